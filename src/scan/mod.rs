//! Scan data: geometry, volumes, projections, phantoms, noise and file formats.

pub mod air;
pub mod array_path;
pub mod borders;
pub mod corrections;
pub mod dataset;
pub mod frame;
// Test builds include it without the feature, so that one test build covers it.
#[cfg(any(feature = "hdf5", test))]
pub mod hdf5;
pub mod hounsfield;
pub mod intensities;
pub mod interpolant;
pub mod model;
pub mod noise;
pub mod npy;
pub mod npz;
pub mod phantom;
pub mod pixels;
pub mod plausibility;
pub mod simulate;
pub mod stack;
pub mod trace;
pub mod trajectory;
pub mod trilinear;
pub mod truncation;
pub mod volume_file;

pub use air::Air;
pub use corrections::Corrections;
pub use dataset::Dataset;
pub use frame::{Frame, Unit};
pub use interpolant::interpolant;
pub use noise::Noise;
pub use phantom::Phantom;
