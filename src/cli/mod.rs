//! The command line: one file per command; global flags and exit codes here.
//!
//! Results go to standard output, as a table or with `--json` as one object. Everything else goes to standard error.
//! Exit codes: 0 success, 1 a check failed, 2 bad input or usage, 130 interrupted.

mod arguments;
#[cfg(feature = "oracle")]
mod compare;
mod confidence;
mod convert;
mod corrections;
mod cost;
mod demo;
mod evaluate;
mod explain;
mod flags;
mod geometry_check;
mod inspect;
mod interrupt;
mod messages;
mod mix;
#[cfg(feature = "oracle")]
mod oracle;
mod output;
mod pace;
mod progress;
mod reconstruct;
mod render;
mod report;
mod run_folder;
mod run_log;
mod simulate;
mod table;
mod view;
mod views;
mod voxelize;

use bytesize::ByteSize;
use clap::error::{ContextKind, ContextValue, ErrorKind};
use clap::{Args, CommandFactory, Parser, Subcommand, ValueEnum, value_parser};
use output::Output;
use std::ffi::OsString;
use std::sync::OnceLock;
use trgs::numeric::threads;
use trgs::words::counted;
use trgs::{Error, Result, limit};

const CHECK_SAID_NO: u8 = 1;
const BAD_INPUT: u8 = 2;
const INTERRUPTED: u8 = 130;
/// Largest number of workers; more only wait for each other.
const MOST_THREADS: i64 = 1024;

/// Sparse-view CT reconstruction with Student's t kernels on the CPU, bit-identical on every machine
#[derive(Parser)]
#[command(name = "trgs", version, after_help = "Example:\n  trgs demo")]
struct Cli {
    #[command(flatten)]
    global: Global,
    #[command(subcommand)]
    command: Command,
}

/// Flags of every command.
#[derive(Args)]
#[command(next_help_heading = "Options of every command")]
struct Global {
    /// Number of worker threads, 0 for one per core; no result depends on it
    #[arg(long, global = true, display_order = 1000, value_name = "N", default_value_t = 0,
        value_parser = value_parser!(u16).range(..=MOST_THREADS))]
    threads: u16,
    /// Print only errors and the result
    #[arg(long, global = true, display_order = 1000)]
    quiet: bool,
    /// Format of progress and messages on standard error
    #[arg(long, global = true, display_order = 1000, value_enum, value_name = "FORMAT", default_value_t = LogFormat::Text)]
    log_format: LogFormat,
    /// Use at most this much memory, such as 12GB or 512MiB, with volumes of total variation in slabs of files where that is
    /// enough; refuse what may need more [default: three quarters of the machine's]
    #[arg(long, global = true, display_order = 1000, value_name = "SIZE")]
    max_memory: Option<ByteSize>,
    /// Print the result as one JSON object
    #[arg(long, global = true, display_order = 1000)]
    json: bool,
}

#[derive(Clone, Copy, PartialEq, Eq, ValueEnum)]
enum LogFormat {
    /// Sentences, and a progress bar on a terminal.
    Text,
    /// One JSON object per line.
    Json,
}

#[derive(Subcommand)]
enum Command {
    Demo(demo::Demo),
    Simulate(simulate::Simulate),
    Reconstruct(reconstruct::Reconstruct),
    Evaluate(evaluate::Evaluate),
    Mix(mix::Mix),
    Render(render::Render),
    Voxelize(voxelize::Voxelize),
    Confidence(confidence::Confidence),
    #[cfg(feature = "oracle")]
    Oracle(oracle::Oracle),
    Table(table::Table),
    Report(report::Report),
    #[cfg(feature = "oracle")]
    Compare(compare::Compare),
    Inspect(inspect::Inspect),
    Convert(convert::Convert),
    View(view::View),
}

/// The name of the program and its arguments.
static ARGUMENTS: OnceLock<Vec<OsString>> = OnceLock::new();

/// Runs the program with its name and its arguments; returns the exit code.
///
/// # Panics
/// The second time in a process: signals, messages and limits are those of the process.
pub fn main(given: impl IntoIterator<Item = OsString>) -> u8 {
    ARGUMENTS.set(given.into_iter().collect()).expect("the program runs once in a process");
    let cli = match Cli::try_parse_from(arguments()).map_err(name_the_commands) {
        Ok(cli) => cli,
        Err(usage) => {
            // If standard error is closed, there is no place to report to.
            let _ = usage.print();
            return if usage.use_stderr() { BAD_INPUT } else { 0 };
        }
    };
    messages::install(&cli.global);
    limit::set(cli.global.max_memory.map(|limit| limit.as_u64()));
    messages::unused_instructions();
    interrupt::install();
    trgs::input::record();
    arguments().skip(1).for_each(|argument| trgs::output::recover(argument.as_ref()));
    tell_of_threads(cli.global.threads.into());
    let answer = threads::install(cli.global.threads.into(), || cli.command.run(&cli.global));
    match answer.flatten().and_then(|answer| answer.print(cli.global.json).map(|()| answer.approves())) {
        Ok(true) => 0,
        Ok(false) => CHECK_SAID_NO,
        Err(error) => {
            messages::error(&error);
            if matches!(error, Error::Interrupted { .. }) { INTERRUPTED } else { BAD_INPUT }
        }
    }
}

/// The name of the program and its arguments.
fn arguments() -> impl Iterator<Item = &'static OsString> {
    ARGUMENTS.get().into_iter().flatten()
}

impl Command {
    fn run(&self, global: &Global) -> Result<Output> {
        match self {
            Self::Demo(command) => command.run(global),
            Self::Simulate(command) => command.run(),
            Self::Reconstruct(command) => command.run(global),
            Self::Evaluate(command) => command.run(),
            Self::Mix(command) => command.run(),
            Self::Render(command) => command.run(global),
            Self::Voxelize(command) => command.run(global),
            Self::Confidence(command) => command.run(),
            #[cfg(feature = "oracle")]
            Self::Oracle(command) => command.run(global),
            Self::Table(command) => command.run(global),
            Self::Report(command) => command.run(),
            #[cfg(feature = "oracle")]
            Self::Compare(command) => command.run(),
            Self::Inspect(command) => command.run(global),
            Self::Convert(command) => command.run(),
            Self::View(command) => command.run(),
        }
    }
}

/// Warns of more worker threads than the machine has cores.
fn tell_of_threads(threads: usize) {
    let cores = threads::cores().unwrap_or(usize::MAX);
    if threads > cores {
        tracing::warn!(
            "--threads {threads}: this machine has {}; more threads than cores only wait for each other",
            counted(cores, "core")
        );
    }
}

/// Adds the list of commands to the error about an unknown command.
fn name_the_commands(mut error: clap::Error) -> clap::Error {
    if error.kind() == ErrorKind::InvalidSubcommand {
        let names: Vec<_> = Cli::command().get_subcommands().map(|c| c.get_name().to_owned()).collect();
        let tip = format!("the commands are {}", names.join(", "));
        error.insert(ContextKind::Suggested, ContextValue::StyledStrs(vec![tip.into()]));
    }
    error
}
