//! The circles on which filtered backprojection is exact in the plane of the source, among scans with poses.

use glam::DVec3;
use trgs_core::error::{Error, Result};
use trgs_core::geometry::{Beam, Projections, Scanner, View};
use trgs_core::setting::Text;

/// Largest deviation of a view from the circle, relative to the distance from source to axis.
const SAME: f64 = 1e-6;

/// A scan on a circle whose axis may be shifted.
pub(super) struct Circle {
    /// Distances and offsets of all views.
    pub(super) scanner: Scanner,
    /// Radians.
    pub(super) angles: Vec<f64>,
    /// Shift of source and detector along u in a cone beam, scene units.
    pub(super) shift: f64,
}

impl Circle {
    /// The circle of a scan.
    ///
    /// A constant height of source and detector moves the grid. In a parallel beam a shift of the axis is one of the
    /// detector.
    ///
    /// # Errors
    /// When the views are turned or tilted, or their distances, offsets, heights or shifts differ.
    pub(super) fn of(scanner: &Scanner, projections: &Projections) -> Result<Self> {
        if projections.poses.is_none() {
            return Ok(Self { scanner: *scanner, angles: projections.angles.clone(), shift: 0.0 });
        }
        let trajectory = projections.trajectory();
        trajectory.validate(scanner)?;
        let views = trajectory.views(scanner);
        let first = words(&views[0]);
        for (number, view) in views.iter().enumerate() {
            let (words, limit) = (words(view), SAME * scanner.beam.dso());
            if (view.v - DVec3::NEG_Z).length() > SAME {
                let got = format!("view {number} with v = {}", view.v);
                return Err(refused(&got, "detectors whose rows are perpendicular to the rotation axis"));
            }
            if let Some(k) = (0..words.len()).find(|&k| (words[k].1 - first[k].1).abs() > limit) {
                let got = format!("{} {} in view {number}, {} in view 0", words[k].0, words[k].1, first[k].1);
                return Err(refused(
                    &got,
                    "one circle: the same distances, offsets, heights and axis shift in all views",
                ));
            }
        }
        let [shift, height, ..] = first.map(|(_, value)| value);
        let mut scanner = Scanner { beam: views[0].beam, detector: views[0].detector, grid: scanner.grid };
        let mut shift_of_source = shift;
        match scanner.beam {
            Beam::Cone { .. } => scanner.grid.min.z -= height,
            Beam::Parallel { .. } => {
                scanner.detector.offset_u += shift;
                scanner.detector.offset_v -= height;
                shift_of_source = 0.0;
            }
        }
        let angles = projections.poses.iter().flatten().map(|pose| pose.angle()).collect();
        Ok(Self { scanner, angles, shift: shift_of_source })
    }
}

/// Shift along u, height, distances and offsets of a view, with their names.
fn words(view: &View) -> [(&'static str, f64); 6] {
    let (dso, dsd) = match view.beam {
        Beam::Cone { dso, dsd } => (dso, dsd),
        Beam::Parallel { .. } => (0.0, 0.0),
    };
    // In a parallel beam the source may lie anywhere on the ray through the detector's centre.
    let (source, u, v) = match view.beam {
        Beam::Cone { .. } => (view.source, view.detector.offset_u, view.detector.offset_v),
        Beam::Parallel { .. } => {
            (view.source + view.u * view.detector.offset_u + view.v * view.detector.offset_v, 0.0, 0.0)
        }
    };
    [
        ("axis shift", source.dot(view.u)),
        ("height", source.z),
        ("DSO", dso),
        ("DSD", dsd),
        ("offset along u", u),
        ("offset along v", v),
    ]
}

fn refused(got: &str, expected: &str) -> Error {
    let remedy = "use the method tr-gs, sart, os-sart, asd-pocs, cgls or tv, which take any poses; for the first primitives, "
        + Text::set("initialisation.from", "sart");
    Error::invalid("poses for filtered backprojection", got, expected, remedy)
}
