//! Numbers of a description: those written as text, and lists with one for each axis.

use super::fields::{SCANNER_FIELDS, VIEW_FIELDS};
use serde_json::Value;
use trgs_core::error::{Error, Result};

/// Relative deviation from `s = n·d` that counts as rounding to a few digits.
pub(super) const ROUNDED: f64 = 1e-3;
/// Largest relative deviation at which the stated element size is more exact than size over number.
pub(super) const EXACT: f64 = 1e-9;

/// Numbers of the scanner that only descriptions of stacks have.
const OF_STACKS: [&str; 2] = ["totalAngle", "startAngle"];

/// Converts between the upward and the downward offset, without a negative zero.
pub(super) fn opposite(offset: f64) -> f64 {
    0.0 - offset
}

/// Refuses the first field of a file that should hold a number and holds something else.
///
/// # Errors
/// [`Error::Invalid`] that names the field, what it holds, and what to write.
pub(super) fn check(file: &Value) -> Result<()> {
    for name in SCANNER_FIELDS.into_iter().filter(|name| *name != "mode").chain(OF_STACKS) {
        check_field(name, &file["scanner"][name])?;
    }
    for list in ["proj_train", "proj_test"] {
        for (number, view) in file[list].as_array().into_iter().flatten().enumerate() {
            for name in VIEW_FIELDS.into_iter().filter(|name| *name != "file_path") {
                check_field(&format!("{name} of view {number} in {list}"), &view[name])?;
            }
        }
    }
    Ok(())
}

fn check_field(name: &str, value: &Value) -> Result<()> {
    let Some(other) = other_than_number(value) else { return Ok(()) };
    let remedy = match other.as_str().map(str::trim) {
        Some(text) if text.parse::<f64>().is_ok_and(f64::is_finite) => format!("write {text} without quotation marks"),
        _ => "write a number, without a unit".into(),
    };
    let got = match other {
        Value::String(text) => format!("the text {:?}", text.chars().take(LONGEST).collect::<String>()),
        Value::Bool(value) => format!("{value}"),
        _ => "an object".into(),
    };
    Err(Error::invalid(name, got, "a number", remedy))
}

/// Characters of a text that an error repeats.
const LONGEST: usize = 40;

/// The first text, truth value or object in a field or its lists; nothing is no value.
fn other_than_number(value: &Value) -> Option<&Value> {
    match value {
        Value::Null | Value::Number(_) => None,
        Value::Array(values) => values.iter().find_map(other_than_number),
        other => Some(other),
    }
}

/// A field with one number per axis.
fn entries<const N: usize>(name: &str, values: &[f64]) -> Result<[f64; N]> {
    values.try_into().map_err(|_| {
        Error::invalid(name, format!("{values:?}"), format!("{N} numbers, one per axis"), "give one number per axis")
    })
}

/// Numbers of pixels or voxels.
pub(super) fn counts<const N: usize>(name: &str, values: &[f64]) -> Result<[usize; N]> {
    let values: [f64; N] = entries(name, values)?;
    if values.iter().all(|n| n.fract() == 0.0 && (1.0..=65_536.0).contains(n)) {
        return Ok(values.map(|n| n as usize));
    }
    Err(Error::invalid(name, format!("{values:?}"), "whole numbers from 1 to 65536", "give positive whole numbers"))
}

/// Total sizes in the unit of the file.
pub(super) fn sizes<const N: usize>(name: &str, values: &[f64]) -> Result<[f64; N]> {
    let values: [f64; N] = entries(name, values)?;
    if values.iter().all(|s| *s > 0.0 && s.is_finite()) {
        return Ok(values);
    }
    Err(Error::invalid(name, format!("{values:?}"), "positive lengths: the total size", "give the total size"))
}

/// Sizes of pixels or voxels, `s/n`, compared with `d` where that is given.
pub(super) fn pitches<const N: usize>(name: &str, n: [usize; N], s: [f64; N], d: Option<&[f64]>) -> Result<[f64; N]> {
    let derived: [f64; N] = std::array::from_fn(|i| s[i] / n[i] as f64);
    let Some(d) = d else { return Ok(derived) };
    let d: [f64; N] = entries(&format!("d{name}"), d)?;
    let within = |limit: f64| d.iter().zip(&derived).all(|(d, derived)| (d / derived - 1.0).abs() <= limit);
    if within(EXACT) {
        Ok(d)
    } else if within(ROUNDED) {
        Ok(derived)
    } else {
        Err(Error::invalid(
            format!("d{name}"),
            format!("{d:?}"),
            format!("s{name}/n{name} = {derived:?}"),
            format!("s{name} is the total size, not that of one element: correct it, or leave d{name} out"),
        ))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    fn message(file: &Value) -> String {
        check(file).unwrap_err().to_string()
    }

    #[test]
    fn numbers_as_text_are_named_with_what_to_write() {
        for (field, value, shown) in [
            ("DSO", json!("5.0"), "write 5.0 without quotation marks"),
            ("sVoxel", json!([2, " 2.5 ", 2]), "write 2.5 without quotation marks"),
            ("offDetector", json!([[0, 0], [0, "1e-3"]]), "write 1e-3 without quotation marks"),
            ("DSD", json!("7 mm"), "write a number, without a unit"),
            ("totalAngle", json!(true), "write a number"),
            ("COR", json!({ "x": 1 }), "write a number"),
        ] {
            let found = message(&json!({ "scanner": { field: value } }));
            assert!(found.starts_with(&format!("{field}: got ")) && found.contains("expected a number"), "{found}");
            assert!(found.contains(shown), "{found}");
        }
        let found = message(&json!({ "scanner": {}, "proj_test": [{ "angle": 0.5 }, { "angle": "0.7" }] }));
        assert!(found.starts_with("angle of view 1 in proj_test: got the text \"0.7\""), "{found}");
        check(&json!({ "scanner": { "mode": "cone", "DSO": 5, "COR": null, "offDetector": [[0, 1]] } })).unwrap();
    }
}
