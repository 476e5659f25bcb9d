//! A reconstruction that is set up step by step.

use super::{Checkpoints, Observe, Progress, Reconstruction, reconstruct_with};
use crate::config::{Config, Plan};
use crate::error::Result;
use crate::limit;
use crate::memory::Estimate;
use crate::numeric::threads;
use crate::scan::Dataset;
use crate::scan::dataset::DatasetInfo;
use crate::scan::plausibility::{self, AnglesFrom};
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
    settings: Settings<'a>,
    checkpoints: Option<Checkpoints>,
    observe: Box<Observe<'a>>,
}

/// Settings of a run.
#[derive(Debug)]
enum Settings<'a> {
    /// Still to be checked and completed.
    Config(&'a Config),
    Plan(&'a Plan),
}

impl<'a> Run<'a> {
    /// A run with the method and the settings of `config`, without checkpoints and observer.
    pub fn new(dataset: &'a Dataset, config: &'a Config) -> Self {
        Self::of(dataset, Settings::Config(config))
    }

    /// A run by a plan for this scan, whose memory was checked: see [`Estimate::fitted`].
    pub fn planned(dataset: &'a Dataset, plan: &'a Plan) -> Self {
        Self::of(dataset, Settings::Plan(plan))
    }

    fn of(dataset: &'a Dataset, settings: Settings<'a>) -> Self {
        Self { dataset, settings, checkpoints: None, observe: Box::new(|_| ControlFlow::Continue(())) }
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
        let (scanner, views) = (&self.dataset.scanner, self.dataset.train.len());
        let made;
        let plan = match self.settings {
            Settings::Plan(plan) => plan,
            Settings::Config(config) => {
                let plan = config.plan(scanner, views)?;
                plausibility::check(self.dataset, AnglesFrom::File)?;
                let info = DatasetInfo::of(self.dataset);
                (made, _) = Estimate::fitted(&info, views, &plan, threads::count(), limit::bytes())?;
                &made
            }
        };
        reconstruct_with(self.dataset, plan, self.checkpoints, &mut *self.observe)
    }
}

impl fmt::Debug for Run<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Run")
            .field("dataset", &self.dataset.name)
            .field("settings", &self.settings)
            .finish_non_exhaustive()
    }
}
