//! A primitive on an image: one plane, and the columns of registers that its support reaches there.

use super::canvas::{Canvas, HALF};
use super::column::{Column, Stance};
use super::kernel::Reach;
use super::outline::Outline;
use super::plane::Plane;
use crate::numeric::{Lanes, Real, real};
use std::ops::Range;

/// A primitive's plane, and where its pixels are on a canvas.
#[derive(Clone, Debug)]
pub(super) struct Patch {
    plane: Plane,
    /// Rows (even start) and columns that bound the support.
    rows: Range<usize>,
    columns: Range<usize>,
    /// Where on the canvas the pixel of column 0 in the first of these rows is.
    first: usize,
    stride: usize,
}

impl Patch {
    /// `rows` start at an even one and, with the columns, bound the support. The first of them is row `top` of the canvas.
    #[inline(always)]
    pub(super) fn new(plane: &Plane, rows: Range<usize>, columns: Range<usize>, top: usize, stride: usize) -> Self {
        Self { plane: *plane, rows, columns, first: top * stride, stride }
    }
}

impl<R: Real> Reach<R> for Patch {
    type Board = Canvas<R>;
    const SOLID: bool = false;

    #[inline(always)]
    fn plane(&self) -> &Plane {
        &self.plane
    }

    #[inline(always)]
    fn walk(&self, mut visit: impl FnMut(Column<R::Lanes>, usize, Range<usize>)) {
        let Self { plane, rows, columns, first, stride } = self;
        let half = R::Lanes::WIDTH / 2;
        let stance = Stance {
            columns: std::array::from_fn(|i| i as f64),
            row_centre: [plane.row_centre; HALF],
            shift: [plane.shift; HALF],
            floor: R::Lanes::splat(real(plane.floor)),
            row: R::Lanes::from_fn(|i| R::from_index(i / half)),
            x: R::Lanes::default(),
        };
        Outline::new(plane).walk(rows, columns, half, |strip, column, registers| {
            let place = first + (strip.start - rows.start) * stride + column;
            visit(Column::new(plane, &stance, strip.start, column, both_rows), place, registers);
        });
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
    use super::super::kernel::{Scratch, backward, forward};
    use super::*;
    use crate::numeric::NEAR_ONE;
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
        let mut counts = [0; 3];
        for (plane, rows, columns) in [0.001, 0.02, 0.1].into_iter().flat_map(planes) {
            let mut worst = 0.0_f64;
            let patch = Patch::new(&plane, rows.clone(), columns, 0, 1000);
            Reach::<f32>::walk(&patch, |_, place, registers| {
                for register in registers {
                    for lane in 0..16 {
                        let (row, column) = (rows.start + 2 * register + lane / 8, place % 1000 + lane % 8);
                        let across = column as f64 - plane.column_centre;
                        let y = plane.b * (row as f64 - plane.row_centre - plane.slant * across);
                        let z = plane.a * across;
                        let h = 1.0 + plane.h_y * y + plane.h_z * z;
                        worst = worst.max((h * h + plane.k * (y * y + z * z) - 1.0).abs());
                    }
                }
            });
            assert!(worst <= plane.bend, "{worst}: {plane:?}");
            counts[NEAR_ONE.iter().filter(|&&near| plane.bend > near).count()] += 1;
        }
        assert!(counts.iter().all(|&count| count > 50), "{counts:?}");
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
