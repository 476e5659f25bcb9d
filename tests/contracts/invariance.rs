//! Symmetries: results when the whole scene is rotated, mirrored, scaled or moved.
//!
//! Each test computes one result twice, at two places of the geometry page.

use crate::common::scenes;
use glam::{DQuat, DVec3};
use ndarray::{Array3, ArrayView3, Axis, Slice};
use trgs::density::{NextPrimitive, Relocation, adc, ar, next_parameters};
use trgs::geometry::{Beam, Detector, Grid, Scanner};
use trgs::primitives::{KernelKind, Primitives};
use trgs::projector::{self, Projection};

const ANGLES: [f64; 3] = [0.3, 2.4, 5.1];
const KERNELS: [KernelKind; 2] = [KernelKind::StudentT, KernelKind::Gaussian];
const PROJECTIONS: [Projection; 2] = [Projection::Exact, Projection::Affine];

/// Largest difference relative to the largest value.
fn distance(a: ArrayView3<'_, f64>, b: ArrayView3<'_, f64>) -> f64 {
    assert_eq!(a.shape(), b.shape());
    let peak = b.iter().fold(0.0_f64, |m, x| m.max(x.abs()));
    assert!(peak > 0.0, "there is nothing to compare");
    let worst = a.iter().zip(b).map(|(a, b)| (a - b).abs()).fold(0.0_f64, |m, d| if d.is_nan() { d } else { m.max(d) });
    worst / peak
}

fn images(primitives: &Primitives, scanner: &Scanner, angles: &[f64], projection: Projection) -> Array3<f64> {
    projector::forward(primitives, scanner, angles, projection, 0.0)
}

fn volume(primitives: &Primitives, grid: &Grid) -> Array3<f64> {
    projector::voxelize(primitives, grid, 0.0)
}

/// The array with some axes in reverse order.
fn reversed(mut array: Array3<f64>, axes: &[usize]) -> Array3<f64> {
    axes.iter().for_each(|axis| array.invert_axis(Axis(*axis)));
    array
}

/// `[start..end;step]` along each axis.
fn part(array: &Array3<f64>, ranges: [(usize, Option<usize>, usize); 3]) -> ArrayView3<'_, f64> {
    array.slice_each_axis(|axis| {
        let (start, end, step) = ranges[axis.axis.index()];
        Slice::new(start as isize, end.map(|end| end as isize), step as isize)
    })
}

/// Runs `check` for both kernels, projections and beams; prints the largest distance.
fn everywhere(what: &str, check: impl Fn(&Primitives, &Scanner, Projection) -> f64) {
    for scanner in [scenes::cone(), scenes::parallel()] {
        for kernel in KERNELS {
            for projection in PROJECTIONS {
                let found = check(&scenes::primitives(kernel, 13, 61), &scanner, projection);
                let name = format!("{what}: {kernel:?} {projection:?} {:?}", scanner.beam);
                eprintln!("{name}: {found:.1e}");
                within!(found, "{name}");
            }
        }
    }
}

/// [`everywhere`] for volumes.
fn in_space(what: &str, check: impl Fn(&Primitives, &Grid) -> f64) {
    for kernel in KERNELS {
        let found = check(&scenes::primitives(kernel, 13, 62), &scenes::cone().grid);
        eprintln!("{what}: {kernel:?} volume: {found:.1e}");
        within!(found, "{what}: {kernel:?}");
    }
}

/// The primitives with positions mapped by `place` and shapes rotated by `turn`.
fn mapped(primitives: &Primitives, place: impl Fn(DVec3) -> DVec3, turn: DQuat) -> Primitives {
    let mut mapped = primitives.clone();
    for mean in &mut mapped.parameters.mean {
        *mean = place(DVec3::from_array(*mean)).to_array();
    }
    for q in &mut mapped.parameters.quaternion {
        let turned = turn * DQuat::from_xyzw(q[1], q[2], q[3], q[0]);
        *q = [turned.w, turned.x, turned.y, turned.z];
    }
    mapped
}

/// A mirror in the plane y = 0 keeps the form of Σ.
///
/// The rotation about (x, y, z) by φ becomes that about (x, -y, z) by -φ.
fn mirrored(primitives: &Primitives) -> Primitives {
    let mut mirrored = mapped(primitives, |p| DVec3::new(p.x, -p.y, p.z), DQuat::IDENTITY);
    mirrored.parameters.quaternion.iter_mut().for_each(|q| *q = [q[0], -q[1], q[2], -q[3]]);
    mirrored
}

#[test]
fn turning_the_object_is_turning_the_scanner_back() {
    everywhere("turn", |primitives, scanner, projection| {
        let phi = 0.77;
        let turn = DQuat::from_rotation_z(phi);
        let turned = mapped(primitives, |p| turn * p, turn);
        let back = ANGLES.map(|angle| angle - phi);
        distance(
            images(&turned, scanner, &ANGLES, projection).view(),
            images(primitives, scanner, &back, projection).view(),
        )
    });
}

#[test]
fn mirroring_the_object_in_y_mirrors_the_columns_of_the_opposite_views() {
    everywhere("mirror", |primitives, scanner, projection| {
        let opposite = ANGLES.map(|angle| -angle);
        let offset_u = -scanner.detector.offset_u;
        let mirror = Scanner { detector: Detector { offset_u, ..scanner.detector }, ..*scanner };
        let straight = images(primitives, scanner, &ANGLES, projection);
        distance(reversed(images(&mirrored(primitives), &mirror, &opposite, projection), &[2]).view(), straight.view())
    });
}

#[test]
fn turning_the_object_upside_down_turns_the_images_upside_down() {
    everywhere("upside down", |primitives, scanner, projection| {
        // Half a turn about x: y → -y, z → -z, so angles change sign and rows and columns reverse their order.
        let turn = DQuat::from_rotation_x(std::f64::consts::PI);
        let turned = mapped(primitives, |p| turn * p, turn);
        let opposite = ANGLES.map(|angle| -angle);
        let Detector { offset_u, offset_v, .. } = scanner.detector;
        let detector = Detector { offset_u: -offset_u, offset_v: -offset_v, ..scanner.detector };
        let turned = images(&turned, &Scanner { detector, ..*scanner }, &opposite, projection);
        let straight = images(primitives, scanner, &ANGLES, projection);
        distance(reversed(turned, &[1, 2]).view(), straight.view())
    });
}

/// The scene in units `k` times smaller; densities per unit stay the same.
fn enlarged(primitives: &Primitives, scanner: &Scanner, k: f64) -> (Primitives, Scanner) {
    let mut primitives = mapped(primitives, |p| p * k, DQuat::IDENTITY);
    primitives.parameters.scale.as_flattened_mut().iter_mut().for_each(|s| *s *= k);
    let beam = match scanner.beam {
        Beam::Cone { dso, dsd } => Beam::Cone { dso: dso * k, dsd: dsd * k },
        Beam::Parallel { dso } => Beam::Parallel { dso: dso * k },
    };
    let d = scanner.detector;
    let detector = Detector {
        pitch_u: d.pitch_u * k,
        pitch_v: d.pitch_v * k,
        offset_u: d.offset_u * k,
        offset_v: d.offset_v * k,
        ..d
    };
    let grid = Grid { min: scanner.grid.min * k, spacing: scanner.grid.spacing * k, ..scanner.grid };
    (primitives, Scanner { beam, detector, grid })
}

#[test]
fn enlarging_all_lengths_enlarges_projections_alike_and_leaves_densities() {
    for k in [0.031, 17.3] {
        everywhere(&format!("enlarge {k}"), |primitives, scanner, projection| {
            let (large, large_scanner) = enlarged(primitives, scanner, k);
            let same = distance(volume(&large, &large_scanner.grid).view(), volume(primitives, &scanner.grid).view());
            within!(same, "volume enlarged by {k}");
            distance(
                images(&large, &large_scanner, &ANGLES, projection).view(),
                (images(primitives, scanner, &ANGLES, projection) * k).view(),
            )
        });
    }
}

#[test]
fn a_power_of_two_enlarges_without_any_rounding() {
    for (kernel, projection) in KERNELS.into_iter().zip(PROJECTIONS) {
        let (primitives, scanner) = (scenes::primitives(kernel, 13, 63), scenes::cone());
        let (large, large_scanner) = enlarged(&primitives, &scanner, 4.0);
        let images = [
            images(&primitives, &scanner, &ANGLES, projection) * 4.0,
            images(&large, &large_scanner, &ANGLES, projection),
        ];
        assert_eq!(images[0], images[1], "{kernel:?} {projection:?}");
        assert_eq!(volume(&primitives, &scanner.grid), volume(&large, &large_scanner.grid), "{kernel:?}");
    }
}

#[test]
fn moving_object_and_grid_together_leaves_the_volume() {
    in_space("move", |primitives, grid| {
        let by = DVec3::new(3.1, -7.7, 0.9);
        let moved = mapped(primitives, |p| p + by, DQuat::IDENTITY);
        distance(volume(&moved, &Grid { min: grid.min + by, ..*grid }).view(), volume(primitives, grid).view())
    });
}

#[test]
fn permuted_axes_of_the_object_are_permuted_axes_of_the_volume() {
    in_space("permute", |primitives, grid| {
        // x → y → z → x: a third of a turn about (1,1,1).
        let turn = DQuat::from_axis_angle(DVec3::ONE.normalize(), std::f64::consts::TAU / 3.0);
        let permute = |p: DVec3| DVec3::new(p.z, p.x, p.y);
        within!((turn * DVec3::new(1.0, 2.0, 3.0) - DVec3::new(3.0, 1.0, 2.0)).length());
        let turned = mapped(primitives, permute, turn);
        let [nx, ny, nz] = grid.shape;
        let turned_grid = Grid { shape: [nz, nx, ny], min: permute(grid.min), spacing: permute(grid.spacing) };
        let straight = volume(primitives, grid);
        // Axis 0 of the rotated volume is z.
        distance(volume(&turned, &turned_grid).view(), straight.view().permuted_axes([2, 0, 1]))
    });
}

#[test]
fn a_negated_axis_of_the_object_is_a_reversed_axis_of_the_volume() {
    in_space("negate", |primitives, grid| {
        let (min, max) = (grid.min.y, grid.max().y);
        let mirror_grid = Grid { min: DVec3::new(grid.min.x, -max, grid.min.z), ..*grid };
        assert!(min != -max, "the grid must be off-centre");
        let mirror = reversed(volume(&mirrored(primitives), &mirror_grid), &[1]);
        distance(mirror.view(), volume(primitives, grid).view())
    });
}

#[test]
fn uneven_voxels_sample_the_same_field_as_every_so_many_small_even_ones() {
    in_space("voxels", |primitives, _| {
        // 3, 1 and 5 small voxels along x, y, z form a large one, centred at the middle one.
        let small = Grid { shape: [21, 11, 45], min: DVec3::new(-0.9, -0.5, -1.1), spacing: DVec3::splat(0.05) };
        let large = Grid { shape: [7, 11, 9], min: small.min, spacing: small.spacing * DVec3::new(3.0, 1.0, 5.0) };
        let all = volume(primitives, &small);
        distance(volume(primitives, &large).view(), part(&all, [(1, None, 3), (0, None, 1), (2, None, 5)]))
    });
}

#[test]
fn a_detector_moved_by_whole_pixels_is_a_crop_of_a_larger_one() {
    everywhere("crop", |primitives, scanner, projection| {
        let d = scanner.detector;
        // 5 more columns on the left and 8 on the right, 3 more rows on top and 4 below.
        let offset_u = d.offset_u + 1.5 * d.pitch_u;
        let offset_v = d.offset_v + 0.5 * d.pitch_v;
        let large = Detector { rows: d.rows + 7, columns: d.columns + 13, offset_u, offset_v, ..d };
        let whole = images(primitives, &Scanner { detector: large, ..*scanner }, &ANGLES, projection);
        distance(
            images(primitives, scanner, &ANGLES, projection).view(),
            part(&whole, [(0, None, 1), (3, Some(3 + d.rows), 1), (5, Some(5 + d.columns), 1)]),
        )
    });
}

#[test]
fn a_detector_twice_as_far_and_twice_as_large_sees_the_same() {
    for (kernel, projection) in [(0, 0), (0, 1), (1, 0), (1, 1)].map(|(k, p)| (KERNELS[k], PROJECTIONS[p])) {
        let primitives = scenes::primitives(kernel, 13, 64);
        let (near, d) = (scenes::cone(), scenes::cone().detector);
        for k in [2.0, 1.7] {
            let far = Scanner {
                beam: Beam::Cone { dso: 5.0, dsd: 7.0 * k },
                detector: Detector {
                    pitch_u: d.pitch_u * k,
                    pitch_v: d.pitch_v * k,
                    offset_u: d.offset_u * k,
                    offset_v: d.offset_v * k,
                    ..d
                },
                ..near
            };
            let found = distance(
                images(&primitives, &far, &ANGLES, projection).view(),
                images(&primitives, &near, &ANGLES, projection).view(),
            );
            within!(found, "detector at {k}: {kernel:?} {projection:?}");
            assert!(
                k != 2.0 || found == 0.0,
                "{kernel:?} {projection:?}: a power of two rounds nothing, but {found:e}"
            );
        }
    }
}

/// How far the distance from a limit is from falling like 1/parameter, as a deviation of a factor from 1.
///
/// The distance is computed at two values of the parameter; distance times parameter should be equal.
fn first_order(what: &str, parameters: [f64; 2], distance_at: impl Fn(f64) -> f64) -> f64 {
    let [near, far] = parameters.map(&distance_at);
    let fall = near / far;
    let expected = parameters[1] / parameters[0];
    eprintln!("{what}: {near:.2e} at {:e}, {far:.2e} at {:e}", parameters[0], parameters[1]);
    (fall / expected - 1.0).abs()
}

#[test]
fn the_t_kernel_approaches_the_gaussian_like_one_over_nu() {
    let gaussian = scenes::primitives(KernelKind::Gaussian, 13, 65);
    let student = |nu: f64| {
        let mut parameters = gaussian.parameters.clone();
        parameters.nu.fill(nu);
        Primitives::new(parameters).unwrap()
    };
    for nu in [[1e3, 1e5], [1e6, 1e8]] {
        for projection in PROJECTIONS {
            let limit = images(&gaussian, &scenes::cone(), &ANGLES, projection);
            let at =
                |nu: f64| distance(images(&student(nu), &scenes::cone(), &ANGLES, projection).view(), limit.view());
            within!(first_order(&format!("ν → ∞, {projection:?}"), nu, at), "{nu:?} {projection:?}");
        }
        let grid = scenes::cone().grid;
        let limit = volume(&gaussian, &grid);
        let at = |nu: f64| distance(volume(&student(nu), &grid).view(), limit.view());
        within!(first_order("ν → ∞, volume", nu, at), "{nu:?}");
    }
}

#[test]
fn a_cone_beam_from_far_away_approaches_the_parallel_beam_like_one_over_the_distance() {
    for kernel in KERNELS {
        for projection in PROJECTIONS {
            let (primitives, parallel) = (scenes::primitives(kernel, 13, 66), scenes::parallel());
            let limit = images(&primitives, &parallel, &ANGLES, projection);
            // The detector is at the axis, so its pixels have the size of the parallel beam's.
            let at = |distance_of_source: f64| {
                let beam = Beam::Cone { dso: distance_of_source, dsd: distance_of_source };
                distance(images(&primitives, &Scanner { beam, ..parallel }, &ANGLES, projection).view(), limit.view())
            };
            let what = format!("DSO → ∞, {kernel:?} {projection:?}");
            within!(first_order(&what, [1e3, 1e5], at), "{what}");
        }
    }
}

/// The primitives after a step of density control.
fn next_population(primitives: &Primitives, next: &[NextPrimitive]) -> Primitives {
    assert!(next.iter().filter(|s| s.fresh).count() > 3, "something was copied");
    Primitives { kernel: primitives.kernel, parameters: next_parameters(&primitives.parameters, next) }
}

/// Half as many primitives again, copied from living ones.
fn grown(primitives: &Primitives, relocation: Relocation) -> Primitives {
    let settings = ar::Settings { dead: 0.0, recycled: 0.0, growth: 0.5, cap: 1000, relocation };
    let draws = scenes::uniform(63, 100, 0.0, 1.0);
    let mut draws = draws.iter();
    next_population(primitives, &ar::ar(primitives, &settings, || *draws.next().unwrap()))
}

#[test]
fn copying_primitives_changes_neither_projections_nor_field() {
    everywhere("copies", |primitives, scanner, projection| {
        let grown = grown(primitives, Relocation::Exact);
        let after = images(&grown, scanner, &ANGLES, projection);
        distance(after.view(), images(primitives, scanner, &ANGLES, projection).view())
    });
    in_space("copies", |primitives, grid| {
        distance(volume(&grown(primitives, Relocation::Exact), grid).view(), volume(primitives, grid).view())
    });
}

#[test]
fn the_rule_for_opacities_does_change_them() {
    let (primitives, grid) = (scenes::primitives(KernelKind::StudentT, 13, 61), scenes::cone().grid);
    let before = volume(&primitives, &grid);
    beyond!(distance(volume(&grown(&primitives, Relocation::Sss), &grid).view(), before.view()));
}

#[test]
fn cloning_what_pulls_changes_neither_projections_nor_field() {
    let cloned = |primitives: &Primitives| {
        let settings = adc::Settings { gradient: 0.5, split_scale: 1.0, faint: 0.0, cap: 1000 };
        let pull: Vec<f64> = (0..primitives.len()).map(|i| (i % 3) as f64).collect();
        let wide = Grid { min: DVec3::splat(-9.0), spacing: DVec3::splat(18.0), shape: [1; 3] };
        next_population(primitives, &adc::adc(&primitives.parameters, &pull, &settings, &wide, |_| [0.0; 6]))
    };
    everywhere("clones", |primitives, scanner, projection| {
        let after = images(&cloned(primitives), scanner, &ANGLES, projection);
        distance(after.view(), images(primitives, scanner, &ANGLES, projection).view())
    });
    in_space("clones", |primitives, grid| {
        distance(volume(&cloned(primitives), grid).view(), volume(primitives, grid).view())
    });
}
