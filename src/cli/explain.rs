//! `--explain`: the contributions of primitives to one pixel or voxel.

use super::Output;
use serde::Serialize;
use serde_json::Value;
use std::path::Path;
use trgs::config::Precision;
use trgs::numeric::Real;
use trgs::primitives::Primitives;
use trgs::projector::{Contribution, Projection, rank};
use trgs::{Error, Result};

/// Number of lines in the table; `--json` lists all contributions.
const LINES: usize = 20;

/// The files that a command wrote.
#[derive(Serialize)]
pub(super) struct Written<'a> {
    #[serde(serialize_with = "trgs::words::serialize_name")]
    pub(super) out: &'a Path,
    pub(super) shape: Vec<usize>,
    pub(super) precision: Precision,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) projection: Option<Projection>,
    pub(super) cutoff: f64,
    /// Bound on the error of a pixel due to the cutoff.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) truncation_bound: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) grad_out: Option<String>,
}

/// The contributions, and the files written by the same command.
#[derive(Serialize)]
struct Explanation<'a> {
    /// The pixel or the voxel.
    #[serde(flatten)]
    place: Value,
    /// Sum of all contributions.
    value: f64,
    /// Number of primitives in the model.
    primitives: usize,
    /// Primitives with a nonzero contribution, the largest first.
    contributions: Vec<Line>,
    #[serde(flatten)]
    written: Option<Written<'a>>,
}

#[derive(Serialize)]
struct Line {
    primitive: usize,
    contribution: f64,
    /// Fraction of the value; null if the value is 0.
    share: f64,
    sum: f64,
    centre: [f64; 3],
    /// Null for a Gaussian.
    nu: f64,
}

/// Rejects an index outside `shape`, whose axes are called `names`.
pub(super) fn check_index(index: [usize; 3], shape: [usize; 3], names: [&str; 3]) -> Result<()> {
    for axis in 0..3 {
        if index[axis] >= shape[axis] {
            return Err(Error::invalid(
                "--explain",
                format!("{} {}", names[axis], index[axis]),
                format!("0 to {}", shape[axis] - 1),
                "count from 0, in the order of the output's axes",
            ));
        }
    }
    Ok(())
}

/// The table of contributions, the largest first.
pub(super) fn answer<R: Real>(
    place: Value,
    primitives: &Primitives,
    contributions: &[R],
    written: Option<Written<'_>>,
) -> Output {
    let parameters = &primitives.parameters;
    let line = |c: Contribution| Line {
        primitive: c.primitive,
        contribution: c.value,
        share: c.share,
        sum: c.sum,
        centre: parameters.mean[c.primitive],
        nu: parameters.nu[c.primitive],
    };
    let lines: Vec<Line> = rank(contributions).into_iter().map(line).collect();
    let value = lines.last().map_or(0.0, |line| line.sum);
    let mut rows: Vec<_> = lines.iter().take(LINES).map(Line::row).collect();
    if lines.len() != rows.len() || lines.is_empty() {
        let [more, sum] = [format!("{} more", lines.len() - rows.len()), format!("{value:.6e}")];
        rows.push([more, String::new(), String::new(), sum, String::new(), String::new()]);
    }
    let header = ["primitive", "contribution", "share", "sum", "centre", "nu"];
    let result = Explanation { place, value, primitives: primitives.len(), contributions: lines, written };
    Output::table(&result, header, rows)
}

impl Line {
    fn row(&self) -> [String; 6] {
        let [x, y, z] = self.centre;
        [
            self.primitive.to_string(),
            format!("{:.6e}", self.contribution),
            format!("{:.4}", self.share),
            format!("{:.6e}", self.sum),
            format!("{x:.4} {y:.4} {z:.4}"),
            format!("{:.4}", self.nu),
        ]
    }
}
