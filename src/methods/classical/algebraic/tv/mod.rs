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

mod state;
mod sweep;
#[cfg(test)]
mod tests;

use super::space::total;
use super::{Change, Division, Measure, Name, Observe, Pass, Space, System, dot, run_to_the_end};
use crate::classical::VoxelProjector;
use crate::memory::{Allocation, F32, Sizes, allocation};
use trgs_core::error::{Error, Result};
use trgs_core::geometry::{Projections, Volume};
use trgs_core::numeric::{Real, real};

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
    pub fn arrays(&self, sizes: &Sizes, chooses: bool) -> Vec<Allocation> {
        let held_out = if chooses { sizes.pixels } else { 0 };
        let mut arrays = vec![
            allocation("projections, images of three volumes, residual", sizes.pixels, 5 * sizes.real + 1),
            allocation("views held out and the others", held_out, F32 + sizes.real),
            sizes.at_work(1),
        ];
        if sizes.slabs == 1 {
            let volumes = "three volumes, dual of the total variation, and as it is written";
            arrays.push(allocation(
                "volume that predicts them best",
                if chooses { sizes.voxels } else { 0 },
                sizes.real,
            ));
            arrays.push(allocation(volumes, sizes.voxels, 6 * sizes.real + sizes.written()));
        } else {
            let slabs = "slabs of a volume and of the dual of the total variation, with those beside them";
            arrays.push(allocation(slabs, sizes.slab(2 * (self.steps + 1)), 4 * sizes.real));
            arrays.push(allocation("volume, and as it is written", sizes.voxels, sizes.real + sizes.written()));
        }
        arrays
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
    run_to_the_end(TvRun::<R>::new(projector, projections, settings, start, &Division::whole())?, observe)
}

/// A reconstruction with total variation, run one iteration at a time.
pub struct TvRun<'a, R> {
    system: System<'a, R>,
    /// The numbers of all views.
    views: Vec<usize>,
    /// Marks rays that intersect less than half a voxel in length.
    idle: Vec<bool>,
    settings: TvSettings,
    lambda: f64,
    /// L, the bound of `‖AᵀA‖`.
    lipschitz: f64,
    space: Box<dyn Space<R> + 'a>,
    /// `A x` of the volume and of the one before; measured values for ignored rays.
    seen: Vec<R>,
    seen_before: Vec<R>,
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
    /// When the projections or `start` do not fit the projector; when files of slabs cannot be made.
    pub fn new(
        projector: &'a VoxelProjector,
        projections: &'a Projections,
        settings: &TvSettings,
        start: Option<&Volume>,
        division: &Division,
    ) -> Result<Self> {
        let space = division.space(projector, projector.views(projections.trajectory())?)?;
        Self::in_space(projector, projections, settings, start, space)
    }

    /// Begins at the zeros of a space, whose first views are those of the projections, or at `start`.
    ///
    /// # Errors
    /// As [`Self::new`], and those of the space.
    pub fn in_space(
        projector: &'a VoxelProjector,
        projections: &'a Projections,
        settings: &TvSettings,
        start: Option<&Volume>,
        space: Box<dyn Space<R> + 'a>,
    ) -> Result<Self> {
        let mut run = Self::prepared(projector, projections, settings, space)?;
        run.lipschitz = run.power_iteration()?;
        run.sets = if start.is_none() { sweep::first_sets(run.views.len()) } else { 1 };
        if let Some(start) = start {
            let (got, expected) = (start.values.shape(), projector.scanner().grid.shape);
            if got != expected {
                let remedy = "give a starting volume on the scan's grid";
                return Err(Error::invalid("start", format!("shape {got:?}"), format!("{expected:?}"), remedy));
            }
            let values = start.values.as_standard_layout();
            run.space.start(values.as_slice().expect("standard layout"))?;
        }
        run.begin()?;
        Ok(run)
    }

    /// Begins again at zeros with another weight.
    ///
    /// # Errors
    /// When slabs cannot be read or written.
    pub fn restart(&mut self, weight: f64) -> Result<()> {
        self.settings.weight = weight;
        self.set_lambda()?;
        self.space.change(Change::Forget)?;
        self.space.change(Change::Fill(Name::Volume, R::ZERO))?;
        (self.iteration, self.sets) = (0, sweep::first_sets(self.views.len()));
        self.begin()
    }

    /// The line integrals of the current volume in the views of the space that are not those of the run.
    ///
    /// # Errors
    /// When slabs cannot be read.
    pub(super) fn see_others(&mut self) -> Result<Vec<R>> {
        let others: Vec<usize> = (self.views.len()..self.space.views()).collect();
        self.space.project(&others, Some(Name::Volume))
    }

    /// The state without L and the values derived from x.
    fn prepared(
        projector: &'a VoxelProjector,
        projections: &'a Projections,
        settings: &TvSettings,
        mut space: Box<dyn Space<R> + 'a>,
    ) -> Result<Self> {
        let system = System::<R>::new(projector, projections)?;
        let views: Vec<usize> = (0..projections.len()).collect();
        let least = real(0.5 * projector.scanner().grid.spacing.min_element());
        let idle = space.project(&views, None)?.into_iter().map(|length| length <= least).collect();
        let mut run = Self {
            idle,
            settings: *settings,
            lambda: 0.0,
            lipschitz: 0.0,
            space,
            seen: Vec::new(),
            seen_before: Vec::new(),
            momentum: [1.0, 0.0],
            objective: 0.0,
            change: f64::INFINITY,
            iteration: 0,
            sets: 1,
            views,
            system,
        };
        run.set_lambda()?;
        Ok(run)
    }

    /// Computes λ from the weight.
    fn set_lambda(&mut self) -> Result<()> {
        let counted = self.system.measured.iter().zip(&self.idle);
        let counted: Vec<R> = counted.map(|(&p, &idle)| if idle { R::ZERO } else { p }).collect();
        self.space.adjoin(&self.views, &counted, Name::Next, None)?;
        self.lambda = self.settings.weight * total(&mut *self.space, Measure::Largest(Name::Next))?[0];
        Ok(())
    }

    /// Computes the values derived from x.
    fn begin(&mut self) -> Result<()> {
        self.momentum = [1.0, 0.0];
        self.space.change(Change::Keep)?;
        let seen = self.project(Name::Volume)?;
        self.objective = self.objective_of(&seen, Name::Volume)?;
        (self.seen_before, self.seen) = (seen.clone(), seen);
        self.change = f64::INFINITY;
        Ok(())
    }

    /// Goes on with iterations over all views after sweeps.
    fn begin_whole(&mut self) -> Result<()> {
        self.sets = 1;
        let seen = self.project(Name::Volume)?;
        self.objective = self.objective_of(&seen, Name::Volume)?;
        (self.seen, self.seen_before) = (seen, self.project(Name::Before)?);
        Ok(())
    }

    /// `A x`; measured values for ignored rays.
    fn project(&mut self, name: Name) -> Result<Vec<R>> {
        let mut seen = self.space.project(&self.views, Some(name))?;
        let known = self.idle.iter().zip(&self.system.measured);
        seen.iter_mut().zip(known).filter(|(_, (idle, _))| **idle).for_each(|(seen, (_, &p))| *seen = p);
        Ok(seen)
    }

    /// `‖A x - p‖²`.
    fn misfit(&self, seen: &[R]) -> f64 {
        let residual: Vec<R> = seen.iter().zip(&self.system.measured).map(|(&seen, &p)| seen - p).collect();
        dot(&residual, &residual)
    }

    fn objective_of(&mut self, seen: &[R], name: Name) -> Result<f64> {
        Ok(0.5 * self.misfit(seen) + self.lambda * total(&mut *self.space, Measure::Variation(name))?[0])
    }

    /// An upper bound of `‖AᵀA‖`.
    fn power_iteration(&mut self) -> Result<f64> {
        let Self { space, views, idle, .. } = self;
        let norm = |space: &mut Box<dyn Space<R> + 'a>| {
            Ok::<_, Error>(total(&mut **space, Measure::Squares(Name::Next))?[0].sqrt())
        };
        let mut norm_before = 0.0;
        space.change(Change::Fill(Name::Next, R::ONE))?;
        for _ in 0..POWER {
            let mut image = space.project(views, Some(Name::Next))?;
            image.iter_mut().zip(&*idle).filter(|(_, idle)| **idle).for_each(|(value, _)| *value = R::ZERO);
            let size = norm(space)?;
            space.adjoin(views, &image, Name::Next, None)?;
            let length = norm(space)?;
            let value = length / size;
            if value == 0.0 || value - norm_before < POWER_TOLERANCE * value {
                return Ok(SAFETY * value);
            }
            norm_before = value;
            space.change(Change::Scale(Name::Next, real(1.0 / length)))?;
        }
        Ok(SAFETY * norm_before)
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
        let beta: R = real(self.momentum[1]);
        self.space.change(Change::Extrapolate(beta))?;
        let seen = self.seen.iter().zip(&self.seen_before).zip(&self.system.measured);
        let residual: Vec<R> = seen.map(|((&seen, &before), &p)| seen + beta * (seen - before) - p).collect();
        let [step, tau] = self.step_lengths();
        self.space.adjoin(&self.views, &residual, Name::Next, Some(real(step)))?;
        drop(residual);
        self.space.solve(tau, self.settings.steps)?;

        let seen = self.project(Name::Next)?;
        let objective = self.objective_of(&seen, Name::Next)?;
        let [moved, size, upwards] = total(&mut *self.space, Measure::Step(beta))?;
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
            self.advance();
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

    /// The next volume becomes the present one, and that the one before.
    fn advance(&mut self) {
        self.space.swap(Name::Before, Name::Volume);
        self.space.swap(Name::Volume, Name::Next);
    }

    /// F of the current volume.
    pub fn objective(&self) -> f64 {
        self.objective
    }

    /// The current volume, `[x, y, z]`.
    ///
    /// # Errors
    /// When slabs cannot be read.
    pub fn volume(mut self) -> Result<Volume> {
        self.system.volume(self.space.volume()?)
    }
}

/// t and β of the next step.
fn next_momentum(t: f64) -> [f64; 2] {
    let next = 0.5 * (1.0 + (1.0 + 4.0 * t * t).sqrt());
    [next, (t - 1.0) / next]
}
