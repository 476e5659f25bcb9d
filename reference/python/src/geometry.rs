//! Grids and scanners.

use crate::arrays::{Axes, named, numbers, wrong_value};
use crate::views::scanner_of;
use crate::work::{fits, raise, try_run};
use glam::DVec3;
use pyo3::exceptions::PyTypeError;
use pyo3::prelude::*;
use std::path::{Path, PathBuf};
use trgs::geometry::{Beam, Detector};
use trgs::scan::dataset::{Description, read_scanner};

/// An axis-aligned box of voxels.
///
/// Parameters
/// ----------
/// shape : tuple of int
///     Voxels along x, y and z.
/// low, high : tuple of float
///     Corners of the box with the smallest and the largest coordinates, scene units. The default is the cube from -1 to
///     1: the longest side of a volume is 2 in scene units.
///
/// Raises
/// ------
/// ValueError
///     For an axis without voxels, or corners that are not finite or not in increasing order.
#[pyclass(frozen, module = "trgs", eq)]
#[derive(Clone, PartialEq)]
pub(crate) struct Grid(pub(crate) trgs::geometry::Grid);

#[pymethods]
impl Grid {
    #[new]
    #[pyo3(
        signature = (shape, low = Axes([-1.0; 3]), high = Axes([1.0; 3])),
        text_signature = "(shape, low=(-1.0, -1.0, -1.0), high=(1.0, 1.0, 1.0))"
    )]
    fn new(shape: Axes<usize, 3>, low: Axes<f64, 3>, high: Axes<f64, 3>) -> PyResult<Self> {
        trgs::geometry::Grid::new(shape.0, low.0.into(), high.0.into()).map(Self).map_err(raise)
    }

    /// Voxels along x, y and z.
    #[getter]
    fn shape(&self) -> (usize, usize, usize) {
        self.0.shape.into()
    }

    /// The corner with the smallest coordinates, scene units.
    #[getter]
    fn low(&self) -> (f64, f64, f64) {
        self.0.min.into()
    }

    /// The corner with the largest coordinates, scene units.
    #[getter]
    fn high(&self) -> (f64, f64, f64) {
        self.0.max().into()
    }

    /// Sides of a voxel along x, y and z, scene units.
    #[getter]
    fn spacing(&self) -> (f64, f64, f64) {
        self.0.spacing.into()
    }

    /// The part of the grid that starts at voxel `start` and has `shape` voxels.
    ///
    /// Parameters
    /// ----------
    /// start, shape : tuple of int
    ///     First voxel and number of voxels along x, y and z. The block may reach beyond the grid.
    ///
    /// Returns
    /// -------
    /// Grid
    fn block(&self, start: Axes<usize, 3>, shape: Axes<usize, 3>) -> PyResult<Self> {
        let (Axes(start), Axes(shape)) = (start, shape);
        if shape.contains(&0) {
            let remedy = "give at least one voxel on each axis";
            return Err(wrong_value("shape", format!("{shape:?}"), "at least one voxel on each axis", remedy));
        }
        let block = self.0.block(start, shape);
        trgs::geometry::Grid::new(block.shape, block.min, block.max()).map(|_| Self(block)).map_err(raise)
    }

    fn __reduce__(slf: &Bound<'_, Self>) -> (Py<PyAny>, Corners) {
        let grid = &slf.get().0;
        (slf.get_type().into_any().unbind(), (grid.shape.into(), grid.min.into(), grid.max().into()))
    }

    fn __repr__(&self) -> String {
        format!("Grid(shape={:?}, low={:?}, high={:?})", self.shape(), self.low(), self.high())
    }
}

type Corners = ((usize, usize, usize), (f64, f64, f64), (f64, f64, f64));

type ScannerParts = (Option<f64>, Option<f64>, (usize, usize), (f64, f64), Grid, (f64, f64));

/// Beam, detector and volume of a scan.
///
/// Made by `Scanner.cone`, `Scanner.parallel`, `Scanner.synthetic`, `Scanner.read` or `Scanner.parse`. World coordinates
/// are right-handed and z is the axis of rotation. At angle φ the source is at dso·(cos φ, sin φ, 0). Images are [v, u]:
/// row 0 is at the top (+z), and columns run along (-sin φ, cos φ, 0).
#[pyclass(frozen, module = "trgs", eq)]
#[derive(Clone, PartialEq)]
pub(crate) struct Scanner(pub(crate) trgs::geometry::Scanner);

/// Counts, lengths or shifts [v, u].
type Pair<T> = Axes<T, 2>;

/// The volume of a scanner.
struct Space(trgs::geometry::Grid);

impl FromPyObject<'_, '_> for Space {
    type Error = PyErr;

    fn extract(value: Borrowed<'_, '_, PyAny>) -> PyResult<Self> {
        value.cast::<Grid>().map(|grid| Self(grid.get().0)).map_err(|_| {
            let got = value.get_type().name().map_or_else(|_| "an object".into(), |name| name.to_string());
            PyTypeError::new_err(format!("got an object of type {got}, expected a Grid; give trgs.Grid((64, 64, 64))"))
        })
    }
}

fn made(beam: Beam, detector: Pair<usize>, pitch: Pair<f64>, offset: Pair<f64>, grid: Space) -> PyResult<Scanner> {
    let (Axes([rows, columns]), Axes([pitch_v, pitch_u]), Axes([offset_v, offset_u])) = (detector, pitch, offset);
    let detector = Detector { rows, columns, pitch_v, pitch_u, offset_u, offset_v };
    let scanner = trgs::geometry::Scanner { beam, detector, grid: grid.0 };
    scanner.validate().map_err(raise)?;
    Ok(Scanner(scanner))
}

#[pymethods]
impl Scanner {
    /// A point source and a flat detector.
    ///
    /// Parameters
    /// ----------
    /// dso, dsd : float
    ///     Distances from the source to the axis of rotation and to the detector, scene units.
    /// detector : tuple of int
    ///     Rows and columns [v, u].
    /// pitch : tuple of float
    ///     Distances between rows and between columns [v, u], scene units.
    /// grid : Grid
    ///     The volume.
    /// offset : tuple of float
    ///     Shift of the detector [v, u], scene units. v points down, towards higher rows.
    ///
    /// Returns
    /// -------
    /// Scanner
    ///
    /// Raises
    /// ------
    /// ValueError
    ///     For sizes that are not positive, a source in the volume, or a detector that does not see the volume.
    #[staticmethod]
    #[pyo3(
        signature = (dso, dsd, *, detector, pitch, grid, offset = Axes([0.0; 2])),
        text_signature = "(dso, dsd, *, detector, pitch, grid, offset=(0.0, 0.0))"
    )]
    fn cone(
        dso: f64,
        dsd: f64,
        detector: Pair<usize>,
        pitch: Pair<f64>,
        grid: Space,
        offset: Pair<f64>,
    ) -> PyResult<Self> {
        made(Beam::Cone { dso, dsd }, detector, pitch, offset, grid)
    }

    /// Rays perpendicular to a flat detector. Parameters and errors are those of `cone`, without distances.
    ///
    /// Parameters
    /// ----------
    /// detector : tuple of int
    ///     Rows and columns [v, u].
    /// pitch : tuple of float
    ///     Distances between rows and between columns [v, u], scene units.
    /// grid : Grid
    ///     The volume.
    /// offset : tuple of float
    ///     Shift of the detector [v, u], scene units. v points down, towards higher rows.
    ///
    /// Returns
    /// -------
    /// Scanner
    #[staticmethod]
    #[pyo3(
        signature = (*, detector, pitch, grid, offset = Axes([0.0; 2])),
        text_signature = "(*, detector, pitch, grid, offset=(0.0, 0.0))"
    )]
    fn parallel(detector: Pair<usize>, pitch: Pair<f64>, grid: Space, offset: Pair<f64>) -> PyResult<Self> {
        made(Beam::Parallel { dso: 5.0 }, detector, pitch, offset, grid)
    }

    /// The scanner of poses: distances, pixel sizes and shifts are those of the first.
    ///
    /// Functions take the vectors as `angles`.
    ///
    /// Parameters
    /// ----------
    /// vectors : array [view, 12]
    ///     Source, centre of the detector, u from a pixel to the next of its row, v from a row to the next: three numbers
    ///     each, scene units. This is the order of ASTRA's `cone_vec`. u × v points away from the source.
    /// detector : tuple of int
    ///     Rows and columns [v, u].
    /// grid : Grid
    ///     The volume.
    ///
    /// Returns
    /// -------
    /// Scanner
    ///     Of a cone beam.
    ///
    /// Raises
    /// ------
    /// ValueError
    ///     For another shape, axes that are not perpendicular, sizes of pixels that differ, and a source in the volume.
    #[staticmethod]
    #[pyo3(signature = (vectors, *, detector, grid))]
    fn from_vectors(vectors: &Bound<'_, PyAny>, detector: Pair<usize>, grid: Space) -> PyResult<Self> {
        let Axes([rows, columns]) = detector;
        scanner_of(vectors, rows, columns, grid.0)
    }

    /// The scanner of R²-Gaussian's synthetic scans: a cone beam that sees the cube from -1 to 1.
    ///
    /// The source is 5 from the axis of rotation and 7 from the detector, a square with sides of 4.
    ///
    /// Parameters
    /// ----------
    /// voxels : int
    ///     Voxels along each side of the volume.
    /// pixels : int
    ///     Pixels along each side of the detector.
    ///
    /// Returns
    /// -------
    /// Scanner
    #[staticmethod]
    fn synthetic(voxels: usize, pixels: usize) -> PyResult<Self> {
        let scanner = trgs::geometry::Scanner::synthetic(voxels, pixels);
        scanner.validate().map_err(raise)?;
        Ok(Self(scanner))
    }

    /// Reads the scanner of a dataset in scene units.
    ///
    /// Parameters
    /// ----------
    /// path : str or os.PathLike
    ///     A dataset's folder, its `meta_data.json`, or a `.pickle` of NAF.
    ///
    /// Returns
    /// -------
    /// Scanner
    ///
    /// Raises
    /// ------
    /// OSError
    ///     For a file that cannot be read.
    /// ValueError
    ///     For content that is wrong.
    #[staticmethod]
    fn read(py: Python<'_>, path: PathBuf) -> PyResult<Self> {
        Ok(Self(try_run(py, move || read_scanner(&path))?))
    }

    /// The scanner in the text of a `meta_data.json`, in scene units.
    ///
    /// Parameters
    /// ----------
    /// text : str
    ///     JSON with the key `scanner`.
    ///
    /// Returns
    /// -------
    /// Scanner
    ///
    /// Raises
    /// ------
    /// ValueError
    ///     For content that is wrong.
    #[staticmethod]
    fn parse(text: &str) -> PyResult<Self> {
        let description = Description::parse(text.as_bytes(), Path::new("meta_data.json")).map_err(raise)?;
        Ok(Self(description.scanner))
    }

    /// Angles of `views` views, evenly spaced from `start`, the end excluded.
    ///
    /// Parameters
    /// ----------
    /// views : int
    ///     Number of views.
    /// start, span : float
    ///     First angle and range, radians.
    ///
    /// Returns
    /// -------
    /// list of float
    ///     Radians.
    #[staticmethod]
    #[pyo3(signature = (views, start = 0.0, span = std::f64::consts::TAU))]
    fn uniform_angles(views: usize, start: f64, span: f64) -> PyResult<Vec<f64>> {
        // As numbers, and as objects of Python with their places in the list.
        fits("angles", &[views], 40)?;
        Ok(trgs::geometry::Scanner::uniform_angles(views, start, span))
    }

    /// "cone" or "parallel".
    #[getter]
    fn beam(&self) -> &'static str {
        match self.0.beam {
            Beam::Cone { .. } => "cone",
            Beam::Parallel { .. } => "parallel",
        }
    }

    /// Distance from the source to the axis of rotation, scene units; `None` of a parallel beam.
    #[getter]
    fn dso(&self) -> Option<f64> {
        match self.0.beam {
            Beam::Cone { dso, .. } => Some(dso),
            Beam::Parallel { .. } => None,
        }
    }

    /// Distance from the source to the detector, scene units; `None` of a parallel beam.
    #[getter]
    fn dsd(&self) -> Option<f64> {
        match self.0.beam {
            Beam::Cone { dsd, .. } => Some(dsd),
            Beam::Parallel { .. } => None,
        }
    }

    /// Rows and columns [v, u].
    #[getter]
    fn detector(&self) -> (usize, usize) {
        (self.0.detector.rows, self.0.detector.columns)
    }

    /// Distances between rows and between columns [v, u], scene units.
    #[getter]
    fn pitch(&self) -> (f64, f64) {
        (self.0.detector.pitch_v, self.0.detector.pitch_u)
    }

    /// Shift of the detector [v, u], scene units.
    #[getter]
    fn offset(&self) -> (f64, f64) {
        (self.0.detector.offset_v, self.0.detector.offset_u)
    }

    /// The volume.
    #[getter]
    fn grid(&self) -> Grid {
        Grid(self.0.grid)
    }

    fn __reduce__<'py>(slf: &Bound<'py, Self>) -> PyResult<(Bound<'py, PyAny>, ScannerParts)> {
        let scanner = slf.get();
        let parts =
            (scanner.dso(), scanner.dsd(), scanner.detector(), scanner.pitch(), scanner.grid(), scanner.offset());
        Ok((named(slf.py(), "scanner")?, parts))
    }

    fn __repr__(&self) -> String {
        let distances = match self.0.beam {
            Beam::Cone { dso, dsd } => format!("cone({dso:?}, {dsd:?}, "),
            Beam::Parallel { .. } => "parallel(".into(),
        };
        format!(
            "Scanner.{distances}detector={:?}, pitch={:?}, grid={}, offset={:?})",
            self.detector(),
            self.pitch(),
            self.grid().__repr__(),
            self.offset()
        )
    }
}

/// A grid: that of a scan or scanner, or itself.
pub(crate) fn grid_of(value: &Bound<'_, PyAny>) -> PyResult<trgs::geometry::Grid> {
    if let Ok(scan) = value.cast::<crate::scan::Scan>() {
        return Ok(scan.get().0.scanner.grid);
    }
    if let Ok(scanner) = value.cast::<Scanner>() {
        return Ok(scanner.get().0.grid);
    }
    let grid = value.cast::<Grid>();
    let expected = "a trgs.Grid, trgs.Scanner or trgs.Scan";
    let wrong = |_| crate::arrays::wrong_type("grid", value, expected, "give scanner.grid");
    Ok(grid.map_err(wrong)?.get().0)
}

/// Three coordinates.
pub(crate) fn corner(value: &Bound<'_, PyAny>, what: &str) -> PyResult<DVec3> {
    match numbers(value, what)?[..] {
        [x, y, z] => Ok(DVec3::new(x, y, z)),
        ref other => {
            Err(wrong_value(what, format!("{} numbers", other.len()), "x, y and z", "give (-1.0, -1.0, -1.0)"))
        }
    }
}
