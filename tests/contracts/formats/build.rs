//! Small files in many formats, built byte by byte.

use ndarray::Array3;
use std::io::{Cursor, Write};

/// Numbers of a type, x fastest, from the values of a volume.
macro_rules! encode {
    ($kind:ty, $order:ident) => {
        volume().t().iter().flat_map(|&value| (value as $kind).$order()).collect::<Vec<u8>>()
    };
}

/// The volume of most inputs: 3 × 4 × 5 voxels, all different.
pub(crate) fn volume() -> Array3<f32> {
    Array3::from_shape_fn((3, 4, 5), |(x, y, z)| (2 * (20 * x + 5 * y + z) + 1) as f32)
}

pub(crate) fn floats() -> Vec<u8> {
    encode!(f32, to_le_bytes)
}

pub(crate) fn shorts() -> Vec<u8> {
    encode!(i16, to_le_bytes)
}

pub(crate) fn big_shorts() -> Vec<u8> {
    encode!(i16, to_be_bytes)
}

pub(crate) fn bytes() -> Vec<u8> {
    encode!(u8, to_le_bytes)
}

/// The numbers as decimal text.
pub(crate) fn text() -> Vec<u8> {
    volume().t().iter().map(|value| format!("{value}\n")).collect::<String>().into_bytes()
}

/// The bytes of slice `z` of numbers with `size` bytes each.
pub(crate) fn slice(numbers: &[u8], z: usize, size: usize) -> Vec<u8> {
    numbers[12 * size * z..12 * size * (z + 1)].to_vec()
}

pub(crate) fn zlib(content: &[u8]) -> Vec<u8> {
    let mut encoder = flate2::write::ZlibEncoder::new(Vec::new(), flate2::Compression::fast());
    encoder.write_all(content).unwrap();
    encoder.finish().unwrap()
}

pub(crate) fn gzip(content: &[u8]) -> Vec<u8> {
    let mut encoder = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::fast());
    encoder.write_all(content).unwrap();
    encoder.finish().unwrap()
}

pub(crate) fn bzip2(content: &[u8]) -> Vec<u8> {
    let mut encoder = bzip2::write::BzEncoder::new(Vec::new(), bzip2::Compression::fast());
    encoder.write_all(content).unwrap();
    encoder.finish().unwrap()
}

/// A header of lines, with some of them replaced, and the numbers behind it.
pub(crate) fn header(base: &str, changes: &[(&str, &str)], numbers: &[u8]) -> Vec<u8> {
    let mut text = base.to_owned();
    for (from, to) in changes {
        assert!(text.contains(from), "{from}");
        text = text.replacen(from, to, 1);
    }
    [text.as_bytes(), numbers].concat()
}

pub(crate) const MHA: &str = "ObjectType = Image\nNDims = 3\nBinaryData = True\nBinaryDataByteOrderMSB = False\n\
    ElementSpacing = 0.5 0.75 1.25\nOffset = -3 7 0.5\nDimSize = 3 4 5\nElementType = MET_FLOAT\nElementDataFile = LOCAL\n";

pub(crate) const NRRD: &str = "NRRD0004\ntype: float\ndimension: 3\nsizes: 3 4 5\nspace: left-posterior-superior\n\
    space directions: (0.5,0,0) (0,0.75,0) (0,0,1.25)\nspace origin: (-3,7,0.5)\nendian: little\nencoding: raw\n\n";

/// Writes a number into a header.
pub(crate) fn put<const N: usize>(content: &mut [u8], at: usize, number: [u8; N]) {
    content[at..at + N].copy_from_slice(&number);
}

fn put_all<const N: usize>(content: &mut [u8], at: usize, numbers: impl IntoIterator<Item = [u8; N]>) {
    numbers.into_iter().enumerate().for_each(|(i, number)| put(content, at + N * i, number));
}

/// NIfTI-1 of 16-bit numbers with a changed header.
pub(crate) fn nifti(change: impl FnOnce(&mut Vec<u8>)) -> Vec<u8> {
    let mut file = vec![0; 352];
    put(&mut file, 0, 348_i32.to_le_bytes());
    put_all(&mut file, 40, [3_i16, 3, 4, 5, 1, 1, 1, 1].map(i16::to_le_bytes));
    put_all(&mut file, 70, [4_i16, 16].map(i16::to_le_bytes));
    put_all(&mut file, 76, [1.0_f32, 0.5, 0.75, 1.25, 1.0, 1.0, 1.0, 1.0].map(f32::to_le_bytes));
    put_all(&mut file, 108, [352.0_f32, 1.0, 0.0].map(f32::to_le_bytes));
    put_all(&mut file, 252, [1_i16, 1].map(i16::to_le_bytes));
    put_all(&mut file, 256, [0.0_f32, 0.0, 1.0, 3.0, -7.0, 0.5].map(f32::to_le_bytes));
    put_all(&mut file, 280, SROW.map(|x| (x as f32).to_le_bytes()));
    put(&mut file, 344, *b"n+1\0");
    file.extend(shorts());
    change(&mut file);
    file
}

const SROW: [f64; 12] = [-0.5, 0.0, 0.0, 3.0, 0.0, -0.75, 0.0, -7.0, 0.0, 0.0, 1.25, 0.5];

/// NIfTI-2 of 16-bit numbers, in either byte order.
pub(crate) fn nifti_2(big_endian: bool) -> Vec<u8> {
    let mut file = vec![0; 544];
    let ordered =
        |bytes: &[u8]| -> Vec<u8> { if big_endian { bytes.iter().rev().copied().collect() } else { bytes.to_vec() } };
    let mut set = |at: usize, bytes: &[u8]| file[at..at + bytes.len()].copy_from_slice(&ordered(bytes));
    set(0, &540_i32.to_le_bytes());
    set(12, &4_i16.to_le_bytes());
    set(14, &16_i16.to_le_bytes());
    (0..8).for_each(|i| set(16 + 8 * i, &[3_i64, 3, 4, 5, 1, 1, 1, 1][i].to_le_bytes()));
    (0..4).for_each(|i| set(104 + 8 * i, &[1.0_f64, 0.5, 0.75, 1.25][i].to_le_bytes()));
    set(168, &544_i64.to_le_bytes());
    set(348, &1_i32.to_le_bytes());
    SROW.iter().enumerate().for_each(|(i, x)| set(400 + 8 * i, &x.to_le_bytes()));
    file[4..12].copy_from_slice(b"n+2\0\r\n\x1a\n");
    file.extend(if big_endian { big_shorts() } else { shorts() });
    file
}

/// The values of a tag.
#[derive(Clone)]
pub(crate) enum Tag {
    Short(u16),
    Long(u32),
    Longs(Vec<u32>),
    Fraction(u32, u32),
    Text(&'static str),
}

/// The tags of a page of 4 rows and 3 columns; its numbers begin at `at`.
pub(crate) fn page(at: usize, bits: u16, format: u16) -> Vec<(u16, Tag)> {
    vec![
        (256, Tag::Long(3)),
        (257, Tag::Long(4)),
        (258, Tag::Short(bits)),
        (259, Tag::Short(1)),
        (262, Tag::Short(1)),
        (273, Tag::Long(at as u32)),
        (277, Tag::Short(1)),
        (278, Tag::Long(4)),
        (279, Tag::Long(12 * u32::from(bits) / 8)),
        (339, Tag::Short(format)),
    ]
}

/// The tags of a page with some changed or added.
pub(crate) fn with(mut page: Vec<(u16, Tag)>, changes: &[(u16, Tag)]) -> Vec<(u16, Tag)> {
    page.retain(|(tag, _)| !changes.iter().any(|(changed, _)| changed == tag));
    page.extend_from_slice(changes);
    page.sort_by_key(|(tag, _)| *tag);
    page
}

/// Position of the data in the files of [`tiff`].
pub(crate) const DATA: usize = 8;

/// A little-endian TIFF: data, then the directories of the pages.
pub(crate) fn tiff(data: &[u8], pages: &[Vec<(u16, Tag)>]) -> Vec<u8> {
    let mut file = [&b"II*\0\0\0\0\0"[..], data].concat();
    let mut link = 4;
    for tags in pages {
        let mut directory = (tags.len() as u16).to_le_bytes().to_vec();
        for (tag, values) in tags {
            let (kind, count, mut content) = match values {
                Tag::Short(value) => (3_u16, 1, value.to_le_bytes().to_vec()),
                Tag::Long(value) => (4, 1, value.to_le_bytes().to_vec()),
                Tag::Longs(values) => (4, values.len(), values.iter().flat_map(|value| value.to_le_bytes()).collect()),
                Tag::Fraction(above, below) => (5, 1, [above.to_le_bytes(), below.to_le_bytes()].concat()),
                Tag::Text(text) => (2, text.len() + 1, [text.as_bytes(), b"\0"].concat()),
            };
            if content.len() > 4 {
                file.extend_from_slice(&content);
                content = ((file.len() - content.len()) as u32).to_le_bytes().to_vec();
            }
            content.resize(4, 0);
            directory.extend(
                [&tag.to_le_bytes()[..], &kind.to_le_bytes(), &(count as u32).to_le_bytes(), &content].concat(),
            );
        }
        let at = file.len() as u32;
        put(&mut file, link, at.to_le_bytes());
        file.extend(directory);
        link = file.len();
        file.extend([0; 4]);
    }
    file
}

/// A PNG of the slice `z` in 8 or 16 bits, or in equal colours.
pub(crate) fn png(z: usize, is_wide: bool, colour: png::ColorType) -> Vec<u8> {
    let mut file = Vec::new();
    let mut encoder = png::Encoder::new(Cursor::new(&mut file), 3, 4);
    encoder.set_color(colour);
    encoder.set_depth(if is_wide { png::BitDepth::Sixteen } else { png::BitDepth::Eight });
    let numbers = slice(&bytes(), z, 1);
    let channels = colour.samples();
    let content: Vec<u8> = match (is_wide, channels) {
        (true, _) => numbers.iter().flat_map(|&byte| [0, byte]).collect(),
        (false, n) => numbers.iter().flat_map(|&byte| std::iter::repeat_n(byte, n)).collect(),
    };
    let mut writer = encoder.write_header().unwrap();
    writer.write_image_data(&content).unwrap();
    writer.finish().unwrap();
    file
}

/// An archive of arrays `[x, y, z]` with these names.
pub(crate) fn npz(names: &[&str]) -> Vec<u8> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.npz");
    let values = volume();
    let entries: Vec<_> =
        names.iter().map(|name| (*name, trgs::scan::npz::Entry::F32(values.view().into_dyn()))).collect();
    trgs::scan::npz::write(&path, &entries).unwrap();
    std::fs::read(path).unwrap()
}

/// A stack of ImageJ: one directory, and the numbers of five pages.
pub(crate) fn image_j() -> Vec<u8> {
    let text = "ImageJ=1.53t\nimages=5\nslices=5\nunit=mm\nspacing=1.25\n";
    let tags = [(270, Tag::Text(text)), (282, Tag::Fraction(2, 1)), (283, Tag::Fraction(4, 3))];
    tiff(&floats(), &[with(page(DATA, 32, 3), &tags)])
}

/// A TIFF of five pages packed by Zstandard.
pub(crate) fn zstd() -> Vec<u8> {
    let level = ruzstd::encoding::CompressionLevel::Fastest;
    let packed: Vec<Vec<u8>> =
        (0..5).map(|z| ruzstd::encoding::compress_to_vec(slice(&floats(), z, 4).as_slice(), level)).collect();
    let start = |z: usize| (DATA + packed[..z].iter().map(Vec::len).sum::<usize>()) as u32;
    let tags = |z: usize| {
        let changes = [(259, Tag::Short(50_000)), (273, Tag::Long(start(z))), (279, Tag::Long(packed[z].len() as u32))];
        with(page(DATA + 48 * z, 32, 3), &changes)
    };
    tiff(&packed.concat(), &(0..5).map(tags).collect::<Vec<_>>())
}
