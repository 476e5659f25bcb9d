//! **HOT.** Columns of registers that a walk over a support has found, and the distances in them.
//!
//! Columns are short, and no two as long as each other: no processor foresees where a loop over one of them ends. So a walk
//! only says where its columns are. Distances are found afterwards, for a batch of registers in one loop, whichever columns
//! they are in.

use super::column::{Column, STRIP};
use super::plane::Plane;
use crate::numeric::{Lanes, ROOT_RANGES, Real, real};
use std::ops::Range;

/// Registers in a batch: enough for their long chains to hide behind each other, few enough for the nearest cache.
pub(super) const BATCH: usize = 32;
/// Columns in a queue, and registers in them: all of most footprints, and room for any column.
const COLUMNS: usize = 64;
const REGISTERS: usize = 8 * BATCH;

/// How 1/√(1+e) is found in all registers of a support.
#[derive(Clone, Copy)]
enum Root {
    /// The affine projection has none.
    None,
    /// No e is beyond the first of [`ROOT_RANGES`].
    Nearest,
    /// No e is beyond the second.
    Near,
    Any,
}

impl Root {
    #[inline(always)]
    fn new<const EXACT: bool>(plane: &Plane) -> Self {
        match EXACT {
            false => Self::None,
            true if plane.bend <= ROOT_RANGES[0] => Self::Nearest,
            true if plane.bend <= ROOT_RANGES[1] => Self::Near,
            true => Self::Any,
        }
    }
}

/// What all registers need of a plane, in every lane.
pub(super) struct Shared<L> {
    minus_b: L,
    h_y: L,
    k: L,
    /// What e grows by with y².
    curvature: L,
    pub(super) limit: L,
    root: Root,
}

impl<L: Lanes> Shared<L> {
    #[inline(always)]
    pub(super) fn new<const EXACT: bool>(plane: &Plane) -> Self {
        let (h_y, k) = (L::splat_f64(plane.h_y), L::splat_f64(plane.k));
        let curvature = h_y.fma(h_y, k);
        Self {
            minus_b: L::splat_f64(-plane.b),
            h_y,
            k,
            curvature,
            limit: L::splat_f64(plane.limit),
            root: Root::new::<EXACT>(plane),
        }
    }
}

/// Where a register's lanes are, seen from the primitive.
pub(super) struct Sight<L> {
    pub(super) y: L,
    pub(super) x: L,
    /// Exact projection only: 1/√(1+e).
    pub(super) root: L,
}

/// What is needed of a [`Column`].
#[derive(Clone, Copy, Default)]
pub(super) struct Queued<L> {
    ridge: [L; 2],
    floor: L,
    /// Exact projection only.
    tilt: L,
    /// e at y = 0, and what it grows by with y. Exact projection only.
    e: [L; 2],
    /// Gradients only, as the slices' x and the end.
    pub(super) z: L,
    pub(super) x: L,
    /// Where its registers end in the queue.
    pub(super) end: usize,
}

/// Columns of registers, and which registers they are. Kept from call to call, as [`Scratch`](super::kernel::Scratch).
///
/// Of each column as many registers are written as a strip can have, which takes whole instructions and no branch; the next
/// column, or nobody, comes over those beyond its end.
pub(super) struct Queue<L> {
    columns: [Queued<L>; COLUMNS],
    /// A register's column.
    owner: [u8; REGISTERS + STRIP],
    /// Its row, from the strip's first one on.
    row: [f32; REGISTERS + STRIP],
    /// Where it is on the board.
    place: [u32; REGISTERS + STRIP],
    /// How many columns and registers there are.
    ended: usize,
    filled: usize,
}

impl<L: Lanes> Default for Queue<L> {
    fn default() -> Self {
        Self {
            columns: [Queued::default(); COLUMNS],
            owner: [0; REGISTERS + STRIP],
            row: [0.0; REGISTERS + STRIP],
            place: [0; REGISTERS + STRIP],
            ended: 0,
            filled: 0,
        }
    }
}

impl<L: Lanes> Queue<L> {
    /// Whether a column of these registers can be added.
    #[inline(always)]
    pub(super) fn has_room(&self, registers: &Range<usize>) -> bool {
        self.ended < COLUMNS && self.filled + registers.len() <= REGISTERS
    }

    /// Adds a column that there is room for. `place` is where the register of the strip's first row is on the board; the next
    /// one in the column is `step` scalars and `tall` rows away.
    #[inline(always)]
    pub(super) fn push<const EXACT: bool, const BACK: bool>(
        &mut self,
        shared: &Shared<L>,
        column: Column<L>,
        place: usize,
        registers: Range<usize>,
        [step, tall]: [usize; 2],
    ) {
        let (queued, filled) = (&mut self.columns[self.ended], self.filled);
        (queued.ridge, queued.floor) = (column.ridge, column.floor);
        if EXACT {
            let Column { tilt, floor, .. } = column;
            queued.tilt = tilt;
            queued.e =
                [tilt.fma(tilt + L::splat_f64(2.0), shared.k * floor), shared.h_y * (tilt + tilt + L::splat_f64(2.0))];
        }
        if BACK {
            (queued.z, queued.x, queued.end) = (column.z, column.x, filled + registers.len());
        }
        let most = filled..filled + STRIP / tall;
        let (first, step, first_row) =
            ((place + registers.start * step) as u32, step as u32, (registers.start * tall) as f32);
        self.owner[most.clone()].fill(self.ended as u8);
        self.row[most.clone()].iter_mut().enumerate().for_each(|(i, row)| *row = first_row + (i * tall) as f32);
        // Beyond the column's end there need not be a place.
        self.place[most]
            .iter_mut()
            .zip(0_u32..)
            .for_each(|(place, i)| *place = first.wrapping_add(i.wrapping_mul(step)));
        self.ended += 1;
        self.filled += registers.len();
    }

    /// Its registers by batches.
    #[inline(always)]
    pub(super) fn batches(&self) -> impl Iterator<Item = Range<usize>> + use<L> {
        let filled = self.filled;
        (0..filled).step_by(BATCH).map(move |first| first..filled.min(first + BATCH))
    }

    #[inline(always)]
    pub(super) fn columns(&self) -> &[Queued<L>] {
        &self.columns[..self.ended]
    }

    /// Where registers are on the board.
    #[inline(always)]
    pub(super) fn places(&self, registers: Range<usize>) -> &[u32] {
        &self.place[registers]
    }

    #[inline(always)]
    pub(super) fn clear(&mut self) {
        (self.ended, self.filled) = (0, 0);
    }

    /// Calls `write(place, sight)` for each of some registers and of the places where that belongs.
    #[inline(always)]
    pub(super) fn look<P>(
        &self,
        shared: &Shared<L>,
        registers: Range<usize>,
        places: impl Iterator<Item = P>,
        write: impl FnMut(P, Sight<L>),
    ) {
        let e = |of: &Queued<L>, y: L| y.fma(y.fma(shared.curvature, of.e[1]), of.e[0]);
        let looked = Looked { queue: self, shared, registers, places, write };
        match shared.root {
            Root::None => looked.run(|_, _, delta| (delta, L::default())),
            Root::Nearest => looked.run(|of, y, delta| (delta, e(of, y).rsqrt_1p_sixteenth())),
            Root::Near => looked.run(|of, y, delta| (delta, e(of, y).rsqrt_1p_quarter())),
            // Far from the centre e could overflow, and beside the source 1+e would lose its digits.
            Root::Any => looked.run(|of, y, delta| {
                let delta = delta.at_most(L::splat_f64(L::Scalar::FAR));
                let h = shared.h_y.fma(y, of.tilt + L::splat_f64(1.0));
                (delta, h.fma(h, shared.k * delta).rsqrt())
            }),
        }
    }
}

/// What [`Queue::look`] is asked.
struct Looked<'a, L, P, W> {
    queue: &'a Queue<L>,
    shared: &'a Shared<L>,
    registers: Range<usize>,
    places: P,
    write: W,
}

impl<L: Lanes, P: Iterator, W: FnMut(P::Item, Sight<L>)> Looked<'_, L, P, W> {
    /// `root` is δ/unit, where it has to be bounded, and 1/√(1+e).
    #[inline(always)]
    fn run(self, root: impl Fn(&Queued<L>, L, L) -> (L, L)) {
        let Self { queue, shared, registers, places, mut write } = self;
        let rows = &queue.row[registers.clone()];
        for ((&owner, &row), place) in queue.owner[registers].iter().zip(rows).zip(places) {
            let of = &queue.columns[owner as usize % COLUMNS];
            let y = (of.ridge[0] - L::splat(real(row.into()))).fma(shared.minus_b, of.ridge[1]);
            let (delta, root) = root(of, y, y.fma(y, of.floor));
            let x = if matches!(shared.root, Root::None) { delta } else { delta * (root * root) };
            write(place, Sight { y, x, root });
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    type F32s = <f32 as Real>::Lanes;

    /// Adds columns of up to `most` registers until there is no room; all registers have to be where they were said to be.
    fn every_register_is_in_its_column(most: usize, columns: usize) {
        let plane = Plane { b: 1.0, limit: 1e6, ..Plane::default() };
        let (shared, mut queue) = (Shared::<F32s>::new::<false>(&plane), Queue::<F32s>::default());
        for _ in 0..2 {
            let mut expected = Vec::new();
            for number in 0.. {
                let registers = number % 3..number % 3 + 1 + number % most;
                if !queue.has_room(&registers) {
                    assert_eq!(number, columns);
                    break;
                }
                let ridge = 100 * number;
                let [whole, floor, zero] = [ridge as f32, number as f32, 0.0].map(F32s::splat);
                let column = Column { z: zero, floor, tilt: zero, ridge: [whole, zero], x: zero };
                queue.push::<false, true>(&shared, column, 1000 * number, registers.clone(), [70, 2]);
                expected.extend(registers.map(|j| {
                    let y = 2.0 * j as f32 - ridge as f32;
                    (1000 * number + 70 * j, y, y * y + number as f32)
                }));
                assert_eq!(queue.columns().last().map(|column| column.end), Some(expected.len()));
            }
            let mut found = Vec::new();
            for batch in queue.batches() {
                let places = queue.places(batch.clone());
                queue.look(&shared, batch, places.iter(), |&place, Sight { y, x, .. }| {
                    assert!(y == F32s::splat(y.to_array()[0]) && x == F32s::splat(x.to_array()[0]));
                    found.push((place as usize, y.to_array()[0], x.to_array()[0]));
                });
            }
            assert_eq!(found, expected);
            queue.clear();
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
