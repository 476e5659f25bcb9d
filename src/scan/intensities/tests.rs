use super::*;
use crate::tolerances::{largest, relative};
use ndarray::Axis;
use std::f64::consts::LN_2;
use trgs_core::numeric::elementary::exp;

const VIEWS: usize = 3;
const ROWS: usize = 5;
const COLUMNS: usize = 8;
/// Relative rounding error of single precision.
const ROUNDING: f64 = 1.0 / 16_777_216.0;

/// Line integrals with air on the left of view 0 only; in other views the object fills the detector.
fn truth(view: usize, row: usize, column: usize) -> f64 {
    let body = 0.1 * row as f64 + 0.03 * (column * column) as f64;
    match view {
        0 if column < 2 => 0.0,
        0 => body,
        view => body + 0.7 * view as f64,
    }
}

fn readings(reading: impl Fn(usize, usize, usize) -> f64) -> Array3<f32> {
    Array3::from_shape_fn((VIEWS, ROWS, COLUMNS), |(view, row, column)| reading(view, row, column) as f32)
}

fn correction(white: White) -> Correction {
    Correction { dark: None, white, air: None }
}

/// The largest error of line integrals, in units of the rounding error of one reading and one result.
fn error(found: &Array3<f32>, expected: impl Fn(usize, usize, usize) -> f64, share_of_signal: f64) -> f64 {
    let of = |((view, row, column), &p): ((usize, usize, usize), &f32)| {
        let expected = expected(view, row, column);
        (f64::from(p) - expected).abs() / (ROUNDING * (1.0 / share_of_signal + expected.abs()))
    };
    found.indexed_iter().map(of).fold(0.0, f64::max)
}

#[test]
fn a_transmission_is_turned_into_a_line_integral() {
    for (transmission, expected) in [(1.0, 0.0), (0.125, 3.0 * LN_2), (4.0, -2.0 * LN_2)] {
        within!(relative(line_integral(transmission), expected));
    }
    for nothing in [FLOOR, 0.0, -0.5, f64::NAN] {
        within!(relative(line_integral(nothing), 16.0 * LN_2));
    }
}

#[test]
fn patterns_of_flat_and_dark_fields_are_taken_out() {
    let dark = |row: usize, column: usize| (100 + 7 * row + 3 * column) as f64;
    let flat = |row: usize, column: usize| (30_000 + 2000 * row - 900 * column) as f64;
    let stack = readings(|view, row, column| {
        dark(row, column) + (flat(row, column) - dark(row, column)) * exp(-truth(view, row, column))
    });
    // Three frames that differ, around the field.
    let frames = |field: &dyn Fn(usize, usize) -> f64| {
        let shape = (3, ROWS, COLUMNS);
        let frames =
            Array3::from_shape_fn(shape, |(i, row, column)| (field(row, column) + 16.0 * (i as f64 - 1.0)) as f32);
        mean_frame("field", &frames).unwrap()
    };
    let (flat, dark) = (frames(&flat), frames(&dark));
    assert_eq!((flat[[2, 1]], dark[[2, 1]]), (33_100.0, 117.0));
    let whole = Correction { dark: Some(dark.clone()), white: White::Flat(flat.clone()), air: None };
    let found = whole.apply(&stack).unwrap();
    // The darkest pixel reads 1100 above a dark field of 149: nine tenths of it are signal.
    let darkest = exp(-truth(2, ROWS - 1, COLUMNS - 1));
    let share = darkest * 31_000.0 / (darkest * 31_000.0 + 149.0);
    let worst = error(&found.line_integrals, truth, share);
    assert!(worst < 1.0, "{worst} of what rounding may do");
    assert_eq!((found.clamped, found.dead, found.drift, found.white), (0, 0, None, None));
    assert!(found.remarks.is_empty(), "{:?}", found.remarks);
    // Omitting either field must be noticed.
    let without = Correction { dark: None, ..whole };
    assert!(error(&without.apply(&stack).unwrap().line_integrals, truth, share) > 1000.0);
    let flatless = Correction { dark: Some(dark), white: White::Reading(30_000.0), air: None };
    assert!(error(&flatless.apply(&stack).unwrap().line_integrals, truth, share) > 1000.0);
}

#[test]
fn frames_by_themselves_lose_what_no_ray_of_theirs_misses() {
    let stack = readings(|view, row, column| 52_000.0 * exp(-truth(view, row, column)));
    for white in [White::OfStack, White::Reading(52_000.0)] {
        let found = correction(white.clone()).apply(&stack).unwrap();
        assert!(error(&found.line_integrals, truth, 1.0) < 1.0, "{white:?}");
        assert_eq!(found.white, Some(52_000.0));
    }
    let found = correction(White::OfFrame).apply(&stack).unwrap();
    assert!(found.remarks[0].contains("contradict each other"), "{:?}", found.remarks);
    // View 0 sees air; the most transparent rays of the others pass through 0.7 and 1.4.
    let lost = |view: usize, row: usize, column: usize| truth(view, row, column) - 0.7 * view as f64;
    assert!(error(&found.line_integrals, lost, 0.5) < 1.0);
    assert!(error(&found.line_integrals, truth, 1.0) > 1e6);
}

#[test]
fn a_thousandth_of_hot_pixels_is_not_the_beam() {
    let mut stack = Array3::from_elem((2, 30, 50), 1000.0_f32);
    (stack[[0, 3, 4]], stack[[1, 7, 9]], stack[[1, 0, 0]]) = (60_000.0, 50_000.0, 250.0);
    for white in [White::OfStack, White::OfFrame] {
        let found = correction(white).apply(&stack).unwrap();
        assert_eq!(found.line_integrals[[1, 20, 20]], 0.0);
        within!(relative(f64::from(found.line_integrals[[1, 0, 0]]), 2.0 * LN_2));
        assert!(found.line_integrals[[0, 3, 4]] < -4.0, "brighter than the beam is left as it is");
    }
}

#[test]
fn drift_is_taken_out_by_air() {
    let beam = [1.0, 0.8, 1.3];
    let seen = |view: usize, row: usize, column: usize| if column < 2 { 0.0 } else { truth(view, row, column) };
    let stack = readings(|view, row, column| 40_000.0 * beam[view] * exp(-seen(view, row, column)));
    let air = Some(Air { rows: 1..ROWS, columns: 0..2 });
    for white in [White::OfStack, White::OfFrame, White::Flat(Array2::from_elem((ROWS, COLUMNS), 40_000.0))] {
        let fixed = Correction { air: air.clone(), ..correction(white.clone()) }.apply(&stack).unwrap();
        assert!(error(&fixed.line_integrals, seen, 0.5) < 1.0, "{white:?}");
    }
    let flat = White::Flat(Array2::from_elem((ROWS, COLUMNS), 40_000.0));
    let drifting = correction(flat.clone()).apply(&stack).unwrap();
    let wrong = |view: usize, row: usize, column: usize| seen(view, row, column) - log(beam[view]);
    assert!(error(&drifting.line_integrals, wrong, 0.5) < 1.0);
    let fixed = Correction { air, ..correction(flat) }.apply(&stack).unwrap();
    let [low, high] = fixed.drift.unwrap();
    within!(largest([low - 0.8, high - 1.3]), "{low} {high}");
    assert!(fixed.remarks[0].contains("a source that drifts"), "{:?}", fixed.remarks);
}

#[test]
fn readings_without_light_are_clamped_and_counted() {
    let dark = Some(Array2::from_elem((ROWS, COLUMNS), 100.0));
    let mut stack = readings(|_, _, _| 1100.0);
    // Below, at, and just above the dark field; the last transmits 2⁻¹⁵, which is above the floor.
    (stack[[0, 1, 1]], stack[[1, 4, 7]], stack[[2, 0, 0]], stack[[2, 0, 1]]) = (90.0, 100.0, 100.01, 100.031_25);
    let found = Correction { dark, ..correction(White::Reading(1124.0)) }.apply(&stack).unwrap();
    assert_eq!(found.clamped, 3);
    for at in [[0, 1, 1], [1, 4, 7], [2, 0, 0]] {
        assert_eq!(found.line_integrals[at], (16.0 * LN_2) as f32);
    }
    assert_eq!(found.line_integrals[[2, 0, 1]], (15.0 * LN_2) as f32);
    assert!(found.remarks[0].starts_with("3 readings (2.500 %)"), "{:?}", found.remarks);
}

#[test]
fn dead_pixels_have_the_median_of_their_neighbours() {
    let (rows, columns) = (9, 12);
    let mut flat = Array2::from_elem((rows, columns), 1000.0);
    // A single dead pixel, and a corner of four dead pixels whose corner pixel has no living neighbour.
    let dead = [[5, 6], [0, 0], [0, 1], [1, 0], [1, 1]];
    dead.iter().for_each(|&at| flat[at] = 3.0);
    let p = |row: usize, column: usize| 0.1 * (row * row) as f64 + 0.2 * column as f64;
    let frame = |(_, row, column): (usize, usize, usize)| (flat[[row, column]] * exp(-p(row, column))) as f32;
    let mut stack = Array3::from_shape_fn((2, rows, columns), frame);
    dead.iter().for_each(|&[row, column]| stack[[1, row, column]] = 60_000.0);
    let found = correction(White::Flat(flat.clone())).apply(&stack).unwrap();
    assert_eq!((found.dead, found.clamped), (5, 0));
    assert!(found.remarks[0].contains("5 dead pixels"), "{:?}", found.remarks);
    let median_of = |pixels: &[[usize; 2]]| {
        median(&mut pixels.iter().map(|&[row, column]| f64::from(p(row, column) as f32)).collect::<Vec<_>>())
    };
    let ring = [[4, 5], [4, 6], [4, 7], [5, 5], [5, 7], [6, 5], [6, 6], [6, 7]];
    let corner = [[0, 2], [1, 2], [2, 0], [2, 1], [2, 2]];
    for (at, expected) in [([5, 6], median_of(&ring)), ([0, 0], median_of(&corner))] {
        for view in 0..2 {
            let found = f64::from(found.line_integrals[[view, at[0], at[1]]]);
            assert!((found - expected).abs() < 4.0 * ROUNDING * (1.0 + expected), "{at:?}: {found}, {expected}");
        }
    }
    flat.row_mut(3).fill(0.0);
    let message = correction(White::Flat(flat)).apply(&stack).unwrap_err().to_string();
    assert!(message.contains("17 of 108 pixels"), "{message}");
}

#[test]
fn what_cannot_be_is_an_error_that_names_it() {
    let stack = readings(|_, _, _| 500.0);
    let refused = |correction: &Correction, stack: &Array3<f32>| correction.apply(stack).unwrap_err().to_string();
    let field = |value: f64| Array2::from_elem((ROWS, COLUMNS), value);
    let exchanged = Correction { dark: Some(field(900.0)), white: White::Flat(field(20.0)), air: None };
    assert!(refused(&exchanged, &stack).contains("exchange flat and dark field"));
    let dark = Correction { dark: Some(field(600.0)), ..correction(White::OfStack) };
    assert!(refused(&dark, &stack).contains("more than the dark field"));
    let other = correction(White::Flat(Array2::ones((COLUMNS, ROWS))));
    assert!(refused(&other, &stack).contains("flat field: got shape [8, 5], expected [5, 8] = [v, u]"));
    let outside = Correction { air: Some(Air { rows: 0..6, columns: 0..2 }), ..correction(White::OfStack) };
    assert!(refused(&outside, &stack).contains("within 5 rows and 8 columns"));
    let mut damaged = stack.clone();
    damaged[[1, 2, 3]] = f32::NAN;
    assert!(refused(&correction(White::OfStack), &damaged).contains("NaN at (1, 2, 3)"));
    let mut black = stack;
    black.index_axis_mut(Axis(0), 1).fill(0.0);
    let air = Correction { air: Some(Air { rows: 0..2, columns: 0..2 }), ..correction(White::Reading(500.0)) };
    assert!(refused(&air, &black).contains("frame 1"));
    assert!(refused(&correction(White::OfFrame), &black).contains("more than the dark field"));
    assert!(mean_frame("flat field", &Array3::zeros((0, 2, 2))).unwrap_err().to_string().contains("no frame"));
    for text in ["1,2,3", "0,0,0,5", "4,0,2,5", "a,b,c,d", "0,0,-1,3"] {
        assert!(text.parse::<Air>().is_err(), "{text}");
    }
    assert_eq!("0, 1,2,5".parse::<Air>().unwrap(), Air { rows: 0..2, columns: 1..5 });
}
