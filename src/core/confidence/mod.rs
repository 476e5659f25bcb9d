//! Ray confidence: the fraction of a primitive's neighbourhood that the rays of all views cover, and the target of ν.
//!
//! In its local frame and in units of its scales a primitive is the unit ball. Each view that sees it contributes
//! one ray through its centre, with the direction `u = Rᵀ·(source - μ)/|source - μ|` (parallel beam: `u = -Rᵀw`). The
//! part of that ray inside the unit sphere is the chord from `-u` to `+u`, which is the axis of a tube:
//!
//! | tag | | |
//! |---|---|---|
//! | `[Eq. 6]` | `e = α/√Σ(sₖuₖ)²` | effective ratio: above 1 along the short axes |
//! | `[Eq. 7]` | `r = r_max·min(e/κ, 1)` | radius of the tube |
//! | `[Eq. 8]` | `c = #{p : 1 - (p·u)² ≤ r² in some view}/N` | fraction of N points of the sphere within a tube |
//! | `[Eq. 9]` | `ν_target = ν_min + (ν_max - ν_min)·σ(logit(c)/T)` | [`nu_target`] |
//! | `[Eq. 10]` | `L = (1/M) Σ λ(1-c)(ln ν - ln ν_target)²` | [`nu_loss`] |
//!
//! `1 - (p·u)²` is the squared distance of a point of the unit sphere from the chord: the foot of the perpendicular
//! never lies beyond its ends. The scaling factor α is a length, for which there are two readings ([`Alpha`]): the primitive's
//! own mean scale `(s₁s₂s₃)^⅓`, with which e = 1 for a sphere of any size, or one constant for all primitives, with which the
//! small are covered more than the large. Not in the paper: α itself, the N points (a Fibonacci lattice), the weight `1-c`, and
//! that a view counts only if the projected mean is on the detector.
//!
//! [`naive`] has the equations as plainly as they can be written; the SIMD path makes the same comparisons in the same
//! arithmetic, so both count the same points, on every build and with any number of threads.

pub mod naive;
pub mod nu;
pub mod rank;
mod sphere;
#[cfg(test)]
mod tests;

pub use nu::{nu_loss, nu_loss_into, nu_target};
pub use rank::{Histogram, Spread, spearman};

use crate::error::{Error, Result};
use crate::geometry::{Beam, Scanner, Trajectory, View};
use crate::numeric::elementary::{length, power_of_two_below};
use crate::numeric::threads;
use crate::primitives::{Primitives, rotation};
use glam::{DMat3, DVec3};
use sphere::{Sphere, Tube};

/// Largest number of points on the sphere; their array fits easily into memory.
pub const MOST_POINTS: usize = 1 << 24;
/// Primitives of one task.
const CHUNK: usize = 128;

/// The scaling factor α of `[Eq. 6]`, a length.
///
/// The paper does not specify it. Only α/κ matters.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum Alpha {
    /// The geometric mean `(s₁s₂s₃)^⅓` of the primitive's own scales.
    #[default]
    Own,
    /// The median of these means over all primitives of the model; the lower one of two in the middle.
    Median,
    /// This length in scene units, positive.
    Length(f64),
}

impl Alpha {
    /// The constant of all primitives; none where each has its own.
    ///
    /// Tests: `a_constant_alpha_is_the_median_or_a_length`.
    pub fn constant(self, primitives: &Primitives) -> Option<f64> {
        match self {
            Self::Own => None,
            Self::Length(length) => Some(length),
            Self::Median => {
                let of = |scale: &[f64; 3]| {
                    let unit = unit_of(DVec3::from_array(*scale));
                    unit * mean_scale(DVec3::from_array(*scale) / unit)
                };
                let mut means: Vec<f64> = primitives.parameters.scale.iter().map(of).collect();
                let middle = means.len().checked_sub(1)? / 2;
                Some(*means.select_nth_unstable_by(middle, f64::total_cmp).1)
            }
        }
    }
}

/// The geometric mean of three scales.
fn mean_scale(scale: DVec3) -> f64 {
    libm::cbrt(scale.x * scale.y * scale.z)
}

/// Parameters of `[Eq. 6]` to `[Eq. 9]` that the paper does not specify.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Settings {
    /// N, points on the sphere, at least 1.
    pub sphere_points: usize,
    /// α: the length that the primitive's extent along a ray is compared with.
    pub alpha: Alpha,
    /// Largest radius of a tube, in units of the primitive. A tube of radius 1 or more holds the whole sphere.
    pub r_max: f64,
    /// Effective ratio from which the tube has its largest radius.
    pub kappa: f64,
    /// T: the smaller, the steeper the transition of ν from minimum to maximum at c = ½.
    pub temperature: f64,
}

impl Default for Settings {
    fn default() -> Self {
        Self { sphere_points: 512, alpha: Alpha::Own, r_max: 0.5, kappa: 1.0, temperature: 0.25 }
    }
}

impl Settings {
    /// Checks that there is a point and that the three numbers are positive and finite.
    ///
    /// # Errors
    /// For the first setting that is invalid.
    pub fn validate(&self) -> Result<()> {
        if !(1..=MOST_POINTS).contains(&self.sphere_points) {
            let expected = format!("1 to {MOST_POINTS}");
            return Err(Error::invalid("sphere points", self.sphere_points, expected, "the default is 512"));
        }
        let usual = Self::default();
        let length = if let Alpha::Length(length) = self.alpha { length } else { 1.0 };
        for (what, value, usual) in [
            ("alpha", length, "own".into()),
            ("r_max", self.r_max, usual.r_max.to_string()),
            ("kappa", self.kappa, usual.kappa.to_string()),
            ("temperature", self.temperature, usual.temperature.to_string()),
        ] {
            if !(value > 0.0 && value.is_finite()) {
                return Err(Error::invalid(what, value, "a positive number", format!("the default is {usual}")));
            }
        }
        Ok(())
    }
}

/// The points of the sphere, laid out for SIMD once for all primitives.
pub struct Coverage {
    settings: Settings,
    sphere: Sphere,
}

impl Coverage {
    /// Prepares the points.
    ///
    /// # Panics
    /// On settings that [`Settings::validate`] refuses.
    pub fn new(settings: Settings) -> Self {
        assert!(settings.validate().is_ok(), "unusable {settings:?}");
        Self { settings, sphere: Sphere::new(settings.sphere_points) }
    }

    /// What the confidence is computed with.
    pub fn settings(&self) -> Settings {
        self.settings
    }

    /// The confidence c of every primitive in [0, 1], `[M]` `[Eq. 8]`.
    ///
    /// 0 for a primitive that no view sees. Exact: a count divided by N, the same as [`naive::confidence`].
    ///
    /// Tests: `fast_and_naive_count_the_same_points`, `one_view_of_a_sphere_covers_two_caps`.
    pub fn confidence<'a>(
        &self,
        primitives: &Primitives,
        scanner: &Scanner,
        views: impl Into<Trajectory<'a>>,
    ) -> Vec<f64> {
        let all: Vec<usize> = (0..primitives.len()).collect();
        self.confidence_of(&all, primitives, scanner, views)
    }

    /// [`Self::confidence`] of the primitives in some `rows` alone, in their order.
    ///
    /// Tests: `the_confidence_of_some_is_that_of_all`.
    ///
    /// # Panics
    /// For a row that does not exist.
    pub fn confidence_of<'a>(
        &self,
        rows: &[usize],
        primitives: &Primitives,
        scanner: &Scanner,
        views: impl Into<Trajectory<'a>>,
    ) -> Vec<f64> {
        let views = views.into().views(scanner);
        let alpha = self.settings.alpha.constant(primitives);
        let mut confidence = vec![0.0; rows.len()];
        threads::for_each_chunk(&mut confidence, CHUNK, |chunk, confidence| {
            let mut tubes = Vec::with_capacity(views.len());
            for (&row, c) in rows[chunk * CHUNK..].iter().zip(confidence) {
                self.collect_tubes(primitives, row, alpha, &views, &mut tubes);
                *c = self.sphere.covered(&tubes) / self.settings.sphere_points as f64;
            }
        });
        confidence
    }

    /// The tubes of the views that see primitive `i`, with a constant `alpha` or its own.
    fn collect_tubes(
        &self,
        primitives: &Primitives,
        i: usize,
        alpha: Option<f64>,
        views: &[View],
        into: &mut Vec<Tube>,
    ) {
        let parameters = &primitives.parameters;
        let mean = DVec3::from_array(parameters.mean[i]);
        let (quaternion, _) = rotation::unit(parameters.quaternion[i]);
        let to_local = DMat3::from_quat(quaternion).transpose();
        let scale = DVec3::from_array(parameters.scale[i]);
        let unit = unit_of(scale);
        let scale = scale / unit;
        let alpha = alpha.map_or_else(|| mean_scale(scale), |alpha| alpha / unit);
        into.clear();
        for view in views.iter().filter(|view| sees(view, mean)) {
            let direction = to_local * towards_source(view, mean);
            let ratio = alpha / length(scale * direction) / self.settings.kappa;
            let radius = self.settings.r_max * if ratio < 1.0 { ratio } else { 1.0 };
            into.push(Tube { direction, nearest: 1.0 - radius * radius });
        }
    }
}

/// The unit that a primitive's lengths are measured in: the power of two below its largest scale.
///
/// Squares and products stay in range. The unit cancels in e, whose bits are unchanged.
fn unit_of(scale: DVec3) -> f64 {
    let power = power_of_two_below(scale.max_element());
    if power > 0.0 { power } else { f64::MIN_POSITIVE }
}

/// Whether the projection of a point is on the detector, up to the edges of its pixels.
fn sees(view: &View, point: DVec3) -> bool {
    let on = |index: f64, count: usize| -0.5 <= index && index < count as f64 - 0.5;
    view.project(view.to_camera(point)).is_some_and(|(u, v)| {
        let (row, column) = view.detector.pixel(u, v);
        on(row, view.detector.rows) && on(column, view.detector.columns)
    })
}

/// Unit vector against the ray through a point that the view sees.
fn towards_source(view: &View, point: DVec3) -> DVec3 {
    match view.beam {
        Beam::Cone { .. } => (view.source - point) / length(view.source - point),
        Beam::Parallel { .. } => -view.w,
    }
}
