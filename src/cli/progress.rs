//! Progress of the parts of a run, on a bar or in lines, and how long the run will take.

use super::Global;
use super::interrupt::requested;
use super::messages::ProgressBar;
use super::pace::{Pace, STEP_IN_VIEWS, spoken};
use std::ops::ControlFlow;
use std::time::{Duration, Instant};
use trgs::classical::VoxelProjector;
use trgs::classical::algebraic::{Pass, Trial};
use trgs::config::Config;
use trgs::reconstruction::{PILOT_PART, Progress};
use trgs::scan::Dataset;
use trgs::train::Record;
use trgs::words;

/// Time between two lines where standard error is no terminal.
const BETWEEN_LINES: Duration = Duration::from_secs(5);

/// Reports the steps of a run.
pub(super) struct RunProgress<'a> {
    dataset: &'a Dataset,
    config: &'a Config,
    pace: Pace<'a>,
    bar: ProgressBar,
    began: Instant,
    lines: Lines,
    /// The part, its first step, and the seconds then.
    part: (&'static str, usize, f64),
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
        let views = [dataset.train.len(), dataset.test.as_ref().map_or(0, |test| test.len())];
        Self {
            dataset,
            config,
            pace: Pace { config, done, is_decided, views, steps: 0, from: 0.0 },
            bar: ProgressBar::of("{bar:30} {msg}", 1, global),
            began: Instant::now(),
            lines: Lines::default(),
            part: ("", 0, 0.0),
            loss: String::new(),
        }
    }

    /// Call after every step; breaks when the user interrupts.
    pub(super) fn see(&mut self, step: &Progress<'_>) -> ControlFlow<()> {
        let now = self.began.elapsed().as_secs_f64();
        let fits = self.config.method.fits_primitives();
        match *step {
            Progress::Iteration(iteration, record) => {
                self.measure(now);
                self.iteration("iteration", [iteration, self.config.iterations], record, now);
            }
            Progress::Pilot(iteration, record) => {
                let all = (PILOT_PART * self.config.iterations as f64) as usize;
                self.iteration("pilot run, iteration", [iteration, all.max(1)], record, now);
            }
            Progress::Choosing(key, trial) => {
                // Passes are chosen among the passes of one run, each of which is a trial.
                if !fits && (trial.is_none() || key == "passes") {
                    self.measure(now);
                }
                self.trial(key, trial, now);
            }
            Progress::Pass(pass) => {
                // Those of a checkpoint come first, and were not run.
                if !fits && pass.iteration > self.pace.done {
                    self.measure(now);
                }
                self.pass(if fits { "finish on voxels, iteration" } else { "iteration" }, pass, now);
            }
        }
        if requested() { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
    }

    /// Says that the metrics are computed.
    pub(super) fn evaluating(&mut self) {
        self.bar.show("evaluation".into(), [0, 1]);
    }

    /// Says once how long the run will take, as soon as its first steps allow.
    fn measure(&mut self, now: f64) {
        let Some(step) = self.pace.step(now) else { return };
        let on_voxels = if self.pace.asks_for_a_step() { self.step_on_voxels() } else { f64::NAN };
        if let Some((seconds, text)) = self.pace.duration(now, step, on_voxels) {
            self.bar.above(|| tracing::info!(seconds, "{text}"));
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
            Ok(_) => began.elapsed().as_secs_f64() * STEP_IN_VIEWS * train.len() as f64,
            Err(_) => f64::NAN,
        }
    }

    /// The time that a part will take to its last step.
    fn left(&mut self, part: &'static str, [done, all]: [usize; 2], now: f64) -> String {
        if self.part.0 != part {
            self.part = (part, done, now);
        }
        let (_, first, began) = self.part;
        if done <= first {
            return String::new();
        }
        let seconds = (now - began) / (done - first) as f64 * all.saturating_sub(done) as f64;
        format!(", about {} left of this part", spoken(seconds))
    }

    fn iteration(&mut self, what: &'static str, steps: [usize; 2], record: Option<&Record>, now: f64) {
        let (left, [iteration, all]) = (self.left(what, steps, now), steps);
        if self.bar.is_shown() {
            if let Some(Record { loss, primitives, .. }) = record {
                self.loss = format!(": loss {loss:.5}, {primitives} primitives");
            }
            return self.bar.show(format!("{what} {iteration} of {all}{}{left}", self.loss), steps);
        }
        let Some(record) = record.filter(|_| self.lines.is_due(Instant::now())) else { return };
        let Record { iterations, loss, l1, d_ssim, tv, primitives, seconds, .. } = *record;
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

    fn pass(&mut self, what: &'static str, pass: &Pass, now: f64) {
        let left = self.left(what, [pass.iteration, pass.iterations], now);
        let Pass { iteration, iterations, residual, objective, change } = *pass;
        let shown = if (0.01..1e6).contains(&residual) { format!("{residual:.4}") } else { format!("{residual:.4e}") };
        if self.bar.is_shown() {
            let text = format!("{what} {iteration} of {iterations}: residual {shown}{left}");
            return self.bar.show(text, [iteration, iterations]);
        }
        if self.lines.is_due(Instant::now()) {
            let change = change.map_or(String::new(), |change| format!(", step {change:.1e} of the volume"));
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
        if self.bar.is_shown() {
            if let Some(Trial { value, error }) = trial {
                let value = words::value(*value);
                self.loss = format!(": {value} has a held-out error of {error:.5}");
            }
            return self.bar.show(format!("choice of {key}{}", self.loss), [0, 1]);
        }
        let Some(Trial { value, error }) = trial else { return };
        if self.lines.is_due(Instant::now()) {
            tracing::info!(
                part = "choice",
                key,
                value,
                error,
                "choice of {key}: {} has a held-out error of {error:.5}, {now:.1} s",
                words::value(*value)
            );
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
