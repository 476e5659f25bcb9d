//! A key whose default follows from the scan.

use serde::{Deserialize, Serialize};
use std::fmt;

/// A value, or `"auto"`: the value follows from the scan.
#[derive(Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(untagged, expecting = "a number or \"auto\"")]
pub enum Auto<T> {
    /// The value that was set.
    Fixed(T),
    /// `"auto"`.
    #[default]
    #[serde(with = "word")]
    Auto,
}

/// Sets a key that is 0.
pub(super) fn fill(key: &mut usize, value: usize) {
    if *key == 0 {
        *key = value;
    }
}

impl<T: Copy> Auto<T> {
    /// The value, if one was set.
    pub fn fixed(self) -> Option<T> {
        match self {
            Self::Fixed(value) => Some(value),
            Self::Auto => None,
        }
    }

    /// The value, or what follows from the scan.
    pub fn or(self, from_scan: T) -> T {
        self.fixed().unwrap_or(from_scan)
    }
}

impl<T: fmt::Debug> fmt::Debug for Auto<T> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Fixed(value) => value.fmt(f),
            Self::Auto => f.write_str("auto"),
        }
    }
}

impl<T> From<T> for Auto<T> {
    fn from(value: T) -> Self {
        Self::Fixed(value)
    }
}

/// The one word that is not a value.
mod word {
    use serde::{Deserialize, Deserializer, Serializer, de::Error};

    const AUTO: &str = "auto";

    pub(super) fn serialize<S: Serializer>(serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_str(AUTO)
    }

    pub(super) fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<(), D::Error> {
        match String::deserialize(deserializer)?.as_str() {
            AUTO => Ok(()),
            other => Err(D::Error::custom(format!("{other:?} is neither a number nor {AUTO:?}"))),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[derive(Debug, PartialEq, Serialize, Deserialize)]
    struct Keys {
        whole: Auto<usize>,
        part: Auto<f64>,
    }

    #[test]
    fn a_value_and_the_word_are_read_and_written() {
        for (text, whole, part) in [
            ("whole = 3\npart = 2\n", Auto::Fixed(3), Auto::Fixed(2.0)),
            ("whole = \"auto\"\npart = 0.5\n", Auto::Auto, Auto::Fixed(0.5)),
        ] {
            let keys: Keys = toml::from_str(text).unwrap();
            assert_eq!(keys, Keys { whole, part });
            assert_eq!(toml::from_str::<Keys>(&toml::to_string(&keys).unwrap()).unwrap(), keys);
        }
        assert_eq!((Auto::Auto.or(7), Auto::Fixed(2).or(7)), (7, 2));
    }

    #[test]
    fn another_word_is_refused() {
        for text in ["whole = \"many\"\npart = 1", "whole = -1\npart = 1", "whole = 1.5\npart = 1"] {
            let message = toml::from_str::<Keys>(text).unwrap_err().to_string();
            assert!(message.contains("a number or \"auto\""), "{message}");
        }
    }
}
