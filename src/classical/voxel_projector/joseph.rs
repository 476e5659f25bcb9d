//! Joseph's rays: planes of voxel centres, interpolated bilinearly.
//!
//! All rays of a fan cross a plane perpendicular to the main axis on one vertical line. So the two lines of voxels beside
//! it are blended once into a profile along z, which every ray then reads; the adjoint is the same backwards.

use super::fan::{Fan, Level};
use crate::numeric::{Real, real};
use std::ops::Range;

/// Rays that share one exact start; the others count from there, in the kernel's precision.
const BLOCK: usize = 16;
/// Beyond the voxels a profile has one zero below and these above, which rounding may lead to.
const MARGIN: usize = 3;

/// A plane of voxel centres that the rays of a fan cross.
struct Plane {
    /// The line of voxels below the crossing, and the one above it; `None` outside of the slab.
    lines: [Option<usize>; 2],
    /// Their shares.
    shares: [f64; 2],
    level: Level,
}

/// The grid, and the part of it that is looked at.
pub(super) struct Slab {
    pub(super) shape: [usize; 3],
    /// The slices in x.
    pub(super) x: Range<usize>,
}

impl Slab {
    /// Number of the line of voxels at (x, y), counted from the slab's first one; `None` outside.
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
            lines.iter().any(Option::is_some).then(|| Plane {
                lines,
                shares: [1.0 - share, share],
                level: self.level(s),
            })
        })
    }

    /// Each ray's scene units of length from one plane to the next.
    fn steps<R: Real>(&self, rows: Range<usize>) -> Vec<R> {
        let step = 1.0 / self.direction[self.main_axis()].abs();
        rows.map(|k| real(self.length(k) * step)).collect()
    }

    /// Calls `visit(line, z, k, weight)` for all voxels of the slab that the steep ray k weighs: planes perpendicular to z.
    pub(super) fn visit_steep(&self, k: usize, slab: &Slab, mut visit: impl FnMut(usize, usize, f64)) {
        let step = self.length(k) / self.slope(k).abs();
        for z in 0..slab.shape[2] {
            let Some(s) = self.crossing(k, z as f64).filter(|&s| s > 0.0) else { continue };
            let [x, y] = [0, 1].map(|axis| self.origin[axis] + s * self.direction[axis]);
            for (i, share_x) in [(x.floor(), 1.0 - (x - x.floor())), (x.floor() + 1.0, x - x.floor())] {
                for (j, share_y) in [(y.floor(), 1.0 - (y - y.floor())), (y.floor() + 1.0, y - y.floor())] {
                    if let Some(line) = slab.line(i, j) {
                        visit(line, z, step * share_x * share_y);
                    }
                }
            }
        }
    }

    /// Line integrals of the shallow rays `rows` of `out`, which has one value per ray.
    pub(super) fn joseph_forward<R: Real>(
        &self,
        volume: &[R],
        slab: &Slab,
        rows: &Range<usize>,
        out: &mut [R],
        profile: &mut Vec<R>,
    ) {
        let nz = slab.shape[2];
        profile.clear();
        profile.resize(nz + 1 + MARGIN, R::ZERO);
        out[rows.clone()].fill(R::ZERO);
        for plane in self.planes(slab) {
            let rows = plane.level.rows_within(rows, -1.0, nz as f64);
            if rows.is_empty() {
                continue;
            }
            let touched = touched(&plane.level, &rows, nz);
            plane.blend(volume, nz, touched, profile);
            for_each_block(&plane.level, rows, |first, block, at| {
                let profile = &profile[first..];
                for (&(index, share), value) in at.iter().zip(&mut out[block]) {
                    let (below, above) = (profile[index], profile[index + 1]);
                    *value += below + (above - below) * share;
                }
            });
        }
        for (value, step) in out[rows.clone()].iter_mut().zip(self.steps::<R>(rows.clone())) {
            *value *= step;
        }
    }

    /// Adds what the shallow rays with the values `image` give to the voxels of the slab.
    pub(super) fn joseph_adjoint<R: Real, const N: usize>(
        &self,
        image: &[[R; N]],
        slab: &Slab,
        out: &mut [[R; N]],
        scratch: &mut Scratch<R, N>,
    ) {
        let nz = slab.shape[2];
        let mut planes = self.planes(slab).peekable();
        if planes.peek().is_none() {
            return;
        }
        let rows = self.shallow(image.len());
        let weighted = &mut scratch.weighted;
        weighted.clear();
        weighted.resize(rows.start, [R::ZERO; N]);
        let values = image[rows.clone()].iter().zip(self.steps::<R>(rows.clone()));
        weighted.extend(values.map(|(value, step)| value.map(|value| value * step)));
        for plane in planes {
            let rows = plane.level.rows_within(&rows, -1.0, nz as f64);
            if rows.is_empty() {
                continue;
            }
            let touched = touched(&plane.level, &rows, nz);
            // A second profile for every other ray: sums into one place wait for each other.
            let [even, odd] = &mut scratch.profiles;
            for profile in [&mut *even, &mut *odd] {
                profile.resize(nz + 1 + MARGIN, [R::ZERO; N]);
                let to = (touched.end + 1 + MARGIN).min(profile.len());
                profile[touched.start..to].fill([R::ZERO; N]);
            }
            for_each_block(&plane.level, rows, |first, block, at| {
                let (even, odd) = (&mut even[first..], &mut odd[first..]);
                let add = |profile: &mut [[R; N]], (index, share): (usize, R), value: [R; N]| {
                    let cells = &mut profile[index..index + 2];
                    for n in 0..N {
                        let above = value[n] * share;
                        cells[0][n] += value[n] - above;
                        cells[1][n] += above;
                    }
                };
                let mut pairs = at.chunks_exact(2).zip(weighted[block.clone()].chunks_exact(2));
                for (at, value) in &mut pairs {
                    add(even, at[0], value[0]);
                    add(odd, at[1], value[1]);
                }
                if block.len() % 2 == 1 {
                    let last = block.len() - 1;
                    add(even, at[last], weighted[block][last]);
                }
            });
            plane.spread([even, odd], nz, touched, out);
        }
    }
}

/// What the adjoint of a column works in.
#[derive(Default)]
pub(super) struct Scratch<R, const N: usize> {
    weighted: Vec<[R; N]>,
    profiles: [Vec<[R; N]>; 2],
}

impl Plane {
    /// The two lines' sum by shares, at the heights `touched`.
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

    /// Gives both lines their shares of the profiles' sum, at the heights `touched`.
    fn spread<R: Real, const N: usize>(
        &self,
        profiles: [&[[R; N]]; 2],
        nz: usize,
        touched: Range<usize>,
        out: &mut [[R; N]],
    ) {
        let [even, odd] = profiles.map(|profile| &profile[touched.start + 1..=touched.end]);
        for (line, share) in self.lines.into_iter().zip(self.shares.map(real::<R>)) {
            let Some(line) = line else { continue };
            let values = &mut out[line * nz..][..nz][touched.clone()];
            for ((value, even), odd) in values.iter_mut().zip(even).zip(odd) {
                for n in 0..N {
                    value[n] += share * (even[n] + odd[n]);
                }
            }
        }
    }
}

/// The voxels along z that rays of these rows can read, of a line of `nz`.
fn touched(level: &Level, rows: &Range<usize>, nz: usize) -> Range<usize> {
    let clamped = |z: f64| z.clamp(0.0, nz as f64) as usize;
    clamped(level.at(rows.start).floor() - 1.0)..clamped(level.at(rows.end - 1).floor() + 3.0)
}

/// Calls `f(first, rows, at)` for blocks of rays: ray i of them is at `at[i].1` between the values `first + at[i].0` and the
/// next of a profile, which begins with one zero.
#[inline(always)]
fn for_each_block<R: Real>(level: &Level, rows: Range<usize>, mut f: impl FnMut(usize, Range<usize>, &[(usize, R)])) {
    let pitch: R = real(level.pitch);
    for start in rows.clone().step_by(BLOCK) {
        let end = (start + BLOCK).min(rows.end);
        let from = level.at(start) + 1.0;
        let first = from.floor();
        let offset: R = real(from - first);
        let mut at = [(0, R::ZERO); BLOCK];
        for (lane, at) in at.iter_mut().enumerate() {
            let place = offset + pitch * R::from_index(lane);
            let index = place.to_index();
            *at = (index, place - R::from_index(index));
        }
        f(first as usize, start..end, &at[..end - start]);
    }
}
