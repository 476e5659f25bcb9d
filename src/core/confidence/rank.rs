//! Order statistics of confidences, and their rank correlation with ν.

use crate::numeric::reduce;
use serde::Serialize;

/// Minimum, median, mean and maximum of values.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Spread {
    /// The smallest.
    pub min: f64,
    /// The median.
    pub median: f64,
    /// Their mean.
    pub mean: f64,
    /// The largest.
    pub max: f64,
}

impl Spread {
    /// The spread of values; `None` if there are none. A NaN affects the mean and an end.
    ///
    /// Tests: `the_spread_is_that_computed_by_hand`.
    pub fn of(values: &[f64]) -> Option<Self> {
        let mut sorted = values.to_vec();
        sorted.sort_by(f64::total_cmp);
        let (&min, &max) = (sorted.first()?, sorted.last()?);
        let n = sorted.len();
        let median = (sorted[(n - 1) / 2] + sorted[n / 2]) / 2.0;
        Some(Self { min, median, mean: reduce::sum(values) / n as f64, max })
    }
}

/// How many of the values from 0 to 1 lie in each of twenty intervals of equal width.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(transparent)]
pub struct Histogram {
    /// Value v is counted at `⌊20 v⌋`, 1 in the last interval.
    pub counts: [usize; Self::INTERVALS],
}

impl Histogram {
    /// Number of intervals.
    pub const INTERVALS: usize = 20;

    /// The histogram of values from 0 to 1.
    ///
    /// Tests: `values_on_a_border_are_counted_above_it`.
    pub fn of(values: &[f64]) -> Self {
        let mut counts = [0; Self::INTERVALS];
        for value in values {
            counts[((value * Self::INTERVALS as f64) as usize).min(Self::INTERVALS - 1)] += 1;
        }
        Self { counts }
    }

    /// Where an interval begins.
    pub fn start(interval: usize) -> f64 {
        interval as f64 / Self::INTERVALS as f64
    }
}

/// Spearman's rank correlation in [-1, 1]: Pearson's of the ranks, equal values sharing the mean of theirs.
///
/// `None` if undefined: fewer than two values, all of one array equal, or a NaN. Infinities have ranks.
/// ±1 exactly for monotone pairs of up to 2^18 values, whose sums have no rounding.
/// Not in the paper: its formula; the paper reports this number for ν and c over the temperatures.
///
/// Tests: `ranks_of_ties_are_those_computed_by_hand`, `monotone_pairs_have_exactly_one`.
///
/// # Panics
/// When the arrays differ in length.
pub fn spearman(a: &[f64], b: &[f64]) -> Option<f64> {
    assert_eq!(a.len(), b.len(), "rank correlation of arrays of different lengths");
    if a.len() < 2 || a.iter().chain(b).any(|value| value.is_nan()) {
        return None;
    }
    let (a, b) = (centred_ranks(a), centred_ranks(b));
    let product = |x: &[f64], y: &[f64]| reduce::sum_by(x.len(), &|i| x[i] * y[i]);
    let variances = product(&a, &a) * product(&b, &b);
    (variances > 0.0).then(|| product(&a, &b) / variances.sqrt())
}

/// Ranks less their mean; multiples of ½.
fn centred_ranks(values: &[f64]) -> Vec<f64> {
    let mut order: Vec<usize> = (0..values.len()).collect();
    order.sort_by(|&i, &j| values[i].total_cmp(&values[j]));
    let middle = (values.len() - 1) as f64 / 2.0;
    let mut ranks = vec![0.0; values.len()];
    let mut before = 0;
    for ties in order.chunk_by(|&i, &j| values[i] == values[j]) {
        let rank = before as f64 + (ties.len() - 1) as f64 / 2.0;
        ties.iter().for_each(|&i| ranks[i] = rank - middle);
        before += ties.len();
    }
    ranks
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_on_a_border_are_counted_above_it() {
        let mut expected = [0; Histogram::INTERVALS];
        (expected[0], expected[5], expected[10], expected[19]) = (2, 1, 3, 2);
        let values = [0.0, 0.049, 0.25, 0.5, 0.51, 0.549, 0.95, 1.0];
        assert_eq!(Histogram::of(&values).counts, expected);
        assert_eq!(Histogram::of(&[]).counts, [0; Histogram::INTERVALS]);
        assert_eq!([0, 5, 19].map(Histogram::start), [0.0, 0.25, 0.95]);
    }
    use crate::tolerances::relative;

    #[test]
    fn the_spread_is_that_computed_by_hand() {
        assert_eq!(Spread::of(&[]), None);
        assert_eq!(Spread::of(&[3.0, 1.0, 8.0]), Some(Spread { min: 1.0, median: 3.0, mean: 4.0, max: 8.0 }));
        assert_eq!(Spread::of(&[3.0, 1.0, 8.0, 2.0]), Some(Spread { min: 1.0, median: 2.5, mean: 3.5, max: 8.0 }));
    }

    #[test]
    fn ranks_of_ties_are_those_computed_by_hand() {
        assert_eq!(centred_ranks(&[3.0, -1.0, 3.0, 7.0, 3.0]), [0.0, -2.0, 0.0, 2.0, 0.0]);
        assert_eq!(centred_ranks(&[0.0, -0.0, 5.0]), [-0.5, -0.5, 1.0]);
        // Ranks 1, 2½, 2½, 4 against 2, 1, 3, 4: products ¾ + 2¼, squares 4½ and 5.
        let value = spearman(&[1.0, 2.0, 2.0, 9.0], &[0.2, 0.1, 0.3, 0.4]).unwrap();
        within!(relative(value, 3.0 / 22.5_f64.sqrt()));
    }

    #[test]
    fn monotone_pairs_have_exactly_one() {
        let a: Vec<f64> = (0..1001_i32).map(|i| f64::from((i * 37) % 1001)).collect();
        let up: Vec<f64> = a.iter().map(|x| x * x * x).collect();
        let down: Vec<f64> = a.iter().map(|x| 1.0 / (1.0 + x)).collect();
        assert_eq!(spearman(&a, &up), Some(1.0));
        assert_eq!(spearman(&a, &down), Some(-1.0));
    }

    #[test]
    fn what_has_no_order_has_no_correlation() {
        assert_eq!(spearman(&[], &[]), None);
        assert_eq!(spearman(&[1.0], &[2.0]), None);
        assert_eq!(spearman(&[1.0, 2.0], &[3.0, 3.0]), None);
        assert_eq!(spearman(&[f64::INFINITY; 3], &[1.0, 2.0, 3.0]), None);
        assert_eq!(spearman(&[1.0, f64::NAN], &[1.0, 2.0]), None);
        assert_eq!(spearman(&[1.0, f64::INFINITY], &[1.0, 2.0]), Some(1.0));
    }
}
