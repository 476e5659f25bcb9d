//! A folder that several processes add files to. Nothing is removed from it, so other files may be in it.

use super::destination::Destination;
use super::lock::is_at;
use super::mark::Mark;
use super::{LOCK, create_folder, write_atomically};
use crate::digest::{digest_bytes, digest_file};
use std::fs::{self, File, OpenOptions};
use std::io::{self, Write};
use std::path::PathBuf;
use trgs_core::error::{Error, Result};
use trgs_core::setting::Setting;

/// A folder whose files are replaced only if they are as they were written.
#[derive(Debug)]
pub struct SharedFolder(Destination);

impl SharedFolder {
    /// Opens a folder, which is created if it does not exist, for files of these names.
    ///
    /// # Errors
    /// [`Error::Invalid`] for a folder of another kind, and for a file of one of the names that the mark does not list with
    /// its digest, unless [`Destination::overwrite`] allows to replace it. [`Error::Write`].
    pub fn open(destination: Destination, names: impl IntoIterator<Item = String>) -> Result<Self> {
        let shared = Self(destination);
        let folder = shared.0.folder();
        if let Some(mark) = Mark::read(folder).filter(|mark| mark.kind != shared.0.kind) {
            let what = format!("output folder {}", folder.display());
            let expected = format!("a {}, or a folder without results", shared.0.kind.word());
            return Err(Error::invalid(what, format!("a {}", mark.kind.word()), expected, "name another folder"));
        }
        names.into_iter().try_for_each(|name| shared.check(&shared.mark(), &name))?;
        create_folder(folder)?;
        shared.locked(|| if folder.join(super::MARK).exists() { Ok(()) } else { shared.mark().write(folder) })?;
        Ok(shared)
    }

    fn mark(&self) -> Mark {
        Mark::read(self.0.folder()).unwrap_or_else(|| Mark::new(self.0.kind, &self.0.by))
    }

    fn check(&self, mark: &Mark, name: &str) -> Result<()> {
        let path = self.0.folder().join(name);
        if self.0.overwrites() || fs::symlink_metadata(&path).is_err() {
            return Ok(());
        }
        let got = match mark.files.get(name) {
            // Its process ended between the file and the mark.
            Some(None) => return Ok(()),
            Some(Some(digest)) if digest_file(&path).is_ok_and(|found| found == *digest) => return Ok(()),
            Some(Some(_)) => "a file that was changed after it was written",
            None => "a file that this program did not write",
        };
        let remedy = "move it away, name another folder, or give " + Setting::Overwrite + " to replace it";
        let expected = "a new file, or one of this program that is as it was written";
        Err(Error::invalid(format!("output file {}", path.display()), got, expected, remedy))
    }

    /// Writes a file, and its digest in the mark.
    ///
    /// # Errors
    /// Those of [`Self::open`].
    pub fn write(&self, name: &str, content: &[u8]) -> Result<PathBuf> {
        let folder = self.0.folder();
        let path = folder.join(name);
        self.locked(|| {
            let mut mark = self.mark();
            self.check(&mark, name)?;
            // After a kill between the two, the file counts as ours.
            mark.files.insert(name.into(), None);
            mark.write(folder)?;
            write_atomically(&path, |file| file.write_all(content))?;
            mark.files.insert(name.into(), Some(digest_bytes(content)));
            mark.write(folder)
        })?;
        Ok(path)
    }

    /// Runs `work` while no other process is in `locked`.
    fn locked<T>(&self, work: impl FnOnce() -> Result<T>) -> Result<T> {
        let path = self.0.folder().join(LOCK);
        let open = || -> io::Result<File> {
            loop {
                let file = OpenOptions::new().write(true).create(true).truncate(false).open(&path)?;
                // On a file system without locks, the last process to write the mark wins.
                let _ = file.lock();
                if is_at(&file, &path) {
                    return Ok(file);
                }
            }
        };
        let lock = open().map_err(|source| Error::write(&path, source))?;
        let done = work();
        // Removed while it is locked: another process that waits for it opens it again.
        let _ = fs::remove_file(&path);
        drop(lock);
        done
    }
}
