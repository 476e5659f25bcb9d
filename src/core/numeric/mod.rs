//! Scalars, SIMD lanes, sums, random numbers and threads. It does not depend on any other module.

pub mod elementary;
pub mod exponentials;
mod fused;
pub mod lanes;
mod polynomials;
pub mod rank;
mod real;
pub mod rearrange;
pub mod reduce;
pub mod rng;
pub mod threads;
pub mod vectors;

pub use lanes::{Lanes, ROOT_RANGES, WIDEST};
pub use real::{Precision, Real, real};
