//! Losses on images and blocks of voxels: values and gradients. They do not depend on primitives.
//!
//! A gradient is ∂loss/∂prediction, an array of the prediction's shape: the cotangent that the projector's or
//! the voxelizer's `vjp` takes. Values are f64, summed in a tree that depends on the shape alone.

pub mod l1;
pub mod ssim;
pub mod tv;

pub use ssim::{Ssim, SsimTarget};

use crate::numeric::Real;
use ndarray::{Array2, ArrayView2};

/// The terms of the data loss of one projection.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ImageTerms {
    /// `l1 + weight·d_ssim`.
    pub total: f64,
    /// Mean absolute difference.
    pub l1: f64,
    /// `1 - SSIM`, between 0 and 2.
    pub d_ssim: f64,
}

/// Data loss of one projection, `L1 + weight·(1 - SSIM)`, and ∂total/∂prediction `[v, u]`.
///
/// Not in the paper: taken from R²-Gaussian, with its weight of 0.25. It is no convex combination:
/// the weight of L1 is always 1. The third term, [`tv::tv`], is of the volume and not of the image.
///
/// # Panics
/// When the prediction and the target differ in shape.
pub fn image_loss<R: Real>(
    ssim: &Ssim<R>,
    weight: f64,
    prediction: ArrayView2<R>,
    target: &SsimTarget<R>,
) -> (ImageTerms, Array2<R>) {
    let mut cotangent = Array2::default(prediction.raw_dim());
    (image_loss_into(ssim, weight, prediction, target, &mut cotangent), cotangent)
}

/// [`image_loss`] with the cotangent written to an existing array. Not in the paper.
///
/// # Panics
/// When the prediction and the target differ in shape.
pub fn image_loss_into<R: Real>(
    ssim: &Ssim<R>,
    weight: f64,
    prediction: ArrayView2<R>,
    target: &SsimTarget<R>,
    cotangent: &mut Array2<R>,
) -> ImageTerms {
    let [similarity, l1] = ssim.compare(prediction, target, [-weight, 1.0], Some(cotangent));
    let d_ssim = 1.0 - similarity;
    ImageTerms { total: l1 + weight * d_ssim, l1, d_ssim }
}

#[cfg(test)]
mod testing {
    use ndarray::{Array, Dimension};

    /// Compares a gradient with central differences of `value` at every `stride`-th element.
    pub(super) fn assert_matches_central_differences<D: Dimension>(
        at: &Array<f64, D>,
        gradient: &Array<f64, D>,
        stride: usize,
        value: impl Fn(&Array<f64, D>) -> f64,
    ) {
        const STEP: f64 = 1e-5;
        let moved = |i: usize, by: f64| {
            let mut x = at.clone();
            x.as_slice_mut().unwrap()[i] += by;
            value(&x)
        };
        for i in (0..at.len()).step_by(stride) {
            let difference = (moved(i, STEP) - moved(i, -STEP)) / (2.0 * STEP);
            let analytic = gradient.as_slice().unwrap()[i];
            within!((analytic - difference).abs(), "element {i}: {analytic:e} against {difference:e}");
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tolerances::largest;

    #[test]
    fn gradient_of_the_image_loss_matches_central_differences() {
        let ssim = Ssim::<f64>::default();
        let target =
            SsimTarget::new(&ssim, Array2::from_shape_fn((9, 14), |(r, c)| ((r * 5 + c * 3) % 7) as f64 / 5.0).view());
        let prediction = Array2::from_shape_fn((9, 14), |(r, c)| ((r * 3 + c * 4) % 11) as f64 / 9.0 + 0.01);
        let (loss, cotangent) = image_loss(&ssim, 0.25, prediction.view(), &target);
        assert_eq!(loss.total, loss.l1 + 0.25 * loss.d_ssim);
        testing::assert_matches_central_differences(&prediction, &cotangent, 1, |p| {
            image_loss(&ssim, 0.25, p.view(), &target).0.total
        });
    }

    #[test]
    fn l1_of_the_image_loss_is_l1_and_its_gradient_to_the_bit() {
        let ssim = Ssim::<f32>::default();
        let target = Array2::from_shape_fn((70, 45), |(r, c)| ((r * 5 + c * 3) % 7) as f32 / 5.0);
        let prediction = Array2::from_shape_fn((70, 45), |(r, c)| ((r * 3 + c * 4) % 7) as f32 / 5.0);
        let (loss, cotangent) = image_loss(&ssim, 0.0, prediction.view(), &SsimTarget::new(&ssim, target.view()));
        let (value, gradient) = l1::l1(prediction.view(), target.view());
        within!((loss.l1 - value).abs() / value, "{} against {value}", loss.l1);
        assert_eq!(cotangent, gradient);
    }

    #[test]
    fn a_perfect_image_has_no_loss_and_no_gradient() {
        let ssim = Ssim::<f64>::default();
        let image = Array2::from_shape_fn((8, 8), |(r, c)| (r * c) as f64 / 64.0);
        let (loss, cotangent) = image_loss(&ssim, 0.25, image.view(), &SsimTarget::new(&ssim, image.view()));
        within!(loss.total.abs(), "{}", loss.total);
        within!("gradient", largest(cotangent));
    }
}
