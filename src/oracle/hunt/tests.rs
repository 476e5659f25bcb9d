use super::*;
use crate::answers::{self, answer};
use crate::question::Question;
use trgs_core::numeric::Precision;

fn settings(stage: &str, cases: usize) -> Settings {
    Settings {
        stages: vec![stage.into()],
        seed: 5,
        cases,
        precision: Format::F64,
        level: Level::Core,
        ask: Ask::Values,
    }
}

/// Answers with this program, with a change of each question and of each answer.
fn backend(
    change: impl Fn(&mut Question) + 'static,
    wrong: impl Fn(&Question, &mut Outputs) + 'static,
) -> Box<Backend<'static>> {
    Box::new(move |vectors, _, folder| {
        for case in &vectors.manifest.cases {
            let mut question = Question::new(vectors, case)?;
            change(&mut question);
            let mut outputs = answer(&question, Precision::F64)?;
            wrong(&question, &mut outputs);
            answers::write(folder, case, &outputs)?;
        }
        Ok(None)
    })
}

fn half_a_pixel() -> Box<Backend<'static>> {
    backend(
        |question| {
            let detector = &mut question.scanner.as_mut().unwrap().detector;
            detector.offset_u -= 0.5 * detector.pitch_u;
        },
        |_, _| {},
    )
}

fn hunted(folder: &Path, settings: &Settings, backend: &mut Backend<'_>) -> Hunt {
    let mut hunt = Hunt::open(folder, settings.clone()).unwrap();
    hunt.run(folder, None, backend).unwrap();
    hunt
}

#[test]
fn a_mistake_is_found_named_and_shrunk_to_a_question_that_is_replayed() {
    let folder = tempfile::tempdir().unwrap();
    let hunt = hunted(folder.path(), &settings("image-exact", 100), &mut *half_a_pixel());
    let [finding] = &hunt.findings[..] else { panic!("{hunt:?}") };
    assert_eq!((finding.primitives, finding.elements), (1, 1), "{finding:?}");
    assert_eq!(finding.looks_like.as_deref(), Some("a half-pixel shift in u towards higher columns"));
    let case = Vectors::open(folder.path().join(&finding.case)).unwrap();
    assert_eq!(precision(&case), Some(Format::F64));
    let status = |backend: &mut Backend<'_>| replay(&case, Format::F64, backend).unwrap()[0].status;
    assert_eq!(status(&mut *half_a_pixel()), Status::Failed);
    assert_eq!(status(&mut *backend(|_| {}, |_, _| {})), Status::Passed);
}

#[test]
fn right_answers_are_not_accused_and_a_stage_without_answers_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let hunt = hunted(folder.path(), &settings("gradient-density", 30), &mut *backend(|_| {}, |_, _| {}));
    assert_eq!((hunt.findings.len(), hunt.asked["gradient-density"].0), (0, 30));
    let folder = tempfile::tempdir().unwrap();
    let hunt = hunted(folder.path(), &settings("kernel", 30), &mut |_, _, _| Ok(None));
    assert_eq!((&hunt.unanswered[..], hunt.findings.len()), (&["kernel".to_owned()][..], 0));
}

#[test]
fn a_hunt_that_was_stopped_ends_as_one_that_was_not() {
    let wrong = |question: &Question, outputs: &mut Outputs| {
        if question.numbers("nu").unwrap()[0] < 3.0 {
            outputs.get_mut("kernel").unwrap().get_mut("").unwrap()[[0]] += 1.0;
        }
    };
    let settings = Settings { seed: 6, ..settings("kernel", 300) };
    let (whole, parts) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    let one = hunted(whole.path(), &settings, &mut *backend(|_| {}, wrong));
    assert_eq!((one.findings.len(), one.findings[0].elements), (1, 1), "{one:?}");
    let mut other = Hunt::open(parts.path(), settings.clone()).unwrap();
    let mut batches = 0;
    let mut right = backend(|_| {}, wrong);
    let stopped = other.run(parts.path(), None, &mut |vectors, questions, answers| {
        batches += 1;
        let stop = Error::Interrupted { step: 0, remedy: "again".into() };
        if batches > 1 { Err(stop) } else { right(vectors, questions, answers) }
    });
    assert!(stopped.is_err(), "the hunt was stopped while it shrank");
    assert_eq!(hunted(parts.path(), &settings, &mut *right), one);
    let other = Settings { seed: 7, ..settings };
    assert!(Hunt::open(parts.path(), other).unwrap_err().to_string().contains("other settings"));
}

#[test]
fn a_question_that_ends_the_backend_is_found_among_the_others() {
    let folder = tempfile::tempdir().unwrap();
    let mut right = backend(|_| {}, |_, _| {});
    let hunt = hunted(folder.path(), &settings("covariance", 60), &mut |vectors, questions, answers| {
        for case in &vectors.manifest.cases {
            if Question::new(vectors, case)?.primitives()?.len() == 3 {
                return Ok(Some("the backend ended with exit status: 1: three".into()));
            }
        }
        right(vectors, questions, answers)
    });
    assert_eq!(hunt.findings[0].primitives, 3);
    assert!(hunt.findings[0].error.contains("exit status: 1: three"), "{hunt:?}");
}

#[test]
fn a_backend_that_says_it_is_deterministic_is_asked_twice() {
    let folder = tempfile::tempdir().unwrap();
    let mut asked = 0.0;
    let hunt = hunted(folder.path(), &settings("covariance", 6), &mut |vectors, _, answers| {
        asked += 1.0;
        for case in &vectors.manifest.cases {
            let mut outputs = answer(&Question::new(vectors, case)?, Precision::F64)?;
            outputs.get_mut("covariance").unwrap().get_mut("").unwrap().mapv_inplace(|x| x * (1.0 + asked * 1e-15));
            answers::write(answers, case, &outputs)?;
        }
        std::fs::write(answers.join("backend.json"), r#"{"deterministic": true}"#).unwrap();
        Ok(None)
    });
    assert!(hunt.findings[0].error.contains("asked again"), "{hunt:?}");
}

#[test]
fn a_deterministic_backend_with_a_switch_for_threads_is_asked_with_other_numbers_of_them() {
    // A backend whose sums depend on the number of threads, if it is right in all else.
    let hunt = |wrong_with: &'static str, switch: &'static str| {
        let folder = tempfile::tempdir().unwrap();
        let mut asked = Vec::new();
        let mut hunt = Hunt::open(folder.path(), settings("covariance", 6)).unwrap();
        let found = hunt.run(folder.path(), None, &mut |vectors, questions, answers| {
            let variables = environment(questions)?;
            let threads = variables.get(switch).map_or("8", String::as_str);
            asked.push(threads.to_owned());
            for case in &vectors.manifest.cases {
                let mut outputs = answer(&Question::new(vectors, case)?, Precision::F64)?;
                let array = outputs.get_mut("covariance").unwrap().get_mut("").unwrap();
                array.mapv_inplace(|x| if threads == wrong_with { x * (1.0 + 1e-15) } else { x });
                answers::write(answers, case, &outputs)?;
            }
            let about = json!({"deterministic": true, "threads": switch});
            std::fs::write(answers.join("backend.json"), about.to_string()).unwrap();
            Ok(None)
        });
        (found.map(|()| hunt), asked)
    };
    let (right, asked) = hunt("", "OMP_NUM_THREADS");
    assert!(right.unwrap().findings.is_empty() && asked == ["8", "1", "3"], "{asked:?}");
    let (wrong, _) = hunt("3", "OMP_NUM_THREADS");
    assert!(wrong.unwrap().findings[0].error.contains("OMP_NUM_THREADS=3"));
    let (refused, _) = hunt("", "OMP NUM");
    assert!(refused.unwrap_err().to_string().contains("environment variable"));
}

#[test]
fn a_description_names_the_vectors_and_the_stages_that_were_answered() {
    let (vectors, folder) = (Vectors::embedded().unwrap(), tempfile::tempdir().unwrap());
    let exported = folder.path().join("vectors");
    vectors.export(&exported, true, &[&vectors.manifest.cases[0]]).unwrap();
    let opened = Vectors::open(&exported).unwrap();
    assert_eq!((opened.origin(), opened.origin() == opened.digest), (vectors.digest.as_str(), false));
    let options = || {
        let (format, level, today) = (Format::F64, Level::Stress, waivers::today());
        Options { format, level, stages: &[], waivers: &[], today, commit: None }
    };
    let judge = |about: serde_json::Value| {
        std::fs::write(folder.path().join("backend.json"), about.to_string()).unwrap();
        check::check(&vectors, &Tolerances::embedded().unwrap(), folder.path(), &options())
    };
    let report = judge(json!({"vectors": opened.origin(), "stages": ["kernel"]})).unwrap();
    assert!(report.results.iter().all(|result| result.stage == "kernel") && !report.results.is_empty());
    let message = |about| judge(about).unwrap_err().to_string();
    assert!(message(json!({"vectors": "0123"})).contains(&vectors.digest));
    assert!(message(json!({"stages": ["kernels"]})).contains("covariance, kernel"));
}
