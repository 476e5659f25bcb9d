//! The rows of `reference/FORMATS.md`: inputs, and what must be read from them.

use super::Case;
use super::build::{
    DATA, MHA, NRRD, Tag, big_shorts, bytes, bzip2, floats, gzip, header, nifti, nifti_2, npz, page, png, put, shorts,
    slice, text, tiff, volume, with, zlib, zstd,
};
use ::png::ColorType;
use ndarray::{Array3, Axis};

/// A case with one file.
fn one(input: &'static str, name: &'static str, content: Vec<u8>) -> Case {
    Case::new(input, name, vec![(name.into(), content)])
}

/// A case with a header and one file beside it.
fn two(input: &'static str, name: &'static str, content: Vec<u8>, beside: &str, numbers: Vec<u8>) -> Case {
    Case::new(input, name, vec![(name.into(), content), (beside.into(), numbers)])
}

/// A case with a header and five slices beside it.
fn slices(input: &'static str, name: &'static str, content: Vec<u8>) -> Case {
    let mut files = vec![(name.to_owned(), content)];
    files.extend((0..5).map(|z| (format!("s{z:02}.raw"), slice(&floats(), z, 4))));
    Case::new(input, name, files)
}

pub(super) fn all() -> Vec<Case> {
    [meta_image(), nrrd(), nifti_cases(), tiffs(), folders(), others()].concat()
}

fn mha(changes: &[(&str, &str)], numbers: &[u8]) -> Vec<u8> {
    header(MHA, changes, numbers)
}

fn meta_image() -> Vec<Case> {
    let at = |name: &'static str| ("LOCAL", name);
    let hundred = [vec![9; 100], floats()].concat();
    let list = "LIST\ns00.raw\ns01.raw\n./s02.raw\ns03.raw\ns04.raw";
    let packed = zlib(&floats());
    let size = format!("CompressedData = True\nCompressedDataSize = {}\nElementDataFile", packed.len());
    vec![
        one("MetaImage: plain", "a.mha", mha(&[], &floats())),
        two(
            "MetaImage: HeaderSize = 100",
            "a.mhd",
            mha(&[at("b.raw"), ("DimSize", "HeaderSize = 100\nDimSize")], &[]),
            "b.raw",
            hundred.clone(),
        ),
        two(
            "MetaImage: HeaderSize = -1",
            "a.mhd",
            mha(&[at("b.raw"), ("DimSize", "HeaderSize = -1\nDimSize")], &[]),
            "b.raw",
            hundred.clone(),
        ),
        two(
            "MetaImage: data file longer than needed",
            "a.mhd",
            mha(&[at("b.raw")], &[]),
            "b.raw",
            [floats(), vec![0; 7]].concat(),
        )
        .odd("more data follow"),
        one("MetaImage: numbers cut off", "a.mha", mha(&[], &floats()[..100])).refused("100 bytes"),
        one(
            "MetaImage: ElementByteOrderMSB = True, MET_SHORT",
            "a.mha",
            mha(
                &[("MET_FLOAT", "MET_SHORT"), ("BinaryDataByteOrderMSB = False", "ElementByteOrderMSB = True")],
                &big_shorts(),
            ),
        ),
        one(
            "MetaImage: CompressedData, CompressedDataSize, bytes after it",
            "a.mha",
            mha(&[("ElementDataFile", &size)], &[packed.clone(), vec![1; 9]].concat()),
        ),
        slices("MetaImage: ElementDataFile = LIST", "a.mhd", mha(&[at(list)], &[])),
        slices("MetaImage: ElementDataFile = s%02d.raw 0 4 1", "a.mhd", mha(&[at("s%02d.raw 0 4 1")], &[])),
        two("MetaImage: ElementDataFile = ./b.raw", "a.mhd", mha(&[at("./b.raw")], &[]), "b.raw", floats()),
        two(
            "MetaImage: ElementDataFile = data\\b.raw",
            "a.mhd",
            mha(&[at("data\\b.raw")], &[]),
            "data/b.raw",
            floats(),
        ),
        one("MetaImage: data file that does not exist", "a.mhd", mha(&[at("b.raw")], &[]))
            .refused("put the file there"),
        two("MetaImage: data file in another folder", "a.mhd", mha(&[at("../b.raw")], &[]), "b.raw", floats())
            .refused("move the file into this folder"),
        one("MetaImage: BinaryData = False", "a.mha", mha(&[("BinaryData = True", "BinaryData = False")], &text())),
        one("MetaImage: DistanceUnits = um", "a.mha", mha(&[("DimSize", "DistanceUnits = um\nDimSize")], &floats()))
            .scaled(1e-3)
            .odd("converted to millimetres"),
        one(
            "MetaImage: ElementToIntensityFunctionSlope = 2, Offset = 10",
            "a.mha",
            mha(
                &[("DimSize", "ElementToIntensityFunctionSlope = 2\nElementToIntensityFunctionOffset = 10\nDimSize")],
                &floats(),
            ),
        )
        .values(volume().mapv(|value| 2.0 * value + 10.0))
        .odd("is applied"),
        one("MetaImage: ElementSpacing = 0 0.75 NaN", "a.mha", mha(&[("0.5 0.75 1.25", "0 0.75 NaN")], &floats()))
            .spacing([1.0, 0.75, 1.0])
            .odd("zero or non-finite lengths"),
        one("MetaImage: ElementSpacing = -0.5 0.75 1.25", "a.mha", mha(&[("0.5 0.75", "-0.5 0.75")], &floats()))
            .odd("directions"),
        one("MetaImage: a field of nobody, Gain = 3", "a.mha", mha(&[("DimSize", "Gain = 3\nDimSize")], &floats()))
            .odd("not read: Gain"),
        one(
            "MetaImage: ElementNumberOfChannels = 3",
            "a.mha",
            mha(&[("DimSize", "ElementNumberOfChannels = 3\nDimSize")], &floats()),
        )
        .refused("not supported"),
        one(
            "MetaImage: NDims = 4, DimSize = 3 4 5 2",
            "a.mha",
            mha(
                &[
                    ("NDims = 3", "NDims = 4"),
                    ("3 4 5", "3 4 5 2"),
                    ("ElementSpacing = 0.5 0.75 1.25\nOffset = -3 7 0.5\n", ""),
                ],
                &floats(),
            ),
        )
        .refused("not supported"),
        one(
            "MetaImage: byte-order mark, lines that end with CR LF",
            "a.mha",
            [b"\xef\xbb\xbf", mha(&[], &[]).as_slice(), &floats()].concat(),
        )
        .changed(|content| replace(content, "= Image\n", "= Image\r\n")),
    ]
}

/// Replaces a part of a file.
fn replace(content: &mut Vec<u8>, from: &str, to: &str) {
    let at = content.windows(from.len()).position(|part| part == from.as_bytes()).unwrap();
    content.splice(at..at + from.len(), to.bytes());
}

fn nrrd() -> Vec<Case> {
    let plain = |changes: &[(&str, &str)], numbers: &[u8]| header(NRRD, changes, numbers);
    let beside = |name: &str| format!("encoding: raw\ndata file: {name}");
    let file = |name: &str, more: &str| plain(&[("encoding: raw", &(beside(name) + more))], &[]);
    let list = "LIST\ns00.raw\ns01.raw\ns02.raw\ns03.raw\ns04.raw";
    let no_space = |with: &str| {
        let space = "space: left-posterior-superior\nspace directions: (0.5,0,0) (0,0.75,0) (0,0,1.25)\nspace origin: (-3,7,0.5)\n";
        plain(&[(space, with)], &floats())
    };
    let encoded =
        |encoding: &str, numbers: &[u8]| plain(&[("encoding: raw", &format!("encoding: {encoding}"))], numbers);
    vec![
        one("NRRD: plain", "a.nrrd", plain(&[], &floats())),
        two(
            "NRRD: byte skip: 100",
            "a.nhdr",
            file("b.raw", "\nbyte skip: 100"),
            "b.raw",
            [vec![9; 100], floats()].concat(),
        ),
        two(
            "NRRD: byte skip: -1",
            "a.nhdr",
            file("b.raw", "\nbyte skip: -1"),
            "b.raw",
            [vec![9; 100], floats()].concat(),
        ),
        two(
            "NRRD: line skip: 2",
            "a.nhdr",
            file("b.raw", "\nline skip: 2"),
            "b.raw",
            [b"one\ntwo\n".to_vec(), floats()].concat(),
        ),
        one("NRRD: gzip", "a.nrrd", encoded("gzip", &gzip(&floats()))),
        one(
            "NRRD: gzip, byte skip: 4 (after unpacking)",
            "a.nrrd",
            plain(&[("encoding: raw", "encoding: gzip\nbyte skip: 4")], &gzip(&[vec![9; 4], floats()].concat())),
        ),
        one("NRRD: bzip2", "a.nrrd", encoded("bzip2", &bzip2(&floats()))),
        one("NRRD: ascii", "a.nrrd", encoded("ascii", &text())),
        one("NRRD: hex", "a.nrrd", encoded("hex", b"00")).refused("not supported"),
        slices(
            "NRRD: data file: LIST",
            "a.nhdr",
            header(NRRD, &[("raw\n\n", &format!("raw\ndata file: {list}\n"))], &[]),
        ),
        two("NRRD: data file: ./b.raw", "a.nhdr", file("./b.raw", ""), "b.raw", floats()),
        one("NRRD: spacings: NaN NaN NaN", "a.nrrd", no_space("spacings: NaN NaN NaN\n"))
            .spacing([1.0; 3])
            .no_origin()
            .odd("zero or non-finite lengths"),
        one("NRRD: axis mins, cells", "a.nrrd", no_space("spacings: 0.5 0.75 1.25\naxis mins: -3.25 6.625 -0.125\n")),
        one(
            "NRRD: axis mins, centers: node",
            "a.nrrd",
            no_space("spacings: 0.5 0.75 1.25\naxis mins: -3 7 0.5\ncenters: node node node\n"),
        ),
        one(
            "NRRD: space: right-anterior-superior",
            "a.nrrd",
            plain(
                &[
                    ("left-posterior", "right-anterior"),
                    ("(0.5,", "(-0.5,"),
                    ("(0,0.75", "(0,-0.75"),
                    ("(-3,7", "(3,-7"),
                ],
                &floats(),
            ),
        ),
        one(
            "NRRD: space units: \"um\"",
            "a.nrrd",
            plain(&[("space origin", "space units: \"um\" \"um\" \"um\"\nspace origin")], &floats()),
        )
        .scaled(1e-3)
        .odd("converted to millimetres"),
        one("NRRD: more data than needed", "a.nrrd", plain(&[], &[floats(), vec![0; 9]].concat()))
            .odd("more data follow"),
        one("NRRD: numbers cut off", "a.nrrd", plain(&[], &floats()[..100])).refused("100 bytes"),
        one(
            "NRRD: kinds: RGB-color domain domain",
            "a.nrrd",
            plain(&[("endian", "kinds: RGB-color domain domain\nendian")], &floats()),
        )
        .refused("not supported"),
        one("NRRD: endian not stated", "a.nrrd", plain(&[("endian: little\n", "")], &floats()))
            .odd("endian is not stated"),
        one(
            "NRRD: a field of nobody, gain: 3; a remark key:=value",
            "a.nrrd",
            plain(&[("endian", "key:=value\ngain: 3\nendian")], &floats()),
        )
        .odd("not read: gain"),
    ]
}

fn nifti_cases() -> Vec<Case> {
    let float = |at: usize, x: f32| nifti(move |file| put(file, at, x.to_le_bytes()));
    let no_forms = |file: &mut Vec<u8>| put(file, 252, [0; 4]);
    vec![
        one("NIfTI-1: plain", "a.nii", nifti(|_| {})),
        one("NIfTI-1: gzip", "a.nii.gz", gzip(&nifti(|_| {}))),
        one("NIfTI-2", "a.nii", nifti_2(false)),
        one("NIfTI-2: big-endian, gzip", "a.nii.gz", gzip(&nifti_2(true))),
        one("NIfTI: unit micrometre", "a.nii", nifti(|file| file[123] = 3)).scaled(1e-3).odd("micrometres"),
        one("NIfTI: unit metre", "a.nii", nifti(|file| file[123] = 1)).scaled(1e3).odd("metres"),
        one("NIfTI: sform of zeros", "a.nii", nifti(|file| file[280..328].fill(0))).odd("qform is read instead"),
        one(
            "NIfTI: sform of zeros, no qform",
            "a.nii",
            nifti(|file| {
                file[280..328].fill(0);
                put(file, 252, [0; 2]);
            }),
        )
        .no_origin()
        .odd("pixdim is read instead"),
        one("NIfTI: sform and pixdim differ", "a.nii", float(80, 0.6)).odd("differs from the spacing"),
        one(
            "NIfTI: no sform, no qform, pixdim 0",
            "a.nii",
            nifti(|file| {
                no_forms(file);
                put(file, 84, 0_f32.to_le_bytes());
            }),
        )
        .no_origin()
        .spacing([0.5, 1.0, 1.25])
        .odd("zero or non-finite lengths"),
        one(
            "NIfTI: no sform, no qform, pixdim NaN, inf, -1.25",
            "a.nii",
            nifti(|file| {
                no_forms(file);
                put(file, 80, f32::NAN.to_le_bytes());
                put(file, 84, f32::INFINITY.to_le_bytes());
                put(file, 88, (-1.25_f32).to_le_bytes());
            }),
        )
        .no_origin()
        .spacing([1.0, 1.0, 1.25])
        .odd("zero or non-finite lengths"),
        one(
            "NIfTI: scl_slope 2, scl_inter 10",
            "a.nii",
            nifti(|file| {
                put(file, 112, 2_f32.to_le_bytes());
                put(file, 116, 10_f32.to_le_bytes());
            }),
        )
        .values(volume().mapv(|value| 2.0 * value + 10.0)),
        one("NIfTI: scl_slope NaN", "a.nii", float(112, f32::NAN)).odd("not applied"),
        one("NIfTI: intent code 1002 (labels)", "a.nii", nifti(|file| put(file, 68, 1002_i16.to_le_bytes())))
            .odd("intent code 1002"),
        one("NIfTI: vox_offset 0", "a.nii", float(108, 0.0)).odd("within the header"),
        one("NIfTI: more data than needed", "a.nii", nifti(|file| file.extend([0; 9]))).odd("more data follow"),
        one("NIfTI: numbers cut off", "a.nii", nifti(|file| file.truncate(400))).refused("400 bytes"),
        one("NIfTI: colours (datatype 128)", "a.nii", nifti(|file| put(file, 70, 128_i16.to_le_bytes())))
            .refused("not supported"),
        one(
            "NIfTI: two times",
            "a.nii",
            nifti(|file| {
                put(file, 40, 4_i16.to_le_bytes());
                put(file, 48, 2_i16.to_le_bytes());
            }),
        )
        .refused("not supported"),
        one("NIfTI: header of a pair .hdr and .img", "a.nii", nifti(|file| put(file, 344, *b"ni1\0")))
            .refused("not supported"),
    ]
}

fn tiffs() -> Vec<Case> {
    let all = |z: usize| page(DATA + 48 * z, 32, 3);
    let pages = || (0..5).map(all).collect::<Vec<_>>();
    let described = |text: &'static str| vec![with(all(0), &[(270, Tag::Text(text))])];
    let fractions = [(282, Tag::Fraction(2, 1)), (283, Tag::Fraction(4, 3))];
    let image_j = "ImageJ=1.53t\nimages=5\nslices=5\nunit=mm\nspacing=1.25\n";
    let micron = "ImageJ=1.53t\nimages=5\nslices=5\nunit=micron\nspacing=1.25\n";
    let scaled = |text: &'static str| with(all(0), &[&[(270, Tag::Text(text))][..], &fractions].concat());
    let calibrated = "ImageJ=1.53t\nimages=5\nslices=5\ncf=0\nc0=-32768\nc1=1\nvunit=gray value\n";
    let shifted: Vec<u8> = volume().t().iter().flat_map(|&value| (value as u16 + 32_768).to_le_bytes()).collect();
    let ome = "<?xml version=\"1.0\"?><OME><Image><Pixels SizeX=\"3\" SizeY=\"4\" SizeZ=\"5\" SizeC=\"1\" SizeT=\"1\" \
               PhysicalSizeX=\"500\" PhysicalSizeY=\"750\" PhysicalSizeZ=\"1250\"/></Image></OME>";
    let thumbnail =
        with(page(DATA, 32, 3), &[(254, Tag::Long(1)), (256, Tag::Long(1)), (257, Tag::Long(1)), (279, Tag::Long(4))]);
    let bare = |case: Case| case.no_spacing().no_origin();
    vec![
        bare(one("TIFF: five pages", "a.tif", tiff(&floats(), &pages()))),
        one("TIFF: ImageJ, one directory, unit mm", "a.tif", tiff(&floats(), &[scaled(image_j)])).no_origin(),
        one("TIFF: ImageJ, one directory, unit micron", "a.tif", tiff(&floats(), &[scaled(micron)]))
            .scaled(1e-3)
            .no_origin()
            .odd("converted to millimetres"),
        bare(one(
            "TIFF: tifffile's frames as planes of one page",
            "a.tif",
            tiff(
                &floats(),
                &[with(
                    all(0),
                    &[
                        (270, Tag::Text("{\"shape\": [5, 4, 3]}")),
                        (262, Tag::Short(2)),
                        (277, Tag::Short(5)),
                        (279, Tag::Long(240)),
                        (284, Tag::Short(2)),
                    ],
                )],
            ),
        )),
        bare(
            one(
                "TIFF: ImageJ's 16 bits with c0=-32768",
                "a.tif",
                tiff(&shifted, &[with(page(DATA, 16, 1), &[(270, Tag::Text(calibrated))])]),
            )
            .odd("is applied"),
        ),
        bare(one("TIFF: ImageJ, one directory, numbers cut off", "a.tif", tiff(&floats()[..100], &[scaled(image_j)])))
            .refused("which its description states"),
        bare(one(
            "TIFF: ImageJ states 5 pages, 3 directories",
            "a.tif",
            tiff(&floats(), &[scaled(image_j), all(1), all(2)]),
        ))
        .refused("truncated"),
        bare(one(
            "TIFF: tifffile's shape [5, 4, 3], one directory",
            "a.tif",
            tiff(&floats(), &described("{\"shape\": [5, 4, 3], \"truncated\": true}")),
        )),
        bare(one(
            "TIFF: tifffile's shape [60, 4, 3], one directory",
            "a.tif",
            tiff(&floats(), &described("{\"shape\": [60, 4, 3]}")),
        ))
        .refused("which its description states"),
        bare(
            one(
                "TIFF: tifffile's shape [2, 4, 3], five pages",
                "a.tif",
                tiff(&floats(), &[described("{\"shape\": [2, 4, 3]}"), (1..5).map(all).collect()].concat()),
            )
            .odd("states 2 pages"),
        ),
        one(
            "TIFF: OME-XML, spacing in micrometres",
            "a.tif",
            tiff(&floats(), &[described(ome), (1..5).map(all).collect()].concat()),
        )
        .no_origin(),
        bare(one("TIFF: Zstandard", "a.tif", zstd())),
        bare(one("TIFF: JPEG", "a.tif", tiff(&floats(), &[with(all(0), &[(259, Tag::Short(7))])])))
            .refused("not supported"),
        bare(one(
            "TIFF: three numbers per pixel",
            "a.tif",
            tiff(&floats(), &[with(page(DATA, 8, 1), &[(262, Tag::Short(2)), (277, Tag::Short(3))])]),
        ))
        .refused("not supported"),
        bare(
            one("TIFF: a reduced copy among the pages", "a.tif", tiff(&floats(), &[pages(), vec![thumbnail]].concat()))
                .odd("reduced copies"),
        ),
        bare(
            one(
                "TIFF: white is zero",
                "a.tif",
                tiff(
                    &bytes(),
                    &(0..5).map(|z| with(page(DATA + 12 * z, 8, 1), &[(262, Tag::Short(0))])).collect::<Vec<_>>(),
                ),
            )
            .odd("0 is white"),
        ),
        bare(
            one(
                "TIFF: orientation 4 (rows from the bottom)",
                "a.tif",
                tiff(&floats(), &(0..5).map(|z| with(all(z), &[(274, Tag::Short(4))])).collect::<Vec<_>>()),
            )
            .odd("another orientation"),
        ),
        bare(one(
            "TIFF: page of another size",
            "a.tif",
            tiff(&floats(), &[all(0), with(all(1), &[(257, Tag::Long(3)), (279, Tag::Long(36))])]),
        ))
        .refused("pages of equal size"),
        bare(one("TIFF: page cut off", "a.tif", tiff(&floats()[..100], &pages()[..1]).into_iter().take(40).collect()))
            .refused("after the end of the file"),
    ]
}

fn folders() -> Vec<Case> {
    let folder = |input, name: fn(usize) -> String, content: fn(usize) -> Vec<u8>| {
        let files = (0..5).map(|z| (format!("s/{}", name(z)), content(z))).collect();
        Case::new(input, "s", files).no_spacing().no_origin()
    };
    let gap = |z: usize| format!("s{}.tif", if z < 3 { z } else { z + 1 });
    let one_page = |z: usize| tiff(&slice(&floats(), z, 4), &[page(DATA, 32, 3)]);
    vec![
        folder("folder of .png, 8 bits", |z| format!("{}.png", z + 8), |z| png(z, false, ColorType::Grayscale)),
        folder("folder of .png, 16 bits", |z| format!("{}.png", z + 8), |z| png(z, true, ColorType::Grayscale)),
        folder("folder of .png in equal colours", |z| format!("{z}.png"), |z| png(z, false, ColorType::Rgb))
            .odd("one channel"),
        folder("folder of .tif, a number missing", gap, one_page).odd("slices seem to be missing (1)"),
        folder("folder of .raw, s0_3x4_uint8.raw", |z| format!("s{z}_3x4_uint8.raw"), |z| slice(&bytes(), z, 1)),
        folder("folder of .raw, one of another size", |z| format!("s{z}_3x4_uint8.raw"), |z| slice(&bytes(), z, 1))
            .with("s/s5_4x3_uint8.raw", slice(&bytes(), 0, 1))
            .refused("pages of equal size"),
        Case::new(
            "folder of .raw whose name states size and type",
            "s_3x4_int16be",
            (0..5).map(|z| (format!("s_3x4_int16be/{z}.raw"), slice(&big_shorts(), z, 2))).collect(),
        )
        .no_spacing()
        .no_origin(),
        folder("folder of .png and .tif", |z| format!("{z}.tif"), one_page)
            .with("s/0.png", Vec::new())
            .odd("other kinds"),
        Case::new("folder of .h5", "s", vec![("s/a.h5".into(), Vec::new())]).refused("not supported"),
    ]
}

fn others() -> Vec<Case> {
    let bare = |case: Case| case.no_spacing().no_origin();
    let grey = Array3::from_shape_fn((3, 4, 1), |(x, y, _)| (100 + 20 * x + 10 * y) as f32);
    let transparent = png(0, false, ColorType::GrayscaleAlpha);
    let slice_0 = volume().select(Axis(2), &[0]);
    vec![
        bare(one("PNG: one slice", "a.png", png(0, false, ColorType::Grayscale))).values(slice_0),
        bare(one("PNG: transparent", "a.png", transparent)).refused("not supported"),
        bare(one("JPEG: one slice", "a.jpg", include_bytes!("../../data/grey.jpg").to_vec())).values(grey).odd("loses detail"),
        bare(one("NumPy archive: one volume", "a.npz", npz(&["vol"]))),
        bare(one("NumPy archive: two volumes", "a.npz", npz(&["a", "b"]))).refused("one array with axes"),
        bare(one("raw: a_3x4x5_float32.raw", "a_3x4x5_float32.raw", floats())),
        bare(one("raw: one byte too many", "a_3x4x5_float32.raw", [floats(), vec![0]].concat())).refused("correct the size"),
        two("raw: side file with a byte-order mark", "a.raw", shorts(), "a.raw.json",
            b"\xef\xbb\xbf{\"shape\": [3, 4, 5], \"type\": \"int16\", \"spacing\": [0.5, 0.75, 1.25], \"origin\": [-3, 7, 0.5]}".to_vec()),
        bare(one("Analyze", "a.img", Vec::new())).refused("not supported"),
    ]
}
