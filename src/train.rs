//! Training: the paper's loop. Reads like its pipeline; every number is computed elsewhere.
//!
//! ```text
//! first volume (FDK) → points → raw parameters
//! repeat:  raw → physical → field ─┬─ one view: image → L1, D-SSIM ─┐
//!                                  └─ a random block: voxels → TV ──┴→ gradient → raw gradient → step
//! ```

use crate::classical::fdk::{Window, fdk};
use crate::config::{Config, DensityControl, KernelName, PositionOptimiser, Precision, Start};
use crate::error::{Error, Result};
use crate::loss::{Ssim, SsimTarget, image_loss, tv::tv};
use crate::numeric::rng;
use crate::optim::{Adam, Exponential};
use crate::primitives::activation::Interval;
use crate::primitives::initialisation::{self, Point};
use crate::primitives::{Activation, Group, Kernel, Parameters, Primitives};
use crate::projector::{Field, Kernels};
use crate::scene::dataset::Dataset;
use crate::scene::{Grid, Volume};
use glam::DVec3;
use rand::RngExt;
use rand::seq::SliceRandom;
use serde::Serialize;
use std::ops::ControlFlow;
use std::time::Instant;

/// A report on the state of a run: means over the iterations since the last one.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Record {
    /// Iterations done.
    pub iteration: usize,
    /// Iterations of the whole run.
    pub iterations: usize,
    /// What is minimised.
    pub loss: f64,
    /// Mean absolute difference of the projections.
    pub l1: f64,
    /// 1 - SSIM of the projections.
    pub d_ssim: f64,
    /// Total variation of the blocks.
    pub tv: f64,
    /// Number of primitives.
    pub primitives: usize,
    /// Seconds since training began.
    pub seconds: f64,
}

/// Called after every iteration, with a record where one is due. `Break` stops the run.
pub type Observe<'a> = dyn FnMut(usize, Option<&Record>) -> ControlFlow<()> + 'a;

/// What a run ends with.
#[derive(Clone, Debug)]
pub struct Reconstruction {
    /// Physical parameters.
    pub primitives: Primitives,
    /// The field on the dataset's grid.
    pub volume: Volume,
    /// All reports.
    pub log: Vec<Record>,
}

/// Reconstructs a dataset by fitting primitives to its training views.
///
/// # Errors
/// For a configuration that does not fit the data, a value that is not finite, or when `observe` stops the run.
pub fn train(dataset: &Dataset, config: &Config, observe: &mut Observe<'_>) -> Result<Reconstruction> {
    match config.precision {
        Precision::F32 => Trainer::<f32>::new(dataset, config)?.run(observe),
        Precision::F64 => Trainer::<f64>::new(dataset, config)?.run(observe),
    }
}

/// The primitives that a run starts from.
///
/// # Errors
/// When the dataset does not have what the configuration asks for.
pub fn initial_primitives(dataset: &Dataset, config: &Config) -> Result<Primitives> {
    let kernel = kernel(config);
    let start = &config.initialisation;
    let points = match start.from {
        Start::Fdk => {
            let volume = fdk(&dataset.scanner, &dataset.train, Window::RamLak)?;
            initialisation::bright_voxels(&volume, start.threshold, config.model.points, config.seed)?
        }
        Start::Random => initialisation::random_points(&dataset.scanner.grid, config.model.points, config.seed),
        Start::Dataset => {
            let points = dataset.initial_points.as_ref().ok_or_else(|| {
                Error::invalid(
                    "initialisation.from",
                    "dataset",
                    "a dataset with initial points (init_*.npy)",
                    "use fdk or random",
                )
            })?;
            let point = |row: ndarray::ArrayView1<'_, f64>| Point {
                position: DVec3::new(row[0], row[1], row[2]),
                density: row[3],
            };
            points.rows().into_iter().map(point).collect()
        }
    };
    initialisation::primitives(&points, kernel, start.density_factor, config.model.nu_initial)
}

fn kernel(config: &Config) -> Kernel {
    match config.model.kernel {
        KernelName::StudentT => Kernel::StudentT,
        KernelName::Gaussian => Kernel::Gaussian,
    }
}

/// The state of a run.
struct Trainer<'a, R> {
    dataset: &'a Dataset,
    config: &'a Config,
    activation: Activation,
    raw: Parameters,
    optimiser: Optimiser,
    order: ViewOrder,
    ssim: Ssim<R>,
    targets: Vec<SsimTarget<R>>,
}

/// Parts of the loss of one iteration.
#[derive(Clone, Copy, Default)]
struct Losses {
    total: f64,
    l1: f64,
    d_ssim: f64,
    tv: f64,
}

impl<'a, R: Kernels> Trainer<'a, R> {
    fn new(dataset: &'a Dataset, config: &'a Config) -> Result<Self> {
        dataset.scanner.validate()?;
        let longest = dataset.scanner.grid.size().max_element();
        let activation = Activation {
            kernel: kernel(config),
            scale: Interval { min: config.model.scale_min * longest, max: config.model.scale_max * longest },
            nu: Interval { min: config.model.nu_min, max: config.model.nu_max },
        };
        let raw = activation.inverse(&initial_primitives(dataset, config)?.parameters);
        let ssim = Ssim::<R>::default();
        let real = |view| dataset.train.image(view).mapv(|value| R::from_f64(f64::from(value)));
        let targets = (0..dataset.train.len()).map(|view| SsimTarget::new(&ssim, real(view).view())).collect();
        Ok(Self {
            dataset,
            config,
            activation,
            optimiser: Optimiser::new(raw.len(), config),
            raw,
            order: ViewOrder::new(dataset.train.len(), config.seed),
            ssim,
            targets,
        })
    }

    fn run(mut self, observe: &mut Observe<'_>) -> Result<Reconstruction> {
        let began = Instant::now();
        let iterations = self.config.iterations;
        let (mut log, mut sum, mut since) = (Vec::new(), Losses::default(), 0);
        for iteration in 1..=iterations {
            let losses = self.step(iteration)?;
            sum = Losses {
                total: sum.total + losses.total,
                l1: sum.l1 + losses.l1,
                d_ssim: sum.d_ssim + losses.d_ssim,
                tv: sum.tv + losses.tv,
            };
            since += 1;
            let due = iteration % self.config.report_every == 0 || iteration == iterations;
            if due {
                let mean = |total: f64| total / since as f64;
                log.push(Record {
                    iteration,
                    iterations,
                    loss: mean(sum.total),
                    l1: mean(sum.l1),
                    d_ssim: mean(sum.d_ssim),
                    tv: mean(sum.tv),
                    primitives: self.raw.len(),
                    seconds: began.elapsed().as_secs_f64(),
                });
                (sum, since) = (Losses::default(), 0);
            }
            if observe(iteration, log.last().filter(|_| due)).is_break() {
                return Err(Error::Interrupted {
                    step: iteration,
                    remedy: "nothing was written; start it again".into(),
                });
            }
        }
        let primitives = self.activation.forward(&self.raw);
        let grid = self.dataset.scanner.grid;
        let values = Field::<R>::new(&primitives, self.config.cutoff).voxels(&grid).mapv(|value| value.to_f64() as f32);
        Ok(Reconstruction { primitives, volume: Volume::new(grid, values)?, log })
    }

    /// One iteration: one view, one block, one step of the optimiser.
    fn step(&mut self, iteration: usize) -> Result<Losses> {
        let physical = self.activation.forward(&self.raw);
        let field = Field::<R>::new(&physical, self.config.cutoff);
        let mut gradient = field.zero_gradient();
        let mut losses = self.data_loss(&field, iteration, &mut gradient);
        if self.config.loss.tv > 0.0 {
            losses.tv = self.total_variation(&field, iteration, &mut gradient);
            losses.total += self.config.loss.tv * losses.tv;
        }
        let mut gradient = field.finish(&gradient);
        self.activation.vjp(&physical, &mut gradient);
        gradient.check_finite("gradient of the raw parameters", iteration)?;
        self.optimiser.step(&mut self.raw, &gradient, iteration - 1);
        match self.config.density_control.method {
            DensityControl::None => {}
        }
        Ok(losses)
    }

    /// L1 and D-SSIM of the iteration's view.
    fn data_loss(
        &mut self,
        field: &Field<R>,
        iteration: usize,
        gradient: &mut crate::projector::FieldGradient,
    ) -> Losses {
        let view = self.order.view(iteration - 1);
        let seen = field.view(&self.dataset.scanner, self.dataset.train.angles[view], self.config.projection);
        let loss = image_loss(&self.ssim, self.config.loss.d_ssim, seen.image().view(), &self.targets[view]);
        seen.pull_back(loss.cotangent.view(), gradient);
        Losses { total: loss.total, l1: loss.l1, d_ssim: loss.d_ssim, tv: 0.0 }
    }

    /// Total variation of a random block of the volume.
    fn total_variation(
        &self,
        field: &Field<R>,
        iteration: usize,
        gradient: &mut crate::projector::FieldGradient,
    ) -> f64 {
        let block = random_block(&self.dataset.scanner.grid, self.config.loss.tv_block, self.config.seed, iteration);
        let (value, mut cotangent) = tv(field.voxels(&block).view());
        cotangent.mapv_inplace(|d| d * R::from_f64(self.config.loss.tv));
        field.pull_back_voxels(&block, cotangent.view(), gradient);
        value
    }
}

/// A block of at most `side` voxels a side, somewhere in the grid.
fn random_block(grid: &Grid, side: usize, seed: u64, iteration: usize) -> Grid {
    let mut random = rng::stream(seed, rng::Purpose::TotalVariation, iteration as u64, 0);
    let shape = grid.shape.map(|n| n.min(side));
    let start = [0, 1, 2].map(|axis| random.random_range(0..=grid.shape[axis] - shape[axis]));
    grid.block(start, shape)
}

/// Every view once per epoch, in an order that depends on the seed and the epoch alone.
struct ViewOrder {
    views: Vec<usize>,
    epoch: Option<u64>,
    seed: u64,
}

impl ViewOrder {
    fn new(views: usize, seed: u64) -> Self {
        Self { views: (0..views).collect(), epoch: None, seed }
    }

    /// The view of a step, counted from 0.
    fn view(&mut self, step: usize) -> usize {
        let epoch = (step / self.views.len()) as u64;
        if self.epoch != Some(epoch) {
            self.views.sort_unstable();
            self.views.shuffle(&mut rng::stream(self.seed, rng::Purpose::ViewOrder, epoch, 0));
            self.epoch = Some(epoch);
        }
        self.views[step % self.views.len()]
    }
}

/// An optimiser and a learning rate for each group of parameters.
struct Optimiser {
    groups: Vec<(Group, Adam, Exponential)>,
}

impl Optimiser {
    fn new(m: usize, config: &Config) -> Self {
        let o = &config.optimiser;
        let group = |group: Group| {
            let [first, last] = match group {
                Group::Mean => match o.position {
                    PositionOptimiser::Adam => o.mean,
                },
                Group::Scale => o.scale,
                Group::Quaternion => o.quaternion,
                Group::Density => o.density,
                Group::Nu => o.nu,
            };
            (
                group,
                Adam::new(m * group.width(), o.beta, o.epsilon),
                Exponential { first, last, steps: config.iterations },
            )
        };
        Self { groups: Group::ALL.map(group).into() }
    }

    fn step(&mut self, raw: &mut Parameters, gradient: &Parameters, step: usize) {
        for (group, adam, rate) in &mut self.groups {
            adam.step(raw.group_mut(*group), gradient.group(*group), rate.at(step));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_epoch_shows_every_view_once_in_its_own_order() {
        let mut order = ViewOrder::new(7, 3);
        let epochs: Vec<Vec<usize>> = (0..4).map(|e| (0..7).map(|i| order.view(e * 7 + i)).collect()).collect();
        for epoch in &epochs {
            let mut sorted = epoch.clone();
            sorted.sort_unstable();
            assert_eq!(sorted, (0..7).collect::<Vec<_>>());
        }
        assert_ne!(epochs[0], epochs[1]);
        assert_eq!(ViewOrder::new(7, 3).view(23), epochs[3][2], "a step's view does not depend on what came before");
    }

    #[test]
    fn random_blocks_lie_within_the_grid_and_move() {
        let grid = Grid::cube(40);
        let blocks: Vec<Grid> = (0..50).map(|i| random_block(&grid, 32, 0, i)).collect();
        assert!(blocks.iter().all(|b| b.shape == [32; 3]
            && b.min.cmpge(grid.min - 1e-12).all()
            && b.max().cmple(grid.max() + 1e-12).all()));
        assert!(blocks.iter().any(|b| b.min != blocks[0].min));
        assert_eq!(random_block(&Grid::cube(8), 32, 0, 1), Grid::cube(8));
    }
}
