//! Opening of files to read: regular files only, and a record of them on request.
//!
//! A pipe without a writer would block, and a device such as `/dev/zero` has no end.

use crate::digest::{digest_file, open_unrecorded};
use crate::limit;
use std::cell::RefCell;
use std::collections::{BTreeMap, BTreeSet};
use std::fs::{self, File, Metadata};
use std::io;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};
use std::time::SystemTime;
use trgs_core::error::{Error, Result};
use trgs_core::words;

/// Size and time of the last change of a file: equal ones mean equal content.
type Stamp = (u64, Option<SystemTime>);

/// Files by path.
type Record = BTreeMap<PathBuf, Stamp>;

/// Where the recorded files are, without links; folder → files.
static PLACES: Mutex<BTreeMap<PathBuf, BTreeSet<PathBuf>>> = Mutex::new(BTreeMap::new());

/// Files opened since [`record`] was called; `None` before.
static RECORD: Mutex<Option<Record>> = Mutex::new(None);

thread_local! {
    /// Files opened by the work of [`digests_of`]; `None` outside.
    static OF_THREAD: RefCell<Option<Record>> = const { RefCell::new(None) };
}

/// Begins to record the files that are read, for [`digests`] and for outputs, which never replace a folder of inputs.
pub fn record() {
    RECORD.lock().unwrap_or_else(PoisonError::into_inner).get_or_insert_default();
}

/// A file in each folder of which a file was read.
pub(crate) fn of_each_folder() -> Vec<PathBuf> {
    let places = PLACES.lock().unwrap_or_else(PoisonError::into_inner);
    places.values().filter_map(|files| files.first().cloned()).collect()
}

/// Whether a file, named without links, was read.
pub(crate) fn was_read(path: &Path) -> bool {
    let places = PLACES.lock().unwrap_or_else(PoisonError::into_inner);
    path.parent().and_then(|folder| places.get(folder)).is_some_and(|files| files.contains(path))
}

fn stamp(found: &Metadata) -> Stamp {
    (found.len(), found.modified().ok())
}

/// Opens a regular file, and records it.
pub fn open(path: &Path) -> io::Result<File> {
    let file = open_unrecorded(path)?;
    let stamp = stamp(&file.metadata()?);
    // The first reading counts: a later change is one during the command.
    let add = |record: &mut Record| _ = record.entry(path.into()).or_insert(stamp);
    if RECORD.lock().unwrap_or_else(PoisonError::into_inner).as_mut().map(add).is_some() {
        let place = fs::canonicalize(path)?;
        let folder = place.parent().unwrap_or(&place).to_owned();
        PLACES.lock().unwrap_or_else(PoisonError::into_inner).entry(folder).or_default().insert(place);
    }
    OF_THREAD.with_borrow_mut(|record| record.as_mut().map(add));
    Ok(file)
}

/// The content of a regular file.
pub fn read(path: &Path) -> io::Result<Vec<u8>> {
    limit::read_to_end(open(path)?)
}

/// The content of a text, which may also come from a pipe, as the shell's `<(command)` does.
pub fn read_text(path: &Path) -> io::Result<Vec<u8>> {
    #[cfg(unix)]
    if fs::metadata(path).is_ok_and(|found| std::os::unix::fs::FileTypeExt::is_fifo(&found.file_type())) {
        return limit::read_to_end(File::open(path)?);
    }
    read(path)
}

/// SHA-256 of every file that was read since [`record`] was called, by path.
///
/// # Errors
/// [`Error::Read`] for a file that cannot be read again, and [`Error::Format`] for one that was changed since it was read.
pub fn digests() -> Result<BTreeMap<String, String>> {
    of(RECORD.lock().unwrap_or_else(PoisonError::into_inner).clone().unwrap_or_default())
}

/// The result of `work`, and the digests of the files that it reads on this thread.
pub fn digests_of<T>(work: impl FnOnce() -> Result<T>) -> Result<(T, BTreeMap<String, String>)> {
    OF_THREAD.set(Some(Record::new()));
    let found = work();
    let files = OF_THREAD.take().unwrap_or_default();
    Ok((found?, of(files)?))
}

fn of(files: Record) -> Result<BTreeMap<String, String>> {
    let digest = |(path, then): (PathBuf, Stamp)| {
        let digest = digest_file(&path)?;
        let now = stamp(&fs::metadata(&path).map_err(|source| Error::read(&path, source))?);
        if now != then {
            let expected = "one that stays as it is while it is read";
            let remedy = "repeat the command once nothing writes the file";
            return Err(Error::format(&path, "file", "a file that was changed after it was read", expected, remedy));
        }
        Ok((words::name(&path), digest))
    };
    files.into_iter().map(digest).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::digest::digest_bytes;

    #[test]
    fn digests_are_those_of_the_bytes_that_were_read() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a");
        fs::write(&path, "first").unwrap();
        let reading = || read(&path).map_err(|source| Error::read(&path, source));
        let (content, digests) = digests_of(reading).unwrap();
        assert_eq!(digests.into_values().collect::<Vec<_>>(), [digest_bytes(&content)]);
        let message = digests_of(|| {
            let content = reading()?;
            fs::write(&path, "second, of another length").unwrap();
            Ok(content)
        });
        let message = message.unwrap_err().to_string();
        assert!(message.contains("changed after it was read"), "{message}");
        // Files of other work are not in the record.
        assert_eq!(digests_of(|| Ok(())).unwrap().1, BTreeMap::new());
    }

    #[test]
    fn a_remedy_says_what_was_on_disk_when_the_error_was_made() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a/b.npy");
        let error = trgs_core::error::Error::read(&path, io::ErrorKind::NotFound.into());
        let message = error.to_string();
        fs::create_dir(folder.path().join("a")).unwrap();
        assert!(message.ends_with("a does not exist") && error.to_string() == message, "{message}");
    }

    #[cfg(unix)]
    #[test]
    fn a_pipe_is_refused_without_waiting_and_texts_may_come_from_one() {
        let folder = tempfile::tempdir().unwrap();
        let pipe = folder.path().join("pipe");
        assert!(std::process::Command::new("mkfifo").arg(&pipe).status().unwrap().success());
        for error in [read(&pipe).unwrap_err(), read(Path::new("/dev/zero")).unwrap_err()] {
            assert_eq!(error.kind(), io::ErrorKind::Unsupported);
        }
        assert_eq!(read_text(Path::new("/dev/zero")).unwrap_err().kind(), io::ErrorKind::Unsupported);
        let writer = {
            let pipe = pipe.clone();
            std::thread::spawn(move || fs::write(pipe, "0 1 2"))
        };
        assert_eq!(read_text(&pipe).unwrap(), b"0 1 2");
        writer.join().unwrap().unwrap();
    }
}
