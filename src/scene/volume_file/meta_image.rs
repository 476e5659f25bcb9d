//! MetaImage, ITK's format: a text header, followed by the numbers or naming their file.

use super::elements::{Element, Encoding, Number};
use super::{VolumeFile, damaged, numbers};
use crate::error::{Error, Result};
use glam::{DMat3, DVec3};
use std::path::Path;

/// Longest header accepted, bytes.
const HEADER: usize = 1 << 16;

/// ITK's type names.
const TYPES: [(&str, Number); 12] = [
    ("MET_UCHAR", Number::U8),
    ("MET_CHAR", Number::I8),
    ("MET_USHORT", Number::U16),
    ("MET_SHORT", Number::I16),
    ("MET_UINT", Number::U32),
    ("MET_INT", Number::I32),
    ("MET_ULONG", Number::U32),
    ("MET_LONG", Number::I32),
    ("MET_ULONG_LONG", Number::U64),
    ("MET_LONG_LONG", Number::I64),
    ("MET_FLOAT", Number::F32),
    ("MET_DOUBLE", Number::F64),
];

pub(super) fn parse(content: &[u8], path: &Path) -> Result<VolumeFile> {
    let wrong = |key: &str, got: &str, expected: &str| {
        Error::format(path, key, shown(got), expected, "write it again as a plain 3-D image, for example with ITK")
    };
    let (mut shape, mut element, mut encoding, mut big) = (None, None, Encoding::Raw, false);
    let (mut spacing, mut origin, mut axes) = (None, None, None);
    let mut at = 0;
    loop {
        let rest = &content[at..content.len().min(HEADER)];
        let length = rest.iter().position(|&byte| byte == b'\n').unwrap_or(rest.len());
        let line = String::from_utf8_lossy(&rest[..length]).into_owned();
        at = (at + length + 1).min(content.len());
        let Some((key, value)) = line.split_once('=').map(|(key, value)| (key.trim(), value.trim())) else {
            return Err(wrong("header", &line, "lines `key = value` that end with ElementDataFile"));
        };
        let is_true = value.eq_ignore_ascii_case("true");
        match key {
            "NDims" if value != "3" => return Err(wrong(key, value, "3")),
            "ElementNumberOfChannels" if value != "1" => return Err(wrong(key, value, "1")),
            "BinaryData" if !is_true => return Err(wrong(key, value, "True")),
            "DimSize" => shape = Some(numbers::<3, usize>(value).ok_or_else(|| wrong(key, value, "three counts"))?),
            "ElementType" => {
                let known = TYPES.iter().find(|(name, _)| *name == value);
                element = Some(known.ok_or_else(|| wrong(key, value, "a type of one number"))?.1);
            }
            "ElementSpacing" | "ElementSize" => {
                let read = numbers(value).ok_or_else(|| wrong(key, value, "three lengths"))?;
                spacing = spacing.filter(|_| key == "ElementSize").or(Some(DVec3::from_array(read)));
            }
            "Offset" | "Position" | "Origin" => {
                origin = Some(DVec3::from_array(numbers(value).ok_or_else(|| wrong(key, value, "three lengths"))?));
            }
            "TransformMatrix" | "Rotation" | "Orientation" => {
                // One axis after another.
                let read = numbers::<9, f64>(value).ok_or_else(|| wrong(key, value, "nine numbers"))?;
                axes = Some([0, 3, 6].map(|i| DVec3::from_slice(&read[i..])));
            }
            "BinaryDataByteOrderMSB" | "ElementByteOrderMSB" => big = is_true,
            "CompressedData" if is_true => encoding = Encoding::Zlib,
            "ElementDataFile" => {
                let (Some(shape), Some(element)) = (shape, element) else {
                    return Err(wrong(key, value, "DimSize and ElementType before it"));
                };
                let element = Element { number: element, big_endian: big };
                let elsewhere;
                let bytes = if value == "LOCAL" {
                    &content[at..]
                } else {
                    elsewhere = beside(path, value).map_err(|got| {
                        Error::format(
                            path,
                            key,
                            got,
                            "LOCAL or a file in this folder",
                            "move the file into this folder",
                        )
                    })?;
                    &elsewhere
                };
                let values = element.volume(bytes, encoding, shape, |x| x).map_err(|found| damaged(path, &found))?;
                return Ok(VolumeFile::new(values, spacing, origin, axes));
            }
            _ => {}
        }
        if at >= content.len().min(HEADER) {
            return Err(wrong("header", "its end", "ElementDataFile"));
        }
    }
}

/// The content of a file in the same folder, or an error message.
///
/// A header must not name files elsewhere.
pub(super) fn beside(path: &Path, name: &str) -> std::result::Result<Vec<u8>, String> {
    if Path::new(name).file_name().is_none_or(|file| file != name) {
        return Err(shown(name));
    }
    std::fs::read(path.with_file_name(name)).map_err(|error| format!("{}: {error}", shown(name)))
}

/// The beginning of a text from a file, shortened for a message.
pub(super) fn shown(text: &str) -> String {
    const LONGEST: usize = 60;
    let beginning: String = text.chars().take(LONGEST).collect();
    let rest = if text.chars().count() > LONGEST { "…" } else { "" };
    format!("{beginning:?}{rest}")
}

pub(super) fn header(
    path: &Path,
    shape: [usize; 3],
    spacing: DVec3,
    origin: DVec3,
    directions: DMat3,
) -> Result<Vec<u8>> {
    if path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("mhd")) {
        return Err(Error::invalid("file to write", path.display(), "one file", "end it with .mha"));
    }
    let [x, y, z] = shape;
    let (s, o) = (spacing, origin);
    let axes = directions.to_cols_array().map(|x| x.to_string()).join(" ");
    Ok(format!(
        "ObjectType = Image\nNDims = 3\nBinaryData = True\nBinaryDataByteOrderMSB = False\nCompressedData = False\n\
         TransformMatrix = {axes}\nOffset = {} {} {}\nElementSpacing = {} {} {}\nDimSize = {x} {y} {z}\n\
         ElementType = MET_FLOAT\nElementDataFile = LOCAL\n",
        o.x, o.y, o.z, s.x, s.y, s.z
    )
    .into_bytes())
}
