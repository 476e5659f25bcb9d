//! Scanner and views: the flags of all commands that compute projections.

use super::arguments::finite;
use clap::{Args, ValueEnum};
use std::path::PathBuf;
use trgs::geometry::{Pose, Scanner, Trajectory};
use trgs::scan::Dataset;
use trgs::scan::dataset::read_at_angles;
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

/// A scanner and some of its views.
pub(super) struct Views {
    pub(super) scanner: Scanner,
    /// Radians.
    pub(super) angles: Vec<f64>,
    poses: Option<Vec<Pose>>,
}

impl Views {
    pub(super) fn trajectory(&self) -> Trajectory<'_> {
        Trajectory { angles: &self.angles, poses: self.poses.as_deref() }
    }
}

impl ViewArgs {
    /// The scanner and the views.
    ///
    /// Angles are those of a circle, or of the one deviation from it that the description states for all views.
    pub(super) fn read(&self) -> Result<Views> {
        if !self.angles.is_empty() {
            let (scanner, poses) = read_at_angles(&self.scanner, &self.angles)?;
            return Ok(Views { scanner, angles: self.angles.clone(), poses });
        }
        let dataset = Dataset::read(&self.scanner)?;
        let views = match self.split {
            Split::Train => dataset.train,
            Split::Test => dataset.test.ok_or_else(|| {
                Error::invalid("--split", "test", "train: the dataset has no test views", "or give --angles")
            })?,
        };
        Ok(Views { scanner: dataset.scanner, angles: views.angles, poses: views.poses })
    }
}
