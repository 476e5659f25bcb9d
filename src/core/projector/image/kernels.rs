//! The kernels for images: one is chosen per view, outside of the loop over primitives.

use super::placement::{PlacedFootprint, RowLayout};
use crate::numeric::Real;
use crate::primitives::KernelKind;
use crate::projector::kernel::buffers::PaddedImage;
use crate::projector::kernel::variants::{Affine, Exact, Gaussian, Profile, Rays, StudentT};
use crate::projector::kernel::{self, Scratch, Sums};
use crate::projector::projection::Projection;

/// The kernels for images with one profile and one projection.
pub struct ImageKernels<R: Real> {
    pub(crate) forward: fn(&PlacedFootprint, &mut PaddedImage<R>, &mut Scratch<R::Lanes>),
    pub(crate) vjp: fn(&PlacedFootprint, &PaddedImage<R>, &mut Scratch<R::Lanes>) -> Sums,
}

impl<R: Real> ImageKernels<R> {
    pub(crate) fn new(kernel: KernelKind, projection: Projection) -> Self {
        match (kernel, projection) {
            (KernelKind::StudentT, Projection::Exact) => Self::of::<StudentT, Exact>(),
            (KernelKind::StudentT, Projection::Affine) => Self::of::<StudentT, Affine>(),
            (KernelKind::Gaussian, Projection::Exact) => Self::of::<Gaussian, Exact>(),
            (KernelKind::Gaussian, Projection::Affine) => Self::of::<Gaussian, Affine>(),
        }
    }

    fn of<P: Profile, J: Rays>() -> Self {
        Self {
            forward: |footprint, image, scratch| {
                if footprint.fits_row_layout::<R>() {
                    kernel::forward::<R, _, P, J>(&RowLayout(footprint), image, scratch);
                } else {
                    kernel::forward::<R, _, P, J>(footprint, image, scratch);
                }
            },
            vjp: |footprint, image, scratch| {
                if footprint.fits_row_layout::<R>() {
                    kernel::vjp::<R, _, P, J>(&RowLayout(footprint), image, scratch)
                } else {
                    kernel::vjp::<R, _, P, J>(footprint, image, scratch)
                }
            },
        }
    }
}
