//! A pseudo truth for a measured scan, whose true volume is unknown.
//!
//! The paper and R²-Gaussian reconstruct measured objects from all of their views, some 700, by FDK, and take the
//! result as the truth when few of these views are used. It has artefacts and noise of its own, which a method better
//! than FDK cannot reproduce: metrics against it compare methods, they do not measure the distance from the object.
//!
//! Projections must be line integrals, `ln(I₀/I)` for photon counts I and I₀ without an object, and lengths must have
//! one unit. R²-Gaussian's own scripts divide the stored values of its three measured scans by 400 and multiply them by
//! 50, as all lengths: this only chooses the unit of length, so that densities lie about 0 to 1.

use super::fdk::{Turn, Window, fdk};
use trgs_core::error::Result;
use trgs_core::geometry::Volume;
use trgs_scan::{Dataset, limit};

/// The dataset with FDK of all its training views, without negative values, as the truth `[FDK84]`.
///
/// A note in the dataset says so. Not in the paper: it says that pseudo truths are made so, but not how FDK is set.
/// Here it uses the plain ramp filter and the weights that the views require ([`Turn::Measured`]).
///
/// # Errors
/// Those of [`fdk`].
///
/// Tests: `the_pseudo_truth_is_fdk_without_negative_values`.
pub fn with_pseudo_truth(dataset: Dataset) -> Result<Dataset> {
    let shape = dataset.scanner.grid.shape;
    limit::allow_array("true volume", &shape, size_of::<f32>()).map_err(|error| error.or_instead("fewer voxels"))?;
    let mut volume: Volume = fdk(&dataset.scanner, &dataset.train, Window::RamLak, Turn::Measured)?;
    volume.values.mapv_inplace(|density| if density < 0.0 { 0.0 } else { density });
    let note = format!(
        "the true volume is a pseudo truth: FDK of all {} views, negative values set to 0; nobody knows the object itself",
        dataset.train.len()
    );
    let notes = dataset.notes.into_iter().chain([note]).collect();
    Ok(Dataset { truth: Some(volume), notes, ..dataset })
}

#[cfg(test)]
mod tests {
    use super::*;
    use trgs_core::geometry::{Beam, Detector, Grid, Scanner};
    use trgs_scan::Noise;
    use trgs_scan::phantom::Phantom;
    use trgs_scan::simulate::{Object, Plan, simulate};

    #[test]
    fn the_pseudo_truth_is_fdk_without_negative_values() {
        let detector = Detector { rows: 24, columns: 30, pitch_v: 0.15, pitch_u: 0.13, offset_u: 0.0, offset_v: 0.1 };
        let grid = Grid::new([16, 14, 12], [-1.0, -0.9, -0.7].into(), [1.0, 0.8, 0.8].into()).unwrap();
        let scanner = Scanner { beam: Beam::Cone { dso: 5.0, dsd: 7.0 }, detector, grid };
        let plan = Plan { views: 40, test_views: 3, noise: Noise::HIGH, seed: 2 };
        let phantom = Phantom::by_name("axes", 0).unwrap();
        let scan = simulate("axes", Object::Phantom(&phantom), &scanner, &plan).unwrap();
        let plain = fdk(&scanner, &scan.train, Window::default(), Turn::default()).unwrap();
        let scan = with_pseudo_truth(scan.clone()).unwrap();
        let truth = scan.truth.unwrap();
        assert_eq!(truth.grid, scanner.grid);
        let mut clipped = 0;
        for (truth, plain) in truth.values.iter().zip(&plain.values) {
            assert_eq!(truth.to_bits(), plain.max(0.0).to_bits());
            clipped += usize::from(*plain < 0.0);
        }
        assert!(clipped > 100, "only {clipped} negative voxels");
        assert!(scan.notes.concat().contains("pseudo truth: FDK of all 40 views"), "{:?}", scan.notes);
    }
}
