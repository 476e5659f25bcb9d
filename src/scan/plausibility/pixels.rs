//! Pixels of the detector that err.

use super::Evidence;
use crate::pixels::WrongPixels;
use trgs_core::setting::{Setting, Text};
use trgs_core::words::{counted, verb};

/// Remarks on pixels that err in all views, and on values that no measurement has.
pub(super) fn remarks(scan: &Evidence<'_>) -> Vec<Text> {
    if scan.are_readings {
        return Vec::new();
    }
    let wrong = &scan.wrong;
    let mut remarks = Vec::new();
    let WrongPixels { single, columns, impossible } = wrong;
    let remedy = "convert or reconstruct with " + Setting::MaskPixels + " auto, which interpolates them";
    let count = single.len() + columns.len();
    if count > 0 {
        let found = format!(
            "{} {} from {} neighbours in all views: dead or hot pixels, or a flat field of another day; ",
            wrong.describe(),
            verb(count, "differs", "differ"),
            verb(count, "its", "their"),
        );
        remarks.push(Text::from(found) + &remedy);
    }
    if let [[view, row, column], ..] = impossible[..] {
        let value = f64::from(scan.dataset.train.images[[view, row, column]]) / scan.dataset.scale;
        let found = format!(
            "{} {} more than a hundred times as large as all others, first {value:.3e} in view {view} (counted from 0), row \
             {row}, column {column}: damaged; ",
            counted(impossible.len(), "value"),
            verb(impossible.len(), "is", "are"),
        );
        remarks.push(Text::from(found) + remedy + ", or measure the view again");
    }
    remarks
}
