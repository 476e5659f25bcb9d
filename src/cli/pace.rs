//! How long a run will take, over all its parts, from the time of the steps that are done.

use trgs::classical::algebraic::FEWEST_TRIALS;
use trgs::config::{Auto, Config, Finish, Method, Sampling};
use trgs::numeric::elementary::pow;
use trgs::reconstruction::PILOT_PART;

/// A part of a run, in order.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Part {
    Training,
    Pilot,
    Choice,
    Finish,
    Passes,
    Evaluation,
}

/// The steps of a part, and their time.
#[derive(Debug)]
struct Stage {
    part: Part,
    name: &'static str,
    /// Expected steps; those done once the part has ended.
    steps: f64,
    done: f64,
    /// The step from which on the time is measured: those before include preparations.
    first: f64,
    /// Steps done and seconds passed at that step.
    from: Option<[f64; 2]>,
    /// Seconds of a step in the mean over those measured.
    measured: Option<f64>,
}

/// All parts of a run.
#[derive(Debug)]
pub(super) struct Plan {
    stages: Vec<Stage>,
    /// The stage of the last step.
    current: usize,
    /// By how much the mean iteration on primitives takes longer than the first ones.
    growth: f64,
    /// Seconds of an iteration on voxels with all views, before one was measured.
    step: f64,
    /// Steps of a resumed run that were done before.
    resumed: f64,
    /// Test views as a part of the training views.
    test_part: f64,
}

impl Plan {
    /// The time of an iteration is proportional to this power of the number of primitives.
    const POWER: f64 = 0.8;
    /// Projections of a view that take as long as its share of an iteration with total variation.
    pub(super) const STEP_IN_VIEWS: f64 = 3.0;
    /// The iterations between which training is measured, and the steps of other parts.
    const ITERATIONS: [f64; 2] = [10.0, 40.0];
    const STEPS: [f64; 2] = [1.0, 5.0];
    /// Steps of the choice of a finish for each sampling: two or three weights of some 65 steps.
    const CHOICE: f64 = 160.0;
    /// Iterations of a finish before they are known.
    const FINISH: usize = 20;
    /// Iterations on primitives that take as long as the evaluation of a test view.
    const EVALUATION: f64 = 0.5;
    /// A pilot run leaves out a sixth of the views, the choice of a weight a quarter.
    const PILOT_VIEWS: f64 = 5.0 / 6.0;
    const CHOICE_VIEWS: f64 = 0.75;
    /// A run of fewer seconds says nothing.
    const LONG: f64 = 10.0;

    /// `views` are those of the fit and of the test.
    pub(super) fn new(config: &Config, done: usize, is_decided: bool, [views, test_views]: [usize; 2]) -> Self {
        let n = config.iterations as f64;
        let stage = |part, name, steps: f64| {
            let first = match part {
                Part::Training => Self::ITERATIONS[0] + done as f64,
                Part::Passes => Self::STEPS[0] + done as f64,
                _ => Self::STEPS[0],
            };
            Stage { part, name, steps, done: 0.0, first, from: None, measured: None }
        };
        let mut stages = Vec::new();
        let has_pilot = config.has_pilot() && !is_decided;
        match config.method {
            Method::TrGs | Method::R2Gaussian => {
                stages.push(stage(Part::Training, "training", n));
                let samplings = if config.sampling == Sampling::Auto { 2.0 } else { 1.0 };
                if has_pilot {
                    stages.push(stage(Part::Pilot, "the pilot run", PILOT_PART * n));
                    stages.push(stage(Part::Choice, "the choice of the finish", samplings * Self::CHOICE));
                } else if config.has_open_finish() && !is_decided {
                    stages.push(stage(Part::Choice, "the choice of tv.weight", Self::CHOICE));
                }
                if config.finish == Finish::Tv {
                    stages.push(stage(Part::Finish, "the finish", config.tv.finish_iterations.or(Self::FINISH) as f64));
                }
            }
            _ => {
                let is_open = config.method == Method::Tv && config.tv.weight == Auto::Auto;
                if is_open && !is_decided {
                    stages.push(stage(Part::Choice, "the choice of tv.weight", n * FEWEST_TRIALS as f64));
                } else if config.algebraic.auto && !is_decided {
                    stages.push(stage(Part::Choice, "the choice of the passes at most", n));
                }
                stages.push(stage(Part::Passes, "iterations", n));
            }
        }
        stages.push(stage(Part::Evaluation, "evaluation", test_views as f64));
        let points = config.model.points.max(1);
        let growth = match config.method.fits_primitives() {
            true => pow(config.mean_population(points) / points as f64, Self::POWER),
            false => 1.0,
        };
        let test_part = test_views as f64 / views.max(1) as f64;
        Self { stages, current: 0, growth, step: f64::NAN, resumed: done as f64, test_part }
    }

    /// So many steps of a part are done `now`, in seconds since the run began; its number of steps may be known better.
    pub(super) fn reach(&mut self, part: Part, done: usize, steps: Option<usize>, now: f64) {
        let Some(stage) = self.stage(part) else { return };
        stage.done = done as f64;
        if let Some(steps) = steps {
            stage.steps = steps as f64;
        }
        stage.measure(now);
    }

    /// One more step of a part is done.
    pub(super) fn step(&mut self, part: Part, now: f64) {
        let Some(stage) = self.stage(part) else { return };
        stage.done += 1.0;
        stage.steps = stage.steps.max(stage.done + 1.0);
        stage.measure(now);
    }

    /// Begins a part, which ends those before it.
    pub(super) fn enter(&mut self, part: Part) {
        let _ = self.stage(part);
    }

    /// The stage of a part, which ends those before it.
    fn stage(&mut self, part: Part) -> Option<&mut Stage> {
        let number = self.stages.iter().position(|stage| stage.part == part)?;
        if number > self.current {
            self.stages[..number].iter_mut().for_each(|stage| stage.steps = stage.done);
            self.current = number;
        }
        Some(&mut self.stages[number])
    }

    /// Whether the first part has been measured for long enough to say how long the run will take.
    pub(super) fn is_measured(&self) -> bool {
        let stage = &self.stages[self.current];
        let [first, last] = if stage.part == Part::Training { Self::ITERATIONS } else { Self::STEPS };
        stage.measured.is_some() && stage.from.is_some_and(|[from, _]| stage.done - from >= last - first)
    }

    /// Whether an iteration on voxels is part of the run, and none was measured.
    pub(super) fn asks_for_a_step(&self) -> bool {
        let on_voxels = |stage: &Stage| matches!(stage.part, Part::Choice | Part::Finish);
        matches!(self.stages[self.current].part, Part::Training | Part::Pilot) && self.stages.iter().any(on_voxels)
    }

    /// States the seconds of an iteration on voxels with all views.
    pub(super) fn set_step(&mut self, seconds: f64) {
        self.step = seconds;
    }

    /// Expected steps of a part.
    pub(super) fn steps(&self, part: Part) -> usize {
        self.stages.iter().find(|stage| stage.part == part).map_or(0, |stage| stage.steps as usize)
    }

    /// Seconds left; `None` before anything was measured.
    pub(super) fn left(&self) -> Option<f64> {
        self.stages[self.current..]
            .iter()
            .map(|stage| Some((stage.steps - stage.done).max(0.0) * self.rate(stage)?))
            .sum()
    }

    /// The whole duration and its parts in a sentence; `None` for a run that is soon done.
    pub(super) fn duration(&self, now: f64) -> Option<(f64, String)> {
        let left = self.left()?;
        let total = now + left;
        let parts: Vec<String> = (self.stages.iter())
            .filter_map(|stage| {
                let seconds = (stage.steps - self.before(stage)) * self.rate(stage)?;
                (seconds >= 1.0).then(|| format!("{} {}", stage.name, spoken(seconds)))
            })
            .collect();
        let skip = match self.stages[0] {
            Stage { part: Part::Choice, name, .. } if name.ends_with("tv.weight") => {
                "; a choice may take longer, and --set tv.weight=W skips it"
            }
            _ => "",
        };
        let of_parts = if parts.len() > 1 { format!(": {}", parts.join(", ")) } else { String::new() };
        (total >= Self::LONG).then(|| (total, format!("about {} in all{of_parts}{skip}", spoken(total))))
    }

    /// Steps of a stage that a resumed run does not repeat.
    fn before(&self, stage: &Stage) -> f64 {
        if matches!(stage.part, Part::Training | Part::Passes) { self.resumed.min(stage.steps) } else { 0.0 }
    }

    /// Expected seconds of a step in the mean over those left.
    fn rate(&self, stage: &Stage) -> Option<f64> {
        let of = |part| self.stages.iter().find(|stage| stage.part == part);
        let measured = |part| of(part).and_then(|stage: &Stage| stage.measured);
        let on_voxels = |views: f64| {
            let seconds = measured(Part::Choice).map(|seconds| seconds / views);
            seconds.or(Some(self.step).filter(|step| step.is_finite()))
        };
        match (stage.part, stage.measured) {
            (Part::Training, Some(seconds)) => {
                // Later iterations have more primitives, as far as the plan tells.
                let part = stage.done / stage.steps.max(1.0);
                Some(seconds * (part + (1.0 - part) * self.growth))
            }
            (_, Some(seconds)) => Some(seconds),
            (Part::Training, None) => None,
            (Part::Pilot, None) => of(Part::Training).and_then(|training| self.rate(training)),
            (Part::Choice, None) => Some(self.step * Self::PILOT_VIEWS).filter(|step| step.is_finite()),
            (Part::Finish, None) => on_voxels(Self::PILOT_VIEWS),
            (Part::Passes, None) => on_voxels(Self::CHOICE_VIEWS),
            // A test view is projected once.
            (Part::Evaluation, None) if stage.steps == 0.0 => Some(0.0),
            (Part::Evaluation, None) => match of(Part::Training) {
                Some(training) => self.rate(training).map(|seconds| Self::EVALUATION * seconds),
                None => {
                    let step = of(Part::Passes).and_then(|passes| self.rate(passes))?;
                    Some(step * self.test_part / (Self::STEP_IN_VIEWS * stage.steps))
                }
            },
        }
    }
}

impl Stage {
    fn measure(&mut self, now: f64) {
        match self.from {
            None if self.done >= self.first => self.from = Some([self.done, now]),
            Some([done, began]) if self.done > done => self.measured = Some((now - began) / (self.done - done)),
            _ => {}
        }
    }
}

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

    fn resolved(method: Method, iterations: usize) -> Config {
        let mut config = Config::of(method);
        config.iterations = iterations;
        (config.model.points, config.density_control.cap) = (1000, 1000);
        (config.density_control.every, config.confidence.every) = (100, 100);
        config
    }

    fn left(plan: &Plan) -> String {
        format!("{:.1}", plan.left().unwrap())
    }

    #[test]
    fn all_parts_of_a_run_on_primitives_are_in_the_estimate_and_on_the_bar() {
        let config = resolved(Method::TrGs, 600);
        let mut plan = Plan::new(&config, 0, false, [18, 40]);
        let names: Vec<&str> = plan.stages.iter().map(|stage| stage.name).collect();
        assert_eq!(names, ["training", "the pilot run", "the choice of the finish", "the finish", "evaluation"]);
        // An iteration takes 0.1 s after a start of 5 s; a step on voxels is said to take 0.03 s.
        let time = |iteration: usize| 5.0 + 0.1 * iteration as f64;
        for iteration in 1..40 {
            plan.reach(Part::Training, iteration, None, time(iteration));
            assert!(!plan.is_measured(), "{iteration}");
        }
        plan.reach(Part::Training, 40, None, time(40));
        assert!(plan.is_measured() && plan.asks_for_a_step());
        plan.set_step(0.03);
        let (seconds, text) = plan.duration(time(40)).unwrap();
        // 5 before, 60, half of it, 320 steps with 5/6 of the views, 20 with all, 40 test views of half an iteration.
        assert_eq!(format!("{seconds:.1}"), "105.6", "{text}");
        assert_eq!(
            text,
            "about 2 min in all: training 60 s, the pilot run 30 s, the choice of the finish 8 s, evaluation 2 s"
        );
        let mut last = plan.left().unwrap();
        for iteration in 41..=600 {
            plan.reach(Part::Training, iteration, None, time(iteration));
            let left = plan.left().unwrap();
            assert!(left < last, "{iteration}");
            last = left;
        }
        // At the end of the training a third is still to come.
        assert_eq!(format!("{last:.1}"), "40.6");
        for iteration in 1..=300 {
            plan.reach(Part::Pilot, iteration, None, 65.0 + 0.1 * iteration as f64);
        }
        assert_eq!(left(&plan), "10.6");
        // The choice takes more steps than expected, and the finish more than 20.
        (1..=500).for_each(|step| plan.step(Part::Choice, 95.0 + 0.025 * f64::from(step)));
        plan.reach(Part::Finish, 1, Some(100), 108.0);
        assert_eq!(left(&plan), "5.0");
        plan.enter(Part::Evaluation);
        assert_eq!(left(&plan), "2.0");
    }

    #[test]
    fn a_run_that_is_decided_has_no_pilot_and_a_resumed_one_fewer_iterations() {
        let config = resolved(Method::TrGs, 600);
        let mut plan = Plan::new(&config, 500, true, [18, 0]);
        let parts: Vec<Part> = plan.stages.iter().map(|stage| stage.part).collect();
        assert_eq!(parts, [Part::Training, Part::Finish, Part::Evaluation]);
        (501..=550)
            .for_each(|iteration| plan.reach(Part::Training, iteration, None, f64::from(iteration as u32 - 500)));
        plan.set_step(0.1);
        assert!(plan.is_measured());
        let (seconds, text) = plan.duration(50.0).unwrap();
        assert!(seconds.round() == 102.0 && text.contains("training 2 min"), "{seconds}: {text}");
    }

    #[test]
    fn passes_of_a_checkpoint_are_not_measured() {
        let mut config = Config::of(Method::Sart);
        config.iterations = 20;
        let mut plan = Plan::new(&config, 3, false, [10, 5]);
        let mut see = |iteration, now| {
            plan.reach(Part::Passes, iteration, Some(20), now);
            plan.stages[0].measured
        };
        assert_eq!([1, 2, 3].map(|iteration| see(iteration, 0.001)), [None; 3]);
        assert_eq!([see(4, 2.0), see(5, 4.0), see(6, 6.0)], [None, Some(2.0), Some(2.0)]);
        assert_eq!(left(&plan), "28.3");
    }

    #[test]
    fn a_long_run_on_voxels_says_what_it_costs() {
        let plan = |step: f64, weight: Auto<f64>| {
            let mut config = Config::of(Method::Tv);
            (config.iterations, config.tv.weight) = (100, weight);
            let mut plan = Plan::new(&config, 0, false, [10, 0]);
            let is_open = weight == Auto::Auto;
            for k in 1..=6 {
                match is_open {
                    true => plan.step(Part::Choice, step * f64::from(k)),
                    false => plan.reach(Part::Passes, k as usize, Some(100), step * f64::from(k)),
                }
            }
            assert!(plan.is_measured() && !plan.asks_for_a_step());
            plan.duration(step * 6.0)
        };
        assert_eq!(plan(0.05, Auto::Fixed(1e-3)), None);
        let (seconds, text) = plan(0.5, Auto::Fixed(1e-3)).unwrap();
        assert_eq!((seconds.round(), text.as_str()), (50.0, "about 50 s in all"));
        // Three weights in two folds, and the run with all views.
        let (seconds, text) = plan(0.375, Auto::Auto).unwrap();
        assert_eq!(seconds.round(), 275.0);
        let expected = "about 5 min in all: the choice of tv.weight 4 min, iterations 50 s; a choice may take longer, and \
                        --set tv.weight=W skips it";
        assert_eq!(text, expected);
        assert!(plan(0.02, Auto::Auto).is_some() && plan(0.01, Auto::Auto).is_none());
    }

    #[test]
    fn durations_are_said_in_their_unit() {
        assert_eq!([9.6, 99.4, 125.0, 9000.0].map(spoken), ["10 s", "99 s", "2 min", "2.5 h"]);
    }
}
