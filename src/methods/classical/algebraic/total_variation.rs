//! The gradient of the total variation of a volume.

use trgs_core::numeric::{Real, real, threads};

/// Added to squared differences, in squared density units: keeps the gradient finite in flat regions.
const FLAT: f64 = 1e-7;

/// ∂TV/∂f of `TV = Σ_j √(|∇f_j|² + 1e-7·square)`, backward differences, 0 across the border `[SP08]`.
///
/// `shape` is `[x, y, z]`; `square` is the square of the unit of density.
///
/// Tests: `it_is_the_derivative`.
pub(super) fn gradient<R: Real>(f: &[R], shape: [usize; 3], square: f64) -> Vec<R> {
    let flat: R = real(FLAT * square);
    let [nx, ny, nz] = shape;
    let strides = [ny * nz, nz, 1];
    // 1/√(|∇f|² + ε) of every voxel, then the terms of f_j from the voxel and its upper neighbours.
    let inverse = over_slices(nx, ny * nz, |x, out| {
        for (i, out) in out.iter_mut().enumerate() {
            let (at, j) = ([x, i / nz, i % nz], x * ny * nz + i);
            let mut length: R = flat;
            for axis in 0..3 {
                let d = if at[axis] > 0 { f[j] - f[j - strides[axis]] } else { R::ZERO };
                length += d * d;
            }
            *out = R::ONE / length.sqrt();
        }
    });
    over_slices(nx, ny * nz, |x, out| {
        for (i, out) in out.iter_mut().enumerate() {
            let (at, j) = ([x, i / nz, i % nz], x * ny * nz + i);
            let mut total = R::ZERO;
            for axis in 0..3 {
                let stride = strides[axis];
                if at[axis] > 0 {
                    total += (f[j] - f[j - stride]) * inverse[j];
                }
                if at[axis] + 1 < shape[axis] {
                    total += (f[j] - f[j + stride]) * inverse[j + stride];
                }
            }
            *out = total;
        }
    })
}

fn over_slices<R: Real>(n: usize, slice: usize, f: impl Fn(usize, &mut [R]) + Sync + Send) -> Vec<R> {
    let mut values = vec![R::ZERO; n * slice];
    threads::for_each_chunk(&mut values, slice, f);
    values
}

#[cfg(test)]
mod tests {
    use super::*;
    use trgs_core::numeric::reduce;

    /// The total variation whose derivative is [`gradient`].
    fn total_variation(f: &[f64], shape: [usize; 3]) -> f64 {
        let strides = [shape[1] * shape[2], shape[2], 1];
        reduce::sum_by(f.len(), &|j| {
            let at = [j / strides[0], j / strides[1] % shape[1], j % shape[2]];
            let d = |axis: usize| if at[axis] > 0 { f[j] - f[j - strides[axis]] } else { 0.0 };
            (d(0) * d(0) + d(1) * d(1) + d(2) * d(2) + FLAT).sqrt()
        })
    }

    #[test]
    fn it_is_the_derivative() {
        let shape = [3, 4, 5];
        let f: Vec<f64> = (0..60).map(|i| f64::from(i * 37 % 23) / 10.0).collect();
        let exact = gradient(&f, shape, 1.0);
        for j in 0..60 {
            let moved = |h: f64| {
                let mut f = f.clone();
                f[j] += h;
                total_variation(&f, shape)
            };
            let step = 1e-5;
            let difference = (moved(step) - moved(-step)) / (2.0 * step);
            within!((exact[j] - difference).abs(), "{j}: {} and {difference}", exact[j]);
        }
    }
}
