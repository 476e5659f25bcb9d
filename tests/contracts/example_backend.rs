//! A NumPy backend passes the blind export, answers and the check.
//!
//! Then one deliberate bug after another is inserted; the report must catch and name each.
//!
//! Needs Python with NumPy: `python3`, or the program named by `TRGS_PYTHON`. Without it the tests are skipped with a
//! message; a CI server must have it.

use crate::common::vectors::vectors;
use std::collections::BTreeMap;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::Command;
use trgs::oracle::check::Status;
use trgs::oracle::{Format, Level, Options, Report, Tolerances, check, report, waivers};

fn folder() -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("reference/example_backend")
}

/// A Python with NumPy, or `None` with a message.
fn python() -> Option<String> {
    let program = std::env::var("TRGS_PYTHON").unwrap_or_else(|_| "python3".into());
    let found = Command::new(&program).args(["-c", "import numpy"]).output().is_ok_and(|out| out.status.success());
    if found {
        return Some(program);
    }
    assert!(std::env::var_os("CI").is_none(), "{program} has no NumPy; set TRGS_PYTHON");
    let remark = format!("SKIPPED: {program} has no NumPy; set TRGS_PYTHON to a Python that has it\n");
    std::io::stderr().write_all(remark.as_bytes()).unwrap();
    None
}

/// Exports the questions up to a level, without answers.
fn export(into: &Path, level: Level) {
    let vectors = vectors();
    let cases: Vec<_> = vectors.manifest.cases.iter().filter(|case| case.level <= level).collect();
    vectors.export(into, true, &cases).unwrap();
}

fn run(python: &str, backend: &Path, questions: &Path, answers: &Path) {
    let output = Command::new(python).arg(backend).arg(questions).arg(answers).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
}

fn judge(answers: &Path, level: Level, stages: &[String]) -> Report {
    let options = Options { format: Format::F64, level, stages, waivers: &[], today: waivers::today() };
    check(&vectors(), &Tolerances::embedded().unwrap(), answers, &options).unwrap()
}

#[test]
fn the_example_backend_is_short_and_passes_core() {
    let text = std::fs::read_to_string(folder().join("backend.py")).unwrap();
    assert!(text.lines().count() < 120, "{} lines", text.lines().count());
    let Some(python) = python() else { return };
    let scratch = tempfile::tempdir().unwrap();
    let (questions, answers) = (scratch.path().join("vectors"), scratch.path().join("answers"));
    export(&questions, Level::Core);
    run(&python, &folder().join("backend.py"), &questions, &answers);
    let report = judge(&answers, Level::Core, &[]);
    println!("{}", report::markdown(&report));
    assert!(report.passed(), "{}", report::markdown(&report));
    assert_eq!(report.count(Status::Passed), report.results.len());
}

#[derive(serde::Deserialize)]
struct Mutation {
    name: String,
    find: String,
    replace: String,
    stage: String,
    named: String,
}

#[test]
fn every_deliberate_bug_is_caught_and_named() {
    let text = std::fs::read_to_string(folder().join("backend.py")).unwrap();
    let mutations = std::fs::read(folder().join("mutations.json")).unwrap();
    let mutations: Vec<Mutation> = serde_json::from_slice(&mutations).unwrap();
    assert!(mutations.len() >= 8, "{} mutations", mutations.len());
    for mutation in &mutations {
        assert_eq!(text.matches(&mutation.find).count(), 1, "{}: its text must occur once", mutation.name);
    }
    let Some(python) = python() else { return };
    let scratch = tempfile::tempdir().unwrap();
    let questions = scratch.path().join("vectors");
    // A power of 1 + x instead of log1p is visible only in double precision at ν = 1e6, a case above level core.
    export(&questions, Level::Optional);
    let mut missed = Vec::new();
    for mutation in &mutations {
        let (backend, answers) = (scratch.path().join("mutated.py"), scratch.path().join(&mutation.name));
        std::fs::write(&backend, text.replace(&mutation.find, &mutation.replace)).unwrap();
        run(&python, &backend, &questions, &answers);
        let report = judge(&answers, Level::Optional, std::slice::from_ref(&mutation.stage));
        let failed = report.results.iter().filter(|r| r.stage == mutation.stage && r.status == Status::Failed);
        let mut names: BTreeMap<&str, usize> = BTreeMap::new();
        for part in failed.clone().flat_map(|r| &r.parts).filter(|part| part.status == Status::Failed) {
            *names.entry(part.looks_like.as_deref().unwrap_or("no name")).or_default() += 1;
        }
        println!("{:32} {} cases of {} failed: {names:?}", mutation.name, failed.count(), mutation.stage);
        let most = names.iter().filter(|(name, _)| **name != "no name").max_by_key(|(_, count)| **count);
        if !most.is_some_and(|(name, _)| name.contains(&mutation.named)) {
            missed.push(format!("{}: {names:?} for {:?}", mutation.name, mutation.named));
        }
    }
    assert!(missed.is_empty(), "{}", missed.join("\n"));
}
