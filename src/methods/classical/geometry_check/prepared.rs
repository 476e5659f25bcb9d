//! The views that a check uses, without the errors that no geometry causes.
//!
//! A pixel that errs in every view, and air that is not 0, contradict each other under every geometry. Either of them makes
//! a residual that some roll or offset lowers by chance. [`WrongPixels`] and [`Air`] find them; both are removed first.

use super::stated::Stated;
use ndarray::Axis;
use trgs_core::error::Result;
use trgs_core::geometry::Projections;
use trgs_scan::pixels::{WrongPixels, interpolate};
use trgs_scan::{Air, Dataset};

/// Largest number of views used.
const VIEWS: usize = 24;

/// The views that a check uses.
pub(super) struct Prepared {
    /// Evenly spaced training views, in the order of their angles, on the plain circle.
    pub(super) views: Projections,
    /// The pixels that were interpolated.
    pub(super) wrong: WrongPixels,
    /// The smallest and the largest reading of air that was subtracted, in the unit of the files.
    pub(super) air: Option<[f64; 2]>,
}

impl Prepared {
    /// Evenly spaced views of a scan, corrected.
    ///
    /// # Errors
    /// When no sound pixel is left beside a wrong one.
    pub(super) fn new(dataset: &Dataset, stated: &Stated) -> Result<Self> {
        let (train, angles) = (&dataset.train, &stated.angles);
        let mut order: Vec<usize> = (0..train.len()).collect();
        order.sort_by(|&a, &b| angles[a].total_cmp(&angles[b]));
        let used = train.len().min(VIEWS);
        let chosen: Vec<usize> = (0..used).map(|i| order[i * train.len() / used]).collect();
        let angles = chosen.iter().map(|&view| angles[view]).collect();
        let mut views = Projections { poses: None, angles, images: train.images.select(Axis(0), &chosen) };
        let (_, rows, columns) = views.images.dim();
        let wrong = WrongPixels::of(&stated.scanner, &views);
        interpolate(&mut views.images, &wrong.mask(rows, columns))?;

        let levels: Vec<f64> =
            Air::of(views.images.view()).map_or(Vec::new(), |air| (0..used).map(|view| air.at(view)).collect());
        for (mut image, &level) in views.images.outer_iter_mut().zip(&levels) {
            image.mapv_inplace(|value| (f64::from(value) - level) as f32);
        }
        let ends = levels.iter().fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], &level| {
            let level = level / dataset.scale;
            [if level < low { level } else { low }, if level > high { level } else { high }]
        });
        let air = levels.iter().any(|&level| level != 0.0).then_some(ends);
        Ok(Self { views, wrong, air })
    }
}
