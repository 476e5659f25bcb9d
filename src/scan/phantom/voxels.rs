//! Mean densities of voxels.

use super::solid::{Coverage, Solid};
use ndarray::Array3;
use trgs_core::geometry::{Grid, Volume};
use trgs_core::numeric::{reduce, threads};

/// The density within a voxel.
#[derive(Clone)]
enum Voxel {
    /// The same everywhere.
    Even(f64),
    /// Densities at evenly spaced points.
    Points(Vec<f64>),
}

impl Voxel {
    /// Adds the covered part of a solid to the voxel.
    fn put(&mut self, solid: &Solid, covered: &Coverage) {
        match (&mut *self, covered) {
            (_, Coverage::Nothing) => {}
            (_, Coverage::Everything) if solid.displaces() => *self = Self::Even(solid.density()),
            (Self::Even(density), Coverage::Everything) => *density = solid.over(*density),
            (Self::Points(values), Coverage::Everything) => values.iter_mut().for_each(|d| *d = solid.over(*d)),
            (Self::Points(values), Coverage::Points(inside)) => {
                values.iter_mut().zip(inside).filter(|(_, inside)| **inside).for_each(|(d, _)| *d = solid.over(*d));
            }
            (Self::Even(density), Coverage::Points(inside)) => {
                let value = |inside: &bool| if *inside { solid.over(*density) } else { *density };
                *self = Self::Points(inside.iter().map(value).collect());
            }
        }
    }

    fn mean(&self) -> f64 {
        match self {
            Self::Even(density) => *density,
            Self::Points(values) => reduce::sum(values) / values.len() as f64,
        }
    }
}

/// See [`super::Phantom::voxelize`].
pub(super) fn means(solids: &[Solid], grid: &Grid, samples: usize) -> Volume {
    let [_, ny, nz] = grid.shape;
    let half = grid.spacing / 2.0;
    let mut values = Array3::zeros(grid.shape);
    let slices = values.as_slice_mut().expect("a new array is in C order");
    threads::for_each_chunk(slices, ny * nz, |x, slice| {
        let mut voxels = vec![Voxel::Even(0.0); slice.len()];
        for solid in solids {
            let low = (solid.centre() - solid.reach() - grid.min) / grid.spacing;
            let high = (solid.centre() + solid.reach() - grid.min) / grid.spacing;
            if (x as f64) > high.x || ((x + 1) as f64) < low.x {
                continue;
            }
            let range = |low: f64, high: f64, n: usize| {
                low.clamp(0.0, n as f64) as usize..high.ceil().clamp(0.0, n as f64) as usize
            };
            for y in range(low.y, high.y, ny) {
                for z in range(low.z, high.z, nz) {
                    voxels[y * nz + z].put(solid, &solid.coverage(grid.centre([x, y, z]), half, samples));
                }
            }
        }
        for (value, voxel) in slice.iter_mut().zip(voxels) {
            *value = voxel.mean() as f32;
        }
    });
    Volume { grid: *grid, values }
}
