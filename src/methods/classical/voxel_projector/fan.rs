//! The rays of one detector column: they share a vertical plane, hence one path through x and y.

use crate::classical::resample::Places;
use std::ops::Range;
use trgs_core::geometry::{Beam, Grid, View};

/// The rays through the pixels of one column, in voxel units: voxel i has its centre at i.
///
/// A point of ray k, counted from the lowest row, is `(x, y) = origin + s·direction`, `z = height + (low + k·pitch)·m`
/// with `m = s` in a cone beam, whose rays diverge from the source, and `m = 1` in a parallel beam.
pub(super) struct Fan {
    pub(super) origin: [f64; 2],
    pub(super) direction: [f64; 2],
    height: f64,
    low: f64,
    pitch: f64,
    is_cone: bool,
    /// Length of the direction in the x-y plane, and the spacing along z, scene units.
    horizontal: f64,
    spacing_z: f64,
}

impl Fan {
    /// The rays of a column of an upright view.
    pub(super) fn new(grid: &Grid, view: &View, column: usize) -> Self {
        let detector = &view.detector;
        let (u, v_of_lowest) = detector.position((detector.rows - 1) as f64, column as f64);
        let (source, along) = match view.beam {
            Beam::Cone { dsd, .. } => (view.source, view.u * u + view.w * dsd),
            Beam::Parallel { .. } => (view.source + view.u * u, view.w),
        };
        let origin = (source - grid.min) / grid.spacing - 0.5;
        let direction = along / grid.spacing;
        Self {
            origin: [origin.x, origin.y],
            direction: [direction.x, direction.y],
            height: origin.z,
            // v points down.
            low: -v_of_lowest / grid.spacing.z,
            pitch: detector.pitch_v / grid.spacing.z,
            is_cone: matches!(view.beam, Beam::Cone { .. }),
            horizontal: along.length(),
            spacing_z: grid.spacing.z,
        }
    }

    /// 0 if the rays run closer to x than to y, else 1.
    pub(super) fn main_axis(&self) -> usize {
        usize::from(self.direction[0].abs() < self.direction[1].abs())
    }

    /// Whether x does not fall from a plane of the main axis to the next.
    pub(super) fn rises(&self) -> bool {
        self.main_axis() == 0 || self.direction[0] * self.direction[1] >= 0.0
    }

    /// Whether x does not fall along the steep ray k from a slice in z to the next.
    pub(super) fn rises_along_z(&self, k: usize) -> bool {
        self.direction[0] * self.slope(k) >= 0.0
    }

    /// Voxels that ray k rises per unit of s.
    pub(super) fn slope(&self, k: usize) -> f64 {
        if self.is_cone { self.low + k as f64 * self.pitch } else { 0.0 }
    }

    /// The heights of the rays at s, in voxels: row k at `first + k·pitch`.
    pub(super) fn level(&self, s: f64) -> Places {
        let m = if self.is_cone { s } else { 1.0 };
        Places { first: self.height + self.low * m, pitch: self.pitch * m }
    }

    /// The s at which ray k reaches the height z; `None` for a horizontal ray.
    pub(super) fn crossing(&self, k: usize, z: f64) -> Option<f64> {
        let slope = self.slope(k);
        (slope != 0.0).then(|| (z - self.height) / slope)
    }

    /// Length of ray k per unit of s, scene units.
    pub(super) fn length(&self, k: usize) -> f64 {
        let rise = self.slope(k) * self.spacing_z;
        (self.horizontal * self.horizontal + rise * rise).sqrt()
    }

    /// The rays, of `rows`, that rise at most one voxel per voxel along the main axis.
    pub(super) fn shallow(&self, rows: usize) -> Range<usize> {
        let steepest = self.direction[self.main_axis()].abs();
        let is_shallow = |k: &usize| self.slope(*k).abs() <= steepest;
        // Slopes grow with k, so rays between two shallow rays are shallow.
        let first = (0..rows).find(is_shallow).unwrap_or(rows);
        let last = (first..rows).rev().find(is_shallow);
        first..last.map_or(first, |last| last + 1)
    }

    /// The interval of s in which the rays satisfy `low < coordinate < high` on both axes, x and y.
    pub(super) fn within(&self, low: [f64; 2], high: [f64; 2]) -> Option<(f64, f64)> {
        within(self.origin, self.direction, low, high, self.start())
    }

    /// The smallest s of the grid: it is in front of the source of a cone beam.
    pub(super) fn start(&self) -> f64 {
        if self.is_cone { 0.0 } else { f64::NEG_INFINITY }
    }
}

/// The interval from `start` on of s in which `low < origin + s·direction < high` on all axes.
pub(super) fn within<const N: usize>(
    origin: [f64; N],
    direction: [f64; N],
    low: [f64; N],
    high: [f64; N],
    start: f64,
) -> Option<(f64, f64)> {
    let mut part = (start, f64::INFINITY);
    for axis in 0..N {
        let (origin, direction) = (origin[axis], direction[axis]);
        if direction == 0.0 {
            if !(low[axis] < origin && origin < high[axis]) {
                return None;
            }
        } else {
            let (a, b) = ((low[axis] - origin) / direction, (high[axis] - origin) / direction);
            part = (part.0.max(a.min(b)), part.1.min(a.max(b)));
        }
    }
    (part.0 < part.1).then_some(part)
}
