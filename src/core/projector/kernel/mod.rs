//! **HOT.** One primitive over the registers of its support: the only code that runs once per (pixel, primitive).
//!
//! ```text
//! forward(primitive, target):                                 vjp(primitive, cotangent):
//!   for each column of registers in the support:                for each column of registers in the support:
//!     if the batch is full: accumulate(batch)                     if the batch is full: accumulate_moments(batch)
//!     push the column                                             push the column
//!   accumulate(batch)                                           accumulate_moments(batch); sum the lanes
//!
//! accumulate(batch):                                          accumulate_moments(batch):
//!   for every 32 registers of the batch:                        for every 32 registers of the batch:
//!     y, x ← distances; root ← 1/√(1+e)                           y, x ← distances; root ← 1/√(1+e)
//!     log ← log2(1+x)                                             log ← log2(1+x)
//!     power ← 2^(-q·log)                                          power ← 2^(-(q+1)·log)
//!     target += weight·root·power  where x ≤ max_x                for each column of these registers:
//!                                                                   a ← cotangent·root·power  where x ≤ max_x
//!                                                                   part ← Σ of a, a·y, a·y² along the column
//!                                                                   total += part times 1, z, z²
//! ```
//!
//! Reasons for this structure:
//!
//! 1. Columns are collected in batches because their lengths vary: a loop per column mispredicts at each end.
//! 2. Each stage runs over 32 registers, so that the dependency chain of one register (distance, logarithm, exponential)
//!    overlaps with those of the others.
//! 3. [`accumulate`], [`accumulate_moments`] and [`out_of_line`] are not inlined: inside their callers too few registers are
//!    left for the constants of the polynomials, which would be reloaded for every one or two registers of pixels.
//! 4. z is constant along a column. Half of the quadratic form and two thirds of the moments leave the inner loop.
//! 5. The bounds of [`Conic`] select the cheapest root and logarithm once per primitive, not per register.
//! 6. [`Scratch`] is kept from call to call: clearing it would cost as much as a small footprint.
//! 7. Variants are types, so that each combination is compiled without branches.
//!
//! A register is `WIDTH/2` columns × 2 rows of pixels; `WIDTH` pixels of a row where that is as wide as the support; or
//! `WIDTH/4` columns × 2 rows × 2 slices of voxels.
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

pub(crate) mod buffers;
pub(crate) mod columns;
pub(crate) mod conic;
pub(crate) mod extents;
mod moments;
pub(crate) mod variants;

pub(crate) use moments::Sums;

use crate::numeric::{Lanes, Real};
use columns::{BATCH, Column, ColumnBatch, ConicLanes};
use conic::Conic;
use moments::{ColumnSums, Totals};
use std::f64::consts::LN_2;
use std::ops::Range;
use variants::{Forward, Profile, Rays, Vjp};

/// Registers whose logarithms, and exponentials, are computed together.
///
/// Two with AVX-512. Elsewhere a register of lanes is two of the processor's already.
const SIDE_BY_SIDE: usize = if cfg!(target_feature = "avx512f") { 2 } else { 1 };

/// A primitive and the registers of a target that its support covers.
pub(crate) trait Rasterize<R: Real> {
    /// The array that holds its registers.
    type Target;
    /// Rows from a register to the next one in a column.
    const REGISTER_ROWS: usize;
    /// Whether it is evaluated in slices, so that [`Sums::x`] is needed.
    const IS_VOLUME: bool;

    /// The conic of all registers.
    fn conic(&self) -> &Conic;
    /// Calls `visit(column, offset, registers)` for each non-empty column of registers within a strip.
    ///
    /// Registers are counted from the strip's first row; `offset` is that of the register in this row.
    fn for_each_column(&self, visit: impl FnMut(Column<R::Lanes>, usize, Range<usize>));
    /// From a register's offset to that of the next one in its column.
    fn register_stride(target: &Self::Target) -> usize;
    /// The register at an offset.
    fn load(target: &Self::Target, offset: usize) -> R::Lanes;
    /// Adds to the register at an offset.
    fn add(target: &mut Self::Target, offset: usize, value: R::Lanes);
}

/// How log2(1+x) is computed in all of a support.
enum Logarithm {
    /// Not at all: Gaussian.
    None,
    /// No x within the support exceeds [`Lanes::LOG_NEAR`].
    Near,
    /// Any x.
    Any,
}

impl Conic {
    #[inline(always)]
    fn logarithm<L: Lanes, P: Profile>(&self) -> Logarithm {
        match P::IS_STUDENT {
            false => Logarithm::None,
            true if self.max_x <= L::LOG_NEAR => Logarithm::Near,
            true => Logarithm::Any,
        }
    }
}

/// A batch of columns, and intermediate values of its registers.
#[derive(Default)]
pub(crate) struct Scratch<L: Lanes> {
    x: [L; BATCH],
    y: [L; BATCH],
    /// 1/√(1+e).
    root: [L; BATCH],
    log: [L; BATCH],
    power: [L; BATCH],
    columns: ColumnBatch<L>,
    total: Totals<L>,
}

/// Adds a primitive to a target; pixels beyond `max_x` are left unchanged.
#[inline]
pub(crate) fn forward<R: Real, T: Rasterize<R>, P: Profile, J: Rays>(
    primitive: &T,
    target: &mut T::Target,
    scratch: &mut Scratch<R::Lanes>,
) {
    let conic = primitive.conic();
    let lanes = ConicLanes::<R::Lanes>::new::<J>(conic);
    let stride = [T::register_stride(target), T::REGISTER_ROWS];
    primitive.for_each_column(|column, offset, registers| {
        if !scratch.columns.has_room(&registers) {
            accumulate::<R, T, P, J>(conic, &lanes, scratch, target);
        }
        scratch.columns.push::<J, Forward>(&lanes, column, offset, registers, stride);
    });
    accumulate::<R, T, P, J>(conic, &lanes, scratch, target);
}

/// Adds the values of the batch's registers to the target, and empties the batch.
#[inline(never)]
fn accumulate<R: Real, T: Rasterize<R>, P: Profile, J: Rays>(
    conic: &Conic,
    lanes: &ConicLanes<R::Lanes>,
    scratch: &mut Scratch<R::Lanes>,
    target: &mut T::Target,
) {
    let (weight, zero) = (R::Lanes::splat_f64(conic.weight), R::Lanes::default());
    let Scratch { x, root, log, power, columns, .. } = scratch;
    for registers in columns.register_ranges() {
        columns.for_each_distance(lanes, registers.clone(), x.iter_mut().zip(&mut *root), |(x, root), coords| {
            *x = coords.x;
            if J::ARE_EXACT {
                *root = coords.root;
            }
        });
        let offsets = columns.offsets(registers);
        let filled = offsets.len();
        profile::<_, P>(conic, conic.q, filled, x, log, power);
        let (x, root, power) = (&x[..filled], &root[..filled], &power[..filled]);
        for (((&x, &root), &power), &offset) in x.iter().zip(root).zip(power).zip(offsets) {
            let value = if J::ARE_EXACT { power * root } else { power };
            T::add(target, offset as usize, x.select_le(lanes.max_x, value * weight, zero));
        }
    }
    columns.clear();
}

/// (1+x)^-exponent of the first `filled` registers and the logarithms of 1+x, or 2^-x.
#[inline(always)]
fn profile<L: Lanes, P: Profile>(
    conic: &Conic,
    exponent: f64,
    filled: usize,
    x: &[L; BATCH],
    log: &mut [L; BATCH],
    power: &mut [L; BATCH],
) {
    match conic.logarithm::<L, P>() {
        Logarithm::None => return powers(filled, -1.0, x, power),
        Logarithm::Near => logarithms(filled, x, log, Lanes::log2_1p_near_each),
        Logarithm::Any => logarithms(filled, x, log, Lanes::log2_1p_each),
    }
    powers(filled, -exponent, log, power);
}

/// Deliberately not inlined: inside the accumulation loop the polynomial constants would spill.
#[inline(never)]
fn out_of_line(work: impl FnOnce()) {
    work();
}

/// log2(1+x) of the first `filled` registers. One more may be computed from old data; its result is not read.
#[inline(always)]
fn logarithms<L: Lanes>(
    filled: usize,
    x: &[L; BATCH],
    log: &mut [L; BATCH],
    of_group: impl Fn([L; SIDE_BY_SIDE]) -> [L; SIDE_BY_SIDE],
) {
    let (x, log) = (x.as_chunks::<SIDE_BY_SIDE>().0, log.as_chunks_mut().0);
    for (x, log) in x.iter().zip(log).take(filled.div_ceil(SIDE_BY_SIDE)) {
        *log = of_group(*x);
    }
}

/// 2^(factor·exponent) of the first `filled` registers, as [`logarithms`].
#[inline(always)]
fn powers<L: Lanes>(filled: usize, factor: f64, exponent: &[L; BATCH], power: &mut [L; BATCH]) {
    let factor = L::splat_f64(factor);
    let (exponent, power) = (exponent.as_chunks::<SIDE_BY_SIDE>().0, power.as_chunks_mut().0);
    for (exponent, power) in exponent.iter().zip(power).take(filled.div_ceil(SIDE_BY_SIDE)) {
        *power = L::exp2_each(exponent.map(|exponent| factor * exponent));
    }
}

/// Sums `cotangent × derivative` of a primitive over all pixels of its support.
///
/// With a = w·root·(1+x)^-(q+1) and b = a·root²: ∂/∂(δ/unit) = k·g - q·b, ∂/∂h = 2·h·g, ∂/∂k = g·δ/unit, where
/// g = b·((q-½)x - ½) is the derivative to 1+e. For the Gaussian, ln 2 replaces q and q-½, and 2^-x the power. As h
/// and δ/unit are polynomials of y and z, only moments of b and of b·x are summed.
#[inline]
pub(crate) fn vjp<R: Real, T: Rasterize<R>, P: Profile, J: Rays>(
    primitive: &T,
    cotangent: &T::Target,
    scratch: &mut Scratch<R::Lanes>,
) -> Sums {
    let conic = primitive.conic();
    let lanes = ConicLanes::<R::Lanes>::new::<J>(conic);
    let stride = [T::register_stride(cotangent), T::REGISTER_ROWS];
    scratch.total.clear::<J>(T::IS_VOLUME);
    primitive.for_each_column(|column, offset, registers| {
        if !scratch.columns.has_room(&registers) {
            accumulate_moments::<R, T, P, J>(conic, &lanes, scratch, cotangent);
        }
        scratch.columns.push::<J, Vjp>(&lanes, column, offset, registers, stride);
    });
    accumulate_moments::<R, T, P, J>(conic, &lanes, scratch, cotangent);
    let slopes = if P::IS_STUDENT { [conic.q, conic.q - 0.5] } else { [LN_2; 2] };
    scratch.total.sums::<J>(conic, slopes, T::IS_VOLUME)
}

/// Adds the batch's registers to the sums, and empties the batch.
#[inline(never)]
fn accumulate_moments<R: Real, T: Rasterize<R>, P: Profile, J: Rays>(
    conic: &Conic,
    lanes: &ConicLanes<R::Lanes>,
    scratch: &mut Scratch<R::Lanes>,
    cotangent: &T::Target,
) {
    let Scratch { x, y, root, log, power, columns: batch, total } = scratch;
    let zero = R::Lanes::default();
    // Values beyond max_x are multiplied by zero: x must be finite, and its logarithm, near 0, too.
    let beyond = R::Lanes::splat_f64(2.0 * conic.max_x + 1.0);
    let mut columns = batch.columns();
    let mut part = ColumnSums::<R::Lanes>::default();
    for registers in batch.register_ranges() {
        let outputs = x.iter_mut().zip(&mut *y).zip(&mut *root);
        batch.for_each_distance(lanes, registers.clone(), outputs, |((x, y), root), coords| {
            *x = coords.x.at_most(beyond);
            *y = coords.y;
            if J::ARE_EXACT {
                *root = coords.root;
            }
        });
        let offsets = batch.offsets(registers.clone());
        let filled = offsets.len();
        out_of_line(|| profile::<_, P>(conic, conic.q + 1.0, filled, x, log, power));
        let mut begin = 0;
        while let [column, others @ ..] = columns {
            let rest = column.end - registers.start;
            let end = rest.min(filled);
            for i in begin..end {
                let w = T::load(cotangent, offsets[i] as usize);
                let w = if J::ARE_EXACT { w * root[i] } else { w };
                let a = x[i].select_le(lanes.max_x, w * power[i], zero);
                let value = if P::IS_STUDENT { a.fma(x[i], a) } else { a };
                part.value += value;
                if P::IS_STUDENT {
                    part.log = value.fma(log[i], part.log);
                }
                let b = if J::ARE_EXACT { a * (root[i] * root[i]) } else { a };
                part.b.add(b, y[i]);
                if J::ARE_EXACT {
                    part.bx.add(b * x[i], y[i]);
                }
            }
            begin = end;
            if rest > filled {
                // The column continues in the next registers.
                break;
            }
            total.add::<J>(&part, column.z);
            if T::IS_VOLUME {
                total.add_slices(&part, column);
            }
            part = ColumnSums::default();
            columns = others;
        }
    }
    batch.clear();
}
