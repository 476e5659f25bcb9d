//! Angles of the fan and widths of the volume in the source's plane.

use trgs_core::geometry::{Beam, Scanner};
use trgs_core::numeric::elementary::{asin, atan, tan};
use trgs_scan::borders::Borders;

/// Angle between the ray to column position u and the middle of the fan, radians.
pub(super) fn fan_angle(scanner: &Scanner, u: f64) -> f64 {
    match scanner.beam {
        Beam::Cone { dsd, .. } => atan(u / dsd),
        Beam::Parallel { .. } => 0.0,
    }
}

/// Angle of the middle of the fan from the ray through the axis, where source and detector are shifted along u, radians.
pub(super) fn axis_angle(scanner: &Scanner, shift: f64) -> f64 {
    match scanner.beam {
        Beam::Cone { dso, .. } => atan(shift / dso),
        Beam::Parallel { .. } => 0.0,
    }
}

/// Radius of the cylinder around the axis inside the volume's box.
fn radius(scanner: &Scanner) -> f64 {
    let (min, max) = (scanner.grid.min, scanner.grid.max());
    [-min.x, max.x, -min.y, max.y].into_iter().fold(0.0, f64::max)
}

/// Half the fan angle of the volume or of the object, if that is wider, or of the detector if both are wider; radians.
pub(super) fn half_fan(scanner: &Scanner, shift: f64, seen: &Borders) -> f64 {
    let aside = axis_angle(scanner, shift);
    // Angle of the ray to the start of a column from the ray through the axis.
    let from_axis = |column: usize| {
        let start = scanner.detector.position(0.0, column as f64 - 0.5).0;
        (fan_angle(scanner, start) + aside).abs()
    };
    let widest = |columns: [usize; 2]| columns.map(from_axis).into_iter().fold(0.0, f64::max);
    let object = if seen.columns.is_empty() { 0.0 } else { widest([seen.columns.start, seen.columns.end]) };
    match scanner.beam {
        Beam::Cone { dso, .. } => {
            let volume = asin((radius(scanner) / dso).min(1.0));
            volume.max(object).min(widest([0, scanner.detector.columns]))
        }
        Beam::Parallel { .. } => 0.0,
    }
}

/// Half the width of the volume's projection on the detector.
pub(super) fn shadow(scanner: &Scanner) -> f64 {
    match scanner.beam {
        Beam::Cone { dso, dsd } => dsd * tan(asin((radius(scanner) / dso).min(1.0))),
        Beam::Parallel { .. } => radius(scanner),
    }
}
