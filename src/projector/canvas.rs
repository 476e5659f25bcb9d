//! What the kernels read and write: images row by row, volumes in pairs of rows and slices, column by column.

use crate::numeric::{Lanes, Real, threads};
use std::ops::Range;

/// Half of the lanes of the widest register.
pub(super) const HALF: usize = 8;

/// An image: a register is `WIDTH/2` pixels of two rows, or `WIDTH` of one, from any column on.
#[derive(Default)]
pub(super) struct Canvas<R> {
    /// Row by row; `stride` ≥ columns + WIDTH, and an even number of rows.
    pub(super) pixels: Vec<R>,
    pub(super) stride: usize,
}

impl<R: Real> Canvas<R> {
    /// Zeros for `rows` × `columns`.
    pub(super) fn new(rows: usize, columns: usize) -> Self {
        let mut canvas = Self::default();
        canvas.renew(rows, columns);
        canvas
    }

    /// Zeros for `rows` × `columns`, whatever it was before.
    pub(super) fn renew(&mut self, rows: usize, columns: usize) {
        self.stride = columns + R::Lanes::WIDTH;
        clear(&mut self.pixels, rows.next_multiple_of(2) * self.stride);
    }

    /// Zeros again, in some columns of all rows, to the end of the last column's register.
    pub(super) fn clear(&mut self, columns: Range<usize>) {
        let end = columns.end - 1 + R::Lanes::WIDTH;
        for row in self.pixels.chunks_exact_mut(self.stride) {
            row[columns.start..end].fill(R::ZERO);
        }
    }

    /// The pixels of one row.
    pub(super) fn row(&self, row: usize, columns: usize) -> &[R] {
        &self.pixels[row * self.stride..][..columns]
    }

    /// The register of two rows at a place.
    #[inline(always)]
    pub(super) fn load(&self, place: usize) -> R::Lanes {
        let half = R::Lanes::WIDTH / 2;
        let (top, bottom) = self.pixels[place..].split_at(self.stride);
        R::Lanes::from_rows(&top[..half], &bottom[..half])
    }

    /// Adds onto the register of two rows at a place.
    #[inline(always)]
    pub(super) fn add(&mut self, place: usize, value: R::Lanes) {
        let half = R::Lanes::WIDTH / 2;
        let (top, bottom) = self.pixels[place..].split_at_mut(self.stride);
        value.add_to_rows(&mut top[..half], &mut bottom[..half]);
    }

    /// The register of one row at a place.
    #[inline(always)]
    pub(super) fn load_row(&self, place: usize) -> R::Lanes {
        R::Lanes::from_slice(&self.pixels[place..])
    }

    /// Adds onto the register of one row at a place.
    #[inline(always)]
    pub(super) fn add_to_row(&mut self, place: usize, value: R::Lanes) {
        let pixels = &mut self.pixels[place..];
        (R::Lanes::from_slice(pixels) + value).write(pixels);
    }
}

/// As many zeros: a place among them is a u32 (`queue`).
fn clear<R: Real>(values: &mut Vec<R>, count: usize) {
    assert!(u32::try_from(count).is_ok(), "{count} pixels or voxels in one piece: there is room for fewer than 2^32");
    values.clear();
    values.resize(count, R::ZERO);
}

/// Rows and slices of a register of a volume.
pub(super) const PAIR: usize = 2;
/// Voxels of a register with the same column.
pub(super) const BUNDLE: usize = PAIR * PAIR;

/// The part of a grid that [`Blocks`] hold: slices from an even one on, all rows, and some columns.
#[derive(Clone, Debug, Default)]
pub(super) struct Window {
    pub(super) slices: Range<usize>,
    pub(super) rows: usize,
    pub(super) columns: Range<usize>,
}

impl Window {
    /// Columns of a register.
    pub(super) const fn wide<L: Lanes>() -> usize {
        L::WIDTH / BUNDLE
    }

    /// Which of half a register's lanes, those of one row, a lane is in line with.
    pub(super) const fn twin(lane: usize) -> usize {
        lane / BUNDLE * PAIR + lane % PAIR
    }

    /// Row, slice and column of a lane in its register.
    pub(super) const fn lane(lane: usize) -> [usize; 3] {
        [lane / PAIR % PAIR, lane % PAIR, lane / BUNDLE]
    }

    /// From the place of a column to that of the same one two rows below.
    #[inline(always)]
    pub(super) fn step<L: Lanes>(&self) -> usize {
        BUNDLE * (self.columns.len() + Self::wide::<L>())
    }

    /// Where the first voxel of a column is, in a pair of rows of a pair of slices.
    #[inline(always)]
    pub(super) fn place<L: Lanes>(&self, slice: usize, row: usize, column: usize) -> usize {
        let pairs = (slice - self.slices.start) / PAIR * self.rows.div_ceil(PAIR) + row / PAIR;
        pairs * self.step::<L>() + BUNDLE * (column - self.columns.start)
    }
}

/// A volume: a register is two slices × two rows × `WIDTH/4` columns, from any column on. A small support, about as long as
/// wide, needs fewer of these than of registers that lie in one slice.
#[derive(Default)]
pub(super) struct Blocks<R> {
    /// `[slices / 2][rows / 2][columns + WIDTH/4][row][slice]`.
    voxels: Vec<R>,
    pub(super) window: Window,
}

impl<R: Real> Blocks<R> {
    /// Zeros.
    pub(super) fn new(window: Window) -> Self {
        let mut blocks = Self::default();
        blocks.renew(window);
        blocks
    }

    /// Zeros for another window.
    pub(super) fn renew(&mut self, window: Window) {
        let pairs = window.slices.len().div_ceil(PAIR) * window.rows.div_ceil(PAIR);
        clear(&mut self.voxels, pairs * window.step::<R::Lanes>());
        self.window = window;
    }

    /// Zeros again.
    pub(super) fn clear(&mut self) {
        self.voxels.fill(R::ZERO);
    }

    /// Writes all voxels: `row(slice, row)` are the values of one.
    pub(super) fn fill<'a>(&mut self, row: impl Fn(usize, usize) -> &'a [R] + Send + Sync) {
        let Window { slices, rows, .. } = self.window.clone();
        let step = self.window.step::<R::Lanes>();
        threads::for_each_chunk(&mut self.voxels, rows.div_ceil(PAIR) * step, |pair, voxels| {
            let first = slices.start + PAIR * pair;
            for slice in first..slices.end.min(first + PAIR) {
                for y in 0..rows {
                    let bundles = voxels[y / PAIR * step..].chunks_exact_mut(BUNDLE);
                    let place = y % PAIR * PAIR + slice - first;
                    row(slice, y).iter().zip(bundles).for_each(|(&value, bundle)| bundle[place] = value);
                }
            }
        });
    }

    /// Reads the values of a row of a slice.
    pub(super) fn read(&self, slice: usize, row: usize, values: &mut [R]) {
        let first = self.window.place::<R::Lanes>(slice, row, self.window.columns.start);
        let place = row % PAIR * PAIR + (slice - self.window.slices.start) % PAIR;
        let bundles = self.voxels[first..].chunks_exact(BUNDLE);
        values.iter_mut().zip(bundles).for_each(|(value, bundle)| *value = bundle[place]);
    }

    /// The register at a place.
    #[inline(always)]
    pub(super) fn load(&self, place: usize) -> R::Lanes {
        R::Lanes::from_slice(&self.voxels[place..])
    }

    /// Adds onto the register at a place.
    #[inline(always)]
    pub(super) fn add(&mut self, place: usize, value: R::Lanes) {
        let voxels = &mut self.voxels[place..];
        (R::Lanes::from_slice(voxels) + value).write(voxels);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    #[should_panic(expected = "fewer than 2^32")]
    fn an_image_whose_places_are_not_numbers_of_32_bits_is_refused() {
        let _ = Canvas::<f32>::new(1 << 16, 1 << 16);
    }

    #[test]
    #[should_panic(expected = "fewer than 2^32")]
    fn a_volume_whose_places_are_not_numbers_of_32_bits_is_refused() {
        let _ = Blocks::<f32>::new(Window { slices: 0..1 << 11, rows: 1 << 11, columns: 0..1 << 10 });
    }
}
