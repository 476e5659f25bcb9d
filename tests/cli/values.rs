//! Values that cannot be right are refused or warned of, with numbers and the remedy to type.

use crate::program::{Sandbox, stderr};
use ndarray::{Array2, Array3, Axis};
use serde_json::json;
use std::f64::consts::PI;
use std::process::Output;
use trgs::geometry::{Beam, Detector, Grid, Scanner};
use trgs::numeric::elementary::exp;
use trgs::scan::Noise;
use trgs::scan::dataset::Dataset;
use trgs::scan::npy;
use trgs::scan::phantom::Phantom;
use trgs::scan::simulate::{Object, Plan, simulate};

const ROWS: usize = 16;
const COLUMNS: usize = 20;

/// A small scan of the torso: 12 views of 16 × 20 pixels over a full turn.
fn scan() -> Dataset {
    let detector = Detector { rows: ROWS, columns: COLUMNS, pitch_v: 0.25, pitch_u: 0.2, offset_u: 0.0, offset_v: 0.0 };
    let scanner = Scanner { beam: Beam::Cone { dso: 5.0, dsd: 7.0 }, detector, grid: Grid::cube(12) };
    let plan = Plan { views: 12, test_views: 3, noise: Noise::None, seed: 1 };
    simulate("scan", Object::Phantom(&Phantom::by_name("torso", 0).unwrap()), &scanner, &plan).unwrap()
}

/// Readings of the scan's training views with 40,000 counts in air.
fn counts() -> Array3<f32> {
    scan().train.images.mapv(|p| (40_000.0 * exp(-f64::from(p))).round() as f32)
}

/// A sandbox with the frames in the folder `frames`, named by `name`, and their description.
fn with_frames(frames: &Array3<f32>, name: impl Fn(usize) -> String) -> Sandbox {
    let sandbox = Sandbox::new();
    std::fs::create_dir(sandbox.path("frames")).unwrap();
    for (view, frame) in frames.outer_iter().enumerate() {
        npy::write(&sandbox.path(&format!("frames/{}.npy", name(view))), frame).unwrap();
    }
    let meta = json!({ "scanner": { "mode": "cone", "DSD": 7, "DSO": 5, "nDetector": [ROWS, COLUMNS], "sDetector": [4, 4],
        "nVoxel": [12, 12, 12], "sVoxel": [2, 2, 2], "offOrigin": [0, 0, 0], "offDetector": [0, 0],
        "totalAngle": 360.0, "startAngle": 0.0 } });
    sandbox.write("meta.json", meta.to_string());
    npy::write(&sandbox.path("flat.npy"), Array2::from_elem((ROWS, COLUMNS), 40_000.0_f32).view()).unwrap();
    sandbox
}

/// Runs a command that must succeed; returns what it said.
fn said(sandbox: &Sandbox, arguments: &str) -> String {
    let output = sandbox.run(arguments);
    assert_eq!(output.status.code(), Some(0), "{arguments}: {}", stderr(&output));
    stderr(&output)
}

/// The one error that ended a command, after any warnings.
fn error(output: &Output) -> String {
    let said = stderr(output);
    assert_eq!(output.status.code(), Some(2), "{said}");
    let errors: Vec<&str> = said.lines().filter(|line| line.starts_with("error: ")).collect();
    assert_eq!(errors.len(), 1, "{said}");
    errors[0].into()
}

#[test]
fn fdk_refuses_a_displaced_detector_on_a_short_scan() {
    let sandbox = Sandbox::new();
    let mut scan = scan();
    (scan.scanner.detector.columns, scan.scanner.detector.pitch_u, scan.scanner.detector.offset_u) = (26, 0.1, 0.9);
    let angles = Scanner::uniform_angles(60, 0.0, 3.7);
    scan.train = Phantom::by_name("torso", 0).unwrap().project(&scan.scanner, &angles).unwrap();
    (scan.test, scan.truth) = (None, None);
    scan.write(&sandbox.path("scan")).unwrap();
    let message = error(&sandbox.run("reconstruct scan --out run --method fdk"));
    for part in ["got 212.0° with a displaced detector", "expected 360.0°", "sart", "tr-gs"] {
        assert!(message.contains(part), "{part}: {message}");
    }
    assert_eq!(sandbox.names(), ["scan"]);
    let output = sandbox.run("reconstruct scan --out run --method sart --iterations 1");
    assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
    assert!(stderr(&output).contains("warning: scan: the object is wider than the detector: cut off at the left"));
}

#[test]
fn missing_frames_are_named_and_the_span_is_stated() {
    let without_5 = counts().select(Axis(0), &[0, 1, 2, 3, 5, 6, 7, 8, 9, 10, 11]);
    let number = |view: usize| if view < 4 { view + 1 } else { view + 2 };
    let sandbox = with_frames(&without_5, |view| format!("proj_{}", number(view)));
    let text = said(&sandbox, "convert frames scan --scanner meta.json --flat flat.npy");
    assert!(
        text.contains("warning: frames: number 5 is missing between 1 and 12 (11 frames for 12 numbers)"),
        "{text}"
    );
    assert!(text.contains("11 views from 0.00° to 327.27°, in steps of 32.73°"), "{text}");
    let angles = |numbers: &[usize]| {
        let lines: Vec<String> = numbers.iter().map(|n| format!("{n},{}", 30 * (n - 1))).collect();
        sandbox.write("angles.csv", format!("frame,angle_deg\n{}\n", lines.join("\n")));
    };
    angles(&[1, 2, 3, 4, 6, 7, 8, 9, 10, 11, 12]);
    let text = said(&sandbox, "convert frames scan --scanner meta.json --flat flat.npy --angles angles.csv --degrees");
    assert!(text.contains("11 views from 0.00° to 330.00°, in steps of 30.00° to 60.00°"), "{text}");
    let found = Dataset::read(sandbox.path("scan")).unwrap().train.angles;
    within!((found[4] - 5.0 * PI / 6.0).abs(), "{found:?}");

    let forgot = error(&sandbox.run("convert frames scan --scanner meta.json --flat flat.npy --angles angles.csv"));
    assert!(forgot.contains("got degrees, expected radians; add --degrees"), "{forgot}");
    angles(&[1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12]);
    let message =
        error(&sandbox.run("convert frames scan --scanner meta.json --flat flat.npy --angles angles.csv --degrees"));
    assert!(message.contains("got 12, expected one for each of 11 frames; give 11 angles"), "{message}");
}

#[test]
fn a_field_among_the_frames_is_no_view() {
    let sandbox = with_frames(&counts(), |view| format!("{view:04}"));
    let plain = said(&sandbox, "convert frames scan --scanner meta.json --flat flat.npy");
    assert!(!plain.contains("warning"), "{plain}");
    let expected = Dataset::read(sandbox.path("scan")).unwrap();
    for name in ["flat.npy", "x.npy"] {
        std::fs::copy(sandbox.path("flat.npy"), sandbox.path(&format!("frames/{name}"))).unwrap();
        let text = said(&sandbox, "convert frames again --scanner meta.json --flat flat.npy");
        assert!(text.contains(&format!("frames: {name} is left out of the frames: it is the flat field")), "{text}");
        assert!(text.contains("12 views from"), "{text}");
        let found = Dataset::read(sandbox.path("again")).unwrap();
        assert_eq!(found.train, expected.train);
        std::fs::remove_file(sandbox.path(&format!("frames/{name}"))).unwrap();
    }
}

#[test]
fn saturated_readings_are_counted() {
    let cut = counts().mapv(|reading| (1.8 * reading).min(65_535.0).round());
    let sandbox = with_frames(&cut, |view| format!("{view:04}"));
    let text = said(&sandbox, "convert frames scan --scanner meta.json --flat flat.npy");
    let count = cut.iter().filter(|reading| **reading == 65_535.0).count();
    let share = 100.0 * count as f64 / cut.len() as f64;
    let expected = format!("{count} readings of the frames ({share:.2} %) are 65535, the largest number of 16 bits");
    assert!(count > 0 && text.contains(&expected), "{expected}: {text}");
    npy::write(&sandbox.path("flat.npy"), Array2::from_elem((ROWS, COLUMNS), 65_535.0_f32).view()).unwrap();
    let text = said(&sandbox, "convert frames again --scanner meta.json --flat flat.npy");
    assert!(text.contains("flat.npy: 320 readings of the flat field (100.00 %) are 65535"), "{text}");
}

#[test]
fn readings_as_line_integrals_are_warned_of_with_the_remedy() {
    let sandbox = Sandbox::new();
    let mut scan = scan();
    scan.train.images = counts();
    scan.write(&sandbox.path("scan")).unwrap();
    let found = sandbox.done("inspect scan");
    let oddities: Vec<&str> = found["oddities"].as_array().unwrap().iter().map(|o| o.as_str().unwrap()).collect();
    let remedy = "trgs convert FRAMES SCAN --scanner meta_data.json --flat FLAT, or --white 40000 without a flat field";
    assert!(oddities[0].contains("whole numbers") && oddities[0].contains(remedy), "{oddities:?}");
    assert!(oddities[1].contains("times as large as the test views"), "{oddities:?}");
    let text = said(&sandbox, "reconstruct scan --out run --method fdk");
    assert!(text.contains("warning: scan: training views have values from") && text.contains(remedy), "{text}");
    // The remedy works.
    let text = said(&sandbox, "convert scan/proj_train good --scanner scan/meta_data.json --white 40000");
    assert!(!text.contains("warning"), "{text}");
    assert_eq!(sandbox.done("inspect good")["oddities"], json!([]));
}

#[test]
fn hounsfield_units_are_warned_of_and_converted() {
    let sandbox = Sandbox::new();
    let hounsfield = Array3::from_shape_fn((10, 10, 10), |(x, y, z)| {
        let inside = [x, y, z].iter().all(|i| (3..7).contains(i));
        if inside { 500.0_f32 } else { -1000.0 }
    });
    npy::write(&sandbox.path("hu.npy"), hounsfield.view()).unwrap();
    let small = "--detector 12 --views 3 --test-views 1";
    let text = said(&sandbox, &format!("simulate --volume hu.npy --out wrong {small}"));
    assert!(text.contains("values from -1000 to 500, 93.6 % of them below -200"), "{text}");
    assert!(text.contains("--mu-water 1") && !text.contains('`'), "{text}");
    let text = said(&sandbox, &format!("simulate --volume hu.npy --mu-water 0.4 --out right {small}"));
    assert!(!text.contains("warning"), "{text}");
    let truth = Dataset::read(sandbox.path("right")).unwrap().truth.unwrap().values;
    assert_eq!((truth[[0, 0, 0]], truth[[5, 5, 5]]), (0.0, 0.6));
    said(&sandbox, "convert hu.npy mu.npy --mu-water 0.4");
    assert_eq!(sandbox.read("mu.npy"), sandbox.read("right/vol_gt.npy"));
    let oddities = sandbox.done("inspect wrong")["oddities"].to_string();
    assert!(oddities.contains("Hounsfield") && oddities.contains("trgs convert IN OUT --mu-water 1"), "{oddities}");
    let text = said(&sandbox, "convert mu.npy twice.npy --mu-water 0.4");
    assert!(text.contains("is this attenuation already?"), "{text}");
    for (flags, part) in
        [("mu.npy bad.npy --mu-water 0", "--mu-water: got 0"), ("right bad --mu-water 1", "--mu-water")]
    {
        assert!(sandbox.refused(&format!("convert {flags}")).contains(part), "{flags}");
    }
}

#[test]
fn remedies_of_paths_follow_from_their_cause() {
    let sandbox = Sandbox::with_scan();
    sandbox.write("text.npy", "no array");
    for (command, remedy) in [
        ("inspect nothing.npy", "correct the name"),
        ("inspect here/there/x.npy", "correct the path: the folder here does not exist"),
        ("inspect scan/Vol_GT.npy", "give scan/vol_gt.npy: names distinguish capitals"),
        ("evaluate scan/vol_gt.npy --against SCAN", "give scan: names distinguish capitals"),
        ("inspect text.npy", "copy or write it again"),
    ] {
        let message = sandbox.refused(command);
        assert!(message.contains(remedy) && !message.contains("permissions"), "{command}: {message}");
    }
}

#[test]
fn rays_and_measuring_chain_are_chosen_and_noted_in_the_scan() {
    let sandbox = Sandbox::with_scan();
    let scan = |flags: &str| {
        let small = "--views 3 --test-views 1 --detector 12";
        let done = sandbox.done(&format!("simulate --volume scan/vol_gt.npy {small} --out {flags}"));
        (done["notes"].to_string(), done["noise"].to_string(), Dataset::read(sandbox.path(&flags[..1])).unwrap())
    };
    let (notes, _, plain) = scan("a --rays trilinear");
    assert_eq!(notes, "null");
    let (notes, _, siddon) = scan("b --rays siddon --helix 0.3,2");
    assert!(notes.contains("Siddon") && siddon.notes.len() == 1 && siddon.truth == plain.truth);
    assert!(siddon.train.images != plain.train.images);
    let (notes, noise, measured) = scan("c --realistic scatter=0.2,axis=0 --rays joseph");
    assert!(notes.contains("Joseph") && notes.contains("scatter=0.2") && noise == "\"low\"", "{notes}");
    assert_eq!(measured.notes.len(), 2);
    assert_eq!(scan("d --realistic --noise none").1, "\"none\"");
    for (flags, words) in [
        ("--phantom torso --rays trilinear", "error: --rays: got a phantom, expected a volume"),
        ("--phantom torso --realistic --noise low,physical", "depth=0"),
    ] {
        let message = sandbox.refused(&format!("simulate {flags} --size 8 --detector 8 --out other"));
        assert!(message.contains(words), "{flags}: {message}");
    }
}
