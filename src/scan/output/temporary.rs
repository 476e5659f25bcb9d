//! Names and marks of temporary files and folders.

use super::{OWNER, TEMPORARY, step};
use std::ffi::OsStr;
use std::fs;
use std::path::Path;

/// Random characters at the end of a temporary name.
pub(super) const RANDOM: usize = 12;
/// Content of the file that names a staging folder as ours.
pub(super) const OWNER_TEXT: &[u8] = b"temporary folder of trgs\n";
/// Folder of the new content.
pub(super) const NEW: &str = "new";
/// Folder of the old content, in a replacement in place.
pub(super) const OLD: &str = "old";

/// Whether a name is one of our temporary files or folders.
pub(super) fn is_temporary(name: &OsStr) -> bool {
    let rest = name.to_str().and_then(|name| name.strip_prefix(TEMPORARY));
    rest.is_some_and(|rest| rest.len() == RANDOM && rest.bytes().all(|byte| byte.is_ascii_alphanumeric()))
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
