//! The one error type. Each message says what was wrong, what was found and expected, and the remedy.

use crate::setting::Setting;
use std::path::{Path, PathBuf};

/// Every error that the library reports at its borders.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// A file or folder could not be read.
    #[error("cannot read {}: {source}; check the path and its permissions", path.display())]
    Read {
        /// The file or folder.
        path: PathBuf,
        /// The error of the operating system.
        source: std::io::Error,
    },
    /// A file or folder could not be written; no partial file was left behind.
    #[error("cannot write {}: {source}; check that the folder exists, is writable and has space", path.display())]
    Write {
        /// The file or folder.
        path: PathBuf,
        /// The error of the operating system.
        source: std::io::Error,
    },
    /// A file was read, but its content is not as expected.
    #[error("{}: {what}: got {got}, expected {expected}; {remedy}", path.display())]
    Format {
        /// The file.
        path: PathBuf,
        /// The part of the file that is wrong.
        what: String,
        /// The content found.
        got: String,
        /// The content expected.
        expected: String,
        /// The action that the user can take.
        remedy: String,
    },
    /// A value given by the user cannot be used.
    #[error("{what}: got {got}, expected {expected}; {remedy}")]
    Invalid {
        /// The name of the value.
        what: String,
        /// The value given.
        got: String,
        /// The values allowed.
        expected: String,
        /// The action that the user can take.
        remedy: String,
    },
    /// A computation produced a value that is not finite. Such values are reported, never replaced.
    #[error("{stage}: {value} at index {index:?}, step {step}; the first non-finite value ends the run")]
    NonFinite {
        /// The computation.
        stage: &'static str,
        /// The value found.
        value: f64,
        /// Index in the array that the stage produces.
        index: Vec<usize>,
        /// Training iteration, or 0 outside of training.
        step: usize,
    },
    /// The user stopped the run.
    #[error("interrupted at iteration {step}; {remedy}")]
    Interrupted {
        /// The iteration reached.
        step: usize,
        /// What was saved, and how to continue.
        remedy: String,
    },
}

/// `std::result::Result` with [`Error`].
pub type Result<T> = std::result::Result<T, Error>;

impl Error {
    /// Builds an [`Error::Invalid`] from printable parts.
    pub fn invalid(
        what: impl ToString,
        got: impl ToString,
        expected: impl Into<String>,
        remedy: impl Into<String>,
    ) -> Self {
        Self::Invalid { what: one_line(what), got: one_line(got), expected: expected.into(), remedy: remedy.into() }
    }

    /// Builds an [`Error::Format`] from printable parts.
    pub fn format(
        path: &Path,
        what: impl ToString,
        got: impl ToString,
        expected: impl Into<String>,
        remedy: impl Into<String>,
    ) -> Self {
        Self::Format {
            path: path.into(),
            what: one_line(what),
            got: one_line(got),
            expected: expected.into(),
            remedy: remedy.into(),
        }
    }

    /// Turns an error about a value into an error about the file that holds the value.
    #[must_use]
    pub fn in_file(self, path: &Path) -> Self {
        match self {
            Self::Invalid { what, got, expected, remedy } => {
                Self::Format { path: path.into(), what, got, expected, remedy }
            }
            other => other,
        }
    }

    /// An [`Error::Invalid`] about a run that is not the checkpoint's: `what` differs from what it was.
    pub(crate) fn other_run(what: impl ToString, got: impl ToString, expected: impl Into<String>) -> Self {
        Self::invalid(what, got, expected, format!("go on with the same settings and data, or {}", start_again()))
    }

    /// An [`Error::Interrupted`] after iteration `step` of a run that keeps a checkpoint or none.
    pub(crate) fn interrupted(step: usize, is_saved: bool) -> Self {
        let remedy = match is_saved {
            true => format!("its state is saved; the same run with {} goes on from there", Setting::Resume),
            false => "nothing was written; start it again".into(),
        };
        Self::Interrupted { step, remedy }
    }

    /// Builds an [`Error::Read`] for `path`.
    pub fn read(path: &Path, source: std::io::Error) -> Self {
        Self::Read { path: path.into(), source }
    }

    /// Builds an [`Error::Write`] for `path`.
    pub fn write(path: &Path, source: std::io::Error) -> Self {
        Self::Write { path: path.into(), source }
    }
}

/// The remedy for a checkpoint that cannot be used.
pub(crate) fn start_again() -> String {
    format!("start again without {}", Setting::Resume)
}

/// Escapes control characters, so that a message stays on one line whatever a file or a flag holds.
fn one_line(text: impl ToString) -> String {
    let escaped = |c: char| if c.is_control() { c.escape_default().to_string() } else { c.into() };
    text.to_string().chars().map(escaped).collect()
}
