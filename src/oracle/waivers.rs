//! Known failures that are accepted until a date, each with a reason.
//!
//! ```toml
//! [[waiver]]
//! case = "image-exact/needle"
//! reason = "set-up in single precision; issue 41 of the backend"
//! expires = 2027-06-30
//! ```

use super::manifest::Case;
use serde::Deserialize;
use std::path::Path;
use std::time::SystemTime;
use toml::value::Date;
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
        let expires =
            day.ok_or_else(|| wrong(format!("expires = {} for {}", row.expires, row.case), "a day, YYYY-MM-DD"))?;
        Ok(Waiver { case: row.case, reason: row.reason, expires })
    };
    file.waiver.into_iter().map(waiver).collect()
}

/// The current date, UTC.
pub fn today() -> Date {
    let since = SystemTime::now().duration_since(SystemTime::UNIX_EPOCH).unwrap_or_default();
    date(since.as_secs() / 86_400)
}

/// The date so many days after 1970-01-01.
fn date(days: u64) -> Date {
    // Years from 1 March end with the leap day. 719468 days lead from March of the year 0 to 1970; 146097 are 400 years.
    let (fours, day) = ((days + 719_468) / 146_097, (days + 719_468) % 146_097);
    let year = (day - day / 1460 + day / 36_524 - day / 146_096) / 365;
    let day = day - (365 * year + year / 4 - year / 100);
    let month = (5 * day + 2) / 153;
    let after = u64::from(month >= 10);
    Date {
        year: (400 * fours + year + after) as u16,
        month: (month + 3 - 12 * after) as u8,
        day: (day - (153 * month + 2) / 5 + 1) as u8,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn days_are_dates() {
        let of = |days| date(days).to_string();
        assert_eq!([0, 31, 364, 365].map(of), ["1970-01-01", "1970-02-01", "1970-12-31", "1971-01-01"]);
        assert_eq!([789, 11_016, 11_017].map(of), ["1972-02-29", "2000-02-29", "2000-03-01"]);
        assert_eq!([20_785, 47_540, 47_541].map(of), ["2026-11-28", "2100-02-28", "2100-03-01"]);
    }
}
