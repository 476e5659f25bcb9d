//! What it costs to sample a model: said before it begins, and shown while it goes on.

use super::Global;
use super::messages::ProgressBar;
use super::pace::spoken;
use super::progress::Lines;
use std::time::Instant;

/// Seconds that are worth a word.
const LONG: f64 = 10.0;
/// The flags that make sampling fast.
const FAST: &str = "--precision f32 --cutoff 1e-3";

/// Says how long sampling will take, if that is long, and how long it takes with the fast flags.
pub(super) fn announce(what: &str, seconds: f64, fast: impl FnOnce() -> Option<f64>) {
    if let Some(text) = (seconds >= LONG).then(fast).and_then(|fast| sentence(what, seconds, fast)) {
        tracing::info!(seconds, "{text}");
    }
}

fn sentence(what: &str, seconds: f64, fast: Option<f64>) -> Option<String> {
    let remedy = fast.filter(|fast| *fast < seconds / 2.0);
    let remedy = remedy.map_or(String::new(), |fast| format!("; {FAST} takes about {}", spoken(fast.max(1.0))));
    (seconds >= LONG).then(|| format!("{what} will take about {}{remedy}", spoken(seconds)))
}

/// Progress of sampling.
pub(super) struct Steps {
    what: &'static str,
    bar: ProgressBar,
    lines: Lines,
    began: Instant,
}

impl Steps {
    /// `what` is the plural of a step: views, or slices of the grid.
    pub(super) fn new(what: &'static str, global: &Global) -> Self {
        let bar = ProgressBar::of("{bar:30} {pos}/{len} {msg}", 1, global);
        bar.show(what.into(), [0, 1]);
        Self { what, bar, lines: Lines::begun(Instant::now()), began: Instant::now() }
    }

    pub(super) fn see(&mut self, done: usize, all: usize) {
        let seconds = self.began.elapsed().as_secs_f64();
        let left = spoken(seconds * (all - done) as f64 / done.max(1) as f64);
        if self.bar.is_shown() {
            self.bar.show(format!("{}, about {left} left", self.what), [done, all]);
        } else if self.lines.is_due(Instant::now()) {
            tracing::info!(done, all, seconds, "{done} of {all} {}, {seconds:.1} s, about {left} left", self.what);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_long_work_is_announced_and_only_a_remedy_that_helps() {
        assert_eq!(sentence("a volume", 9.0, Some(1.0)), None);
        let said = |seconds, fast| sentence("a volume", seconds, fast).unwrap();
        let whole = "a volume will take about 3.0 h; --precision f32 --cutoff 1e-3 takes about 30 s";
        assert_eq!(said(10_800.0, Some(30.0)), whole);
        assert_eq!(said(10_800.0, None), "a volume will take about 3.0 h");
        assert_eq!(said(20.0, Some(15.0)), "a volume will take about 20 s");
    }
}
