//! Initial primitives on bright voxels of a first reconstruction, on given points, or at random.
//!
//! Not in the paper: the rules are R²-Gaussian's, but points lie at voxel centres (R²-Gaussian's lie at voxel corners).

use super::{KernelKind, Parameters, Primitives};
use crate::error::{Error, Result};
use crate::geometry::{Grid, Volume};
use crate::numeric::{rng, threads};
use crate::setting::{Setting, Text};
use glam::DVec3;
use kiddo::{ImmutableKdTree, SquaredEuclidean};
use rand::RngExt;
use rand::seq::index;

/// Points per parallel task.
const CHUNK: usize = 512;
/// Lower bound on squared distances of neighbours, scene units squared.
const CLOSEST: f64 = 1e-6;

/// An initial point and the density there.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Point {
    /// Position, scene units.
    pub position: DVec3,
    /// Attenuation per scene unit.
    pub density: f64,
}

/// Draws `n` voxels above `threshold` without replacement, in the order of the volume.
///
/// All of them are returned if there are fewer. `threshold` is attenuation per scene unit.
///
/// # Errors
/// When fewer than four voxels are above the threshold.
pub fn bright_voxels(volume: &Volume, threshold: f64, n: usize, seed: u64) -> Result<Vec<Point>> {
    let values = volume.values.as_slice().expect("volumes are in standard layout");
    let is_bright = |voxel: &usize| f64::from(values[*voxel]) > threshold;
    let mut bright = Vec::with_capacity((0..values.len()).filter(is_bright).count());
    bright.extend((0..values.len()).filter(is_bright));
    if bright.len() < 4 {
        return Err(Error::invalid(
            "initialisation.threshold",
            format!("{threshold} with {} voxels above it", bright.len()),
            "at least 4 voxels of the first reconstruction above it",
            "lower it, or start from random points: " + Text::set("initialisation.from", "random"),
        ));
    }
    let mut random = rng::stream(seed, rng::Purpose::Initialisation, 0, 0);
    let mut chosen = index::sample(&mut random, bright.len(), n.min(bright.len())).into_vec();
    chosen.sort_unstable();
    let point = |i: usize| {
        let (voxel, [_, ny, nz]) = (bright[i], volume.grid.shape);
        let index = [voxel / (ny * nz), voxel / nz % ny, voxel % nz];
        Point { position: volume.grid.centre(index), density: f64::from(values[voxel]) }
    };
    Ok(chosen.into_iter().map(point).collect())
}

/// Draws `n` points uniformly in the grid's box, with densities uniform in [0, 1).
pub fn random_points(grid: &Grid, n: usize, seed: u64) -> Vec<Point> {
    let point = |i: usize| {
        let mut random = rng::stream(seed, rng::Purpose::Initialisation, 1, i as u64);
        let mut uniform = || random.random::<f64>();
        Point { position: grid.min + DVec3::new(uniform(), uniform(), uniform()) * grid.size(), density: uniform() }
    };
    (0..n).map(point).collect()
}

/// Round primitives on points, with density × `factor` and degrees of freedom `nu`.
///
/// The scale is the root mean square distance to the three nearest other points, scene units.
///
/// # Errors
/// With fewer than four points, or a coordinate or density that is not finite.
pub fn primitives(points: &[Point], kernel: KernelKind, factor: f64, nu: f64) -> Result<Primitives> {
    if points.len() < 4 {
        let remedy = "raise " + Setting::Points;
        return Err(Error::invalid("initial points", points.len(), "at least 4", remedy));
    }
    if let Some(i) = points.iter().position(|p| !(p.position.is_finite() && p.density.is_finite())) {
        return Err(Error::invalid(
            format!("initial point {i}"),
            format!("{:?}", points[i]),
            "finite numbers",
            "correct this row in the file of initial points, or delete it",
        ));
    }
    let positions: Vec<[f64; 3]> = points.iter().map(|p| p.position.to_array()).collect();
    let tree: ImmutableKdTree<f64, 3> = ImmutableKdTree::new_from_slice(&positions).map_err(|error| {
        Error::invalid(
            "initial points",
            format!("{error:?}"),
            "points that a kd-tree can hold",
            "remove repeated points from the file of initial points",
        )
    })?;
    let mut spread = vec![0.0; points.len()];
    threads::for_each_chunk(&mut spread, CHUNK, |chunk, spread| {
        for (i, spread) in spread.iter_mut().enumerate() {
            let four = std::num::NonZero::new(4).expect("4 is not 0");
            let nearest = tree.query(&positions[chunk * CHUNK + i]).nearest_n::<SquaredEuclidean<f64>>(four).execute();
            // The first of the four is the point itself.
            let mean_square = nearest[1..].iter().map(|n| n.distance).sum::<f64>() / 3.0;
            *spread = mean_square.max(CLOSEST).sqrt();
        }
    });
    let m = points.len();
    Primitives::new(Parameters {
        mean: positions,
        scale: spread.into_iter().map(|s| [s; 3]).collect(),
        quaternion: vec![[1.0, 0.0, 0.0, 0.0]; m],
        density: points.iter().map(|p| p.density * factor).collect(),
        nu: vec![if kernel == KernelKind::Gaussian { f64::INFINITY } else { nu }; m],
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tolerances::relative;
    use ndarray::Array3;

    #[test]
    fn a_lattice_gets_its_spacing_as_scale() {
        let points: Vec<Point> = (0..64)
            .map(|i| Point {
                position: DVec3::new((i / 16) as f64, (i / 4 % 4) as f64, (i % 4) as f64) * 0.1,
                density: 0.5,
            })
            .collect();
        let p = primitives(&points, KernelKind::StudentT, 0.15, 10.0).unwrap().parameters;
        for (scale, density) in p.scale.iter().zip(&p.density) {
            within!(relative(scale[0], 0.1));
            within!("density", relative(*density, 0.075));
        }
    }

    #[test]
    fn bright_voxels_are_distinct_voxel_centres_above_the_threshold() {
        let grid = Grid::cube(8);
        let volume =
            Volume::new(grid, Array3::from_shape_fn((8, 8, 8), |(x, y, _)| if x > 3 { 0.1 * y as f32 } else { 0.0 }))
                .unwrap();
        let threshold = 0.25;
        let points = bright_voxels(&volume, threshold, 50, 3).unwrap();
        assert_eq!(points.len(), 50);
        assert!(points.iter().all(|p| p.density > threshold && p.position.x > 0.0));
        assert!(points.windows(2).all(|w| w[0].position != w[1].position));
        assert_eq!(bright_voxels(&volume, 0.25, 50, 3).unwrap(), points);
        assert_ne!(bright_voxels(&volume, 0.25, 50, 4).unwrap(), points);
        assert_eq!(bright_voxels(&volume, 0.25, 10_000, 3).unwrap().len(), 4 * 8 * 5);
    }

    #[test]
    fn a_volume_without_bright_voxels_is_refused() {
        let volume = Volume::new(Grid::cube(4), Array3::zeros((4, 4, 4))).unwrap();
        assert!(bright_voxels(&volume, 0.05, 10, 0).unwrap_err().to_string().contains("threshold"));
    }
}
