//! The field at voxel centres, slice by slice along x, and the adjoint. A slice is a plane of pixels (rows = y,
//! columns = z) for the same kernels as the projections, with the exponent (ν+3)/2 of `[Eq. 2]`.

use super::footprint::{Extent, from_even, symmetric};
use super::kernel::{Canvas, Plane, STRIP, Scratch, Sums};
use super::kernels::Kernels;
use super::shape::{CHUNK, Shape, ShapeGradient};
use super::{Field, FieldGradient, Projection};
use crate::numeric::threads;
use crate::scene::Grid;
use glam::{DVec2, DVec3};
use ndarray::{Array3, ArrayView3};
use std::ops::Range;

/// Primitives whose gradients one task gathers.
const GATHER: usize = 16;

/// A primitive on a grid. With (X, Y, Z) the distance of a voxel from its centre, M = Q·U for the orthogonal Q and
/// the triangular U of `y = b·Y + ab·Z + bx·X`, `z = a·Z + ax·X`, `x = xx·X`, and δ = x² + y² + z².
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Solid {
    /// The part that all slices share; `slant` is along z.
    plane: Plane,
    /// Rows by which the ridge moves per length along x, and what z and x gain, in units of √unit.
    ridge_x: f64,
    ax: f64,
    xx: f64,
    /// Half extent of the form's unit circle, in rows and in columns.
    half: [f64; 2],
    /// Slice of the centre, with a fraction, and the distance of slices.
    centre: f64,
    step: f64,
    first: usize,
    last: usize,
}

impl Solid {
    pub(super) fn new(shape: &Shape, grid: &Grid) -> Self {
        let (mx, my, mz) = (shape.whitening.x_axis, shape.whitening.y_axis, shape.whitening.z_axis);
        let (yz, yx) = (my.cross(mz), my.cross(mx));
        let b = my.length();
        let a = yz.length() / b;
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
            ..Plane::default()
        };
        let xx = shape.determinant() / (b * a * root);
        let slices = reach(place.x, grid.spacing.x, shape.limit.sqrt() / xx, grid.shape[0]);
        Self {
            plane,
            ridge_x: -my.dot(mx) / (b * b * grid.spacing.y),
            ax: yz.dot(yx) / (b * b * a * root),
            xx,
            half: [(1.0 / (plane.b * plane.b) + plane.slant * plane.slant / (plane.a * plane.a)).sqrt(), 1.0 / plane.a],
            centre: place.x,
            step: grid.spacing.x,
            first: slices.start,
            last: slices.end,
        }
    }

    pub(super) fn slices(&self) -> Range<usize> {
        self.first..self.last
    }

    /// The primitive in one slice, with the rows and columns it reaches there.
    pub(super) fn slice(&self, slice: usize, grid: &Grid) -> (Plane, Range<usize>, Range<usize>) {
        let offset = self.offset(slice);
        let mut plane = self.plane;
        plane.shift = self.ax * offset;
        let x = self.xx * offset;
        plane.floor = x * x;
        // z = 0 lies `across` columns from the centre; there the ridge is the middle of the slice's ellipse.
        let across = -plane.shift * self.half[1];
        plane.row_centre += self.ridge_x * offset;
        let left = (plane.limit - plane.floor).max(0.0).sqrt();
        let rows = reach(plane.row_centre + plane.slant * across, 1.0, left * self.half[0], grid.shape[1]);
        let columns = reach(plane.column_centre + across, 1.0, left * self.half[1], grid.shape[2]);
        (plane, rows, columns)
    }

    /// Distance of a slice from the centre along x.
    fn offset(&self, slice: usize) -> f64 {
        (slice as f64 - self.centre) * self.step
    }
}

/// The sums of a primitive over all its slices, in the axes of [`Solid`].
#[derive(Clone, Copy, Debug, Default)]
struct Moments {
    /// Σ G (x, y, z).
    first: DVec3,
    /// Σ G (xx, xy, xz, yy, yz, zz).
    second: [f64; 6],
    value: f64,
    log: f64,
}

impl Moments {
    /// Adds one slice; `x` is its third coordinate.
    fn add(&mut self, x: f64, sums: &Sums) {
        let [one, y, z, yy, yz, zz] = sums.distance;
        self.first += DVec3::new(x * one, y, z);
        for (total, part) in self.second.iter_mut().zip([x * x * one, x * y, x * z, yy, yz, zz]) {
            *total += part;
        }
        self.value += sums.value;
        self.log += sums.log;
    }

    fn pull_back(&self, shape: &Shape) -> ShapeGradient {
        let (my, mz) = (shape.whitening.y_axis, shape.whitening.z_axis);
        let q_x = my.cross(mz).normalize();
        let q_y = my.normalize();
        let q_z = q_x.cross(q_y);
        let [xx, xy, xz, yy, yz, zz] = self.second.map(|value| value * shape.density);
        let precision = symmetric(q_x, q_x, xx)
            + symmetric(q_x, q_y, 2.0 * xy)
            + symmetric(q_x, q_z, 2.0 * xz)
            + symmetric(q_y, q_y, yy)
            + symmetric(q_y, q_z, 2.0 * yz)
            + symmetric(q_z, q_z, zz);
        let first = self.first * (shape.density / shape.unit.sqrt());
        let mean = shape.whitening.transpose() * (q_x * first.x + q_y * first.y + q_z * first.z) * -2.0;
        let nu = if shape.nu.is_finite() {
            -0.5 * std::f64::consts::LN_2 * self.log * shape.density - (xx + yy + zz) / shape.nu
        } else {
            0.0
        };
        ShapeGradient { mean, precision, density: self.value, nu, shadow: DVec2::ZERO }
    }
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

impl<R: Kernels> Field<R> {
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
            for slice in &mut members[solid.slices()] {
                slice.push(i as u32);
            }
        }
        let kernel = R::kernels(self.kernel, Projection::Affine).forward;
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
        let kernel = R::kernels(self.kernel, Projection::Affine).backward;
        threads::for_each_chunk(&mut gradient.shapes, GATHER, |chunk, gradients| {
            let mut scratch = Scratch::new();
            for (i, gradient) in gradients.iter_mut().enumerate() {
                let solid = &solids[chunk * GATHER + i];
                let shape = &self.shapes[chunk * GATHER + i];
                let mut moments = Moments::default();
                for slice in solid.slices() {
                    let (plane, rows, columns) = solid.slice(slice, grid);
                    if !rows.is_empty() && !columns.is_empty() {
                        let sums = kernel(&plane, from_even(rows), columns, &canvases[slice], &mut scratch);
                        moments.add(solid.xx * solid.offset(slice), &sums);
                    }
                }
                if !solid.slices().is_empty() {
                    gradient.add(&moments.pull_back(shape));
                }
            }
        });
    }
}
