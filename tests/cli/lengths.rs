//! Unit and place of a scan, from the first read to the last write: scanners in any unit, and scanned volumes.

use crate::formats::{numbers, others};
use crate::program::Sandbox;
use crate::tolerances::largest;
use glam::{DMat3, DVec3};
use ndarray::{Array3, Axis};
use serde_json::{Value, json};
use std::path::{Path, PathBuf};
use trgs::scan::volume_file::{self, VolumeFile};
use trgs::scan::{Dataset, Unit, npy};

/// Endings of formats that state lengths.
const ENDINGS: [&str; 5] = ["nii", "nii.gz", "mha", "nrrd", "tif"];

/// A scanner whose lengths are `factor` times millimetres: voxels of 2, 2 and 1 mm, off the axis of rotation.
fn scanner(factor: f64, unit: Option<&str>) -> Value {
    let lengths = |of: &[f64]| of.iter().map(|length| length * factor).collect::<Vec<_>>();
    let mut description = json!({ "scanner": {
        "mode": "cone", "DSD": 70.0 * factor, "DSO": 50.0 * factor, "nDetector": [12, 14],
        "sDetector": lengths(&[36.0, 42.0]), "nVoxel": [8, 7, 12], "sVoxel": lengths(&[16.0, 14.0, 12.0]),
        "offOrigin": lengths(&[1.0, -0.5, 2.0]), "offDetector": [0.0, 0.0], "totalAngle": 360.0, "startAngle": 0.0
    } });
    if let Some(unit) = unit {
        description["unit"] = json!(unit);
    }
    description
}

/// Line integrals of a ball, 0.02 per millimetre and 5 mm in radius, as far as a test of units needs them.
fn write_frames(sandbox: &Sandbox) {
    let frames = Array3::from_shape_fn((6, 12, 14), |(_, v, u)| {
        let apart = DVec3::new(u as f64 - 6.5, v as f64 - 5.5, 0.0).length() * 3.0 / 1.4;
        (0.04 * (25.0 - apart * apart).max(0.0).sqrt()) as f32
    });
    npy::write(&sandbox.path("frames.npy"), frames.view()).unwrap();
}

fn read(sandbox: &Sandbox, name: &str) -> VolumeFile {
    volume_file::read(sandbox.path(name)).unwrap_or_else(|error| panic!("{name}: {error}"))
}

fn assert_at(found: Option<DVec3>, expected: DVec3, what: &str) {
    let found = found.unwrap_or_else(|| panic!("{what}: nothing"));
    within!(largest((found - expected).to_array()) / largest(expected.to_array()), "{what}: {found}, not {expected}");
}

#[test]
fn a_scanner_in_any_unit_gives_volumes_in_millimetres_and_attenuation_per_millimetre() {
    let sandbox = Sandbox::new();
    write_frames(&sandbox);
    let (spacing, origin) = (DVec3::new(2.0, 2.0, 1.0), DVec3::new(-6.0, -6.5, -3.5));
    let mut first = None;
    for (unit, factor) in [("mm", 1.0), ("um", 1000.0), ("m", 0.001)] {
        sandbox.write("meta.json", scanner(factor, Some(unit)).to_string());
        let converted = sandbox.done(&format!("convert frames.npy {unit} --scanner meta.json --line-integrals"));
        assert_eq!(converted["unit"], unit);
        let found = sandbox.done(&format!("inspect {unit}"));
        within!("scale", (found["scene_units_per_unit_of_the_files"].as_f64().unwrap() * factor * 8.0 - 1.0).abs());
        assert_eq!(found["unit_of_the_files"], unit);
        let lengths = &found["in_unit_of_the_files"];
        within!("scale", (lengths["dso"].as_f64().unwrap() / factor / 50.0 - 1.0).abs(), "{lengths}");
        sandbox.done(&format!("reconstruct {unit} --method fdk --out {unit}-run"));
        assert!(sandbox.text(&format!("{unit}-run/report.html")).contains(&format!("attenuation is per {unit}")));
        assert_eq!(sandbox.done(&format!("inspect {unit}-run"))["volume"]["unit"], unit);
        let own: Array3<f32> = npy::read_f32(&sandbox.path(&format!("{unit}-run/volume.npy")), "").unwrap();
        for ending in ENDINGS {
            let (name, what) = (format!("{unit}.{ending}"), format!("{unit} as {ending}"));
            let written = sandbox.done(&format!("convert {unit}-run/volume.npy {name}"));
            assert_eq!(written["unit"], "mm", "{what}");
            let file = read(&sandbox, &name);
            assert_at(file.spacing, spacing, &what);
            if ending != "tif" {
                assert_at(file.origin, origin, &what);
            }
            assert_eq!((file.unit, file.directions), (Some(Unit::Millimetre), DMat3::IDENTITY), "{what}");
            let apart = file.values.iter().zip(&own).map(|(mm, own)| f64::from(*mm) - f64::from(*own) * factor);
            within!("values", largest(apart) / 0.02, "{what}");
            // A description is as good as the run's own place.
            sandbox.done(&format!("convert {unit}-run/volume.npy again.{ending} --scanner {unit}"));
            assert_eq!(sandbox.read(&format!("again.{ending}")), sandbox.read(&name), "{what}");
        }
        // Whatever the unit, the file is the same, and it is the scan's own volume to a judge.
        let file = read(&sandbox, &format!("{unit}.mha")).values;
        let first = first.get_or_insert_with(|| file.clone());
        within!("units", largest(file.iter().zip(&*first).map(|(a, b)| f64::from(a - b))) / 0.02, "{unit}");
        let scan = Dataset::read(sandbox.path(unit)).unwrap();
        let (back, _) = scan.frame.arrange(read(&sandbox, &format!("{unit}.mha")), &scan.scanner.grid).unwrap();
        let apart = back.values.iter().zip(&own).map(|(back, own)| f64::from(back - own) * factor);
        within!("values", largest(apart) / 0.02, "{unit} read for the scan");
    }
}

#[test]
fn a_scan_without_a_unit_keeps_the_lengths_of_its_files() {
    let sandbox = Sandbox::new();
    write_frames(&sandbox);
    sandbox.write("meta.json", scanner(1.0, None).to_string());
    sandbox.done("convert frames.npy scan --scanner meta.json --line-integrals");
    // A second conversion keeps them, too.
    let again = sandbox.done("convert scan again");
    assert_eq!((&again["spacing"], &again["unit"]), (&json!([2.0, 2.0, 1.0]), &json!("not stated")));
    let found = sandbox.done("inspect again");
    assert_eq!(found["scene_units_per_unit_of_the_files"], 0.125);
    assert_eq!(found["in_unit_of_the_files"]["first_voxel"], json!([-6.0, -6.5, -3.5]));
    sandbox.done("reconstruct again --method fdk --out run");
    let written = sandbox.done("convert run/volume.npy v.nii.gz");
    assert!(written["notes"].to_string().contains("states no unit of length"), "{written}");
    let file = read(&sandbox, "v.nii.gz");
    assert_at(file.spacing, DVec3::new(2.0, 2.0, 1.0), "unstated");
    assert_eq!(file.unit, None);
    // What a format does not keep, and what is not known, is said.
    for (arguments, part) in [
        ("run/volume.npy v.npy", "keeps no spacing"),
        ("run/volume.npy v.tif", "keeps no spacing"),
        ("v.npy bare.nii.gz", "no spacing is known"),
    ] {
        let written = sandbox.done(&format!("convert {arguments}"));
        assert!(written["notes"].to_string().contains(part), "{written}");
    }
    sandbox.edit("again/meta_data.json", |meta| meta["unit"] = json!("furlong"));
    assert!(sandbox.refused("inspect again").contains("nm, um, mm, cm, m or in"));
    sandbox.edit("again/meta_data.json", |meta| meta["unit"] = json!("mm"));
    assert_eq!(sandbox.done("inspect again")["unit_of_the_files"], "mm");
}

/// Volumes to scan, by the directions of their axes: along those of ITK, of NIfTI, and oblique.
fn cts() -> [(&'static str, DMat3); 3] {
    let oblique = DMat3::from_quat(glam::DQuat::from_xyzw(0.2, -0.1, 0.15, 0.9).normalize());
    [("lps", DMat3::IDENTITY), ("ras", DMat3::from_diagonal(DVec3::new(-1.0, -1.0, 1.0))), ("oblique", oblique)]
}

/// An asymmetric body in the middle of 10 × 9 × 8 voxels.
fn ct(directions: DMat3) -> VolumeFile {
    let values = Array3::from_shape_fn((10, 9, 8), |(x, y, z)| {
        let inside = (2..8).contains(&x) && (2..7).contains(&y) && (1..6).contains(&z);
        if inside { 0.5 + 0.05 * (x + 2 * y + z) as f32 } else { 0.0 }
    });
    let (spacing, origin) = (Some(DVec3::new(1.5, 2.0, 2.5)), Some(DVec3::new(-120.0, 35.0, 410.5)));
    VolumeFile { values, spacing, origin, directions, unit: Some(Unit::Millimetre), oddities: Vec::new() }
}

#[test]
fn the_volume_of_a_scanned_ct_lies_over_the_ct() {
    let sandbox = Sandbox::new();
    let mut files: Vec<(PathBuf, PathBuf)> = Vec::new();
    for (name, directions) in cts() {
        let ct = ct(directions);
        volume_file::write(sandbox.path(&format!("{name}.nii.gz")), &ct).unwrap();
        let small = "--detector 14 --views 8 --test-views 2";
        let scan = sandbox.done(&format!("simulate --volume {name}.nii.gz --out {name} {small}"));
        assert_eq!(scan["unit"], "mm");
        sandbox.done(&format!("reconstruct {name} --method fdk --out {name}-run"));
        let own = sandbox.done(&format!("evaluate {name}-run --against {name}"));
        let psnr = |found: &Value| found["psnr_3d"]["value"].clone();
        for ending in ["nii.gz", "mha", "nrrd"] {
            let out = format!("{name}-run.{ending}");
            sandbox.done(&format!("convert {name}-run/volume.npy {out}"));
            let found = read(&sandbox, &out);
            // Every corner is where that of the CT is, in voxels.
            for corner in [DVec3::ZERO, DVec3::new(9.0, 0.0, 0.0), DVec3::new(0.0, 8.0, 0.0), DVec3::new(9.0, 8.0, 7.0)]
            {
                let at = |file: &VolumeFile| file.origin.unwrap() + file.directions * (corner * file.spacing.unwrap());
                let apart = (at(&found) - at(&ct)) / ct.spacing.unwrap().min_element();
                within!("corners", largest(apart.to_array()), "{out}");
            }
            assert_eq!(psnr(&sandbox.done(&format!("evaluate {out} --against {name}"))), psnr(&own), "{out}");
            files.push((sandbox.path(&format!("{name}.nii.gz")), sandbox.path(&out)));
        }
        // The same volume with its axes exchanged and reversed, as other programs store it, has the same quality.
        let mut other = read(&sandbox, &format!("{name}-run.mha"));
        let [x, y, z] = [0, 1, 2].map(|axis| other.directions.col(axis));
        let (s, n) = (other.spacing.unwrap(), other.values.dim());
        other.values.invert_axis(Axis(1));
        other.values = other.values.permuted_axes([2, 0, 1]).as_standard_layout().into_owned();
        other.origin = other.origin.map(|origin| origin + y * s.y * (n.1 - 1) as f64);
        (other.spacing, other.directions) = (Some(DVec3::new(s.z, s.x, s.y)), DMat3::from_cols(z, x, -y));
        volume_file::write(sandbox.path("turned.nrrd"), &other).unwrap();
        assert_eq!(psnr(&sandbox.done(&format!("evaluate turned.nrrd --against {name}"))), psnr(&own), "{name}");
        // The CT itself instead of the scan that was made of it; the test views alone are missing.
        for result in [format!("{name}-run"), format!("{name}-run.mha"), "turned.nrrd".into()] {
            let found = sandbox.done(&format!("evaluate {result} --against {name}.nii.gz"));
            assert_eq!(psnr(&found), psnr(&own), "{result}");
            assert!(found["absent"]["psnr_2d"] == "a volume has no test views" && found.get("psnr_2d").is_none());
        }
        // In another place it is another volume.
        other.origin = other.origin.map(|origin| origin + 20.0);
        volume_file::write(sandbox.path("elsewhere.nrrd"), &other).unwrap();
        let message = sandbox.refused(&format!("evaluate elsewhere.nrrd --against {name}"));
        assert!(message.contains("its middle is at") && message.contains("convert it to .npy"), "{message}");
    }
    let paths: Vec<&Path> = files.iter().flat_map(|(ct, found)| [ct.as_path(), found.as_path()]).collect();
    let Some(seen) = others(&paths, "see") else { return };
    for (ct, found) in &files {
        let [ct, found] = [ct, found].map(|path| &seen[path.to_str().unwrap()]);
        for key in ["spacing", "origin", "directions"] {
            let apart = numbers(&found["itk"][key]).into_iter().zip(numbers(&ct["itk"][key])).map(|(a, b)| a - b);
            within!("itk", largest(apart), "{key}: {found} and {ct}");
        }
        if let Some(nibabel) = found.get("nibabel") {
            assert_eq!(nibabel["unit"], "mm");
        }
    }
}
