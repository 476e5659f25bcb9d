//! Prediction error of views that were held out of a reconstruction.

use super::Convention;
use super::offsets::Place;
use super::reduced::Reduced;
use crate::classical::algebraic::{Order, SartSettings, sart};
use crate::classical::{RayModel, VoxelProjector};
use crate::error::Result;
use crate::numeric::{reduce, threads};
use crate::scene::{Projections, Scanner, Trajectory, Volume};
use std::ops::ControlFlow;

/// Number of parts of the views that are held out in turn.
const FOLDS: usize = 3;
/// SART passes: a third pass changes neither ranks nor minima.
const PASSES: usize = 2;

/// A convention, and the place of detector and axis.
pub(super) type Hypothesis = (Convention, Place);

/// The squared residual of each held-out view, and the sum of squares of the measured values.
#[derive(Clone, Debug)]
pub(super) struct HeldOut {
    pub(super) residuals: Vec<f64>,
    measured: f64,
}

impl HeldOut {
    /// `‖A x - p‖/‖p‖` over all views, each with the x reconstructed without it.
    pub(super) fn residual(&self) -> f64 {
        (reduce::sum(&self.residuals) / self.measured).sqrt()
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
    let parts: Result<Vec<Vec<f64>>> =
        threads::map(hypotheses.len() * FOLDS, |job| fold(scan, &hypotheses[job / FOLDS], job % FOLDS))
            .into_iter()
            .collect();
    let measured = square(scan.views.images.as_slice().expect("standard layout"));
    let of = |parts: &[Vec<f64>]| HeldOut {
        residuals: (0..views).map(|view| parts[view % FOLDS][view / FOLDS]).collect(),
        measured,
    };
    Ok(parts?.chunks_exact(FOLDS).map(of).collect())
}

/// The squared residuals of every third view, with x from the others.
fn fold(scan: &Reduced, &(convention, offset): &Hypothesis, fold: usize) -> Result<Vec<f64>> {
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
    let differences = differences.as_slice().expect("standard layout");
    Ok(differences.chunks_exact(scanner.detector.pixels()).map(square).collect())
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
