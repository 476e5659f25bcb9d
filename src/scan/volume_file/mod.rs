//! Volumes in common file formats, chosen by extension.
//!
//! | extension | format | metadata besides the values |
//! |---|---|---|
//! | `.npy` | NumPy, `[x, y, z]` | nothing, unless `name.npy.json` is beside it: see [`NpySide`] |
//! | `.mha`, `.mhd` | MetaImage, x fastest | spacing, origin |
//! | `.nrrd`, `.nhdr` | NRRD, x fastest | spacing, origin |
//! | `.nii`, `.nii.gz` | NIfTI-1 and NIfTI-2, x fastest | spacing, origin |
//! | `.h5`, `.hdf5`, `.hdf`, `.nxs`, `.nx`, `.mat` | an array `[z, y, x]` of HDF5 or MATLAB 7.3, `FILE.h5:/group/name`; read only; needs the feature `hdf5` | nothing |
//! | `.npz` | the one array with three axes, `[x, y, z]`; read only | nothing |
//! | `.tif`, `.tiff` | TIFF of grey pages: page z, row y, column x | spacing, if ImageJ or OME states it; it is written as ImageJ does where the unit is known |
//! | `.png`, `.jpg`, `.jpeg` | one grey slice: row y, column x; read only | nothing |
//! | `.raw` | numbers, x fastest | size and type by name: `name_256x256x256_uint8.raw`, `_uint16be` for big-endian |
//! | `.raw`, `.raw.json` | the same, described by a side file: see [`SideFile`] | size, type, spacing, origin |
//! | folder of `.tif`, `.png`, `.jpg` or `.raw` | one slice each, in natural order: `s2.tif` before `s10.tif` | nothing |
//! | folder of DICOM slices, `.dcm` | a series, ordered by position; needs the feature `dicom` | spacing, origin |
//!
//! [`write_slices`] writes a folder of PNG or a DICOM series.
//!
//! # Axes
//!
//! The array's axes are always `[x, y, z]`, in the order of the file: nothing is flipped or rotated. Spacing and origin
//! (the centre of the first voxel) are in the file's unit, or in millimetres where it states its unit. Directions of the
//! axes stated by a file are reported and copied to a written file, but do not rotate the array; [`Frame::arrange`](super::Frame::arrange) turns
//! it to the axes of a scan.
//!
//! Where the unit is known, lengths are written in millimetres, and attenuation with them: a volume per micrometre becomes
//! one per millimetre. `.npy` and `.raw` state no lengths; their values are kept.
//!
//! Positions are in the coordinates of ITK: x grows to the patient's left, y to the back, z to the head (LPS). A
//! MetaImage, and a NRRD whose space is LPS or unnamed, are stored in these coordinates. NIfTI uses coordinates that
//! grow to the right, the front and the head (RAS), as do NRRDs whose space says so: their x and y change sign on
//! reading and writing. A volume therefore has the same position in all formats: ITK, which does the same, reads equal
//! spacing, origin and directions from the files written here, and nibabel reads the affine `diag(-1,-1,1,1)` times it.
//! The x, y and z of [`geometry`](trgs_core::geometry), which knows no patient, are taken as those of ITK.
//!
//! Sizes in a header are accepted only if the file has enough bytes for them. Fields that are not read, more data than
//! the header describes, and numbers that cannot be lengths are listed as oddities: `reference/FORMATS.md` has a table.

mod archive;
mod detached;
// Test builds include it without the feature, so that one test build covers it.
#[cfg(any(feature = "dicom", test))]
mod dicom;
mod elements;
mod folder;
mod header;
mod images;
mod meta_image;
mod nifti;
mod npy_side;
mod nrrd;
mod pages;
mod plain;
mod raw;
mod scaling;
mod slices;
mod stored;
mod tiff;

pub(super) use folder::{GAP, SLICES, files, with_extension};
pub use npy_side::NpySide;
pub use raw::SideFile;
pub use scaling::Scaling;
pub(super) use scaling::range;
pub use slices::{Slices, write_slices};
pub(super) use stored::turned;
pub use stored::{Stored, open};

use super::content::{damaged, unsupported};
use super::unit::Unit;
use super::{array_path, npy};
use crate::output::write_atomically;
use flate2::Compression;
use flate2::write::GzEncoder;
use glam::{DMat3, DVec3};
use ndarray::{Array3, ArrayView3, Axis, Ix3};
use std::borrow::Cow;
use std::io::{self, Write};
use std::path::Path;
use trgs_core::error::{Error, Result};

/// Directions of axes that run along x, y and z.
pub const STRAIGHT: DMat3 = DMat3::IDENTITY;
/// Signs that convert between LPS and RAS coordinates.
const RAS: DVec3 = DVec3::new(-1.0, -1.0, 1.0);
/// Directions that differ from x, y and z by less are rounded to them.
const ROUNDING: f64 = 1e-5;

/// A volume with the metadata of its file.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct VolumeFile {
    /// `[x, y, z]`.
    pub values: Array3<f32>,
    /// Distance between voxels in the file's unit, if the file states it.
    pub spacing: Option<DVec3>,
    /// Centre of voxel (0, 0, 0) in the file's unit, if the file states it.
    pub origin: Option<DVec3>,
    /// Unit vectors along the axes of the array, one per column; by default the identity.
    pub directions: DMat3,
    /// Unit of spacing and origin, if the file states it; attenuation is taken as per this unit.
    pub unit: Option<Unit>,
    /// Unusual properties of the file, one sentence each.
    pub oddities: Vec<String>,
}

impl VolumeFile {
    /// Values without metadata.
    fn bare(values: Array3<f32>) -> Self {
        Self { values, ..Self::default() }
    }

    /// Values without metadata, and unusual properties of their file.
    #[cfg(any(feature = "hdf5", test))]
    fn remarked((values, oddities): (Array3<f32>, Vec<String>)) -> Self {
        Self { oddities, ..Self::bare(values) }
    }

    /// Whether lengths are in millimetres, rather than in a unit that is not stated.
    fn in_millimetres(self, is_stated: bool) -> Self {
        Self { unit: is_stated.then_some(Unit::Millimetre), ..self }
    }

    /// The volume with z fastest in memory.
    fn in_order(self) -> Self {
        let values =
            if self.values.is_standard_layout() { self.values } else { self.values.as_standard_layout().into_owned() };
        Self { values, ..self }
    }
}

#[derive(Clone, Copy, PartialEq)]
enum Format {
    Npy,
    Npz,
    Hdf5,
    MetaImage,
    Nrrd,
    Nifti,
    Tiff,
    Image,
    Dicom,
    Raw,
}

/// Endings of the names of each format.
const ENDINGS: [(&str, Format); 21] = [
    (".npy", Format::Npy),
    (".npz", Format::Npz),
    (".mha", Format::MetaImage),
    (".mhd", Format::MetaImage),
    (".nrrd", Format::Nrrd),
    (".nhdr", Format::Nrrd),
    (".nii", Format::Nifti),
    (".nii.gz", Format::Nifti),
    (".tif", Format::Tiff),
    (".tiff", Format::Tiff),
    (".png", Format::Image),
    (".jpg", Format::Image),
    (".jpeg", Format::Image),
    (".dcm", Format::Dicom),
    (".raw", Format::Raw),
    (".h5", Format::Hdf5),
    (".hdf5", Format::Hdf5),
    (".hdf", Format::Hdf5),
    (".nxs", Format::Hdf5),
    (".nx", Format::Hdf5),
    (".mat", Format::Hdf5),
];

/// Endings of formats that are not read, or not as the slices of a folder, and how to convert them.
const FOREIGN: [(&str, &str); 11] = [
    (".h5", HDF5),
    (".hdf5", HDF5),
    (".nxs", HDF5),
    (".hdr", "python -c \"import nibabel; nibabel.save(nibabel.load('IN.hdr'), 'OUT.nii')\""),
    (".img", "python -c \"import nibabel; nibabel.save(nibabel.load('IN.img'), 'OUT.nii')\""),
    (".mgz", "python -c \"import nibabel; nibabel.save(nibabel.load('IN.mgz'), 'OUT.nii')\""),
    (".vtk", "python -c \"import SimpleITK as s; s.WriteImage(s.ReadImage('IN.vtk'), 'OUT.mha')\""),
    (".vti", "open it in ParaView or 3D Slicer, and save it as .nrrd or .mha"),
    (".bmp", "magick mogrify -format png *.bmp"),
    (".vol", "rename it with its size and type, as in name_256x256x256_float32.raw"),
    (".bin", "rename it with its size and type, as in name_256x256x256_float32.raw"),
];

const HDF5: &str = "python -c \"import h5py, numpy; numpy.save('OUT.npy', h5py.File('IN')['NAME'][:])\"";

impl Format {
    fn of(path: &Path) -> Result<Self> {
        if array_path::is_hdf5(path) {
            return Ok(Self::Hdf5);
        }
        let name = path.file_name().unwrap_or_default().to_string_lossy().to_lowercase();
        if let Some((_, format)) = ENDINGS.iter().find(|(ending, _)| name.ends_with(ending)) {
            return Ok(*format);
        }
        let endings = ENDINGS.map(|(ending, _)| ending).join(", ");
        let expected = format!("a name that ends with {endings}");
        Err(match FOREIGN.iter().find(|(ending, _)| name.ends_with(ending)) {
            Some((ending, how)) => {
                let got = format!("{}: {ending}, which is not supported", path.display());
                Error::invalid("volume's file", got, expected, format!("convert it: {how}"))
            }
            None => {
                let remedy = "rename the file, or convert it to one of these formats";
                Error::invalid("volume's file", path.display(), expected, remedy)
            }
        })
    }
}

/// Whether the name has an extension of this page.
pub fn is_volume(path: &Path) -> bool {
    Format::of(path).is_ok()
}

/// Whether the name has an extension of this page, or of a format whose error says how to convert it.
pub fn has_known_ending(path: &Path) -> bool {
    let name = path.file_name().unwrap_or_default().to_string_lossy().to_lowercase();
    is_volume(path) || FOREIGN.iter().any(|(ending, _)| name.ends_with(ending))
}

/// Writes a slab.
type PutSlab<'a> = dyn FnMut(ArrayView3<'_, f32>) -> io::Result<()> + 'a;
/// Gives the slabs across an axis to its argument, in their order.
type Slabs<'a> = dyn FnMut(usize, &mut PutSlab<'_>) -> io::Result<()> + 'a;
/// Gives the slices across z to its argument, x fastest.
type EachSlice<'a> = dyn FnMut(&mut dyn FnMut(&[f32]) -> io::Result<()>) -> io::Result<()> + 'a;

/// Reads a volume; the format follows from the name.
///
/// # Errors
/// [`Error::Read`], [`Error::Invalid`] for an unknown extension, or [`Error::Format`] for the first content that does
/// not fit.
pub fn read(path: impl AsRef<Path>) -> Result<VolumeFile> {
    read_path(path.as_ref())
}

fn read_path(path: &Path) -> Result<VolumeFile> {
    read_in_any_order(path).map(VolumeFile::in_order)
}

/// [`read`] without the copy that makes z fastest in memory; the axes are `[x, y, z]` nevertheless.
pub(super) fn read_in_any_order(path: &Path) -> Result<VolumeFile> {
    if path.is_dir() {
        return folder::read(path);
    }
    match Format::of(path)? {
        Format::Npy => return placed(npy::read_f32::<Ix3>(path, "[x, y, z]")?, path),
        #[cfg(any(feature = "hdf5", test))]
        Format::Hdf5 => return super::hdf5::read(path).map(VolumeFile::remarked),
        _ => {}
    }
    let file = array_path::parts(path).0;
    let content = crate::input::read(&file).map_err(|source| Error::read(&file, source))?;
    parse_in_any_order(&content, path)
}

/// Reads a volume from the content of a file.
///
/// `path` gives the format, and the location of side files and detached data.
///
/// # Errors
/// Those of [`read`].
pub fn parse(content: &[u8], path: &Path) -> Result<VolumeFile> {
    parse_in_any_order(content, path).map(VolumeFile::in_order)
}

/// The volume of a `.npy`, at the place that its side file states.
fn placed(values: Array3<f32>, path: &Path) -> Result<VolumeFile> {
    let metadata = NpySide::beside(path, values.dim().into())?;
    Ok(VolumeFile { values, ..metadata })
}

fn parse_in_any_order(content: &[u8], path: &Path) -> Result<VolumeFile> {
    match Format::of(path)? {
        Format::Npy => {
            let values = npy::parse(content, path)?.numbers.into_f32();
            placed(npy::with_axes::<f32, Ix3>(values, path, "array", "[x, y, z]")?, path)
        }
        Format::Npz => archive::parse(content, path),
        #[cfg(any(feature = "hdf5", test))]
        Format::Hdf5 => super::hdf5::parse(content, path).map(VolumeFile::remarked),
        #[cfg(not(any(feature = "hdf5", test)))]
        Format::Hdf5 => Err(no_hdf5(path)),
        Format::Tiff => tiff::parse(content, path),
        Format::Image => images::parse(content, path),
        #[cfg(any(feature = "dicom", test))]
        Format::Dicom => dicom::parse(content, path),
        #[cfg(not(any(feature = "dicom", test)))]
        Format::Dicom => Err(no_dicom(path)),
        Format::MetaImage => detached::whole(meta_image::describe(content, path)?, content, path),
        Format::Nrrd => detached::whole(nrrd::describe(content, path)?, content, path),
        Format::Nifti => detached::whole(nifti::describe(content, content.len(), path)?, content, path),
        Format::Raw => detached::whole(raw::describe(content.len(), path)?, content, path),
    }
}

/// Writes a volume as f32; the format follows from the name.
///
/// Unknown spacing is written as 1, unknown origin as 0. Lengths of a known unit are written in millimetres, and the values
/// as attenuation per millimetre.
///
/// # Errors
/// [`Error::Write`], or [`Error::Invalid`] for an unknown extension or a `.raw` whose name states another size or type.
pub fn write(path: impl AsRef<Path>, volume: &VolumeFile) -> Result<()> {
    write_path(path.as_ref(), volume)
}

fn write_path(path: &Path, volume: &VolumeFile) -> Result<()> {
    write_slabs(path, volume, volume.values.dim().into(), &mut |_, put| put(volume.values.view()))
}

/// [`write()`] of a volume slab by slab. The file may be the one that it is read from.
///
/// # Errors
/// Those of [`write()`] and [`Stored::each`].
pub fn write_stored(path: impl AsRef<Path>, stored: Stored) -> Result<()> {
    let path = path.as_ref();
    let (metadata, shape) = (stored.metadata().clone(), stored.shape());
    let mut stored = Some(stored);
    write_slabs(path, &metadata, shape, &mut |axis, put| {
        // It is closed before the new file takes its place.
        let mut stored = stored.take().expect("called once");
        let written = stored.each(axis, |_, slab| put(slab.view()).map_err(|source| Error::write(path, source)));
        written.map_err(io::Error::other)
    })
}

/// Writes a volume of which the slabs are given, once.
fn write_slabs(path: &Path, volume: &VolumeFile, shape: [usize; 3], slabs: &mut Slabs<'_>) -> Result<()> {
    let format = Format::of(path).map_err(|_| not_written(path))?;
    let place = Place::of(volume);
    let factor = if format == Format::Raw { 1.0 } else { volume.unit.map_or(1.0, Unit::millimetres) };
    let slices: &mut EachSlice<'_> = &mut |put| {
        slabs(2, &mut |slab| {
            slab.axis_iter(Axis(2)).try_for_each(|slice| {
                let values: Vec<f32> = slice.t().iter().map(|&value| divided(value, factor)).collect();
                put(&values)
            })
        })
    };
    let header = match format {
        Format::Npy => {
            return npy::write_parts(path, &shape, |put| {
                slabs(0, &mut |slab| {
                    let mut slices = slab.outer_iter();
                    slices.try_for_each(|slice| put(slice.as_standard_layout().as_slice().expect("standard layout")))
                })
            });
        }
        Format::MetaImage => meta_image::header(path, shape, place)?,
        Format::Nrrd => nrrd::header(path, shape, place)?,
        Format::Nifti => nifti::header(shape, place)?,
        Format::Tiff => return tiff::write(path, shape, place, slices),
        Format::Dicom | Format::Image | Format::Npz | Format::Hdf5 => {
            let expected = "another format: HDF5, JPEG and volumes as .npz are not written, and DICOM and PNG as folders of slices";
            return Err(Error::invalid("file to write", path.display(), expected, "end it with .nii.gz or .mha"));
        }
        Format::Raw => {
            raw::check_name(path, shape)?;
            Vec::new()
        }
    };
    let is_packed = format == Format::Nifti && path.extension().is_some_and(|end| end.eq_ignore_ascii_case("gz"));
    write_atomically(path, |file| match is_packed {
        true => {
            let mut packer = GzEncoder::new(file, Compression::fast());
            write_numbers(&mut packer, &header, slices)?;
            packer.finish().map(|_| ())
        }
        false => write_numbers(file, &header, slices),
    })
}

/// Writes a header, and numbers in little-endian order.
fn write_numbers(file: &mut dyn Write, header: &[u8], slices: &mut EachSlice<'_>) -> io::Result<()> {
    file.write_all(header)?;
    slices(&mut |values| file.write_all(&values.iter().flat_map(|value| value.to_le_bytes()).collect::<Vec<_>>()))
}

/// The error for a name to write whose ending is of no format: it lists those that are written, of one file each.
fn not_written(path: &Path) -> Error {
    let read_only = [Format::Dicom, Format::Image, Format::Npz, Format::Hdf5];
    let written =
        |(ending, format): &(&str, Format)| !read_only.contains(format) && !["mhd", "nhdr"].contains(&&ending[1..]);
    let endings: Vec<_> = ENDINGS.into_iter().filter(written).map(|(ending, _)| ending).collect();
    let expected = format!("a name that ends with {}", endings.join(", "));
    Error::invalid("file to write", path.display(), expected, "end it with .nii.gz or .mha")
}

/// The place of a volume as headers state it.
#[derive(Clone, Copy)]
struct Place {
    spacing: DVec3,
    origin: DVec3,
    directions: DMat3,
    /// Whether lengths are in millimetres, rather than in a unit that is not known.
    in_millimetres: bool,
}

impl Place {
    fn of(volume: &VolumeFile) -> Self {
        let factor = volume.unit.map_or(1.0, Unit::millimetres);
        Self {
            spacing: volume.spacing.map_or(DVec3::ONE, |spacing| spacing * factor),
            origin: volume.origin.map_or(DVec3::ZERO, |origin| origin * factor),
            directions: volume.directions,
            in_millimetres: volume.unit.is_some(),
        }
    }
}

/// The attenuation of a volume per millimetre; its own where it states no unit.
fn per_millimetre(volume: &VolumeFile) -> Cow<'_, Array3<f32>> {
    match volume.unit.map_or(1.0, Unit::millimetres) {
        1.0 => Cow::Borrowed(&volume.values),
        factor => Cow::Owned(volume.values.mapv(|value| divided(value, factor))),
    }
}

fn divided(value: f32, factor: f64) -> f32 {
    if factor == 1.0 { value } else { (f64::from(value) / factor) as f32 }
}

/// The error of a build without the feature.
#[cfg(not(any(feature = "dicom", test)))]
fn no_dicom(path: &Path) -> Error {
    let expected = "a build that reads DICOM";
    Error::invalid("DICOM", path.display(), expected, "build with the feature dicom: `cargo build -r -F dicom`")
}

/// The error of a build without the feature.
#[cfg(not(any(feature = "hdf5", test)))]
pub(super) fn no_hdf5(path: &Path) -> Error {
    let remedy = format!("build with the feature hdf5: `cargo build -r -F hdf5`, or convert it: {HDF5}");
    Error::invalid("HDF5", path.display(), "a build that reads HDF5", remedy)
}

impl VolumeFile {
    /// The metadata of a file, without values.
    ///
    /// `axes` are the steps between voxels or their directions, in ITK's coordinates. `None` means that the file states
    /// no directions. Lengths that cannot be a spacing are replaced by 1, and an origin that is not finite is unknown;
    /// both are remarked on. A negative spacing reverses its axis, as in ITK.
    fn new(spacing: Option<DVec3>, origin: Option<DVec3>, axes: Option<[DVec3; 3]>) -> Self {
        let mut oddities = Vec::new();
        let mut axes = axes.unwrap_or(STRAIGHT.to_cols_array_2d().map(DVec3::from));
        let spacing = spacing.map(|stated| {
            let is_length = |side: f64| side != 0.0 && side.is_finite();
            if !stated.to_array().into_iter().all(is_length) {
                oddities.push(format!("its spacing {stated} has zero or non-finite lengths, which are read as 1"));
            }
            let sound = stated.to_array().map(|side| if is_length(side) { side } else { 1.0 });
            (0..3).filter(|&axis| sound[axis] < 0.0).for_each(|axis| axes[axis] = -axes[axis]);
            DVec3::from_array(sound.map(f64::abs))
        });
        if let Some(stated) = origin.filter(|origin| !origin.is_finite()) {
            oddities.push(format!("its origin {stated} is not finite: it is read as unknown"));
        }
        // Adding 0 turns -0 into 0.
        let [x, y, z] = axes.map(|axis| axis.normalize() + 0.0);
        let origin = origin.filter(|origin| origin.is_finite()).map(|origin| origin + 0.0);
        let mut volume = Self { spacing, origin, oddities, ..Self::default() };
        let directions = DMat3::from_cols(x, y, z);
        if !directions.is_finite() {
            volume.oddities.push("its axes have no directions; they are read as x, y and z".into());
        } else if !directions.abs_diff_eq(STRAIGHT, ROUNDING) {
            volume.directions = directions;
            volume.oddities.extend(volume.remark_on_directions());
        }
        volume
    }

    /// The remark on axes that do not run along x, y and z.
    fn remark_on_directions(&self) -> Option<String> {
        let [x, y, z] = [0, 1, 2].map(|axis| self.directions.col(axis));
        let remark = || format!("its axes have the directions {x}, {y}, {z}; they are read as x, y and z");
        (self.directions != STRAIGHT).then(remark)
    }

    /// The unusual properties but the directions, for a reader that heeds them.
    pub(super) fn other_oddities(&self) -> Vec<String> {
        let directions = self.remark_on_directions();
        self.oddities.iter().filter(|oddity| Some(*oddity) != directions.as_ref()).cloned().collect()
    }
}

#[cfg(test)]
mod letters;
#[cfg(test)]
mod tests;
