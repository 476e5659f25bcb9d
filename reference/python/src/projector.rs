//! From primitives to projections and volumes, and the gradients back.

use crate::arrays::wrong_value;
use crate::arrays::{Number, check_shape, dispatch, give, give_parameters, precision, read_float, word};
use crate::geometry::{Scanner, grid_of};
use crate::model::Model;
use crate::views::Views;
use crate::work::{fits, run};
use ndarray::{Array2, Array3, Ix3};
use numpy::{PyReadonlyArray3, PyUntypedArrayMethods};
use pyo3::prelude::*;
use trgs::config::Precision;
use trgs::in_precision;
use trgs::projector::{self, Field, Projection};

const PROJECTIONS: [(&str, Projection); 2] = [("exact", Projection::Exact), ("affine", Projection::Affine)];

/// How a cone beam's rays are taken through primitives, and where primitives end.
pub(crate) struct Rays {
    pub(crate) projection: Projection,
    pub(crate) cutoff: f64,
}

fn check_cutoff(cutoff: f64) -> PyResult<()> {
    if (0.0..1.0).contains(&cutoff) {
        return Ok(());
    }
    Err(wrong_value("cutoff", cutoff, "a number from 0 to below 1", "give 0.0 for no cutoff"))
}

pub(crate) fn how(projection: &str, cutoff: f64) -> PyResult<Rays> {
    check_cutoff(cutoff)?;
    Ok(Rays { projection: word("projection", projection, &PROJECTIONS)?, cutoff })
}

/// Projections of a model: line integrals of its density.
///
/// Parameters
/// ----------
/// model : Model
/// scanner : Scanner
/// angles : sequence of float, or array [view, 12]
///     Of the views, radians. Poses instead are source, centre of the detector, and u and v from a pixel to the next, as in
///     ASTRA's `cone_vec`, in scene units: see `Scanner.from_vectors`.
/// projection : {"exact", "affine"}
///     The line integral along every pixel's own ray, or the paper's: all rays parallel to the one through the centre.
/// cutoff : float
///     A primitive ends where its projection has fallen to this fraction of its peak; 0: nowhere, which is exact and slow.
///     Training uses 1e-3.
/// dtype : dtype
///     float64 (the default) or float32: the arithmetic, and the type of the result.
///
/// Returns
/// -------
/// ndarray [view, v, u]
///     Scene units of length times density.
///
/// Raises
/// ------
/// ValueError
///     For an unknown word, a cutoff out of range, or an angle that is not finite.
#[pyfunction]
#[pyo3(signature = (model, scanner, angles, *, projection = "exact", cutoff = 0.0, dtype = None))]
pub(crate) fn project<'py>(
    py: Python<'py>,
    model: &Model,
    scanner: &Scanner,
    angles: &Bound<'py, PyAny>,
    projection: &str,
    cutoff: f64,
    dtype: Option<&Bound<'py, PyAny>>,
) -> PyResult<Bound<'py, PyAny>> {
    let (how, views) = (how(projection, cutoff)?, Views::of(angles, scanner)?);
    in_precision!(precision(dtype)?, R => project_in::<R>(py, model, scanner, &views, &how))
}

fn project_in<'py, R: Number>(
    py: Python<'py>,
    model: &Model,
    scanner: &Scanner,
    views: &Views,
    how: &Rays,
) -> PyResult<Bound<'py, PyAny>> {
    let detector = scanner.0.detector;
    fits("projections", &[views.len(), detector.rows, detector.columns], 2 * size_of::<R>())?;
    let images =
        run(py, || projector::forward::<R>(&model.0, &scanner.0, views.trajectory(), how.projection, how.cutoff))?;
    Ok(give(py, images))
}

pub(crate) fn check_images(what: &str, got: &[usize], scanner: &Scanner, views: &Views) -> PyResult<()> {
    let expected = [views.len(), scanner.0.detector.rows, scanner.0.detector.columns];
    check_shape(what, got, &expected, "give one image [v, u] of the scanner's detector per angle")
}

/// The gradient of Σ cotangent·projection to the parameters of a model.
///
/// Parameters
/// ----------
/// model : Model
/// scanner : Scanner
/// angles : sequence of float, or array [view, 12]
///     Of the views, as of `project`.
/// cotangent : ndarray [view, v, u], float32 or float64
///     Its type is the arithmetic.
/// projection, cutoff
///     As of `project`.
///
/// Returns
/// -------
/// Parameters
///     float64 arrays of the shapes of the model's. The gradient to ν of a Gaussian is 0.
///
/// Raises
/// ------
/// TypeError
///     For a cotangent that is no contiguous array of float32 or float64.
/// ValueError
///     For a cotangent of another shape, and as `project`.
#[pyfunction]
#[pyo3(signature = (model, scanner, angles, cotangent, *, projection = "exact", cutoff = 0.0))]
pub(crate) fn project_vjp<'py>(
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
    dispatch!(cotangent, |cotangent| project_vjp_in(py, model, scanner, &views, &cotangent, &how))
}

fn project_vjp_in<'py, R: Number>(
    py: Python<'py>,
    model: &Model,
    scanner: &Scanner,
    views: &Views,
    cotangent: &PyReadonlyArray3<'py, R>,
    how: &Rays,
) -> PyResult<Bound<'py, PyAny>> {
    check_images("cotangent", cotangent.shape(), scanner, views)?;
    let cotangent = cotangent.as_array();
    let gradient = run(py, || {
        projector::vjp(&model.0, &scanner.0, views.trajectory(), how.projection, how.cutoff, cotangent.view())
    })?;
    give_parameters(py, gradient)
}

/// The gradient of Σ cotangent·projection to a shift of every footprint, which density control asks for.
///
/// Parameters
/// ----------
/// model, scanner, angles, cotangent, projection, cutoff
///     As of `project_vjp`.
///
/// Returns
/// -------
/// ndarray [M, 2], float64
///     Along u and v, in halves of the detector's width and height, summed over views.
///
/// Raises
/// ------
/// TypeError, ValueError
///     As `project_vjp`.
#[pyfunction]
#[pyo3(signature = (model, scanner, angles, cotangent, *, projection = "exact", cutoff = 0.0))]
pub(crate) fn footprint_gradient<'py>(
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
    dispatch!(cotangent, |cotangent| footprints_in(py, model, scanner, &views, &cotangent, &how))
}

fn footprints_in<'py, R: Number>(
    py: Python<'py>,
    model: &Model,
    scanner: &Scanner,
    views: &Views,
    cotangent: &PyReadonlyArray3<'py, R>,
    how: &Rays,
) -> PyResult<Bound<'py, PyAny>> {
    check_images("cotangent", cotangent.shape(), scanner, views)?;
    let cotangent = cotangent.as_array();
    let shifts: Vec<[f64; 2]> = run(py, || {
        let field = Field::<R>::new(&model.0, how.cutoff);
        let mut gradient = field.zero_gradient();
        for (cotangent, view) in cotangent.outer_iter().zip(views.trajectory().views(&scanner.0)) {
            field.seen_in(&view, how.projection).vjp(cotangent, &mut gradient);
        }
        gradient.mean2d_gradients().collect()
    })?;
    Ok(give(py, Array2::from(shifts)))
}

/// The pixels that each primitive reaches in each view.
///
/// Parameters
/// ----------
/// model, scanner, angles, projection, cutoff
///     As of `project`.
///
/// Returns
/// -------
/// ndarray [view, M, 4], float64
///     Lowest row, highest row, lowest column, highest column, fractional and not clipped to the detector.
///
/// Raises
/// ------
/// ValueError
///     As `project`.
#[pyfunction]
#[pyo3(signature = (model, scanner, angles, *, projection = "exact", cutoff = 0.0))]
pub(crate) fn support<'py>(
    py: Python<'py>,
    model: &Model,
    scanner: &Scanner,
    angles: &Bound<'py, PyAny>,
    projection: &str,
    cutoff: f64,
) -> PyResult<Bound<'py, PyAny>> {
    let (how, views) = (how(projection, cutoff)?, Views::of(angles, scanner)?);
    fits("extents", &[views.len(), model.0.len(), 4], size_of::<f64>())?;
    let boxes = run(py, || {
        let field = Field::<f64>::new(&model.0, how.cutoff);
        let mut boxes = Array3::zeros((views.len(), model.0.len(), 4));
        for (view, seen) in views.trajectory().views(&scanner.0).iter().enumerate() {
            for (i, sides) in field.seen_in(seen, how.projection).support_boxes().into_iter().enumerate() {
                sides.into_iter().enumerate().for_each(|(k, side)| boxes[[view, i, k]] = side);
            }
        }
        boxes
    })?;
    Ok(give(py, boxes))
}

/// An upper bound of what a cutoff leaves out of every pixel.
///
/// Parameters
/// ----------
/// model, scanner, angles, projection, cutoff
///     As of `project`.
///
/// Returns
/// -------
/// ndarray [view, v, u], float64
///     Scene units of length times density.
///
/// Raises
/// ------
/// ValueError
///     As `project`.
#[pyfunction]
#[pyo3(signature = (model, scanner, angles, *, projection = "exact", cutoff = 1e-3))]
pub(crate) fn truncation_bound<'py>(
    py: Python<'py>,
    model: &Model,
    scanner: &Scanner,
    angles: &Bound<'py, PyAny>,
    projection: &str,
    cutoff: f64,
) -> PyResult<Bound<'py, PyAny>> {
    let (how, views) = (how(projection, cutoff)?, Views::of(angles, scanner)?);
    let detector = scanner.0.detector;
    fits("projections", &[views.len(), detector.rows, detector.columns], size_of::<f64>())?;
    let bounds = run(py, || {
        let field = Field::<f64>::new(&model.0, how.cutoff);
        let mut bounds = Array3::zeros((views.len(), detector.rows, detector.columns));
        for (mut bound, view) in bounds.outer_iter_mut().zip(views.trajectory().views(&scanner.0)) {
            bound.assign(&field.seen_in(&view, how.projection).truncation_bound());
        }
        bounds
    })?;
    Ok(give(py, bounds))
}

/// The density of a model at the voxel centres of a grid.
///
/// Parameters
/// ----------
/// model : Model
/// grid : Grid or Scanner
///     The grid, or a scanner whose grid is taken.
/// cutoff : float
///     As of `project`.
/// dtype : dtype
///     float64 (the default) or float32: the arithmetic, and the type of the result.
///
/// Returns
/// -------
/// ndarray [x, y, z]
///     Attenuation per scene unit.
///
/// Raises
/// ------
/// ValueError
///     For a cutoff out of range.
#[pyfunction]
#[pyo3(signature = (model, grid, *, cutoff = 0.0, dtype = None))]
pub(crate) fn voxelize<'py>(
    py: Python<'py>,
    model: &Model,
    grid: &Bound<'py, PyAny>,
    cutoff: f64,
    dtype: Option<&Bound<'py, PyAny>>,
) -> PyResult<Bound<'py, PyAny>> {
    let ([nx, ny, nz], bytes) = (grid_of(grid)?.shape, if precision(dtype)? == Precision::F32 { 4 } else { 8 });
    // The volume, and its slices as they are computed.
    fits("volume", &[nx, ny, nz], 2 * bytes)?;
    voxelize_part(py, model, grid, cutoff, dtype, (0, nx))
}

/// Some slices of `voxelize`.
#[pyfunction]
#[pyo3(signature = (model, grid, cutoff, dtype, slices))]
pub(crate) fn voxelize_part<'py>(
    py: Python<'py>,
    model: &Model,
    grid: &Bound<'py, PyAny>,
    cutoff: f64,
    dtype: Option<&Bound<'py, PyAny>>,
    slices: (usize, usize),
) -> PyResult<Bound<'py, PyAny>> {
    check_cutoff(cutoff)?;
    let (grid, x) = (grid_of(grid)?, slices.0..slices.1);
    Ok(in_precision!(
        precision(dtype)?,
        R => give(py, run(py, || Field::<R>::new(&model.0, cutoff).on(&grid).slices(x))?)
    ))
}

/// The gradient of Σ cotangent·volume to the parameters of a model.
///
/// Parameters
/// ----------
/// model : Model
/// grid : Grid or Scanner
///     The grid, or a scanner whose grid is taken.
/// cotangent : ndarray [x, y, z], float32 or float64
///     Its type is the arithmetic.
/// cutoff : float
///     As of `project`.
///
/// Returns
/// -------
/// Parameters
///     float64 arrays of the shapes of the model's. The gradient to ν of a Gaussian is 0.
///
/// Raises
/// ------
/// TypeError
///     For a cotangent that is no contiguous array of float32 or float64.
/// ValueError
///     For a cotangent of another shape, or a cutoff out of range.
#[pyfunction]
#[pyo3(signature = (model, grid, cotangent, *, cutoff = 0.0))]
pub(crate) fn voxelize_vjp<'py>(
    py: Python<'py>,
    model: &Model,
    grid: &Bound<'py, PyAny>,
    cotangent: &Bound<'py, PyAny>,
    cutoff: f64,
) -> PyResult<Bound<'py, PyAny>> {
    check_cutoff(cutoff)?;
    let grid = grid_of(grid)?;
    let gradient = dispatch!(read_float::<Ix3>(cotangent, "cotangent", "[x, y, z]")?, |cotangent| {
        check_shape("cotangent", cotangent.shape(), &grid.shape, "give a cotangent [x, y, z] of the grid's shape")?;
        let cotangent = cotangent.as_array();
        run(py, || projector::voxelize_vjp(&model.0, &grid, cutoff, cotangent.view()))?
    });
    give_parameters(py, gradient)
}
