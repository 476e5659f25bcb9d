//! Redundancy weights: how often each ray was measured, and the weight of a view at each column.
//!
//! Over a full turn every ray of the source's plane is measured twice, and each measurement counts half. Two scans
//! differ:
//!
//! - a *short scan* ends before the full turn, so that some rays are measured twice and others once. Parker's weights
//!   `[Parker82]`, for any coverage from half a turn and the fan up to a full turn (Silver, *A method for including
//! - a *displaced detector* sees the object on only one side. Rays measured by a single view of a full turn count once,
//!   and the weights of the others fade from one side to the other `[Wang02]`.
//!
//! `[Parker82]`: D. L. Parker, *Optimal short scan convolution reconstruction for fanbeam CT*, Med. Phys. 9 (1982) 254.
//! `[Wang02]`: G. Wang, *X-ray micro-CT with a displaced detector array*, Med. Phys. 29 (2002) 1634.

use super::Turn;
use crate::error::{Error, Result};
use crate::numeric::Real;
use crate::numeric::elementary::{asin, atan, sin, tan};
use crate::scene::{Beam, Scanner};
use ndarray::{Array3, ArrayView3, Axis};
use std::f64::consts::{FRAC_PI_2, FRAC_PI_4, PI, TAU};

/// A gap between neighbouring views wider than all others by this factor ends an arc.
const GAP: f64 = 1.5;

/// Weights of the rays, including Δφ.
#[derive(Debug)]
pub(super) struct RayWeights {
    views: Vec<f64>,
    /// `[view][column]`; empty if all columns have the same weight.
    rays: Vec<f64>,
    columns: usize,
    /// Columns of zeros to add left and right: they keep the filter's spread beyond a displaced detector.
    padding: [usize; 2],
}

/// The views as an arc: sorted, starting after the widest gap.
struct Arc {
    /// Indices of the views in order.
    order: Vec<usize>,
    /// Angle of each view from the first, in that order, radians.
    from_first: Vec<f64>,
    /// The angle that the views cover, radians: from the first to the last, plus one step.
    coverage: f64,
    /// Whether the widest gap ends an arc.
    ends: bool,
}

impl Arc {
    /// The arc of angles on a circle of circumference `turn`.
    fn of(angles: &[f64], turn: f64) -> Self {
        let n = angles.len();
        let mut order: Vec<usize> = (0..n).collect();
        let on_circle = |view: usize| angles[view].rem_euclid(turn);
        order.sort_by(|&a, &b| on_circle(a).total_cmp(&on_circle(b)).then(a.cmp(&b)));
        let gap = |k: usize| (on_circle(order[(k + 1) % n]) - on_circle(order[k])).rem_euclid(turn);
        let gaps: Vec<f64> = (0..n).map(gap).collect();
        let widest = (0..n).reduce(|a, b| if gaps[b] > gaps[a] { b } else { a }).expect("at least one view");
        let second = (0..n).filter(|&k| k != widest).map(|k| gaps[k]).fold(0.0, f64::max);
        order.rotate_left((widest + 1) % n);
        let first = on_circle(order[0]);
        let from_first: Vec<f64> = order.iter().map(|&view| (on_circle(view) - first).rem_euclid(turn)).collect();
        let (last, steps) = (from_first[n - 1], (n - 1) as f64);
        let step = if n > 1 { last / steps } else { turn };
        Self { order, from_first, coverage: (last + step).min(turn), ends: n > 2 && gaps[widest] > GAP * second }
    }

    /// Half the angle between the neighbours of each view; the ends use their one neighbour twice.
    fn steps(&self) -> Vec<f64> {
        let (at, n) = (&self.from_first, self.from_first.len());
        let step = |k: usize| match k {
            0 => at[1] - at[0],
            k if k + 1 == n => at[k] - at[k - 1],
            k => (at[k + 1] - at[k - 1]) / 2.0,
        };
        (0..n).map(step).collect()
    }
}

impl RayWeights {
    /// Weights of the views at `angles`.
    ///
    /// # Errors
    /// With [`Turn::Measured`], when the views cover less than half a turn plus, in a cone beam, the fan of the volume.
    pub(super) fn new(scanner: &Scanner, angles: &[f64], turn: Turn) -> Result<Self> {
        let columns = scanner.detector.columns;
        let circle = match scanner.beam {
            Beam::Cone { .. } => TAU,
            Beam::Parallel { .. } => PI,
        };
        let arc = Arc::of(angles, circle);
        if turn == Turn::Measured && arc.ends {
            let half_fan = half_fan(scanner);
            let (needed, got) = ((PI + 2.0 * half_fan).to_degrees(), arc.coverage.to_degrees());
            if got < needed - 1e-6 {
                let expected = format!(
                    "at least {needed:.1}°, half a turn and the fan of the volume: filtered back projection needs every ray"
                );
                let remedy =
                    "use the method tr-gs, sart, asd-pocs, cgls or tv, or `fdk.turn=full`, which ignores the gap";
                return Err(Error::invalid("arc of the views", format!("{got:.1}°"), expected, remedy));
            }
            if circle == TAU {
                return Ok(Self::short_scan(scanner, &arc));
            }
        }
        // On the full turn of a cone beam every ray is measured about twice.
        let share = if circle == TAU { 0.5 } else { 1.0 };
        let views: Vec<f64> = angular_weights(angles, circle).into_iter().map(|weight| share * weight).collect();
        match displaced(scanner) {
            Some((of_column, padding)) if turn == Turn::Measured && !Arc::of(angles, TAU).ends => {
                let rays =
                    views.iter().flat_map(|view| of_column.iter().map(move |share| 2.0 * view * share)).collect();
                Ok(Self { views: Vec::new(), rays, columns, padding })
            }
            _ => Ok(Self { views, rays: Vec::new(), columns, padding: [0, 0] }),
        }
    }

    /// Parker's weights times the angle that each view covers.
    fn short_scan(scanner: &Scanner, arc: &Arc) -> Self {
        let columns = scanner.detector.columns;
        let mut rays = vec![0.0; arc.order.len() * columns];
        let step = arc.coverage / arc.order.len() as f64;
        for ((&view, from_first), width) in arc.order.iter().zip(&arc.from_first).zip(arc.steps()) {
            for column in 0..columns {
                // The opposite ray is half a turn and twice this angle further on, at minus this angle.
                let gamma = -fan_angle(scanner, scanner.detector.position(0.0, column as f64).0);
                rays[view * columns + column] = width * parker(from_first + step / 2.0, gamma, arc.coverage);
            }
        }
        Self { views: Vec::new(), rays, columns, padding: [0, 0] }
    }

    /// The weight of a ray, radians; columns are those of the detector from [`Self::widen`].
    pub(super) fn at(&self, view: usize, column: usize) -> f64 {
        match column.checked_sub(self.padding[0]) {
            Some(column) if column < self.columns => {
                if self.rays.is_empty() {
                    self.views[view]
                } else {
                    self.rays[view * self.columns + column]
                }
            }
            _ => 0.0,
        }
    }

    /// Scanner and images with a displaced detector padded by zero columns to the reach of its other side.
    pub(super) fn widen<R: Real>(&self, scanner: &Scanner, images: ArrayView3<'_, R>) -> Option<(Scanner, Array3<R>)> {
        let [left, right] = self.padding;
        if left + right == 0 {
            return None;
        }
        let (views, rows, columns) = images.dim();
        let mut wide = Array3::from_elem((views, rows, left + columns + right), R::ZERO);
        wide.slice_axis_mut(Axis(2), (left..left + columns).into()).assign(&images);
        let mut scanner = *scanner;
        scanner.detector.columns = left + columns + right;
        scanner.detector.offset_u += (right as f64 - left as f64) / 2.0 * scanner.detector.pitch_u;
        Some((scanner, wide))
    }
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

/// Weights of a displaced detector's columns, from 0 to 1 `[Wang02]`, and the columns that it lacks.
///
/// The missing columns are given for the left and the right side. `None` if the volume's projection is inside the
/// detector on both sides, or on neither.
///
/// Tests: `columns_at_both_sides_of_the_axis_add_up_to_one`.
fn displaced(scanner: &Scanner) -> Option<(Vec<f64>, [usize; 2])> {
    let detector = &scanner.detector;
    let half = detector.columns as f64 * detector.pitch_u / 2.0;
    let (low, high) = (half - detector.offset_u, half + detector.offset_u);
    let (overlap, far) = (low.min(high), low.max(high));
    if overlap <= 0.0 || overlap >= shadow(scanner) || far < 1.05 * overlap {
        return None;
    }
    let side = if high > low { 1.0 } else { -1.0 };
    let angle = |u: f64| if matches!(scanner.beam, Beam::Cone { .. }) { fan_angle(scanner, u) } else { u };
    let weight = |column: usize| {
        let part = angle(side * detector.position(0.0, column as f64).0) / angle(overlap);
        0.5 + 0.5 * sin(FRAC_PI_2 * part.clamp(-1.0, 1.0))
    };
    let missing = ((far - overlap) / detector.pitch_u).ceil() as usize;
    let padding = if side > 0.0 { [missing, 0] } else { [0, missing] };
    Some(((0..detector.columns).map(weight).collect(), padding))
}

/// Angle between the ray to column position u and the middle of the fan, radians.
fn fan_angle(scanner: &Scanner, u: f64) -> f64 {
    match scanner.beam {
        Beam::Cone { dsd, .. } => atan(u / dsd),
        Beam::Parallel { .. } => 0.0,
    }
}

/// Radius of the cylinder around the axis inside the volume's box.
fn radius(scanner: &Scanner) -> f64 {
    let (min, max) = (scanner.grid.min, scanner.grid.max());
    [-min.x, max.x, -min.y, max.y].into_iter().fold(0.0, f64::max)
}

/// Half the fan angle of the volume, or of the detector if that is smaller, radians.
fn half_fan(scanner: &Scanner) -> f64 {
    let detector = &scanner.detector;
    let edge = detector.columns as f64 * detector.pitch_u / 2.0 + detector.offset_u.abs();
    match scanner.beam {
        Beam::Cone { dso, .. } => asin((radius(scanner) / dso).min(1.0)).min(fan_angle(scanner, edge)),
        Beam::Parallel { .. } => 0.0,
    }
}

/// Half the width of the volume's projection on the detector.
fn shadow(scanner: &Scanner) -> f64 {
    match scanner.beam {
        Beam::Cone { dso, dsd } => dsd * tan(asin((radius(scanner) / dso).min(1.0))),
        Beam::Parallel { .. } => radius(scanner),
    }
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
    use crate::scene::{Detector, Grid};
    use crate::tolerances::largest;

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
        let (weights, padding) = displaced(&scanner(0.5, 30)).unwrap();
        assert_eq!(padding, [10, 0]);
        // The axis lies between columns 9 and 10; 10 columns are at its near side.
        for k in 0..10 {
            within!((weights[9 - k] + weights[10 + k] - 1.0).abs(), "{k}");
        }
        within!(largest(weights[20..].iter().map(|weight| weight - 1.0)), "{weights:?}");
        let (mirrored, padding) = displaced(&scanner(-0.5, 30)).unwrap();
        assert_eq!(padding, [0, 10]);
        let mirrored: Vec<f64> = mirrored.into_iter().rev().collect();
        within!(largest(weights.iter().zip(&mirrored).map(|(a, b)| a - b)));
        assert!(displaced(&scanner(0.5, 90)).is_none() && displaced(&scanner(0.0, 20)).is_none());
    }

    #[test]
    fn an_arc_is_told_from_a_full_turn() {
        let arc = |n, span| Arc::of(&Scanner::uniform_angles(n, 5.0, span), TAU);
        assert!(!arc(12, TAU).ends);
        within!((arc(12, TAU).coverage - TAU).abs());
        let short = arc(40, 4.0);
        assert!(short.ends);
        within!((short.coverage - 4.0).abs());
        assert_eq!(short.order, (0..40).collect::<Vec<_>>());
    }

    #[test]
    fn too_short_an_arc_is_refused_and_named() {
        let refused =
            |span| RayWeights::new(&scanner(0.0, 60), &Scanner::uniform_angles(60, 0.3, span), Turn::Measured);
        // Half a turn and the fan of a radius of 1 at a distance of 4: 180° + 29°.
        let message = refused(3.6).unwrap_err().to_string();
        assert!(message.contains("206.3°") && message.contains("209.0°") && message.contains("sart"), "{message}");
        refused(3.7).unwrap();
        RayWeights::new(&scanner(0.0, 60), &Scanner::uniform_angles(60, 0.3, 2.0), Turn::Full).unwrap();
    }
}
