//! Ctrl-C, the termination signal and a closed terminal: the program ends at once, but never leaves partial output.
//!
//! A signal that the parent process had ignored stays ignored, as `nohup` and the `&` of a script require.

use super::INTERRUPTED;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering::SeqCst};
use trgs::{Error, Result};

static REQUESTED: AtomicBool = AtomicBool::new(false);
static SHIELDS: AtomicUsize = AtomicUsize::new(0);

/// Installs the signal handler.
pub(super) fn install() {
    if let Err(error) = listen() {
        tracing::warn!("an interrupt will end the program without cleaning up: {error}");
    }
}

#[cfg(unix)]
fn listen() -> std::io::Result<()> {
    use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM};
    let handled = [SIGHUP, SIGINT, SIGTERM].into_iter().filter(|signal| !is_ignored(*signal));
    let mut signals = signal_hook::iterator::Signals::new(handled)?;
    let wait = move || signals.forever().for_each(|_| end());
    std::thread::Builder::new().name("signals".into()).spawn(wait).map(drop)
}

/// Whether the signal was ignored when the program began. Only Linux tells it without unsafe code.
#[cfg(unix)]
fn is_ignored(signal: i32) -> bool {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let mask = status.lines().find_map(|line| line.strip_prefix("SigIgn:"));
    let mask = mask.and_then(|mask| u64::from_str_radix(mask.trim(), 16).ok());
    mask.is_some_and(|mask| mask >> (signal - 1) & 1 == 1)
}

#[cfg(windows)]
fn listen() -> Result<(), ctrlc::Error> {
    ctrlc::set_handler(end)
}

/// There are no signals in WebAssembly.
#[cfg(not(any(unix, windows)))]
fn listen() -> std::io::Result<()> {
    Ok(())
}

/// Ends the program, or asks shielded work to end it.
fn end() {
    REQUESTED.store(true, SeqCst);
    if SHIELDS.load(SeqCst) == 0 {
        trgs::output::abandon();
        tracing::error!("interrupted; no partial output was left behind");
        std::process::exit(INTERRUPTED.into());
    }
}

/// Whether the user has requested the end of the program.
pub(super) fn requested() -> bool {
    REQUESTED.load(SeqCst)
}

/// Runs `work` to its end despite signals; long work must poll [`requested`].
///
/// # Errors
/// Those of `work`, or [`Error::Interrupted`] when a signal arrived before it began.
pub(super) fn shielded<T>(work: impl FnOnce() -> Result<T>) -> Result<T> {
    SHIELDS.fetch_add(1, SeqCst);
    let outcome = if requested() {
        Err(Error::Interrupted { step: 0, remedy: "finished output is complete; run the same command again".into() })
    } else {
        work()
    };
    SHIELDS.fetch_sub(1, SeqCst);
    outcome
}
