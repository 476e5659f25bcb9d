//! The state from which a reconstruction with total variation resumes to the same bits.

use super::{TvRun, TvSettings};
use crate::classical::VoxelProjector;
use crate::classical::algebraic::{Division, Name, Pass, VoxelRun, VoxelState};
use trgs_core::error::Result;
use trgs_core::geometry::{Projections, Volume};
use trgs_core::numeric::Real;

impl<'a, R: Real> TvRun<'a, R> {
    /// Continues a run with the same projections and settings, bit-identical to an uninterrupted run.
    ///
    /// # Errors
    /// When the state belongs to a volume of another size, the projections do not fit the projector, or volumes are in slabs.
    pub fn resume(
        projector: &'a VoxelProjector,
        projections: &'a Projections,
        settings: &TvSettings,
        state: &VoxelState,
        division: &Division,
    ) -> Result<Self> {
        let space = division.space(projector, projector.views(projections.trajectory())?)?;
        let mut run = Self::prepared(projector, projections, settings, space)?;
        let voxels = projector.scanner().grid.voxels();
        let ([t, beta, objective, change, lipschitz, sets], arrays) = state.get([voxels; 5])?;
        run.space.resume(arrays.into())?;
        (run.seen, run.seen_before) = (run.project(Name::Volume)?, run.project(Name::Before)?);
        run.sets = (sets as usize).clamp(1, run.views.len());
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
        let [t, beta] = self.momentum;
        let scalars = vec![t, beta, self.objective, self.change, self.lipschitz, self.sets as f64];
        VoxelState::of(self.iteration, scalars, self.space.arrays())
    }

    fn into_volume(self: Box<Self>) -> Result<Volume> {
        self.volume()
    }
}
