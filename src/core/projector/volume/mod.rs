//! Volumes: the field at voxel centres and its gradient.

pub(super) mod ellipsoid;
pub(super) mod kernels;
pub(super) mod voxelizer;
