//! DICOM: a series of slices, one file each.
//!
//! Slices are ordered by their position in the patient, never by file name, and become `[x, y, z]` = column, row,
//! slice, with z along the normal of the slices. Values are rescaled by the slope and intercept of the files: CT values
//! are in Hounsfield units. Spacing and origin are in millimetres.
//!
//! Pixels must be uncompressed; compressed pixels (such as JPEG) are rejected.

mod lengths;

use super::{VolumeFile, damaged, unsupported};
use crate::error::{Error, Result};
use dicom_core::header::HasLength;
use dicom_object::{DefaultDicomObject, Tag};
use glam::DVec3;
use lengths::Defect;
use ndarray::Array3;
use std::fmt::Display;
use std::io::Read;
use std::path::{Path, PathBuf};

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

/// Whether a file begins like a DICOM file.
pub(super) fn is_dicom(path: &Path) -> bool {
    let mut head = Vec::new();
    let read = std::fs::File::open(path).and_then(|file| file.take(132).read_to_end(&mut head));
    read.is_ok() && head.get(128..) == Some(lengths::MARK)
}

/// Reads the slices `files` of `folder`, given in any order.
pub(super) fn read(folder: &Path, files: &[PathBuf]) -> Result<VolumeFile> {
    let slice = |path: &PathBuf| {
        let content = std::fs::read(path).map_err(|source| Error::read(path, source))?;
        Slice::parse(&content, path)
    };
    let slices = files.iter().map(slice).collect::<Result<Vec<_>>>()?;
    assemble(slices, folder)
}

/// Reads a single-slice volume from the content of its file.
pub(super) fn parse(content: &[u8], path: &Path) -> Result<VolumeFile> {
    assemble(vec![Slice::parse(content, path)?], path)
}

/// One slice, from one file.
struct Slice {
    path: PathBuf,
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
    values: Vec<f32>,
}

impl Slice {
    fn parse(content: &[u8], path: &Path) -> Result<Self> {
        lengths::check(content).map_err(|defect| match defect {
            Defect::Damage(found) => damaged(path, &found),
            Defect::Syntax(syntax) => {
                let remedy = "convert the series, for example with gdcmconv -w IN OUT or dcmdjpeg IN OUT";
                let got = format!("{:?}", syntax.chars().take(LONGEST_SYNTAX).collect::<String>());
                unsupported(path, "transfer syntax", got, "plain little-endian pixels", remedy)
            }
        })?;
        let object = dicom_object::from_reader(content).map_err(|error| damaged(path, &error.to_string()))?;
        let wrong = |what: &str, got: &dyn Display, expected: &str| {
            let remedy = "give a series with one slice per file and one number per pixel";
            Error::format(path, what, got, expected, remedy)
        };
        let fields = Fields { object: &object, path };
        if fields.optional(FRAMES)?.is_some_and(|frames: f64| frames != 1.0) {
            let remedy = "write one file for each slice, for example with emf2sf of dcm4che";
            return Err(unsupported(path, "number of frames", "several frames in one file", "1", remedy));
        }
        if fields.vector(SAMPLES, "samples per pixel")? != [1.0] {
            return Err(wrong("samples per pixel", &"several", "1: grey values"));
        }
        let [rows, columns] = [fields.count(ROWS, "rows")?, fields.count(COLUMNS, "columns")?];
        let [pitch_v, pitch_u] = fields.vector(PIXEL_SPACING, "pixel spacing")?;
        let position = DVec3::from_array(fields.vector(POSITION, "image position (patient)")?);
        let [a, b, c, d, e, f] = fields.vector(ORIENTATION, "image orientation (patient)")?;
        let axes = [DVec3::new(a, b, c), DVec3::new(d, e, f)];
        let is_frame =
            axes.iter().all(|axis| (axis.length() - 1.0).abs() < TURNED) && axes[0].dot(axes[1]).abs() < TURNED;
        if !is_frame {
            return Err(wrong("image orientation (patient)", &format!("{axes:?}"), "two perpendicular unit vectors"));
        }
        if !(pitch_u > 0.0 && pitch_v > 0.0) {
            return Err(wrong("pixel spacing", &format!("{pitch_v}, {pitch_u}"), "two lengths"));
        }
        let values = pixels(&fields, rows * columns)?;
        Ok(Self {
            path: path.into(),
            series: fields.text(SERIES)?,
            modality: fields.text(MODALITY)?,
            shape: (rows, columns),
            pitch: [pitch_v, pitch_u],
            position,
            axes,
            thickness: fields.optional(SLICE_THICKNESS)?,
            values,
        })
    }
}

/// Access to the fields of a file as numbers.
struct Fields<'a> {
    object: &'a DefaultDicomObject,
    path: &'a Path,
}

impl Fields<'_> {
    fn wrong(&self, what: impl Display, got: impl Display, expected: &str) -> Error {
        Error::format(self.path, what, got, expected, "export the series again as uncompressed grey slices")
    }

    fn numbers(&self, tag: Tag) -> Result<Option<Vec<f64>>> {
        let Some(element) = self.object.get(tag).filter(|element| !element.is_empty()) else { return Ok(None) };
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
        let text = self.object.get(tag).map(|element| element.to_str().map(|text| text.trim().to_owned()));
        text.unwrap_or_else(|| Ok(String::new())).map_err(|error| self.wrong(tag, error, "a text"))
    }
}

/// The rescaled values of a slice, row by row.
fn pixels(fields: &Fields<'_>, count: usize) -> Result<Vec<f32>> {
    let bits = fields.count(BITS_ALLOCATED, "bits allocated")?;
    let stored = fields.optional(BITS_STORED)?.map_or(bits, |stored| stored as usize);
    let high = fields.optional(HIGH_BIT)?.map_or(stored.wrapping_sub(1), |high| high as usize);
    if !(bits == 8 || bits == 16) || stored == 0 || stored > high + 1 || high >= bits {
        let got = format!("{stored} bits up to bit {high} of {bits}");
        return Err(fields.wrong("bits of a pixel", got, "8 or 16, with the stored ones among them"));
    }
    let is_signed = fields.optional(IS_SIGNED)?.is_some_and(|signed| signed == 1.0);
    let (slope, intercept) = (fields.optional(SLOPE)?.unwrap_or(1.0), fields.optional(INTERCEPT)?.unwrap_or(0.0));
    let bytes = fields.object.get(PIXELS).and_then(|element| element.to_bytes().ok());
    let bytes = bytes.ok_or_else(|| fields.wrong("pixel data", "no uncompressed pixels", "uncompressed numbers"))?;
    if bytes.len() < count * bits / 8 {
        let got = format!("{} bytes", bytes.len());
        return Err(fields.wrong("pixel data", got, &format!("{count} numbers of {bits} bits")));
    }
    let value = |word: u16| {
        // The stored bits are moved to the upper end, so that the shift back extends the sign.
        let upper = word << (15 - high);
        let number =
            if is_signed { f64::from(upper.cast_signed() >> (16 - stored)) } else { f64::from(upper >> (16 - stored)) };
        (number * slope + intercept) as f32
    };
    Ok(match bits {
        8 => bytes[..count].iter().map(|&byte| value(byte.into())).collect(),
        // The library has converted the words to the byte order of this machine.
        _ => bytes.as_chunks().0[..count].iter().map(|&word| value(u16::from_ne_bytes(word))).collect(),
    })
}

/// Orders the slices of one series and stacks them.
fn assemble(mut slices: Vec<Slice>, folder: &Path) -> Result<VolumeFile> {
    let first = slices.first().ok_or_else(|| damaged(folder, "no slice"))?;
    let wrong = |slice: &Slice, what: &str, got: String, expected: String| {
        Error::format(&slice.path, what, got, expected, "give a folder that holds only the slices of one series")
    };
    let normal = first.axes[0].cross(first.axes[1]);
    for slice in &slices {
        if slice.series != first.series {
            let expected = format!("{} as in {}", first.series, first.path.display());
            return Err(wrong(slice, "series", slice.series.clone(), expected));
        }
        let turned = |(a, b): (&DVec3, &DVec3)| (*a - *b).length() > TURNED;
        if slice.shape != first.shape || slice.pitch != first.pitch || slice.axes.iter().zip(&first.axes).any(turned) {
            let of = |slice: &Slice| format!("{:?} pixels of {:?} along {:?}", slice.shape, slice.pitch, slice.axes);
            return Err(wrong(slice, "slice", of(slice), format!("{} as in {}", of(first), first.path.display())));
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
        let got = format!("{} behind {}", distance(pair), pair[0].path.display());
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
        oddities.push("values are Hounsfield units, not attenuation: air is -1000".into());
    }
    let [pitch_v, pitch_u] = first.pitch;
    let (spacing, origin) = (DVec3::new(pitch_u, pitch_v, gap), first.position);
    let axes = [first.axes[0], first.axes[1], normal];
    let (rows, columns) = first.shape;
    let count = slices.len();
    let values = slices.into_iter().flat_map(|slice| slice.values).collect();
    let values =
        Array3::from_shape_vec((count, rows, columns), values).expect("every slice has the shape of the first");
    let mut volume = VolumeFile::new(values.reversed_axes(), Some(spacing), Some(origin), Some(axes));
    volume.oddities.extend(oddities);
    Ok(volume)
}

#[cfg(test)]
mod tests;
