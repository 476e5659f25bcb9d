//! The place of a volume in a `.npy`, which states none itself.

use super::{STRAIGHT, VolumeFile};
use crate::output::write_atomically;
use crate::unit::Unit;
use glam::{DMat3, DVec3};
use serde::{Deserialize, Serialize};
use std::io::ErrorKind;
use std::path::{Path, PathBuf};
use trgs_core::error::{Error, Result};
use trgs_core::words::utf8;

/// The side file `name.npy.json`, which runs write beside their volume:
///
/// ```json
/// { "shape": [64, 64, 64], "unit": "mm", "spacing": [0.5, 0.5, 0.5], "origin": [-15.75, -15.75, -15.75],
///   "directions": [[1, 0, 0], [0, 1, 0], [0, 0, 1]] }
/// ```
///
/// Without `unit`, the unit is not known; `directions` are unit vectors along the axes of the array. It describes an array
/// of its shape only.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct NpySide {
    shape: [usize; 3],
    #[serde(default, skip_serializing_if = "Option::is_none")]
    unit: Option<String>,
    spacing: [f64; 3],
    origin: [f64; 3],
    #[serde(default, skip_serializing_if = "Option::is_none")]
    directions: Option<[[f64; 3]; 3]>,
}

impl NpySide {
    /// The path of the side file of an array.
    pub fn path(array: &Path) -> PathBuf {
        let mut name = array.as_os_str().to_owned();
        name.push(".json");
        name.into()
    }

    /// Writes the side file of the array `array`, which holds the values of the volume, of this shape `[x, y, z]`.
    ///
    /// # Errors
    /// [`Error::Write`].
    pub fn write(array: &Path, shape: [usize; 3], volume: &VolumeFile) -> Result<()> {
        let side = Self {
            shape,
            unit: volume.unit.map(|unit| unit.symbol().into()),
            spacing: volume.spacing.unwrap_or(DVec3::ONE).to_array(),
            origin: volume.origin.unwrap_or(DVec3::ZERO).to_array(),
            directions: (volume.directions != STRAIGHT).then(|| volume.directions.to_cols_array_2d()),
        };
        write_atomically(&Self::path(array), |file| Ok(serde_json::to_writer_pretty(file, &side)?))
    }

    /// What a side file states of an array of a shape, if there is one; without values.
    pub(super) fn beside(array: &Path, shape: [usize; 3]) -> Result<VolumeFile> {
        let path = Self::path(array);
        let text = match crate::input::read(&path) {
            Ok(text) => text,
            Err(error) if [ErrorKind::NotFound, ErrorKind::NotADirectory].contains(&error.kind()) => {
                return Ok(VolumeFile::default());
            }
            Err(error) => return Err(Error::read(&path, error)),
        };
        Self::parse(&text, &path)?.of(shape, &path)
    }

    /// Parses the content of a side file; `path` names it in errors.
    ///
    /// # Errors
    /// [`Error::Format`] for anything but the fields above.
    pub fn parse(text: &[u8], path: &Path) -> Result<Self> {
        serde_json::from_slice(&utf8(text)).map_err(|error| wrong(path, error.to_string()))
    }

    fn of(&self, shape: [usize; 3], path: &Path) -> Result<VolumeFile> {
        if shape != self.shape {
            let remark = format!(
                "{} describes an array of shape {:?}, not of {shape:?}: it is not read",
                path.file_name().unwrap_or_default().to_string_lossy(),
                self.shape
            );
            return Ok(VolumeFile { oddities: vec![remark], ..VolumeFile::default() });
        }
        let unit = self.unit.as_deref().map(str::parse::<Unit>).transpose().map_err(|error| error.in_file(path))?;
        let is_length = |side: &f64| *side > 0.0 && side.is_finite();
        let axes = self.directions.map(|axes| axes.map(DVec3::from_array));
        let is_sound = self.spacing.iter().all(is_length)
            && self.origin.iter().all(|position| position.is_finite())
            && axes.is_none_or(|axes| DMat3::from_cols_array_2d(&axes.map(Into::into)).determinant().abs() > 0.0);
        if !is_sound {
            return Err(wrong(path, format!("{self:?}")));
        }
        let (spacing, origin) = (DVec3::from_array(self.spacing), DVec3::from_array(self.origin));
        let placed = VolumeFile::new(Some(spacing), Some(origin), axes);
        // Its directions are those of a scan, and nothing unusual.
        Ok(VolumeFile { unit, oddities: Vec::new(), ..placed })
    }
}

fn wrong(path: &Path, got: String) -> Error {
    let expected = "JSON with shape, spacing and origin, and perhaps unit and directions, of three numbers each";
    Error::format(path, "side file", got, expected, "delete it: the array is then read without a place")
}
