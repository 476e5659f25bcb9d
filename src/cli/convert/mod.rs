//! `trgs convert`: converts between formats, which follow from the file names.

mod model;
mod protocol;
mod scan;
mod stack;
mod surface;
mod volume;

use crate::cli::Output;
use crate::cli::arguments::Replace;
use crate::cli::corrections::CorrectionArgs;
use clap::Args;
use protocol::Protocol;
use serde::Serialize;
use std::ffi::OsStr;
use std::path::{Path, PathBuf, is_separator};
use trgs::output::{self, Destination};
use trgs::primitives::Primitives;
use trgs::scan::npz::Npz;
use trgs::scan::surface::Mesh;
use trgs::scan::volume_file::Slices;
use trgs::{Error, Result};

/// Convert volumes, models, scans and raw projections between formats
#[derive(Args)]
#[command(after_help = "Examples:
  trgs convert run/volume.npy volume.nii.gz
  trgs convert scan/vol_gt.npy truth.nii.gz --scanner scan
  trgs convert volume_256x256x256_uint8.raw volume.mha
  trgs convert thorax_in_hu.nii.gz thorax.npy --mu-water 1
  trgs convert run bone.stl --level 0.4
  trgs convert run slices --slices dicom
  trgs convert run sheet.png
  trgs convert run/model.npz model.ply --scanner scan
  trgs convert run/model.npz splats.ply --splats
  trgs convert run/model.npz point_cloud.npz --r2
  trgs convert point_cloud.pickle model.npz
  trgs convert chest.pickle scan
  trgs convert walnut scan --pseudo-truth --views 25 --test-views 100
  trgs convert frames scan --scanner meta_data.json --flat flats.tif --dark darks.tif --angles angles.txt --degrees
  trgs convert frames scan --scanner meta_data.json --flat flats.tif --air auto --mask-pixels auto
  trgs convert walnut corrected --air 0.02 --mask-pixels dead.png

Volumes: .npy, .mha, .mhd, .nrrd, .nhdr, .nii, .nii.gz, .tif and .raw; read only are .npz with one array of three \
axes, .png, .jpg, a folder of .tif, .png, .jpg or .raw with one slice each, a folder with a DICOM series, and a \
DICOM file with several frames (in builds with --features dicom). Builds with --features hdf5 also read HDF5, NeXus \
and MATLAB 7.3; FILE.h5:/group/name names an array, [z, y, x] or [view, v, u], and a scan in the layout of Data \
Exchange or NXtomo brings its fields and angles. A .raw states size and type in its name \
(name_256x256x256_uint8.raw, name_256x256_uint16be.raw for a slice), in that of its folder, or in a side file \
name.raw.json: {\"shape\": [256, 256, 100], \"type\": \"uint16\", \"byte_order\": \"little\", \"spacing\": [0.5, \
0.5, 1], \"origin\": [0, 0, 0], \"unit\": \"mm\", \"skip_bytes\": 0}, of which shape and type are required. Volumes \
are written as f32 with axes in the order of the source. A run keeps spacing, place and unit of its volume.npy in \
volume.npy.json beside it. The unit of a scan's lengths is that of \"unit\": \"mm\" (or um, cm, m) in its \
meta_data.json; where it is known, files state lengths in mm and hold attenuation per mm. A volume \
becomes a closed surface as .stl, .glb or .ply, with vertices in mm (or in the unit of the files), or slices across z in \
a folder: 16 bits from the lowest to the highest value. Models: .npz, .ply (physical values, coloured by confidence or nu), \
R²-Gaussian's point_cloud.pickle (its code is not run), or the same arrays as .npz. Scans: a pickle of NAF or a \
folder, written as a folder in scene units.

A stack of projections (.npy or .npz [view, v, u], a folder of .npy, or any format of volumes with z the view, y = v, \
x = u; a folder of images has one view per file) becomes a scan if OUT is a name without an extension. Intensities I become line integrals p = -ln((I - D)/(F - D)) \
with the flat field F and the dark field D; with --line-integrals the stack holds p already. --scanner describes beam, \
detector and volume like the meta_data.json of a dataset. Without --angles, the angles are those that it lists, or \
evenly spaced over its totalAngle from startAngle. The file of --angles may be a table: the column is the one whose \
heading has angle, theta, phi, deg or rad. Angles of a circle beyond two turns are refused: --degrees converts them, \
--radians insists. Frames that are flat or dark fields, by path, content or name, are left out. \
Gaps in the numbers of the names, several patterns of names and different types of numbers are warned of.

Do not normalise each frame by its own brightest pixel: if no pixel of a frame sees air (the object fills the \
detector), its line integrals are too small by a constant of that frame, the views contradict each other, and no \
volume explains them all. Without a flat field, one value is therefore used for all frames. --air with a region that \
sees air in every frame corrects a drifting source.

--air auto measures the line integral of air at the borders and subtracts it: one constant, or one for each view if it \
varies by more than its error. --mask-pixels auto finds pixels that differ from their neighbours in all views, and \
columns that cause rings. Both say what they changed, and note it in the scan. --mask-pixels FILE (.npy, .tif, .png) is \
a mask of the frames.")]
pub(super) struct Convert {
    /// File or folder to read: a volume, model, scan or stack of projections
    #[arg(value_name = "IN")]
    source: PathBuf,
    /// File or folder to write; its name selects the format
    #[arg(value_name = "OUT")]
    out: PathBuf,
    #[command(flatten)]
    replace: Replace,
    /// Scan that gives a volume its spacing, place and unit, or a .ply its confidence; scanner of a stack
    #[arg(long, value_name = "DATASET|meta_data.json")]
    scanner: Option<PathBuf>,
    /// Read a volume as Hounsfield units: write attenuation X (1 + HU/1000), where X is that of water
    #[arg(long, value_name = "X", value_parser = crate::cli::arguments::finite)]
    mu_water: Option<f64>,
    /// Write a model as R²-Gaussian's arrays, with values before activation
    #[arg(long)]
    r2: bool,
    /// Write a model as splats for viewers of 3D Gaussian splatting: an approximation
    #[arg(long)]
    splats: bool,
    /// Values above X are inside of a surface [default: chosen by Otsu's method]
    #[arg(long, value_name = "X", value_parser = crate::cli::arguments::finite)]
    level: Option<f64>,
    /// Write a volume as a folder of slices
    #[arg(long, value_parser = crate::cli::arguments::choice(&Slices::ALL))]
    slices: Option<Slices>,
    #[command(flatten)]
    corrections: CorrectionArgs,
    #[command(flatten)]
    protocol: Protocol,
    #[command(flatten)]
    stack: stack::StackArgs,
}

/// The kind of data at a path, judged by its name.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Kind {
    Scan,
    Model,
    Volume,
    /// A surface, which is only written.
    Surface,
    /// Projections without a description; as output, a scan.
    Stack,
}

/// The result of the command.
#[derive(Serialize)]
struct Converted<'a> {
    #[serde(serialize_with = "trgs::words::serialize_name")]
    out: &'a Path,
    kind: &'static str,
    shape: [usize; 3],
    #[serde(skip_serializing_if = "Option::is_none")]
    spacing: Option<[f64; 3]>,
    #[serde(skip_serializing_if = "Option::is_none")]
    origin: Option<[f64; 3]>,
    /// Of spacing and origin.
    #[serde(skip_serializing_if = "Option::is_none")]
    unit: Option<&'static str>,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    notes: Vec<String>,
}

impl Convert {
    pub(super) fn run(&self) -> Result<Output> {
        let out = kind(&self.out);
        let source = match extension(&self.source) {
            _ if self.source.join("meta_data.json").exists() => Kind::Scan,
            "json" => Kind::Scan,
            // Scans of NAF and point clouds of R²-Gaussian share the extension: the output's name decides.
            "pickle" | "pkl" if out == Kind::Model => Kind::Model,
            "pickle" | "pkl" => Kind::Scan,
            _ if is_model(&self.source) => Kind::Model,
            _ if self.slices.is_some() => Kind::Volume,
            _ if out == Kind::Scan => Kind::Stack,
            _ => Kind::Volume,
        };
        let refuse = |flag: &str, expected: &str| {
            let got = format!("{} to {}", self.source.display(), self.out.display());
            Err(Error::invalid(flag, got, expected, "omit the flag, or name an output of that kind"))
        };
        let is_surface = source == Kind::Volume && Mesh::is_written_as(extension(&self.out));
        match (self.stack.first_flag(), self.protocol.flag(), self.corrections.flag()) {
            (Some(flag), ..) if source != Kind::Stack => {
                return refuse(
                    flag,
                    "a stack of projections to read and a folder to write, a name without an extension",
                );
            }
            (_, Some(flag), _) if out != Kind::Scan => {
                return refuse(flag, "a scan to choose views of, and a folder to write, a name without an extension");
            }
            (.., Some(flag)) if out != Kind::Scan => {
                return refuse(flag, "a scan or a stack to read, and a folder to write, a name without an extension");
            }
            _ if self.r2 && (source, out) != (Kind::Model, Kind::Model) => {
                return refuse("--r2", "a model to read and a .npz to write");
            }
            _ if self.splats && ((source, out) != (Kind::Model, Kind::Model) || extension(&self.out) != "ply") => {
                return refuse("--splats", "a model to read and a .ply to write");
            }
            _ if self.slices.is_some() && (source, out) != (Kind::Volume, Kind::Scan) => {
                return refuse("--slices", "a volume to read and a folder to write, a name without an extension");
            }
            _ if self.level.is_some() && !is_surface => {
                return refuse("--level", "a volume to read and a surface to write: .stl, .glb or .ply");
            }
            _ if self.mu_water.is_some() && (source != Kind::Volume || out == Kind::Model && !is_surface) => {
                return refuse("--mu-water", "a volume to read and a volume to write, .nii.gz for example");
            }
            _ => {}
        }
        match (source, out) {
            (Kind::Scan, Kind::Scan) => scan::convert(self),
            (Kind::Stack, _) => stack::convert(self),
            (Kind::Model, Kind::Model) => model::convert(self),
            (Kind::Volume, _) if is_surface => surface::convert(self),
            (Kind::Volume, Kind::Scan) => match self.slices {
                Some(format) => surface::slices(self, format),
                None => Err(self.impossible(source, out)),
            },
            (Kind::Volume, Kind::Volume) if extension(&self.out) == "png" => surface::sheet(self),
            // An unknown extension leads to an error that lists the known ones.
            (Kind::Volume, Kind::Volume) => volume::convert(self),
            _ => Err(self.impossible(source, out)),
        }
    }

    /// The folder of a scan, which must not hold what is read.
    fn destination(&self) -> Destination {
        let destination = Destination::new(&self.out, output::Kind::Scan, "convert").overwrite(self.replace.overwrite);
        self.scanner.iter().chain([&self.source]).fold(destination, Destination::input)
    }

    /// The error for a conversion that needs another command; the remedy names that command.
    fn impossible(&self, source: Kind, out: Kind) -> Error {
        let (got, expected, remedy) = match (source, out) {
            (Kind::Model, Kind::Volume | Kind::Surface) => {
                ("a volume of a model", "a model, .npz or .ply", "use trgs voxelize to make a volume")
            }
            (Kind::Model, _) => ("a scan of a model", "a model, .npz or .ply", "use trgs render to make projections"),
            (Kind::Volume, _) => {
                ("a model of a volume", "a volume", "use trgs simulate, then trgs reconstruct, to fit a model")
            }
            (_, Kind::Model) => ("a model of a scan", "a folder", "use trgs reconstruct to fit a model"),
            _ => ("a volume of a scan", "a folder", "use trgs reconstruct; the true volume is vol_gt.npy"),
        };
        Error::invalid(format!("OUT {}", self.out.display()), got, expected, remedy)
    }
}

/// The kind of data that a name stands for.
fn kind(path: &Path) -> Kind {
    // A separator at the end makes a folder of any name: 2024.05.12/.
    if path.is_dir() || path.as_os_str().as_encoded_bytes().last().is_some_and(|&end| is_separator(end.into())) {
        return Kind::Scan;
    }
    match path.extension().and_then(OsStr::to_str) {
        None => Kind::Scan,
        Some("npz" | "ply") => Kind::Model,
        Some("stl" | "glb") => Kind::Surface,
        Some(_) => Kind::Volume,
    }
}

/// Whether a path is that of a scan: its folder, its description or a pickle.
pub(super) fn is_scan(path: &Path) -> bool {
    path.join("meta_data.json").exists() || ["json", "pickle", "pkl"].contains(&extension(path))
}

/// Whether a path is that of a model.
pub(super) fn is_model(path: &Path) -> bool {
    kind(path) == Kind::Model && !holds_arrays(path)
}

/// The primitives of a file of a model.
pub(super) fn read_model(path: &Path) -> Result<Primitives> {
    Ok(model::read(path)?.0)
}

/// Whether an archive holds other arrays than those of a model: a volume or a stack.
fn holds_arrays(path: &Path) -> bool {
    let is_other = |npz: Npz| !npz.keys().any(|key| ["mean", "xyz"].contains(&key));
    extension(path) == "npz" && Npz::read(path).is_ok_and(is_other)
}

fn extension(path: &Path) -> &str {
    path.extension().and_then(OsStr::to_str).unwrap_or_default()
}
