//! The lanes of `trgs::numeric::lanes` as arrays of any width, computed one number at a time.
//!
//! There is no SIMD and no `wide`, only the arithmetic of `f32` and `f64`. All kernels of the project can run in these
//! lanes, so the same kernel text is compared bit by bit with the fast lanes.

#![allow(clippy::disallowed_methods, reason = "the fused operation itself, one number at a time")]

use std::fmt::{self, Display, Formatter};
use std::iter::Sum;
use std::ops::{Add, AddAssign, Div, Mul, MulAssign, Neg, Sub, SubAssign};
use trgs::numeric::rearrange::{INTERLEAVED, Rearrange};
use trgs::numeric::{Lanes, Real};

// Copies, not imports: a change of the polynomials changes bits and must be repeated here.
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
#[allow(clippy::approx_constant, reason = "a minimax coefficient")]
const LOG2_F32: [f32; 5] = [1.442695e+00, -7.21347e-01, 4.8091084e-01, -3.616642e-01, 2.8736347e-01];
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
#[allow(clippy::approx_constant, reason = "a minimax coefficient")]
const EXP2_F32: [f32; 3] = [6.9314724e-01, 2.4025756e-01, 5.5487253e-02];
#[allow(clippy::approx_constant, reason = "a minimax coefficient")]
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

const ROOT_F32: [f32; 7] =
    [-4.9999994e-01, 3.750099e-01, -3.1251863e-01, 2.724889e-01, -2.4487777e-01, 2.5110355e-01, -2.366246e-01];
const ROOT_SIXTEENTH_F32: [f32; 4] = [-4.9999884e-01, 3.7499842e-01, -3.137006e-01, 2.7469513e-01];
const ROOT_F64: [f64; 6] = [
    -5.00005971871159e-01,
    3.7501053018373964e-01,
    -3.117243883458679e-01,
    2.7246239040918496e-01,
    -2.7059304945533413e-01,
    2.5136991558173755e-01,
];

/// Horner's rule with fused multiply-add.
macro_rules! polynomial {
    ($x:expr, $coefficients:expr) => {
        $coefficients.iter().rev().copied().reduce(|sum, next| sum.mul_add($x, next)).unwrap()
    };
}

/// Added to a number, this puts its eighths into the low bits.
const EIGHTHS: f32 = 1_572_864.0;

/// `log2(1+x)` near 0, by a step from one of sixteen inverses.
fn log2_1p_near_f32(x: f32) -> f32 {
    let part = (x + EIGHTHS).to_bits() as usize % 16;
    let step = x.mul_add(INVERSE_F32[part], INVERSE_F32[part] - 1.0);
    step.mul_add(polynomial!(step, LOG2_F32), LOG2_OF_INVERSE_F32[part])
}

/// `log2(1+x)` for any octave; the first octave is from 31/32 to its double.
fn log2_1p_f32(x: f32) -> f32 {
    let eighths = (1.0 + x).to_bits().wrapping_sub((31.0_f32 / 32.0).to_bits()) >> 20;
    let (part, octave) = (eighths as usize % 8, eighths / 8);
    let inverse = f32::from_bits(INVERSE_F32[part].to_bits().wrapping_sub(octave << 23));
    let step = x.mul_add(inverse, inverse - 1.0);
    // The bits above the number 2^20 count eighths: an out-of-range value cannot reach the sign bit.
    let integer: f32 = 1_048_576.0;
    let count = f32::from_bits(integer.to_bits() | eighths) - integer;
    let rest = LOG2_OF_INVERSE_F32[part] - part as f32 / 8.0;
    step.mul_add(polynomial!(step, LOG2_F32), rest + count)
}

/// `log2(1+f) + k`.
fn log2_series_f64(f: f64, k: f64) -> f64 {
    let s = f / (f + 2.0);
    s.mul_add(polynomial!(s * s, LOG2_F64), k)
}

fn log2_1p_near_f64(x: f64) -> f64 {
    log2_series_f64(x, 0.0)
}

/// `1+x = 2^k·(1+f)` with `1+f` in [√½, √2).
///
/// The exponent comes from the bits of the rounded 1+x, f from x itself.
fn log2_1p_f64(x: f64) -> f64 {
    let exponent = (1.0 + x).to_bits().wrapping_sub(std::f64::consts::FRAC_1_SQRT_2.to_bits()) >> 52;
    let scale = f64::from_bits(1.0_f64.to_bits().wrapping_sub(exponent << 52));
    // The bits above the number 2^52 count units: an out-of-range exponent cannot reach the sign bit.
    let integer = (1_u64 << 52) as f64;
    let k = f64::from_bits(integer.to_bits() | exponent) - integer;
    log2_series_f64(x.mul_add(scale, scale - 1.0), k)
}

/// One of eight powers, with the integer part in its exponent, times `2^rest` as a polynomial.
fn exp2_f32(t: f32) -> f32 {
    let shifted = t + EIGHTHS;
    let rest = t - (shifted - EIGHTHS);
    let eighths = shifted.to_bits();
    let part = eighths % 8;
    let whole = (eighths - part) << 20;
    let power = f32::from_bits(POWER_F32[part as usize].to_bits().wrapping_add(whole));
    power.mul_add(rest.mul_add(polynomial!(rest, EXP2_F32), LACK_F32[part as usize]), power)
}

/// The integer part goes into the exponent; `2^rest` is a polynomial.
fn exp2_f64(t: f64) -> f64 {
    let rounder = 1.5 * (1_u64 << 52) as f64;
    let shifted = t + rounder;
    let rest = t - (shifted - rounder);
    let mantissa = rest.mul_add(polynomial!(rest, EXP2_F64), 1.0);
    f64::from_bits(mantissa.to_bits().wrapping_add(shifted.to_bits() << 52))
}

/// `1/√(1+e)` near e = 0, for the wider and for the narrower range.
fn root_quarter_f32(e: f32) -> f32 {
    e.mul_add(polynomial!(e, ROOT_F32), 1.0)
}

fn root_sixteenth_f32(e: f32) -> f32 {
    e.mul_add(polynomial!(e, ROOT_SIXTEENTH_F32), 1.0)
}

fn root_quarter_f64(e: f64) -> f64 {
    let root = e.mul_add(polynomial!(e, ROOT_F64), 1.0);
    let error = (-(e + 1.0) * root).mul_add(root, 1.0);
    (root * error).mul_add(error.mul_add(0.375, 0.5), root)
}

macro_rules! plain {
    (
        $number:ident, $row:ident, $scalar:ident, $unsigned:ident, mantissa $mantissa:literal, $log2_1p:ident, $log2_1p_near:ident up to $span:expr, $exp2:ident,
        rsqrt $magic:literal in $steps:literal, quarter $quarter:ident, sixteenth $sixteenth:ident
    ) => {
        /// A number whose lanes are arrays of `W`.
        #[derive(Clone, Copy, Debug, Default, PartialEq, PartialOrd)]
        pub(crate) struct $number<const W: usize>(pub(crate) $scalar);

        /// `W` numbers.
        #[derive(Clone, Copy, Debug)]
        pub(crate) struct $row<const W: usize>([$number<W>; W]);

        impl<const W: usize> $number<W> {
            fn log2_1p(self) -> Self {
                Self($log2_1p(self.0))
            }

            fn log2_1p_near(self) -> Self {
                Self($log2_1p_near(self.0))
            }

            fn exp2(self) -> Self {
                Self($exp2(self.0))
            }

            /// An initial value from the bits, then iterations of third order.
            fn rsqrt(self) -> Self {
                let x = self.0;
                let mut root = $scalar::from_bits($magic - (x.to_bits() >> 1));
                for _ in 0..$steps {
                    let error = (-x * root).mul_add(root, 1.0);
                    root = (root * error).mul_add(error.mul_add(0.375, 0.5), root);
                }
                Self(root)
            }
        }

        impl<const W: usize> trgs::projector::Kernels for $number<W> {}

        impl<const W: usize> Real for $number<W> {
            type Lanes = $row<W>;
            const ZERO: Self = Self(0.0);
            const ONE: Self = Self(1.0);
            const HORIZON: f64 = <$scalar as Real>::HORIZON;
            const FAR: f64 = <$scalar as Real>::FAR;
            fn from_f64(value: f64) -> Self {
                Self(value as $scalar)
            }
            fn to_f64(self) -> f64 {
                self.0.into()
            }
            fn from_index(index: usize) -> Self {
                Self(index as $scalar)
            }
            fn sqrt(self) -> Self {
                Self(self.0.sqrt())
            }
            fn abs(self) -> Self {
                Self(self.0.abs())
            }
            fn is_finite(self) -> bool {
                self.0.is_finite()
            }
        }

        impl<const W: usize> Rearrange<$number<W>> for $row<W> {
            fn deinterleave<const N: usize>(
                values: &[$number<W>],
                stride: usize,
                columns: &mut [[Self; N]; INTERLEAVED],
                row: usize,
            ) {
                for (i, column) in columns.iter_mut().enumerate() {
                    column[row] = Self::from_fn(|lane| values[lane * stride + i]);
                }
            }
            fn interleave<const N: usize>(
                columns: &[[Self; N]; INTERLEAVED],
                row: usize,
                values: &mut [$number<W>],
                stride: usize,
            ) {
                for (i, column) in columns.iter().enumerate() {
                    column[row].0.iter().enumerate().for_each(|(lane, &value)| values[lane * stride + i] = value);
                }
            }
            fn shift_up(self) -> Self {
                Self::from_fn(|i| if i == 0 { $number(0.0) } else { self.0[i - 1] })
            }
            fn shift_down(self) -> Self {
                Self::from_fn(|i| self.0.get(i + 1).copied().unwrap_or_default())
            }
        }

        impl<const W: usize> Lanes for $row<W> {
            type Scalar = $number<W>;
            type Index = [usize; W];
            type Block = [$number<W>; W];
            const WIDTH: usize = W;
            const LOG_NEAR: f64 = $span;
            fn splat(value: $number<W>) -> Self {
                Self([value; W])
            }
            fn from_slice(values: &[$number<W>]) -> Self {
                Self::from_fn(|i| values[i])
            }
            fn write(self, values: &mut [$number<W>]) {
                values[..W].copy_from_slice(&self.0);
            }
            fn blocks(values: &[$number<W>]) -> &[Self::Block] {
                values.as_chunks().0
            }
            fn blocks_mut(values: &mut [$number<W>]) -> &mut [Self::Block] {
                values.as_chunks_mut().0
            }
            fn from_block(block: &Self::Block) -> Self {
                Self(*block)
            }
            fn to_block(self) -> Self::Block {
                self.0
            }
            fn from_rows(top: &[$number<W>], bottom: &[$number<W>]) -> Self {
                Self::from_fn(|i| if i < W / 2 { top[i] } else { bottom[i - W / 2] })
            }
            fn add_to_rows(self, top: &mut [$number<W>], bottom: &mut [$number<W>]) {
                for i in 0..W / 2 {
                    top[i] += self.0[i];
                    bottom[i] += self.0[W / 2 + i];
                }
            }
            fn from_fn(value: impl FnMut(usize) -> $number<W>) -> Self {
                Self(std::array::from_fn(value))
            }
            fn split(self) -> ([usize; W], Self) {
                (self.0.map(|value| value.0.floor() as usize), Self(self.0.map(|value| $number(value.0 - value.0.floor()))))
            }
            fn ceil(self) -> Self {
                Self(self.0.map(|value| $number(value.0.ceil())))
            }
            fn write_indices(index: [usize; W], indices: &mut [u32]) {
                indices.iter_mut().zip(index).for_each(|(to, whole)| *to = whole as u32);
            }
            fn lookup(tables: [&[$number<W>]; 2], index: [usize; W]) -> Self {
                Self::from_fn(|i| tables[2 * i / W][..W / 2].get(index[i]).copied().unwrap_or_default())
            }
            fn lookup_wide(tables: [&[$number<W>]; 2], index: [usize; W]) -> Self {
                Self::from_fn(|i| tables[2 * i / W][..W].get(index[i]).copied().unwrap_or_default())
            }
            fn fma(self, factor: Self, summand: Self) -> Self {
                Self::from_fn(|i| $number(self.0[i].0.mul_add(factor.0[i].0, summand.0[i].0)))
            }
            fn sqrt(self) -> Self {
                Self(self.0.map(Real::sqrt))
            }
            fn rsqrt(self) -> Self {
                Self(self.0.map($number::rsqrt))
            }
            fn rsqrt_1p_quarter(self) -> Self {
                Self(self.0.map(|e| $number($quarter(e.0))))
            }
            fn rsqrt_1p_sixteenth(self) -> Self {
                Self(self.0.map(|e| $number($sixteenth(e.0))))
            }
            fn abs(self) -> Self {
                Self(self.0.map(Real::abs))
            }
            fn at_most(self, other: Self) -> Self {
                Self::from_fn(|i| if self.0[i] < other.0[i] { self.0[i] } else { other.0[i] })
            }
            fn at_least(self, other: Self) -> Self {
                Self::from_fn(|i| if self.0[i] > other.0[i] { self.0[i] } else { other.0[i] })
            }
            fn below(self, limit: Self) -> u32 {
                (0..Self::WIDTH).fold(0, |bits, i| bits | u32::from(self.0[i] < limit.0[i]) << i)
            }
            fn select_le(self, limit: Self, yes: Self, no: Self) -> Self {
                Self::from_fn(|i| if self.0[i] <= limit.0[i] { yes.0[i] } else { no.0[i] })
            }
            fn log2_1p_each<const N: usize>(x: [Self; N]) -> [Self; N] {
                x.map(|x| Self(x.0.map($number::log2_1p)))
            }
            fn log2_1p_near_each<const N: usize>(x: [Self; N]) -> [Self; N] {
                x.map(|x| Self(x.0.map($number::log2_1p_near)))
            }
            fn exp2_each<const N: usize>(t: [Self; N]) -> [Self; N] {
                t.map(|t| Self(t.0.map($number::exp2)))
            }
            /// Adds the halves until eight numbers are left.
            fn fold_to_8(self) -> [f64; 8] {
                let lane = |i: usize| self.0.get(i).map_or(0.0, |lane| lane.to_f64());
                std::array::from_fn(|i| (i + 8..W).step_by(8).fold(lane(i), |sum, other| sum + lane(other)))
            }
            /// Adds the halves until one number is left.
            fn sum(self) -> f64 {
                fn tree(lanes: &[f64]) -> f64 {
                    let half = lanes.len() / 2;
                    match lanes {
                        [one] => *one,
                        _ => tree(&(0..half).map(|i| lanes[i] + lanes[half + i]).collect::<Vec<_>>()),
                    }
                }
                tree(&self.0.map(Real::to_f64))
            }
        }

        impl<const W: usize> Default for $row<W> {
            fn default() -> Self {
                Self([$number(0.0); W])
            }
        }

        impl<const W: usize> Display for $number<W> {
            fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
                self.0.fmt(f)
            }
        }

        impl<const W: usize> Sum for $number<W> {
            fn sum<I: Iterator<Item = Self>>(numbers: I) -> Self {
                numbers.fold(Self(0.0), Add::add)
            }
        }

        impl<const W: usize> Neg for $number<W> {
            type Output = Self;
            fn neg(self) -> Self {
                Self(-self.0)
            }
        }

        impl<const W: usize> Neg for $row<W> {
            type Output = Self;
            fn neg(self) -> Self {
                Self(self.0.map(Neg::neg))
            }
        }

        plain!(@operator $number, $row, Add, add);
        plain!(@operator $number, $row, Sub, sub);
        plain!(@operator $number, $row, Mul, mul);
        plain!(@operator $number, $row, Div, div);
        plain!(@assign $number, AddAssign, add_assign, add);
        plain!(@assign $number, SubAssign, sub_assign, sub);
        plain!(@assign $number, MulAssign, mul_assign, mul);
        plain!(@assign $row, AddAssign, add_assign, add);
    };
    (@operator $number:ident, $row:ident, $trait:ident, $method:ident) => {
        impl<const W: usize> $trait for $number<W> {
            type Output = Self;
            fn $method(self, other: Self) -> Self {
                Self(self.0.$method(other.0))
            }
        }
        impl<const W: usize> $trait for $row<W> {
            type Output = Self;
            fn $method(self, other: Self) -> Self {
                Self(std::array::from_fn(|i| self.0[i].$method(other.0[i])))
            }
        }
    };
    (@assign $type:ident, $trait:ident, $method:ident, $plain:ident) => {
        impl<const W: usize> $trait for $type<W> {
            fn $method(&mut self, other: Self) {
                *self = (*self).$plain(other);
            }
        }
    };
}

plain!(Plain32, Row32, f32, u32, mantissa 23, log2_1p_f32, log2_1p_near_f32 up to 1.9374, exp2_f32, rsqrt 0x5f37_5a86 in 2, quarter root_quarter_f32, sixteenth root_sixteenth_f32);
plain!(Plain64, Row64, f64, u64, mantissa 52, log2_1p_f64, log2_1p_near_f64 up to 0.4142, exp2_f64, rsqrt 0x5fe6_eb50_c7b5_37a9 in 3, quarter root_quarter_f64, sixteenth root_quarter_f64);
