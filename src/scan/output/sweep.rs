//! Removal of temporary files and folders whose process is dead, and of no others.

use super::lock::{Lock, lock};
use super::staging::{finish_in_place, is_staging, remove_staging};
use super::{OWNER, TEMPORARY, step};
use std::collections::BTreeSet;
use std::ffi::OsStr;
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

/// Random characters at the end of a temporary name.
pub(super) const RANDOM: usize = 12;

/// Whether a name is one of our temporary files or folders.
pub(super) fn is_temporary(name: &OsStr) -> bool {
    let rest = name.to_str().and_then(|name| name.strip_prefix(TEMPORARY));
    rest.is_some_and(|rest| rest.len() == RANDOM && rest.bytes().all(|byte| byte.is_ascii_alphanumeric()))
}

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
        is_temporary(&entry.file_name()) && is_staging(&entry.path()) && entry.path().join(super::COMMIT).exists()
    };
    if fs::read_dir(folder).into_iter().flatten().flatten().any(is_half_done) {
        sweep(folder);
    }
}
