//! Iterative reconstruction of voxels: solves A x = p with the pair of [`super::voxel_projector`].
//!
//! | method | one iteration | source |
//! |---|---|---|
//! | [`sart()`] | for each set of views: `x ← x + λ·Aᵀ[(p - A x)/A1]/Aᵀ1`, then `x ≥ 0` | `[SART84]`; sets of more than one view: OS-SART |
//! | [`asd_pocs()`] | one SART iteration, then descent of the total variation by as much as SART's step | `[SP08]` |
//! | [`cgls()`] | minimises `‖A x - p‖` over a Krylov space of one more dimension | `[HS52]` on the normal equations |
//! | [`tv()`] | one FISTA step for `½‖A x - p‖² + λ·TV(x)`, `x ≥ 0` | `[BT09]` |
//!
//! All sums of squares use a tree of fixed shape in f64: any number of threads gives the same bits. Not in the paper,
//! which compares with the first two.
//!
//! `[SART84]`: A. H. Andersen, A. C. Kak, *Simultaneous algebraic reconstruction technique*, Ultrason. Imaging 6 (1984) 81.
//! `[SP08]`: E. Y. Sidky, X. Pan, *Image reconstruction in circular cone-beam computed tomography by constrained,
//! total-variation minimization*, Phys. Med. Biol. 53 (2008) 4777.
//! `[HS52]`: M. R. Hestenes, E. Stiefel, *Methods of conjugate gradients*, J. Res. NBS 49 (1952) 409.

mod asd_pocs;
mod cgls;
mod division;
pub(crate) mod held_out;
mod order;
mod proximal;
mod sart;
mod slabs;
mod space;
#[cfg(test)]
mod tests;
mod total_variation;
mod tv;
mod voxel_run;

pub use asd_pocs::{AsdPocsRun, AsdPocsSettings, asd_pocs};
pub use cgls::{CglsRun, arrays as cgls_arrays, cgls};
pub use division::Division;
pub use held_out::{
    Choice, FEWEST_TRIALS, Mixture, ObserveChoice, Passes, SpaceOf, Trial, choose_passes, choose_weight,
    choose_weight_in, mixture,
};
pub use order::Order;
pub use sart::{SartRun, SartSettings, sart};
use space::Whole;
pub use space::{Change, Measure, Name, Part, Space};
pub use tv::{TvRun, TvSettings, tv};
pub use voxel_run::{VoxelRun, VoxelState};

use super::columns::Columns;
use super::voxel_projector::VoxelProjector;
use ndarray::Array3;
use serde::{Deserialize, Serialize};
use std::ops::ControlFlow;
use trgs_core::error::{Error, Result};
use trgs_core::geometry::{Projections, Trajectory, View, Volume};
use trgs_core::numeric::{Real, real, reduce, threads};

/// Elements of a volume per parallel task where nothing else determines the split.
const CHUNK: usize = 1 << 16;

/// Progress of an iterative reconstruction.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Pass {
    /// Iterations done.
    pub iteration: usize,
    /// Largest number of iterations.
    pub iterations: usize,
    /// `‖A x - p‖`, scene units of length × density.
    ///
    /// For [`sart()`] each view counts before its own correction; for networks, the rays of the step alone.
    pub residual: f64,
    /// The objective of [`tv()`].
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub objective: Option<f64>,
    /// Length of the last step of [`tv()`] relative to the volume: its fixed-point residual.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub change: Option<f64>,
}

/// Observer of every iteration; breaking ends the reconstruction with an error.
pub type Observe<'a> = dyn FnMut(&Pass) -> ControlFlow<()> + 'a;

/// The linear system to be solved.
struct System<'a, R> {
    projector: &'a VoxelProjector,
    trajectory: Trajectory<'a>,
    /// p in the projector's order.
    measured: Vec<R>,
    /// Pixels of a view.
    pixels: usize,
}

impl<'a, R: Real> System<'a, R> {
    fn new(projector: &'a VoxelProjector, projections: &'a Projections) -> Result<Self> {
        let detector = &projector.scanner().detector;
        let (got, expected) = (projections.images.dim(), (projections.len(), detector.rows, detector.columns));
        if got != expected {
            let remedy = "give projections [view, v, u] of this scanner";
            return Err(Error::invalid("projections", format!("shape {got:?}"), format!("{expected:?}"), remedy));
        }
        let measured = Columns::from_images(projections.images.mapv(|value| real(f64::from(value))).view()).values;
        Ok(Self { projector, trajectory: projections.trajectory(), measured, pixels: detector.pixels() })
    }

    /// A volume of zeros.
    fn empty(&self) -> Vec<R> {
        vec![R::ZERO; self.projector.scanner().grid.voxels()]
    }

    /// Marks rays that intersect less than half a voxel in length.
    fn idle(&self, views: &[View]) -> Vec<bool> {
        let grid = &self.projector.scanner().grid;
        let lengths = self.projector.project(views, &vec![R::ONE; grid.voxels()]).values;
        let least = real(0.5 * grid.spacing.min_element());
        lengths.iter().map(|&length| length <= least).collect()
    }

    /// `p - A x`.
    fn residual(&self, x: &[R]) -> Result<Vec<R>> {
        let views = self.projector.views(self.trajectory)?;
        let mut values = self.projector.project(&views, x).values;
        values.iter_mut().zip(&self.measured).for_each(|(value, &measured)| *value = measured - *value);
        Ok(values)
    }

    fn volume(&self, x: Vec<R>) -> Result<Volume> {
        let grid = self.projector.scanner().grid;
        let values = x.into_iter().map(|value| value.to_f64() as f32).collect();
        Volume::new(grid, Array3::from_shape_vec(grid.shape, values).expect("a value for each voxel"))
    }
}

impl Pass {
    /// The record of an iteration whose residual must be finite.
    #[doc(hidden)]
    pub fn new(iteration: usize, iterations: usize, residual: f64) -> Result<Self> {
        if !residual.is_finite() {
            return Err(Error::NonFinite { stage: "residual", value: residual, index: Vec::new(), step: iteration });
        }
        Ok(Self { iteration, iterations, residual, objective: None, change: None })
    }
}

/// Runs a method to its end.
fn run_to_the_end(mut run: impl VoxelRun, observe: &mut Observe<'_>) -> Result<Volume> {
    while !run.is_finished() {
        let Some(pass) = run.step()? else { break };
        held_out::go_on(observe(&pass), pass.iteration)?;
    }
    Box::new(run).into_volume()
}

/// `‖values‖₂`.
fn norm<R: Real>(values: &[R]) -> f64 {
    dot(values, values).sqrt()
}

/// `⟨a, b⟩`.
fn dot<R: Real>(a: &[R], b: &[R]) -> f64 {
    let parts = threads::map(a.len().div_ceil(CHUNK), |chunk| {
        let range = chunk * CHUNK..(chunk * CHUNK + CHUNK).min(a.len());
        let (a, b) = (&a[range.clone()], &b[range]);
        reduce::sum_by(a.len(), &|i| a[i].to_f64() * b[i].to_f64())
    });
    reduce::sum(&parts)
}

/// `x ← x + factor·y`.
fn add_scaled<R: Real>(x: &mut [R], factor: f64, y: &[R]) {
    let factor: R = real(factor);
    threads::for_each_chunk(x, CHUNK, |chunk, x| {
        x.iter_mut().zip(&y[chunk * CHUNK..]).for_each(|(x, &y)| *x += factor * y);
    });
}
