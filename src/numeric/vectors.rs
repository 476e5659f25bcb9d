//! Eight numbers or vectors at a time, one in each lane: for what is done once per primitive. Each lane has the bits that
//! glam's `DVec3` would have, for every operation is rounded alike and comes in the same order.

use super::Lanes;
use glam::DVec3;
use std::ops::{Add, Mul, Sub};
use wide::{f64x8, u64x8};

/// A number in each of [`EIGHT`] lanes.
pub type Eight = f64x8;

/// Lanes of an [`Eight`].
pub const EIGHT: usize = <f64x8 as Lanes>::WIDTH;

/// The same number in every lane.
#[inline(always)]
pub fn all(value: f64) -> Eight {
    Eight::splat(value)
}

/// A number for each lane.
#[inline(always)]
pub fn each(value: impl FnMut(usize) -> f64) -> Eight {
    Eight::from_fn(value)
}

/// What each lane is about: the first [`EIGHT`] of `some`, of which there is one, in the lanes that are left over the last.
#[inline(always)]
pub fn lanes<'a, T, U: ?Sized>(some: &'a [T], of: impl Fn(&'a T) -> &'a U) -> [&'a U; EIGHT] {
    std::array::from_fn(|i| of(&some[i.min(some.len() - 1)]))
}

/// In each lane the power of two at or below a positive number: [`power_of_two_below`](super::elementary::power_of_two_below).
#[inline(always)]
pub fn powers_of_two_below(x: Eight) -> Eight {
    let bits: u64x8 = bytemuck::cast(x);
    bytemuck::cast(bits & u64x8::splat(f64::INFINITY.to_bits()))
}

/// `f` of every number, eight at a time; in the lanes that are left over, of 0.
#[inline(always)]
pub fn map_into(values: &mut [f64], given: &[f64], f: impl Fn(Eight) -> Eight) {
    for (values, given) in values.chunks_mut(EIGHT).zip(given.chunks(EIGHT)) {
        let found = f(each(|i| given.get(i).copied().unwrap_or(0.0))).to_array();
        values.copy_from_slice(&found[..values.len()]);
    }
}

/// A vector in each lane.
#[derive(Clone, Copy, Debug)]
pub struct Vectors {
    /// First coordinates.
    pub x: Eight,
    /// Second coordinates.
    pub y: Eight,
    /// Third coordinates.
    pub z: Eight,
}

impl Vectors {
    /// From their coordinates.
    #[inline(always)]
    pub fn new(x: Eight, y: Eight, z: Eight) -> Self {
        Self { x, y, z }
    }

    /// The same vector in every lane.
    #[inline(always)]
    pub fn all(v: DVec3) -> Self {
        Self::new(all(v.x), all(v.y), all(v.z))
    }

    /// A vector for each lane.
    #[inline(always)]
    pub fn each(vector: impl Fn(usize) -> DVec3) -> Self {
        Self::new(each(|i| vector(i).x), each(|i| vector(i).y), each(|i| vector(i).z))
    }

    /// The vector of each lane.
    #[inline(always)]
    pub fn to_array(self) -> [DVec3; EIGHT] {
        let (x, y, z) = (self.x.to_array(), self.y.to_array(), self.z.to_array());
        std::array::from_fn(|i| DVec3::new(x[i], y[i], z[i]))
    }

    /// Scalar products.
    #[inline(always)]
    pub fn dot(self, other: Self) -> Eight {
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
    pub fn length_squared(self) -> Eight {
        self.dot(self)
    }

    /// Lengths.
    #[inline(always)]
    pub fn length(self) -> Eight {
        self.length_squared().sqrt()
    }

    /// The same directions with length 1.
    #[inline(always)]
    pub fn unit(self) -> Self {
        self * (all(1.0) / self.length())
    }
}

impl Add for Vectors {
    type Output = Self;
    #[inline(always)]
    fn add(self, other: Self) -> Self {
        Self::new(self.x + other.x, self.y + other.y, self.z + other.z)
    }
}

impl Sub for Vectors {
    type Output = Self;
    #[inline(always)]
    fn sub(self, other: Self) -> Self {
        Self::new(self.x - other.x, self.y - other.y, self.z - other.z)
    }
}

impl Mul<Eight> for Vectors {
    type Output = Self;
    #[inline(always)]
    fn mul(self, factor: Eight) -> Self {
        Self::new(self.x * factor, self.y * factor, self.z * factor)
    }
}

/// A matrix in each lane, by its columns.
#[derive(Clone, Copy, Debug)]
pub struct Matrices {
    /// Columns.
    pub columns: [Vectors; 3],
}

impl Mul<Vectors> for Matrices {
    type Output = Vectors;
    #[inline(always)]
    fn mul(self, v: Vectors) -> Vectors {
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
        let a: [DVec3; EIGHT] = std::array::from_fn(|_| draw());
        let b: [DVec3; EIGHT] = std::array::from_fn(|_| draw());
        let columns: [DVec3; 3] = std::array::from_fn(|_| draw());
        let (va, vb) = (Vectors::each(|i| a[i]), Vectors::each(|i| b[i]));
        let matrix = Matrices { columns: columns.map(Vectors::all) };
        let numbers = [va.dot(vb), va.length(), va.length_squared()].map(Eight::to_array);
        let vectors = [va.cross(vb), va.unit(), va + vb, va - vb, va * vb.x, matrix * va, Vectors::all(columns[0])];
        let vectors = vectors.map(Vectors::to_array);
        for i in 0..EIGHT {
            let (a, b) = (a[i], b[i]);
            assert_eq!(numbers.map(|n| n[i]), [a.dot(b), a.length(), a.length_squared()]);
            let [x, y, z] = columns;
            let product = DMat3::from_cols(x, y, z) * a;
            assert_eq!(vectors.map(|v| v[i]), [a.cross(b), a.normalize(), a + b, a - b, a * b.x, product, x]);
        }
    }
}
