//! `trgs compare`: the difference of two arrays, and the mistake that explains it.

use super::Output;
use super::arguments::{choice, finite};
use clap::Args;
use std::path::PathBuf;
use trgs::Result;
use trgs::oracle::Format;
use trgs::oracle::compare::{Comparison, compare};
use trgs::oracle::report::ulps;

/// Compare two files of arrays: norms, worst element, and the mistake that explains the difference
#[derive(Args)]
#[command(after_help = "Examples:
  trgs compare expected.npy got.npy --axes view,v,u
  trgs compare grad-expected.npz grad-got.npz --precision f32 --tolerance 1e-5")]
pub(super) struct Compare {
    /// File with the expected arrays
    #[arg(value_name = "A.npy")]
    expected: PathBuf,
    /// File with the arrays to check
    #[arg(value_name = "B.npy")]
    got: PathBuf,
    /// Names of the axes, outermost first
    #[arg(long, value_name = "NAME,..", value_delimiter = ',')]
    axes: Vec<String>,
    /// Floating-point format that defines an ulp
    #[arg(long, default_value = "f64", value_parser = choice(&Format::ALL))]
    precision: Format,
    /// Exit with code 1 if an error exceeds this fraction of the largest expected value
    #[arg(long, value_name = "EPS", value_parser = finite)]
    tolerance: Option<f64>,
}

impl Compare {
    pub(super) fn run(&self) -> Result<Output> {
        let axes: Vec<&str> = self.axes.iter().map(String::as_str).collect();
        let arrays = compare(&self.expected, &self.got, &axes, self.precision)?;
        let approves = self.tolerance.is_none_or(|tolerance| arrays.iter().all(|array| array.within(tolerance)));
        let lines: Vec<String> = arrays.iter().flat_map(describe).collect();
        Ok(Output::verdict(&arrays, lines.join("\n"), approves))
    }
}

/// The comparison of an array in a few lines.
fn describe(array: &Comparison) -> Vec<String> {
    let name = if array.array.is_empty() { String::new() } else { format!("{} ", array.array) };
    let mut lines = vec![format!("{name}{:?}", array.shape)];
    lines.extend(array.message.as_ref().map(|message| format!("  {message}")));
    if let Some(d) = &array.difference {
        lines.push(format!(
            "  largest error / peak {:.3e}   L2 {:.3e}   1 - cosine {:.3e}   bias {:+.3e}   wrong zeros {:.1} %   significant elements {} ulp",
            d.peak, d.l2, d.cosine, d.bias, 100.0 * d.zeros, ulps(d.ulp)
        ));
        if let Some(worst) = &d.worst {
            lines.push(format!("  worst at {:?}: expected {:e}, got {:e}", worst.index, worst.expected, worst.got));
        }
    }
    lines.extend(array.place.as_ref().map(|place| format!("  differs at {place}")));
    lines.extend(array.looks_like.as_ref().map(|name| format!("  looks like {name}")));
    lines
}
