//! Cost of the projector in nanoseconds per (pixel, primitive): forward and backward, exact and affine, f32 and f64.
//!
//! The scene is a lattice of primitives whose footprints are about 24 × 24 pixels on a 512 × 512 detector. Pairs are
//! counted as the pixels within every primitive's support, one thread; set-up of the footprints is included, once
//! per image. `cargo bench --bench projector`; the last lines are the table.

use criterion::{BenchmarkId, Criterion, Throughput, criterion_group, criterion_main};
use ndarray::Array2;
use std::hint::black_box;
use std::time::Duration;
use trgs::numeric::{Real, threads::Pool};
use trgs::primitives::{Kernel, Parameters, Primitives};
use trgs::projector::{Field, Projection};
use trgs::scene::{Beam, Detector, Grid, Scanner};

const SIDE: usize = 37;
const CUTOFF: f64 = 1e-3;

fn scanner() -> Scanner {
    Scanner {
        beam: Beam::Cone { dso: 5.0, dsd: 7.0 },
        detector: Detector {
            rows: 512,
            columns: 512,
            pitch_v: 4.0 / 512.0,
            pitch_u: 4.0 / 512.0,
            offset_u: 0.0,
            offset_v: 0.0,
        },
        grid: Grid::cube(64),
    }
}

/// A lattice of `SIDE`³ slightly elongated, rotated primitives.
fn primitives(kernel: Kernel) -> Primitives {
    let m = SIDE * SIDE * SIDE;
    let at = |k: usize| (k as f64 + 0.5) / SIDE as f64 * 1.6 - 0.8;
    // Scales at which a support of δ ≤ cut is about 24 pixels wide.
    let scale = match kernel {
        Kernel::StudentT => 0.0125,
        Kernel::Gaussian => 0.0172,
    };
    Primitives::new(Parameters {
        mean: (0..m).map(|i| [at(i / (SIDE * SIDE)), at(i / SIDE % SIDE), at(i % SIDE)]).collect(),
        scale: (0..m).map(|i| [scale, scale * 1.1, scale * (0.9 + 0.02 * (i % 7) as f64)]).collect(),
        quaternion: (0..m).map(|i| [1.0, 0.1 * (i % 5) as f64, -0.2, 0.07 * (i % 3) as f64]).collect(),
        density: vec![0.5; m],
        nu: vec![if kernel == Kernel::Gaussian { f64::INFINITY } else { 10.0 }; m],
    })
    .expect("a valid lattice")
}

fn bench<R: Real>(c: &mut Criterion, precision: &str) {
    let pool = Pool::new(1).expect("one thread");
    for kernel in [Kernel::StudentT, Kernel::Gaussian] {
        let primitives = primitives(kernel);
        let field = Field::<R>::new(&primitives, CUTOFF);
        for projection in [Projection::Affine, Projection::Exact] {
            let scanner = scanner();
            let view = field.view(&scanner, 0.4, projection);
            let pairs = view.support_pixels();
            let cotangent =
                Array2::from_shape_fn((512, 512), |(v, u)| R::from_f64((v * 7 + u * 3) as f64 % 11.0 - 5.0));
            let mut group = c.benchmark_group(format!("{kernel:?}/{projection:?}"));
            group
                .throughput(Throughput::Elements(pairs as u64))
                .measurement_time(Duration::from_secs(3))
                .sample_size(20);
            group.bench_function(BenchmarkId::new("forward", precision), |b| {
                b.iter(|| pool.run(|| black_box(view.image())))
            });
            let mut gradient = field.zero_gradient();
            group.bench_function(BenchmarkId::new("backward", precision), |b| {
                b.iter(|| pool.run(|| view.pull_back(cotangent.view(), &mut gradient)))
            });
            group.bench_function(BenchmarkId::new("set-up", precision), |b| {
                b.iter(|| pool.run(|| black_box(field.view(&scanner, 0.4, projection))))
            });
            group.finish();
        }
    }
}

fn all(c: &mut Criterion) {
    bench::<f32>(c, "f32");
    bench::<f64>(c, "f64");
}

criterion_group!(benches, all);
criterion_main!(benches);
