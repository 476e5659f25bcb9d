//! Which pixels or voxels lie within an interval, of eight primitives at a time.

use crate::numeric::Lanes;
use crate::numeric::vectors::{LANES, f64x8, splat};
use std::ops::Range;

/// f64x8 intervals on an axis of pixels or voxels, in fractional indices.
#[derive(Clone, Copy, Debug)]
pub(super) struct Extents {
    pub(super) low: f64x8,
    pub(super) high: f64x8,
    /// A breath of rounding, in indices.
    slack: f64x8,
}

impl Extents {
    /// What lies within `half` of the offset `middle` from index `centre`; `step` is the length per index.
    #[inline(always)]
    pub(super) fn new(centre: f64x8, step: f64x8, middle: f64x8, half: f64x8) -> Self {
        Self {
            low: centre + (middle - half) / step,
            high: centre + (middle + half) / step,
            slack: splat(1e-9) * (splat(1.0) + half / step),
        }
    }

    /// The indices below `count` within, with the breath of rounding to spare. What is not a number bounds nothing.
    #[inline(always)]
    pub(super) fn indices(self, count: usize) -> Indices {
        let zero = splat(0.0);
        let first = (self.low - self.slack).ceil().at_least(zero);
        let last = (self.high + self.slack).floor().at_most(splat(count as f64 - 1.0));
        let some = first.simd_le(last);
        Indices { start: some.select(first, zero), end: some.select(last + splat(1.0), zero) }
    }
}

/// f64x8 ranges of indices; whole numbers.
#[derive(Clone, Copy, Debug)]
pub(super) struct Indices {
    pub(super) start: f64x8,
    pub(super) end: f64x8,
}

impl Indices {
    /// These where `some` is not 0, elsewhere all of `count`.
    #[inline(always)]
    pub(super) fn or_all(self, some: f64x8, count: usize) -> Self {
        Self { start: some.select(self.start, splat(0.0)), end: some.select(self.end, splat(count as f64)) }
    }

    /// Numbers of indices.
    #[inline(always)]
    pub(super) fn len(self) -> f64x8 {
        self.end - self.start
    }

    /// A range for each lane.
    #[inline(always)]
    pub(super) fn ranges(self) -> [Range<usize>; LANES] {
        let (start, end) = (self.start.to_array(), self.end.to_array());
        std::array::from_fn(|i| start[i] as usize..end[i] as usize)
    }
}
