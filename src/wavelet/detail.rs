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
//! is a sum of three out of six squares. Seen from a cell, a border has the slope `s = F²/8·(c - c beyond)`, seen from beyond -s,
//! and the gradient of `Σ w·|∇f|` to c is the sum over its six borders of `s·Σ w/|∇f|`, which runs over the four voxels here at
//! the border and the four beyond. A cell finds its own part of both: what it gains itself is what its neighbour loses.
//!
//! Divisions and roots take the time: two for each voxel of a band. All else is between them.
//!
//! Cells of a slice along x are rows along z, one after another as coefficients are; a register may hold parts of several.

use super::routing::Routing;
use super::{FLAT, Settings, haar};
use crate::numeric::threads::{self, Pool};
use crate::numeric::vectors::{f64x8, splat};
use crate::numeric::{Lanes, Real, WIDEST, real};

/// Voxels of a cell, in the order `4·x + 2·y + z`.
const VOXELS: usize = 8;
/// Borders of a cell: before and after it along x, along y, along z.
const BORDERS: usize = 6;
/// F²/8 between cells.
const BETWEEN: f64 = 0.25 / 8.0;
/// F²/8 at the faces across which a band is high.
const AT_FACE: f64 = 4.0 / 8.0;

/// Cells of a block.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Cells {
    /// Cells along x, y and z.
    shape: [usize; 3],
    /// Cells of a slice.
    slice: usize,
    /// Registers for these.
    registers: usize,
}

impl Cells {
    /// Those of a block of `shape` voxels.
    fn new<R: Real>(shape: [usize; 3]) -> Self {
        let [x, y, z] = shape.map(|side| side / 2);
        Self { shape: [x, y, z], slice: y * z, registers: (y * z).div_ceil(R::Lanes::WIDTH) }
    }

    /// From a cell to the next one along x, y and z.
    fn strides(&self) -> [usize; 3] {
        [self.slice, self.shape[2], 1]
    }
}

/// What there is in the places of a register.
#[derive(Clone, Copy, Debug, Default)]
struct Places<L> {
    /// K, 0 where there is no cell.
    neighbours: L,
    /// 1 where there is a cell beyond the borders along y and z, else 0.
    beyond: [L; 4],
}

/// What the strength at each voxel counts.
#[derive(Debug, Default)]
pub(super) struct Weights<R: Real> {
    cells: Cells,
    /// K.
    neighbours: usize,
    /// Of a slice.
    places: Vec<Places<R::Lanes>>,
    /// For each slice and register the confident neighbours of the cells' voxels.
    high: Vec<[R::Lanes; VOXELS]>,
    /// What each neighbour adds to the gradient of the loss to a strength, and each confident one on top of that.
    push: [R; 2],
    /// Confident neighbours of the first voxels of a slice's cells, of the second ones and so on.
    apart: Pool<[Vec<R>; VOXELS]>,
}

impl<R: Real> Weights<R> {
    /// `share` is what sums over voxels and bands are divided by.
    pub(super) fn fit(&mut self, routing: &Routing, settings: &Settings, share: f64) {
        let (x, y, z) = routing.high.dim();
        let cells = Cells::new::<R>([x, y, z]);
        if (self.cells, self.neighbours) != (cells, routing.neighbours) {
            self.reshape(cells, routing.neighbours);
        }
        let of_low = settings.suppress / share;
        let of_high = settings.enhance * settings.enhancement / share;
        self.push = [of_low, -of_low - of_high].map(real);
        let high = routing.high.as_standard_layout();
        let high = high.as_slice().expect("standard layout");
        threads::for_each_chunk_in(&mut self.high, cells.registers, &self.apart, |slice, registers, apart| {
            for voxels in apart.iter_mut() {
                voxels.resize(cells.registers * R::Lanes::WIDTH, R::ZERO);
                voxels[cells.slice..].fill(R::ZERO);
            }
            for (row, counts) in high[2 * slice * y * z..][..2 * y * z].chunks_exact(z).enumerate() {
                let (odd_x, odd_y, first) = (row / y, row % 2, row % y / 2 * (z / 2));
                let of_row = 4 * odd_x + 2 * odd_y;
                let [even, odd] = &mut apart[of_row..of_row + 2] else { unreachable!("a pair of eight") };
                deinterleave(counts, &mut even[first..], &mut odd[first..]);
            }
            for (voxel, values) in apart.iter().enumerate() {
                let values = values.chunks_exact(R::Lanes::WIDTH).map(R::Lanes::from_slice);
                registers.iter_mut().zip(values).for_each(|(voxels, values)| voxels[voxel] = values);
            }
        });
    }

    fn reshape(&mut self, cells: Cells, neighbours: usize) {
        let Cells { shape: [nx, ny, nz], slice, registers } = cells;
        (self.cells, self.neighbours) = (cells, neighbours);
        self.high = vec![<[R::Lanes; VOXELS]>::default(); nx * registers];
        let places = |register: usize| {
            let of_cells = |some: &dyn Fn(usize, usize) -> usize| {
                R::Lanes::from_fn(|lane| {
                    let place = register * R::Lanes::WIDTH + lane;
                    if place < slice { R::from_index(some(place / nz, place % nz)) } else { R::ZERO }
                })
            };
            Places {
                neighbours: of_cells(&|_, _| neighbours),
                beyond: [
                    of_cells(&|y, _| usize::from(y > 0)),
                    of_cells(&|y, _| usize::from(y + 1 < ny)),
                    of_cells(&|_, z| usize::from(z > 0)),
                    of_cells(&|_, z| usize::from(z + 1 < nz)),
                ],
            }
        };
        self.places = (0..registers).map(places).collect();
    }
}

/// Counts in even places and those in odd ones.
fn deinterleave<R: Real>(counts: &[u16], even: &mut [R], odd: &mut [R]) {
    // As many as the widest register has lanes, or the compiler takes one after another.
    const PAIRS: usize = WIDEST;
    let (chunks, rest) = counts.as_chunks::<{ 2 * PAIRS }>();
    let (even, even_rest) = even.split_at_mut(PAIRS * chunks.len());
    let (odd, odd_rest) = odd.split_at_mut(PAIRS * chunks.len());
    let places = even.as_chunks_mut::<PAIRS>().0.iter_mut().zip(odd.as_chunks_mut::<PAIRS>().0);
    for (counts, (even, odd)) in chunks.iter().zip(places) {
        for i in 0..PAIRS {
            (even[i], odd[i]) = (R::from_index(counts[2 * i].into()), R::from_index(counts[2 * i + 1].into()));
        }
    }
    for (pair, (even, odd)) in rest.as_chunks::<2>().0.iter().zip(even_rest.iter_mut().zip(odd_rest)) {
        (*even, *odd) = (R::from_index(pair[0].into()), R::from_index(pair[1].into()));
    }
}

/// What a band is gone through with.
#[derive(Debug, Default)]
pub(super) struct Space<R: Real> {
    cells: Cells,
    /// The coefficients, between a slice of zeros and another one.
    band: Vec<R>,
    /// What the cells of a slice gain themselves.
    own: Vec<R>,
    /// What their neighbours lose beyond each border. Beside those along y and z is room for zeros: before the others where
    /// the neighbour comes after, else after them.
    lost: [Vec<R>; BORDERS],
    /// What the slice before took from this one.
    lost_before: Vec<R>,
}

impl<R: Real> Space<R> {
    /// Nobody writes to the zeros around cells but zeros, so they are still there at the next band.
    fn fit(&mut self, cells: Cells) {
        if self.cells == cells {
            return;
        }
        self.cells = cells;
        let Cells { shape, slice, registers } = cells;
        let places = registers * R::Lanes::WIDTH;
        let zeros = |n: usize| vec![R::ZERO; n];
        self.band = zeros((shape[0] + 1) * slice + places);
        self.own = zeros(places);
        self.lost_before = zeros(places);
        let [_, along_y, along_z] = cells.strides();
        self.lost = [0, 0, along_y, along_y, along_z, along_z].map(|room| zeros(places + room));
    }

    /// The gradient to the coefficients of slice x, but for what the next one takes from it, and what this one takes from
    /// that before.
    fn settle(&mut self, x: usize, gradient: &mut [R]) {
        let Cells { slice, .. } = self.cells;
        let [_, along_y, along_z] = self.cells.strides();
        let [before_x, after_x, before_y, after_y, before_z, after_z] = &mut self.lost;
        let (before, here) = gradient[..(x + 1) * slice].split_at_mut(x * slice);
        if x > 0 {
            before[(x - 1) * slice..].iter_mut().zip(before_x).for_each(|(gradient, lost)| *gradient -= *lost);
        }
        let lost_y = after_y.iter().zip(&before_y[along_y..]);
        let lost_z = after_z.iter().zip(&before_z[along_z..]);
        let lost = self.lost_before.iter().zip(lost_y.zip(lost_z));
        for ((gradient, own), (x, ((y0, y1), (z0, z1)))) in here.iter_mut().zip(&self.own).zip(lost) {
            *gradient = *own - (*x + ((*y0 + *y1) + (*z0 + *z1)));
        }
        std::mem::swap(after_x, &mut self.lost_before);
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
    space.fit(cells);
    space.band[cells.slice..][..coefficients.len()].copy_from_slice(coefficients);
    space.lost_before.fill(R::ZERO);
    let at_face = haar::is_high(band).map(|high| if high { AT_FACE } else { 0.0 });
    let mut sums = [splat(0.0); 2];
    for x in 0..cells.shape[0] {
        weigh(x, at_face, weights, space, &mut sums);
        space.settle(x, gradient);
    }
    sums.map(|sum| sum.sum())
}

/// As many registers of an array.
fn registers_of<L: Lanes>(values: &mut [L::Scalar], registers: usize) -> &mut [L::Block] {
    &mut L::blocks_mut(values)[..registers]
}

/// In slice x, adds up strength times confident neighbours and times others, and finds what cells gain and their neighbours
/// lose.
#[inline(always)]
fn weigh<R: Real>(x: usize, at_face: [f64; 3], weights: &Weights<R>, space: &mut Space<R>, sums: &mut [f64x8; 2]) {
    let Cells { shape, slice, registers } = weights.cells;
    let [along_x, along_y, along_z] = weights.cells.strides();
    let (flat, push) = (R::Lanes::splat_f64(FLAT), weights.push.map(R::Lanes::splat));
    // Of the borders along x all cells of a slice have the same kind; of others the one at faces and what is added between.
    let factors =
        [x > 0, x + 1 < shape[0]].map(|within| R::Lanes::splat_f64(if within { BETWEEN } else { at_face[0] }));
    let at_faces = [R::Lanes::splat_f64(at_face[1]), R::Lanes::splat_f64(at_face[2])];
    let between = [R::Lanes::splat_f64(BETWEEN - at_face[1]), R::Lanes::splat_f64(BETWEEN - at_face[2])];
    // All arrays are cut to one length, so that no place in them has to be checked.
    let Space { band, own, lost, .. } = space;
    let cells = |first: usize| &R::Lanes::blocks(&band[first..])[..registers];
    let first = (x + 1) * slice;
    let here = cells(first);
    let beyond = [
        cells(first - along_x),
        cells(first + along_x),
        cells(first - along_y),
        cells(first + along_y),
        cells(first - along_z),
        cells(first + along_z),
    ];
    let places = &weights.places[..registers];
    let high = &weights.high[x * registers..][..registers];
    let own = registers_of::<R::Lanes>(own, registers);
    let [x0, x1, y0, y1, z0, z1] = lost;
    // Not `map`, which may stay a call.
    let lost = [
        registers_of::<R::Lanes>(x0, registers),
        registers_of::<R::Lanes>(x1, registers),
        registers_of::<R::Lanes>(y0, registers),
        registers_of::<R::Lanes>(&mut y1[along_y..], registers),
        registers_of::<R::Lanes>(z0, registers),
        registers_of::<R::Lanes>(&mut z1[along_z..], registers),
    ];
    let differences = |i: usize| {
        let c = R::Lanes::from_block(&here[i]);
        let (mut slopes, mut squares) = ([flat; BORDERS], [flat; BORDERS]);
        for border in 0..BORDERS {
            let other = R::Lanes::from_block(&beyond[border][i]);
            let (factor, step) = if border < 2 {
                (factors[border], c - other)
            } else {
                let (axis, there) = (border / 2 - 1, places[i].beyond[border - 2]);
                (there.fma(between[axis], at_faces[axis]), (-there).fma(other, c))
            };
            slopes[border] = factor * step;
            squares[border] = slopes[border] * step;
        }
        (slopes, squares)
    };
    let mut found = differences(0);
    for i in 0..registers {
        let (slopes, [x0, x1, y0, y1, z0, z1]) = found;
        // The roots of the next register need not wait for what becomes of these.
        found = differences((i + 1).min(registers - 1));
        let (x, y, z) = ([x0 + flat, x1 + flat], [y0, y1], [z0, z1]);
        let Places { neighbours, beyond } = places[i];
        let least = push[0] * neighbours;
        let (mut confident, mut others) = (R::Lanes::default(), R::Lanes::default());
        let mut shares = [flat; VOXELS];
        for voxel in 0..VOXELS {
            let strength = (x[voxel / 4] + y[voxel / 2 % 2] + z[voxel % 2]).sqrt();
            let high = high[i][voxel];
            confident = high.fma(strength, confident);
            others = (neighbours - high).fma(strength, others);
            shares[voxel] = push[1].fma(high, least) / strength;
        }
        sums[0] += f64x8::new(confident.eight());
        sums[1] += f64x8::new(others.eight());
        let [a, b, c, d, e, f, g, h] = shares;
        let (ab, cd, ef, gh) = (a + b, c + d, e + f, g + h);
        let (ae, bf, cg, dh) = (a + e, b + f, c + g, d + h);
        let halves = [ab + cd, ef + gh, ab + ef, cd + gh, ae + cg, bf + dh];
        let mut gained = [flat; BORDERS];
        for border in 0..BORDERS {
            gained[border] = slopes[border] * halves[border];
        }
        let [x0, x1, y0, y1, z0, z1] = gained;
        own[i] = ((x0 + x1) + ((y0 + y1) + (z0 + z1))).to_block();
        for border in 0..BORDERS {
            let lost_there = if border < 4 { gained[border] } else { beyond[border - 2] * gained[border] };
            lost[border][i] = lost_there.to_block();
        }
    }
}
