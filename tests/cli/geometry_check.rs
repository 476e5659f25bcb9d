//! The check of a scan's geometry finds every deliberate fault, and reports what it cannot decide.

use crate::program::{Sandbox, stderr};
use glam::DVec3;
use ndarray::{Array3, Axis};
use std::f64::consts::{FRAC_PI_2, PI, TAU};
use std::ops::ControlFlow;
use trgs::Text;
use trgs::classical::check_geometry;
use trgs::classical::geometry_check::{Candidate, Convention, GeometryCheck};
use trgs::geometry::{Beam, Detector, Grid, Projections, Scanner};
use trgs::numeric::threads;
use trgs::scan::phantom::solid::{Shape, Solid};
use trgs::scan::simulate::{Object, Orbit, Plan, simulate_measured, simulate_on};
use trgs::scan::{Chain, Dataset, Noise, Phantom};

const CONE: Beam = Beam::Cone { dso: 4.0, dsd: 6.0 };
const PARALLEL: Beam = Beam::Parallel { dso: 4.0 };

/// A detector that sees the whole cube.
fn scanner(beam: Beam, rows: usize, columns: usize) -> Scanner {
    let side = if beam == PARALLEL { 2.9 } else { 4.4 };
    let (pitch_v, pitch_u) = (side / rows as f64, side / columns as f64);
    let detector = Detector { rows, columns, pitch_v, pitch_u, offset_u: 0.0, offset_v: 0.0 };
    Scanner { beam, detector, grid: Grid::cube(24) }
}

/// A scan of a phantom with a little noise and without its true volume.
fn scan_of(phantom: &Phantom, scanner: &Scanner, angles: &[f64]) -> Dataset {
    let train = Noise::LOW.apply(&phantom.project(scanner, angles).unwrap(), 5).unwrap();
    Dataset { noise: Noise::LOW, ..Dataset::new(phantom.name.as_str(), *scanner, train) }
}

/// The sentences of a verdict.
fn said(check: &GeometryCheck) -> String {
    check.verdict.iter().map(Text::to_string).collect::<Vec<_>>().join(" ")
}

fn axes() -> Phantom {
    Phantom::by_name("axes", 0).unwrap()
}

fn turn(views: usize) -> Vec<f64> {
    Scanner::uniform_angles(views, 0.3, TAU)
}

fn with_truth(mut scan: Dataset, phantom: &Phantom) -> Dataset {
    scan.truth = Some(phantom.voxelize(&scan.scanner.grid, 2));
    scan
}

/// The scan as a program that follows `convention` would write it.
fn written_as(scan: &Dataset, convention: &Convention) -> Dataset {
    let mut images = scan.train.images.clone();
    if convention.rows_reversed {
        images.invert_axis(Axis(1));
    }
    if convention.columns_reversed {
        images.invert_axis(Axis(2));
    }
    if convention.transposed {
        images.swap_axes(1, 2);
    }
    let sign = if convention.rotation_reversed { -1.0 } else { 1.0 };
    let angle = |angle: &f64| if convention.degrees { (sign * angle).to_degrees() } else { sign * angle };
    Dataset { train: Projections::new(scan.train.angles.iter().map(angle).collect(), images).unwrap(), ..scan.clone() }
}

fn checked(scan: &Dataset) -> GeometryCheck {
    check_geometry(scan, &mut |_| ControlFlow::Continue(())).unwrap()
}

/// Asserts the findings for a scan written in a convention, with the true volume.
fn assert_found(scan: &Dataset, convention: &Convention) {
    let check = checked(&written_as(scan, convention));
    let words = convention.words();
    assert_eq!(check.looks_like, *convention, "{words}: {:?}", check.verdict);
    assert_eq!(check.agrees, *convention == Convention::AS_STATED, "{words}: {:?}", check.verdict);
    for remedy in convention.remedies() {
        assert!(check.verdict[0].to_string().contains(remedy), "{words}: {:?}", check.verdict);
    }
    within!(check.offset_u.found.abs(), "{words}: {:?}", check.offset_u);
    // The views alone determine the class, whatever the truth.
    for candidate in &check.candidates {
        let same = candidate.convention.looks_like(convention, &scan.scanner.beam);
        assert_eq!((candidate.class == 1, candidate.told_apart), (same, !same), "{words}: {candidate:?}");
    }
}

#[test]
fn every_fault_of_the_images_and_of_the_rotation_is_found() {
    let scan = with_truth(scan_of(&axes(), &scanner(CONE, 26, 26), &turn(18)), &axes());
    // Images that are not transposed: the next test, on another detector.
    for convention in Convention::all(true, false) {
        if convention.transposed || convention == Convention::AS_STATED {
            assert_found(&scan, &convention);
        }
    }
}

#[test]
fn faults_of_a_detector_that_is_no_square_are_found() {
    let torso = Phantom::by_name("torso", 0).unwrap();
    let scan = with_truth(scan_of(&torso, &scanner(CONE, 32, 26), &turn(18)), &torso);
    for convention in Convention::all(false, false) {
        assert_found(&scan, &convention);
    }
}

#[test]
fn without_a_reference_the_simplest_of_a_class_are_named() {
    let scan = scan_of(&axes(), &scanner(CONE, 26, 26), &turn(18));
    let verdict = |number: usize| {
        let check = checked(&written_as(&scan, &Convention::all(true, false)[number]));
        assert_eq!(check.agrees, number == 1, "{:?}", check.verdict);
        said(&check)
    };
    // Reversed rows equal the rows of a mirrored object.
    let rows = verdict(1);
    assert!(
        rows.contains("agree with the conventions as stated") && rows.contains("from rows from the bottom up;"),
        "{rows}"
    );
    let columns = verdict(2);
    assert!(columns.contains("look like columns mirrored, or rotation in the opposite sense:"), "{columns}");
    assert!(columns.contains("image[:, ::-1], or change the sign of every angle."), "{columns}");
    let transposed = verdict(8);
    assert!(transposed.contains("look like images transposed:") && transposed.contains("image.T"), "{transposed}");
}

/// The residuals of members are computed one by one, so this is a property of scans, not of the check.
#[test]
fn conventions_of_a_class_have_the_same_residual() {
    for (beam, classes) in [(CONE, 4), (PARALLEL, 2)] {
        let mut scanner = scanner(beam, 26, 26);
        scanner.detector.offset_u = 0.7 * scanner.detector.pitch_u;
        scanner.detector.offset_v = if beam == CONE { -1.2 * scanner.detector.pitch_v } else { 0.0 };
        let check = checked(&scan_of(&axes(), &scanner, &turn(18)));
        assert!(check.agrees, "{:?}", check.verdict);
        let mut least = Vec::new();
        for class in 1..=classes {
            let of = |c: &&Candidate| c.class == class;
            let residuals: Vec<f64> = check.candidates.iter().filter(of).map(|c| c.residual).collect();
            assert_eq!(residuals.len(), 16 / classes);
            for residual in &residuals {
                within!((residual / residuals[0] - 1.0).abs(), "{beam:?} {class}: {residuals:?}");
            }
            least.push(residuals[0]);
        }
        least.iter().skip(1).for_each(|other| beyond!("other classes", other / least[0], "{beam:?}: {least:?}"));
        assert_eq!(check.candidates.iter().map(|c| c.class).max(), Some(classes));
    }
}

#[test]
fn displaced_detectors_are_found_to_a_fifth_of_a_pixel() {
    // The actual and the stated offset, pixels.
    let cases = [
        (CONE, 40, -3.3, -3.3),
        (CONE, 40, -3.3, 0.0),
        (CONE, 40, 0.0, 0.0),
        (CONE, 40, 1.7, 0.0),
        (CONE, 40, 1.7, -1.7),
        (CONE, 80, 1.7, 0.0),
        (PARALLEL, 36, -3.3, 0.0),
        (PARALLEL, 36, 1.7, 1.7),
    ];
    for (beam, columns, pixels, stated) in cases {
        let mut scanner = scanner(beam, 28, columns);
        scanner.detector.offset_u = pixels * scanner.detector.pitch_u;
        let mut scan = scan_of(&axes(), &scanner, &turn(20));
        scan.scanner.detector.offset_u = stated * scanner.detector.pitch_u;
        scan.scale = 0.01;
        let check = checked(&scan);
        let sentences = said(&check);
        within!((check.offset_u.found - pixels).abs(), "{beam:?} {pixels}: {:?}", check.offset_u);
        assert_eq!(check.agrees, stated == pixels, "{sentences}");
        let set = check.off_detector[0] * scan.scale / scanner.detector.pitch_u;
        within!((set - pixels).abs(), "{:?}", check.off_detector);
        assert_eq!(sentences.contains("opposite sign"), stated == -pixels && pixels != 0.0, "{sentences}");
        assert_eq!(sentences.contains("Set offDetector"), stated != pixels, "{sentences}");
    }
}

#[test]
fn a_detector_displaced_along_v_is_found_in_a_cone_beam_and_left_alone_in_a_parallel_one() {
    let mut scanner = scanner(CONE, 48, 34);
    scanner.detector.offset_v = 2.4 * scanner.detector.pitch_v;
    let mut scan = scan_of(&axes(), &scanner, &turn(18));
    let sound = checked(&scan);
    let along_v = sound.offset_v.as_ref().unwrap();
    // The minimum is shallow, but the stated uncertainty holds.
    let near = |found: f64| (found - 2.4).abs() < 2.0 * along_v.uncertainty;
    within!(along_v.uncertainty, "{along_v:?}");
    assert!(sound.agrees && near(along_v.found), "{:?}", sound.verdict);
    scan.scanner.detector.offset_v *= -1.0;
    let wrong = checked(&scan);
    assert!(!wrong.agrees, "{:?}", wrong.verdict);
    assert_eq!(wrong.looks_like, Convention::AS_STATED);
    // Reversed rows with the offset as stated are the scan of a mirrored object.
    assert!(near(wrong.offset_v.unwrap().found), "{:?}", wrong.verdict);
    assert!(near(-wrong.off_detector[1] / scanner.detector.pitch_v), "{:?}", wrong.off_detector);

    let mut scanner = self::scanner(PARALLEL, 34, 34);
    scanner.detector.offset_v = 1.5 * scanner.detector.pitch_v;
    let mut scan = scan_of(&axes(), &scanner, &turn(18));
    scan.scanner.detector.offset_v = 0.0;
    let check = checked(&scan);
    assert!(check.agrees && check.offset_v.is_none(), "{:?}", check.verdict);
    assert!(said(&check).contains("parallel"), "{:?}", check.verdict);
}

#[test]
fn parallel_rays_over_half_a_turn_tell_transposed_images_and_nothing_else() {
    let scan = scan_of(&axes(), &scanner(PARALLEL, 26, 26), &Scanner::uniform_angles(16, 0.3, PI));
    for number in [2, 4, 8, 12] {
        let convention = Convention::all(true, false)[number];
        let written = written_as(&scan, &convention);
        let check = checked(&written);
        assert_eq!(check.looks_like.transposed, convention.transposed, "{:?}", check.verdict);
        assert_eq!(check.agrees, !convention.transposed, "{:?}", check.verdict);
        // With the truth, only half a turn remains, which equals mirrored columns.
        let check = checked(&with_truth(written, &axes()));
        let found = check.looks_like;
        let half = check.candidates[0].resemblance.unwrap().quarter_turns == 2;
        assert_eq!(found.columns_reversed != half, convention.columns_reversed, "{:?}", check.verdict);
        assert_eq!(found.rotation_reversed, convention.rotation_reversed, "{:?}", check.verdict);
        assert!(!check.agrees, "{:?}", check.verdict);
    }
}

#[test]
fn the_true_volume_or_points_from_it_tell_where_the_angles_begin() {
    let late: Vec<f64> = turn(18).iter().map(|angle| angle + FRAC_PI_2).collect();
    let mut scan = scan_of(&axes(), &scanner(CONE, 26, 26), &late);
    scan.train.angles = turn(18);
    assert!(checked(&scan).agrees);
    let check = checked(&with_truth(scan.clone(), &axes()));
    assert!(!check.agrees && check.looks_like == Convention::AS_STATED, "{:?}", check.verdict);
    assert!(
        check.verdict[0].to_string().contains("begin 90° too early: ")
            || check.verdict[0].to_string().contains("add 1.570796"),
        "{:?}",
        check.verdict
    );

    let truth = axes().voxelize(&scan.scanner.grid, 2);
    let bright: Vec<[f64; 4]> = truth
        .values
        .indexed_iter()
        .filter(|(_, value)| **value > 0.05)
        .map(|((x, y, z), &value)| {
            let centre = truth.grid.centre([x, y, z]);
            [centre.x, centre.y, centre.z, f64::from(value)]
        })
        .collect();
    scan.initial_points = Some(bright.into());
    let check = checked(&scan);
    assert!(!check.agrees && check.candidates[0].resemblance.unwrap().quarter_turns == 1, "{:?}", check.verdict);
    assert!(said(&check).contains("made from these views"), "{:?}", check.verdict);
}

#[test]
fn degrees_that_are_read_as_radians_are_recognised() {
    let scan = scan_of(&axes(), &scanner(CONE, 26, 26), &turn(18));
    let convention = Convention { degrees: true, ..Convention::AS_STATED };
    let check = checked(&written_as(&scan, &convention));
    assert_eq!((check.looks_like, check.agrees), (convention, false), "{:?}", check.verdict);
    assert!(check.verdict[0].to_string().contains("radians"), "{:?}", check.verdict);
    assert_eq!(check.candidates.len(), 32);
}

#[test]
fn a_body_of_revolution_does_not_tell_and_what_is_stated_stands() {
    let ball = Phantom {
        name: "ball".into(),
        solids: vec![Solid::new(Shape::Ellipsoid, 0.6, DVec3::ZERO, DVec3::splat(0.6))],
    };
    let check = checked(&scan_of(&ball, &scanner(CONE, 34, 34), &turn(18)));
    assert!(check.agrees && check.looks_like == Convention::AS_STATED, "{:?}", check.verdict);
    assert!(said(&check).contains("do not exclude"), "{:?}", check.verdict);
    // A ball does not determine the height of the detector either.
    assert_eq!(check.off_detector, [0.0, 0.0], "{:?}", check.verdict);
}

#[test]
fn what_no_convention_explains_is_not_approved() {
    let mut scan = scan_of(&axes(), &scanner(CONE, 26, 26), &turn(18));
    // Every angle belongs to another view.
    scan.train.angles = (0..18).map(|i| turn(18)[i * 7 % 18]).collect();
    let check = checked(&scan);
    assert!(!check.agrees, "{:?}", check.verdict);
    assert!(
        check.verdict[0].to_string().contains("No convention explains") && !check.is_explained,
        "{:?}",
        check.verdict
    );
    // Nothing is said about the place of a detector that no place explains.
    let said = said(&check);
    assert!(!["rotDetector", "offDetector", "rolled", "pixel"].iter().any(|word| said.contains(word)), "{said}");
}

/// Two bodies that are nearly of revolution together: a roll shows weakly, and errors of the data look like one.
fn nearly_round() -> Phantom {
    let solid =
        |density, centre: [f64; 3], half: [f64; 3]| Solid::new(Shape::Ellipsoid, density, centre.into(), half.into());
    let solids = vec![
        solid(0.5, [0.0; 3], [0.62, 0.5, 0.7]),
        solid(0.4, [0.25, 0.1, 0.1], [0.2, 0.15, 0.2]),
        solid(0.3, [-0.25, 0.0, -0.2], [0.15, 0.2, 0.12]),
    ];
    Phantom { name: "nearly round".into(), solids }
}

fn rolled(phantom: &Phantom, degrees: f64) -> Dataset {
    let orbit = Orbit { roll: degrees.to_radians(), ..Orbit::CIRCLE };
    let plan = Plan { views: 20, test_views: 0, noise: Noise::LOW, seed: 2 };
    let mut scan = simulate_on("round", Object::Phantom(phantom), &scanner(CONE, 32, 32), &plan, &orbit).unwrap();
    (scan.train.poses, scan.truth) = (None, None);
    scan
}

/// A change of all images.
type Fault<'a> = &'a dyn Fn(&mut Array3<f32>);

#[test]
fn errors_of_the_data_are_no_roll_and_no_offset() {
    let sound = rolled(&nearly_round(), 0.0);
    let hot = |images: &mut Array3<f32>, [v, u]: [usize; 2]| {
        images.outer_iter_mut().for_each(|mut image| image[[v, u]] = 1.5);
    };
    let faults: [(&str, Fault<'_>, [usize; 2]); 4] = [
        ("a hot pixel", &|images| hot(images, [11, 13]), [1, 0]),
        ("three of them", &|images| [[11, 13], [9, 20], [20, 10]].into_iter().for_each(|at| hot(images, at)), [3, 0]),
        ("a column", &|images| images.index_axis_mut(Axis(2), 12).mapv_inplace(|value| value + 0.1), [0, 1]),
        (
            "drift and air",
            &|images| {
                for (view, mut image) in images.outer_iter_mut().enumerate() {
                    image.mapv_inplace(|value| value + 0.1 + 0.06 * (view as f32 / 7.0 - 1.0));
                }
            },
            [0, 0],
        ),
    ];
    for (name, fault, [single, columns]) in faults {
        let mut scan = sound.clone();
        // Files of another unit of length.
        scan.scale = 0.5;
        fault(&mut scan.train.images);
        let check = checked(&scan);
        let verdict = said(&check);
        assert!(check.agrees && check.is_explained, "{name}: {verdict}");
        assert!(!verdict.contains("set rotDetector") && !verdict.contains("Set offDetector"), "{name}: {verdict}");
        within!("roll, standard errors", (check.roll.found / check.roll.uncertainty).abs(), "{name}: {verdict}");
        let wrong = &check.wrong_pixels;
        assert_eq!((wrong.single.len(), wrong.columns.len()), (single, columns), "{name}: {wrong:?}");
        assert_eq!(verdict.contains("In all views"), single + columns > 0, "{name}: {verdict}");
        assert_eq!(verdict.contains("Air reads 0.08"), single + columns == 0, "{name}: {verdict}");
    }
}

#[test]
fn a_roll_is_found_beside_a_hot_pixel() {
    let mut scan = rolled(&Phantom::by_name("torso", 0).unwrap(), 2.0);
    scan.train.images.outer_iter_mut().for_each(|mut image| image[[11, 13]] = 1.5);
    let check = checked(&scan);
    assert!(!check.agrees && said(&check).contains("set rotDetector"), "{:?}", check.verdict);
    within!((check.roll.found - 2.0).abs(), "{:?}", check.roll);
}

#[test]
fn twelve_views_are_enough_and_three_are_refused() {
    let torso = Phantom::by_name("torso", 0).unwrap();
    let scan = scan_of(&torso, &scanner(CONE, 34, 34), &turn(12));
    let reversed = Convention { rotation_reversed: true, ..Convention::AS_STATED };
    let check = checked(&written_as(&scan, &reversed));
    assert!(!check.agrees && check.looks_like.looks_like(&reversed, &CONE), "{:?}", check.verdict);
    assert!(checked(&scan).agrees);
    let few = Dataset { train: scan.train.select(&[0, 4, 8]), ..scan.clone() };
    let refused = check_geometry(&few, &mut |_| ControlFlow::Continue(())).unwrap_err().to_string();
    assert!(refused.contains("training views: got 3, expected at least 4"), "{refused}");
    let mut nothing = scan.clone();
    nothing.train.images.fill(0.0);
    assert!(check_geometry(&nothing, &mut |_| ControlFlow::Continue(())).unwrap_err().to_string().contains("zeros"));
    let stopped = check_geometry(&scan, &mut |_| ControlFlow::Break(())).unwrap_err().to_string();
    assert!(stopped.contains("interrupted"), "{stopped}");
}

#[test]
fn the_number_of_threads_changes_no_bit() {
    let scan = with_truth(scan_of(&axes(), &scanner(CONE, 20, 20), &turn(9)), &axes());
    let run = || checked(&scan);
    assert_eq!(threads::install(1, run).unwrap(), threads::install(3, run).unwrap());
}

#[test]
fn the_program_says_what_is_wrong_and_exits_with_it() {
    let sandbox = Sandbox::new();
    sandbox.done("simulate --phantom axes --out scan --size 24 --detector 34 --views 15 --test-views 0 --noise low");
    let found = sandbox.done("inspect scan --check-geometry");
    assert_eq!((&found["agrees"], &found["candidates"][0]["words"]), (&true.into(), &"as stated".into()));
    assert_eq!(found["candidates"].as_array().unwrap().len(), 16);
    within!(found["offset_u"]["found"].as_f64().unwrap().abs(), "{found}");
    assert!(sandbox.run("inspect scan --check-geometry --quiet").stderr.is_empty());

    // Air is not 0, and the rotation has the other sense.
    let mut wrong = Dataset::read(sandbox.path("scan")).unwrap();
    wrong.train.images += 0.1;
    wrong.write(&sandbox.path("wrong")).unwrap();
    sandbox.edit("wrong/meta_data.json", |meta| {
        for view in meta["proj_train"].as_array_mut().unwrap() {
            view["angle"] = (-view["angle"].as_f64().unwrap()).into();
        }
    });
    let output = sandbox.run("inspect wrong --check-geometry");
    let text = String::from_utf8(output.stdout).unwrap();
    let reads = ["Air reads 0.1", "Air reads 0.09"].iter().any(|reading| text.contains(reading));
    assert!(reads && text.contains("or give --air auto."), "{text}");
    assert_eq!(output.status.code(), Some(1), "{text}");
    assert!(
        text.contains("The data look like rotation in the opposite sense") && text.contains("every angle"),
        "{text}"
    );
    assert!(stderr(&sandbox.run("inspect wrong --check-geometry")).contains("step 7 of 7"));
    let json = sandbox.run("inspect wrong --check-geometry --json");
    let json: serde_json::Value = serde_json::from_slice(&json.stdout).unwrap();
    assert_eq!(json["looks_like"]["rotation_reversed"], true);

    sandbox.edit("scan/meta_data.json", |meta| meta["proj_train"].as_array_mut().unwrap().truncate(3));
    assert!(sandbox.refused("inspect scan --check-geometry").contains("training views"));
    assert!(sandbox.refused("inspect nowhere --check-geometry").contains("nowhere"));
}

/// A scan on an orbit that the files do not state. Four pixels of the detector become one of the check's.
fn unstated(orbit: &Orbit, noise: Noise) -> Dataset {
    let plan = Plan { views: 18, test_views: 0, noise, seed: 0 };
    let torso = Phantom::by_name("torso", 0).unwrap();
    let mut scan = simulate_on("torso", Object::Phantom(&torso), &Scanner::synthetic(32, 96), &plan, orbit).unwrap();
    scan.train.poses = None;
    scan
}

/// Asserts that the roll and the shift of the axis are found, and that their uncertainties are true.
fn assert_moved(orbit: &Orbit, noise: Noise) -> GeometryCheck {
    let scan = unstated(orbit, noise);
    let check = checked(&scan);
    let GeometryCheck { roll, axis_shift, .. } = &check;
    let of_roll = (roll.found - orbit.roll.to_degrees()).abs();
    within!("roll", of_roll, "{roll:?}");
    within!("roll, standard errors", of_roll / roll.uncertainty, "{roll:?}");
    let of_shift = (axis_shift.found - orbit.axis_shift).abs();
    within!("shift", of_shift / scan.scanner.detector.pitch_u, "{axis_shift:?}");
    within!("shift, standard errors", of_shift / axis_shift.uncertainty, "{axis_shift:?}");
    assert_eq!(
        (check.looks_like, check.agrees),
        (Convention::AS_STATED, *orbit == Orbit::CIRCLE),
        "{:?}",
        check.verdict
    );
    check
}

#[test]
fn rolls_and_axis_shifts_are_found() {
    let moved = |degrees: f64, axis_shift| Orbit { roll: degrees.to_radians(), axis_shift, ..Orbit::CIRCLE };
    assert_moved(&Orbit::CIRCLE, Noise::HIGH);
    let verdict = said(&assert_moved(&moved(0.5, 0.0), Noise::HIGH));
    assert!(verdict.contains("set rotDetector to [0, 0, -0.0") && !verdict.contains("COR"), "{verdict}");
    let verdict = said(&assert_moved(&moved(0.0, 0.08), Noise::LOW));
    assert!(verdict.contains("COR 0.0") && !verdict.contains("rotDetector"), "{verdict}");
    let verdict = said(&assert_moved(&moved(-1.5, -0.05), Noise::LOW));
    assert!(verdict.contains("COR -0.0") && verdict.contains("rotDetector"), "{verdict}");
}

#[test]
fn a_roll_is_found_with_parallel_rays() {
    let scanner = scanner(PARALLEL, 48, 48);
    let orbit = Orbit { roll: (-0.8_f64).to_radians(), ..Orbit::CIRCLE };
    let plan = Plan { views: 18, test_views: 0, noise: Noise::LOW, seed: 0 };
    let mut scan = simulate_on("axes", Object::Phantom(&axes()), &scanner, &plan, &orbit).unwrap();
    assert!(checked(&scan).agrees);
    scan.train.poses = None;
    let check = checked(&scan);
    within!((check.roll.found + 0.8).abs(), "{:?}", check.roll);
    assert!(!check.agrees, "{:?}", check.verdict);
}

/// The verdict's numbers in the description make the scan agree.
#[test]
fn the_remedies_of_a_roll_and_a_shifted_axis_are_right() {
    let sandbox = Sandbox::new();
    sandbox.done(
        "simulate --phantom torso --out scan --size 24 --detector 48 --views 15 --test-views 0 --noise low --roll 0.9 \
         --axis-shift 0.09",
    );
    let stated = sandbox.done("inspect scan --check-geometry");
    assert_eq!(stated["agrees"], true, "{stated}");
    within!("as stated", (stated["roll"]["stated"].as_f64().unwrap() - 0.9).abs());
    sandbox.edit("scan/meta_data.json", |meta| {
        let scanner = meta["scanner"].as_object_mut().unwrap();
        for field in ["vectors", "COR", "rotDetector"] {
            scanner.remove(field);
        }
        for view in meta["proj_train"].as_array_mut().unwrap() {
            view.as_object_mut().unwrap().remove("vector");
        }
    });
    let output = sandbox.run("inspect scan --check-geometry --json");
    let found: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!((output.status.code(), &found["agrees"]), (Some(1), &false.into()), "{found}");
    let verdict = found["verdict"].to_string();
    let number = |before: &str, after: &str| -> f64 {
        let (_, rest) = verdict.split_once(before).unwrap_or_else(|| panic!("{verdict}"));
        rest.split_once(after).unwrap().0.parse().unwrap()
    };
    let (roll, shift) = (number("rotDetector to [0, 0, ", "]"), number("COR ", " "));
    sandbox.edit("scan/meta_data.json", |meta| {
        meta["scanner"]["rotDetector"] = serde_json::json!([0.0, 0.0, roll]);
        meta["scanner"]["COR"] = shift.into();
    });
    let corrected = sandbox.done("inspect scan --check-geometry");
    assert_eq!(corrected["agrees"], true, "{corrected}");
    within!("corrected", (corrected["roll"]["stated"].as_f64().unwrap() - 0.9).abs());
    within!("residual", corrected["roll"]["residual"].as_f64().unwrap() / stated["roll"]["residual"].as_f64().unwrap());
}

#[test]
fn the_check_of_a_helix_is_refused_with_the_reason() {
    let orbit = Orbit { turns: 2.0, pitch: 0.1, ..Orbit::CIRCLE };
    let plan = Plan { views: 6, test_views: 0, noise: Noise::None, seed: 0 };
    let scan = simulate_on("axes", Object::Phantom(&axes()), &scanner(CONE, 20, 20), &plan, &orbit).unwrap();
    let refused = check_geometry(&scan, &mut |_| ControlFlow::Continue(())).unwrap_err().to_string();
    assert!(refused.contains("a circle around z") && refused.contains("helix"), "{refused}");
}

/// The axis error of a measuring chain is found where it was put, beside hardening, scatter, blur and rings.
#[test]
fn the_axis_error_of_a_measured_scan_is_found() {
    let plan = Plan { views: 12, test_views: 0, noise: Noise::LOW, seed: 5 };
    let (phantom, scanner, chain) = (axes(), scanner(CONE, 32, 32), Chain::default());
    let object = Object::Phantom(&phantom);
    let scan = simulate_measured("axes", object, &scanner, &plan, &Orbit::CIRCLE, &chain).unwrap();
    let check = checked(&scan);
    // An axis that is off by a pixel of the detector is off by dso/dsd of it in space.
    let found = check.axis_shift.found / scanner.detector.pitch_u * 6.0 / 4.0;
    within!((found - chain.axis).abs(), "{found}: {:?}", check.verdict);
}
