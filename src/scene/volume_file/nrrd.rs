//! NRRD: "nearly raw raster data" of Teem and 3D Slicer.

use super::elements::{Element, Encoding, Number};
use super::meta_image::{beside, shown};
use super::{RAS, VolumeFile, damaged, numbers};
use crate::error::{Error, Result};
use glam::{DMat3, DVec3};
use std::path::Path;

/// Longest header accepted, bytes.
const HEADER: usize = 1 << 16;

/// Parses a type name, including those that NumPy does not use.
fn number(name: &str) -> Option<Number> {
    Some(match name {
        "uchar" | "unsigned char" | "uint8_t" => Number::U8,
        "signed char" | "int8_t" => Number::I8,
        "ushort" | "unsigned short" | "unsigned short int" | "uint16_t" => Number::U16,
        "short" | "short int" | "signed short" | "signed short int" | "int16_t" => Number::I16,
        "uint" | "unsigned int" | "uint32_t" => Number::U32,
        "int" | "signed int" | "int32_t" => Number::I32,
        "ulonglong" | "unsigned long long" | "unsigned long long int" | "uint64_t" => Number::U64,
        "longlong" | "long long" | "long long int" | "signed long long" | "signed long long int" | "int64_t" => {
            Number::I64
        }
        "float" => Number::F32,
        "double" => Number::F64,
        other => return Number::named(other),
    })
}

/// Parses `(a,b,c)`.
fn vector(text: &str) -> Option<DVec3> {
    let inner = text.trim().strip_prefix('(')?.strip_suffix(')')?.replace(',', " ");
    numbers(&inner).map(DVec3::from_array)
}

pub(super) fn parse(content: &[u8], path: &Path) -> Result<VolumeFile> {
    let wrong = |key: &str, got: &str, expected: &str| {
        Error::format(path, key, shown(got), expected, "write it again as a plain 3-D volume, for example with Slicer")
    };
    let (mut shape, mut kind, mut encoding, mut big, mut file) = (None, None, None, false, None);
    let (mut spacing, mut origin, mut axes, mut signs) = (None, None, None, DVec3::ONE);
    let mut at = 0;
    loop {
        let end = content.len().min(HEADER);
        let rest = &content[at.min(end)..end];
        // A detached header may end with its last line.
        let length = rest.iter().position(|&byte| byte == b'\n').unwrap_or(rest.len());
        let line = String::from_utf8_lossy(&rest[..length]).trim_end().to_owned();
        if at == 0 && !line.starts_with("NRRD000") {
            return Err(wrong("first line", &line, "NRRD0001 to NRRD0005"));
        }
        at = (at + length + 1).min(content.len());
        if line.is_empty() {
            break;
        }
        let Some((key, value)) = line.split_once(": ").map(|(key, value)| (key.trim(), value.trim())) else { continue };
        match key.to_lowercase().as_str() {
            "dimension" if value != "3" => return Err(wrong(key, value, "3")),
            "type" => {
                kind = Some(number(value).ok_or_else(|| wrong(key, value, "a type of one number"))?);
            }
            "sizes" => shape = Some(numbers::<3, usize>(value).ok_or_else(|| wrong(key, value, "three counts"))?),
            "endian" => big = value == "big",
            "encoding" => {
                encoding = Some(match value {
                    "raw" => Encoding::Raw,
                    "gzip" | "gz" => Encoding::Gzip,
                    _ => return Err(wrong(key, value, "raw or gzip")),
                });
            }
            "spacings" => {
                spacing = Some(DVec3::from_array(numbers(value).ok_or_else(|| wrong(key, value, "three lengths"))?));
            }
            "space directions" => {
                let read: Option<Vec<DVec3>> = value.split_inclusive(')').map(vector).collect();
                let Some(Ok(read)) = read.map(<[DVec3; 3]>::try_from) else {
                    return Err(wrong(key, value, "three vectors"));
                };
                (spacing, axes) = (Some(DVec3::from_array(read.map(DVec3::length))), Some(read));
            }
            "space" => {
                signs = match value.to_lowercase().as_str() {
                    "right-anterior-superior" | "ras" => RAS,
                    "left-anterior-superior" | "las" => DVec3::new(1.0, -1.0, 1.0),
                    _ => DVec3::ONE,
                }
            }
            "space origin" => origin = Some(vector(value).ok_or_else(|| wrong(key, value, "(x,y,z)"))?),
            "data file" | "datafile" => file = Some(value.to_owned()),
            "line skip" | "lineskip" | "byte skip" | "byteskip" if value != "0" => {
                return Err(wrong(key, value, "0"));
            }
            _ => {}
        }
    }
    let (Some(shape), Some(kind), Some(encoding)) = (shape, kind, encoding) else {
        return Err(wrong("header", "no such fields", "sizes, type and encoding"));
    };
    let elsewhere;
    let bytes = match file {
        None => &content[at..],
        Some(name) => {
            elsewhere = beside(path, &name).map_err(|got| {
                Error::format(path, "data file", got, "a file in this folder", "move the file into this folder")
            })?;
            &elsewhere
        }
    };
    let element = Element { number: kind, big_endian: big };
    let values = element.volume(bytes, encoding, shape, |x| x).map_err(|found| damaged(path, &found))?;
    let (origin, axes) = (origin.map(|o| o * signs), axes.map(|axes| axes.map(|axis| axis * signs)));
    Ok(VolumeFile::new(values, spacing, origin, axes))
}

pub(super) fn header(
    path: &Path,
    shape: [usize; 3],
    spacing: DVec3,
    origin: DVec3,
    directions: DMat3,
) -> Result<Vec<u8>> {
    if path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("nhdr")) {
        return Err(Error::invalid("file to write", path.display(), "one file", "end it with .nrrd"));
    }
    let [x, y, z] = shape;
    let vector = |v: DVec3| format!("({},{},{})", v.x, v.y, v.z);
    let steps = [0, 1, 2].map(|axis| vector(directions.col(axis) * spacing[axis])).join(" ");
    Ok(format!(
        "NRRD0004\ntype: float\ndimension: 3\nspace: left-posterior-superior\nsizes: {x} {y} {z}\n\
         space directions: {steps}\nkinds: domain domain domain\nendian: little\nencoding: raw\n\
         space origin: {}\n\n",
        vector(origin)
    )
    .into_bytes())
}
