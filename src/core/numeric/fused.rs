//! Fused multiply-add for processors without the instruction: in f32 by additions and multiplications in f64, in f64 by the
//! function of the system.
//!
//! A product of two f32 is exact in f64, where its sum with the third is rounded to odd and then to f32 (Boldo and Melquiond,
//! "Emulation of FMA and correctly rounded sums: proved algorithms using rounding to odd", IEEE Transactions on Computers
//! 57, 2008). Two roundings are one there, because f64 has more than two bits beyond twice those of f32. The compiler turns
//! the operations into those of registers, which is faster than one call for each lane.

/// A number that is multiplied and added with one rounding.
pub(super) trait Fused {
    /// `self · factor + summand`, rounded once.
    fn fused(self, factor: Self, summand: Self) -> Self;
}

impl Fused for f32 {
    #[inline(always)]
    fn fused(self, factor: Self, summand: Self) -> Self {
        if cfg!(target_arch = "aarch64") {
            return instruction(self, factor, summand);
        }
        emulated(self, factor, summand)
    }
}

impl Fused for f64 {
    #[inline(always)]
    #[expect(clippy::disallowed_methods, reason = "rounded once by IEEE 754 wherever it is compiled")]
    fn fused(self, factor: Self, summand: Self) -> Self {
        self.mul_add(factor, summand)
    }
}

/// `a · b + c` by an instruction of every processor of this kind.
#[inline(always)]
#[expect(clippy::disallowed_methods, reason = "rounded once by IEEE 754 wherever it is compiled")]
fn instruction(a: f32, b: f32, c: f32) -> f32 {
    a.mul_add(b, c)
}

/// `a · b + c` by operations in f64.
#[inline(always)]
fn emulated(a: f32, b: f32, c: f32) -> f32 {
    let (product, summand) = (f64::from(a) * f64::from(b), f64::from(c));
    // Knuth's sum: `sum + error` is the exact one.
    let sum = product + summand;
    let added = sum - product;
    let error = (product - (sum - added)) + (summand - added);
    // Towards zero, with the last bit set where something was cut off: rounded to odd. An error that is NaN belongs to a
    // sum that is not finite, which stays.
    let inexact = u64::from(error < 0.0) | u64::from(error > 0.0);
    let beyond = ((error.to_bits() ^ sum.to_bits()) >> 63) & inexact;
    f64::from_bits((sum.to_bits() - beyond) | inexact) as f32
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{Rng, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    #[expect(clippy::disallowed_methods, reason = "the truth")]
    fn check(a: f32, b: f32, c: f32) {
        let (found, truth) = (emulated(a, b, c), a.mul_add(b, c));
        assert!(
            found.to_bits() == truth.to_bits() || found.is_nan() && truth.is_nan(),
            "{a:e} {b:e} {c:e}: {found:e}, {truth:e}"
        );
    }

    #[test]
    fn any_bits_are_rounded_once() {
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let mut next = || rng.next_u32();
        for _ in 0..300_000 {
            // Any numbers; and numbers whose product and sum are near each other, where one cancels the other.
            let [a, b, c] = [next(), next(), next()].map(f32::from_bits);
            check(a, b, c);
            check(a, b, -(a * b));
            check(a, b, f32::from_bits((a * b).to_bits() ^ (next() & 0x8000_ffff)));
            // Halves of the last place: small integers far apart.
            let [a, b] = [next(), next()].map(|bits| (bits >> 20) as f32);
            let scale = f32::from_bits((next() % 254 + 1) << 23);
            check(a * scale, b, c);
            check(a, b, (next() >> 8) as f32 * scale);
        }
    }

    #[test]
    fn the_ends_of_the_range_are_rounded_once() {
        let tiny = f32::from_bits(1);
        let values = [
            0.0,
            tiny,
            3.0 * tiny,
            f32::MIN_POSITIVE,
            f32::EPSILON,
            0.5,
            1.0,
            1.0 + f32::EPSILON,
            1.5,
            2.0,
            f32::MAX / 2.0,
            f32::MAX,
            f32::INFINITY,
            f32::NAN,
        ];
        let signed = || values.iter().flat_map(|&value| [value, -value]);
        for a in signed() {
            for b in signed() {
                signed().for_each(|c| check(a, b, c));
            }
        }
    }
}
