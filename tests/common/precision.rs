//! **The table of tolerances.** No other test file holds one. Each row says why it is what it is and what was measured.

/// Projections and densities against 50-digit quadrature, relative, at every pixel however far from the centre.
/// A skirt at 10^-47 of the peak carries an exponent of 108, whose last bit alone is 1e-14.
/// Measured: 5e-14 (wide-gaussian), 2e-13 (needle).
pub(crate) const VALUE_AGAINST_TRUTH_F64: f64 = 1e-12;

/// The same in single precision, relative to the largest pixel of the case.
pub(crate) const VALUE_AGAINST_TRUTH_F32: f64 = 1e-6;

/// Gradients against 50-digit central differences, elementwise, relative to the largest entry of their group.
pub(crate) const GRADIENT_AGAINST_TRUTH_F64: f64 = 1e-9;

/// The same in single precision. Sums of signed terms: what cancels in the sum does not cancel in its rounding.
pub(crate) const GRADIENT_AGAINST_TRUTH_F32: f64 = 2e-4;

/// Fast path against the naive twin in f64, relative to the largest value.
pub(crate) const FAST_AGAINST_NAIVE_F64: f64 = 1e-13;

/// Gradients of the fast path against the naive twin's in f64, relative to the largest of the group. The twin
/// subtracts positions of size 5 to get offsets of size 0.05 and sums in another order.
pub(crate) const GRADIENT_FAST_AGAINST_NAIVE_F64: f64 = 1e-11;
