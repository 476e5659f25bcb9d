//! The part of the SIMD lanes that is within supports. Not in the paper.

use super::image::footprint::Footprint;
use super::image::placement::RowLayout;
use super::image::view::ViewField;
use super::kernel::Rasterize;
use super::kernel::buffers::GridRegion;
use super::kernel::conic::Conic;
use super::kernels::Kernels;
use super::volume::ellipsoid::{Ellipsoid, EllipsoidInRegion};
use super::volume::voxelizer::GridField;
use crate::numeric::{Lanes, Real, threads};
use std::iter::Sum;
use std::ops::Range;

/// Numbers of lanes that an image or a volume evaluates, and of those within supports.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct LaneUtilisation {
    /// Lanes within the supports `[X2]`: pairs of a primitive and a pixel or voxel that it adds to.
    pub active: usize,
    /// Lanes that the kernels evaluate: whole registers, which extend beyond the supports.
    pub evaluated: usize,
    /// Columns of registers that hold them: each is set up once.
    pub columns: usize,
}

impl LaneUtilisation {
    /// The active part of the evaluated lanes, 1 if there are none.
    pub fn ratio(&self) -> f64 {
        if self.evaluated == 0 { 1.0 } else { self.active as f64 / self.evaluated as f64 }
    }

    fn of<R: Real, T: Rasterize<R>>(primitive: &T, active: usize) -> Self {
        let (mut evaluated, mut columns) = (0, 0);
        primitive.for_each_column(|_, _, registers| {
            evaluated += registers.len() * R::Lanes::WIDTH;
            columns += 1;
        });
        Self { active, evaluated, columns }
    }
}

/// Number of pixels of the support.
fn active(conic: &Conic, rows: &Range<usize>, columns: &Range<usize>) -> usize {
    rows.clone().map(|row| columns.clone().filter(|&column| conic.contains(row, column)).count()).sum()
}

impl Sum for LaneUtilisation {
    fn sum<I: Iterator<Item = Self>>(parts: I) -> Self {
        parts.fold(Self::default(), |sum, part| Self {
            active: sum.active + part.active,
            evaluated: sum.evaluated + part.evaluated,
            columns: sum.columns + part.columns,
        })
    }
}

impl<R: Kernels> ViewField<'_, R> {
    /// The lanes of the gradient of an image; the image itself evaluates the same, band by band.
    ///
    /// It tests every pixel: for measurements, not for training.
    ///
    /// Not in the paper. Tests: `most_lanes_are_active`.
    pub fn utilisation(&self) -> LaneUtilisation {
        let one = |i: usize| {
            let footprint @ Footprint { conic, rows, columns, .. } = &self.footprints[i];
            let placed = footprint.placed(rows.clone(), rows.start, 0);
            let active = active(conic, rows, columns);
            if placed.fits_row_layout::<R>() {
                LaneUtilisation::of::<R, _>(&RowLayout(&placed), active)
            } else {
                LaneUtilisation::of::<R, _>(&placed, active)
            }
        };
        threads::map_fine(self.footprints.len(), one).into_iter().sum()
    }
}

impl<R: Kernels> GridField<'_, R> {
    /// The lanes of a volume, and of its gradient.
    ///
    /// It tests every voxel: for measurements, not for training.
    ///
    /// Not in the paper. Tests: `most_lanes_are_active`.
    pub fn utilisation(&self) -> LaneUtilisation {
        let [nx, ny, nz] = self.grid.shape;
        let region = GridRegion { slices: 0..nx, rows: ny, columns: 0..nz };
        let ellipsoids: Vec<&Ellipsoid> = self.ellipsoids.iter().flatten().map(|(_, ellipsoid)| ellipsoid).collect();
        let one = |i: usize| {
            let ellipsoid = ellipsoids[i];
            let of_slice = |x: usize| {
                let (conic, rows, columns) = ellipsoid.slice(x);
                active(&conic, &rows, &columns)
            };
            let active = ellipsoid.slices().map(of_slice).sum();
            LaneUtilisation::of::<R, _>(&EllipsoidInRegion { ellipsoid, region: &region }, active)
        };
        threads::map_fine(ellipsoids.len(), one).into_iter().sum()
    }
}

#[cfg(test)]
mod tests {
    use super::LaneUtilisation;
    use crate::geometry::{Beam, Detector, Grid, Scanner};
    use crate::primitives::{Parameters, Primitives};
    use crate::projector::{Field, Projection};

    /// A lattice of turned primitives of this size, with axes up to 1 to `stretch`, as far as the view and the grid reach.
    fn field(scale: f64, stretch: f64) -> Field<f32> {
        let m = 1000;
        let at = |k: usize| (k as f64 + 0.37) * 0.16 - 0.8;
        let parameters = Parameters {
            mean: (0..m).map(|i| [at(i / 100), at(i / 10 % 10), at(i % 10)]).collect(),
            scale: (0..m).map(|i| [scale, scale * stretch, scale * (0.9 + 0.03 * (i % 7) as f64)]).collect(),
            quaternion: (0..m).map(|i| [1.0, 0.1 * (i % 5) as f64, -0.2, 0.2 * (i % 4) as f64]).collect(),
            density: vec![0.5; m],
            nu: (0..m).map(|i| 5.0 + (i % 30) as f64).collect(),
        };
        Field::new(&Primitives::new(parameters).unwrap(), 1e-3)
    }

    #[test]
    fn most_lanes_are_active() {
        let pitch = 4.0 / 512.0;
        let detector =
            Detector { rows: 512, columns: 512, pitch_v: pitch, pitch_u: pitch, offset_u: 0.0, offset_v: 0.0 };
        let scanner = Scanner { beam: Beam::Cone { dso: 5.0, dsd: 7.0 }, detector, grid: Grid::cube(256) };
        // Supports of 22, of 50 and of more pixels across; registers are 2 rows of 8.
        for (scale, stretch, least) in [(0.0125, 1.1, 0.68), (0.0125, 3.0, 0.75), (0.03, 1.1, 0.8), (0.03, 5.0, 0.8)] {
            let field = field(scale, stretch);
            for projection in [Projection::Affine, Projection::Exact] {
                let lanes = field.view(&scanner, 0.4, projection).utilisation();
                assert!(lanes.ratio() >= least, "{scale} {stretch} {projection:?}: {} of {lanes:?}", lanes.ratio());
            }
        }
        // 22 and 11 voxels across: a slice is small, and what it needs of a register as well.
        for (side, least) in [(128, 0.6), (64, 0.5)] {
            let lanes = field(0.03, 1.1).on(&Grid::cube(side)).utilisation();
            assert!(lanes.ratio() >= least, "{side}: {lanes:?}");
        }
    }

    #[test]
    fn active_lanes_are_the_pixels_that_receive_a_value() {
        let pitch = 4.0 / 96.0;
        let detector = Detector { rows: 91, columns: 96, pitch_v: pitch, pitch_u: pitch, offset_u: 0.3, offset_v: 0.0 };
        let scanner = Scanner { beam: Beam::Cone { dso: 5.0, dsd: 7.0 }, detector, grid: Grid::cube(20) };
        let (field, mut pixels, mut voxels) = (field(0.05, 2.0), 0, 0);
        let view = field.view(&scanner, 0.4, Projection::Exact);
        for row in 0..detector.rows {
            for column in 0..detector.columns {
                pixels += view.contributions(row, column).iter().filter(|&&value| value != 0.0).count();
            }
        }
        let active = view.utilisation().active;
        assert!(active > 10_000 && active.abs_diff(pixels) * 10_000 < active, "{active} and {pixels}");
        for i in 0..scanner.grid.voxels() {
            let contributions = field.voxel_contributions(&scanner.grid, [i / 400, i / 20 % 20, i % 20]);
            voxels += contributions.iter().filter(|&&value| value != 0.0).count();
        }
        let active = field.on(&scanner.grid).utilisation().active;
        assert!(active > 10_000 && active.abs_diff(voxels) * 10_000 < active, "{active} and {voxels}");
        assert_eq!(LaneUtilisation::default().ratio(), 1.0);
    }
}
