//! Locks that the system releases when their process ends, and what a process leaves behind if it is stopped.

use super::step;
use super::temporary::remove_staging;
use std::fs::{self, File, Metadata, OpenOptions, TryLockError};
use std::io;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError, Weak};

/// The outcome of [`lock`].
pub(super) enum Lock {
    /// The lock is held until the file is dropped.
    Held(File),
    /// Another process holds it.
    Busy,
    /// The file system has no locks.
    Unsupported(File),
}

/// Locks the file at `path`, which is created if `create` says so.
pub(super) fn lock(path: &Path, create: bool) -> io::Result<Lock> {
    loop {
        let file = OpenOptions::new().read(true).write(true).create(create).truncate(false).open(path)?;
        match file.try_lock() {
            // The file may have been removed, with its lock, after it was opened.
            Ok(()) if !is_at(&file, path) && !create => return Err(io::ErrorKind::NotFound.into()),
            Ok(()) if !is_at(&file, path) => {}
            Ok(()) => return Ok(Lock::Held(file)),
            Err(TryLockError::WouldBlock) => return Ok(Lock::Busy),
            Err(TryLockError::Error(_)) => return Ok(Lock::Unsupported(file)),
        }
    }
}

/// Whether `path` still names the open file.
pub(super) fn is_at(file: &File, path: &Path) -> bool {
    let pair = file.metadata().and_then(|open| Ok((open, fs::symlink_metadata(path)?)));
    pair.is_ok_and(|(open, named)| is_same(&open, &named))
}

/// Whether both describe one file or folder.
#[cfg(unix)]
pub(super) fn is_same(a: &Metadata, b: &Metadata) -> bool {
    use std::os::unix::fs::MetadataExt;
    (a.dev(), a.ino()) == (b.dev(), b.ino())
}

/// Whether both describe one file or folder: unknown on this system, where open files are not removed.
#[cfg(not(unix))]
pub(super) fn is_same(_: &Metadata, _: &Metadata) -> bool {
    true
}

/// Whether two paths are one folder, whatever their names are.
pub(super) fn is_folder(a: &Path, b: &Path) -> bool {
    if cfg!(unix) {
        return matches!((fs::metadata(a), fs::metadata(b)), (Ok(a), Ok(b)) if is_same(&a, &b));
    }
    matches!((fs::canonicalize(a), fs::canonicalize(b)), (Ok(a), Ok(b)) if a == b)
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

/// A locked file, and what is removed when it is released.
#[derive(Debug)]
pub(super) struct Hold {
    pub(super) lock: File,
    pub(super) path: PathBuf,
    pub(super) scope: Scope,
    /// Folders that were created for it, outermost first; they are removed if they are empty.
    pub(super) made: Vec<PathBuf>,
}

/// What a lock is for.
#[derive(Debug)]
pub(super) enum Scope {
    /// A staging folder, removed with its content.
    Staging(PathBuf),
    /// The folder of a run, of which only the lock is removed, and a mark without other files.
    Folder(PathBuf),
}

/// What is held at the moment.
static HELD: Mutex<Vec<Weak<Hold>>> = Mutex::new(Vec::new());

impl Hold {
    pub(super) fn register(self) -> Arc<Self> {
        let hold = Arc::new(self);
        let mut held = HELD.lock().unwrap_or_else(PoisonError::into_inner);
        held.retain(|other| other.strong_count() > 0);
        held.push(Arc::downgrade(&hold));
        hold
    }

    fn release(&self) {
        match &self.scope {
            Scope::Staging(folder) if is_at(&self.lock, &self.path) => remove_staging(folder),
            Scope::Folder(folder) if is_at(&self.lock, &self.path) => {
                super::mark::remove_if_alone(folder);
                step();
                // An error leaves a file that nobody holds, which the next process takes over.
                let _ = fs::remove_file(&self.path);
            }
            _ => {}
        }
        for folder in self.made.iter().rev() {
            step();
            // Fails for a folder that has content, as it should.
            let _ = fs::remove_dir(folder);
        }
    }
}

impl Drop for Hold {
    fn drop(&mut self) {
        self.release();
    }
}

/// Removes what this process would remove at its end: unfinished folders and locks. For the end on a signal.
pub fn abandon() {
    // A thread that holds the mutex is registering something empty.
    let Ok(held) = HELD.try_lock() else { return };
    held.iter().filter_map(Weak::upgrade).for_each(|hold| hold.release());
}

/// Creates a folder and its missing parents; returns those created, outermost first.
pub(super) fn make_folders(folder: &Path) -> io::Result<Vec<PathBuf>> {
    let missing = folder.ancestors().take_while(|folder| !folder.as_os_str().is_empty() && !folder.exists());
    let mut made: Vec<PathBuf> = missing.map(Into::into).collect();
    made.reverse();
    step();
    fs::create_dir_all(folder)?;
    Ok(made)
}
