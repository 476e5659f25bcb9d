use super::*;
use crate::damage::{MANY, assert_reader_survives};
use crate::stack::{self, ScanFile};
use crate::volume_file;
use ndarray::Array3;
use serde_json::{Value, json};
use std::io::Write;
use std::process::Command;
use trgs_core::setting::Text;

fn path(name: &str) -> PathBuf {
    Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../../tests/data")).join(name)
}

/// The numbers of `reference/generate/make_hdf5.py`, `[z, y, x]` or `[view, v, u]`.
fn values() -> Array3<f32> {
    Array3::from_shape_fn((4, 3, 5), |(z, y, x)| (((3 * z + y) * 5 + x) * 7 + 100) as f32)
}

fn scan(name: &str) -> ScanFile {
    stack::read_scan_file(path(name)).unwrap().unwrap()
}

#[test]
fn a_scan_of_data_exchange_has_its_fields_and_angles() {
    let found = scan("exchange.h5");
    assert_eq!(found.frames, values());
    assert_eq!(found.flat, Some(Array3::from_elem((2, 3, 5), 1000.0)));
    assert_eq!(found.dark, Some(Array3::from_elem((1, 3, 5), 10.0)));
    assert_eq!(found.angles, Some([0.0_f64, 45.0, 90.0, 135.0].map(f64::to_radians).to_vec()));
    assert_eq!(
        found.remarks,
        [
            "/exchange/theta states no unit: degrees are read, which span 135.0°",
            "Data Exchange: 4 views, 2 frames of flat field, 1 of dark field, 4 angles",
            "arrays that are not read: /measurement/instrument/distance []",
        ]
        .map(Text::from)
    );
    // A name asks for the array alone.
    assert_eq!(stack::read_scan_file(path("exchange.h5:/exchange/data")).unwrap(), None);
    assert_eq!(stack::read(path("exchange.h5:/exchange/data")).unwrap(), values());
}

#[test]
fn a_scan_of_nx_tomo_is_divided_by_its_image_key() {
    let found = scan("nxtomo.nxs");
    assert_eq!(found.frames, values());
    assert_eq!(found.flat, Some(Array3::from_elem((2, 3, 5), 1000.0)));
    assert_eq!(found.dark, Some(Array3::from_elem((1, 3, 5), 10.0)));
    assert_eq!(found.angles, Some(vec![0.75, 1.0, 1.25, 1.5]));
    assert_eq!(
        found.remarks,
        [
            "1 frame is left out: the image key is not 0, 1 or 2",
            "NXtomo: 4 views, 2 frames of flat field, 1 of dark field, 4 angles",
        ]
        .map(Text::from)
    );
}

#[test]
fn a_volume_of_matlab_has_its_axes() {
    let found = volume_file::read(path("matlab.mat")).unwrap();
    assert_eq!(found.values, values().reversed_axes());
    assert_eq!(found.oddities, ["/A is read, and not /pixel [1, 1]"]);
    assert_eq!(stack::read(path("matlab.mat")).unwrap(), values());
}

#[test]
fn all_types_of_numbers_are_read_in_both_byte_orders() {
    let file = Hdf5::read(path("arrays.h5")).unwrap();
    let expected = values().mapv(|value| (value / 7.0).floor());
    let types: Vec<&Entry> = file.entries().iter().filter(|entry| entry.name.starts_with("/types/")).collect();
    assert_eq!(types.len(), 12);
    for entry in types {
        let found = volume_file::read(path(&format!("arrays.h5:{}", entry.name))).unwrap();
        assert_eq!(found.values, expected.clone().reversed_axes(), "{} {}", entry.name, entry.numbers);
    }
    let slice = volume_file::read(path("arrays.h5:/slice")).unwrap().values;
    assert_eq!(slice.dim(), (5, 3, 1));
    let constant = volume_file::read(path("arrays.h5:/constant")).unwrap().values;
    assert!(constant.dim() == (70, 60, 50) && constant.iter().all(|&value| value == 2.5));
}

#[test]
fn what_cannot_be_read_is_named_with_what_can() {
    let refused = |name: &str| volume_file::read(path(name)).unwrap_err().to_string();
    let message = refused("arrays.h5");
    assert!(message.contains("/constant [50, 60, 70]") && message.contains("arrays.h5:/"), "{message}");
    let message = refused("arrays.h5:/typos");
    assert!(message.contains("/typos") && message.contains("name one of its arrays: /constant"), "{message}");
    assert_eq!(volume_file::read(path("arrays.h5:/half")).unwrap().values, values().reversed_axes());
    assert!(refused("missing.h5").contains("missing.h5"));
    let parse = |content: &[u8]| volume_file::parse(content, Path::new("a.mat")).unwrap_err().to_string();
    assert!(parse(b"MATLAB 5.0 MAT-file").contains("-v7.3"));
    assert!(parse(b"no HDF5").contains("a.mat"));
    assert_eq!(stack::read_scan_file(Path::new("frames.npy")).unwrap(), None);
    assert_eq!(stack::read_scan_file(path("arrays.h5")).unwrap(), None);
}

#[test]
fn the_end_of_a_search_is_told_and_names_reach_beyond_it() {
    let deep: String = (0..18).map(|i| format!("/g{i}")).collect();
    let found = Hdf5::read(path("deep.h5")).unwrap();
    let limit = found.limit().unwrap();
    assert!(limit.contains("ended 16 levels deep, before /g0/g1/"), "{limit}");
    assert!(limit.contains("deep.h5:/path/of/array"), "{limit}");
    let names: Vec<&str> = found.entries().iter().map(|entry| entry.name.as_str()).collect();
    assert_eq!(names, ["/top"]);
    // The array that was found is read with a remark; others by their name.
    let only = volume_file::read(path("deep.h5")).unwrap();
    assert_eq!((only.values.dim().2, &only.oddities), (2, &vec![limit]));
    let named = volume_file::read(path(&format!("deep.h5:{deep}/deep"))).unwrap();
    assert_eq!((named.values, named.oddities), (values().reversed_axes(), vec![]));
    for missing in [format!("{deep}/none"), format!("{deep}/g18/none"), "/none".into()] {
        let message = volume_file::read(path(&format!("deep.h5:{missing}"))).unwrap_err().to_string();
        assert!(message.contains("/top [2, 3, 5] (the search ended 16 levels deep"), "{message}");
    }
    // Ten groups, each linked twice.
    let found = Hdf5::read(path("many_paths.h5")).unwrap();
    assert!(found.limit().unwrap().contains("after 1000 groups, before /"), "{:?}", found.limit());
    assert_eq!(found.entry("z/data").unwrap().shape, [2, 3, 5]);
    for whole in ["exchange.h5", "nxtomo.nxs", "matlab.mat", "arrays.h5"] {
        assert_eq!(Hdf5::read(path(whole)).unwrap().limit(), None, "{whole}");
    }
}

#[test]
fn damaged_files_are_clear_errors() {
    for name in ["exchange.h5", "nxtomo.nxs"] {
        let scan = |content: &[u8], path: &Path| Hdf5::parse(content, path)?.scan();
        assert_reader_survives(name, MANY / 3, &std::fs::read(path(name)).unwrap(), scan);
    }
    let content = std::fs::read(path("matlab.mat")).unwrap();
    assert_reader_survives("matlab.mat", MANY / 3, &content, volume_file::parse);
}

/// The arrays of files as h5py reads them, or `None` with a message without h5py. A CI server must have it.
fn read_with_h5py(folder: &Path, files: &[PathBuf]) -> Option<Value> {
    let program = std::env::var("TRGS_PYTHON").unwrap_or_else(|_| "python3".into());
    let has_it = Command::new(&program).args(["-c", "import h5py"]).output();
    if !has_it.is_ok_and(|out| out.status.success()) {
        assert!(std::env::var_os("CI").is_none(), "{program} lacks h5py; set TRGS_PYTHON");
        std::io::stderr().write_all(format!("SKIPPED: {program} lacks h5py; set TRGS_PYTHON\n").as_bytes()).unwrap();
        return None;
    }
    let script = concat!(env!("CARGO_MANIFEST_DIR"), "/../../reference/formats/hdf5.py");
    let output = Command::new(program).arg(script).arg(folder).args(files).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    Some(serde_json::from_slice(&output.stdout).unwrap())
}

#[test]
fn every_array_is_read_as_h5py_reads_it() {
    let folder = tempfile::tempdir().unwrap();
    let names = ["arrays.h5", "exchange.h5", "nxtomo.nxs", "matlab.mat", "deep.h5", "many_paths.h5"];
    let files = names.map(path);
    let Some(expected) = read_with_h5py(folder.path(), &files) else { return };
    let mut compared = 0;
    for file in &files {
        let found = Hdf5::read(file).unwrap();
        let file = file.to_str().unwrap();
        for (name, expected) in expected[file].as_object().unwrap() {
            let entry = found.entry(name).unwrap();
            assert_eq!(
                json!([entry.shape, entry.numbers]),
                json!([expected["shape"], expected["numbers"]]),
                "{file}: {name}"
            );
            let array = npy::read(expected["array"].as_str().unwrap()).unwrap();
            let values = found.numbers(&entry).unwrap().into_f64();
            assert_eq!(values, array.numbers.into_f64(), "{file}: {name}");
            compared += 1;
        }
    }
    assert_eq!(compared, 28);
}
