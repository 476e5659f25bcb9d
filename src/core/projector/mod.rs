//! From primitives to projections and volumes, and the gradients back.
//!
//! The pipeline is whiten → project → conic → bin → rasterise:
//!
//! | step | where | paper |
//! |---|---|---|
//! | whiten: the whitening matrix and kernel constants of each primitive | `whitened` | `[Eq. 3]`, `[Eq. 5]` |
//! | project: a primitive in one view, or on a grid, and its support | `image/footprint`, `volume/ellipsoid` | `[Eq. 4]`, `[X1]`, `[X2]` |
//! | conic: the quadratic form as a sum of squares on pixels or voxels | `kernel/conic` | `[Eq. 4]`, `[X1]` |
//! | bin: footprints by bands of rows, primitives by chunks | `image/view`, `volume/voxelizer` | |
//! | rasterise: columns of SIMD registers, values and moments | `kernel` | `[Eq. 2]`, `[Eq. 4]`, `[X1]`, `[X3]` |
//!
//! The gradient runs through the same steps in reverse. Besides the pipeline:
//!
//! | | where | paper |
//! |---|---|---|
//! | the field, and functions from primitives to arrays | `field` | `[Eq. 1]` |
//! | the contribution of each primitive to one pixel or voxel | `contributions` | `[Eq. 1]` |
//! | the part of the SIMD lanes that is within supports | `utilisation` | |
//! | the profile alone, by the same kernel | `image/profile` | `[Eq. 2]` |
//! | the equations as plainly as they can be written | [`naive`] | `[Eq. 1]`–`[Eq. 5]`, `[X1]` |
//!
//! A pixel sums its primitives in index order, a primitive its pixels in a fixed tree: no bit depends on threads.
//! Per-primitive setup is vectorised over 8 primitives; results are bit-identical to the scalar path.

mod contributions;
mod field;
mod image;
mod kernel;
mod kernels;
pub mod naive;
mod projection;
mod utilisation;
mod volume;
mod whitened;

pub use contributions::{Contribution, rank};
#[doc(hidden)]
pub use field::bytes;
pub use field::{Field, forward, forward_seen, motion_vjp, vjp, voxelize, voxelize_vjp};
pub use image::kernels::ImageKernels;
pub use image::profile::profile;
pub use image::view::ViewField;
pub use kernels::Kernels;
pub use projection::Projection;
pub use utilisation::LaneUtilisation;
pub use volume::kernels::VolumeKernels;
pub use volume::voxelizer::GridField;
pub use whitened::FieldGradient;
