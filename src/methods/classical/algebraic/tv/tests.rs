use super::*;
use crate::classical::RayModel;
use crate::classical::algebraic::proximal::Proximal;
use crate::classical::algebraic::slabs::Slabs;
use crate::classical::algebraic::space::Part;
use crate::classical::algebraic::{Division, Name, VoxelRun};
use crate::tolerances::largest;
use glam::DVec3;
use ndarray::Array3;
use std::f64::consts::TAU;
use std::ops::ControlFlow;
use trgs_core::geometry::{Beam, Detector, Grid, Scanner};
use trgs_core::numeric::threads;

fn scanner(shape: [usize; 3]) -> Scanner {
    let rows = if shape[2] == 1 { 1 } else { 9 };
    let detector = Detector { rows, columns: 14, pitch_v: 0.3, pitch_u: 0.25, offset_u: 0.03, offset_v: 0.0 };
    let half = if shape[2] == 1 { 0.1 } else { 0.9 };
    let grid = Grid::new(shape, DVec3::new(-0.9, -0.8, -half), DVec3::new(0.8, 0.9, half)).unwrap();
    Scanner { beam: Beam::Cone { dso: 4.0, dsd: 6.0 }, detector, grid }
}

/// Noisy projections of a block in a box, times `unit`.
fn scan(shape: [usize; 3], unit: f32) -> (VoxelProjector, Projections) {
    scan_of(shape, unit, 7)
}

fn scan_of(shape: [usize; 3], unit: f32, views: usize) -> (VoxelProjector, Projections) {
    let projector = VoxelProjector::new(&scanner(shape), RayModel::Joseph).unwrap();
    let inside = |i: usize, n: usize| 4 * i >= n && 4 * i < 3 * n || n == 1;
    let block = |(x, y, z)| if inside(x, shape[0]) && inside(y, shape[1]) && inside(z, shape[2]) { 1.0 } else { 0.1 };
    let values = Array3::from_shape_fn(shape, block);
    let angles = Scanner::uniform_angles(views, 0.1, TAU);
    let mut images: Array3<f64> = projector.forward(&angles, values.view()).unwrap();
    images.iter_mut().enumerate().for_each(|(i, value)| *value += ((i * 37) % 23) as f64 / 230.0 - 0.05);
    let images = images.mapv(|value| unit * value as f32);
    (projector, Projections::new(angles, images).unwrap())
}

const SHAPE: [usize; 3] = [7, 8, 6];

fn settings(iterations: usize) -> TvSettings {
    TvSettings { weight: 3e-3, iterations, tolerance: 0.0, steps: 10 }
}

fn run<R: Real>(scan: &(VoxelProjector, Projections), settings: &TvSettings) -> (Volume, Vec<Pass>) {
    let mut passes = Vec::new();
    let mut observe = |pass: &Pass| {
        passes.push(pass.clone());
        ControlFlow::Continue(())
    };
    let volume = tv::<R>(&scan.0, &scan.1, settings, None, &mut observe).unwrap();
    (volume, passes)
}

/// `D x` along an axis and its transpose, written as plainly as possible.
fn differences(grid: &Grid, x: &Array3<f64>, axis: usize) -> Array3<f64> {
    let weight = grid.spacing.min_element() / grid.spacing[axis];
    Array3::from_shape_fn(x.dim(), |(i, j, k)| {
        let mut next = [i, j, k];
        next[axis] += 1;
        x.get(next).map_or(0.0, |value| weight * (value - x[[i, j, k]]))
    })
}

fn transposed(grid: &Grid, q: &Array3<f64>, axis: usize) -> Array3<f64> {
    let weight = grid.spacing.min_element() / grid.spacing[axis];
    let n = q.shape()[axis];
    Array3::from_shape_fn(q.dim(), |(i, j, k)| {
        let at = [i, j, k];
        let mut before = at;
        before[axis] = before[axis].wrapping_sub(1);
        let below = if at[axis] > 0 { q[before] } else { 0.0 };
        weight * (below - if at[axis] + 1 < n { q[at] } else { 0.0 })
    })
}

fn cut(q: &mut [Array3<f64>; 3], limit: f64) {
    for i in 0..q[0].len() {
        let values: Vec<f64> = q.iter().map(|q| q.as_slice().unwrap()[i]).collect();
        let length = values.iter().map(|value| value * value).sum::<f64>().sqrt();
        q.iter_mut().for_each(|q| q.as_slice_mut().unwrap()[i] /= (length / limit).max(1.0));
    }
}

#[test]
fn the_step_of_total_variation_is_the_plain_one() {
    for shape in [SHAPE, [20, 5, 1], [3, 4, 37], [37, 4, 3]] {
        let grid = scanner(shape).grid;
        let z = Array3::from_shape_fn(shape, |(x, y, z)| ((x * 5 + y * 3 + z * 7) % 11) as f64 / 5.0 - 0.6);
        let tau = 0.13;
        let mut q = [0, 1, 2].map(|_| Array3::<f64>::zeros(shape));
        let primal = |q: &[Array3<f64>; 3]| {
            let adjoint = (0..3).fold(Array3::<f64>::zeros(shape), |sum, axis| sum + transposed(&grid, &q[axis], axis));
            (&z - &(adjoint * tau)).mapv(|value: f64| value.max(0.0))
        };
        for _ in 0..6000 {
            let x = primal(&q);
            (0..3).for_each(|axis| q[axis] = &q[axis] + &(differences(&grid, &x, axis) / (12.0 * tau)));
            cut(&mut q, 1.0);
        }
        let plain = primal(&q);
        let mut proximal = Proximal::<f64>::new(&grid);
        let mut solved = |steps: usize| {
            let mut x = z.clone().into_raw_vec_and_offset().0;
            proximal.solve(&mut x, tau, steps);
            x
        };
        let found = solved(1500);
        let worst = found.iter().zip(&plain).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        within!(worst, "{shape:?}: {worst}");
        let lengths = [0, 1, 2].map(|axis| differences(&grid, &plain, axis));
        let square = |i: usize| lengths.iter().map(|d| d.as_slice().unwrap()[i]).map(|d| d * d).sum::<f64>();
        let variation: f64 = (0..plain.len()).map(|i| square(i).sqrt()).sum();
        let none: &[f64] = &[];
        let volumes = [plain.as_slice().unwrap(), none, none];
        let projector = VoxelProjector::new(&scanner(shape), RayModel::Joseph).unwrap();
        let terms = Part::new(&projector, 0..shape[0]).unwrap().measure(Measure::Variation(Name::Volume), volumes);
        let fast: f64 = terms.iter().map(|term| term[0]).sum();
        within!("norm", (fast - variation).abs() / variation, "{shape:?}: {fast}, {variation}");
        // A second call continues from the first one's dual.
        let found = solved(1);
        let worst = found.iter().zip(&plain).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        within!(worst, "{shape:?}: {worst}");
    }
}

/// Compares with the primal-dual method of Chambolle and Pock, which has the same minimum.
#[test]
fn the_least_objective_is_found() {
    let scan = scan(SHAPE, 1.0);
    let (volume, passes) = run::<f64>(&scan, &settings(1500));
    let found = passes.last().unwrap().objective.unwrap();
    let (projector, projections) = &scan;
    let (grid, angles) = (projector.scanner().grid, &projections.angles);
    // Rays that intersect less than half a voxel are ignored.
    let lengths = projector.forward(angles, Array3::<f64>::ones(SHAPE).view()).unwrap();
    let least = 0.5 * grid.spacing.min_element();
    let counts = lengths.mapv(|length| if length > least { 1.0 } else { 0.0 });
    let measured = projections.images.mapv(f64::from) * &counts;
    let forward = |x: &Array3<f64>| projector.forward(angles, x.view()).unwrap() * &counts;
    let back = projector.adjoint(angles, measured.view()).unwrap();
    let lambda = 3e-3 * back.iter().fold(0.0_f64, |largest, value| largest.max(value.abs()));
    let objective = |x: &Array3<f64>| {
        let misfit = forward(x) - &measured;
        let d = [0, 1, 2].map(|axis| differences(&grid, x, axis));
        let length = |i: usize| d.iter().map(|d| d.as_slice().unwrap()[i]).map(|d| d * d).sum::<f64>().sqrt();
        0.5 * misfit.mapv(|value| value * value).sum() + lambda * (0..x.len()).map(length).sum::<f64>()
    };
    let (mut x, mut u) = (Array3::<f64>::zeros(SHAPE), Array3::<f64>::zeros(measured.dim()));
    let (mut ahead, mut q) = (x.clone(), [0, 1, 2].map(|_| Array3::<f64>::zeros(SHAPE)));
    let step = 1.0
        / (TvRun::<f64>::new(projector, projections, &settings(1), None, &Division::whole()).unwrap().lipschitz + 12.0)
            .sqrt();
    for _ in 0..12_000 {
        u = (u + step * (forward(&ahead) - &measured)) / (1.0 + step);
        (0..3).for_each(|axis| q[axis] = &q[axis] + &(step * differences(&grid, &ahead, axis)));
        cut(&mut q, lambda);
        let adjoint = (0..3)
            .fold(projector.adjoint(angles, u.view()).unwrap(), |sum, axis| sum + transposed(&grid, &q[axis], axis));
        let next = (&x - step * adjoint).mapv(|value| value.max(0.0));
        ahead = 2.0 * &next - &x;
        x = next;
    }
    let least = objective(&x);
    within!((found / least - 1.0).abs(), "{found}, {least}");
    within!("volume", largest(volume.values.iter().zip(&x).map(|(a, b)| f64::from(*a) - b)));
    let objectives: Vec<f64> = passes.iter().filter_map(|pass| pass.objective).collect();
    assert!(objectives.len() > 1400 && objectives.is_sorted_by(|a, b| b <= a), "it grew");
}

#[test]
fn a_solution_is_a_fixed_point() {
    let scan = scan(SHAPE, 1.0);
    let (solution, _) = run::<f64>(&scan, &settings(1500));
    let settings = settings(60);
    let mut last = f64::INFINITY;
    let mut observe = |pass: &Pass| {
        last = pass.change.unwrap();
        ControlFlow::Continue(())
    };
    let again = tv::<f64>(&scan.0, &scan.1, &settings, Some(&solution), &mut observe).unwrap();
    let worst = again.values.iter().zip(&solution.values).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
    within!("volume", worst);
    within!("last step", last);
}

#[test]
fn powers_of_two_change_no_bit() {
    for unit in [1.0 / 64.0, 1024.0] {
        let (one, other) =
            (run::<f32>(&scan(SHAPE, 1.0), &settings(40)), run::<f32>(&scan(SHAPE, unit), &settings(40)));
        assert_eq!(one.0.values.mapv(|value| value * unit), other.0.values);
    }
    let (one, other) = (run::<f64>(&scan(SHAPE, 1.0), &settings(40)), run::<f64>(&scan(SHAPE, 0.3), &settings(40)));
    within!(largest(one.0.values.iter().zip(&other.0.values).map(|(a, b)| 0.3 * a - b)));
}

#[test]
fn the_number_of_threads_changes_no_bit_and_single_precision_little() {
    let scan = scan(SHAPE, 1.0);
    let one = threads::install(1, || run::<f32>(&scan, &settings(30)).0).unwrap();
    assert!(one == threads::install(3, || run::<f32>(&scan, &settings(30)).0).unwrap());
    let double = run::<f64>(&scan, &settings(30)).0;
    let worst = one.values.iter().zip(&double.values).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
    within!(worst, "{worst}");
}

#[test]
fn a_resumed_run_ends_with_the_same_bits() {
    for shape in [SHAPE, [16, 17, 1]] {
        let scan = scan(shape, 1.0);
        let settings = settings(25);
        let (whole, passes) = run::<f32>(&scan, &settings);
        let mut first = TvRun::<f32>::new(&scan.0, &scan.1, &settings, None, &Division::whole()).unwrap();
        for _ in 0..11 {
            first.step().unwrap();
        }
        let state = first.state();
        assert_eq!(state.iteration(), 11);
        let mut second = TvRun::<f32>::resume(&scan.0, &scan.1, &settings, &state, &Division::whole()).unwrap();
        while !second.is_finished() {
            let pass = second.step().unwrap();
            assert_eq!(pass, passes[pass.iteration - 1]);
        }
        assert!(second.volume().unwrap() == whole, "{shape:?}");
    }
}

#[test]
fn one_row_and_no_data_are_reconstructed() {
    let (volume, passes) = run::<f32>(&scan([16, 17, 1], 1.0), &settings(200));
    within!("residual", passes[199].residual / passes[0].residual);
    beyond!("inside", volume.values[[8, 8, 0]]);
    within!("outside", volume.values[[1, 1, 0]]);
    let (volume, _) = run::<f32>(&scan(SHAPE, 0.0), &settings(3));
    assert!(volume.values.iter().all(|&value| value == 0.0));
}

#[test]
fn sweeps_get_further_than_as_many_iterations_over_all_views() {
    let (projector, projections) = scan(SHAPE, 1.0);
    let zeros = Volume::new(projector.scanner().grid, Array3::zeros(SHAPE)).unwrap();
    let mut sweeping = TvRun::<f64>::new(&projector, &projections, &settings(6), None, &Division::whole()).unwrap();
    let mut whole =
        TvRun::<f64>::new(&projector, &projections, &settings(6), Some(&zeros), &Division::whole()).unwrap();
    // Of seven views three and four.
    assert_eq!((sweeping.sets, whole.sets), (2, 1));
    let before = whole.objective();
    for run in [&mut sweeping, &mut whole] {
        for _ in 0..6 {
            run.step().unwrap();
        }
    }
    sweeping.begin_whole().unwrap();
    let [fast, slow] = [&sweeping, &whole].map(TvRun::objective);
    assert!(fast < slow && slow < before, "{fast}, {slow}, {before}");
}

#[test]
fn every_number_of_sets_has_two_sweeps() {
    let (projector, projections) = scan_of(SHAPE, 1.0, 24);
    let settings = TvSettings { weight: 0.1, ..settings(40) };
    let mut run = TvRun::<f64>::new(&projector, &projections, &settings, None, &Division::whole()).unwrap();
    let mut after = || {
        run.step().unwrap();
        run.sets
    };
    let sets: Vec<usize> = (0..40).map(|_| after()).collect();
    assert_eq!([sets[0], sets[39]], [8, 1]);
    assert!(sets.windows(3).all(|sets| sets[1] < 2 || sets[0] == sets[1] || sets[1] == sets[2]), "{sets:?}");
}

#[test]
fn slabs_have_the_bits_of_whole_volumes() {
    let folder = std::env::temp_dir();
    for shape in [SHAPE, [20, 5, 1], [30, 4, 5]] {
        let scan = scan(shape, 1.0);
        let (projector, projections) = &scan;
        // Sweeps first, then iterations over all views with many steps of the dual.
        for settings in [settings(12), TvSettings { steps: 2, weight: 0.02, ..settings(12) }] {
            let (whole, passes) = run::<f32>(&scan, &settings);
            for count in [1, 2, 3, 7] {
                let views = projector.views(projections.trajectory()).unwrap();
                let slabs = Box::new(Slabs::<f32>::new(projector, views, count, &folder).unwrap());
                let mut run = TvRun::<f32>::in_space(projector, projections, &settings, None, slabs).unwrap();
                let found: Vec<Pass> = (0..12).map(|_| run.step().unwrap()).collect();
                assert_eq!(found, passes, "{count} slabs");
                let volume = run.volume().unwrap();
                let bits = |volume: &Volume| volume.values.iter().map(|value| value.to_bits()).collect::<Vec<_>>();
                assert!(bits(&volume) == bits(&whole), "{count} slabs");
            }
        }
    }
}

#[test]
fn memory_of_slabs_is_used_again() {
    let (projector, projections) = scan(SHAPE, 1.0);
    let views = projector.views(projections.trajectory()).unwrap();
    let mut slabs = Slabs::<f32>::new(&projector, views, 3, &std::env::temp_dir()).unwrap();
    for name in [None, Some(Name::Volume)].repeat(4) {
        for change in [Change::Forget, Change::Fill(Name::Next, 1.0), Change::Extrapolate(0.5)] {
            slabs.change(change).unwrap();
        }
        let images = slabs.project(&[0, 3], name).unwrap();
        slabs.adjoin(&[0, 3], &images, Name::Next, Some(0.1)).unwrap();
        slabs.solve(0.1, 2).unwrap();
        slabs.measure(Measure::Step(0.5)).unwrap();
    }
    // A step has four arrays at a time.
    assert_eq!(slabs.spare.len(), 4);
}
