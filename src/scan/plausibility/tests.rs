//! Sound scans have no remark, and each kind of remark is made where it is due.

use super::sentences as remarks;
use crate::Noise;
use crate::dataset::Dataset;
use crate::phantom::{PHANTOMS, Phantom};
use crate::simulate::{Object, Plan, simulate};
use trgs_core::geometry::{Beam, Detector, Grid, Scanner};

fn scanner(columns: usize, offset_u: f64) -> Scanner {
    let detector = Detector { rows: 40, columns, pitch_v: 0.1, pitch_u: 0.09, offset_u, offset_v: 0.0 };
    Scanner { beam: Beam::Cone { dso: 5.0, dsd: 7.0 }, detector, grid: Grid::cube(24) }
}

fn scan(columns: usize, offset_u: f64) -> Dataset {
    let plan = Plan { views: 18, test_views: 4, noise: Noise::LOW, seed: 1 };
    let phantom = Phantom::by_name("torso", 0).unwrap();
    simulate("torso", Object::Phantom(&phantom), &scanner(columns, offset_u), &plan).unwrap()
}

fn only(dataset: &Dataset) -> String {
    let found = remarks(dataset);
    assert_eq!(found.len(), 1, "{found:?}");
    found.into_iter().next().unwrap()
}

#[test]
fn a_sound_scan_has_no_remark() {
    for (columns, offset) in [(44, 0.05), (28, 0.9)] {
        let scan = scan(columns, offset);
        assert_eq!(remarks(&scan), [""; 0], "{columns}");
        // Scaled counts of a file in other units are no whole numbers of the file.
        assert_eq!(remarks(&Dataset { scale: 0.37, ..scan }), [""; 0]);
    }
}

#[test]
fn readings_are_told_from_line_integrals() {
    let mut scan = scan(44, 0.0);
    scan.test = None;
    let line_integrals = scan.train.images.clone();
    let transmission = |p: f32| trgs_core::numeric::elementary::exp(-f64::from(p));
    scan.train.images = line_integrals.mapv(|p| (60_000.0 * transmission(p)).round() as f32);
    let found = only(&scan);
    for part in ["all of them whole numbers", "instead of 0", "`flat` FLAT", "`white` 59990 ", "trgs convert"] {
        assert!(found.contains(part), "{part}: {found}");
    }
    scan.train.images = line_integrals.mapv(|p| transmission(p) as f32);
    let found = only(&scan);
    assert!(found.contains("at their border, is 0.99") && !found.contains("whole"), "{found}");
    scan.train.images = line_integrals.mapv(|p| (100.0 * p).round());
    let found = remarks(&scan);
    assert!(found[0].contains("whole numbers") && !found[0].contains("instead of 0"), "{found:?}");
}

#[test]
fn scales_that_differ_are_found() {
    let sound = scan(44, 0.0);
    let mut other = sound.clone();
    other.test.as_mut().unwrap().images *= 1e-3;
    assert!(only(&other).contains("times as large as the test views"), "{}", only(&other));
    let mut other = sound.clone();
    other.truth.as_mut().unwrap().values *= 0.1;
    assert!(only(&other).contains("times the mass of the true volume"), "{}", only(&other));
    let mut other = sound;
    other.truth.as_mut().unwrap().values.mapv_inplace(|mu| 1000.0 * (mu - 1.0));
    let found = only(&other);
    assert!(found.contains("Hounsfield") && found.contains("`mu_water`"), "{found}");
}

#[test]
fn sound_stand_ins_have_no_remark() {
    let scanner = Scanner::synthetic(16, 32);
    for (k, named) in PHANTOMS.iter().enumerate() {
        for noise in [Noise::None, Noise::HIGH] {
            let plan = Plan { views: [12, 18][k % 2], test_views: 0, noise, seed: 3 };
            let phantom = Phantom::by_name(named.name, 0).unwrap();
            let scan = simulate(named.name, Object::Phantom(&phantom), &scanner, &plan).unwrap();
            assert_eq!(remarks(&scan), [""; 0], "{} {noise}", named.name);
        }
    }
}

#[test]
fn air_is_named_with_what_it_explains() {
    let sound = scan(44, 0.0);
    let mut offset = sound.clone();
    // The views see far more than the mass of the true volume, and every border far more than 0.
    offset.train.images += 0.5;
    let found = only(&offset);
    for part in ["air is 0.", "at all four borders in all 18 views", "0.60", "`air` auto", "`flat`", "`white`"] {
        assert!(found.contains(part), "{part}: {found}");
    }
    offset.train.images -= 1.0;
    let found = only(&offset);
    assert!(found.contains("air is -0."), "{found}");
    let mut drifting = sound;
    for (view, mut image) in drifting.train.images.outer_iter_mut().enumerate() {
        image += 0.03 * (view as f32 / 8.5 - 1.0);
    }
    let found = only(&drifting);
    assert!(found.contains("air varies over the views, from -0.0") && found.contains("drifts"), "{found}");
}

#[test]
fn single_views_that_differ_are_named() {
    let sound = scan(44, 0.0);
    let with = |view: usize, change: fn(f32) -> f32| {
        let mut scan = sound.clone();
        scan.train.images.index_axis_mut(ndarray::Axis(0), view).mapv_inplace(change);
        only(&scan)
    };
    let blank = with(7, |_| 0.0);
    assert!(blank.starts_with("view 7 counted from 0 (8 from 1) is blank: all pixels have one value"), "{blank}");
    let open = with(3, |value| 0.001 * value);
    assert!(open.starts_with("view 3 counted from 0 (4 from 1) is without the object"), "{open}");
    let dark = with(0, |value| 11.0 + 0.001 * value);
    assert!(dark.starts_with("view 0 counted from 0 (1 from 1) is without beam"), "{dark}");
    let exposure = with(11, |value| value + 0.3);
    assert!(
        exposure.starts_with("view 11 counted from 0 (12 from 1) is different") && exposure.contains("`air`"),
        "{exposure}"
    );
    let damaged = {
        let mut scan = sound.clone();
        scan.train.images[[5, 20, 20]] = 1e30;
        only(&scan)
    };
    assert!(damaged.contains("first 1.000e30 in view 5 (counted from 0), row 20, column 20"), "{damaged}");
}
