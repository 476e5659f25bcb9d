//! `trgs mix`: two volumes of a scan as one.

use super::Output;
use super::evaluate::read_volume;
use clap::Args;
use serde_json::json;
use std::path::{Path, PathBuf};
use trgs::classical::algebraic::{Mixture, mixture};
use trgs::classical::{RayModel, VoxelProjector};
use trgs::error::Error;
use trgs::geometry::Volume;
use trgs::scan::{Dataset, write_volume};
use trgs::{Result, words};

/// Mix two volumes of a scan so that the mixture predicts its test views best
#[derive(Args)]
#[command(after_help = "Examples:
  trgs mix out/tr-gs out/tv --scanner data/aorta --out mixed.npy

The mixture is s times the first volume and 1 - s times the second, s from 0 to 1, with the least residual in the test \
views. Errors of volumes that different methods found cancel in part. Test views that are used here no longer say how \
good the mixture is.")]
pub(super) struct Mix {
    /// Folder of a run, or a volume [x, y, z] on the dataset's grid
    #[arg(value_name = "RUN|VOLUME")]
    first: PathBuf,
    /// The other one
    #[arg(value_name = "RUN|VOLUME")]
    second: PathBuf,
    /// Dataset with test views, which neither volume was made from
    #[arg(long, value_name = "DATASET")]
    scanner: PathBuf,
    /// File to write, in the format of its name
    #[arg(long, value_name = "FILE")]
    out: PathBuf,
}

impl Mix {
    pub(super) fn run(&self) -> Result<Output> {
        let dataset = Dataset::read(&self.scanner)?;
        let Some(views) = &dataset.test else {
            let remedy =
                "give a dataset with test views: volumes have seen the training views, which would not tell them apart";
            return Err(Error::invalid("test views", "none", "at least one", remedy).in_file(&self.scanner));
        };
        let [first, second] = [&self.first, &self.second].map(|path| volume_of(path, &dataset));
        let (first, mut second) = (first?, second?);
        let projector = VoxelProjector::new(&dataset.scanner, RayModel::Joseph)?;
        let Mixture { share, errors } = mixture(&projector, views, [&first, &second])?;
        let factor = share as f32;
        second.values.zip_mut_with(&first.values, |value, &first| *value = factor * first + (1.0 - factor) * *value);
        write_volume(&self.out, &second, &dataset.frame)?;
        Ok(Output::list(&json!({
            "out": words::name(&self.out),
            "share": share,
            "residual_first": errors[0],
            "residual_second": errors[1],
            "residual": errors[2],
        })))
    }
}

/// The volume of a run or of a file.
fn volume_of(path: &Path, dataset: &Dataset) -> Result<Volume> {
    read_volume(&if path.is_dir() { path.join("volume.npy") } else { path.to_owned() }, dataset)
}
