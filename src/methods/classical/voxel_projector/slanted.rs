//! The rays of views that are not upright, one by one: a turned or tilted detector has no fans.
//!
//! The weights are those of the fans: the planes of Joseph's method, the lengths of Siddon's.

use super::fan::within;
use super::joseph::Slab;
use super::siddon::for_each_cell;
use std::ops::Range;
use trgs_core::geometry::{Grid, View};

/// A ray in voxel units: voxel i has its centre at i.
pub(super) struct SlantedRay {
    origin: [f64; 3],
    /// Voxels per scene unit of length.
    direction: [f64; 3],
}

impl SlantedRay {
    /// The ray through the pixel `k` rows above the lowest one.
    pub(super) fn new(grid: &Grid, view: &View, column: usize, k: usize) -> Self {
        let ray = view.ray(view.detector.rows - 1 - k, column);
        let origin = (ray.origin - grid.min) / grid.spacing - 0.5;
        Self { origin: origin.to_array(), direction: (ray.direction / grid.spacing).to_array() }
    }

    /// The axis that the ray is closest to, in voxels.
    fn main_axis(&self) -> usize {
        let per_voxel = self.direction.map(f64::abs);
        let horizontal = if per_voxel[0] >= per_voxel[1] { 0 } else { 1 };
        if per_voxel[2] > per_voxel[horizontal] { 2 } else { horizontal }
    }

    /// Whether x does not fall from a plane of the main axis to the next.
    pub(super) fn rises(&self) -> bool {
        let main = self.main_axis();
        main == 0 || self.direction[0] * self.direction[main] >= 0.0
    }

    /// Calls `visit(voxel, weight)` for the voxels of the slab by Joseph's method, counted from the slab's first.
    pub(super) fn visit_joseph(&self, slab: &Slab, mut visit: impl FnMut(usize, f64)) {
        let per_voxel = self.direction.map(f64::abs);
        let main = self.main_axis();
        let [a, b] = [[1, 2], [0, 2], [0, 1]][main];
        let ends = ends(slab);
        let low = ends.each_ref().map(|end| end.start as f64 - 1.0);
        let high = ends.each_ref().map(|end| end.end as f64);
        let Some((from, to)) = within(self.origin, self.direction, low, high, f64::NEG_INFINITY) else { return };
        let [from, to] = [from, to].map(|t| self.origin[main] + t * self.direction[main]);
        // A plane more at either end: rounding must not decide which voxels have a weight.
        let planes = (from.min(to).floor() - 1.0).max(ends[main].start as f64) as usize
            ..(from.max(to).ceil() + 2.0).clamp(0.0, ends[main].end as f64) as usize;
        let step = 1.0 / per_voxel[main];
        let strides = strides(slab);
        let first = slab.x.start * strides[0];
        for plane in planes {
            let t = (plane as f64 - self.origin[main]) / self.direction[main];
            let [at_a, at_b] = [a, b].map(|axis| self.origin[axis] + t * self.direction[axis]);
            let (low_a, low_b) = (at_a.floor(), at_b.floor());
            if !slab.owns(if main == 0 { plane as f64 } else { low_a }) {
                continue;
            }
            let (share_a, share_b) = (at_a - low_a, at_b - low_b);
            let (low_a, low_b) = (low_a as isize, low_b as isize);
            for (i, weight_a) in [(low_a, step * (1.0 - share_a)), (low_a + 1, step * share_a)] {
                if !ends[a].contains(&(i as usize)) {
                    continue;
                }
                let line = plane * strides[main] + i as usize * strides[a] - first;
                for (j, weight_b) in [(low_b, 1.0 - share_b), (low_b + 1, share_b)] {
                    if ends[b].contains(&(j as usize)) {
                        visit(line + j as usize * strides[b], weight_a * weight_b);
                    }
                }
            }
        }
    }

    /// Calls `visit(voxel, length)` for the voxels of the slab by Siddon's method, counted from the slab's first.
    pub(super) fn visit_siddon(&self, slab: &Slab, mut visit: impl FnMut(usize, f64)) {
        let strides = strides(slab);
        for_each_cell(self.origin, self.direction, &ends(slab), f64::NEG_INFINITY, |[x, y, z], from, to| {
            visit((x - slab.x.start) * strides[0] + y * strides[1] + z, to - from);
        });
    }
}

/// Index ranges of the slab along x, y and z.
fn ends(slab: &Slab) -> [Range<usize>; 3] {
    [slab.x.clone(), 0..slab.shape[1], 0..slab.shape[2]]
}

/// The distance of neighbours along x, y and z in array order.
fn strides(slab: &Slab) -> [usize; 3] {
    [slab.shape[1] * slab.shape[2], slab.shape[2], 1]
}
