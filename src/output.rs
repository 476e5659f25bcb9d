//! Atomic writing of files and folders: content goes to a temporary name and is renamed at the end.

use crate::error::{Error, Result};
use std::collections::BTreeSet;
use std::ffi::OsString;
use std::fs::{self, File};
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};
use tempfile::{Builder, TempDir};

/// Writes a file completely or not at all.
///
/// `content` fills a temporary file in the same folder, which is then renamed to `path`: a reader sees the old file or
/// the new one. Links are followed. A path that is no regular file (a device, a pipe) is written to directly.
///
/// # Errors
/// [`Error::Write`] with the error of the operating system or of `content`; the temporary file is removed.
pub fn write_atomically(path: &Path, content: impl FnOnce(&mut BufWriter<File>) -> io::Result<()>) -> Result<()> {
    let target = fs::canonicalize(path).unwrap_or_else(|_| path.into());
    let mut content = Some(content);
    let mut once = |file: &mut BufWriter<File>| content.take().expect("called once")(file);
    replace(&target, &mut once).map_err(|source| Error::write(path, source))
}

/// [`write_atomically`], compiled once for all contents.
fn replace(target: &Path, content: &mut dyn FnMut(&mut BufWriter<File>) -> io::Result<()>) -> io::Result<()> {
    if fs::metadata(target).is_ok_and(|m| !m.is_file() && !m.is_dir()) {
        let mut device = BufWriter::new(fs::OpenOptions::new().write(true).open(target)?);
        content(&mut device)?;
        return device.flush();
    }
    let temporary = shared_with_umask(&mut Builder::new(), 0o666).prefix(".trgs-").tempfile_in(folder_of(target))?;
    let (file, temporary) = temporary.into_parts();
    let mut buffer = BufWriter::new(file);
    content(&mut buffer)?;
    // Without this, a power failure could leave the new name on an empty file.
    buffer.into_inner().map_err(io::IntoInnerError::into_error)?.sync_all()?;
    temporary.persist(target).map_err(|failure| failure.error)
}

/// Creates a folder and its missing parents; an existing folder is no error.
///
/// # Errors
/// [`Error::Write`] with the error of the operating system.
pub fn create_folder(path: &Path) -> Result<()> {
    fs::create_dir_all(path).map_err(|source| Error::write(path, source))
}

/// A temporary folder beside its target. It is deleted when dropped without [`Self::commit`].
#[derive(Debug)]
pub struct StagedFolder {
    temporary: TempDir,
    target: PathBuf,
}

/// Begins a folder that appears at `target` completely, on [`StagedFolder::commit`].
///
/// Missing parents are created.
///
/// # Errors
/// [`Error::Write`] when the parent cannot be written to.
pub fn stage_folder(target: &Path) -> Result<StagedFolder> {
    let target = fs::canonicalize(target).unwrap_or_else(|_| target.into());
    let parent = folder_of(&target);
    create_folder(parent)?;
    let temporary = shared_with_umask(&mut Builder::new(), 0o777)
        .prefix(".trgs-")
        .tempdir_in(parent)
        .map_err(|source| Error::write(&target, source))?;
    Ok(StagedFolder { temporary, target })
}

impl StagedFolder {
    /// The temporary folder to write the content to.
    pub fn path(&self) -> &Path {
        self.temporary.path()
    }

    /// Moves the folder to its target.
    ///
    /// An older folder there is replaced completely, but only if every entry in it has the name of an entry of the new
    /// one (an empty folder has none). So a dataset can be made again, and other files are never lost.
    ///
    /// # Errors
    /// [`Error::Invalid`] when another entry is in the way, [`Error::Write`] when the system refuses; in both cases the
    /// old folder is untouched and the new one is deleted.
    pub fn commit(self) -> Result<()> {
        let failed = |source| Error::write(&self.target, source);
        if !self.target.exists() {
            fs::rename(self.temporary.path(), &self.target).map_err(failed)?;
        } else {
            let ours = names(self.temporary.path()).map_err(failed)?;
            if let Some(foreign) = names(&self.target).map_err(failed)?.difference(&ours).next() {
                return Err(Error::invalid(
                    format!("output folder {}", self.target.display()),
                    format!("one that holds {}", foreign.display()),
                    "a new or empty folder, or an older result of the same kind",
                    "name another folder, or move its content away",
                ));
            }
            let attic = Builder::new().prefix(".trgs-old-").tempdir_in(folder_of(&self.target)).map_err(failed)?;
            let old = attic.path().join("old");
            fs::rename(&self.target, &old).map_err(failed)?;
            if let Err(source) = fs::rename(self.temporary.path(), &self.target) {
                fs::rename(&old, &self.target).map_err(failed)?;
                return Err(failed(source));
            }
        }
        // The temporary folder was renamed, so nothing is left to delete under its old name.
        let _ = self.temporary.keep();
        Ok(())
    }
}

/// The folder that would hold `path`, which need not exist.
fn folder_of(path: &Path) -> &Path {
    match path.parent() {
        Some(parent) if !parent.as_os_str().is_empty() => parent,
        _ => Path::new("."),
    }
}

fn names(folder: &Path) -> io::Result<BTreeSet<OsString>> {
    fs::read_dir(folder)?.map(|entry| Ok(entry?.file_name())).collect()
}

/// Gives a result the permissions of any other new file; temporary files are private by default.
fn shared_with_umask<'a, 'b>(builder: &'a mut Builder<'b, 'b>, mode: u32) -> &'a mut Builder<'b, 'b> {
    #[cfg(unix)]
    builder.permissions(std::os::unix::fs::PermissionsExt::from_mode(mode));
    #[cfg(not(unix))]
    let _ = mode;
    builder
}

#[cfg(test)]
mod tests {
    use super::*;

    fn entries(folder: &Path) -> Vec<OsString> {
        names(folder).unwrap().into_iter().collect()
    }

    #[test]
    fn a_failed_write_leaves_the_old_file_and_nothing_else() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.txt");
        write_atomically(&path, |file| file.write_all(b"old")).unwrap();
        let error = write_atomically(&path, |file| {
            file.write_all(b"ne")?;
            Err(io::Error::other("out of ink"))
        });
        assert!(matches!(&error, Err(Error::Write { path: p, .. }) if *p == path), "{error:?}");
        assert_eq!(fs::read(&path).unwrap(), b"old");
        assert_eq!(entries(folder.path()), ["a.txt"]);
    }

    #[test]
    fn a_missing_folder_is_an_error_that_names_the_file() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("missing/a.txt");
        let message = write_atomically(&path, |_| Ok(())).unwrap_err().to_string();
        assert!(message.contains("missing/a.txt") && message.contains("mkdir -p"), "{message}");
        assert_eq!(entries(folder.path()).len(), 0);
    }

    #[cfg(target_os = "linux")]
    #[test]
    fn a_full_device_is_an_error_and_stays_a_device() {
        let path = Path::new("/dev/full");
        assert!(matches!(write_atomically(path, |file| file.write_all(b"x")), Err(Error::Write { .. })));
        assert!(!fs::metadata(path).unwrap().is_file());
    }

    #[cfg(unix)]
    #[test]
    fn files_and_folders_get_ordinary_permissions() {
        use std::os::unix::fs::MetadataExt;
        let folder = tempfile::tempdir().unwrap();
        let (plain, ours) = (folder.path().join("plain"), folder.path().join("ours"));
        fs::write(&plain, "").unwrap();
        write_atomically(&ours, |_| Ok(())).unwrap();
        assert_eq!(fs::metadata(ours).unwrap().mode(), fs::metadata(plain).unwrap().mode());
        let (plain, ours) = (folder.path().join("dir"), folder.path().join("staged"));
        fs::create_dir(&plain).unwrap();
        stage_folder(&ours).unwrap().commit().unwrap();
        assert_eq!(fs::metadata(ours).unwrap().mode(), fs::metadata(plain).unwrap().mode());
    }

    #[test]
    fn a_staged_folder_appears_as_a_whole_or_not_at_all() {
        let folder = tempfile::tempdir().unwrap();
        let target = folder.path().join("deep/set");
        let staged = stage_folder(&target).unwrap();
        fs::write(staged.path().join("a"), "1").unwrap();
        assert!(!target.exists());
        drop(staged);
        assert_eq!(entries(&folder.path().join("deep")).len(), 0);

        let staged = stage_folder(&target).unwrap();
        fs::write(staged.path().join("a"), "1").unwrap();
        staged.commit().unwrap();
        assert_eq!(entries(&target), ["a"]);
        assert_eq!(entries(&folder.path().join("deep")), ["set"]);
    }

    #[test]
    fn an_older_result_is_replaced_and_foreign_files_are_protected() {
        let folder = tempfile::tempdir().unwrap();
        let target = folder.path().join("set");
        fs::create_dir(&target).unwrap();
        for text in ["1", "2"] {
            let staged = stage_folder(&target).unwrap();
            fs::write(staged.path().join("a"), text).unwrap();
            staged.commit().unwrap();
            assert_eq!(fs::read_to_string(target.join("a")).unwrap(), text);
        }
        fs::write(target.join("thesis.txt"), "years").unwrap();
        let message = stage_folder(&target).unwrap().commit().unwrap_err().to_string();
        assert!(message.contains("thesis.txt") || message.contains("holds a"), "{message}");
        assert_eq!(entries(&target), ["a", "thesis.txt"]);
        assert_eq!(entries(folder.path()), ["set"]);
    }
}
