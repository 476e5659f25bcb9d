//! HDF5 files: arrays of numbers with names. The crate hdf5-reader parses the format.
//!
//! `FILE.h5:/group/name` names an array of a file; without a name the only array with three axes is read, or the scan of
//! a known layout (see `Hdf5::scan`). MATLAB's files from version 7.3 on are HDF5. The axes of an array are `[z, y, x]`, and of
//! a stack `[view, v, u]`; MATLAB writes `A(x, y, z)` in this order.
//!
//! Numbers are integers or floats of 32 or 64 bits, contiguous or in chunks, with the filters deflate, shuffle, LZ4,
//! SZIP, n-bit and scale-offset. Attributes are not read, except for the unit of angles.

pub(super) mod layouts;

use super::array_path;
use super::npy::{self, Numbers};
use super::volume_file::{VolumeFile, damaged, unsupported};
use crate::error::{Error, Result};
use hdf5_reader::group::Group;
use hdf5_reader::{Dataset, Datatype, H5Type, Hdf5File, OpenOptions};
use ndarray::{ArrayD, Axis, Ix3};
use std::path::{Path, PathBuf};

/// Deflate makes at most so many bytes of one.
const EXPANSION: usize = 1032;
/// Most bytes of an array in a small file: arrays of constant values take no space.
const LEAST: usize = 1 << 20;
/// Nested groups that are searched.
const DEEPEST: usize = 16;
/// Groups that are searched.
const MOST_GROUPS: usize = 1000;
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
    /// Whether two names are of one array.
    fn is_same(&self, other: &Self) -> bool {
        self.dataset.address() == other.dataset.address()
    }
}

/// The arrays of a file.
pub struct Hdf5 {
    path: PathBuf,
    entries: Vec<Entry>,
    /// Names of the arrays of other values.
    others: Vec<String>,
}

impl Hdf5 {
    /// Reads the names of all arrays of numbers.
    ///
    /// # Errors
    /// [`Error::Read`], or [`Error::Format`] for a file that is not HDF5.
    pub fn read(path: &Path) -> Result<Self> {
        Self::parse(&std::fs::read(path).map_err(|source| Error::read(path, source))?, path)
    }

    pub(super) fn parse(content: &[u8], path: &Path) -> Result<Self> {
        if content.starts_with(b"MATLAB 5.0") {
            let remedy = "save it in MATLAB with the option -v7.3, or convert it: python -c \"import numpy, scipy.io; \
                          numpy.save('OUT.npy', scipy.io.loadmat('IN.mat')['NAME'])\"";
            return Err(Error::format(path, "file", "a MATLAB file before version 7.3", "version 7.3", remedy));
        }
        let most = content.len().saturating_mul(EXPANSION).max(LEAST);
        let options = OpenOptions::default().with_max_read_bytes(most).with_max_chunk_bytes(most);
        let file =
            Hdf5File::from_vec_with_options(content.to_vec(), options).map_err(|error| cause(path, "file", &error))?;
        let root = file.root_group().map_err(|error| cause(path, "root group", &error))?;
        let mut found = Self { path: path.to_owned(), entries: Vec::new(), others: Vec::new() };
        let mut left = MOST_GROUPS;
        found.search(&root, "", &mut Vec::new(), &mut left)?;
        Ok(found)
    }

    /// Adds the arrays of a group and of those below it; `above` are the groups that contain it.
    fn search(&mut self, group: &Group, name: &str, above: &mut Vec<u64>, left: &mut usize) -> Result<()> {
        // Links may form cycles, and several may lead to one group.
        if *left == 0 || above.len() == DEEPEST || above.contains(&group.address()) {
            return Ok(());
        }
        *left -= 1;
        above.push(group.address());
        let what = if name.is_empty() { "root group" } else { name };
        let (groups, datasets) = group.members().map_err(|error| cause(&self.path, &shorter(what), &error))?;
        for dataset in datasets {
            let name = format!("{name}/{}", dataset.name());
            let shape = dataset.shape().iter().map(|&n| usize::try_from(n).unwrap_or(usize::MAX)).collect();
            match type_of(dataset.dtype()) {
                Some(numbers) => self.entries.push(Entry { name, shape, numbers, dataset }),
                None => self.others.push(name),
            }
        }
        for child in groups {
            let name = format!("{name}/{}", child.name());
            self.search(&child, &name, above, left)?;
        }
        above.pop();
        Ok(())
    }

    /// All arrays of numbers, group by group.
    pub fn entries(&self) -> &[Entry] {
        &self.entries
    }

    /// The array of a name, which may be stated without the `/` in front.
    ///
    /// # Errors
    /// [`Error::Format`] that names the arrays of the file.
    pub fn entry(&self, name: &str) -> Result<&Entry> {
        let full = format!("/{}", name.trim_start_matches('/'));
        self.entries.iter().find(|entry| entry.name == full).ok_or_else(|| {
            if self.others.contains(&full) {
                let remedy = "write it as float32 with h5py";
                return unsupported(
                    &self.path,
                    &shorter(&full),
                    "its type",
                    "integers, or floats of 32 or 64 bits",
                    remedy,
                );
            }
            let remedy = format!("name one of its arrays: {}", list(&self.distinct()));
            Error::format(&self.path, "array", shorter(&full), "an array of numbers of this file", remedy)
        })
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
                let remedy = format!("name the array: {}:{}", self.path.display(), shorter(name));
                Err(Error::format(&self.path, "arrays", list(&distinct), expected, remedy))
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
        let single = |values: ArrayD<f32>| Ok(Numbers::F32(values));
        let double = |values: ArrayD<f64>| Ok(Numbers::F64(values));
        match (size, signed, floating) {
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
    fn slices(&self, entry: &Entry) -> Result<ndarray::Array3<f32>> {
        let values = self.numbers(entry)?.into_f32();
        let values = if values.ndim() == 2 { values.insert_axis(Axis(0)) } else { values };
        npy::with_axes::<f32, Ix3>(values, &self.path, &shorter(&entry.name), "[z, y, x] or [view, v, u]")
    }

    /// The text of an attribute of an array.
    fn text(entry: &Entry, attribute: &str) -> Option<String> {
        entry.dataset.attribute(attribute).ok()?.read_string().ok()
    }
}

/// Reads a volume; `path` may name an array.
pub(super) fn parse(content: &[u8], path: &Path) -> Result<VolumeFile> {
    let (file, name) = array_path::parts(path);
    let hdf5 = Hdf5::parse(content, &file)?;
    let entry = match &name {
        Some(name) => hdf5.entry(name)?,
        None => hdf5.only_volume()?,
    };
    let values = hdf5.slices(entry)?.reversed_axes();
    let mut oddities = Vec::new();
    if name.is_none() {
        let others: Vec<&Entry> = hdf5.distinct().into_iter().filter(|other| !other.is_same(entry)).collect();
        if !others.is_empty() {
            oddities.push(format!("{} is read, and not {}", shorter(&entry.name), list(&others)));
        }
    }
    Ok(VolumeFile { values, oddities, ..VolumeFile::default() })
}

/// The type of numbers that can be read.
fn type_of(datatype: &Datatype) -> Option<String> {
    match datatype {
        Datatype::FixedPoint { size: size @ (1 | 2 | 4 | 8), signed, .. } => {
            Some(format!("{}int{}", if *signed { "" } else { "u" }, 8 * size))
        }
        Datatype::FloatingPoint { size: size @ (4 | 8), .. } => Some(format!("float{}", 8 * size)),
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
