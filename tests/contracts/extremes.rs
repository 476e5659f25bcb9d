//! Extreme but valid numbers: images, volumes and gradients are finite, and nothing panics.
//!
//! In the ordinary range, the fast path equals the naive twin.
//!
//! Uses proptest with a fixed seed. Arbitrary bytes of files are in `tests/contracts/robustness.rs`.

use crate::common::scenes;
use ndarray::Array3;
use proptest::collection::vec;
use proptest::prelude::*;
use proptest::test_runner::{Config as Settings, RngAlgorithm, TestRng, TestRunner};
use trgs::geometry::{Detector, Scanner};
use trgs::primitives::{Group, Parameters, Primitives};
use trgs::projector::{self, Kernels, Projection, naive};

const ANGLES: [f64; 2] = [0.0, 2.6];

/// Runs `check` on values drawn with a fixed seed; a failure message holds the smallest failing value.
fn for_all<S: Strategy>(cases: u32, strategy: &S, check: impl Fn(S::Value)) {
    let settings = Settings { cases, failure_persistence: None, max_shrink_iters: 300, ..Settings::default() };
    let mut runner = TestRunner::new_with_rng(settings, TestRng::deterministic_rng(RngAlgorithm::ChaCha));
    let outcome = runner.run(strategy, |value| {
        check(value);
        Ok(())
    });
    outcome.unwrap_or_else(|failure| panic!("{failure}"));
}

/// The numbers of one primitive.
type Row = ([f64; 3], [f64; 3], [f64; 4], f64, f64);

fn primitives(rows: Vec<Row>, gaussian: bool) -> Primitives {
    let mut parameters = Parameters::default();
    for (mean, scale, quaternion, density, nu) in rows {
        parameters.mean.push(mean);
        parameters.scale.push(scale);
        parameters.quaternion.push(quaternion);
        parameters.density.push(density);
        parameters.nu.push(if gaussian { f64::INFINITY } else { nu });
    }
    Primitives::new(parameters).unwrap()
}

/// A number with a uniformly distributed exponent of ten.
fn magnitude(low: f64, high: f64) -> impl Strategy<Value = f64> {
    (low..high).prop_map(|exponent| libm::pow(10.0, exponent))
}

fn quaternion(low: f64, high: f64) -> impl Strategy<Value = [f64; 4]> {
    (prop::array::uniform4(-1.0..1.0_f64), magnitude(low, high))
        .prop_filter("not too short", |(q, _)| q.iter().map(|x| x * x).sum::<f64>() > 0.01)
        .prop_map(|(q, length)| q.map(|x| x * length))
}

/// Extreme primitives: scales from 1e-6 to 1e3, ν from 0.01 to 1e9, means anywhere.
///
/// Means may be on the source, behind it, or in a pixel's ray. Densities have any sign, from 1e-30 to 1e30, quaternions
/// any length from 1e-100 to 1e100.
fn extreme() -> impl Strategy<Value = (Vec<Row>, bool)> {
    let mean = prop_oneof![
        6 => prop::array::uniform3(-1.5..1.5_f64),
        2 => prop::array::uniform3(-9.0..9.0_f64),
        1 => prop::sample::select(&[[5.0, 0.0, 0.0], [4.94, 0.0, 0.0], [0.0; 3], [6.0, 0.3, -0.1], [1e6, 0.0, 0.0], [-1e6, 1e5, 3.0]][..]),
    ];
    let density = (magnitude(-30.0, 30.0), any::<bool>()).prop_map(|(x, negative)| if negative { -x } else { x });
    let scale = prop_oneof![
        2 => prop::array::uniform3(magnitude(-6.0, 3.0)),
        1 => magnitude(-6.0, 3.0).prop_map(|s| [s; 3]),
    ];
    let row = (mean, scale, quaternion(-100.0, 100.0), density, magnitude(-2.0, 9.0));
    (vec(row, 1..4), any::<bool>())
}

/// Scales that no scan needs, 1e-25 to 1e10: coordinates and squares leave the range of f32.
fn absurd() -> impl Strategy<Value = (Vec<Row>, bool)> {
    let scale = prop_oneof![
        prop::array::uniform3(magnitude(-25.0, -6.0)),
        prop::array::uniform3(magnitude(3.0, 10.0)),
        magnitude(-25.0, 10.0).prop_map(|s| [s; 3]),
    ];
    let mean = prop::array::uniform3(-1.5..1.5_f64);
    (vec((mean, scale, quaternion(-1.0, 1.0), -1.0..1.0_f64, magnitude(-1.0, 6.0)), 1..3), any::<bool>())
}

/// Ordinary primitives: scales 0.02 to 0.5, ν from 0.5 to 300, inside the volume.
fn ordinary() -> impl Strategy<Value = (Vec<Row>, bool)> {
    let mean = prop::array::uniform3(-0.8..0.8_f64);
    let row = (
        mean,
        prop::array::uniform3(magnitude(-1.7, -0.3)),
        quaternion(-3.0, 3.0),
        -1.0..1.0_f64,
        magnitude(-0.3, 2.5),
    );
    (vec(row, 1..6), any::<bool>())
}

/// A small detector, for speed.
fn scanner(cone: bool) -> Scanner {
    let scanner = if cone { scenes::cone() } else { scenes::parallel() };
    let Detector { pitch_v, pitch_u, .. } = scanner.detector;
    let detector =
        Detector { rows: 13, columns: 19, pitch_v: 3.0 * pitch_v, pitch_u: 2.5 * pitch_u, ..scanner.detector };
    Scanner { detector, ..scanner }
}

fn assert_finite<R: Kernels>(what: &str, primitives: &Primitives) {
    let finite = |name: &str, values: &Array3<R>| {
        let bad = values.indexed_iter().find(|(_, x)| !x.is_finite());
        assert!(bad.is_none(), "{what} {name}: {bad:?}");
    };
    let gradient_finite = |name: &str, gradient: &Parameters| {
        for group in Group::ALL {
            let bad = gradient.group(group).iter().enumerate().find(|(_, x)| !x.is_finite());
            assert!(bad.is_none(), "{what} {name}, gradient to {}: {bad:?}", group.key());
        }
    };
    for cutoff in [0.0, 1e-3] {
        for (beam, projection) in
            [("cone", Projection::Exact), ("cone", Projection::Affine), ("parallel", Projection::Exact)]
        {
            let scanner = scanner(beam == "cone");
            let name = format!("{beam} {projection:?} cutoff {cutoff}");
            finite(&name, &projector::forward::<R>(primitives, &scanner, &ANGLES, projection, cutoff));
            let d = scanner.detector;
            let cotangent = scenes::cotangent(91, (ANGLES.len(), d.rows, d.columns)).mapv(R::from_f64);
            gradient_finite(
                &name,
                &projector::vjp(primitives, &scanner, &ANGLES, projection, cutoff, cotangent.view()),
            );
        }
        let grid = scanner(true).grid;
        finite("volume", &projector::voxelize::<R>(primitives, &grid, cutoff));
        let cotangent = scenes::cotangent(92, grid.shape).mapv(R::from_f64);
        gradient_finite("volume", &projector::voxelize_vjp(primitives, &grid, cutoff, cotangent.view()));
    }
}

#[test]
fn extreme_primitives_have_finite_images_volumes_and_gradients_in_f64() {
    for_all(2000, &extreme(), |(rows, gaussian)| assert_finite::<f64>("f64", &primitives(rows, gaussian)));
}

#[test]
fn extreme_primitives_have_finite_images_volumes_and_gradients_in_f32() {
    for_all(2000, &extreme(), |(rows, gaussian)| assert_finite::<f32>("f32", &primitives(rows, gaussian)));
}

#[test]
fn absurdly_small_and_large_primitives_have_finite_images_volumes_and_gradients() {
    for_all(500, &absurd(), |(rows, gaussian)| {
        assert_finite::<f64>("f64", &primitives(rows.clone(), gaussian));
        assert_finite::<f32>("f32", &primitives(rows, gaussian));
    });
}

/// A point exactly in a pixel's ray.
///
/// Its neighbours in the register are 10^25 standard deviations away; the square of that overflows in f32.
#[test]
fn a_point_in_the_ray_of_a_pixel_is_finite() {
    for cone in [true, false] {
        let detector = Detector { rows: 13, columns: 19, offset_u: 0.0, offset_v: 0.0, ..scanner(cone).detector };
        let scanner = Scanner { detector, ..scanner(cone) };
        for (scale, gaussian) in [(1e-18, false), (1e-25, false), (1e-25, true), (1e-30, false)] {
            let row = ([0.0; 3], [scale, 0.7 * scale, 0.9 * scale], [0.9, 0.1, 0.3, -0.2], 0.8, 3.0);
            let primitives = primitives(vec![row], gaussian);
            let what = format!("cone {cone}, scale {scale:e}, Gaussian {gaussian}");
            for projection in [Projection::Exact, Projection::Affine] {
                let image = projector::forward::<f32>(&primitives, &scanner, &ANGLES, projection, 0.0);
                let seen: Vec<_> = image.indexed_iter().filter(|(_, x)| **x != 0.0).map(|(index, _)| index).collect();
                assert_eq!(seen, [(0, 6, 9), (1, 6, 9)], "{what}: pixels that see the point");
                let cotangent = scenes::cotangent(93, image.dim()).mapv(|x: f64| x as f32);
                let gradient = projector::vjp(&primitives, &scanner, &ANGLES, projection, 0.0, cotangent.view());
                for group in Group::ALL {
                    let values = gradient.group(group);
                    assert!(values.iter().all(|x| x.is_finite()), "{what} {projection:?} {}: {values:?}", group.key());
                }
            }
        }
    }
}

#[test]
fn ordinary_primitives_look_alike_on_the_fast_and_the_naive_path() {
    let same = |what: String, fast: &Array3<f64>, naive: &Array3<f64>| {
        let peak = naive.iter().fold(1e-6_f64, |m, x| m.max(x.abs()));
        for ((index, fast), naive) in fast.indexed_iter().zip(naive) {
            let error = (fast - naive).abs() / peak;
            within!(error, "{what} at {index:?}: fast {fast:e}, naive {naive:e}, peak {peak:e}");
        }
    };
    for_all(120, &ordinary(), |(rows, gaussian)| {
        let primitives = primitives(rows, gaussian);
        for (cone, projection) in [(true, Projection::Exact), (true, Projection::Affine), (false, Projection::Exact)] {
            let scanner = scanner(cone);
            same(
                format!("{projection:?} {:?}", scanner.beam),
                &projector::forward(&primitives, &scanner, &ANGLES, projection, 0.0),
                &naive::forward(&primitives, &scanner, &ANGLES, projection, 0.0),
            );
        }
        let grid = scanner(true).grid;
        same("volume".into(), &projector::voxelize(&primitives, &grid, 0.0), &naive::voxelize(&primitives, &grid, 0.0));
    });
}
