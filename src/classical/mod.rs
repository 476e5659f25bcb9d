//! Reconstruction without primitives, on the same scanner: what every scan can be compared with.

pub mod fdk;

pub use fdk::{Window, fdk};
