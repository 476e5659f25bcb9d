use super::*;
use glam::DVec3;
use ndarray::Axis;
use trgs_core::geometry::{Beam, Detector, Deviation, Grid};
use trgs_core::numeric::reduce;
use trgs_scan::phantom::solid::{Shape, Solid};
use trgs_scan::simulate::{Object, Orbit, Plan, simulate_measured, simulate_on};
use trgs_scan::{Chain, Noise};

const MODELS: [RayModel; 2] = [RayModel::Joseph, RayModel::Siddon];

/// Off-centre, anisotropic, with a shifted non-square detector and rays above the volume.
fn scanner(beam: Beam) -> Scanner {
    let detector = Detector { rows: 37, columns: 22, pitch_v: 0.11, pitch_u: 0.17, offset_u: 0.13, offset_v: -0.07 };
    let grid = Grid::new([11, 14, 9], DVec3::new(-0.8, -0.9, -1.0), DVec3::new(0.95, 0.7, 0.9)).unwrap();
    Scanner { beam, detector, grid }
}

/// Cone, parallel, a cone so close that its outer rays are steep, and one row through one slice.
fn scanners() -> [Scanner; 4] {
    let mut flat = scanner(Beam::Cone { dso: 4.0, dsd: 6.0 });
    flat.detector = Detector { rows: 1, columns: 150, pitch_u: 0.023, offset_v: 0.01, ..flat.detector };
    flat.grid = Grid::new([23, 19, 1], DVec3::new(-0.8, -0.9, -0.04), DVec3::new(0.95, 0.7, 0.05)).unwrap();
    let mut close = scanner(Beam::Cone { dso: 1.6, dsd: 2.2 });
    (close.detector.pitch_v, close.grid.spacing.z) = (0.16, 0.1);
    [scanner(Beam::Cone { dso: 4.0, dsd: 6.0 }), scanner(Beam::Parallel { dso: 4.0 }), close, flat]
}

/// Includes multiples of a right angle, where rays run along planes of voxels.
const ANGLES: [f64; 5] = [0.3, 0.0, 2.1, std::f64::consts::FRAC_PI_2, 5.0];

fn noise(n: usize, salt: u64) -> Vec<f64> {
    (0..n as u64).map(|i| ((i * 2_654_435_761 + salt * 40_503) % 10_007) as f64 / 5003.5 - 1.0).collect()
}

fn volume(scanner: &Scanner) -> Array3<f64> {
    Array3::from_shape_vec(scanner.grid.shape, noise(scanner.grid.voxels(), 1)).unwrap()
}

fn images(scanner: &Scanner) -> Array3<f64> {
    let shape = (ANGLES.len(), scanner.detector.rows, scanner.detector.columns);
    Array3::from_shape_vec(shape, noise(shape.0 * shape.1 * shape.2, 2)).unwrap()
}

fn dot(a: &Array3<f64>, b: &Array3<f64>) -> f64 {
    let (a, b) = (a.as_slice().unwrap(), b.as_slice().unwrap());
    reduce::sum_by(a.len(), &|i| a[i] * b[i])
}

#[test]
fn fast_rays_are_the_naive_ones() {
    for (number, scanner) in scanners().into_iter().enumerate() {
        for model in MODELS {
            let volume = volume(&scanner);
            let fast = VoxelProjector::new(&scanner, model).unwrap().forward(&ANGLES, volume.view()).unwrap();
            let (mut hit, mut steep) = (0, 0);
            for ((view, row, column), &value) in fast.indexed_iter() {
                let ray = scanner.ray(&scanner.view(ANGLES[view]), row, column);
                let weights = naive::weights(model, &scanner.grid, &ray);
                let plain: f64 = weights.iter().map(|&(voxel, weight)| weight * volume[voxel]).sum();
                hit += usize::from(!weights.is_empty());
                let per_voxel = (ray.direction / scanner.grid.spacing).abs();
                steep += usize::from(!weights.is_empty() && per_voxel.z > per_voxel.x.max(per_voxel.y));
                within!((value - plain).abs(), "{number} {model:?} {view} {row} {column}: {value}, {plain}");
            }
            assert!(hit > 500 && (steep > 20) == (number == 2), "{number}: {hit} rays, {steep} steep");
        }
    }
}

#[test]
fn the_adjoint_is_the_transpose() {
    for scanner in scanners() {
        for model in MODELS {
            let projector = VoxelProjector::new(&scanner, model).unwrap();
            let (x, y) = (volume(&scanner), images(&scanner));
            let forward = projector.forward(&ANGLES, x.view()).unwrap();
            let adjoint = projector.adjoint(&ANGLES, y.view()).unwrap();
            let (left, right) = (dot(&forward, &y), dot(&x, &adjoint));
            let size = dot(&forward, &forward).sqrt() * dot(&y, &y).sqrt();
            within!((left - right).abs() / size, "{model:?}: {left} and {right}");
            // The factor that fits one product to the other.
            within!((left / right - 1.0).abs(), "{model:?}: {}", left / right);
        }
    }
}

#[test]
fn single_precision_is_the_same_to_rounding() {
    for scanner in scanners() {
        for model in MODELS {
            let projector = VoxelProjector::new(&scanner, model).unwrap();
            let (x, y) = (volume(&scanner), images(&scanner));
            let near = |a: Array3<f64>, b: Array3<f32>| {
                let peak = a.iter().fold(0.0_f64, |peak, value| peak.max(value.abs()));
                let error = a.iter().zip(&b).fold(0.0_f64, |error, (a, &b)| error.max((a - f64::from(b)).abs()));
                within!(error / peak, "{model:?}: {error} of {peak}");
            };
            let (x32, y32) = (x.mapv(|v| v as f32), y.mapv(|v| v as f32));
            let (x, y) = (x32.mapv(f64::from), y32.mapv(f64::from));
            near(projector.forward(&ANGLES, x.view()).unwrap(), projector.forward(&ANGLES, x32.view()).unwrap());
            near(projector.adjoint(&ANGLES, y.view()).unwrap(), projector.adjoint(&ANGLES, y32.view()).unwrap());
        }
    }
}

#[test]
fn siddons_lengths_in_a_full_box_add_up_to_its_chord() {
    for scanner in scanners() {
        let ones = Array3::from_elem(scanner.grid.shape, 1.0);
        let lengths = VoxelProjector::new(&scanner, RayModel::Siddon).unwrap().forward(&ANGLES, ones.view()).unwrap();
        let (centre, half) = ((scanner.grid.min + scanner.grid.max()) / 2.0, scanner.grid.size() / 2.0);
        let cuboid = Solid::new(Shape::Cuboid, 1.0, centre, half);
        for ((view, row, column), length) in lengths.indexed_iter() {
            let chord = cuboid.line_integral(&scanner.ray(&scanner.view(ANGLES[view]), row, column));
            within!((length - chord).abs(), "{length} of {chord}");
        }
    }
}

#[test]
fn the_number_of_threads_changes_no_bit() {
    for model in MODELS {
        let scanner = scanner(Beam::Cone { dso: 4.0, dsd: 6.0 });
        let projector = VoxelProjector::new(&scanner, model).unwrap();
        let (x, y) = (volume(&scanner).mapv(|v| v as f32), images(&scanner).mapv(|v| v as f32));
        let run = || (projector.forward(&ANGLES, x.view()).unwrap(), projector.adjoint(&ANGLES, y.view()).unwrap());
        assert!(threads::install(1, run).unwrap() == threads::install(3, run).unwrap());
    }
}

#[test]
fn views_of_a_set_do_not_depend_on_each_other() {
    let scanner = scanner(Beam::Parallel { dso: 4.0 });
    for model in MODELS {
        let projector = VoxelProjector::new(&scanner, model).unwrap();
        let x = volume(&scanner);
        let all = projector.forward(&ANGLES, x.view()).unwrap();
        let some = projector.forward(&[ANGLES[4], ANGLES[2]], x.view()).unwrap();
        assert_eq!(all.select(Axis(0), &[4, 2]), some);
    }
}

#[test]
fn other_shapes_and_no_views_are_refused() {
    let scanner = scanner(Beam::Parallel { dso: 4.0 });
    let projector = VoxelProjector::new(&scanner, RayModel::Joseph).unwrap();
    let wrong = Array3::<f32>::zeros((9, 14, 11));
    assert!(projector.forward(&[0.0], wrong.view()).unwrap_err().to_string().contains("[11, 14, 9]"));
    assert!(projector.adjoint(&[0.0], wrong.view()).unwrap_err().to_string().contains("[1, 37, 22]"));
    let right = Array3::<f32>::zeros((11, 14, 9));
    assert!(projector.forward(&[], right.view()).unwrap_err().to_string().contains("angles"));
}

const PLAN: Plan = Plan { views: 3, test_views: 2, noise: Noise::None, seed: 1 };
const HELIX: Orbit = Orbit { turns: 2.0, pitch: 0.3, roll: 0.1, axis_shift: 0.05 };

#[test]
fn scans_by_siddon_have_the_lengths_in_a_box_on_any_orbit() {
    for scanner in scanners() {
        let block = scanner.grid.shape.map(|n| n / 4..(n - n / 4));
        let inside = |index: [usize; 3]| (0..3).all(|axis| block[axis].contains(&index[axis]));
        let values = Array3::from_shape_fn(scanner.grid.shape, |(x, y, z)| 0.75 * f32::from(inside([x, y, z])));
        let volume = Volume::new(scanner.grid, values).unwrap();
        let corner = |at: [usize; 3]| scanner.grid.min + DVec3::from_array(at.map(|i| i as f64)) * scanner.grid.spacing;
        let (low, high) = (corner(block.clone().map(|b| b.start)), corner(block.clone().map(|b| b.end)));
        let cuboid = Solid::new(Shape::Cuboid, 0.75, (low + high) / 2.0, (high - low) / 2.0);
        for orbit in [Orbit::CIRCLE, HELIX] {
            let object = Object::Voxels(&volume, RayModel::Siddon.rays());
            let scan = simulate_on("box", object, &scanner, &PLAN, &orbit).unwrap();
            assert!(scan.notes[0].contains("Siddon") && scan.truth.as_ref() == Some(&volume));
            for views in [&scan.train, scan.test.as_ref().unwrap()] {
                for ((view, row, column), &value) in views.images.indexed_iter() {
                    let chord = cuboid.line_integral(&views.trajectory().view(&scanner, view).ray(row, column));
                    within!((f64::from(value) - chord).abs(), "{value} of {chord}");
                }
                // The helix leaves a single slice.
                let hit = views.images.iter().filter(|value| **value > 0.0).count();
                assert!(hit > 50 || orbit == HELIX && scanner.grid.shape[2] == 1, "{hit} pixels");
            }
        }
    }
}

#[test]
fn the_rays_of_a_scan_agree_on_a_smooth_volume() {
    let mut scanner = scanner(Beam::Cone { dso: 4.0, dsd: 6.0 });
    scanner.grid = Grid::cube(32);
    let blob = |(x, y, z): (usize, usize, usize)| {
        let point = scanner.grid.centre([x, y, z]) - DVec3::new(0.1, -0.05, 0.0);
        trgs_core::numeric::elementary::exp(-point.length_squared() / 0.18) as f32
    };
    let volume = Volume::new(scanner.grid, Array3::from_shape_fn([32; 3], blob)).unwrap();
    let scan = |object| simulate_on("blob", object, &scanner, &PLAN, &HELIX).unwrap();
    let trilinear = scan(Object::Volume(&volume));
    let peak = trilinear.train.images.iter().fold(0.0_f32, |peak, &value| peak.max(value));
    for model in MODELS {
        let voxels = scan(Object::Voxels(&volume, model.rays()));
        let error =
            (&voxels.train.images - &trilinear.train.images).iter().fold(0.0_f32, |worst, e| worst.max(e.abs()));
        match model {
            RayModel::Joseph => within!("joseph", error / peak),
            RayModel::Siddon => within!("siddon", error / peak),
        }
        beyond!("difference", error / peak, "{model:?}");
        // A measuring chain sees the same rays.
        let object = Object::Voxels(&volume, model.rays());
        let measured = |chain: &str| {
            let chain: Chain = chain.parse().unwrap();
            simulate_measured("blob", object, &scanner, &Plan { noise: Noise::LOW, ..PLAN }, &HELIX, &chain).unwrap()
        };
        let scan = measured("");
        assert!(scan == measured("") && scan.train != measured("axis=0").train && scan.notes.len() == 2);
        assert_eq!((scan.test, scan.train.poses), (voxels.test, voxels.train.poses));
    }
}

#[test]
fn parts_have_the_bits_of_the_whole() {
    let bits = |values: &Array3<f32>| values.iter().map(|value| value.to_bits()).collect::<Vec<_>>();
    for scanner in scanners() {
        let projector = VoxelProjector::new(&scanner, RayModel::Joseph).unwrap();
        let (x, y) = (volume(&scanner).mapv(|v| v as f32), images(&scanner).mapv(|v| v as f32));
        let rolled = ANGLES.map(|angle| Deviation::none(&scanner).rolled(0.3).pose(angle));
        for views in [Trajectory::from(&ANGLES), Trajectory { angles: &ANGLES, poses: Some(&rolled) }] {
            let whole = projector.forward(views, x.view()).unwrap();
            let back = projector.adjoint(views, y.view()).unwrap();
            let nx = scanner.grid.shape[0];
            let listed = projector.views(views).unwrap();
            let (values, columns) = (x.as_slice().unwrap(), Columns::from_images(y.view()).values);
            let slice = scanner.grid.shape[1] * scanner.grid.shape[2];
            for count in [1, 2, 3, 7] {
                let parts: Vec<_> = (0..count).map(|k| k * nx / count..(k + 1) * nx / count).collect();
                let mut sums = projector.no_sums(&listed);
                for (part, rising) in parts.iter().map(|p| (p, true)).chain(parts.iter().rev().map(|p| (p, false))) {
                    let slab = &values[part.start * slice..(part.end + 1).min(nx) * slice];
                    projector.add_part(&listed, slab, part.clone(), rising, &mut sums);
                }
                projector.scale(&listed, &mut sums);
                let Scanner { detector: Detector { rows, columns: across, .. }, .. } = scanner;
                let sums = Columns { values: sums, rows, columns: across }.images();
                assert!(bits(&sums) == bits(&whole), "{count} parts");
                let mut adjoint = vec![0.0; nx * slice];
                for part in parts {
                    let slab = &mut adjoint[part.start * slice..part.end * slice];
                    projector.adjoin(&listed, [&columns], part.start, slab, |out, [value]| *out = value);
                }
                assert!(adjoint.iter().zip(&back).all(|(a, b)| a.to_bits() == b.to_bits()), "{count} parts");
            }
        }
    }
}
