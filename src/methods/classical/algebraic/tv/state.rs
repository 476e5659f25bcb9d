//! The state from which a reconstruction with total variation resumes to the same bits.

use super::{TvRun, TvSettings};
use crate::classical::VoxelProjector;
use crate::classical::algebraic::voxel_run::Numbers;
use crate::classical::algebraic::{Pass, VoxelRun, VoxelState};
use trgs_core::error::Result;
use trgs_core::geometry::{Projections, Volume};
use trgs_core::numeric::Real;

impl<'a, R: Real> TvRun<'a, R> {
    /// Continues a run with the same projections and settings, bit-identical to an uninterrupted run.
    ///
    /// # Errors
    /// When the state belongs to a volume of another size, or the projections do not fit the projector.
    pub fn resume(
        projector: &'a VoxelProjector,
        projections: &'a Projections,
        settings: &TvSettings,
        state: &VoxelState,
    ) -> Result<Self> {
        let mut run = Self::prepared(projector, projections, settings)?;
        let ([t, beta, objective, change, lipschitz, sets], [x, before, q0, q1, q2]) = state.get([run.x.len(); 5])?;
        (run.seen, run.seen_before) = (run.project(&x), run.project(&before));
        (run.x, run.before, run.sets) = (x, before, (sets as usize).clamp(1, run.views.len()));
        run.proximal.set_dual([q0, q1, q2]);
        (run.iteration, run.momentum) = (state.iteration, [t, beta]);
        (run.objective, run.change, run.lipschitz) = (objective, change, lipschitz);
        Ok(run)
    }
}

impl<R: Real> VoxelRun for TvRun<'_, R> {
    fn is_finished(&self) -> bool {
        self.is_finished()
    }

    fn step(&mut self) -> Result<Option<Pass>> {
        self.step().map(Some)
    }

    fn state(&self) -> VoxelState<'_> {
        let ([q0, q1, q2], [t, beta]) = (self.proximal.dual(), self.momentum);
        VoxelState {
            iteration: self.iteration,
            scalars: vec![t, beta, self.objective, self.change, self.lipschitz, self.sets as f64],
            arrays: [&self.x, &self.before, q0, q1, q2].map(|values| Numbers::new(values)).into(),
        }
    }

    fn into_volume(self: Box<Self>) -> Result<Volume> {
        self.volume()
    }
}
