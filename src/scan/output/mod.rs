//! Writing of files and folders as a whole, and the decision which older folder is replaced.
//!
//! Content goes to a temporary name and is renamed at the end. Every folder has a mark of origin ([`Mark`]), and
//! [`Destination::check`] decides for all writers whether a folder is replaced. Temporary files and folders are locked by
//! their process; the next process removes those of a dead one.

mod destination;
mod lock;
mod mark;
mod shared;
mod staging;
mod sweep;
mod temporary;
#[cfg(test)]
mod tests;

pub use destination::{Claim, Destination};
pub use lock::abandon;
pub use mark::{Kind, Mark};
pub use shared::SharedFolder;
pub use staging::{StagedFolder, stage_folder};
pub use sweep::recover;

use lock::is_at;
use std::fs::{self, File};
use std::io::{self, BufWriter, Write};
use std::path::Path;
use sweep::sweep_once;
use tempfile::{Builder, NamedTempFile};
use temporary::RANDOM;
use trgs_core::error::{Error, Result};

/// Name of the mark of a folder.
pub const MARK: &str = ".trgs.json";
/// Name of the log of a run, which grows while the run goes on.
const LOG: &str = "log.jsonl";
/// Name of the lock of a folder.
const LOCK: &str = ".trgs.lock";
/// Beginning of the names of temporary files and folders.
const TEMPORARY: &str = ".trgs-tmp-";
/// File in a staging folder that names it as ours; its process has locked it.
const OWNER: &str = "owner";
/// File in a staging folder that records the decision to replace in place.
const COMMIT: &str = "commit";

/// Refuses a file that was read, if the reading is recorded.
///
/// # Errors
/// [`Error::Invalid`].
pub fn check_file(path: &Path) -> Result<()> {
    match fs::canonicalize(path) {
        Ok(target) if crate::input::was_read(&target) => {
            let what = format!("output file {}", path.display());
            Err(Error::invalid(what, "a file that is read", "another file", "give another name"))
        }
        _ => Ok(()),
    }
}

/// Writes a file completely or not at all.
///
/// `content` fills a temporary file in the same folder, which is then renamed to `path`: a reader sees the old file or
/// the new one. Links are followed. A path that is no regular file (a device, a pipe) is written to directly.
///
/// # Errors
/// [`Error::Write`] with the error of the operating system or of `content`; the temporary file is removed.
pub fn write_atomically(path: &Path, content: impl FnOnce(&mut BufWriter<File>) -> io::Result<()>) -> Result<()> {
    let target = fs::canonicalize(path).unwrap_or_else(|_| path.into());
    let mut content = Some(content);
    let mut once = |file: &mut BufWriter<File>| content.take().expect("called once")(file);
    replace(&target, &mut once).map_err(|source| Error::write(path, source))
}

/// [`write_atomically`], compiled once for all contents.
fn replace(target: &Path, content: &mut dyn FnMut(&mut BufWriter<File>) -> io::Result<()>) -> io::Result<()> {
    if fs::metadata(target).is_ok_and(|m| !m.is_file() && !m.is_dir()) {
        let mut device = BufWriter::new(fs::OpenOptions::new().write(true).open(target)?);
        content(&mut device)?;
        return device.flush();
    }
    sweep_once(folder_of(target));
    let (file, temporary) = locked_file(folder_of(target))?.into_parts();
    let mut buffer = BufWriter::new(file);
    content(&mut buffer)?;
    let file = buffer.into_inner().map_err(io::IntoInnerError::into_error)?;
    // Without this, a power failure could leave the new name on an empty file.
    file.sync_all()?;
    step();
    temporary.persist(target).map_err(|failure| failure.error)
}

/// A temporary file that other processes see to be in use.
fn locked_file(folder: &Path) -> io::Result<NamedTempFile> {
    loop {
        step();
        let mut builder = Builder::new();
        let builder = shared_with_umask(builder.prefix(TEMPORARY).rand_bytes(RANDOM), 0o666);
        let temporary = builder.tempfile_in(folder)?;
        step();
        match temporary.as_file().try_lock() {
            // Another process took it for a dead one's, before it was locked.
            Err(fs::TryLockError::WouldBlock) => {}
            Ok(()) if !is_at(temporary.as_file(), temporary.path()) => {}
            Ok(()) | Err(fs::TryLockError::Error(_)) => return Ok(temporary),
        }
    }
}

/// A place where a process may be killed: tests do so at each of them.
fn step() {
    #[cfg(test)]
    tests::step();
}

/// Creates a folder and its missing parents; an existing folder is no error.
///
/// # Errors
/// [`Error::Write`] with the error of the operating system.
pub fn create_folder(path: &Path) -> Result<()> {
    fs::create_dir_all(path).map_err(|source| Error::write(path, source))
}

/// The folder that would hold `path`, which need not exist.
fn folder_of(path: &Path) -> &Path {
    match path.parent() {
        Some(parent) if !parent.as_os_str().is_empty() => parent,
        _ => Path::new("."),
    }
}

/// Gives a result the permissions of any other new file; temporary files are private by default.
fn shared_with_umask<'a, 'b>(builder: &'a mut Builder<'b, 'b>, mode: u32) -> &'a mut Builder<'b, 'b> {
    #[cfg(unix)]
    builder.permissions(std::os::unix::fs::PermissionsExt::from_mode(mode));
    #[cfg(not(unix))]
    let _ = mode;
    builder
}
