//! Reading and writing of datasets: units, orders, oddities and errors.

use super::*;
use crate::phantom::Phantom;
use crate::phantom::solid::{Shape, Solid};
use crate::tolerances::{largest, relative};
use glam::{DMat3, DVec3};
use ndarray::Axis;
use serde_json::{Value, json};
use tempfile::TempDir;
use trgs_core::geometry::{Beam, Detector, Grid};

/// A small asymmetric scan, in scene units.
pub(super) fn sample() -> Dataset {
    let grid = Grid { shape: [6, 4, 8], min: DVec3::new(-0.7, -0.5, -0.9), spacing: DVec3::new(0.25, 0.3, 0.25) };
    let detector = Detector { rows: 3, columns: 5, pitch_v: 1.1, pitch_u: 0.7, offset_u: 0.2, offset_v: -0.1 };
    let scanner = Scanner { beam: Beam::Cone { dso: 5.3, dsd: 7.1 }, detector, grid };
    let images = |n: usize, seed: f32| {
        Array3::from_shape_fn((n, 3, 5), |(k, v, u)| seed * (k + 1) as f32 / (v * 7 + u * 3 + 1) as f32)
    };
    Dataset {
        name: "sample".into(),
        scanner,
        scale: 1.0,
        frame: Frame::default(),
        noise: Noise::MEDIUM,
        train: Projections::new(vec![0.1, 3.7, 2.2], images(3, 0.9)).unwrap(),
        test: Some(Projections::new(vec![0.3, 0.1], images(2, 0.77)).unwrap()),
        truth: Some(
            Volume::new(grid, Array3::from_shape_fn((6, 4, 8), |(x, y, z)| (x * 2 + y * y + 3 * z) as f32 / 31.0))
                .unwrap(),
        ),
        initial_points: Some(Array2::from_shape_fn((7, 4), |(i, j)| 1.0 / (i + 2 * j + 1) as f64)),
        notes: vec!["the truth is made up".into()],
        oddities: Vec::new(),
    }
}

/// The sample on disk, with its description changed by `edit`.
fn edited(edit: impl FnOnce(&mut Value)) -> (TempDir, PathBuf) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("sample");
    sample().write(&path).unwrap();
    let meta = path.join("meta_data.json");
    let mut json = serde_json::from_slice(&std::fs::read(&meta).unwrap()).unwrap();
    edit(&mut json);
    std::fs::write(&meta, serde_json::to_vec(&json).unwrap()).unwrap();
    (folder, path)
}

fn error_after(edit: impl FnOnce(&mut Value)) -> String {
    let (_folder, path) = edited(edit);
    Dataset::read(&path).unwrap_err().to_string()
}

fn oddities_after(edit: impl FnOnce(&mut Value)) -> Vec<String> {
    let (_folder, path) = edited(edit);
    Dataset::read(&path).unwrap().oddities
}

#[test]
fn what_is_written_is_read_again_bit_for_bit() {
    let (_folder, path) = edited(|_| {});
    let read = Dataset::read(&path).unwrap();
    let expected = sample();
    assert_eq!((&read.train, &read.test, read.noise), (&expected.train, &expected.test, expected.noise));
    assert_eq!(read.truth.as_ref().unwrap().values, expected.truth.as_ref().unwrap().values);
    assert_eq!((&read.initial_points, &read.notes), (&expected.initial_points, &expected.notes));
    assert_eq!((read.scale, read.name.as_str()), (1.0, "sample"));
    assert_eq!((read.scanner.beam, read.scanner.detector), (expected.scanner.beam, expected.scanner.detector));
    assert_eq!(read.scanner.grid.spacing, expected.scanner.grid.spacing);
    within!((read.scanner.grid.min - expected.scanner.grid.min).abs().max_element());
    assert_eq!(read_scanner(path.join("meta_data.json")).unwrap(), read.scanner);
    assert_eq!(read_scanner(&path).unwrap(), read.scanner);
}

#[test]
fn notes_may_be_missing_but_not_be_numbers() {
    let (_folder, path) = edited(|json| drop(json.as_object_mut().unwrap().remove("notes")));
    assert!(Dataset::read(&path).unwrap().notes.is_empty());
    assert!(error_after(|json| json["notes"] = json!([3])).contains("scan description"));
}

#[test]
fn counts_are_written_as_integers() {
    let (_folder, path) = edited(|json| assert_eq!(json["scanner"]["nVoxel"], json!([6, 4, 8])));
    assert!(std::fs::read_to_string(path.join("meta_data.json")).unwrap().contains("\"nDetector\":[3,5]"));
}

#[test]
fn a_cube_of_any_resolution_is_read_again_exactly() {
    for n in 1..200 {
        let mut scanner = sample().scanner;
        scanner.grid = Grid::cube(n);
        let meta = ScannerMeta::describe(&scanner, &[0.0], Noise::None);
        let bbox = [scanner.grid.min.to_array(), scanner.grid.max().to_array()];
        let meta = Meta::new(meta, None, bbox, Default::default(), Vec::new(), &Frame::default());
        assert_eq!(meta.interpret(Path::new("meta_data.json")).unwrap().scanner, scanner, "{n} voxels");
    }
}

#[test]
fn a_folder_in_millimetres_equals_the_same_scan_in_scene_units() {
    let unit = 120.0;
    let (_folder, path) = edited(|json| {
        for key in ["DSD", "DSO", "sDetector", "dDetector", "sVoxel", "dVoxel", "offOrigin", "offDetector"] {
            match &mut json["scanner"][key] {
                Value::Array(values) => values.iter_mut().for_each(|v| *v = json!(v.as_f64().unwrap() * unit)),
                value => *value = json!(value.as_f64().unwrap() * unit),
            }
        }
        for key in [
            "totalAngle",
            "startAngle",
            "accuracy",
            "noise",
            "possion_noise",
            "gaussian_noise",
            "filter",
            "dVoxel",
            "dDetector",
        ] {
            json["scanner"].as_object_mut().unwrap().remove(key);
        }
        json["scanner"]["convert"] = json!("an unknown field");
        json["proj_train"][0]["radius"] = json!(5.3 * unit);
    });
    let expected = sample();
    for (kind, projections) in [("train", &expected.train), ("test", expected.test.as_ref().unwrap())] {
        for i in 0..projections.len() {
            let file = path.join(format!("proj_{kind}/proj_{kind}_{i:04}.npy"));
            npy::write(&file, projections.image(i).mapv(|p| f64::from(p) * unit).view()).unwrap();
        }
    }
    let read = Dataset::read(&path).unwrap();
    within!((read.scale * unit - 1.0).abs());
    assert_eq!(read.noise, Noise::None);
    let close = |a: f64, b: f64| within!((a - b).abs() / b.abs().max(1.0), "{a} instead of {b}");
    let (a, b) = (read.scanner.detector, expected.scanner.detector);
    assert_eq!((a.rows, a.columns), (b.rows, b.columns));
    close(a.pitch_u, b.pitch_u);
    close(a.pitch_v, b.pitch_v);
    close(a.offset_u, b.offset_u);
    close(a.offset_v, b.offset_v);
    let (a, b) = (read.scanner.grid, expected.scanner.grid);
    a.min.to_array().into_iter().zip(b.min.to_array()).for_each(|(a, b)| close(a, b));
    a.spacing.to_array().into_iter().zip(b.spacing.to_array()).for_each(|(a, b)| close(a, b));
    for (a, b) in read.train.images.iter().zip(&expected.train.images) {
        within!("pixels", relative((*a).into(), (*b).into()), "{a} instead of {b}");
    }
    // Densities keep the unit of the file; points are in scene units already.
    assert_eq!(read.truth.unwrap().values, expected.truth.unwrap().values);
    assert_eq!(read.initial_points, expected.initial_points);
}

#[test]
fn rows_and_columns_keep_their_places() {
    let (_folder, path) = edited(|json| json["scanner"]["offDetector"] = json!([0.4, 0.0]));
    let read = Dataset::read(&path).unwrap();
    assert_eq!((read.scanner.detector.offset_u, read.scanner.detector.offset_v), (0.4, 0.0));
    assert_eq!((read.scanner.detector.rows, read.scanner.detector.columns), (3, 5));
    assert_eq!(read.oddities, Vec::<String>::new());
}

/// A ball projected by TIGRE with the detector at `[v, u]`, as R²-Gaussian stores it.
///
/// TIGRE: source at (DSO, 0, 0), detector in the plane x = -(DSD - DSO), columns towards +y, row 0 lowest. The detector
/// is moved by the offset towards +z and +y, and everything is rotated by the angle about z. R²-Gaussian reverses the
/// rows on writing.
fn seen_by_tigre(scan: &Dataset, [off_v, off_u]: [f64; 2], centre: DVec3, radius: f64) -> Array3<f32> {
    let Beam::Cone { dso, dsd } = scan.scanner.beam else { panic!("a cone") };
    let d = &scan.scanner.detector;
    let mut images = Array3::from_shape_fn((scan.train.len(), d.rows, d.columns), |(view, row, column)| {
        let turn = DMat3::from_rotation_z(scan.train.angles[view]);
        let y = (column as f64 - d.columns as f64 / 2.0 + 0.5) * d.pitch_u + off_u;
        let z = (row as f64 - d.rows as f64 / 2.0 + 0.5) * d.pitch_v + off_v;
        let (source, pixel) = (turn * DVec3::new(dso, 0.0, 0.0), turn * DVec3::new(-(dsd - dso), y, z));
        let direction = (pixel - source).normalize();
        let distance = (centre - source).cross(direction).length();
        (2.0 * (radius * radius - distance * distance).max(0.0).sqrt()) as f32
    });
    images.invert_axis(Axis(1));
    images
}

#[test]
fn the_offset_of_the_detector_moves_it_as_in_tigre() {
    let (centre, radius) = (DVec3::new(0.2, -0.3, 0.25), 0.5);
    let ball =
        Phantom { name: "ball".into(), solids: vec![Solid::new(Shape::Ellipsoid, 1.0, centre, DVec3::splat(radius))] };
    for (off_u, off_v) in [(0.0, 0.0), (0.15, 0.0), (0.0, 0.11), (-0.13, -0.17)] {
        let (_folder, path) = edited(|json| {
            json["scanner"]["offDetector"] = json!([off_u, off_v]);
            (json["scanner"]["nDetector"], json["scanner"]["sDetector"]) = (json!([22, 26]), json!([3.3, 3.5]));
            json["scanner"].as_object_mut().unwrap().remove("dDetector");
        });
        let mut scan = sample();
        scan.scanner = read_scanner(&path).unwrap();
        let ours = ball.project(&scan.scanner, &scan.train.angles).unwrap().images;
        let theirs = seen_by_tigre(&scan, [off_v, off_u], centre, radius);
        let error = ours.iter().zip(&theirs).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
        within!(error, "[{off_u}, {off_v}]: {error}");
        beyond!("peak", largest(ours));
    }
}

#[test]
fn the_key_ct_and_other_oddities_are_noted() {
    let oddities = oddities_after(|json| json["ct"] = json.as_object_mut().unwrap().remove("vol").unwrap());
    assert!(oddities.len() == 1 && oddities[0].contains("`ct`"), "{oddities:?}");
    let oddities = oddities_after(|json| json["scanner"]["mode"] = json!("parallel"));
    assert!(oddities.len() == 1 && oddities[0].contains("parallel"), "{oddities:?}");
    let oddities =
        oddities_after(|json| json["proj_train"][2]["file_path"] = json["proj_train"][0]["file_path"].clone());
    assert!(oddities.len() == 1 && oddities[0].contains("more than once"), "{oddities:?}");
    let oddities = oddities_after(|json| json["bbox"] = json!([[-1, -1, -1], [1, 1, 1]]));
    assert!(oddities.len() == 1 && oddities[0].contains("bbox"), "{oddities:?}");
    let oddities = oddities_after(|json| json["proj_train"][2]["radius"] = json!(8.0));
    assert!(oddities.len() == 1 && oddities[0].contains("radius"), "{oddities:?}");
}

#[test]
fn truth_test_views_and_points_may_be_missing() {
    let (_folder, path) = edited(|json| {
        json["vol"] = Value::Null;
        json.as_object_mut().unwrap().remove("proj_test");
        json["scanner"]["DSD"] = Value::Null;
        json["scanner"]["DSO"] = Value::Null;
        json["scanner"]["mode"] = json!("parallel");
    });
    std::fs::remove_file(path.join("init_sample.npy")).unwrap();
    let read = Dataset::read(&path).unwrap();
    assert!(read.truth.is_none() && read.test.is_none() && read.initial_points.is_none());
    assert!(matches!(read.scanner.beam, Beam::Parallel { .. }));
}

#[test]
fn unusable_descriptions_are_errors_that_name_the_field() {
    let scanner = |key: &'static str, value: Value| error_after(move |json| json["scanner"][key] = value);
    for (message, part) in [
        (scanner("nDetector", json!([-3, 5])), "nDetector: got [-3.0, 5.0], expected whole numbers"),
        (scanner("nDetector", json!([3, 5.5])), "nDetector"),
        (scanner("nVoxel", json!([6, 4, 1e9])), "nVoxel"),
        (scanner("nVoxel", json!([6, 4])), "nVoxel"),
        (scanner("sDetector", json!([3.3, -3.5])), "sDetector"),
        (scanner("sDetector", json!([1.1, 0.7])), "sDetector is the total size"),
        (scanner("sVoxel", json!([0, 1.2, 2])), "sVoxel"),
        (scanner("dVoxel", json!([0.25, 0.3, 0.26])), "dVoxel"),
        (scanner("mode", json!("fan")), "mode: got \"fan\""),
        (scanner("DSO", Value::Null), "DSO: got nothing"),
        (scanner("DSO", json!(0.3)), "DSO: got 0.3"),
        (scanner("DSD", json!(-7.0)), "DSD"),
        (scanner("offDetector", json!([90, 0])), "offDetector"),
        (error_after(|json| json["proj_train"] = json!([])), "proj_train: got no view"),
        (error_after(|json| json["proj_train"][1] = json!({"file_path": "x"})), "angle"),
        (error_after(|json| *json = json!({"vol": "vol_gt.npy"})), "scanner"),
        (error_after(|json| *json = json!([1, 2])), "scan description"),
    ] {
        assert!(message.contains("meta_data.json: ") && message.contains(part), "{message}");
    }
}

#[test]
fn missing_wrong_and_damaged_files_are_errors_that_name_the_file() {
    let (_folder, path) = edited(|_| {});
    let file = path.join("proj_train/proj_train_0001.npy");
    let mut image = sample().train.image(1).to_owned();

    npy::write(&file, image.t()).unwrap();
    let message = Dataset::read(&path).unwrap_err().to_string();
    assert!(
        message.contains("proj_train_0001.npy") && message.contains("[5, 3]") && message.contains("nDetector"),
        "{message}"
    );

    image[[2, 3]] = f32::NAN;
    npy::write(&file, image.view()).unwrap();
    let message = Dataset::read(&path).unwrap_err().to_string();
    assert!(message.contains("proj_train_0001.npy") && message.contains("NaN at index (2, 3)"), "{message}");

    std::fs::remove_file(&file).unwrap();
    assert!(matches!(Dataset::read(&path), Err(Error::Read { path, .. }) if path == file));

    let (_folder, path) = edited(|_| {});
    npy::write(&path.join("vol_gt.npy"), Array3::<f32>::zeros((4, 6, 8)).view()).unwrap();
    let message = Dataset::read(&path).unwrap_err().to_string();
    assert!(message.contains("vol_gt.npy") && message.contains("[6, 4, 8]"), "{message}");

    let (_folder, path) = edited(|_| {});
    npy::write(&path.join("init_sample.npy"), Array2::<f32>::zeros((4, 3)).view()).unwrap();
    let message = Dataset::read(&path).unwrap_err().to_string();
    assert!(message.contains("init_sample.npy") && message.contains("x, y, z, density"), "{message}");

    let nowhere = Dataset::read(Path::new("/nowhere/at/all")).unwrap_err();
    assert!(matches!(nowhere, Error::Read { .. }), "{nowhere}");
}

#[test]
fn a_description_that_windows_wrote_is_read() {
    let folder = tempfile::tempdir().unwrap();
    sample().write(&folder.path().join("scan")).unwrap();
    let text = std::fs::read_to_string(folder.path().join("scan/meta_data.json")).unwrap();
    let plain = Description::parse(text.as_bytes(), Path::new("meta_data.json")).unwrap();
    let wide: Vec<u8> = format!("\u{feff}{text}").encode_utf16().flat_map(u16::to_le_bytes).collect();
    for content in [format!("\u{feff}{text}").into_bytes(), wide] {
        assert_eq!(Description::parse(&content, Path::new("meta_data.json")).unwrap(), plain);
    }
}
