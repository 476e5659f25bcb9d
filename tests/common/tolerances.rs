//! **Tolerances** of all tests: one row each in `tests/tolerances.toml`.
//!
//! A test states an error and no number: `within!(error)` fails when the error exceeds the limit of the row that is
//! named after the file and the function of the call. A function with several tolerances names their parts:
//! `within!("f32", error)` reads the row `function/f32`. `beyond!` is the opposite: it fails when a value falls short of
//! the row's `least`. Both take a message, as `assert!` does. NaN fails.
//!
//! ```text
//! ["src/core/loss/tv.rs"]
//! a_test = { limit = 1e-9, measured = 2.1e-10, why = "where the error comes from" }
//! ```
//!
//! `measured` is the worst value that the tests reach: the largest error, or the smallest value of `beyond!`. Every
//! machine and number of threads measures the same, except where `tests/cli/formats.rs` and
//! `tests/contracts/real_data.rs` compare with other programs. A limit above [`WIDEST`] times the measured value needs a
//! second reason, `wide`. `tests/contracts/tolerance_rows.rs` checks the table, and searches the tests for tolerances that
//! are not rows. `.ci/tolerances` measures: with `TRGS_MEASURED=FILE` each check that is the worst so far appends a line to
//! FILE.

#![allow(dead_code)]

use std::collections::BTreeMap;
use std::fmt::Arguments;
use std::io::Write;
use std::panic::Location;
use std::path::Path;
use std::sync::{LazyLock, Mutex, PoisonError};

/// A limit may be this many times the measured value without a second reason.
pub(crate) const WIDEST: f64 = 30.0;

/// One tolerance.
#[derive(serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Row {
    /// Largest value allowed.
    pub(crate) limit: Option<f64>,
    /// Smallest value allowed.
    pub(crate) least: Option<f64>,
    /// Worst value that the tests reach.
    pub(crate) measured: f64,
    /// Where the error comes from.
    pub(crate) why: String,
    /// Why the limit is far from the measured value.
    pub(crate) wide: Option<String>,
}

/// Rows by file, and by function or `function/part`.
pub(crate) static ROWS: LazyLock<BTreeMap<String, BTreeMap<String, Row>>> =
    LazyLock::new(|| toml::from_str(include_str!("../tolerances.toml")).expect("tests/tolerances.toml"));

/// The name of the function around the macro's call.
macro_rules! function {
    () => {{
        fn inside() {}
        std::any::type_name_of_val(&inside)
    }};
}
pub(crate) use function;

/// Fails when an error exceeds the limit of its row: `within!([part,] error [, message..])`.
macro_rules! within {
    ($part:literal, $error:expr $(,)?) => { within!($part, $error, "") };
    ($part:literal, $error:expr, $($message:tt)+) => {
        crate::tolerances::within(crate::tolerances::function!(), $part, $error, format_args!($($message)+))
    };
    ($error:expr $(,)?) => { within!("", $error, "") };
    ($error:expr, $($message:tt)+) => { within!("", $error, $($message)+) };
}

/// Fails when a value falls short of the least value of its row: `beyond!([part,] value [, message..])`.
macro_rules! beyond {
    ($part:literal, $value:expr $(,)?) => { beyond!($part, $value, "") };
    ($part:literal, $value:expr, $($message:tt)+) => {
        crate::tolerances::beyond(crate::tolerances::function!(), $part, $value, format_args!($($message)+))
    };
    ($value:expr $(,)?) => { beyond!("", $value, "") };
    ($value:expr, $($message:tt)+) => { beyond!("", $value, $($message)+) };
}

/// See `within!`.
#[track_caller]
pub(crate) fn within(function: &str, part: &str, error: impl Into<f64>, message: Arguments<'_>) {
    let (error, place) = (error.into(), place(function, part));
    let limit = row(&place).limit.unwrap_or_else(|| panic!("{place:?}: the row has no limit"));
    assert!(error <= limit, "{}: {error:e}, limit {limit:e}. {message}", place.1);
    record(&place, error, |error, worst| error > worst);
}

/// See `beyond!`.
#[track_caller]
pub(crate) fn beyond(function: &str, part: &str, value: impl Into<f64>, message: Arguments<'_>) {
    let (value, place) = (value.into(), place(function, part));
    let least = row(&place).least.unwrap_or_else(|| panic!("{place:?}: the row has no least value"));
    assert!(value >= least, "{}: {value:e}, least {least:e}. {message}", place.1);
    record(&place, value, |value, worst| value < worst);
}

/// File and name of the row.
#[track_caller]
fn place(function: &str, part: &str) -> (String, String) {
    let name = function.rsplit("::").find(|name| !matches!(*name, "inside" | "{{closure}}")).unwrap();
    let name = if part.is_empty() { name.to_owned() } else { format!("{name}/{part}") };
    // The compiler names files from where it was started.
    let file = Location::caller().file().replace('\\', "/");
    let known = ROWS.keys().find(|known| Path::new(&file).ends_with(known));
    (known.cloned().unwrap_or(file), name)
}

fn row((file, name): &(String, String)) -> &'static Row {
    let found = ROWS.get(file).and_then(|rows| rows.get(name));
    found.unwrap_or_else(|| panic!("tests/tolerances.toml has no row \"{name}\" in [\"{file}\"]"))
}

/// Appends a value to the log, if there is one and no value of this process was worse.
fn record(place: &(String, String), value: f64, is_worse: fn(f64, f64) -> bool) {
    static WORST: Mutex<BTreeMap<(String, String), f64>> = Mutex::new(BTreeMap::new());
    let Some(path) = std::env::var_os("TRGS_MEASURED") else { return };
    let mut all = WORST.lock().unwrap_or_else(PoisonError::into_inner);
    if all.get(place).is_none_or(|&worst| is_worse(value, worst)) {
        all.insert(place.clone(), value);
        let mut log = std::fs::OpenOptions::new().append(true).create(true).open(path).unwrap();
        log.write_all(format!("{}\t{}\t{value:e}\n", place.0, place.1).as_bytes()).unwrap();
    }
}

/// Difference of two numbers in units of the larger, 0 for equal numbers.
pub(crate) fn relative(a: f64, b: f64) -> f64 {
    if a == b { 0.0 } else { (a - b).abs() / a.abs().max(b.abs()) }
}

/// Largest absolute value, NaN if there is any, 0 of nothing.
pub(crate) fn largest<T: Into<f64>>(values: impl IntoIterator<Item = T>) -> f64 {
    values.into_iter().map(|value| value.into().abs()).fold(0.0, |m: f64, x| if m.is_nan() || m >= x { m } else { x })
}
