//! Conjugate gradients on the normal equations (CGLS). Not in the paper.

use super::{Observe, Pass, System, VoxelRun, VoxelState, add_scaled, dot, norm, run_to_the_end};
use crate::classical::VoxelProjector;
use crate::memory::{Allocation, Sizes, allocation};
use trgs_core::error::Result;
use trgs_core::geometry::{Projections, View, Volume};
use trgs_core::numeric::{Real, real};

/// Minimises `‖A x - p‖` over the Krylov space of `iterations` dimensions, from zeros `[HS52]`.
///
/// Few iterations smooth, many fit the noise. The volume is attenuation per scene unit, and values may be negative. The
/// residual never grows, and the iteration ends early when no search direction is left.
///
/// # Errors
/// Those of [`super::sart()`].
///
/// Tests: `consistent_data_are_solved`, `the_residual_of_cgls_never_grows`, `the_number_of_threads_changes_no_bit`.
pub fn cgls<R: Real>(
    projector: &VoxelProjector,
    projections: &Projections,
    iterations: usize,
    observe: &mut Observe<'_>,
) -> Result<Volume> {
    run_to_the_end(CglsRun::<R>::new(projector, projections, iterations, None)?, observe)
}

/// What a run asks of memory.
pub fn arrays(sizes: &Sizes) -> Vec<Allocation> {
    let volumes = "volume, direction and gradient, and as it is written";
    vec![
        allocation("projections, residual, image or pairs", sizes.pixels, 3 * sizes.real),
        allocation(volumes, sizes.voxels, 3 * sizes.real + sizes.written()),
        sizes.at_work(1),
    ]
}

/// CGLS, run one iteration at a time.
pub struct CglsRun<'a, R> {
    system: System<'a, R>,
    views: Vec<View>,
    iterations: usize,
    x: Vec<R>,
    /// `p - A x`.
    residual: Vec<R>,
    direction: Vec<R>,
    /// Squared norm of the gradient that the direction comes from.
    gamma: f64,
    iteration: usize,
}

impl<'a, R: Real> CglsRun<'a, R> {
    /// Begins at zeros, or continues from a state with the bits of an uninterrupted run.
    ///
    /// # Errors
    /// When the projections or the state do not fit the projector.
    pub fn new(
        projector: &'a VoxelProjector,
        projections: &'a Projections,
        iterations: usize,
        state: Option<&VoxelState>,
    ) -> Result<Self> {
        let system = System::<R>::new(projector, projections)?;
        let views = projector.views(system.trajectory)?;
        let (x, residual) = (system.empty(), system.measured.clone());
        let mut run = Self { system, views, iterations, x, residual, direction: Vec::new(), gamma: 0.0, iteration: 0 };
        if let Some(state) = state {
            let lengths = [run.x.len(), run.residual.len(), run.x.len()];
            ([run.gamma], [run.x, run.residual, run.direction]) = state.get(lengths)?;
            run.iteration = state.iteration;
        } else {
            run.direction = run.gradient();
            run.gamma = dot(&run.direction, &run.direction);
        }
        Ok(run)
    }

    /// The current volume, in array order.
    pub(super) fn values(&self) -> &[R] {
        &self.x
    }

    /// `Aᵀ(p - A x)`.
    fn gradient(&self) -> Vec<R> {
        let mut out = self.system.empty();
        self.system.projector.adjoin(&self.views, [&self.residual], 0, &mut out, |out, [value]| *out = value);
        out
    }

    /// Moves along the direction; returns the norm of the residual, or `None` when no direction is left.
    fn improve(&mut self) -> Option<f64> {
        let image = self.system.projector.project(&self.views, &self.direction).values;
        let size = dot(&image, &image);
        if size == 0.0 {
            return None;
        }
        let step = self.gamma / size;
        add_scaled(&mut self.x, step, &self.direction);
        add_scaled(&mut self.residual, -step, &image);
        self.iteration += 1;
        Some(norm(&self.residual))
    }

    /// Finds the next direction.
    fn turn(&mut self) {
        let gradient = self.gradient();
        let next = dot(&gradient, &gradient);
        let factor: R = real(next / self.gamma);
        let pairs = self.direction.iter_mut().zip(&gradient);
        pairs.for_each(|(direction, &gradient)| *direction = gradient + factor * *direction);
        self.gamma = next;
    }
}

impl<R: Real> VoxelRun for CglsRun<'_, R> {
    fn is_finished(&self) -> bool {
        self.iteration >= self.iterations
    }

    fn step(&mut self) -> Result<Option<Pass>> {
        let Some(residual) = self.improve() else { return Ok(None) };
        let pass = Pass::new(self.iteration, self.iterations, residual)?;
        self.turn();
        Ok(Some(pass))
    }

    fn state(&self) -> VoxelState<'_> {
        VoxelState::of(self.iteration, vec![self.gamma], vec![&self.x, &self.residual, &self.direction])
    }

    fn into_volume(self: Box<Self>) -> Result<Volume> {
        self.system.volume(self.x)
    }
}
