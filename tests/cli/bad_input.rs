//! Damaged, impossible and hostile input, full disks, and places that cannot be written to.
//!
//! Each gives exit code 2 and one clear line, and changes no file.

use crate::program::Sandbox;
use assert_cmd::Command;
use ndarray::{Array, Array1, Array2, Array3};
use serde_json::{Value, json};
use trgs::scan::npy;
use trgs::scan::npz::{self, Entry};

const VIEW: &str = "scan/proj_train/proj_train_0002.npy";

/// Asserts that `reconstruct` and `inspect` reject a scan after `damage` in the `expected` words.
fn refuses_scan(expected: &[&str], damage: impl FnOnce(&Sandbox)) {
    let sandbox = Sandbox::with_scan();
    damage(&sandbox);
    for command in ["reconstruct scan --out run --iterations 2", "inspect scan"] {
        let message = sandbox.refused(command);
        assert!(expected.iter().all(|part| message.contains(part)), "{expected:?} is not in: {message}");
    }
}

/// [`refuses_scan`] after a change of its description.
fn refuses_description(expected: &[&str], change: impl FnOnce(&mut Value)) {
    refuses_scan(expected, |sandbox| sandbox.edit("scan/meta_data.json", change));
}

#[test]
fn missing_and_damaged_projections() {
    refuses_scan(&["proj_train_0002.npy", "No such file"], |s| std::fs::remove_file(s.path(VIEW)).unwrap());
    refuses_scan(&["proj_train_0002.npy", "truncated"], |s| s.write(VIEW, &s.read(VIEW)[..500]));
    refuses_scan(&["proj_train_0002.npy", "truncated"], |s| s.write(VIEW, &s.read(VIEW)[..20]));
    refuses_scan(&["proj_train_0002.npy"], |s| s.write(VIEW, ""));
    refuses_scan(&["proj_train_0002.npy"], |s| s.write(VIEW, "<html>not found</html>"));
    refuses_scan(&["vol_gt.npy", "truncated"], |s| s.write("scan/vol_gt.npy", &s.read("scan/vol_gt.npy")[..300]));
}

#[test]
fn wrong_shapes_and_types() {
    let replace = |s: &Sandbox, shape: [usize; 2]| {
        npy::write(&s.path(VIEW), Array2::<f32>::ones(shape).view()).unwrap();
    };
    refuses_scan(&["proj_train_0002.npy", "[15, 14]", "[14, 15] = nDetector"], |s| replace(s, [15, 14]));
    refuses_scan(&["proj_train_0002.npy"], |s| {
        npy::write(&s.path(VIEW), Array3::<f32>::ones([1, 14, 15]).view()).unwrap();
    });
    refuses_scan(&["vol_gt.npy", "nVoxel"], |s| {
        npy::write(&s.path("scan/vol_gt.npy"), Array3::<f32>::ones([12, 12, 11]).view()).unwrap();
    });
    refuses_scan(&["proj_train_0002.npy", "<c8"], |s| {
        let text = s.read(VIEW);
        let at = text.windows(3).position(|w| w == b"<f4").unwrap();
        s.write(VIEW, [&text[..at], b"<c8", &text[at + 3..]].concat());
    });
}

#[test]
fn values_that_are_not_finite() {
    for (value, name) in [(f32::NAN, "NaN"), (f32::INFINITY, "inf"), (f32::NEG_INFINITY, "-inf")] {
        refuses_scan(&["proj_train_0002.npy", name, "(3, 4)"], |s| {
            let mut image = npy::read_f32::<ndarray::Ix2>(&s.path(VIEW), "").unwrap();
            image[[3, 4]] = value;
            npy::write(&s.path(VIEW), image.view()).unwrap();
        });
    }
    refuses_scan(&["vol_gt.npy", "NaN"], |s| {
        npy::write(&s.path("scan/vol_gt.npy"), Array3::from_elem([12, 12, 12], f32::NAN).view()).unwrap();
    });
}

#[test]
fn descriptions_that_cannot_be() {
    refuses_description(&["proj_train", "no view"], |m| m["proj_train"] = json!([]));
    refuses_description(&["detector", "offDetector"], |m| m["scanner"]["offDetector"] = json!([50.0, 0.0]));
    refuses_description(&["sDetector", "positive"], |m| m["scanner"]["sDetector"] = json!([-4.0, 4.0]));
    refuses_description(&["nVoxel", "-12"], |m| m["scanner"]["nVoxel"] = json!([-12, 12, 12]));
    refuses_description(&["nDetector"], |m| m["scanner"]["nDetector"] = json!([0, 15]));
    refuses_description(&["sVoxel"], |m| m["scanner"]["sVoxel"] = json!([2.0, 2.0]));
    refuses_description(&["DSO", "through the volume"], |m| m["scanner"]["DSO"] = json!(0.5));
    refuses_description(&["DSD"], |m| m["scanner"]["DSD"] = Value::Null);
    refuses_description(&["mode", "fan"], |m| m["scanner"]["mode"] = json!("fan"));
    refuses_description(&["meta_data.json", "north"], |m| m["proj_train"][1]["angle"] = json!("north"));
    refuses_scan(&["meta_data.json", "JSON"], |s| s.write("scan/meta_data.json", "{\"scanner\": "));
    refuses_scan(&["meta_data.json", "JSON"], |s| s.write("scan/meta_data.json", [0xff, 0xfe, 0x00]));
}

#[cfg(not(feature = "dicom"))]
#[test]
fn a_build_without_dicom_says_how_to_get_it() {
    let sandbox = Sandbox::new();
    std::fs::create_dir(sandbox.path("series")).unwrap();
    sandbox.write("series/a.dcm", "");
    for path in ["series/a.dcm", "series"] {
        let message = sandbox.refused(&format!("convert {path} v.nii.gz"));
        assert!(message.contains("-F dicom"), "{message}");
    }
}

#[cfg(not(feature = "hdf5"))]
#[test]
fn a_build_without_hdf5_says_how_to_get_it() {
    let sandbox = Sandbox::with_scan();
    sandbox.write("a.h5", "");
    sandbox.write("a.mat", "");
    for command in ["inspect a.h5", "inspect a.h5:/data", "convert a.mat v.nii.gz", "convert a.h5 out --scanner scan"] {
        let message = sandbox.refused(command);
        assert!(message.contains("-F hdf5") && message.contains("h5py"), "{message}");
    }
}

#[test]
fn a_volume_larger_than_any_computer_is_refused_before_memory_is_asked_for() {
    let sandbox = Sandbox::with_scan();
    sandbox.edit("scan/meta_data.json", |m| {
        m["vol"] = Value::Null;
        m["scanner"]["nVoxel"] = json!([60000, 60000, 60000]);
        m["scanner"]["dVoxel"] = Value::Null;
    });
    assert!(sandbox.refused("reconstruct scan --out run --method fdk").contains("60000"));
    assert!(sandbox.refused("simulate --phantom foam --out x --size 60000").contains("grid shape: got [60000"));
    assert!(sandbox.refused("simulate --phantom foam --out x --detector 60000 --views 9").contains("--max-memory"));
}

/// The arrays of a model with two primitives.
fn model() -> Vec<(&'static str, ndarray::ArrayD<f64>)> {
    let rows = |shape: &[usize], value: f64| Array::from_elem(shape, value).into_dyn();
    vec![
        ("mean", rows(&[2, 3], 0.1)),
        ("scale", rows(&[2, 3], 0.2)),
        ("quaternion", rows(&[2, 4], 0.5)),
        ("density", rows(&[2], 0.3)),
        ("nu", rows(&[2], 4.0)),
    ]
}

fn write_model(sandbox: &Sandbox, arrays: &[(&str, ndarray::ArrayD<f64>)]) {
    let entries: Vec<_> = arrays.iter().map(|(key, values)| (*key, Entry::F64(values.view()))).collect();
    npz::write(sandbox.path("m.npz"), &entries).unwrap();
}

#[test]
fn models_with_missing_or_impossible_arrays() {
    let sandbox = Sandbox::with_scan();
    let commands = ["render m.npz --scanner scan --out a.npy", "voxelize m.npz --scanner scan --out a.npy"];
    let refuses = |expected: &[&str]| {
        for command in commands {
            let message = sandbox.refused(command);
            assert!(expected.iter().all(|part| message.contains(part)), "{expected:?} is not in: {message}");
        }
    };
    refuses(&["m.npz", "No such file"]);
    for missing in ["mean", "scale", "quaternion", "density"] {
        write_model(&sandbox, &model().into_iter().filter(|(key, _)| *key != missing).collect::<Vec<_>>());
        refuses(&["m.npz", missing]);
    }
    for (key, shape, value) in [
        ("mean", &[2, 3][..], f64::NAN),
        ("mean", &[3, 3], 0.1),
        ("scale", &[2, 3], -0.1),
        ("scale", &[2, 4], 0.1),
        ("quaternion", &[2, 4], 0.0),
        ("density", &[2], f64::INFINITY),
        ("nu", &[2], 0.0),
        ("nu", &[2, 1], 4.0),
    ] {
        let mut arrays = model();
        arrays.iter_mut().find(|(name, _)| *name == key).unwrap().1 = Array::from_elem(shape, value).into_dyn();
        write_model(&sandbox, &arrays);
        refuses(&["m.npz", key]);
    }
    write_model(&sandbox, &model());
    let whole = sandbox.read("m.npz");
    sandbox.write("m.npz", &whole[..whole.len() / 2]);
    refuses(&["m.npz", "archive"]);
    sandbox.write("m.npz", "PK");
    refuses(&["m.npz", "archive"]);
}

#[test]
fn cotangents_that_do_not_fit() {
    let sandbox = Sandbox::with_scan();
    write_model(&sandbox, &model());
    let command = "voxelize m.npz --grid 3,4,5 --out a.npy --vjp d.npy --grad-out g.npz";
    npy::write(&sandbox.path("d.npy"), Array3::<f64>::ones([3, 5, 4]).view()).unwrap();
    assert!(sandbox.refused(command).contains("[3, 4, 5], the output's"));
    npy::write(&sandbox.path("d.npy"), Array1::<f64>::ones(60).view()).unwrap();
    assert!(sandbox.refused(command).contains("d.npy"));
    npy::write(&sandbox.path("d.npy"), Array3::from_elem([3, 4, 5], f64::NAN).view()).unwrap();
    assert!(sandbox.refused(command).contains("NaN at index (0, 0, 0)"));
    assert!(sandbox.refused("voxelize m.npz --grid 0,4,5 --out a.npy").contains("at least one voxel"));
    assert!(sandbox.refused("voxelize m.npz --grid 3,4,5 --box 1,1,1,0,0,0 --out a.npy").contains("box"));
    assert!(sandbox.refused("render m.npz --scanner scan/vol_gt.npy --out a.npy").contains("vol_gt.npy"));
}

#[test]
fn pixels_and_voxels_that_are_not_there() {
    let sandbox = Sandbox::with_scan();
    write_model(&sandbox, &model());
    for (command, expected) in [
        ("render m.npz --scanner scan --explain 4,0,0", "view 4, expected 0 to 3"),
        ("render m.npz --scanner scan --explain 0,14,0 --out a.npy", "row 14, expected 0 to 13"),
        ("render m.npz --scanner scan --angles 0.5 --explain 0,13,15", "column 15, expected 0 to 14"),
        ("voxelize m.npz --scanner scan --explain 12,0,0 --out a.npy", "x 12, expected 0 to 11"),
        ("voxelize m.npz --grid 3,4,5 --explain 2,3,5", "z 5, expected 0 to 4"),
    ] {
        let message = sandbox.refused(command);
        assert!(message.contains("--explain") && message.contains(expected), "{command}: {message}");
    }
}

#[test]
fn configurations_that_cannot_be() {
    let sandbox = Sandbox::with_scan();
    for (text, expected) in [
        ("report_every = 0", "at least 1"),
        ("iteration = 5", "did you mean iterations?"),
        ("[loss]\nd_sim = 1", "did you mean loss.d_ssim?"),
        ("iterations = \"many\"", "iterations"),
        ("iterations = ", "line 1"),
        ("[model]\nnu_min = 200.0", "model.nu_max"),
        ("[optimiser]\nbeta = [0.9, 1.0]", "[0, 1)"),
        ("[initialisation]\nfrom = \"dataset\"", "init_*.npy"),
        ("[initialisation]\nthreshold = 1e9", "voxels above it"),
    ] {
        sandbox.write("a.toml", text);
        let message = sandbox.refused("reconstruct scan --out run --config a.toml");
        assert!(message.contains(expected), "{text}: {message}");
    }
    assert!(sandbox.refused("reconstruct scan --out run --config b.toml").contains("b.toml"));
}

#[test]
fn results_that_do_not_belong_to_the_scan() {
    let sandbox = Sandbox::with_scan();
    npy::write(&sandbox.path("a.npy"), Array3::<f32>::ones([4, 4, 4]).view()).unwrap();
    assert!(sandbox.refused("evaluate a.npy --against scan").contains("[12, 12, 12] = [x, y, z]"));
    assert!(sandbox.refused("evaluate scan --against scan").contains("config.toml"));
    npy::write(&sandbox.path("b.npy"), Array3::<f32>::ones([4, 4, 5]).view()).unwrap();
    let message = sandbox.refused("evaluate a.npy --against b.npy");
    assert!(message.contains("a.npy") && message.contains("[4, 4, 5]"), "{message}");
    assert!(sandbox.refused("simulate --volume scan/meta_data.json --out x").contains("meta_data.json"));
    std::fs::create_dir(sandbox.path("empty")).unwrap();
    assert!(sandbox.refused("inspect empty").contains("expected slices"));
}

#[test]
fn places_that_cannot_be_written_to() {
    let sandbox = Sandbox::with_scan();
    write_model(&sandbox, &model());
    for place in ["m.npz/below", "m.npz", "/proc/below"] {
        let reconstruct = sandbox.refused(&format!("reconstruct scan --out {place} --iterations 2 --points 9"));
        let simulate = sandbox.refused(&format!("simulate --phantom axes --out {place} --size 4 --detector 4"));
        assert!(reconstruct.contains("cannot write") && simulate.contains("cannot write"), "{reconstruct}{simulate}");
    }
    for place in ["nowhere/a.npy", "m.npz/a.npy", "/proc/a.npy", "scan"] {
        let message = sandbox.refused(&format!("voxelize m.npz --grid 3,3,3 --out {place}"));
        assert!(message.contains(&format!("cannot write {place}")), "{message}");
    }
}

#[cfg(target_os = "linux")]
#[test]
fn disks_that_are_full() {
    let sandbox = Sandbox::with_scan();
    write_model(&sandbox, &model());
    assert!(sandbox.refused("voxelize m.npz --grid 9,9,9 --out /dev/full").contains("No space left"));
    let mut to_full = Command::new("sh");
    to_full.args([
        "-c",
        "exec \"$0\" inspect scan > /dev/full",
        assert_cmd::cargo::cargo_bin!("trgs").to_str().unwrap(),
    ]);
    to_full.current_dir(sandbox.path(""));
    assert!(sandbox.refuses("inspect > /dev/full", to_full).contains("standard output"));
    // No file may grow beyond 4 KiB (8 blocks): the system fails in the middle of a write, as on a full disk.
    for arguments in [
        "reconstruct scan --out run --iterations 2 --points 60",
        "simulate --phantom axes --out other --size 16 --detector 16",
        "simulate --phantom axes --out scan --size 16 --detector 16",
        "render m.npz --scanner scan --out scan/vol_gt.npy",
    ] {
        let mut limited = Command::new("sh");
        let script = "trap '' XFSZ; ulimit -f 8; program=$0; exec \"$program\" $1";
        limited.args(["-c", script, assert_cmd::cargo::cargo_bin!("trgs").to_str().unwrap()]);
        limited.arg(format!("{arguments} --quiet")).current_dir(sandbox.path(""));
        assert!(sandbox.refuses(arguments, limited).contains("cannot write"));
    }
}
