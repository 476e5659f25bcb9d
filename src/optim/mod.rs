//! How parameters move. Knows arrays of numbers, no primitives' meaning.

pub mod adam;
pub mod schedule;
pub mod sghmc;

pub use adam::Adam;
pub use schedule::Exponential;
pub use sghmc::Sghmc;
