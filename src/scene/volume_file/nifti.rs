//! NIfTI-1, with or without gzip.

use super::elements::{Element, Encoding, Number, unpack};
use super::{RAS, VolumeFile, damaged};
use crate::error::{Error, Result};
use crate::output::write_atomically;
use flate2::read::MultiGzDecoder;
use glam::{DMat3, DQuat, DVec3};
use nifti::writer::WriterOptions;
use nifti::{Endianness, NiftiHeader, NiftiType};
use std::fs::File;
use std::io;
use std::path::Path;

/// Bytes of a header and of the extension flag after it.
const HEADER: usize = 352;
/// Largest expansion of a byte of gzip.
const MOST_INFLATION: usize = 1032;
/// NIfTI's code for a transformation to the coordinates of the scanner.
const SCANNER: i16 = 1;

pub(super) fn parse(content: &[u8], path: &Path) -> Result<VolumeFile> {
    let is_packed = content.starts_with(&[0x1f, 0x8b]);
    let first = |count: usize| {
        if is_packed {
            unpack(MultiGzDecoder::new(content), count)
        } else {
            Ok(content[..count.min(content.len())].into())
        }
    };
    let broken = |found: &str| damaged(path, found);
    let head = first(HEADER).map_err(|found| broken(&found))?;
    let header = NiftiHeader::from_reader(&head[..]).map_err(|error| broken(&error.to_string()))?;
    // Trailing axes of length 1 are common.
    let sides = header.dim().map_err(|error| broken(&error.to_string()))?;
    let &[x, y, z, ref rest @ ..] = sides else { return Err(broken(&format!("{} axes instead of 3", sides.len()))) };
    if rest.iter().any(|&n| n != 1) {
        return Err(broken(&format!("shape {sides:?} instead of three axes")));
    }
    let shape = [x, y, z].map(usize::from);
    let kind = header.data_type().map_err(|error| broken(&error.to_string()))?;
    let Some(number) = number(kind) else { return Err(broken(&format!("numbers of type {kind:?}"))) };
    let size = shape.iter().product::<usize>() * kind.size_of();
    let offset = header.vox_offset.max(HEADER as f32) as usize;
    let total = offset.saturating_add(size);
    let most = if is_packed { content.len().saturating_mul(MOST_INFLATION) } else { content.len() };
    if total > most {
        return Err(broken(&format!("{} bytes for shape {shape:?} of {kind:?}", content.len())));
    }
    let bytes = first(total).map_err(|found| broken(&found))?;
    if bytes.len() < total {
        return Err(broken(&format!("{} of {total} bytes", bytes.len())));
    }
    let element = Element { number, big_endian: header.endianness == Endianness::Big };
    let (slope, intercept) = (f64::from(header.scl_slope), f64::from(header.scl_inter));
    let is_scaled = slope != 0.0 && slope.is_finite() && intercept.is_finite();
    let means = |stored: f64| if is_scaled { stored * slope + intercept } else { stored };
    let values = element.volume(&bytes[offset..], Encoding::Raw, shape, means).map_err(|found| broken(&found))?;
    let sides = DVec3::new(header.pixdim[1].into(), header.pixdim[2].into(), header.pixdim[3].into()).abs();
    let Some((origin, axes)) = placement(&header) else {
        return Ok(VolumeFile::new(values, Some(sides), None, None));
    };
    // The matrix contains the spacing, which takes precedence; a quaternion contains none.
    let spacing = if header.sform_code > 0 { DVec3::from(axes.map(DVec3::length)) } else { sides };
    Ok(VolumeFile::new(values, Some(spacing), Some(origin), Some(axes)))
}

/// The number type of a NIfTI type with one number per voxel.
fn number(kind: NiftiType) -> Option<Number> {
    Some(match kind {
        NiftiType::Uint8 => Number::U8,
        NiftiType::Int8 => Number::I8,
        NiftiType::Uint16 => Number::U16,
        NiftiType::Int16 => Number::I16,
        NiftiType::Uint32 => Number::U32,
        NiftiType::Int32 => Number::I32,
        NiftiType::Uint64 => Number::U64,
        NiftiType::Int64 => Number::I64,
        NiftiType::Float32 => Number::F32,
        NiftiType::Float64 => Number::F64,
        _ => return None,
    })
}

/// Centre of the first voxel and the axes in ITK's coordinates: from the matrix, else the quaternion.
fn placement(header: &NiftiHeader) -> Option<(DVec3, [DVec3; 3])> {
    if header.sform_code > 0 {
        let rows = [header.srow_x, header.srow_y, header.srow_z].map(|row| row.map(f64::from));
        let column = |j: usize| DVec3::new(rows[0][j], rows[1][j], rows[2][j]) * RAS;
        return Some((column(3), [0, 1, 2].map(column)));
    }
    if header.qform_code > 0 {
        let origin = DVec3::new(header.quatern_x.into(), header.quatern_y.into(), header.quatern_z.into());
        let [b, c, d] = [header.quatern_b, header.quatern_c, header.quatern_d].map(f64::from);
        let rotation =
            DMat3::from_quat(DQuat::from_xyzw(b, c, d, (1.0 - b * b - c * c - d * d).max(0.0).sqrt()).normalize());
        let mirror = if header.pixdim[0] < 0.0 { -1.0 } else { 1.0 };
        let axes = [rotation.x_axis, rotation.y_axis, rotation.z_axis * mirror];
        return Some((origin * RAS, axes.map(|axis| axis * RAS)));
    }
    None
}

pub(super) fn write(path: &Path, volume: &VolumeFile, spacing: DVec3, origin: DVec3) -> Result<()> {
    let origin = (origin * RAS).as_vec3();
    let axes = [0, 1, 2].map(|axis| volume.directions.col(axis) * RAS);
    let mirror = if DMat3::from_cols_array_2d(&axes.map(Into::into)).determinant() < 0.0 { -1.0 } else { 1.0 };
    let quaternion = DQuat::from_mat3(&DMat3::from_cols(axes[0], axes[1], axes[2] * mirror));
    // The real part is not stored; it is not negative.
    let q = if quaternion.w < 0.0 { -quaternion } else { quaternion }.as_quat();
    let s = spacing.as_vec3();
    let row = |i: usize| [0, 1, 2, 3].map(|j| if j < 3 { (axes[j][i] * spacing[j]) as f32 } else { origin[i] });
    let header = NiftiHeader {
        pixdim: [mirror as f32, s.x, s.y, s.z, 1.0, 1.0, 1.0, 1.0],
        sform_code: SCANNER,
        qform_code: SCANNER,
        srow_x: row(0),
        srow_y: row(1),
        srow_z: row(2),
        quatern_b: q.x,
        quatern_c: q.y,
        quatern_d: q.z,
        quatern_x: origin.x,
        quatern_y: origin.y,
        quatern_z: origin.z,
        ..NiftiHeader::default()
    };
    let is_packed = path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("gz"));
    let fail = |source: io::Error| Error::write(path, source);
    let folder = tempfile::tempdir().map_err(fail)?;
    let file = folder.path().join(if is_packed { "volume.nii.gz" } else { "volume.nii" });
    let written = WriterOptions::new(&file).reference_header(&header).write_nifti(&volume.values);
    written.map_err(|error| fail(io::Error::other(error.to_string())))?;
    write_atomically(path, |out| io::copy(&mut File::open(&file)?, out).map(|_| ()))
}
