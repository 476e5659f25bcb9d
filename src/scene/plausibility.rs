//! Values of a scan held against each other and against what they must be.
//!
//! Not in the paper. Line integrals are 0 in air, and training views, test views and the true volume have one scale.
//! Attenuation is not far below 0. [`remarks`] says where a scan differs; it changes nothing.
//!
//! | remark | condition |
//! |---|---|
//! | readings instead of line integrals | the border of the mean view is its brightest part, and the object is darker |
//! | whole numbers | all training values are whole numbers, and at least [`LEVELS`] differ |
//! | another scale of the test views | the mean values differ by more than a factor of [`SCALE`] |
//! | another scale of the true volume | its mass and that seen by the views differ by more than a factor of [`SCALE`] |
//! | Hounsfield units | the true volume has values below [`super::hounsfield::IMPOSSIBLE`] |
//! | an object wider than the detector | see [`super::truncation`] |
//! | an object taller than the detector | see [`super::truncation`] |

use super::arrays::{Projections, Volume};
use super::borders::{Borders, Side};
use super::dataset::Dataset;
use super::geometry::{Beam, Scanner};
use super::hounsfield;
use super::truncation::{taller, wider};
use crate::numeric::reduce;
use crate::setting::Setting;

/// Range of whole numbers from which on they are remarked on.
pub const LEVELS: f64 = 16.0;
/// Ratio of scales that is remarked on.
pub const SCALE: f64 = 2.0;
/// A whole number, as far as single precision keeps it after scaling.
const WHOLE: f64 = 1e-6;
/// Air of readings: the border of the mean view, in units of the view's largest value, at least.
const AIR: f64 = 0.7;
/// The object in readings: the smallest value of the mean view, in units of its border, at most.
const SHADE: f64 = 0.8;

/// What is implausible about the values of a scan, one sentence each, with numbers and the remedy.
pub fn remarks(dataset: &Dataset) -> Vec<String> {
    let Dataset { scanner, scale, train, test, truth, .. } = dataset;
    let borders = Borders::of(train.images.view());
    let is_cut = Side::ALL.iter().any(|&side| borders.at(side).is_cut());
    let readings = readings(train, *scale);
    let are_readings = readings.is_some();
    let test_scale = test.as_ref().and_then(|test| scale_of_test(train, test));
    let hounsfield = truth.as_ref().and_then(|truth| hounsfield::remark("true volume", &truth.values));
    // The mass is only seen whole, and only attenuation has one.
    let mass = match truth {
        Some(truth) if !is_cut && !are_readings && hounsfield.is_none() => scale_of_truth(scanner, train, truth),
        _ => None,
    };
    let wide = if are_readings { None } else { wider(scanner, train, &borders) };
    let tall = if are_readings { None } else { taller(scanner, train, &borders) };
    [readings, test_scale, hounsfield, mass, wide, tall].into_iter().flatten().collect()
}

/// A remark on training views that are readings of a detector.
fn readings(train: &Projections, scale: f64) -> Option<String> {
    let images = &train.images;
    let (views, rows, columns) = images.dim();
    let (low, high) = ends(images.iter().map(|&value| f64::from(value) / scale));
    let is_whole = |value: &f32| {
        let value = f64::from(*value) / scale;
        (value - value.round()).abs() <= WHOLE * value.abs()
    };
    let whole = high - low >= LEVELS && images.iter().all(is_whole);
    let mean = |row: usize, column: usize| {
        reduce::sum_by(views, &|view| f64::from(images[[view, row, column]])) / views as f64 / scale
    };
    let pixels: Vec<f64> = (0..rows * columns).map(|pixel| mean(pixel / columns, pixel % columns)).collect();
    let (dark, bright) = ends(pixels.iter().copied());
    let at_border = |pixel: &usize| {
        let (row, column) = (pixel / columns, pixel % columns);
        row == 0 || column == 0 || row + 1 == rows || column + 1 == columns
    };
    let border: Vec<f64> = (0..pixels.len()).filter(at_border).map(|pixel| pixels[pixel]).collect();
    let air = reduce::sum(&border) / border.len().max(1) as f64;
    let shaded = air > 0.0 && air >= AIR * bright && dark <= SHADE * air;
    if !whole && !shaded {
        return None;
    }
    let short = |value: f64| if value.abs() < 100.0 { format!("{value:.4}") } else { format!("{value:.0}") };
    let mut what = vec![format!("training views have values from {} to {}", short(low), short(high))];
    if whole {
        what.push("all of them whole numbers".into());
    }
    if shaded {
        what.push(format!("and air, at their border, is {} instead of 0", short(air)));
    }
    Some(format!(
        "{}: they look like readings of a detector instead of line integrals; convert the frames first: \
         trgs convert FRAMES SCAN {} meta_data.json {} FLAT, or {} {} without a flat field",
        what.join(", "),
        Setting::Scanner,
        Setting::Flat,
        Setting::White,
        short(bright),
    ))
}

/// A remark on test views that are larger or smaller than the training views.
fn scale_of_test(train: &Projections, test: &Projections) -> Option<String> {
    let mean = |views: &Projections| {
        let values = views.images.as_slice().expect("projections are in C order");
        reduce::sum(values) / values.len() as f64
    };
    let (train, test) = (mean(train), mean(test));
    let ratio = train / test;
    (train > 0.0 && test > 0.0 && !(1.0 / SCALE..=SCALE).contains(&ratio)).then(|| {
        format!(
            "training views are {ratio:.3} times as large as the test views (mean {train:.4} and {test:.4}): the 2D \
             metrics compare different quantities; convert both in the same way"
        )
    })
}

/// A remark on a true volume of another scale than the views.
///
/// The integral over a parallel view is the mass of the object. In a cone beam it is magnified, by nearly (dsd/dso)².
fn scale_of_truth(scanner: &Scanner, train: &Projections, truth: &Volume) -> Option<String> {
    let values = |array: &ndarray::Array3<f32>| reduce::sum(array.as_slice().expect("arrays of scans are in C order"));
    let spacing = truth.grid.spacing;
    let mass = values(&truth.values) * spacing.x * spacing.y * spacing.z;
    let magnification = match scanner.beam {
        Beam::Cone { dso, dsd } => dsd / dso,
        Beam::Parallel { .. } => 1.0,
    };
    let pixel = scanner.detector.pitch_u * scanner.detector.pitch_v / (magnification * magnification);
    let seen = values(&train.images) * pixel / train.len() as f64;
    let ratio = seen / mass;
    (seen > 0.0 && mass > 0.0 && !(1.0 / SCALE..=SCALE).contains(&ratio)).then(|| {
        format!(
            "the training views see {ratio:.3} times the mass of the true volume: the unit of length, or that of the \
             densities, differs; divide the projections by {ratio:.3}, or correct sVoxel and sDetector"
        )
    })
}

/// The smallest and the largest value; infinite for none.
fn ends(values: impl Iterator<Item = f64>) -> (f64, f64) {
    values.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), value| {
        (if value < low { value } else { low }, if value > high { value } else { high })
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::phantom::Phantom;
    use crate::scene::simulate::{Object, Plan, simulate};
    use crate::scene::{Detector, Grid, Noise};

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
        let transmission = |p: f32| crate::numeric::elementary::exp(-f64::from(p));
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
}
