//! Rotations from quaternions (w,x,y,z) of any length.

use crate::numeric::Lanes;
use crate::numeric::vectors::{DMat3x8, DVec3x8, LANES, f64x8, powers_of_two_below, splat};
use glam::DQuat;

/// Smallest allowed largest entry: the gradient, which grows like 1/length, can still be squared.
pub(crate) const SMALLEST: f64 = 1e-150;

/// Whether a quaternion has a direction: finite, the largest magnitude at least [`SMALLEST`].
pub(crate) fn is_usable(q: [f64; 4]) -> bool {
    q.iter().all(|x| x.is_finite()) && largest(q) >= SMALLEST
}

/// The unit quaternion `q/|q|` and the length `|q|` of a usable quaternion.
///
/// The length is computed in units of the power of two below the largest entry. Its square neither overflows nor
/// underflows, and the bits equal those of the plain formula where that formula works.
pub(crate) fn unit(q: [f64; 4]) -> (DQuat, f64) {
    let (units, norms) = Units::new(q.map(splat));
    (units.to_array()[0], norms.to_array()[0])
}

/// Unit quaternions, one per lane.
#[derive(Clone, Copy)]
pub(crate) struct Units {
    w: f64x8,
    v: DVec3x8,
}

impl Units {
    /// [`unit()`] of each lane: unit quaternions and lengths of quaternions (w,x,y,z) of any length.
    #[inline(always)]
    pub(crate) fn new(q: [f64x8; 4]) -> (Self, f64x8) {
        let largest = q.iter().fold(splat(0.0), |largest, entry| entry.abs().at_least(largest));
        let scale = powers_of_two_below(largest);
        let [w, x, y, z] = q.map(|entry| entry / scale);
        let norm = (w * w + x * x + y * y + z * z).sqrt();
        (Self { w: w / norm, v: DVec3x8::new(x / norm, y / norm, z / norm) }, norm * scale)
    }

    /// The quaternion of each lane.
    #[inline(always)]
    pub(crate) fn to_array(self) -> [DQuat; LANES] {
        let (w, v) = (self.w.to_array(), self.v.to_array());
        std::array::from_fn(|i| DQuat::from_xyzw(v[i].x, v[i].y, v[i].z, w[i]))
    }

    /// The transposed rotation matrix, which is the inverse rotation; bit-identical to glam's.
    #[inline(always)]
    pub(crate) fn transposed(self) -> DMat3x8 {
        let (one, Self { w, v: DVec3x8 { x, y, z } }) = (splat(1.0), self);
        let (x2, y2, z2) = (x + x, y + y, z + z);
        let (xx, xy, xz, yy, yz, zz) = (x * x2, x * y2, x * z2, y * y2, y * z2, z * z2);
        let (wx, wy, wz) = (w * x2, w * y2, w * z2);
        let rows = [
            DVec3x8::new(one - (yy + zz), xy - wz, xz + wy),
            DVec3x8::new(xy + wz, one - (xx + zz), yz - wx),
            DVec3x8::new(xz - wy, yz + wx, one - (xx + yy)),
        ];
        DMat3x8 { columns: rows }
    }
}

/// The largest magnitude of an entry.
fn largest(q: [f64; 4]) -> f64 {
    q.iter().fold(0.0, |largest, x| if x.abs() > largest { x.abs() } else { largest })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::numeric::rng::{Purpose, stream};
    use crate::tolerances::relative;
    use rand::RngExt;

    /// A quaternion with entries of very different magnitudes.
    fn quaternion(id: u64) -> [f64; 4] {
        let mut random = stream(1, Purpose::Phantom, 0, id);
        std::array::from_fn(|_| {
            let sign = if random.random::<bool>() { 1.0 } else { -1.0 };
            sign * libm::pow(10.0, 12.0 * random.random::<f64>() - 6.0)
        })
    }

    #[test]
    fn ordinary_quaternions_keep_the_bits_of_the_plain_formula() {
        for id in 0..10_000 {
            let q = quaternion(id);
            let [w, x, y, z] = q;
            let norm = (w * w + x * x + y * y + z * z).sqrt();
            let (unit, length) = unit(q);
            assert_eq!(length.to_bits(), norm.to_bits(), "{q:?}");
            assert_eq!(unit.to_array().map(f64::to_bits), [x, y, z, w].map(|x| (x / norm).to_bits()), "{q:?}");
        }
    }

    #[test]
    fn tiny_and_huge_quaternions_keep_their_direction() {
        let (expected, length) = unit([0.7, -0.3, 0.5, 0.2]);
        for factor in [1e-149, 1e-100, 1e100, 1e150, 1e300] {
            let q = [0.7, -0.3, 0.5, 0.2].map(|x| x * factor);
            assert!(is_usable(q), "{factor:e}");
            let (direction, norm) = unit(q);
            within!(relative(norm, length * factor));
            within!((direction - expected).length(), "{factor:e}: {direction}");
        }
        for bad in [[0.0; 4], [1e-151; 4], [1.0, f64::NAN, 0.0, 0.0], [f64::INFINITY, 1.0, 0.0, 0.0]] {
            assert!(!is_usable(bad), "{bad:?}");
        }
    }
}
