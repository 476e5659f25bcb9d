//! **The geometry page**: every axis, sign, unit and index order of the project is defined here.
//!
//! ```text
//!                     z (rotation axis)          World: right-handed, scene units. The longest side of the
//!                     │   ╭──── volume           volume is 2, so it lies in [-1,1]³ (files in other units are
//!                     │  ╱│                      scaled on reading, and projections with them).
//!       source ●──────┼─╱─┼────▶ w    ┌───┐u→    Volume: array [x,y,z], z fastest; the centre of voxel i lies at
//!     at dso·(cos φ,  │╱  │           │  v│      min + (i+½)·spacing.
//!        sin φ, 0)    ●───┼──▶ y      │  ↓│      Detector: array [v,u], rows v first. Columns run along u,
//!                    ╱                └───┘      rows along v, so row 0 is the top (+z).
//!                   x                detector    Projections: array [view, v, u].
//!                                    at dsd
//! ```
//!
//! View at angle φ (radians, counter-clockwise seen from +z; φ = 0 has the source on +x):
//!
//! | axis | at angle φ | at φ = 0 |
//! |---|---|---|
//! | source | `dso·(cos φ, sin φ, 0)` | `(dso, 0, 0)` |
//! | `w`, forward | `(-cos φ, -sin φ, 0)` | `-x` |
//! | `u`, along the columns | `(-sin φ, cos φ, 0)` | `+y` |
//! | `v`, down the rows | `(0, 0, -1)` | `-z` |
//!
//! `u × v = w`: the camera frame (u,v,w) is right-handed. The centre of pixel (row, column) lies at
//! `((column+½-columns/2)·pitch_u + offset_u, (row+½-rows/2)·pitch_v + offset_v)` on the detector, which is
//! perpendicular to `w` at distance `dsd` from the source. In a parallel beam all rays run along `w`,
//! the detector has the size of the region that it sees, and `dsd` has no meaning.
//!
//! Files of R²-Gaussian and NAF count the detector offset along v upwards, towards +z, as TIGRE does. Its sign is
//! changed on reading and writing.
//!
//! A projection value is the integral of the density along the whole ray, in scene units of true length.
//!
//! # Poses
//!
//! A scan need not be a circle. A [`Pose`] states the source, the detector's centre and the unit vectors u and v of one
//! view in world coordinates; `w = u × v`. It replaces `dso`, `dsd` and the detector's offset, which become
//!
//! | of the view | formula |
//! |---|---|
//! | `dsd` | `w·(centre - source)` |
//! | offset along u and v | `u·(centre - source)`, `v·(centre - source)` |
//! | `dso` | `-w·source`: the depth of the origin |
//!
//! so that all formulas above hold for a detector in any position: turned in its plane, tilted, or moved along the axis
//! as in a helix. In a parallel beam the rays run along w, and a pose has no `dsd`. A [`Deviation`] makes a pose from
//! the words of a scanner. In the frame of the plain view at angle φ:
//!
//! | word | moves | by |
//! |---|---|---|
//! | axis shift (TIGRE: `COR`) | source and detector | along u |
//! | detector offset | the detector | along u and v of the plain view |
//! | roll | the detector about its centre | from u towards v, positive angles |
//! | turns (TIGRE: `rotDetector`, its entries in this order) | the detector about its centre | `Rz·Ry·Rx` at φ = 0 |
//! | source height, detector height | source, detector | along +z |
//! | origin (TIGRE: `offOrigin` of a view) | source and detector | along the opposite direction |
//!
//! TIGRE's `rotDetector = [0, 0, r]` is a roll of -r: forward is -x at φ = 0. A roll also turns the frame that detector
//! positions (u, v) refer to, but not the direction of the offset. All views of a scan have poses, or none
//! ([`Trajectory`]). Everything that needs a view takes it from [`View`]: it has the beam and the detector of that view.

mod arrays;
mod coarser;
mod pose;

pub use arrays::{Projections, Volume, check_finite, check_finite_from, check_shape};
pub use pose::{Deviation, Pose, Trajectory};

use crate::error::{Error, Result};
use crate::numeric::elementary::{cos, sin};
use glam::DVec3;

/// Direction of the rays.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Beam {
    /// Point source and flat detector.
    ///
    /// The source is at distance `dso` from the rotation axis and at distance `dsd` from the detector.
    Cone {
        /// Source to rotation axis, scene units.
        dso: f64,
        /// Source to detector, scene units.
        dsd: f64,
    },
    /// Along `w`, perpendicular to the detector.
    Parallel {
        /// Nominal distance of the source plane from the axis, scene units. No value depends on it.
        dso: f64,
    },
}

/// A flat detector of `rows` × `columns` pixels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Detector {
    /// Pixels along v.
    pub rows: usize,
    /// Pixels along u.
    pub columns: usize,
    /// Distance between rows, scene units.
    pub pitch_v: f64,
    /// Distance between columns, scene units.
    pub pitch_u: f64,
    /// Shift of the detector along u, scene units.
    pub offset_u: f64,
    /// Shift of the detector along v, scene units.
    pub offset_v: f64,
}

/// An axis-aligned grid of voxels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Grid {
    /// Voxels along x, y, z.
    pub shape: [usize; 3],
    /// The corner with the smallest coordinates, scene units.
    pub min: DVec3,
    /// Voxel size along x, y, z, scene units.
    pub spacing: DVec3,
}

/// The fixed part of a scan: beam, detector and reconstruction grid.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Scanner {
    /// Cone or parallel.
    pub beam: Beam,
    /// The detector.
    pub detector: Detector,
    /// The volume's grid.
    pub grid: Grid,
}

/// One view of a scan: source position, detector axes, and the distances and offsets that hold in this view.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct View {
    /// Rotation, radians.
    pub angle: f64,
    /// The scanner's beam, with the distances of this view.
    pub beam: Beam,
    /// The scanner's detector, with the offset of this view.
    pub detector: Detector,
    /// Source position; for a parallel beam a point on the central ray.
    pub source: DVec3,
    /// Unit vector along the columns.
    pub u: DVec3,
    /// Unit vector down the rows.
    pub v: DVec3,
    /// Unit vector forward.
    pub w: DVec3,
}

/// A ray with unit direction: `origin + t·direction`, t in scene units.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ray {
    /// A point on the ray: the source, or in a parallel beam the ray's point in the source plane.
    pub origin: DVec3,
    /// Unit vector.
    pub direction: DVec3,
}

impl Beam {
    /// Source to rotation axis, scene units.
    pub fn dso(&self) -> f64 {
        match *self {
            Self::Cone { dso, .. } | Self::Parallel { dso } => dso,
        }
    }

    /// The length of an image on the detector over that of the object at the axis.
    pub fn magnification(&self) -> f64 {
        match *self {
            Self::Cone { dso, dsd } => dsd / dso,
            Self::Parallel { .. } => 1.0,
        }
    }
}

impl Detector {
    /// Detector position (u, v) of a pixel centre, scene units. Fractional indices are allowed.
    pub fn position(&self, row: f64, column: f64) -> (f64, f64) {
        (
            (column + 0.5 - self.columns as f64 / 2.0) * self.pitch_u + self.offset_u,
            (row + 0.5 - self.rows as f64 / 2.0) * self.pitch_v + self.offset_v,
        )
    }

    /// Row and column (fractional) of a detector position; inverse of [`Self::position`].
    pub fn pixel(&self, u: f64, v: f64) -> (f64, f64) {
        (
            (v - self.offset_v) / self.pitch_v + self.rows as f64 / 2.0 - 0.5,
            (u - self.offset_u) / self.pitch_u + self.columns as f64 / 2.0 - 0.5,
        )
    }

    /// Half the size along u and v, scene units.
    fn half(&self) -> [f64; 2] {
        [self.columns as f64 * self.pitch_u / 2.0, self.rows as f64 * self.pitch_v / 2.0]
    }

    /// Number of pixels.
    pub fn pixels(&self) -> usize {
        self.rows.saturating_mul(self.columns)
    }
}

/// Most voxels or pixels that a count is computed for: no memory holds them.
const MOST: usize = match 1_usize.checked_shl(40) {
    Some(most) => most,
    // Addresses of 32 bits.
    None => usize::MAX / 2,
};

/// Rejects a shape whose elements are too many to be counted.
fn check_count(what: &str, shape: &[usize]) -> Result<()> {
    let count = shape.iter().fold(1_usize, |product, &n| product.saturating_mul(n));
    if count <= MOST {
        return Ok(());
    }
    let expected = format!("at most {MOST} elements");
    Err(Error::invalid(format!("{what} shape"), format!("{shape:?}"), expected, "give smaller numbers"))
}

impl Grid {
    /// A grid of `shape` voxels over the box from `min` to `max`.
    ///
    /// # Errors
    /// For an axis without voxels, or corners that are not finite or not in increasing order.
    pub fn new(shape: [usize; 3], min: DVec3, max: DVec3) -> Result<Self> {
        if shape.contains(&0) {
            return Err(Error::invalid(
                "grid shape",
                format!("{shape:?}"),
                "at least one voxel on each axis",
                "give at least one voxel on each axis",
            ));
        }
        check_count("grid", &shape)?;
        let size = max - min;
        if !(size.x > 0.0 && size.y > 0.0 && size.z > 0.0 && size.is_finite() && min.is_finite()) {
            return Err(Error::invalid(
                "box of the grid",
                format!("{min} to {max}"),
                "finite corners, the first below the second",
                "exchange the corners, or give a larger box",
            ));
        }
        Ok(Self { shape, min, spacing: size / DVec3::new(shape[0] as f64, shape[1] as f64, shape[2] as f64) })
    }

    /// The cube [-1,1]³ with `n` voxels on each side.
    pub fn cube(n: usize) -> Self {
        Self { shape: [n; 3], min: DVec3::NEG_ONE, spacing: DVec3::splat(2.0 / n as f64) }
    }

    /// Centre of voxel (x,y,z).
    pub fn centre(&self, index: [usize; 3]) -> DVec3 {
        self.min + (DVec3::new(index[0] as f64, index[1] as f64, index[2] as f64) + 0.5) * self.spacing
    }

    /// Side lengths, scene units.
    pub fn size(&self) -> DVec3 {
        self.spacing * DVec3::new(self.shape[0] as f64, self.shape[1] as f64, self.shape[2] as f64)
    }

    /// The corner with the largest coordinates.
    pub fn max(&self) -> DVec3 {
        self.min + self.size()
    }

    /// Number of voxels.
    pub fn voxels(&self) -> usize {
        self.shape.iter().fold(1, |product, &n| product.saturating_mul(n))
    }

    /// The grid with voxels of the same size around it, on both sides of each axis that has more than one: `margin` times the
    /// longest side, and up to a voxel more.
    pub fn with_margin(&self, margin: f64) -> Self {
        let width = margin * self.size().max_element();
        let more = [0, 1, 2].map(|axis| match self.shape[axis] {
            1 => 0,
            _ => (width / self.spacing[axis] - 1e-9).ceil().max(0.0) as usize,
        });
        let before = DVec3::from_array(more.map(|n| n as f64));
        let shape = [0, 1, 2].map(|axis| self.shape[axis].saturating_add(more[axis].saturating_mul(2)));
        Self { shape, min: self.min - before * self.spacing, spacing: self.spacing }
    }

    /// The part of the grid that starts at voxel `start` and has `shape` voxels.
    pub fn block(&self, start: [usize; 3], shape: [usize; 3]) -> Self {
        let offset = DVec3::new(start[0] as f64, start[1] as f64, start[2] as f64);
        Self { shape, min: self.min + offset * self.spacing, spacing: self.spacing }
    }
}

impl View {
    /// The view of a scanner at `angle` (radians) of the circle.
    pub fn new(scanner: &Scanner, angle: f64) -> Self {
        let (s, c) = (sin(angle), cos(angle));
        let Scanner { beam, detector, .. } = *scanner;
        Self {
            angle,
            beam,
            detector,
            source: DVec3::new(beam.dso() * c, beam.dso() * s, 0.0),
            u: DVec3::new(-s, c, 0.0),
            v: DVec3::NEG_Z,
            w: DVec3::new(-c, -s, 0.0),
        }
    }

    /// World → camera: components along (u, v, w) seen from the source.
    pub fn to_camera(&self, point: DVec3) -> DVec3 {
        let offset = point - self.source;
        DVec3::new(self.u.dot(offset), self.v.dot(offset), self.w.dot(offset))
    }

    /// The ray through the centre of a pixel.
    pub fn ray(&self, row: usize, column: usize) -> Ray {
        let (u, v) = self.detector.position(row as f64, column as f64);
        match self.beam {
            Beam::Cone { dsd, .. } => {
                Ray { origin: self.source, direction: (self.u * u + self.v * v + self.w * dsd).normalize() }
            }
            Beam::Parallel { .. } => Ray { origin: self.source + self.u * u + self.v * v, direction: self.w },
        }
    }

    /// Detector position (u, v) of the projection of a point given in camera coordinates, scene units.
    ///
    /// `None` for a point at or behind the source of a cone beam.
    pub fn project(&self, camera: DVec3) -> Option<(f64, f64)> {
        match self.beam {
            Beam::Cone { dsd, .. } => (camera.z > 0.0).then(|| (dsd * camera.x / camera.z, dsd * camera.y / camera.z)),
            Beam::Parallel { .. } => Some((camera.x, camera.y)),
        }
    }

    /// Whether v is -z: all rays of a column then lie in one vertical plane.
    pub fn is_upright(&self) -> bool {
        self.v == DVec3::NEG_Z
    }
}

impl Scanner {
    /// The scanner of R²-Gaussian's synthetic scans: a cone beam, `pixels`² pixels and `voxels`³ voxels.
    ///
    /// The volume is the cube from -1 to 1. The source is 5 from the rotation axis and 7 from the detector, a square with
    /// sides of 4.
    pub fn synthetic(voxels: usize, pixels: usize) -> Self {
        let pitch = 4.0 / pixels as f64;
        let detector =
            Detector { rows: pixels, columns: pixels, pitch_v: pitch, pitch_u: pitch, offset_u: 0.0, offset_v: 0.0 };
        Self { beam: Beam::Cone { dso: 5.0, dsd: 7.0 }, detector, grid: Grid::cube(voxels) }
    }

    /// `n` angles from `start`, evenly spaced over `span` (radians), end excluded.
    pub fn uniform_angles(n: usize, start: f64, span: f64) -> Vec<f64> {
        (0..n).map(|i| start + span * i as f64 / n as f64).collect()
    }

    /// The view at `angle` (radians) of the circle.
    pub fn view(&self, angle: f64) -> View {
        View::new(self, angle)
    }

    /// The ray through the centre of a pixel: [`View::ray`].
    pub fn ray(&self, view: &View, row: usize, column: usize) -> Ray {
        view.ray(row, column)
    }

    /// Checks sizes and distances, and that the projection of the volume reaches the detector.
    ///
    /// # Errors
    /// An error for the first check that fails.
    pub fn validate(&self) -> Result<()> {
        let d = &self.detector;
        if d.rows == 0 || d.columns == 0 {
            return Err(Error::invalid(
                "detector",
                format!("{} rows × {} columns", d.rows, d.columns),
                "at least one pixel",
                "correct nDetector = [v, u]",
            ));
        }
        check_count("detector", &[d.rows, d.columns])?;
        let positive = |what: &str, value: f64, remedy: &str| match value > 0.0 && value.is_finite() {
            true => Ok(()),
            false => Err(Error::invalid(what, value, "a positive length", remedy)),
        };
        let size = "correct sDetector = [v, u], the total size";
        positive("pitch of the detector's rows", d.pitch_v, size)?;
        positive("pitch of the detector's columns", d.pitch_u, size)?;
        if !(d.offset_u.is_finite() && d.offset_v.is_finite()) {
            return Err(Error::invalid(
                "detector offset",
                format!("[{}, {}]", d.offset_u, d.offset_v),
                "finite lengths",
                "correct offDetector = [u, upwards]",
            ));
        }
        Grid::new(self.grid.shape, self.grid.min, self.grid.max())?;
        let dso = self.beam.dso();
        positive("DSO", dso, "give the distance from source to rotation axis")?;
        if let Beam::Cone { dsd, .. } = self.beam {
            positive("DSD", dsd, "give the distance from source to detector")?;
            let radius = self.radius_around_axis();
            if radius >= dso {
                return Err(Error::invalid(
                    "DSO",
                    dso,
                    format!("more than {radius}, the volume's reach around the axis"),
                    "the source would pass through the volume: give DSO and sVoxel in one unit of length, and the \
                     distance from source to rotation axis as DSO",
                ));
            }
        }
        self.sees_volume()
    }

    /// Largest distance of a corner of the volume from the rotation axis.
    fn radius_around_axis(&self) -> f64 {
        self.corners().map(|p| p.truncate().length()).fold(0.0, f64::max)
    }

    /// Whether the projection of the volume overlaps the detector in a view.
    fn is_seen(&self, view: &View) -> bool {
        let (mut low, mut high) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
        for (u, v) in self.corners().filter_map(|p| view.project(view.to_camera(p))) {
            for (axis, value) in [u, v].into_iter().enumerate() {
                low[axis] = low[axis].min(value);
                high[axis] = high[axis].max(value);
            }
        }
        let d = &view.detector;
        let (half, offset) = (d.half(), [d.offset_u, d.offset_v]);
        (0..2).all(|axis| low[axis] < offset[axis] + half[axis] && high[axis] > offset[axis] - half[axis])
    }

    /// The corners of the volume.
    fn corners(&self) -> impl Iterator<Item = DVec3> {
        let (min, size) = (self.grid.min, self.grid.size());
        (0..8).map(move |k| min + size * DVec3::new((k & 1) as f64, (k >> 1 & 1) as f64, (k >> 2) as f64))
    }

    /// An error when the projection of the volume misses the detector in every view of a full turn.
    fn sees_volume(&self) -> Result<()> {
        if Self::uniform_angles(16, 0.0, std::f64::consts::TAU).into_iter().any(|angle| self.is_seen(&self.view(angle)))
        {
            return Ok(());
        }
        let d = &self.detector;
        let [half_u, half_v] = d.half();
        Err(Error::invalid(
            "detector",
            format!("offset [{}, {}], half size [{half_u}, {half_v}] along [u, v]", d.offset_u, d.offset_v),
            "a detector that the volume's shadow reaches in some view",
            "correct offDetector = [u, upwards], sDetector = [v, u] or offOrigin, all in one unit of length",
        ))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tolerances::largest;

    fn scanner() -> Scanner {
        Scanner {
            beam: Beam::Cone { dso: 5.0, dsd: 7.0 },
            detector: Detector { rows: 6, columns: 9, pitch_v: 0.5, pitch_u: 0.4, offset_u: 0.3, offset_v: -0.2 },
            grid: Grid::cube(8),
        }
    }

    #[test]
    fn a_margin_has_voxels_of_the_same_size_on_both_sides() {
        let grid = Grid::new([8, 4, 1], DVec3::new(-1.0, -0.5, 0.0), DVec3::new(1.0, 0.5, 0.25)).unwrap();
        let around = grid.with_margin(0.25);
        assert_eq!((around.shape, around.min), ([12, 8, 1], DVec3::new(-1.5, -1.0, 0.0)));
        assert_eq!((around.spacing, grid.with_margin(0.0)), (grid.spacing, grid));
        assert_eq!(grid.with_margin(1e300).voxels(), usize::MAX);
    }

    #[test]
    fn axes_at_angle_zero_are_those_of_the_page() {
        let view = scanner().view(0.0);
        assert_eq!(
            (view.source, view.u, view.v, view.w),
            (DVec3::new(5.0, 0.0, 0.0), DVec3::Y, DVec3::NEG_Z, DVec3::NEG_X)
        );
    }

    #[test]
    fn camera_frame_is_right_handed_at_every_angle() {
        for angle in Scanner::uniform_angles(7, 0.3, 6.0) {
            let view = scanner().view(angle);
            within!((view.u.cross(view.v) - view.w).length());
        }
    }

    #[test]
    fn a_ray_through_a_pixel_projects_onto_its_centre() {
        let s = scanner();
        let view = s.view(1.1);
        for (row, column) in [(0, 0), (5, 8), (2, 3)] {
            let ray = s.ray(&view, row, column);
            let (u, v) = view.project(view.to_camera(ray.origin + ray.direction * 4.3)).unwrap();
            let (r, c) = s.detector.pixel(u, v);
            within!(largest([r - row as f64, c - column as f64]), "({row},{column}) became ({r},{c})");
        }
    }

    #[test]
    fn a_detector_beside_the_shadow_is_refused() {
        let mut s = scanner();
        s.validate().unwrap();
        s.detector.offset_v = 40.0;
        let message = s.validate().unwrap_err().to_string();
        assert!(message.contains("offDetector"), "{message}");
    }

    #[test]
    fn a_source_inside_the_volume_is_refused() {
        let mut s = scanner();
        s.beam = Beam::Cone { dso: 1.2, dsd: 7.0 };
        assert!(s.validate().is_err());
    }
}
