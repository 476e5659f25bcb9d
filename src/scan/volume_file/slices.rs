//! A volume as a folder of slices across z: PNG of 16 bits, or a DICOM series.
//!
//! Stored numbers are whole, 0 to 65,535, from the lowest to the highest value.

use super::scaling::Scaling;
use super::{VolumeFile, per_millimetre};
use crate::output::write_atomically;
use ndarray::{Array2, Axis};
use serde::Serialize;
use std::path::Path;
use trgs_core::error::Result;

trgs_core::described! {
    /// A format of slices.
    #[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
    #[serde(rename_all = "kebab-case")]
    pub enum Slices {
        /// A DICOM series.
        Dicom,
        /// PNG of 16 bits.
        Png,
    }
}

/// Writes the slices of a volume to an existing folder: rows are y, columns are x. Lengths of a known unit are written in
/// millimetres, and the values as attenuation per millimetre. Values that are not finite are the lowest.
///
/// # Errors
/// [`Error::Write`](trgs_core::error::Error::Write), or [`Error::Invalid`](trgs_core::error::Error::Invalid) for DICOM in a
/// build without it.
pub fn write_slices(folder: &Path, volume: &VolumeFile, format: Slices) -> Result<Scaling> {
    let values = per_millimetre(volume);
    let scaling = Scaling::of(&values);
    match format {
        Slices::Png => {
            let slices = values.axis_iter(Axis(2)).enumerate();
            slices.map(|(index, slice)| (index + 1, slice)).try_for_each(|(number, slice)| {
                png(&folder.join(format!("slice_{number:04}.png")), &scaling.numbers(slice))
            })?;
        }
        #[cfg(any(feature = "dicom", test))]
        Slices::Dicom => super::dicom::write(folder, &values, &super::Place::of(volume), scaling)?,
        #[cfg(not(any(feature = "dicom", test)))]
        Slices::Dicom => return Err(super::no_dicom(folder)),
    }
    Ok(scaling)
}

fn png(path: &Path, pixels: &Array2<u16>) -> Result<()> {
    let (rows, columns) = pixels.dim();
    let bytes: Vec<u8> = pixels.iter().flat_map(|number| number.to_be_bytes()).collect();
    write_atomically(path, |file| {
        let mut encoder = png::Encoder::new(file, columns as u32, rows as u32);
        encoder.set_color(png::ColorType::Grayscale);
        encoder.set_depth(png::BitDepth::Sixteen);
        Ok(encoder.write_header()?.write_image_data(&bytes)?)
    })
}

#[cfg(test)]
mod tests {
    use super::super::read;
    use super::*;
    use crate::Unit;
    use glam::{DMat3, DVec3};
    use ndarray::Array3;

    /// Values in micrometres, along turned axes.
    fn volume() -> VolumeFile {
        VolumeFile {
            values: Array3::from_shape_fn((3, 4, 5), |(x, y, z)| (100 * x + 10 * y + z) as f32 - 7.0),
            spacing: Some(DVec3::new(500.0, 250.0, 125.0)),
            origin: Some(DVec3::new(-1000.0, 2000.0, 3500.0)),
            directions: DMat3::from_cols(DVec3::Y, DVec3::X, DVec3::NEG_Z),
            unit: Some(Unit::Micrometre),
            oddities: Vec::new(),
        }
    }

    #[test]
    fn a_dicom_series_reads_back_at_its_place() {
        let folder = tempfile::tempdir().unwrap();
        let scaling = write_slices(folder.path(), &volume(), Slices::Dicom).unwrap();
        let (found, expected) = (read(folder.path()).unwrap(), volume());
        assert_eq!(found.values.dim(), (3, 4, 5));
        assert_eq!(found.spacing, Some(DVec3::new(0.5, 0.25, 0.125)));
        assert_eq!(found.origin, Some(DVec3::new(-1.0, 2.0, 3.5)));
        assert_eq!(found.directions, expected.directions);
        // Per millimetre there is a thousand times the attenuation per micrometre.
        let errors = found.values.iter().zip(&expected.values).map(|(a, b)| f64::from((a - 1000.0 * b).abs()));
        within!(errors.fold(0.0, f64::max) / scaling.step);
    }

    #[test]
    fn other_volumes_are_other_series() {
        let folder = tempfile::tempdir().unwrap();
        let content = |volume: &VolumeFile| {
            write_slices(folder.path(), volume, Slices::Dicom).unwrap();
            std::fs::read(folder.path().join("slice_0002.dcm")).unwrap()
        };
        let first = content(&volume());
        assert_eq!(content(&volume()), first);
        let mut other = volume();
        other.values[[0, 0, 4]] += 0.5;
        assert_ne!(content(&other), first);
    }

    #[test]
    fn png_slices_hold_the_range_of_the_values() {
        let folder = tempfile::tempdir().unwrap();
        let mut file = VolumeFile { unit: None, ..volume() };
        let scaling = write_slices(folder.path(), &file, Slices::Png).unwrap();
        assert_eq!((scaling.offset, scaling.step), (-7.0, 234.0 / 65535.0));
        let found = read(folder.path()).unwrap();
        let back = found.values.mapv(|number| scaling.offset + scaling.step * f64::from(number));
        let errors = back.iter().zip(&file.values).map(|(a, b)| (a - f64::from(*b)).abs());
        within!(errors.fold(0.0, f64::max) / scaling.step);
        file.values.fill(f32::NAN);
        assert_eq!(write_slices(folder.path(), &file, Slices::Png).unwrap(), Scaling { offset: 0.0, step: 1.0 });
    }
}
