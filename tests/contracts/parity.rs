//! The fast path against the naive twin: every kernel, projection and beam, with and without a cutoff.

use crate::common::scenes;
use crate::tolerances::largest;
use ndarray::Array3;
use trgs::geometry::Scanner;
use trgs::primitives::{Group, KernelKind, Parameters, Primitives};
use trgs::projector::{self, Projection, naive};

const ANGLES: [f64; 3] = [0.3, 2.1, 4.4];

fn combinations() -> Vec<(KernelKind, Projection, Scanner)> {
    let mut all = Vec::new();
    for kernel in [KernelKind::StudentT, KernelKind::Gaussian] {
        for projection in [Projection::Exact, Projection::Affine] {
            all.extend([(kernel, projection, scenes::cone()), (kernel, projection, scenes::parallel())]);
        }
    }
    all
}

fn worst(fast: &Array3<f64>, naive: &Array3<f64>) -> f64 {
    let peak = naive.iter().fold(0.0_f64, |m, x| m.max(x.abs()));
    fast.iter().zip(naive).fold(0.0_f64, |m, (a, b)| m.max((a - b).abs())) / peak
}

fn assert_gradients_agree(fast: &Parameters, naive: &Parameters, what: &str) {
    for group in Group::ALL {
        let peak = naive.group(group).iter().fold(f64::MIN_POSITIVE, |m, x| m.max(x.abs()));
        for (i, (a, b)) in fast.group(group).iter().zip(naive.group(group)).enumerate() {
            let error = (a - b).abs() / peak;
            within!(error, "{what}, {} {i}: {a:e} against {b:e}, peak {peak:e}", group.key());
        }
    }
}

#[test]
fn images_agree_with_the_naive_twin() {
    for (kernel, projection, scanner) in combinations() {
        let primitives = scenes::primitives(kernel, 9, 1);
        let fast = projector::forward::<f64>(&primitives, &scanner, &ANGLES, projection, 0.0);
        let naive = naive::forward(&primitives, &scanner, &ANGLES, projection, 0.0);
        let error = worst(&fast, &naive);
        within!(error, "{kernel:?} {projection:?} {:?}", scanner.beam);
    }
}

#[test]
fn image_gradients_agree_with_the_naive_twin() {
    for (kernel, projection, scanner) in combinations() {
        let primitives = scenes::primitives(kernel, 9, 2);
        let cotangent = scenes::cotangent(7, (ANGLES.len(), scanner.detector.rows, scanner.detector.columns));
        let fast = projector::vjp::<f64>(&primitives, &scanner, &ANGLES, projection, 0.0, cotangent.view());
        let naive = naive::vjp(&primitives, &scanner, &ANGLES, projection, 0.0, cotangent.view());
        assert_gradients_agree(&fast, &naive, &format!("{kernel:?} {projection:?} {:?}", scanner.beam));
    }
}

#[test]
fn volumes_and_their_gradients_agree_with_the_naive_twin() {
    for kernel in [KernelKind::StudentT, KernelKind::Gaussian] {
        let (primitives, grid) = (scenes::primitives(kernel, 9, 3), scenes::cone().grid);
        let error =
            worst(&projector::voxelize::<f64>(&primitives, &grid, 0.0), &naive::voxelize(&primitives, &grid, 0.0));
        within!(error, "{kernel:?}");
        let cotangent = scenes::cotangent(8, grid.shape);
        let fast = projector::voxelize_vjp::<f64>(&primitives, &grid, 0.0, cotangent.view());
        let naive = naive::voxelize_vjp(&primitives, &grid, 0.0, cotangent.view());
        assert_gradients_agree(&fast, &naive, &format!("{kernel:?}"));
    }
}

/// A cutoff is defined by the ellipsoid, not by tiles: both paths leave out the same pixels and voxels.
#[test]
fn the_cutoff_leaves_out_the_same_pixels_and_voxels_as_the_naive_twin() {
    for (kernel, projection, scanner) in combinations() {
        let primitives = scenes::primitives(kernel, 40, 4);
        let fast = projector::forward::<f64>(&primitives, &scanner, &ANGLES, projection, 1e-2);
        let naive = naive::forward(&primitives, &scanner, &ANGLES, projection, 1e-2);
        let whole = naive::forward(&primitives, &scanner, &ANGLES, projection, 0.0);
        let seen = naive.iter().zip(&whole).filter(|(_, whole)| **whole > 0.0);
        beyond!(
            "cut",
            largest(seen.map(|(cut, whole)| 1.0 - cut / whole)),
            "{kernel:?} {projection:?} {:?}: the cutoff cuts nothing",
            scanner.beam
        );
        let error = worst(&fast, &naive);
        within!(error, "{kernel:?} {projection:?} {:?}", scanner.beam);
        let error = worst(
            &projector::voxelize::<f64>(&primitives, &scanner.grid, 1e-2),
            &naive::voxelize(&primitives, &scanner.grid, 1e-2),
        );
        within!(error, "{kernel:?} volume");
    }
}

#[test]
fn what_the_cutoff_drops_is_within_its_reported_bound() {
    for (kernel, projection, scanner) in combinations() {
        let primitives = scenes::primitives(kernel, 40, 5);
        let field = projector::Field::<f64>::new(&primitives, 1e-2);
        for angle in ANGLES {
            let view = field.view(&scanner, angle, projection);
            let (cut, bound) = (view.image(), view.truncation_bound());
            let whole = projector::forward::<f64>(&primitives, &scanner, &[angle], projection, 0.0);
            let mut tightest = f64::INFINITY;
            for ((index, cut), bound) in cut.indexed_iter().zip(&bound) {
                let dropped = whole[[0, index.0, index.1]] - cut;
                let what = format!("{kernel:?} {projection:?} at {index:?}: dropped {dropped:e}, bound {bound:e}");
                within!(dropped - bound, "{what}");
                if dropped > 1e-9 {
                    tightest = tightest.min(bound / dropped);
                }
            }
            assert!(tightest < 100.0, "a bound that is never within a factor of 100 tells nothing: {tightest}");
        }
    }
}

#[test]
fn primitives_behind_the_source_are_no_part_of_the_bound() {
    let mut primitives = scenes::primitives(KernelKind::StudentT, 2, 6);
    primitives.parameters.mean[1] = [6.0, 2.0, 0.1];
    let bound = |primitives: &Primitives| {
        let field = projector::Field::<f64>::new(primitives, 1e-2);
        field.view(&scenes::cone(), 0.0, Projection::Exact).truncation_bound()
    };
    let both = bound(&primitives);
    primitives.parameters.density[1] = 0.0;
    assert_eq!(both, bound(&primitives));
    assert!(both.iter().any(|b| *b == 0.0) && both.iter().any(|b| *b > 0.0), "the other one counts");
}

#[test]
fn primitives_behind_the_source_are_left_out_by_both() {
    let mut primitives = scenes::primitives(KernelKind::StudentT, 3, 6);
    primitives.parameters.mean[1] = [6.0, 2.0, 0.1];
    primitives.parameters.mean[2] = [5.0, 0.0, 0.0];
    let fast = projector::forward::<f64>(&primitives, &scenes::cone(), &[0.0], Projection::Exact, 0.0);
    let naive = naive::forward(&primitives, &scenes::cone(), &[0.0], Projection::Exact, 0.0);
    within!(worst(&fast, &naive));
    let alone = {
        primitives.parameters.density[1] = 0.0;
        primitives.parameters.density[2] = 0.0;
        projector::forward::<f64>(&primitives, &scenes::cone(), &[0.0], Projection::Exact, 0.0)
    };
    assert_eq!(fast, alone);
}
