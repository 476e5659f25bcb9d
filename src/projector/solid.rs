//! A primitive in the grid's slices: what differs from slice to slice, and the registers that its support reaches.

use super::canvas::{Blocks, HALF, PAIR, Window};
use super::column::{Column, STRIP, Stance};
use super::extents::Extents;
use super::kernel::Reach;
use super::plane::{Bounds, Plane, Planes};
use super::shape::{Shape, whitening};
use crate::numeric::vectors::{DVec3x8, LANES, f64x8, splat};
use crate::numeric::{Lanes, Real, WIDEST, real};
use crate::scene::Grid;
use std::ops::Range;

/// How much wider the outline is than the support, so that no rounding leads out of it.
const SPARE: f64 = 1e-3;
/// The same of what cancels in single precision, several times.
const SPARE_CANCELLED: f64 = 1e-6;
/// Columns of registers in a pair of slices whose ends are found together, with those of as many pairs as lanes allow.
const ACROSS: usize = 4;
/// More columns than a grid has.
const MOST: f64 = 1e6;

/// A primitive on a grid. With (X, Y, Z) the distance of a voxel from its centre, M = Q·U for the orthogonal Q and
/// the triangular U of `y = b·Y + ab·Z + bx·X`, `z = a·Z + ax·X`, `x = xx·X`, and δ = x² + y² + z².
#[derive(Clone, Debug)]
pub(super) struct Solid {
    /// The part that all slices share; `slant` is along z.
    plane: Plane,
    /// Rows by which the ridge moves per length along x, and what z and x gain, in units of √unit.
    ridge_x: f64,
    ax: f64,
    xx: f64,
    /// Rows and columns that bound the support in all slices.
    rows: Range<usize>,
    columns: Range<usize>,
    /// Slice of the centre, with a fraction, and the distance of slices.
    centre: f64,
    step: f64,
    slices: Range<usize>,
}

impl Solid {
    /// Whether a sphere around a primitive's support meets the grid: most that do not reach it are told by that.
    pub(super) fn is_near(shape: &Shape, grid: &Grid) -> bool {
        let last = grid.min + grid.size();
        !((shape.mean + shape.radius).cmplt(grid.min).any() || (shape.mean - shape.radius).cmpgt(last).any())
    }

    /// Primitives anywhere: their slices are none where they do not reach the grid.
    pub(super) fn eight(shapes: [&Shape; LANES], grid: &Grid) -> [Self; LANES] {
        let Grid { min, spacing, shape } = *grid;
        let [mx, my, mz] = whitening(shapes).columns;
        let (yz, yx) = (my.cross(mz), my.cross(mx));
        let b = my.length();
        let a = yz.length() / b;
        let root = f64x8::from_fn(|i| shapes[i].unit).sqrt();
        let offset = DVec3x8::from_fn(|i| shapes[i].mean) - DVec3x8::splat(min);
        let place = |along: f64x8, spacing: f64| along / splat(spacing) - splat(0.5);
        let (slice, row, column) = (place(offset.x, spacing.x), place(offset.y, spacing.y), place(offset.z, spacing.z));
        let limit = f64x8::from_fn(|i| shapes[i].limit);
        let planes = Planes {
            row_centre: row,
            column_centre: column,
            slant: -my.dot(mz) / (b * b) * splat(spacing.z) / splat(spacing.y),
            b: b * splat(spacing.y) / root,
            a: a * splat(spacing.z) / root,
            shift: splat(0.0),
            floor: splat(0.0),
            h_y: splat(0.0),
            h_z: splat(0.0),
            k: splat(0.0),
            q: f64x8::from_fn(|i| (shapes[i].nu + 3.0) / 2.0),
            weight: f64x8::from_fn(|i| shapes[i].density),
            limit,
        };
        let xx = f64x8::from_fn(|i| shapes[i].determinant()) / (b * a * root);
        let ridge_x = -my.dot(mx) / (b * b * splat(spacing.y));
        let ax = yz.dot(yx) / (b * b * a * root);
        let radius = limit.sqrt();
        // How far the ridge of each of the unit sphere's axes leads, in rows, and how far columns do.
        let slant = planes.slant;
        let tall =
            DVec3x8::new((ridge_x - slant * ax / planes.a) / xx, splat(1.0) / planes.b, slant / planes.a).length();
        let wide = DVec3x8::new(ax / xx, splat(0.0), splat(1.0)).length() / planes.a;
        let slices = reach(slice, splat(spacing.x), radius / xx, shape[0]);
        let rows = reach(row, splat(1.0), radius * tall, shape[1]);
        let columns = reach(column, splat(1.0), radius * wide, shape[2]);
        let zero = splat(0.0);
        let bounds = Bounds { most: limit, bend: zero, corners: zero.simd_eq(zero) };
        let planes = planes.to_array(&bounds);
        let [ridge_x, ax, xx, centre] = [ridge_x, ax, xx, slice].map(f64x8::to_array);
        std::array::from_fn(|i| Self {
            plane: planes[i],
            ridge_x: ridge_x[i],
            ax: ax[i],
            xx: xx[i],
            rows: rows[i].clone(),
            columns: columns[i].clone(),
            centre: centre[i],
            step: spacing.x,
            slices: slices[i].clone(),
        })
    }

    /// Slices of the support.
    pub(super) fn slices(&self) -> Range<usize> {
        self.slices.clone()
    }

    /// Where the plane is in some slices from one on.
    #[inline(always)]
    fn levels(&self, slice: usize) -> Levels {
        let offset = (splat(slice as f64) + f64x8::from_fn(|i| i as f64) - splat(self.centre)) * splat(self.step);
        let x = splat(self.xx) * offset;
        Levels {
            x: x.to_array(),
            row_centre: (splat(self.plane.row_centre) + splat(self.ridge_x) * offset).to_array(),
            shift: (splat(self.ax) * offset).to_array(),
            floor: (x * x).to_array(),
        }
    }

    /// The plane in one slice, and rows and columns that bound the support there.
    pub(super) fn slice(&self, slice: usize) -> (Plane, Range<usize>, Range<usize>) {
        let Levels { row_centre: [row_centre, ..], shift: [shift, ..], floor: [floor, ..], .. } = self.levels(slice);
        (Plane { row_centre, shift, floor, ..self.plane }, self.rows.clone(), self.columns.clone())
    }

    /// Where registers can hold voxels of the support: for [`ACROSS`] columns of registers side by side in each of `WIDTH/4`
    /// pairs of slices from `slice` on, one pair after the other, in a strip of rows. The first of them all starts at the first
    /// of `columns` that the pair's support can reach, and `shift` columns further.
    #[inline(always)]
    fn ends<L: Lanes>(&self, slice: usize, rows: &Range<usize>, columns: &Range<usize>, shift: usize) -> Ends {
        let Self { plane, ridge_x, ax, xx, step, .. } = self;
        let wide = Window::wide::<L>();
        let width = wide as f64 - 1.0;
        let (offset, left) = ((slice as f64 - self.centre) * step, columns.start as f64 - plane.column_centre);
        // Slices from the first one on, and columns from a pair's first one on.
        let along = L::from_fn(|i| L::Scalar::from_index(i / ACROSS * PAIR));
        let beside = L::from_fn(|i| L::Scalar::from_index(i % ACROSS * wide));

        // What is left of y² + z² in the nearer slice.
        let x = L::splat_f64(xx * offset) + L::splat_f64(xx * step) * along;
        let next = x + L::splat_f64(xx * step);
        let room = L::splat_f64(plane.limit * (1.0 + SPARE)) - (x * x).at_most(next * next);

        // z is 0 in the middle of a slice's ellipse. What is not a number bounds nothing.
        let drift = ax * step;
        let lost = SPARE_CANCELLED
            * (plane.a * (left.abs() + self.columns.len() as f64)
                + (ax * offset).abs()
                + drift.abs() * L::WIDTH as f64);
        let middle = -left - (ax * offset + drift.max(0.0) + lost) / plane.a - SPARE;
        let start =
            L::splat_f64(middle) - L::splat_f64(drift / plane.a) * along - room.sqrt() * L::splat_f64(1.0 / plane.a);
        let start = start.at_least(L::splat_f64(0.0)).at_most(L::splat_f64(MOST));
        let across = start.ceil() + beside + L::splat_f64(shift as f64);

        // And where z is nearest to 0.
        let first = plane.a * left + ax * offset + drift.min(0.0) - lost;
        let z = L::splat_f64(first) + L::splat_f64(plane.a) * across + L::splat_f64(drift) * along;
        let beyond = z + L::splat_f64(plane.a * width + drift.abs() + 2.0 * lost);
        let nearest = z.at_least(-beyond).at_least(L::splat_f64(0.0));
        let room = room - nearest * nearest;

        // So far it can lead from the ridge, which is straight.
        let (turn, bend) = (ridge_x * step, plane.slant * width);
        let top = plane.row_centre + ridge_x * offset + plane.slant * left - rows.start as f64;
        let ridge = L::splat_f64(top + turn.min(0.0) + bend.min(0.0))
            + L::splat_f64(plane.slant) * across
            + L::splat_f64(turn) * along;
        let led = top.abs() + turn.abs() * L::WIDTH as f64 + plane.slant.abs() * self.columns.len() as f64;
        let spare = SPARE + SPARE_CANCELLED * led;
        let reach = room.sqrt() * L::splat_f64(1.0 / plane.b) + L::splat_f64(spare);
        let low = (ridge - reach).at_least(L::splat_f64(0.0));
        let high =
            (ridge + L::splat_f64(turn.abs() + bend.abs()) + reach).at_most(L::splat_f64(rows.len() as f64 - 1.0));
        // None where the last row is above the first one.
        let per_row = L::splat_f64(1.0 / PAIR as f64);
        let end = low.select_le(high, high * per_row + L::splat_f64(1.0), L::splat_f64(0.0));
        let end = room.select_le(L::splat_f64(-f64::from(f32::MIN_POSITIVE)), L::splat_f64(0.0), end);
        let end = across.select_le(L::splat_f64(columns.len() as f64 - 1.0), end, L::splat_f64(0.0));
        let some = L::splat_f64(0.0).below(end);
        let [across, begin, end] = [across, low * per_row, end].map(|lanes| {
            let mut indices = [0; WIDEST];
            L::write_indices(lanes.split().0, &mut indices);
            indices
        });
        Ends { across, begin, end, some }
    }
}

/// For each lane the column, from the first one on, and where its registers begin and end in a strip.
struct Ends {
    across: [u32; WIDEST],
    begin: [u32; WIDEST],
    end: [u32; WIDEST],
    /// A bit for each lane that has registers, in columns there are.
    some: u32,
}

/// What differs from slice to slice in a solid's [`Plane`], and the slice's own coordinate x: of some slices.
struct Levels {
    x: [f64; LANES],
    row_centre: [f64; LANES],
    shift: [f64; LANES],
    floor: [f64; LANES],
}

/// A primitive and the window that is looked at.
pub(super) struct Placed<'a> {
    pub(super) solid: &'a Solid,
    pub(super) window: &'a Window,
}

impl<R: Real> Reach<R> for Placed<'_> {
    type Board = Blocks<R>;
    const TALL: usize = PAIR;
    const SOLID: bool = true;

    #[inline(always)]
    fn plane(&self) -> &Plane {
        &self.solid.plane
    }

    #[inline(always)]
    fn step(blocks: &Blocks<R>) -> usize {
        blocks.window.step::<R::Lanes>()
    }

    #[inline(always)]
    fn load(blocks: &Blocks<R>, place: usize) -> R::Lanes {
        blocks.load(place)
    }

    #[inline(always)]
    fn add(blocks: &mut Blocks<R>, place: usize, value: R::Lanes) {
        blocks.add(place, value);
    }

    #[inline(always)]
    fn walk(&self, mut visit: impl FnMut(Column<R::Lanes>, usize, Range<usize>)) {
        let Self { solid, window } = self;
        let wide = Window::wide::<R::Lanes>();
        let (together, abreast) = (PAIR * R::Lanes::WIDTH / ACROSS, ACROSS * wide);
        let slices = window.slices.start.max(solid.slices.start) & !1..window.slices.end.min(solid.slices.end);
        let rows = solid.rows.start & !1..solid.rows.end;
        let columns = window.columns.start.max(solid.columns.start)..window.columns.end.min(solid.columns.end);
        for some in slices.clone().step_by(together) {
            for strip in rows.clone().step_by(STRIP) {
                let strip = strip..rows.end.min(strip + STRIP);
                for shift in (0..columns.len()).step_by(abreast) {
                    let Ends { across, begin, end, some: mut lanes } =
                        solid.ends::<R::Lanes>(some, &strip, &columns, shift);
                    let levels = solid.levels(some);
                    let pairs = (slices.end - some).div_ceil(PAIR);
                    lanes &= (1_u32 << (pairs * ACROSS).min(R::Lanes::WIDTH)) - 1;
                    while lanes != 0 {
                        let lane = lanes.trailing_zeros() as usize;
                        lanes &= lanes - 1;
                        let slice = lane / ACROSS * PAIR;
                        let stance = Stance::of_slices(&levels, slice);
                        let column = columns.start + across[lane] as usize;
                        let place = window.place::<R::Lanes>(some + slice, strip.start, column);
                        let column = Column::new(&solid.plane, &stance, strip.start, column, both_rows);
                        visit(column, place, begin[lane] as usize..end[lane] as usize);
                    }
                }
            }
        }
    }
}

impl<L: Lanes> Stance<L> {
    /// In a row, slice `first` of the levels and the next one take turns.
    #[inline(always)]
    fn of_slices(levels: &Levels, first: usize) -> Self {
        let turns = |levels: &[f64; LANES]| std::array::from_fn(|i| levels[first + i % PAIR]);
        let lanes = |levels: &[f64; LANES]| L::from_fn(|i| real(levels[first + i % PAIR]));
        Self {
            columns: std::array::from_fn(|i| (i / PAIR) as f64),
            row_centre: turns(&levels.row_centre),
            shift: turns(&levels.shift),
            floor: lanes(&levels.floor),
            row: L::from_fn(|i| L::Scalar::from_index(Window::lane(i)[0])),
            x: lanes(&levels.x),
        }
    }
}

/// The same values in both rows of a register, which may have fewer columns.
#[inline(always)]
fn both_rows<L: Lanes>(values: [f64; HALF]) -> L {
    let values = values.map(real::<L::Scalar>);
    L::from_fn(|i| values[Window::twin(i)])
}

/// Indices within `half` of `centre`, with a breath of rounding to spare.
fn reach(centre: f64x8, step: f64x8, half: f64x8, count: usize) -> [Range<usize>; LANES] {
    Extents::new(centre, step, splat(0.0), half).indices(count).ranges()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::numeric::rng::{Purpose, stream};
    use crate::primitives::{Parameters, Primitives, student_t};
    use rand::RngExt;
    use std::collections::BTreeSet;

    /// Voxels `[slice, row, column]` of the support, and of the registers that a window's walk visits.
    fn held<R: Real>(solid: &Solid, window: &Window) -> (Vec<[usize; 3]>, BTreeSet<[usize; 3]>) {
        let (step, down) = (window.step::<R::Lanes>(), window.rows.div_ceil(PAIR));
        let mut visited = BTreeSet::new();
        Reach::<R>::walk(&Placed { solid, window }, |_, place, registers| {
            assert!(!registers.is_empty());
            for register in registers.map(|j| place + j * step) {
                let [pair, row, column] =
                    [register / step / down, register / step % down, register % step / PAIR / PAIR];
                for lane in 0..R::Lanes::WIDTH {
                    let [down, deep, across] = Window::lane(lane);
                    let voxel = [
                        window.slices.start + PAIR * pair + deep,
                        PAIR * row + down,
                        window.columns.start + column + across,
                    ];
                    assert!(visited.insert(voxel), "{voxel:?} twice");
                }
            }
        });
        let mut support = Vec::new();
        for slice in solid.slices().start.max(window.slices.start)..solid.slices().end.min(window.slices.end) {
            let (plane, rows, columns) = solid.slice(slice);
            for row in rows {
                let within = columns.clone().filter(|column| window.columns.contains(column));
                support.extend(within.filter(|&column| plane.reaches(row, column)).map(|column| [slice, row, column]));
            }
        }
        (support, visited)
    }

    /// Primitives with axes from `thin` to 0.12: more than `some` voxels, and `least` percent of what is visited.
    fn every_voxel_of_the_support_is_visited_and_few_others<R: Real>(thin: f64, some: usize, least: usize) {
        let mut random = stream(8, Purpose::Phantom, 0, 0);
        let mut draw = |low: f64, high: f64| low + (high - low) * random.random::<f64>();
        let grid = Grid::cube(50).block([3, 2, 1], [45, 47, 49]);
        let (mut useful, mut walked) = (0, 0);
        for number in 0..150 {
            let primitives = Primitives::new(Parameters {
                mean: vec![[draw(-1.0, 1.0), draw(-1.0, 1.0), draw(-1.0, 1.0)]],
                scale: vec![std::array::from_fn(|_| thin * libm::pow(0.12 / thin, draw(0.0, 1.0)))],
                quaternion: vec![[draw(-1.0, 1.0), draw(-1.0, 1.0), draw(-1.0, 1.0), 0.1]],
                density: vec![1.0],
                nu: vec![draw(2.0, 40.0)],
            });
            let shape = Shape::new::<R>(&primitives.unwrap(), 0, student_t::bits(1e-2));
            let [solid, ..] = Solid::eight([&shape; LANES], &grid);
            let window = match number % 3 {
                0 => Window { slices: 8..12, rows: 47, columns: 16..31 },
                _ => Window { slices: 0..45, rows: 47, columns: 0..49 },
            };
            let (support, visited) = held::<R>(&solid, &window);
            let missed = support.iter().find(|voxel| !visited.contains(*voxel));
            assert_eq!(missed, None, "{solid:?}");
            useful += support.len();
            walked += visited.len();
        }
        assert!(useful > some && 100 * useful >= least * walked, "{useful} of {walked}");
    }

    #[test]
    fn the_walk_visits_every_voxel_of_a_support_and_few_others() {
        every_voxel_of_the_support_is_visited_and_few_others::<f32>(0.02, 20_000, 42);
        every_voxel_of_the_support_is_visited_and_few_others::<f64>(0.02, 20_000, 51);
    }

    /// Needles along (3, 2, 2), through the centres of voxels: nothing may be lost where columns and slices cancel.
    fn an_oblique_needle_is_visited<R: Real>() {
        let grid = Grid::cube(200);
        let window = Window { slices: 0..200, rows: 200, columns: 0..200 };
        let (half, across) = (0.5 * libm::acos(3.0 / libm::sqrt(17.0)), libm::sqrt(0.5));
        let turn = [libm::cos(half), 0.0, -across * libm::sin(half), across * libm::sin(half)];
        for thin in [1e-3, 1e-5, 1e-7, 1e-9] {
            let primitives = Primitives::new(Parameters {
                mean: vec![[0.005; 3]],
                scale: vec![[0.25, thin, thin]],
                quaternion: vec![turn],
                density: vec![1.0],
                nu: vec![5.0],
            });
            let shape = Shape::new::<R>(&primitives.unwrap(), 0, student_t::bits(1e-2));
            let [solid, ..] = Solid::eight([&shape; LANES], &grid);
            let mut visited = BTreeSet::new();
            Reach::<R>::walk(&Placed { solid: &solid, window: &window }, |_, place, registers| {
                visited.extend(registers.map(|j| place + j * window.step::<R::Lanes>()));
            });
            let wide = Window::wide::<R::Lanes>();
            let centres = (0..66).map(|i| [3 * i + 1, 2 * i + 34]);
            let on: Vec<_> = centres.filter(|&[x, yz]| solid.slice(x).0.reaches(yz, yz)).collect();
            let missed = |[x, yz]: &&[usize; 2]| {
                let place = window.place::<R::Lanes>(*x, *yz, *yz);
                (0..wide).all(|back| !visited.contains(&(place - back * PAIR * PAIR)))
            };
            assert!(on.len() > 30, "{thin}: {}", on.len());
            assert_eq!(on.iter().find(missed), None, "{thin}");
        }
    }

    #[test]
    fn no_voxel_of_a_needle_far_thinner_than_voxels_is_missed() {
        an_oblique_needle_is_visited::<f32>();
        an_oblique_needle_is_visited::<f64>();
        every_voxel_of_the_support_is_visited_and_few_others::<f32>(1e-3, 1000, 10);
        every_voxel_of_the_support_is_visited_and_few_others::<f64>(1e-3, 1000, 16);
    }

    #[test]
    fn among_seven_others_a_solid_has_the_bits_that_it_has_alone() {
        let mut random = stream(9, Purpose::Phantom, 0, 0);
        let mut draw = |low: f64, high: f64| low + (high - low) * random.random::<f64>();
        let grid = Grid::cube(20).block([3, 2, 1], [9, 7, 11]);
        let m = 80;
        let primitives = Primitives::new(Parameters {
            mean: (0..m).map(|_| [draw(-1.0, 1.0), draw(-1.0, 1.0), draw(-1.0, 1.0)]).collect(),
            scale: (0..m).map(|_| [draw(0.01, 0.3), draw(0.01, 0.3), draw(0.01, 0.3)]).collect(),
            quaternion: (0..m).map(|_| [draw(-1.0, 1.0), draw(-1.0, 1.0), draw(-1.0, 1.0), 0.1]).collect(),
            density: (0..m).map(|_| draw(0.1, 2.0)).collect(),
            nu: (0..m).map(|_| draw(2.0, 40.0)).collect(),
        });
        let mut shapes = Vec::new();
        Shape::all_into::<f32>(&mut shapes, &primitives.unwrap(), 1e-2);
        let mut reaching = 0;
        for eight in shapes.chunks(LANES) {
            let together = Solid::eight(std::array::from_fn(|i| &eight[i]), &grid);
            for (shape, solid) in eight.iter().zip(together) {
                let [alone, ..] = Solid::eight([shape; LANES], &grid);
                assert_eq!(format!("{alone:?}"), format!("{solid:?}"));
                reaching += usize::from(!solid.slices().is_empty());
            }
        }
        assert!(10 < reaching && reaching < 70, "{reaching}");
    }
}
