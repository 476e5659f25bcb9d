//! `trgs oracle`: conformance vectors for other implementations.

use super::arguments::{choice, word};
use super::{Answer, interrupt};
use clap::{Args, Subcommand};
use serde::Serialize;
use serde_json::json;
use std::path::{Path, PathBuf};
use trgs::Result;
use trgs::config::Precision;
use trgs::oracle::check::{check, select};
use trgs::oracle::{Format, Level, Options, Question, Tolerances, Vectors, answers, report, waivers};
use trgs::output::stage_folder;

/// Learn whether an implementation's values, gradients and steps are right
#[derive(Args)]
#[command(after_help = "Example:
  trgs oracle export vectors --blind         inputs and manifest.json
  my-backend vectors answers                 writes its outputs under the names in the manifest
  trgs oracle check answers --precision f32 --level core --report conformance.json")]
pub(super) struct Oracle {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    List(List),
    Export(Export),
    Answer(AnswerArgs),
    Check(Check),
}

/// Which cases.
#[derive(Args)]
struct Selection {
    /// The most that is asked: core, or also optional, or also stress
    #[arg(long, default_value = "stress", value_parser = choice(&Level::ALL))]
    level: Level,
    /// Only these stages
    #[arg(long, value_name = "STAGE,..", value_delimiter = ',')]
    stage: Vec<String>,
    /// Vectors in a folder, in the place of the built-in ones
    #[arg(long, value_name = "DIR")]
    vectors: Option<PathBuf>,
}

/// Show the cases: what each asks, how much, and what is special about it
#[derive(Args)]
#[command(after_help = "Example:\n  trgs oracle list --stage image-exact --level core")]
struct List {
    #[command(flatten)]
    selection: Selection,
}

/// Write manifest and inputs for a backend, and the truth to DIR/expected
#[derive(Args)]
#[command(after_help = "Example:\n  trgs oracle export vectors --blind --level core")]
struct Export {
    /// Folder to make
    #[arg(value_name = "DIR")]
    folder: PathBuf,
    /// Without the truth
    #[arg(long)]
    blind: bool,
    #[command(flatten)]
    selection: Selection,
}

/// Write this program's own answers, as a backend would
#[derive(Args)]
#[command(after_help = "Example:\n  trgs oracle answer own --precision f32 && trgs oracle check own --precision f32")]
struct AnswerArgs {
    /// Folder to make
    #[arg(value_name = "DIR")]
    folder: PathBuf,
    /// Arithmetic
    #[arg(long, default_value = "f64", value_parser = choice(&Precision::ALL))]
    precision: Precision,
    #[command(flatten)]
    selection: Selection,
}

/// Compare a backend's answers with the truth; exit code 1 if one is wrong or missing
#[derive(Args)]
#[command(after_help = "Example:
  trgs oracle check answers --precision f32 --level core --report conformance.json --waivers waivers.toml

A waiver excuses a case for a while:
  [[waiver]]
  case = \"image-exact/needle\"
  reason = \"set-up in single precision\"
  expires = 2027-06-30")]
struct Check {
    /// Folder of answers, named as in the manifest; backend.json in it may tell name, version, device
    #[arg(value_name = "DIR")]
    folder: PathBuf,
    /// The backend's arithmetic: which tolerances count, and what an ulp is
    #[arg(long, default_value = "f32", value_parser = choice(&Format::ALL))]
    precision: Format,
    /// Also write the report: FILE.json, FILE.md and, for build servers, FILE.xml (JUnit)
    #[arg(long, value_name = "FILE.json")]
    report: Option<PathBuf>,
    /// Failures that are excused
    #[arg(long, value_name = "FILE.toml")]
    waivers: Option<PathBuf>,
    #[command(flatten)]
    selection: Selection,
}

impl Oracle {
    pub(super) fn run(&self) -> Result<Answer> {
        match &self.command {
            Command::List(command) => command.run(),
            Command::Export(command) => command.run(),
            Command::Answer(command) => command.run(),
            Command::Check(command) => command.run(),
        }
    }
}

impl Selection {
    fn vectors(&self) -> Result<Vectors> {
        self.vectors.as_deref().map_or_else(Vectors::embedded, Vectors::open)
    }
}

impl List {
    fn run(&self) -> Result<Answer> {
        let vectors = self.selection.vectors()?;
        let cases = select(&vectors, self.selection.level, &self.selection.stage)?;
        let rows = cases.iter().map(|case| {
            [case.id.clone(), word(&case.level), case.equations.join(", "), case.flags.join(" "), case.title.clone()]
        });
        let result = json!({ "flags": vectors.manifest.flags, "cases": cases });
        Ok(Answer::table(&result, ["case", "level", "equations", "flags", ""], rows))
    }
}

/// What was written.
#[derive(Serialize)]
struct Written<'a> {
    folder: &'a Path,
    cases: usize,
    files: usize,
}

impl Export {
    fn run(&self) -> Result<Answer> {
        let vectors = self.selection.vectors()?;
        let cases = select(&vectors, self.selection.level, &self.selection.stage)?;
        let files = interrupt::shielded(|| vectors.export(&self.folder, self.blind, &cases))?;
        Ok(Answer::list(&Written { folder: &self.folder, cases: cases.len(), files: files + 1 }))
    }
}

impl AnswerArgs {
    fn run(&self) -> Result<Answer> {
        let vectors = self.selection.vectors()?;
        let cases = select(&vectors, self.selection.level, &self.selection.stage)?;
        let staged = stage_folder(&self.folder)?;
        let mut files = 0;
        for case in &cases {
            let question = Question::new(&vectors, case)?;
            let outputs = answers::answer(&question, self.precision)?;
            answers::write(staged.path(), case, &outputs)?;
            files += case.outputs.len();
        }
        interrupt::shielded(|| staged.commit())?;
        Ok(Answer::list(&Written { folder: &self.folder, cases: cases.len(), files }))
    }
}

impl Check {
    fn run(&self) -> Result<Answer> {
        let vectors = self.selection.vectors()?;
        let waivers = match &self.waivers {
            Some(path) => waivers::read(path, &vectors.manifest.cases)?,
            None => Vec::new(),
        };
        let options = Options {
            format: self.precision,
            level: self.selection.level,
            stages: &self.selection.stage,
            waivers: &waivers,
            today: waivers::today(),
        };
        let report = check(&vectors, &Tolerances::embedded()?, &self.folder, &options)?;
        if let Some(path) = &self.report {
            interrupt::shielded(|| report::write(&report, path))?;
        }
        Ok(Answer::verdict(&report, report::markdown(&report), report.passed()))
    }
}
