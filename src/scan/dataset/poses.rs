//! Poses of a description: numbers per view in TIGRE's words, ASTRA's vectors, projection matrices.

use super::numbers::opposite;
use glam::{DMat3, DVec3};
use serde::{Deserialize, Serialize};
use std::ops::Range;
use trgs_core::error::{Error, Result};
use trgs_core::geometry::{Beam, Deviation, Pose, Scanner};
use trgs_core::words::counted;

/// Relative deviation of a vector's length from the pitch, and of an angle from a right one.
const ROUNDED: f64 = 1e-3;
/// Deviation of a stated angle from the one of the pose, radians.
const SAME_ANGLE: f64 = 1e-2;

/// A value that is the same in all views, or one for each view.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(untagged)]
pub(super) enum PerView<T> {
    /// In all views.
    Same(T),
    /// In each: training views, then test views.
    Each(Vec<T>),
}

impl<T: Copy> PerView<T> {
    /// One value for each view; one value alone holds for all.
    fn list(&self) -> &[T] {
        match self {
            Self::Same(value) => std::slice::from_ref(value),
            Self::Each(values) => values,
        }
    }
}

/// Numbers per axis; a list of lists has one list for each view.
pub(super) type Axes = PerView<Vec<f64>>;

impl Axes {
    /// One array for each view; one alone holds for all.
    pub(super) fn arrays<const N: usize>(&self, name: &str) -> Result<Vec<[f64; N]>> {
        let array = |values: &Vec<f64>| {
            values.as_slice().try_into().map_err(|_| {
                let expected = format!("{N} numbers, one per axis, or a list of {N} numbers for each view");
                Error::invalid(name, format!("{values:?}"), expected, "give one number per axis")
            })
        };
        match self {
            Self::Same(values) => Ok(vec![array(values)?]),
            Self::Each(values) => values.iter().map(array).collect(),
        }
    }
}

impl PerView<f64> {
    /// One number for each view; one alone holds for all.
    pub(super) fn numbers(&self) -> Vec<f64> {
        self.list().to_vec()
    }
}

/// The words of a scanner that may differ from view to view, in scene units and radians.
///
/// Each list has one entry that holds for all views, or one per view.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Words {
    pub(super) dso: Vec<f64>,
    pub(super) dsd: Vec<f64>,
    /// `[u, upwards]`
    pub(super) off_detector: Vec<[f64; 2]>,
    /// `[x, y, z]`
    pub(super) off_origin: Vec<[f64; 3]>,
    pub(super) axis_shift: Vec<f64>,
    pub(super) turns: Vec<[f64; 3]>,
}

/// The poses that a description states, before the angles are known.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) enum Motion {
    /// None: a circle.
    #[default]
    Circle,
    /// Deviations of each view from the circle, or one for all.
    Deviations(Vec<Deviation>),
    /// Poses, training views first.
    Poses(Vec<Pose>),
}

impl Motion {
    /// The motion of a scanner whose own numbers are the first of each list.
    ///
    /// # Errors
    /// When lists have different lengths.
    pub(super) fn of(scanner: &Scanner, words: &Words) -> Result<Self> {
        let lengths = [
            ("DSO", words.dso.len()),
            ("DSD", words.dsd.len()),
            ("offDetector", words.off_detector.len()),
            ("offOrigin", words.off_origin.len()),
            ("COR", words.axis_shift.len()),
            ("rotDetector", words.turns.len()),
        ];
        let longest = lengths.iter().copied().max_by_key(|(_, length)| *length).expect("there are words");
        if let Some((name, length)) = lengths.into_iter().find(|(_, n)| *n > 1 && *n != longest.1) {
            let expected = format!("one entry, or {} as {} has", longest.1, longest.0);
            return Err(Error::invalid(name, format!("{length} entries"), expected, "give one entry per view"));
        }
        let plain = Deviation::none(scanner);
        let origin = words.off_origin.first().map_or(DVec3::ZERO, |origin| DVec3::from_array(*origin));
        let deviation = |i: usize| {
            let mut d = plain;
            // In a parallel beam no value depends on the distances.
            if let Beam::Cone { .. } = scanner.beam {
                d.dso = at(&words.dso, i).copied().unwrap_or(d.dso);
                d.dsd = at(&words.dsd, i).copied().unwrap_or(d.dsd);
            }
            if let Some(&[u, upwards]) = at(&words.off_detector, i) {
                d.offset = [u, opposite(upwards)];
            }
            if let Some(&place) = at(&words.off_origin, i) {
                d.origin = DVec3::from_array(place) - origin;
            }
            if let Some(&shift) = at(&words.axis_shift, i) {
                d.axis_shift = shift;
            }
            if let Some(&turns) = at(&words.turns, i) {
                d.turns = turns;
            }
            d
        };
        let mut all: Vec<Deviation> = (0..longest.1.max(1)).map(deviation).collect();
        if all.iter().all(|d| *d == all[0]) {
            all.truncate(1);
        }
        Ok(if all == [plain] { Self::Circle } else { Self::Deviations(all) })
    }

    /// Whether views have entries of their own.
    pub(super) fn is_of_single_views(&self) -> bool {
        self.entries().is_some()
    }

    /// The number of entries for single views, if there are any.
    fn entries(&self) -> Option<usize> {
        match self {
            Self::Circle => None,
            Self::Deviations(all) => (all.len() > 1).then_some(all.len()),
            Self::Poses(all) => Some(all.len()),
        }
    }

    /// Checks the number of entries against the views.
    ///
    /// # Errors
    /// When it is another than that of all views.
    pub(super) fn fits(&self, train: usize, test: usize) -> Result<()> {
        match self.entries() {
            Some(entries) if entries != train + test => {
                let expected = format!(
                    "{}: {}, then {}",
                    train + test,
                    counted(train, "training view"),
                    counted(test, "test view")
                );
                let remedy = "give one entry for each view of proj_train and then of proj_test, or one entry for all";
                Err(Error::invalid("entries per view", entries, expected, remedy))
            }
            _ => Ok(()),
        }
    }

    /// Poses of the views of a range of all views, at `angles` (radians); `None` for a circle.
    pub(super) fn poses(&self, range: Range<usize>, angles: &[f64]) -> Option<Vec<Pose>> {
        match self {
            Self::Circle => None,
            Self::Deviations(all) => {
                let of = |view: usize| all[if all.len() == 1 { 0 } else { view }];
                Some(range.zip(angles).map(|(view, &angle)| of(view).pose(angle)).collect())
            }
            Self::Poses(all) => Some(all[range].to_vec()),
        }
    }
}

/// Element i of a list, or its only one.
fn at<T>(values: &[T], i: usize) -> Option<&T> {
    if values.len() == 1 { values.first() } else { values.get(i) }
}

/// A remark on the first stated angle that differs from the one of its pose.
pub(super) fn angles_differ(angles: &[f64], poses: &[Pose]) -> Option<String> {
    let turn = std::f64::consts::TAU;
    let apart = |(angle, pose): (&f64, &Pose)| {
        let apart = (angle - pose.angle()).rem_euclid(turn);
        apart.min(turn - apart)
    };
    let differs = angles.iter().zip(poses).position(|pair| apart(pair) > SAME_ANGLE)?;
    Some(format!(
        "view {differs} has the angle {}, but its vector or matrix looks in the direction {}; the angle only orders views",
        angles[differs],
        poses[differs].angle()
    ))
}

/// The pose of a vector in scene units: source (parallel beam: direction of the rays), detector's centre, u and v.
///
/// This is the order of ASTRA's `cone_vec` and `parallel3d_vec`; u and v point from a pixel to the next.
///
/// # Errors
/// When there are not twelve finite numbers, or u and v are not perpendicular and of the pixel's size.
pub fn of_vector(scanner: &Scanner, values: &[f64], scale: f64) -> Result<Pose> {
    let values: [f64; 12] = values.try_into().map_err(|_| {
        let expected = "12 numbers: source, centre of the detector, u and v, three each";
        Error::invalid("vector of a view", counted(values.len(), "number"), expected, "give 12 numbers")
    })?;
    let [first, centre, u, v] = [0, 3, 6, 9].map(|i| DVec3::new(values[i], values[i + 1], values[i + 2]));
    let detector = &scanner.detector;
    let unit = |name: &str, axis: DVec3, pitch: f64| {
        let length = axis.length();
        if (length * scale / pitch - 1.0).abs() <= ROUNDED {
            return Ok(axis / length);
        }
        let expected = format!("{}, the pixel's size from sDetector and nDetector", pitch / scale);
        let remedy = format!("correct {name} or sDetector: {name} points from one pixel to the next");
        Err(Error::invalid(format!("length of {name} of a vector"), length, expected, remedy))
    };
    let (u, v) = (unit("u", u, detector.pitch_u)?, unit("v", v, detector.pitch_v)?);
    let v = perpendicular(u, v)?;
    let centre = centre * scale;
    let source = match scanner.beam {
        Beam::Cone { .. } => first * scale,
        Beam::Parallel { dso } => {
            let (w, ray) = (u.cross(v), first.normalize());
            if w.dot(ray).abs() < 1.0 - ROUNDED * ROUNDED {
                let remedy =
                    "give u and v perpendicular to the rays: a tilted detector in a parallel beam is not supported";
                return Err(Error::invalid("ray of a vector", first, format!("along u × v = {w}"), remedy));
            }
            centre - w * (2.0 * dso)
        }
    };
    Ok(Pose { source, centre, u, v })
}

/// The vector of a pose in scene units, with the direction of the rays first in a parallel beam.
pub fn to_vector(scanner: &Scanner, pose: &Pose) -> Vec<f64> {
    let mut vector = pose.vector(&scanner.detector).to_vec();
    if matches!(scanner.beam, Beam::Parallel { .. }) {
        vector[..3].copy_from_slice(&pose.u.cross(pose.v).to_array());
    }
    vector
}

/// v made perpendicular to u, of which it may be off by rounding.
fn perpendicular(u: DVec3, v: DVec3) -> Result<DVec3> {
    if u.dot(v).abs() > ROUNDED {
        let got = format!("u·v = {} of unit vectors", u.dot(v));
        return Err(Error::invalid("axes of a view", got, "0: u perpendicular to v", "correct u and v"));
    }
    if u.dot(v).abs() < 1e-15 {
        return Ok(v);
    }
    let v = v - u * u.dot(v);
    Ok(v / v.length())
}

/// The pose of a projection matrix from homogeneous lengths of the file to pixels.
///
/// `matrix·(x, y, z, 1)` is proportional to (column, row, 1), with 0 at the centre of the first pixel.
///
/// # Errors
/// When it is no 3 × 4 matrix of a cone beam onto pixels of the detector's shape.
pub(super) fn of_matrix(scanner: &Scanner, matrix: &[Vec<f64>], scale: f64) -> Result<Pose> {
    let expected = "3 rows of 4 numbers that map (x, y, z, 1) to (column, row, 1) times a factor";
    let refused = |got: String, remedy: &str| Error::invalid("matrix of a view", got, expected, remedy);
    if matrix.len() != 3 || matrix.iter().any(|row| row.len() != 4) {
        return Err(refused(format!("{matrix:?}"), "give a 3 × 4 matrix"));
    }
    if matches!(scanner.beam, Beam::Parallel { .. }) {
        return Err(refused("a parallel beam".into(), "give vectors for a parallel beam"));
    }
    let row = |i: usize| DVec3::new(matrix[i][0], matrix[i][1], matrix[i][2]);
    let linear = DMat3::from_cols(row(0), row(1), row(2)).transpose();
    let size = row(2).length();
    if linear.determinant() == 0.0 || !linear.determinant().is_finite() {
        return Err(refused("a singular matrix".into(), "check the matrix"));
    }
    let source = -(linear.inverse() * DVec3::new(matrix[0][3], matrix[1][3], matrix[2][3])) * scale;
    let detector = &scanner.detector;
    // Rows in units of the depth: pixels per slope, and the pixel where the perpendicular meets the detector.
    let forward = row(2) / size;
    let of = |i: usize| {
        let foot = row(i).dot(forward) / size;
        (row(i) / size - forward * foot, foot)
    };
    let ((along_u, column), (along_v, line)) = (of(0), of(1));
    let (u, v) = (along_u / along_u.length(), along_v / along_v.length());
    let (dsd, from_v) = (along_u.length() * detector.pitch_u, along_v.length() * detector.pitch_v);
    if (from_v / dsd - 1.0).abs() > ROUNDED {
        let got =
            format!("a distance from source to detector of {} along u and {} along v", dsd / scale, from_v / scale);
        return Err(refused(got, "correct the matrix, or the pixel's size in sDetector and nDetector"));
    }
    // The sign of a matrix is free: the detector lies in front of the source.
    let sign = if u.cross(v).dot(forward) > 0.0 { 1.0 } else { -1.0 };
    let (u, v) = (u * sign, v * sign);
    let v = perpendicular(u, v)?;
    let offset = |foot: f64, count: usize, pitch: f64| (count as f64 / 2.0 - 0.5 - foot) * pitch;
    let centre = source
        + u.cross(v) * dsd
        + u * offset(column, detector.columns, detector.pitch_u)
        + v * offset(line, detector.rows, detector.pitch_v);
    Ok(Pose { source, centre, u, v })
}
