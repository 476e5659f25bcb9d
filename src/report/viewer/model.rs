//! Primitives in a scene: the ellipsoids on which their density is half of that at their centres.

use super::{Depth, coded};
use crate::geometry::Grid;
use crate::primitives::{KernelKind, Primitives};
use crate::scan::model::splat::half_width;
use glam::{DMat3, DVec3};
use ndarray::Array3;
use serde_json::Value;

/// Columns of a table of primitives; `model.js` and `viewer.js` know their order.
#[derive(Clone, Debug, Default)]
pub(super) struct Model {
    /// The centre, in voxels from the middle of the first.
    centre: [Vec<f64>; 3],
    /// The rows of the factor F of the ellipsoid's matrix F·Fᵀ, in voxels.
    factor: [[Vec<f64>; 3]; 3],
    /// What the colours show.
    quantities: Vec<(&'static str, Vec<f64>)>,
}

impl Model {
    pub(super) fn new(primitives: &Primitives, grid: &Grid, confidence: Option<Vec<f64>>) -> Self {
        let parameters = &primitives.parameters;
        let (first, per_voxel) = (grid.centre([0; 3]), DMat3::from_diagonal(DVec3::ONE / grid.spacing));
        let factor = |(i, nu): (usize, &f64)| per_voxel * parameters.root(i) * half_width(*nu);
        let factors: Vec<DMat3> = parameters.nu.iter().enumerate().map(factor).collect();
        let place = |mean: &[f64; 3], axis: usize| (mean[axis] - first[axis]) / grid.spacing[axis];
        let nu = (primitives.kernel == KernelKind::StudentT).then(|| ("ν", parameters.nu.clone()));
        let confidence = confidence.map(|confidence| ("confidence", confidence));
        Self {
            centre: [0, 1, 2].map(|axis| parameters.mean.iter().map(|mean| place(mean, axis)).collect()),
            factor: [0, 1, 2].map(|row| [0, 1, 2].map(|column| factors.iter().map(|f| f.col(column)[row]).collect())),
            quantities: nu.into_iter().chain(confidence).chain([("density", parameters.density.clone())]).collect(),
        }
    }

    /// In voxels that are blocks of the former.
    pub(super) fn reduce(&mut self, block: DVec3) {
        for axis in 0..3 {
            self.centre[axis].iter_mut().for_each(|at| *at = (*at + 0.5) / block[axis] - 0.5);
            self.factor[axis].iter_mut().flatten().for_each(|entry| *entry /= block[axis]);
        }
    }

    /// What the script reads: no column without primitives.
    pub(super) fn json(&self) -> Vec<Value> {
        let places = self.centre.iter().chain(self.factor.iter().flatten()).map(|column| ("", column));
        let all = places.chain(self.quantities.iter().map(|(name, column)| (*name, column)));
        let values = |column: &Vec<f64>| Array3::from_shape_fn((column.len(), 1, 1), |(i, ..)| column[i] as f32);
        all.filter(|(_, column)| !column.is_empty())
            .map(|(name, column)| coded(name, &values(column), Depth::Sixteen))
            .collect()
    }
}
