//! The wavelet loss as in training: from the voxels of a block to every parameter of the primitives.

use crate::common::scenes;
use glam::DVec3;
use trgs::geometry::Grid;
use trgs::numeric::threads;
use trgs::primitives::{Group, KernelKind, Parameters, Primitives};
use trgs::projector::Field;
use trgs::wavelet::{Routing, Settings, route, wavelet_loss};

/// Step of a difference, relative to the parameter's size.
const STEP: f64 = 5e-6;

/// An off-centre block with voxels of three different side lengths.
fn block() -> Grid {
    Grid::new([8, 6, 10], DVec3::new(-0.3, -0.55, -0.2), DVec3::new(0.5, 0.35, 0.65)).unwrap()
}

fn settings(levels: usize) -> Settings {
    // Equal weights would hide an exchange of the two.
    Settings { neighbours: 3, suppress: 0.8, enhance: 0.3, levels, ..Settings::default() }
}

fn routing(primitives: &Primitives, grid: &Grid) -> Routing {
    let confidence = scenes::uniform(5, primitives.len(), 0.0, 0.9);
    route(grid, &primitives.parameters.mean, &confidence, &settings(1)).unwrap()
}

fn value_and_gradient(
    primitives: &Primitives,
    grid: &Grid,
    routing: &Routing,
    settings: &Settings,
) -> (f64, Parameters) {
    let field = Field::<f64>::new(primitives, 0.0);
    let loss = wavelet_loss(field.voxels(grid).view(), routing, settings);
    let mut gradient = field.zero_gradient();
    field.on(grid).vjp(loss.gradient.view(), &mut gradient);
    (loss.value, field.parameter_gradient(&gradient))
}

#[test]
fn gradients_through_the_field_match_central_differences_for_every_parameter() {
    for (kernel, levels, shape) in [(KernelKind::StudentT, 1, [8, 6, 10]), (KernelKind::Gaussian, 2, [8, 4, 12])] {
        let (primitives, grid) = (scenes::primitives(kernel, 12, 31), Grid { shape, ..block() });
        let (routing, settings) = (routing(&primitives, &grid), settings(levels));
        let shares = (0..=3).filter(|n| routing.high.iter().any(|h| h == n)).count();
        assert!(shares >= 3, "{shares} shares of confident neighbours");
        let (_, gradient) = value_and_gradient(&primitives, &grid, &routing, &settings);
        for group in Group::ALL.into_iter().filter(|group| kernel == KernelKind::StudentT || *group != Group::Nu) {
            let (mut error, mut size) = (0.0, 0.0);
            for (i, analytic) in gradient.group(group).iter().enumerate() {
                let at = primitives.parameters.group(group)[i];
                let step = STEP * if group == Group::Mean { 0.1 } else { at.abs().max(0.01) };
                let moved = |by: f64| {
                    let mut moved = primitives.clone();
                    moved.parameters.group_mut(group)[i] += by;
                    value_and_gradient(&moved, &grid, &routing, &settings).0
                };
                let difference = (moved(step) - moved(-step)) / (2.0 * step);
                error += (analytic - difference) * (analytic - difference);
                size += analytic * analytic;
            }
            let error = (error / size).sqrt();
            within!(error, "{kernel:?} {}", group.key());
        }
    }
}

#[test]
fn the_chain_has_the_same_bits_on_any_number_of_threads() {
    let primitives = scenes::primitives(KernelKind::StudentT, 200, 32);
    let run = || {
        let routing = routing(&primitives, &block());
        value_and_gradient(&primitives, &block(), &routing, &settings(1))
    };
    let alone = threads::install(1, run).unwrap();
    for count in [2, 3, 7] {
        let found = threads::install(count, run).unwrap();
        assert_eq!(found.0.to_bits(), alone.0.to_bits(), "{count} threads");
        assert_eq!(found.1, alone.1, "{count} threads");
    }
}
