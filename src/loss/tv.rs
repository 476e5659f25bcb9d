//! Total variation of a block of voxels.

use super::l1::sign;
use crate::numeric::threads::{self, Spares};
use crate::numeric::{Real, reduce};
use ndarray::{Array3, ArrayView3};

/// Slices along x that one task works on: a constant, so the cut does not depend on the threads.
const SLAB: usize = 8;

/// Value and gradient of the anisotropic total variation per difference,
/// `TV = (Σ|Δx f| + Σ|Δy f| + Σ|Δz f|)/D`, of a block `[x, y, z]`.
///
/// Δ is the difference of neighbours along one axis and D their number over all three axes,
/// `D = (X-1)YZ + X(Y-1)Z + XY(Z-1)`. A side of 1 has no differences; a block without any has the value 0.
/// The sub-gradient at equal neighbours is 0. Not in the paper: the third part of R²-Gaussian's data loss.
pub fn tv<R: Real>(block: ArrayView3<R>) -> (f64, Array3<R>) {
    let mut gradient = Array3::default(block.raw_dim());
    (tv_into(block, &Spares::default(), &mut gradient), gradient)
}

/// [`tv`] with the gradient in the place of another array. `pushes` is for what the differences within a slice push voxels by.
pub(crate) fn tv_into<R: Real>(block: ArrayView3<R>, pushes: &Spares<Vec<R>>, gradient: &mut Array3<R>) -> f64 {
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
    let values = block.as_slice().expect("standard layout");
    let slices = gradient.as_slice_mut().expect("standard layout");
    let along = |axis: usize| distance(values, shape, axis);
    let push = || {
        let (slope, [_, ny, nz]) = (R::from_f64(1.0 / number as f64), shape);
        threads::for_each_chunk_in(slices, SLAB * ny * nz, pushes, |slab, slices, pushes| {
            for (x, slice) in (slab * SLAB..).zip(slices.chunks_exact_mut(ny * nz)) {
                push(values, shape, slope, x, pushes, slice);
            }
        });
    };
    let ((x, y), (z, ())) =
        threads::both(|| threads::both(|| along(0), || along(1)), || threads::both(|| along(2), push));
    [x, y, z].into_iter().sum::<f64>() / number as f64
}

/// Number of differences along an axis.
fn differences(shape: [usize; 3], axis: usize) -> usize {
    let voxels = shape.iter().product::<usize>();
    voxels - voxels / shape[axis].max(1)
}

/// Σ|Δ f| along an axis, in the order of the voxels before.
fn distance<R: Real>(values: &[R], [nx, ny, nz]: [usize; 3], axis: usize) -> f64 {
    // Voxels that have one after them come in runs.
    let (offset, stride) = ([ny * nz, nz, 1][axis], [nx * ny * nz, ny * nz, nz][axis]);
    let run = stride - offset;
    reduce::sum_made(differences([nx, ny, nz], axis), &|range, mut distances: &mut [R]| {
        let mut from = range.start;
        while !distances.is_empty() {
            let (first, length) = (from / run * stride + from % run, distances.len().min(run - from % run));
            let (part, rest) = distances.split_at_mut(length);
            let pairs = values[first..].iter().zip(&values[first + offset..]);
            part.iter_mut().zip(pairs).for_each(|(d, (&before, &after))| *d = (after - before).abs());
            (from, distances) = (from + length, rest);
        }
    })
}

/// The gradient of slice `x`: each voxel is pushed by the differences before it and after it, axis by axis.
fn push<R: Real>(values: &[R], [nx, ny, nz]: [usize; 3], slope: R, x: usize, pushes: &mut Vec<R>, slice: &mut [R]) {
    let size = ny * nz;
    let slice_of = |x: usize| &values[x * size..][..size];
    let (here, force) = (slice_of(x), |before: R, after: R| slope * sign(after - before));
    slice.fill(R::ZERO);
    if x > 0 {
        let pairs = slice_of(x - 1).iter().zip(here);
        slice.iter_mut().zip(pairs).for_each(|(g, (&before, &here))| *g += force(before, here));
    }
    if x + 1 < nx {
        let pairs = here.iter().zip(slice_of(x + 1));
        slice.iter_mut().zip(pairs).for_each(|(g, (&here, &after))| *g -= force(here, after));
    }
    for (offset, run) in [(nz, size), (1, nz)] {
        pushes.clear();
        pushes.extend(here.iter().zip(&here[offset..]).map(|(&before, &after)| force(before, after)));
        // Between the last of a run and the first of the next there is no difference.
        pushes.iter_mut().skip(run - 1).step_by(run).for_each(|push| *push = R::ZERO);
        slice[offset..].iter_mut().zip(&*pushes).for_each(|(g, &push)| *g += push);
        slice.iter_mut().zip(&*pushes).for_each(|(g, &push)| *g -= push);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::loss::testing::assert_matches_central_differences;
    use ndarray::{Zip, array};

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
        assert_matches_central_differences(&values, &gradient, 1, 1e-9, |v| tv(v.view()).0);
        let (turned, of_turned) = tv(values.view().permuted_axes([2, 0, 1]));
        assert!((turned - value).abs() < 1e-15);
        let back = of_turned.permuted_axes([1, 2, 0]);
        assert!(Zip::from(&back).and(&gradient).all(|a, b| (a - b).abs() < 1e-15));
    }

    #[test]
    fn a_block_after_others_has_the_bits_of_the_first_one() {
        let (spares, mut gradient) = (Spares::default(), Array3::default((0, 0, 0)));
        for shape in [(9, 5, 7), (4, 3, 5), (1, 1, 1), (9, 5, 7), (1, 6, 1)] {
            let block = Array3::from_shape_fn(shape, |(x, y, z)| ((x * 7 + y * 5 + z * 3) % 13) as f32 / 3.0);
            let value = tv_into(block.view(), &spares, &mut gradient);
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
