//! The lanes of `trgs::numeric::lanes` once more, as arrays of any width and one number at a time: no SIMD, no `wide`, only
//! the arithmetic of `f32` and `f64`. All kernels of the project run in them, so the same kernel text can be compared bit
//! by bit with the fast lanes.

#![allow(clippy::disallowed_methods, reason = "the fused operation itself, one number at a time")]

use std::fmt::{self, Display, Formatter};
use std::iter::Sum;
use std::ops::{Add, AddAssign, Div, Mul, MulAssign, Neg, Sub, SubAssign};
use trgs::numeric::{Lanes, Real};

// Copies, not imports: a change of the polynomials changes bits and has to be made here, too.
#[allow(clippy::approx_constant, reason = "a minimax coefficient")]
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
#[allow(clippy::approx_constant, reason = "a minimax coefficient")]
const EXP2_F32: [f32; 6] = [6.931472e-01, 2.4022648e-01, 5.5503596e-02, 9.618499e-03, 1.339097e-03, 1.5329279e-04];
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
const ROOT_NEAREST_F32: [f32; 4] = [-4.9999884e-01, 3.7499842e-01, -3.137006e-01, 2.7469513e-01];
const ROOT_F64: [f64; 6] = [
    -5.00005971871159e-01,
    3.7501053018373964e-01,
    -3.117243883458679e-01,
    2.7246239040918496e-01,
    -2.7059304945533413e-01,
    2.5136991558173755e-01,
];

/// Horner's rule, fused.
macro_rules! polynomial {
    ($x:expr, $coefficients:expr) => {
        $coefficients.iter().rev().copied().reduce(|sum, next| sum.mul_add($x, next)).unwrap()
    };
}

/// `log2(1+f) + k`.
fn log2_series_f32(f: f32, k: f32) -> f32 {
    f.mul_add(polynomial!(f, LOG2_F32), k)
}

fn log2_series_f64(f: f64, k: f64) -> f64 {
    let s = f / (f + 2.0);
    s.mul_add(polynomial!(s * s, LOG2_F64), k)
}

/// `1/√(1+e)` near e = 0, and nearest to it.
fn root_near_f32(e: f32) -> f32 {
    e.mul_add(polynomial!(e, ROOT_F32), 1.0)
}

fn root_nearest_f32(e: f32) -> f32 {
    e.mul_add(polynomial!(e, ROOT_NEAREST_F32), 1.0)
}

fn root_near_f64(e: f64) -> f64 {
    let root = e.mul_add(polynomial!(e, ROOT_F64), 1.0);
    let error = (-(e + 1.0) * root).mul_add(root, 1.0);
    (root * error).mul_add(error.mul_add(0.375, 0.5), root)
}

macro_rules! plain {
    (
        $number:ident, $row:ident, $scalar:ident, $unsigned:ident, mantissa $mantissa:literal, $series:ident, $exp2:ident,
        rsqrt $magic:literal in $steps:literal, near $near:ident, nearest $nearest:ident
    ) => {
        /// A number whose lanes are arrays of `W`.
        #[derive(Clone, Copy, Debug, Default, PartialEq, PartialOrd)]
        pub(crate) struct $number<const W: usize>(pub(crate) $scalar);

        /// `W` numbers.
        #[derive(Clone, Copy)]
        pub(crate) struct $row<const W: usize>([$number<W>; W]);

        impl<const W: usize> $number<W> {
            /// `1+x = 2^k·(1+f)` with `1+f` in [√½, √2), the exponent from the bits of the rounded 1+x and f from x itself.
            fn log2_1p(self) -> Self {
                let x = self.0;
                let root_half = std::$scalar::consts::FRAC_1_SQRT_2.to_bits();
                let exponent = (1.0 + x).to_bits().wrapping_sub(root_half) >> $mantissa;
                let one: $scalar = 1.0;
                let scale = $scalar::from_bits(one.to_bits().wrapping_sub(exponent << $mantissa));
                // The bits above the number 2^mantissa count units: an exponent out of range cannot reach its sign.
                let integer = ((1 as $unsigned) << $mantissa) as $scalar;
                let k = $scalar::from_bits(integer.to_bits() | exponent) - integer;
                Self($series(x.mul_add(scale, scale - 1.0), k))
            }

            /// The integer part goes into the exponent, `2^fraction` is a polynomial.
            fn exp2(self) -> Self {
                let rounder = 1.5 * ((1 as $unsigned) << $mantissa) as $scalar;
                let shifted = self.0 + rounder;
                let fraction = self.0 - (shifted - rounder);
                let mantissa = fraction.mul_add(polynomial!(fraction, $exp2), 1.0);
                Self($scalar::from_bits(mantissa.to_bits().wrapping_add(shifted.to_bits() << $mantissa)))
            }

            /// A guess from the bits, then steps of third order.
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

        impl<const W: usize> Lanes for $row<W> {
            type Scalar = $number<W>;
            type Index = [usize; W];
            const WIDTH: usize = W;
            fn splat(value: $number<W>) -> Self {
                Self([value; W])
            }
            fn from_slice(values: &[$number<W>]) -> Self {
                Self::from_fn(|i| values[i])
            }
            fn write(self, values: &mut [$number<W>]) {
                values[..W].copy_from_slice(&self.0);
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
            fn write_indices(index: [usize; W], indices: &mut [u32]) {
                indices.iter_mut().zip(index).for_each(|(to, whole)| *to = whole as u32);
            }
            fn pick(tables: [&[$number<W>]; 2], index: [usize; W]) -> Self {
                Self::from_fn(|i| tables[2 * i / W][..W / 2].get(index[i]).copied().unwrap_or_default())
            }
            fn pick_wide(tables: [&[$number<W>]; 2], index: [usize; W]) -> Self {
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
            fn rsqrt_1p_near(self) -> Self {
                Self(self.0.map(|e| $number($near(e.0))))
            }
            fn rsqrt_1p_nearest(self) -> Self {
                Self(self.0.map(|e| $number($nearest(e.0))))
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
            fn any_below(self, limit: Self) -> bool {
                (0..Self::WIDTH).any(|i| self.0[i] < limit.0[i])
            }
            fn select_le(self, limit: Self, yes: Self, no: Self) -> Self {
                Self::from_fn(|i| if self.0[i] <= limit.0[i] { yes.0[i] } else { no.0[i] })
            }
            fn log2_1p_each<const N: usize>(x: [Self; N]) -> [Self; N] {
                x.map(|x| Self(x.0.map($number::log2_1p)))
            }
            fn exp2_each<const N: usize>(t: [Self; N]) -> [Self; N] {
                t.map(|t| Self(t.0.map($number::exp2)))
            }
            /// One half plus the other, until one number is left.
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

plain!(Plain32, Row32, f32, u32, mantissa 23, log2_series_f32, EXP2_F32, rsqrt 0x5f37_5a86 in 2, near root_near_f32, nearest root_nearest_f32);
plain!(Plain64, Row64, f64, u64, mantissa 52, log2_series_f64, EXP2_F64, rsqrt 0x5fe6_eb50_c7b5_37a9 in 3, near root_near_f64, nearest root_near_f64);
