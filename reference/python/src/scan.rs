//! Scans: reading, simulation, evaluation, and reconstruction by any method.

use crate::arrays::{self, copy, give, named, read, word, wrong_type, wrong_value};
use crate::classical::{measured, pass_event, trial_event};
use crate::geometry::{Grid, Scanner};
use crate::model::Model;
use crate::views::vectors;
use crate::work::{Event, Watch, python, raise, run, try_run};
use glam::DMat3;
use ndarray::{Array1, Ix2, Ix3};
use pyo3::exceptions::PyUserWarning;
use pyo3::prelude::*;
use pyo3::types::{PyBool, PyDict, PyList, PyString, PyTuple};
use serde_json::json;
use std::ffi::CString;
use std::path::PathBuf;
use trgs::classical::RayModel;
use trgs::reconstruction::{self, Checkpoints, Progress};
use trgs::scan::corrections::{Corrections, PixelCorrection};
use trgs::scan::phantom::{PHANTOMS, Phantom};
use trgs::scan::simulate::{self, Object, Plan};
use trgs::scan::volume_file::VolumeFile;
use trgs::scan::{Frame, Noise, Unit, plausibility, volume_file};
use trgs::words::visible;
use trgs::{Config, Dataset, Method, Projections, Run, Volume};

/// Models of the rays through a simulated volume; the first is not one of constant voxels or planes.
const SIMULATED_RAYS: [(&str, Option<RayModel>); 3] =
    [("trilinear", None), ("siddon", Some(RayModel::Siddon)), ("joseph", Some(RayModel::Joseph))];

/// Projections with their geometry, and the true volume if it is known.
///
/// Read by `load_scan`, made by `simulate`, or from arrays. An attribute that is an array is a read-only copy. What is
/// implausible about the values that are given is a warning.
///
/// Parameters
/// ----------
/// scanner : Scanner
/// angles : sequence of float, or array [view, 12]
///     Of the views, radians, or vectors of poses: as of `project`.
/// projections : ndarray [view, v, u], float32
///     Line integrals, scene units of length times density.
/// truth : ndarray [x, y, z], float32, optional
///     The true volume, attenuation per scene unit.
/// test_angles : sequence of float, or array [view, 12], optional
/// test_projections : ndarray [view, v, u], float32, optional
///     Views to judge by.
/// name : str
///
/// Raises
/// ------
/// TypeError
///     For arrays of another type or number of axes.
/// ValueError
///     For shapes that do not fit the scanner, and numbers that are not finite.
#[pyclass(frozen, module = "trgs")]
pub(crate) struct Scan(pub(crate) Dataset);

fn views(scanner: &Scanner, projections: &Bound<'_, PyAny>, angles: &Bound<'_, PyAny>) -> PyResult<Projections> {
    let measured = measured(projections, scanner, angles)?;
    let expected = [measured.angles.len(), scanner.0.detector.rows, scanner.0.detector.columns];
    let remedy = "give one image [v, u] of the scanner's detector per angle";
    arrays::check_shape("projections", measured.images.shape(), &expected, remedy)?;
    Ok(measured)
}

fn volume(grid: trgs::Grid, values: &Bound<'_, PyAny>, what: &str) -> PyResult<Volume> {
    let values = read::<f32, Ix3>(values, what, "[x, y, z]")?;
    Volume::new(grid, values.as_array().to_owned()).map_err(raise)
}

#[pymethods]
impl Scan {
    #[new]
    #[allow(clippy::too_many_arguments)]
    #[pyo3(signature = (scanner, angles, projections, *, truth = None, test_angles = None, test_projections = None,
        name = "scan"))]
    fn new(
        py: Python<'_>,
        scanner: &Scanner,
        angles: &Bound<'_, PyAny>,
        projections: &Bound<'_, PyAny>,
        truth: Option<&Bound<'_, PyAny>>,
        test_angles: Option<&Bound<'_, PyAny>>,
        test_projections: Option<&Bound<'_, PyAny>>,
        name: &str,
    ) -> PyResult<Self> {
        let test = match (test_angles, test_projections) {
            (Some(angles), Some(projections)) => Some(views(scanner, projections, angles)?),
            (None, None) => None,
            _ => {
                let remedy = "give test_angles and test_projections, or neither";
                return Err(wrong_value("test views", "one of angles and projections", "both", remedy));
            }
        };
        let scan = Self(Dataset {
            name: name.into(),
            scanner: scanner.0,
            scale: 1.0,
            frame: Frame::default(),
            noise: Noise::None,
            train: views(scanner, projections, angles)?,
            test,
            truth: truth.map(|truth| volume(scanner.0.grid, truth, "truth")).transpose()?,
            initial_points: None,
            notes: Vec::new(),
            oddities: Vec::new(),
        });
        scan.remarks(py)?.iter().try_for_each(|remark| warn(py, remark))?;
        Ok(scan)
    }

    /// The name: of a scan that was read, its folder's.
    #[getter]
    fn name(&self) -> &str {
        &self.0.name
    }

    /// Beam, detector and volume, scene units.
    #[getter]
    fn scanner(&self) -> Scanner {
        Scanner(self.0.scanner)
    }

    /// Scene units per unit of length of the files; attenuation is per this unit.
    #[getter]
    fn scale(&self) -> f64 {
        self.0.frame.scale
    }

    /// The unit of length of the files, such as "mm", or None if they do not state it.
    #[getter]
    fn unit(&self) -> Option<&'static str> {
        self.0.frame.unit.map(Unit::symbol)
    }

    /// The place of the volume in the unit of length: spacing, origin (the centre of the first voxel) and directions (a
    /// unit vector for each axis), in the coordinates of ITK.
    #[getter]
    fn place(&self) -> ([f64; 3], [f64; 3], [[f64; 3]; 3]) {
        let (spacing, origin) = self.0.frame.place(&self.0.scanner.grid);
        (spacing.to_array(), origin.to_array(), self.0.frame.directions.to_cols_array_2d())
    }

    /// Of the training views, radians: float64 [view]. With `poses` they are labels.
    #[getter]
    fn angles<'py>(&self, py: Python<'py>) -> Bound<'py, PyAny> {
        copy(py, Array1::from(self.0.train.angles.clone()))
    }

    /// Poses of the training views as `Scanner.from_vectors` takes them: float64 [view, 12], or None of a circle. Where they
    /// are not None, functions need them instead of the angles.
    #[getter]
    fn poses<'py>(&self, py: Python<'py>) -> Option<Bound<'py, PyAny>> {
        vectors(py, &self.0.scanner, self.0.train.trajectory())
    }

    /// Poses of the test views: float64 [view, 12], or None.
    #[getter]
    fn test_poses<'py>(&self, py: Python<'py>) -> Option<Bound<'py, PyAny>> {
        vectors(py, &self.0.scanner, self.0.test.as_ref()?.trajectory())
    }

    /// Training views: float32 [view, v, u], scene units of length times density.
    #[getter]
    fn projections<'py>(&self, py: Python<'py>) -> Bound<'py, PyAny> {
        copy(py, self.0.train.images.clone())
    }

    /// Of the test views, radians: float64 [view], or None.
    #[getter]
    fn test_angles<'py>(&self, py: Python<'py>) -> Option<Bound<'py, PyAny>> {
        self.0.test.as_ref().map(|test| copy(py, Array1::from(test.angles.clone())))
    }

    /// Test views: float32 [view, v, u], or None.
    #[getter]
    fn test_projections<'py>(&self, py: Python<'py>) -> Option<Bound<'py, PyAny>> {
        self.0.test.as_ref().map(|test| copy(py, test.images.clone()))
    }

    /// The true volume: float32 [x, y, z], attenuation per scene unit, or None.
    #[getter]
    fn truth<'py>(&self, py: Python<'py>) -> Option<Bound<'py, PyAny>> {
        self.0.truth.as_ref().map(|truth| copy(py, truth.values.clone()))
    }

    /// Facts needed to judge results on this scan, one sentence each.
    #[getter]
    fn notes(&self) -> Vec<String> {
        self.0.notes.clone()
    }

    /// Unusual properties of the files, one sentence each.
    #[getter]
    fn oddities(&self) -> Vec<String> {
        self.0.oddities.clone()
    }

    /// What is implausible about the values, one sentence each, with the remedy.
    #[getter]
    fn remarks(&self, py: Python<'_>) -> PyResult<Vec<String>> {
        try_run(py, || Ok(plausibility::remarks(&self.0).iter().map(ToString::to_string).collect()))
    }

    /// The scan with corrected projections; `notes` say what was changed.
    ///
    /// Parameters
    /// ----------
    /// air : "auto" or float, optional
    ///     The line integral of air to subtract: "auto" measures it at the borders, for each view if it varies.
    /// mask_pixels : "auto" or ndarray [v, u], bool, optional
    ///     The pixels to interpolate from their neighbours: "auto" finds those that differ from them in all views.
    ///
    /// Returns
    /// -------
    /// Scan
    ///
    /// Raises
    /// ------
    /// TypeError
    ///     For arguments of another type.
    /// ValueError
    ///     For air that no border sees, and a mask of another shape.
    #[pyo3(signature = (*, air = None, mask_pixels = None))]
    fn correct(
        &self,
        py: Python<'_>,
        air: Option<&Bound<'_, PyAny>>,
        mask_pixels: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<Self> {
        let word = |value: &Bound<'_, PyAny>| value.cast::<PyString>().ok().map(|text| text.to_string());
        let air = match air {
            None => None,
            Some(value) => Some(match (word(value), value.extract::<f64>()) {
                (Some(text), _) => text.parse().map_err(raise)?,
                (None, Ok(number)) => number.to_string().parse().map_err(raise)?,
                (None, Err(_)) => return Err(wrong_type("air", value, "\"auto\" or a number", "give one of them")),
            }),
        };
        let pixels = match mask_pixels {
            None => None,
            Some(value) if word(value).as_deref() == Some("auto") => Some(PixelCorrection::Auto),
            Some(value) => {
                let mask = read::<bool, Ix2>(value, "mask_pixels", "[v, u]")?;
                Some(PixelCorrection::Mask(mask.as_array().to_owned()))
            }
        };
        let mut scan = self.0.clone();
        try_run(py, || scan.correct(&Corrections { air, pixels }))?;
        Ok(Self(scan))
    }

    /// Writes the scan as a folder in the format of R²-Gaussian, as a whole or not at all.
    ///
    /// Parameters
    /// ----------
    /// folder : str or os.PathLike
    ///
    /// Raises
    /// ------
    /// OSError
    ///     For a folder that cannot be written.
    /// ValueError
    ///     For a folder that holds other files.
    fn save(&self, py: Python<'_>, folder: PathBuf) -> PyResult<()> {
        try_run(py, || self.0.write(&folder))
    }

    /// Metrics of a volume, and of the projections of a model or else of the volume.
    ///
    /// Parameters
    /// ----------
    /// volume : ndarray [x, y, z], float32
    ///     On the scanner's grid.
    /// model : Model, optional
    ///     The primitives that the volume came from, whose projections are compared with the test views.
    ///
    /// Returns
    /// -------
    /// dict of str to Metric
    ///     `psnr_3d` and `ssim_3d` where the truth is known, `psnr_2d` and `ssim_2d` where there are test views.
    ///
    /// Raises
    /// ------
    /// TypeError
    ///     For a volume of another type or number of axes.
    /// ValueError
    ///     For a volume of another shape.
    #[pyo3(signature = (volume, model = None))]
    fn evaluate<'py>(
        &self,
        py: Python<'py>,
        volume: &Bound<'py, PyAny>,
        model: Option<&Model>,
    ) -> PyResult<Bound<'py, PyDict>> {
        let volume = self::volume(self.0.scanner.grid, volume, "volume")?;
        let config = Config::default();
        let model = model.map(|model| &model.0);
        let metrics = try_run(py, || reconstruction::evaluate(&self.0, &volume, model, &config))?.metrics;
        let found = PyDict::new(py);
        let names = trgs::evaluation::Metrics::NAMES.into_iter().chain(trgs::evaluation::Metrics::RANGE_NAMES);
        for (name, metric) in names.zip(metrics.columns().into_iter().chain(metrics.of_range())) {
            if let Some(metric) = metric {
                let values = (metric.value, metric.definition.as_str(), metric.detail.clone());
                found.set_item(name, named(py, "Metric")?.call1(values)?)?;
            }
        }
        Ok(found)
    }

    fn __reduce__<'py>(&self, py: Python<'py>) -> PyResult<(Bound<'py, PyAny>, Parts<'py>)> {
        let Dataset { name, scale, frame, noise, initial_points, notes, oddities, .. } = &self.0;
        let Frame { unit, scale: frame_scale, origin, directions } = frame;
        let train = (self.poses(py).unwrap_or_else(|| self.angles(py)), self.projections(py));
        let test = self.test_angles(py).zip(self.test_projections(py));
        let test = test.map(|(angles, images)| (self.test_poses(py).unwrap_or(angles), images));
        let arrays = (train, test, self.truth(py), initial_points.clone().map(|points| copy(py, points)));
        let place = (
            unit.map(|unit| PyString::new(py, unit.symbol())),
            *frame_scale,
            origin.to_array(),
            directions.to_cols_array_2d(),
        );
        let labels = (self.0.train.angles.clone(), self.0.test.as_ref().map(|test| test.angles.clone()));
        let words = (name.clone(), *scale, noise.to_string(), notes.clone(), oddities.clone());
        let restore = py.import("trgs._core")?.getattr("restored_scan")?;
        Ok((restore, (self.scanner(), arrays, labels, place, words)))
    }

    fn __len__(&self) -> usize {
        self.0.train.len()
    }

    fn __repr__(&self) -> String {
        let Dataset { name, scanner, train, .. } = &self.0;
        let (rows, columns) = (scanner.detector.rows, scanner.detector.columns);
        format!(
            "<trgs.Scan {name:?} of {} views, {rows} × {columns} pixels, {:?} voxels>",
            train.len(),
            scanner.grid.shape
        )
    }
}

/// Parts of a pickled scan: its scanner, arrays, angles, place and words.
type Parts<'py> = (Scanner, Arrays<'py>, Labels, Place<'py>, Words);
type Pair<'py> = (Bound<'py, PyAny>, Bound<'py, PyAny>);
/// Views or vectors and images, the same of test views, truth, initial points.
type Arrays<'py> = (Pair<'py>, Option<Pair<'py>>, Option<Bound<'py, PyAny>>, Option<Bound<'py, PyAny>>);
/// Angles of training and test views, which poses only label.
type Labels = (Vec<f64>, Option<Vec<f64>>);
/// Unit, scene units per unit, origin and directions.
type Place<'py> = (Option<Bound<'py, PyString>>, f64, [f64; 3], [[f64; 3]; 3]);
/// Name, scale, noise, notes, oddities.
type Words = (String, f64, String, Vec<String>, Vec<String>);

/// A pickled `trgs.Scan`.
#[pyfunction]
pub(crate) fn restored_scan(
    scanner: &Scanner,
    arrays: Arrays<'_>,
    labels: Labels,
    place: Place<'_>,
    words: Words,
) -> PyResult<Scan> {
    let ((angles, images), test, truth, points) = arrays;
    let (unit, scale, origin, directions) = place;
    let unit = unit.map(|unit| unit.to_string().parse()).transpose().map_err(raise)?;
    let frame = Frame { unit, scale, origin: origin.into(), directions: DMat3::from_cols_array_2d(&directions) };
    let (name, scale, noise, notes, oddities) = words;
    let test = test.map(|(angles, images)| views(scanner, &images, &angles)).transpose()?;
    let test = test.zip(labels.1).map(|(test, angles)| Projections { angles, ..test });
    let points = points.map(|points| read::<f64, Ix2>(&points, "initial_points", "[M, 4]")).transpose()?;
    Ok(Scan(Dataset {
        name,
        scanner: scanner.0,
        scale,
        frame,
        noise: noise.parse().map_err(raise)?,
        train: Projections { angles: labels.0, ..views(scanner, &images, &angles)? },
        test,
        truth: truth.map(|truth| volume(scanner.0.grid, &truth, "truth")).transpose()?,
        initial_points: points.map(|points| points.as_array().to_owned()),
        notes,
        oddities,
    }))
}

/// Reads a scan. Every oddity of its files, and every remark on its values, is a warning.
///
/// Parameters
/// ----------
/// path : str or os.PathLike
///     A dataset's folder in the format of R²-Gaussian, its `meta_data.json`, or a `.pickle` of NAF.
///
/// Returns
/// -------
/// Scan
///     In scene units: the longest side of the volume is 2.
///
/// Raises
/// ------
/// OSError
///     For a file that cannot be read.
/// ValueError
///     For content that is damaged or does not fit the scanner.
#[pyfunction]
pub(crate) fn load_scan(py: Python<'_>, path: PathBuf) -> PyResult<Scan> {
    let scan = Scan(try_run(py, || Dataset::read(&path))?);
    for oddity in scan.0.oddities.iter().chain(&scan.remarks(py)?) {
        warn(py, &format!("{}: {oddity}", path.display()))?;
    }
    Ok(scan)
}

/// Warns of unusual data.
fn warn(py: Python<'_>, text: &str) -> PyResult<()> {
    let text = CString::new(visible(text))?;
    PyErr::warn(py, &py.get_type::<PyUserWarning>(), &text, 1)
}

/// Simulates a scan of a phantom, whose projections are exact, or of a volume.
///
/// Parameters
/// ----------
/// object : str or ndarray [x, y, z], float32
///     The name of a phantom (see `phantoms`), or a volume on the scanner's grid, attenuation per scene unit.
/// scanner : Scanner
/// views : int
///     Training views, evenly spaced over a full turn from angle 0.
/// test_views : int
///     Views without noise at random angles.
/// noise : str
///     "none", "low", "medium", "high", or "I0,SIGMA" in photons and counts; ",physical" after it for the law of
///     Beer and Lambert.
/// seed : int
///     Of noise, test angles, and phantoms with random parts.
/// rays : {"trilinear", "siddon", "joseph"}
///     What the voxels of a volume stand for: densities at their centres, linear between them; constant densities, as in
///     TIGRE; or planes of centres. Line integrals of a phantom are exact.
///
/// Returns
/// -------
/// Scan
///
/// Raises
/// ------
/// ValueError
///     For an unknown phantom, noise or model of rays, one other than trilinear for a phantom, no views, or a volume of
///     another shape.
#[pyfunction]
#[pyo3(
    name = "simulate",
    signature = (object, scanner, views, *, test_views = 0, noise = "none", seed = 0, rays = "trilinear")
)]
#[allow(clippy::too_many_arguments)]
pub(crate) fn simulate_scan(
    py: Python<'_>,
    object: &Bound<'_, PyAny>,
    scanner: &Scanner,
    views: usize,
    test_views: usize,
    noise: &str,
    seed: u64,
    rays: &str,
) -> PyResult<Scan> {
    let plan = Plan { views, test_views, noise: noise.parse().map_err(raise)?, seed };
    let model = word("rays", rays, &SIMULATED_RAYS)?;
    if let Ok(name) = object.cast::<PyString>() {
        let name = name.to_string();
        if model.is_some() {
            let expected = "\"trilinear\" for a phantom, whose line integrals are exact";
            return Err(wrong_value("rays", format!("{rays:?}"), expected, "omit it, or give a volume"));
        }
        let phantom = Phantom::by_name(&name, seed).map_err(raise)?;
        let scan = try_run(py, || simulate::simulate(&name, Object::Phantom(&phantom), &scanner.0, &plan))?;
        return Ok(Scan(scan));
    }
    let volume = volume(scanner.0.grid, object, "object")?;
    let object = model.map_or(Object::Volume(&volume), |model| Object::Voxels(&volume, model.rays()));
    Ok(Scan(try_run(py, || simulate::simulate("volume", object, &scanner.0, &plan))?))
}

/// The names of the phantoms.
///
/// Returns
/// -------
/// list of str
#[pyfunction]
pub(crate) fn phantoms() -> Vec<&'static str> {
    PHANTOMS.iter().map(|phantom| phantom.name).collect()
}

/// Reads a volume. Every oddity of the file is a warning.
///
/// Parameters
/// ----------
/// path : str or os.PathLike
///     `.npy`, `.nii.gz`, `.mha`, `.nrrd`, `.tif`, `.raw` with its size in the name, and others.
///
/// scan : Scan, optional
///     Takes the volume as one on the grid of this scan: a file that states other axes is turned to those of the scan.
/// place : bool
///     Whether the place is returned, too.
///
/// Returns
/// -------
/// ndarray [x, y, z], float32
///     With `place`, a tuple of it and a dict: `spacing`, `origin` (centre of the first voxel) and `directions` (a unit
///     vector for each axis, in the coordinates of ITK), and their `unit`. Entries that are not known are None.
///
/// Raises
/// ------
/// OSError
///     For a file that cannot be read.
/// ValueError
///     For content that is damaged, and for a volume that is not on the grid of `scan`.
#[pyfunction]
#[pyo3(signature = (path, *, scan = None, place = false))]
pub(crate) fn load_volume<'py>(
    py: Python<'py>,
    path: PathBuf,
    scan: Option<&Scan>,
    place: bool,
) -> PyResult<Bound<'py, PyAny>> {
    let mut file = try_run(py, || volume_file::read(&path))?;
    if let Some(Scan(Dataset { scanner, frame, .. })) = scan {
        let arranged = try_run(py, || frame.arrange(file, &scanner.grid).map_err(|error| error.in_file(&path)));
        let (volume, oddities) = arranged?;
        file = VolumeFile { oddities, ..frame.file(&volume) };
    }
    for oddity in &file.oddities {
        warn(py, &format!("{}: {oddity}", path.display()))?;
    }
    let stated = PyDict::new(py);
    stated.set_item("spacing", file.spacing.map(|spacing| spacing.to_array()))?;
    stated.set_item("origin", file.origin.map(|origin| origin.to_array()))?;
    stated.set_item("directions", file.directions.to_cols_array_2d())?;
    stated.set_item("unit", file.unit.map(Unit::symbol))?;
    let values = give(py, file.values);
    if place { Ok(PyTuple::new(py, [values, stated.into_any()])?.into_any()) } else { Ok(values) }
}

/// Writes a volume with the spacing and the origin of its grid, as a whole or not at all.
///
/// With the scan, lengths are those of its files (in millimetres if their unit is known) at the place of the volume that
/// was scanned; with a grid or scanner, they are scene units.
///
/// Parameters
/// ----------
/// path : str or os.PathLike
///     Its ending is the format: `.npy`, `.nii.gz`, `.mha`, `.nrrd`, `.tif`, `.raw`.
/// volume : ndarray [x, y, z], float32
/// grid : Scan, Grid or Scanner
///
/// Raises
/// ------
/// OSError
///     For a file that cannot be written.
/// ValueError
///     For a volume of another shape than the grid's, numbers that are not finite, and an unknown ending.
#[pyfunction]
pub(crate) fn save_volume(
    py: Python<'_>,
    path: PathBuf,
    volume: &Bound<'_, PyAny>,
    grid: &Bound<'_, PyAny>,
) -> PyResult<()> {
    let (grid, frame) = place_of(grid)?;
    let volume = self::volume(grid, volume, "volume")?;
    try_run(py, || trgs::write_volume(&path, &volume, &frame))
}

/// The grid of a scan, grid or scanner, and its unit and place.
pub(crate) fn place_of(grid: &Bound<'_, PyAny>) -> PyResult<(trgs::Grid, Frame)> {
    match grid.cast::<Scan>() {
        Ok(scan) => Ok((scan.get().0.scanner.grid, scan.get().0.frame)),
        Err(_) => Ok((crate::geometry::grid_of(grid)?, Frame::default())),
    }
}

/// What a method found.
#[pyclass(frozen, module = "trgs")]
pub(crate) struct Reconstruction {
    /// float32 [x, y, z] on the scanner's grid, attenuation per scene unit.
    #[pyo3(get)]
    volume: Py<PyAny>,
    /// The primitives, or None of a method on voxels.
    #[pyo3(get)]
    model: Option<Py<Model>>,
    /// The volume of the primitives, where `volume` is finished on voxels: float32 [x, y, z], or None.
    #[pyo3(get)]
    unfinished: Option<Py<PyAny>>,
    /// Reports of a method that fits primitives: a dict each.
    #[pyo3(get)]
    log: Py<PyAny>,
    /// What was chosen by views held out, or None.
    #[pyo3(get)]
    choice: Py<PyAny>,
    /// Attenuation per scene unit that counted as 1, or None.
    #[pyo3(get)]
    unit: Option<f64>,
    /// All settings of the run: TOML.
    #[pyo3(get)]
    settings: String,
    grid: trgs::Grid,
    frame: Frame,
    name: &'static str,
}

#[pymethods]
impl Reconstruction {
    /// The grid of the volume.
    #[getter]
    fn grid(&self) -> Grid {
        Grid(self.grid)
    }

    /// Writes the volume, see `save_volume`.
    ///
    /// Parameters
    /// ----------
    /// path : str or os.PathLike
    ///
    /// Raises
    /// ------
    /// OSError
    ///     For a file that cannot be written.
    /// ValueError
    ///     For an unknown ending.
    fn save(&self, py: Python<'_>, path: PathBuf) -> PyResult<()> {
        let volume = self::volume(self.grid, self.volume.bind(py), "volume")?;
        try_run(py, || trgs::write_volume(&path, &volume, &self.frame))
    }

    fn __repr__(&self) -> String {
        format!("<trgs.Reconstruction by {}, {:?} voxels>", self.name, self.grid.shape)
    }
}

/// A value of a setting as TOML.
fn toml(key: &str, value: &Bound<'_, PyAny>) -> PyResult<String> {
    let wrong = || wrong_type(key, value, "a bool, int, float, str, or a sequence of them", "give such a value");
    if value.is_instance_of::<PyBool>() {
        return Ok(value.extract::<bool>()?.to_string());
    }
    if let Ok(text) = value.cast::<PyString>() {
        return Ok(json!(text.to_string()).to_string());
    }
    if value.is_instance_of::<PyList>() || value.is_instance_of::<PyTuple>() {
        let parts = value.try_iter()?.map(|part| toml(key, &part?)).collect::<PyResult<Vec<_>>>()?;
        return Ok(format!("[{}]", parts.join(", ")));
    }
    if let Ok(number) = value.extract::<i64>() {
        return Ok(number.to_string());
    }
    value.extract::<f64>().map(|number| format!("{number:?}")).map_err(|_| wrong())
}

/// Sets keys of the configuration; a dict has the keys of a table.
pub(crate) fn configure(config: &mut Config, table: &str, settings: &Bound<'_, PyDict>) -> PyResult<()> {
    for (key, value) in settings {
        let key = format!("{table}{}", key.extract::<String>()?);
        match value.cast::<PyDict>() {
            Ok(table) => configure(config, &format!("{key}."), table)?,
            Err(_) => config.set(&format!("{key}={}", toml(&key, &value)?)).map_err(raise)?,
        }
    }
    Ok(())
}

fn event(progress: Progress<'_>) -> Option<Event> {
    match progress {
        Progress::Iteration(_, None) | Progress::Pilot(_, None) | Progress::Choosing(_, None) => None,
        Progress::Iteration(iteration, Some(record)) => {
            let values = serde_json::to_value(record).expect("a record is JSON");
            Some(Event { stage: "primitives", iteration, iterations: record.iterations, values })
        }
        Progress::Pilot(iteration, Some(record)) => {
            let values = serde_json::to_value(record).expect("a record is JSON");
            Some(Event { stage: "pilot", iteration, iterations: record.iterations, values })
        }
        Progress::Pass(pass) => Some(pass_event(pass)),
        Progress::Choosing(key, Some(trial)) => Some(trial_event(key, trial)),
    }
}

/// Reconstructs a scan.
///
/// Parameters
/// ----------
/// scan : Scan
/// method : {"tr-gs", "r2-gaussian", "fdk", "sart", "os-sart", "asd-pocs", "cgls", "tv", "naf", "sax-nerf",
///     "intratomo"}
/// progress : bool
///     Whether reports are printed to stderr.
/// callback : callable, optional
///     Gets a `Progress` with every report. What it raises ends the run and is raised here.
/// checkpoint : str or os.PathLike, optional
///     A file that keeps the state of the run. If it exists, the run goes on from there, to the same bits.
/// settings : dict, optional
///     Keys of the configuration, as `**more` takes them: for settings that are kept in a variable.
/// **more
///     Keys of the configuration, `iterations=2000`; those of a table as a dict, `model={"points": 5000}`. `settings` of a
///     result has all keys with their documentation.
///
/// Returns
/// -------
/// Reconstruction
///     The same bits as `trgs reconstruct` writes with the same settings.
///
/// Raises
/// ------
/// TypeError
///     For a setting of another type.
/// ValueError
///     For an unknown method or setting, or one out of its range.
/// ArithmeticError
///     When values become infinite.
/// KeyboardInterrupt
///     After Ctrl-C.
#[pyfunction]
#[pyo3(signature = (scan, method = "tr-gs", settings = None, *, progress = false, callback = None, checkpoint = None, **more))]
#[allow(clippy::too_many_arguments)]
pub(crate) fn reconstruct(
    py: Python<'_>,
    scan: &Scan,
    method: &str,
    settings: Option<&Bound<'_, PyAny>>,
    progress: bool,
    callback: Option<Py<PyAny>>,
    checkpoint: Option<PathBuf>,
    more: Option<&Bound<'_, PyDict>>,
) -> PyResult<Reconstruction> {
    const METHODS: [(&str, Method); 11] = [
        ("tr-gs", Method::TrGs),
        ("r2-gaussian", Method::R2Gaussian),
        ("fdk", Method::Fdk),
        ("sart", Method::Sart),
        ("os-sart", Method::OsSart),
        ("asd-pocs", Method::AsdPocs),
        ("cgls", Method::Cgls),
        ("tv", Method::Tv),
        ("naf", Method::Naf),
        ("sax-nerf", Method::SaxNerf),
        ("intratomo", Method::Intratomo),
    ];
    let kind = arrays::word("method", method, &METHODS)?;
    let name = METHODS.iter().find(|(_, one)| *one == kind).expect("it was found").0;
    let mut config = Config::of(kind);
    if let Some(settings) = settings {
        let wrong = |_| wrong_type("settings", settings, "a dict of keys", "give {\"iterations\": 2000}, for example");
        configure(&mut config, "", settings.cast::<PyDict>().map_err(wrong)?)?;
    }
    if let Some(more) = more {
        configure(&mut config, "", more)?;
    }
    let printer = progress.then(|| named(py, "Printer")?.call0().map(Bound::unbind)).transpose()?;
    let callbacks: Vec<_> = printer.into_iter().chain(callback).collect();
    let checkpoints = checkpoint.map(Checkpoints::resume).transpose().map_err(raise)?;
    let (result, watch) = run(py, || {
        let mut watch = Watch::new(callbacks);
        let run = Run::new(&scan.0, &config).observe(|progress| watch.see(event(progress)));
        let run = match checkpoints {
            Some(checkpoints) => run.checkpoints(checkpoints),
            None => run,
        };
        (run.reconstruct(), watch)
    })?;
    let found = watch.end(result)?;
    Ok(Reconstruction {
        volume: give(py, found.volume.values).unbind(),
        model: found.primitives.map(|primitives| Py::new(py, Model(primitives))).transpose()?,
        unfinished: found.unfinished.map(|volume| give(py, volume.values).unbind()),
        log: python(py, &serde_json::to_value(&found.log).expect("a log is JSON"))?.unbind(),
        choice: python(py, &serde_json::to_value(&found.choice).expect("a choice is JSON"))?.unbind(),
        unit: found.unit,
        settings: config.to_toml(),
        grid: scan.0.scanner.grid,
        frame: scan.0.frame,
        name,
    })
}
