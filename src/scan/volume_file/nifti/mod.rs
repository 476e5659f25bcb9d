//! NIfTI-1 and NIfTI-2, with or without gzip.
//!
//! Lengths are converted to millimetres from the unit that the header states. The position of the volume is that of the
//! matrix (sform), else that of the quaternion (qform).

mod header;

use super::detached::{Described, Numbers};
use super::elements::{Element, Encoding, Layout, MOST_INFLATION, Number, Start, unpack};
use super::header::three_axes;
use super::{Place, RAS, VolumeFile, damaged, unsupported};
use flate2::read::MultiGzDecoder;
use glam::{DMat3, DQuat, DVec3};
use header::{Header, SMALLEST_OFFSET};
use std::path::Path;
use trgs_core::error::{Error, Result};

/// NIfTI's code for a transformation to the coordinates of the scanner.
const SCANNER: i16 = 1;
/// The bits of a header's units that are for lengths; the others are for time.
const LENGTHS: i64 = 7;
/// NIfTI's code for millimetres.
const MILLIMETRES: u8 = 2;
/// Relative difference of two spacings from which on they disagree: they are stored in single precision.
const DIFFERS: f64 = 1e-3;
/// Remedy for content that is not one volume of one number per voxel.
const TO_PLAIN: &str = "write one volume of one number per voxel, for example with nibabel";

/// The types with one number per voxel.
const TYPES: [(i64, Number, usize); 10] = [
    (2, Number::U8, 1),
    (4, Number::I16, 2),
    (8, Number::I32, 4),
    (16, Number::F32, 4),
    (64, Number::F64, 8),
    (256, Number::I8, 1),
    (512, Number::U16, 2),
    (768, Number::U32, 4),
    (1024, Number::I64, 8),
    (1280, Number::U64, 8),
];
/// The names of other types.
const OTHER_TYPES: [(i64, &str); 7] = [
    (1, "bits"),
    (32, "complex numbers"),
    (128, "colours"),
    (1536, "numbers of 128 bits"),
    (1792, "complex numbers"),
    (2048, "complex numbers"),
    (2304, "colours"),
];

/// The volume in a file of `length` bytes, whose content or beginning is given.
pub(super) fn describe(content: &[u8], length: usize, path: &Path) -> Result<Described> {
    let is_packed = content.starts_with(&[0x1f, 0x8b]);
    let broken = |found: &str| damaged(path, found);
    let head = match is_packed {
        true => unpack(MultiGzDecoder::new(content), SMALLEST_OFFSET[1]).map_err(|found| broken(&found))?,
        false => content[..SMALLEST_OFFSET[1].min(content.len())].into(),
    };
    let header = Header::parse(&head).map_err(|found| broken(&found))?;
    if !header.is_single {
        let remedy = "write it as one file .nii, for example with nibabel";
        return Err(unsupported(path, "NIfTI", "numbers in another file (.img), or Analyze 7.5", "one file", remedy));
    }
    let mut oddities = Vec::new();
    let shape = shape(&header, path)?;
    let Some((_, number, bytes)) = TYPES.iter().find(|(code, ..)| *code == header.datatype) else {
        return Err(match OTHER_TYPES.iter().find(|(code, _)| *code == header.datatype) {
            Some((_, name)) => unsupported(path, "datatype", name, "one number per voxel", TO_PLAIN),
            None => broken(&format!("datatype {}", header.datatype)),
        });
    };
    let start = start(&header, &mut oddities).ok_or_else(|| broken(&format!("vox_offset {}", header.vox_offset)))?;
    let element = Element { number: *number, big_endian: header.big_endian };
    let size = shape.iter().try_fold(*bytes, |product, &n| product.checked_mul(n)).unwrap_or(usize::MAX);
    let most = if is_packed { length.saturating_mul(MOST_INFLATION) } else { length };
    if start.saturating_add(size) > most {
        return Err(broken(&format!("{length} bytes for shape {shape:?} of {bytes} bytes each")));
    }
    let encoding = if is_packed { Encoding::Gzip } else { Encoding::Raw };
    let layout = Layout { element, encoding, shape, start: Start::After(start) };
    let numbers = Numbers { scale: scale(&header, &mut oddities), ..Numbers::here(0, layout) };
    if header.intent != 0 {
        oddities.push(format!("intent code {}: its numbers may not be attenuation", header.intent));
    }
    let (spacing, origin, axes) = place(&header, &mut oddities);
    let in_millimetres = (1..=3).contains(&(header.units & LENGTHS));
    let mut volume = VolumeFile::new(Some(spacing), origin, axes).in_millimetres(in_millimetres);
    volume.oddities.extend(oddities);
    Ok((volume, numbers))
}

fn shape(header: &Header, path: &Path) -> Result<[usize; 3]> {
    let count = usize::try_from(header.dim[0]).ok().filter(|count| (1..=7).contains(count));
    let sides = count.map(|count| header.dim[1..=count].iter().map(|&n| usize::try_from(n).ok().filter(|&n| n > 0)));
    let sides: Option<Vec<usize>> = sides.and_then(Iterator::collect);
    let sides = sides.ok_or_else(|| damaged(path, &format!("dim {:?}", header.dim)))?;
    let expected = "at most three axes longer than 1";
    three_axes(&sides).ok_or_else(|| unsupported(path, "shape", format!("{sides:?}"), expected, TO_PLAIN))
}

/// Position of the first number.
fn start(header: &Header, oddities: &mut Vec<String>) -> Option<usize> {
    let smallest = SMALLEST_OFFSET[usize::from(header.is_second)];
    let stated = header.vox_offset;
    if !(0.0..=1e15).contains(&stated) || stated.fract() != 0.0 {
        return None;
    }
    if (stated as usize) < smallest {
        oddities.push(format!("vox_offset {stated} is within the header; numbers are read from {smallest} on"));
    }
    Some((stated as usize).max(smallest))
}

/// Slope and offset of the values, if they are not the stored numbers.
fn scale(header: &Header, oddities: &mut Vec<String>) -> Option<[f64; 2]> {
    let (slope, intercept) = (header.slope, header.intercept);
    let is_scaled = slope != 0.0 && slope.is_finite() && intercept.is_finite();
    if !is_scaled && (!slope.is_finite() || !intercept.is_finite() || intercept != 0.0) {
        oddities.push(format!("scl_slope {slope} and scl_inter {intercept} are not applied: numbers are as stored"));
    }
    is_scaled.then_some([slope, intercept])
}

/// Spacing, centre of the first voxel and axes in ITK's coordinates, in millimetres.
fn place(header: &Header, oddities: &mut Vec<String>) -> (DVec3, Option<DVec3>, Option<[DVec3; 3]>) {
    let unit = match header.units & LENGTHS {
        0 | 2 => 1.0,
        1 => {
            oddities.push("its unit is metres: lengths are converted to millimetres".into());
            1000.0
        }
        3 => {
            oddities.push("its unit is micrometres: lengths are converted to millimetres".into());
            1e-3
        }
        other => {
            oddities.push(format!("its unit of length has the unknown code {other}: lengths are kept"));
            1.0
        }
    };
    let [_, x, y, z, ..] = header.pixdim;
    let stated = DVec3::new(x, y, z);
    if stated.min_element() < 0.0 {
        oddities.push(format!("pixdim {stated} has negative lengths: they are read as positive"));
    }
    let sides = stated.abs() * unit;
    let sform = (header.sform_code > 0).then(|| {
        let column = |j: usize| DVec3::from_array(header.srow.map(|row| row[j])) * RAS * unit;
        (column(3), [0, 1, 2].map(column))
    });
    let is_sound = |(origin, axes): &(DVec3, [DVec3; 3])| {
        let volume = axes[0].cross(axes[1]).dot(axes[2]).abs();
        origin.is_finite() && volume > 0.0 && volume.is_finite()
    };
    let usable = sform.filter(is_sound);
    if sform.is_some() && usable.is_none() {
        let instead = if header.qform_code > 0 { "qform" } else { "pixdim" };
        oddities.push(format!("the matrix of its sform spans no volume: {instead} is read instead"));
    }
    if let Some((origin, axes)) = usable {
        // The matrix contains the spacing, which takes precedence; a quaternion contains none.
        let spacing = DVec3::from(axes.map(DVec3::length));
        if (spacing - sides).abs().max_element() > DIFFERS * spacing.max_element() {
            oddities.push(format!("pixdim {sides} differs from the spacing {spacing} of its sform, which is read"));
        }
        return (spacing, Some(origin), Some(axes));
    }
    if header.qform_code > 0 {
        let [b, c, d] = header.quaternion;
        let real = (1.0 - b * b - c * c - d * d).max(0.0).sqrt();
        let rotation = DMat3::from_quat(DQuat::from_xyzw(b, c, d, real).normalize());
        let mirror = if header.pixdim[0] < 0.0 { -1.0 } else { 1.0 };
        let axes = [rotation.x_axis, rotation.y_axis, rotation.z_axis * mirror];
        return (sides, Some(DVec3::from_array(header.q_offset) * RAS * unit), Some(axes.map(|axis| axis * RAS)));
    }
    (sides, None, None)
}

pub(super) fn header(
    sides: [usize; 3],
    Place { spacing, origin, directions, in_millimetres }: Place,
) -> Result<Vec<u8>> {
    let [x, y, z] = sides.map(|side| i16::try_from(side).ok());
    let (Some(x), Some(y), Some(z)) = (x, y, z) else {
        let expected = format!("at most {} voxels along each axis, as NIfTI-1 states", i16::MAX);
        return Err(Error::invalid("volume", format!("{sides:?}"), expected, "end the name with .mha or .nrrd"));
    };
    let origin = (origin * RAS).as_vec3();
    let axes = [0, 1, 2].map(|axis| directions.col(axis) * RAS);
    let mirror = if DMat3::from_cols_array_2d(&axes.map(Into::into)).determinant() < 0.0 { -1.0 } else { 1.0 };
    let quaternion = DQuat::from_mat3(&DMat3::from_cols(axes[0], axes[1], axes[2] * mirror));
    // The real part is not stored; it is not negative.
    let q = if quaternion.w < 0.0 { -quaternion } else { quaternion }.as_quat();
    let s = spacing.as_vec3();
    let row = |i: usize| [0, 1, 2, 3].map(|j| if j < 3 { (axes[j][i] * spacing[j]) as f32 } else { origin[i] });
    let mut header = [0; SMALLEST_OFFSET[0]];
    let mut put = |at: usize, bytes: &[u8]| header[at..at + bytes.len()].copy_from_slice(bytes);
    let shorts = |numbers: &[i16]| numbers.iter().flat_map(|number| number.to_le_bytes()).collect::<Vec<_>>();
    let singles = |numbers: &[f32]| numbers.iter().flat_map(|number| number.to_le_bytes()).collect::<Vec<_>>();
    put(0, &348_i32.to_le_bytes());
    put(40, &shorts(&[3, x, y, z, 1, 1, 1, 1]));
    // Datatype and bits of f32.
    put(70, &shorts(&[16, 32]));
    put(76, &singles(&[mirror as f32, s.x, s.y, s.z, 1.0, 1.0, 1.0, 1.0]));
    // Position of the numbers, slope and intercept.
    put(108, &singles(&[SMALLEST_OFFSET[0] as f32, 1.0, 0.0]));
    put(123, &[if in_millimetres { MILLIMETRES } else { 0 }]);
    put(252, &shorts(&[SCANNER, SCANNER]));
    put(256, &singles(&[q.x, q.y, q.z, origin.x, origin.y, origin.z]));
    put(280, &singles(&[row(0), row(1), row(2)].concat()));
    put(344, b"n+1\0");
    Ok(header.to_vec())
}
