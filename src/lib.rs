//! **trgs** reconstructs a CT volume from few X-ray projections, as a sum of Student's t-kernels. It is a reference
//! implementation of TR-GS (*High-Fidelity Sparse-View CT Volumetric Rendering via t-Distribution Gaussian Splatting
//! and Ray-Confidence Modeling*, MM '26, doi 10.1145/3767308.3835527) for the CPU, with SIMD. The same input gives the
//! same bits on every build and any number of threads.
//!
//! [`Preset::Paper`] is the paper's method. The default adds exact rays in a cone
//! beam, a start from SART, a pilot run and a finish on voxels, which are ours. The equations alone are the package
//! `trgs-core`.
//!
//! # Usage
//!
//! From a scan on disk to a volume, with the settings and the result of the bare command `trgs reconstruct`:
//!
//! ```no_run
//! # fn main() -> trgs::Result<()> {
//! let scan = trgs::Dataset::read("scan")?;
//! let result = trgs::reconstruct(&scan, &trgs::Config::default())?;
//! trgs::write_volume("volume.nii.gz", &result.volume, &scan.frame)?;
//! # Ok(())
//! # }
//! ```
//!
//! A simulated scan, a short run that reports its progress, and its quality:
//!
//! ```
//! use std::ops::ControlFlow;
//! use trgs::scan::simulate::{Object, Plan, simulate};
//! use trgs::scan::{Noise, Phantom};
//! use trgs::{Config, Run, Scanner};
//!
//! let phantom = Phantom::by_name("torso", 0)?;
//! let plan = Plan { views: 6, test_views: 0, noise: Noise::None, seed: 0 };
//! let scan = simulate("torso", Object::Phantom(&phantom), &Scanner::synthetic(16, 24), &plan)?;
//!
//! let mut config = Config::default();
//! config.iterations = 20;
//! config.set("model.points=200")?;
//! let mut steps = 0;
//! let run = Run::new(&scan, &config).observe(|_progress| {
//!     steps += 1;
//!     ControlFlow::Continue(())
//! });
//! let result = run.reconstruct()?;
//!
//! let quality = trgs::evaluate(&scan, &result.volume, result.primitives.as_ref(), &config)?;
//! assert!(steps > 20 && quality.metrics.psnr_3d.unwrap().value > 15.0);
//! # Ok::<(), trgs::Error>(())
//! ```
//!
//! Images of given primitives, and the gradient of a loss on them:
//!
//! ```
//! use trgs::{Parameters, Primitives, Projection, Scanner, forward, vjp};
//!
//! let primitives = Primitives::new(Parameters {
//!     mean: vec![[0.1, -0.2, 0.3]],
//!     scale: vec![[0.2, 0.1, 0.15]],
//!     quaternion: vec![[1.0, 0.0, 0.0, 0.0]],
//!     density: vec![1.0],
//!     nu: vec![5.0],
//! })?;
//! let scanner = Scanner::synthetic(16, 24);
//! let images = forward::<f64>(&primitives, &scanner, &[0.0, 1.0], Projection::Exact, 0.0);
//! let gradient = vjp(&primitives, &scanner, &[0.0, 1.0], Projection::Exact, 0.0, images.view());
//! assert!(gradient.density[0] > 0.0);
//! # Ok::<(), trgs::Error>(())
//! ```
//!
//! A trained model as a volume on a finer grid:
//!
//! ```no_run
//! # fn main() -> trgs::Result<()> {
//! let model = trgs::read_model("run/model.npz")?;
//! let grid = trgs::Grid::cube(256);
//! let values = trgs::voxelize::<f32>(&model, &grid, 0.0);
//! trgs::write_volume("fine.nii.gz", &trgs::Volume::new(grid, values)?, &trgs::Frame::default())?;
//! # Ok(())
//! # }
//! ```
//!
//! [`Dataset::read`] takes a dataset folder of R²-Gaussian or a pickle of NAF; [`scan::stack`] turns raw detector frames
//! into projections. [`Config`] documents every setting. The programs in `reference/examples` show reconstruction,
//! rendering with gradients, and FDK.
//!
//! # Features
//!
//! All are on by default except `dicom` and `hdf5`; `default-features = false` leaves the library alone.
//!
//! | feature | adds |
//! |---|---|
//! | `cli` | the program `trgs` |
//! | `oracle` | the module `oracle`: the judge of other implementations, with conformance vectors from a folder |
//! | `vectors` | these vectors are built in |
//! | `plots` | plots on the pages of the paper's tables |
//! | `dicom` | the reader of DICOM series |
//! | `hdf5` | the reader of HDF5, NeXus and MATLAB 7.3 |
//!
//! # Limits
//!
//! - A scan has a cone beam or a parallel beam and a flat detector, on a circle or with a pose for each view; FDK takes
//!   circles alone.
//! - Everything runs on the CPU, in f32 or f64. A run at the paper's size takes about an hour on two cores.
//! - The library uses the global thread pool of rayon; [`numeric::threads`] sets the number of threads.
//!
//! # Modules, in reading order
//!
//! The names at the root are those that a program needs first; the modules have the rest.
//!
//! | module | content | paper |
//! |---|---|---|
//! | [`geometry`] | **the conventions**: every axis, sign, unit and index order | |
//! | [`scan`] | phantoms with exact line integrals, noise, files | Sec. 4.1 |
//! | [`primitives`] | the kernels, raw and physical parameters, initialisation | Sec. 3.1, Eq. 1–3 |
//! | [`projector`] | primitives → images and volumes, and the gradients back | Sec. 3.1, Eq. 4–5, appendix A |
//! | [`projector::naive`] | the same equations as plainly as they can be written | |
//! | [`confidence`] | how well the rays cover a primitive, and the ν that follows from it | Eq. 6–10 |
//! | [`loss`] | L1, D-SSIM, total variation | |
//! | [`wavelet`] | Haar transform of a block, confident neighbours, the loss on its detail | Sec. 3.3, Eq. 11–15 |
//! | [`optim`] | Adam, SGHMC, learning rates | Sec. 4.5 |
//! | [`density`] | density control: ADC, adding and recycling | Sec. 4.5 |
//! | [`train`](mod@train) | the training loop | Fig. 2 |
//! | [`classical`] | the projector of voxels and its adjoint; FDK, SART, ASD-POCS, CGLS, total variation | Sec. 4.1 |
//! | [`neural`] | NAF, SAX-NeRF, IntraTomo | Sec. 4.1 |
//! | [`reconstruction`] | any method on any dataset | Sec. 4.1 |
//! | [`evaluation`] | metrics, each with the id of its definition | Sec. 4.1 |
//! | `oracle` | conformance vectors for other implementations, and the judge of their answers | |
//! | [`experiments`] | the paper's tables as data, run and set beside the paper's figures | Sec. 4, appendix |
//! | [`config`], [`setting`] | settings of a run, and those besides the configuration | |
//! | [`memory`] | an upper bound on the memory of a run | |
//! | [`numeric`] | scalars, lanes, sums, random numbers, threads | |
//!
//! Functions ending in `_into` write to an array of the caller and allocate nothing once it has the right size.
//!
//! Equation tags: `[Eq. n]` are the paper's; `[X1]` is the exact cone-beam projection, `[X2]` the support of a
//! primitive, `[X3]` the precision of its power, all three ours and explained in [`projector`].

#![forbid(unsafe_code)]

#[cfg(test)]
#[macro_use]
#[path = "../tests/common/tolerances.rs"]
mod tolerances;

// Names of the library in the modules of the program.
#[cfg(feature = "cli")]
extern crate self as trgs;

#[cfg(feature = "cli")]
#[doc(hidden)]
pub mod cli;
pub mod config;
pub mod experiments;
pub mod memory;
pub mod reconstruction;
mod sealed;
pub mod train;

pub use config::{Config, Method, Precision, Preset};
pub use reconstruction::{Checkpoints, Progress, Reconstruction, Run, evaluate, reconstruct};
pub use trgs_core::geometry::{Beam, Detector, Grid, Projections, Scanner, Volume};
pub use trgs_core::primitives::{KernelKind, Parameters, Primitives};
pub use trgs_core::projector::{Field, Projection, forward, vjp, voxelize, voxelize_vjp};
pub use trgs_core::setting::{Setting, Text};
pub use trgs_core::{Error, Result};
pub use trgs_scan::model::{read as read_model, write as write_model};
pub use trgs_scan::volume_file::read as read_volume;
pub use trgs_scan::{Dataset, Frame, Noise, Phantom, write_volume};

pub use trgs_core::{confidence, density, geometry, loss, numeric, optim, primitives, projector, setting, wavelet};
pub use trgs_methods::{classical, evaluation, neural};
#[cfg(feature = "oracle")]
pub use trgs_oracle as oracle;
pub use trgs_scan as scan;

// Parts of the program and of the packages beside this one.
#[doc(hidden)]
pub mod duration;
#[doc(hidden)]
pub mod provenance;
#[doc(hidden)]
pub mod report;
#[doc(hidden)]
pub use trgs_core::{error, in_precision, words};
#[doc(hidden)]
pub use trgs_scan::{input, limit, output};
