//! From the volume of fitted primitives to one that its own projections fit to the scan: iterations of least squares with
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
//! so that the residual of x₀ is that of the primitives, `p' - A x₀ = p - F`. The correction holds near x₀ alone,
//! so the weight has a lower bound. The result is a mixture of both volumes, `x₀ + s·(x - x₀)`. `super::pilot` chooses weight,
//! iterations and share; without it fixed rules do, and the share is 1.

use super::{Observe, Progress, project};
use crate::classical::VoxelProjector;
use crate::classical::algebraic::{Choice, Trial, TvSettings};
use crate::config::{Config, Plan, Sampling};
use crate::error::{Error, Result};
use crate::geometry::{Projections, Scanner, Volume};
use crate::primitives::Primitives;
use crate::scan::Dataset;
use crate::setting::Text;
use std::borrow::Cow;
use trgs_methods::internals::{Iterative, begin, choose_weight};

/// Without a pilot run: part of the weight that held-out views ask for where the volume is an interpolant. Its start is
/// smooth already.
const PART: f64 = 0.25;
/// Least weight where the projections are corrected: views held out are judged without the correction, and ask for too little.
pub(super) const LEAST: f64 = 2e-3;
/// Without a pilot run: iterations at most.
const ITERATIONS: usize = 20;
/// Without a pilot run: iterations, from zeros, after which each weight is judged.
const JUDGED_AFTER: usize = 40;
/// Fewest iterations where the projections are corrected. Without a pilot run the finish may end from then on, when the
/// last [`WINDOW`] iterations have lowered the residual by less than [`FALL`]: the correction is used up.
pub(super) const SHORTEST: usize = 10;
const WINDOW: usize = 5;
const FALL: f64 = 0.01;

/// What a finish starts from.
pub(super) struct Start<'a> {
    /// The fitted primitives.
    pub(super) primitives: &'a Primitives,
    /// Their volume.
    pub(super) volume: &'a Volume,
    /// How it was sampled.
    pub(super) sampling: Sampling,
    /// What a pilot run chose.
    pub(super) chosen: Option<Choice>,
}

/// The finished volume, and the weight of the total variation if it was chosen on held-out views.
///
/// # Errors
/// As [`crate::classical::algebraic::tv()`], and [`Error::Interrupted`] when `observe` breaks.
pub(super) fn finish(
    dataset: &Dataset,
    start: Start<'_>,
    config: &Plan,
    observe: &mut Observe<'_>,
) -> Result<(Volume, Option<Choice>)> {
    let Start { primitives, volume, sampling, chosen } = start;
    let projector = VoxelProjector::new(&dataset.scanner, config.algebraic.rays)?;
    let (settings, choice, may_end) = match chosen {
        Some(choice) if config.has_open_finish() => {
            let iterations = choice.iterations.unwrap_or(ITERATIONS);
            (TvSettings { weight: choice.value, iterations, ..config.tv() }, Some(choice), false)
        }
        _ => by_rule(dataset, &projector, sampling, config, observe)?,
    };
    let target = target(&dataset.train, &dataset.scanner, primitives, volume, sampling, &projector, config)?;
    let tv = Iterative::Tv(&settings, Some(volume), config.division());
    let mut run = begin(&tv, config.precision, &projector, &target, None)?;
    let mut residuals = Vec::new();
    while !run.is_finished() {
        let Some(pass) = run.step()? else { break };
        if observe(Progress::Pass(&pass)).is_break() {
            return Err(Error::Interrupted { step: pass.iteration, remedy: Text::default() });
        }
        residuals.push(pass.residual);
        let done = residuals.len();
        if may_end && done >= SHORTEST && pass.residual > (1.0 - FALL) * residuals[done - 1 - WINDOW] {
            break;
        }
    }
    let share = choice.as_ref().and_then(|choice| choice.share).unwrap_or(config.tv.share.or(1.0)) as f32;
    let mut finished = run.into_volume()?;
    finished.values.zip_mut_with(&volume.values, |value, &before| {
        // The finish starts from values that are not negative.
        let before = before.max(0.0);
        *value = if share < 1.0 { before + share * (*value - before) } else { *value };
    });
    Ok((finished, choice))
}

/// Settings without a pilot run, the choice of the weight, and whether the finish may end by its residual.
fn by_rule(
    dataset: &Dataset,
    projector: &VoxelProjector,
    sampling: Sampling,
    config: &Plan,
    observe: &mut Observe<'_>,
) -> Result<(TvSettings, Option<Choice>, bool)> {
    let interpolated = sampling == Sampling::Interpolant;
    let iterations = config.tv.finish_iterations.or(ITERATIONS);
    let mut settings = TvSettings { iterations, ..config.tv() };
    let may_end = !interpolated && config.tv.finish_iterations.fixed().is_none();
    if config.tv.weight.fixed().is_some() {
        return Ok((settings, None, may_end));
    }
    let mut watch = |key: &str, trial: Option<&Trial>| observe(Progress::Choosing(key, trial));
    let judged = TvSettings { iterations: JUDGED_AFTER, tolerance: 0.0, ..config.tv() };
    let chosen = choose_weight(config.precision, projector, &dataset.train, &judged, config.division(), &mut watch)?;
    settings.weight = if interpolated { PART * chosen.value } else { chosen.value.max(LEAST) };
    Ok((settings, Some(chosen), may_end))
}

/// What voxels are fitted to, which start at `volume`: the views as measured, or the projections p' of the [module](self).
pub(super) fn target<'a>(
    views: &'a Projections,
    scanner: &Scanner,
    primitives: &Primitives,
    volume: &Volume,
    sampling: Sampling,
    projector: &VoxelProjector,
    config: &Config,
) -> Result<Cow<'a, Projections>> {
    if sampling == Sampling::Interpolant {
        return Ok(Cow::Borrowed(views));
    }
    let of_primitives = project(primitives, scanner, views.trajectory(), config)?;
    let of_voxels = projector.forward::<f32>(views, volume.values.view())?;
    let images = &views.images - &of_primitives.images + &of_voxels;
    Projections::along(views.trajectory(), images).map(Cow::Owned)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::classical::RayModel;
    use crate::config::{Auto, Method, Start};
    use crate::geometry::{Beam, Detector, Grid, Scanner};
    use crate::reconstruction::reconstruct;
    use crate::scan::simulate::{Object, Plan, simulate};
    use crate::scan::{Noise, Phantom};
    use crate::tolerances::largest;

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
        let sampling = Sampling::Point;
        let target = target(&scan.train, &scanner, &primitives, &volume, sampling, &projector, &config).unwrap();
        let of_voxels = projector.forward::<f32>(&scan.train, volume.values.view()).unwrap();
        let of_primitives = project(&primitives, &scanner, scan.train.trajectory(), &config).unwrap();
        let size = scan.train.images.iter().fold(0.0, |most: f32, value| most.max(value.abs()));
        let (voxels, fitted) = (&target.images - &of_voxels, &scan.train.images - &of_primitives.images);
        within!(largest(&voxels - &fitted) / f64::from(size));
        beyond!("fitted", largest(fitted) / f64::from(size));
        assert!(found.volume != volume);
        // Half of both volumes.
        config.tv.share = Auto::Fixed(0.5);
        (config.tv.weight, config.tv.finish_iterations) = (Auto::Fixed(2e-3), Auto::Fixed(10));
        let half = reconstruct(&scan, &config).unwrap().volume.values;
        config.tv.share = Auto::Fixed(1.0);
        let whole = reconstruct(&scan, &config).unwrap().volume.values;
        let mean = (whole + volume.values.mapv(|value| value.max(0.0))) / 2.0;
        within!("share", largest(half - mean));
    }
}
