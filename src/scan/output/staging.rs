//! A folder that is written beside its target and takes its place as a whole.

use super::destination::{Destination, Standing};
use super::lock::{Hold, Lock, Scope, is_fixed, lock, make_folders};
use super::mark::Mark;
use super::sweep::{finish_in_place, sweep};
use super::temporary::{NEW, OLD, OWNER_TEXT, RANDOM};
use super::{COMMIT, OWNER, TEMPORARY, folder_of, step};
use std::fs;
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use tempfile::Builder;
use trgs_core::error::{Error, Result};

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
