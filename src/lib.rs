//! **trgs** reconstructs a CT volume from few X-ray projections as a sum of Student's t-kernels.

pub mod classical;
pub mod config;
pub mod error;
pub mod evaluation;
pub mod loss;
pub mod numeric;
pub mod optim;
pub mod output;
pub mod primitives;
pub mod projector;
pub mod provenance;
pub mod report;
pub mod scene;
pub mod train;

pub use error::{Error, Result};
