//! Prediction error of views that were held out of a reconstruction.

use super::Convention;
use super::reduced::{Place, Reduced};
use crate::classical::algebraic::{Order, SartSettings, sart};
use crate::classical::{RayModel, VoxelProjector};
use ndarray::ArrayView2;
use std::ops::ControlFlow;
use trgs_core::error::Result;
use trgs_core::geometry::{Projections, Scanner, Trajectory, Volume};
use trgs_core::numeric::{reduce, threads};

/// Number of parts of the views that are held out in turn.
const FOLDS: usize = 3;
/// SART passes: a third pass changes neither ranks nor minima.
const PASSES: usize = 2;
/// Bands of rows, and of columns, whose residuals are kept apart.
pub(super) const BANDS: usize = 6;

/// A convention, and the place of detector and axis.
pub(super) type Hypothesis = (Convention, Place);

/// The squared residual of each held-out view, and the sum of squares of the measured values.
#[derive(Clone, Debug)]
pub(super) struct HeldOut {
    pub(super) residuals: Vec<f64>,
    /// The parts of each residual in [`BANDS`] × [`BANDS`] equal tiles of the detector, in C order.
    pub(super) tiles: Vec<Vec<f64>>,
    measured: f64,
}

impl HeldOut {
    /// `‖A x - p‖/‖p‖` over all views, each with the x reconstructed without it.
    pub(super) fn residual(&self) -> f64 {
        (self.sum() / self.measured).sqrt()
    }

    /// The sum of squared differences of all views.
    pub(super) fn sum(&self) -> f64 {
        reduce::sum(&self.residuals)
    }

    /// The mean difference of squared residuals per view from another hypothesis, in standard errors.
    pub(super) fn worse_than(&self, other: &Self) -> f64 {
        let n = self.residuals.len() as f64;
        let difference = |i: usize| self.residuals[i] - other.residuals[i];
        let mean = reduce::sum_by(self.residuals.len(), &difference) / n;
        let deviation = |i: usize| (difference(i) - mean) * (difference(i) - mean);
        let error = (reduce::sum_by(self.residuals.len(), &deviation) / (n * (n - 1.0))).sqrt();
        if error > 0.0 { mean / error } else { 0.0 }
    }
}

/// The held-out residuals of each hypothesis.
pub(super) fn held_out(scan: &Reduced, hypotheses: &[Hypothesis]) -> Result<Vec<HeldOut>> {
    let views = scan.views.len();
    let parts: Result<Vec<Vec<Vec<f64>>>> =
        threads::map(hypotheses.len() * FOLDS, |job| fold(scan, &hypotheses[job / FOLDS], job % FOLDS))
            .into_iter()
            .collect();
    let measured = square(scan.views.images.as_slice().expect("standard layout"));
    let of = |parts: &[Vec<Vec<f64>>]| {
        let tiles: Vec<Vec<f64>> = (0..views).map(|view| parts[view % FOLDS][view / FOLDS].clone()).collect();
        HeldOut { residuals: tiles.iter().map(|tiles| reduce::sum(tiles)).collect(), tiles, measured }
    };
    Ok(parts?.chunks_exact(FOLDS).map(of).collect())
}

/// The squared residuals of every third view by tiles, with x from the others.
fn fold(scan: &Reduced, &(convention, offset): &Hypothesis, fold: usize) -> Result<Vec<Vec<f64>>> {
    let (scanner, views) = scan.read_as(&convention, offset);
    let (left_out, kept): (Vec<usize>, Vec<usize>) = (0..views.len()).partition(|view| view % FOLDS == fold);
    let left_out = views.select(&left_out);
    let mut differences = left_out.images;
    // A detector that is moved off the volume's projection predicts nothing.
    if scanner.validate().is_ok() {
        let (projector, volume) = reconstruct(&scanner, &views.select(&kept))?;
        differences -= &projector
            .forward(Trajectory { angles: &left_out.angles, poses: left_out.poses.as_deref() }, volume.values.view())?;
    }
    Ok(differences.outer_iter().map(by_tiles).collect())
}

/// The sums of squares in equal tiles of an image.
fn by_tiles(image: ArrayView2<'_, f32>) -> Vec<f64> {
    let (rows, columns) = image.dim();
    let part = |i: usize, n: usize| i * n / BANDS..(i + 1) * n / BANDS;
    let tile = |i: usize| {
        let columns = part(i % BANDS, columns);
        let pixels = part(i / BANDS, rows).flat_map(|row| columns.clone().map(move |column| (row, column)));
        square(&pixels.map(|pixel| image[pixel]).collect::<Vec<_>>())
    };
    (0..BANDS * BANDS).map(tile).collect()
}

/// A volume after some passes of SART with non-negative densities, and its projector.
pub(super) fn reconstruct(scanner: &Scanner, views: &Projections) -> Result<(VoxelProjector, Volume)> {
    let projector = VoxelProjector::new(scanner, RayModel::Joseph)?;
    let settings = SartSettings { iterations: PASSES, order: Order::AngularDistance, ..SartSettings::default() };
    let volume = sart::<f32>(&projector, views, &settings, &mut |_| ControlFlow::Continue(()))?;
    Ok((projector, volume))
}

fn square(values: &[f32]) -> f64 {
    reduce::sum_by(values.len(), &|i| f64::from(values[i]) * f64::from(values[i]))
}
