//! The wavelet loss of one band and its gradient, computed in the band's coefficients.
//!
//! Along an axis of m cells, a band alone is `f(2i) = C_i`, `f(2i+1) = ±C_i` with C = c/√8 and - where the band is high.
//! Its differences are `(f[j+1] - f[j-1])/2`, at the boundaries of the block those of neighbours. They agree, up to a sign
//! that squaring removes, at the two voxels on both sides of a face between cells:
//!
//! ```text
//! d_i = F_i·(C_i - C_{i-1}) at voxels 2i-1 and 2i,   i = 0 … m,   C_{-1} = C_m = 0
//! F_i = 1/2 between cells,   F_0 = F_m = 0 where the band is low, 2 where it is high
//! ```
//!
//! A cell therefore has six differences instead of the 24 of its voxels, and no band is reconstructed: |∇f|² of each of its
//! eight voxels is a sum of three of six squares. Seen from a cell, a face has the slope `s = F²/8·(c - c beyond)`; seen
//! from the other side, -s. The gradient of `Σ w·|∇f|` to c is the sum over the cell's six faces of `s·Σ w/|∇f|`, where
//! the inner sum runs over the four voxels on each side of the face. As in a finite-volume scheme, each cell computes the
//! fluxes of its own voxels once: its inflow is the outflow of its neighbours.
//!
//! Divisions and square roots dominate the cost, two per voxel and band; the other operations overlap with them.
//!
//! The cells of a slice along x are stored as the coefficients are: rows along z, one after another. A register may span
//! several rows.

use super::routing::Routing;
use super::{FLAT, Settings, haar};
use crate::numeric::threads::{self, Pool};
use crate::numeric::vectors::{f64x8, splat};
use crate::numeric::{Lanes, Real, WIDEST, real};

/// Voxels of a cell, in the order `4·x + 2·y + z`.
const VOXELS: usize = 8;
/// Faces of a cell: before and after it along x, along y, along z.
const FACES: usize = 6;
/// F²/8 between cells.
const BETWEEN: f64 = 0.25 / 8.0;
/// F²/8 at the boundaries of the block across which a band is high.
const AT_BOUNDARY: f64 = 4.0 / 8.0;

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

/// Neighbour masks of a register's cells.
#[derive(Clone, Copy, Debug, Default)]
struct NeighbourMasks<L> {
    /// K, 0 where there is no cell.
    neighbours: L,
    /// 1 where there is a cell beyond the faces along y and z, else 0.
    beyond: [L; 4],
}

/// Weights of the detail strength at each voxel.
#[derive(Debug, Default)]
pub(super) struct Weights<R: Real> {
    cells: Cells,
    /// K.
    neighbours: usize,
    /// Of the registers of a slice.
    masks: Vec<NeighbourMasks<R::Lanes>>,
    /// Confident neighbours of the cells' voxels, by slice and register.
    high: Vec<[R::Lanes; VOXELS]>,
    /// Weight of a neighbour in ∂loss/∂strength, and the additional weight of a confident one.
    push: [R; 2],
    /// Scratch: confident neighbours of a slice's cells, by voxel of the cell.
    per_voxel: Pool<[Vec<R>; VOXELS]>,
}

impl<R: Real> Weights<R> {
    /// Sets the weights. Sums over voxels and bands are divided by `share`.
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
        threads::for_each_chunk_in(&mut self.high, cells.registers, &self.per_voxel, |slice, registers, per_voxel| {
            for voxels in per_voxel.iter_mut() {
                voxels.resize(cells.registers * R::Lanes::WIDTH, R::ZERO);
                voxels[cells.slice..].fill(R::ZERO);
            }
            for (row, counts) in high[2 * slice * y * z..][..2 * y * z].chunks_exact(z).enumerate() {
                let (odd_x, odd_y, first) = (row / y, row % 2, row % y / 2 * (z / 2));
                let of_row = 4 * odd_x + 2 * odd_y;
                let [even, odd] = &mut per_voxel[of_row..of_row + 2] else { unreachable!("a pair of eight") };
                deinterleave(counts, &mut even[first..], &mut odd[first..]);
            }
            for (voxel, values) in per_voxel.iter().enumerate() {
                let values = values.chunks_exact(R::Lanes::WIDTH).map(R::Lanes::from_slice);
                registers.iter_mut().zip(values).for_each(|(voxels, values)| voxels[voxel] = values);
            }
        });
    }

    fn reshape(&mut self, cells: Cells, neighbours: usize) {
        let Cells { shape: [nx, ny, nz], slice, registers } = cells;
        (self.cells, self.neighbours) = (cells, neighbours);
        self.high = vec![<[R::Lanes; VOXELS]>::default(); nx * registers];
        let masks = |register: usize| {
            let of_cells = |some: &dyn Fn(usize, usize) -> usize| {
                R::Lanes::from_fn(|lane| {
                    let place = register * R::Lanes::WIDTH + lane;
                    if place < slice { R::from_index(some(place / nz, place % nz)) } else { R::ZERO }
                })
            };
            NeighbourMasks {
                neighbours: of_cells(&|_, _| neighbours),
                beyond: [
                    of_cells(&|y, _| usize::from(y > 0)),
                    of_cells(&|y, _| usize::from(y + 1 < ny)),
                    of_cells(&|_, z| usize::from(z > 0)),
                    of_cells(&|_, z| usize::from(z + 1 < nz)),
                ],
            }
        };
        self.masks = (0..registers).map(masks).collect();
    }
}

/// Splits counts by even and odd position.
fn deinterleave<R: Real>(counts: &[u16], even: &mut [R], odd: &mut [R]) {
    // With fewer than the lanes of the widest register the compiler does not vectorise.
    const PAIRS: usize = WIDEST;
    let (chunks, rest) = counts.as_chunks::<{ 2 * PAIRS }>();
    let (even, even_rest) = even.split_at_mut(PAIRS * chunks.len());
    let (odd, odd_rest) = odd.split_at_mut(PAIRS * chunks.len());
    let pairs = even.as_chunks_mut::<PAIRS>().0.iter_mut().zip(odd.as_chunks_mut::<PAIRS>().0);
    for (counts, (even, odd)) in chunks.iter().zip(pairs) {
        for i in 0..PAIRS {
            (even[i], odd[i]) = (R::from_index(counts[2 * i].into()), R::from_index(counts[2 * i + 1].into()));
        }
    }
    for (pair, (even, odd)) in rest.as_chunks::<2>().0.iter().zip(even_rest.iter_mut().zip(odd_rest)) {
        (*even, *odd) = (R::from_index(pair[0].into()), R::from_index(pair[1].into()));
    }
}

/// Scratch arrays for one band.
#[derive(Debug, Default)]
pub(super) struct Scratch<R: Real> {
    cells: Cells,
    /// The coefficients, with a slice of zeros before and after.
    band: Vec<R>,
    /// Flux into each cell of a slice.
    inflow: Vec<R>,
    /// Flux out of the neighbour beyond each face. Those along y and z are padded with zeros: in front where the
    /// neighbour comes after the cell, else at the end.
    outflow: [Vec<R>; FACES],
    /// Outflow into this slice's cells from the slice before.
    outflow_before: Vec<R>,
}

impl<R: Real> Scratch<R> {
    /// Fits the arrays to a block. The padding around cells only ever holds zeros, also at the next band.
    fn fit(&mut self, cells: Cells) {
        if self.cells == cells {
            return;
        }
        self.cells = cells;
        let Cells { shape, slice, registers } = cells;
        let lanes = registers * R::Lanes::WIDTH;
        let zeros = |n: usize| vec![R::ZERO; n];
        self.band = zeros((shape[0] + 1) * slice + lanes);
        self.inflow = zeros(lanes);
        self.outflow_before = zeros(lanes);
        let [_, along_y, along_z] = cells.strides();
        self.outflow = [0, 0, along_y, along_y, along_z, along_z].map(|padding| zeros(lanes + padding));
    }

    /// Writes the gradient of slice x and subtracts this slice's flux from the slice before.
    ///
    /// The flux of the next slice is still to be subtracted.
    fn scatter(&mut self, x: usize, gradient: &mut [R]) {
        let Cells { slice, .. } = self.cells;
        let [_, along_y, along_z] = self.cells.strides();
        let [before_x, after_x, before_y, after_y, before_z, after_z] = &mut self.outflow;
        let (before, here) = gradient[..(x + 1) * slice].split_at_mut(x * slice);
        if x > 0 {
            before[(x - 1) * slice..].iter_mut().zip(before_x).for_each(|(gradient, outflow)| *gradient -= *outflow);
        }
        let outflow_y = after_y.iter().zip(&before_y[along_y..]);
        let outflow_z = after_z.iter().zip(&before_z[along_z..]);
        let outflow = self.outflow_before.iter().zip(outflow_y.zip(outflow_z));
        for ((gradient, inflow), (x, ((y0, y1), (z0, z1)))) in here.iter_mut().zip(&self.inflow).zip(outflow) {
            *gradient = *inflow - (*x + ((*y0 + *y1) + (*z0 + *z1)));
        }
        std::mem::swap(after_x, &mut self.outflow_before);
    }
}

/// Sums over all voxels of the strength of one band of level 1, weighted by confident neighbours and by others.
///
/// Writes the gradient to the band's coefficients.
pub(super) fn strength<R: Real>(
    coefficients: &[R],
    band: usize,
    weights: &Weights<R>,
    scratch: &mut Scratch<R>,
    gradient: &mut [R],
) -> [f64; 2] {
    let cells = weights.cells;
    scratch.fit(cells);
    scratch.band[cells.slice..][..coefficients.len()].copy_from_slice(coefficients);
    scratch.outflow_before.fill(R::ZERO);
    let at_boundary = haar::is_high(band).map(|high| if high { AT_BOUNDARY } else { 0.0 });
    let mut sums = [splat(0.0); 2];
    for x in 0..cells.shape[0] {
        accumulate(x, at_boundary, weights, scratch, &mut sums);
        scratch.scatter(x, gradient);
    }
    sums.map(|sum| sum.sum())
}

/// The first registers of an array.
fn registers_of<L: Lanes>(values: &mut [L::Scalar], registers: usize) -> &mut [L::Block] {
    &mut L::blocks_mut(values)[..registers]
}

/// Adds the weighted strengths of slice x to the sums and computes the fluxes through the faces of its cells.
#[inline(always)]
fn accumulate<R: Real>(
    x: usize,
    at_boundary: [f64; 3],
    weights: &Weights<R>,
    scratch: &mut Scratch<R>,
    sums: &mut [f64x8; 2],
) {
    let Cells { shape, slice, registers } = weights.cells;
    let [along_x, along_y, along_z] = weights.cells.strides();
    let (flat, push) = (R::Lanes::splat_f64(FLAT), weights.push.map(R::Lanes::splat));
    // Faces along x are of one kind for a whole slice. For others: the factor at boundaries, and its difference to `BETWEEN`.
    let factors =
        [x > 0, x + 1 < shape[0]].map(|within| R::Lanes::splat_f64(if within { BETWEEN } else { at_boundary[0] }));
    let at_boundaries = [R::Lanes::splat_f64(at_boundary[1]), R::Lanes::splat_f64(at_boundary[2])];
    let between = [R::Lanes::splat_f64(BETWEEN - at_boundary[1]), R::Lanes::splat_f64(BETWEEN - at_boundary[2])];
    // All arrays are cut to one length so that no bounds checks remain.
    let Scratch { band, inflow, outflow, .. } = scratch;
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
    let masks = &weights.masks[..registers];
    let high = &weights.high[x * registers..][..registers];
    let inflow = registers_of::<R::Lanes>(inflow, registers);
    let [x0, x1, y0, y1, z0, z1] = outflow;
    // Not `map`, which may stay a call.
    let outflow = [
        registers_of::<R::Lanes>(x0, registers),
        registers_of::<R::Lanes>(x1, registers),
        registers_of::<R::Lanes>(y0, registers),
        registers_of::<R::Lanes>(&mut y1[along_y..], registers),
        registers_of::<R::Lanes>(z0, registers),
        registers_of::<R::Lanes>(&mut z1[along_z..], registers),
    ];
    let differences = |i: usize| {
        let c = R::Lanes::from_block(&here[i]);
        let (mut slopes, mut squares) = ([flat; FACES], [flat; FACES]);
        for face in 0..FACES {
            let other = R::Lanes::from_block(&beyond[face][i]);
            let (factor, step) = if face < 2 {
                (factors[face], c - other)
            } else {
                let (axis, there) = (face / 2 - 1, masks[i].beyond[face - 2]);
                (there.fma(between[axis], at_boundaries[axis]), (-there).fma(other, c))
            };
            slopes[face] = factor * step;
            squares[face] = slopes[face] * step;
        }
        (slopes, squares)
    };
    let mut found = differences(0);
    for i in 0..registers {
        let (slopes, [x0, x1, y0, y1, z0, z1]) = found;
        // The square roots of the next register do not depend on the results below.
        found = differences((i + 1).min(registers - 1));
        let (x, y, z) = ([x0 + flat, x1 + flat], [y0, y1], [z0, z1]);
        let NeighbourMasks { neighbours, beyond } = masks[i];
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
        sums[0] += f64x8::new(confident.fold_to_8());
        sums[1] += f64x8::new(others.fold_to_8());
        let [a, b, c, d, e, f, g, h] = shares;
        let (ab, cd, ef, gh) = (a + b, c + d, e + f, g + h);
        let (ae, bf, cg, dh) = (a + e, b + f, c + g, d + h);
        let halves = [ab + cd, ef + gh, ab + ef, cd + gh, ae + cg, bf + dh];
        let mut fluxes = [flat; FACES];
        for face in 0..FACES {
            fluxes[face] = slopes[face] * halves[face];
        }
        let [x0, x1, y0, y1, z0, z1] = fluxes;
        inflow[i] = ((x0 + x1) + ((y0 + y1) + (z0 + z1))).to_block();
        for face in 0..FACES {
            let outflow_there = if face < 4 { fluxes[face] } else { beyond[face - 2] * fluxes[face] };
            outflow[face][i] = outflow_there.to_block();
        }
    }
}
