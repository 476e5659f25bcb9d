//! The blur: the layout of rows in registers, and the window.
//!
//! A row is cut into as many pieces as a register has lanes, and register i holds pixel i of every piece (the
//! dimension-lifted layout of Henretty et al. 2011). The neighbours of a register's pixels are in the neighbouring
//! registers, so that a blur along a row needs no unaligned loads, as one down the columns.

use crate::numeric::elementary::exp;
use crate::numeric::rearrange::{INTERLEAVED, Rearrange};
use crate::numeric::{Lanes, Real};
use std::array::from_fn;

/// Pixels of the window on each side of the centre.
pub(super) const RADIUS: usize = 5;
const TAPS: usize = 2 * RADIUS + 1;
/// Rows of a block: the radius, so that the window covers exactly the block before and the block after.
pub(super) const BLOCK: usize = RADIUS;
/// The rows of three blocks.
const REACHED: usize = 3 * BLOCK;
/// Standard deviation of the window, pixels.
const SIGMA: f64 = 1.5;

/// A register of each row of a block.
pub(super) type Column<R> = [<R as Real>::Lanes; BLOCK];

/// Rows cut into pieces.
#[derive(Clone, Copy, Debug)]
pub(super) struct Fold {
    columns: usize,
    /// Pixels of a piece: at least as many as are interleaved together, so that the window ends within the next piece.
    pub(super) length: usize,
}

impl Fold {
    pub(super) fn new<R: Real>(columns: usize) -> Self {
        Self { columns, length: columns.div_ceil(R::Lanes::WIDTH).max(INTERLEAVED) }
    }

    /// Values of a row padded to whole pieces.
    pub(super) fn padded<R: Real>(self) -> usize {
        R::Lanes::WIDTH * self.length
    }

    /// Values of a row with whole pieces: the values themselves, or a copy padded with zeros in `row`.
    fn whole<'a, R: Real>(self, values: &'a [R], row: &'a mut [R]) -> &'a [R] {
        if values.len() == row.len() {
            return values;
        }
        row[..values.len()].copy_from_slice(values);
        row
    }

    /// First columns of the groups that are interleaved together; the last group overlaps the one before.
    fn starts(self) -> impl Iterator<Item = usize> {
        (0..self.length).step_by(INTERLEAVED).map(move |start| start.min(self.length - INTERLEAVED))
    }

    /// Folds rows, contiguous in `values`, into the first rows of a block; the others become 0.
    ///
    /// `row` is scratch, padded with zeros.
    pub(super) fn deinterleave<R: Real>(self, values: &[R], row: &mut [R], block: &mut [Column<R>]) {
        let rows = values.len() / self.columns;
        if rows < BLOCK {
            block.fill([R::Lanes::default(); BLOCK]);
        }
        for (r, values) in values.chunks_exact(self.columns).enumerate() {
            let row = self.whole(values, row);
            for start in self.starts() {
                let columns = block[start..].first_chunk_mut().expect("as many as are interleaved together");
                R::Lanes::deinterleave(&row[start..], self.length, columns, r);
            }
        }
    }

    /// Writes the first rows of a block to `values`, as many as fit. `row` is scratch.
    pub(super) fn interleave<R: Real>(self, block: &[Column<R>], row: &mut [R], values: &mut [R]) {
        for (r, values) in values.chunks_exact_mut(self.columns).enumerate() {
            let whole = values.len() == row.len();
            let to = if whole { &mut *values } else { &mut *row };
            for start in self.starts() {
                let columns = block[start..].first_chunk().expect("as many as are interleaved together");
                R::Lanes::interleave(columns, r, &mut to[start..], self.length);
            }
            if !whole {
                values.copy_from_slice(&row[..self.columns]);
            }
        }
    }

    /// For each register, 1 in the lanes that hold a pixel, else 0.
    pub(super) fn pixels<R: Real>(self) -> impl Iterator<Item = R::Lanes> {
        (0..self.length).map(move |i| {
            R::Lanes::from_fn(|lane| if lane * self.length + i < self.columns { R::ONE } else { R::ZERO })
        })
    }
}

/// The weights of a Gaussian at distance 1, 2, … from the centre, whose weight is 1.
///
/// The blur is a sum and not a mean, so that the centre needs no multiplication.
#[derive(Clone, Copy, Debug)]
pub(super) struct Window<T>([T; RADIUS]);

/// Weight at some distance from the centre.
fn gauss(distance: usize) -> f64 {
    exp(-((distance * distance) as f64) / (2.0 * SIGMA * SIGMA))
}

/// The sum of the weights in rows and columns.
pub(super) fn total() -> f64 {
    let of_row = 1.0 + 2.0 * (1..=RADIUS).map(gauss).sum::<f64>();
    of_row * of_row
}

impl<L: Lanes> Window<L> {
    pub(super) fn new() -> Self {
        Self(from_fn(|i| L::splat_f64(gauss(1 + i))))
    }

    /// `Σ_t w_t x(t)` over the eleven taps, from the centre outwards.
    #[inline(always)]
    fn weighted_sum(&self, x: impl Fn(usize) -> L) -> L {
        let Self(weights) = self;
        let outer = (1..).zip(weights);
        outer.fold(x(RADIUS), |sum, (d, &weight)| (x(RADIUS - d) + x(RADIUS + d)).fma(weight, sum))
    }

    /// Down a column: from the rows of a block and its neighbours to those of the block.
    // Not `from_fn`, which is not inlined where a register of lanes is two of the processor's.
    #[inline(always)]
    pub(super) fn down(&self, x: impl Fn(usize) -> L) -> [L; BLOCK] {
        let x: [L; REACHED] =
            [x(0), x(1), x(2), x(3), x(4), x(5), x(6), x(7), x(8), x(9), x(10), x(11), x(12), x(13), x(14)];
        let y = |row: usize| self.weighted_sum(|t| x[row + t]);
        [y(0), y(1), y(2), y(3), y(4)]
    }

    /// Along the rows of a block: from a line with margins. Two columns at a time share most loads.
    pub(super) fn along(&self, line: &[[L; BLOCK]], out: &mut [[L; BLOCK]]) {
        let last = out.len() - 2;
        for j in (0..out.len()).step_by(2) {
            let j = j.min(last);
            let columns: &[_; TAPS + 1] = line[j..].first_chunk().expect("margins");
            let [first, second] = out[j..].first_chunk_mut().expect("two columns");
            for row in 0..BLOCK {
                first[row] = self.weighted_sum(|t| columns[t][row]);
                second[row] = self.weighted_sum(|t| columns[1 + t][row]);
            }
        }
    }
}

/// Column j of a block and its neighbours.
#[inline(always)]
pub(super) fn around<'a, L: Copy>(blocks: [&'a [[L; BLOCK]]; 3], j: usize) -> impl Fn(usize) -> L + 'a {
    let columns = [&blocks[0][j], &blocks[1][j], &blocks[2][j]];
    move |t| columns[t / BLOCK][t % BLOCK]
}

/// Fills the margins of a line with the columns of the pieces before and after, 0 outside of the image.
pub(super) fn margins<L: Lanes>(line: &mut [[L; BLOCK]]) {
    let length = line.len() - 2 * RADIUS;
    for i in 0..RADIUS {
        line[i] = from_fn(|row| line[length + i][row].shift_up());
        line[RADIUS + length + i] = from_fn(|row| line[RADIUS + i][row].shift_down());
    }
}
