//! Total variation of a block of voxels.

use crate::numeric::threads::{self, Pool};
use crate::numeric::{Lanes, Real, reduce};
use ndarray::{Array3, ArrayView3};

/// Slices along x of one task: a constant, so that results do not depend on the number of threads.
const SLAB: usize = 8;

/// Value and gradient of the anisotropic total variation of a block `[x, y, z]`, per difference.
///
/// ```text
/// TV = (Σ|Δx f| + Σ|Δy f| + Σ|Δz f|)/D
/// ```
///
/// Δ is the difference of neighbours along one axis and D their number over all three axes,
/// `D = (X-1)YZ + X(Y-1)Z + XY(Z-1)`. A side of 1 has no differences; a block without any has the value 0.
/// The sub-gradient at equal neighbours is 0. The three distances of a voxel are summed in the block's precision, voxels in
/// f64. Not in the paper: the third term of R²-Gaussian's data loss.
pub fn tv<R: Real>(block: ArrayView3<R>) -> (f64, Array3<R>) {
    let mut gradient = Array3::default(block.raw_dim());
    (tv_into(block, &Workspace::default(), &mut gradient), gradient)
}

/// Buffers of [`tv_into`]. Nothing is allocated while blocks have the size of the last one.
#[derive(Debug, Default)]
pub struct Workspace<R> {
    /// For each voxel of a slice, the sum of the distances to its next neighbours.
    distances: Pool<Vec<R>>,
    /// For each voxel of a slice, 1 if it has a neighbour before it along z, else 0; and one more 0.
    joined: Pool<Vec<R>>,
    /// For each slice, the sum of its distances.
    sums: Pool<Vec<f64>>,
}

/// [`tv`] with the gradient written to an existing array. Not in the paper.
pub fn tv_into<R: Real>(block: ArrayView3<R>, workspace: &Workspace<R>, gradient: &mut Array3<R>) -> f64 {
    let block = block.as_standard_layout();
    if gradient.dim() != block.dim() {
        *gradient = Array3::default(block.raw_dim());
    }
    let shape: [usize; 3] = block.dim().into();
    let number = (0..3).map(|axis| differences(shape, axis)).sum::<usize>();
    if number == 0 {
        gradient.fill(R::ZERO);
        return 0.0;
    }
    let [nx, ny, nz] = shape;
    let (mut joined, mut sums) = (workspace.joined.take(), workspace.sums.take());
    joined.clear();
    joined.resize(ny * nz + 1, R::ONE);
    joined.iter_mut().step_by(nz).for_each(|first| *first = R::ZERO);
    sums.resize(nx, 0.0);
    let whole = Whole {
        values: block.as_slice().expect("standard layout"),
        shape,
        joined: &joined,
        slope: R::from_f64(1.0 / number as f64),
    };
    let slices = gradient.as_slice_mut().expect("standard layout");
    let slabs = (threads::chunks(slices, SLAB * ny * nz), threads::chunks(&mut sums, SLAB));
    threads::for_each_zip(slabs, |slab, (slices, sums)| {
        let mut distances = workspace.distances.take();
        distances.resize(ny * nz, R::ZERO);
        for (x, (slice, sum)) in (slab * SLAB..).zip(slices.chunks_exact_mut(ny * nz).zip(sums)) {
            whole.slice(x, slice, &mut distances);
            *sum = reduce::sum(&distances);
        }
    });
    reduce::sum(&sums) / number as f64
}

/// Number of differences along an axis.
fn differences(shape: [usize; 3], axis: usize) -> usize {
    let voxels = shape.iter().product::<usize>();
    voxels - voxels / shape[axis].max(1)
}

/// A block, and the constants of its gradient.
struct Whole<'a, R> {
    values: &'a [R],
    shape: [usize; 3],
    joined: &'a [R],
    slope: R,
}

impl<R: Real> Whole<'_, R> {
    /// The gradient of slice `x`, and for each of its voxels the sum of the distances to its next neighbours.
    fn slice(&self, x: usize, gradient: &mut [R], distances: &mut [R]) {
        let [nx, ny, nz] = self.shape;
        let size = ny * nz;
        // Within a run all voxels have the same kinds of neighbours; the block's first and last voxel lack one in memory.
        let ends = [usize::from(x == 0), size - usize::from(x + 1 == nx)];
        let mut cuts = [0, ends[0], nz, size - nz, ends[1], size];
        cuts.sort_unstable();
        for (&start, &end) in cuts.iter().zip(&cuts[1..]).filter(|(start, end)| start < end) {
            let (place, n) = (x * size + start, end - start);
            // A missing neighbour is replaced by the voxel itself: no distance, no gradient.
            let beside = |offset: usize, before: bool, after: bool| {
                let first = if before { place - offset } else { place };
                let last = if after { place + offset } else { place };
                [&self.values[first..][..n], &self.values[last..][..n]]
            };
            let around = [
                beside(size, x > 0, x + 1 < nx),
                beside(nz, start >= nz, end + nz <= size),
                beside(1, place > 0, place + n < self.values.len()),
            ];
            let here = &self.values[place..][..n];
            let joined = [&self.joined[start..][..n], &self.joined[start + 1..][..n]];
            gradient_of_run(here, around, joined, self.slope, &mut gradient[start..end], &mut distances[start..end]);
        }
    }
}

/// The gradient of voxels from their neighbours along x, y and z, and the sums of the distances to the next ones.
///
/// Differences along z are multiplied by `joined`.
fn gradient_of_run<R: Real>(
    here: &[R],
    [x, y, z]: [[&[R]; 2]; 3],
    joined: [&[R]; 2],
    slope: R,
    gradient: &mut [R],
    distances: &mut [R],
) {
    let slope = R::Lanes::splat(slope);
    for i in (0..here.len()).step_by(R::Lanes::WIDTH) {
        let at = |values: &[R]| R::Lanes::from_first(&values[i..]);
        let here = at(here);
        let steps = |pair: [&[R]; 2]| [here - at(pair[0]), at(pair[1]) - here];
        let ([x0, x1], [y0, y1], [z0, z1]) = (steps(x), steps(y), steps(z));
        let [z0, z1] = [at(joined[0]) * z0, at(joined[1]) * z1];
        let signs = (sign(x0) - sign(x1)) + (sign(y0) - sign(y1)) + (sign(z0) - sign(z1));
        (slope * signs).write_first(&mut gradient[i..]);
        (x1.abs() + y1.abs() + z1.abs()).write_first(&mut distances[i..]);
    }
}

/// -1, 0 or 1 in each lane; 0 also for NaN.
#[inline(always)]
fn sign<L: Lanes>(x: L) -> L {
    let (zero, one) = (L::default(), L::splat(L::Scalar::ONE));
    x.select_le(zero, zero, one) - zero.select_le(x, zero, one)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::loss::testing::assert_matches_central_differences;
    use crate::tolerances::largest;
    use ndarray::array;

    #[test]
    fn value_and_gradient_are_those_computed_by_hand() {
        // Differences: along x 3 and 2, along y 1 and 0; a side of 1 along z has none.
        let (value, gradient) = tv(array![[[0.0], [1.0]], [[3.0], [3.0]]].view());
        assert_eq!(value, 6.0 / 4.0);
        assert_eq!(gradient, array![[[-0.5], [0.0]], [[0.25], [0.25]]]);
    }

    #[test]
    fn gradient_matches_central_differences_also_in_a_block_that_is_not_contiguous() {
        let values = Array3::from_shape_fn((4, 3, 5), |(x, y, z)| ((x * 7 + y * 5 + z * 3) % 13) as f64 / 3.0);
        let (value, gradient) = tv(values.view());
        assert_matches_central_differences(&values, &gradient, 1, |v| tv(v.view()).0);
        let (turned, of_turned) = tv(values.view().permuted_axes([2, 0, 1]));
        within!((turned - value).abs());
        let back = of_turned.permuted_axes([1, 2, 0]);
        within!(largest(&back - &gradient));
    }

    #[test]
    fn a_block_after_others_has_the_bits_of_the_first_one() {
        let (workspace, mut gradient) = (Workspace::default(), Array3::default((0, 0, 0)));
        for shape in [(9, 5, 7), (4, 3, 5), (1, 1, 1), (9, 5, 7), (1, 6, 1)] {
            let block = Array3::from_shape_fn(shape, |(x, y, z)| ((x * 7 + y * 5 + z * 3) % 13) as f32 / 3.0);
            let value = tv_into(block.view(), &workspace, &mut gradient);
            let expected = tv(block.view());
            assert_eq!((value, &gradient), (expected.0, &expected.1), "{shape:?}");
        }
    }

    #[test]
    fn a_constant_block_and_a_single_voxel_and_nothing_have_none() {
        for shape in [(3, 4, 5), (1, 1, 1), (1, 1, 6), (0, 2, 2)] {
            let (value, gradient) = tv(Array3::<f32>::ones(shape).view());
            assert_eq!(value, 0.0);
            assert!(gradient.iter().all(|&g| g == 0.0));
        }
    }
}
