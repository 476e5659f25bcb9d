//! One optimiser for each group of parameters, with its learning rate.

use crate::config::{Config, OptimiserConfig, PositionOptimiser};
use crate::error::Result;
use crate::numeric::rng::{self, Purpose};
use crate::numeric::threads;
use crate::optim::schedule::pace;
use crate::optim::sghmc::{NoiseInput, Phase, gate};
use crate::optim::{Adam, Exponential, Sghmc};
use crate::primitives::{Group, Parameters, Primitives};
use crate::sealed::require;
use glam::{DMat3, DVec3};
use rand::RngExt;
use rand_distr::StandardNormal;
use serde::{Deserialize, Serialize};

/// The state of the optimisers.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct Optimiser {
    /// In the order of [`Group::ALL`].
    adam: [Adam; Group::ALL.len()],
    /// Momentum of the positions.
    sghmc: Sghmc,
}

/// The inputs of a step, apart from the gradient.
pub(super) struct Step<'a> {
    pub(super) config: &'a Config,
    /// Steps completed before this one.
    pub(super) done: usize,
    /// Physical values before the step.
    pub(super) physical: &'a Primitives,
    pub(super) ids: &'a [u64],
}

impl Optimiser {
    pub(super) fn new(m: usize, config: &Config) -> Self {
        let o = &config.optimiser;
        let adam = Group::ALL.map(|group| Adam::new(m * group.width(), o.beta, o.epsilon));
        Self { adam, sghmc: Sghmc::new(m) }
    }

    /// Rejects the state of other optimisers than those of `m` primitives after `done` iterations of `config`.
    pub(super) fn check(&self, m: usize, done: usize, config: &Config) -> Result<()> {
        let o = &config.optimiser;
        let mut pairs = Group::ALL.into_iter().zip(&self.adam);
        let fits = pairs.all(|(group, adam)| adam.fits(m * group.width(), o.beta, o.epsilon, done));
        let expected = "finite moments of each parameter, in at most as many steps as iterations are done";
        require(fits && self.sghmc.fits(m), "state of the optimisers", "another", expected)
    }

    /// One step of all parameters; `direction` is scratch.
    pub(super) fn step(
        &mut self,
        raw: &mut Parameters,
        gradient: &Parameters,
        direction: &mut Vec<[f64; 3]>,
        step: &Step<'_>,
    ) {
        let o = &step.config.optimiser;
        let pace = pace(o.horizon, o.longest, step.config.iterations);
        let rate =
            |[first, last]: [f64; 2]| pace * Exponential { first, last, steps: step.config.iterations }.at(step.done);
        let [of_mean, others @ ..] = &mut self.adam;
        let Parameters { mean, scale, quaternion, density, nu } = raw;
        let mut values = [scale.as_flattened_mut(), quaternion.as_flattened_mut(), density, nu];
        let ends = [o.scale, o.quaternion, o.density, o.nu];
        let move_positions = || match o.position {
            PositionOptimiser::Adam => {
                of_mean.step(mean.as_flattened_mut(), gradient.group(Group::Mean), rate(o.mean));
            }
            _ => sample(&mut self.sghmc, of_mean, mean, gradient, direction, rate(o.mean).sqrt(), step),
        };
        let step_others = || {
            let each = (threads::chunks(others, 1), threads::chunks(&mut values, 1));
            threads::for_each_zip(each, |i, (adam, values)| {
                adam[0].step(values[0], gradient.group(Group::ALL[1 + i]), rate(ends[i]));
            });
        };
        threads::join(move_positions, step_others);
    }

    /// First and second moments of `m` primitives, as rows of parameters.
    #[cfg(feature = "oracle")]
    pub(super) fn moments(&self, m: usize) -> [Parameters; 2] {
        let mut moments = [Parameters::zeros(m), Parameters::zeros(m)];
        for (group, adam) in Group::ALL.into_iter().zip(&self.adam) {
            let (_, first, second) = adam.state();
            moments[0].group_mut(group).copy_from_slice(&first);
            moments[1].group_mut(group).copy_from_slice(&second);
        }
        moments
    }

    /// Momentum of the positions.
    #[cfg(feature = "oracle")]
    pub(super) fn momentum(&self) -> &[[f64; 3]] {
        self.sghmc.momentum()
    }

    /// Adapts to a new population: the old rows that keep Adam's moments, and those that keep their momentum.
    pub(super) fn remap_rows(&mut self, moments: &[Option<usize>], momentum: &[Option<usize>]) {
        for (group, adam) in Group::ALL.into_iter().zip(&mut self.adam) {
            adam.remap_rows(group.width(), moments);
        }
        self.sghmc.remap_rows(momentum);
    }
}

/// The normal numbers of a primitive in the step after `done`.
pub(super) fn normals(config: &Config, done: usize, id: u64) -> DVec3 {
    let mut random = rng::stream(config.seed, Purpose::PositionNoise, done as u64, id);
    let mut normal = || random.sample(StandardNormal);
    DVec3::new(normal(), normal(), normal())
}

/// Steps of the burn-in: those of which fewer than this part of all are done.
pub(super) fn burn_in(config: &Config) -> usize {
    (config.sghmc.burn_in * config.iterations as f64).ceil() as usize
}

/// One step of the positions by SGHMC.
fn sample(
    sghmc: &mut Sghmc,
    adam: &mut Adam,
    mean: &mut [[f64; 3]],
    gradient: &Parameters,
    direction: &mut Vec<[f64; 3]>,
    rate: f64,
    step: &Step<'_>,
) {
    let settings = &step.config.sghmc;
    let OptimiserConfig { horizon, longest, .. } = step.config.optimiser;
    let pace_root = pace(horizon, longest, step.config.iterations).sqrt();
    let (burn_in_friction, friction) = (settings.burn_in_friction / pace_root, settings.friction / pace_root);
    let noise = |i: usize| normals(step.config, step.done, step.ids[i]);
    if step.config.optimiser.position == PositionOptimiser::SghmcTextbook {
        direction.clear();
        direction.extend(gradient.mean.iter().map(|g| g.map(|g| g / settings.temperature)));
        let free = |i| NoiseInput { gate: 1.0, noise: noise(i), covariance: DMat3::ZERO };
        return sghmc.step(mean, direction, rate, Phase::Sampling(friction), free);
    }
    let burning = step.done < burn_in(step.config);
    let phase = if burning { Phase::BurnIn(burn_in_friction) } else { Phase::Sampling(friction) };
    let parameters = &step.physical.parameters;
    let noise_for = |i: usize| match gate(parameters.density[i], settings.density_reference) {
        0.0 => NoiseInput::GATE_CLOSED,
        gate => {
            let covariance = if burning { parameters.covariance(i) } else { DMat3::ZERO };
            NoiseInput { gate, noise: noise(i), covariance }
        }
    };
    direction.resize(mean.len(), [0.0; 3]);
    adam.direction(gradient.group(Group::Mean), direction.as_flattened_mut());
    sghmc.step(mean, direction, rate, phase, noise_for);
}
