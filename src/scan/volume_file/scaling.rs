//! Values as whole numbers of 16 bits, from the lowest to the highest value.

use ndarray::{Array2, Array3, ArrayView2};

/// Largest stored number.
const TOP: f64 = 65535.0;

/// How stored numbers become values: `value = offset + step · number`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Scaling {
    /// The lowest value.
    pub offset: f64,
    /// The distance of two values.
    pub step: f64,
}

impl Scaling {
    /// That of all finite values.
    pub(super) fn of(values: &Array3<f32>) -> Self {
        let (low, high) = range(values);
        match high > low {
            true => Self { offset: low, step: (high - low) / TOP },
            false => Self { offset: if low.is_finite() { low } else { 0.0 }, step: 1.0 },
        }
    }

    /// The stored numbers `[row, column]` of a slice `[x, y]`.
    pub(super) fn numbers(self, slice: ArrayView2<f32>) -> Array2<u16> {
        slice.t().mapv(|value| ((f64::from(value) - self.offset) / self.step).round() as u16)
    }
}

/// The lowest and the highest finite value; infinite and the wrong way round without any.
pub(crate) fn range(values: &Array3<f32>) -> (f64, f64) {
    let finite = values.iter().copied().filter(|value| value.is_finite()).map(f64::from);
    finite.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), x| (low.min(x), high.max(x)))
}
