//! Views of a scanner: angles on its circle, or poses.

use crate::arrays::{self, Number, dispatch, give, numbers, read, read_float, slice, wrong_value};
use crate::geometry::Scanner;
use crate::model::Model;
use crate::projector::{Rays, check_images, how};
use crate::work::{raise, run};
use ndarray::{Array2, Ix2};
use numpy::{PyReadonlyArray3, PyUntypedArray, PyUntypedArrayMethods};
use pyo3::prelude::*;
use std::path::Path;
use trgs::geometry::{Pose, Trajectory};
use trgs::projector;
use trgs::scan::dataset::{Description, pose_of_vector, vector_of_pose};
use trgs::scan::plausibility::{self, AnglesFrom};

/// Views that a call is about.
pub(crate) struct Views {
    /// Radians; with poses, the angles of the plain views that look in the same directions.
    pub(crate) angles: Vec<f64>,
    poses: Option<Vec<Pose>>,
}

impl Views {
    /// Angles `[N]`, or vectors `[N, 12]` of poses in scene units.
    pub(crate) fn of(value: &Bound<'_, PyAny>, scanner: &Scanner) -> PyResult<Self> {
        let value = as_array(value)?;
        if !value.cast::<PyUntypedArray>().is_ok_and(|array| array.ndim() == 2) {
            return Ok(Self { angles: angles(&value)?, poses: None });
        }
        let vectors = read::<f64, Ix2>(&value, "angles", "[view] of radians or [view, 12] of vectors")?;
        let rows = slice(&vectors).chunks(vectors.shape()[1].max(1));
        let pose = |row: &[f64]| pose_of_vector(&scanner.0, row, 1.0);
        let poses: Vec<Pose> = rows.map(pose).collect::<Result<_, _>>().map_err(raise)?;
        let views = Self { angles: poses.iter().map(Pose::angle).collect(), poses: Some(poses) };
        views.trajectory().validate(&scanner.0).map_err(raise)?;
        Ok(views)
    }

    /// The angles of views on the circle of the scanner.
    pub(crate) fn circle(value: &Bound<'_, PyAny>, scanner: &Scanner) -> PyResult<Vec<f64>> {
        let Self { angles, poses } = Self::of(value, scanner)?;
        if poses.is_some() {
            let remedy = "give angles, or call fdk, which takes poses on a circle";
            return Err(wrong_value("angles", "vectors of poses", "radians, [view]", remedy));
        }
        Ok(angles)
    }

    pub(crate) fn trajectory(&self) -> Trajectory<'_> {
        Trajectory { angles: &self.angles, poses: self.poses.as_deref() }
    }

    pub(crate) fn len(&self) -> usize {
        self.angles.len()
    }
}

/// An array or tensor of real numbers as C-contiguous float64, which is exact for the angles of views; else the value itself.
fn as_array<'py>(value: &Bound<'py, PyAny>) -> PyResult<Bound<'py, PyAny>> {
    if !value.hasattr("__array__")? {
        return Ok(value.clone());
    }
    let numpy = value.py().import("numpy")?;
    let array = numpy.call_method1("asarray", (value,))?;
    let kind: String = array.getattr("dtype")?.getattr("kind")?.extract()?;
    let is_view = array.getattr("ndim")?.extract::<usize>()? > 0;
    if is_view && matches!(kind.as_str(), "f" | "i" | "u") {
        return numpy.call_method1("ascontiguousarray", (array, "float64"));
    }
    Ok(array)
}

/// The angles of views, radians.
fn angles(value: &Bound<'_, PyAny>) -> PyResult<Vec<f64>> {
    let angles = numbers(value, "angles")?;
    match angles.iter().find(|angle| !angle.is_finite()) {
        None => plausibility::check_radians(&angles, AnglesFrom::Argument).map_err(raise).map(|()| angles),
        Some(bad) => Err(wrong_value("angles", bad, "finite numbers of radians", "correct the angles")),
    }
}

/// Poses as vectors `[view, 12]`; `None` of a circle.
pub(crate) fn vectors<'py>(
    py: Python<'py>,
    scanner: &trgs::Scanner,
    views: Trajectory<'_>,
) -> Option<Bound<'py, PyAny>> {
    let poses = views.poses?;
    let numbers = poses.iter().flat_map(|pose| vector_of_pose(scanner, pose)).collect();
    Some(arrays::copy(py, Array2::from_shape_vec((poses.len(), 12), numbers).expect("twelve numbers for each view")))
}

/// The scanner of a description in JSON, its views at these angles or poses, and its scene units per unit of length.
#[pyfunction]
pub(crate) fn geometry_of<'py>(
    py: Python<'py>,
    text: &str,
    angles: &Bound<'py, PyAny>,
) -> PyResult<(Scanner, Bound<'py, PyAny>, f64)> {
    let description = Description::parse(text.as_bytes(), Path::new("geometry")).map_err(raise)?;
    let angles = self::angles(&as_array(angles)?)?;
    let poses = description.poses(&angles).map_err(raise)?;
    let views = vectors(py, &description.scanner, Trajectory { angles: &angles, poses: poses.as_deref() });
    let views = views.unwrap_or_else(|| arrays::copy(py, ndarray::Array1::from(angles)));
    Ok((Scanner(description.scanner), views, description.scale))
}

/// The gradient of Σ cotangent·projection to a motion of source and detector together, for each view.
///
/// Parameters
/// ----------
/// model, scanner, angles, cotangent, projection, cutoff
///     As of `project_vjp`.
///
/// Returns
/// -------
/// ndarray [view, 6], float64
///     To a shift along x, y and z (per scene unit), and to a turn about the axes x, y and z through the origin (per
///     radian). The last is the gradient to an angle of the circle.
///
/// Raises
/// ------
/// TypeError, ValueError
///     As `project_vjp`.
#[pyfunction]
#[pyo3(signature = (model, scanner, angles, cotangent, *, projection = "exact", cutoff = 0.0))]
pub(crate) fn motion_vjp<'py>(
    py: Python<'py>,
    model: &Model,
    scanner: &Scanner,
    angles: &Bound<'py, PyAny>,
    cotangent: &Bound<'py, PyAny>,
    projection: &str,
    cutoff: f64,
) -> PyResult<Bound<'py, PyAny>> {
    let (how, views) = (how(projection, cutoff)?, Views::of(angles, scanner)?);
    let cotangent = read_float(cotangent, "cotangent", "[view, v, u]")?;
    dispatch!(cotangent, |cotangent| motions_in(py, model, scanner, &views, &cotangent, &how))
}

fn motions_in<'py, R: Number>(
    py: Python<'py>,
    model: &Model,
    scanner: &Scanner,
    views: &Views,
    cotangent: &PyReadonlyArray3<'py, R>,
    how: &Rays,
) -> PyResult<Bound<'py, PyAny>> {
    check_images("cotangent", cotangent.shape(), scanner, views)?;
    let (cotangent, views) = (cotangent.as_array(), views.trajectory());
    let Rays { projection, cutoff } = *how;
    let motions = run(py, || projector::motion_vjp(&model.0, &scanner.0, views, projection, cutoff, cotangent.view()))?;
    Ok(give(py, Array2::from(motions)))
}

/// A scanner whose distances, pixels and shifts are those of the first pose of vectors `[view, 12]`.
pub(crate) fn scanner_of(
    vectors: &Bound<'_, PyAny>,
    rows: usize,
    columns: usize,
    grid: trgs::geometry::Grid,
) -> PyResult<Scanner> {
    let vectors = as_array(vectors)?;
    let read = read::<f64, Ix2>(&vectors, "vectors", "[view, 12]")?;
    let Some(&[sx, sy, sz, cx, cy, cz, ux, uy, uz, vx, vy, vz]) =
        slice(&read).as_chunks().0.first().filter(|_| read.shape()[1] == 12)
    else {
        let remedy = "give source, centre of the detector, u and v of each view, three numbers each";
        return Err(wrong_value("vectors", format!("shape {:?}", read.shape()), "[view, 12]", remedy));
    };
    let [source, centre, u, v] = [[sx, sy, sz], [cx, cy, cz], [ux, uy, uz], [vx, vy, vz]].map(glam::DVec3::from);
    let detector =
        trgs::Detector { rows, columns, pitch_u: u.length(), pitch_v: v.length(), offset_u: 0.0, offset_v: 0.0 };
    let plain = trgs::geometry::Scanner { beam: trgs::Beam::Cone { dso: 5.0, dsd: 7.0 }, detector, grid };
    let view = Pose { source, centre, u: u / u.length(), v: v / v.length() }.view(&plain, 0.0);
    let scanner = trgs::geometry::Scanner { beam: view.beam, detector: view.detector, grid };
    scanner.validate().map_err(raise)?;
    let scanner = Scanner(scanner);
    Views::of(&vectors, &scanner)?;
    Ok(scanner)
}
