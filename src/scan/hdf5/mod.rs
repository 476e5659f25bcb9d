//! HDF5 files: arrays of numbers with names. The crate hdf5-reader parses the format.
//!
//! `FILE.h5:/group/name` names an array of a file; without a name the only array with three axes is read, or the scan of
//! a known layout (see `Hdf5::scan`). MATLAB's files from version 7.3 on are HDF5. The axes of an array are `[z, y, x]`, and of
//! a stack `[view, v, u]`; MATLAB writes `A(x, y, z)` in this order.
//!
//! Numbers are integers, or floats of 16, 32 or 64 bits, contiguous or in chunks, with the filters deflate, shuffle, LZ4,
//! SZIP, n-bit and scale-offset. Attributes are not read, except for the unit of angles. Of the file, only what is asked
//! for is read.
//!
//! Groups are searched for arrays down to [`DEEPEST`] levels, [`MOST_GROUPS`] in all, for links may lead to one group under
//! any number of names. A file with more is remarked on; an array beyond these limits is read by its name.

mod half;
pub(super) mod layouts;

use super::array_path;
use super::content::{damaged, unsupported};
use super::npy::{self, Numbers};
use crate::limit;
use half::Half;
use hdf5_reader::group::Group;
use hdf5_reader::storage::{BytesStorage, DynStorage, FileStorage};
use hdf5_reader::{Dataset, Datatype, H5Type, Hdf5File, OpenOptions};
use ndarray::{Array3, ArrayD, Axis, Ix3};
use std::io::Read;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use trgs_core::error::{Error, Result};
use trgs_core::words::quoted;

/// How a MATLAB file begins that is not HDF5.
const OLD_MATLAB: &[u8] = b"MATLAB 5.0";

/// Deflate makes at most so many bytes of one.
const EXPANSION: usize = 1032;
/// Most bytes of an array in a small file: arrays of constant values take no space.
const LEAST: usize = 1 << 20;
/// Nested groups that are searched, with the root.
pub const DEEPEST: usize = 16;
/// Groups that are searched.
pub const MOST_GROUPS: usize = 1000;
/// Arrays that a message names.
const LISTED: usize = 12;
/// Characters of a name or of a cause that a message shows.
const LONGEST: usize = 60;

/// An array of numbers in a file.
#[derive(Clone)]
pub struct Entry {
    /// Path from the root: `/group/name`.
    pub name: String,
    /// Lengths of the axes.
    pub shape: Vec<usize>,
    /// Type of the numbers, such as `uint16`.
    pub numbers: String,
    dataset: Dataset,
}

impl Entry {
    /// The name itself for an array of other values.
    fn new(name: String, dataset: Dataset) -> std::result::Result<Self, String> {
        let shape = dataset.shape().iter().map(|&n| usize::try_from(n).unwrap_or(usize::MAX)).collect();
        match type_of(dataset.dtype()) {
            Some(numbers) => Ok(Self { name, shape, numbers, dataset }),
            None => Err(name),
        }
    }

    /// Whether two names are of one array.
    fn is_same(&self, other: &Self) -> bool {
        self.dataset.address() == other.dataset.address()
    }
}

/// The arrays of a file.
pub struct Hdf5 {
    path: PathBuf,
    root: Group,
    entries: Vec<Entry>,
    /// Names of the arrays of other values.
    others: Vec<String>,
    /// The limit that ended the search, and the first group that was not searched.
    ended: Option<(String, String)>,
}

impl Hdf5 {
    /// Reads the names of all arrays of numbers.
    ///
    /// # Errors
    /// [`Error::Read`], or [`Error::Format`] for a file that is not HDF5.
    pub fn read(path: impl AsRef<Path>) -> Result<Self> {
        let path = path.as_ref();
        let failed = |source| Error::read(path, source);
        let mut file = crate::input::open(path).map_err(failed)?;
        let mut head = Vec::new();
        file.by_ref().take(OLD_MATLAB.len() as u64).read_to_end(&mut head).map_err(failed)?;
        let storage = FileStorage::from_file(file).map_err(|error| cause(path, "file", &error))?;
        Self::search_in(Arc::new(storage), &head, path)
    }

    pub(super) fn parse(content: &[u8], path: &Path) -> Result<Self> {
        Self::search_in(Arc::new(BytesStorage::new(content.to_vec())), content, path)
    }

    /// The arrays of a file that begins with `head`.
    fn search_in(storage: DynStorage, head: &[u8], path: &Path) -> Result<Self> {
        if head.starts_with(OLD_MATLAB) {
            let remedy = "save it in MATLAB with the option -v7.3, or convert it: python -c \"import numpy, scipy.io; \
                          numpy.save('OUT.npy', scipy.io.loadmat('IN.mat')['NAME'])\"";
            return Err(Error::format(path, "file", "a MATLAB file before version 7.3", "version 7.3", remedy));
        }
        let most = usize::try_from(storage.len()).unwrap_or(usize::MAX).saturating_mul(EXPANSION).max(LEAST);
        let options = OpenOptions::default().with_max_read_bytes(most).with_max_chunk_bytes(most);
        let file =
            Hdf5File::from_storage_with_options(storage, options).map_err(|error| cause(path, "file", &error))?;
        let root = file.root_group().map_err(|error| cause(path, "root group", &error))?;
        let mut found =
            Self { path: path.to_owned(), root: root.clone(), entries: Vec::new(), others: Vec::new(), ended: None };
        let mut left = MOST_GROUPS;
        found.search(&root, "", &mut Vec::new(), &mut left)?;
        Ok(found)
    }

    /// Adds the arrays of a group and of those below it; `above` are the groups that contain it.
    fn search(&mut self, group: &Group, name: &str, above: &mut Vec<u64>, left: &mut usize) -> Result<()> {
        // Links may form cycles, and several may lead to one group.
        if above.contains(&group.address()) {
            return Ok(());
        }
        if *left == 0 || above.len() == DEEPEST {
            let limit =
                if *left == 0 { format!("after {MOST_GROUPS} groups") } else { format!("{DEEPEST} levels deep") };
            self.ended.get_or_insert_with(|| (limit, shorter(name)));
            return Ok(());
        }
        *left -= 1;
        above.push(group.address());
        let what = if name.is_empty() { "root group" } else { name };
        let (groups, datasets) = group.members().map_err(|error| cause(&self.path, &shorter(what), &error))?;
        for dataset in datasets {
            let name = format!("{name}/{}", dataset.name());
            match Entry::new(name, dataset) {
                Ok(entry) => self.entries.push(entry),
                Err(name) => self.others.push(name),
            }
        }
        for child in groups {
            let name = format!("{name}/{}", child.name());
            self.search(&child, &name, above, left)?;
        }
        above.pop();
        Ok(())
    }

    /// A remark on a search that did not reach all groups.
    pub fn limit(&self) -> Option<String> {
        let (limit, group) = self.ended.as_ref()?;
        let name = quoted(&format!("{}:/path/of/array", self.path.display()));
        Some(format!(
            "the search for arrays ended {limit}, before {group}: others may follow; name the array to read, as in {name}"
        ))
    }

    /// All arrays of numbers, group by group.
    pub fn entries(&self) -> &[Entry] {
        &self.entries
    }

    /// The array of a name, which may be stated without the `/` in front.
    ///
    /// # Errors
    /// [`Error::Format`] that names the arrays of the file.
    pub fn entry(&self, name: &str) -> Result<Entry> {
        let full = format!("/{}", name.trim_start_matches('/'));
        if let Some(entry) = self.entries.iter().find(|entry| entry.name == full) {
            return Ok(entry.clone());
        }
        let beyond = self.ended.as_ref().and_then(|_| self.beyond(&full));
        let is_other = match beyond {
            Some(Ok(entry)) => return Ok(entry),
            Some(Err(_)) => true,
            None => self.others.contains(&full),
        };
        if is_other {
            let remedy = "write it as float32 with h5py";
            let expected = "integers, or floats of 32 or 64 bits";
            return Err(unsupported(&self.path, &shorter(&full), "its type", expected, remedy));
        }
        let remedy = format!("name one of its arrays: {}", self.list_all());
        Err(Error::format(&self.path, "array", shorter(&full), "an array of numbers of this file", remedy))
    }

    /// An array that the search may not have reached; its name for one of other values.
    fn beyond(&self, full: &str) -> Option<std::result::Result<Entry, String>> {
        let (groups, name) = full.rsplit_once('/')?;
        let mut group = self.root.clone();
        for part in groups.split('/').filter(|part| !part.is_empty()) {
            group = group.group(part).ok()?;
        }
        Some(Entry::new(full.to_owned(), group.dataset(name).ok()?))
    }

    /// The names of the arrays for a message, and that there may be others.
    fn list_all(&self) -> String {
        let others = self
            .ended
            .as_ref()
            .map_or_else(String::new, |(limit, group)| format!(" (the search ended {limit}, before {group})"));
        format!("{}{others}", list(&self.distinct()))
    }

    /// The only array with three axes longer than 1, or with three axes.
    fn only_volume(&self) -> Result<&Entry> {
        let distinct = self.distinct();
        let with_axes: Vec<&Entry> = distinct.iter().copied().filter(|entry| entry.shape.len() == 3).collect();
        let solid: Vec<&Entry> = with_axes.iter().copied().filter(|entry| entry.shape.iter().all(|&n| n > 1)).collect();
        match (with_axes.as_slice(), solid.as_slice()) {
            (&[entry], _) | (_, &[entry]) => Ok(entry),
            _ => {
                let expected = "one array with three axes, or a name";
                let name = with_axes.first().map_or("/group/name", |entry| &entry.name);
                let remedy =
                    format!("name the array: {}", quoted(&format!("{}:{}", self.path.display(), shorter(name))));
                Err(Error::format(&self.path, "arrays", self.list_all(), expected, remedy))
            }
        }
    }

    /// Each array once, under the shortest of its names.
    fn distinct(&self) -> Vec<&Entry> {
        let mut found: Vec<&Entry> = Vec::new();
        for entry in &self.entries {
            match found.iter().position(|other| other.is_same(entry)) {
                Some(at) if entry.name.len() < found[at].name.len() => found[at] = entry,
                Some(_) => {}
                None => found.push(entry),
            }
        }
        found
    }

    /// The values of an array, in the order of the file: the last axis is fastest.
    ///
    /// # Errors
    /// [`Error::Format`] for data that cannot be read.
    pub fn numbers(&self, entry: &Entry) -> Result<Numbers> {
        let dataset = &entry.dataset;
        let (size, signed, floating) = match dataset.dtype() {
            Datatype::FixedPoint { size, signed, .. } => (*size, *signed, false),
            Datatype::FloatingPoint { size, .. } => (*size, true, true),
            _ => (0, false, false),
        };
        // As stored, and as f32 or f64.
        let what = format!("array {}", shorter(&entry.name));
        limit::allow_array(what, &entry.shape, size as usize + size_of::<f64>())
            .map_err(|error| error.in_file(&self.path))?;
        let single = |values: ArrayD<f32>| Ok(Numbers::F32(values));
        let double = |values: ArrayD<f64>| Ok(Numbers::F64(values));
        match (size, signed, floating) {
            (2, _, true) => single(self.values::<Half>(entry)?.mapv(|Half(value)| value)),
            (4, _, true) => single(self.values::<f32>(entry)?),
            (8, _, true) => double(self.values::<f64>(entry)?),
            (1, true, _) => single(self.values::<i8>(entry)?.mapv(f32::from)),
            (1, false, _) => single(self.values::<u8>(entry)?.mapv(f32::from)),
            (2, true, _) => single(self.values::<i16>(entry)?.mapv(f32::from)),
            (2, false, _) => single(self.values::<u16>(entry)?.mapv(f32::from)),
            (4, true, _) => double(self.values::<i32>(entry)?.mapv(f64::from)),
            (4, false, _) => double(self.values::<u32>(entry)?.mapv(f64::from)),
            (8, true, _) => double(self.values::<i64>(entry)?.mapv(|value| value as f64)),
            _ => double(self.values::<u64>(entry)?.mapv(|value| value as f64)),
        }
    }

    fn values<T: H5Type>(&self, entry: &Entry) -> Result<ArrayD<T>> {
        entry.dataset.read_array::<T>().map_err(|error| cause(&self.path, &shorter(&entry.name), &error))
    }

    /// An array with three axes `[z, y, x]`; two are one slice.
    fn slices(&self, entry: &Entry) -> Result<Array3<f32>> {
        let values = self.numbers(entry)?.into_f32();
        let values = if values.ndim() == 2 { values.insert_axis(Axis(0)) } else { values };
        npy::with_axes::<f32, Ix3>(values, &self.path, &shorter(&entry.name), "[z, y, x] or [view, v, u]")
    }

    /// The text of an attribute of an array.
    fn text(entry: &Entry, attribute: &str) -> Option<String> {
        entry.dataset.attribute(attribute).ok()?.read_string().ok()
    }
}

/// Reads a volume `[x, y, z]`, and remarks; `path` may name an array.
pub(super) fn read(path: &Path) -> Result<(Array3<f32>, Vec<String>)> {
    let (file, name) = array_path::parts(path);
    volume(&Hdf5::read(&file)?, name.as_deref())
}

/// [`read`] from the content of the file.
pub(super) fn parse(content: &[u8], path: &Path) -> Result<(Array3<f32>, Vec<String>)> {
    let (file, name) = array_path::parts(path);
    volume(&Hdf5::parse(content, &file)?, name.as_deref())
}

/// The array of a name, or the only volume.
fn volume(hdf5: &Hdf5, name: Option<&str>) -> Result<(Array3<f32>, Vec<String>)> {
    let entry = match name {
        Some(name) => &hdf5.entry(name)?,
        None => hdf5.only_volume()?,
    };
    let values = hdf5.slices(entry)?.reversed_axes();
    let mut oddities = Vec::new();
    if name.is_none() {
        let others: Vec<&Entry> = hdf5.distinct().into_iter().filter(|other| !other.is_same(entry)).collect();
        if !others.is_empty() {
            oddities.push(format!("{} is read, and not {}", shorter(&entry.name), list(&others)));
        }
        oddities.extend(hdf5.limit());
    }
    Ok((values, oddities))
}

/// The type of numbers that can be read.
fn type_of(datatype: &Datatype) -> Option<String> {
    match datatype {
        Datatype::FixedPoint { size: size @ (1 | 2 | 4 | 8), signed, .. } => {
            Some(format!("{}int{}", if *signed { "" } else { "u" }, 8 * size))
        }
        Datatype::FloatingPoint { size: size @ (2 | 4 | 8), .. } => Some(format!("float{}", 8 * size)),
        _ => None,
    }
}

/// Names and shapes of arrays, as far as a message has room for them.
fn list(entries: &[&Entry]) -> String {
    let text: Vec<String> =
        entries.iter().take(LISTED).map(|entry| format!("{} {:?}", shorter(&entry.name), entry.shape)).collect();
    match entries.len() {
        0 => "no array of numbers".into(),
        n if n > LISTED => format!("{} and {} more", text.join(", "), n - LISTED),
        _ => text.join(", "),
    }
}

/// A name or a cause for one line of a message.
fn shorter(text: &str) -> String {
    let line: String = text.chars().map(|c| if c.is_control() { ' ' } else { c }).collect();
    if line.chars().count() > LONGEST { format!("{}…", line.chars().take(LONGEST).collect::<String>()) } else { line }
}

/// The error of the crate as one of ours.
fn cause(path: &Path, what: &str, error: &dyn std::fmt::Display) -> Error {
    let text = shorter(&error.to_string());
    if text.contains("nsupported") || text.contains("filter") {
        let remedy = "write the array anew with h5py, without filters or with gzip";
        unsupported(path, what, &text, "an array that the crate hdf5-reader reads", remedy)
    } else {
        damaged(path, &format!("{what}: {text}"))
    }
}

#[cfg(test)]
mod tests;
