//! The Gaussian kernel `exp(-δ/2)`, the limit ν → ∞ of the t-kernel and the primitive of R²-Gaussian.

use std::f64::consts::{LN_2, TAU};

/// Unit of δ in which the kernel is a power of two: `exp(-δ/2) = 2^-(δ/UNIT)`.
pub(crate) const UNIT: f64 = 2.0 * LN_2;

/// `√(2π)`: the integral of `exp(-t²/2)` over the whole line, the limit of `[Eq. 5]`.
pub fn line_integral() -> f64 {
    TAU.sqrt()
}

/// The Mahalanobis distance δ at which the kernel is 2^-`bits` `[X2]`.
pub(crate) fn reach(bits: f64) -> f64 {
    UNIT * bits
}
