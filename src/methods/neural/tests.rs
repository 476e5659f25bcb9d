//! Networks against plain scalar code, finite differences, and what a training must do.

use super::block::PARTS;
use super::encoding::{Encoding, FEATURES, Level};
use super::linear::HIDDEN;
use super::run::Model;
use super::{Kind, NeuralRun, NeuralSettings};
use crate::classical::algebraic::VoxelRun;
use crate::evaluation::psnr_3d;
use crate::memory::Sizes;
use crate::tolerances::largest;
use glam::DVec3;
use ndarray::Array3;
use rand::RngExt;
use trgs_core::geometry::{Beam, Detector, Grid, Scanner};
use trgs_core::numeric::{Real, threads};
use trgs_scan::simulate::{Object, Plan, simulate};
use trgs_scan::{Dataset, Noise, Phantom};
use wide::{f32x16, f64x8};

fn settings(kind: Kind) -> NeuralSettings {
    NeuralSettings {
        kind,
        iterations: 3,
        levels: 3,
        table: 12,
        samples: 12,
        rays: 30,
        sees_air: false,
        windows: 3,
        window: 2,
        rate: [1e-2, 3e-3],
        drop: 1000,
        is_bounded: true,
        ceiling: 1.25,
        pairs_neighbours: false,
        seed: 5,
    }
}

/// An offset detector and a volume that is no cube, with an odd number of slices.
fn scan(size: usize, views: usize) -> Dataset {
    let detector = Detector {
        rows: size,
        columns: size + 5,
        pitch_v: 3.4 / size as f64,
        pitch_u: 3.4 / size as f64,
        offset_u: 0.1,
        offset_v: -0.05,
    };
    let grid = Grid::new([size, size - 2, size - 1], DVec3::splat(-1.0), DVec3::new(1.0, 0.8, 0.9)).unwrap();
    let scanner = Scanner { beam: Beam::Cone { dso: 5.0, dsd: 7.0 }, detector, grid };
    let plan = Plan { views, test_views: 0, noise: Noise::None, seed: 1 };
    simulate("pepper", Object::Phantom(&Phantom::by_name("pepper", 0).unwrap()), &scanner, &plan).unwrap()
}

fn run<R: Real>(scan: &Dataset, settings: NeuralSettings) -> NeuralRun<'_, R> {
    NeuralRun::new(&scan.scanner, &scan.train, &settings, 0.7, None).unwrap()
}

#[test]
fn grid_points_are_joined_or_hashed_as_in_the_program_of_naf() {
    let Encoding::Hash(levels) = Encoding::hash(16, 19) else { unreachable!() };
    let sizes: Vec<u32> = levels.iter().map(|level| level.entries).collect();
    assert_eq!((&sizes[..4], sizes.iter().sum::<u32>()), (&[4913, 35_937, 274_625, 1 << 19][..], 7_131_219));
    assert_eq!(levels[3].first, 4913 + 35_937 + 274_625);
    let of = |level: usize, point: [u32; 3]| levels[level].entry(point) as u64;
    let joined = |point: [u32; 3], steps: [u64; 2]| {
        (u64::from(point[0]) + u64::from(point[1]) * steps[0] + u64::from(point[2]) * steps[1]) % (1 << 19)
    };
    let hashed = |point: [u32; 3]| {
        // In 64 bits, and then the lowest 32 of them.
        let [x, y, z] = point.map(u64::from);
        (x ^ (y * 19_349_663) ^ (z * 83_492_791)) as u32 as u64 % (1 << 19)
    };
    for point in [[3, 5, 7], [15, 16, 11], [1, 0, 16]] {
        assert_eq!(of(0, point), joined(point, [17, 289]));
        assert_eq!(of(2, point), joined(point, [65, 4225]));
        assert!((3..12).chain([14, 15]).all(|level| of(level, point) == hashed(point)));
        // The product of the sides overflows 32 bits and seems small.
        assert_eq!(of(12, point), joined(point, [65_537, 131_073]));
        assert_eq!(of(13, point), joined(point, [131_073, 262_145]));
    }
}

/// One sample, or two of a pair, through table and network in plain scalars.
fn plain(kind: Kind, settings: &NeuralSettings, parameters: &[f64], points: &[[f64; 3]], frame: [f64; 3]) -> Vec<f64> {
    let leaky = |x: f64| if x > 0.0 { x } else { 0.01 * x };
    let encoding = Encoding::hash(settings.levels, settings.table);
    let table = if kind == Kind::IntraTomo { 0 } else { encoding.parameters() };
    let mut at = table;
    let mut take = |n: usize| {
        at += n;
        parameters[at - n..at].to_vec()
    };
    let codes: Vec<Vec<f64>> =
        points.iter().map(|point| plain_code(kind, &encoding, parameters, *point, frame)).collect();
    let times = |w: &[f64], x: &[f64]| -> Vec<f64> {
        w.chunks(x.len()).map(|row| row.iter().zip(x).map(|(w, x)| w * x).sum()).collect()
    };
    let (count, joined) = if kind == Kind::IntraTomo { (8, 4) } else { (4, 2) };
    let mut x = codes.clone();
    for k in 0..count {
        if k == 1 && kind == Kind::SaxNerf {
            let parts: Vec<Vec<f64>> = PARTS.iter().map(|part| take(part.len())).collect();
            x = plain_block(&parts, &x).into_iter().map(|x| x.into_iter().map(leaky).collect()).collect();
            continue;
        }
        if k == joined {
            x = codes.iter().zip(x).map(|(code, x)| [code.clone(), x].concat()).collect();
        }
        let outputs = if k + 1 == count { 1 } else { HIDDEN };
        let (w, b) = (take(outputs * x[0].len()), take(outputs));
        for x in &mut x {
            let y = times(&w, x).into_iter().zip(&b).map(|(y, b)| y + b);
            *x = if k + 1 == count { y.collect() } else { y.map(leaky).collect() };
        }
    }
    x.iter().map(|x| settings.ceiling / (1.0 + libm::exp(-x[0]))).collect()
}

fn plain_code(kind: Kind, encoding: &Encoding, table: &[f64], point: [f64; 3], frame: [f64; 3]) -> Vec<f64> {
    if kind == Kind::IntraTomo {
        let p: Vec<f64> = (0..3).map(|axis| (2.0 * point[axis] - 1.0) * frame[axis]).collect();
        let waves = (0..6).flat_map(|k| [libm::sin, libm::cos].map(|wave| (f64::from(1 << k), wave)));
        let waves = waves.flat_map(|(factor, wave): (f64, fn(f64) -> f64)| {
            p.iter().map(move |p| wave(factor * p)).collect::<Vec<_>>()
        });
        return p.iter().copied().chain(waves).collect();
    }
    let Encoding::Hash(levels) = encoding else { unreachable!() };
    let mut code = Vec::new();
    for level in levels {
        let scaled = point.map(|x| x * f64::from(level.resolution - 1) + 0.5);
        for feature in 0..FEATURES {
            let mut sum = 0.0;
            for corner in [[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0], [0, 0, 1], [1, 0, 1], [0, 1, 1], [1, 1, 1]] {
                let cell: [u32; 3] = std::array::from_fn(|axis| scaled[axis] as u32 + corner[axis]);
                let weight: f64 = (0..3).map(|axis| 1.0 - (scaled[axis] - f64::from(cell[axis])).abs()).product();
                sum += weight * table[(level.first + level.entry(cell)) * FEATURES + feature];
            }
            code.push(sum);
        }
    }
    code
}

fn plain_block(parts: &[Vec<f64>], x: &[Vec<f64>]) -> Vec<Vec<f64>> {
    let [g1, s1, wq, wkv, positions, wo, bo, g2, s2, w1, w2, w3] = parts else { unreachable!() };
    let times = |w: &[f64], x: &[f64]| -> Vec<f64> {
        w.chunks(x.len()).map(|row| row.iter().zip(x).map(|(w, x)| w * x).sum()).collect()
    };
    let normal = |x: &[f64], gain: &[f64], shift: &[f64]| -> Vec<f64> {
        let mean = x.iter().sum::<f64>() / 32.0;
        let variance = x.iter().map(|x| (x - mean) * (x - mean)).sum::<f64>() / 32.0;
        (0..32).map(|i| (x[i] - mean) / (variance + 1e-5).sqrt() * gain[i] + shift[i]).collect()
    };
    let gelu = |x: f64| 0.5 * x * (1.0 + libm::erf(x / std::f64::consts::SQRT_2));
    let n: Vec<Vec<f64>> = x.iter().map(|x| normal(x, g1, s1)).collect();
    let (q, kv): (Vec<_>, Vec<_>) = n.iter().map(|n| (times(wq, n), times(wkv, n))).unzip();
    (0..2)
        .map(|own| {
            let mut mixed = vec![0.0; 32];
            for head in 0..8 {
                let score = |other: usize| {
                    let product: f64 = (0..4).map(|d| q[own][4 * head + d] * kv[other][4 * head + d]).sum();
                    libm::exp(product / 2.0 + positions[4 * head + 2 * own + other])
                };
                let [a, b] = [score(0), score(1)];
                for d in 0..4 {
                    let value = |other: usize| kv[other][32 + 4 * head + d];
                    mixed[4 * head + d] = (a * value(0) + b * value(1)) / (a + b);
                }
            }
            let y: Vec<f64> = times(wo, &mixed).iter().zip(bo).zip(&x[own]).map(|((o, b), x)| o + b + x).collect();
            let first: Vec<f64> = times(w1, &normal(&y, g2, s2)).into_iter().map(gelu).collect();
            let second: Vec<f64> = times(w2, &first).into_iter().map(gelu).collect();
            times(w3, &second).iter().zip(&y).map(|(f, y)| f + y).collect()
        })
        .collect()
}

/// Parameters of some size, where every part matters.
fn parameters(model: &Model, seed: u64) -> Vec<f64> {
    let mut values = model.begin(seed);
    values[..model.table].iter_mut().for_each(|value| *value *= 5e3);
    values
}

#[test]
fn densities_are_those_of_plain_scalars() {
    let grid = scan(9, 2).scanner.grid;
    let points: Vec<DVec3> = (0..37)
        .map(|k| {
            let turns = DVec3::new(0.618, 0.755, 0.57) * f64::from(k);
            grid.min + (turns - turns.floor()) * grid.size()
        })
        .collect();
    for kind in [Kind::Naf, Kind::SaxNerf, Kind::IntraTomo] {
        let settings = settings(kind);
        let model = Model::new(&grid, &settings);
        let parameters = parameters(&model, 3);
        let places: Vec<[f64; 3]> = points.iter().map(|&p| ((p - grid.min) / grid.size()).to_array()).collect();
        let expected: Vec<f64> = places
            .chunks(if kind == Kind::SaxNerf { 2 } else { 1 })
            .flat_map(|points| {
                // The last point has the first of all beside it.
                let pair = if kind == Kind::SaxNerf && points.len() == 1 {
                    vec![points[0], places[0]]
                } else {
                    points.to_vec()
                };
                plain(kind, &settings, &parameters, &pair, (grid.size() / 2.0).to_array())
            })
            .take(points.len())
            .collect();
        let spread = expected.iter().fold([f64::INFINITY, 0.0], |[a, b], &x| [a.min(x), b.max(x)]);
        beyond!("spread", spread[1] - spread[0], "{kind:?}: {spread:?}");
        let double = model.densities::<f64>(&grid, &parameters, &points);
        let single = model.densities::<f32>(&grid, &parameters, &points);
        let off = |found: &[f64]| largest(found.iter().zip(&expected).map(|(a, b)| a - b));
        within!("f64", off(&double), "{kind:?}");
        within!("f32", off(&single), "{kind:?}");
    }
}

#[test]
fn gradients_are_those_of_central_differences() {
    let scan = scan(9, 2);
    for (kind, is_bounded) in [(Kind::Naf, true), (Kind::Naf, false), (Kind::SaxNerf, true), (Kind::IntraTomo, true)] {
        let settings = NeuralSettings { is_bounded, ..settings(kind) };
        let mut run = run::<f64>(&scan, settings);
        let begin = parameters(&run.model, 4);
        run.parameters.clone_from(&begin);
        let (_, rays, gradient) = run.gradient();
        beyond!("rays", rays as f64);
        let largest_slope = gradient.iter().fold(0.0_f64, |top, value| top.max(value.abs()));
        let mut loss = |at: usize, by: f64| {
            run.parameters.clone_from(&begin);
            run.parameters[at] += by;
            let (error, rays, _) = run.gradient();
            error / rays as f64
        };
        let table =
            if kind == Kind::IntraTomo { 0 } else { Encoding::hash(settings.levels, settings.table).parameters() };
        // Entries of the table that rays meet, and numbers of every layer.
        let met = (0..table).filter(|&at| gradient[at] != 0.0).step_by(97).take(12);
        let step = (begin.len() - table) / 60;
        for at in met.chain((table..begin.len()).step_by(step)).chain([begin.len() - 1]) {
            let h = 1e-5;
            let numeric = (loss(at, h) - loss(at, -h)) / (2.0 * h);
            within!((numeric - gradient[at]).abs() / largest_slope, "{kind:?}, {at}: {numeric:e}, {:e}", gradient[at]);
        }
    }
}

#[test]
fn functions_between_layers_are_those_of_libm() {
    for k in -800..=800 {
        let x = f64::from(k) / 100.0;
        let (sigmoid, phi) = (1.0 / (1.0 + libm::exp(-x)), 0.5 * (1.0 + libm::erf(x / std::f64::consts::SQRT_2)));
        let expected = [sigmoid, x * phi, phi + x * libm::exp(-x * x / 2.0) / std::f64::consts::TAU.sqrt()];
        let found = |lanes: [f64; 3]| largest(lanes.iter().zip(expected).map(|(a, b)| a - b));
        let of = |[value, slope]: [f64x8; 2], s: f64x8| [s, value, slope].map(|lanes| lanes.to_array()[3]);
        within!(
            "f64",
            found(of(super::activation::gelu(f64x8::splat(x)), super::activation::sigmoid(f64x8::splat(x))))
        );
        let narrow = f32x16::splat(x as f32);
        let [value, slope] = super::activation::gelu(narrow);
        let single = [super::activation::sigmoid(narrow), value, slope].map(|lanes| f64::from(lanes.to_array()[7]));
        within!("f32", found(single), "{x}: {single:?}, {expected:?}");
    }
}

#[test]
fn the_number_of_threads_changes_no_bit_and_a_state_goes_on_to_the_same() {
    let scan = scan(9, 3);
    for kind in [Kind::Naf, Kind::SaxNerf, Kind::IntraTomo] {
        let train = |workers: usize, stop: usize| {
            threads::install(workers, || {
                let mut run = run::<f32>(&scan, settings(kind));
                (0..stop).for_each(|_| assert!(run.step().unwrap().is_some()));
                let state = run.state();
                let mut run =
                    NeuralRun::<f32>::new(&scan.scanner, &scan.train, &settings(kind), 0.7, Some(&state)).unwrap();
                while !run.is_finished() {
                    run.step().unwrap();
                }
                Box::new(run).into_volume().unwrap().values
            })
            .unwrap()
        };
        let once = train(1, 0);
        assert!(once.iter().all(|value| *value >= 0.0) && once.iter().any(|value| *value != once[[0, 0, 0]]));
        assert!(train(3, 0) == once && train(2, 2) == once, "{kind:?}");
    }
}

#[test]
fn a_voxel_has_itself_or_its_neighbour_as_partner() {
    // Nine slices: the last has no neighbour that is left.
    let scan = scan(10, 2);
    let grid = scan.scanner.grid;
    let place = |index: [usize; 3]| std::array::from_fn(|axis| (index[axis] as f64 + 0.5) / grid.shape[axis] as f64);
    let volumes = [false, true].map(|pairs_neighbours| {
        let settings = NeuralSettings { pairs_neighbours, ..settings(Kind::SaxNerf) };
        let mut run = run::<f64>(&scan, settings);
        run.parameters = parameters(&run.model, 6);
        let values = run.parameters.clone();
        let found = Box::new(run).into_volume().unwrap().values;
        for (z, partner) in [(0, 1), (1, 0), (6, 7), (7, 6), (8, 8)] {
            let index = [4, 5, z];
            let partner = [4, 5, if pairs_neighbours { partner } else { z }];
            let pair = if z % 2 == 0 { [place(index), place(partner)] } else { [place(partner), place(index)] };
            let expected = plain(Kind::SaxNerf, &settings, &values, &pair, (grid.size() / 2.0).to_array())[z % 2] * 0.7;
            within!((f64::from(found[index]) - expected).abs(), "{pairs_neighbours} {index:?}");
        }
        found
    });
    let differences = (&volumes[0] - &volumes[1]).mapv(f32::abs);
    beyond!("difference", f64::from(differences.iter().fold(0.0_f32, |top, &value| top.max(value))));
    assert!(differences.index_axis(ndarray::Axis(2), 8).iter().all(|difference| *difference == 0.0));
}

#[test]
fn training_finds_a_phantom() {
    let scan = scan(16, 8);
    let truth = scan.truth.as_ref().unwrap();
    for (kind, network_rate) in [(Kind::Naf, 3e-3), (Kind::SaxNerf, 1e-3)] {
        let settings = NeuralSettings {
            rate: [1e-2, network_rate],
            iterations: 300,
            samples: 24,
            rays: 128,
            sees_air: true,
            windows: 0,
            levels: 3,
            ..settings(kind)
        };
        let mut run = NeuralRun::<f32>::new(&scan.scanner, &scan.train, &settings, 1.0, None).unwrap();
        while !run.is_finished() {
            run.step().unwrap();
        }
        let found = Box::new(run).into_volume().unwrap();
        let psnr = |values: &Array3<f32>| psnr_3d(truth.values.view(), values.view()).value;
        let (found, nothing) = (psnr(&found.values), psnr(&Array3::zeros(truth.values.dim())));
        beyond!(found - nothing, "{kind:?}: {found} dB, zeros {nothing} dB");
    }
}

#[test]
fn points_of_a_ray_lie_in_the_box_in_order_and_stand_for_its_length() {
    let scan = scan(9, 2);
    let views = scan.train.trajectory().views(&scan.scanner);
    let rays = super::rays::chosen(&scan.scanner.grid, &views, &scan.train, &settings(Kind::SaxNerf), 1, 1.0);
    // 30 pixels with a value, and 3 windows of 4 wherever they meet the box.
    assert!((30..=42).contains(&rays.len()), "{}", rays.len());
    let (low, high) = (scan.scanner.grid.min, scan.scanner.grid.max());
    for (id, ray) in rays.iter().enumerate() {
        let mut random = trgs_core::numeric::rng::stream(0, trgs_core::numeric::rng::Purpose::Jitter, 0, id as u64);
        let draws: Vec<f64> = (0..12).map(|_| random.random()).collect();
        let points = super::rays::points(ray, &draws);
        let along: Vec<f64> = points.iter().map(|(p, _)| (*p - ray.ray.origin).dot(ray.ray.direction)).collect();
        assert!(along.windows(2).all(|pair| pair[0] < pair[1]), "{along:?}");
        assert!(points.iter().all(|(p, _)| p.cmpge(low - 1e-12).all() && p.cmple(high + 1e-12).all()));
        let total: f64 = points.iter().map(|point| point.1).sum();
        within!((total - (along[11] - along[0])).abs());
    }
}

/// A column of 601 voxels is more than a task of the volume has otherwise, if each of its points is a pair.
#[test]
fn the_samples_of_a_long_column_are_counted() {
    let sizes =
        Sizes { detector: 1, pixels: 1, voxels: 1, slice: 1, slices: 1, column: 1, real: 4, threads: 1, slabs: 1 };
    let together = |kind: Kind, pairs_neighbours: bool, column: usize| {
        let arrays = NeuralSettings { pairs_neighbours, ..settings(kind) }.phases(&Sizes { column, ..sizes }).concat();
        arrays.iter().find(|row| row.what == "samples in the network").unwrap().count
    };
    assert_eq!([false, true].map(|pairs| together(Kind::SaxNerf, pairs, 601)), [1202, 1024]);
    assert_eq!([false, true].map(|pairs| together(Kind::SaxNerf, pairs, 1601)), [3202, 1602]);
    assert_eq!([300, 1601].map(|column| together(Kind::Naf, false, column)), [1024, 1601]);
}

#[test]
fn levels_are_levels() {
    let level = Level { resolution: 16, entries: 4913, first: 0 };
    let points = [0.25, 0.5, 1.0].map(f64x8::splat);
    let mut gradient = vec![0.0; 4913 * FEATURES];
    level.add_gradient::<f64>(&points, &[f64x8::splat(1.0), f64x8::splat(2.0)], &mut gradient);
    // Weights of the corners of one cell sum to 1, for each of eight lanes.
    let sum = |feature: usize| gradient.iter().skip(feature).step_by(FEATURES).sum::<f64>();
    assert_eq!([sum(0), sum(1)], [8.0, 16.0]);
}
