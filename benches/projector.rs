//! Cost of the projector in nanoseconds per (pixel, primitive): forward and backward, exact and affine, Student's t
//! and Gaussian, f32 and f64, on one thread.
//!
//! The scene is a lattice of 50,653 rotated primitives whose supports are about 22 × 22 pixels of a 512 × 512
//! detector. Pairs are the pixels in the bounding boxes of all supports. `cargo bench --bench projector`

use criterion::measurement::{Measurement, ValueFormatter, WallTime};
use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use ndarray::Array2;
use std::hint::black_box;
use std::time::{Duration, Instant};
use trgs::numeric::threads::Pool;
use trgs::primitives::{Kernel, Parameters, Primitives};
use trgs::projector::{Field, Kernels, Projection};
use trgs::scene::{Beam, Detector, Grid, Scanner};

const SIDE: usize = 37;
const CUTOFF: f64 = 1e-3;
const PIXELS: usize = 512;

/// Wall time whose throughput reads as time per pair instead of pairs per time.
struct TimePerPair(WallTime);

impl Measurement for TimePerPair {
    type Intermediate = Instant;
    type Value = Duration;

    fn start(&self) -> Instant {
        self.0.start()
    }
    fn end(&self, began: Instant) -> Duration {
        self.0.end(began)
    }
    fn add(&self, a: &Duration, b: &Duration) -> Duration {
        self.0.add(a, b)
    }
    fn zero(&self) -> Duration {
        self.0.zero()
    }
    fn to_f64(&self, value: &Duration) -> f64 {
        self.0.to_f64(value)
    }
    fn formatter(&self) -> &dyn ValueFormatter {
        self
    }
}

impl ValueFormatter for TimePerPair {
    fn scale_values(&self, typical: f64, values: &mut [f64]) -> &'static str {
        self.0.formatter().scale_values(typical, values)
    }
    fn scale_throughputs(&self, typical: f64, throughput: &Throughput, values: &mut [f64]) -> &'static str {
        match *throughput {
            Throughput::Elements(pairs) => {
                values.iter_mut().for_each(|nanoseconds| *nanoseconds /= pairs as f64);
                "ns/(pixel, primitive)"
            }
            _ => self.0.formatter().scale_throughputs(typical, throughput, values),
        }
    }
    fn scale_for_machines(&self, values: &mut [f64]) -> &'static str {
        self.0.formatter().scale_for_machines(values)
    }
}

fn scanner() -> Scanner {
    let pitch = 4.0 / PIXELS as f64;
    Scanner {
        beam: Beam::Cone { dso: 5.0, dsd: 7.0 },
        detector: Detector {
            rows: PIXELS,
            columns: PIXELS,
            pitch_v: pitch,
            pitch_u: pitch,
            offset_u: 0.0,
            offset_v: 0.0,
        },
        grid: Grid::cube(64),
    }
}

fn primitives(kernel: Kernel) -> Primitives {
    let m = SIDE * SIDE * SIDE;
    let at = |k: usize| (k as f64 + 0.5) / SIDE as f64 * 1.6 - 0.8;
    // Scales at which the support at this cutoff is about 22 pixels wide.
    let scale = match kernel {
        Kernel::StudentT => 0.0125,
        Kernel::Gaussian => 0.0155,
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

fn bench<R: Kernels>(c: &mut Criterion<TimePerPair>, precision: &str) {
    let pool = Pool::new(1).expect("one thread");
    for kernel in [Kernel::StudentT, Kernel::Gaussian] {
        let field = Field::<R>::new(&primitives(kernel), CUTOFF);
        for projection in [Projection::Affine, Projection::Exact] {
            let scanner = scanner();
            let view = field.view(&scanner, 0.4, projection);
            let cotangent =
                Array2::from_shape_fn((PIXELS, PIXELS), |(v, u)| R::from_f64((v * 7 + u * 3) as f64 % 11.0 - 5.0));
            let mut gradient = field.zero_gradient();
            let mut group = c.benchmark_group(format!("{kernel:?}, {projection:?}, {precision}"));
            group.throughput(Throughput::Elements(view.support_pixels() as u64));
            group.warm_up_time(Duration::from_secs(1)).measurement_time(Duration::from_secs(2)).sample_size(20);
            group
                .bench_function("set-up", |b| b.iter(|| pool.run(|| black_box(field.view(&scanner, 0.4, projection)))));
            group.bench_function("forward", |b| b.iter(|| pool.run(|| black_box(view.image()))));
            group.bench_function("backward", |b| {
                b.iter(|| pool.run(|| view.pull_back(cotangent.view(), &mut gradient)))
            });
            group.finish();
        }
    }
}

fn all(c: &mut Criterion<TimePerPair>) {
    bench::<f32>(c, "f32");
    bench::<f64>(c, "f64");
}

criterion_group!(name = benches; config = Criterion::default().with_measurement(TimePerPair(WallTime)); targets = all);
criterion_main!(benches);
