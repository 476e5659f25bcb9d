//! Models: primitives, and the map between raw and physical parameters.

use crate::arrays::{copy, give, give_parameters, numbers, parameters, precision, word, wrong_value};
use crate::geometry::Scanner;
use crate::views::Views;
use crate::work::{raise, run, try_run};
use ndarray::{Array1, Array3};
use pyo3::prelude::*;
use std::path::PathBuf;
use trgs::confidence::{self, Alpha, Coverage};
use trgs::in_precision;
use trgs::primitives::activation::{self, Interval};
use trgs::primitives::{KernelKind, Primitives, student_t};
use trgs::projector;
use trgs::scan::model;

/// The names of the kernels.
const KERNELS: [(&str, KernelKind); 2] = [("student-t", KernelKind::StudentT), ("gaussian", KernelKind::Gaussian)];

/// Primitives: M kernels, whose sum is the density.
///
/// Arrays are float64, or float32, which is widened. They are copied once: a function that takes a model copies nothing.
///
/// Parameters
/// ----------
/// mean : ndarray [M, 3]
///     Centres, scene units.
/// scale : ndarray [M, 3]
///     Standard deviations along the principal axes, scene units, positive.
/// quaternion : ndarray [M, 4]
///     Rotations (w, x, y, z) of any length but 0.
/// density : ndarray [M]
///     Densities at the centres, attenuation per scene unit.
/// nu : ndarray [M]
///     Degrees of freedom, positive. If all are infinite the kernel is Gaussian.
///
/// Raises
/// ------
/// TypeError
///     For an array of another type or number of axes, or one that is not contiguous in C order.
/// ValueError
///     For another shape, and for the first value that cannot be used.
#[pyclass(frozen, module = "trgs")]
pub(crate) struct Model(pub(crate) Primitives);

/// The error about a value of a model that comes from arguments, and not from a file.
fn of_arguments(error: trgs::Error) -> PyErr {
    raise(match error {
        trgs::Error::Invalid { what, got, expected, .. } => {
            trgs::Error::invalid(what, got, expected, "correct the array; a model holds physical values, not raw ones")
        }
        error => error,
    })
}

#[pymethods]
impl Model {
    #[new]
    fn new(
        mean: Bound<'_, PyAny>,
        scale: Bound<'_, PyAny>,
        quaternion: Bound<'_, PyAny>,
        density: Bound<'_, PyAny>,
        nu: Bound<'_, PyAny>,
    ) -> PyResult<Self> {
        let parameters = parameters(&[mean, scale, quaternion, density, nu])?;
        Primitives::new(parameters).map(Self).map_err(of_arguments)
    }

    /// Reads a model.
    ///
    /// Parameters
    /// ----------
    /// path : str or os.PathLike
    ///     `.npz`, `.ply`, or a model of R²-Gaussian (`.pickle`, or its arrays as `.npz`).
    ///
    /// Returns
    /// -------
    /// Model
    ///
    /// Raises
    /// ------
    /// OSError
    ///     For a file that cannot be read.
    /// ValueError
    ///     For a damaged file, or the first value that cannot be used.
    #[staticmethod]
    fn load(py: Python<'_>, path: PathBuf) -> PyResult<Self> {
        Ok(Self(try_run(py, move || model::read(&path))?))
    }

    /// Writes the model, as a whole or not at all.
    ///
    /// Parameters
    /// ----------
    /// path : str or os.PathLike
    ///     A name that ends in `.npz` or `.ply`.
    ///
    /// Raises
    /// ------
    /// OSError
    ///     For a file that cannot be written.
    /// ValueError
    ///     For another ending.
    fn save(&self, py: Python<'_>, path: PathBuf) -> PyResult<()> {
        let ending = path.extension().map(|ending| ending.to_string_lossy().into_owned());
        try_run(py, || match ending.as_deref() {
            Some("npz") => model::write(&path, &self.0.parameters),
            Some("ply") => model::ply::write(&path, &self.0, None, &trgs::scan::Frame::default()),
            _ => {
                Err(trgs::Error::invalid("path", path.display(), "a name that ends in .npz or .ply", "give model.npz"))
            }
        })
    }

    /// Centres, scene units: a read-only float64 copy [M, 3].
    #[getter]
    fn mean<'py>(&self, py: Python<'py>) -> Bound<'py, PyAny> {
        copy(py, ndarray::Array2::from(self.0.parameters.mean.clone()))
    }

    /// Standard deviations along the principal axes, scene units: a read-only float64 copy [M, 3].
    #[getter]
    fn scale<'py>(&self, py: Python<'py>) -> Bound<'py, PyAny> {
        copy(py, ndarray::Array2::from(self.0.parameters.scale.clone()))
    }

    /// Rotations (w, x, y, z): a read-only float64 copy [M, 4].
    #[getter]
    fn quaternion<'py>(&self, py: Python<'py>) -> Bound<'py, PyAny> {
        copy(py, ndarray::Array2::from(self.0.parameters.quaternion.clone()))
    }

    /// Densities at the centres, attenuation per scene unit: a read-only float64 copy [M].
    #[getter]
    fn density<'py>(&self, py: Python<'py>) -> Bound<'py, PyAny> {
        copy(py, Array1::from(self.0.parameters.density.clone()))
    }

    /// Degrees of freedom: a read-only float64 copy [M].
    #[getter]
    fn nu<'py>(&self, py: Python<'py>) -> Bound<'py, PyAny> {
        copy(py, Array1::from(self.0.parameters.nu.clone()))
    }

    /// "student-t" or "gaussian".
    #[getter]
    fn kernel(&self) -> &'static str {
        KERNELS.iter().find(|(_, kind)| *kind == self.0.kernel).expect("a kernel with a name").0
    }

    /// Covariances Σ = R diag(s²) Rᵀ of all primitives, scene units squared.
    ///
    /// Returns
    /// -------
    /// ndarray [M, 3, 3], float64
    fn covariance<'py>(&self, py: Python<'py>) -> Bound<'py, PyAny> {
        let m = self.0.len();
        let matrices: Vec<_> = (0..m).map(|i| self.0.parameters.covariance(i)).collect();
        give(py, Array3::from_shape_fn((m, 3, 3), |(i, row, column)| matrices[i].col(column)[row]))
    }

    fn __len__(&self) -> usize {
        self.0.len()
    }

    fn __reduce__<'py>(slf: &Bound<'py, Self>) -> PyResult<(Py<PyAny>, Bound<'py, PyAny>)> {
        let arrays = give_parameters(slf.py(), slf.get().0.parameters.clone())?;
        Ok((slf.get_type().into_any().unbind(), arrays))
    }

    fn __repr__(&self) -> String {
        format!("<trgs.Model of {} {} primitives>", self.0.len(), self.kernel())
    }
}

/// The map between raw parameters, which an optimiser can move freely, and physical ones.
///
/// Scales and ν are `min + (max - min)·sigmoid(raw)`, densities are `softplus(raw)`; means and quaternions are copied.
///
/// Parameters
/// ----------
/// scale_range : tuple of float
///     Smallest and largest scale, scene units, both excluded.
/// nu_range : tuple of float
///     Smallest and largest degrees of freedom, both excluded.
/// kernel : {"student-t", "gaussian"}
///     The kernel of the models.
///
/// Raises
/// ------
/// ValueError
///     For a range that is empty or not positive, and for an unknown kernel.
#[pyclass(frozen, module = "trgs.optim")]
pub(crate) struct Activation(activation::Activation);

fn interval(what: &str, (min, max): (f64, f64)) -> PyResult<Interval> {
    if 0.0 <= min && min < max && max.is_finite() {
        return Ok(Interval { min, max });
    }
    Err(wrong_value(
        what,
        format!("({min}, {max})"),
        "two increasing positive numbers",
        "give (2.0, 100.0), for example",
    ))
}

#[pymethods]
impl Activation {
    #[new]
    #[pyo3(signature = (scale_range, nu_range = (2.0, 100.0), kernel = "student-t"))]
    fn new(scale_range: (f64, f64), nu_range: (f64, f64), kernel: &str) -> PyResult<Self> {
        Ok(Self(activation::Activation {
            kernel: word("kernel", kernel, &KERNELS)?,
            scale: interval("scale_range", scale_range)?,
            nu: interval("nu_range", nu_range)?,
        }))
    }

    /// The model of raw parameters.
    ///
    /// Parameters
    /// ----------
    /// raw : Parameters
    ///     Five arrays, float64 or float32.
    ///
    /// Returns
    /// -------
    /// Model
    fn forward(&self, py: Python<'_>, raw: [Bound<'_, PyAny>; 5]) -> PyResult<Model> {
        let raw = parameters(&raw)?;
        raw.check_finite("raw parameters", 0).map_err(raise)?;
        run(py, || Model(self.0.forward(&raw)))
    }

    /// Raw parameters of a model; values at or outside of a range are first moved just inside.
    ///
    /// Parameters
    /// ----------
    /// model : Model
    ///
    /// Returns
    /// -------
    /// Parameters
    ///     float64.
    fn inverse<'py>(&self, py: Python<'py>, model: &Model) -> PyResult<Bound<'py, PyAny>> {
        let raw = run(py, || self.0.inverse(&model.0.parameters))?;
        give_parameters(py, raw)
    }

    /// The gradient to raw parameters from the gradient to physical ones.
    ///
    /// Parameters
    /// ----------
    /// model : Model
    ///     The physical parameters.
    /// gradient : Parameters
    ///     Gradient to them, as from `project_vjp`.
    ///
    /// Returns
    /// -------
    /// Parameters
    ///     float64.
    ///
    /// Raises
    /// ------
    /// ValueError
    ///     When the gradient does not have a row for each primitive.
    fn vjp<'py>(
        &self,
        py: Python<'py>,
        model: &Model,
        gradient: [Bound<'py, PyAny>; 5],
    ) -> PyResult<Bound<'py, PyAny>> {
        let mut gradient = parameters(&gradient)?;
        if gradient.len() != model.0.len() {
            let expected = format!("{}, as many as primitives", model.0.len());
            return Err(wrong_value(
                "gradient",
                format!("{} rows", gradient.len()),
                &expected,
                "give that of this model",
            ));
        }
        let gradient = run(py, || {
            self.0.vjp(&model.0, &mut gradient);
            gradient
        })?;
        give_parameters(py, gradient)
    }
}

/// The kernel T(δ) = (1 + δ/ν)^(-(ν+3)/2), exp(-δ/2) where ν is infinite.
///
/// Parameters
/// ----------
/// delta, nu : ndarray [N], float64
///     Squared Mahalanobis distances, not negative, and degrees of freedom, positive.
/// dtype : dtype
///     float64 or float32: the arithmetic.
///
/// Returns
/// -------
/// ndarray [N]
///     Of `dtype`.
///
/// Raises
/// ------
/// ValueError
///     For arrays of different lengths or values out of range.
#[pyfunction]
#[pyo3(signature = (delta, nu, *, dtype = None))]
pub(crate) fn kernel<'py>(
    py: Python<'py>,
    delta: &Bound<'py, PyAny>,
    nu: &Bound<'py, PyAny>,
    dtype: Option<&Bound<'py, PyAny>>,
) -> PyResult<Bound<'py, PyAny>> {
    let (delta, nu) = (numbers(delta, "delta")?, numbers(nu, "nu")?);
    let expected = format!("{} numbers, as many as delta", delta.len());
    if delta.len() != nu.len() {
        return Err(wrong_value("nu", format!("{} numbers", nu.len()), &expected, "give one nu for each delta"));
    }
    if let Some(bad) = delta.iter().find(|delta| delta.is_nan() || **delta < 0.0) {
        return Err(wrong_value("delta", bad, "numbers that are not negative", "give squared distances"));
    }
    check_nu(&nu)?;
    Ok(in_precision!(
        precision(dtype)?,
        R => give(py, Array1::from(run(py, || projector::profile::<R>(&delta, &nu))?))
    ))
}

fn check_nu(nu: &[f64]) -> PyResult<()> {
    match nu.iter().find(|nu| nu.is_nan() || **nu <= 0.0) {
        None => Ok(()),
        Some(bad) => Err(wrong_value("nu", bad, "positive numbers", "give np.inf for a Gaussian")),
    }
}

/// The factor C(ν) of the line integral of a kernel, and its slope C'(ν).
///
/// Parameters
/// ----------
/// nu : ndarray [N], float64
///     Degrees of freedom, positive and finite.
///
/// Returns
/// -------
/// factor, slope : ndarray [N], float64
#[pyfunction]
pub(crate) fn integral_factor<'py>(
    py: Python<'py>,
    nu: &Bound<'py, PyAny>,
) -> PyResult<(Bound<'py, PyAny>, Bound<'py, PyAny>)> {
    let nu = numbers(nu, "nu")?;
    check_nu(&nu)?;
    let (factor, slope): (Vec<f64>, Vec<f64>) = nu.into_iter().map(student_t::line_integral).unzip();
    Ok((give(py, Array1::from(factor)), give(py, Array1::from(slope))))
}

fn settings(
    sphere_points: usize,
    alpha: Alpha,
    r_max: f64,
    kappa: f64,
    temperature: f64,
) -> PyResult<confidence::Settings> {
    let settings = confidence::Settings { sphere_points, alpha, r_max, kappa, temperature };
    settings.validate().map_err(raise)?;
    Ok(settings)
}

/// α of the confidence as an argument: a length or a word.
#[derive(FromPyObject)]
pub(crate) enum AlphaArgument {
    Length(f64),
    Word(String),
}

impl AlphaArgument {
    fn value(&self) -> PyResult<Alpha> {
        match self {
            Self::Length(length) => Ok(Alpha::Length(*length)),
            Self::Word(word) => match word.as_str() {
                "own" => Ok(Alpha::Own),
                "median" => Ok(Alpha::Median),
                other => {
                    let expected = "'own', 'median' or a length in scene units";
                    Err(wrong_value("alpha", format!("{other:?}"), expected, "give one of them"))
                }
            },
        }
    }
}

/// The ray confidence c of every primitive: how well the rays through it cover its directions.
///
/// Parameters
/// ----------
/// model : Model
/// scanner : Scanner
/// angles : sequence of float, or array [view, 12]
///     Of the views, radians, or vectors of poses: as of `project`.
/// sphere_points : int
///     Points on the sphere.
/// r_max : float
///     Largest radius that a ray covers, in units of the sphere's.
/// kappa : float
///     Ratio of alpha to the extent along the ray from which the radius is the largest.
/// alpha : 'own', 'median' or float
///     The length that a primitive's extent along a ray is compared with: the geometric mean of its own scales, the median of
///     these means over all primitives, or a number of scene units.
///
/// Returns
/// -------
/// ndarray [M], float64
///     From 0 to 1; 0 for a primitive that no view sees.
///
/// Raises
/// ------
/// ValueError
///     For a setting that is not positive.
#[pyfunction]
#[pyo3(
    name = "confidence",
    signature = (model, scanner, angles, *, sphere_points = 512, r_max = 0.5, kappa = 1.0, alpha = AlphaArgument::Word("own".into())),
    text_signature = "(model, scanner, angles, *, sphere_points=512, r_max=0.5, kappa=1.0, alpha='own')",
)]
#[allow(clippy::too_many_arguments)]
pub(crate) fn ray_confidence<'py>(
    py: Python<'py>,
    model: &Model,
    scanner: &Scanner,
    angles: &Bound<'py, PyAny>,
    sphere_points: usize,
    r_max: f64,
    kappa: f64,
    alpha: AlphaArgument,
) -> PyResult<Bound<'py, PyAny>> {
    let settings = settings(sphere_points, alpha.value()?, r_max, kappa, 1.0)?;
    let views = Views::of(angles, scanner)?;
    let found = run(py, || Coverage::new(settings).confidence(&model.0, &scanner.0, views.trajectory()))?;
    Ok(give(py, Array1::from(found)))
}

/// The degrees of freedom that follow from a confidence.
///
/// Parameters
/// ----------
/// confidence : ndarray [N], float64
///     From 0 to 1.
/// nu_range : tuple of float
///     Smallest and largest degrees of freedom.
/// sphere_points : int
///     Points of the sphere that the confidence was computed with.
/// temperature : float
///     The lower, the steeper.
///
/// Returns
/// -------
/// ndarray [N], float64
///
/// Raises
/// ------
/// ValueError
///     For a setting out of its range.
#[pyfunction]
#[pyo3(signature = (confidence, *, nu_range = (2.0, 100.0), sphere_points = 512, temperature = 0.25))]
pub(crate) fn nu_target<'py>(
    py: Python<'py>,
    confidence: &Bound<'py, PyAny>,
    nu_range: (f64, f64),
    sphere_points: usize,
    temperature: f64,
) -> PyResult<Bound<'py, PyAny>> {
    let (settings, nu) = (settings(sphere_points, Alpha::Own, 1.0, 1.0, temperature)?, interval("nu_range", nu_range)?);
    let confidence = numbers(confidence, "confidence")?;
    let target = confidence.iter().map(|&c| confidence::nu_target(c, &settings, nu));
    Ok(give(py, target.collect::<Array1<f64>>()))
}

/// The mean over primitives of weight·(1-c)·(ln ν - ln ν*)², and its gradient to ν.
///
/// Parameters
/// ----------
/// nu, target, confidence : ndarray [M], float64
///     Degrees of freedom ν, their targets ν*, and confidences c. Target and confidence are constants.
/// weight : float
///
/// Returns
/// -------
/// value : float
/// gradient : ndarray [M], float64
///
/// Raises
/// ------
/// ValueError
///     For arrays of different lengths, and ν or targets that are not positive.
#[pyfunction]
pub(crate) fn nu_loss<'py>(
    py: Python<'py>,
    nu: &Bound<'py, PyAny>,
    target: &Bound<'py, PyAny>,
    confidence: &Bound<'py, PyAny>,
    weight: f64,
) -> PyResult<(f64, Bound<'py, PyAny>)> {
    let [nu, target, confidence] = [numbers(nu, "nu")?, numbers(target, "target")?, numbers(confidence, "confidence")?];
    for (what, got) in [("target", target.len()), ("confidence", confidence.len())] {
        if got != nu.len() {
            let expected = format!("{} numbers, as many as nu", nu.len());
            return Err(wrong_value(what, format!("{got} numbers"), &expected, "give one number per primitive"));
        }
    }
    check_nu(&nu)?;
    check_nu(&target)?;
    let (value, gradient) = run(py, || confidence::nu_loss(&nu, &target, &confidence, weight))?;
    Ok((value, give(py, Array1::from(gradient))))
}
