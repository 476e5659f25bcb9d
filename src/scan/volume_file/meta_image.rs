//! MetaImage, ITK's format: a text header, followed by the numbers or naming their files.

use super::detached::{Described, Numbers, Skip, Source};
use super::elements::{Element, Encoding, Layout, Number, Start};
use super::header::{Header, converted, lossy, numbers, shown, three_axes, vector};
use super::{Place, VolumeFile, unsupported};
use crate::unit::Unit;
use glam::DVec3;
use std::path::Path;
use trgs_core::error::{Error, Result};

/// Most axes accepted; all but three have length 1.
const MOST_AXES: usize = 10;

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

/// Fields that are read, or that change neither numbers nor positions.
const KNOWN: &str = "ObjectType ObjectSubType NDims Name ID ParentID Comment AcquisitionDate Color Modality SequenceID \
    ElementMin ElementMax ElementNBits AnatomicalOrientation CenterOfRotation CompressionLevel BinaryData \
    BinaryDataByteOrderMSB ElementByteOrderMSB CompressedData CompressedDataSize TransformMatrix Rotation \
    Orientation Offset Position Origin DistanceUnits ElementSpacing ElementSize DimSize HeaderSize \
    HeaderSizePerSlice ElementNumberOfChannels ElementToIntensityFunctionSlope ElementToIntensityFunctionOffset \
    ElementType ElementDataFile ITK_InputFilterName ITK_original_direction";

fn header_of<'a>(content: &[u8], path: &'a Path) -> Result<Header<'a>> {
    let mut header = Header::begin(content, path, "write it again as a plain 3-D image, for example with ITK");
    while let Some(line) = header.line(content) {
        let Some((key, value)) = line.split_once('=').map(|(key, value)| (key.trim(), value.trim())) else {
            return Err(header.wrong("header", &line, "lines `key = value` that end with ElementDataFile"));
        };
        header.fields.push((key.to_owned(), value.to_owned()));
        if key == "ElementDataFile" {
            return Ok(header);
        }
    }
    Err(header.wrong("header", "its end", "ElementDataFile"))
}

impl Header<'_> {
    /// The first of several names that is there, and a remark if another one differs.
    fn one_of(&self, keys: &[&'static str], oddities: &mut Vec<String>) -> Option<(&'static str, &str)> {
        let mut there = keys.iter().filter_map(|key| Some((*key, self.get(key)?)));
        let first = there.next()?;
        if let Some((other, _)) = there.find(|(_, value)| *value != first.1) {
            oddities.push(format!("{other} differs from {}, which is read", first.0));
        }
        Some(first)
    }

    fn is_true(&self, key: &str) -> bool {
        self.get(key).is_some_and(|value| value.eq_ignore_ascii_case("true") || value == "1")
    }

    fn number<T: std::str::FromStr>(&self, key: &str, expected: &str) -> Result<Option<T>> {
        let parse = |value: &str| value.parse().map_err(|_| self.wrong(key, value, expected));
        self.get(key).map(parse).transpose()
    }
}

/// The volume whose header begins the content.
pub(super) fn describe(content: &[u8], path: &Path) -> Result<Described> {
    let header = header_of(content, path)?;
    let mut oddities = Vec::new();
    let (shape, axes, element) = numbers_of(&header)?;
    let unit = header.get("DistanceUnits").filter(|unit| *unit != "?");
    let stated = unit.and_then(|unit| converted("DistanceUnits", unit, &mut oddities));
    let unit = stated.map_or(1.0, Unit::millimetres);

    let vector_of = |(key, value): (&str, &str), default| {
        vector(value, axes, default).ok_or_else(|| header.wrong(key, value, &format!("{axes} lengths")))
    };
    // A size of elements is their distance where no distance is given.
    let spacing = header.get("ElementSpacing").map(|value| ("ElementSpacing", value));
    let spacing = spacing.or(header.get("ElementSize").map(|value| ("ElementSize", value)));
    let spacing = spacing.map(|found| vector_of(found, 1.0)).transpose()?.map(|spacing| spacing * unit);
    let origin = header.one_of(&["Offset", "Position", "Origin"], &mut oddities);
    let origin = origin.map(|found| vector_of(found, 0.0)).transpose()?.map(|origin| origin * unit);
    let directions = header.one_of(&["TransformMatrix", "Rotation", "Orientation"], &mut oddities);
    let directions = match directions {
        None => None,
        Some((key, value)) => {
            let read: Option<Vec<f64>> = numbers(value).filter(|read: &Vec<f64>| read.len() == axes * axes);
            let read = read.ok_or_else(|| header.wrong(key, value, &format!("{} numbers", axes * axes)))?;
            // One axis after another; an axis that the file lacks is that of the array.
            let entry = |axis: usize, i: usize| match axis < axes && i < axes {
                true => read[axis * axes + i],
                false => f64::from(axis == i),
            };
            Some([0, 1, 2].map(|axis| DVec3::from_array([0, 1, 2].map(|i| entry(axis, i)))))
        }
    };

    let slope: f64 = header.number("ElementToIntensityFunctionSlope", "a number")?.unwrap_or(1.0);
    let offset: f64 = header.number("ElementToIntensityFunctionOffset", "a number")?.unwrap_or(0.0);
    let is_scaled = (slope, offset) != (1.0, 0.0);
    if is_scaled {
        oddities.push(format!("its intensity function {slope}·(stored number) + {offset} is applied; ITK does not"));
    }
    let scale = is_scaled.then_some([slope, offset]);
    let numbers = Numbers { scale, ..place_of_numbers(&header, content, shape, element)? };
    let unknown = header.unknown(|key| KNOWN.split(' ').any(|known| known == key));
    let mut volume = VolumeFile::new(spacing, origin, directions).in_millimetres(stated.is_some());
    volume.oddities.extend(oddities.into_iter().chain(unknown));
    Ok((volume, numbers))
}

/// Shape, number of axes in the file, and type.
fn numbers_of(header: &Header<'_>) -> Result<([usize; 3], usize, Element)> {
    let value = header.get("ElementDataFile").unwrap_or_default();
    let (Some(sides), Some(kind)) = (header.get("DimSize"), header.get("ElementType")) else {
        return Err(header.wrong("ElementDataFile", value, "DimSize and ElementType before it"));
    };
    let axes = header.number("NDims", "a number of axes")?.unwrap_or(3);
    let read = numbers::<usize>(sides).filter(|read| read.len() == axes && axes <= MOST_AXES);
    let read = read.ok_or_else(|| header.wrong("DimSize", sides, &format!("{axes} counts, as NDims states")))?;
    let to_one = "write one volume of one number per voxel, for example with SimpleITK's Extract";
    let shape = three_axes(&read)
        .ok_or_else(|| unsupported(header.path, "DimSize", shown(sides), "at most three axes longer than 1", to_one))?;
    if let Some(channels) = header.get("ElementNumberOfChannels").filter(|channels| *channels != "1") {
        return Err(unsupported(header.path, "ElementNumberOfChannels", shown(channels), "1", to_one));
    }
    let known = TYPES.iter().find(|(name, _)| *name == kind);
    let number = known.ok_or_else(|| header.wrong("ElementType", kind, "a type of one number, such as MET_FLOAT"))?.1;
    let big_endian = ["ElementByteOrderMSB", "BinaryDataByteOrderMSB"].iter().any(|key| header.is_true(key));
    Ok((shape, axes, Element { number, big_endian }))
}

/// The numbers after the header or in other files.
fn place_of_numbers(header: &Header<'_>, content: &[u8], shape: [usize; 3], element: Element) -> Result<Numbers> {
    const FILE: &str = "ElementDataFile";
    let skip: i64 = header.number("HeaderSize", "a number of bytes, or -1")?.unwrap_or(0);
    if let Some(size) = header.get("HeaderSizePerSlice").filter(|size| *size != "0") {
        let remedy = "write one file for each slice, and HeaderSize";
        return Err(unsupported(header.path, "HeaderSizePerSlice", shown(size), "0", remedy));
    }
    let packed: Option<usize> = header.number("CompressedDataSize", "a number of bytes")?;
    let encoding =
        match (header.is_true("CompressedData"), header.get("BinaryData").is_none() || header.is_true("BinaryData")) {
            (true, true) => Encoding::Zlib,
            (false, true) => Encoding::Raw,
            (_, false) => Encoding::Text,
        };
    if skip < -1 || (skip == -1 && encoding != Encoding::Raw) {
        return Err(header.wrong("HeaderSize", &skip.to_string(), "a number of bytes, or -1 for plain numbers"));
    }
    let value = header.get(FILE).unwrap_or_default();
    let is_local = value.eq_ignore_ascii_case("LOCAL");
    let source = if is_local {
        // A stated size counts from the beginning of the file.
        Source::Here(if skip > 0 { 0 } else { header.end })
    } else {
        Source::files(header.path, FILE, value, &lossy(&content[header.end..]), shape[2])?
    };
    let start = if skip == -1 { Start::AtEnd } else { Start::After(0) };
    let packed = packed.filter(|_| encoding == Encoding::Zlib);
    let skip = Skip { bytes: usize::try_from(skip).unwrap_or(0), lines: 0, packed };
    let layout = Layout { element, encoding, shape, start };
    Ok(Numbers { source, key: FILE, layout, skip, scale: None })
}

pub(super) fn header(
    path: &Path,
    shape: [usize; 3],
    Place { spacing, origin, directions, in_millimetres }: Place,
) -> Result<Vec<u8>> {
    if path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("mhd")) {
        return Err(Error::invalid("file to write", path.display(), "one file", "end it with .mha"));
    }
    let [x, y, z] = shape;
    let (s, o) = (spacing, origin);
    let axes = directions.to_cols_array().map(|x| x.to_string()).join(" ");
    let unit = if in_millimetres { "DistanceUnits = mm\n" } else { "" };
    Ok(format!(
        "ObjectType = Image\nNDims = 3\nBinaryData = True\nBinaryDataByteOrderMSB = False\nCompressedData = False\n\
         TransformMatrix = {axes}\nOffset = {} {} {}\n{unit}ElementSpacing = {} {} {}\nDimSize = {x} {y} {z}\n\
         ElementType = MET_FLOAT\nElementDataFile = LOCAL\n",
        o.x, o.y, o.z, s.x, s.y, s.z
    )
    .into_bytes())
}
