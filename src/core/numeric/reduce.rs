//! Sums whose tree depends on the length alone, accumulated in f64.

use super::rearrange::wider;
use super::{Real, threads};
use std::ops::Range;
use wide::{f32x16, f64x2, f64x4, f64x8};

/// Values added one after another before the tree begins.
const LEAF: usize = 32;
/// Leaves that are summed side by side, so that their dependency chains overlap.
const ABREAST: usize = 8;
/// Values in these leaves.
const GROUP: usize = ABREAST * LEAF;
/// Values of one task, enough to make the cost of a task negligible.
const SHARE: usize = 1 << 13;

/// Sum of eight lanes, by halves. Explicit registers keep the compiler from splitting several sums into scalars.
#[inline(always)]
pub(super) fn sum_of_8(lanes: f64x8) -> f64 {
    let [low, high]: [f64x4; 2] = bytemuck::cast(lanes);
    let [low, high]: [f64x2; 2] = bytemuck::cast(low + high);
    let [low, high] = (low + high).to_array();
    low + high
}

/// Sums of the two halves of sixteen lanes, in f64.
#[inline(always)]
pub(super) fn fold_16_to_8(lanes: f32x16) -> f64x8 {
    let halves: [[f32; 8]; 2] = bytemuck::cast(lanes);
    wider(halves[0]) + wider(halves[1])
}

/// Where the tree divides `n` values.
fn middle(n: usize) -> usize {
    n.div_ceil(2 * LEAF) * LEAF
}

/// Pairwise sum: leaves of 32 values in order, halves joined left to right; parallel for many values.
pub fn sum<R: Real>(values: &[R]) -> f64 {
    match values.len() {
        0..=LEAF => values.iter().fold(0.0, |total, value| total + value.to_f64()),
        GROUP => join(leaves(values)),
        n => {
            let (left, right) = values.split_at(middle(n));
            if n <= SHARE {
                return sum(left) + sum(right);
            }
            let (left, right) = threads::join(|| sum(left), || sum(right));
            left + right
        }
    }
}

/// [`sum`] of `n` values that are computed on demand: `make(range, values)` writes those of a range.
pub fn sum_made<R: Real>(n: usize, make: &(impl Fn(Range<usize>, &mut [R]) + Sync)) -> f64 {
    made(0..n, make)
}

fn made<R: Real>(indices: Range<usize>, make: &(impl Fn(Range<usize>, &mut [R]) + Sync)) -> f64 {
    let n = indices.len();
    if n <= GROUP {
        let values = &mut [R::ZERO; GROUP][..n];
        make(indices, values);
        return sum(values);
    }
    let between = indices.start + middle(n);
    let (left, right) = (|| made(indices.start..between, make), || made(between..indices.end, make));
    let (left, right) = if n <= SHARE { (left(), right()) } else { threads::join(left, right) };
    left + right
}

/// The sums of the leaves of a group, one per lane.
fn leaves<R: Real>(values: &[R]) -> [f64; ABREAST] {
    let mut totals = f64x8::default();
    for i in (0..LEAF).step_by(ABREAST) {
        let column = R::columns(std::array::from_fn(|leaf| &values[leaf * LEAF + i..][..ABREAST]));
        totals = column.into_iter().fold(totals, |totals, column| totals + column);
    }
    totals.to_array()
}

fn join([a, b, c, d, e, f, g, h]: [f64; ABREAST]) -> f64 {
    ((a + b) + (c + d)) + ((e + f) + (g + h))
}

/// Pairwise sum of the terms of a range of indices, with the same tree as [`sum`]; parallel for many terms.
pub fn sum_of(indices: Range<usize>, term: &(impl Fn(usize) -> f64 + Sync)) -> f64 {
    if indices.len() <= SHARE {
        return tree(indices, term);
    }
    let between = indices.start + middle(indices.len());
    let (left, right) = threads::join(|| sum_of(indices.start..between, term), || sum_of(between..indices.end, term));
    left + right
}

/// Pairwise sum of `term(0) … term(n-1)`, with the same tree as [`sum`].
pub fn sum_by(n: usize, term: &impl Fn(usize) -> f64) -> f64 {
    tree(0..n, term)
}

fn tree(indices: Range<usize>, term: &impl Fn(usize) -> f64) -> f64 {
    if indices.len() <= LEAF {
        indices.fold(0.0, |total, i| total + term(i))
    } else if indices.len() == GROUP {
        let mut leaves = [0.0; ABREAST];
        for i in indices.start..indices.start + LEAF {
            for (leaf, total) in leaves.iter_mut().enumerate() {
                *total += term(i + leaf * LEAF);
            }
        }
        join(leaves)
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
        within!((sum(&values) - exact).abs() / exact);
    }

    #[test]
    fn many_values_have_the_tree_of_few() {
        for n in [SHARE, SHARE + 1, 3 * SHARE - 7, 1 << 17] {
            let values: Vec<f64> = (0..n).map(|i| 1.0 / (i as f64 + 1.7)).collect();
            assert_eq!(sum(&values), sum_by(n, &|i| values[i]));
            assert_eq!(sum_of(5..n, &|i| values[i]), sum(&values[5..]));
            let single: Vec<f32> = values.iter().map(|&value| value as f32).collect();
            assert_eq!(sum(&single), sum_by(n, &|i| f64::from(single[i])));
            assert_eq!(sum_made(n, &|range, made: &mut [f32]| made.copy_from_slice(&single[range])), sum(&single));
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
