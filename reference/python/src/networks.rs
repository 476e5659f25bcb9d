//! Training steps of the methods that are networks.

use crate::arrays::{give, named, word};
use crate::scan::{Scan, configure};
use crate::work::{raise, run};
use ndarray::ArrayD;
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyList};
use trgs::config::{Config, Method};

fn dictionary<'py>(py: Python<'py>, arrays: Vec<(String, ArrayD<f64>)>) -> PyResult<Bound<'py, PyDict>> {
    let found = PyDict::new(py);
    for (name, array) in arrays {
        found.set_item(name, give(py, array))?;
    }
    Ok(found)
}

/// The first steps of the training of a network, with all that they rest on.
///
/// Parameters
/// ----------
/// scan : Scan
/// method : {"naf", "sax-nerf", "intratomo"}
/// steps : int
///     How many.
/// **settings
///     As those of `trgs.reconstruct`; `precision="f64"` for the most exact.
///
/// Returns
/// -------
/// NetworkSteps
///
/// Raises
/// ------
/// TypeError
///     For a setting of another type.
/// ValueError
///     For an unknown method or setting, or one out of its range.
#[pyfunction]
#[pyo3(name = "steps", signature = (scan, method = "naf", *, steps = 10, **settings))]
pub(crate) fn network_steps<'py>(
    py: Python<'py>,
    scan: &Scan,
    method: &str,
    steps: usize,
    settings: Option<&Bound<'py, PyDict>>,
) -> PyResult<Bound<'py, PyAny>> {
    const METHODS: [(&str, Method); 3] =
        [("naf", Method::Naf), ("sax-nerf", Method::SaxNerf), ("intratomo", Method::Intratomo)];
    let mut config = Config::of(word("method", method, &METHODS)?);
    if let Some(settings) = settings {
        configure(&mut config, "", settings)?;
    }
    let found = run(py, || trgs::reconstruction::network_steps(&scan.0, &config, steps))?.map_err(raise)?;
    let batches = PyList::empty(py);
    for batch in found.batches {
        let arrays = (give(py, batch.points), give(py, batch.lengths), give(py, batch.values));
        batches.append(named(py, "Batch")?.call1(arrays)?)?;
    }
    let losses = give(py, ndarray::Array1::from(found.errors));
    let [begin, end] = [dictionary(py, found.begin)?, dictionary(py, found.end)?];
    named(py, "NetworkSteps")?.call1((begin, batches, losses, end, found.unit, found.config.to_toml()))
}
