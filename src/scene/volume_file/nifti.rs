//! NIfTI-1, packed by gzip or not.

use super::elements::unpack;
use super::{VolumeFile, damaged};
use crate::error::{Error, Result};
use crate::output::write_atomically;
use flate2::read::MultiGzDecoder;
use glam::DVec3;
use ndarray::Array3;
use nifti::writer::WriterOptions;
use nifti::{InMemNiftiVolume, NiftiHeader, NiftiType};
use std::fs::File;
use std::io;
use std::path::Path;

/// Bytes of a header and of the mark for extensions behind it.
const HEADER: usize = 352;
/// A byte of gzip stands for at most so many.
const MOST_INFLATION: usize = 1032;
/// "The transformation is to coordinates of the scanner."
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
    // Trailing axes of one voxel are common.
    let sides = header.dim().map_err(|error| broken(&error.to_string()))?;
    let &[x, y, z, ref rest @ ..] = sides else { return Err(broken(&format!("{} axes instead of 3", sides.len()))) };
    if rest.iter().any(|&n| n != 1) {
        return Err(broken(&format!("shape {sides:?} instead of three axes")));
    }
    let shape = [x, y, z].map(usize::from);
    let kind = header.data_type().map_err(|error| broken(&error.to_string()))?;
    if !is_real(kind) {
        return Err(broken(&format!("numbers of type {kind:?}")));
    }
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
    let volume = InMemNiftiVolume::from_raw_data(&header, bytes[offset..].to_vec());
    let numbers = volume.and_then(InMemNiftiVolume::into_nifti_typed_data::<f32>);
    let numbers = numbers.map_err(|error| broken(&error.to_string()))?;
    let [x, y, z] = shape;
    let values = Array3::from_shape_vec((z, y, x), numbers).map_err(|error| broken(&error.to_string()))?;
    let spacing = DVec3::new(header.pixdim[1].into(), header.pixdim[2].into(), header.pixdim[3].into());
    let (origin, straight) = placement(&header);
    let mut oddities = Vec::new();
    if !straight {
        oddities.push("the axes have directions of their own; they are read as x, y and z".into());
    }
    Ok(VolumeFile { values: values.reversed_axes(), spacing: Some(spacing.abs()), origin, oddities })
}

/// Types of one number per voxel.
fn is_real(kind: NiftiType) -> bool {
    use NiftiType as T;
    matches!(kind, T::Uint8 | T::Int8 | T::Uint16 | T::Int16 | T::Uint32 | T::Int32 | T::Float32 | T::Float64)
}

/// The first voxel's centre, and whether the axes run along x, y and z.
fn placement(header: &NiftiHeader) -> (Option<DVec3>, bool) {
    if header.sform_code > 0 {
        let rows = [header.srow_x, header.srow_y, header.srow_z];
        let straight = (0..3).all(|i| (0..3).all(|j| if i == j { rows[i][j] > 0.0 } else { rows[i][j] == 0.0 }));
        return (Some(DVec3::from_array(rows.map(|row| row[3].into()))), straight);
    }
    if header.qform_code > 0 {
        let origin = DVec3::new(header.quatern_x.into(), header.quatern_y.into(), header.quatern_z.into());
        let turned = [header.quatern_b, header.quatern_c, header.quatern_d].iter().any(|&part| part != 0.0);
        return (Some(origin), !turned && header.pixdim[0] >= 0.0);
    }
    (None, true)
}

pub(super) fn write(path: &Path, volume: &VolumeFile, spacing: DVec3, origin: DVec3) -> Result<()> {
    let (s, o) = (spacing.as_vec3(), origin.as_vec3());
    let header = NiftiHeader {
        pixdim: [1.0, s.x, s.y, s.z, 1.0, 1.0, 1.0, 1.0],
        sform_code: SCANNER,
        qform_code: SCANNER,
        srow_x: [s.x, 0.0, 0.0, o.x],
        srow_y: [0.0, s.y, 0.0, o.y],
        srow_z: [0.0, 0.0, s.z, o.z],
        quatern_x: o.x,
        quatern_y: o.y,
        quatern_z: o.z,
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
