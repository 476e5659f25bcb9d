//! The state that a run needs to resume with the same bits, and its checkpoint file.

use super::optimiser::Optimiser;
use super::record::{Losses, Record};
use crate::config::Config;
use crate::density::{NextPrimitive, next_parameters};
use crate::error::{Error, Result, start_again};
use crate::output::{create_folder, write_atomically};
use crate::primitives::{Activation, Parameters};
use crate::provenance::digest_parts;
use crate::scene::Dataset;
use bytemuck::cast_slice;
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// Version of the file format.
const FORMAT: u32 = 2;

/// The state of a run after an iteration.
///
/// Random numbers and the order of views are functions of the seed and the iteration.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct State {
    /// Iterations completed.
    pub(super) iteration: usize,
    pub(super) raw: Parameters,
    /// Unique ids of the primitives; none is reused.
    pub(super) ids: Vec<u64>,
    next_id: u64,
    pub(super) optimiser: Optimiser,
    /// c of each primitive as last computed; empty if no loss needs it.
    pub(super) confidence: Vec<f64>,
    pub(super) gradient_stats: GradientStats,
    pub(super) log: Vec<Record>,
    /// Sums of the losses since the last record, and their number.
    pub(super) sums: Losses,
    pub(super) summed: usize,
    /// Seconds spent so far.
    pub(super) seconds: f64,
    /// Iterations after which the number of iterations was changed.
    #[serde(default)]
    pub(super) continued: Vec<usize>,
}

/// Mean gradient to each projected mean over the views that saw the primitive, since the last density control.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(super) struct GradientStats {
    sum: Vec<f64>,
    views: Vec<u32>,
}

impl GradientStats {
    fn new(m: usize) -> Self {
        Self { sum: vec![0.0; m], views: vec![0; m] }
    }

    /// Adds one view: the gradient to each projected mean, and whether the view saw the primitive.
    pub(super) fn add(&mut self, mean2d_gradients: impl Iterator<Item = [f64; 2]>, seen: impl Iterator<Item = bool>) {
        let totals = self.sum.iter_mut().zip(&mut self.views);
        for ((sum, views), ([u, v], _)) in totals.zip(mean2d_gradients.zip(seen)).filter(|(_, (_, seen))| *seen) {
            *sum += (u * u + v * v).sqrt();
            *views += 1;
        }
    }

    /// The means; 0 for a primitive that no view saw.
    pub(super) fn means(&self) -> Vec<f64> {
        self.sum.iter().zip(&self.views).map(|(sum, &views)| sum / f64::from(views.max(1))).collect()
    }
}

impl State {
    pub(super) fn new(raw: Parameters, config: &Config) -> Self {
        let m = raw.len();
        Self {
            iteration: 0,
            ids: (0..m as u64).collect(),
            next_id: m as u64,
            optimiser: Optimiser::new(m, config),
            confidence: Vec::new(),
            gradient_stats: GradientStats::new(m),
            raw,
            log: Vec::new(),
            sums: Losses::default(),
            summed: 0,
            seconds: 0.0,
            continued: Vec::new(),
        }
    }

    /// Replaces the population. Unchanged values keep their raw values to the bit.
    pub(super) fn replace_population(
        &mut self,
        physical: &Parameters,
        next: &[NextPrimitive],
        activation: &Activation,
    ) {
        let new = activation.inverse(&next_parameters(physical, next));
        let old = &self.raw;
        let keep = |same: bool, old: f64, new: f64| if same { old } else { new };
        self.raw = Parameters {
            mean: new.mean,
            scale: (next.iter().zip(&new.scale))
                .map(|(s, new)| {
                    let p = s.parent;
                    [0, 1, 2].map(|k| keep(s.scale[k] == physical.scale[p][k], old.scale[p][k], new[k]))
                })
                .collect(),
            quaternion: new.quaternion,
            density: (next.iter().zip(&new.density))
                .map(|(s, &new)| keep(s.density == physical.density[s.parent], old.density[s.parent], new))
                .collect(),
            nu: next.iter().map(|s| old.nu[s.parent]).collect(),
        };
        let mut id = |s: &NextPrimitive| {
            if s.fresh {
                self.next_id += 1;
                self.next_id - 1
            } else {
                self.ids[s.parent]
            }
        };
        self.ids = next.iter().map(&mut id).collect();
        let rows: Vec<_> = next.iter().map(|s| (!s.fresh).then_some(s.parent)).collect();
        self.optimiser.remap_rows(&rows);
        self.gradient_stats = GradientStats::new(next.len());
    }
}

/// The state of a run, with its configuration and the digest of its data.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Checkpoint {
    format: u32,
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
        Self { format: FORMAT, config: config.to_toml(), data, state }
    }

    /// Reads a checkpoint.
    ///
    /// # Errors
    /// [`Error::Read`], or [`Error::Format`] for what is none.
    pub fn read(path: &Path) -> Result<Self> {
        let bytes = std::fs::read(path).map_err(|source| Error::read(path, source))?;
        let checkpoint: Self = rmp_serde::from_slice(&bytes)
            .map_err(|error| Error::format(path, "content", error, "a checkpoint of trgs", start_again()))?;
        if checkpoint.format != FORMAT {
            return Err(Error::format(path, "format", checkpoint.format, FORMAT.to_string(), start_again()));
        }
        Ok(checkpoint)
    }

    /// Writes it as a whole or not at all; missing folders are created, and removed again if it cannot be written.
    ///
    /// # Errors
    /// [`Error::Write`].
    pub fn write(&self, path: &Path) -> Result<()> {
        let folders = path.ancestors().skip(1).take_while(|folder| !folder.as_os_str().is_empty());
        let missing: Vec<&Path> = folders.take_while(|folder| !folder.exists()).collect();
        let written = path.parent().map_or(Ok(()), create_folder).and_then(|()| {
            write_atomically(path, |file| rmp_serde::encode::write(file, self).map_err(std::io::Error::other))
        });
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::primitives::{KernelKind, activation::Interval};
    use crate::tolerances::relative;

    fn activation() -> Activation {
        Activation {
            kernel: KernelKind::StudentT,
            scale: Interval { min: 0.001, max: 1.0 },
            nu: Interval { min: 2.0, max: 100.0 },
        }
    }

    fn raw() -> Parameters {
        Parameters {
            mean: vec![[0.1, -0.2, 0.3], [0.5, 0.6, 0.7]],
            scale: vec![[-2.0, -2.4, -1.7], [-3.0, -3.1, -3.2]],
            quaternion: vec![[0.3, -0.4, 0.8, 0.1], [1.0, 0.0, 0.2, 0.0]],
            density: vec![-0.7, -3.0],
            nu: vec![-1.3, 0.2],
        }
    }

    #[test]
    fn successors_keep_raw_values_to_the_bit_where_nothing_changed() {
        let mut state = State::new(raw(), &Config::default());
        let physical = activation().forward(&state.raw).parameters;
        let same = NextPrimitive::same(&physical, 1);
        let half = NextPrimitive { density: physical.density[0] / 2.0, ..NextPrimitive::same(&physical, 0) };
        state.replace_population(&physical, &[same, half, NextPrimitive { fresh: true, ..half }], &activation());
        assert_eq!((state.raw.scale[0], state.raw.density[0]), (raw().scale[1], raw().density[1]));
        assert_eq!((state.raw.scale[1], state.raw.nu[2]), (raw().scale[0], raw().nu[0]));
        let density = activation().forward(&state.raw).parameters.density;
        within!(relative(density[1] + density[2], physical.density[0]));
        assert_eq!((state.ids.as_slice(), state.next_id), (&[1, 0, 2][..], 3));
    }

    #[test]
    fn pulls_are_means_over_the_views_that_saw_a_primitive() {
        let mut gradient_stats = GradientStats::new(3);
        gradient_stats.add([[3.0, 4.0], [1.0, 0.0], [7.0, 7.0]].into_iter(), [true, true, false].into_iter());
        gradient_stats.add([[0.0, 1.0], [5.0, 5.0], [7.0, 7.0]].into_iter(), [true, false, false].into_iter());
        assert_eq!(gradient_stats.means(), [3.0, 1.0, 0.0]);
    }

    #[test]
    fn what_is_no_checkpoint_is_refused_with_its_name() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("checkpoint");
        std::fs::write(&path, b"hello").unwrap();
        let message = Checkpoint::read(&path).unwrap_err().to_string();
        assert!(message.contains("checkpoint") && !message.contains('\n'), "{message}");
        assert!(Checkpoint::read(&folder.path().join("none")).is_err());
    }
}
