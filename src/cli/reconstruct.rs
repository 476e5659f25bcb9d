//! `trgs reconstruct`: reconstructs a volume from a dataset and writes the folder of a run.

use super::arguments::{Replace, choice, positive, seed};
use super::evaluate::answer;
use super::messages::{ProgressBar, warning};
use super::pace::Pace;
use super::run_folder::{Inputs, Outcome, RunFolder, TimedPass, checkpoint_file};
use super::{Global, Output, interrupt};
use bytesize::ByteSize;
use clap::Args;
use serde_json::json;
use std::path::PathBuf;
use std::time::Instant;
use trgs::config::{Config, Method, Precision, Preset, Start};
use trgs::evaluation::Metrics;
use trgs::input;
use trgs::memory::Estimate;
use trgs::numeric::threads;
use trgs::output::{Claim, Destination, Kind};
use trgs::projector::Projection;
use trgs::reconstruction::{Checkpoint, Checkpoints, Progress, Reconstruction, Run, evaluate};
use trgs::scene::dataset::DatasetInfo;
use trgs::scene::{Dataset, Volume, plausibility};
use trgs::train::{primitives_of_model, with_points_of_model};
use trgs::words;
use trgs::{Error, Result, limit};

/// Largest number of passes that --auto may choose, in units of the method's default.
const AUTO: usize = 10;

/// Reconstruct the volume of a dataset
#[derive(Args)]
#[command(
    allow_negative_numbers = true,
    after_help = "Examples:
  trgs reconstruct data/torso --out out/torso
  trgs reconstruct data/torso --out out/fdk --method fdk
  trgs reconstruct data/torso --out out/sart --method sart --preset sax-nerf
  trgs reconstruct data/torso --out out/tv --method tv
  trgs reconstruct data/torso --out out/cgls --method cgls --auto
  trgs reconstruct data/torso --out out/r2 --method r2-gaussian
  trgs reconstruct data/torso --out out/base --set confidence.enabled=false --set wavelet.enabled=false
  trgs reconstruct data/torso --out out/torso --resume
  trgs reconstruct data/torso --out out/torso --max-memory 3GB
  trgs reconstruct data/torso --out out/torso --resume --iterations 5000
  trgs reconstruct data/torso --out out/again --set initialisation.from=model --set initialisation.model=out/torso/model.npz

A value given by --set overrides a flag, a flag overrides FILE.toml, and FILE.toml overrides the method's default. \
The config.toml of any run lists and documents all keys.

--resume with more --iterations continues a run beyond its end. Other methods end with the bits \
of a run of so many iterations. tr-gs and r2-gaussian follow the schedule of the longer run (learning rates, sampler, \
density control) from the iteration reached; this is deterministic, but differs from the longer run from its start."
)]
pub(super) struct Reconstruct {
    /// Folder of the scan, its meta_data.json, or a pickle of NAF
    #[arg(value_name = "DATASET")]
    dataset: PathBuf,
    /// Folder to write; an older run of the same method in it is replaced at the end
    #[arg(long, value_name = "RUN")]
    out: PathBuf,
    #[command(flatten)]
    replace: Replace,
    /// Reconstruction method
    #[arg(long, value_parser = choice(&Method::ALL))]
    method: Option<Method>,
    /// Use only this number of training views, evenly spaced
    #[arg(long, value_name = "N")]
    views: Option<usize>,
    /// Number of training iterations [default: 140 per view]
    #[arg(long, value_name = "N", value_parser = positive)]
    iterations: Option<usize>,
    /// Initial number of primitives [default: from the surface of the volume]
    #[arg(long, value_name = "N", value_parser = positive)]
    points: Option<usize>,
    /// Projection of primitives: exact, or affine as in the paper
    #[arg(long, value_parser = choice(&[Projection::Exact, Projection::Affine]))]
    projection: Option<Projection>,
    /// Arithmetic of the pixel kernels
    #[arg(long, value_parser = choice(&Precision::ALL))]
    precision: Option<Precision>,
    /// Choose the passes of sart, os-sart, cgls on held-out views, up to --iterations or 10 times the default
    #[arg(long)]
    auto: bool,
    /// Seed of all random choices
    #[arg(long, value_name = "N", value_parser = seed)]
    seed: Option<u64>,
    /// Published settings to start from: of a comparison that has sart, os-sart or asd-pocs, or of the paper's own experiment
    #[arg(long, value_parser = choice(&Preset::ALL), conflicts_with = "config")]
    preset: Option<Preset>,
    /// Configuration file to start from
    #[arg(long, value_name = "FILE.toml")]
    config: Option<PathBuf>,
    /// Set a configuration key, for example loss.tv=0.1; may be repeated
    #[arg(long, value_name = "KEY=VALUE")]
    set: Vec<String>,
    /// Continue from the last checkpoint of RUN, bit-identical to an uninterrupted run; with more --iterations see below
    #[arg(long)]
    resume: bool,
}

impl Reconstruct {
    pub(super) fn run(&self, global: &Global) -> Result<Output> {
        // A configuration in RUN would be deleted, unless the run writes it again.
        if let Some(config) = self.config.as_ref().filter(|config| **config != self.out.join("config.toml")) {
            Destination::new(&self.out, Kind::Run, "").overwrite(self.replace.overwrite).input(config).check()?;
        }
        let claim = RunFolder::claim(&self.out, &self.dataset, self.replace.overwrite)?;
        let mut checkpoint = self.checkpoint()?;
        let config = self.config(&mut checkpoint)?;
        self.estimate(&config)?.check(limit::bytes())?;
        let mut dataset = Dataset::read(&self.dataset)?;
        for oddity in dataset.oddities.iter().chain(&plausibility::remarks(&dataset)) {
            warning(&self.dataset, oddity);
        }
        for note in &dataset.notes {
            tracing::info!("{}: {note}", self.dataset.display());
        }
        if let Some(n) = self.views {
            dataset.train = dataset.train.evenly_spaced(n)?;
        }
        let asked = config;
        let config = asked.resolved(&dataset.scanner, dataset.train.len());
        if asked.wavelet.enabled && asked.method.fits_primitives() && !config.wavelet.enabled {
            let shape = dataset.scanner.grid.shape;
            tracing::warn!("wavelets are left out: a volume of {shape:?} voxels is too thin for their blocks");
        }
        if let Some(saved) = &mut checkpoint {
            extend(saved, config.iterations)?;
            saved.check_config(&config)?;
            tell_of_pilot(saved, &config);
        } else if config.method.fits_primitives() && config.initialisation.from == Start::Model {
            let (_, remarks) = primitives_of_model(&dataset.scanner.grid, &config)?;
            remarks.iter().for_each(|remark| tracing::warn!("{remark}"));
        }
        let checkpoints = Checkpoints { file: checkpoint_file(&self.out), from: checkpoint };
        let inputs = input::digests()?;
        let outcome = reconstruct(&dataset, &config, claim, inputs, Some(checkpoints), None, global)?;
        let report = self.out.join("report.html");
        tracing::info!("wrote {}: open it in a browser", report.display());
        let context = json!({ "run": words::name(&self.out), "method": config.method, "seconds": outcome.seconds, "report": words::name(&report) });
        Ok(answer(&outcome.evaluation, context))
    }

    /// The memory that the run needs, as far as it is known before the scan is read.
    fn estimate(&self, config: &Config) -> Result<Estimate> {
        let Some(scan) = DatasetInfo::read(&self.dataset)? else {
            let file = std::fs::metadata(&self.dataset).map_err(|source| Error::read(&self.dataset, source))?;
            return Ok(Estimate::of_file(file.len()));
        };
        let views = self.views.map_or(scan.train, |n| n.min(scan.train));
        Ok(Estimate::new(&scan, views, config, threads::count()))
    }

    /// The checkpoint to resume from.
    ///
    /// Without one, a resumed run starts at the beginning, so that one command can be repeated after every crash.
    fn checkpoint(&self) -> Result<Option<Checkpoint>> {
        let file = checkpoint_file(&self.out);
        if !self.resume {
            return Ok(None);
        }
        if !file.exists() {
            tracing::warn!("{} does not exist: starting from the beginning", file.display());
            return Ok(None);
        }
        let checkpoint = Checkpoint::read(&file)?;
        tracing::info!("resuming after iteration {}", checkpoint.iteration());
        Ok(Some(checkpoint))
    }

    /// The configuration of the checkpoint or file, changed by flags, then by --set.
    fn config(&self, checkpoint: &mut Option<Checkpoint>) -> Result<Config> {
        let method = self.method.unwrap_or(Method::TrGs);
        let mut config = match (&self.config, &checkpoint) {
            (Some(file), _) => Config::read(file, method)?,
            (None, Some(checkpoint)) => checkpoint.config()?,
            (None, None) => Config::of(method),
        };
        config.method = self.method.unwrap_or(config.method);
        if let (Some(preset), None) = (self.preset, &checkpoint) {
            config.apply(preset);
        }
        if self.auto {
            config.algebraic.auto = true;
            if checkpoint.is_none() {
                config.iterations *= AUTO;
            }
        }
        config.iterations = self.iterations.unwrap_or(config.iterations);
        config.model.points = self.points.unwrap_or(config.model.points);
        config.projection = self.projection.unwrap_or(config.projection);
        config.precision = self.precision.unwrap_or(config.precision);
        config.seed = self.seed.unwrap_or(config.seed);
        self.set.iter().try_for_each(|setting| config.set(setting))?;
        // A configuration from a file is compared once it is complete.
        if let (Some(checkpoint), None) = (checkpoint.as_mut(), &self.config) {
            extend(checkpoint, config.iterations)?;
            checkpoint.check_config(&config)?;
        }
        config.validate()?;
        if checkpoint.is_some() { Ok(config) } else { with_points_of_model(&config) }
    }
}

/// Makes a checkpoint one of a run of `iterations`, and says what that means.
fn extend(checkpoint: &mut Checkpoint, iterations: usize) -> Result<()> {
    let (before, done) = (checkpoint.config()?.iterations, checkpoint.iteration());
    if iterations == before {
        return Ok(());
    }
    checkpoint.extend(iterations)?;
    let meaning = match checkpoint {
        Checkpoint::Primitives(_) => format!(
            "learning rates, sampler and density control follow the schedule of {iterations} iterations from here, so the \
             result differs from a run of {iterations} from its start"
        ),
        Checkpoint::Voxels(_) => format!("the result is that of a run of {iterations} from its start"),
    };
    tracing::info!("continuing after iteration {done} to {iterations} instead of {before}: {meaning}");
    Ok(())
}

/// Says that a pilot run decides again for a run that was continued.
fn tell_of_pilot(checkpoint: &Checkpoint, config: &Config) {
    if matches!(checkpoint, Checkpoint::Primitives(saved) if saved.is_continued()) && config.has_pilot() {
        tracing::warn!(
            "a pilot run of the new length decides sampling and finish anew; what it decided before can be kept with \
             --set sampling=... --set tv.weight=... --set tv.finish_iterations=..., from the report of the shorter run"
        );
    }
}

/// Reconstructs the dataset, read from `inputs`, and writes the run; `beside` is compared on its page.
///
/// Without `checkpoints`, an interrupted run leaves nothing.
pub(super) fn reconstruct(
    dataset: &Dataset,
    config: &Config,
    claim: Claim,
    inputs: Inputs,
    checkpoints: Option<Checkpoints>,
    beside: Option<&Outcome>,
    global: &Global,
) -> Result<Outcome> {
    interrupt::shielded(|| {
        let estimate = Estimate::new(&DatasetInfo::of(dataset), dataset.train.len(), config, threads::count());
        // Checked again with sizes that are known only after reading.
        estimate.check(limit::bytes())?;
        let folder = RunFolder::begin(claim, config, estimate.peak(), inputs)?;
        tracing::info!(memory = estimate.peak(), "needs at most {estimate}");
        if let Some(installed) = limit::available().filter(|&installed| installed < estimate.peak()) {
            tracing::warn!("this machine has only {} of memory: the run may be slow or be killed", ByteSize(installed));
        }
        let began = Instant::now();
        let mut bar = ProgressBar::new(config.iterations, global);
        let done =
            checkpoints.as_ref().and_then(|checkpoints| checkpoints.from.as_ref()).map_or(0, Checkpoint::iteration);
        let (mut passes, mut pace) = (Vec::new(), Pace::new(config, done));
        let run = Run::new(dataset, config).observe(|step| {
            pace.tell(&step);
            match step {
                Progress::Iteration(iteration, record) => bar.observe(iteration, record),
                Progress::Choosing(key, trial) => bar.trial(key, trial),
                Progress::Pass(pass) if config.method.fits_primitives() => bar.finish(pass),
                Progress::Pass(pass) => {
                    let seconds = began.elapsed().as_secs_f64();
                    passes.push(TimedPass { pass: pass.clone(), seconds });
                    bar.pass(pass, seconds)
                }
            }
        });
        let run = match checkpoints {
            Some(checkpoints) => run.checkpoints(checkpoints),
            None => run,
        };
        let found = run.reconstruct()?;
        let Reconstruction { primitives, volume, unfinished, log, sampled, unit, choice, continued } = found;
        drop(bar);
        if let Some(unit) = unit {
            tracing::info!(unit, "a density of {unit:.4e} per scene unit counted as 1 (density_unit)");
        }
        if let Some(TimedPass { pass, .. }) = passes.last().filter(|last| last.pass.iteration < last.pass.iterations) {
            tracing::info!("converged after iteration {} of {}", pass.iteration, pass.iterations);
        }
        let seconds = began.elapsed().as_secs_f64();
        let evaluation = evaluate(dataset, &volume, primitives.as_ref(), config)?;
        let metrics = |volume: &Volume| Metrics::compute(dataset.truth.as_ref().map(|truth| (truth, volume)), None);
        let unfinished = unfinished.map(|volume| metrics(&volume).map(|metrics| (volume, metrics))).transpose()?;
        if let Some(sampled) = &sampled {
            tracing::info!("{sampled}");
        }
        let method = config.method;
        let outcome = Outcome {
            method,
            primitives,
            volume,
            unfinished,
            log,
            passes,
            choice,
            seconds,
            unit,
            evaluation,
            sampled,
            continued,
        };
        folder.finish(dataset, config, &outcome, beside)?;
        Ok(outcome)
    })
}
