//! **trgs** reconstructs a CT volume from few X-ray projections as a sum of Student's t-kernels.

pub mod config;
pub mod error;
pub mod loss;
pub mod numeric;
pub mod optim;
pub mod output;
pub mod primitives;
pub mod projector;
pub mod scene;

pub use error::{Error, Result};
