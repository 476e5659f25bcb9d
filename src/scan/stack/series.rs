//! The files of a series: which of them are views, and in which order.
//!
//! Not in the paper. A name is text and numbers: `scan2_0007.tif` has the pattern `scan2_#.tif`, where `#` is the number
//! that differs most among the names. The pattern of most files is that of the views.
//!
//! | observation | consequence |
//! |---|---|
//! | a frame that is also the flat or dark field, by its path, or by content and another pattern | left out, with a remark |
//! | a frame of another pattern whose name says that it is a field | left out, with a remark |
//! | other frames of another pattern | a remark |
//! | numbers that are missing, or occur twice | a remark that names them |
//! | names with and without a minus before the number | ordered by the signed number, with a remark |
//! | different types of numbers | a remark |

use super::super::volume_file::{GAP, SLICES, files, with_extension};
use super::{npy, read_with_oddities};
use crate::input;
use ndarray::{Array3, Axis};
use std::collections::{BTreeMap, BTreeSet};
use std::io::{self, BufRead, BufReader};
use std::path::{Path, PathBuf};
use tiff::decoder::Decoder;
use tiff::tags::Tag;
use trgs_core::error::Result;
use trgs_core::setting::{Setting, Text};

/// Words in the names of fields.
const FIELDS: &str =
    "flat flats flatfield dark darks darkfield white gain offset bright open openbeam blank background di io";
/// Missing numbers that are listed.
const LISTED: usize = 5;

/// The frames of a series.
#[derive(Clone, Debug, PartialEq)]
pub struct Series {
    /// `[view, v, u]`.
    pub values: Array3<f32>,
    /// Names of the files of the views, in order; empty if one file holds all.
    pub names: Vec<String>,
    /// Remarks for the user, one sentence each.
    pub remarks: Vec<Text>,
}

/// Reads a stack like [`read`](super::read()), without the frames that are fields.
///
/// `fields` are the stacks given as flat and dark field, with their names.
///
/// # Errors
/// Those of [`read`](super::read()).
pub fn read_series(path: impl AsRef<Path>, fields: &[(&str, &Path)]) -> Result<Series> {
    series_of(path.as_ref(), fields)
}

fn series_of(path: &Path, fields: &[(&str, &Path)]) -> Result<Series> {
    let (values, oddities) = read_with_oddities(path)?;
    let mut series = Series { values, names: Vec::new(), remarks: oddities.iter().map(Text::from).collect() };
    if !path.is_dir() {
        return Ok(series);
    }
    let all = files(path)?;
    let kinds = [["npy"].as_slice()].into_iter().chain(SLICES);
    let frames = kinds.map(|kind| with_extension(&all, kind)).find(|found| !found.is_empty()).unwrap_or_default();
    // The slices of a DICOM series state their order themselves.
    if frames.len() == series.values.dim().0 {
        let (views, remarks) = choose(&frames, fields);
        if views.len() < frames.len() || views.windows(2).any(|pair| pair[1] < pair[0]) {
            series.values = series.values.select(Axis(0), &views);
        }
        series.names = views.iter().map(|&view| file_name(frames[view])).collect();
        // The names say more of a gap.
        series.remarks.retain(|remark| !remark.to_string().starts_with(GAP));
        series.remarks.extend(remarks);
        let kept: Vec<&Path> = views.iter().map(|&view| frames[view]).collect();
        series.remarks.extend(mixed_types(&kept).map(Text::from));
    }
    Ok(series)
}

/// A file name, taken apart.
struct Name {
    pattern: String,
    number: Option<i128>,
}

/// The views among the files of a folder, as indices in order, and remarks.
fn choose(frames: &[&Path], fields: &[(&str, &Path)]) -> (Vec<usize>, Vec<Text>) {
    let mut remarks = Vec::new();
    let names = name_patterns(frames, &mut remarks);
    let mut counts = BTreeMap::<&str, usize>::new();
    names.iter().for_each(|name| *counts.entry(&name.pattern).or_default() += 1);
    let most = counts.values().copied().max().unwrap_or(0);
    let main = names.iter().map(|name| name.pattern.as_str()).find(|pattern| counts[pattern] == most).unwrap_or("");

    let mut views = Vec::new();
    for (i, (path, name)) in frames.iter().zip(&names).enumerate() {
        let (file, is_other) = (file_name(path), name.pattern != main);
        match fields.iter().find_map(|(what, field)| same(path, field).map(|by| (what, by))) {
            Some((what, by_path)) if by_path || is_other => {
                remarks.push(format!("{file} is left out of the frames: it is the {what}"));
            }
            Some((what, _)) => {
                remarks.push(format!("{file} has the content of the {what}: take it out if it is no view"));
                views.push(i);
            }
            None if is_other && is_field(&name.pattern) => remarks.push(format!(
                "{file} is left out of the frames: its name says that it is a flat or dark field; rename it if it is a view"
            )),
            None => views.push(i),
        }
    }
    let others: Vec<usize> = views.iter().copied().filter(|&i| names[i].pattern != main).collect();
    if let Some(&first) = others.first() {
        let like = frames.iter().zip(&names).find(|(_, name)| name.pattern == main).map(|(path, _)| file_name(path));
        remarks.push(format!(
            "names have different patterns: {} like {}, {} like {}: take the files out that are no views",
            views.len() - others.len(),
            like.unwrap_or_default(),
            others.len(),
            file_name(frames[first]),
        ));
    }
    let numbers: Vec<i128> =
        views.iter().filter(|&&i| names[i].pattern == main).filter_map(|&i| names[i].number).collect();
    if numbers.iter().any(|number| *number < 0) {
        views.sort_by_key(|&i| (names[i].pattern != main, names[i].number, i));
        let (low, high) = (numbers.iter().min().copied(), numbers.iter().max().copied());
        remarks.push(format!(
            "names have negative numbers: frames are in the order of the numbers from {} to {}",
            low.unwrap_or_default(),
            high.unwrap_or_default()
        ));
    }
    let remarks = remarks.into_iter().map(Text::from).chain(gaps(numbers)).collect();
    (views, remarks)
}

/// Whether a frame is a field: `Some(true)` by its path, `Some(false)` by its content.
fn same(frame: &Path, field: &Path) -> Option<bool> {
    let real = |path: &Path| path.canonicalize().ok();
    if real(frame).is_some() && real(frame) == real(field) {
        return Some(true);
    }
    let length = |path: &Path| path.metadata().ok().filter(std::fs::Metadata::is_file).map(|file| file.len());
    if length(frame).is_none() || length(frame) != length(field) {
        return None;
    }
    same_content(frame, field).ok().filter(|same| *same).map(|_| false)
}

/// Compares files up to the first byte that differs.
fn same_content(a: &Path, b: &Path) -> io::Result<bool> {
    let (mut a, mut b) = (BufReader::new(input::open(a)?), BufReader::new(input::open(b)?));
    loop {
        let (left, right) = (a.fill_buf()?, b.fill_buf()?);
        let n = left.len().min(right.len());
        if n == 0 {
            return Ok(left.is_empty() && right.is_empty());
        }
        if left[..n] != right[..n] {
            return Ok(false);
        }
        a.consume(n);
        b.consume(n);
    }
}

/// Whether the letters of a pattern are the name of a field.
fn is_field(pattern: &str) -> bool {
    let stem = pattern.rsplit_once('.').map_or(pattern, |(stem, _)| stem);
    let words = stem.split(|c: char| !c.is_alphabetic()).map(str::to_lowercase);
    words.into_iter().any(|word| FIELDS.split(' ').any(|field| field == word))
}

/// Takes names apart; the number is the one that differs most among the names of a pattern.
fn name_patterns(frames: &[&Path], remarks: &mut Vec<String>) -> Vec<Name> {
    let parts: Vec<Vec<String>> = frames.iter().map(|path| split(&file_name(path))).collect();
    let shape = |parts: &[String]| {
        let mark = |part: &String| if is_number(part) { "#" } else { part.as_str() }.to_owned();
        parts.iter().map(mark).collect::<Vec<_>>()
    };
    // A minus is a sign only if other names lack it.
    let shapes: BTreeSet<Vec<String>> = parts.iter().map(|parts| shape(parts)).collect();
    let unsigned = |shape: &[String], at: usize| -> Option<Vec<String>> {
        let before = shape.get(at.checked_sub(1)?)?.strip_suffix('-')?.to_owned();
        let mut other = shape.to_vec();
        if before.is_empty() {
            other.remove(at - 1);
        } else {
            other[at - 1] = before;
        }
        shapes.contains(&other).then_some(other)
    };
    let mut groups = BTreeMap::<Vec<String>, Vec<(usize, Vec<i128>)>>::new();
    for (i, parts) in parts.iter().enumerate() {
        let own = shape(parts);
        let signed = (0..own.len()).filter(|&at| own[at] == "#").find_map(|at| Some((at, unsigned(&own, at)?)));
        let number = |at: usize| parts[at].parse::<i128>().unwrap_or(i128::MAX);
        let numbers = (0..own.len()).filter(|&at| own[at] == "#").map(|at| match &signed {
            Some((minus, _)) if *minus == at => -number(at),
            _ => number(at),
        });
        let numbers = numbers.collect();
        groups.entry(signed.map_or(own, |(_, other)| other)).or_default().push((i, numbers));
    }
    let mut names: Vec<Option<Name>> = frames.iter().map(|_| None).collect();
    for (shape, members) in groups {
        let fields = members[0].1.len();
        let different = |field: usize| members.iter().map(|(_, numbers)| numbers[field]).collect::<BTreeSet<_>>().len();
        let running = (0..fields).max_by_key(|&field| (different(field), field));
        let varying = (0..fields).filter(|&field| different(field) > 1).count();
        if varying > 1 && members.len() > 2 {
            remarks.push(format!(
                "names have {varying} numbers that differ, like {}: frames are in natural order of the names",
                file_name(frames[members[0].0])
            ));
        }
        for (i, numbers) in members {
            // Only a single number that differs counts the frames.
            let number = running.filter(|_| varying <= 1).map(|field| numbers[field]);
            names[i] = Some(Name { pattern: shape.concat(), number });
        }
    }
    names.into_iter().map(|name| name.expect("every name is in a group")).collect()
}

/// A remark on missing and repeated numbers.
fn gaps(mut numbers: Vec<i128>) -> Vec<Text> {
    numbers.sort_unstable();
    let mut remarks = Vec::new();
    if let Some(pair) = numbers.windows(2).find(|pair| pair[0] == pair[1]) {
        remarks.push(format!("the number {} occurs twice among the names: is each of them a view?", pair[0]).into());
    }
    numbers.dedup();
    let differences: Vec<i128> = numbers.windows(2).map(|pair| pair[1].saturating_sub(pair[0])).collect();
    let mut counts = BTreeMap::<i128, usize>::new();
    differences.iter().for_each(|&difference| *counts.entry(difference).or_default() += 1);
    // The step that most names follow.
    let Some((&step, &follow)) = counts.iter().max_by_key(|(step, count)| (**count, -**step)) else { return remarks };
    let wide = || numbers.windows(2).filter(|pair| pair[1].saturating_sub(pair[0]) > step);
    let lacking = wide().map(|pair| (pair[1].saturating_sub(pair[0]) - 1) / step).fold(0, i128::saturating_add);
    // Two different steps alone may be an order without a step.
    let follows =
        2 * follow > differences.len() || (2 * follow == differences.len() && lacking <= numbers.len() as i128);
    if numbers.len() < 3 || !follows || lacking == 0 {
        return remarks;
    }
    let listed =
        wide().flat_map(|pair| (1..).map(move |k| pair[0].saturating_add(k * step)).take_while(move |&n| n < pair[1]));
    let list: Vec<String> = listed.take(LISTED).map(|number| number.to_string()).collect();
    let more = if lacking > LISTED as i128 { ", …" } else { "" };
    let (noun, verb) = if lacking == 1 { ("number", "is") } else { ("numbers", "are") };
    let found = format!(
        "{noun} {}{more} {verb} missing between {} and {} ({} frames for {} numbers): evenly spaced angles would be wrong; give ",
        list.join(", "),
        numbers[0],
        numbers[numbers.len() - 1],
        numbers.len(),
        lacking.saturating_add(numbers.len() as i128)
    );
    let file = format!(" a file with the angles of the {} frames", numbers.len());
    remarks.push(Text::from(found) + Setting::Angles + file);
    remarks
}

/// A remark on files with different types of numbers.
fn mixed_types(frames: &[&Path]) -> Option<String> {
    let mut kinds = BTreeMap::<String, (usize, String)>::new();
    for path in frames {
        let kind = number_type(path)?;
        kinds.entry(kind).or_insert_with(|| (0, file_name(path))).0 += 1;
    }
    let list: Vec<String> = kinds.iter().map(|(kind, (n, first))| format!("{n} of {kind} like {first}")).collect();
    (kinds.len() > 1).then(|| {
        format!(
            "frames have different types of numbers: {}: do they have one scale? write them in one type",
            list.join(", ")
        )
    })
}

/// The type of the numbers of a file that was read before.
fn number_type(path: &Path) -> Option<String> {
    if path.extension()?.eq_ignore_ascii_case("npy") {
        return npy::type_of(path);
    }
    let mut decoder = Decoder::new(BufReader::new(input::open(path).ok()?)).ok()?;
    let bits = decoder.colortype().ok()?.bit_depth();
    let kind = match decoder.find_tag_unsigned::<u16>(Tag::SampleFormat).ok()? {
        Some(2) => "signed integers",
        Some(3) => "floats",
        _ => "integers",
    };
    Some(format!("{bits}-bit {kind}"))
}

/// Runs of digits and the text between them.
fn split(name: &str) -> Vec<String> {
    let mut parts: Vec<String> = Vec::new();
    for c in name.chars() {
        match parts.last_mut().filter(|part| is_number(part) == c.is_ascii_digit()) {
            Some(part) => part.push(c),
            None => parts.push(c.into()),
        }
    }
    parts
}

fn is_number(part: &str) -> bool {
    part.starts_with(|c: char| c.is_ascii_digit())
}

fn file_name(path: &Path) -> String {
    PathBuf::from(path).file_name().unwrap_or_default().to_string_lossy().into_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn chosen(names: &[&str]) -> (Vec<String>, String) {
        let mut paths: Vec<PathBuf> = names.iter().map(PathBuf::from).collect();
        paths.sort_by(|a, b| alphanumeric_sort::compare_path(a, b));
        let paths: Vec<&Path> = paths.iter().map(PathBuf::as_path).collect();
        let (views, remarks) = choose(&paths, &[]);
        (
            views.into_iter().map(|i| file_name(paths[i])).collect(),
            remarks.iter().map(Text::to_string).collect::<Vec<_>>().join("; "),
        )
    }

    #[test]
    fn complete_series_have_no_remark() {
        let counted = |pattern: &str, numbers: &[i32]| {
            let names: Vec<String> = numbers.iter().map(|n| pattern.replace('#', &n.to_string())).collect();
            chosen(&names.iter().map(String::as_str).collect::<Vec<_>>()).1
        };
        assert_eq!(counted("proj_#.tif", &[0, 1, 2, 3]), "");
        assert_eq!(counted("scan-#_v2.tif", &[5, 6, 7]), "");
        assert_eq!(counted("a#.npy", &[0, 18, 36, 54]), "", "steps of 18");
        assert_eq!(counted("a#.npy", &[7]), "");
        assert_eq!(counted("a#.npy", &[2, 10, 100]), "", "no step");
        assert_eq!(counted("a#.npy", &[1, 5, 30, 32, 100]), "", "no step");
        assert_eq!(chosen(&["a.tif", "b.tif"]).0.len(), 2);
    }

    #[test]
    fn missing_numbers_are_named() {
        let (views, remarks) = chosen(&["p_1.tif", "p_2.tif", "p_3.tif", "p_4.tif", "p_6.tif", "p_10.tif"]);
        assert_eq!(views.len(), 6);
        assert!(remarks.starts_with("numbers 5, 7, 8, 9 are missing between 1 and 10 (6 frames for 10"), "{remarks}");
        let (_, remarks) = chosen(&["p_01.tif", "p_02.tif", "p_04.tif", "p_05.tif"]);
        assert!(remarks.starts_with("number 3 is missing between 1 and 5 (4 frames for 5 numbers)"), "{remarks}");
        let (_, remarks) = chosen(&["p_000.tif", "p_010.tif", "p_020.tif", "p_040.tif"]);
        assert!(remarks.starts_with("number 30 is missing"), "{remarks}");
        let (_, remarks) = chosen(&["p_1.tif", "p_2.tif", "p_02.tif", "p_3.tif"]);
        assert!(remarks.contains("number 2 occurs twice"), "{remarks}");
        let (_, remarks) = chosen(&["p_1.tif", "p_2.tif", "p_3.tif", "p_170141183460469231731687303715884105720.tif"]);
        assert!(remarks.contains("numbers 4, 5, 6, 7, 8, … are missing"), "{remarks}");
    }

    #[test]
    fn fields_among_the_frames_are_left_out() {
        let (views, remarks) = chosen(&["0000.tif", "0001.tif", "flat.tif", "dark_1.tif"]);
        assert_eq!(views, ["0000.tif", "0001.tif"]);
        assert!(remarks.contains("flat.tif is left out") && remarks.contains("dark_1.tif is left out"), "{remarks}");
        // The frames of most files are views, whatever their name.
        assert_eq!(chosen(&["open_1.tif", "open_2.tif", "x.tif"]).0.len(), 3);
        let (views, remarks) = chosen(&["0000.tif", "0001.tif", "preview.tif"]);
        assert_eq!(views.len(), 3);
        assert!(remarks.contains("different patterns: 2 like 0000.tif, 1 like preview.tif"), "{remarks}");
    }

    #[test]
    fn a_frame_that_is_given_as_a_field_is_left_out() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        std::fs::create_dir(at("frames")).unwrap();
        let write = |name: &str, value: f32| {
            npy::write(&at(name), ndarray::Array2::from_elem((2, 3), value).view()).unwrap();
        };
        for (name, value) in [("0", 1.0), ("1", 2.0), ("2", 9.0), ("beam", 9.0)] {
            write(&format!("frames/{name}.npy"), value);
        }
        write("field.npy", 9.0);
        let kept = |field: &Path| read_series(at("frames"), &[("flat field", field)]).unwrap();
        let series = kept(&at("field.npy"));
        assert_eq!(series.names, ["0.npy", "1.npy", "2.npy"]);
        assert_eq!(series.values.dim(), (3, 2, 3));
        assert!(
            series.remarks[0].to_string().contains("2.npy has the content of the flat field"),
            "{:?}",
            series.remarks
        );
        assert!(
            series.remarks[1].to_string().contains("beam.npy is left out of the frames: it is the flat"),
            "{:?}",
            series.remarks
        );
        let series = kept(&at("frames/1.npy"));
        assert_eq!(series.names[..2], ["0.npy", "2.npy"]);
        assert_eq!(series.values[[1, 0, 0]], 9.0);
        let one = read_series(at("field.npy"), &[]).unwrap();
        assert!(one.names.is_empty() && one.remarks.is_empty());
        npy::write(&at("frames/1.npy"), ndarray::Array2::<f64>::zeros((2, 3)).view()).unwrap();
        let series = read_series(at("frames"), &[]).unwrap();
        let types = "frames have different types of numbers: 3 of <f4 like 0.npy, 1 of <f8 like 1.npy";
        assert!(series.remarks.iter().any(|remark| remark.to_string().starts_with(types)), "{:?}", series.remarks);
    }

    #[test]
    fn signed_numbers_are_an_order_and_separators_are_not() {
        let (views, remarks) = chosen(&["p_-10.tif", "p_-5.tif", "p_0.tif", "p_5.tif"]);
        assert_eq!(views, ["p_-10.tif", "p_-5.tif", "p_0.tif", "p_5.tif"]);
        assert!(remarks.contains("numbers from -10 to 5") && !remarks.contains("missing"), "{remarks}");
        let (views, _) = chosen(&["-2.tif", "-1.tif", "0.tif", "1.tif"]);
        assert_eq!(views, ["-2.tif", "-1.tif", "0.tif", "1.tif"]);
        let (views, remarks) = chosen(&["p-1.tif", "p-2.tif", "p-3.tif"]);
        assert_eq!((views[0].as_str(), remarks.as_str()), ("p-1.tif", ""));
    }
}
