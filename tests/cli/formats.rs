//! Files exchanged with SimpleITK, nibabel, pynrrd, tifffile, imagecodecs, plyfile, trimesh and NumPy, in both directions.
//!
//! Needs Python with the packages of `reference/formats/requirements.txt`: `python3`, or the program named by
//! `TRGS_PYTHON`. Without it the tests are skipped with a message; a CI server must have it.

use crate::program::Sandbox;
use crate::tolerances::largest;
use glam::{DMat3, DVec3};
use ndarray::Array3;
use serde_json::{Value, json};
use std::io::Write;
use std::path::Path;
use std::process::Command;
use trgs::primitives::{Group, KernelKind, Parameters, Primitives};
use trgs::scan::model;
use trgs::scan::surface::otsu;
use trgs::scan::volume_file::{self, VolumeFile};
use trgs::scan::{dataset, npy};

/// Output of the script, or `None` with a message if Python lacks a package.
pub(crate) fn others(arguments: &[&Path], command: &str) -> Option<Value> {
    let program = std::env::var("TRGS_PYTHON").unwrap_or_else(|_| "python3".into());
    let has_all = Command::new(&program)
        .args(["-c", "import imagecodecs, nibabel, nrrd, numpy, plyfile, pydicom, SimpleITK, tifffile, trimesh"])
        .output();
    if !has_all.is_ok_and(|out| out.status.success()) {
        assert!(std::env::var_os("CI").is_none(), "{program} lacks packages; set TRGS_PYTHON");
        let remark =
            format!("SKIPPED: {program} lacks packages of reference/formats/requirements.txt; set TRGS_PYTHON\n");
        std::io::stderr().write_all(remark.as_bytes()).unwrap();
        return None;
    }
    let script = concat!(env!("CARGO_MANIFEST_DIR"), "/reference/formats/others.py");
    let output = Command::new(program).arg(script).arg(command).args(arguments).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    Some(serde_json::from_slice(&output.stdout).unwrap_or(Value::Null))
}

pub(crate) fn numbers(value: &Value) -> Vec<f64> {
    value.as_array().unwrap_or_else(|| panic!("{value}")).iter().map(|x| x.as_f64().unwrap()).collect()
}

fn assert_close(found: &[f64], expected: &[f64], what: &str) {
    assert_eq!(found.len(), expected.len(), "{what}");
    within!(largest(found.iter().zip(expected).map(|(a, b)| a - b)), "{what}: {found:?} instead of {expected:?}");
}

/// [`assert_close`] for parameters, which files hold in double precision.
fn assert_same_parameters(found: &[f64], expected: &[f64], what: &str) {
    assert_eq!(found.len(), expected.len(), "{what}");
    within!(largest(found.iter().zip(expected).map(|(a, b)| a - b)), "{what}: {found:?} instead of {expected:?}");
}

/// Compares a volume as another program read it with the original.
fn assert_seen(found: &Value, expected: &VolumeFile, what: &str) {
    let shape: [usize; 3] = expected.values.dim().into();
    assert_eq!(found["shape"], json!(shape), "{what}");
    let values: Vec<f64> = expected.values.iter().map(|&value| value.into()).collect();
    assert_eq!(numbers(&found["values"]), values, "{what}");
    assert_close(&numbers(&found["spacing"]), &expected.spacing.unwrap().to_array(), what);
    assert_close(&numbers(&found["origin"]), &expected.origin.unwrap().to_array(), what);
    assert_close(&numbers(&found["directions"]), &expected.directions.to_cols_array(), what);
}

/// A scanner with an off-centre grid that differs in every axis.
fn lopsided() -> Value {
    json!({ "scanner": {
        "mode": "cone", "DSD": 7.0, "DSO": 5.0, "nDetector": [6, 8], "sDetector": [4.0, 4.0], "nVoxel": [5, 4, 7],
        "sVoxel": [1.5, 0.9, 2.0], "offOrigin": [0.1, -0.7, 0.3], "offDetector": [0.0, 0.0]
    } })
}

/// An asymmetric model.
fn primitives() -> Primitives {
    let rows = |i: f64| [0.3 - 0.2 * i, 0.1 + 0.25 * i, -0.4 + 0.3 * i];
    Primitives::new(Parameters {
        mean: vec![rows(0.0), rows(1.0), rows(2.0)],
        scale: vec![[0.1, 0.2, 0.3], [0.05, 0.2, 0.1], [0.02, 0.01, 0.4]],
        quaternion: vec![[1.0, 0.2, -0.3, 0.4], [0.1, -0.7, 0.3, 2.0], [0.0, 1.0, 0.0, 0.5]],
        density: vec![0.5, 0.1, 2.0],
        nu: vec![3.0, 50.0, 7.0],
    })
    .unwrap()
}

#[test]
fn a_world_point_has_one_value_in_every_format_and_for_every_reader() {
    let sandbox = Sandbox::new();
    sandbox.write("meta_data.json", lopsided().to_string());
    let values = ndarray::Array3::from_shape_fn((5, 4, 7), |(x, y, z)| (100 * x + 10 * y + z) as f32);
    npy::write(&sandbox.path("v.npy"), values.view()).unwrap();
    let grid = dataset::read_scanner(sandbox.path("meta_data.json")).unwrap().grid;
    let (spacing, origin) = (Some(grid.spacing), Some(grid.centre([0, 0, 0])));
    let expected = VolumeFile { values, spacing, origin, ..VolumeFile::default() };
    within!(largest((grid.min - DVec3::new(-0.65, -1.15, -0.7)).to_array()));
    let names = ["v.nii", "v.nii.gz", "v.mha", "v.nrrd"];
    for name in names {
        sandbox.done(&format!("convert v.npy {name} --scanner meta_data.json"));
        let found = volume_file::read(sandbox.path(name)).unwrap();
        assert_eq!((&found.values, found.directions, &found.oddities), (&expected.values, DMat3::IDENTITY, &vec![]));
        for (found, expected) in [(found.spacing, expected.spacing), (found.origin, expected.origin)] {
            assert_close(&found.unwrap().to_array(), &expected.unwrap().to_array(), name);
        }
    }
    let paths = names.map(|name| sandbox.path(name));
    let Some(seen) = others(&paths.each_ref().map(|path| path.as_path()), "see") else { return };
    let points = [[-0.5, -0.8, -0.2], [0.1, -0.4, 0.9], [0.35, -1.1, 0.3]];
    let at_points = points.map(|point| {
        let index = (DVec3::from(point) - grid.min) / grid.spacing;
        f64::from(expected.values[[0, 1, 2].map(|axis| index[axis] as usize)])
    });
    for path in &paths {
        let seen = seen[path.to_str().unwrap()].as_object().unwrap();
        assert_eq!(seen.contains_key("nibabel"), path.to_string_lossy().contains(".nii"));
        for (who, found) in seen {
            let what = format!("{who}, {}", path.display());
            assert_seen(found, &expected, &what);
            assert_eq!(numbers(&found["at_points"]), at_points, "{what}");
            assert!(found["qform_is_sform"].as_bool().unwrap_or(true), "{what}");
        }
    }
}

#[test]
fn volumes_of_itk_and_nibabel_are_read_with_all_that_they_say() {
    let sandbox = Sandbox::new();
    if others(&[&sandbox.path("")], "make").is_none() {
        return;
    }
    let expected: Value = serde_json::from_str(&sandbox.text("expected.json")).unwrap();
    let expected = expected.as_object().unwrap();
    assert!(expected.len() > 50, "{} files", expected.len());
    for (name, expected) in expected {
        let found = volume_file::read(sandbox.path(name)).unwrap();
        assert_seen(expected, &found, name);
        let straight = found.directions == DMat3::IDENTITY;
        assert_eq!(found.oddities.is_empty(), straight, "{name}: {:?}", found.oddities);
        assert_eq!(
            ["turned", "mirrored", "right", "oblique", "qform", "sform"].iter().any(|w| name.contains(w)),
            !straight
        );
    }
    // Oblique directions survive conversions between formats.
    let mut written = Vec::new();
    for source in ["itk_turned.mha", "itk_turned.nrrd", "itk_mirrored.nii", "itk_mirrored.mha", "nibabel_qform.nii"] {
        for ending in ["mha", "nrrd", "nii.gz"] {
            let name = format!("{}.again.{ending}", source.replace('.', "_"));
            sandbox.done(&format!("convert {source} {name}"));
            written.push((source, sandbox.path(&name)));
        }
    }
    let paths: Vec<&Path> = written.iter().map(|(_, path)| path.as_path()).collect();
    let seen = others(&paths, "see").unwrap();
    for (source, path) in &written {
        let original = volume_file::read(sandbox.path(source)).unwrap();
        for (who, found) in seen[path.to_str().unwrap()].as_object().unwrap() {
            assert_seen(found, &original, &format!("{who}, {}", path.display()));
        }
    }
}

#[test]
fn odd_volumes_are_read_as_other_programs_read_them() {
    let sandbox = Sandbox::new();
    if others(&[&sandbox.path("")], "odd").is_none() {
        return;
    }
    let expected: Value = serde_json::from_str(&sandbox.text("expected.json")).unwrap();
    let expected = expected.as_object().unwrap();
    assert!(expected.len() > 40, "{} files", expected.len());
    for (name, expected) in expected {
        let found = volume_file::read(sandbox.path(name)).unwrap_or_else(|error| panic!("{name}: {error}"));
        let shape: [usize; 3] = found.values.dim().into();
        assert_eq!(expected["shape"], json!(shape), "{name}");
        let values: Vec<f64> = found.values.iter().map(|&value| value.into()).collect();
        let wanted = numbers(&expected["values"]);
        if name == "jpg" {
            assert_eq!(values.len(), wanted.len(), "{name}");
            within!("jpg", largest(values.iter().zip(&wanted).map(|(a, b)| a - b)), "{values:?}");
        } else {
            assert_eq!(values, wanted, "{name}");
        }
        for (key, place) in [("spacing", found.spacing), ("origin", found.origin)] {
            match (place, expected[key].is_null()) {
                (None, true) => {}
                (Some(place), false) => {
                    let expected = numbers(&expected[key]);
                    let size = expected.iter().fold(1.0_f64, |most, x| most.max(x.abs()));
                    let [found, expected] =
                        [&place.to_array()[..], &expected].map(|of| of.iter().map(|x| x / size).collect::<Vec<_>>());
                    assert_close(&found, &expected, &format!("{name}, {key}"));
                }
                (place, _) => panic!("{name}: {key} {place:?} instead of {}", expected[key]),
            }
        }
    }
}

#[test]
fn a_ply_holds_the_model_its_confidence_and_colours() {
    let sandbox = Sandbox::with_scan();
    model::write(sandbox.path("model.npz"), &primitives().parameters).unwrap();
    let found = sandbox.done("convert model.npz model.ply --scanner scan");
    assert_eq!(
        (&found["kind"], &found["kernel"], &found["primitives"]),
        (&json!("model"), &json!("student-t"), &json!(3))
    );
    sandbox.done("confidence model.npz --scanner scan --out c.npz");
    sandbox.done("convert model.ply back.npz");
    assert_eq!(sandbox.read("back.npz"), sandbox.read("model.npz"));
    // A conversion keeps the confidence of a PLY.
    sandbox.done("convert model.ply again.ply");
    assert_eq!(sandbox.read("again.ply"), sandbox.read("model.ply"));
    let paths = [sandbox.path("model.ply"), sandbox.path("c.npz")];
    let Some(seen) = others(&paths.each_ref().map(|path| path.as_path()), "see") else { return };
    let [ply, c] = paths.map(|path| seen[path.to_str().unwrap()].clone());
    let p = primitives().parameters;
    let column =
        |group: Group, k: usize| p.group(group).iter().copied().skip(k).step_by(group.width()).collect::<Vec<_>>();
    let names = [
        (Group::Mean, vec!["x", "y", "z"]),
        (Group::Scale, vec!["scale_x", "scale_y", "scale_z"]),
        (Group::Quaternion, vec!["rotation_w", "rotation_x", "rotation_y", "rotation_z"]),
        (Group::Density, vec!["density"]),
        (Group::Nu, vec!["nu"]),
    ];
    for (group, names) in names {
        for (k, name) in names.into_iter().enumerate() {
            assert_eq!(numbers(&ply[name]), column(group, k), "{name}");
        }
    }
    assert_eq!(ply["confidence"], c["c"]);
    for colour in ["red", "green", "blue"] {
        assert!(numbers(&ply[colour]).iter().all(|value| (0.0..256.0).contains(value)), "{ply}");
    }
}

#[test]
fn point_clouds_of_r2_gaussian_come_and_go() {
    let sandbox = Sandbox::new();
    if others(&[&sandbox.path("")], "make").is_none() {
        return;
    }
    let physical: Value = serde_json::from_str(&sandbox.text("physical.json")).unwrap();
    for name in ["point_cloud", "unbounded"] {
        for protocol in 2..=5 {
            let pickle = format!("{name}_{protocol}.pickle");
            sandbox.done(&format!("convert {pickle} {pickle}.npz"));
            let found = model::read(sandbox.path(&format!("{pickle}.npz"))).unwrap();
            assert_eq!((found.kernel, found.len()), (KernelKind::Gaussian, 6));
            for group in [Group::Mean, Group::Scale, Group::Quaternion, Group::Density] {
                let unbounded = group == Group::Scale && name == "unbounded";
                let key = if unbounded { "unbounded_scale" } else { group.key() };
                let what = format!("{pickle}, {key}");
                assert_same_parameters(found.parameters.group(group), &numbers(&physical[key]), &what);
            }
        }
    }
    sandbox.done("convert point_cloud_4.pickle.npz cloud.npz --r2");
    sandbox.done("convert cloud.npz again.ply");
    let before = model::read(sandbox.path("point_cloud_4.pickle.npz")).unwrap();
    let after = model::read(sandbox.path("again.ply")).unwrap();
    for group in [Group::Mean, Group::Scale, Group::Quaternion, Group::Density] {
        assert_same_parameters(after.parameters.group(group), before.parameters.group(group), group.key());
    }
    let path = sandbox.path("cloud.npz");
    let seen = others(&[&path], "see").unwrap();
    let keys: Vec<&String> = seen[path.to_str().unwrap()].as_object().unwrap().keys().collect();
    assert_eq!(keys, ["xyz", "density", "scale", "rotation", "scale_bound"]);
}

#[test]
fn students_go_to_r2_gaussian_with_a_warning_and_their_nu() {
    let sandbox = Sandbox::new();
    model::write(sandbox.path("model.npz"), &primitives().parameters).unwrap();
    let output = sandbox.run("convert model.npz cloud.npz --r2");
    assert!(crate::program::stderr(&output).contains("ignores nu"), "{}", crate::program::stderr(&output));
    let back = model::read(sandbox.path("cloud.npz")).unwrap();
    assert_eq!((back.kernel, back.parameters.nu), (KernelKind::StudentT, primitives().parameters.nu));
    sandbox.done("voxelize cloud.npz --grid 4,5,6 --out v.npy");
    assert!(sandbox.refused("convert model.npz cloud.ply --r2").contains("--r2"));
}

#[test]
fn impossible_pairs_are_told_which_command_does_it() {
    let sandbox = Sandbox::with_scan();
    model::write(sandbox.path("model.npz"), &primitives().parameters).unwrap();
    for (arguments, remedy) in [
        ("model.npz v.nii.gz", "trgs voxelize"),
        ("model.npz folder", "trgs render"),
        ("scan/vol_gt.npy other.npz", "trgs reconstruct"),
        ("model.npz surface.stl", "trgs voxelize"),
        ("scan/vol_gt.npy v.mha --level 0.5", "--level"),
        ("model.npz model.ply --level 0.5", "--level"),
        ("model.npz other.npz --splats", "--splats"),
        ("scan copy --slices png", "--slices"),
        ("scan/vol_gt.npy v.mha --slices png", "--slices"),
        ("scan/vol_gt.npy s.stl --level 9", "the highest value of the volume"),
        ("scan model.npz", "trgs reconstruct"),
        ("scan v.mha", "trgs reconstruct"),
        ("model.npz other.npz --scanner scan", "trgs confidence"),
        ("scan/vol_gt.npy v.mha --r2", "--r2"),
        ("scan copy --r2", "--r2"),
    ] {
        let message = sandbox.refused(&format!("convert {arguments}"));
        assert!(message.contains(remedy), "{arguments}: {message}");
    }
}

#[test]
fn the_surface_of_a_ball_is_closed_and_has_its_volume_for_trimesh() {
    let sandbox = Sandbox::new();
    let (side, radius) = (48, 20.0_f64);
    // From 0 to 1 over the voxels at the surface.
    let density = |(x, y, z)| {
        let from_middle = |index: usize| index as f64 - (side as f64 - 1.0) / 2.0;
        let distance = DVec3::new(from_middle(x), from_middle(y), from_middle(z)).length();
        (radius - distance + 0.5).clamp(0.0, 1.0) as f32
    };
    npy::write(&sandbox.path("ball.npy"), Array3::from_shape_fn((side, side, side), density).view()).unwrap();
    let paths = ["stl", "ply", "glb"].map(|ending| sandbox.path(&format!("ball.{ending}")));
    for path in &paths {
        sandbox.done(&format!("convert ball.npy {} --level 0.5", path.display()));
    }
    let Some(seen) = others(&paths.each_ref().map(|path| path.as_path()), "mesh") else { return };
    let expected = 4.0 / 3.0 * std::f64::consts::PI * radius * radius * radius;
    for path in &paths {
        let found = &seen[path.to_str().unwrap()];
        assert_eq!(found["closed"], json!(true), "{}", path.display());
        within!((found["volume"].as_f64().unwrap() / expected - 1.0).abs(), "{}: {found}", path.display());
    }
}

#[test]
fn surfaces_slices_and_splats_say_how_they_were_made() {
    let sandbox = Sandbox::with_scan();
    let chosen = sandbox.done("convert scan/vol_gt.npy surface.stl --scanner scan");
    assert_eq!(sandbox.read("surface.stl").len() as u64, 84 + 50 * chosen["triangles"].as_u64().unwrap());
    let level = chosen["level"].as_f64().unwrap();
    assert_eq!(level, otsu(&volume_file::read(sandbox.path("scan/vol_gt.npy")).unwrap()));
    assert!(chosen["notes"][0].as_str().unwrap().contains("Otsu"), "{chosen}");
    for ending in ["ply", "glb", "stl"] {
        let found = sandbox.done(&format!("convert scan/vol_gt.npy given.{ending} --scanner scan --level {level}"));
        assert_eq!([&found["kind"], &found["volume"]], [&json!("surface"), &chosen["volume"]]);
    }
    assert_eq!(sandbox.read("given.stl"), sandbox.read("surface.stl"));
    let found = sandbox.done("convert scan/vol_gt.npy sheet.png");
    assert_eq!([&found["kind"], &found["shape"]], [&json!("contact sheet"), &json!([12, 12, 12])]);
    assert!(found["notes"][0].as_str().unwrap().starts_with("12 slices across z"), "{found}");
    // Four columns of three.
    assert_eq!(volume_file::read(sandbox.path("sheet.png")).unwrap().values.dim(), (48, 36, 1));
    let found = sandbox.done("convert scan/vol_gt.npy slices --slices png");
    assert_eq!([&found["kind"], &found["shape"]], [&json!("slices"), &json!([12, 12, 12])]);
    assert!(found["notes"][0].as_str().unwrap().starts_with("a stored number n is the value 0.0"), "{found}");
    assert_eq!(volume_file::read(sandbox.path("slices")).unwrap().values.dim(), (12, 12, 12));
    model::write(sandbox.path("model.npz"), &primitives().parameters).unwrap();
    let output = sandbox.run("convert model.npz splats.ply --splats");
    assert!(crate::program::stderr(&output).contains("approximation"), "{}", crate::program::stderr(&output));
    let path = sandbox.path("splats.ply");
    let Some(seen) = others(&[&path], "see") else { return };
    let splats = seen[path.to_str().unwrap()].as_object().unwrap();
    assert_eq!((splats.len(), numbers(&splats["opacity"]).len()), (17, 3));
    // A reader of what is written for viewers is told so.
    assert!(sandbox.refused("convert splats.ply back.npz").contains("3D Gaussian splatting"));
}
