//! The checkpoint of a run: its state, its configuration and the digest of its data.

use super::record::Record;
use super::state::State;
use crate::classical::algebraic::Choice;
use crate::config::{Config, Sampling};
use crate::error::{Error, Result, start_again};
use crate::output::create_folder;
use crate::scan::Dataset;
use crate::scan::digest::digest_numbers;
use crate::sealed::{self, Kind, Sealed, are_finite, require};
use crate::setting::Text;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Most iterations of a finish that a pilot run tries.
pub(crate) const MOST_ITERATIONS: usize = 200;

/// The state of a run, with its configuration and the digest of its data.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Checkpoint {
    /// All keys, TOML.
    config: String,
    /// Digest of scanner, angles and training projections.
    data: String,
    pub(super) state: State,
    /// What a pilot run decided, with the configuration's `sampling`, `finish` and `tv`.
    pub(super) decision: Option<Decision>,
    /// Digests of the results of a finished run, by file; empty until they are written. The last field, which is replaced.
    results: BTreeMap<String, String>,
}

/// What a pilot run decided about the steps after training.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Decision {
    /// Iterations of the run that it was made for.
    pub iterations: usize,
    /// How the volume is sampled.
    pub sampling: Sampling,
    /// Held-out errors with point samples and with the interpolant, where both were tried.
    pub errors: Option<[f64; 2]>,
    /// Weight and iterations of the finish.
    pub finish: Choice,
}

/// The file of a run's checkpoints, and the checkpoint to resume from.
#[derive(Debug)]
pub struct Checkpoints {
    /// The file; its folder is created.
    pub file: PathBuf,
    /// The checkpoint to resume from.
    pub from: Option<Checkpoint>,
}

impl Checkpoint {
    /// `data` is the [`digest`] of the run's dataset.
    pub(super) fn new(config: &Config, data: String, state: State, decision: Option<Decision>) -> Self {
        Self { config: config.to_toml(), data, state, decision, results: BTreeMap::new() }
    }

    /// Adds the decision of a pilot run to the file of a run of `config` whose training is done.
    pub(crate) fn decide(path: &Path, config: &Config, decision: Decision) -> Result<()> {
        let mut checkpoint = Self::read(path)?;
        (checkpoint.config, checkpoint.decision) = (config.to_toml(), Some(decision));
        checkpoint.write(path)
    }

    /// What a pilot run decided, if a run of `config` keeps it: with the same settings of the steps after training.
    pub fn decision(&self, config: &Config) -> Option<&Decision> {
        let saved = self.config().ok()?;
        let settings = |config: &Config| (config.sampling, config.finish, config.tv.clone());
        self.decision.as_ref().filter(|_| settings(&saved) == settings(config))
    }

    /// Forgets the decision of a pilot run, so that the run makes another one.
    pub fn forget_decision(&mut self) {
        self.decision = None;
        self.results.clear();
    }

    /// Digests of the results of a finished run, by file.
    pub fn results(&self) -> &BTreeMap<String, String> {
        &self.results
    }

    /// Reads a checkpoint.
    ///
    /// # Errors
    /// [`Error::Read`], or [`Error::Format`] for a file that is none of primitives, is damaged or does not fit itself.
    pub fn read(path: impl AsRef<Path>) -> Result<Self> {
        let path = path.as_ref();
        let file = sealed::open(path)?;
        let is_own = file.kind == Kind::Primitives;
        require(is_own, "checkpoint", "one of voxels", "one of primitives").map_err(|error| error.in_file(path))?;
        Self::decode(&file, path)
    }

    /// Decodes a checkpoint and checks it.
    pub(crate) fn decode(file: &Sealed, path: &Path) -> Result<Self> {
        let checkpoint: Self = file.decode(path)?;
        checkpoint.check_content().map_err(|error| error.in_file(path))?;
        Ok(checkpoint)
    }

    fn check_content(&self) -> Result<()> {
        let config = self.config()?;
        config.validate()?;
        require(config.method.fits_primitives(), "method of the checkpoint", "another", "one that fits primitives")?;
        let ranged = self.decision.as_ref().is_none_or(|decision| {
            let fewer = |n: usize| n <= MOST_ITERATIONS || config.tv.finish_iterations.fixed() == Some(n);
            let Decision { sampling, errors, finish, .. } = decision;
            *sampling != Sampling::Auto
                && finish.is_valid()
                && finish.iterations.is_none_or(fewer)
                && errors.as_ref().is_none_or(are_finite)
        });
        require(ranged, "decision of the pilot run", "another", "finite numbers of the settings")?;
        self.state.check(&config)
    }

    /// Writes it as a whole or not at all; missing folders are created, and removed again if it cannot be written.
    ///
    /// # Errors
    /// [`Error::Write`].
    pub fn write(&self, path: impl AsRef<Path>) -> Result<()> {
        let path = path.as_ref();
        let folders = path.ancestors().skip(1).take_while(|folder| !folder.as_os_str().is_empty());
        let missing: Vec<&Path> = folders.take_while(|folder| !folder.exists()).collect();
        let written = path.parent().map_or(Ok(()), create_folder);
        let written = written.and_then(|()| sealed::write(path, Kind::Primitives, self));
        if written.is_err() {
            // Only empty folders are removed: others are in use by now.
            missing.into_iter().for_each(|folder| drop(std::fs::remove_dir(folder)));
        }
        written
    }

    /// The records of the iterations done.
    pub fn log(&self) -> &[Record] {
        &self.state.log
    }

    /// Iterations done.
    pub fn iteration(&self) -> usize {
        self.state.iteration
    }

    /// The configuration of its run.
    ///
    /// # Errors
    /// When it is not one of this version.
    pub fn config(&self) -> Result<Config> {
        config_of(&self.config)
    }

    /// Makes it the state of a run of `iterations`, which are more than those done.
    ///
    /// From here on, everything that depends on the length of the run (learning rates, the phases of the sampler and of
    /// density control) is that of a run of `iterations`. Intervals between steps, such as `confidence.every`, stay. The
    /// result has the same bits for any number of threads and after any interruption. It is that of a run of `iterations`
    /// from its start, up to the rounding of rates, only where no setting depends on the length: constant rates, an
    /// `optimiser.horizon` of 1, at most `optimiser.longest` iterations, and phases that begin at 0 and end at 1.
    ///
    /// # Errors
    /// When as many iterations are done, unless the run has this number already.
    pub fn extend(&mut self, iterations: usize) -> Result<()> {
        let mut config = self.config()?;
        if iterations == config.iterations {
            return Ok(());
        }
        check_extension(iterations, self.iteration())?;
        config.iterations = iterations;
        self.config = config.to_toml();
        self.results.clear();
        self.state.continued.push(self.state.iteration);
        Ok(())
    }

    /// Rejects another configuration. Settings of the steps after training may differ: `sampling`, `finish` and the table
    /// `tv`.
    ///
    /// # Errors
    /// [`Error::Invalid`] with the first key that differs.
    pub fn check_config(&self, config: &Config) -> Result<()> {
        let afterwards = (config.sampling, config.finish, config.tv.clone());
        let mut saved = self.config()?;
        (saved.sampling, saved.finish, saved.tv) = afterwards;
        let Some((key, now, then)) = config.difference(&saved) else { return Ok(()) };
        Err(Error::other_run(key, now, format!("{then}, as in the checkpoint")))
    }

    /// Rejects other projections than those of the run.
    ///
    /// # Errors
    /// [`Error::Invalid`].
    pub fn check_data(&self, dataset: &Dataset) -> Result<()> {
        check_digest(&self.data, &digest(dataset))
    }

    /// Rejects another configuration and other data.
    pub(super) fn check(&self, data: &str, config: &Config) -> Result<()> {
        self.check_config(config)?;
        check_digest(&self.data, data)
    }
}

/// The configuration that a checkpoint holds.
pub(crate) fn config_of(text: &str) -> Result<Config> {
    Config::from_toml(text).map_err(|message| {
        let remedy = "use the version of trgs that wrote it";
        Error::invalid("configuration of the checkpoint", message, "that of this version", remedy)
    })
}

/// Rejects another digest of the projections than a checkpoint holds.
pub(crate) fn check_digest(saved: &str, data: &str) -> Result<()> {
    if saved != data {
        return Err(Error::other_run("dataset", "other projections", "those of the checkpoint"));
    }
    Ok(())
}

/// Rejects no more iterations than are done.
pub(crate) fn check_extension(iterations: usize, done: usize) -> Result<()> {
    if iterations > done {
        return Ok(());
    }
    let remedy = "ask for more, such as " + Text::set("iterations", 2 * done) + ", or " + start_again();
    Err(Error::invalid("iterations", iterations, format!("more than {done}, which are done"), remedy))
}

/// Digest of all that a run takes from its dataset.
pub(crate) fn digest(dataset: &Dataset) -> String {
    let projections = dataset.train.images.as_standard_layout();
    let description =
        format!("{:?} {:?}{}", dataset.scanner, dataset.train.angles, dataset.train.trajectory().digest_text());
    digest_numbers(&description, projections.as_slice().expect("standard layout"))
}
