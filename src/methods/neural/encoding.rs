//! What a point is to the network: features of a hash grid, or sines and cosines. Not in the paper.

use trgs_core::numeric::{Lanes, Real, WIDEST, real};

/// Numbers of a table's entry.
pub(super) const FEATURES: usize = 2;
/// Factors of the hash, those of NAF's program.
const PRIMES: [u32; 3] = [1, 19_349_663, 83_492_791];

/// The encoding of points.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Encoding {
    /// Trilinear interpolation in tables of several resolutions; the levels from coarse to fine.
    Hash(Vec<Level>),
    /// The coordinates, and sine and cosine of 1, 2, 4, … times them.
    Frequencies(usize),
}

/// A level of the hash grid.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Level {
    /// Cells along each side.
    pub(super) resolution: u32,
    /// Entries of its table.
    pub(super) entries: u32,
    /// The first of its entries in the table of all levels.
    pub(super) first: usize,
}

/// A cell that a point lies in, and the place within it from 0 to 1.
struct Place<R> {
    cell: [u32; 3],
    part: [R; 3],
}

impl Encoding {
    /// `levels` levels of 16, 32, 64, … cells a side, with at most `2^table` entries each.
    pub(super) fn hash(levels: usize, table: u32) -> Self {
        let mut first = 0;
        let level = |number: usize| {
            let resolution = 16 << number;
            let points = u64::from(resolution + 1).pow(3);
            let entries = points.min(1 << table) as u32;
            let level = Level { resolution, entries, first };
            first += entries as usize;
            level
        };
        Self::Hash((0..levels).map(level).collect())
    }

    /// Numbers of the table.
    pub(super) fn parameters(&self) -> usize {
        match self {
            Self::Hash(levels) => levels.iter().map(|level| level.entries as usize * FEATURES).sum(),
            Self::Frequencies(_) => 0,
        }
    }

    /// Name and shape of each level's table.
    pub(super) fn layout(&self) -> Vec<(String, Vec<usize>)> {
        match self {
            Self::Hash(levels) => {
                let named = |(number, level): (usize, &Level)| {
                    (format!("level_{number}"), vec![level.entries as usize, FEATURES])
                };
                levels.iter().enumerate().map(named).collect()
            }
            Self::Frequencies(_) => Vec::new(),
        }
    }

    /// Numbers of a point.
    pub(super) fn width(&self) -> usize {
        match self {
            Self::Hash(levels) => levels.len() * FEATURES,
            Self::Frequencies(count) => 3 + 6 * count,
        }
    }

    /// Encodes a register of points, from 0 to 1 along each side of the box; `frame` has half of its sides, scene units.
    pub(super) fn encode<R: Real>(&self, table: &[R], points: &[R::Lanes; 3], frame: [f64; 3], code: &mut [R::Lanes]) {
        match self {
            Self::Hash(levels) => {
                for (level, code) in levels.iter().zip(code.as_chunks_mut::<FEATURES>().0) {
                    let places = places::<R>(level, points);
                    let entries = &table[level.first * FEATURES..][..level.entries as usize * FEATURES];
                    let mut features = [[R::ZERO; WIDEST]; FEATURES];
                    for (lane, place) in places.iter().enumerate().take(R::Lanes::WIDTH) {
                        for (entry, weight) in level.corners(place) {
                            for (k, features) in features.iter_mut().enumerate() {
                                features[lane] += weight * entries[entry * FEATURES + k];
                            }
                        }
                    }
                    *code = features.map(|features| R::Lanes::from_slice(&features));
                }
            }
            Self::Frequencies(count) => {
                let mut coordinates = [[0.0; WIDEST]; 3];
                for axis in 0..3 {
                    let mut lanes = [R::ZERO; WIDEST];
                    points[axis].write(&mut lanes);
                    let of = |i: usize| (2.0 * lanes[i].to_f64() - 1.0) * frame[axis];
                    coordinates[axis] = std::array::from_fn(of);
                }
                let lanes =
                    |of: &dyn Fn(f64) -> f64, axis: usize| R::Lanes::from_fn(|i| real(of(coordinates[axis][i])));
                for axis in 0..3 {
                    code[axis] = lanes(&|x| x, axis);
                    for k in 0..*count {
                        let factor = (1_u64 << k) as f64;
                        code[3 + 6 * k + axis] = lanes(&|x| libm::sin(factor * x), axis);
                        code[6 + 6 * k + axis] = lanes(&|x| libm::cos(factor * x), axis);
                    }
                }
            }
        }
    }
}

impl Level {
    /// Adds the gradient to this level's entries: of each register of points, the gradient to their two features.
    pub(super) fn add_gradient<R: Real>(&self, points: &[R::Lanes; 3], slopes: &[R::Lanes], gradient: &mut [R]) {
        let places = places::<R>(self, points);
        let mut of = [[R::ZERO; WIDEST]; FEATURES];
        (0..FEATURES).for_each(|k| slopes[k].write(&mut of[k]));
        for (lane, place) in places.iter().enumerate().take(R::Lanes::WIDTH) {
            for (entry, weight) in self.corners(place) {
                for (k, of) in of.iter().enumerate() {
                    gradient[entry * FEATURES + k] += weight * of[lane];
                }
            }
        }
    }

    /// The entry of a grid point.
    ///
    /// Coordinates are joined while the product of the sides so far, with the overflow of 32 bits, is at most the number of
    /// entries; else they are hashed.
    pub(super) fn entry(&self, point: [u32; 3]) -> usize {
        let (mut index, mut step) = (0_u32, 1_u32);
        for coordinate in point {
            if step > self.entries {
                break;
            }
            index = index.wrapping_add(coordinate.wrapping_mul(step));
            step = step.wrapping_mul(self.resolution + 1);
        }
        if step > self.entries {
            index = (0..3).fold(0, |hash, axis| hash ^ point[axis].wrapping_mul(PRIMES[axis]));
        }
        (index % self.entries) as usize
    }

    /// Entries and weights of the corners of the cells that a register of points lies in, x fastest.
    #[cfg(feature = "conformance")]
    pub(super) fn corners_of<R: Real>(&self, points: &[R::Lanes; 3]) -> Vec<[(usize, R); 8]> {
        places::<R>(self, points).iter().take(R::Lanes::WIDTH).map(|place| self.corners(place)).collect()
    }

    /// Entries and weights of the corners of a cell, x fastest.
    fn corners<R: Real>(&self, place: &Place<R>) -> [(usize, R); 8] {
        let sides = place.part.map(|part| [R::ONE - part, part]);
        std::array::from_fn(|corner| {
            let at = [corner & 1, corner >> 1 & 1, corner >> 2];
            let point = std::array::from_fn(|axis| place.cell[axis] + at[axis] as u32);
            (self.entry(point), sides[0][at[0]] * sides[1][at[1]] * sides[2][at[2]])
        })
    }
}

/// The places of a register of points in the cells of a level.
fn places<R: Real>(level: &Level, points: &[R::Lanes; 3]) -> [Place<R>; WIDEST] {
    let (mut cells, mut parts) = ([[0_u32; WIDEST]; 3], [[R::ZERO; WIDEST]; 3]);
    for axis in 0..3 {
        let scaled = points[axis] * R::Lanes::splat_f64(f64::from(level.resolution - 1)) + R::Lanes::splat_f64(0.5);
        let (cell, part) = scaled.split();
        R::Lanes::write_indices(cell, &mut cells[axis]);
        part.write(&mut parts[axis]);
    }
    std::array::from_fn(|lane| Place { cell: cells.map(|cells| cells[lane]), part: parts.map(|parts| parts[lane]) })
}
