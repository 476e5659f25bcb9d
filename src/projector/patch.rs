//! A primitive on an image: one plane, and the columns of registers that its support reaches there.

use super::canvas::{Canvas, HALF};
use super::column::{Column, STRIP, Stance};
use super::kernel::Reach;
use super::outline::Outline;
use super::plane::Plane;
use crate::numeric::{Lanes, Real, real};
use std::ops::Range;

/// A primitive's plane, and where its pixels are on a canvas.
#[derive(Clone, Debug)]
pub(super) struct Patch {
    plane: Plane,
    /// Rows and columns that bound the support.
    rows: Range<usize>,
    columns: Range<usize>,
    /// Where on the canvas the pixel of column 0 in the first of these rows is.
    first: usize,
    stride: usize,
}

impl Patch {
    /// `rows` and columns bound the support. The first of the rows is row `top` of the canvas: both are even or both odd.
    #[inline(always)]
    pub(super) fn new(plane: &Plane, rows: Range<usize>, columns: Range<usize>, top: usize, stride: usize) -> Self {
        Self { plane: *plane, rows, columns, first: top * stride, stride }
    }

    /// Whether a register of one row is as wide as the support, and one of two rows is not. There are fewer lanes in vain
    /// then, and one column of registers instead of two.
    #[inline(always)]
    pub(super) fn is_slim<R: Real>(&self) -> bool {
        let wide = self.columns.len();
        !self.plane.corners && R::Lanes::WIDTH / 2 < wide && wide <= R::Lanes::WIDTH
    }
}

/// A range that starts at an even row, as registers of two rows want it.
pub(super) fn from_even(rows: Range<usize>) -> Range<usize> {
    rows.start & !1..rows.end
}

impl<R: Real> Reach<R> for Patch {
    type Board = Canvas<R>;
    const TALL: usize = 2;
    const SOLID: bool = false;

    #[inline(always)]
    fn plane(&self) -> &Plane {
        &self.plane
    }

    #[inline(always)]
    fn walk(&self, mut visit: impl FnMut(Column<R::Lanes>, usize, Range<usize>)) {
        let Self { plane, columns, stride, .. } = self;
        let rows = from_even(self.rows.clone());
        let first = self.first - (self.rows.start - rows.start) * stride;
        let half = R::Lanes::WIDTH / 2;
        let stance = Stance { row: R::Lanes::from_fn(|i| R::from_index(i / half)), ..stance(plane) };
        Outline::new(plane).walk(&rows, columns, half, |strip, column, registers| {
            let place = first + (strip.start - rows.start) * stride + column;
            visit(Column::new(plane, &stance, strip.start, column, both_rows), place, registers);
        });
    }

    #[inline(always)]
    fn step(canvas: &Canvas<R>) -> usize {
        2 * canvas.stride
    }

    #[inline(always)]
    fn load(canvas: &Canvas<R>, place: usize) -> R::Lanes {
        canvas.load(place)
    }

    #[inline(always)]
    fn add(canvas: &mut Canvas<R>, place: usize, value: R::Lanes) {
        canvas.add(place, value);
    }
}

/// A [slim](Patch::is_slim) patch.
pub(super) struct Slim<'a>(pub(super) &'a Patch);

impl<R: Real> Reach<R> for Slim<'_> {
    type Board = Canvas<R>;
    const TALL: usize = 1;
    const SOLID: bool = false;

    #[inline(always)]
    fn plane(&self) -> &Plane {
        &self.0.plane
    }

    #[inline(always)]
    fn walk(&self, mut visit: impl FnMut(Column<R::Lanes>, usize, Range<usize>)) {
        let Patch { plane, rows, columns, first, stride } = self.0;
        let stance = stance(plane);
        for start in rows.clone().step_by(STRIP) {
            let place = first + (start - rows.start) * stride + columns.start;
            let registers = 0..STRIP.min(rows.end - start);
            visit(Column::of_row(plane, &stance, start, columns.start), place, registers);
        }
    }

    #[inline(always)]
    fn step(canvas: &Canvas<R>) -> usize {
        canvas.stride
    }

    #[inline(always)]
    fn load(canvas: &Canvas<R>, place: usize) -> R::Lanes {
        canvas.load_row(place)
    }

    #[inline(always)]
    fn add(canvas: &mut Canvas<R>, place: usize, value: R::Lanes) {
        canvas.add_to_row(place, value);
    }
}

/// Where the lanes of a row are.
#[inline(always)]
fn stance<L: Lanes>(plane: &Plane) -> Stance<L> {
    Stance {
        columns: std::array::from_fn(|i| i as f64),
        row_centre: [plane.row_centre; HALF],
        shift: [plane.shift; HALF],
        floor: L::splat(real(plane.floor)),
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
    use super::super::kernel::{Scratch, Sums, backward, forward};
    use super::*;
    use crate::numeric::ROOT_RANGES;
    use crate::numeric::rng::{Purpose, stream};
    use rand::RngExt;

    /// Rows and columns of the image that planes are drawn on.
    const SIDE: usize = 64;

    /// Planes of supports within the image, tilted by up to `tilt` per unit of y and z, with their boxes.
    fn planes(tilt: f64) -> Vec<(Plane, Range<usize>, Range<usize>)> {
        let mut random = stream(9, Purpose::Phantom, 0, 0);
        let mut draw = |low: f64, high: f64| low + (high - low) * random.random::<f64>();
        let mut any = || {
            let plane = Plane {
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
                limit: draw(0.3, 3.0),
                ..Plane::default()
            };
            let inside = |i: &usize| plane.reaches(i / SIDE, i % SIDE);
            let (mut rows, mut columns) = ([SIDE, 0], [SIDE, 0]);
            for i in (0..SIDE * SIDE).filter(inside) {
                rows = [rows[0].min(i / SIDE), rows[1].max(i / SIDE + 1)];
                columns = [columns[0].min(i % SIDE), columns[1].max(i % SIDE + 1)];
            }
            let (rows, columns) = (rows[0]..rows[1], columns[0]..columns[1]);
            (plane.bounded(&rows, &columns), rows.start & !1..rows.end, columns)
        };
        (0..200).map(|_| any()).collect()
    }

    #[test]
    fn no_lane_of_a_visited_register_is_bent_beyond_the_bound() {
        let (mut counts, mut slim) = ([0; 3], 0);
        for (plane, rows, columns) in [0.001, 0.02, 0.1].into_iter().flat_map(planes) {
            let mut worst = 0.0_f64;
            let patch = Patch::new(&plane, rows.clone(), columns, 0, 1000);
            let mut look = |row: usize, column: usize| {
                let across = column as f64 - plane.column_centre;
                let y = plane.b * (row as f64 - plane.row_centre - plane.slant * across);
                let z = plane.a * across;
                let h = 1.0 + plane.h_y * y + plane.h_z * z;
                worst = worst.max((h * h + plane.k * (y * y + z * z) - 1.0).abs());
            };
            Reach::<f32>::walk(&patch, |_, place, registers| {
                for (register, lane) in registers.flat_map(|register| (0..16).map(move |lane| (register, lane))) {
                    look(rows.start + 2 * register + lane / 8, place % 1000 + lane % 8);
                }
            });
            if patch.is_slim::<f32>() {
                slim += 1;
                Reach::<f32>::walk(&Slim(&patch), |_, place, registers| {
                    for (register, lane) in registers.flat_map(|register| (0..16).map(move |lane| (register, lane))) {
                        look(rows.start + register, place % 1000 + lane);
                    }
                });
            }
            assert!(worst <= plane.bend, "{worst}: {plane:?}");
            counts[ROOT_RANGES.iter().filter(|&&near| plane.bend > near).count()] += 1;
        }
        assert!(counts.iter().all(|&count| count > 50) && slim > 50, "{counts:?}, {slim} slim");
    }

    /// Largest difference of pixels and of sums, relative to the largest, between registers of one row and of two.
    fn difference_of_shapes<R: Real>() -> (usize, f64) {
        let (mut slim, mut worst) = (0, 0.0_f64);
        for (plane, rows, columns) in [0.001, 0.02, 0.1].into_iter().flat_map(planes) {
            // The first one that is reached, even or odd.
            let reached = |row: &usize| columns.clone().any(|column| plane.reaches(*row, column));
            let top = rows.clone().find(reached).expect("a support");
            let plane = Plane { corners: false, ..plane };
            let patch = Patch::new(&plane, top..rows.end, columns, top, SIDE + R::Lanes::WIDTH);
            if !patch.is_slim::<R>() {
                continue;
            }
            slim += 1;
            let mut made = [(); 2].map(|()| (Canvas::<R>::new(SIDE, SIDE), Scratch::default()));
            let [(one, one_scratch), (two, two_scratch)] = &mut made;
            forward::<R, _, true, true>(&Slim(&patch), one, one_scratch);
            forward::<R, _, true, true>(&patch, two, two_scratch);
            let values =
                |sums: Sums| [sums.distance.to_vec(), sums.h.to_vec(), vec![sums.k, sums.value, sums.log]].concat();
            let sums_of_two = values(backward::<R, _, true, true>(&patch, two, two_scratch));
            let sums_of_one = values(backward::<R, _, true, true>(&Slim(&patch), two, one_scratch));
            let pixels = |canvas: &Canvas<R>| canvas.pixels.iter().map(|pixel| pixel.to_f64()).collect::<Vec<_>>();
            let pairs = [(pixels(one), pixels(two)), (sums_of_one, sums_of_two)];
            for (a, b) in pairs {
                let largest = b.iter().fold(0.0, |most: f64, value| most.max(value.abs()));
                worst = a.iter().zip(&b).fold(worst, |worst, (a, b)| worst.max((a - b).abs() / largest));
            }
        }
        (slim, worst)
    }

    #[test]
    fn registers_of_one_row_make_the_same_image_and_gradient_as_those_of_two() {
        for ((slim, worst), most) in [(difference_of_shapes::<f32>(), 2e-6), (difference_of_shapes::<f64>(), 5e-15)] {
            assert!(slim > 50 && worst < most, "{slim}: {worst:e}");
        }
    }

    /// Largest difference of images and of gradients, relative to their sizes, between roots found near 1 and found anywhere.
    fn difference<R: Real, const STUDENT: bool>() -> f64 {
        let most = |values: &[f64]| values.iter().fold(0.0, |most: f64, value| most.max(value.abs()));
        let mut worst = 0.0_f64;
        for (plane, rows, columns) in [0.001, 0.02].into_iter().flat_map(planes) {
            let [near, anywhere] = [plane.bend, f64::INFINITY].map(|bend| {
                let (mut image, mut scratch) = (Canvas::<R>::new(SIDE, SIDE), Scratch::default());
                let plane = Plane { bend, ..plane };
                let patch = Patch::new(&plane, rows.clone(), columns.clone(), rows.start, image.stride);
                forward::<R, _, STUDENT, true>(&patch, &mut image, &mut scratch);
                let sums = backward::<R, _, STUDENT, true>(&patch, &image, &mut scratch);
                let pixels: Vec<f64> = image.pixels.iter().map(|pixel| pixel.to_f64()).collect();
                (pixels, [sums.value, sums.distance[0], sums.distance[3], sums.distance[5]])
            });
            let apart: Vec<f64> = near.0.iter().zip(&anywhere.0).map(|(a, b)| a - b).collect();
            let ratios: Vec<f64> = near.1.iter().zip(&anywhere.1).map(|(a, b)| a / b - 1.0).collect();
            worst = worst.max(most(&apart) / most(&anywhere.0)).max(most(&ratios));
        }
        worst
    }

    #[test]
    fn roots_near_one_make_the_same_images_and_gradients() {
        for [single, double] in [
            [difference::<f32, true>(), difference::<f64, true>()],
            [difference::<f32, false>(), difference::<f64, false>()],
        ] {
            assert!(single > 0.0 && single < 2e-6 && double > 0.0 && double < 5e-15, "{single:e} {double:e}");
        }
    }
}
