//! Parts that the headers of several formats share: text, numbers, units, and remarks on fields.

use crate::unit::Unit;
use glam::DVec3;
use std::borrow::Cow;

/// First bytes of a text that a Windows editor saved as UTF-8.
const BOM: &[u8] = b"\xef\xbb\xbf";

/// The content without a byte-order mark at its beginning.
pub(super) fn without_bom(content: &[u8]) -> &[u8] {
    content.strip_prefix(BOM).unwrap_or(content)
}

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

/// Fields of a header that are not read, for a remark.
#[derive(Default)]
pub(super) struct Unknown(Vec<String>);

impl Unknown {
    pub(super) fn add(&mut self, field: &str) {
        self.0.push(shown(field).trim_matches('"').to_owned());
    }

    /// One sentence that names the first of them.
    pub(super) fn remark(self) -> Option<String> {
        const MOST: usize = 8;
        let (names, count) = (&self.0, self.0.len());
        let listed = names.iter().take(MOST).map(String::as_str).collect::<Vec<_>>().join(", ");
        let rest = if count > MOST { format!(" and {} more", count - MOST) } else { String::new() };
        (count > 0).then(|| format!("fields of the header that are not read: {listed}{rest}"))
    }
}

/// The remark on bytes after the last number.
pub(super) fn surplus(has_more: bool) -> Option<String> {
    has_more.then(|| "more data follow the numbers that the header describes; they are not read".into())
}
