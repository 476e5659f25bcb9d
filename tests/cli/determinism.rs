//! Same input, same bits: for any number of threads, and for repeated runs in one or several processes.
//!
//! `.ci/builds` compares three instruction sets.

use crate::common::scenes;
use crate::program::Sandbox;
use sha2::{Digest, Sha256};
use std::ops::ControlFlow;
use trgs::classical::{Turn, Window, fdk};
use trgs::config::{Config, Precision};
use trgs::geometry::{Beam, Detector, Grid, Scanner};
use trgs::numeric::threads;
use trgs::primitives::{Group, KernelKind, Parameters};
use trgs::projector::{self, Kernels, Projection};
use trgs::scan::dataset::Dataset;
use trgs::scan::noise::Noise;
use trgs::scan::phantom::Phantom;
use trgs::scan::simulate::{Object, Plan, simulate};
use trgs::train;

fn digest(numbers: impl IntoIterator<Item = f64>) -> String {
    let mut hasher = Sha256::new();
    numbers.into_iter().for_each(|x| hasher.update(x.to_bits().to_le_bytes()));
    hasher.finalize().iter().map(|byte| format!("{byte:02x}")).collect()
}

fn digest_of(parameters: &Parameters) -> String {
    digest(Group::ALL.into_iter().flat_map(|group| parameters.group(group).to_vec()))
}

/// Asserts that `work` gives the same digest on 1, 2, 3 and 7 threads, and twice on the last.
fn assert_independent_of_threads(what: &str, work: impl Fn() -> String + Sync) {
    let alone = threads::install(1, &work).unwrap();
    for count in [2, 3, 7, 7] {
        assert_eq!(threads::install(count, &work).unwrap(), alone, "{what} on {count} threads");
    }
}

fn images_and_gradients<R: Kernels>(precision: &str) {
    let scanner =
        Scanner { detector: Detector { rows: 150, columns: 131, ..scenes::cone().detector }, ..scenes::cone() };
    let angles = [0.2, 3.0];
    for kernel in [KernelKind::StudentT, KernelKind::Gaussian] {
        let primitives = scenes::primitives(kernel, 700, 21);
        for projection in [Projection::Exact, Projection::Affine] {
            let what = format!("{precision} {kernel:?} {projection:?}");
            assert_independent_of_threads(&format!("image {what}"), || {
                let image = projector::forward::<R>(&primitives, &scanner, &angles, projection, 1e-3);
                digest(image.iter().map(|x| x.to_f64()))
            });
            let cotangent = scenes::cotangent(4, (2, 150, 131)).mapv(R::from_f64);
            assert_independent_of_threads(&format!("gradient {what}"), || {
                digest_of(&projector::vjp(&primitives, &scanner, &angles, projection, 1e-3, cotangent.view()))
            });
        }
        let cotangent = scenes::cotangent(4, scanner.grid.shape).mapv(R::from_f64);
        assert_independent_of_threads(&format!("volume {precision} {kernel:?}"), || {
            let volume = projector::voxelize::<R>(&primitives, &scanner.grid, 1e-3);
            let gradient = projector::voxelize_vjp(&primitives, &scanner.grid, 1e-3, cotangent.view());
            digest(volume.iter().map(|x| x.to_f64())) + &digest_of(&gradient)
        });
    }
}

#[test]
fn images_volumes_and_gradients_have_the_same_bits_on_any_number_of_threads() {
    images_and_gradients::<f32>("f32");
    images_and_gradients::<f64>("f64");
}

fn scan() -> Dataset {
    let scanner = Scanner {
        beam: Beam::Cone { dso: 5.0, dsd: 7.0 },
        detector: Detector {
            rows: 48,
            columns: 48,
            pitch_v: 4.0 / 48.0,
            pitch_u: 4.0 / 48.0,
            offset_u: 0.0,
            offset_v: 0.0,
        },
        grid: Grid::cube(24),
    };
    let phantom = Phantom::by_name("torso", 0).unwrap();
    let plan = Plan { views: 6, test_views: 2, noise: Noise::LOW, seed: 5 };
    simulate("torso", Object::Phantom(&phantom), &scanner, &plan).unwrap()
}

#[test]
fn simulation_noise_and_filtered_backprojection_have_the_same_bits_on_any_number_of_threads() {
    let numbers = |values: &ndarray::Array3<f32>| digest(values.iter().map(|&x| f64::from(x)));
    assert_independent_of_threads("simulation", || {
        let scan = scan();
        numbers(&scan.train.images) + &numbers(&scan.test.unwrap().images) + &numbers(&scan.truth.unwrap().values)
    });
    let scan = scan();
    for window in [Window::RamLak, Window::Hann] {
        assert_independent_of_threads(&format!("FDK {window:?}"), || {
            numbers(&fdk(&scan.scanner, &scan.train, window, Turn::Measured).unwrap().values)
        });
    }
}

/// All result files of a simulation with noise and of a reconstruction by FDK.
fn files(sandbox: &Sandbox, threads: usize) -> Vec<(String, Vec<u8>)> {
    let scan =
        "simulate --phantom torso --out scan --size 16 --detector 18,21 --views 5 --test-views 2 --noise high --seed 9";
    sandbox.done(&format!("{scan} --threads {threads}"));
    sandbox.done(&format!("reconstruct scan --out run --method fdk --threads {threads}"));
    let content = sandbox.content().into_iter().filter(|(path, _)| !path.ends_with("provenance.json"));
    // The mark of a run has the digests of these two.
    let content = content.filter(|(path, _)| !path.ends_with("report.html") && !path.ends_with("run/.trgs.json"));
    content.map(|(path, bytes)| (path.strip_prefix(sandbox.path("")).unwrap().display().to_string(), bytes)).collect()
}

#[test]
fn several_processes_write_the_same_files_on_any_number_of_threads() {
    let first = files(&Sandbox::new(), 1);
    assert!(first.iter().any(|(name, _)| name == "scan/proj_train/proj_train_0004.npy"), "simulated");
    assert!(first.iter().any(|(name, _)| name == "run/volume.npy"), "reconstructed");
    for threads in [1, 2, 3] {
        for ((name, before), (again, after)) in first.iter().zip(files(&Sandbox::new(), threads)) {
            assert_eq!(*name, again);
            assert!(*before == after, "{name} on {threads} threads differs from another process's");
        }
    }
}

#[test]
fn fifty_training_steps_have_the_same_bits_on_any_number_of_threads() {
    let dataset = scan();
    for precision in [Precision::F32, Precision::F64] {
        let mut config = Config::default();
        (config.iterations, config.precision, config.model.points) = (50, precision, 400);
        config.loss.tv_block = 16;
        let plan = config.plan(&dataset.scanner, dataset.train.len()).unwrap();
        assert_independent_of_threads(&format!("training {precision:?}"), || {
            let result = train::train(&dataset, &plan, None, &mut |_, _| ControlFlow::Continue(())).unwrap();
            digest_of(&result.primitives.parameters) + &digest(result.volume.values.iter().map(|&x| f64::from(x)))
        });
    }
}

#[test]
fn a_different_seed_gives_a_different_result() {
    let dataset = scan();
    let run = |seed| {
        let mut config = Config::default();
        (config.iterations, config.seed, config.model.points) = (3, seed, 200);
        digest_of(
            &train::train(&dataset, &config.plan(&dataset.scanner, dataset.train.len()).unwrap(), None, &mut |_, _| {
                ControlFlow::Continue(())
            })
            .unwrap()
            .primitives
            .parameters,
        )
    };
    assert_eq!(run(1), run(1));
    assert_ne!(run(1), run(2));
}
