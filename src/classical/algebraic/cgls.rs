//! Conjugate gradients on the normal equations (CGLS). Not in the paper.

use super::{Counter, Observe, See, System, add_scaled, dot, norm};
use crate::classical::VoxelProjector;
use crate::error::Result;
use crate::numeric::{Real, real};
use crate::scene::{Projections, Volume};
use std::ops::ControlFlow;

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
    let mut counter = Counter::new(iterations, observe);
    cgls_seen::<R>(projector, projections, iterations, &mut |iteration, residual, _| {
        counter.done(iteration, residual).map(|()| ControlFlow::Continue(()))
    })
}

/// [`cgls()`] that passes the volume to `see` after every iteration.
pub(super) fn cgls_seen<R: Real>(
    projector: &VoxelProjector,
    projections: &Projections,
    iterations: usize,
    see: &mut See<'_, R>,
) -> Result<Volume> {
    let system = System::<R>::new(projector, projections)?;
    let views = projector.views(system.trajectory)?;
    let adjoint = |values: &[R]| {
        let mut out = system.empty();
        projector.adjoin(&views, [values], &mut out, |out, [value]| *out = value);
        out
    };
    let mut x = system.empty();
    let mut residual = system.measured.clone();
    let mut direction = adjoint(&residual);
    let mut gamma = dot(&direction, &direction);
    for iteration in 1..=iterations {
        let image = projector.project(&views, &direction).values;
        let size = dot(&image, &image);
        if size == 0.0 {
            break;
        }
        let step = gamma / size;
        add_scaled(&mut x, step, &direction);
        add_scaled(&mut residual, -step, &image);
        if see(iteration, norm(&residual), &x)?.is_break() {
            break;
        }
        let gradient = adjoint(&residual);
        let next = dot(&gradient, &gradient);
        let factor: R = real(next / gamma);
        direction
            .iter_mut()
            .zip(&gradient)
            .for_each(|(direction, &gradient)| *direction = gradient + factor * *direction);
        gamma = next;
    }
    system.volume(x)
}
