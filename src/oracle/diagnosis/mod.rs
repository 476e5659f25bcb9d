//! Diagnosis of a wrong answer: compares it with the truth under common mistakes.
//!
//! Not in the paper. A mistake is named only if it explains the answer: the remaining error must be a small fraction, and
//! enough elements must agree (`evidence`). Mistakes that explain it equally well are named together.
//! The mistakes of [`arrays`] need only the truth. Those of `scenes` recompute the question with one thing changed,
//! `plain` has the equations of kernels and projections with one fault, `losses` and `steps` those of losses and optimisers.

pub mod arrays;
mod evidence;
mod losses;
mod plain;
mod scenes;
mod steps;

use evidence::{Accuracy, most_likely};

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
    /// Whether the array is an approximation, which leaves more than rounding.
    pub interpolated: bool,
    /// Whether the array has no error but rounding, so that nothing above the tolerance may remain.
    pub exact: bool,
    /// Whether a number of the mistake was fitted to the answer.
    pub fitted: bool,
    /// Whether the name says what is seen, as a factor, and not what causes it.
    pub observation: bool,
}

impl Suspect {
    /// A mistake whose result is known exactly.
    pub(super) fn new(name: impl Into<String>, array: ArrayD<f64>) -> Self {
        Self {
            name: name.into(),
            array,
            residual: 0.05,
            interpolated: false,
            exact: false,
            fitted: false,
            observation: false,
        }
    }

    /// A mistake that another one resembles up to a small part: rounding alone may remain.
    pub(super) fn exactly(name: impl Into<String>, array: ArrayD<f64>) -> Self {
        Self { exact: true, ..Self::new(name, array) }
    }

    /// A property of the answer that several mistakes can cause.
    pub(super) fn observed(name: impl Into<String>, array: ArrayD<f64>) -> Self {
        Self { observation: true, ..Self::new(name, array) }
    }
}

/// Names the mistake behind a wrong array, if a known mistake explains it.
///
/// `limit` is the tolerance of the largest error relative to the peak.
pub(super) fn of_part(
    question: &Question,
    (role, part): (&str, &str),
    expected: &ArrayD<f64>,
    got: &ArrayD<f64>,
    format: Format,
    limit: f64,
) -> Option<String> {
    let accuracy = Accuracy::of_tolerance(limit.max(format.ulp(1.0)));
    let suspects = || {
        let mut all = arrays::suspects(expected, got, axes(role), accuracy);
        all.extend(scenes::suspects(question, role, part, expected, format));
        all
    };
    most_likely(expected, got, suspects, accuracy)
}

/// Names the mistake behind a wrong array for which only the truth is known.
///
/// `axes` names the axes, outermost first; `format` is the one in which the arrays were computed.
pub fn of_array(expected: &ArrayD<f64>, got: &ArrayD<f64>, axes: &[&str], format: Format) -> Option<String> {
    let accuracy = Accuracy::of_format(format);
    let suspects = || {
        let mut all = arrays::suspects(expected, got, axes, accuracy);
        all.extend(arrays::half_shifts(expected, got, axes));
        all
    };
    most_likely(expected, got, suspects, accuracy)
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
