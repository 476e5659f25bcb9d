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

mod index;
#[cfg(test)]
mod tests;
mod window;

use crate::numeric::threads::{self, Pool};
use crate::numeric::{Lanes, Real, reduce};
use index::Index;
use ndarray::{Array2, ArrayView2};
use std::array::from_fn;
use std::ops::Range;
use window::{BLOCK, Column, Fold, RADIUS, Window, around, margins};

/// Number of blurs: of `a`, `a²` and `ab`, and of the derivatives of S to them.
const KINDS: usize = 3;
/// Blocks kept at a time: one and its neighbours.
const KEPT: usize = 3;
/// Blocks of one task: a constant, so that results do not depend on the number of threads.
///
/// The derivatives of S in [`RADIUS`] rows on both sides are computed by the neighbouring tasks, too: that is less work
/// than to store all of them and wait.
const SPAN: usize = 13;

/// Computes SSIM and its gradient, with buffers that are reused.
#[derive(Clone, Debug, Default)]
pub struct Ssim<R: Real> {
    scratch: Pool<Scratch<R>>,
    sums: Pool<Vec<Sums>>,
}

/// Sums of S and of |a - b|.
type Sums = [f64; 2];

/// The rows of a block, column by column.
type Block<R> = Vec<Column<R>>;
/// A block and the blocks above and below.
type Neighbours<'a, R> = [&'a [Column<R>]; 3];

/// Scratch arrays of a task.
#[derive(Debug, Default)]
struct Scratch<R: Real> {
    /// A row before folding and one after unfolding, padded.
    rows: [Vec<R>; 2],
    /// 1 in the lanes that have a pixel.
    pixels: Vec<R::Lanes>,
    /// Blocks of `a`; block i has index i modulo [`KEPT`].
    image: [Block<R>; KEPT],
    /// The blurs of a block down the columns, and the derivatives of S to the full blurs; both with [`margins`].
    down: [Block<R>; KINDS],
    slopes: [Block<R>; KINDS],
    /// Blocks of the derivatives blurred along the rows, indexed as those of `a`.
    lines: [[Block<R>; KINDS]; KEPT],
    gradient: Block<R>,
}

impl<R: Real> Scratch<R> {
    fn fit(&mut self, fold: Fold) {
        let (zero, length) = ([R::Lanes::default(); BLOCK], fold.length);
        for row in &mut self.rows {
            row.clear();
            row.resize(fold.padded::<R>(), R::ZERO);
        }
        self.pixels.clear();
        self.pixels.extend(fold.pixels::<R>());
        let blocks = self.image.iter_mut().chain(self.lines.iter_mut().flatten()).chain([&mut self.gradient]);
        blocks.for_each(|block| block.resize(length, zero));
        self.down.iter_mut().chain(&mut self.slopes).for_each(|block| block.resize(length + 2 * RADIUS, zero));
    }
}

/// A reference image with its blur and variance, computed once per view.
#[derive(Clone, Debug)]
pub struct SsimTarget<R: Real> {
    /// Rows and columns.
    shape: [usize; 2],
    /// The blocks of the image, between two blocks of zeros.
    blocks: Block<R>,
    /// The blur of the image and its variance, in blocks.
    moments: [Block<R>; 2],
}

impl<R: Real> SsimTarget<R> {
    /// Blurs the image `[v, u]` and its square.
    pub fn new(ssim: &Ssim<R>, image: ArrayView2<R>) -> Self {
        let image = image.as_standard_layout();
        let (rows, columns) = image.dim();
        let (fold, window, index) = (Fold::new::<R>(columns), Window::new(), Index::new(1.0));
        let (n, count) = (fold.length, rows.div_ceil(BLOCK));
        let zeros = |count: usize| vec![Column::<R>::default(); count * n];
        let (mut blocks, mut moments) = (zeros(count + 2), [zeros(count), zeros(count)]);
        if !image.is_empty() {
            let mut scratch = ssim.scratch.take();
            scratch.fit(fold);
            let rows = image.as_slice().expect("standard layout").chunks(BLOCK * columns);
            for (values, block) in rows.zip(blocks[n..].chunks_exact_mut(n)) {
                fold.deinterleave(values, &mut scratch.rows[0], block);
            }
        }
        let [of_b, variances] = moments.each_mut().map(|moments| threads::chunks(moments, n));
        threads::for_each_zip((of_b, variances), |i, (of_b, variances)| {
            let mut scratch = ssim.scratch.take();
            scratch.fit(fold);
            let near = [i, i + 1, i + 2].map(|i| &blocks[i * n..][..n]);
            let [down, down_square, _] = &mut scratch.down;
            for j in 0..n {
                let b = around(near, j);
                down[RADIUS + j] = window.down(&b);
                down_square[RADIUS + j] = window.down(|t| b(t) * b(t));
            }
            margins(down);
            margins(down_square);
            window.along(down, of_b);
            window.along(down_square, variances);
            for (of_b, variance) in of_b.iter().zip(variances) {
                *variance = from_fn(|row| index.variance(of_b[row], variance[row]));
            }
        });
        Self { shape: [rows, columns], blocks, moments }
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
        self.compare(image, target, [1.0, 0.0], None)[0]
    }

    /// [`Self::value`] and ∂SSIM/∂image, an array of the image's shape.
    ///
    /// # Panics
    /// When the shapes differ.
    pub fn value_and_grad(&self, image: ArrayView2<R>, target: &SsimTarget<R>) -> (f64, Array2<R>) {
        let mut gradient = Array2::default(image.raw_dim());
        let [value, _] = self.compare(image, target, [1.0, 0.0], Some(&mut gradient));
        (value, gradient)
    }

    /// SSIM and the mean absolute difference; writes the gradient of their weighted sum.
    ///
    /// Both are computed together, since they read the same pixels.
    pub(super) fn compare(
        &self,
        image: ArrayView2<R>,
        target: &SsimTarget<R>,
        weights: [f64; 2],
        gradient: Option<&mut Array2<R>>,
    ) -> [f64; 2] {
        assert_eq!(image.shape(), target.shape, "SSIM of an image and a target of different shapes");
        let image = image.as_standard_layout();
        let (rows, columns) = image.dim();
        let gradient = gradient.map(|gradient| {
            if gradient.dim() != image.dim() {
                *gradient = Array2::default(image.raw_dim());
            }
            gradient.as_slice_mut().expect("standard layout")
        });
        if image.is_empty() {
            return [1.0, 0.0];
        }
        let share = 1.0 / image.len() as f64;
        let [index, step] = [weights[0] * share, weights[1] * share];
        let (fold, window) = (Fold::new::<R>(columns), Window::new());
        let (index, step) = (Index::new(index), R::Lanes::splat_f64(step));
        let image = image.as_slice().expect("standard layout");
        let pass = Comparison { fold, window, index, step, image, rows, columns, target };
        let mut sums = self.sums.take();
        sums.resize(rows.div_ceil(SPAN * BLOCK), [0.0; 2]);
        let of_tasks = threads::chunks(&mut sums, 1);
        let of_task = |task: usize, gradient: Option<&mut [R]>| pass.task(task, &mut self.scratch.take(), gradient);
        match gradient {
            Some(gradient) => {
                let gradients = threads::chunks(gradient, SPAN * BLOCK * columns);
                threads::for_each_zip((of_tasks, gradients), |i, (sums, gradient)| {
                    sums[0] = of_task(i, Some(gradient))
                });
            }
            None => threads::for_each_zip(of_tasks, |i, sums| sums[0] = of_task(i, None)),
        }
        [0, 1].map(|which| reduce::sum_by(sums.len(), &|task| sums[task][which]) * share)
    }
}

/// The inputs of one comparison. Block numbers start two blocks before the image.
struct Comparison<'a, R: Real> {
    fold: Fold,
    window: Window<R::Lanes>,
    index: Index<R::Lanes>,
    /// ∂/∂a of the weighted mean absolute difference where a > b.
    step: R::Lanes,
    image: &'a [R],
    rows: usize,
    columns: usize,
    target: &'a SsimTarget<R>,
}

impl<R: Real> Comparison<'_, R> {
    /// The image's rows in a block.
    fn rows_of(&self, block: usize) -> Range<usize> {
        let at = |block: usize| (block * BLOCK).saturating_sub(2 * BLOCK).min(self.rows);
        at(block)..at(block + 1)
    }

    /// The sums of the task's blocks, and their gradient: a block's follows when the next block has its derivatives.
    fn task(&self, task: usize, scratch: &mut Scratch<R>, mut gradient: Option<&mut [R]>) -> Sums {
        scratch.fit(self.fold);
        let first = 2 + task * SPAN;
        let blocks = first..(first + SPAN).min(2 + self.rows.div_ceil(BLOCK));
        let mut sums = [0.0; 2];
        self.load_block(first - 2, scratch);
        self.load_block(first - 1, scratch);
        for block in first - 1..=blocks.end {
            self.load_block(block + 1, scratch);
            let of_block = self.differentiate(block, scratch);
            if blocks.contains(&block) {
                sums = [sums[0] + of_block[0], sums[1] + of_block[1]];
            }
            if block > first
                && let Some(gradient) = &mut gradient
            {
                let rows = gradient.chunks_mut(BLOCK * self.columns).nth(block - 1 - first);
                self.vjp(block - 1, scratch, rows.expect("a chunk for each block"));
            }
        }
        sums
    }

    /// Folds a block of `a`.
    fn load_block(&self, block: usize, scratch: &mut Scratch<R>) {
        let rows = self.rows_of(block);
        let values = &self.image[rows.start * self.columns..rows.end * self.columns];
        self.fold.deinterleave(values, &mut scratch.rows[0], &mut scratch.image[block % KEPT]);
    }

    /// The sums of a block; writes the derivatives of S, blurred along the rows, 0 outside of the image.
    fn differentiate(&self, block: usize, scratch: &mut Scratch<R>) -> Sums {
        let (n, rows, window) = (self.fold.length, self.rows_of(block).len(), self.window);
        let Scratch { pixels, image, down, slopes, lines, .. } = scratch;
        let lines = &mut lines[block % KEPT];
        if rows == 0 {
            lines.iter_mut().for_each(|line| line.fill(Column::<R>::default()));
            return [0.0; 2];
        }
        let a = [block - 1, block, block + 1].map(|block| &image[block % KEPT][..n]);
        let b = [block - 2, block - 1, block].map(|block| &self.target.blocks[block * n..][..n]);
        let moments = self.target.moments.each_ref().map(|moments| &moments[(block - 2) * n..][..n]);
        self.blur_down(a, b, down);
        let mut slopes_within = slopes.each_mut().map(|line| &mut line[RADIUS..][..n]);
        for (line, blur) in down.iter_mut().zip(&mut slopes_within) {
            margins(line);
            window.along(line, blur);
        }
        let sums = self.slopes(rows, pixels, [a[1], b[1]], moments, slopes_within);
        for (slopes, line) in slopes.iter_mut().zip(lines) {
            margins(slopes);
            window.along(slopes, line);
        }
        sums
    }

    /// Blurs `a`, `a²` and `ab` down the columns of a block, from it and its neighbours.
    ///
    /// One blur after another: together they would need more registers than there are.
    fn blur_down(&self, a: Neighbours<R>, b: Neighbours<R>, down: &mut [Block<R>; KINDS]) {
        let (n, window) = (self.fold.length, self.window);
        let [of_a, of_aa, of_ab] = down.each_mut().map(|line| line[RADIUS..][..n].iter_mut().enumerate());
        for (j, out) in of_a {
            *out = window.down(around(a, j));
        }
        for (j, out) in of_aa {
            let a = around(a, j);
            *out = window.down(|t| a(t) * a(t));
        }
        for (j, out) in of_ab {
            let (a, b) = (around(a, j), around(b, j));
            *out = window.down(|t| a(t) * b(t));
        }
    }

    /// Replaces the blurs of `a`, `a²` and `ab` in a block by the derivatives of S to them.
    ///
    /// The sums are over the rows within the image, lane by lane first.
    fn slopes(
        &self,
        rows: usize,
        pixels: &[R::Lanes],
        [a, b]: [&[Column<R>]; 2],
        [of_b, variance]: [&[Column<R>]; 2],
        [of_a, of_aa, of_ab]: [&mut [Column<R>]; KINDS],
    ) -> Sums {
        let (zero, mut sums) = (R::Lanes::default(), [0.0; 2]);
        for (j, &pixels) in pixels.iter().enumerate() {
            let (s, slopes) = self.index.within(pixels).slopes([of_b[j], variance[j]], [of_a[j], of_aa[j], of_ab[j]]);
            [of_a[j], of_aa[j], of_ab[j]] = slopes;
            for row in rows..BLOCK {
                [of_a[j][row], of_aa[j][row], of_ab[j][row]] = [zero; KINDS];
            }
            let (mut similarity, mut distance) = (zero, zero);
            for row in 0..rows {
                similarity += s[row];
                distance += (a[j][row] - b[j][row]).abs();
            }
            sums = [sums[0] + (similarity * pixels).sum(), sums[1] + distance.sum()];
        }
        sums
    }

    /// The gradient in a block, from the derivatives of S in it and its neighbours.
    fn vjp(&self, block: usize, scratch: &mut Scratch<R>, gradient: &mut [R]) {
        let n = self.fold.length;
        let Scratch { rows: [_, row], image, lines, gradient: folded, .. } = scratch;
        let kept = [block - 1, block, block + 1].map(|block| &lines[block % KEPT]);
        let lines: [_; KINDS] = from_fn(|kind| kept.map(|lines| &lines[kind][..n]));
        let (a, b) = (&image[block % KEPT][..n], &self.target.blocks[(block - 1) * n..][..n]);
        for (j, out) in folded.iter_mut().enumerate() {
            let down = |kind: usize| self.window.down(around(lines[kind], j));
            let [by_a, by_aa, by_ab] = [down(0), down(1), down(2)];
            for (row, out) in out.iter_mut().enumerate() {
                let (a, b) = (a[j][row], b[j][row]);
                let of_index = b.fma(by_ab[row], (-a).fma(by_aa[row], by_a[row]));
                *out = self.slope_of_distance(a - b) + of_index;
            }
        }
        self.fold.interleave(folded, row, gradient);
    }

    /// `step`, with the sign of the difference; 0 also for NaN.
    #[inline(always)]
    fn slope_of_distance(&self, difference: R::Lanes) -> R::Lanes {
        let zero = R::Lanes::default();
        zero.select_le(difference, self.step, zero) - difference.select_le(zero, self.step, zero)
    }
}
