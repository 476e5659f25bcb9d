//! The registers of a strip that can hold pixels of a primitive's support.

use crate::projector::kernel::columns::STRIP;
use crate::projector::kernel::conic::Conic;
use std::ops::Range;

/// The outline of a support within its box of pixels. Values outside of it are zero.
pub(crate) struct Outline<'a> {
    conic: &'a Conic,
    /// Bound on y² + z².
    squares: f64,
    /// Rows per unit of y.
    per_y: f64,
}

impl<'a> Outline<'a> {
    /// How much wider than the support the outline is, so that the lanes' rounding stays inside.
    const MARGIN: f64 = 1e-3;

    /// The outline of a conic whose bounds are set.
    #[inline(always)]
    pub(crate) fn new(conic: &'a Conic) -> Self {
        Self { conic, squares: conic.max_delta * (1.0 + Self::MARGIN) - conic.floor, per_y: 1.0 / conic.b }
    }

    /// Calls `column(strip, first, registers)` for each non-empty column of registers in the strips of `rows`.
    ///
    /// Columns are `half` pixels wide from `first` on. Registers are counted from the strip's first row; `rows` starts at
    /// an even row.
    #[inline(always)]
    pub(crate) fn for_each_column(
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

    /// The registers of a strip of `rows` that can hold pixels of the support in `width` columns from `first` on.
    #[inline(always)]
    fn registers(&self, rows: &Range<usize>, first: usize, width: usize) -> Range<usize> {
        let conic = self.conic;
        if !conic.trims_corners {
            return 0..rows.len().div_ceil(2);
        }
        let left = first as f64 - conic.column_centre;
        let right = (first + width - 1) as f64 - conic.column_centre;
        let (z0, z1) = (conic.a * left + conic.shift, conic.a * right + conic.shift);
        let nearest = if z0 * z1 > 0.0 { (z0 * z0).min(z1 * z1) } else { 0.0 };
        let rest = self.squares - nearest;
        if rest < 0.0 {
            return 0..0;
        }
        let extent = rest.sqrt() * self.per_y + Self::MARGIN;
        let (ridge0, ridge1) = (conic.row_centre + conic.slant * left, conic.row_centre + conic.slant * right);
        // NaN bounds are treated as unbounded.
        let low = (ridge0.min(ridge1) - extent).max(rows.start as f64);
        let high = (ridge0.max(ridge1) + extent).min(rows.end as f64 - 1.0);
        if low > high {
            return 0..0;
        }
        (low as usize - rows.start) / 2..(high as usize - rows.start) / 2 + 1
    }
}

#[cfg(test)]
mod tests {
    use super::super::placement::PlacedFootprint;
    use super::*;
    use crate::numeric::rng::{Purpose, stream};
    use crate::projector::kernel::buffers::PaddedImage;
    use crate::projector::kernel::variants::{Exact, StudentT};
    use crate::projector::kernel::{Scratch, forward, vjp};
    use rand::RngExt;

    /// A conic whose support is in the middle of 64 × 64 pixels.
    fn any(draw: &mut impl FnMut(f64, f64) -> f64) -> Conic {
        Conic {
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
            max_x: draw(0.3, 3.0),
            ..Conic::default()
        }
    }

    #[test]
    fn an_outline_holds_every_pixel_of_the_support_and_little_else() {
        let mut draws = stream(5, Purpose::Phantom, 0, 0);
        let (mut walked, mut boxed, mut active) = (0, 0, 0);
        for number in 0..400 {
            let mut draw = |low: f64, high: f64| low + (high - low) * draws.random::<f64>();
            let shifted = Conic { shift: draw(-0.1, 0.1), floor: draw(0.0, 0.5), ..any(&mut draw) };
            let conic = if number % 2 == 0 { Conic { h_y: 0.0, ..shifted } } else { shifted };
            let pixels: Vec<_> =
                (0..64 * 64).map(|i| (i / 64, i % 64)).filter(|&(r, c)| conic.contains(r, c)).collect();
            let Some(&(top, _)) = pixels.first() else { continue };
            let bottom = pixels.last().unwrap().0 + 1;
            let columns = pixels.iter().map(|p| p.1).min().unwrap()..pixels.iter().map(|p| p.1).max().unwrap() + 1;
            let rows = top & !1..bottom;
            let conic = Conic { trims_corners: true, ..conic.with_bounds(&rows, &columns) };
            let outline = Outline::new(&conic);
            active += pixels.len();
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
                            assert!(registers.contains(&((row - strip.start) / 2)), "{conic:?} at {row}, {column}");
                        }
                    }
                }
            }
        }
        assert!(active > 20_000 && walked * 6 < boxed * 5, "{walked} of {boxed} for {active}");
    }

    #[test]
    fn an_outline_changes_no_bit_of_an_image_or_a_gradient() {
        let mut draws = stream(6, Purpose::Phantom, 0, 0);
        for _ in 0..50 {
            let mut draw = |low: f64, high: f64| low + (high - low) * draws.random::<f64>();
            let conic = any(&mut draw);
            let (rows, columns) = (0..64, 0..64);
            let conic = conic.with_bounds(&rows, &columns);
            let walked = [false, true].map(|trims_corners| {
                let (mut image, mut scratch) = (PaddedImage::<f32>::new(64, 64), Scratch::default());
                let footprint = PlacedFootprint::new(
                    &Conic { trims_corners, ..conic },
                    rows.clone(),
                    columns.clone(),
                    0,
                    image.stride,
                );
                forward::<f32, _, StudentT, Exact>(&footprint, &mut image, &mut scratch);
                let sums = vjp::<f32, _, StudentT, Exact>(&footprint, &image, &mut scratch);
                ((0..64).map(|row| image.row(row, 64).to_vec()).collect::<Vec<_>>(), sums)
            });
            assert!(walked[0].0.concat().iter().any(|&value| value > 0.0), "{conic:?}");
            assert_eq!(walked[0], walked[1], "{conic:?}");
        }
    }
}
