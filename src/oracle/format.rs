//! Floating-point formats of backends, and their units in the last place.

use serde::{Deserialize, Serialize};
use trgs_core::described;

described! {
    /// A binary floating-point format.
    #[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
    #[serde(into = "&str", try_from = "String")]
    pub enum Format {
        /// IEEE 754 double precision.
        F64,
        /// IEEE 754 single precision.
        F32,
        /// IEEE 754 half precision.
        F16,
        /// bfloat16: the upper half of single precision.
        Bf16,
        /// Single precision in which the factors of matrix products are rounded to 11 bits, as TF32 tensor cores do.
        Tf32,
        /// The same with factors in half precision, and its range.
        F16F32,
    }
}

impl Format {
    /// Its name in files, flags and reports.
    pub fn name(self) -> &'static str {
        match self {
            Self::F64 => "f64",
            Self::F32 => "f32",
            Self::F16 => "f16",
            Self::Bf16 => "bf16",
            Self::Tf32 => "tf32",
            Self::F16F32 => "f16+f32",
        }
    }

    /// Bits of the fraction, and the exponents of the smallest and the largest normal numbers.
    fn parts(self) -> (i32, i32, i32) {
        match self {
            Self::F64 => (52, -1022, 1023),
            Self::F32 => (23, -126, 127),
            Self::F16 | Self::F16F32 => (10, -14, 15),
            Self::Tf32 => (10, -126, 127),
            Self::Bf16 => (7, -126, 127),
        }
    }

    /// The distance between neighbouring numbers around `x`: one unit in the last place.
    pub fn ulp(self, x: f64) -> f64 {
        let (fraction, smallest, _) = self.parts();
        libm::ldexp(1.0, exponent(x).max(smallest) - fraction)
    }

    /// The smallest normal number. Hardware may flush smaller numbers to zero.
    pub fn smallest_normal(self) -> f64 {
        libm::ldexp(1.0, self.parts().1)
    }

    /// The largest finite number.
    pub fn largest(self) -> f64 {
        let (fraction, _, largest) = self.parts();
        libm::ldexp(2.0 - libm::ldexp(1.0, -fraction), largest)
    }

    /// The nearest number of the format, ties to even.
    pub fn round(self, x: f64) -> f64 {
        if self == Self::F64 || !x.is_finite() {
            return x;
        }
        let step = self.ulp(x);
        let rounded = (x / step).round_ties_even() * step;
        if rounded.abs() > self.largest() { f64::INFINITY.copysign(x) } else { rounded }
    }
}

impl From<Format> for &str {
    fn from(format: Format) -> Self {
        format.name()
    }
}

impl TryFrom<String> for Format {
    type Error = String;

    fn try_from(name: String) -> Result<Self, String> {
        let expected = || format!("{name:?} is none of {}", Self::ALL.map(Self::name).join(", "));
        Self::ALL.into_iter().find(|format| format.name() == name).ok_or_else(expected)
    }
}

impl std::fmt::Display for Format {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(self.name())
    }
}

/// The exponent e of a finite `|x| = m·2^e`, 1 ≤ m < 2; for 0, that of the smallest number.
fn exponent(x: f64) -> i32 {
    if x == 0.0 { -1074 } else { libm::ilogb(x) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rounding_to_single_and_half_precision_is_that_of_the_hardware_types() {
        let numbers = [0.0, 1.0, -1.0 / 3.0, 65519.9, 65520.0, 1e5, 3e-8, -5.1e-5, 1e-45, 0.7e-45, 3.4028236e38, 1e39];
        for x in numbers.into_iter().chain((0..200).map(|i| libm::exp(f64::from(i) - 100.0) * 1.2345)) {
            assert_eq!(Format::F32.round(x), f64::from(x as f32), "{x:e} in f32");
            assert_eq!(Format::F16.round(x), half::f16::from_f64(x).to_f64(), "{x:e} in f16");
            assert_eq!(Format::Bf16.round(x), half::bf16::from_f64(x).to_f64(), "{x:e} in bf16");
            assert_eq!(Format::F64.round(x), x);
        }
    }

    #[test]
    fn a_unit_in_the_last_place_is_the_distance_to_the_next_number() {
        for x in [1.0_f64, 1.999, 1e-300, 3e200, 5e-324] {
            assert_eq!(Format::F64.ulp(x), x.next_up() - x, "{x:e}");
            assert_eq!(Format::F64.ulp(-x), x.next_up() - x);
        }
        assert_eq!(Format::F32.ulp(1.5), f64::from(f32::EPSILON));
        assert_eq!(Format::F32.ulp(0.0), f64::from(f32::from_bits(1)));
        assert_eq!(Format::F16.largest(), 65504.0);
        assert_eq!(Format::F32.smallest_normal(), f64::from(f32::MIN_POSITIVE));
    }
}
