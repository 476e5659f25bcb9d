//! Projections of voxels and their adjoint, and reconstruction on voxels.

use crate::arrays::{self, dispatch, give, read, read_float, word, wrong_value};
use crate::geometry::Scanner;
use crate::views::Views;
use crate::work::{Event, Watch, fits, raise, run, try_run};
use ndarray::Ix3;
use pyo3::prelude::*;
use serde_json::json;
use trgs::Projections;
use trgs::classical::algebraic::{self, Observe, Order, Pass, Trial};
use trgs::classical::{self, RayModel, Turn, VoxelProjector, Window};
use trgs::config::{Auto, Precision};
use trgs::scan::plausibility;
use trgs::{Config, Method};

const RAYS: [(&str, RayModel); 2] = [("joseph", RayModel::Joseph), ("siddon", RayModel::Siddon)];
const TURNS: [(&str, Turn); 2] = [("measured", Turn::Measured), ("full", Turn::Full)];
const ORDERS: [(&str, Order); 3] =
    [("input", Order::Input), ("random", Order::Random), ("angular-distance", Order::AngularDistance)];

fn projector(scanner: &Scanner, rays: &str) -> PyResult<VoxelProjector> {
    VoxelProjector::new(&scanner.0, word("rays", rays, &RAYS)?).map_err(raise)
}

/// Line integrals A x of voxels.
///
/// Parameters
/// ----------
/// volume : ndarray [x, y, z], float32 or float64
///     On the scanner's grid, attenuation per scene unit. Its type is the arithmetic.
/// scanner : Scanner
/// angles : sequence of float, or array [view, 12]
///     Of the views, radians, or vectors of poses: as of `project`.
/// rays : {"joseph", "siddon"}
///     Weights of the voxels on a ray: bilinear in planes of voxel centres, or the length in each voxel.
///
/// Returns
/// -------
/// ndarray [view, v, u]
///     Scene units of length times density, of the volume's type.
///
/// Raises
/// ------
/// TypeError
///     For a volume that is no contiguous array of float32 or float64.
/// ValueError
///     For a volume of another shape, an unknown word, or without angles.
#[pyfunction]
#[pyo3(signature = (volume, scanner, angles, *, rays = "joseph"))]
pub(crate) fn forward_project<'py>(
    py: Python<'py>,
    volume: &Bound<'py, PyAny>,
    scanner: &Scanner,
    angles: &Bound<'py, PyAny>,
    rays: &str,
) -> PyResult<Bound<'py, PyAny>> {
    let (projector, views) = (projector(scanner, rays)?, Views::of(angles, scanner)?);
    let detector = scanner.0.detector;
    fits("projections", &[views.len(), detector.rows, detector.columns], 2 * size_of::<f64>())?;
    dispatch!(read_float::<Ix3>(volume, "volume", "[x, y, z]")?, |volume| {
        let volume = volume.as_array();
        Ok(give(py, try_run(py, || projector.forward(views.trajectory(), volume.view()))?))
    })
}

/// The exact adjoint Aᵀ y of `forward_project`.
///
/// Parameters
/// ----------
/// projections : ndarray [view, v, u], float32 or float64
///     Its type is the arithmetic.
/// scanner, angles, rays
///     As of `forward_project`.
///
/// Returns
/// -------
/// ndarray [x, y, z]
///     On the scanner's grid, of the type of the projections.
///
/// Raises
/// ------
/// TypeError, ValueError
///     As `forward_project`.
#[pyfunction]
#[pyo3(signature = (projections, scanner, angles, *, rays = "joseph"))]
pub(crate) fn back_project<'py>(
    py: Python<'py>,
    projections: &Bound<'py, PyAny>,
    scanner: &Scanner,
    angles: &Bound<'py, PyAny>,
    rays: &str,
) -> PyResult<Bound<'py, PyAny>> {
    fits("volume", &scanner.0.grid.shape, 2 * size_of::<f64>())?;
    let (projector, views) = (projector(scanner, rays)?, Views::of(angles, scanner)?);
    dispatch!(read_float::<Ix3>(projections, "projections", "[view, v, u]")?, |projections| {
        let projections = projections.as_array();
        Ok(give(py, try_run(py, || projector.adjoint(views.trajectory(), projections.view()))?))
    })
}

/// Weighted and filtered projections, the first part of `fdk`.
///
/// Parameters
/// ----------
/// projections : ndarray [view, v, u], float32 or float64
///     Line integrals. Its type is the arithmetic.
/// scanner, angles, window
///     As of `fdk`.
///
/// Returns
/// -------
/// ndarray [view, v, u]
///     Attenuation per scene unit.
///
/// Raises
/// ------
/// TypeError, ValueError
///     As `fdk`.
#[pyfunction]
#[pyo3(signature = (projections, scanner, angles, *, window = "ram-lak"))]
pub(crate) fn fdk_filter<'py>(
    py: Python<'py>,
    projections: &Bound<'py, PyAny>,
    scanner: &Scanner,
    angles: &Bound<'py, PyAny>,
    window: &str,
) -> PyResult<Bound<'py, PyAny>> {
    let (window, angles) = (word("window", window, &Window::NAMED)?, Views::circle(angles, scanner)?);
    dispatch!(read_float::<Ix3>(projections, "projections", "[view, v, u]")?, |projections| {
        let projections = projections.as_array();
        Ok(give(py, try_run(py, || classical::fdk::filter(&scanner.0, &angles, projections.view(), window))?))
    })
}

/// The weighted sum of filtered projections at every voxel, the second part of `fdk`.
///
/// Parameters
/// ----------
/// filtered : ndarray [view, v, u], float32 or float64
///     As `fdk_filter` returns it. Its type is the arithmetic.
/// scanner, angles
///     As of `fdk`.
///
/// Returns
/// -------
/// ndarray [x, y, z]
///     Attenuation per scene unit.
///
/// Raises
/// ------
/// TypeError, ValueError
///     As `fdk`.
#[pyfunction]
pub(crate) fn fdk_backproject<'py>(
    py: Python<'py>,
    filtered: &Bound<'py, PyAny>,
    scanner: &Scanner,
    angles: &Bound<'py, PyAny>,
) -> PyResult<Bound<'py, PyAny>> {
    let angles = Views::circle(angles, scanner)?;
    fits("volume", &scanner.0.grid.shape, 2 * size_of::<f64>())?;
    dispatch!(read_float::<Ix3>(filtered, "filtered", "[view, v, u]")?, |filtered| {
        let filtered = filtered.as_array();
        Ok(give(py, try_run(py, || classical::fdk::backproject(&scanner.0, &angles, filtered.view()))?))
    })
}

/// Measured line integrals with their angles or poses; the volume's arithmetic is another matter.
pub(crate) fn measured(
    projections: &Bound<'_, PyAny>,
    scanner: &Scanner,
    angles: &Bound<'_, PyAny>,
) -> PyResult<Projections> {
    let views = Views::of(angles, scanner)?;
    let images = read::<f32, Ix3>(projections, "projections", "[view, v, u]")?;
    Projections::along(views.trajectory(), images.as_array().to_owned()).map_err(raise)
}

/// [`measured`], refused where no method makes anything of it: views that are empty or have the wrong sign.
pub(crate) fn to_reconstruct(
    projections: &Bound<'_, PyAny>,
    scanner: &Scanner,
    angles: &Bound<'_, PyAny>,
) -> PyResult<Projections> {
    let measured = measured(projections, scanner, angles)?;
    plausibility::check_views(&measured).map_err(raise).map(|()| measured)
}

/// Filtered backprojection (Feldkamp, Davis, Kress; of a parallel beam the exact one).
///
/// Parameters
/// ----------
/// projections : ndarray [view, v, u], float32
///     Line integrals, scene units of length times density.
/// scanner : Scanner
/// angles : sequence of float, or array [view, 12]
///     Of the views, radians, or vectors of poses: as of `project`. Filtered backprojection takes poses on a circle.
/// window : {"ram-lak", "shepp-logan", "cosine", "hamming", "hann"}
///     Factor on the ramp filter.
/// turn : {"measured", "full"}
///     The range of angles: the measured one with its weights, or a full turn even if views are missing.
///
/// Returns
/// -------
/// ndarray [x, y, z], float32
///     On the scanner's grid, attenuation per scene unit.
///
/// Raises
/// ------
/// TypeError
///     For projections that are no contiguous array of float32.
/// ValueError
///     For other shapes, an unknown word, and views that lack rays.
#[pyfunction]
#[pyo3(signature = (projections, scanner, angles, *, window = "ram-lak", turn = "measured"))]
pub(crate) fn fdk<'py>(
    py: Python<'py>,
    projections: &Bound<'py, PyAny>,
    scanner: &Scanner,
    angles: &Bound<'py, PyAny>,
    window: &str,
    turn: &str,
) -> PyResult<Bound<'py, PyAny>> {
    let (window, turn) = window_and_turn(window, turn)?;
    let measured = to_reconstruct(projections, scanner, angles)?;
    fits("volume", &scanner.0.grid.shape, 2 * size_of::<f32>())?;
    Ok(give(py, try_run(py, || classical::fdk(&scanner.0, &measured, window, turn))?.values))
}

pub(crate) fn window_and_turn(window: &str, turn: &str) -> PyResult<(Window, Turn)> {
    Ok((word("window", window, &Window::NAMED)?, word("turn", turn, &TURNS)?))
}

/// What a callback gets of a value that was tried.
pub(crate) fn trial_event(key: &str, trial: &Trial) -> Event {
    let values = json!({ "key": key, "value": trial.value, "error": trial.error });
    Event { stage: "choosing", iteration: 0, iterations: 0, values }
}

/// What is reported after a pass.
pub(crate) fn pass_event(pass: &Pass) -> Event {
    let Pass { iteration, iterations, residual, objective, change } = *pass;
    let mut values = json!({ "residual": residual });
    for (key, value) in [("objective", objective), ("change", change)] {
        if let Some(value) = value {
            values[key] = json!(value);
        }
    }
    Event { stage: "voxels", iteration, iterations, values }
}

/// Runs an iterative method in the given precision.
fn iterate<'py>(
    py: Python<'py>,
    callback: Option<Py<PyAny>>,
    work: impl FnOnce(&mut Observe<'_>) -> trgs::Result<trgs::Volume> + Send,
) -> PyResult<Bound<'py, PyAny>> {
    let (result, watch) = run(py, || {
        let mut watch = Watch::new(callback);
        let result = work(&mut |pass: &Pass| watch.see(Some(pass_event(pass))));
        (result, watch)
    })?;
    Ok(give(py, watch.end(result)?.values))
}

/// Calls a method of the library in float32 or float64.
macro_rules! in_precision {
    ($precision:expr, $method:ident, $($argument:expr),*) => {
        match $precision {
            Precision::F32 => algebraic::$method::<f32>($($argument),*),
            Precision::F64 => algebraic::$method::<f64>($($argument),*),
        }
    };
}

/// Checks the number of iterations, and that the volumes of any method fit into memory: `tv` has twelve in its own precision.
fn check_run(iterations: usize, scanner: &Scanner) -> PyResult<()> {
    if iterations > 0 {
        return fits("volumes of the method", &scanner.0.grid.shape, 12 * size_of::<f32>() + size_of::<f32>());
    }
    Err(wrong_value("iterations", 0, "at least 1", "give iterations=20"))
}

/// Simultaneous algebraic reconstruction from zeros, view by view.
///
/// Parameters
/// ----------
/// projections : ndarray [view, v, u], float32
///     Line integrals, scene units of length times density.
/// scanner : Scanner
/// angles : sequence of float, or array [view, 12]
///     Of the views, radians, or vectors of poses: as of `project`.
/// iterations : int
///     Passes over all views.
/// relaxation : float
///     Factor on the corrections of the first pass.
/// reduction : float
///     Factor on the relaxation after every pass.
/// order : {"input", "random", "angular-distance"}
///     Order of the views.
/// non_negative : bool
///     Whether negative values become 0 after every correction.
/// tolerance : float
///     Ends when a pass lowers the residual by less than this fraction; 0 runs all passes.
/// seed : int
///     Of the random order.
/// rays : {"joseph", "siddon"}
///     As of `forward_project`.
/// dtype : dtype
///     float32 (the default here) or float64: the arithmetic. The result is float32.
/// callback : callable, optional
///     Gets a `Progress` after every pass. What it raises ends the run and is raised here.
///
/// Returns
/// -------
/// ndarray [x, y, z], float32
///     On the scanner's grid, attenuation per scene unit.
///
/// Raises
/// ------
/// TypeError
///     For projections that are no contiguous array of float32.
/// ValueError
///     For other shapes and settings out of their range.
/// ArithmeticError
///     When values become infinite.
#[pyfunction]
#[pyo3(signature = (projections, scanner, angles, *, iterations = 20, relaxation = 1.0, reduction = 0.999, order = "input",
    non_negative = true, tolerance = 0.0, seed = 0, rays = "joseph", dtype = None, callback = None))]
#[allow(clippy::too_many_arguments)]
pub(crate) fn sart<'py>(
    py: Python<'py>,
    projections: &Bound<'py, PyAny>,
    scanner: &Scanner,
    angles: &Bound<'py, PyAny>,
    iterations: usize,
    relaxation: f64,
    reduction: f64,
    order: &str,
    non_negative: bool,
    tolerance: f64,
    seed: u64,
    rays: &str,
    dtype: Option<&Bound<'py, PyAny>>,
    callback: Option<Py<PyAny>>,
) -> PyResult<Bound<'py, PyAny>> {
    os_sart(
        py,
        projections,
        scanner,
        angles,
        1,
        iterations,
        relaxation,
        reduction,
        order,
        non_negative,
        tolerance,
        seed,
        rays,
        dtype,
        callback,
    )
}

/// SART by subsets of views.
///
/// Parameters
/// ----------
/// subset : int
///     Views per correction.
/// projections, scanner, angles, iterations, relaxation, reduction, order, non_negative, tolerance, seed, rays, dtype, callback
///     As of `sart`.
///
/// Returns
/// -------
/// ndarray [x, y, z], float32
///     On the scanner's grid, attenuation per scene unit.
///
/// Raises
/// ------
/// TypeError, ValueError, ArithmeticError
///     As `sart`.
#[pyfunction]
#[pyo3(signature = (projections, scanner, angles, *, subset = 10, iterations = 20, relaxation = 1.0, reduction = 0.999,
    order = "input", non_negative = true, tolerance = 0.0, seed = 0, rays = "joseph", dtype = None, callback = None))]
#[allow(clippy::too_many_arguments)]
pub(crate) fn os_sart<'py>(
    py: Python<'py>,
    projections: &Bound<'py, PyAny>,
    scanner: &Scanner,
    angles: &Bound<'py, PyAny>,
    subset: usize,
    iterations: usize,
    relaxation: f64,
    reduction: f64,
    order: &str,
    non_negative: bool,
    tolerance: f64,
    seed: u64,
    rays: &str,
    dtype: Option<&Bound<'py, PyAny>>,
    callback: Option<Py<PyAny>>,
) -> PyResult<Bound<'py, PyAny>> {
    check_run(iterations, scanner)?;
    let order = word("order", order, &ORDERS)?;
    let mut config = Config::of(Method::OsSart);
    (config.iterations, config.seed) = (iterations, seed);
    let part = &mut config.algebraic;
    (part.relaxation, part.reduction, part.subset, part.order) = (relaxation, reduction, subset, order);
    (part.non_negative, part.tolerance) = (non_negative, tolerance);
    config.validate().map_err(raise)?;
    let sart = config.sart();
    let (projector, measured) = (projector(scanner, rays)?, to_reconstruct(projections, scanner, angles)?);
    let precision = single(dtype)?;
    iterate(py, callback, |observe| in_precision!(precision, sart, &projector, &measured, &sart, observe))
}

/// float32 unless the caller says otherwise.
fn single(dtype: Option<&Bound<'_, PyAny>>) -> PyResult<Precision> {
    dtype.map_or(Ok(Precision::F32), |dtype| arrays::precision(Some(dtype)))
}

/// ASD-POCS from zeros: SART and descent of the total variation in turn.
///
/// Parameters
/// ----------
/// iterations : int
///     Passes over all views.
/// tv_steps : int
///     Steps of the descent per iteration.
/// alpha, alpha_reduction : float
///     First step of the descent as a fraction of SART's, and the factor on it when the descent undoes too much.
/// r_max : float
///     The fraction of SART's step from which on the descent undoes too much.
/// epsilon : float
///     Sufficient residual, as a fraction of that of `fdk`.
/// unit : float
///     The density that counts as 1.
/// relaxation, reduction : float
///     As of `sart`.
/// projections, scanner, angles, rays, dtype, callback
///     As of `sart`.
///
/// Returns
/// -------
/// ndarray [x, y, z], float32
///     On the scanner's grid, attenuation per scene unit.
///
/// Raises
/// ------
/// TypeError, ValueError, ArithmeticError
///     As `sart`.
#[pyfunction]
#[pyo3(signature = (projections, scanner, angles, *, iterations = 10, tv_steps = 20, alpha = 0.002, alpha_reduction = 0.95,
    r_max = 0.94, epsilon = 0.15, unit = 1.0, relaxation = 1.0, reduction = 0.9999, rays = "joseph", dtype = None,
    callback = None))]
#[allow(clippy::too_many_arguments)]
pub(crate) fn asd_pocs<'py>(
    py: Python<'py>,
    projections: &Bound<'py, PyAny>,
    scanner: &Scanner,
    angles: &Bound<'py, PyAny>,
    iterations: usize,
    tv_steps: usize,
    alpha: f64,
    alpha_reduction: f64,
    r_max: f64,
    epsilon: f64,
    unit: f64,
    relaxation: f64,
    reduction: f64,
    rays: &str,
    dtype: Option<&Bound<'py, PyAny>>,
    callback: Option<Py<PyAny>>,
) -> PyResult<Bound<'py, PyAny>> {
    check_run(iterations, scanner)?;
    let mut config = Config::of(Method::AsdPocs);
    (config.iterations, config.density_unit) = (iterations, Auto::Fixed(unit));
    (config.algebraic.relaxation, config.algebraic.reduction) = (relaxation, reduction);
    let part = &mut config.asd_pocs;
    (part.tv_steps, part.alpha, part.alpha_reduction) = (tv_steps, alpha, alpha_reduction);
    (part.r_max, part.epsilon) = (r_max, epsilon);
    config.validate().map_err(raise)?;
    let settings = config.asd_pocs();
    let (projector, measured) = (projector(scanner, rays)?, to_reconstruct(projections, scanner, angles)?);
    let precision = single(dtype)?;
    iterate(py, callback, |observe| in_precision!(precision, asd_pocs, &projector, &measured, &settings, observe))
}

/// Conjugate gradients on the normal equations, from zeros.
///
/// Parameters
/// ----------
/// iterations : int
///     Dimensions of the Krylov space: few smooth, many fit the noise.
/// projections, scanner, angles, rays, dtype, callback
///     As of `sart`.
///
/// Returns
/// -------
/// ndarray [x, y, z], float32
///     On the scanner's grid, attenuation per scene unit; values may be negative.
///
/// Raises
/// ------
/// TypeError, ValueError, ArithmeticError
///     As `sart`.
#[pyfunction]
#[pyo3(signature = (projections, scanner, angles, *, iterations = 20, rays = "joseph", dtype = None, callback = None))]
#[allow(clippy::too_many_arguments)]
pub(crate) fn cgls<'py>(
    py: Python<'py>,
    projections: &Bound<'py, PyAny>,
    scanner: &Scanner,
    angles: &Bound<'py, PyAny>,
    iterations: usize,
    rays: &str,
    dtype: Option<&Bound<'py, PyAny>>,
    callback: Option<Py<PyAny>>,
) -> PyResult<Bound<'py, PyAny>> {
    check_run(iterations, scanner)?;
    let (projector, measured) = (projector(scanner, rays)?, to_reconstruct(projections, scanner, angles)?);
    let precision = single(dtype)?;
    iterate(py, callback, |observe| in_precision!(precision, cgls, &projector, &measured, iterations, observe))
}

/// Least squares without negative values, with total variation: FISTA from zeros.
///
/// Parameters
/// ----------
/// weight : float
///     Of the total variation, as a fraction of the largest entry of Aᵀp.
/// iterations : int
///     At most.
/// tolerance : float
///     Ends when a step is shorter than this fraction of the volume's norm.
/// steps : int
///     Of the dual problem of the total variation, per iteration.
/// projections, scanner, angles, rays, dtype, callback
///     As of `sart`.
///
/// Returns
/// -------
/// ndarray [x, y, z], float32
///     On the scanner's grid, attenuation per scene unit.
///
/// Raises
/// ------
/// TypeError, ValueError, ArithmeticError
///     As `sart`.
#[pyfunction]
#[pyo3(signature = (projections, scanner, angles, *, weight = 1e-3, iterations = 40, tolerance = 1e-4, steps = 10,
    rays = "joseph", dtype = None, callback = None))]
#[allow(clippy::too_many_arguments)]
pub(crate) fn tv<'py>(
    py: Python<'py>,
    projections: &Bound<'py, PyAny>,
    scanner: &Scanner,
    angles: &Bound<'py, PyAny>,
    weight: f64,
    iterations: usize,
    tolerance: f64,
    steps: usize,
    rays: &str,
    dtype: Option<&Bound<'py, PyAny>>,
    callback: Option<Py<PyAny>>,
) -> PyResult<Bound<'py, PyAny>> {
    check_run(iterations, scanner)?;
    let mut config = Config::of(Method::Tv);
    config.iterations = iterations;
    (config.tv.weight, config.tv.tolerance, config.tv.steps) = (Auto::Fixed(weight), tolerance, steps);
    config.validate().map_err(raise)?;
    let settings = config.tv();
    let (projector, measured) = (projector(scanner, rays)?, to_reconstruct(projections, scanner, angles)?);
    let precision = single(dtype)?;
    iterate(py, callback, |observe| in_precision!(precision, tv, &projector, &measured, &settings, None, observe))
}
