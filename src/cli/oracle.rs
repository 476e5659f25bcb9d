//! `trgs oracle`: conformance vectors for other implementations.

mod hunt;
mod trace;

use super::arguments::{Replace, choice, word};
use super::messages::moved;
use super::{Global, Output, interrupt};
use clap::{Args, Subcommand};
use serde::Serialize;
use serde_json::json;
use std::path::{Path, PathBuf};
use trgs::Result;
use trgs::config::Precision;
use trgs::oracle::check::{check, select};
use trgs::oracle::{Format, Level, Options, Question, Tolerances, Vectors, answers, fresh, plain, report, waivers};
use trgs::output::{Destination, Kind, stage_folder};

/// Check values, gradients and optimiser steps of another implementation
#[derive(Args)]
#[command(after_help = "Example:
  trgs oracle export vectors --blind         inputs, manifest.json and PROTOCOL.md: what to compute
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
    Make(hunt::Make),
    Hunt(hunt::Hunt),
    Replay(hunt::Replay),
    Trace(trace::Trace),
}

/// Selection of cases.
#[derive(Args)]
struct Selection {
    /// Highest level of cases to include
    #[arg(long, default_value = "stress", value_parser = choice(&Level::ALL))]
    level: Level,
    #[command(flatten)]
    source: Source,
}

/// The vectors, and stages of them.
#[derive(Args)]
struct Source {
    /// Include only these stages
    #[arg(long, value_name = "STAGE,..", value_delimiter = ',')]
    stage: Vec<String>,
    /// Folder with vectors, instead of the built-in ones
    #[arg(long, value_name = "DIR", env = "TRGS_VECTORS", hide_env_values = true)]
    vectors: Option<PathBuf>,
}

/// List the cases: title, level and special properties
#[derive(Args)]
#[command(after_help = "Example:\n  trgs oracle list --stage image-exact --level core")]
struct List {
    #[command(flatten)]
    selection: Selection,
}

/// Write manifest, inputs and PROTOCOL.md for a backend, and the truth to DIR/expected
#[derive(Args)]
#[command(after_help = "Example:\n  trgs oracle export vectors --blind --level core")]
struct Export {
    /// Folder to write; older vectors in it are replaced
    #[arg(value_name = "DIR")]
    folder: PathBuf,
    /// Leave out the truth
    #[arg(long)]
    blind: bool,
    /// json: manifest.json and archives; plain: manifest.tsv and .npy files alone
    #[arg(long, value_name = "FORMAT", default_value = "json", value_parser = ["json", "plain"])]
    format: String,
    #[command(flatten)]
    replace: Replace,
    #[command(flatten)]
    selection: Selection,
}

/// Write this program's own answers in the form of a backend's
#[derive(Args)]
#[command(
    after_help = "Example:\n  trgs oracle answer own --precision f32 && trgs oracle check own --precision f32 --level stress"
)]
struct AnswerArgs {
    /// Folder to write; older answers in it are replaced
    #[arg(value_name = "DIR")]
    folder: PathBuf,
    /// Arithmetic of the answers
    #[arg(long, default_value = "f64", value_parser = choice(&Precision::ALL))]
    precision: Precision,
    #[command(flatten)]
    replace: Replace,
    #[command(flatten)]
    selection: Selection,
}

/// Compare a backend's answers with the truth; exit with code 1 if an answer is wrong or missing
#[derive(Args)]
#[command(after_help = "Example:
  trgs oracle check answers --precision f32 --report conformance.json --waivers waivers.toml

A waiver accepts the failure of a case until a date:
  [[waiver]]
  case = \"image-exact/needle\"
  reason = \"set-up in single precision\"
  expires = 2027-06-30")]
struct Check {
    /// Folder of answers, named as in the manifest; its optional backend.json describes the backend
    #[arg(value_name = "DIR")]
    folder: PathBuf,
    /// Arithmetic of the backend; selects tolerances and the ulp
    #[arg(long, default_value = "f32", value_parser = choice(&Format::ALL))]
    precision: Format,
    /// Report to write: FILE.json, FILE.md, FILE.html and FILE.xml (JUnit)
    #[arg(long, value_name = "FILE.json")]
    report: Option<PathBuf>,
    /// File of accepted failures
    #[arg(long, value_name = "FILE.toml")]
    waivers: Option<PathBuf>,
    /// File of limits, in the form of reference/tolerances.toml, that are added to the built-in ones
    #[arg(long, value_name = "FILE.toml")]
    tolerances: Option<PathBuf>,
    /// Highest level of cases to include
    #[arg(long, default_value = "core", value_parser = choice(&Level::ALL))]
    level: Level,
    #[command(flatten)]
    source: Source,
}

impl Oracle {
    pub(super) fn run(&self, global: &Global) -> Result<Output> {
        match &self.command {
            Command::List(command) => command.run(),
            Command::Export(command) => command.run(),
            Command::Answer(command) => command.run(),
            Command::Check(command) => command.run(),
            Command::Make(command) => command.run(),
            Command::Hunt(command) => command.run(),
            Command::Replay(command) => command.run(),
            Command::Trace(command) => command.run(global),
        }
    }
}

impl Source {
    fn vectors(&self) -> Result<Vectors> {
        self.vectors.as_deref().map_or_else(Vectors::embedded, Vectors::open)
    }

    /// A folder to write, which the vectors must not be in.
    fn destination(&self, folder: &Path, kind: Kind, by: &str, replace: Replace) -> Destination {
        let destination = Destination::new(folder, kind, by).overwrite(replace.overwrite);
        self.vectors.iter().fold(destination, Destination::input)
    }
}

impl List {
    fn run(&self) -> Result<Output> {
        let vectors = self.selection.source.vectors()?;
        let cases = select(&vectors, self.selection.level, &self.selection.source.stage)?;
        let rows = cases.iter().map(|case| {
            [case.id.clone(), word(&case.level), case.equations.join(", "), case.flags.join(" "), case.title.clone()]
        });
        let result = json!({ "flags": vectors.manifest.flags, "cases": cases });
        Ok(Output::table(&result, ["case", "level", "equations", "flags", ""], rows))
    }
}

/// The files written.
#[derive(Serialize)]
struct Written<'a> {
    #[serde(serialize_with = "trgs::words::serialize_name")]
    folder: &'a Path,
    cases: usize,
    files: usize,
}

impl Export {
    fn run(&self) -> Result<Output> {
        let vectors = self.selection.source.vectors()?;
        let cases = select(&vectors, self.selection.level, &self.selection.source.stage)?;
        let destination = self.selection.source.destination(&self.folder, Kind::Vectors, "oracle export", self.replace);
        let files = interrupt::shielded(|| match &*self.format {
            "plain" => plain::export(&vectors, destination.clone(), self.blind, &cases),
            _ => vectors.export(destination.clone(), self.blind, &cases),
        })?;
        moved(&destination);
        Ok(Output::list(&Written { folder: &self.folder, cases: cases.len(), files: files + 2 }))
    }
}

impl AnswerArgs {
    fn run(&self) -> Result<Output> {
        let vectors = self.selection.source.vectors()?;
        let cases = select(&vectors, self.selection.level, &self.selection.source.stage)?;
        let destination = self.selection.source.destination(&self.folder, Kind::Answers, "oracle answer", self.replace);
        let staged = stage_folder(destination.clone())?;
        let mut files = 0;
        for case in &cases {
            let question = Question::new(&vectors, case)?;
            let outputs = answers::answer(&question, self.precision)?;
            answers::write(&staged.path(), case, &outputs)?;
            files += case.outputs.len();
        }
        interrupt::shielded(|| staged.commit())?;
        moved(&destination);
        Ok(Output::list(&Written { folder: &self.folder, cases: cases.len(), files }))
    }
}

impl Check {
    fn run(&self) -> Result<Output> {
        let vectors = fresh::with_truth(self.source.vectors()?, self.precision, &self.folder)?;
        let waivers = match &self.waivers {
            Some(path) => waivers::read(path, &vectors.manifest.cases)?,
            None => Vec::new(),
        };
        let options = Options {
            format: self.precision,
            level: self.level,
            stages: &self.source.stage,
            waivers: &waivers,
            today: waivers::today(),
            commit: trgs::provenance::commit(),
        };
        let mut tolerances = Tolerances::embedded()?;
        self.tolerances.iter().try_for_each(|file| tolerances.add(file))?;
        let report = check(&vectors, &tolerances.made_for(&vectors), &self.folder, &options)?;
        if let Some(path) = &self.report {
            interrupt::shielded(|| report::write(&report, path))?;
        }
        Ok(Output::verdict(&report, report::markdown(&report), report.passed()))
    }
}
