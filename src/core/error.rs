//! The one error type. Each message says what was wrong, what was found and expected, and the remedy.

use crate::setting::Setting;
use crate::words::{quoted_path, visible};
use bytesize::ByteSize;
use std::io;
use std::path::{Path, PathBuf};

/// Every error that the library reports at its borders.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// A file or folder could not be read.
    #[error("cannot read {}: {source}; {}", visible(path.display()), to_read(path, source))]
    Read {
        /// The file or folder.
        path: PathBuf,
        /// The error of the operating system.
        source: std::io::Error,
    },
    /// A file or folder could not be written; no partial file was left behind.
    #[error("cannot write {}: {source}; {}", visible(path.display()), to_write(path, source))]
    Write {
        /// The file or folder.
        path: PathBuf,
        /// The error of the operating system.
        source: std::io::Error,
    },
    /// A file was read, but its content is not as expected.
    #[error("{}: {what}: got {got}, expected {}; {}", visible(path.display()), visible(expected), visible(remedy))]
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
    #[error("{what}: got {got}, expected {}; {}", visible(expected), visible(remedy))]
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
    /// Something needs more memory than the limit allows; none was allocated for it.
    #[error("{what}: got {got}, expected at most {} of memory; {remedy}", ByteSize(*limit))]
    Memory {
        /// What needs the memory, with its file if it has one.
        what: String,
        /// The memory needed.
        got: String,
        /// The limit, bytes.
        limit: u64,
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
            Self::Memory { what, got, limit, remedy } => {
                Self::Memory { what: format!("{}: {what}", visible(path.display())), got, limit, remedy }
            }
            other => other,
        }
    }

    /// Builds an [`Error::Memory`] for `needed` bytes; the remedy is a higher limit.
    pub fn memory(what: impl ToString, got: impl ToString, limit: u64, needed: u64) -> Self {
        const GIGABYTE: u64 = 1_000_000_000;
        /// A petabyte.
        const MOST: u64 = 1 << 50;
        let enough = match needed.div_ceil(GIGABYTE) {
            1 => format!("{}MB", needed.div_ceil(GIGABYTE / 1000)),
            gigabytes => format!("{gigabytes}GB"),
        };
        let remedy = match needed {
            MOST.. => "give smaller sizes: no machine has so much memory".into(),
            _ => format!("give {} {enough} on a machine that has it", Setting::MaxMemory),
        };
        Self::Memory { what: one_line(what), got: one_line(got), limit, remedy }
    }

    /// Adds a second remedy to an [`Error::Memory`]: something smaller.
    #[must_use]
    pub fn or_instead(self, instead: &str) -> Self {
        match self {
            Self::Memory { what, got, limit, remedy } => {
                Self::Memory { what, got, limit, remedy: format!("{remedy}, or {instead}") }
            }
            other => other,
        }
    }

    /// An [`Error::Invalid`] about a run that is not the checkpoint's: `what` differs from what it was.
    pub fn other_run(what: impl ToString, got: impl ToString, expected: impl Into<String>) -> Self {
        Self::invalid(what, got, expected, format!("go on with the same settings and data, or {}", start_again()))
    }

    /// An [`Error::Interrupted`] after iteration `step` of a run that keeps a checkpoint or none.
    pub fn interrupted(step: usize, is_saved: bool) -> Self {
        let remedy = match is_saved {
            true => format!("its state is saved; the same run with {} goes on from there", Setting::Resume),
            false => "nothing was written; start it again".into(),
        };
        Self::Interrupted { step, remedy }
    }

    /// Builds an [`Error::Read`] for `path`.
    ///
    /// A file that is too large for the limit on memory is an [`Error::Memory`].
    pub fn read(path: &Path, source: std::io::Error) -> Self {
        match source.downcast::<Self>() {
            Ok(error) => error.in_file(path),
            Err(source) => Self::Read { path: path.into(), source },
        }
    }

    /// Builds an [`Error::Write`] for `path`.
    pub fn write(path: &Path, source: std::io::Error) -> Self {
        Self::Write { path: path.into(), source }
    }
}

/// The remedy for a path that cannot be read, from its cause.
fn to_read(path: &Path, source: &io::Error) -> String {
    match source.kind() {
        io::ErrorKind::NotFound => not_found(path),
        io::ErrorKind::PermissionDenied => format!("allow reading it: chmod u+r {}", quoted_path(path)),
        io::ErrorKind::IsADirectory => "give a file, not a folder".into(),
        io::ErrorKind::NotADirectory => "give a path whose folders are folders: a part before its end is a file".into(),
        io::ErrorKind::InvalidData | io::ErrorKind::InvalidInput | io::ErrorKind::UnexpectedEof => {
            "its content is damaged or incomplete: copy or write it again".into()
        }
        io::ErrorKind::OutOfMemory => "it is larger than the free memory: give a part of it".into(),
        io::ErrorKind::Unsupported => "give a regular file: write its content to one first".into(),
        _ => "copy the file again, to another disk if the disk fails, and give that path".into(),
    }
}

/// The remedy for a path that does not exist: the first folder that is missing, or a name that differs in case only.
fn not_found(path: &Path) -> String {
    let Some(folder) = path.parent().filter(|folder| !folder.as_os_str().is_empty()) else {
        return similar(Path::new("."), path).unwrap_or_else(|| "correct the name, or give its folder too".into());
    };
    let missing = path.ancestors().skip(1).filter(|folder| !folder.as_os_str().is_empty());
    match missing.take_while(|folder| !folder.exists()).last() {
        Some(missing) => format!("correct the path: the folder {} does not exist", visible(missing.display())),
        None => similar(folder, path)
            .unwrap_or_else(|| format!("correct the name: the folder {} has no such file", visible(folder.display()))),
    }
}

/// A file of the folder whose name differs in case only.
fn similar(folder: &Path, path: &Path) -> Option<String> {
    let wanted = path.file_name()?.to_string_lossy().to_lowercase();
    let mut names: Vec<_> = folder.read_dir().ok()?.filter_map(|entry| Some(entry.ok()?.file_name())).collect();
    names.sort();
    let found = names.into_iter().find(|name| name.to_string_lossy().to_lowercase() == wanted)?;
    let found = if folder == Path::new(".") { PathBuf::from(found) } else { folder.join(found) };
    Some(format!("give {}: names distinguish capitals", visible(found.display())))
}

/// The remedy for a path that cannot be written, from its cause.
fn to_write(path: &Path, source: &io::Error) -> String {
    let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    match source.kind() {
        io::ErrorKind::NotFound => format!("make its folder first: mkdir -p {}", quoted_path(folder)),
        io::ErrorKind::PermissionDenied => {
            format!("name another folder, or allow writing: chmod u+w {}", quoted_path(folder))
        }
        io::ErrorKind::ReadOnlyFilesystem => "name a folder on a disk that can be written to".into(),
        io::ErrorKind::StorageFull | io::ErrorKind::QuotaExceeded => {
            "free space on that disk, or name another one".into()
        }
        io::ErrorKind::NotADirectory | io::ErrorKind::IsADirectory | io::ErrorKind::AlreadyExists => {
            "name another path: a file or folder of this name is in the way".into()
        }
        _ => "name a file on another disk".into(),
    }
}

/// The remedy for a checkpoint that cannot be used.
pub fn start_again() -> String {
    format!("start again without {}", Setting::Resume)
}

/// A part of a message on one line, whatever a file or a flag holds.
fn one_line(text: impl ToString) -> String {
    visible(text.to_string())
}
