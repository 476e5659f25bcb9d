//! **The table of tolerances.** No other test file holds one. Each row says why it is what it is and what was measured.

/// Projections and densities against 50-digit quadrature, relative, at every pixel however far from the centre.
/// A skirt at 10^-47 of the peak carries an exponent of 108, whose last bit alone is 1e-14.
/// Measured: 3.9e-13 (wide-gaussian), 2.5e-13 (pancake), 1.3e-13 (needle), 1e-13 elsewhere.
pub(crate) const VALUE_AGAINST_TRUTH_F64: f64 = 1e-12;

/// The same in single precision, relative to the peak: the largest pixel, or the density at the densest centre.
/// Measured: 2.1e-7 (nu-1).
pub(crate) const VALUE_AGAINST_TRUTH_F32: f64 = 1e-6;

/// Gradients against 50-digit central differences, elementwise, relative to the largest entry of their group.
/// Measured: 1.3e-10 (pancake), 3.1e-11 (needle), 5.5e-12 elsewhere.
pub(crate) const GRADIENT_AGAINST_TRUTH_F64: f64 = 1e-9;

/// The same in single precision, for a case and a group of parameters. Measured: 1.3e-6, and at each exception.
pub(crate) fn gradient_against_truth_f32(case: &str, group: &str) -> f64 {
    match (case, group) {
        // 1:1000: a pixel is tens of standard deviations across, and the coordinate of its centre has 24 bits. 1.3e-4.
        ("needle" | "pancake", _) => 3e-4,
        // ∂/∂ν is the difference of two sums that agree to 1/ν, and the gradient itself falls like 1/ν². 6e-5, 2.9e-3.
        ("nu-1e3", "nu") => 2e-4,
        ("nu-1e4", "nu") => 6e-3,
        // The same difference at ν ≈ 10, and a cotangent that cancels besides. 4.0e-6.
        (_, "nu") => 1e-5,
        _ => 3e-6,
    }
}

/// Fast path against the naive twin in f64, relative to the largest value.
pub(crate) const FAST_AGAINST_NAIVE_F64: f64 = 1e-13;

/// Gradients of the fast path against the naive twin's in f64, relative to the largest of the group. The twin
/// subtracts positions of size 5 to get offsets of size 0.05 and sums in another order.
pub(crate) const GRADIENT_FAST_AGAINST_NAIVE_F64: f64 = 1e-11;

/// Raw gradients against central differences in f64 with a step of 1e-5: their own error is near 1e-9.
pub(crate) const GRADIENT_RAW_AGAINST_DIFFERENCES: f64 = 1e-8;
