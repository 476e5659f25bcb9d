//! From the volume of fitted primitives to one that its own interpolation fits to the projections: a few steps of least
//! squares with total variation on voxels. Not in the paper.

use super::{Observe, Progress};
use crate::classical::VoxelProjector;
use crate::classical::algebraic::{Choice, Trial, TvRun, TvSettings, choose_weight};
use crate::config::{Config, Sampling};
use crate::error::{Error, Result};
use crate::numeric::Real;
use crate::scene::{Dataset, Volume};

/// Part of the weight that views held out ask for where the volume is an interpolant: the start is regularised already, and
/// the volume fits the projections to their noise. Of a continuous object no volume does, and the whole weight is needed.
const PART: f64 = 0.25;

/// The finished volume, and the weight of the total variation if it was found on views held out.
///
/// # Errors
/// As [`crate::classical::algebraic::tv()`], and [`Error::Interrupted`] when `observe` breaks.
pub(super) fn finish<R: Real>(
    dataset: &Dataset,
    volume: &Volume,
    sampled: Sampling,
    config: &Config,
    observe: &mut Observe<'_>,
) -> Result<(Volume, Option<Choice>)> {
    let projector = VoxelProjector::new(&dataset.scanner, config.algebraic.rays)?;
    let choice = match config.tv.weight.fixed() {
        Some(_) => None,
        None => {
            let mut watch = |key: &str, trial: Option<&Trial>| observe(Progress::Choosing(key, trial));
            Some(choose_weight::<R>(&projector, &dataset.train, &config.tv(), &mut watch)?)
        }
    };
    let settings = config.tv();
    let part = if sampled == Sampling::Interpolant { PART } else { 1.0 };
    let weight = choice.as_ref().map_or(settings.weight, |choice| part * choice.value);
    let settings = TvSettings { weight, iterations: config.tv.finish_iterations, ..settings };
    let mut run = TvRun::<R>::new(&projector, &dataset.train, &settings, Some(volume))?;
    while !run.is_finished() {
        let pass = run.step()?;
        if observe(Progress::Pass(&pass)).is_break() {
            let remedy = "the primitives are saved; the same command with --resume finishes them again";
            return Err(Error::Interrupted { step: pass.iteration, remedy: remedy.into() });
        }
    }
    Ok((run.volume()?, choice))
}
