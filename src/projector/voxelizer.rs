//! The field at voxel centres, and the adjoint. A slice of the grid along x is a plane of pixels (rows = y, columns = z)
//! for the same kernels as the projections, with the exponent (ν+3)/2 of `[Eq. 2]`. A primitive's slices go through
//! them together: most are a few registers.

use super::footprint::{Extent, from_even, symmetric};
use super::kernel::{Canvas, Plane, STRIP, Scratch, Slice, Sums};
use super::kernels::Kernels;
use super::shape::{CHUNK, Shape, ShapeGradient};
use super::{Field, FieldGradient, Projection};
use crate::numeric::elementary::{length, unit};
use crate::numeric::threads;
use crate::scene::Grid;
use glam::{DVec2, DVec3};
use ndarray::{Array3, ArrayView3};
use std::ops::Range;

/// Primitives among which one task gathers gradients.
const GATHER: usize = 32;
/// Slices that one task adds up.
const SLAB: usize = 4;

/// A primitive on a grid. With (X, Y, Z) the distance of a voxel from its centre, M = Q·U for the orthogonal Q and
/// the triangular U of `y = b·Y + ab·Z + bx·X`, `z = a·Z + ax·X`, `x = xx·X`, and δ = x² + y² + z².
#[derive(Clone, Debug, Default)]
pub(super) struct Solid {
    /// The part that all slices share; `slant` is along z.
    plane: Plane,
    /// Rows by which the ridge moves per length along x, and what z and x gain, in units of √unit.
    ridge_x: f64,
    ax: f64,
    xx: f64,
    /// Half extent of a slice's form of 1, in columns.
    half: f64,
    /// Rows of the support in all slices, from an even one.
    rows: Range<usize>,
    /// Slice of the centre, with a fraction, and the distance of slices.
    centre: f64,
    step: f64,
    first: usize,
    last: usize,
}

impl Solid {
    /// A primitive of which no voxel is within a sphere around its support is left empty, without further ado.
    pub(super) fn new(shape: &Shape, grid: &Grid) -> Self {
        let radius = (shape.limit * shape.unit).sqrt() / shape.inverse_scale.min_element() * (1.0 + 1e-9);
        let last = grid.min + grid.size();
        if (shape.mean + radius).cmplt(grid.min).any() || (shape.mean - radius).cmpgt(last).any() {
            return Self::default();
        }
        let (mx, my, mz) = (shape.whitening.x_axis, shape.whitening.y_axis, shape.whitening.z_axis);
        let (yz, yx) = (my.cross(mz), my.cross(mx));
        let b = length(my);
        let a = length(yz) / b;
        let root = shape.unit.sqrt();
        let place = (shape.mean - grid.min) / grid.spacing - 0.5;
        let plane = Plane {
            row_centre: place.y,
            column_centre: place.z,
            slant: -my.dot(mz) / (b * b) * grid.spacing.z / grid.spacing.y,
            b: b * grid.spacing.y / root,
            a: a * grid.spacing.z / root,
            q: (shape.nu + 3.0) / 2.0,
            weight: shape.density,
            limit: shape.limit,
            most: shape.limit,
            corners: true,
            ..Plane::default()
        };
        let xx = shape.determinant() / (b * a * root);
        let ridge_x = -my.dot(mx) / (b * b * grid.spacing.y);
        let ax = yz.dot(yx) / (b * b * a * root);
        let radius = shape.limit.sqrt();
        let slices = reach(place.x, grid.spacing.x, radius / xx, grid.shape[0]);
        // How far the ridge of each of the unit sphere's axes leads, in rows.
        let tall =
            length(DVec3::new((ridge_x - plane.slant * ax / plane.a) / xx, 1.0 / plane.b, plane.slant / plane.a));
        Self {
            plane,
            ridge_x,
            ax,
            xx,
            half: 1.0 / plane.a,
            rows: from_even(reach(place.y, 1.0, radius * tall, grid.shape[1])),
            centre: place.x,
            step: grid.spacing.x,
            first: slices.start,
            last: slices.end,
        }
    }

    pub(super) fn slices(&self) -> Range<usize> {
        self.first..self.last
    }

    /// Rows of the support in all slices.
    pub(super) fn rows(&self) -> Range<usize> {
        self.rows.clone()
    }

    /// The primitive in one slice, with the columns it reaches there. `first` is where the slice's first row and column are
    /// on the canvas.
    pub(super) fn slice(&self, slice: usize, grid: &Grid, first: usize) -> Slice {
        let offset = (slice as f64 - self.centre) * self.step;
        let mut plane = self.plane;
        plane.shift = self.ax * offset;
        let x = self.xx * offset;
        plane.floor = x * x;
        plane.row_centre += self.ridge_x * offset;
        // z = 0 lies in the middle of the slice's ellipse.
        let middle = plane.column_centre - plane.shift * self.half;
        let left = (plane.limit - plane.floor).max(0.0).sqrt();
        let columns = reach(middle, 1.0, left * self.half, grid.shape[2]);
        Slice { plane, columns, first, x }
    }

    /// The slices of `range` that it reaches, on a canvas that holds `range` one below the other, `pixels` in each.
    fn slices_on(&self, range: Range<usize>, grid: &Grid, pixels: usize, stride: usize, slices: &mut Vec<Slice>) {
        slices.clear();
        if self.rows.is_empty() {
            return;
        }
        for x in range.start.max(self.first)..range.end.min(self.last) {
            let slice = self.slice(x, grid, (x - range.start) * pixels + self.rows.start * stride);
            if !slice.columns.is_empty() {
                slices.push(slice);
            }
        }
    }
}

/// The gradient of a primitive from the sums over all its slices, in the axes of [`Solid`].
fn pull_back(sums: &Sums, shape: &Shape) -> ShapeGradient {
    let [_, y, z, yy, yz, zz] = sums.distance;
    let [x, xx, xy, xz] = sums.x;
    let (my, mz) = (shape.whitening.y_axis, shape.whitening.z_axis);
    let q_x = unit(my.cross(mz));
    let q_y = unit(my);
    let q_z = q_x.cross(q_y);
    let [xx, xy, xz, yy, yz, zz] = [xx, xy, xz, yy, yz, zz].map(|value| value * shape.density);
    let precision = symmetric(q_x, q_x, xx)
        + symmetric(q_x, q_y, 2.0 * xy)
        + symmetric(q_x, q_z, 2.0 * xz)
        + symmetric(q_y, q_y, yy)
        + symmetric(q_y, q_z, 2.0 * yz)
        + symmetric(q_z, q_z, zz);
    let first = DVec3::new(x, y, z) * (shape.density / shape.unit.sqrt());
    let mean = shape.whitening.transpose() * (q_x * first.x + q_y * first.y + q_z * first.z) * -2.0;
    let nu = if shape.nu.is_finite() {
        -0.5 * std::f64::consts::LN_2 * sums.log * shape.density - (xx + yy + zz) / shape.nu
    } else {
        0.0
    };
    ShapeGradient { mean, precision, density: sums.value, nu, shadow: DVec2::ZERO }
}

/// Indices within `half` of `centre`, with a breath of rounding to spare.
fn reach(centre: f64, step: f64, half: f64, count: usize) -> Range<usize> {
    Extent::new(centre, step, 0.0, half).indices(count)
}

/// Strips of [`STRIP`] rows from an even start.
pub(super) fn strips(rows: Range<usize>) -> impl Iterator<Item = Range<usize>> {
    let rows = from_even(rows);
    rows.clone().step_by(STRIP).map(move |first| first..rows.end.min(first + STRIP))
}

/// A [`Field`] on a grid: the primitives that reach any of its voxels.
pub struct GridField<'a, R> {
    field: &'a Field<R>,
    pub(super) grid: Grid,
    /// Each with its index in the model, in order.
    pub(super) solids: Vec<(usize, Solid)>,
}

impl<R: Kernels> Field<R> {
    /// The field on a grid.
    pub fn on(&self, grid: &Grid) -> GridField<'_, R> {
        let chunks = threads::map(self.shapes.len().div_ceil(CHUNK), |chunk| {
            let all = (chunk * CHUNK..).zip(&self.shapes[chunk * CHUNK..]).take(CHUNK);
            let solids = all.map(|(i, shape)| (i, Solid::new(shape, grid)));
            solids.filter(|(_, solid)| !solid.slices().is_empty()).collect::<Vec<_>>()
        });
        GridField { field: self, grid: *grid, solids: chunks.concat() }
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
        for (place, (_, solid)) in self.solids.iter().enumerate() {
            for slab in &mut members[solid.first / SLAB..=(solid.last - 1) / SLAB] {
                slab.push(place as u32);
            }
        }
        let kernel = R::kernels(self.field.kernel, Projection::Affine).forward;
        let mut volume = vec![R::ZERO; nx * ny * nz];
        threads::for_each_chunk(&mut volume, SLAB * ny * nz, |slab, voxels| {
            let range = slab * SLAB..nx.min((slab + 1) * SLAB);
            let tall = ny.next_multiple_of(2);
            let mut canvas = Canvas::<R>::new(range.len() * tall, nz);
            let (stride, mut scratch, mut slices) = (canvas.stride, Scratch::new(), Vec::new());
            for &place in &members[slab] {
                let solid = &self.solids[place as usize].1;
                solid.slices_on(range.clone(), &self.grid, tall * stride, stride, &mut slices);
                kernel(&slices, solid.rows(), &mut canvas, &mut scratch);
            }
            for (row, voxels) in voxels.chunks_exact_mut(nz).enumerate() {
                voxels.copy_from_slice(canvas.row(row / ny * tall + row % ny, nz));
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
        let tall = ny.next_multiple_of(2);
        let mut canvas = Canvas::<R>::new(nx * tall, nz);
        let stride = canvas.stride;
        threads::for_each_chunk(&mut canvas.pixels, tall * stride, |x, pixels| {
            for (y, row) in pixels.chunks_exact_mut(stride).take(ny).enumerate() {
                row[..nz].iter_mut().enumerate().for_each(|(z, value)| *value = cotangent[[x, y, z]]);
            }
        });
        let kernel = R::kernels(field.kernel, Projection::Affine).solid;
        threads::for_each_chunk(&mut gradient.shapes, GATHER, |chunk, gradients| {
            let first = chunk * GATHER;
            let [begin, end] = [first, first + GATHER].map(|limit| solids.partition_point(|(i, _)| *i < limit));
            let (mut scratch, mut slices) = (Scratch::new(), Vec::new());
            for (i, solid) in &solids[begin..end] {
                solid.slices_on(0..nx, grid, tall * stride, stride, &mut slices);
                if !slices.is_empty() {
                    let sums = kernel(&slices, solid.rows(), &canvas, &mut scratch);
                    gradients[i - first].add(&pull_back(&sums, &field.shapes[*i]));
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
        let mut kept = there.solids.iter().map(|(i, _)| *i).peekable();
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
