//! **HOT.** One primitive over a strip of pixels: the only code that runs once per (pixel, primitive).
//!
//! A SIMD register is `WIDTH/2` columns × 2 rows of pixels. The work is split into stages that each run over a batch
//! of registers (distance, logarithm, exponential, use; forward, the last two at once), so that the long chains of
//! one register hide behind those of the others. Within a column of registers the coordinate z of [`Plane`] is
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

use super::outline::Outline;
use crate::numeric::{Lanes, NEAR, Real};
use std::f64::consts::LN_2;
use std::ops::Range;

/// Registers in a column of a strip, each two rows tall.
const DEPTH: usize = 16;
/// Rows in a strip.
pub(super) const STRIP: usize = 2 * DEPTH;
/// Registers in a batch: several columns of a small footprint, at least one of a large one.
const BATCH: usize = 2 * DEPTH;

/// Columns of a support that is too small for its outline to be worth its while.
const PLUMP: usize = 24;

/// A primitive seen on a plane of pixels, in coordinates in which its form is a sum of squares:
///
/// ```text
/// δ/unit = y² + z² + floor,   z = a·(column - column_centre) + shift,   y = b·(row - ridge(column)),
/// ridge  = row_centre + slant·(column - column_centre)
/// ```
///
/// It is never negative whatever the rounding, and thin oblique primitives keep their digits because a row's distance
/// from the ridge is taken in pixels, integer part first. The exact projection divides by
/// `A/A0 = h² + k·δ/unit`, `h = 1 + h_y·y + h_z·z` `[X1]`.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Plane {
    pub(super) row_centre: f64,
    pub(super) column_centre: f64,
    pub(super) slant: f64,
    pub(super) b: f64,
    pub(super) a: f64,
    pub(super) shift: f64,
    pub(super) floor: f64,
    pub(super) h_y: f64,
    pub(super) h_z: f64,
    pub(super) k: f64,
    /// Exponent of the t-kernel.
    pub(super) q: f64,
    /// Factor in front.
    pub(super) weight: f64,
    /// Largest x that counts.
    pub(super) limit: f64,
    /// Largest δ/unit within the support.
    pub(super) most: f64,
    /// Whether the support's box has corners worth leaving out.
    pub(super) corners: bool,
}

/// A plane on which a primitive is seen, and where its pixels are on the canvas.
#[derive(Clone, Debug)]
pub(super) struct Slice {
    pub(super) plane: Plane,
    /// Columns that bound the support.
    pub(super) columns: Range<usize>,
    /// Where on the canvas the first pixel of the first row that bounds the support is.
    pub(super) first: usize,
    /// The plane's own coordinate, of which [`Sums::x`] are moments.
    pub(super) x: f64,
}

/// Pixels with room for whole registers: `stride` ≥ columns + WIDTH/2 and an even number of rows.
pub(super) struct Canvas<R> {
    pub(super) pixels: Vec<R>,
    pub(super) stride: usize,
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
    /// No x within the support is beyond [`NEAR`].
    Near,
    Any,
}

impl Plane {
    #[inline(always)]
    fn logarithm<const STUDENT: bool>(&self) -> Logarithm {
        match STUDENT {
            false => Logarithm::None,
            true if self.limit <= NEAR => Logarithm::Near,
            true => Logarithm::Any,
        }
    }

    /// Whether a pixel lies within the support: x ≤ limit.
    pub(super) fn reaches(&self, row: usize, column: usize) -> bool {
        let across = column as f64 - self.column_centre;
        let y = self.b * (row as f64 - self.row_centre - self.slant * across);
        let z = self.a * across + self.shift;
        let delta = y * y + z * z + self.floor;
        let h = 1.0 + self.h_y * y + self.h_z * z;
        delta / (h * h + self.k * delta) <= self.limit
    }

    /// Finds [`Self::most`] and [`Self::corners`] for a support within these rows and columns. From `x ≤ limit`, which is
    /// `δ/unit·(1 - limit·k) ≤ limit·h²`, with the largest h that a corner of the box has.
    #[inline(always)]
    pub(super) fn bound(&mut self, rows: &Range<usize>, columns: &Range<usize>) {
        // h is linear: its value in the middle, and how far it goes from there to a corner.
        let middle = |range: &Range<usize>| 0.5 * (range.start as f64 + range.end as f64 - 1.0);
        let across = middle(columns) - self.column_centre;
        let y = self.b * (middle(rows) - self.row_centre - self.slant * across);
        let steps = [self.h_y * self.b, self.h_z * self.a - self.h_y * self.b * self.slant];
        let reach = 0.5 * (steps[0].abs() * rows.len() as f64 + steps[1].abs() * columns.len() as f64);
        let h = (1.0 + self.h_y * y + self.h_z * (self.a * across + self.shift)).abs() + reach;
        let free = 1.0 - self.limit * self.k;
        self.most = if free > 0.0 { self.limit * h * h / free } else { f64::INFINITY };
        // Small ellipses along the axes fill their registers as well as an outline could.
        self.corners = columns.len() > PLUMP || (self.slant * columns.len() as f64).abs() > 0.5 * rows.len() as f64;
    }
}

impl<R: Real> Canvas<R> {
    /// Zeros for `rows` × `columns`.
    pub(super) fn new(rows: usize, columns: usize) -> Self {
        let stride = columns + R::Lanes::WIDTH / 2;
        Self { pixels: vec![R::ZERO; rows.next_multiple_of(2) * stride], stride }
    }

    /// Zeros again, in some columns of all rows, to the end of the last column's register.
    pub(super) fn clear(&mut self, columns: Range<usize>) {
        let end = columns.end - 1 + R::Lanes::WIDTH / 2;
        for row in self.pixels.chunks_exact_mut(self.stride) {
            row[columns.start..end].fill(R::ZERO);
        }
    }

    /// The pixels of one row.
    pub(super) fn row(&self, row: usize, columns: usize) -> &[R] {
        &self.pixels[row * self.stride..][..columns]
    }
}

/// The intermediate values of a batch of registers. Kept from call to call: clearing it would cost as much as a small
/// footprint.
pub(super) struct Scratch<L> {
    x: [L; BATCH],
    y: [L; BATCH],
    delta: [L; BATCH],
    h: [L; BATCH],
    root: [L; BATCH],
    w: [L; BATCH],
    log: [L; BATCH],
    power: [L; BATCH],
    /// Where a register's first pixel is on the canvas.
    pixel: [usize; BATCH],
    columns: [Ended<L>; BATCH],
    /// Rows of the lanes of a column's registers, from the strip's first row on.
    row: [L; DEPTH],
}

/// A column of registers in a batch.
#[derive(Clone, Copy, Default)]
struct Ended<L> {
    z: L,
    /// x of its slice.
    slice: f64,
    /// Where its registers end.
    end: usize,
}

impl<L: Lanes> Scratch<L> {
    pub(super) fn new() -> Self {
        let empty = [L::default(); BATCH];
        Self {
            x: empty,
            y: empty,
            delta: empty,
            h: empty,
            root: empty,
            w: empty,
            log: empty,
            power: empty,
            pixel: [0; BATCH],
            columns: [Ended::default(); BATCH],
            row: std::array::from_fn(|j| L::from_fn(|i| L::Scalar::from_f64((2 * j + i / (L::WIDTH / 2)) as f64))),
        }
    }
}

/// What is constant along a column of registers.
struct Column<L> {
    z: L,
    floor: L,
    h: L,
    /// The ridge from the strip's first row on: rounded to an integer, and the rest.
    ridge: [L; 2],
}

impl<L: Lanes> Column<L> {
    #[inline(always)]
    fn new(plane: &Plane, first_row: usize, column: usize) -> Self {
        let left = column as f64 - plane.column_centre;
        let top = plane.row_centre - first_row as f64;
        let across: [f64; WIDEST] = std::array::from_fn(|i| left + i as f64);
        let ridge = across.map(|across| top + plane.slant * across);
        let whole = ridge.map(f64::floor);
        let z = both_rows::<L>(across.map(|across| plane.a * across + plane.shift));
        Self {
            z,
            floor: z * z + real(plane.floor),
            h: real::<L>(plane.h_z) * z + real(1.0),
            ridge: [both_rows(whole), both_rows(std::array::from_fn(|i| ridge[i] - whole[i]))],
        }
    }
}

/// Columns of the widest register.
const WIDEST: usize = 8;

/// The same values in both rows of a register, which may have fewer columns.
#[inline(always)]
fn both_rows<L: Lanes>(values: [f64; WIDEST]) -> L {
    let values = values.map(L::Scalar::from_f64);
    L::from_rows(&values[..L::WIDTH / 2], &values[..L::WIDTH / 2])
}

/// The same number in every lane.
#[inline(always)]
fn real<L: Lanes>(value: f64) -> L {
    L::splat(L::Scalar::from_f64(value))
}

/// What all kernels need of a plane, in every lane.
struct Shared<L> {
    b: L,
    h_y: L,
    k: L,
    limit: L,
}

impl<L: Lanes> Shared<L> {
    #[inline(always)]
    fn new(plane: &Plane) -> Self {
        Self { b: real(plane.b), h_y: real(plane.h_y), k: real(plane.k), limit: real(plane.limit) }
    }

    /// Distances of one register: y, δ/unit, h, and √r = 1/√(h²+k·δ/unit).
    #[inline(always)]
    fn distances<const EXACT: bool>(&self, column: &Column<L>, row: L) -> (L, L, L, L) {
        let y = self.b * (row - column.ridge[0] - column.ridge[1]);
        let delta = y.fma(y, column.floor).at_most(real(L::Scalar::FAR));
        if EXACT {
            let h = self.h_y.fma(y, column.h);
            (y, delta, h, h.fma(h, self.k * delta).rsqrt())
        } else {
            (y, delta, L::default(), L::default())
        }
    }
}

/// Adds a primitive onto the canvas, in any number of planes.
///
/// `rows` (even start) and each plane's columns bound the support; pixels beyond `limit` add nothing.
#[inline]
pub(super) fn forward<R: Real, const STUDENT: bool, const EXACT: bool>(
    slices: &[Slice],
    rows: Range<usize>,
    canvas: &mut Canvas<R>,
    scratch: &mut Scratch<R::Lanes>,
) {
    let half = R::Lanes::WIDTH / 2;
    let Some(Slice { plane: any, .. }) = slices.first() else { return };
    let shared = Shared::<R::Lanes>::new(any);
    let mut filled = 0;
    for Slice { plane, columns, first: begin, .. } in slices {
        Outline::new(plane).walk(&rows, columns, half, |strip, first, registers| {
            if filled + registers.len() > BATCH {
                paint::<R, STUDENT, EXACT>(any, &shared, filled, scratch, canvas);
                filled = 0;
            }
            let column = Column::new(plane, strip.start, first);
            let top = begin + (strip.start - rows.start) * canvas.stride + first;
            for j in registers {
                let (_, delta, _, root) = shared.distances::<EXACT>(&column, scratch.row[j]);
                if EXACT {
                    scratch.root[filled] = root;
                }
                scratch.x[filled] = if EXACT { delta * (root * root) } else { delta };
                scratch.pixel[filled] = top + 2 * j * canvas.stride;
                filled += 1;
            }
        });
    }
    paint::<R, STUDENT, EXACT>(any, &shared, filled, scratch, canvas);
}

/// Adds the values of a batch, whose first `filled` registers have their distances, onto the canvas.
#[inline(always)]
fn paint<R: Real, const STUDENT: bool, const EXACT: bool>(
    plane: &Plane,
    shared: &Shared<R::Lanes>,
    filled: usize,
    scratch: &mut Scratch<R::Lanes>,
    canvas: &mut Canvas<R>,
) {
    let half = R::Lanes::WIDTH / 2;
    let (minus_q, weight, zero) = (real::<R::Lanes>(-plane.q), real(plane.weight), R::Lanes::default());
    let Scratch { x, root, power, pixel, .. } = scratch;
    let (x, root, power, pixel) = (&x[..filled], &root[..filled], &mut power[..filled], &pixel[..filled]);
    let logs = power.iter_mut().zip(x);
    match plane.logarithm::<STUDENT>() {
        Logarithm::None => logs.for_each(|(power, &x)| *power = -x),
        Logarithm::Near => logs.for_each(|(power, &x)| *power = minus_q * x.log2_1p_near()),
        Logarithm::Any => logs.for_each(|(power, &x)| *power = minus_q * x.log2_1p()),
    }
    for (((&x, &root), &power), &pixel) in x.iter().zip(root).zip(&*power).zip(pixel) {
        let power = power.exp2();
        let value = if EXACT { power * root } else { power };
        let value = x.select_le(shared.limit, value * weight, zero);
        let (top, bottom) = canvas.pixels[pixel..].split_at_mut(canvas.stride);
        value.add_to_rows(&mut top[..half], &mut bottom[..half]);
    }
}

/// Sums `cotangent × derivative` of a primitive over `rows` (even start) × the columns of each plane.
///
/// With a = w·root·(1+x)^-(q+1) and b = a·r: ∂/∂(δ/unit) = k·g - q·b, ∂/∂h = 2·h·g, ∂/∂k = g·δ/unit, where
/// g = b·((q-½)x - ½) is the derivative to h²+k·δ/unit. For the Gaussian ln 2 stands for q and q-½, and
/// 2^-x for the power.
#[inline]
pub(super) fn backward<R: Real, const STUDENT: bool, const EXACT: bool, const SOLID: bool>(
    slices: &[Slice],
    rows: Range<usize>,
    cotangent: &Canvas<R>,
    scratch: &mut Scratch<R::Lanes>,
) -> Sums {
    let half = R::Lanes::WIDTH / 2;
    let Some(Slice { plane: any, .. }) = slices.first() else { return Sums::default() };
    let shared = Shared::<R::Lanes>::new(any);
    let zero = R::Lanes::default();
    let mut total = Totals::<R::Lanes>::default();
    let (mut filled, mut ended) = (0, 0);
    for Slice { plane, columns, first: begin, x: slice } in slices {
        Outline::new(plane).walk(&rows, columns, half, |strip, first, registers| {
            if filled + registers.len() > BATCH {
                gather::<R, STUDENT, EXACT, SOLID>(any, &shared, filled, ended, scratch, &mut total);
                (filled, ended) = (0, 0);
            }
            let column = Column::new(plane, strip.start, first);
            let top = begin + (strip.start - rows.start) * cotangent.stride + first;
            for j in registers {
                let (y, delta, h, root) = shared.distances::<EXACT>(&column, scratch.row[j]);
                let x = if EXACT { delta * (root * root) } else { delta };
                let (top, bottom) = cotangent.pixels[top + 2 * j * cotangent.stride..].split_at(cotangent.stride);
                let w = R::Lanes::from_rows(&top[..half], &bottom[..half]);
                let w = if EXACT { w * root } else { w };
                // Beyond the limit x becomes 0 as well: no power of it may overflow.
                scratch.x[filled] = x.select_le(shared.limit, x, zero);
                scratch.w[filled] = x.select_le(shared.limit, w, zero);
                scratch.y[filled] = y;
                if EXACT {
                    (scratch.delta[filled], scratch.h[filled], scratch.root[filled]) = (delta, h, root);
                }
                filled += 1;
            }
            scratch.columns[ended] = Ended { z: column.z, slice: *slice, end: filled };
            ended += 1;
        });
    }
    gather::<R, STUDENT, EXACT, SOLID>(any, &shared, filled, ended, scratch, &mut total);
    total.sums::<EXACT, SOLID>()
}

/// Adds a batch to the sums: its first `filled` registers, in its first `ended` columns.
#[inline(always)]
fn gather<R: Real, const STUDENT: bool, const EXACT: bool, const SOLID: bool>(
    plane: &Plane,
    shared: &Shared<R::Lanes>,
    filled: usize,
    ended: usize,
    scratch: &mut Scratch<R::Lanes>,
    total: &mut Totals<R::Lanes>,
) {
    let minus_point_five = real::<R::Lanes>(-0.5);
    let minus_q_1 = real::<R::Lanes>(-(plane.q + 1.0));
    let (slope, slope_x) = if STUDENT { (plane.q, plane.q - 0.5) } else { (LN_2, LN_2) };
    let (minus_slope, slope_x) = (real::<R::Lanes>(-slope), real::<R::Lanes>(slope_x));
    let Scratch { x, y, delta, h, root, w, log, power, columns, .. } = scratch;
    let (log, power) = (&mut log[..filled], &mut power[..filled]);
    let logs = log.iter_mut().zip(&*x);
    match plane.logarithm::<STUDENT>() {
        Logarithm::None => {}
        Logarithm::Near => logs.for_each(|(log, x)| *log = x.log2_1p_near()),
        Logarithm::Any => logs.for_each(|(log, x)| *log = x.log2_1p()),
    }
    if STUDENT {
        power.iter_mut().zip(&*log).for_each(|(power, &log)| *power = (minus_q_1 * log).exp2());
    } else {
        power.iter_mut().zip(&*x).for_each(|(power, &x)| *power = (-x).exp2());
    }
    let mut begin = 0;
    for column in &columns[..ended] {
        let mut part = ColumnSums::<R::Lanes>::default();
        for j in begin..column.end {
            let a = w[j] * power[j];
            let value = if STUDENT { a.fma(x[j], a) } else { a };
            part.value += value;
            if STUDENT {
                part.log = value.fma(log[j], part.log);
            }
            let distance = if EXACT {
                let b = a * (root[j] * root[j]);
                let g = b * slope_x.fma(x[j], minus_point_five);
                let gh = g * h[j];
                part.h[0] += gh;
                part.h[1] = gh.fma(y[j], part.h[1]);
                part.k = g.fma(delta[j], part.k);
                shared.k.fma(g, minus_slope * b)
            } else {
                minus_slope * a
            };
            let first = distance * y[j];
            part.distance[0] += distance;
            part.distance[1] += first;
            part.distance[2] = first.fma(y[j], part.distance[2]);
        }
        total.add::<EXACT>(&part, column.z);
        if SOLID {
            total.add_slice(&part, column);
        }
        begin = column.end;
    }
}

/// Sums over one column of registers; the powers of z are still to be multiplied in.
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
    x: [L; 4],
}

impl<L: Lanes> Totals<L> {
    #[inline(always)]
    fn add<const EXACT: bool>(&mut self, part: &ColumnSums<L>, z: L) {
        let times_z = part.distance[0] * z;
        self.distance[0] += part.distance[0];
        self.distance[1] += part.distance[1];
        self.distance[2] += times_z;
        self.distance[3] += part.distance[2];
        self.distance[4] += part.distance[1] * z;
        self.distance[5] += times_z * z;
        self.value += part.value;
        self.log += part.log;
        if EXACT {
            self.h[0] += part.h[0];
            self.h[1] += part.h[1];
            self.h[2] += part.h[0] * z;
            self.k += part.k;
        }
    }

    /// The moments of x, which is the same in all pixels of a slice.
    #[inline(always)]
    fn add_slice(&mut self, part: &ColumnSums<L>, column: &Ended<L>) {
        let x = real::<L>(column.slice);
        let times_x = part.distance[0] * x;
        self.x[0] += times_x;
        self.x[1] += times_x * x;
        self.x[2] += part.distance[1] * x;
        self.x[3] += times_x * column.z;
    }

    fn sums<const EXACT: bool, const SOLID: bool>(&self) -> Sums {
        let mut sums = Sums {
            distance: std::array::from_fn(|i| self.distance[i].sum()),
            value: self.value.sum(),
            log: self.log.sum(),
            ..Sums::default()
        };
        if EXACT {
            sums.h = std::array::from_fn(|i| self.h[i].sum());
            sums.k = self.k.sum();
        }
        if SOLID {
            sums.x = std::array::from_fn(|i| self.x[i].sum());
        }
        sums
    }
}
