//! Index ranges of intervals on an axis of pixels or voxels, of eight primitives at a time.

use crate::numeric::Lanes;
use crate::numeric::vectors::{LANES, f64x8, splat};
use std::ops::Range;

/// Eight intervals on an axis of pixels or voxels, in fractional indices.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Extents {
    pub(crate) low: f64x8,
    pub(crate) high: f64x8,
    /// Allowance for rounding, in indices.
    slack: f64x8,
}

impl Extents {
    /// The interval within `half` of the offset `middle` from index `centre`; `step` is the length per index.
    #[inline(always)]
    pub(crate) fn new(centre: f64x8, step: f64x8, middle: f64x8, half: f64x8) -> Self {
        Self {
            low: centre + (middle - half) / step,
            high: centre + (middle + half) / step,
            slack: splat(1e-9) * (splat(1.0) + half / step),
        }
    }

    /// The indices below `count` within the interval, widened by the slack. NaN bounds are treated as unbounded.
    #[inline(always)]
    pub(crate) fn indices(self, count: usize) -> Indices {
        let zero = splat(0.0);
        let first = (self.low - self.slack).ceil().at_least(zero);
        let last = (self.high + self.slack).floor().at_most(splat(count as f64 - 1.0));
        let is_any = first.simd_le(last);
        Indices { start: is_any.select(first, zero), end: is_any.select(last + splat(1.0), zero) }
    }
}

/// Eight index ranges; all bounds are integers.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Indices {
    pub(crate) start: f64x8,
    pub(crate) end: f64x8,
}

impl Indices {
    /// These ranges in the lanes of the mask, elsewhere `0..count`.
    #[inline(always)]
    pub(crate) fn or_all(self, mask: f64x8, count: usize) -> Self {
        Self { start: mask.select(self.start, splat(0.0)), end: mask.select(self.end, splat(count as f64)) }
    }

    /// Numbers of indices.
    #[inline(always)]
    pub(crate) fn len(self) -> f64x8 {
        self.end - self.start
    }

    /// The range of each lane.
    #[inline(always)]
    pub(crate) fn ranges(self) -> [Range<usize>; LANES] {
        let (start, end) = (self.start.to_array(), self.end.to_array());
        std::array::from_fn(|i| start[i] as usize..end[i] as usize)
    }
}
