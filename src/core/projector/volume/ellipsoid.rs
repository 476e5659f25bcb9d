//! A primitive on a grid: its conic in each slice, and the registers that its support covers.

use crate::geometry::Grid;
use crate::numeric::vectors::{DVec3x8, LANES, f64x8, splat};
use crate::numeric::{Lanes, Real, WIDEST, real};
use crate::projector::kernel::Rasterize;
use crate::projector::kernel::buffers::{BrickedVolume, GridRegion, HALF, PAIR};
use crate::projector::kernel::columns::{Column, LaneOffsets, STRIP};
use crate::projector::kernel::conic::Conic;
use crate::projector::kernel::extents::Extents;
use crate::projector::whitened::{WhitenedPrimitive, whitening};
use std::ops::Range;

/// How much wider than the support the outline is, so that rounding stays inside.
const MARGIN: f64 = 1e-3;
/// A multiple of the relative rounding error of f32, for differences that cancel.
const CANCELLATION_MARGIN: f64 = 1e-6;
/// Columns of registers in a pair of slices whose ends are computed together, in `WIDTH/4` pairs of slices.
const ACROSS: usize = 4;
/// More columns than a grid has.
const MAX_COLUMN: f64 = 1e6;

/// A primitive on a grid. With (X, Y, Z) the distance of a voxel from its centre, M = Q·U for the orthogonal Q and
/// the triangular U of `y = b·Y + ab·Z + bx·X`, `z = a·Z + ax·X`, `x = xx·X`, and δ = x² + y² + z².
#[derive(Clone, Debug)]
pub(crate) struct Ellipsoid {
    /// The conic but for what [`SlicePositions`] has; `slant` is along z.
    conic: Conic,
    /// Rows by which the ridge moves per length along x.
    ridge_x: f64,
    /// Increase of z per length along x, in units of √unit.
    ax: f64,
    /// Increase of x, in units of √unit, per length along x.
    xx: f64,
    /// Rows and columns that bound the support in all slices.
    rows: Range<usize>,
    columns: Range<usize>,
    /// Slice of the centre, fractional.
    centre: f64,
    /// Distance of slices.
    step: f64,
    slices: Range<usize>,
}

impl Ellipsoid {
    /// Whether a sphere around the support meets the grid: a cheap test that rejects most primitives outside of it.
    pub(crate) fn is_near(primitive: &WhitenedPrimitive, grid: &Grid) -> bool {
        let last = grid.min + grid.size();
        !((primitive.mean + primitive.radius).cmplt(grid.min).any()
            || (primitive.mean - primitive.radius).cmpgt(last).any())
    }

    /// The ellipsoids of eight primitives. One that does not reach the grid has no slices.
    pub(crate) fn on_grid(primitives: [&WhitenedPrimitive; LANES], grid: &Grid) -> [Self; LANES] {
        let Grid { min, spacing, shape } = *grid;
        let [mx, my, mz] = whitening(primitives).columns;
        let (yz, yx) = (my.cross(mz), my.cross(mx));
        let b = my.length();
        let a = yz.length() / b;
        let root = f64x8::from_fn(|i| primitives[i].unit).sqrt();
        let offset = DVec3x8::from_fn(|i| primitives[i].mean) - DVec3x8::splat(min);
        let index = |along: f64x8, spacing: f64| along / splat(spacing) - splat(0.5);
        let (slice, row, column) = (index(offset.x, spacing.x), index(offset.y, spacing.y), index(offset.z, spacing.z));
        let max_x = f64x8::from_fn(|i| primitives[i].max_x);
        let zero = splat(0.0);
        let conics = Conic {
            row_centre: row,
            column_centre: column,
            slant: -my.dot(mz) / (b * b) * splat(spacing.z) / splat(spacing.y),
            b: b * splat(spacing.y) / root,
            a: a * splat(spacing.z) / root,
            q: f64x8::from_fn(|i| (primitives[i].nu + 3.0) / 2.0),
            weight: f64x8::from_fn(|i| primitives[i].density),
            max_x,
            max_delta: max_x,
            trims_corners: zero.simd_eq(zero),
            ..Conic::default()
        };
        let xx = f64x8::from_fn(|i| primitives[i].determinant()) / (b * a * root);
        let ridge_x = -my.dot(mx) / (b * b * splat(spacing.y));
        let ax = yz.dot(yx) / (b * b * a * root);
        let radius = max_x.sqrt();
        // Half extents of the unit sphere along each of its axes, in rows and in columns.
        let slant = conics.slant;
        let tall =
            DVec3x8::new((ridge_x - slant * ax / conics.a) / xx, splat(1.0) / conics.b, slant / conics.a).length();
        let wide = DVec3x8::new(ax / xx, splat(0.0), splat(1.0)).length() / conics.a;
        let slices = index_ranges(slice, splat(spacing.x), radius / xx, shape[0]);
        let rows = index_ranges(row, splat(1.0), radius * tall, shape[1]);
        let columns = index_ranges(column, splat(1.0), radius * wide, shape[2]);
        let conics = conics.to_array();
        let [ridge_x, ax, xx, centre] = [ridge_x, ax, xx, slice].map(f64x8::to_array);
        std::array::from_fn(|i| Self {
            conic: conics[i],
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
    pub(crate) fn slices(&self) -> Range<usize> {
        self.slices.clone()
    }

    /// The conic's position in eight slices from one on.
    #[inline(always)]
    fn positions(&self, slice: usize) -> SlicePositions {
        let offset = (splat(slice as f64) + f64x8::from_fn(|i| i as f64) - splat(self.centre)) * splat(self.step);
        let x = splat(self.xx) * offset;
        SlicePositions {
            x: x.to_array(),
            row_centre: (splat(self.conic.row_centre) + splat(self.ridge_x) * offset).to_array(),
            shift: (splat(self.ax) * offset).to_array(),
            floor: (x * x).to_array(),
        }
    }

    /// The conic in one slice, and rows and columns that bound the support there.
    pub(crate) fn slice(&self, slice: usize) -> (Conic, Range<usize>, Range<usize>) {
        let SlicePositions { row_centre: [row_centre, ..], shift: [shift, ..], floor: [floor, ..], .. } =
            self.positions(slice);
        (Conic { row_centre, shift, floor, ..self.conic }, self.rows.clone(), self.columns.clone())
    }

    /// The registers of a strip that can hold voxels of the support.
    ///
    /// They are computed for [`ACROSS`] columns of registers side by side in each of `WIDTH/4` pairs of slices from `slice`
    /// on, pair by pair. A pair's first column is the first of `columns` that its support can reach, plus `shift`.
    #[inline(always)]
    fn ends<L: Lanes>(&self, slice: usize, rows: &Range<usize>, columns: &Range<usize>, shift: usize) -> ColumnEnds {
        let Self { conic, ridge_x, ax, xx, step, .. } = self;
        let wide = GridRegion::register_columns::<L>();
        let width = wide as f64 - 1.0;
        let (offset, left) = ((slice as f64 - self.centre) * step, columns.start as f64 - conic.column_centre);
        // Slices relative to the first one, and columns relative to the pair's first one.
        let along = L::from_fn(|i| L::Scalar::from_index(i / ACROSS * PAIR));
        let beside = L::from_fn(|i| L::Scalar::from_index(i % ACROSS * wide));

        // Bound on y² + z² in the slice closer to the centre.
        let x = L::splat_f64(xx * offset) + L::splat_f64(xx * step) * along;
        let next = x + L::splat_f64(xx * step);
        let rest = L::splat_f64(conic.max_x * (1.0 + MARGIN)) - (x * x).at_most(next * next);

        // z is 0 in the middle of a slice's ellipse. NaN bounds are treated as unbounded.
        let drift = ax * step;
        let lost = CANCELLATION_MARGIN
            * (conic.a * (left.abs() + self.columns.len() as f64)
                + (ax * offset).abs()
                + drift.abs() * L::WIDTH as f64);
        let middle = -left - (ax * offset + drift.max(0.0) + lost) / conic.a - MARGIN;
        let start =
            L::splat_f64(middle) - L::splat_f64(drift / conic.a) * along - rest.sqrt() * L::splat_f64(1.0 / conic.a);
        let start = start.at_least(L::splat_f64(0.0)).at_most(L::splat_f64(MAX_COLUMN));
        let across = start.ceil() + beside + L::splat_f64(shift as f64);

        // The smallest |z| of the registers.
        let first = conic.a * left + ax * offset + drift.min(0.0) - lost;
        let z = L::splat_f64(first) + L::splat_f64(conic.a) * across + L::splat_f64(drift) * along;
        let beyond = z + L::splat_f64(conic.a * width + drift.abs() + 2.0 * lost);
        let nearest = z.at_least(-beyond).at_least(L::splat_f64(0.0));
        let rest = rest - nearest * nearest;

        // The distance from the ridge, which is straight.
        let (turn, lean) = (ridge_x * step, conic.slant * width);
        let top = conic.row_centre + ridge_x * offset + conic.slant * left - rows.start as f64;
        let ridge = L::splat_f64(top + turn.min(0.0) + lean.min(0.0))
            + L::splat_f64(conic.slant) * across
            + L::splat_f64(turn) * along;
        let led = top.abs() + turn.abs() * L::WIDTH as f64 + conic.slant.abs() * self.columns.len() as f64;
        let spare = MARGIN + CANCELLATION_MARGIN * led;
        let extent = rest.sqrt() * L::splat_f64(1.0 / conic.b) + L::splat_f64(spare);
        let low = (ridge - extent).at_least(L::splat_f64(0.0));
        let high =
            (ridge + L::splat_f64(turn.abs() + lean.abs()) + extent).at_most(L::splat_f64(rows.len() as f64 - 1.0));
        // Empty where the last row is above the first one.
        let per_row = L::splat_f64(1.0 / PAIR as f64);
        let end = low.select_le(high, high * per_row + L::splat_f64(1.0), L::splat_f64(0.0));
        let end = rest.select_le(L::splat_f64(-f64::from(f32::MIN_POSITIVE)), L::splat_f64(0.0), end);
        let end = across.select_le(L::splat_f64(columns.len() as f64 - 1.0), end, L::splat_f64(0.0));
        let occupied = L::splat_f64(0.0).below(end);
        let [across, begin, end] = [across, low * per_row, end].map(|lanes| {
            let mut indices = [0; WIDEST];
            L::write_indices(lanes.split().0, &mut indices);
            indices
        });
        ColumnEnds { across, begin, end, occupied }
    }
}

/// Columns of registers in a strip, one per lane.
struct ColumnEnds {
    /// The column, from the first one on.
    across: [u32; WIDEST],
    /// The first register.
    begin: [u32; WIDEST],
    /// The end of the registers.
    end: [u32; WIDEST],
    /// A bit for each lane whose column exists and has registers.
    occupied: u32,
}

/// The fields of an ellipsoid's [`Conic`] that differ between slices, and the slices' coordinate x: of eight slices.
struct SlicePositions {
    x: [f64; LANES],
    row_centre: [f64; LANES],
    shift: [f64; LANES],
    floor: [f64; LANES],
}

/// An ellipsoid and the region of the grid in which it is evaluated.
pub(crate) struct EllipsoidInRegion<'a> {
    pub(crate) ellipsoid: &'a Ellipsoid,
    pub(crate) region: &'a GridRegion,
}

impl<R: Real> Rasterize<R> for EllipsoidInRegion<'_> {
    type Target = BrickedVolume<R>;
    const REGISTER_ROWS: usize = PAIR;
    const IS_VOLUME: bool = true;

    #[inline(always)]
    fn conic(&self) -> &Conic {
        &self.ellipsoid.conic
    }

    #[inline(always)]
    fn register_stride(volume: &BrickedVolume<R>) -> usize {
        volume.region.register_stride::<R::Lanes>()
    }

    #[inline(always)]
    fn load(volume: &BrickedVolume<R>, offset: usize) -> R::Lanes {
        volume.load(offset)
    }

    #[inline(always)]
    fn add(volume: &mut BrickedVolume<R>, offset: usize, value: R::Lanes) {
        volume.add(offset, value);
    }

    #[inline(always)]
    fn for_each_column(&self, mut visit: impl FnMut(Column<R::Lanes>, usize, Range<usize>)) {
        let Self { ellipsoid, region } = self;
        let width = GridRegion::register_columns::<R::Lanes>();
        let (slices_at_once, columns_at_once) = (PAIR * R::Lanes::WIDTH / ACROSS, ACROSS * width);
        let slices = region.slices.start.max(ellipsoid.slices.start) & !1..region.slices.end.min(ellipsoid.slices.end);
        let rows = ellipsoid.rows.start & !1..ellipsoid.rows.end;
        let columns = region.columns.start.max(ellipsoid.columns.start)..region.columns.end.min(ellipsoid.columns.end);
        for first in slices.clone().step_by(slices_at_once) {
            for strip in rows.clone().step_by(STRIP) {
                let strip = strip..rows.end.min(strip + STRIP);
                for shift in (0..columns.len()).step_by(columns_at_once) {
                    let ColumnEnds { across, begin, end, occupied: mut lanes } =
                        ellipsoid.ends::<R::Lanes>(first, &strip, &columns, shift);
                    let positions = ellipsoid.positions(first);
                    let pairs = (slices.end - first).div_ceil(PAIR);
                    lanes &= (1_u32 << (pairs * ACROSS).min(R::Lanes::WIDTH)) - 1;
                    while lanes != 0 {
                        let lane = lanes.trailing_zeros() as usize;
                        lanes &= lanes - 1;
                        let slice = lane / ACROSS * PAIR;
                        let lane_offsets = LaneOffsets::of_slices(&positions, slice);
                        let column = columns.start + across[lane] as usize;
                        let offset = region.offset::<R::Lanes>(first + slice, strip.start, column);
                        let column = Column::new(&ellipsoid.conic, &lane_offsets, strip.start, column, both_rows);
                        visit(column, offset, begin[lane] as usize..end[lane] as usize);
                    }
                }
            }
        }
    }
}

impl<L: Lanes> LaneOffsets<L> {
    /// The lanes of a row alternate between slice `first` of the positions and the next one.
    #[inline(always)]
    fn of_slices(positions: &SlicePositions, first: usize) -> Self {
        let turns = |positions: &[f64; LANES]| std::array::from_fn(|i| positions[first + i % PAIR]);
        let lanes = |positions: &[f64; LANES]| L::from_fn(|i| real(positions[first + i % PAIR]));
        Self {
            columns: std::array::from_fn(|i| (i / PAIR) as f64),
            row_centre: turns(&positions.row_centre),
            shift: turns(&positions.shift),
            floor: lanes(&positions.floor),
            row: L::from_fn(|i| L::Scalar::from_index(GridRegion::lane_position(i)[0])),
            x: lanes(&positions.x),
        }
    }
}

/// The same values in both rows of a register, which may have fewer columns.
#[inline(always)]
fn both_rows<L: Lanes>(values: [f64; HALF]) -> L {
    let values = values.map(real::<L::Scalar>);
    L::from_fn(|i| values[GridRegion::row_lane(i)])
}

/// Indices within `half` of `centre`, widened for rounding.
fn index_ranges(centre: f64x8, step: f64x8, half: f64x8, count: usize) -> [Range<usize>; LANES] {
    Extents::new(centre, step, splat(0.0), half).indices(count).ranges()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::numeric::rng::{Purpose, stream};
    use crate::primitives::{Parameters, Primitives, student_t};
    use rand::RngExt;
    use std::collections::BTreeSet;

    /// Voxels `[slice, row, column]` of the support, and of the registers that are visited in a region.
    fn held<R: Real>(ellipsoid: &Ellipsoid, region: &GridRegion) -> (Vec<[usize; 3]>, BTreeSet<[usize; 3]>) {
        let (step, down) = (region.register_stride::<R::Lanes>(), region.rows.div_ceil(PAIR));
        let mut visited = BTreeSet::new();
        Rasterize::<R>::for_each_column(&EllipsoidInRegion { ellipsoid, region }, |_, offset, registers| {
            assert!(!registers.is_empty());
            for register in registers.map(|j| offset + j * step) {
                let [pair, row, column] =
                    [register / step / down, register / step % down, register % step / PAIR / PAIR];
                for lane in 0..R::Lanes::WIDTH {
                    let [down, deep, across] = GridRegion::lane_position(lane);
                    let voxel = [
                        region.slices.start + PAIR * pair + deep,
                        PAIR * row + down,
                        region.columns.start + column + across,
                    ];
                    assert!(visited.insert(voxel), "{voxel:?} twice");
                }
            }
        });
        let mut support = Vec::new();
        for slice in ellipsoid.slices().start.max(region.slices.start)..ellipsoid.slices().end.min(region.slices.end) {
            let (conic, rows, columns) = ellipsoid.slice(slice);
            for row in rows {
                let within = columns.clone().filter(|column| region.columns.contains(column));
                support.extend(within.filter(|&column| conic.contains(row, column)).map(|column| [slice, row, column]));
            }
        }
        (support, visited)
    }

    /// Primitives with axes from `thin` to 0.12: more than `some` voxels, and `least` percent of what is visited.
    fn every_voxel_of_the_support_is_visited_and_few_others<R: Real>(thin: f64, some: usize, least: usize) {
        let mut random = stream(8, Purpose::Phantom, 0, 0);
        let mut draw = |low: f64, high: f64| low + (high - low) * random.random::<f64>();
        let grid = Grid::cube(50).block([3, 2, 1], [45, 47, 49]);
        let (mut active, mut walked) = (0, 0);
        for number in 0..150 {
            let primitives = Primitives::new(Parameters {
                mean: vec![[draw(-1.0, 1.0), draw(-1.0, 1.0), draw(-1.0, 1.0)]],
                scale: vec![std::array::from_fn(|_| thin * libm::pow(0.12 / thin, draw(0.0, 1.0)))],
                quaternion: vec![[draw(-1.0, 1.0), draw(-1.0, 1.0), draw(-1.0, 1.0), 0.1]],
                density: vec![1.0],
                nu: vec![draw(2.0, 40.0)],
            });
            let primitive = WhitenedPrimitive::new::<R>(&primitives.unwrap(), 0, student_t::bits(1e-2));
            let [ellipsoid, ..] = Ellipsoid::on_grid([&primitive; LANES], &grid);
            let region = match number % 3 {
                0 => GridRegion { slices: 8..12, rows: 47, columns: 16..31 },
                _ => GridRegion { slices: 0..45, rows: 47, columns: 0..49 },
            };
            let (support, visited) = held::<R>(&ellipsoid, &region);
            let missed = support.iter().find(|voxel| !visited.contains(*voxel));
            assert_eq!(missed, None, "{ellipsoid:?}");
            active += support.len();
            walked += visited.len();
        }
        assert!(active > some && 100 * active >= least * walked, "{active} of {walked}");
    }

    #[test]
    fn the_walk_visits_every_voxel_of_a_support_and_few_others() {
        every_voxel_of_the_support_is_visited_and_few_others::<f32>(0.02, 20_000, 42);
        every_voxel_of_the_support_is_visited_and_few_others::<f64>(0.02, 20_000, 51);
    }

    /// Needles along (3, 2, 2), through the centres of voxels: nothing may be lost where columns and slices cancel.
    fn an_oblique_needle_is_visited<R: Real>() {
        let grid = Grid::cube(200);
        let region = GridRegion { slices: 0..200, rows: 200, columns: 0..200 };
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
            let primitive = WhitenedPrimitive::new::<R>(&primitives.unwrap(), 0, student_t::bits(1e-2));
            let [ellipsoid, ..] = Ellipsoid::on_grid([&primitive; LANES], &grid);
            let mut visited = BTreeSet::new();
            Rasterize::<R>::for_each_column(
                &EllipsoidInRegion { ellipsoid: &ellipsoid, region: &region },
                |_, offset, registers| {
                    visited.extend(registers.map(|j| offset + j * region.register_stride::<R::Lanes>()));
                },
            );
            let wide = GridRegion::register_columns::<R::Lanes>();
            let centres = (0..66).map(|i| [3 * i + 1, 2 * i + 34]);
            let on: Vec<_> = centres.filter(|&[x, yz]| ellipsoid.slice(x).0.contains(yz, yz)).collect();
            let missed = |[x, yz]: &&[usize; 2]| {
                let offset = region.offset::<R::Lanes>(*x, *yz, *yz);
                (0..wide).all(|back| !visited.contains(&(offset - back * PAIR * PAIR)))
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
        let mut whitened = Vec::new();
        WhitenedPrimitive::all_into(&mut whitened, &primitives.unwrap(), 1e-2, f32::HORIZON);
        let mut reaching = 0;
        for eight in whitened.chunks(LANES) {
            let together = Ellipsoid::on_grid(std::array::from_fn(|i| &eight[i]), &grid);
            for (primitive, ellipsoid) in eight.iter().zip(together) {
                let [alone, ..] = Ellipsoid::on_grid([primitive; LANES], &grid);
                assert_eq!(format!("{alone:?}"), format!("{ellipsoid:?}"));
                reaching += usize::from(!ellipsoid.slices().is_empty());
            }
        }
        assert!(10 < reaching && reaching < 70, "{reaching}");
    }
}
