//! NRRD: "nearly raw raster data" of Teem and 3D Slicer.

use super::detached::{Described, Numbers, Skip, Source};
use super::elements::{Element, Encoding, Layout, Number, Start};
use super::header::{Header, converted, lossy, numbers, shown, three_axes, vector as plain_vector};
use super::{Place, RAS, VolumeFile, unsupported};
use crate::unit::Unit;
use glam::DVec3;
use std::path::Path;
use trgs_core::error::{Error, Result};

/// Remedy for content that is not one volume of one number per voxel.
const TO_PLAIN: &str = "write it again as a plain 3-D volume, for example with Slicer";

/// Fields that are read, or that change neither numbers nor positions.
const KNOWN: &str = "dimension|type|sizes|endian|encoding|spacings|space|space dimension|space directions|space origin|\
    space units|units|axis mins|axismins|centers|centerings|kinds|labels|content|thicknesses|measurement frame|\
    data file|line skip|byte skip|number|sample units";

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
    plain_vector(&inner, 3, 0.0)
}

/// The header, with names of fields in lower case.
fn header_of<'a>(content: &[u8], path: &'a Path) -> Result<Header<'a>> {
    let mut header = Header::begin(content, path, TO_PLAIN);
    let start = header.end;
    loop {
        let is_first = header.end == start;
        // A detached header may end with its last line.
        let line = header.line(content).unwrap_or_default();
        let line = line.trim_end();
        if is_first && !line.starts_with("NRRD000") {
            return Err(header.wrong("first line", line, "NRRD0001 to NRRD0005"));
        }
        if line.is_empty() {
            return Ok(header);
        }
        // `key:=value` is a remark of the writer.
        let field = line.split_once(':').filter(|(_, value)| !value.starts_with('='));
        let Some((key, value)) = field.filter(|_| !line.starts_with('#')) else { continue };
        let key = key.trim().to_lowercase();
        let key = match key.as_str() {
            "datafile" => "data file",
            "lineskip" => "line skip",
            "byteskip" => "byte skip",
            other => other,
        };
        header.fields.push((key.to_owned(), value.trim().to_owned()));
        // The names of a list follow without an empty line.
        if key == "data file" && value.trim().starts_with("LIST") {
            return Ok(header);
        }
    }
}

/// How much is skipped, by a field.
fn skip(header: &Header<'_>, key: &str) -> Result<i64> {
    let value = header.get(key).unwrap_or("0");
    value.parse().ok().filter(|n| *n >= -1).ok_or_else(|| header.wrong(key, value, "a number from -1"))
}

/// The volume whose header begins the content.
pub(super) fn describe(content: &[u8], path: &Path) -> Result<Described> {
    let header = header_of(content, path)?;
    let mut oddities = Vec::new();
    let (Some(sides), Some(kind), Some(encoding)) = (header.get("sizes"), header.get("type"), header.get("encoding"))
    else {
        return Err(header.wrong("header", "no such fields", "sizes, type and encoding"));
    };
    let axes: usize = match header.get("dimension") {
        None => 3,
        Some(value) => value.parse().map_err(|_| header.wrong("dimension", value, "a number of axes"))?,
    };
    let read = numbers::<usize>(sides).filter(|read| read.len() == axes && axes <= 16);
    let read = read.ok_or_else(|| header.wrong("sizes", sides, &format!("{axes} counts")))?;
    let expected = "at most three axes longer than 1";
    let shape = three_axes(&read).ok_or_else(|| unsupported(path, "sizes", shown(sides), expected, TO_PLAIN))?;
    check_kinds(&header, &read, &mut oddities)?;
    let number = number(kind).ok_or_else(|| match kind {
        "block" => unsupported(path, "type", "block", "a type of one number", TO_PLAIN),
        _ => header.wrong("type", kind, "a type of one number"),
    })?;
    let (spacing, origin, directions, in_millimetres) = place(&header, axes, &mut oddities)?;
    let numbers = place_of_numbers(&header, content, shape, number, encoding, &mut oddities)?;
    for key in ["old min", "oldmin", "old max", "oldmax"].iter().filter(|key| header.get(key).is_some()) {
        oddities.push(format!("{key} states the values before quantisation; numbers are read as stored"));
    }
    let unknown = header.unknown(|key| KNOWN.split('|').any(|known| known == key) || key.starts_with("old"));
    let mut volume = VolumeFile::new(spacing, origin, directions).in_millimetres(in_millimetres);
    volume.oddities.extend(oddities.into_iter().chain(unknown));
    Ok((volume, numbers))
}

/// Rejects axes that are not of space.
fn check_kinds(header: &Header<'_>, sides: &[usize], oddities: &mut Vec<String>) -> Result<()> {
    let kinds = header.get("kinds").unwrap_or_default();
    for (kind, side) in kinds.split_whitespace().zip(sides) {
        match kind.to_lowercase().as_str() {
            "domain" | "space" | "none" | "???" => {}
            _ if *side == 1 => {}
            "list" | "time" | "stub" | "scalar" => {
                oddities.push(format!("kinds: an axis of kind {} is read as one of space", shown(kind)));
            }
            _ => return Err(unsupported(header.path, "kinds", shown(kinds), "axes of space", TO_PLAIN)),
        }
    }
    Ok(())
}

/// Spacing, origin and steps along the axes in ITK's coordinates, and whether they are in millimetres.
type Stated = (Option<DVec3>, Option<DVec3>, Option<[DVec3; 3]>, bool);

fn place(header: &Header<'_>, axes: usize, oddities: &mut Vec<String>) -> Result<Stated> {
    let signs = match header.get("space").map(str::to_lowercase).as_deref() {
        Some("right-anterior-superior" | "ras") => RAS,
        Some("left-anterior-superior" | "las") => DVec3::new(1.0, -1.0, 1.0),
        None | Some("left-posterior-superior" | "lps" | "scanner-xyz" | "3d-right-handed" | "3d-left-handed" | "") => {
            DVec3::ONE
        }
        Some(other) => {
            oddities.push(format!("space {} is not understood: it is read as left-posterior-superior", shown(other)));
            DVec3::ONE
        }
    };
    let units = header.get("space units").or(header.get("units")).unwrap_or_default();
    let unit = units.split('"').map(str::trim).find(|unit| !unit.is_empty() && *unit != "???" && *unit != "none");
    let stated = unit.and_then(|unit| converted("the unit of space", unit, oddities));
    let unit = stated.map_or(1.0, Unit::millimetres);
    let lengths = |key: &str, default| match header.get(key) {
        None => Ok(None),
        Some(value) => {
            let read = plain_vector(value, axes, default);
            read.map(Some).ok_or_else(|| header.wrong(key, value, &format!("{axes} numbers")))
        }
    };
    let mut spacing = lengths("spacings", 1.0)?;
    let mut directions = None;
    if let Some(value) = header.get("space directions") {
        let words = value.replace(" (", "\n(").replace(" none", "\nnone");
        let read: Option<Vec<Option<DVec3>>> =
            words.lines().map(|word| if word.trim() == "none" { Some(None) } else { vector(word).map(Some) }).collect();
        let read = read.map(|read| read.into_iter().flatten().collect::<Vec<_>>());
        let Some(Ok(read)) = read.map(<[DVec3; 3]>::try_from) else {
            return Err(header.wrong("space directions", value, "three vectors"));
        };
        (spacing, directions) = (Some(DVec3::from_array(read.map(DVec3::length))), Some(read));
    }
    let origin = match header.get("space origin") {
        Some(value) => Some(vector(value).ok_or_else(|| header.wrong("space origin", value, "(x,y,z)"))?),
        None => {
            let key = if header.get("axismins").is_some() { "axismins" } else { "axis mins" };
            let centers = header.get("centers").or(header.get("centerings")).unwrap_or_default();
            // The beginning of the first cell, unless the numbers are at the nodes.
            let half = if centers.to_lowercase().starts_with("node") { 0.0 } else { 0.5 };
            lengths(key, 0.0)?.filter(|_| directions.is_none()).map(|mins| mins + half * spacing.unwrap_or(DVec3::ONE))
        }
    };
    let (spacing, origin) = (spacing.map(|spacing| spacing * unit), origin.map(|origin| origin * unit * signs));
    Ok((spacing, origin, directions.map(|axes| axes.map(|axis| axis * signs)), stated.is_some()))
}

/// The numbers after the header or in other files.
fn place_of_numbers(
    header: &Header<'_>,
    content: &[u8],
    shape: [usize; 3],
    number: Number,
    encoding: &str,
    oddities: &mut Vec<String>,
) -> Result<Numbers> {
    const FILE: &str = "data file";
    let known = match encoding.to_lowercase().as_str() {
        "raw" => Encoding::Raw,
        "gzip" | "gz" => Encoding::Gzip,
        "bzip2" | "bz2" => Encoding::Bzip2,
        "ascii" | "text" | "txt" => Encoding::Text,
        _ => {
            let expected = "raw, gzip, bzip2 or ascii";
            let remedy = "convert it, for example with unu save -f nrrd -e gzip";
            return Err(unsupported(header.path, "encoding", shown(encoding), expected, remedy));
        }
    };
    let big_endian = match header.get("endian") {
        Some("big") => true,
        Some("little") => false,
        None if known == Encoding::Text || matches!(number, Number::U8 | Number::I8) => false,
        None => {
            oddities.push("endian is not stated: little is taken".into());
            false
        }
        Some(other) => return Err(header.wrong("endian", other, "little or big")),
    };
    let source = match header.get(FILE) {
        None => Source::Here(header.end),
        Some(value) => Source::files(header.path, FILE, value, &lossy(&content[header.end..]), shape[2])?,
    };
    let (lines, bytes) = (skip(header, "line skip")?, skip(header, "byte skip")?);
    if lines < 0 || (bytes < 0 && known != Encoding::Raw) {
        let (key, value) = if lines < 0 { ("line skip", lines) } else { ("byte skip", bytes) };
        return Err(header.wrong(key, &value.to_string(), "a number from 0"));
    }
    let skip = Skip { lines: usize::try_from(lines).unwrap_or(usize::MAX), ..Skip::default() };
    // Lines are skipped before unpacking, bytes after it.
    let start = usize::try_from(bytes).map_or(Start::AtEnd, Start::After);
    let layout = Layout { element: Element { number, big_endian }, encoding: known, shape, start };
    Ok(Numbers { source, key: FILE, layout, skip, scale: None })
}

pub(super) fn header(
    path: &Path,
    shape: [usize; 3],
    Place { spacing, origin, directions, in_millimetres }: Place,
) -> Result<Vec<u8>> {
    if path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("nhdr")) {
        return Err(Error::invalid("file to write", path.display(), "one file", "end it with .nrrd"));
    }
    let [x, y, z] = shape;
    let vector = |v: DVec3| format!("({},{},{})", v.x, v.y, v.z);
    let steps = [0, 1, 2].map(|axis| vector(directions.col(axis) * spacing[axis])).join(" ");
    let unit = if in_millimetres { "space units: \"mm\" \"mm\" \"mm\"\n" } else { "" };
    Ok(format!(
        "NRRD0004\ntype: float\ndimension: 3\nspace: left-posterior-superior\nsizes: {x} {y} {z}\n\
         space directions: {steps}\nkinds: domain domain domain\nendian: little\nencoding: raw\n{unit}\
         space origin: {}\n\n",
        vector(origin)
    )
    .into_bytes())
}
