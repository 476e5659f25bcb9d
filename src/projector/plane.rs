//! A primitive seen on a plane of pixels, or in a slice of voxels.

use super::canvas::HALF;
use super::extents::Indices;
use crate::numeric::vectors::{LANES, f64x8, splat};
use crate::numeric::{Lanes, Real};
#[cfg(test)]
use std::ops::Range;

/// Columns of a support that is too small for its outline to be worth its while: at most one register of a row.
const PLUMP: usize = 16;

/// A primitive seen on a plane of pixels, in coordinates in which its form is a sum of squares:
///
/// ```text
/// δ/unit = y² + z² + floor,   z = a·(column - column_centre) + shift,   y = b·(row - ridge(column)),
/// ridge  = row_centre + slant·(column - column_centre)
/// ```
///
/// It is never negative whatever the rounding, and thin oblique primitives keep their digits because a row's distance
/// from the ridge is taken in pixels, integer part first. The exact projection divides by
/// `A/A0 = h² + k·δ/unit = 1 + e`, `h = 1 + h_y·y + h_z·z` `[X1]`. Along a column e is a polynomial of y.
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
    /// Bound on |e| in all registers that may be walked.
    pub(super) bend: f64,
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

/// f64x8 planes, with what [`Plane`] says of each field.
pub(super) struct Planes {
    pub(super) row_centre: f64x8,
    pub(super) column_centre: f64x8,
    pub(super) slant: f64x8,
    pub(super) b: f64x8,
    pub(super) a: f64x8,
    pub(super) shift: f64x8,
    pub(super) floor: f64x8,
    pub(super) h_y: f64x8,
    pub(super) h_z: f64x8,
    pub(super) k: f64x8,
    pub(super) q: f64x8,
    pub(super) weight: f64x8,
    pub(super) limit: f64x8,
}

/// [`Plane::most`], [`Plane::bend`] and, where not 0, [`Plane::corners`] of eight planes.
pub(super) struct Bounds {
    pub(super) most: f64x8,
    pub(super) bend: f64x8,
    pub(super) corners: f64x8,
}

impl Planes {
    /// The bounds of supports within these rows and columns. [`Plane::most`] follows from `x ≤ limit`, which is
    /// `δ/unit·(1 - limit·k) ≤ limit·h²`, with the largest h that a corner of the box has.
    #[inline(always)]
    pub(super) fn bounds(&self, rows: Indices, columns: Indices) -> Bounds {
        let half = splat(0.5);
        let (tall, wide) = (rows.len(), columns.len());
        // h is linear: its value in the middle, and how far it goes from there to a corner.
        let middle = |range: Indices| half * (range.start + range.end - splat(1.0));
        let across = middle(columns) - self.column_centre;
        let y = self.b * (middle(rows) - self.row_centre - self.slant * across);
        let steps = [self.h_y * self.b, self.h_z * self.a - self.h_y * self.b * self.slant];
        let reach = half * (steps[0].abs() * tall + steps[1].abs() * wide);
        let z = self.a * across + self.shift;
        let tilt = self.h_y * y + self.h_z * z;
        let h = (splat(1.0) + tilt).abs() + reach;
        let free = splat(1.0) - self.limit * self.k;
        let infinite = splat(f64::INFINITY);
        let most = free.simd_gt(splat(0.0)).select(self.limit * h * h / free, infinite);
        // Small ellipses along the axes fill their registers as well as an outline could.
        let oblique = (self.slant * wide).abs().simd_gt(half * tall);
        let corners = wide.simd_gt(splat(PLUMP as f64)) | oblique;
        // Registers reach beyond the box, by up to two rows and all but one of their columns.
        let (tall, wide) = (half * tall + splat(2.0), half * wide + splat(HALF as f64));
        let y_most = y.abs() + self.b.abs() * (tall + self.slant.abs() * wide);
        let z_most = z.abs() + self.a.abs() * wide;
        let tilt = tilt.abs() + steps[0].abs() * tall + steps[1].abs() * wide;
        let farthest = y_most * y_most + z_most * z_most + self.floor;
        let bend = tilt * (splat(2.0) + tilt) + self.k * farthest;
        Bounds { most, bend: farthest.select_le(splat(f32::FAR), bend, infinite), corners }
    }

    /// One plane for each lane.
    #[inline(always)]
    pub(super) fn to_array(&self, bounds: &Bounds) -> [Plane; LANES] {
        let Self { row_centre, column_centre, slant, b, a, shift, floor, h_y, h_z, k, q, weight, limit } = *self;
        let fields = [row_centre, column_centre, slant, b, a, shift, floor, h_y, h_z, k, q, weight, limit];
        let (fields, [most, bend]) = (fields.map(f64x8::to_array), [bounds.most, bounds.bend].map(f64x8::to_array));
        let corners = bounds.corners.to_bitmask();
        std::array::from_fn(|i| {
            let [row_centre, column_centre, slant, b, a, shift, floor, h_y, h_z, k, q, weight, limit] =
                fields.map(|field| field[i]);
            Plane {
                row_centre,
                column_centre,
                slant,
                b,
                a,
                shift,
                floor,
                h_y,
                h_z,
                k,
                q,
                weight,
                limit,
                most: most[i],
                corners: corners >> i & 1 == 1,
                bend: bend[i],
            }
        })
    }
}

#[cfg(test)]
impl Plane {
    /// The same with its bounds, for a support within these rows and columns.
    pub(super) fn bounded(&self, rows: &Range<usize>, columns: &Range<usize>) -> Self {
        let Self { row_centre, column_centre, slant, b, a, shift, floor, h_y, h_z, k, q, weight, limit, .. } = *self;
        let fields = [row_centre, column_centre, slant, b, a, shift, floor, h_y, h_z, k, q, weight, limit];
        let [row_centre, column_centre, slant, b, a, shift, floor, h_y, h_z, k, q, weight, limit] = fields.map(splat);
        let planes = Planes { row_centre, column_centre, slant, b, a, shift, floor, h_y, h_z, k, q, weight, limit };
        let indices = |range: &Range<usize>| Indices { start: splat(range.start as f64), end: splat(range.end as f64) };
        planes.to_array(&planes.bounds(indices(rows), indices(columns)))[0]
    }
}
