//! **HOT.** One primitive over a strip of pixels: the only code that runs once per (pixel, primitive).
//!
//! A strip is `WIDTH/2` columns × 2 rows per SIMD register, [`DEPTH`] registers tall. The work is split into
//! stages that each run over the whole strip (distance, logarithm, exponential, use), so that the long chains
//! of one register hide behind those of the others. Within a column of registers the coordinate z of [`Plane`]
//! is constant: half of the quadratic form and two thirds of the moments leave the inner loop.
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
use std::f64::consts::LN_2;
use std::ops::Range;

/// Registers in a strip, each two rows tall.
pub(super) const DEPTH: usize = 16;
/// Rows in a strip.
pub(super) const STRIP: usize = 2 * DEPTH;

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
}

impl Plane {
    /// Whether a pixel lies within the support: x ≤ limit.
    pub(super) fn reaches(&self, row: usize, column: usize) -> bool {
        let across = column as f64 - self.column_centre;
        let y = self.b * (row as f64 - self.row_centre - self.slant * across);
        let z = self.a * across + self.shift;
        let delta = y * y + z * z + self.floor;
        let h = 1.0 + self.h_y * y + self.h_z * z;
        delta / (h * h + self.k * delta) <= self.limit
    }
}

/// Where the support may lie in a box of pixels. Pixels that it leaves out would have added zeros.
struct Outline<'a> {
    plane: &'a Plane,
    /// What y² + z² may be at most.
    squares: f64,
    /// Rows per unit of y.
    per_y: f64,
}

impl<'a> Outline<'a> {
    /// How much wider it is than the support, so that no rounding of the lanes leads out of it.
    const SPARE: f64 = 1e-3;

    /// From `x ≤ limit`, which is `δ/unit·(1 - limit·k) ≤ limit·h²`, with the largest h that a corner of the box has.
    fn new(plane: &'a Plane, rows: &Range<usize>, columns: &Range<usize>) -> Self {
        let h = |row: usize, column: usize| {
            let across = column as f64 - plane.column_centre;
            let y = plane.b * (row as f64 - plane.row_centre - plane.slant * across);
            (1.0 + plane.h_y * y + plane.h_z * (plane.a * across + plane.shift)).abs()
        };
        let (last_row, last_column) = (rows.end.max(1) - 1, columns.end.max(1) - 1);
        let corners = [(rows.start, columns.start), (rows.start, last_column), (last_row, columns.start)];
        let h = corners.iter().fold(h(last_row, last_column), |most, &(row, column)| most.max(h(row, column)));
        let free = 1.0 - plane.limit * plane.k;
        let most = if free > 0.0 { plane.limit * h * h / free } else { f64::INFINITY };
        let squares = most * (1.0 + Self::SPARE) - plane.floor;
        Self { plane, squares, per_y: 1.0 / plane.b }
    }

    /// The registers, of a strip of `rows` (even start), that pixels of the support in `width` columns from `first` on can
    /// be in.
    #[inline(always)]
    fn registers(&self, rows: &Range<usize>, first: usize, width: usize) -> Range<usize> {
        let plane = self.plane;
        let across = [first, first + width - 1].map(|column| column as f64 - plane.column_centre);
        let [z0, z1] = across.map(|across| plane.a * across + plane.shift);
        let nearest = if z0 * z1 > 0.0 { (z0 * z0).min(z1 * z1) } else { 0.0 };
        let room = self.squares - nearest;
        if room < 0.0 {
            return 0..0;
        }
        let reach = room.sqrt() * self.per_y + Self::SPARE;
        let [a, b] = across.map(|across| plane.row_centre + plane.slant * across);
        // What is not a number bounds nothing.
        let low = (a.min(b) - reach).max(rows.start as f64);
        let high = (a.max(b) + reach).min(rows.end as f64 - 1.0);
        if low > high {
            return 0..0;
        }
        (low as usize - rows.start) / 2..(high as usize - rows.start) / 2 + 1
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

    /// The pixels of one row.
    pub(super) fn row_mut(&mut self, row: usize, columns: usize) -> &mut [R] {
        &mut self.pixels[row * self.stride..][..columns]
    }
}

/// The intermediate values of one column of registers. Kept from call to call: clearing it would cost as much as
/// a small footprint.
pub(super) struct Scratch<L> {
    x: [L; DEPTH],
    y: [L; DEPTH],
    delta: [L; DEPTH],
    h: [L; DEPTH],
    r: [L; DEPTH],
    w: [L; DEPTH],
    log: [L; DEPTH],
    power: [L; DEPTH],
    /// Rows of each register's lanes, from the strip's first row on.
    row: [L; DEPTH],
}

impl<L: Lanes> Scratch<L> {
    pub(super) fn new() -> Self {
        let empty = [L::default(); DEPTH];
        let row = std::array::from_fn(|j| L::from_fn(|i| L::Scalar::from_f64((2 * j + i / (L::WIDTH / 2)) as f64)));
        Self { x: empty, y: empty, delta: empty, h: empty, r: empty, w: empty, log: empty, power: empty, row }
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
        let first = column as f64 - plane.column_centre;
        let across = |i: usize| first + (i % (L::WIDTH / 2)) as f64;
        let ridge = |i: usize| plane.row_centre - first_row as f64 + plane.slant * across(i);
        let z = L::from_fn(|i| L::Scalar::from_f64(plane.a * across(i) + plane.shift));
        Self {
            z,
            floor: z * z + real(plane.floor),
            h: real::<L>(plane.h_z) * z + real(1.0),
            ridge: [
                L::from_fn(|i| L::Scalar::from_f64(ridge(i).floor())),
                L::from_fn(|i| L::Scalar::from_f64(ridge(i) - ridge(i).floor())),
            ],
        }
    }
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

    /// Distances of one register: y, δ/unit, h, and 1/(h²+k·δ/unit).
    #[inline(always)]
    fn distances<const EXACT: bool>(&self, column: &Column<L>, row: L) -> (L, L, L, L) {
        let y = self.b * (row - column.ridge[0] - column.ridge[1]);
        let delta = (y * y + column.floor).at_most(real(L::Scalar::FAR));
        if EXACT {
            let h = self.h_y * y + column.h;
            (y, delta, h, real::<L>(1.0) / (h * h + self.k * delta))
        } else {
            (y, delta, L::default(), L::default())
        }
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
    let half = R::Lanes::WIDTH / 2;
    let Scratch { row, x, r: root, power, .. } = scratch;
    let outline = Outline::new(plane, &rows, &columns);
    let shared = Shared::<R::Lanes>::new(plane);
    let (minus_q, weight, zero) = (real::<R::Lanes>(-plane.q), real(plane.weight), R::Lanes::default());
    for first in columns.step_by(half) {
        let registers = outline.registers(&rows, first, half);
        if registers.is_empty() {
            continue;
        }
        let column = Column::new(plane, rows.start, first);
        for j in registers.clone() {
            let (_, delta, _, r) = shared.distances::<EXACT>(&column, row[j]);
            (x[j], root[j]) = if EXACT { (delta * r, r.sqrt()) } else { (delta, zero) };
        }
        for j in registers.clone() {
            power[j] = if STUDENT { minus_q * x[j].log2_1p() } else { -x[j] };
        }
        for power in &mut power[registers.clone()] {
            *power = power.exp2();
        }
        for j in registers {
            let value = if EXACT { power[j] * root[j] } else { power[j] };
            let value = x[j].select_le(shared.limit, value * weight, zero);
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
    let half = R::Lanes::WIDTH / 2;
    let shared = Shared::<R::Lanes>::new(plane);
    let (zero, point_five) = (R::Lanes::default(), real::<R::Lanes>(0.5));
    let minus_q_1 = real::<R::Lanes>(-(plane.q + 1.0));
    let (slope, slope_x) = if STUDENT { (plane.q, plane.q - 0.5) } else { (LN_2, LN_2) };
    let (slope, slope_x) = (real::<R::Lanes>(slope), real::<R::Lanes>(slope_x));
    let mut total = Totals::<R::Lanes>::default();
    let outline = Outline::new(plane, &rows, &columns);
    for strip in rows.clone().step_by(STRIP) {
        let strip = strip..rows.end.min(strip + STRIP);
        let Scratch { row, x, y, delta, h, r, w, log, power } = &mut *scratch;
        for first in columns.clone().step_by(half) {
            let registers = outline.registers(&strip, first, half);
            if registers.is_empty() {
                continue;
            }
            let column = Column::new(plane, strip.start, first);
            for j in registers.clone() {
                (y[j], delta[j], h[j], r[j]) = shared.distances::<EXACT>(&column, row[j]);
                let here = if EXACT { delta[j] * r[j] } else { delta[j] };
                let pixel = (strip.start + 2 * j) * cotangent.stride + first;
                let (top, bottom) = cotangent.pixels[pixel..].split_at(cotangent.stride);
                let cotangent = R::Lanes::from_rows(&top[..half], &bottom[..half]);
                let cotangent = if EXACT { cotangent * r[j].sqrt() } else { cotangent };
                // Beyond the limit x becomes 0 as well: no power of it may overflow.
                x[j] = here.select_le(shared.limit, here, zero);
                w[j] = here.select_le(shared.limit, cotangent, zero);
            }
            for j in registers.clone() {
                log[j] = if STUDENT { x[j].log2_1p() } else { zero };
            }
            for j in registers.clone() {
                power[j] = if STUDENT { (minus_q_1 * log[j]).exp2() } else { (-x[j]).exp2() };
            }
            let mut part = ColumnSums::<R::Lanes>::default();
            for j in registers {
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
                    part.h[1] += gh * y[j];
                    part.k += g * delta[j];
                    shared.k * g - slope * b
                } else {
                    -(slope * a)
                };
                let first = distance * y[j];
                part.distance[0] += distance;
                part.distance[1] += first;
                part.distance[2] += first * y[j];
            }
            total.add::<EXACT>(&part, column.z);
        }
    }
    total.sums()
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::numeric::rng::{Purpose, stream};
    use rand::RngExt;

    #[test]
    fn an_outline_holds_every_pixel_of_the_support_and_little_else() {
        let mut draws = stream(5, Purpose::Phantom, 0, 0);
        let (mut walked, mut boxed, mut useful) = (0, 0, 0);
        for number in 0..400 {
            let mut draw = |low: f64, high: f64| low + (high - low) * draws.random::<f64>();
            let plane = Plane {
                row_centre: draw(10.0, 50.0),
                column_centre: draw(10.0, 50.0),
                slant: draw(-2.0, 2.0),
                b: draw(0.1, 0.5),
                a: draw(0.1, 0.5),
                shift: draw(-0.1, 0.1),
                floor: draw(0.0, 0.5),
                h_y: if number % 2 == 0 { 0.0 } else { draw(-0.1, 0.1) },
                h_z: draw(-0.1, 0.1),
                k: draw(0.0, 0.02),
                limit: draw(0.3, 3.0),
                ..Plane::default()
            };
            let pixels: Vec<_> = (0..64 * 64).map(|i| (i / 64, i % 64)).filter(|&(r, c)| plane.reaches(r, c)).collect();
            let Some(&(top, _)) = pixels.first() else { continue };
            let bottom = pixels.last().unwrap().0 + 1;
            let columns = pixels.iter().map(|p| p.1).min().unwrap()..pixels.iter().map(|p| p.1).max().unwrap() + 1;
            let rows = top & !1..bottom;
            let outline = Outline::new(&plane, &rows, &columns);
            useful += pixels.len();
            for strip in rows.clone().step_by(STRIP) {
                let strip = strip..rows.end.min(strip + STRIP);
                for first in columns.clone().step_by(8) {
                    let registers = outline.registers(&strip, first, 8);
                    walked += 16 * registers.len();
                    boxed += 16 * strip.len().div_ceil(2);
                    assert!(
                        registers.is_empty() || registers.end <= strip.len().div_ceil(2),
                        "{registers:?} of {strip:?}"
                    );
                    for &(row, column) in &pixels {
                        if strip.contains(&row) && (first..first + 8).contains(&column) {
                            assert!(registers.contains(&((row - strip.start) / 2)), "{plane:?} at {row}, {column}");
                        }
                    }
                }
            }
        }
        assert!(useful > 20_000 && walked * 6 < boxed * 5, "{walked} of {boxed} for {useful}");
    }
}
