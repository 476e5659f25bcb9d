//! Numbers, names and foreign text in sentences.

use std::borrow::Cow;
use std::ffi::OsStr;
use std::fmt::{Display, Write};
use std::path::Path;

/// Names of a choice that explain themselves: see [`described!`](crate::described).
pub trait Described {
    /// The documentation of the variant, without its full stop.
    fn description(&self) -> &'static str;
}

/// Declares an enum without fields with a list of its variants, which have their documentation at run time: [`Described`].
#[macro_export]
macro_rules! described {
    ($(#[$outer:meta])* pub enum $name:ident { $($(#[doc = $docs:literal])+ $variant:ident,)+ }) => {
        $(#[$outer])*
        pub enum $name { $($(#[doc = $docs])+ $variant,)+ }

        impl $name {
            /// All of them, in the order of their declaration.
            pub const ALL: [Self; [$(Self::$variant),+].len()] = [$(Self::$variant),+];
        }

        impl $crate::words::Described for $name {
            fn description(&self) -> &'static str {
                match self { $(Self::$variant => concat!($($docs),+).trim().trim_end_matches('.'),)+ }
            }
        }
    };
}

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

/// Whether a terminal may take a character as a command: control characters, and marks that reverse text.
pub fn is_command(c: char) -> bool {
    let is_direction =
        matches!(c, '\u{61c}' | '\u{200e}' | '\u{200f}' | '\u{202a}'..='\u{202e}' | '\u{2066}'..='\u{2069}');
    c.is_control() || is_direction || matches!(c, '\u{2028}' | '\u{2029}')
}

/// Foreign text for one line of a message: what a terminal could take as a command is escaped, as in `\u{1b}`.
pub fn visible(text: impl Display) -> String {
    let text = text.to_string();
    if !text.contains(is_command) {
        return text;
    }
    let escaped = |c: char| if is_command(c) { c.escape_default().to_string() } else { c.into() };
    text.chars().map(escaped).collect()
}

/// A text as UTF-8 without a byte-order mark: editors on Windows write one, and UTF-16 as well.
pub fn utf8(content: &[u8]) -> Cow<'_, [u8]> {
    let (rest, join): (_, fn([u8; 2]) -> u16) = match content {
        [0xff, 0xfe, rest @ ..] => (rest, u16::from_le_bytes),
        [0xfe, 0xff, rest @ ..] => (rest, u16::from_be_bytes),
        _ => return content.strip_prefix(b"\xef\xbb\xbf").unwrap_or(content).into(),
    };
    let units: Vec<u16> = rest.as_chunks().0.iter().map(|&pair| join(pair)).collect();
    String::from_utf16_lossy(&units).into_bytes().into()
}

/// A word for a shell: in quotes unless it is plain.
pub fn quoted(word: &str) -> String {
    let is_plain = |c: char| c.is_alphanumeric() || "_-./,:=+@%^".contains(c);
    if !word.is_empty() && word.chars().all(is_plain) {
        return word.into();
    }
    if !word.contains(is_command) {
        return format!("'{}'", word.replace('\'', r"'\''"));
    }
    let escaped = |c: char| match c {
        '\'' | '\\' => format!("\\{c}"),
        c if is_command(c) => c.to_string().bytes().map(|byte| format!("\\x{byte:02x}")).collect(),
        c => c.into(),
    };
    format!("$'{}'", word.chars().map(escaped).collect::<String>())
}

/// [`quoted`] of a path; one that begins with a hyphen is no option then.
pub fn quoted_path(path: &Path) -> String {
    let text = path.to_string_lossy();
    quoted(&if text.starts_with('-') { format!("./{text}") } else { text.into_owned() })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn counts_have_no_exponent() {
        assert_eq!([1.0, 40.0, 0.5, 0.002, 0.0].map(value), ["1", "40", "5.000e-1", "2.000e-3", "0.000e0"]);
    }

    #[test]
    fn foreign_text_gives_a_terminal_no_commands() {
        let name = "a\u{1b}]0;x\u{7}\u{9b}31m\r\n\u{202e}b\u{7f}\u{2066}ä→";
        let shown = visible(name);
        assert!(!shown.contains(is_command) && shown.ends_with("ä→"), "{shown}");
        assert!(shown.starts_with(r"a\u{1b}]0;x\u{7}\u{9b}31m\r\n\u{202e}b"), "{shown}");
        assert_eq!(visible("plain: text – and ±"), "plain: text – and ±");
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

    #[cfg(unix)]
    #[test]
    fn a_shell_takes_quoted_words_as_they_were() {
        for word in
            ["a", "a b", "it's", "$HOME", "a;b", "`x`", "*", "", "~", "ä", "tab\tx\u{1b}[0m'\\\u{202e}é", "a\nb"]
        {
            let run = std::process::Command::new("bash").args(["-c", &format!("printf %s {}", quoted(word))]).output();
            // Systems without this shell test nothing.
            let Ok(run) = run else { return };
            assert_eq!(String::from_utf8_lossy(&run.stdout), word, "{}", quoted(word));
            assert!(!quoted(word).contains(is_command));
        }
        assert_eq!(["out/a.npy", "a b"].map(quoted), ["out/a.npy", "'a b'"]);
        assert_eq!(quoted_path(Path::new("-rf")), "./-rf");
    }

    #[test]
    fn texts_of_windows_are_utf8_without_a_mark() {
        let text = "{\"µ\": \"ä→😀\"}";
        let units: Vec<u16> = text.encode_utf16().collect();
        let [little, big] = [u16::to_le_bytes as fn(u16) -> [u8; 2], u16::to_be_bytes]
            .map(|bytes| std::iter::once(0xfeff).chain(units.iter().copied()).flat_map(bytes).collect::<Vec<u8>>());
        for content in [text.into(), ["\u{feff}", text].concat().into_bytes(), little, big] {
            assert_eq!(utf8(&content), text.as_bytes());
        }
        assert_eq!(utf8(b"\xff\xfe{\0\0"), b"{".as_slice());
    }

    #[test]
    fn only_one_is_singular() {
        let sentence = |n| format!("{} {} left out", counted(n, "frame"), verb(n, "is", "are"));
        assert_eq!([0, 1, 2].map(sentence), ["0 frames are left out", "1 frame is left out", "2 frames are left out"]);
    }
}
