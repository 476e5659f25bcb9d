//! Scans that no method can reconstruct: angles in degrees, views without an object, attenuation of the wrong sign.

use super::{Evidence, is_at_border};
use crate::dataset::Dataset;
use std::f64::consts::{PI, TAU};
use trgs_core::error::{Error, Result};
use trgs_core::geometry::{Projections, Scanner};
use trgs_core::setting::{Setting, Text};

/// Span of the angles of a circle beyond which they are taken for degrees, radians: two turns.
const LARGEST_SPAN: f64 = 2.0 * TAU;
/// Largest difference of heights of the source in a circle, in units of its distance from the axis.
const LEVEL: f64 = 1e-6;
/// The opposite tail of the readings, in units of the tail that is the object, at most.
const OTHER_TAIL: f64 = 0.25;
/// Share of the readings in a tail: more than single damaged pixels, less than a small object.
const TAIL: f64 = 0.005;

/// Pixels from which the tails are found, about: more tell the same.
const PIXELS: usize = 1 << 20;

/// Where the angles of a scan come from: errors name the remedy there.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum AnglesFrom {
    /// The fields of the scan's file.
    File,
    /// A stack's angles, whose unit is a setting.
    Stack,
    /// An argument of a function.
    Argument,
}

/// Refuses a scan that no method can reconstruct.
///
/// # Errors
/// [`Error::Invalid`] for angles in degrees, views without an object, and attenuation of the wrong sign.
///
/// Tests: `degrees_taken_as_radians_are_refused_with_both_remedies`, `views_without_an_object_are_refused`,
/// `a_reversed_sign_is_told_from_air_below_zero`.
pub fn check(dataset: &Dataset, from: AnglesFrom) -> Result<()> {
    let Dataset { scanner, train, test, .. } = dataset;
    for views in std::iter::once(train).chain(test) {
        check_angles(scanner, views, from)?;
    }
    check_views(train)
}

/// The errors of [`check`] as sentences.
pub(super) fn remarks(scan: &Evidence<'_>) -> Vec<Text> {
    let Dataset { scanner, train, test, .. } = scan.dataset;
    let angles = std::iter::once(train).chain(test).map(|views| check_angles(scanner, views, AnglesFrom::File));
    let first = angles.filter_map(Result::err).next();
    first.into_iter().chain(check_views(train).err()).map(|error| error.text()).collect()
}

/// Refuses angles of a circle that span more than two turns.
fn check_angles(scanner: &Scanner, views: &Projections, from: AnglesFrom) -> Result<()> {
    let heights = views.poses.iter().flatten().map(|pose| pose.source.z);
    let (low, high) = super::ends(heights);
    // The turns of a helix are places of their own.
    if high - low > LEVEL * scanner.beam.dso() {
        return Ok(());
    }
    check_radians(&views.angles, from)
}

/// Refuses angles of a circle that are too large for radians.
///
/// Several turns of a circle see nothing that one turn does not see, and degrees reach hundreds.
///
/// # Errors
/// [`Error::Invalid`] for a span beyond two turns, or an angle beyond that.
pub fn check_radians(angles: &[f64], from: AnglesFrom) -> Result<()> {
    let (low, high) = super::ends(angles.iter().copied());
    if angles.is_empty() || (high - low <= LARGEST_SPAN && low.abs().max(high.abs()) <= LARGEST_SPAN) {
        return Ok(());
    }
    let got = format!("{low} to {high}, which look like degrees");
    let expected = format!("radians: at most two turns of a circle, {LARGEST_SPAN:.3}");
    let factor = PI / 180.0;
    let remedy = match from {
        AnglesFrom::Stack => {
            let degrees = "give " + Setting::Degrees + " if they are degrees, which converts them, or ";
            degrees + Setting::Radians + " if they are radians of several turns"
        }
        AnglesFrom::File => format!(
            "multiply every angle of proj_train and proj_test (train.angles and val.angles in a pickle) by {factor} if they \
             are degrees, or subtract whole turns of {TAU} if they are radians"
        )
        .into(),
        AnglesFrom::Argument => {
            "give numpy.deg2rad(angles) if they are degrees, or numpy.mod(angles, 2 * numpy.pi) if they are radians of \
             several turns"
                .into()
        }
    };
    Err(Error::invalid("angles", got, expected, remedy))
}

/// The angles of a circle within one turn, where they are radians of several turns.
pub fn within_a_turn(angles: &mut [f64]) {
    if check_radians(angles, AnglesFrom::Stack).is_err() {
        angles.iter_mut().for_each(|angle| *angle = angle.rem_euclid(TAU));
    }
}

/// Refuses views without an object, and those in which it is less than air.
///
/// # Errors
/// [`Error::Invalid`] for constant views, and for readings far below 0 beside air at 0.
pub fn check_views(train: &Projections) -> Result<()> {
    let constant = |image: ndarray::ArrayView2<'_, f32>| image.iter().all(|value| *value == image[[0, 0]]);
    if train.images.outer_iter().all(constant) && train.images.len() > train.len() {
        let (low, high) = super::ends(train.images.iter().map(|&value| f64::from(value)));
        let got = match low == high {
            true => format!("the value {low} in every pixel"),
            false => format!("one value in all pixels of each view, from {low} to {high}"),
        };
        let remedy = "give the projections of an object: these are empty";
        return Err(Error::invalid("training views", got, "line integrals of an object", remedy));
    }
    let mut values: Vec<f32> = train.images.iter().step_by(1 + train.images.len() / PIXELS).copied().collect();
    let below = values.iter().filter(|value| **value < 0.0).count() as f64 / values.len().max(1) as f64;
    let (low, high) = (quantile(&mut values, TAIL), quantile(&mut values, 1.0 - TAIL));
    let border = border(train);
    // Air that is below 0 is the lowest part of the views, not the highest.
    if low >= 0.0 || high > -OTHER_TAIL * low || border < OTHER_TAIL * low || below < 2.0 * TAIL {
        return Ok(());
    }
    Err(Error::invalid(
        "training views",
        format!("{low:.4} to {high:.4}, {:.0} % below 0", 100.0 * below),
        "line integrals, which are 0 in air and positive in an object",
        "change their sign: a line integral is ln(I0/I), not ln(I/I0)",
    ))
}

/// The median of the pixels at the border of all views.
fn border(train: &Projections) -> f64 {
    let (_, rows, columns) = train.images.dim();
    let pixels =
        train.images.indexed_iter().filter(|((_, row, column), _)| is_at_border(*row, *column, [rows, columns]));
    quantile(&mut pixels.map(|(_, &value)| value).collect::<Vec<f32>>(), 0.5)
}

/// A quantile, without interpolation; 0 without values.
fn quantile(values: &mut [f32], share: f64) -> f64 {
    if values.is_empty() {
        return 0.0;
    }
    let place = ((values.len() - 1) as f64 * share).round() as usize;
    f64::from(*values.select_nth_unstable_by(place, f32::total_cmp).1)
}
