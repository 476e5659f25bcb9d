//! Ctrl-C and the termination signal: the program ends at once, except where it would leave something half-done.

use super::INTERRUPTED;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering::SeqCst};
use trgs::{Error, Result};

static REQUESTED: AtomicBool = AtomicBool::new(false);
static SHIELDS: AtomicUsize = AtomicUsize::new(0);

/// Takes over the signals.
pub(super) fn install() {
    let handler = || {
        REQUESTED.store(true, SeqCst);
        if SHIELDS.load(SeqCst) == 0 {
            tracing::error!("interrupted; nothing half-written was left behind");
            std::process::exit(INTERRUPTED.into());
        }
    };
    if let Err(error) = ctrlc::set_handler(handler) {
        tracing::warn!("an interrupt will end the program without cleaning up: {error}");
    }
}

/// Whether the user wants the program to end.
pub(super) fn requested() -> bool {
    REQUESTED.load(SeqCst)
}

/// Runs `work` to its end, whatever the user does meanwhile; long work asks [`requested`].
///
/// # Errors
/// Those of `work`, or [`Error::Interrupted`] when the user had enough before it began.
pub(super) fn shielded<T>(work: impl FnOnce() -> Result<T>) -> Result<T> {
    SHIELDS.fetch_add(1, SeqCst);
    let outcome = if requested() {
        Err(Error::Interrupted { step: 0, remedy: "what was finished before is complete".into() })
    } else {
        work()
    };
    SHIELDS.fetch_sub(1, SeqCst);
    outcome
}
