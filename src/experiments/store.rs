//! A folder of finished cells, which any number of processes may share.
//!
//! `cells/ID.json` is what a cell found, `cells/ID.png` a slice of it, `cells/ID.lock` is locked by the process that
//! is at work on it: the system frees the lock of a process that dies, so a kill loses no more than one cell.

use super::cell::{Cell, Finding};
use crate::error::{Error, Result};
use crate::output::{create_folder, write_atomically};
use std::fs::{File, TryLockError};
use std::io::{ErrorKind, Write};
use std::path::{Path, PathBuf};

/// The folder.
#[derive(Clone, Debug)]
pub struct Store {
    cells: PathBuf,
}

/// The right to do a cell.
pub(super) struct Claim {
    /// Locked until it is dropped.
    _lock: File,
    path: PathBuf,
}

impl Store {
    /// The cells below `folder`, which is made if it does not exist.
    ///
    /// # Errors
    /// When it cannot be made.
    pub fn open(folder: &Path) -> Result<Self> {
        let cells = folder.join("cells");
        create_folder(&cells)?;
        Ok(Self { cells })
    }

    fn path(&self, name: &str, extension: &str) -> PathBuf {
        self.cells.join(format!("{name}.{extension}"))
    }

    /// What a cell found, if it is finished.
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
            Error::format(&path, "finished cell", error, "what this program writes", "remove the file to run it again")
        })?;
        if finding.id != id {
            let remedy = "remove the file to run it again";
            return Err(Error::format(&path, "id", &finding.id, "that of the file's name", remedy));
        }
        Ok(Some(finding))
    }

    /// The right to do a cell that is not finished; None while another process has it and one may not `wait`, and when
    /// it is finished.
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
        // It may have been finished between the question and the lock.
        Ok(self.find(id)?.is_none().then_some(claim))
    }

    /// Removes the lock of a finished cell whose process died between the two.
    pub(super) fn clear(&self, id: &str) {
        let path = self.path(id, "lock");
        if let Ok(lock) = File::open(&path)
            && lock.try_lock().is_ok()
        {
            drop(Claim { _lock: lock, path });
        }
    }

    /// Keeps what a cell found.
    pub(super) fn keep(&self, cell: &Cell, finding: &Finding, picture: &[u8]) -> Result<()> {
        let text = serde_json::to_string_pretty(finding).expect("a finding has string keys") + "\n";
        write_atomically(&self.path(&cell.id, "png"), |file| file.write_all(picture))?;
        write_atomically(&self.path(&cell.id, "json"), |file| file.write_all(text.as_bytes()))
    }

    /// Keeps the slice of the truth that goes with those of the cells.
    pub(super) fn keep_truth(&self, cell: &Cell, picture: &[u8]) -> Result<()> {
        let path = self.path(&truth(cell), "png");
        if path.exists() { Ok(()) } else { write_atomically(&path, |file| file.write_all(picture)) }
    }

    /// The slice of what a cell found, as a PNG file, where there is one.
    pub(super) fn picture(&self, cell: &Cell) -> Option<Vec<u8>> {
        std::fs::read(self.path(&cell.id, "png")).ok()
    }

    /// The same of the truth.
    pub(super) fn picture_of_truth(&self, cell: &Cell) -> Option<Vec<u8>> {
        std::fs::read(self.path(&truth(cell), "png")).ok()
    }
}

fn truth(cell: &Cell) -> String {
    format!("truth-{}-{}", cell.case.name, cell.scale.size)
}

impl Drop for Claim {
    fn drop(&mut self) {
        // Whoever holds the removed file locked finds the cell finished, or does it; two never write it at once with
        // different content, as equal cells have equal bits.
        let _ = std::fs::remove_file(&self.path);
    }
}
