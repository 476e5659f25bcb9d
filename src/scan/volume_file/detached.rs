//! Numbers in files that a header names: one file, a list of files, or a numbered pattern.

use super::elements::{Encoding, Layout, Voxels};
use super::header::{shown, surplus};
use super::plain::{Plain, Values};
use super::{VolumeFile, damaged};
use crate::limit;
use ndarray::Array3;
use std::collections::BTreeSet;
use std::fs::File;
use std::io::{self, ErrorKind};
use std::ops::Range;
use std::path::{Component, Path, PathBuf};
use trgs_core::error::{Error, Result};
use trgs_core::words::counted;

/// The numbers that a header describes.
pub(super) struct Numbers {
    pub(super) source: Source,
    /// The field of the header that states the source.
    pub(super) key: &'static str,
    pub(super) layout: Layout,
    pub(super) skip: Skip,
    /// Slope and offset of the values, if they are not the numbers.
    pub(super) scale: Option<[f64; 2]>,
}

/// What surrounds the numbers in each file.
#[derive(Default)]
pub(super) struct Skip {
    /// Bytes before them.
    pub(super) bytes: usize,
    /// Lines before them.
    pub(super) lines: usize,
    /// Bytes of the compressed numbers, if they are stated.
    pub(super) packed: Option<usize>,
}

/// A volume without its values, and its numbers.
pub(super) type Described = (VolumeFile, Numbers);

/// Where a header says that its numbers are.
pub(super) enum Source {
    /// After the header, from a position on.
    Here(usize),
    /// In files beside the header, each with the same number of slices.
    Files(Names),
}

/// Names of files. Those of a pattern are made one by one: a header may state any number of them.
pub(super) enum Names {
    Listed(Vec<String>),
    Numbered(Pattern),
}

/// A name with a number.
pub(super) struct Pattern {
    before: String,
    after: String,
    first: i64,
    step: i64,
    count: usize,
    /// Digits at least, and whether zeros fill them up.
    digits: usize,
    has_zeros: bool,
}

impl Names {
    fn count(&self) -> usize {
        match self {
            Self::Listed(names) => names.len(),
            Self::Numbered(pattern) => pattern.count,
        }
    }

    /// Rejects a list that names a file twice: a short one would make a large volume of a small file.
    fn check(&self, header: &Path, key: &str) -> Result<()> {
        let Self::Listed(names) = self else { return Ok(()) };
        let mut known = BTreeSet::new();
        for name in names {
            if !known.insert(beside(header, key, name)?) {
                let got = format!("{} twice", shown(name));
                return Err(Error::format(header, key, got, "different files", "list each file once"));
            }
        }
        Ok(())
    }

    fn name(&self, i: usize) -> String {
        match self {
            Self::Listed(names) => names[i].clone(),
            Self::Numbered(Pattern { before, after, first, step, digits, has_zeros, .. }) => {
                let (number, digits) = (first + i as i64 * step, *digits);
                let number = if *has_zeros { format!("{number:0digits$}") } else { format!("{number:digits$}") };
                format!("{before}{number}{after}")
            }
        }
    }
}

impl Source {
    /// Interprets the value of the header's field: a name, a pattern such as `slice%03d.raw 1 40 1`, or `LIST` with
    /// names in the lines of `rest`.
    pub(super) fn files(header: &Path, key: &str, value: &str, rest: &str, slices: usize) -> Result<Self> {
        let mut words = value.split_whitespace();
        if words.next() == Some("LIST") {
            let names: Vec<String> =
                rest.lines().map(str::trim).filter(|line| !line.is_empty()).map(Into::into).collect();
            return if (1..=slices).contains(&names.len()) {
                Ok(Self::Files(Names::Listed(names)))
            } else {
                let remedy = "list one name in each line after the header";
                let expected = format!("1 to {slices} names of files, for {}", counted(slices, "slice"));
                Err(Error::format(header, key, format!("a list of {}", names.len()), expected, remedy))
            };
        }
        let pattern: Vec<&str> = value.split_whitespace().collect();
        match (pattern.as_slice(), value.contains('%')) {
            ([name, first, last, step @ ..], true) => {
                let pattern = numbered(name, first, last, step.first().unwrap_or(&"1"), slices).ok_or_else(|| {
                    let expected = format!("a pattern such as slice%03d.raw 1 {slices} 1, for {slices} slices");
                    Error::format(header, key, shown(value), expected, "correct the pattern, or list the names")
                })?;
                Ok(Self::Files(Names::Numbered(pattern)))
            }
            _ => Ok(Self::Files(Names::Listed(vec![value.to_owned()]))),
        }
    }
}

impl Skip {
    /// Where the numbers are in a file of `length` bytes. Its content is needed for lines only.
    fn range(&self, content: &[u8], length: usize, path: &Path) -> Result<Range<usize>> {
        let mut start = self.bytes;
        if start > length {
            return Err(damaged(path, &format!("{length} bytes, of which HeaderSize skips {start}")));
        }
        for _ in 0..self.lines {
            let line = content[start..].iter().position(|&byte| byte == b'\n');
            let fewer = || damaged(path, &format!("fewer than {} lines, which line skip states", self.lines));
            start += line.ok_or_else(fewer)? + 1;
        }
        let size = self.packed.unwrap_or(length - start);
        if size > length - start {
            return Err(damaged(path, &format!("{} of {size} compressed bytes", length - start)));
        }
        Ok(start..start + size)
    }
}

/// The volume that the content of the file `path` describes.
pub(super) fn whole((volume, numbers): Described, content: &[u8], path: &Path) -> Result<VolumeFile> {
    let Voxels { values, has_more } = numbers.read(path, content)?;
    let oddities = volume.oddities.into_iter().chain(surplus(has_more)).collect();
    Ok(VolumeFile { values, oddities, ..volume })
}

impl Numbers {
    /// Numbers that fill one file from a position on.
    pub(super) fn here(at: usize, layout: Layout) -> Self {
        Self { source: Source::Here(at), key: "", layout, skip: Skip::default(), scale: None }
    }

    /// The value of a stored number.
    fn means(&self) -> impl Fn(f64) -> f64 + Send + Sync + 'static {
        let scale = self.scale;
        move |stored| scale.map_or(stored, |[slope, offset]| stored * slope + offset)
    }

    /// Numbers of which boxes are read, if they are plain ones in one file, and whether bytes follow them. `file` is the
    /// header's own.
    pub(super) fn plain(&self, header: &Path, file: File) -> Result<Option<(Plain, bool)>> {
        let Self { layout, skip, .. } = self;
        if layout.encoding != Encoding::Raw || skip.lines > 0 {
            return Ok(None);
        }
        let (file, path, at) = match &self.source {
            Source::Here(at) => (file, header.to_owned(), *at),
            Source::Files(names) if names.count() == 1 => {
                let name = names.name(0);
                let path = beside(header, self.key, &name)?;
                let file = crate::input::open(&path);
                (file.map_err(|error| not_read(header, self.key, &name, &path, error))?, path, 0)
            }
            Source::Files(_) => return Ok(None),
        };
        let length = file.metadata().map_err(|source| Error::read(&path, source))?.len();
        let length = usize::try_from(length).unwrap_or(usize::MAX).saturating_sub(at);
        let range = skip.range(&[], length, &path)?;
        let (start, has_more) = layout.plain(range.len()).map_err(|found| damaged(&path, &found))?;
        let (element, means) = (layout.element, self.means());
        let values: Values = Box::new(move |bytes| Ok(element.numbers(bytes, &means)));
        let start = (at + range.start + start) as u64;
        let (shape, item) = (layout.shape, element.number.size());
        Ok(Some((Plain { file, path, start, shape, x_is_fastest: true, item, values }, has_more)))
    }

    /// The values, with all files in their order along z.
    fn read(&self, header: &Path, content: &[u8]) -> Result<Voxels> {
        let Self { source, key, layout, skip, .. } = self;
        let key = *key;
        let of_file = |bytes: &[u8], layout: &Layout, path: &Path| {
            let numbers = &bytes[skip.range(bytes, bytes.len(), path)?];
            layout.read(numbers, self.means()).map_err(|found| found.of(path))
        };
        let names = match source {
            Source::Here(at) => return of_file(content.get(*at..).unwrap_or_default(), layout, header),
            Source::Files(names) => names,
        };
        let ([x, y, z], count) = (layout.shape, names.count());
        if z % count != 0 {
            let expected = format!("a number of files that divides {z}, the number of slices");
            let remedy = "list one file for each slice";
            return Err(Error::format(header, key, counted(count, "file"), expected, remedy));
        }
        names.check(header, key)?;
        let layout = Layout { shape: [x, y, z / count], ..*layout };
        let (mut values, mut has_more) = (Vec::new(), false);
        for i in 0..count {
            let name = names.name(i);
            let path = beside(header, key, &name)?;
            let bytes = crate::input::read(&path).map_err(|error| not_read(header, key, &name, &path, error))?;
            let part = of_file(&bytes, &layout, &path)?;
            has_more |= part.has_more;
            // The values of a part are in its order, x fastest.
            let part = part.values.into_raw_vec_and_offset().0;
            if count == 1 {
                values = part;
            } else {
                if i == 0 {
                    // The first file is as large as the header states: the others may be, too.
                    let volume = format!("{key}: volume of {} voxels from {}", x * y * z, counted(count, "file"));
                    values = limit::room(volume, part.len().saturating_mul(count)).map_err(|e| e.in_file(header))?;
                }
                values.extend(part);
            }
        }
        let values = Array3::from_shape_vec((z, y, x), values).expect("all parts have one shape");
        Ok(Voxels { values: values.reversed_axes(), has_more })
    }
}

/// A pattern with one `%d`, `%3d` or `%03d`, for at most `most` names.
fn numbered(pattern: &str, first: &str, last: &str, step: &str, most: usize) -> Option<Pattern> {
    let (before, rest) = pattern.split_once('%')?;
    let (width, after) = rest.split_once('d')?;
    let (first, last, step): (i64, i64, i64) = (first.parse().ok()?, last.parse().ok()?, step.parse().ok()?);
    let digits: usize = if width.is_empty() { 0 } else { width.parse().ok()? };
    let steps = last.checked_sub(first)?.checked_div(step)?;
    let count = usize::try_from(steps).ok()?.checked_add(1).filter(|count| *count <= most)?;
    if digits > 20 || after.contains('%') {
        return None;
    }
    let has_zeros = width.starts_with('0');
    Some(Pattern { before: before.into(), after: after.into(), first, step, count, digits, has_zeros })
}

/// Path of a file that a header names.
///
/// It must be in the header's folder or below it: a header must not read files elsewhere.
fn beside(header: &Path, key: &str, name: &str) -> Result<PathBuf> {
    // Headers made on Windows separate folders by backslashes.
    let parts: Vec<_> = name.split(['/', '\\']).filter(|part| !part.is_empty() && *part != ".").collect();
    let relative: PathBuf = parts.iter().collect();
    let is_plain = relative.components().all(|part| matches!(part, Component::Normal(_)));
    let is_absolute = name.starts_with(['/', '\\']) || parts.first().is_some_and(|part| part.ends_with(':'));
    if parts.is_empty() || !is_plain || is_absolute || name.contains('\0') {
        let expected = "the name of a file in this folder or below it";
        let remedy = "move the file into this folder, and write its name without a path";
        return Err(Error::format(header, key, shown(name), expected, remedy));
    }
    Ok(header.with_file_name(relative))
}

/// The error about a file that a header names.
fn not_read(header: &Path, key: &str, name: &str, path: &Path, error: io::Error) -> Error {
    match error.kind() {
        ErrorKind::NotFound => {
            let remedy = "put the file there, or correct its name in the header";
            let got = format!("{}, which does not exist", shown(name));
            Error::format(header, key, got, "a file that exists", remedy)
        }
        _ => Error::read(path, error),
    }
}
