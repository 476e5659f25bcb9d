//! Any method on any dataset: from projections to a volume, and how good that is.

mod checkpoint;
mod finish;
#[cfg(feature = "oracle")]
mod network_steps;
mod pilot;
mod run;
mod sampling;
mod voxels;

pub use checkpoint::{Checkpoint, Checkpoints, VoxelCheckpoint};
#[cfg(feature = "oracle")]
pub use network_steps::{NetworkSteps, network_steps};
pub use pilot::PILOT_PART;
pub use run::Run;
pub use sampling::{Evidence, Sampled};

use crate::classical::algebraic::{Choice, Pass, Trial};
use crate::classical::fdk;
use crate::config::{Auto, Config, Finish, Method, Plan, Precision, Sampling};
use crate::error::{Error, Result, start_again};
use crate::evaluation::Metrics;
use crate::geometry::{Projections, Scanner, Trajectory, Volume};
use crate::primitives::Primitives;
use crate::projector::forward;
use crate::scan::{Dataset, trilinear};
use crate::train::{self, Record, train};
use serde::Serialize;
use std::borrow::Cow;
use std::collections::BTreeMap;
use std::ops::ControlFlow;
use std::path::Path;

/// What a method found.
#[derive(Clone, Debug)]
pub struct Reconstruction {
    /// Missing where the method has none.
    pub primitives: Option<Primitives>,
    /// Density on the dataset's grid, attenuation per scene unit of length.
    pub volume: Volume,
    /// With the layer of `model.margin` around it, of a method without primitives: its projections are those of the scan.
    pub around: Option<Volume>,
    /// That of the primitives, where `volume` is finished on voxels.
    pub unfinished: Option<Volume>,
    /// Of a method that fits primitives.
    pub log: Vec<Record>,
    /// How the primitives became the volume; missing where the method has none.
    pub sampled: Option<Sampled>,
    /// Attenuation per scene unit that counted as 1, where the method asks.
    pub unit: Option<f64>,
    /// What was chosen by views held out, if anything was.
    pub choice: Option<Choice>,
    /// Iterations after which a run that fits primitives was given another length: see [`train::Checkpoint::extend`].
    pub continued: Vec<usize>,
}

/// How far a method has come.
#[derive(Clone, Copy, Debug)]
pub enum Progress<'a> {
    /// So many iterations on primitives are done; now and then with a record.
    Iteration(usize, Option<&'a Record>),
    /// So many iterations of the pilot run are done, which has [`PILOT_PART`] of those of the run.
    Pilot(usize, Option<&'a Record>),
    /// An iteration on voxels.
    Pass(&'a Pass),
    /// A setting of this name is being chosen; now and then with a trial.
    Choosing(&'a str, Option<&'a Trial>),
}

/// Called after every step; `Break` stops the run.
pub type Observe<'a> = dyn FnMut(Progress<'_>) -> ControlFlow<()> + 'a;

/// The metrics of a reconstruction, and why others are missing.
#[derive(Clone, Debug, Serialize)]
pub struct Evaluation {
    /// Those that the dataset allows.
    #[serde(flatten)]
    pub metrics: Metrics,
    /// Name of a metric → the reason that there is none.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    pub absent: BTreeMap<&'static str, &'static str>,
}

/// Reconstructs a dataset with the method and the settings of `config`.
///
/// `Config::default()` gives the result of the bare command `trgs reconstruct`. [`Run`] adds checkpoints and progress.
///
/// ```no_run
/// let scan = trgs::Dataset::read("scan")?;
/// let result = trgs::reconstruct(&scan, &trgs::Config::default())?;
/// trgs::write_volume("volume.nii.gz", &result.volume, &scan.frame)?;
/// # Ok::<(), trgs::Error>(())
/// ```
///
/// # Errors
/// For a setting out of its range, and those of the method.
pub fn reconstruct(dataset: &Dataset, config: &Config) -> Result<Reconstruction> {
    Run::new(dataset, config).reconstruct()
}

/// The method of a plan, with the margin around the volume.
fn reconstruct_with(
    dataset: &Dataset,
    config: &Plan,
    checkpoints: Option<Checkpoints>,
    observe: &mut Observe<'_>,
) -> Result<Reconstruction> {
    if config.model.margin == 0.0 {
        return reconstruct_whole(dataset, config, checkpoints, observe);
    }
    let around = dataset.on(config.with_margin(&dataset.scanner).grid);
    let found = reconstruct_whole(&around, config, checkpoints, observe)?;
    let inside = |volume: Volume| volume.without_margin(&dataset.scanner.grid);
    let around = found.primitives.is_none().then(|| found.volume.clone());
    Ok(Reconstruction { volume: inside(found.volume), around, unfinished: found.unfinished.map(inside), ..found })
}

/// The method of a plan, on the whole grid of the dataset.
fn reconstruct_whole(
    dataset: &Dataset,
    config: &Plan,
    checkpoints: Option<Checkpoints>,
    observe: &mut Observe<'_>,
) -> Result<Reconstruction> {
    let voxels::Found { volume, choice, unit } = match config.method {
        Method::TrGs | Method::R2Gaussian => {
            let file = checkpoints.as_ref().map(|checkpoints| checkpoints.file.clone());
            let checkpoints = checkpoints.map(of_training).transpose()?;
            let mut watch = |iteration, record: Option<&Record>| observe(Progress::Iteration(iteration, record));
            let found = train(dataset, config, checkpoints, &mut watch)?;
            return after_training(found, dataset, config, file.as_deref(), observe).map_err(|error| match error {
                Error::Interrupted { .. } => Error::interrupted(config.iterations, file.is_some()),
                other => other,
            });
        }
        Method::Fdk => {
            let volume = fdk(&dataset.scanner, &dataset.train, config.fdk.window, config.fdk.turn)?;
            voxels::Found { volume, choice: None, unit: None }
        }
        _ => voxels::iterate(dataset, config, checkpoints, observe)?,
    };
    let (log, continued) = (Vec::new(), Vec::new());
    Ok(Reconstruction {
        primitives: None,
        volume,
        around: None,
        unfinished: None,
        log,
        sampled: None,
        unit,
        choice,
        continued,
    })
}

/// The volume of trained primitives, sampled and finished as `config` has it.
///
/// A decision of a pilot run is kept in the `checkpoint`: it is made once, also when the run is continued later.
fn after_training(
    found: train::TrainedModel,
    dataset: &Dataset,
    config: &Plan,
    checkpoint: Option<&Path>,
    observe: &mut Observe<'_>,
) -> Result<Reconstruction> {
    let train::TrainedModel { primitives, volume, log, unit, continued, decision } = found;
    let asked = config;
    // The pilot run has fewer views, which would make another unit.
    let config = &config.changed(|config| config.density_unit = Auto::Fixed(unit));
    let piloted = match decision.filter(|_| config.has_pilot()) {
        Some(decision) => Some(decision.into()),
        None if config.has_pilot() => {
            let found = pilot::choose(dataset, config, observe)?;
            if let (Some(found), Some(file)) = (&found, checkpoint) {
                train::Checkpoint::decide(file, asked, found.decision(config.iterations))?;
            }
            found
        }
        None => None,
    };
    let (sampled, chosen) = match piloted {
        Some(pilot::Found { sampled, choice }) => (sampled, Some(choice)),
        None => {
            let sampling = if config.sampling == Sampling::Auto { Sampling::Point } else { config.sampling };
            (Sampled { sampling, evidence: None }, None)
        }
    };
    let mut volume = sampling::volume(volume, sampled.sampling);
    let (mut unfinished, mut choice) = (None, None);
    if config.finish == Finish::Tv {
        let start = finish::Start { primitives: &primitives, volume: &volume, sampling: sampled.sampling, chosen };
        let (finished, chosen) = finish::finish(dataset, start, config, observe)?;
        unfinished = Some(std::mem::replace(&mut volume, finished));
        choice = chosen;
    }
    let (primitives, sampled, unit) = (Some(primitives), Some(sampled), Some(unit));
    Ok(Reconstruction { primitives, volume, around: None, unfinished, log, sampled, unit, choice, continued })
}

/// The checkpoints as training takes them.
fn of_training(Checkpoints { file, from }: Checkpoints) -> Result<train::Checkpoints> {
    let from = match from {
        Some(Checkpoint::Primitives(from)) => Some(*from),
        None => None,
        Some(Checkpoint::Voxels(_)) => {
            return Err(Error::invalid("checkpoint", "one of voxels", "one of primitives", start_again()));
        }
    };
    Ok(train::Checkpoints { file, from })
}

/// Evaluates a volume, and the projections of the primitives that it came from, or where there are none its own.
///
/// The volume may have the layer of `model.margin` around it. Without the layer and primitives it has no projections to
/// compare, where `config` has a margin.
///
/// # Errors
/// When the volume does not have the shape of the truth.
pub fn evaluate(
    dataset: &Dataset,
    volume: &Volume,
    primitives: Option<&Primitives>,
    config: &Config,
) -> Result<Evaluation> {
    let mut absent = BTreeMap::new();
    let grid = &dataset.scanner.grid;
    let is_layered =
        volume.grid.shape != grid.shape && volume.grid.shape == config.with_margin(&dataset.scanner).grid.shape;
    let inside = if is_layered { Cow::Owned(volume.clone().without_margin(grid)) } else { Cow::Borrowed(volume) };
    let volumes = dataset.truth.as_ref().map(|truth| (truth, &*inside));
    if volumes.is_none() {
        absent.extend(["psnr_3d", "ssim_3d"].map(|name| (name, "the dataset has no true volume")));
    }
    let projections = match &dataset.test {
        Some(_) if config.model.margin > 0.0 && primitives.is_none() && !is_layered => {
            let reason = "the layer around the volume (model.margin), which its views show as well, is not written";
            absent.extend(["psnr_2d", "ssim_2d"].map(|name| (name, reason)));
            None
        }
        Some(test) => Some((test, reproject(dataset, test, volume, primitives, config)?)),
        None => {
            absent.extend(["psnr_2d", "ssim_2d"].map(|name| (name, "the dataset has no test views")));
            None
        }
    };
    let projections = projections.as_ref().map(|(test, seen)| (*test, seen));
    Ok(Evaluation { metrics: Metrics::compute(volumes, projections)?, absent })
}

/// Projections of a result in given views: of its primitives, or where there are none of its volume.
///
/// # Errors
/// When there is no view.
pub fn reproject(
    dataset: &Dataset,
    views: &Projections,
    volume: &Volume,
    primitives: Option<&Primitives>,
    config: &Config,
) -> Result<Projections> {
    match primitives {
        Some(primitives) => project(primitives, &dataset.scanner, views.trajectory(), config),
        None => trilinear::project(volume, &dataset.scanner, views),
    }
}

/// Projections of primitives as they were fitted.
fn project(primitives: &Primitives, scanner: &Scanner, views: Trajectory<'_>, config: &Config) -> Result<Projections> {
    let (projection, cutoff) = (config.projection, config.cutoff);
    let images = match config.precision {
        Precision::F32 => forward::<f32>(primitives, scanner, views, projection, cutoff),
        Precision::F64 => forward::<f64>(primitives, scanner, views, projection, cutoff).mapv(|value| value as f32),
    };
    Projections::along(views, images)
}
