//! Volumes in the formats that others read and write, by extension.
//!
//! | extension | format | what it says beside the values |
//! |---|---|---|
//! | `.npy` | NumPy, `[x, y, z]` | nothing |
//! | `.mha`, `.mhd` | MetaImage, x fastest | spacing, origin |
//! | `.nrrd`, `.nhdr` | NRRD, x fastest | spacing, origin |
//! | `.nii`, `.nii.gz` | NIfTI-1, x fastest | spacing, origin |
//! | `.raw` | numbers alone, x fastest | size and type by name: `name_256x256x256_uint8.raw`, `_uint16be` for big-endian |
//!
//! The array's axes are always `[x, y, z]`, in the order of the file: nothing is flipped or turned. Spacing and origin (of
//! the centre of the first voxel) are along these axes, in the file's unit; a direction matrix other than the identity is
//! reported and otherwise left alone. What is written has the identity.
//!
//! Sizes in a header are believed only as far as the file has the bytes for them.

mod elements;
mod meta_image;
mod nifti;
mod nrrd;

use super::npy;
use crate::error::{Error, Result};
use crate::output::write_atomically;
use elements::{Element, Encoding, Number};
use glam::DVec3;
use ndarray::{Array3, Ix3};
use std::io::Write;
use std::path::Path;

/// A volume as a file has it.
#[derive(Clone, Debug, PartialEq)]
pub struct VolumeFile {
    /// `[x, y, z]`.
    pub values: Array3<f32>,
    /// Distance of voxels, if the file says it.
    pub spacing: Option<DVec3>,
    /// Centre of voxel (0, 0, 0), if the file says it.
    pub origin: Option<DVec3>,
    /// What is unusual, a sentence each.
    pub oddities: Vec<String>,
}

#[derive(Clone, Copy)]
enum Format {
    Npy,
    MetaImage,
    Nrrd,
    Nifti,
    Raw,
}

impl Format {
    fn of(path: &Path) -> Result<Self> {
        let name = path.file_name().unwrap_or_default().to_string_lossy().to_lowercase();
        let known = [
            (".npy", Self::Npy),
            (".mha", Self::MetaImage),
            (".mhd", Self::MetaImage),
            (".nrrd", Self::Nrrd),
            (".nhdr", Self::Nrrd),
            (".nii", Self::Nifti),
            (".nii.gz", Self::Nifti),
            (".raw", Self::Raw),
        ];
        known.into_iter().find(|(ending, _)| name.ends_with(ending)).map(|(_, format)| format).ok_or_else(|| {
            let endings = known.map(|(ending, _)| ending).join(", ");
            Error::invalid("volume's file", path.display(), format!("a name that ends with {endings}"), "rename it")
        })
    }
}

/// Reads a volume; what it is follows from the name.
///
/// # Errors
/// [`Error::Read`], [`Error::Invalid`] for an unknown extension, or [`Error::Format`] for the first thing that does not fit.
pub fn read(path: &Path) -> Result<VolumeFile> {
    let format = Format::of(path)?;
    if let Format::Npy = format {
        let values = npy::read_f32::<Ix3>(path, "[x, y, z]")?;
        return Ok(VolumeFile { values, spacing: None, origin: None, oddities: Vec::new() });
    }
    let content = std::fs::read(path).map_err(|source| Error::read(path, source))?;
    match format {
        Format::Npy => unreachable!("read above"),
        Format::MetaImage => meta_image::parse(&content, path),
        Format::Nrrd => nrrd::parse(&content, path),
        Format::Nifti => nifti::parse(&content, path),
        Format::Raw => {
            let (shape, element) = elements::of_name(path)?;
            let values = element.volume(&content, Encoding::Raw, shape).map_err(|found| damaged(path, &found))?;
            Ok(VolumeFile { values, spacing: None, origin: None, oddities: Vec::new() })
        }
    }
}

/// Writes a volume as f32; what it becomes follows from the name. Where spacing or origin are not known, they are 1 and 0.
///
/// # Errors
/// [`Error::Write`], or [`Error::Invalid`] for an unknown extension or a `.raw` whose name tells another size or type.
pub fn write(path: &Path, volume: &VolumeFile) -> Result<()> {
    let format = Format::of(path)?;
    let shape: [usize; 3] = volume.values.dim().into();
    let spacing = volume.spacing.unwrap_or(DVec3::ONE);
    let origin = volume.origin.unwrap_or(DVec3::ZERO);
    let header = match format {
        Format::Npy => return npy::write(path, volume.values.view()),
        Format::MetaImage => meta_image::header(path, shape, spacing, origin)?,
        Format::Nrrd => nrrd::header(path, shape, spacing, origin)?,
        Format::Nifti => return nifti::write(path, volume, spacing, origin),
        Format::Raw => {
            let expected = elements::of_name(path)?;
            if expected != (shape, Element { number: Number::F32, big_endian: false }) {
                let [x, y, z] = shape;
                let remedy = format!("end it with _{x}x{y}x{z}_float32.raw");
                return Err(Error::invalid("name of the file", path.display(), "its size and type", remedy));
            }
            Vec::new()
        }
    };
    write_atomically(path, |file| {
        file.write_all(&header)?;
        file.write_all(&elements::x_fastest(&volume.values))
    })
}

/// An error about the content of a file.
fn damaged(path: &Path, found: &str) -> Error {
    Error::format(path, "volume", found, "a whole file with one number per voxel", "get the file again")
}

/// Three numbers of a text.
fn three<T: std::str::FromStr>(text: &str) -> Option<[T; 3]> {
    let numbers: Option<Vec<T>> = text.split_whitespace().map(|word| word.parse().ok()).collect();
    numbers?.try_into().ok()
}

#[cfg(test)]
mod tests;
