//! Views that are held out, and the error of a volume in them.

use super::super::{System, dot};
use super::near::Squares;
use crate::classical::VoxelProjector;
use trgs_core::error::Result;
use trgs_core::geometry::{Detector, Projections, View};
use trgs_core::numeric::{Real, real};

/// Tiles along each side of a view held out.
const TILES: usize = 8;

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

    pub(super) fn error(&self, x: &[R]) -> Squares {
        self.squares(&self.residual(x), 1.0)
    }

    /// The error of the mixture `x₀ + s·(x - x₀)`, from the residual of x₀. Without a share s, the error of x, with the share of
    /// least error from 0 to 1.
    pub(super) fn mixed(&self, before: &[R], x: &[R], share: Option<f64>) -> Squares {
        let mut residual = self.residual(x);
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
    pub(super) fn residual(&self, x: &[R]) -> Vec<R> {
        let seen = self.system.projector.project(&self.views, x).values;
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
