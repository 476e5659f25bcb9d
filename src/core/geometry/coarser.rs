//! A scan at a lower resolution: the same detector and box, with fewer pixels and voxels.

use super::{Detector, Grid, Projections, Scanner};
use crate::numeric::threads;
use glam::DVec3;
use ndarray::{Array2, Array3, ArrayView2};

impl Scanner {
    /// The scanner with voxels `factor` times as long, as nearly as whole numbers of them fill the box, and pixels so many
    /// times as long, at most `factor`, that their images on the axis are about as long as the voxels.
    pub fn coarser(&self, factor: usize) -> Self {
        let Self { beam, detector: d, grid } = *self;
        let voxel = factor as f64 * grid.spacing.min_element() * beam.magnification();
        let count = |n: usize, pitch: f64| n.div_ceil(((voxel / pitch).round() as usize).clamp(1, factor));
        let [rows, columns] = [count(d.rows, d.pitch_v), count(d.columns, d.pitch_u)];
        let detector = Detector {
            rows,
            columns,
            pitch_v: d.pitch_v * d.rows as f64 / rows as f64,
            pitch_u: d.pitch_u * d.columns as f64 / columns as f64,
            ..d
        };
        let shape = grid.shape.map(|n| n.div_ceil(factor));
        let counts = DVec3::from_array(shape.map(|n| n as f64));
        Self { beam, detector, grid: Grid { shape, min: grid.min, spacing: grid.size() / counts } }
    }
}

impl Projections {
    /// The means over `rows` × `columns` equal parts of every image.
    pub fn averaged(&self, rows: usize, columns: usize) -> Self {
        let images = threads::map(self.len(), |view| averaged(self.image(view), rows, columns));
        let images = Array3::from_shape_vec((self.len(), rows, columns), images.into_iter().flatten().collect());
        let images = images.expect("every image has as many pixels");
        Self { angles: self.angles.clone(), poses: self.poses.clone(), images }
    }
}

/// The mean over each of `rows` × `columns` equal parts of an image.
fn averaged(image: ArrayView2<'_, f32>, rows: usize, columns: usize) -> Array2<f32> {
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
        let image = Array3::from_shape_fn((1, 6, 10), |(_, v, u)| (2 * v + 3 * u) as f32);
        let reduced = Projections::new(vec![0.0], image).unwrap().averaged(3, 5);
        let mean = |(_, v, u): (usize, usize, usize)| (2.0 * (2.0 * v as f32 + 0.5)) + 3.0 * (2.0 * u as f32 + 0.5);
        assert_eq!(reduced.images, Array3::from_shape_fn((1, 3, 5), mean));
    }

    #[test]
    fn a_coarser_scanner_has_the_same_detector_and_box() {
        let mut scanner = Scanner::synthetic(10, 20);
        (scanner.detector.offset_u, scanner.grid.shape[2], scanner.detector.rows) = (0.3, 1, 1);
        let coarse = scanner.coarser(4);
        assert_eq!((coarse.grid.shape, coarse.detector.rows, coarse.detector.columns), ([3, 3, 1], 1, 5));
        within!((coarse.grid.max() - scanner.grid.max()).abs().max_element());
        let ends = |d: &Detector| [-0.5, d.columns as f64 - 0.5].map(|column| d.position(0.0, column).0);
        within!("detector", largest([0, 1].map(|i| ends(&coarse.detector)[i] - ends(&scanner.detector)[i])));
        assert_eq!(scanner.coarser(1), scanner);
        // Pixels that are as long as the coarse voxels already stay.
        let of = |pixels| Scanner::synthetic(64, pixels).coarser(2).detector.columns;
        assert_eq!([128, 91, 64, 45, 32].map(of), [64, 46, 64, 45, 32]);
    }
}
