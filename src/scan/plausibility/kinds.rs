//! Each kind of scan that contradicts itself is found, with a remedy that mends it, and sound scans are none of them.

use super::sentences as remarks;
use super::*;
use crate::Noise;
use crate::phantom::{PHANTOMS, Phantom};
use crate::simulate::{Object, Orbit, Plan, simulate, simulate_on};
use std::f64::consts::{PI, TAU};
use trgs_core::geometry::{Beam, Detector, Grid, Projections, Scanner};

fn scanner() -> Scanner {
    let detector = Detector { rows: 26, columns: 28, pitch_v: 0.15, pitch_u: 0.15, offset_u: 0.0, offset_v: 0.0 };
    Scanner { beam: Beam::Cone { dso: 5.0, dsd: 7.0 }, detector, grid: Grid::cube(16) }
}

fn scan_of(name: &str, noise: Noise) -> Dataset {
    let plan = Plan { views: 12, test_views: 3, noise, seed: 1 };
    let phantom = Phantom::by_name(name, 0).unwrap();
    simulate(name, Object::Phantom(&phantom), &scanner(), &plan).unwrap()
}

/// A scan without truth and test views, whose volume can be exchanged.
fn measured() -> Dataset {
    Dataset { truth: None, test: None, ..scan_of("torso", Noise::LOW) }
}

fn refused(dataset: &Dataset, from: AnglesFrom) -> String {
    check(dataset, from).unwrap_err().to_string()
}

#[test]
fn sound_scans_have_no_remark() {
    for phantom in PHANTOMS {
        for noise in [Noise::None, Noise::HIGH] {
            let scan = scan_of(phantom.name, noise);
            // Noise at the border of the detector is the matter of `truncation`.
            let found: Vec<String> =
                remarks(&scan).into_iter().filter(|remark| !remark.contains("than the detector")).collect();
            assert_eq!(found, [""; 0], "{} {noise}", phantom.name);
            check(&scan, AnglesFrom::File).unwrap();
        }
    }
}

#[test]
fn degrees_taken_as_radians_are_refused_with_both_remedies() {
    let sound = measured();
    let with = |of: &dyn Fn(f64) -> f64| {
        let mut scan = sound.clone();
        scan.train.angles.iter_mut().for_each(|angle| *angle = of(*angle));
        scan
    };
    let degrees = with(&f64::to_degrees);
    for (from, parts) in [
        (AnglesFrom::File, ["multiply every angle of proj_train", "whole turns"]),
        (AnglesFrom::Stack, ["`degrees`", "`radians`"]),
        (AnglesFrom::Argument, ["numpy.deg2rad", "numpy.mod"]),
    ] {
        let message = refused(&degrees, from);
        assert!(message.starts_with("angles: got 0 to 330, which look like degrees"), "{message}");
        assert!(parts.iter().all(|part| message.contains(part)), "{message}");
    }
    assert_eq!(remarks(&degrees), [refused(&degrees, AnglesFrom::File)]);
    // Degrees that begin late, test views alone, and an arc of a tomosynthesis.
    assert!(check(&with(&|angle| angle.to_degrees() + 1e4), AnglesFrom::File).is_err());
    assert!(check(&with(&|angle| (angle / 6.0).to_degrees() - 30.0), AnglesFrom::File).is_err());
    let of_test = Dataset { test: Some(degrees.train.clone()), ..sound.clone() };
    assert!(check(&of_test, AnglesFrom::File).is_err());
    // Negative angles, two turns, and three turns of a helix are radians.
    for sound in [with(&|angle| -angle), with(&|angle| 2.0 * angle), with(&|angle| angle - TAU)] {
        check(&sound, AnglesFrom::File).unwrap();
    }
    let plan = Plan { views: 12, test_views: 0, noise: Noise::None, seed: 0 };
    let torso = Phantom::by_name("torso", 0).unwrap();
    let orbit = Orbit { turns: 3.0, pitch: 0.3, ..Orbit::CIRCLE };
    check(&simulate_on("torso", Object::Phantom(&torso), &scanner(), &plan, &orbit).unwrap(), AnglesFrom::File)
        .unwrap();

    let mut turns = vec![0.0, 3.0 * TAU + 0.5];
    within_a_turn(&mut turns);
    assert!((turns[1] - 0.5).abs() < 1e-12 && turns[0] == 0.0, "{turns:?}");
    let mut usual = vec![-0.5, 1.0];
    within_a_turn(&mut usual);
    assert_eq!(usual, [-0.5, 1.0]);
}

#[test]
fn views_without_an_object_are_refused() {
    let sound = measured();
    for value in [0.0, 1.5, -2.0] {
        let mut scan = sound.clone();
        scan.train.images.fill(value);
        let message = refused(&scan, AnglesFrom::File);
        assert!(message.contains(&format!("got the value {value} in every pixel")), "{message}");
    }
    let mut scan = sound.clone();
    scan.train.images.outer_iter_mut().enumerate().for_each(|(view, mut image)| image.fill(view as f32));
    assert!(refused(&scan, AnglesFrom::File).contains("from 0 to 11"));
    scan.train.images[[3, 2, 1]] += 1.0;
    check(&scan, AnglesFrom::File).unwrap();
}

#[test]
fn a_reversed_sign_is_told_from_air_below_zero() {
    for name in ["torso", "teapot", "axes"] {
        for noise in [Noise::None, Noise::HIGH] {
            let sound = scan_of(name, noise);
            let mut reversed = sound.clone();
            reversed.train.images.mapv_inplace(|value| -value);
            let message = refused(&reversed, AnglesFrom::File);
            assert!(message.contains("change their sign") && message.contains("ln(I0/I)"), "{name}: {message}");
            for air in [-0.02, -0.1, -0.4, 0.3] {
                let mut scan = sound.clone();
                scan.train.images += air;
                check(&scan, AnglesFrom::File).unwrap();
            }
        }
    }
}

#[test]
fn a_scan_of_one_row_has_its_border_left_and_right() {
    let detector = Detector { rows: 1, columns: 28, pitch_v: 0.15, pitch_u: 0.15, offset_u: 0.0, offset_v: 0.0 };
    let grid = Grid::new([16, 16, 1], [-1.0, -1.0, -0.06].into(), [1.0, 1.0, 0.06].into()).unwrap();
    let scanner = Scanner { detector, grid, ..scanner() };
    let torso = Phantom::by_name("torso", 0).unwrap();
    let plan = Plan { views: 12, test_views: 0, noise: Noise::LOW, seed: 1 };
    let mut scan = simulate("torso", Object::Phantom(&torso), &scanner, &plan).unwrap();
    assert_eq!(remarks(&scan), [""; 0]);
    scan.train.images.mapv_inplace(|value| -value);
    assert!(refused(&scan, AnglesFrom::File).contains("change their sign"));
}

/// The sizes that a remark says to set.
fn sizes(remark: &str, name: &str) -> [f64; 3] {
    // Air that is not 0 looks like an object that is cut off: then the size is the least.
    let remark = remark.replace(" to at least [", " to [");
    let (_, rest) = remark.split_once(&format!("{name} to [")).unwrap_or_else(|| panic!("{remark}"));
    let numbers = rest.split_once(']').unwrap().0.split(", ").map(|number| number.parse().unwrap());
    numbers.collect::<Vec<f64>>().try_into().unwrap()
}

#[test]
fn an_object_larger_than_the_volume_is_found_and_the_size_said_holds_it() {
    let sound = measured();
    let within = |half: [f64; 3]| Grid::new([8, 8, 8], half.map(|x| -x).into(), half.into()).unwrap();
    let larger = |scan: &Dataset| {
        remarks(scan).into_iter().filter(|remark| remark.contains("larger than the volume")).collect::<Vec<_>>()
    };
    for half in [[0.4; 3], [0.4, 0.4, 1.0], [1.0, 1.0, 0.4]] {
        // Air that is not 0 looks like an object that is cut off above, of which a volume may be a slab.
        let airs = if half[0] < 1.0 { [0.0, 0.2] } else { [0.0; 2] };
        for (air, scale) in airs.into_iter().zip([1.0, 0.01]) {
            let mut scan = Dataset { scale, ..sound.clone() };
            scan.scanner.grid = within(half);
            scan.train.images += air;
            let found = larger(&scan);
            assert_eq!(found.len(), 1, "{half:?} {air}: {found:?}");
            // The mass outside is no other scale of the volume.
            let truth = Phantom::by_name("torso", 0).unwrap().voxelize(&scan.scanner.grid, 2);
            let with_truth = Dataset { truth: Some(truth), ..scan.clone() };
            assert!(!remarks(&with_truth).iter().any(|remark| remark.contains("times the mass")), "{half:?} {air}");
            let (size, count) = (sizes(&found[0], "sVoxel").map(|size| size * scale), sizes(&found[0], "nVoxel"));
            for axis in 0..3 {
                let (voxel, before) = (size[axis] / count[axis], 2.0 * half[axis] / 8.0);
                assert!((voxel / before - 1.0).abs() < 1e-3, "{found:?}");
                // Not smaller than before, and not larger than the object's diagonal needs.
                assert!(size[axis] >= 2.0 * half[axis] - 1e-9 && size[axis] < 3.0, "{found:?}");
            }
            let (_, margin) = found[0].split_once("model.margin to ").unwrap();
            let margin: f64 = margin.split_once(',').unwrap().0.parse().unwrap();
            // A layer that wide holds it, a quarter of it does not, and the width that is said stays the same.
            let with = |margin| {
                let remarks = remarks_with(&scan, margin).into_iter().map(|remark| remark.to_string());
                remarks.filter(|remark| remark.contains("larger than the volume")).collect::<Vec<_>>()
            };
            assert_eq!(with(margin), [""; 0], "{half:?} {air} {margin}");
            assert!(
                with(margin / 4.0)[0].contains(&format!("model.margin to {margin:.2},")),
                "{half:?} {air} {margin}"
            );
            scan.scanner.grid = within(half).with_margin(margin);
            assert_eq!(larger(&scan), [""; 0], "{half:?} {air} {margin}");
            scan.scanner.grid = within(size.map(|size| size / 2.0));
            assert_eq!(larger(&scan), [""; 0], "{half:?} {air} {size:?}");
        }
    }
    // A pixel that errs in all views is no object.
    let mut scan = sound;
    scan.train.images.outer_iter_mut().for_each(|mut image| image[[1, 1]] = 9.0);
    assert_eq!(larger(&scan), [""; 0]);
}

#[test]
fn copies_of_views_and_test_views_that_were_seen_are_found() {
    let scan = scan_of("torso", Noise::LOW);
    let told = |scan: &Dataset| remarks(scan).join("\n");
    let leaked = Dataset { test: Some(scan.train.select(&[0, 4, 8])), ..scan.clone() };
    assert!(told(&leaked).starts_with("3 test views of 3 are training views, as test view 0 and training view 0"));
    // Of the same image, the angle may be another.
    let mut turned = leaked;
    turned.test.as_mut().unwrap().angles[1] += 0.1;
    assert!(told(&turned).starts_with("3 test views"), "{}", told(&turned));
    // At the same angle, the image may differ by its noise.
    let mut anew = turned;
    anew.test.as_mut().unwrap().images *= 1.01;
    assert!(told(&anew).starts_with("2 test views of 3 are training views"), "{}", told(&anew));
    let twice = Dataset { train: scan.train.select(&[0, 1, 2, 3, 4, 5, 6, 6, 8, 9, 10, 11]), ..scan.clone() };
    let found = remarks(&twice);
    assert!(
        found[0].contains("1 training view has the image of another one, bit by bit, as views 6 and 7"),
        "{found:?}"
    );
    assert!(
        found[1].contains("1 training view has the angle of another one, as views 6 and 7 at 180.00°"),
        "{found:?}"
    );
    // The end of a full turn repeats its beginning, measured anew; empty frames are no copies.
    let mut closed = scan.clone();
    closed.train.angles[11] = TAU;
    closed.train.images.index_axis_mut(ndarray::Axis(0), 1).fill(0.0);
    closed.train.images.index_axis_mut(ndarray::Axis(0), 2).fill(0.0);
    assert!(!told(&closed).contains("another one"), "{}", told(&closed));
}

#[test]
fn an_arc_of_a_few_degrees_is_said() {
    let scan = |span: f64| {
        let mut scan = measured();
        scan.train.angles.iter_mut().for_each(|angle| *angle *= span / TAU);
        remarks(&scan).into_iter().filter(|remark| remark.contains("converted from degrees twice")).collect::<Vec<_>>()
    };
    let found = scan(TAU * PI / 180.0);
    assert!(found[0].contains("span 5.76° only") && found[0].contains("57.29577951308232"), "{found:?}");
    assert_eq!(scan(0.5), [""; 0]);
    let mut few = measured();
    few.train =
        Projections::new(few.train.angles[..2].iter().map(|a| a * 0.1).collect(), few.train.select(&[0, 1]).images)
            .unwrap();
    assert!(!remarks(&few).join(" ").contains("twice"));
}
