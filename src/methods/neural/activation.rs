//! Functions between layers, and their slopes.

use std::f64::consts::{FRAC_1_SQRT_2, LOG2_E};
use trgs_core::numeric::{Lanes, Real};

/// Slope of the leaky rectifier for negative values.
const LEAK: f64 = 0.01;
/// Erf by Abramowitz and Stegun 7.1.26, within 1.5e-7: p and a1 to a5.
const ERF: [f64; 6] = [0.327_591_1, 0.254_829_592, -0.284_496_736, 1.421_413_741, -1.453_152_027, 1.061_405_429];

/// The larger of x and x/100.
#[inline(always)]
pub(super) fn leaky<L: Lanes>(x: L) -> L {
    x.at_least(x * L::splat_f64(LEAK))
}

/// The slope of [`leaky`] by its value, which has the sign of its argument.
#[inline(always)]
pub(super) fn leaky_slope<L: Lanes>(value: L) -> L {
    value.select_le(L::splat_f64(0.0), L::splat_f64(LEAK), L::splat_f64(1.0))
}

/// `e^x` for `x ≤ 0`; values below 2^-HORIZON are that.
#[inline(always)]
pub(super) fn exp_below<L: Lanes>(x: L) -> L {
    let least = L::splat_f64(-<L::Scalar as Real>::HORIZON);
    (x * L::splat_f64(LOG2_E)).at_least(least).exp2()
}

/// `1/(1 + e^-x)`.
#[inline(always)]
pub(super) fn sigmoid<L: Lanes>(x: L) -> L {
    let small = exp_below(-x.abs());
    let large = L::splat_f64(1.0) / (L::splat_f64(1.0) + small);
    x.select_le(L::splat_f64(0.0), small * large, large)
}

/// Value and slope of `x·Φ(x)`, Φ the cumulative normal distribution.
#[inline(always)]
pub(super) fn gelu<L: Lanes>(x: L) -> [L; 2] {
    let half = L::splat_f64(0.5);
    let falling = exp_below(-(half * x * x));
    let z = x.abs() * L::splat_f64(FRAC_1_SQRT_2);
    let upper = half + half * erf(z, falling);
    let phi = x.select_le(L::splat_f64(0.0), L::splat_f64(1.0) - upper, upper);
    // 1/√(2π).
    let density = falling * L::splat_f64(0.398_942_280_401_432_7);
    [x * phi, phi + x * density]
}

/// Erf of `z ≥ 0` with `e^(-z²)`: within 1.5e-7 in f32, by the function of libm in f64.
#[inline(always)]
fn erf<L: Lanes>(z: L, falling: L) -> L {
    if size_of::<L::Scalar>() == size_of::<f64>() {
        let mut values = [L::Scalar::ZERO; trgs_core::numeric::WIDEST];
        z.write(&mut values);
        return L::from_fn(|i| L::Scalar::from_f64(libm::erf(values[i].to_f64())));
    }
    let one = L::splat_f64(1.0);
    let t = one / L::splat_f64(ERF[0]).fma(z, one);
    let series = ERF[1..].iter().rev().fold(L::splat_f64(0.0), |sum, &a| sum.fma(t, L::splat_f64(a)));
    one - series * t * falling
}
