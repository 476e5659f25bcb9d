//! Errors about the content of files.

use std::fmt::Display;
use std::path::Path;
use trgs_core::error::Error;

/// Longest part of an error that a library may fill, characters.
const LONGEST: usize = 400;

/// An error about damaged content of a file.
pub(super) fn damaged(path: &Path, found: &str) -> Error {
    let found: String = found.chars().take(LONGEST).collect();
    Error::format(path, "volume", found, "a whole file with one number per voxel", "copy or export the file again")
}

/// An error about content that is sound, but of a kind that is not read.
pub(super) fn unsupported(path: &Path, what: &str, got: impl Display, expected: &str, remedy: &str) -> Error {
    let got: String = got.to_string().chars().take(LONGEST).collect();
    Error::format(path, what, format!("{got}, which is not supported"), expected, remedy)
}
