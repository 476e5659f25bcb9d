//! Views with poses: projections, gradients and adjoints in any position of source and detector, and what
//! reconstructions from helices, rolled detectors and shifted axes are worth.

use crate::common::scenes;
use crate::tolerances::relative;
use glam::DVec3;
use ndarray::{Array2, Array3};
use std::f64::consts::{FRAC_PI_2, TAU};
use std::ops::ControlFlow;
use trgs::classical::algebraic::{Order, SartSettings, TvSettings, sart, tv};
use trgs::classical::{RayModel, Turn, VoxelProjector, Window, fdk};
use trgs::confidence::{Coverage, Settings, naive as naive_confidence};
use trgs::config::{Config, Finish, Method, Sampling};
use trgs::evaluation::psnr_3d;
use trgs::geometry::{Beam, Detector, Deviation, Grid, Pose, Projections, Scanner, Trajectory, Volume};
use trgs::numeric::{reduce, threads};
use trgs::primitives::{Group, KernelKind, Parameters, Primitives};
use trgs::projector::{self, Field, Projection, naive};
use trgs::scan::simulate::{Object, Orbit, Plan, simulate_on};
use trgs::scan::{Dataset, Noise, Phantom, trilinear};

const ANGLES: [f64; 4] = [0.3, 2.1, 4.4, 5.0];

/// Turned and tilted detectors, shifted axes, heights, other distances; the last is upright.
fn poses(scanner: &Scanner) -> Vec<Pose> {
    let plain = Deviation::none(scanner);
    let all = [
        Deviation { turns: [0.1, -0.15, 0.2], axis_shift: 0.2, heights: [0.3, 0.1], ..plain },
        Deviation { dso: 4.2, dsd: 6.1, origin: DVec3::new(0.05, -0.1, 0.1), ..plain.rolled(-1.2) },
        Deviation { turns: [-0.05, 0.25, FRAC_PI_2], offset: [-0.1, 0.3], ..plain },
        Deviation { axis_shift: -0.1, heights: [0.2, 0.25], ..plain },
    ];
    all.iter().zip(ANGLES).map(|(deviation, angle)| deviation.pose(angle)).collect()
}

fn scanners() -> [Scanner; 2] {
    [scenes::cone(), scenes::parallel()]
}

/// A parallel beam has no tilt of the detector against the rays: turned poses turn the rays.
fn along(poses: &[Pose]) -> Trajectory<'_> {
    Trajectory { angles: &ANGLES, poses: Some(poses) }
}

fn peak<'a>(values: impl IntoIterator<Item = &'a f64>) -> f64 {
    values.into_iter().fold(f64::MIN_POSITIVE, |peak, value| peak.max(value.abs()))
}

#[test]
fn images_and_gradients_of_posed_views_agree_with_the_naive_twin() {
    for kernel in [KernelKind::StudentT, KernelKind::Gaussian] {
        for (projection, scanner) in
            [Projection::Exact, Projection::Affine].into_iter().flat_map(|p| scanners().map(|s| (p, s)))
        {
            let (primitives, poses) = (scenes::primitives(kernel, 12, 6), poses(&scanner));
            let views = along(&poses);
            views.validate(&scanner).unwrap();
            for cutoff in [0.0, 1e-2] {
                let fast = projector::forward::<f64>(&primitives, &scanner, views, projection, cutoff);
                let naive = naive::forward(&primitives, &scanner, views, projection, cutoff);
                let error = peak(&(&fast - &naive)) / peak(&naive);
                within!("image", error, "{kernel:?} {projection:?} {:?}", scanner.beam);
                let plain = projector::forward::<f64>(&primitives, &scanner, &ANGLES, projection, cutoff);
                beyond!("poses ignored", peak(&(&fast - &plain)) / peak(&naive));
            }
            let cotangent = scenes::cotangent(9, (4, scanner.detector.rows, scanner.detector.columns));
            let fast = projector::vjp::<f64>(&primitives, &scanner, views, projection, 0.0, cotangent.view());
            let naive = naive::vjp(&primitives, &scanner, views, projection, 0.0, cotangent.view());
            for group in Group::ALL {
                let (a, b) = (fast.group(group), naive.group(group));
                let error = a.iter().zip(b).fold(0.0_f64, |worst, (a, b)| worst.max((a - b).abs())) / peak(b);
                within!("gradient", error, "{projection:?} {}", group.key());
            }
        }
    }
}

/// Step of 1e-5 of a unit: the error of a central difference is some 1e-9.
#[test]
fn gradients_of_posed_views_match_central_differences() {
    const STEP: f64 = 1e-5;
    for projection in [Projection::Exact, Projection::Affine] {
        let scanner = scenes::cone();
        let (primitives, poses) = (scenes::primitives(KernelKind::StudentT, 3, 8), poses(&scanner));
        let cotangent: Array3<f64> = scenes::cotangent(4, (4, scanner.detector.rows, scanner.detector.columns));
        let gradient = projector::vjp(&primitives, &scanner, along(&poses), projection, 0.0, cotangent.view());
        let value = |primitives: &Primitives| {
            let images = projector::forward::<f64>(primitives, &scanner, along(&poses), projection, 0.0);
            (images * &cotangent).sum()
        };
        for group in Group::ALL {
            let gradient = gradient.group(group);
            for (k, &found) in gradient.iter().enumerate() {
                let at = |step: f64| {
                    let mut moved = primitives.clone();
                    moved.parameters.group_mut(group)[k] += step;
                    value(&moved)
                };
                let difference = (at(STEP) - at(-STEP)) / (2.0 * STEP);
                let error = (found - difference).abs() / peak(gradient);
                within!(error, "{} {k}: {found} and {difference}", group.key());
            }
        }
    }
}

/// `tests/data/posed_view.json` is from `reference/generate/poses.py`: 50 digits, rounded.
#[test]
fn a_posed_view_and_its_gradient_are_right_to_twelve_digits() {
    let text = std::fs::read_to_string(concat!(env!("CARGO_MANIFEST_DIR"), "/tests/data/posed_view.json")).unwrap();
    let scene: serde_json::Value = serde_json::from_str(&text).unwrap();
    let list = |value: &serde_json::Value| -> Vec<f64> {
        value.as_array().unwrap().iter().map(|x| x.as_f64().unwrap_or(f64::INFINITY)).collect()
    };
    let vector = |name: &str| DVec3::from_slice(&list(&scene[name]));
    let shape: Vec<usize> = list(&scene["shape"]).into_iter().map(|n| n as usize).collect();
    let pitch = list(&scene["pitch"]);
    let detector = Detector {
        rows: shape[0],
        columns: shape[1],
        pitch_u: pitch[0],
        pitch_v: pitch[1],
        offset_u: 0.0,
        offset_v: 0.0,
    };
    let scanner = Scanner { beam: Beam::Cone { dso: 5.0, dsd: 7.0 }, detector, grid: Grid::cube(4) };
    let pose = Pose { source: vector("source"), centre: vector("centre"), u: vector("u"), v: vector("v") };
    let views = Trajectory { angles: &[0.0], poses: Some(&[pose]) };
    views.validate(&scanner).unwrap();
    let rows = |name: &str| -> Vec<Vec<f64>> { scene["model"][name].as_array().unwrap().iter().map(list).collect() };
    let triples = |name: &str| rows(name).iter().map(|r| [r[0], r[1], r[2]]).collect::<Vec<_>>();
    let factors = Array3::from_shape_fn((1, shape[0], shape[1]), |(_, row, column)| {
        ((7 * row + 5 * column) % 11) as f64 / 4.0 - 1.25
    });
    let truth = list(&scene["image"]);
    // A model is of Student's t or of Gaussians: the Gaussian here is the limit.
    let model = |keep: &[usize]| {
        let pick = |values: Vec<[f64; 3]>| keep.iter().map(|&i| values[i]).collect::<Vec<_>>();
        let one = |name: &str| keep.iter().map(|&i| rows(name)[i][0]).collect::<Vec<_>>();
        Primitives::new(Parameters {
            mean: pick(triples("mean")),
            scale: pick(triples("scale")),
            quaternion: keep.iter().map(|&i| rows("quaternion")[i].clone().try_into().unwrap()).collect(),
            density: one("density"),
            nu: one("nu"),
        })
        .unwrap()
    };
    let parts = [model(&[0, 1]), model(&[2])];
    let image: Array3<f64> = parts
        .iter()
        .map(|part| projector::forward::<f64>(part, &scanner, views, Projection::Exact, 0.0))
        .reduce(|a, b| a + b)
        .unwrap();
    let error = image.iter().zip(&truth).fold(0.0_f64, |worst, (a, b)| worst.max((a - b).abs())) / peak(&truth);
    within!("image", error);
    for (part, first) in parts.iter().zip([0, 2]) {
        let found = projector::vjp(part, &scanner, views, Projection::Exact, 0.0, factors.view());
        for group in Group::ALL {
            let all: Vec<Vec<f64>> = scene["gradient"][group.key()].as_array().unwrap().iter().map(list).collect();
            let truth: Vec<f64> = all[first..first + part.len()].concat();
            let (found, size) = (found.group(group), peak(&truth));
            let error = found.iter().zip(&truth).fold(0.0_f64, |worst, (a, b)| worst.max((a - b).abs())) / size;
            // A Gaussian has no gradient to nu.
            if peak(&truth) == f64::MIN_POSITIVE {
                assert!(found.iter().all(|&found| found == 0.0), "{}", group.key());
            } else {
                within!("gradient", error, "{} of {first}", group.key());
            }
        }
    }
}

#[test]
fn contributions_boxes_and_confidence_follow_the_poses() {
    for scanner in scanners() {
        let (primitives, poses) = (scenes::primitives(KernelKind::StudentT, 30, 3), poses(&scanner));
        let views = along(&poses);
        let field = Field::<f64>::new(&primitives, 1e-2);
        for number in 0..views.len() {
            let view = field.seen_in(&views.view(&scanner, number), Projection::Exact);
            let image: Array2<f64> = view.image();
            for (row, column) in [(5, 8), (20, 30), (36, 2)] {
                let sum: f64 = view.contributions(row, column).iter().sum();
                within!((sum - image[[row, column]]).abs(), "{sum} against {}", image[[row, column]]);
            }
            let boxes = view.support_boxes();
            for (row, column) in [(5, 8), (20, 30)] {
                for (i, value) in view.contributions(row, column).into_iter().enumerate() {
                    let [top, bottom, left, right] = boxes[i];
                    let (row, column) = (row as f64, column as f64);
                    let within = top <= row && row <= bottom && left <= column && column <= right;
                    assert!(within || value == 0.0, "{i}: {value} outside of {:?}", boxes[i]);
                }
            }
        }
        let settings = Settings { sphere_points: 100, ..Settings::default() };
        let fast = Coverage::new(settings).confidence(&primitives, &scanner, views);
        assert_eq!(fast, naive_confidence::confidence(&primitives, &scanner, views, &settings));
        assert_ne!(fast, Coverage::new(settings).confidence(&primitives, &scanner, &ANGLES));
    }
}

#[test]
fn line_integrals_of_phantoms_and_volumes_follow_the_poses() {
    let scanner = scenes::cone();
    let poses = poses(&scanner);
    let ball = Phantom::by_name("axes", 0).unwrap();
    let exact = ball.project(&scanner, along(&poses)).unwrap();
    assert_eq!(exact.poses.as_deref(), Some(&poses[..]));
    for (number, pose) in poses.iter().enumerate() {
        for (row, column) in [(3, 4), (18, 22), (30, 40)] {
            let d = &scanner.detector;
            let along = |k: usize, n: usize, pitch: f64| (k as f64 + 0.5 - n as f64 / 2.0) * pitch;
            let pixel =
                pose.centre + pose.u * along(column, d.columns, d.pitch_u) + pose.v * along(row, d.rows, d.pitch_v);
            let ray = trgs::geometry::Ray { origin: pose.source, direction: (pixel - pose.source).normalize() };
            let expected = ball.line_integral(&ray) as f32;
            let found = exact.images[[number, row, column]];
            within!(relative(found.into(), expected.into()), "{found} and {expected}");
        }
    }
    let volume = Volume::new(scanner.grid, Array3::from_elem(scanner.grid.shape, 1.0)).unwrap();
    let ours = trilinear::project(&volume, &scanner, &exact).unwrap();
    assert_eq!(ours.poses, exact.poses);
}

fn noise(n: usize, salt: u64) -> Vec<f64> {
    (0..n as u64).map(|i| ((i * 2_654_435_761 + salt * 40_503) % 10_007) as f64 / 5003.5 - 1.0).collect()
}

#[test]
fn the_voxel_projector_of_posed_views_is_the_naive_one_and_its_adjoint_the_transpose() {
    for (mut scanner, model) in scanners().into_iter().flat_map(|s| [(s, RayModel::Joseph), (s, RayModel::Siddon)]) {
        scanner.detector = Detector { rows: 23, columns: 19, pitch_v: 0.157, pitch_u: 0.2, ..scanner.detector };
        let poses = poses(&scanner);
        let views = along(&poses);
        let projector = VoxelProjector::new(&scanner, model).unwrap();
        let x = Array3::from_shape_vec(scanner.grid.shape, noise(scanner.grid.voxels(), 1)).unwrap();
        let y = Array3::from_shape_vec((4, 23, 19), noise(4 * 23 * 19, 2)).unwrap();
        let forward = projector.forward(views, x.view()).unwrap();
        let mut hit = 0;
        for ((number, row, column), &value) in forward.indexed_iter() {
            let ray = views.view(&scanner, number).ray(row, column);
            let weights = trgs::classical::voxel_projector::naive::weights(model, &scanner.grid, &ray);
            let plain: f64 = weights.iter().map(|&(voxel, weight)| weight * x[voxel]).sum();
            hit += usize::from(!weights.is_empty());
            within!("projection", (value - plain).abs(), "{model:?} {number} {row} {column}: {value} and {plain}");
        }
        assert!(hit > 400, "{hit} rays");
        let adjoint = projector.adjoint(views, y.view()).unwrap();
        let dot = |a: &Array3<f64>, b: &Array3<f64>| {
            let (a, b) = (a.as_slice().unwrap(), b.as_slice().unwrap());
            reduce::sum_by(a.len(), &|i| a[i] * b[i])
        };
        let (left, right) = (dot(&forward, &y), dot(&x, &adjoint));
        let size = dot(&forward, &forward).sqrt() * dot(&y, &y).sqrt();
        within!("transpose", (left - right).abs() / size, "{model:?}: {left} and {right}");
        let (x32, y32) = (x.mapv(|v| v as f32), y.mapv(|v| v as f32));
        let run = || (projector.forward(views, x32.view()).unwrap(), projector.adjoint(views, y32.view()).unwrap());
        assert!(threads::install(1, run).unwrap() == threads::install(3, run).unwrap());
    }
}

/// A scan of `size`³ voxels and (2·size)² pixels of the torso.
fn scan(size: usize, views: usize, orbit: &Orbit) -> Dataset {
    let (pixels, pitch) = (2 * size, 4.0 / (2 * size) as f64);
    let detector =
        Detector { rows: pixels, columns: pixels, pitch_v: pitch, pitch_u: pitch, offset_u: 0.0, offset_v: 0.0 };
    let scanner = Scanner { beam: Beam::Cone { dso: 5.0, dsd: 7.0 }, detector, grid: Grid::cube(size) };
    let plan = Plan { views, test_views: 3, noise: Noise::LOW, seed: 5 };
    let phantom = Phantom::by_name("torso", 0).unwrap();
    simulate_on("torso", Object::Phantom(&phantom), &scanner, &plan, orbit).unwrap()
}

fn orbits() -> [(&'static str, Orbit); 3] {
    [
        ("helix", Orbit { turns: 3.0, pitch: 0.15, ..Orbit::CIRCLE }),
        ("roll", Orbit { roll: 3.0_f64.to_radians(), ..Orbit::CIRCLE }),
        ("axis shift", Orbit { axis_shift: 0.12, ..Orbit::CIRCLE }),
    ]
}

fn psnr(scan: &Dataset, volume: &Volume) -> f64 {
    psnr_3d(scan.truth.as_ref().unwrap().values.view(), volume.values.view()).value
}

#[test]
fn posed_scans_reconstruct_as_well_as_plain_ones() {
    let of_sart = |scan: &Dataset, views: &Projections| {
        let projector = VoxelProjector::new(&scan.scanner, RayModel::Joseph).unwrap();
        let settings = SartSettings { iterations: 6, order: Order::AngularDistance, ..SartSettings::default() };
        psnr(scan, &sart::<f32>(&projector, views, &settings, &mut |_| ControlFlow::Continue(())).unwrap())
    };
    let of_tv = |scan: &Dataset| {
        let projector = VoxelProjector::new(&scan.scanner, RayModel::Joseph).unwrap();
        let settings = TvSettings { iterations: 30, ..TvSettings::default() };
        psnr(scan, &tv::<f32>(&projector, &scan.train, &settings, None, &mut |_| ControlFlow::Continue(())).unwrap())
    };
    let of_primitives = |scan: &Dataset| {
        let mut config = Config::of(Method::TrGs);
        (config.iterations, config.model.points, config.density_control.cap) = (150, 1000, 1000);
        // The decision between samplings is not what is compared.
        (config.finish, config.sampling) = (Finish::None, Sampling::Point);
        psnr(scan, &trgs::reconstruct(scan, &config).unwrap().volume)
    };
    let plain = scan(32, 20, &Orbit::CIRCLE);
    let expected = [of_sart(&plain, &plain.train), of_tv(&plain), of_primitives(&plain)];
    for (name, orbit) in orbits() {
        let posed = scan(32, 20, &orbit);
        let found = [of_sart(&posed, &posed.train), of_tv(&posed), of_primitives(&posed)];
        let without = Projections { poses: None, ..posed.train.clone() };
        let ignored = of_sart(&posed, &without);
        for (found, expected) in found.into_iter().zip(expected) {
            within!("plain", expected - found, "{name}: {found} instead of {expected}");
        }
        beyond!("poses ignored", found[0] - ignored, "{name}: {ignored} dB");
    }
}

#[test]
fn filtered_backprojection_honours_a_shifted_axis_and_refuses_a_helix_with_the_reason() {
    let of = |scan: &Dataset, turn: Turn| fdk(&scan.scanner, &scan.train, Window::RamLak, turn);
    let plain = scan(32, 120, &Orbit::CIRCLE);
    let expected = psnr(&plain, &of(&plain, Turn::Measured).unwrap());
    let shifted = scan(32, 120, &Orbit { axis_shift: 0.3, ..Orbit::CIRCLE });
    let found = psnr(&shifted, &of(&shifted, Turn::Measured).unwrap());
    let ignored = Dataset { train: Projections { poses: None, ..shifted.train.clone() }, ..shifted.clone() };
    let ignored = psnr(&ignored, &of(&ignored, Turn::Measured).unwrap());
    // Opposite rays of the shifted axis lie between each other, which even helps.
    within!("plain", expected - found, "{found} instead of {expected}");
    beyond!("poses ignored", expected - ignored, "{ignored} dB");
    for (orbit, reason) in [
        (Orbit { turns: 3.0, pitch: 0.15, ..Orbit::CIRCLE }, "height"),
        (Orbit { roll: 0.05, ..Orbit::CIRCLE }, "v = "),
    ] {
        let refused = of(&scan(16, 8, &orbit), Turn::Full).unwrap_err().to_string();
        assert!(refused.contains(reason) && refused.contains("sart") && refused.contains("tr-gs"), "{refused}");
    }
    // A constant height is a circle.
    let scanner = plain.scanner;
    let high = |angle: &f64| Deviation { heights: [0.2; 2], ..Deviation::none(&scanner) }.pose(*angle);
    let poses: Vec<Pose> = plain.train.angles.iter().map(high).collect();
    let phantom = Phantom::by_name("torso", 0).unwrap();
    let train = phantom.project(&scanner, Trajectory { angles: &plain.train.angles, poses: Some(&poses) }).unwrap();
    let found = psnr(&plain, &fdk(&scanner, &train, Window::RamLak, Turn::Measured).unwrap());
    within!("height", expected - found, "{found} instead of {expected}");
}

#[test]
fn shifted_axes_keep_the_weights_of_short_scans_and_displaced_detectors_exact() {
    let centre = DVec3::new(0.15, -0.2, 0.1);
    let solid = trgs::scan::phantom::solid::Solid::new(
        trgs::scan::phantom::solid::Shape::Ellipsoid,
        0.6,
        centre,
        DVec3::splat(0.5),
    );
    let ball = Phantom { name: "ball".into(), solids: vec![solid] };
    let (radius, half) = (0.35, 0.2);
    let mean = |volume: &Volume| {
        let inside = |index: (usize, usize, usize)| {
            let at = volume.grid.centre(index.into());
            at.distance(centre) < radius && at.z.abs() < half
        };
        let values: Vec<f64> =
            volume.values.indexed_iter().filter(|(i, _)| inside(*i)).map(|(_, v)| f64::from(*v)).collect();
        reduce::sum(&values) / values.len() as f64
    };
    let wide = Detector { rows: 96, columns: 110, pitch_v: 0.035, pitch_u: 0.03, offset_u: 0.0, offset_v: 0.0 };
    let displaced = Detector { columns: 80, offset_u: 0.6, ..wide };
    for (what, detector, span) in [("full", wide, TAU), ("short", wide, 4.2), ("displaced", displaced, TAU)] {
        for shift in [0.0, 0.25, -0.25] {
            let scanner = Scanner { beam: Beam::Cone { dso: 5.0, dsd: 7.0 }, detector, grid: Grid::cube(40) };
            let angles = Scanner::uniform_angles(150, 0.9, span);
            let deviation = Deviation { axis_shift: shift, ..Deviation::none(&scanner) };
            let poses: Vec<Pose> = angles.iter().map(|&angle| deviation.pose(angle)).collect();
            let train = ball.project(&scanner, Trajectory { angles: &angles, poses: Some(&poses) }).unwrap();
            let found = mean(&fdk(&scanner, &train, Window::RamLak, Turn::Measured).unwrap());
            within!(relative(found, 0.6), "{what}, shift {shift}: {found}");
        }
    }
}

#[test]
fn a_posed_scan_is_written_and_read_again_and_selections_keep_their_poses() {
    let folder = tempfile::tempdir().unwrap();
    for beam in [Beam::Cone { dso: 5.0, dsd: 7.0 }, Beam::Parallel { dso: 5.0 }] {
        let mut scan = scan(8, 5, &Orbit { turns: 2.0, pitch: 0.2, roll: 0.1, axis_shift: 0.05 });
        scan.scanner.beam = beam;
        if matches!(beam, Beam::Parallel { .. }) {
            let upright = |pose: &Pose| Pose { source: pose.centre - pose.u.cross(pose.v) * 10.0, ..*pose };
            for views in [Some(&mut scan.train), scan.test.as_mut()].into_iter().flatten() {
                views.poses = views.poses.as_ref().map(|poses| poses.iter().map(upright).collect());
            }
        }
        let path = folder.path().join(format!("{beam:?}").replace(|c: char| !c.is_alphanumeric(), ""));
        scan.write(&path).unwrap();
        let read = Dataset::read(&path).unwrap();
        assert_eq!(
            (read.scanner, &read.train.angles, &read.train.images),
            (scan.scanner, &scan.train.angles, &scan.train.images)
        );
        // The detector of the parallel beam is not as wide as the volume.
        assert_eq!(read.oddities.len(), usize::from(matches!(beam, Beam::Parallel { .. })), "{:?}", read.oddities);
        for (read, written) in [(&read.train, &scan.train), (read.test.as_ref().unwrap(), scan.test.as_ref().unwrap())]
        {
            for (a, b) in read.poses.as_ref().unwrap().iter().zip(written.poses.as_ref().unwrap()) {
                within!("places", a.source.distance(b.source).max(a.centre.distance(b.centre)));
                within!("axes", a.u.distance(b.u).max(a.v.distance(b.v)));
            }
        }
        let few = scan.train.select(&[3, 1]);
        assert_eq!(few.poses.as_ref().unwrap()[0], scan.train.poses.as_ref().unwrap()[3]);
        let half = scan.clone().subsample(2, Some(2), 0).unwrap();
        assert_eq!((half.train.poses.unwrap().len(), half.test.unwrap().poses.unwrap().len()), (2, 2));
    }
}

/// A pose is part of the data: a checkpoint of other poses is refused.
#[test]
fn a_checkpoint_of_other_poses_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("checkpoint");
    let posed = scan(16, 6, &Orbit { axis_shift: 0.05, ..Orbit::CIRCLE });
    let mut config = Config::of(Method::TrGs);
    (config.iterations, config.checkpoint_every) = (6, 3);
    (config.model.points, config.density_control.cap, config.finish) = (50, 50, Finish::None);
    let run = |dataset: &Dataset| {
        let from = file.exists().then(|| trgs::reconstruction::Checkpoint::read(&file)).transpose()?;
        let run = trgs::reconstruction::Run::new(dataset, &config);
        let checkpoints = trgs::reconstruction::Checkpoints { file: file.clone(), from };
        run.checkpoints(checkpoints).reconstruct()
    };
    run(&posed).unwrap();
    let other = Dataset { train: Projections { poses: None, ..posed.train.clone() }, ..posed.clone() };
    assert!(run(&other).unwrap_err().to_string().contains("other projections"));
}
