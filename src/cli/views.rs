//! Scanner and views: the flags of all commands that compute projections.

use super::arguments::finite;
use clap::{Args, ValueEnum};
use std::path::PathBuf;
use trgs::scene::dataset::read_scanner;
use trgs::scene::{Dataset, Scanner};
use trgs::{Error, Result};

#[derive(Args)]
pub(super) struct ViewArgs {
    /// Dataset, or its meta_data.json
    #[arg(long, value_name = "DATASET|meta_data.json")]
    scanner: PathBuf,
    /// Angles of the views, radians
    #[arg(long, value_name = "RAD,RAD,..", value_delimiter = ',', allow_hyphen_values = true, value_parser = finite,
        conflicts_with = "split")]
    angles: Vec<f64>,
    /// Views of the dataset to use if no angles are given
    #[arg(long, value_enum, default_value_t = Split::Train)]
    split: Split,
}

#[derive(Clone, Copy, ValueEnum)]
enum Split {
    Train,
    Test,
}

impl ViewArgs {
    /// The scanner, and angles in radians.
    pub(super) fn read(&self) -> Result<(Scanner, Vec<f64>)> {
        if !self.angles.is_empty() {
            return Ok((read_scanner(&self.scanner)?, self.angles.clone()));
        }
        let dataset = Dataset::read(&self.scanner)?;
        let views = match self.split {
            Split::Train => dataset.train,
            Split::Test => dataset.test.ok_or_else(|| {
                Error::invalid("--split", "test", "train: the dataset has no test views", "or give --angles")
            })?,
        };
        Ok((dataset.scanner, views.angles))
    }
}
