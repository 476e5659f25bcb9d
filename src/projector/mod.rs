//! From primitives to projections and volumes, and back with gradients.
//!
//! | step | where | paper |
//! |---|---|---|
//! | whitening matrix, kernel constants | `shape` | `[Eq. 3]`, `[Eq. 5]` |
//! | quadratic form on the detector, support | `footprint`, `extents` | `[Eq. 4]`, `[X1]`, `[X2]` |
//! | pixels, SIMD | `kernel`, `queue`, `column` | `[Eq. 4]`, `[X1]`, `[X3]` |
//! | registers that hold pixels or voxels of the support | `outline`, `patch`, `solid` | `[X2]` |
//! | images and volumes as the kernels have them | `canvas` | |
//! | images band by band, gradients primitive by primitive | `view` | |
//! | voxels and their adjoint | `voxelizer` | `[Eq. 1]`, `[Eq. 2]` |
//! | what each primitive adds to one pixel or voxel | `contributions` | `[Eq. 1]` |
//! | the kernel alone, by the same lanes | `profile` | `[Eq. 2]` |
//! | the same, as plainly as it can be written | [`naive`] | `[Eq. 1]`–`[Eq. 5]`, `[X1]` |
//!
//! A pixel adds up its primitives in index order, a primitive its pixels in a fixed tree: no bit depends on threads.
//! What is done once per primitive and view or grid (footprints, solids, the ways back from sums) is done for eight at a
//! time, one in each lane of [`vectors`](crate::numeric::vectors), with the bits that one alone would have.

mod canvas;
mod column;
mod contributions;
mod extents;
mod footprint;
mod kernel;
mod kernels;
pub mod naive;
mod outline;
mod pairs;
mod patch;
mod plane;
mod profile;
mod queue;
mod shape;
mod solid;
mod view;
mod voxelizer;

pub use contributions::{Contribution, rank};
pub use kernels::{KernelPair, Kernels};
pub use pairs::Pairs;
pub use profile::profile;
pub use view::ViewField;
pub use voxelizer::GridField;

use crate::numeric::Real;
use crate::numeric::threads::{self, Lent, Spares};
use crate::primitives::{Kernel, Parameters, Primitives};
use crate::scene::{Grid, Scanner};
use canvas::{Blocks, Canvas};
use footprint::Footprint;
use glam::DVec3;
use kernel::Scratch;
use ndarray::{Array3, ArrayView3, Axis};
use patch::Patch;
use shape::{Shape, ShapeGradient};

/// Bytes of a primitive in each role, for the estimate of a run's memory.
pub(crate) mod bytes {
    /// In a field.
    pub(crate) const FIELD: usize = size_of::<super::Shape>();
    /// In its gradient.
    pub(crate) const GRADIENT: usize = size_of::<super::ShapeGradient>();
    /// In a view.
    pub(crate) const VIEW: usize = size_of::<super::footprint::Footprint>();
    /// On a grid.
    pub(crate) const GRID: usize = size_of::<(usize, super::solid::Solid)>();
}

/// How a cone beam's rays are taken through a primitive. In a parallel beam both are the same.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize, documented::DocumentedVariants)]
#[serde(rename_all = "lowercase")]
pub enum Projection {
    /// The line integral along every pixel's own ray `[X1]`.
    Exact,
    /// The paper's and R²-Gaussian's: all rays as if parallel to the one through the centre `[Eq. 4]`.
    Affine,
}

/// The density field f(x) = Σ ρT `[Eq. 1]`: primitives prepared for kernels that run in `R`.
pub struct Field<R: Real> {
    kernel: Kernel,
    cutoff: f64,
    shapes: Vec<Shape>,
    spaces: Spaces<R>,
}

/// What the views and grids of a field are made of and work in. It stays when they go, so that whoever keeps a field and
/// [renews](Field::renew) it asks the system for no more memory.
#[derive(Default)]
struct Spaces<R: Real> {
    footprints: Spares<Vec<Footprint>>,
    members: Spares<Vec<view::Members>>,
    canvases: Spares<Canvas<R>>,
    fetched: Spares<Vec<Patch>>,
    solids: Spares<Vec<voxelizer::Chunk>>,
    blocks: Spares<Blocks<R>>,
    scratch: Spares<Scratch<R::Lanes>>,
    gradients: Spares<FieldGradient>,
}

/// A gradient to a [`Field`], summed over any number of views and volumes.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct FieldGradient {
    shapes: Vec<ShapeGradient>,
}

impl FieldGradient {
    /// Adds another gradient to the same field.
    pub(crate) fn add(&mut self, other: &Self) {
        assert_eq!(self.shapes.len(), other.shapes.len(), "primitives of the gradients");
        threads::for_each_chunk(&mut self.shapes, shape::CHUNK, |chunk, gradients| {
            let others = &other.shapes[chunk * shape::CHUNK..];
            gradients.iter_mut().zip(others).for_each(|(gradient, other)| gradient.add(other));
        });
    }

    /// Leaves out what would move centres.
    pub(crate) fn hold_centres(&mut self) {
        self.shapes.iter_mut().for_each(|gradient| gradient.mean = DVec3::ZERO);
    }

    /// The gradient to each centre's shadow on the detector, everything else held, `[∂/∂û, ∂/∂v̂]`: û and v̂ run from -1
    /// to 1 over the detector. Summed over the views that were pulled back; volumes add nothing. It is what density
    /// control by gradients measures. Not in the paper: units and meaning are R²-Gaussian's.
    pub fn shadows(&self) -> impl Iterator<Item = [f64; 2]> {
        self.shapes.iter().map(|shape| shape.shadow.to_array())
    }
}

impl<R: Kernels> Field<R> {
    /// Prepares primitives. A primitive is cut off where its projection has fallen to `cutoff` of its peak (0: nowhere).
    pub fn new(primitives: &Primitives, cutoff: f64) -> Self {
        let mut field = Self { kernel: primitives.kernel, cutoff, shapes: Vec::new(), spaces: Spaces::default() };
        field.renew(primitives);
        field
    }

    /// The field of other primitives with the same cutoff, in the same memory.
    pub fn renew(&mut self, primitives: &Primitives) {
        self.kernel = primitives.kernel;
        Shape::all_into::<R>(&mut self.shapes, primitives, self.cutoff);
    }

    /// The field as a view sees it.
    pub fn view(&self, scanner: &Scanner, angle: f64, projection: Projection) -> ViewField<'_, R> {
        ViewField::new(self, scanner, angle, projection)
    }

    /// A gradient of zeros.
    pub fn zero_gradient(&self) -> FieldGradient {
        FieldGradient { shapes: vec![ShapeGradient::ZERO; self.shapes.len()] }
    }

    /// A gradient of zeros in memory that the field gets back.
    pub(crate) fn lend_gradient(&self) -> Lent<'_, FieldGradient> {
        let mut gradient = self.spaces.gradients.lend();
        gradient.shapes.resize(self.shapes.len(), ShapeGradient::ZERO);
        threads::for_each_chunk(&mut gradient.shapes, shape::CHUNK, |_, shapes| shapes.fill(ShapeGradient::ZERO));
        gradient
    }

    /// The gradient to mean, scale, (unnormalised) quaternion, density and ν.
    pub fn finish(&self, gradient: &FieldGradient) -> Parameters {
        let mut all = Parameters::default();
        self.finish_into(gradient, &mut all);
        all
    }

    /// [`Self::finish`] into memory that is there already.
    pub(crate) fn finish_into(&self, gradient: &FieldGradient, all: &mut Parameters) {
        shape::finish(&self.shapes, &gradient.shapes, all);
    }
}

/// Projections `[view, v, u]` of all primitives `[Eq. 4]`, `[X1]`.
///
/// `cutoff`: relative to each primitive's peak, 0 for the untruncated truth. Tests: `tests/contracts/analytic.rs`, `tests/contracts/parity.rs`.
pub fn forward<R: Kernels>(
    primitives: &Primitives,
    scanner: &Scanner,
    angles: &[f64],
    projection: Projection,
    cutoff: f64,
) -> Array3<R> {
    let field = Field::<R>::new(primitives, cutoff);
    let mut images = Array3::from_elem((angles.len(), scanner.detector.rows, scanner.detector.columns), R::ZERO);
    for (mut image, &angle) in images.outer_iter_mut().zip(angles) {
        image.assign(&field.view(scanner, angle, projection).image());
    }
    images
}

/// Gradient of `Σ cotangent·projection` to the physical parameters; `cotangent` is `[view, v, u]`.
///
/// Tests: `tests/contracts/gradients.rs`, `tests/contracts/parity.rs`.
pub fn vjp<R: Kernels>(
    primitives: &Primitives,
    scanner: &Scanner,
    angles: &[f64],
    projection: Projection,
    cutoff: f64,
    cotangent: ArrayView3<'_, R>,
) -> Parameters {
    let field = Field::<R>::new(primitives, cutoff);
    let mut gradient = field.zero_gradient();
    for (view, &angle) in angles.iter().enumerate() {
        field.view(scanner, angle, projection).pull_back(cotangent.index_axis(Axis(0), view), &mut gradient);
    }
    field.finish(&gradient)
}

/// The field at the voxel centres of a grid, `[x, y, z]` `[Eq. 1]`, `[Eq. 2]`.
pub fn voxelize<R: Kernels>(primitives: &Primitives, grid: &Grid, cutoff: f64) -> Array3<R> {
    Field::<R>::new(primitives, cutoff).voxels(grid)
}

/// Gradient of `Σ cotangent·volume` to the physical parameters; `cotangent` is `[x, y, z]`.
pub fn voxelize_vjp<R: Kernels>(
    primitives: &Primitives,
    grid: &Grid,
    cutoff: f64,
    cotangent: ArrayView3<'_, R>,
) -> Parameters {
    let field = Field::<R>::new(primitives, cutoff);
    let mut gradient = field.zero_gradient();
    field.on(grid).pull_back(cotangent, &mut gradient);
    field.finish(&gradient)
}
