//! Parts that the headers of several formats share: text, numbers, units, and remarks on fields.

use crate::unit::Unit;
use glam::DVec3;
use std::borrow::Cow;
use std::path::Path;
use trgs_core::error::Error;

/// First bytes of a text that a Windows editor saved as UTF-8.
const BOM: &[u8] = b"\xef\xbb\xbf";

/// Longest text header accepted, bytes.
pub(super) const LARGEST: usize = 1 << 16;

/// Text of any encoding.
pub(super) fn lossy(text: &[u8]) -> Cow<'_, str> {
    String::from_utf8_lossy(text)
}

/// The beginning of a text from a file, shortened for a message.
pub(super) fn shown(text: &str) -> String {
    const LONGEST: usize = 60;
    let beginning: String = text.chars().take(LONGEST).collect();
    let rest = if text.chars().count() > LONGEST { "…" } else { "" };
    format!("{beginning:?}{rest}")
}

/// The numbers of a text, or `None` if a word is none.
pub(super) fn numbers<T: std::str::FromStr>(text: &str) -> Option<Vec<T>> {
    text.split_whitespace().map(|word| word.parse().ok()).collect()
}

/// A position or the lengths of three axes, from as many numbers as the file has axes; further axes have `default`.
pub(super) fn vector(text: &str, axes: usize, default: f64) -> Option<DVec3> {
    let read = numbers::<f64>(text).filter(|read| read.len() == axes)?;
    Some(DVec3::from_array([0, 1, 2].map(|i| read.get(i).copied().unwrap_or(default))))
}

/// The shape `[x, y, z]` of a file with a number of axes, or `None` if it has more than three that are longer than 1.
pub(super) fn three_axes(sides: &[usize]) -> Option<[usize; 3]> {
    let rest = sides.get(3..).unwrap_or_default();
    let is_volume = !sides.is_empty() && rest.iter().all(|&n| n == 1);
    is_volume.then(|| [0, 1, 2].map(|i| sides.get(i).copied().unwrap_or(1)))
}

/// The unit that a field names, and a remark unless it is the millimetre: lengths are converted to millimetres.
pub(super) fn converted(field: &str, unit: &str, oddities: &mut Vec<String>) -> Option<Unit> {
    let known = Unit::named(unit);
    match known {
        Some(Unit::Millimetre) => {}
        Some(_) => oddities.push(format!("{field} is {}: lengths are converted to millimetres", shown(unit))),
        None => oddities.push(format!("{field} is {}, which is not understood: lengths are kept", shown(unit))),
    }
    known
}

/// The fields of a text header in their order, and where it ends.
pub(super) struct Header<'a> {
    pub(super) fields: Vec<(String, String)>,
    pub(super) end: usize,
    pub(super) path: &'a Path,
    /// Remedy for a wrong field.
    remedy: &'static str,
}

impl<'a> Header<'a> {
    /// A header before its first line.
    pub(super) fn begin(content: &[u8], path: &'a Path, remedy: &'static str) -> Self {
        let end = if content.starts_with(BOM) { BOM.len() } else { 0 };
        Self { fields: Vec::new(), end, path, remedy }
    }

    /// The next line; `None` at the end of the content, or of what a header may have.
    pub(super) fn line(&mut self, content: &[u8]) -> Option<String> {
        let rest = content.get(self.end..content.len().min(LARGEST)).filter(|rest| !rest.is_empty())?;
        let length = rest.iter().position(|&byte| byte == b'\n').unwrap_or(rest.len());
        self.end = (self.end + length + 1).min(content.len());
        Some(lossy(&rest[..length]).into_owned())
    }

    pub(super) fn wrong(&self, key: &str, got: &str, expected: &str) -> Error {
        Error::format(self.path, key, shown(got), expected, self.remedy)
    }

    /// The last value of a field.
    pub(super) fn get(&self, key: &str) -> Option<&str> {
        self.fields.iter().rfind(|(known, _)| known == key).map(|(_, value)| value.as_str())
    }

    /// The remark that names the first of the fields that are not known.
    pub(super) fn unknown(&self, is_known: impl Fn(&str) -> bool) -> Option<String> {
        const MOST: usize = 8;
        let unknown = self.fields.iter().filter(|(key, _)| !is_known(key));
        let names: Vec<String> = unknown.map(|(key, _)| shown(key).trim_matches('"').to_owned()).collect();
        let listed = names[..names.len().min(MOST)].join(", ");
        let rest = if names.len() > MOST { format!(" and {} more", names.len() - MOST) } else { String::new() };
        (!names.is_empty()).then(|| format!("fields of the header that are not read: {listed}{rest}"))
    }
}

/// The remark on bytes after the last number.
pub(super) fn surplus(has_more: bool) -> Option<String> {
    has_more.then(|| "more data follow the numbers that the header describes; they are not read".into())
}
