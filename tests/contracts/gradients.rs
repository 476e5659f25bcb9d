//! Every gradient against 50-digit central differences.

use crate::common::scenes;
use crate::common::vectors::assert_conformance;
use crate::tolerances::relative;
use trgs::config::Precision;
use trgs::geometry::{Detector, Scanner};
use trgs::oracle::Format;
use trgs::primitives::activation::Interval;
use trgs::primitives::{Activation, Group, KernelKind, Parameters};
use trgs::projector::{self, Field, Projection};

fn is_gradient(case: &trgs::oracle::Case) -> bool {
    case.stage.starts_with("gradient")
}

#[test]
fn gradients_in_f64_agree_with_50_digit_differences() {
    assert_conformance(Precision::F64, Format::F64, is_gradient);
}

#[test]
fn gradients_in_f32_agree_with_50_digit_differences() {
    assert_conformance(Precision::F32, Format::F32, is_gradient);
}

/// The whole chain of training: raw parameters → physical → image, and back.
#[test]
fn raw_gradients_agree_with_central_differences() {
    let activation = Activation {
        kernel: KernelKind::StudentT,
        scale: Interval { min: 0.001, max: 1.0 },
        nu: Interval { min: 0.5, max: 100.0 },
    };
    let raw = activation.inverse(&scenes::primitives(KernelKind::StudentT, 3, 11).parameters);
    let (scanner, angles) = (scenes::cone(), [0.4, 2.5]);
    let cotangent = scenes::cotangent(5, (2, scanner.detector.rows, scanner.detector.columns));
    let loss = |raw: &Parameters| {
        (projector::forward::<f64>(&activation.forward(raw), &scanner, &angles, Projection::Exact, 0.0) * &cotangent)
            .sum()
    };
    let physical = activation.forward(&raw);
    let mut gradient = projector::vjp(&physical, &scanner, &angles, Projection::Exact, 0.0, cotangent.view());
    activation.vjp(&physical, &mut gradient);
    for group in Group::ALL {
        let peak = gradient.group(group).iter().fold(0.0_f64, |m, x| m.max(x.abs()));
        for i in 0..gradient.group(group).len() {
            let shifted = |h: f64| {
                let mut raw = raw.clone();
                raw.group_mut(group)[i] += h;
                loss(&raw)
            };
            let difference = (shifted(1e-5) - shifted(-1e-5)) / 2e-5;
            let error = (gradient.group(group)[i] - difference).abs() / peak;
            within!(error, "{} {i}", group.key());
        }
    }
}

/// A round primitive has no preferred rotation: Adam would amplify rounding noise there to full steps.
#[test]
fn the_gradient_to_the_rotation_of_a_round_primitive_is_exactly_zero() {
    let mut primitives = scenes::primitives(KernelKind::StudentT, 5, 12);
    primitives.parameters.scale.iter_mut().for_each(|s| *s = [s[0]; 3]);
    let scanner = scenes::cone();
    let cotangent = scenes::cotangent(6, (1, scanner.detector.rows, scanner.detector.columns));
    let gradient = projector::vjp(&primitives, &scanner, &[0.7], Projection::Exact, 0.0, cotangent.view());
    assert!(gradient.quaternion.as_flattened().iter().all(|d| *d == 0.0), "{:?}", gradient.quaternion);
    assert!(gradient.scale.as_flattened().iter().all(|d| *d != 0.0));
}

/// Only the rotation matters: the gradient has no component along the quaternion itself.
#[test]
fn the_gradient_to_a_quaternion_is_tangential() {
    let primitives = scenes::primitives(KernelKind::Gaussian, 5, 13);
    let scanner = scenes::cone();
    let cotangent = scenes::cotangent(6, (1, scanner.detector.rows, scanner.detector.columns));
    let gradient = projector::vjp(&primitives, &scanner, &[0.7], Projection::Affine, 0.0, cotangent.view());
    for (q, d) in primitives.parameters.quaternion.iter().zip(&gradient.quaternion) {
        let along: f64 = q.iter().zip(d).map(|(a, b)| a * b).sum();
        let lengths: f64 = q.iter().map(|a| a * a).sum::<f64>().sqrt() * d.iter().map(|a| a * a).sum::<f64>().sqrt();
        within!(along.abs() / lengths, "{along:e} of {lengths:e}");
    }
}

/// Moving the detector against a primitive moves its projection.
///
/// The affine projection depends on the detector in no other way.
#[test]
fn the_gradient_to_a_shadow_is_that_of_a_shifted_image() {
    for (scanner, name) in [(scenes::cone(), "cone"), (scenes::parallel(), "parallel")] {
        for kernel in [KernelKind::StudentT, KernelKind::Gaussian] {
            let primitives = scenes::primitives(kernel, 1, 17);
            let Detector { rows, columns, pitch_u, pitch_v, .. } = scanner.detector;
            let (half_u, half_v) = (pitch_u * columns as f64 / 2.0, pitch_v * rows as f64 / 2.0);
            let cotangent = scenes::cotangent(6, (rows, columns));
            let field = Field::<f64>::new(&primitives, 0.0);
            let mut gradient = field.zero_gradient();
            field.view(&scanner, 0.7, Projection::Affine).vjp(cotangent.view(), &mut gradient);
            let [u, v] = gradient.mean2d_gradients().next().unwrap();
            let moved = |u: f64, v: f64| {
                let Detector { offset_u, offset_v, .. } = scanner.detector;
                let detector =
                    Detector { offset_u: offset_u - u * half_u, offset_v: offset_v - v * half_v, ..scanner.detector };
                let scanner = Scanner { detector, ..scanner };
                (field.view(&scanner, 0.7, Projection::Affine).image() * &cotangent).sum()
            };
            let h = 1e-5;
            within!(relative(u, (moved(h, 0.0) - moved(-h, 0.0)) / (2.0 * h)));
            within!(relative(v, (moved(0.0, h) - moved(0.0, -h)) / (2.0 * h)));
            beyond!("size", f64::min(u.abs(), v.abs()), "{name} {kernel:?}: nothing to compare");
        }
    }
}

/// Volumes do not contribute to the gradient with respect to projected centres.
#[test]
fn the_gradient_to_a_shadow_comes_from_views_alone() {
    let (primitives, scanner) = (scenes::primitives(KernelKind::StudentT, 3, 17), scenes::cone());
    let field = Field::<f64>::new(&primitives, 0.0);
    let mut gradient = field.zero_gradient();
    field.on(&scanner.grid).vjp(scenes::cotangent(7, scanner.grid.shape).view(), &mut gradient);
    assert!(gradient.mean2d_gradients().all(|shadow| shadow == [0.0, 0.0]));
}
