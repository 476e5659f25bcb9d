//! Training: the paper's loop, in the order of its pipeline. The arithmetic is in other modules.
//!
//! ```text
//! first volume (SART) → points → raw parameters; rays around them → confidence c → targets of ν
//! repeat:  raw → physical → field ─┬─ one view: image → L1, D-SSIM ────────────────────┐
//!                            │     ├─ a random block: voxels → TV ─────────────────────┤
//!                            │     └─ every few steps a block: voxels, routes → wavelets ┼→ gradient → raw gradient
//!                            └─ ν, c → ν loss ───────────────────────────────────────────┘        │
//!          every few steps: density control (clone, split, prune); recompute c  ←  SGHMC, Adam  ←──┘
//! ```

mod checkpoint;
mod losses;
mod optimiser;
mod record;
mod start;
mod state;
#[cfg(feature = "oracle")]
mod trace;
mod views;

pub use checkpoint::{Checkpoint, Checkpoints, Decision};
pub(crate) use checkpoint::{MOST_ITERATIONS, check_digest, check_extension, config_of, digest};
pub use record::Record;
pub use start::{initial_primitives, primitives_of_model};
#[cfg(feature = "oracle")]
pub use trace::trace;

use crate::classical::density_unit::density_unit;
use crate::confidence::{Coverage, nu_target, spearman};
use crate::config::{Config, DensityControl, Plan, Start};
use crate::density::{self, NextPrimitive, adc, ar};
use crate::error::{Error, Result};
use crate::geometry::{Grid, Volume};
use crate::loss::{Ssim, SsimTarget};
use crate::numeric::rng::{self, Purpose};
use crate::numeric::{real, reduce};
use crate::primitives::activation::Interval;
use crate::primitives::{Activation, Primitives};
use crate::projector::{Field, Kernels};
use crate::scan::dataset::Dataset;
use losses::{DataTerm, IterationState, LossInputs};
use optimiser::Step;
use rand::RngExt;
use rand_distr::StandardNormal;
use record::Losses;
use state::State;
use std::borrow::Cow;
use std::ops::ControlFlow;
use std::path::PathBuf;
use std::time::Instant;
use trgs_core::in_precision;
use trgs_methods::internals::in_unit;
use views::ViewOrder;

/// Called after every iteration, with a record where one is due. `Break` stops the run.
pub type Observe<'a> = dyn FnMut(usize, Option<&Record>) -> ControlFlow<()> + 'a;

/// The result of training.
#[derive(Clone, Debug)]
pub struct TrainedModel {
    /// Physical parameters, densities in attenuation per scene unit.
    pub primitives: Primitives,
    /// The field at the voxel centres of the dataset's grid.
    pub volume: Volume,
    /// All records.
    pub log: Vec<Record>,
    /// The unit of density of the run, attenuation per scene unit.
    pub unit: f64,
    /// Iterations after which the run was given another number of iterations: see [`Checkpoint::extend`].
    pub continued: Vec<usize>,
    /// What a pilot run decided before the run was resumed, if it is kept: see [`Checkpoint::decision`].
    pub decision: Option<Decision>,
}

/// Reconstructs a dataset by fitting primitives to its training views.
///
/// The training sees the scan on pixels and voxels that are `config.coarse` times as long. The volume is on the dataset's
/// grid.
///
/// With `checkpoints` the state is written to a file at intervals, at the end, and when `observe` stops the run. A resumed
/// run has the same bits. [`Checkpoint::extend`] continues a run beyond its end.
///
/// Projections are divided by a unit of density U: `config.density_unit`, or [`density_unit`] where that is auto. All
/// densities in the configuration and all losses are in units of U. Densities of initial points are divided by U, those of
/// the result multiplied. Projections times k therefore lead to densities times k: to the bit for a power of two, else up
/// to the rounding of the pixels, which large learning rates amplify.
///
/// # Errors
/// For a configuration that does not fit the data or the checkpoint, a value that is not finite, a checkpoint that
/// cannot be written, or when `observe` stops the run.
pub fn train(
    dataset: &Dataset,
    config: &Plan,
    checkpoints: Option<Checkpoints>,
    observe: &mut Observe<'_>,
) -> Result<TrainedModel> {
    dataset.scanner.validate()?;
    let (grid, checkpoints) = (dataset.scanner.grid, checkpoints.map(|checkpoints| (checkpoints, digest(dataset))));
    let dataset = &*seen(dataset, config);
    let unit = unit_of(dataset, config)?;
    let dataset = &*in_unit(dataset, unit);
    in_precision!(config.precision, R => Trainer::<R>::new(dataset, unit, config, checkpoints)?.run(&grid, observe))
}

/// The scan as the training sees it.
pub(crate) fn seen<'a>(dataset: &'a Dataset, config: &Config) -> Cow<'a, Dataset> {
    if config.coarse > 1 { Cow::Owned(dataset.coarser(config.coarse)) } else { Cow::Borrowed(dataset) }
}

/// The unit of density of a run.
pub(crate) fn unit_of(dataset: &Dataset, config: &Plan) -> Result<f64> {
    config.density_unit.fixed().map_or_else(|| density_unit(&dataset.scanner, &dataset.train), Ok)
}

/// The range of the scales on a grid, scene units.
fn scales(grid: &Grid, config: &Config) -> Result<Interval> {
    let voxel = grid.spacing.min_element();
    let (min, max) = (config.model.smallest_scale * voxel, config.model.scale_max * grid.size().max_element());
    if min >= max {
        let expected = format!("less than model.scale_max = {} of the longest side", config.model.scale_max);
        let remedy = format!("set it below {:.3}", max / voxel);
        return Err(Error::invalid("model.smallest_scale", config.model.smallest_scale, expected, remedy));
    }
    Ok(Interval { min, max })
}

/// The state of a run, with all that depends on dataset and configuration.
struct Trainer<'a, R: Kernels> {
    /// Projections in units of `unit`.
    dataset: &'a Dataset,
    unit: f64,
    config: &'a Plan,
    activation: Activation,
    coverage: Coverage,
    /// ν_target of each primitive `[Eq. 9]`.
    targets: Vec<f64>,
    order: ViewOrder,
    ssim: Ssim<R>,
    images: Vec<SsimTarget<R>>,
    state: State,
    current: IterationState<R>,
    /// The checkpoint's file, and the digest of the data that it belongs to.
    checkpoint: Option<(PathBuf, String)>,
    /// What a pilot run decided before.
    decision: Option<Decision>,
}

impl<'a, R: Kernels> Trainer<'a, R> {
    /// `checkpoints` come with the digest of the measured data.
    fn new(
        dataset: &'a Dataset,
        unit: f64,
        config: &'a Plan,
        checkpoints: Option<(Checkpoints, String)>,
    ) -> Result<Self> {
        let activation = Activation {
            kernel: config.model.kernel,
            scale: scales(&dataset.scanner.grid, config)?,
            nu: Interval { min: config.model.nu_min, max: config.model.nu_max },
        };
        let ssim = Ssim::<R>::default();
        let image = |view| dataset.train.image(view).mapv(|value| real::<R>(f64::from(value)));
        let images = (0..dataset.train.len()).map(|view| SsimTarget::new(&ssim, image(view).view())).collect();
        let (checkpoint, from) = checkpoints.map_or((None, None), |(c, data)| (Some((c.file, data)), c.from));
        let resumed = from.is_some();
        let decision = from.as_ref().and_then(|from| from.decision(config).cloned());
        let state = match (from, &checkpoint) {
            (Some(from), Some((_, data))) => {
                from.check(data, config)?;
                from.state
            }
            _ => {
                let mut parameters = initial_primitives(dataset, config)?.parameters;
                if config.initialisation.from == Start::Model {
                    parameters.density.iter_mut().for_each(|density| *density /= unit);
                }
                State::new(activation.inverse(&parameters), config)
            }
        };
        let mut trainer = Self {
            dataset,
            unit,
            config,
            activation,
            coverage: Coverage::new(config.confidence.settings(dataset.scanner.grid.spacing.min_element())),
            targets: Vec::new(),
            order: ViewOrder::new(dataset.train.len(), config.seed),
            ssim,
            images,
            state,
            current: IterationState::new(&activation, config.cutoff),
            checkpoint,
            decision,
        };
        if resumed {
            trainer.find_targets();
        } else {
            trainer.refresh_confidence();
        }
        Ok(trainer)
    }

    /// Trains; `grid` is that of the volume.
    fn run(mut self, grid: &Grid, observe: &mut Observe<'_>) -> Result<TrainedModel> {
        let (began, before) = (Instant::now(), self.state.seconds);
        let iterations = self.config.iterations;
        while self.state.iteration < iterations {
            let iteration = self.state.iteration + 1;
            let losses = self.step(iteration)?;
            self.state.iteration = iteration;
            self.state.sums.add(&losses);
            self.state.summed += 1;
            self.state.seconds = before + began.elapsed().as_secs_f64();
            let report = iteration.is_multiple_of(self.config.report_every) || iteration == iterations;
            if report {
                let record = self.record();
                self.state.log.push(record);
                (self.state.sums, self.state.summed) = (Losses::default(), 0);
            }
            let stop = observe(iteration, self.state.log.last().filter(|_| report)).is_break();
            let save = iteration.is_multiple_of(self.config.checkpoint_every) || iteration == iterations || stop;
            if save && let Some((file, data)) = &self.checkpoint {
                let (state, decision) = (self.state.clone(), self.decision.clone());
                Checkpoint::new(self.config, data.clone(), state, decision).write(file)?;
            }
            if stop {
                return Err(Error::interrupted(iteration, self.checkpoint.is_some()));
            }
        }
        drop(self.current);
        let mut primitives = self.activation.forward(&self.state.raw);
        primitives.parameters.density.iter_mut().for_each(|density| *density *= self.unit);
        let field = Field::<R>::new(&primitives, self.config.cutoff);
        let volume = Volume::new(*grid, field.on(grid).voxels_in_single())?;
        let State { log, continued, .. } = self.state;
        Ok(TrainedModel { primitives, volume, log, unit: self.unit, continued, decision: self.decision })
    }

    /// One iteration: one view, one or two blocks, one step of the optimisers; density control and confidence if due.
    fn step(&mut self, iteration: usize) -> Result<Losses> {
        let losses = self.fit(iteration)?;
        self.control_density(iteration)?;
        if iteration.is_multiple_of(self.config.confidence.every) {
            self.refresh_confidence();
        }
        Ok(losses)
    }

    /// The losses, and one step of the optimisers.
    fn fit(&mut self, iteration: usize) -> Result<Losses> {
        self.current.update(&self.state.raw, &self.activation);
        let losses = self.losses(iteration)?;
        let IterationState { physical, gradient, direction, .. } = &mut self.current;
        self.activation.vjp(physical, gradient);
        gradient.check_finite("gradient of the raw parameters", iteration)?;
        let State { raw, ids, optimiser, .. } = &mut self.state;
        optimiser.step(raw, gradient, direction, &Step { config: self.config, done: iteration - 1, physical, ids });
        Ok(losses)
    }

    /// All losses that are due; writes their gradient to the physical parameters.
    fn losses(&mut self, iteration: usize) -> Result<Losses> {
        let view = self.order.view(iteration - 1);
        let Self { dataset, config, ssim, images, targets, state, current, .. } = self;
        let IterationState { physical, field, workspace, gradient, .. } = current;
        let inputs = LossInputs {
            iteration,
            dataset,
            config,
            ssim,
            image: &images[view],
            view: dataset.train.trajectory().view(&dataset.scanner, view),
            nu_targets: targets,
            confidence: &state.confidence,
            physical,
            field,
            workspace,
        };
        let terms = inputs.all()?;
        if config.density_control.method == DensityControl::Adc {
            let DataTerm { view, gradient, .. } = &terms.data;
            state.gradient_stats.add(gradient.mean2d_gradients(), view.seen());
        }
        let losses = terms.values(config);
        terms.gradient_into(field, config, gradient);
        Ok(losses)
    }

    /// Whether density control is due after an iteration.
    fn controls_density(&self, iteration: usize) -> bool {
        let control = &self.config.density_control;
        let part = iteration as f64 / self.config.iterations as f64;
        iteration.is_multiple_of(control.every) && part > control.start && part <= control.stop.or(1.0)
    }

    /// Adds, moves and removes primitives if due.
    fn control_density(&mut self, iteration: usize) -> Result<()> {
        let control = &self.config.density_control;
        if !self.controls_density(iteration) {
            return Ok(());
        }
        let physical = self.activation.forward(&self.state.raw);
        let (seed, step) = (self.config.seed, iteration as u64);
        let next = match control.method {
            DensityControl::None => return Ok(()),
            DensityControl::Adc => {
                let grid = &self.dataset.scanner.grid;
                let settings = adc::Settings {
                    gradient: control.gradient.or(0.0),
                    split_scale: control.split_scale * grid.size().max_element(),
                    faint: control.faint,
                    cap: control.cap,
                };
                let normals = |i: usize| {
                    let mut random = rng::stream(seed, Purpose::Splitting, step, self.state.ids[i]);
                    std::array::from_fn(|_| random.sample(StandardNormal))
                };
                adc::adc(&physical.parameters, &self.state.gradient_stats.means(), &settings, grid, normals)
            }
            DensityControl::Ar => self.recycled(&physical, iteration, |_| (), |_| ()),
        };
        if next.is_empty() {
            let expected = "at least one primitive that is neither faint nor outside of the volume";
            let remedy = "lower density_control.faint or the learning rates";
            return Err(Error::invalid(format!("density control at step {iteration}"), "none left", expected, remedy));
        }
        self.state.replace_population(&physical.parameters, &next, control.reset_parents, &self.activation);
        self.inherit_confidence(&next);
        Ok(())
    }

    /// The population after adding and recycling; the random numbers that it takes are shown.
    fn recycled(
        &self,
        physical: &Primitives,
        iteration: usize,
        mut drawn: impl FnMut(f64),
        mut placed: impl FnMut([f64; 3]),
    ) -> Vec<NextPrimitive> {
        let (control, step) = (&self.config.density_control, iteration as u64);
        let settings = ar::Settings {
            dead: control.dead,
            recycled: control.recycled,
            growth: control.growth,
            cap: control.cap,
            relocation: control.relocation,
        };
        let mut random = rng::stream(self.config.seed, Purpose::Recycling, step, 0);
        let mut next = ar::ar(physical, &settings, || {
            let uniform = random.random();
            drawn(uniform);
            uniform
        });
        let mut places = rng::stream(self.config.seed, Purpose::Splitting, step, 0);
        density::spread(&physical.parameters, &mut next, control.spread, || {
            let normals = std::array::from_fn(|_| places.sample(StandardNormal));
            placed(normals);
            normals
        });
        next
    }

    /// c of a new population: computed for fresh primitives, inherited by the others until the next recomputation.
    fn inherit_confidence(&mut self, next: &[NextPrimitive]) {
        if self.state.confidence.is_empty() {
            return;
        }
        let physical = self.activation.forward(&self.state.raw);
        let (scanner, views) = (&self.dataset.scanner, &self.dataset.train);
        let fresh: Vec<usize> = (0..next.len()).filter(|&row| next[row].fresh).collect();
        let of_fresh = self.coverage.confidence_of(&fresh, &physical, scanner, views);
        let mut confidence: Vec<f64> = next.iter().map(|s| self.state.confidence[s.parent]).collect();
        fresh.into_iter().zip(of_fresh).for_each(|(row, c)| confidence[row] = c);
        self.state.confidence = confidence;
        self.find_targets();
    }

    /// Computes c `[Eq. 8]` and the targets of ν, if a loss needs them.
    fn refresh_confidence(&mut self) {
        if self.config.confidence.enabled || self.config.wavelet.enabled {
            let physical = self.activation.forward(&self.state.raw);
            let (scanner, views) = (&self.dataset.scanner, &self.dataset.train);
            self.state.confidence = self.coverage.confidence(&physical, scanner, views);
            self.find_targets();
        }
    }

    /// ν_target of every primitive `[Eq. 9]`.
    fn find_targets(&mut self) {
        let settings = self.coverage.settings();
        let target = |&c: &f64| nu_target(c, &settings, self.activation.nu);
        self.targets = self.state.confidence.iter().map(target).collect();
    }

    /// The means since the last record.
    fn record(&self) -> Record {
        let State { sums, confidence, .. } = &self.state;
        let mean = |total: f64| total / self.state.summed as f64;
        let nu = self.activation.forward(&self.state.raw).parameters.nu;
        Record {
            iteration: self.state.iteration,
            iterations: self.config.iterations,
            loss: mean(sums.total),
            l1: mean(sums.l1),
            d_ssim: mean(sums.d_ssim),
            tv: mean(sums.tv),
            nu: mean(sums.nu),
            wavelet: sums.wavelet / sums.blocks.max(1) as f64,
            primitives: self.state.raw.len(),
            confidence: (!confidence.is_empty()).then(|| reduce::sum(confidence) / confidence.len() as f64),
            mean_nu: Some(reduce::sum(&nu) / nu.len() as f64).filter(|mean| mean.is_finite()),
            spearman: if confidence.is_empty() { None } else { spearman(&nu, confidence) },
            seconds: self.state.seconds,
        }
    }
}
