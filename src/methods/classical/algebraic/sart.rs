//! SART and OS-SART. Not in the paper, which compares with it.

use super::{CHUNK, Name, Observe, Order, Pass, Space, System, VoxelRun, VoxelState, Whole, run_to_the_end};
use crate::classical::VoxelProjector;
use crate::memory::{Allocation, Sizes, allocation};
use trgs_core::error::Result;
use trgs_core::geometry::{Projections, Volume};
use trgs_core::numeric::{Real, real, reduce, threads};

/// Parameters of SART and OS-SART.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SartSettings {
    /// Number of passes over all views.
    pub iterations: usize,
    /// λ of the first pass, the relaxation.
    pub relaxation: f64,
    /// Factor on λ after every pass.
    pub reduction: f64,
    /// Keeps λ constant, as TIGRE does, which accepts a reduction but ignores it.
    pub constant_relaxation: bool,
    /// Number of views per correction: 1 is SART, more are OS-SART.
    pub subset: usize,
    /// Order of the views; consecutive views form the subsets.
    pub order: Order,
    /// Sets negative values to 0 after every correction.
    pub non_negative: bool,
    /// Ends when a pass lowers the residual by less than this fraction; 0 runs all passes.
    pub tolerance: f64,
    /// Seed of all random choices.
    pub seed: u64,
}

impl Default for SartSettings {
    fn default() -> Self {
        Self {
            iterations: 20,
            relaxation: 1.0,
            reduction: 0.999,
            constant_relaxation: false,
            subset: 1,
            order: Order::Input,
            non_negative: true,
            tolerance: 0.0,
            seed: 0,
        }
    }
}

impl SartSettings {
    /// The factor on λ after a pass.
    pub(super) fn factor(&self) -> f64 {
        if self.constant_relaxation { 1.0 } else { self.reduction }
    }

    /// What a run asks of memory.
    pub fn arrays(&self, sizes: &Sizes) -> Vec<Allocation> {
        let subset = self.subset.saturating_mul(sizes.detector).min(sizes.pixels);
        vec![
            allocation("projections and lengths of rays", sizes.pixels, 2 * sizes.real),
            allocation("corrections of a set of views, and as the projector orders them", subset, 5 * sizes.real),
            allocation("volume, and as it is written", sizes.voxels, sizes.real + sizes.written()),
            sizes.at_work(2),
        ]
    }
}

/// Reconstructs from zeros by passes of `x ← x + λ·Aᵀ[(p - A x)/A1]/Aᵀ1` over view subsets `[SART84]`.
///
/// The volume is `[x, y, z]`, attenuation per scene unit. Rays that intersect less than half a voxel in length are
/// ignored, because their correction would be a division by nearly 0.
///
/// # Errors
/// When the projections do not fit the scanner, values become non-finite, or `observe` breaks.
///
/// Tests: `consistent_data_are_solved`, `a_subset_of_all_views_is_the_formula`, `the_number_of_threads_changes_no_bit`.
pub fn sart<R: Real>(
    projector: &VoxelProjector,
    projections: &Projections,
    settings: &SartSettings,
    observe: &mut Observe<'_>,
) -> Result<Volume> {
    run_to_the_end(SartRun::<R>::new(projector, projections, settings, None)?, observe)
}

/// SART or OS-SART, run one pass at a time.
pub struct SartRun<'a, R> {
    system: System<'a, R>,
    sweeps: Sweeps<R>,
    settings: SartSettings,
    space: Box<dyn Space<R> + 'a>,
    /// λ of the next pass.
    relaxation: f64,
    /// Residuals of the last pass but one and of the last pass.
    residuals: [f64; 2],
    iteration: usize,
}

impl<'a, R: Real> SartRun<'a, R> {
    /// Begins at zeros, or continues from a state with the bits of an uninterrupted run.
    ///
    /// # Errors
    /// When the projections or the state do not fit the projector.
    pub fn new(
        projector: &'a VoxelProjector,
        projections: &'a Projections,
        settings: &SartSettings,
        state: Option<&VoxelState>,
    ) -> Result<Self> {
        let space = Whole::new(projector, projector.views(projections.trajectory())?, false);
        let mut run = Self::in_space(projector, projections, settings, Box::new(space))?;
        if let Some(state) = state {
            let ([relaxation, before, last], arrays) = state.get([projector.scanner().grid.voxels()])?;
            run.space.resume(arrays.into())?;
            (run.relaxation, run.residuals, run.iteration) = (relaxation, [before, last], state.iteration);
        }
        Ok(run)
    }

    /// Begins at the zeros of a space.
    ///
    /// # Errors
    /// As [`Self::new`].
    pub fn in_space(
        projector: &'a VoxelProjector,
        projections: &'a Projections,
        settings: &SartSettings,
        mut space: Box<dyn Space<R> + 'a>,
    ) -> Result<Self> {
        let system = System::<R>::new(projector, projections)?;
        let sweeps = Sweeps::new(&system, settings, &mut *space)?;
        let (relaxation, residuals) = (settings.relaxation, [f64::INFINITY; 2]);
        Ok(Self { system, sweeps, settings: *settings, space, relaxation, residuals, iteration: 0 })
    }

    /// The line integrals of the current volume in some views of the space.
    ///
    /// # Errors
    /// When slabs cannot be read.
    pub(super) fn see(&mut self, views: &[usize]) -> Result<Vec<R>> {
        self.space.project(views, Some(Name::Volume))
    }

    /// Runs one pass; returns its residual.
    fn pass(&mut self) -> Result<f64> {
        let residual = self.sweeps.pass(&self.system, &mut *self.space, self.relaxation)?;
        self.iteration += 1;
        self.residuals = [self.residuals[1], residual];
        self.relaxation *= self.settings.factor();
        Ok(residual)
    }
}

impl<R: Real> VoxelRun for SartRun<'_, R> {
    fn is_finished(&self) -> bool {
        let [before, last] = self.residuals;
        let slow = before - last < self.settings.tolerance * before && before.is_finite();
        self.iteration >= self.settings.iterations || slow
    }

    fn step(&mut self) -> Result<Option<Pass>> {
        let residual = self.pass()?;
        Pass::new(self.iteration, self.settings.iterations, residual).map(Some)
    }

    fn state(&self) -> VoxelState<'_> {
        let [before, last] = self.residuals;
        let scalars = vec![self.relaxation, before, last];
        VoxelState::of(self.iteration, scalars, self.space.arrays())
    }

    fn into_volume(mut self: Box<Self>) -> Result<Volume> {
        self.system.volume(self.space.volume()?)
    }
}

/// Passes over all views, one subset after another.
pub(super) struct Sweeps<R> {
    subsets: Vec<Vec<usize>>,
    /// 1/A1 of every ray, 0 for ignored rays.
    per_length: Vec<R>,
    non_negative: bool,
}

impl<R: Real> Sweeps<R> {
    pub(super) fn new(
        system: &System<'_, R>,
        settings: &SartSettings,
        space: &mut (impl Space<R> + ?Sized),
    ) -> Result<Self> {
        let all: Vec<usize> = (0..system.trajectory.len()).collect();
        let least = real(0.5 * system.projector.scanner().grid.spacing.min_element());
        let per_length = space.project(&all, None)?.into_iter();
        let per_length = per_length.map(|l| if l > least { R::ONE / l } else { R::ZERO }).collect();
        let order = settings.order.of(system.trajectory.angles, settings.seed);
        let subsets = order.chunks(settings.subset).map(<[usize]>::to_vec).collect();
        Ok(Self { subsets, per_length, non_negative: settings.non_negative })
    }

    /// Runs one pass; returns the residual, in which each view counts before its own correction.
    pub(super) fn pass(
        &self,
        system: &System<'_, R>,
        space: &mut (impl Space<R> + ?Sized),
        relaxation: f64,
    ) -> Result<f64> {
        let relaxation: R = real(relaxation);
        let correct = |subset: &Vec<usize>| self.correct(system, space, relaxation, subset);
        let squares: Vec<f64> = self.subsets.iter().map(correct).collect::<Result<_>>()?;
        Ok(reduce::sum(&squares).sqrt())
    }

    /// Corrects x by a subset of the views; returns the sum of its squared residuals before the correction.
    fn correct(
        &self,
        system: &System<'_, R>,
        space: &mut (impl Space<R> + ?Sized),
        relaxation: R,
        subset: &[usize],
    ) -> Result<f64> {
        let pixels = system.pixels;
        let seen = space.project(subset, Some(Name::Volume))?;
        let mut corrections = vec![R::ZERO; seen.len()];
        threads::for_each_chunk(&mut corrections, pixels, |slot, corrections| {
            let view = subset[slot] * pixels;
            let (measured, per_length) = (&system.measured[view..], &self.per_length[view..]);
            for (i, (correction, &seen)) in corrections.iter_mut().zip(&seen[slot * pixels..]).enumerate() {
                *correction = (measured[i] - seen) * per_length[i];
            }
        });
        let weights = subset.iter().flat_map(|&view| &self.per_length[view * pixels..][..pixels]);
        let counts: Vec<R> = weights.map(|&weight| if weight > R::ZERO { R::ONE } else { R::ZERO }).collect();
        let residual = |i: usize| (system.measured[subset[i / pixels] * pixels + i % pixels] - seen[i]).to_f64();
        let squares = threads::map(seen.len().div_ceil(CHUNK), |chunk| {
            let from = chunk * CHUNK;
            reduce::sum_by(CHUNK.min(seen.len() - from), &|i| residual(from + i) * residual(from + i))
        });
        space.correct(subset, [&corrections, &counts], relaxation, self.non_negative)?;
        Ok(reduce::sum(&squares))
    }
}
