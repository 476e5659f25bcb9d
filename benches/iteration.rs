//! Cost of a training iteration and of its parts, at 64³/128²/5,000 primitives and at 256³/512²/50,000.
//!
//! Each part runs alone on primitives with the statistics of a trained model: distribution of scales, anisotropy and ν
//! are those of two trained models. Parts that do not run in every iteration (wavelets 10, density control with the
//! confidence of new primitives 100, confidence of all 500) count with their fraction. After the measurements, a table
//! gives milliseconds per iteration and percentages. Runs on all cores; `cargo bench --bench iteration`

mod trained;

use criterion::Criterion;
use ndarray::Array2;
use std::cell::RefCell;
use std::hint::black_box;
use std::time::{Duration, Instant};
use trained::{TRAINED, Trained};
use trgs::confidence::{Coverage, nu_loss, nu_target};
use trgs::config::Config;
use trgs::density::{ar, next_parameters};
use trgs::geometry::Scanner;
use trgs::loss::tv::{self, tv_into};
use trgs::loss::{Ssim, SsimTarget, image_loss, image_loss_into};
use trgs::numeric::threads::WorkerPool;
use trgs::optim::sghmc::{NoiseInput, Phase};
use trgs::optim::{Adam, Sghmc};
use trgs::primitives::activation::Interval;
use trgs::primitives::{Activation, Group, KernelKind, Primitives};
use trgs::projector::Field;
use trgs::wavelet::{self, Router, Routing, wavelet_loss_into};

const VIEWS: usize = 18;

/// Mean time of each part, with the number of iterations between its runs.
#[derive(Default)]
struct Shares(RefCell<Vec<(&'static str, Duration, usize)>>);

impl Shares {
    fn print(&self, name: &str) {
        let parts = self.0.borrow();
        if parts.is_empty() {
            return;
        }
        let each = |(_, time, every): &(&str, Duration, usize)| time.as_secs_f64() * 1e3 / *every as f64;
        let total: f64 = parts.iter().map(each).sum();
        println!("\n{name}: {total:.2} ms per iteration");
        for part in parts.iter() {
            let once = part.1.as_secs_f64() * 1e3;
            println!(
                "  {:<28} {:8.3} ms {:5.1} %   ({once:.3} ms every {})",
                part.0,
                each(part),
                100.0 * each(part) / total,
                part.2
            );
        }
        let new = parts.iter().filter(|part| part.2 > 1 || part.0.starts_with("pull")).map(each).sum::<f64>();
        println!("  confidence, wavelets and density control together: {:.1} %\n", 100.0 * new / total);
    }
}

fn bench(c: &mut Criterion, trained: &Trained) {
    let Trained { voxels, pixels, primitives, .. } = *trained;
    let name = &format!("{voxels}³ voxels, {pixels}² pixels, {primitives} primitives");
    let (scanner, physical) = (trained.scanner(), trained.primitives());
    let (config, shares) = (Config::default().plan(&scanner, VIEWS).unwrap(), Shares::default());
    let (m, grid) = (physical.len(), scanner.grid);
    let angles = Scanner::uniform_angles(VIEWS, 0.0, std::f64::consts::TAU);
    let activation = Activation {
        kernel: KernelKind::StudentT,
        scale: Interval { min: 0.001, max: 1.0 },
        nu: Interval { min: 2.0, max: 100.0 },
    };
    let raw = activation.inverse(&physical.parameters);
    let field = Field::<f32>::new(&physical, config.cutoff);
    let view = field.view(&scanner, 0.4, config.projection);
    let image = view.image();
    let ssim = Ssim::<f32>::default();
    let target = SsimTarget::new(
        &ssim,
        Array2::from_shape_fn((pixels, pixels), |(v, u)| ((v * 7 + u * 3) % 11) as f32 / 11.0).view(),
    );
    let cotangent = image_loss(&ssim, 0.25, image.view(), &target).1;
    // As in a run, buffers of the last iteration are reused.
    let (prediction, of_image) = (RefCell::new(image.clone()), RefCell::new(cotangent.clone()));
    let (volume, slopes) = (RefCell::default(), RefCell::default());
    let workspace = (tv::Workspace::default(), wavelet::Workspace::default());
    let block = grid.block([grid.shape[0] / 4; 3], [32; 3]);
    let gradient = RefCell::new(field.zero_gradient());
    let settings = config.confidence.settings(scanner.grid.spacing.min_element());
    let coverage = Coverage::new(settings);
    let confidence = coverage.confidence(&physical, &scanner, &angles);
    let targets: Vec<f64> = confidence.iter().map(|&c| nu_target(c, &settings, activation.nu)).collect();
    let flat = field.parameter_gradient(&gradient.borrow());
    let adam = RefCell::new(Group::ALL.map(|group| Adam::new(m * group.width(), [0.9, 0.999], 1e-15)));
    let (sghmc, moved) = (RefCell::new(Sghmc::new(m)), RefCell::new(raw.clone()));

    let mut group = c.benchmark_group(name);
    group.sample_size(10).warm_up_time(Duration::from_millis(500)).measurement_time(Duration::from_secs(3));
    let mut part = |name: &'static str, every: usize, work: &dyn Fn()| {
        let (mut spent, mut runs) = (Duration::ZERO, 0);
        group.bench_function(name, |b| {
            b.iter_custom(|n| {
                let began = Instant::now();
                (0..n).for_each(|_| work());
                spent += began.elapsed();
                runs += n as u32;
                began.elapsed()
            });
        });
        if runs > 0 {
            shares.0.borrow_mut().push((name, spent / runs, every));
        }
    };
    part("raw to field", 1, &|| {
        black_box(Field::<f32>::new(&activation.forward(&raw), config.cutoff));
    });
    part("projection", 1, &|| {
        field.view(&scanner, 0.4, config.projection).image_into(&mut prediction.borrow_mut());
    });
    part("image loss", 1, &|| {
        black_box(image_loss_into(&ssim, 0.25, image.view(), &target, &mut of_image.borrow_mut()));
    });
    part("projection, back", 1, &|| view.vjp(cotangent.view(), &mut gradient.borrow_mut()));
    part("total variation", 1, &|| {
        let (there, mut volume, mut slopes) = (field.on(&block), volume.borrow_mut(), slopes.borrow_mut());
        there.voxels_into(&mut volume);
        black_box(tv_into(volume.view(), &workspace.0, &mut slopes));
        there.vjp(slopes.view(), &mut gradient.borrow_mut());
    });
    part("gradient to raw", 1, &|| {
        let mut gradient = field.parameter_gradient(&gradient.borrow());
        activation.vjp(&physical, &mut gradient);
        black_box(gradient);
    });
    part("optimisers", 1, &|| {
        let (mut adam, mut moved) = (adam.borrow_mut(), moved.borrow_mut());
        for (group, adam) in Group::ALL.into_iter().zip(adam.iter_mut()).skip(1) {
            adam.step(moved.group_mut(group), flat.group(group), 1e-4);
        }
        let mut direction = vec![[0.0; 3]; flat.len()];
        adam[0].direction(flat.group(Group::Mean), direction.as_flattened_mut());
        sghmc.borrow_mut().step(&mut moved.mean, &direction, 0.014, Phase::Sampling(50.0), |_| NoiseInput::GATE_CLOSED);
    });
    part("pull on ν", 1, &|| {
        black_box(nu_loss(&physical.parameters.nu, &targets, &confidence, 1e-3));
    });
    let routes = RefCell::new((Router::default(), Routing::default()));
    part("wavelets", config.wavelet.every, &|| {
        let settings = config.wavelet.settings();
        let (router, routing) = &mut *routes.borrow_mut();
        router.route_into(&block, &physical.parameters.mean, &confidence, &settings, routing).expect("finite means");
        let (there, mut volume, mut slopes) = (field.on(&block), volume.borrow_mut(), slopes.borrow_mut());
        there.voxels_into(&mut volume);
        black_box(wavelet_loss_into(volume.view(), routing, &settings, &workspace.1, &mut slopes));
        there.vjp(slopes.view(), &mut gradient.borrow_mut());
    });
    part("confidence of all", config.confidence.every, &|| {
        black_box(coverage.confidence(&physical, &scanner, &angles));
    });
    part("adding and recycling", config.density_control.every, &|| {
        let control = &config.density_control;
        let settings = ar::Settings {
            dead: control.dead,
            recycled: control.recycled,
            growth: control.growth,
            cap: usize::MAX,
            relocation: control.relocation,
        };
        let mut k = 0_u64;
        let next = ar::ar(&physical, &settings, || {
            k += 1;
            (k * 7919 % 10007) as f64 / 10007.0
        });
        let parameters = next_parameters(&physical.parameters, &next);
        black_box(activation.inverse(&parameters));
        let fresh: Vec<usize> = (0..next.len()).filter(|&row| next[row].fresh).collect();
        let next = Primitives::new(parameters).expect("valid primitives");
        black_box(coverage.confidence_of(&fresh, &next, &scanner, &angles));
    });
    group.finish();
    shares.print(name);
    for (what, pairs) in [("pixels", view.utilisation()), ("voxels", field.on(&block).utilisation())] {
        let each = pairs.active as f64 / m as f64;
        println!("  {each:.0} {what} of the supports for each primitive, {:.0} % of the lanes", 100.0 * pairs.ratio());
    }
}

/// Runs inside the worker pool, as a run does: work submitted from outside would wait for a worker.
fn main() {
    WorkerPool::new(0).expect("threads").run(|| {
        let mut criterion = Criterion::default().configure_from_args();
        TRAINED.iter().for_each(|trained| bench(&mut criterion, trained));
        criterion.final_summary();
    });
}
