//! The passes outside the projector, each compared with the machine's limit.
//!
//! On one thread. First the machine is measured: fused multiply-adds of whole f32 registers per second, divisions and
//! square roots (also in f64), and bytes per second of a copy between arrays larger than all caches. The time of a pass
//! is bounded by its arithmetic (operations on whole registers, counted in the source, at most one per multiply-add),
//! by its divisions and roots, for which a core has one unit, and by its memory traffic if the data exceed the caches.
//! The largest of these is the bound; the share is bound / time. A pass reuses its buffers, as in a run, and allocates
//! no memory. The fastest of several runs counts for machine and passes, since other processes slow both down.
//!
//! `cargo bench --bench passes`

mod trained;

use criterion::Criterion;
use ndarray::{Array2, Array3};
use std::cell::RefCell;
use std::hint::black_box;
use std::time::{Duration, Instant};
use trgs::confidence::{Coverage, Settings};
use trgs::config::{Config, Method};
use trgs::geometry::Scanner;
use trgs::loss::tv::{self, tv_into};
use trgs::loss::{Ssim, SsimTarget, image_loss_into};
use trgs::neural::NeuralRun;
use trgs::numeric::threads::WorkerPool;
use trgs::numeric::{Lanes, Real, real};
use trgs::optim::Adam;
use trgs::projector::Field;
use trgs::scan::simulate::{Object, Plan, simulate};
use trgs::scan::{Noise, Phantom};
use trgs::wavelet::{self, Routing, wavelet_loss_into};

type F32s = <f32 as Real>::Lanes;
type F64s = <f64 as Real>::Lanes;

const VIEWS: usize = 18;
const SIDE: usize = 32;

/// Rates of one thread.
struct Machine {
    /// Operations on whole f32 registers per second.
    operations: f64,
    /// Divisions per second of f32 and of f64 registers; square roots follow.
    divisions: [f64; 2],
    roots: [f64; 2],
    /// Bytes read plus bytes written per second by a copy.
    bytes: f64,
}

/// Seconds of the fastest of several runs.
fn fastest(work: &dyn Fn()) -> f64 {
    let time = |_| {
        let began = Instant::now();
        work();
        began.elapsed().as_secs_f64()
    };
    (0..7).map(time).fold(f64::INFINITY, f64::min)
}

/// Steps on a register per second, when no step waits for another.
fn rate<L: Lanes>(step: impl Fn(L, L) -> L) -> f64 {
    const CHAINS: usize = 12;
    const STEPS: usize = 1_000_000;
    let chains = || {
        let [mut chains, factor] = [1e-3, 0.999].map(|x| [L::splat(real(black_box(x))); CHAINS]);
        for _ in 0..STEPS {
            chains.iter_mut().zip(factor).for_each(|(chain, factor)| *chain = step(*chain, factor));
        }
        black_box(chains.map(|chain| chain.sum()));
    };
    (CHAINS * STEPS) as f64 / fastest(&chains)
}

impl Machine {
    fn measure() -> Self {
        let length = 1 << 25;
        let (from, to) = (vec![1.0_f32; length], RefCell::new(vec![0.0_f32; length]));
        let copy = || {
            to.borrow_mut().copy_from_slice(&from);
            black_box(&to);
        };
        Self {
            operations: rate::<F32s>(|x, factor| x.fma(factor, factor)),
            divisions: [rate::<F32s>(|x, factor| factor / x), rate::<F64s>(|x, factor| factor / x)],
            roots: [rate::<F32s>(|x, _| x.sqrt()), rate::<F64s>(|x, _| x.sqrt())],
            bytes: 8.0 * length as f64 / fastest(&copy),
        }
    }
}

/// The minimum work of a pass.
#[derive(Default)]
struct Work {
    /// Operations on whole registers.
    operations: f64,
    /// Divisions of f32 and of f64 registers; square roots follow.
    divisions: [f64; 2],
    roots: [f64; 2],
    /// Bytes from and to memory.
    bytes: f64,
}

impl Work {
    /// The least time for it in seconds, and the unit that takes it.
    fn bound(&self, machine: &Machine) -> (f64, &'static str) {
        let of_unit = |i: usize| self.divisions[i] / machine.divisions[i] + self.roots[i] / machine.roots[i];
        let bounds = [
            (self.operations / machine.operations, "arithmetic"),
            (of_unit(0) + of_unit(1), "divisions and roots"),
            (self.bytes / machine.bytes, "memory"),
        ];
        bounds.into_iter().max_by(|a, b| a.0.total_cmp(&b.0)).expect("three bounds")
    }
}

fn all(c: &mut Criterion) {
    let machine = Machine::measure();
    println!(
        "this machine, a thread: {:.2}e9 operations on registers of {} f32, {:.2}e9 divisions and {:.2}e9 roots \
         ({:.2}e9 and {:.2}e9 of f64), {:.1}e9 bytes copied a second\n",
        machine.operations / 1e9,
        F32s::WIDTH,
        machine.divisions[0] / 1e9,
        machine.roots[0] / 1e9,
        machine.divisions[1] / 1e9,
        machine.roots[1] / 1e9,
        machine.bytes / 1e9
    );
    let mut group = c.benchmark_group("passes");
    group.sample_size(10).warm_up_time(Duration::from_millis(300)).measurement_time(Duration::from_secs(2));
    let mut rows = Vec::new();
    let mut pass = |name: &'static str, work: Work, run: &dyn Fn()| {
        let mut seconds = f64::INFINITY;
        group.bench_function(name, |b| {
            b.iter_custom(|n| {
                let began = Instant::now();
                (0..n).for_each(|_| run());
                let spent = began.elapsed();
                seconds = seconds.min(spent.as_secs_f64() / n as f64);
                spent
            });
        });
        if seconds.is_finite() {
            rows.push((name, work, seconds));
        }
    };
    let (f32s, f64s) = (F32s::WIDTH as f64, F64s::WIDTH as f64);
    let voxels = (SIDE * SIDE * SIDE) as f64;

    // 12 blurs along a row or a column, 10 operations each (five sums, five multiply-adds); two products, the index and
    // its slopes 25, the gradient of the products 2; L1 and its slope 10, sums 3. Moves between lanes are not counted.
    // Both images, the target's mean and variance and the gradient, one number each per pixel, exceed the inner caches.
    let (ssim, pixels) = (Ssim::<f32>::default(), 512 * 512);
    let picture = |k: usize| Array2::from_shape_fn((512, 512), |(v, u)| ((v * k + u * 3) % 11) as f32 / 11.0);
    let (image, target) = (picture(5), SsimTarget::new(&ssim, picture(7).view()));
    let registers = pixels as f64 / f32s;
    let work = Work {
        operations: 162.0 * registers,
        divisions: [registers, 0.0],
        bytes: 20.0 * pixels as f64,
        ..Work::default()
    };
    let cotangent = RefCell::new(Array2::default(image.dim()));
    pass("L1 and SSIM with gradient, 512²", work, &|| {
        black_box(image_loss_into(&ssim, 0.25, image.view(), &target, &mut cotangent.borrow_mut()));
    });

    // Six differences, two of them masked, their signs 30 and the sum of these 5, the slope; three distances and their
    // sum 5, accumulated in f64 10.
    let block = Array3::from_shape_fn([SIDE; 3], |(x, y, z)| ((x * 7 + y * 5 + z * 3) % 13) as f32 / 13.0);
    let work = Work { operations: 59.0 * voxels / f32s, ..Work::default() };
    let (workspace, of_block) = (tv::Workspace::default(), RefCell::new(Array3::default(block.dim())));
    pass("total variation with gradient, 32³", work, &|| {
        black_box(tv_into(block.view(), &workspace, &mut of_block.borrow_mut()));
    });

    // Forward 36 operations per register of lanes, backward 44, as in the kernels (README.md); 19 and 38 per column of
    // registers. Work done once per primitive, or per eight of its slices, is left out.
    let [trained, _] = &trained::TRAINED;
    let (physical, scanner) = (trained.primitives(), trained.scanner());
    let field = Field::<f32>::new(&physical, 1e-3);
    let grid = scanner.grid.block([16; 3], [SIDE; 3]);
    let (gradient, volume) = (RefCell::new(field.zero_gradient()), RefCell::new(Array3::default(block.dim())));
    let pairs = field.on(&grid).utilisation();
    let (registers, columns) = (pairs.evaluated as f64 / f32s, pairs.columns as f64);
    pass(
        "voxels of a 32³ block of 64³, 5,000 primitives",
        Work { operations: 36.0 * registers + 19.0 * columns, ..Work::default() },
        &|| {
            field.on(&grid).voxels_into(&mut volume.borrow_mut());
        },
    );
    pass("and back", Work { operations: 44.0 * registers + 38.0 * columns, ..Work::default() }, &|| {
        field.on(&grid).vjp(block.view(), &mut gradient.borrow_mut());
    });

    // 14 operations in f64, three divisions and a root among them; value and two moments there and back, a gradient.
    let n = 650_000;
    let (adam, values) = (RefCell::new(Adam::new(n, [0.9, 0.999], 1e-15)), RefCell::new(vec![0.5; n]));
    let slopes: Vec<f64> = (0..n).map(|i| (i % 17) as f64 - 8.0).collect();
    let registers = n as f64 / f64s;
    let work = Work {
        operations: 14.0 * registers,
        divisions: [0.0, 3.0 * registers],
        roots: [0.0, registers],
        bytes: 56.0 * n as f64,
    };
    pass("Adam, 50,000 primitives of 13 numbers", work, &|| {
        adam.borrow_mut().step(&mut values.borrow_mut(), &slopes, 1e-4);
    });

    // For each point of the sphere and each view: a product of two vectors 5, its square, a difference, the minimum.
    let (settings, angles) = (Settings::default(), Scanner::uniform_angles(VIEWS, 0.0, std::f64::consts::TAU));
    let coverage = Coverage::new(settings);
    let points = (physical.len() * VIEWS * settings.sphere_points) as f64;
    pass(
        "confidence, 5,000 primitives, 18 views",
        Work { operations: 8.0 * points / f64s, ..Work::default() },
        &|| {
            black_box(coverage.confidence(&physical, &scanner, &angles));
        },
    );

    // Six bands, for a register of cells, which is eight registers of voxels: differences and their squares 22, sums of
    // squares 14, weights and sums of each voxel 32, of halves of cells 14, inflow and outflow of these 14, cells in
    // f64 8, across borders 6. The transform and its inverse 32 each; the weights of a voxel 1.
    let routing =
        Routing { high: Array3::from_shape_fn([SIDE; 3], |(x, y, z)| ((x + 3 * y + 5 * z) % 9) as u16), neighbours: 8 };
    let registers = voxels / f32s;
    let operations = ((6.0 * 110.0 + 64.0) / 8.0 + 1.0) * registers;
    let of_bands = [6.0 * registers, 0.0];
    let work = Work { operations, divisions: of_bands, roots: of_bands, ..Work::default() };
    let workspace = wavelet::Workspace::default();
    pass("wavelet loss with gradient, 32³", work, &|| {
        let settings = wavelet::Settings::default();
        black_box(wavelet_loss_into(block.view(), &routing, &settings, &workspace, &mut of_block.borrow_mut()));
    });

    // A product for each weight and register of samples, forward, to the input and to the weight. What the hash grid, the
    // functions between layers and Adam add is left out: it is what the share lacks.
    let plan = Plan { views: VIEWS, test_views: 0, noise: Noise::None, seed: 0 };
    let phantom = Phantom::by_name("torso", 0).expect("a phantom of this name");
    let scan = simulate("torso", Object::Phantom(&phantom), &scanner, &plan).expect("a scan of a phantom");
    for (method, name) in [(Method::Naf, "step of naf, 64³"), (Method::SaxNerf, "step of sax-nerf, 64³")] {
        let config = Config::of(method).plan(&scan.scanner, scan.train.len()).unwrap();
        let settings = config.neural();
        let run =
            NeuralRun::<f32>::new(&scan.scanner, &scan.train, &settings, 1.0, None).expect("a scan of this scanner");
        let batch = run.batch();
        let samples = batch.lengths.len() as f64;
        println!("{name}: {} rays of {} samples", batch.values.len(), settings.samples);
        let operations = 3.0 * settings.parameters() as f64 * samples / f32s;
        let run = RefCell::new(run);
        pass(name, Work { operations, ..Work::default() }, &|| {
            black_box(run.borrow_mut().train());
        });
    }
    group.finish();

    println!("\n| pass | ms | bound, ms | by | share |\n|---|---|---|---|---|");
    for (name, work, seconds) in rows {
        let (bound, by) = work.bound(&machine);
        println!("| {name} | {:.3} | {:.3} | {by} | {:.0} % |", seconds * 1e3, bound * 1e3, 100.0 * bound / seconds);
    }
}

/// Runs on one thread: `iteration` and `scaling` measure the gain from more threads.
fn main() {
    WorkerPool::new(1).expect("a thread").run(|| {
        let mut criterion = Criterion::default().configure_from_args();
        all(&mut criterion);
        criterion.final_summary();
    });
}
