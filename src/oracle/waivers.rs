//! Known failures that are accepted until a date, each with a reason.
//!
//! ```toml
//! [[waiver]]
//! case = "image-exact/needle"
//! reason = "set-up in single precision; issue 41 of the backend"
//! expires = 2027-06-30
//! ```

use super::manifest::Case;
use jiff::civil::Date;
use jiff::{Timestamp, tz::TimeZone};
use serde::Deserialize;
use std::path::Path;
use trgs_core::error::{Error, Result};

/// A waiver for one case.
#[derive(Clone, Debug, PartialEq)]
pub struct Waiver {
    /// The case's id.
    pub case: String,
    /// The reason why it may fail.
    pub reason: String,
    /// The last day on which it may fail.
    pub expires: Date,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct File {
    #[serde(default)]
    waiver: Vec<WaiverEntry>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct WaiverEntry {
    case: String,
    reason: String,
    expires: toml::value::Datetime,
}

/// Reads a file of waivers; each must name an existing case and give a reason and a date.
///
/// # Errors
/// [`Error::Read`] for a file that cannot be read, [`Error::Format`] for content that is wrong.
pub fn read(path: impl AsRef<Path>, cases: &[Case]) -> Result<Vec<Waiver>> {
    let path = path.as_ref();
    let text = std::fs::read_to_string(path).map_err(|source| Error::read(path, source))?;
    let wrong = |got: String, expected: &str| {
        Error::format(path, "waivers", got, expected, "`trgs help oracle check` has an example")
    };
    let expected = "a list of [[waiver]] with case, reason and expires = YYYY-MM-DD";
    let file: File = toml::from_str(&text).map_err(|error| wrong(error.message().to_owned(), expected))?;
    let waiver = |row: WaiverEntry| {
        if !cases.iter().any(|case| case.id == row.case) {
            return Err(wrong(format!("the case {:?}", row.case), "a case that `trgs oracle list` shows"));
        }
        if row.reason.trim().is_empty() {
            return Err(wrong(format!("no reason for {}", row.case), "a reason"));
        }
        let day = row.expires.date.filter(|_| row.expires.time.is_none());
        let day =
            day.and_then(|d| Date::new(d.year.try_into().ok()?, d.month.try_into().ok()?, d.day.try_into().ok()?).ok());
        let expires =
            day.ok_or_else(|| wrong(format!("expires = {} for {}", row.expires, row.case), "a day, YYYY-MM-DD"))?;
        Ok(Waiver { case: row.case, reason: row.reason, expires })
    };
    file.waiver.into_iter().map(waiver).collect()
}

/// The current date, UTC.
pub fn today() -> Date {
    Timestamp::now().to_zoned(TimeZone::UTC).date()
}
