//! NumPy arrays in and out. An array is checked and never converted; a result is handed over without a copy.

use ndarray::{Array, Array2, Dimension};
use numpy::{Element, IntoPyArray, PyArray, PyArrayDescr, PyArrayDescrMethods, PyArrayMethods};
use numpy::{PyReadonlyArray, PyUntypedArray, PyUntypedArrayMethods};
use pyo3::exceptions::{PyTypeError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::{PyInt, PyList, PyTuple};
use trgs::classical::fdk::Sample;
use trgs::config::Precision;
use trgs::numeric::Real;
use trgs::primitives::{Group, Parameters};
use trgs::projector::Kernels;

/// The types of numbers that pixels and voxels have: float32 and float64.
pub(crate) trait Number: Kernels + Sample + Element {}

impl Number for f32 {}
impl Number for f64 {}

/// An array of one of the two types.
pub(crate) enum Float<'py, D: Dimension> {
    Single(PyReadonlyArray<'py, f32, D>),
    Double(PyReadonlyArray<'py, f64, D>),
}

/// Calls a function that is generic over the type of numbers with the array that there is.
macro_rules! dispatch {
    ($array:expr, |$view:ident| $call:expr) => {
        match $array {
            $crate::arrays::Float::Single($view) => $call,
            $crate::arrays::Float::Double($view) => $call,
        }
    };
}
pub(crate) use dispatch;

/// `TypeError` in the form of the library's messages.
pub(crate) fn wrong_type(what: &str, got: &Bound<'_, PyAny>, expected: &str, remedy: &str) -> PyErr {
    PyTypeError::new_err(format!("{what}: got {}, expected {expected}; {remedy}", describe(got)))
}

/// `ValueError` in the form of the library's messages.
pub(crate) fn wrong_value(what: &str, got: impl std::fmt::Display, expected: &str, remedy: &str) -> PyErr {
    PyValueError::new_err(format!("{what}: got {got}, expected {expected}; {remedy}"))
}

/// Type, and of an array its numbers, shape and order.
fn describe(value: &Bound<'_, PyAny>) -> String {
    let kind = value.get_type().name().map_or_else(|_| "an object".into(), |name| name.to_string());
    match value.cast::<PyUntypedArray>() {
        Ok(array) => {
            let order = if array.is_c_contiguous() { "" } else { ", not contiguous in C order" };
            format!("{kind} of {}, shape {:?}{order}", array.dtype(), array.shape())
        }
        Err(_) => format!("an object of type {kind}"),
    }
}

fn names(types: &[&str]) -> String {
    types.join(" or ")
}

fn refused(value: &Bound<'_, PyAny>, what: &str, axes: &str, types: &[&str], dimensions: Option<usize>) -> PyErr {
    let expected = format!("a C-contiguous NumPy array of {}, {axes}", names(types));
    let got = value.cast::<PyUntypedArray>().ok().map(|array| array.ndim());
    // Another type or order is no help to an array with another number of axes.
    let remedy = match (got, dimensions) {
        (Some(got), Some(wanted)) if got != wanted => {
            format!("give an array with {}, {axes}", counted(wanted, "axis", "axes"))
        }
        _ => format!("give np.ascontiguousarray({what}, dtype=np.{})", types[types.len() - 1]),
    };
    wrong_type(what, value, &expected, &remedy)
}

fn counted(count: usize, one: &str, more: &str) -> String {
    format!("{count} {}", if count == 1 { one } else { more })
}

/// Borrows the array where type, number of axes, order and alignment fit.
fn fitting<'py, T: Element, D: Dimension>(value: &Bound<'py, PyAny>) -> PyResult<Option<PyReadonlyArray<'py, T, D>>> {
    let Ok(array) = value.cast::<PyArray<T, D>>() else { return Ok(None) };
    let aligned: bool = value.getattr("flags")?.getattr("aligned")?.extract()?;
    if !(array.is_c_contiguous() && aligned) {
        return Ok(None);
    }
    Ok(Some(array.try_readonly()?))
}

/// An array of exactly the type `T`.
pub(crate) fn read<'py, T: Element, D: Dimension>(
    value: &Bound<'py, PyAny>,
    what: &str,
    axes: &str,
) -> PyResult<PyReadonlyArray<'py, T, D>> {
    let name = T::get_dtype(value.py()).to_string();
    fitting(value)?.ok_or_else(|| refused(value, what, axes, &[&name], D::NDIM))
}

/// An array of float32 or float64.
pub(crate) fn read_float<'py, D: Dimension>(
    value: &Bound<'py, PyAny>,
    what: &str,
    axes: &str,
) -> PyResult<Float<'py, D>> {
    if let Some(array) = fitting(value)? {
        return Ok(Float::Single(array));
    }
    let array = fitting(value)?.ok_or_else(|| refused(value, what, axes, &["float32", "float64"], D::NDIM))?;
    Ok(Float::Double(array))
}

/// A contiguous array of numbers as a slice.
pub(crate) fn slice<'a, T: Element, D: Dimension>(array: &'a PyReadonlyArray<'_, T, D>) -> &'a [T] {
    array.as_slice().expect("only contiguous arrays are read")
}

/// Numbers of float64 `[N]`: a NumPy array, or a sequence of Python numbers.
pub(crate) fn numbers(value: &Bound<'_, PyAny>, what: &str) -> PyResult<Vec<f64>> {
    if value.cast::<PyUntypedArray>().is_ok() {
        return Ok(slice(&read::<f64, ndarray::Ix1>(value, what, "[N]")?).to_vec());
    }
    let expected = "a sequence of numbers, or a C-contiguous NumPy array of float64, [N]";
    value.extract().map_err(|_| wrong_type(what, value, expected, &format!("give [0.0, 0.5] as {what}, for example")))
}

/// Refuses an array of another shape.
pub(crate) fn check_shape(what: &str, got: &[usize], expected: &[usize], remedy: &str) -> PyResult<()> {
    if got == expected {
        return Ok(());
    }
    Err(wrong_value(what, format!("shape {got:?}"), &format!("shape {expected:?}"), remedy))
}

/// The precision of a dtype; float64 for `None`.
pub(crate) fn precision(dtype: Option<&Bound<'_, PyAny>>) -> PyResult<Precision> {
    let Some(value) = dtype else { return Ok(Precision::F64) };
    let py = value.py();
    if let Ok(descr) = PyArrayDescr::new(py, value) {
        if descr.is_equiv_to(&f32::get_dtype(py)) {
            return Ok(Precision::F32);
        }
        if descr.is_equiv_to(&f64::get_dtype(py)) {
            return Ok(Precision::F64);
        }
    }
    let got = value.repr().map_or_else(|_| "an object".into(), |text| text.to_string());
    Err(wrong_value("dtype", got, "float32 or float64", "give np.float32 or np.float64"))
}

/// A word out of a list with values.
pub(crate) fn word<T: Copy>(what: &str, got: &str, words: &[(&str, T)]) -> PyResult<T> {
    words.iter().find(|(word, _)| *word == got).map(|(_, value)| *value).ok_or_else(|| {
        let known: Vec<_> = words.iter().map(|(word, _)| format!("{word:?}")).collect();
        let remedy = format!("give {what}={}", known[0]);
        wrong_value(what, format!("{got:?}"), &format!("one of {}", known.join(", ")), &remedy)
    })
}

/// Hands an array over to Python.
pub(crate) fn give<T: Element, D: Dimension>(py: Python<'_>, array: Array<T, D>) -> Bound<'_, PyAny> {
    array.into_pyarray(py).into_any()
}

/// A copy of an object's own array, which refuses writes: they would not change the object.
pub(crate) fn copy<'py, T: Element, D: Dimension>(py: Python<'py>, array: Array<T, D>) -> Bound<'py, PyAny> {
    let array = array.into_pyarray(py);
    drop(array.readwrite().make_nonwriteable());
    array.into_any()
}

/// A tuple of `N` numbers, one for each axis.
pub(crate) struct Axes<T, const N: usize>(pub(crate) [T; N]);

/// A number of a tuple: its name in errors, and an example.
pub(crate) trait Part: for<'a, 'py> FromPyObject<'a, 'py> {
    const WHAT: &'static str;
    const EXAMPLE: &'static str;
}

impl Part for usize {
    const WHAT: &'static str = "counts";
    const EXAMPLE: &'static str = "64";
}

impl Part for f64 {
    const WHAT: &'static str = "numbers";
    const EXAMPLE: &'static str = "1.0";
}

impl<T: Part, const N: usize> FromPyObject<'_, '_> for Axes<T, N> {
    type Error = PyErr;

    /// PyO3 adds the argument's name, as a note where Python has notes. Integers that are no sizes are wrong values.
    fn extract(value: Borrowed<'_, '_, PyAny>) -> PyResult<Self> {
        let is_sequence = value.is_instance_of::<PyTuple>() || value.is_instance_of::<PyList>();
        let found = if is_sequence { value.extract::<Vec<T>>().ok() } else { None };
        found.and_then(|found| found.try_into().ok()).map(Self).ok_or_else(|| {
            let got = value.repr().map_or_else(|_| "an object".into(), |text| text.to_string());
            let got: String = got.chars().take(60).collect();
            let example = [T::EXAMPLE; N].join(", ");
            let expected = format!("a tuple of {N} {}", T::WHAT);
            let message = format!("got {got}, expected {expected}; give ({example}), for example");
            let mut parts = value.try_iter().into_iter().flatten();
            let are_integers = is_sequence && parts.all(|part| part.is_ok_and(|part| part.is_instance_of::<PyInt>()));
            let is_value = are_integers && value.len().is_ok_and(|len| len == N);
            if is_value { PyValueError::new_err(message) } else { PyTypeError::new_err(message) }
        })
    }
}

/// Rows of `N` numbers `[M, N]`; float32 is widened, which is exact.
fn rows<const N: usize>(value: &Bound<'_, PyAny>, what: &str) -> PyResult<Vec<[f64; N]>> {
    let axes = format!("[M, {N}]");
    let array = read_float::<ndarray::Ix2>(value, what, &axes)?;
    dispatch!(array, |array| {
        if array.shape()[1] != N {
            let remedy = "give one row per primitive";
            return Err(wrong_value(what, format!("shape {:?}", array.shape()), &axes, remedy));
        }
        let (rows, _) = slice(&array).as_chunks::<N>();
        Ok(rows.iter().map(|row| row.map(Real::to_f64)).collect())
    })
}

/// One number per primitive `[M]`; float32 is widened, which is exact.
fn column(value: &Bound<'_, PyAny>, what: &str) -> PyResult<Vec<f64>> {
    let array = read_float::<ndarray::Ix1>(value, what, "[M]")?;
    dispatch!(array, |array| Ok(slice(&array).iter().map(|number| number.to_f64()).collect()))
}

/// Five arrays of one row per primitive, in the order of [`Group::ALL`].
pub(crate) fn parameters(arrays: &[Bound<'_, PyAny>; 5]) -> PyResult<Parameters> {
    let [mean, scale, quaternion, density, nu] = arrays;
    let parameters = Parameters {
        mean: rows(mean, "mean")?,
        scale: rows(scale, "scale")?,
        quaternion: rows(quaternion, "quaternion")?,
        density: column(density, "density")?,
        nu: column(nu, "nu")?,
    };
    for group in Group::ALL {
        let got = parameters.group(group).len() / group.width();
        if got != parameters.len() {
            let expected = format!("{}, as many as densities", parameters.len());
            return Err(wrong_value(group.key(), format!("{got} rows"), &expected, "give one row per primitive"));
        }
    }
    Ok(parameters)
}

/// A `trgs.Parameters` with the five arrays.
pub(crate) fn give_parameters(py: Python<'_>, parameters: Parameters) -> PyResult<Bound<'_, PyAny>> {
    let Parameters { mean, scale, quaternion, density, nu } = parameters;
    let arrays = (
        give(py, Array2::from(mean)),
        give(py, Array2::from(scale)),
        give(py, Array2::from(quaternion)),
        density.into_pyarray(py),
        nu.into_pyarray(py),
    );
    named(py, "Parameters")?.call1(arrays)
}

/// A class or function of `trgs._types`.
pub(crate) fn named<'py>(py: Python<'py>, name: &str) -> PyResult<Bound<'py, PyAny>> {
    py.import("trgs._types")?.getattr(name)
}
