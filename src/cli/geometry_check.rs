//! `trgs inspect --check-geometry`: detects the conventions of a scan.

use super::flags::with_flags;
use super::messages::{ProgressBar, warnings};
use super::{Global, Output};
use std::path::Path;
use trgs::classical::check_geometry as check;
use trgs::classical::geometry_check::{Candidate, Step};
use trgs::scan::{Dataset, plausibility};
use trgs::{Result, Text};

/// The ranked conventions of a scan; the check fails if they differ from those stated.
pub(super) fn check_geometry(path: &Path, global: &Global) -> Result<Output> {
    let dataset = Dataset::read(path)?;
    warnings(path, &dataset.oddities);
    warnings(path, plausibility::remarks(&dataset));
    let mut progress = ProgressBar::new(Step::ALL, global);
    let mut found = check(&dataset, &mut |step| progress.step(step))?;
    drop(progress);
    let sentences: Vec<_> = found.verdict.iter().map(with_flags).collect();
    found.verdict = sentences.iter().map(Text::from).collect();
    let header = ["class", "convention", "held-out residual", "σ worse", "offset u", "offset v", "correlation", "turn"];
    let rows = found.candidates.iter().map(row);
    Ok(Output::judgement(&found, &sentences, header, rows, found.agrees))
}

fn row(candidate: &Candidate) -> [String; 8] {
    let Candidate { words, class, residual, standard_errors, offset, resemblance, .. } = candidate;
    let (correlation, turn) = match resemblance {
        Some(found) => (format!("{:.3}", found.correlation), format!("{}°", 90 * found.quarter_turns)),
        None => (String::new(), String::new()),
    };
    [
        class.to_string(),
        words.clone(),
        format!("{residual:.4}"),
        format!("{standard_errors:.1}"),
        format!("{:.2}", offset[0]),
        format!("{:.2}", offset[1]),
        correlation,
        turn,
    ]
}
