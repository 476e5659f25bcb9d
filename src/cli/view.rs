//! `trgs view`: a page to look at volumes and projections.

use super::arguments::finite;
use super::evaluate::arrange;
use super::messages::warning;
use super::render::FAST_CUTOFF;
use super::{Output, convert};
use clap::Args;
use ndarray::Array3;
use serde_json::json;
use std::borrow::Cow;
use std::f64::consts::TAU;
use std::io::Write;
use std::path::{Path, PathBuf};
use trgs::confidence::Coverage;
use trgs::config::{Config, Method};
use trgs::geometry::{Projections, Scanner, Volume};
use trgs::output::{check_file, write_atomically};
use trgs::primitives::Primitives;
use trgs::projector::voxelize;
use trgs::reconstruction::reproject;
use trgs::report::viewer::{Depth, Scene, page};
use trgs::scan::volume_file::{self, VolumeFile};
use trgs::scan::{Dataset, Frame, stack};
use trgs::{Error, Result, words};

/// Write a page that shows volumes, runs and scans: planes, window, profile, comparison
#[derive(Args)]
#[command(after_help = "Examples:
  trgs view thorax.nii.gz
  trgs view out/torso data/torso --out torso.html
  trgs view out/tr-gs out/tv truth.nii.gz --full
  trgs view data/torso
  trgs view out/torso data/torso --turntable
  trgs view out/torso/model.npz data/torso

The page is one file without network access, for any browser of 2023 or newer; ? lists its keys. All formats of volumes \
that trgs convert reads are shown; a folder of .npy is a stack of projections. Two to four volumes are compared, on the \
grid of the first that states one: side by side, by difference, wipe and flicker. A scan shows its true volume and its \
projections; with a run, a volume or a model beside it, measured and rendered projections of the test views and their \
difference. Beside a scan, the primitives of the first run or model are drawn where a plane cuts them, coloured by ν, \
confidence or density.

Volumes of more than 128³ voxels are shown as means of blocks, and of projections at most 128 views, unless --full is \
given. One volume is stored in 16 bits, several are in 8.")]
pub(super) struct View {
    /// Volumes in any format, folders of runs, models, and a scan
    #[arg(value_name = "FILE|RUN|SCAN", required = true)]
    paths: Vec<PathBuf>,
    /// File to write
    #[arg(long, value_name = "PAGE.html", default_value = "view.html")]
    out: PathBuf,
    /// Show all voxels and views of large volumes and scans
    #[arg(long)]
    full: bool,
    /// Show projections around the object, rendered from the first volume or run on the scan
    #[arg(long)]
    turntable: bool,
    /// Bits of a stored value [default: 16 for one volume, 8 for several]
    #[arg(long, value_name = "8|16", value_parser = depth)]
    bits: Option<Depth>,
    /// Show Hounsfield units as well: the attenuation of water in the volumes
    #[arg(long, value_name = "X", value_parser = water)]
    mu_water: Option<f64>,
}

/// Projections of a turntable.
const TURNTABLE: usize = 36;

/// What is shown, sorted by kind.
#[derive(Default)]
struct Shown {
    scan: Option<(PathBuf, Dataset)>,
    volumes: Vec<Named>,
    /// Files of models.
    models: Vec<PathBuf>,
    /// Frames `[view, v, u]`.
    stacks: Vec<(String, Array3<f32>)>,
}

/// A volume that is shown.
struct Named {
    name: String,
    path: PathBuf,
    file: VolumeFile,
    /// Whether the path is a run's.
    is_run: bool,
}

impl View {
    pub(super) fn run(&self) -> Result<Output> {
        let Shown { scan, volumes, models, stacks } = self.read()?;
        let mut scenes = Vec::new();
        let placed;
        match &scan {
            Some((path, dataset)) => {
                placed = Placed::of(dataset, volumes, &models)?;
                if let Some(scene) = placed.volumes(dataset, path)? {
                    scenes.push(scene);
                }
                scenes.push(placed.projections(dataset)?);
                if self.turntable {
                    scenes.push(placed.turntable(dataset)?);
                }
            }
            None if !models.is_empty() => {
                let (got, remedy) = (models[0].display(), "name the scan as well");
                return Err(Error::invalid(
                    "model to show",
                    got,
                    "a scan beside it, whose voxels it is shown in",
                    remedy,
                ));
            }
            None if self.turntable => {
                let expected = "a volume or a run, and the scan whose detector sees it";
                return Err(Error::invalid("--turntable", "no scan", expected, "name a scan as well"));
            }
            None if !volumes.is_empty() => {
                let names: Vec<_> = volumes.iter().map(|named| named.name.as_str()).collect();
                let title = names.join(", ");
                scenes.push(Scene::of_files(&title, on_one_grid(volumes)?)?);
            }
            None => {}
        }
        for (name, frames) in stacks {
            scenes.push(Scene::of_frames(&format!("Frames of {name}"), &name, frames)?);
        }
        let scenes = scenes.into_iter().map(|scene| scene.with_water(self.mu_water));
        let scenes: Vec<_> = scenes.map(|scene| if self.full { scene } else { scene.reduced() }).collect();
        let shows: Vec<String> = scenes.iter().map(Scene::summary).collect();
        let is_one = matches!(&scenes[..], [scene] if scene.count() == 1);
        let depth = self.bits.unwrap_or(if is_one { Depth::Sixteen } else { Depth::Eight });
        let names: Vec<_> = self.paths.iter().map(|path| name(path)).collect();
        let html = page(&names.join(", "), &shows.join("; "), &scenes, depth);
        check_file(&self.out)?;
        write_atomically(&self.out, |file| file.write_all(html.as_bytes()))?;
        Ok(Output::list(&json!({ "out": words::name(&self.out), "bytes": html.len(), "shows": shows })))
    }

    fn read(&self) -> Result<Shown> {
        let mut shown = Shown::default();
        for path in &self.paths {
            let of_run = path.join("volume.npy");
            if convert::is_scan(path) {
                if let Some((other, _)) = &shown.scan {
                    let got = format!("{} and {}", other.display(), path.display());
                    return Err(Error::invalid("scans to show", got, "one", "show each on a page of its own"));
                }
                shown.scan = Some((path.clone(), Dataset::read(path)?));
            } else if convert::is_model(path) {
                shown.models.push(path.clone());
            } else {
                let is_run = of_run.exists();
                match volume_file::read(if is_run { &of_run } else { path }) {
                    Ok(file) => {
                        file.oddities.iter().for_each(|oddity| warning(path, oddity));
                        shown.volumes.push(Named { name: name(path), path: path.clone(), file, is_run });
                    }
                    Err(error) if !path.is_dir() => return Err(error),
                    Err(error) => {
                        let (frames, _) = stack::read_with_oddities(path).map_err(|_| error)?;
                        shown.stacks.push((name(path), frames));
                    }
                }
            }
        }
        Ok(shown)
    }
}

/// Volumes on the grid of a scan.
struct Placed {
    volumes: Vec<(String, Volume)>,
    /// The primitives of the first.
    primitives: Option<Primitives>,
    /// The settings of its run.
    config: Config,
}

impl Placed {
    /// Volumes and runs, and after them the volumes of models.
    fn of(dataset: &Dataset, volumes: Vec<Named>, models: &[PathBuf]) -> Result<Self> {
        let grid = &dataset.scanner.grid;
        let run = volumes.first().filter(|named| named.is_run).map(|named| named.path.clone());
        let config = run.as_ref().map(|run| Config::read(run.join("config.toml"), Method::TrGs)).transpose()?;
        let config = config.unwrap_or_default();
        config.validate()?;
        let of_run = run.map(|run| run.join("model.npz")).filter(|model| model.exists());
        let models = models.iter().map(|path| Ok((name(path), convert::read_model(path)?)));
        let models = models.collect::<Result<Vec<_>>>()?;
        let primitives = match of_run {
            Some(path) => Some(convert::read_model(&path)?),
            None => models.first().filter(|_| volumes.is_empty()).map(|(_, primitives)| primitives.clone()),
        };
        let of = |named: Named| Ok((named.name, arrange(&dataset.frame, named.file, grid, &named.path)?));
        let of_model = |(name, primitives): (String, Primitives)| {
            Ok((name, Volume::new(*grid, voxelize::<f32>(&primitives, grid, FAST_CUTOFF))?))
        };
        let volumes = volumes.into_iter().map(of).chain(models.into_iter().map(of_model)).collect::<Result<_>>()?;
        Ok(Self { volumes, primitives, config })
    }

    /// The true volume and these; `None` if there is none.
    fn volumes<'a>(&'a self, dataset: &'a Dataset, path: &Path) -> Result<Option<Scene<'a>>> {
        let truth = dataset.truth.iter().map(|truth| ("truth", truth));
        let others = self.volumes.iter().map(|(name, volume)| (name.as_str(), volume));
        let all: Vec<_> = truth.chain(others).collect();
        if all.is_empty() {
            return Ok(None);
        }
        let scene = Scene::of_volumes(&format!("Volumes on the grid of {}", name(path)), all, &dataset.frame)?;
        let Some(primitives) = &self.primitives else { return Ok(Some(scene)) };
        let Dataset { scanner, train, .. } = dataset;
        let settings = self.config.confidence.settings(self.config.seen(scanner).grid.spacing.min_element());
        let confidence = Coverage::new(settings).confidence(primitives, scanner, train);
        Ok(Some(scene.with_primitives(primitives, &scanner.grid, Some(confidence))))
    }

    /// The test views and the same rendered from the first volume, or from the primitives of its run where it has them.
    /// Without a volume, the training views.
    fn projections<'a>(&self, dataset: &'a Dataset) -> Result<Scene<'a>> {
        let (views, kind) = match &dataset.test {
            Some(test) if !self.volumes.is_empty() => (test, "test"),
            _ => (&dataset.train, "training"),
        };
        let mut stacks = vec![("measured", Cow::Borrowed(views))];
        if !self.volumes.is_empty() {
            stacks.push(("rendered", Cow::Owned(self.rendered(dataset, views)?)));
        }
        Scene::of_projections(&format!("Projections of the {kind} views"), stacks, &dataset.scanner, &dataset.frame)
    }

    /// Rendered projections over a whole turn.
    fn turntable(&self, dataset: &Dataset) -> Result<Scene<'static>> {
        let detector = &dataset.scanner.detector;
        let images = Array3::zeros((TURNTABLE, detector.rows, detector.columns));
        let views = Projections::new(Scanner::uniform_angles(TURNTABLE, 0.0, TAU), images)?;
        let stacks = vec![("rendered", Cow::Owned(self.rendered(dataset, &views)?))];
        Scene::of_projections("Turntable", stacks, &dataset.scanner, &dataset.frame)
    }

    /// The views rendered from the first volume, or from the primitives of its run; without both, from the true volume.
    fn rendered(&self, dataset: &Dataset, views: &Projections) -> Result<Projections> {
        let volume = self.volumes.first().map(|(_, volume)| volume).or(dataset.truth.as_ref());
        let Some(volume) = volume else {
            let expected = "a run or a volume beside a scan without a true volume";
            return Err(Error::invalid("projections to render", "a scan alone", expected, "name a run as well"));
        };
        reproject(dataset, views, volume, self.primitives.as_ref(), &self.config)
    }
}

/// Volumes on the grid of the first that states its spacing; without one, as they are.
fn on_one_grid(volumes: Vec<Named>) -> Result<Vec<(String, VolumeFile)>> {
    let stating = volumes.iter().find(|named| named.file.spacing.is_some());
    let Some(stating) = stating.filter(|_| volumes.len() > 1) else {
        return Ok(volumes.into_iter().map(|named| (named.name, named.file)).collect());
    };
    let (frame, grid) = Frame::around(&stating.file).map_err(|error| error.in_file(&stating.path))?;
    let of = |named: Named| Ok((named.name, frame.file(&arrange(&frame, named.file, &grid, &named.path)?)));
    volumes.into_iter().map(of).collect()
}

/// The name of a file or folder, without the folders above.
fn name(path: &Path) -> String {
    words::name(path.file_name().map_or(path, Path::new))
}

fn depth(text: &str) -> std::result::Result<Depth, String> {
    match text {
        "8" => Ok(Depth::Eight),
        "16" => Ok(Depth::Sixteen),
        _ => Err("expected 8 or 16".into()),
    }
}

fn water(text: &str) -> std::result::Result<f64, String> {
    finite(text).ok().filter(|value| *value > 0.0).ok_or_else(|| "expected a positive number".into())
}
