//! Questions without an answer, or at the borders of what has one: refusals instead of values.
//!
//! `refuse`: the inputs mean nothing, and no finite number may come out. `finite`: the question is valid, however odd.
//! `either`: an implementation may refuse it or answer with finite numbers; NaN must not leak.

use super::draft::Draft;
use super::flags::REFUSALS;
use super::stages;
use crate::manifest::{Arrays, Level};
use ndarray::{ArrayD, Axis, IxDyn};
use serde_json::json;
use std::f64::consts::PI;

/// A change of a valid question.
type Change = fn(&mut Draft);

/// Stage, name, outcome, change.
const QUESTIONS: [(&str, &str, &str, Change); 50] = [
    ("covariance", "zero-quaternion", "refuse", |d| first(d, "model", "quaternion", 4, 0.0)),
    ("covariance", "nan-scale", "refuse", |d| first(d, "model", "scale", 1, f64::NAN)),
    ("covariance", "small-quaternion", "finite", |d| scale(d, "quaternion", 1e-12)),
    ("covariance", "no-primitives", "finite", no_primitives),
    ("kernel", "zero-nu", "refuse", |d| first(d, "nu", "", 1, 0.0)),
    ("kernel", "negative-nu", "refuse", |d| first(d, "nu", "", 1, -3.0)),
    ("kernel", "nan-delta", "refuse", |d| first(d, "delta", "", 1, f64::NAN)),
    ("kernel", "large-delta", "finite", |d| first(d, "delta", "", 1, 1e30)),
    ("kernel", "infinite-nu", "finite", |d| first(d, "nu", "", 1, f64::INFINITY)),
    ("integral-factor", "zero-nu", "refuse", |d| first(d, "nu", "", 1, 0.0)),
    ("integral-factor", "large-nu", "finite", |d| first(d, "nu", "", 1, 1e7)),
    ("density", "zero-scale", "refuse", |d| first(d, "model", "scale", 1, 0.0)),
    ("density", "nan-mean", "refuse", |d| first(d, "model", "mean", 1, f64::NAN)),
    ("density", "no-primitives", "finite", no_primitives),
    ("density", "far-away", "finite", |d| first(d, "model", "mean", 1, 1e6)),
    ("image-affine", "zero-quaternion", "refuse", |d| first(d, "model", "quaternion", 4, 0.0)),
    ("image-affine", "no-primitives", "finite", no_primitives),
    ("image-affine", "at-the-source", "finite", at_the_source),
    ("image-exact", "zero-quaternion", "refuse", |d| first(d, "model", "quaternion", 4, 0.0)),
    ("image-exact", "zero-scale", "refuse", |d| first(d, "model", "scale", 1, 0.0)),
    ("image-exact", "negative-scale", "refuse", |d| first(d, "model", "scale", 1, -0.1)),
    ("image-exact", "zero-nu", "refuse", |d| first(d, "model", "nu", 1, 0.0)),
    ("image-exact", "negative-nu", "refuse", |d| first(d, "model", "nu", 1, -2.0)),
    ("image-exact", "nan-density", "refuse", |d| first(d, "model", "density", 1, f64::NAN)),
    ("image-exact", "infinite-mean", "refuse", |d| first(d, "model", "mean", 1, f64::INFINITY)),
    ("image-exact", "negative-density", "either", |d| first(d, "model", "density", 1, -0.5)),
    ("image-exact", "no-views", "either", |d| d.settings["angles"] = json!([])),
    ("image-exact", "no-primitives", "finite", no_primitives),
    ("image-exact", "at-the-source", "finite", at_the_source),
    ("image-exact", "many-turns", "finite", |d| d.settings["angles"] = json!([200.0 * PI])),
    ("gradient-image-exact", "zero-scale", "refuse", |d| first(d, "model", "scale", 1, 0.0)),
    ("gradient-image-exact", "nan-cotangent", "refuse", |d| first(d, "cotangent", "", 1, f64::NAN)),
    ("gradient-image-exact", "no-primitives", "finite", no_primitives),
    ("gradient-image-exact", "at-the-source", "finite", at_the_source),
    ("activation", "nan-raw", "refuse", |d| first(d, "raw", "density", 1, f64::NAN)),
    ("activation", "large-raw", "finite", |d| first(d, "raw", "density", 1, 1e4)),
    ("loss-l1", "nan-pixel", "refuse", |d| first(d, "prediction", "", 1, f64::NAN)),
    ("loss-l1", "equal-images", "finite", equal_images),
    ("loss-ssim", "nan-pixel", "refuse", |d| first(d, "prediction", "", 1, f64::NAN)),
    ("loss-ssim", "equal-images", "finite", equal_images),
    ("loss-tv", "nan-voxel", "refuse", |d| first(d, "block", "", 1, f64::NAN)),
    ("loss-tv", "one-voxel", "finite", |d| put(d, "block", &[1, 1, 1], 0.5)),
    ("nu-target", "both-ends", "finite", |d| put(d, "c", &[1], 0.0)),
    ("loss-nu", "zero-nu", "refuse", |d| first(d, "nu", "", 1, 0.0)),
    ("loss-nu", "certain", "finite", |d| first(d, "confidence", "", 1, 1.0)),
    ("haar", "odd-side", "refuse", |d| put(d, "block", &[3, 4, 2], 0.5)),
    ("haar", "constant", "finite", |d| put(d, "block", &[2, 4, 2], 0.5)),
    ("wavelet-loss", "constant", "finite", |d| scale_all(d, "block", 0.0)),
    ("schedule", "beyond-the-length", "finite", |d| first(d, "steps", "", 1, 1e6)),
    ("adam", "no-slope", "finite", |d| scale_all(d, "gradients", 0.0)),
];

fn array<'a>(draft: &'a mut Draft, role: &str, name: &str) -> &'a mut ArrayD<f64> {
    draft.arrays.get_mut(role).and_then(|arrays| arrays.get_mut(name)).expect("an input of the stage")
}

/// Sets the first `n` numbers.
fn first(draft: &mut Draft, role: &str, name: &str, n: usize, value: f64) {
    array(draft, role, name).iter_mut().take(n).for_each(|x| *x = value);
}

fn scale(draft: &mut Draft, name: &str, factor: f64) {
    array(draft, "model", name).mapv_inplace(|x| x * factor);
}

fn scale_all(draft: &mut Draft, role: &str, factor: f64) {
    array(draft, role, "").mapv_inplace(|x| x * factor);
}

fn put(draft: &mut Draft, role: &str, shape: &[usize], value: f64) {
    let block = ArrayD::from_elem(IxDyn(shape), value);
    draft.arrays.insert(role.into(), Arrays::from([(String::new(), block)]));
}

fn no_primitives(draft: &mut Draft) {
    for array in draft.arrays.get_mut("model").expect("a scene has a model").values_mut() {
        *array = array.select(Axis(0), &[]);
    }
}

fn equal_images(draft: &mut Draft) {
    let target = draft.arrays["target"].clone();
    draft.arrays.insert("prediction".into(), target);
}

/// A centre in the source itself, which the near rule leaves out.
fn at_the_source(draft: &mut Draft) {
    let scanner = draft.scanner.as_mut().expect("a scene has one");
    scanner.mode = "cone".into();
    let dso = scanner.dso;
    draft.settings["angles"] = json!([0.0]);
    first(draft, "model", "mean", 3, 0.0);
    first(draft, "model", "mean", 1, dso);
    if draft.arrays.contains_key("cotangent") {
        let [rows, columns] = draft.scanner.as_ref().expect("a scene has one").n_detector;
        put(draft, "cotangent", &[1, rows, columns], 1.0);
    }
}

/// Question `index` of a stage, if there are so many.
pub(super) fn draft(stage: &str, seed: u64, index: u64) -> Option<Draft> {
    let (_, name, outcome, change) = QUESTIONS.iter().filter(|question| question.0 == stage).nth(index as usize)?;
    let mut draft = stages::draft(stage, seed, 0, Level::Core, false);
    change(&mut draft);
    draft.id = format!("{stage}/{name}-{seed}-{index}");
    draft.title = format!("{name}: {outcome}");
    draft.flags = vec![(*outcome).into()];
    Some(draft)
}

/// The stages with such questions.
pub(super) fn stages() -> Vec<&'static str> {
    let mut stages: Vec<_> = QUESTIONS.iter().map(|question| question.0).collect();
    stages.dedup();
    stages
}

/// The number of questions of a stage.
pub(super) fn count(stage: &str) -> usize {
    QUESTIONS.iter().filter(|question| question.0 == stage).count()
}

/// Whether a question may be left without an answer.
pub(crate) fn may_refuse(flags: &[String]) -> bool {
    flags.iter().any(|flag| flag == "refuse" || flag == "either")
}

/// What is wrong with an answer, or with its absence: `None` in `finite` stands for no answer.
pub(crate) fn fault(flags: &[String], finite: Option<bool>) -> Option<&'static str> {
    match (flags.iter().map(String::as_str).find(|flag| REFUSALS.iter().any(|(word, _)| word == flag)), finite) {
        (Some("refuse"), Some(true)) => Some("finite numbers for a question without an answer"),
        (Some("finite"), None) => Some("no answer"),
        (Some("finite" | "either"), Some(false)) => Some("NaN or infinity"),
        _ => None,
    }
}
