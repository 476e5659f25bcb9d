//! Projections of any origin: a stack of images and their angles.
//!
//! | stack | frames |
//! |---|---|
//! | `.npy` | `[view, v, u]`; `[v, u]` is one frame |
//! | folder of `.npy` | `[v, u]` each, in natural order of names |
//! | formats of [`super::volume_file`] | z is the view, y is v, x is u: a TIFF page is a view, its rows are v |
//!
//! A folder of images (`.tif`, `.png`, `.jpg`, `.raw`) has one frame per file.

mod angles;
mod scan_file;
mod series;

pub use angles::{AngleUnit, parse_angles, read_angles};
pub use scan_file::{ScanFile, read_scan_file};
pub use series::{Series, read_series};

pub mod rtk;

pub use rtk::RtkGeometry;

use super::dataset::{Dataset, Description};
use super::npy;
use super::volume_file::{self, VolumeFile, files, with_extension};
use crate::limit;
use ndarray::{Array3, Axis, Ix2, Ix3};
use std::path::Path;
use trgs_core::error::{Error, Result};
use trgs_core::geometry::{Projections, Trajectory};
use trgs_core::words::counted;

/// Relative difference of steps between angles from which on both are stated.
const UNEVEN: f64 = 1e-3;

/// How frames are oriented relative to the geometry page.
///
/// There, row 0 is on top, columns run along u and angles are counter-clockwise.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Orientation {
    /// Row 0 is at the bottom.
    pub flip_rows: bool,
    /// Column 0 is at the opposite side.
    pub flip_columns: bool,
    /// Angles are counted clockwise, seen from +z.
    pub clockwise: bool,
}

/// Reads a stack `[view, v, u]`.
///
/// # Errors
/// [`Error::Read`], [`Error::Invalid`] for an unknown extension, or [`Error::Format`] for the first content that does
/// not fit.
pub fn read(path: impl AsRef<Path>) -> Result<Array3<f32>> {
    read_with_oddities(path).map(|(stack, _)| stack)
}

/// [`read`], with the unusual properties of the files, one sentence each.
///
/// # Errors
/// Those of [`read`].
pub fn read_with_oddities(path: impl AsRef<Path>) -> Result<(Array3<f32>, Vec<String>)> {
    let path = path.as_ref();
    if path.is_dir() {
        let files = files(path)?;
        let frames = with_extension(&files, &["npy"]);
        if !frames.is_empty() {
            return Ok((read_frames(&frames)?, Vec::new()));
        }
    } else if path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("npy")) {
        let values = npy::read(path)?.numbers.into_f32();
        let values = if values.ndim() == 2 { values.insert_axis(Axis(0)) } else { values };
        return Ok((npy::with_axes::<f32, Ix3>(values, path, "stack", "[view, v, u]")?, Vec::new()));
    } else if path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("npz")) {
        // NumPy's axes, as in `.npy`; a volume's are [x, y, z].
        let volume = volume_file::read(path)?;
        return Ok((volume.values, volume.oddities));
    }
    let VolumeFile { values, oddities, .. } = volume_file::read_in_any_order(path)?;
    let values = values.reversed_axes();
    Ok((if values.is_standard_layout() { values } else { values.as_standard_layout().into_owned() }, oddities))
}

fn read_frames(paths: &[&Path]) -> Result<Array3<f32>> {
    let (mut shape, mut values) = ((0, 0), Vec::new());
    for (view, path) in paths.iter().enumerate() {
        let frame = npy::read_f32::<Ix2>(path, "[v, u]")?;
        if view == 0 {
            shape = frame.dim();
            values = limit::room(format!("{} frames of shape {shape:?}", paths.len()), paths.len() * frame.len())?;
        }
        if frame.dim() != shape {
            let expected = format!("{shape:?}, that of the first file");
            return Err(Error::format(path, "frame", format!("shape {:?}", frame.shape()), expected, "take it out"));
        }
        values.extend(frame);
    }
    Ok(Array3::from_shape_vec((paths.len(), shape.0, shape.1), values).expect("every frame has the shape of the first"))
}

/// A scan from a stack of dimensionless line integrals `[view, v, u]` and its angles (radians).
///
/// Lengths of the description are converted to scene units, and line integrals with them: densities remain per unit of
/// length of its [`Frame`](super::Frame).
///
/// # Errors
/// When frames have another shape than the detector, the numbers of angles and frames differ, or a value is not finite.
pub fn scan(
    name: &str,
    description: &Description,
    line_integrals: Array3<f32>,
    angles: Vec<f64>,
    orientation: Orientation,
) -> Result<Dataset> {
    let Description { scanner, scale, frame, .. } = description;
    let line_scale = frame.scale;
    let (views, rows, columns) = line_integrals.dim();
    if (rows, columns) != (scanner.detector.rows, scanner.detector.columns) {
        let expected = format!("{} × {} = nDetector = [v, u]", scanner.detector.rows, scanner.detector.columns);
        let remedy = "correct nDetector = [v, u], or reorder the stack: a page is a view, its rows are v";
        return Err(Error::invalid("frames", format!("{rows} rows × {columns} columns"), expected, remedy));
    }
    if angles.len() != views {
        return Err(Error::invalid(
            "angles",
            angles.len(),
            format!("one for each of {}", counted(views, "frame")),
            format!("give {}, one for each frame, or take out the frames that are no views", counted(views, "angle")),
        ));
    }
    // Rounding once, from f64, keeps a scale of 1 exact.
    let mut images = line_integrals.mapv_into(|value| (f64::from(value) * line_scale) as f32);
    for (flip, axis) in [(orientation.flip_rows, Axis(1)), (orientation.flip_columns, Axis(2))] {
        if flip {
            images.invert_axis(axis);
        }
    }
    let sense = if orientation.clockwise { -1.0 } else { 1.0 };
    let angles: Vec<f64> = angles.into_iter().map(|angle| sense * angle).collect();
    let poses = description.poses(&angles)?;
    let train = Projections::along(Trajectory { angles: &angles, poses: poses.as_deref() }, images)?;
    let oddities = description.oddities.clone();
    Ok(Dataset { scale: *scale, frame: *frame, oddities, ..Dataset::new(name, *scanner, train) })
}

/// The number of views, their first and last angle, and the step between them, as a sentence; angles in radians.
pub fn span(angles: &[f64]) -> String {
    let degrees = |angle: f64| format!("{:.2}°", angle.to_degrees());
    let (Some(&first), Some(&last)) = (angles.first(), angles.last()) else { return "no views".into() };
    let steps: Vec<f64> = angles.windows(2).map(|pair| pair[1] - pair[0]).collect();
    let fold = |pick: fn(f64, f64) -> bool| steps.iter().copied().reduce(|a, b| if pick(b, a) { b } else { a });
    let text = match (fold(|b, a| b < a), fold(|b, a| b > a)) {
        (Some(least), Some(most)) if most - least > UNEVEN * most.abs().max(least.abs()) => {
            format!("in steps of {} to {}", degrees(least), degrees(most))
        }
        (Some(_), Some(_)) => format!("in steps of {}", degrees((last - first) / steps.len() as f64)),
        _ => return format!("1 view at {}", degrees(first)),
    };
    format!("{} views from {} to {}, {text}", angles.len(), degrees(first), degrees(last))
}

#[cfg(test)]
mod tests;
