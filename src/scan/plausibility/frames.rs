//! Single frames that differ from those beside them.
//!
//! The *mass* of a view is its mean less its air. It changes little from view to view, whatever the object. Each view is
//! held against the median of the two views at each side by angle. A view of another exposure has another air.

use super::Evidence;
use crate::borders::Side;
use trgs_core::numeric::rank::{SIGMA_OF_MAD, median};
use trgs_core::numeric::reduce;
use trgs_core::setting::{Setting, Text};
use trgs_core::words::verb;

/// Views from which on one can differ from the others.
const LEAST: usize = 6;
/// Standard deviations of the differences between neighbours.
const CLEAR: f64 = 8.0;
/// Difference in units of the median mass.
const LARGE: f64 = 0.25;
/// The same where the object leaves the detector, so that its mass varies.
const LARGE_IF_CUT: f64 = 0.8;
/// Mass of a view without an object, in units of the median mass.
const EMPTY: f64 = 0.1;

/// Remarks on views that are blank, without object, without beam, or of another exposure.
pub(super) fn remarks(scan: &Evidence<'_>) -> Vec<Text> {
    let train = &scan.dataset.train;
    let n = train.len();
    if n < LEAST || scan.are_readings {
        return Vec::new();
    }
    let images: Vec<&[f32]> =
        train.images.outer_iter().map(|image| image.to_slice().expect("projections are in C order")).collect();
    let air = scan.borders.air.as_ref();
    let level = air.map_or(0.0, |air| air.level);
    let bases: Vec<f64> = (0..n).map(|view| air.and_then(|air| air.views[view]).unwrap_or(level)).collect();
    let mass = |view: usize| reduce::sum(images[view]) / images[view].len() as f64 - bases[view];
    let masses: Vec<f64> = (0..n).map(mass).collect();
    let is_blank = |view: &usize| images[*view].iter().all(|value| *value == images[*view][0]);
    // A view with values that no measurement has is named with its pixels.
    let is_damaged = |view: &usize| scan.wrong.impossible.iter().any(|[damaged, ..]| damaged == view);
    let (blank, others): (Vec<usize>, Vec<usize>) = (0..n).filter(|view| !is_damaged(view)).partition(is_blank);
    if others.len() < LEAST {
        return Vec::new();
    }
    let mut by_angle = others;
    let angle = |view: usize| train.angles[view].rem_euclid(std::f64::consts::TAU);
    by_angle.sort_by(|&a, &b| angle(a).total_cmp(&angle(b)).then(a.cmp(&b)));
    let count = by_angle.len();
    let differences: Vec<f64> = (0..count)
        .map(|k| {
            let beside = [count - 2, count - 1, 1, 2].map(|step| masses[by_angle[(k + step) % count]]);
            masses[by_angle[k]] - median(&mut beside.to_vec())
        })
        .collect();
    let typical = median(&mut by_angle.iter().map(|&view| masses[view]).collect::<Vec<_>>());
    let spread = SIGMA_OF_MAD * median(&mut differences.iter().map(|d| d.abs()).collect::<Vec<_>>());
    let is_cut = Side::ALL.iter().any(|&side| scan.borders.at(side).is_cut());
    let limit = (CLEAR * spread).max(typical.abs() * if is_cut { LARGE_IF_CUT } else { LARGE });
    let exposures = air.map(|air| air.outliers()).unwrap_or_default();

    let (mut empty, mut dark, mut other) = (Vec::new(), Vec::new(), Vec::new());
    let mut brightest: Vec<f64> = by_angle.iter().map(|&view| largest(images[view])).collect();
    let brightest = median(&mut brightest) - level;
    for (&view, difference) in by_angle.iter().zip(&differences) {
        if difference.abs() <= limit && !exposures.contains(&view) {
            continue;
        }
        let list = match masses[view] < EMPTY * typical {
            false => &mut other,
            true if bases[view] - level > brightest => &mut dark,
            true => &mut empty,
        };
        list.push(view);
    }
    let out = "take them out with their angles, or measure them again";
    let air = "convert or reconstruct with " + Setting::Air + " auto if their air differs, or " + out;
    [
        (blank, "blank: all pixels have one value", out.into()),
        (empty, "without the object", out.into()),
        (dark, "without beam: darker than the object in the others", out.into()),
        (other, "different from the views beside, as with another exposure", air),
    ]
    .into_iter()
    .filter(|(views, ..)| !views.is_empty())
    .map(|(mut views, what, remedy)| {
        views.sort_unstable();
        let list = |first: usize| views.iter().map(|view| (view + first).to_string()).collect::<Vec<_>>().join(", ");
        let found = format!(
            "{} {} counted from 0 ({} from 1) {} {what}; ",
            verb(views.len(), "view", "views"),
            list(0),
            list(1),
            verb(views.len(), "is", "are")
        );
        Text::from(found) + remedy
    })
    .collect()
}

fn largest(image: &[f32]) -> f64 {
    f64::from(image.iter().fold(f32::NEG_INFINITY, |a, &b| if b > a { b } else { a }))
}
