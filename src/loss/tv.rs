//! Total variation of a block of voxels.

use super::l1::sign;
use crate::numeric::{Real, reduce};
use ndarray::{Array3, ArrayView3, Axis, Slice, Zip};

/// Value and gradient of the anisotropic total variation per difference,
/// `TV = (Σ|Δx f| + Σ|Δy f| + Σ|Δz f|)/D`, of a block `[x, y, z]`.
///
/// Δ is the difference of neighbours along one axis and D their number over all three axes,
/// `D = (X-1)YZ + X(Y-1)Z + XY(Z-1)`. A side of 1 has no differences; a block without any has the value 0.
/// The sub-gradient at equal neighbours is 0. Not in the paper: the third part of R²-Gaussian's data loss.
pub fn tv<R: Real>(block: ArrayView3<R>) -> (f64, Array3<R>) {
    let block = block.as_standard_layout();
    let mut gradient = Array3::default(block.raw_dim());
    let pairs = |axis: usize| block.len() - block.len() / block.shape()[axis].max(1);
    let number = (0..3).map(pairs).sum::<usize>();
    if number == 0 {
        return (0.0, gradient);
    }
    let slope = R::from_f64(1.0 / number as f64);
    let mut sum = 0.0;
    for axis in (0..3).map(Axis) {
        let (before, after) = (Slice::new(0, Some(-1), 1), Slice::new(1, None, 1));
        let step = &block.slice_axis(axis, after) - &block.slice_axis(axis, before);
        let distance = step.mapv(R::abs);
        sum += reduce::sum(distance.as_slice().expect("a new array is contiguous"));
        let push = step.mapv(|d| slope * sign(d));
        Zip::from(&mut gradient.slice_axis_mut(axis, after)).and(&push).for_each(|g, &p| *g += p);
        Zip::from(&mut gradient.slice_axis_mut(axis, before)).and(&push).for_each(|g, &p| *g -= p);
    }
    (sum / number as f64, gradient)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::loss::testing::assert_matches_central_differences;
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
        assert_matches_central_differences(&values, &gradient, 1, 1e-9, |v| tv(v.view()).0);
        let (turned, of_turned) = tv(values.view().permuted_axes([2, 0, 1]));
        assert!((turned - value).abs() < 1e-15);
        let back = of_turned.permuted_axes([1, 2, 0]);
        assert!(Zip::from(&back).and(&gradient).all(|a, b| (a - b).abs() < 1e-15));
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
