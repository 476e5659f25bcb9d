//! DICOM: a series of slices, one or several in a file.
//!
//! Slices are ordered by their position in the patient, never by file name, and become `[x, y, z]` = column, row,
//! slice, with z along the normal of the slices. Values are rescaled by the slope and intercept of the files: CT values
//! are in Hounsfield units. Spacing and origin are in millimetres.
//!
//! A file with several frames (Enhanced CT) states position, orientation, pixel spacing, slope and intercept in the
//! functional groups of each frame, in those that all frames share, or where a file with one slice does: the first of
//! these places counts (DICOM PS3.3, C.7.6.16). Frames without positions of their own, such as the projections of a
//! C-arm, stay in the order of the file.
//!
//! Pixels must be uncompressed; compressed pixels (such as JPEG) are rejected.
//!
//! [`write_slices`](super::write_slices) writes a series.

mod lengths;
mod write;

use super::{VolumeFile, damaged, unsupported};
use crate::limit;
use dicom_core::header::HasLength;
use dicom_object::mem::InMemElement;
use dicom_object::{InMemDicomObject, Tag};
use glam::DVec3;
use lengths::Defect;
use ndarray::Array3;
use std::borrow::Cow;
use std::fmt::Display;
use std::io::Read;
use std::path::{Path, PathBuf};
use trgs_core::error::{Error, Result};

pub(super) use write::write;

/// Allowed relative deviation of a slice distance from the usual one: positions have few digits.
const UNEVEN: f64 = 0.01;
/// Allowed difference between unit vectors.
const TURNED: f64 = 1e-3;
/// Characters of a transfer syntax that a message shows: identifiers have at most 64.
const LONGEST_SYNTAX: usize = 64;

const MODALITY: Tag = Tag(0x0008, 0x0060);
const SLICE_THICKNESS: Tag = Tag(0x0018, 0x0050);
const SERIES: Tag = Tag(0x0020, 0x000E);
const POSITION: Tag = Tag(0x0020, 0x0032);
const ORIENTATION: Tag = Tag(0x0020, 0x0037);
const PHOTOMETRIC: Tag = Tag(0x0028, 0x0004);
const SAMPLES: Tag = Tag(0x0028, 0x0002);
const FRAMES: Tag = Tag(0x0028, 0x0008);
const ROWS: Tag = Tag(0x0028, 0x0010);
const COLUMNS: Tag = Tag(0x0028, 0x0011);
const PIXEL_SPACING: Tag = Tag(0x0028, 0x0030);
const BITS_ALLOCATED: Tag = Tag(0x0028, 0x0100);
const BITS_STORED: Tag = Tag(0x0028, 0x0101);
const HIGH_BIT: Tag = Tag(0x0028, 0x0102);
const IS_SIGNED: Tag = Tag(0x0028, 0x0103);
const INTERCEPT: Tag = Tag(0x0028, 0x1052);
const SLOPE: Tag = Tag(0x0028, 0x1053);
const PIXELS: Tag = Tag(0x7FE0, 0x0010);
const SLICE_DISTANCE: Tag = Tag(0x0018, 0x0088);
/// Pixel size on the detector, which projections state instead of the one in the patient.
const IMAGER_PIXEL_SPACING: Tag = Tag(0x0018, 0x1164);
const FRAME_OFFSETS: Tag = Tag(0x3004, 0x000C);
const SHARED_GROUPS: Tag = Tag(0x5200, 0x9229);
const GROUPS_OF_FRAMES: Tag = Tag(0x5200, 0x9230);
/// The functional groups that are read: plane position, plane orientation, pixel measures, pixel value transformation.
const GROUPS: [Tag; 4] = [Tag(0x0020, 0x9113), Tag(0x0020, 0x9116), Tag(0x0028, 0x9110), Tag(0x0028, 0x9145)];

/// Whether a file begins like a DICOM file.
pub(super) fn is_dicom(path: &Path) -> bool {
    let mut head = Vec::new();
    let read = crate::input::open(path).and_then(|file| file.take(132).read_to_end(&mut head));
    read.is_ok() && head.get(128..) == Some(lengths::MARK)
}

/// Reads the slices `files` of `folder`, given in any order.
pub(super) fn read(folder: &Path, files: &[PathBuf]) -> Result<VolumeFile> {
    let mut slices = Vec::new();
    for path in files {
        let content = crate::input::read(path).map_err(|source| Error::read(path, source))?;
        match File::parse(&content, path)? {
            File::Slices(found) => {
                slices.extend(found);
                // The slices, and the volume that is made of them.
                let pixels: usize = slices.iter().map(|slice: &Slice| slice.values.len()).sum();
                limit::allow("series", 2 * 4 * pixels as u64).map_err(|error| error.in_file(folder))?;
            }
            File::Stack(stack) if files.len() == 1 => return Ok(*stack),
            File::Stack(_) => {
                let got = "several frames without positions, beside other files";
                let remedy = "give the path of this file instead of the folder";
                return Err(Error::format(path, "file of a series", got, "slices with positions", remedy));
            }
        }
    }
    assemble(slices, folder)
}

/// Reads a volume from the content of its only file.
pub(super) fn parse(content: &[u8], path: &Path) -> Result<VolumeFile> {
    match File::parse(content, path)? {
        File::Slices(slices) => assemble(slices, path),
        File::Stack(stack) => Ok(*stack),
    }
}

/// The content of a file.
enum File {
    /// Slices with positions.
    Slices(Vec<Slice>),
    /// Frames without positions, in the order of the file.
    Stack(Box<VolumeFile>),
}

impl File {
    fn parse(content: &[u8], path: &Path) -> Result<Self> {
        let content = &*lengths::with_group_length(content);
        lengths::check(content).map_err(|defect| match defect {
            Defect::Damage(found) => damaged(path, &found),
            Defect::Syntax(syntax) => {
                let remedy = "convert the series, for example with gdcmconv -w IN OUT or dcmdjpeg IN OUT";
                let got = format!("{:?}", syntax.chars().take(LONGEST_SYNTAX).collect::<String>());
                unsupported(path, "transfer syntax", got, "plain little-endian pixels", remedy)
            }
        })?;
        let object = dicom_object::from_reader(content).map_err(|error| damaged(path, &error.to_string()))?;
        let fields = Fields { objects: vec![&object], own: 0, frame: None, path };
        if fields.vector(SAMPLES, "samples per pixel")? != [1.0] {
            let remedy = "give files with one number per pixel";
            return Err(Error::format(path, "samples per pixel", "several", "1: grey values", remedy));
        }
        let count = match fields.numbers(FRAMES)? {
            Some(_) => fields.count(FRAMES, "number of frames")?,
            None => 1,
        };
        let pixels = Pixels::of(&fields, count)?;
        let frames = Fields::of_frames(&object, count, path)?;
        if count > 1 && !frames.iter().any(Fields::has_own_position) {
            return stack(&fields, &frames, &pixels).map(|stack| Self::Stack(Box::new(stack)));
        }
        frames.iter().map(|frame| Slice::of(frame, &pixels)).collect::<Result<Vec<_>>>().map(Self::Slices)
    }
}

/// One slice.
struct Slice {
    path: PathBuf,
    /// Its number in the file, from 1; `None` if it is alone.
    frame: Option<usize>,
    series: String,
    modality: String,
    /// Rows and columns.
    shape: (usize, usize),
    /// Distance between rows, then between columns, in millimetres.
    pitch: [f64; 2],
    /// Centre of the first pixel, millimetres.
    position: DVec3,
    /// Unit vectors along a row and down a column.
    axes: [DVec3; 2],
    thickness: Option<f64>,
    is_inverted: bool,
    values: Vec<f32>,
}

impl Slice {
    fn of(fields: &Fields<'_>, pixels: &Pixels<'_>) -> Result<Self> {
        let pitch = fields.pitch(PIXEL_SPACING)?;
        if fields.frame.is_some() && !fields.has_own_position() {
            return Err(fields.wrong("image position (patient)", "nothing", "numbers, as other frames have"));
        }
        let position = DVec3::from_array(fields.vector(POSITION, "image position (patient)")?);
        let [a, b, c, d, e, f] = fields.vector(ORIENTATION, "image orientation (patient)")?;
        let axes = [DVec3::new(a, b, c), DVec3::new(d, e, f)];
        let is_frame =
            axes.iter().all(|axis| (axis.length() - 1.0).abs() < TURNED) && axes[0].dot(axes[1]).abs() < TURNED;
        if !is_frame {
            let expected = "two perpendicular unit vectors";
            return Err(fields.wrong("image orientation (patient)", format!("{axes:?}"), expected));
        }
        Ok(Self {
            path: fields.path.into(),
            frame: fields.frame.map(|frame| frame + 1),
            series: fields.text(SERIES)?,
            modality: fields.text(MODALITY)?,
            shape: pixels.shape,
            pitch,
            position,
            axes,
            thickness: fields.optional(SLICE_THICKNESS)?,
            is_inverted: pixels.is_inverted,
            values: pixels.values(fields)?,
        })
    }

    /// File, and frame if there are several.
    fn name(&self) -> String {
        let path = self.path.display();
        self.frame.map_or_else(|| path.to_string(), |frame| format!("frame {frame} of {path}"))
    }
}

/// Access to fields as numbers.
struct Fields<'a> {
    /// Where a field is looked for, in this order.
    objects: Vec<&'a InMemDicomObject>,
    /// How many of them belong to the frame alone.
    own: usize,
    /// Number of the frame, from 0, of a file with several.
    frame: Option<usize>,
    path: &'a Path,
}

impl<'a> Fields<'a> {
    /// The fields of each of `count` frames.
    fn of_frames(root: &'a InMemDicomObject, count: usize, path: &'a Path) -> Result<Vec<Self>> {
        let items = |tag: Tag| root.get(tag).and_then(|element| element.items()).unwrap_or_default();
        let groups = |item: &'a InMemDicomObject| {
            let first = |tag: &Tag| item.get(*tag).and_then(|element| element.items()?.first());
            GROUPS.iter().filter_map(first).collect::<Vec<_>>()
        };
        let (of_frames, shared) =
            (items(GROUPS_OF_FRAMES), items(SHARED_GROUPS).first().map(groups).unwrap_or_default());
        if !of_frames.is_empty() && of_frames.len() != count {
            let expected = format!("{count}, the number of frames");
            let remedy = "export the file again";
            return Err(Error::format(path, "functional groups of frames", of_frames.len(), expected, remedy));
        }
        let fields = |frame: usize| {
            let mut objects = of_frames.get(frame).map(groups).unwrap_or_default();
            let own = objects.len();
            objects.extend(&shared);
            objects.push(root);
            Self { objects, own, frame: (count > 1).then_some(frame), path }
        };
        Ok((0..count).map(fields).collect())
    }

    fn get(&self, tag: Tag) -> Option<&'a InMemElement> {
        self.objects.iter().find_map(|object| object.get(tag).filter(|element| !element.is_empty()))
    }

    /// Whether the frame has a position that is not that of all frames.
    fn has_own_position(&self) -> bool {
        self.objects[..self.own].iter().any(|object| object.get(POSITION).is_some())
    }

    fn wrong(&self, what: impl Display, got: impl Display, expected: &str) -> Error {
        let what = self.frame.map_or_else(|| what.to_string(), |frame| format!("frame {}: {what}", frame + 1));
        Error::format(self.path, what, got, expected, "export the series again as uncompressed grey slices")
    }

    /// Distance between rows, then between columns.
    fn pitch(&self, tag: Tag) -> Result<[f64; 2]> {
        let [v, u] = self.vector(tag, "pixel spacing")?;
        if v > 0.0 && u > 0.0 {
            Ok([v, u])
        } else {
            Err(self.wrong("pixel spacing", format!("{v}, {u}"), "two lengths"))
        }
    }

    fn numbers(&self, tag: Tag) -> Result<Option<Vec<f64>>> {
        let Some(element) = self.get(tag) else { return Ok(None) };
        let numbers = element.to_multi_float64().map_err(|error| self.wrong(tag, error, "numbers"))?;
        match numbers.iter().find(|number| !number.is_finite()) {
            Some(number) => Err(self.wrong(tag, number, "finite numbers")),
            None => Ok(Some(numbers)),
        }
    }

    fn vector<const N: usize>(&self, tag: Tag, name: &str) -> Result<[f64; N]> {
        let numbers = self.numbers(tag)?.ok_or_else(|| self.wrong(name, "nothing", "numbers"))?;
        let expected = format!("{N} numbers");
        numbers
            .try_into()
            .map_err(|numbers: Vec<f64>| self.wrong(name, format!("{} numbers", numbers.len()), &expected))
    }

    fn optional(&self, tag: Tag) -> Result<Option<f64>> {
        Ok(self.numbers(tag)?.and_then(|numbers| numbers.first().copied()))
    }

    fn count(&self, tag: Tag, name: &str) -> Result<usize> {
        let [number] = self.vector(tag, name)?;
        match number.fract() == 0.0 && (1.0..=65_535.0).contains(&number) {
            true => Ok(number as usize),
            false => Err(self.wrong(name, number, "a whole number from 1 to 65535")),
        }
    }

    fn text(&self, tag: Tag) -> Result<String> {
        let text = self.get(tag).map(|element| element.to_str().map(|text| text.trim().to_owned()));
        text.unwrap_or_else(|| Ok(String::new())).map_err(|error| self.wrong(tag, error, "a text"))
    }
}

/// The stored numbers of all frames of a file.
struct Pixels<'a> {
    /// Rows and columns.
    shape: (usize, usize),
    /// Bits of a number: 8 or 16.
    bits: usize,
    /// How many of them are its value.
    stored: usize,
    /// The highest of those.
    high: usize,
    is_signed: bool,
    /// Whether the file states that the lowest number is white.
    is_inverted: bool,
    bytes: Cow<'a, [u8]>,
}

impl<'a> Pixels<'a> {
    fn of(fields: &Fields<'a>, frames: usize) -> Result<Self> {
        let shape = (fields.count(ROWS, "rows")?, fields.count(COLUMNS, "columns")?);
        let bits = fields.count(BITS_ALLOCATED, "bits allocated")?;
        let stored = fields.optional(BITS_STORED)?.map_or(bits, |stored| stored as usize);
        let high = fields.optional(HIGH_BIT)?.map_or(stored.wrapping_sub(1), |high| high as usize);
        if !(bits == 8 || bits == 16) || stored == 0 || stored > high + 1 || high >= bits {
            let got = format!("{stored} bits up to bit {high} of {bits}");
            return Err(fields.wrong("bits of a pixel", got, "8 or 16, with the stored ones among them"));
        }
        let is_signed = fields.optional(IS_SIGNED)?.is_some_and(|signed| signed == 1.0);
        let bytes = fields.get(PIXELS).and_then(|element| element.to_bytes().ok());
        let bytes =
            bytes.ok_or_else(|| fields.wrong("pixel data", "no uncompressed pixels", "uncompressed numbers"))?;
        let count = frames * shape.0 * shape.1;
        if bytes.len() >= count * bits / 8 {
            limit::allow("pixel data", 2 * 4 * count as u64).map_err(|error| error.in_file(fields.path))?;
        } else {
            let got = format!("{} bytes", bytes.len());
            return Err(fields.wrong("pixel data", got, &format!("{count} numbers of {bits} bits")));
        }
        let is_inverted = fields.text(PHOTOMETRIC)? == "MONOCHROME1";
        Ok(Self { shape, bits, stored, high, is_signed, is_inverted, bytes })
    }

    /// The rescaled values of a frame, row by row.
    fn values(&self, fields: &Fields<'_>) -> Result<Vec<f32>> {
        let (slope, intercept) = (fields.optional(SLOPE)?.unwrap_or(1.0), fields.optional(INTERCEPT)?.unwrap_or(0.0));
        let value = |word: u16| {
            // The stored bits are moved to the upper end, so that the shift back extends the sign.
            let (upper, down) = (word << (15 - self.high), 16 - self.stored);
            let number = if self.is_signed { f64::from(upper.cast_signed() >> down) } else { f64::from(upper >> down) };
            (number * slope + intercept) as f32
        };
        let size = self.shape.0 * self.shape.1 * self.bits / 8;
        let bytes = &self.bytes[fields.frame.unwrap_or(0) * size..][..size];
        Ok(match self.bits {
            8 => bytes.iter().map(|&byte| value(byte.into())).collect(),
            // The library has converted the words to the byte order of this machine.
            _ => bytes.as_chunks().0.iter().map(|&word| value(u16::from_ne_bytes(word))).collect(),
        })
    }
}

/// What is remarked on values of a computed tomography.
const HOUNSFIELD: &str = "values are Hounsfield units, not attenuation: air is -1000";

/// What is remarked on numbers of which the lowest is white. ITK subtracts them from the largest number instead.
const INVERTED: &str = "it states MONOCHROME1, that the lowest number is white; its numbers are read as stored, while ITK \
                        and programs built on it invert them";

/// Frames without positions, in the order of the file.
fn stack(fields: &Fields<'_>, frames: &[Fields<'_>], pixels: &Pixels<'_>) -> Result<VolumeFile> {
    if fields.get(FRAME_OFFSETS).is_some() {
        let remedy = "convert it to .nii.gz or .mha, for example with 3D Slicer";
        let expected = "positions in the functional groups of frames";
        return Err(unsupported(fields.path, "positions of frames", "a grid frame offset vector", expected, remedy));
    }
    let first = &frames[0];
    let tag = [PIXEL_SPACING, IMAGER_PIXEL_SPACING].into_iter().find(|&tag| first.get(tag).is_some());
    let distance = first.optional(SLICE_DISTANCE)?.or(first.optional(SLICE_THICKNESS)?).map(f64::abs);
    let distance = distance.filter(|distance| *distance > 0.0);
    let spacing = tag.map(|tag| first.pitch(tag)).transpose()?.map(|[v, u]| DVec3::new(u, v, distance.unwrap_or(1.0)));
    let mut values = Vec::new();
    for frame in frames {
        values.extend(pixels.values(frame)?);
    }
    let (rows, columns) = pixels.shape;
    let values = Array3::from_shape_vec((frames.len(), rows, columns), values).expect("every frame has this shape");
    let mut volume = VolumeFile::new(spacing, None, None).in_millimetres(spacing.is_some());
    volume.values = values.reversed_axes();
    let apart = if spacing.is_some() && distance.is_none() { ", 1 mm apart" } else { "" };
    volume.oddities.push(format!(
        "its {} frames have no positions of their own: they are read in the order of the file{apart}",
        frames.len()
    ));
    if fields.text(MODALITY)? == "CT" {
        volume.oddities.push(HOUNSFIELD.into());
    }
    if pixels.is_inverted {
        volume.oddities.push(INVERTED.into());
    }
    Ok(volume)
}

/// Orders the slices of one series and stacks them.
fn assemble(mut slices: Vec<Slice>, folder: &Path) -> Result<VolumeFile> {
    let first = slices.first().ok_or_else(|| damaged(folder, "no slice"))?;
    let wrong = |slice: &Slice, what: &str, got: String, expected: String| {
        let what = slice.frame.map_or_else(|| what.to_owned(), |frame| format!("frame {frame}: {what}"));
        Error::format(&slice.path, what, got, expected, "give a folder that holds only the slices of one series")
    };
    let normal = first.axes[0].cross(first.axes[1]);
    for slice in &slices {
        if slice.series != first.series {
            let expected = format!("{} as in {}", first.series, first.name());
            return Err(wrong(slice, "series", slice.series.clone(), expected));
        }
        let turned = |(a, b): (&DVec3, &DVec3)| (*a - *b).length() > TURNED;
        if slice.shape != first.shape || slice.pitch != first.pitch || slice.axes.iter().zip(&first.axes).any(turned) {
            let of = |slice: &Slice| format!("{:?} pixels of {:?} along {:?}", slice.shape, slice.pitch, slice.axes);
            return Err(wrong(slice, "slice", of(slice), format!("{} as in {}", of(first), first.name())));
        }
    }
    slices.sort_by(|a, b| a.position.dot(normal).total_cmp(&b.position.dot(normal)));
    let distance = |pair: &[Slice]| (pair[1].position - pair[0].position).dot(normal);
    let (first, last) = (&slices[0], &slices[slices.len() - 1]);
    let mut oddities = Vec::new();
    let gap = match slices.len() {
        1 => first.thickness.filter(|thickness| *thickness > 0.0).unwrap_or(1.0),
        n => (last.position - first.position).dot(normal) / (n - 1) as f64,
    };
    // The median gap; a missing slice would shift the mean.
    let mut gaps: Vec<f64> = slices.windows(2).map(distance).collect();
    gaps.sort_by(f64::total_cmp);
    let usual = gaps.get(gaps.len() / 2).copied().unwrap_or(gap);
    let is_odd = |pair: &&[Slice]| usual <= 0.0 || (distance(pair) - usual).abs() > UNEVEN * usual;
    if let Some(pair) = slices.windows(2).find(is_odd) {
        let got = format!("{} behind {}", distance(pair), pair[0].name());
        return Err(wrong(
            &pair[1],
            "distance of slices",
            got,
            format!("{usual} as elsewhere: slices are missing or duplicated"),
        ));
    }
    let sideways = (last.position - first.position) - normal * gap * (slices.len() - 1) as f64;
    if sideways.length() > UNEVEN * gap * slices.len() as f64 {
        oddities.push(format!("slices are shifted sideways by {} mm in all: the volume is sheared", sideways.length()));
    }
    if first.modality == "CT" {
        oddities.push(HOUNSFIELD.into());
    }
    if slices.iter().any(|slice| slice.is_inverted) {
        oddities.push(INVERTED.into());
    }
    let [pitch_v, pitch_u] = first.pitch;
    let (spacing, origin) = (DVec3::new(pitch_u, pitch_v, gap), first.position);
    let axes = [first.axes[0], first.axes[1], normal];
    let (rows, columns) = first.shape;
    let count = slices.len();
    let values = slices.into_iter().flat_map(|slice| slice.values).collect();
    let values =
        Array3::from_shape_vec((count, rows, columns), values).expect("every slice has the shape of the first");
    let mut volume = VolumeFile::new(Some(spacing), Some(origin), Some(axes)).in_millimetres(true);
    volume.values = values.reversed_axes();
    volume.oddities.extend(oddities);
    Ok(volume)
}

#[cfg(test)]
mod tests;
