//! The state that a run needs to resume with the same bits.

use super::optimiser::Optimiser;
use super::record::{Losses, Record};
use crate::config::Config;
use crate::density::{NextPrimitive, kept_rows, next_parameters};
use crate::error::Result;
use crate::primitives::{Activation, Group, Parameters};
use crate::sealed::{are_finite, require};
use serde::{Deserialize, Serialize};

/// The state of a run after an iteration.
///
/// Random numbers and the order of views are functions of the seed and the iteration.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct State {
    /// Iterations completed.
    pub(super) iteration: usize,
    pub(super) raw: Parameters,
    /// Unique ids of the primitives; none is reused.
    pub(super) ids: Vec<u64>,
    next_id: u64,
    pub(super) optimiser: Optimiser,
    /// c of each primitive as last computed; empty if no loss needs it.
    pub(super) confidence: Vec<f64>,
    pub(super) gradient_stats: GradientStats,
    pub(super) log: Vec<Record>,
    /// Sums of the losses since the last record, and their number.
    pub(super) sums: Losses,
    pub(super) summed: usize,
    /// Seconds spent so far.
    pub(super) seconds: f64,
    /// Iterations after which the number of iterations was changed.
    #[serde(default)]
    pub(super) continued: Vec<usize>,
}

/// Mean gradient to each projected mean over the views that saw the primitive, since the last density control.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(super) struct GradientStats {
    sum: Vec<f64>,
    views: Vec<u32>,
}

impl GradientStats {
    fn new(m: usize) -> Self {
        Self { sum: vec![0.0; m], views: vec![0; m] }
    }

    /// Adds one view: the gradient to each projected mean, and whether the view saw the primitive.
    pub(super) fn add(&mut self, mean2d_gradients: impl Iterator<Item = [f64; 2]>, seen: impl Iterator<Item = bool>) {
        let totals = self.sum.iter_mut().zip(&mut self.views);
        for ((sum, views), ([u, v], _)) in totals.zip(mean2d_gradients.zip(seen)).filter(|(_, (_, seen))| *seen) {
            *sum += (u * u + v * v).sqrt();
            *views += 1;
        }
    }

    /// The means; 0 for a primitive that no view saw.
    pub(super) fn means(&self) -> Vec<f64> {
        self.sum.iter().zip(&self.views).map(|(sum, &views)| sum / f64::from(views.max(1))).collect()
    }
}

impl State {
    pub(super) fn new(raw: Parameters, config: &Config) -> Self {
        let m = raw.len();
        Self {
            iteration: 0,
            ids: (0..m as u64).collect(),
            next_id: m as u64,
            optimiser: Optimiser::new(m, config),
            confidence: Vec::new(),
            gradient_stats: GradientStats::new(m),
            raw,
            log: Vec::new(),
            sums: Losses::default(),
            summed: 0,
            seconds: 0.0,
            continued: Vec::new(),
        }
    }

    /// Rejects a state that no run of `config` has: lengths and ranges of what was read from a file.
    pub(super) fn check(&self, config: &Config) -> Result<()> {
        let Self { iteration, raw, ids, next_id, optimiser, confidence, gradient_stats, .. } = self;
        let (m, done) = (raw.len(), *iteration);
        require(done <= config.iterations, "iterations done", done, "no more than the run has")?;
        let rows = Group::ALL.map(|group| raw.group(group).len() / group.width());
        let expected = "one row for each of one primitive or more";
        require(m > 0 && rows == [m; 5], "rows of the parameters", format!("{rows:?}"), expected)?;
        let finite = Group::ALL.iter().all(|group| are_finite(raw.group(*group)));
        require(finite && raw.have_directions(), "parameters", "others", "finite numbers")?;
        let mut sorted = ids.clone();
        sorted.sort_unstable();
        let unique = sorted.is_sorted_by(|a, b| a < b) && sorted.last().is_none_or(|last| last < next_id);
        // Each iteration adds fewer ids than this.
        let few = *next_id <= u64::MAX / 2;
        require(ids.len() == m && unique && few, "ids", "others", "a unique one for each primitive")?;
        optimiser.check(m, done, config)?;
        let is_confident = config.confidence.enabled || config.wavelet.enabled;
        let whole = confidence.len() == if is_confident { m } else { 0 };
        let ranged = confidence.iter().all(|c| (0.0..=1.0).contains(c));
        require(whole && ranged, "confidence", "others", "a number from 0 to 1 for each primitive")?;
        let GradientStats { sum, views } = gradient_stats;
        let seen = sum.iter().all(|sum| sum.is_finite() && *sum >= 0.0) && views.iter().all(|&n| n as usize <= done);
        require([sum.len(), views.len()] == [m; 2] && seen, "gradients of the views", "others", "those of the views")?;
        self.check_log()
    }

    fn check_log(&self) -> Result<()> {
        let Self { iteration, log, sums, summed, seconds, continued, .. } = self;
        let records = log.is_sorted_by(|a, b| a.iteration < b.iteration)
            && log.iter().all(|record| (1..=*iteration).contains(&record.iteration) && record.is_finite());
        require(records, "log", "others", "finite records of the iterations done")?;
        let few = *summed <= *iteration && sums.blocks <= *summed;
        require(few && sums.is_finite() && seconds.is_finite(), "sums of the losses", "others", "finite sums")?;
        let continues = continued.is_sorted() && continued.iter().all(|at| at <= iteration);
        require(continues, "iterations of a continuation", "others", "iterations done, in their order")
    }

    /// Replaces the population. Unchanged values keep their raw values to the bit; with `reset_parents` Adam's moments of what was
    /// copied start anew.
    pub(super) fn replace_population(
        &mut self,
        physical: &Parameters,
        next: &[NextPrimitive],
        reset_parents: bool,
        activation: &Activation,
    ) {
        let new = activation.inverse(&next_parameters(physical, next));
        let old = &self.raw;
        let keep = |same: bool, old: f64, new: f64| if same { old } else { new };
        self.raw = Parameters {
            mean: new.mean,
            scale: (next.iter().zip(&new.scale))
                .map(|(s, new)| {
                    let p = s.parent;
                    [0, 1, 2].map(|k| keep(s.scale[k] == physical.scale[p][k], old.scale[p][k], new[k]))
                })
                .collect(),
            quaternion: new.quaternion,
            density: (next.iter().zip(&new.density))
                .map(|(s, &new)| keep(s.density == physical.density[s.parent], old.density[s.parent], new))
                .collect(),
            nu: next.iter().map(|s| old.nu[s.parent]).collect(),
        };
        let mut id = |s: &NextPrimitive| {
            if s.fresh {
                self.next_id += 1;
                self.next_id - 1
            } else {
                self.ids[s.parent]
            }
        };
        self.ids = next.iter().map(&mut id).collect();
        let [moments, momentum] = kept_rows(next, reset_parents);
        self.optimiser.remap_rows(&moments, &momentum);
        self.gradient_stats = GradientStats::new(next.len());
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::primitives::{KernelKind, activation::Interval};
    use crate::tolerances::relative;
    use crate::train::optimiser::Step;

    fn activation() -> Activation {
        Activation {
            kernel: KernelKind::StudentT,
            scale: Interval { min: 0.001, max: 1.0 },
            nu: Interval { min: 2.0, max: 100.0 },
        }
    }

    fn raw() -> Parameters {
        Parameters {
            mean: vec![[0.1, -0.2, 0.3], [0.5, 0.6, 0.7]],
            scale: vec![[-2.0, -2.4, -1.7], [-3.0, -3.1, -3.2]],
            quaternion: vec![[0.3, -0.4, 0.8, 0.1], [1.0, 0.0, 0.2, 0.0]],
            density: vec![-0.7, -3.0],
            nu: vec![-1.3, 0.2],
        }
    }

    #[test]
    fn successors_keep_raw_values_to_the_bit_where_nothing_changed() {
        let mut state = State::new(raw(), &Config::default());
        let physical = activation().forward(&state.raw).parameters;
        let same = NextPrimitive::same(&physical, 1);
        let half = NextPrimitive { density: physical.density[0] / 2.0, ..NextPrimitive::same(&physical, 0) };
        state.replace_population(&physical, &[same, half, NextPrimitive { fresh: true, ..half }], false, &activation());
        assert_eq!((state.raw.scale[0], state.raw.density[0]), (raw().scale[1], raw().density[1]));
        assert_eq!((state.raw.scale[1], state.raw.nu[2]), (raw().scale[0], raw().nu[0]));
        let density = activation().forward(&state.raw).parameters.density;
        within!(relative(density[1] + density[2], physical.density[0]));
        assert_eq!((state.ids.as_slice(), state.next_id), (&[1, 0, 2][..], 3));
    }

    #[test]
    fn moments_of_what_was_copied_start_anew_where_that_is_asked_for() {
        let physical = activation().forward(&raw()).parameters;
        let next = [0, 1].map(|row| NextPrimitive::same(&physical, row));
        let next = [next[0], next[1], NextPrimitive { fresh: true, ..next[0] }];
        let moments = |reset| {
            let config = Config::default();
            let mut state = State::new(raw(), &config);
            let (primitives, mut direction) = (activation().forward(&raw()), Vec::new());
            let step = Step { config: &config, done: 0, physical: &primitives, ids: &[0, 1] };
            state.optimiser.step(&mut state.raw, &raw(), &mut direction, &step);
            state.replace_population(&physical, &next, reset, &activation());
            let optimiser = serde_json::to_value(&state.optimiser).unwrap();
            let of_densities = optimiser["adam"][3]["moments"].as_array().unwrap();
            of_densities.iter().map(|moments| *moments == serde_json::json!([0.0, 0.0])).collect::<Vec<_>>()
        };
        assert_eq!((moments(false), moments(true)), (vec![false, false, true], vec![true, false, true]));
    }

    #[test]
    fn pulls_are_means_over_the_views_that_saw_a_primitive() {
        let mut gradient_stats = GradientStats::new(3);
        gradient_stats.add([[3.0, 4.0], [1.0, 0.0], [7.0, 7.0]].into_iter(), [true, true, false].into_iter());
        gradient_stats.add([[0.0, 1.0], [5.0, 5.0], [7.0, 7.0]].into_iter(), [true, false, false].into_iter());
        assert_eq!(gradient_stats.means(), [3.0, 1.0, 0.0]);
    }
}
