//! Training views, test views and the true volume on different scales.

use super::{Evidence, outside};
use crate::borders::Side;
use crate::dataset::Dataset;
use trgs_core::geometry::Projections;
use trgs_core::numeric::reduce;

/// Ratio of scales that is remarked on.
pub const SCALE: f64 = 2.0;

/// A remark on test views that are larger or smaller than the training views.
pub(super) fn of_test(scan: &Evidence<'_>) -> Option<String> {
    let Dataset { train, test, .. } = scan.dataset;
    // A value that no measurement has is named, and is all of the mean.
    if !scan.wrong.impossible.is_empty() {
        return None;
    }
    let mean = |views: &Projections| {
        let values = views.images.as_slice().expect("projections are in C order");
        reduce::sum(values) / values.len() as f64
    };
    let (train, test) = (mean(train) - scan.air(), mean(test.as_ref()?));
    let ratio = train / test;
    (train > 0.0 && test > 0.0 && !(1.0 / SCALE..=SCALE).contains(&ratio)).then(|| {
        format!(
            "training views are {ratio:.3} times as large as the test views (mean {train:.4} and {test:.4}): the 2D \
             metrics compare different quantities; convert both in the same way"
        )
    })
}

/// A remark on a true volume of another scale than the views.
///
/// The integral over a parallel view is the mass of the object. In a cone beam it is magnified, by nearly (dsd/dso)².
pub(super) fn of_truth(scan: &Evidence<'_>) -> Option<String> {
    let Dataset { scanner, train, truth, .. } = scan.dataset;
    let is_cut = Side::ALL.iter().any(|&side| scan.borders.at(side).is_cut());
    // The mass is only seen whole, and only attenuation has one.
    let truth = truth
        .as_ref()
        .filter(|_| !is_cut && scan.wrong.impossible.is_empty() && !scan.are_readings && !scan.is_hounsfield)?;
    let values = |array: &ndarray::Array3<f32>| reduce::sum(array.as_slice().expect("arrays of scans are in C order"));
    let spacing = truth.grid.spacing;
    let mass = values(&truth.values) * spacing.x * spacing.y * spacing.z;
    let magnification = scanner.beam.magnification();
    let pixel = scanner.detector.pitch_u * scanner.detector.pitch_v / (magnification * magnification);
    let pixels = train.images.len() as f64;
    let seen = (values(&train.images) - scan.air() * pixels) * pixel / train.len() as f64;
    let ratio = seen / mass;
    let differs = seen > 0.0 && mass > 0.0 && !(1.0 / SCALE..=SCALE).contains(&ratio);
    // Views of an object that is larger than the volume see more than the volume holds.
    (differs && !(ratio > 1.0 && outside::is_larger(scan))).then(|| {
        format!(
            "the training views see {ratio:.3} times the mass of the true volume: the unit of length, or that of the \
             densities, differs; divide the projections by {ratio:.3}, or correct sVoxel and sDetector"
        )
    })
}
