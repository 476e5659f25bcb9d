//! `trgs simulate`: a simulated scan of a phantom or a volume.

use super::arguments::{Replace, finite, pair, seed};
use super::messages::{hounsfield_to_attenuation, moved, warnings};
use super::{Output, interrupt};
use clap::{Args, ValueEnum, value_parser};
use serde::Serialize;
use std::path::{Path, PathBuf};
use trgs::classical::RayModel;
use trgs::geometry::{Beam, Detector, Grid, Scanner, Volume};
use trgs::output::{Destination, Kind};
use trgs::scan::chain::PARTS;
use trgs::scan::phantom::{Group, PHANTOMS};
use trgs::scan::simulate::{Object, Orbit, Plan, simulate_measured, simulate_on};
use trgs::scan::{Chain, Dataset, Frame, Noise, Phantom, hounsfield, volume_file};
use trgs::{Error, Result};

/// Simulate a scan of a phantom or a volume and write the dataset
#[derive(Args)]
#[command(
    allow_negative_numbers = true,
    after_help = "Examples:
  trgs simulate --phantom torso --out data/torso --noise low
  trgs simulate --volume bone.npy --out data/bone --views 50 --detector 96,128
  trgs simulate --volume bone.npy --out data/tigre --rays siddon
  trgs simulate --phantom torso --out data/measured --realistic scatter=0.2,axis=0 --noise 2e4,10
  trgs simulate --phantom torso --out data/helix --helix 0.4,3 --views 60
  trgs simulate --volume thorax_in_hu.nii.gz --mu-water 1 --out data/thorax"
)]
pub(super) struct Simulate {
    #[command(flatten)]
    object: ObjectArgs,
    /// What a volume's voxels stand for: densities at their centres, linear between them; constant densities, as in TIGRE
    /// (siddon); or planes of centres (joseph) [default: trilinear]
    #[arg(long, value_enum)]
    rays: Option<RaysName>,
    /// Read the volume as Hounsfield units: attenuation X (1 + HU/1000), where X is that of water per unit of the file
    #[arg(long, value_name = "X", requires = "volume", value_parser = finite)]
    mu_water: Option<f64>,
    /// Folder to write; an older scan in it that this command wrote is replaced
    #[arg(long, value_name = "DATASET")]
    out: PathBuf,
    #[command(flatten)]
    replace: Replace,
    /// Number of voxels along each side of a phantom's volume
    #[arg(long, value_name = "N", default_value_t = 64, conflicts_with = "volume",
        value_parser = value_parser!(u16).range(1..))]
    size: u16,
    /// Number of pixels: rows and columns, or one number for both
    #[arg(long, value_name = "N|V,U", default_value = "128", value_parser = pair::<u16>)]
    detector: [u16; 2],
    /// Number of training views, evenly spaced over a full turn
    #[arg(long, value_name = "N", default_value_t = 18, value_parser = value_parser!(u16).range(1..))]
    views: u16,
    /// Number of test views, at random angles and without noise
    #[arg(long, value_name = "N", default_value_t = 50)]
    test_views: u16,
    /// Noise: none, low, medium, high, or I0 photons and SIGMA counts (TIGRE); `,physical`: Beer-Lambert law [default: none;
    /// low with --realistic, whose photons follow its own law]
    #[arg(long, value_name = "LEVEL|I0,SIGMA")]
    noise: Option<Noise>,
    #[arg(long, value_name = "PART=NUMBER,..", num_args = 0..=1, default_missing_value = "", help = realistic_help())]
    realistic: Option<Chain>,
    /// Geometry of the beam
    #[arg(long, value_enum, default_value_t = BeamName::Cone)]
    beam: BeamName,
    /// Distance from source to rotation axis; the volume's longest side is 2
    #[arg(long, value_name = "LENGTH", default_value_t = 5.0, value_parser = finite)]
    dso: f64,
    /// Distance from source to detector
    #[arg(long, value_name = "LENGTH", default_value_t = 7.0, value_parser = finite)]
    dsd: f64,
    /// Height and width of the detector, or one number for both
    #[arg(long, value_name = "LENGTH|V,U", default_value = "4", value_parser = pair::<f64>)]
    detector_size: [f64; 2],
    /// Helix: height that source and detector gain per turn, and turns that the views are spread over
    #[arg(long, value_name = "PITCH,TURNS", allow_hyphen_values = true, value_parser = pair::<f64>)]
    helix: Option<[f64; 2]>,
    /// Turn of the detector in its plane, from the columns' direction towards the rows', degrees
    #[arg(long, value_name = "DEGREES", default_value_t = 0.0, value_parser = finite)]
    roll: f64,
    /// Shift of source and detector along the columns' direction, off the rotation axis (TIGRE's COR)
    #[arg(long, value_name = "LENGTH", default_value_t = 0.0, value_parser = finite)]
    axis_shift: f64,
    /// Seed of noise, test angles and the phantom's random details
    #[arg(long, value_name = "N", default_value_t = 0, value_parser = seed)]
    seed: u64,
}

#[derive(Args)]
#[group(required = true, multiple = false)]
struct ObjectArgs {
    #[arg(long, value_name = "NAME", help = phantom_help())]
    phantom: Option<String>,
    /// Volume [x, y, z], attenuation per unit of its lengths, whose unit and place the scan keeps: .npy (cubic voxels),
    /// .mha, .nrrd, .nii.gz, .tif, .raw
    #[arg(long, value_name = "FILE")]
    volume: Option<PathBuf>,
}

#[derive(Clone, Copy, ValueEnum)]
enum BeamName {
    /// Rays from a point source.
    Cone,
    /// Parallel rays.
    Parallel,
}

#[derive(Clone, Copy, ValueEnum)]
enum RaysName {
    /// Exact line integrals of the trilinear function between centres.
    Trilinear,
    /// The length of the ray in each voxel times its density.
    Siddon,
    /// Bilinear interpolation in planes of centres across the ray.
    Joseph,
}

/// The result of the command.
#[derive(Serialize)]
struct Simulated<'a> {
    #[serde(serialize_with = "trgs::words::serialize_name")]
    dataset: &'a Path,
    volume: [usize; 3],
    detector: [usize; 2],
    train_views: usize,
    test_views: usize,
    noise: String,
    seed: u64,
    /// Of the lengths of the volume that was scanned.
    #[serde(skip_serializing_if = "Option::is_none")]
    unit: Option<&'static str>,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    notes: Vec<String>,
}

fn phantom_help() -> String {
    let own = PHANTOMS.into_iter().filter(|p| p.group.is_none()).map(|p| format!("{} ({})", p.name, p.description));
    let groups = Group::ALL.map(|group| {
        let names: Vec<_> = group.stand_ins().map(|p| p.name).collect();
        format!("{}: {}", group.title(), names.join(", "))
    });
    format!(
        "Phantom: {}. Procedural stand-ins, which share only their names with the scans of the paper: {}",
        own.collect::<Vec<_>>().join("; "),
        groups.join("; ")
    )
}

fn realistic_help() -> String {
    let parts = PARTS.map(|part| format!("{} ({})", part.name, part.docs));
    format!(
        "Training views of a real scanner's measuring chain; test views and volume stay ideal. Parts: {}. Without numbers: \
         {}; 0 leaves a part out",
        parts.join("; "),
        Chain::default()
    )
}

impl Simulate {
    pub(super) fn run(&self) -> Result<Output> {
        let destination = Destination::new(&self.out, Kind::Scan, "simulate").overwrite(self.replace.overwrite);
        let destination = self.object.volume.iter().fold(destination, Destination::input);
        destination.check()?;
        let dataset = self.scan()?;
        interrupt::shielded(|| dataset.write(destination.clone()))?;
        moved(&destination);
        Ok(Output::list(&Simulated {
            dataset: &self.out,
            volume: dataset.scanner.grid.shape,
            detector: self.detector.map(usize::from),
            train_views: dataset.train.len(),
            test_views: self.test_views.into(),
            noise: dataset.noise.to_string(),
            seed: self.seed,
            unit: (dataset.frame != Frame::default()).then(|| dataset.frame.unit_words()),
            notes: dataset.notes,
        }))
    }

    fn scan(&self) -> Result<Dataset> {
        let noise = self.noise.unwrap_or(if self.realistic.is_some() { Noise::LOW } else { Noise::None });
        let plan = Plan { views: self.views.into(), test_views: self.test_views.into(), noise, seed: self.seed };
        let [pitch, turns] = self.helix.unwrap_or([Orbit::CIRCLE.pitch, Orbit::CIRCLE.turns]);
        let orbit = Orbit { turns, pitch, roll: self.roll.to_radians(), axis_shift: self.axis_shift };
        let simulate = |name: &str, object: Object<'_>, scanner: &Scanner| match &self.realistic {
            Some(chain) => simulate_measured(name, object, scanner, &plan, &orbit, chain),
            None => simulate_on(name, object, scanner, &plan, &orbit),
        };
        match (&self.object.phantom, &self.object.volume) {
            (Some(_), _) if self.rays.is_some() => {
                let expected = "a volume: line integrals of a phantom are exact";
                Err(Error::invalid("--rays", "a phantom", expected, "omit --rays, or give --volume FILE"))
            }
            (Some(name), _) => {
                let grid = Grid::cube(self.size.into());
                let phantom = Phantom::by_name(name, self.seed)?;
                simulate(name, Object::Phantom(&phantom), &self.scanner(grid))
            }
            (None, path) => {
                let path = path.as_deref().expect("one of the two is required");
                let (volume, frame) = read_volume(path, self.mu_water)?;
                let name = path.file_stem().unwrap_or_default().to_string_lossy();
                let object = match self.rays {
                    None | Some(RaysName::Trilinear) => Object::Volume(&volume),
                    Some(RaysName::Siddon) => Object::Voxels(&volume, RayModel::Siddon.rays()),
                    Some(RaysName::Joseph) => Object::Voxels(&volume, RayModel::Joseph.rays()),
                };
                let scan = simulate(&name, object, &self.scanner(volume.grid))?;
                Ok(Dataset { frame, ..scan })
            }
        }
    }

    fn scanner(&self, grid: Grid) -> Scanner {
        let beam = match self.beam {
            BeamName::Cone => Beam::Cone { dso: self.dso, dsd: self.dsd },
            BeamName::Parallel => Beam::Parallel { dso: self.dso },
        };
        let [rows, columns] = self.detector.map(usize::from);
        let [height, width] = self.detector_size;
        let (pitch_v, pitch_u) = (height / rows as f64, width / columns as f64);
        let detector = Detector { rows, columns, pitch_v, pitch_u, offset_u: 0.0, offset_v: 0.0 };
        Scanner { beam, detector, grid }
    }
}

/// A volume centred at the origin, its longest side 2; voxels are cubes unless the file says otherwise.
fn read_volume(path: &Path, mu_water: Option<f64>) -> Result<(Volume, Frame)> {
    let mut file = volume_file::read(path)?;
    let hounsfield = match mu_water {
        Some(mu_water) => hounsfield_to_attenuation(path, &mut file.values, mu_water).map(|()| None)?,
        None => hounsfield::remark("volume", &file.values),
    };
    warnings(path, &file.oddities);
    warnings(path, hounsfield);
    let (frame, grid) = Frame::around(&file).map_err(|error| error.in_file(path))?;
    let volume = Volume::new(grid, file.values).map_err(|error| error.in_file(path))?;
    Ok((volume, frame))
}
