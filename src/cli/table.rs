//! `trgs table`: runs the paper's tables and compares them with the paper's figures.

use super::arguments::{ReplaceFiles, choice};
use super::messages::{ProgressBar, go_on};
use super::{Global, Output, interrupt};
use clap::{Args, value_parser};
use serde::{Deserialize, Serialize};
use serde_json::json;
use std::collections::{BTreeMap, BTreeSet};
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, OnceLock};
use std::time::Instant;
use trgs::config::Method;
use trgs::experiments::{self, Case, Cell, Done, Judged, Matching, NAMES, Predictions, Scale, Store, Summary};
use trgs::numeric::threads;
use trgs::output::{Destination, Kind, SharedFolder};
use trgs::{Error, Result, limit, words};

/// File with the arguments of a table, so that its page can be rewritten.
const REQUESTS: &str = "tables.json";
/// Endings of the files of a table.
const CSV: &str = ".csv";
const CASES: &str = "-cases.csv";
const MARKDOWN: &str = ".md";
const LATEX: &str = ".tex";
const PAGE: &str = ".html";

/// Run a table of the paper, or all of them, and compare with the paper's figures
#[derive(Args)]
#[command(after_help = "Examples:
  trgs table list
  trgs table ablation --out out/tables --size 32
  trgs table all --out out/tables --seeds 3
  trgs table volume --out out/tables --data data/r2_gaussian
  trgs table volume --out out/ray --matched ray
  trgs table volume --out out/middle --data data/volumes --crop 64
  trgs table volume --out out/tables --networks naf
  trgs table volume --out out/measured --data data/r2_gaussian/real --measured
  trgs table own.toml --out out/own --seeds 3
  trgs table ablation --out out/tables --list-cells
  trgs table ablation --out out/tables --cell 0123456789abcdef0123
  trgs table volume --size 256 --data data/r2_gaussian --out out/paper --against reference/results/predictions.json

Cells finished in DIR are not run again: an interrupted run continues, and several processes may share DIR.")]
pub(super) struct Table {
    /// Name of a table, or a file with one in the same form; `all` runs all tables of the paper, `list` lists them
    #[arg(value_name = "NAME|FILE.toml|all|list")]
    name: String,
    /// Folder of cells and tables
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    #[command(flatten)]
    replace: ReplaceFiles,
    #[command(flatten)]
    what: What,
    /// Run only this cell and write no table; may be repeated
    #[arg(long, value_name = "ID", conflicts_with = "list_cells")]
    cell: Vec<String>,
    /// List the cells and run nothing
    #[arg(long)]
    list_cells: bool,
    /// Compare the finished table with the predictions of a file; the exit code is 1 if a figure is outside its interval
    #[arg(long, value_name = "FILE.json", conflicts_with_all = ["list_cells", "cell"])]
    against: Option<PathBuf>,
}

/// The arguments of a table.
#[derive(Args, Clone, Serialize, Deserialize)]
pub(super) struct What {
    /// Voxels along the longest side; detector, primitives and iterations scale with it
    #[arg(long, value_name = "N", default_value_t = 64, value_parser = value_parser!(u16).range(8..=512))]
    size: u16,
    /// What stays as in the paper: edge (rays per voxel of a surface) or ray (rays per voxel and per parameter)
    #[arg(long, value_name = "edge|ray", value_parser = matching, default_value = "edge")]
    #[serde(default)]
    matched: Matching,
    /// Of larger volumes in --data, the middle of N³ voxels instead of the average; rays per voxel and per voxel of a surface
    /// are then those of the paper
    #[arg(long, value_name = "N", requires = "data", conflicts_with_all = ["size", "matched", "measured"], value_parser = value_parser!(u16).range(8..=512))]
    #[serde(default)]
    crop: Option<u16>,
    /// Number of runs of each cell, each with another seed; intervals need at least two
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = value_parser!(u64).range(1..=1000))]
    seeds: u64,
    /// Folder of scans and volumes, instead of the fifteen phantoms
    #[arg(long, value_name = "DIR")]
    data: Option<PathBuf>,
    /// Run only these cases
    #[arg(long, value_name = "NAME,NAME", value_delimiter = ',')]
    cases: Vec<String>,
    /// Set a configuration key of all rows that fit primitives, for example confidence.alpha=median; may be repeated
    #[arg(long, value_name = "KEY=VALUE")]
    #[serde(default)]
    set: Vec<String>,
    /// Run the rows of these networks, which take minutes a cell: naf, sax-nerf
    #[arg(long, value_name = "NAME,NAME", value_delimiter = ',', value_parser = choice(&[Method::Naf, Method::SaxNerf]))]
    #[serde(default)]
    networks: Vec<Method>,
    /// Compare with the paper's figures on measured scans, which the tables volume and projection have
    #[arg(long, requires = "data")]
    #[serde(default)]
    measured: bool,
    /// The content of the file of an own table.
    #[arg(skip)]
    #[serde(default, skip_serializing_if = "Option::is_none")]
    definition: Option<String>,
}

impl What {
    /// The cases of tables: those that are named, or all.
    pub(super) fn cases(&self, tables: &[experiments::Table]) -> Result<Vec<Case>> {
        let named =
            if self.cases.is_empty() { tables.first().map_or(&[][..], |table| &table.cases) } else { &self.cases };
        if self.data.is_none() && !named.is_empty() {
            return named.iter().map(|name| Case::phantom(name)).collect();
        }
        let all = match &self.data {
            Some(folder) => match self.crop {
                Some(size) => Case::middles_in_folder(folder, size.into())?,
                None => Case::in_folder(folder, self.size.into())?,
            },
            None => Case::stand_ins(),
        };
        if named.is_empty() {
            return Ok(all);
        }
        let chosen = named.iter().map(|name| {
            all.iter().find(|case| case.name == *name).cloned().ok_or_else(|| {
                let names: Vec<_> = all.iter().map(|case| case.name.as_str()).collect();
                Error::invalid(
                    "--cases",
                    format!("{name:?}"),
                    format!("one of {}", names.join(", ")),
                    "give names from this list",
                )
            })
        });
        chosen.collect()
    }

    /// The table with a name, or all tables.
    pub(super) fn tables(&self, name: &str) -> Result<Vec<experiments::Table>> {
        let tables = match (&self.definition, name) {
            (Some(definition), name) => vec![experiments::Table::parsed(name, definition)?],
            (None, "all") => experiments::Table::all(),
            (None, name) => vec![experiments::Table::by_name(name)?],
        };
        let with = |table: experiments::Table| table.with_networks(&self.networks).with(&self.set);
        let tables: Vec<_> = tables.into_iter().map(with).collect::<Result<_>>()?;
        let runs = |table: &experiments::Table| table.rows.iter().any(|row| row.method.is_some_and(Method::is_network));
        if !self.networks.is_empty() && !tables.iter().any(runs) {
            let expected = "volume or projection: the other tables have no networks";
            return Err(Error::invalid("--networks", name, expected, "leave it out"));
        }
        if !self.measured {
            return Ok(tables);
        }
        let measured: Vec<_> = tables.into_iter().filter_map(experiments::Table::measured).collect();
        if measured.is_empty() {
            let expected = "volume or projection: the paper has no measured scans in the others";
            return Err(Error::invalid("--measured", name, expected, "leave it out"));
        }
        Ok(measured)
    }

    fn scale(&self, table: &experiments::Table) -> Scale {
        let scale = match self.crop {
            Some(size) => Scale::new(size.into(), Matching::Ray),
            None => Scale::new(self.size.into(), self.matched),
        };
        Scale { pixels: table.detector, ..scale }
    }

    /// Writes all files of a table from the finished cells.
    pub(super) fn write(
        &self,
        table: &experiments::Table,
        cases: &[Case],
        out: &Path,
        folder: &SharedFolder,
    ) -> Result<Written> {
        let store = Store::open(out)?;
        let summary = Summary::new(table, cases, self.scale(table), self.seeds, &store)?;
        let file = |ending: &str, text: String| folder.write(&format!("{}{ending}", table.name), text.as_bytes());
        file(CSV, summary.csv())?;
        file(CASES, summary.cases_csv())?;
        file(MARKDOWN, summary.markdown())?;
        file(LATEX, summary.latex())?;
        let page = file(PAGE, summary.html(cases, &store))?;
        let kept = |of: fn(&experiments::Agreement) -> [usize; 2]| {
            summary
                .blocks
                .iter()
                .flat_map(|block| &block.agreement)
                .map(of)
                .fold([0, 0], |a, b| [a[0] + b[0], a[1] + b[1]])
        };
        Ok(Written {
            table: table.name.clone(),
            page,
            cells: summary.findings.len(),
            missing: summary.missing,
            pairs: kept(|a| [a.pairs_kept, a.pairs]),
            signs: kept(|a| [a.signs_kept, a.signs]),
        })
    }
}

/// The files and agreement of a table.
#[derive(Clone, Serialize)]
pub(super) struct Written {
    table: String,
    #[serde(serialize_with = "trgs::words::serialize_name")]
    page: PathBuf,
    cells: usize,
    missing: usize,
    /// Pairs of rows that differ in the paper: number in the same order here, and number of all.
    pairs: [usize; 2],
    /// Rows that differ from the full model in the paper: number with the same sign here, number of all.
    signs: [usize; 2],
}

impl Table {
    pub(super) fn run(&self, global: &Global) -> Result<Output> {
        if self.name == "list" {
            return Ok(list());
        }
        let (name, what) = self.named()?;
        let tables = what.tables(&name)?;
        if let Some(folder) = what.data.as_deref().filter(|folder| folder.to_str().is_none()) {
            let remedy = "rename the folder, or give a link to it: trgs report reads its name from the table's folder";
            return Err(Error::invalid("--data", words::name(folder), "a name in UTF-8", remedy));
        }
        let predictions = self.against.as_deref().map(Predictions::read).transpose()?;
        let predicted: Vec<_> =
            predictions.iter().flat_map(|all| tables.iter().map(|table| all.of(table))).collect::<Result<_>>()?;
        let cases = what.cases(&tables)?;
        let cells_of = |table: &experiments::Table| table.cells(&cases, what.scale(table), what.seeds);
        if self.list_cells {
            return Ok(listed(&tables.iter().flat_map(cells_of).collect::<Vec<_>>()));
        }
        let out = self.out.as_deref().ok_or_else(|| {
            Error::invalid("--out", "nothing", "a folder for cells and tables", "give one, as in --out out/tables")
        })?;
        let mut cells: Vec<Cell> = tables.iter().flat_map(cells_of).collect();
        // Cells of one scan are adjacent, whichever table they belong to.
        cells.sort_by_cached_key(|cell| (cell.seed, cell.views, cell.noise.clone(), cell.case.name.clone()));
        if !self.cell.is_empty() {
            cells = self.chosen(cells)?;
        }
        let sides = [what.crop.unwrap_or(what.size).into(); 3];
        let together = threads::count().min(cells.len());
        let checked = limit::allow_array("cells at work, on volumes", &sides, together * PER_VOXEL);
        checked.map_err(|error| error.or_instead("a smaller --size, or fewer --threads"))?;
        let folder = shared(out, tables.iter().map(|table| table.name.as_str()), self.replace)?;
        let store = Store::open(out)?;
        interrupt::shielded(|| run(&cells, &store, global))?;
        if !self.cell.is_empty() {
            let found = cells.iter().filter_map(|cell| store.find(&cell.id).transpose()).collect::<Result<Vec<_>>>()?;
            return Ok(Output::list(&json!({ "out": words::name(out), "cells": found })));
        }
        remember(&tables, &what, out, &folder)?;
        let written = tables.iter().map(|table| what.write(table, &cases, out, &folder)).collect::<Result<Vec<_>>>()?;
        if predicted.is_empty() {
            return Ok(answer(out, &written));
        }
        let mut judged = Vec::new();
        for (table, predictions) in tables.iter().zip(predicted) {
            let summary = Summary::new(table, &cases, what.scale(table), what.seeds, &store)?;
            judged.extend(predictions.into_iter().map(|prediction| prediction.judged(&summary)));
        }
        Ok(judgement(out, &written, &judged))
    }

    /// The name of the table, and the arguments with the definition if it is a file.
    fn named(&self) -> Result<(String, What)> {
        let path = Path::new(&self.name);
        if path.extension().is_none_or(|extension| extension != "toml") {
            return Ok((self.name.clone(), self.what.clone()));
        }
        let text = std::fs::read_to_string(path).map_err(|source| Error::read(path, source))?;
        let stem = path.file_stem().and_then(|stem| stem.to_str()).unwrap_or_default();
        let plain = |c: char| c.is_alphanumeric() || "-_".contains(c);
        let free = !stem.is_empty() && stem.chars().all(plain) && !NAMES.contains(&stem) && stem != "all";
        if !free {
            let expected = "letters, digits, - and _, and no table of the paper";
            return Err(Error::invalid("name of the table's file", &self.name, expected, "rename the file"));
        }
        Ok((stem.into(), What { definition: Some(text), ..self.what.clone() }))
    }

    /// The cells with the requested ids.
    fn chosen(&self, cells: Vec<Cell>) -> Result<Vec<Cell>> {
        let wanted = |id: &String| {
            cells.iter().find(|cell| cell.id == *id).cloned().ok_or_else(|| {
                let expected = "an id that --list-cells prints for the same table, program and options";
                Error::invalid("--cell", format!("{id:?}"), expected, "run --list-cells again")
            })
        };
        self.cell.iter().map(wanted).collect()
    }
}

/// The result of the command: pages and files of tables.
pub(super) fn answer(out: &Path, written: &[Written]) -> Output {
    let rows = written.iter().map(|w| {
        let of = |[kept, all]: [usize; 2]| format!("{kept} of {all}");
        [w.table.clone(), w.cells.to_string(), of(w.pairs), of(w.signs), w.page.display().to_string()]
    });
    Output::table(
        &json!({ "out": words::name(out), "tables": written }),
        ["table", "cells", "order as in the paper", "signs", "page"],
        rows,
    )
}

/// The result of the command with predictions.
fn judgement(out: &Path, written: &[Written], judged: &[Judged]) -> Output {
    let inside = judged.iter().filter(|judged| judged.is_inside).count();
    let rows = judged.iter().map(|Judged { prediction: p, found, is_inside }| {
        let found = found.map_or_else(|| "none".into(), |found| format!("{found:.3}"));
        let interval = format!("{:.3} to {:.3}", p.low, p.high);
        let outcome = if *is_inside { "inside" } else { "OUTSIDE" };
        let row = p.minus.as_ref().map_or_else(|| p.row.clone(), |minus| format!("{} − {minus}", p.row));
        [row, p.views.to_string(), p.noise.clone(), p.metric.clone(), interval, found, outcome.into()]
    });
    Output::judged_table(
        &json!({ "out": words::name(out), "tables": written, "predictions": judged }),
        ["row", "views", "noise", "metric", "predicted", "found", ""],
        rows,
        &[format!("{inside} of {} figures are in their intervals", judged.len())],
        inside == judged.len(),
    )
}

/// Memory of a cell per voxel, in bytes: the truth and the arrays of the method tv in single precision, which has the most.
const PER_VOXEL: usize = 4 + 12 * 4 + 4;

/// Runs the unfinished cells and shows progress.
fn run(cells: &[Cell], store: &Store, global: &Global) -> Result<()> {
    let ids: BTreeSet<_> = cells.iter().map(|cell| &cell.id).collect();
    let (bar, first, began) = (Mutex::new(ProgressBar::new(ids.len(), global)), OnceLock::new(), Instant::now());
    let observe = |done: Option<&Done<'_>>| -> ControlFlow<()> {
        if let (Some(done), Ok(mut bar)) = (done, bar.lock()) {
            let first = *first.get_or_init(|| done.done - 1);
            bar.cell(done, first, began.elapsed().as_secs_f64());
        }
        go_on()
    };
    experiments::run(cells, store, threads::count(), &observe)
}

fn matching(text: &str) -> std::result::Result<Matching, String> {
    [Matching::Edge, Matching::Ray]
        .into_iter()
        .find(|matching| matching.to_string() == text)
        .ok_or_else(|| "expected edge or ray".into())
}

fn list() -> Output {
    let tables = experiments::Table::all();
    let of = |table: &experiments::Table| {
        json!({ "name": table.name, "number": table.number, "title": table.title, "metrics": table.metrics,
            "views": table.views, "noise": table.noise, "rows": table.rows.iter().map(|row| &row.name).collect::<Vec<_>>() })
    };
    let rows = tables.iter().map(|table| {
        let views: Vec<_> = table.views.iter().map(usize::to_string).collect();
        [
            table.name.clone(),
            table.number.map(|number| number.to_string()).unwrap_or_default(),
            table.title.clone(),
            table.rows.len().to_string(),
            views.join(", "),
        ]
    });
    let all: Vec<_> = tables.iter().map(of).collect();
    Output::table(&all, ["name", "in the paper", "what", "rows", "views"], rows)
}

fn listed(cells: &[Cell]) -> Output {
    let mut known = BTreeSet::new();
    let cells: Vec<_> = cells.iter().filter(|cell| known.insert(&cell.id)).collect();
    let all: Vec<_> = cells.iter().map(|cell| json!({ "id": cell.id, "cell": cell.description() })).collect();
    Output::table(&all, ["id", "cell"], cells.iter().map(|cell| [cell.id.clone(), cell.description()]))
}

/// Stores the arguments in DIR, in addition to earlier ones.
fn remember(tables: &[experiments::Table], what: &What, out: &Path, folder: &SharedFolder) -> Result<()> {
    let mut requests = if out.join(REQUESTS).exists() { requests(out)? } else { BTreeMap::new() };
    requests.extend(tables.iter().map(|table| (table.name.clone(), what.clone())));
    let text = serde_json::to_string_pretty(&requests).expect("string keys") + "\n";
    folder.write(REQUESTS, text.as_bytes()).map(drop)
}

/// The folder of some tables, whose files are replaced only if they are as they were written.
pub(super) fn shared<'a>(
    out: &Path,
    tables: impl IntoIterator<Item = &'a str>,
    replace: ReplaceFiles,
) -> Result<SharedFolder> {
    let of = |table: &str| [CSV, CASES, MARKDOWN, LATEX, PAGE].map(|ending| format!("{table}{ending}"));
    let names = tables.into_iter().flat_map(of).chain([REQUESTS.into()]);
    let destination = Destination::new(out, Kind::Tables, "table").overwrite(replace.overwrite);
    SharedFolder::open(destination, names.collect::<Vec<_>>())
}

/// The arguments stored in a folder, by the name of the table.
pub(super) fn requests(folder: &Path) -> Result<BTreeMap<String, What>> {
    let path = folder.join(REQUESTS);
    let text = std::fs::read(&path).map_err(|source| Error::read(&path, source))?;
    let requests: BTreeMap<String, What> = serde_json::from_slice(&text)
        .map_err(|error| Error::format(&path, "tables", error, "what `trgs table` writes", "run the table again"))?;
    match requests.iter().find(|(name, what)| what.definition.is_none() && !NAMES.contains(&name.as_str())) {
        Some((name, _)) => Err(Error::format(&path, "table", name, NAMES.join(", "), "run the table again")),
        None => Ok(requests),
    }
}
