//! The polynomials of [`Lanes`], of several registers at a time. Coefficients are minimax in relative error, from
//! reference/generate/polynomials.py.

use super::lanes::{Lanes, Real, real};
use std::array::from_fn;
use wide::{f32x16, f64x8};

/// `c[0] + c[1] x + c[2] x² + …` by Horner's rule, fused: the fewest steps. Each waits for the one before, but not for
/// those of the other registers.
#[inline(always)]
pub(super) fn polynomial<L: Lanes, const N: usize, const TERMS: usize>(
    x: [L; N],
    coefficients: &[L::Scalar; TERMS],
) -> [L; N] {
    let last = [L::splat(coefficients[TERMS - 1]); N];
    let step = |values: [L; N], &next| from_fn(|i| values[i].fma(x[i], L::splat(next)));
    coefficients[..TERMS - 1].iter().rev().fold(last, step)
}

/// `log2(1+f) = f·P(f)` on [√½-1, √2-1]; 2.9e-8.
#[allow(clippy::approx_constant, reason = "the first coefficient of a minimax polynomial is near log2 e, not it")]
const LOG2_F32: [f32; 9] = [
    1.442695e+00,
    -7.213474e-01,
    4.8090905e-01,
    -3.6070004e-01,
    2.8795016e-01,
    -2.3902889e-01,
    2.1552761e-01,
    -2.0669751e-01,
    1.2560181e-01,
];
/// `log2(1+f) = s·Q(s²)` with `s = f/(2+f)`, same interval; 1.4e-17.
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
/// `2^t = 1 + t·P(t)` on [-½, ½]; 3.0e-9.
#[allow(clippy::approx_constant, reason = "as above, with ln 2")]
pub(super) const EXP2_F32: [f32; 6] =
    [6.931472e-01, 2.4022648e-01, 5.5503596e-02, 9.618499e-03, 1.339097e-03, 1.5329279e-04];
/// `2^t = 1 + t·P(t)` on [-½, ½]; 4.1e-18.
#[allow(clippy::approx_constant, reason = "as above, with ln 2")]
pub(super) const EXP2_F64: [f64; 11] = [
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
const ROOT_NEAREST_F32: [f32; 4] = [-4.9999884e-01, 3.7499842e-01, -3.137006e-01, 2.7469513e-01];
/// The same on [-1/4, 1/4], to 2.4e-7: a step of third order takes that to 3e-20.
const ROOT_F64: [f64; 6] = [
    -5.00005971871159e-01,
    3.7501053018373964e-01,
    -3.117243883458679e-01,
    2.7246239040918496e-01,
    -2.7059304945533413e-01,
    2.5136991558173755e-01,
];

/// `1 + x·(c[0] + c[1] x + …)`.
#[inline(always)]
pub(super) fn one_plus<L: Lanes, const N: usize, const TERMS: usize>(
    x: [L; N],
    coefficients: &[L::Scalar; TERMS],
) -> [L; N] {
    let rest = polynomial(x, coefficients);
    from_fn(|i| x[i].fma(rest[i], L::splat(L::Scalar::ONE)))
}

/// A step of third order towards `1/√radicand`: from a relative error ε to 2.5 ε³.
#[inline(always)]
pub(super) fn nearer_to_root<L: Lanes>(root: L, radicand: L) -> L {
    let splat = |value: f64| L::splat(real(value));
    let error = (-radicand * root).fma(root, splat(1.0));
    (root * error).fma(error.fma(splat(0.375), splat(0.5)), root)
}

/// `log2(1+f)` on [√½-1, √2-1], as two factors.
#[inline(always)]
pub(super) fn log2_of_1_plus_f32<const N: usize>(f: [f32x16; N]) -> ([f32x16; N], [f32x16; N]) {
    (f, polynomial(f, &LOG2_F32))
}

#[inline(always)]
pub(super) fn log2_of_1_plus_f64<const N: usize>(f: [f64x8; N]) -> ([f64x8; N], [f64x8; N]) {
    let s = f.map(|f| f / (f + f64x8::splat(2.0)));
    (s, polynomial(s.map(|s| s * s), &LOG2_F64))
}

#[inline(always)]
pub(super) fn root_near_f32(e: f32x16) -> f32x16 {
    one_plus([e], &ROOT_F32)[0]
}

#[inline(always)]
pub(super) fn root_nearest_f32(e: f32x16) -> f32x16 {
    one_plus([e], &ROOT_NEAREST_F32)[0]
}

#[inline(always)]
pub(super) fn root_near_f64(e: f64x8) -> f64x8 {
    nearer_to_root(one_plus([e], &ROOT_F64)[0], e + f64x8::splat(1.0))
}
