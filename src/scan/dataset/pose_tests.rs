//! Poses, unread fields and odd entries of descriptions and pickles.

use super::*;
use glam::DVec3;
use serde_json::{Value, json};
use trgs_core::geometry::{Beam, Deviation};

const ANGLES: [f64; 3] = [0.1, 1.3, 4.0];

/// A description in millimetres, of which a scene unit is 100.
fn description() -> Value {
    let view = |i: usize| json!({"file_path": format!("{i}.npy"), "angle": ANGLES[i]});
    json!({
        "scanner": {
            "mode": "cone", "DSD": 700.0, "DSO": 500.0, "nDetector": [4, 6], "sDetector": [400.0, 480.0],
            "nVoxel": [4, 4, 4], "sVoxel": [200.0, 200.0, 200.0],
        },
        "proj_train": [view(0), view(1), view(2)],
    })
}

fn with(field: &str, value: Value) -> Value {
    let mut description = description();
    description["scanner"][field] = value;
    description
}

fn parsed(description: &Value) -> Result<Description> {
    Description::parse(description.to_string().as_bytes(), Path::new("meta_data.json"))
}

fn poses(description: &Value) -> Option<Vec<Pose>> {
    parsed(description).unwrap().poses(&ANGLES).unwrap()
}

fn refused(description: &Value) -> String {
    let parsed = parsed(description).and_then(|description| description.poses(&ANGLES));
    parsed.expect_err(&description.to_string()).to_string()
}

/// The poses of deviations from the plain scanner.
fn expected(deviation: impl Fn(usize, Deviation) -> Deviation) -> Vec<Pose> {
    let plain = Deviation::none(&parsed(&description()).unwrap().scanner);
    (0..3).map(|i| deviation(i, plain).pose(ANGLES[i])).collect()
}

fn assert_near(found: Option<Vec<Pose>>, expected: &[Pose]) {
    let found = found.expect("poses");
    for (a, b) in found.iter().zip(expected) {
        let apart = [a.source - b.source, a.centre - b.centre, a.u - b.u, a.v - b.v];
        assert!(apart.iter().all(|apart| apart.length() < 1e-12), "{a:?}\n{b:?}");
    }
    assert_eq!(found.len(), expected.len());
}

#[test]
fn words_of_tigre_are_honoured_for_all_views_and_for_each() {
    assert_eq!(poses(&description()), None);
    let shifted = expected(|_, d| Deviation { axis_shift: 0.14, ..d });
    assert_near(poses(&with("COR", json!(14.0))), &shifted);
    assert_near(poses(&with("COR", json!([14.0, 14.0, 14.0]))), &shifted);
    let each = expected(|i, d| Deviation { axis_shift: 0.1 * i as f64, ..d });
    assert_near(poses(&with("COR", json!([0.0, 10.0, 20.0]))), &each);
    let turned = expected(|_, d| Deviation { turns: [0.1, 0.2, 0.3], ..d });
    assert_near(poses(&with("rotDetector", json!([0.1, 0.2, 0.3]))), &turned);
    let moved = expected(|i, d| Deviation { offset: [0.05 * i as f64, -0.1], ..d });
    assert_near(poses(&with("offDetector", json!([[0.0, 10.0], [5.0, 10.0], [10.0, 10.0]]))), &moved);
    let far = expected(|i, d| Deviation { dso: 5.0 + 0.1 * i as f64, ..d });
    assert_near(poses(&with("DSO", json!([500.0, 510.0, 520.0]))), &far);
    let longer = expected(|i, d| Deviation { dsd: 7.0 + 0.1 * i as f64, ..d });
    assert_near(poses(&with("DSD", json!([700.0, 710.0, 720.0]))), &longer);
    // The volume lies elsewhere in each view: the first states the grid.
    let offsets = json!([[1.0, 2.0, 3.0], [1.0, 2.0, 13.0], [4.0, 2.0, 3.0]]);
    let origins = [DVec3::ZERO, DVec3::new(0.0, 0.0, 0.1), DVec3::new(0.03, 0.0, 0.0)];
    let description = with("offOrigin", offsets);
    assert_near(poses(&description), &expected(|i, d| Deviation { origin: origins[i], ..d }));
    assert!(parsed(&description).unwrap().scanner.grid.min.abs_diff_eq(DVec3::new(-0.99, -0.98, -0.97), 1e-12));
}

#[test]
fn lists_of_equal_or_neutral_numbers_are_a_circle() {
    assert_eq!(poses(&with("COR", json!(0))), None);
    assert_eq!(poses(&with("rotDetector", json!([[0, 0, 0], [0, 0, 0], [0, 0, 0]]))), None);
    let equal = with("offDetector", json!([[3.0, 4.0], [3.0, 4.0], [3.0, 4.0]]));
    assert_eq!(poses(&equal), None);
    let found = parsed(&equal).unwrap().scanner;
    assert_eq!(found, parsed(&with("offDetector", json!([3.0, 4.0]))).unwrap().scanner);
    assert_eq!(poses(&with("DSO", json!([500.0, 500.0, 500.0]))), None);
    for (field, value) in [("COR", json!([0.0, 1.0])), ("offDetector", json!([[0, 0], [1, 0]]))] {
        let message = refused(&with(field, value));
        assert!(message.contains("got 2, expected 3: 3 training views, then 0 test views"), "{message}");
    }
    let mut two = with("COR", json!([0.0, 1.0]));
    two["scanner"]["DSO"] = json!([500.0, 510.0, 520.0]);
    assert!(refused(&two).contains("COR: got 2 entries"), "{}", refused(&two));
    assert!(refused(&with("offDetector", json!([1.0, 2.0, 3.0]))).contains("2 numbers, one per axis"));
}

/// The vectors of ASTRA and the matrices of the same poses, in millimetres.
#[test]
fn vectors_and_matrices_state_whole_poses() {
    let scanner = parsed(&description()).unwrap().scanner;
    let poses_of = expected(|i, d| Deviation {
        turns: [0.1, -0.2, 0.3],
        axis_shift: 0.2,
        heights: [0.1 * i as f64, 0.05],
        offset: [0.1, 0.2],
        ..d
    });
    let vector = |pose: &Pose| pose.vector(&scanner.detector).map(|x| 100.0 * x);
    let vectors: Vec<_> = poses_of.iter().map(vector).collect();
    assert_near(poses(&with("vectors", json!(vectors))), &poses_of);
    let matrices: Vec<_> = poses_of.iter().map(|pose| matrix(pose, &scanner)).collect();
    let negative = matrices[1].map(|row| row.map(|x| -2.5 * x));
    assert_near(poses(&with("matrices", json!([matrices[0], negative, matrices[2]]))), &poses_of);
    // In the views themselves, without angle, DSO and DSD.
    let mut description = description();
    for i in 0..3 {
        description["proj_train"][i] = json!({"file_path": "a.npy", "vector": vectors[i]});
    }
    let fields = description["scanner"].as_object_mut().unwrap();
    fields.remove("DSO");
    fields.remove("DSD");
    assert_near(poses(&description), &poses_of);
    let found = parsed(&description).unwrap();
    assert!(matches!(found.scanner.beam, Beam::Cone { dsd, .. } if (dsd - 7.0).abs() < 0.7), "{:?}", found.scanner);
    assert!(found.listed.iter().zip(&poses_of).all(|(angle, pose)| (angle - pose.angle()).abs() < 1e-12));
    description["proj_train"][1] = json!({"file_path": "a.npy", "angle": 1.0});
    assert!(refused(&description).contains("vector of the views: got 2 of them"));

    let mut wrong = vectors.clone();
    wrong[1][6] *= 3.0;
    let message = refused(&with("vectors", json!(wrong)));
    assert!(message.contains("view 1: length of u of a vector"), "{message}");
    let message = refused(&with("vectors", json!([vectors[0][..11].to_vec()])));
    assert!(message.contains("got 11 numbers, expected 12 numbers: source"), "{message}");
    let mut twice = with("vectors", json!(vectors));
    twice["scanner"]["COR"] = json!(1.0);
    assert!(refused(&twice).contains("one statement of the poses"));
    let mut skew = matrices.clone();
    skew[2][0][1] += 1000.0;
    assert!(refused(&with("matrices", json!(skew))).contains("view 2"));
    assert!(refused(&with("vectors", json!(vectors[..2]))).contains("got 2, expected 3"));
}

/// From millimetres to (column, row) times the depth.
fn matrix(pose: &Pose, scanner: &trgs_core::geometry::Scanner) -> [[f64; 4]; 3] {
    let view = pose.view(scanner, 0.0);
    let Beam::Cone { dsd, .. } = view.beam else { panic!("a cone") };
    let (row, column) = view.detector.pixel(0.0, 0.0);
    let pixels = [
        view.u * (dsd / view.detector.pitch_u) + view.w * column,
        view.v * (dsd / view.detector.pitch_v) + view.w * row,
        view.w,
    ];
    pixels.map(|p| [p.x, p.y, p.z, -p.dot(view.source) * 100.0])
}

#[test]
fn fields_that_are_not_read_are_remarks_or_errors() {
    let oddities = |description: &Value| parsed(description).unwrap().oddities;
    assert_eq!(oddities(&description()), [""; 0]);
    let message = refused(&with("offDetecor", json!([12.0, 0.0])));
    assert!(
        message.contains("field offDetecor of scanner") && message.contains("did you mean offDetector?"),
        "{message}"
    );
    let neutral = oddities(&with("offDetecor", json!([0.0, 0.0])));
    assert!(neutral[0].contains("offDetecor") && neutral[0].contains("moves nothing"), "{neutral:?}");
    assert_eq!(oddities(&with("kV", json!(80))), ["the field kV of scanner is not read"]);
    let mut other = description();
    other["COR"] = json!(14.0);
    assert!(refused(&other).contains("field COR of the file"), "{}", refused(&other));
    let mut other = description();
    other["operator"] = json!("me");
    for i in 0..3 {
        other["proj_train"][i]["exposure"] = json!(0.5);
    }
    let found = oddities(&other);
    assert_eq!(found.len(), 2, "{found:?}");
    assert!(found[1].contains("exposure of proj_train"), "{found:?}");
    other["proj_train"][2]["roll"] = json!(0.1);
    assert!(refused(&other).contains("field roll of proj_train"));
    // Generators' fields say nothing about where anything is.
    let mut known = with("accuracy", json!(0.5));
    known["scanner"]["convert"] = json!(true);
    assert_eq!(oddities(&known), [""; 0]);
}

#[test]
fn backslashes_in_file_names_are_slashes() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("scan");
    super::tests::sample().write(&path).unwrap();
    let file = path.join("meta_data.json");
    let text = std::fs::read_to_string(&file).unwrap();
    let before = Dataset::read(&path).unwrap();
    std::fs::write(&file, text.replace("proj_train/", "proj_train\\\\").replace("proj_test/", "proj_test\\\\"))
        .unwrap();
    assert_ne!(std::fs::read_to_string(&file).unwrap(), text);
    assert_eq!(Dataset::read(&path).unwrap(), before);
}

/// `tests/data/naf_odd.pickle`, from `reference/generate/make_pickles.py`: degrees, COR for each view, and entries that
/// nobody needs: a date, a set, texts in an array, a large number, a class.
#[test]
fn a_pickle_with_odd_entries_is_read_and_says_so() {
    let content = include_bytes!("../../../tests/data/naf_odd.pickle");
    let scan = Dataset::parse_pickle(content, Path::new("odd.pickle")).unwrap();
    let text = scan.oddities.join("\n");
    for part in ["field date", "field tags", "field names", "field big", "field path", "train is not read"] {
        assert!(text.contains(part), "{part} is missing in {text}");
    }
    let poses = scan.train.poses.as_ref().unwrap();
    let shift = |i: usize| poses[i].source.dot(poses[i].u) / scan.scale * 1000.0;
    assert!((shift(0) - 1.0).abs() < 1e-9 && (shift(1) - 2.0).abs() < 1e-9, "{} {}", shift(0), shift(1));
    let test = scan.test.unwrap();
    let third = test.poses.as_ref().unwrap()[0];
    assert!((third.source.dot(third.u) / scan.scale * 1000.0 - 3.0).abs() < 1e-9);
}
