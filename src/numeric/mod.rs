//! The ground: scalars, SIMD lanes, sums, random numbers and threads. Knows nothing of CT.

pub mod elementary;
pub mod exponentials;
pub mod lanes;
mod polynomials;
pub mod rearrange;
pub mod reduce;
pub mod rng;
pub mod threads;
pub mod vectors;

pub use lanes::{Lanes, ROOT_RANGES, Real, WIDEST, real};
