//! `trgs report`: rewrites the pages of a folder of tables from the finished cells.

use super::arguments::ReplaceFiles;
use super::table::{What, answer, requests, shared};
use super::{Output, interrupt};
use clap::Args;
use serde_json::json;
use std::path::PathBuf;
use trgs::Result;
use trgs::words;

/// Rewrite the pages of tables from the cells finished so far, or print the path of a run's page
#[derive(Args)]
#[command(after_help = "Examples:
  trgs report out/tables
  trgs report out/torso")]
pub(super) struct Report {
    /// Folder of a run, or of tables
    #[arg(value_name = "RUN|TABLE_DIR")]
    folder: PathBuf,
    #[command(flatten)]
    replace: ReplaceFiles,
}

impl Report {
    pub(super) fn run(&self) -> Result<Output> {
        let page = self.folder.join("report.html");
        if page.exists() {
            return Ok(Output::list(&json!({ "report": words::name(&page) })));
        }
        let requests = requests(&self.folder)?;
        let folder = shared(&self.folder, requests.keys().map(String::as_str), self.replace)?;
        let of = |(name, what): (&String, &What)| {
            let tables = what.tables(name)?;
            let cases = what.cases(&tables)?;
            tables.iter().map(|table| what.write(table, &cases, &self.folder, &folder)).collect::<Result<Vec<_>>>()
        };
        let written = requests.iter().map(of);
        let written = interrupt::shielded(|| written.collect::<Result<Vec<_>>>())?;
        Ok(answer(&self.folder, &written.concat()))
    }
}
