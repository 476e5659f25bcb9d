//! How long a run will take, over all its parts, from the time of a step of the first one.

use trgs::classical::algebraic::FEWEST_TRIALS;
use trgs::config::{Auto, Config, Finish, Method, Sampling};
use trgs::numeric::elementary::pow;
use trgs::reconstruction::PILOT_PART;

/// The time of an iteration is proportional to this power of the number of primitives.
const POWER: f64 = 0.8;
/// Projections of a view that take as long as its share of an iteration with total variation.
pub(super) const STEP_IN_VIEWS: f64 = 3.0;
/// The iterations between which training is measured, and the steps of other parts: the first include preparations.
const ITERATIONS: [usize; 2] = [10, 40];
const STEPS: [usize; 2] = [1, 5];
/// Steps of the choice of a finish for each sampling: two or three weights of some 65 steps.
const CHOICE: f64 = 120.0;
/// Iterations of a finish before they are known.
const FINISH: usize = 20;
/// Iterations on primitives that take as long as the evaluation of a test view.
const EVALUATION: f64 = 0.5;
/// A pilot run leaves out a sixth of the views, the choice of a weight a quarter.
const PILOT_VIEWS: f64 = 5.0 / 6.0;
const CHOICE_VIEWS: f64 = 0.75;
/// A run of fewer seconds says nothing.
const LONG: f64 = 10.0;

/// What a run is about to do.
pub(super) struct Pace<'a> {
    pub(super) config: &'a Config,
    /// Iterations of a checkpoint, which take no time.
    pub(super) done: usize,
    /// Whether the checkpoint has the choice, too.
    pub(super) is_decided: bool,
    /// Views of the fit and of the test.
    pub(super) views: [usize; 2],
    /// Steps of the first part so far.
    pub(super) steps: usize,
    /// Seconds at the step from which on the time is measured.
    pub(super) from: f64,
}

impl Pace<'_> {
    /// Another step of the first part; returns the seconds of one as soon as enough are done.
    pub(super) fn step(&mut self, now: f64) -> Option<f64> {
        let [first, last] = if self.config.method.fits_primitives() { ITERATIONS } else { STEPS };
        self.steps += 1;
        if self.steps == first {
            self.from = now;
        }
        (self.steps == last).then(|| (now - self.from) / (last - first) as f64)
    }

    /// Whether an iteration on voxels is part of a run that begins with others.
    pub(super) fn asks_for_a_step(&self) -> bool {
        let config = self.config;
        let is_open = !self.is_decided && (config.has_pilot() || config.has_open_finish());
        config.method.fits_primitives() && (is_open || config.finish == Finish::Tv)
    }

    /// The parts of the run and their seconds.
    ///
    /// A step of the first part takes `step`, and an iteration on voxels with all views `on_voxels` seconds.
    fn parts(&self, step: f64, on_voxels: f64) -> Vec<(&'static str, f64)> {
        let (config, n) = (self.config, self.config.iterations as f64);
        let left = n - self.done as f64;
        let tests = self.views[1] as f64;
        let mut parts = Vec::new();
        if config.method.fits_primitives() {
            // Later iterations have more primitives.
            let points = config.model.points.max(1);
            let growth = pow(config.mean_population(points) / points as f64, POWER);
            let part = (self.done + self.steps) as f64 / n;
            let iteration = step * (part + (1.0 - part) * growth);
            let choice = CHOICE * PILOT_VIEWS * on_voxels;
            parts.push(("training", left * iteration));
            if config.has_pilot() && !self.is_decided {
                let samplings = if config.sampling == Sampling::Auto { 2.0 } else { 1.0 };
                parts.push(("the pilot run", PILOT_PART * n * iteration));
                // Weights are chosen on longer voxels, and one of them is judged on the scan as it is.
                let coarse = config.coarse.max(1) as f64;
                let weights = samplings * choice / (coarse * coarse * coarse);
                let whole = if coarse > 1.0 { 0.5 * samplings * choice } else { 0.0 };
                parts.push(("the choice of the finish", weights + whole));
            } else if config.has_open_finish() && !self.is_decided {
                parts.push((WEIGHT, choice));
            }
            if config.finish == Finish::Tv {
                parts.push(("the finish", config.tv.finish_iterations.or(FINISH) as f64 * on_voxels));
            }
            parts.push(("evaluation", tests * EVALUATION * iteration));
            return parts;
        }
        let is_open = config.method == Method::Tv && config.tv.weight == Auto::Auto;
        let mut pass = step / CHOICE_VIEWS;
        if is_open && !self.is_decided {
            parts.push((WEIGHT, n * FEWEST_TRIALS as f64 * step));
        } else if config.algebraic.auto && !self.is_decided {
            parts.push(("the choice of the passes at most", n * step));
        } else {
            pass = step;
        }
        parts.push(("iterations", left * pass));
        // A test view is projected once.
        parts.push(("evaluation", tests / self.views[0].max(1) as f64 * pass / STEP_IN_VIEWS));
        parts
    }

    /// The whole duration and its parts in a sentence; `None` for a run that is soon done.
    pub(super) fn duration(&self, now: f64, step: f64, on_voxels: f64) -> Option<(f64, String)> {
        let parts = self.parts(step, on_voxels);
        let total = now - self.steps as f64 * step + parts.iter().map(|(_, seconds)| seconds).sum::<f64>();
        let long: Vec<String> = (parts.iter().filter(|(_, seconds)| *seconds >= 1.0))
            .map(|(name, seconds)| format!("{name} {}", spoken(*seconds)))
            .collect();
        let skip = match parts[0].0 {
            WEIGHT => "; a choice may take longer, and --set tv.weight=W skips it",
            _ => "",
        };
        let of_parts = if long.len() > 1 { format!(": {}", long.join(", ")) } else { String::new() };
        (total >= LONG).then(|| (total, format!("about {} in all{of_parts}{skip}", spoken(total))))
    }
}

const WEIGHT: &str = "the choice of tv.weight";

/// A duration as it is said: `45 s`, `12 min`, `3.5 h`.
pub(super) fn spoken(seconds: f64) -> String {
    match seconds {
        s if s < 100.0 => format!("{s:.0} s"),
        s if s < 6000.0 => format!("{:.0} min", s / 60.0),
        s => format!("{:.1} h", s / 3600.0),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pace(config: &Config, done: usize, views: [usize; 2]) -> Pace<'_> {
        Pace { config, done, is_decided: done > 0, views, steps: 0, from: 0.0 }
    }

    fn on_primitives() -> Config {
        let mut config = Config::of(Method::TrGs);
        config.iterations = 600;
        (config.model.points, config.density_control.cap) = (1000, 1000);
        (config.density_control.every, config.confidence.every) = (100, 100);
        config
    }

    #[test]
    fn all_parts_of_a_run_on_primitives_are_in_the_estimate() {
        let config = on_primitives();
        let mut pace = pace(&config, 0, [18, 40]);
        // An iteration takes 0.1 s after a start of 5 s; a step on voxels is said to take 0.03 s.
        let steps: Vec<Option<f64>> = (1..=40).map(|i| pace.step(5.0 + 0.1 * f64::from(i))).collect();
        assert!(steps[..39].iter().all(Option::is_none) && pace.asks_for_a_step());
        let (seconds, text) = pace.duration(9.0, steps[39].unwrap(), 0.03).unwrap();
        // 5 before, 60, half of it, 240 steps with 5/6 of the views, 20 with all, 40 test views of half an iteration.
        assert_eq!(format!("{seconds:.1}"), "103.6", "{text}");
        assert_eq!(
            text,
            "about 2 min in all: training 60 s, the pilot run 30 s, the choice of the finish 6 s, evaluation 2 s"
        );
    }

    #[test]
    fn a_run_that_is_decided_has_no_pilot_and_a_resumed_one_fewer_iterations() {
        let config = on_primitives();
        let mut pace = pace(&config, 500, [18, 0]);
        let step = (1..=40).find_map(|i| pace.step(f64::from(i))).unwrap();
        let (seconds, text) = pace.duration(40.0, step, 0.1).unwrap();
        assert!(seconds.round() == 102.0 && text.contains("training 2 min"), "{seconds}: {text}");
        assert!(!text.contains("pilot"), "{text}");
    }

    #[test]
    fn a_long_run_on_voxels_says_what_it_costs() {
        let said = |step: f64, weight: Auto<f64>| {
            let mut config = Config::of(Method::Tv);
            (config.iterations, config.tv.weight) = (100, weight);
            let mut pace = pace(&config, 0, [10, 0]);
            let seconds = (1..=5).find_map(|k| pace.step(step * f64::from(k))).unwrap();
            assert!(!pace.asks_for_a_step());
            pace.duration(step * 5.0, seconds, f64::NAN)
        };
        assert_eq!(said(0.05, Auto::Fixed(1e-3)), None);
        let (seconds, text) = said(0.5, Auto::Fixed(1e-3)).unwrap();
        assert_eq!((seconds.round(), text.as_str()), (50.0, "about 50 s in all"));
        // Three weights in one fold, and the run with all views.
        let (seconds, text) = said(0.375, Auto::Auto).unwrap();
        assert_eq!(seconds, 162.5);
        let expected = "about 3 min in all: the choice of tv.weight 2 min, iterations 50 s; a choice may take longer, and \
                        --set tv.weight=W skips it";
        assert_eq!(text, expected);
        assert!(said(0.03, Auto::Auto).is_some() && said(0.02, Auto::Auto).is_none());
    }

    #[test]
    fn durations_are_said_in_their_unit() {
        assert_eq!([9.6, 99.4, 125.0, 9000.0].map(spoken), ["10 s", "99 s", "2 min", "2.5 h"]);
    }
}
