//! Views that are held out, the error of a volume in them, and the mixture of two volumes with the least error.

use super::super::{System, dot};
use super::near::{Squares, relative};
use crate::classical::VoxelProjector;
use trgs_core::error::{Error, Result};
use trgs_core::geometry::{Detector, Projections, View, Volume};
use trgs_core::numeric::{Real, real};

/// Tiles along each side of a view held out.
const TILES: usize = 8;

/// A mixture `s·a + (1 - s)·b` of two volumes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Mixture {
    /// s, from 0 to 1.
    pub share: f64,
    /// Residuals of a, of b and of the mixture in the views, relative to the measured values.
    pub errors: [f64; 3],
}

/// The mixture of two volumes `[a, b]` with the least residual in views that neither was made from. Not in the paper.
///
/// Projections are linear in the volume, so s solves a least-squares problem of one number. Rays that intersect less than
/// half a voxel in length are ignored.
///
/// # Errors
/// When a volume or the projections do not fit the projector.
///
/// Tests: `a_mixture_has_no_larger_error_than_its_parts`.
pub fn mixture(projector: &VoxelProjector, views: &Projections, volumes: [&Volume; 2]) -> Result<Mixture> {
    let grid = &projector.scanner().grid;
    if let Some(other) = volumes.iter().find(|volume| volume.values.shape() != grid.shape) {
        let (got, expected) = (format!("shape {:?}", other.values.shape()), format!("{:?}", grid.shape));
        return Err(Error::invalid("volume", got, expected, "give volumes on the scan's grid"));
    }
    let held = Held::<f64>::new(projector, views)?;
    let [a, b] =
        volumes.map(|volume| held.see(&volume.values.iter().map(|&value| f64::from(value)).collect::<Vec<_>>()));
    let before = held.residual(&b);
    let share = held.mixed(&before, &a, None).share;
    let errors = [1.0, 0.0, share].map(|share| relative(held.mixed(&before, &a, Some(share)).sums));
    Ok(Mixture { share, errors })
}

/// The held-out views.
pub(super) struct Held<'a, R> {
    pub(super) system: System<'a, R>,
    views: Vec<View>,
    idle: Vec<bool>,
}

impl<'a, R: Real> Held<'a, R> {
    pub(super) fn new(projector: &'a VoxelProjector, projections: &'a Projections) -> Result<Self> {
        let system = System::<R>::new(projector, projections)?;
        let views = projector.views(system.trajectory)?;
        let idle = system.idle(&views);
        Ok(Self { system, views, idle })
    }

    /// The error of a volume that is `seen` so in these views.
    pub(super) fn error(&self, seen: &[R]) -> Squares {
        self.squares(&self.residual(seen), 1.0)
    }

    /// The line integrals of a volume in these views.
    pub(super) fn see(&self, x: &[R]) -> Vec<R> {
        self.system.projector.project(&self.views, x).values
    }

    /// The error of the mixture `x₀ + s·(x - x₀)`, from the residual of x₀ and x as it is `seen`. Without a share s, the error
    /// of x, with the share of least error from 0 to 1.
    pub(super) fn mixed(&self, before: &[R], seen: &[R], share: Option<f64>) -> Squares {
        let mut residual = self.residual(seen);
        let gain: Vec<R> = before.iter().zip(&residual).map(|(&before, &after)| before - after).collect();
        let size = dot(&gain, &gain);
        let best = if size > 0.0 { (dot(before, &gain) / size).clamp(0.0, 1.0) } else { 1.0 };
        if let Some(share) = share.filter(|share| *share < 1.0) {
            let factor: R = real(share);
            residual = before.iter().zip(&gain).map(|(&before, &gain)| before - factor * gain).collect();
        }
        self.squares(&residual, share.unwrap_or(best))
    }

    /// `A x - p`, and 0 where a ray is not used.
    pub(super) fn residual(&self, seen: &[R]) -> Vec<R> {
        let rays = seen.iter().zip(&self.system.measured).zip(&self.idle);
        rays.map(|((&seen, &p), &idle)| if idle { R::ZERO } else { seen - p }).collect()
    }

    fn squares(&self, residual: &[R], share: f64) -> Squares {
        let mut measured = self.system.measured.clone();
        measured.iter_mut().zip(&self.idle).filter(|(_, idle)| **idle).for_each(|(value, _)| *value = R::ZERO);
        let sums = [dot(residual, residual), dot(&measured, &measured).max(f64::MIN_POSITIVE)];
        let Detector { rows, columns, .. } = self.system.projector.scanner().detector;
        let mut tiles = vec![0.0; self.views.len() * TILES * TILES];
        for (at, values) in residual.chunks_exact(rows).enumerate() {
            let (view, column) = (at / columns, at % columns);
            for (row, value) in values.iter().enumerate() {
                let value = value.to_f64();
                tiles[(view * TILES + column * TILES / columns) * TILES + row * TILES / rows] += value * value;
            }
        }
        Squares { sums, tiles, share }
    }
}

#[cfg(test)]
mod tests {
    use super::super::super::{SartSettings, sart};
    use super::super::pilot_folds;
    use super::super::tests::{CONE, scan};
    use super::*;
    use crate::classical::RayModel;
    use std::ops::ControlFlow;
    use trgs_core::geometry::Grid;

    #[test]
    fn a_mixture_has_no_larger_error_than_its_parts() {
        let scan = scan(12, CONE);
        let projector = VoxelProjector::new(&scan.scanner, RayModel::Joseph).unwrap();
        let [fitted, held] = pilot_folds(&projector, &scan.train).unwrap().map(|views| scan.train.select(&views));
        let volume = |iterations| {
            let settings = SartSettings { iterations, ..SartSettings::default() };
            sart::<f32>(&projector, &fitted, &settings, &mut |_| ControlFlow::Continue(())).unwrap()
        };
        let (few, many) = (volume(2), volume(60));
        let found = mixture(&projector, &held, [&few, &many]).unwrap();
        let [of_few, of_many, mixed] = found.errors;
        assert!(0.0 < found.share && found.share < 1.0 && mixed < of_few.min(of_many), "{found:?}");
        // The other way round it is the same mixture, and a volume with itself is that volume.
        let turned = mixture(&projector, &held, [&many, &few]).unwrap();
        within!((turned.share + found.share - 1.0).abs());
        assert_eq!(mixture(&projector, &held, [&few, &few]).unwrap().errors, [of_few; 3]);
        let other = Volume { grid: Grid::cube(8), values: ndarray::Array3::zeros([8; 3]) };
        let message = mixture(&projector, &held, [&few, &other]).unwrap_err().to_string();
        assert!(message.contains("[8, 8, 8]") && message.contains("[24, 24, 24]"), "{message}");
    }
}
