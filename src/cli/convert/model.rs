//! Conversion of models: archives, PLY, R²-Gaussian's point clouds.

use super::{Convert, extension};
use crate::cli::{Output, interrupt};
use serde::Serialize;
use std::path::Path;
use trgs::confidence::{Coverage, Settings, Spread};
use trgs::output::check_file;
use trgs::primitives::{KernelKind, Primitives};
use trgs::scan::{Dataset, Frame, model};
use trgs::{Error, Result};

/// The result of the command.
#[derive(Serialize)]
struct Converted<'a> {
    #[serde(serialize_with = "trgs::words::serialize_name")]
    out: &'a Path,
    kind: &'static str,
    kernel: &'static str,
    primitives: usize,
    #[serde(skip_serializing_if = "Option::is_none")]
    confidence: Option<Spread>,
}

pub(super) fn convert(command: &Convert) -> Result<Output> {
    let to_ply = extension(&command.out) == "ply";
    let refuse = |flag: &str, expected: &str| {
        Err(Error::invalid(
            flag,
            format!("OUT {}", command.out.display()),
            expected,
            "omit the flag, or change the extension of OUT",
        ))
    };
    if command.r2 && to_ply {
        return refuse("--r2", "a .npz");
    }
    if command.scanner.is_some() && !to_ply {
        return refuse("--scanner", "a .ply: only it holds confidences, or the command trgs confidence");
    }
    let (primitives, known) = read(&command.source)?;
    let (confidence, frame) = match &command.scanner {
        Some(scan) => {
            let (confidence, frame) = confidence(&primitives, scan)?;
            (Some(confidence), frame)
        }
        None => (known.filter(|_| to_ply), Frame::default()),
    };
    check_file(&command.out)?;
    interrupt::shielded(|| match (to_ply, command.r2) {
        _ if command.splats => {
            tracing::warn!(
                "splats are an approximation: Gaussians of the same half width, and viewers lay one over the other instead of \
                 adding line integrals"
            );
            let written = model::splat::write(&command.out, &primitives, confidence.as_deref())?;
            if written < primitives.len() {
                tracing::warn!("{} without density are left out", primitives.len() - written);
            }
            Ok(())
        }
        (true, _) => model::ply::write(&command.out, &primitives, confidence.as_deref(), &frame),
        (_, true) => model::r2::write(&command.out, &primitives),
        _ => model::write(&command.out, &primitives.parameters),
    })?;
    let is_student = primitives.kernel == KernelKind::StudentT;
    if command.r2 && is_student {
        tracing::warn!("R²-Gaussian ignores nu and reads the primitives as Gaussians: it reconstructs another density");
    }
    Ok(Output::list(&Converted {
        out: &command.out,
        kind: "model",
        kernel: if is_student { "student-t" } else { "gaussian" },
        primitives: primitives.len(),
        confidence: confidence.and_then(|c| Spread::of(&c)),
    }))
}

/// The primitives of a file, and their confidence where the file has it.
pub(super) fn read(path: &Path) -> Result<(Primitives, Option<Vec<f64>>)> {
    match extension(path) {
        "ply" => model::ply::read(path),
        _ => Ok((model::read(path)?, None)),
    }
}

/// The confidence of each primitive over a scan's training views, with default settings; and the frame of the scan.
fn confidence(primitives: &Primitives, scan: &Path) -> Result<(Vec<f64>, Frame)> {
    let Dataset { scanner, train, frame, .. } = Dataset::read(scan)?;
    Ok((Coverage::new(Settings::default()).confidence(primitives, &scanner, &train), frame))
}
