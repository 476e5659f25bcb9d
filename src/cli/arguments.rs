//! Argument parsers that several commands share.

use clap::Args;
use clap::builder::{PossibleValue, PossibleValuesParser, TypedValueParser};
use serde::Serialize;
use std::str::FromStr;
use trgs::words::Described;

/// What to do with an older folder.
#[derive(Args, Clone, Copy)]
pub(super) struct Replace {
    /// Write the folder whatever it holds: other content is moved to NAME.replaced-1 beside it
    #[arg(long)]
    pub(super) overwrite: bool,
}

/// What to do with older files of a folder to which files are added.
#[derive(Args, Clone, Copy)]
pub(super) struct ReplaceFiles {
    /// Replace files with the names of pages and tables, whoever wrote them
    #[arg(long)]
    pub(super) overwrite: bool,
}

/// Parses the name of one of the library's variants: the name that files have, explained by its documentation.
pub(super) fn choice<T>(variants: &'static [T]) -> impl TypedValueParser<Value = T>
where
    T: Copy + Serialize + Described + Send + Sync + 'static,
{
    let values = variants.iter().map(|variant| PossibleValue::new(word(variant)).help(variant.description()));
    PossibleValuesParser::new(values)
        .map(|text| *variants.iter().find(|variant| word(variant) == text).expect("clap accepts no other value"))
}

/// The name of a variant without fields.
pub(super) fn word(variant: &impl Serialize) -> String {
    serde_json::to_value(variant).ok().and_then(|name| name.as_str().map(Into::into)).unwrap_or_default()
}

/// Parses `N` values separated by commas.
pub(super) fn list<T: FromStr, const N: usize>(text: &str) -> Result<[T; N], String> {
    let values = text.split(',').map(|value| value.trim().parse().ok()).collect::<Option<Vec<T>>>();
    values.and_then(|values| values.try_into().ok()).ok_or_else(|| format!("expected {N} numbers between commas"))
}

/// Parses two numbers, or one that is used for both.
pub(super) fn pair<T: FromStr + Copy>(text: &str) -> Result<[T; 2], String> {
    let both = list::<T, 1>(text).map(|[value]| [value; 2]);
    both.or_else(|_| list(text)).map_err(|_| "expected a number, or two between commas".into())
}

/// Parses a finite number.
pub(super) fn finite(text: &str) -> Result<f64, String> {
    text.trim().parse().ok().filter(|value: &f64| value.is_finite()).ok_or_else(|| "expected a finite number".into())
}

/// Parses a seed; configurations are TOML, whose integers end at 2⁶³ - 1.
pub(super) fn seed(text: &str) -> Result<u64, String> {
    let value: Option<i64> = text.parse().ok();
    value.and_then(|value| value.try_into().ok()).ok_or_else(|| "expected an integer from 0 to 2^63 - 1".into())
}

/// Parses a cutoff: a fraction of a primitive's peak.
pub(super) fn cutoff(text: &str) -> Result<f64, String> {
    finite(text).ok().filter(|value| (0.0..1.0).contains(value)).ok_or_else(|| "expected a number in [0, 1)".into())
}

/// Parses a positive integer.
pub(super) fn positive(text: &str) -> Result<usize, String> {
    text.trim().parse().ok().filter(|value| *value >= 1).ok_or_else(|| "expected a positive integer".into())
}
