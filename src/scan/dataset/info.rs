//! The sizes of a scan, found without reading its arrays.

use super::meta::{Interpreted, Meta};
use super::poses::Motion;
use super::{Dataset, find_points, meta_path, naf};
use crate::borders::{Borders, Side};
use ndarray::Array2;
use std::path::Path;
use trgs_core::error::Result;
use trgs_core::geometry::Scanner;

/// Bytes of an initial point in the smallest type that files use.
const POINT: u64 = 16;

/// The sizes of a scan.
#[derive(Clone, Debug, PartialEq)]
pub struct DatasetInfo {
    /// Detector and grid.
    pub scanner: Scanner,
    /// Training views.
    pub train: usize,
    /// Test views.
    pub test: usize,
    /// Whether its views have poses.
    pub is_posed: bool,
    /// Whether it has a true volume.
    pub has_truth: bool,
    /// Upper bound on the number of initial points.
    pub points: usize,
    /// Whether the object is wider than the detector; false as long as the arrays are not read.
    pub is_cut: bool,
}

impl DatasetInfo {
    /// The sizes of a dataset in memory.
    pub fn of(dataset: &Dataset) -> Self {
        let borders = Borders::of(dataset.train.images.view());
        Self {
            scanner: dataset.scanner,
            train: dataset.train.len(),
            test: dataset.test.as_ref().map_or(0, |views| views.len()),
            is_posed: dataset.train.poses.is_some(),
            has_truth: dataset.truth.is_some(),
            points: dataset.initial_points.as_ref().map_or(0, Array2::nrows),
            is_cut: [Side::Left, Side::Right].into_iter().any(|side| borders.at(side).is_cut()),
        }
    }

    /// The sizes of the dataset at `path`, a folder or its `meta_data.json`.
    ///
    /// `None` for a file whose sizes are only known once it is read.
    ///
    /// # Errors
    /// Those of [`Dataset::read`] for the description.
    pub fn read(path: impl AsRef<Path>) -> Result<Option<Self>> {
        let path = path.as_ref();
        if naf::is_pickle(path) {
            return Ok(None);
        }
        let path = meta_path(path);
        let meta = Meta::read(&path)?;
        let Interpreted { scanner, motion, .. } = meta.interpret(&path)?;
        let folder = path.parent().filter(|parent| !parent.as_os_str().is_empty()).unwrap_or(Path::new("."));
        let points = find_points(folder, "", &mut Vec::new())?.and_then(|file| std::fs::metadata(file).ok());
        Ok(Some(Self {
            scanner,
            train: meta.proj_train.len(),
            test: meta.proj_test.len(),
            is_posed: motion != Motion::Circle,
            has_truth: meta.vol.or(meta.ct).is_some(),
            points: points.map_or(0, |file| (file.len() / POINT) as usize),
            is_cut: false,
        }))
    }
}
