//! Volumes in the formats that others read and write, by extension.
//!
//! | extension | format | what it says beside the values |
//! |---|---|---|
//! | `.npy` | NumPy, `[x, y, z]` | nothing |
//! | `.mha`, `.mhd` | MetaImage, x fastest | spacing, origin |
//! | `.nrrd`, `.nhdr` | NRRD, x fastest | spacing, origin |
//! | `.nii`, `.nii.gz` | NIfTI-1, x fastest | spacing, origin |
//! | `.tif`, `.tiff` | TIFF of grey pages: page z, row y, column x | nothing |
//! | `.raw` | numbers alone, x fastest | size and type by name: `name_256x256x256_uint8.raw`, `_uint16be` for big-endian |
//! | `.raw`, `.raw.json` | the same, described by a file beside it: see [`SideFile`] | size, type, spacing, origin |
//! | folder of `.tif` | one page each, in natural order of the names: `s2.tif` before `s10.tif` | nothing |
//! | folder of DICOM slices, `.dcm` | a series, in order of the slices' places; needs the feature `dicom` | spacing, origin |
//!
//! # Axes
//!
//! The array's axes are always `[x, y, z]`, in the order of the file: nothing is flipped or turned. Spacing and origin (of
//! the centre of the first voxel) are in the file's unit. What else a file says about its axes, their directions, is
//! reported, carried on to the file that is written, and does not turn the array.
//!
//! Where a voxel lies is told in the coordinates of ITK: x grows to the patient's left, y to the back, z to the head (LPS).
//! A MetaImage, and a NRRD whose space is LPS or has no name, state them as they are. NIfTI is defined in coordinates that
//! grow to the right, the front and the head (RAS), and so are NRRDs whose space says so: of these x and y change their
//! sign, on reading and on writing. So one volume has one place in all formats: ITK, which does the same, sees equal
//! spacing, origin and directions in what is written here, and nibabel the affine `diag(-1,-1,1,1)` times it. The world of
//! [`geometry`](super::geometry) has no patient in it; its x, y and z are taken as those of ITK.
//!
//! Sizes in a header are believed only as far as the file has the bytes for them.

// The tests have it without the feature, so that one build of them is enough.
#[cfg(any(feature = "dicom", test))]
mod dicom;
mod elements;
mod folder;
mod meta_image;
mod nifti;
mod nrrd;
mod raw;
mod tiff;

pub(super) use folder::{files, with_extension};
pub use raw::SideFile;

use super::{Volume, npy};
use crate::error::{Error, Result};
use crate::output::write_atomically;
use glam::{DMat3, DVec3};
use ndarray::{Array3, Ix3};
use std::io::Write;
use std::path::Path;

/// Directions of axes that run along x, y and z.
pub const STRAIGHT: DMat3 = DMat3::IDENTITY;
/// To coordinates that grow to the right, the front and the head, and back.
const RAS: DVec3 = DVec3::new(-1.0, -1.0, 1.0);
/// Directions that differ from x, y and z by less are those, rounded.
const ROUNDING: f64 = 1e-5;

/// A volume as a file has it.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct VolumeFile {
    /// `[x, y, z]`.
    pub values: Array3<f32>,
    /// Distance of voxels, if the file says it.
    pub spacing: Option<DVec3>,
    /// Centre of voxel (0, 0, 0), if the file says it.
    pub origin: Option<DVec3>,
    /// Unit vectors along the axes of the array, a column each; the identity unless the file says otherwise.
    pub directions: DMat3,
    /// What is unusual, a sentence each.
    pub oddities: Vec<String>,
}

impl VolumeFile {
    /// Values and nothing else.
    fn bare(values: Array3<f32>) -> Self {
        Self { values, ..Self::default() }
    }

    /// With z the fastest in memory.
    fn in_order(self) -> Self {
        let values =
            if self.values.is_standard_layout() { self.values } else { self.values.as_standard_layout().into_owned() };
        Self { values, ..self }
    }
}

#[derive(Clone, Copy)]
enum Format {
    Npy,
    MetaImage,
    Nrrd,
    Nifti,
    Tiff,
    Dicom,
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
            (".tif", Self::Tiff),
            (".tiff", Self::Tiff),
            (".dcm", Self::Dicom),
            (".raw", Self::Raw),
        ];
        known.into_iter().find(|(ending, _)| name.ends_with(ending)).map(|(_, format)| format).ok_or_else(|| {
            let endings = known.map(|(ending, _)| ending).join(", ");
            Error::invalid("volume's file", path.display(), format!("a name that ends with {endings}"), "rename it")
        })
    }
}

/// Whether the name is that of a format of this page.
pub fn is_volume(path: &Path) -> bool {
    Format::of(path).is_ok()
}

/// Reads a volume; what it is follows from the name.
///
/// # Errors
/// [`Error::Read`], [`Error::Invalid`] for an unknown extension, or [`Error::Format`] for the first thing that does not fit.
pub fn read(path: &Path) -> Result<VolumeFile> {
    read_in_any_order(path).map(VolumeFile::in_order)
}

/// [`read`] without the copy that brings z to the end: the array has the right axes, but x may be the fastest in memory.
pub(super) fn read_in_any_order(path: &Path) -> Result<VolumeFile> {
    if path.is_dir() {
        return folder::read(path);
    }
    if let Format::Npy = Format::of(path)? {
        return npy::read_f32::<Ix3>(path, "[x, y, z]").map(VolumeFile::bare);
    }
    let content = std::fs::read(path).map_err(|source| Error::read(path, source))?;
    parse_in_any_order(&content, path)
}

/// Reads a volume from the content of a file; `path` tells what it is, and where a header's numbers or a side file are.
///
/// # Errors
/// Those of [`read`].
pub fn parse(content: &[u8], path: &Path) -> Result<VolumeFile> {
    parse_in_any_order(content, path).map(VolumeFile::in_order)
}

fn parse_in_any_order(content: &[u8], path: &Path) -> Result<VolumeFile> {
    match Format::of(path)? {
        Format::Npy => {
            let values = npy::parse(content, path)?.numbers.into_f32();
            npy::with_axes::<f32, Ix3>(values, path, "array", "[x, y, z]").map(VolumeFile::bare)
        }
        Format::MetaImage => meta_image::parse(content, path),
        Format::Nrrd => nrrd::parse(content, path),
        Format::Nifti => nifti::parse(content, path),
        Format::Tiff => tiff::parse(content, path),
        #[cfg(any(feature = "dicom", test))]
        Format::Dicom => dicom::parse(content, path),
        #[cfg(not(any(feature = "dicom", test)))]
        Format::Dicom => Err(no_dicom(path)),
        Format::Raw => raw::parse(content, path),
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
        Format::MetaImage => meta_image::header(path, shape, spacing, origin, volume.directions)?,
        Format::Nrrd => nrrd::header(path, shape, spacing, origin, volume.directions)?,
        Format::Nifti => return nifti::write(path, volume, spacing, origin),
        Format::Tiff => return tiff::write(path, &volume.values),
        Format::Dicom => {
            let expected = "another format: DICOM is read but not written";
            return Err(Error::invalid("file to write", path.display(), expected, "end it with .nii.gz or .mha"));
        }
        Format::Raw => {
            raw::check_name(path, shape)?;
            Vec::new()
        }
    };
    write_atomically(path, |file| {
        file.write_all(&header)?;
        file.write_all(&elements::x_fastest(&volume.values))
    })
}

/// Writes a volume with the spacing and the origin of its grid; the format follows from the name.
///
/// # Errors
/// Those of [`write()`].
pub fn write_volume(path: impl AsRef<Path>, volume: &Volume) -> Result<()> {
    let Volume { grid, values } = volume;
    let (spacing, origin) = (Some(grid.spacing), Some(grid.centre([0, 0, 0])));
    write(path.as_ref(), &VolumeFile { values: values.clone(), spacing, origin, ..VolumeFile::default() })
}

/// What a build without the feature says.
#[cfg(not(any(feature = "dicom", test)))]
fn no_dicom(path: &Path) -> Error {
    let expected = "a build that reads DICOM";
    Error::invalid("DICOM", path.display(), expected, "build with the feature dicom: `cargo build -r -F dicom`")
}

impl VolumeFile {
    /// What a file says: `axes` are the steps from voxel to voxel or the directions of these, in the coordinates of ITK.
    /// Without them it says nothing about directions.
    fn new(values: Array3<f32>, spacing: Option<DVec3>, origin: Option<DVec3>, axes: Option<[DVec3; 3]>) -> Self {
        // Adding 0 makes a plain zero of -0.
        let [x, y, z] = axes.unwrap_or(STRAIGHT.to_cols_array_2d().map(DVec3::from)).map(|axis| axis.normalize() + 0.0);
        let mut volume = Self { values, spacing, origin: origin.map(|origin| origin + 0.0), ..Self::default() };
        let directions = DMat3::from_cols(x, y, z);
        if !directions.is_finite() {
            volume.oddities.push("its axes have no directions; they are read as x, y and z".into());
        } else if !directions.abs_diff_eq(STRAIGHT, ROUNDING) {
            volume.oddities.push(format!("its axes have the directions {x}, {y}, {z}; they are read as x, y and z"));
            volume.directions = directions;
        }
        volume
    }
}

/// An error about the content of a file. What a library found may be as long as the file.
fn damaged(path: &Path, found: &str) -> Error {
    const LONGEST: usize = 400;
    let found: String = found.chars().take(LONGEST).collect();
    Error::format(path, "volume", found, "a whole file with one number per voxel", "get the file again")
}

/// All numbers of a text, N of them.
fn numbers<const N: usize, T: std::str::FromStr>(text: &str) -> Option<[T; N]> {
    let numbers: Option<Vec<T>> = text.split_whitespace().map(|word| word.parse().ok()).collect();
    numbers?.try_into().ok()
}

#[cfg(test)]
mod tests;
