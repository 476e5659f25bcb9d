//! Raw numbers, described by the file's name or by a side file.

use super::detached::{Described, Numbers, whole};
use super::elements::{Element, Encoding, Layout, Number, Start};
use super::{VolumeFile, damaged};
use crate::unit::Unit;
use glam::DVec3;
use serde::Deserialize;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};
use trgs_core::error::{Error, Result};
use trgs_core::words::utf8;

/// The side file `name.raw.json`, which describes `name.raw`:
///
/// ```json
/// { "shape": [256, 256, 100], "type": "uint16", "byte_order": "little",
///   "spacing": [0.5, 0.5, 1.0], "origin": [0.0, 0.0, 0.0], "unit": "mm", "skip_bytes": 0 }
/// ```
///
/// Only `shape` and `type` are required. The numbers fill the rest of the file, to its last byte.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SideFile {
    /// `[x, y, z]`, x fastest in the file.
    shape: [usize; 3],
    /// NumPy's type name: uint8, int8, uint16, int16, uint32, int32, float32 or float64.
    #[serde(rename = "type")]
    kind: String,
    /// Order of the bytes of a number.
    #[serde(default)]
    byte_order: ByteOrder,
    /// Distance between voxels along x, y, z.
    spacing: Option<[f64; 3]>,
    /// Centre of voxel (0, 0, 0).
    origin: Option<[f64; 3]>,
    /// Unit of spacing and origin.
    unit: Option<String>,
    /// Bytes before the first number.
    #[serde(default)]
    skip_bytes: usize,
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
enum ByteOrder {
    #[default]
    Little,
    Big,
}

impl SideFile {
    /// Parses the content of a side file; `path` names it in errors.
    ///
    /// # Errors
    /// [`Error::Format`] for anything but the fields above.
    pub fn parse(text: &[u8], path: &Path) -> Result<Self> {
        let wrong = |got: String| {
            let expected = "JSON with shape [x, y, z], type (uint8, int16, float32, …) and perhaps byte_order, spacing, \
                            origin, unit, skip_bytes";
            Error::format(path, "side file", got, expected, "compare it with the one in `trgs help convert`")
        };
        let side: Self = serde_json::from_slice(&utf8(text)).map_err(|error| wrong(error.to_string()))?;
        if Number::named(&side.kind).is_none() {
            return Err(wrong(format!("type {:?}", side.kind)));
        }
        let is_sound = side.spacing.iter().flatten().all(|side| *side > 0.0 && side.is_finite())
            && side.origin.iter().flatten().all(|position| position.is_finite());
        if !is_sound {
            return Err(wrong(format!("spacing {:?}, origin {:?}", side.spacing, side.origin)));
        }
        if let Some(unit) = &side.unit {
            unit.parse::<Unit>().map_err(|error| error.in_file(path))?;
        }
        Ok(side)
    }

    /// The volume in the content of the file `path`, `[x, y, z]`.
    ///
    /// # Errors
    /// [`Error::Format`] when the content has another length.
    pub fn volume(&self, content: &[u8], path: &Path) -> Result<VolumeFile> {
        whole(self.describe(content.len(), path)?, content, path)
    }

    fn describe(&self, length: usize, path: &Path) -> Result<Described> {
        let number = Number::named(&self.kind).expect("checked when it was read");
        let element = Element { number, big_endian: self.byte_order == ByteOrder::Big };
        let [spacing, origin] = [self.spacing, self.origin].map(|vector| vector.map(DVec3::from_array));
        let unit = self.unit.as_deref().and_then(Unit::named);
        let numbers = numbers(length, self.skip_bytes, element, self.shape, path)?;
        Ok((VolumeFile { spacing, origin, unit, ..VolumeFile::default() }, numbers))
    }
}

/// The volume in a file of `length` bytes, described by its side file, or else by its name.
pub(super) fn describe(length: usize, path: &Path) -> Result<Described> {
    let side_path = side_path(path);
    match crate::input::read(&side_path) {
        Ok(text) => SideFile::parse(&text, &side_path)?.describe(length, path),
        Err(error) if [ErrorKind::NotFound, ErrorKind::NotADirectory].contains(&error.kind()) => {
            let (shape, element) = of_name(path)?;
            Ok((VolumeFile::default(), numbers(length, 0, element, shape, path)?))
        }
        Err(error) => Err(Error::read(&side_path, error)),
    }
}

/// All numbers after `skip` bytes.
fn numbers(length: usize, skip: usize, element: Element, shape: [usize; 3], path: &Path) -> Result<Numbers> {
    let size = element.size(shape).map_err(|found| damaged(path, &found))?;
    let found = length.saturating_sub(skip);
    if found != size {
        let got = format!("{found} bytes after the first {skip}");
        let remedy = "correct the size and type in the name or side file; skip_bytes of a side file skips a header";
        return Err(Error::format(path, "volume", got, format!("{size} bytes for shape {shape:?}"), remedy));
    }
    Ok(Numbers::here(skip, Layout { element, encoding: Encoding::Raw, shape, start: Start::After(0) }))
}

/// The path of the side file, `name.raw.json`.
fn side_path(path: &Path) -> PathBuf {
    let mut name = path.as_os_str().to_owned();
    name.push(".json");
    name.into()
}

/// Rejects a file name that does not state the size and type to be written.
pub(super) fn check_name(path: &Path, shape: [usize; 3]) -> Result<()> {
    let [x, y, z] = shape;
    let remedy = format!("end it with _{x}x{y}x{z}_float32.raw");
    if side_path(path).exists() {
        let expected = "no side file: the name states the content";
        return Err(Error::invalid("file to write", side_path(path).display(), expected, "delete the side file"));
    }
    if of_name(path)? != (shape, Element { number: Number::F32, big_endian: false }) {
        return Err(Error::invalid("name of the file", path.display(), "its size and type", remedy));
    }
    Ok(())
}

/// Size and type stated by the name of a `.raw` file, or else by that of its folder.
///
/// Two numbers are the columns and rows of one slice.
fn of_name(path: &Path) -> Result<([usize; 3], Element)> {
    let stem = path.file_stem().unwrap_or_default().to_string_lossy().to_lowercase();
    let folder = path.parent().and_then(Path::file_name).unwrap_or_default().to_string_lossy().to_lowercase();
    let found = [stem, folder].iter().find_map(|name| size_and_type(name));
    found.ok_or_else(|| {
        let expected = "size and type, as in name_256x256x256_uint8.raw, or name_256x256_uint8.raw for a slice; be \
                        after the type means big-endian";
        let remedy = "rename the file, or describe it in a side file named like it with .json appended";
        Error::invalid("name of the file", path.display(), expected, remedy)
    })
}

fn size_and_type(name: &str) -> Option<([usize; 3], Element)> {
    let sides = |part: &str| -> Option<Vec<usize>> { part.split('x').map(|n| n.parse().ok()).collect() };
    let element = |part: &str| {
        let (name, big_endian) = match part.strip_suffix("be") {
            Some(name) => (name, true),
            None => (part.strip_suffix("le").unwrap_or(part), false),
        };
        Number::named(name).map(|number| Element { number, big_endian })
    };
    let sizes: Vec<Vec<usize>> = name.split('_').filter_map(sides).collect();
    let shape = match (sizes.iter().find(|sides| sides.len() == 3), sizes.iter().find(|sides| sides.len() == 2)) {
        (Some(sides), _) => [sides[0], sides[1], sides[2]],
        (None, Some(sides)) => [sides[0], sides[1], 1],
        (None, None) => return None,
    };
    Some((shape, name.split('_').find_map(element)?))
}
