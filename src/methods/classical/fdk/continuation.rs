//! Continuation of projections beyond the detector, where it cuts the object off.
//!
//! The ramp filter needs whole projections: a row that ends inside the object adds a bright rim, and makes the middle too
//! bright as well. With the distance d of a ray from the axis, the square of a
//! homogeneous ellipse's projection is a parabola in d, in a fan beam nearly:
//!
//! ```text
//! p(d)² ≈ a + b·d + c·d²,   c < 0
//! ```
//!
//! Each row continues along the parabola fitted to all of it, shifted to meet the row at its end, down to 0. The idea is
//! that of J. Hsieh et al., *A novel reconstruction algorithm to extend the CT scan field-of-view*, Med. Phys. 31 (2004)
//! 2385, who continue by a cylinder of water. A row that no such parabola fits fades to 0 over the columns added. Not
//! in the paper.

use glam::{DMat3, DVec3};
use ndarray::Array3;
use std::f64::consts::FRAC_PI_2;
use trgs_core::geometry::{Beam, Scanner};
use trgs_core::numeric::elementary::cos;
use trgs_core::numeric::{Real, real, threads};

/// Columns at the end of a row whose mean the continuation meets.
const END: usize = 3;

/// Fills the columns that were added to `images` `[view, v, u]` at the sides that are `continued`.
///
/// `scanner` has the widened detector, and `padding` the number of columns added left and right.
pub(super) fn fill<R: Real>(
    scanner: &Scanner,
    images: &mut Array3<R>,
    [left, right]: [usize; 2],
    continued: [bool; 2],
) {
    let columns = scanner.detector.columns;
    let measured = left..columns - right;
    if !continued.contains(&true) {
        return;
    }
    let distances: Vec<f64> = (0..columns).map(|column| distance(scanner, column)).collect();
    let rows = images.as_slice_mut().expect("a new array is in C order");
    threads::for_each_chunk(rows, columns, |_, row| {
        let squares: Vec<f64> = row[measured.clone()].iter().map(|&p| signed_square(Real::to_f64(p))).collect();
        let parabola = Parabola::fit(&distances[measured.clone()], &squares);
        let n = END.min(squares.len());
        for (side, end, outside) in [
            (0, measured.start..measured.start + n, 0..measured.start),
            (1, measured.end - n..measured.end, measured.end..columns),
        ] {
            if !continued[side] {
                continue;
            }
            let mean = |value: &dyn Fn(usize) -> f64| end.clone().map(value).sum::<f64>() / n as f64;
            let level = mean(&|column| squares[column - measured.start]);
            let shift = level - mean(&|column| parabola.at(distances[column]));
            let reach = outside.len() as f64 + 1.0;
            for column in outside {
                let steps = if side == 0 { measured.start - column } else { column + 1 - measured.end };
                let fade = cos(FRAC_PI_2 * steps as f64 / reach);
                let square = match parabola.opens_down() {
                    true => parabola.at(distances[column]) + shift,
                    false => level,
                };
                row[column] = real(square.max(0.0).sqrt() * if parabola.opens_down() { 1.0 } else { fade });
            }
        }
    });
}

/// Signed distance of a column's ray from the axis, in the plane of the source.
fn distance(scanner: &Scanner, column: usize) -> f64 {
    let (u, _) = scanner.detector.position(0.0, column as f64);
    match scanner.beam {
        Beam::Cone { dso, dsd } => dso * u / (dsd * dsd + u * u).sqrt(),
        Beam::Parallel { .. } => u,
    }
}

/// The square with the sign of the value: noise around 0 has no bias.
fn signed_square(value: f64) -> f64 {
    value * value.abs()
}

/// `a + b·t + c·t²` with `t = (x - middle)/half`.
#[derive(Clone, Copy, Debug)]
struct Parabola {
    middle: f64,
    half: f64,
    coefficients: [f64; 3],
}

impl Parabola {
    /// The least-squares fit to values at increasing positions; constant for fewer than three.
    fn fit(positions: &[f64], values: &[f64]) -> Self {
        let (first, last) = (positions[0], positions[positions.len() - 1]);
        let (middle, half) = ((first + last) / 2.0, ((last - first) / 2.0).max(f64::MIN_POSITIVE));
        let mut moments = [0.0; 5];
        let mut right = [0.0; 3];
        for (&x, &y) in positions.iter().zip(values) {
            let t = (x - middle) / half;
            let mut power = 1.0;
            for k in 0..5 {
                moments[k] += power;
                if k < 3 {
                    right[k] += power * y;
                }
                power *= t;
            }
        }
        let matrix = DMat3::from_cols(
            DVec3::new(moments[0], moments[1], moments[2]),
            DVec3::new(moments[1], moments[2], moments[3]),
            DVec3::new(moments[2], moments[3], moments[4]),
        );
        let coefficients = match positions.len() {
            0..3 => [right[0] / moments[0], 0.0, 0.0],
            _ => (matrix.inverse() * DVec3::from_array(right)).to_array(),
        };
        Self { middle, half, coefficients }
    }

    fn at(&self, x: f64) -> f64 {
        let t = (x - self.middle) / self.half;
        let [a, b, c] = self.coefficients;
        a + t * (b + t * c)
    }

    fn opens_down(&self) -> bool {
        self.coefficients[2] < 0.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ndarray::Axis;
    use trgs_core::geometry::{Detector, Grid};

    #[test]
    fn an_ellipse_is_continued_to_its_end() {
        let detector = Detector { rows: 2, columns: 40, pitch_v: 0.1, pitch_u: 0.1, offset_u: 0.0, offset_v: 0.0 };
        let scanner = Scanner { beam: Beam::Parallel { dso: 5.0 }, detector, grid: Grid::cube(4) };
        let chord = |column: usize| {
            let u = detector.position(0.0, column as f64).0 - 0.2;
            0.6 * (2.6 - u * u).max(0.0).sqrt()
        };
        let whole = Array3::from_shape_fn((2, 2, 40), |(_, _, column)| chord(column));
        let mut images = whole.clone();
        images.slice_axis_mut(Axis(2), (..10).into()).fill(0.0);
        images.slice_axis_mut(Axis(2), (30..).into()).fill(0.0);
        fill(&scanner, &mut images, [10, 10], [true, false]);
        let differ =
            |a: usize, b: usize| (a..b).map(|c| (images[[1, 1, c]] - whole[[1, 1, c]]).abs()).fold(0.0, f64::max);
        within!(differ(0, 30));
        assert!((30..40).all(|column| images[[0, 1, column]] == 0.0), "the other side is left");
    }

    #[test]
    fn a_row_without_an_end_fades() {
        let detector = Detector { rows: 1, columns: 30, pitch_v: 0.1, pitch_u: 0.1, offset_u: 0.0, offset_v: 0.0 };
        let scanner = Scanner { beam: Beam::Cone { dso: 5.0, dsd: 7.0 }, detector, grid: Grid::cube(4) };
        // Hollow: its middle is darker than its borders.
        let mut images =
            Array3::from_shape_fn((1, 1, 30), |(_, _, column)| (1.0 + (column as f64 - 14.5).abs()) as f32);
        images.slice_axis_mut(Axis(2), (20..).into()).fill(0.0);
        fill(&scanner, &mut images, [0, 10], [false, true]);
        let tail: Vec<f32> = images.iter().skip(20).copied().collect();
        assert!(tail.windows(2).all(|pair| pair[1] < pair[0]) && tail[9] > 0.0 && tail[0] < 6.0, "{tail:?}");
    }
}
