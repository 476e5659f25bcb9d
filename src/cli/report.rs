//! `trgs report`: rewrites the pages of a folder of tables from the finished cells, and shows runs side by side.

use super::arguments::ReplaceFiles;
use super::evaluate::arrange;
use super::table::{What, answer, requests, shared};
use super::{Output, interrupt};
use clap::Args;
use serde_json::json;
use std::collections::{BTreeMap, BTreeSet};
use std::io::Write;
use std::path::{Path, PathBuf};
use trgs::config::Config;
use trgs::evaluation::Metrics;
use trgs::output::{check_file, write_atomically};
use trgs::report::{Method, Report as Page, render};
use trgs::scan::Frame;
use trgs::scan::volume_file::{self, VolumeFile};
use trgs::{Error, Result, input, words};

/// Rewrite the pages of tables from the cells finished so far, or show runs side by side
#[derive(Args)]
#[command(after_help = "Examples:
  trgs report out/tables
  trgs report out/torso
  trgs report out/tr-gs out/tv out/fdk --out runs.html

Of one run, the path of its page is printed. Of several, a page is written: their volumes (at most four are shown, on the \
grid of the first), metrics, and the settings that differ.")]
pub(super) struct Report {
    /// Folder of tables, or folders of runs
    #[arg(value_name = "RUN|TABLE_DIR", required = true)]
    folders: Vec<PathBuf>,
    /// File to write for several runs
    #[arg(long, value_name = "PAGE.html", default_value = "runs.html")]
    out: PathBuf,
    #[command(flatten)]
    replace: ReplaceFiles,
}

impl Report {
    pub(super) fn run(&self) -> Result<Output> {
        let [folder] = &self.folders[..] else { return self.side_by_side() };
        let page = folder.join("report.html");
        if page.exists() {
            return Ok(Output::list(&json!({ "report": words::name(&page) })));
        }
        let requests = requests(folder)?;
        let target = shared(folder, requests.keys().map(String::as_str), self.replace)?;
        let of = |(name, what): (&String, &What)| {
            let tables = what.tables(name)?;
            let cases = what.cases(&tables)?;
            tables.iter().map(|table| what.write(table, &cases, folder, &target)).collect::<Result<Vec<_>>>()
        };
        let written = requests.iter().map(of);
        let written = interrupt::shielded(|| written.collect::<Result<Vec<_>>>())?;
        Ok(answer(folder, &written.concat()))
    }

    /// The page of several runs.
    fn side_by_side(&self) -> Result<Output> {
        let runs = self.folders.iter().map(|folder| Run::read(folder)).collect::<Result<Vec<_>>>()?;
        let (first, path) = (&runs[0].file, &self.folders[0]);
        let (frame, grid) = Frame::around(first).map_err(|error| error.in_file(path))?;
        let of = |(run, path): (&Run, &PathBuf)| arrange(&frame, run.file.clone(), &grid, path);
        let volumes = runs.iter().zip(&self.folders).map(of).collect::<Result<Vec<_>>>()?;
        let names: Vec<_> = runs.iter().map(|run| run.name.as_str()).collect();
        let page = render(&Page {
            title: &names.join(", "),
            subtitle: "Runs side by side; settings that differ are below",
            methods: runs
                .iter()
                .zip(&volumes)
                .map(|(run, volume)| Method { name: &run.name, volume: Some(volume), metrics: Some(&run.metrics) })
                .collect(),
            frame,
            facts: differences(&runs),
            ..Page::default()
        })?;
        check_file(&self.out)?;
        write_atomically(&self.out, |file| file.write_all(page.as_bytes()))?;
        Ok(Output::list(&json!({ "report": words::name(&self.out), "runs": names })))
    }
}

/// What a page shows of a run.
struct Run {
    name: String,
    file: VolumeFile,
    metrics: Metrics,
    /// All settings: key and value.
    settings: BTreeMap<String, String>,
}

impl Run {
    fn read(folder: &Path) -> Result<Self> {
        let config = Config::read(folder.join("config.toml"), trgs::Method::TrGs)?;
        let file = volume_file::read(folder.join("volume.npy"))?;
        let path = folder.join("metrics.json");
        let text = input::read(&path).map_err(|source| Error::read(&path, source))?;
        let metrics = serde_json::from_slice(&text)
            .map_err(|error| Error::format(&path, "metrics", error, "those of a run", "give the folder of a run"))?;
        let settings = config.entries().into_iter().map(|(key, value)| (key, value.to_string())).collect();
        Ok(Self { name: words::name(folder.file_name().unwrap_or(folder.as_os_str())), file, metrics, settings })
    }
}

/// The settings that differ between runs: key, and the value of each.
fn differences(runs: &[Run]) -> Vec<(String, String)> {
    let keys: BTreeSet<_> = runs.iter().flat_map(|run| run.settings.keys()).collect();
    let value = |run: &Run, key: &String| run.settings.get(key).cloned().unwrap_or_else(|| "–".into());
    let row = |key: &String| (key.clone(), runs.iter().map(|run| value(run, key)).collect::<Vec<_>>());
    let differ = keys.into_iter().map(row).filter(|(_, values)| values.iter().any(|value| *value != values[0]));
    differ.map(|(key, values)| (key, values.join(" | "))).collect()
}
