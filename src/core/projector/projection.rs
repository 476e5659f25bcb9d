//! The projection model that the fast path and [`naive`](super::naive) share.

use crate::described;

described! {
    /// How a cone beam's rays are taken through a primitive. In a parallel beam both are the same.
    #[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
    #[serde(rename_all = "lowercase")]
    pub enum Projection {
        /// The line integral along every pixel's own ray `[X1]`.
        Exact,
        /// The paper's and R²-Gaussian's: all rays as if parallel to the one through the centre `[Eq. 4]`.
        Affine,
    }
}

/// Primitives whose centre is nearer to the source than this fraction of `dso`, or behind it, are left out.
pub(super) const MIN_DEPTH: f64 = 0.01;
