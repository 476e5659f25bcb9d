//! From the volume of fitted primitives to one that its own projections fit to the scan: a few steps of least squares with
//! total variation on voxels. Not in the paper.
//!
//! Voxels of an interpolated volume project as the scan does, so the scan is what they are fitted to. No voxels project as a
//! continuous object does: at its edges a fit to the scan turns the error of the model into structure. There the scan is
//! corrected by the error of the model at the start:
//!
//! ```text
//! p' = p - F + A x₀      p: the scan, F: projections of the primitives, x₀: their volume, A: projections of voxels
//! ```
//!
//! so that the residual of x₀ is that of the primitives, `p' - A x₀ = p - F`. The correction holds near x₀ alone, which is
//! why the steps are few.

use super::{Observe, Progress, project};
use crate::classical::VoxelProjector;
use crate::classical::algebraic::{Choice, Trial, TvRun, TvSettings, choose_weight};
use crate::config::{Config, Sampling};
use crate::error::{Error, Result};
use crate::numeric::Real;
use crate::primitives::Primitives;
use crate::scene::{Dataset, Projections, Volume};

/// Part of the weight that views held out ask for where the volume is an interpolant: the start is regularised already, and
/// the volume fits the projections to their noise.
const PART: f64 = 0.25;
/// Least weight where the projections are corrected: views held out are judged without the correction, and ask for too little.
const LEAST: f64 = 2e-3;
/// Iterations at most.
const ITERATIONS: usize = 20;
/// Where the projections are corrected, it ends after so many iterations when the last [`WINDOW`] of them have brought the
/// residual down by less than [`FALL`], which stands for the correction being used up.
const SHORTEST: usize = 10;
const WINDOW: usize = 5;
const FALL: f64 = 0.01;

/// The finished volume, and the weight of the total variation if it was found on views held out.
///
/// # Errors
/// As [`crate::classical::algebraic::tv()`], and [`Error::Interrupted`] when `observe` breaks.
pub(super) fn finish<R: Real>(
    dataset: &Dataset,
    primitives: &Primitives,
    volume: &Volume,
    sampled: Sampling,
    config: &Config,
    observe: &mut Observe<'_>,
) -> Result<(Volume, Option<Choice>)> {
    let projector = VoxelProjector::new(&dataset.scanner, config.algebraic.rays)?;
    let interpolated = sampled == Sampling::Interpolant;
    let iterations = config.tv.finish_iterations.or(ITERATIONS);
    let (mut settings, mut choice) = (TvSettings { iterations, ..config.tv() }, None);
    if config.tv.weight.fixed().is_none() {
        let mut watch = |key: &str, trial: Option<&Trial>| observe(Progress::Choosing(key, trial));
        let chosen = choose_weight::<R>(&projector, &dataset.train, &config.tv(), &mut watch)?;
        settings.weight = if interpolated { PART * chosen.value } else { chosen.value.max(LEAST) };
        choice = Some(chosen);
    }
    let corrected = match interpolated {
        true => None,
        false => Some(corrected(dataset, primitives, volume, &projector, config)?),
    };
    let may_end = !interpolated && config.tv.finish_iterations.fixed().is_none();
    let target = corrected.as_ref().unwrap_or(&dataset.train);
    let mut run = TvRun::<R>::new(&projector, target, &settings, Some(volume))?;
    let mut residuals = Vec::new();
    while !run.is_finished() {
        let pass = run.step()?;
        if observe(Progress::Pass(&pass)).is_break() {
            return Err(Error::Interrupted { step: pass.iteration, remedy: String::new() });
        }
        residuals.push(pass.residual);
        let done = residuals.len();
        if may_end && done >= SHORTEST && pass.residual > (1.0 - FALL) * residuals[done - 1 - WINDOW] {
            break;
        }
    }
    Ok((run.volume()?, choice))
}

/// The projections p' of the [module's](self) formula.
fn corrected(
    dataset: &Dataset,
    primitives: &Primitives,
    volume: &Volume,
    projector: &VoxelProjector,
    config: &Config,
) -> Result<Projections> {
    let train = &dataset.train;
    let of_primitives = project(primitives, dataset, &train.angles, config)?;
    let of_voxels = projector.forward::<f32>(&train.angles, volume.values.view())?;
    Projections::new(train.angles.clone(), &train.images - &of_primitives.images + &of_voxels)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::classical::RayModel;
    use crate::config::{Method, Start};
    use crate::reconstruction::reconstruct;
    use crate::scene::simulate::{Object, Plan, simulate};
    use crate::scene::{Beam, Detector, Grid, Noise, Phantom, Scanner};

    #[test]
    fn voxels_have_the_residual_of_the_primitives_to_begin_with() {
        let detector = Detector { rows: 24, columns: 24, pitch_v: 0.16, pitch_u: 0.16, offset_u: 0.0, offset_v: 0.0 };
        let scanner = Scanner { beam: Beam::Cone { dso: 5.0, dsd: 7.0 }, detector, grid: Grid::cube(16) };
        let plan = Plan { views: 8, test_views: 0, noise: Noise::None, seed: 0 };
        let phantom = Phantom::by_name("torso", 0).unwrap();
        let scan = simulate("scan", Object::Phantom(&phantom), &scanner, &plan).unwrap();
        let mut config = Config { iterations: 20, sampling: Sampling::Point, ..Config::of(Method::TrGs) };
        (config.model.points, config.initialisation.from) = (200, Start::Sart);
        let found = reconstruct(&scan, &config).unwrap();
        let (primitives, volume) = (found.primitives.unwrap(), found.unfinished.unwrap());
        let projector = VoxelProjector::new(&scanner, RayModel::Joseph).unwrap();
        let target = corrected(&scan, &primitives, &volume, &projector, &config).unwrap();
        let of_voxels = projector.forward::<f32>(&scan.train.angles, volume.values.view()).unwrap();
        let of_primitives = project(&primitives, &scan, &scan.train.angles, &config).unwrap();
        let size = scan.train.images.iter().fold(0.0, |most: f32, value| most.max(value.abs()));
        let (voxels, fitted) = (&target.images - &of_voxels, &scan.train.images - &of_primitives.images);
        assert!((&voxels - &fitted).iter().all(|value| value.abs() < 1e-6 * size));
        assert!(fitted.iter().any(|value| value.abs() > 1e-3 * size) && found.volume != volume);
    }
}
