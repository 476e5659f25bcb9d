//! What a stopped or finished run goes on from: primitives of training, or voxels.

use crate::classical::algebraic::{Choice, Pass, VoxelState};
use crate::config::{Config, Method};
use crate::error::{Error, Result, start_again};
use crate::output::create_folder;
use crate::scan::Dataset;
use crate::sealed::{self, Kind, are_finite, require};
use crate::train::{self, Record, digest};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Where a run keeps its state, and what it goes on from.
#[derive(Debug)]
pub struct Checkpoints {
    /// The file; its folder is created.
    pub file: PathBuf,
    /// What was read from it.
    pub from: Option<Checkpoint>,
}

impl Checkpoints {
    /// Checkpoints of a run that starts from the beginning.
    pub fn new(file: impl Into<PathBuf>) -> Self {
        Self { file: file.into(), from: None }
    }

    /// Checkpoints of a run that goes on from the state in the file, or starts from the beginning if there is no file.
    ///
    /// # Errors
    /// Those of [`Checkpoint::read`].
    pub fn resume(file: impl Into<PathBuf>) -> Result<Self> {
        let file = file.into();
        let from = if file.exists() { Some(Checkpoint::read(&file)?) } else { None };
        Ok(Self { file, from })
    }
}

/// The state of a run of any method that has one.
#[derive(Clone, Debug)]
pub enum Checkpoint {
    /// Of a method that fits primitives.
    Primitives(Box<train::Checkpoint>),
    /// Of an iterative method on voxels.
    Voxels(Box<VoxelCheckpoint<'static>>),
}

/// The state of a run on voxels, with what it belongs to.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct VoxelCheckpoint<'a> {
    /// All keys, TOML.
    config: String,
    /// Digest of scanner, angles and training projections.
    data: String,
    pub(super) choice: Option<Choice>,
    /// What was shown before.
    pub(super) passes: Vec<Pass>,
    pub(super) state: VoxelState<'a>,
    /// Digests of the results of a finished run, by file; empty until they are written. The last field: see
    /// [`Checkpoint::finish`].
    pub(super) results: BTreeMap<String, String>,
}

impl Checkpoint {
    /// Reads the one or the other.
    ///
    /// # Errors
    /// [`Error::Read`], or [`Error::Format`] for a file that is none, is damaged or does not fit itself.
    pub fn read(path: impl AsRef<Path>) -> Result<Self> {
        let path = path.as_ref();
        let file = sealed::open(path)?;
        match file.kind {
            Kind::Primitives => train::Checkpoint::decode(&file, path).map(|found| Self::Primitives(Box::new(found))),
            Kind::Voxels => {
                let found: VoxelCheckpoint<'_> = file.decode(path)?;
                found.check_content().map_err(|error| error.in_file(path))?;
                Ok(Self::Voxels(Box::new(found)))
            }
        }
    }

    /// Digests of the results of a finished run, by file; empty for the state of an unfinished one.
    pub fn results(&self) -> &BTreeMap<String, String> {
        match self {
            Self::Primitives(checkpoint) => checkpoint.results(),
            Self::Voxels(checkpoint) => &checkpoint.results,
        }
    }

    /// Writes the last checkpoint of a run, which is finished, as `to` with the digests of its results.
    ///
    /// # Errors
    /// [`Error::Format`] if another program has changed `last`, [`Error::Read`] and [`Error::Write`].
    pub fn finish(last: &Path, to: &Path, results: &BTreeMap<String, String>) -> Result<()> {
        sealed::write_with_last(last, to, results)
    }

    /// The records of a run on primitives. Those of a run on voxels are reported again when it goes on.
    pub fn log(&self) -> &[Record] {
        match self {
            Self::Primitives(checkpoint) => checkpoint.log(),
            Self::Voxels(_) => &[],
        }
    }

    /// Whether a run of `config` that goes on from it chooses nothing on held-out views any more.
    pub fn is_decided(&self, config: &Config) -> bool {
        match self {
            Self::Primitives(checkpoint) => checkpoint.decision(config).is_some(),
            Self::Voxels(_) => true,
        }
    }

    /// Refuses other projections than those of the run.
    ///
    /// # Errors
    /// [`Error::Invalid`].
    pub fn check_data(&self, dataset: &Dataset) -> Result<()> {
        match self {
            Self::Primitives(checkpoint) => checkpoint.check_data(dataset),
            Self::Voxels(checkpoint) => checkpoint.check_data(dataset),
        }
    }

    /// Iterations done.
    pub fn iteration(&self) -> usize {
        match self {
            Self::Primitives(checkpoint) => checkpoint.iteration(),
            Self::Voxels(checkpoint) => checkpoint.state.iteration(),
        }
    }

    /// The configuration of its run.
    ///
    /// # Errors
    /// When it is not one of this version.
    pub fn config(&self) -> Result<Config> {
        match self {
            Self::Primitives(checkpoint) => checkpoint.config(),
            Self::Voxels(checkpoint) => checkpoint.config(),
        }
    }

    /// Makes it the state of a run of `iterations`, which are more than those done: a finished run goes on.
    ///
    /// A method on voxels ends with the bits of a run that had `iterations` from its start. For a method that fits
    /// primitives see [`train::Checkpoint::extend`]: the schedule is that of the longer run from here on.
    ///
    /// # Errors
    /// When as many iterations are done, unless the run has this number already, or when the number was chosen on held-out
    /// views.
    pub fn extend(&mut self, iterations: usize) -> Result<()> {
        match self {
            Self::Primitives(checkpoint) => checkpoint.extend(iterations),
            Self::Voxels(checkpoint) => checkpoint.extend(iterations),
        }
    }

    /// Refuses another configuration.
    ///
    /// # Errors
    /// [`Error::Invalid`] with the first key that differs.
    pub fn check_config(&self, config: &Config) -> Result<()> {
        match self {
            Self::Primitives(checkpoint) => checkpoint.check_config(config),
            Self::Voxels(checkpoint) => checkpoint.check_config(config),
        }
    }
}

impl VoxelCheckpoint<'_> {
    /// Without a state yet.
    pub(super) fn new(dataset: &Dataset, config: &Config, choice: Option<Choice>) -> Self {
        let (config, data) = (config.to_toml(), digest(dataset));
        Self { config, data, choice, passes: Vec::new(), state: VoxelState::default(), results: BTreeMap::new() }
    }

    /// Writes it with the state of a run, as a whole or not at all.
    pub(super) fn write(&self, path: &Path, state: VoxelState<'_>) -> Result<()> {
        path.parent().map_or(Ok(()), create_folder)?;
        let Self { config, data, choice, passes, state: _, results } = self.clone();
        sealed::write(path, Kind::Voxels, &VoxelCheckpoint { config, data, choice, passes, state, results })
    }

    fn config(&self) -> Result<Config> {
        train::config_of(&self.config)
    }

    /// Rejects what no run has, as far as it does not depend on the dataset: the method checks its numbers and arrays.
    fn check_content(&self) -> Result<()> {
        let config = self.config()?;
        config.validate()?;
        let is_iterative = !config.method.fits_primitives() && config.method != Method::Fdk;
        require(is_iterative, "method of the checkpoint", "another", "one on voxels, or a network")?;
        let done = self.state.iteration();
        require(done <= config.iterations, "iterations done", done, "no more than the run has")?;
        let of = |(k, pass): (usize, &Pass)| {
            let numbers = [Some(pass.residual), pass.objective, pass.change];
            pass.iteration == k + 1 && pass.iterations <= config.iterations && are_finite(numbers.iter().flatten())
        };
        let passes = self.passes.len() == done && self.passes.iter().enumerate().all(of);
        require(passes, "residuals", "others", "a finite one for each iteration done")?;
        let chosen = self.choice.as_ref().map(|choice| choice.key.as_str());
        require(chosen == chooses(&config), "choice", format!("{chosen:?}"), "that of the method's settings")?;
        let most = if chosen == Some("passes") { config.iterations as f64 } else { f64::INFINITY };
        let ranged = self.choice.as_ref().is_none_or(|choice| choice.is_valid() && choice.value <= most);
        require(ranged, "choice", "another", "positive numbers with their errors")?;
        require(self.state.is_finite(), "state", "another", "finite numbers")
    }

    fn extend(&mut self, iterations: usize) -> Result<()> {
        let mut config = self.config()?;
        if iterations == config.iterations {
            return Ok(());
        }
        if config.algebraic.auto {
            let expected = format!("{}, as algebraic.auto chose the number of passes among so many", config.iterations);
            return Err(Error::invalid("iterations", iterations, expected, start_again()));
        }
        train::check_extension(iterations, self.state.iteration())?;
        config.iterations = iterations;
        self.config = config.to_toml();
        self.results.clear();
        self.passes.iter_mut().for_each(|pass| pass.iterations = iterations);
        Ok(())
    }

    fn check_config(&self, config: &Config) -> Result<()> {
        let Some((key, now, then)) = config.difference(&self.config()?) else { return Ok(()) };
        Err(Error::other_run(key, now, format!("{then}, as in the checkpoint")))
    }

    /// Refuses another configuration and other data.
    pub(super) fn check(&self, dataset: &Dataset, config: &Config) -> Result<()> {
        self.check_config(config)?;
        self.check_data(dataset)
    }

    fn check_data(&self, dataset: &Dataset) -> Result<()> {
        train::check_digest(&self.data, &digest(dataset))
    }
}

/// The setting that a method on voxels chooses by views held out.
pub(super) fn chooses(config: &Config) -> Option<&'static str> {
    match config.method {
        Method::Tv if config.tv.weight.fixed().is_none() => Some("tv.weight"),
        Method::Cgls | Method::Sart | Method::OsSart if config.algebraic.auto => Some("passes"),
        _ => None,
    }
}

#[cfg(test)]
mod tests;
