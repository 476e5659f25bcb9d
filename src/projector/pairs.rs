//! How much of the work of an image or a volume is of use. Not in the paper.

use super::canvas::Window;
use super::footprint::Footprint;
use super::kernel::Reach;
use super::kernels::Kernels;
use super::patch::Slim;
use super::plane::Plane;
use super::solid::{Placed, Solid};
use super::{GridField, ViewField};
use crate::numeric::{Lanes, Real, threads};
use std::iter::Sum;
use std::ops::Range;

/// Numbers of pairs of a primitive and a pixel or a voxel, and of the columns of registers that hold them.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Pairs {
    /// Pixels within the supports `[X2]`: each adds something.
    pub useful: usize,
    /// Lanes that the kernels go through: whole registers, which reach beyond the supports.
    pub evaluated: usize,
    /// Columns of registers that they are in: each is set up once.
    pub columns: usize,
}

impl Pairs {
    /// The part of the work that is of use, 1 if there is none.
    pub fn share(&self) -> f64 {
        if self.evaluated == 0 { 1.0 } else { self.useful as f64 / self.evaluated as f64 }
    }

    fn of<R: Real, T: Reach<R>>(target: &T, useful: usize) -> Self {
        let (mut evaluated, mut columns) = (0, 0);
        target.walk(|_, _, registers| {
            evaluated += registers.len() * R::Lanes::WIDTH;
            columns += 1;
        });
        Self { useful, evaluated, columns }
    }
}

/// Pixels of the support.
fn useful(plane: &Plane, rows: &Range<usize>, columns: &Range<usize>) -> usize {
    rows.clone().map(|row| columns.clone().filter(|&column| plane.reaches(row, column)).count()).sum()
}

impl Sum for Pairs {
    fn sum<I: Iterator<Item = Self>>(pairs: I) -> Self {
        pairs.fold(Self::default(), |sum, pairs| Self {
            useful: sum.useful + pairs.useful,
            evaluated: sum.evaluated + pairs.evaluated,
            columns: sum.columns + pairs.columns,
        })
    }
}

impl<R: Kernels> ViewField<'_, R> {
    /// What the gradient of an image goes through; the image itself goes through the same, band by band. Asks every pixel:
    /// for measurements, not for training.
    ///
    /// Not in the paper. Tests: `most_of_the_work_is_of_use`.
    pub fn pairs(&self) -> Pairs {
        let one = |i: usize| {
            let footprint @ Footprint { plane, rows, columns, .. } = &self.footprints[i];
            let patch = footprint.patch(rows.clone(), rows.start, 0);
            let useful = useful(plane, rows, columns);
            if patch.is_slim::<R>() {
                Pairs::of::<R, _>(&Slim(&patch), useful)
            } else {
                Pairs::of::<R, _>(&patch, useful)
            }
        };
        threads::map_fine(self.footprints.len(), one).into_iter().sum()
    }
}

impl<R: Kernels> GridField<'_, R> {
    /// What a volume, and its gradient, go through. Asks every voxel: for measurements, not for training.
    ///
    /// Not in the paper. Tests: `most_of_the_work_is_of_use`.
    pub fn pairs(&self) -> Pairs {
        let [nx, ny, nz] = self.grid.shape;
        let window = Window { slices: 0..nx, rows: ny, columns: 0..nz };
        let solids: Vec<&Solid> = self.solids.iter().flatten().map(|(_, solid)| solid).collect();
        let one = |i: usize| {
            let solid = solids[i];
            let of_slice = |x: usize| {
                let (plane, rows, columns) = solid.slice(x);
                useful(&plane, &rows, &columns)
            };
            Pairs::of::<R, _>(&Placed { solid, window: &window }, solid.slices().map(of_slice).sum())
        };
        threads::map_fine(solids.len(), one).into_iter().sum()
    }
}

#[cfg(test)]
mod tests {
    use super::Pairs;
    use crate::primitives::{Parameters, Primitives};
    use crate::projector::{Field, Projection};
    use crate::scene::{Beam, Detector, Grid, Scanner};

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
    fn most_of_the_work_is_of_use() {
        let pitch = 4.0 / 512.0;
        let detector =
            Detector { rows: 512, columns: 512, pitch_v: pitch, pitch_u: pitch, offset_u: 0.0, offset_v: 0.0 };
        let scanner = Scanner { beam: Beam::Cone { dso: 5.0, dsd: 7.0 }, detector, grid: Grid::cube(256) };
        // Supports of 22, of 50 and of more pixels across; registers are 2 rows of 8.
        for (scale, stretch, least) in [(0.0125, 1.1, 0.68), (0.0125, 3.0, 0.75), (0.03, 1.1, 0.8), (0.03, 5.0, 0.8)] {
            let field = field(scale, stretch);
            for projection in [Projection::Affine, Projection::Exact] {
                let pairs = field.view(&scanner, 0.4, projection).pairs();
                assert!(pairs.share() >= least, "{scale} {stretch} {projection:?}: {} of {pairs:?}", pairs.share());
            }
        }
        // 22 and 11 voxels across: a slice is small, and what it needs of a register as well.
        for (side, least) in [(128, 0.6), (64, 0.5)] {
            let pairs = field(0.03, 1.1).on(&Grid::cube(side)).pairs();
            assert!(pairs.share() >= least, "{side}: {pairs:?}");
        }
    }

    #[test]
    fn useful_pairs_are_the_pixels_that_something_is_added_to() {
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
        let useful = view.pairs().useful;
        assert!(useful > 10_000 && useful.abs_diff(pixels) * 10_000 < useful, "{useful} and {pixels}");
        for i in 0..scanner.grid.voxels() {
            let contributions = field.voxel_contributions(&scanner.grid, [i / 400, i / 20 % 20, i % 20]);
            voxels += contributions.iter().filter(|&&value| value != 0.0).count();
        }
        let useful = field.on(&scanner.grid).pairs().useful;
        assert!(useful > 10_000 && useful.abs_diff(voxels) * 10_000 < useful, "{useful} and {voxels}");
        assert_eq!(Pairs::default().share(), 1.0);
    }
}
