//! ∇ of a block by differences of neighbouring voxels, and its transpose.
//!
//! Along an axis of n voxels: `(f[i+1] - f[i-1])/2`, and at the two faces `f[1] - f[0]` and `f[n-1] - f[n-2]`. A side of 2 has
//! only the latter. Blocks are slices in the order `[x, y, z]`; along an axis they are runs of n slabs of voxels.

use crate::numeric::{Real, real};

/// The differences of slice `x` of a block `f` along its three axes, whose sides are at least 2.
pub(super) fn forward<R: Real>(f: &[R], shape: [usize; 3], x: usize, [dx, dy, dz]: [&mut [R]; 3]) {
    let [nx, ny, nz] = shape;
    let slice = |x: usize| &f[x * ny * nz..][..ny * nz];
    let (above, below) = ((x + 1).min(nx - 1), x.saturating_sub(1));
    let difference = if above - below == 2 { within } else { at_face };
    difference(slice(above), slice(below), dx);
    along(slice(x), nz, dy);
    // All rows as one, then the faces, where one row meets the next.
    let (f, inner) = (slice(x), 1..ny * nz - 1);
    within(&f[2..], f, &mut dz[inner]);
    for (f, d) in f.chunks_exact(nz).zip(dz.chunks_exact_mut(nz)) {
        (d[0], d[nz - 1]) = (f[1] - f[0], f[nz - 1] - f[nz - 2]);
    }
}

/// Differences along a run of slabs.
fn along<R: Real>(f: &[R], slab: usize, d: &mut [R]) {
    let last = f.len() - slab;
    at_face(&f[slab..][..slab], f, d);
    within(&f[2 * slab..], f, &mut d[slab..last]);
    at_face(&f[last..], &f[last - slab..], &mut d[last..]);
}

fn at_face<R: Real>(above: &[R], below: &[R], d: &mut [R]) {
    d.iter_mut().zip(above.iter().zip(below)).for_each(|(d, (above, below))| *d = *above - *below);
}

fn within<R: Real>(above: &[R], below: &[R], d: &mut [R]) {
    let half = real::<R>(0.5);
    d.iter_mut().zip(above.iter().zip(below)).for_each(|(d, (above, below))| *d = half * (*above - *below));
}

/// Adds slice `x` of the transpose of [`forward`] to `out`: of the fluxes along x in the slices before, at and after it, as
/// far as there are such, and of those along y and z in itself. Those along z lose their faces.
pub(super) fn add_transpose<R: Real>(
    [before, here, after]: [&[R]; 3],
    along_y: &[R],
    along_z: &mut [R],
    [nx, _, nz]: [usize; 3],
    x: usize,
    out: &mut [R],
) {
    let (one, half) = (R::ONE, real::<R>(0.5));
    let faces = [(x == 1, one, before), (x == 0, -one, here), (x == nx - 1, one, here), (x == nx - 2, -one, after)];
    let inner = [(x > 1, half, before), (x + 2 < nx, -half, after)];
    for (_, factor, flux) in faces.into_iter().chain(inner).filter(|(counts, ..)| *counts) {
        add(factor, flux, out);
    }
    add_transpose_along(along_y, nz, out);
    for (flux, out) in along_z.chunks_exact_mut(nz).zip(out.chunks_exact_mut(nz)) {
        for (at, above, below) in [(0, 1, 0), (nz - 1, nz - 1, nz - 2)] {
            out[above] += flux[at];
            out[below] -= flux[at];
            flux[at] = R::ZERO;
        }
    }
    // All rows as one: from a face nothing goes beyond.
    add(half, along_z, &mut out[1..]);
    add(-half, &along_z[1..], out);
}

/// The same along a run of slabs.
fn add_transpose_along<R: Real>(flux: &[R], slab: usize, out: &mut [R]) {
    let (one, half, last) = (R::ONE, real::<R>(0.5), flux.len() - slab);
    for (at, above, below) in [(0, slab, 0), (last, last, last - slab)] {
        let flux = &flux[at..][..slab];
        add(one, flux, &mut out[above..]);
        add(-one, flux, &mut out[below..]);
    }
    let flux = &flux[slab..last];
    add(half, flux, &mut out[2 * slab..]);
    add(-half, flux, out);
}

fn add<R: Real>(factor: R, flux: &[R], out: &mut [R]) {
    out.iter_mut().zip(flux).for_each(|(out, flux)| *out += factor * *flux);
}

#[cfg(test)]
mod tests {
    use super::*;
    use ndarray::Array3;

    /// Differences along each axis of all slices.
    fn all(f: &[f64], shape: [usize; 3]) -> [Vec<f64>; 3] {
        let mut differences = [(); 3].map(|()| vec![0.0; f.len()]);
        let size = shape[1] * shape[2];
        for x in 0..shape[0] {
            let slices = differences.each_mut().map(|d| &mut d[x * size..][..size]);
            forward(f, shape, x, slices);
        }
        differences
    }

    /// The transpose for all slices.
    fn transpose(flux: [&[f64]; 3], shape: [usize; 3]) -> Vec<f64> {
        let size = shape[1] * shape[2];
        let mut out = vec![0.0; flux[0].len()];
        for (x, out) in out.chunks_exact_mut(size).enumerate() {
            let slice = |axis: usize, x: usize| flux[axis].get(x * size..).and_then(|f| f.get(..size)).unwrap_or(&[]);
            let along_x = [slice(0, x.wrapping_sub(1).min(shape[0])), slice(0, x), slice(0, x + 1)];
            add_transpose(along_x, slice(1, x), &mut slice(2, x).to_vec(), shape, x, out);
        }
        out
    }

    #[test]
    fn differences_are_central_within_and_one_sided_at_the_faces() {
        let mut d = [0.0; 4];
        along(&[1.0, 4.0, 9.0, 25.0], 1, &mut d);
        assert_eq!(d, [3.0, 4.0, 10.5, 16.0]);
        let [dx, ..] = all(&[1.0, 1.0, 1.0, 1.0, 4.0, 4.0, 4.0, 4.0, 9.0, 9.0, 9.0, 9.0], [3, 2, 2]);
        assert_eq!(dx, [3.0, 3.0, 3.0, 3.0, 4.0, 4.0, 4.0, 4.0, 5.0, 5.0, 5.0, 5.0]);
        let f = Array3::from_shape_fn((4, 6, 2), |(x, y, z)| (3 * x + 5 * y + 11 * z) as f64);
        for (differences, slope) in all(f.as_slice().unwrap(), [4, 6, 2]).iter().zip([3.0, 5.0, 11.0]) {
            assert!(differences.iter().all(|d| *d == slope), "slope {slope}");
        }
    }

    #[test]
    fn the_transpose_is_the_transpose_entry_by_entry() {
        for shape in [[2, 4, 6], [6, 2, 4], [4, 6, 2]] {
            let n: usize = shape.iter().product();
            let unit = |i: usize| (0..n).map(|j| f64::from(u8::from(i == j))).collect::<Vec<_>>();
            let (columns, zeros): (Vec<_>, _) = ((0..n).map(|i| all(&unit(i), shape)).collect(), vec![0.0; n]);
            for (axis, i) in (0..3).flat_map(|axis| (0..n).map(move |i| (axis, i))) {
                let (mut flux, unit) = ([&zeros[..]; 3], unit(i));
                flux[axis] = &unit;
                let row = transpose(flux, shape);
                let is_column = row.iter().zip(&columns).all(|(x, column)| *x == column[axis][i]);
                assert!(is_column, "{shape:?}, axis {axis}, row {i}");
            }
        }
    }
}
