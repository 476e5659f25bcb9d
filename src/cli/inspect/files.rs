//! Summaries of volumes, stacks and angles: the files that `trgs convert` reads.

use super::range;
use crate::cli::flags::with_flags;
use serde_json::{Value, json};
use std::path::Path;
use trgs::Result;
#[cfg(feature = "hdf5")]
use trgs::scan::hdf5::Hdf5;
use trgs::scan::plausibility::{self, AnglesFrom};
use trgs::scan::volume_file::{self, VolumeFile};
use trgs::scan::{Unit, stack};

/// A volume, or a folder of slices: one of `.npy` is a stack of projections.
pub(super) fn volume(path: &Path) -> Result<Value> {
    let (kind, volume) = match volume_file::read(path) {
        Ok(volume) => ("volume [x, y, z], or projections with x = u, y = v, z = view", volume),
        Err(error) if !path.is_dir() => return Err(error),
        Err(error) => match stack::read_with_oddities(path) {
            Ok((values, oddities)) => {
                let volume = VolumeFile { values, oddities, ..VolumeFile::default() };
                ("stack of projections [view, v, u]", volume)
            }
            Err(_) => return Err(error),
        },
    };
    let VolumeFile { values, spacing, origin, directions, unit, mut oddities } = volume;
    let not_finite = values.iter().filter(|value| !value.is_finite()).count();
    if not_finite > 0 {
        oddities.push(format!("{not_finite} values are not finite"));
    }
    let ends = range(&values);
    if matches!(ends.as_array().map(Vec::as_slice), Some([low, high]) if low == high) {
        oddities.push("all values are equal".into());
    }
    let is_straight = directions == volume_file::STRAIGHT;
    Ok(json!({
        "kind": kind,
        "shape": <[usize; 3]>::from(values.dim()),
        "values": ends,
        "unit": spacing.map(|_| unit.map_or("not stated", Unit::symbol)),
        "spacing": spacing.map(|spacing| spacing.to_array()),
        "origin": origin.map(|origin| origin.to_array()),
        "directions": (!is_straight).then(|| directions.to_cols_array()),
        "oddities": oddities,
    }))
}

/// An HDF5 file, or an array of one.
#[cfg(feature = "hdf5")]
pub(super) fn hdf5(path: &Path) -> Result<Value> {
    if let Some(scan) = stack::read_scan_file(path)? {
        let radians = scan.angles.as_ref().map(range);
        let oddities: Vec<_> = scan.remarks.iter().map(with_flags).collect();
        return Ok(json!({
            "kind": "scan in HDF5: frames [view, v, u], with fields and angles",
            "shape": <[usize; 3]>::from(scan.frames.dim()),
            "values": range(&scan.frames),
            "flat": scan.flat.as_ref().map(range),
            "dark": scan.dark.as_ref().map(range),
            "radians": radians,
            "oddities": oddities,
        }));
    }
    if let Ok(found) = volume(path) {
        return Ok(found);
    }
    // Several arrays: they are named.
    let file = Hdf5::read(path).map_err(|error| if path.exists() { error } else { volume(path).unwrap_err() })?;
    let arrays = file
        .entries()
        .iter()
        .map(|entry| (entry.name.clone(), json!({ "shape": entry.shape, "numbers": entry.numbers })));
    Ok(json!({
        "kind": "HDF5 file; FILE:/group/name names an array",
        "arrays": arrays.collect::<Value>(),
        "oddities": file.limit().into_iter().collect::<Vec<_>>(),
    }))
}

/// The error of a build without the feature.
#[cfg(not(feature = "hdf5"))]
pub(super) fn hdf5(path: &Path) -> Result<Value> {
    volume(path)
}

/// Angles of views in a text or a table.
pub(super) fn angles(path: &Path) -> Result<Value> {
    // A header may state degrees, which are then asked for.
    let (angles, in_degrees) = match stack::read_angles(path, false) {
        Ok(angles) => (angles, false),
        Err(error) => (stack::read_angles(path, true).map_err(|_| error)?, true),
    };
    let unusual = plausibility::check_radians(&angles, AnglesFrom::Stack).err().filter(|_| !in_degrees);
    let oddities = [
        angles.is_empty().then(|| "there is no angle".to_owned()),
        unusual.map(|error| with_flags(&error.text())),
        in_degrees.then(|| "its header states degrees: give --degrees to trgs convert".to_owned()),
    ];
    Ok(json!({
        "kind": "angles",
        "views": angles.len(),
        "radians": range(&angles),
        "oddities": oddities.into_iter().flatten().collect::<Vec<_>>(),
    }))
}
