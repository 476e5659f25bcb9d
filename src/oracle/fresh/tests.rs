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
