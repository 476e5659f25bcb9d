//! A volume in a file, brought to the axes of a scan.

use super::{Frame, Unit};
use crate::volume_file::{STRAIGHT, Stored, VolumeFile, turned};
use glam::DVec3;
use ndarray::Array3;
use trgs_core::error::{Error, Result};
use trgs_core::geometry::{Grid, Volume, check_finite_from, check_shape};

/// The names of the axes of an array.
const AXES: [&str; 3] = ["x", "y", "z"];
/// Voxels by which two grids may differ at their ends and be the same: nearest voxels still match.
const HALF: f64 = 0.5;

/// How the array of a file lies on the grid of a scan.
///
/// The array is turned and mirrored to the directions of the scan's [`Frame`]. It lies on the scan's grid if all voxels
/// then agree within half a voxel. Where the file or the scan states no unit, they agree if a common factor of all lengths
/// makes them so.
#[derive(Clone, Debug, PartialEq)]
struct Arrangement {
    /// For each axis of the scan: the axis of the array, and whether it is reversed. `None` for oblique axes.
    axes: Option<[(usize, bool); 3]>,
    /// What the values are multiplied by: they are per unit of length of the file.
    factor: f64,
    /// What differs from the scan's grid, as far as the file states it.
    difference: Option<Difference>,
}

/// The first difference of two grids, in words.
#[derive(Clone, Debug, PartialEq)]
enum Difference {
    Axes(String),
    Shape,
    Spacing(String),
    Place(String),
}

impl Arrangement {
    /// The arrangement of a file on the grid of a scan.
    fn of(file: &VolumeFile, shape: [usize; 3], grid: &Grid, frame: &Frame) -> Self {
        let axes = axes(file, shape, frame);
        let differs = |difference| Self { axes, factor: 1.0, difference: Some(difference) };
        let Some(axes) = axes else {
            let [of_file, of_scan] = [file, &VolumeFile { directions: frame.directions, ..VolumeFile::default() }]
                .map(|volume| [0, 1, 2].map(|axis| volume.directions.col(axis).to_string()).join(", "));
            return differs(Difference::Axes(format!(
                "its axes have the directions {of_file}, oblique to those of the scan, {of_scan}"
            )));
        };
        if axes.map(|(axis, _)| shape[axis]) != grid.shape {
            return differs(Difference::Shape);
        }
        let (spacing, _) = frame.place(grid);
        let counts = DVec3::from_array(grid.shape.map(|n| n as f64));
        // Both in the unit of the scan, if it is known.
        let units = file.unit.zip(frame.unit).map(|(file, scan)| file.millimetres() / scan.millimetres());
        let same_unit = units.unwrap_or(1.0);
        let stated = file.spacing.map(|stated| DVec3::from_array(axes.map(|(axis, _)| stated[axis])) * same_unit);
        let ratios = stated.map_or(DVec3::ONE, |stated| stated / spacing);
        let common = if units.is_some() { 1.0 } else { ratios.element_sum() / 3.0 };
        let off_at_the_ends = ((ratios / common - 1.0) * counts / 2.0).abs().max_element();
        if off_at_the_ends > HALF {
            let stated = stated.unwrap_or_default();
            return differs(Difference::Spacing(format!("its spacing {stated} is not that of the scan, {spacing}")));
        }
        if let (Some(origin), Some(stated)) = (file.origin, file.spacing) {
            let counts = DVec3::from_array(shape.map(|n| n as f64));
            let middle = origin + file.directions * ((counts - 1.0) / 2.0 * stated);
            let middle = middle * same_unit / common;
            let expected = frame.origin + frame.directions * ((grid.min + grid.size() / 2.0) / frame.scale);
            let apart = (frame.directions.transpose() * (middle - expected) / spacing).abs().max_element();
            if apart > HALF {
                let words = format!("its middle is at {middle}, that of the scan's volume at {expected}");
                return differs(Difference::Place(words));
            }
        }
        Self { axes: Some(axes), factor: units.map_or(1.0, f64::recip), difference: None }
    }

    /// What is done to the array, one sentence each.
    fn remarks(&self, file: Option<Unit>, scan: Option<Unit>) -> Vec<String> {
        let axis =
            |(axis, is_reversed): (usize, bool)| format!("{}{}", ["", "-"][usize::from(is_reversed)], AXES[axis]);
        let turned = self.axes.filter(|_| self.is_turned()).map(|axes| {
            format!("its axes {} are those of the scan: the array is turned to them", axes.map(axis).join(", "))
        });
        let scaled = file.zip(scan).filter(|_| self.factor != 1.0).map(|(file, scan)| {
            format!("its values per {file} are multiplied by {}: those of the scan are per {scan}", self.factor)
        });
        turned.into_iter().chain(scaled).collect()
    }

    /// Whether axes are exchanged or reversed.
    fn is_turned(&self) -> bool {
        self.axes != Some([(0, false), (1, false), (2, false)])
    }

    /// The array in the order of the scan.
    fn apply(&self, values: Array3<f32>) -> Array3<f32> {
        turned(values, self.axes.expect("oblique axes are refused"), self.factor)
    }
}

/// The axis of the array along each axis of the scan, if they are parallel within half a voxel at the ends.
fn axes(file: &VolumeFile, shape: [usize; 3], frame: &Frame) -> Option<[(usize, bool); 3]> {
    if file.origin.is_none() && file.directions == STRAIGHT {
        // Formats that state no place state no axes, either: the array is in the order of the scan.
        return Some([(0, false), (1, false), (2, false)]);
    }
    let relative = frame.directions.transpose() * file.directions;
    let mut axes = [None; 3];
    for (axis, &n) in shape.iter().enumerate() {
        let along = relative.col(axis);
        let of_scan = (0..3).max_by(|&a, &b| along[a].abs().total_cmp(&along[b].abs()))?;
        let sideways = (1.0 - along[of_scan] * along[of_scan]).max(0.0).sqrt();
        if sideways * n as f64 / 2.0 > HALF || axes[of_scan].is_some() {
            return None;
        }
        axes[of_scan] = Some((axis, along[of_scan] < 0.0));
    }
    Some([axes[0]?, axes[1]?, axes[2]?])
}

impl Frame {
    /// The volume of a file on the grid of a scan, and remarks, one sentence each.
    ///
    /// A file that states axes is turned to those of the scan. One whose spacing or place differs is taken as it is, with a
    /// remark, unless it has to be turned, too.
    ///
    /// # Errors
    /// For another shape, and for axes that are not those of the scan's grid.
    pub fn arrange(&self, file: VolumeFile, grid: &Grid) -> Result<(Volume, Vec<String>)> {
        let (arrangement, remarks) = self.arrangement(&file, file.values.dim().into(), grid)?;
        Ok((Volume::new(*grid, arrangement.apply(file.values))?, remarks))
    }

    /// [`Self::arrange`] of a volume that is read by slabs. The remarks are among its metadata.
    ///
    /// # Errors
    /// Those of [`Self::arrange`] and [`Stored::each`].
    pub fn arrange_stored(&self, stored: Stored, grid: &Grid) -> Result<Stored> {
        let (Arrangement { axes, factor, .. }, oddities) = self.arrangement(stored.metadata(), stored.shape(), grid)?;
        let axes = axes.expect("oblique axes are refused");
        let mut stored = stored.turned(VolumeFile { oddities, ..self.metadata(grid) }, axes, factor);
        check_shape(grid, &stored.shape())?;
        stored.each(0, |first, slab| check_finite_from("volume", first, &slab))?;
        Ok(stored)
    }

    /// How an array of a shape lies on the grid of a scan, and remarks.
    fn arrangement(&self, file: &VolumeFile, shape: [usize; 3], grid: &Grid) -> Result<(Arrangement, Vec<String>)> {
        let arrangement = Arrangement::of(file, shape, grid, self);
        let mut remarks = file.other_oddities();
        remarks.extend(arrangement.remarks(file.unit, self.unit));
        match &arrangement.difference {
            Some(Difference::Axes(words)) => return Err(not_of_the_scan(words)),
            Some(Difference::Spacing(words) | Difference::Place(words)) if arrangement.is_turned() => {
                return Err(not_of_the_scan(&format!("{}, but {words}", remarks.join("; "))));
            }
            Some(Difference::Spacing(words) | Difference::Place(words)) => {
                remarks.push(format!("{words}: its voxels are taken as those of the scan, in their order"));
            }
            // Another shape is an error of the volume.
            Some(Difference::Shape) | None => {}
        }
        Ok((arrangement, remarks))
    }

    /// The values of a file that a scan names as its volume, and remarks.
    ///
    /// As [`Self::arrange`], but the array of a file in another place is taken in its own order.
    pub(crate) fn arrange_own(&self, file: VolumeFile, grid: &Grid) -> (Array3<f32>, Vec<String>) {
        let arrangement = Arrangement::of(&file, file.values.dim().into(), grid, self);
        if arrangement.difference.is_none() {
            let mut remarks = file.other_oddities();
            remarks.extend(arrangement.remarks(file.unit, self.unit));
            return (arrangement.apply(file.values), remarks);
        }
        let mut remarks = file.oddities;
        if let Some(Difference::Spacing(words)) = arrangement.difference {
            remarks.push(format!("{words}, which is read"));
        }
        (file.values, remarks)
    }
}

fn not_of_the_scan(got: &str) -> Error {
    let expected = "the scan's grid, also turned or mirrored";
    let remedy = "resample it on the grid of a volume of the scan; or convert it to .npy, which states no axes, if its array \
                  is in the order of the scan";
    Error::invalid("place of the volume", got, expected, remedy)
}
