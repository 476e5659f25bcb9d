//! Structural similarity of two images, with the definition of R²-Gaussian, and its gradient. Not in the paper.
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
use crate::numeric::threads::{self, Spares};
use crate::numeric::{Lanes, Real, reduce};
use ndarray::{Array2, ArrayView2};
use std::array::from_fn;
use std::ops::{Add, Div, Mul, Neg, Range, Sub};

/// The window reaches this many pixels to each side.
const RADIUS: usize = 5;
const TAPS: usize = 2 * RADIUS + 1;
/// Rows blurred together: most of the rows that the window reaches from one are those that it reaches from the next.
const TOGETHER: usize = 4;
/// The rows that it reaches from all of these.
const REACHED: usize = TAPS + TOGETHER - 1;
/// Standard deviation of the window, pixels.
const SIGMA: f64 = 1.5;
const C1: f64 = 0.01 * 0.01;
const C2: f64 = 0.03 * 0.03;
/// Lines kept of each row: the derivatives of S by `G a`, `G a²` and `G ab`.
const LINES: usize = 3;
/// Between lines: eleven rows that were a power of two apart would push each other out of the cache.
const GAP: usize = 16;
/// Columns weighed together: a few registers, so that eleven addresses are worth finding.
const ABREAST: usize = 32;
/// Rows that one task computes, several times [`TOGETHER`]: a constant, so the cut does not depend on the threads.
const BAND: usize = 16;

/// Compares images: holds the window, which is symmetric and the same for rows and columns.
#[derive(Clone, Debug)]
pub struct Ssim<R> {
    /// Weights at distance 0, 1, … from the centre.
    weights: [R; RADIUS + 1],
    /// The derivatives of S by the three blurs, `[row][line][column]`, each line with a gap after it.
    lines: Spares<Vec<R>>,
    rows: Spares<Rows<R>>,
    sums: Spares<Vec<f64>>,
}

/// What a task works in.
#[derive(Debug, Default)]
struct Rows<R> {
    /// Rows blurred down the columns, with room for the window's reach on both sides, where they are 0.
    down: [Vec<R>; TOGETHER],
    /// A row outside of the image.
    zeros: Vec<R>,
    /// S of a row.
    similarity: Vec<R>,
    /// `a²` and `ab` of the rows that a band reaches.
    products: [Vec<R>; 2],
    /// [`TOGETHER`] rows each.
    blurs: [Vec<R>; 3],
}

impl<R: Real> Rows<R> {
    fn fit(&mut self, columns: usize) {
        let zeros = |values: &mut Vec<R>, n: usize| {
            values.clear();
            values.resize(n, R::ZERO);
        };
        self.down.iter_mut().for_each(|line| zeros(line, columns + 2 * RADIUS));
        zeros(&mut self.zeros, columns);
        self.similarity.resize(columns, R::ZERO);
        self.blurs.iter_mut().for_each(|blur| blur.resize(TOGETHER * columns, R::ZERO));
    }
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

impl<R: Real> Default for Ssim<R> {
    fn default() -> Self {
        let gauss = |d: usize| exp(-((d * d) as f64) / (2.0 * SIGMA * SIGMA));
        let total = gauss(0) + 2.0 * (1..=RADIUS).map(gauss).sum::<f64>();
        let weights = std::array::from_fn(|d| R::from_f64(gauss(d) / total));
        Self { weights, lines: Spares::default(), rows: Spares::default(), sums: Spares::default() }
    }
}

impl<R: Real> SsimTarget<R> {
    /// Blurs the image `[v, u]` and its square.
    pub fn new(ssim: &Ssim<R>, image: ArrayView2<R>) -> Self {
        let image = image.as_standard_layout().into_owned();
        let (rows, columns) = image.dim();
        let values = contiguous(&image.view());
        let bands = threads::map(rows.div_ceil(BAND), |band| {
            let mut space = ssim.rows.lend();
            space.fit(columns);
            let Rows { down, zeros, products: [squares, _], .. } = &mut *space;
            let inputs = reached_rows(band, rows);
            multiply(values, values, &inputs, columns, squares);
            let band = band_rows(band, rows);
            let (mut mean, mut variance) = (vec![R::ZERO; band.len() * columns], vec![R::ZERO; band.len() * columns]);
            let size = TOGETHER * columns.max(1);
            let outs = mean.chunks_mut(size).zip(variance.chunks_mut(size));
            for (row, (mean, variance)) in band.step_by(TOGETHER).zip(outs) {
                let b = around(values, 0, columns, row, zeros);
                let bb = around(squares, inputs.start, columns, row, zeros);
                ssim.blur(b, down, mean.chunks_exact_mut(columns));
                ssim.blur(bb, down, variance.chunks_exact_mut(columns));
            }
            variance.iter_mut().zip(&mean).for_each(|(v, &m)| *v -= m * m);
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
        let mut lines = self.lines.lend();
        self.compare(image.view(), target, &mut lines)
    }

    /// [`Self::value`] and ∂SSIM/∂image, an array of the image's shape.
    ///
    /// # Panics
    /// When the shapes differ.
    pub fn value_and_gradient(&self, image: ArrayView2<R>, target: &SsimTarget<R>) -> (f64, Array2<R>) {
        let mut gradient = Array2::default(image.raw_dim());
        (self.value_and_gradient_into(image, target, &mut gradient), gradient)
    }

    /// [`Self::value_and_gradient`] with the gradient in the place of another array.
    pub(super) fn value_and_gradient_into(
        &self,
        image: ArrayView2<R>,
        target: &SsimTarget<R>,
        gradient: &mut Array2<R>,
    ) -> f64 {
        let image = image.as_standard_layout();
        if gradient.dim() != image.dim() {
            *gradient = Array2::default(image.raw_dim());
        }
        let mut lines = self.lines.lend();
        let value = self.compare(image.view(), target, &mut lines);
        if !image.is_empty() {
            let values = gradient.as_slice_mut().expect("standard layout");
            threads::for_each_chunk_in(values, BAND * image.ncols(), &self.rows, |band, values, space| {
                self.pull_back(&lines, image.view(), target, band, space, values);
            });
        }
        value
    }

    /// The mean of S, and its derivatives by the three blurs. `image` is in standard layout. Rows are summed first, then
    /// their sums in a band, then these.
    fn compare(&self, image: ArrayView2<R>, target: &SsimTarget<R>, lines: &mut Vec<R>) -> f64 {
        assert_eq!(image.shape(), target.image.shape(), "SSIM of an image and a target of different shapes");
        let (rows, columns) = image.dim();
        if image.is_empty() {
            return 1.0;
        }
        let width = columns + GAP;
        lines.resize(rows * LINES * width, R::ZERO);
        let mut sums = self.sums.lend();
        sums.resize(rows.div_ceil(BAND), 0.0);
        let bands = (threads::chunks(lines, BAND * LINES * width), threads::chunks(&mut sums, 1));
        threads::for_each_of(bands, |band, (lines, sum)| {
            sum[0] = self.compare_band(image, target, band, &mut self.rows.lend(), lines);
        });
        reduce::sum(&sums) / (rows * columns) as f64
    }

    /// The sum of S in one band of rows, and the derivatives of its mean.
    fn compare_band(
        &self,
        image: ArrayView2<R>,
        target: &SsimTarget<R>,
        band: usize,
        space: &mut Rows<R>,
        lines: &mut [R],
    ) -> f64 {
        let (rows, columns) = image.dim();
        let (a, b) = (contiguous(&image), contiguous(&target.image.view()));
        let (width, share) = (columns + GAP, R::from_f64(1.0 / image.len() as f64));
        space.fit(columns);
        let Rows { down, zeros, similarity, products: [aa, ab], .. } = space;
        let inputs = reached_rows(band, rows);
        multiply(a, a, &inputs, columns, aa);
        multiply(a, b, &inputs, columns, ab);
        let blurred = [(a, 0), (&aa[..], inputs.start), (&ab[..], inputs.start)];
        let mut sum = 0.0;
        let groups = band_rows(band, rows).step_by(TOGETHER).zip(lines.chunks_mut(TOGETHER * LINES * width));
        for (first, group) in groups {
            for (kind, (x, start)) in blurred.into_iter().enumerate() {
                let outs = group.chunks_exact_mut(width).skip(kind).step_by(LINES).map(|line| &mut line[..columns]);
                self.blur(around(x, start, columns, first, zeros), down, outs);
            }
            for (row, lines) in (first..).zip(group.chunks_exact_mut(LINES * width)) {
                let mut lines = lines.chunks_exact_mut(width).map(|line| &mut line[..columns]);
                let blurs: [_; LINES] = from_fn(|_| lines.next().expect("three lines of a row"));
                let [mean, variance] = [&target.mean, &target.variance].map(|all| line_of(all, columns, row));
                differentiate(mean, variance, share, blurs, similarity);
                sum += reduce::sum(similarity);
            }
        }
        sum
    }

    /// The gradient of one band of rows: the transpose of [`Self::compare_band`].
    fn pull_back(
        &self,
        lines: &[R],
        image: ArrayView2<R>,
        target: &SsimTarget<R>,
        band: usize,
        space: &mut Rows<R>,
        gradient: &mut [R],
    ) {
        let (rows, columns) = image.dim();
        let (a, b) = (contiguous(&image), contiguous(&target.image.view()));
        let width = columns + GAP;
        space.fit(columns);
        let Rows { down, zeros, blurs, .. } = space;
        let groups = band_rows(band, rows).step_by(TOGETHER).zip(gradient.chunks_mut(TOGETHER * columns));
        for (first, group) in groups {
            for (kind, blur) in blurs.iter_mut().enumerate() {
                let partial = around(&lines[kind * width..], 0, LINES * width, first, zeros);
                self.blur(partial, down, blur.chunks_exact_mut(columns));
            }
            for (i, gradient) in group.chunks_exact_mut(columns).enumerate() {
                let [of_a, of_aa, of_ab] = blurs.each_ref().map(|blur| line_of(blur, columns, i));
                let (a, b) = (line_of(a, columns, first + i), line_of(b, columns, first + i));
                for (j, g) in gradient.iter_mut().enumerate() {
                    *g = of_a[j] + a[j] * of_aa[j] + b[j] * of_ab[j];
                }
            }
        }
    }

    /// Some rows of `G x`: down the rows around them into the middle of `down`, then along these. There may be fewer
    /// `outs` than [`TOGETHER`].
    fn blur<'o>(&self, x: [&[R]; REACHED], down: &mut [Vec<R>; TOGETHER], outs: impl Iterator<Item = &'o mut [R]>)
    where
        R: 'o,
    {
        self.down(x, down.each_mut().map(|line| &mut line[RADIUS..][..x[0].len()]));
        for (line, out) in down.iter().zip(outs) {
            self.along(line, out);
        }
    }

    /// `outs[r][j] = Σ_t w_t x[r+t][j]` over the eleven taps: some registers at a time, then what is left.
    fn down(&self, x: [&[R]; REACHED], mut outs: [&mut [R]; TOGETHER]) {
        let wide = x.map(|x| x.as_chunks::<ABREAST>());
        let count = wide[0].0.len();
        let blocks = wide.map(|(blocks, _)| &blocks[..count]);
        let weights = self.weights.map(R::Lanes::splat);
        for block in 0..count {
            for j in (0..ABREAST).step_by(R::Lanes::WIDTH) {
                let mut x = [R::Lanes::default(); REACHED];
                x.iter_mut().zip(blocks).for_each(|(x, blocks)| *x = R::Lanes::from_slice(&blocks[block][j..]));
                for (r, out) in outs.iter_mut().enumerate() {
                    weigh(&weights, |t| x[r + t]).write(&mut out[block * ABREAST + j..]);
                }
            }
        }
        for j in count * ABREAST..x[0].len() {
            for (r, out) in outs.iter_mut().enumerate() {
                out[j] = weigh(&self.weights, |t| x[r + t][j]);
            }
        }
    }

    /// `out[j] = Σ_t w_t line[j+t]`.
    fn along(&self, line: &[R], out: &mut [R]) {
        let x: [_; TAPS] = from_fn(|t| &line[t..][..out.len()]);
        let (blocks, rest) = out.as_chunks_mut::<ABREAST>();
        let (first, count) = (blocks.len() * ABREAST, blocks.len());
        let wide = x.map(|x| &x.as_chunks::<ABREAST>().0[..count]);
        let weights = self.weights.map(R::Lanes::splat);
        for (block, out) in blocks.iter_mut().enumerate() {
            for j in (0..ABREAST).step_by(R::Lanes::WIDTH) {
                weigh(&weights, |t| R::Lanes::from_slice(&wide[t][block][j..])).write(&mut out[j..]);
            }
        }
        for (j, out) in (first..).zip(rest) {
            *out = weigh(&self.weights, |t| x[t][j]);
        }
    }
}

/// `Σ_t w_t x(t)` over the eleven taps, from the centre outwards.
#[inline(always)]
fn weigh<T: Copy + Add<Output = T> + Mul<Output = T>>(weights: &[T; RADIUS + 1], x: impl Fn(usize) -> T) -> T {
    let outer = weights.iter().enumerate().skip(1);
    outer.fold(weights[0] * x(RADIUS), |sum, (d, &weight)| sum + weight * (x(RADIUS - d) + x(RADIUS + d)))
}

/// In one row, turns the blurs of `a`, `a²` and `ab` into `share` times the derivatives of S by them, the
/// second one doubled because `∂a²/∂a = 2a`, and writes S.
fn differentiate<R: Real>(mean: &[R], variance: &[R], share: R, blurs: [&mut [R]; LINES], similarity: &mut [R]) {
    let of_lanes = Index::new(share).map(R::Lanes::splat);
    let n = similarity.len();
    let whole = n - n % R::Lanes::WIDTH;
    let [of_a, of_aa, of_ab] = blurs.map(|blur| &mut blur[..n]);
    for j in (0..whole).step_by(R::Lanes::WIDTH) {
        let at = |values: &[R]| R::Lanes::from_slice(&values[j..]);
        let [s, by_a, by_aa, by_ab] = of_lanes.slopes([at(mean), at(variance), at(of_a), at(of_aa), at(of_ab)]);
        s.write(&mut similarity[j..]);
        by_a.write(&mut of_a[j..]);
        by_aa.write(&mut of_aa[j..]);
        by_ab.write(&mut of_ab[j..]);
    }
    for j in whole..n {
        let given = [mean[j], variance[j], of_a[j], of_aa[j], of_ab[j]];
        [similarity[j], of_a[j], of_aa[j], of_ab[j]] = Index::new(share).slopes(given);
    }
}

/// What the index is made with: constants, and what its derivatives are multiplied by.
#[derive(Clone, Copy)]
struct Index<T> {
    one: T,
    two: T,
    c1: T,
    c2: T,
    share: T,
}

impl<R: Real> Index<R> {
    fn new(share: R) -> Self {
        Self { one: R::ONE, two: R::from_f64(2.0), c1: R::from_f64(C1), c2: R::from_f64(C2), share }
    }

    fn map<T>(self, f: impl Fn(R) -> T) -> Index<T> {
        Index { one: f(self.one), two: f(self.two), c1: f(self.c1), c2: f(self.c2), share: f(self.share) }
    }
}

impl<T> Index<T>
where
    T: Copy + Add<Output = T> + Sub<Output = T> + Mul<Output = T> + Div<Output = T> + Neg<Output = T>,
{
    /// S and `share` times its derivatives from μb, σb² and the blurs of `a`, `a²` and `ab`.
    #[inline(always)]
    fn slopes(self, [mean_b, variance_b, mean_a, of_aa, of_ab]: [T; 5]) -> [T; 4] {
        let Self { one, two, c1, c2, share } = self;
        let product = mean_a * mean_b;
        let square = mean_a * mean_a;
        let luminance = two * product + c1;
        let structure = two * (of_ab - product) + c2;
        let luminance_norm = square + mean_b * mean_b + c1;
        let structure_norm = of_aa - square + variance_b + c2;
        let inverse = one / (luminance_norm * structure_norm);
        let s = luminance * structure * inverse;
        let factor = two * inverse * share;
        let by_a = factor * (mean_b * (structure - luminance) + mean_a * s * (luminance_norm - structure_norm));
        [s, by_a, -factor * s * luminance_norm, factor * luminance]
    }
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

fn band_rows(band: usize, rows: usize) -> Range<usize> {
    band * BAND..((band + 1) * BAND).min(rows)
}

/// The rows that the window reaches from those of a band.
fn reached_rows(band: usize, rows: usize) -> Range<usize> {
    (band * BAND).saturating_sub(RADIUS)..((band + 1) * BAND + RADIUS).min(rows)
}

/// `x·y` on some rows.
fn multiply<R: Real>(x: &[R], y: &[R], rows: &Range<usize>, columns: usize, products: &mut Vec<R>) {
    let range = rows.start * columns..rows.end * columns;
    products.clear();
    products.extend(x[range.clone()].iter().zip(&y[range]).map(|(&x, &y)| x * y));
}

/// The rows around [`TOGETHER`] rows from `row` on; `values` holds the image's rows from `first` on, `stride` apart. Those
/// outside of the image are `zeros`, which has the length of a row.
fn around<'a, R>(values: &'a [R], first: usize, stride: usize, row: usize, zeros: &'a [R]) -> [&'a [R]; REACHED] {
    from_fn(|t| {
        let index = (row + t).checked_sub(RADIUS + first);
        index.and_then(|i| values.get(i * stride..)?.get(..zeros.len())).unwrap_or(zeros)
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
    fn an_image_after_others_has_the_bits_of_the_first_one() {
        let kept = Ssim::<f32>::default();
        let mut gradient = Array2::default((0, 0));
        for (rows, columns) in [(50, 70), (20, 40), (60, 33), (0, 4), (50, 70)] {
            let (a, b) = images(rows, columns);
            let (a, b) = (a.mapv(|x| x as f32), b.mapv(|x| x as f32));
            let value = kept.value_and_gradient_into(a.view(), &SsimTarget::new(&kept, b.view()), &mut gradient);
            let new = Ssim::<f32>::default();
            let expected = new.value_and_gradient(a.view(), &SsimTarget::new(&new, b.view()));
            assert_eq!((value, &gradient), (expected.0, &expected.1), "{rows}×{columns}");
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
