//! The dimensions of each stage's questions: what can be left out, reordered, and counted.

use crate::{answers, iteration, recycling, run};
use std::iter;
use std::sync::LazyLock;

/// What the elements of a dimension are.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Of {
    Primitives,
    /// The setting `angles`.
    Views,
    Rows,
    Columns,
    /// An axis of the volume.
    Voxels(usize),
    /// Elements of arrays.
    Elements,
}

/// A dimension that several arrays share.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Dimension {
    pub(crate) of: Of,
    /// Role and axis of each input that has it.
    pub(crate) inputs: Vec<(&'static str, usize)>,
    /// Role and axis of each output that has it.
    pub(crate) outputs: Vec<(&'static str, usize)>,
    /// Elements that stay together.
    pub(crate) step: usize,
    /// Whether the reversed question has the same answer, reversed along the same dimension.
    pub(crate) reversible: bool,
}

/// The stages for which questions are generated. The place of a stage among them seeds its questions.
pub static STAGES: LazyLock<Vec<&'static str>> =
    LazyLock::new(|| answers::STAGES.into_iter().filter(|stage| !dimensions(stage).is_empty()).collect());

/// The outputs of a stage.
pub(crate) fn outputs(stage: &str) -> &'static [&'static str] {
    match stage {
        "covariance" => &["covariance"],
        "kernel" => &["kernel"],
        "integral-factor" => &["factor", "slope"],
        "density" | "density-cutoff" => &["volume"],
        "projected-kernel-affine" | "projected-kernel-exact" => &["kernels"],
        "image-affine" | "image-exact" | "image-cutoff" => &["image"],
        "activation" => &["physical"],
        "loss-l1" | "loss-ssim" | "loss-tv" | "loss-image" | "loss-nu" => &["gradient", "value"],
        "nu-target" => &["nu_target"],
        "haar" => &["bands", "coefficients"],
        "wavelet-loss" => &["enhancement", "gradient", "suppression", "value"],
        "schedule" => &["rate"],
        "adam" | "sghmc" => &["trajectory"],
        "sghmc-gate" => &["gate"],
        "gradient-shadow" => &["shadow"],
        iteration::STAGE => &iteration::OUTPUTS,
        recycling::STAGE => &recycling::OUTPUTS,
        run::STAGE => &run::OUTPUTS,
        _ => &["grad"],
    }
}

/// The dimensions of a stage, the most telling first.
pub(crate) fn dimensions(stage: &str) -> Vec<Dimension> {
    let of = |of, inputs: &[(&'static str, usize)], outputs: &[(&'static str, usize)], step, reversible| Dimension {
        of,
        inputs: inputs.to_vec(),
        outputs: outputs.to_vec(),
        step,
        reversible,
    };
    let primitives =
        |role: &'static str, outputs: &[(&'static str, usize)]| of(Of::Primitives, &[(role, 0)], outputs, 1, true);
    let elements = |inputs: &[(&'static str, usize)], outputs: &[(&'static str, usize)]| {
        of(Of::Elements, inputs, outputs, 1, true)
    };
    // A dimension, and three axes of an output or of a cotangent.
    let with =
        |all: Dimension, kinds: [Of; 3], inputs: Option<&'static str>, outputs: Option<(&'static str, usize)>| {
            let axes = kinds.into_iter().enumerate().map(|(axis, kind)| {
                let inputs: Vec<_> = inputs.iter().map(|role| (*role, axis)).collect();
                let outputs: Vec<_> = outputs.iter().map(|(role, first)| (*role, first + axis)).collect();
                of(kind, &inputs, &outputs, 1, kind == Of::Views)
            });
            iter::once(all).chain(axes).collect()
        };
    let (images, voxels) = ([Of::Views, Of::Rows, Of::Columns], [0, 1, 2].map(Of::Voxels));
    let block =
        |step| move |axis| of(Of::Elements, &[("block", axis), ("high", axis)], &[("gradient", axis)], step, step != 2);
    match stage {
        "covariance" => vec![primitives("model", &[("covariance", 0)])],
        "kernel" => vec![elements(&[("delta", 0), ("nu", 0)], &[("kernel", 0)])],
        "integral-factor" => vec![elements(&[("nu", 0)], &[("factor", 0), ("slope", 0)])],
        "density" | "density-cutoff" => with(primitives("model", &[]), voxels, None, Some(("volume", 0))),
        "projected-kernel-affine" | "projected-kernel-exact" => {
            with(primitives("model", &[("kernels", 0)]), images, None, Some(("kernels", 1)))
        }
        "image-affine" | "image-exact" | "image-cutoff" => {
            with(primitives("model", &[]), images, None, Some(("image", 0)))
        }
        "gradient-density" => with(primitives("model", &[("grad", 0)]), voxels, Some("cotangent"), None),
        "gradient-image-affine" | "gradient-image-exact" => {
            with(primitives("model", &[("grad", 0)]), images, Some("cotangent"), None)
        }
        "gradient-shadow" => with(primitives("model", &[("shadow", 0)]), images, Some("cotangent"), None),
        "gradient-raw" => with(primitives("raw", &[("grad", 0)]), images, Some("cotangent"), None),
        "activation" => vec![primitives("raw", &[("physical", 0)])],
        "loss-l1" | "loss-ssim" | "loss-image" => {
            let along = |axis| elements(&[("prediction", axis), ("target", axis)], &[("gradient", axis)]);
            vec![along(0), along(1)]
        }
        "loss-tv" => (0..3).map(block(1)).collect(),
        "haar" => (0..3).map(block(2)).collect(),
        "wavelet-loss" => (0..3).map(block(4)).collect(),
        "gradient-wavelet" => vec![primitives("model", &[("grad", 0)])],
        "nu-target" => vec![elements(&[("c", 0)], &[("nu_target", 0)])],
        "loss-nu" => vec![elements(&[("nu", 0), ("target", 0), ("confidence", 0)], &[("gradient", 0)])],
        "schedule" => vec![elements(&[("steps", 0)], &[("rate", 0)])],
        "sghmc-gate" => vec![elements(&[("density", 0)], &[("gate", 0)])],
        "adam" => vec![
            elements(&[("start", 0), ("gradients", 1)], &[("trajectory", 1)]),
            of(Of::Elements, &[("gradients", 0), ("rates", 0)], &[("trajectory", 0)], 1, false),
        ],
        "sghmc" => vec![
            elements(
                &[("start", 0), ("directions", 1), ("noise", 1), ("gates", 0), ("covariance", 0)],
                &[("trajectory", 1)],
            ),
            of(Of::Elements, &[("directions", 0), ("noise", 0), ("rates", 0)], &[("trajectory", 0)], 1, false),
        ],
        iteration::STAGE => {
            let inputs =
                ["raw", "first", "second", "momentum", "normals", "confidence", "nu_target"].map(|role| (role, 0));
            let outputs: Vec<_> =
                iteration::ARCHIVES.into_iter().chain(["10-momentum"]).map(|role| (role, 0)).collect();
            vec![of(Of::Primitives, &inputs, &outputs, 1, true)]
        }
        recycling::STAGE => {
            let inputs = ["raw", "first", "second", "momentum"].map(|role| (role, 0));
            vec![of(Of::Primitives, &inputs, &recycling::OUTPUTS.map(|role| (role, 0)), 1, false)]
        }
        run::STAGE => {
            let outputs: Vec<_> = run::OUTPUTS[1..].iter().map(|role| (*role, 0)).collect();
            let steps = of(Of::Elements, &[("normals", 0)], &[(run::OUTPUTS[0], 0)], 1, false);
            vec![of(Of::Primitives, &[("raw", 0)], &outputs, 1, false), steps]
        }
        _ => Vec::new(),
    }
}
