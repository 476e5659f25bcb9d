//! The one judge of a scan's values: held against each other and against what they must be.
//!
//! Not in the paper. Line integrals are 0 in air, and training views, test views and the true volume have one scale.
//! Attenuation is not far below 0. [`remarks`] says where a scan differs; it changes nothing. Each kind of remark has a
//! file here, or one of [`super::truncation`] and [`super::hounsfield`], and a line in `JUDGES`.
//!
//! | remark | condition |
//! |---|---|
//! | readings instead of line integrals | the border of the mean view is its brightest part, and the object is darker |
//! | air that is not 0 | see [`super::air`]: more than 5 standard errors, and a percent of the largest profile |
//! | single views that differ | see `frames.rs`: blank, without object or beam, another exposure |
//! | pixels that err in all views | see [`super::pixels`] |
//! | whole numbers | all training values are whole numbers, and at least [`LEVELS`] differ |
//! | another scale of the test views | the mean values differ by more than a factor of [`SCALE`] |
//! | another scale of the true volume | its mass and that seen by the views differ by more than a factor of [`SCALE`] |
//! | Hounsfield units | the true volume has values below [`super::hounsfield::IMPOSSIBLE`] |
//! | an object wider than the detector | see [`super::truncation`] |
//! | an object taller than the detector | see [`super::truncation`] |
//! | an object larger than the volume | rays that miss the volume read clearly more than air |
//! | degrees, empty views, wrong sign | see [`check`], which refuses them |
//! | a short arc | the views span less than 20° |
//! | copies | training views with equal images or angles, test views with the image of a training view |

mod air;
mod frames;
mod outside;
mod pixels;
mod readings;
mod refused;
mod scales;
mod views;

pub use readings::LEVELS;
pub use refused::{AnglesFrom, check, check_radians, check_views, within_a_turn};
pub use scales::SCALE;

use super::borders::Borders;
use super::dataset::Dataset;
use super::pixels::WrongPixels;
use super::{hounsfield, truncation};
use trgs_core::setting::Text;

/// A scan and what several judges need of it, measured once.
pub(super) struct Evidence<'a> {
    pub(super) dataset: &'a Dataset,
    /// Layer around the volume that is reconstructed as well, as a fraction of its longest side.
    pub(super) margin: f64,
    /// Those of the training views.
    pub(super) borders: Borders,
    /// Those of the detector.
    pub(super) wrong: WrongPixels,
    /// The training views are readings of a detector: they have no air of 0, no mass and no truncation.
    pub(super) are_readings: bool,
    /// The true volume is in Hounsfield units.
    pub(super) is_hounsfield: bool,
}

impl Evidence<'_> {
    /// The mean air of the training views, 0 as long as it may be 0, and of readings, which are no line integrals.
    pub(super) fn air(&self) -> f64 {
        if self.are_readings {
            return 0.0;
        }
        let views = self.dataset.train.len();
        let sum: f64 = self.borders.air.iter().flat_map(|air| (0..views).map(|view| air.at(view))).sum();
        sum / views.max(1) as f64
    }
}

/// A kind of remark: one sentence each, with numbers and the remedy.
type Judge = fn(&Evidence<'_>) -> Vec<Text>;

/// All kinds, in the order in which they are said.
const JUDGES: &[Judge] = &[
    |scan| texts(readings::remark(scan.dataset)),
    air::remarks,
    frames::remarks,
    pixels::remarks,
    |scan| texts(scales::of_test(scan)),
    |scan| texts(hounsfield_of_truth(scan.dataset)),
    |scan| texts(scales::of_truth(scan)),
    |scan| match scan.are_readings {
        true => Vec::new(),
        false => texts(truncation::remarks(&scan.dataset.scanner, &scan.dataset.train, &scan.borders)),
    },
    |scan| texts(outside::remark(scan)),
    refused::remarks,
    |scan| texts(views::remarks(scan)),
];

fn texts<T: Into<Text>>(remarks: impl IntoIterator<Item = T>) -> Vec<Text> {
    remarks.into_iter().map(T::into).collect()
}

/// What is implausible about the values of a scan, one sentence each, with numbers and the remedy.
pub fn remarks(dataset: &Dataset) -> Vec<Text> {
    remarks_with(dataset, 0.0)
}

/// [`remarks`] where a layer around the volume is reconstructed as well, a fraction `margin` of its longest side.
pub fn remarks_with(dataset: &Dataset, margin: f64) -> Vec<Text> {
    let evidence = Evidence {
        dataset,
        margin,
        borders: Borders::of(dataset.train.images.view()),
        wrong: WrongPixels::of(&dataset.scanner, &dataset.train),
        are_readings: readings::remark(dataset).is_some(),
        is_hounsfield: hounsfield_of_truth(dataset).is_some(),
    };
    JUDGES.iter().flat_map(|judge| judge(&evidence)).collect()
}

/// Whether a pixel is in the first or last row or column; a detector of one or two rows has no border above and below.
fn is_at_border(row: usize, column: usize, [rows, columns]: [usize; 2]) -> bool {
    let is_end = |i: usize, n: usize| n > 2 && (i == 0 || i + 1 == n);
    is_end(row, rows) || is_end(column, columns) || (rows <= 2 && columns <= 2)
}

/// The smallest and the largest value; infinite for none.
fn ends(values: impl Iterator<Item = f64>) -> (f64, f64) {
    values.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), value| {
        (if value < low { value } else { low }, if value > high { value } else { high })
    })
}

fn hounsfield_of_truth(dataset: &Dataset) -> Option<Text> {
    dataset.truth.as_ref().and_then(|truth| hounsfield::remark("true volume", &truth.values))
}

/// [`remarks`] as strings.
#[cfg(test)]
pub(super) fn sentences(dataset: &Dataset) -> Vec<String> {
    remarks(dataset).iter().map(Text::to_string).collect()
}

#[cfg(test)]
mod kinds;
#[cfg(test)]
mod tests;
