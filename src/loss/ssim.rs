//! Structural similarity of two images, with the definition of R²-Gaussian, and its gradient.
//!
//! With `G` the blur by a normalised Gaussian window (11×11, σ = 1.5, zeros outside of the image),
//! `μa = G a`, `μb = G b`, `σa² = G a² - μa²`, `σb² = G b² - μb²`, `σab = G ab - μa μb`:
//!
//! ```text
//! S = (2 μa μb + C1)(2 σab + C2) / ((μa² + μb² + C1)(σa² + σb² + C2)),   C1 = 0.01², C2 = 0.03²
//! ```
//!
//! and SSIM is the mean of S over the whole image, border included. This is the index of Wang et al. 2004
//! (Eq. 13) for data of range 1, whatever their range is. It depends on `a` through three blurs, and `G` is
//! its own transpose, so the gradient is three more:
//!
//! ```text
//! N ∂SSIM/∂a = G(∂S/∂(G a)) + 2a·G(∂S/∂(G a²)) + b·G(∂S/∂(G ab))
//! ```

use crate::numeric::elementary::exp;
use crate::numeric::{Real, reduce, threads};
use ndarray::{Array2, ArrayView2};

/// The window reaches this many pixels to each side.
const RADIUS: usize = 5;
const TAPS: usize = 2 * RADIUS + 1;
/// Standard deviation of the window, pixels.
const SIGMA: f64 = 1.5;
const C1: f64 = 0.01 * 0.01;
const C2: f64 = 0.03 * 0.03;
/// Rows that one task computes: a constant, so the cut does not depend on the threads.
const BAND: usize = 16;

/// Compares images: holds the window, which is symmetric and the same for rows and columns.
#[derive(Clone, Debug)]
pub struct Ssim<R> {
    /// Weights at distance 0, 1, … from the centre.
    weights: [R; RADIUS + 1],
}

/// An image to compare others with, and what SSIM needs to know of it. Computed once for each view.
#[derive(Clone, Debug)]
pub struct SsimTarget<R> {
    image: Array2<R>,
    /// μb
    mean: Vec<R>,
    /// σb²
    variance: Vec<R>,
}

/// Derivatives of S by the three blurs, and S summed, for the rows of one band.
struct Band<R> {
    /// `[row][G a | G a² | G ab][column]`
    partials: Vec<R>,
    similarity: f64,
}

impl<R: Real> Default for Ssim<R> {
    fn default() -> Self {
        let gauss = |d: usize| exp(-((d * d) as f64) / (2.0 * SIGMA * SIGMA));
        let total = gauss(0) + 2.0 * (1..=RADIUS).map(gauss).sum::<f64>();
        Self { weights: std::array::from_fn(|d| R::from_f64(gauss(d) / total)) }
    }
}

impl<R: Real> SsimTarget<R> {
    /// Blurs the image `[v, u]` and its square.
    pub fn new(ssim: &Ssim<R>, image: ArrayView2<R>) -> Self {
        let image = image.as_standard_layout().into_owned();
        let (rows, columns) = image.dim();
        let values = contiguous(&image.view());
        let bands = threads::map(rows.div_ceil(BAND), |band| {
            let (mut line, zeros) = (padded_line(columns), vec![R::ZERO; columns]);
            let band = band_rows(band, rows);
            let (mut mean, mut variance) = (vec![R::ZERO; band.len() * columns], vec![R::ZERO; band.len() * columns]);
            for (slot, row) in band.enumerate() {
                let here = slot * columns..(slot + 1) * columns;
                let b = around(row, rows, &zeros, |row| line_of(values, columns, row));
                ssim.blur(&mut line, &mut mean[here.clone()], |t, j| b[t][j]);
                ssim.blur(&mut line, &mut variance[here], |t, j| b[t][j] * b[t][j]);
            }
            variance.iter_mut().zip(&mean).for_each(|(v, &m)| *v = *v - m * m);
            (mean, variance)
        });
        let (means, variances): (Vec<_>, Vec<_>) = bands.into_iter().unzip();
        Self { mean: means.concat(), variance: variances.concat(), image }
    }

    /// The image itself.
    pub fn image(&self) -> ArrayView2<'_, R> {
        self.image.view()
    }
}

impl<R: Real> Ssim<R> {
    /// SSIM of two images of the same shape; 1 for equal ones, and for empty ones.
    ///
    /// Not in the paper: R²-Gaussian's definition, [module documentation](self).
    ///
    /// # Panics
    /// When the shapes differ.
    pub fn value(&self, image: ArrayView2<R>, target: &SsimTarget<R>) -> f64 {
        let image = image.as_standard_layout();
        mean_of(&self.bands(image.view(), target), image.len())
    }

    /// [`Self::value`] and ∂SSIM/∂image, an array of the image's shape.
    ///
    /// # Panics
    /// When the shapes differ.
    pub fn value_and_gradient(&self, image: ArrayView2<R>, target: &SsimTarget<R>) -> (f64, Array2<R>) {
        let image = image.as_standard_layout();
        let (rows, columns) = image.dim();
        let bands = self.bands(image.view(), target);
        let mut gradient = Array2::default((rows, columns));
        if !image.is_empty() {
            let values = gradient.as_slice_mut().expect("a new array is contiguous");
            threads::for_each_chunk(values, BAND * columns, |band, values| {
                self.pull_back(&bands, image.view(), target, band, values);
            });
        }
        (mean_of(&bands, image.len()), gradient)
    }

    /// S and its derivatives, band by band. `image` is in standard layout.
    fn bands(&self, image: ArrayView2<R>, target: &SsimTarget<R>) -> Vec<Band<R>> {
        assert_eq!(image.shape(), target.image.shape(), "SSIM of an image and a target of different shapes");
        let (rows, columns) = image.dim();
        if image.is_empty() {
            return Vec::new();
        }
        let (values_a, values_b) = (contiguous(&image), contiguous(&target.image.view()));
        let share = R::from_f64(1.0 / image.len() as f64);
        threads::map(rows.div_ceil(BAND), |band| {
            let (mut line, zeros) = (padded_line(columns), vec![R::ZERO; columns]);
            let mut similarity = vec![R::ZERO; columns];
            let mut partials = vec![R::ZERO; band_rows(band, rows).len() * 3 * columns];
            let mut sums = Vec::with_capacity(BAND);
            for (row, blurs) in band_rows(band, rows).zip(partials.chunks_exact_mut(3 * columns)) {
                let a = around(row, rows, &zeros, |row| line_of(values_a, columns, row));
                let b = around(row, rows, &zeros, |row| line_of(values_b, columns, row));
                let (blur_a, others) = blurs.split_at_mut(columns);
                let (blur_aa, blur_ab) = others.split_at_mut(columns);
                self.blur(&mut line, blur_a, |t, j| a[t][j]);
                self.blur(&mut line, blur_aa, |t, j| a[t][j] * a[t][j]);
                self.blur(&mut line, blur_ab, |t, j| a[t][j] * b[t][j]);
                let here = row * columns..(row + 1) * columns;
                compare(
                    [blur_a, blur_aa, blur_ab],
                    &target.mean[here.clone()],
                    &target.variance[here],
                    share,
                    &mut similarity,
                );
                sums.push(reduce::sum(&similarity));
            }
            Band { partials, similarity: reduce::sum(&sums) }
        })
    }

    /// The gradient of one band of rows: the transpose of [`Self::bands`].
    fn pull_back(
        &self,
        bands: &[Band<R>],
        image: ArrayView2<R>,
        target: &SsimTarget<R>,
        band: usize,
        gradient: &mut [R],
    ) {
        let (rows, columns) = image.dim();
        let (values_a, values_b) = (contiguous(&image), contiguous(&target.image.view()));
        let (mut line, zeros) = (padded_line(columns), vec![R::ZERO; columns]);
        let mut blurs = [(); 3].map(|()| vec![R::ZERO; columns]);
        for (row, gradient) in band_rows(band, rows).zip(gradient.chunks_exact_mut(columns)) {
            for (number, blur) in blurs.iter_mut().enumerate() {
                let d = around(row, rows, &zeros, |row| {
                    line_of(&bands[row / BAND].partials, columns, row % BAND * 3 + number)
                });
                self.blur(&mut line, blur, |t, j| d[t][j]);
            }
            let (a, b) = (line_of(values_a, columns, row), line_of(values_b, columns, row));
            for (j, g) in gradient.iter_mut().enumerate() {
                *g = blurs[0][j] + a[j] * blurs[1][j] + b[j] * blurs[2][j];
            }
        }
    }

    /// One row of `G x`: down the eleven rows around it, given by `x(tap, column)`, then along `line`.
    #[inline(always)]
    fn blur(&self, line: &mut [R], out: &mut [R], x: impl Fn(usize, usize) -> R) {
        let columns = out.len();
        self.weigh(&mut line[RADIUS..RADIUS + columns], x);
        let shifted: [&[R]; TAPS] = std::array::from_fn(|t| &line[t..t + columns]);
        self.weigh(out, |t, j| shifted[t][j]);
    }

    /// `out[j] = Σ_t w_t x(t, j)` over the eleven taps, in the same order for every j.
    #[inline(always)]
    fn weigh(&self, out: &mut [R], x: impl Fn(usize, usize) -> R) {
        for (j, out) in out.iter_mut().enumerate() {
            let mut sum = self.weights[0] * x(RADIUS, j);
            for d in 1..=RADIUS {
                sum += self.weights[d] * (x(RADIUS - d, j) + x(RADIUS + d, j));
            }
            *out = sum;
        }
    }
}

/// Turns the blurs of `a`, `a²` and `ab` in one row into `share` times the derivatives of S by them, the
/// second one doubled because `∂a²/∂a = 2a`; writes S.
#[inline(always)]
fn compare<R: Real>(blurs: [&mut [R]; 3], mean: &[R], variance: &[R], share: R, similarity: &mut [R]) {
    let n = similarity.len();
    let [blur_a, blur_aa, blur_ab] = blurs.map(|blur| &mut blur[..n]);
    let (mean, variance) = (&mean[..n], &variance[..n]);
    let (two, c1, c2) = (R::from_f64(2.0), R::from_f64(C1), R::from_f64(C2));
    for j in 0..n {
        let (mean_a, mean_b) = (blur_a[j], mean[j]);
        let product = mean_a * mean_b;
        let square = mean_a * mean_a;
        let luminance = two * product + c1;
        let structure = two * (blur_ab[j] - product) + c2;
        let of_luminance = square + mean_b * mean_b + c1;
        let of_structure = blur_aa[j] - square + variance[j] + c2;
        let inverse = R::ONE / (of_luminance * of_structure);
        let s = luminance * structure * inverse;
        let factor = two * inverse * share;
        similarity[j] = s;
        blur_a[j] = factor * (mean_b * (structure - luminance) + mean_a * s * (of_luminance - of_structure));
        blur_aa[j] = -factor * s * of_luminance;
        blur_ab[j] = factor * luminance;
    }
}

fn mean_of<R>(bands: &[Band<R>], pixels: usize) -> f64 {
    let sums: Vec<f64> = bands.iter().map(|band| band.similarity).collect();
    if pixels == 0 { 1.0 } else { reduce::sum(&sums) / pixels as f64 }
}

/// The values of an array in standard layout.
fn contiguous<'a, R>(image: &ArrayView2<'a, R>) -> &'a [R] {
    image.to_slice().expect("standard layout")
}

/// Line `index` of rows stored one after another.
#[inline(always)]
fn line_of<R>(values: &[R], columns: usize, index: usize) -> &[R] {
    &values[index * columns..][..columns]
}

fn band_rows(band: usize, rows: usize) -> std::ops::Range<usize> {
    band * BAND..((band + 1) * BAND).min(rows)
}

/// A row with room for the window's reach on both sides, all 0.
fn padded_line<R: Real>(columns: usize) -> Vec<R> {
    vec![R::ZERO; columns + 2 * RADIUS]
}

/// The eleven rows around `row`, `zeros` for those outside of the image.
#[inline(always)]
fn around<'a, R>(row: usize, rows: usize, zeros: &'a [R], at: impl Fn(usize) -> &'a [R]) -> [&'a [R]; TAPS] {
    std::array::from_fn(|t| match (row + t).checked_sub(RADIUS) {
        Some(row) if row < rows => &at(row)[..zeros.len()],
        _ => zeros,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::loss::testing::assert_matches_central_differences;

    /// SSIM as it is written, with the window as a matrix: a sum of 121 products for each blur and pixel.
    fn naive(a: &Array2<f64>, b: &Array2<f64>) -> f64 {
        let (rows, columns) = a.dim();
        let gauss: Vec<f64> = (0..11).map(|i| exp(-((i as f64 - 5.0) * (i as f64 - 5.0)) / 4.5)).collect();
        let total: f64 = gauss.iter().sum();
        let blur = |row: usize, column: usize, of: &dyn Fn(f64, f64) -> f64| {
            let mut sum = 0.0;
            for (i, wi) in gauss.iter().enumerate() {
                for (j, wj) in gauss.iter().enumerate() {
                    let (r, c) = ((row + i).wrapping_sub(5), (column + j).wrapping_sub(5));
                    if r < rows && c < columns {
                        sum += wi / total * (wj / total) * of(a[[r, c]], b[[r, c]]);
                    }
                }
            }
            sum
        };
        let mut sum = 0.0;
        for row in 0..rows {
            for column in 0..columns {
                let at = |of: &dyn Fn(f64, f64) -> f64| blur(row, column, of);
                let (mean_a, mean_b) = (at(&|a, _| a), at(&|_, b| b));
                let variance_a = at(&|a, _| a * a) - mean_a * mean_a;
                let variance_b = at(&|_, b| b * b) - mean_b * mean_b;
                let covariance = at(&|a, b| a * b) - mean_a * mean_b;
                sum += (2.0 * mean_a * mean_b + C1) * (2.0 * covariance + C2)
                    / ((mean_a * mean_a + mean_b * mean_b + C1) * (variance_a + variance_b + C2));
            }
        }
        sum / (rows * columns) as f64
    }

    fn images(rows: usize, columns: usize) -> (Array2<f64>, Array2<f64>) {
        let wave = |x: usize, y: usize, k: usize| ((x * x * 3 + y * 7 * k + x * y) % 23) as f64 / 20.0;
        (
            Array2::from_shape_fn((rows, columns), |(r, c)| wave(r, c, 1)),
            Array2::from_shape_fn((rows, columns), |(r, c)| wave(r, c, 1) * 0.8 + 0.2 * wave(c, r, 2)),
        )
    }

    #[test]
    fn value_agrees_with_the_double_loop_for_every_shape() {
        for (rows, columns) in [(1, 1), (1, 40), (3, 2), (16, 16), (17, 33), (50, 7), (33, 64)] {
            let (a, b) = images(rows, columns);
            let ssim = Ssim::<f64>::default();
            let value = ssim.value(a.view(), &SsimTarget::new(&ssim, b.view()));
            let truth = naive(&a, &b);
            assert!((value - truth).abs() <= 1e-12, "{rows}×{columns}: {value} against {truth}");
            let single = Ssim::<f32>::default();
            let (a, b) = (a.mapv(|x| x as f32), b.mapv(|x| x as f32));
            let value = single.value(a.view(), &SsimTarget::new(&single, b.view()));
            assert!((value - truth).abs() <= 1e-5, "{rows}×{columns} in f32: {value} against {truth}");
        }
    }

    #[test]
    fn gradient_matches_central_differences_across_bands_and_borders() {
        for (rows, columns) in [(2, 3), (35, 13), (18, 40)] {
            let (a, b) = images(rows, columns);
            let ssim = Ssim::<f64>::default();
            let target = SsimTarget::new(&ssim, b.view());
            let (value, gradient) = ssim.value_and_gradient(a.view(), &target);
            assert_eq!(value, ssim.value(a.view(), &target));
            assert_matches_central_differences(&a, &gradient, 1, 1e-9, |a| ssim.value(a.view(), &target));
        }
    }

    #[test]
    fn gradient_in_f32_agrees_with_f64() {
        let (a, b) = images(40, 50);
        let (double, single) = (Ssim::<f64>::default(), Ssim::<f32>::default());
        let (_, truth) = double.value_and_gradient(a.view(), &SsimTarget::new(&double, b.view()));
        let (a, b) = (a.mapv(|x| x as f32), b.mapv(|x| x as f32));
        let (_, gradient) = single.value_and_gradient(a.view(), &SsimTarget::new(&single, b.view()));
        let largest = truth.iter().fold(0.0_f64, |m, g| m.max(g.abs()));
        for (g, t) in gradient.iter().zip(&truth) {
            assert!((f64::from(*g) - t).abs() <= 1e-5 * largest, "{g:e} against {t:e}");
        }
    }

    #[test]
    fn equal_images_have_similarity_one_and_no_slope() {
        let (a, _) = images(20, 30);
        let ssim = Ssim::<f64>::default();
        let (value, gradient) = ssim.value_and_gradient(a.view(), &SsimTarget::new(&ssim, a.view()));
        assert!((value - 1.0).abs() < 1e-15, "{value}");
        assert!(gradient.iter().all(|g| g.abs() < 1e-15));
    }

    #[test]
    fn images_that_are_not_contiguous_and_empty_ones_are_accepted() {
        let (a, b) = images(20, 30);
        let ssim = Ssim::<f64>::default();
        let value = ssim.value(a.view(), &SsimTarget::new(&ssim, b.view()));
        let turned = ssim.value(a.t(), &SsimTarget::new(&ssim, b.t()));
        assert!((value - turned).abs() < 1e-14);
        for shape in [(0, 0), (0, 4), (4, 0)] {
            let empty = Array2::zeros(shape);
            let (value, gradient) = ssim.value_and_gradient(empty.view(), &SsimTarget::new(&ssim, empty.view()));
            assert_eq!((value, gradient.dim()), (1.0, shape));
        }
    }

    #[test]
    fn one_thread_and_three_give_the_same_bits() {
        let (a, b) = images(70, 50);
        let ssim = Ssim::<f32>::default();
        let (a, b) = (a.mapv(|x| x as f32), b.mapv(|x| x as f32));
        let run = |count| {
            threads::install(count, || ssim.value_and_gradient(a.view(), &SsimTarget::new(&ssim, b.view()))).unwrap()
        };
        assert_eq!(run(1), run(3));
    }
}
