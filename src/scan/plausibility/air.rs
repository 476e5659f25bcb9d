//! Air whose line integral is not 0.

use super::Evidence;
use crate::borders::Side;
use trgs_core::numeric::elementary::exp;
use trgs_core::setting::{Setting, Text};

/// Remarks on air that differs from 0 in all views, or that varies over them.
pub(super) fn remarks(scan: &Evidence<'_>) -> Vec<Text> {
    let (Some(air), false) = (&scan.borders.air, scan.are_readings) else { return Vec::new() };
    let scale = scan.dataset.scale;
    let views = scan.dataset.train.len();
    let sides = if air.sides.len() == Side::ALL.len() {
        "all four borders".into()
    } else {
        format!("the borders {}", air.sides.iter().map(|side| side.name()).collect::<Vec<_>>().join(", "))
    };
    let subtract = "convert or reconstruct with " + Setting::Air + " auto, which subtracts it, or correct ";
    let remedy = subtract + Setting::Flat + " or " + Setting::White + " and convert again";
    let (level, error) = (air.level / scale, air.error / scale);
    if air.drifts() {
        let mut seen: Vec<f64> = air.views.iter().flatten().map(|level| level / scale).collect();
        seen.sort_by(f64::total_cmp);
        let found = format!(
            "air varies over the views, from {:.4} to {:.4} (± {:.1e} each) instead of 0 at {sides}: the source drifts, or the \
             frames have different exposures; ",
            seen[0],
            seen[seen.len() - 1],
            air.view_error / scale
        );
        return vec![Text::from(found) + remedy];
    }
    if !air.is_offset() {
        return Vec::new();
    }
    let found = format!(
        "air is {level:.4} ± {error:.1e} instead of 0 at {sides} in all {views} views, as if frames had {:.3} times the \
         exposure or range of the flat field: another exposure, a wrong reading without an object, or another number of \
         bits; ",
        exp(-level)
    );
    vec![Text::from(found) + remedy]
}
