//! Learning rates over a run. Not in the paper: they are R²-Gaussian's.

use crate::numeric::elementary::{exp, log, pow};

/// Largest factor on learning rates.
const FASTEST: f64 = 64.0;

/// Factor on the learning rates of a run of `steps`, for rates stated for `horizon` steps: `(horizon/steps)^¾`, clamped to
/// 1 … 64.
///
/// Fewer steps must be longer. Beyond `longest` steps the factor falls as `1/steps`: the rates of a run then have the same sum,
/// and more steps do not fit the noise of the projections more closely. The friction of SGHMC is divided by the root of the
/// factor, so that the decay of momentum per step is unchanged.
///
/// Not in the paper, whose runs have 30,000 steps. Tests: `short_runs_take_longer_steps`; its effect is in CHOICES.md.
pub fn pace(horizon: usize, longest: usize, steps: usize) -> f64 {
    let followed = steps.clamp(1, longest);
    let beyond = followed as f64 / steps.max(1) as f64;
    beyond * pow(horizon as f64 / followed as f64, 0.75).clamp(1.0, FASTEST)
}

/// Log-linear decay from `first` at step 0 to `last` at step `steps`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Exponential {
    /// Rate at the first step.
    pub first: f64,
    /// Rate at the end.
    pub last: f64,
    /// Length of the run.
    pub steps: usize,
}

impl Exponential {
    /// The rate at a step; constant after the end. A rate of zero at either end is zero throughout.
    pub fn at(&self, step: usize) -> f64 {
        if self.first == 0.0 || self.last == 0.0 {
            return 0.0;
        }
        let t = (step as f64 / self.steps.max(1) as f64).min(1.0);
        exp((1.0 - t) * log(self.first) + t * log(self.last))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tolerances::relative;

    #[test]
    fn short_runs_take_longer_steps() {
        within!(relative(pace(16_000, 5000, 1000), 8.0));
        let paper = |steps| pace(30_000, 30_000, steps);
        assert_eq!([paper(30_000), paper(1), paper(0), pace(5000, 30_000, 30_000)], [1.0, 64.0, 64.0, 1.0]);
        // The sum of the rates stays from there on.
        let sum = |steps| pace(30_000, 5000, steps) * steps as f64;
        assert!(sum(2500) < sum(5000));
        within!("sum", (sum(30_000) / sum(5000) - 1.0).abs());
    }

    #[test]
    fn decay_is_geometric_between_its_ends() {
        let rate = Exponential { first: 1e-2, last: 1e-4, steps: 100 };
        within!(relative(rate.at(0), 1e-2));
        within!("middle", relative(rate.at(50), 1e-3));
        within!(relative(rate.at(100), 1e-4));
        assert_eq!(rate.at(500), rate.at(100));
        assert_eq!(Exponential { first: 0.0, last: 0.0, steps: 10 }.at(3), 0.0);
    }
}
