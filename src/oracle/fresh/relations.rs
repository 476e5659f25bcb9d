//! Relations between answers, which need no truth: a question is asked in several forms.
//!
//! The expectation of a form is computed from the backend's answers to the others. Both sides may be wrong by rounding, so
//! that the limits of the stage hold [`FACTOR`] times. Zeros throughout meet all relations: they stand beside the questions
//! with a truth, and do not replace them.

use super::dimensions::{Of, dimensions};
use super::draft::Draft;
use super::flags::RELATIONS;
use super::truth::{insert, reordered, reversed, zeros};
use crate::manifest::{Arrays, Case, Vectors};
use crate::outputs::Outputs;
use ndarray::{ArrayD, Axis, IxDyn, concatenate};
use serde_json::json;
use std::ops::Range;
use std::path::Path;
use trgs_core::error::Result;

/// The stages with relations.
pub(crate) const STAGES: [&str; 6] =
    ["density", "image-affine", "image-exact", "gradient-density", "gradient-image-affine", "gradient-image-exact"];

/// Limits of the stage: two for the two answers, and two because the scenes have finer scales than those of the vectors.
pub(crate) const FACTOR: f64 = 4.0;
/// The angle of rotated scenes.
const TURN: f64 = 0.7;
/// The factor of scaled scenes.
const SCALE: f64 = 1.5;

/// The relation that question `index` of a stage asks for.
pub(super) fn choose(stage: &str, index: u64) -> &'static str {
    let fits = |word: &str| match word {
        "rotated" | "views" | "scaled" => stage.contains("image"),
        "split" | "linear" => !stage.starts_with("gradient"),
        "adjoint" => stage.starts_with("gradient"),
        _ => true,
    };
    let all: Vec<&str> = RELATIONS.iter().map(|(word, _)| *word).filter(|word| fits(word)).collect();
    // The sizes of level `large` have a period of five.
    all[((index + 2 * (index / 5)) % all.len() as u64) as usize]
}

fn word(draft: &Draft) -> &str {
    let flags = draft.flags.iter().map(String::as_str);
    flags.rev().find(|flag| RELATIONS.iter().any(|(word, _)| word == flag)).unwrap_or_default()
}

/// The forms of a question; the last one, or all but the first, are what the relation speaks of.
pub(crate) fn forms(base: &Draft) -> Vec<Draft> {
    let primitives = &dimensions(&base.stage)[0];
    let count = base.length(primitives);
    let mut forms = match word(base) {
        "rotated" => vec![base.clone(), rotated(base)],
        "reordered" => vec![base.clone(), reversed(base)],
        "split" => {
            let mut split = base.select(primitives, &(0..count).chain(count.checked_sub(1)).collect::<Vec<_>>());
            let halves = (count.saturating_sub(1)..=count).filter(|_| count > 0);
            halves.for_each(|index| model(&mut split, "density")[[index]] *= 0.5);
            vec![base.clone(), split]
        }
        "linear" => {
            let middle = count.div_ceil(2);
            let first: Vec<usize> = (0..middle).collect();
            let second: Vec<usize> = if middle < count { (middle..count).collect() } else { first.clone() };
            let mut both = base.select(primitives, &[&first[..], &second].concat());
            let density = model(&mut both, "density");
            density.iter_mut().skip(middle).for_each(|density| *density *= 3.0);
            vec![base.select(primitives, &first), base.select(primitives, &second), both]
        }
        "views" => {
            let views = dimensions(&base.stage).into_iter().find(|dimension| dimension.of == Of::Views);
            let views = views.expect("images have views");
            let single = (0..base.length(&views)).map(|view| base.select(&views, &[view]));
            single.chain([base.clone()]).collect()
        }
        "scaled" => vec![base.clone(), scaled(base)],
        _ => {
            let mut gradient = base.clone();
            let cotangent = gradient.arrays.get_mut("cotangent").and_then(|arrays| arrays.get_mut(""));
            cotangent.expect("a gradient has one").mapv_inplace(f64::abs);
            let mut image = gradient.clone();
            image.stage = base.stage.trim_start_matches("gradient-").into();
            image.arrays.remove("cotangent");
            vec![image, gradient]
        }
    };
    for (index, form) in forms.iter_mut().enumerate() {
        form.id = format!("{}-{index}", base.id);
    }
    forms
}

fn model<'a>(draft: &'a mut Draft, name: &str) -> &'a mut ArrayD<f64> {
    draft.arrays.get_mut("model").and_then(|arrays| arrays.get_mut(name)).expect("a scene has a model")
}

/// Turns points around the z axis.
fn turn_points(points: &mut ArrayD<f64>) {
    let (sin, cos) = (libm::sin(TURN), libm::cos(TURN));
    for mut p in points.outer_iter_mut() {
        (p[0], p[1]) = (cos * p[0] - sin * p[1], sin * p[0] + cos * p[1]);
    }
}

/// Multiplies quaternions by that of the turn, from the left.
fn turn_quaternions(quaternions: &mut ArrayD<f64>) {
    let (c, s) = (libm::cos(0.5 * TURN), libm::sin(0.5 * TURN));
    for mut q in quaternions.outer_iter_mut() {
        let [w, x, y, z] = [q[0], q[1], q[2], q[3]];
        (q[0], q[1], q[2], q[3]) = (c * w - s * z, c * x - s * y, c * y + s * x, c * z + s * w);
    }
}

fn rotated(base: &Draft) -> Draft {
    let mut draft = base.clone();
    turn_points(model(&mut draft, "mean"));
    turn_quaternions(model(&mut draft, "quaternion"));
    let angles = base.settings["angles"].as_array().into_iter().flatten();
    draft.settings["angles"] = angles.map(|angle| json!(angle.as_f64().unwrap_or(0.0) + TURN)).collect();
    draft
}

fn scaled(base: &Draft) -> Draft {
    let mut draft = base.clone();
    ["mean", "scale"].into_iter().for_each(|name| model(&mut draft, name).mapv_inplace(|x| x * SCALE));
    if let Some(s) = &mut draft.scanner {
        // The longest side of a volume is 2 in scene units, and images do not depend on it.
        let lengths = [&mut s.s_detector[..], &mut s.off_detector];
        lengths.into_iter().flatten().chain([&mut s.dso, &mut s.dsd]).for_each(|length| *length *= SCALE);
    }
    draft
}

/// The shapes of a form's answer.
fn shapes(draft: &Draft) -> Outputs {
    let scanner = draft.scanner.as_ref().expect("a scene has one");
    let zeros = |shape: &[usize]| ArrayD::zeros(IxDyn(shape));
    let (role, arrays) = match draft.stage.as_str() {
        "density" => ("volume", Arrays::from([(String::new(), zeros(&scanner.n_voxel))])),
        stage if stage.starts_with("gradient") => {
            let shaped = draft.arrays["model"].iter().map(|(name, array)| (name.clone(), zeros(array.shape())));
            ("grad", shaped.collect())
        }
        _ => {
            let views = draft.settings["angles"].as_array().map_or(0, Vec::len);
            let [rows, columns] = scanner.n_detector;
            ("image", Arrays::from([(String::new(), zeros(&[views, rows, columns]))]))
        }
    };
    [(role.to_owned(), arrays)].into()
}

/// The answers that the forms must have if the others are right.
fn expected(forms: &[Draft], answers: &[Outputs]) -> Vec<Outputs> {
    let mut all = answers.to_vec();
    let last = all.len() - 1;
    let gradient = forms[last].stage.starts_with("gradient");
    let combine = |terms: &[(f64, &Outputs)]| {
        let mut sum = zeros(terms[0].1);
        for (factor, term) in terms {
            for (role, arrays) in &mut sum {
                arrays.iter_mut().for_each(|(name, array)| array.scaled_add(*factor, &term[role][name]));
            }
        }
        sum
    };
    all[last] = match word(&forms[last]) {
        "reordered" => reordered(&forms[0], &answers[0]),
        "linear" => combine(&[(1.0, &answers[0]), (3.0, &answers[1])]),
        "views" if gradient => combine(&answers[..last].iter().map(|one| (1.0, one)).collect::<Vec<_>>()),
        "views" => {
            let images: Vec<_> = answers[..last].iter().map(|one| one["image"][""].view()).collect();
            let image = concatenate(Axis(0), &images).expect("images of one detector");
            [("image".to_owned(), Arrays::from([(String::new(), image)]))].into()
        }
        "rotated" if gradient => {
            let mut turned = answers[0].clone();
            let grad = turned.get_mut("grad").expect("an output");
            grad.get_mut("mean").into_iter().for_each(turn_points);
            grad.get_mut("quaternion").into_iter().for_each(turn_quaternions);
            turned
        }
        "scaled" => {
            let mut scaled = answers[0].clone();
            // A line integral is a length, and its slope to a length is none.
            let lengths = scaled.values_mut().flatten().filter(|(name, _)| !matches!(name.as_str(), "mean" | "scale"));
            lengths.for_each(|(_, array)| array.mapv_inplace(|x| x * SCALE));
            scaled
        }
        "adjoint" => adjoint(&forms[last], &answers[0], &answers[last]),
        _ => answers[0].clone(),
    };
    all
}

/// The nearest gradient to the density with the inner product of image and cotangent.
fn adjoint(gradient: &Draft, image: &Outputs, answer: &Outputs) -> Outputs {
    let cotangent = gradient.arrays["cotangent"][""].iter();
    let products = image.values().flat_map(|arrays| arrays.values().flatten());
    let product: f64 = cotangent.zip(products).map(|(y, x)| x * y).sum();
    let density = &gradient.arrays["model"]["density"];
    let mut nearest = answer.clone();
    let slope = nearest.get_mut("grad").and_then(|grad| grad.get_mut("density")).expect("an output");
    let own: f64 = density.iter().zip(slope.iter()).map(|(x, g)| x * g).sum();
    let square: f64 = density.iter().map(|x| x * x).sum();
    if square > 0.0 {
        slope.scaled_add((product - own) / square, density);
    }
    nearest
}

/// The cases of each group of forms.
pub(crate) fn groups(cases: &[Case]) -> Vec<Range<usize>> {
    let base = |index: usize| cases[index].id.rsplit_once('-').map(|(base, _)| base);
    let starts = (1..cases.len()).filter(|&index| base(index) != base(index - 1));
    let starts: Vec<usize> = [0].into_iter().chain(starts).chain([cases.len()]).collect();
    starts.windows(2).map(|pair| pair[0]..pair[1]).collect()
}

/// Adds the expectations to questions with relations, from the answers in a folder.
///
/// Where an answer is missing or has another shape, only its own shape is expected.
pub(crate) fn complete(vectors: &mut Vectors, folder: &Path) -> Result<()> {
    for range in groups(&vectors.manifest.cases) {
        let forms = range.clone().map(|index| Draft::read(vectors, &vectors.manifest.cases[index]));
        let forms = forms.collect::<Result<Vec<Draft>>>()?;
        let shapes: Vec<Outputs> = forms.iter().map(shapes).collect();
        let answers: Option<Vec<Outputs>> =
            range.clone().zip(&shapes).map(|(index, shape)| answered(vectors, index, folder, shape)).collect();
        let all = answers.map_or(shapes, |answers| expected(&forms, &answers));
        for (index, expected) in range.zip(all) {
            let allowance = zeros(&expected);
            insert(vectors, index, &(expected, allowance));
        }
    }
    Ok(())
}

/// An answer of the right shape.
fn answered(vectors: &Vectors, index: usize, folder: &Path, shape: &Outputs) -> Option<Outputs> {
    let read = |(role, arrays): (&String, &Arrays)| {
        let file = &vectors.manifest.cases[index].outputs[role].file;
        let mut got = crate::plain::answered(&folder.join(file)).ok().flatten()?;
        got.retain(|name, _| arrays.contains_key(name));
        let fits = arrays.iter().all(|(name, array)| got.get(name).is_some_and(|got| got.shape() == array.shape()));
        fits.then(|| (role.clone(), got))
    };
    shape.iter().map(read).collect()
}
