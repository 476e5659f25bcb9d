//! Fields of a description that are not read: remarks, and errors where one would move something.

use trgs_core::error::{Error, Result};
use trgs_core::words::{counted, verb};

/// The fields of a view that are read.
pub(super) const VIEW_FIELDS: [&str; 5] = ["file_path", "angle", "radius", "vector", "matrix"];
/// The fields of the scanner that are read.
pub(super) const SCANNER_FIELDS: [&str; 15] = [
    "mode",
    "DSD",
    "DSO",
    "nDetector",
    "sDetector",
    "dDetector",
    "nVoxel",
    "sVoxel",
    "dVoxel",
    "offOrigin",
    "offDetector",
    "COR",
    "rotDetector",
    "vectors",
    "matrices",
];
/// Unread fields of one place that are named; the others are counted.
const SHOWN: usize = 12;
/// Fields of views that move rays; those of the scanner are [`SCANNER_FIELDS`].
const OF_VIEWS: [&str; 4] = ["vector", "matrix", "angle", "angles"];
/// Names of other programs for what moves something. They are not read.
const ELSEWHERE: &str = "tau roll tilt pitch yaw helicalPitch tiltAngle rollAngle InPlaneAngle OutOfPlaneAngle GantryAngle \
    SourceOffsetX SourceOffsetY ProjectionOffsetX ProjectionOffsetY SourceToIsocenterDistance \
    SourceToDetectorDistance RadiusCylindricalDetector sourceOffset detectorOffset centerOfRotation \
    centreOfRotation sourceHeight detectorHeight";
/// Fields of generators that say how a scan was made. Nothing of them is needed to read it.
pub(super) const OF_GENERATORS: [&str; 15] = [
    "accuracy",
    "totalAngle",
    "startAngle",
    "randomAngle",
    "filter",
    "noise",
    "possion_noise",
    "gaussian_noise",
    "noise_model",
    "convert",
    "rescale_slope",
    "rescale_intercept",
    "normalize",
    "numTrain",
    "numVal",
];

/// Whether a JSON value is nothing, false, an empty text or list, or zeros: it moves nothing.
pub(super) fn is_neutral(value: &serde_json::Value) -> bool {
    use serde_json::Value;
    match value {
        Value::Null => true,
        Value::Bool(value) => !value,
        Value::Number(number) => number.as_f64() == Some(0.0),
        Value::String(text) => text.is_empty(),
        Value::Array(values) => values.iter().all(is_neutral),
        Value::Object(values) => values.values().all(is_neutral),
    }
}

/// Remarks on the fields of an object that are not among those `read`; `place` says where the object is. Each field comes
/// with whether it is neutral.
///
/// # Errors
/// [`Error::Invalid`] for a field that is named almost like one that moves something, or as other programs name such
/// a field, unless it is neutral.
pub(super) fn unread<'a>(
    place: &str,
    fields: impl IntoIterator<Item = (&'a str, bool)>,
    read: &[&str],
) -> Result<Vec<String>> {
    let (mut remarks, mut more) = (Vec::new(), 0);
    for (name, is_neutral) in fields.into_iter().filter(|(name, _)| !read.contains(name)) {
        let near = read.iter().chain(&SCANNER_FIELDS).chain(&OF_VIEWS).find(|known| are_near(name, known));
        let elsewhere = ELSEWHERE.split(' ').any(|other| plain(other) == plain(name));
        let misplaced = is_moving(name);
        let moves = elsewhere || misplaced || near.is_some_and(|near| is_moving(near));
        let hint = near.filter(|_| !misplaced).map_or_else(String::new, |near| format!("; did you mean {near}?"));
        if moves && !is_neutral {
            let remedy = match near {
                Some(_) if misplaced => {
                    "move it to where it is read: see the geometry page and reference/COMMANDS.md".into()
                }
                Some(near) => format!("did you mean {near}? Rename it, or remove it"),
                None => {
                    "state it as COR, offDetector, rotDetector, offOrigin, vectors or matrices, or remove it".into()
                }
            };
            let expected = "only fields that are read, among those that move source, detector or volume";
            return Err(Error::invalid(
                format!("field {name} of {place}"),
                "a field that is not read",
                expected,
                remedy,
            ));
        }
        if remarks.len() == SHOWN {
            more += 1;
            continue;
        }
        let neutral = if moves { ", but moves nothing" } else { "" };
        remarks.push(format!("the field {name} of {place} is not read{neutral}{hint}"));
    }
    if more > 0 {
        remarks.push(format!("{} of {place} {} not read either", counted(more, "field"), verb(more, "is", "are")));
    }
    Ok(remarks)
}

/// Whether a field moves source, detector, volume or rays, by the names that this reader knows.
fn is_moving(name: &str) -> bool {
    SCANNER_FIELDS.contains(&name) || OF_VIEWS.contains(&name)
}

/// A name without case and separators.
fn plain(name: &str) -> String {
    name.chars().filter(|c| c.is_alphanumeric()).flat_map(char::to_lowercase).collect()
}

/// Whether a name is so close to another that it may be meant: but for case, separators and a slip or two.
///
/// Slips are letters that are missing, added, replaced or exchanged with the next.
fn are_near(name: &str, known: &str) -> bool {
    let (a, b) = (plain(name), plain(known));
    let (written, meant) = (a.chars().count(), b.chars().count());
    let allowed = match meant {
        0..=4 => usize::from(written >= 3 && written != meant),
        5..=7 => 1,
        _ => 2,
    };
    // Every slip changes the length by one at most.
    a == b || (written.abs_diff(meant) <= allowed && strsim::osa_distance(&a, &b) <= allowed)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Whether a field is neutral.
    const NEUTRAL: bool = true;
    const SOMETHING: bool = false;

    fn of(name: &str, is_neutral: bool) -> std::result::Result<Vec<String>, String> {
        unread("the scanner", [(name, is_neutral)], &["offDetector", "DSO", "COR", "filter"]).map_err(|e| e.to_string())
    }

    #[test]
    fn a_typo_of_a_field_that_moves_something_is_an_error_with_the_name_meant() {
        for typo in ["offDetecor", "offdetector", "off_detector", "offDetectro", "ofDetectr", "Cor", "OffDetectors"] {
            let message = of(typo, SOMETHING).unwrap_err();
            assert!(message.contains("did you mean"), "{message}");
            let remarks = of(typo, NEUTRAL).unwrap();
            assert!(remarks[0].contains("moves nothing") && remarks[0].contains("did you mean"), "{remarks:?}");
        }
        assert!(of("helical_pitch", SOMETHING).unwrap_err().contains("vectors"));
        assert!(of("rotDetector", SOMETHING).unwrap_err().contains("move it to where it is read"));
    }

    #[test]
    fn other_fields_are_remarks_and_what_is_read_is_none() {
        assert_eq!(of("offDetector", SOMETHING), Ok(Vec::new()));
        assert_eq!(of("operator", SOMETHING).unwrap(), ["the field operator of the scanner is not read"]);
        assert!(of("fliter", SOMETHING).unwrap()[0].ends_with("did you mean filter?"));
        for other in ["kVp", "CT", "DSI", "vol", "date", "tube_current"] {
            assert_eq!(of(other, SOMETHING).unwrap().len(), 1, "{other}");
        }
    }

    #[test]
    fn many_unread_fields_are_counted() {
        let names: Vec<String> = (0..60_000).map(|i| format!("some long name of a field {i}")).collect();
        let remarks = unread("the file", names.iter().map(|name| (name.as_str(), SOMETHING)), &["vol"]).unwrap();
        assert_eq!(remarks.len(), SHOWN + 1);
        assert_eq!(remarks[SHOWN], "59988 fields of the file are not read either");
        // A field that moves something is refused wherever it stands.
        let moving = names.iter().map(String::as_str).chain(["offDetecor"]).map(|name| (name, SOMETHING));
        assert!(unread("the scanner", moving, &["offDetector"]).is_err());
    }

    #[test]
    fn zeros_and_nothing_are_neutral() {
        let of = |text: &str| is_neutral(&serde_json::from_str(text).unwrap());
        for text in ["null", "0", "0.0", "[0, 0]", "[[0, 0], [0, 0.0]]", "false", "\"\"", "[]", "{}", "{\"a\": 0}"] {
            assert!(of(text), "{text}");
        }
        for text in ["0.1", "[0, 1]", "true", "\"a\"", "{\"a\": 2}"] {
            assert!(!of(text), "{text}");
        }
    }
}
