//! The macro that declares the keys of a table: name, type, default, range and sentence in one place.

use crate::error::{Error, Result};
use std::fmt::Debug;

/// A key as it is declared.
#[derive(Clone, Copy, Debug)]
pub(super) struct Key {
    pub(super) name: &'static str,
    /// What it is for: one or two sentences.
    pub(super) docs: &'static str,
}

/// The values that a key may have.
pub(super) struct Range<T> {
    /// The range in words.
    pub(super) expected: &'static str,
    pub(super) holds: fn(&T) -> bool,
}

impl<T: Debug> Range<T> {
    /// # Errors
    /// [`Error::Invalid`] for a value out of the range.
    pub(super) fn check(&self, table: &str, key: &str, value: &T) -> Result<()> {
        require(&dotted(table, key), value, (self.holds)(value), self.expected)
    }
}

/// The name of a key with that of its table.
pub(super) fn dotted(table: &str, key: &str) -> String {
    if table.is_empty() { key.into() } else { format!("{table}.{key}") }
}

/// An error about a key without a remedy, which [`Config::validate`](super::Config::validate) adds.
pub(super) fn require(key: &str, got: impl Debug, holds: bool, expected: &str) -> Result<()> {
    if holds { Ok(()) } else { Err(Error::invalid(key, format!("{got:?}"), expected, "")) }
}

/// A table of keys.
pub(super) trait Keys: Sized {
    /// What the table is for.
    const DOCS: &'static str;
    /// Its keys, in order.
    const KEYS: &'static [Key];

    /// Checks the range of each key.
    fn check(&self, table: &str) -> Result<()>;
}

/// Declares a table: `name: type = default, range;` below the sentences of each key. Without a range every value is usable.
macro_rules! keys {
    ($(#[doc = $docs:literal])+ pub struct $table:ident {
        $($(#[doc = $key_docs:literal])+ $key:ident: $type:ty = $default:expr $(, $range:expr)?;)+
    }) => {
        $(#[doc = $docs])+
        #[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
        #[serde(deny_unknown_fields, default)]
        #[non_exhaustive]
        pub struct $table { $($(#[doc = $key_docs])+ pub $key: $type,)+ }

        impl Default for $table {
            fn default() -> Self {
                Self { $($key: $default,)+ }
            }
        }

        impl $crate::config::keys::Keys for $table {
            const DOCS: &'static str = concat!($($docs, "\n"),+);
            const KEYS: &'static [$crate::config::keys::Key] = &[
                $($crate::config::keys::Key { name: stringify!($key), docs: concat!($($key_docs, "\n"),+) },)+
            ];

            fn check(&self, table: &str) -> $crate::Result<()> {
                // A table of tables and of keys without a range checks nothing.
                let _ = table;
                $($($range.check(table, stringify!($key), &self.$key)?;)?)+
                Ok(())
            }
        }
    };
}
pub(super) use keys;

/// Ranges that several keys have.
pub(super) mod ranges {
    use super::Range;
    use crate::config::Auto;

    /// More primitives than any computer here can hold, so that a typing error is a message and not a crash.
    const MOST_POINTS: usize = 10_000_000;

    const fn range<T>(expected: &'static str, holds: fn(&T) -> bool) -> Range<T> {
        Range { expected, holds }
    }

    pub(in crate::config) const SEED: Range<u64> =
        range("at most 2^63 - 1, the largest integer of TOML", |seed| i64::try_from(*seed).is_ok());
    pub(in crate::config) const AT_LEAST_1: Range<usize> = range("at least 1", |count| *count >= 1);
    pub(in crate::config) const BLOCK: Range<usize> =
        range("at least 2, or 0: as the scan says", |side| *side == 0 || *side >= 2);
    pub(in crate::config) const COUNT_OR_AUTO: Range<Auto<usize>> = range("at least 1", |count| count.or(1) >= 1);
    pub(in crate::config) const POPULATION: Range<usize> =
        range("4 to 10 million, or 0: as the scan says", |n| *n == 0 || (4..=MOST_POINTS).contains(n));
    pub(in crate::config) const FINITE: Range<f64> = range("a finite number", |value| value.is_finite());
    pub(in crate::config) const POSITIVE: Range<f64> =
        range("a positive number", |value| *value > 0.0 && value.is_finite());
    pub(in crate::config) const VOXELS: Range<f64> =
        range("a positive number of voxels", |value| *value > 0.0 && value.is_finite());
    pub(in crate::config) const POSITIVE_OR_AUTO: Range<Auto<f64>> =
        range("a positive number, or auto", |value| value.or(1.0) > 0.0 && value.or(1.0).is_finite());
    pub(in crate::config) const NOT_NEGATIVE: Range<f64> =
        range("a number that is not negative", |value| *value >= 0.0 && value.is_finite());
    pub(in crate::config) const NOT_NEGATIVE_OR_AUTO: Range<Auto<f64>> =
        range("a number that is not negative", |value| value.or(0.0) >= 0.0 && value.or(0.0).is_finite());
    pub(in crate::config) const FRACTION: Range<f64> =
        range("a number from 0 to 1", |value| (0.0..=1.0).contains(value));
    pub(in crate::config) const FRACTION_OR_AUTO: Range<Auto<f64>> =
        range("a number from 0 to 1, or auto", |value| (0.0..=1.0).contains(&value.or(0.0)));
    pub(in crate::config) const BELOW_1: Range<f64> = range("a number in [0, 1)", |value| (0.0..1.0).contains(value));
    pub(in crate::config) const UP_TO_1: Range<f64> =
        range("a number in (0, 1]", |value| *value > 0.0 && *value <= 1.0);
    pub(in crate::config) const BELOW_2: Range<f64> = range("a number in (0, 2)", |value| *value > 0.0 && *value < 2.0);
    pub(in crate::config) const UP_TO_16: Range<f64> =
        range("a number in (0, 16]", |value| *value > 0.0 && *value <= 16.0);
    pub(in crate::config) const RATES: Range<[f64; 2]> =
        range("two rates that are not negative", |rates| rates.iter().all(|rate| *rate >= 0.0 && rate.is_finite()));
    pub(in crate::config) const DECAYS: Range<[f64; 2]> =
        range("two numbers in [0, 1)", |decays| decays.iter().all(|decay| (0.0..1.0).contains(decay)));
    pub(in crate::config) const SPHERE: Range<usize> = range("8 to 2^20", |points| (8..=1 << 20).contains(points));
    pub(in crate::config) const LEVELS: Range<usize> = range("1 to 8", |levels| (1..=8).contains(levels));
    pub(in crate::config) const NEIGHBOURS: Range<usize> = range("1 to 255", |k| (1..=255).contains(k));
    pub(in crate::config) const GRIDS: Range<usize> = range("1 to 16, or 0: as the scan says", |n| *n <= 16);
    pub(in crate::config) const DOUBLINGS: Range<u32> = range("1 to 24, or 0: as the scan says", |n| *n <= 24);
    pub(in crate::config) const COARSE: Range<usize> = range("1 to 64, or 0: as the scan says", |n| *n <= 64);
    pub(in crate::config) const SAMPLES: Range<usize> =
        range("an even number up to 65,536, or 0: as the scan says", |n| n.is_multiple_of(2) && *n <= 1 << 16);
}
