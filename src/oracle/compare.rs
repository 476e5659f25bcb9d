//! Compares two files of arrays with the norms and the diagnosis of a check.

use super::diagnosis::{self, arrays::transposition};
use super::difference::Difference;
use super::format::Format;
use super::manifest::{Arrays, decode};
use super::place::Errors;
use serde::Serialize;
use std::path::Path;
use trgs_core::error::{Error, Result};

/// The comparison of one array.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Comparison {
    /// Its name in the archive; empty for a file with a single array.
    pub array: String,
    /// Its shape in the first file.
    pub shape: Vec<usize>,
    /// The errors, if the shapes are equal.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub difference: Option<Difference>,
    /// The reason why the arrays cannot be compared.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub message: Option<String>,
    /// The mistake that would turn the first array into the second.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub looks_like: Option<String>,
    /// The rows, views, primitives or tiles that differ, if the rest does not.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub place: Option<String>,
}

impl Comparison {
    /// Whether the arrays were compared and the largest error is at most `tolerance` of the peak.
    pub fn within(&self, tolerance: f64) -> bool {
        self.difference.as_ref().is_some_and(|difference| difference.peak <= tolerance)
    }
}

/// Compares two `.npy` files, or two `.npz` archives array by array.
///
/// `axes` names the axes for the diagnosis, outermost first.
///
/// # Errors
/// [`Error::Read`] or [`Error::Format`] for a file that cannot be read.
pub fn compare(
    expected: impl AsRef<Path>,
    got: impl AsRef<Path>,
    axes: &[&str],
    format: Format,
) -> Result<Vec<Comparison>> {
    let (truth, answer) = (read(expected.as_ref())?, read(got.as_ref())?);
    let one = |(name, e): (&String, &ndarray::ArrayD<f64>)| {
        let mut result = Comparison { array: name.clone(), shape: e.shape().to_vec(), ..Comparison::default() };
        match answer.get(name) {
            None => result.message = Some("only in the first file".into()),
            Some(g) if g.shape() != e.shape() => {
                result.message = Some(format!("shapes {:?} and {:?}", e.shape(), g.shape()));
                result.looks_like = transposition(e, g, axes);
            }
            Some(g) => {
                let difference = Difference::new(e, g, None, format);
                if difference.peak > 0.0 {
                    result.looks_like = diagnosis::of_array(e, g, axes, format);
                    let largest = difference.worst.as_ref().map_or(0.0, |worst| (worst.got - worst.expected).abs());
                    // Rounding is below a millionth of an error that has a place.
                    let limit = |_: &[usize], e: f64| (16.0 * format.ulp(e)).max(1e-6 * largest);
                    result.place = Errors::new(e, g, limit).place(axes);
                }
                result.difference = Some(difference);
            }
        }
        result
    };
    let mut all: Vec<_> = truth.iter().map(one).collect();
    for (name, g) in answer.iter().filter(|(name, _)| !truth.contains_key(*name)) {
        let message = Some("only in the second file".into());
        let (array, shape) = (name.clone(), g.shape().to_vec());
        all.push(Comparison { array, shape, message, ..Comparison::default() });
    }
    Ok(all)
}

fn read(path: &Path) -> Result<Arrays> {
    decode(&trgs_scan::input::read(path).map_err(|source| Error::read(path, source))?, path)
}
