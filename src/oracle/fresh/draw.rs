//! Numbers of a generated question: random, spaced, or at the ends of their ranges.

use rand::{Rng, RngExt};
use serde::Serialize;
use trgs_core::numeric::rng::{self, Purpose};

/// How the numbers of a question are chosen.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub(crate) enum Kind {
    /// Uniform in their ranges.
    Random,
    /// At the ends and in the middle of their ranges.
    Edge,
    /// Spaced evenly over the questions of a stage.
    Spaced,
    /// Random, with one property that programs are known to get wrong.
    Adversarial,
}

impl Kind {
    pub(crate) const ALL: [Self; 4] = [Self::Random, Self::Edge, Self::Spaced, Self::Adversarial];

    pub(crate) fn word(self) -> &'static str {
        ["random", "edge", "spaced", "adversarial"][self as usize]
    }
}

/// One primitive.
#[derive(Clone, Copy)]
pub(super) struct Row {
    pub(super) mean: [f64; 3],
    pub(super) scale: [f64; 3],
    pub(super) quaternion: [f64; 4],
    pub(super) density: f64,
    pub(super) nu: f64,
}

/// The draws of one question.
pub(crate) struct Draw {
    rng: Box<dyn Rng>,
    pub(crate) kind: Kind,
    index: u64,
    calls: u32,
    large: bool,
    /// Whether sizes may be larger than any truth is computed for.
    pub(crate) huge: bool,
}

impl Draw {
    pub(crate) fn new(seed: u64, stage: u64, index: u64, large: bool, huge: bool) -> Self {
        let kind = Kind::ALL[(index % 4) as usize];
        Self { rng: Box::new(rng::stream(seed, Purpose::Questions, stage, index)), kind, index, calls: 0, large, huge }
    }

    /// A number of [0, 1] in single precision.
    pub(crate) fn unit(&mut self) -> f64 {
        let random: f64 = self.rng.random();
        self.calls += 1;
        match self.kind {
            Kind::Random | Kind::Adversarial => random,
            Kind::Edge => [0.0, 0.5, 1.0, random][self.rng.random_range(0..4)],
            // Multiples of irrational numbers fill the interval evenly.
            Kind::Spaced => {
                let step = libm::log(f64::from(self.calls) + 1.0);
                ((self.index / 4) as f64 * step + step * 7.0).fract()
            }
        }
    }

    pub(crate) fn between(&mut self, low: f64, high: f64) -> f64 {
        single(low + (high - low) * self.unit())
    }

    /// A positive number whose logarithm is drawn.
    pub(crate) fn magnitude(&mut self, low: f64, high: f64) -> f64 {
        let (low, high) = (libm::log(low), libm::log(high));
        single(libm::exp(low + (high - low) * self.unit()))
    }

    /// An integer of both ends and between.
    pub(crate) fn count(&mut self, low: usize, high: usize) -> usize {
        low + ((self.unit() * (high - low + 1) as f64) as usize).min(high - low)
    }

    /// As [`Self::count`]; at level `large` a count that is no multiple of a block.
    pub(crate) fn size(&mut self, low: usize, high: usize) -> usize {
        if self.large { self.pick(&[17, 33, 100, 257, 1001]) } else { self.count(low, high) }
    }

    /// The number of the question, modulo `n`.
    pub(crate) fn turn(&self, n: u64) -> u64 {
        self.index % n
    }

    /// One of the small shapes, or at level `large` one of the others.
    pub(crate) fn pick_by_level<T: Copy>(&mut self, small: &[T], large: &[T]) -> T {
        self.pick(if self.large { large } else { small })
    }

    pub(crate) fn pick<T: Copy>(&mut self, from: &[T]) -> T {
        from[self.rng.random_range(0..from.len())]
    }

    pub(crate) fn chance(&mut self, probability: f64) -> bool {
        self.rng.random::<f64>() < probability
    }

    /// `n` numbers in [low, high].
    pub(crate) fn row(&mut self, n: usize, low: f64, high: f64) -> Vec<f64> {
        (0..n).map(|_| self.between(low, high)).collect()
    }
}

/// The nearest number of single precision: inputs that both precisions hold exactly.
pub(crate) fn single(x: f64) -> f64 {
    f64::from(x as f32)
}
