//! **trgs** reconstructs a CT volume from few X-ray projections, as a sum of Student's t-kernels. It is a reference
//! implementation of TR-GS (*High-Fidelity Sparse-View CT Volumetric Rendering via t-Distribution Gaussian Splatting
//! and Ray-Confidence Modeling*, MM '26, doi 10.1145/3767308.3835527): on the CPU, with SIMD, and with the same bits
//! for the same input on every build and any number of threads.
//!
//! # Where to find what, in reading order
//!
//! | module | what it holds | paper |
//! |---|---|---|
//! | [`scene::geometry`] | **the conventions**: every axis, sign, unit and index order | |
//! | [`scene`] | volumes, projections, phantoms with exact line integrals, noise, files | Sec. 4.1 |
//! | [`primitives`] | the kernels, raw and physical parameters, where they start | Sec. 3.1, Eq. 1–3 |
//! | [`projector`] | primitives → images and volumes, and the gradients back | Sec. 3.1, Eq. 4–5, appendix A |
//! | [`projector::naive`] | the same equations as plainly as they can be written | |
//! | [`confidence`] | how well the rays cover a primitive, and the ν that this entitles it to | Eq. 6–10 |
//! | [`loss`] | L1, D-SSIM, total variation | |
//! | [`wavelet`] | Haar transform of a block, confident neighbours, the loss on its detail | Sec. 3.3, Eq. 11–15 |
//! | [`optim`] | Adam, SGHMC, learning rates | Sec. 4.5 |
//! | [`density`] | how primitives come and go: ADC, adding & recycling | Sec. 4.5 |
//! | [`train`](mod@train) | the loop | Fig. 2 |
//! | [`classical`] | the projector of voxels and its adjoint; FDK, SART, ASD-POCS, CGLS | Sec. 4.1 |
//! | [`reconstruction`] | any method on any dataset | Sec. 4.1 |
//! | [`evaluation`] | metrics, each with the id of its definition | Sec. 4.1 |
//! | [`oracle`] | conformance vectors for other implementations: handed out, and answers judged | |
//! | [`experiments`] | the paper's tables as data, run and set beside the paper's figures | Sec. 4, appendix |
//! | [`config`], [`report`], [`provenance`], [`output`] | what a run is told, shows and leaves behind | |
//! | [`memory`] | what a run will need, before it starts | |
//! | [`numeric`] | the ground: scalars, lanes, sums, random numbers, threads | |
//!
//! Images, volumes and losses that are made again and again have a twin of their function, `…_into`, which fills an array that
//! is there and asks for no memory the second time.
//!
//! Equation tags: `[Eq. n]` are the paper's; `[X1]` is the exact cone-beam projection, `[X2]` the support of a
//! primitive, `[X3]` the precision of its power, all three ours and explained in [`projector`].

pub mod classical;
pub mod confidence;
pub mod config;
pub mod density;
pub mod error;
pub mod evaluation;
pub mod experiments;
pub mod loss;
pub mod memory;
pub mod numeric;
pub mod optim;
pub mod oracle;
pub mod output;
pub mod primitives;
pub mod projector;
pub mod provenance;
pub mod reconstruction;
pub mod report;
pub mod scene;
pub mod train;
pub mod wavelet;

pub use config::{Config, Method};
pub use error::{Error, Result};
pub use primitives::Primitives;
pub use projector::{Field, Projection};
pub use reconstruction::{evaluate, reconstruct};
pub use scene::{Dataset, Grid, Projections, Scanner, Volume};
