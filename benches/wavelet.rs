//! Cost of the wavelet regularisation of a block of 32³ voxels, on one thread and on all.
//!
//! Measures routing among few and many primitives, and the loss with its gradient. `cargo bench --bench wavelet`

use criterion::{Criterion, criterion_group, criterion_main};
use ndarray::Array3;
use rand::RngExt;
use std::hint::black_box;
use std::time::Duration;
use trgs::geometry::Grid;
use trgs::numeric::Real;
use trgs::numeric::rng::{Purpose, stream};
use trgs::numeric::threads::WorkerPool;
use trgs::wavelet::{Router, Routing, Settings, route, wavelet_loss};

const SIDE: usize = 32;

fn uniform(seed: u64, n: usize) -> Vec<f64> {
    let mut random = stream(seed, Purpose::Phantom, 0, 0);
    (0..n).map(|_| random.random::<f64>()).collect()
}

/// A block in the middle of a volume of 128³ voxels, and primitives all over the volume.
fn routing(c: &mut Criterion) {
    let grid = Grid::cube(128).block([40, 48, 56], [SIDE; 3]);
    for m in [5_000, 50_000] {
        let means: Vec<[f64; 3]> =
            uniform(1, 3 * m).chunks_exact(3).map(|c| [c[0], c[1], c[2]].map(|x| 2.0 * x - 1.0)).collect();
        let confidence = uniform(2, m);
        let mut group = c.benchmark_group(format!("routing, 32³ voxels, {m} primitives"));
        group.sample_size(10).warm_up_time(Duration::from_secs(1)).measurement_time(Duration::from_secs(3));
        for threads in [1, 0] {
            let pool = WorkerPool::new(threads).expect("threads");
            let name = if threads == 1 { "one thread" } else { "all threads" };
            group.bench_function(name, |b| {
                b.iter(|| pool.run(|| black_box(route(&grid, &means, &confidence, &Settings::default()).unwrap())));
            });
            let (mut router, mut routing, settings) = (Router::default(), Routing::default(), Settings::default());
            let mut again = || router.route_into(&grid, &means, &confidence, &settings, &mut routing).unwrap();
            group.bench_function(format!("{name}, with an earlier tree"), |b| b.iter(|| pool.run(&mut again)));
        }
        group.finish();
    }
}

fn loss<R: Real>(c: &mut Criterion, precision: &str) {
    let values = uniform(3, SIDE * SIDE * SIDE).into_iter().map(R::from_f64).collect();
    let block = Array3::from_shape_vec([SIDE; 3], values).expect("a block");
    let high = Array3::from_shape_fn([SIDE; 3], |(x, y, z)| ((x + 3 * y + 5 * z) % 9) as u16);
    let routing = Routing { high, neighbours: 8 };
    let mut group = c.benchmark_group(format!("loss and gradient, 32³ voxels, {precision}"));
    group.sample_size(20).warm_up_time(Duration::from_secs(1)).measurement_time(Duration::from_secs(2));
    for threads in [1, 0] {
        let pool = WorkerPool::new(threads).expect("threads");
        let name = if threads == 1 { "one thread" } else { "all threads" };
        group.bench_function(name, |b| {
            b.iter(|| pool.run(|| black_box(wavelet_loss(block.view(), &routing, &Settings::default()))));
        });
    }
    group.finish();
}

fn losses(c: &mut Criterion) {
    loss::<f32>(c, "f32");
    loss::<f64>(c, "f64");
}

criterion_group!(benches, routing, losses);
criterion_main!(benches);
