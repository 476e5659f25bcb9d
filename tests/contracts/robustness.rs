//! Arbitrary bytes in every file reader and text parser: a value or one clear line, never a panic.
//!
//! A size claimed by a header allocates no memory by itself.
//!
//! Proptest generates the bytes with a fixed seed (`tests/contracts/damage.rs`); `cargo fuzz` needs a nightly compiler.
//! DICOM is tested in `src/scan/volume_file/dicom`, extreme numbers in `tests/contracts/extremes.rs`.

use crate::damage::{MANY, MOST_MEMORY, assert_clear, assert_reader_survives, damaged, for_all};
use crate::formats::build;
use glam::DVec3;
use ndarray::{Array1, Array2, Array3};
use proptest::collection::vec;
use proptest::prelude::*;
use std::io::Cursor;
use std::path::Path;
use tempfile::TempDir;
use tiff::encoder::colortype::{Gray8, Gray16, Gray32Float};
use tiff::encoder::{Compression, DeflateLevel, Predictor, TiffEncoder};
use trgs::config::{Config, Method};
use trgs::geometry::{Beam, Detector, Grid, Scanner};
use trgs::primitives::{Parameters, Primitives};
use trgs::scan::dataset::{Dataset, Description};
use trgs::scan::model;
use trgs::scan::noise::Noise;
use trgs::scan::npz::{Entry, Npz};
use trgs::scan::phantom::Phantom;
use trgs::scan::simulate::{Object, Plan, simulate};
use trgs::scan::stack::parse_angles;
use trgs::scan::volume_file::{self, SideFile, VolumeFile};
use trgs::scan::{Frame, npy, npz};

/// Number of cases for parsers of text and for readers that need a disk.
const FEW: u32 = 400;

fn bytes_of(name: &str, write: impl FnOnce(&Path)) -> Vec<u8> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join(name);
    write(&path);
    std::fs::read(&path).unwrap()
}

fn small_npy() -> Vec<u8> {
    let values = Array3::from_shape_fn((2, 3, 4), |(x, y, z)| (x + 2 * y) as f32 - 0.5 * z as f32);
    bytes_of("a.npy", |path| npy::write(path, values.view()).unwrap())
}

#[test]
fn damaged_arrays_are_clear_errors() {
    assert_reader_survives("array.npy", MANY, &small_npy(), npy::parse);
}

fn small_npz() -> Vec<u8> {
    let (a, b) = (Array2::from_elem((3, 2), 0.7_f32).into_dyn(), Array1::from_elem(5, -1.5_f64).into_dyn());
    let entries = [("first", Entry::F32(a.view())), ("second", Entry::F64(b.view()))];
    bytes_of("a.npz", |path| npz::write(path, &entries).unwrap())
}

#[test]
fn damaged_archives_are_clear_errors() {
    assert_reader_survives("archive.npz", MANY, &small_npz(), Npz::parse);
}

#[test]
fn damaged_models_are_clear_errors() {
    let parameters = Parameters {
        mean: vec![[0.1, -0.2, 0.3]; 2],
        scale: vec![[0.1, 0.2, 0.3]; 2],
        quaternion: vec![[1.0, 0.2, -0.3, 0.4]; 2],
        density: vec![0.5, -0.1],
        nu: vec![3.0, 50.0],
    };
    let valid = bytes_of("a.npz", |path| model::write(path, &parameters).unwrap());
    assert_reader_survives("MODEL.npz", MANY, &valid, model::parse);
    let primitives = Primitives::new(parameters).unwrap();
    let valid =
        bytes_of("a.ply", |path| model::ply::write(path, &primitives, Some(&[0.0, 1.0]), &Frame::default()).unwrap());
    assert_reader_survives("model.ply", MANY, &valid, model::parse);
    assert_reader_survives("ascii.ply", MANY, ASCII_PLY, model::parse);
    let primitives =
        Primitives { parameters: Parameters { density: vec![0.5; 2], ..primitives.parameters }, ..primitives };
    let valid = bytes_of("a.npz", |path| model::r2::write(path, &primitives).unwrap());
    assert_reader_survives("point_cloud.npz", MANY, &valid, model::parse);
    assert_reader_survives("point_cloud.pickle", MANY, POINT_CLOUD, model::parse);
}

/// A PLY with all kinds of properties.
const ASCII_PLY: &[u8] = b"ply\nformat ascii 1.0\nelement edge 1\nproperty list uchar int ends\nelement vertex 2\n\
    property float x\nproperty float y\nproperty float z\nproperty double scale_x\nproperty float scale_y\n\
    property float scale_z\nproperty int rotation_w\nproperty char rotation_x\nproperty short rotation_y\n\
    property int rotation_z\nproperty float density\nproperty float nu\nproperty uchar red\nend_header\n2 0 1\n\
    1 2 3 0.5 0.25 4 1 0 0 -1 0.125 5 7\n0.1 0.2 0.3 0.5 0.25 4 1 0 0 -1 0.125 50 255\n";

/// A point cloud of R²-Gaussian.
const POINT_CLOUD: &[u8] = include_bytes!("../data/point_cloud.pickle");

/// A small scan in a temporary folder.
fn scan() -> TempDir {
    let folder = tempfile::tempdir().unwrap();
    let scanner = Scanner {
        beam: Beam::Cone { dso: 5.0, dsd: 7.0 },
        detector: Detector { rows: 5, columns: 6, pitch_v: 0.8, pitch_u: 0.7, offset_u: 0.1, offset_v: 0.0 },
        grid: Grid::cube(4),
    };
    let plan = Plan { views: 3, test_views: 2, noise: Noise::LOW, seed: 1 };
    let phantom = Phantom::by_name("axes", 0).unwrap();
    simulate("scan", Object::Phantom(&phantom), &scanner, &plan).unwrap().write(&folder.path().join("scan")).unwrap();
    folder
}

#[test]
fn damaged_descriptions_of_scanners_are_clear_errors() {
    let folder = scan();
    let valid = std::fs::read(folder.path().join("scan/meta_data.json")).unwrap();
    assert_reader_survives("meta_data.json", MANY, &valid, Description::parse);
}

#[test]
fn damaged_lists_of_angles_are_clear_errors() {
    assert_reader_survives("angles.txt", MANY, b"# degrees\n0, 45.5, 90\n135;-180 # end\n", parse_angles);
    assert_reader_survives("angles.csv", MANY, b"view,\"angle\",time\n0,1.5,9:00\n1,-3e-1,9:01\n", parse_angles);
}

#[test]
fn scans_with_any_damaged_file_are_clear_errors() {
    let folder = scan();
    let scan = folder.path().join("scan");
    Dataset::read(&scan).unwrap();
    for file in ["meta_data.json", "vol_gt.npy", "proj_train/proj_train_0001.npy", "proj_test/proj_test_0000.npy"] {
        let path = scan.join(file);
        let valid = std::fs::read(&path).unwrap();
        for_all(FEW / 2, &damaged(valid.clone()), |bytes| {
            std::fs::write(&path, bytes).unwrap();
            assert_clear(Dataset::read(&scan), "scan");
        });
        std::fs::write(&path, valid).unwrap();
    }
    Dataset::read(&scan).unwrap();
}

/// A volume in the format of a file name.
fn small_volume(name: &str) -> Vec<u8> {
    let values = Array3::from_shape_fn((3, 4, 5), |(x, y, z)| (x + y * z) as f32);
    let volume = VolumeFile { values, spacing: Some(DVec3::splat(0.5)), ..VolumeFile::default() };
    bytes_of(name, |path| volume_file::write(path, &volume).unwrap())
}

/// Volumes in forms that this program does not write.
fn odd_volumes() -> Vec<(&'static str, Vec<u8>)> {
    let encoded = |encoding: &str, numbers: &[u8]| {
        build::header(build::NRRD, &[("encoding: raw", &format!("encoding: {encoding}"))], numbers)
    };
    vec![
        ("bzip2.nrrd", encoded("bzip2", &build::bzip2(&build::floats()))),
        ("gzip.nrrd", encoded("gzip", &build::gzip(&build::floats()))),
        ("text.nrrd", encoded("ascii", &build::text())),
        ("second.nii", build::nifti_2(true)),
        ("volume.npz", build::npz(&["vol"])),
        ("slice.png", build::png(0, true, png::ColorType::Grayscale)),
        ("slice.jpg", include_bytes!("../data/grey.jpg").to_vec()),
        ("stack.tif", build::image_j()),
        ("zstd.tif", build::zstd()),
    ]
}

#[test]
fn damaged_volumes_of_every_format_are_clear_errors() {
    for name in ["a.mha", "a.nrrd", "a.nii", "a.nii.gz"] {
        assert_reader_survives(name, MANY, &small_volume(name), volume_file::parse);
    }
    for (name, valid) in odd_volumes() {
        assert_reader_survives(name, MANY / 4, &valid, volume_file::parse);
    }
    let detached = b"NDims = 3\nDimSize = 2 2 1\nElementType = MET_UCHAR\nElementDataFile = LOCAL\n1234";
    assert_reader_survives("a.mhd", MANY, detached, volume_file::parse);
    // For raw numbers only the length can be wrong.
    assert_reader_survives("a_3x4x5_float32.raw", MANY, &small_volume("a_3x4x5_float32.raw"), volume_file::parse);
}

#[test]
fn damaged_headers_that_name_files_are_clear_errors() {
    let folder = tempfile::tempdir().unwrap();
    for header in ["a.mhd", "a.nhdr"] {
        // An error may be about a file that the header names.
        let names: Vec<String> = (0..5).map(|z| format!("{header}.s{z}.raw")).collect();
        for (z, name) in names.iter().enumerate() {
            std::fs::write(folder.path().join(name), build::slice(&build::floats(), z, 4)).unwrap();
        }
        for list in [format!("LIST\n{}\n", names.join("\n")), format!("{header}.s%1d.raw 0 4 1")] {
            let valid = match header {
                "a.mhd" => build::header(build::MHA, &[("LOCAL", &list)], &[]),
                _ => build::header(build::NRRD, &[("raw\n\n", &format!("raw\ndata file: {list}\n"))], &[]),
            };
            assert_reader_survives(header, FEW, &valid, |bytes, path| {
                volume_file::parse(bytes, &folder.path().join(path))
            });
        }
    }
}

#[test]
fn damaged_side_files_are_clear_errors() {
    let valid = br#"{"shape": [2, 3, 4], "type": "uint16", "byte_order": "big", "spacing": [0.5, 1, 2],
        "origin": [0, -1.5, 1e3], "skip_bytes": 2}"#;
    let numbers = [7_u8; 50];
    assert_reader_survives("a.raw", MANY, valid, |text, path| SideFile::parse(text, path)?.volume(&numbers, path));
}

/// Two pages of each number type and compression.
fn small_tiffs() -> Vec<Vec<u8>> {
    let values: Vec<u16> = (0..30).map(|i| 100 * i).collect();
    let (bytes, floats): (Vec<u8>, Vec<f32>) = values.iter().map(|&v| ((v / 100) as u8, f32::from(v) - 0.5)).unzip();
    let packings = [
        (Compression::Uncompressed, Predictor::None),
        (Compression::Lzw, Predictor::Horizontal),
        (Compression::Deflate(DeflateLevel::Fast), Predictor::None),
        (Compression::Packbits, Predictor::None),
    ];
    let file = |(packing, predictor)| {
        let mut file = Cursor::new(Vec::new());
        let mut encoder = TiffEncoder::new(&mut file).unwrap().with_compression(packing);
        match packing {
            Compression::Lzw => {
                encoder = encoder.with_predictor(predictor);
                (0..2).for_each(|_| encoder.write_image::<Gray16>(6, 5, &values).unwrap());
            }
            Compression::Uncompressed => {
                (0..2).for_each(|_| encoder.write_image::<Gray32Float>(6, 5, &floats).unwrap());
            }
            _ => (0..2).for_each(|_| encoder.write_image::<Gray8>(6, 5, &bytes).unwrap()),
        }
        file.into_inner()
    };
    packings.into_iter().map(file).collect()
}

#[test]
fn damaged_tiffs_are_clear_errors() {
    for valid in small_tiffs() {
        assert_reader_survives("pages.tif", MANY / 4, &valid, volume_file::parse);
    }
}

fn pickle(protocol: u32) -> Vec<u8> {
    std::fs::read(format!("{}/tests/data/naf_{protocol}.pickle", env!("CARGO_MANIFEST_DIR"))).unwrap()
}

#[test]
fn damaged_pickles_are_clear_errors() {
    for protocol in 2..=5 {
        assert_reader_survives("scan.pickle", MANY / 4, &pickle(protocol), Dataset::parse_pickle);
    }
}

/// Replaces bytes of small files by large numbers: two, four and eight bytes, and digits of headers.
#[test]
fn files_that_claim_gigabytes_are_given_no_memory() {
    type Reader = fn(&[u8], &Path) -> bool;
    let volume: Reader = |bytes, path| assert_clear(volume_file::parse(bytes, path), "a.");
    let model: Reader = |bytes, path| assert_clear(model::parse(bytes, path), "a.");
    let mut files: Vec<(&str, Vec<u8>, Reader)> = vec![
        ("a.npy", small_npy(), |bytes, path| assert_clear(npy::parse(bytes, path), "a.")),
        ("a.npz", small_npz(), |bytes, path| assert_clear(Npz::parse(bytes, path), "a.")),
        ("a.pickle", pickle(4), |bytes, path| assert_clear(Dataset::parse_pickle(bytes, path), "a.")),
        ("a.pickle", POINT_CLOUD.into(), model),
        ("a.ply", ASCII_PLY.into(), model),
    ];
    files.extend(["a.mha", "a.nrrd", "a.nii", "a.nii.gz"].map(|name| (name, small_volume(name), volume)));
    let odd: Reader = |bytes, path| assert_clear(volume_file::parse(bytes, path), ".");
    files.extend(odd_volumes().into_iter().map(|(name, content)| (name, content, odd)));
    files.extend(small_tiffs().into_iter().map(|tiff| ("a.tif", tiff, volume)));
    for (name, valid, read) in files {
        let path = Path::new(name);
        assert!(read(&valid, path), "{name}");
        let check = |bytes: &[u8]| {
            let memory = allocation_counter::measure(|| {
                read(bytes, path);
            });
            assert!(memory.bytes_max <= MOST_MEMORY, "{name}: {} bytes for {bytes:?}", memory.bytes_max);
        };
        for at in 0..valid.len() {
            for claim in [u64::MAX, 0x7f7f_7f7f_7f7f_7f7f, 1 << 28, 1 << 36, 0] {
                for size in [2, 4, 8] {
                    for number in [claim.to_le_bytes(), (claim << (64 - 8 * size)).to_be_bytes()] {
                        let mut bytes = valid.clone();
                        bytes.iter_mut().skip(at).zip(&number[..size]).for_each(|(byte, new)| *byte = *new);
                        check(&bytes);
                    }
                }
            }
            if valid[at].is_ascii_digit() {
                let mut bytes = valid.clone();
                bytes.splice(at..=at, *b"99999");
                check(&bytes);
            }
        }
    }
}

#[test]
fn damaged_configurations_are_clear_errors() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("config.toml");
    let valid = Config::default().to_toml().into_bytes();
    assert_reader_survives("config.toml", FEW, &valid, |text, path| {
        std::fs::write(&file, text).unwrap();
        let config = Config::read(&file, Method::TrGs)?;
        config.validate().map_err(|error| error.in_file(path))
    });
}

#[test]
fn any_text_for_a_setting_or_for_noise_is_a_value_or_a_clear_error() {
    let word = prop::sample::select(
        &[
            "loss.tv", "seed", "=", "1e5", ",", "-", "inf", "nan", "[", "]", "\"", "\n", " ", "model", ".", "é", "{",
            "low",
        ][..],
    );
    let text = prop_oneof![
        vec(word, 0..8).prop_map(|words| words.concat()),
        vec(any::<char>(), 0..12).prop_map(|chars| chars.into_iter().collect::<String>()),
        (-400..400_i32, -400..400_i32).prop_map(|(a, b)| format!("1e{a},{b}")),
    ];
    for_all(4 * FEW, &text, |text| {
        let mut config = Config::default();
        assert_clear(config.set(&text), "");
        assert_clear(text.parse::<Noise>(), "noise");
        assert_clear(Phantom::by_name(&text, 0).map(|_| ()), "phantom");
    });
}

#[test]
fn a_header_that_claims_gigabytes_is_given_no_memory() {
    const CLAIMED: u64 = 8 << 30;
    let path = Path::new("a.npy");
    let check = |bytes: &[u8]| {
        let memory = allocation_counter::measure(|| {
            assert!(!assert_clear(npy::parse(bytes, path), "a.npy"), "taken: {bytes:?}")
        });
        assert!(memory.bytes_max <= MOST_MEMORY, "{} bytes for a file of {}", memory.bytes_max, bytes.len());
    };
    let shape = prop_oneof![
        (CLAIMED..u64::MAX).prop_map(|n| format!("({n},)")),
        (1..10_000_u64).prop_map(|n| format!("({n}, {})", CLAIMED / n)),
        (1..10_000_u64).prop_map(|n| format!("({n}, 0, {})", u64::MAX / n)),
        (CLAIMED..1_u64 << 40).prop_map(|n| format!("(1, {n}, 1, 1)")),
    ];
    let claims = (shape, prop::sample::select(&["<f4", "<f8", "|u1", "<i8", "|b1", "<V1000000", "|S9999999999"][..]));
    for_all(FEW, &claims, |(shape, kind)| {
        let text = format!("{{'descr': '{kind}', 'fortran_order': False, 'shape': {shape}, }}");
        let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
        bytes.extend((text.len() as u16 + 1).to_le_bytes());
        bytes.extend(text.bytes());
        bytes.extend(b"\n0123456789abcdef");
        check(&bytes);
    });
    // Lengths of headers are claims as well.
    for version in 1..=4_u8 {
        check(&[b"\x93NUMPY", &[version, 0, 0xff, 0xff, 0xff, 0xff][..], b"{'descr'"].concat());
    }
}

#[test]
fn no_method_reconstructs_what_cannot_be_a_scan() {
    let phantom = Phantom::by_name("torso", 0).unwrap();
    let plan = Plan { views: 6, test_views: 0, noise: Noise::None, seed: 0 };
    let sound = simulate("torso", Object::Phantom(&phantom), &Scanner::synthetic(8, 12), &plan).unwrap();
    let (mut empty, mut degrees) = (sound.clone(), sound);
    empty.train.images.fill(1.5);
    degrees.train.angles.iter_mut().for_each(|angle| *angle = angle.to_degrees());
    for (scan, part) in [(empty, "got the value 1.5 in every pixel"), (degrees, "which look like degrees")] {
        for method in Method::ALL {
            let message = trgs::reconstruct(&scan, &Config::of(method)).unwrap_err().to_string();
            assert!(message.contains(part), "{method:?}: {message}");
        }
    }
}
