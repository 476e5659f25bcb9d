//! `trgs reconstruct`: reconstructs a volume from a dataset and writes the folder of a run.

use super::arguments::{Replace, choice, positive, seed, word};
use super::corrections::CorrectionArgs;
use super::evaluate::{answer, answer_again};
use super::flags::with_flags;
use super::messages::warnings;
use super::progress::RunProgress;
use super::run_folder::{Outcome, RunFolder, Source, TimedPass, checkpoint_file, metrics_of_results};
use super::{Global, Output, interrupt};
use bytesize::ByteSize;
use clap::Args;
use serde_json::{Value, json};
use std::path::PathBuf;
use std::time::Instant;
use trgs::config::{Config, Method, Plan, Precision, Preset, Sampling, Start};
use trgs::evaluation::Metrics;
use trgs::geometry::Volume;
use trgs::memory::Estimate;
use trgs::numeric::threads;
use trgs::output::{Claim, Destination, Kind};
use trgs::projector::Projection;
use trgs::reconstruction::{Checkpoint, Checkpoints, Progress, Run, evaluate};
use trgs::scan::Dataset;
use trgs::scan::dataset::DatasetInfo;
use trgs::scan::plausibility::{self, AnglesFrom};
use trgs::train::{Decision, primitives_of_model};
use trgs::{Error, Result, Setting, Text, input, limit, words};

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
  trgs reconstruct data/torso --out out/clean --method tv --air auto --mask-pixels auto
  trgs reconstruct data/torso --out out/torso --resume
  trgs reconstruct data/torso --out out/torso --max-memory 3GB
  trgs reconstruct data/torso --out out/torso --resume --iterations 5000
  trgs reconstruct data/torso --out out/again --set initialisation.from=model --set initialisation.model=out/torso/model.npz

A value given by --set overrides a flag, a flag overrides FILE.toml, and FILE.toml overrides the method's default. \
The config.toml of any run lists and documents all keys.

--resume with more --iterations continues a run beyond its end. Other methods end with the bits \
of a run of so many iterations. tr-gs and r2-gaussian follow the schedule of the longer run (learning rates, sampler, \
density control) from the iteration reached; this is deterministic, but differs from the longer run from its start. They \
keep the sampling and the finish that the pilot run of the shorter run chose, unless --choose-again is given."
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
    #[arg(long, value_parser = choice(&Projection::ALL))]
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
    /// Published settings to start from: paper is the paper's method; the default adds exact rays, start, pilot run and finish
    #[arg(long, value_parser = choice(&Preset::ALL), conflicts_with = "config")]
    preset: Option<Preset>,
    /// Configuration file to start from
    #[arg(long, value_name = "FILE.toml")]
    config: Option<PathBuf>,
    /// Set a configuration key, for example loss.tv=0.1; may be repeated
    #[arg(long, value_name = "KEY=VALUE")]
    set: Vec<String>,
    #[command(flatten)]
    corrections: CorrectionArgs,
    /// Continue from the last checkpoint of RUN, bit-identical to an uninterrupted run; with more --iterations see below
    #[arg(long)]
    resume: bool,
    /// With --resume: let a pilot run choose sampling and finish again; without it the earlier choice is kept
    #[arg(long, requires = "resume")]
    choose_again: bool,
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
        self.allow(&config)?;
        let mut dataset = Dataset::read(&self.dataset)?;
        plausibility::check(&dataset, AnglesFrom::File).map_err(|error| error.in_file(&self.dataset))?;
        for note in &dataset.notes {
            tracing::info!("{}: {note}", self.dataset.display());
        }
        self.corrections.refuse_region("a scan")?;
        self.corrections.apply(&mut dataset, [false; 2])?;
        let oddities = dataset.oddities.iter().map(Text::from);
        let mut remarks: Vec<Text> =
            oddities.chain(plausibility::remarks_with(&dataset, config.model.margin)).collect();
        warnings(&self.dataset, remarks.iter().cloned());
        if let Some(n) = self.views {
            dataset.train = dataset.train.evenly_spaced(n)?;
        }
        let asked = config;
        let config = asked.plan(&dataset.scanner, dataset.train.len())?;
        if asked.wavelet.enabled && asked.method.fits_primitives() && !config.wavelet.enabled {
            let shape = dataset.scanner.grid.shape;
            let remark = format!("wavelets are left out: a volume of {shape:?} voxels is too thin for their blocks");
            tracing::warn!("{remark}");
            remarks.push(remark.into());
        }
        if let Some(saved) = &mut checkpoint {
            extend(saved, config.iterations)?;
            saved.check_config(&config)?;
            saved.check_data(&dataset)?;
            if let Some(metrics) = metrics_of_results(&self.out, saved.results(), &config)? {
                tracing::info!("{} is complete: nothing is left to do", self.out.display());
                return Ok(answer_again(metrics, self.context(config.method)));
            }
            tell_of_decision(saved, &config);
        } else if config.method.fits_primitives() && config.initialisation.from == Start::Model {
            let (_, of_model) = primitives_of_model(&config.seen(&dataset.scanner).grid, &config)?;
            of_model.iter().for_each(|remark| tracing::warn!("{remark}"));
            remarks.extend(of_model.iter().map(Text::from));
        }
        let checkpoints = Checkpoints { file: checkpoint_file(&self.out), from: checkpoint };
        let warnings = remarks.iter().map(with_flags).collect();
        let source = Source { scan: self.dataset.clone(), digests: input::digests()?, warnings };
        let outcome = reconstruct(&dataset, &config, claim, source, Some(checkpoints), None, global)
            .map_err(|error| self.with_command(error))?;
        tracing::info!("wrote {}: open it in a browser", self.out.join("report.html").display());
        let mut context = self.context(config.method);
        context["seconds"] = json!(outcome.seconds);
        Ok(answer(&outcome.evaluation, context))
    }

    /// What the result says besides the metrics.
    fn context(&self, method: Method) -> Value {
        json!({ "run": words::name(&self.out), "method": method, "report": words::name(self.out.join("report.html")) })
    }

    /// The error of an interrupted run with the command that goes on with it: its settings are in the checkpoint.
    fn with_command(&self, error: Error) -> Error {
        match error {
            Error::Interrupted { step, remedy } if remedy.names(Setting::Resume) => {
                let views = self.views.map_or(String::new(), |n| format!(" --views {n}"));
                let corrections = self.corrections.again();
                let [dataset, out] = [&self.dataset, &self.out].map(|path| words::quoted_path(path));
                let remedy = format!(
                    "its state is saved; go on with: trgs reconstruct {dataset} --out {out}{views}{corrections} --resume"
                );
                Error::Interrupted { step, remedy: remedy.into() }
            }
            other => other,
        }
    }

    /// Refuses a run that needs more memory than the limit, as far as it is known before the scan is read.
    fn allow(&self, config: &Config) -> Result<()> {
        let Some(scan) = DatasetInfo::read(&self.dataset)? else {
            let file = std::fs::metadata(&self.dataset).map_err(|source| Error::read(&self.dataset, source))?;
            return Estimate::of_file(file.len()).check(limit::bytes());
        };
        let views = self.views.map_or(scan.train, |n| n.min(scan.train));
        let plan = config.plan(&scan.scanner, views)?;
        Estimate::fitted(&scan, views, &plan, threads::count(), limit::bytes()).map(drop)
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
        let mut checkpoint = Checkpoint::read(&file)?;
        if self.choose_again {
            match &mut checkpoint {
                Checkpoint::Primitives(saved) => saved.forget_decision(),
                Checkpoint::Voxels(_) => {
                    let expected = "a run of tr-gs or r2-gaussian: a run on voxels began with its choice";
                    return Err(Error::invalid("--choose-again", "a run of another method", expected, "leave it out"));
                }
            }
        }
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
        Ok(config)
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
        Checkpoint::Voxels(_) => {
            let config = checkpoint.config()?;
            let drop = config.neural.drop.fixed().filter(|_| config.method.is_network());
            let rates = drop.map_or(String::new(), |drop| format!(" with neural.drop={drop}"));
            format!("the result is that of a run of {iterations} from its start{rates}")
        }
    };
    tracing::info!("continuing after iteration {done} to {iterations} instead of {before}: {meaning}");
    Ok(())
}

/// Says which choice a run keeps that goes on with another length than it was made for.
fn tell_of_decision(checkpoint: &Checkpoint, config: &Config) {
    let Checkpoint::Primitives(saved) = checkpoint else { return };
    let Some(Decision { iterations, sampling, finish, .. }) = saved.decision(config) else { return };
    if *iterations != config.iterations && config.has_pilot() {
        let finish = match config.has_open_finish() {
            true => format!(", a finish of tv.weight {}{}", words::value(finish.value), finish.details()),
            false => String::new(),
        };
        tracing::info!(
            "kept from the run of {iterations} iterations: sampling {}{finish}; --choose-again lets a pilot run of the \
             new length choose",
            word(sampling)
        );
    }
}

/// Reconstructs the dataset, read from `source`, and writes the run; `beside` is compared on its page.
///
/// Without `checkpoints`, an interrupted run leaves nothing.
pub(super) fn reconstruct(
    dataset: &Dataset,
    config: &Plan,
    claim: Claim,
    source: Source,
    checkpoints: Option<Checkpoints>,
    beside: Option<&Outcome>,
    global: &Global,
) -> Result<Outcome> {
    interrupt::shielded(|| {
        // Checked again with sizes that are known only after reading.
        let (info, views) = (DatasetInfo::of(dataset), dataset.train.len());
        let (plan, estimate) = Estimate::fitted(&info, views, config, threads::count(), limit::bytes())?;
        let folder = RunFolder::begin(claim, &plan, estimate.peak(), source)?;
        let config = &plan.with_files_in(&folder.path());
        tracing::info!(memory = estimate.peak(), parts = %estimate, "memory: at most {}", ByteSize(estimate.peak()));
        let slabs = config.division().slabs;
        if slabs > 1 {
            let lost = if config.method.fits_primitives() { "" } else { ": there are no checkpoints" };
            tracing::info!("volumes of total variation are in {slabs} slabs of files beside the result{lost}");
        }
        if let Some(installed) = limit::available().filter(|&installed| installed < estimate.peak()) {
            tracing::warn!("this machine has only {} of memory: the run may be slow or be killed", ByteSize(installed));
        }
        let began = Instant::now();
        let from = checkpoints.as_ref().and_then(|checkpoints| checkpoints.from.as_ref());
        let done = from.map_or(0, Checkpoint::iteration);
        let is_decided = from.is_some_and(|from| from.is_decided(config));
        let mut progress = RunProgress::new(dataset, config, done, is_decided, global);
        let mut passes = Vec::new();
        let keeps = checkpoints.is_some();
        let mut log = keeps.then(|| folder.log(from));
        let run = Run::planned(dataset, config).observe(|step| {
            match (&step, &mut log) {
                (Progress::Iteration(_, Some(record)), Some(log)) => log.write(record),
                (Progress::Pass(pass), log) if !config.method.fits_primitives() => {
                    let pass = TimedPass { pass: (*pass).clone(), seconds: began.elapsed().as_secs_f64() };
                    log.iter_mut().for_each(|log| log.write(&pass));
                    passes.push(pass);
                }
                _ => {}
            }
            progress.see(&step)
        });
        let run = match checkpoints {
            Some(checkpoints) => run.checkpoints(checkpoints),
            None => run,
        };
        let found = run.reconstruct()?;
        let seconds = began.elapsed().as_secs_f64();
        progress.evaluating();
        let seen = found.around.as_ref().unwrap_or(&found.volume);
        let evaluation = evaluate(dataset, seen, found.primitives.as_ref(), config)?;
        let metrics = |volume: &Volume| Metrics::compute(dataset.truth.as_ref().map(|truth| (truth, volume)), None);
        let before = found.unfinished.as_ref().map(metrics).transpose()?;
        drop(progress);
        if let Some(TimedPass { pass, .. }) = passes.last().filter(|last| last.pass.iteration < last.pass.iterations) {
            tracing::info!("converged after iteration {} of {}", pass.iteration, pass.iterations);
        }
        if let Some(sampled) = &found.sampled {
            let other = if sampled.sampling == Sampling::Interpolant { "point" } else { "interpolant" };
            let remedy =
                sampled.evidence.map_or(String::new(), |_| format!("; --set sampling={other} takes the other"));
            tracing::info!("volume: {sampled}{remedy}");
        }
        let outcome = Outcome { method: config.method, found, before, passes, seconds, evaluation };
        folder.finish(dataset, config, &outcome, beside, keeps)?;
        Ok(outcome)
    })
}
