//! The truth of generated questions: the f64 path, with the error that it may have itself.
//!
//! The allowance of an element is the sum of
//!
//! - four times its change when primitives, views or elements are evaluated in the reversed order;
//! - its condition times `4·2⁻⁵³`, for the truth, and times [`ROUNDINGS`] rounding errors of the backend's format.
//!
//! The condition is the largest change of the element, divided by the size of the step, in [`SAMPLES`] evaluations with
//! all inputs moved by a step of [`STEP`] of their natural size in random directions. Centres and detectors move by
//! fractions of the distances in the scene, because a backend computes with coordinates of that size; amplitudes also by
//! log Γ, which a backend in single precision takes differences of.
//!
//! Of an iteration, what cancels in its slopes is followed through all later outputs. Runs of many steps have a corridor
//! instead: [`CORRIDOR`] times the largest difference of [`RUNS`] runs in f64 whose state is changed by rounding errors of the
//! format after every step.

use super::dimensions::dimensions;
use super::draft::Draft;
use crate::answers::answer;
use crate::format::Format;
use crate::manifest::{FileRef, Vectors, encode};
use crate::outputs::Outputs;
use crate::question::Question;
use crate::{iteration, run};
use ndarray::{ArrayD, Axis, Ix2};
use rand::{Rng, RngExt};
use serde_json::json;
use trgs_core::error::{Error, Result};
use trgs_core::geometry::Beam;
use trgs_core::numeric::Precision;
use trgs_core::numeric::rng::{self, Purpose};
use trgs_core::primitives::{Group, Parameters, student_t};
use trgs_core::projector::Projection;

/// Evaluations with changed inputs.
const SAMPLES: u64 = 6;
/// The relative change of the inputs.
const STEP: f64 = 1.0 / 4_194_304.0;
/// Rounding errors of the natural size of the inputs that a correct backend may make.
const ROUNDINGS: f64 = 8.0;
/// Runs that make the corridor of a run, and the multiple of their largest difference that it is.
const RUNS: u64 = 8;
const CORRIDOR: f64 = 4.0;
/// What an integral may multiply a density with: scales of a scene are at most 2, times √(2π).
const FACTOR: f64 = 8.0;
/// What SSIM adds to its variances.
const SSIM_C2: f64 = 0.03 * 0.03;

/// Adds the truth and its allowances to generated questions; other vectors stay as they are.
///
/// # Errors
/// Those of reading, or for a question that has no finite answer.
pub(crate) fn complete(vectors: &mut Vectors, format: Format) -> Result<()> {
    if !super::is_generated(vectors) {
        return Ok(());
    }
    for index in 0..vectors.manifest.cases.len() {
        let draft = Draft::read(vectors, &vectors.manifest.cases[index])?;
        insert(vectors, index, &truth(&draft, format)?);
    }
    Ok(())
}

/// Adds the truth of case `index` and its allowances.
pub(crate) fn insert(vectors: &mut Vectors, index: usize, (truth, allowance): &(Outputs, Outputs)) {
    let case = &mut vectors.manifest.cases[index];
    for (role, file) in &case.outputs {
        let name = format!("allowances/{}", file.file);
        vectors.files.insert(file.file.clone(), encode(&truth[role]));
        vectors.files.insert(name.clone(), encode(&allowance[role]));
        case.allowances.insert(role.clone(), FileRef { file: name, sha256: None });
    }
}

/// The answer to a question, and the error of each element that does not count.
///
/// # Errors
/// For a question that has no finite answer.
pub(crate) fn truth(draft: &Draft, format: Format) -> Result<(Outputs, Outputs)> {
    let question = draft.question()?;
    let truth = answer(&question, Precision::F64)?;
    // ν of the Gaussian is infinite.
    let has_end = question.stage == "activation";
    if truth.values().flat_map(|arrays| arrays.values().flatten()).any(|x| x.is_nan() || (x.is_infinite() && !has_end))
    {
        return Err(Error::invalid(
            format!("case {}", draft.id),
            "no finite answer",
            "finite numbers",
            "change the inputs",
        ));
    }
    let unit = match format {
        Format::F64 => Format::F64.ulp(1.0),
        _ => Format::F32.ulp(1.0),
    };
    if question.stage == run::STAGE {
        let corridor = corridor(&question, &truth, 0.5 * ROUNDINGS * unit)?;
        return Ok((truth, corridor));
    }
    let mut allowance = zeros(&truth);
    let other = reordered(draft, &answer(&reversed(draft).question()?, Precision::F64)?);
    raise(&mut allowance, &truth, &other, 4.0);
    let mut condition = zeros(&truth);
    if let Some(smooth) = smooth(&question) {
        let base = if smooth.stage == question.stage { truth.clone() } else { answer(&smooth, Precision::F64)? };
        for sample in 0..SAMPLES {
            raise(&mut condition, &base, &answer(&moved(&smooth, sample)?, Precision::F64)?, 1.0 / STEP);
        }
    }
    for_what_cancels(&question, &truth, &mut condition)?;
    let share = 0.5 * (4.0 * Format::F64.ulp(1.0) + ROUNDINGS * unit);
    if question.stage == iteration::STAGE {
        // What the parts of its slopes change in all that follows: the first step of Adam has the sign of a slope of 0.
        let parts = parts_of_slopes(&of_image(&question, &truth))?;
        let mut errors = zeros(&truth);
        for share in [-share, share] {
            let change = |gradient: &mut Parameters| {
                for group in [Group::Quaternion, Group::Nu] {
                    let slopes = gradient.group_mut(group).iter_mut().zip(parts.group(group));
                    slopes.for_each(|(slope, part)| *slope += share * part);
                }
            };
            raise(&mut errors, &truth, &iteration::changed::<f64>(&question, &change)?, 1.0);
        }
        add(&mut allowance, &errors, 1.0);
    }
    // Hardware may flush the power of a kernel to zero before it is multiplied with density and integral factor.
    let densities: f64 = draft.arrays.get("model").map_or(0.0, |model| model["density"].sum());
    let flushed = FACTOR * densities * format.smallest_normal();
    allowance.values_mut().flat_map(|arrays| arrays.values_mut()).for_each(|array| *array += flushed);
    add(&mut allowance, &condition, share);
    if question.stage.ends_with("-cutoff") {
        for sign in [-1.0, 1.0] {
            // δ of the cutoff changes by 1e-4 of itself.
            let cutoff = question.setting("cutoff")?;
            let mut near = question.clone();
            near.settings["cutoff"] = json!(cutoff * libm::exp(sign * 1e-4 * libm::log(cutoff)));
            raise(&mut allowance, &truth, &answer(&near, Precision::F64)?, 1.0);
        }
    }
    Ok((truth, allowance))
}

/// How far correct runs are apart: the difference of runs whose state is changed by ±`unit` of each number after every step.
fn corridor(question: &Question, truth: &Outputs, unit: f64) -> Result<Outputs> {
    let mut corridor = zeros(truth);
    for run in 0..RUNS {
        let mut random = rng::stream(0, Purpose::Perturbation, run, 1);
        let mut change = |array: &mut ArrayD<f64>| {
            array.mapv_inplace(|x| x * (1.0 + if random.random::<bool>() { unit } else { -unit }));
        };
        raise(&mut corridor, truth, &run::walk::<f64>(question, &mut change)?, CORRIDOR);
    }
    Ok(corridor)
}

pub(super) fn zeros(like: &Outputs) -> Outputs {
    let mut zeros = like.clone();
    zeros.values_mut().flat_map(|arrays| arrays.values_mut()).for_each(|array| array.fill(0.0));
    zeros
}

/// Raises `bound` to `factor` times the difference.
fn raise(bound: &mut Outputs, a: &Outputs, b: &Outputs, factor: f64) {
    for (role, arrays) in bound {
        for (name, bound) in arrays {
            let difference = a[role][name].iter().zip(&b[role][name]).map(|(a, b)| (a - b).abs() * factor);
            bound.iter_mut().zip(difference).for_each(|(bound, difference)| *bound = bound.max(difference));
        }
    }
}

fn add(sum: &mut Outputs, more: &Outputs, factor: f64) {
    for (role, arrays) in sum {
        arrays
            .iter_mut()
            .for_each(|(name, sum)| sum.zip_mut_with(&more[role][name], |sum, more| *sum += factor * more));
    }
}

/// The question with every dimension that has no order reversed.
pub(crate) fn reversed(draft: &Draft) -> Draft {
    dimensions(&draft.stage).iter().filter(|dimension| dimension.reversible).fold(draft.clone(), |draft, dimension| {
        let back: Vec<usize> = (0..draft.length(dimension)).rev().collect();
        draft.select(dimension, &back)
    })
}

/// The answer to the reversed question in the order of the question itself.
pub(crate) fn reordered(draft: &Draft, answer: &Outputs) -> Outputs {
    let mut answer = answer.clone();
    for dimension in dimensions(&draft.stage).iter().filter(|dimension| dimension.reversible) {
        for (role, axis) in &dimension.outputs {
            for array in answer.get_mut(*role).into_iter().flat_map(|arrays| arrays.values_mut()) {
                array.invert_axis(Axis(*axis));
            }
        }
    }
    answer
}

/// The question whose smoothness in its inputs bounds the rounding errors; `None` if rounding cannot be magnified.
fn smooth(question: &Question) -> Option<Question> {
    match question.stage.as_str() {
        "loss-l1" | "loss-tv" => None,
        // The other part is L1, which jumps where pixels are equal.
        "loss-image" => {
            let mut smooth = question.clone();
            smooth.stage = "loss-ssim".into();
            Some(smooth)
        }
        _ => Some(question.clone()),
    }
}

/// The question with all inputs moved by a small step.
fn moved(question: &Question, sample: u64) -> Result<Question> {
    let mut rng = rng::stream(0, Purpose::Perturbation, sample, 0);
    let mut moved = question.clone();
    let projects = question.settings.contains_key("angles");
    let mut reach = 1.0;
    if let Some(scanner) = &mut moved.scanner {
        if let (Beam::Cone { dso, .. }, true) = (scanner.beam, projects) {
            reach = dso;
        }
        let d = &mut scanner.detector;
        let sides = [d.rows as f64 * d.pitch_v + d.offset_v.abs(), d.columns as f64 * d.pitch_u + d.offset_u.abs()];
        d.offset_v += step(&mut rng) * sides[0];
        d.offset_u += step(&mut rng) * sides[1];
        d.pitch_v *= 1.0 + step(&mut rng);
        d.pitch_u *= 1.0 + step(&mut rng);
        scanner.grid.min.as_mut().iter_mut().for_each(|x| *x += step(&mut rng) * (1.0 + x.abs()));
    }
    if question.settings.contains_key("angles") {
        let angles: Vec<f64> = question.angles()?.iter().map(|a| a + step(&mut rng) * (1.0 + a.abs())).collect();
        moved.settings["angles"] = json!(angles);
    }
    for (role, arrays) in moved.arrays_mut() {
        if matches!(role.as_str(), "steps" | "high") {
            continue;
        }
        let in_model = matches!(role.as_str(), "model" | "raw");
        let nu: Vec<f64> = arrays.get("nu").map_or_else(Vec::new, |nu| nu.iter().copied().collect());
        for (name, array) in arrays {
            match name.as_str() {
                "mean" => array.mapv_inplace(|x| x + step(&mut rng) * (reach + x.abs())),
                "quaternion" => array.outer_iter_mut().for_each(|mut q| {
                    let norm = q.iter().map(|x| x * x).sum::<f64>().sqrt();
                    q.mapv_inplace(|x| x + step(&mut rng) * norm);
                }),
                "density" if in_model && projects => array.iter_mut().zip(&nu).for_each(|(x, nu)| {
                    *x *= 1.0 + step(&mut rng) * (1.0 + gamma(*nu));
                }),
                _ => array.mapv_inplace(|x| x * (1.0 + step(&mut rng))),
            }
        }
    }
    Ok(moved)
}

/// ±[`STEP`].
fn step(rng: &mut impl Rng) -> f64 {
    if rng.random::<bool>() { STEP } else { -STEP }
}

/// log Γ((ν+3)/2), the size of what cancels in the integral factor.
fn gamma(nu: f64) -> f64 {
    if nu.is_finite() { libm::lgamma(0.5 * nu.abs() + 1.5).abs() } else { 0.0 }
}

/// Adds what cancels to the condition: logarithms of Γ and ψ in ∂/∂ν and in the integral factor, 1 - SSIM, variances as
/// differences of squares, and what the three axes give to a quaternion, which is nothing in all if their scales are equal.
fn for_what_cancels(question: &Question, truth: &Outputs, condition: &mut Outputs) -> Result<()> {
    if let ("loss-image", Some(value)) = (question.stage.as_str(), condition.get_mut("value")) {
        // 1 - SSIM of images that are almost equal: SSIM itself is rounded at 1.
        value.get_mut("").expect("an array")[[0]] += question.setting("weight")?;
    }
    if let ("loss-ssim" | "loss-image", Some(gradient)) = (question.stage.as_str(), condition.get_mut("gradient")) {
        let gradient = gradient.get_mut("").expect("an array");
        let largest = truth["gradient"][""].iter().fold(0.0_f64, |most, x| most.max(x.abs()));
        let (mut squares, mut variances) = (0.0, SSIM_C2);
        for role in ["prediction", "target"] {
            let values: Vec<f64> = question.array::<Ix2>(role)?.into_iter().collect();
            let mean = |of: &dyn Fn(&f64) -> f64| values.iter().map(of).sum::<f64>() / values.len().max(1) as f64;
            let centre = mean(&|x| *x);
            squares += mean(&|x| x * x);
            variances += mean(&|x| (x - centre) * (x - centre));
        }
        gradient.mapv_inplace(|x| x + largest * squares / variances);
        let weight = if question.stage == "loss-image" { question.setting("weight")? } else { 1.0 };
        let value = condition.get_mut("value").and_then(|value| value.get_mut("")).expect("an output");
        value[[0]] += weight * squares / variances;
    }
    if question.stage == "integral-factor" {
        for (index, nu) in question.numbers("nu")?.into_iter().enumerate() {
            let factor = student_t::line_integral(nu).0;
            condition.get_mut("factor").expect("an output").get_mut("").expect("an array")[[index]] +=
                factor * gamma(nu);
            condition.get_mut("slope").expect("an output").get_mut("").expect("an array")[[index]] +=
                factor * cancelled(nu);
        }
    }
    let is_gradient = question.stage.starts_with("gradient-image") || question.stage == "gradient-density";
    if let (true, Some(grad)) = (is_gradient, condition.get_mut("grad")) {
        let parts = parts_of_slopes(question)?;
        for i in 0..parts.len() {
            grad.get_mut("nu").expect("a part")[[i]] += parts.nu[i];
            let quaternion = grad.get_mut("quaternion").expect("a part");
            (0..4).for_each(|k| quaternion[[i, k]] += parts.quaternion[i][k]);
        }
    }
    Ok(())
}

/// 1 and the size of ψ at ν, a difference of which is the slope of the integral factor.
fn cancelled(nu: f64) -> f64 {
    if nu.is_finite() { 1.0 + libm::log(1.0 + nu) } else { 0.0 }
}

/// What cancels in the slopes of a gradient to ν and quaternions; 0 elsewhere.
fn parts_of_slopes(question: &Question) -> Result<Parameters> {
    let mut positive = question.clone();
    let cotangent = positive.arrays_mut().get_mut("cotangent").and_then(|arrays| arrays.get_mut(""));
    cotangent.expect("a gradient has one").mapv_inplace(f64::abs);
    let whole = answer(&positive, Precision::F64)?;
    let parameters = question.parameters("model")?;
    let [sums, scales] = ["density", "scale"].map(|name| &whole["grad"][name]);
    let mut parts = Parameters::zeros(parameters.len());
    for (i, (density, nu)) in parameters.density.iter().zip(&parameters.nu).enumerate() {
        parts.nu[i] = sums[[i]] * density * cancelled(*nu);
        let axes: f64 = (0..3).map(|k| (scales[[i, k]] * parameters.scale[i][k]).abs()).sum();
        let norm = parameters.quaternion[i].iter().map(|x| x * x).sum::<f64>().sqrt();
        parts.quaternion[i] = [2.0 * axes / norm; 4];
    }
    Ok(parts)
}

/// The gradient through the image of an iteration, as a question.
fn of_image(iteration: &Question, truth: &Outputs) -> Question {
    let mut question = iteration.clone();
    question.stage = match iteration.projection() {
        Ok(Projection::Exact) => "gradient-image-exact",
        _ => "gradient-image-affine",
    }
    .into();
    let cotangent = truth["03-cotangent"][""].clone().insert_axis(Axis(0));
    question.arrays_mut().insert("cotangent".into(), [(String::new(), cotangent)].into());
    question.arrays_mut().insert("model".into(), truth["01-physical"].clone());
    question
}
