//! Projections and volumes that a description names, in any format of images and volumes.

use crate::frame::Frame;
use crate::npy;
use crate::volume_file::{self, VolumeFile};
use ndarray::{Array2, Array3, Axis, Ix2, Ix3};
use std::path::Path;
use trgs_core::error::{Error, Result};
use trgs_core::geometry::Grid;

/// Whether a file is read as a NumPy array: one whose extension states no other format is.
fn is_array(path: &Path) -> bool {
    let is_npy = path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("npy"));
    is_npy || !(volume_file::is_volume(path) || path.is_dir())
}

/// Adds remarks that are not there yet: many views share theirs.
fn add(oddities: &mut Vec<String>, of: &str, found: Vec<String>) {
    for oddity in found.into_iter().map(|oddity| format!("{of}: {oddity}")) {
        if !oddities.contains(&oddity) {
            oddities.push(oddity);
        }
    }
}

/// A projection `[v, u]`: an array, or an image whose rows are v.
pub(super) fn read_image(path: &Path, oddities: &mut Vec<String>) -> Result<Array2<f32>> {
    if is_array(path) {
        return npy::read_f32::<Ix2>(path, "[v, u]");
    }
    let VolumeFile { values, oddities: found, .. } = volume_file::read(path)?;
    let (columns, rows, pages) = values.dim();
    if pages != 1 {
        let got = format!("{pages} pages of {rows} rows and {columns} columns");
        let remedy = "write one file for each view, or convert the stack to a scan";
        return Err(Error::format(path, "projection", got, "one page, [v, u]", remedy));
    }
    add(oddities, "projections", found);
    Ok(values.index_axis_move(Axis(2), 0).reversed_axes().as_standard_layout().into_owned())
}

/// The values `[x, y, z]` of a volume, in the order of the scan.
pub(super) fn read_values(path: &Path, grid: &Grid, frame: &Frame, oddities: &mut Vec<String>) -> Result<Array3<f32>> {
    if is_array(path) {
        return npy::read_f32::<Ix3>(path, "[x, y, z]");
    }
    let (values, found) = frame.arrange_own(volume_file::read(path)?, grid);
    add(oddities, "true volume", found);
    Ok(values)
}
