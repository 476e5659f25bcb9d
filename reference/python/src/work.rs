//! Computations without the GIL, errors as exceptions, and observers.

use crate::arrays::{named, wrong_value};
use pyo3::exceptions::PyValueError;
use pyo3::exceptions::{
    PyArithmeticError, PyFileNotFoundError, PyKeyboardInterrupt, PyMemoryError, PyOSError, PyRuntimeError,
};
use pyo3::prelude::*;
use serde_json::Value;
use std::hint::black_box;
use std::io::ErrorKind;
use std::ops::ControlFlow;
use std::sync::OnceLock;
use std::time::{Duration, Instant};
use trgs::{Error, limit};

/// Time between two looks for Ctrl-C.
const LOOK: Duration = Duration::from_millis(100);

/// The process whose threads compute.
static PROCESS: OnceLock<u32> = OnceLock::new();

/// Refuses to compute where subnormal numbers count as zeros: the bits would be others.
///
/// Worker threads take the mode of the thread that starts them, so this comes before each call that may start them.
fn check_mode() -> PyResult<()> {
    let smallest = black_box(f32::from_bits(1));
    if smallest * black_box(1.0) != 0.0 {
        return Ok(());
    }
    Err(PyRuntimeError::new_err(
        "floating-point mode: got one that flushes subnormal numbers to zero, as libraries compiled with -ffast-math set it, \
         expected that of IEEE 754; call torch.set_flush_denormal(False), or load that library in another process",
    ))
}

/// Runs `work` without the GIL.
///
/// A forked process has none of its parent's threads and would wait for them forever: that is an error.
pub(crate) fn run<T: Send>(py: Python<'_>, work: impl FnOnce() -> T + Send) -> PyResult<T> {
    let here = std::process::id();
    if *PROCESS.get_or_init(|| here) != here {
        return Err(PyRuntimeError::new_err(
            "process: got a fork of a process that has computed with trgs, expected a process of its own; \
             give multiprocessing.get_context(\"spawn\")",
        ));
    }
    check_mode()?;
    Ok(py.detach(work))
}

/// [`run`] of a function of the library that can fail.
pub(crate) fn try_run<T: Send>(py: Python<'_>, work: impl FnOnce() -> trgs::Result<T> + Send) -> PyResult<T> {
    run(py, work)?.map_err(raise)
}

/// The exception of an error.
pub(crate) fn raise(error: Error) -> PyErr {
    let message = error.to_string();
    match error {
        Error::Read { source, .. } if source.kind() == ErrorKind::NotFound => PyFileNotFoundError::new_err(message),
        Error::Read { .. } | Error::Write { .. } => PyOSError::new_err(message),
        Error::Format { .. } | Error::Invalid { .. } => PyValueError::new_err(message),
        Error::Memory { .. } => PyMemoryError::new_err(message),
        Error::NonFinite { .. } => PyArithmeticError::new_err(message),
        Error::Interrupted { .. } => PyKeyboardInterrupt::new_err(message),
        _ => PyRuntimeError::new_err(message),
    }
}

/// Rejects an array of a shape that does not fit into memory, before it is allocated.
pub(crate) fn fits(what: &str, shape: &[usize], bytes: usize) -> PyResult<()> {
    limit::allow_array(what, shape, bytes).map_err(raise)
}

/// Sets the largest memory that a call may ask for.
///
/// A call that needs more, by the sizes in a file or by its arguments, raises `MemoryError` before it allocates.
///
/// Parameters
/// ----------
/// size : int or None
///     Bytes; None: three quarters of the machine's memory, as at the start.
#[pyfunction]
#[pyo3(signature = (size = None))]
pub(crate) fn set_max_memory(size: Option<u64>) {
    limit::set(size);
}

/// Sets the number of worker threads of this process.
///
/// Results do not depend on it.
///
/// Parameters
/// ----------
/// n : int
///     Number of threads; 0: one for each core.
///
/// Raises
/// ------
/// RuntimeError
///     When threads have been started already, by an earlier call or a computation.
/// ValueError
///     For more than 1024 threads.
#[pyfunction]
pub(crate) fn set_threads(n: usize) -> PyResult<()> {
    check_mode()?;
    const MOST: usize = 1024;
    if n > MOST {
        return Err(wrong_value("threads", n, "at most 1024", "give 0 for one per core"));
    }
    rayon::ThreadPoolBuilder::new().num_threads(n).build_global().map_err(|error| {
        PyRuntimeError::new_err(format!(
            "threads: got {n} ({error}), expected a call before the first computation; call trgs.set_threads right after \
             the import, or set the environment variable RAYON_NUM_THREADS={n}"
        ))
    })
}

/// The number of worker threads.
///
/// Returns
/// -------
/// int
#[pyfunction]
pub(crate) fn threads() -> PyResult<usize> {
    check_mode()?;
    Ok(trgs::numeric::threads::count())
}

/// Version, target and instruction sets, beyond the baseline, that the extension module was compiled for.
///
/// Returns
/// -------
/// list of tuple of str
///     Pairs of a key, `version`, `target` or `features`, and its value.
#[pyfunction]
pub(crate) fn build() -> Vec<(String, String)> {
    // Counting the threads would start them.
    let provenance = trgs::provenance::Provenance::new(0, []);
    vec![
        ("version".into(), provenance.version),
        ("target".into(), provenance.target),
        ("features".into(), provenance.target_features.join(" ")),
    ]
}

/// Runs the program `trgs`, once in a process. A signal may end the process.
///
/// Parameters
/// ----------
/// arguments : list of str
///     The name of the program and its arguments.
///
/// Returns
/// -------
/// int
///     The exit code.
#[pyfunction]
pub(crate) fn command_line(py: Python<'_>, arguments: Vec<std::ffi::OsString>) -> u8 {
    py.detach(|| trgs::cli::main(arguments))
}

/// The highest level of x86-64 that this CPU has all instructions of: `v4`, `v3`, or `baseline`, also on other architectures.
#[pyfunction]
pub(crate) fn cpu_level() -> &'static str {
    #[cfg(target_arch = "x86_64")]
    {
        use std::is_x86_feature_detected as has;
        let v3 = has!("avx2")
            && has!("fma")
            && has!("bmi1")
            && has!("bmi2")
            && has!("f16c")
            && has!("lzcnt")
            && has!("movbe")
            && has!("xsave");
        let v4 = has!("avx512f") && has!("avx512bw") && has!("avx512cd") && has!("avx512dq") && has!("avx512vl");
        match (v3, v4) {
            (true, true) => "v4",
            (true, false) => "v3",
            _ => "baseline",
        }
    }
    #[cfg(not(target_arch = "x86_64"))]
    "baseline"
}

/// Whether this module was compiled for a CPU with fused multiply-add.
#[pyfunction]
pub(crate) fn is_fast() -> bool {
    cfg!(any(all(target_feature = "avx2", target_feature = "fma"), target_arch = "aarch64"))
}

/// JSON as Python objects.
pub(crate) fn python<'py>(py: Python<'py>, value: &Value) -> PyResult<Bound<'py, PyAny>> {
    py.import("json")?.call_method1("loads", (value.to_string(),))
}

/// What is reported to the callbacks of a run.
pub(crate) struct Event {
    pub(crate) stage: &'static str,
    pub(crate) iteration: usize,
    pub(crate) iterations: usize,
    pub(crate) values: Value,
}

/// Reports events, and looks for Ctrl-C.
pub(crate) struct Watch {
    callbacks: Vec<Py<PyAny>>,
    looked: Instant,
    /// What a callback or a signal raised.
    raised: Option<PyErr>,
}

impl Watch {
    pub(crate) fn new(callbacks: impl IntoIterator<Item = Py<PyAny>>) -> Self {
        Self { callbacks: callbacks.into_iter().collect(), looked: Instant::now(), raised: None }
    }

    /// Breaks when a callback raises or the user presses Ctrl-C.
    pub(crate) fn see(&mut self, event: Option<Event>) -> ControlFlow<()> {
        let told = event.filter(|_| !self.callbacks.is_empty());
        let looks = self.looked.elapsed() >= LOOK;
        if told.is_none() && !looks {
            return ControlFlow::Continue(());
        }
        self.looked = Instant::now();
        match Python::attach(|py| self.tell(py, told)) {
            Ok(()) => ControlFlow::Continue(()),
            Err(error) => {
                self.raised = Some(error);
                ControlFlow::Break(())
            }
        }
    }

    fn tell(&self, py: Python<'_>, event: Option<Event>) -> PyResult<()> {
        py.check_signals()?;
        let Some(Event { stage, iteration, iterations, values }) = event else { return Ok(()) };
        let event = named(py, "Progress")?.call1((stage, iteration, iterations, python(py, &values)?))?;
        self.callbacks.iter().try_for_each(|callback| callback.call1(py, (&event,)).map(drop))
    }

    /// The result, or what was raised.
    pub(crate) fn end<T>(self, result: trgs::Result<T>) -> PyResult<T> {
        match (result, self.raised) {
            (Err(Error::Interrupted { .. }), Some(raised)) => Err(raised),
            (result, _) => result.map_err(raise),
        }
    }
}
