//! The angles of a stack: a NumPy array, a list, or a table with a header.

use super::super::npy;
use ndarray::Ix1;
use std::path::Path;
use trgs_core::error::{Error, Result};
use trgs_core::setting::Setting;
use trgs_core::words::utf8;

/// The unit that the header of a table states.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum AngleUnit {
    /// A heading with `deg` or `°`.
    Degrees,
    /// A heading with `rad`.
    Radians,
}

/// Longest word of a file that an error repeats.
const LONGEST: usize = 40;

/// Reads angles and returns radians.
///
/// The file is a one-dimensional `.npy` array, or a text for [`parse_angles`]. `in_degrees` states the unit of the file.
///
/// # Errors
/// [`Error::Read`], or [`Error::Format`] for the first word that is not a finite number, and for a header that states
/// another unit.
pub fn read_angles(path: impl AsRef<Path>, in_degrees: bool) -> Result<Vec<f64>> {
    let path = path.as_ref();
    let (angles, unit) = if path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("npy")) {
        (npy::read_f64::<Ix1>(path, "[view]")?.to_vec(), None)
    } else {
        let text = crate::input::read_text(path).map_err(|source| Error::read(path, source))?;
        parse_angles(&text, path)?
    };
    let (got, remedy) = match (unit, in_degrees) {
        (Some(AngleUnit::Degrees), false) => ("degrees", "add " + Setting::Degrees),
        (Some(AngleUnit::Radians), true) => ("radians", "omit " + Setting::Degrees),
        _ => return Ok(if in_degrees { angles.into_iter().map(f64::to_radians).collect() } else { angles }),
    };
    let expected = if in_degrees { "degrees" } else { "radians" };
    Err(Error::format(path, "unit in the heading of the angles", got, expected, remedy))
}

/// Parses angles, and the unit that a header states; `path` names the text in errors.
///
/// Without a header, the text holds numbers separated by spaces, commas, semicolons or line ends. A first line without
/// any number is a header: the columns below it are separated like its own, and the angles are the only column or the
/// one whose heading has `angle`, `theta`, `phi`, `rotation`, `deg` or `rad`. `#` starts a comment.
///
/// # Errors
/// [`Error::Format`] for the first word that is not a finite number, and for a header without one column of angles.
pub fn parse_angles(text: &[u8], path: &Path) -> Result<(Vec<f64>, Option<AngleUnit>)> {
    let text = utf8(text);
    let text = String::from_utf8_lossy(&text);
    let content = |line: &'_ str| line.split('#').next().unwrap_or_default().trim().to_owned();
    let lines: Vec<(usize, String)> =
        text.lines().enumerate().map(|(i, line)| (i + 1, content(line))).filter(|(_, line)| !line.is_empty()).collect();
    let any = |c: char| c.is_whitespace() || ",;".contains(c);
    let header = lines.first().filter(|(_, line)| lines.len() > 1 && line.split(any).all(is_heading));
    let Some((_, header)) = header else {
        let words = lines.iter().flat_map(|(i, line)| line.split(any).map(move |word| (*i, word)));
        let angles = words.filter(|(_, word)| !word.is_empty()).map(|(i, word)| number(word, i, path));
        return Ok((angles.collect::<Result<_>>()?, None));
    };
    let separator = [',', ';', '\t'].into_iter().find(|&c| header.contains(c));
    let cells = |line: &str| -> Vec<String> {
        let trimmed = |cell: &str| cell.trim().trim_matches('"').trim().to_owned();
        match separator {
            Some(c) => line.split(c).map(trimmed).collect(),
            None => line.split_whitespace().map(trimmed).collect(),
        }
    };
    let headings = match cells(&lines[1].1).len() {
        // A heading of several words.
        1 if separator.is_none() => vec![header.clone()],
        _ => cells(header),
    };
    let column = column_of_angles(&headings).ok_or_else(|| {
        let got: String = headings.join(", ").chars().take(LONGEST).collect();
        let expected = "one column whose heading has angle, theta, phi, rotation, deg or rad";
        Error::format(path, "header", got, expected, "name the column of the angles angle, or keep only that column")
    })?;
    let angle = |(i, line): &(usize, String)| {
        let cells = cells(line);
        match cells.get(column) {
            Some(cell) => number(cell, *i, path),
            None => {
                let (got, expected) =
                    (format!("{} columns", cells.len()), format!("{}, as its header", headings.len()));
                Err(Error::format(path, format!("line {i}"), got, expected, "complete the line, or delete it"))
            }
        }
    };
    let unit = |text: &str| match text.to_lowercase() {
        heading if heading.contains("deg") || heading.contains('°') => Some(AngleUnit::Degrees),
        heading if heading.contains("rad") => Some(AngleUnit::Radians),
        _ => None,
    };
    Ok((lines[1..].iter().map(angle).collect::<Result<_>>()?, unit(&headings[column])))
}

/// Whether a word of a first line may be a heading: it has a letter and is no number, even a misspelt one.
fn is_heading(word: &str) -> bool {
    let word = word.trim_matches('"');
    word.parse::<f64>().is_err() && !word.starts_with(|c: char| c.is_ascii_digit() || "+-.".contains(c))
}

/// The only column, or the only one with the heading of an angle; `angle` comes before the other words.
fn column_of_angles(headings: &[String]) -> Option<usize> {
    if headings.len() == 1 {
        return Some(0);
    }
    let with = |words: &[&str]| -> Vec<usize> {
        let has = |heading: &String| words.iter().any(|word| heading.to_lowercase().contains(word));
        (0..headings.len()).filter(|&i| has(&headings[i])).collect()
    };
    let only = |found: Vec<usize>| (found.len() == 1).then(|| found[0]);
    only(with(&["angle"])).or_else(|| only(with(&["theta", "phi", "rotation", "deg", "°", "rad"])))
}

fn number(word: &str, line: usize, path: &Path) -> Result<f64> {
    word.parse().ok().filter(|angle: &f64| angle.is_finite()).ok_or_else(|| {
        let got = word.chars().take(LONGEST).collect::<String>();
        let remedy = "correct the number, or start comments with #; a header is the first line of a table";
        Error::format(path, format!("line {line}"), got, "a finite number", remedy)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parsed(text: &str) -> Result<(Vec<f64>, Option<AngleUnit>)> {
        parse_angles(text.as_bytes(), Path::new("angles.csv"))
    }

    #[test]
    fn a_table_has_its_angles_under_their_heading() {
        for (text, unit) in [
            ("angle\n0\n30.5\n-60\n", None),
            (
                "\u{feff}# made by hand\nfile,Angle (deg),dose\na.tif,0,1\nb.tif,30.5,1\nc.tif,-60,1\n",
                Some(AngleUnit::Degrees),
            ),
            ("frame;theta_rad\r\n1;0\r\n2;30.5\r\n3;-60\r\n", Some(AngleUnit::Radians)),
            ("\"index\"\t\"phi\"\n0\t0\n1\t30.5\n2\t-60", None),
            ("n angle\n1 0\n2  30.5\n3 -60\n", None),
        ] {
            assert_eq!(parsed(text).unwrap(), (vec![0.0, 30.5, -60.0], unit), "{text}");
        }
        // Without a header, all numbers are angles.
        assert_eq!(parsed("0 1\n2,3;4").unwrap().0, [0.0, 1.0, 2.0, 3.0, 4.0]);
    }

    #[test]
    fn tables_that_do_not_fit_are_refused() {
        for (text, message) in [
            ("frame,position\n1,0\n2,30\n", "header: got frame, position, expected one column"),
            ("frame,angle\n1,0\n2\n", "line 3: got 1 columns, expected 2"),
            ("frame,angle\n1,0\n2,x\n", "line 3: got x"),
            ("0\nninety\n", "line 2: got ninety"),
            ("1O\n20\n", "line 1: got 1O"),
            ("nan\n20\n", "line 1: got nan"),
            ("ninety", "line 1: got ninety"),
        ] {
            let found = parsed(text).unwrap_err().to_string();
            assert!(found.contains(message), "{text}: {found}");
        }
    }

    #[test]
    fn a_heading_that_contradicts_the_unit_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("angles.csv");
        std::fs::write(&path, "angle_deg\n0\n180\n").unwrap();
        assert_eq!(read_angles(&path, true).unwrap()[1], std::f64::consts::PI);
        assert!(read_angles(&path, false).unwrap_err().to_string().contains("add `degrees`"));
        std::fs::write(&path, "angle [rad]\n0\n1\n").unwrap();
        assert_eq!(read_angles(&path, false).unwrap()[1], 1.0);
        assert!(read_angles(&path, true).unwrap_err().to_string().contains("omit `degrees`"));
    }
}
