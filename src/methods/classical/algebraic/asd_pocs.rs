//! ASD-POCS: SART alternating with descent of the total variation.
//!
//! The descent is as long as SART's step. Not in the paper, which compares with it.

use super::sart::Sweeps;
use super::{
    Name, Observe, Pass, SartSettings, Space, System, VoxelRun, VoxelState, Whole, add_scaled, dot, norm,
    run_to_the_end, total_variation,
};
use crate::classical::{Turn, VoxelProjector, Window, fdk};
use crate::memory::{Allocation, Sizes, allocation};
use trgs_core::error::Result;
use trgs_core::geometry::{Projections, Volume};
use trgs_core::numeric::{Real, real};

/// Parameters of ASD-POCS `[SP08]`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AsdPocsSettings {
    /// Parameters of the SART step. Its iterations are those of ASD-POCS; its reduction is the factor on β.
    pub sart: SartSettings,
    /// Steps of the descent of the total variation per iteration.
    pub tv_steps: usize,
    /// α: the first step of the descent, as a fraction of SART's step.
    pub alpha: f64,
    /// Factor on α when the descent undoes too much of SART's step.
    pub alpha_reduction: f64,
    /// The fraction of SART's step from which on the descent undoes too much.
    pub r_max: f64,
    /// Sufficient residual, as a fraction of the residual of FDK.
    pub epsilon: f64,
    /// The density that counts as 1 in the two constants that prevent division by 0.
    ///
    /// If projections and unit are scaled by one factor, so is the volume.
    pub unit: f64,
}

impl Default for AsdPocsSettings {
    fn default() -> Self {
        let sart = SartSettings { iterations: 10, reduction: 0.9999, ..SartSettings::default() };
        Self { sart, tv_steps: 20, alpha: 0.002, alpha_reduction: 0.95, r_max: 0.94, epsilon: 0.15, unit: 1.0 }
    }
}

impl AsdPocsSettings {
    /// What a run asks of memory.
    pub fn arrays(&self, sizes: &Sizes) -> Vec<Allocation> {
        let mut arrays = self.sart.arrays(sizes);
        arrays.extend([
            allocation("first guess, steps and direction", sizes.voxels, 5 * sizes.real),
            allocation("residual", sizes.pixels, sizes.real),
        ]);
        arrays
    }
}

/// The reconstruction ends when β has fallen below this.
const LEAST_BETA: f64 = 0.005;
/// Cosine between SART's step and the descent below which nothing will change any more.
const OPPOSITE: f64 = -0.99;
/// Smallest product of two step lengths for which a cosine is computed, in squared units of density.
const LEAST_PRODUCT: f64 = 1e-6;

/// Reconstructs from zeros `[SP08]`; the volume is `[x, y, z]`, attenuation per scene unit.
///
/// It ends early when the residual is sufficient and the SART step and the descent are opposite. β is multiplied by
/// SART's reduction in every iteration, and so is the relaxation unless it is constant.
///
/// # Errors
/// Those of [`super::sart()`].
///
/// Tests: `total_variation_falls_and_noise_with_it`, `the_number_of_threads_changes_no_bit`; units of density in `tests/cli/units.rs`.
pub fn asd_pocs<R: Real>(
    projector: &VoxelProjector,
    projections: &Projections,
    settings: &AsdPocsSettings,
    observe: &mut Observe<'_>,
) -> Result<Volume> {
    run_to_the_end(AsdPocsRun::<R>::new(projector, projections, settings, None)?, observe)
}

/// ASD-POCS, run one iteration at a time.
pub struct AsdPocsRun<'a, R> {
    system: System<'a, R>,
    sweeps: Sweeps<R>,
    settings: AsdPocsSettings,
    /// The residual that suffices.
    enough: f64,
    space: Whole<'a, R>,
    relaxation: f64,
    beta: f64,
    /// Length of the first step of the next descent; NaN before the first iteration.
    length: f64,
    /// Whether nothing will change any more.
    is_settled: bool,
    iteration: usize,
}

impl<'a, R: Real> AsdPocsRun<'a, R> {
    /// Begins at zeros, or continues from a state with the bits of an uninterrupted run.
    ///
    /// # Errors
    /// When the projections or the state do not fit the projector.
    pub fn new(
        projector: &'a VoxelProjector,
        projections: &'a Projections,
        settings: &AsdPocsSettings,
        state: Option<&VoxelState>,
    ) -> Result<Self> {
        let system = System::<R>::new(projector, projections)?;
        let mut space = Whole::new(projector, projector.views(system.trajectory)?, false);
        let sweeps = Sweeps::new(&system, &settings.sart, &mut space)?;
        let first_guess: Vec<R> = {
            let volume = fdk(projector.scanner(), projections, Window::RamLak, Turn::Full)?;
            volume.values.iter().map(|&value| real(f64::from(value))).collect()
        };
        let enough = settings.epsilon * norm(&system.residual(&first_guess)?);
        let relaxation = settings.sart.relaxation;
        let mut run = Self {
            system,
            sweeps,
            settings: *settings,
            enough,
            space,
            relaxation,
            beta: 1.0,
            length: f64::NAN,
            is_settled: false,
            iteration: 0,
        };
        if let Some(state) = state {
            let settled;
            let arrays;
            ([run.relaxation, run.beta, run.length, settled], arrays) =
                state.get([projector.scanner().grid.voxels()])?;
            run.space.resume(arrays.into())?;
            (run.is_settled, run.iteration) = (settled != 0.0, state.iteration);
        }
        Ok(run)
    }
}

impl<R: Real> VoxelRun for AsdPocsRun<'_, R> {
    fn is_finished(&self) -> bool {
        self.iteration >= self.settings.sart.iterations || self.is_settled
    }

    fn step(&mut self) -> Result<Option<Pass>> {
        let Self { system, settings, space, .. } = self;
        let (shape, square) = (system.projector.scanner().grid.shape, settings.unit * settings.unit);
        let before = space.get(Name::Volume).to_vec();
        self.sweeps.pass(system, space, self.relaxation)?;
        let x = space.get_mut(Name::Volume);
        let residual = norm(&system.residual(x)?);
        let by_sart = difference(x, &before);
        let sart_step = norm(&by_sart);
        let length = if self.length.is_nan() { settings.alpha * sart_step } else { self.length };

        let before = x.clone();
        for _ in 0..settings.tv_steps {
            let direction = total_variation::gradient(x, shape, square);
            let size = norm(&direction);
            if size > 0.0 {
                add_scaled(x, -length / size, &direction);
            }
        }
        let by_descent = difference(x, &before);
        let descent = norm(&by_descent);
        let undoes = descent > settings.r_max * sart_step && residual > self.enough;
        self.length = if undoes { length * settings.alpha_reduction } else { length };
        self.beta *= settings.sart.reduction;
        self.relaxation *= settings.sart.factor();
        self.iteration += 1;
        let pass = Pass::new(self.iteration, settings.sart.iterations, residual)?;
        let cosine = dot(&by_descent, &by_sart) / (descent * sart_step).max(LEAST_PRODUCT * square);
        self.is_settled = cosine < OPPOSITE && residual <= self.enough || self.beta < LEAST_BETA;
        Ok(Some(pass))
    }

    fn state(&self) -> VoxelState<'_> {
        let scalars = vec![self.relaxation, self.beta, self.length, f64::from(u8::from(self.is_settled))];
        VoxelState::of(self.iteration, scalars, self.space.arrays())
    }

    fn into_volume(mut self: Box<Self>) -> Result<Volume> {
        self.system.volume(self.space.volume()?)
    }
}

fn difference<R: Real>(a: &[R], b: &[R]) -> Vec<R> {
    a.iter().zip(b).map(|(&a, &b)| a - b).collect()
}
