//! Permutations of lanes.

use wide::{f32x8, f32x16, f64x8, i32x8, u32x8, u32x16, u64x8};

/// Registers that are interleaved together.
pub const INTERLEAVED: usize = 8;

/// Moves of values between lanes, without arithmetic.
pub trait Rearrange<R>: Sized {
    /// Loads a register into entry `row` of each column: lane l of column i is `values[l·stride + i]`.
    fn deinterleave<const N: usize>(values: &[R], stride: usize, columns: &mut [[Self; N]; INTERLEAVED], row: usize);
    /// The inverse.
    fn interleave<const N: usize>(columns: &[[Self; N]; INTERLEAVED], row: usize, values: &mut [R], stride: usize);
    /// Moves every lane up by one; the first becomes 0.
    fn shift_up(self) -> Self;
    /// Moves every lane down by one; the last becomes 0.
    fn shift_down(self) -> Self;
}

#[inline(always)]
fn load_8(values: &[f32]) -> f32x8 {
    f32x8::new(values[..8].try_into().expect("a slice of this length"))
}

/// `table[index]` for indices below 8.
#[inline(always)]
pub(super) fn one_of_eight(table: &[f32], index: u32x8) -> u32x8 {
    bytemuck::cast::<_, u32x8>(load_8(table)).shuffle(index)
}

/// `table[index]` for indices below 16.
#[inline(always)]
pub(super) fn one_of_sixteen(table: &[f32], index: u32x8) -> u32x8 {
    let place = index & u32x8::splat(7);
    let low: i32x8 = bytemuck::cast(one_of_eight(table, place));
    let high: i32x8 = bytemuck::cast(one_of_eight(&table[8..], place));
    let index: i32x8 = bytemuck::cast(index);
    bytemuck::cast(index.simd_lt(i32x8::splat(8)).select(low, high))
}

/// In f64. Not by `map`, which may stay a call.
#[inline(always)]
pub(super) fn wider([a, b, c, d, e, f, g, h]: [f32; 8]) -> f64x8 {
    f64x8::new([a.into(), b.into(), c.into(), d.into(), e.into(), f.into(), g.into(), h.into()])
}

/// [`Real::columns`](super::Real::columns), in registers.
#[inline(always)]
pub(super) fn columns_of_f32(rows: [&[f32]; 8]) -> [f64x8; 8] {
    let row = |i: usize| load_8(rows[i]);
    let [a, b, c, d, e, f, g, h] =
        f32x8::transpose([row(0), row(1), row(2), row(3), row(4), row(5), row(6), row(7)]).map(f32x8::to_array);
    [wider(a), wider(b), wider(c), wider(d), wider(e), wider(f), wider(g), wider(h)]
}

// By halves of eight lanes, for which there is a fast transpose; in memory, where halves are a register.
impl Rearrange<f32> for f32x16 {
    #[inline(always)]
    fn deinterleave<const N: usize>(values: &[f32], stride: usize, columns: &mut [[Self; N]; INTERLEAVED], row: usize) {
        for half in [0, 8] {
            let lane = |i: usize| load_8(&values[(half + i) * stride..]);
            let columns_of_half =
                f32x8::transpose([lane(0), lane(1), lane(2), lane(3), lane(4), lane(5), lane(6), lane(7)]);
            for i in 0..INTERLEAVED {
                columns[i][row].as_mut_array()[half..][..8].copy_from_slice(columns_of_half[i].as_array());
            }
        }
    }
    #[inline(always)]
    fn interleave<const N: usize>(columns: &[[Self; N]; INTERLEAVED], row: usize, values: &mut [f32], stride: usize) {
        for half in [0, 8] {
            let column = |i: usize| load_8(&columns[i][row].as_array()[half..]);
            let lanes = [column(0), column(1), column(2), column(3), column(4), column(5), column(6), column(7)];
            let lanes = f32x8::transpose(lanes);
            for i in 0..8 {
                values[(half + i) * stride..][..INTERLEAVED].copy_from_slice(lanes[i].as_array());
            }
        }
    }
    #[inline(always)]
    fn shift_up(self) -> Self {
        self.shuffle_zeroing(u32x16::new([16, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14]))
    }
    #[inline(always)]
    fn shift_down(self) -> Self {
        self.shuffle_zeroing(u32x16::new([1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15, 16]))
    }
}

impl Rearrange<f64> for f64x8 {
    #[inline(always)]
    fn deinterleave<const N: usize>(values: &[f64], stride: usize, columns: &mut [[Self; N]; INTERLEAVED], row: usize) {
        for (i, column) in columns.iter_mut().enumerate() {
            column[row] = Self::new(std::array::from_fn(|lane| values[lane * stride + i]));
        }
    }
    #[inline(always)]
    fn interleave<const N: usize>(columns: &[[Self; N]; INTERLEAVED], row: usize, values: &mut [f64], stride: usize) {
        for (i, column) in columns.iter().enumerate() {
            column[row].as_array().iter().enumerate().for_each(|(lane, &value)| values[lane * stride + i] = value);
        }
    }
    #[inline(always)]
    fn shift_up(self) -> Self {
        self.shuffle_zeroing(u64x8::new([8, 0, 1, 2, 3, 4, 5, 6]))
    }
    #[inline(always)]
    fn shift_down(self) -> Self {
        self.shuffle_zeroing(u64x8::new([1, 2, 3, 4, 5, 6, 7, 8]))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::numeric::{Lanes, Real};

    fn lanes_are_interleaved_and_shifted<R: Real>() {
        let width = R::Lanes::WIDTH;
        for stride in [INTERLEAVED, 11] {
            let values: Vec<R> = (0..width * stride).map(R::from_index).collect();
            let mut columns = [[R::Lanes::default(); 2]; INTERLEAVED];
            R::Lanes::deinterleave(&values, stride, &mut columns, 1);
            let mut written = vec![R::ZERO; width];
            for (i, [_, register]) in columns.into_iter().enumerate() {
                let value = |lane: usize| values[lane * stride + i];
                register.write(&mut written);
                assert!((0..width).all(|lane| written[lane] == value(lane)));
                register.shift_up().write(&mut written);
                assert!((1..width).all(|lane| written[lane] == value(lane - 1)) && written[0] == R::ZERO);
                register.shift_down().write(&mut written);
                assert!((1..width).all(|lane| written[lane - 1] == value(lane)) && written[width - 1] == R::ZERO);
            }
            let mut back = vec![R::ZERO; values.len()];
            R::Lanes::interleave(&columns, 1, &mut back, stride);
            assert!((0..width * stride).all(|i| back[i] == if i % stride < INTERLEAVED { values[i] } else { R::ZERO }));
        }
    }

    #[test]
    fn lanes_of_both_precisions_are_interleaved_and_shifted() {
        lanes_are_interleaved_and_shifted::<f32>();
        lanes_are_interleaved_and_shifted::<f64>();
    }
}
