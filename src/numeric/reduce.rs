//! Sums whose tree depends on the length alone, accumulated in f64.

use super::{Real, threads};
use std::ops::Range;

/// Values added one after another before the tree begins.
const LEAF: usize = 32;
/// Leaves gone through side by side: a sum waits for the one before in its own leaf alone.
const ABREAST: usize = 8;
/// Values that one worker adds up, so that handing them over costs little beside.
const SHARE: usize = 1 << 13;

/// Where the tree divides `n` values.
fn middle(n: usize) -> usize {
    n.div_ceil(2 * LEAF) * LEAF
}

/// Pairwise sum: leaves of 32 values in order, halves joined left to right.
pub fn sum<R: Real>(values: &[R]) -> f64 {
    sum_of(0..values.len(), &|i| values[i].to_f64())
}

/// Pairwise sum of the terms of some indices, with the same tree as [`sum`]; several workers add up many.
pub fn sum_of(indices: Range<usize>, term: &(impl Fn(usize) -> f64 + Sync)) -> f64 {
    if indices.len() <= SHARE {
        return tree(indices, term);
    }
    let between = indices.start + middle(indices.len());
    let (left, right) = threads::both(|| sum_of(indices.start..between, term), || sum_of(between..indices.end, term));
    left + right
}

/// Pairwise sum of `term(0) … term(n-1)`, with the same tree as [`sum`].
pub fn sum_by(n: usize, term: &impl Fn(usize) -> f64) -> f64 {
    tree(0..n, term)
}

fn tree(indices: Range<usize>, term: &impl Fn(usize) -> f64) -> f64 {
    if indices.len() <= LEAF {
        indices.fold(0.0, |total, i| total + term(i))
    } else if indices.len() == ABREAST * LEAF {
        let mut leaves = [0.0; ABREAST];
        for i in indices.start..indices.start + LEAF {
            for (leaf, total) in leaves.iter_mut().enumerate() {
                *total += term(i + leaf * LEAF);
            }
        }
        let [a, b, c, d, e, f, g, h] = leaves;
        ((a + b) + (c + d)) + ((e + f) + (g + h))
    } else {
        let between = indices.start + middle(indices.len());
        tree(indices.start..between, term) + tree(between..indices.end, term)
    }
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
    fn many_values_have_the_tree_of_few() {
        for n in [SHARE, SHARE + 1, 3 * SHARE - 7, 1 << 17] {
            let values: Vec<f64> = (0..n).map(|i| 1.0 / (i as f64 + 1.7)).collect();
            assert_eq!(sum(&values), sum_by(n, &|i| values[i]));
            assert_eq!(sum_of(5..n, &|i| values[i]), sum(&values[5..]));
        }
    }

    #[test]
    fn leaves_side_by_side_have_the_sum_of_leaves_one_after_another() {
        let value = |i: usize| 1.0 / (i as f64 + 0.3);
        let leaf = |i: usize| (i * LEAF..(i + 1) * LEAF).fold(0.0, |total, i| total + value(i));
        let pair = |i: usize| leaf(i) + leaf(i + 1);
        for first in [0, ABREAST] {
            let [a, b, c, d] = [0, 2, 4, 6].map(|i| pair(first + i));
            let found = sum_of(first * LEAF..(first + ABREAST) * LEAF, &value);
            assert_eq!(found, (a + b) + (c + d));
            assert_ne!(found, (first * LEAF..(first + ABREAST) * LEAF).fold(0.0, |total, i| total + value(i)));
        }
    }

    #[test]
    fn sum_of_every_small_length_is_exact_for_integers() {
        for n in 0..200_usize {
            assert_eq!(sum_by(n, &|i| i as f64), (n * n.saturating_sub(1) / 2) as f64);
        }
    }
}
