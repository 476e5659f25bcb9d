//! Scans that one file holds with their fields and angles: the layouts of HDF5.

use super::super::array_path;
use ndarray::Array3;
use std::path::Path;
use trgs_core::error::Result;
use trgs_core::setting::Text;

/// Frames, fields and angles of a file.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ScanFile {
    /// `[view, v, u]`.
    pub frames: Array3<f32>,
    /// Frames without an object.
    pub flat: Option<Array3<f32>>,
    /// Frames without X-rays.
    pub dark: Option<Array3<f32>>,
    /// Radians.
    pub angles: Option<Vec<f64>>,
    /// Whether the file states no unit of the angles, so that they were read as degrees.
    pub is_unit_assumed: bool,
    /// Remarks for the user, one sentence each.
    pub remarks: Vec<Text>,
}

/// Reads the scan of an HDF5 file in the layout of Data Exchange or NXtomo; none for all other files.
///
/// A path that names an array, as in `FILE.h5:/group/name`, is a plain stack.
///
/// # Errors
/// Those of reading the file, and [`trgs_core::Error::Invalid`] in a build without the feature `hdf5`.
pub fn read_scan_file(path: impl AsRef<Path>) -> Result<Option<ScanFile>> {
    let path = path.as_ref();
    match array_path::is_hdf5(path) && array_path::parts(path).1.is_none() {
        true => scan_of(path),
        false => Ok(None),
    }
}

#[cfg(any(feature = "hdf5", test))]
fn scan_of(path: &Path) -> Result<Option<ScanFile>> {
    super::super::hdf5::Hdf5::read(path)?.scan()
}

#[cfg(not(any(feature = "hdf5", test)))]
fn scan_of(path: &Path) -> Result<Option<ScanFile>> {
    std::fs::metadata(path).map_err(|source| trgs_core::error::Error::read(path, source))?;
    Err(super::super::volume_file::no_hdf5(path))
}
