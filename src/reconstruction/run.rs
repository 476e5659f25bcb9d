//! A reconstruction that is set up step by step.

use super::{Checkpoints, Observe, Progress, Reconstruction, reconstruct_with};
use crate::config::Config;
use crate::error::Result;
use crate::limit;
use crate::memory::Estimate;
use crate::numeric::threads;
use crate::scene::Dataset;
use crate::scene::dataset::DatasetInfo;
use crate::scene::plausibility::{self, AnglesFrom};
use crate::train::with_points_of_model;
use std::fmt;
use std::ops::ControlFlow;

/// [`reconstruct`](super::reconstruct()) with checkpoints and an observer.
///
/// ```no_run
/// use std::ops::ControlFlow;
/// use trgs::reconstruction::{Checkpoints, Progress, Run};
///
/// let scan = trgs::Dataset::read("scan")?;
/// let result = Run::new(&scan, &trgs::Config::default())
///     .checkpoints(Checkpoints::resume("state.msgpack")?)
///     .observe(|progress| {
///         if let Progress::Iteration(iteration, Some(record)) = progress {
///             eprintln!("{iteration}: loss {:.5}", record.loss);
///         }
///         ControlFlow::Continue(())
///     })
///     .reconstruct()?;
/// # Ok::<(), trgs::Error>(())
/// ```
#[must_use = "a run does nothing until `reconstruct` is called"]
pub struct Run<'a> {
    dataset: &'a Dataset,
    config: &'a Config,
    checkpoints: Option<Checkpoints>,
    observe: Box<Observe<'a>>,
}

impl<'a> Run<'a> {
    /// A run with the method and the settings of `config`, without checkpoints and observer.
    pub fn new(dataset: &'a Dataset, config: &'a Config) -> Self {
        Self { dataset, config, checkpoints: None, observe: Box::new(|_| ControlFlow::Continue(())) }
    }

    /// Keeps the state of the run in a file; going on from it leads to the same bits. Without checkpoints a run that is
    /// stopped leaves nothing. Filtered back projection has no state to keep.
    pub fn checkpoints(self, checkpoints: Checkpoints) -> Self {
        Self { checkpoints: Some(checkpoints), ..self }
    }

    /// Calls `observe` after every step; `Break` stops the run.
    pub fn observe(self, observe: impl FnMut(Progress<'_>) -> ControlFlow<()> + 'a) -> Self {
        Self { observe: Box::new(observe), ..self }
    }

    /// Runs the method.
    ///
    /// # Errors
    /// For a setting out of its range, a scan that [`plausibility::check`] refuses, a run that may need more memory than the
    /// limit, those of the method, and [`Error::Interrupted`](crate::Error::Interrupted) when
    /// the observer breaks.
    pub fn reconstruct(mut self) -> Result<Reconstruction> {
        self.config.validate()?;
        plausibility::check(self.dataset, AnglesFrom::File)?;
        let is_resumed = self.checkpoints.as_ref().is_some_and(|checkpoints| checkpoints.from.is_some());
        let config = if is_resumed { self.config.clone() } else { with_points_of_model(self.config)? };
        let config = config.resolved(&self.dataset.scanner, self.dataset.train.len());
        let info = DatasetInfo::of(self.dataset);
        Estimate::new(&info, self.dataset.train.len(), &config, threads::count()).check(limit::bytes())?;
        reconstruct_with(self.dataset, &config, self.checkpoints, &mut *self.observe)
    }
}

impl fmt::Debug for Run<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Run").field("dataset", &self.dataset.name).field("config", &self.config).finish_non_exhaustive()
    }
}
