//! Scans and volumes in HDF5: fields and angles come with the frames. Needs the feature `hdf5`.
//!
//! h5py judges the reader, if `python3`, or the program named by `TRGS_PYTHON`, has it; a CI server must have it.

use crate::program::{Sandbox, stderr};
use serde_json::{Value, json};
use std::io::Write;
use std::path::Path;
use std::process::Command;
use trgs::numeric::elementary::log;
use trgs::scan::hdf5::Hdf5;
use trgs::scan::{Dataset, npy};

const DATA: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/data");
const SCANNER: &str = r#"{ "scanner": {
    "mode": "cone", "DSD": 7.0, "DSO": 5.0, "nDetector": [3, 5], "sDetector": [4.0, 4.0],
    "nVoxel": [4, 4, 4], "sVoxel": [2.0, 2.0, 2.0] } }"#;

#[test]
fn both_layouts_of_a_scan_give_the_same_line_integrals() {
    let sandbox = Sandbox::new();
    sandbox.write("scanner.json", SCANNER);
    let read = |source: &str, out: &str, flags: &str| {
        let convert = format!("convert {DATA}/{source} {out} --scanner scanner.json {flags}");
        let output = sandbox.run(&convert);
        assert!(output.status.success(), "{}", stderr(&output));
        (Dataset::read(sandbox.path(out)).unwrap(), stderr(&output))
    };
    let (exchange, message) = read("exchange.h5", "a", "");
    assert!(message.contains("arrays that are not read: /measurement"), "{message}");
    let (nexus, _) = read("nxtomo.nxs", "b", "");
    assert_eq!(exchange.train.images, nexus.train.images);
    // The unit of length is that of the description.
    let expected = -log((100.0 - 10.0) / (1000.0 - 10.0)) as f32;
    assert_eq!(exchange.train.images[[0, 0, 0]], expected);
    assert_eq!(exchange.train.angles, [0.0_f64, 45.0, 90.0, 135.0].map(f64::to_radians));
    assert_eq!(nexus.train.angles, [0.75, 1.0, 1.25, 1.5]);
    // A flag replaces what the file says, and the array alone has no fields.
    let (white, message) = read("exchange.h5", "c", "--white 1000");
    assert!(message.contains("flat field of this file: not used"), "{message}");
    assert_eq!(white.train.images, exchange.train.images);
    sandbox.write("angles.txt", "0 1 2 3");
    let (plain, _) = read("exchange.h5:/exchange/data", "d", "--line-integrals --angles angles.txt");
    assert_eq!(plain.train.images[[0, 0, 0]], 100.0);
}

#[test]
fn files_are_inspected_and_volumes_are_converted() {
    let sandbox = Sandbox::new();
    assert_eq!(sandbox.done(&format!("inspect {DATA}/nxtomo.nxs"))["shape"], json!([4, 3, 5]));
    let arrays = &sandbox.done(&format!("inspect {DATA}/arrays.h5"))["arrays"];
    assert_eq!(arrays["/types/u2"], json!({ "shape": [4, 3, 5], "numbers": "uint16" }));
    let oddities = &sandbox.done(&format!("inspect {DATA}/many_paths.h5"))["oddities"];
    assert!(oddities[0].as_str().unwrap().contains("after 1000 groups"), "{oddities}");
    sandbox.done(&format!("convert {DATA}/matlab.mat v.npy"));
    let array = npy::read_f32::<ndarray::Ix3>(&sandbox.path("v.npy"), "[x, y, z]").unwrap();
    assert_eq!((array.dim(), array[[1, 2, 3]]), ((5, 3, 4), ((3 * 3 + 2) * 5 + 1) as f32 * 7.0 + 100.0));
    assert!(sandbox.refused("inspect missing.h5").contains("missing.h5"));
}

/// The arrays of files as h5py reads them, or `None` with a message without h5py.
fn read_with_h5py(folder: &Path, files: &[String]) -> Option<Value> {
    let program = std::env::var("TRGS_PYTHON").unwrap_or_else(|_| "python3".into());
    let has_it = Command::new(&program).args(["-c", "import h5py"]).output();
    if !has_it.is_ok_and(|out| out.status.success()) {
        assert!(std::env::var_os("CI").is_none(), "{program} lacks h5py; set TRGS_PYTHON");
        std::io::stderr().write_all(format!("SKIPPED: {program} lacks h5py; set TRGS_PYTHON\n").as_bytes()).unwrap();
        return None;
    }
    let script = concat!(env!("CARGO_MANIFEST_DIR"), "/reference/formats/hdf5.py");
    let output = Command::new(program).arg(script).arg(folder).args(files).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    Some(serde_json::from_slice(&output.stdout).unwrap())
}

#[test]
fn every_array_is_read_as_h5py_reads_it() {
    let sandbox = Sandbox::new();
    let names = ["arrays.h5", "exchange.h5", "nxtomo.nxs", "matlab.mat", "deep.h5", "many_paths.h5"];
    let files = names.map(|name| format!("{DATA}/{name}"));
    let Some(expected) = read_with_h5py(&sandbox.path(""), &files) else { return };
    let mut compared = 0;
    for file in &files {
        let found = Hdf5::read(Path::new(file)).unwrap();
        for (name, expected) in expected[file].as_object().unwrap() {
            let entry = found.entry(name).unwrap();
            assert_eq!(
                json!([entry.shape, entry.numbers]),
                json!([expected["shape"], expected["numbers"]]),
                "{file}: {name}"
            );
            let array = npy::read(Path::new(expected["array"].as_str().unwrap())).unwrap();
            let values = found.numbers(&entry).unwrap().into_f64();
            assert_eq!(values, array.numbers.into_f64(), "{file}: {name}");
            compared += 1;
        }
    }
    assert_eq!(compared, 28);
}
