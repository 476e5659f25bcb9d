//! The field at voxel centres, and the adjoint. A slice of the grid along x is a plane of pixels (rows = y, columns = z)
//! for the same kernels as the projections, with the exponent (ν+3)/2 of `[Eq. 2]`. A register is in two slices, and all
//! of a primitive's slices go through the kernels together: most are a few registers.

use super::canvas::{Blocks, Window};
use super::kernel::{Scratch, Sums};
use super::kernels::Kernels;
use super::shape::{Gradients, Shape, ShapeGradient, Symmetric, whitening};
use super::solid::{Placed, Solid};
use super::{Field, FieldGradient, Projection};
use crate::numeric::vectors::{EIGHT, Vectors, all, each, lanes};
use crate::numeric::{Lanes, threads};
use crate::scene::Grid;
use ndarray::{Array3, ArrayView3};

/// Primitives that one task prepares, and among which one gathers gradients.
const GATHER: usize = 64;
/// Slices that one task adds up: as many pairs as a solid finds the ends of at a time.
const SLAB: usize = 8;

/// The gradients of primitives from the sums over all their slices, in the axes of [`Solid`].
fn pull_back(sums: &[Sums; EIGHT], shapes: [&Shape; EIGHT]) -> [ShapeGradient; EIGHT] {
    let density = each(|i| shapes[i].density);
    let [y, z, yy, yz, zz] = [1, 2, 3, 4, 5].map(|j| each(|i| sums[i].distance[j]));
    let [x, xx, xy, xz] = [0, 1, 2, 3].map(|j| each(|i| sums[i].x[j]));
    let [mx, my, mz] = whitening(shapes).columns;
    let q_x = my.cross(mz).unit();
    let q_y = my.unit();
    let q_z = q_x.cross(q_y);
    let [xx, xy, xz, yy, yz, zz] = [xx, xy, xz, yy, yz, zz].map(|value| value * density);
    let precision = Symmetric::new(q_x, q_x, xx)
        + Symmetric::new(q_x, q_y, all(2.0) * xy)
        + Symmetric::new(q_x, q_z, all(2.0) * xz)
        + Symmetric::new(q_y, q_y, yy)
        + Symmetric::new(q_y, q_z, all(2.0) * yz)
        + Symmetric::new(q_z, q_z, zz);
    let factor = density / each(|i| shapes[i].unit).sqrt();
    let first = q_x * (x * factor) + q_y * (y * factor) + q_z * (z * factor);
    let mean = Vectors::new(mx.dot(first), my.dot(first), mz.dot(first)) * all(-2.0);
    let nu = each(|i| shapes[i].nu);
    let log = each(|i| sums[i].log);
    let d_nu = all(-0.5 * std::f64::consts::LN_2) * log * density - (xx + yy + zz) / nu;
    let zero = all(0.0);
    Gradients {
        mean,
        precision,
        density: each(|i| sums[i].value),
        nu: nu.select_le(all(f64::MAX), d_nu, zero),
        shadow: [zero; 2],
    }
    .to_array()
}

/// A [`Field`] on a grid: the primitives that reach any of its voxels.
pub struct GridField<'a, R> {
    field: &'a Field<R>,
    pub(super) grid: Grid,
    /// Those of each [`GATHER`] primitives, with their indices in the model, in order.
    pub(super) solids: Vec<Vec<(usize, Solid)>>,
}

impl<R: Kernels> Field<R> {
    /// The field on a grid.
    pub fn on(&self, grid: &Grid) -> GridField<'_, R> {
        let solids = threads::map(self.shapes.len().div_ceil(GATHER), |chunk| {
            let all = (chunk * GATHER..).zip(&self.shapes[chunk * GATHER..]).take(GATHER);
            let near: Vec<_> = all.filter(|(_, shape)| Solid::is_near(shape, grid)).collect();
            let solids = near.chunks(EIGHT).flat_map(|some| {
                let solids = Solid::eight(lanes(some, |(_, shape)| *shape), grid);
                some.iter().map(|(i, _)| *i).zip(solids)
            });
            solids.filter(|(_, solid)| !solid.slices().is_empty()).collect()
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
        let [nx, ny, nz] = self.grid.shape;
        let mut members = vec![Vec::new(); nx.div_ceil(SLAB)];
        for (_, solid) in self.solids.iter().flatten() {
            for slab in &mut members[solid.slices().start / SLAB..=(solid.slices().end - 1) / SLAB] {
                slab.push(solid);
            }
        }
        let kernel = R::kernels(self.field.kernel, Projection::Affine).solid.forward;
        let mut volume = vec![R::ZERO; nx * ny * nz];
        threads::for_each_chunk_in(&mut volume, SLAB * ny * nz, Scratch::new, |slab, voxels, scratch| {
            let slices = slab * SLAB..nx.min((slab + 1) * SLAB);
            let window = Window { slices: slices.clone(), rows: ny, columns: 0..nz };
            let mut blocks = Blocks::<R>::new(window.clone());
            for solid in &members[slab] {
                kernel(&Placed { solid, window: &window }, &mut blocks, scratch);
            }
            for (row, voxels) in voxels.chunks_exact_mut(nz).enumerate() {
                blocks.read(slices.start + row / ny, row % ny, voxels);
            }
        });
        Array3::from_shape_vec((nx, ny, nz), volume).expect("slabs make up the volume")
    }

    /// Adds the gradient of `Σ cotangent·volume`; `cotangent` is `[x, y, z]`.
    ///
    /// # Panics
    /// If the cotangent does not have the grid's shape, or the gradient belongs to another field.
    pub fn pull_back(&self, cotangent: ArrayView3<'_, R>, gradient: &mut FieldGradient) {
        let Self { field, grid, solids } = self;
        let [nx, ny, nz] = grid.shape;
        assert_eq!(cotangent.shape(), grid.shape, "shape of the cotangent");
        assert_eq!(gradient.shapes.len(), field.shapes.len(), "primitives of the gradient");
        let cotangent = cotangent.as_standard_layout();
        let values = cotangent.as_slice().expect("standard layout");
        let window = Window { slices: 0..nx, rows: ny, columns: 0..nz };
        let mut blocks = Blocks::<R>::new(window.clone());
        blocks.fill(|x, y| &values[(x * ny + y) * nz..][..nz]);
        let kernel = R::kernels(field.kernel, Projection::Affine).solid.backward;
        threads::for_each_chunk_in(&mut gradient.shapes, GATHER, Scratch::new, |chunk, gradients, scratch| {
            for some in solids[chunk].chunks(EIGHT) {
                let mut sums = [Sums::default(); EIGHT];
                for (sums, (_, solid)) in sums.iter_mut().zip(some) {
                    *sums = kernel(&Placed { solid, window: &window }, &blocks, scratch);
                }
                let shapes = lanes(some, |(i, _)| &field.shapes[*i]);
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
    use glam::DVec3;
    use rand::RngExt;

    #[test]
    fn primitives_are_left_out_only_where_they_reach_no_voxel() {
        let mut random = stream(7, Purpose::Phantom, 0, 0);
        let mut draw = |low: f64, high: f64| low + (high - low) * random.random::<f64>();
        let m = 3000;
        let parameters = Parameters {
            mean: (0..m).map(|_| [draw(-1.0, 1.0), draw(-1.0, 1.0), draw(-1.0, 1.0)]).collect(),
            scale: (0..m).map(|_| [draw(0.005, 0.1), draw(0.005, 0.1), draw(0.005, 0.1)]).collect(),
            quaternion: (0..m).map(|_| [draw(-1.0, 1.0), draw(-1.0, 1.0), draw(-1.0, 1.0), 0.1]).collect(),
            density: vec![1.0; m],
            nu: (0..m).map(|_| draw(2.0, 40.0)).collect(),
        };
        let field = Field::<f32>::new(&Primitives::new(parameters).unwrap(), 1e-2);
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
