//! A folder of finished cells that any number of processes can share.
//!
//! `cells/ID.json` is the result of a cell, `cells/ID.png` a slice of it, `cells/ID.html` a page that shows it. `cells/ID.lock` is locked by the process that
//! runs the cell: the system releases the lock of a process that dies. `cells/ID.state` is the last checkpoint of a cell that is
//! not finished: the next process goes on from it.

use super::cell::{Cell, Finding};
use crate::error::{Error, Result};
use crate::output::{create_folder, write_atomically};
use std::fs::{File, TryLockError};
use std::io::{ErrorKind, Write};
use std::path::{Path, PathBuf};

/// The folder of cells.
#[derive(Clone, Debug)]
pub struct Store {
    cells: PathBuf,
}

/// The exclusive right to run a cell.
pub(super) struct Claim {
    /// Locked until dropped.
    _lock: File,
    path: PathBuf,
}

impl Store {
    /// Opens the cells below `folder`, which is created if it does not exist.
    ///
    /// # Errors
    /// When the folder cannot be created.
    pub fn open(folder: impl AsRef<Path>) -> Result<Self> {
        let cells = folder.as_ref().join("cells");
        create_folder(&cells)?;
        Ok(Self { cells })
    }

    fn path(&self, name: &str, extension: &str) -> PathBuf {
        self.cells.join(format!("{name}.{extension}"))
    }

    /// The result of a cell, if it is finished.
    ///
    /// # Errors
    /// When its file is damaged.
    pub fn find(&self, id: &str) -> Result<Option<Finding>> {
        let path = self.path(id, "json");
        let text = match std::fs::read(&path) {
            Ok(text) => text,
            Err(error) if error.kind() == ErrorKind::NotFound => return Ok(None),
            Err(error) => return Err(Error::read(&path, error)),
        };
        let finding: Finding = serde_json::from_slice(&text).map_err(|error| {
            Error::format(
                &path,
                "finished cell",
                error,
                "a file written by this program",
                "delete the file to run the cell again",
            )
        })?;
        if finding.id != id {
            let remedy = "delete the file to run the cell again";
            return Err(Error::format(&path, "id", &finding.id, "that of the file's name", remedy));
        }
        Ok(Some(finding))
    }

    /// Claims a cell; `None` if it is finished, or another process has it and `wait` is false.
    pub(super) fn claim(&self, id: &str, wait: bool) -> Result<Option<Claim>> {
        let path = self.path(id, "lock");
        let lock = File::create(&path).map_err(|source| Error::write(&path, source))?;
        if wait {
            lock.lock().map_err(|source| Error::write(&path, source))?;
        } else {
            match lock.try_lock() {
                Ok(()) => {}
                Err(TryLockError::WouldBlock) => return Ok(None),
                Err(TryLockError::Error(source)) => return Err(Error::write(&path, source)),
            }
        }
        let claim = Claim { _lock: lock, path };
        // The cell may have been finished between the first check and the lock.
        Ok(self.find(id)?.is_none().then_some(claim))
    }

    /// Where a cell keeps its checkpoints until it is finished.
    pub(super) fn state(&self, id: &str) -> PathBuf {
        self.path(id, "state")
    }

    /// Removes what a finished cell needed, if its process died before it could.
    pub(super) fn clear(&self, id: &str) {
        let _ = std::fs::remove_file(self.state(id));
        let path = self.path(id, "lock");
        if let Ok(lock) = File::open(&path)
            && lock.try_lock().is_ok()
        {
            drop(Claim { _lock: lock, path });
        }
    }

    /// Stores the result of a cell.
    pub(super) fn keep(&self, cell: &Cell, (finding, picture, page): &(Finding, Vec<u8>, String)) -> Result<()> {
        let text = serde_json::to_string_pretty(finding).expect("a finding has string keys") + "\n";
        write_atomically(&self.path(&cell.id, "png"), |file| file.write_all(picture))?;
        write_atomically(&self.path(&cell.id, "html"), |file| file.write_all(page.as_bytes()))?;
        write_atomically(&self.path(&cell.id, "json"), |file| file.write_all(text.as_bytes()))?;
        let _ = std::fs::remove_file(self.state(&cell.id));
        Ok(())
    }

    /// Stores the slice of the truth that belongs to those of the cells.
    pub(super) fn keep_truth(&self, cell: &Cell, picture: &[u8]) -> Result<()> {
        let path = self.path(&truth(cell), "png");
        if path.exists() { Ok(()) } else { write_atomically(&path, |file| file.write_all(picture)) }
    }

    /// The slice of a cell's result as a PNG file, if there is one.
    pub(super) fn picture(&self, cell: &Cell) -> Option<Vec<u8>> {
        std::fs::read(self.path(&cell.id, "png")).ok()
    }

    /// The page of a cell beside those of the tables, if there is one.
    pub(super) fn page(&self, cell: &Cell) -> Option<String> {
        self.path(&cell.id, "html").exists().then(|| format!("cells/{}.html", cell.id))
    }

    /// The slice of its truth as a PNG file, if there is one.
    pub(super) fn picture_of_truth(&self, cell: &Cell) -> Option<Vec<u8>> {
        std::fs::read(self.path(&truth(cell), "png")).ok()
    }
}

fn truth(cell: &Cell) -> String {
    format!("truth-{}-{}", cell.case.name, cell.scale.size)
}

impl Drop for Claim {
    fn drop(&mut self) {
        // A process that locks the removed file finds the cell finished, or runs it. Two processes never write
        // different content, since equal cells have equal bits.
        let _ = std::fs::remove_file(&self.path);
    }
}
