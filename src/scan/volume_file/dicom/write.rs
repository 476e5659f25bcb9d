//! Slices of a series: CT images of 16 bits, whose slope and intercept give the values.

use super::{
    BITS_ALLOCATED, BITS_STORED, COLUMNS, HIGH_BIT, INTERCEPT, IS_SIGNED, MODALITY, ORIENTATION, PHOTOMETRIC,
    PIXEL_SPACING, PIXELS, POSITION, ROWS, SAMPLES, SERIES, SLICE_THICKNESS, SLOPE,
};
use crate::output::write_atomically;
use crate::volume_file::{Place, Scaling};
use dicom_core::{DataElement, PrimitiveValue, VR};
use dicom_object::{FileMetaTableBuilder, InMemDicomObject, Tag};
use glam::DVec3;
use ndarray::{Array2, Array3, Axis};
use sha2::{Digest, Sha256};
use std::io;
use std::path::Path;
use trgs_core::error::{Error, Result};

const CT_IMAGE: &str = "1.2.840.10008.5.1.4.1.1.2";
const EXPLICIT_LITTLE_ENDIAN: &str = "1.2.840.10008.1.2.1";
const SOP_CLASS: Tag = Tag(0x0008, 0x0016);
const SOP_INSTANCE: Tag = Tag(0x0008, 0x0018);
const STUDY: Tag = Tag(0x0020, 0x000D);
const FRAME_OF_REFERENCE: Tag = Tag(0x0020, 0x0052);
/// Attributes that every CT image has: their values are not known.
const EMPTY: [(Tag, VR); 13] = [
    (Tag(0x0008, 0x0020), VR::DA),
    (Tag(0x0008, 0x0030), VR::TM),
    (Tag(0x0008, 0x0050), VR::SH),
    (Tag(0x0008, 0x0090), VR::PN),
    (Tag(0x0010, 0x0010), VR::PN),
    (Tag(0x0010, 0x0020), VR::LO),
    (Tag(0x0010, 0x0030), VR::DA),
    (Tag(0x0010, 0x0040), VR::CS),
    (Tag(0x0018, 0x0060), VR::DS),
    (Tag(0x0018, 0x5100), VR::CS),
    (Tag(0x0020, 0x0010), VR::SH),
    (Tag(0x0020, 0x0012), VR::IS),
    (Tag(0x0020, 0x1040), VR::LO),
];

/// Writes the slices of a volume as files of a folder.
pub(in crate::volume_file) fn write(
    folder: &Path,
    values: &Array3<f32>,
    place: &Place,
    scaling: Scaling,
) -> Result<()> {
    let (columns, rows, _) = values.dim();
    if columns.max(rows) > usize::from(u16::MAX) {
        let expected = format!("at most {} rows and columns", u16::MAX);
        return Err(Error::invalid(
            "slices",
            format!("{rows} rows and {columns} columns"),
            expected,
            "write another format",
        ));
    }
    let digest = digest(values, place);
    let mut slices = values.axis_iter(Axis(2)).zip(1..);
    slices.try_for_each(|(slice, number)| write_slice(folder, &scaling.numbers(slice), number, place, scaling, digest))
}

/// Writes a slice, of a volume with this digest, as a file.
fn write_slice(
    folder: &Path,
    pixels: &Array2<u16>,
    number: u32,
    place: &Place,
    scaling: Scaling,
    digest: u128,
) -> Result<()> {
    let (rows, columns) = pixels.dim();
    let position = place.origin + place.directions * DVec3::new(0.0, 0.0, f64::from(number - 1) * place.spacing.z);
    let [along_row, along_column] = [place.directions.x_axis, place.directions.y_axis].map(|axis| axis.to_array());
    let Scaling { offset, step } = scaling;
    // Identifiers of a series are derived from its content, so that equal volumes have equal files.
    let identifier =
        |kind: u8, number: u32| format!("2.25.{}", digest << 40 | u128::from(kind) << 32 | u128::from(number));
    let instance = identifier(1, number);
    let texts = [
        (Tag(0x0008, 0x0008), VR::CS, "DERIVED\\SECONDARY\\AXIAL".into()),
        (SOP_CLASS, VR::UI, CT_IMAGE.into()),
        (SOP_INSTANCE, VR::UI, instance.clone()),
        (MODALITY, VR::CS, "CT".into()),
        (Tag(0x0008, 0x0070), VR::LO, "trgs".into()),
        (SLICE_THICKNESS, VR::DS, decimal(place.spacing.z)),
        (STUDY, VR::UI, identifier(2, 0)),
        (SERIES, VR::UI, identifier(3, 0)),
        (Tag(0x0020, 0x0011), VR::IS, "1".into()),
        (Tag(0x0020, 0x0013), VR::IS, number.to_string()),
        (POSITION, VR::DS, decimals(&position.to_array())),
        (ORIENTATION, VR::DS, decimals(&[along_row, along_column].concat())),
        (FRAME_OF_REFERENCE, VR::UI, identifier(4, 0)),
        (PHOTOMETRIC, VR::CS, "MONOCHROME2".into()),
        (PIXEL_SPACING, VR::DS, decimals(&[place.spacing.y, place.spacing.x])),
        (Tag(0x0028, 0x1050), VR::DS, decimal(offset + step * 32768.0)),
        (Tag(0x0028, 0x1051), VR::DS, decimal(step * 65535.0)),
        (INTERCEPT, VR::DS, decimal(offset)),
        (SLOPE, VR::DS, decimal(step)),
        // Neither Hounsfield units nor another unit that DICOM has a name for.
        (Tag(0x0028, 0x1054), VR::LO, "US".into()),
    ];
    let numbers = [
        (SAMPLES, 1),
        (ROWS, rows),
        (COLUMNS, columns),
        (BITS_ALLOCATED, 16),
        (BITS_STORED, 16),
        (HIGH_BIT, 15),
        (IS_SIGNED, 0),
    ];
    let mut object = InMemDicomObject::new_empty();
    EMPTY.into_iter().for_each(|(tag, kind)| drop(object.put(DataElement::empty(tag, kind))));
    texts
        .into_iter()
        .for_each(|(tag, kind, text)| drop(object.put(DataElement::new(tag, kind, PrimitiveValue::from(text)))));
    numbers
        .into_iter()
        .for_each(|(tag, number)| drop(object.put(DataElement::new(tag, VR::US, PrimitiveValue::from(number as u16)))));
    object.put(DataElement::new(PIXELS, VR::OW, PrimitiveValue::U16(pixels.iter().copied().collect())));
    let meta = FileMetaTableBuilder::new()
        .transfer_syntax(EXPLICIT_LITTLE_ENDIAN)
        .media_storage_sop_class_uid(CT_IMAGE)
        .media_storage_sop_instance_uid(instance);
    write_atomically(&folder.join(format!("slice_{number:04}.dcm")), |file| {
        object.with_meta(meta).map_err(io::Error::other)?.write_all(file).map_err(io::Error::other)
    })
}

/// The first 88 bits of the SHA-256 of values and place.
fn digest(values: &Array3<f32>, place: &Place) -> u128 {
    let mut hash = Sha256::new();
    let lengths = place.spacing.to_array().into_iter().chain(place.origin.to_array());
    lengths.chain(place.directions.to_cols_array()).for_each(|length| hash.update(length.to_le_bytes()));
    values.iter().for_each(|value| hash.update(value.to_le_bytes()));
    hash.finalize()[..11].iter().fold(0, |number, byte| number << 8 | u128::from(*byte))
}

/// A number of at most 16 characters.
fn decimal(value: f64) -> String {
    let plain = value.to_string();
    if plain.len() <= 16 { plain } else { format!("{value:.8e}") }
}

fn decimals(values: &[f64]) -> String {
    values.iter().map(|&value| decimal(value)).collect::<Vec<_>>().join("\\")
}
