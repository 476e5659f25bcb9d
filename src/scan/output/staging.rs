//! A folder that is written beside its target and takes its place as a whole.

use super::destination::{Destination, Standing};
use super::lock::{Hold, Lock, Scope, is_folder, lock, make_folders};
use super::mark::Mark;
use super::sweep::{RANDOM, sweep};
use super::{COMMIT, MARK, OWNER, TEMPORARY, folder_of, step};
use std::collections::BTreeSet;
use std::fs;
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use tempfile::Builder;
use trgs_core::error::{Error, Result};
use trgs_core::words;

/// Content of the file that names a staging folder as ours.
const OWNER_TEXT: &[u8] = b"temporary folder of trgs\n";
/// Folder of the new content.
const NEW: &str = "new";
/// Folder of the old content, in a replacement in place.
const OLD: &str = "old";

/// A temporary folder for the content of a [`Destination`]. It is deleted when dropped without [`Self::commit`].
///
/// It lies beside its target. It lies in it where the target cannot be renamed: a mount point, the current folder, or a
/// folder in one that cannot be written to.
#[derive(Debug)]
pub struct StagedFolder {
    _hold: Arc<Hold>,
    staging: PathBuf,
    destination: Destination,
    target: PathBuf,
    is_inside: bool,
}

/// Begins a folder that appears completely, on [`StagedFolder::commit`]. Missing parents are created.
///
/// # Errors
/// Those of [`Destination::check`], and [`Error::Write`] when neither the parent nor the folder can be written to.
pub fn stage_folder(destination: impl Into<Destination>) -> Result<StagedFolder> {
    let destination = destination.into();
    let standing = destination.decide()?;
    let target = destination.target();
    let failed = |source| Error::write(&target, source);
    let parent = folder_of(&target);
    let mut made = make_folders(parent).map_err(failed)?;
    sweep(parent);
    // Other content is moved aside by its name.
    let exists = target.is_dir() && !matches!(standing, Standing::Foreign);
    let must_be_inside = exists && is_fixed(&target);
    let beside = if must_be_inside { None } else { Some(begin(parent, &mut made)) };
    let (hold, staging, is_inside) = match beside {
        Some(Ok((hold, staging))) if !exists || can_exchange(&staging) => (hold, staging, false),
        Some(Err(source)) if !exists => return Err(failed(source)),
        _ => {
            let (hold, staging) = begin(&target, &mut made).map_err(failed)?;
            (hold, staging, true)
        }
    };
    Ok(StagedFolder { _hold: hold, staging, destination, target, is_inside })
}

/// Creates a staging folder in `parent`.
fn begin(parent: &Path, made: &mut Vec<PathBuf>) -> io::Result<(Arc<Hold>, PathBuf)> {
    loop {
        step();
        let staging = Builder::new().prefix(TEMPORARY).rand_bytes(RANDOM).tempdir_in(parent)?.keep();
        let path = staging.join(OWNER);
        step();
        let mut owner = match lock(&path, true) {
            Ok(Lock::Held(owner) | Lock::Unsupported(owner)) => owner,
            // Another process took it for a dead one's, before it was locked.
            Ok(Lock::Busy) => continue,
            Err(error) if error.kind() == io::ErrorKind::NotFound && parent.exists() => continue,
            Err(error) => return Err(error),
        };
        let made = std::mem::take(made);
        let hold = Hold { lock: owner.try_clone()?, path, scope: Scope::Staging(staging.clone()), made }.register();
        step();
        owner.write_all(OWNER_TEXT)?;
        step();
        fs::create_dir(staging.join(NEW))?;
        return Ok((hold, staging));
    }
}

impl StagedFolder {
    /// The temporary folder to write the content to.
    pub fn path(&self) -> PathBuf {
        self.staging.join(NEW)
    }

    /// Marks the folder as ours and moves it to its target. [`Destination::check`] decides which older folder it replaces.
    ///
    /// Where the system can exchange two names, the target is the old or the new folder at any moment. Where it cannot, and
    /// in a folder that cannot be renamed, the entries are moved one by one; a process that is killed then leaves a record,
    /// and the next one that writes there finishes the replacement.
    ///
    /// # Errors
    /// Those of [`Destination::check`], and [`Error::Write`]. The old folder is untouched, and the complete new one is
    /// kept: the error names its place.
    pub fn commit(self) -> Result<()> {
        self.move_to_target().map_err(|error| self.kept(error))
    }

    fn move_to_target(&self) -> Result<()> {
        let (new, target) = (self.path(), &self.target);
        let failed = |source| Error::write(target, source);
        let mut mark = Mark::new(self.destination.kind, &self.destination.by);
        mark.add_files(&new, self.destination.kind.working_files())?;
        mark.write(&new)?;
        // Files may have been added since the folder was begun.
        let standing = self.destination.decide()?;
        step();
        match standing {
            Standing::Missing => fs::rename(&new, target).map_err(failed),
            Standing::Foreign => {
                let aside = self.destination.move_aside().map_err(failed)?;
                step();
                fs::rename(&new, target).map_err(|source| {
                    // Nothing is lost if this fails, too: the content has its new name.
                    let _ = fs::rename(&aside, target);
                    failed(source)
                })
            }
            _ if self.is_inside => {
                fs::File::create(self.staging.join(COMMIT)).map_err(failed)?;
                finish_in_place(&self.staging, target).map_err(failed)
            }
            standing => {
                exchange(&new, target).map_err(failed)?;
                if let Standing::Older(mark) = standing
                    && !matches!(mark.first_foreign(&new, false), Ok(None))
                {
                    // A file was added after the check.
                    exchange(&new, target).map_err(failed)?;
                    self.destination.decide()?;
                }
                Ok(())
            }
        }
    }

    /// Keeps the folder, and says so in the error.
    fn kept(&self, error: Error) -> Error {
        // Without this file, no process takes the folder for a temporary one.
        if fs::remove_file(self.staging.join(OWNER)).is_err() {
            return error;
        }
        let place = self.path();
        let place = place.display();
        match error {
            Error::Invalid { what, got, expected, remedy } => {
                let remedy = remedy + format!(". The complete result was kept in {place}");
                Error::Invalid { what, got, expected, remedy }
            }
            Error::Write { path, source, .. } => {
                let what = format!("output folder {}", path.display());
                let remedy = format!("take the complete result from {place}");
                Error::invalid(what, source, "a folder that can be written and replaced", remedy)
            }
            other => other,
        }
    }
}

/// Removes a staging folder; the file that names it goes last.
pub(super) fn remove_staging(staging: &Path) {
    for entry in fs::read_dir(staging).into_iter().flatten().flatten() {
        let path = entry.path();
        if path.file_name().is_some_and(|name| name != OWNER) {
            step();
            // What cannot be removed stays for the next process.
            let _ = if path.is_dir() { fs::remove_dir_all(&path) } else { fs::remove_file(&path) };
        }
    }
    if fs::read_dir(staging).is_ok_and(|entries| entries.flatten().count() <= 1) {
        step();
        let _ = fs::remove_file(staging.join(OWNER));
        step();
        let _ = fs::remove_dir(staging);
    }
}

/// Whether a folder with the name of a temporary one was made by this program.
pub(super) fn is_staging(staging: &Path) -> bool {
    let owner = staging.join(OWNER);
    fs::symlink_metadata(&owner).is_ok_and(|found| found.is_file() && found.len() <= OWNER_TEXT.len() as u64)
        && fs::read(owner).is_ok_and(|text| OWNER_TEXT.starts_with(&text))
}

/// Moves the new content of a staging folder to `target`, in which it lies, and the old content to the staging folder.
///
/// It goes on where a killed process stopped. Without the record of a decision, nothing is done. The old mark is moved
/// after all old files, and the new mark after all new ones.
pub(super) fn finish_in_place(staging: &Path, target: &Path) -> io::Result<()> {
    let (new, old) = (staging.join(NEW), staging.join(OLD));
    if !staging.join(COMMIT).exists() || !new.join(MARK).exists() {
        return Ok(());
    }
    if target.join(MARK).exists() && !old.join(MARK).exists() {
        step();
        fs::create_dir_all(&old)?;
        let mark = Mark::read(target).ok_or(io::ErrorKind::InvalidData)?;
        let firsts: BTreeSet<&str> = mark.files.keys().filter_map(|path| path.split('/').next()).collect();
        for entry in fs::read_dir(target)? {
            let name = entry?.file_name();
            if firsts.contains(&*words::name(&name)) {
                step();
                fs::rename(target.join(&name), old.join(&name))?;
            }
        }
        step();
        fs::rename(target.join(MARK), old.join(MARK))?;
    }
    for entry in fs::read_dir(&new)? {
        let name = entry?.file_name();
        if name == MARK {
            continue;
        }
        if fs::symlink_metadata(target.join(&name)).is_ok() {
            return Err(io::ErrorKind::AlreadyExists.into());
        }
        step();
        fs::rename(new.join(&name), target.join(&name))?;
    }
    step();
    fs::rename(new.join(MARK), target.join(MARK))
}

/// Whether a folder cannot be renamed: a mount point, or the current folder, which a shell would lose.
pub(super) fn is_fixed(folder: &Path) -> bool {
    is_mount_point(folder) || std::env::current_dir().is_ok_and(|here| is_folder(&here, folder))
}

/// Whether a file system is mounted at a folder.
#[cfg(unix)]
pub(super) fn is_mount_point(folder: &Path) -> bool {
    use std::os::unix::fs::MetadataExt;
    #[cfg(target_os = "linux")]
    {
        use rustix::fs::{AtFlags, CWD, StatxAttributes, StatxFlags, statx};
        // A mount of a folder of the same file system shows only here.
        if let Ok(found) = statx(CWD, folder, AtFlags::empty(), StatxFlags::empty())
            && found.stx_attributes_mask.contains(StatxAttributes::MOUNT_ROOT)
        {
            return found.stx_attributes.contains(StatxAttributes::MOUNT_ROOT);
        }
    }
    let device = |path: &Path| fs::metadata(path).map(|found| found.dev());
    matches!((device(folder), device(&folder.join(".."))), (Ok(a), Ok(b)) if a != b)
}

/// Whether a file system is mounted at a folder: unknown on this system.
#[cfg(not(unix))]
pub(super) fn is_mount_point(_: &Path) -> bool {
    false
}

/// Exchanges the names of two folders at once.
#[cfg(any(target_os = "linux", target_os = "android", target_vendor = "apple"))]
fn exchange(a: &Path, b: &Path) -> io::Result<()> {
    use rustix::fs::{CWD, RenameFlags, renameat_with};
    step();
    Ok(renameat_with(CWD, a, CWD, b, RenameFlags::EXCHANGE)?)
}

/// Exchanges the names of two folders at once: not possible on this system.
#[cfg(not(any(target_os = "linux", target_os = "android", target_vendor = "apple")))]
fn exchange(_: &Path, _: &Path) -> io::Result<()> {
    Err(io::ErrorKind::Unsupported.into())
}

/// Whether the file system of a staging folder can exchange names.
fn can_exchange(staging: &Path) -> bool {
    #[cfg(test)]
    if super::tests::FORBID_EXCHANGE.get() {
        return false;
    }
    let (new, probe) = (staging.join(NEW), staging.join(OLD));
    fs::create_dir(&probe).is_ok_and(|()| exchange(&new, &probe).is_ok() & fs::remove_dir(&probe).is_ok())
}
