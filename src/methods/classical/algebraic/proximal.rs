//! The proximal step of total variation with a non-negativity constraint. Not in the paper.

use std::ops::{Add, Mul};
use trgs_core::geometry::Grid;
use trgs_core::numeric::threads::{chunks, for_each_chunk, for_each_zip, map};
use trgs_core::numeric::{Lanes, Real, real, reduce};

/// Parallel tasks of a step.
const TASKS: usize = 16;
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
    /// Numbers of slices, of lines per slice and of voxels per line.
    shape: [usize; 3],
    weights: [f64; 3],
    /// An upper bound of `‖D‖²`.
    bound: f64,
    q: [Vec<R>; 3],
    /// A slice of zeros: q before the first one.
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
        let (shape, weights) = if nz == 1 { ([slices, 1, ny], [x, z, y]) } else { ([slices, ny, nz], [x, y, z]) };
        let sides = [(nx, x), (ny, y), (nz, z)].into_iter().filter(|(n, _)| *n > 1);
        let bound = sides.map(|(_, weight)| 4.0 * weight * weight).sum();
        Self { shape, weights, bound, q, zeros: vec![R::ZERO; ny * nz] }
    }

    /// The dual variable q.
    pub(super) fn dual(&self) -> &[Vec<R>; 3] {
        &self.q
    }

    pub(super) fn into_dual(self) -> [Vec<R>; 3] {
        self.q
    }

    /// Sets the dual variable to continue from.
    pub(super) fn set_dual(&mut self, dual: [Vec<R>; 3]) {
        self.q = dual;
    }

    /// Numbers of a parallel task.
    fn share(&self) -> usize {
        self.shape[0].div_ceil(TASKS) * self.zeros.len()
    }

    /// Solves for x in the place of z by `steps` steps; τ is in units of z.
    pub(super) fn solve(&mut self, z: &mut [R], tau: f64, steps: usize) {
        if tau == 0.0 || self.bound == 0.0 {
            z.iter_mut().for_each(|z| *z = if *z > R::ZERO { *z } else { R::ZERO });
            return;
        }
        for _ in 0..steps {
            self.ascend(z, tau);
        }
        let (share, slice) = (self.share(), self.zeros.len());
        for_each_chunk(z, share, |task, z| {
            z.chunks_exact_mut(slice).enumerate().for_each(|(i, z)| self.primal(tau, task * share + i * slice, z));
        });
    }

    /// `max(0, z - τ·Dᵀq)` of the slice that begins at `at`, in the place of z.
    fn primal(&self, tau: f64, at: usize, z: &mut [R]) {
        let slice = self.zeros.len();
        let before = if at == 0 { &self.zeros } else { &self.q[0][at - slice..at] };
        let q = self.q.each_ref().map(|q| &q[at..at + slice]);
        primal_slice(q, [before, &self.zeros], self.factors(tau), self.shape[2], z);
    }

    /// Weights times a factor.
    fn factors(&self, factor: f64) -> [R; 3] {
        self.weights.map(|weight| real(factor * weight))
    }

    /// An ascent step of the dual. Two slices of x per task are there at a time.
    fn ascend(&mut self, z: &[R], tau: f64) {
        let (share, slice, nz) = (self.share(), self.zeros.len(), self.shape[2]);
        // q of the slice before the first one of a task is another task's.
        let firsts = map(z.len().div_ceil(share), |task| {
            let mut x = z[task * share..][..slice].to_vec();
            self.primal(tau, task * share, &mut x);
            x
        });
        let (down, up) = (self.factors(tau), self.factors(STEP / (tau * self.bound)));
        let Self { q: [q0, q1, q2], zeros, .. } = self;
        for_each_zip((chunks(q0, share), chunks(q1, share), chunks(q2, share)), |task, (q0, q1, q2)| {
            let (mut here, mut next) = (firsts[task].clone(), vec![R::ZERO; slice]);
            for at in (0..q0.len()).step_by(slice) {
                let (part, above) = (at..at + slice, at + slice..at + 2 * slice);
                let beyond = if above.end <= q0.len() {
                    next.copy_from_slice(&z[task * share + above.start..][..slice]);
                    let q = [&q0[above.clone()], &q1[above.clone()], &q2[above]];
                    primal_slice(q, [&q0[part], zeros], down, nz, &mut next);
                    &next
                } else {
                    // The last slice has no difference to a next slice.
                    firsts.get(task + 1).unwrap_or(&here)
                };
                for k in (0..slice).step_by(nz) {
                    let line = k..k + nz;
                    let x = &here[line.clone()];
                    let next = [&beyond[line.clone()], here.get(k + nz..k + 2 * nz).unwrap_or(x)];
                    let line = at + k..at + k + nz;
                    let q = [&mut q0[line.clone()], &mut q1[line.clone()], &mut q2[line]];
                    dual_line::<R::Lanes>(x, next, up, q);
                }
                std::mem::swap(&mut here, &mut next);
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

/// [`Proximal::primal`] of a slice, from q, q of the first axis before it, and zeros.
fn primal_slice<R: Real>(q: [&[R]; 3], before: [&[R]; 2], factors: [R; 3], nz: usize, z: &mut [R]) {
    let [before, zeros] = before;
    for at in (0..z.len()).step_by(nz) {
        let line = at..at + nz;
        let before = [&before[line.clone()], if at == 0 { &zeros[..nz] } else { &q[1][at - nz..at] }];
        primal_line::<R::Lanes>(q.map(|q| &q[line.clone()]), before, factors, &mut z[line]);
    }
}

/// [`primal_slice`] of one line.
fn primal_line<L: Lanes>(
    q: [&[L::Scalar]; 3],
    before: [&[L::Scalar]; 2],
    factors: [L::Scalar; 3],
    z: &mut [L::Scalar],
) {
    let (factors, n) = (factors.map(L::splat), z.len());
    for k in (0..n).step_by(L::WIDTH) {
        let at = |values: &[L::Scalar]| L::from_first(&values[k..n]);
        let below = match k {
            0 => L::from_fn(|i| if i > 0 && i <= n { q[2][i - 1] } else { L::Scalar::ZERO }),
            _ => L::from_first(&q[2][k - 1..n - 1]),
        };
        let adjoint = factors[0] * (at(before[0]) - at(q[0]))
            + factors[1] * (at(before[1]) - at(q[1]))
            + factors[2] * (below - at(q[2]));
        (at(z) - adjoint).at_least(L::default()).write_first(&mut z[k..(k + L::WIDTH).min(n)]);
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
