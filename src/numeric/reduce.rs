//! Sums whose tree depends on the length alone, accumulated in f64.

use super::Real;

/// Values added one after another before the tree begins.
const LEAF: usize = 32;

/// Pairwise sum: leaves of 32 values in order, halves joined left to right.
pub fn sum<R: Real>(values: &[R]) -> f64 {
    sum_by(values.len(), &|i| values[i].to_f64())
}

/// Pairwise sum of `term(0) … term(n-1)`, with the same tree as [`sum`].
pub fn sum_by(n: usize, term: &impl Fn(usize) -> f64) -> f64 {
    fn tree(from: usize, to: usize, term: &impl Fn(usize) -> f64) -> f64 {
        if to - from <= LEAF {
            (from..to).fold(0.0, |total, i| total + term(i))
        } else {
            let middle = from + (to - from).div_ceil(2 * LEAF) * LEAF;
            tree(from, middle, term) + tree(middle, to, term)
        }
    }
    tree(0, n, term)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pairwise_sum_is_more_accurate_than_a_running_sum() {
        let values = vec![0.1_f32; 1 << 20];
        let exact = f64::from(0.1_f32) * values.len() as f64;
        assert!((sum(&values) - exact).abs() <= 1e-9 * exact);
    }

    #[test]
    fn sum_of_every_small_length_is_exact_for_integers() {
        for n in 0..200_usize {
            assert_eq!(sum_by(n, &|i| i as f64), (n * n.saturating_sub(1) / 2) as f64);
        }
    }
}
