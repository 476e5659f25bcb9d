//! ∇ of a block by differences of neighbouring voxels, and its transpose.
//!
//! Along an axis of n voxels: `(f[i+1] - f[i-1])/2`, and at the two faces `f[1] - f[0]` and `f[n-1] - f[n-2]`. A side of 2 has
//! only the latter. Blocks are slices in the order `[x, y, z]`; along an axis they are runs of n slabs of voxels.

use crate::numeric::{Real, real};

/// The differences along the three axes of a slice `f` of a block whose sides are at least 2, from the slices below and above,
/// of which there is but one at the faces. Rows are `nz` long.
pub(super) fn forward<R: Real>(f: &[R], around: [Option<&[R]>; 2], nz: usize, [dx, dy, dz]: [&mut [R]; 3]) {
    match around {
        [Some(below), Some(above)] => within(above, below, dx),
        [below, above] => at_face(above.unwrap_or(f), below.unwrap_or(f), dx),
    }
    along(f, nz, dy);
    // All rows as one, then the faces, where one row meets the next.
    let inner = 1..f.len() - 1;
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

/// The two slabs of n along an axis by whose fluxes slab `i` is pushed, and how much.
fn pushes<R: Real>(i: usize, n: usize) -> [(R, usize); 2] {
    let (one, half) = (R::ONE, real::<R>(0.5));
    let faces = [(i == 1, one, 0), (i == 0, -one, 0), (i == n - 1, one, n - 1), (i == n - 2, -one, n - 1)];
    let inner = [(i > 1, half, i.wrapping_sub(1)), (i + 2 < n, -half, i + 1)];
    let mut both = faces.into_iter().chain(inner).filter(|(counts, ..)| *counts).map(|(_, factor, at)| (factor, at));
    [(); 2].map(|()| both.next().expect("one on each side, or a face"))
}

/// Slice `x` of the transpose of [`forward`]: of the fluxes along x by slice, of those along y and z in itself. Those along z
/// lose their faces.
pub(super) fn transpose<'a, R: Real>(
    along_x: impl Fn(usize) -> &'a [R],
    along_y: &[R],
    along_z: &mut [R],
    [nx, ny, nz]: [usize; 3],
    x: usize,
    out: &mut [R],
) {
    let [(a, first), (b, second)] = pushes::<R>(x, nx).map(|(factor, x)| (factor, along_x(x)));
    let mut y = 0;
    while y < ny {
        // All rows but two at each face are pushed alike.
        let rows = if y == 2 { (ny - 2).max(3) - 2 } else { 1 };
        let (from, length) = (y * nz, rows * nz);
        let [(c, third), (d, fourth)] = pushes::<R>(y, ny).map(|(factor, y)| (factor, &along_y[y * nz..][..length]));
        let out = &mut out[from..][..length];
        let (first, second) = (&first[from..][..length], &second[from..][..length]);
        for (i, out) in out.iter_mut().enumerate() {
            *out = a * first[i] + b * second[i] + c * third[i] + d * fourth[i];
        }
        y += rows;
    }
    for (flux, out) in along_z.chunks_exact_mut(nz).zip(out.chunks_exact_mut(nz)) {
        for (at, above, below) in [(0, 1, 0), (nz - 1, nz - 1, nz - 2)] {
            out[above] += flux[at];
            out[below] -= flux[at];
            flux[at] = R::ZERO;
        }
    }
    // All rows as one: from a face nothing goes beyond.
    let (half, last) = (real::<R>(0.5), out.len() - 1);
    out[0] -= half * along_z[1];
    for (out, (before, after)) in out[1..last].iter_mut().zip(along_z.iter().zip(&along_z[2..])) {
        *out = *out + half * *before - half * *after;
    }
    out[last] += half * along_z[last - 1];
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
            let slice = |x: usize| f.chunks_exact(size).nth(x);
            forward(slice(x).unwrap(), [x.checked_sub(1).and_then(slice), slice(x + 1)], shape[2], slices);
        }
        differences
    }

    /// The transpose for all slices.
    fn transposed(flux: [&[f64]; 3], shape: [usize; 3]) -> Vec<f64> {
        let size = shape[1] * shape[2];
        let mut out = vec![0.0; flux[0].len()];
        for (x, out) in out.chunks_exact_mut(size).enumerate() {
            let slice = |axis: usize, x: usize| &flux[axis][x * size..][..size];
            transpose(|x| slice(0, x), slice(1, x), &mut slice(2, x).to_vec(), shape, x, out);
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
        for shape in [[2, 4, 6], [6, 2, 4], [4, 6, 2], [3, 5, 4]] {
            let n: usize = shape.iter().product();
            let unit = |i: usize| (0..n).map(|j| f64::from(u8::from(i == j))).collect::<Vec<_>>();
            let (columns, zeros): (Vec<_>, _) = ((0..n).map(|i| all(&unit(i), shape)).collect(), vec![0.0; n]);
            for (axis, i) in (0..3).flat_map(|axis| (0..n).map(move |i| (axis, i))) {
                let (mut flux, unit) = ([&zeros[..]; 3], unit(i));
                flux[axis] = &unit;
                let row = transposed(flux, shape);
                let is_column = row.iter().zip(&columns).all(|(x, column)| *x == column[axis][i]);
                assert!(is_column, "{shape:?}, axis {axis}, row {i}");
            }
        }
    }
}
