//! How long a run will take, said as soon as early iterations allow.

use std::time::Instant;
use trgs::classical::algebraic::FEWEST_TRIALS;
use trgs::config::Config;
use trgs::numeric::elementary::pow;
use trgs::reconstruction::{PILOT_PART, Progress};

/// Measures the time of early iterations and reports the predicted total once.
pub(super) struct Pace<'a> {
    config: &'a Config,
    /// Iterations of the checkpoint that the run continues; its passes are reported again, in no time.
    done: usize,
    /// Steps of a method on voxels or of its choice.
    steps: usize,
    from: Option<Instant>,
}

impl<'a> Pace<'a> {
    /// The iterations on primitives between which the time is measured.
    const ITERATIONS: [usize; 2] = [10, 40];
    /// The steps on voxels between which the time is measured; the first of all includes preparations.
    const STEPS: [usize; 2] = [1, 5];
    /// The time of an iteration is proportional to this power of the number of primitives.
    const POWER: f64 = 0.8;
    /// A method on voxels that takes fewer seconds says nothing.
    const LONG: f64 = 10.0;

    pub(super) fn new(config: &'a Config, done: usize) -> Self {
        Self { config, done, steps: 0, from: None }
    }

    pub(super) fn tell(&mut self, step: &Progress<'_>) {
        let is_on_voxels = !self.config.method.fits_primitives();
        match step {
            Progress::Iteration(iteration, _) => {
                if let Some(seconds) = self.seconds(*iteration, Self::ITERATIONS) {
                    self.tell_of_primitives(seconds);
                }
            }
            Progress::Choosing(_, None) if is_on_voxels => self.tell_of_voxels(self.config.iterations, true),
            Progress::Pass(pass) if is_on_voxels && pass.iteration > self.done => {
                self.tell_of_voxels(pass.iterations - self.done, false);
            }
            Progress::Choosing(..) | Progress::Pass(_) => {}
        }
    }

    /// Seconds of a step, when the last of those measured is done.
    fn seconds(&mut self, step: usize, [from, to]: [usize; 2]) -> Option<f64> {
        if step == from {
            self.from = Some(Instant::now());
        }
        let began = self.from.filter(|_| step == to)?;
        Some(began.elapsed().as_secs_f64() / (to - from) as f64)
    }

    fn tell_of_primitives(&self, seconds: f64) {
        let config = self.config;
        let points = config.model.points as f64;
        let growth = pow(config.mean_population(config.model.points) / points, Self::POWER);
        let seconds = seconds * growth * config.iterations as f64;
        let (pilot, also) = match config.has_pilot() {
            true => (PILOT_PART * seconds, format!(", the pilot run {:.0} s", PILOT_PART * seconds)),
            false => (0.0, String::new()),
        };
        let text = format!("{} iterations will take about {seconds:.0} s{also}", config.iterations);
        tracing::info!(seconds = seconds + pilot, "{text}");
    }

    fn tell_of_voxels(&mut self, iterations: usize, is_choosing: bool) {
        self.steps += 1;
        let Some(step) = self.seconds(self.steps, Self::STEPS) else { return };
        if let Some((seconds, text)) = of_voxels(step, iterations, is_choosing) {
            tracing::info!(seconds, "{text}");
        }
    }
}

/// Predicted seconds of a method on voxels, and how they are said; `None` if it is soon done.
fn of_voxels(step: f64, iterations: usize, is_choosing: bool) -> Option<(f64, String)> {
    let steps = step * iterations as f64;
    let (seconds, text) = if is_choosing {
        let choice = steps * FEWEST_TRIALS as f64;
        // A trial leaves out a quarter of the views.
        let run = steps * 4.0 / 3.0;
        let text = format!(
            "the choice of tv.weight will take {choice:.0} s or more, then {iterations} iterations about {run:.0} s; \
             --set tv.weight=W skips the choice"
        );
        (choice + run, text)
    } else {
        (steps, format!("{iterations} iterations will take about {steps:.0} s"))
    };
    (seconds >= Pace::LONG).then_some((seconds, text))
}

#[cfg(test)]
mod tests {
    use super::*;
    use trgs::classical::algebraic::Pass;
    use trgs::config::Method;

    #[test]
    fn passes_of_a_checkpoint_are_not_measured() {
        let config = Config::of(Method::Sart);
        let mut pace = Pace::new(&config, 3);
        let mut see = |iteration| {
            pace.tell(&Progress::Pass(&Pass {
                iteration,
                iterations: 20,
                residual: 1.0,
                objective: None,
                change: None,
            }));
            (pace.steps, pace.from.is_some())
        };
        assert_eq!([1, 2, 3, 4].map(&mut see), [(0, false), (0, false), (0, false), (1, true)]);
    }

    #[test]
    fn a_long_run_on_voxels_says_what_it_costs() {
        assert_eq!(of_voxels(0.05, 100, false), None);
        let (seconds, text) = of_voxels(0.5, 100, false).unwrap();
        assert_eq!((seconds, text.as_str()), (50.0, "100 iterations will take about 50 s"));
        // Three weights in two folds, and the run with all views.
        let (seconds, text) = of_voxels(0.375, 100, true).unwrap();
        assert_eq!(seconds, 275.0);
        assert!(
            text.starts_with("the choice of tv.weight will take 225 s or more, then 100 iterations about 50 s"),
            "{text}"
        );
        assert!(of_voxels(0.02, 100, true).is_some() && of_voxels(0.01, 100, true).is_none());
    }
}
