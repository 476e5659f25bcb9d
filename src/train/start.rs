//! The initial primitives of a run: at points of a first volume, of the dataset, or at random.

use crate::classical::algebraic::{Order, SartSettings, TvSettings, sart, tv};
use crate::classical::fdk::{Turn, Window, fdk};
use crate::classical::{RayModel, VoxelProjector};
use crate::config::{Config, Start};
use crate::error::{Error, Result};
use crate::numeric::elementary::exp;
use crate::primitives::Primitives;
use crate::primitives::initialisation::{self, Point};
use crate::scene::{Dataset, Volume};
use glam::DVec3;
use ndarray::{ArrayView1, Axis, Zip};
use std::ops::ControlFlow;

/// Iterations of SART for the first volume.
const PASSES: usize = 5;
/// Iterations with total variation for the first volume; the weight is that of [`TvSettings::default`].
const ITERATIONS: usize = 30;
/// Radius of the smoothing kernel in standard deviations.
const REACH: f64 = 3.0;

/// The initial primitives of a run.
///
/// # Errors
/// When the dataset does not have what the configuration asks for.
pub fn initial_primitives(dataset: &Dataset, config: &Config) -> Result<Primitives> {
    let config = &config.resolved(&dataset.scanner, dataset.train.len());
    let start = &config.initialisation;
    let points = match start.from {
        Start::Fdk | Start::SmoothedFdk | Start::Sart | Start::Tv => {
            let volume = first_volume(dataset, start.from, start.smoothing)?;
            initialisation::bright_voxels(&volume, start.threshold, config.model.points, config.seed)?
        }
        Start::Random => initialisation::random_points(&dataset.scanner.grid, config.model.points, config.seed),
        Start::Dataset => given(dataset)?,
    };
    initialisation::primitives(&points, config.model.kernel, start.density_factor, config.model.nu_initial)
}

/// The volume whose bright voxels are the first points.
fn first_volume(dataset: &Dataset, from: Start, smoothing: f64) -> Result<Volume> {
    let projector = VoxelProjector::new(&dataset.scanner, RayModel::Joseph)?;
    let mut quiet = |_: &_| ControlFlow::Continue(());
    match from {
        Start::Sart => {
            let order = Order::AngularDistance;
            let settings = SartSettings { iterations: PASSES, order, ..SartSettings::default() };
            sart::<f32>(&projector, &dataset.train, &settings, &mut quiet)
        }
        Start::Tv => {
            let settings = TvSettings { iterations: ITERATIONS, ..TvSettings::default() };
            tv::<f32>(&projector, &dataset.train, &settings, None, &mut quiet)
        }
        _ => {
            let volume = fdk(&dataset.scanner, &dataset.train, Window::RamLak, Turn::Full)?;
            Ok(if from == Start::SmoothedFdk { smoothed(volume, smoothing) } else { volume })
        }
    }
}

/// The initial points of the dataset.
fn given(dataset: &Dataset) -> Result<Vec<Point>> {
    let points = dataset.initial_points.as_ref().ok_or_else(|| {
        Error::invalid(
            "initialisation.from",
            "dataset",
            "a dataset with initial points (init_*.npy)",
            "use fdk or random",
        )
    })?;
    let point = |row: ArrayView1<'_, f64>| Point { position: DVec3::new(row[0], row[1], row[2]), density: row[3] };
    Ok(points.rows().into_iter().map(point).collect())
}

/// A volume convolved with a normal distribution of `sigma` voxels along each axis; edge voxels are repeated.
fn smoothed(mut volume: Volume, sigma: f64) -> Volume {
    let reach = (REACH * sigma).ceil() as usize;
    let weights: Vec<f64> = (0..=2 * reach)
        .map(|k| {
            let offset = k as f64 - reach as f64;
            exp(-offset * offset / (2.0 * sigma * sigma))
        })
        .collect();
    let total: f64 = weights.iter().sum();
    for axis in 0..3 {
        let before = volume.values.clone();
        let lanes = |axis| (volume.values.len_of(Axis(axis)), Axis(axis));
        let (n, axis) = lanes(axis);
        Zip::from(volume.values.lanes_mut(axis)).and(before.lanes(axis)).for_each(|mut out, line| {
            for (i, out) in out.iter_mut().enumerate() {
                let at = |k: usize| f64::from(line[(i + k).saturating_sub(reach).min(n - 1)]);
                let sum: f64 = weights.iter().enumerate().map(|(k, weight)| weight * at(k)).sum();
                *out = (sum / total) as f32;
            }
        });
    }
    volume
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::simulate::{Object, Plan, simulate};
    use crate::scene::{Beam, Detector, Grid, Noise, Phantom, Scanner};
    use crate::tolerances::largest;
    use ndarray::Array3;

    #[test]
    fn every_first_volume_has_its_points_on_the_object() {
        let detector = Detector { rows: 24, columns: 24, pitch_v: 0.16, pitch_u: 0.16, offset_u: 0.0, offset_v: 0.0 };
        let scanner = Scanner { beam: Beam::Cone { dso: 5.0, dsd: 7.0 }, detector, grid: Grid::cube(16) };
        let plan = Plan { views: 8, test_views: 0, noise: Noise::None, seed: 0 };
        let phantom = Phantom::by_name("torso", 0).unwrap();
        let scan = simulate("scan", Object::Phantom(&phantom), &scanner, &plan).unwrap();
        let truth = &scan.truth.as_ref().unwrap().values;
        // Random points would hit the object less often; FDK has streaks outside of it with so few views.
        assert!(truth.iter().filter(|value| **value > 0.0).count() * 2 < truth.len());
        let mut volumes = Vec::new();
        for from in [Start::Fdk, Start::SmoothedFdk, Start::Sart, Start::Tv] {
            let mut config = Config::default();
            (config.initialisation.from, config.model.points) = (from, 200);
            let primitives = initial_primitives(&scan, &config).unwrap();
            let on_object = (primitives.parameters.mean.iter())
                .filter(|mean| {
                    let place = (DVec3::from_array(**mean) - scanner.grid.min) / scanner.grid.spacing;
                    truth[place.to_array().map(|place| place as usize)] > 0.0
                })
                .count();
            assert!(primitives.len() == 200 && on_object >= 140, "{from:?}: {on_object} of {}", primitives.len());
            volumes.push(first_volume(&scan, from, config.initialisation.smoothing).unwrap().values);
        }
        assert!((0..4).all(|i| (0..i).all(|k| volumes[i] != volumes[k])));
    }

    #[test]
    fn smoothing_keeps_the_sum_and_has_its_variance() {
        let mut values = Array3::zeros((21, 19, 17));
        values[[10, 9, 8]] = 1.0;
        let grid = Grid { shape: [21, 19, 17], ..Grid::cube(20) };
        let found = smoothed(Volume::new(grid, values).unwrap(), 1.2).values;
        let sum: f64 = found.iter().map(|&value| f64::from(value)).sum();
        let second: f64 =
            found.indexed_iter().map(|((x, ..), &v)| f64::from(v) * (x as f64 - 10.0) * (x as f64 - 10.0)).sum();
        within!("sum", (sum - 1.0).abs());
        within!("variance", (second / sum - 1.44).abs());
        let even = Volume::new(Grid::cube(6), Array3::from_elem([6; 3], 0.3)).unwrap();
        within!("constant", largest(smoothed(even, 2.0).values - 0.3));
    }
}
