//! Eight numbers or vectors at a time, one per lane, for work done once per primitive.
//!
//! Results are bit-identical to the scalar path with glam's `DVec3`: the operations and their order are the same.

use super::Lanes;
use glam::DVec3;
use std::ops::{Add, Mul, Sub};
use wide::u64x8;

pub use wide::f64x8;

/// Lanes of an [`f64x8`].
pub const LANES: usize = <f64x8 as Lanes>::WIDTH;

/// The same number in every lane.
#[inline(always)]
pub fn splat(value: f64) -> f64x8 {
    f64x8::splat(value)
}

/// References to the first 8 items; the last is repeated if there are fewer. Panics on an empty slice.
#[inline(always)]
pub fn lane_refs<'a, T, U: ?Sized>(items: &'a [T], of: impl Fn(&'a T) -> &'a U) -> [&'a U; LANES] {
    std::array::from_fn(|i| of(&items[i.min(items.len() - 1)]))
}

/// Per lane the power of two at or below a positive number.
///
/// As [`power_of_two_below`](super::elementary::power_of_two_below).
#[inline(always)]
pub fn powers_of_two_below(x: f64x8) -> f64x8 {
    let bits: u64x8 = bytemuck::cast(x);
    bytemuck::cast(bits & u64x8::splat(f64::INFINITY.to_bits()))
}

/// `f` of every number, eight at a time; unused lanes of the last group are 0.
#[inline(always)]
pub fn map_into(values: &mut [f64], given: &[f64], f: impl Fn(f64x8) -> f64x8) {
    for (values, given) in values.chunks_mut(LANES).zip(given.chunks(LANES)) {
        let found = f(f64x8::from_fn(|i| given.get(i).copied().unwrap_or(0.0))).to_array();
        values.copy_from_slice(&found[..values.len()]);
    }
}

/// A 3-vector per lane.
#[derive(Clone, Copy, Debug)]
pub struct DVec3x8 {
    /// First coordinates.
    pub x: f64x8,
    /// Second coordinates.
    pub y: f64x8,
    /// Third coordinates.
    pub z: f64x8,
}

impl DVec3x8 {
    /// From their coordinates.
    #[inline(always)]
    pub fn new(x: f64x8, y: f64x8, z: f64x8) -> Self {
        Self { x, y, z }
    }

    /// The same vector in every lane.
    #[inline(always)]
    pub fn splat(v: DVec3) -> Self {
        Self::new(splat(v.x), splat(v.y), splat(v.z))
    }

    /// A vector for each lane.
    #[inline(always)]
    pub fn from_fn(vector: impl Fn(usize) -> DVec3) -> Self {
        Self::new(f64x8::from_fn(|i| vector(i).x), f64x8::from_fn(|i| vector(i).y), f64x8::from_fn(|i| vector(i).z))
    }

    /// The vector of each lane.
    #[inline(always)]
    pub fn to_array(self) -> [DVec3; LANES] {
        let (x, y, z) = (self.x.to_array(), self.y.to_array(), self.z.to_array());
        std::array::from_fn(|i| DVec3::new(x[i], y[i], z[i]))
    }

    /// Scalar products.
    #[inline(always)]
    pub fn dot(self, other: Self) -> f64x8 {
        self.x * other.x + self.y * other.y + self.z * other.z
    }

    /// Vector products.
    #[inline(always)]
    pub fn cross(self, other: Self) -> Self {
        Self::new(
            self.y * other.z - other.y * self.z,
            self.z * other.x - other.z * self.x,
            self.x * other.y - other.x * self.y,
        )
    }

    /// Squares of the lengths.
    #[inline(always)]
    pub fn length_squared(self) -> f64x8 {
        self.dot(self)
    }

    /// Lengths.
    #[inline(always)]
    pub fn length(self) -> f64x8 {
        self.length_squared().sqrt()
    }

    /// The same directions with length 1.
    #[inline(always)]
    pub fn unit(self) -> Self {
        self * (splat(1.0) / self.length())
    }
}

impl Add for DVec3x8 {
    type Output = Self;
    #[inline(always)]
    fn add(self, other: Self) -> Self {
        Self::new(self.x + other.x, self.y + other.y, self.z + other.z)
    }
}

impl Sub for DVec3x8 {
    type Output = Self;
    #[inline(always)]
    fn sub(self, other: Self) -> Self {
        Self::new(self.x - other.x, self.y - other.y, self.z - other.z)
    }
}

impl Mul<f64x8> for DVec3x8 {
    type Output = Self;
    #[inline(always)]
    fn mul(self, factor: f64x8) -> Self {
        Self::new(self.x * factor, self.y * factor, self.z * factor)
    }
}

/// A 3×3 matrix per lane, stored by columns.
#[derive(Clone, Copy, Debug)]
pub struct DMat3x8 {
    /// Columns.
    pub columns: [DVec3x8; 3],
}

impl Mul<DVec3x8> for DMat3x8 {
    type Output = DVec3x8;
    #[inline(always)]
    fn mul(self, v: DVec3x8) -> DVec3x8 {
        let [x, y, z] = self.columns;
        x * v.x + y * v.y + z * v.z
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::numeric::rng::{Purpose, stream};
    use glam::DMat3;
    use rand::RngExt;

    #[test]
    fn every_lane_has_the_bits_of_glam() {
        let mut random = stream(3, Purpose::Phantom, 0, 0);
        let mut draw = || DVec3::from_array(std::array::from_fn(|_| random.random::<f64>() - 0.5));
        let a: [DVec3; LANES] = std::array::from_fn(|_| draw());
        let b: [DVec3; LANES] = std::array::from_fn(|_| draw());
        let columns: [DVec3; 3] = std::array::from_fn(|_| draw());
        let (va, vb) = (DVec3x8::from_fn(|i| a[i]), DVec3x8::from_fn(|i| b[i]));
        let matrix = DMat3x8 { columns: columns.map(DVec3x8::splat) };
        let numbers = [va.dot(vb), va.length(), va.length_squared()].map(f64x8::to_array);
        let vectors = [va.cross(vb), va.unit(), va + vb, va - vb, va * vb.x, matrix * va, DVec3x8::splat(columns[0])];
        let vectors = vectors.map(DVec3x8::to_array);
        for i in 0..LANES {
            let (a, b) = (a[i], b[i]);
            assert_eq!(numbers.map(|n| n[i]), [a.dot(b), a.length(), a.length_squared()]);
            let [x, y, z] = columns;
            let product = DMat3::from_cols(x, y, z) * a;
            assert_eq!(vectors.map(|v| v[i]), [a.cross(b), a.normalize(), a + b, a - b, a * b.x, product, x]);
        }
    }
}
