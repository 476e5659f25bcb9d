//! Few views of a measured scan, and a truth to compare with: flags of `trgs convert`.

use crate::cli::arguments::seed;
use crate::cli::check_size;
use clap::Args;
use trgs::Result;
use trgs::classical::with_pseudo_truth;
use trgs::scene::Dataset;

#[derive(Args)]
#[command(next_help_heading = "Measured scans")]
pub(super) struct Protocol {
    /// Keep only so many of the training views, evenly spaced from the first to the last
    #[arg(long, value_name = "N")]
    views: Option<usize>,
    /// Test views, drawn from the training views that are not kept; unless said, 100 or all that are left
    #[arg(long, value_name = "N", requires = "views")]
    test_views: Option<usize>,
    /// Take the reconstruction of all training views by FDK, without negative values, for the truth
    #[arg(long)]
    pseudo_truth: bool,
    /// Of the choice of the test views [default: 0]
    #[arg(long, value_name = "N", requires = "views", value_parser = seed)]
    seed: Option<u64>,
}

impl Protocol {
    /// The flag that was given, if any.
    pub(super) fn flag(&self) -> Option<&'static str> {
        self.views.map(|_| "--views").or(self.pseudo_truth.then_some("--pseudo-truth"))
    }

    /// The scan as the flags want it. The pseudo truth is of the views before any is dropped.
    pub(super) fn apply(&self, mut dataset: Dataset) -> Result<Dataset> {
        if self.pseudo_truth {
            check_size("volume", &dataset.scanner.grid.shape)?;
            dataset = with_pseudo_truth(dataset)?;
        }
        match self.views {
            Some(views) => dataset.subsample(views, self.test_views, self.seed.unwrap_or(0)),
            None => Ok(dataset),
        }
    }
}
