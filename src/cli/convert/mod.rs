//! `trgs convert`: from one format to another, by the names of the files.

mod protocol;
mod scan;
mod stack;
mod volume;

use crate::cli::Answer;
use clap::Args;
use protocol::Protocol;
use serde::Serialize;
use std::path::{Path, PathBuf};
use trgs::{Error, Result};

/// Convert volumes, scans and raw projections between formats
#[derive(Args)]
#[command(after_help = "Examples:
  trgs convert run/volume.npy volume.nii.gz --scanner scan
  trgs convert volume_256x256x256_uint8.raw volume.mha
  trgs convert chest.pickle scan
  trgs convert walnut scan --pseudo-truth --views 25 --test-views 100
  trgs convert frames scan --scanner meta_data.json --flat flats.tif --dark darks.tif --angles angles.txt --degrees

Volumes: .npy, .mha, .mhd, .nrrd, .nhdr, .nii, .nii.gz, .tif, a folder of .tif or of the slices of a DICOM series (read
only, in builds with --features dicom), and .raw with size and type in its name or in a file name.raw.json beside it:
{\"shape\": [256, 256, 100], \"type\": \"uint16\", \"byte_order\": \"little\", \"spacing\": [0.5, 0.5, 1], \"origin\": [0, 0, 0],
\"skip_bytes\": 0}, of which shape and type are needed. They are written as f32, axes in the order of the file. Scans: a
pickle of NAF or a folder, written as a folder in scene units.

A stack of projections (.npy [view, v, u], a folder of .npy, or any format of volumes with z the view, y = v, x = u) becomes
a scan when OUT is a name without an extension. It holds intensities, which become line integrals p = -ln((I - D)/(F - D))
with the flat field F and the dark field D, or --line-integrals already. --scanner describes beam, detector and volume as
meta_data.json of a dataset does; without --angles the views are those that it lists, or lie evenly over its totalAngle from
startAngle on.

Beware of frames that were normalised one by one, each by its own brightest pixel: where no pixel of a frame sees air (the
object fills the detector) its line integrals are too small by a constant of that frame alone, the views contradict each
other and no volume explains them all. So without a flat field one value stands for it in all frames. A source that drifts
is followed by --air, a region that sees air in every frame.")]
pub(super) struct Convert {
    /// Volume, scan or stack of projections to read
    #[arg(value_name = "IN")]
    source: PathBuf,
    /// File or folder to write
    #[arg(value_name = "OUT")]
    out: PathBuf,
    /// Scan whose grid gives a volume its spacing and origin, in scene units; scanner of a stack
    #[arg(long, value_name = "DATASET|meta_data.json")]
    scanner: Option<PathBuf>,
    #[command(flatten)]
    protocol: Protocol,
    #[command(flatten)]
    stack: stack::StackArgs,
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
        let is_scan =
            self.source.join("meta_data.json").exists() || has_extension(&self.source, &["pickle", "pkl", "json"]);
        let is_stack = !is_scan && self.out.extension().is_none();
        match self.stack.first_flag().filter(|_| !is_stack) {
            Some(flag) => {
                let expected = "a stack of projections to read and a folder to write, a name without an extension";
                let got = format!("{} to {}", self.source.display(), self.out.display());
                Err(Error::invalid(flag, got, expected, "leave the flag out or change the names"))
            }
            None if is_scan => scan::convert(self),
            None if is_stack => stack::convert(self),
            None => volume::convert(self),
        }
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
