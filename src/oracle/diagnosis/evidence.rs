//! Evidence for a suspected mistake: the share of the error that it explains, and the number of elements that agree.

use super::Suspect;
use crate::format::Format;
use ndarray::ArrayD;

/// The smallest evidence for a name: digits of agreement, summed over independent elements.
///
/// About a hundred mistakes are tried for an array. One of them agrees by chance in one of 10⁴ wrong arrays.
const EVIDENCE: f64 = 6.0;
/// More candidates than this say nothing.
const CANDIDATES: usize = 3;
/// The part of the error that a gradient by differences leaves, or an answer whose mistake is ill-conditioned.
const DIFFERENCES: f64 = 1e-3;
/// An error above so many limits of the tolerance is no rounding.
const ROUNDING: f64 = 3.0;
/// The rest of an error that an exact mistake leaves, in limits of the tolerance.
const REST: f64 = 20.0;

/// The accuracy that the answer would have without the mistake.
#[derive(Clone, Copy, Debug)]
pub(super) struct Accuracy {
    /// Error relative to the peak that an honest answer may have.
    pub(super) limit: f64,
    /// Whether `limit` is the tolerance of a case. If not, it is the rounding of a format.
    pub(super) tolerance: bool,
}

impl Accuracy {
    /// The limit of a tolerance.
    pub(super) fn of_tolerance(limit: f64) -> Self {
        Self { limit, tolerance: true }
    }

    /// The rounding of a number format.
    pub(super) fn of_format(format: Format) -> Self {
        Self { limit: 64.0 * format.ulp(1.0), tolerance: false }
    }

    /// The smallest relative change of all values that is not rounding.
    pub(super) fn smallest_factor(self) -> f64 {
        (ROUNDING * self.limit).max(1e-5)
    }
}

/// The mistakes that explain the error, at most three that explain it equally well, joined by "or".
///
/// None if nothing explains it, if the evidence is weak, or if more than three mistakes explain it.
/// Suspects are computed only for an error that is finite, above rounding, and not that of zeros throughout.
pub(super) fn most_likely(
    expected: &ArrayD<f64>,
    got: &ArrayD<f64>,
    suspects: impl FnOnce() -> Vec<Suspect>,
    accuracy: Accuracy,
) -> Option<String> {
    let errors = || expected.iter().zip(got).filter(|(e, _)| e.is_finite()).map(|(e, g)| (e - g).abs());
    let peak = expected.iter().filter(|e| e.is_finite()).fold(0.0_f64, |peak, e| peak.max(e.abs()));
    let peak = if peak > 0.0 { peak } else { 1.0 };
    let largest = errors().fold(0.0_f64, f64::max);
    let error = super::distance(expected, got);
    if !(error > 0.0 && error.is_finite()) || (accuracy.tolerance && largest < ROUNDING * accuracy.limit * peak) {
        return None;
    }
    if got.iter().all(|&g| g == 0.0) {
        return Some("zeros throughout".into());
    }
    // The number of elements that share the error: all if it is evenly distributed, one if one element has it.
    let (two, four) = errors().map(|d| d / largest * (d / largest)).fold((0.0, 0.0), |(a, b), d| (a + d, b + d * d));
    let elements = two * two / four;
    let floor = accuracy.limit * peak * two.max(1.0).sqrt() / error;
    let mut likely: Vec<(f64, Suspect)> = Vec::new();
    for suspect in suspects() {
        if suspect.array.iter().zip(expected).any(|(s, e)| e.is_finite() && !s.is_finite()) {
            continue;
        }
        let left = super::distance(&suspect.array, got) / error;
        let rest = suspect.array.iter().zip(got).filter(|(s, _)| s.is_finite());
        let rest = rest.map(|(s, g)| (s - g).abs()).fold(0.0_f64, f64::max) / peak;
        let explained = suspect.interpolated
            || !accuracy.tolerance
            || rest <= REST * accuracy.limit
            || (left <= DIFFERENCES && !suspect.exact);
        let evidence = (elements - f64::from(u8::from(suspect.fitted))) * -libm::log10(left.max(1e-15));
        if left <= suspect.residual && explained && evidence >= EVIDENCE {
            likely.push((left, suspect));
        }
    }
    let best = likely.iter().map(|(left, _)| *left).fold(f64::INFINITY, f64::min);
    likely.retain(|(left, _)| *left <= (3.0 * best).max(floor));
    // A cause is named before an observation, and a known factor before one that was fitted.
    let rank = |suspect: &Suspect| u8::from(suspect.observation) + u8::from(suspect.fitted);
    let simplest = likely.iter().map(|(_, suspect)| rank(suspect)).min()?;
    let mut names: Vec<String> = Vec::new();
    for (_, suspect) in likely.into_iter().filter(|(_, suspect)| rank(suspect) == simplest) {
        if !names.contains(&suspect.name) {
            names.push(suspect.name);
        }
    }
    (names.len() <= CANDIDATES).then(|| names.join(", or "))
}

#[cfg(test)]
mod tests {
    use super::super::arrays::suspects;
    use super::*;
    use ndarray::arr1;

    fn name(expected: &[f64], got: &[f64]) -> Option<String> {
        let (expected, got) = (arr1(expected).into_dyn(), arr1(got).into_dyn());
        let accuracy = Accuracy::of_tolerance(1e-14);
        most_likely(&expected, &got, || suspects(&expected, &got, &[], accuracy), accuracy)
    }

    #[test]
    fn one_or_two_elements_that_are_off_by_half_a_percent_have_no_name() {
        for value in [0.37, 1.0, -2.5, 1e-8, 12.0] {
            for error in [0.005, -0.005, 0.0049, 0.3] {
                assert_eq!(name(&[value], &[value * (1.0 + error)]), None, "{value} {error}");
                assert_eq!(name(&[value, 0.0], &[value * (1.0 + error), 0.0]), None, "{value} {error}");
                assert_eq!(name(&[value, 2.0], &[value * (1.0 + error), 2.0]), None, "{value} {error}");
            }
        }
        assert_eq!(name(&[0.37], &[0.74]).unwrap(), "a factor of 2");
        assert_eq!(name(&[0.37], &[-0.37]).unwrap(), "the opposite sign");
        assert_eq!(name(&[0.37, 0.2], &[0.0, 0.0]).unwrap(), "zeros throughout");
    }

    #[test]
    fn rounding_has_no_factor() {
        let truth: Vec<f64> = (1..40).map(|i| 0.1 * f64::from(i)).collect();
        let scaled = |k: f64| truth.iter().map(|x| x * k).collect::<Vec<f64>>();
        assert_eq!(name(&truth, &scaled(1.0 + 1e-14)), None);
        assert_eq!(name(&truth, &scaled(1.0 + 1e-6)), None);
        assert_eq!(name(&truth, &scaled(1e-8)), None, "a factor of 0 says nothing");
        assert_eq!(name(&truth, &scaled(1.37)).unwrap(), "a factor of 1.370000");
        assert_eq!(
            name(&truth, &scaled(39.0)).unwrap(),
            "a factor of 39, the number of elements: a sum instead of a mean"
        );
        let f16: Vec<f64> = truth.iter().map(|&x| Format::F16.round(x)).collect();
        assert_eq!(name(&truth, &f16).unwrap(), "values rounded to f16");
    }

    #[test]
    fn two_mistakes_with_equal_results_are_both_candidates() {
        // A symmetric array: mirrored and shifted have no name, and a mirror of both axes is one of one.
        let truth = [1.0, 2.0, 5.0, 7.0];
        let suspect = |name: &str| Suspect::new(name, arr1(&[7.0, 5.0, 2.0, 1.0]).into_dyn());
        let (expected, got) = (arr1(&truth).into_dyn(), arr1(&[7.0, 5.0, 2.0, 1.0]).into_dyn());
        let of = |names: &[&str]| {
            let suspects = || names.iter().map(|name| suspect(name)).collect();
            most_likely(&expected, &got, suspects, Accuracy::of_tolerance(1e-14))
        };
        assert_eq!(of(&["a", "b"]).unwrap(), "a, or b");
        assert_eq!(of(&["a", "b", "c", "d"]), None);
    }
}
