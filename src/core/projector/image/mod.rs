//! Images: projections, their supports and their gradients.

pub(super) mod footprint;
mod footprint_vjp;
pub(super) mod kernels;
mod outline;
pub(super) mod placement;
pub(super) mod profile;
pub(super) mod view;
