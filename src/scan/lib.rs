//! **trgs-scan**: scan data for TR-GS, on disk and made. Readers and writers of volumes, projections and models, datasets and
//! stacks of detector frames, phantoms with exact line integrals, noise, simulation, and checks of plausibility. The
//! geometry and the arrays are those of [`trgs_core::geometry`].
//!
//! | module | content |
//! |---|---|
//! | [`dataset`] | a scan: scanner, projections, true volume; the dataset folders of R²-Gaussian and the pickles of NAF |
//! | [`stack`], [`intensities`], [`corrections`], [`air`] | raw detector frames → line integrals |
//! | [`volume_file`], [`npy`], [`npz`], [`model`], [`frame`] | volumes, arrays and primitives in files; axes and units |
//! | [`phantom`], [`noise`], [`chain`], [`simulate`](mod@simulate), [`interpolant`](mod@interpolant) | scans of known objects |
//! | [`plausibility`], [`borders`], [`pixels`], [`truncation`], [`hounsfield`] | values that cannot be right |
//! | [`trilinear`], [`trajectory`], [`trace`] | a volume between its voxels; the path of the source |
//! | [`input`], [`output`], [`limit`], [`digest`] | opening of files, writing as a whole, the limit on memory, SHA-256 |

#![forbid(unsafe_code)]

#[cfg(test)]
#[path = "../../tests/contracts/damage.rs"]
mod damage;
#[cfg(test)]
#[macro_use]
#[path = "../../tests/common/tolerances.rs"]
mod tolerances;

pub mod air;
pub mod array_path;
pub mod borders;
pub mod chain;
mod content;
pub mod corrections;
pub mod dataset;
pub mod digest;
pub mod frame;
// Test builds include it without the feature, so that one test build covers it.
#[cfg(any(feature = "hdf5", test))]
pub mod hdf5;
pub mod hounsfield;
pub mod input;
pub mod intensities;
pub mod interpolant;
pub mod limit;
pub mod model;
pub mod noise;
pub mod npy;
pub mod npz;
pub mod output;
pub mod phantom;
pub mod pixels;
pub mod plausibility;
pub mod simulate;
pub mod stack;
pub mod surface;
pub mod trace;
pub mod trajectory;
pub mod trilinear;
pub mod truncation;
mod unit;
pub mod volume_file;

pub use air::Air;
pub use chain::Chain;
pub use corrections::Corrections;
pub use dataset::Dataset;
pub use frame::{Frame, write_volume};
pub use interpolant::interpolant;
pub use noise::Noise;
pub use phantom::Phantom;
pub use unit::Unit;
