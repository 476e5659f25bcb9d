//! The iterative methods on voxels, with what is chosen for them by views held out.

use super::checkpoint::{Checkpoint, Checkpoints, VoxelCheckpoint};
use super::{Observe, Progress};
use crate::classical::algebraic::{
    AsdPocsSettings, Choice, Pass, Passes, Trial, TvRun, TvSettings, asd_pocs, cgls, choose_passes, choose_weight, sart,
};
use crate::classical::{VoxelProjector, density_unit};
use crate::config::{Auto, Config, Method};
use crate::error::{Error, Result, start_again};
use crate::numeric::Real;
use crate::scene::{Dataset, Volume};

/// What an iterative method found.
pub(super) struct Found {
    pub(super) volume: Volume,
    /// What was chosen by views held out.
    pub(super) choice: Option<Choice>,
    /// Attenuation per scene unit that counted as 1.
    pub(super) unit: Option<f64>,
}

/// The volume that an iterative method finds, and what was chosen for it.
pub(super) fn iterate<R: Real>(
    dataset: &Dataset,
    config: &Config,
    checkpoints: Option<Checkpoints>,
    observe: &mut Observe<'_>,
) -> Result<Found> {
    let projector = VoxelProjector::new(&dataset.scanner, config.algebraic.rays)?;
    if config.method == Method::Tv {
        let (volume, choice) = total_variation::<R>(&projector, dataset, config, checkpoints, observe)?;
        return Ok(Found { volume, choice, unit: None });
    }
    let passes = match config.method {
        Method::Cgls => Some(Passes::Cgls(config.iterations)),
        Method::Sart | Method::OsSart => Some(Passes::Sart(config.sart())),
        _ => None,
    };
    let choice = match passes.filter(|_| config.algebraic.auto) {
        Some(passes) => {
            let mut watch = |key: &str, trial: Option<&Trial>| observe(Progress::Choosing(key, trial));
            Some(choose_passes::<R>(&projector, &dataset.train, passes, &mut watch)?)
        }
        None => None,
    };
    let iterations = choice.as_ref().map_or(config.iterations, |choice| choice.value as usize);
    let config = Config { iterations, ..config.clone() };
    let unit = match (config.method, config.density_unit) {
        (Method::AsdPocs, Auto::Auto) => Some(density_unit(&dataset.scanner, &dataset.train)?),
        (Method::AsdPocs, Auto::Fixed(unit)) => Some(unit),
        _ => None,
    };
    let mut observe = |pass: &Pass| observe(Progress::Pass(pass));
    let volume = match config.method {
        Method::AsdPocs => {
            let settings = AsdPocsSettings { unit: unit.unwrap_or(1.0), ..config.asd_pocs() };
            asd_pocs::<R>(&projector, &dataset.train, &settings, &mut observe)
        }
        Method::Cgls => cgls::<R>(&projector, &dataset.train, config.iterations, &mut observe),
        _ => sart::<R>(&projector, &dataset.train, &config.sart(), &mut observe),
    };
    Ok(Found { volume: volume?, choice, unit })
}

/// The method tv: its weight first, if that is to be found, then its iterations.
fn total_variation<R: Real>(
    projector: &VoxelProjector,
    dataset: &Dataset,
    config: &Config,
    checkpoints: Option<Checkpoints>,
    observe: &mut Observe<'_>,
) -> Result<(Volume, Option<Choice>)> {
    let (file, from) = checkpoints.map_or((None, None), |c| (Some(c.file), c.from));
    let settings = |choice: &Option<Choice>| match choice {
        Some(choice) => TvSettings { weight: choice.value, ..config.tv() },
        None => config.tv(),
    };
    let (mut run, mut saved) = match from {
        Some(Checkpoint::Voxels(saved)) => {
            saved.check(dataset, config)?;
            for pass in &saved.passes {
                stop(observe(Progress::Pass(pass)).is_break(), pass.iteration, true)?;
            }
            (TvRun::<R>::resume(projector, &dataset.train, &settings(&saved.choice), &saved.state)?, *saved)
        }
        Some(Checkpoint::Primitives(_)) => {
            let expected = "one of the method tv";
            return Err(Error::invalid("checkpoint", "one of primitives", expected, start_again()));
        }
        None => {
            let choice = match config.tv.weight.fixed() {
                Some(_) => None,
                None => {
                    let mut watch = |key: &str, trial: Option<&Trial>| observe(Progress::Choosing(key, trial));
                    Some(choose_weight::<R>(projector, &dataset.train, &config.tv(), &mut watch)?)
                }
            };
            let run = TvRun::<R>::new(projector, &dataset.train, &settings(&choice), None)?;
            let saved = VoxelCheckpoint::new(dataset, config, choice, run.state());
            (run, saved)
        }
    };
    while !run.is_finished() {
        let pass = run.step()?;
        let ends = observe(Progress::Pass(&pass)).is_break();
        saved.passes.push(pass);
        let iteration = saved.passes.len();
        if let Some(file) = file.as_ref().filter(|_| ends || iteration.is_multiple_of(config.checkpoint_every)) {
            saved.state = run.state();
            saved.write(file)?;
        }
        stop(ends, iteration, file.is_some())?;
    }
    Ok((run.volume()?, saved.choice))
}

/// The error of a run that is stopped.
fn stop(is_wanted: bool, step: usize, is_saved: bool) -> Result<()> {
    if is_wanted { Err(Error::interrupted(step, is_saved)) } else { Ok(()) }
}
