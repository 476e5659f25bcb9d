//! The contribution of each primitive to one pixel or voxel, to trace an artefact to its cause. Not in the paper.

use super::image::placement::{PlacedFootprint, from_even};
use super::image::view::ViewField;
use super::kernel::Scratch;
use super::kernel::buffers::{BrickedVolume, GridRegion, PAIR, PaddedImage};
use super::kernel::columns::STRIP;
use super::kernels::Kernels;
use super::volume::ellipsoid::{Ellipsoid, EllipsoidInRegion};
use super::whitened::{CHUNK, Whitened};
use crate::geometry::Grid;
use crate::numeric::vectors::LANES;
use crate::numeric::{Lanes, Real, threads};
use std::ops::Range;

/// The contribution of one primitive to a value.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Contribution {
    /// Its index in the model.
    pub primitive: usize,
    /// Its contribution; negative with its density.
    pub value: f64,
    /// `value` as a fraction of the sum of all; not finite if that is 0.
    pub share: f64,
    /// Sum of the values up to this one, in the order of the list.
    pub sum: f64,
}

/// The primitives with a non-zero contribution, the largest |value| first, equal ones by index.
///
/// `values` has an element per primitive, as [`ViewField::contributions`] and [`Field::voxel_contributions`](super::Field::voxel_contributions) make it.
/// Not in the paper: a tool to for_each_distance with. Tests: `ranks_are_by_size_and_sums_run`.
pub fn rank<R: Real>(values: &[R]) -> Vec<Contribution> {
    let values: Vec<f64> = values.iter().map(|value| value.to_f64()).collect();
    let mut order: Vec<usize> = (0..values.len()).filter(|&i| values[i] != 0.0).collect();
    order.sort_by(|&i, &j| values[j].abs().total_cmp(&values[i].abs()).then(i.cmp(&j)));
    let total: f64 = order.iter().map(|&i| values[i]).sum();
    let mut sum = 0.0;
    let one = |primitive: usize| {
        let value = values[primitive];
        sum += value;
        Contribution { primitive, value, share: value / total, sum }
    };
    order.into_iter().map(one).collect()
}

impl<R: Kernels> ViewField<'_, R> {
    /// The contribution of each primitive to the pixel at (row, column), `[M]`, line integrals of its density `[Eq. 4]`,
    /// `[X1]`.
    ///
    /// The kernels of the image compute them, register by register: in index order they add up to the image's pixel but
    /// for a rounding of each. 0 beyond the cutoff, and for primitives near or behind the source.
    ///
    /// Tests: `contributions_add_up_to_the_image_and_the_volume`.
    ///
    /// # Panics
    /// If the pixel is not on the detector.
    pub fn contributions(&self, row: usize, column: usize) -> Vec<R> {
        let detector = &self.view.detector;
        let on_detector = row < detector.rows && column < detector.columns;
        assert!(on_detector, "pixel ({row}, {column}) of {} × {}", detector.rows, detector.columns);
        let length = self.ray_lengths(row).map_or(R::ONE, |length| length(column));
        let kernel = self.kernels().forward;
        let origin = row / STRIP * STRIP;
        let band = origin..detector.rows.min(origin + STRIP);
        let half = R::Lanes::WIDTH / 2;
        in_chunks(self.footprints.len(), |primitives| {
            let (mut image, mut scratch) = (PaddedImage::<R>::new(STRIP, column + 1), Scratch::default());
            let one = |i: usize| {
                let footprint = &self.footprints[i];
                let (rows, columns) = (from_even(footprint.rows_in(band.clone())), footprint.columns.clone());
                // Registers are two rows tall and `half` columns wide, and extend beyond the last row and column.
                let tall = rows.start..rows.start + rows.len().next_multiple_of(2);
                let wide = columns.start..columns.start + columns.len().next_multiple_of(half);
                if !(tall.contains(&row) && wide.contains(&column)) {
                    return R::ZERO;
                }
                let first = column - (column - columns.start) % half;
                image.clear(first..first + 1);
                let pixel =
                    PlacedFootprint::new(&footprint.conic, rows.start..row + 1, first..first + 1, 0, image.stride);
                kernel(&pixel, &mut image, &mut scratch);
                image.row(row - rows.start, column + 1)[column] * length
            };
            primitives.map(one).collect()
        })
    }
}

/// [`Field::voxel_contributions`](super::Field::voxel_contributions) of whitened primitives. Not in the paper.
pub(super) fn of_voxel<R: Kernels>(whitened: Whitened<'_>, grid: &Grid, [x, y, z]: [usize; 3]) -> Vec<R> {
    let on_grid = [x, y, z].iter().zip(grid.shape).all(|(&index, n)| index < n);
    assert!(on_grid, "voxel {:?} of {:?}", [x, y, z], grid.shape);
    let kernel = R::volume_kernels(whitened.kernel).forward;
    // A voxel's value does not depend on the register that holds it.
    let slice = x / PAIR * PAIR;
    let region = GridRegion { slices: slice..slice + PAIR, rows: grid.shape[1], columns: z..z + 1 };
    in_chunks(whitened.primitives.len(), |primitives| {
        let (mut volume, mut scratch) = (BrickedVolume::<R>::new(region.clone()), Scratch::default());
        let mut voxel = [R::ZERO];
        let one = |i: usize| {
            volume.clear();
            let [ellipsoid, ..] = &Ellipsoid::on_grid([&whitened.primitives[i]; LANES], grid);
            kernel(&EllipsoidInRegion { ellipsoid, region: &region }, &mut volume, &mut scratch);
            volume.read(x, y, &mut voxel);
            voxel[0]
        };
        primitives.map(one).collect()
    })
}

/// The values of `m` primitives, chunk by chunk.
fn in_chunks<R: Real>(m: usize, chunk: impl Fn(Range<usize>) -> Vec<R> + Send + Sync) -> Vec<R> {
    threads::map(m.div_ceil(CHUNK), |number| chunk(number * CHUNK..m.min((number + 1) * CHUNK))).concat()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::{Beam, Detector, Scanner};
    use crate::numeric::rng::{Purpose, stream};
    use crate::primitives::{Parameters, Primitives};
    use crate::projector::{Field, Projection};
    use glam::DVec3;
    use rand::RngExt;

    /// More than a chunk of primitives of all sizes, some of negative density, one behind the source.
    fn primitives(gaussian: bool) -> Primitives {
        let mut random = stream(5, Purpose::Phantom, 0, 0);
        let mut parameters = Parameters::zeros(CHUNK + 40);
        for i in 0..parameters.len() {
            let mut draw = |low: f64, high: f64| low + (high - low) * random.random::<f64>();
            parameters.mean[i] = [draw(-0.9, 0.9), draw(-0.9, 0.9), draw(-0.9, 0.9)];
            parameters.scale[i] = [draw(0.02, 0.3), draw(0.02, 0.3), draw(0.02, 0.3)];
            parameters.quaternion[i] = [draw(-1.0, 1.0), draw(-1.0, 1.0), draw(-1.0, 1.0), draw(-1.0, 1.0)];
            parameters.density[i] = draw(-0.3, 1.0);
            parameters.nu[i] = if gaussian { f64::INFINITY } else { draw(1.0, 40.0) };
        }
        parameters.mean[7] = [6.0, 2.0, 0.1];
        Primitives::new(parameters).unwrap()
    }

    fn scanner(beam: Beam) -> Scanner {
        let detector =
            Detector { rows: 71, columns: 45, pitch_v: 0.05, pitch_u: 0.08, offset_u: 0.13, offset_v: -0.07 };
        let grid = Grid::new([5, 71, 19], DVec3::new(-1.0, -0.9, -0.8), DVec3::new(0.9, 1.0, 0.7)).unwrap();
        Scanner { beam, detector, grid }
    }

    /// The sum in index order, and how far it is from the value in units of the roundings that go into it.
    fn sum<R: Real>(parts: &[R], value: R) -> (R, f64) {
        let sum = parts.iter().fold(R::ZERO, |sum, &part| sum + part);
        let size: f64 = parts.iter().map(|part| part.to_f64().abs()).sum();
        let epsilon = if R::HORIZON > 1000.0 { f64::EPSILON } else { f64::from(f32::EPSILON) };
        (sum, if sum == value { 0.0 } else { (sum - value).abs().to_f64() / (epsilon * size) })
    }

    fn check<R: Kernels>(gaussian: bool) {
        let primitives = primitives(gaussian);
        for cutoff in [0.0, 1e-2] {
            let field = Field::<R>::new(&primitives, cutoff);
            for beam in [Beam::Cone { dso: 5.0, dsd: 7.0 }, Beam::Parallel { dso: 5.0 }] {
                let scanner = scanner(beam);
                for projection in [Projection::Exact, Projection::Affine] {
                    let view = field.view(&scanner, 0.7, projection);
                    let image = view.image();
                    for (row, column) in [(0, 0), (33, 44), (31, 7), (70, 21), (40, 22)] {
                        let parts = view.contributions(row, column);
                        let what = format!("{beam:?} {projection:?} cutoff {cutoff} pixel ({row}, {column})");
                        // Without a ray's length to multiply with, the sum is the image's to the bit. Roundings that have
                        // nothing to do with each other grow as the root of their number.
                        let some = (primitives.len() as f64).sqrt() / 2.0;
                        let allowed = if view.ray_lengths(row).is_some() { some } else { 0.0 };
                        let (sum, error) = sum(&parts, image[[row, column]]);
                        assert!(error <= allowed, "{what}: {sum} is off by {error}");
                        assert_eq!(parts.len(), primitives.len());
                        assert!(cutoff == 0.0 || parts.iter().filter(|&&part| part == R::ZERO).count() > 5, "{what}");
                    }
                }
            }
            let grid = scanner(Beam::Parallel { dso: 5.0 }).grid;
            let volume = field.voxels(&grid);
            for voxel in [[0, 0, 0], [4, 70, 18], [2, 33, 9], [3, 31, 12]] {
                let (sum, _) = sum(&field.voxel_contributions(&grid, voxel), volume[voxel]);
                assert_eq!(sum, volume[voxel], "cutoff {cutoff} voxel {voxel:?}");
            }
        }
    }

    #[test]
    fn contributions_add_up_to_the_image_and_the_volume() {
        for gaussian in [false, true] {
            check::<f32>(gaussian);
            check::<f64>(gaussian);
        }
    }

    #[test]
    fn a_contribution_is_the_image_of_the_primitive_alone() {
        let primitives = primitives(false);
        let scanner = scanner(Beam::Cone { dso: 5.0, dsd: 7.0 });
        let field = Field::<f64>::new(&primitives, 0.0);
        let parts = field.view(&scanner, 0.7, Projection::Exact).contributions(33, 20);
        for i in [0, 7, 19, CHUNK + 3] {
            let mut alone = primitives.clone();
            alone.parameters.density.iter_mut().enumerate().filter(|(j, _)| *j != i).for_each(|(_, d)| *d = 0.0);
            let image = super::super::forward::<f64>(&alone, &scanner, &[0.7], Projection::Exact, 0.0);
            assert_eq!(image[[0, 33, 20]], parts[i], "primitive {i}");
        }
        assert_eq!(parts[7], 0.0, "behind the source");
    }

    #[test]
    fn ranks_are_by_size_and_sums_run() {
        let ranked = rank(&[0.5_f64, 0.0, -2.0, 4.0, 0.5]);
        let list: Vec<_> = ranked.iter().map(|c| (c.primitive, c.value, c.sum)).collect();
        assert_eq!(list, [(3, 4.0, 4.0), (2, -2.0, 2.0), (0, 0.5, 2.5), (4, 0.5, 3.0)]);
        assert_eq!(ranked.iter().map(|c| c.share * 3.0).collect::<Vec<_>>(), [4.0, -2.0, 0.5, 0.5]);
        assert!(rank(&[0.0_f32; 3]).is_empty());
        assert!(rank(&[1.0_f32, -1.0])[0].share.is_infinite());
    }
}
