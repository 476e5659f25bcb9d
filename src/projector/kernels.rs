//! Which kernels a precision has: chosen outside of the loop over primitives, compiled once.

use super::Projection;
use super::kernel::{self, Canvas, Scratch, Slice, Sums};
use crate::numeric::Real;
use crate::primitives::Kernel;
use std::ops::Range;

pub(super) type Forward<R> = fn(&[Slice], Range<usize>, &mut Canvas<R>, &mut Scratch<<R as Real>::Lanes>);
type Backward<R> = fn(&[Slice], Range<usize>, &Canvas<R>, &mut Scratch<<R as Real>::Lanes>) -> Sums;

/// The kernels for a profile and a projection.
pub struct KernelPair<R: Real> {
    pub(super) forward: Forward<R>,
    pub(super) backward: Backward<R>,
    /// Backward with the moments that solids need.
    pub(super) solid: Backward<R>,
}

impl<R: Real> KernelPair<R> {
    fn new(kernel: Kernel, projection: Projection) -> Self {
        match (kernel, projection) {
            (Kernel::StudentT, Projection::Exact) => Self::of::<true, true>(),
            (Kernel::StudentT, Projection::Affine) => Self::of::<true, false>(),
            (Kernel::Gaussian, Projection::Exact) => Self::of::<false, true>(),
            (Kernel::Gaussian, Projection::Affine) => Self::of::<false, false>(),
        }
    }

    fn of<const STUDENT: bool, const EXACT: bool>() -> Self {
        Self {
            forward: kernel::forward::<R, STUDENT, EXACT>,
            backward: kernel::backward::<R, STUDENT, EXACT, false>,
            solid: kernel::backward::<R, STUDENT, false, true>,
        }
    }
}

/// A scalar that pixels and voxels can be computed in.
///
/// The kernels of f32 and f64 are compiled here, once, and not again in every crate that projects something. Another
/// scalar gets its own where it implements this: `impl Kernels for MyScalar {}`.
pub trait Kernels: Real {
    /// The kernels for a profile and a projection.
    fn kernels(kernel: Kernel, projection: Projection) -> KernelPair<Self> {
        KernelPair::new(kernel, projection)
    }
}

impl Kernels for f32 {
    #[inline(never)]
    fn kernels(kernel: Kernel, projection: Projection) -> KernelPair<Self> {
        KernelPair::new(kernel, projection)
    }
}

impl Kernels for f64 {
    #[inline(never)]
    fn kernels(kernel: Kernel, projection: Projection) -> KernelPair<Self> {
        KernelPair::new(kernel, projection)
    }
}
