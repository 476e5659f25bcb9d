//! Diagnosis of a wrong answer: compares it with the truth under common mistakes.
//!
//! Not in the paper. A mistake is named only if it explains the answer: the remaining error must be a small fraction.
//! The mistakes of [`arrays`] need only the truth; those of `scenes` recompute the question with one thing changed.

pub mod arrays;
mod scenes;

use super::format::Format;
use super::question::Question;
use ndarray::ArrayD;

/// A mistake, and the answer that it would give.
#[derive(Clone, Debug)]
pub struct Suspect {
    /// Completes "looks like …".
    pub name: String,
    /// The array that results from the mistake.
    pub array: ArrayD<f64>,
    /// The fraction of the error that may remain: small for exact arrays, larger for interpolated ones.
    pub residual: f64,
}

impl Suspect {
    /// A mistake whose result is known exactly.
    pub(super) fn new(name: impl Into<String>, array: ArrayD<f64>) -> Self {
        Self { name: name.into(), array, residual: 0.05 }
    }
}

/// Names the mistake behind a wrong array, if a known mistake explains it.
pub(super) fn of_part(
    question: &Question,
    role: &str,
    part: &str,
    expected: &ArrayD<f64>,
    got: &ArrayD<f64>,
    format: Format,
) -> Option<String> {
    let axes = axes(role);
    let mut suspects = arrays::suspects(expected, got, axes);
    suspects.extend(scenes::suspects(question, role, part, expected, format));
    most_likely(expected, got, suspects)
}

/// Names the mistake behind a wrong array for which only the truth is known.
///
/// `axes` names the axes, outermost first.
pub fn of_array(expected: &ArrayD<f64>, got: &ArrayD<f64>, axes: &[&str]) -> Option<String> {
    let mut suspects = arrays::suspects(expected, got, axes);
    suspects.extend(arrays::half_shifts(expected, got, axes));
    most_likely(expected, got, suspects)
}

/// The suspect that leaves the least error, if that is small enough; the first of equals.
///
/// Suspects are ordered from simple to complex.
fn most_likely(expected: &ArrayD<f64>, got: &ArrayD<f64>, suspects: Vec<Suspect>) -> Option<String> {
    let error = distance(expected, got);
    let likely = suspects.into_iter().map(|s| (distance(&s.array, got) / error, s));
    let likely = likely.filter(|(left, s)| *left <= s.residual);
    // Rounding must not decide between two names for one array.
    let simplest = likely.reduce(|best, next| if next.0 < 0.5 * best.0 && best.0 > 1e-6 { next } else { best });
    simplest.map(|(_, s)| s.name)
}

/// Root of the sum of squared differences; NaN if any value is NaN.
fn distance(a: &ArrayD<f64>, b: &ArrayD<f64>) -> f64 {
    let finite = a.iter().zip(b).filter(|(a, _)| a.is_finite());
    finite.map(|(a, b)| (a - b) * (a - b)).sum::<f64>().sqrt()
}

/// The names of an output's axes, outermost first.
pub(super) fn axes(role: &str) -> &'static [&'static str] {
    match role {
        "kernels" => &["primitive", "view", "v", "u"],
        "image" | "bound" | "filtered" | "noisy" => &["view", "v", "u"],
        "volume" | "high" => &["x", "y", "z"],
        "coefficients" | "bands" => &["band", "x", "y", "z"],
        "trajectory" => &["step", "parameter"],
        _ => &[],
    }
}
