//! ASD-POCS: SART alternating with descent of the total variation.
//!
//! The descent is as long as SART's step. Not in the paper, which compares with it.

use super::sart::Sweeps;
use super::{Counter, Observe, SartSettings, System, add_scaled, dot, norm, total_variation};
use crate::classical::{Turn, VoxelProjector, Window, fdk};
use crate::error::Result;
use crate::numeric::{Real, real};
use crate::scene::{Projections, Volume};

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
    let system = System::<R>::new(projector, projections)?;
    let sweeps = Sweeps::new(&system, &settings.sart)?;
    let shape = projector.scanner().grid.shape;
    let first_guess: Vec<R> = {
        let volume = fdk(projector.scanner(), projections, Window::RamLak, Turn::Full)?;
        volume.values.iter().map(|&value| real(f64::from(value))).collect()
    };
    let enough = settings.epsilon * norm(&system.residual(&first_guess)?);
    let square = settings.unit * settings.unit;
    let mut counter = Counter::new(settings.sart.iterations, observe);
    let (mut x, mut relaxation, mut step) = (system.empty(), settings.sart.relaxation, None);
    let mut beta = 1.0;
    for iteration in 1..=settings.sart.iterations {
        let before = x.clone();
        sweeps.pass(&mut x, relaxation);
        let residual = norm(&system.residual(&x)?);
        let by_sart = difference(&x, &before);
        let sart_step = norm(&by_sart);
        let length = step.unwrap_or(settings.alpha * sart_step);

        let before = x.clone();
        for _ in 0..settings.tv_steps {
            let direction = total_variation::gradient(&x, shape, square);
            let size = norm(&direction);
            if size > 0.0 {
                add_scaled(&mut x, -length / size, &direction);
            }
        }
        let by_descent = difference(&x, &before);
        let descent = norm(&by_descent);
        let undoes = descent > settings.r_max * sart_step && residual > enough;
        step = Some(if undoes { length * settings.alpha_reduction } else { length });
        beta *= settings.sart.reduction;
        relaxation *= settings.sart.factor();
        counter.done(iteration, residual)?;
        let cosine = dot(&by_descent, &by_sart) / (descent * sart_step).max(LEAST_PRODUCT * square);
        if cosine < OPPOSITE && residual <= enough || beta < LEAST_BETA {
            break;
        }
    }
    system.volume(x)
}

fn difference<R: Real>(a: &[R], b: &[R]) -> Vec<R> {
    a.iter().zip(b).map(|(&a, &b)| a - b).collect()
}
