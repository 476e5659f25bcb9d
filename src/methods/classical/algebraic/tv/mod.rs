//! Non-negative least squares with isotropic total variation. Not in the paper.
//!
//! ```text
//! min over x ≥ 0 of F(x) = ½‖A x - p‖² + λ·TV(x)      λ = weight · max_j |Aᵀp|_j
//! y = x + β·(x - x before);  x ← prox(y - Aᵀ(A y - p)/L),  prox: step of λ/L·TV and x ≥ 0
//! ```
//!
//! FISTA `[BT09]` with L from a power iteration of AᵀA. Its momentum restarts when it points uphill or F has grown
//! (`[OC15]`), and a step that increases F is rejected. λ scales with the unit of density, the unit of length and the
//! number of views as the first term does, so the weight is dimensionless. From zeros, the first iterations are
//! [sweeps](sweep) over sets of views, which have no F.
//!
//! `[BT09]`: A. Beck, M. Teboulle, *Fast gradient-based algorithms for constrained total variation image denoising and
//! deblurring problems*, IEEE Trans. Image Process. 18 (2009) 2419.
//! `[OC15]`: B. O'Donoghue, E. Candès, *Adaptive restart for accelerated gradient schemes*, Found. Comput. Math. 15 (2015) 715.

mod proximal;
mod state;
mod sweep;
#[cfg(test)]
mod tests;

use super::{CHUNK, Observe, Pass, System, dot, norm, run_to_the_end};
use crate::classical::VoxelProjector;
use crate::memory::{Allocation, F32, Sizes, allocation};
use proximal::Proximal;
use std::mem::swap;
use trgs_core::error::{Error, Result};
use trgs_core::geometry::{Projections, View, Volume};
use trgs_core::numeric::{Real, real, reduce, threads};

/// Parameters of the reconstruction with total variation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TvSettings {
    /// λ as a fraction of the largest entry of Aᵀp; 0 disables the total variation.
    pub weight: f64,
    /// Largest number of iterations.
    pub iterations: usize,
    /// Ends when a step is shorter than this fraction of the volume's norm.
    pub tolerance: f64,
    /// Steps of the dual problem of the total variation per iteration.
    pub steps: usize,
}

impl Default for TvSettings {
    fn default() -> Self {
        Self { weight: 1e-3, iterations: 40, tolerance: 1e-4, steps: 10 }
    }
}

impl TvSettings {
    /// What a run asks of memory; one that `chooses` its weight holds out views.
    pub fn arrays(sizes: &Sizes, chooses: bool) -> Vec<Allocation> {
        let held_out = if chooses { sizes.pixels } else { 0 };
        let volumes = "four volumes, dual of the total variation, and as it is written";
        vec![
            allocation("projections, images of three volumes, residual", sizes.pixels, 5 * sizes.real + 1),
            allocation("views held out and the others", held_out, F32 + sizes.real),
            allocation("volume that predicts them best", if chooses { sizes.voxels } else { 0 }, sizes.real),
            allocation(volumes, sizes.voxels, 7 * sizes.real + sizes.written()),
            sizes.at_work(1),
        ]
    }
}

/// Largest number of power iterations.
const POWER: usize = 30;
/// The power iteration ends when its value grows by less than this fraction.
const POWER_TOLERANCE: f64 = 2e-3;
/// The power iteration underestimates the norm; this factor makes it an upper bound.
const SAFETY: f64 = 1.02;

/// Minimises F from zeros or from `start`, which must have the projector's shape `[BT09]`.
///
/// The volume is `[x, y, z]`, attenuation per scene unit. Rays that intersect less than half a voxel in length are
/// ignored, as in [`super::sart()`]. After the sweeps over sets of views, F never grows.
///
/// # Errors
/// Those of [`super::sart()`], and for a start of another shape.
///
/// Tests: `the_least_objective_is_found`, `sweeps_get_further_than_as_many_iterations_over_all_views`,
/// `powers_of_two_change_no_bit`, `a_solution_is_a_fixed_point`.
pub fn tv<R: Real>(
    projector: &VoxelProjector,
    projections: &Projections,
    settings: &TvSettings,
    start: Option<&Volume>,
    observe: &mut Observe<'_>,
) -> Result<Volume> {
    run_to_the_end(TvRun::<R>::new(projector, projections, settings, start)?, observe)
}

/// A reconstruction with total variation, run one iteration at a time.
pub struct TvRun<'a, R> {
    system: System<'a, R>,
    views: Vec<View>,
    /// Marks rays that intersect less than half a voxel in length.
    idle: Vec<bool>,
    settings: TvSettings,
    lambda: f64,
    /// L, the bound of `‖AᵀA‖`.
    lipschitz: f64,
    proximal: Proximal<R>,
    x: Vec<R>,
    before: Vec<R>,
    /// `A x` of both volumes; measured values for ignored rays.
    seen: Vec<R>,
    seen_before: Vec<R>,
    /// Buffers for y and the next x.
    y: Vec<R>,
    next: Vec<R>,
    /// t of the momentum, and β.
    momentum: [f64; 2],
    objective: f64,
    change: f64,
    iteration: usize,
    /// Sets of views that correct the volume one after another; 1: iterations over all views.
    sets: usize,
}

impl<'a, R: Real> TvRun<'a, R> {
    /// Begins at zeros or at `start`.
    ///
    /// # Errors
    /// When the projections or `start` do not fit the projector.
    pub fn new(
        projector: &'a VoxelProjector,
        projections: &'a Projections,
        settings: &TvSettings,
        start: Option<&Volume>,
    ) -> Result<Self> {
        let mut run = Self::prepared(projector, projections, settings)?;
        if let Some(start) = start {
            let (got, expected) = (start.values.shape(), projector.scanner().grid.shape);
            if got != expected {
                let remedy = "give a starting volume on the scan's grid";
                return Err(Error::invalid("start", format!("shape {got:?}"), format!("{expected:?}"), remedy));
            }
            run.x = start.values.iter().map(|&v| if v > 0.0 { real(f64::from(v)) } else { R::ZERO }).collect();
        }
        run.lipschitz = run.power_iteration();
        run.sets = if start.is_none() { sweep::first_sets(run.views.len()) } else { 1 };
        run.begin();
        Ok(run)
    }

    /// The state without L and the values derived from x.
    fn prepared(projector: &'a VoxelProjector, projections: &'a Projections, settings: &TvSettings) -> Result<Self> {
        let system = System::<R>::new(projector, projections)?;
        let views = projector.views(system.trajectory)?;
        let grid = &projector.scanner().grid;
        let idle = system.idle(&views);
        let (x, empty) = (system.empty(), || system.empty());
        let (before, y, next) = (empty(), empty(), empty());
        let mut run = Self {
            idle,
            settings: *settings,
            lambda: 0.0,
            lipschitz: 0.0,
            proximal: Proximal::new(grid),
            x,
            before,
            seen: Vec::new(),
            seen_before: Vec::new(),
            y,
            next,
            momentum: [1.0, 0.0],
            objective: 0.0,
            change: f64::INFINITY,
            iteration: 0,
            sets: 1,
            views,
            system,
        };
        run.set_lambda();
        Ok(run)
    }

    /// Computes λ from the weight.
    fn set_lambda(&mut self) {
        let counted = self.system.measured.iter().zip(&self.idle);
        let counted: Vec<R> = counted.map(|(&p, &idle)| if idle { R::ZERO } else { p }).collect();
        self.system.projector.adjoin(&self.views, [&counted], &mut self.next, |out, [value]| *out = value);
        let largest =
            self.next.iter().fold(R::ZERO, |largest, value| if value.abs() > largest { value.abs() } else { largest });
        self.lambda = self.settings.weight * largest.to_f64();
    }

    /// Begins again at zeros with another weight.
    pub fn restart(&mut self, weight: f64) {
        self.settings.weight = weight;
        self.set_lambda();
        self.proximal = Proximal::new(&self.system.projector.scanner().grid);
        self.x.fill(R::ZERO);
        (self.iteration, self.sets) = (0, sweep::first_sets(self.views.len()));
        self.begin();
    }

    /// Computes the values derived from x.
    fn begin(&mut self) {
        self.momentum = [1.0, 0.0];
        self.before.copy_from_slice(&self.x);
        self.seen = self.project(&self.x);
        self.seen_before = self.seen.clone();
        self.objective = self.objective_of(&self.seen, &self.x);
        self.change = f64::INFINITY;
    }

    /// Goes on with iterations over all views after sweeps.
    fn begin_whole(&mut self) {
        self.sets = 1;
        (self.seen, self.seen_before) = (self.project(&self.x), self.project(&self.before));
        self.objective = self.objective_of(&self.seen, &self.x);
    }

    /// `A x`; measured values for ignored rays.
    fn project(&self, x: &[R]) -> Vec<R> {
        let mut seen = self.system.projector.project(&self.views, x).values;
        let known = self.idle.iter().zip(&self.system.measured);
        seen.iter_mut().zip(known).filter(|(_, (idle, _))| **idle).for_each(|(seen, (_, &p))| *seen = p);
        seen
    }

    /// `‖A x - p‖²`.
    fn misfit(&self, seen: &[R]) -> f64 {
        let residual: Vec<R> = seen.iter().zip(&self.system.measured).map(|(&seen, &p)| seen - p).collect();
        dot(&residual, &residual)
    }

    fn objective_of(&self, seen: &[R], x: &[R]) -> f64 {
        0.5 * self.misfit(seen) + self.lambda * self.proximal.variation(x)
    }

    /// An upper bound of `‖AᵀA‖`.
    fn power_iteration(&mut self) -> f64 {
        let (projector, mut norm_before) = (self.system.projector, 0.0);
        let x = &mut self.next;
        x.fill(R::ONE);
        for _ in 0..POWER {
            let mut image = projector.project(&self.views, x).values;
            image.iter_mut().zip(&self.idle).filter(|(_, idle)| **idle).for_each(|(value, _)| *value = R::ZERO);
            let size = norm(x);
            projector.adjoin(&self.views, [&image], x, |out, [value]| *out = value);
            let value = norm(x) / size;
            if value == 0.0 || value - norm_before < POWER_TOLERANCE * value {
                return SAFETY * value;
            }
            norm_before = value;
            let scale: R = real(1.0 / norm(x));
            x.iter_mut().for_each(|x| *x *= scale);
        }
        SAFETY * norm_before
    }

    /// Whether the run has converged or reached its last iteration.
    pub fn is_finished(&self) -> bool {
        self.iteration >= self.settings.iterations || self.change < self.settings.tolerance
    }

    /// Lengths of a step of the gradient and of one of the total variation: 1/L and λ/L.
    fn step_lengths(&self) -> [f64; 2] {
        if self.lipschitz > 0.0 { [1.0, self.lambda].map(|length| length / self.lipschitz) } else { [0.0; 2] }
    }

    /// Runs one iteration.
    ///
    /// # Errors
    /// When values become non-finite.
    pub fn step(&mut self) -> Result<Pass> {
        self.iteration += 1;
        if self.sets > 1 {
            return self.sweep();
        }
        self.extrapolate();
        let beta: R = real(self.momentum[1]);
        let seen = self.seen.iter().zip(&self.seen_before).zip(&self.system.measured);
        let residual: Vec<R> = seen.map(|((&seen, &before), &p)| seen + beta * (seen - before) - p).collect();
        let [step, tau] = self.step_lengths();
        let step: R = real(step);
        self.system.projector.adjoin(&self.views, [&residual], &mut self.y, |y, [gradient]| *y += -(step * gradient));
        drop(residual);
        self.proximal.solve(&self.y, tau, self.settings.steps, &mut self.next);

        let seen = self.project(&self.next);
        let objective = self.objective_of(&seen, &self.next);
        let [moved, size, upwards] = self.compare(beta);
        self.change = if moved == 0.0 { 0.0 } else { (moved / size.max(f64::MIN_POSITIVE)).sqrt() };
        if !objective.is_finite() {
            return Err(Error::NonFinite {
                stage: "objective",
                value: objective,
                index: Vec::new(),
                step: self.iteration,
            });
        }
        if objective <= self.objective {
            swap(&mut self.before, &mut self.x);
            swap(&mut self.x, &mut self.next);
            self.seen_before = std::mem::replace(&mut self.seen, seen);
            self.objective = objective;
            self.momentum = if upwards > 0.0 { [1.0, 0.0] } else { next_momentum(self.momentum[0]) };
        } else {
            self.momentum = [1.0, 0.0];
        }
        Ok(Pass {
            iteration: self.iteration,
            iterations: self.settings.iterations,
            residual: self.misfit(&self.seen).sqrt(),
            objective: Some(self.objective),
            change: Some(self.change),
        })
    }

    /// `‖next - y‖²`, `‖next‖²` and `⟨y - next, next - x⟩`, where y is before the gradient step.
    fn compare(&self, beta: R) -> [f64; 3] {
        let (x, before, next) = (&self.x, &self.before, &self.next);
        let of = |i: usize| {
            let y = x[i] + beta * (x[i] - before[i]);
            let moved = (next[i] - y).to_f64();
            [moved * moved, next[i].to_f64() * next[i].to_f64(), -moved * (next[i] - x[i]).to_f64()]
        };
        let parts = threads::map(x.len().div_ceil(CHUNK), |chunk| {
            let from = chunk * CHUNK;
            [0, 1, 2].map(|k| reduce::sum_by(CHUNK.min(x.len() - from), &|i| of(from + i)[k]))
        });
        [0, 1, 2].map(|k| reduce::sum_by(parts.len(), &|i| parts[i][k]))
    }

    /// The current volume, in array order.
    pub(super) fn values(&self) -> &[R] {
        &self.x
    }

    /// F of the current volume.
    pub fn objective(&self) -> f64 {
        self.objective
    }

    /// The current volume, `[x, y, z]`.
    ///
    /// # Errors
    /// None, since the shape is the grid's.
    pub fn volume(self) -> Result<Volume> {
        self.system.volume(self.x)
    }
}

/// t and β of the next step.
fn next_momentum(t: f64) -> [f64; 2] {
    let next = 0.5 * (1.0 + (1.0 + 4.0 * t * t).sqrt());
    [next, (t - 1.0) / next]
}
