//! Redundancy weights: how often each ray was measured, and the weight of a view at each column.
//!
//! Over a full turn every ray of the source's plane is measured twice, and each measurement counts half. Two scans
//! differ:
//!
//! - a *short scan* ends before the full turn, so that some rays are measured twice and others once. Parker's weights
//!   `[Parker82]`, for any coverage from half a turn and the fan up to a full turn (Silver, *A method for including
//!   redundant data in computed tomography*, Med. Phys. 27 (2000) 773), add up to 1 for each ray and fade smoothly;
//! - a *displaced detector* sees the object on only one side. Rays measured by a single view of a full turn count once,
//!   and the weights of the others fade from one side to the other `[Wang02]`.
//!
//! `[Parker82]`: D. L. Parker, *Optimal short scan convolution reconstruction for fanbeam CT*, Med. Phys. 9 (1982) 254.
//! `[Wang02]`: G. Wang, *X-ray micro-CT with a displaced detector array*, Med. Phys. 29 (2002) 1634.

use super::conditions::{Arc, Plan, Weights};
use super::continuation;
use super::fan::{axis_angle, fan_angle};
use ndarray::{Array3, ArrayView3, Axis};
use std::f64::consts::{FRAC_PI_2, FRAC_PI_4, PI, TAU};
use trgs_core::error::Result;
use trgs_core::geometry::{Beam, Scanner};
use trgs_core::numeric::Real;
use trgs_core::numeric::elementary::sin;
use trgs_scan::borders::Borders;
use trgs_scan::truncation::Displacement;

/// Weights of the rays, including Δφ.
#[derive(Debug)]
pub(super) struct RayWeights {
    views: Vec<f64>,
    /// `[view][column]`; empty if all columns have the same weight.
    rays: Vec<f64>,
    /// Columns of the widened detector.
    columns: usize,
    /// Columns to add left and right.
    padding: [usize; 2],
    /// Whether the added columns continue the projections; otherwise they are 0, and so are their weights.
    continued: [bool; 2],
    /// Shift of source and detector along u, scene units.
    shift: f64,
}

impl RayWeights {
    /// Weights of the views at `angles`; `shift` of source and detector along u, scene units; `seen` are the borders of the
    /// projections, with [`super::Turn::Measured`].
    ///
    /// # Errors
    /// Those of [`Plan::of`].
    pub(super) fn new(scanner: &Scanner, angles: &[f64], shift: f64, seen: Option<&Borders>) -> Result<Self> {
        let plan = match seen {
            Some(seen) => Plan::of(scanner, angles, shift, seen)?,
            None => Plan { weights: Weights::Even, continued: [false; 2] },
        };
        let columns = scanner.detector.columns;
        let mut padding = plan.continued.map(|continued| if continued { columns.div_ceil(2) } else { 0 });
        if let Weights::Displaced(Displacement { overlap, far, side, .. }) = plan.weights {
            // They keep the filter's spread beyond the nearer end of a displaced detector.
            let missing = ((far - overlap) / scanner.detector.pitch_u).ceil() as usize;
            let near = usize::from(side < 0.0);
            padding[near] = missing;
            // The detector at most doubles in width.
            padding[1 - near] = padding[1 - near].min(columns.saturating_sub(missing));
        }
        let wide = widened(scanner, padding);
        // On the full turn of a cone beam every ray is measured about twice.
        let (circle, share) = match scanner.beam {
            Beam::Cone { .. } => (TAU, 0.5),
            Beam::Parallel { .. } => (PI, 1.0),
        };
        let even = || angular_weights(angles, circle).into_iter().map(|weight| share * weight).collect::<Vec<_>>();
        let (views, rays) = match &plan.weights {
            Weights::Even => (even(), Vec::new()),
            Weights::Arc(arc) => (Vec::new(), short_scan(&wide, arc, shift)),
            Weights::Displaced(displacement) => {
                let of_column = displaced(&wide, displacement, shift);
                let weights = |view: &f64| of_column.iter().map(|share| 2.0 * view * share).collect::<Vec<_>>();
                (Vec::new(), even().iter().flat_map(weights).collect())
            }
        };
        Ok(Self { views, rays, columns: wide.detector.columns, padding, continued: plan.continued, shift })
    }

    /// The weight of a ray, radians; columns are those of the detector from [`Self::widen`].
    pub(super) fn at(&self, view: usize, column: usize) -> f64 {
        if self.rays.is_empty() { self.views[view] } else { self.rays[view * self.columns + column] }
    }

    /// The factor on `ds/dγ` of the shift at column position u.
    pub(super) fn shifted(&self, scanner: &Scanner, u: f64) -> f64 {
        match scanner.beam {
            Beam::Cone { dso, dsd } => 1.0 - self.shift * u / (dso * dsd),
            Beam::Parallel { .. } => 1.0,
        }
    }

    /// Scanner and images with the columns that are added, if there are any.
    pub(super) fn widen<R: Real>(&self, scanner: &Scanner, images: ArrayView3<'_, R>) -> Option<(Scanner, Array3<R>)> {
        let [left, right] = self.padding;
        if left + right == 0 {
            return None;
        }
        let (views, rows, columns) = images.dim();
        let mut wide = Array3::from_elem((views, rows, left + columns + right), R::ZERO);
        wide.slice_axis_mut(Axis(2), (left..left + columns).into()).assign(&images);
        let scanner = widened(scanner, self.padding);
        continuation::fill(&scanner, &mut wide, self.padding, self.continued);
        Some((scanner, wide))
    }
}

/// The scanner with a detector that has more columns left and right.
fn widened(scanner: &Scanner, [left, right]: [usize; 2]) -> Scanner {
    let mut scanner = *scanner;
    scanner.detector.columns += left + right;
    scanner.detector.offset_u += (right as f64 - left as f64) / 2.0 * scanner.detector.pitch_u;
    scanner
}

/// Parker's weights times the angle that each view covers, `[view][column]`.
fn short_scan(scanner: &Scanner, arc: &Arc, shift: f64) -> Vec<f64> {
    let aside = axis_angle(scanner, shift);
    let columns = scanner.detector.columns;
    let mut rays = vec![0.0; arc.order.len() * columns];
    let step = arc.coverage / arc.order.len() as f64;
    for ((&view, from_first), width) in arc.order.iter().zip(&arc.from_first).zip(arc.steps()) {
        for column in 0..columns {
            // The opposite ray is half a turn and twice this angle further on, at minus this angle.
            let gamma = -(fan_angle(scanner, scanner.detector.position(0.0, column as f64).0) + aside);
            rays[view * columns + column] = width * parker(from_first + step / 2.0, gamma, arc.coverage);
        }
    }
    rays
}

/// Weight of the ray at `beta` from the start of an arc and `gamma` from the fan's centre `[Parker82]`.
///
/// Tests: `a_ray_and_its_opposite_add_up_to_one`.
fn parker(beta: f64, gamma: f64, coverage: f64) -> f64 {
    let delta = (coverage - PI) / 2.0;
    // Beyond it, rays meet only air if the coverage suffices.
    let gamma = gamma.clamp(-0.999 * delta, 0.999 * delta);
    let fade = |part: f64| {
        let sine = sin(FRAC_PI_4 * part.clamp(0.0, 2.0));
        sine * sine
    };
    let (rise, fall) = (beta / (delta - gamma), (coverage - beta) / (delta + gamma));
    if rise < 2.0 {
        fade(rise)
    } else if fall < 2.0 {
        fade(fall)
    } else {
        1.0
    }
}

/// Weights of a displaced detector's columns, from 0 to 1 `[Wang02]`; 0 beyond its nearer end.
///
/// Tests: `columns_at_both_sides_of_the_axis_add_up_to_one`.
fn displaced(scanner: &Scanner, displacement: &Displacement, shift: f64) -> Vec<f64> {
    let Displacement { overlap, side, axis, .. } = *displacement;
    let detector = &scanner.detector;
    let aside = axis_angle(scanner, shift);
    // From the ray through the axis, positive on the far side.
    let angle = |u: f64| match scanner.beam {
        Beam::Cone { .. } => fan_angle(scanner, side * u) + side * aside,
        Beam::Parallel { .. } => side * u,
    };
    let edge = -angle(axis - side * overlap);
    let weight = |column: usize| {
        let part = angle(detector.position(0.0, column as f64).0) / edge;
        0.5 + 0.5 * sin(FRAC_PI_2 * part.clamp(-1.0, 1.0))
    };
    (0..detector.columns).map(weight).collect()
}

/// The angle that each view covers, on a circle of circumference `turn`.
///
/// It is half the distance between the neighbours of the view.
///
/// The angles add up to `turn`.
fn angular_weights(angles: &[f64], turn: f64) -> Vec<f64> {
    let n = angles.len();
    let mut order: Vec<(f64, usize)> =
        angles.iter().enumerate().map(|(i, angle)| (angle.rem_euclid(turn), i)).collect();
    order.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    let mut weights = vec![turn; n];
    if n > 1 {
        for (k, &(angle, view)) in order.iter().enumerate() {
            let next = if k + 1 < n { order[k + 1].0 } else { order[0].0 + turn };
            let before = if k > 0 { order[k - 1].0 } else { order[n - 1].0 - turn };
            weights[view] = (next - before) / 2.0;
            debug_assert!(before <= angle && angle <= next);
        }
    }
    weights
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tolerances::largest;
    use trgs_core::geometry::{Detector, Grid};

    fn scanner(offset_u: f64, columns: usize) -> Scanner {
        let detector = Detector { rows: 4, columns, pitch_v: 0.1, pitch_u: 0.1, offset_u, offset_v: 0.0 };
        Scanner { beam: Beam::Cone { dso: 4.0, dsd: 6.0 }, detector, grid: Grid::cube(4) }
    }

    #[test]
    fn views_are_weighted_by_half_the_distance_of_their_neighbours() {
        let weights = angular_weights(&[1.0, 1.0 + TAU, 4.0], TAU);
        within!(largest([weights.iter().sum::<f64>() - TAU, weights[2] - PI]), "{weights:?}");
        assert_eq!(angular_weights(&[3.0], TAU), [TAU]);
    }

    #[test]
    fn a_ray_and_its_opposite_add_up_to_one() {
        for coverage in [3.7, 4.5, 6.0] {
            let delta = (coverage - PI) / 2.0;
            for i in 0..50 {
                let gamma = 0.9 * delta * (f64::from(i) / 24.5 - 1.0);
                for k in 0..=100 {
                    let beta = coverage * f64::from(k) / 100.0;
                    let opposites = [beta + PI + 2.0 * gamma, beta - PI + 2.0 * gamma];
                    let both = opposites.into_iter().filter(|o| (0.0..=coverage).contains(o));
                    let total = parker(beta, gamma, coverage) + both.map(|o| parker(o, -gamma, coverage)).sum::<f64>();
                    within!((total - 1.0).abs(), "{coverage} {gamma} {beta}: {total}");
                }
            }
        }
    }

    #[test]
    fn columns_at_both_sides_of_the_axis_add_up_to_one() {
        let weights = |offset: f64, padding| {
            let scanner = scanner(offset, 30);
            displaced(&widened(&scanner, padding), &Displacement::of(&scanner, 0.0), 0.0)
        };
        let right = weights(0.5, [10, 0]);
        assert!(right[..10].iter().all(|weight| *weight == 0.0), "{right:?}");
        // The axis lies between columns 9 and 10 of the detector; 10 columns are at its near side.
        for k in 0..10 {
            within!((right[19 - k] + right[20 + k] - 1.0).abs(), "{k}");
        }
        within!(largest(right[30..].iter().map(|weight| weight - 1.0)), "{right:?}");
        let left: Vec<f64> = weights(-0.5, [0, 10]).into_iter().rev().collect();
        within!(largest(right.iter().zip(&left).map(|(a, b)| a - b)));
    }

    #[test]
    fn a_displaced_detector_is_padded_to_the_reach_of_its_other_side() {
        let padding = |offset, columns| {
            let angles = Scanner::uniform_angles(60, 0.0, TAU);
            RayWeights::new(&scanner(offset, columns), &angles, 0.0, Some(&Borders::default())).unwrap().padding
        };
        assert_eq!([padding(0.5, 30), padding(-0.5, 30)], [[10, 0], [0, 10]]);
        // The detector reaches beyond the volume on both sides, or on neither.
        assert_eq!([padding(0.5, 90), padding(0.0, 20)], [[0, 0], [0, 0]]);
    }

    #[test]
    fn too_short_an_arc_is_refused_and_named() {
        let air = Borders::default();
        let angles = |span| Scanner::uniform_angles(60, 0.3, span);
        let refused = |span| RayWeights::new(&scanner(0.0, 60), &angles(span), 0.0, Some(&air));
        // Half a turn and the fan of a radius of 1 at a distance of 4: 180° + 29°.
        let message = refused(3.6).unwrap_err().to_string();
        assert!(message.contains("206.3°") && message.contains("209.0°") && message.contains("sart"), "{message}");
        refused(3.7).unwrap();
        RayWeights::new(&scanner(0.0, 60), &angles(2.0), 0.0, None).unwrap();
        // An object wider than the volume needs the fan of the detector, 2·atan(3/6): 180° + 53°.
        let wide = Borders { columns: 0..60, ..Borders::default() };
        let message = RayWeights::new(&scanner(0.0, 60), &angles(3.7), 0.0, Some(&wide)).unwrap_err().to_string();
        assert!(message.contains("233.1°"), "{message}");
    }
}
