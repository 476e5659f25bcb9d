//! `trgs oracle trace`: one iteration of a run as a question.

use super::{Written, interrupt, moved};
use crate::cli::arguments::{Replace, choice, positive};
use crate::cli::cost::Steps;
use crate::cli::{Global, Output};
use clap::Args;
use std::ops::ControlFlow;
use std::path::PathBuf;
use trgs::Result;
use trgs::config::{Config, Method, Preset};
use trgs::output::{Destination, Kind};
use trgs::scan::Dataset;
use trgs::train::trace;

/// Write what an iteration of a run starts from, or several in a row, as a question for a backend's training
///
/// The run is made up to that iteration. The question has no truncation of primitives, and the confidence of the next
/// iterations is not part of it. Where adding and recycling is due after a single iteration, it is a second question.
#[derive(Args)]
#[command(after_help = "Example:
  trgs oracle trace data/torso step --iteration 300 --config out/torso/config.toml
  my-backend step answers
  trgs oracle check answers --vectors step --precision f32")]
pub(super) struct Trace {
    /// Folder of the scan
    #[arg(value_name = "DATASET")]
    dataset: PathBuf,
    /// Folder to write; older vectors in it are replaced
    #[arg(value_name = "DIR")]
    folder: PathBuf,
    /// The iteration, counted from 1
    #[arg(long, value_name = "N", value_parser = positive)]
    iteration: usize,
    /// Number of iterations in a row from there
    #[arg(long, value_name = "N", value_parser = positive, default_value_t = 1)]
    steps: usize,
    /// Configuration file of the run
    #[arg(long, value_name = "FILE.toml")]
    config: Option<PathBuf>,
    /// Published settings to start from
    #[arg(long, value_parser = choice(&Preset::ALL), conflicts_with = "config")]
    preset: Option<Preset>,
    /// Set a configuration key, for example loss.tv=0.1; may be repeated
    #[arg(long, value_name = "KEY=VALUE")]
    set: Vec<String>,
    #[command(flatten)]
    replace: Replace,
}

impl Trace {
    pub(super) fn run(&self, global: &Global) -> Result<Output> {
        let destination =
            Destination::new(&self.folder, Kind::Vectors, "oracle trace").overwrite(self.replace.overwrite);
        let destination = destination.input(&self.dataset);
        destination.check()?;
        let mut config = match &self.config {
            Some(file) => Config::read(file, Method::TrGs)?,
            None => Config::of(Method::TrGs),
        };
        self.preset.into_iter().for_each(|preset| config.apply(preset));
        self.set.iter().try_for_each(|setting| config.set(setting))?;
        let dataset = Dataset::read(&self.dataset)?;
        let plan = config.plan(&dataset.scanner, dataset.train.len())?;
        let mut steps = Steps::new("iterations", global);
        let vectors = trace(&dataset, &plan, [self.iteration, self.steps], &mut |done| {
            steps.see(done, self.iteration);
            if interrupt::requested() { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
        })?;
        drop(steps);
        let cases: Vec<_> = vectors.manifest.cases.iter().collect();
        let files = interrupt::shielded(|| vectors.export(destination.clone(), true, &cases))?;
        moved(&destination);
        Ok(Output::list(&Written { folder: &self.folder, cases: cases.len(), files: files + 2 }))
    }
}
