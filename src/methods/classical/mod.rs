//! Reconstruction on voxels, on the same scanner: the methods that every scan can be compared with.

pub mod algebraic;
mod columns;
pub mod density_unit;
pub mod fdk;
pub mod geometry_check;
pub mod pseudo_truth;
mod resample;
pub mod voxel_projector;

pub use density_unit::density_unit;
pub use fdk::{Turn, Window, fdk};
pub use geometry_check::check_geometry;
pub use pseudo_truth::with_pseudo_truth;
pub use voxel_projector::{RayModel, VoxelProjector};
