//! The index of a pixel and its derivatives to the blurs, which are sums over the window.
//!
//! With `A`, `B`, `AA`, `BB`, `AB` the blurs of `a`, `b`, `a²`, `b²` and `ab`, and `n` the sum of the window's weights, S is
//! multiplied by `n⁴` above and below the line:
//!
//! ```text
//! S = (2AB' + n²C1)(2(n·AB - AB') + n²C2) / ((A² + B² + n²C1)(n·AA - A² + n·BB - B² + n²C2)),   AB' = A·B
//! ```

use super::window::total;
use crate::numeric::Lanes;
use std::array::from_fn;

const C1: f64 = 0.01 * 0.01;
const C2: f64 = 0.03 * 0.03;

/// Constants of the index.
#[derive(Clone, Copy)]
pub(super) struct Index<L> {
    one: L,
    two: L,
    /// The sum of the window's weights.
    n: L,
    /// C1 and C2, times the square of this sum.
    c1: L,
    c2: L,
    /// Twice the factor of the derivatives.
    share: L,
}

impl<L: Lanes> Index<L> {
    pub(super) fn new(share: f64) -> Self {
        let n = total();
        Self {
            one: L::splat_f64(1.0),
            two: L::splat_f64(2.0),
            n: L::splat_f64(n),
            c1: L::splat_f64(C1 * n * n),
            c2: L::splat_f64(C2 * n * n),
            share: L::splat_f64(2.0 * share),
        }
    }

    /// The same for registers in which some lanes hold no pixel.
    pub(super) fn within(self, pixels: L) -> Self {
        Self { share: self.share * pixels, ..self }
    }

    /// `n²` times the variance.
    #[inline(always)]
    pub(super) fn variance(self, of_b: L, of_bb: L) -> L {
        self.n.fma(of_bb, -(of_b * of_b))
    }

    /// S, and `share` times its derivatives to the blurs of `a`, `a²` and `ab`; from these, the blur of `b` and its variance.
    ///
    /// The second derivative is doubled, because `∂a²/∂a = 2a`, and negated. Several registers are computed together so that
    /// their dependency chains overlap.
    #[inline(always)]
    pub(super) fn slopes<const N: usize>(
        self,
        [of_b, variance_b]: [[L; N]; 2],
        [of_a, of_aa, of_ab]: [[L; N]; 3],
    ) -> ([L; N], [[L; N]; 3]) {
        let Self { one, two, n, c1, c2, share } = self;
        let product: [L; N] = from_fn(|i| of_a[i] * of_b[i]);
        let square: [L; N] = from_fn(|i| of_a[i] * of_a[i]);
        let luminance: [L; N] = from_fn(|i| two.fma(product[i], c1));
        let structure: [L; N] = from_fn(|i| two.fma(n.fma(of_ab[i], -product[i]), c2));
        let luminance_norm: [L; N] = from_fn(|i| of_b[i].fma(of_b[i], square[i] + c1));
        let structure_norm: [L; N] = from_fn(|i| n.fma(of_aa[i], variance_b[i] + c2 - square[i]));
        let inverse: [L; N] = from_fn(|i| one / (luminance_norm[i] * structure_norm[i]));
        let s: [L; N] = from_fn(|i| luminance[i] * structure[i] * inverse[i]);
        let factor: [L; N] = from_fn(|i| inverse[i] * share);
        let by_square: [L; N] = from_fn(|i| s[i] * (luminance_norm[i] - structure_norm[i]));
        let by_product: [L; N] = from_fn(|i| structure[i] - luminance[i]);
        let by_a = from_fn(|i| factor[i] * of_b[i].fma(by_product[i], of_a[i] * by_square[i]));
        let factor: [L; N] = from_fn(|i| factor[i] * n);
        let by_aa = from_fn(|i| factor[i] * s[i] * luminance_norm[i]);
        let by_ab = from_fn(|i| factor[i] * luminance[i]);
        (s, [by_a, by_aa, by_ab])
    }
}
