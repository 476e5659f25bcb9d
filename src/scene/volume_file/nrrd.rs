//! NRRD: "nearly raw raster data" of Teem and 3D Slicer.

use super::elements::{Element, Encoding, Number};
use super::meta_image::{beside, shown};
use super::{VolumeFile, damaged, three};
use crate::error::{Error, Result};
use glam::DVec3;
use std::path::Path;

/// A header is not longer.
const HEADER: usize = 1 << 16;

/// Names of types that are not NumPy's.
fn number(name: &str) -> Option<Number> {
    Some(match name {
        "uchar" | "unsigned char" | "uint8_t" => Number::U8,
        "signed char" | "int8_t" => Number::I8,
        "ushort" | "unsigned short" | "unsigned short int" | "uint16_t" => Number::U16,
        "short" | "short int" | "signed short" | "signed short int" | "int16_t" => Number::I16,
        "uint" | "unsigned int" | "uint32_t" => Number::U32,
        "int" | "signed int" | "int32_t" => Number::I32,
        "float" => Number::F32,
        "double" => Number::F64,
        other => return Number::named(other),
    })
}

/// `(a,b,c)`.
fn vector(text: &str) -> Option<DVec3> {
    let inner = text.trim().strip_prefix('(')?.strip_suffix(')')?.replace(',', " ");
    three(&inner).map(DVec3::from_array)
}

pub(super) fn parse(content: &[u8], path: &Path) -> Result<VolumeFile> {
    let wrong = |key: &str, got: &str, expected: &str| {
        Error::format(path, key, shown(got), expected, "write it again as a plain 3-D volume, for example with Slicer")
    };
    let (mut shape, mut kind, mut encoding, mut big, mut file) = (None, None, None, false, None);
    let (mut spacing, mut origin, mut oddities) = (None, None, Vec::new());
    let mut at = 0;
    loop {
        let end = content.len().min(HEADER);
        let rest = &content[at.min(end)..end];
        // A header that lies beside its numbers may end with its last line.
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
                kind =
                    Some(number(value).ok_or_else(|| wrong(key, value, "a number type of up to 32 bits, or double"))?)
            }
            "sizes" => shape = Some(three::<usize>(value).ok_or_else(|| wrong(key, value, "three counts"))?),
            "endian" => big = value == "big",
            "encoding" => {
                encoding = Some(match value {
                    "raw" => Encoding::Raw,
                    "gzip" | "gz" => Encoding::Gzip,
                    _ => return Err(wrong(key, value, "raw or gzip")),
                });
            }
            "spacings" => {
                spacing = Some(DVec3::from_array(three(value).ok_or_else(|| wrong(key, value, "three lengths"))?));
            }
            "space directions" => {
                let axes: Option<Vec<DVec3>> = value.split_inclusive(')').map(vector).collect();
                let Some(Ok(axes)) = axes.map(<[DVec3; 3]>::try_from) else {
                    return Err(wrong(key, value, "three vectors"));
                };
                spacing = Some(DVec3::from_array(axes.map(DVec3::length)));
                let straight = (0..3).all(|axis| axes[axis][axis] > 0.0 && axes[axis][axis] == axes[axis].length());
                if !straight {
                    oddities.push(format!("the axes have the directions {value}; they are read as x, y and z"));
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
            elsewhere = beside(path, &name)
                .map_err(|got| Error::format(path, "data file", got, "a file in this folder", "put the file there"))?;
            &elsewhere
        }
    };
    let element = Element { number: kind, big_endian: big };
    let values = element.volume(bytes, encoding, shape).map_err(|found| damaged(path, &found))?;
    Ok(VolumeFile { values, spacing, origin, oddities })
}

pub(super) fn header(path: &Path, shape: [usize; 3], spacing: DVec3, origin: DVec3) -> Result<Vec<u8>> {
    if path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("nhdr")) {
        return Err(Error::invalid("file to write", path.display(), "one file", "end it with .nrrd"));
    }
    let [x, y, z] = shape;
    let (s, o) = (spacing, origin);
    Ok(format!(
        "NRRD0004\ntype: float\ndimension: 3\nspace dimension: 3\nsizes: {x} {y} {z}\n\
         space directions: ({},0,0) (0,{},0) (0,0,{})\nkinds: domain domain domain\nendian: little\nencoding: raw\n\
         space origin: ({},{},{})\n\n",
        s.x, s.y, s.z, o.x, o.y, o.z
    )
    .into_bytes())
}
