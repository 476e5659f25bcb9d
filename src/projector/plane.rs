//! A primitive seen on a plane of pixels, or in a slice of voxels.

use super::canvas::HALF;
use crate::numeric::{Lanes, Real, real};
use std::ops::Range;

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

    /// Finds [`Self::most`], [`Self::corners`] and [`Self::bend`] for a support within these rows and columns. The first from
    /// `x ≤ limit`, which is `δ/unit·(1 - limit·k) ≤ limit·h²`, with the largest h that a corner of the box has.
    #[inline(always)]
    pub(super) fn bound(&mut self, rows: &Range<usize>, columns: &Range<usize>) {
        // h is linear: its value in the middle, and how far it goes from there to a corner.
        let middle = |range: &Range<usize>| 0.5 * (range.start as f64 + range.end as f64 - 1.0);
        let across = middle(columns) - self.column_centre;
        let y = self.b * (middle(rows) - self.row_centre - self.slant * across);
        let steps = [self.h_y * self.b, self.h_z * self.a - self.h_y * self.b * self.slant];
        let reach = 0.5 * (steps[0].abs() * rows.len() as f64 + steps[1].abs() * columns.len() as f64);
        let z = self.a * across + self.shift;
        let tilt = self.h_y * y + self.h_z * z;
        let h = (1.0 + tilt).abs() + reach;
        let free = 1.0 - self.limit * self.k;
        self.most = if free > 0.0 { self.limit * h * h / free } else { f64::INFINITY };
        // Small ellipses along the axes fill their registers as well as an outline could.
        self.corners = columns.len() > PLUMP || (self.slant * columns.len() as f64).abs() > 0.5 * rows.len() as f64;
        // Registers reach beyond the box, by up to two rows and all but one of their columns.
        let [tall, wide] = [0.5 * rows.len() as f64 + 2.0, 0.5 * columns.len() as f64 + HALF as f64];
        let y_most = y.abs() + self.b.abs() * (tall + self.slant.abs() * wide);
        let z_most = z.abs() + self.a.abs() * wide;
        let tilt = tilt.abs() + steps[0].abs() * tall + steps[1].abs() * wide;
        let farthest = y_most * y_most + z_most * z_most + self.floor;
        let bend = tilt * (2.0 + tilt) + self.k * farthest;
        self.bend = if farthest <= f32::FAR { bend } else { f64::INFINITY };
    }
}

/// The same number in every lane.
#[inline(always)]
pub(super) fn all<L: Lanes>(value: f64) -> L {
    L::splat(real(value))
}
