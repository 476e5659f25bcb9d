//! The mark of origin in every folder that this program writes: the writer, and the digests of the files.

use super::temporary::{is_staging, is_temporary};
use super::{LOCK, LOG, MARK, write_atomically};
use crate::digest::digest_file;
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};
use std::time::SystemTime;
use trgs_core::error::Result;
use trgs_core::words;

/// The kind of content of a folder.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Kind {
    /// Projections with their geometry.
    Scan,
    /// A reconstruction.
    Run,
    /// Questions and truth for other implementations.
    Vectors,
    /// Answers to them.
    Answers,
    /// The paper's tables and their cells.
    Tables,
    /// A volume as slices.
    Slices,
}

impl Kind {
    pub(super) fn word(self) -> &'static str {
        match self {
            Self::Scan => "scan",
            Self::Run => "run",
            Self::Vectors => "folder of vectors",
            Self::Answers => "folder of answers",
            Self::Tables => "folder of tables",
            Self::Slices => "folder of slices",
        }
    }

    /// What tells two folders of the kind apart.
    pub(super) fn maker(self) -> &'static str {
        if self == Self::Run { "method" } else { "command" }
    }

    /// Files that change while a run goes on, so that they have no digest.
    pub(super) fn working_files(self) -> &'static [&'static str] {
        if self == Self::Run { &["checkpoints/last.msgpack", LOG] } else { &[] }
    }
}

/// The content of the mark. It holds no time, so equal folders have equal marks.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Mark {
    /// Program and version.
    pub program: String,
    /// The kind of content.
    pub kind: Kind,
    /// The command or the method that wrote it.
    pub by: String,
    /// SHA-256 by path relative to the folder; none for files that change while a run goes on.
    pub files: BTreeMap<String, Option<String>>,
}

impl Mark {
    /// A mark without files.
    pub(super) fn new(kind: Kind, by: &str) -> Self {
        let program = concat!("trgs ", env!("CARGO_PKG_VERSION")).into();
        Self { program, kind, by: by.into(), files: BTreeMap::new() }
    }

    /// The mark of a folder; `None` without one, or if it is damaged or of a later version.
    pub fn read(folder: &Path) -> Option<Self> {
        let path = folder.join(MARK);
        let is_file = fs::symlink_metadata(&path).is_ok_and(|found| found.is_file());
        is_file.then(|| serde_json::from_slice(&fs::read(path).ok()?).ok()).flatten()
    }

    pub(super) fn write(&self, folder: &Path) -> Result<()> {
        let text = serde_json::to_string_pretty(self).expect("string keys") + "\n";
        write_atomically(&folder.join(MARK), |file| file.write_all(text.as_bytes()))
    }

    /// Adds the files of a folder; those of `working` have no digest.
    pub(super) fn add_files(&mut self, folder: &Path, working: &[&str]) -> Result<()> {
        let mut files = Vec::new();
        let listed = walk(folder, "", &mut |path, file, entry| {
            files.extend(entry.is_file().then(|| (path.to_owned(), file.to_owned())));
            None::<()>
        });
        listed.map_err(|source| trgs_core::Error::read(folder, source))?;
        for (path, file) in files {
            let digest = if working.contains(&&*path) { None } else { Some(digest_file(&file)?) };
            self.files.insert(path, digest);
        }
        Ok(())
    }

    /// The first path in a folder that is not of this mark, and why.
    ///
    /// Without `thorough` the content of the files is not compared.
    pub(super) fn first_foreign(&self, folder: &Path, thorough: bool) -> io::Result<Option<String>> {
        let parents: BTreeSet<&str> = self.files.keys().flat_map(|path| parents(path)).collect();
        walk(folder, "", &mut |path, file, entry| {
            if entry.is_dir() && !entry.is_symlink() && parents.contains(path) {
                return None;
            }
            match self.files.get(path) {
                Some(None) if entry.is_file() => None,
                Some(Some(_)) if entry.is_file() && !thorough => None,
                Some(Some(digest)) if entry.is_file() => {
                    (!has_digest(file, digest)).then(|| format!("{path}, which was changed since"))
                }
                _ => Some(path.to_owned()),
            }
        })
    }
}

/// Size and time of a file, and the digest that it has.
type Known = (u64, Option<SystemTime>, String);

/// Whether a file has a digest; computed once in a process as long as size and time of the file stay.
fn has_digest(file: &Path, digest: &str) -> bool {
    static KNOWN: Mutex<BTreeMap<PathBuf, Known>> = Mutex::new(BTreeMap::new());
    let Ok(found) = fs::metadata(file) else { return false };
    let known = (found.len(), found.modified().ok(), digest.to_owned());
    if KNOWN.lock().unwrap_or_else(PoisonError::into_inner).get(file) == Some(&known) {
        return true;
    }
    let is_same = digest_file(file).is_ok_and(|found| found == digest);
    if is_same {
        KNOWN.lock().unwrap_or_else(PoisonError::into_inner).insert(file.into(), known);
    }
    is_same
}

/// Folders of a relative path: `a/b` of `a/b/c`, and `a`.
fn parents(path: &str) -> impl Iterator<Item = &str> {
    path.match_indices('/').map(|(end, _)| &path[..end])
}

/// Visits everything below a folder but the mark, locks and temporary files, until `visit` returns something.
///
/// It gets the path relative to the first folder, with `/`, and the whole path. Links are not followed.
pub(super) fn walk<T>(
    folder: &Path,
    prefix: &str,
    visit: &mut dyn FnMut(&str, &Path, &fs::FileType) -> Option<T>,
) -> io::Result<Option<T>> {
    let mut entries = fs::read_dir(folder)?.collect::<io::Result<Vec<_>>>()?;
    entries.sort_by_key(fs::DirEntry::file_name);
    for entry in entries {
        let kind = entry.file_type()?;
        let name = entry.file_name();
        if kind.is_file() && (is_temporary(&name) || prefix.is_empty() && [MARK, LOCK].iter().any(|own| name == *own)) {
            continue;
        }
        let path = format!("{prefix}{}", words::name(&name));
        if kind.is_dir() && prefix.is_empty() && is_temporary(&name) && is_staging(&entry.path()) {
            continue;
        }
        if let Some(found) = visit(&path, &entry.path(), &kind) {
            return Ok(Some(found));
        }
        if kind.is_dir()
            && let Some(found) = walk(&entry.path(), &format!("{path}/"), visit)?
        {
            return Ok(Some(found));
        }
    }
    Ok(None)
}

/// Removes the mark of a folder that has no other file, and with it the log of a run that has neither state nor results.
pub(super) fn remove_if_alone(folder: &Path) {
    let is_log = |path: &str| path == LOG && Mark::read(folder).is_some_and(|mark| mark.files.contains_key(LOG));
    if walk(folder, "", &mut |path, _, _| (!is_log(path)).then_some(())).is_ok_and(|found| found.is_none()) {
        for name in [LOG, MARK] {
            super::step();
            // An error leaves a folder of ours.
            let _ = fs::remove_file(folder.join(name));
        }
    }
}
