//! Joseph's method: planes of voxel centres with bilinear interpolation.
//!
//! All rays of a fan cross a plane perpendicular to the main axis on one vertical line. The two lines of voxels next to
//! it are therefore blended once into a profile along z, which every ray then reads; the adjoint reverses the steps.
//! Steep rays, if there are any, are computed one by one.

use super::fan::Fan;
use crate::classical::resample::{Places, interpolate, margin, spread};
use std::ops::Range;
use trgs_core::numeric::{Real, real};

/// A plane of voxel centres that the rays of a fan cross.
struct Plane {
    /// The line of voxels below the crossing and the one above it; `None` outside the slab.
    lines: [Option<usize>; 2],
    /// Their interpolation weights.
    shares: [f64; 2],
    /// Heights at which the rays cross it.
    heights: Places,
}

/// A range of slices of the grid.
pub(super) struct Slab {
    pub(super) shape: [usize; 3],
    /// The slices in x.
    pub(super) x: Range<usize>,
    /// The positions in x, rounded down, of the points whose values are interpolated here.
    own: Range<f64>,
}

impl Slab {
    /// The slices `x`, with all points that have a voxel there.
    pub(super) fn new(shape: [usize; 3], x: Range<usize>) -> Self {
        Self { shape, x, own: f64::NEG_INFINITY..f64::INFINITY }
    }

    /// The slices `x` and one more, the last excepted, with the points from each slice to the next: every point of the
    /// grid is in one part.
    pub(super) fn part(shape: [usize; 3], x: Range<usize>) -> Self {
        let from = if x.start == 0 { f64::NEG_INFINITY } else { x.start as f64 };
        let to = if x.end == shape[0] { f64::INFINITY } else { x.end as f64 };
        Self { shape, x: x.start..(x.end + 1).min(shape[0]), own: from..to }
    }

    /// Whether points with the position `x`, rounded down, are interpolated here.
    pub(super) fn owns(&self, x: f64) -> bool {
        self.own.contains(&x)
    }

    /// Index of the line of voxels at (x, y), counted from the slab's first line; `None` outside.
    fn line(&self, x: f64, y: f64) -> Option<usize> {
        let inside = x >= self.x.start as f64 && x < self.x.end as f64 && y >= 0.0 && y < self.shape[1] as f64;
        inside.then(|| (x as usize - self.x.start) * self.shape[1] + y as usize)
    }
}

impl Fan {
    /// The planes that the rays cross within reach of the slab, in the order of their index.
    fn planes(&self, slab: &Slab) -> impl Iterator<Item = Plane> {
        let (main, ends) = (self.main_axis(), [slab.x.clone(), 0..slab.shape[1]]);
        let (low, high) = (ends.clone().map(|end| end.start as f64 - 1.0), ends.clone().map(|end| end.end as f64));
        let numbers = self.within(low, high).map_or(0..0, |(from, to)| {
            let [from, to] = [from, to].map(|s| self.origin[main] + s * self.direction[main]);
            let clamped = |i: f64| i.clamp(ends[main].start as f64, ends[main].end as f64) as usize;
            clamped(from.min(to).floor())..clamped(from.max(to).ceil() + 1.0)
        });
        numbers.filter_map(move |number| {
            let i = number as f64;
            let s = (i - self.origin[main]) / self.direction[main];
            let across = self.origin[1 - main] + s * self.direction[1 - main];
            let below = across.floor();
            let line = |j: f64| if main == 0 { slab.line(i, j) } else { slab.line(j, i) };
            let lines = [line(below), line(below + 1.0)];
            let share = across - below;
            let is_here = slab.owns(if main == 0 { i } else { below }) && lines.iter().any(Option::is_some);
            is_here.then(|| Plane { lines, shares: [1.0 - share, share], heights: self.level(s) })
        })
    }

    /// The length of each ray from one plane to the next, scene units.
    fn steps<R: Real>(&self, rows: Range<usize>) -> Vec<R> {
        let step = 1.0 / self.direction[self.main_axis()].abs();
        rows.map(|k| real(self.length(k) * step)).collect()
    }

    /// Calls `visit(line, z, k, weight)` for the voxels of the slab on the steep ray k.
    ///
    /// The planes of interpolation are perpendicular to z.
    pub(super) fn visit_steep(&self, k: usize, slab: &Slab, mut visit: impl FnMut(usize, usize, f64)) {
        let step = self.length(k) / self.slope(k).abs();
        for z in 0..slab.shape[2] {
            let Some(s) = self.crossing(k, z as f64).filter(|&s| s > 0.0) else { continue };
            let [x, y] = [0, 1].map(|axis| self.origin[axis] + s * self.direction[axis]);
            if !slab.owns(x.floor()) {
                continue;
            }
            for (i, share_x) in [(x.floor(), 1.0 - (x - x.floor())), (x.floor() + 1.0, x - x.floor())] {
                for (j, share_y) in [(y.floor(), 1.0 - (y - y.floor())), (y.floor() + 1.0, y - y.floor())] {
                    if let Some(line) = slab.line(i, j) {
                        visit(line, z, step * share_x * share_y);
                    }
                }
            }
        }
    }

    /// Adds the shallow rays `rows` through the slab to `out`, which has one value per ray, before [`Self::scale`].
    pub(super) fn joseph_forward<R: Real>(
        &self,
        volume: &[R],
        slab: &Slab,
        rows: &Range<usize>,
        out: &mut [R],
        profile: &mut Vec<R>,
    ) {
        let nz = slab.shape[2];
        if nz == 1 && rows.len() == 1 {
            self.flat_forward(volume, slab, rows.start, &mut out[rows.start]);
            return;
        }
        profile.clear();
        // The profile starts at height -1; positions reach up to nz, where rounding may end them.
        profile.resize(nz + 2 + margin::<R>(), R::ZERO);
        for plane in self.planes(slab) {
            let heights = plane.heights;
            let rows = heights.within(rows, -1.0, nz as f64);
            if !rows.is_empty() {
                plane.blend(volume, nz, touched(heights, &rows, nz), profile);
                interpolate(profile, Places { first: heights.first + 1.0, ..heights }, rows, out);
            }
        }
    }

    /// Multiplies the sums of the shallow rays `rows` by their steps.
    pub(super) fn scale<R: Real>(&self, rows: &Range<usize>, out: &mut [R]) {
        for (value, step) in out[rows.clone()].iter_mut().zip(self.steps::<R>(rows.clone())) {
            *value *= step;
        }
    }

    /// The shallow rays' pixels of a column times their steps: the input of [`Self::joseph_adjoint`].
    pub(super) fn weighted<R: Real>(&self, column: &[R], out: &mut [R]) {
        let rows = self.shallow(column.len());
        let steps = self.steps::<R>(rows.clone());
        let out = &mut out[margin::<R>()..][rows.clone()];
        for ((out, &value), step) in out.iter_mut().zip(&column[rows]).zip(steps) {
            *out = value * step;
        }
    }

    /// [`Self::joseph_forward`] for one ray through a volume of one slice.
    fn flat_forward<R: Real>(&self, volume: &[R], slab: &Slab, row: usize, sum: &mut R) {
        for plane in self.planes(slab) {
            let weight = 1.0 - plane.heights.at(row).abs();
            if weight > 0.0 {
                for (line, share) in plane.lines.into_iter().zip(plane.shares) {
                    *sum += line.map_or(R::ZERO, |line| real::<R>(weight * share) * volume[line]);
                }
            }
        }
    }

    /// The transpose of [`Self::flat_forward`].
    fn flat_adjoint<R: Real, const N: usize>(&self, values: [R; N], row: usize, slab: &Slab, out: &mut [Vec<R>; N]) {
        for plane in self.planes(slab) {
            let weight = 1.0 - plane.heights.at(row).abs();
            if weight > 0.0 {
                for (line, share) in plane.lines.into_iter().zip(plane.shares) {
                    let Some(line) = line else { continue };
                    let weight: R = real(weight * share);
                    out.iter_mut().zip(values).for_each(|(out, value)| out[line] += weight * value);
                }
            }
        }
    }

    /// Adds the contribution of the shallow rays to the voxels of the slab, in their order.
    ///
    /// `columns` are values from [`Self::weighted`].
    pub(super) fn joseph_adjoint<R: Real, const N: usize>(
        &self,
        columns: [&[R]; N],
        shallow: &Range<usize>,
        slab: &Slab,
        out: &mut [Vec<R>; N],
    ) {
        let nz = slab.shape[2];
        if nz == 1 && shallow.len() == 1 {
            return self.flat_adjoint(
                columns.map(|column| column[margin::<R>() + shallow.start]),
                shallow.start,
                slab,
                out,
            );
        }
        for plane in self.planes(slab) {
            let rows = plane.heights.within(shallow, -1.0, nz as f64);
            if rows.is_empty() {
                continue;
            }
            let shares = plane.shares.map(real::<R>);
            spread(columns, plane.heights, &rows, touched(plane.heights, &rows, nz), |heights, sums| {
                for (line, share) in plane.lines.into_iter().zip(shares) {
                    let Some(line) = line else { continue };
                    for (n, out) in out.iter_mut().enumerate() {
                        sums.add(n, share, &mut out[line * nz..][heights.clone()]);
                    }
                }
            });
        }
    }
}

impl Plane {
    /// The weighted sum of the two lines, at the heights `touched`.
    fn blend<R: Real>(&self, volume: &[R], nz: usize, touched: Range<usize>, profile: &mut [R]) {
        let out = &mut profile[touched.start + 1..=touched.end];
        let line = |line: usize| &volume[line * nz..][..nz][touched.clone()];
        let [below, above] = self.shares.map(real::<R>);
        match self.lines {
            [Some(a), Some(b)] => {
                for ((out, &a), &b) in out.iter_mut().zip(line(a)).zip(line(b)) {
                    *out = below * a + above * b;
                }
            }
            [Some(a), None] => out.iter_mut().zip(line(a)).for_each(|(out, &a)| *out = below * a),
            [None, Some(b)] => out.iter_mut().zip(line(b)).for_each(|(out, &b)| *out = above * b),
            [None, None] => unreachable!("planes without a line are left out"),
        }
    }
}

/// The voxels along z, of `nz`, that rays of these rows can read.
fn touched(heights: Places, rows: &Range<usize>, nz: usize) -> Range<usize> {
    let clamped = |z: f64| z.clamp(0.0, nz as f64) as usize;
    clamped(heights.at(rows.start).floor() - 1.0)..clamped(heights.at(rows.end - 1).floor() + 3.0)
}
