//! Counting the points of a sphere that lie within tubes round its diameters: the hot loop.

use super::naive;
use crate::numeric::{Lanes, Real};
use glam::DVec3;

/// Points that are tested together.
type Row = <f64 as Real>::Lanes;

/// A tube round the chord from `-direction` to `+direction`, in the primitive's local frame.
#[derive(Clone, Copy, Debug)]
pub(super) struct Tube {
    /// Unit vector.
    pub(super) direction: DVec3,
    /// `1 - r²`: the tube holds the points p of the sphere with `(p·u)²` not below this.
    pub(super) nearest: f64,
}

/// The x, y and z of the points, a row at a time; the last is filled up with NaN, which no tube holds.
pub(super) struct Sphere {
    rows: Vec<[Row; 3]>,
}

impl Sphere {
    /// `n` points.
    pub(super) fn new(n: usize) -> Self {
        let point = |k: usize| if k < n { naive::sphere_point(k, n) } else { DVec3::NAN };
        let row = |first: usize| [0, 1, 2].map(|axis| Row::from_fn(|lane| point(first + lane)[axis]));
        Self { rows: (0..n).step_by(Row::WIDTH).map(row).collect() }
    }

    /// Number of points within at least one tube.
    ///
    /// A point keeps the least of `(1 - r²) - (p·u)²` over the tubes; a difference has the sign of the comparison.
    pub(super) fn covered(&self, tubes: &[Tube]) -> f64 {
        let (zero, one) = (Row::splat(0.0), Row::splat(1.0));
        let mut covered = zero;
        for [x, y, z] in &self.rows {
            let mut outside = Row::splat(f64::INFINITY);
            for tube in tubes {
                // Not a `map` of the array: the compiler leaves it a call, with the sums in memory.
                let DVec3 { x: ux, y: uy, z: uz } = tube.direction;
                let along = *x * Row::splat(ux) + *y * Row::splat(uy) + *z * Row::splat(uz);
                outside = (Row::splat(tube.nearest) - along * along).at_most(outside);
            }
            covered += outside.select_le(zero, one, zero);
        }
        covered.sum()
    }
}
