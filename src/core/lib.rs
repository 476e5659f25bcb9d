//! **trgs-core**: the equations of TR-GS (*High-Fidelity Sparse-View CT Volumetric Rendering via t-Distribution Gaussian
//! Splatting and Ray-Confidence Modeling*, MM '26, doi 10.1145/3767308.3835527) and what they stand on, for the CPU, with
//! SIMD. It reads no files and knows no method: the package `trgs` trains and reconstructs with it. The same input gives
//! the same bits on every build and any number of threads.
//!
//! A primitive, its image, and a gradient of the image back to its parameters:
//!
//! ```
//! use trgs_core::{Parameters, Primitives, Projection, Scanner, forward, vjp};
//!
//! let primitives = Primitives::new(Parameters {
//!     mean: vec![[0.1, -0.2, 0.3]],
//!     scale: vec![[0.2, 0.1, 0.15]],
//!     quaternion: vec![[1.0, 0.0, 0.0, 0.0]],
//!     density: vec![1.0],
//!     nu: vec![5.0],
//! })?;
//! let scanner = Scanner::synthetic(16, 24);
//! let images = forward::<f64>(&primitives, &scanner, &[0.0], Projection::Exact, 0.0);
//! assert_eq!(images.dim(), (1, 24, 24));
//! let gradient = vjp(&primitives, &scanner, &[0.0], Projection::Exact, 0.0, images.view());
//! // The images are linear in the density: half the sum of squares has the gradient Σ p².
//! let squares: f64 = images.iter().map(|pixel| pixel * pixel).sum();
//! assert!((gradient.density[0] / squares - 1.0).abs() < 1e-12);
//! # Ok::<(), trgs_core::Error>(())
//! ```
//!
//! # Modules, in reading order
//!
//! | module | content | paper |
//! |---|---|---|
//! | [`geometry`] | **the conventions**: every axis, sign, unit and index order; volumes and projections | |
//! | [`primitives`] | the kernels, raw and physical parameters, initialisation | Sec. 3.1, Eq. 1–3 |
//! | [`projector`] | primitives → images and volumes, and the gradients back | Sec. 3.1, Eq. 4–5, appendix A |
//! | [`projector::naive`] | the same equations as plainly as they can be written | |
//! | [`confidence`] | how well the rays cover a primitive, and the ν that follows from it | Eq. 6–10 |
//! | [`loss`] | L1, D-SSIM, total variation | |
//! | [`wavelet`] | Haar transform of a block, confident neighbours, the loss on its detail | Sec. 3.3, Eq. 11–15 |
//! | [`optim`] | Adam, SGHMC, learning rates | Sec. 4.5 |
//! | [`density`] | density control: ADC, adding and recycling | Sec. 4.5 |
//! | [`numeric`] | scalars, lanes, sums, random numbers, threads | |
//!
//! Functions ending in `_into` write to an array of the caller and allocate nothing once it has the right size.
//!
//! Equation tags: `[Eq. n]` are the paper's; `[X1]` is the exact cone-beam projection, `[X2]` the support of a
//! primitive, `[X3]` the precision of its power, all three ours and explained in [`projector`].

#![forbid(unsafe_code)]

#[cfg(test)]
#[macro_use]
#[path = "../../tests/common/tolerances.rs"]
mod tolerances;

pub mod confidence;
pub mod density;
pub mod error;
pub mod geometry;
pub mod loss;
pub mod numeric;
pub mod optim;
pub mod primitives;
pub mod projector;
pub mod setting;
pub mod wavelet;
pub mod words;

pub use confidence::{Coverage, nu_loss, nu_target};
pub use error::{Error, Result};
pub use geometry::{Beam, Detector, Grid, Pose, Projections, Scanner, Volume};
pub use numeric::threads::install as with_threads;
pub use optim::{Adam, Sghmc};
pub use primitives::{Activation, KernelKind, Parameters, Primitives};
pub use projector::{Field, Projection, forward, vjp, voxelize, voxelize_vjp};
pub use wavelet::{route, wavelet_loss};
