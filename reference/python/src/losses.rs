//! Losses of images and blocks of voxels with their gradients, wavelets, and metrics.

use crate::arrays::{Float, Number, check_shape, dispatch, give, named, read, read_float, slice, wrong_value};
use crate::geometry::grid_of;
use crate::work::{fits, run, try_run};
use ndarray::{Array3, Ix2, Ix3, Ix4};
use numpy::{Element, PyReadonlyArray, PyReadonlyArray2, PyUntypedArrayMethods};
use pyo3::prelude::*;
use trgs::evaluation::{self, Metric};
use trgs::loss::{self, Ssim, SsimTarget};
use trgs::wavelet::haar::{self, BANDS, Subbands};
use trgs::wavelet::{self, Routing};

type Valued<'py> = (f64, Bound<'py, PyAny>);

/// Reads the second array of a pair, with the type and the shape of the first.
fn fellow<'py, R: Element, D: ndarray::Dimension>(
    first: &PyReadonlyArray<'py, R, D>,
    second: &Bound<'py, PyAny>,
    what: &str,
    axes: &str,
) -> PyResult<PyReadonlyArray<'py, R, D>> {
    let second = read::<R, D>(second, what, axes)?;
    check_shape(what, second.shape(), first.shape(), "give two arrays of one shape")?;
    Ok(second)
}

/// Mean absolute difference of two images, and its gradient.
///
/// Parameters
/// ----------
/// prediction, target : ndarray [v, u], float32 or float64
///     Of one type and shape.
///
/// Returns
/// -------
/// value : float
/// gradient : ndarray [v, u]
///     To the prediction, of its type; 0 where both are equal.
///
/// Raises
/// ------
/// TypeError
///     For arrays of other or different types.
/// ValueError
///     For different shapes.
#[pyfunction]
pub(crate) fn l1<'py>(
    py: Python<'py>,
    prediction: &Bound<'py, PyAny>,
    target: &Bound<'py, PyAny>,
) -> PyResult<Valued<'py>> {
    dispatch!(read_float::<Ix2>(prediction, "prediction", "[v, u]")?, |prediction| {
        let target = fellow(&prediction, target, "target", "[v, u]")?;
        let (prediction, target) = (prediction.as_array(), target.as_array());
        let (value, gradient) = run(py, || loss::l1::l1(prediction.view(), target.view()))?;
        Ok((value, give(py, gradient)))
    })
}

/// Structural similarity of two images, and its gradient.
///
/// Window of 11 × 11 pixels, σ 1.5, zeros beyond the image, dynamic range 1.
///
/// Parameters
/// ----------
/// prediction, target : ndarray [v, u], float32 or float64
///     Of one type and shape.
///
/// Returns
/// -------
/// value : float
///     1 for equal images.
/// gradient : ndarray [v, u]
///     To the prediction, of its type.
///
/// Raises
/// ------
/// TypeError, ValueError
///     As `l1`.
#[pyfunction]
pub(crate) fn ssim<'py>(
    py: Python<'py>,
    prediction: &Bound<'py, PyAny>,
    target: &Bound<'py, PyAny>,
) -> PyResult<Valued<'py>> {
    dispatch!(read_float::<Ix2>(prediction, "prediction", "[v, u]")?, |prediction| {
        let target = fellow(&prediction, target, "target", "[v, u]")?;
        ssim_in(py, &prediction, &target)
    })
}

fn ssim_in<'py, R: Number>(
    py: Python<'py>,
    prediction: &PyReadonlyArray2<'py, R>,
    target: &PyReadonlyArray2<'py, R>,
) -> PyResult<Valued<'py>> {
    let (prediction, target) = (prediction.as_array(), target.as_array());
    let (value, gradient) = run(py, || {
        let ssim = Ssim::<R>::default();
        ssim.value_and_grad(prediction.view(), &SsimTarget::new(&ssim, target.view()))
    })?;
    Ok((value, give(py, gradient)))
}

/// The data loss of a projection, L1 + weight·(1 - SSIM), and its gradient.
///
/// Parameters
/// ----------
/// prediction, target : ndarray [v, u], float32 or float64
///     Of one type and shape.
/// weight : float
///     Weight of 1 - SSIM.
///
/// Returns
/// -------
/// value : float
/// gradient : ndarray [v, u]
///     To the prediction, of its type.
///
/// Raises
/// ------
/// TypeError, ValueError
///     As `l1`.
#[pyfunction]
#[pyo3(signature = (prediction, target, weight = 0.25))]
pub(crate) fn image_loss<'py>(
    py: Python<'py>,
    prediction: &Bound<'py, PyAny>,
    target: &Bound<'py, PyAny>,
    weight: f64,
) -> PyResult<Valued<'py>> {
    dispatch!(read_float::<Ix2>(prediction, "prediction", "[v, u]")?, |prediction| {
        let target = fellow(&prediction, target, "target", "[v, u]")?;
        image_loss_in(py, &prediction, &target, weight)
    })
}

fn image_loss_in<'py, R: Number>(
    py: Python<'py>,
    prediction: &PyReadonlyArray2<'py, R>,
    target: &PyReadonlyArray2<'py, R>,
    weight: f64,
) -> PyResult<Valued<'py>> {
    let (prediction, target) = (prediction.as_array(), target.as_array());
    let (loss, cotangent) = run(py, || {
        let ssim = Ssim::<R>::default();
        loss::image_loss(&ssim, weight, prediction.view(), &SsimTarget::new(&ssim, target.view()))
    })?;
    Ok((loss.total, give(py, cotangent)))
}

/// Mean absolute difference of neighbouring voxels, and its gradient.
///
/// Parameters
/// ----------
/// block : ndarray [x, y, z], float32 or float64
///
/// Returns
/// -------
/// value : float
/// gradient : ndarray [x, y, z]
///     Of the block's type; neighbours that are equal have none.
///
/// Raises
/// ------
/// TypeError
///     For another type or number of axes.
#[pyfunction]
pub(crate) fn total_variation<'py>(py: Python<'py>, block: &Bound<'py, PyAny>) -> PyResult<Valued<'py>> {
    dispatch!(read_float::<Ix3>(block, "block", "[x, y, z]")?, |block| {
        let block = block.as_array();
        let (value, gradient) = run(py, || loss::tv::tv(block.view()))?;
        Ok((value, give(py, gradient)))
    })
}

/// Counts of neighbours are numbers of 16 bits.
fn check_neighbours(neighbours: usize) -> PyResult<()> {
    match u16::try_from(neighbours) {
        Ok(_) => Ok(()),
        Err(_) => Err(wrong_value("neighbours", neighbours, "at most 65535", "give 8, for example")),
    }
}

fn check_sides(what: &str, shape: &[usize], levels: usize) -> PyResult<()> {
    let even = |side: &usize| *side > 0 && side.trailing_zeros() as usize >= levels;
    if levels > 0 && shape.iter().all(even) {
        return Ok(());
    }
    let got = format!("shape {shape:?} with {levels} levels");
    let expected = "at least one level, and sides divisible by 2 once for each";
    Err(wrong_value(what, got, expected, "give even sides and levels=1"))
}

/// The Haar transform of a block.
///
/// Parameters
/// ----------
/// block : ndarray [x, y, z], float32 or float64
///     Sides divisible by 2 once for each level.
/// levels : int
///
/// Returns
/// -------
/// list of ndarray [8, x, y, z]
///     Coefficients level by level, finest first. Band 4·hx + 2·hy + hz is high along the axes with h = 1; band 0 of a
///     level is the input of the next one.
///
/// Raises
/// ------
/// TypeError
///     For another type or number of axes.
/// ValueError
///     For sides that cannot be halved.
#[pyfunction]
#[pyo3(name = "haar", signature = (block, levels = 1))]
pub(crate) fn haar_transform<'py>(
    py: Python<'py>,
    block: &Bound<'py, PyAny>,
    levels: usize,
) -> PyResult<Vec<Bound<'py, PyAny>>> {
    dispatch!(read_float::<Ix3>(block, "block", "[x, y, z]")?, |block| {
        check_sides("block", block.shape(), levels)?;
        let block = block.as_array();
        let subbands = run(py, || haar::forward(block.view(), levels))?;
        Ok(subbands.levels.into_iter().map(|level| give(py, level)).collect())
    })
}

/// The block of a Haar transform.
///
/// Parameters
/// ----------
/// levels : list of ndarray [8, x, y, z], float32 or float64
///     As `haar` returns them. Band 0 counts in the coarsest level only.
///
/// Returns
/// -------
/// ndarray [x, y, z]
///     Of the type of the coefficients.
///
/// Raises
/// ------
/// TypeError
///     For arrays of other or different types.
/// ValueError
///     Without levels, and for shapes that do not belong to one block.
#[pyfunction]
pub(crate) fn haar_inverse<'py>(py: Python<'py>, levels: Vec<Bound<'py, PyAny>>) -> PyResult<Bound<'py, PyAny>> {
    let Some(first) = levels.first() else {
        return Err(wrong_value("levels", "none", "at least one", "give what trgs.haar returned"));
    };
    match read_float::<Ix4>(first, "levels", "[8, x, y, z]")? {
        Float::Single(_) => haar_inverse_in::<f32>(py, &levels),
        Float::Double(_) => haar_inverse_in::<f64>(py, &levels),
    }
}

fn haar_inverse_in<'py, R: Number>(py: Python<'py>, levels: &[Bound<'py, PyAny>]) -> PyResult<Bound<'py, PyAny>> {
    let mut subbands = Subbands::<R> { levels: Vec::new() };
    for level in levels {
        let level = read::<R, Ix4>(level, "levels", "[8, x, y, z]")?;
        let finest = subbands.levels.first().map_or(level.shape(), |finest| finest.shape());
        let side = |axis: usize| finest[axis] >> subbands.levels.len();
        check_sides("levels", &finest[1..].iter().map(|side| 2 * side).collect::<Vec<_>>(), levels.len())?;
        let expected = [BANDS, side(1), side(2), side(3)];
        check_shape("levels", level.shape(), &expected, "give what trgs.haar returned")?;
        subbands.levels.push(level.as_array().to_owned());
    }
    Ok(give(py, run(py, || haar::inverse(&subbands))?))
}

/// The number of confident primitives among the nearest ones of each voxel.
///
/// Parameters
/// ----------
/// grid : Grid or Scanner
///     The block. Its sides are even.
/// means : ndarray [M, 3], float64
///     Centres of the primitives, scene units.
/// confidence : ndarray [M], float64
/// neighbours : int
///     Nearest primitives of a voxel that count.
/// threshold : float
///     Confidence from which a primitive is confident.
///
/// Returns
/// -------
/// ndarray [x, y, z], uint16
///
/// Raises
/// ------
/// TypeError
///     For arrays of another type or number of axes.
/// ValueError
///     Without primitives, for numbers that are not finite, and for settings out of their range.
#[pyfunction]
#[pyo3(signature = (grid, means, confidence, *, neighbours = 8, threshold = 0.35))]
pub(crate) fn wavelet_routing<'py>(
    py: Python<'py>,
    grid: &Bound<'py, PyAny>,
    means: &Bound<'py, PyAny>,
    confidence: &Bound<'py, PyAny>,
    neighbours: usize,
    threshold: f64,
) -> PyResult<Bound<'py, PyAny>> {
    let grid = grid_of(grid)?;
    check_neighbours(neighbours)?;
    fits("counts", &grid.shape, 2 * size_of::<u16>())?;
    let means = read::<f64, Ix2>(means, "means", "[M, 3]")?;
    let confidence = read::<f64, ndarray::Ix1>(confidence, "confidence", "[M]")?;
    let m = confidence.shape()[0];
    check_shape("means", means.shape(), &[m, 3], "give one centre x, y, z for each confidence")?;
    let (means, _) = slice(&means).as_chunks::<3>();
    let confidence = slice(&confidence);
    let settings = wavelet::Settings { neighbours, threshold, ..wavelet::Settings::default() };
    let routing = try_run(py, || wavelet::route(&grid, means, confidence, &settings))?;
    Ok(give(py, routing.high))
}

/// The wavelet loss of a block, suppress·S - enhance·E, and its gradient.
///
/// Parameters
/// ----------
/// block : ndarray [x, y, z], float32 or float64
///     Sides divisible by 2 once for each level.
/// high : ndarray [x, y, z], uint16
///     Confident ones among the nearest primitives of each voxel, as from `wavelet_routing`; a constant.
/// neighbours : int
///     Nearest primitives that were counted.
/// enhancement : float
///     Factor on the details near confident primitives.
/// suppress, enhance : float
///     Weights of smoothing and sharpening.
/// levels : int
///     Of the Haar transform.
///
/// Returns
/// -------
/// WaveletLoss
///     `value`, `gradient` (to the block, of its type), `enhancement` E and `suppression` S.
///
/// Raises
/// ------
/// TypeError
///     For arrays of another type or number of axes.
/// ValueError
///     For shapes that differ or cannot be halved, and a count above `neighbours`.
#[pyfunction]
#[pyo3(signature = (block, high, *, neighbours = 8, enhancement = 1.5, suppress = 0.03, enhance = 0.01, levels = 1))]
#[allow(clippy::too_many_arguments)]
pub(crate) fn wavelet_loss<'py>(
    py: Python<'py>,
    block: &Bound<'py, PyAny>,
    high: &Bound<'py, PyAny>,
    neighbours: usize,
    enhancement: f64,
    suppress: f64,
    enhance: f64,
    levels: usize,
) -> PyResult<Bound<'py, PyAny>> {
    check_neighbours(neighbours)?;
    let high = read::<u16, Ix3>(high, "high", "[x, y, z]")?;
    let most = slice(&high).iter().copied().max().unwrap_or(0);
    if neighbours == 0 || usize::from(most) > neighbours {
        let expected = format!("at least {}, the largest count in high", most.max(1));
        return Err(wrong_value("neighbours", neighbours, &expected, "give the number that high was computed with"));
    }
    let settings = wavelet::Settings { neighbours, enhancement, suppress, enhance, levels, ..Default::default() };
    let high: Array3<u16> = high.as_array().to_owned();
    dispatch!(read_float::<Ix3>(block, "block", "[x, y, z]")?, |block| {
        check_sides("block", block.shape(), levels)?;
        check_shape("high", high.shape(), block.shape(), "give one count per voxel of the block")?;
        let block = block.as_array();
        let routing = Routing { high, neighbours };
        let loss = run(py, || wavelet::wavelet_loss(block.view(), &routing, &settings))?;
        named(py, "WaveletLoss")?.call1((loss.value, give(py, loss.gradient), loss.enhancement, loss.suppression))
    })
}

fn metric<'py>(
    py: Python<'py>,
    [truth, result]: [&Bound<'py, PyAny>; 2],
    axes: &str,
    compute: fn(ndarray::ArrayView3<f32>, ndarray::ArrayView3<f32>) -> Metric,
) -> PyResult<Bound<'py, PyAny>> {
    let truth = read::<f32, Ix3>(truth, "truth", axes)?;
    let result = fellow(&truth, result, "result", axes)?;
    let (truth, result) = (truth.as_array(), result.as_array());
    let Metric { value, definition, detail } = run(py, || compute(truth.view(), result.view()))?;
    named(py, "Metric")?.call1((value, definition, detail))
}

/// PSNR of a volume with peak 1, dB.
///
/// Parameters
/// ----------
/// truth, result : ndarray [x, y, z], float32
///     Of one shape.
///
/// Returns
/// -------
/// Metric
///     `value` is infinite for equal volumes; `definition` is its id.
///
/// Raises
/// ------
/// TypeError
///     For arrays of another type or number of axes.
/// ValueError
///     For different shapes.
#[pyfunction]
pub(crate) fn psnr_3d<'py>(
    py: Python<'py>,
    truth: &Bound<'py, PyAny>,
    result: &Bound<'py, PyAny>,
) -> PyResult<Bound<'py, PyAny>> {
    metric(py, [truth, result], "[x, y, z]", evaluation::psnr_3d)
}

/// SSIM of a volume: mean over the axes of the mean over slices whose truth has a value above 0.
///
/// Parameters
/// ----------
/// truth, result : ndarray [x, y, z], float32
///     Of one shape.
///
/// Returns
/// -------
/// Metric
///     `detail` has the mean across each axis.
///
/// Raises
/// ------
/// TypeError, ValueError
///     As `psnr_3d`.
#[pyfunction]
pub(crate) fn ssim_3d<'py>(
    py: Python<'py>,
    truth: &Bound<'py, PyAny>,
    result: &Bound<'py, PyAny>,
) -> PyResult<Bound<'py, PyAny>> {
    metric(py, [truth, result], "[x, y, z]", evaluation::ssim_3d)
}

/// PSNR of projections, each divided by its own maximum, dB: mean over views whose truth has a value above 0.
///
/// Parameters
/// ----------
/// truth, result : ndarray [view, v, u], float32
///     Of one shape.
///
/// Returns
/// -------
/// Metric
///     `detail` has the value of each view, NaN of one that is left out.
///
/// Raises
/// ------
/// TypeError, ValueError
///     As `psnr_3d`.
#[pyfunction]
pub(crate) fn psnr_2d<'py>(
    py: Python<'py>,
    truth: &Bound<'py, PyAny>,
    result: &Bound<'py, PyAny>,
) -> PyResult<Bound<'py, PyAny>> {
    metric(py, [truth, result], "[view, v, u]", evaluation::psnr_2d)
}

/// SSIM of projections, each divided by its own maximum: mean over views whose truth has a value above 0.
///
/// Parameters
/// ----------
/// truth, result : ndarray [view, v, u], float32
///     Of one shape.
///
/// Returns
/// -------
/// Metric
///     `detail` has the value of each view, NaN of one that is left out.
///
/// Raises
/// ------
/// TypeError, ValueError
///     As `psnr_3d`.
#[pyfunction]
pub(crate) fn ssim_2d<'py>(
    py: Python<'py>,
    truth: &Bound<'py, PyAny>,
    result: &Bound<'py, PyAny>,
) -> PyResult<Bound<'py, PyAny>> {
    metric(py, [truth, result], "[view, v, u]", evaluation::ssim_2d)
}
