//! Mean absolute difference.

use crate::numeric::{Real, reduce, threads};
use ndarray::{Array2, ArrayView2};

/// Pixels of one task: a constant, so that results do not depend on the number of threads.
const CHUNK: usize = 4096;

/// Value and gradient of `L1 = (1/N) Σ |p - t|` over the N pixels of an image.
///
/// `∂L1/∂p = sign(p - t)/N`, and 0 where `p = t`. An empty image has the value 0.
/// Not in the paper: the first term of R²-Gaussian's data loss.
///
/// # Panics
/// When the shapes differ.
pub fn l1<R: Real>(prediction: ArrayView2<R>, target: ArrayView2<R>) -> (f64, Array2<R>) {
    assert_eq!(prediction.shape(), target.shape(), "L1 of a prediction and a target of different shapes");
    let mut gradient = Array2::default(prediction.raw_dim());
    let (p, t) = (prediction.as_standard_layout(), target.as_standard_layout());
    let [p, t] = [&p, &t].map(|image| image.as_slice().expect("standard layout"));
    let n = p.len();
    let slope = R::from_f64(1.0 / n.max(1) as f64);
    threads::for_each_chunk(gradient.as_slice_mut().expect("standard layout"), CHUNK, |chunk, gradient| {
        let pairs = p[chunk * CHUNK..].iter().zip(&t[chunk * CHUNK..]);
        gradient.iter_mut().zip(pairs).for_each(|(g, (&p, &t))| *g = slope * sign(p - t));
    });
    let sum = reduce::sum_made(n, &|range, distances: &mut [R]| {
        let pairs = p[range.clone()].iter().zip(&t[range]);
        distances.iter_mut().zip(pairs).for_each(|(d, (&p, &t))| *d = (p - t).abs());
    });
    (sum / n.max(1) as f64, gradient)
}

/// -1, 0 or 1; 0 also for -0 and NaN.
#[inline(always)]
pub(super) fn sign<R: Real>(x: R) -> R {
    let positive = if x > R::ZERO { R::ONE } else { R::ZERO };
    if x < R::ZERO { -R::ONE } else { positive }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ndarray::array;

    #[test]
    fn value_and_gradient_are_those_computed_by_hand() {
        let (value, gradient) = l1(array![[1.0, 2.0], [3.0, 4.0]].view(), array![[1.0, 4.0], [2.0, 4.5]].view());
        assert_eq!(value, 3.5 / 4.0);
        assert_eq!(gradient, array![[0.0, -0.25], [0.25, -0.25]]);
    }

    #[test]
    fn an_empty_image_costs_nothing() {
        assert_eq!(l1(Array2::<f32>::zeros((0, 3)).view(), Array2::zeros((0, 3)).view()).0, 0.0);
    }
}
