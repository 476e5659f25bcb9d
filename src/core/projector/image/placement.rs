//! A footprint placed on an image buffer: the columns of registers that its support covers there.

use super::outline::Outline;
use crate::numeric::{Lanes, Real, real};
use crate::projector::kernel::Rasterize;
use crate::projector::kernel::buffers::{HALF, PaddedImage};
use crate::projector::kernel::columns::{Column, LaneOffsets, STRIP};
use crate::projector::kernel::conic::Conic;
use std::ops::Range;

/// A primitive's conic and the offsets of its pixels in an image buffer.
#[derive(Clone, Debug)]
pub(crate) struct PlacedFootprint {
    conic: Conic,
    /// Rows that bound the support.
    rows: Range<usize>,
    /// Columns that bound the support.
    columns: Range<usize>,
    /// Offset of the pixel of column 0 in the first of these rows.
    first: usize,
    stride: usize,
}

impl PlacedFootprint {
    /// `rows` and `columns` bound the support. The first row is row `top` of the buffer: both are even or both odd.
    #[inline(always)]
    pub(crate) fn new(conic: &Conic, rows: Range<usize>, columns: Range<usize>, top: usize, stride: usize) -> Self {
        Self { conic: *conic, rows, columns, first: top * stride, stride }
    }

    /// Whether one register of a single row covers the support's width but one of two rows does not.
    ///
    /// [`RowLayout`] then wastes fewer lanes, and has one column of registers instead of two.
    #[inline(always)]
    pub(crate) fn fits_row_layout<R: Real>(&self) -> bool {
        let width = self.columns.len();
        !self.conic.trims_corners && R::Lanes::WIDTH / 2 < width && width <= R::Lanes::WIDTH
    }
}

/// The range extended to an even start, as registers of two rows need it.
pub(crate) fn from_even(rows: Range<usize>) -> Range<usize> {
    rows.start & !1..rows.end
}

impl<R: Real> Rasterize<R> for PlacedFootprint {
    type Target = PaddedImage<R>;
    const REGISTER_ROWS: usize = 2;
    const IS_VOLUME: bool = false;

    #[inline(always)]
    fn conic(&self) -> &Conic {
        &self.conic
    }

    #[inline(always)]
    fn for_each_column(&self, mut visit: impl FnMut(Column<R::Lanes>, usize, Range<usize>)) {
        let Self { conic, columns, stride, .. } = self;
        let rows = from_even(self.rows.clone());
        let first = self.first - (self.rows.start - rows.start) * stride;
        let half = R::Lanes::WIDTH / 2;
        let lane_offsets = LaneOffsets { row: R::Lanes::from_fn(|i| R::from_index(i / half)), ..of_row(conic) };
        Outline::new(conic).for_each_column(&rows, columns, half, |strip, column, registers| {
            let offset = first + (strip.start - rows.start) * stride + column;
            visit(Column::new(conic, &lane_offsets, strip.start, column, both_rows), offset, registers);
        });
    }

    #[inline(always)]
    fn register_stride(image: &PaddedImage<R>) -> usize {
        2 * image.stride
    }

    #[inline(always)]
    fn load(image: &PaddedImage<R>, offset: usize) -> R::Lanes {
        image.load(offset)
    }

    #[inline(always)]
    fn add(image: &mut PaddedImage<R>, offset: usize, value: R::Lanes) {
        image.add(offset, value);
    }
}

/// A footprint in registers of a single row, where it [fits](PlacedFootprint::fits_row_layout).
pub(crate) struct RowLayout<'a>(pub(crate) &'a PlacedFootprint);

impl<R: Real> Rasterize<R> for RowLayout<'_> {
    type Target = PaddedImage<R>;
    const REGISTER_ROWS: usize = 1;
    const IS_VOLUME: bool = false;

    #[inline(always)]
    fn conic(&self) -> &Conic {
        &self.0.conic
    }

    #[inline(always)]
    fn for_each_column(&self, mut visit: impl FnMut(Column<R::Lanes>, usize, Range<usize>)) {
        let PlacedFootprint { conic, rows, columns, first, stride } = self.0;
        let lane_offsets = of_row(conic);
        for start in rows.clone().step_by(STRIP) {
            let offset = first + (start - rows.start) * stride + columns.start;
            let registers = 0..STRIP.min(rows.end - start);
            visit(Column::of_row(conic, &lane_offsets, start, columns.start), offset, registers);
        }
    }

    #[inline(always)]
    fn register_stride(image: &PaddedImage<R>) -> usize {
        image.stride
    }

    #[inline(always)]
    fn load(image: &PaddedImage<R>, offset: usize) -> R::Lanes {
        image.load_row(offset)
    }

    #[inline(always)]
    fn add(image: &mut PaddedImage<R>, offset: usize, value: R::Lanes) {
        image.add_to_row(offset, value);
    }
}

/// Coordinates of the lanes of a row.
#[inline(always)]
fn of_row<L: Lanes>(conic: &Conic) -> LaneOffsets<L> {
    LaneOffsets {
        columns: std::array::from_fn(|i| i as f64),
        row_centre: [conic.row_centre; HALF],
        shift: [conic.shift; HALF],
        floor: L::splat_f64(conic.floor),
        row: L::default(),
        x: L::default(),
    }
}

/// The same values in both rows of a register, which may have fewer columns.
#[inline(always)]
fn both_rows<L: Lanes>(values: [f64; HALF]) -> L {
    let values = values.map(real::<L::Scalar>);
    L::from_rows(&values[..L::WIDTH / 2], &values[..L::WIDTH / 2])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::numeric::ROOT_RANGES;
    use crate::numeric::rng::{Purpose, stream};
    use crate::projector::kernel::variants::{Exact, Gaussian, Profile, StudentT};
    use crate::projector::kernel::{Scratch, Sums, forward, vjp};
    use rand::RngExt;

    /// Rows and columns of the image that conics are drawn on.
    const SIDE: usize = 64;

    /// Conics of supports within the image, tilted by up to `tilt` per unit of y and z, with their boxes.
    fn conics(tilt: f64) -> Vec<(Conic, Range<usize>, Range<usize>)> {
        let mut random = stream(9, Purpose::Phantom, 0, 0);
        let mut draw = |low: f64, high: f64| low + (high - low) * random.random::<f64>();
        let mut any = || {
            let conic = Conic {
                row_centre: draw(20.0, 40.0),
                column_centre: draw(20.0, 40.0),
                slant: draw(-1.0, 1.0),
                b: draw(0.1, 0.4),
                a: draw(0.1, 0.4),
                h_y: draw(-tilt, tilt),
                h_z: draw(-tilt, tilt),
                k: draw(0.0, tilt * tilt),
                q: draw(2.0, 20.0),
                weight: 1.0,
                max_x: draw(0.3, 3.0),
                ..Conic::default()
            };
            let inside = |i: &usize| conic.contains(i / SIDE, i % SIDE);
            let (mut rows, mut columns) = ([SIDE, 0], [SIDE, 0]);
            for i in (0..SIDE * SIDE).filter(inside) {
                rows = [rows[0].min(i / SIDE), rows[1].max(i / SIDE + 1)];
                columns = [columns[0].min(i % SIDE), columns[1].max(i % SIDE + 1)];
            }
            let (rows, columns) = (rows[0]..rows[1], columns[0]..columns[1]);
            (conic.with_bounds(&rows, &columns), rows.start & !1..rows.end, columns)
        };
        (0..200).map(|_| any()).collect()
    }

    #[test]
    fn no_lane_of_a_visited_register_is_bent_beyond_the_bound() {
        let (mut counts, mut row_layouts) = ([0; 3], 0);
        for (conic, rows, columns) in [0.001, 0.02, 0.1].into_iter().flat_map(conics) {
            let mut worst = 0.0_f64;
            let footprint = PlacedFootprint::new(&conic, rows.clone(), columns, 0, 1000);
            let mut visit = |row: usize, column: usize| {
                let across = column as f64 - conic.column_centre;
                let y = conic.b * (row as f64 - conic.row_centre - conic.slant * across);
                let z = conic.a * across;
                let h = 1.0 + conic.h_y * y + conic.h_z * z;
                worst = worst.max((h * h + conic.k * (y * y + z * z) - 1.0).abs());
            };
            Rasterize::<f32>::for_each_column(&footprint, |_, offset, registers| {
                for (register, lane) in registers.flat_map(|register| (0..16).map(move |lane| (register, lane))) {
                    visit(rows.start + 2 * register + lane / 8, offset % 1000 + lane % 8);
                }
            });
            if footprint.fits_row_layout::<f32>() {
                row_layouts += 1;
                Rasterize::<f32>::for_each_column(&RowLayout(&footprint), |_, offset, registers| {
                    for (register, lane) in registers.flat_map(|register| (0..16).map(move |lane| (register, lane))) {
                        visit(rows.start + register, offset % 1000 + lane);
                    }
                });
            }
            assert!(worst <= conic.max_abs_e, "{worst}: {conic:?}");
            counts[ROOT_RANGES.iter().filter(|&&near| conic.max_abs_e > near).count()] += 1;
        }
        assert!(counts.iter().all(|&count| count > 50) && row_layouts > 50, "{counts:?}, {row_layouts} row layouts");
    }

    /// Largest difference of pixels and of sums, relative to the largest, between registers of one row and of two.
    fn difference_of_shapes<R: Real>() -> (usize, f64) {
        let (mut row_layouts, mut worst) = (0, 0.0_f64);
        for (conic, rows, columns) in [0.001, 0.02, 0.1].into_iter().flat_map(conics) {
            // The first one that is reached, even or odd.
            let reached = |row: &usize| columns.clone().any(|column| conic.contains(*row, column));
            let top = rows.clone().find(reached).expect("a support");
            let conic = Conic { trims_corners: false, ..conic };
            let footprint = PlacedFootprint::new(&conic, top..rows.end, columns, top, SIDE + R::Lanes::WIDTH);
            if !footprint.fits_row_layout::<R>() {
                continue;
            }
            row_layouts += 1;
            let mut made = [(); 2].map(|()| (PaddedImage::<R>::new(SIDE, SIDE), Scratch::default()));
            let [(one, one_scratch), (two, two_scratch)] = &mut made;
            forward::<R, _, StudentT, Exact>(&RowLayout(&footprint), one, one_scratch);
            forward::<R, _, StudentT, Exact>(&footprint, two, two_scratch);
            let values =
                |sums: Sums| [sums.distance.to_vec(), sums.h.to_vec(), vec![sums.k, sums.value, sums.log]].concat();
            let sums_of_two = values(vjp::<R, _, StudentT, Exact>(&footprint, two, two_scratch));
            let sums_of_one = values(vjp::<R, _, StudentT, Exact>(&RowLayout(&footprint), two, one_scratch));
            let pixels = |image: &PaddedImage<R>| image.pixels.iter().map(|pixel| pixel.to_f64()).collect::<Vec<_>>();
            let pairs = [(pixels(one), pixels(two)), (sums_of_one, sums_of_two)];
            for (a, b) in pairs {
                let largest = b.iter().fold(0.0, |largest: f64, value| largest.max(value.abs()));
                worst = a.iter().zip(&b).fold(worst, |worst, (a, b)| worst.max((a - b).abs() / largest));
            }
        }
        (row_layouts, worst)
    }

    #[test]
    fn registers_of_one_row_make_the_same_image_and_gradient_as_those_of_two() {
        let [single, double] = [difference_of_shapes::<f32>(), difference_of_shapes::<f64>()];
        assert!(single.0 > 50 && double.0 > 50, "{single:?} {double:?}");
        within!("f32", single.1);
        within!("f64", double.1);
    }

    /// Largest difference of images and of gradients, relative to their sizes, between roots computed near 1 and anywhere.
    fn difference<R: Real, P: Profile>() -> f64 {
        let largest = |values: &[f64]| values.iter().fold(0.0, |largest: f64, value| largest.max(value.abs()));
        let mut worst = 0.0_f64;
        for (conic, rows, columns) in [0.001, 0.02].into_iter().flat_map(conics) {
            let [near, anywhere] = [conic.max_abs_e, f64::INFINITY].map(|max_abs_e| {
                let (mut image, mut scratch) = (PaddedImage::<R>::new(SIDE, SIDE), Scratch::default());
                let conic = Conic { max_abs_e, ..conic };
                let footprint = PlacedFootprint::new(&conic, rows.clone(), columns.clone(), rows.start, image.stride);
                forward::<R, _, P, Exact>(&footprint, &mut image, &mut scratch);
                let sums = vjp::<R, _, P, Exact>(&footprint, &image, &mut scratch);
                let pixels: Vec<f64> = image.pixels.iter().map(|pixel| pixel.to_f64()).collect();
                (pixels, [sums.value, sums.distance[0], sums.distance[3], sums.distance[5]])
            });
            let differences: Vec<f64> = near.0.iter().zip(&anywhere.0).map(|(a, b)| a - b).collect();
            let ratios: Vec<f64> = near.1.iter().zip(&anywhere.1).map(|(a, b)| a / b - 1.0).collect();
            worst = worst.max(largest(&differences) / largest(&anywhere.0)).max(largest(&ratios));
        }
        worst
    }

    #[test]
    fn roots_near_one_make_the_same_images_and_gradients() {
        for [single, double] in [
            [difference::<f32, StudentT>(), difference::<f64, StudentT>()],
            [difference::<f32, Gaussian>(), difference::<f64, Gaussian>()],
        ] {
            assert!(single > 0.0 && double > 0.0, "{single:e} {double:e}");
            within!("f32", single);
            within!("f64", double);
        }
    }
}
