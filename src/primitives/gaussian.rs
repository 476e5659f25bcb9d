//! The Gaussian kernel `exp(-δ/2)`, the limit ν → ∞ of the t-kernel and the primitive of R²-Gaussian.

use std::f64::consts::{LN_2, TAU};

/// δ is measured in units of this, so that the kernel is a power of two: `exp(-δ/2) = 2^-(δ/UNIT)`.
pub(crate) const UNIT: f64 = 2.0 * LN_2;

/// `√(2π)`: the integral of `exp(-t²/2)` over the whole line.
pub fn line_integral() -> f64 {
    TAU.sqrt()
}

/// The Mahalanobis distance δ where the kernel has fallen to 2^-`bits` `[X2]`.
pub(crate) fn reach(bits: f64) -> f64 {
    UNIT * bits
}
