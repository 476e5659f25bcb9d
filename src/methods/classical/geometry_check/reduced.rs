//! A scan reduced so far that it can be reconstructed many times per second.

use super::Convention;
use super::stated::Stated;
use glam::DVec3;
use ndarray::{Array2, Array3, ArrayView2};
use trgs_core::geometry::{Beam, Detector, Deviation, Grid, Projections, Scanner};
use trgs_core::numeric::threads;

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
        let used = views.len();
        let [rows, columns] = [d.rows, d.columns].map(|n| n.div_ceil(n.div_ceil(pixels)));
        let images = threads::map(used, |i| reduce(views.image(i), rows, columns));
        let images = Array3::from_shape_vec((used, rows, columns), images.into_iter().flatten().collect());
        let detector = Detector {
            rows,
            columns,
            pitch_v: d.pitch_v * d.rows as f64 / rows as f64,
            pitch_u: d.pitch_u * d.columns as f64 / columns as f64,
            offset_u: 0.0,
            offset_v: 0.0,
        };
        let images = images.expect("every image has as many pixels");
        let views = Projections { poses: None, angles: views.angles.clone(), images };
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

/// The mean over each of `rows` × `columns` equal parts of an image.
fn reduce(image: ArrayView2<'_, f32>, rows: usize, columns: usize) -> Array2<f32> {
    let (across, along) = (shares(image.ncols(), columns), shares(image.nrows(), rows));
    Array2::from_shape_fn((rows, columns), |(row, column)| {
        let line = |v: usize| across[column].iter().map(|&(u, share)| share * f64::from(image[[v, u]])).sum::<f64>();
        along[row].iter().map(|&(v, share)| share * line(v)).sum::<f64>() as f32
    })
}

/// For each of `parts` equal parts of `n` elements: the elements it overlaps and their weights.
fn shares(n: usize, parts: usize) -> Vec<Vec<(usize, f64)>> {
    let width = n as f64 / parts as f64;
    let part = |i: usize| {
        let (from, to) = (i as f64 * width, (i + 1) as f64 * width);
        let elements = (from as usize..n).take_while(move |&k| (k as f64) < to - 1e-9);
        elements.map(move |k| (k, (to.min((k + 1) as f64) - from.max(k as f64)) / width)).collect()
    };
    (0..parts).map(part).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tolerances::largest;

    #[test]
    fn shares_add_up_to_one_and_elements_to_their_width() {
        for (n, parts) in [(128, 64), (101, 51), (7, 3), (5, 5), (1, 1)] {
            let shares = shares(n, parts);
            let mut used = vec![0.0; n];
            for part in &shares {
                within!((part.iter().map(|(_, share)| share).sum::<f64>() - 1.0).abs());
                part.iter().for_each(|&(k, share)| used[k] += share * n as f64 / parts as f64);
            }
            within!("elements", largest(used.iter().map(|used| used - 1.0)), "{n} {parts}: {used:?}");
        }
    }

    #[test]
    fn the_mean_of_an_image_stays_and_a_gradient_stays_one() {
        let image = Array2::from_shape_fn((6, 10), |(v, u)| (2 * v + 3 * u) as f32);
        let reduced = reduce(image.view(), 3, 5);
        assert_eq!(
            reduced,
            Array2::from_shape_fn((3, 5), |(v, u)| (2.0 * (2.0 * v as f32 + 0.5)) + 3.0 * (2.0 * u as f32 + 0.5))
        );
    }

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
