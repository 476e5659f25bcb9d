//! `trgs oracle make`, `hunt` and `replay`: generated questions.

use super::{Written, interrupt, moved};
use crate::cli::Output;
use crate::cli::arguments::{Replace, choice, positive, seed};
use clap::Args;
use serde::Serialize;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::Duration;
use trgs::oracle::check::{CaseResult, Status};
use trgs::oracle::fresh::{self, Ask};
use trgs::oracle::hunt::{self, Finding};
use trgs::oracle::{Format, Level, Vectors};
use trgs::output::{Destination, Kind};
use trgs::{Error, Result};

/// Write generated questions for a backend; `oracle check` computes their truth
#[derive(Args)]
#[command(after_help = "Example:
  trgs oracle make questions --stage image-exact --seed 7 --count 100
  my-backend questions answers
  trgs oracle check answers --vectors questions --level stress")]
pub(super) struct Make {
    /// Folder to write; older vectors in it are replaced
    #[arg(value_name = "DIR")]
    folder: PathBuf,
    /// Questions of each stage
    #[arg(long, default_value_t = 100, value_parser = positive)]
    count: usize,
    #[command(flatten)]
    range: Range,
    #[command(flatten)]
    replace: Replace,
}

/// The questions to generate.
#[derive(Args)]
struct Range {
    /// Stages to ask; all for which questions are generated if absent
    #[arg(long, value_name = "STAGE,..", value_delimiter = ',')]
    stage: Vec<String>,
    /// Seed of the questions
    #[arg(long, value_name = "N", default_value_t = 0, value_parser = seed)]
    seed: u64,
    /// How demanding the questions are
    #[arg(long, default_value = "core", value_parser = choice(&Level::ALL))]
    level: Level,
    /// What the questions ask for
    #[arg(long, default_value = "values", value_parser = choice(&Ask::ALL))]
    ask: Ask,
}

/// Ask a backend generated questions until it fails, and shrink each failure; exit with code 1 if there is one
///
/// COMMAND is started once for each batch, with two more arguments: the folder of the questions, and the folder for its
/// answers. A hunt that was stopped goes on when it is started again.
#[derive(Args)]
#[command(after_help = "Example:
  trgs oracle hunt --stage image-exact --out found -- python3 my-backend.py
  trgs oracle replay found/image-exact-3 -- python3 my-backend.py")]
pub(super) struct Hunt {
    #[command(flatten)]
    range: Range,
    /// Questions of each stage
    #[arg(long, value_name = "K", default_value_t = 1000, value_parser = positive)]
    cases: usize,
    /// Stop after this time
    #[arg(long, value_name = "T", value_parser = positive)]
    seconds: Option<usize>,
    /// Arithmetic of the backend
    #[arg(long, default_value = "f32", value_parser = choice(&Format::ALL))]
    precision: Format,
    /// Folder for the shrunk questions and hunt.json: new, empty, or of the same hunt
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// The backend's program and its arguments
    #[arg(last = true, required = true, value_name = "COMMAND")]
    command: Vec<String>,
}

/// Ask a backend the questions of a folder again, such as a shrunk one; exit with code 1 if an answer is wrong
#[derive(Args)]
#[command(after_help = "Example:\n  trgs oracle replay found/image-exact-3 -- python3 my-backend.py")]
pub(super) struct Replay {
    /// Folder of generated questions
    #[arg(value_name = "CASE")]
    folder: PathBuf,
    /// Arithmetic of the backend [default: as in the hunt that wrote the question, otherwise f32]
    #[arg(long, value_parser = choice(&Format::ALL))]
    precision: Option<Format>,
    /// The backend's program and its arguments
    #[arg(last = true, required = true, value_name = "COMMAND")]
    command: Vec<String>,
}

impl Range {
    fn stages(&self) -> Vec<String> {
        let all = self.ask.stages().into_iter().map(str::to_owned);
        if self.stage.is_empty() { all.collect() } else { self.stage.clone() }
    }
}

impl Make {
    pub(super) fn run(&self) -> Result<Output> {
        let Range { seed, level, ask, .. } = self.range;
        let vectors = fresh::make(&self.range.stages(), seed, self.count, level, ask)?;
        let cases: Vec<_> = vectors.manifest.cases.iter().collect();
        let destination =
            Destination::new(&self.folder, Kind::Vectors, "oracle make").overwrite(self.replace.overwrite);
        let files = interrupt::shielded(|| vectors.export(destination.clone(), true, &cases))?;
        moved(&destination);
        Ok(Output::list(&Written { folder: &self.folder, cases: cases.len(), files: files + 2 }))
    }
}

impl Hunt {
    pub(super) fn run(&self) -> Result<Output> {
        let settings = hunt::Settings {
            stages: self.range.stages(),
            seed: self.range.seed,
            cases: self.cases,
            precision: self.precision,
            level: self.range.level,
            ask: self.range.ask,
        };
        let mut hunt = hunt::Hunt::open(&self.out, settings)?;
        let limit = self.seconds.map(|seconds| Duration::from_secs(seconds as u64));
        hunt.run(&self.out, limit, &mut |_, questions, answers| start(&self.command, questions, answers))?;
        let asked: usize = hunt.asked.values().map(|(asked, _)| asked).sum();
        let mut sentences =
            vec![format!("{asked} questions asked, {} of {} stages failed", hunt.findings.len(), hunt.asked.len())];
        if !hunt.unanswered.is_empty() {
            sentences.push(format!("no answers to {}", hunt.unanswered.join(", ")));
        }
        let row = |finding: &Finding| {
            let size = format!("{} × {}", finding.primitives, finding.elements);
            let folder = self.out.join(&finding.case).display().to_string();
            let place = finding.place.as_ref().map(|place| format!("wrong at {place}"));
            let looks_like = finding.looks_like.clone().or(place).unwrap_or_default();
            [finding.stage.clone(), looks_like, finding.error.clone(), size, folder]
        };
        let rows = hunt.findings.iter().map(row);
        let header = ["stage", "looks like", "shrunk question", "primitives × elements", "folder"];
        Ok(Output::judgement(&hunt, &sentences, header, rows, hunt.findings.is_empty()))
    }
}

/// The results of a replay.
#[derive(Serialize)]
struct Replayed {
    precision: Format,
    results: Vec<CaseResult>,
}

impl Replay {
    pub(super) fn run(&self) -> Result<Output> {
        let vectors = Vectors::open(&self.folder)?;
        if !fresh::is_generated(&vectors) {
            let remedy = "name a folder of `trgs oracle hunt` or `make`, or use `trgs oracle check`";
            return Err(Error::invalid("CASE", "other vectors", "generated questions", remedy));
        }
        let precision = self.precision.or_else(|| hunt::precision(&vectors)).unwrap_or(Format::F32);
        let results =
            hunt::replay(&vectors, precision, &mut |_, questions, answers| start(&self.command, questions, answers))?;
        let approves = results.iter().all(|result| result.status <= Status::Waived);
        let rows: Vec<_> = results
            .iter()
            .map(|result| {
                let name = result.parts.iter().find_map(|part| part.looks_like.clone()).unwrap_or_default();
                [result.id.clone(), super::word(&result.status), name, hunt::describe(result)]
            })
            .collect();
        let sentences = [format!("{} in {precision}", if approves { "passed" } else { "FAILED" })];
        let replayed = Replayed { precision, results };
        Ok(Output::judgement(&replayed, &sentences, ["case", "status", "looks like", "largest error"], rows, approves))
    }
}

/// Starts the backend for one batch; returns why it ended, if it did not succeed.
fn start(command: &[String], questions: &Path, answers: &Path) -> Result<Option<String>> {
    let program = Path::new(&command[0]);
    let mut started = Command::new(program);
    started.args(&command[1..]).arg(questions).arg(answers).stdin(Stdio::null()).envs(hunt::environment(questions)?);
    let output = started.output().map_err(|source| Error::read(program, source))?;
    if output.status.success() {
        return Ok(None);
    }
    let text = String::from_utf8_lossy(&output.stderr);
    let last = text.lines().rev().find(|line| !line.trim().is_empty()).unwrap_or("no message");
    Ok(Some(format!("the backend ended with {}: {last}", output.status)))
}
