//! The folder of a run. It appears completely at the end of the run, or not at all.

use super::arguments::word;
use super::flags::with_flags;
use super::messages::moved;
use super::run_log::{RunLog, to_line};
use serde::Serialize;
use std::borrow::Cow;
use std::collections::BTreeMap;
use std::io::Write;
use std::path::{Path, PathBuf};
use trgs::classical::algebraic::{Choice, Pass};
use trgs::confidence::Coverage;
use trgs::config::{Config, Method};
use trgs::evaluation::Metrics;
use trgs::memory::COMPARED_VIEWS;
use trgs::numeric::threads;
use trgs::output::{Claim, Destination, Kind, stage_folder, write_atomically};
use trgs::primitives::Primitives;
use trgs::provenance::{Provenance, digest_bytes, digest_file};
use trgs::reconstruction::{Checkpoint, Evaluation, Reconstruction, Sampled, reproject};
use trgs::report::agreement::{Agreement, Figures};
use trgs::report::viewer::Scene;
use trgs::report::{self, Curve, Report};
use trgs::scan::volume_file::NpySide;
use trgs::scan::{Dataset, model, npy};
use trgs::train::Record;
use trgs::words::{self, counted};
use trgs::{Error, Result};

/// The records of a run, a line each.
const LOG: &str = "log.jsonl";
/// Folder with the state of an iterative run.
const CHECKPOINTS: &str = "checkpoints";
/// The volume, and its place beside it: spacing, origin, directions and unit.
const VOLUME: &str = "volume.npy";
const PLACE: &str = "volume.npy.json";
/// Views on the page.
const SHOWN_VIEWS: usize = 6;
/// Training views from which on some can be held out for a test.
const ENOUGH_VIEWS: usize = 8;
/// Files that contain no time, so that equal runs have equal digests.
const TIMELESS: [&str; 5] = ["config.toml", "model.npz", VOLUME, PLACE, "metrics.json"];

/// What a run was made from.
pub(super) struct Source {
    /// The path of the scan.
    pub(super) scan: PathBuf,
    /// Digests of the files that were read, by path.
    pub(super) digests: BTreeMap<String, String>,
    /// What is unusual about the scan.
    pub(super) warnings: Vec<String>,
}

/// The result of a run.
pub(super) struct Outcome {
    pub(super) method: Method,
    pub(super) found: Reconstruction,
    /// Metrics of the volume before its finish on voxels, if it has one.
    pub(super) before: Option<Metrics>,
    /// Iterations of a method on voxels.
    pub(super) passes: Vec<TimedPass>,
    pub(super) seconds: f64,
    pub(super) evaluation: Evaluation,
}

/// An iteration on voxels, as logged.
#[derive(Serialize)]
pub(super) struct TimedPass {
    #[serde(flatten)]
    pub(super) pass: Pass,
    /// Time since the reconstruction began.
    pub(super) seconds: f64,
}

/// The content of `metrics.json`.
#[derive(Serialize)]
struct Results<'a> {
    #[serde(flatten)]
    evaluation: &'a Evaluation,
    #[serde(skip_serializing_if = "Option::is_none")]
    choice: Option<&'a Choice>,
    /// Measured against rendered views.
    residual: Figures,
    /// How the volume was sampled from the primitives.
    #[serde(skip_serializing_if = "Option::is_none")]
    sampled: Option<&'a Sampled>,
    /// Metrics of the primitives' volume, if volume.npy was finished on voxels.
    #[serde(skip_serializing_if = "Option::is_none")]
    unfinished: Option<&'a Metrics>,
}

/// The folder of a run under construction, which no other process writes.
pub(super) struct RunFolder {
    claim: Claim,
    destination: Destination,
    provenance: Provenance,
    scan: PathBuf,
    warnings: Vec<String>,
}

impl Outcome {
    /// Name of the method for display.
    pub(super) fn name(&self) -> &'static str {
        self.method.title()
    }

    /// The volume, and the volume before the finish.
    fn on_the_page(&self) -> impl Iterator<Item = report::Method<'_>> {
        let metrics = Some(&self.evaluation.metrics);
        let found = report::Method { name: self.name(), volume: Some(&self.found.volume), metrics };
        let before = self.found.unfinished.iter().map(|volume| report::Method {
            name: "before the finish",
            volume: Some(volume),
            metrics: self.before.as_ref(),
        });
        std::iter::once(found).chain(before)
    }
}

impl RunFolder {
    /// Claims a folder for a run of the scan at `source`, before its checkpoint is read.
    ///
    /// Content of others is rejected now, not after hours of work.
    pub(super) fn claim(folder: &Path, source: &Path, overwrite: bool) -> Result<Claim> {
        Claim::new(Destination::new(folder, Kind::Run, "").overwrite(overwrite).input(source))
    }

    /// Begins a run of `config`; `memory` is estimated, in bytes. An older run of the same method will be replaced.
    pub(super) fn begin(claim: Claim, config: &Config, memory: u64, source: Source) -> Result<Self> {
        let destination = claim.destination().by(word(&config.method));
        destination.check()?;
        let mut provenance = Provenance::new(threads::count(), super::arguments().map(words::name));
        provenance.seeds.insert("reconstruct".into(), config.seed);
        provenance.memory = Some(memory);
        provenance.inputs = source.digests;
        // Tests whether the folder can be written and replaced.
        drop(stage_folder(destination.clone())?);
        claim.begin(&destination)?;
        moved(&destination);
        Ok(Self { claim, destination, provenance, scan: source.scan, warnings: source.warnings })
    }

    /// The folder of the run while it goes on.
    pub(super) fn path(&self) -> PathBuf {
        self.claim.folder().into()
    }

    /// The log that grows while the run goes on.
    pub(super) fn log(&self, from: Option<&Checkpoint>) -> RunLog {
        RunLog::begin(self.claim.folder().join(LOG), from.map_or(&[], Checkpoint::log))
    }

    /// Writes all files and moves the folder to its target. `beside` is shown on the page for comparison; `keeps` says that
    /// the run has a checkpoint.
    pub(super) fn finish(
        mut self,
        dataset: &Dataset,
        config: &Config,
        outcome: &Outcome,
        beside: Option<&Outcome>,
        keeps: bool,
    ) -> Result<()> {
        self.provenance.density_unit = outcome.found.unit;
        self.provenance.continued.clone_from(&outcome.found.continued);
        let staged = stage_folder(self.destination.clone())?;
        let at = |name: &str| staged.path().join(name);
        write_text(&at("config.toml"), &config.to_toml())?;
        npy::write(&at(VOLUME), outcome.found.volume.values.view())?;
        let grid = &outcome.found.volume.grid;
        NpySide::write(&at(VOLUME), grid.shape, &dataset.frame.metadata(grid))?;
        let (agreement, views) = views(dataset, config, outcome)?;
        let results = Results {
            evaluation: &outcome.evaluation,
            choice: outcome.found.choice.as_ref(),
            residual: agreement.figures(),
            sampled: outcome.found.sampled.as_ref(),
            unfinished: outcome.before.as_ref(),
        };
        write_text(&at("metrics.json"), &json(&results))?;
        if let Some(primitives) = &outcome.found.primitives {
            model::write(at("model.npz"), &primitives.parameters)?;
        }
        let lines: String = outcome.found.log.iter().map(to_line).chain(outcome.passes.iter().map(to_line)).collect();
        if !lines.is_empty() {
            write_text(&at(LOG), &lines)?;
        }
        for name in TIMELESS.into_iter().filter(|name| at(name).exists()) {
            self.provenance.outputs.insert(name.into(), digest_file(&at(name))?);
        }
        // The run's last state replaces earlier states together with the results, and has their digests.
        let last = checkpoint_file(self.claim.folder());
        if keeps && last.exists() {
            match Checkpoint::finish(&last, &checkpoint_file(&staged.path()), &self.provenance.outputs) {
                // Another program may have changed the file; the results are not lost for that.
                Err(error @ (Error::Format { .. } | Error::Read { .. })) => {
                    tracing::warn!("the run cannot be continued: {}", with_flags(&error.text()));
                }
                written => written?,
            }
        }
        write_text(&at("report.html"), &self.page(dataset, config, outcome, beside, (agreement, views))?)?;
        write_text(&at("provenance.json"), &json(&self.provenance))?;
        staged.commit()
    }

    fn page(
        &self,
        dataset: &Dataset,
        config: &Config,
        outcome: &Outcome,
        beside: Option<&Outcome>,
        (agreement, scene): (Agreement, Scene<'static>),
    ) -> Result<String> {
        let (curves, facts) = (curves(outcome), facts(dataset, config, outcome));
        report::render(&Report {
            title: &format!("{} from {}", outcome.name(), dataset.name),
            subtitle: &format!("Reconstructed from {}", counted(dataset.train.len(), "projection")),
            methods: outcome.on_the_page().chain(beside.into_iter().flat_map(Outcome::on_the_page)).collect(),
            truth: dataset.truth.as_ref(),
            frame: dataset.frame,
            warnings: self.warnings.clone(),
            next: self.next(dataset, outcome, &agreement),
            views: Some((agreement, scene)),
            curves: curves.into_iter().filter(|curve| !curve.points.is_empty()).collect(),
            population: population(&outcome.found.log),
            choice: outcome.found.choice.as_ref(),
            primitives: outcome
                .found
                .primitives
                .as_ref()
                .map(|primitives| (primitives, confidence(dataset, config, primitives))),
            facts,
            provenance: Some(&self.provenance),
        })
    }

    /// Commands that may follow the run, with what each is for.
    fn next(&self, dataset: &Dataset, outcome: &Outcome, agreement: &Agreement) -> Vec<(String, String)> {
        let run = self.claim.folder();
        let scan = words::quoted_path(&self.scan);
        let beside = |suffix: &str| {
            let mut name = run.as_os_str().to_owned();
            name.push(suffix);
            words::quoted_path(Path::new(&name))
        };
        let [page, volume, other, held] = [".html", ".nii.gz", "-tr-gs", "-held-out"].map(beside);
        let run = words::quoted_path(run);
        let mut next = vec![
            ("Look at all voxels and all views:".into(), format!("trgs view {run} {scan} --full --out {page}")),
            ("Take the volume to 3D Slicer, ITK-SNAP or Fiji:".into(), format!("trgs convert {run} {volume}")),
        ];
        if !agreement.is_explained() {
            let why = "The residual is more than noise: check axes, rotation and offset of the scan:";
            next.push((why.into(), format!("trgs inspect {scan} --check-geometry")));
        }
        let count = dataset.train.len();
        if dataset.test.is_none() && count >= ENOUGH_VIEWS {
            let (kept, tested) = (count - count / 5, count / 5);
            let command = format!("trgs convert {scan} {held} --views {kept} --test-views {tested}");
            next.push(("Keep views for a test, then reconstruct that scan:".into(), command));
        }
        if !outcome.method.fits_primitives() {
            next.push(("Compare with TR-GS:".into(), format!("trgs reconstruct {scan} --out {other}")));
        }
        next
    }
}

/// Losses or residuals over the iterations.
fn curves(outcome: &Outcome) -> [Curve<'static>; 7] {
    let loss = |name, value| curve(name, &outcome.found.log, |record| record.iteration, value);
    let of_passes = |name, value| curve(name, &outcome.passes, |timed| timed.pass.iteration, value);
    [
        loss("total", |r| Some(r.loss)),
        loss("L1", |r| Some(r.l1)),
        loss("1-SSIM", |r| Some(r.d_ssim)),
        loss("TV", |r| Some(r.tv)),
        of_passes("residual", |timed| Some(timed.pass.residual)),
        of_passes("objective", |timed| timed.pass.objective),
        of_passes("step", |timed| timed.pass.change),
    ]
}

/// A value over the iterations, of the items that have it.
fn curve<T>(
    name: &'static str,
    items: &[T],
    iteration: fn(&T) -> usize,
    value: fn(&T) -> Option<f64>,
) -> Curve<'static> {
    Curve { name, points: items.iter().filter_map(|item| Some((iteration(item) as f64, value(item)?))).collect() }
}

/// Number of the primitives, mean ν and mean confidence over the iterations.
fn population(log: &[Record]) -> Vec<Curve<'static>> {
    let of = |name, value| curve(name, log, |record: &Record| record.iteration, value);
    vec![
        of("primitives", |record| Some(record.primitives as f64)),
        of("mean ν", |record| record.mean_nu),
        of("mean c", |record| record.confidence),
    ]
}

/// Facts of scan and run: label and value.
fn facts(dataset: &Dataset, config: &Config, outcome: &Outcome) -> Vec<(String, String)> {
    let detector = &dataset.scanner.detector;
    let mut facts = vec![
        ("Training views".into(), dataset.train.len().to_string()),
        ("Detector, rows × columns".into(), format!("{} × {}", detector.rows, detector.columns)),
        ("Volume".into(), dataset.scanner.grid.shape.map(|n| n.to_string()).join(" × ")),
        ("Voxel".into(), voxel(dataset)),
        ("Noise".into(), dataset.noise.to_string()),
        ("Seconds".into(), format!("{:.1}", outcome.seconds)),
    ];
    facts.extend(outcome.found.sampled.iter().map(|sampled| ("Volume sampled".into(), sampled.to_string())));
    if let Some(unit) = outcome.found.unit {
        facts.push(("Density that counted as 1, per scene unit".into(), format!("{unit:.4e}")));
    }
    for metric in outcome.evaluation.metrics.of_range().into_iter().flatten() {
        facts.push((metric.definition.clone(), format!("{:.4}", metric.value)));
    }
    facts.extend(dataset.notes.iter().map(|note| ("Note".into(), note.clone())));
    if let Some(last) = outcome.passes.last() {
        facts.push(("Iterations".into(), last.pass.iteration.to_string()));
    }
    if let Some(choice) = &outcome.found.choice {
        let how = match choice.folds {
            0 => "too few views for cross-validation".into(),
            _ => format!("chosen on held-out views at the cost of {:.0} iterations over all views", choice.cost),
        };
        facts.push((choice.key.clone(), format!("{}{}, {how}", words::value(choice.value), choice.details())));
    }
    if let Some(primitives) = &outcome.found.primitives {
        facts.push(("Primitives".into(), primitives.len().to_string()));
        facts.push(("Iterations".into(), config.iterations.to_string()));
        let last = outcome.found.log.last();
        if let Some(c) = last.and_then(|record| record.confidence) {
            facts.push(("Mean confidence".into(), format!("{c:.3}")));
        }
        if let Some(rho) = last.and_then(|record| record.spearman) {
            facts.push(("Spearman's ρ of ν and confidence".into(), format!("{rho:.2}")));
        }
    }
    facts
}

/// Test views, or else training views, beside those of the result: compared, and a few of them shown.
fn views(dataset: &Dataset, config: &Config, outcome: &Outcome) -> Result<(Agreement, Scene<'static>)> {
    let (views, kind) = dataset.test.as_ref().map_or((&dataset.train, "training"), |test| (test, "test"));
    let views = views.evenly_spaced(views.len().min(COMPARED_VIEWS))?;
    let rendered = reproject(
        dataset,
        &views,
        outcome.found.around.as_ref().unwrap_or(&outcome.found.volume),
        outcome.found.primitives.as_ref(),
        config,
    )?;
    let agreement = Agreement::new([&views, &rendered], &dataset.train, &dataset.scanner, dataset.test.is_none())?;
    let [views, rendered] = [&views, &rendered].map(|views| views.evenly_spaced(views.len().min(SHOWN_VIEWS)));
    let stacks = vec![("Measured", Cow::Owned(views?)), (outcome.name(), Cow::Owned(rendered?))];
    let title = format!("Projections of {kind} views");
    Ok((agreement, Scene::of_projections(&title, stacks, &dataset.scanner, &dataset.frame)?.reduced()))
}

/// The size of a voxel in the unit of the scan's files.
fn voxel(dataset: &Dataset) -> String {
    let (spacing, _) = dataset.frame.place(&dataset.scanner.grid);
    let sides = spacing.to_array().map(|side| side.to_string()).join(" × ");
    match dataset.frame.unit {
        Some(unit) => format!("{sides} {unit}; attenuation is per {unit}"),
        None => format!("{sides}, in the unit of the scan's files, which is not stated"),
    }
}

/// The confidence of the primitives, where the method uses it.
fn confidence(dataset: &Dataset, config: &Config, primitives: &Primitives) -> Option<Vec<f64>> {
    if config.method != Method::TrGs || !config.confidence.enabled && !config.wavelet.enabled {
        return None;
    }
    let settings = config.confidence.settings(config.seen(&dataset.scanner).grid.spacing.min_element());
    Some(Coverage::new(settings).confidence(primitives, &dataset.scanner, &dataset.train))
}

/// The file with the state of a run.
pub(super) fn checkpoint_file(run: &Path) -> PathBuf {
    run.join(CHECKPOINTS).join("last.msgpack")
}

/// The metrics of a finished run of `config`; `None` where its results are not those with these digests.
pub(super) fn metrics_of_results(
    run: &Path,
    digests: &BTreeMap<String, String>,
    config: &Config,
) -> Result<Option<serde_json::Value>> {
    let of_config =
        digests.get("config.toml").is_some_and(|digest| *digest == digest_bytes(config.to_toml().as_bytes()));
    let is_intact =
        |(name, digest): (&String, &String)| digest_file(&run.join(name)).is_ok_and(|found| found == *digest);
    if !of_config || !run.join("report.html").exists() || !digests.iter().all(is_intact) {
        return Ok(None);
    }
    let path = run.join("metrics.json");
    let text = std::fs::read(&path).map_err(|source| Error::read(&path, source))?;
    Ok(serde_json::from_slice(&text).ok())
}

fn write_text(path: &Path, text: &str) -> Result<()> {
    write_atomically(path, |file| file.write_all(text.as_bytes()))
}

fn json(value: &impl Serialize) -> String {
    serde_json::to_string_pretty(value).expect("results have string keys and no foreign serialisers") + "\n"
}
