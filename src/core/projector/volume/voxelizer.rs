//! The field at voxel centres, and the gradient.
//!
//! A slice of the grid along x is a plane of pixels (rows = y, columns = z) for the same kernels as the projections, with
//! the exponent (ν+3)/2 of `[Eq. 2]`. A register covers two slices, and all of a primitive's slices are one call of the
//! kernel: most consist of a few registers.

use super::ellipsoid::{Ellipsoid, EllipsoidInRegion};
use super::kernels::VolumeKernels;
use crate::geometry::Grid;
use crate::numeric::threads::{self, Pool, PoolGuard};
use crate::numeric::vectors::{DVec3x8, LANES, f64x8, lane_refs, splat};
use crate::numeric::{Lanes, Real};
use crate::projector::kernel::buffers::{BrickedVolume, GridRegion};
use crate::projector::kernel::{Scratch, Sums};
use crate::projector::kernels::Kernels;
use crate::projector::whitened::{
    FieldGradient, GradientLanes, PrimitiveGradient, Symmetric, Whitened, WhitenedPrimitive, whitening,
};
use ndarray::{Array3, ArrayView3};
use std::array::from_fn;
use std::convert::Infallible;
use std::ops::Range;

/// Primitives of one task.
const CHUNK: usize = 64;
/// Slices of one task: as many pairs as an ellipsoid computes the column ends of at a time.
const SLAB: usize = 8;
/// Slices of each worker between two reports.
pub(crate) const SLICES_OF_WORKER: usize = 2 * SLAB;

/// The gradients of eight primitives from the sums over all their slices, in the axes of [`Ellipsoid`].
fn primitive_gradients(sums: &[Sums; LANES], primitives: [&WhitenedPrimitive; LANES]) -> [PrimitiveGradient; LANES] {
    let density = f64x8::from_fn(|i| primitives[i].density);
    let [y, z, yy, yz, zz] = from_fn(|j| f64x8::from_fn(|i| sums[i].distance[1 + j]));
    let [x, xx, xy, xz] = from_fn(|j| f64x8::from_fn(|i| sums[i].x[j]));
    let [mx, my, mz] = whitening(primitives).columns;
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
    let factor = density / f64x8::from_fn(|i| primitives[i].unit).sqrt();
    let first = q_x * (x * factor) + q_y * (y * factor) + q_z * (z * factor);
    let mean = DVec3x8::new(mx.dot(first), my.dot(first), mz.dot(first)) * splat(-2.0);
    let nu = f64x8::from_fn(|i| primitives[i].nu);
    let log = f64x8::from_fn(|i| sums[i].log);
    let d_nu = splat(-0.5 * std::f64::consts::LN_2) * log * density - (xx + yy + zz) / nu;
    let zero = splat(0.0);
    GradientLanes {
        mean,
        precision,
        density: f64x8::from_fn(|i| sums[i].value),
        nu: nu.select_le(splat(f64::MAX), d_nu, zero),
        mean2d: [zero; 2],
    }
    .to_array()
}

/// The ellipsoids among [`CHUNK`] primitives that reach a voxel, with their indices in the model, in order.
pub(crate) type Chunk = Vec<(usize, Ellipsoid)>;

/// Buffers of grids, reused from grid to grid so that a steady state allocates nothing.
#[derive(Default)]
pub(crate) struct Workspace<R: Real> {
    ellipsoids: Pool<Vec<Chunk>>,
    volumes: Pool<BrickedVolume<R>>,
    scratch: Pool<Scratch<R::Lanes>>,
}

/// A [`Field`](crate::projector::Field) on a grid: the primitives that reach any of its voxels.
pub struct GridField<'a, R: Real> {
    whitened: Whitened<'a>,
    workspace: &'a Workspace<R>,
    pub(crate) grid: Grid,
    pub(crate) ellipsoids: PoolGuard<'a, Vec<Chunk>>,
}

/// The ellipsoids that reach a voxel of the grid.
fn place_all(primitives: &[WhitenedPrimitive], grid: &Grid, ellipsoids: &mut Vec<Chunk>) {
    // Full capacity, so that another grid needs no more.
    ellipsoids.resize_with(primitives.len().div_ceil(CHUNK), || Vec::with_capacity(CHUNK));
    threads::for_each_chunk(ellipsoids, 1, |chunk, ellipsoids| {
        let [ellipsoids] = ellipsoids else { unreachable!("a chunk of one") };
        ellipsoids.clear();
        let (mut near, mut count) = ([0; CHUNK], 0);
        for (i, primitive) in (chunk * CHUNK..).zip(&primitives[chunk * CHUNK..]).take(CHUNK) {
            near[count] = i;
            count += usize::from(Ellipsoid::is_near(primitive, grid));
        }
        for group in near[..count].chunks(LANES) {
            let eight = Ellipsoid::on_grid(lane_refs(group, |&i| &primitives[i]), grid);
            let reaching = group.iter().copied().zip(eight).filter(|(_, ellipsoid)| !ellipsoid.slices().is_empty());
            ellipsoids.extend(reaching);
        }
    });
}

impl<'a, R: Kernels> GridField<'a, R> {
    pub(crate) fn new(whitened: Whitened<'a>, workspace: &'a Workspace<R>, grid: &Grid) -> Self {
        let mut ellipsoids = workspace.ellipsoids.take();
        place_all(whitened.primitives, grid, &mut ellipsoids);
        Self { whitened, workspace, grid: *grid, ellipsoids }
    }

    fn kernels(&self) -> VolumeKernels<R> {
        R::volume_kernels(self.whitened.kernel)
    }

    /// Values at the voxel centres, `[x, y, z]`.
    pub fn voxels(&self) -> Array3<R> {
        let mut volume = Array3::default((0, 0, 0));
        self.voxels_into(&mut volume);
        volume
    }

    /// Slices (x) that [`Self::by_slabs`] computes together.
    pub fn slices_together(&self) -> usize {
        (SLICES_OF_WORKER * threads::count()).min(self.grid.shape[0])
    }

    /// The values of [`Self::voxels`], the same bits, some slices after the others, for a volume that is larger than memory.
    /// `give` also gets the number of slices so far.
    ///
    /// # Errors
    /// That of `give`.
    pub fn by_slabs<E>(&self, mut give: impl FnMut(&[R], usize) -> Result<(), E>) -> Result<(), E> {
        let ([nx, ny, nz], together) = (self.grid.shape, self.slices_together());
        let mut values = vec![R::ZERO; together * ny * nz];
        for first in (0..nx).step_by(together) {
            let last = nx.min(first + together);
            let values = &mut values[..(last - first) * ny * nz];
            self.slabs_into(first / SLAB, values);
            give(values, last)?;
        }
        Ok(())
    }

    /// [`Self::voxels`], rounded to single precision; with few slices in `R` at a time.
    pub fn voxels_in_single(&self) -> Array3<f32> {
        let mut values = Vec::with_capacity(self.grid.voxels());
        let give = |slab: &[R], _| -> Result<(), Infallible> {
            values.extend(slab.iter().map(|value| value.to_f64() as f32));
            Ok(())
        };
        let Ok(()) = self.by_slabs(give);
        Array3::from_shape_vec(self.grid.shape, values).expect("every voxel of the grid")
    }

    /// The slices `x` of [`Self::voxels`], with its bits.
    ///
    /// # Panics
    /// When they are not slices of the grid.
    pub fn slices(&self, x: Range<usize>) -> Array3<R> {
        let [nx, ny, nz] = self.grid.shape;
        assert!(x.start < x.end && x.end <= nx, "slices {x:?} of {nx}");
        let first = x.start / SLAB;
        let mut values = vec![R::ZERO; (x.end.next_multiple_of(SLAB).min(nx) - first * SLAB) * ny * nz];
        self.slabs_into(first, &mut values);
        values.drain(..(x.start - first * SLAB) * ny * nz);
        values.truncate(x.len() * ny * nz);
        Array3::from_shape_vec((x.len(), ny, nz), values).expect("whole slices")
    }

    /// [`Self::voxels`] into an existing array.
    pub fn voxels_into(&self, volume: &mut Array3<R>) {
        let [nx, ny, nz] = self.grid.shape;
        if volume.dim() != (nx, ny, nz) {
            *volume = Array3::default((nx, ny, nz));
        }
        self.slabs_into(0, volume.as_slice_mut().expect("volumes are in standard layout"));
    }

    /// The values of slabs from the first one on.
    fn slabs_into(&self, first: usize, values: &mut [R]) {
        let Self { workspace, grid, ellipsoids, .. } = self;
        let [nx, ny, nz] = grid.shape;
        let kernel = self.kernels().forward;
        threads::for_each_chunk_in(values, SLAB * ny * nz, &workspace.scratch, |slab, voxels, scratch| {
            let slab = first + slab;
            let slices = slab * SLAB..nx.min((slab + 1) * SLAB);
            let region = GridRegion { slices: slices.clone(), rows: ny, columns: 0..nz };
            let mut buffer = workspace.volumes.take();
            buffer.reset(region.clone());
            for (_, ellipsoid) in ellipsoids.iter().flatten() {
                if ellipsoid.slices().start < slices.end && slices.start < ellipsoid.slices().end {
                    kernel(&EllipsoidInRegion { ellipsoid, region: &region }, &mut buffer, scratch);
                }
            }
            for (row, voxels) in voxels.chunks_exact_mut(nz).enumerate() {
                buffer.read(slices.start + row / ny, row % ny, voxels);
            }
        });
    }

    /// Adds the gradient of `Σ cotangent·volume`; `cotangent` is `[x, y, z]`.
    ///
    /// # Panics
    /// If the cotangent does not have the grid's shape, if the gradient belongs to another field, or for volumes of 2^32
    /// voxels.
    pub fn vjp(&self, cotangent: ArrayView3<'_, R>, gradient: &mut FieldGradient) {
        let Self { whitened, workspace, grid, ellipsoids } = self;
        let [nx, ny, nz] = grid.shape;
        assert_eq!(cotangent.shape(), grid.shape, "shape of the cotangent");
        assert_eq!(gradient.by_primitive.len(), whitened.primitives.len(), "primitives of the gradient");
        let cotangent = cotangent.as_standard_layout();
        let values = cotangent.as_slice().expect("standard layout");
        let region = GridRegion { slices: 0..nx, rows: ny, columns: 0..nz };
        let mut buffer = workspace.volumes.take();
        buffer.reset(region.clone());
        buffer.fill(|x, y| &values[(x * ny + y) * nz..][..nz]);
        let kernel = self.kernels().vjp;
        let (gradients, scratch) = (&mut gradient.by_primitive, &workspace.scratch);
        threads::for_each_chunk_in(gradients, CHUNK, scratch, |chunk, gradients, scratch| {
            for group in ellipsoids[chunk].chunks(LANES) {
                let mut sums = [Sums::default(); LANES];
                for (sums, (_, ellipsoid)) in sums.iter_mut().zip(group) {
                    *sums = kernel(&EllipsoidInRegion { ellipsoid, region: &region }, &buffer, scratch);
                }
                let primitives = lane_refs(group, |(i, _)| &whitened.primitives[*i]);
                for ((i, _), gradient) in group.iter().zip(primitive_gradients(&sums, primitives)) {
                    gradients[i - chunk * CHUNK].add(&gradient);
                }
            }
        });
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::{Beam, Detector, Scanner};
    use crate::numeric::rng::{Purpose, stream};
    use crate::primitives::{Parameters, Primitives};
    use crate::projector::{Field, Projection};
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
    fn parts_have_the_bits_of_the_whole() {
        let (primitives, grid) = (some(300, 5), Grid::new([37, 20, 24], DVec3::splat(-1.0), DVec3::ONE).unwrap());
        let field = Field::<f32>::new(&primitives, 1e-3);
        let on_grid = field.on(&grid);
        let whole = on_grid.voxels();
        let parts = [0..5, 5..9, 9..32, 32..37].map(|x| on_grid.slices(x));
        let together = ndarray::concatenate(ndarray::Axis(0), &parts.each_ref().map(|part| part.view())).unwrap();
        assert!(whole.iter().any(|value| *value > 0.0) && together == whole && on_grid.voxels_in_single() == whole);
        let double = Field::<f64>::new(&primitives, 1e-3);
        let rounded = double.on(&grid).voxels().mapv(|value| value as f32);
        assert_eq!(double.on(&grid).voxels_in_single(), rounded);
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
            view.vjp(into.0.view(), &mut gradient);
            there.vjp(into.1.view(), &mut gradient);
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
        let mut kept = there.ellipsoids.iter().flatten().map(|(i, _)| *i).peekable();
        let (mut left_out, mut reaching) = (0, 0);
        for (i, primitive) in field.whitened().primitives.iter().enumerate() {
            let delta = |x: usize, y: usize, z: usize| {
                let place = grid.min + (DVec3::new(x as f64, y as f64, z as f64) + 0.5) * grid.spacing;
                (primitive.whitening * (place - primitive.mean)).length_squared() / primitive.unit
            };
            let voxels = (0..6 * 7 * 5).map(|j| delta(j / 35, j / 5 % 7, j % 5));
            let reaches = voxels.fold(f64::INFINITY, f64::min) <= primitive.max_x;
            reaching += usize::from(reaches);
            if kept.next_if_eq(&i).is_none() {
                left_out += 1;
                assert!(!reaches, "primitive {i}");
            }
        }
        assert!(reaching > 100 && left_out > 2000, "{reaching} reach, {left_out} left out");
    }
}
