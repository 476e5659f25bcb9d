//! Linear layers on registers of samples.
//!
//! Arrays of registers have a row for each group of samples; rows are [`stride`] registers apart.

use std::array::from_fn;
use trgs_core::numeric::{Lanes, Real};

/// Width of all hidden layers.
pub(super) const HIDDEN: usize = 32;
/// Outputs that are computed together: as many chains of sums as hide the latency of a fused product. Without AVX-512 a
/// register of 16 numbers is two of the processor's.
const TILE: usize = if cfg!(target_feature = "avx512f") { 8 } else { 4 };
/// Inputs and outputs whose products are summed together, likewise.
const PATCH: usize = if cfg!(target_feature = "avx512f") { 4 } else { 2 };

/// Registers between two rows of so many: an odd number, so that the rows do not share lines of the cache.
pub(super) fn stride(width: usize) -> usize {
    width | 1
}

/// `y = w·x + b` for every row; `w` is `[outputs, inputs]`.
///
/// Each output is one chain of fused products over the inputs in order, from the bias or 0.
pub(super) fn apply<R: Real>(w: &[R], bias: Option<&[R]>, x: &[R::Lanes], y: &mut [R::Lanes], shape: [usize; 2]) {
    let [inputs, outputs] = shape;
    let start = |j: usize| bias.map_or(R::ZERO, |bias| bias[j]);
    for (x, y) in x.chunks_exact(stride(inputs)).zip(y.chunks_exact_mut(stride(outputs))) {
        let x = &x[..inputs];
        let mut j = 0;
        while j + TILE <= outputs {
            let rows: [&[R]; TILE] = from_fn(|k| &w[(j + k) * inputs..][..inputs]);
            let mut sums: [R::Lanes; TILE] = from_fn(|k| R::Lanes::splat(start(j + k)));
            for i in 0..inputs {
                for k in 0..TILE {
                    sums[k] = R::Lanes::splat(rows[k][i]).fma(x[i], sums[k]);
                }
            }
            y[j..j + TILE].copy_from_slice(&sums);
            j += TILE;
        }
        for (j, y) in y.iter_mut().enumerate().take(outputs).skip(j) {
            let row = &w[j * inputs..][..inputs];
            *y = row.iter().zip(x).fold(R::Lanes::splat(start(j)), |sum, (&w, &x)| R::Lanes::splat(w).fma(x, sum));
        }
    }
}

/// The transpose of `w`, which is `[outputs, inputs]`.
pub(super) fn transposed<R: Real>(w: &[R], [inputs, outputs]: [usize; 2]) -> Vec<R> {
    (0..inputs * outputs).map(|k| w[k % outputs * inputs + k / outputs]).collect()
}

/// Adds the gradient to the weights: `Σ dy·x` over rows and lanes.
pub(super) fn add_gradient<L: Lanes>(x: &[L], dy: &[L], gradient: &mut [f64], [inputs, outputs]: [usize; 2]) {
    let mut j = 0;
    while j + PATCH <= outputs {
        let mut i = 0;
        while i + PATCH <= inputs {
            tile::<L, PATCH, PATCH>(x, dy, gradient, [inputs, outputs], [i, j]);
            i += PATCH;
        }
        (i..inputs).for_each(|i| tile::<L, 1, PATCH>(x, dy, gradient, [inputs, outputs], [i, j]));
        j += PATCH;
    }
    for j in j..outputs {
        (0..inputs).for_each(|i| tile::<L, 1, 1>(x, dy, gradient, [inputs, outputs], [i, j]));
    }
}

#[inline(always)]
fn tile<L: Lanes, const I: usize, const J: usize>(
    x: &[L],
    dy: &[L],
    gradient: &mut [f64],
    [inputs, outputs]: [usize; 2],
    [i, j]: [usize; 2],
) {
    let mut sums = [[L::default(); I]; J];
    for (x, dy) in x.chunks_exact(stride(inputs)).zip(dy.chunks_exact(stride(outputs))) {
        for b in 0..J {
            for a in 0..I {
                sums[b][a] = dy[j + b].fma(x[i + a], sums[b][a]);
            }
        }
    }
    for (b, sums) in sums.into_iter().enumerate() {
        for (a, sum) in sums.into_iter().enumerate() {
            gradient[(j + b) * inputs + i + a] += sum.sum();
        }
    }
}

/// Adds the gradient to the bias: `Σ dy` over rows and lanes.
pub(super) fn add_bias_gradient<L: Lanes>(dy: &[L], gradient: &mut [f64], outputs: usize) {
    for (j, gradient) in gradient.iter_mut().enumerate() {
        *gradient += dy.chunks_exact(stride(outputs)).fold(L::default(), |sum, dy| sum + dy[j]).sum();
    }
}
