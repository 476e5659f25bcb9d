//! The conformance vectors, and the judge of answers.

use crate::arrays::{give, word};
use crate::work::{raise, try_run};
use ndarray::IxDyn;
use numpy::{PyReadonlyArray, PyReadonlyArrayDyn};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::OnceLock;
use std::time::Duration;
use trgs::oracle::manifest::{Arrays, Case, FileRef};
use trgs::oracle::{Format, Level, Options, Outputs, Tolerances, Vectors, answers, check, fresh, hunt, waivers};

const LEVELS: [(&str, Level); 4] =
    [("core", Level::Core), ("optional", Level::Optional), ("stress", Level::Stress), ("large", Level::Large)];
const FORMATS: [(&str, Format); 6] = [
    ("f64", Format::F64),
    ("f32", Format::F32),
    ("f16", Format::F16),
    ("bf16", Format::Bf16),
    ("tf32", Format::Tf32),
    ("f16+f32", Format::F16F32),
];

const ASKS: [(&str, fresh::Ask); 3] =
    [("values", fresh::Ask::Values), ("relations", fresh::Ask::Relations), ("refusals", fresh::Ask::Refusals)];

static VECTORS: OnceLock<Vectors> = OnceLock::new();

fn vectors() -> PyResult<&'static Vectors> {
    if let Some(vectors) = VECTORS.get() {
        return Ok(vectors);
    }
    let vectors = Vectors::embedded().map_err(raise)?;
    Ok(VECTORS.get_or_init(|| vectors))
}

/// Takes the vectors from a folder. Those in use cannot be replaced by others.
#[pyfunction]
pub(crate) fn conformance_open(folder: PathBuf) -> PyResult<()> {
    let vectors = Vectors::open(&folder).map_err(raise)?;
    let digest = vectors.digest.clone();
    if VECTORS.get_or_init(|| vectors).digest == digest {
        return Ok(());
    }
    let got = format!("{}, which has others than those in use", folder.display());
    Err(crate::arrays::wrong_value("folder", got, "the vectors in use", "open it first, in a new process"))
}

fn case<'a>(vectors: &'a Vectors, id: &str) -> PyResult<&'a Case> {
    vectors.manifest.cases.iter().find(|case| case.id == id).ok_or_else(|| {
        crate::arrays::wrong_value("case", format!("{id:?}"), "the id of a case", "take one of trgs.conformance.find()")
    })
}

/// The accepted failures of a file, as JSON: for each case the reason, and whether its day is not over.
#[pyfunction]
pub(crate) fn conformance_waivers(file: PathBuf) -> PyResult<String> {
    let (all, today) = (waivers::read(file, &vectors()?.manifest.cases).map_err(raise)?, waivers::today());
    let reason = |waiver: &waivers::Waiver| format!("{} (until {})", waiver.reason, waiver.expires);
    let found: BTreeMap<_, _> =
        all.iter().map(|waiver| (&waiver.case, (reason(waiver), waiver.expires >= today))).collect();
    Ok(serde_json::to_string(&found).expect("texts are JSON"))
}

/// The cases of some stages up to a level, as JSON: the entries of the manifest.
#[pyfunction]
pub(crate) fn conformance_cases(stages: Vec<String>, level: &str) -> PyResult<String> {
    let selected = check::select(vectors()?, word("level", level, &LEVELS)?, &stages).map_err(raise)?;
    Ok(serde_json::to_string(&selected).expect("a manifest is JSON"))
}

fn of_file<'py>(py: Python<'py>, file: &FileRef) -> PyResult<Bound<'py, PyAny>> {
    let vectors = vectors()?;
    if file.file.ends_with(".json") {
        let bytes = vectors.bytes(file).map_err(raise)?;
        return Ok(String::from_utf8_lossy(&bytes).into_owned().into_pyobject(py)?.into_any());
    }
    let mut arrays = vectors.arrays(file).map_err(raise)?;
    if let Some(array) = arrays.remove("") {
        return Ok(give(py, array));
    }
    let all = PyDict::new(py);
    arrays.into_iter().try_for_each(|(name, array)| all.set_item(name, give(py, array)))?;
    Ok(all.into_any())
}

/// An input of a case: an array, a dict of arrays, or the text of a JSON file.
#[pyfunction]
pub(crate) fn conformance_input<'py>(py: Python<'py>, id: &str, role: &str) -> PyResult<Bound<'py, PyAny>> {
    of_file(py, &case(vectors()?, id)?.inputs[role])
}

/// The truth of an output of a case: an array or a dict of arrays.
#[pyfunction]
pub(crate) fn conformance_truth<'py>(py: Python<'py>, id: &str, role: &str) -> PyResult<Bound<'py, PyAny>> {
    of_file(py, &case(vectors()?, id)?.outputs[role])
}

/// Judges the answers of a case, `{role: {name: array}}`; returns the result as JSON.
///
/// `folder` has generated questions, if the case is one of them.
#[pyfunction]
pub(crate) fn conformance_check<'py>(
    py: Python<'py>,
    id: &str,
    outputs: BTreeMap<String, BTreeMap<String, PyReadonlyArrayDyn<'py, f64>>>,
    precision: &str,
    folder: Option<PathBuf>,
) -> PyResult<String> {
    let format = word("precision", precision, &FORMATS)?;
    let generated = folder.map(Vectors::open).transpose().map_err(raise)?;
    let all = match &generated {
        Some(vectors) => vectors,
        None => vectors()?,
    };
    let case = case(all, id)?;
    let owned = |array: PyReadonlyArray<'py, f64, IxDyn>| array.as_array().to_owned();
    let outputs: Outputs = outputs
        .into_iter()
        .map(|(role, arrays)| {
            let arrays: Arrays = arrays.into_iter().map(|(name, array)| (name, owned(array))).collect();
            (role, arrays)
        })
        .collect();
    let mut one = all.clone();
    one.manifest.cases = vec![case.clone()];
    try_run(py, || {
        let folder = tempfile::tempdir().map_err(|source| trgs::Error::write(&std::env::temp_dir(), source))?;
        answers::write(folder.path(), case, &outputs)?;
        let options = Options {
            format,
            level: case.level,
            stages: &[],
            waivers: &[],
            today: waivers::today(),
            commit: trgs::provenance::commit(),
        };
        let one = fresh::with_truth(one, format, folder.path())?;
        let report = check::check(&one, &Tolerances::of(&one)?, folder.path(), &options)?;
        Ok(serde_json::to_string(&report.results[0]).expect("a result is JSON"))
    })
}

/// Writes manifest, protocol and inputs of cases to a folder, and the truth unless `blind`; returns the number of files.
#[pyfunction]
pub(crate) fn conformance_export(
    py: Python<'_>,
    folder: PathBuf,
    stages: Vec<String>,
    level: &str,
    blind: bool,
) -> PyResult<usize> {
    let vectors = vectors()?;
    let selected = check::select(vectors, word("level", level, &LEVELS)?, &stages).map_err(raise)?;
    try_run(py, || vectors.export(&folder, blind, &selected))
}

/// Writes generated questions to a folder.
#[pyfunction]
pub(crate) fn conformance_make(
    py: Python<'_>,
    folder: PathBuf,
    stages: Vec<String>,
    seed: u64,
    count: usize,
    level: &str,
) -> PyResult<usize> {
    let level = word("level", level, &LEVELS)?;
    try_run(py, || {
        let vectors = fresh::make(&stages, seed, count, level, fresh::Ask::Values)?;
        vectors.export(&folder, true, &vectors.manifest.cases.iter().collect::<Vec<_>>())
    })
}

/// Hunts with `backend(questions, answers)`, a function of two folders that returns why it ended or None.
#[pyfunction]
#[allow(clippy::too_many_arguments, reason = "the arguments of the Python function")]
pub(crate) fn conformance_hunt(
    py: Python<'_>,
    backend: Py<PyAny>,
    folder: PathBuf,
    stages: Vec<String>,
    seed: u64,
    cases: usize,
    seconds: Option<f64>,
    precision: &str,
    level: &str,
    ask: &str,
) -> PyResult<String> {
    let (precision, level) = (word("precision", precision, &FORMATS)?, word("level", level, &LEVELS)?);
    let ask = word("ask", ask, &ASKS)?;
    let settings = hunt::Settings { stages, seed, cases, precision, level, ask };
    let mut raised = None;
    let found = try_run(py, || {
        let mut hunt = hunt::Hunt::open(&folder, settings)?;
        let limit = seconds.and_then(|seconds| Duration::try_from_secs_f64(seconds).ok());
        hunt.run(&folder, limit, &mut |_, questions, answers| {
            let ended = Python::attach(|py| backend.call1(py, (questions, answers))?.extract::<Option<String>>(py));
            ended.map_err(|error| {
                raised = Some(error);
                trgs::Error::Interrupted { step: 0, remedy: "call the function again to go on".into() }
            })
        })?;
        Ok(serde_json::to_string(&hunt).expect("a hunt is JSON"))
    });
    raised.map_or(found, Err)
}
