//! From point samples of a density to the volume whose trilinear interpolation represents the density.
//!
//! A volume is interpreted as a continuous function by trilinear interpolation ([`super::trilinear`]). Interpolated
//! point samples are blurrier than the sampled function: along each axis the spectrum is multiplied by `sinc²(k) = 1 -
//! w²/12 + O(w⁴)`, `w = 2πk`, k in cycles per voxel. So that projections of the interpolation match those of the
//! function, the values c of the volume follow from the samples f by the compact scheme of fourth order
//!
//! ```text
//! (c_{j-1} + 10 c_j + c_{j+1})/12 = f_j     along each axis; at both ends (11 c_0 + c_1)/12 = f_0
//! ```
//!
//! whose left side has the spectrum `(10 + 2 cos w)/12 = 1 - w²/12 + O(w⁴)`. Not in the paper.

use ndarray::Array3;
use trgs_core::geometry::Volume;
use trgs_core::numeric::threads;

/// Weight of each neighbour in the scheme.
const SIDE: f64 = 1.0 / 12.0;

/// The volume whose trilinear interpolation represents the function that was sampled.
///
/// `samples` holds the function at the voxel centres, attenuation per scene unit; the result is correct to fourth order
/// in the spacing. The scheme can produce negative values beside sharp edges; they become 0 if no sample is negative.
///
/// Not in the paper. Tests: `the_scheme_is_undone_by_its_stencil`, `projections_of_the_interpolant_are_those_of_the_function`,
/// `a_constant_and_a_single_voxel_stay`.
pub fn interpolant(samples: &Volume) -> Volume {
    let [_, ny, nz] = samples.grid.shape;
    let slice = ny * nz;
    let mut values: Vec<f64> = samples.values.iter().map(|&value| f64::from(value)).collect();
    threads::for_each_chunk(&mut values, slice, |_, slice| {
        slice.chunks_exact_mut(nz).for_each(|line| solve(line, 1));
        solve(slice, nz);
    });
    solve(&mut values, slice);
    let floor = if samples.values.iter().any(|&value| value < 0.0) { f64::NEG_INFINITY } else { 0.0 };
    let values = values.into_iter().map(|value| if value < floor { floor as f32 } else { value as f32 }).collect();
    let values = Array3::from_shape_vec(samples.grid.shape, values).expect("a value for each voxel");
    Volume { grid: samples.grid, values }
}

/// Solves the scheme along the first axis of `values`, whose rows have `width` elements.
///
/// Elimination needs no pivots, since the matrix is diagonally dominant.
fn solve(values: &mut [f64], width: usize) {
    let n = values.len() / width;
    if n < 2 {
        return;
    }
    let middle = |row: usize| if row == 0 || row == n - 1 { 1.0 - SIDE } else { 1.0 - 2.0 * SIDE };
    let mut upper = vec![0.0; n];
    for row in 0..n {
        let (before, here) = values.split_at_mut(row * width);
        let pivot = if row == 0 { middle(row) } else { middle(row) - SIDE * upper[row - 1] };
        upper[row] = SIDE / pivot;
        if row == 0 {
            here[..width].iter_mut().for_each(|value| *value /= pivot);
        } else {
            let last = &before[(row - 1) * width..];
            here[..width].iter_mut().zip(last).for_each(|(value, last)| *value = (*value - SIDE * last) / pivot);
        }
    }
    for row in (0..n - 1).rev() {
        let (here, after) = values.split_at_mut((row + 1) * width);
        let here = &mut here[row * width..];
        here.iter_mut().zip(&after[..width]).for_each(|(value, after)| *value -= upper[row] * after);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tolerances::largest;
    use crate::trilinear;
    use trgs_core::geometry::{Beam, Detector, Grid, Scanner};
    use trgs_core::numeric::elementary::exp;

    fn scanner(grid: Grid) -> Scanner {
        let detector = Detector { rows: 40, columns: 40, pitch_v: 0.08, pitch_u: 0.08, offset_u: 0.0, offset_v: 0.0 };
        Scanner { beam: Beam::Cone { dso: 5.0, dsd: 7.0 }, detector, grid }
    }

    #[test]
    fn the_scheme_is_undone_by_its_stencil() {
        let grid = Grid { shape: [5, 4, 7], ..Grid::cube(8) };
        let values = Array3::from_shape_fn((5, 4, 7), |(x, y, z)| 30.0 + ((x * 7 + y * 5 + z * 3) % 11) as f32);
        let samples = Volume::new(grid, values).unwrap();
        let found = interpolant(&samples).values;
        let at = |index: [usize; 3]| f64::from(found[index]);
        for ((x, y, z), &sample) in samples.values.indexed_iter() {
            let mut total = 0.0;
            for dx in -1..=1_isize {
                for dy in -1..=1_isize {
                    for dz in -1..=1_isize {
                        // Beyond an end, the value at the end is repeated.
                        let moved = |i: usize, d: isize, n: usize| i.saturating_add_signed(d).min(n - 1);
                        let weight = |d: isize| if d == 0 { 10.0 / 12.0 } else { 1.0 / 12.0 };
                        let index = [moved(x, dx, 5), moved(y, dy, 4), moved(z, dz, 7)];
                        total += weight(dx) * weight(dy) * weight(dz) * at(index);
                    }
                }
            }
            within!((total - f64::from(sample)).abs(), "{x} {y} {z}: {total} and {sample}");
        }
    }

    /// A Gaussian ball slightly wider than a voxel, off the voxel centres, has known projections.
    ///
    /// The remaining error is the interpolation's content above the grid's highest frequency.
    #[test]
    fn projections_of_the_interpolant_are_those_of_the_function() {
        let grid = Grid::cube(32);
        let (scale, centre) = (1.2 * grid.spacing.x, glam::DVec3::new(0.11, -0.07, 0.05));
        let density = |point: glam::DVec3| exp(-(point - centre).length_squared() / (2.0 * scale * scale));
        let values = Array3::from_shape_fn((32, 32, 32), |(x, y, z)| density(grid.centre([x, y, z])) as f32);
        let samples = Volume::new(grid, values).unwrap();
        let (scanner, angle) = (scanner(grid), 0.7);
        let view = scanner.view(angle);
        let error = |volume: &Volume| {
            let seen = trilinear::project(volume, &scanner, &[angle]).unwrap();
            let mut worst = 0.0_f64;
            for ((_, row, column), &value) in seen.images.indexed_iter() {
                let ray = scanner.ray(&view, row, column);
                let direction = ray.direction.normalize();
                let offset = centre - ray.origin;
                let apart = offset.length_squared() - offset.dot(direction) * offset.dot(direction);
                let expected = scale * std::f64::consts::TAU.sqrt() * exp(-apart / (2.0 * scale * scale));
                worst = worst.max((f64::from(value) - expected).abs());
            }
            worst
        };
        let (of_samples, of_interpolant) = (error(&samples), error(&interpolant(&samples)));
        assert!(of_interpolant < of_samples / 2.0, "{of_interpolant} and {of_samples}");
    }

    #[test]
    fn a_constant_and_a_single_voxel_stay() {
        for shape in [[6, 5, 4], [1, 1, 1], [3, 1, 2]] {
            let grid = Grid { shape, ..Grid::cube(8) };
            let samples = Volume::new(grid, Array3::from_elem(shape, 0.7)).unwrap();
            let found = interpolant(&samples);
            within!(largest(found.values.mapv(|value| value - 0.7)), "{shape:?}: {:?}", found.values);
        }
    }

    #[test]
    fn negative_values_come_from_negative_samples_alone() {
        let grid = Grid::cube(8);
        let mut values = Array3::zeros([8; 3]);
        values[[4, 4, 4]] = 1.0;
        let found = interpolant(&Volume::new(grid, values.clone()).unwrap());
        assert!(found.values.iter().all(|value| *value >= 0.0));
        beyond!("peak", found.values[[4, 4, 4]]);
        values[[0, 0, 0]] = -0.1;
        let found = interpolant(&Volume::new(grid, values).unwrap()).values;
        beyond!("trough", -found.iter().copied().fold(0.0, f32::min));
    }
}
