//! Pixels of the detector that err.

use super::Evidence;
use crate::pixels::WrongPixels;
use trgs_core::setting::Setting;
use trgs_core::words::{counted, verb};

/// Remarks on pixels that err in all views, and on values that no measurement has.
pub(super) fn remarks(scan: &Evidence<'_>) -> Vec<String> {
    if scan.are_readings {
        return Vec::new();
    }
    let wrong = &scan.wrong;
    let mut remarks = Vec::new();
    let WrongPixels { single, columns, impossible } = wrong;
    let remedy = format!("convert or reconstruct with {} auto, which interpolates them", Setting::MaskPixels);
    let count = single.len() + columns.len();
    if count > 0 {
        remarks.push(format!(
            "{} {} from {} neighbours in all views: dead or hot pixels, or a flat field of another day; {remedy}",
            wrong.describe(),
            verb(count, "differs", "differ"),
            verb(count, "its", "their"),
        ));
    }
    if let [[view, row, column], ..] = impossible[..] {
        let value = f64::from(scan.dataset.train.images[[view, row, column]]) / scan.dataset.scale;
        remarks.push(format!(
            "{} {} more than a hundred times as large as all others, first {value:.3e} in view {view} (counted from 0), row \
             {row}, column {column}: damaged; {remedy}, or measure the view again",
            counted(impossible.len(), "value"),
            verb(impossible.len(), "is", "are"),
        ));
    }
    remarks
}
