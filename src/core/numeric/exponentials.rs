//! [`elementary`] functions of eight numbers at a time, bit-identical to the scalar functions.
//!
//! The steps are those of the `libm` crate (FreeBSD's), with selects instead of branches. They serve work that is done for
//! every primitive in every iteration.

use super::vectors::{f64x8, splat};
use super::{Lanes, elementary};
use wide::u64x8;

/// ln 2 in two parts: products of the first with integer exponents are exact.
const LN_2: [f64; 2] = [6.931_471_803_691_238e-1, 1.908_214_929_270_587_7e-10];
/// Threshold of the reduction by ln 2: the next number after ½ ln 2 in the upper half of the bits.
const REDUCED: f64 = f64::from_bits(0x3fd6_2e43 << 32);
/// `r·(e^r+1)/(e^r-1) = 2 + z·P(z)`, z = r².
const EXP: [f64; 5] = [
    1.666_666_666_666_660_2e-1,
    -2.777_777_777_701_559_3e-3,
    6.613_756_321_437_934e-5,
    -1.653_390_220_546_525_2e-6,
    4.138_136_797_057_238_5e-8,
];
/// `6/r·((e^r+1)/(e^r-1) - 2/r) = 1 + z·P(z)`, z = r²/2.
const EXPM1: [f64; 5] = [
    -3.333_333_333_333_313e-2,
    1.587_301_587_254_814_6e-3,
    -7.936_507_578_674_88e-5,
    4.008_217_827_329_362e-6,
    -2.010_992_181_836_243_7e-7,
];
/// `ln((1+s)/(1-s)) = 2s + s·z·P(z)`, z = s².
const LOG: [f64; 7] = [
    6.666_666_666_666_735e-1,
    3.999_999_999_940_942e-1,
    2.857_142_874_366_239e-1,
    2.222_219_843_214_978_4e-1,
    1.818_357_216_161_805e-1,
    1.531_383_769_920_937_3e-1,
    1.479_819_860_511_658_6e-1,
];
/// The bits of √½ and of 1, upper halves only.
const ROOT_HALF: u64 = 0x3fe6_a09e << 32;
const ONE: u64 = 0x3ff0_0000 << 32;
/// Adding an integer to this number puts the integer into its low bits.
const INTEGER: f64 = (1_u64 << 52) as f64;

/// `c[0] + x·(c[1] + x·(…))`.
#[inline(always)]
fn polynomial(x: f64x8, coefficients: &[f64]) -> f64x8 {
    let [rest @ .., last] = coefficients else { unreachable!("a polynomial has terms") };
    rest.iter().rev().fold(splat(*last), |sum, &next| splat(next) + x * sum)
}

/// 2^k for integers k in the exponent range of normal numbers.
#[inline(always)]
fn power_of_two(k: f64x8) -> f64x8 {
    let bits: u64x8 = bytemuck::cast(k + splat(INTEGER + 1023.0));
    bytemuck::cast(bits.unbounded_shl_scalar(52))
}

/// The integer k and the remainder `x - k·ln 2` in two parts.
#[inline(always)]
fn reduced(x: f64x8) -> [f64x8; 3] {
    let (size, zero) = (x.abs(), splat(0.0));
    let whole = (splat(std::f64::consts::LOG2_E) * size + splat(0.5)).floor();
    let whole = size.simd_lt(splat(REDUCED)).select(zero, whole);
    let k = x.simd_lt(zero).select(-whole, whole);
    [k, x - k * splat(LN_2[0]), k * splat(LN_2[1])]
}

/// `e^x`: [`elementary::exp`].
#[inline(always)]
pub fn exp(x: f64x8) -> f64x8 {
    // Lanes that are infinite, underflow or NaN are computed one by one.
    if !x.abs().simd_lt(splat(708.0)).all() {
        let x = x.to_array();
        return f64x8::from_fn(|i| elementary::exp(x[i]));
    }
    let [k, high, low] = reduced(x);
    let r = high - low;
    let z = r * r;
    let c = r - z * polynomial(z, &EXP);
    let mantissa = splat(1.0) + (r * c / (splat(2.0) - c) - low + high);
    // Below about 2^-28 the polynomial would only change the rounding.
    let tiny = splat(f64::from_bits(0x3e30_0001 << 32));
    x.abs().simd_lt(tiny).select(splat(1.0) + x, mantissa * power_of_two(k))
}

/// `e^x - 1`, accurate also near 0: [`elementary::expm1`].
#[inline(always)]
pub fn expm1(x: f64x8) -> f64x8 {
    // For larger arguments libm adds 1 in a different order.
    if !x.abs().simd_lt(splat(13.0)).all() {
        let x = x.to_array();
        return f64x8::from_fn(|i| elementary::expm1(x[i]));
    }
    let (half, one) = (splat(0.5), splat(1.0));
    let [k, high, low] = reduced(x);
    let r = high - low;
    let lost = (high - r) - low;
    let half_r = half * r;
    let z = r * half_r;
    let series = one + z * polynomial(z, &EXPM1);
    let t = splat(3.0) - series * half_r;
    let e = z * ((series - t) / (splat(6.0) - r * t));
    let here = r - (r * e - z);
    let e = (r * (e - lost) - lost) - z;
    let power = power_of_two(k);
    let anywhere = (r - e + (one - power_of_two(-k))) * power;
    let doubled = r.simd_lt(splat(-0.25)).select(splat(-2.0) * (e - (r + half)), one + splat(2.0) * (r - e));
    let halved = half * (r - e) - half;
    // Below k = -1 the 1 is subtracted after the scaling.
    let far_below = (r - e + one) * power - one;
    let is = |whole: f64| k.simd_eq(splat(whole));
    let value = k.simd_lt(splat(0.0)).select(far_below, anywhere);
    let value = is(-1.0).select(halved, is(0.0).select(here, is(1.0).select(doubled, value)));
    // Below 2^-54 it is x itself, and -0 stays.
    x.abs().simd_lt(splat(f64::from_bits(0x3c90_0000 << 32))).select(x, value)
}

/// `ln(2^k·(1+f))` for 1+f from √½ to √2. `add` adds the lower part of k·ln 2, and other small terms, to the series.
#[inline(always)]
fn log_of(k: f64x8, f: f64x8, add: impl Fn(f64x8, f64x8) -> f64x8) -> f64x8 {
    let half_square = splat(0.5) * f * f;
    let s = f / (splat(2.0) + f);
    let z = s * s;
    let w = z * z;
    let even = w * (splat(LOG[1]) + w * (splat(LOG[3]) + w * splat(LOG[5])));
    let odd = z * (splat(LOG[0]) + w * (splat(LOG[2]) + w * (splat(LOG[4]) + w * splat(LOG[6]))));
    add(s * (half_square + (odd + even)), k * splat(LN_2[1])) - half_square + f + k * splat(LN_2[0])
}

/// The natural logarithm: [`elementary::log`].
#[inline(always)]
pub fn log(x: f64x8) -> f64x8 {
    if !(x.simd_ge(splat(f64::MIN_POSITIVE)) & x.simd_le(splat(f64::MAX))).all() {
        let x = x.to_array();
        return f64x8::from_fn(|i| elementary::log(x[i]));
    }
    let bits: u64x8 = bytemuck::cast(x);
    let bits = bits + u64x8::splat(ONE - ROOT_HALF);
    let k: f64x8 = bytemuck::cast(bits.unbounded_shr_scalar(52) | u64x8::splat(INTEGER.to_bits()));
    let f: f64x8 = bytemuck::cast((bits & u64x8::splat(u64::MAX >> 12)) + u64x8::splat(ROOT_HALF));
    log_of(k - splat(INTEGER + 1023.0), f - splat(1.0), |sum, low| sum + low)
}

/// `ln(1+x)` for x from 0 to 1, accurate also near 0: [`elementary::log1p`].
#[inline(always)]
fn log1p_of_fraction(x: f64x8) -> f64x8 {
    let (one, zero) = (splat(1.0), splat(0.0));
    // Below √2 - 1, compared by the upper half of the bits, 1+x needs no scaling.
    let small = x.simd_lt(splat(f64::from_bits(0x3fda_827a << 32)));
    let u = one + x;
    let lost = small.select(zero, (x - (u - one)) / u);
    log_of(small.select(zero, one), small.select(x, u * splat(0.5) - one), |sum, low| sum + (low + lost))
}

/// Logistic function `1/(1+e^-x)`: [`elementary::sigmoid`].
#[inline(always)]
pub fn sigmoid(x: f64x8) -> f64x8 {
    let e = exp(-x.abs());
    x.simd_ge(splat(0.0)).select(splat(1.0), e) / (splat(1.0) + e)
}

/// `ln(1+e^x)`: [`elementary::softplus`].
#[inline(always)]
pub fn softplus(x: f64x8) -> f64x8 {
    let log = log1p_of_fraction(exp(-x.abs()));
    x.simd_gt(splat(0.0)).select(x + log, log)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::numeric::rng::{Purpose, stream};
    use rand::RngExt;

    /// Numbers of all sizes and both signs, the borders between the branches of libm with their neighbours, and special ones.
    fn arguments() -> Vec<f64> {
        let mut random = stream(7, Purpose::Phantom, 0, 0);
        let mut draw = |low: f64, high: f64| low + (high - low) * random.random::<f64>();
        let mut some: Vec<f64> = (0..40_000).map(|_| draw(-3.0, 3.0)).collect();
        some.extend((0..20_000).map(|_| draw(-750.0, 750.0)));
        some.extend(
            (0..20_000).map(|_| libm::pow(10.0, draw(-320.0, 308.0)) * if draw(-1.0, 1.0) < 0.0 { -1.0 } else { 1.0 }),
        );
        some.extend(
            (0..20_000).map(|_| libm::pow(10.0, draw(-18.0, 1.0)) * if draw(-1.0, 1.0) < 0.0 { -1.0 } else { 1.0 }),
        );
        let words = [
            0x3fd6_2e42,
            0x3fd6_2e43,
            0x3ff0_a2b2,
            0x3e30_0000,
            0x3e30_0001,
            0x3c90_0000,
            0x3ca0_0000,
            0x3fda_827a,
            0x3fe6_a09e,
            0x3ff6_a09e,
        ];
        let exact = (-40..=40).flat_map(|n| [0.5, 1.0].map(|half| (f64::from(n) + half) * std::f64::consts::LN_2));
        let borders = words.map(|word: u64| f64::from_bits(word << 32)).into_iter().chain(exact);
        for border in borders.chain([0.0, 0.25, 1.0, 13.0, 708.0, f64::MIN_POSITIVE]) {
            for step in -3_i64..=3 {
                let near = f64::from_bits(border.to_bits().wrapping_add_signed(step));
                some.extend([near, -near, border * (1.0 + step as f64 * 1e-9)]);
            }
        }
        some.extend([f64::INFINITY, f64::NEG_INFINITY, f64::NAN, f64::MAX, -0.0]);
        some
    }

    /// Of every argument with ordinary ones beside it, for one that is not takes all of its lanes with it.
    fn assert_bits(name: &str, eight: fn(f64x8) -> f64x8, one: fn(f64) -> f64, taken: impl Fn(f64) -> bool) {
        for (number, x) in arguments().into_iter().filter(|&x| taken(x)).enumerate() {
            let lane = number % 8;
            let values = eight(f64x8::from_fn(|i| if i == lane { x } else { 0.1 + i as f64 / 10.0 })).to_array();
            for (i, value) in values.into_iter().enumerate() {
                let expected = one(if i == lane { x } else { 0.1 + i as f64 / 10.0 });
                let same = value.to_bits() == expected.to_bits() || value.is_nan() && expected.is_nan();
                assert!(same, "{name} of {x:e}, lane {i}: {value:e}, alone {expected:e}");
            }
        }
    }

    #[test]
    fn eight_have_the_bits_of_one() {
        assert_bits("exp", exp, elementary::exp, |_| true);
        assert_bits("expm1", expm1, elementary::expm1, |_| true);
        assert_bits("log", log, elementary::log, |_| true);
        assert_bits("log1p", log1p_of_fraction, elementary::log1p, |x| x.is_sign_positive() && x <= 1.0);
        assert_bits("sigmoid", sigmoid, elementary::sigmoid, |_| true);
        assert_bits("softplus", softplus, elementary::softplus, |_| true);
    }
}
