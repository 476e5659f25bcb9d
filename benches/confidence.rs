//! Cost of the ray confidence in sphere points per second: primitives × views × points.
//!
//! 18 views and 512 points, on one thread. `cargo bench --bench confidence`

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use std::hint::black_box;
use trgs::confidence::{Coverage, Settings};
use trgs::geometry::{Beam, Detector, Grid, Scanner};
use trgs::numeric::elementary::{cos, sin};
use trgs::numeric::threads::WorkerPool;
use trgs::primitives::{Parameters, Primitives};

const VIEWS: usize = 18;

/// `m` rotated primitives along a spiral, with axes up to 1:4.
fn primitives(m: usize) -> Primitives {
    let mut parameters = Parameters::zeros(m);
    for i in 0..m {
        let t = i as f64;
        parameters.mean[i] = [0.8 * sin(0.01 * t), 0.7 * cos(0.013 * t), 0.9 * sin(0.0007 * t)];
        parameters.scale[i] = [0.01, 0.02 + 0.01 * sin(0.3 * t), 0.02 + 0.02 * cos(0.7 * t).abs()];
        parameters.quaternion[i] = [cos(0.1 * t), 0.5, sin(0.2 * t), 0.3];
        parameters.density[i] = 1.0;
        parameters.nu[i] = 5.0;
    }
    Primitives::new(parameters).unwrap()
}

fn confidence(criterion: &mut Criterion) {
    let detector = Detector { rows: 128, columns: 128, pitch_v: 0.03, pitch_u: 0.03, offset_u: 0.0, offset_v: 0.0 };
    let scanner = Scanner { beam: Beam::Cone { dso: 5.0, dsd: 7.0 }, detector, grid: Grid::cube(64) };
    let angles = Scanner::uniform_angles(VIEWS, 0.0, std::f64::consts::TAU);
    let (settings, pool) = (Settings::default(), WorkerPool::new(1).unwrap());
    let coverage = Coverage::new(settings);
    let mut group = criterion.benchmark_group("confidence");
    for m in [5_000, 50_000] {
        let primitives = primitives(m);
        group.throughput(Throughput::Elements((m * VIEWS * settings.sphere_points) as u64));
        group.sample_size(10).bench_function(format!("{m} primitives"), |bencher| {
            bencher.iter(|| pool.run(|| black_box(coverage.confidence(black_box(&primitives), &scanner, &angles))));
        });
    }
    group.finish();
}

criterion_group!(benches, confidence);
criterion_main!(benches);
