//! Flags of `trgs convert` for measured scans: fewer views, and a pseudo truth.

use crate::cli::arguments::seed;
use clap::Args;
use trgs::classical::with_pseudo_truth;
use trgs::scan::Dataset;
use trgs::{Error, Result};

#[derive(Args)]
#[command(next_help_heading = "Measured scans")]
pub(super) struct Protocol {
    /// Keep only this number of training views, evenly spaced from the first to the last
    #[arg(long, value_name = "N")]
    views: Option<usize>,
    /// Number of test views, drawn from the other training views [default: 100, or all that remain]
    #[arg(long, value_name = "N", requires = "views")]
    test_views: Option<usize>,
    /// Use the FDK reconstruction of all training views, without negative values, as the true volume
    #[arg(long)]
    pseudo_truth: bool,
    /// Seed of the choice of test views [default: 0]
    #[arg(long, value_name = "N", requires = "views", value_parser = seed)]
    seed: Option<u64>,
}

impl Protocol {
    /// The first of these flags that was given, if any.
    pub(super) fn flag(&self) -> Option<&'static str> {
        self.views.map(|_| "--views").or(self.pseudo_truth.then_some("--pseudo-truth"))
    }

    /// Applies the flags to a scan. The pseudo truth uses all views, before any is dropped.
    pub(super) fn apply(&self, mut dataset: Dataset) -> Result<Dataset> {
        if self.pseudo_truth {
            dataset = with_pseudo_truth(dataset).map_err(|error| match error {
                Error::Invalid { what, got, expected, .. } => {
                    Error::invalid(what, got, expected, "omit --pseudo-truth: FDK makes no truth of this scan")
                }
                other => other,
            })?;
        }
        match self.views {
            Some(views) => dataset.subsample(views, self.test_views, self.seed.unwrap_or(0)),
            None => Ok(dataset),
        }
    }
}
