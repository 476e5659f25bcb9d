//! **HOT.** One primitive over a strip of pixels: the only code that runs once per (pixel, primitive).
//!
//! A SIMD register is `WIDTH/2` columns × 2 rows of pixels, `WIDTH` pixels of a row where that is as wide as the support, or
//! `WIDTH/4` × 2 voxels in each of two slices. The work is split into stages that each run over a batch of registers
//! (distance, logarithm, exponential, use), logarithms and exponentials of two side by side, so that the long chains of one
//! register hide behind those of the others. Within a column of registers the coordinate z of [`Plane`] is constant: half of
//! the quadratic form and two thirds of the moments leave the inner loop.
//!
//! Everything is a power of two. With Δ the squared Mahalanobis distance of the primitive's centre from the
//! ray, x = Δ/unit and root = √(A0/A), 1 in the affine projection:
//!
//! | kernel | unit | value per density | source |
//! |---|---|---|---|
//! | Student's t | ν | `root·2^(-q·log2(1+x))` | `[Eq. 4]`, `[X3]`: never a power of 1+x |
//! | Gaussian | 2 ln 2 | `root·2^-x` | its limit |
//!
//! Accuracy: the profile is within 1.5e-7 (f32) and 5e-16 (f64) of its peak for every ν from 1 to 10⁴.
//! Tests: `numeric::lanes`, `tests/contracts/analytic.rs`, `tests/contracts/parity.rs`, `tests/contracts/gradients.rs`.

use super::column::Column;
use super::plane::Plane;
use super::queue::{BATCH, Queue, Queued, Shared};
use crate::numeric::{Lanes, Real};
use std::f64::consts::LN_2;
use std::ops::Range;

/// Registers whose logarithms, and exponentials, are found side by side: two where they are whole, one where the processor's
/// are half as wide and as many, and it is two of these already.
const ABREAST: usize = if cfg!(target_feature = "avx512f") { 2 } else { 1 };

/// A primitive and the registers of a board that its support reaches.
pub(super) trait Reach<R: Real> {
    /// What its registers are on: scalars with room for whole registers.
    type Board;
    /// Rows from a register to the next one in a column.
    const TALL: usize;
    /// Whether it is seen in slices, so that [`Sums::x`] are wanted.
    const SOLID: bool;

    /// What all of its registers share.
    fn plane(&self) -> &Plane;
    /// Calls `visit(column, place, registers)` for each column of registers within a strip, which holds at least one:
    /// they are counted from the strip's first row, and `place` is where the one of that row is.
    fn walk(&self, visit: impl FnMut(Column<R::Lanes>, usize, Range<usize>));
    /// From a register's place to that of the next one in its column.
    fn step(board: &Self::Board) -> usize;
    /// The register at a place.
    fn load(board: &Self::Board, place: usize) -> R::Lanes;
    /// Adds onto the register at a place.
    fn add(board: &mut Self::Board, place: usize, value: R::Lanes);
}

/// `Σ over pixels of cotangent × derivative`, per unit of `weight`, in the terms of [`Plane`].
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Sums {
    /// Derivative to δ/unit (at constant h), times 1, y, z, y², yz, z².
    pub(super) distance: [f64; 6],
    /// Half the derivative to h, times 1, y, z. Exact projection only.
    pub(super) h: [f64; 3],
    /// Derivative to k. Exact projection only.
    pub(super) k: f64,
    /// The values themselves: derivative to `weight`.
    pub(super) value: f64,
    /// Values times log2(1+x). Student's t only.
    pub(super) log: f64,
    /// Derivative to δ/unit times the slice's x, its square, x·y, x·z. Solids only.
    pub(super) x: [f64; 4],
}

/// How log2(1+x) is found in all of a support.
enum Logarithm {
    /// A Gaussian has none.
    None,
    /// No x within the support is beyond [`Lanes::LOG_NEAR`].
    Near,
    Any,
}

impl Plane {
    #[inline(always)]
    fn logarithm<L: Lanes, const STUDENT: bool>(&self) -> Logarithm {
        match STUDENT {
            false => Logarithm::None,
            true if self.limit <= L::LOG_NEAR => Logarithm::Near,
            true => Logarithm::Any,
        }
    }
}

/// A queue of registers, and the intermediate values of a batch of them. Kept from call to call: clearing it would cost as
/// much as a small footprint.
pub(super) struct Scratch<L> {
    x: [L; BATCH],
    y: [L; BATCH],
    /// 1/√(1+e).
    root: [L; BATCH],
    log: [L; BATCH],
    power: [L; BATCH],
    queue: Queue<L>,
    total: Totals<L>,
}

impl<L: Lanes> Default for Scratch<L> {
    fn default() -> Self {
        let empty = [L::default(); BATCH];
        Self {
            x: empty,
            y: empty,
            root: empty,
            log: empty,
            power: empty,
            queue: Queue::default(),
            total: Totals::default(),
        }
    }
}

/// Adds a primitive onto a board; pixels beyond `limit` get nothing.
#[inline]
pub(super) fn forward<R: Real, T: Reach<R>, const STUDENT: bool, const EXACT: bool>(
    target: &T,
    board: &mut T::Board,
    scratch: &mut Scratch<R::Lanes>,
) {
    let plane = target.plane();
    let shared = Shared::<R::Lanes>::new::<EXACT>(plane);
    let stride = [T::step(board), T::TALL];
    target.walk(|column, place, registers| {
        if !scratch.queue.has_room(&registers) {
            paint::<R, T, STUDENT, EXACT>(plane, &shared, scratch, board);
        }
        scratch.queue.push::<EXACT, false>(&shared, column, place, registers, stride);
    });
    paint::<R, T, STUDENT, EXACT>(plane, &shared, scratch, board);
}

/// Adds the values of a queue's registers onto the board, and empties it.
///
/// Not inlined: within the walk's closure there are too few registers left for the constants of its loops, which would be
/// read from memory again for every one or two registers of pixels.
#[inline(never)]
fn paint<R: Real, T: Reach<R>, const STUDENT: bool, const EXACT: bool>(
    plane: &Plane,
    shared: &Shared<R::Lanes>,
    scratch: &mut Scratch<R::Lanes>,
    board: &mut T::Board,
) {
    let (weight, zero) = (R::Lanes::splat_f64(plane.weight), R::Lanes::default());
    let Scratch { x, root, log, power, queue, .. } = scratch;
    for batch in queue.batches() {
        queue.look(shared, batch.clone(), x.iter_mut().zip(&mut *root), |(x, root), sight| {
            *x = sight.x;
            if EXACT {
                *root = sight.root;
            }
        });
        let places = queue.places(batch);
        let filled = places.len();
        profile::<_, STUDENT>(plane, plane.q, filled, x, log, power);
        let (x, root, power) = (&x[..filled], &root[..filled], &power[..filled]);
        for (((&x, &root), &power), &place) in x.iter().zip(root).zip(power).zip(places) {
            let value = if EXACT { power * root } else { power };
            T::add(board, place as usize, x.select_le(shared.limit, value * weight, zero));
        }
    }
    queue.clear();
}

/// (1+x)^-exponent of the first `filled` registers and the logarithms of 1+x, or 2^-x.
#[inline(always)]
fn profile<L: Lanes, const STUDENT: bool>(
    plane: &Plane,
    exponent: f64,
    filled: usize,
    x: &[L; BATCH],
    log: &mut [L; BATCH],
    power: &mut [L; BATCH],
) {
    match plane.logarithm::<L, STUDENT>() {
        Logarithm::None => return powers(filled, -1.0, x, power),
        Logarithm::Near => logarithms(filled, x, log, Lanes::log2_1p_near_each),
        Logarithm::Any => logarithms(filled, x, log, Lanes::log2_1p_each),
    }
    powers(filled, -exponent, log, power);
}

/// Does work that would find no registers for its constants where it is called from, among sums, and would read them again for
/// every one or two registers of pixels.
#[inline(never)]
fn apart(work: impl FnOnce()) {
    work();
}

/// log2(1+x) of the first `filled` registers, several at a time: one beyond is of an earlier batch, nobody reads its log.
#[inline(always)]
fn logarithms<L: Lanes>(
    filled: usize,
    x: &[L; BATCH],
    log: &mut [L; BATCH],
    of_some: impl Fn([L; ABREAST]) -> [L; ABREAST],
) {
    let (x, log) = (x.as_chunks::<ABREAST>().0, log.as_chunks_mut().0);
    for (x, log) in x.iter().zip(log).take(filled.div_ceil(ABREAST)) {
        *log = of_some(*x);
    }
}

/// 2^(factor·exponent), the same way.
#[inline(always)]
fn powers<L: Lanes>(filled: usize, factor: f64, exponent: &[L; BATCH], power: &mut [L; BATCH]) {
    let factor = L::splat_f64(factor);
    let (exponent, power) = (exponent.as_chunks::<ABREAST>().0, power.as_chunks_mut().0);
    for (exponent, power) in exponent.iter().zip(power).take(filled.div_ceil(ABREAST)) {
        *power = L::exp2_each(exponent.map(|exponent| factor * exponent));
    }
}

/// Sums `cotangent × derivative` of a primitive over all pixels of its support.
///
/// With a = w·root·(1+x)^-(q+1) and b = a·root²: ∂/∂(δ/unit) = k·g - q·b, ∂/∂h = 2·h·g, ∂/∂k = g·δ/unit, where
/// g = b·((q-½)x - ½) is the derivative to 1+e. For the Gaussian ln 2 stands for q and q-½, and 2^-x for the power. As h
/// and δ/unit are polynomials of y and z, moments of b and of b·x are all that is summed.
#[inline]
pub(super) fn backward<R: Real, T: Reach<R>, const STUDENT: bool, const EXACT: bool>(
    target: &T,
    cotangent: &T::Board,
    scratch: &mut Scratch<R::Lanes>,
) -> Sums {
    let plane = target.plane();
    let shared = Shared::<R::Lanes>::new::<EXACT>(plane);
    let stride = [T::step(cotangent), T::TALL];
    scratch.total.clear::<EXACT>(T::SOLID);
    target.walk(|column, place, registers| {
        if !scratch.queue.has_room(&registers) {
            gather::<R, T, STUDENT, EXACT>(plane, &shared, scratch, cotangent);
        }
        scratch.queue.push::<EXACT, true>(&shared, column, place, registers, stride);
    });
    gather::<R, T, STUDENT, EXACT>(plane, &shared, scratch, cotangent);
    let slopes = if STUDENT { [plane.q, plane.q - 0.5] } else { [LN_2; 2] };
    scratch.total.sums::<EXACT>(plane, slopes, T::SOLID)
}

/// Adds the registers of a queue to the sums, and empties it. Not inlined, as [`paint`].
#[inline(never)]
fn gather<R: Real, T: Reach<R>, const STUDENT: bool, const EXACT: bool>(
    plane: &Plane,
    shared: &Shared<R::Lanes>,
    scratch: &mut Scratch<R::Lanes>,
    cotangent: &T::Board,
) {
    let Scratch { x, y, root, log, power, queue, total } = scratch;
    let zero = R::Lanes::default();
    // What is beyond the limit is multiplied by zero: it, and its logarithm near 0, have to be finite.
    let beyond = R::Lanes::splat_f64(2.0 * plane.limit + 1.0);
    let mut columns = queue.columns();
    let mut part = ColumnSums::<R::Lanes>::default();
    for batch in queue.batches() {
        let found = x.iter_mut().zip(&mut *y).zip(&mut *root);
        queue.look(shared, batch.clone(), found, |((x, y), root), sight| {
            *x = sight.x.at_most(beyond);
            *y = sight.y;
            if EXACT {
                *root = sight.root;
            }
        });
        let places = queue.places(batch.clone());
        let filled = places.len();
        apart(|| profile::<_, STUDENT>(plane, plane.q + 1.0, filled, x, log, power));
        let mut begin = 0;
        while let [column, others @ ..] = columns {
            let rest = column.end - batch.start;
            let end = rest.min(filled);
            for i in begin..end {
                let w = T::load(cotangent, places[i] as usize);
                let w = if EXACT { w * root[i] } else { w };
                let a = x[i].select_le(shared.limit, w * power[i], zero);
                let value = if STUDENT { a.fma(x[i], a) } else { a };
                part.value += value;
                if STUDENT {
                    part.log = value.fma(log[i], part.log);
                }
                let b = if EXACT { a * (root[i] * root[i]) } else { a };
                part.b.add(b, y[i]);
                if EXACT {
                    part.bx.add(b * x[i], y[i]);
                }
            }
            begin = end;
            if rest > filled {
                // It goes on in the next batch.
                break;
            }
            total.add::<EXACT>(&part, column.z);
            if T::SOLID {
                total.add_slices(&part.b, column);
            }
            part = ColumnSums::default();
            columns = others;
        }
    }
    queue.clear();
}

/// Something times 1, y, y², summed.
#[derive(Default)]
struct Moments<L>([L; 3]);

impl<L: Lanes> Moments<L> {
    #[inline(always)]
    fn add(&mut self, value: L, y: L) {
        let first = value * y;
        self.0[0] += value;
        self.0[1] += first;
        self.0[2] = first.fma(y, self.0[2]);
    }
}

/// Sums over one column of registers; the powers of z are still to be multiplied in.
#[derive(Default)]
struct ColumnSums<L> {
    b: Moments<L>,
    bx: Moments<L>,
    value: L,
    log: L,
}

/// Sums over all registers, lane by lane: something times 1, y, z, y², yz, z².
#[derive(Default)]
struct Totals<L> {
    b: [L; 6],
    bx: [L; 6],
    value: L,
    log: L,
    x: [L; 4],
}

impl<L: Lanes> Totals<L> {
    /// Zeros again, where something will be added.
    #[inline(always)]
    fn clear<const EXACT: bool>(&mut self, solid: bool) {
        let zero = L::default();
        (self.b, self.value, self.log) = ([zero; 6], zero, zero);
        if EXACT {
            self.bx = [zero; 6];
        }
        if solid {
            self.x = [zero; 4];
        }
    }

    #[inline(always)]
    fn add<const EXACT: bool>(&mut self, part: &ColumnSums<L>, z: L) {
        let add = |total: &mut [L; 6], Moments([one, y, yy]): &Moments<L>| {
            let times_z = *one * z;
            total[0] += *one;
            total[1] += *y;
            total[2] += times_z;
            total[3] += *yy;
            total[4] += *y * z;
            total[5] += times_z * z;
        };
        add(&mut self.b, &part.b);
        if EXACT {
            add(&mut self.bx, &part.bx);
        }
        self.value += part.value;
        self.log += part.log;
    }

    /// The moments of x, which is the same in all voxels of a slice.
    #[inline(always)]
    fn add_slices(&mut self, Moments([one, y, _]): &Moments<L>, column: &Queued<L>) {
        let times_x = *one * column.x;
        self.x[0] += times_x;
        self.x[1] += times_x * column.x;
        self.x[2] += *y * column.x;
        self.x[3] += times_x * column.z;
    }

    /// `slopes` are q and q-½.
    #[inline(always)]
    fn sums<const EXACT: bool>(&self, plane: &Plane, [slope, slope_x]: [f64; 2], solid: bool) -> Sums {
        let sum = |lanes: &[L; 6]| -> [f64; 6] { std::array::from_fn(|i| lanes[i].sum()) };
        let b = sum(&self.b);
        let mut sums =
            Sums { distance: b.map(|b| -slope * b), value: self.value.sum(), log: self.log.sum(), ..Sums::default() };
        if EXACT {
            let Plane { h_y, h_z, k, floor, .. } = *plane;
            let bx = sum(&self.bx);
            let g: [f64; 6] = std::array::from_fn(|i| slope_x * bx[i] - 0.5 * b[i]);
            let [one, y, z, yy, yz, zz] = g;
            sums.h = [one + h_y * y + h_z * z, y + h_y * yy + h_z * yz, z + h_y * yz + h_z * zz];
            sums.k = yy + zz + floor * one;
            sums.distance.iter_mut().zip(g).for_each(|(distance, g)| *distance += k * g);
        }
        if solid {
            sums.x = std::array::from_fn(|i| -slope * self.x[i].sum());
        }
        sums
    }
}
