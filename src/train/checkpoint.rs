//! The checkpoint of a run: its state, its configuration and the digest of its data.

use super::state::State;
use crate::config::Config;
use crate::error::{Error, Result, start_again};
use crate::output::create_folder;
use crate::provenance::digest_parts;
use crate::scene::Dataset;
use crate::sealed::{self, Kind, Sealed, require};
use bytemuck::cast_slice;
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// The state of a run, with its configuration and the digest of its data.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Checkpoint {
    /// All keys, TOML.
    config: String,
    /// Digest of scanner, angles and training projections.
    data: String,
    pub(super) state: State,
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
    pub(super) fn new(config: &Config, data: String, state: State) -> Self {
        Self { config: config.to_toml(), data, state }
    }

    /// Reads a checkpoint.
    ///
    /// # Errors
    /// [`Error::Read`], or [`Error::Format`] for a file that is none of primitives, is damaged or does not fit itself.
    pub fn read(path: &Path) -> Result<Self> {
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
        self.state.check(&config)
    }

    /// Writes it as a whole or not at all; missing folders are created, and removed again if it cannot be written.
    ///
    /// # Errors
    /// [`Error::Write`].
    pub fn write(&self, path: &Path) -> Result<()> {
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

    /// Iterations done.
    pub fn iteration(&self) -> usize {
        self.state.iteration
    }

    /// The configuration of its run.
    ///
    /// # Errors
    /// When it is not one of this version.
    pub fn config(&self) -> Result<Config> {
        Config::from_toml(&self.config).map_err(|message| {
            let remedy = "use the version of trgs that wrote it";
            Error::invalid("configuration of the checkpoint", message, "that of this version", remedy)
        })
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
        self.state.continued.push(self.state.iteration);
        Ok(())
    }

    /// Whether the run was given another number of iterations after its start.
    pub fn is_continued(&self) -> bool {
        !self.state.continued.is_empty()
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

    /// Rejects another configuration and other data.
    pub(super) fn check(&self, data: &str, config: &Config) -> Result<()> {
        self.check_config(config)?;
        if self.data != data {
            return Err(Error::other_run("dataset", "other projections", "those of the checkpoint"));
        }
        Ok(())
    }
}

/// Rejects no more iterations than are done.
pub(crate) fn check_extension(iterations: usize, done: usize) -> Result<()> {
    if iterations > done {
        return Ok(());
    }
    let remedy = format!("ask for more, such as `iterations={}`, or {}", 2 * done, start_again());
    Err(Error::invalid("iterations", iterations, format!("more than {done}, which are done"), remedy))
}

/// Digest of the parts of a dataset that training uses.
pub(super) fn digest(dataset: &Dataset) -> String {
    let projections = dataset.train.images.as_standard_layout();
    let description =
        format!("{:?} {:?}{}", dataset.scanner, dataset.train.angles, dataset.train.trajectory().digest_text());
    digest_parts(&[description.as_bytes(), cast_slice(projections.as_slice().expect("standard layout"))])
}
