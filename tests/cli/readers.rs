//! Frames, views, volumes and angles in the formats that people have, through `convert`, `inspect` and `reconstruct`.

use crate::program::Sandbox;
use ndarray::{Array3, Axis};
use serde_json::{Value, json};
use std::f64::consts::{PI, TAU};
use std::path::Path;
use trgs::scan::npz::{self, Entry};
use trgs::scan::volume_file::{self, VolumeFile};
use trgs::scan::{Dataset, npy};

/// Frames `[view, v, u]` of whole numbers below 256.
fn frames() -> Array3<f32> {
    Array3::from_shape_fn((3, 4, 5), |(view, v, u)| (40 + 60 * view + 10 * v + 2 * u) as f32)
}

const SCANNER: &str = r#"{"scanner": {"mode": "cone", "DSD": 7.0, "DSO": 5.0, "nDetector": [4, 5], "sDetector": [4.0, 5.0],
    "nVoxel": [4, 4, 4], "sVoxel": [2.0, 2.0, 2.0], "totalAngle": 360.0, "startAngle": 0.0}}"#;

fn write_png(path: &Path, frame: ndarray::ArrayView2<'_, f32>) {
    let file = std::fs::File::create(path).unwrap();
    let mut encoder = png::Encoder::new(file, frame.ncols() as u32, frame.nrows() as u32);
    encoder.set_color(png::ColorType::Grayscale);
    encoder.set_depth(png::BitDepth::Eight);
    let content: Vec<u8> = frame.iter().map(|&value| value as u8).collect();
    encoder.write_header().unwrap().write_image_data(&content).unwrap();
}

/// A sandbox with the same frames in several forms, and their scanner.
fn with_frames() -> (Sandbox, [&'static str; 5]) {
    let sandbox = Sandbox::new();
    sandbox.write("scanner.json", SCANNER);
    for folder in ["png", "raw", "inner_5x4_uint8"] {
        std::fs::create_dir(sandbox.path(folder)).unwrap();
    }
    for (view, frame) in frames().outer_iter().enumerate() {
        write_png(&sandbox.path(&format!("png/{}.png", view + 9)), frame);
        let content: Vec<u8> = frame.iter().map(|&value| value as u8).collect();
        sandbox.write(&format!("raw/f{}_5x4_uint8.raw", view + 9), &content);
        sandbox.write(&format!("inner_5x4_uint8/{}.raw", view + 9), content);
    }
    npy::write(&sandbox.path("stack.npy"), frames().view()).unwrap();
    npz::write(sandbox.path("stack.npz"), &[("data", Entry::F32(frames().view().into_dyn()))]).unwrap();
    (sandbox, ["stack.npy", "stack.npz", "png", "raw", "inner_5x4_uint8"])
}

#[test]
fn frames_of_every_kind_become_the_same_scan() {
    let (sandbox, names) = with_frames();
    let scan = |name: &str| {
        let out = format!("scan_{}", name.replace('.', "_"));
        sandbox.done(&format!("convert {name} {out} --scanner scanner.json --line-integrals"));
        Dataset::read(sandbox.path(&out)).unwrap().train
    };
    let expected = scan(names[0]);
    assert_eq!(expected.images, frames());
    for name in &names[1..] {
        assert_eq!(scan(name), expected, "{name}");
    }
}

#[test]
fn everything_that_convert_reads_can_be_inspected() {
    let (sandbox, names) = with_frames();
    let names = &names[1..];
    for name in &names[1..] {
        let found = sandbox.done(&format!("inspect {name}"));
        assert_eq!((&found["shape"], &found["values"]), (&json!([5, 4, 3]), &json!([40.0, 198.0])), "{name}: {found}");
    }
    assert_eq!(sandbox.done("inspect stack.npz")["arrays"]["data"]["shape"], json!([3, 4, 5]));
    sandbox.done("simulate --phantom torso --out scan --size 12 --detector 6,7 --views 4 --test-views 3");
    let found = sandbox.done("inspect scan/proj_train");
    assert_eq!((&found["kind"], &found["shape"]), (&json!("stack of projections [view, v, u]"), &json!([4, 6, 7])));
    let volume = VolumeFile { spacing: Some([0.5, 0.75, 1.25].into()), ..VolumeFile::default() };
    let volume = VolumeFile { values: frames(), ..volume };
    for name in ["v.mha", "v.nrrd", "v.nii", "v.nii.gz", "v.tif", "v_3x4x5_float32.raw"] {
        volume_file::write(sandbox.path(name), &volume).unwrap();
        let found = sandbox.done(&format!("inspect {name}"));
        let has_spacing = !name.contains("tif") && !name.contains("raw");
        assert_eq!(found["shape"], json!([3, 4, 5]), "{name}");
        assert_eq!(found["spacing"], if has_spacing { json!([0.5, 0.75, 1.25]) } else { Value::Null }, "{name}");
    }
    let data = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/data");
    assert_eq!(sandbox.done(&format!("inspect {data}/naf_4.pickle"))["kind"], "dataset");
    assert_eq!(sandbox.done(&format!("inspect {data}/point_cloud.pickle"))["kind"], "model");
    sandbox.write("angles.csv", "view;Angle [deg]\r\n0;0\r\n1;90\r\n");
    let found = sandbox.done("inspect angles.csv");
    assert_eq!((&found["kind"], &found["views"]), (&json!("angles"), &json!(2)));
    assert!(found["oddities"][0].as_str().unwrap().contains("degrees"), "{found}");
    assert!(sandbox.refused("inspect missing.h5").contains("No such file"));
    assert!(sandbox.refused("inspect scanner.docx").contains("No such file"));
    std::fs::create_dir(sandbox.path("empty")).unwrap();
    assert!(sandbox.refused("inspect empty").contains("got 0 files"));
}

#[test]
fn tables_of_angles_are_read_by_the_name_of_their_column() {
    let (sandbox, _) = with_frames();
    let convert = "convert stack.npy out --scanner scanner.json --line-integrals --angles angles.csv";
    let angles = |text: &str, flag: &str| {
        sandbox.write("angles.csv", text);
        let found = sandbox.run(&format!("{convert} {flag}"));
        let message = crate::program::stderr(&found);
        match found.status.code() {
            Some(0) => Ok(Dataset::read(sandbox.path("out")).unwrap().train.angles),
            _ => Err(message),
        }
    };
    for text in
        ["angle\n0\n0.5\n1\n", "\u{feff}view,angle\r\n0,0\r\n1,0.5\r\n2,1\r\n", "theta\tt\n0\t7\n0.5\t8\n1\t9\n"]
    {
        assert_eq!(angles(text, "").unwrap(), [0.0, 0.5, 1.0], "{text}");
    }
    let degrees = "\"frame\",\"angle_deg\"\n0,0\n1,90\n2,180\n";
    assert!(angles(degrees, "").unwrap_err().contains("add --degrees"));
    assert_eq!(angles(degrees, "--degrees").unwrap()[1], std::f64::consts::FRAC_PI_2);
    assert!(angles("angle_rad\n0\n1\n2\n", "--degrees").unwrap_err().contains("omit --degrees"));
    assert!(angles("a,b\n0,0\n1,0.5\n2,1\n", "").unwrap_err().contains("one column whose heading has angle"));
    assert!(angles("angle\n0\nninety\n1\n", "").unwrap_err().contains("line 3: got ninety"));
    // A list states no unit: degrees are refused with both remedies, and nothing is written.
    std::fs::remove_dir_all(sandbox.path("out")).unwrap();
    let refused = angles("0\n90\n180\n", "").unwrap_err();
    assert!(refused.contains("give --degrees if they are degrees") && refused.contains("or --radians"), "{refused}");
    assert!(!sandbox.path("out").exists());
    assert_eq!(angles("0\n90\n180\n", "--degrees").unwrap()[2], PI);
    let insisted = angles("0\n9.5\n19\n", "--radians").unwrap();
    assert_eq!(insisted, [0.0, 9.5 - TAU, 19.0_f64.rem_euclid(TAU)]);
    // A scan of an older version, whose angles are degrees: told by inspect, refused by the others.
    angles("0\n0.5\n1\n", "").unwrap();
    sandbox.edit("out/meta_data.json", |meta| {
        for (view, angle) in meta["proj_train"].as_array_mut().unwrap().iter_mut().zip([0, 120, 240]) {
            view["angle"] = angle.into();
        }
    });
    assert!(sandbox.done("inspect out")["oddities"].to_string().contains("which look like degrees"));
    for command in ["reconstruct out --out run --method fdk", "convert out copy"] {
        let refused = sandbox.refused(command);
        assert!(refused.contains("multiply every angle of proj_train and proj_test"), "{refused}");
    }
}

#[test]
fn scans_may_name_images_and_volumes_in_other_formats() {
    let sandbox = Sandbox::with_scan();
    let plain = Dataset::read(sandbox.path("scan")).unwrap();
    let truth = plain.truth.clone().unwrap();
    let scanner = plain.scanner;
    for (i, view) in ["proj_train/proj_train_0000", "proj_train/proj_train_0001"].iter().enumerate() {
        let values = plain.train.images.select(Axis(0), &[i]).reversed_axes();
        let ending = ["tif", "mha"][i];
        volume_file::write(
            sandbox.path(&format!("scan/{view}.{ending}")),
            &VolumeFile { values, ..VolumeFile::default() },
        )
        .unwrap();
        std::fs::remove_file(sandbox.path(&format!("scan/{view}.npy"))).unwrap();
    }
    std::fs::remove_file(sandbox.path("scan/vol_gt.npy")).unwrap();
    trgs::write_volume(sandbox.path("scan/truth.nii.gz"), &truth, &plain.frame).unwrap();
    npz::write(sandbox.path("scan/truth.npz"), &[("vol", Entry::F32(truth.values.view().into_dyn()))]).unwrap();
    for truth in ["truth.nii.gz", "truth.npz"] {
        sandbox.edit("scan/meta_data.json", |meta| {
            meta["proj_train"][0]["file_path"] = json!("proj_train/proj_train_0000.tif");
            meta["proj_train"][1]["file_path"] = json!("proj_train/proj_train_0001.mha");
            meta["vol"] = json!(truth);
        });
        let found = Dataset::read(sandbox.path("scan")).unwrap();
        assert_eq!((&found.train, &found.test, &found.truth), (&plain.train, &plain.test, &plain.truth), "{truth}");
        assert_eq!((found.scanner, found.oddities), (scanner, plain.oddities.clone()), "{truth}");
    }
    // A volume of other proportions is remarked on.
    let spacing = Some(scanner.grid.spacing * glam::DVec3::new(1.0, 1.0, 2.0));
    let other = VolumeFile { values: truth.values, spacing, ..VolumeFile::default() };
    volume_file::write(sandbox.path("scan/truth.mha"), &other).unwrap();
    sandbox.edit("scan/meta_data.json", |meta| meta["vol"] = json!("truth.mha"));
    let found = sandbox.done("inspect scan");
    assert!(found["oddities"].to_string().contains("is not that of the scan"), "{found}");
    // A file with several pages is no view.
    volume_file::write(sandbox.path("scan/proj_train/proj_train_0000.tif"), &other).unwrap();
    assert!(sandbox.refused("inspect scan").contains("one page, [v, u]"));
}

#[test]
fn a_volume_in_an_archive_is_converted_and_odd_files_are_warned_of() {
    let sandbox = Sandbox::new();
    npz::write(sandbox.path("v.npz"), &[("vol", Entry::F32(frames().view().into_dyn()))]).unwrap();
    sandbox.done("convert v.npz v.mha");
    assert_eq!(volume_file::read(sandbox.path("v.mha")).unwrap().values, frames());
    assert!(sandbox.refused("convert v.mha w.npz").contains("a model of a volume"));
    let mut content = sandbox.read("v.mha");
    content.extend([0; 5]);
    sandbox.write("long.mha", content);
    let warning = crate::program::stderr(&sandbox.run("convert long.mha long.nrrd"));
    assert!(warning.contains("long.mha: more data follow"), "{warning}");
    sandbox.write("scanner.json", SCANNER);
    let found = sandbox.run("convert long.mha scan --scanner scanner.json --line-integrals");
    assert!(crate::program::stderr(&found).contains("long.mha: more data follow"), "{found:?}");
}
