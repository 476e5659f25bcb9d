//! Projections and densities against 50-digit quadrature, pixel by pixel, skirts included.

mod common;

use common::precision::{VALUE_AGAINST_TRUTH_F32, VALUE_AGAINST_TRUTH_F64};
use common::vectors::cases;
use ndarray::Array3;
use trgs::projector::{self, Projection};

const PROJECTIONS: [(Projection, &str); 2] =
    [(Projection::Exact, "image_exact.npy"), (Projection::Affine, "image_affine.npy")];

/// Largest relative error of any element, with its index.
fn worst_relative(got: &Array3<f64>, truth: &Array3<f64>) -> (f64, (usize, usize, usize)) {
    assert_eq!(got.shape(), truth.shape());
    let mut worst = (0.0, (0, 0, 0));
    for ((index, got), truth) in got.indexed_iter().zip(truth) {
        let error = (got - truth).abs() / truth.abs().max(f64::MIN_POSITIVE);
        if error.is_nan() || error > worst.0 {
            worst = (error, index);
        }
    }
    worst
}

/// Largest error relative to `peak`.
fn worst_of_peak(got: &Array3<f32>, truth: &Array3<f64>, peak: f64) -> f64 {
    got.iter().zip(truth).fold(0.0_f64, |m, (a, b)| m.max((f64::from(*a) - b).abs())) / peak
}

#[test]
fn projections_in_f64_agree_with_quadrature_at_every_pixel() {
    for case in cases() {
        for (projection, file) in PROJECTIONS {
            let image = projector::forward::<f64>(&case.primitives, &case.scanner, &case.angles, projection, 0.0);
            let (error, index) = worst_relative(&image, &case.array(file));
            println!("{} {projection:?}: {error:.2e}", case.id);
            assert!(error <= VALUE_AGAINST_TRUTH_F64, "{} {projection:?}: {error:e} at {index:?}", case.id);
        }
    }
}

#[test]
fn densities_in_f64_agree_with_the_truth_at_every_voxel() {
    for case in cases() {
        let volume = projector::voxelize::<f64>(&case.primitives, &case.scanner.grid, 0.0);
        let (error, index) = worst_relative(&volume, &case.array("volume.npy"));
        println!("{}: {error:.2e}", case.id);
        assert!(error <= VALUE_AGAINST_TRUTH_F64, "{}: {error:e} at {index:?}", case.id);
    }
}

#[test]
fn projections_and_densities_in_f32_agree_to_a_millionth_of_the_peak() {
    for case in cases() {
        for (projection, file) in PROJECTIONS {
            let image = projector::forward::<f32>(&case.primitives, &case.scanner, &case.angles, projection, 0.0);
            let truth = case.array(file);
            let error = worst_of_peak(&image, &truth, truth.iter().fold(0.0_f64, |m, x| m.max(x.abs())));
            println!("{} {projection:?}: {error:.2e}", case.id);
            assert!(error <= VALUE_AGAINST_TRUTH_F32, "{} {projection:?}: {error:e}", case.id);
        }
        let volume = projector::voxelize::<f32>(&case.primitives, &case.scanner.grid, 0.0);
        // The peak of a field lies at a primitive's centre, which a coarse grid can miss by far.
        let peak = case.primitives.parameters.density.iter().fold(0.0_f64, |m, x| m.max(x.abs()));
        let error = worst_of_peak(&volume, &case.array("volume.npy"), peak);
        println!("{} volume: {error:.2e}", case.id);
        assert!(error <= VALUE_AGAINST_TRUTH_F32, "{} volume: {error:e}", case.id);
    }
}
