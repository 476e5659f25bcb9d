//! Confidence: the fast path against its naive twin, and both against what is known without them.

use super::naive::{effective_ratio, own_alpha, sphere_point, support_radius};
use super::*;
use crate::geometry::{Detector, Grid};
use crate::numeric::rng::{Purpose, stream};
use crate::primitives::Parameters;
use crate::tolerances::{largest, relative};
use glam::DQuat;
use rand::RngExt;
use std::f64::consts::{FRAC_PI_2, TAU};

/// An offset, non-square detector, too small for what is far from the axis.
fn scanner(beam: Beam) -> Scanner {
    let detector = Detector { rows: 20, columns: 31, pitch_v: 0.09, pitch_u: 0.08, offset_u: 0.31, offset_v: -0.17 };
    Scanner { beam, detector, grid: Grid::cube(8) }
}

fn cone() -> Scanner {
    scanner(Beam::Cone { dso: 5.0, dsd: 7.0 })
}

fn parallel() -> Scanner {
    scanner(Beam::Parallel { dso: 5.0 })
}

/// A parallel beam onto a detector that sees everything.
fn wide() -> Scanner {
    let detector = Detector { pitch_u: 10.0, pitch_v: 10.0, ..parallel().detector };
    Scanner { detector, ..parallel() }
}

/// Rotated primitives with axes up to 1:100, some outside of the volume.
fn primitives(m: u64, seed: u64) -> Primitives {
    let mut parameters = Parameters::default();
    for id in 0..m {
        let mut random = stream(seed, Purpose::Phantom, 7, id);
        let mut uniform = |low: f64, high: f64| low + (high - low) * random.random::<f64>();
        parameters.mean.push(std::array::from_fn(|_| uniform(-1.2, 1.2)));
        parameters.scale.push(std::array::from_fn(|_| libm::pow(10.0, uniform(-2.5, -0.5))));
        parameters.quaternion.push(std::array::from_fn(|_| uniform(-1.0, 1.0)));
        parameters.density.push(0.5);
        parameters.nu.push(7.0);
    }
    Primitives::new(parameters).unwrap()
}

fn one(mean: [f64; 3], scale: [f64; 3], quaternion: [f64; 4]) -> Primitives {
    let (mean, scale, quaternion) = (vec![mean], vec![scale], vec![quaternion]);
    Primitives::new(Parameters { mean, scale, quaternion, density: vec![1.0], nu: vec![3.0] }).unwrap()
}

fn fast(primitives: &Primitives, scanner: &Scanner, angles: &[f64], settings: Settings) -> Vec<f64> {
    Coverage::new(settings).confidence(primitives, scanner, angles)
}

fn points(sphere_points: usize) -> Settings {
    Settings { sphere_points, ..Settings::default() }
}

#[test]
fn fast_and_naive_count_the_same_points() {
    let primitives = primitives(150, 1);
    let angles = Scanner::uniform_angles(7, 0.2, TAU);
    for scanner in [cone(), parallel()] {
        for settings in [
            Settings::default(),
            points(1),
            points(17),
            Settings { sphere_points: 100, r_max: 0.83, kappa: 0.4, ..Settings::default() },
            Settings { sphere_points: 48, r_max: 1.6, kappa: 2.5, ..Settings::default() },
            Settings { alpha: Alpha::Median, ..Settings::default() },
            Settings { alpha: Alpha::Length(0.07), kappa: 0.4, ..Settings::default() },
        ] {
            let expected = naive::confidence(&primitives, &scanner, &angles, &settings);
            assert_eq!(fast(&primitives, &scanner, &angles, settings), expected, "{settings:?}");
        }
        let c = fast(&primitives, &scanner, &angles, Settings::default());
        let unseen = c.iter().filter(|c| **c == 0.0).count();
        assert!((3..100).contains(&unseen), "{unseen} unseen");
        beyond!(largest(c));
    }
}

#[test]
fn the_confidence_of_some_is_that_of_all() {
    let (primitives, angles) = (primitives(150, 1), Scanner::uniform_angles(7, 0.2, TAU));
    for alpha in [Alpha::Own, Alpha::Median] {
        let settings = Settings { alpha, ..Settings::default() };
        let all = fast(&primitives, &cone(), &angles, settings);
        let rows: Vec<usize> = (0..150).rev().step_by(2).chain([3, 3]).collect();
        let some = Coverage::new(settings).confidence_of(&rows, &primitives, &cone(), &angles);
        assert_eq!(some, rows.iter().map(|&row| all[row]).collect::<Vec<_>>());
    }
}

#[test]
fn a_constant_alpha_is_the_median_or_a_length() {
    let quaternion = [1.0, 0.0, 0.0, 0.0];
    // Mean scales 1, 1/8, 1/2 and 1/4.
    let scales = [[1.0; 3], [0.125; 3], [0.25, 1.0, 0.5], [0.125, 0.25, 0.5]];
    let of = |count: usize, alpha: Alpha| {
        let mut all = one([0.0; 3], [1.0; 3], quaternion);
        all.parameters.scale = scales[..count].to_vec();
        alpha.constant(&all)
    };
    // The middle one of three, and the lower one of two in the middle.
    assert_eq!([of(3, Alpha::Median), of(4, Alpha::Median)], [Some(0.5), Some(0.25)]);
    assert_eq!([of(0, Alpha::Median), of(3, Alpha::Own), of(3, Alpha::Length(0.7))], [None, None, Some(0.7)]);
}

#[test]
fn with_a_constant_alpha_the_small_are_covered_more_and_the_unit_does_not_matter() {
    let angles = Scanner::uniform_angles(6, 0.2, TAU);
    let c = |scale: f64, alpha: Alpha| {
        let sphere = one([0.1, 0.0, 0.1], [scale; 3], [1.0, 0.0, 0.0, 0.0]);
        fast(&sphere, &wide(), &angles, Settings { alpha, r_max: 0.3, ..points(4000) })[0]
    };
    let constant = [0.02, 0.05, 0.1, 0.2].map(|scale| c(scale, Alpha::Length(0.05)));
    // Tubes have their largest radius up to a scale of α/κ.
    assert!(constant[0] == constant[1] && constant[1] > constant[2] && constant[2] > constant[3], "{constant:?}");
    assert_eq!([0.02, 0.2].map(|scale| c(scale, Alpha::Own)), [constant[1]; 2]);
    assert_eq!(c(0.4, Alpha::Length(0.2)), c(0.1, Alpha::Length(0.05)));
}

#[test]
fn points_lie_on_the_sphere_and_spread_evenly() {
    for n in [64, 512, 2000] {
        let points: Vec<DVec3> = (0..n).map(|k| sphere_point(k, n)).collect();
        within!(largest(points.iter().map(|p| p.length() - 1.0)));
        let mean = points.iter().sum::<DVec3>() / n as f64;
        let squares = points.iter().map(|p| *p * *p).sum::<DVec3>() / n as f64;
        assert!(mean.abs().max_element() < 2.0 / n as f64, "{n}: {mean}");
        assert!((squares - 1.0 / 3.0).abs().max_element() < 2.0 / n as f64, "{n}: {squares}");
        // Every direction has a point within twice the radius of a cap of its share.
        for k in 0..97 {
            let direction = sphere_point(k, 97);
            let best = points.iter().map(|p| p.dot(direction)).fold(-1.0, f64::max);
            assert!(1.0 - best < 4.0 * 2.0 / n as f64, "{n}: {direction} is {best} from its point");
        }
    }
}

#[test]
fn the_ratio_is_one_for_spheres_and_follows_the_axes() {
    let u = DVec3::new(0.48, -0.6, 0.64);
    within!(relative(effective_ratio(own_alpha(DVec3::splat(0.03)), DVec3::splat(0.03), u), 1.0));
    // α = (0.1·0.2·0.4)^⅓ = 0.2.
    let scale = DVec3::new(0.1, 0.2, 0.4);
    for (axis, expected) in [(DVec3::X, 2.0), (DVec3::Y, 1.0), (DVec3::NEG_Z, 0.5)] {
        within!(relative(effective_ratio(own_alpha(scale), scale, axis), expected));
    }
    let long = (0.048_f64 * 0.048 + 0.12 * 0.12 + 0.256 * 0.256).sqrt();
    within!(relative(effective_ratio(own_alpha(scale), scale, u), 0.2 / long));
}

#[test]
fn the_tube_grows_with_the_ratio_up_to_its_largest_radius() {
    let settings = Settings { r_max: 0.6, kappa: 2.0, ..Settings::default() };
    for (ratio, expected) in [(0.0, 0.0), (0.5, 0.15), (1.0, 0.3), (2.0, 0.6), (9.0, 0.6), (f64::INFINITY, 0.6)] {
        within!(relative(support_radius(ratio, &settings), expected));
    }
}

#[test]
fn a_point_is_within_the_tube_iff_it_is_near_the_chord() {
    // The distance to the segment from -u to +u, with the foot of the perpendicular kept between its ends.
    let distance = |p: DVec3, u: DVec3| (p - u * p.dot(u).clamp(-1.0, 1.0)).length();
    let sphere = one([0.0; 3], [0.1; 3], [1.0, 0.0, 0.0, 0.0]);
    for (angle, r_max) in [(0.3, 0.5), (1.9, 0.2), (4.0, 0.95)] {
        let u = -wide().view(angle).w;
        let near = (0..300).filter(|&k| distance(sphere_point(k, 300), u) <= r_max).count();
        let settings = Settings { r_max, ..points(300) };
        assert_eq!(fast(&sphere, &wide(), &[angle], settings), [near as f64 / 300.0]);
    }
}

#[test]
fn one_view_of_a_sphere_covers_two_caps() {
    let sphere = one([0.1, -0.2, 0.15], [0.07; 3], [0.3, -0.4, 0.8, 0.1]);
    for r_max in [0.2, 0.5, 0.8, 0.99_f64] {
        let caps = 1.0 - (1.0 - r_max * r_max).sqrt();
        for n in [512, 5000] {
            let [c] = fast(&sphere, &cone(), &[0.7], Settings { r_max, ..points(n) })[..] else { panic!() };
            // The lattice misjudges the area of a cap by some n^-¾.
            assert!(
                (c - caps).abs() <= 2.0 * libm::pow(n as f64, -0.75),
                "r = {r_max}, {n} points: {c} against {caps}"
            );
        }
    }
}

#[test]
fn a_needle_is_covered_from_the_side_and_hardly_from_its_end() {
    // Turned by a third about (1,1,1), which takes z to x: the long axis lies along x, and x is not where y goes.
    let needle = one([0.0; 3], [0.1, 0.1, 0.8], [0.5, 0.5, 0.5, 0.5]);
    let caps = |r: f64| 1.0 - (1.0 - r * r).sqrt();
    // α = 0.2: e = ¼ from the end (view 0 has the source on +x), 2 from the side.
    for (angle, r) in [(0.0, 0.125), (FRAC_PI_2, 0.5)] {
        let [c] = fast(&needle, &wide(), &[angle], points(4000))[..] else { panic!() };
        within!((c - caps(r)).abs(), "{angle}: {c} against {}", caps(r));
    }
}

#[test]
fn the_direction_of_a_cone_beam_points_from_the_centre_to_the_source() {
    let scanner = scanner(Beam::Cone { dso: 4.0, dsd: 7.0 });
    let direction = towards_source(&scanner.view(0.0), DVec3::new(0.0, 3.0, 0.0));
    within!((direction - DVec3::new(0.8, -0.6, 0.0)).length(), "{direction}");
    let direction = towards_source(&parallel().view(0.0), DVec3::new(0.0, 3.0, 0.0));
    assert_eq!(direction, DVec3::X);
}

#[test]
fn a_view_counts_from_the_outer_edge_of_the_first_pixel_to_that_of_the_last() {
    // View 0: u = y - ½, v = -z on a detector of 2 × 4 pixels of ½ × 1.
    let detector = Detector { rows: 2, columns: 4, pitch_u: 0.5, pitch_v: 1.0, offset_u: 0.5, offset_v: 0.0 };
    let scanner = Scanner { detector, ..parallel() };
    let seen =
        |y: f64, z: f64| fast(&one([0.4, y, z], [0.1; 3], [1.0, 0.0, 0.0, 0.0]), &scanner, &[0.0], points(64))[0];
    for (y, z) in [(-0.5, 0.0), (1.499_999, 0.0), (0.5, 1.0), (0.5, -0.999_999)] {
        assert!(seen(y, z) > 0.0, "{y}, {z}");
    }
    for (y, z) in [(-0.500_001, 0.0), (1.5, 0.0), (0.5, 1.000_001), (0.5, -1.0)] {
        assert_eq!(seen(y, z), 0.0, "{y}, {z}");
    }
}

#[test]
fn what_no_view_sees_has_no_confidence() {
    let sphere = |mean| one(mean, [0.1; 3], [1.0, 0.0, 0.0, 0.0]);
    let at = |mean, angles: &[f64]| fast(&sphere(mean), &cone(), angles, points(64))[0];
    assert_eq!(at([0.0; 3], &[]), 0.0);
    // In the source, and behind it on the central ray.
    for x in [5.0, 6.0] {
        assert_eq!(at([x, 0.0, 0.0], &[0.0]), 0.0);
        assert!(at([x, 0.0, 0.0], &[std::f64::consts::PI]) > 0.0);
    }
}

#[test]
fn a_tube_as_wide_as_the_sphere_covers_all_of_it() {
    let scene = primitives(40, 2);
    // κ below every ratio: all tubes have the radius r_max.
    let settings = Settings { r_max: 1.0, kappa: 1e-3, ..points(77) };
    let c = fast(&scene, &wide(), &[0.4], settings);
    assert!(c.iter().all(|c| *c == 1.0), "{c:?}");
    let c = fast(&scene, &wide(), &[0.4], Settings { r_max: 0.99, ..settings });
    assert!(c.iter().all(|c| *c < 1.0), "{c:?}");
}

#[test]
fn more_views_never_cover_less() {
    let (scene, angles) = (primitives(60, 3), Scanner::uniform_angles(12, 0.1, 2.4));
    let steps: Vec<Vec<f64>> = (0..=12).map(|n| fast(&scene, &cone(), &angles[..n], points(256))).collect();
    for i in 0..scene.len() {
        assert!(steps.windows(2).all(|pair| pair[0][i] <= pair[1][i]), "primitive {i}");
    }
    assert!(steps[12].iter().zip(&steps[1]).filter(|(all, one)| all > one).count() > 30);
}

#[test]
fn turning_the_world_by_right_angles_changes_nothing() {
    let (scene, angles) = (primitives(80, 4), Scanner::uniform_angles(5, 0.3, TAU));
    for scanner in [cone(), parallel()] {
        let expected = fast(&scene, &scanner, &angles, Settings::default());
        let mut turned = scene.clone();
        for step in 1..4 {
            let quarter = DQuat::from_rotation_z(FRAC_PI_2);
            let Parameters { mean, quaternion, .. } = &mut turned.parameters;
            for ([x, y, _], [w, i, j, k]) in mean.iter_mut().zip(quaternion) {
                (*x, *y) = (-*y, *x);
                let q = quarter * DQuat::from_xyzw(*i, *j, *k, *w);
                [*w, *i, *j, *k] = [q.w, q.x, q.y, q.z];
            }
            let angles: Vec<f64> = angles.iter().map(|angle| angle + f64::from(step) * FRAC_PI_2).collect();
            assert_eq!(fast(&turned, &scanner, &angles, Settings::default()), expected, "{step} quarters");
            assert_ne!(fast(&scene, &scanner, &angles, Settings::default()), expected, "{step} quarters of the scan");
        }
    }
}

#[test]
fn the_unit_of_the_scales_does_not_matter() {
    let (scene, angles) = (primitives(50, 5), Scanner::uniform_angles(6, 0.0, TAU));
    let expected = fast(&scene, &cone(), &angles, Settings::default());
    for exponent in [-1000.0, -600.0, 600.0, 1000.0] {
        let mut other = scene.clone();
        other.parameters.scale.as_flattened_mut().iter_mut().for_each(|s| *s *= libm::exp2(exponent));
        assert_eq!(fast(&other, &cone(), &angles, Settings::default()), expected, "2^{exponent}");
    }
}

#[test]
fn the_number_of_threads_does_not_matter() {
    let (scene, angles) = (primitives(700, 6), Scanner::uniform_angles(5, 0.0, TAU));
    let on = |n: usize| threads::install(n, || fast(&scene, &cone(), &angles, Settings::default())).unwrap();
    let expected = on(1);
    assert_eq!(on(2), expected);
    assert_eq!(on(3), expected);
}

#[test]
fn unusable_settings_are_refused_by_name() {
    assert!(Settings::default().validate().is_ok());
    for (bad, name) in [
        (points(0), "sphere points"),
        (Settings { r_max: 0.0, ..points(9) }, "r_max"),
        (Settings { kappa: f64::NAN, ..points(9) }, "kappa"),
        (Settings { temperature: f64::INFINITY, ..points(9) }, "temperature"),
    ] {
        let message = bad.validate().unwrap_err().to_string();
        assert!(message.contains(name), "{message}");
    }
}
