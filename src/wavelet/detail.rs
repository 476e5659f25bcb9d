//! How strong the detail of a band is, and the gradient, found in the band's coefficients.
//!
//! Along an axis of m cells, a band alone is `f(2i) = C_i`, `f(2i+1) = ±C_i` with C = c/√8 and - where it is high. Its
//! differences, `(f[j+1] - f[j-1])/2` and at the faces those of neighbours, are then the same at the two voxels on both sides
//! of a border between cells, up to signs that squares forget:
//!
//! ```text
//! d_i = F_i·(C_i - C_{i-1}) at voxels 2i-1 and 2i,   i = 0 … m,   C_{-1} = C_m = 0
//! F_i = 1/2 between cells,   F_0 = F_m = 0 where the band is low, 2 where it is high
//! ```
//!
//! So a cell has six differences instead of the 24 of its voxels, and no band is put together: |∇f|² of each of its eight voxels
//! is a sum of three out of six squares, and the gradient `-∂(Σ w·|∇f|)/∂C_{i-1} = ∂/∂C_i = F_i·d_i·Σ w/|∇f|` goes across
//! borders, summed over the voxels on both sides.
//!
//! Cells of a slice along x are rows along z, each with a cell of zeros after it, so that there is room for the last border.

use super::routing::Routing;
use super::{FLAT, Settings, haar};
use crate::numeric::threads::{self, Spares};
use crate::numeric::{Lanes, Real, real};
use std::array::from_fn;
use std::iter::repeat;

/// Voxels of a cell, in the order `4·x + 2·y + z`.
const VOXELS: usize = 8;
/// Registers that say of as many cells what [`Weights`] says.
const RECORD: usize = 1 + 2 * VOXELS;
/// The squared factor of a difference between cells.
const BETWEEN: f64 = 0.25;

/// Cells of a block and where they are kept.
#[derive(Clone, Copy, Debug, Default)]
struct Cells {
    /// Cells along x, y and z.
    shape: [usize; 3],
    /// From a row to the next.
    pitch: usize,
    /// Places of a slice, whole registers.
    size: usize,
}

impl Cells {
    /// Those of a block of `shape` voxels.
    fn new<R: Real>(shape: [usize; 3]) -> Self {
        let [x, y, z] = shape.map(|side| side / 2);
        Self { shape: [x, y, z], pitch: z + 1, size: (y * (z + 1)).next_multiple_of(R::Lanes::WIDTH) }
    }

    /// A slice of coefficients, one after another, times `factor`.
    fn spread<R: Real>(&self, coefficients: &[R], factor: R, slice: &mut [R]) {
        let rows = coefficients.chunks_exact(self.shape[2]);
        for (row, places) in rows.zip(slice.chunks_mut(self.pitch)) {
            places.iter_mut().zip(row).for_each(|(place, &c)| *place = factor * c);
        }
    }

    /// The gradient to a slice of coefficients: what it has gained less what goes to the next slice, times `factor`.
    fn settle<R: Real>(&self, gained: &[R], lost: &[R], factor: R, gradient: &mut [R]) {
        let places = gained.chunks(self.pitch).zip(lost.chunks(self.pitch));
        for (row, (gained, lost)) in gradient.chunks_exact_mut(self.shape[2]).zip(places) {
            row.iter_mut().zip(gained.iter().zip(lost)).for_each(|(d, (gained, lost))| *d = factor * (*gained - *lost));
        }
    }
}

/// What the strength at each voxel counts.
#[derive(Debug, Default)]
pub(super) struct Weights<R> {
    cells: Cells,
    /// For each slice and register of cells: K, 0 where there is no cell; the confident neighbours of each of their voxels;
    /// the gradient of the loss to the strength there.
    records: Vec<R>,
    /// Of a slice, K, and the confident neighbours of the first voxels of all cells, of the second ones and so on.
    apart: Spares<[Vec<R>; 1 + VOXELS]>,
}

impl<R: Real> Weights<R> {
    /// `share` is what sums over voxels and bands are divided by.
    pub(super) fn fit(&mut self, routing: &Routing, settings: &Settings, share: f64) {
        let (x, y, z) = routing.high.dim();
        let cells = Cells::new::<R>([x, y, z]);
        let high = routing.high.as_standard_layout();
        let high = high.as_slice().expect("standard layout");
        let splat = |value: f64| R::Lanes::splat(real(value));
        let of_low = splat(settings.suppress / share);
        let of_high = splat(settings.enhance * settings.enhancement / share);
        let width = R::Lanes::WIDTH;
        self.cells = cells;
        self.records.resize(cells.shape[0] * cells.size * RECORD, R::ZERO);
        threads::for_each_chunk_in(&mut self.records, cells.size * RECORD, &self.apart, |slice, records, space| {
            let [all, apart @ ..] = space;
            apart.iter_mut().chain([&mut *all]).for_each(|values| zeros(values, cells.size));
            for (row, voxels) in high[2 * slice * y * z..][..2 * y * z].chunks_exact(z).enumerate() {
                let (odd_x, odd_y, first) = (row / y, row % 2, row % y / 2 * cells.pitch);
                let of_row = 4 * odd_x + 2 * odd_y;
                let [even, odd] = &mut apart[of_row..of_row + 2] else { unreachable!("a pair of eight") };
                let places = even[first..].iter_mut().zip(&mut odd[first..]);
                for (pair, (even, odd)) in voxels.chunks_exact(2).zip(places) {
                    (*even, *odd) = (real(f64::from(pair[0])), real(f64::from(pair[1])));
                }
                all[first..][..z / 2].fill(R::from_index(routing.neighbours));
            }
            for (record, place) in records.chunks_exact_mut(RECORD * width).zip((0..).step_by(width)) {
                let neighbours = R::Lanes::from_slice(&all[place..]);
                neighbours.write(record);
                for (voxel, high) in apart.iter().enumerate() {
                    let high = R::Lanes::from_slice(&high[place..]);
                    high.write(&mut record[(1 + voxel) * width..]);
                    let push = of_low * (neighbours - high) - of_high * high;
                    push.write(&mut record[(1 + VOXELS + voxel) * width..]);
                }
            }
        });
    }

    fn of_slice(&self, x: usize) -> &[R] {
        let length = self.cells.size * RECORD;
        &self.records[x * length..][..length]
    }
}

/// Differences across the borders along one axis.
#[derive(Debug, Default)]
struct Borders<R> {
    /// F·d.
    slopes: Vec<R>,
    /// d².
    squares: Vec<R>,
}

impl<R: Real> Borders<R> {
    fn fit(&mut self, places: usize) {
        zeros(&mut self.slopes, places);
        zeros(&mut self.squares, places);
    }

    /// From the cells on both sides and F².
    fn find(&mut self, before: &[R], after: &[R], factors: impl Iterator<Item = R>) {
        let borders = self.slopes.iter_mut().zip(&mut self.squares);
        for (((slope, square), (before, after)), factor) in borders.zip(before.iter().zip(after)).zip(factors) {
            let step = *after - *before;
            *slope = factor * step;
            *square = *slope * step;
        }
    }
}

/// Of each cell, the sums of weight / strength over the four voxels before its middle along an axis, and over those after it.
#[derive(Debug, Default)]
struct Halves<R> {
    before: Vec<R>,
    /// Behind as many zeros as there are places from a border to the next: at a border's place is the cell before it.
    after: Vec<R>,
}

impl<R: Real> Halves<R> {
    fn fit(&mut self, places: usize) {
        zeros(&mut self.before, places);
        zeros(&mut self.after, places);
    }

    /// What the borders' slopes add to the gradient of the cells after them, and take from that of the cells before.
    fn flow_into(&self, slopes: &[R], flow: &mut [R]) {
        let halves = self.after.iter().zip(&self.before);
        for ((flow, slope), (after, before)) in flow.iter_mut().zip(slopes).zip(halves) {
            *flow = *slope * (*after + *before);
        }
    }
}

/// What a band is gone through with.
#[derive(Debug, Default)]
pub(super) struct Space<R> {
    /// A slice and the one after it, by turns, with a row of zeros before the cells and one after them.
    slices: [Vec<R>; 2],
    /// Borders before a slice and after it, by turns.
    along_x: [Borders<R>; 2],
    along_y: Borders<R>,
    along_z: Borders<R>,
    /// F² of the latter two.
    factors: [Vec<R>; 2],
    /// Those along x are of two slices: after the middle of the one before.
    halves: [Halves<R>; 3],
    after_x: Vec<R>,
    flows: [Vec<R>; 3],
    /// The gradient of a slice but for what goes to the next one.
    gained: Vec<R>,
}

fn zeros<R: Real>(values: &mut Vec<R>, n: usize) {
    values.clear();
    values.resize(n, R::ZERO);
}

impl<R: Real> Space<R> {
    fn fit(&mut self, Cells { pitch, size, .. }: Cells) {
        self.slices.iter_mut().for_each(|slice| zeros(slice, size + 2 * pitch));
        self.along_x.iter_mut().for_each(|borders| borders.fit(size));
        self.along_y.fit(size + pitch);
        self.along_z.fit(size + 1);
        let parts = self.halves.iter_mut().zip(&mut self.flows);
        for ((halves, flow), stride) in parts.zip([0, pitch, 1]) {
            halves.fit(size + stride);
            zeros(flow, size + stride);
        }
        zeros(&mut self.after_x, size);
        zeros(&mut self.gained, size);
    }
}

/// The strength of one band of level 1 times confident neighbours, and times others, added up over all voxels; writes the
/// gradient to the band's coefficients.
pub(super) fn strength<R: Real>(
    coefficients: &[R],
    band: usize,
    weights: &Weights<R>,
    space: &mut Space<R>,
    gradient: &mut [R],
) -> [f64; 2] {
    let cells = weights.cells;
    let Cells { shape: [nx, ny, nz], pitch, .. } = cells;
    space.fit(cells);
    let Space { slices, along_x, along_y, along_z, factors, halves: [x_halves, y_halves, z_halves], .. } = space;
    let Space { after_x, flows: [flow_x, flow_y, flow_z], gained, .. } = space;
    let scale = haar::scale();
    let at_face = haar::is_high(band).map(|high| if high { real::<R>(4.0) } else { R::ZERO });
    let factor = |axis: usize, border: usize, n: usize| {
        if border == 0 || border == n { at_face[axis] } else { real(BETWEEN) }
    };
    factors[0].clear();
    factors[0].extend((0..flow_y.len()).map(|place| factor(1, (place / pitch).min(ny), ny)));
    factors[1].clear();
    factors[1].extend((0..flow_z.len()).map(|place| factor(2, place % pitch, nz)));
    let slice_of = |x: usize| &coefficients[x * ny * nz..][..ny * nz];
    let mut slices_of_gradient = gradient.chunks_exact_mut(ny * nz);
    let mut sums = [0.0; 2];
    cells.spread(slice_of(0), scale, &mut slices[0][pitch..]);
    along_x[0].find(&slices[1][pitch..], &slices[0][pitch..], repeat(factor(0, 0, nx)));
    for x in 0..nx {
        let [even, odd] = slices;
        let (here, next) = if x % 2 == 0 { (even, odd) } else { (odd, even) };
        if x + 1 < nx {
            cells.spread(slice_of(x + 1), scale, &mut next[pitch..]);
        } else {
            next.fill(R::ZERO);
        }
        let [even, odd] = along_x;
        let (before_x, beyond_x) = if x % 2 == 0 { (even, odd) } else { (odd, even) };
        beyond_x.find(&here[pitch..], &next[pitch..], repeat(factor(0, x + 1, nx)));
        along_y.find(here, &here[pitch..], factors[0].iter().copied());
        along_z.find(&here[pitch - 1..], &here[pitch..], factors[1].iter().copied());
        let squares = [
            [&before_x.squares[..], &beyond_x.squares[..]],
            [&along_y.squares[..], &along_y.squares[pitch..]],
            [&along_z.squares[..], &along_z.squares[1..]],
        ];
        let halves = [
            [&mut x_halves.before[..], &mut after_x[..]],
            [&mut y_halves.before[..], &mut y_halves.after[pitch..]],
            [&mut z_halves.before[..], &mut z_halves.after[1..]],
        ];
        let found = weigh(squares, weights.of_slice(x), halves);
        sums = from_fn(|i| sums[i] + found[i]);
        x_halves.flow_into(&before_x.slopes, flow_x);
        if x > 0 {
            cells.settle(gained, flow_x, scale, slices_of_gradient.next().expect("a slice for each of the cells'"));
        }
        y_halves.flow_into(&along_y.slopes, flow_y);
        z_halves.flow_into(&along_z.slopes, flow_z);
        let within = flow_y.iter().zip(&flow_y[pitch..]).zip(flow_z.iter().zip(&flow_z[1..]));
        for ((gained, flow_x), ((y, beyond_y), (z, beyond_z))) in gained.iter_mut().zip(&*flow_x).zip(within) {
            *gained = *flow_x + (*y - *beyond_y) + (*z - *beyond_z);
        }
        std::mem::swap(&mut x_halves.after, after_x);
    }
    x_halves.before.fill(R::ZERO);
    x_halves.flow_into(&along_x[nx % 2].slopes, flow_x);
    cells.settle(gained, flow_x, scale, slices_of_gradient.next().expect("a slice for each of the cells'"));
    sums
}

/// In one slice, from the squares at both borders along each axis: the sums of strength times confident neighbours and times
/// others, and weight / strength summed over the halves of each cell.
fn weigh<R: Real>(squares: [[&[R]; 2]; 3], records: &[R], halves: [[&mut [R]; 2]; 3]) -> [f64; 2] {
    let flat = R::Lanes::splat(real(FLAT));
    let width = R::Lanes::WIDTH;
    let [[x0, x1], [y0, y1], [z0, z1]] = squares;
    let [[before_x, after_x], [before_y, after_y], [before_z, after_z]] = halves;
    let mut sums = [0.0; 2];
    for (record, place) in records.chunks_exact(RECORD * width).zip((0..).step_by(width)) {
        let load = |values: &[R]| R::Lanes::from_slice(&values[place..]);
        let of = |number: usize| R::Lanes::from_slice(&record[number * width..]);
        let (x, y, z) = ([load(x0) + flat, load(x1) + flat], [load(y0), load(y1)], [load(z0), load(z1)]);
        let neighbours = of(0);
        let (mut confident, mut others) = (R::Lanes::default(), R::Lanes::default());
        let mut shares = [R::Lanes::default(); VOXELS];
        for (voxel, share) in shares.iter_mut().enumerate() {
            let strength = (x[voxel / 4] + y[voxel / 2 % 2] + z[voxel % 2]).sqrt();
            let high = of(1 + voxel);
            *share = of(1 + VOXELS + voxel) / strength;
            confident += high * strength;
            others += (neighbours - high) * strength;
        }
        let [a, b, c, d, e, f, g, h] = shares;
        let (ab, cd, ef, gh) = (a + b, c + d, e + f, g + h);
        let (ae, bf, cg, dh) = (a + e, b + f, c + g, d + h);
        let write = |values: &mut [R], sum: R::Lanes| sum.write(&mut values[place..]);
        write(before_x, ab + cd);
        write(after_x, ef + gh);
        write(before_y, ab + ef);
        write(after_y, cd + gh);
        write(before_z, ae + cg);
        write(after_z, bf + dh);
        sums = [sums[0] + confident.sum(), sums[1] + others.sum()];
    }
    sums
}
