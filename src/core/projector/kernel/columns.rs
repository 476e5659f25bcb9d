//! **HOT.** Columns of registers, their batches, and the distances in them.
//!
//! A column is a run of registers below one another within a strip of 32 rows. Column lengths vary, so a loop per column
//! mispredicts. Columns are collected first; distances are then computed in fixed-size batches of registers.

use super::buffers::HALF;
use super::conic::Conic;
use super::variants::{Pass, Rays};
use crate::numeric::{Lanes, ROOT_RANGES, Real, real};
use std::ops::Range;

/// Rows in a strip: a column has at most as many registers.
pub(crate) const STRIP: usize = 32;

/// Coordinates of half of a register's lanes, those of its first row, on the plane or on the planes of two slices.
pub(crate) struct LaneOffsets<L> {
    /// Columns, from the register's first one on.
    pub(crate) columns: [f64; HALF],
    pub(crate) row_centre: [f64; HALF],
    pub(crate) shift: [f64; HALF],
    /// Of all lanes: the conic's floor.
    pub(crate) floor: L,
    /// Of all lanes: the row, 0 or 1.
    pub(crate) row: L,
    /// Of all lanes: the slice's coordinate, whose moments are [`Sums::x`](super::Sums::x).
    pub(crate) x: L,
}

/// Constants of a column of registers, in the terms of [`Conic`].
pub(crate) struct Column<L> {
    z: L,
    floor: L,
    /// h_z·z.
    tilt: L,
    /// The ridge from the lane's row of the strip's first register on: rounded to an integer, and -b times the remainder.
    ridge: [L; 2],
    x: L,
}

impl<L: Lanes> Column<L> {
    /// `both` copies the values of half of the lanes into both rows.
    #[inline(always)]
    pub(crate) fn new(
        conic: &Conic,
        lane_offsets: &LaneOffsets<L>,
        first_row: usize,
        column: usize,
        both: impl Fn([f64; HALF]) -> L,
    ) -> Self {
        let half = HalfLanes::new(conic, lane_offsets, first_row, column);
        Self::at(conic, lane_offsets, both(half.z), [both(half.whole), both(half.rest)])
    }

    /// Of registers of one row, whose halves are side by side.
    #[inline(always)]
    pub(crate) fn of_row(conic: &Conic, lane_offsets: &LaneOffsets<L>, first_row: usize, column: usize) -> Self {
        let left = HalfLanes::new(conic, lane_offsets, first_row, column);
        let right = HalfLanes::new(conic, lane_offsets, first_row, column + L::WIDTH / 2);
        let join = |left: [f64; HALF], right: [f64; HALF]| {
            let [left, right] = [left, right].map(|half| half.map(real::<L::Scalar>));
            L::from_rows(&left[..L::WIDTH / 2], &right[..L::WIDTH / 2])
        };
        let ridge = [join(left.whole, right.whole), join(left.rest, right.rest)];
        Self::at(conic, lane_offsets, join(left.z, right.z), ridge)
    }

    /// `ridge` is from the strip's first row on.
    #[inline(always)]
    fn at(conic: &Conic, lane_offsets: &LaneOffsets<L>, z: L, [whole, rest]: [L; 2]) -> Self {
        Self {
            z,
            floor: z * z + lane_offsets.floor,
            tilt: L::splat_f64(conic.h_z) * z,
            ridge: [whole - lane_offsets.row, rest],
            x: lane_offsets.x,
        }
    }
}

/// [`Column::z`] and [`Column::ridge`] of half of a register's lanes.
struct HalfLanes {
    z: [f64; HALF],
    whole: [f64; HALF],
    rest: [f64; HALF],
}

impl HalfLanes {
    #[inline(always)]
    fn new<L: Lanes>(conic: &Conic, lane_offsets: &LaneOffsets<L>, first_row: usize, column: usize) -> Self {
        let (first_row, column) = (first_row as f64, column as f64);
        // Rounded once, so that the result does not depend on the register that holds the column.
        let across: [f64; HALF] = std::array::from_fn(|i| (column + lane_offsets.columns[i]) - conic.column_centre);
        let ridge: [f64; HALF] =
            std::array::from_fn(|i| lane_offsets.row_centre[i] - first_row + conic.slant * across[i]);
        let whole = ridge.map(f64::floor);
        // b as the lanes have it: y keeps its digits where both parts cancel.
        let b = real::<L::Scalar>(conic.b).to_f64();
        Self {
            z: std::array::from_fn(|i| conic.a * across[i] + lane_offsets.shift[i]),
            whole,
            rest: std::array::from_fn(|i| b * (whole[i] - ridge[i])),
        }
    }
}

/// Registers of which distances are computed together: enough to overlap their dependency chains, few enough for L1.
pub(super) const BATCH: usize = 32;
/// Columns in a batch: all of most footprints.
const COLUMNS: usize = 64;
/// Registers of these columns: room for any column.
const REGISTERS: usize = 8 * BATCH;

/// How 1/√(1+e) is computed in all registers of a support.
#[derive(Clone, Copy)]
enum Root {
    /// e = 0: affine projection.
    None,
    /// |e| does not exceed the first of [`ROOT_RANGES`].
    Sixteenth,
    /// |e| does not exceed the second.
    Quarter,
    /// Any e.
    Any,
}

impl Root {
    #[inline(always)]
    fn new<J: Rays>(conic: &Conic) -> Self {
        match J::ARE_EXACT {
            false => Self::None,
            true if conic.max_abs_e <= ROOT_RANGES[0] => Self::Sixteenth,
            true if conic.max_abs_e <= ROOT_RANGES[1] => Self::Quarter,
            true => Self::Any,
        }
    }
}

/// Constants of a conic, in every lane.
pub(super) struct ConicLanes<L> {
    minus_b: L,
    h_y: L,
    k: L,
    /// Coefficient of y² in e.
    curvature: L,
    pub(super) max_x: L,
    root: Root,
}

impl<L: Lanes> ConicLanes<L> {
    #[inline(always)]
    pub(super) fn new<J: Rays>(conic: &Conic) -> Self {
        let (h_y, k) = (L::splat_f64(conic.h_y), L::splat_f64(conic.k));
        let curvature = h_y.fma(h_y, k);
        Self {
            minus_b: L::splat_f64(-conic.b),
            h_y,
            k,
            curvature,
            max_x: L::splat_f64(conic.max_x),
            root: Root::new::<J>(conic),
        }
    }
}

/// Coordinates of a register's lanes relative to the primitive.
pub(super) struct LaneCoords<L> {
    pub(super) y: L,
    pub(super) x: L,
    /// Exact projection only: 1/√(1+e).
    pub(super) root: L,
}

/// The part of a [`Column`] that the distances, and the moments, depend on.
#[derive(Clone, Copy, Default)]
pub(super) struct BatchedColumn<L> {
    ridge: [L; 2],
    floor: L,
    /// Exact projection only.
    tilt: L,
    /// e at y = 0, and the coefficient of y in e. Exact projection only.
    e: [L; 2],
    /// Vjp only.
    pub(super) z: L,
    /// Vjp of volumes only: the slices' coordinate.
    pub(super) x: L,
    /// Vjp only: where its registers end in the batch.
    pub(super) end: usize,
}

/// A batch of columns, and their registers. Kept from call to call, as [`Scratch`](super::Scratch).
///
/// `push` writes as many registers per column as a strip has, without a branch; the next column overwrites those beyond
/// the column's end.
pub(super) struct ColumnBatch<L> {
    columns: [BatchedColumn<L>; COLUMNS],
    /// The column of each register.
    owner: [u8; REGISTERS + STRIP],
    /// The row of each register, from the strip's first one on.
    row: [f32; REGISTERS + STRIP],
    /// The offset of each register in the target.
    offset: [u32; REGISTERS + STRIP],
    column_count: usize,
    register_count: usize,
}

impl<L: Lanes> Default for ColumnBatch<L> {
    fn default() -> Self {
        Self {
            columns: [BatchedColumn::default(); COLUMNS],
            owner: [0; REGISTERS + STRIP],
            row: [0.0; REGISTERS + STRIP],
            offset: [0; REGISTERS + STRIP],
            column_count: 0,
            register_count: 0,
        }
    }
}

impl<L: Lanes> ColumnBatch<L> {
    /// Whether a column of these registers can be added.
    #[inline(always)]
    pub(super) fn has_room(&self, registers: &Range<usize>) -> bool {
        self.column_count < COLUMNS && self.register_count + registers.len() <= REGISTERS
    }

    /// Adds a column, for which there must be room.
    ///
    /// `offset` is that of the register in the strip's first row; the next register of the column is `stride` scalars and
    /// `rows` rows further.
    #[inline(always)]
    pub(super) fn push<J: Rays, D: Pass>(
        &mut self,
        lanes: &ConicLanes<L>,
        column: Column<L>,
        offset: usize,
        registers: Range<usize>,
        [stride, rows]: [usize; 2],
    ) {
        let (batched, count) = (&mut self.columns[self.column_count], self.register_count);
        (batched.ridge, batched.floor) = (column.ridge, column.floor);
        if J::ARE_EXACT {
            let Column { tilt, floor, .. } = column;
            batched.tilt = tilt;
            let two = L::splat_f64(2.0);
            batched.e = [tilt.fma(tilt + two, lanes.k * floor), lanes.h_y * (tilt + tilt + two)];
        }
        if D::SUMS_MOMENTS {
            (batched.z, batched.x, batched.end) = (column.z, column.x, count + registers.len());
        }
        let written = count..count + STRIP / rows;
        let (first, stride, first_row) =
            ((offset + registers.start * stride) as u32, stride as u32, (registers.start * rows) as f32);
        self.owner[written.clone()].fill(self.column_count as u8);
        self.row[written.clone()].iter_mut().enumerate().for_each(|(i, row)| *row = first_row + (i * rows) as f32);
        // Wrapping: beyond the column's end the offset need not exist.
        self.offset[written]
            .iter_mut()
            .zip(0_u32..)
            .for_each(|(offset, i)| *offset = first.wrapping_add(i.wrapping_mul(stride)));
        self.column_count += 1;
        self.register_count += registers.len();
    }

    /// Its registers, [`BATCH`] at a time.
    #[inline(always)]
    pub(super) fn register_ranges(&self) -> impl Iterator<Item = Range<usize>> + use<L> {
        let count = self.register_count;
        (0..count).step_by(BATCH).map(move |first| first..count.min(first + BATCH))
    }

    #[inline(always)]
    pub(super) fn columns(&self) -> &[BatchedColumn<L>] {
        &self.columns[..self.column_count]
    }

    /// Offsets of registers in the target.
    #[inline(always)]
    pub(super) fn offsets(&self, registers: Range<usize>) -> &[u32] {
        &self.offset[registers]
    }

    #[inline(always)]
    pub(super) fn clear(&mut self) {
        (self.column_count, self.register_count) = (0, 0);
    }

    /// Calls `write(output, coords)` for each of the registers, with one of `outputs` each.
    #[inline(always)]
    pub(super) fn for_each_distance<O>(
        &self,
        lanes: &ConicLanes<L>,
        registers: Range<usize>,
        outputs: impl Iterator<Item = O>,
        write: impl FnMut(O, LaneCoords<L>),
    ) {
        let e = |of: &BatchedColumn<L>, y: L| y.fma(y.fma(lanes.curvature, of.e[1]), of.e[0]);
        let distances = DistanceLoop { batch: self, lanes, registers, outputs, write };
        match lanes.root {
            Root::None => distances.run(|_, _, delta| (delta, L::default())),
            Root::Sixteenth => distances.run(|of, y, delta| (delta, e(of, y).rsqrt_1p_sixteenth())),
            Root::Quarter => distances.run(|of, y, delta| (delta, e(of, y).rsqrt_1p_quarter())),
            // Far from the centre e could overflow, and next to the source 1+e would lose its digits.
            Root::Any => distances.run(|of, y, delta| {
                let delta = delta.at_most(L::splat_f64(L::Scalar::FAR));
                let h = lanes.h_y.fma(y, of.tilt + L::splat_f64(1.0));
                (delta, h.fma(h, lanes.k * delta).rsqrt())
            }),
        }
    }
}

/// The arguments of [`ColumnBatch::for_each_distance`].
struct DistanceLoop<'a, L, O, W> {
    batch: &'a ColumnBatch<L>,
    lanes: &'a ConicLanes<L>,
    registers: Range<usize>,
    outputs: O,
    write: W,
}

impl<L: Lanes, O: Iterator, W: FnMut(O::Item, LaneCoords<L>)> DistanceLoop<'_, L, O, W> {
    /// `root` returns δ/unit, clamped where necessary, and 1/√(1+e).
    #[inline(always)]
    fn run(self, root: impl Fn(&BatchedColumn<L>, L, L) -> (L, L)) {
        let Self { batch, lanes, registers, outputs, mut write } = self;
        let rows = &batch.row[registers.clone()];
        for ((&owner, &row), output) in batch.owner[registers].iter().zip(rows).zip(outputs) {
            let of = &batch.columns[owner as usize % COLUMNS];
            let y = (of.ridge[0] - L::splat_f64(row.into())).fma(lanes.minus_b, of.ridge[1]);
            let (delta, root) = root(of, y, y.fma(y, of.floor));
            let x = if matches!(lanes.root, Root::None) { delta } else { delta * (root * root) };
            write(output, LaneCoords { y, x, root });
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::variants::{Affine, Vjp};
    use super::*;

    type F32s = <f32 as Real>::Lanes;

    /// Adds columns of up to `longest` registers until there is no room; all registers have to be where they were said to be.
    fn every_register_is_in_its_column(longest: usize, columns: usize) {
        let conic = Conic { b: 1.0, max_x: 1e6, ..Conic::default() };
        let (lanes, mut batch) = (ConicLanes::<F32s>::new::<Affine>(&conic), ColumnBatch::<F32s>::default());
        for _ in 0..2 {
            let mut expected = Vec::new();
            for number in 0.. {
                let registers = number % 3..number % 3 + 1 + number % longest;
                if !batch.has_room(&registers) {
                    assert_eq!(number, columns);
                    break;
                }
                let ridge = 100 * number;
                let [whole, floor, zero] = [ridge as f32, number as f32, 0.0].map(F32s::splat);
                let column = Column { z: zero, floor, tilt: zero, ridge: [whole, zero], x: zero };
                batch.push::<Affine, Vjp>(&lanes, column, 1000 * number, registers.clone(), [70, 2]);
                expected.extend(registers.map(|j| {
                    let y = 2.0 * j as f32 - ridge as f32;
                    (1000 * number + 70 * j, y, y * y + number as f32)
                }));
                assert_eq!(batch.columns().last().map(|column| column.end), Some(expected.len()));
            }
            let mut found = Vec::new();
            for registers in batch.register_ranges() {
                let offsets = batch.offsets(registers.clone());
                batch.for_each_distance(&lanes, registers, offsets.iter(), |&offset, LaneCoords { y, x, .. }| {
                    assert!(y == F32s::splat(y.to_array()[0]) && x == F32s::splat(x.to_array()[0]));
                    found.push((offset as usize, y.to_array()[0], x.to_array()[0]));
                });
            }
            assert_eq!(found, expected);
            batch.clear();
        }
    }

    #[test]
    fn every_register_of_many_short_columns_is_in_its_own() {
        every_register_is_in_its_column(1, COLUMNS);
    }

    #[test]
    fn every_register_of_long_columns_is_in_its_own() {
        // 1 + 2 + … + 16 registers and 1 + 2 + … + 15 are all that there is room for.
        every_register_is_in_its_column(STRIP / 2, 31);
    }
}
