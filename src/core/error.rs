//! The one error type. Each message says what was wrong, what was found and expected, and the remedy.

use crate::setting::{Setting, Text};
use crate::words::quoted_path;
use bytesize::ByteSize;
use std::path::{Path, PathBuf};
use std::{fmt, io};

/// Every error that the library reports at its borders.
#[derive(Debug)]
#[non_exhaustive]
pub enum Error {
    /// A file or folder could not be read.
    Read {
        /// The file or folder.
        path: PathBuf,
        /// The error of the operating system.
        source: io::Error,
        /// The action that the user can take.
        remedy: Text,
    },
    /// A file or folder could not be written; no partial file was left behind.
    Write {
        /// The file or folder.
        path: PathBuf,
        /// The error of the operating system.
        source: io::Error,
        /// The action that the user can take.
        remedy: Text,
    },
    /// A file was read, but its content is not as expected.
    Format {
        /// The file.
        path: PathBuf,
        /// The part of the file that is wrong.
        what: Text,
        /// The content found.
        got: String,
        /// The content expected.
        expected: String,
        /// The action that the user can take.
        remedy: Text,
    },
    /// A value given by the user cannot be used.
    Invalid {
        /// The name of the value.
        what: Text,
        /// The value given.
        got: String,
        /// The values allowed.
        expected: String,
        /// The action that the user can take.
        remedy: Text,
    },
    /// Something needs more memory than the limit allows; none was allocated for it.
    Memory {
        /// What needs the memory, with its file if it has one.
        what: Text,
        /// The memory needed.
        got: String,
        /// The limit, bytes.
        limit: u64,
        /// The action that the user can take.
        remedy: Text,
    },
    /// A computation produced a value that is not finite. Such values are reported, never replaced.
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
    Interrupted {
        /// The iteration reached.
        step: usize,
        /// What was saved, and how to continue.
        remedy: Text,
    },
}

/// `std::result::Result` with [`Error`].
pub type Result<T> = std::result::Result<T, Error>;

impl Error {
    /// Builds an [`Error::Invalid`] from printable parts.
    pub fn invalid(
        what: impl Into<Text>,
        got: impl ToString,
        expected: impl Into<String>,
        remedy: impl Into<Text>,
    ) -> Self {
        Self::Invalid { what: what.into(), got: got.to_string(), expected: expected.into(), remedy: remedy.into() }
    }

    /// Builds an [`Error::Format`] from printable parts.
    pub fn format(
        path: &Path,
        what: impl Into<Text>,
        got: impl ToString,
        expected: impl Into<String>,
        remedy: impl Into<Text>,
    ) -> Self {
        Self::Format {
            path: path.into(),
            what: what.into(),
            got: got.to_string(),
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
                Self::Memory { what: Text::from(format!("{}: ", path.display())) + what, got, limit, remedy }
            }
            other => other,
        }
    }

    /// Puts the part that the value belongs to before its name in an [`Error::Invalid`].
    #[must_use]
    pub fn within(self, part: impl fmt::Display) -> Self {
        match self {
            Self::Invalid { what, got, expected, remedy } => {
                Self::Invalid { what: Text::from(format!("{part}: ")) + what, got, expected, remedy }
            }
            other => other,
        }
    }

    /// Builds an [`Error::Memory`] for `needed` bytes; the remedy is a higher limit.
    pub fn memory(what: impl Into<Text>, got: impl ToString, limit: u64, needed: u64) -> Self {
        const GIGABYTE: u64 = 1_000_000_000;
        /// A petabyte.
        const MOST: u64 = 1 << 50;
        let enough = match needed.div_ceil(GIGABYTE) {
            1 => format!("{}MB", needed.div_ceil(GIGABYTE / 1000)),
            gigabytes => format!("{gigabytes}GB"),
        };
        let remedy = match needed {
            MOST.. => "give smaller sizes: no machine has so much memory".into(),
            _ => "give " + Setting::MaxMemory + format!(" {enough} on a machine that has it"),
        };
        Self::Memory { what: what.into(), got: got.to_string(), limit, remedy }
    }

    /// Adds a second remedy to an [`Error::Memory`]: something smaller.
    #[must_use]
    pub fn or_instead(self, instead: impl Into<Text>) -> Self {
        match self {
            Self::Memory { what, got, limit, remedy } => {
                Self::Memory { what, got, limit, remedy: remedy + ", or " + instead }
            }
            other => other,
        }
    }

    /// An [`Error::Invalid`] about a run that is not the checkpoint's: `what` differs from what it was.
    pub fn other_run(what: impl Into<Text>, got: impl ToString, expected: impl Into<String>) -> Self {
        Self::invalid(what, got, expected, "go on with the same settings and data, or " + start_again())
    }

    /// An [`Error::Interrupted`] after iteration `step` of a run that keeps a checkpoint or none.
    pub fn interrupted(step: usize, is_saved: bool) -> Self {
        let remedy = match is_saved {
            true => "its state is saved; the same run with " + Setting::Resume + " goes on from there",
            false => "nothing was written; start it again".into(),
        };
        Self::Interrupted { step, remedy }
    }

    /// Builds an [`Error::Read`] for `path`, whose remedy is what the disk holds there now.
    ///
    /// A file that is too large for the limit on memory is an [`Error::Memory`].
    pub fn read(path: &Path, source: io::Error) -> Self {
        match source.downcast::<Self>() {
            Ok(error) => error.in_file(path),
            Err(source) => Self::Read { path: path.into(), remedy: to_read(path, &source).into(), source },
        }
    }

    /// Builds an [`Error::Write`] for `path`. An error about what is written is returned as it is.
    pub fn write(path: &Path, source: io::Error) -> Self {
        let failed = |source| Self::Write { path: path.into(), remedy: to_write(path, &source).into(), source };
        source.downcast().unwrap_or_else(failed)
    }

    /// The message, on one line.
    pub fn text(&self) -> Text {
        let failed = |verb: &str, path: &Path, source: &io::Error| {
            let source: Vec<_> = source.to_string().lines().map(|line| line.trim().to_owned()).collect();
            Text::from(format!("cannot {verb} {}: {}; ", path.display(), source.join(" ")))
        };
        match self {
            Self::Read { path, source, remedy } => failed("read", path, source) + remedy,
            Self::Write { path, source, remedy } => failed("write", path, source) + remedy,
            Self::Format { path, what, got, expected, remedy } => {
                Text::from(format!("{}: ", path.display()))
                    + what
                    + format!(": got {got}, expected {expected}; ")
                    + remedy
            }
            Self::Invalid { what, got, expected, remedy } => {
                Text::from(what) + format!(": got {got}, expected {expected}; ") + remedy
            }
            Self::Memory { what, got, limit, remedy } => {
                Text::from(what) + format!(": got {got}, expected at most {} of memory; ", ByteSize(*limit)) + remedy
            }
            Self::NonFinite { stage, value, index, step } => {
                format!("{stage}: {value} at index {index:?}, step {step}; the first non-finite value ends the run")
                    .into()
            }
            Self::Interrupted { step, remedy } => Text::from(format!("interrupted at iteration {step}; ")) + remedy,
        }
    }
}

impl fmt::Display for Error {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.text().fmt(f)
    }
}

impl std::error::Error for Error {
    fn source(&self) -> Option<&(dyn std::error::Error + 'static)> {
        match self {
            Self::Read { source, .. } | Self::Write { source, .. } => Some(source),
            _ => None,
        }
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
        Some(missing) => format!("correct the path: the folder {} does not exist", missing.display()),
        None => similar(folder, path)
            .unwrap_or_else(|| format!("correct the name: the folder {} has no such file", folder.display())),
    }
}

/// A file of the folder whose name differs in case only.
fn similar(folder: &Path, path: &Path) -> Option<String> {
    let wanted = path.file_name()?.to_string_lossy().to_lowercase();
    let mut names: Vec<_> = folder.read_dir().ok()?.filter_map(|entry| Some(entry.ok()?.file_name())).collect();
    names.sort();
    let found = names.into_iter().find(|name| name.to_string_lossy().to_lowercase() == wanted)?;
    let found = if folder == Path::new(".") { PathBuf::from(found) } else { folder.join(found) };
    Some(format!("give {}: names distinguish capitals", found.display()))
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
pub fn start_again() -> Text {
    "start again without " + Setting::Resume
}
