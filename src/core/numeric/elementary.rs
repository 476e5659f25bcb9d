//! Transcendental functions with the same bits on every machine.
//!
//! They are the `libm` crate's, compiled from source instead of taken from the platform. The hot kernels have their own
//! ([`super::lanes`]).

use glam::DVec3;

pub use libm::{asin, atan, atan2, cbrt, cos, exp, exp2, expm1, log, log1p, log2, log10, pow, sin, tan};

/// |v|, with the bits of glam's `length`.
///
/// glam's square root is libm's SSE instruction. After AVX-512 kernels it waits for the upper halves of their registers, as
/// long as a small footprint takes.
pub fn length(v: DVec3) -> f64 {
    v.length_squared().sqrt()
}

/// The power of two at or below a positive number, 0 for a subnormal one. Division by it is exact.
pub fn power_of_two_below(x: f64) -> f64 {
    f64::from_bits(x.to_bits() & f64::INFINITY.to_bits())
}

/// Logistic function `1/(1+e^-x)`, without overflow.
pub fn sigmoid(x: f64) -> f64 {
    if x >= 0.0 {
        1.0 / (1.0 + exp(-x))
    } else {
        let e = exp(x);
        e / (1.0 + e)
    }
}

/// Inverse of [`sigmoid`] on (0, 1).
pub fn logit(p: f64) -> f64 {
    log(p / (1.0 - p))
}

/// `ln(1+e^x)`, without overflow.
pub fn softplus(x: f64) -> f64 {
    if x > 0.0 { x + log1p(exp(-x)) } else { log1p(exp(x)) }
}

/// Inverse of [`softplus`] on (0, ∞).
pub fn softplus_inverse(y: f64) -> f64 {
    y + log(-expm1(-y))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tolerances::relative;

    #[test]
    fn lengths_are_those_of_glam_to_the_bit() {
        for v in [DVec3::new(0.3, -1.7, 2.9), DVec3::new(1e-160, 3e-150, 0.0), DVec3::new(1e150, -2e140, 7.0)] {
            assert_eq!(length(v), v.length());
        }
    }

    #[test]
    fn powers_of_two_lie_at_or_below() {
        for (x, power) in [(1.0, 1.0), (1.9, 1.0), (6.0, 4.0), (0.3, 0.25), (f64::MIN_POSITIVE / 2.0, 0.0)] {
            assert_eq!(power_of_two_below(x), power);
        }
    }

    #[test]
    fn inverses_invert() {
        for x in [-30.0, -3.0, -0.1, 0.0, 0.7, 5.0, 30.0] {
            within!(relative(softplus_inverse(softplus(x)), x));
        }
        for x in [-30.0, -3.0, 0.0, 0.7, 5.0] {
            within!(relative(logit(sigmoid(x)), x));
        }
    }
}
