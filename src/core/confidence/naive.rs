//! The confidence as plainly as it can be written: every point of every primitive against every view.
//!
//! The SIMD path must count the same points.
//!
//! Squares and products of scales are taken as they are, so scales must lie well between 1e-100 and 1e100.

use super::{Alpha, Settings, sees, towards_source};
use crate::geometry::{Scanner, Trajectory, View};
use crate::numeric::elementary::{cos, sin};
use crate::primitives::{Primitives, rotation};
use glam::{DMat3, DVec3};
use std::f64::consts::TAU;

/// Point k of n on the unit sphere: the Fibonacci lattice, from the north pole down, turning by the golden ratio.
///
/// `z = 1 - (2k+1)/n`, azimuth `2π·frac(k·(√5-1)/2)`. Not in the paper, which only asks for points on the sphere.
///
/// Tests: `points_lie_on_the_sphere_and_spread_evenly`.
pub fn sphere_point(k: usize, n: usize) -> DVec3 {
    let turns = k as f64 * ((5.0_f64.sqrt() - 1.0) / 2.0);
    let azimuth = TAU * (turns - turns.floor());
    let z = 1.0 - (2 * k + 1) as f64 / n as f64;
    let radius = (1.0 - z * z).sqrt();
    DVec3::new(radius * cos(azimuth), radius * sin(azimuth), z)
}

/// Effective ratio `e = α/√Σ(sₖuₖ)²` `[Eq. 6]` of a primitive with scales `s` along the unit vector `u` of its local frame.
///
/// With `α = (s₁s₂s₃)^⅓`, the primitive's own, it is 1 for equal scales and does not depend on their unit.
///
/// Tests: `the_ratio_is_one_for_spheres_and_follows_the_axes`.
pub fn effective_ratio(alpha: f64, scale: DVec3, u: DVec3) -> f64 {
    alpha / (scale * u).length()
}

/// The primitive's own α: `(s₁s₂s₃)^⅓`.
pub(super) fn own_alpha(scale: DVec3) -> f64 {
    libm::cbrt(scale.x * scale.y * scale.z)
}

/// Radius of the tube `r = r_max·min(e/κ, 1)` `[Eq. 7]`, in units of the primitive.
///
/// Tests: `the_tube_grows_with_the_ratio_up_to_its_largest_radius`.
pub fn support_radius(ratio: f64, settings: &Settings) -> f64 {
    let share = ratio / settings.kappa;
    settings.r_max * if share < 1.0 { share } else { 1.0 }
}

/// The confidence c of every primitive, `[M]` `[Eq. 8]`.
///
/// Tests: `fast_and_naive_count_the_same_points`, `a_point_is_within_the_tube_iff_it_is_near_the_chord`.
pub fn confidence<'a>(
    primitives: &Primitives,
    scanner: &Scanner,
    views: impl Into<Trajectory<'a>>,
    settings: &Settings,
) -> Vec<f64> {
    let views = views.into().views(scanner);
    let n = settings.sphere_points;
    let mut own: Vec<f64> = primitives.parameters.scale.iter().map(|&s| own_alpha(DVec3::from_array(s))).collect();
    own.sort_by(f64::total_cmp);
    let one = |i: usize| {
        let (scale, mean) = (primitives.parameters.scale[i], primitives.parameters.mean[i]);
        let (scale, mean) = (DVec3::from_array(scale), DVec3::from_array(mean));
        let rotation = DMat3::from_quat(rotation::unit(primitives.parameters.quaternion[i]).0);
        let alpha = match settings.alpha {
            Alpha::Own => own_alpha(scale),
            Alpha::Median => own[(own.len() - 1) / 2],
            Alpha::Length(length) => length,
        };
        let within = |p: DVec3, view: &View| {
            let u = rotation.transpose() * towards_source(view, mean);
            let r = support_radius(effective_ratio(alpha, scale, u), settings);
            sees(view, mean) && p.dot(u) * p.dot(u) >= 1.0 - r * r
        };
        let covered = (0..n).filter(|&k| views.iter().any(|view| within(sphere_point(k, n), view))).count();
        covered as f64 / n as f64
    };
    (0..primitives.len()).map(one).collect()
}
