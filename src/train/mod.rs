//! Training: the paper's loop. Reads like its pipeline; every number is computed elsewhere.
//!
//! ```text
//! first volume (FDK) → points → raw parameters; rays around them → confidence c → targets of ν
//! repeat:  raw → physical → field ─┬─ one view: image → L1, D-SSIM ──────────────────┐
//!                            │     ├─ a random block: voxels → TV ───────────────────┤
//!                            │     └─ now and then a block: voxels, routes → wavelets ┼→ gradient → raw gradient
//!                            └─ ν, c → pull on ν ─────────────────────────────────────┘        │
//!          now and then: who is needed is copied, who is not goes; c again  ←  SGHMC, Adam  ←──┘
//! ```

mod optimiser;
mod record;
mod start;
mod state;
mod views;

pub use record::Record;
pub use start::initial_primitives;
pub use state::{Checkpoint, Checkpoints};

use crate::classical::density_unit::{density_unit, in_unit};
use crate::confidence::{Coverage, nu_loss_into, nu_target, spearman};
use crate::config::{Config, DensityControl, KernelName, Precision};
use crate::density::{self, Successor, adc, ar};
use crate::error::{Error, Result};
use crate::loss::{Ssim, SsimTarget, image_loss_into, tv};
use crate::numeric::rng::{self, Purpose};
use crate::numeric::threads::{self, Lent, Spares};
use crate::numeric::{Real, real, reduce};
use crate::primitives::activation::Interval;
use crate::primitives::{Activation, Kernel, Parameters, Primitives};
use crate::projector::{Field, FieldGradient, Kernels, ViewField};
use crate::scene::dataset::Dataset;
use crate::scene::{Grid, Volume};
use crate::wavelet::{self, Router, Routing, wavelet_loss_into};
use ndarray::{Array2, Array3};
use optimiser::Step;
use rand::RngExt;
use rand_distr::StandardNormal;
use record::Losses;
use state::{State, digest};
use std::ops::ControlFlow;
use std::path::PathBuf;
use std::time::Instant;
use views::{ViewOrder, random_block};

/// Called after every iteration, with a record where one is due. `Break` stops the run.
pub type Observe<'a> = dyn FnMut(usize, Option<&Record>) -> ControlFlow<()> + 'a;

/// What a run ends with.
#[derive(Clone, Debug)]
pub struct Reconstruction {
    /// Physical parameters, densities in attenuation per scene unit.
    pub primitives: Primitives,
    /// The field at the voxel centres of the dataset's grid.
    pub volume: Volume,
    /// All reports.
    pub log: Vec<Record>,
    /// Attenuation per scene unit that counted as 1 in the run.
    pub unit: f64,
}

/// Reconstructs a dataset by fitting primitives to its training views. With `checkpoints` the state is kept in a file
/// from time to time, at the end and when `observe` stops the run; going on from it leads to the same bits.
///
/// The run works on projections divided by a unit of density U: `config.density_unit`, or where that is auto what
/// [`density_unit`] finds. All densities in the configuration and all losses are in units of U; densities of initial points
/// are divided by it, those of the result multiplied. So projections times k lead to densities times k: to the bit for a power
/// of two; otherwise up to the rounding of the pixels, which a run with large learning rates magnifies.
///
/// # Errors
/// For a configuration that does not fit the data or the checkpoint, a value that is not finite, a checkpoint that
/// cannot be written, or when `observe` stops the run.
pub fn train(
    dataset: &Dataset,
    config: &Config,
    checkpoints: Option<Checkpoints>,
    observe: &mut Observe<'_>,
) -> Result<Reconstruction> {
    let config = &config.resolved(&dataset.scanner, dataset.train.len());
    dataset.scanner.validate()?;
    let unit = config.density_unit.fixed().map_or_else(|| density_unit(&dataset.scanner, &dataset.train), Ok)?;
    let checkpoints = checkpoints.map(|checkpoints| (checkpoints, digest(dataset)));
    let dataset = &*in_unit(dataset, unit);
    match config.precision {
        Precision::F32 => Trainer::<f32>::new(dataset, unit, config, checkpoints)?.run(observe),
        Precision::F64 => Trainer::<f64>::new(dataset, unit, config, checkpoints)?.run(observe),
    }
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

fn kernel(config: &Config) -> Kernel {
    match config.model.kernel {
        KernelName::StudentT => Kernel::StudentT,
        KernelName::Gaussian => Kernel::Gaussian,
    }
}

/// The state of a run, and what follows from dataset and configuration.
struct Trainer<'a, R: Kernels> {
    /// In units of density.
    dataset: &'a Dataset,
    unit: f64,
    config: &'a Config,
    activation: Activation,
    coverage: Coverage,
    /// Where the pull on ν leads, for each primitive.
    targets: Vec<f64>,
    order: ViewOrder,
    ssim: Ssim<R>,
    images: Vec<SsimTarget<R>>,
    state: State,
    /// Where the state is kept, and the digest of the data that it belongs to.
    checkpoint: Option<(PathBuf, String)>,
}

/// What the losses of an iteration work in.
#[derive(Default)]
struct Spaces<R: Real> {
    images: Spares<Array2<R>>,
    volumes: Spares<Array3<R>>,
    tv: tv::Spaces<R>,
    routers: Spares<Router>,
    routings: Spares<Routing>,
    wavelets: wavelet::Spaces<R>,
    pulls: Spares<Vec<f64>>,
}

/// What an iteration makes anew from the raw parameters, in the memory of the one before.
struct Derived<R: Kernels> {
    physical: Primitives,
    field: Field<R>,
    spaces: Spaces<R>,
    /// To the physical parameters, then to the raw ones.
    gradient: Parameters,
    direction: Vec<[f64; 3]>,
}

impl<R: Kernels> Derived<R> {
    fn new(raw: &Parameters, activation: &Activation, cutoff: f64) -> Self {
        let physical = activation.forward(raw);
        let field = Field::new(&physical, cutoff);
        let (spaces, gradient) = (Spaces::default(), Parameters::default());
        Self { physical, field, spaces, gradient, direction: Vec::new() }
    }
}

impl<'a, R: Kernels> Trainer<'a, R> {
    /// Checkpoints go with the digest of the data as they were measured.
    fn new(
        dataset: &'a Dataset,
        unit: f64,
        config: &'a Config,
        checkpoints: Option<(Checkpoints, String)>,
    ) -> Result<Self> {
        let activation = Activation {
            kernel: kernel(config),
            scale: scales(&dataset.scanner.grid, config)?,
            nu: Interval { min: config.model.nu_min, max: config.model.nu_max },
        };
        let ssim = Ssim::<R>::default();
        let image = |view| dataset.train.image(view).mapv(|value| real::<R>(f64::from(value)));
        let images = (0..dataset.train.len()).map(|view| SsimTarget::new(&ssim, image(view).view())).collect();
        let (checkpoint, from) = checkpoints.map_or((None, None), |(c, data)| (Some((c.file, data)), c.from));
        let resumed = from.is_some();
        let state = match (from, &checkpoint) {
            (Some(from), Some((_, data))) => {
                from.check(data, config)?;
                from.state
            }
            _ => State::new(activation.inverse(&initial_primitives(dataset, config)?.parameters), config),
        };
        let mut trainer = Self {
            dataset,
            unit,
            config,
            activation,
            coverage: Coverage::new(config.confidence.settings()),
            targets: Vec::new(),
            order: ViewOrder::new(dataset.train.len(), config.seed),
            ssim,
            images,
            state,
            checkpoint,
        };
        if resumed {
            trainer.find_targets();
        } else {
            trainer.refresh_confidence();
        }
        Ok(trainer)
    }

    fn run(mut self, observe: &mut Observe<'_>) -> Result<Reconstruction> {
        let (began, before) = (Instant::now(), self.state.seconds);
        let iterations = self.config.iterations;
        let mut derived = Derived::new(&self.state.raw, &self.activation, self.config.cutoff);
        while self.state.iteration < iterations {
            let iteration = self.state.iteration + 1;
            let losses = self.step(iteration, &mut derived)?;
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
                Checkpoint::new(self.config, data.clone(), self.state.clone()).write(file)?;
            }
            if stop {
                return Err(Error::interrupted(iteration, self.checkpoint.is_some()));
            }
        }
        drop(derived);
        let mut primitives = self.activation.forward(&self.state.raw);
        primitives.parameters.density.iter_mut().for_each(|density| *density *= self.unit);
        let field = Field::<R>::new(&primitives, self.config.cutoff);
        let grid = self.dataset.scanner.grid;
        let volume = Volume::new(grid, field.voxels(&grid).mapv(|value| value.to_f64() as f32))?;
        Ok(Reconstruction { primitives, volume, log: self.state.log, unit: self.unit })
    }

    /// One iteration: one view, one or two blocks, one step of the optimisers, and what is due.
    fn step(&mut self, iteration: usize, derived: &mut Derived<R>) -> Result<Losses> {
        self.activation.forward_into(&self.state.raw, &mut derived.physical);
        derived.field.renew(&derived.physical);
        let losses = self.losses(iteration, derived)?;
        let Derived { physical, gradient, direction, .. } = derived;
        self.activation.vjp(physical, gradient);
        gradient.check_finite("gradient of the raw parameters", iteration)?;
        let State { raw, ids, optimiser, .. } = &mut self.state;
        optimiser.step(raw, gradient, direction, &Step { config: self.config, done: iteration - 1, physical, ids });
        self.control_density(iteration)?;
        if iteration.is_multiple_of(self.config.confidence.every) {
            self.refresh_confidence();
        }
        Ok(losses)
    }

    /// All losses that count in an iteration, and their gradient to the physical parameters.
    fn losses(&mut self, iteration: usize, derived: &mut Derived<R>) -> Result<Losses> {
        let Derived { physical, field, spaces, gradient, .. } = derived;
        let view = self.order.view(iteration - 1);
        // Side by side: while one waits for its last piece of work, the others have some.
        let (((mut losses, seen, mut of_view), tv), (wavelet, pull)) = threads::both(
            || threads::both(|| self.data_loss(field, spaces, view), || self.total_variation(field, spaces, iteration)),
            || {
                threads::both(
                    || self.wavelets(field, spaces, physical, iteration),
                    || self.pull_on_nu(spaces, physical),
                )
            },
        );
        if self.config.density_control.method == DensityControl::Adc {
            self.state.pulls.add(of_view.shadows(), seen.seen());
        }
        let wavelet = wavelet?;
        losses.tv = tv.as_ref().map_or(0.0, |(value, _)| *value);
        (losses.wavelet, losses.blocks) = wavelet.as_ref().map_or((0.0, 0), |(value, _)| (*value, 1));
        self.add_blocks(&mut of_view, [tv, wavelet].map(|block| block.map(|(_, gradient)| gradient)));
        field.finish_into(&of_view, gradient);
        if let Some((value, d_nu)) = pull {
            losses.nu = value;
            gradient.nu.iter_mut().zip(d_nu.iter()).for_each(|(gradient, d)| *gradient += d);
        }
        losses.total += self.config.loss.tv * losses.tv + losses.wavelet + losses.nu;
        Ok(losses)
    }

    /// L1 and D-SSIM of a view, and their gradient.
    fn data_loss<'f>(
        &self,
        field: &'f Field<R>,
        spaces: &Spaces<R>,
        view: usize,
    ) -> (Losses, ViewField<'f, R>, Lent<'f, FieldGradient>) {
        let seen = field.view(&self.dataset.scanner, self.dataset.train.angles[view], self.config.projection);
        let (mut image, mut cotangent) = (spaces.images.lend(), spaces.images.lend());
        seen.image_into(&mut image);
        let (target, weight) = (&self.images[view], self.config.loss.d_ssim);
        let [total, l1, d_ssim] = image_loss_into(&self.ssim, weight, image.view(), target, &mut cotangent);
        let mut gradient = field.lend_gradient();
        seen.pull_back(cotangent.view(), &mut gradient);
        (Losses { total, l1, d_ssim, ..Losses::default() }, seen, gradient)
    }

    /// Total variation of a random block of the volume, and its gradient, if it counts.
    fn total_variation<'f>(
        &self,
        field: &'f Field<R>,
        spaces: &Spaces<R>,
        iteration: usize,
    ) -> Option<(f64, Lent<'f, FieldGradient>)> {
        let (grid, loss) = (&self.dataset.scanner.grid, &self.config.loss);
        if loss.tv <= 0.0 {
            return None;
        }
        let block = random_block(grid, loss.tv_block, 1, self.config.seed, Purpose::TotalVariation, iteration);
        let there = field.on(&block);
        let (mut voxels, mut cotangent) = (spaces.volumes.lend(), spaces.volumes.lend());
        there.voxels_into(&mut voxels);
        let value = tv::tv_into(voxels.view(), &spaces.tv, &mut cotangent);
        cotangent.mapv_inplace(|d| d * real::<R>(loss.tv));
        let mut gradient = field.lend_gradient();
        there.pull_back(cotangent.view(), &mut gradient);
        Some((value, gradient))
    }

    /// The wavelet loss of a random block of the volume `[Eq. 11]`–`[Eq. 15]`, and its gradient, if it is due.
    fn wavelets<'f>(
        &self,
        field: &'f Field<R>,
        spaces: &Spaces<R>,
        physical: &Primitives,
        iteration: usize,
    ) -> Result<Option<(f64, Lent<'f, FieldGradient>)>> {
        let (grid, wavelet) = (&self.dataset.scanner.grid, &self.config.wavelet);
        if !(wavelet.enabled && iteration.is_multiple_of(wavelet.every)) {
            return Ok(None);
        }
        let multiple = 1 << wavelet.levels;
        let block = random_block(grid, wavelet.block, multiple, self.config.seed, Purpose::Wavelet, iteration);
        let settings = wavelet.settings();
        let (mut router, mut routing) = (spaces.routers.lend(), spaces.routings.lend());
        let (means, confidence) = (&physical.parameters.mean, &self.state.confidence);
        router.route_into(&block, means, confidence, &settings, &mut routing)?;
        let there = field.on(&block);
        let (mut voxels, mut cotangent) = (spaces.volumes.lend(), spaces.volumes.lend());
        there.voxels_into(&mut voxels);
        let [value, ..] = wavelet_loss_into(voxels.view(), &routing, &settings, &spaces.wavelets, &mut cotangent);
        let mut gradient = field.lend_gradient();
        there.pull_back(cotangent.view(), &mut gradient);
        Ok(Some((value, gradient)))
    }

    /// Adds the gradients of blocks to that of the view; they may leave the centres alone.
    fn add_blocks(&self, gradient: &mut FieldGradient, of_blocks: [Option<Lent<'_, FieldGradient>>; 2]) {
        let mut of_blocks = of_blocks.into_iter().flatten();
        if self.config.loss.blocks_move {
            of_blocks.for_each(|block| gradient.add(&block));
        } else if let Some(mut held) = of_blocks.next() {
            of_blocks.for_each(|block| held.add(&block));
            held.hold_centres();
            gradient.add(&held);
        }
    }

    /// The pull of ν towards its target `[Eq. 10]` and its gradient, if it counts.
    fn pull_on_nu<'f>(&self, spaces: &'f Spaces<R>, physical: &Primitives) -> Option<(f64, Lent<'f, Vec<f64>>)> {
        let settings = &self.config.confidence;
        let loss = || {
            let mut gradient = spaces.pulls.lend();
            let (nu, confidence) = (&physical.parameters.nu, &self.state.confidence);
            (nu_loss_into(nu, &self.targets, confidence, settings.weight, &mut gradient), gradient)
        };
        settings.enabled.then(loss)
    }

    /// Adds, moves and removes primitives if that is due.
    fn control_density(&mut self, iteration: usize) -> Result<()> {
        let control = &self.config.density_control;
        let part = iteration as f64 / self.config.iterations as f64;
        let due = iteration.is_multiple_of(control.every) && part > control.start && part <= control.stop;
        if !due {
            return Ok(());
        }
        let physical = self.activation.forward(&self.state.raw);
        let (seed, step) = (self.config.seed, iteration as u64);
        let successors = match control.method {
            DensityControl::None => return Ok(()),
            DensityControl::Adc => {
                let grid = &self.dataset.scanner.grid;
                let settings = adc::Settings {
                    gradient: control.gradient,
                    split_scale: control.split_scale * grid.size().max_element(),
                    faint: control.faint,
                    cap: control.cap,
                };
                let normals = |i: usize| {
                    let mut random = rng::stream(seed, Purpose::Splitting, step, self.state.ids[i]);
                    std::array::from_fn(|_| random.sample(StandardNormal))
                };
                adc::adc(&physical.parameters, &self.state.pulls.means(), &settings, grid, normals)
            }
            DensityControl::Ar => {
                let settings = ar::Settings {
                    dead: control.dead,
                    recycled: control.recycled,
                    growth: control.growth,
                    cap: control.cap,
                    relocation: control.relocation,
                };
                let mut random = rng::stream(seed, Purpose::Recycling, step, 0);
                let mut next = ar::ar(&physical, &settings, || random.random());
                let mut places = rng::stream(seed, Purpose::Splitting, step, 0);
                let normals = || std::array::from_fn(|_| places.sample(StandardNormal));
                density::spread(&physical.parameters, &mut next, control.spread, normals);
                next
            }
        };
        if successors.is_empty() {
            let expected = "at least one primitive that is neither faint nor outside of the volume";
            let remedy = "lower density_control.faint or the learning rates";
            return Err(Error::invalid(format!("density control at step {iteration}"), "none left", expected, remedy));
        }
        self.state.succeed(&physical.parameters, &successors, &self.activation);
        self.inherit_confidence(&successors);
        Ok(())
    }

    /// c of a new population: the fresh have their own, the others keep theirs until all are computed again.
    fn inherit_confidence(&mut self, successors: &[Successor]) {
        if self.state.confidence.is_empty() {
            return;
        }
        let physical = self.activation.forward(&self.state.raw);
        let (scanner, angles) = (&self.dataset.scanner, &self.dataset.train.angles);
        let fresh: Vec<usize> = (0..successors.len()).filter(|&row| successors[row].fresh).collect();
        let of_fresh = self.coverage.confidence_of(&fresh, &physical, scanner, angles);
        let mut confidence: Vec<f64> = successors.iter().map(|s| self.state.confidence[s.parent]).collect();
        fresh.into_iter().zip(of_fresh).for_each(|(row, c)| confidence[row] = c);
        self.state.confidence = confidence;
        self.find_targets();
    }

    /// Computes c `[Eq. 8]` and what follows from it, if anything asks for it.
    fn refresh_confidence(&mut self) {
        if self.config.confidence.enabled || self.config.wavelet.enabled {
            let physical = self.activation.forward(&self.state.raw);
            let (scanner, angles) = (&self.dataset.scanner, &self.dataset.train.angles);
            self.state.confidence = self.coverage.confidence(&physical, scanner, angles);
            self.find_targets();
        }
    }

    /// ν_target of every primitive `[Eq. 9]`.
    fn find_targets(&mut self) {
        let settings = self.config.confidence.settings();
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
            spearman: if confidence.is_empty() { None } else { spearman(&nu, confidence) },
            seconds: self.state.seconds,
        }
    }
}
