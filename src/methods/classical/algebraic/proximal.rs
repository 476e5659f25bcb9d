//! The proximal step of total variation with a non-negativity constraint. Not in the paper.

use std::ops::{Add, Mul};
use trgs_core::geometry::Grid;
use trgs_core::numeric::threads::{chunks, for_each_chunk, for_each_zip};
use trgs_core::numeric::{Lanes, Real, real, reduce};

/// Voxels per parallel task.
const SHARE: usize = 1 << 14;
/// Length of a step of the dual. It converges below 2; there one step is as good as two of 1.
const STEP: f64 = 1.9;

/// Solves `min ½‖x - z‖² + τ·TV(x)` over `x ≥ 0` by its dual `[BT09]`.
///
/// The dual is kept as a warm start for the next call, whose solution is near.
///
/// ```text
/// TV(x) = Σ_j √(Σ_a ((D_a x)_j)²)     (D_a x)_j = w_a·(x_{j+e_a} - x_j), 0 at the last voxel along a
/// x(q) = max(0, z - τ·Dᵀq)            |q_j| ≤ 1
/// q ← (q + s·D x(q)/(τ‖D‖²)) projected to length 1;  s: [`STEP`]
/// ```
///
/// w_a is the smallest spacing of the voxels divided by the one along a.
#[derive(Clone, Debug)]
pub(super) struct Proximal<R> {
    /// Numbers of lines of voxels along the first two axes, and their length.
    shape: [usize; 3],
    weights: [f64; 3],
    /// An upper bound of `‖D‖²`.
    bound: f64,
    q: [Vec<R>; 3],
    zeros: Vec<R>,
}

impl<R: Real> Proximal<R> {
    pub(super) fn new(grid: &Grid) -> Self {
        Self::of(grid, grid.shape[0], [0, 1, 2].map(|_| vec![R::ZERO; grid.voxels()]))
    }

    /// Of some slices of the grid, with their dual variable.
    pub(super) fn of(grid: &Grid, slices: usize, q: [Vec<R>; 3]) -> Self {
        let [nx, ny, nz] = grid.shape;
        let [x, y, z] = weights(grid);
        // A volume with a single slice in z has the same memory order with its long lines last.
        let (shape, weights) = if nz == 1 { ([1, slices, ny], [z, x, y]) } else { ([slices, ny, nz], [x, y, z]) };
        let sides = [(nx, x), (ny, y), (nz, z)].into_iter().filter(|(n, _)| *n > 1);
        let bound = sides.map(|(_, weight)| 4.0 * weight * weight).sum();
        Self { shape, weights, bound, q, zeros: vec![R::ZERO; shape[2]] }
    }

    /// The dual variable q.
    pub(super) fn dual(&self) -> &[Vec<R>; 3] {
        &self.q
    }

    /// Sets the dual variable to continue from.
    pub(super) fn set_dual(&mut self, dual: [Vec<R>; 3]) {
        self.q = dual;
    }

    fn lines(&self) -> usize {
        (SHARE / self.shape[2]).max(1)
    }

    /// Solves for x given z by `steps` steps; τ is in units of z.
    pub(super) fn solve(&mut self, z: &[R], tau: f64, steps: usize, x: &mut [R]) {
        let bound = self.bound;
        if tau == 0.0 || bound == 0.0 {
            x.iter_mut().zip(z).for_each(|(x, &z)| *x = if z > R::ZERO { z } else { R::ZERO });
            return;
        }
        for _ in 0..steps {
            self.primal(z, tau, x);
            self.ascend(x, STEP / (tau * bound));
        }
        self.primal(z, tau, x);
    }

    /// `x = max(0, z - τ·Dᵀq)`.
    fn primal(&self, z: &[R], tau: f64, x: &mut [R]) {
        let ([_, ny, nz], lines, q) = (self.shape, self.lines(), &self.q);
        let factors: [R; 3] = self.weights.map(|weight| real(tau * weight));
        for_each_chunk(x, lines * nz, |chunk, x| {
            for (i, x) in x.chunks_exact_mut(nz).enumerate() {
                let line = chunk * lines + i;
                let at = line * nz;
                let before = |axis: usize, first: bool, stride: usize| {
                    if first { &self.zeros[..nz] } else { &q[axis][at - stride..][..nz] }
                };
                let q_before = [before(0, line < ny, ny * nz), before(1, line % ny == 0, nz)];
                let q = q.each_ref().map(|q| &q[at..at + nz]);
                primal_line::<R::Lanes>(q, q_before, &z[at..at + nz], factors, x);
            }
        });
    }

    /// An ascent step of the dual.
    fn ascend(&mut self, x: &[R], step: f64) {
        let ([nx, ny, nz], lines) = (self.shape, self.lines());
        let factors: [R; 3] = self.weights.map(|weight| real(step * weight));
        let length = lines * nz;
        let [q0, q1, q2] = &mut self.q;
        for_each_zip((chunks(q0, length), chunks(q1, length), chunks(q2, length)), |chunk, (q0, q1, q2)| {
            for i in 0..q0.len() / nz {
                let (line, part) = (chunk * lines + i, i * nz..(i + 1) * nz);
                let at = line * nz;
                let here = &x[at..at + nz];
                // The last line has no difference to a next line.
                let next = |last: bool, stride: usize| if last { here } else { &x[at + stride..][..nz] };
                let next = [next(line / ny + 1 == nx, ny * nz), next(line % ny + 1 == ny, nz)];
                let q = [&mut q0[part.clone()], &mut q1[part.clone()], &mut q2[part]];
                dual_line::<R::Lanes>(here, next, factors, q);
            }
        });
    }

    /// The part of `TV(x)` of a slice; `next` is the slice after it.
    pub(super) fn variation(grid: &Grid, here: &[R], next: Option<&[R]>) -> f64 {
        let (weights, nz): ([R; 3], _) = (weights(grid).map(real), grid.shape[2]);
        let mut lengths = Vec::with_capacity(here.len());
        let last = here.len() - nz;
        for at in (0..here.len()).step_by(nz) {
            let line = &here[at..at + nz];
            // The last line has no difference to a next line.
            let beyond =
                [next.map_or(line, |next| &next[at..at + nz]), if at < last { &here[at + nz..][..nz] } else { line }];
            lengths.extend((0..nz).map(|k| {
                let beyond = [beyond[0][k], beyond[1][k], line[(k + 1).min(nz - 1)]];
                square([0, 1, 2].map(|axis| weights[axis] * (beyond[axis] - line[k]))).sqrt()
            }));
        }
        reduce::sum(&lengths)
    }
}

/// w of the three axes.
fn weights(grid: &Grid) -> [f64; 3] {
    let least = grid.spacing.min_element();
    [0, 1, 2].map(|axis| least / grid.spacing[axis])
}

/// The squared length of a vector.
#[inline(always)]
fn square<T: Copy + Add<Output = T> + Mul<Output = T>>([a, b, c]: [T; 3]) -> T {
    a * a + b * b + c * c
}

/// [`Proximal::primal`] for one line.
fn primal_line<L: Lanes>(
    q: [&[L::Scalar]; 3],
    before: [&[L::Scalar]; 2],
    z: &[L::Scalar],
    factors: [L::Scalar; 3],
    x: &mut [L::Scalar],
) {
    let (factors, n) = (factors.map(L::splat), x.len());
    for k in (0..n).step_by(L::WIDTH) {
        let at = |values: &[L::Scalar]| L::from_first(&values[k..n]);
        let below = match k {
            0 => L::from_fn(|i| if i > 0 && i <= n { q[2][i - 1] } else { L::Scalar::ZERO }),
            _ => L::from_first(&q[2][k - 1..n - 1]),
        };
        let adjoint = factors[0] * (at(before[0]) - at(q[0]))
            + factors[1] * (at(before[1]) - at(q[1]))
            + factors[2] * (below - at(q[2]));
        (at(z) - adjoint).at_least(L::default()).write_first(&mut x[k..(k + L::WIDTH).min(n)]);
    }
}

/// [`Proximal::ascend`] for one line.
fn dual_line<L: Lanes>(x: &[L::Scalar], next: [&[L::Scalar]; 2], factors: [L::Scalar; 3], q: [&mut [L::Scalar]; 3]) {
    let (factors, one, n) = (factors.map(L::splat), L::splat(L::Scalar::ONE), x.len());
    for k in (0..n).step_by(L::WIDTH) {
        let part = k..(k + L::WIDTH).min(n);
        let at = |values: &[L::Scalar]| L::from_first(&values[k..n]);
        let (here, above) = (at(x), above::<L>(x, k));
        let d = [factors[0] * (at(next[0]) - here), factors[1] * (at(next[1]) - here), factors[2] * (above - here)];
        let g = [at(q[0]) + d[0], at(q[1]) + d[1], at(q[2]) + d[2]];
        let size = square(g);
        let cut = size.select_le(one, one, one / size.sqrt());
        for axis in 0..3 {
            (g[axis] * cut).write_first(&mut q[axis][part.clone()]);
        }
    }
}

/// The values one after each of those from k on; the last element repeats itself.
#[inline(always)]
fn above<L: Lanes>(x: &[L::Scalar], k: usize) -> L {
    let last = x.len() - 1;
    if k + L::WIDTH <= last { L::from_slice(&x[k + 1..]) } else { L::from_fn(|i| x[(k + i + 1).min(last)]) }
}
