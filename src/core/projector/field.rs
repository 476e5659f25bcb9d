//! The density field: whitened primitives, and the functions from them to projections and volumes.

use super::contributions;
use super::image::view::{self, ViewField};
use super::kernels::Kernels;
use super::projection::Projection;
use super::volume::voxelizer::{self, GridField};
use super::whitened::{self, FieldGradient, Whitened, WhitenedPrimitive};
use crate::geometry::{Grid, Scanner, Trajectory, View};
use crate::numeric::Real;
use crate::numeric::threads::{Pool, PoolGuard};
use crate::primitives::{KernelKind, Parameters, Primitives};
use glam::DVec3;
use ndarray::{Array3, ArrayView3, Axis};

/// Bytes of a primitive in each role, for the estimate of a run's memory.
#[doc(hidden)]
pub mod bytes {
    use super::super::image::footprint::Footprint;
    use super::super::volume::ellipsoid::Ellipsoid;
    use super::super::whitened::{PrimitiveGradient, WhitenedPrimitive};

    /// In a field.
    pub const FIELD: usize = size_of::<WhitenedPrimitive>();
    /// In its gradient.
    pub const GRADIENT: usize = size_of::<PrimitiveGradient>();
    /// In a view.
    pub const VIEW: usize = size_of::<Footprint>();
    /// On a grid.
    pub const GRID: usize = size_of::<(usize, Ellipsoid)>();
    /// Slices that each thread computes between two parts of a volume.
    pub const SLICES: usize = super::super::volume::voxelizer::SLICES_OF_WORKER;
}

/// The density field f(x) = Σ ρT `[Eq. 1]`: primitives prepared for kernels that run in `R`.
///
/// It keeps the buffers of its views and grids: a field that is [renewed](Self::renew) allocates nothing in a steady
/// state.
pub struct Field<R: Real> {
    kernel: KernelKind,
    cutoff: f64,
    primitives: Vec<WhitenedPrimitive>,
    views: view::Workspace<R>,
    grids: voxelizer::Workspace<R>,
    gradients: Pool<FieldGradient>,
}

impl<R: Kernels> Field<R> {
    /// Prepares primitives. A primitive is cut off where its projection has fallen to `cutoff` of its peak (0: nowhere).
    pub fn new(primitives: &Primitives, cutoff: f64) -> Self {
        let mut field = Self {
            kernel: primitives.kernel,
            cutoff,
            primitives: Vec::new(),
            views: view::Workspace::default(),
            grids: voxelizer::Workspace::default(),
            gradients: Pool::default(),
        };
        field.renew(primitives);
        field
    }

    /// Replaces the primitives, with the same cutoff and in the same memory.
    pub fn renew(&mut self, primitives: &Primitives) {
        self.kernel = primitives.kernel;
        WhitenedPrimitive::all_into(&mut self.primitives, primitives, self.cutoff, R::HORIZON);
    }

    pub(super) fn whitened(&self) -> Whitened<'_> {
        Whitened { primitives: &self.primitives, kernel: self.kernel, cutoff: self.cutoff }
    }

    /// The field in the plain view at `angle` (radians).
    pub fn view(&self, scanner: &Scanner, angle: f64, projection: Projection) -> ViewField<'_, R> {
        self.seen_in(&scanner.view(angle), projection)
    }

    /// The field in any view.
    pub fn seen_in(&self, view: &View, projection: Projection) -> ViewField<'_, R> {
        ViewField::new(self.whitened(), &self.views, view, projection)
    }

    /// The field on a grid.
    pub fn on(&self, grid: &Grid) -> GridField<'_, R> {
        GridField::new(self.whitened(), &self.grids, grid)
    }

    /// Values at the voxel centres of a grid, `[x, y, z]`.
    pub fn voxels(&self, grid: &Grid) -> Array3<R> {
        self.on(grid).voxels()
    }

    /// The contribution of each primitive to the density at the centre of voxel (x, y, z), `[M]` `[Eq. 1]`, `[Eq. 2]`.
    ///
    /// As [`ViewField::contributions`]: in index order they add up to the voxel of [`Field::voxels`].
    ///
    /// Tests: `contributions_add_up_to_the_image_and_the_volume`.
    ///
    /// # Panics
    /// If the voxel is not on the grid.
    pub fn voxel_contributions(&self, grid: &Grid, voxel: [usize; 3]) -> Vec<R> {
        contributions::of_voxel(self.whitened(), grid, voxel)
    }

    /// A gradient of zeros.
    pub fn zero_gradient(&self) -> FieldGradient {
        let mut gradient = FieldGradient::default();
        gradient.reset(self.primitives.len());
        gradient
    }

    /// A gradient of zeros from the field's pool.
    pub fn pooled_gradient(&self) -> PoolGuard<'_, FieldGradient> {
        let mut gradient = self.gradients.take();
        gradient.reset(self.primitives.len());
        gradient
    }

    /// The gradient to mean, scale, (unnormalised) quaternion, density and ν.
    pub fn parameter_gradient(&self, gradient: &FieldGradient) -> Parameters {
        let mut parameters = Parameters::default();
        self.parameter_gradient_into(gradient, &mut parameters);
        parameters
    }

    /// [`Self::parameter_gradient`] into existing arrays.
    pub fn parameter_gradient_into(&self, gradient: &FieldGradient, parameters: &mut Parameters) {
        whitened::parameter_gradient(&self.primitives, &gradient.by_primitive, parameters);
    }
}

/// Projections `[view, v, u]` of all primitives `[Eq. 4]`, `[X1]`.
///
/// `cutoff`: relative to each primitive's peak, 0 for no truncation. Tests: `tests/contracts/analytic.rs`,
/// `tests/contracts/parity.rs`.
pub fn forward<'a, R: Kernels>(
    primitives: &Primitives,
    scanner: &Scanner,
    views: impl Into<Trajectory<'a>>,
    projection: Projection,
    cutoff: f64,
) -> Array3<R> {
    forward_seen(primitives, scanner, views.into(), projection, cutoff, &mut |_, _| {})
}

/// [`forward`] `[Eq. 4]`, `[X1]`, calling `see` after each view with the views done and all of them.
pub fn forward_seen<R: Kernels>(
    primitives: &Primitives,
    scanner: &Scanner,
    views: Trajectory<'_>,
    projection: Projection,
    cutoff: f64,
    see: &mut dyn FnMut(usize, usize),
) -> Array3<R> {
    let field = Field::<R>::new(primitives, cutoff);
    let mut images = Array3::from_elem((views.len(), scanner.detector.rows, scanner.detector.columns), R::ZERO);
    for (number, mut image) in images.outer_iter_mut().enumerate() {
        image.assign(&field.seen_in(&views.view(scanner, number), projection).image());
        see(number + 1, views.len());
    }
    images
}

/// Gradient of `Σ cotangent·projection` to the physical parameters `[Eq. 4]`, `[X1]`; `cotangent` is `[view, v, u]`.
///
/// Tests: `tests/contracts/gradients.rs`, `tests/contracts/parity.rs`.
pub fn vjp<'a, R: Kernels>(
    primitives: &Primitives,
    scanner: &Scanner,
    views: impl Into<Trajectory<'a>>,
    projection: Projection,
    cutoff: f64,
    cotangent: ArrayView3<'_, R>,
) -> Parameters {
    let views = views.into();
    let field = Field::<R>::new(primitives, cutoff);
    let mut gradient = field.zero_gradient();
    for number in 0..views.len() {
        let view = field.seen_in(&views.view(scanner, number), projection);
        view.vjp(cotangent.index_axis(Axis(0), number), &mut gradient);
    }
    field.parameter_gradient(&gradient)
}

/// Gradient of `Σ cotangent·projection` to a motion of source and detector together `[motion]`: for each view of a shift
/// along x, y and z, and of a turn about these axes (radians). The last entry is the gradient to an angle of the circle.
///
/// The opposite motion of the primitives has the same images, so it follows from the gradient to them. Not in the paper.
pub fn motion_vjp<'a, R: Kernels>(
    primitives: &Primitives,
    scanner: &Scanner,
    views: impl Into<Trajectory<'a>>,
    projection: Projection,
    cutoff: f64,
    cotangent: ArrayView3<'_, R>,
) -> Vec<[f64; 6]> {
    let views = views.into();
    let field = Field::<R>::new(primitives, cutoff);
    let motion = |number: usize| {
        let mut gradient = field.zero_gradient();
        let view = field.seen_in(&views.view(scanner, number), projection);
        view.vjp(cotangent.index_axis(Axis(0), number), &mut gradient);
        let gradient = field.parameter_gradient(&gradient);
        let (mut shift, mut turn) = (DVec3::ZERO, DVec3::ZERO);
        for (row, by_mean) in gradient.mean.iter().map(|row| DVec3::from(*row)).enumerate() {
            let [w, x, y, z] = primitives.parameters.quaternion[row];
            let [by_w, by_x, by_y, by_z] = gradient.quaternion[row];
            let (v, by_v) = (DVec3::new(x, y, z), DVec3::new(by_x, by_y, by_z));
            shift -= by_mean;
            turn -= DVec3::from(primitives.parameters.mean[row]).cross(by_mean);
            turn -= (by_v * w - v * by_w + v.cross(by_v)) * 0.5;
        }
        [shift.x, shift.y, shift.z, turn.x, turn.y, turn.z]
    };
    (0..views.len()).map(motion).collect()
}

/// The field at the voxel centres of a grid, `[x, y, z]` `[Eq. 1]`, `[Eq. 2]`.
pub fn voxelize<R: Kernels>(primitives: &Primitives, grid: &Grid, cutoff: f64) -> Array3<R> {
    Field::<R>::new(primitives, cutoff).voxels(grid)
}

/// Gradient of `Σ cotangent·volume` to the physical parameters `[Eq. 1]`, `[Eq. 2]`; `cotangent` is `[x, y, z]`.
pub fn voxelize_vjp<R: Kernels>(
    primitives: &Primitives,
    grid: &Grid,
    cutoff: f64,
    cotangent: ArrayView3<'_, R>,
) -> Parameters {
    let field = Field::<R>::new(primitives, cutoff);
    let mut gradient = field.zero_gradient();
    field.on(grid).vjp(cotangent, &mut gradient);
    field.parameter_gradient(&gradient)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::{Deviation, Pose};
    use crate::numeric::rng::{Purpose, stream};
    use glam::{DMat3, DQuat};
    use rand::RngExt;

    const ANGLES: [f64; 2] = [0.3, 4.4];
    const STEP: f64 = 1e-5;

    fn along(poses: &[Pose]) -> Trajectory<'_> {
        Trajectory { angles: &ANGLES, poses: Some(poses) }
    }

    fn primitives() -> Primitives {
        let mut random = stream(8, Purpose::Phantom, 0, 0);
        let mut draw = |low: f64, high: f64| low + (high - low) * random.random::<f64>();
        let mut parameters = Parameters::zeros(5);
        for i in 0..5 {
            parameters.mean[i] = std::array::from_fn(|_| draw(-0.6, 0.6));
            parameters.scale[i] = std::array::from_fn(|_| draw(0.1, 0.4));
            parameters.quaternion[i] = std::array::from_fn(|_| draw(-1.0, 1.0));
            parameters.density[i] = draw(0.2, 1.0);
            parameters.nu[i] = draw(1.0, 20.0);
        }
        Primitives::new(parameters).unwrap()
    }

    /// Each view is shifted and turned along and about each axis; on the circle, its angle changes.
    #[test]
    fn gradients_to_motions_of_views_match_central_differences() {
        let (primitives, scanner) = (primitives(), Scanner::synthetic(8, 12));
        let plain = Deviation { turns: [0.1, -0.15, 0.2], heights: [0.3, 0.1], ..Deviation::none(&scanner) };
        let poses = ANGLES.map(|angle| plain.pose(angle));
        let cotangent = Array3::from_shape_fn((2, 12, 12), |(_, v, u)| ((7 * v + 5 * u) % 11) as f64 / 4.0 - 1.25);
        for projection in [Projection::Exact, Projection::Affine] {
            let value = |views: Trajectory<'_>, number: usize| {
                let images = forward::<f64>(&primitives, &scanner, views, projection, 0.0);
                (images * &cotangent).index_axis(Axis(0), number).sum()
            };
            let check = |found: f64, at: &dyn Fn(f64) -> f64, largest: f64| {
                let difference = (at(STEP) - at(-STEP)) / (2.0 * STEP);
                within!((found - difference).abs() / largest, "{projection:?}: {found} and {difference}");
            };
            let largest = |gradient: &[f64; 6]| gradient.iter().fold(0.0_f64, |most, x| most.max(x.abs()));
            let found = motion_vjp(&primitives, &scanner, along(&poses), projection, 0.0, cotangent.view());
            for (number, gradient) in found.iter().enumerate() {
                for (k, &found) in gradient.iter().enumerate() {
                    let at = |step: f64| {
                        let axis = DVec3::AXES[k % 3] * step;
                        let (turn, shift) = if k < 3 { (DVec3::ZERO, axis) } else { (axis, DVec3::ZERO) };
                        let turn = DMat3::from_quat(DQuat::from_scaled_axis(turn));
                        let mut moved = poses;
                        let Pose { source, centre, u, v } = moved[number];
                        let [source, centre] = [source, centre].map(|place| turn * place + shift);
                        moved[number] = Pose { source, centre, u: turn * u, v: turn * v };
                        value(along(&moved), number)
                    };
                    check(found, &at, largest(gradient));
                }
            }
            let found = motion_vjp(&primitives, &scanner, &ANGLES, projection, 0.0, cotangent.view());
            for (number, gradient) in found.iter().enumerate() {
                let at = |step: f64| {
                    let mut angles = ANGLES;
                    angles[number] += step;
                    value((&angles).into(), number)
                };
                check(gradient[5], &at, largest(gradient));
            }
        }
    }
}
