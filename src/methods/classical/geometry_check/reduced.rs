//! A scan reduced so far that it can be reconstructed many times per second.

use super::Convention;
use super::stated::Stated;
use glam::DVec3;
use trgs_core::geometry::{Beam, Detector, Deviation, Grid, Projections, Scanner};

/// Largest extent of the grid, as a fraction of the distance to the source.
const REACH: f64 = 0.95;

/// Where detector and axis are: offsets along u and v (scene units), roll (radians), axis shift (scene units).
pub(super) type Place = [f64; 4];
/// Index of the roll in a [`Place`].
pub(super) const ROLL: usize = 2;
/// Index of the axis shift in a [`Place`].
pub(super) const SHIFT: usize = 3;

/// A subset of the training views on a coarse detector, as read.
pub(super) struct Reduced {
    beam: Beam,
    /// Its offsets are 0, since they are to be found.
    detector: Detector,
    grid: Grid,
    /// In the order of the angles, as read.
    pub(super) views: Projections,
}

impl Reduced {
    /// `views` averaged to at most `pixels` rows and columns.
    ///
    /// The grid has three voxels for four pixels of the longer side.
    pub(super) fn new(views: &Projections, stated: &Stated, pixels: usize) -> Self {
        let Scanner { beam, detector: d, grid } = stated.scanner;
        let [rows, columns] = [d.rows, d.columns].map(|n| n.div_ceil(n.div_ceil(pixels)));
        let detector = Detector {
            rows,
            columns,
            pitch_v: d.pitch_v * d.rows as f64 / rows as f64,
            pitch_u: d.pitch_u * d.columns as f64 / columns as f64,
            offset_u: 0.0,
            offset_v: 0.0,
        };
        let views = Projections { poses: None, ..views.averaged(rows, columns) };
        Self { beam, detector, grid: symmetric(&grid, &beam, (3 * rows.max(columns)).div_ceil(4)), views }
    }

    /// Views corrected for a convention, and their scanner, with detector and axis at `place`.
    pub(super) fn read_as(&self, convention: &Convention, place: Place) -> (Scanner, Projections) {
        let [offset_u, offset_v, roll, axis_shift] = place;
        let detector = Detector { offset_u, offset_v, ..self.detector };
        let scanner = Scanner { beam: self.beam, detector, grid: self.grid };
        let mut views = convention.correct(&self.views);
        if roll != 0.0 || axis_shift != 0.0 {
            let deviation = Deviation { axis_shift, ..Deviation::none(&scanner).rolled(roll) };
            views.poses = Some(views.angles.iter().map(|&angle| deviation.pose(angle)).collect());
        }
        (scanner, views)
    }

    /// The units of a [`Place`] in a search: a coarse pixel, or what moves the detector's corner by about one.
    pub(super) fn units(&self) -> Place {
        let d = &self.detector;
        let mut units = [d.pitch_u, d.pitch_v, 0.0, 0.0];
        units[ROLL] = 2.0 / d.rows.max(d.columns) as f64;
        units[SHIFT] = d.pitch_u;
        units
    }

    /// The grid of the reconstructions.
    pub(super) fn grid(&self) -> &Grid {
        &self.grid
    }

    /// Width and height of a coarse pixel `[u, v]`, scene units.
    pub(super) fn pitch(&self) -> [f64; 2] {
        [self.detector.pitch_u, self.detector.pitch_v]
    }
}

/// A cubic grid around the axis that contains `grid` with all its mirror images and quarter turns.
///
/// An object that a wrong convention mirrors or rotates must not leave it.
fn symmetric(grid: &Grid, beam: &Beam, voxels: usize) -> Grid {
    let reach = grid.min.abs().max(grid.max().abs());
    let mut across = reach.x.max(reach.y);
    if let Beam::Cone { dso, .. } = beam {
        across = across.min(REACH * dso * std::f64::consts::FRAC_1_SQRT_2);
    }
    let spacing = 2.0 * across.max(reach.z) / voxels as f64;
    let count = |half: f64| (2.0 * half / spacing - 1e-9).ceil().max(1.0) as usize;
    let shape = [count(across), count(across), count(reach.z)];
    let size = DVec3::new(shape[0] as f64, shape[1] as f64, shape[2] as f64) * spacing;
    Grid { shape, min: -size / 2.0, spacing: DVec3::splat(spacing) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_grid_holds_all_mirror_images_of_a_shifted_volume_and_stays_away_from_the_source() {
        let grid = Grid::new([20, 10, 8], DVec3::new(-0.3, -0.4, 0.1), DVec3::new(0.9, 0.2, 0.7)).unwrap();
        let held = symmetric(&grid, &Beam::Cone { dso: 5.0, dsd: 7.0 }, 24);
        within!((held.min + held.max()).abs().max_element());
        within!((DVec3::new(0.9, 0.9, 0.7) - held.max()).max_element());
        assert_eq!(held.shape, [24, 24, 19]);
        let near = symmetric(&grid, &Beam::Cone { dso: 1.0, dsd: 7.0 }, 24);
        assert!(near.max().truncate().length() < 1.0);
    }
}
