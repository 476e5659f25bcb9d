//! Numbers and names in sentences.

use std::ffi::OsStr;
use std::fmt::Write;

/// A count with its noun: `1 frame`, `3 frames`.
pub fn counted(count: usize, noun: &str) -> String {
    format!("{count} {noun}{}", if count == 1 { "" } else { "s" })
}

/// The form of a verb that follows a count.
pub fn verb<'a>(count: usize, singular: &'a str, plural: &'a str) -> &'a str {
    if count == 1 { singular } else { plural }
}

/// The value of a setting: a count as it is, any other number with four digits.
pub fn value(value: f64) -> String {
    let is_count = value.fract() == 0.0 && (1.0..1e9).contains(&value);
    if is_count { format!("{value}") } else { format!("{value:.3e}") }
}

/// A file's name, a path or an argument as text: each byte that is not UTF-8 is `\xff`, so that two names never
/// become the same text.
pub fn name(name: impl AsRef<OsStr>) -> String {
    let mut text = String::new();
    for chunk in name.as_ref().as_encoded_bytes().utf8_chunks() {
        text.push_str(chunk.valid());
        chunk.invalid().iter().for_each(|byte| write!(text, "\\x{byte:02x}").expect("a string takes all text"));
    }
    text
}

/// Serialises a path as [`name`]: that of the standard library fails where a path is not UTF-8.
///
/// # Errors
/// Those of the serialiser.
pub fn serialize_name<S: serde::Serializer>(path: &impl AsRef<OsStr>, serializer: S) -> Result<S::Ok, S::Error> {
    serializer.serialize_str(&name(path))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn counts_have_no_exponent() {
        assert_eq!([1.0, 40.0, 0.5, 0.002, 0.0].map(value), ["1", "40", "5.000e-1", "2.000e-3", "0.000e0"]);
    }

    #[cfg(unix)]
    #[test]
    fn names_that_are_not_utf_8_stay_apart() {
        use std::os::unix::ffi::OsStrExt;
        let of = |bytes: &[u8]| name(OsStr::from_bytes(bytes));
        assert_eq!(of("a/größe \n.npy".as_bytes()), "a/größe \n.npy");
        assert_eq!(of(b"a\xff\xc3b"), "a\\xff\\xc3b");
        assert_ne!(of(b"\xff"), of(b"\xfe"));
    }

    #[test]
    fn only_one_is_singular() {
        let sentence = |n| format!("{} {} left out", counted(n, "frame"), verb(n, "is", "are"));
        assert_eq!([0, 1, 2].map(sentence), ["0 frames are left out", "1 frame is left out", "2 frames are left out"]);
    }
}
