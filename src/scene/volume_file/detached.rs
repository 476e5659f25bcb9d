//! Numbers in files that a header names: one file, a list of files, or a numbered pattern.

use super::damaged;
use super::elements::{Layout, Voxels};
use super::header::shown;
use crate::error::{Error, Result};
use crate::words::counted;
use ndarray::{Axis, concatenate};
use std::path::{Component, Path, PathBuf};

/// Where a header says that its numbers are.
pub(super) enum Source {
    /// After the header, from a position on.
    Here(usize),
    /// In files beside the header, each with the same number of slices.
    Files(Vec<String>),
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
                Ok(Self::Files(names))
            } else {
                let remedy = "list one name in each line after the header";
                let expected = format!("1 to {slices} names of files, for {}", counted(slices, "slice"));
                Err(Error::format(header, key, format!("a list of {}", names.len()), expected, remedy))
            };
        }
        let pattern: Vec<&str> = value.split_whitespace().collect();
        match (pattern.as_slice(), value.contains('%')) {
            ([name, first, last, step @ ..], true) => {
                let names = numbered(name, first, last, step.first().unwrap_or(&"1"), slices).ok_or_else(|| {
                    let expected = format!("a pattern such as slice%03d.raw 1 {slices} 1, for {slices} slices");
                    Error::format(header, key, shown(value), expected, "correct the pattern, or list the names")
                })?;
                Ok(Self::Files(names))
            }
            _ => Ok(Self::Files(vec![value.to_owned()])),
        }
    }

    /// The volume, with all files in their order along z. `skip` maps the content of a file to that after its header.
    pub(super) fn read(
        &self,
        header: &Path,
        key: &str,
        content: &[u8],
        layout: Layout,
        skip: impl for<'a> Fn(&'a [u8], &Path) -> Result<&'a [u8]>,
        means: impl Fn(f64) -> f64,
    ) -> Result<Voxels> {
        let names = match self {
            Self::Here(at) => {
                let bytes = skip(content.get(*at..).unwrap_or_default(), header)?;
                return layout.read(bytes, means).map_err(|found| damaged(header, &found));
            }
            Self::Files(names) => names,
        };
        let [x, y, z] = layout.shape;
        if z % names.len() != 0 {
            let expected = format!("a number of files that divides {z}, the number of slices");
            let remedy = "list one file for each slice";
            return Err(Error::format(header, key, counted(names.len(), "file"), expected, remedy));
        }
        let layout = Layout { shape: [x, y, z / names.len()], ..layout };
        let (mut parts, mut has_more) = (Vec::new(), false);
        for name in names {
            let (path, bytes) = beside(header, key, name)?;
            let part = layout.read(skip(&bytes, &path)?, &means).map_err(|found| damaged(&path, &found))?;
            has_more |= part.has_more;
            parts.push(part.values.reversed_axes());
        }
        if let [_] = parts.as_slice() {
            return Ok(Voxels { values: parts.remove(0).reversed_axes(), has_more });
        }
        let views: Vec<_> = parts.iter().map(|part| part.view()).collect();
        let values = concatenate(Axis(0), &views).expect("all parts have one shape");
        Ok(Voxels { values: values.reversed_axes(), has_more })
    }
}

/// The names of a pattern with one `%d`, `%3d` or `%03d`, at most `most`.
fn numbered(pattern: &str, first: &str, last: &str, step: &str, most: usize) -> Option<Vec<String>> {
    let (before, rest) = pattern.split_once('%')?;
    let (width, after) = rest.split_once('d')?;
    let (first, last, step): (i64, i64, i64) = (first.parse().ok()?, last.parse().ok()?, step.parse().ok()?);
    let digits: usize = if width.is_empty() { 0 } else { width.parse().ok()? };
    let steps = last.checked_sub(first)?.checked_div(step)?;
    let count = usize::try_from(steps).ok()?.checked_add(1).filter(|count| *count <= most)?;
    if digits > 20 || after.contains('%') {
        return None;
    }
    let name = |i: i64| {
        let number = first + i * step;
        let number = if width.starts_with('0') { format!("{number:0digits$}") } else { format!("{number:digits$}") };
        format!("{before}{number}{after}")
    };
    Some((0..count as i64).map(name).collect())
}

/// Path and content of a file that a header names.
///
/// It must be in the header's folder or below it: a header must not read files elsewhere.
fn beside(header: &Path, key: &str, name: &str) -> Result<(PathBuf, Vec<u8>)> {
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
    let path = header.with_file_name(relative);
    match crate::input::read(&path) {
        Ok(content) => Ok((path, content)),
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => {
            let remedy = "put the file there, or correct its name in the header";
            Err(Error::format(
                header,
                key,
                format!("{}, which does not exist", shown(name)),
                "a file that exists",
                remedy,
            ))
        }
        Err(error) => Err(Error::read(&path, error)),
    }
}
