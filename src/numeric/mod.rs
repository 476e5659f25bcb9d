//! The ground: scalars, SIMD lanes, sums, random numbers and threads. Knows nothing of CT.

pub mod elementary;
pub mod lanes;
pub mod reduce;
pub mod rng;
pub mod threads;

pub use lanes::{Lanes, NEAR, Real, real};
