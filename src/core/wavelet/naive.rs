//! The wavelet regularisation as plainly as it can be written `[Eq. 11]`–`[Eq. 15]`, in f64.
//!
//! The transform is a sum over the whole block. Neighbours are found by sorting all primitives, single bands by the inverse
//! transform, and the gradient by scattering.

use super::routing::Routing;
use super::{FLAT, Settings, WaveletLoss};
use crate::geometry::Grid;
use glam::DVec3;
use ndarray::{Array3, Array4};
use std::f64::consts::FRAC_1_SQRT_2;

/// The Haar function along one axis of a cell at a voxel.
fn haar(high: bool, cell: usize, voxel: usize) -> f64 {
    match (voxel / 2 == cell, high && voxel % 2 == 1) {
        (false, _) => 0.0,
        (true, false) => FRAC_1_SQRT_2,
        (true, true) => -FRAC_1_SQRT_2,
    }
}

/// The basis function of a band and a cell at a voxel.
fn basis((band, i, j, k): (usize, usize, usize, usize), (x, y, z): (usize, usize, usize)) -> f64 {
    haar(band & 4 != 0, i, x) * haar(band & 2 != 0, j, y) * haar(band & 1 != 0, k, z)
}

/// Coefficients `[band, X/2, Y/2, Z/2]` of a block, one level `[Eq. 11]`.
pub fn transform(block: &Array3<f64>) -> Array4<f64> {
    let (nx, ny, nz) = block.dim();
    Array4::from_shape_fn((8, nx / 2, ny / 2, nz / 2), |of| {
        block.indexed_iter().map(|(voxel, value)| basis(of, voxel) * value).sum()
    })
}

/// The block of coefficients `[band, X/2, Y/2, Z/2]` `[Eq. 11]`.
pub fn inverse_transform(coefficients: &Array4<f64>) -> Array3<f64> {
    let (_, nx, ny, nz) = coefficients.dim();
    Array3::from_shape_fn((2 * nx, 2 * ny, 2 * nz), |voxel| {
        coefficients.indexed_iter().map(|(of, value)| basis(of, voxel) * value).sum()
    })
}

/// The contribution of one band of one level (from 1) to a block `[Eq. 11]`.
///
/// The block is transformed, all other coefficients are set to zero, and the rest is transformed back.
pub fn alone(block: &Array3<f64>, level: usize, band: usize) -> Array3<f64> {
    let mut coefficients = transform(block);
    for (b, mut values) in coefficients.outer_iter_mut().enumerate() {
        if level > 1 && b == 0 {
            let coarser = alone(&values.to_owned(), level - 1, band);
            values.assign(&coarser);
        } else if level > 1 || b != band {
            values.fill(0.0);
        }
    }
    inverse_transform(&coefficients)
}

/// The number of confident primitives among the K nearest of each voxel, by sorting all `[Eq. 12]`, `[Eq. 13]`.
pub fn route(grid: &Grid, means: &[[f64; 3]], confidence: &[f64], settings: &Settings) -> Routing {
    let neighbours = settings.neighbours.min(means.len());
    let high = Array3::from_shape_fn(grid.shape, |(x, y, z)| {
        let centre = grid.centre([x, y, z]);
        let mut order: Vec<(f64, usize)> =
            means.iter().enumerate().map(|(i, &mean)| ((DVec3::from(mean) - centre).length_squared(), i)).collect();
        order.sort_by(|a, b| a.partial_cmp(b).expect("finite distances"));
        order[..neighbours].iter().filter(|(_, i)| confidence[*i] >= settings.threshold).count() as u16
    });
    Routing { high, neighbours }
}

/// The two voxels of a difference along an axis of n voxels, and its divisor.
fn ends(i: usize, n: usize) -> (usize, usize, f64) {
    if i == 0 {
        (0, 1, 1.0)
    } else if i == n - 1 {
        (n - 2, n - 1, 1.0)
    } else {
        (i - 1, i + 1, 2.0)
    }
}

/// Value and gradient of the wavelet loss `[Eq. 14]`, `[Eq. 15]`.
pub fn wavelet_loss(block: &Array3<f64>, routing: &Routing, settings: &Settings) -> WaveletLoss<f64> {
    let (n, bands) = (block.len() as f64, 6.0 * settings.levels as f64);
    let mut sum = WaveletLoss { value: 0.0, enhancement: 0.0, suppression: 0.0, gradient: Array3::zeros(block.dim()) };
    for (level, band) in (1..=settings.levels).flat_map(|level| (1..=6).map(move |band| (level, band))) {
        let f = alone(block, level, band);
        let mut d_f = Array3::zeros(block.dim());
        for ((x, y, z), &high) in routing.high.indexed_iter() {
            let voxel = [x, y, z];
            let along = [0, 1, 2].map(|axis| {
                let (below, above, span) = ends(voxel[axis], block.shape()[axis]);
                let at = |i: usize| {
                    let mut voxel = voxel;
                    voxel[axis] = i;
                    voxel
                };
                (at(below), at(above), span)
            });
            let slope = along.map(|(below, above, span)| (f[above] - f[below]) / span);
            let g = (slope.iter().map(|s| s * s).sum::<f64>() + FLAT).sqrt();
            let high = f64::from(high) / routing.neighbours as f64;
            let (e, s) = (settings.enhancement * high / bands, (1.0 - high) / bands);
            sum.enhancement += e * g / n;
            sum.suppression += s * g / n;
            let d_g = (settings.suppress * s - settings.enhance * e) / n;
            for ((below, above, span), slope) in along.into_iter().zip(slope) {
                d_f[above] += d_g * slope / g / span;
                d_f[below] -= d_g * slope / g / span;
            }
        }
        // Extracting a band is an orthogonal projection, which is its own transpose.
        sum.gradient += &alone(&d_f, level, band);
    }
    sum.value = settings.suppress * sum.suppression - settings.enhance * sum.enhancement;
    sum
}
