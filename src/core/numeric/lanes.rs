//! SIMD lanes: one kernel text for f32 and f64, for every instruction set.
//!
//! The virtual width is a constant of the algorithm, 16 lanes of f32 and 8 of f64; a build without wide
//! registers emulates it lane by lane, so sums have the same tree everywhere. `a * b + c` is rounded twice on every
//! build and [`Lanes::fma`] once on every build, also where the processor has no such instruction.

use super::fused::Fused;
use super::polynomials::{
    exp2_f32, exp2_f64, log2_1p_f32, log2_1p_f64, log2_1p_near_f32, log2_1p_near_f64, nearer_to_root, root_quarter_f32,
    root_quarter_f64, root_sixteenth_f32,
};
use super::rearrange::{Rearrange, columns_of_f32, one_of_eight, one_of_sixteen};
use super::reduce::{fold_16_to_8, sum_of_8};
use super::{Real, real};
use std::fmt::Debug;
use std::ops::{Add, AddAssign, Div, Mul, Neg, Sub};
use wide::{f32x16, f64x8, u32x8, u32x16, u64x8};

/// Lanes of the widest register.
pub const WIDEST: usize = 16;

/// Largest |e| that [`Lanes::rsqrt_1p_sixteenth`] and [`Lanes::rsqrt_1p_quarter`] accept.
pub const ROOT_RANGES: [f64; 2] = [1.0 / 16.0, 1.0 / 4.0];

/// `WIDTH` scalars that are computed together.
pub trait Lanes:
    Copy
    + Debug
    + Default
    + Send
    + Sync
    + Add<Output = Self>
    + AddAssign
    + Sub<Output = Self>
    + Mul<Output = Self>
    + Div<Output = Self>
    + Neg<Output = Self>
    + Rearrange<<Self as Lanes>::Scalar>
{
    /// One lane.
    type Scalar: Real<Lanes = Self>;
    /// A whole number in every lane.
    type Index: Copy;
    /// `WIDTH` contiguous values.
    type Block: Copy;
    /// Number of lanes, even.
    const WIDTH: usize;
    /// Largest x that [`Self::log2_1p_near`] accepts.
    const LOG_NEAR: f64;

    /// The same value in every lane.
    fn splat(value: Self::Scalar) -> Self;
    /// The same value, rounded to nearest, in every lane.
    #[inline(always)]
    fn splat_f64(value: f64) -> Self {
        Self::splat(real(value))
    }
    /// Lanes from the first `WIDTH` of contiguous values.
    fn from_slice(values: &[Self::Scalar]) -> Self;
    /// Writes the lanes to the first `WIDTH` of contiguous values.
    fn write(self, values: &mut [Self::Scalar]);
    /// Contiguous values in blocks of `WIDTH`; an incomplete last block is dropped.
    fn blocks(values: &[Self::Scalar]) -> &[Self::Block];
    /// Lanes from a block.
    fn from_block(block: &Self::Block) -> Self;
    /// Mutable [`Self::blocks`].
    fn blocks_mut(values: &mut [Self::Scalar]) -> &mut [Self::Block];
    /// The values of the lanes.
    fn to_block(self) -> Self::Block;
    /// Lanes from the first values, zeros where there are fewer than `WIDTH`.
    #[inline(always)]
    fn from_first(values: &[Self::Scalar]) -> Self {
        if values.len() < Self::WIDTH {
            return Self::from_fn(|i| values.get(i).copied().unwrap_or_default());
        }
        Self::from_slice(values)
    }
    /// Writes as many lanes as there are values.
    #[inline(always)]
    fn write_first(self, values: &mut [Self::Scalar]) {
        if values.len() < Self::WIDTH {
            let mut lanes = [Self::Scalar::ZERO; WIDEST];
            self.write(&mut lanes);
            values.copy_from_slice(&lanes[..values.len()]);
        } else {
            self.write(values);
        }
    }
    /// Lanes from two rows of `WIDTH/2` contiguous values.
    fn from_rows(top: &[Self::Scalar], bottom: &[Self::Scalar]) -> Self;
    /// Adds the lanes onto two rows of `WIDTH/2` contiguous values.
    fn add_to_rows(self, top: &mut [Self::Scalar], bottom: &mut [Self::Scalar]);
    /// Lanes from a function of the lane's number.
    fn from_fn(value: impl FnMut(usize) -> Self::Scalar) -> Self;
    /// Integer and fractional part of each lane, for lanes from 0 to 2^22.
    fn split(self) -> (Self::Index, Self);
    /// The whole number at or above each lane.
    fn ceil(self) -> Self;
    /// Writes integer lanes from 0 to 2^22 to the first `WIDTH` elements.
    fn write_indices(index: Self::Index, indices: &mut [u32]);
    /// Lane i is `table[index[i]]`: each half of the register has its own table of `WIDTH/2` values.
    ///
    /// A lane whose index is out of range holds any of these values, or zero.
    fn lookup(tables: [&[Self::Scalar]; 2], index: Self::Index) -> Self;
    /// [`Self::lookup`] in tables of `WIDTH` values.
    fn lookup_wide(tables: [&[Self::Scalar]; 2], index: Self::Index) -> Self;
    /// `self · factor + summand`, rounded once: one instruction where the build has it, more elsewhere.
    fn fma(self, factor: Self, summand: Self) -> Self;
    /// Square root, correctly rounded.
    fn sqrt(self) -> Self;
    /// `1/√self` for positive normal numbers, to two units in the last place.
    fn rsqrt(self) -> Self;
    /// `1/√(1+self)` for lanes from -1/4 to 1/4, to two units in the last place.
    fn rsqrt_1p_quarter(self) -> Self;
    /// The same for lanes from -1/16 to 1/16: fewer steps, different last bits.
    fn rsqrt_1p_sixteenth(self) -> Self;
    /// Absolute value.
    fn abs(self) -> Self;
    /// `self` where `self < other`, else `other`: so of two zeros, and where one is NaN.
    fn at_most(self, other: Self) -> Self;
    /// `self` where `self > other`, else `other`: so of two zeros, and where one is NaN.
    fn at_least(self, other: Self) -> Self;
    /// A bit for each lane, from the lowest one on: whether `self < limit`.
    fn below(self, limit: Self) -> u32;
    /// `yes` in the lanes with `self ≤ limit`, else `no` (also for NaN).
    fn select_le(self, limit: Self, yes: Self, no: Self) -> Self;
    /// `log2(1+x)` for `0 ≤ x < 2^100`, accurate relative to itself down to x = 0.
    ///
    /// Several registers are computed together so that their dependency chains overlap.
    fn log2_1p_each<const N: usize>(x: [Self; N]) -> [Self; N];
    /// [`Self::log2_1p_each`] for x from 0 to [`Self::LOG_NEAR`]: as accurate, in fewer steps; last bits may differ.
    fn log2_1p_near_each<const N: usize>(x: [Self; N]) -> [Self; N];
    /// `2^t` for `-HORIZON ≤ t ≤ 0`, of several registers.
    fn exp2_each<const N: usize>(t: [Self; N]) -> [Self; N];
    /// [`Self::log2_1p_each`] of one.
    fn log2_1p(self) -> Self {
        Self::log2_1p_each([self])[0]
    }
    /// [`Self::log2_1p_near_each`] of one.
    fn log2_1p_near(self) -> Self {
        Self::log2_1p_near_each([self])[0]
    }
    /// [`Self::exp2_each`] of one.
    fn exp2(self) -> Self {
        Self::exp2_each([self])[0]
    }
    /// Sums of lanes that are eight apart, in f64.
    fn fold_to_8(self) -> [f64; 8];
    /// Sum over the lanes in f64: halves added pairwise, ((0+8)+(4+12))+….
    #[inline(always)]
    fn sum(self) -> f64 {
        sum_of_8(f64x8::new(self.fold_to_8()))
    }
}

/// Implements [`Real`] and [`Lanes`] for one precision.
///
/// `rsqrt` has the constant of the first approximation (`constant - bits/2`) and the number of Newton steps.
macro_rules! precision {
    (
        $scalar:ident, $lanes:ident, $bits:ident, $unsigned:ident, width $width:literal, mantissa $mantissa:literal,
        rsqrt $magic:literal in $steps:literal, horizon $horizon:literal, far $far:literal, exp2 $exp2:ident,
        lookup |$tables:ident, $index:ident| $from_table:expr, wide $from_wide_table:expr,
        log2_1p $log2_1p:ident, $log2_1p_near:ident up to $near:expr, root_of_1_plus $root_quarter:ident, sixteenth $root_sixteenth:ident, fold $fold:expr
        $(, columns $columns:ident)?
    ) => {
        impl Real for $scalar {
            type Lanes = $lanes;
            const ZERO: Self = 0.0;
            const ONE: Self = 1.0;
            const HORIZON: f64 = $horizon;
            const FAR: f64 = $far;

            #[inline(always)]
            fn from_f64(value: f64) -> Self {
                value as Self
            }
            #[inline(always)]
            fn to_f64(self) -> f64 {
                self.into()
            }
            #[inline(always)]
            fn from_index(index: usize) -> Self {
                index as Self
            }
            #[inline(always)]
            fn sqrt(self) -> Self {
                self.sqrt()
            }
            #[inline(always)]
            fn abs(self) -> Self {
                self.abs()
            }
            #[inline(always)]
            fn is_finite(self) -> bool {
                self.is_finite()
            }
            $(
                #[inline(always)]
                fn columns(rows: [&[Self]; 8]) -> [f64x8; 8] {
                    $columns(rows)
                }
            )?
        }

        impl Lanes for $lanes {
            type Scalar = $scalar;
            type Index = $bits;
            type Block = [$scalar; $width];
            const WIDTH: usize = $width;
            const LOG_NEAR: f64 = $near;

            #[inline(always)]
            fn splat(value: $scalar) -> Self {
                $lanes::splat(value)
            }
            #[inline(always)]
            fn from_slice(values: &[$scalar]) -> Self {
                $lanes::new(values[..$width].try_into().expect("a slice of this length"))
            }
            #[inline(always)]
            fn write(self, values: &mut [$scalar]) {
                values[..$width].copy_from_slice(&self.to_array());
            }
            #[inline(always)]
            fn blocks(values: &[$scalar]) -> &[Self::Block] {
                values.as_chunks().0
            }
            #[inline(always)]
            fn from_block(block: &Self::Block) -> Self {
                $lanes::new(*block)
            }
            #[inline(always)]
            fn blocks_mut(values: &mut [$scalar]) -> &mut [Self::Block] {
                values.as_chunks_mut().0
            }
            #[inline(always)]
            fn to_block(self) -> Self::Block {
                self.to_array()
            }
            #[inline(always)]
            fn from_rows(top: &[$scalar], bottom: &[$scalar]) -> Self {
                let mut lanes = [0.0; $width];
                lanes[..$width / 2].copy_from_slice(&top[..$width / 2]);
                lanes[$width / 2..].copy_from_slice(&bottom[..$width / 2]);
                $lanes::new(lanes)
            }
            #[inline(always)]
            fn add_to_rows(self, top: &mut [$scalar], bottom: &mut [$scalar]) {
                let sum = (Self::from_rows(top, bottom) + self).to_array();
                top[..$width / 2].copy_from_slice(&sum[..$width / 2]);
                bottom[..$width / 2].copy_from_slice(&sum[$width / 2..]);
            }
            #[inline(always)]
            fn from_fn(value: impl FnMut(usize) -> $scalar) -> Self {
                $lanes::new(std::array::from_fn(value))
            }
            // A whole number is in the bits of what it is added to.
            #[inline(always)]
            fn split(self) -> (Self::Index, Self) {
                const INTEGER: $scalar = ((1 as $unsigned) << $mantissa) as $scalar;
                let whole = self.floor();
                let bits: $bits = bytemuck::cast(whole + Self::splat(INTEGER));
                (bits - $bits::splat(INTEGER.to_bits()), self - whole)
            }
            #[inline(always)]
            fn ceil(self) -> Self {
                self.ceil()
            }
            #[inline(always)]
            fn write_indices(index: Self::Index, indices: &mut [u32]) {
                indices.iter_mut().zip(index.to_array()).for_each(|(to, whole)| *to = whole as u32);
            }
            #[inline(always)]
            fn lookup($tables: [&[$scalar]; 2], $index: Self::Index) -> Self {
                $from_table
            }
            #[inline(always)]
            fn lookup_wide($tables: [&[$scalar]; 2], $index: Self::Index) -> Self {
                $from_wide_table
            }
            #[inline(always)]
            fn sqrt(self) -> Self {
                $lanes::sqrt(self)
            }
            #[inline(always)]
            fn fma(self, factor: Self, summand: Self) -> Self {
                // Elsewhere `wide` rounds twice.
                if cfg!(any(target_arch = "aarch64", all(target_feature = "avx", target_feature = "fma"))) {
                    self.mul_add(factor, summand)
                } else {
                    let (a, b, c) = (self.to_array(), factor.to_array(), summand.to_array());
                    Self::from_fn(|i| a[i].fused(b[i], c[i]))
                }
            }
            // Half of the exponent with a linear mantissa is within 3.5 %.
            #[inline(always)]
            fn rsqrt(self) -> Self {
                let bits: $bits = bytemuck::cast(self);
                let root: Self = bytemuck::cast($bits::splat($magic) - bits.unbounded_shr_scalar(1));
                (0..$steps).fold(root, |root, _| nearer_to_root(root, self))
            }
            #[inline(always)]
            fn rsqrt_1p_quarter(self) -> Self {
                $root_quarter(self)
            }
            #[inline(always)]
            fn rsqrt_1p_sixteenth(self) -> Self {
                $root_sixteenth(self)
            }
            #[inline(always)]
            fn abs(self) -> Self {
                $lanes::abs(self)
            }
            #[inline(always)]
            fn at_most(self, other: Self) -> Self {
                // Instructions of other processors take another one of two zeros, and NaN.
                if cfg!(target_feature = "sse2") {
                    self.fast_min(other)
                } else {
                    self.simd_lt(other).select(self, other)
                }
            }
            #[inline(always)]
            fn at_least(self, other: Self) -> Self {
                if cfg!(target_feature = "sse2") {
                    self.fast_max(other)
                } else {
                    self.simd_gt(other).select(self, other)
                }
            }
            #[inline(always)]
            fn below(self, limit: Self) -> u32 {
                self.simd_lt(limit).to_bitmask()
            }
            #[inline(always)]
            fn select_le(self, limit: Self, yes: Self, no: Self) -> Self {
                self.simd_le(limit).select(yes, no)
            }

            #[inline(always)]
            fn log2_1p_each<const N: usize>(x: [Self; N]) -> [Self; N] {
                $log2_1p(x)
            }
            #[inline(always)]
            fn log2_1p_near_each<const N: usize>(x: [Self; N]) -> [Self; N] {
                $log2_1p_near(x)
            }
            #[inline(always)]
            fn exp2_each<const N: usize>(t: [Self; N]) -> [Self; N] {
                $exp2(t)
            }
            #[inline(always)]
            fn fold_to_8(self) -> [f64; 8] {
                $fold(self).to_array()
            }
        }
    };
}

precision!(
    f32, f32x16, u32x16, u32, width 16, mantissa 23, rsqrt 0x5f37_5a86 in 2, horizon 126.0, far 1e15, exp2 exp2_f32,
    lookup |tables, index| {
        let [first, second]: [u32x8; 2] = bytemuck::cast(index);
        bytemuck::cast([one_of_eight(tables[0], first), one_of_eight(tables[1], second)])
    },
    wide {
        let [first, second]: [u32x8; 2] = bytemuck::cast(index);
        bytemuck::cast([one_of_sixteen(tables[0], first), one_of_sixteen(tables[1], second)])
    },
    log2_1p log2_1p_f32, log2_1p_near_f32 up to 1.9374, root_of_1_plus root_quarter_f32, sixteenth root_sixteenth_f32, fold fold_16_to_8,
    columns columns_of_f32
);
precision!(
    f64, f64x8, u64x8, u64, width 8, mantissa 52, rsqrt 0x5fe6_eb50_c7b5_37a9 in 3, horizon 1022.0, far 1e120, exp2 exp2_f64,
    lookup |tables, index| {
        let tables = [&tables[0][..4], &tables[1][..4]];
        let index = index.to_array();
        Self::from_fn(|lane| tables[lane / 4][index[lane] as usize % 4])
    },
    wide {
        let tables = [&tables[0][..8], &tables[1][..8]];
        let index = index.to_array();
        Self::from_fn(|lane| tables[lane / 4][index[lane] as usize % 8])
    },
    log2_1p log2_1p_f64, log2_1p_near_f64 up to 0.4142, root_of_1_plus root_quarter_f64, sixteenth root_quarter_f64, fold |lanes| lanes
);

#[cfg(test)]
mod tests {
    use super::*;

    /// Largest error of (1+x)^-q, relative to its peak 1, over the whole range of x.
    fn worst_error_of_the_t_kernel<R: Real>(nu: f64) -> f64 {
        let q = (nu + 2.0) / 2.0;
        let minus_q = R::from_f64(-q);
        let mut worst = 0.0_f64;
        for i in 0..40_000 {
            // δ from 1e-8 to 1e6, evenly in its logarithm.
            let x = R::from_f64(libm::pow(10.0, -8.0 + 14.0 * f64::from(i) / 40_000.0) / nu);
            let truth = libm::exp(-q * libm::log1p(x.to_f64()));
            if truth < 1e-36 {
                continue;
            }
            let (lanes, near) = (R::Lanes::splat(x), x.to_f64() <= R::Lanes::LOG_NEAR);
            for log in [Some(lanes.log2_1p()), near.then(|| lanes.log2_1p_near())].into_iter().flatten() {
                let value = (log * R::Lanes::splat(minus_q)).exp2();
                worst = worst.max((value.sum() / R::Lanes::WIDTH as f64 - truth).abs());
            }
        }
        worst
    }

    #[test]
    fn t_kernel_in_f32_is_within_1_5e_7_of_its_peak_for_every_nu() {
        for nu in [1.0, 2.0, 3.0, 5.0, 10.0, 30.0, 100.0, 300.0, 1e3, 3e3, 1e4] {
            let worst = worst_error_of_the_t_kernel::<f32>(nu);
            within!(worst, "ν = {nu}: {worst:e}");
        }
    }

    #[test]
    fn t_kernel_in_f64_is_within_5e_16_of_its_peak_for_every_nu() {
        for nu in [1.0, 2.0, 3.0, 5.0, 10.0, 30.0, 100.0, 300.0, 1e3, 3e3, 1e4] {
            let worst = worst_error_of_the_t_kernel::<f64>(nu);
            within!(worst, "ν = {nu}: {worst:e}");
        }
    }

    fn worst_relative_error_of_a_logarithm<R: Real>(x: impl Iterator<Item = f64>) -> f64 {
        x.flat_map(|x| {
            let (lanes, x) = (R::Lanes::splat(R::from_f64(x)), R::from_f64(x).to_f64());
            let logarithms = [Some(lanes.log2_1p()), (x <= R::Lanes::LOG_NEAR).then(|| lanes.log2_1p_near())];
            let truth = libm::log1p(x) / std::f64::consts::LN_2;
            logarithms.map(|log| log.map_or(0.0, |log| (log.sum() / R::Lanes::WIDTH as f64 / truth - 1.0).abs()))
        })
        .fold(0.0, f64::max)
    }

    #[test]
    fn logarithms_keep_the_relative_accuracy_of_tiny_arguments() {
        // And beside the borders of octaves, of their sixteenths, and of what is near.
        let borders = (0..96).flat_map(|i| {
            let border = libm::exp2(f64::from(i / 32)) * (1.0 + f64::from(i % 32) / 32.0) - 1.0;
            [-2.0, -1.0, 0.0, 1.0, 2.0].map(|step| border + step * f64::from(f32::EPSILON) / 2.0)
        });
        let near = [f32x16::LOG_NEAR, f64x8::LOG_NEAR, std::f64::consts::SQRT_2 - 1.0].into_iter();
        let all = (0..100_000).map(|i| libm::pow(10.0, -30.0 + 50.0 * f64::from(i) / 100_000.0));
        let some = || all.clone().chain(borders.clone()).chain(near.clone()).filter(|&x| x > 0.0);
        let (double, single) =
            (worst_relative_error_of_a_logarithm::<f64>(some()), worst_relative_error_of_a_logarithm::<f32>(some()));
        within!("f64", double);
        within!("f32", single);
    }

    #[test]
    fn comparisons_of_lanes_are_those_of_numbers() {
        let lanes = f64x8::from_fn(|i| i as f64);
        assert_eq!([f64::NAN, 0.0, 0.5, 3.0].map(|limit| lanes.below(f64x8::splat(limit))), [0, 0, 1, 0b111]);
        assert_eq!(f32x16::from_fn(|i| 15.0 - i as f32).below(f32x16::splat(6.0)), 0b1111_1100_0000_0000);
        assert_eq!(lanes.at_least(f64x8::splat(3.0)).to_array(), [3.0, 3.0, 3.0, 3.0, 4.0, 5.0, 6.0, 7.0]);
    }

    /// Every lane of both bounds has the bits of the comparison that defines it.
    fn bounds_by_bits<R: Real>(bits: impl Fn(R) -> u64) {
        let (zero, nan) = (R::ZERO, R::from_f64(f64::NAN));
        let values = [zero, -zero, R::ONE, -R::ONE, R::from_f64(f64::INFINITY), R::from_f64(-f64::INFINITY), nan];
        for a in values {
            for b in values {
                for lane in 0..R::Lanes::WIDTH {
                    let [x, y] = [a, b].map(|value| R::Lanes::from_fn(|i| if i == lane { value } else { R::ONE }));
                    let mut found = [[R::ZERO; WIDEST]; 2];
                    x.at_most(y).write(&mut found[0]);
                    x.at_least(y).write(&mut found[1]);
                    let expected = [if a < b { a } else { b }, if a > b { a } else { b }];
                    assert_eq!(found.map(|lanes| bits(lanes[lane])), expected.map(&bits), "of {a} and {b}");
                }
            }
        }
    }

    #[test]
    fn of_two_zeros_and_of_nan_a_bound_is_the_other_on_every_processor() {
        bounds_by_bits::<f32>(|value| value.to_bits().into());
        bounds_by_bits::<f64>(f64::to_bits);
    }

    #[test]
    fn fma_rounds_once_on_every_build() {
        // (1+ε)² = 1 + 2ε + ε²: rounded before the sum, ε² is gone.
        let single = f32x16::splat(1.0 + f32::EPSILON).fma(f32x16::splat(1.0 + f32::EPSILON), f32x16::splat(-1.0));
        assert_eq!(single.to_array()[5], 2.0 * f32::EPSILON + f32::EPSILON * f32::EPSILON);
        let double = f64x8::splat(1.0 + f64::EPSILON).fma(f64x8::splat(1.0 + f64::EPSILON), f64x8::splat(-1.0));
        assert_eq!(double.to_array()[5], 2.0 * f64::EPSILON + f64::EPSILON * f64::EPSILON);
    }

    #[test]
    fn rsqrt_is_within_two_units_in_the_last_place_of_every_normal_number() {
        for i in 0..100_000 {
            // Two octaves hold every mantissa and both parities of the exponent; the ends of the range as well.
            let x = 0.5 + 2.0 * f64::from(i) / 100_000.0;
            for x in [x, x * 1e-37, x * 1e37] {
                let truth = 1.0 / libm::sqrt(f64::from(x as f32));
                let single = f64::from(f32x16::splat(x as f32).rsqrt().to_array()[9]);
                within!("f32", (single / truth - 1.0).abs(), "{x}: {single} against {truth}");
            }
            for x in [x, x * 1e-307, x * 1e307] {
                let truth = 1.0 / libm::sqrt(x);
                let double = f64x8::splat(x).rsqrt().to_array()[3];
                within!("f64", (double / truth - 1.0).abs(), "{x}: {double} against {truth}");
            }
        }
    }

    #[test]
    fn roots_near_one_are_within_two_units_in_the_last_place() {
        let check = |e: f64, single: f32x16, double: f64x8| {
            let truth = 1.0 / libm::sqrt(1.0 + f64::from(e as f32));
            let (single, double) = (f64::from(single.to_array()[11]), double.to_array()[6]);
            within!("f32", (single / truth - 1.0).abs(), "{e}: {single} against {truth}");
            let truth = 1.0 / libm::sqrt(1.0 + e);
            within!("f64", (double / truth - 1.0).abs(), "{e}: {double} against {truth}");
        };
        for i in -10_000..=10_000 {
            let [nearest, near] = ROOT_RANGES.map(|most| most * f64::from(i) / 10_000.0);
            check(near, f32x16::splat(near as f32).rsqrt_1p_quarter(), f64x8::splat(near).rsqrt_1p_quarter());
            check(
                nearest,
                f32x16::splat(nearest as f32).rsqrt_1p_sixteenth(),
                f64x8::splat(nearest).rsqrt_1p_sixteenth(),
            );
        }
    }

    /// Numbers at and just below whole ones are split by floor, and lanes look up the table of their half by the whole part.
    fn split_and_lookup<R: Real>(below_one: f64) {
        let width = R::Lanes::WIDTH;
        let table: Vec<R> = (0..2 * width).map(|i| R::from_index(100 + i)).collect();
        for first in 0..width {
            for rest in [0.0, 1e-3, 0.5, below_one] {
                for lane in 0..width {
                    let mut given = vec![R::ZERO; width];
                    given[lane] = R::from_f64(first as f64 + rest);
                    let floor = given[lane].to_f64().floor();
                    let (index, fraction) = R::Lanes::from_slice(&given).split();
                    let mut indices = [0; 16];
                    R::Lanes::write_indices(index, &mut indices);
                    assert_eq!(f64::from(indices[lane]), floor);
                    let mut above = vec![R::ZERO; width];
                    R::Lanes::from_slice(&given).ceil().write(&mut above);
                    assert_eq!(above[lane].to_f64(), given[lane].to_f64().ceil());
                    let mut lanes = [vec![R::ZERO; width], vec![R::ZERO; width], vec![R::ZERO; width]];
                    let tables = [&table[..], &table[width..]];
                    fraction.write(&mut lanes[0]);
                    R::Lanes::lookup(tables, index).write(&mut lanes[1]);
                    R::Lanes::lookup_wide(tables, index).write(&mut lanes[2]);
                    let [fraction, narrow, wide] = lanes.map(|lanes| lanes[lane].to_f64());
                    let expected = 100.0 + floor + if lane < width / 2 { 0.0 } else { width as f64 };
                    assert_eq!(fraction, given[lane].to_f64() - floor);
                    assert!(floor >= width as f64 || wide == expected, "{wide} instead of {expected}");
                    assert!(floor >= (width / 2) as f64 || narrow == expected, "{narrow} instead of {expected}");
                }
            }
        }
    }

    #[test]
    fn lanes_are_split_into_whole_numbers_and_look_up_the_tables_of_their_halves() {
        split_and_lookup::<f32>(0.999_998);
        split_and_lookup::<f64>(1.0 - 1e-14);
    }

    #[test]
    fn lanes_agree_with_each_other_and_the_sum_has_a_fixed_tree() {
        let lanes = f32x16::from_fn(|i| 0.1 + i as f32);
        assert_eq!(Lanes::sum(lanes), (0..16).map(|i| f64::from(0.1 + i as f32)).sum::<f64>());
        let rows: Vec<f32> = (0..20).map(|i| i as f32).collect();
        let mut target = rows.clone();
        let (top, bottom) = target.split_at_mut(10);
        f32x16::from_rows(&rows[..8], &rows[10..18]).add_to_rows(&mut top[..8], &mut bottom[..8]);
        assert_eq!(
            target,
            [0., 2., 4., 6., 8., 10., 12., 14., 8., 9., 20., 22., 24., 26., 28., 30., 32., 34., 18., 19.]
        );
    }
}
