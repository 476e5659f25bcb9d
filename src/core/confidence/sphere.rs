//! **HOT.** Counts the points of a sphere within tubes around its diameters.

use super::naive;
use crate::numeric::Lanes;
use crate::numeric::vectors::f64x8;
use glam::DVec3;

/// A tube around the chord from `-direction` to `+direction`, in the primitive's local frame.
#[derive(Clone, Copy, Debug)]
pub(super) struct Tube {
    /// Unit vector.
    pub(super) direction: DVec3,
    /// `1 - r²`: the tube holds the points p of the sphere with `(p·u)²` not below this.
    pub(super) nearest: f64,
}

/// The x, y and z of the points, a register at a time; the last is padded with NaN, which is in no tube.
pub(super) struct Sphere {
    rows: Vec<[f64x8; 3]>,
}

impl Sphere {
    /// `n` points.
    pub(super) fn new(n: usize) -> Self {
        let point = |k: usize| if k < n { naive::sphere_point(k, n) } else { DVec3::NAN };
        let row = |first: usize| [0, 1, 2].map(|axis| f64x8::from_fn(|lane| point(first + lane)[axis]));
        Self { rows: (0..n).step_by(f64x8::WIDTH).map(row).collect() }
    }

    /// Number of points within at least one tube.
    ///
    /// A point keeps the least of `(1 - r²) - (p·u)²` over the tubes; a difference has the sign of the comparison.
    pub(super) fn covered(&self, tubes: &[Tube]) -> f64 {
        let (zero, one) = (f64x8::splat(0.0), f64x8::splat(1.0));
        let mut covered = zero;
        for [x, y, z] in &self.rows {
            let mut outside = f64x8::splat(f64::INFINITY);
            for tube in tubes {
                // Not a `map` of the array: the compiler leaves it a call, with the sums in memory.
                let DVec3 { x: ux, y: uy, z: uz } = tube.direction;
                let along = *x * f64x8::splat(ux) + *y * f64x8::splat(uy) + *z * f64x8::splat(uz);
                outside = (f64x8::splat(tube.nearest) - along * along).at_most(outside);
            }
            covered += outside.select_le(zero, one, zero);
        }
        covered.sum()
    }
}
