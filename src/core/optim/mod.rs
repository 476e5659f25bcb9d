//! Optimisers and learning rates. They work on arrays of numbers and do not depend on primitives.

pub mod adam;
pub mod schedule;
pub mod sghmc;

pub use adam::Adam;
pub use schedule::Exponential;
pub use sghmc::Sghmc;
