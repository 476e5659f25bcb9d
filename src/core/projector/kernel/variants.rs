//! The variants of the kernel as marker types: the loops are compiled once for each combination.

/// The profile of the primitives.
pub(crate) trait Profile {
    /// Student's t; else the Gaussian, which needs no logarithm.
    const IS_STUDENT: bool;
}

/// `(1+x)^-q`.
pub(crate) struct StudentT;
/// `2^-x`.
pub(crate) struct Gaussian;

impl Profile for StudentT {
    const IS_STUDENT: bool = true;
}

impl Profile for Gaussian {
    const IS_STUDENT: bool = false;
}

/// The rays of the projection.
pub(crate) trait Rays {
    /// Each pixel has its own ray `[X1]`, so that e differs from 0.
    const ARE_EXACT: bool;
}

/// The rays of the exact projection.
pub(crate) struct Exact;
/// The parallel rays of the affine projection and of slices.
pub(crate) struct Affine;

impl Rays for Exact {
    const ARE_EXACT: bool = true;
}

impl Rays for Affine {
    const ARE_EXACT: bool = false;
}

/// The direction of a pass over the columns.
pub(crate) trait Pass {
    /// Moments are summed column by column, so that columns keep their z, x and end.
    const SUMS_MOMENTS: bool;
}

/// From a primitive to values.
pub(crate) struct Forward;
/// From a cotangent to a gradient.
pub(crate) struct Vjp;

impl Pass for Forward {
    const SUMS_MOMENTS: bool = false;
}

impl Pass for Vjp {
    const SUMS_MOMENTS: bool = true;
}
