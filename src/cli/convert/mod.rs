//! `trgs convert`: from one format to another, by the names of the files.

mod protocol;
mod scan;
mod volume;

use crate::cli::Answer;
use clap::Args;
use protocol::Protocol;
use serde::Serialize;
use std::path::{Path, PathBuf};
use trgs::Result;

/// Convert volumes and scans between formats
#[derive(Args)]
#[command(after_help = "Examples:
  trgs convert run/volume.npy volume.nii.gz --scanner scan
  trgs convert volume_256x256x256_uint8.raw volume.mha
  trgs convert chest.pickle scan
  trgs convert walnut scan --pseudo-truth --views 25 --test-views 100

Volumes: .npy, .mha, .mhd, .nrrd, .nhdr, .nii, .nii.gz, and .raw with size and type in its name. They are written as f32,
axes in the order of the file. Scans: a pickle of NAF or a folder, written as a folder in scene units.")]
pub(super) struct Convert {
    /// Volume or scan to read
    #[arg(value_name = "IN")]
    source: PathBuf,
    /// File or folder to write
    #[arg(value_name = "OUT")]
    out: PathBuf,
    /// Scan whose grid gives a volume its spacing and origin, in scene units
    #[arg(long, value_name = "DATASET|meta_data.json")]
    scanner: Option<PathBuf>,
    #[command(flatten)]
    protocol: Protocol,
}

/// What was converted.
#[derive(Serialize)]
struct Converted<'a> {
    out: &'a Path,
    kind: &'static str,
    shape: [usize; 3],
    #[serde(skip_serializing_if = "Option::is_none")]
    spacing: Option<[f64; 3]>,
    #[serde(skip_serializing_if = "Option::is_none")]
    origin: Option<[f64; 3]>,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    notes: Vec<String>,
}

impl Convert {
    pub(super) fn run(&self) -> Result<Answer> {
        let is_scan = self.source.is_dir() || has_extension(&self.source, &["pickle", "pkl", "json"]);
        if is_scan { scan::convert(self) } else { volume::convert(self) }
    }
}

fn has_extension(path: &Path, extensions: &[&str]) -> bool {
    path.extension().is_some_and(|extension| extensions.iter().any(|known| extension == *known))
}

fn warn(path: &Path, oddities: &[String]) {
    for oddity in oddities {
        tracing::warn!("{}: {oddity}", path.display());
    }
}
