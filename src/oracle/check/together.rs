//! Mistakes that only all cases together tell.

use super::{CaseResult, PartResult, Status};
use crate::format::Format;
use crate::limits::Tolerances;
use crate::manifest::{Case, Vectors};
use crate::question::Question;
use std::collections::BTreeSet;
use trgs_core::error::Result;

/// Fewest failed cases, and fewest stages among them, that are evidence of a mode of the arithmetic.
const CASES: usize = 5;
const STAGES: usize = 3;

/// Names what has no name yet where all failures have the same cause.
pub(super) fn name(
    results: &mut [CaseResult],
    vectors: &Vectors,
    tolerances: &Tolerances,
    format: Format,
) -> Result<()> {
    if products(results, vectors, tolerances, format) {
        let what =
            "products of factors with 11 bits, as in TF32: the other stages are right, and these within its limits";
        of_failed(results, |_| true).for_each(|part| {
            part.looks_like.get_or_insert_with(|| what.into());
        });
    }
    if infinite(results, vectors)? {
        let what = "∞/∞ or 0·∞: all that is NaN has a primitive with ν = ∞, as with fast math";
        of_failed(results, is_nan).for_each(|part| {
            part.looks_like.get_or_insert_with(|| what.into());
        });
    }
    Ok(())
}

fn of_failed(results: &mut [CaseResult], of: fn(&PartResult) -> bool) -> impl Iterator<Item = &mut PartResult> {
    let parts = results.iter_mut().flat_map(|result| &mut result.parts);
    parts.filter(move |part| part.status == Status::Failed && of(part))
}

fn is_nan(part: &PartResult) -> bool {
    part.message.as_deref() == Some("NaN")
}

fn case_of<'a>(vectors: &'a Vectors, result: &CaseResult) -> &'a Case {
    vectors.manifest.cases.iter().find(|case| case.id == result.id).expect("a case of these vectors")
}

/// Whether all failures are in stages with products, and within the limits of products in TF32.
fn products(results: &[CaseResult], vectors: &Vectors, tolerances: &Tolerances, format: Format) -> bool {
    let failed: Vec<&CaseResult> = results.iter().filter(|result| result.status == Status::Failed).collect();
    let stages: BTreeSet<&str> = failed.iter().map(|result| &*result.stage).collect();
    let has_products = |stage: &str| tolerances.products.iter().any(|known| known == stage);
    let others = results.iter().any(|result| result.status == Status::Passed && !has_products(&result.stage));
    if format != Format::F32 || failed.len() < CASES || stages.len() < STAGES || !others {
        return false;
    }
    let within = |result: &CaseResult, part: &PartResult| {
        let name = part.output.rsplit('.').next().unwrap_or_default();
        let format = tolerances.judged_as(&result.stage, Format::Tf32);
        let limits = tolerances.rule(case_of(vectors, result), name, format).map(|rule| rule.limits[&format]);
        let (Some(limits), Some(difference)) = (limits, &part.difference) else { return false };
        let below = |value: f64, limit: Option<f64>| limit.is_none_or(|limit| value <= limit);
        below(difference.peak, limits.peak) && below(difference.l2, limits.l2)
    };
    failed.iter().all(|result| {
        let parts = result.parts.iter().filter(|part| part.status == Status::Failed);
        has_products(&result.stage) && parts.into_iter().all(|part| within(result, part))
    })
}

/// Whether there is NaN, in at least two cases, all of which have a primitive with infinite ν.
fn infinite(results: &[CaseResult], vectors: &Vectors) -> Result<bool> {
    let of_nan: Vec<&CaseResult> = results.iter().filter(|result| result.parts.iter().any(is_nan)).collect();
    for result in &of_nan {
        if !Question::new(vectors, case_of(vectors, result))?.has_infinite_nu() {
            return Ok(false);
        }
    }
    Ok(of_nan.len() >= 2)
}
