use super::*;
use crate::classical::voxel_projector::naive;
use crate::classical::{RayModel, VoxelProjector};
use glam::DVec3;
use std::f64::consts::TAU;
use trgs_core::geometry::{Beam, Detector, Grid, Scanner};
use trgs_scan::{Noise, Phantom};

fn scanner() -> Scanner {
    let detector = Detector { rows: 20, columns: 24, pitch_v: 0.2, pitch_u: 0.2, offset_u: 0.03, offset_v: 0.0 };
    let grid = Grid::new([10, 12, 9], DVec3::new(-0.9, -0.8, -1.0), DVec3::new(0.8, 0.9, 0.9)).unwrap();
    Scanner { beam: Beam::Cone { dso: 4.0, dsd: 6.0 }, detector, grid }
}

fn projector(model: RayModel) -> VoxelProjector {
    VoxelProjector::new(&scanner(), model).unwrap()
}

/// A non-negative volume and its projections.
fn consistent(model: RayModel) -> (Volume, Projections) {
    let grid = scanner().grid;
    let values = Array3::from_shape_fn(grid.shape, |(x, y, z)| ((x * 5 + y * 3 + z * 7) % 11) as f32 / 10.0);
    let angles = Scanner::uniform_angles(30, 0.1, TAU);
    let images = projector(model).forward(&angles, values.mapv(f64::from).view()).unwrap().mapv(|v| v as f32);
    (Volume::new(grid, values).unwrap(), Projections::new(angles, images).unwrap())
}

fn error(a: &Volume, b: &Volume) -> f64 {
    let differences: Vec<f64> = a.values.iter().zip(&b.values).map(|(a, b)| f64::from(a - b)).collect();
    norm(&differences) / (differences.len() as f64).sqrt()
}

/// Runs a reconstruction and records all residuals.
fn watch(run: impl FnOnce(&mut Observe<'_>) -> Result<Volume>) -> (Volume, Vec<f64>) {
    let mut residuals = Vec::new();
    let volume = run(&mut |pass| {
        residuals.push(pass.residual);
        ControlFlow::Continue(())
    });
    (volume.unwrap(), residuals)
}

#[test]
fn consistent_data_are_solved() {
    for model in [RayModel::Joseph, RayModel::Siddon] {
        let (truth, projections) = consistent(model);
        let projector = projector(model);
        let sart = |subset, order| {
            let settings = SartSettings { iterations: 60, reduction: 1.0, subset, order, ..SartSettings::default() };
            watch(|observe| sart::<f64>(&projector, &projections, &settings, observe))
        };
        for (name, (volume, residuals)) in [
            ("SART", sart(1, Order::Input)),
            ("random", sart(1, Order::Random)),
            ("far", sart(1, Order::AngularDistance)),
            ("OS-SART", sart(7, Order::AngularDistance)),
            ("CGLS", watch(|observe| cgls::<f64>(&projector, &projections, 120, observe))),
        ] {
            let (first, last) = (residuals[0], residuals[residuals.len() - 1]);
            within!(last / first, "{model:?} {name}: residual {first} to {last}");
            within!("volume", error(&volume, &truth), "{model:?} {name}: {}", error(&volume, &truth));
        }
    }
}

#[test]
fn a_subset_of_all_views_is_the_formula() {
    let (_, projections) = consistent(RayModel::Siddon);
    let (scanner, relaxation) = (scanner(), 0.7);
    let settings = SartSettings { iterations: 1, relaxation, subset: 30, ..SartSettings::default() };
    let (volume, _) = watch(|observe| sart::<f64>(&projector(RayModel::Siddon), &projections, &settings, observe));
    let (mut sums, mut weights) = (Array3::<f64>::zeros(scanner.grid.shape), Array3::<f64>::zeros(scanner.grid.shape));
    for ((view, row, column), &p) in projections.images.indexed_iter() {
        let ray = scanner.ray(&scanner.view(projections.angles[view]), row, column);
        let entries = naive::weights(RayModel::Siddon, &scanner.grid, &ray);
        let length: f64 = entries.iter().map(|(_, weight)| weight).sum();
        if length > 0.5 * scanner.grid.spacing.min_element() {
            for (voxel, weight) in entries {
                sums[voxel] += weight * f64::from(p) / length;
                weights[voxel] += weight;
            }
        }
    }
    for (voxel, &value) in volume.values.indexed_iter() {
        let expected = if weights[voxel] > 0.0 { relaxation * sums[voxel] / weights[voxel] } else { 0.0 };
        within!((f64::from(value) - expected).abs(), "{voxel:?}: {value} and {expected}");
    }
}

#[test]
fn the_residual_of_cgls_never_grows() {
    let (_, projections) = consistent(RayModel::Joseph);
    let noisy = Noise::HIGH.apply(&projections, 3).unwrap();
    let (_, residuals) = watch(|observe| cgls::<f64>(&projector(RayModel::Joseph), &noisy, 40, observe));
    residuals.windows(2).for_each(|pair| within!(pair[1] / pair[0] - 1.0, "{residuals:?}"));
}

#[test]
fn total_variation_falls_and_noise_with_it() {
    let (scanner, projector) = (scanner(), projector(RayModel::Joseph));
    let phantom = Phantom::by_name("shepp-logan", 0).unwrap();
    let truth = phantom.voxelize(&scanner.grid, 4);
    let clean = phantom.project(&scanner, &Scanner::uniform_angles(12, 0.1, TAU)).unwrap();
    let noisy = Noise::HIGH.apply(&clean, 1).unwrap();
    let settings = AsdPocsSettings { alpha: 0.05, ..AsdPocsSettings::default() };
    let (smooth, _) = watch(|observe| asd_pocs::<f64>(&projector, &noisy, &settings, observe));
    let (rough, _) = watch(|observe| sart::<f64>(&projector, &noisy, &settings.sart, observe));
    let variation = |volume: &Volume| {
        let (values, shape) = (&volume.values, volume.grid.shape);
        let steps = values.indexed_iter().filter(|((x, _, _), _)| x + 1 < shape[0]);
        steps.map(|((x, y, z), v)| f64::from((values[[x + 1, y, z]] - v).abs())).sum::<f64>()
    };
    within!(variation(&smooth) / variation(&rough));
    assert!(error(&smooth, &truth) < error(&rough, &truth), "{} {}", error(&smooth, &truth), error(&rough, &truth));
}

#[test]
fn the_number_of_threads_changes_no_bit() {
    let (_, projections) = consistent(RayModel::Joseph);
    let projector = projector(RayModel::Joseph);
    let run = || {
        let mut observe = |_: &Pass| ControlFlow::Continue(());
        let sart = sart::<f32>(&projector, &projections, &SartSettings::default(), &mut observe).unwrap();
        let pocs = asd_pocs::<f32>(&projector, &projections, &AsdPocsSettings::default(), &mut observe).unwrap();
        (sart, pocs, cgls::<f32>(&projector, &projections, 10, &mut observe).unwrap())
    };
    assert!(threads::install(1, run).unwrap() == threads::install(3, run).unwrap());
}

#[test]
fn relaxation_falls_and_little_progress_ends_the_run() {
    let (_, projections) = consistent(RayModel::Joseph);
    let projector = projector(RayModel::Joseph);
    let run = |settings| watch(|observe| sart::<f64>(&projector, &projections, &settings, observe));
    let base = SartSettings { iterations: 12, ..SartSettings::default() };
    let ((constant, _), (falling, _)) =
        (run(SartSettings { reduction: 1.0, ..base }), run(SartSettings { reduction: 0.5, ..base }));
    assert_ne!(constant, falling);
    let enough = 0.3;
    let (_, short) = run(SartSettings { tolerance: enough, ..base });
    assert!((2..12).contains(&short.len()), "{} passes", short.len());
    let gain = |k: usize| (short[k - 1] - short[k]) / short[k - 1];
    let last = short.len() - 1;
    assert!(gain(last) < enough && (1..last).all(|k| gain(k) >= enough), "{short:?}");
}

#[test]
fn an_observer_can_stop_and_other_projections_are_refused() {
    let (_, mut projections) = consistent(RayModel::Joseph);
    let projector = projector(RayModel::Joseph);
    let mut stop = |pass: &Pass| if pass.iteration == 2 { ControlFlow::Break(()) } else { ControlFlow::Continue(()) };
    let stopped = sart::<f32>(&projector, &projections, &SartSettings::default(), &mut stop).unwrap_err();
    assert!(matches!(stopped, Error::Interrupted { step: 2, .. }), "{stopped}");
    projections.images = Array3::zeros((30, 24, 20));
    let refused = cgls::<f32>(&projector, &projections, 3, &mut stop).unwrap_err();
    assert!(refused.to_string().contains("(30, 20, 24)"), "{refused}");
}
