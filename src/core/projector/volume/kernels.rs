//! The kernels for volumes: one is chosen per grid, outside of the loop over primitives.

use super::ellipsoid::EllipsoidInRegion;
use crate::numeric::Real;
use crate::primitives::KernelKind;
use crate::projector::kernel::buffers::BrickedVolume;
use crate::projector::kernel::variants::{Affine, Gaussian, Profile, StudentT};
use crate::projector::kernel::{self, Scratch, Sums};

/// The kernels for volumes with one profile.
pub struct VolumeKernels<R: Real> {
    pub(crate) forward: for<'a> fn(&EllipsoidInRegion<'a>, &mut BrickedVolume<R>, &mut Scratch<R::Lanes>),
    pub(crate) vjp: for<'a> fn(&EllipsoidInRegion<'a>, &BrickedVolume<R>, &mut Scratch<R::Lanes>) -> Sums,
}

impl<R: Real> VolumeKernels<R> {
    pub(crate) fn new(kernel: KernelKind) -> Self {
        match kernel {
            KernelKind::StudentT => Self::of::<StudentT>(),
            KernelKind::Gaussian => Self::of::<Gaussian>(),
        }
    }

    /// In a slice e is 0, as in the affine projection.
    fn of<P: Profile>() -> Self {
        Self {
            forward: |ellipsoid, volume, scratch| {
                kernel::forward::<R, _, P, Affine>(ellipsoid, volume, scratch);
            },
            vjp: |ellipsoid, volume, scratch| kernel::vjp::<R, _, P, Affine>(ellipsoid, volume, scratch),
        }
    }
}
