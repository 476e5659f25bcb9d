use super::*;
use crate::answers;
use crate::check::{Options, Status, check};
use crate::limits::Tolerances;
use crate::waivers;
use trgs_core::numeric::Precision;

fn all_stages() -> Vec<String> {
    STAGES.map(String::from).into()
}

/// The failures of this program's own answers.
fn failures(vectors: &Vectors, precision: Precision, format: Format) -> Vec<String> {
    let folder = tempfile::tempdir().unwrap();
    for case in &vectors.manifest.cases {
        let question = crate::Question::new(vectors, case).unwrap();
        answers::write(folder.path(), case, &answers::answer(&question, precision).unwrap()).unwrap();
    }
    let options =
        Options { format, level: Level::Stress, stages: &[], waivers: &[], today: waivers::today(), commit: None };
    let tolerances = Tolerances::of(vectors).unwrap();
    let report = check(vectors, &tolerances, folder.path(), &options).unwrap();
    report.results.iter().filter(|result| result.status != Status::Passed).map(|result| format!("{result:?}")).collect()
}

#[test]
fn questions_are_those_of_their_seed() {
    let one = |seed| make(&all_stages(), seed, 3, Level::Stress).unwrap();
    assert_eq!(one(1).digest, one(1).digest);
    assert_ne!(one(1).digest, one(2).digest);
    let some = make(&["kernel".into()], 1, 2, Level::Core).unwrap();
    let more = make(&["kernel".into()], 1, 5, Level::Core).unwrap();
    assert_eq!(some.manifest.cases[..], more.manifest.cases[..2]);
    assert!(make(&["kernels".into()], 1, 2, Level::Core).unwrap_err().to_string().contains("covariance, kernel"));
}

#[test]
fn the_own_answers_pass_in_both_precisions() {
    let vectors = make(&all_stages(), 7, 4, Level::Stress).unwrap();
    for (precision, format) in [(Precision::F64, Format::F64), (Precision::F32, Format::F32)] {
        let vectors = with_truth(vectors.clone(), format).unwrap();
        assert_eq!(failures(&vectors, precision, format), Vec::<String>::new());
    }
    let images = make(&["image-exact".into()], 7, 4, Level::Core).unwrap();
    assert_eq!(failures(&with_truth(images, Format::F64).unwrap(), Precision::F32, Format::F64).len(), 4);
}

/// The plain equations share no code with the truth.
#[test]
fn the_stated_error_of_the_truth_covers_the_plain_equations() {
    use trgs_core::projector::naive;
    for stage in ["image-exact", "image-affine", "density"] {
        for draft in drafts(stage, 3, 0, 16, Level::Core).0 {
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
    let vectors = draft::vectors(&drafts(stage, 7, index, 1, Level::Large).0, &[]);
    let (vectors, folder) = (with_truth(vectors, Format::F64).unwrap(), tempfile::tempdir().unwrap());
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
