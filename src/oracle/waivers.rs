//! Failures that are known and excused for a while: each with a reason and a last day.
//!
//! ```toml
//! [[waiver]]
//! case = "image-exact/needle"
//! reason = "set-up in single precision; issue 41 of the backend"
//! expires = 2027-06-30
//! ```

use super::manifest::Case;
use crate::error::{Error, Result};
use serde::Deserialize;
use std::path::Path;
use std::time::SystemTime;
use toml::value::{Date, Datetime};

/// One excuse.
#[derive(Clone, Debug, PartialEq)]
pub struct Waiver {
    /// The case's id.
    pub case: String,
    /// Why it may fail.
    pub reason: String,
    /// The last day on which it may.
    pub expires: Date,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct File {
    #[serde(default)]
    waiver: Vec<Row>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Row {
    case: String,
    reason: String,
    expires: Datetime,
}

/// Reads a file of waivers; every one must name a case that exists, and give a reason and a day.
///
/// # Errors
/// [`Error::Read`] or [`Error::Format`].
pub fn read(path: &Path, cases: &[Case]) -> Result<Vec<Waiver>> {
    let text = std::fs::read_to_string(path).map_err(|source| Error::read(path, source))?;
    let wrong = |got: String, expected: &str| {
        Error::format(path, "waivers", got, expected, "`trgs help oracle check` has an example")
    };
    let expected = "a list of [[waiver]] with case, reason and expires = YYYY-MM-DD";
    let file: File = toml::from_str(&text).map_err(|error| wrong(error.message().to_owned(), expected))?;
    let waiver = |row: Row| {
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

/// Today, UTC.
pub fn today() -> Date {
    let now = SystemTime::now().duration_since(SystemTime::UNIX_EPOCH).unwrap_or_default();
    date(now.as_secs() / 86_400)
}

/// The date of a day, counted from 1970-01-01.
///
/// Years are taken from March on, so that a leap day is the last of its year; 400 of them have 146,097 days.
fn date(day: u64) -> Date {
    // Days since 0000-03-01.
    let day = day + 719_468;
    let (era, day) = (day / 146_097, day % 146_097);
    let year = (day - day / 1460 + day / 36_524 - day / 146_096) / 365;
    let day = day - (365 * year + year / 4 - year / 100);
    let month = (5 * day + 2) / 153;
    let day = day - (153 * month + 2) / 5 + 1;
    let (month, next) = if month < 10 { (month + 3, 0) } else { (month - 9, 1) };
    Date { year: (400 * era + year + next) as u16, month: month as u8, day: day as u8 }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn days_follow_each_other_as_in_the_calendar() {
        let (mut day, months) = (0, [31, 28, 31, 30, 31, 30, 31, 31, 30, 31, 30, 31]);
        for year in 1970..2410_u16 {
            let leap = year % 4 == 0 && (year % 100 != 0 || year % 400 == 0);
            for (month, length) in (1..).zip(months) {
                for of_month in 1..=length + u8::from(leap && month == 2) {
                    assert_eq!(date(day), Date { year, month, day: of_month });
                    day += 1;
                }
            }
        }
    }
}
