//! Which kernels a precision has: chosen outside of the loop over primitives, compiled once.

use super::Projection;
use super::canvas::{Blocks, Canvas};
use super::kernel::{self, Scratch, Sums};
use super::patch::{Patch, Slim};
use super::solid::Placed;
use crate::numeric::Real;
use crate::primitives::KernelKind;

/// The kernels for a profile and a projection.
pub struct KernelPair<R: Real> {
    pub(super) forward: fn(&Patch, &mut Canvas<R>, &mut Scratch<R::Lanes>),
    pub(super) backward: fn(&Patch, &Canvas<R>, &mut Scratch<R::Lanes>) -> Sums,
    pub(super) solid: Solids<R>,
}

/// The kernels for volumes, where the projection does not matter.
pub(super) struct Solids<R: Real> {
    pub(super) forward: for<'a> fn(&Placed<'a>, &mut Blocks<R>, &mut Scratch<R::Lanes>),
    pub(super) backward: for<'a> fn(&Placed<'a>, &Blocks<R>, &mut Scratch<R::Lanes>) -> Sums,
}

impl<R: Real> KernelPair<R> {
    fn new(kernel: KernelKind, projection: Projection) -> Self {
        match (kernel, projection) {
            (KernelKind::StudentT, Projection::Exact) => Self::of::<true, true>(),
            (KernelKind::StudentT, Projection::Affine) => Self::of::<true, false>(),
            (KernelKind::Gaussian, Projection::Exact) => Self::of::<false, true>(),
            (KernelKind::Gaussian, Projection::Affine) => Self::of::<false, false>(),
        }
    }

    fn of<const STUDENT: bool, const EXACT: bool>() -> Self {
        Self {
            forward: |patch, canvas, scratch| {
                if patch.is_slim::<R>() {
                    kernel::forward::<R, _, STUDENT, EXACT>(&Slim(patch), canvas, scratch);
                } else {
                    kernel::forward::<R, _, STUDENT, EXACT>(patch, canvas, scratch);
                }
            },
            backward: |patch, canvas, scratch| {
                if patch.is_slim::<R>() {
                    kernel::backward::<R, _, STUDENT, EXACT>(&Slim(patch), canvas, scratch)
                } else {
                    kernel::backward::<R, _, STUDENT, EXACT>(patch, canvas, scratch)
                }
            },
            solid: Solids {
                forward: |placed, blocks, scratch| kernel::forward::<R, _, STUDENT, false>(placed, blocks, scratch),
                backward: |placed, blocks, scratch| kernel::backward::<R, _, STUDENT, false>(placed, blocks, scratch),
            },
        }
    }
}

/// A scalar that pixels and voxels can be computed in.
///
/// The kernels of f32 and f64 are compiled here, once, and not again in every crate that projects something. Another
/// scalar gets its own where it implements this: `impl Kernels for MyScalar {}`.
pub trait Kernels: Real {
    /// The kernels for a profile and a projection.
    fn kernels(kernel: KernelKind, projection: Projection) -> KernelPair<Self> {
        KernelPair::new(kernel, projection)
    }
}

impl Kernels for f32 {
    #[inline(never)]
    fn kernels(kernel: KernelKind, projection: Projection) -> KernelPair<Self> {
        KernelPair::new(kernel, projection)
    }
}

impl Kernels for f64 {
    #[inline(never)]
    fn kernels(kernel: KernelKind, projection: Projection) -> KernelPair<Self> {
        KernelPair::new(kernel, projection)
    }
}
