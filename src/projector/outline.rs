//! Which registers of a strip can hold pixels of a primitive's support.

use super::column::STRIP;
use super::plane::Plane;
use std::ops::Range;

/// Where the support may lie in a box of pixels. Pixels that it leaves out would have added zeros.
pub(super) struct Outline<'a> {
    plane: &'a Plane,
    /// What y² + z² may be at most.
    squares: f64,
    /// Rows per unit of y.
    per_y: f64,
}

impl<'a> Outline<'a> {
    /// How much wider it is than the support, so that no rounding of the lanes leads out of it.
    const SPARE: f64 = 1e-3;

    /// The outline of a plane that is [bounded](super::plane::Planes::bounds).
    #[inline(always)]
    pub(super) fn new(plane: &'a Plane) -> Self {
        Self { plane, squares: plane.most * (1.0 + Self::SPARE) - plane.floor, per_y: 1.0 / plane.b }
    }

    /// Calls `column(strip, first, registers)` for each column of registers, `half` pixels wide from `first` on, in the
    /// strips of `rows` (even start): registers are counted from the strip's first row, and there is at least one.
    #[inline(always)]
    pub(super) fn walk(
        &self,
        rows: &Range<usize>,
        columns: &Range<usize>,
        half: usize,
        mut column: impl FnMut(Range<usize>, usize, Range<usize>),
    ) {
        for strip in rows.clone().step_by(STRIP) {
            let strip = strip..rows.end.min(strip + STRIP);
            for first in columns.clone().step_by(half) {
                let registers = self.registers(&strip, first, half);
                if !registers.is_empty() {
                    column(strip.clone(), first, registers);
                }
            }
        }
    }

    /// The registers, of a strip of `rows` (even start), that pixels of the support in `width` columns from `first` on can
    /// be in.
    #[inline(always)]
    fn registers(&self, rows: &Range<usize>, first: usize, width: usize) -> Range<usize> {
        let plane = self.plane;
        if !plane.corners {
            return 0..rows.len().div_ceil(2);
        }
        let left = first as f64 - plane.column_centre;
        let right = (first + width - 1) as f64 - plane.column_centre;
        let (z0, z1) = (plane.a * left + plane.shift, plane.a * right + plane.shift);
        let nearest = if z0 * z1 > 0.0 { (z0 * z0).min(z1 * z1) } else { 0.0 };
        let room = self.squares - nearest;
        if room < 0.0 {
            return 0..0;
        }
        let reach = room.sqrt() * self.per_y + Self::SPARE;
        let (a, b) = (plane.row_centre + plane.slant * left, plane.row_centre + plane.slant * right);
        // What is not a number bounds nothing.
        let low = (a.min(b) - reach).max(rows.start as f64);
        let high = (a.max(b) + reach).min(rows.end as f64 - 1.0);
        if low > high {
            return 0..0;
        }
        (low as usize - rows.start) / 2..(high as usize - rows.start) / 2 + 1
    }
}

#[cfg(test)]
mod tests {
    use super::super::canvas::Canvas;
    use super::super::kernel::{Scratch, backward, forward};
    use super::super::patch::Patch;
    use super::*;
    use crate::numeric::rng::{Purpose, stream};
    use rand::RngExt;

    /// A plane whose support is in the middle of 64 × 64 pixels.
    fn any(draw: &mut impl FnMut(f64, f64) -> f64) -> Plane {
        Plane {
            row_centre: draw(10.0, 50.0),
            column_centre: draw(10.0, 50.0),
            slant: draw(-2.0, 2.0),
            b: draw(0.1, 0.5),
            a: draw(0.1, 0.5),
            h_y: draw(-0.1, 0.1),
            h_z: draw(-0.1, 0.1),
            k: draw(0.0, 0.02),
            q: draw(1.0, 20.0),
            weight: 1.0,
            limit: draw(0.3, 3.0),
            ..Plane::default()
        }
    }

    #[test]
    fn an_outline_holds_every_pixel_of_the_support_and_little_else() {
        let mut draws = stream(5, Purpose::Phantom, 0, 0);
        let (mut walked, mut boxed, mut useful) = (0, 0, 0);
        for number in 0..400 {
            let mut draw = |low: f64, high: f64| low + (high - low) * draws.random::<f64>();
            let shifted = Plane { shift: draw(-0.1, 0.1), floor: draw(0.0, 0.5), ..any(&mut draw) };
            let plane = if number % 2 == 0 { Plane { h_y: 0.0, ..shifted } } else { shifted };
            let pixels: Vec<_> = (0..64 * 64).map(|i| (i / 64, i % 64)).filter(|&(r, c)| plane.reaches(r, c)).collect();
            let Some(&(top, _)) = pixels.first() else { continue };
            let bottom = pixels.last().unwrap().0 + 1;
            let columns = pixels.iter().map(|p| p.1).min().unwrap()..pixels.iter().map(|p| p.1).max().unwrap() + 1;
            let rows = top & !1..bottom;
            let plane = Plane { corners: true, ..plane.bounded(&rows, &columns) };
            let outline = Outline::new(&plane);
            useful += pixels.len();
            for strip in rows.clone().step_by(STRIP) {
                let strip = strip..rows.end.min(strip + STRIP);
                for first in columns.clone().step_by(8) {
                    let registers = outline.registers(&strip, first, 8);
                    walked += 16 * registers.len();
                    boxed += 16 * strip.len().div_ceil(2);
                    assert!(
                        registers.is_empty() || registers.end <= strip.len().div_ceil(2),
                        "{registers:?} of {strip:?}"
                    );
                    for &(row, column) in &pixels {
                        if strip.contains(&row) && (first..first + 8).contains(&column) {
                            assert!(registers.contains(&((row - strip.start) / 2)), "{plane:?} at {row}, {column}");
                        }
                    }
                }
            }
        }
        assert!(useful > 20_000 && walked * 6 < boxed * 5, "{walked} of {boxed} for {useful}");
    }

    #[test]
    fn an_outline_changes_no_bit_of_an_image_or_a_gradient() {
        let mut draws = stream(6, Purpose::Phantom, 0, 0);
        for _ in 0..50 {
            let mut draw = |low: f64, high: f64| low + (high - low) * draws.random::<f64>();
            let plane = any(&mut draw);
            let (rows, columns) = (0..64, 0..64);
            let plane = plane.bounded(&rows, &columns);
            let walked = [false, true].map(|corners| {
                let (mut image, mut scratch) = (Canvas::<f32>::new(64, 64), Scratch::default());
                let patch = Patch::new(&Plane { corners, ..plane }, rows.clone(), columns.clone(), 0, image.stride);
                forward::<f32, _, true, true>(&patch, &mut image, &mut scratch);
                let sums = backward::<f32, _, true, true>(&patch, &image, &mut scratch);
                ((0..64).map(|row| image.row(row, 64).to_vec()).collect::<Vec<_>>(), sums)
            });
            assert!(walked[0].0.concat().iter().any(|&value| value > 0.0), "{plane:?}");
            assert_eq!(walked[0], walked[1], "{plane:?}");
        }
    }
}
