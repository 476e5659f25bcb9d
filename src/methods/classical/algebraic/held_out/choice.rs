//! What was chosen, with its evidence.

use serde::{Deserialize, Serialize};

/// A value of a setting and its held-out error.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Trial {
    /// The value of the setting.
    pub value: f64,
    /// Residual of the held-out views relative to the measured values.
    pub error: f64,
}

/// The chosen value of a setting, with its evidence.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Choice {
    /// `tv.weight` or `passes`.
    pub key: String,
    /// The chosen value.
    pub value: f64,
    /// All values tried, in increasing order; empty if there are too few views to hold any out.
    pub curve: Vec<Trial>,
    /// Number of reconstructions without some of the views.
    pub folds: usize,
    /// Cost of the choice, in iterations or passes over all views.
    pub cost: f64,
    /// Number of iterations that belongs to the value, where it was chosen with it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub iterations: Option<usize>,
    /// Share of the finished volume in the result, where it was chosen: the rest is the volume that the finish starts from.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub share: Option<f64>,
}

impl Choice {
    /// Whether it can be a choice: what was read from a file is checked by this.
    #[doc(hidden)]
    pub fn is_valid(&self) -> bool {
        let is_trial =
            |trial: &Trial| trial.value > 0.0 && trial.value.is_finite() && (0.0..f64::INFINITY).contains(&trial.error);
        self.value > 0.0
            && [self.value, self.cost].iter().all(|value| value.is_finite())
            && self.share.is_none_or(|share| (0.0..=1.0).contains(&share))
            && self.curve.iter().all(is_trial)
    }

    /// Iterations and share as words, with a space before; empty where there are none.
    #[doc(hidden)]
    pub fn details(&self) -> String {
        let iterations = self.iterations.map_or(String::new(), |n| format!(" with {n} iterations"));
        let share = |share: f64| format!(" and a share of {:.0} %", 100.0 * share);
        iterations + &self.share.filter(|share| *share < 1.0).map_or(String::new(), share)
    }

    /// The given value, where there are too few views to hold any out.
    pub(super) fn without_folds(key: &str, value: f64) -> Self {
        Self { key: key.into(), value, curve: Vec::new(), folds: 0, cost: 0.0, iterations: None, share: None }
    }
}
