//! Removal of temporary files and folders whose process is dead, and of no others.

use super::lock::{Lock, lock};
use super::mark::Mark;
use super::temporary::{NEW, OLD, is_staging, is_temporary, remove_staging};
use super::{COMMIT, MARK, OWNER, step};
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};
use std::{fs, io};
use trgs_core::words;

/// [`sweep`], once for each folder and process.
pub(super) fn sweep_once(folder: &Path) {
    static SWEPT: Mutex<BTreeSet<PathBuf>> = Mutex::new(BTreeSet::new());
    let mut swept = SWEPT.lock().unwrap_or_else(PoisonError::into_inner);
    if swept.insert(folder.into()) {
        drop(swept);
        sweep(folder);
    }
}

/// Removes temporary files and folders of dead processes directly in a folder.
///
/// A replacement in place that a process did not finish is finished. Errors leave things as they are.
pub(super) fn sweep(folder: &Path) {
    for entry in fs::read_dir(folder).into_iter().flatten().flatten().filter(|entry| is_temporary(&entry.file_name())) {
        let path = entry.path();
        match entry.file_type() {
            Ok(kind) if kind.is_file() => {
                if let Ok(Lock::Held(_file)) = lock(&path, false) {
                    step();
                    let _ = fs::remove_file(&path);
                }
            }
            Ok(kind) if kind.is_dir() => sweep_staging(folder, &path),
            _ => {}
        }
    }
}

fn sweep_staging(folder: &Path, staging: &Path) {
    if !is_staging(staging) {
        step();
        // A process that died before it named itself left an empty folder; any other stays.
        let _ = fs::remove_dir(staging);
    } else if let Ok(Lock::Held(_owner)) = lock(&staging.join(OWNER), false)
        && finish_in_place(staging, folder).is_ok()
    {
        remove_staging(staging);
    }
}

/// Finishes a replacement in a folder that a killed process left half done; nothing is done to other folders.
///
/// For folders that are about to be read; writers do this on their own.
pub fn recover(folder: &Path) {
    let is_half_done = |entry: fs::DirEntry| {
        is_temporary(&entry.file_name()) && is_staging(&entry.path()) && entry.path().join(COMMIT).exists()
    };
    if fs::read_dir(folder).into_iter().flatten().flatten().any(is_half_done) {
        sweep(folder);
    }
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
