//! The field at voxel centres, slice by slice along x, and the adjoint. A slice is a plane of pixels (rows = y,
//! columns = z) for the same kernels as the projections, with the exponent (ν+3)/2 of `[Eq. 2]`.

use super::footprint::symmetric;
use super::kernel::{Canvas, Plane, STRIP, Scratch, Sums};
use super::shape::{CHUNK, Shape, ShapeGradient};
use super::view::{backward_kernel, forward_kernel, from_even};
use super::{Field, FieldGradient, Projection};
use crate::numeric::{Real, threads};
use crate::scene::Grid;
use glam::DVec3;
use ndarray::{Array3, ArrayView3};
use std::ops::Range;

/// Primitives whose gradients one task gathers.
const GATHER: usize = 16;

/// The form `δ/unit = (b·y + ab·z + bx·x)² + (a·z + ax·x)² + (xx·x)²` of a primitive on a grid.
#[derive(Clone, Debug, Default)]
struct Solid {
    /// The part that all slices share.
    plane: Plane,
    bx: f64,
    ax: f64,
    xx: f64,
    /// Slice at which x = 0, with a fraction.
    centre: f64,
    /// Distance of slices.
    step: f64,
    slices: Range<usize>,
}

impl Solid {
    fn new(shape: &Shape, grid: &Grid) -> Self {
        let (mx, my, mz) = (shape.whitening.x_axis, shape.whitening.y_axis, shape.whitening.z_axis);
        let (yz, yx) = (my.cross(mz), my.cross(mx));
        let b = my.length();
        let a = yz.length() / b;
        let root = shape.unit.sqrt();
        let place = (shape.mean - grid.min) / grid.spacing - 0.5;
        let plane = Plane {
            row_centre: place.y,
            column_centre: place.z,
            row_step: grid.spacing.y,
            column_step: grid.spacing.z,
            b: b / root,
            ab: my.dot(mz) / (b * root),
            a: a / root,
            q: (shape.nu + 3.0) / 2.0,
            weight: shape.density,
            limit: shape.limit,
            ..Plane::default()
        };
        let xx = shape.determinant() / (b * a * root);
        let mut solid = Self {
            plane,
            bx: my.dot(mx) / (b * root),
            ax: yz.dot(yx) / (b * b * a * root),
            xx,
            centre: place.x,
            step: grid.spacing.x,
            slices: 0..0,
        };
        solid.slices = reach(place.x, grid.spacing.x, shape.limit.sqrt() / xx, grid.shape[0]);
        solid
    }

    /// The primitive in one slice, with the rows and columns it reaches there.
    fn slice(&self, slice: usize, grid: &Grid) -> (Plane, Range<usize>, Range<usize>) {
        let x = self.offset(slice);
        let mut plane = self.plane;
        plane.shift_b = self.bx * x;
        plane.shift_a = self.ax * x;
        plane.floor = self.xx * x * (self.xx * x);
        let left = (plane.limit - plane.floor).max(0.0).sqrt();
        let z = -plane.shift_a / plane.a;
        let y = -(plane.shift_b + plane.ab * z) / plane.b;
        let half_z = left / plane.a;
        let half_y = left * (plane.a * plane.a + plane.ab * plane.ab).sqrt() / (plane.a * plane.b);
        let rows = reach(plane.row_centre + y / plane.row_step, plane.row_step, half_y, grid.shape[1]);
        let columns = reach(plane.column_centre + z / plane.column_step, plane.column_step, half_z, grid.shape[2]);
        (plane, rows, columns)
    }

    /// Distance of a slice from the centre along x.
    fn offset(&self, slice: usize) -> f64 {
        (slice as f64 - self.centre) * self.step
    }

    /// From the sums over one slice to the gradient; `x` is the slice's distance from the centre.
    fn pull_back(&self, shape: &Shape, x: f64, sums: &Sums) -> ShapeGradient {
        let weight = self.plane.weight;
        let [s, sz, sy, szz, szy, syy] = sums.distance.map(|value| value * weight / shape.unit);
        let (ex, ey, ez) = (DVec3::X, DVec3::Y, DVec3::Z);
        let precision = symmetric(ex, ex, x * x * s)
            + symmetric(ex, ey, 2.0 * x * sy)
            + symmetric(ex, ez, 2.0 * x * sz)
            + symmetric(ey, ey, syy)
            + symmetric(ey, ez, 2.0 * szy)
            + symmetric(ez, ez, szz);
        let m = shape.whitening;
        let mean = m.transpose() * (m * DVec3::new(x * s, sy, sz)) * -2.0;
        let nu = if shape.nu.is_finite() {
            let mut moment = 0.0;
            for axis in [DVec3::X, DVec3::Y, DVec3::Z] {
                let row = m.transpose() * axis;
                moment += row.dot(precision * row);
            }
            -0.5 * std::f64::consts::LN_2 * sums.log * weight - moment / shape.nu
        } else {
            0.0
        };
        ShapeGradient { mean, precision, density: sums.value, nu }
    }
}

/// Indices within `half` of `centre`, with a breath of rounding to spare.
fn reach(centre: f64, step: f64, half: f64, count: usize) -> Range<usize> {
    super::footprint::pixels(centre, step, 0.0, half, count)
}

/// Strips of [`STRIP`] rows from an even start.
fn strips(rows: Range<usize>) -> impl Iterator<Item = Range<usize>> {
    let rows = from_even(rows);
    rows.clone().step_by(STRIP).map(move |first| first..rows.end.min(first + STRIP))
}

impl<R: Real> Field<R> {
    fn solids(&self, grid: &Grid) -> Vec<Solid> {
        let mut solids = vec![Solid::default(); self.shapes.len()];
        threads::for_each_chunk(&mut solids, CHUNK, |chunk, solids| {
            for (solid, shape) in solids.iter_mut().zip(&self.shapes[chunk * CHUNK..]) {
                *solid = Solid::new(shape, grid);
            }
        });
        solids
    }

    /// Values at the voxel centres, `[x, y, z]`.
    pub fn voxels(&self, grid: &Grid) -> Array3<R> {
        let [nx, ny, nz] = grid.shape;
        let solids = self.solids(grid);
        let mut members = vec![Vec::new(); nx];
        for (i, solid) in solids.iter().enumerate() {
            for slice in &mut members[solid.slices.clone()] {
                slice.push(i as u32);
            }
        }
        let kernel = forward_kernel::<R>(self.kernel, Projection::Affine);
        let slices = threads::map(nx, |x| {
            let mut canvas = Canvas::<R>::new(ny, nz);
            let mut scratch = Scratch::new();
            for &i in &members[x] {
                let (plane, rows, columns) = solids[i as usize].slice(x, grid);
                if !columns.is_empty() {
                    strips(rows).for_each(|strip| kernel(&plane, strip, columns.clone(), &mut canvas, 0, &mut scratch));
                }
            }
            (0..ny).flat_map(|y| canvas.row(y, nz).to_vec()).collect::<Vec<_>>()
        });
        Array3::from_shape_vec((nx, ny, nz), slices.concat()).expect("slices make up the volume")
    }

    /// Adds the gradient of `Σ cotangent·volume`; `cotangent` is `[x, y, z]`.
    ///
    /// # Panics
    /// If the cotangent does not have the grid's shape, or the gradient belongs to another field.
    pub fn pull_back_voxels(&self, grid: &Grid, cotangent: ArrayView3<'_, R>, gradient: &mut FieldGradient) {
        let [nx, ny, nz] = grid.shape;
        assert_eq!(cotangent.shape(), grid.shape, "shape of the cotangent");
        assert_eq!(gradient.shapes.len(), self.shapes.len(), "primitives of the gradient");
        let solids = self.solids(grid);
        let canvases = threads::map(nx, |x| {
            let mut canvas = Canvas::<R>::new(ny, nz);
            for y in 0..ny {
                canvas.row_mut(y, nz).iter_mut().enumerate().for_each(|(z, value)| *value = cotangent[[x, y, z]]);
            }
            canvas
        });
        let kernel = backward_kernel::<R>(self.kernel, Projection::Affine);
        threads::for_each_chunk(&mut gradient.shapes, GATHER, |chunk, gradients| {
            let mut scratch = Scratch::new();
            for (i, gradient) in gradients.iter_mut().enumerate() {
                let solid = &solids[chunk * GATHER + i];
                let shape = &self.shapes[chunk * GATHER + i];
                for x in solid.slices.clone() {
                    let (plane, rows, columns) = solid.slice(x, grid);
                    if !rows.is_empty() && !columns.is_empty() {
                        let sums = kernel(&plane, from_even(rows), columns, &canvases[x], &mut scratch);
                        gradient.add(&solid.pull_back(shape, solid.offset(x), &sums));
                    }
                }
            }
        });
    }
}
