//! Angles in a text: plain numbers, or a table with a header row.

use super::super::volume_file::without_bom;
use crate::error::{Error, Result};
use std::path::Path;

/// Words in the name of a column of angles.
const NAMES: [&str; 5] = ["angle", "theta", "phi", "rotation", "deg"];

/// A unit of angles.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Unit {
    Degrees,
    Radians,
}

/// The angles of a text, in its unit.
#[derive(Debug, PartialEq)]
pub(super) struct AngleTable {
    pub(super) angles: Vec<f64>,
    /// The unit that a header row states.
    pub(super) unit: Option<Unit>,
}

/// Parses the angles of a text, in its unit; `path` names it in errors.
///
/// The text has numbers separated by spaces, commas, semicolons or line ends, in which `#` starts a comment. A first
/// line with names makes it a table with one row per view: the angles are its only column, or the one that is called
/// angle, theta, phi, rotation or deg.
///
/// # Errors
/// [`Error::Format`] for the first word that is not a finite number, and for a table without a column of angles.
pub fn parse_angles(text: &[u8], path: &Path) -> Result<Vec<f64>> {
    parse_table(text, path).map(|table| table.angles)
}

/// [`parse_angles`], with the unit that a header states.
pub(super) fn parse_table(text: &[u8], path: &Path) -> Result<AngleTable> {
    let text = String::from_utf8_lossy(without_bom(text));
    let lines = text.lines().enumerate().map(|(i, line)| (i + 1, line.split('#').next().unwrap_or_default().trim()));
    let mut lines = lines.filter(|(_, line)| !line.is_empty()).peekable();
    let header = lines.next_if(|(_, line)| is_header(line));
    let Some((_, header)) = header else {
        let mut angles = Vec::new();
        for (number, line) in lines {
            for word in line.split(|c: char| c.is_whitespace() || ",;".contains(c)).filter(|word| !word.is_empty()) {
                angles.push(parse(word, number, path)?);
            }
        }
        return Ok(AngleTable { angles, unit: None });
    };
    let separator = [',', ';', '\t'].into_iter().find(|separator| header.contains(*separator));
    let cells = |line: &str| -> Vec<String> {
        let clean = |cell: &str| cell.trim().trim_matches('"').trim().to_owned();
        match separator {
            Some(separator) => line.split(separator).map(clean).collect(),
            None => vec![clean(line)],
        }
    };
    let names: Vec<String> = cells(header).iter().map(|name| name.to_lowercase()).collect();
    let named: Vec<usize> = (0..names.len()).filter(|&i| NAMES.iter().any(|name| names[i].contains(name))).collect();
    let column = match (names.len(), named.as_slice()) {
        (1, _) => 0,
        (_, [column]) => *column,
        _ => {
            let got = format!("columns {}", shortened(&names.join(", ")));
            let expected = "one column whose name contains angle, theta, phi, rotation or deg";
            return Err(Error::format(
                path,
                "header of the angles",
                got,
                expected,
                "rename the column, or remove others",
            ));
        }
    };
    let unit = match names[column].as_str() {
        name if name.contains("deg") || name.contains('°') => Some(Unit::Degrees),
        name if name.contains("rad") => Some(Unit::Radians),
        _ => None,
    };
    let angle = |(number, line): (usize, &str)| {
        parse(cells(line).get(column).map(String::as_str).unwrap_or_default(), number, path)
    };
    Ok(AngleTable { angles: lines.map(angle).collect::<Result<_>>()?, unit })
}

/// Whether a line names columns: it has letters, and no word of it is a number.
fn is_header(line: &str) -> bool {
    let mut words = line.split(|c: char| c.is_whitespace() || ",;\"".contains(c)).filter(|word| !word.is_empty());
    line.contains(char::is_alphabetic) && words.all(|word| word.parse::<f64>().is_err())
}

fn parse(word: &str, line: usize, path: &Path) -> Result<f64> {
    let angle = word.parse().ok().filter(|angle: &f64| angle.is_finite());
    angle.ok_or_else(|| {
        let remedy = "correct the number, or start comments with #";
        Error::format(path, format!("line {line}"), shortened(word), "a finite number", remedy)
    })
}

fn shortened(text: &str) -> String {
    const LONGEST: usize = 40;
    text.chars().take(LONGEST).collect()
}
