//! The density unit of a scan: thresholds, weights and constants of a method are relative to it.

use super::algebraic::{SartSettings, sart};
use super::{RayModel, VoxelProjector};
use std::borrow::Cow;
use std::ops::ControlFlow;
use trgs_core::error::Result;
use trgs_core::geometry::{Projections, Scanner};
use trgs_scan::Dataset;

/// SART passes that U is computed from.
const PASSES: usize = 2;
/// Quantile of the voxels that U is computed from.
const SHARE: f64 = 0.999;
/// Density of the truth over that of the passes, each at this quantile.
///
/// It is the median over the scans of `reference/CHOICES.md`.
const FACTOR: f64 = 1.06;

/// U, attenuation per scene unit: about the largest density of the object.
///
/// Not in the paper, whose densities lie in [0, 1]. `U = 1.06·(99.9th percentile of the voxels after two passes of
/// SART)`. For an object that fills less than a thousandth of the volume, the largest voxel replaces the percentile.
/// Projections scaled by k > 0 give U scaled by k, exactly for a power of two. If no voxel is above 0 (projections
/// without a positive value), U is 1.
///
/// # Errors
/// Those of [`sart`].
///
/// Tests: `it_follows_the_projections_and_is_1_of_nothing`, `any_scanner_has_one`, `tests/cli/units.rs`.
pub fn density_unit(scanner: &Scanner, projections: &Projections) -> Result<f64> {
    let projector = VoxelProjector::new(scanner, RayModel::Joseph)?;
    let settings = SartSettings { iterations: PASSES, ..SartSettings::default() };
    let volume = sart::<f32>(&projector, projections, &settings, &mut |_| ControlFlow::Continue(()))?;
    let mut values = volume.values.into_raw_vec_and_offset().0;
    let rank = ((values.len() as f64 * SHARE).ceil() as usize).saturating_sub(1);
    let (_, &mut high, above) = values.select_nth_unstable_by(rank, f32::total_cmp);
    let high =
        if high > 0.0 { high } else { above.iter().fold(0.0, |high, &value| if value > high { value } else { high }) };
    Ok(if high > 0.0 { FACTOR * f64::from(high) } else { 1.0 })
}

/// The inputs of a run from a dataset, divided by the unit; the dataset itself for the unit 1. Not in the paper.
///
/// These are training projections and densities of initial points; test views and truth are left out.
pub fn in_unit(dataset: &Dataset, unit: f64) -> Cow<'_, Dataset> {
    if unit == 1.0 {
        return Cow::Borrowed(dataset);
    }
    let mut own = dataset.on(dataset.scanner.grid);
    own.train.images.mapv_inplace(|value| (f64::from(value) / unit) as f32);
    if let Some(points) = &mut own.initial_points {
        points.column_mut(3).mapv_inplace(|density| density / unit);
    }
    Cow::Owned(own)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tolerances::relative;
    use trgs_core::geometry::{Beam, Detector, Grid};
    use trgs_scan::simulate::{Object, Plan, simulate};
    use trgs_scan::{Noise, Phantom};

    fn scan(beam: Beam, rows: usize, pitch: f64) -> Dataset {
        let grid = if rows == 1 {
            Grid::new([16, 16, 1], [-1.0, -1.0, -0.05].into(), [1.0, 1.0, 0.05].into())
        } else {
            Ok(Grid::cube(16))
        };
        let detector = Detector { rows, columns: 24, pitch_v: pitch, pitch_u: pitch, offset_u: 0.0, offset_v: 0.0 };
        let scanner = Scanner { beam, detector, grid: grid.unwrap() };
        let plan = Plan { views: 12, test_views: 0, noise: Noise::LOW, seed: 4 };
        simulate("torso", Object::Phantom(&Phantom::by_name("torso", 0).unwrap()), &scanner, &plan).unwrap()
    }

    fn unit(dataset: &Dataset) -> f64 {
        density_unit(&dataset.scanner, &dataset.train).unwrap()
    }

    /// A scan with its projections multiplied by k.
    fn times(dataset: &Dataset, k: f32) -> Dataset {
        let mut dataset = dataset.clone();
        dataset.train.images *= k;
        dataset
    }

    #[test]
    fn it_follows_the_projections_and_is_1_of_nothing() {
        let scan = scan(Beam::Cone { dso: 5.0, dsd: 7.0 }, 24, 0.17);
        let found = unit(&scan);
        for k in [1.0 / 1_073_741_824.0, 1.0 / 64.0, 2.0, 1_048_576.0] {
            assert_eq!(unit(&times(&scan, k as f32)), k * found);
            let divided = in_unit(&times(&scan, k as f32), k * found).into_owned();
            assert_eq!(divided.train, in_unit(&scan, found).train);
        }
        within!(relative(unit(&times(&scan, 0.02)), 0.02 * found));
        let nothing = times(&scan, 0.0);
        let negative = Projections { images: scan.train.images.mapv(|value| -1.0 - value.abs()), ..scan.train.clone() };
        assert_eq!((unit(&nothing), density_unit(&scan.scanner, &negative).unwrap()), (1.0, 1.0));
    }

    #[test]
    fn any_scanner_has_one() {
        let (cone, parallel) = (Beam::Cone { dso: 5.0, dsd: 7.0 }, Beam::Parallel { dso: 5.0 });
        let whole = scan(cone, 24, 0.17);
        let reference = unit(&whole);
        let arc = Dataset { train: whole.train.select(&[0, 1, 2, 3, 4]), ..whole };
        for (what, scan) in [
            ("parallel rays", scan(parallel, 24, 0.13)),
            ("one row", scan(cone, 1, 0.17)),
            ("a detector that is too small", scan(cone, 24, 0.08)),
            ("an arc", arc),
        ] {
            let ratio = unit(&scan) / reference;
            within!(f64::max(ratio, ratio.recip()), "{what}: {ratio}");
        }
    }
}
