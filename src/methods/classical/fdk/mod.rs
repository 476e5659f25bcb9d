//! Filtered backprojection: Feldkamp, Davis and Kress for cone beams, exact for parallel beams.
//!
//! Source, `[FDK84]`: L. A. Feldkamp, L. C. Davis, J. W. Kress, *Practical cone-beam algorithm*, JOSA A 1 (1984) 612.
//! With the projection p, the detector position (u, v) and the depth `d = dso + w·x` of a voxel from the source,
//!
//! ```text
//! f(x) = ½ Σ_views Δφ · (dso/d)² · (h * [p · dsd/√(dsd² + u² + v²)])(u, v)     u = dsd·(u·x)/d, v = dsd·(v·x)/d
//! ```
//!
//! where h is the ramp filter along the rows, on a detector scaled to the rotation axis. Projections are interpolated
//! bilinearly, with 0 outside the detector. In a parallel beam both weights are 1. Δφ is half the angle between the two
//! neighbours of a view, so the views of a full turn may be uneven. A parallel view equals its opposite view, so half a
//! turn suffices. Nothing is clipped: values may be negative.
//!
//! # Conditions
//!
//! Each ray through the object must be measured, by itself or from the opposite side. With [`Turn::Measured`] the
//! weights follow from the views, from the position of the detector, and from the borders of the projections
//! ([`Borders`]): the object is *cut off* where they are clearly above air. The first row that applies decides:
//!
//! | detector | views | result |
//! |---|---|---|
//! | does not reach the axis | any | refused: the middle was not measured |
//! | any | one, or an arc of less than 180° and the fan (parallel: 180°) | refused |
//! | any | groups with several wide gaps | refused |
//! | displaced, object cut off at the near side | less than a full turn, in any beam | refused |
//! | displaced, object or volume cut off at the near side | full turn | weights of `[Wang02]` |
//! | any other, cone | arc of at least 180° and the fan | weights of `[Parker82]` |
//! | any other, cone | full turn | every ray counts half |
//! | any other, parallel | at least 180° | every direction counts once |
//!
//! - The detector is displaced if one side of the axis is wider than the other by 5 %; that is the far side.
//! - The fan is that of the volume or of the object, if that is wider; the detector limits both.
//! - An arc ends where a gap is 1.5 times as wide as all others. A full turn of a displaced detector lacks at most four
//!   mean steps. A gap is wide beyond 30° and six times the median gap.
//! - Where the object is cut off and no opposite view sees the rest, each row is continued as an ellipse. The middle
//!   of an ellipsoid up to 2.3 times as wide as the detector is right within 3 %, as in every cell of the table. Other
//!   objects are continued roughly; [`trgs_scan::plausibility`] warns of them.
//! - Few views cause streaks, and no error of the mean in the middle. They are not refused.
//!
//! # Poses
//!
//! Poses are accepted if they make one circle: detectors parallel to the axis, and the same distances, offsets, heights
//! and axis shift τ in all views. The distance of a ray from the axis is then `s = dso·sin γ + τ·cos γ`, `tan γ = u/dsd`,
//! so that `ds/dγ` has the factor `1 - τ·u/(dso·dsd)` on that of the plain circle, and angles from the ray through the
//! axis are `γ + atan(τ/dso)`. Both are exact. All other poses are refused.
//!
//! Tests: `every_cell_is_right_in_the_middle_or_refused` goes through all combinations.

mod backproject;
mod circle;
mod conditions;
mod continuation;
mod fan;
mod filter;
mod redundancy;

use super::columns::Columns;
use crate::memory::{Allocation, F32, Sizes, allocation};
use backproject::voxels;
use circle::Circle;
use filter::filtered;
use ndarray::{Array3, ArrayView3};
use redundancy::RayWeights;
use rustfft::FftNum;
use serde::{Deserialize, Serialize};
use std::ops::Range;
use trgs_core::error::{Error, Result};
use trgs_core::geometry::{Projections, Scanner, Volume};
use trgs_core::numeric::Real;
use trgs_core::numeric::elementary::{cos, sin};
use trgs_scan::borders::Borders;

/// Factor on the ramp filter that damps noise; ω is the frequency, π at the finest one.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Window {
    /// 1: the plain ramp filter of Ramachandran and Lakshminarayanan.
    #[default]
    RamLak,
    /// `sin(ω/2)/(ω/2)`
    SheppLogan,
    /// `cos(ω/2)`
    Cosine,
    /// `0.54 + 0.46·cos ω`
    Hamming,
    /// `½ + ½·cos ω`
    Hann,
}

impl Window {
    /// The windows by TIGRE's names.
    pub const NAMED: [(&str, Self); 5] = [
        ("ram-lak", Self::RamLak),
        ("shepp-logan", Self::SheppLogan),
        ("cosine", Self::Cosine),
        ("hamming", Self::Hamming),
        ("hann", Self::Hann),
    ];

    /// The factor at frequency ω.
    fn at(self, omega: f64) -> f64 {
        match self {
            Self::RamLak => 1.0,
            Self::SheppLogan if omega == 0.0 => 1.0,
            Self::SheppLogan => sin(omega / 2.0) / (omega / 2.0),
            Self::Cosine => cos(omega / 2.0),
            Self::Hamming => 0.54 + 0.46 * cos(omega),
            Self::Hann => 0.5 + 0.5 * cos(omega),
        }
    }
}

/// The angular range that the views are assumed to cover.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Turn {
    /// The measured range, by the table of conditions of `classical::fdk`.
    #[default]
    Measured,
    /// A full turn of a centred detector, even if views are missing: for a first guess from any scan.
    Full,
}

/// What a reconstruction asks of memory. A detector that is displaced or cuts the object off is `widened` before its
/// projections are filtered, at most to the double.
pub fn arrays(sizes: &Sizes, widened: bool) -> Vec<Allocation> {
    let copies = if widened { 4 } else { 1 };
    vec![allocation("filtered projections", sizes.pixels, copies * F32), allocation("volume", sizes.voxels, F32)]
}

/// Reconstructs the scanner's grid by `[FDK84]`, or exactly for parallel rays.
///
/// The volume is `[x, y, z]`, attenuation per scene unit. Accuracy: values are f32. From 180 exact views of a ball the
/// mean inside is off by 0.17 % in a cone beam, where the method itself is an approximation away from the plane of the
/// source, and by 0.003 % in a parallel beam.
///
/// # Errors
/// When the scanner is invalid, the projections do not have its detector's size, the views lack rays (see the table of
/// conditions on this page), or their poses make no circle.
///
/// Tests: `every_cell_is_right_in_the_middle_or_refused`; known densities in cone and parallel beams, off-centre, anisotropic, uneven; threads.
pub fn fdk(scanner: &Scanner, projections: &Projections, window: Window, turn: Turn) -> Result<Volume> {
    Volume::new(scanner.grid, part(scanner, projections, window, turn, 0..scanner.grid.shape[0])?)
}

/// The slices `x` of [`fdk`], with its bits, for a volume that is larger than memory: `[x, y, z]`.
///
/// # Errors
/// Those of [`fdk`], and when `x` are not slices of the grid.
///
/// Tests: `parts_have_the_bits_of_the_whole`.
pub fn part(
    scanner: &Scanner,
    projections: &Projections,
    window: Window,
    turn: Turn,
    x: Range<usize>,
) -> Result<Array3<f32>> {
    if x.start >= x.end || x.end > scanner.grid.shape[0] {
        let expected = format!("at least one of the {} slices along x", scanner.grid.shape[0]);
        return Err(Error::invalid("slices", format!("{x:?}"), expected, "give a range of slices of the grid"));
    }
    let images = projections.images.view();
    check(scanner, &projections.angles, images.shape())?;
    let Circle { scanner: circle, angles, shift } = Circle::of(scanner, projections)?;
    let seen = (turn == Turn::Measured).then(|| Borders::of(images));
    let weights = RayWeights::new(&circle, &angles, shift, seen.as_ref())?;
    Ok(match weights.widen(&circle, images) {
        Some((wide, images)) => voxels(&filtered(&wide, &weights, images.view(), window), &wide, &angles, shift, x),
        None => voxels(&filtered(&circle, &weights, images, window), &circle, &angles, shift, x),
    })
}

/// A scalar type for filtering and backprojection: f32 or f64.
pub trait Sample: Real + FftNum {}

impl<R: Real + FftNum> Sample for R {}

/// Weighted and filtered projections g, including all constant factors `[FDK84]`.
///
/// Then `f(x) = Σ_views (dso/d)² · g(u, v)`, and `f(x) = Σ_views g(u, v)` in a parallel beam.
///
/// ```text
/// g = ½ Δφ · (h * [p · dsd/√(dsd² + u² + v²)])        cone beam
/// g =   Δφ · (h * p)                                  parallel beam, where the views cover half a turn
/// ```
///
/// g is `[view, v, u]` like the projections p, attenuation per scene unit of length; transforms run in `R`. h belongs
/// to the detector scaled to the rotation axis, with pitch `pitch_u·dso/dsd`.
///
/// # Errors
/// Those of [`fdk`].
///
/// Tests: `an_impulse_becomes_the_sampled_ramp_times_its_constants`, `filtering_and_backprojecting_are_the_whole_to_the_bit`.
pub fn filter<R: Sample>(
    scanner: &Scanner,
    angles: &[f64],
    projections: ArrayView3<'_, R>,
    window: Window,
) -> Result<Array3<R>> {
    check(scanner, angles, projections.shape())?;
    let weights = RayWeights::new(scanner, angles, 0.0, None)?;
    Ok(filtered(scanner, &weights, projections, window).images())
}

/// The weighted sum of the views at every voxel: `f(x) = Σ_views (dso/d)² · g(u, v)` `[FDK84]`.
///
/// The weight is 1 in a parallel beam; (u, v) is the point where the voxel's ray meets the detector.
///
/// `filtered` g is `[view, v, u]`, interpolated bilinearly between pixel centres, with zeros around the detector. The
/// volume is `[x, y, z]` on the scanner's grid, in the unit of g.
///
/// # Errors
/// Those of [`fdk`].
///
/// Tests: `a_pixel_spreads_over_the_voxels_it_sees`, `filtering_and_backprojecting_are_the_whole_to_the_bit`.
pub fn backproject<R: Sample>(scanner: &Scanner, angles: &[f64], filtered: ArrayView3<'_, R>) -> Result<Array3<R>> {
    check(scanner, angles, filtered.shape())?;
    Ok(voxels(&Columns::from_images(filtered), scanner, angles, 0.0, 0..scanner.grid.shape[0]))
}

/// Rejects an invalid scanner, and projections that do not fit it.
fn check(scanner: &Scanner, angles: &[f64], shape: &[usize]) -> Result<()> {
    scanner.validate()?;
    let expected = [angles.len(), scanner.detector.rows, scanner.detector.columns];
    if shape == expected && !angles.is_empty() {
        return Ok(());
    }
    let [_, rows, columns] = expected;
    let (got, expected) =
        (format!("shape {shape:?}"), format!("[view, {rows}, {columns}] with an angle for each view"));
    Err(Error::invalid("projections", got, expected, "give one image [v, u] per angle"))
}

#[cfg(test)]
#[path = "tests.rs"]
mod cells;

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;
    use std::f64::consts::{PI, TAU};
    use trgs_core::geometry::Beam;
    use trgs_core::geometry::{Detector, Grid};
    use trgs_core::numeric::threads;
    use trgs_scan::phantom::Phantom;
    use trgs_scan::phantom::solid::{Shape, Solid};

    const CENTRE: DVec3 = DVec3::new(0.15, -0.2, 0.1);

    fn ball() -> Phantom {
        Phantom { name: "ball".into(), solids: vec![Solid::new(Shape::Ellipsoid, 0.6, CENTRE, DVec3::splat(0.5))] }
    }

    fn scanner(beam: Beam) -> Scanner {
        let detector = Detector { rows: 96, columns: 110, pitch_v: 0.035, pitch_u: 0.03, offset_u: 0.0, offset_v: 0.0 };
        Scanner { beam, detector, grid: Grid::cube(40) }
    }

    fn turn(n: usize) -> Vec<f64> {
        Scanner::uniform_angles(n, 0.2, TAU)
    }

    /// Means within 0.35 of the centre and beyond 0.65 of it.
    fn means(volume: &Volume) -> (f64, f64) {
        let mut sums = [(0.0, 0), (0.0, 0)];
        for ((x, y, z), &value) in volume.values.indexed_iter() {
            let distance = volume.grid.centre([x, y, z]).distance(CENTRE);
            let (sum, count) = &mut sums[usize::from(distance > 0.5)];
            if !(0.35..0.65).contains(&distance) {
                *sum += f64::from(value);
                *count += 1;
            }
        }
        (sums[0].0 / f64::from(sums[0].1), sums[1].0 / f64::from(sums[1].1))
    }

    fn assert_ball(scanner: &Scanner, angles: &[f64]) {
        let projections = ball().project(scanner, angles).unwrap();
        let (inside, outside) = means(&fdk(scanner, &projections, Window::RamLak, Turn::Measured).unwrap());
        within!("inside", (inside / 0.6 - 1.0).abs());
        within!("outside", outside.abs());
    }

    #[test]
    fn a_ball_has_its_density_in_a_cone_beam() {
        assert_ball(&scanner(Beam::Cone { dso: 5.0, dsd: 7.0 }), &turn(180));
    }

    #[test]
    fn a_ball_has_its_density_in_a_parallel_beam_from_a_full_or_half_turn() {
        let scanner = scanner(Beam::Parallel { dso: 5.0 });
        assert_ball(&scanner, &turn(180));
        assert_ball(&scanner, &turn(91));
        assert_ball(&scanner, &Scanner::uniform_angles(90, 0.7, PI));
    }

    #[test]
    fn offsets_of_detector_and_volume_and_anisotropic_voxels_are_respected() {
        for beam in [Beam::Cone { dso: 4.0, dsd: 7.0 }, Beam::Parallel { dso: 4.0 }] {
            let mut scanner = scanner(beam);
            (scanner.detector.offset_u, scanner.detector.offset_v) = (0.2, -0.15);
            scanner.grid = Grid::new([31, 40, 24], DVec3::new(-0.8, -0.9, -1.0), DVec3::new(0.95, 0.7, 0.9)).unwrap();
            assert_ball(&scanner, &turn(180));
        }
    }

    #[test]
    fn a_short_scan_is_as_good_as_a_full_turn() {
        let scanner = scanner(Beam::Cone { dso: 5.0, dsd: 7.0 });
        // Half a turn and a fan of 2·asin(1/5), 23°; then more.
        for span in [3.56, 4.4, 5.5] {
            assert_ball(&scanner, &Scanner::uniform_angles(150, 0.9, span));
        }
        let short = Scanner::uniform_angles(150, 0.9, 3.4);
        let projections = ball().project(&scanner, &short).unwrap();
        let refused = fdk(&scanner, &projections, Window::RamLak, Turn::Measured).unwrap_err().to_string();
        assert!(refused.contains("arc of the views: got 194.8"), "{refused}");
        fdk(&scanner, &projections, Window::RamLak, Turn::Full).unwrap();
    }

    #[test]
    fn a_displaced_detector_is_as_good_as_a_centred_one() {
        // The ball reaches 0.75 from the axis, its projection 1.06; one side of the detector ends at 0.4.
        for beam in [Beam::Cone { dso: 5.0, dsd: 7.0 }, Beam::Parallel { dso: 5.0 }] {
            for side in [1.0, -1.0] {
                let mut scanner = scanner(beam);
                (scanner.detector.columns, scanner.detector.offset_u) = (66, side * 0.59);
                assert_ball(&scanner, &turn(180));
                let projections = ball().project(&scanner, &turn(180)).unwrap();
                let (inside, _) = means(&fdk(&scanner, &projections, Window::RamLak, Turn::Full).unwrap());
                beyond!((inside / 0.6 - 1.0).abs(), "weights make no difference: {inside}");
            }
        }
    }

    #[test]
    fn air_that_is_not_0_is_no_object_at_the_border() {
        // A short scan whose detector is displaced by two pixels: with an object at the near side it would be refused.
        let mut scanner = scanner(Beam::Cone { dso: 5.0, dsd: 7.0 });
        scanner.detector.offset_u = 0.06;
        let mut projections = ball().project(&scanner, &Scanner::uniform_angles(60, 0.2, 4.0)).unwrap();
        projections.images += 0.04;
        assert!(fdk(&scanner, &projections, Window::RamLak, Turn::Measured).is_ok());
    }

    #[test]
    fn uneven_views_are_weighted_by_the_angle_they_stand_for() {
        let uneven: Vec<f64> = turn(180).into_iter().map(|a| a + 0.7 * sin(a)).rev().collect();
        assert_ball(&scanner(Beam::Cone { dso: 5.0, dsd: 7.0 }), &uneven);
        assert_ball(&scanner(Beam::Parallel { dso: 5.0 }), &uneven);
    }

    #[test]
    fn windows_damp_fine_detail_and_keep_the_mean() {
        let scanner = scanner(Beam::Cone { dso: 5.0, dsd: 7.0 });
        let noisy = trgs_scan::Noise::HIGH.apply(&ball().project(&scanner, &turn(60)).unwrap(), 1).unwrap();
        let roughness = |window: Window| {
            let volume = fdk(&scanner, &noisy, window, Turn::Measured).unwrap();
            let (inside, _) = means(&volume);
            within!((inside / 0.6 - 1.0).abs(), "{window:?}: {inside}");
            volume.values.var(0.0)
        };
        let values = Window::NAMED.map(|(_, window)| roughness(window));
        assert!(values.windows(2).all(|pair| pair[1] < pair[0]), "{values:?}");
    }

    #[test]
    fn filtering_and_backprojecting_are_the_whole_to_the_bit() {
        for beam in [Beam::Cone { dso: 5.0, dsd: 7.0 }, Beam::Parallel { dso: 5.0 }] {
            let scanner = scanner(beam);
            let projections = ball().project(&scanner, &turn(7)).unwrap();
            let (angles, images) = (&projections.angles, projections.images.view());
            let filtered = filter(&scanner, angles, images, Window::Hann).unwrap();
            let both = backproject(&scanner, angles, filtered.view()).unwrap();
            assert_eq!(both, fdk(&scanner, &projections, Window::Hann, Turn::Measured).unwrap().values);
        }
    }

    #[test]
    fn parts_have_the_bits_of_the_whole() {
        for displaced in [0.0, 0.59] {
            let mut scanner = scanner(Beam::Cone { dso: 5.0, dsd: 7.0 });
            (scanner.detector.columns, scanner.detector.offset_u) = (66, displaced);
            let projections = ball().project(&scanner, &turn(40)).unwrap();
            let whole = fdk(&scanner, &projections, Window::Hann, Turn::Full).unwrap().values;
            let part = |x: Range<usize>| super::part(&scanner, &projections, Window::Hann, Turn::Full, x);
            let parts = [0..13, 13..14, 14..40].map(|x| part(x).unwrap());
            let together = ndarray::concatenate(ndarray::Axis(0), &parts.each_ref().map(|part| part.view())).unwrap();
            assert_eq!(together, whole);
            assert!(part(39..41).unwrap_err().to_string().contains("40 slices"));
        }
    }

    #[test]
    fn the_number_of_threads_changes_no_bit() {
        let scanner = scanner(Beam::Parallel { dso: 5.0 });
        let projections = ball().project(&scanner, &turn(12)).unwrap();
        let run = || fdk(&scanner, &projections, Window::Hann, Turn::Measured).unwrap();
        assert_eq!(threads::install(1, run).unwrap(), threads::install(3, run).unwrap());
    }

    #[test]
    fn projections_of_another_detector_are_refused() {
        let scanner = scanner(Beam::Cone { dso: 5.0, dsd: 7.0 });
        let other = Projections::new(vec![0.0], Array3::zeros((1, 110, 96))).unwrap();
        for refused in [
            fdk(&scanner, &other, Window::RamLak, Turn::Measured).unwrap_err(),
            filter(&scanner, &other.angles, other.images.view(), Window::RamLak).unwrap_err(),
            backproject(&scanner, &other.angles, other.images.view()).unwrap_err(),
        ] {
            assert!(refused.to_string().contains("[view, 96, 110]"), "{refused}");
        }
    }
}
