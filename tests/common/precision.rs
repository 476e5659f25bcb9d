//! **Tolerances** shared by the numerical contracts, each with its reason and the measured value.
//!
//! Tolerances of the conformance vectors, which apply to every backend, are in `reference/tolerances.toml`. Contracts
//! with a single tolerance of their own state it beside the assertion.

/// Fast path against the naive twin in f64, relative to the largest value.
pub(crate) const FAST_AGAINST_NAIVE_F64: f64 = 1e-13;

/// Gradients of the fast path against the naive twin's in f64, relative to the largest of the group.
///
/// The twin subtracts positions of size 5 to get offsets of size 0.05, and sums in another order.
pub(crate) const GRADIENT_FAST_AGAINST_NAIVE_F64: f64 = 1e-11;

/// Raw gradients against central differences in f64 with a step of 1e-5, whose own error is near 1e-9.
pub(crate) const GRADIENT_RAW_AGAINST_DIFFERENCES: f64 = 1e-8;

/// ⟨Ax, y⟩ against ⟨x, Aᵀy⟩ for densities in f64, relative to ‖Ax‖·‖y‖.
///
/// Both sides add the same products in different orders. Measured: 1.5e-16.
pub(crate) const ADJOINT_F64: f64 = 2e-15;

/// The same in f32. Measured: 5.5e-9; single roundings of 6e-8 mostly cancel.
pub(crate) const ADJOINT_F32: f64 = 3e-8;

/// Single entries of the matrix against the transpose's in f64, relative.
///
/// The derivative uses the power -q-1 and multiplies by 1+x. Measured: 1.3e-14.
pub(crate) const ADJOINT_ENTRY_F64: f64 = 1e-13;

/// Extrapolated differences along one direction through all parameters against the gradient.
///
/// Relative to ‖Jx‖·‖y‖. Steps are 1e-3 and 5e-4 of the parameters; the error is of order h⁴. Measured: 5e-11.
pub(crate) const DIRECTIONAL_DERIVATIVE: f64 = 5e-10;

/// Central differences against gradients in f64, root mean square over a group, relative.
///
/// The step is 2e-5 of a parameter's size; half of the error is the step's, half the rounding of the loss. Measured:
/// 2.1e-9.
pub(crate) const GRADIENT_AGAINST_DIFFERENCES: f64 = 1e-8;

/// Ratio of central-difference errors when the step falls to a tenth (second order).
///
/// Measured: 95 to 102.
pub(crate) const SECOND_ORDER: std::ops::Range<f64> = 90.0..111.0;

/// Errors below this are due to rounding, where a loss is linear in a group. Measured: 5.9e-12.
pub(crate) const DIFFERENCE_ROUNDING: f64 = 3e-11;

/// The derivative along a quaternion's own direction, relative to its terms. Measured: 1.7e-16.
pub(crate) const RADIAL_DERIVATIVE: f64 = 1e-15;

/// Images and volumes computed at two places of the geometry, f64, relative to the peak.
///
/// Rotating and scaling rounds the means by 1e-16 of a distance of 5, at a kernel scale of 0.03. Measured: 5.8e-15.
pub(crate) const INVARIANCE_F64: f64 = 2e-14;

/// Deviation of the approach to the Gaussian from 1/ν, as a factor. Measured: 0.99 to 1.00.
pub(crate) const LARGE_NU_RATE: std::ops::Range<f64> = 0.97..1.03;

/// Deviation of the approach to the parallel beam from 1/DSO, as a factor. Measured: 1.00.
pub(crate) const FAR_SOURCE_RATE: std::ops::Range<f64> = 0.97..1.03;

/// One field in two representations, f64, relative to the peak. Measured: 1.4e-15.
pub(crate) const REPRESENTATION_F64: f64 = 5e-15;

/// The same in f32. Measured: 5.0e-7, where each of 17 primitives is the sum of five parts.
pub(crate) const REPRESENTATION_F32: f64 = 1e-6;

/// Pixels computed in other lanes or with another lane width in f64, relative to the peak.
///
/// The distance of a column from the centre is exact unless the centre is near column 0. Measured: 1.5e-16.
pub(crate) const OTHER_WIDTH_F64: f64 = 1e-15;

/// The same in f32, where that distance is computed in f64. Measured: 0.
pub(crate) const OTHER_WIDTH_F32: f64 = 1e-7;

/// Fast path against the naive twin in f64, for random primitives with axes up to 1:25.
///
/// Relative to the largest value (at least 1e-6). Measured: 9.5e-15.
pub(crate) const RANDOM_FAST_AGAINST_NAIVE_F64: f64 = 5e-14;
