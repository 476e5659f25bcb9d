//! Poses: source and detector of single views, for scans that are no plain circle.

use super::{Beam, Detector, Scanner, View};
use crate::error::{Error, Result};
use crate::numeric::elementary::{atan2, cos, sin};
use glam::{DMat3, DVec3};

/// Largest deviation from unit length and from a right angle of a pose's axes.
const ORTHONORMAL: f64 = 1e-6;

/// Position of source and detector in one view, in world coordinates.
///
/// It replaces `dso`, `dsd` and the detector's offsets of the [`Scanner`], whose pixels and grid it keeps. `w = u × v` is
/// the normal of the detector, and in a parallel beam the direction of the rays.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pose {
    /// Source, scene units; in a parallel beam any point.
    pub source: DVec3,
    /// Centre of the detector, scene units; in a parallel beam any point of the ray through it.
    pub centre: DVec3,
    /// Unit vector along the columns.
    pub u: DVec3,
    /// Unit vector down the rows.
    pub v: DVec3,
}

/// A pose in terms of deviations from the circle of the [geometry page](super).
///
/// At angle 0 the detector is turned about its centre, put at `x = dso - dsd` and moved by its offset; then everything
/// rotates by the angle, and the axis shift and the origin are applied. These are the definitions of TIGRE.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Deviation {
    /// Source to rotation axis, scene units.
    pub dso: f64,
    /// Source to detector, scene units.
    pub dsd: f64,
    /// Shift of the detector along u and v, scene units.
    pub offset: [f64; 2],
    /// Shift of source and detector along the u of the plain view, scene units: TIGRE's `COR`.
    pub axis_shift: f64,
    /// Turns of the detector about z, y and x of the view at angle 0, radians, applied in the order x, y, z.
    pub turns: [f64; 3],
    /// Height of source and of detector, along +z, scene units.
    pub heights: [f64; 2],
    /// The point of space at which the object's origin lies in this view, scene units.
    pub origin: DVec3,
}

impl Deviation {
    /// No deviation from the circle of a scanner.
    pub fn none(scanner: &Scanner) -> Self {
        let (dso, dsd) = match scanner.beam {
            Beam::Cone { dso, dsd } => (dso, dsd),
            Beam::Parallel { dso } => (dso, 2.0 * dso),
        };
        let offset = [scanner.detector.offset_u, scanner.detector.offset_v];
        Self { dso, dsd, offset, axis_shift: 0.0, turns: [0.0; 3], heights: [0.0; 2], origin: DVec3::ZERO }
    }

    /// Turns the detector in its plane by `roll` (radians), from u towards v.
    pub fn rolled(self, roll: f64) -> Self {
        // Forward is -x at angle 0.
        Self { turns: [0.0, 0.0, 0.0 - roll], ..self }
    }

    /// The pose at `angle` (radians).
    ///
    /// Tests: `a_deviation_of_nothing_is_the_plain_view`, `deviations_move_as_tigre_does`.
    pub fn pose(&self, angle: f64) -> Pose {
        let [about_z, about_y, about_x] = self.turns.map(|turn| (sin(turn), cos(turn)));
        let columns = |x: [f64; 3], y: [f64; 3], z: [f64; 3]| DMat3::from_cols(x.into(), y.into(), z.into());
        let (s, c) = about_z;
        let turn_z = columns([c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]);
        let (s, c) = about_y;
        let turn_y = columns([c, 0.0, -s], [0.0, 1.0, 0.0], [s, 0.0, c]);
        let (s, c) = about_x;
        let turn_x = columns([1.0, 0.0, 0.0], [0.0, c, s], [0.0, -s, c]);
        let turned = turn_z * turn_y * turn_x;
        let (s, c) = (sin(angle), cos(angle));
        let rotated = |p: DVec3| DVec3::new(c * p.x - s * p.y, s * p.x + c * p.y, p.z);
        let shift = DVec3::new(-s, c, 0.0) * self.axis_shift - self.origin;
        let [source_height, detector_height] = self.heights;
        let [u, v] = self.offset;
        Pose {
            source: rotated(DVec3::new(self.dso, 0.0, source_height)) + shift,
            centre: rotated(DVec3::new(self.dso - self.dsd, u, detector_height - v)) + shift,
            u: rotated(turned.y_axis),
            v: rotated(-turned.z_axis),
        }
    }
}

impl Pose {
    /// The pose of a view.
    pub fn of(view: &View) -> Self {
        let to_plane = match view.beam {
            Beam::Cone { dsd, .. } => dsd,
            Beam::Parallel { dso } => 2.0 * dso,
        };
        let Detector { offset_u, offset_v, .. } = view.detector;
        let centre = view.source + view.u * offset_u + view.v * offset_v + view.w * to_plane;
        Self { source: view.source, centre, u: view.u, v: view.v }
    }

    /// The view of a scanner in this pose; `angle` (radians) is a label.
    ///
    /// `dso` of the view is the distance from the source to the origin along w.
    pub fn view(&self, scanner: &Scanner, angle: f64) -> View {
        let Self { source, centre, u, v } = *self;
        let w = u.cross(v);
        let to_centre = centre - source;
        let beam = match scanner.beam {
            Beam::Cone { .. } => Beam::Cone { dso: -source.dot(w), dsd: to_centre.dot(w) },
            parallel @ Beam::Parallel { .. } => parallel,
        };
        let detector = Detector { offset_u: to_centre.dot(u), offset_v: to_centre.dot(v), ..scanner.detector };
        View { angle, beam, detector, source, u, v, w }
    }

    /// The angle (radians) of the plain view that looks in the same direction.
    pub fn angle(&self) -> f64 {
        let w = self.u.cross(self.v);
        atan2(0.0 - w.y, 0.0 - w.x)
    }

    /// Source, centre and axes as one list of numbers: ASTRA's `cone_vec`, with u and v of the length of a pixel.
    pub fn vector(&self, detector: &Detector) -> [f64; 12] {
        let axes = [self.source, self.centre, self.u * detector.pitch_u, self.v * detector.pitch_v];
        std::array::from_fn(|i| axes[i / 3][i % 3])
    }

    /// Checks a pose: finite numbers, orthonormal axes, and a source in front of which detector and volume lie.
    ///
    /// # Errors
    /// For the first check that fails.
    pub fn validate(&self, scanner: &Scanner) -> Result<()> {
        let finite = [self.source, self.centre, self.u, self.v].iter().all(|p| p.is_finite());
        let skew = [self.u.length_squared() - 1.0, self.v.length_squared() - 1.0, self.u.dot(self.v)];
        if !finite || skew.iter().any(|x| x.abs() > ORTHONORMAL) {
            return Err(Error::invalid(
                "pose of a view",
                format!("u {}, v {}", self.u, self.v),
                "finite numbers, and u perpendicular to v",
                "correct the vectors of the view",
            ));
        }
        let view = self.view(scanner, 0.0);
        let Beam::Cone { dsd, .. } = view.beam else { return Ok(()) };
        if dsd <= 0.0 {
            return Err(Error::invalid(
                "pose of a view",
                format!("a detector {dsd} in front of the source, along u × v"),
                "a positive distance",
                "change the sign of u or of v: u × v points from the source to the detector",
            ));
        }
        let nearest = scanner.corners().map(|p| view.to_camera(p).z).fold(f64::INFINITY, f64::min);
        if nearest <= 0.0 {
            return Err(Error::invalid(
                "pose of a view",
                format!("the volume reaches {} behind the source", -nearest),
                "the whole volume in front of the source",
                "the source would pass through the volume: check units, source and sVoxel",
            ));
        }
        Ok(())
    }
}

/// The views of a scan: an angle for each, and a pose for each where the scan is no plain circle.
///
/// Functions that take views accept a list of angles (radians), which is a circle, or [`Projections`](super::Projections).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Trajectory<'a> {
    /// Radians. With poses they are labels: for the order of views, and for people.
    pub angles: &'a [f64],
    /// As many as angles.
    pub poses: Option<&'a [Pose]>,
}

impl<'a, T: AsRef<[f64]> + ?Sized> From<&'a T> for Trajectory<'a> {
    fn from(angles: &'a T) -> Self {
        Self { angles: angles.as_ref(), poses: None }
    }
}

impl Trajectory<'_> {
    /// Number of views.
    pub fn len(&self) -> usize {
        self.angles.len()
    }

    /// Whether there are no views.
    pub fn is_empty(&self) -> bool {
        self.angles.is_empty()
    }

    /// One of the views.
    ///
    /// # Panics
    /// If there is no such view.
    pub fn view(&self, scanner: &Scanner, number: usize) -> View {
        match self.poses {
            None => scanner.view(self.angles[number]),
            Some(poses) => poses[number].view(scanner, self.angles[number]),
        }
    }

    /// All views.
    pub fn views(&self, scanner: &Scanner) -> Vec<View> {
        (0..self.len()).map(|number| self.view(scanner, number)).collect()
    }

    /// Checks the poses, and that the volume's shadow reaches the detector in one of them.
    ///
    /// # Errors
    /// For the first pose that fails [`Pose::validate`], or if no view sees the volume.
    pub fn validate(&self, scanner: &Scanner) -> Result<()> {
        let Some(poses) = self.poses else { return Ok(()) };
        for (number, pose) in poses.iter().enumerate() {
            pose.validate(scanner).map_err(|error| error.within(format!("view {number}")))?;
        }
        if (0..self.len()).any(|number| scanner.is_seen(&self.view(scanner, number))) {
            return Ok(());
        }
        Err(Error::invalid(
            "poses of the views",
            "no view in which the volume's shadow reaches the detector",
            "a detector that the shadow reaches in some view",
            "check the unit of length, and the order of the numbers: source, detector's centre, u, v",
        ))
    }

    /// Text for a digest: it is empty for a circle.
    pub fn digest_text(&self) -> String {
        self.poses.map_or_else(String::new, |poses| format!(" {poses:?}"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Grid;
    use crate::tolerances::largest;
    use std::f64::consts::FRAC_PI_2;

    fn scanner() -> Scanner {
        Scanner {
            beam: Beam::Cone { dso: 5.0, dsd: 7.0 },
            detector: Detector { rows: 6, columns: 9, pitch_v: 0.5, pitch_u: 0.4, offset_u: 0.3, offset_v: -0.2 },
            grid: Grid::cube(8),
        }
    }

    #[test]
    fn a_deviation_of_nothing_is_the_plain_view() {
        for beam in [scanner().beam, Beam::Parallel { dso: 5.0 }] {
            let scanner = Scanner { beam, ..scanner() };
            for angle in [0.0, 0.7, 3.9] {
                let (plain, pose) = (scanner.view(angle), Deviation::none(&scanner).pose(angle));
                let posed = pose.view(&scanner, angle);
                assert_eq!((posed.u, posed.v, posed.w, posed.source), (plain.u, plain.v, plain.w, plain.source));
                let d = [posed.detector.offset_u - 0.3, posed.detector.offset_v + 0.2];
                within!("detector", largest(d), "{d:?}");
                if let Beam::Cone { dso, dsd } = posed.beam {
                    within!("distances", largest([dso - 5.0, dsd - 7.0]));
                }
                let again = Pose::of(&plain);
                assert_eq!((again.u, again.v), (pose.u, pose.v));
                within!("source", again.source.distance(pose.source));
                // In a parallel beam the detector may lie anywhere along the rays.
                let across = again.centre - pose.centre;
                within!("centre", across.reject_from(plain.w).length());
                within!("angle", sin(pose.angle() - angle).abs());
            }
        }
    }

    #[test]
    fn deviations_move_as_tigre_does() {
        let plain = Deviation::none(&scanner());
        let deviation = Deviation {
            axis_shift: 0.14,
            heights: [0.2, 0.3],
            origin: DVec3::new(0.01, 0.02, 0.03),
            ..plain.rolled(0.1)
        };
        let (a, b) = (plain.pose(FRAC_PI_2), deviation.pose(FRAC_PI_2));
        // At 90° u is -x.
        let moved = |z: f64| DVec3::new(-0.14 - 0.01, -0.02, z - 0.03);
        within!("places", (b.source - a.source).distance(moved(0.2)));
        within!("places", (b.centre - a.centre).distance(moved(0.3)));
        // A roll turns u towards v, which is down.
        within!("axes", b.u.distance(a.u * cos(0.1) + a.v * sin(0.1)));
        within!("axes", b.v.distance(a.v * cos(0.1) - a.u * sin(0.1)));
        // TIGRE's matrix Rz(roll)·Ry(pitch)·Rx(yaw) at angle 0: the images of y and z.
        let [r, p, y] = [0.1, -0.2, 0.3];
        let turned = Deviation { turns: [r, p, y], ..plain }.pose(0.0);
        let ([sr, sp, sy], [cr, cp, cy]) = ([r, p, y].map(sin), [r, p, y].map(cos));
        let of_y = DVec3::new(cr * sp * sy - sr * cy, sr * sp * sy + cr * cy, cp * sy);
        let of_z = DVec3::new(cr * sp * cy + sr * sy, sr * sp * cy - cr * sy, cp * cy);
        within!("turns", turned.u.distance(of_y).max(turned.v.distance(-of_z)));
    }

    #[test]
    fn a_ray_through_a_pixel_of_a_posed_view_projects_onto_its_centre() {
        let scanner = scanner();
        let deviation =
            Deviation { turns: [0.1, -0.2, 0.3], axis_shift: 0.2, heights: [0.1, -0.2], ..Deviation::none(&scanner) };
        let view = deviation.pose(1.1).view(&scanner, 1.1);
        for (row, column) in [(0, 0), (5, 8), (2, 3)] {
            let ray = scanner.ray(&view, row, column);
            let (u, v) = view.project(view.to_camera(ray.origin + ray.direction * 4.3)).unwrap();
            let (r, c) = view.detector.pixel(u, v);
            within!("pixel", largest([r - row as f64, c - column as f64]), "({row},{column}): ({r},{c})");
            // The pixel lies on the plane of the detector where the pose says.
            let pose = deviation.pose(1.1);
            let pixel =
                pose.centre + pose.u * ((column as f64 + 0.5 - 4.5) * 0.4) + pose.v * ((row as f64 + 0.5 - 3.0) * 0.5);
            within!("direction", (pixel - ray.origin).normalize().distance(ray.direction));
        }
    }

    #[test]
    fn impossible_poses_are_named() {
        let scanner = scanner();
        let good = Deviation::none(&scanner).pose(0.3);
        good.validate(&scanner).unwrap();
        let refused = |pose: Pose| pose.validate(&scanner).unwrap_err().to_string();
        assert!(refused(Pose { v: -good.v, ..good }).contains("sign of u or of v"));
        let (long, inside) = (Pose { u: good.u * 1.1, ..good }, Pose { source: good.u * 0.2, ..good });
        assert!(refused(long).contains("perpendicular"));
        assert!(refused(inside).contains("behind the source"));
        let away = Pose { centre: good.centre + good.u * 90.0, ..good };
        let poses = [good, Pose { source: DVec3::NAN, ..good }];
        let of = |poses: &[Pose]| {
            let trajectory = Trajectory { angles: &vec![0.3; poses.len()], poses: Some(poses) };
            trajectory.validate(&scanner).map_err(|error| error.to_string())
        };
        assert!(of(&poses).unwrap_err().contains("view 1: pose"));
        assert!(of(&[away]).unwrap_err().contains("shadow"));
        of(&[away, good]).unwrap();
    }
}
