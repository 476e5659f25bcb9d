//! The known object, which resolves ambiguities that projections cannot.

use super::RESEMBLES;
use super::held_out::{Hypothesis, reconstruct};
use super::reduced::Reduced;
use glam::DVec3;
use ndarray::{Array2, Array3};
use serde::Serialize;
use trgs_core::error::Result;
use trgs_core::geometry::Grid;
use trgs_core::numeric::{reduce, threads};
use trgs_scan::Dataset;
use trgs_scan::trilinear::Trilinear;

/// Points along each axis of a coarse voxel, for the mean of the reference there.
const SAMPLES: usize = 2;

/// The source of the reference.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Source {
    /// The true volume.
    TrueVolume,
    /// The initial points of a reconstruction. They may have been made from these very views.
    InitialPoints,
}

/// The object on a coarse grid.
pub(super) struct Reference {
    pub(super) source: Source,
    values: Array3<f64>,
}

/// Resemblance of a reconstruction to the reference.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Resemblance {
    /// Pearson's correlation of the voxels, for the best of the four quarter turns.
    pub correlation: f64,
    /// Quarter turns to add to every angle, after the convention's correction.
    pub quarter_turns: usize,
}

impl Reference {
    /// The true volume, or else the initial points; `None` without either.
    pub(super) fn new(dataset: &Dataset, grid: &Grid) -> Option<Self> {
        let found = match (&dataset.truth, &dataset.initial_points) {
            (Some(truth), _) => (Source::TrueVolume, sample(&Trilinear::new(truth), grid)),
            (None, Some(points)) => (Source::InitialPoints, gather(points, grid)),
            (None, None) => return None,
        };
        let varies = found.1.iter().any(|value| *value != found.1[[0, 0, 0]]);
        varies.then_some(Self { source: found.0, values: found.1 })
    }

    /// Resemblance of reconstructions from all views, under each convention with its offset.
    pub(super) fn compare(&self, scan: &Reduced, hypotheses: &[Hypothesis]) -> Result<Vec<Resemblance>> {
        let one = |i: usize| {
            let (scanner, views) = scan.read_as(&hypotheses[i].0, hypotheses[i].1);
            let (_, volume) = reconstruct(&scanner, &views)?;
            Ok(self.best_turn(&volume.values))
        };
        threads::map(hypotheses.len(), one).into_iter().collect()
    }

    fn best_turn(&self, values: &Array3<f32>) -> Resemblance {
        let of = |quarter_turns: usize| Resemblance {
            correlation: correlation(values, &turned(&self.values, quarter_turns)),
            quarter_turns,
        };
        let as_stated = of(0);
        let best = (1..4).map(of).fold(as_stated, |a, b| if b.correlation > a.correlation { b } else { a });
        if best.correlation > as_stated.correlation + RESEMBLES { best } else { as_stated }
    }
}

/// `f(R x)`, R a number of quarter turns counter-clockwise: the object if stated angles are too small.
fn turned(values: &Array3<f64>, quarter_turns: usize) -> Array3<f64> {
    let (nx, ny, _) = values.dim();
    Array3::from_shape_fn(values.dim(), |(x, y, z)| match quarter_turns {
        0 => values[[x, y, z]],
        1 => values[[nx - 1 - y, x, z]],
        2 => values[[nx - 1 - x, ny - 1 - y, z]],
        _ => values[[y, ny - 1 - x, z]],
    })
}

/// Means of a function over the voxels of a grid.
fn sample(density: &Trilinear, grid: &Grid) -> Array3<f64> {
    let within = |i: usize| (i as f64 + 0.5) / SAMPLES as f64 - 0.5;
    Array3::from_shape_fn(grid.shape, |(x, y, z)| {
        let centre = grid.centre([x, y, z]);
        let point =
            |i: usize| DVec3::new(within(i % SAMPLES), within(i / SAMPLES % SAMPLES), within(i / SAMPLES / SAMPLES));
        let count = SAMPLES * SAMPLES * SAMPLES;
        reduce::sum_by(count, &|i| density.at(centre + point(i) * grid.spacing)) / count as f64
    })
}

/// Sums of the densities of points over the voxels of a grid.
fn gather(points: &Array2<f64>, grid: &Grid) -> Array3<f64> {
    let mut values = Array3::zeros(grid.shape);
    for point in points.rows() {
        let place = (DVec3::new(point[0], point[1], point[2]) - grid.min) / grid.spacing;
        let index = place.to_array().map(|place| if place >= 0.0 { place as usize } else { usize::MAX });
        if let Some(value) = values.get_mut(index) {
            *value += point[3];
        }
    }
    values
}

/// Pearson's correlation; 0 if either volume is constant.
fn correlation(a: &Array3<f32>, b: &Array3<f64>) -> f64 {
    let (a, b): (Vec<f64>, Vec<f64>) = (a.iter().map(|&value| f64::from(value)).collect(), b.iter().copied().collect());
    let mean = |values: &[f64]| reduce::sum(values) / values.len() as f64;
    let (mean_a, mean_b) = (mean(&a), mean(&b));
    let moment = |f: &dyn Fn(usize) -> f64| reduce::sum_by(a.len(), &f);
    let ab = moment(&|i| (a[i] - mean_a) * (b[i] - mean_b));
    let aa = moment(&|i| (a[i] - mean_a) * (a[i] - mean_a));
    let bb = moment(&|i| (b[i] - mean_b) * (b[i] - mean_b));
    if aa > 0.0 && bb > 0.0 { ab / (aa * bb).sqrt() } else { 0.0 }
}
