//! Slabs of files against whole volumes.

use super::super::{read, write, write_slices, write_stored};
use super::*;
use glam::DVec3;
use ndarray::concatenate;
use std::fs;
use std::path::PathBuf;
use tempfile::TempDir;

const SHAPE: [usize; 3] = [3, 4, 5];
/// Files to write, each of its own order or packing.
const WRITTEN: [&str; 7] = ["a.npy", "a.mha", "a.nrrd", "a.nii", "a.nii.gz", "a.tif", "a_3x4x5_float32.raw"];

/// The number at a position.
fn number(i: usize) -> i16 {
    (i * 37 % 251) as i16
}

/// NumPy's file of a type, by the bytes of each number.
fn npy(kind: &str, is_fortran: bool, bytes: impl Fn(i16) -> Vec<u8>) -> Vec<u8> {
    let order = if is_fortran { "True" } else { "False" };
    let header = format!("{{'descr': '{kind}', 'fortran_order': {order}, 'shape': (3, 4, 5), }}\n");
    let begin = [b"\x93NUMPY\x01\0", &(header.len() as u16).to_le_bytes()[..], header.as_bytes()].concat();
    [begin, (0..60).flat_map(|i| bytes(number(i))).collect()].concat()
}

/// Files of every format with plain numbers, in every order and of three types each; those of other formats last.
fn sources() -> (TempDir, Vec<PathBuf>, usize) {
    let folder = tempfile::tempdir().unwrap();
    let mut paths = Vec::new();
    let mut put = |name: String, content: Vec<u8>| {
        fs::write(folder.path().join(&name), content).unwrap();
        paths.push(folder.path().join(name));
    };
    type Bytes = fn(i16) -> Vec<u8>;
    let types: [(&str, &str, &str, &str, Bytes); 3] = [
        ("<f4", "MET_FLOAT", "float", "float32", |n| (f32::from(n) / 8.0).to_le_bytes().into()),
        ("|u1", "MET_UCHAR", "uchar", "uint8", |n| vec![n as u8]),
        (">i2", "MET_SHORT", "short", "int16be", |n| (n - 99).to_be_bytes().into()),
    ];
    for (of_npy, of_meta, of_nrrd, of_raw, bytes) in types {
        let numbers: Vec<u8> = (0..60).flat_map(|i| bytes(number(i))).collect();
        let is_big = of_npy.starts_with('>');
        for is_fortran in [false, true] {
            put(format!("{of_raw}_{is_fortran}.npy"), npy(of_npy, is_fortran, bytes));
        }
        let place = "ElementSpacing = 1 2 3\nOffset = 1 0 -1\nDistanceUnits = um";
        let scale = "ElementToIntensityFunctionSlope = 0.5\nElementToIntensityFunctionOffset = 3";
        let meta = |more: &str| {
            let header =
                format!("NDims = 3\nDimSize = 3 4 5\nElementType = {of_meta}\nBinaryDataByteOrderMSB = {is_big}");
            format!("{header}\n{more}\n").into_bytes()
        };
        let here = meta(&format!("{place}\n{scale}\nElementDataFile = LOCAL"));
        put(format!("{of_raw}.mha"), [&here[..], &numbers, b"rest"].concat());
        put(format!("plain_3x4x5_{of_raw}.raw"), numbers.clone());
        put(format!("{of_raw}.mhd"), meta(&format!("ElementDataFile = plain_3x4x5_{of_raw}.raw")));
        let end = meta(&format!("HeaderSize = -1\nElementDataFile = plain_3x4x5_{of_raw}.raw"));
        put(format!("{of_raw}_end.mhd"), end);
        let endian = if is_big { "big" } else { "little" };
        let nrrd = format!(
            "NRRD0004\ntype: {of_nrrd}\ndimension: 3\nsizes: 3 4 5\nendian: {endian}\nencoding: raw\nspacings: 1 2 4\n"
        );
        put(format!("{of_raw}.nrrd"), [format!("{nrrd}\n").as_bytes(), &numbers].concat());
        put(format!("{of_raw}.nhdr"), format!("{nrrd}data file: plain_3x4x5_{of_raw}.raw\n").into());
    }
    put("bool.npy".into(), npy("|b1", true, |n| vec![u8::from(n > 99)]));
    put("long.npy".into(), npy(">u8", false, |n| (n as u64 * 77_777_777_777).to_be_bytes().into()));
    put("half.npy".into(), npy("<f2", false, |n| half::f16::from_f32(f32::from(n)).to_le_bytes().into()));
    let sides = r#"{"shape": [3, 4, 5], "spacing": [1, 2, 3], "origin": [0, 1, 0], "unit": "um"}"#;
    fs::write(folder.path().join("half.npy.json"), sides).unwrap();
    let values = Array3::from_shape_fn(SHAPE, |(x, y, z)| number(20 * x + 5 * y + z).into());
    let volume = VolumeFile { values, spacing: Some(DVec3::new(1.0, 2.0, 0.5)), ..VolumeFile::default() };
    write(folder.path().join("placed.nii"), &volume).unwrap();
    let mut short = fs::read(folder.path().join("placed.nii")).unwrap();
    // Numbers of 32 bits with a slope, and a byte more.
    short[70] = 8;
    short[112..116].copy_from_slice(&1e-9_f32.to_le_bytes());
    put("scaled.nii".into(), [&short[..], &[0]].concat());
    paths.push(folder.path().join("placed.nii"));
    let plain = paths.len();
    for name in ["packed.nii.gz", "pages.tif"] {
        write(folder.path().join(name), &volume).unwrap();
        paths.push(folder.path().join(name));
    }
    (folder, paths, plain)
}

#[test]
fn slabs_of_every_file_are_those_of_the_whole_volume() {
    let (_folder, paths, plain) = sources();
    for (i, path) in paths.iter().enumerate() {
        let whole = read(path).unwrap();
        for most in [1, 2, usize::MAX] {
            let open = || Stored { most, ..open(path).unwrap() };
            assert_eq!(matches!(open().numbers, Numbers::File(_)), i < plain, "{}", path.display());
            for (axis, count) in SHAPE.into_iter().enumerate() {
                let mut slabs = Vec::new();
                let mut keep = |first, slab| {
                    slabs.push((first, slab));
                    Ok(())
                };
                open().each(axis, &mut keep).unwrap();
                assert_eq!(slabs.len(), count.div_ceil(most.min(count)), "{}", path.display());
                assert!(slabs.iter().enumerate().all(|(i, (first, _))| *first == i * most.min(count)));
                let views: Vec<_> = slabs.iter().map(|(_, slab): &(_, Array3<f32>)| slab.view()).collect();
                assert_eq!(concatenate(Axis(axis), &views).unwrap(), whole.values, "{}", path.display());
            }
            assert_eq!(open().whole().unwrap(), whole, "{}", path.display());
        }
    }
}

/// A folder of slices of each kind, with a gap and an image of another kind.
fn folders() -> (TempDir, Vec<PathBuf>) {
    let folder = tempfile::tempdir().unwrap();
    let values = Array3::from_shape_fn(SHAPE, |(x, y, z)| number(20 * x + 5 * y + z).into());
    let volume = VolumeFile { values, ..VolumeFile::default() };
    let paths = ["png", "tif"].map(|kind| {
        let path = folder.path().join(kind);
        fs::create_dir(&path).unwrap();
        write_slices(&path, &volume, super::super::Slices::Png).unwrap();
        path
    });
    for z in 0..SHAPE[2] {
        let slice = volume.values.slice_axis(Axis(2), Slice::from(z..=z)).to_owned();
        // Not in the order of letters.
        let name = format!("s{}.tif", z + 8 + z / 4);
        write(paths[1].join(name), &VolumeFile { values: slice, ..VolumeFile::default() }).unwrap();
    }
    (folder, paths.into())
}

#[test]
fn slabs_of_folders_are_those_of_the_whole_volume() {
    let (folder, paths) = folders();
    for path in &paths {
        let whole = read(path).unwrap();
        assert_eq!(whole.oddities.len(), if path.ends_with("tif") { 2 } else { 0 });
        // What fits in memory is read once.
        assert!(matches!(open(path).unwrap().numbers, Numbers::Memory(_)) && of_folder(path, 240).unwrap().is_none());
        let open = |most| Stored { most, ..of_folder(path, 239).unwrap().unwrap() };
        assert_eq!(open(1).metadata(), &VolumeFile { values: Array3::zeros((3, 4, 0)), ..whole.clone() });
        for (axis, count) in SHAPE.into_iter().enumerate() {
            let mut slabs = Vec::new();
            let mut keep = |_, slab| {
                slabs.push(slab);
                Ok(())
            };
            open(2).each(axis, &mut keep).unwrap();
            assert_eq!(slabs.len(), count.div_ceil(2));
            let views: Vec<_> = slabs.iter().map(|slab: &Array3<f32>| slab.view()).collect();
            assert_eq!(concatenate(Axis(axis), &views).unwrap(), whole.values);
        }
        assert_eq!(open(1).whole().unwrap(), whole);
        for name in ["a.npy", "a.nii"] {
            let [by_slabs, at_once] = ["slabs", "whole"].map(|part| folder.path().join(format!("{part}-{name}")));
            write_stored(&by_slabs, open(1)).unwrap();
            write(&at_once, &whole).unwrap();
            assert!(fs::read(by_slabs).unwrap() == fs::read(at_once).unwrap());
        }
    }
    // A slice of another size is an error before anything is written; one that is cut later, when it is read.
    let mut stored = of_folder(&paths[1], 0).unwrap().unwrap();
    let other = VolumeFile { values: Array3::zeros((3, 3, 1)), ..VolumeFile::default() };
    write(paths[1].join("s9.tif"), &other).unwrap();
    let message = read(&paths[1]).unwrap_err().to_string();
    assert_eq!(of_folder(&paths[1], 0).err().unwrap().to_string(), message);
    assert!(matches!(stored.slab(2, 1..2), Err(Error::Format { .. })) && stored.slab(2, 2..3).is_ok());
}

#[test]
fn files_written_by_slabs_have_the_bytes_of_those_written_whole() {
    let (folder, paths, _) = sources();
    let at = |name: &str| folder.path().join(name);
    fs::create_dir(at("slabs")).unwrap();
    for (i, path) in paths.iter().enumerate() {
        let whole = read(path).unwrap();
        // All formats for each order of the first files, then in turn: each file is brought to the disk.
        let written = WRITTEN.iter().enumerate().filter(|(k, _)| i < 3 || i % WRITTEN.len() == *k);
        for (k, name) in written {
            write(at(name), &whole).unwrap();
            let most = 1 + k % 2;
            write_stored(at("slabs").join(name), Stored { most, ..open(path).unwrap() }).unwrap();
            assert!(fs::read(at("slabs").join(name)).unwrap() == fs::read(at(name)).unwrap(), "{path:?} {name}");
        }
    }
    // The file that is read is replaced.
    let name = at("slabs").join("a.nrrd");
    fs::copy(at("int16be.nrrd"), &name).unwrap();
    write(at("whole.nrrd"), &read(&name).unwrap()).unwrap();
    write_stored(&name, Stored { most: 1, ..open(&name).unwrap() }).unwrap();
    assert!(fs::read(&name).unwrap() == fs::read(at("whole.nrrd")).unwrap());
}

#[test]
fn damaged_files_have_the_errors_of_whole_reading() {
    let (folder, paths, plain) = sources();
    for path in &paths[..plain] {
        let content = fs::read(path).unwrap();
        let name = path.file_name().unwrap();
        for length in [0, 9, 40, content.len() - 5] {
            let path = folder.path().join("cut").join(name);
            fs::create_dir_all(folder.path().join("cut")).unwrap();
            fs::write(&path, &content[..length]).unwrap();
            let [by_slabs, whole] =
                [open(&path).and_then(Stored::whole), read(&path)].map(|read| read.map_err(|error| error.to_string()));
            assert!(whole.is_err() && by_slabs == whole, "{path:?} {length}: {by_slabs:?} {whole:?}");
        }
    }
    let mut wrong = fs::read(folder.path().join("bool.npy")).unwrap();
    *wrong.last_mut().unwrap() = 7;
    let path = folder.path().join("wrong.npy");
    fs::write(&path, wrong).unwrap();
    let message = read(&path).unwrap_err().to_string();
    let out = folder.path().join("wrong.mha");
    assert_eq!(write_stored(&out, open(&path).unwrap()).unwrap_err().to_string(), message);
    assert!(!out.exists());
    // Its length fits, but it is cut while it is read.
    let path = folder.path().join("uint8.nrrd");
    let mut stored = open(&path).unwrap();
    fs::OpenOptions::new().write(true).open(&path).unwrap().set_len(120).unwrap();
    assert!(matches!(stored.slab(2, 4..5), Err(Error::Format { .. })));
}
