//! Decides whether an interpolated volume on the voxel grid or a continuous object was scanned.
//!
//! The grid is moved by half a voxel along each axis with more than one voxel.
//!
//! The projections of an interpolated volume are fitted best on its own voxel grid. For a continuous object no grid is
//! special: a moved grid fits its projections equally well, better or worse. Two measures compare solutions of
//! [`super::tv()`] on the moved grid (primed) and on the grid of the scan:
//!
//! ```text
//! fitted   = ln ‖A'x' - p‖ - ln ‖A x - p‖                            from all views, weight 1e-4
//! held out = ½ ln Σ_f ‖A'_f x'_f - p_f‖² - ½ ln Σ_f ‖A_f x_f - p_f‖²     from all views but those of fold f, weight 1e-3
//! ```
//!
//! Their sum is near zero for a continuous object, of either sign, and positive for an interpolated volume. Flat faces
//! of a continuous object that happen to lie between voxels look like a grid: therefore [`crate::reconstruction`] also
//! tests the fitted primitives. Not in the paper.

use super::held_out::{Held, go_on, weight_folds};
use super::{ObserveChoice, TvRun, TvSettings};
use crate::classical::{RayModel, VoxelProjector};
use crate::error::Result;
use crate::numeric::Real;
use crate::numeric::elementary::log;
use crate::scene::{Projections, Scanner};
use serde::Serialize;

/// The setting that is chosen.
const KEY: &str = "sampling";
/// Weight and iterations of the fits to all views: little smoothing, since smoothing hides the grid.
const FITTED: (f64, usize) = (1e-4, 40);
/// Weight and iterations of the fits without a fold.
const HELD_OUT: (f64, usize) = (1e-3, 50);
/// Shift of the grid, voxels.
const SHIFT: f64 = 0.5;

/// Loss of a voxel fit when the grid moves by half a voxel: natural logarithms of residual ratios.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Alignment {
    /// From all views.
    pub fitted: f64,
    /// From held-out views; 0 where there are too few views to hold any out.
    pub held_out: f64,
}

impl Alignment {
    /// The sum of both measures.
    pub fn sum(&self) -> f64 {
        self.fitted + self.held_out
    }
}

/// Log ratios of the residuals of voxel fits with and without a shift of the grid by half a voxel.
///
/// Not in the paper. Weight, iterations and tolerance of `settings` are not used. With too few views to hold any out,
/// `held_out` is 0.
///
/// # Errors
/// Those of [`super::tv()`], and [`crate::Error::Interrupted`] when `observe` breaks.
///
/// Tests: `interpolated_volumes_lie_on_the_grid_and_objects_do_not`.
pub fn alignment<R: Real>(
    scanner: &Scanner,
    projections: &Projections,
    settings: &TvSettings,
    observe: &mut ObserveChoice<'_>,
) -> Result<Alignment> {
    let moved = moved(scanner);
    let mut fitted = [0.0; 2];
    let mut held_out = [0.0; 2];
    for (k, scanner) in [scanner, &moved].into_iter().enumerate() {
        let projector = VoxelProjector::new(scanner, RayModel::Joseph)?;
        let mut run = |projections: &Projections, (weight, iterations), held: Option<&Projections>| {
            let settings = TvSettings { weight, iterations, tolerance: 0.0, ..*settings };
            let mut run = TvRun::<R>::new(&projector, projections, &settings, None)?;
            let mut residual = 0.0;
            while !run.is_finished() {
                residual = run.step()?.residual;
                go_on(observe(KEY, None))?;
            }
            Ok::<_, crate::Error>(match held {
                Some(held) => Held::<R>::new(&projector, held)?.error(run.values())[0],
                None => residual * residual,
            })
        };
        fitted[k] = run(projections, FITTED, None)?;
        for [train, held] in weight_folds(&projector, projections) {
            held_out[k] += run(&projections.select(&train), HELD_OUT, Some(&projections.select(&held)))?;
        }
    }
    // A perfect fit, as of an empty object, says nothing.
    let half_log_ratio = |[first, moved]: [f64; 2]| match first > 0.0 && moved > 0.0 {
        true => 0.5 * log(moved / first),
        false => 0.0,
    };
    Ok(Alignment { fitted: half_log_ratio(fitted), held_out: half_log_ratio(held_out) })
}

/// The scanner with the grid moved by half a voxel and as large as before.
fn moved(scanner: &Scanner) -> Scanner {
    let mut moved = *scanner;
    let grid = &mut moved.grid;
    for axis in (0..3).filter(|&axis| scanner.grid.shape[axis] > 1) {
        grid.shape[axis] += 1;
        grid.min[axis] -= SHIFT * grid.spacing[axis];
    }
    moved
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::simulate::{Object, Plan, simulate};
    use crate::scene::{Beam, Detector, Grid, Noise, Phantom};
    use std::ops::ControlFlow;

    #[test]
    fn interpolated_volumes_lie_on_the_grid_and_objects_do_not() {
        let detector = Detector { rows: 40, columns: 40, pitch_v: 0.1, pitch_u: 0.1, offset_u: 0.0, offset_v: 0.0 };
        for (beam, name) in [(Beam::Cone { dso: 5.0, dsd: 7.0 }, "torso"), (Beam::Parallel { dso: 5.0 }, "shepp-logan")]
        {
            let scanner = Scanner { beam, detector, grid: Grid::cube(24) };
            let plan = Plan { views: 11, test_views: 0, noise: Noise::LOW, seed: 2 };
            let phantom = Phantom::by_name(name, 0).unwrap();
            let scan = simulate("scan", Object::Phantom(&phantom), &scanner, &plan).unwrap();
            let volume = scan.truth.as_ref().unwrap();
            let of_volume = simulate("scan", Object::Volume(volume), &scanner, &plan).unwrap();
            let of = |projections: &Projections| {
                let mut quiet = |_: &str, _: Option<&_>| ControlFlow::Continue(());
                alignment::<f32>(&scanner, projections, &TvSettings::default(), &mut quiet).unwrap()
            };
            let (continuous, interpolated) = (of(&scan.train), of(&of_volume.train));
            eprintln!("{name}: {continuous:?}, interpolated {interpolated:?}");
            // Scans of 64³ are as far apart: see CHOICES.md.
            within!("objects", continuous.sum());
            beyond!("volumes", interpolated.sum());
            // The result must not depend on the unit of density.
            let mut scaled = of_volume.train.clone();
            scaled.images *= 0.25;
            assert_eq!(of(&scaled), interpolated);
        }
    }

    #[test]
    fn nothing_and_few_views_say_little_but_something_finite() {
        let detector = Detector { rows: 12, columns: 12, pitch_v: 0.3, pitch_u: 0.3, offset_u: 0.0, offset_v: 0.0 };
        let scanner = Scanner { beam: Beam::Cone { dso: 5.0, dsd: 7.0 }, detector, grid: Grid::cube(8) };
        let plan = Plan { views: 2, test_views: 0, noise: Noise::None, seed: 2 };
        let phantom = Phantom::by_name("torso", 0).unwrap();
        let mut scan = simulate("scan", Object::Phantom(&phantom), &scanner, &plan).unwrap().train;
        let mut quiet = |_: &str, _: Option<&_>| ControlFlow::Continue(());
        let found = alignment::<f32>(&scanner, &scan, &TvSettings::default(), &mut quiet).unwrap();
        assert!(found.fitted.is_finite() && found.fitted != 0.0 && found.held_out == 0.0, "{found:?}");
        scan.images.fill(0.0);
        let found = alignment::<f32>(&scanner, &scan, &TvSettings::default(), &mut quiet).unwrap();
        assert_eq!(found, Alignment { fitted: 0.0, held_out: 0.0 });
    }

    #[test]
    fn a_grid_of_one_slice_moves_in_its_plane_alone() {
        let grid = Grid { shape: [8, 6, 1], ..Grid::cube(8) };
        let detector = Detector { rows: 1, columns: 9, pitch_v: 0.3, pitch_u: 0.3, offset_u: 0.0, offset_v: 0.0 };
        let moved = moved(&Scanner { beam: Beam::Parallel { dso: 5.0 }, detector, grid }).grid;
        assert_eq!(moved.shape, [9, 7, 1]);
        assert_eq!(moved.min, grid.min - glam::DVec3::new(0.125, 0.125, 0.0));
        assert_eq!(moved.spacing, grid.spacing);
    }
}
