//! Scans and volumes in HDF5: fields and angles come with the frames.
//!
//! The program needs the feature `hdf5`. In a build without it, `TRGS_HDF5_PROGRAM` names a program that has it, and the
//! tests run if they are asked for: `cargo test --test cli -- --ignored hdf5::`.

use crate::program::{Sandbox, stderr};
use serde_json::json;
use trgs::numeric::elementary::log;
use trgs::scan::{Dataset, npy};

const DATA: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/data");
const SCANNER: &str = r#"{ "scanner": {
    "mode": "cone", "DSD": 7.0, "DSO": 5.0, "nDetector": [3, 5], "sDetector": [4.0, 4.0],
    "nVoxel": [4, 4, 4], "sVoxel": [2.0, 2.0, 2.0] } }"#;

/// An empty sandbox for the program with the feature.
fn sandbox() -> Sandbox {
    if cfg!(feature = "hdf5") {
        return Sandbox::new();
    }
    Sandbox::of(std::env::var_os("TRGS_HDF5_PROGRAM").expect("TRGS_HDF5_PROGRAM names a program").into())
}

#[test]
#[cfg_attr(not(feature = "hdf5"), ignore = "needs a program with the feature hdf5, TRGS_HDF5_PROGRAM")]
fn both_layouts_of_a_scan_give_the_same_line_integrals() {
    let sandbox = sandbox();
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
#[cfg_attr(not(feature = "hdf5"), ignore = "needs a program with the feature hdf5, TRGS_HDF5_PROGRAM")]
fn files_are_inspected_and_volumes_are_converted() {
    let sandbox = sandbox();
    assert_eq!(sandbox.done(&format!("inspect {DATA}/nxtomo.nxs"))["shape"], json!([4, 3, 5]));
    let arrays = &sandbox.done(&format!("inspect {DATA}/arrays.h5"))["arrays"];
    assert_eq!(arrays["/types/u2"], json!({ "shape": [4, 3, 5], "numbers": "uint16" }));
    let oddities = &sandbox.done(&format!("inspect {DATA}/many_paths.h5"))["oddities"];
    assert!(oddities[0].as_str().unwrap().contains("after 1000 groups"), "{oddities}");
    sandbox.done(&format!("convert {DATA}/matlab.mat v.npy"));
    let array = npy::read_f32::<ndarray::Ix3>(&sandbox.path("v.npy"), "[x, y, z]").unwrap();
    assert_eq!((array.dim(), array[[1, 2, 3]]), ((5, 3, 4), ((3 * 3 + 2) * 5 + 1) as f32 * 7.0 + 100.0));
    assert!(sandbox.refused("inspect missing.h5 --quiet").contains("missing.h5"));
}
