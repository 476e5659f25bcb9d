//! Small files that claim gigabytes: by counts, by parts that share their bytes, and by names that occur often.
//!
//! They are refused with the numbers, and given little memory.

use crate::damage::MOST_MEMORY;
use crate::formats::build::{self, Tag};
use std::io::Write;
use std::path::Path;
use tiff::decoder::Decoder;
use trgs::scan::npz::Npz;
use trgs::scan::stack::RtkGeometry;
use trgs::scan::volume_file;
use zip::write::SimpleFileOptions;

/// The message about a file, which is given at most [`MOST_MEMORY`].
fn refused<T>(what: &str, read: impl FnOnce() -> trgs::Result<T>) -> String {
    let mut message = String::new();
    let memory = allocation_counter::measure(|| message = read().map(|_| ()).expect_err(what).to_string());
    assert!(memory.bytes_max <= MOST_MEMORY, "{what}: {} bytes of memory: {message}", memory.bytes_max);
    assert!(!message.contains('\n'), "{message}");
    message
}

fn volume(content: &[u8], path: &Path) -> String {
    refused(&path.display().to_string(), || volume_file::parse(content, path))
}

#[test]
fn files_that_a_header_counts_are_looked_for_one_by_one() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    const SLICES: u64 = 1_000_000_000_000;
    let mhd = |shape: &str, files: &str| {
        format!("NDims = 3\nDimSize = {shape}\nElementType = MET_UCHAR\nElementDataFile = {files}")
    };
    let nhdr = |shape: &str, files: &str| {
        format!("NRRD0004\ntype: uchar\ndimension: 3\nsizes: {shape}\nencoding: raw\ndata file: {files}\n")
    };
    let (shape, pattern) = (format!("1 1 {SLICES}"), format!("s%d.raw 0 {} 1", SLICES - 1));
    let missing = [("a.mhd", mhd(&shape, &pattern)), ("a.nhdr", nhdr(&shape, &pattern))];
    for (name, text) in &missing {
        let message = volume(text.as_bytes(), &at(name));
        assert!(message.contains("\"s0.raw\", which does not exist"), "{message}");
    }
    // The first file is there: so many of them fit into no memory.
    std::fs::write(at("s0.raw"), [7]).unwrap();
    for (name, text) in &missing {
        let message = volume(text.as_bytes(), &at(name));
        assert!(message.contains("1000000000000 files") && message.contains("TiB"), "{message}");
    }
    // A name of two bytes for a megabyte each.
    std::fs::write(at("s0.raw"), vec![7; 1 << 20]).unwrap();
    let list = format!("LIST\n{}", "s0.raw\n./s0.raw\n".repeat(500));
    for (name, text) in [("a.mhd", mhd("1024 1024 1000", &list)), ("a.nhdr", nhdr("1024 1024 1000", &list))] {
        let message = volume(text.as_bytes(), &at(name));
        assert!(message.contains("./s0.raw\" twice, expected different files"), "{message}");
    }
}

#[test]
fn a_jpeg_has_no_more_pixels_than_its_bytes_can_hold() {
    // The size follows the mark of the frame, its length and its bits.
    let mut jpeg = include_bytes!("../data/grey.jpg").to_vec();
    let frame = jpeg.windows(2).position(|pair| pair == [0xff, 0xc0] || pair == [0xff, 0xc2]).unwrap();
    jpeg[frame + 5..frame + 9].copy_from_slice(&[0x3e, 0x80, 0x3e, 0x80]);
    let message = volume(&jpeg, Path::new("a.jpg"));
    assert!(message.contains("16000 rows and 16000 columns in ") && message.contains("pixels at most"), "{message}");
}

/// A TIFF of bytes with `strips` strips of 1000 rows of 1000 columns that are the same bytes.
fn sharing(packing: u16, packed: &[u8], strips: usize) -> Vec<u8> {
    let changes = [
        (256, Tag::Long(1000)),
        (257, Tag::Long(1000 * strips as u32)),
        (259, Tag::Short(packing)),
        (278, Tag::Long(1000)),
        (273, Tag::Longs(vec![build::DATA as u32; strips])),
        (279, Tag::Longs(vec![packed.len() as u32; strips])),
    ];
    build::tiff(packed, &[build::with(build::page(build::DATA, 8, 1), &changes)])
}

#[test]
fn strips_that_share_their_bytes_are_not_unpacked_each() {
    let zeros = vec![0; 1_000_000];
    let zstd = ruzstd::encoding::compress_to_vec(zeros.as_slice(), ruzstd::encoding::CompressionLevel::Fastest);
    let lzw = weezl::encode::Encoder::with_tiff_size_switch(weezl::BitOrder::Msb, 8).encode(&zeros).unwrap();
    for (packing, packed) in [(50_000, zstd), (5, lzw)] {
        let one = volume_file::parse(&sharing(packing, &packed, 1), Path::new("a.tif")).unwrap();
        assert_eq!((one.values.dim(), one.values.sum()), ((1000, 1000, 1), 0.0));
        // Each strip takes eight bytes of the lists.
        let strips = if packing == 5 { 1000 } else { 120 };
        let file = sharing(packing, &packed, strips);
        let mut message = String::new();
        let memory = allocation_counter::measure(|| {
            message = volume_file::parse(&file, Path::new("a.tif")).unwrap_err().to_string();
        });
        assert!(message.contains("strips that share their bytes"), "{message}");
        // What the file could expand to without sharing.
        let most = if packing == 5 { 2732 * file.len() } else { MOST_MEMORY as usize };
        assert!(memory.bytes_max <= most as u64 + (8 << 20), "{} bytes for {}", memory.bytes_max, file.len());
    }
}

#[test]
fn entries_that_share_their_bytes_are_refused() {
    let mut file = Vec::new();
    let mut archive = zip::ZipWriter::new(std::io::Cursor::new(&mut file));
    let options = SimpleFileOptions::default().compression_method(zip::CompressionMethod::Deflated);
    archive.start_file("a00.npy", options).unwrap();
    let header = format!("{:117}\n", "{'descr': '<f4', 'fortran_order': False, 'shape': (1000000, ), }");
    archive.write_all(&[&b"\x93NUMPY\x01\x00\x76\x00"[..], header.as_bytes(), &vec![0; 4_000_000]].concat()).unwrap();
    archive.finish().unwrap();
    assert_eq!(Npz::parse(&file, Path::new("a.npz")).unwrap().keys().count(), 1);
    // The record of the entry again under other names.
    let at = |mark: &[u8]| file.windows(4).rposition(|four| four == mark).unwrap();
    let (record, end) = (at(b"PK\x01\x02"), at(b"PK\x05\x06"));
    let mut many = file[..record].to_vec();
    for i in 0..60 {
        let mut entry = file[record..end].to_vec();
        let name = entry.windows(7).position(|name| name == b"a00.npy").unwrap();
        entry[name..name + 3].copy_from_slice(format!("a{i:02}").as_bytes());
        many.extend(entry);
    }
    let size = (many.len() - record) as u32;
    let mut tail = file[end..].to_vec();
    tail[8..12].copy_from_slice(&[60, 0, 60, 0]);
    tail[12..16].copy_from_slice(&size.to_le_bytes());
    many.extend(tail);
    let message = refused("archive", || Npz::parse(&many, Path::new("a.npz")));
    assert!(message.contains("a.npz: a01.npy: got the bytes of a00.npy again"), "{message}");
}

#[test]
fn entities_of_xml_are_not_expanded() {
    let entity = format!("<!DOCTYPE RTKGEOMETRY [<!ENTITY a \"{}\">]>", "1".repeat(100_000));
    let text = format!("{entity}<RTKThreeDCircularGeometry>{}</RTKThreeDCircularGeometry>", "&a;".repeat(20_000));
    let message = refused("geometry", || RtkGeometry::parse(&text));
    assert!(message.contains("entities"), "{message}");
}

/// A tiled TIFF of 16-bit numbers packed by LZW, which differ and do not pack well.
fn tiled(rows: usize, columns: usize, number: impl Fn(usize, usize) -> u16) -> Vec<u8> {
    const SIDE: usize = 16;
    let (mut data, mut places, mut sizes) = (Vec::new(), Vec::new(), Vec::new());
    for top in (0..rows).step_by(SIDE) {
        for left in (0..columns).step_by(SIDE) {
            let pixel = |i: usize| {
                let (row, column) = (top + i / SIDE, left + i % SIDE);
                if row < rows && column < columns { number(row, column) } else { 0 }
            };
            let tile: Vec<u8> = (0..SIDE * SIDE).flat_map(|i| pixel(i).to_le_bytes()).collect();
            let packed = weezl::encode::Encoder::with_tiff_size_switch(weezl::BitOrder::Msb, 8).encode(&tile).unwrap();
            places.push((build::DATA + data.len()) as u32);
            sizes.push(packed.len() as u32);
            data.extend(packed);
        }
    }
    let tags = vec![
        (256, Tag::Long(columns as u32)),
        (257, Tag::Long(rows as u32)),
        (258, Tag::Short(16)),
        (259, Tag::Short(5)),
        (262, Tag::Short(1)),
        (277, Tag::Short(1)),
        (322, Tag::Long(SIDE as u32)),
        (323, Tag::Long(SIDE as u32)),
        (324, Tag::Longs(places)),
        (325, Tag::Longs(sizes)),
        (339, Tag::Short(1)),
    ];
    build::tiff(&data, &[tags])
}

#[test]
fn tiles_packed_by_lzw_are_read_whatever_their_padding() {
    let mut refused = 0;
    for columns in 17..=32 {
        for noise in [1, 7, 4093] {
            let number = |row: usize, column: usize| ((row * 7919 + column * 104_729) % noise * 13 + row) as u16;
            let file = tiled(20, columns, number);
            let read = volume_file::parse(&file, Path::new("a.tif")).unwrap();
            assert_eq!(read.values.dim(), (columns, 20, 1));
            read.values.indexed_iter().for_each(|((x, y, _), value)| assert_eq!(*value, f32::from(number(y, x))));
            refused += usize::from(Decoder::new(std::io::Cursor::new(&file)).unwrap().read_image().is_err());
        }
    }
    eprintln!("the library alone refuses {refused} of 48 files");
}
