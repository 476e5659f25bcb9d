//! Ctrl-C and the termination signal: the program ends at once, but never leaves partial output.

use super::INTERRUPTED;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering::SeqCst};
use trgs::{Error, Result};

static REQUESTED: AtomicBool = AtomicBool::new(false);
static SHIELDS: AtomicUsize = AtomicUsize::new(0);

/// Installs the signal handler.
pub(super) fn install() {
    let handler = || {
        REQUESTED.store(true, SeqCst);
        if SHIELDS.load(SeqCst) == 0 {
            tracing::error!("interrupted; no partial output was left behind");
            std::process::exit(INTERRUPTED.into());
        }
    };
    if let Err(error) = ctrlc::set_handler(handler) {
        tracing::warn!("an interrupt will end the program without cleaning up: {error}");
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
