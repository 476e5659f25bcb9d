use super::*;
use crate::tolerances::largest;
use ::tiff::encoder::colortype::{ColorType, Gray8, Gray16, Gray32, Gray32Float, Gray64Float, GrayI16, RGB8};
use ::tiff::encoder::{Compression, DeflateLevel, TiffEncoder, TiffValue};
use ndarray::Axis;
use std::path::PathBuf;
use tempfile::TempDir;

fn sample() -> VolumeFile {
    let values = Array3::from_shape_fn((3, 4, 5), |(x, y, z)| (100 * x + 10 * y + z) as f32 / 8.0);
    let (spacing, origin) = (Some(DVec3::new(0.5, 0.25, 2.0)), Some(DVec3::new(-1.0, 3.0, 0.125)));
    VolumeFile { values, spacing, origin, ..VolumeFile::default() }
}

fn folder() -> (TempDir, impl Fn(&str) -> PathBuf) {
    let folder = tempfile::tempdir().unwrap();
    let root = folder.path().to_owned();
    (folder, move |name: &str| root.join(name))
}

#[test]
fn what_is_written_is_read_again() {
    let (_folder, at) = folder();
    for name in ["a.mha", "a.nrrd", "a.nii", "a.nii.gz", "a.npy", "a.tif", "a.TIFF", "a_3x4x5_float32.raw"] {
        write(at(name), &sample()).unwrap();
        let mut expected = sample();
        if ["npy", "raw", "tif", "TIFF"].iter().any(|ending| name.ends_with(ending)) {
            (expected.spacing, expected.origin) = (None, None);
        }
        assert_eq!(read(at(name)).unwrap(), expected, "{name}");
    }
}

#[test]
fn directions_go_through_every_format_that_has_them() {
    let (_folder, at) = folder();
    // A rotation about an oblique axis, without and with a mirror.
    let turn = DMat3::from_quat(glam::DQuat::from_xyzw(0.5, -0.1, 0.7, 0.5).normalize());
    for directions in [turn, turn * DMat3::from_diagonal(DVec3::new(1.0, 1.0, -1.0)), DMat3::from_diagonal(-DVec3::ONE)]
    {
        let turned = VolumeFile { directions, ..sample() };
        for name in ["a.mha", "a.nrrd", "a.nii", "a.nii.gz"] {
            write(at(name), &turned).unwrap();
            let found = read(at(name)).unwrap();
            within!(largest((found.directions - directions).to_cols_array()), "{name}: {}", found.directions);
            within!(largest((found.spacing.unwrap() - turned.spacing.unwrap()).to_array()), "{name}");
            assert_eq!((found.values, found.origin), (turned.values.clone(), turned.origin), "{name}");
            assert!(found.oddities[0].contains("directions"), "{:?}", found.oddities);
        }
    }
}

#[test]
fn nifti_counts_to_the_right_and_the_front_and_the_others_to_the_left_and_the_back() {
    let (_folder, at) = folder();
    write(at("a.nii"), &sample()).unwrap();
    let header = std::fs::read(at("a.nii")).unwrap();
    let number = |at: usize| f32::from_le_bytes(header[at..at + 4].try_into().unwrap());
    // The rows of the matrix, and the quaternion of half a turn about z with the same origin.
    let rows: Vec<f32> = (0..12).map(|i| number(280 + 4 * i)).collect();
    assert_eq!(rows, [-0.5, 0.0, 0.0, 1.0, 0.0, -0.25, 0.0, -3.0, 0.0, 0.0, 2.0, 0.125]);
    let quaternion: Vec<f32> = (0..6).map(|i| number(256 + 4 * i)).collect();
    assert_eq!(quaternion, [0.0, 0.0, 1.0, 1.0, -3.0, 0.125]);
    write(at("a.mha"), &sample()).unwrap();
    let header = std::fs::read(at("a.mha")).unwrap();
    let header = String::from_utf8_lossy(&header);
    assert!(header.contains("TransformMatrix = 1 0 0 0 1 0 0 0 1\nOffset = -1 3 0.125\n"), "{header}");
    write(at("a.nrrd"), &sample()).unwrap();
    let mut content = std::fs::read(at("a.nrrd")).unwrap();
    let said = b"left-posterior-superior";
    let place = content.windows(said.len()).position(|window| window == said).unwrap();
    content.splice(place..place + said.len(), *b"right-anterior-superior");
    std::fs::write(at("ras.nrrd"), content).unwrap();
    let found = read(at("ras.nrrd")).unwrap();
    assert_eq!(found.origin, Some(DVec3::new(1.0, -3.0, 0.125)));
    assert_eq!(found.directions, DMat3::from_diagonal(DVec3::new(-1.0, -1.0, 1.0)));
}

#[test]
fn the_same_volume_gives_the_same_bytes() {
    let (_folder, at) = folder();
    for name in ["a.mha", "a.nrrd", "a.nii", "a.nii.gz", "a.tif"] {
        let bytes = || {
            write(at(name), &sample()).unwrap();
            std::fs::read(at(name)).unwrap()
        };
        assert!(bytes() == bytes(), "{name}");
    }
}

#[test]
fn types_orders_and_files_beside_are_understood() {
    let (_folder, at) = folder();
    let expected = Array3::from_shape_vec((2, 1, 2), vec![1.0, 3.0, 2.0, 256.0]).unwrap();
    // x is the fastest: (0,0,0), (1,0,0), (0,0,1), (1,0,1).
    let numbers: [u16; 4] = [1, 2, 3, 256];
    std::fs::write(at("v_2x1x2_uint16be.raw"), numbers.map(u16::to_be_bytes).concat()).unwrap();
    assert_eq!(read(at("v_2x1x2_uint16be.raw")).unwrap().values, expected);
    let header = "ObjectType = Image\nNDims = 3\nDimSize = 2 1 2\nElementType = MET_USHORT\nElementByteOrderMSB = True\n\
                  TransformMatrix = 0 1 0 1 0 0 0 0 1\nElementSpacing = 1 2 3\nElementDataFile = v_2x1x2_uint16be.raw\n";
    std::fs::write(at("v.mhd"), header).unwrap();
    let found = read(at("v.mhd")).unwrap();
    assert_eq!((found.values, found.spacing), (expected.clone(), Some(DVec3::new(1.0, 2.0, 3.0))));
    assert!(found.oddities[0].contains("directions [0, 1, 0], [1, 0, 0]"));
    let header = "NRRD0001\n# a remark\ntype: unsigned short\ndimension: 3\nsizes: 2 1 2\nspacings: 1 2 3\nendian: big\n\
                  encoding: raw\ndata file: v_2x1x2_uint16be.raw";
    std::fs::write(at("v.nhdr"), header).unwrap();
    let found = read(at("v.nhdr")).unwrap();
    assert_eq!((found.values, found.spacing), (expected, Some(DVec3::new(1.0, 2.0, 3.0))));
}

/// A page of 2 rows and 3 columns: 0, 1, … in one number type.
fn page<C: ColorType<Inner: From<u8>>>(compression: Compression) -> Vec<u8>
where
    [C::Inner]: TiffValue,
{
    let mut content = std::io::Cursor::new(Vec::new());
    let mut encoder = TiffEncoder::new(&mut content).unwrap().with_compression(compression);
    let values: Vec<C::Inner> = (0..6_u8).map(C::Inner::from).collect();
    encoder.write_image::<C>(3, 2, &values).unwrap();
    content.into_inner()
}

#[test]
fn pages_of_every_type_and_packing_are_columns_rows_and_slices() {
    let expected = Array3::from_shape_fn((3, 2, 1), |(x, y, _)| (3 * y + x) as f32);
    let pages = [
        page::<Gray8>(Compression::Packbits),
        page::<Gray16>(Compression::Lzw),
        page::<Gray32>(Compression::Uncompressed),
        page::<GrayI16>(Compression::Deflate(DeflateLevel::Balanced)),
        page::<Gray32Float>(Compression::Lzw),
        page::<Gray64Float>(Compression::Uncompressed),
    ];
    for (i, content) in pages.iter().enumerate() {
        let found = parse(content, Path::new("a.tif")).unwrap();
        assert_eq!(found.values, expected, "{i}");
        assert!(found.values.is_standard_layout());
    }
    let colour = {
        let mut content = std::io::Cursor::new(Vec::new());
        TiffEncoder::new(&mut content).unwrap().write_image::<RGB8>(1, 1, &[1, 2, 3]).unwrap();
        content.into_inner()
    };
    assert!(parse(&colour, Path::new("a.tif")).unwrap_err().to_string().contains("RGB(8), which is not supported"));
}

/// Memory used to read a damaged file, and the error message.
fn cost(content: &[u8], name: &str) -> (u64, String) {
    let mut message = String::new();
    let memory = allocation_counter::measure(|| message = parse(content, Path::new(name)).unwrap_err().to_string());
    (memory.bytes_max, message)
}

#[test]
fn counts_and_tiles_that_a_tiff_has_no_room_for_are_given_no_memory() {
    let valid = page::<Gray32Float>(Compression::Uncompressed);
    let width = valid.windows(4).position(|part| part == [0, 1, 4, 0]).unwrap();
    let mut content = valid.clone();
    content[width + 4..width + 8].copy_from_slice(&0x7f00_0000_u32.to_le_bytes());
    let (memory, message) = cost(&content, "a.tif");
    assert!(memory < 1 << 16 && message.contains("2130706432 values of tag 256"), "{memory}: {message}");
    // A row of a tile is held completely where a predictor works on it.
    let entries: [(u16, u32); 12] = [
        (256, 1),
        (257, 1),
        (258, 32),
        (259, 1),
        (262, 1),
        (277, 1),
        (317, 3),
        (322, 0x1000_0000),
        (323, 1),
        (324, 8),
        (325, 64),
        (339, 3),
    ];
    let mut content = [&b"II*\0\x08\0\0\0"[..], &(entries.len() as u16).to_le_bytes()].concat();
    for (tag, value) in entries {
        content.extend([&tag.to_le_bytes()[..], &[4, 0, 1, 0, 0, 0], &value.to_le_bytes()].concat());
    }
    content.extend([0; 4]);
    let (memory, message) = cost(&content, "a.tif");
    assert!(memory < 1 << 16 && message.contains("tiles of (268435456, 1) pixels"), "{memory}: {message}");
    // A cyclic chain of directories must end.
    let end = content.len() - 4;
    content[end..].copy_from_slice(&8_u32.to_le_bytes());
    assert!(cost(&content, "a.tif").0 < 1 << 16);
}

#[test]
fn messages_of_libraries_are_cut() {
    // A sample format for each of 600 samples, all unknown.
    let mut content = [&b"II*\0\x08\0\0\0\x06\0"[..]].concat();
    for (tag, count, value) in
        [(256_u16, 1_u32, 1_u32), (257, 1, 1), (258, 1, 8), (262, 1, 1), (277, 1, 1), (339, 600, 10)]
    {
        content.extend([&tag.to_le_bytes()[..], &[3, 0], &count.to_le_bytes(), &value.to_le_bytes()].concat());
    }
    content.extend([0; 4]);
    content.extend([9; 1300]);
    let (_, message) = cost(&content, "a.tif");
    assert!((400..600).contains(&message.len()), "{} bytes: {message}", message.len());
}

#[test]
fn a_folder_of_pages_is_read_in_natural_order() {
    let (_folder, at) = folder();
    std::fs::create_dir(at("pages")).unwrap();
    let page = |name: &str, value: f32, depth: usize| {
        let values = Array3::from_elem((3, 2, depth), value);
        write(at("pages").join(name), &VolumeFile { values, ..sample() }).unwrap();
    };
    for (name, value) in [("s10.tif", 3.0), ("s9.tif", 2.0), ("s1.tif", 1.0), ("s011.tif", 4.0)] {
        page(name, value, 1);
    }
    std::fs::write(at("pages/notes.txt"), "no page").unwrap();
    std::fs::write(at("pages/.hidden.tif"), "no page").unwrap();
    let found = read(at("pages")).unwrap().values;
    assert_eq!(found.dim(), (3, 2, 4));
    assert_eq!(found.index_axis(Axis(0), 2).row(1).to_vec(), [1.0, 2.0, 3.0, 4.0]);
    page("s12.tif", 5.0, 2);
    assert!(read(at("pages")).unwrap_err().to_string().contains("s12.tif: file in a folder: got 2 pages"));
    write(at("pages/s12.tif"), &sample()).unwrap();
    assert!(
        read(at("pages"))
            .unwrap_err()
            .to_string()
            .contains("a page of 4 rows and 3 columns after 4 of 2 rows and 3 columns")
    );
    std::fs::create_dir(at("empty")).unwrap();
    assert!(read(at("empty")).unwrap_err().to_string().contains("got 0 files, expected slices .tif"));
}

#[test]
fn a_file_beside_raw_numbers_describes_them() {
    let (_folder, at) = folder();
    let numbers: Vec<u8> = (0..8_u16).flat_map(|n| (n * 300).to_be_bytes()).collect();
    std::fs::write(at("v.raw"), [&b"head"[..], &numbers].concat()).unwrap();
    let described = |text: &str| {
        std::fs::write(at("v.raw.json"), text).unwrap();
        read(at("v.raw"))
    };
    let whole = r#"{"shape": [4, 1, 2], "type": "uint16", "byte_order": "big", "spacing": [0.5, 1, 2],
        "origin": [1, 2, -3.5], "skip_bytes": 4}"#;
    let found = described(whole).unwrap();
    assert_eq!(found.values, Array3::from_shape_fn((4, 1, 2), |(x, _, z)| (300 * (x + 4 * z)) as f32));
    assert_eq!((found.spacing, found.origin), (Some(DVec3::new(0.5, 1.0, 2.0)), Some(DVec3::new(1.0, 2.0, -3.5))));
    let found = described(r#"{"shape": [5, 2, 2], "type": "uint8"}"#).unwrap();
    assert_eq!((found.values[[4, 0, 0]], found.spacing), (0.0, None));
    for (text, part) in [
        (r#"{"shape": [4, 1, 2], "type": "uint16"}"#, "20 bytes after the first 0, expected 16 bytes"),
        (r#"{"shape": [4, 1, 2], "type": "uint16", "skip_bytes": 99}"#, "0 bytes after the first 99"),
        (r#"{"shape": [4, 1, 0], "type": "uint16"}"#, "[4, 1, 0]"),
        (r#"{"shape": [4, 1, 2], "type": "complex64"}"#, "complex64"),
        (r#"{"shape": [4, 1], "type": "uint16"}"#, "v.raw.json"),
        (r#"{"shape": [4, 1, 2], "type": "uint16", "order": "big"}"#, "order"),
        (r#"{"shape": [4, 1, 2], "type": "uint16", "spacing": [1, 0, 1]}"#, "spacing"),
    ] {
        let message = described(text).unwrap_err().to_string();
        assert!(message.contains(part), "{message}");
    }
    // A stale side file must not remain when its numbers are replaced.
    std::fs::write(at("a_3x4x5_float32.raw.json"), whole).unwrap();
    assert!(write(at("a_3x4x5_float32.raw"), &sample()).unwrap_err().to_string().contains("delete the side file"));
}

#[test]
fn headers_of_numbers_elsewhere_stay_in_their_folder() {
    let (_folder, at) = folder();
    std::fs::create_dir(at("inner")).unwrap();
    std::fs::write(at("secret.raw"), [7]).unwrap();
    std::fs::write(at("inner/v.raw"), [5]).unwrap();
    let absolute = at("secret.raw").to_str().unwrap().to_owned();
    for (name, is_inside) in [("v.raw", true), ("../secret.raw", false), (absolute.as_str(), false), ("./v.raw", true)]
    {
        let mhd = format!("NDims = 3\nDimSize = 1 1 1\nElementType = MET_UCHAR\nElementDataFile = {name}\n");
        let nhdr = format!("NRRD0004\ntype: uchar\ndimension: 3\nsizes: 1 1 1\nencoding: raw\ndata file: {name}\n");
        for (header, text) in [("inner/a.mhd", mhd), ("inner/a.nhdr", nhdr)] {
            std::fs::write(at(header), text).unwrap();
            match read(at(header)) {
                Ok(found) => assert!(is_inside && found.values[[0, 0, 0]] == 5.0, "{header} {name}"),
                Err(error) => {
                    assert!(!is_inside && error.to_string().contains("file in this folder or below"), "{error}")
                }
            }
        }
    }
}

#[test]
fn what_does_not_fit_is_an_error_that_names_it() {
    let (_folder, at) = folder();
    let refused = |name: &str, content: &[u8]| {
        std::fs::write(at(name), content).unwrap();
        read(at(name)).unwrap_err().to_string()
    };
    assert!(
        refused("a.mha", b"DimSize = 9 9 9\nElementType = MET_FLOAT\nElementDataFile = LOCAL\n1234")
            .contains("[9, 9, 9]")
    );
    assert!(refused("a.mha", b"DimSize = 9 9\nElementType = MET_CHAR\nElementDataFile = LOCAL\n").contains("3 counts"));
    assert!(
        refused("a.mha", b"DimSize = 1 1 1\nElementType = MET_UCHAR\nElementDataFile = ../x.raw\n")
            .contains("this folder")
    );
    let missing = refused("a.mhd", b"DimSize = 1 1 1\nElementType = MET_UCHAR\nElementDataFile = x.raw\n");
    assert!(missing.contains("x.raw\", which does not exist") && missing.contains("put the file there"), "{missing}");
    assert!(refused("a.nrrd", b"NRRD0004\ntype: block\nsizes: 1 1 1\nencoding: raw\n\n").contains("block"));
    assert!(refused("a.nrrd", b"P5\n").contains("NRRD0001"));
    let huge = b"NRRD0004\ntype: float\ndimension: 3\nsizes: 99999 99999 99999\nencoding: gzip\n\n12345";
    assert!(refused("a.nrrd", huge).contains("99999"));
    assert!(refused("a.raw", b"1").contains("name_256x256x256_uint8.raw"));
    assert!(refused("a_2x2x2_uint8.raw", b"1234567").contains("7 bytes"));
    assert!(refused("a.nii", &[0; 400]).contains("volume"));
    assert!(read(at("a.stl")).unwrap_err().to_string().contains(".nii.gz"));
    assert!(write(at("a_3x4x6_float32.raw"), &sample()).unwrap_err().to_string().contains("_3x4x5_float32.raw"));
}
