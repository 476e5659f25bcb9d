//! Unit and place of a scan: how scene units relate to the lengths and positions of its files.
//!
//! Everything inside is in scene units ([`geometry`](trgs_core::geometry)). A [`Frame`] keeps what the files state besides:
//! their unit of length, and where the scene lies. A point `p` of the scene has the position
//!
//! ```text
//! origin + directions·p/scale
//! ```
//!
//! in the coordinates of ITK (x to the patient's left, y to the back, z to the head), in the unit of the files. Densities
//! are per this unit: a volume whose lengths are in millimetres holds attenuation per millimetre.
//!
//! The key `frame` of a `meta_data.json` written by this program holds the frame of the files that the scan came from:
//!
//! ```json
//! "frame": { "unit": "mm", "scene_units_per_unit": 0.01, "origin": [0, 0, 0],
//!            "directions": [[1, 0, 0], [0, 1, 0], [0, 0, 1]] }
//! ```
//!
//! Every entry may be missing. `directions` are unit vectors along x, y and z of the scene. The key `unit` of the file or
//! of its `scanner` states the unit of the lengths in a file of another program.

mod arrange;

use super::unit::Unit;
use super::volume_file::{self, STRAIGHT, VolumeFile};
use glam::{DMat3, DVec3};
use serde::{Deserialize, Serialize};
use std::path::Path;
use trgs_core::error::{Error, Result};
use trgs_core::geometry::{Grid, Volume};

/// Digits that a length keeps: fewer than those that rounding by the scale changes.
const DIGITS: i32 = 12;
/// Deviation of directions from perpendicular unit vectors that counts as rounding to a few digits.
const PERPENDICULAR: f64 = 1e-4;

/// How scene units relate to the lengths and positions of files.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Frame {
    /// The unit of length; `None` if it is not stated.
    pub unit: Option<Unit>,
    /// Scene units per unit of length.
    pub scale: f64,
    /// Position of the scene's origin, in the unit of length.
    pub origin: DVec3,
    /// Directions of the scene's x, y and z, one unit vector per column; they may be left-handed.
    pub directions: DMat3,
}

impl Default for Frame {
    fn default() -> Self {
        Self::scaled(1.0)
    }
}

impl Frame {
    /// A frame of so many scene units per unit of length, which is not stated.
    pub fn scaled(scale: f64) -> Self {
        Self { unit: None, scale, origin: DVec3::ZERO, directions: STRAIGHT }
    }

    /// The grid and the frame of a volume that is scanned: its middle is the origin, its longest side 2.
    ///
    /// Voxels are cubes unless the file states their spacing. A file that does not has no frame but scene units.
    ///
    /// # Errors
    /// For a volume without voxels.
    pub fn around(file: &VolumeFile) -> Result<(Self, Grid)> {
        Self::around_shape(file, file.values.dim().into())
    }

    /// [`Self::around`] of a volume with these metadata and this shape, `[x, y, z]`.
    ///
    /// # Errors
    /// For a volume without voxels.
    pub fn around_shape(file: &VolumeFile, shape: [usize; 3]) -> Result<(Self, Grid)> {
        let counts = DVec3::from_array(shape.map(|n| n as f64));
        let sides = counts * file.spacing.unwrap_or(DVec3::ONE);
        let corner = sides / sides.max_element();
        let grid = Grid::new(shape, -corner, corner)?;
        let Some(spacing) = file.spacing else { return Ok((Self::default(), grid)) };
        let to_middle = file.directions * ((counts - 1.0) / 2.0 * spacing);
        let origin = file.origin.map_or(DVec3::ZERO, |first| first + to_middle);
        Ok((Self { unit: file.unit, scale: 2.0 / sides.max_element(), origin, directions: file.directions }, grid))
    }

    /// Spacing and centre of the first voxel of a grid, in the unit of length.
    pub fn place(&self, grid: &Grid) -> (DVec3, DVec3) {
        let origin = self.origin + self.directions * (grid.centre([0, 0, 0]) / self.scale);
        if *self == Self::default() {
            return (grid.spacing, origin);
        }
        // Rounding errors of the scale are not shown.
        let extent = (grid.size() / self.scale).max_element();
        let shown = |lengths: DVec3| DVec3::from_array(lengths.to_array().map(|length| rounded(length, extent)));
        (shown(grid.spacing / self.scale), shown(origin))
    }

    /// A length of the scene in the unit of length, without rounding errors of the scale.
    pub fn length(&self, scene: f64) -> f64 {
        if self.scale == 1.0 { scene } else { rounded(scene / self.scale, scene / self.scale) }
    }

    /// Scene units and the unit of length in a sentence.
    pub fn words(&self) -> String {
        match self.unit {
            Some(unit) => format!("1 {unit} is {} scene units", self.scale),
            None => format!("not stated; 1 of the files is {} scene units", self.scale),
        }
    }

    /// A volume of the scene as a file holds it: lengths and densities in the unit of length.
    pub fn file(&self, volume: &Volume) -> VolumeFile {
        VolumeFile { values: volume.values.clone(), ..self.metadata(&volume.grid) }
    }

    /// [`Self::file`] of a grid, without values.
    pub fn metadata(&self, grid: &Grid) -> VolumeFile {
        let (spacing, origin) = self.place(grid);
        VolumeFile {
            spacing: Some(spacing),
            origin: Some(origin),
            directions: self.directions,
            unit: self.unit,
            ..VolumeFile::default()
        }
    }

    /// The unit of length in words.
    pub fn unit_words(&self) -> &'static str {
        self.unit.map_or("not stated", Unit::symbol)
    }
}

/// Writes a volume of a scan in the scan's unit of length, and at its place; the format follows from the name.
///
/// `frame` is that of the [`Dataset`](super::Dataset); `Frame::default()` writes scene units.
///
/// # Errors
/// Those of [`volume_file::write()`].
pub fn write_volume(path: impl AsRef<Path>, volume: &Volume, frame: &Frame) -> Result<()> {
    volume_file::write(path.as_ref(), &frame.file(volume))
}

/// A length with the digits that matter beside `extent`, without a negative zero.
fn rounded(length: f64, extent: f64) -> f64 {
    let exponent = format!("{extent:e}").split_once('e').and_then(|(_, exponent)| exponent.parse::<i32>().ok());
    let decimals = usize::try_from(DIGITS - exponent.unwrap_or(0)).unwrap_or(0);
    format!("{length:.decimals$}").parse().unwrap_or(length) + 0.0
}

/// The key `frame` of a description.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct FrameMeta {
    #[serde(default, skip_serializing_if = "Option::is_none")]
    unit: Option<String>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    scene_units_per_unit: Option<f64>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    origin: Option<[f64; 3]>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    directions: Option<[[f64; 3]; 3]>,
}

impl FrameMeta {
    /// The key for a frame; `None` for scene units, which need none.
    pub(super) fn of(frame: &Frame) -> Option<Self> {
        (*frame != Frame::default()).then(|| Self {
            unit: frame.unit.map(|unit| unit.symbol().into()),
            scene_units_per_unit: Some(frame.scale),
            origin: (frame.origin != DVec3::ZERO).then(|| frame.origin.to_array()),
            directions: (frame.directions != STRAIGHT).then(|| frame.directions.to_cols_array_2d()),
        })
    }

    /// The frame of a file with `scale` scene units per unit of its lengths, whose unit it may state elsewhere, too.
    ///
    /// # Errors
    /// For an unknown unit, two different ones, and numbers that are no frame.
    pub(super) fn frame(&self, stated: &[&str], scale: f64) -> Result<Frame> {
        let names = self.unit.iter().map(String::as_str).chain(stated.iter().copied());
        let units = names.map(str::parse).collect::<Result<Vec<Unit>>>()?;
        if let Some(other) = units.iter().find(|unit| **unit != units[0]) {
            let expected = "one unit of length";
            return Err(Error::invalid("unit", format!("{} and {other}", units[0]), expected, "remove one of the two"));
        }
        let wrong = |what: &str, got: String, expected: &str| {
            Err(Error::invalid(format!("{what} of frame"), got, expected, "correct it, or remove the key frame"))
        };
        let stated_scale = self.scene_units_per_unit.unwrap_or(scale);
        if !(stated_scale > 0.0 && stated_scale.is_finite()) {
            return wrong("scene_units_per_unit", stated_scale.to_string(), "a positive number");
        }
        // The entry is for files in scene units; others state their scale by sVoxel.
        if scale != 1.0 && (stated_scale / scale - 1.0).abs() > PERPENDICULAR {
            let expected = format!("{scale} = 2/max(sVoxel), or lengths in scene units");
            return wrong("scene_units_per_unit", stated_scale.to_string(), &expected);
        }
        let origin = DVec3::from_array(self.origin.unwrap_or_default());
        if !origin.is_finite() {
            return wrong("origin", format!("{origin}"), "three finite numbers");
        }
        let directions = self.directions.map_or(STRAIGHT, |axes| DMat3::from_cols_array_2d(&axes));
        if !(directions.transpose() * directions).abs_diff_eq(DMat3::IDENTITY, PERPENDICULAR) {
            return wrong("directions", format!("{:?}", self.directions), "three perpendicular unit vectors");
        }
        Ok(Frame { unit: units.first().copied(), scale: stated_scale, origin, directions })
    }
}

#[cfg(test)]
mod tests;
