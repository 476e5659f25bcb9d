//! **HOT.** One primitive over a strip of pixels: the only code that runs once per (pixel, primitive).
//!
//! A strip is `WIDTH/2` columns × 2 rows per SIMD register, [`DEPTH`] registers tall. The work is split into
//! stages that each run over the whole strip (distance, logarithm, exponential, use), so that the long chains
//! of one register hide behind those of the others. Within a column of registers the column offset α is
//! constant: half of the quadratic form and two thirds of the moments leave the inner loop.
//!
//! Everything is a power of two. With Δ the squared Mahalanobis distance of the primitive's centre from the
//! ray, x = Δ/unit and root = √r:
//!
//! | kernel | unit | value per density | source |
//! |---|---|---|---|
//! | Student's t | ν | `root·2^(-q·log2(1+x))` | `[Eq. 4]`, `[X3]`: never a power of 1+x |
//! | Gaussian | 2 ln 2 | `root·2^-x` | its limit |
//!
//! Accuracy: the profile is within 1.5e-7 (f32) and 5e-16 (f64) of its peak for every ν from 1 to 10⁴.
//! Tests: `numeric::lanes`, `tests/analytic.rs`, `tests/parity.rs`, `tests/gradients.rs`.

use crate::numeric::{Lanes, Real};
use std::ops::Range;

/// Registers in a strip, each two rows tall.
pub(super) const DEPTH: usize = 16;
/// Rows in a strip.
pub(super) const STRIP: usize = 2 * DEPTH;

/// A primitive seen on a plane of pixels: `α = (column-centre)·step`, `β = (row-centre)·step` and
///
/// `δ/unit = (b·β + ab·α + shift_b)² + (a·α + shift_a)² + floor`, never negative whatever the rounding.
///
/// The exact projection divides by `A/A0 = h² + k·δ/unit`, `h = 1 + h_row·β + h_column·α` `[X1]`.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Plane {
    pub(super) row_centre: f64,
    pub(super) column_centre: f64,
    pub(super) row_step: f64,
    pub(super) column_step: f64,
    pub(super) b: f64,
    pub(super) ab: f64,
    pub(super) a: f64,
    pub(super) shift_b: f64,
    pub(super) shift_a: f64,
    pub(super) floor: f64,
    pub(super) h_row: f64,
    pub(super) h_column: f64,
    pub(super) k: f64,
    /// Exponent of the t-kernel.
    pub(super) q: f64,
    /// Factor in front.
    pub(super) weight: f64,
    /// Largest x that counts.
    pub(super) limit: f64,
}

/// Pixels with room for whole registers: `stride` ≥ columns + WIDTH/2 and an even number of rows.
pub(super) struct Canvas<R> {
    pub(super) pixels: Vec<R>,
    pub(super) stride: usize,
}

/// `Σ over pixels of cotangent × derivative`, per unit of `weight`, in the terms of [`Plane`].
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Sums {
    /// Derivative to δ/unit (at constant h), times 1, α, β, α², αβ, β².
    pub(super) distance: [f64; 6],
    /// Half the derivative to h, times 1, α, β. Exact projection only.
    pub(super) h: [f64; 3],
    /// Derivative to k. Exact projection only.
    pub(super) k: f64,
    /// The values themselves: derivative to `weight`.
    pub(super) value: f64,
    /// Values times log2(1+x). Student's t only.
    pub(super) log: f64,
}

impl Plane {
    /// Whether a pixel lies within the support: x ≤ limit.
    pub(super) fn reaches(&self, row: usize, column: usize) -> bool {
        let alpha = (column as f64 - self.column_centre) * self.column_step;
        let beta = (row as f64 - self.row_centre) * self.row_step;
        let y = self.b * beta + self.ab * alpha + self.shift_b;
        let z = self.a * alpha + self.shift_a;
        let delta = y * y + z * z + self.floor;
        let h = 1.0 + self.h_row * beta + self.h_column * alpha;
        delta / (h * h + self.k * delta) <= self.limit
    }
}

impl<R: Real> Canvas<R> {
    /// Zeros for `rows` × `columns`.
    pub(super) fn new(rows: usize, columns: usize) -> Self {
        let stride = columns + R::Lanes::WIDTH / 2;
        Self { pixels: vec![R::ZERO; rows.next_multiple_of(2) * stride], stride }
    }

    /// The pixels of one row.
    pub(super) fn row(&self, row: usize, columns: usize) -> &[R] {
        &self.pixels[row * self.stride..][..columns]
    }

    /// The pixels of one row.
    pub(super) fn row_mut(&mut self, row: usize, columns: usize) -> &mut [R] {
        &mut self.pixels[row * self.stride..][..columns]
    }
}

/// The intermediate values of one column of registers. Kept from call to call: clearing it would cost as much as
/// a small footprint.
pub(super) struct Scratch<L> {
    beta: [L; DEPTH],
    x: [L; DEPTH],
    delta: [L; DEPTH],
    h: [L; DEPTH],
    r: [L; DEPTH],
    w: [L; DEPTH],
    log: [L; DEPTH],
    power: [L; DEPTH],
}

impl<L: Lanes> Scratch<L> {
    pub(super) fn new() -> Self {
        let empty = [L::default(); DEPTH];
        Self { beta: empty, x: empty, delta: empty, h: empty, r: empty, w: empty, log: empty, power: empty }
    }

    /// The offsets β of a strip's registers, `first` being its first row.
    #[inline(always)]
    fn set_betas(&mut self, plane: &Plane, first: usize, registers: usize) {
        let lanes = L::from_fn(|i| L::Scalar::from_f64((i / (L::WIDTH / 2)) as f64 * plane.row_step));
        for (j, beta) in self.beta[..registers].iter_mut().enumerate() {
            *beta = offset::<L>((first + 2 * j) as f64 - plane.row_centre, plane.row_step) + lanes;
        }
    }
}

/// A distance in pixels as a length, rounded once.
#[inline(always)]
fn offset<L: Lanes>(pixels: f64, step: f64) -> L {
    L::splat(L::Scalar::from_f64(pixels * step))
}

/// What is constant along a column of registers.
struct Column<L> {
    alpha: L,
    y: L,
    floor: L,
    h: L,
}

impl<L: Lanes> Column<L> {
    #[inline(always)]
    fn new(plane: &Plane, column: usize) -> Self {
        let real = |value| L::splat(L::Scalar::from_f64(value));
        let lanes = L::from_fn(|i| L::Scalar::from_f64((i % (L::WIDTH / 2)) as f64 * plane.column_step));
        let alpha = offset::<L>(column as f64 - plane.column_centre, plane.column_step) + lanes;
        let z = real(plane.a) * alpha + real(plane.shift_a);
        Self {
            alpha,
            y: real(plane.ab) * alpha + real(plane.shift_b),
            floor: z * z + real(plane.floor),
            h: real(plane.h_column) * alpha + real(1.0),
        }
    }
}

/// Distances of one register: δ/unit, h, and 1/(h²+k·δ/unit).
#[inline(always)]
fn distances<L: Lanes, const EXACT: bool>(plane: (L, L, L), column: &Column<L>, beta: L) -> (L, L, L) {
    let (b, h_row, k) = plane;
    let y = b * beta + column.y;
    let delta = (y * y + column.floor).at_most(L::splat(L::Scalar::from_f64(L::Scalar::FAR)));
    if EXACT {
        let h = h_row * beta + column.h;
        (delta, h, L::splat(L::Scalar::ONE) / (h * h + k * delta))
    } else {
        (delta, L::default(), L::default())
    }
}

/// Adds a primitive onto the canvas, whose first row is row `origin` of the plane.
///
/// `rows` (even start, at most [`STRIP`] long) and `columns` bound the support; pixels beyond `limit` add nothing.
#[inline]
pub(super) fn forward<R: Real, const STUDENT: bool, const EXACT: bool>(
    plane: &Plane,
    rows: Range<usize>,
    columns: Range<usize>,
    canvas: &mut Canvas<R>,
    origin: usize,
    scratch: &mut Scratch<R::Lanes>,
) {
    type L<R> = <R as Real>::Lanes;
    let half = L::<R>::WIDTH / 2;
    let real = |value| L::<R>::splat(R::from_f64(value));
    let registers = rows.len().div_ceil(2);
    scratch.set_betas(plane, rows.start, registers);
    let Scratch { beta, x, r: root, power, .. } = scratch;
    let (b, h_row, k) = (real(plane.b), real(plane.h_row), real(plane.k));
    let (minus_q, weight, limit, zero) = (real(-plane.q), real(plane.weight), real(plane.limit), L::<R>::default());
    for first in columns.step_by(half) {
        let column = Column::new(plane, first);
        for j in 0..registers {
            let (delta, _, r) = distances::<_, EXACT>((b, h_row, k), &column, beta[j]);
            (x[j], root[j]) = if EXACT { (delta * r, r.sqrt()) } else { (delta, zero) };
        }
        for j in 0..registers {
            power[j] = if STUDENT { minus_q * x[j].log2_1p() } else { -x[j] };
        }
        for j in 0..registers {
            power[j] = power[j].exp2();
        }
        for j in 0..registers {
            let value = if EXACT { power[j] * root[j] } else { power[j] };
            let value = x[j].select_le(limit, value * weight, zero);
            let pixel = (rows.start - origin + 2 * j) * canvas.stride + first;
            let (top, bottom) = canvas.pixels[pixel..].split_at_mut(canvas.stride);
            value.add_to_rows(&mut top[..half], &mut bottom[..half]);
        }
    }
}

/// Sums `cotangent × derivative` of a primitive over `rows` (even start) × `columns` of the whole plane.
///
/// With a = w·root·(1+x)^-(q+1) and b = a·r: ∂/∂(δ/unit) = k·g - q·b, ∂/∂h = 2·h·g, ∂/∂k = g·δ/unit, where
/// g = b·((q-½)x - ½) is the derivative to h²+k·δ/unit. For the Gaussian ln 2 stands for q and q-½, and
/// 2^-x for the power.
#[inline]
pub(super) fn backward<R: Real, const STUDENT: bool, const EXACT: bool>(
    plane: &Plane,
    rows: Range<usize>,
    columns: Range<usize>,
    cotangent: &Canvas<R>,
    scratch: &mut Scratch<R::Lanes>,
) -> Sums {
    type L<R> = <R as Real>::Lanes;
    let half = L::<R>::WIDTH / 2;
    let real = |value| L::<R>::splat(R::from_f64(value));
    let (b, h_row, k) = (real(plane.b), real(plane.h_row), real(plane.k));
    let (limit, zero, point_five) = (real(plane.limit), L::<R>::default(), real(0.5));
    let minus_q_1 = real(-(plane.q + 1.0));
    let (slope, slope_x) = if STUDENT {
        (real(plane.q), real(plane.q - 0.5))
    } else {
        (real(std::f64::consts::LN_2), real(std::f64::consts::LN_2))
    };
    let mut total = Totals::<L<R>>::default();
    for strip in rows.clone().step_by(STRIP) {
        let registers = (rows.end - strip).min(STRIP).div_ceil(2);
        scratch.set_betas(plane, strip, registers);
        let Scratch { beta, x, delta, h, r, w, log, power } = &mut *scratch;
        for first in columns.clone().step_by(half) {
            let column = Column::new(plane, first);
            for j in 0..registers {
                (delta[j], h[j], r[j]) = distances::<_, EXACT>((b, h_row, k), &column, beta[j]);
                let here = if EXACT { delta[j] * r[j] } else { delta[j] };
                let pixel = (strip + 2 * j) * cotangent.stride + first;
                let (top, bottom) = cotangent.pixels[pixel..].split_at(cotangent.stride);
                let cotangent = L::<R>::from_rows(&top[..half], &bottom[..half]);
                let cotangent = if EXACT { cotangent * r[j].sqrt() } else { cotangent };
                // Beyond the limit x becomes 0 as well: no power of it may overflow.
                x[j] = here.select_le(limit, here, zero);
                w[j] = here.select_le(limit, cotangent, zero);
            }
            for j in 0..registers {
                log[j] = if STUDENT { x[j].log2_1p() } else { zero };
            }
            for j in 0..registers {
                power[j] = if STUDENT { (minus_q_1 * log[j]).exp2() } else { (-x[j]).exp2() };
            }
            let mut part = ColumnSums::<L<R>>::default();
            for j in 0..registers {
                let a = w[j] * power[j];
                let value = if STUDENT { a + a * x[j] } else { a };
                part.value += value;
                if STUDENT {
                    part.log += value * log[j];
                }
                let distance = if EXACT {
                    let b = a * r[j];
                    let g = b * (slope_x * x[j] - point_five);
                    let gh = g * h[j];
                    part.h[0] += gh;
                    part.h[1] += gh * beta[j];
                    part.k += g * delta[j];
                    k * g - slope * b
                } else {
                    -(slope * a)
                };
                let first = distance * beta[j];
                part.distance[0] += distance;
                part.distance[1] += first;
                part.distance[2] += first * beta[j];
            }
            total.add::<EXACT>(&part, column.alpha);
        }
    }
    total.sums()
}

/// Sums over one column of registers; the powers of α are still to be multiplied in.
#[derive(Default)]
struct ColumnSums<L> {
    distance: [L; 3],
    h: [L; 2],
    k: L,
    value: L,
    log: L,
}

/// [`Sums`], lane by lane.
#[derive(Default)]
struct Totals<L> {
    distance: [L; 6],
    h: [L; 3],
    k: L,
    value: L,
    log: L,
}

impl<L: Lanes> Totals<L> {
    #[inline(always)]
    fn add<const EXACT: bool>(&mut self, part: &ColumnSums<L>, alpha: L) {
        let times_alpha = part.distance[0] * alpha;
        self.distance[0] += part.distance[0];
        self.distance[1] += times_alpha;
        self.distance[2] += part.distance[1];
        self.distance[3] += times_alpha * alpha;
        self.distance[4] += part.distance[1] * alpha;
        self.distance[5] += part.distance[2];
        self.value += part.value;
        self.log += part.log;
        if EXACT {
            self.h[0] += part.h[0];
            self.h[1] += part.h[0] * alpha;
            self.h[2] += part.h[1];
            self.k += part.k;
        }
    }

    fn sums(&self) -> Sums {
        Sums {
            distance: self.distance.map(L::sum),
            h: self.h.map(L::sum),
            k: self.k.sum(),
            value: self.value.sum(),
            log: self.log.sum(),
        }
    }
}
