//! Siddon's method: the length of the ray in each voxel.

use super::fan::Fan;
use super::joseph::Slab;
use std::ops::Range;

/// A voxel in the x-y plane, entered at s = from and left at s = to.
struct Cell {
    x: usize,
    y: usize,
    from: f64,
    to: f64,
}

impl Fan {
    /// Calls `visit(line, z, k, length)` for all voxels of the slab on each ray k of `rows`.
    pub(super) fn visit_siddon(
        &self,
        rows: Range<usize>,
        slab: &Slab,
        mut visit: impl FnMut(usize, usize, usize, f64),
    ) {
        let nz = slab.shape[2] as f64;
        let lengths: Vec<f64> = rows.clone().map(|k| self.length(k)).collect();
        self.for_each_cell(slab, |cell| {
            let line = (cell.x - slab.x.start) * slab.shape[1] + cell.y;
            let (enter, leave) = (self.level(cell.from), self.level(cell.to));
            // The union of the rays inside at either end: heights in between lie between both.
            let (a, b) = (enter.within(&rows, -0.5, nz - 0.5), leave.within(&rows, -0.5, nz - 0.5));
            for k in a.start.min(b.start)..a.end.max(b.end) {
                // Voxel z spans z to z + 1 here.
                let (a, b) = (enter.at(k) + 0.5, leave.at(k) + 0.5);
                let (low, high) = if a < b { (a, b) } else { (b, a) };
                let length = (cell.to - cell.from) * lengths[k - rows.start];
                let (from, to) = (low.max(0.0), high.min(nz));
                if from > to || from >= nz {
                    continue;
                }
                let (first, last) = (from.floor(), to.floor());
                if first == last {
                    // Includes rays of constant height.
                    let part = if low == high { 1.0 } else { (to - from) / (high - low) };
                    visit(line, first as usize, k, length * part);
                    continue;
                }
                let per_voxel = length / (high - low);
                for z in first as usize..=(last.min(nz - 1.0) as usize) {
                    let part = to.min(z as f64 + 1.0) - from.max(z as f64);
                    visit(line, z, k, part * per_voxel);
                }
            }
        });
    }

    /// The voxels in the x-y plane that the rays pass, in order.
    fn for_each_cell(&self, slab: &Slab, mut f: impl FnMut(&Cell)) {
        let ends = [slab.x.clone(), 0..slab.shape[1]];
        let (low, high) =
            (ends.clone().map(|end| end.start as f64 - 0.5), ends.clone().map(|end| end.end as f64 - 0.5));
        let Some((mut from, end)) = self.within(low, high) else { return };
        let mut cell = [0, 1].map(|axis| {
            let at = (self.origin[axis] + from * self.direction[axis] + 0.5).floor();
            at.clamp(ends[axis].start as f64, ends[axis].end as f64 - 1.0)
        });
        // Computed from the index of the border and not from the previous crossing, so that rounding errors do not add
        // up.
        let crossing = |axis: usize, at: f64| {
            let (direction, origin) = (self.direction[axis], self.origin[axis]);
            let border = if direction > 0.0 { at + 0.5 } else { at - 0.5 };
            if direction == 0.0 { f64::INFINITY } else { (border - origin) / direction }
        };
        while from < end {
            let next = [crossing(0, cell[0]), crossing(1, cell[1])];
            let to = end.min(next[0]).min(next[1]);
            if to > from {
                f(&Cell { x: cell[0] as usize, y: cell[1] as usize, from, to });
                from = to;
            }
            for axis in 0..2 {
                if next[axis] <= to {
                    cell[axis] += self.direction[axis].signum();
                }
            }
            if (0..2).any(|axis| cell[axis] < ends[axis].start as f64 || cell[axis] >= ends[axis].end as f64) {
                break;
            }
        }
    }
}
