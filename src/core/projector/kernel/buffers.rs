//! The arrays that the kernels read and write: padded images, and volumes in bricks of two rows and two slices.

use crate::numeric::{Lanes, Real, threads};
use std::ops::Range;

/// Half the lanes of the widest register.
pub(crate) const HALF: usize = 8;

/// An image with room for whole registers.
///
/// A register is `WIDTH/2` pixels of two rows, or `WIDTH` pixels of one, from any column on.
#[derive(Default)]
pub(crate) struct PaddedImage<R> {
    /// Row by row, an even number of rows.
    pub(crate) pixels: Vec<R>,
    /// At least columns + WIDTH.
    pub(crate) stride: usize,
}

impl<R: Real> PaddedImage<R> {
    /// Zeros for `rows` × `columns`.
    pub(crate) fn new(rows: usize, columns: usize) -> Self {
        let mut image = Self::default();
        image.reset(rows, columns);
        image
    }

    /// Becomes `rows` × `columns` zeros.
    pub(crate) fn reset(&mut self, rows: usize, columns: usize) {
        self.stride = columns + R::Lanes::WIDTH;
        clear(&mut self.pixels, rows.next_multiple_of(2) * self.stride);
    }

    /// Sets some columns of all rows to zero, up to the end of the last column's register.
    pub(crate) fn clear(&mut self, columns: Range<usize>) {
        let end = columns.end - 1 + R::Lanes::WIDTH;
        for row in self.pixels.chunks_exact_mut(self.stride) {
            row[columns.start..end].fill(R::ZERO);
        }
    }

    /// The pixels of one row.
    pub(crate) fn row(&self, row: usize, columns: usize) -> &[R] {
        &self.pixels[row * self.stride..][..columns]
    }

    /// The register of two rows at an offset.
    #[inline(always)]
    pub(crate) fn load(&self, offset: usize) -> R::Lanes {
        let half = R::Lanes::WIDTH / 2;
        let (top, bottom) = self.pixels[offset..].split_at(self.stride);
        R::Lanes::from_rows(&top[..half], &bottom[..half])
    }

    /// Adds to the register of two rows at an offset.
    #[inline(always)]
    pub(crate) fn add(&mut self, offset: usize, value: R::Lanes) {
        let half = R::Lanes::WIDTH / 2;
        let (top, bottom) = self.pixels[offset..].split_at_mut(self.stride);
        value.add_to_rows(&mut top[..half], &mut bottom[..half]);
    }

    /// The register of one row at an offset.
    #[inline(always)]
    pub(crate) fn load_row(&self, offset: usize) -> R::Lanes {
        R::Lanes::from_slice(&self.pixels[offset..])
    }

    /// Adds to the register of one row at an offset.
    #[inline(always)]
    pub(crate) fn add_to_row(&mut self, offset: usize, value: R::Lanes) {
        let pixels = &mut self.pixels[offset..];
        (R::Lanes::from_slice(pixels) + value).write(pixels);
    }
}

/// `count` zeros. Offsets are u32 in [`columns`](super::columns).
fn clear<R: Real>(values: &mut Vec<R>, count: usize) {
    assert!(u32::try_from(count).is_ok(), "{count} pixels or voxels in one piece: there is room for fewer than 2^32");
    values.clear();
    values.resize(count, R::ZERO);
}

/// Rows and slices of a register of a volume.
pub(crate) const PAIR: usize = 2;
/// Voxels of a register with the same column.
pub(crate) const BUNDLE: usize = PAIR * PAIR;

/// The part of a grid that a [`BrickedVolume`] holds: slices from an even one on, all rows, some columns.
#[derive(Clone, Debug, Default)]
pub(crate) struct GridRegion {
    pub(crate) slices: Range<usize>,
    pub(crate) rows: usize,
    pub(crate) columns: Range<usize>,
}

impl GridRegion {
    /// Columns of a register.
    pub(crate) const fn register_columns<L: Lanes>() -> usize {
        L::WIDTH / BUNDLE
    }

    /// The lane of the first row, among half a register's lanes, that has the slice and column of `lane`.
    pub(crate) const fn row_lane(lane: usize) -> usize {
        lane / BUNDLE * PAIR + lane % PAIR
    }

    /// Row, slice and column of a lane in its register.
    pub(crate) const fn lane_position(lane: usize) -> [usize; 3] {
        [lane / PAIR % PAIR, lane % PAIR, lane / BUNDLE]
    }

    /// Stride from a voxel to the one two rows below.
    #[inline(always)]
    pub(crate) fn register_stride<L: Lanes>(&self) -> usize {
        BUNDLE * (self.columns.len() + Self::register_columns::<L>())
    }

    /// Offset of the first voxel of a column, in a pair of rows of a pair of slices.
    #[inline(always)]
    pub(crate) fn offset<L: Lanes>(&self, slice: usize, row: usize, column: usize) -> usize {
        let pairs = (slice - self.slices.start) / PAIR * self.rows.div_ceil(PAIR) + row / PAIR;
        pairs * self.register_stride::<L>() + BUNDLE * (column - self.columns.start)
    }
}

/// A volume in bricks: a register is two slices × two rows × `WIDTH/4` columns, from any column on.
///
/// A small compact support needs fewer bricks than registers within one slice.
#[derive(Default)]
pub(crate) struct BrickedVolume<R> {
    /// `[slices / 2][rows / 2][columns + WIDTH/4][row][slice]`.
    voxels: Vec<R>,
    pub(crate) region: GridRegion,
}

impl<R: Real> BrickedVolume<R> {
    /// Zeros.
    pub(crate) fn new(region: GridRegion) -> Self {
        let mut volume = Self::default();
        volume.reset(region);
        volume
    }

    /// Becomes zeros of a region.
    pub(crate) fn reset(&mut self, region: GridRegion) {
        let pairs = region.slices.len().div_ceil(PAIR) * region.rows.div_ceil(PAIR);
        clear(&mut self.voxels, pairs * region.register_stride::<R::Lanes>());
        self.region = region;
    }

    /// Sets all voxels to zero.
    pub(crate) fn clear(&mut self) {
        self.voxels.fill(R::ZERO);
    }

    /// Writes all voxels; `row(slice, row)` returns the values of a row.
    pub(crate) fn fill<'a>(&mut self, row: impl Fn(usize, usize) -> &'a [R] + Send + Sync) {
        let GridRegion { slices, rows, .. } = self.region.clone();
        let step = self.region.register_stride::<R::Lanes>();
        threads::for_each_chunk(&mut self.voxels, rows.div_ceil(PAIR) * step, |pair, voxels| {
            let first = slices.start + PAIR * pair;
            for slice in first..slices.end.min(first + PAIR) {
                for y in 0..rows {
                    let bundles = voxels[y / PAIR * step..].chunks_exact_mut(BUNDLE);
                    let lane = y % PAIR * PAIR + slice - first;
                    row(slice, y).iter().zip(bundles).for_each(|(&value, bundle)| bundle[lane] = value);
                }
            }
        });
    }

    /// Copies the values of a row of a slice.
    pub(crate) fn read(&self, slice: usize, row: usize, values: &mut [R]) {
        let first = self.region.offset::<R::Lanes>(slice, row, self.region.columns.start);
        let lane = row % PAIR * PAIR + (slice - self.region.slices.start) % PAIR;
        let bundles = self.voxels[first..].chunks_exact(BUNDLE);
        values.iter_mut().zip(bundles).for_each(|(value, bundle)| *value = bundle[lane]);
    }

    /// The register at an offset.
    #[inline(always)]
    pub(crate) fn load(&self, offset: usize) -> R::Lanes {
        R::Lanes::from_slice(&self.voxels[offset..])
    }

    /// Adds to the register at an offset.
    #[inline(always)]
    pub(crate) fn add(&mut self, offset: usize, value: R::Lanes) {
        let voxels = &mut self.voxels[offset..];
        (R::Lanes::from_slice(voxels) + value).write(voxels);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    #[should_panic(expected = "fewer than 2^32")]
    fn an_image_whose_offsets_are_not_numbers_of_32_bits_is_refused() {
        let _ = PaddedImage::<f32>::new(1 << 16, 1 << 16);
    }

    #[test]
    #[should_panic(expected = "fewer than 2^32")]
    fn a_volume_whose_offsets_are_not_numbers_of_32_bits_is_refused() {
        let _ = BrickedVolume::<f32>::new(GridRegion { slices: 0..1 << 11, rows: 1 << 11, columns: 0..1 << 10 });
    }
}
