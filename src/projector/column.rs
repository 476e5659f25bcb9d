//! A column of registers: what its pixels, or voxels, have in common.

use super::canvas::HALF;
use super::plane::Plane;
use crate::numeric::{Lanes, Real, real};

/// Rows in a strip: as many registers as a column has at most.
pub(super) const STRIP: usize = 32;

/// Where half of a register's lanes are in the plane, or in the planes of two slices: those of its first row.
pub(super) struct Stance<L> {
    /// Columns from the register's first one on.
    pub(super) columns: [f64; HALF],
    pub(super) row_centre: [f64; HALF],
    pub(super) shift: [f64; HALF],
    /// Of all lanes: the plane's floor, the row (0 or 1), and the slice's coordinate, of which [`Sums::x`](super::kernel::Sums::x) are moments.
    pub(super) floor: L,
    pub(super) row: L,
    pub(super) x: L,
}

/// What is constant along a column of registers, in the terms of [`Plane`].
pub(super) struct Column<L> {
    pub(super) z: L,
    pub(super) floor: L,
    /// h_z·z.
    pub(super) tilt: L,
    /// The ridge from the lane's row of the strip's first register on: rounded to an integer, and -b times the rest.
    pub(super) ridge: [L; 2],
    pub(super) x: L,
}

impl<L: Lanes> Column<L> {
    /// `both` puts the values of half of the lanes into both rows.
    #[inline(always)]
    pub(super) fn new(
        plane: &Plane,
        stance: &Stance<L>,
        first_row: usize,
        column: usize,
        both: impl Fn([f64; HALF]) -> L,
    ) -> Self {
        let half = Half::new(plane, stance, first_row, column);
        Self::at(plane, stance, both(half.z), [both(half.whole), both(half.rest)])
    }

    /// Of registers of a row, whose halves are beside each other.
    #[inline(always)]
    pub(super) fn of_row(plane: &Plane, stance: &Stance<L>, first_row: usize, column: usize) -> Self {
        let left = Half::new(plane, stance, first_row, column);
        let right = Half::new(plane, stance, first_row, column + L::WIDTH / 2);
        let join = |left: [f64; HALF], right: [f64; HALF]| {
            let [left, right] = [left, right].map(|half| half.map(real::<L::Scalar>));
            L::from_rows(&left[..L::WIDTH / 2], &right[..L::WIDTH / 2])
        };
        let ridge = [join(left.whole, right.whole), join(left.rest, right.rest)];
        Self::at(plane, stance, join(left.z, right.z), ridge)
    }

    /// `ridge` is from the strip's first row on.
    #[inline(always)]
    fn at(plane: &Plane, stance: &Stance<L>, z: L, [whole, rest]: [L; 2]) -> Self {
        Self {
            z,
            floor: z * z + stance.floor,
            tilt: L::splat_f64(plane.h_z) * z,
            ridge: [whole - stance.row, rest],
            x: stance.x,
        }
    }
}

/// What half of a register's lanes need.
struct Half {
    z: [f64; HALF],
    /// Of [`Column::ridge`].
    whole: [f64; HALF],
    rest: [f64; HALF],
}

impl Half {
    #[inline(always)]
    fn new<L: Lanes>(plane: &Plane, stance: &Stance<L>, first_row: usize, column: usize) -> Self {
        let (first_row, column) = (first_row as f64, column as f64);
        // Rounded once, whichever register the column is in.
        let across: [f64; HALF] = std::array::from_fn(|i| (column + stance.columns[i]) - plane.column_centre);
        let ridge: [f64; HALF] = std::array::from_fn(|i| stance.row_centre[i] - first_row + plane.slant * across[i]);
        let whole = ridge.map(f64::floor);
        // The b that lanes have: y keeps its digits where both parts cancel.
        let b = real::<L::Scalar>(plane.b).to_f64();
        Self {
            z: std::array::from_fn(|i| plane.a * across[i] + stance.shift[i]),
            whole,
            rest: std::array::from_fn(|i| b * (whole[i] - ridge[i])),
        }
    }
}
