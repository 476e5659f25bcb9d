//! `meta_data.json` and the interpretation of its fields.

use super::fields::{self, SCANNER_FIELDS, VIEW_FIELDS, is_neutral};
use super::numbers::{self, EXACT, ROUNDED, counts, opposite, pitches, sizes};
use super::poses::{self, Axes, Motion, PerView, Words};
use crate::frame::{Frame, FrameMeta};
use crate::noise::{Attenuation, Noise};
use crate::output::write_atomically;
use glam::DVec3;
use serde::{Deserialize, Serialize};
use serde_json::Value;
use std::collections::BTreeMap;
use std::path::Path;
use trgs_core::error::{Error, Result};
use trgs_core::geometry::{Beam, Detector, Grid, Pose, Scanner};
use trgs_core::words::utf8;

/// Value of `noise_model` for the Beer-Lambert law.
const PHYSICAL: &str = "physical";

/// Distance from source to axis where a parallel scan states none, scene units. No value depends on it.
const PARALLEL_DSO: f64 = 5.0;

/// The whole file. Fields not listed here are not read: see [`super::fields`].
#[derive(Debug, Serialize, Deserialize)]
pub(super) struct Meta {
    pub(super) scanner: ScannerMeta,
    /// The volume's file, relative to the folder.
    pub(super) vol: Option<String>,
    /// Another name for `vol`, written by R²-Gaussian's generator for real data.
    #[serde(skip_serializing)]
    pub(super) ct: Option<String>,
    /// `[[min], [max]]` of the volume, x, y, z.
    pub(super) bbox: Option<[[f64; 3]; 2]>,
    #[serde(default)]
    pub(super) proj_train: Vec<ViewMeta>,
    #[serde(default)]
    pub(super) proj_test: Vec<ViewMeta>,
    /// Facts needed to judge results, one sentence each. This project's own key.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub(super) notes: Vec<String>,
    /// The unit of the lengths. This project's own key.
    #[serde(default, skip_serializing)]
    unit: Option<String>,
    /// Unit and place of the files that a scan in scene units came from. This project's own key.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    frame: Option<FrameMeta>,
    /// Remarks on fields that are not read.
    #[serde(skip)]
    unread: Vec<String>,
}

/// One projection.
#[derive(Debug, Serialize, Deserialize)]
pub(super) struct ViewMeta {
    /// Path relative to the folder.
    pub(super) file_path: String,
    /// Radians. A view with a vector or a matrix may leave it out.
    pub(super) angle: Option<f64>,
    /// Source (parallel beam: direction of the rays), detector's centre, u and v, as ASTRA's `cone_vec`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(super) vector: Option<Vec<f64>>,
    /// From lengths of the file to (column, row), 3 × 4.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    matrix: Option<Vec<Vec<f64>>>,
    /// Distance from source to axis, written by R²-Gaussian's generator for real data.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) radius: Option<f64>,
}

/// The scanner, in any one unit of length. The order of the axes differs between fields.
#[derive(Debug, Serialize, Deserialize)]
pub(super) struct ScannerMeta {
    /// `cone` or `parallel`.
    mode: String,
    /// The unit of the lengths, another place for that of the file.
    #[serde(default, skip_serializing)]
    unit: Option<String>,
    /// Source to detector.
    #[serde(rename = "DSD")]
    dsd: Option<PerView<f64>>,
    /// Source to rotation axis.
    #[serde(rename = "DSO")]
    dso: Option<PerView<f64>>,
    /// Pixels, `[v, u]`.
    #[serde(rename = "nDetector", serialize_with = "as_integers")]
    n_detector: Vec<f64>,
    /// Total size, `[v, u]`.
    #[serde(rename = "sDetector")]
    s_detector: Vec<f64>,
    /// Pixel size, `[v, u]`.
    #[serde(rename = "dDetector")]
    d_detector: Option<Vec<f64>>,
    /// Voxels, `[x, y, z]`.
    #[serde(rename = "nVoxel", serialize_with = "as_integers")]
    n_voxel: Vec<f64>,
    /// Total size, `[x, y, z]`.
    #[serde(rename = "sVoxel")]
    s_voxel: Vec<f64>,
    /// Voxel size, `[x, y, z]`.
    #[serde(rename = "dVoxel")]
    d_voxel: Option<Vec<f64>>,
    /// Centre of the volume, `[x, y, z]`.
    #[serde(rename = "offOrigin")]
    off_origin: Option<Axes>,
    /// Shift of the detector, `[u, upwards]`.
    ///
    /// The format passes it to TIGRE, which moves the detector towards +z, opposite to v of the geometry page.
    /// R²-Gaussian stores rows from the top but keeps the sign of this shift.
    #[serde(rename = "offDetector")]
    off_detector: Option<Axes>,
    /// Shift of source and detector along u.
    #[serde(rename = "COR", default, skip_serializing_if = "Option::is_none")]
    axis_shift: Option<PerView<f64>>,
    /// Turns of the detector about z, y and x at angle 0, radians.
    #[serde(rename = "rotDetector", default, skip_serializing_if = "Option::is_none")]
    rot_detector: Option<Axes>,
    /// A vector for each view, training views first: see [`ViewMeta`].
    #[serde(default, skip_serializing_if = "Option::is_none")]
    vectors: Option<Vec<Vec<f64>>>,
    /// A matrix for each view, training views first.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    matrices: Option<Vec<Vec<Vec<f64>>>>,
    /// Step of an interpolating projector, in voxels. Unused here; other readers require it.
    #[serde(default)]
    accuracy: Option<f64>,
    /// Span of the training views, degrees.
    #[serde(rename = "totalAngle", default)]
    total_angle: Option<f64>,
    /// First training view, degrees.
    #[serde(rename = "startAngle", default)]
    start_angle: Option<f64>,
    /// Whether noise was added.
    #[serde(default)]
    noise: Value,
    /// Photons per pixel. The spelling is the format's.
    #[serde(default)]
    possion_noise: Value,
    /// `[mean, standard deviation]` in counts.
    #[serde(default)]
    gaussian_noise: Value,
    /// `physical` if photons follow the Beer-Lambert law; absent for TIGRE's noise. This project's own key.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    noise_model: Option<String>,
    /// Window of the ramp filter, or null.
    #[serde(default)]
    filter: Option<String>,
}

/// A scanner in scene units, and the scale that converts lengths of the file.
#[derive(Debug)]
pub(super) struct Interpreted {
    pub(super) scanner: Scanner,
    /// Scene units per unit of the file.
    pub(super) scale: f64,
    pub(super) frame: Frame,
    pub(super) noise: Noise,
    /// Poses of the views, if they are no circle.
    pub(super) motion: Motion,
    pub(super) oddities: Vec<String>,
}

/// The names of the fields that are read.
const FILE_FIELDS: [&str; 9] = ["scanner", "vol", "ct", "bbox", "proj_train", "proj_test", "notes", "unit", "frame"];

impl Meta {
    pub(super) fn read(path: &Path) -> Result<Self> {
        Self::parse(&crate::input::read(path).map_err(|source| Error::read(path, source))?, path)
    }

    /// Parses the file's content; `path` names it in errors.
    pub(super) fn parse(text: &[u8], path: &Path) -> Result<Self> {
        let text = &*utf8(text);
        let wrong = |error: serde_json::Error| {
            Error::format(
                path,
                "scan description",
                error,
                "JSON with the scanner's fields and the lists proj_train and proj_test",
                "write it like one of `trgs simulate`",
            )
        };
        let value: Value = serde_json::from_slice(text).map_err(wrong)?;
        numbers::check(&value).map_err(|error| error.in_file(path))?;
        let mut meta: Self = serde_json::from_slice(text).map_err(wrong)?;
        meta.unread = unread(&value).map_err(|error| error.in_file(path))?;
        meta.gather().map_err(|error| error.in_file(path))?;
        for view in meta.proj_train.iter_mut().chain(&mut meta.proj_test) {
            view.file_path = with_slashes(&view.file_path);
        }
        for file in [&mut meta.vol, &mut meta.ct].into_iter().flatten() {
            *file = with_slashes(file);
        }
        Ok(meta)
    }

    /// The file of a scan, whose views have vectors where they have poses; `bbox` and lengths in scene units.
    pub(super) fn new(
        scanner: ScannerMeta,
        vol: Option<String>,
        bbox: [[f64; 3]; 2],
        [proj_train, proj_test]: [Vec<ViewMeta>; 2],
        notes: Vec<String>,
        frame: &Frame,
    ) -> Self {
        let (bbox, frame) = (Some(bbox), FrameMeta::of(frame));
        Self { scanner, vol, ct: None, bbox, proj_train, proj_test, notes, unit: None, frame, unread: Vec::new() }
    }

    pub(super) fn write(&self, path: &Path) -> Result<()> {
        write_atomically(path, |file| Ok(serde_json::to_writer_pretty(file, self)?))
    }

    /// The scanner in scene units, checked; errors name `path`.
    pub(super) fn interpret(&self, path: &Path) -> Result<Interpreted> {
        let mut interpreted = self.scanner.interpret().map_err(|error| error.in_file(path))?;
        let stated: Vec<&str> = [&self.unit, &self.scanner.unit].into_iter().flatten().map(String::as_str).collect();
        let stated_frame = self.frame.clone().unwrap_or_default().frame(&stated, interpreted.scale);
        interpreted.frame = stated_frame.map_err(|error| error.in_file(path))?;
        let Interpreted { scanner, scale, motion, oddities, .. } = &mut interpreted;
        if !self.proj_train.is_empty() {
            motion.fits(self.proj_train.len(), self.proj_test.len()).map_err(|error| error.in_file(path))?;
        }
        let mut views = self.proj_train.iter().chain(&self.proj_test);
        if let (Some(view), false) = (views.find(|view| view.angle.is_none()), matches!(motion, Motion::Poses(_))) {
            let got = format!("none for {}", view.file_path);
            let expected = "radians, for each view without a vector or matrix";
            return Err(Error::format(path, "angle", got, expected, "add the angle of the view"));
        }
        oddities.extend(self.unread.iter().cloned());
        if let Some(corners) = self.bbox {
            let found = corners.map(|corner| DVec3::from_array(corner) * *scale);
            let expected = [scanner.grid.min, scanner.grid.max()];
            // The format's own generator writes this box in scene units, whatever unit the other fields have.
            let agrees = |found: [DVec3; 2]| (0..2).all(|i| (found[i] - expected[i]).abs().max_element() < 1e-3);
            if !agrees(found) && !agrees(corners.map(DVec3::from_array)) {
                oddities.push(format!("bbox {corners:?} is not offOrigin ± sVoxel/2; it is ignored"));
            }
        }
        let dso = scanner.beam.dso();
        let mut radii = self.proj_train.iter().chain(&self.proj_test).filter_map(|view| view.radius);
        if let Some(radius) = radii.find(|radius| [1.0, *scale].iter().all(|s| (radius * s - dso).abs() > 1e-3 * dso)) {
            oddities.push(format!("a view has the radius {radius}, which is not DSO; it is ignored"));
        }
        Ok(interpreted)
    }

    /// Moves the vectors and matrices of the views to the scanner's lists.
    fn gather(&mut self) -> Result<()> {
        let (vectors, matrices): (Vec<_>, Vec<_>) = self
            .proj_train
            .iter_mut()
            .chain(&mut self.proj_test)
            .map(|view| (view.vector.take(), view.matrix.take()))
            .unzip();
        let once = |is_stated: bool| match is_stated {
            false => Ok(()),
            true => {
                let expected = "poses in one place: in the views, or in the fields of scanner";
                Err(Error::invalid("poses", "lists in both places", expected, "remove one of them"))
            }
        };
        if let Some(vectors) = all_or_none("vector", vectors)? {
            once(self.scanner.vectors.is_some())?;
            self.scanner.vectors = Some(vectors);
        }
        if let Some(matrices) = all_or_none("matrix", matrices)? {
            once(self.scanner.matrices.is_some())?;
            self.scanner.matrices = Some(matrices);
        }
        Ok(())
    }
}

/// All the values, or `None` if there are none.
fn all_or_none<T>(name: &str, values: Vec<Option<T>>) -> Result<Option<Vec<T>>> {
    if values.iter().all(Option::is_none) {
        return Ok(None);
    }
    let (count, total) = (values.iter().flatten().count(), values.len());
    let all: Option<Vec<T>> = values.into_iter().collect();
    all.map(Some).ok_or_else(|| {
        let expected = format!("one in each of {total} views, or in none");
        Error::invalid(
            format!("{name} of the views"),
            format!("{count} of them"),
            expected,
            "add those that are missing",
        )
    })
}

impl ViewMeta {
    /// A view at `angle`, with its vector if there is one.
    pub(super) fn new(file_path: String, angle: f64, vector: Option<Vec<f64>>) -> Self {
        Self { file_path, angle: Some(angle), vector, matrix: None, radius: None }
    }
}

/// Remarks on the fields of a file that are not read.
fn unread(file: &Value) -> Result<Vec<String>> {
    let of = |place: &str, value: &Value, read: &[&str]| {
        let fields = value.as_object().into_iter().flatten();
        fields::unread(place, fields.map(|(name, value)| (name.as_str(), is_neutral(value))), read)
    };
    let mut remarks = of("the file", file, &FILE_FIELDS)?;
    remarks.extend(of(
        "scanner",
        &file["scanner"],
        &[&SCANNER_FIELDS[..], &fields::OF_GENERATORS, &["unit"]].concat(),
    )?);
    for list in ["proj_train", "proj_test"] {
        // One remark stands for all views; a field is neutral if it is so in all of them.
        let mut all: BTreeMap<&str, bool> = BTreeMap::new();
        for (name, value) in file[list].as_array().into_iter().flatten().filter_map(Value::as_object).flatten() {
            *all.entry(name).or_insert(true) &= is_neutral(value);
        }
        remarks.extend(fields::unread(list, all, &VIEW_FIELDS)?);
    }
    Ok(remarks)
}

/// A path as files written on Windows state it, with `/`.
fn with_slashes(path: &str) -> String {
    path.replace('\\', "/")
}

impl ScannerMeta {
    /// The `meta_data.json` of `scanner` in scene units, with `angles` (radians) as its training views.
    pub(super) fn describe(scanner: &Scanner, angles: &[f64], noise: Noise) -> Self {
        let Scanner { beam, detector: d, grid } = scanner;
        let (mode, dsd) = match *beam {
            Beam::Cone { dsd, .. } => ("cone", dsd),
            // It has no meaning in a parallel beam, but readers require it.
            Beam::Parallel { dso } => ("parallel", 2.0 * dso),
        };
        let n = angles.len() as f64;
        let first = angles.first().copied().unwrap_or(0.0);
        let gap = angles.get(1).map_or(0.0, |second| second - first);
        let uniform = gap > 0.0 && angles.windows(2).all(|pair| (pair[1] - pair[0] - gap).abs() < 1e-9);
        let (noisy, photons, sigma, model) = match noise {
            Noise::None => (false, 0.0, 0.0, None),
            Noise::Counts { photons, sigma, attenuation } => {
                (true, photons, sigma, (attenuation == Attenuation::Physical).then(|| PHYSICAL.into()))
            }
        };
        Self {
            mode: mode.into(),
            unit: None,
            dsd: Some(PerView::Same(dsd)),
            dso: Some(PerView::Same(beam.dso())),
            n_detector: vec![d.rows as f64, d.columns as f64],
            s_detector: vec![d.rows as f64 * d.pitch_v, d.columns as f64 * d.pitch_u],
            d_detector: Some(vec![d.pitch_v, d.pitch_u]),
            n_voxel: grid.shape.map(|n| n as f64).to_vec(),
            s_voxel: grid.size().to_array().to_vec(),
            d_voxel: Some(grid.spacing.to_array().to_vec()),
            off_origin: Some(PerView::Same((grid.min + grid.size() / 2.0).to_array().to_vec())),
            off_detector: Some(PerView::Same(vec![d.offset_u, opposite(d.offset_v)])),
            axis_shift: None,
            rot_detector: None,
            vectors: None,
            matrices: None,
            accuracy: Some(0.5),
            total_angle: Some(if uniform { (n * gap).to_degrees() } else { 360.0 }),
            start_angle: Some(first.to_degrees()),
            noise: noisy.into(),
            possion_noise: photons.into(),
            gaussian_noise: vec![0.0, sigma].into(),
            noise_model: model,
            filter: None,
        }
    }

    /// First view and span of all views, radians.
    pub(super) fn arc(&self) -> Option<(f64, f64)> {
        Some((self.start_angle.unwrap_or(0.0).to_radians(), self.total_angle?.to_radians()))
    }

    /// The scanner in scene units, checked.
    pub(super) fn interpret(&self) -> Result<Interpreted> {
        let mut oddities = Vec::new();
        let n_detector = counts("nDetector", &self.n_detector)?;
        let n_voxel = counts("nVoxel", &self.n_voxel)?;
        let s_voxel: [f64; 3] = sizes("sVoxel", &self.s_voxel)?;
        let s_detector: [f64; 2] = sizes("sDetector", &self.s_detector)?;
        let [pitch_v, pitch_u] = pitches("Detector", n_detector, s_detector, self.d_detector.as_deref())?;
        let spacing = pitches("Voxel", n_voxel, s_voxel, self.d_voxel.as_deref())?;
        let arrays = |axes: &Option<Axes>| axes.as_ref().map(|axes| axes.arrays("offOrigin")).transpose();
        let mut off_origin: Vec<[f64; 3]> = arrays(&self.off_origin)?.unwrap_or_default();
        let off_detector = self.off_detector.as_ref().map(|axes| axes.arrays("offDetector")).transpose()?;
        let mut off_detector: Vec<[f64; 2]> = off_detector.unwrap_or_default();
        let rot_detector = self.rot_detector.as_ref().map(|axes| axes.arrays("rotDetector")).transpose()?;

        let longest = DVec3::from_array(s_voxel).max_element();
        let scale = if (longest / 2.0 - 1.0).abs() < EXACT { 1.0 } else { 2.0 / longest };
        let spacing = DVec3::from_array(spacing) * scale;
        let size = spacing * DVec3::from_array(n_voxel.map(|n| n as f64));
        off_origin.iter_mut().flatten().for_each(|offset| *offset *= scale);
        off_detector.iter_mut().flatten().for_each(|offset| *offset *= scale);
        let centre = off_origin.first().map_or(DVec3::ZERO, |offset| DVec3::from_array(*offset));
        let grid = Grid { shape: n_voxel, min: centre - size / 2.0, spacing };
        let [rows, columns] = n_detector;
        let [offset_u, upwards] = off_detector.first().copied().unwrap_or_default();
        let offset_v = opposite(upwards);
        let detector =
            Detector { rows, columns, pitch_v: pitch_v * scale, pitch_u: pitch_u * scale, offset_u, offset_v };

        let lengths = |values: &Option<PerView<f64>>| -> Vec<f64> {
            values.iter().flat_map(PerView::numbers).map(|value| value * scale).collect()
        };
        let words = Words {
            dso: lengths(&self.dso),
            dsd: lengths(&self.dsd),
            off_detector,
            off_origin,
            axis_shift: lengths(&self.axis_shift),
            turns: rot_detector.unwrap_or_default(),
        };
        let distance = |name: &str, values: &[f64]| {
            values.first().copied().ok_or_else(|| {
                Error::invalid(name, "nothing", "a length: a cone beam needs it", "add it to the fields of scanner")
            })
        };
        // The beam's distances do not matter for the poses.
        let provisional = |beam: Beam| Scanner { beam, detector, grid };
        let mut poses = None;
        let beam = match self.mode.as_str() {
            "cone" => {
                let scanner = provisional(Beam::Cone { dso: 1.0, dsd: 1.0 });
                poses = self.stated_poses(&scanner, scale)?;
                match poses.as_ref().map(|poses| poses[0].view(&scanner, 0.0).beam) {
                    Some(first) if words.dso.is_empty() || words.dsd.is_empty() => first,
                    _ => Beam::Cone { dso: distance("DSO", &words.dso)?, dsd: distance("DSD", &words.dsd)? },
                }
            }
            "parallel" => {
                // R²-Gaussian renders parallel views on a detector as wide as the volume, whatever the file states.
                if s_detector.iter().any(|s| (s / longest - 1.0).abs() > ROUNDED) {
                    oddities.push(format!(
                        "parallel beam with sDetector {s_detector:?} and max(sVoxel) {longest}: sDetector is used; \
                         R²-Gaussian would use the size of the volume"
                    ));
                }
                Beam::Parallel { dso: words.dso.first().copied().unwrap_or(PARALLEL_DSO) }
            }
            other => {
                return Err(Error::invalid(
                    "mode",
                    format!("{other:?}"),
                    "\"cone\" or \"parallel\"",
                    "correct mode in the scanner's fields",
                ));
            }
        };
        let scanner = provisional(beam);
        if matches!(beam, Beam::Parallel { .. }) {
            poses = self.stated_poses(&scanner, scale)?;
        }
        scanner.validate()?;
        let motion = match (poses, Motion::of(&scanner, &words)?) {
            (None, motion) => motion,
            (Some(poses), Motion::Circle) => Motion::Poses(poses),
            (Some(_), Motion::Deviations(_) | Motion::Poses(_)) => {
                let got = "vectors or matrices, and COR, rotDetector or numbers per view";
                let remedy = "remove one of them: vectors and matrices state whole poses";
                return Err(Error::invalid("poses", got, "one statement of the poses", remedy));
            }
        };
        Ok(Interpreted { scanner, scale, frame: Frame::scaled(scale), noise: self.noise(), motion, oddities })
    }

    /// The poses of the lists of vectors or matrices.
    fn stated_poses(&self, scanner: &Scanner, scale: f64) -> Result<Option<Vec<Pose>>> {
        let numbered =
            |(number, pose): (usize, Result<Pose>)| pose.map_err(|error| error.within(format!("view {number}")));
        let poses: Vec<Pose> = match (&self.vectors, &self.matrices) {
            (None, None) => return Ok(None),
            (Some(vectors), None) => {
                let pose = |vector: &Vec<f64>| poses::of_vector(scanner, vector, scale);
                vectors.iter().map(pose).enumerate().map(numbered).collect::<Result<_>>()?
            }
            (None, Some(matrices)) => {
                let pose = |matrix: &Vec<Vec<f64>>| poses::of_matrix(scanner, matrix, scale);
                matrices.iter().map(pose).enumerate().map(numbered).collect::<Result<_>>()?
            }
            (Some(_), Some(_)) => {
                return Err(Error::invalid("poses", "vectors and matrices", "one of the two", "remove the other"));
            }
        };
        if poses.is_empty() {
            let expected = "one for each view";
            return Err(Error::invalid(
                "vectors or matrices",
                "an empty list",
                expected,
                "fill the list, or remove it",
            ));
        }
        Ok(Some(poses))
    }

    /// The stated noise; [`Noise::None`] if it is missing or has another form.
    fn noise(&self) -> Noise {
        let number = |value: &Value| value.as_f64().filter(|number| *number >= 0.0);
        match (self.noise.as_bool(), number(&self.possion_noise), self.gaussian_noise.get(1).and_then(number)) {
            (Some(true), Some(photons), Some(sigma)) if photons > 0.0 => {
                let noise = Noise::relative(photons, sigma);
                if self.noise_model.as_deref() == Some(PHYSICAL) { noise.physical() } else { noise }
            }
            _ => Noise::None,
        }
    }
}

/// Writes counts as integers: Python accepts 64 as a size of an array, but not 64.0.
fn as_integers<S: serde::Serializer>(counts: &[f64], serializer: S) -> std::result::Result<S::Ok, S::Error> {
    serializer.collect_seq(counts.iter().map(|count| *count as u64))
}
