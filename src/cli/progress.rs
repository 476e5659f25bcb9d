//! Progress of a run over all its parts, on a bar or in lines, and how long the run will take.

use super::interrupt::requested;
use super::pace::{Part, Plan, spoken};
use super::{Global, LogFormat};
use indicatif::ProgressStyle;
use std::io::{self, IsTerminal};
use std::ops::ControlFlow;
use std::time::{Duration, Instant};
use trgs::classical::VoxelProjector;
use trgs::classical::algebraic::{Pass, Trial};
use trgs::config::Config;
use trgs::reconstruction::Progress;
use trgs::scan::Dataset;
use trgs::train::Record;
use trgs::words;

/// Time between two lines where standard error is no terminal.
const BETWEEN_LINES: Duration = Duration::from_secs(5);
/// Positions of the bar.
const POSITIONS: f64 = 1000.0;

/// Reports the steps of a run.
pub(super) struct RunProgress<'a> {
    dataset: &'a Dataset,
    config: &'a Config,
    plan: Plan,
    bar: Option<indicatif::ProgressBar>,
    began: Instant,
    lines: Lines,
    /// Whether the duration was said.
    is_told: bool,
    loss: String,
}

/// Decides which steps have a line of their own: the first, then one every five seconds at most.
#[derive(Default)]
pub(super) struct Lines {
    last: Option<Instant>,
}

impl Lines {
    /// For short work, which has no line at its beginning.
    pub(super) fn begun(now: Instant) -> Self {
        Self { last: Some(now) }
    }

    /// Whether a line is due; it is taken as written.
    pub(super) fn is_due(&mut self, now: Instant) -> bool {
        let due = self.last.is_none_or(|last| now.duration_since(last) >= BETWEEN_LINES);
        if due {
            self.last = Some(now);
        }
        due
    }
}

impl<'a> RunProgress<'a> {
    /// `done` iterations are those of a checkpoint, which take no time; `is_decided` says that it has the choice, too.
    pub(super) fn new(
        dataset: &'a Dataset,
        config: &'a Config,
        done: usize,
        is_decided: bool,
        global: &Global,
    ) -> Self {
        let wanted = !global.quiet && global.log_format == LogFormat::Text && io::stderr().is_terminal();
        let style = ProgressStyle::with_template("{bar:30} {msg}").expect("the template is well formed");
        let test_views = dataset.test.as_ref().map_or(0, |test| test.len());
        Self {
            dataset,
            config,
            plan: Plan::new(config, done, is_decided, [dataset.train.len(), test_views]),
            bar: wanted.then(|| indicatif::ProgressBar::new(POSITIONS as u64).with_style(style)),
            began: Instant::now(),
            lines: Lines::default(),
            is_told: false,
            loss: String::new(),
        }
    }

    /// Call after every step; breaks when the user interrupts.
    pub(super) fn see(&mut self, step: &Progress<'_>) -> ControlFlow<()> {
        let now = self.began.elapsed().as_secs_f64();
        let fits = self.config.method.fits_primitives();
        match *step {
            Progress::Iteration(iteration, record) => {
                self.plan.reach(Part::Training, iteration, None, now);
                self.iteration("iteration", iteration, record, now);
            }
            Progress::Pilot(iteration, record) => {
                self.plan.reach(Part::Pilot, iteration, None, now);
                self.iteration("pilot run, iteration", iteration, record, now);
            }
            Progress::Choosing(key, trial) => {
                // Passes are chosen among the passes of one run, each of which is a trial.
                if trial.is_none() || key == "passes" {
                    self.plan.step(Part::Choice, now);
                }
                self.trial(key, trial, now);
            }
            Progress::Pass(pass) => {
                let part = if fits { Part::Finish } else { Part::Passes };
                self.plan.reach(part, pass.iteration, Some(pass.iterations), now);
                self.pass(if fits { "finish on voxels, iteration" } else { "iteration" }, pass, now);
            }
        }
        self.tell(now);
        if requested() { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
    }

    /// Says that the metrics are computed.
    pub(super) fn evaluating(&mut self) {
        let now = self.began.elapsed().as_secs_f64();
        self.plan.enter(Part::Evaluation);
        self.show("evaluation".into(), now);
    }

    /// Says once how long the run will take, as soon as its first steps allow.
    fn tell(&mut self, now: f64) {
        if self.is_told || !self.plan.is_measured() {
            return;
        }
        self.is_told = true;
        if self.plan.asks_for_a_step() {
            self.plan.set_step(self.step_on_voxels());
        }
        if let Some((seconds, text)) = self.plan.duration(now) {
            match &self.bar {
                Some(bar) => bar.suspend(|| tracing::info!(seconds, "{text}")),
                None => tracing::info!(seconds, "{text}"),
            }
        }
    }

    /// Seconds of an iteration of least squares on voxels, from one view; NaN where it cannot be measured.
    fn step_on_voxels(&self) -> f64 {
        let (scanner, train) = (&self.dataset.scanner, &self.dataset.train);
        let empty = ndarray::Array3::<f32>::zeros(scanner.grid.shape);
        let view = train.select(&[0]);
        let Ok(projector) = VoxelProjector::new(scanner, self.config.algebraic.rays) else { return f64::NAN };
        let began = Instant::now();
        match projector.forward::<f32>(&view, empty.view()) {
            Ok(_) => began.elapsed().as_secs_f64() * Plan::STEP_IN_VIEWS * train.len() as f64,
            Err(_) => f64::NAN,
        }
    }

    fn left(&self) -> String {
        match self.plan.left() {
            Some(seconds) if self.is_told => format!(", about {} left", spoken(seconds)),
            _ => String::new(),
        }
    }

    /// Moves the bar and shows `text` beside it.
    fn show(&self, text: String, now: f64) {
        if let Some(bar) = &self.bar {
            if let Some(left) = self.plan.left().filter(|_| self.is_told) {
                bar.set_position((POSITIONS * now / (now + left).max(f64::MIN_POSITIVE)) as u64);
            }
            bar.set_message(text + &self.left());
        }
    }

    fn iteration(&mut self, what: &str, iteration: usize, record: Option<&Record>, now: f64) {
        if self.bar.is_some() {
            if let Some(Record { loss, primitives, .. }) = record {
                self.loss = format!(": loss {loss:.5}, {primitives} primitives");
            }
            let all = self.plan.steps(if what == "iteration" { Part::Training } else { Part::Pilot });
            return self.show(format!("{what} {iteration} of {all}{}", self.loss), now);
        }
        let Some(record) = record.filter(|_| self.lines.is_due(Instant::now())) else { return };
        let Record { iterations, loss, l1, d_ssim, tv, primitives, seconds, .. } = *record;
        let left = self.left();
        tracing::info!(
            part = if what == "iteration" { "training" } else { "pilot" },
            iteration,
            iterations,
            loss,
            l1,
            d_ssim,
            tv,
            primitives,
            seconds,
            "{what} {iteration} of {iterations}: loss {loss:.5} (L1 {l1:.5}, 1-SSIM {d_ssim:.4}, TV {tv:.5}), \
             {primitives} primitives, {now:.1} s{left}"
        );
    }

    fn pass(&mut self, what: &str, pass: &Pass, now: f64) {
        let Pass { iteration, iterations, residual, objective, change } = *pass;
        let shown = if (0.01..1e6).contains(&residual) { format!("{residual:.4}") } else { format!("{residual:.4e}") };
        if self.bar.is_some() {
            return self.show(format!("{what} {iteration} of {iterations}: residual {shown}"), now);
        }
        if self.lines.is_due(Instant::now()) {
            let change = change.map_or(String::new(), |change| format!(", step {change:.1e} of the volume"));
            let left = self.left();
            tracing::info!(
                part = if self.config.method.fits_primitives() { "finish" } else { "passes" },
                iteration,
                iterations,
                residual,
                objective,
                seconds = now,
                "{what} {iteration} of {iterations}: residual {shown}{change}, {now:.1} s{left}"
            );
        }
    }

    fn trial(&mut self, key: &str, trial: Option<&Trial>, now: f64) {
        if self.bar.is_some() {
            if let Some(Trial { value, error }) = trial {
                let value = words::value(*value);
                self.loss = format!(": {value} has a held-out error of {error:.5}");
            }
            return self.show(format!("choice of {key}{}", self.loss), now);
        }
        let Some(Trial { value, error }) = trial else { return };
        if self.lines.is_due(Instant::now()) {
            let left = self.left();
            tracing::info!(
                part = "choice",
                key,
                value,
                error,
                "choice of {key}: {} has a held-out error of {error:.5}, {now:.1} s{left}",
                words::value(*value)
            );
        }
    }
}

impl Drop for RunProgress<'_> {
    fn drop(&mut self) {
        if let Some(bar) = &self.bar {
            bar.finish_and_clear();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_are_five_seconds_apart() {
        let (mut lines, began) = (Lines::default(), Instant::now());
        let due = |lines: &mut Lines, milliseconds| lines.is_due(began + Duration::from_millis(milliseconds));
        let written: Vec<u64> = (0..30_000).step_by(7).filter(|&at| due(&mut lines, at)).collect();
        assert!(written.len() == 6 && written[0] == 0, "{written:?}");
        assert!(written.windows(2).all(|pair| pair[1] - pair[0] >= 5000), "{written:?}");
    }
}
