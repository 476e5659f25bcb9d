//! Single steps: optimisers and density control.

use crate::arrays::{check_shape, give, named, numbers, read, slice, word, wrong_type, wrong_value};
use crate::geometry::corner;
use crate::model::Model;
use crate::work::{fits, raise, run};
use glam::{DMat3, DVec3};
use ndarray::{Array1, Ix1, Ix2, Ix3, IxDyn};
use numpy::{PyArray, PyArrayMethods, PyReadwriteArray, PyUntypedArrayMethods};
use pyo3::prelude::*;
use trgs::density::{NextPrimitive, Relocation, adc, ar, next_parameters};
use trgs::optim::sghmc::{self, NoiseInput, Phase};
use trgs::optim::{self, Exponential};
use trgs::primitives::Primitives;

/// An array that is changed in place.
fn writable<'py, D: ndarray::Dimension>(
    value: &Bound<'py, PyAny>,
    what: &str,
    axes: &str,
) -> PyResult<PyReadwriteArray<'py, f64, D>> {
    // The checks of reading come first, with their messages.
    drop(read::<f64, D>(value, what, axes)?);
    let array = value.cast::<PyArray<f64, D>>().map_err(PyErr::from)?;
    array.try_readwrite().map_err(|_| {
        let remedy = format!("give a copy: {what} = {what}.copy()");
        wrong_type(what, value, "an array that can be written to and is changed in place", &remedy)
    })
}

/// Adam's state for an array of parameters.
///
/// Parameters
/// ----------
/// n : int
///     Numbers in the array.
/// beta : tuple of float
///     Decay of the first and the second moment.
/// epsilon : float
///     Added to the root of the second moment.
#[pyclass(module = "trgs.optim")]
pub(crate) struct Adam {
    state: optim::Adam,
    n: usize,
}

impl Adam {
    fn check(&self, what: &str, got: usize) -> PyResult<()> {
        if got == self.n {
            return Ok(());
        }
        let expected = format!("{}, as many as the optimiser was made for", self.n);
        Err(wrong_value(what, format!("{got} numbers"), &expected, "make another trgs.optim.Adam"))
    }
}

#[pymethods]
impl Adam {
    #[new]
    #[pyo3(signature = (n, beta = (0.9, 0.999), epsilon = 1e-15))]
    fn new(n: usize, beta: (f64, f64), epsilon: f64) -> PyResult<Self> {
        fits("moments", &[n, 2], size_of::<f64>())?;
        Ok(Self { state: optim::Adam::new(n, beta.into(), epsilon), n })
    }

    /// Moves parameters by rate·m̂/(√v̂ + ε) against the gradient, in place.
    ///
    /// Parameters
    /// ----------
    /// parameters : ndarray, float64
    ///     Of any shape with `n` numbers; it is changed.
    /// gradient : ndarray, float64
    ///     Of the same shape.
    /// rate : float
    ///
    /// Raises
    /// ------
    /// TypeError
    ///     For arrays of another type, or parameters that cannot be written to.
    /// ValueError
    ///     For another number of elements, or shapes that differ.
    fn step(
        &mut self,
        py: Python<'_>,
        parameters: &Bound<'_, PyAny>,
        gradient: &Bound<'_, PyAny>,
        rate: f64,
    ) -> PyResult<()> {
        let mut parameters = writable::<IxDyn>(parameters, "parameters", "[…]")?;
        let gradient = read::<f64, IxDyn>(gradient, "gradient", "[…]")?;
        check_shape("gradient", gradient.shape(), parameters.shape(), "give one number for each parameter")?;
        self.check("parameters", parameters.len())?;
        let values = parameters.as_slice_mut().expect("a contiguous array");
        let gradient = slice(&gradient);
        run(py, || self.state.step(values, gradient, rate))
    }

    /// Updates the moments and returns m̂/(√v̂ + ε), against which a step of rate 1 goes.
    ///
    /// Parameters
    /// ----------
    /// gradient : ndarray, float64
    ///     Of any shape with `n` numbers.
    ///
    /// Returns
    /// -------
    /// ndarray, float64
    ///     Of the gradient's shape.
    ///
    /// Raises
    /// ------
    /// TypeError, ValueError
    ///     As `step`.
    fn direction<'py>(&mut self, py: Python<'py>, gradient: &Bound<'py, PyAny>) -> PyResult<Bound<'py, PyAny>> {
        let gradient = read::<f64, IxDyn>(gradient, "gradient", "[…]")?;
        self.check("gradient", gradient.len())?;
        let mut direction = ndarray::ArrayD::zeros(gradient.shape());
        let values = direction.as_slice_mut().expect("a new array is contiguous");
        let gradient = slice(&gradient);
        run(py, || self.state.direction(gradient, values))?;
        Ok(give(py, direction))
    }

    /// Adapts the moments to a new population, as density control makes it; the count of steps goes on.
    ///
    /// Parameters
    /// ----------
    /// width : int
    ///     Numbers per primitive.
    /// rows : sequence of int or None
    ///     For each new primitive the old row whose moments it takes, or None for zeros.
    ///
    /// Raises
    /// ------
    /// ValueError
    ///     For a width that does not divide `n`, or a row that does not exist.
    fn remap_rows(&mut self, width: usize, rows: Vec<Option<usize>>) -> PyResult<()> {
        if width == 0 || !self.n.is_multiple_of(width) {
            return Err(wrong_value(
                "width",
                width,
                &format!("a divisor of {}", self.n),
                "give 3 for means, for example",
            ));
        }
        let old = self.n / width;
        if let Some(bad) = rows.iter().flatten().find(|row| **row >= old) {
            return Err(wrong_value("rows", bad, &format!("rows below {old}"), "give rows of the old population"));
        }
        fits("moments", &[rows.len(), width, 2], size_of::<f64>())?;
        self.state.remap_rows(width, &rows);
        self.n = rows.len() * width;
        Ok(())
    }
}

/// Stochastic gradient Hamiltonian Monte Carlo on positions: the momentum of M primitives.
///
/// Parameters
/// ----------
/// m : int
///     Number of primitives.
#[pyclass(module = "trgs.optim")]
pub(crate) struct Sghmc {
    state: optim::Sghmc,
    m: usize,
}

#[pymethods]
impl Sghmc {
    #[new]
    fn new(m: usize) -> PyResult<Self> {
        fits("momentum", &[m, 3], size_of::<f64>())?;
        Ok(Self { state: optim::Sghmc::new(m), m })
    }

    /// Moves positions by one step, in place.
    ///
    /// In the burn-in there is no momentum and noise has the primitive's covariance; afterwards p ← s·(1 - ηC)·p - η·g +
    /// s·√(2ηC)·z. Always x ← x + η·p.
    ///
    /// Parameters
    /// ----------
    /// positions : ndarray [M, 3], float64
    ///     Scene units; it is changed.
    /// direction : ndarray [M, 3], float64
    ///     g: the quotient of Adam, without the rate.
    /// rate : float
    ///     η.
    /// friction : float
    ///     C.
    /// gate : ndarray [M], float64
    ///     s: 0 for neither momentum nor noise, as from `gate`.
    /// noise : ndarray [M, 3], float64
    ///     z: standard normal numbers.
    /// covariance : ndarray [M, 3, 3], float64, optional
    ///     Of the primitives, scene units squared: a step of the burn-in. Without it momentum counts.
    ///
    /// Raises
    /// ------
    /// TypeError
    ///     For arrays of another type, or positions that cannot be written to.
    /// ValueError
    ///     For other shapes.
    #[pyo3(signature = (positions, direction, *, rate, friction, gate, noise, covariance = None))]
    #[allow(clippy::too_many_arguments)]
    fn step(
        &mut self,
        py: Python<'_>,
        positions: &Bound<'_, PyAny>,
        direction: &Bound<'_, PyAny>,
        rate: f64,
        friction: f64,
        gate: &Bound<'_, PyAny>,
        noise: &Bound<'_, PyAny>,
        covariance: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<()> {
        let remedy = "give one row per primitive";
        let mut positions = writable::<Ix2>(positions, "positions", "[M, 3]")?;
        let direction = read::<f64, Ix2>(direction, "direction", "[M, 3]")?;
        let noise = read::<f64, Ix2>(noise, "noise", "[M, 3]")?;
        for (what, got) in
            [("positions", positions.shape()), ("direction", direction.shape()), ("noise", noise.shape())]
        {
            check_shape(what, got, &[self.m, 3], remedy)?;
        }
        let gate = read::<f64, Ix1>(gate, "gate", "[M]")?;
        check_shape("gate", gate.shape(), &[self.m], remedy)?;
        let covariance = covariance.map(|value| read::<f64, Ix3>(value, "covariance", "[M, 3, 3]")).transpose()?;
        if let Some(covariance) = &covariance {
            check_shape("covariance", covariance.shape(), &[self.m, 3, 3], remedy)?;
        }
        let phase = if covariance.is_some() { Phase::BurnIn(friction) } else { Phase::Sampling(friction) };
        let (values, _) = positions.as_slice_mut().expect("a contiguous array").as_chunks_mut::<3>();
        let ((direction, _), (noise, _)) = (slice(&direction).as_chunks::<3>(), slice(&noise).as_chunks::<3>());
        let (gate, covariance) = (slice(&gate), covariance.as_ref().map(slice));
        let noise_for = |i: usize| NoiseInput {
            gate: gate[i],
            noise: DVec3::from_array(noise[i]),
            // Rows and columns: a covariance is symmetric, and the matrix is taken as it is.
            covariance: covariance.map_or(DMat3::ZERO, |all| DMat3::from_cols_slice(&all[9 * i..]).transpose()),
        };
        run(py, || self.state.step(values, direction, rate, phase, noise_for))
    }
}

/// The gate of a primitive's momentum and noise: 1 for one that is nearly gone, 0 for one that is there.
///
/// Parameters
/// ----------
/// density : ndarray [M], float64
///     Attenuation per scene unit.
/// reference : float
///     Density from which a primitive is fully there.
///
/// Returns
/// -------
/// ndarray [M], float64
#[pyfunction]
pub(crate) fn gate<'py>(py: Python<'py>, density: &Bound<'py, PyAny>, reference: f64) -> PyResult<Bound<'py, PyAny>> {
    let gates = numbers(density, "density")?.into_iter().map(|density| sghmc::gate(density, reference));
    Ok(give(py, gates.collect::<Array1<f64>>()))
}

/// A learning rate that falls exponentially.
///
/// Parameters
/// ----------
/// step : int
///     From 0.
/// first, last : float
///     Rates at step 0 and at step `length`; if one is 0, so is every rate.
/// length : int
///     Steps of the run.
///
/// Returns
/// -------
/// float
#[pyfunction]
pub(crate) fn learning_rate(step: usize, first: f64, last: f64, length: usize) -> f64 {
    Exponential { first, last, steps: length }.at(step)
}

fn population<'py>(py: Python<'py>, old: &Primitives, next: &[NextPrimitive]) -> PyResult<Bound<'py, PyAny>> {
    let model = Primitives { kernel: old.kernel, parameters: next_parameters(&old.parameters, next) };
    let parent: Array1<i64> = next.iter().map(|primitive| primitive.parent as i64).collect();
    let fresh: Array1<bool> = next.iter().map(|primitive| primitive.fresh).collect();
    named(py, "Population")?.call1((Model(model).into_pyobject(py)?, give(py, parent), give(py, fresh)))
}

/// One step of adding and recycling.
///
/// Parameters
/// ----------
/// model : Model
/// uniform : ndarray [N], float64
///     Random numbers from 0 to below 1: one for each recycled primitive, then one for each added one.
/// dead : float
///     Density below which a primitive is recycled.
/// recycled : float
///     Largest fraction of the population that is recycled.
/// growth : float
///     Fraction of the population that is added.
/// cap : int
///     Number of primitives that growth does not lead beyond.
/// relocation : {"exact", "sss", "sss-program"}
///     How copies share the density of their parent.
///
/// Returns
/// -------
/// Population
///     `model`, `parent` [M'] (int64: row in the old model) and `fresh` [M'] (bool: new primitives).
///
/// Raises
/// ------
/// ValueError
///     For too few random numbers, and fractions that are negative.
#[pyfunction]
#[pyo3(name = "ar", signature = (model, uniform, *, dead, recycled, growth, cap, relocation = "exact"))]
#[allow(clippy::too_many_arguments)]
pub(crate) fn add_and_recycle<'py>(
    py: Python<'py>,
    model: &Model,
    uniform: &Bound<'py, PyAny>,
    dead: f64,
    recycled: f64,
    growth: f64,
    cap: usize,
    relocation: &str,
) -> PyResult<Bound<'py, PyAny>> {
    const RULES: [(&str, Relocation); 3] =
        [("exact", Relocation::Exact), ("sss", Relocation::Sss), ("sss-program", Relocation::SssProgram)];
    let relocation = word("relocation", relocation, &RULES)?;
    for (what, value) in [("recycled", recycled), ("growth", growth)] {
        if !(value >= 0.0 && value.is_finite()) {
            return Err(wrong_value(what, value, "a fraction that is not negative", "give 0.05, for example"));
        }
    }
    let uniform = numbers(uniform, "uniform")?;
    if let Some(bad) = uniform.iter().find(|draw| !(0.0..1.0).contains(*draw)) {
        return Err(wrong_value("uniform", bad, "numbers from 0 to below 1", "give np.random.default_rng().random(n)"));
    }
    // A population with the copies, and twelve numbers of each primitive with their moments.
    let copies = ((growth * model.0.len() as f64) as usize).min(cap.saturating_sub(model.0.len()));
    fits("primitives", &[model.0.len().saturating_add(copies), 3 * 12], size_of::<f64>())?;
    let settings = ar::Settings { dead, recycled, growth, cap, relocation };
    let (next, taken) = run(py, || {
        let mut taken = 0;
        let next = ar::ar(&model.0, &settings, || {
            taken += 1;
            uniform.get(taken - 1).copied().unwrap_or(0.0)
        });
        (next, taken)
    })?;
    if taken > uniform.len() {
        let expected = format!("at least {taken} for this population");
        return Err(wrong_value("uniform", format!("{} numbers", uniform.len()), &expected, "give len(model) numbers"));
    }
    population(py, &model.0, &next)
}

/// One step of adaptive density control.
///
/// Parameters
/// ----------
/// model : Model
/// pull : ndarray [M], float64
///     Mean length of `footprint_gradient` over the views that saw a primitive.
/// normals : ndarray [M, 6], float64
///     Standard normal numbers for the positions of the two parts of a split primitive.
/// gradient : float
///     Pull from which a primitive is cloned or split.
/// split_scale : float
///     Largest scale of a primitive that is cloned, scene units.
/// faint : float
///     Density below which a primitive is removed.
/// cap : int
///     Number of primitives from which none is added.
/// low, high : sequence of float
///     Corners of the box outside of which primitives are removed, scene units.
///
/// Returns
/// -------
/// Population
///     `model`, `parent` [M'] (int64: row in the old model) and `fresh` [M'] (bool: new primitives).
///
/// Raises
/// ------
/// TypeError
///     For arrays of another type or number of axes.
/// ValueError
///     For other shapes, or corners that are not in increasing order.
#[pyfunction]
#[pyo3(name = "adc", signature = (model, pull, normals, *, gradient, split_scale, faint, cap, low, high))]
#[allow(clippy::too_many_arguments)]
pub(crate) fn adaptive_control<'py>(
    py: Python<'py>,
    model: &Model,
    pull: &Bound<'py, PyAny>,
    normals: &Bound<'py, PyAny>,
    gradient: f64,
    split_scale: f64,
    faint: f64,
    cap: usize,
    low: &Bound<'py, PyAny>,
    high: &Bound<'py, PyAny>,
) -> PyResult<Bound<'py, PyAny>> {
    let remedy = "give one row per primitive";
    let pull = read::<f64, Ix1>(pull, "pull", "[M]")?;
    check_shape("pull", pull.shape(), &[model.0.len()], remedy)?;
    let normals = read::<f64, Ix2>(normals, "normals", "[M, 6]")?;
    check_shape("normals", normals.shape(), &[model.0.len(), 6], remedy)?;
    let grid = trgs::geometry::Grid::new([1; 3], corner(low, "low")?, corner(high, "high")?).map_err(raise)?;
    let settings = adc::Settings { gradient, split_scale, faint, cap };
    let (pull, (normals, _)) = (slice(&pull), slice(&normals).as_chunks::<6>());
    let next = run(py, || adc::adc(&model.0.parameters, pull, &settings, &grid, |i| normals[i]))?;
    population(py, &model.0, &next)
}
