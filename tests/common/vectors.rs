//! This program's answers to the conformance vectors.
//!
//! The 50-digit truth was made by `reference/generate`, independently of this code. Tolerances are those of every
//! backend: `reference/tolerances.toml`.

use std::path::{Path, PathBuf};
use trgs::config::Precision;
use trgs::oracle::{Case, Format, Level, Options, Question, Report, Tolerances, Vectors, answers, check, waivers};

/// The vectors of the source tree.
pub(crate) fn vectors() -> Vectors {
    Vectors::open(PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("reference/vectors")).unwrap()
}

/// Writes this program's answers to the wanted cases.
pub(crate) fn answer(vectors: &Vectors, precision: Precision, folder: &Path, wanted: impl Fn(&Case) -> bool) {
    for case in vectors.manifest.cases.iter().filter(|case| wanted(case)) {
        let outputs = answers::answer(&Question::new(vectors, case).unwrap(), precision);
        answers::write(folder, case, &outputs.unwrap_or_else(|error| panic!("{}: {error}", case.id))).unwrap();
    }
}

/// Checks a folder of answers to some stages (all if empty), without waivers.
pub(crate) fn judge(vectors: &Vectors, folder: &Path, format: Format, stages: &[String]) -> Report {
    let options = Options { format, level: Level::Stress, stages, waivers: &[], today: waivers::today(), commit: None };
    check(vectors, &Tolerances::embedded().unwrap(), folder, &options).unwrap()
}

/// Asserts that this program's answers to the wanted cases pass as `format`; prints the worst errors.
pub(crate) fn assert_conformance(precision: Precision, format: Format, wanted: impl Fn(&Case) -> bool) {
    let (vectors, folder) = (vectors(), tempfile::tempdir().unwrap());
    answer(&vectors, precision, folder.path(), &wanted);
    let cases = || vectors.manifest.cases.iter().filter(|case| wanted(case));
    let mut stages: Vec<String> = cases().map(|case| case.stage.clone()).collect();
    stages.dedup();
    assert!(!stages.is_empty());
    let report = judge(&vectors, folder.path(), format, &stages);
    println!("{}", trgs::oracle::report::markdown(&report));
    assert_eq!(report.results.len(), cases().count());
    assert!(report.passed(), "{}", trgs::oracle::report::markdown(&report));
}
