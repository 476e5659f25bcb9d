//! How long sampling a model will take, from the time of a few of its primitives.

use crate::geometry::{Grid, Scanner, Trajectory};
use crate::numeric::threads;
use crate::primitives::Primitives;
use crate::projector::{Field, Kernels, Projection};
use std::time::Instant;

/// Primitives that are measured.
const SAMPLE: usize = 48;
/// Values of primitives at pixels or voxels that take a few seconds at most: nothing is measured.
const FEW: f64 = 1e9;
/// Slices of the grid that are measured, by one worker.
const SLICES: usize = 8;

/// Seconds to sample primitives on a grid, about; 0 for little work.
pub fn seconds_to_voxelize<R: Kernels>(primitives: &Primitives, grid: &Grid, cutoff: f64) -> f64 {
    if primitives.len() as f64 * grid.voxels() as f64 <= FEW {
        return 0.0;
    }
    let (sample, factor) = sample(primitives);
    let [nx, ny, nz] = grid.shape;
    let slices = nx.min(SLICES);
    let block = grid.block([(nx - slices) / 2, 0, 0], [slices, ny, nz]);
    let tasks = nx.div_ceil(SLICES);
    let began = Instant::now();
    let _ = Field::<R>::new(&sample, cutoff).voxels(&block);
    began.elapsed().as_secs_f64() * factor * tasks.div_ceil(workers().min(tasks)) as f64
}

/// Seconds to project primitives to views, about; 0 for little work.
pub fn seconds_to_project<R: Kernels>(
    primitives: &Primitives,
    scanner: &Scanner,
    views: Trajectory<'_>,
    projection: Projection,
    cutoff: f64,
) -> f64 {
    if primitives.len() as f64 * views.len() as f64 * scanner.detector.pixels() as f64 <= FEW {
        return 0.0;
    }
    let (sample, factor) = sample(primitives);
    let began = Instant::now();
    let _ = Field::<R>::new(&sample, cutoff).seen_in(&views.view(scanner, 0), projection).image();
    began.elapsed().as_secs_f64() * factor * views.len() as f64
}

/// A few primitives, evenly spaced, and how many stand behind each.
pub fn sample(primitives: &Primitives) -> (Primitives, f64) {
    let all = &primitives.parameters;
    let step = all.len().div_ceil(SAMPLE).max(1);
    let parameters = all.select(&(0..all.len()).step_by(step).collect::<Vec<_>>());
    let factor = all.len() as f64 / parameters.len().max(1) as f64;
    (Primitives { kernel: primitives.kernel, parameters }, factor)
}

/// Workers that compute at the same time.
fn workers() -> usize {
    threads::count().min(threads::cores().unwrap_or(1)).max(1)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::primitives::{KernelKind, Parameters};

    #[test]
    fn a_sample_stands_for_all_primitives_and_costs_grow_with_them() {
        let of = |m: usize| {
            let mut parameters = Parameters::zeros(m);
            parameters.scale.fill([0.1; 3]);
            parameters.quaternion.fill([1.0, 0.0, 0.0, 0.0]);
            parameters.density.iter_mut().enumerate().for_each(|(i, density)| *density = 1.0 + i as f64);
            parameters.nu.fill(5.0);
            Primitives { kernel: KernelKind::StudentT, parameters }
        };
        assert_eq!(sample(&of(0)).0.len(), 0);
        let (few, factor) = sample(&of(20));
        assert_eq!((few.len(), factor), (20, 1.0));
        let (some, factor) = sample(&of(480));
        assert_eq!((some.len(), factor, some.parameters.density[1]), (48, 10.0, 11.0));
        assert_eq!(seconds_to_voxelize::<f64>(&of(100), &Grid::cube(6), 0.0), 0.0);
        // With a cutoff, few of the voxels are computed.
        let wide = Grid { shape: [8, 1, 20_000], ..Grid::cube(4) };
        assert!(seconds_to_voxelize::<f32>(&of(7000), &wide, 0.5) > 0.0);
        // The bits are those of one call.
        let (field, grid) = (Field::<f32>::new(&of(30), 0.0), Grid { shape: [41, 3, 2], ..Grid::cube(4) });
        let mut seen = Vec::new();
        let mut volume = Vec::new();
        let mut give = |values: &[f32], done| {
            volume.extend_from_slice(values);
            seen.push(done);
            if done < 40 { Ok(()) } else { Err("the end") }
        };
        let ended = threads::install(1, || field.on(&grid).by_slabs(&mut give)).unwrap();
        assert_eq!(volume, field.voxels(&grid).into_raw_vec_and_offset().0);
        assert_eq!((ended, seen), (Err("the end"), vec![16, 32, 41]));
    }
}
