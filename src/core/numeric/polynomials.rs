//! Logarithms, powers of two and inverse square roots of [`Lanes`], of several registers at a time.
//!
//! Coefficients are minimax in relative error. `reference/generate/polynomials.py` computes them and the tables.
//!
//! In f32, logarithms and powers combine a table of 8 or 16 entries with a short polynomial. Permutations use another
//! execution port than multiply-adds, of which a polynomial alone would need 50 % more.

use super::{Lanes, Real};
use std::array::from_fn;
use wide::{f32x16, f64x8, i32x8, u32x8, u32x16, u64x8};

/// `c[0] + c[1] x + c[2] x² + …` by Horner's rule with FMA. The registers' dependency chains are independent.
#[inline(always)]
pub(super) fn polynomial<L: Lanes, const N: usize, const TERMS: usize>(
    x: [L; N],
    coefficients: &[L::Scalar; TERMS],
) -> [L; N] {
    let last = [L::splat(coefficients[TERMS - 1]); N];
    let step = |values: [L; N], &next| from_fn(|i| values[i].fma(x[i], L::splat(next)));
    coefficients[..TERMS - 1].iter().rev().fold(last, step)
}

/// Approximate inverses of 1 + i/8, and -log2 of them. The first eight cover one octave.
///
/// Of the numbers near each inverse, the one whose logarithm is closest to an f32 was chosen: within 6e-11.
const INVERSE_F32: [f32; 16] = [
    1.0e+00,
    8.889791e-01,
    8.000308e-01,
    7.27235e-01,
    6.666963e-01,
    6.152728e-01,
    5.7142097e-01,
    5.3338605e-01,
    5.0e-01,
    4.7058678e-01,
    4.444422e-01,
    4.2108637e-01,
    4.0003836e-01,
    3.809771e-01,
    3.6363494e-01,
    3.477792e-01,
];
const LOG2_OF_INVERSE_F32: [f32; 16] = [
    0.0e+00,
    1.6977863e-01,
    3.218725e-01,
    4.5950642e-01,
    5.8489835e-01,
    7.0070183e-01,
    8.073741e-01,
    9.06748e-01,
    1.0e+00,
    1.0874673e+00,
    1.1699322e+00,
    1.2478119e+00,
    1.3217897e+00,
    1.3922238e+00,
    1.4594373e+00,
    1.5237564e+00,
];
/// `log2(1+r) = r·P(r)` on [-1/16, 1/16]; 1.6e-8.
#[allow(clippy::approx_constant, reason = "the first coefficient of a minimax polynomial is near log2 e, not it")]
const LOG2_F32: [f32; 5] = [1.442695e+00, -7.21347e-01, 4.8091084e-01, -3.616642e-01, 2.8736347e-01];
/// `log2(1+f) = s·Q(s²)` with `s = f/(2+f)` on [√½-1, √2-1]; 1.4e-17.
const LOG2_F64: [f64; 8] = [
    2.8853900817779268e+00,
    9.617966939261154e-01,
    5.770780162765302e-01,
    4.121986000339649e-01,
    3.205971463235787e-01,
    2.6240400417314974e-01,
    2.1918244659274513e-01,
    2.305381423985441e-01,
];
/// 2^(i/8), and the relative rounding errors of these.
#[allow(clippy::approx_constant, reason = "√2 is one of them")]
const POWER_F32: [f32; 8] =
    [1.0e+00, 1.0905077e+00, 1.1892071e+00, 1.2968396e+00, 1.4142135e+00, 1.5422108e+00, 1.6817929e+00, 1.8340081e+00];
const LACK_F32: [f32; 8] = [
    0.0e+00,
    -1.19921575e-08,
    3.193418e-08,
    -3.099072e-08,
    1.7114271e-08,
    5.233334e-09,
    -1.4719605e-08,
    -6.1282597e-09,
];
/// `2^t = 1 + t·P(t)` on [-1/16, 1/16]; 2.6e-8.
#[allow(clippy::approx_constant, reason = "as above, with ln 2")]
const EXP2_F32: [f32; 3] = [6.9314724e-01, 2.4025756e-01, 5.5487253e-02];
/// `2^t = 1 + t·P(t)` on [-½, ½]; 4.1e-18.
#[allow(clippy::approx_constant, reason = "as above, with ln 2")]
const EXP2_F64: [f64; 11] = [
    6.931471805599453e-01,
    2.4022650695910108e-01,
    5.550410866482172e-02,
    9.618129107601608e-03,
    1.3333558146546372e-03,
    1.5403530449030215e-04,
    1.5252733634030488e-05,
    1.3215438839373654e-06,
    1.0178159958915822e-07,
    7.073232407660214e-09,
    4.4388850923243237e-10,
];

/// `1/√(1+e) = 1 + e·P(e)` on [-1/4, 1/4]; 3.2e-8.
const ROOT_F32: [f32; 7] =
    [-4.9999994e-01, 3.750099e-01, -3.1251863e-01, 2.724889e-01, -2.4487777e-01, 2.5110355e-01, -2.366246e-01];
/// The same on [-1/16, 1/16]; 1.5e-8.
const ROOT_SIXTEENTH_F32: [f32; 4] = [-4.9999884e-01, 3.7499842e-01, -3.137006e-01, 2.7469513e-01];
/// The same on [-1/4, 1/4], to 2.4e-7: a step of third order takes that to 3e-20.
const ROOT_F64: [f64; 6] = [
    -5.00005971871159e-01,
    3.7501053018373964e-01,
    -3.117243883458679e-01,
    2.7246239040918496e-01,
    -2.7059304945533413e-01,
    2.5136991558173755e-01,
];

/// Adding this rounds a number to eighths, whose count is then in the low bits: 1.5·2^20.
const EIGHTHS: f32 = 1_572_864.0;
/// The same with integers: 1.5·2^52.
const WHOLE: f64 = 6_755_399_441_055_744.0;
/// An eighth of an octave in the bits of a number: three bits below the exponent.
const EIGHTH: u32 = 20;

/// The bits of the first entries of a table, plus `i·step` for entry i.
const fn stepped<const N: usize>(table: &[f32], step: u32) -> [u32; N] {
    let (mut bits, mut i) = ([0; N], 0);
    while i < N {
        bits[i] = table[i].to_bits().wrapping_add(step.wrapping_mul(i as u32));
        i += 1;
    }
    bits
}

/// `LOG2_OF_INVERSE_F32[i] - i/8`, exact.
const LOG2_REST_F32: [f32; 8] = {
    let (mut rest, mut i) = ([0.0; 8], 0);
    while i < 8 {
        rest[i] = LOG2_OF_INVERSE_F32[i] - i as f32 / 8.0;
        i += 1;
    }
    rest
};

/// `table[index % 16]`.
#[inline(always)]
fn one_of_sixteen(table: [u32; 16], index: u32x16) -> f32x16 {
    if cfg!(target_feature = "avx512f") {
        bytemuck::cast(u32x16::new(table).shuffle_wrapping(index))
    } else {
        let [low, high]: [u32x8; 2] = bytemuck::cast(table);
        let lookup = |half: u32x8| {
            // The fourth bit becomes the sign, which selects one of the tables.
            let above: i32x8 = bytemuck::cast(half.unbounded_shl_scalar(28));
            let from = |table: u32x8| -> i32x8 { bytemuck::cast(table.shuffle_wrapping(half)) };
            above.simd_lt(i32x8::splat(0)).select(from(high), from(low))
        };
        // Not `map`, which the compiler may not inline.
        let [first, second]: [u32x8; 2] = bytemuck::cast(index);
        bytemuck::cast([lookup(first), lookup(second)])
    }
}

/// `table[index % 8]`.
#[inline(always)]
fn one_of_eight(table: [u32; 8], index: u32x16) -> f32x16 {
    if cfg!(target_feature = "avx512f") {
        // The table twice: one permutation of sixteen.
        one_of_sixteen(bytemuck::cast([table, table]), index)
    } else {
        let ([first, second], table): ([u32x8; 2], _) = (bytemuck::cast(index), u32x8::new(table));
        bytemuck::cast([table.shuffle_wrapping(first), table.shuffle_wrapping(second)])
    }
}

/// `1 + x·(c[0] + c[1] x + …)`.
#[inline(always)]
fn one_plus<L: Lanes, const N: usize, const TERMS: usize>(x: [L; N], coefficients: &[L::Scalar; TERMS]) -> [L; N] {
    let rest = polynomial(x, coefficients);
    from_fn(|i| x[i].fma(rest[i], L::splat(L::Scalar::ONE)))
}

/// A step of third order towards `1/√radicand`: from a relative error ε to 2.5 ε³.
#[inline(always)]
pub(super) fn nearer_to_root<L: Lanes>(root: L, radicand: L) -> L {
    let error = (-radicand * root).fma(root, L::splat_f64(1.0));
    (root * error).fma(error.fma(L::splat_f64(0.375), L::splat_f64(0.5)), root)
}

/// `log2(1+x)` for x from 0 to 31/16: 1+x is a small step from one of sixteen inverses.
#[inline(always)]
pub(super) fn log2_1p_near_f32<const N: usize>(x: [f32x16; N]) -> [f32x16; N] {
    const INVERSES: [u32; 16] = stepped(&INVERSE_F32, 0);
    const LOGARITHMS: [u32; 16] = stepped(&LOG2_OF_INVERSE_F32, 0);
    let part: [u32x16; N] = x.map(|x| bytemuck::cast(x + f32x16::splat(EIGHTHS)));
    let step: [f32x16; N] = from_fn(|i| {
        let inverse = one_of_sixteen(INVERSES, part[i]);
        x[i].fma(inverse, inverse - f32x16::splat(1.0))
    });
    let series = polynomial(step, &LOG2_F32);
    from_fn(|i| step[i].fma(series[i], one_of_sixteen(LOGARITHMS, part[i])))
}

/// `log2(1+x)`.
///
/// The bits of the rounded 1+x, relative to those of 31/32, give the part i of the octave k. The step is taken from x
/// itself, so that a small x loses no digits.
#[inline(always)]
pub(super) fn log2_1p_f32<const N: usize>(x: [f32x16; N]) -> [f32x16; N] {
    const LEAST: u32 = (31.0_f32 / 32.0).to_bits();
    // Adding eighths to this number is the same as or-ing them into its bits.
    const SCALE: f32 = (1 << EIGHTH) as f32;
    const INVERSES: [u32; 8] = stepped(&INVERSE_F32, 1 << EIGHTH);
    const LOGARITHMS: [u32; 8] = stepped(&LOG2_REST_F32, 0);
    let one = f32x16::splat(1.0);
    let part: [u32x16; N] = x.map(|x| {
        let bits: u32x16 = bytemuck::cast(one + x);
        (bits - u32x16::splat(LEAST)).unbounded_shr_scalar(EIGHTH)
    });
    let step: [f32x16; N] = from_fn(|i| {
        let bits: u32x16 = bytemuck::cast(one_of_eight(INVERSES, part[i]));
        let inverse: f32x16 = bytemuck::cast(bits - part[i].unbounded_shl_scalar(EIGHTH));
        x[i].fma(inverse, inverse - one)
    });
    let series = polynomial(step, &LOG2_F32);
    from_fn(|i| {
        let scaled: f32x16 = bytemuck::cast(part[i] | u32x16::splat(SCALE.to_bits()));
        step[i].fma(series[i], one_of_eight(LOGARITHMS, part[i]) + (scaled - f32x16::splat(SCALE)))
    })
}

/// `log2(1+x)` for x from 0 to √2 - 1.
#[inline(always)]
pub(super) fn log2_1p_near_f64<const N: usize>(x: [f64x8; N]) -> [f64x8; N] {
    log2_of_1_plus(x, [f64x8::splat(0.0); N])
}

/// `log2(1+x)`.
///
/// 1+x = 2^k·(1+f) with 1+f from √½ to √2. The exponent k is that of the rounded 1+x;
/// f = x·2^-k + (2^-k - 1) is taken from x itself, so that a small x loses no digits.
#[inline(always)]
pub(super) fn log2_1p_f64<const N: usize>(x: [f64x8; N]) -> [f64x8; N] {
    const LEAST: u64 = std::f64::consts::FRAC_1_SQRT_2.to_bits();
    // Adding an integer to this number is the same as or-ing it into its bits.
    const INTEGER: f64 = (1_u64 << 52) as f64;
    let one = f64x8::splat(1.0);
    let exponent: [u64x8; N] = x.map(|x| {
        let bits: u64x8 = bytemuck::cast(one + x);
        (bits - u64x8::splat(LEAST)).unbounded_shr_scalar(52)
    });
    let f: [f64x8; N] = from_fn(|i| {
        let bits = u64x8::splat(1.0_f64.to_bits()) - exponent[i].unbounded_shl_scalar(52);
        let scale: f64x8 = bytemuck::cast(bits);
        x[i].fma(scale, scale - one)
    });
    let whole = exponent.map(|exponent| {
        let k: f64x8 = bytemuck::cast(exponent | u64x8::splat(INTEGER.to_bits()));
        k - f64x8::splat(INTEGER)
    });
    log2_of_1_plus(f, whole)
}

/// `log2(1+f) + whole` for 1+f from √½ to √2.
#[inline(always)]
fn log2_of_1_plus<const N: usize>(f: [f64x8; N], whole: [f64x8; N]) -> [f64x8; N] {
    let s = f.map(|f| f / (f + f64x8::splat(2.0)));
    let series = polynomial(s.map(|s| s * s), &LOG2_F64);
    from_fn(|i| s[i].fma(series[i], whole[i]))
}

/// `2^t`: eighths go into the exponent and the table's index, the remainder into the polynomial.
#[inline(always)]
pub(super) fn exp2_f32<const N: usize>(t: [f32x16; N]) -> [f32x16; N] {
    // Minus the eighths that the shift into the exponent adds to the mantissa.
    const POWERS: [u32; 8] = stepped(&POWER_F32, (1_u32 << EIGHTH).wrapping_neg());
    const LACKS: [u32; 8] = stepped(&LACK_F32, 0);
    let rounder = f32x16::splat(EIGHTHS);
    let shifted = t.map(|t| t + rounder);
    let rest: [f32x16; N] = from_fn(|i| t[i] - (shifted[i] - rounder));
    let series = polynomial(rest, &EXP2_F32);
    from_fn(|i| {
        let eighths: u32x16 = bytemuck::cast(shifted[i]);
        let bits: u32x16 = bytemuck::cast(one_of_eight(POWERS, eighths));
        let power: f32x16 = bytemuck::cast(bits + eighths.unbounded_shl_scalar(EIGHTH));
        power.fma(rest[i].fma(series[i], one_of_eight(LACKS, eighths)), power)
    })
}

/// `2^t`: the integer part goes into the exponent, the remainder into the polynomial.
#[inline(always)]
pub(super) fn exp2_f64<const N: usize>(t: [f64x8; N]) -> [f64x8; N] {
    let rounder = f64x8::splat(WHOLE);
    let shifted = t.map(|t| t + rounder);
    let rest: [f64x8; N] = from_fn(|i| t[i] - (shifted[i] - rounder));
    let mantissa = one_plus(rest, &EXP2_F64);
    from_fn(|i| {
        let [mantissa, exponent]: [u64x8; 2] = [mantissa[i], shifted[i]].map(bytemuck::cast);
        bytemuck::cast(mantissa + exponent.unbounded_shl_scalar(52))
    })
}

#[inline(always)]
pub(super) fn root_quarter_f32(e: f32x16) -> f32x16 {
    one_plus([e], &ROOT_F32)[0]
}

#[inline(always)]
pub(super) fn root_sixteenth_f32(e: f32x16) -> f32x16 {
    one_plus([e], &ROOT_SIXTEENTH_F32)[0]
}

#[inline(always)]
pub(super) fn root_quarter_f64(e: f64x8) -> f64x8 {
    nearer_to_root(one_plus([e], &ROOT_F64)[0], e + f64x8::splat(1.0))
}
