//! Which pixels or voxels lie within an interval, of eight primitives at a time.

use crate::numeric::Lanes;
use crate::numeric::vectors::{EIGHT, Eight, all};
use std::ops::Range;

/// Eight intervals on an axis of pixels or voxels, in fractional indices.
#[derive(Clone, Copy, Debug)]
pub(super) struct Extents {
    pub(super) low: Eight,
    pub(super) high: Eight,
    /// A breath of rounding, in indices.
    slack: Eight,
}

impl Extents {
    /// What lies within `half` of the offset `middle` from index `centre`; `step` is the length per index.
    #[inline(always)]
    pub(super) fn new(centre: Eight, step: Eight, middle: Eight, half: Eight) -> Self {
        Self {
            low: centre + (middle - half) / step,
            high: centre + (middle + half) / step,
            slack: all(1e-9) * (all(1.0) + half / step),
        }
    }

    /// The indices below `count` within, with the breath of rounding to spare. What is not a number bounds nothing.
    #[inline(always)]
    pub(super) fn indices(self, count: usize) -> Indices {
        let zero = all(0.0);
        let first = (self.low - self.slack).ceil().at_least(zero);
        let last = (self.high + self.slack).floor().at_most(all(count as f64 - 1.0));
        let some = first.simd_le(last);
        Indices { start: some.select(first, zero), end: some.select(last + all(1.0), zero) }
    }
}

/// Eight ranges of indices; whole numbers.
#[derive(Clone, Copy, Debug)]
pub(super) struct Indices {
    pub(super) start: Eight,
    pub(super) end: Eight,
}

impl Indices {
    /// These where `some` is not 0, elsewhere all of `count`.
    #[inline(always)]
    pub(super) fn or_all(self, some: Eight, count: usize) -> Self {
        Self { start: some.select(self.start, all(0.0)), end: some.select(self.end, all(count as f64)) }
    }

    /// Numbers of indices.
    #[inline(always)]
    pub(super) fn len(self) -> Eight {
        self.end - self.start
    }

    /// A range for each lane.
    #[inline(always)]
    pub(super) fn ranges(self) -> [Range<usize>; EIGHT] {
        let (start, end) = (self.start.to_array(), self.end.to_array());
        std::array::from_fn(|i| start[i] as usize..end[i] as usize)
    }
}
