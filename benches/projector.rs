//! Cost of the projector in nanoseconds per (pixel, primitive), on one thread.
//!
//! Measures forward and backward passes, exact and affine projection, Student's t and Gaussian, f32 and f64.
//!
//! There are two scenes. A lattice of 50,653 rotated primitives with supports of about 22 × 22 pixels on a 512 × 512
//! detector measures a typical projection. 10,648 primitives whose supports cover a whole detector of 32 × 32 measure
//! the kernels alone, without idle lanes. Pairs are the pixels in the bounding boxes of all supports. `cargo bench
//! --bench projector`

use criterion::measurement::{Measurement, ValueFormatter, WallTime};
use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use ndarray::Array2;
use std::hint::black_box;
use std::time::{Duration, Instant};
use trgs::geometry::{Beam, Detector, Grid, Scanner};
use trgs::numeric::threads::WorkerPool;
use trgs::primitives::{KernelKind, Parameters, Primitives};
use trgs::projector::{Field, Kernels, Projection};

const CUTOFF: f64 = 1e-3;

/// Primitives on a lattice in front of a square detector.
struct Scene {
    name: &'static str,
    /// Primitives along each axis of the lattice; half of the lattice's width follows.
    side: usize,
    half: f64,
    /// Scale of Student's t; a Gaussian with the same support at this cutoff has 1.24 times this scale.
    scale: f64,
    /// Rows and columns of the detector.
    pixels: usize,
}

const SCENES: [Scene; 2] = [
    Scene { name: "22² of 512²", side: 37, half: 0.8, scale: 0.0125, pixels: 512 },
    Scene { name: "32² of 32²", side: 22, half: 0.002, scale: 0.04, pixels: 32 },
];

/// Wall time whose throughput is displayed as time per pair instead of pairs per time.
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

impl Scene {
    fn scanner(&self) -> Scanner {
        let pitch = 4.0 / 512.0;
        Scanner {
            beam: Beam::Cone { dso: 5.0, dsd: 7.0 },
            detector: Detector {
                rows: self.pixels,
                columns: self.pixels,
                pitch_v: pitch,
                pitch_u: pitch,
                offset_u: 0.0,
                offset_v: 0.0,
            },
            grid: Grid::cube(64),
        }
    }

    fn primitives(&self, kernel: KernelKind) -> Primitives {
        let side = self.side;
        let m = side * side * side;
        let at = |k: usize| ((k as f64 + 0.5) / side as f64 * 2.0 - 1.0) * self.half;
        let scale = match kernel {
            KernelKind::StudentT => self.scale,
            KernelKind::Gaussian => 1.24 * self.scale,
        };
        Primitives::new(Parameters {
            mean: (0..m).map(|i| [at(i / (side * side)), at(i / side % side), at(i % side)]).collect(),
            scale: (0..m).map(|i| [scale, scale * 1.1, scale * (0.9 + 0.02 * (i % 7) as f64)]).collect(),
            quaternion: (0..m).map(|i| [1.0, 0.1 * (i % 5) as f64, -0.2, 0.07 * (i % 3) as f64]).collect(),
            density: vec![0.5; m],
            nu: vec![if kernel == KernelKind::Gaussian { f64::INFINITY } else { 10.0 }; m],
        })
        .expect("a valid lattice")
    }
}

fn bench<R: Kernels>(c: &mut Criterion<TimePerPair>, scene: &Scene, precision: &str) {
    let pool = WorkerPool::new(1).expect("one thread");
    let scanner = scene.scanner();
    for kernel in [KernelKind::StudentT, KernelKind::Gaussian] {
        let field = Field::<R>::new(&scene.primitives(kernel), CUTOFF);
        for projection in [Projection::Affine, Projection::Exact] {
            let view = field.view(&scanner, 0.4, projection);
            let cotangent = Array2::from_shape_fn((scene.pixels, scene.pixels), |(v, u)| {
                R::from_f64((v * 7 + u * 3) as f64 % 11.0 - 5.0)
            });
            let mut gradient = field.zero_gradient();
            let mut group = c.benchmark_group(format!("{}, {kernel:?}, {projection:?}, {precision}", scene.name));
            group.throughput(Throughput::Elements(view.support_pixels() as u64));
            group.warm_up_time(Duration::from_secs(1)).measurement_time(Duration::from_secs(2)).sample_size(20);
            group
                .bench_function("set-up", |b| b.iter(|| pool.run(|| black_box(field.view(&scanner, 0.4, projection)))));
            group.bench_function("forward", |b| b.iter(|| pool.run(|| black_box(view.image()))));
            group.bench_function("backward", |b| b.iter(|| pool.run(|| view.vjp(cotangent.view(), &mut gradient))));
            group.finish();
        }
    }
}

fn all(c: &mut Criterion<TimePerPair>) {
    for scene in &SCENES {
        bench::<f32>(c, scene, "f32");
        bench::<f64>(c, scene, "f64");
    }
}

criterion_group!(name = benches; config = Criterion::default().with_measurement(TimePerPair(WallTime)); targets = all);
criterion_main!(benches);
