//! The field at voxel centres, and the adjoint. A slice of the grid along x is a plane of pixels (rows = y, columns = z)
//! for the same kernels as the projections, with the exponent (ν+3)/2 of `[Eq. 2]`. A register is in two slices, and all
//! of a primitive's slices go through the kernels together: most are a few registers.

use super::canvas::Window;
use super::kernel::Sums;
use super::kernels::Kernels;
use super::shape::{Gradients, Shape, ShapeGradient, Symmetric, whitening};
use super::solid::{Placed, Solid};
use super::{Field, FieldGradient, Projection};
use crate::numeric::threads::{self, PoolGuard};
use crate::numeric::vectors::{DVec3x8, LANES, f64x8, lane_refs, splat};
use crate::numeric::{Lanes, Real};
use crate::scene::Grid;
use ndarray::{Array3, ArrayView3};
use std::array::from_fn;

/// Primitives that one task prepares, and among which one gathers gradients.
const GATHER: usize = 64;
/// Slices that one task adds up: as many pairs as a solid finds the ends of at a time.
const SLAB: usize = 8;

/// The gradients of primitives from the sums over all their slices, in the axes of [`Solid`].
fn pull_back(sums: &[Sums; LANES], shapes: [&Shape; LANES]) -> [ShapeGradient; LANES] {
    let density = f64x8::from_fn(|i| shapes[i].density);
    let [y, z, yy, yz, zz] = from_fn(|j| f64x8::from_fn(|i| sums[i].distance[1 + j]));
    let [x, xx, xy, xz] = from_fn(|j| f64x8::from_fn(|i| sums[i].x[j]));
    let [mx, my, mz] = whitening(shapes).columns;
    let q_x = my.cross(mz).unit();
    let q_y = my.unit();
    let q_z = q_x.cross(q_y);
    let second = [xx, xy, xz, yy, yz, zz];
    let [xx, xy, xz, yy, yz, zz] = from_fn(|j| second[j] * density);
    let precision = Symmetric::new(q_x, q_x, xx)
        + Symmetric::new(q_x, q_y, splat(2.0) * xy)
        + Symmetric::new(q_x, q_z, splat(2.0) * xz)
        + Symmetric::new(q_y, q_y, yy)
        + Symmetric::new(q_y, q_z, splat(2.0) * yz)
        + Symmetric::new(q_z, q_z, zz);
    let factor = density / f64x8::from_fn(|i| shapes[i].unit).sqrt();
    let first = q_x * (x * factor) + q_y * (y * factor) + q_z * (z * factor);
    let mean = DVec3x8::new(mx.dot(first), my.dot(first), mz.dot(first)) * splat(-2.0);
    let nu = f64x8::from_fn(|i| shapes[i].nu);
    let log = f64x8::from_fn(|i| sums[i].log);
    let d_nu = splat(-0.5 * std::f64::consts::LN_2) * log * density - (xx + yy + zz) / nu;
    let zero = splat(0.0);
    Gradients {
        mean,
        precision,
        density: f64x8::from_fn(|i| sums[i].value),
        nu: nu.select_le(splat(f64::MAX), d_nu, zero),
        shadow: [zero; 2],
    }
    .to_array()
}

/// Those of [`GATHER`] primitives that reach a voxel, with their indices in the model, in order.
pub(super) type Chunk = Vec<(usize, Solid)>;

/// A [`Field`] on a grid: the primitives that reach any of its voxels.
pub struct GridField<'a, R: Real> {
    field: &'a Field<R>,
    pub(super) grid: Grid,
    pub(super) solids: PoolGuard<'a, Vec<Chunk>>,
}

impl<R: Kernels> Field<R> {
    /// The field on a grid.
    pub fn on(&self, grid: &Grid) -> GridField<'_, R> {
        let mut solids = self.spaces.solids.take();
        // Room for all of them: what comes with another grid needs no more.
        solids.resize_with(self.shapes.len().div_ceil(GATHER), || Vec::with_capacity(GATHER));
        threads::for_each_chunk(&mut solids, 1, |chunk, solids| {
            let [solids] = solids else { unreachable!("a chunk of one") };
            solids.clear();
            let (mut near, mut count) = ([0; GATHER], 0);
            for (i, shape) in (chunk * GATHER..).zip(&self.shapes[chunk * GATHER..]).take(GATHER) {
                near[count] = i;
                count += usize::from(Solid::is_near(shape, grid));
            }
            for some in near[..count].chunks(LANES) {
                let eight = Solid::eight(lane_refs(some, |&i| &self.shapes[i]), grid);
                solids.extend(some.iter().copied().zip(eight).filter(|(_, solid)| !solid.slices().is_empty()));
            }
        });
        GridField { field: self, grid: *grid, solids }
    }

    /// Values at the voxel centres of a grid, `[x, y, z]`.
    pub fn voxels(&self, grid: &Grid) -> Array3<R> {
        self.on(grid).voxels()
    }
}

impl<R: Kernels> GridField<'_, R> {
    /// Values at the voxel centres, `[x, y, z]`.
    pub fn voxels(&self) -> Array3<R> {
        let mut volume = Array3::default((0, 0, 0));
        self.voxels_into(&mut volume);
        volume
    }

    /// [`Self::voxels`] in the place of others.
    pub fn voxels_into(&self, volume: &mut Array3<R>) {
        let Self { field, grid, solids } = self;
        let [nx, ny, nz] = grid.shape;
        if volume.dim() != (nx, ny, nz) {
            *volume = Array3::default((nx, ny, nz));
        }
        let volume = volume.as_slice_mut().expect("volumes are in standard layout");
        let kernel = R::kernels(field.kernel, Projection::Affine).solid.forward;
        threads::for_each_chunk_in(volume, SLAB * ny * nz, &field.spaces.scratch, |slab, voxels, scratch| {
            let slices = slab * SLAB..nx.min((slab + 1) * SLAB);
            let window = Window { slices: slices.clone(), rows: ny, columns: 0..nz };
            let mut blocks = field.spaces.blocks.take();
            blocks.renew(window.clone());
            for (_, solid) in solids.iter().flatten() {
                if solid.slices().start < slices.end && slices.start < solid.slices().end {
                    kernel(&Placed { solid, window: &window }, &mut blocks, scratch);
                }
            }
            for (row, voxels) in voxels.chunks_exact_mut(nz).enumerate() {
                blocks.read(slices.start + row / ny, row % ny, voxels);
            }
        });
    }

    /// Adds the gradient of `Σ cotangent·volume`; `cotangent` is `[x, y, z]`.
    ///
    /// # Panics
    /// If the cotangent does not have the grid's shape, or the gradient belongs to another field, or for volumes of 2^32 voxels.
    pub fn pull_back(&self, cotangent: ArrayView3<'_, R>, gradient: &mut FieldGradient) {
        let Self { field, grid, solids } = self;
        let [nx, ny, nz] = grid.shape;
        assert_eq!(cotangent.shape(), grid.shape, "shape of the cotangent");
        assert_eq!(gradient.shapes.len(), field.shapes.len(), "primitives of the gradient");
        let cotangent = cotangent.as_standard_layout();
        let values = cotangent.as_slice().expect("standard layout");
        let window = Window { slices: 0..nx, rows: ny, columns: 0..nz };
        let mut blocks = field.spaces.blocks.take();
        blocks.renew(window.clone());
        blocks.fill(|x, y| &values[(x * ny + y) * nz..][..nz]);
        let kernel = R::kernels(field.kernel, Projection::Affine).solid.backward;
        let scratch = &field.spaces.scratch;
        threads::for_each_chunk_in(&mut gradient.shapes, GATHER, scratch, |chunk, gradients, scratch| {
            for some in solids[chunk].chunks(LANES) {
                let mut sums = [Sums::default(); LANES];
                for (sums, (_, solid)) in sums.iter_mut().zip(some) {
                    *sums = kernel(&Placed { solid, window: &window }, &blocks, scratch);
                }
                let shapes = lane_refs(some, |(i, _)| &field.shapes[*i]);
                for ((i, _), gradient) in some.iter().zip(pull_back(&sums, shapes)) {
                    gradients[i - chunk * GATHER].add(&gradient);
                }
            }
        });
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::numeric::rng::{Purpose, stream};
    use crate::primitives::{Parameters, Primitives};
    use crate::scene::{Beam, Detector, Scanner};
    use glam::DVec3;
    use ndarray::Array2;
    use rand::RngExt;

    /// `m` turned primitives all over the volume.
    fn some(m: usize, seed: u64) -> Primitives {
        let mut random = stream(seed, Purpose::Phantom, 0, 0);
        let mut draw = |low: f64, high: f64| low + (high - low) * random.random::<f64>();
        let parameters = Parameters {
            mean: (0..m).map(|_| [draw(-1.0, 1.0), draw(-1.0, 1.0), draw(-1.0, 1.0)]).collect(),
            scale: (0..m).map(|_| [draw(0.005, 0.1), draw(0.005, 0.1), draw(0.005, 0.1)]).collect(),
            quaternion: (0..m).map(|_| [draw(-1.0, 1.0), draw(-1.0, 1.0), draw(-1.0, 1.0), 0.1]).collect(),
            density: vec![1.0; m],
            nu: (0..m).map(|_| draw(2.0, 40.0)).collect(),
        };
        Primitives::new(parameters).unwrap()
    }

    #[test]
    fn a_field_that_is_renewed_has_the_bits_of_a_new_one() {
        let pitch = 4.0 / 40.0;
        let scanner = |rows, columns| Scanner {
            beam: Beam::Cone { dso: 5.0, dsd: 7.0 },
            detector: Detector { rows, columns, pitch_v: pitch, pitch_u: pitch, offset_u: 0.0, offset_v: 0.0 },
            grid: Grid::cube(24),
        };
        let use_all = |field: &Field<f32>, scanner: &Scanner, grid: &Grid, into: &mut (Array2<f32>, Array3<f32>)| {
            let view = field.view(scanner, 0.4, Projection::Exact);
            let there = field.on(grid);
            view.image_into(&mut into.0);
            there.voxels_into(&mut into.1);
            let mut gradient = field.pooled_gradient();
            view.pull_back(into.0.view(), &mut gradient);
            there.pull_back(into.1.view(), &mut gradient);
            gradient.clone()
        };
        // More of everything first, then less.
        let large = (scanner(70, 50), Grid::cube(24).block([0; 3], [20, 24, 22]));
        let small = (scanner(40, 61), Grid::cube(24).block([5, 8, 11], [6, 7, 5]));
        let mut kept = Field::<f32>::new(&some(1300, 1), 1e-2);
        let mut arrays = (Array2::default((0, 0)), Array3::default((0, 0, 0)));
        use_all(&kept, &large.0, &large.1, &mut arrays);
        for (m, (scanner, grid)) in [(700, &small), (1500, &large), (0, &small)] {
            let primitives = some(m, m as u64);
            kept.renew(&primitives);
            let gradient = use_all(&kept, scanner, grid, &mut arrays);
            let mut new = (Array2::default((0, 0)), Array3::default((0, 0, 0)));
            assert_eq!(gradient, use_all(&Field::new(&primitives, 1e-2), scanner, grid, &mut new));
            assert_eq!(arrays, new);
            assert!(m == 0 || arrays.0.sum() > 0.0 && arrays.1.sum() > 0.0);
        }
    }

    #[test]
    fn primitives_are_left_out_only_where_they_reach_no_voxel() {
        let field = Field::<f32>::new(&some(3000, 7), 1e-2);
        let grid = Grid::cube(24).block([5, 8, 11], [6, 7, 5]);
        let there = field.on(&grid);
        let mut kept = there.solids.iter().flatten().map(|(i, _)| *i).peekable();
        let (mut left_out, mut reaching) = (0, 0);
        for (i, shape) in field.shapes.iter().enumerate() {
            let delta = |x: usize, y: usize, z: usize| {
                let place = grid.min + (DVec3::new(x as f64, y as f64, z as f64) + 0.5) * grid.spacing;
                (shape.whitening * (place - shape.mean)).length_squared() / shape.unit
            };
            let voxels = (0..6 * 7 * 5).map(|j| delta(j / 35, j / 5 % 7, j % 5));
            let reaches = voxels.fold(f64::INFINITY, f64::min) <= shape.limit;
            reaching += usize::from(reaches);
            if kept.next_if_eq(&i).is_none() {
                left_out += 1;
                assert!(!reaches, "primitive {i}");
            }
        }
        assert!(reaching > 100 && left_out > 2000, "{reaching} reach, {left_out} left out");
    }
}
