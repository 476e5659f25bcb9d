//! Constants of the Student's t kernel: its integral along a line and its support.

use crate::numeric::Lanes;
use crate::numeric::elementary::{exp2, log2};
use crate::numeric::exponentials::expm1;
use crate::numeric::vectors::{f64x8, splat};
use std::f64::consts::PI;

/// Series of `Γ(z)/Γ(z+½)·√w` in powers of `1/w²`, w = z-¼, as exact fractions.
///
/// The remainder at w ≥ 10 is below 1e-18.
const GAMMA_RATIO: [f64; 9] = [
    1.0,
    -1.0 / 64.0,
    21.0 / 8192.0,
    -671.0 / 524_288.0,
    180_323.0 / 134_217_728.0,
    -20_898_423.0 / 8_589_934_592.0,
    7_426_362_705.0 / 1_099_511_627_776.0,
    -1_874_409_467_055.0 / 70_368_744_177_664.0,
    5_099_063_967_524_835.0 / 36_028_797_018_963_968.0,
];

/// Series of `ln(Γ(z)/Γ(z+½)) + ½ ln w` in powers of `1/w²`, starting with the first power.
const LOG_GAMMA_RATIO: [f64; 8] = [
    -1.0 / 64.0,
    5.0 / 2048.0,
    -61.0 / 49_152.0,
    1385.0 / 1_048_576.0,
    -50_521.0 / 20_971_520.0,
    2_702_765.0 / 402_653_184.0,
    -199_360_981.0 / 7_516_192_768.0,
    19_391_512_145.0 / 137_438_953_472.0,
];

/// Smallest w for the series; smaller arguments are shifted up by the recurrence of Γ.
const SERIES_FROM: f64 = 10.0;

/// The integral of `(1+t²/ν)^(-(ν+3)/2)` over the whole line, and its derivative to ν `[Eq. 5]`.
///
/// The integral is `√(νπ)·Γ((ν+2)/2)/Γ((ν+3)/2)`, from the completed square of `[A]`. ν > 0. Relative error below 4e-16
/// (value) and 1e-13 (derivative) against 50 digits. The ratio of gamma functions is computed as one number: a
/// difference of two log-gammas loses five digits at ν = 10⁴.
pub fn line_integral(nu: f64) -> (f64, f64) {
    let (value, derivative) = line_integrals(splat(nu));
    (value.to_array()[0], derivative.to_array()[0])
}

/// [`line_integral`] of eight ν.
pub(crate) fn line_integrals(nu: f64x8) -> (f64x8, f64x8) {
    let (quarter, half, one, two, zero) = (splat(0.25), splat(0.5), splat(1.0), splat(2.0), splat(0.0));
    // Γ(z)/Γ(z+½) = Γ(z+1)/Γ(z+3/2)·(z+½)/z, applied until the series is accurate.
    let mut z = (nu + two) / two;
    let (mut shift, mut shift_log_derivative) = (one, zero);
    loop {
        let early = (z - quarter).simd_lt(splat(SERIES_FROM));
        if !early.any() {
            break;
        }
        shift *= early.select((z + half) / z, one);
        shift_log_derivative -= early.select(half / (z * (z + half)), zero);
        z += early.select(one, zero);
    }
    let w = z - quarter;
    let x = one / (w * w);
    let series = GAMMA_RATIO.iter().rev().fold(zero, |sum, &a| sum * x + splat(a));
    let value = (nu * splat(PI) / w).sqrt() * series * shift;
    let tail = LOG_GAMMA_RATIO.iter().enumerate().rev();
    let tail = tail.fold(zero, |sum, (k, b)| sum * x + splat(b * (k + 1) as f64));
    let log_derivative_z = splat(-0.5) / w - two * tail * x / w + shift_log_derivative;
    (value, value * (half / nu + half * log_derivative_z))
}

/// The Mahalanobis distance δ at which the projected kernel is 2^-`bits` `[X2]`.
///
/// It solves `(1+δ/ν)^(-(ν+2)/2) = 2^-bits`.
pub(crate) fn reach(nu: f64, bits: f64) -> f64 {
    reaches(splat(nu), bits).to_array()[0]
}

/// [`reach`] of eight ν.
pub(crate) fn reaches(nu: f64x8, bits: f64) -> f64x8 {
    nu * expm1(splat(std::f64::consts::LN_2 * bits * 2.0) / (nu + splat(2.0)))
}

/// The largest δ/ν at which kernels that represent 2^-`horizon` can represent all powers of 1+δ/ν in use.
///
/// The largest exponent is that of the voxel gradient, (ν+3)/2 + 1.
pub(crate) fn horizon(nu: f64, horizon: f64) -> f64 {
    exp2(horizon / ((nu + 5.0) / 2.0)) - 1.0
}

/// The smaller of [`reach`] and [`horizon`], both in units of ν.
///
/// The horizon is smaller only for a cutoff near what the kernels can represent.
pub(crate) fn limits(nu: f64x8, bits: f64, reaches: f64x8, horizon: f64) -> f64x8 {
    // Clearly different exponents of 2 decide without computing the powers.
    let within = splat(bits) / (nu + splat(2.0));
    let held = splat(horizon) / (nu + splat(5.0));
    if within.simd_lt(held * splat(0.999)).all() {
        return reaches;
    }
    let (nu, reaches) = (nu.to_array(), reaches.to_array());
    f64x8::from_fn(|i| reaches[i].min(self::horizon(nu[i], horizon)))
}

/// `-log2 ε` of a relative cutoff; infinite without a cutoff.
pub(crate) fn bits(epsilon: f64) -> f64 {
    if epsilon > 0.0 { -log2(epsilon) } else { f64::INFINITY }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tolerances::relative;
    use statrs::function::gamma::{digamma, ln_gamma};

    #[test]
    fn line_integral_agrees_with_statrs() {
        for nu in [0.5, 1.0, 2.0, 3.7, 10.0, 17.4, 17.6, 30.0, 100.0, 1e3, 1e4] {
            let (value, derivative) = line_integral(nu);
            let (a, b) = ((nu + 2.0) / 2.0, (nu + 3.0) / 2.0);
            let log = 0.5 * libm::log(nu * PI) + ln_gamma(a) - ln_gamma(b);
            let slope = 0.5 / nu + 0.5 * (digamma(a) - digamma(b));
            within!(relative(value, libm::exp(log)));
            // In both, the slope is a small difference of large terms, worst at large ν.
            within!("slope", (derivative - value * slope).abs());
        }
    }

    #[test]
    fn lanes_with_other_numbers_of_shifts_do_not_disturb_each_other() {
        let nus = [0.5, 1.0, 3.7, 10.0, 17.4, 17.6, 100.0, 1e12];
        let (values, derivatives) = line_integrals(f64x8::new(nus));
        let alone = nus.map(line_integral);
        assert_eq!((values.to_array(), derivatives.to_array()), (alone.map(|l| l.0), alone.map(|l| l.1)));
    }

    #[test]
    fn line_integral_has_closed_values_at_small_nu() {
        // ν = 1: ∫(1+t²)^-2 = π/2. ν = 2: ∫(1+t²/2)^(-5/2) = 4√2/3. ν → ∞: √(2π).
        within!(relative(line_integral(1.0).0, PI / 2.0));
        within!(relative(line_integral(2.0).0, 4.0 * 2.0_f64.sqrt() / 3.0));
        within!("large nu", relative(line_integral(1e12).0, (2.0 * PI).sqrt()));
    }

    #[test]
    fn reach_is_where_the_profile_meets_the_cutoff() {
        for nu in [1.0, 2.0, 10.0, 1e4] {
            let delta = reach(nu, bits(1e-3));
            within!(relative(libm::pow(1.0 + delta / nu, -(nu + 2.0) / 2.0), 1e-3));
        }
        assert_eq!(reach(3.0, bits(0.0)), f64::INFINITY);
    }
}
