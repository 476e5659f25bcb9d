//! ∇ of a block by differences of neighbouring voxels, and its transpose.
//!
//! Along an axis of n voxels: `(f[i+1] - f[i-1])/2`, and at the two faces `f[1] - f[0]` and `f[n-1] - f[n-2]`. A side of 2 has
//! only the latter. Blocks are slices in the order `[x, y, z]`; along an axis they are runs of n slabs of voxels.

use crate::numeric::{Real, real};

/// The length of a slab, and of a run of slabs.
fn slabs(shape: [usize; 3], axis: usize) -> (usize, usize) {
    let slab = shape[axis + 1..].iter().product();
    (slab, slab * shape[axis])
}

/// Differences along an axis whose side is at least 2.
pub(super) fn forward<R: Real>(f: &[R], shape: [usize; 3], axis: usize) -> Vec<R> {
    let half = real::<R>(0.5);
    let (slab, run) = slabs(shape, axis);
    let mut differences = vec![R::ZERO; f.len()];
    for (d, f) in differences.chunks_exact_mut(run).zip(f.chunks_exact(run)) {
        let ends = [(0, slab, 0), (run - slab, run - slab, run - 2 * slab)];
        for (at, above, below) in ends {
            let pairs = f[above..][..slab].iter().zip(&f[below..][..slab]);
            d[at..][..slab].iter_mut().zip(pairs).for_each(|(d, (above, below))| *d = *above - *below);
        }
        let pairs = f[2 * slab..].iter().zip(f);
        d[slab..run - slab].iter_mut().zip(pairs).for_each(|(d, (above, below))| *d = half * (*above - *below));
    }
    differences
}

/// Adds the transpose of [`forward`] of `flux` to `out`.
pub(super) fn add_transpose<R: Real>(flux: &[R], shape: [usize; 3], axis: usize, out: &mut [R]) {
    let half = real::<R>(0.5);
    let (slab, run) = slabs(shape, axis);
    for (flux, out) in flux.chunks_exact(run).zip(out.chunks_exact_mut(run)) {
        let ends = [(0, slab, 0), (run - slab, run - slab, run - 2 * slab)];
        for (at, above, below) in ends {
            let flux = &flux[at..][..slab];
            out[above..][..slab].iter_mut().zip(flux).for_each(|(out, flux)| *out += *flux);
            out[below..][..slab].iter_mut().zip(flux).for_each(|(out, flux)| *out -= *flux);
        }
        let flux = &flux[slab..run - slab];
        out[2 * slab..].iter_mut().zip(flux).for_each(|(out, flux)| *out += half * *flux);
        out.iter_mut().zip(flux).for_each(|(out, flux)| *out -= half * *flux);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ndarray::Array3;

    #[test]
    fn differences_are_central_within_and_one_sided_at_the_faces() {
        assert_eq!(forward(&[1.0, 4.0, 9.0, 25.0], [1, 1, 4], 2), [3.0, 4.0, 10.5, 16.0]);
        assert_eq!(forward(&[1.0, 4.0], [1, 2, 1], 1), [3.0, 3.0]);
        let f = Array3::from_shape_fn((4, 6, 2), |(x, y, z)| (3 * x + 5 * y + 11 * z) as f64);
        for (axis, slope) in [3.0, 5.0, 11.0].into_iter().enumerate() {
            assert!(forward(f.as_slice().unwrap(), [4, 6, 2], axis).iter().all(|d| *d == slope), "axis {axis}");
        }
    }

    #[test]
    fn the_transpose_is_the_transpose_entry_by_entry() {
        for shape in [[2, 4, 6], [6, 2, 4], [4, 6, 2]] {
            for axis in 0..3 {
                let n: usize = shape.iter().product();
                let unit = |i: usize| (0..n).map(|j| f64::from(u8::from(i == j))).collect::<Vec<_>>();
                let columns: Vec<_> = (0..n).map(|i| forward(&unit(i), shape, axis)).collect();
                for i in 0..n {
                    let mut row = vec![0.0; n];
                    add_transpose(&unit(i), shape, axis, &mut row);
                    let is_column = row.iter().zip(&columns).all(|(x, column)| *x == column[i]);
                    assert!(is_column, "{shape:?}, axis {axis}, row {i}");
                }
            }
        }
    }
}
