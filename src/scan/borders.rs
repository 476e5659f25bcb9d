//! What the borders of projections see: air, or an object that goes on outside the detector.
//!
//! Not in the paper. The profile of a view along one axis of the detector is the mean over the other axis. A border is
//! the mean of the outermost two entries of a profile, or its last one if it is short. The object is *cut off* there in
//! a view whose border exceeds [`CLEARLY`] of the view's largest entry and `NOISE` standard errors. Air ([`Air`]) is
//! subtracted before, and the mean of noise that was clipped at 0.

use super::air::Air;
pub use super::air::Side;
use ndarray::{ArrayView1, ArrayView3, Axis};
use std::ops::Range;
use trgs_core::numeric::Real;
use trgs_core::words::counted;

/// Entries of a profile from which on two of them make a border.
const LONG: usize = 32;
/// A reading clearly above air, in units of the largest entry of the view's profile.
pub const CLEARLY: f64 = 0.05;
/// A reading clearly above noise, standard errors.
const NOISE: f64 = 5.0;
/// Share of the views from which on a border counts as cut off: single damaged views do not.
const VIEWS: f64 = 0.02;

/// A border of the projections.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Border {
    /// Share of the views in which the object is cut off there, from 0 to 1.
    pub share: f64,
    /// The largest reading of the border over the views, in units of the largest entry of its view's profile.
    pub level: f64,
}

impl Border {
    /// Whether the object is cut off there in more than single views.
    pub fn is_cut(&self) -> bool {
        self.share >= VIEWS
    }
}

/// The borders of projections `[view, v, u]`, and the columns that see the object.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Borders {
    /// In the order of [`Side::ALL`].
    pub sides: [Border; 4],
    /// Columns whose profile is clearly above air in more than single views; empty without an object.
    pub columns: Range<usize>,
    /// The air of the projections, if they see any.
    pub air: Option<Air>,
}

impl Borders {
    /// Examines images `[view, v, u]`. Views without any positive profile are skipped.
    pub fn of<R: Real>(images: ArrayView3<'_, R>) -> Self {
        let (views, rows, columns) = images.dim();
        let mut sides = [Border::default(); 4];
        let mut seen = vec![0.0; columns];
        let one = 1.0 / views.max(1) as f64;
        let air = Air::of(images);
        let (noise, bias) = air.as_ref().map_or((0.0, 0.0), |air| (air.noise, air.bias));
        for (view, image) in images.outer_iter().enumerate() {
            let base = air.as_ref().map_or(0.0, |air| air.at(view));
            let mean = |line: ArrayView1<'_, R>| {
                line.iter().map(|&value| Real::to_f64(value)).sum::<f64>() / line.len().max(1) as f64
            };
            for (across, first) in [(Axis(1), 0), (Axis(0), 2)] {
                let profile: Vec<f64> = image.axis_iter(across).map(|line| mean(line) - base).collect();
                let peak = profile.iter().fold(0.0, |a: f64, &b| if b > a { b } else { a });
                let n = profile.len().min(if profile.len() < LONG { 1 } else { 2 });
                if peak <= 0.0 || n == 0 {
                    continue;
                }
                let border = |part: &[f64]| part.iter().sum::<f64>() / (part.len() as f64 * peak);
                let entry = if first == 0 { rows } else { columns };
                let is_clear = |level: f64, entries: usize| {
                    let above = level * peak - bias;
                    above > CLEARLY * peak && above > NOISE * noise / ((entries * entry) as f64).sqrt()
                };
                let levels = [border(&profile[..n]), border(&profile[profile.len() - n..])];
                for (side, level) in sides[first..first + 2].iter_mut().zip(levels) {
                    side.level = if level > side.level { level } else { side.level };
                    side.share += if is_clear(level, n) { one } else { 0.0 };
                }
                if first == 0 {
                    let above = seen.iter_mut().zip(&profile).filter(|(_, value)| is_clear(**value / peak, 1));
                    above.for_each(|(count, _)| *count += one);
                }
            }
        }
        let first = seen.iter().position(|&share| share >= VIEWS);
        let columns = match (first, seen.iter().rposition(|&share| share >= VIEWS)) {
            (Some(first), Some(last)) => first..last + 1,
            _ => 0..0,
        };
        Self { sides, columns, air }
    }

    /// A border.
    pub fn at(&self, side: Side) -> Border {
        self.sides[side as usize]
    }

    /// The sides among `of` where the object is cut off, with numbers.
    ///
    /// Example: `left (in 40 of 40 views, up to 31 % of the view's largest)`.
    pub fn cut(&self, of: &[Side], views: usize) -> Vec<String> {
        let cut = of.iter().map(|&side| (side, self.at(side))).filter(|(_, border)| border.is_cut());
        cut.map(|(side, border)| {
            let count = (border.share * views as f64).round();
            format!(
                "{} (in {count} of {}, up to {:.0} % of the view's largest)",
                side.name(),
                counted(views, "view"),
                100.0 * border.level
            )
        })
        .collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ndarray::Array3;

    #[test]
    fn an_object_that_leaves_the_detector_is_found_at_its_side() {
        // A bar over rows 2 to 4 that reaches the right border in 3 of 10 views, and noise of a hundredth.
        let images = Array3::from_shape_fn((10, 8, 20), |(view, row, column)| {
            let bar = (2..5).contains(&row) && column > 6 && (column < 15 || view < 3);
            f32::from(u8::from(bar)) + 0.01 * f32::from(((7 * row + 3 * column + view) % 3) as u8)
        });
        let borders = Borders::of(images.view());
        let cut = Side::ALL.map(|side| borders.at(side).is_cut());
        assert_eq!(cut, [false, true, false, false], "{borders:?}");
        within!("share", (borders.at(Side::Right).share - 0.3).abs());
        within!("level", (borders.at(Side::Right).level - 1.0).abs());
        assert_eq!(borders.columns, 7..20);
        let text = borders.cut(&Side::ALL, 10);
        assert_eq!(text.len(), 1);
        assert!(text[0].starts_with("right (in 3 of 10 views, up to 100 %"), "{text:?}");
    }

    #[test]
    fn air_and_empty_views_have_no_object() {
        let borders = Borders::of(Array3::<f32>::zeros((3, 4, 5)).view());
        assert_eq!((borders.sides, borders.columns), ([Border::default(); 4], 0..0));
    }
}
