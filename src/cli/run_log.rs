//! `log.jsonl` of a run while it goes on: a line for each record, written at once.
//!
//! The file begins again at every start, with the records of the checkpoint. So a line that a kill left half-written is
//! gone, and the lines after a resumption are those of an uninterrupted run but for their seconds. At the end of the run
//! the whole file is written with the results.

use serde::Serialize;
use std::fs::File;
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use trgs::output::create_folder;
use trgs::train::Record;

/// The file, created with its first line.
pub(super) struct RunLog {
    path: PathBuf,
    state: State,
}

enum State {
    Waiting,
    Open(File),
    /// The results have the log, too: a run is not lost for this file.
    Failed,
}

impl RunLog {
    /// A log that begins with the records of a checkpoint.
    pub(super) fn begin(path: PathBuf, records: &[Record]) -> Self {
        let mut log = Self { path, state: State::Waiting };
        records.iter().for_each(|record| log.write(record));
        log
    }

    pub(super) fn write(&mut self, record: &impl Serialize) {
        if let Err(error) = self.append(record) {
            tracing::warn!("{} does not grow: {error}; the results will have the whole log", self.path.display());
            self.state = State::Failed;
        }
    }

    fn append(&mut self, record: &impl Serialize) -> io::Result<()> {
        if matches!(self.state, State::Waiting) {
            create_folder(self.path.parent().unwrap_or(Path::new("."))).map_err(io::Error::other)?;
            self.state = State::Open(File::create(&self.path)?);
        }
        match &mut self.state {
            State::Open(file) => file.write_all(to_line(record).as_bytes()),
            State::Waiting | State::Failed => Ok(()),
        }
    }
}

/// A record as a line of a log.
pub(super) fn to_line(record: &impl Serialize) -> String {
    serde_json::to_string(record).expect("a record consists of numbers") + "\n"
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs;

    #[test]
    fn a_log_begins_again_and_a_half_written_line_is_gone() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("run/log.jsonl");
        let mut log = RunLog::begin(path.clone(), &[]);
        assert!(!path.exists());
        log.write(&1);
        assert_eq!(fs::read_to_string(&path).unwrap(), "1\n");
        log.write(&2);
        fs::write(&path, "1\n2").unwrap();
        let mut log = RunLog::begin(path.clone(), &[]);
        [1, 2, 3].iter().for_each(|record| log.write(record));
        assert_eq!(fs::read_to_string(&path).unwrap(), "1\n2\n3\n");
        // A folder of that name.
        let mut log = RunLog::begin(folder.path().to_owned(), &[]);
        log.write(&1);
        assert!(matches!(log.state, State::Failed));
    }
}
