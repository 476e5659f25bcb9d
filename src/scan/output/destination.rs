//! The one decision about an existing folder: replace it or refuse.

use super::lock::{Hold, Lock, Scope, is_fixed, is_folder, is_mount_point, lock, make_folders};
use super::mark::{Kind, Mark, walk};
use super::sweep::sweep;
use super::{LOCK, step};
use std::fs;
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::sync::{Arc, OnceLock};
use trgs_core::error::{Error, Result};
use trgs_core::setting::{Setting, Text};

/// The writer of a folder that no command wrote.
const LIBRARY: &str = "the library";

/// A folder to write, and what may be replaced there.
#[derive(Clone, Debug)]
pub struct Destination {
    folder: PathBuf,
    pub(super) kind: Kind,
    pub(super) by: String,
    overwrite: bool,
    inputs: Vec<PathBuf>,
    /// Where other content was moved to; its copies share it.
    moved: Arc<OnceLock<PathBuf>>,
}

/// What is in the place of the folder.
pub(super) enum Standing {
    Missing,
    Empty,
    /// An unchanged folder of the same writer.
    Older(Mark),
    /// Other content, which is moved aside.
    Foreign,
}

impl Destination {
    /// A folder of a kind, written by a command or a method.
    pub fn new(folder: impl Into<PathBuf>, kind: Kind, by: impl Into<String>) -> Self {
        Self { folder: folder.into(), kind, by: by.into(), overwrite: false, inputs: Vec::new(), moved: Arc::default() }
    }

    /// The destination of another writer.
    #[must_use]
    pub fn by(self, by: impl Into<String>) -> Self {
        Self { by: by.into(), ..self }
    }

    /// The destination with another kind of content.
    #[must_use]
    pub fn of(self, kind: Kind) -> Self {
        Self { kind, ..self }
    }

    /// Whether other content is moved aside: [`Setting::Overwrite`]. It is never deleted.
    #[must_use]
    pub fn overwrite(self, overwrite: bool) -> Self {
        Self { overwrite, ..self }
    }

    /// A path that the content is made from. A folder that holds it is never replaced.
    #[must_use]
    pub fn input(mut self, path: impl Into<PathBuf>) -> Self {
        self.inputs.push(path.into());
        self
    }

    pub(super) fn overwrites(&self) -> bool {
        self.overwrite
    }

    /// The folder as it was given.
    pub fn folder(&self) -> &Path {
        &self.folder
    }

    /// The folder, with links followed.
    pub(super) fn target(&self) -> PathBuf {
        fs::canonicalize(&self.folder).unwrap_or_else(|_| without_dots(&self.folder))
    }

    /// Whether the folder may be written now.
    ///
    /// It may if it does not exist, is empty, or is an unchanged folder of the same kind and writer: every file at any depth
    /// is listed in its mark, with the same digest. [`Self::overwrite`] moves any other folder aside, unless it holds an
    /// input, the current folder or a mount point, or cannot be renamed.
    ///
    /// # Errors
    /// [`Error::Invalid`] with what is in the way, [`Error::Write`] for a folder that cannot be listed.
    pub fn check(&self) -> Result<()> {
        self.decide().map(drop)
    }

    pub(super) fn decide(&self) -> Result<Standing> {
        let target = self.target();
        let found = match fs::symlink_metadata(&target) {
            Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(Standing::Missing),
            found => found.map_err(|source| Error::write(&self.folder, source))?,
        };
        let another = "name another folder";
        let refuse = |got: String, expected: &str, remedy: Text| {
            Err(Error::invalid(format!("output folder {}", self.folder.display()), got, expected, remedy))
        };
        if found.is_symlink() {
            return refuse("a link to nothing".into(), "a folder, or a new name", another.into());
        }
        if !found.is_dir() {
            return Err(Error::write(&self.folder, io::ErrorKind::NotADirectory.into()));
        }
        if let Some(input) = self.inputs().find(|input| is_within(input, &target)) {
            let got = match fs::canonicalize(&input).is_ok_and(|input| input == target) {
                true => "the folder that is read".into(),
                false => format!("the folder that holds {}, which is read", input.display()),
            };
            return refuse(got, "a folder outside of the input", another.into());
        }
        let here = std::env::current_dir().unwrap_or_default();
        if !is_folder(&here, &target) && is_within(&here, &target) {
            return refuse("a folder that holds the current one".into(), "a folder that does not", another.into());
        }
        sweep(&target);
        let failed = |source| Error::write(&self.folder, source);
        let first = walk(&target, "", &mut |path, _, _| Some(path.to_owned())).map_err(failed)?;
        let mark = Mark::read(&target);
        let got = match (&mark, first) {
            (None, None) => return Ok(Standing::Empty),
            // Of a run that was stopped before it had a state.
            (Some(mark), None) => return Ok(Standing::Older(mark.clone())),
            (None, Some(first)) => format!("a folder that holds {first} and that this program did not write"),
            (Some(mark), _) if mark.kind != self.kind => format!("a {} of {}", mark.kind.word(), mark.by),
            (Some(mark), _) if mark.by != self.by && !self.by.is_empty() => {
                format!("a {} of another {}, {}", mark.kind.word(), mark.kind.maker(), mark.by)
            }
            (Some(mark), _) => match mark.first_foreign(&target, true).map_err(failed)? {
                None => return Ok(Standing::Older(mark.clone())),
                Some(path) => format!("a folder that holds {path}"),
            },
        };
        let by = if self.by.is_empty() { String::new() } else { format!(" of {}", self.by) };
        let expected = format!("a new or empty folder, or an unchanged {}{by}", self.kind.word());
        if is_fixed(&target) || holds_mount_point(&target) {
            return refuse(got, &expected, format!("{another}, or move its content away").into());
        }
        if self.overwrite {
            return Ok(Standing::Foreign);
        }
        let remedy = match self.by == LIBRARY {
            true => format!("{another}, or delete it").into(),
            false => Text::from(another) + ", or give " + Setting::Overwrite + " to move it aside",
        };
        refuse(got, &expected, remedy)
    }

    /// Where other content was moved to.
    pub fn moved(&self) -> Option<&Path> {
        self.moved.get().map(PathBuf::as_path)
    }

    /// Renames the folder to the first free name `NAME.replaced-1`, `-2`, … beside it, and returns that.
    pub(super) fn move_aside(&self) -> io::Result<PathBuf> {
        let target = self.target();
        let name = target.file_name().ok_or(io::ErrorKind::InvalidFilename)?;
        for number in 1_usize.. {
            let mut other = name.to_owned();
            other.push(format!(".replaced-{number}"));
            let aside = target.with_file_name(other);
            if fs::symlink_metadata(&aside).is_err_and(|error| error.kind() == io::ErrorKind::NotFound) {
                step();
                fs::rename(&target, &aside)?;
                // A run moves its folder once; later results replace its own.
                let _ = self.moved.set(aside.clone());
                return Ok(aside);
            }
        }
        unreachable!("names do not end");
    }

    /// All that is read: the paths given, and the files read so far.
    fn inputs(&self) -> impl Iterator<Item = PathBuf> {
        self.inputs.clone().into_iter().chain(crate::input::of_each_folder())
    }
}

/// A folder that the library writes on its own: an older one must be of the library too.
impl<P: AsRef<Path> + ?Sized> From<&P> for Destination {
    fn from(folder: &P) -> Self {
        Self::new(folder.as_ref(), Kind::Scan, LIBRARY)
    }
}

/// A path without its `.` and trailing separators.
fn without_dots(path: &Path) -> PathBuf {
    path.components().collect()
}

/// Whether a path is a folder, or lies in it: by name, or by what the file system says of its parents.
fn is_within(path: &Path, folder: &Path) -> bool {
    let Ok(path) = fs::canonicalize(path) else { return false };
    path.ancestors().any(|parent| is_folder(parent, folder))
}

/// Whether a file system is mounted below a folder: its content would be deleted too.
fn holds_mount_point(folder: &Path) -> bool {
    let found = walk(folder, "", &mut |_, path, kind| (kind.is_dir() && is_mount_point(path)).then_some(()));
    !matches!(found, Ok(None))
}

/// The exclusive right to write a folder that several commands share, or that exists while a run goes on.
///
/// The system releases it when the process ends, however it ends.
#[derive(Debug)]
pub struct Claim {
    _hold: Arc<Hold>,
    destination: Destination,
}

impl Claim {
    /// Claims the folder of a destination, which is created if it does not exist; dropped, an empty one goes again.
    ///
    /// # Errors
    /// Those of [`Destination::check`], and [`Error::Invalid`] if another process has it.
    pub fn new(destination: Destination) -> Result<Self> {
        destination.check()?;
        let folder = destination.folder();
        let failed = |source| Error::write(folder, source);
        loop {
            let made = make_folders(folder).map_err(failed)?;
            let path = folder.join(LOCK);
            let held = match lock(&path, true) {
                Ok(Lock::Held(file) | Lock::Unsupported(file)) => file,
                Ok(Lock::Busy) => {
                    let by = fs::read_to_string(&path).unwrap_or_default();
                    let got = format!("one that another process{} is writing", by.trim_end());
                    let expected = "a folder that nobody is writing";
                    let remedy = "wait for its end, or name another folder";
                    return Err(Error::invalid(format!("output folder {}", folder.display()), got, expected, remedy));
                }
                // The folder was replaced at this moment.
                Err(error) if error.kind() == io::ErrorKind::NotFound => continue,
                Err(error) => return Err(failed(error)),
            };
            let mut file = held.try_clone().map_err(failed)?;
            let hold = Hold { lock: held, path, scope: Scope::Folder(folder.into()), made }.register();
            file.set_len(0).and_then(|()| write!(file, " ({})", std::process::id())).map_err(failed)?;
            let claim = Self { _hold: hold, destination: destination.clone() };
            sweep(folder);
            // Another process may have written the folder before it was locked.
            return destination.check().map(|()| claim);
        }
    }

    /// Moves other content aside, and marks a folder without files as an unfinished one of the destination.
    ///
    /// # Errors
    /// Those of [`Destination::check`], and [`Error::Write`].
    pub fn begin(&self, destination: &Destination) -> Result<()> {
        let failed = |source| Error::write(self.folder(), source);
        if matches!(destination.decide()?, Standing::Foreign) {
            // The lock stays with the new folder.
            let make_room = || {
                let (target, aside) = (destination.target(), destination.move_aside()?);
                step();
                fs::create_dir(&target)?;
                step();
                fs::rename(aside.join(LOCK), target.join(LOCK))
            };
            make_room().map_err(failed)?;
        }
        if walk(self.folder(), "", &mut |_, _, _| Some(())).map_err(failed)?.is_some() {
            return Ok(());
        }
        let mut mark = Mark::new(destination.kind, &destination.by);
        mark.files.extend(destination.kind.working_files().iter().map(|&file| (file.into(), None)));
        mark.write(self.folder())
    }

    /// The folder.
    pub fn folder(&self) -> &Path {
        self.destination.folder()
    }

    /// What may be replaced there.
    pub fn destination(&self) -> Destination {
        self.destination.clone()
    }
}
