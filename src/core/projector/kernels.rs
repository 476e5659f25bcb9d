//! The kernels of a precision, compiled once.

use super::image::kernels::ImageKernels;
use super::projection::Projection;
use super::volume::kernels::VolumeKernels;
use crate::numeric::Real;
use crate::primitives::KernelKind;

/// A scalar that pixels and voxels can be computed in.
///
/// The kernels of f32 and f64 are compiled here, once, and not again in every crate that projects primitives. Another
/// scalar gets its own where it implements this: `impl Kernels for MyScalar {}`.
pub trait Kernels: Real {
    /// The kernels for images with a profile and a projection.
    fn image_kernels(kernel: KernelKind, projection: Projection) -> ImageKernels<Self> {
        ImageKernels::new(kernel, projection)
    }

    /// The kernels for volumes with a profile.
    fn volume_kernels(kernel: KernelKind) -> VolumeKernels<Self> {
        VolumeKernels::new(kernel)
    }
}

/// Functions that are not generic, so that other crates do not compile the kernels again.
macro_rules! compiled_here {
    ($($scalar:ty),*) => {
        $(impl Kernels for $scalar {
            #[inline(never)]
            fn image_kernels(kernel: KernelKind, projection: Projection) -> ImageKernels<Self> {
                ImageKernels::new(kernel, projection)
            }

            #[inline(never)]
            fn volume_kernels(kernel: KernelKind) -> VolumeKernels<Self> {
                VolumeKernels::new(kernel)
            }
        })*
    };
}

compiled_here!(f32, f64);
