//! The iterative methods on voxels and the networks, with what is chosen for them by views held out.

use super::checkpoint::{Checkpoint, Checkpoints, VoxelCheckpoint, chooses};
use super::{Observe, Progress};
use crate::classical::VoxelProjector;
use crate::classical::algebraic::{
    AsdPocsSettings, Choice, Passes, SartSettings, Trial, TvSettings, VoxelRun, VoxelState,
};
use crate::config::{Method, Plan};
use crate::error::{Error, Result, start_again};
use crate::geometry::Volume;
use crate::scan::Dataset;
use crate::train::unit_of;
use trgs_methods::internals::{self, Iterative, choose_passes, choose_weight};

/// What an iterative method found.
pub(super) struct Found {
    pub(super) volume: Volume,
    /// What was chosen by views held out.
    pub(super) choice: Option<Choice>,
    /// Attenuation per scene unit that counted as 1.
    pub(super) unit: Option<f64>,
}

/// The volume that an iterative method finds, and what was chosen for it.
pub(super) fn iterate(
    dataset: &Dataset,
    config: &Plan,
    checkpoints: Option<Checkpoints>,
    observe: &mut Observe<'_>,
) -> Result<Found> {
    let projector = VoxelProjector::new(&dataset.scanner, config.algebraic.rays)?;
    let has_unit = config.method == Method::AsdPocs || config.method.is_network();
    let unit = has_unit.then(|| unit_of(dataset, config)).transpose()?;
    // The state of volumes in slabs is in no checkpoint.
    let in_memory = config.division().slabs == 1;
    let (file, from) = checkpoints.map_or((None, None), |c| (in_memory.then_some(c.file), c.from));
    let begin =
        |choice: Option<&Choice>, state: Option<&VoxelState>| begin(&projector, dataset, config, unit, choice, state);
    let (mut run, choice, mut saved) = match from {
        Some(Checkpoint::Voxels(mut saved)) => {
            saved.check(dataset, config)?;
            saved.results.clear();
            for pass in &saved.passes {
                stop(observe(Progress::Pass(pass)).is_break(), pass.iteration, true)?;
            }
            let run = begin(saved.choice.as_ref(), Some(&std::mem::take(&mut saved.state)))?;
            (run, saved.choice.clone(), Some(*saved))
        }
        Some(Checkpoint::Primitives(_)) => {
            let expected = "one of a method on voxels";
            return Err(Error::invalid("checkpoint", "one of primitives", expected, start_again()));
        }
        None => {
            let choice = choose(&projector, dataset, config, observe)?;
            let run = begin(choice.as_ref(), None)?;
            let saved = file.as_ref().map(|_| VoxelCheckpoint::new(dataset, config, choice.clone()));
            (run, choice, saved)
        }
    };
    while !run.is_finished() {
        // Without a pass, nothing is left to do; the last state is written below.
        let Some(pass) = run.step()? else { break };
        let ends = observe(Progress::Pass(&pass)).is_break();
        let iteration = pass.iteration;
        if let (Some(saved), Some(file)) = (&mut saved, &file) {
            saved.passes.push(pass);
            if ends || iteration.is_multiple_of(config.checkpoint_every) {
                saved.write(file, run.state())?;
            }
        }
        stop(ends, iteration, file.is_some())?;
    }
    if let (Some(saved), Some(file)) = (&mut saved, &file) {
        saved.write(file, run.state())?;
    }
    Ok(Found { volume: run.into_volume()?, choice, unit })
}

/// Chooses the number of passes or the weight of the total variation on views held out, if that is asked for.
fn choose(
    projector: &VoxelProjector,
    dataset: &Dataset,
    config: &Plan,
    observe: &mut Observe<'_>,
) -> Result<Option<Choice>> {
    let mut watch = |key: &str, trial: Option<&Trial>| observe(Progress::Choosing(key, trial));
    let passes = match config.method {
        _ if chooses(config).is_none() => return Ok(None),
        Method::Tv => {
            let (views, division) = (&dataset.train, config.division());
            return choose_weight(config.precision, projector, views, &config.tv(), division, &mut watch).map(Some);
        }
        Method::Cgls => Passes::Cgls(config.iterations),
        _ => Passes::Sart(config.sart()),
    };
    choose_passes(config.precision, projector, &dataset.train, passes, &mut watch).map(Some)
}

/// A run with what was chosen, from the beginning or from a state.
fn begin<'a>(
    projector: &'a VoxelProjector,
    dataset: &'a Dataset,
    config: &Plan,
    unit: Option<f64>,
    choice: Option<&Choice>,
    state: Option<&VoxelState>,
) -> Result<Box<dyn VoxelRun + 'a>> {
    let unit = unit.unwrap_or(1.0);
    let begin = |method: &Iterative| internals::begin(method, config.precision, projector, &dataset.train, state);
    let passes = choice.map_or(config.iterations, |choice| choice.value as usize);
    match config.method {
        _ if config.method.is_network() => begin(&Iterative::Network(&config.neural(), unit)),
        Method::Tv => {
            let weight = choice.map_or(config.tv().weight, |choice| choice.value);
            begin(&Iterative::Tv(&TvSettings { weight, ..config.tv() }, None, config.division()))
        }
        Method::AsdPocs => begin(&Iterative::AsdPocs(&AsdPocsSettings { unit, ..config.asd_pocs() })),
        Method::Cgls => begin(&Iterative::Cgls(passes)),
        _ => begin(&Iterative::Sart(&SartSettings { iterations: passes, ..config.sart() })),
    }
}

/// The error of a run that is stopped.
fn stop(is_wanted: bool, step: usize, is_saved: bool) -> Result<()> {
    if is_wanted { Err(Error::interrupted(step, is_saved)) } else { Ok(()) }
}
