//! Siddon's method: the length of the ray in each voxel.

use super::fan::{Fan, within};
use super::joseph::Slab;
use std::array::from_fn;
use std::ops::Range;

/// Calls `visit(cell, from, to)` for the cells of a grid with these indices that a ray passes from s = `start` on, in order:
/// it enters each at s = from and leaves it at s = to.
#[inline(always)]
pub(super) fn for_each_cell<const N: usize>(
    origin: [f64; N],
    direction: [f64; N],
    ends: &[Range<usize>; N],
    start: f64,
    mut visit: impl FnMut([usize; N], f64, f64),
) {
    let (low, high) = (ends.each_ref().map(|end| end.start as f64), ends.each_ref().map(|end| end.end as f64));
    let borders = [low, high].map(|ends| ends.map(|end| end - 0.5));
    let Some((mut from, end)) = within(origin, direction, borders[0], borders[1], start) else { return };
    let mut cell: [f64; N] = from_fn(|axis| {
        let at = (origin[axis] + from * direction[axis] + 0.5).floor();
        at.clamp(low[axis], high[axis] - 1.0)
    });
    // Computed from the index of the border and not from the previous crossing, so that rounding errors do not add up.
    let crossing = |axis: usize, at: f64| {
        let border = if direction[axis] > 0.0 { at + 0.5 } else { at - 0.5 };
        if direction[axis] == 0.0 { f64::INFINITY } else { (border - origin[axis]) / direction[axis] }
    };
    while from < end {
        let next: [f64; N] = from_fn(|axis| crossing(axis, cell[axis]));
        let to = next.iter().fold(end, |to, &next| to.min(next));
        if to > from {
            visit(cell.map(|at| at as usize), from, to);
            from = to;
        }
        for axis in 0..N {
            if next[axis] <= to {
                cell[axis] += direction[axis].signum();
            }
        }
        if (0..N).any(|axis| cell[axis] < low[axis] || cell[axis] >= high[axis]) {
            break;
        }
    }
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
        let ends = [slab.x.clone(), 0..slab.shape[1]];
        for_each_cell(self.origin, self.direction, &ends, self.start(), |[x, y], from, to| {
            let line = (x - slab.x.start) * slab.shape[1] + y;
            let (enter, leave) = (self.level(from), self.level(to));
            // The union of the rays inside at either end: heights in between lie between both.
            let (a, b) = (enter.within(&rows, -0.5, nz - 0.5), leave.within(&rows, -0.5, nz - 0.5));
            for k in a.start.min(b.start)..a.end.max(b.end) {
                // Voxel z spans z to z + 1 here.
                let (a, b) = (enter.at(k) + 0.5, leave.at(k) + 0.5);
                let (low, high) = if a < b { (a, b) } else { (b, a) };
                let length = (to - from) * lengths[k - rows.start];
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
}
