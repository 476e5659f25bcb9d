//! **HOT.** The sums of the gradient: over a column of registers, over all registers, over their lanes.

use super::columns::BatchedColumn;
use super::conic::Conic;
use super::variants::Rays;
use crate::numeric::Lanes;

/// `Σ over pixels of cotangent × derivative`, per unit of `weight`, in the terms of [`Conic`].
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Sums {
    /// Derivative to δ/unit (at constant h), times 1, y, z, y², yz, z².
    pub(crate) distance: [f64; 6],
    /// Half the derivative to h, times 1, y, z. Exact projection only.
    pub(crate) h: [f64; 3],
    /// Derivative to k. Exact projection only.
    pub(crate) k: f64,
    /// The values themselves: derivative to `weight`.
    pub(crate) value: f64,
    /// Values times log2(1+x). Student's t only.
    pub(crate) log: f64,
    /// Derivative to δ/unit times the slice's x, its square, x·y, x·z. Volumes only.
    pub(crate) x: [f64; 4],
}

/// A quantity times 1, y, y², summed.
#[derive(Default)]
pub(super) struct Moments<L>([L; 3]);

impl<L: Lanes> Moments<L> {
    #[inline(always)]
    pub(super) fn add(&mut self, value: L, y: L) {
        let first = value * y;
        self.0[0] += value;
        self.0[1] += first;
        self.0[2] = first.fma(y, self.0[2]);
    }
}

/// Sums over one column of registers, before the multiplication with powers of z.
#[derive(Default)]
pub(super) struct ColumnSums<L> {
    pub(super) b: Moments<L>,
    pub(super) bx: Moments<L>,
    pub(super) value: L,
    pub(super) log: L,
}

/// Sums over all registers, lane by lane: a quantity times 1, y, z, y², yz, z².
#[derive(Default)]
pub(super) struct Totals<L> {
    b: [L; 6],
    bx: [L; 6],
    value: L,
    log: L,
    x: [L; 4],
}

impl<L: Lanes> Totals<L> {
    /// Sets the sums that are needed to zero.
    #[inline(always)]
    pub(super) fn clear<J: Rays>(&mut self, is_volume: bool) {
        let zero = L::default();
        (self.b, self.value, self.log) = ([zero; 6], zero, zero);
        if J::ARE_EXACT {
            self.bx = [zero; 6];
        }
        if is_volume {
            self.x = [zero; 4];
        }
    }

    #[inline(always)]
    pub(super) fn add<J: Rays>(&mut self, part: &ColumnSums<L>, z: L) {
        let add = |total: &mut [L; 6], Moments([one, y, yy]): &Moments<L>| {
            let times_z = *one * z;
            total[0] += *one;
            total[1] += *y;
            total[2] += times_z;
            total[3] += *yy;
            total[4] += *y * z;
            total[5] += times_z * z;
        };
        add(&mut self.b, &part.b);
        if J::ARE_EXACT {
            add(&mut self.bx, &part.bx);
        }
        self.value += part.value;
        self.log += part.log;
    }

    /// Adds the moments of x, which is constant within a slice.
    #[inline(always)]
    pub(super) fn add_slices(&mut self, part: &ColumnSums<L>, column: &BatchedColumn<L>) {
        let Moments([one, y, _]) = &part.b;
        let times_x = *one * column.x;
        self.x[0] += times_x;
        self.x[1] += times_x * column.x;
        self.x[2] += *y * column.x;
        self.x[3] += times_x * column.z;
    }

    /// Sums over the lanes. `slopes` are q and q-½.
    #[inline(always)]
    pub(super) fn sums<J: Rays>(&self, conic: &Conic, [slope, slope_x]: [f64; 2], is_volume: bool) -> Sums {
        let sum = |lanes: &[L; 6]| -> [f64; 6] { std::array::from_fn(|i| lanes[i].sum()) };
        let b = sum(&self.b);
        let mut sums =
            Sums { distance: b.map(|b| -slope * b), value: self.value.sum(), log: self.log.sum(), ..Sums::default() };
        if J::ARE_EXACT {
            let Conic { h_y, h_z, k, floor, .. } = *conic;
            let bx = sum(&self.bx);
            let g: [f64; 6] = std::array::from_fn(|i| slope_x * bx[i] - 0.5 * b[i]);
            let [one, y, z, yy, yz, zz] = g;
            sums.h = [one + h_y * y + h_z * z, y + h_y * yy + h_z * yz, z + h_y * yz + h_z * zz];
            sums.k = yy + zz + floor * one;
            sums.distance.iter_mut().zip(g).for_each(|(distance, g)| *distance += k * g);
        }
        if is_volume {
            sums.x = std::array::from_fn(|i| -slope * self.x[i].sum());
        }
        sums
    }
}
