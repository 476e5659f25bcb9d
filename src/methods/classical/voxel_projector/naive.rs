//! The ray weights written as plainly as possible, one ray at a time in world coordinates.
//!
//! Not in the paper.

use super::RayModel;
use glam::DVec3;
use trgs_core::geometry::{Grid, Ray};

/// `([x, y, z], a)` of all voxels with a weight on a ray, scene units; a voxel may occur twice.
pub fn weights(model: RayModel, grid: &Grid, ray: &Ray) -> Vec<([usize; 3], f64)> {
    match model {
        RayModel::Siddon => siddon(grid, ray),
        RayModel::Joseph => joseph(grid, ray),
    }
}

/// `[Siddon85]`: all crossings with planes between voxels; a segment belongs to its midpoint's voxel.
fn siddon(grid: &Grid, ray: &Ray) -> Vec<([usize; 3], f64)> {
    let mut crossings: Vec<f64> = (0..3)
        .filter(|&axis| ray.direction[axis] != 0.0)
        .flat_map(|axis| {
            (0..=grid.shape[axis]).map(move |plane| {
                (grid.min[axis] + plane as f64 * grid.spacing[axis] - ray.origin[axis]) / ray.direction[axis]
            })
        })
        .collect();
    crossings.sort_by(f64::total_cmp);
    let pieces = crossings.windows(2).map(|piece| (piece[1] - piece[0], (piece[0] + piece[1]) / 2.0));
    pieces
        .filter_map(|(length, middle)| {
            let index = ((ray.origin + ray.direction * middle - grid.min) / grid.spacing).floor();
            voxel(grid, index).map(|voxel| (voxel, length))
        })
        .collect()
}

/// `[Joseph82]`: one sample for each plane of centres along the axis closest to the ray, in voxels.
fn joseph(grid: &Grid, ray: &Ray) -> Vec<([usize; 3], f64)> {
    let per_voxel = (ray.direction / grid.spacing).abs();
    let horizontal = if per_voxel.x >= per_voxel.y { 0 } else { 1 };
    let main = if per_voxel.z > per_voxel[horizontal] { 2 } else { horizontal };
    let mut weights = Vec::new();
    for plane in 0..grid.shape[main] {
        let centre = grid.min[main] + (plane as f64 + 0.5) * grid.spacing[main];
        let t = (centre - ray.origin[main]) / ray.direction[main];
        let mut at = (ray.origin + ray.direction * t - grid.min) / grid.spacing - 0.5;
        at[main] = plane as f64;
        let low = at.floor();
        for corner in 0..8 {
            let step = DVec3::new(f64::from(corner & 1), f64::from(corner >> 1 & 1), f64::from(corner >> 2));
            let shares = DVec3::ONE - (at - low - step).abs();
            if let (true, Some(voxel)) = (step[main] == 0.0, voxel(grid, low + step)) {
                weights.push((voxel, shares.element_product() / per_voxel[main]));
            }
        }
    }
    weights
}

fn voxel(grid: &Grid, index: DVec3) -> Option<[usize; 3]> {
    let inside = (0..3).all(|axis| index[axis] >= 0.0 && index[axis] < grid.shape[axis] as f64);
    inside.then_some([index.x as usize, index.y as usize, index.z as usize])
}
