use super::*;
use crate::check::{Options, Status, check};
use crate::limits::Tolerances;
use crate::{answers, waivers};
use trgs_core::numeric::Precision;

fn all_stages() -> Vec<String> {
    STAGES.iter().map(ToString::to_string).collect()
}

/// The failures of this program's own answers, with a change of each question; it refuses by an error or a panic.
fn failures(vectors: &Vectors, precision: Precision, format: Format, change: fn(&mut crate::Question)) -> Vec<String> {
    let folder = tempfile::tempdir().unwrap();
    for case in &vectors.manifest.cases {
        let answer = || {
            let mut question = crate::Question::new(vectors, case)?;
            change(&mut question);
            answers::answer(&question, precision)
        };
        if let Ok(Ok(outputs)) = std::panic::catch_unwind(std::panic::AssertUnwindSafe(answer)) {
            answers::write(folder.path(), case, &outputs).unwrap();
        }
    }
    let vectors = &with_truth(vectors.clone(), format, folder.path()).unwrap();
    let options =
        Options { format, level: Level::Stress, stages: &[], waivers: &[], today: waivers::today(), commit: None };
    let tolerances = Tolerances::of(vectors).unwrap();
    let report = check(vectors, &tolerances, folder.path(), &options).unwrap();
    report
        .results
        .iter()
        .filter(|result| result.status != Status::Passed)
        .map(|result| format!("{}: {:?}", result.id, result.parts))
        .collect()
}

#[test]
fn questions_are_those_of_their_seed() {
    let one = |seed| make(&all_stages(), seed, 3, Level::Stress, Ask::Values).unwrap();
    assert_eq!(one(1).digest, one(1).digest);
    assert_ne!(one(1).digest, one(2).digest);
    let some = make(&["kernel".into()], 1, 2, Level::Core, Ask::Values).unwrap();
    let more = make(&["kernel".into()], 1, 5, Level::Core, Ask::Values).unwrap();
    assert_eq!(some.manifest.cases[..], more.manifest.cases[..2]);
    assert!(
        make(&["kernels".into()], 1, 2, Level::Core, Ask::Values)
            .unwrap_err()
            .to_string()
            .contains("covariance, kernel")
    );
}

#[test]
fn the_own_answers_pass_in_both_precisions() {
    let vectors = make(&all_stages(), 7, 4, Level::Stress, Ask::Values).unwrap();
    for (precision, format) in [(Precision::F64, Format::F64), (Precision::F32, Format::F32)] {
        assert_eq!(failures(&vectors, precision, format, |_| {}), Vec::<String>::new());
    }
    let images = make(&["image-exact".into()], 7, 4, Level::Core, Ask::Values).unwrap();
    assert_eq!(failures(&images, Precision::F32, Format::F64, |_| {}).len(), 4);
}

#[test]
fn relations_hold_for_right_answers_and_not_without_the_last_primitive() {
    let vectors = make(
        &Ask::Relations.stages().iter().map(|s| (*s).into()).collect::<Vec<_>>(),
        7,
        10,
        Level::Core,
        Ask::Relations,
    )
    .unwrap();
    for (precision, format) in [(Precision::F64, Format::F64), (Precision::F32, Format::F32)] {
        assert_eq!(failures(&vectors, precision, format, |_| {}), Vec::<String>::new());
    }
    let without_the_last = |question: &mut crate::Question| {
        let mut parameters = question.parameters("model").unwrap();
        *parameters.density.last_mut().unwrap() = 0.0;
        question.set_model(&parameters).unwrap();
    };
    let failed = failures(&vectors, Precision::F32, Format::F32, without_the_last);
    for word in ["reordered", "linear", "split", "adjoint"] {
        let of = |case: &&crate::Case| case.flags.iter().any(|flag| flag == word);
        let mut cases = vectors.manifest.cases.iter().filter(of);
        assert!(cases.any(|case| failed.iter().any(|failed| failed.contains(&case.id))), "{word}: {failed:?}");
    }
    let turned = |question: &mut crate::Question| {
        let angles: Vec<f64> = question.angles().unwrap_or_default().iter().map(|angle| -angle).collect();
        question.settings.insert("angles".into(), json!(angles));
    };
    let images = make(&["image-exact".into()], 7, 6, Level::Core, Ask::Relations).unwrap();
    let failed = failures(&images, Precision::F64, Format::F64, turned);
    let rotated = images.manifest.cases.iter().filter(|case| case.flags.contains(&"rotated".to_owned()));
    let rotated: Vec<&str> = rotated.map(|case| case.id.as_str()).collect();
    assert!(
        !failed.is_empty() && failed.iter().all(|failed| rotated.iter().any(|id| failed.contains(id))),
        "{failed:?}"
    );
}

#[test]
fn questions_without_an_answer_are_refused_and_others_are_not() {
    let stages: Vec<String> = Ask::Refusals.stages().iter().map(|s| (*s).into()).collect();
    let vectors = make(&stages, 7, 100, Level::Core, Ask::Refusals).unwrap();
    assert!(vectors.manifest.cases.len() >= 40);
    assert_eq!(failures(&vectors, Precision::F64, Format::F64, |_| {}), Vec::<String>::new());
    for stage in &stages {
        let cases = vectors.manifest.cases.iter().filter(|case| case.stage == *stage);
        assert!(
            cases.flat_map(|case| &case.flags).any(|flag| flag == "finite"),
            "{stage}: who answers nothing is seen"
        );
    }
    let of = |word: &str, finite| refusals::fault(&[word.to_owned()], finite).is_some();
    let outcomes = [Some(true), Some(false), None];
    assert_eq!(outcomes.map(|finite| of("refuse", finite)), [true, false, false]);
    assert_eq!(outcomes.map(|finite| of("finite", finite)), [false, true, true]);
    assert_eq!(outcomes.map(|finite| of("either", finite)), [false, true, false]);
}

/// The plain equations share no code with the truth.
#[test]
fn the_stated_error_of_the_truth_covers_the_plain_equations() {
    use trgs_core::projector::naive;
    for stage in ["image-exact", "image-affine", "density"] {
        for draft in Ask::Values.drafts(stage, 3, 0, 16, Level::Core).0 {
            let (truth, allowance) = truth::truth(&draft, Format::F64).unwrap();
            let q = draft.question().unwrap();
            let (primitives, scanner) = (q.primitives().unwrap(), q.scanner().unwrap());
            let (role, plain) = if stage == "density" {
                ("volume", naive::voxelize(&primitives, &scanner.grid, 0.0))
            } else {
                let angles = q.angles().unwrap();
                ("image", naive::forward(&primitives, &scanner, &angles, q.projection().unwrap(), 0.0))
            };
            for ((truth, allowed), plain) in truth[role][""].iter().zip(&allowance[role][""]).zip(&plain) {
                assert!((truth - plain).abs() <= 4.0 * allowed, "{}: {truth} {plain} {allowed}", draft.id);
            }
        }
    }
}

/// An answer to question `index` of level `large` with a change, judged in double precision: status, place and name.
fn judged(
    (stage, index): (&str, u64),
    change: impl Fn(&mut crate::Question),
    wrong: impl Fn(&mut ndarray::ArrayD<f64>),
) -> String {
    let vectors = draft::vectors(&Ask::Values.drafts(stage, 7, index, 1, Level::Large).0, &[]);
    let folder = tempfile::tempdir().unwrap();
    let vectors = with_truth(vectors, Format::F64, folder.path()).unwrap();
    let case = &vectors.manifest.cases[0];
    let mut question = crate::Question::new(&vectors, case).unwrap();
    change(&mut question);
    let mut outputs = answers::answer(&question, Precision::F64).unwrap();
    wrong(outputs.values_mut().next().unwrap().values_mut().next().unwrap());
    answers::write(folder.path(), case, &outputs).unwrap();
    let (format, level, today) = (Format::F64, Level::Large, waivers::today());
    let options = Options { format, level, stages: &[], waivers: &[], today, commit: None };
    let report = check(&vectors, &Tolerances::of(&vectors).unwrap(), folder.path(), &options).unwrap();
    let part = &report.results[0].parts[0];
    format!("{:?} {:?} {:?}", part.status, part.place, part.looks_like)
}

#[test]
fn pixels_and_primitives_beyond_a_block_are_seen_in_large_scenes() {
    let drop = |image: &mut ndarray::ArrayD<f64>| {
        image.indexed_iter_mut().filter(|(index, _)| index[2] >= 16).for_each(|(_, x)| *x = 0.0);
    };
    for index in [0, 4] {
        let found = judged(("image-affine", index), |_| {}, drop);
        assert!(found.starts_with("Failed") && found.contains("columns 16-"), "{found}");
    }
    let tail = |question: &mut crate::Question| {
        let mut parameters = question.parameters("model").unwrap();
        let count = parameters.len();
        parameters.density[count - count % 32..].fill(0.0);
        question.set_model(&parameters).unwrap();
    };
    let found = judged(("density", 4), tail, |_| {});
    assert!(found.contains("those beyond a whole number of blocks"), "{found}");
    let kept = judged(("density", 4), |_| {}, |_| {});
    assert!(kept.starts_with("Passed"), "{kept}");
}

#[test]
fn one_output_that_is_refused_refuses_the_question() {
    let vectors = make(&["integral-factor".into()], 7, 1, Level::Core, Ask::Refusals).unwrap();
    let (format, level, today) = (Format::F64, Level::Core, waivers::today());
    let options = Options { format, level, stages: &[], waivers: &[], today, commit: None };
    for (factor, status) in [(f64::NAN, Status::Passed), (1.0, Status::Failed)] {
        let folder = tempfile::tempdir().unwrap();
        let array = |x: f64| crate::manifest::Arrays::from([(String::new(), ndarray::arr1(&[x]).into_dyn())]);
        let outputs = [("factor".to_owned(), array(factor)), ("slope".to_owned(), array(1.0))].into();
        answers::write(folder.path(), &vectors.manifest.cases[0], &outputs).unwrap();
        let report = check(&vectors, &Tolerances::of(&vectors).unwrap(), folder.path(), &options).unwrap();
        assert_eq!(report.results[0].status, status);
    }
}

/// What cancels in right answers has an allowance: the slope to the quaternion of a ball, and variances of constant images.
#[test]
fn what_cancels_is_allowed_where_no_change_of_the_inputs_shows_it() {
    let made = |stage: &str| Ask::Values.drafts(stage, 1, 0, 1, Level::Core).0.remove(0);
    let allowed = |draft: &Draft, role: &str, name: &str| {
        let (_, allowance) = truth::truth(draft, Format::F32).unwrap();
        allowance[role][name].iter().fold(0.0_f64, |most, x| most.max(*x))
    };
    let mut ball = made("gradient-density");
    ball.arrays.get_mut("cotangent").unwrap().get_mut("").unwrap().mapv_inplace(f64::abs);
    ball.arrays.get_mut("model").unwrap().get_mut("scale").unwrap().mapv_inplace(|_| 0.5);
    let (truth, _) = truth::truth(&ball, Format::F32).unwrap();
    let slope = truth["grad"]["scale"].iter().fold(0.0_f64, |most, x| most.max(x.abs()));
    let norm = ball.arrays["model"]["quaternion"].iter().map(|x| x * x).sum::<f64>().sqrt();
    assert!(allowed(&ball, "grad", "quaternion") > Format::F32.ulp(slope / norm));
    // The power of a kernel is flushed to 0 before it is multiplied with its density.
    let mut far = made("density");
    far.arrays.get_mut("model").unwrap().get_mut("scale").unwrap().mapv_inplace(|_| 1e-3);
    let densities = far.arrays["model"]["density"].sum();
    let (_, allowance) = truth::truth(&far, Format::F32).unwrap();
    let least = allowance["volume"][""].iter().fold(f64::INFINITY, |least, x| least.min(*x));
    assert!(least >= densities * Format::F32.smallest_normal());
    let mut flat = made("loss-ssim");
    let changing = allowed(&flat, "value", "");
    ["prediction", "target"].iter().for_each(|role| flat.arrays.get_mut(*role).unwrap().get_mut("").unwrap().fill(0.5));
    assert!(allowed(&flat, "value", "") > changing);
}
