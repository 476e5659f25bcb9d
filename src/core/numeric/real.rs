//! The scalars of the kernels: f32 and f64.

use super::Lanes;
use crate::described;
use serde::{Deserialize, Serialize};
use std::fmt::{Debug, Display};
use std::iter::Sum;
use std::ops::{Add, AddAssign, Div, Mul, MulAssign, Neg, Sub, SubAssign};
use wide::f64x8;

described! {
    /// Arithmetic of the pixel kernels. Parameters and optimisers are always f64.
    #[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
    #[serde(rename_all = "lowercase")]
    pub enum Precision {
        /// Single.
        F32,
        /// Double.
        F64,
    }
}

/// The value of an expression with the type `$real` of a [`Precision`](crate::numeric::Precision).
#[macro_export]
#[doc(hidden)]
macro_rules! in_precision {
    ($precision:expr, $real:ident => $value:expr) => {
        match $precision {
            $crate::numeric::Precision::F32 => {
                type $real = f32;
                $value
            }
            $crate::numeric::Precision::F64 => {
                type $real = f64;
                $value
            }
        }
    };
}

/// A floating-point scalar that the pixel kernels can run in.
pub trait Real:
    Copy
    + Debug
    + Default
    + Display
    + PartialOrd
    + Send
    + Sync
    + 'static
    + Add<Output = Self>
    + AddAssign
    + Sub<Output = Self>
    + SubAssign
    + Mul<Output = Self>
    + MulAssign
    + Div<Output = Self>
    + Neg<Output = Self>
    + Sum
{
    /// Its SIMD lanes.
    type Lanes: Lanes<Scalar = Self>;
    /// 0
    const ZERO: Self;
    /// 1
    const ONE: Self;
    /// Largest n for which the kernels produce 2^-n; smaller values are zero.
    const HORIZON: f64;
    /// Distances, in units of a primitive's scale, are clamped to this; their squares stay finite.
    const FAR: f64;

    /// Rounds to nearest.
    fn from_f64(value: f64) -> Self;
    /// Exact.
    fn to_f64(self) -> f64;
    /// A small count, exact below 2^24.
    fn from_index(index: usize) -> Self;
    /// Correctly rounded square root.
    fn sqrt(self) -> Self;
    /// Absolute value.
    fn abs(self) -> Self;
    /// Not NaN or infinite.
    fn is_finite(self) -> bool;
    /// Columns of eight rows of eight values, in f64.
    fn columns(rows: [&[Self]; 8]) -> [f64x8; 8] {
        std::array::from_fn(|i| f64x8::new(rows.map(|row| row[i].to_f64())))
    }
}

/// Rounds to nearest. As [`Real::from_f64`], where that name would be ambiguous.
pub fn real<R: Real>(value: f64) -> R {
    R::from_f64(value)
}
