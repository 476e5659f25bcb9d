//! Arbitrary bytes in every file that is read and in every text that is parsed: never a panic, always either a value or an
//! error of one clear line, and no memory for what a header merely claims.
//!
//! `cargo fuzz` would look further, but needs a nightly compiler; this is proptest on bytes with a fixed seed: mutations of
//! valid files, with the tokens that readers stumble over, and plain noise. Extreme numbers are in `tests/extremes.rs`.

use glam::DVec3;
use ndarray::{Array1, Array2, Array3};
use proptest::collection::vec;
use proptest::prelude::*;
use proptest::test_runner::{Config as Settings, RngAlgorithm, TestRng, TestRunner};
use std::fmt::Debug;
use std::path::Path;
use tempfile::TempDir;
use trgs::config::{Config, Method};
use trgs::error::Result;
use trgs::primitives::{Parameters, model};
use trgs::scene::dataset::{self, Dataset};
use trgs::scene::noise::Noise;
use trgs::scene::npz::{Entry, Npz};
use trgs::scene::phantom::Phantom;
use trgs::scene::simulate::{Object, Plan, simulate};
use trgs::scene::volume_file::{self, VolumeFile};
use trgs::scene::{Beam, Detector, Grid, Scanner, npy, npz};

const CASES: u32 = 400;
/// Longest message that is still one line to read.
const LONGEST_MESSAGE: usize = 1500;

/// Runs `check` on values drawn from a fixed seed; the message of a failure holds the smallest value that fails.
fn for_all<S: Strategy>(cases: u32, strategy: &S, check: impl Fn(S::Value)) {
    let settings = Settings { cases, failure_persistence: None, max_shrink_iters: 200, ..Settings::default() };
    let mut runner = TestRunner::new_with_rng(settings, TestRng::deterministic_rng(RngAlgorithm::ChaCha));
    let outcome = runner.run(strategy, |value| {
        check(value);
        Ok(())
    });
    outcome.unwrap_or_else(|failure| panic!("{failure}"));
}

/// An error is one line that says where and what; a value is as good.
fn assert_clear<T>(result: Result<T>, names: &str) -> bool {
    let Err(error) = result else { return true };
    let message = error.to_string();
    assert!(!message.contains(['\n', '\r', '\0']), "more than a line: {message:?}");
    assert!(message.len() <= LONGEST_MESSAGE, "{} bytes: {message}", message.len());
    assert!(message.contains(names), "{names} is not in: {message}");
    false
}

/// One change of a file.
#[derive(Clone, Debug)]
enum Mutation {
    Set(prop::sample::Index, u8),
    Flip(prop::sample::Index, u8),
    Cut(prop::sample::Index),
    Remove(prop::sample::Index, usize),
    Insert(prop::sample::Index, Vec<u8>),
    /// The bytes that look like a number at or after a place, replaced.
    Number(prop::sample::Index, &'static str),
}

impl Mutation {
    fn apply(&self, bytes: &mut Vec<u8>) {
        let at = |index: &prop::sample::Index| if bytes.is_empty() { 0 } else { index.index(bytes.len()) };
        match self {
            Self::Set(index, value) => {
                let at = at(index);
                bytes.iter_mut().skip(at).take(1).for_each(|byte| *byte = *value);
            }
            Self::Flip(index, bit) => {
                let at = at(index);
                bytes.iter_mut().skip(at).take(1).for_each(|byte| *byte ^= 1 << bit);
            }
            Self::Cut(index) => bytes.truncate(at(index)),
            Self::Remove(index, count) => {
                let start = at(index);
                bytes.drain(start..(start + count).min(bytes.len()));
            }
            Self::Insert(index, new) => {
                let at = at(index);
                bytes.splice(at..at, new.iter().copied());
            }
            Self::Number(index, text) => {
                let at = at(index);
                let numeric = |byte: &u8| byte.is_ascii_digit() || *byte == b'.';
                if let Some(start) = bytes[at..].iter().position(numeric).map(|i| at + i) {
                    let end = bytes[start..].iter().position(|b| !numeric(b)).map_or(bytes.len(), |i| start + i);
                    bytes.splice(start..end, text.bytes());
                }
            }
        }
    }
}

const NUMBERS: [&str; 16] = [
    "0",
    "1",
    "-1",
    "2.5",
    "65536",
    "4294967296",
    "9223372036854775807",
    "18446744073709551615",
    "1e999",
    "1e-999",
    "NaN",
    "inf",
    "null",
    "\"text\"",
    "[]",
    "99999999999999999999999999999999",
];

fn mutation() -> impl Strategy<Value = Mutation> {
    let index = any::<prop::sample::Index>;
    prop_oneof![
        (index(), any::<u8>()).prop_map(|(i, value)| Mutation::Set(i, value)),
        (index(), 0..8_u8).prop_map(|(i, bit)| Mutation::Flip(i, bit)),
        index().prop_map(Mutation::Cut),
        (index(), 1..40_usize).prop_map(|(i, count)| Mutation::Remove(i, count)),
        (index(), vec(any::<u8>(), 1..20)).prop_map(|(i, new)| Mutation::Insert(i, new)),
        (index(), prop::sample::select(&["((((((((", "]", "{\"a\":", "\u{feff}", "L", "'descr': '<c16'", ", , ,"][..]))
            .prop_map(|(i, new)| Mutation::Insert(i, new.into())),
        (index(), prop::sample::select(&NUMBERS[..])).prop_map(|(i, text)| Mutation::Number(i, text)),
        (index(), prop::sample::select(&NUMBERS[..])).prop_map(|(i, text)| Mutation::Number(i, text)),
    ]
}

/// Valid bytes with one to four changes, or noise with or without the beginning that is expected.
fn damaged(valid: Vec<u8>) -> impl Strategy<Value = Vec<u8>> {
    let head = valid[..valid.len().min(8)].to_vec();
    prop_oneof![
        8 => (Just(valid), vec(mutation(), 1..5)).prop_map(|(mut bytes, mutations)| {
            mutations.iter().for_each(|mutation| mutation.apply(&mut bytes));
            bytes
        }),
        1 => vec(any::<u8>(), 0..200),
        1 => vec(any::<u8>(), 0..200).prop_map(move |tail| [&head[..], &tail].concat()),
    ]
}

/// Gives damaged versions of a file to a reader, which must neither take all of them nor none.
fn assert_reader_survives<T: Debug>(name: &str, valid: Vec<u8>, read: impl Fn(&Path) -> Result<T>) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join(name);
    std::fs::write(&path, &valid).unwrap();
    read(&path).unwrap();
    let (taken, refused) = (std::cell::Cell::new(0), std::cell::Cell::new(0));
    for_all(CASES, &damaged(valid), |bytes| {
        std::fs::write(&path, bytes).unwrap();
        let count = if assert_clear(read(&path), name) { &taken } else { &refused };
        count.set(count.get() + 1);
    });
    eprintln!("{name}: {} taken, {} refused", taken.get(), refused.get());
    assert!(refused.get() > 50, "{name}: {} refused, {} taken: the damage does nothing", refused.get(), taken.get());
}

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
    assert_reader_survives("array.npy", small_npy(), npy::read);
}

#[test]
fn damaged_archives_are_clear_errors() {
    let (a, b) = (Array2::from_elem((3, 2), 0.7_f32).into_dyn(), Array1::from_elem(5, -1.5_f64).into_dyn());
    let entries = [("first", Entry::F32(a.view())), ("second", Entry::F64(b.view()))];
    let valid = bytes_of("a.npz", |path| npz::write(path, &entries).unwrap());
    assert_reader_survives("archive.npz", valid, Npz::read);
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
    assert_reader_survives("MODEL.npz", valid, model::read);
}

/// A small scan in a folder that disappears.
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
    assert_reader_survives("meta_data.json", valid, dataset::read_scanner);
}

#[test]
fn scans_with_any_damaged_file_are_clear_errors() {
    let folder = scan();
    let scan = folder.path().join("scan");
    Dataset::read(&scan).unwrap();
    for file in ["meta_data.json", "vol_gt.npy", "proj_train/proj_train_0001.npy", "proj_test/proj_test_0000.npy"] {
        let path = scan.join(file);
        let valid = std::fs::read(&path).unwrap();
        for_all(CASES / 2, &damaged(valid.clone()), |bytes| {
            std::fs::write(&path, bytes).unwrap();
            assert_clear(Dataset::read(&scan), "scan");
        });
        std::fs::write(&path, valid).unwrap();
    }
    Dataset::read(&scan).unwrap();
}

/// A volume in a format, by the file's name.
fn small_volume(name: &str) -> Vec<u8> {
    let values = Array3::from_shape_fn((3, 4, 5), |(x, y, z)| (x + y * z) as f32);
    let volume = VolumeFile { values, spacing: Some(DVec3::splat(0.5)), origin: None, oddities: Vec::new() };
    bytes_of(name, |path| volume_file::write(path, &volume).unwrap())
}

#[test]
fn damaged_volumes_of_every_format_are_clear_errors() {
    for name in ["a.mha", "a.nrrd", "a.nii", "a.nii.gz", "a_3x4x5_float32.raw"] {
        // Of numbers alone nothing but the length can be wrong.
        let valid = small_volume(name);
        if name.ends_with("raw") {
            let folder = tempfile::tempdir().unwrap();
            let path = folder.path().join(name);
            for_all(CASES, &damaged(valid), |bytes| {
                std::fs::write(&path, bytes).unwrap();
                assert_clear(volume_file::read(&path), name);
            });
        } else {
            assert_reader_survives(name, valid, volume_file::read);
        }
    }
}

#[test]
fn damaged_pickles_are_clear_errors() {
    for protocol in 2..=5 {
        let path = format!("{}/tests/data/naf_{protocol}.pickle", env!("CARGO_MANIFEST_DIR"));
        assert_reader_survives("scan.pickle", std::fs::read(path).unwrap(), Dataset::read);
    }
}

/// Every four bytes of a small file, everywhere, as large numbers, and every number of a header as a larger one.
#[cfg(target_os = "linux")]
#[test]
fn volumes_and_pickles_that_claim_gigabytes_are_given_no_memory() {
    let folder = tempfile::tempdir().unwrap();
    let pickle = std::fs::read(concat!(env!("CARGO_MANIFEST_DIR"), "/tests/data/naf_4.pickle")).unwrap();
    let files = ["a.mha", "a.nrrd", "a.nii", "a.nii.gz"].map(|name| (name, small_volume(name)));
    let files: Vec<_> = files.into_iter().chain([("scan.pickle", pickle)]).collect();
    let read = |path: &Path| match path.extension().is_some_and(|extension| extension == "pickle") {
        true => assert_clear(Dataset::read(path), "scan"),
        false => assert_clear(volume_file::read(path), "a."),
    };
    for (name, valid) in &files {
        std::fs::write(folder.path().join(name), valid).unwrap();
        assert!(read(&folder.path().join(name)));
    }
    let before = largest_address_space();
    for (name, valid) in &files {
        let path = folder.path().join(name);
        for at in 0..valid.len() - 4 {
            for claim in [u32::MAX, 0x7f7f_7f7f, 1 << 28] {
                let mut bytes = valid.clone();
                bytes[at..at + 4].copy_from_slice(&claim.to_le_bytes());
                std::fs::write(&path, &bytes).unwrap();
                read(&path);
            }
            if valid[at].is_ascii_digit() {
                let mut bytes = valid.clone();
                bytes.splice(at..=at, *b"99999");
                std::fs::write(&path, &bytes).unwrap();
                read(&path);
            }
        }
    }
    let grown = (largest_address_space() - before) << 10;
    assert!(grown < 1 << 30, "{grown} bytes of address space for files of two thousand bytes");
}

#[test]
fn damaged_configurations_are_clear_errors() {
    let valid = Config::default().to_toml().into_bytes();
    assert_reader_survives("config.toml", valid, |path| {
        let config = Config::read(path, Method::TrGs)?;
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
    for_all(4 * CASES, &text, |text| {
        let mut config = Config::default();
        assert_clear(config.set(&text), "");
        assert_clear(text.parse::<Noise>(), "noise");
        assert_clear(Phantom::by_name(&text, 0).map(|_| ()), "phantom");
    });
}

/// The largest address space that this process ever had, kibibytes.
#[cfg(target_os = "linux")]
fn largest_address_space() -> u64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap();
    let line = status.lines().find_map(|line| line.strip_prefix("VmPeak:")).unwrap();
    line.trim().trim_end_matches(" kB").parse().unwrap()
}

#[cfg(target_os = "linux")]
#[test]
fn a_header_that_claims_gigabytes_is_given_no_memory() {
    const CLAIMED: u64 = 8 << 30;
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.npy");
    // Warmed up: allocators and threads have taken what they take.
    std::fs::write(&path, small_npy()).unwrap();
    npy::read(&path).unwrap();
    let before = largest_address_space();
    let shape = prop_oneof![
        (CLAIMED..u64::MAX).prop_map(|n| format!("({n},)")),
        (1..10_000_u64).prop_map(|n| format!("({n}, {})", CLAIMED / n)),
        (1..10_000_u64).prop_map(|n| format!("({n}, 0, {})", u64::MAX / n)),
        (CLAIMED..1_u64 << 40).prop_map(|n| format!("(1, {n}, 1, 1)")),
    ];
    let claims = (shape, prop::sample::select(&["<f4", "<f8", "|u1", "<i8", "|b1", "<V1000000", "|S9999999999"][..]));
    for_all(CASES, &claims, |(shape, kind)| {
        let text = format!("{{'descr': '{kind}', 'fortran_order': False, 'shape': {shape}, }}");
        let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
        bytes.extend((text.len() as u16 + 1).to_le_bytes());
        bytes.extend(text.bytes());
        bytes.extend(b"\n0123456789abcdef");
        std::fs::write(&path, &bytes).unwrap();
        assert!(!assert_clear(npy::read(&path), "a.npy"), "taken: {text}");
    });
    // The lengths of headers are claims as well.
    for version in 1..=4_u8 {
        let bytes = [b"\x93NUMPY", &[version, 0, 0xff, 0xff, 0xff, 0xff][..], b"{'descr'"].concat();
        std::fs::write(&path, bytes).unwrap();
        assert!(!assert_clear(npy::read(&path), "a.npy"));
    }
    let grown = (largest_address_space() - before) << 10;
    // Other tests run beside this one; none of them needs an eighth of the smallest claim.
    assert!(grown < CLAIMED / 8, "{grown} bytes of address space for files of 200 bytes that claim {CLAIMED} or more");
}

/// Entries of archives state their sizes twice, and both can lie.
#[cfg(target_os = "linux")]
#[test]
fn an_archive_that_claims_gigabytes_is_given_no_memory() {
    let values = Array1::from_elem(3, 0.5_f64).into_dyn();
    let valid = bytes_of("a.npz", |path| npz::write(path, &[("a", Entry::F64(values.view()))]).unwrap());
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.npz");
    std::fs::write(&path, &valid).unwrap();
    Npz::read(&path).unwrap();
    let before = largest_address_space();
    // Every four bytes, everywhere, as the largest number: among them all sizes, offsets and counts.
    for at in 0..valid.len() - 4 {
        for claim in [u32::MAX, u32::MAX - 1, 1 << 31, 0] {
            let mut bytes = valid.clone();
            bytes[at..at + 4].copy_from_slice(&claim.to_le_bytes());
            std::fs::write(&path, &bytes).unwrap();
            assert_clear(Npz::read(&path), "a.npz");
        }
    }
    let grown = (largest_address_space() - before) << 10;
    assert!(grown < 1 << 30, "{grown} bytes of address space for an archive of {} bytes", valid.len());
}
