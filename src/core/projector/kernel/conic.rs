//! A primitive on a plane of pixels, or in a slice of voxels, as a conic in the coordinates of the kernel.

use super::buffers::HALF;
use super::extents::Indices;
use crate::numeric::vectors::{LANES, f64x8, splat};
use crate::numeric::{Lanes, Real};
use std::array;
#[cfg(test)]
use std::ops::Range;

/// Columns of a support from which trimming the corners of its box pays: more than one register of a row.
const MIN_OUTLINE_WIDTH: f64 = 16.0;

/// A primitive on a plane of pixels, in coordinates in which its quadratic form is a sum of squares:
///
/// ```text
/// δ/unit = y² + z² + floor,   z = a·(column - column_centre) + shift,   y = b·(row - ridge(column)),
/// ridge  = row_centre + slant·(column - column_centre)
/// ```
///
/// The sum is never negative, whatever the rounding. Thin oblique primitives keep their digits because a row's distance
/// from the ridge is taken in pixels, integer part first. The exact projection divides by
/// `A/A0 = h² + k·δ/unit = 1 + e`, `h = 1 + h_y·y + h_z·z` `[X1]`. Along a column e is a polynomial of y.
///
/// `N` is a number (`f64`) or one per lane (`f64x8`); `M` is a truth value (`bool`) or a lane mask (`f64x8`).
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Conic<N = f64, M = bool> {
    pub(crate) row_centre: N,
    pub(crate) column_centre: N,
    pub(crate) slant: N,
    pub(crate) b: N,
    pub(crate) a: N,
    pub(crate) shift: N,
    pub(crate) floor: N,
    pub(crate) h_y: N,
    pub(crate) h_z: N,
    pub(crate) k: N,
    /// Exponent of the t-kernel.
    pub(crate) q: N,
    /// Factor of all values.
    pub(crate) weight: N,
    /// Largest x of the support.
    pub(crate) max_x: N,
    /// Bound on δ/unit within the support.
    pub(crate) max_delta: N,
    /// Bound on |e| in all registers that may be visited.
    pub(crate) max_abs_e: N,
    /// Whether trimming the corners of the support's box pays.
    pub(crate) trims_corners: M,
}

/// The conics of eight primitives.
pub(crate) type ConicX8 = Conic<f64x8, f64x8>;

impl<N, M> Conic<N, M> {
    /// Applies `number` to all numbers and `mask` to the truth value.
    #[inline(always)]
    fn map<P, Q>(&self, number: impl Fn(&N) -> P, mask: impl Fn(&M) -> Q) -> Conic<P, Q> {
        Conic {
            row_centre: number(&self.row_centre),
            column_centre: number(&self.column_centre),
            slant: number(&self.slant),
            b: number(&self.b),
            a: number(&self.a),
            shift: number(&self.shift),
            floor: number(&self.floor),
            h_y: number(&self.h_y),
            h_z: number(&self.h_z),
            k: number(&self.k),
            q: number(&self.q),
            weight: number(&self.weight),
            max_x: number(&self.max_x),
            max_delta: number(&self.max_delta),
            max_abs_e: number(&self.max_abs_e),
            trims_corners: mask(&self.trims_corners),
        }
    }
}

impl Conic {
    /// Whether a pixel lies within the support: x ≤ max_x.
    pub(crate) fn contains(&self, row: usize, column: usize) -> bool {
        let across = column as f64 - self.column_centre;
        let y = self.b * (row as f64 - self.row_centre - self.slant * across);
        let z = self.a * across + self.shift;
        let delta = y * y + z * z + self.floor;
        let h = 1.0 + self.h_y * y + self.h_z * z;
        delta / (h * h + self.k * delta) <= self.max_x
    }
}

impl ConicX8 {
    /// Sets the bounds of supports within these rows and columns.
    ///
    /// `max_delta` follows from `x ≤ max_x`, which is `δ/unit·(1 - max_x·k) ≤ max_x·h²`, with the largest h at a corner of
    /// the box.
    #[inline(always)]
    pub(crate) fn bounded(self, rows: Indices, columns: Indices) -> Self {
        let half = splat(0.5);
        let (tall, wide) = (rows.len(), columns.len());
        // h is linear: its value in the middle of the box, and its change from there to a corner.
        let middle = |range: Indices| half * (range.start + range.end - splat(1.0));
        let across = middle(columns) - self.column_centre;
        let y = self.b * (middle(rows) - self.row_centre - self.slant * across);
        let slopes = [self.h_y * self.b, self.h_z * self.a - self.h_y * self.b * self.slant];
        let change = half * (slopes[0].abs() * tall + slopes[1].abs() * wide);
        let z = self.a * across + self.shift;
        let tilt = self.h_y * y + self.h_z * z;
        let h = (splat(1.0) + tilt).abs() + change;
        let free = splat(1.0) - self.max_x * self.k;
        let infinite = splat(f64::INFINITY);
        let max_delta = free.simd_gt(splat(0.0)).select(self.max_x * h * h / free, infinite);
        // Small ellipses along the axes fill their registers as well as an outline could.
        let oblique = (self.slant * wide).abs().simd_gt(half * tall);
        let trims_corners = wide.simd_gt(splat(MIN_OUTLINE_WIDTH)) | oblique;
        // Registers extend beyond the box, by up to two rows and all but one of their columns.
        let (tall, wide) = (half * tall + splat(2.0), half * wide + splat(HALF as f64));
        let max_y = y.abs() + self.b.abs() * (tall + self.slant.abs() * wide);
        let max_z = z.abs() + self.a.abs() * wide;
        let tilt = tilt.abs() + slopes[0].abs() * tall + slopes[1].abs() * wide;
        let farthest = max_y * max_y + max_z * max_z + self.floor;
        let max_abs_e = tilt * (splat(2.0) + tilt) + self.k * farthest;
        let max_abs_e = farthest.select_le(splat(f32::FAR), max_abs_e, infinite);
        Self { max_delta, max_abs_e, trims_corners, ..self }
    }

    /// The conic of each lane.
    #[inline(always)]
    pub(crate) fn to_array(self) -> [Conic; LANES] {
        let lanes = self.map(|number| number.to_array(), |mask| mask.to_bitmask());
        array::from_fn(|i| lanes.map(|number| number[i], |mask| mask >> i & 1 == 1))
    }
}

#[cfg(test)]
impl Conic {
    /// The same with its bounds, for a support within these rows and columns.
    pub(crate) fn with_bounds(&self, rows: &Range<usize>, columns: &Range<usize>) -> Self {
        let indices = |range: &Range<usize>| Indices { start: splat(range.start as f64), end: splat(range.end as f64) };
        let lanes = self.map(|&number| splat(number), |_| splat(0.0));
        lanes.bounded(indices(rows), indices(columns)).to_array()[0]
    }
}
