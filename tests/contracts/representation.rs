//! One field in several representations gives equal results up to rounding, and often exactly.
//!
//! Primitives are reordered or split into parts; quaternions change sign and length; axes are permuted.

use crate::common::scenes;
use glam::{DMat3, DQuat};
use ndarray::Array3;
use trgs::geometry::Scanner;
use trgs::primitives::{Group, KernelKind, Parameters, Primitives};
use trgs::projector::{self, Kernels, Projection};

const ANGLES: [f64; 2] = [1.3, 3.9];

/// Images of both projections and beams, and the volume.
fn all<R: Kernels>(primitives: &Primitives, cutoff: f64) -> Vec<Array3<f64>> {
    let mut arrays = vec![projector::voxelize::<R>(primitives, &scenes::cone().grid, cutoff).mapv(R::to_f64)];
    for scanner in [scenes::cone(), scenes::parallel()] {
        for projection in [Projection::Exact, Projection::Affine] {
            let images = projector::forward::<R>(primitives, &scanner, &ANGLES, projection, cutoff);
            arrays.push(images.mapv(R::to_f64));
        }
    }
    arrays
}

fn gradient(primitives: &Primitives, scanner: &Scanner) -> Parameters {
    let cotangent = scenes::cotangent(70, (ANGLES.len(), scanner.detector.rows, scanner.detector.columns));
    projector::vjp::<f64>(primitives, scanner, &ANGLES, Projection::Exact, 0.0, cotangent.view())
}

/// Largest difference relative to the largest value of each array.
fn distance(a: &[Array3<f64>], b: &[Array3<f64>]) -> f64 {
    let one = |(a, b): (&Array3<f64>, &Array3<f64>)| {
        let peak = b.iter().fold(0.0_f64, |m, x| m.max(x.abs()));
        (a - b).iter().fold(0.0_f64, |m, d| if d.is_nan() { f64::INFINITY } else { m.max(d.abs()) }) / peak
    };
    a.iter().zip(b).map(one).fold(0.0, f64::max)
}

fn same_up_to_rounding(what: &str, change: impl Fn(&mut Primitives)) {
    for kernel in [KernelKind::StudentT, KernelKind::Gaussian] {
        let before = scenes::primitives(kernel, 17, 71);
        let mut after = before.clone();
        change(&mut after);
        assert_ne!(before, after, "{what} changes nothing");
        within!("f64", distance(&all::<f64>(&after, 0.0), &all::<f64>(&before, 0.0)), "{what}: {kernel:?}");
        within!("f32", distance(&all::<f32>(&after, 0.0), &all::<f32>(&before, 0.0)), "{what}: {kernel:?}");
    }
}

fn permute<T: Copy>(values: &mut Vec<T>, order: impl Fn(usize) -> usize) {
    *values = (0..values.len()).map(|i| values[order(i)]).collect();
}

#[test]
fn the_order_of_primitives_matters_by_rounding_only() {
    same_up_to_rounding("order", |primitives| {
        let order = |i: usize| (i * 7 + 3) % 17;
        let p = &mut primitives.parameters;
        permute(&mut p.mean, order);
        permute(&mut p.scale, order);
        permute(&mut p.quaternion, order);
        permute(&mut p.density, order);
        permute(&mut p.nu, order);
    });
}

#[test]
fn the_gradient_of_a_primitive_does_not_depend_on_its_place_or_company() {
    let primitives = scenes::primitives(KernelKind::StudentT, 140, 72);
    let together = gradient(&primitives, &scenes::cone());
    for i in [0, 63, 64, 139] {
        let mut alone = Parameters::zeros(1);
        for group in Group::ALL {
            let width = group.width();
            alone.group_mut(group).copy_from_slice(&primitives.parameters.group(group)[i * width..][..width]);
        }
        let alone = gradient(&Primitives::new(alone).unwrap(), &scenes::cone());
        for group in Group::ALL {
            let width = group.width();
            assert_eq!(alone.group(group), &together.group(group)[i * width..][..width], "{} of {i}", group.key());
        }
    }
}

#[test]
fn the_sign_of_a_quaternion_changes_no_bit() {
    for kernel in [KernelKind::StudentT, KernelKind::Gaussian] {
        let before = scenes::primitives(kernel, 17, 73);
        let mut after = before.clone();
        after.parameters.quaternion.iter_mut().for_each(|q| *q = q.map(|x| -x));
        for cutoff in [0.0, 1e-3] {
            assert_eq!(all::<f64>(&after, cutoff), all::<f64>(&before, cutoff), "{kernel:?} f64 {cutoff}");
            assert_eq!(all::<f32>(&after, cutoff), all::<f32>(&before, cutoff), "{kernel:?} f32 {cutoff}");
        }
        let [mut turned, straight] = [&after, &before].map(|p| gradient(p, &scenes::cone()));
        turned.quaternion.iter_mut().for_each(|q| *q = q.map(|x| -x));
        assert_eq!(turned, straight, "{kernel:?}: the gradient changes its sign with the quaternion");
    }
}

#[test]
fn a_power_of_two_in_the_length_of_a_quaternion_changes_no_bit() {
    let before = scenes::primitives(KernelKind::StudentT, 17, 74);
    for length in [0.25, 8.0, libm::exp2(-300.0), libm::exp2(300.0)] {
        let mut after = before.clone();
        after.parameters.quaternion.iter_mut().for_each(|q| *q = q.map(|x| x * length));
        assert_eq!(all::<f64>(&after, 1e-3), all::<f64>(&before, 1e-3), "{length:e}");
        let [mut long, short] = [&after, &before].map(|p| gradient(p, &scenes::cone()));
        long.quaternion.iter_mut().for_each(|q| *q = q.map(|x| x * length));
        assert_eq!(long, short, "{length:e}: the gradient falls like the quaternion's length");
    }
}

#[test]
fn the_length_of_a_quaternion_matters_by_rounding_only() {
    same_up_to_rounding("length", |primitives| {
        for (i, q) in primitives.parameters.quaternion.iter_mut().enumerate() {
            *q = q.map(|x| x * (0.037 + 1.3 * i as f64));
        }
    });
}

#[test]
fn scales_may_be_permuted_together_with_the_axes_they_belong_to() {
    same_up_to_rounding("axes", |primitives| {
        for (scale, q) in primitives.parameters.scale.iter_mut().zip(&mut primitives.parameters.quaternion) {
            let r = DMat3::from_quat(DQuat::from_xyzw(q[1], q[2], q[3], q[0]).normalize());
            // A cyclic permutation keeps the handedness; so does an exchange with one axis reversed.
            let (axes, scales) = if scale[0] < scale[1] {
                (DMat3::from_cols(r.y_axis, r.z_axis, r.x_axis), [scale[1], scale[2], scale[0]])
            } else {
                (DMat3::from_cols(-r.y_axis, r.x_axis, r.z_axis), [scale[1], scale[0], scale[2]])
            };
            let turned = DQuat::from_mat3(&axes);
            (*scale, *q) = (scales, [turned.w, turned.x, turned.y, turned.z]);
        }
    });
}

#[test]
fn splitting_a_primitive_into_parts_of_its_density_changes_nothing() {
    for parts in [2, 5] {
        same_up_to_rounding(&format!("{parts} parts"), |primitives| {
            let p = &mut primitives.parameters;
            for i in 0..p.len() {
                p.density[i] /= parts as f64;
                for _ in 1..parts {
                    p.mean.push(p.mean[i]);
                    p.scale.push(p.scale[i]);
                    p.quaternion.push(p.quaternion[i]);
                    p.density.push(p.density[i]);
                    p.nu.push(p.nu[i]);
                }
            }
        });
    }
}

/// All parts have the same gradient to mean and shape, and these add up to the whole's gradient.
#[test]
fn the_parts_of_a_primitive_share_its_gradient() {
    let whole = scenes::primitives(KernelKind::StudentT, 1, 75);
    let mut halves = whole.clone();
    halves.parameters.density[0] /= 2.0;
    let p = &mut halves.parameters;
    p.mean.push(p.mean[0]);
    p.scale.push(p.scale[0]);
    p.quaternion.push(p.quaternion[0]);
    p.density.push(p.density[0]);
    p.nu.push(p.nu[0]);
    let [of_whole, of_halves] = [&whole, &halves].map(|p| gradient(p, &scenes::cone()));
    for group in Group::ALL {
        let width = group.width();
        let share = if group == Group::Density { 1.0 } else { 0.5 };
        for (k, whole) in of_whole.group(group).iter().enumerate() {
            let (one, other) = (of_halves.group(group)[k], of_halves.group(group)[width + k]);
            assert_eq!([one, other], [share * whole; 2], "{}", group.key());
        }
    }
}

#[test]
fn a_primitive_without_density_changes_no_bit() {
    let before = scenes::primitives(KernelKind::StudentT, 17, 76);
    let mut after = before.clone();
    after.parameters.density[16] = 0.0;
    let mut without = Parameters::zeros(16);
    for group in Group::ALL {
        without.group_mut(group).copy_from_slice(&before.parameters.group(group)[..16 * group.width()]);
    }
    let without = Primitives::new(without).unwrap();
    assert_eq!(all::<f64>(&after, 0.0), all::<f64>(&without, 0.0));
    assert_ne!(all::<f64>(&before, 0.0), all::<f64>(&without, 0.0));
}
