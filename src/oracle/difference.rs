//! The difference of two arrays in every norm that a tolerance can be given in.

use super::format::Format;
use ndarray::{ArrayD, Dimension};
use serde::Serialize;

/// An element is significant where the truth is at least this fraction of the peak.
const SIGNIFICANT: f64 = 1e-3;

/// The element with the largest error.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Worst {
    /// Its index.
    pub index: Vec<usize>,
    /// The truth.
    pub expected: f64,
    /// The backend's value; serialised as text if it is not finite, because JSON has no NaN.
    #[serde(serialize_with = "as_number_or_text")]
    pub got: f64,
    /// The error in units in the last place of the truth.
    #[serde(serialize_with = "as_number_or_text")]
    pub ulp: f64,
}

/// Errors of an array against the truth. All are 0 for equal arrays.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Difference {
    /// Largest error relative to the largest truth; the largest error itself if the truth is 0 throughout.
    #[serde(serialize_with = "as_number_or_text")]
    pub peak: f64,
    /// Largest error of a significant element, in units in the last place of its truth.
    #[serde(serialize_with = "as_number_or_text")]
    pub ulp: f64,
    /// Largest error of an element relative to its own truth, over elements whose truth is not 0.
    #[serde(serialize_with = "as_number_or_text")]
    pub relative: f64,
    /// `|got - expected|₂ / |expected|₂`.
    #[serde(serialize_with = "as_number_or_text")]
    pub l2: f64,
    /// 1 - cosine of the angle between the two.
    #[serde(serialize_with = "as_number_or_text")]
    pub cosine: f64,
    /// `Σ sign(expected)·(got - expected) / Σ |expected|`: positive if magnitudes are too large on average.
    #[serde(serialize_with = "as_number_or_text")]
    pub bias: f64,
    /// Fraction of the significant elements that are 0 although the truth is not.
    pub zeros: f64,
    /// The element with the largest error.
    pub worst: Option<Worst>,
}

/// Serialises infinity and NaN, which JSON lacks, as text.
pub(super) fn as_number_or_text<S: serde::Serializer>(value: &f64, serializer: S) -> Result<S::Ok, S::Error> {
    if value.is_finite() { serializer.serialize_f64(*value) } else { serializer.collect_str(value) }
}

impl Difference {
    /// Compares two arrays of one shape.
    ///
    /// `allowance` is the error of each element that does not count (see [`super::manifest::Case::allowances`]);
    /// neither do errors below the smallest normal number of `format`. Infinite truths must be met exactly; NaN counts
    /// as an infinite error.
    ///
    /// # Panics
    /// When the shapes differ.
    pub fn new(expected: &ArrayD<f64>, got: &ArrayD<f64>, allowance: Option<&ArrayD<f64>>, format: Format) -> Self {
        assert_eq!(expected.shape(), got.shape(), "shapes of truth and answer");
        let peak = expected.iter().filter(|e| e.is_finite()).fold(0.0_f64, |peak, e| peak.max(e.abs()));
        let scale = if peak > 0.0 { peak } else { 1.0 };
        let floor = format.smallest_normal();
        let mut allowances = allowance.map(|a| a.iter());
        let mut result =
            Self { peak: 0.0, ulp: 0.0, relative: 0.0, l2: 0.0, cosine: 0.0, bias: 0.0, zeros: 0.0, worst: None };
        let mut largest = 0.0;
        // Squares of numbers divided by the peak neither overflow nor underflow.
        let (mut ee, mut gg, mut dd, mut signed, mut sum) = (0.0, 0.0, 0.0, 0.0, 0.0);
        let (mut significant, mut zero) = (0_usize, 0_usize);
        for ((index, &e), &g) in expected.indexed_iter().zip(got) {
            let allowed = allowances.as_mut().map_or(0.0, |a| *a.next().expect("an allowance for each element"));
            let raw = if e == g { 0.0 } else { (g - e).abs() };
            let error = if raw.is_nan() { f64::INFINITY } else { (raw - allowed - floor).max(0.0) };
            if error > largest {
                largest = error;
                result.worst =
                    Some(Worst { index: index.as_array_view().to_vec(), expected: e, got: g, ulp: f64::NAN });
            }
            if !e.is_finite() {
                continue;
            }
            if e != 0.0 {
                result.relative = result.relative.max(error / e.abs());
            }
            if e.abs() >= SIGNIFICANT * scale {
                result.ulp = result.ulp.max(error / format.ulp(e));
            }
            let (e, g, d) = (e / scale, g / scale, error / scale * if g < e { -1.0 } else { 1.0 });
            (ee, gg, dd) = (ee + e * e, gg + g * g, dd + d * d);
            if e != 0.0 {
                (signed, sum) = (signed + d * e.signum(), sum + e.abs());
            }
            if e.abs() >= SIGNIFICANT {
                significant += 1;
                zero += usize::from(g == 0.0 && error > 0.0);
            }
        }
        if let Some(worst) = &mut result.worst {
            worst.ulp = if worst.expected.is_finite() { largest / format.ulp(worst.expected) } else { f64::INFINITY };
        }
        result.peak = largest / scale;
        result.l2 = if ee > 0.0 { (dd / ee).sqrt() } else { dd.sqrt() };
        result.cosine = match (ee > 0.0, gg > 0.0 && gg.is_finite()) {
            (true, true) => {
                // |ê - ĝ|²/2 avoids cancellation at small angles.
                let (e_length, g_length) = (scale * ee.sqrt(), scale * gg.sqrt());
                let finite = expected.iter().zip(got).filter(|(e, _)| e.is_finite());
                finite.map(|(e, g)| e / e_length - g / g_length).map(|x| x * x).sum::<f64>() / 2.0
            }
            _ => f64::from(largest > 0.0),
        };
        result.bias = if sum > 0.0 { signed / sum } else { 0.0 };
        result.zeros = if significant > 0 { zero as f64 / significant as f64 } else { 0.0 };
        result
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tolerances::largest;
    use ndarray::arr1;

    fn of(expected: &[f64], got: &[f64]) -> Difference {
        Difference::new(&arr1(expected).into_dyn(), &arr1(got).into_dyn(), None, Format::F64)
    }

    #[test]
    fn equal_arrays_do_not_differ_also_where_they_are_infinite() {
        let d = of(&[1.0, -2.0, f64::INFINITY, 0.0], &[1.0, -2.0, f64::INFINITY, -0.0]);
        assert_eq!((d.peak, d.ulp, d.l2, d.bias, d.zeros), (0.0, 0.0, 0.0, 0.0, 0.0));
        within!(d.cosine, "{d:?}");
        assert!(d.worst.is_none(), "{d:?}");
    }

    #[test]
    fn norms_are_those_computed_by_hand() {
        let d = of(&[4.0, -2.0, 0.0, 1.0], &[4.0, -2.5, 0.0, 0.0]);
        assert_eq!(d.peak, 0.25);
        assert_eq!(d.l2, (1.25_f64 / 21.0).sqrt());
        assert_eq!(d.bias, (0.5 - 1.0) / 7.0);
        assert_eq!(d.zeros, 1.0 / 3.0);
        assert_eq!(d.relative, 1.0);
        let small = of(&[1e6, 1.0], &[1e6, 1.5]);
        assert_eq!((small.ulp, small.relative), (0.0, 0.5));
        let cosine = (16.0 + 5.0) / (21.0_f64 * 22.25).sqrt();
        within!((d.cosine - (1.0 - cosine)).abs(), "{d:?}");
        let worst = d.worst.unwrap();
        assert_eq!((worst.index, worst.expected, worst.got, worst.ulp), (vec![3], 1.0, 0.0, 4_503_599_627_370_496.0));
        let opposite = of(&[1.0, 2.0], &[-1.0, -2.0]);
        within!(largest([opposite.cosine - 2.0, opposite.bias + 2.0]));
    }

    #[test]
    fn nan_and_wrong_infinities_are_infinite_errors() {
        for got in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
            assert_eq!(of(&[1.0, 2.0], &[got, 2.0]).peak, f64::INFINITY, "{got} for 1");
        }
        for got in [f64::NAN, 3.0, f64::NEG_INFINITY] {
            assert_eq!(of(&[1.0, f64::INFINITY], &[1.0, got]).peak, f64::INFINITY, "{got} for infinity");
        }
    }

    #[test]
    fn allowances_and_flushed_subnormals_do_not_count() {
        let (expected, got) = (arr1(&[1.0, 0.5]).into_dyn(), arr1(&[1.0, 0.0]).into_dyn());
        let allowance = arr1(&[0.0, 0.5]).into_dyn();
        assert_eq!(Difference::new(&expected, &got, Some(&allowance), Format::F64).peak, 0.0);
        assert_eq!(of(&[1e-310, 2e-310], &[0.0, 0.0]).peak, 0.0);
        beyond!(of(&[1e-300], &[0.0]).peak);
    }
}
