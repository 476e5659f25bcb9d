//! `trgs inspect`: a summary of a file or folder, and its unusual properties.

mod files;

use super::flags::with_flags;
use super::geometry_check::check_geometry;
use super::{Global, Output};
use clap::Args;
use serde_json::{Value, json};
use std::ffi::OsStr;
use std::path::{Path, PathBuf};
use trgs::config::{Config, Method};
use trgs::geometry::{Beam, Projections, Scanner, Volume};
use trgs::primitives::{Group, KernelKind, Primitives};
use trgs::provenance::Provenance;
use trgs::scan::npy::{self, Npy, Numbers};
use trgs::scan::npz::Npz;
use trgs::scan::stack::RtkGeometry;
use trgs::scan::volume_file::NpySide;
use trgs::scan::{Dataset, Frame, array_path, model, plausibility, trajectory, volume_file};
use trgs::words::{counted, verb};
use trgs::{Error, Result};

/// Ratio of longest to shortest scale from which on a primitive counts as a needle.
const NEEDLE: f64 = 1000.0;

/// Print a summary of a dataset, run, model, volume, stack or list of angles, with its unusual properties
#[derive(Args)]
#[command(after_help = "Examples:
  trgs inspect data/torso
  trgs inspect chest.pickle
  trgs inspect out/torso/model.npz --json
  trgs inspect volume.nii.gz
  trgs inspect frames
  trgs inspect angles.csv
  trgs inspect data/torso --check-geometry

All files that trgs convert reads are read; angles are .txt or .csv.")]
pub(super) struct Inspect {
    /// Folder of a scan or a run, or a file
    #[arg(value_name = "DATASET|RUN|FILE")]
    path: PathBuf,
    /// Detect flipped axes, reversed rotation and a shifted detector; exit with code 1 if there are any; takes ten seconds
    #[arg(long)]
    check_geometry: bool,
}

impl Inspect {
    pub(super) fn run(&self, global: &Global) -> Result<Output> {
        let path = self.path.as_path();
        if self.check_geometry {
            return check_geometry(path, global);
        }
        let found = match path.extension().and_then(OsStr::to_str) {
            _ if path.join("meta_data.json").exists() => dataset(path)?,
            _ if array_path::is_hdf5(path) => files::hdf5(path)?,
            _ if path.join("provenance.json").exists() => run_folder(path)?,
            Some("json") => dataset(path)?,
            Some("pickle" | "pkl") => pickle(path)?,
            Some("xml") => geometry(path)?,
            Some("npz") => archive(path)?,
            Some("npy") => array(path)?,
            Some("ply") => of_model(&model::read(path)?),
            Some("txt" | "csv") => files::angles(path)?,
            _ => {
                let is_folder = std::fs::metadata(path).map_err(|source| Error::read(path, source))?.is_dir();
                if !is_folder && !volume_file::has_known_ending(path) {
                    let expected = "a folder of a scan, a run or images, or a file .json, .pickle, .xml, .npz, .npy, .ply, \
                                    .txt or .csv, or a volume";
                    let remedy = "give one of these; trgs help convert lists the formats of volumes";
                    return Err(Error::invalid("path to inspect", path.display(), expected, remedy));
                }
                files::volume(path)?
            }
        };
        Ok(Output::list(&found))
    }
}

fn dataset(path: &Path) -> Result<Value> {
    let dataset = Dataset::read(path)?;
    let implausible: Vec<_> = plausibility::remarks(&dataset).iter().map(with_flags).collect();
    let Dataset { name, scanner, frame, noise, train, test, truth, initial_points, notes, mut oddities, .. } = dataset;
    oddities.extend(implausible);
    let (d, grid) = (scanner.detector, scanner.grid);
    let poses = trajectory::words(&scanner, &train);
    let beam = match scanner.beam {
        Beam::Cone { dso, dsd } => json!({ "kind": "cone", "dso": dso, "dsd": dsd }),
        Beam::Parallel { .. } => json!({ "kind": "parallel" }),
    };
    let views = |views: &Projections| json!({ "views": views.len(), "values": range(&views.images) });
    let negative = |views: &Projections| views.images.iter().filter(|value| **value < 0.0).count();
    let below_zero = negative(&train);
    if below_zero > 0 {
        let (pixels, are) = (counted(below_zero, "pixel"), verb(below_zero, "is", "are"));
        oddities.push(format!("{pixels} of the training views {are} negative"));
    }
    let mut found = json!({
        "kind": "dataset",
        "name": name,
        "beam": beam,
        "detector": { "rows": d.rows, "columns": d.columns, "pitch_v": d.pitch_v, "pitch_u": d.pitch_u,
                      "offset_v": d.offset_v, "offset_u": d.offset_u },
        "grid": { "shape": grid.shape, "min": grid.min.to_array(), "max": grid.max().to_array() },
        "scene_units_per_unit_of_the_files": frame.scale,
        "unit_of_the_files": frame.unit_words(),
        "in_unit_of_the_files": lengths(&scanner, &frame),
        "noise": noise.to_string(),
        "train": views(&train),
        "test": test.as_ref().map(views),
        "truth": truth.map(|Volume { values, .. }| json!({ "values": range(&values) })),
        "initial_points": initial_points.map(|points| points.nrows()),
        "notes": notes,
        "oddities": oddities,
    });
    if let (Some(found), Some(poses)) = (found.as_object_mut(), poses) {
        found.insert("poses".into(), json!(poses));
    }
    Ok(found)
}

/// The lengths of a scan in the unit of its files, and the place of its volume.
fn lengths(scanner: &Scanner, frame: &Frame) -> Value {
    let (d, (spacing, origin)) = (scanner.detector, frame.place(&scanner.grid));
    let length = |scene: f64| frame.length(scene);
    let mut found = match scanner.beam {
        Beam::Cone { dso, dsd } => json!({ "dso": length(dso), "dsd": length(dsd) }),
        Beam::Parallel { .. } => json!({}),
    };
    let rest = json!({
        "pixel": [length(d.pitch_v), length(d.pitch_u)],
        "voxel": spacing.to_array(),
        "first_voxel": origin.to_array(),
        "directions": (frame.directions != volume_file::STRAIGHT).then(|| frame.directions.to_cols_array()),
    });
    if let (Some(found), Value::Object(rest)) = (found.as_object_mut(), rest) {
        found.extend(rest);
    }
    found
}

/// A geometry file of RTK.
fn geometry(path: &Path) -> Result<Value> {
    let RtkGeometry { poses, oddities } = RtkGeometry::read(path)?;
    let angles: Vec<f64> = poses.iter().map(|pose| pose.angle().to_degrees()).collect();
    let heights: Vec<f64> = poses.iter().map(|pose| pose.source.z).collect();
    Ok(json!({
        "kind": "geometry of RTK",
        "views": poses.len(),
        "angles_in_degrees": range(&angles),
        "heights_of_the_source": range(&heights),
        "oddities": oddities,
    }))
}

/// A scan of NAF, or a point cloud of R²-Gaussian: they share the extension.
fn pickle(path: &Path) -> Result<Value> {
    dataset(path).or_else(|error| model::read(path).map(|primitives| of_model(&primitives)).map_err(|_| error))
}

fn run_folder(path: &Path) -> Result<Value> {
    let config = Config::read(path.join("config.toml"), Method::TrGs)?;
    let provenance: Provenance = read_json(&path.join("provenance.json"))?;
    let metrics: Value = read_json(&path.join("metrics.json"))?;
    let changed = provenance.changed(path);
    let oddities: Vec<_> = changed.iter().map(|name| format!("{name} is not the file that the run wrote")).collect();
    // Runs of older versions have no place.
    let place: Option<Value> =
        NpySide::path(&path.join("volume.npy")).exists().then(|| read_place(path)).transpose()?;
    Ok(json!({
        "kind": "run",
        "method": config.method,
        "version": provenance.version,
        "command": provenance.command_line(),
        "metrics": metrics,
        "volume": place,
        "oddities": oddities,
    }))
}

/// Spacing, first voxel and unit of the volume of a run.
fn read_place(run: &Path) -> Result<Value> {
    let mut place: Value = read_json(&NpySide::path(&run.join("volume.npy")))?;
    if let Some(place) = place.as_object_mut() {
        place.entry("unit").or_insert_with(|| "not stated".into());
    }
    Ok(place)
}

fn archive(path: &Path) -> Result<Value> {
    let npz = Npz::read(path)?;
    let keys: Vec<&str> = npz.keys().collect();
    // A gradient has the keys of a model too, but not its positive scales.
    if Group::ALL.iter().filter(|group| **group != Group::Nu).all(|group| keys.contains(&group.key())) {
        return Ok(match model::read(path) {
            Ok(primitives) => of_model(&primitives),
            Err(error) => json!({
                "kind": "archive with the arrays of a model, or gradient of one",
                "arrays": arrays(&npz),
                "oddities": [format!("not usable as a model: {}", with_flags(&error.text()))],
            }),
        });
    }
    if keys.contains(&"xyz") && keys.contains(&"rotation") {
        return Ok(of_model(&model::read(path)?));
    }
    Ok(json!({ "kind": "archive", "arrays": arrays(&npz) }))
}

fn arrays(npz: &Npz) -> Value {
    npz.keys().filter_map(|key| Some((key.to_owned(), of_array(npz.entry(key)?)))).collect()
}

fn of_model(primitives: &Primitives) -> Value {
    let p = &primitives.parameters;
    let count = |what: &str, n: usize| (n > 0).then(|| format!("{n} of {} {what}", counted(p.len(), "primitive")));
    let outside = p.mean.iter().filter(|mean| mean.iter().any(|x| x.abs() > 1.0)).count();
    let needles = p.scale.iter().filter(|s| s.iter().any(|a| s.iter().any(|b| *a > NEEDLE * b))).count();
    let oddities = [
        p.is_empty().then(|| "there is no primitive".into()),
        count("have their centre outside the cube from -1 to 1", outside),
        count("have a negative density", p.density.iter().filter(|density| **density < 0.0).count()),
        count(&format!("have scales that differ by more than a factor of {NEEDLE}"), needles),
    ];
    let values = |group: Group| (group.key().to_owned(), range(p.group(group)));
    let finite =
        Group::ALL.into_iter().filter(|group| !(primitives.kernel == KernelKind::Gaussian && *group == Group::Nu));
    json!({
        "kind": "model",
        "kernel": match primitives.kernel { KernelKind::StudentT => "student-t", KernelKind::Gaussian => "gaussian" },
        "primitives": p.len(),
        "values": finite.map(values).collect::<Value>(),
        "oddities": oddities.into_iter().flatten().collect::<Vec<_>>(),
    })
}

fn array(path: &Path) -> Result<Value> {
    let array = npy::read(path)?;
    let kind = match array.numbers.shape().len() {
        3 => "array: a volume [x, y, z] or projections [view, v, u]",
        2 => "array: a projection [v, u], or initial points [M, 4]",
        _ => "array",
    };
    let mut found = json!({ "kind": kind });
    if let (Some(found), Value::Object(values)) = (found.as_object_mut(), of_array(&array)) {
        found.extend(values);
    }
    Ok(found)
}

fn of_array(array: &Npy) -> Value {
    let (values, not_finite) = match &array.numbers {
        Numbers::F32(values) => (range(values), values.iter().filter(|value| !value.is_finite()).count()),
        Numbers::F64(values) => (range(values), values.iter().filter(|value| !value.is_finite()).count()),
    };
    let constant = matches!(values.as_array().map(Vec::as_slice), Some([low, high]) if low == high);
    let oddities = [
        (not_finite > 0).then(|| format!("{not_finite} values are not finite")),
        constant.then(|| "all values are equal".into()),
        array.full_scale.map(|full| format!("integers of a type with maximum {full}: possibly not attenuation")),
    ];
    json!({
        "shape": array.numbers.shape(),
        "precision": if array.numbers.is_double() { "f64" } else { "f32" },
        "values": values,
        "oddities": oddities.into_iter().flatten().collect::<Vec<_>>(),
    })
}

/// The smallest and the largest finite value; null if there is none.
fn range<'a, T: Copy + Into<f64> + 'a>(values: impl IntoIterator<Item = &'a T>) -> Value {
    let finite = values.into_iter().map(|value| (*value).into()).filter(|value: &f64| value.is_finite());
    let ends = finite.fold(None, |ends: Option<[f64; 2]>, value| {
        let [low, high] = ends.unwrap_or([value; 2]);
        Some([low.min(value), high.max(value)])
    });
    json!(ends)
}

fn read_json<T: serde::de::DeserializeOwned>(path: &Path) -> Result<T> {
    let text = std::fs::read(path).map_err(|source| Error::read(path, source))?;
    serde_json::from_slice(&text).map_err(|error| {
        Error::format(path, "file", error, "JSON as a run writes it", "restore the file or repeat the run")
    })
}
