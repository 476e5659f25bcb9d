//! The orthonormal 3-D Haar transform `[Eq. 11]`, level by level.
//!
//! Along one axis, of each pair `(a, b)` of neighbours: low `(a + b)/√2`, high `(a - b)/√2`. In three axes a cell of
//! 2×2×2 voxels becomes one coefficient in each of eight bands, `4·hx + 2·hy + hz` with `h = 1` for high: band 0 is low along
//! all axes, band 7 high. All entries of the matrix are ±1/√8, so a band alone is its coefficient times a sign:
//!
//! ```text
//! c_b(cell) = Σ_o ±f(2·cell + o)/√8,   f(2·cell + o) = Σ_b ±c_b(cell)/√8,   ± = (-1)^|b ∧ o|,   o = 4·ox + 2·oy + oz
//! ```

use crate::numeric::{Real, threads};
use ndarray::{Array3, Array4, ArrayView3};
use std::borrow::Cow;
use std::f64::consts::FRAC_1_SQRT_2;

/// Bands of one level.
pub const BANDS: usize = 8;
/// Slices along x of one task, an even number: a constant, so that results do not depend on the number of threads.
const SLAB: usize = 8;
/// Cells of a row that are transformed together.
const CHUNK: usize = 16;

/// The Haar coefficients of a block `[Eq. 11]`.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Subbands<R> {
    /// Level by level, finest first; level l = 1, 2, … is `[band, X/2^l, Y/2^l, Z/2^l]`.
    ///
    /// Band 0 of a level is the input of the next one, and a coefficient in the coarsest level only.
    pub levels: Vec<Array4<R>>,
}

impl<R: Real> Subbands<R> {
    /// Zeros for a block of `shape`.
    ///
    /// # Panics
    /// When a side is not divisible by 2 once for each level, or `levels` is 0.
    pub fn zeros(shape: [usize; 3], levels: usize) -> Self {
        assert!(levels > 0, "a transform of no level");
        let even = |side: &usize| *side > 0 && side.trailing_zeros() as usize >= levels;
        assert!(shape.iter().all(even), "sides {shape:?} of a block, to be halved {levels} times");
        let level = |l: usize| Array4::default((BANDS, shape[0] >> l, shape[1] >> l, shape[2] >> l));
        Self { levels: (1..=levels).map(level).collect() }
    }

    /// Becomes zeros for a block of `shape`, unless it has that shape already.
    pub(super) fn fit(&mut self, shape: [usize; 3], levels: usize) {
        if levels == 0 || self.levels.len() != levels || self.shape() != shape {
            *self = Self::zeros(shape, levels);
        }
    }

    /// The coefficients of one band, `[x, y, z]` in order; levels count from 1.
    pub(super) fn band(&self, level: usize, band: usize) -> &[R] {
        let all = self.levels[level - 1].as_slice().expect("coefficients are contiguous");
        all.chunks_exact(all.len() / BANDS).nth(band).expect("a band below 8")
    }

    /// The shape of the block.
    fn shape(&self) -> [usize; 3] {
        let finest = self.levels[0].shape();
        [1, 2, 3].map(|axis| 2 * finest[axis])
    }
}

/// The transform of a block `[x, y, z]` `[Eq. 11]`.
///
/// # Panics
/// When a side is not divisible by 2 once for each level, or `levels` is 0.
pub fn forward<R: Real>(block: ArrayView3<R>, levels: usize) -> Subbands<R> {
    let mut subbands = Subbands::default();
    forward_into(block, levels, &mut subbands);
    subbands
}

/// [`forward`] into an existing transform.
pub(super) fn forward_into<R: Real>(block: ArrayView3<R>, levels: usize, subbands: &mut Subbands<R>) {
    let (x, y, z) = block.dim();
    let mut shape = [x, y, z];
    subbands.fit(shape, levels);
    let block = block.as_standard_layout();
    let mut low = block.as_slice().expect("standard layout");
    for level in &mut subbands.levels {
        let all = level.as_slice_mut().expect("coefficients are contiguous");
        let size = all.len() / BANDS;
        let [nx, ny, nz] = shape;
        let [a, b, c, d, e, f, g, h] = to_bands(all.chunks_exact_mut(size)).map(|band| {
            let of_slab = SLAB * ny * nz / BANDS;
            threads::chunks(band, of_slab)
        });
        threads::for_each_zip((a, b, c, d, e, f, g, h), |slab, (a, b, c, d, e, f, g, h)| {
            let first = slab * SLAB;
            let slab = &low[first * ny * nz..nx.min(first + SLAB) * ny * nz];
            analyse_all(slab, [ny, nz], [a, b, c, d, e, f, g, h]);
        });
        low = &all[..size];
        shape = shape.map(|side| side / 2);
    }
}

/// The block `[x, y, z]` of a transform, whose bands 0 only count in the coarsest level `[Eq. 11]`.
pub fn inverse<R: Real>(subbands: &Subbands<R>) -> Array3<R> {
    let mut block = Array3::default((0, 0, 0));
    inverse_into(subbands, &mut block);
    block
}

/// [`inverse`] into an existing array.
pub(super) fn inverse_into<R: Real>(subbands: &Subbands<R>, block: &mut Array3<R>) {
    let shape = subbands.shape();
    if block.shape() != shape {
        *block = Array3::default(shape);
    }
    let coarsest = subbands.levels.len();
    let mut low = Cow::Borrowed(subbands.band(coarsest, 0));
    for level in (2..=coarsest).rev() {
        let mut finer = vec![R::ZERO; shape.iter().product::<usize>() >> (3 * (level - 1))];
        synthesise_all(&low, subbands, level, &mut finer);
        low = Cow::Owned(finer);
    }
    synthesise_all(&low, subbands, 1, block.as_slice_mut().expect("standard layout"));
}

/// The block of a level's coefficients; `low` are those of band 0.
fn synthesise_all<R: Real>(low: &[R], subbands: &Subbands<R>, level: usize, block: &mut [R]) {
    let [_, ny, nz] = subbands.shape().map(|side| side >> (level - 1));
    let bands: [_; BANDS] = std::array::from_fn(|band| if band == 0 { low } else { subbands.band(level, band) });
    threads::for_each_chunk(block, SLAB * ny * nz, |slab, block| {
        let mut first = slab * SLAB * ny * nz / BANDS;
        for slices in block.chunks_exact_mut(2 * ny * nz) {
            let (even, odd) = slices.split_at_mut(ny * nz);
            for (even, odd) in even.chunks_exact_mut(2 * nz).zip(odd.chunks_exact_mut(2 * nz)) {
                let ((a, b), (c, d)) = (even.split_at_mut(nz), odd.split_at_mut(nz));
                join_row(&bands, first, [a, b, c, d]);
                first += nz / 2;
            }
        }
    });
}

/// The coefficients of all bands of a few slices: rows of `ny`·`nz` voxels, an even number of them.
fn analyse_all<R: Real>(slices: &[R], [ny, nz]: [usize; 2], mut bands: [&mut [R]; BANDS]) {
    let mut first = 0;
    for slices in slices.chunks_exact(2 * ny * nz) {
        let (even, odd) = slices.split_at(ny * nz);
        for (even, odd) in even.chunks_exact(2 * nz).zip(odd.chunks_exact(2 * nz)) {
            let ((a, b), (c, d)) = (even.split_at(nz), odd.split_at(nz));
            split_row([a, b, c, d], &mut bands, first);
            first += nz / 2;
        }
    }
}

/// All bands of a row of cells, from its four rows of voxels, written from index `first` on.
#[inline(always)]
fn split_row<R: Real>([a, b, c, d]: [&[R]; 4], bands: &mut [&mut [R]; BANDS], first: usize) {
    let left = a.len() / 2 % CHUNK;
    let end = first + a.len() / 2;
    let (a, b, c, d) = (a.as_chunks(), b.as_chunks(), c.as_chunks(), d.as_chunks());
    let rows = a.0.iter().zip(b.0).zip(c.0.iter().zip(d.0));
    for (((a, b), (c, d)), place) in rows.zip((first..).step_by(CHUNK)) {
        for (band, cells) in bands.iter_mut().zip(split([a, b, c, d])) {
            band[place..][..CHUNK].copy_from_slice(&cells);
        }
    }
    if left > 0 {
        let mut voxels = [[R::ZERO; 2 * CHUNK]; 4];
        voxels.iter_mut().zip([a.1, b.1, c.1, d.1]).for_each(|(voxels, row)| voxels[..2 * left].copy_from_slice(row));
        for (band, cells) in bands.iter_mut().zip(split(voxels.each_ref())) {
            band[end - left..end].copy_from_slice(&cells[..left]);
        }
    }
}

/// The four rows of voxels of a row of cells: the transpose of [`split_row`], and its inverse.
#[inline(always)]
fn join_row<R: Real>(bands: &[&[R]; BANDS], first: usize, [a, b, c, d]: [&mut [R]; 4]) {
    let left = a.len() / 2 % CHUNK;
    let end = first + a.len() / 2;
    let cells = |place: usize, n: usize| {
        let mut cells = [[R::ZERO; CHUNK]; BANDS];
        cells.iter_mut().zip(bands).for_each(|(cells, band)| cells[..n].copy_from_slice(&band[place..][..n]));
        cells
    };
    let (a, b, c, d) = (a.as_chunks_mut(), b.as_chunks_mut(), c.as_chunks_mut(), d.as_chunks_mut());
    let rows = a.0.iter_mut().zip(b.0).zip(c.0.iter_mut().zip(d.0));
    for (((a, b), (c, d)), place) in rows.zip((first..).step_by(CHUNK)) {
        [*a, *b, *c, *d] = join(&cells(place, CHUNK));
    }
    if left > 0 {
        for (voxels, row) in [a.1, b.1, c.1, d.1].into_iter().zip(join(&cells(end - left, left))) {
            voxels.copy_from_slice(&row[..2 * left]);
        }
    }
}

/// [`split_row`] of a few cells.
#[inline(always)]
fn split<R: Real>(voxels: [&[R; 2 * CHUNK]; 4]) -> [[R; CHUNK]; BANDS] {
    let mut bands = [[R::ZERO; CHUNK]; BANDS];
    let scale = scale::<R>();
    for i in 0..CHUNK {
        let mut c = [R::ZERO; BANDS];
        for (j, row) in voxels.iter().enumerate() {
            (c[2 * j], c[2 * j + 1]) = (row[2 * i] + row[2 * i + 1], row[2 * i] - row[2 * i + 1]);
        }
        for (j, k) in [(0, 2), (1, 3), (4, 6), (5, 7), (0, 4), (1, 5), (2, 6), (3, 7)] {
            (c[j], c[k]) = (c[j] + c[k], c[j] - c[k]);
        }
        bands.iter_mut().zip(c).for_each(|(band, c)| band[i] = scale * c);
    }
    bands
}

/// [`join_row`] of a few cells.
#[inline(always)]
fn join<R: Real>(bands: &[[R; CHUNK]; BANDS]) -> [[R; 2 * CHUNK]; 4] {
    let mut voxels = [[R::ZERO; 2 * CHUNK]; 4];
    let scale = scale::<R>();
    for i in 0..CHUNK {
        let mut c = [R::ZERO; BANDS];
        c.iter_mut().zip(bands).for_each(|(c, band)| *c = scale * band[i]);
        for (j, k) in [(0, 4), (1, 5), (2, 6), (3, 7), (0, 2), (1, 3), (4, 6), (5, 7)] {
            (c[j], c[k]) = (c[j] + c[k], c[j] - c[k]);
        }
        for (j, row) in voxels.iter_mut().enumerate() {
            (row[2 * i], row[2 * i + 1]) = (c[2 * j] + c[2 * j + 1], c[2 * j] - c[2 * j + 1]);
        }
    }
    voxels
}

fn to_bands<T>(mut values: impl Iterator<Item = T>) -> [T; BANDS] {
    std::array::from_fn(|_| values.next().expect("eight bands"))
}

/// One band alone at full size: `shape` voxels in the order `[x, y, z]` from the band's coefficients of a level.
pub(super) fn alone<R: Real>(coefficients: &[R], shape: [usize; 3], level: usize, band: usize) -> Vec<R> {
    let mut low = Cow::Borrowed(coefficients);
    for finer in (0..level).rev() {
        let shape = shape.map(|side| side >> finer);
        let mut block = vec![R::ZERO; shape.iter().product()];
        let band = if finer + 1 == level { band } else { 0 };
        add_synthesis(&low, shape, band, &mut block);
        low = Cow::Owned(block);
    }
    low.into_owned()
}

/// The transpose of [`alone`]: the band's coefficients, of a level, of a block.
pub(super) fn coefficients<R: Real>(block: &[R], shape: [usize; 3], level: usize, band: usize) -> Vec<R> {
    let mut low = Cow::Borrowed(block);
    for finer in 0..level {
        let mut halved = vec![R::ZERO; low.len() / BANDS];
        let band = if finer + 1 == level { band } else { 0 };
        analyse(&low, shape.map(|side| side >> finer), band, &mut halved);
        low = Cow::Owned(halved);
    }
    low.into_owned()
}

/// Whether a band is high along x, y and z.
pub(super) fn is_high(band: usize) -> [bool; 3] {
    [4, 2, 1].map(|axis| band & axis != 0)
}

/// Signs of the odd voxels along x, y and z in a band: -1 where it is high, 1 where it is low.
fn signs<R: Real>(band: usize) -> [R; 3] {
    is_high(band).map(|high| if high { -R::ONE } else { R::ONE })
}

/// 1/√8
pub(super) fn scale<R: Real>() -> R {
    R::from_f64(0.5 * FRAC_1_SQRT_2)
}

/// Coefficients of one band from a block of `shape`, one level.
///
/// Pairs are added before pairs of pairs: the high bands of an axis along which the block is constant are exactly 0.
fn analyse<R: Real>(block: &[R], shape: [usize; 3], band: usize, coefficients: &mut [R]) {
    let [_, ny, nz] = shape;
    let ([along_x, along_y, along_z], scale) = (signs::<R>(band), scale::<R>());
    for (i, cells) in coefficients.chunks_exact_mut(nz / 2).enumerate() {
        let (x, y) = (2 * (i / (ny / 2)), 2 * (i % (ny / 2)));
        let row = |odd_x: usize, odd_y: usize| block[((x + odd_x) * ny + y + odd_y) * nz..][..nz].chunks_exact(2);
        let pairs = row(0, 0).zip(row(0, 1)).zip(row(1, 0).zip(row(1, 1)));
        for (cell, ((a, b), (c, d))) in cells.iter_mut().zip(pairs) {
            let pair = |p: &[R]| p[0] + along_z * p[1];
            *cell = scale * ((pair(a) + along_y * pair(b)) + along_x * (pair(c) + along_y * pair(d)));
        }
    }
}

/// Adds the contribution of one band to a block of `shape`, one level. The transpose of [`analyse`].
fn add_synthesis<R: Real>(coefficients: &[R], [_, ny, nz]: [usize; 3], band: usize, block: &mut [R]) {
    let ([along_x, along_y, along_z], scale) = (signs::<R>(band), scale::<R>());
    let sign = |sign: R, index: usize| if index.is_multiple_of(2) { R::ONE } else { sign };
    for (i, row) in block.chunks_exact_mut(nz).enumerate() {
        let (x, y) = (i / ny, i % ny);
        let even = scale * sign(along_x, x) * sign(along_y, y);
        let odd = even * along_z;
        let cells = &coefficients[(x / 2 * (ny / 2) + y / 2) * (nz / 2)..][..nz / 2];
        for (cell, pair) in cells.iter().zip(row.chunks_exact_mut(2)) {
            (pair[0], pair[1]) = (pair[0] + even * *cell, pair[1] + odd * *cell);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::numeric::rng::{Purpose, stream};
    use crate::tolerances::largest;
    use crate::wavelet::naive;
    use ndarray::Axis;
    use rand::RngExt;

    fn block(shape: [usize; 3], seed: u64) -> Array3<f64> {
        let mut random = stream(seed, Purpose::Phantom, 1, 0);
        Array3::from_shape_simple_fn(shape, || random.random::<f64>() - 0.3)
    }

    fn energy(subbands: &Subbands<f64>) -> f64 {
        let coarsest = subbands.levels.len();
        let squares = (1..=coarsest).flat_map(|level| {
            let first = usize::from(level < coarsest);
            (first..BANDS).flat_map(move |band| subbands.band(level, band).iter().map(|c| c * c))
        });
        squares.sum()
    }

    #[test]
    fn the_inverse_of_the_transform_is_the_block_and_both_have_the_same_energy() {
        for (shape, levels) in [([2, 2, 2], 1), ([4, 6, 10], 1), ([32, 8, 2], 1), ([4, 12, 8], 2), ([8, 16, 24], 3)] {
            let block = block(shape, levels as u64);
            let subbands = forward(block.view(), levels);
            let peak = block.iter().fold(0.0_f64, |m, v| m.max(v.abs()));
            let worst = (&inverse(&subbands) - &block).iter().fold(0.0_f64, |m, d| m.max(d.abs()));
            within!(worst / peak, "{shape:?}, {levels} levels: {:e}", worst / peak);
            let (before, after) = (block.iter().map(|v| v * v).sum::<f64>(), energy(&subbands));
            within!("energy", (before - after).abs() / before, "{shape:?}, {levels} levels: {before} or {after}");
        }
    }

    #[test]
    fn coefficients_and_bands_alone_are_those_of_the_definition() {
        let block = block([4, 8, 12], 5);
        let subbands = forward(block.view(), 2);
        let finest = naive::transform(&block);
        let coarsest = naive::transform(&finest.index_axis(Axis(0), 0).to_owned());
        for (level, expected) in subbands.levels.iter().zip([finest, coarsest]) {
            within!(largest(level - &expected));
        }
        for (level, band) in (1..=2).flat_map(|level| (0..BANDS).map(move |band| (level, band))) {
            let expected = naive::alone(&block, level, band);
            let found = alone(subbands.band(level, band), [4, 8, 12], level, band);
            within!(largest(found.iter().zip(&expected).map(|(a, b)| a - b)), "level {level}, band {band}");
            let again = coefficients(block.as_slice().unwrap(), [4, 8, 12], level, band);
            within!(largest(again.iter().zip(subbands.band(level, band)).map(|(a, b)| a - b)));
        }
    }

    #[test]
    fn a_band_alone_and_its_coefficients_are_transposes_of_each_other() {
        let (shape, level) = ([8, 4, 12], 2);
        let (f, size) = (block(shape, 7), 2 * 3);
        for band in 0..BANDS {
            let c: Vec<f64> = block([1, 2, 3], band as u64).into_iter().collect();
            let left: f64 = alone(&c, shape, level, band).iter().zip(&f).map(|(a, b)| a * b).sum();
            let right: f64 =
                coefficients(f.as_slice().unwrap(), shape, level, band).iter().zip(&c).map(|(a, b)| a * b).sum();
            assert_eq!(c.len(), size);
            within!((left - right).abs(), "band {band}: {left} or {right}");
        }
    }

    /// The bands in which anything is larger than rounding.
    fn excited(block: &Array3<f64>) -> Vec<usize> {
        let subbands = forward(block.view(), 1);
        (0..BANDS).filter(|&band| subbands.band(1, band).iter().any(|c| c.abs() > 1e-14)).collect()
    }

    #[test]
    fn known_signals_are_in_the_bands_they_belong_to() {
        let shape = (4, 6, 2);
        assert_eq!(excited(&Array3::from_elem(shape, 0.7)), [0], "constant");
        assert_eq!(excited(&Array3::from_shape_fn(shape, |(x, _, _)| x as f64)), [0, 4], "ramp along x");
        assert_eq!(excited(&Array3::from_shape_fn(shape, |(_, y, _)| y as f64)), [0, 2], "ramp along y");
        assert_eq!(excited(&Array3::from_shape_fn(shape, |(_, _, z)| z as f64)), [0, 1], "ramp along z");
        let sign = |n: usize| if n.is_multiple_of(2) { 1.0 } else { -1.0 };
        assert_eq!(excited(&Array3::from_shape_fn(shape, |(x, y, _)| sign(x + y))), [6], "chequers in x and y");
        assert_eq!(excited(&Array3::from_shape_fn(shape, |(x, y, z)| sign(x + y + z))), [7], "chequers");
    }

    #[test]
    fn a_block_that_does_not_change_along_an_axis_has_exactly_nothing_in_its_high_bands() {
        let block = block([6, 4, 8], 11).mapv(|v| v as f32);
        for (axis, high) in [(0, 4), (1, 2), (2, 1)] {
            let even = Array3::from_shape_fn(block.dim(), |(x, y, z)| {
                let mut at = [x, y, z];
                at[axis] = 0;
                block[at]
            });
            let subbands = forward(even.view(), 1);
            for band in (0..BANDS).filter(|band| band & high != 0) {
                assert!(subbands.band(1, band).iter().all(|c| *c == 0.0), "axis {axis}, band {band}");
            }
        }
    }

    #[test]
    #[should_panic(expected = "sides [4, 6, 4] of a block, to be halved 2 times")]
    fn a_side_that_cannot_be_halved_is_refused() {
        forward(block([4, 6, 4], 0).view(), 2);
    }
}
