//! The circle that a scan's poses make, if they make one.

use glam::DVec3;
use trgs_core::error::{Error, Result};
use trgs_core::geometry::{Beam, Scanner, View};
use trgs_core::numeric::elementary::atan2;
use trgs_scan::Dataset;

/// Largest deviation of a view from the circle: of lengths relative to the distance to the axis, of angles in radians.
const SAME: f64 = 1e-6;

/// Deviations from the plain circle that all views share.
#[derive(Clone, Debug)]
pub(super) struct Stated {
    /// Distances and detector offsets of the views.
    pub(super) scanner: Scanner,
    /// Turn of the detector in its plane, from u towards v, radians.
    pub(super) roll: f64,
    /// Shift of source and detector along u, scene units.
    pub(super) axis_shift: f64,
    /// Radians.
    pub(super) angles: Vec<f64>,
}

impl Stated {
    /// The circle of the training views.
    ///
    /// # Errors
    /// When the views have different poses, heights or tilts.
    pub(super) fn of(dataset: &Dataset) -> Result<Self> {
        let (scanner, train) = (dataset.scanner, &dataset.train);
        let Some(poses) = &train.poses else {
            return Ok(Self { scanner, roll: 0.0, axis_shift: 0.0, angles: train.angles.clone() });
        };
        let views = train.trajectory().views(&scanner);
        let all: Vec<[f64; 8]> = views.iter().map(numbers).collect();
        let limit = |k: usize| if k < 6 { SAME * scanner.beam.dso() } else { SAME };
        let differs = |row: &[f64; 8]| (0..8).any(|k| (row[k] - all[0][k]).abs() > limit(k));
        if all.iter().any(differs) || all[0][5].abs() > limit(5) || all[0][7].abs() > limit(7) {
            let expected = "a circle around z: one distance, offset, roll and axis shift in all views";
            let remedy = "the check knows circles alone; compare reconstructions with and without the poses instead";
            return Err(Error::invalid("poses of the training views", "a helix, tilt or other path", expected, remedy));
        }
        let [dso, dsd, offset_u, offset_v, axis_shift, _, roll, _] = all[0];
        let beam = match scanner.beam {
            Beam::Cone { .. } => Beam::Cone { dso, dsd },
            parallel @ Beam::Parallel { .. } => parallel,
        };
        let mut scanner = Scanner { beam, ..scanner };
        (scanner.detector.offset_u, scanner.detector.offset_v) = (offset_u, offset_v);
        Ok(Self { scanner, roll, axis_shift, angles: poses.iter().map(|pose| pose.angle()).collect() })
    }
}

/// Distances, offsets along the plain axes, axis shift, height, roll and tilt of a view.
fn numbers(view: &View) -> [f64; 8] {
    let along_u = DVec3::new(view.w.y, -view.w.x, 0.0);
    let ([dso, dsd], axis_shift, height) = match view.beam {
        Beam::Cone { dso, dsd } => ([dso, dsd], view.source.dot(along_u), view.source.z),
        // The place of the source on its ray does not matter.
        Beam::Parallel { .. } => ([0.0; 2], 0.0, 0.0),
    };
    let moved = match view.beam {
        Beam::Cone { .. } => DVec3::ZERO,
        Beam::Parallel { .. } => view.source,
    };
    let centre = moved + view.u * view.detector.offset_u + view.v * view.detector.offset_v;
    let roll = atan2(0.0 - view.u.z, 0.0 - view.v.z);
    [dso, dsd, centre.dot(along_u), 0.0 - centre.z, axis_shift, height, roll, view.w.z]
}
