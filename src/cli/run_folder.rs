//! The folder that a reconstruction leaves behind. It appears as a whole, at the end, or not at all.

use super::evaluate::Evaluation;
use std::ffi::OsString;
use std::io::{self, Write};
use std::path::Path;
use trgs::config::{Config, Method};
use trgs::numeric::threads;
use trgs::output::{StagedFolder, stage_folder, write_atomically};
use trgs::primitives::{Primitives, model};
use trgs::provenance::{Provenance, digest_file};
use trgs::report::{self, Curve, Report};
use trgs::scene::{Dataset, Volume, npy};
use trgs::train::Record;
use trgs::{Error, Result};

/// What every run writes.
const FILES: [&str; 5] = ["config.toml", "volume.npy", "metrics.json", "report.html", "provenance.json"];
/// What a run that fits primitives writes too.
const MODEL_FILES: [&str; 2] = ["model.npz", "log.jsonl"];
/// Files without a time in them, so that equal runs have equal digests.
const TIMELESS: [&str; 4] = ["config.toml", "model.npz", "volume.npy", "metrics.json"];

/// What a run found.
pub(super) struct Outcome {
    pub(super) method: Method,
    /// Missing where the method has none.
    pub(super) primitives: Option<Primitives>,
    pub(super) volume: Volume,
    pub(super) log: Vec<Record>,
    pub(super) seconds: f64,
    pub(super) evaluation: Evaluation,
}

/// A run's folder under construction.
pub(super) struct RunFolder {
    staged: StagedFolder,
    provenance: Provenance,
}

impl Outcome {
    /// As people write it.
    pub(super) fn name(&self) -> &'static str {
        match self.method {
            Method::TrGs => "TR-GS",
            Method::Fdk => "FDK",
        }
    }

    fn on_the_page(&self) -> report::Method<'_> {
        report::Method { name: self.name(), volume: Some(&self.volume), metrics: Some(&self.evaluation.metrics) }
    }
}

impl RunFolder {
    /// Begins the folder of a run of `config` on the dataset at `source`. An older run of the same kind will be
    /// replaced, anything else is refused now and not after hours of work.
    pub(super) fn begin(folder: &Path, source: &Path, config: &Config) -> Result<Self> {
        check_replaceable(folder, config.method)?;
        let mut provenance = Provenance::new(threads::count(), std::env::args());
        provenance.seeds.insert("reconstruct".into(), config.seed);
        provenance.add_input(match source.parent() {
            // The description of a scan: its folder, which has no name if it is the current one.
            Some(parent) if source.is_file() && parent.as_os_str().is_empty() => Path::new("."),
            Some(parent) if source.is_file() => parent,
            _ => source,
        })?;
        Ok(Self { staged: stage_folder(folder)?, provenance })
    }

    /// Writes everything and moves the folder to its place. `beside` is shown on the page for comparison.
    pub(super) fn finish(
        mut self,
        dataset: &Dataset,
        config: &Config,
        outcome: &Outcome,
        beside: Option<&Outcome>,
    ) -> Result<()> {
        let at = |name: &str| self.staged.path().join(name);
        write_text(&at("config.toml"), &config.to_toml())?;
        npy::write(&at("volume.npy"), outcome.volume.values.view())?;
        write_text(&at("metrics.json"), &json(&outcome.evaluation))?;
        if let Some(primitives) = &outcome.primitives {
            model::write(&at("model.npz"), &primitives.parameters)?;
            let lines = outcome.log.iter().map(to_line);
            write_text(&at("log.jsonl"), &lines.collect::<String>())?;
        }
        for name in TIMELESS.into_iter().filter(|name| at(name).exists()) {
            self.provenance.outputs.insert(name.into(), digest_file(&at(name))?);
        }
        write_text(&at("report.html"), &page(dataset, config, outcome, beside, &self.provenance)?)?;
        write_text(&at("provenance.json"), &json(&self.provenance))?;
        self.staged.commit()
    }
}

fn page(
    dataset: &Dataset,
    config: &Config,
    outcome: &Outcome,
    beside: Option<&Outcome>,
    provenance: &Provenance,
) -> Result<String> {
    let curve = |name, value: fn(&Record) -> f64| Curve {
        name,
        points: outcome.log.iter().map(|record| (record.iteration as f64, value(record))).collect(),
    };
    let curves =
        [curve("total", |r| r.loss), curve("L1", |r| r.l1), curve("1-SSIM", |r| r.d_ssim), curve("TV", |r| r.tv)];
    let detector = &dataset.scanner.detector;
    let mut facts = vec![
        ("Training views".into(), dataset.train.len().to_string()),
        ("Detector, rows × columns".into(), format!("{} × {}", detector.rows, detector.columns)),
        ("Volume".into(), dataset.scanner.grid.shape.map(|n| n.to_string()).join(" × ")),
        ("Noise".into(), dataset.noise.to_string()),
        ("Seconds".into(), format!("{:.1}", outcome.seconds)),
    ];
    if let Some(primitives) = &outcome.primitives {
        facts.push(("Primitives".into(), primitives.len().to_string()));
        facts.push(("Iterations".into(), config.iterations.to_string()));
    }
    report::render(&Report {
        title: &format!("{} from {}", outcome.name(), dataset.name),
        subtitle: &format!("Reconstructed from {} projections", dataset.train.len()),
        methods: std::iter::once(outcome).chain(beside).map(Outcome::on_the_page).collect(),
        truth: dataset.truth.as_ref(),
        curves: curves.into_iter().filter(|curve| !curve.points.is_empty()).collect(),
        facts,
        provenance: Some(provenance),
    })
}

/// Refuses a folder with anything in it but an older run of the same method.
fn check_replaceable(folder: &Path, method: Method) -> Result<()> {
    let names: Vec<OsString> = match folder.read_dir() {
        Ok(entries) => entries.filter_map(|entry| Some(entry.ok()?.file_name())).collect(),
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(()),
        Err(error) => return Err(Error::write(folder, error)),
    };
    let has = |file: &str| names.iter().any(|name| name == file);
    let foreign = |name: &&OsString| !FILES.iter().chain(&MODEL_FILES).any(|file| *name == file);
    let got = match names.iter().find(foreign) {
        _ if names.is_empty() => return Ok(()),
        Some(name) => format!("a folder that holds {}", name.display()),
        None if !has("provenance.json") => "a folder with parts of a run".into(),
        None if has("model.npz") != (method == Method::TrGs) => "a run of another method".into(),
        None => return Ok(()),
    };
    let expected = "a new or empty folder, or an older run of the same method";
    Err(Error::invalid(format!("--out {}", folder.display()), got, expected, "choose another folder"))
}

fn write_text(path: &Path, text: &str) -> Result<()> {
    write_atomically(path, |file| file.write_all(text.as_bytes()))
}

fn json(value: &impl serde::Serialize) -> String {
    serde_json::to_string_pretty(value).expect("results have string keys and no foreign serialisers") + "\n"
}

fn to_line(record: &Record) -> String {
    serde_json::to_string(record).expect("a record consists of numbers") + "\n"
}
