//! Linear interpolation at evenly spaced positions of a line of values, and its transpose.
//!
//! Not in the paper.
//!
//! Both find neighbours within registers. Interpolation takes positions as lanes and looks up values; its transpose
//! takes values as lanes and looks up the positions within reach, so that nothing is scattered. Half of the lanes share
//! a table that starts at their first position; if positions are too far apart for a table, fewer lanes are used.

use std::ops::Range;
use trgs_core::numeric::{Lanes, Real, real};

/// Largest number of lanes.
const MOST: usize = 16;

/// Evenly spaced positions: number k at `first + k·pitch`, pitch > 0.
#[derive(Clone, Copy)]
pub(super) struct Places {
    pub(super) first: f64,
    pub(super) pitch: f64,
}

impl Places {
    pub(super) fn at(&self, k: usize) -> f64 {
        self.first + k as f64 * self.pitch
    }

    /// The subrange of `numbers` with `low < place < high`.
    pub(super) fn within(&self, numbers: &Range<usize>, low: f64, high: f64) -> Range<usize> {
        let (from, to) = ((low - self.first) / self.pitch, (high - self.first) / self.pitch);
        let clamped = |k: f64| k.clamp(numbers.start as f64, numbers.end as f64) as usize;
        let (mut start, mut end) = (clamped(from.floor()), clamped(to.ceil() + 1.0));
        while start < end && self.at(start) <= low {
            start += 1;
        }
        while start < end && self.at(end - 1) >= high {
            end -= 1;
        }
        start..end
    }
}

/// Values required after the last one that a position needs; also zeros at both ends for [`spread`].
pub(super) const fn margin<R: Real>() -> usize {
    R::Lanes::WIDTH + 2
}

/// The span of a table: its width, and how many lanes of a half use it.
#[derive(Clone, Copy)]
struct TableSpan {
    is_wide: bool,
    lanes: usize,
}

impl TableSpan {
    /// For lanes that are `spacing` values apart.
    fn new<R: Real>(spacing: f64) -> Self {
        let half = R::Lanes::WIDTH / 2;
        // Positions are rounded in the precision of the lanes: the last entry is kept free.
        let lanes = |entries: usize| (((entries - 1) as f64 - 1e-3) / spacing).min(half as f64 - 1.0) as usize + 1;
        let narrow = lanes(half);
        if narrow == half {
            Self { is_wide: false, lanes: half }
        } else {
            Self { is_wide: true, lanes: lanes(2 * half) }
        }
    }
}

/// Adds the used lanes of both halves to the values, as far as there are values.
#[inline(always)]
fn add<L: Lanes>(lanes: L, reach: TableSpan, values: &mut [L::Scalar]) {
    if 2 * reach.lanes == L::WIDTH && values.len() >= L::WIDTH {
        (L::from_slice(values) + lanes).write(values);
        return;
    }
    let mut all = [L::Scalar::ZERO; MOST];
    lanes.write(&mut all);
    for (half, values) in all.chunks_exact(L::WIDTH / 2).zip(values.chunks_mut(reach.lanes)) {
        values.iter_mut().zip(half).for_each(|(value, lane)| *value += *lane);
    }
}

/// One number per half of the lanes.
#[inline(always)]
fn halves<L: Lanes>([a, b]: [f64; 2]) -> L {
    L::from_fn(|lane| real(if lane < L::WIDTH / 2 { a } else { b }))
}

/// 0, `spacing`, 2·`spacing`, … in each half of the lanes.
#[inline(always)]
fn steps<L: Lanes>(spacing: f64) -> L {
    L::from_fn(|lane| L::Scalar::from_index(lane % (L::WIDTH / 2))) * L::splat_f64(spacing)
}

#[inline(always)]
fn lookup<L: Lanes, const WIDE: bool>(tables: [&[L::Scalar]; 2], index: L::Index) -> L {
    if WIDE { L::lookup_wide(tables, index) } else { L::lookup(tables, index) }
}

/// `out[k] += (1-t)·line[i] + t·line[i+1]` with `i + t = places.at(k)`, for k in `numbers`.
///
/// Positions are at least 0, and the line has [`margin`] more values after the last one needed.
///
/// Tests: `places_are_interpolated`, `spreading_is_the_transpose`.
#[inline]
pub(super) fn interpolate<R: Real>(line: &[R], places: Places, numbers: Range<usize>, out: &mut [R]) {
    let reach = TableSpan::new::<R>(places.pitch);
    if reach.is_wide {
        interpolate_by::<R, true>(line, places, numbers, out, reach);
    } else {
        interpolate_by::<R, false>(line, places, numbers, out, reach);
    }
}

#[inline(always)]
fn interpolate_by<R: Real, const WIDE: bool>(
    line: &[R],
    places: Places,
    numbers: Range<usize>,
    out: &mut [R],
    reach: TableSpan,
) {
    let steps = steps::<R::Lanes>(places.pitch);
    for start in numbers.clone().step_by(2 * reach.lanes) {
        // Relative to the first, positions are small numbers in the precision of the lanes.
        let from = [places.at(start), places.at((start + reach.lanes).min(numbers.end - 1))];
        let first = [from[0].floor(), from[1].floor()];
        let tables = [&line[first[0] as usize..], &line[first[1] as usize..]];
        let (index, share) = (halves::<R::Lanes>([from[0] - first[0], from[1] - first[1]]) + steps).split();
        let below = lookup::<R::Lanes, WIDE>(tables, index);
        let above = lookup::<R::Lanes, WIDE>([&tables[0][1..], &tables[1][1..]], index);
        add(below + (above - below) * share, reach, &mut out[start..numbers.end]);
    }
}

/// The transpose of [`interpolate`], by gathering: calls `give(heights, sums)` for lanes of heights.
///
/// The sums are over all positions, of `max(0, 1 - |places.at(k) - z|)·columns[n][margin + k]`; together the calls
/// cover `heights`. `columns` have [`margin`] zeros at both ends and zeros for positions outside `numbers`.
///
/// Tests: as [`interpolate`].
#[inline]
pub(super) fn spread<R: Real, const N: usize>(
    columns: [&[R]; N],
    places: Places,
    numbers: &Range<usize>,
    heights: Range<usize>,
    give: impl FnMut(Range<usize>, Shares<R::Lanes, N>),
) {
    let reach = TableSpan::new::<R>(1.0 / places.pitch);
    if reach.is_wide {
        spread_by::<R, N, true>(columns, places, numbers, heights, reach, give);
    } else {
        spread_by::<R, N, false>(columns, places, numbers, heights, reach, give);
    }
}

/// The sums for the heights of one set of lanes.
pub(super) struct Shares<L, const N: usize> {
    sums: [L; N],
    reach: TableSpan,
}

impl<L: Lanes, const N: usize> Shares<L, N> {
    /// Adds `factor` times the n-th sums to the values at the heights.
    #[inline(always)]
    pub(super) fn add(&self, n: usize, factor: L::Scalar, values: &mut [L::Scalar]) {
        add(self.sums[n] * L::splat(factor), self.reach, values);
    }
}

#[inline(always)]
fn spread_by<R: Real, const N: usize, const WIDE: bool>(
    columns: [&[R]; N],
    places: Places,
    numbers: &Range<usize>,
    heights: Range<usize>,
    reach: TableSpan,
    mut give: impl FnMut(Range<usize>, Shares<R::Lanes, N>),
) {
    let (margin, one, zero) = (margin::<R>() as f64, R::Lanes::splat(R::ONE), R::Lanes::default());
    let per_place = 1.0 / places.pitch;
    let (steps, pitch) = (steps::<R::Lanes>(per_place), R::Lanes::splat_f64(places.pitch));
    let table_end = columns[0].len() as f64 - margin;
    for z in heights.clone().step_by(2 * reach.lanes) {
        // The integer part of this is the number of the first position above z - 1.
        let from = (z as f64 - 1.0 - places.first) * per_place + 1.0;
        let from = [from, from + reach.lanes as f64 * per_place];
        let first = [from[0].floor(), from[1].floor()];
        let (index, rest) = (halves::<R::Lanes>([from[0] - first[0], from[1] - first[1]]) + steps).split();
        // That position is a pitch above z - 1, less the fraction.
        let above = pitch - rest * pitch - one;
        // The number of positions within two heights, of which at least one lane needs those that exist.
        let skipped = (numbers.start as f64 - first[1] - margin).max(0.0);
        let end = (2.0 * per_place).ceil().min(numbers.end as f64 - first[0]);
        let mut sums = [zero; N];
        let mut step = skipped;
        while step < end {
            let distance = above + pitch * R::Lanes::splat_f64(step);
            let weight = one - distance.abs();
            let weight = weight.select_le(zero, zero, weight);
            // Beyond either end of the column all values are zero.
            let at = |first: f64| (first + step + margin).clamp(0.0, table_end) as usize;
            let at = [at(first[0]), at(first[1])];
            for n in 0..N {
                let tables = [&columns[n][at[0]..], &columns[n][at[1]..]];
                sums[n] += lookup::<R::Lanes, WIDE>(tables, index) * weight;
            }
            step += 1.0;
        }
        give(z..heights.end.min(z + 2 * reach.lanes), Shares { sums, reach });
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const NUMBERS: Range<usize> = 3..61;

    /// Pitches that use narrow and wide tables, all lanes and few; positions from just above -1 on.
    fn places() -> impl Iterator<Item = Places> {
        let pitches = [0.01, 0.13, 0.37, 0.5, 0.51, 0.7, 0.93, 1.0, 1.01, 1.9, 2.2, 3.7, 20.0, 300.0];
        pitches.into_iter().map(|pitch| Places { first: 0.4 - 3.0 * pitch, pitch })
    }

    fn noise<R: Real>(n: usize, salt: u64) -> Vec<R> {
        (0..n as u64)
            .map(|i| R::from_f64(((i * 2_654_435_761 + salt * 40_503) % 10_007) as f64 / 5003.5 - 1.0))
            .collect()
    }

    /// The linearly interpolated value at height z of a line.
    fn plain<R: Real>(line: &[R], z: f64) -> f64 {
        let (i, t) = (z.floor() as usize, z - z.floor());
        (1.0 - t) * line[i].to_f64() + t * line[i + 1].to_f64()
    }

    fn interpolates<R: Real>(tolerance: f64) {
        for places in places() {
            let line = noise::<R>(places.at(NUMBERS.end) as usize + 2 + margin::<R>(), 1);
            let mut out = noise::<R>(70, 2);
            let before = out.clone();
            interpolate(&line, places, NUMBERS, &mut out);
            for (k, (after, before)) in out.iter().zip(before).enumerate() {
                let expected = before.to_f64() + if NUMBERS.contains(&k) { plain(&line, places.at(k)) } else { 0.0 };
                assert!((after.to_f64() - expected).abs() < tolerance, "{k} at pitch {}", places.pitch);
            }
        }
    }

    #[test]
    fn places_are_interpolated() {
        interpolates::<f64>(1e-12);
        interpolates::<f32>(2e-5);
    }

    fn transposes<R: Real>(tolerance: f64) {
        for places in places() {
            let heights = 2..(places.at(NUMBERS.end) as usize + 5).min(400);
            let mut columns = [noise::<R>(70 + 2 * margin::<R>(), 1), noise::<R>(70 + 2 * margin::<R>(), 2)];
            for column in &mut columns {
                let values = margin::<R>() + NUMBERS.start..margin::<R>() + NUMBERS.end;
                column.iter_mut().enumerate().filter(|(i, _)| !values.contains(i)).for_each(|(_, v)| *v = R::ZERO);
            }
            let mut sums = [vec![R::ZERO; 410], vec![R::ZERO; 410]];
            let slices = columns.each_ref().map(Vec::as_slice);
            spread(slices, places, &NUMBERS, heights.clone(), |heights, shares| {
                (0..2).for_each(|n| shares.add(n, R::ONE, &mut sums[n][heights.clone()]));
            });
            for (n, sums) in sums.iter().enumerate() {
                for (z, sum) in sums.iter().enumerate() {
                    let weight = |k: usize| (1.0 - (places.at(k) - z as f64).abs()).max(0.0);
                    let of = |k: usize| weight(k) * columns[n][margin::<R>() + k].to_f64();
                    let expected: f64 = NUMBERS.filter(|_| heights.contains(&z)).map(of).sum();
                    assert!(
                        (sum.to_f64() - expected).abs() < tolerance,
                        "{z} at pitch {}: {sum}, {expected}",
                        places.pitch
                    );
                }
            }
        }
    }

    #[test]
    fn spreading_is_the_transpose() {
        transposes::<f64>(1e-12);
        transposes::<f32>(2e-5);
    }
}
