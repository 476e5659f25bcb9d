//! `trgs convert`: from one format to another, by the names of the files.

use super::protocol::Protocol;
use super::{Answer, interrupt};
use clap::Args;
use serde::Serialize;
use std::path::{Path, PathBuf};
use trgs::scene::dataset::{Dataset, read_scanner};
use trgs::scene::volume_file;
use trgs::{Error, Result};

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
        let is_scan = self.source.is_dir()
            || self
                .source
                .extension()
                .is_some_and(|extension| ["pickle", "pkl", "json"].iter().any(|e| extension == *e));
        if is_scan { self.scan() } else { self.volume() }
    }

    fn scan(&self) -> Result<Answer> {
        if self.scanner.is_some() {
            let expected = "no --scanner: a scan has its own";
            return Err(Error::invalid("--scanner", self.source.display(), expected, "leave the flag out"));
        }
        let dataset = Dataset::read(&self.source)?;
        warn(&self.source, &dataset.oddities);
        let dataset = self.protocol.apply(dataset)?;
        interrupt::shielded(|| dataset.write(&self.out))?;
        let (shape, notes) = (dataset.scanner.grid.shape, dataset.notes);
        Ok(Answer::list(&Converted { out: &self.out, kind: "dataset", shape, spacing: None, origin: None, notes }))
    }

    fn volume(&self) -> Result<Answer> {
        if let Some(flag) = self.protocol.flag() {
            let expected = "a scan, a folder or a pickle, to choose views of";
            return Err(Error::invalid(flag, self.source.display(), expected, "leave the flag out"));
        }
        let mut volume = volume_file::read(&self.source)?;
        warn(&self.source, &volume.oddities);
        let shape: [usize; 3] = volume.values.dim().into();
        if let Some(path) = &self.scanner {
            let grid = read_scanner(path)?.grid;
            if grid.shape != shape {
                let expected = format!("{:?}, the grid of {}", grid.shape, path.display());
                let remedy = "give the scan that it was made from";
                return Err(Error::format(&self.source, "volume", format!("shape {shape:?}"), expected, remedy));
            }
            (volume.spacing, volume.origin) = (Some(grid.spacing), Some(grid.centre([0, 0, 0])));
        }
        volume_file::write(&self.out, &volume)?;
        let [spacing, origin] = [volume.spacing, volume.origin].map(|vector| vector.map(|vector| vector.to_array()));
        let notes = Vec::new();
        Ok(Answer::list(&Converted { out: &self.out, kind: "volume", shape, spacing, origin, notes }))
    }
}

fn warn(path: &Path, oddities: &[String]) {
    for oddity in oddities {
        tracing::warn!("{}: {oddity}", path.display());
    }
}
