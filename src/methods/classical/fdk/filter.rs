//! The weights and the ramp filter of FDK.

use super::redundancy::RayWeights;
use super::{Sample, Window};
use crate::classical::columns::Columns;
use ndarray::{ArrayView3, Axis};
use rustfft::num_complex::Complex;
use rustfft::{Fft, FftPlannerScalar};
use std::f64::consts::{PI, TAU};
use std::sync::Arc;
use trgs_core::geometry::{Beam, Scanner};
use trgs_core::numeric::elementary::cos;
use trgs_core::numeric::{Real, real, threads};

/// Weighted and filtered projections of the scanner's size.
pub(super) fn filtered<R: Sample>(
    scanner: &Scanner,
    weights: &RayWeights,
    images: ArrayView3<'_, R>,
    window: Window,
) -> Columns<R> {
    let (rows, columns) = (scanner.detector.rows, scanner.detector.columns);
    let ramp = Ramp::new(columns, window);
    let magnification = scanner.beam.magnification();
    let mut values = vec![R::ZERO; images.len()];
    threads::for_each_chunk(&mut values, rows * columns, |view, out| {
        let scale = |column| weights.at(view, column) * magnification / scanner.detector.pitch_u;
        let image = images.index_axis(Axis(0), view);
        let weighted = |row: usize, column: usize| {
            let (u, v) = scanner.detector.position(row as f64, column as f64);
            let cosine = match scanner.beam {
                Beam::Cone { dsd, .. } => dsd / (dsd * dsd + u * u + v * v).sqrt(),
                Beam::Parallel { .. } => 1.0,
            };
            real(Real::to_f64(image[[row, column]]) * cosine * weights.shifted(scanner, u) * scale(column))
        };
        let mut buffer = vec![Complex::default(); ramp.response.len()];
        let mut scratch = vec![Complex::default(); ramp.scratch()];
        for top in (0..rows).step_by(2) {
            // The filter is real and even, so one complex transform filters two rows without mixing them.
            let bottom = (top + 1 < rows).then_some(top + 1);
            buffer.fill(Complex::default());
            for (column, slot) in buffer[..columns].iter_mut().enumerate() {
                *slot = Complex::new(weighted(top, column), bottom.map_or(R::ZERO, |row| weighted(row, column)));
            }
            ramp.apply(&mut buffer, &mut scratch);
            for (column, value) in buffer[..columns].iter().enumerate() {
                out[column * rows + rows - 1 - top] = value.re;
                if let Some(row) = bottom {
                    out[column * rows + rows - 1 - row] = value.im;
                }
            }
        }
    });
    Columns { values, rows, columns }
}

/// The ramp filter along rows, in the frequency domain.
struct Ramp<R> {
    /// Response at each frequency, divided by the length of the unnormalised transforms.
    response: Vec<R>,
    forward: Arc<dyn Fft<R>>,
    backward: Arc<dyn Fft<R>>,
}

impl<R: Sample> Ramp<R> {
    /// The filter for rows of `columns` pixels of size 1, sampled as in TIGRE.
    ///
    /// In space, h(0) = ¼, h(n) = -1/(πn)² for odd n and 0 for even n. Rows are padded with at least as many zeros, so
    /// wrap-around stays outside of them.
    fn new(columns: usize, window: Window) -> Self {
        let length = (2 * columns).next_power_of_two().max(64);
        let cosines: Vec<f64> = (0..length).map(|k| cos(TAU * k as f64 / length as f64)).collect();
        let response = |k: usize| {
            let odd = (1..length / 2).step_by(2);
            let ramp = odd.fold(0.25, |sum, n| sum - 2.0 * cosines[n * k % length] / (PI * PI * (n * n) as f64));
            let frequency = k.min(length - k) as f64 * TAU / length as f64;
            real(ramp * window.at(frequency) / length as f64)
        };
        // This planner does not detect processor features: it gives the same bits everywhere.
        let mut planner = FftPlannerScalar::new();
        Self {
            response: (0..length).map(response).collect(),
            forward: planner.plan_fft_forward(length),
            backward: planner.plan_fft_inverse(length),
        }
    }

    fn scratch(&self) -> usize {
        self.forward.get_inplace_scratch_len().max(self.backward.get_inplace_scratch_len())
    }

    fn apply(&self, buffer: &mut [Complex<R>], scratch: &mut [Complex<R>]) {
        self.forward.process_with_scratch(buffer, scratch);
        buffer.iter_mut().zip(&self.response).for_each(|(value, &factor)| *value = *value * factor);
        self.backward.process_with_scratch(buffer, scratch);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tolerances::largest;
    use ndarray::Array3;
    use trgs_core::geometry::{Detector, Grid};

    #[test]
    fn the_filter_is_the_sampled_ramp() {
        let ramp = Ramp::<f32>::new(50, Window::RamLak);
        let mut buffer = vec![Complex::default(); ramp.response.len()];
        buffer[20] = Complex::new(1.0, -2.0);
        ramp.apply(&mut buffer, &mut vec![Complex::default(); ramp.scratch()]);
        for (n, value) in buffer[..50].iter().enumerate() {
            let distance = n.abs_diff(20);
            let expected = match distance {
                0 => 0.25,
                d if d % 2 == 1 => -1.0 / (PI * PI * (d * d) as f64),
                _ => 0.0,
            };
            within!(largest([f64::from(value.re) - expected, f64::from(value.im) + 2.0 * expected]));
        }
    }

    #[test]
    fn an_impulse_becomes_the_sampled_ramp_times_its_constants() {
        let detector = Detector { rows: 5, columns: 9, pitch_v: 0.7, pitch_u: 0.8, offset_u: 0.3, offset_v: -0.2 };
        let mut images = Array3::<f32>::zeros((3, 5, 9));
        images[[1, 3, 2]] = 1.0;
        // The second view stands for (3.0 - 0.5)/2 of either turn.
        let angles = [0.5, 1.0, 3.0];
        for beam in [Beam::Cone { dso: 5.0, dsd: 7.0 }, Beam::Parallel { dso: 5.0 }] {
            let scanner = Scanner { beam, detector, grid: Grid::cube(4) };
            let filtered = super::super::filter(&scanner, &angles, images.view(), Window::RamLak).unwrap();
            // Pixel (3, 2) lies at u = -2·0.8 + 0.3, v = 0.7 - 0.2.
            let (u, v) = (-1.3_f64, 0.5_f64);
            let front = match beam {
                Beam::Cone { .. } => 0.5 * 1.25 * 7.0 / (49.0 + u * u + v * v).sqrt() / (0.8 * 5.0 / 7.0),
                Beam::Parallel { .. } => 1.25 / 0.8,
            };
            for ((view, row, column), &value) in filtered.indexed_iter() {
                let expected = match column.abs_diff(2) {
                    _ if (view, row) != (1, 3) => 0.0,
                    0 => 0.25 * front,
                    n if n % 2 == 1 => -front / (PI * PI * (n * n) as f64),
                    _ => 0.0,
                };
                within!((f64::from(value) - expected).abs(), "{beam:?} {view} {row} {column}: {value}");
            }
        }
    }
}
