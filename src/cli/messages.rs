//! Messages and progress on standard error.

use super::flags::with_flags;
use super::{Global, LogFormat, interrupt};
use indicatif::{ProgressState, ProgressStyle};
use ndarray::Array3;
use std::fmt;
use std::io::{self, IsTerminal};
use std::ops::ControlFlow;
use std::path::Path;
use tracing::field::{Field, Visit};
use tracing::{Event, Level, Subscriber};
use tracing_subscriber::filter::LevelFilter;
use tracing_subscriber::fmt::format::{FormatEvent, FormatFields, Writer};
use tracing_subscriber::fmt::{FmtContext, fmt};
use tracing_subscriber::registry::LookupSpan;
use trgs::classical::geometry_check::Step;
use trgs::experiments::Done;
use trgs::output::Destination;
use trgs::scan::hounsfield;
use trgs::words::{is_command, visible};
use trgs::{Error, Text};

/// Sends all tracing events to standard error, in the requested format.
pub(super) fn install(global: &Global) {
    let level = if global.quiet { LevelFilter::ERROR } else { LevelFilter::INFO };
    // A closed standard error must not end the program.
    let subscriber = fmt().with_max_level(level).with_writer(io::stderr).log_internal_errors(false);
    match global.log_format {
        LogFormat::Text => subscriber.event_format(Sentence).init(),
        LogFormat::Json => subscriber.json().flatten_event(true).with_target(false).with_writer(|| Plain).init(),
    }
}

/// Reports in one line the error that ended the program.
pub(super) fn error(error: &Error) {
    tracing::error!("{}", with_flags(&error.text()));
}

/// Warns of an unusual property of a file, with flags for settings.
pub(super) fn warning(path: &Path, text: impl Into<Text>) {
    tracing::warn!("{}: {}", path.display(), with_flags(&text.into()));
}

/// [`warning`] of each.
pub(super) fn warnings(path: &Path, texts: impl IntoIterator<Item: Into<Text>>) {
    texts.into_iter().for_each(|text| warning(path, text));
}

/// Says where other content of a folder was moved to, if it was.
pub(super) fn moved(destination: &Destination) {
    if let Some(aside) = destination.moved() {
        tracing::warn!("the older content of {} is now in {}", destination.folder().display(), aside.display());
    }
}

/// Warns of a build without the vector instructions of this CPU.
#[cfg(all(target_arch = "x86_64", not(all(target_feature = "avx2", target_feature = "fma"))))]
pub(super) fn unused_instructions() {
    if std::is_x86_feature_detected!("avx2") && std::is_x86_feature_detected!("fma") {
        let remedy = match std::env::var_os("TRGS_MODULE") {
            Some(module) if module == "baseline" => "unset TRGS_MODULE",
            _ => "build it with RUSTFLAGS=\"-C target-cpu=native\" cargo install --path .",
        };
        tracing::warn!(
            "this program was built without AVX2 and FMA, which this CPU has: results are the same, but take many times as \
             long; {remedy}"
        );
    }
}

/// Warns of a build without the vector instructions of this CPU: this build has them, or they are another CPU's.
#[cfg(not(all(target_arch = "x86_64", not(all(target_feature = "avx2", target_feature = "fma")))))]
pub(super) fn unused_instructions() {}

/// Converts the values of a volume from Hounsfield units, and says how many were below those of air.
pub(super) fn hounsfield_to_attenuation(path: &Path, values: &mut Array3<f32>, mu_water: f64) -> trgs::Result<()> {
    let looks_like_it = values.iter().any(|value| *value < hounsfield::IMPOSSIBLE);
    let below = hounsfield::to_attenuation(values, mu_water)?;
    if !looks_like_it {
        warning(path, "no value is far below 0, as those of air in Hounsfield units are: is this attenuation already?");
    }
    if below > 0 {
        let all = values.len();
        warning(path, format!("{below} of {all} values are below -1000, less than air, and became 0"));
    }
    Ok(())
}

/// A progress bar on a terminal, which is removed when it is dropped. Where there is none, progress is logged in lines.
pub(super) struct ProgressBar(Option<indicatif::ProgressBar>);

impl ProgressBar {
    /// A bar with a message, the rate and the time left.
    pub(super) fn new(steps: usize, global: &Global) -> Self {
        Self::of("{bar:30} {pos}/{len} {msg}{rate}, {eta} left", steps, global)
    }

    /// A bar with a template of indicatif.
    pub(super) fn of(template: &str, steps: usize, global: &Global) -> Self {
        let wanted = !global.quiet && global.log_format == LogFormat::Text && io::stderr().is_terminal();
        let style = ProgressStyle::with_template(template).expect("the template is well formed").with_key(
            "rate",
            |state: &ProgressState, text: &mut dyn fmt::Write| {
                let _ = write!(text, "{:.1} it/s", state.per_sec());
            },
        );
        Self(wanted.then(|| indicatif::ProgressBar::new(steps as u64).with_style(style)))
    }

    /// Whether there is a terminal for it.
    pub(super) fn is_shown(&self) -> bool {
        self.0.is_some()
    }

    /// Shows a message, and how many of all steps are done.
    pub(super) fn show(&self, text: String, [done, all]: [usize; 2]) {
        if let Some(bar) = &self.0 {
            bar.set_length(all as u64);
            bar.set_position(done as u64);
            bar.set_message(text);
        }
    }

    /// Writes lines, above the bar if there is one.
    pub(super) fn above(&self, write: impl FnOnce()) {
        match &self.0 {
            Some(bar) => bar.suspend(write),
            None => write(),
        }
    }

    /// Call after every cell of an experiment.
    ///
    /// `seconds` counts from the start of the first cell; `first` is the number of cells finished before.
    pub(super) fn cell(&mut self, done: &Done<'_>, first: usize, seconds: f64) {
        let Done { cell, done, cells } = *done;
        if self.is_shown() {
            self.show(format!("{}, ", visible(cell.description())), [done, cells]);
        } else {
            let left = seconds / (done.saturating_sub(first).max(1)) as f64 * (cells - done) as f64;
            tracing::info!(
                id = cell.id,
                done,
                cells,
                left,
                "cell {done} of {cells}: {}; about {:.0} min left",
                cell.description(),
                (left / 60.0).ceil()
            );
        }
    }

    /// Call after every step of a check; breaks when the user interrupts.
    pub(super) fn step(&mut self, step: &Step) -> ControlFlow<()> {
        let Step { what, done, steps } = *step;
        if self.is_shown() {
            self.show(format!("{what}, "), [done, steps]);
        } else {
            tracing::info!(done, steps, what, "step {done} of {steps}: {what}");
        }
        go_on()
    }
}

/// Breaks when the user interrupts.
pub(super) fn go_on() -> ControlFlow<()> {
    if interrupt::requested() { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
}

impl Drop for ProgressBar {
    fn drop(&mut self) {
        if let Some(bar) = &self.0 {
            bar.finish_and_clear();
        }
    }
}

/// Formats the message after its level, if that is not info. The fields are only in the JSON format.
struct Sentence;

impl<S, N> FormatEvent<S, N> for Sentence
where
    S: Subscriber + for<'a> LookupSpan<'a>,
    N: for<'a> FormatFields<'a> + 'static,
{
    fn format_event(&self, _: &FmtContext<'_, S, N>, mut writer: Writer<'_>, event: &Event<'_>) -> fmt::Result {
        writer.write_str(match *event.metadata().level() {
            Level::ERROR => "error: ",
            Level::WARN => "warning: ",
            _ => "",
        })?;
        let mut message = Message { writer: writer.by_ref(), outcome: Ok(()) };
        event.record(&mut message);
        message.outcome?;
        writeln!(writer)
    }
}

/// Standard error for JSON: what a terminal could take as a command is escaped.
struct Plain;

impl io::Write for Plain {
    fn write(&mut self, line: &[u8]) -> io::Result<usize> {
        io::stderr().write_all(plain_json(&String::from_utf8_lossy(line)).as_bytes()).map(|()| line.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        io::stderr().flush()
    }
}

/// JSON with the same values, and escapes for all that a terminal could take as a command. Such characters are in texts only.
pub(super) fn plain_json(json: &str) -> String {
    let escaped = |c: char| match c {
        '\n' => c.into(),
        c if is_command(c) => format!("\\u{:04x}", u32::from(c)),
        c => c.into(),
    };
    json.chars().map(escaped).collect()
}

struct Message<'a> {
    writer: Writer<'a>,
    outcome: fmt::Result,
}

impl Visit for Message<'_> {
    fn record_debug(&mut self, field: &Field, value: &dyn fmt::Debug) {
        if field.name() == "message" {
            self.outcome = self.writer.write_str(&visible(format!("{value:?}")));
        }
    }
}
