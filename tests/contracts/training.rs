//! Training as a whole: all methods, all pairs of density control and position optimiser, all options.

use ndarray::{Array2, Array3};
use std::collections::BTreeSet;
use std::ops::ControlFlow;
use trgs::config::{Auto, Config, DensityControl, Method, PositionOptimiser};
use trgs::geometry::{Beam, Detector, Deviation, Grid, Scanner, Volume};
use trgs::loss::{ImageTerms, Ssim, SsimTarget, image_loss, image_loss_into, tv};
use trgs::numeric::threads;
use trgs::primitives::Group;
use trgs::projector::{Field, Projection};
use trgs::reconstruction::{Checkpoints as RunCheckpoints, Progress, Reconstruction, Run, evaluate};
use trgs::scan::Dataset;
use trgs::scan::noise::Noise;
use trgs::scan::phantom::Phantom;
use trgs::scan::simulate::{Object, Plan, simulate};
use trgs::train::{Checkpoint, Checkpoints, TrainedModel, train};
use trgs::wavelet::{self, Routing, wavelet_loss, wavelet_loss_into};
use trgs::{Error, evaluation, reconstruct};

fn scan() -> Dataset {
    let pitch = 4.0 / 40.0;
    let scanner = Scanner {
        beam: Beam::Cone { dso: 5.0, dsd: 7.0 },
        detector: Detector { rows: 40, columns: 40, pitch_v: pitch, pitch_u: pitch, offset_u: 0.0, offset_v: 0.0 },
        grid: Grid::cube(20),
    };
    let plan = Plan { views: 9, test_views: 2, noise: Noise::LOW, seed: 4 };
    simulate("torso", Object::Phantom(&Phantom::by_name("torso", 0).unwrap()), &scanner, &plan).unwrap()
}

/// A configuration in which every part runs within a few iterations.
fn busy(method: Method) -> Config {
    let mut config = Config::of(method);
    (config.iterations, config.report_every, config.model.points) = (60, 10, 300);
    (config.loss.tv_block, config.wavelet.block) = (12, 12);
    // Near the targets: a short run reaches them and learns the tails.
    config.model.nu_initial = 30.0;
    (config.density_control.every, config.density_control.stop, config.confidence.every) = (10, 0.8.into(), 25);
    config
}

fn planned(dataset: &Dataset, config: &Config) -> trgs::config::Plan {
    config.plan(&dataset.scanner, dataset.train.len()).unwrap()
}

fn run(dataset: &Dataset, config: &Config) -> TrainedModel {
    train(dataset, &planned(dataset, config), None, &mut |_, _| ControlFlow::Continue(())).unwrap()
}

fn bits(result: &TrainedModel) -> Vec<u64> {
    let parameters = &result.primitives.parameters;
    Group::ALL.into_iter().flat_map(|group| parameters.group(group)).map(|x| x.to_bits()).collect()
}

/// Matter around the volume is not put into it, and a run that was stopped goes on to the same bits.
#[test]
fn a_margin_keeps_what_is_around_the_volume_out_of_it() {
    let whole = scan();
    let grid = whole.scanner.grid;
    let inside = grid.block([0, 0, 5], [20, 20, 10]);
    let part = |volume: &Volume| volume.clone().without_margin(&inside);
    let cut = Dataset { test: whole.test.clone(), ..whole.on(inside) };
    let truth = part(whole.truth.as_ref().unwrap());
    let db = |volume: &Volume| evaluation::psnr_3d(truth.values.view(), volume.values.view()).value;
    for method in [Method::Sart, Method::Tv, Method::TrGs] {
        let mut config = if method == Method::TrGs { busy(method) } else { Config::of(method) };
        (config.tv.weight, config.tv.finish_iterations, config.tv.pilot) = (Auto::Fixed(3e-3), Auto::Fixed(5), false);
        // The weight that follows from a grid is another one with the layer.
        config.loss.tv = Auto::Fixed(4e-3);
        let of_whole = db(&part(&reconstruct(&whole, &config).unwrap().volume));
        let without = reconstruct(&cut, &config).unwrap();
        config.model.margin = 0.25;
        let with = reconstruct(&cut, &config).unwrap();
        assert_eq!([without.volume.grid, with.volume.grid], [inside; 2]);
        within!(of_whole - db(&with.volume), "{method:?}: {of_whole} dB, without a margin {}", db(&without.volume));
        if method != Method::TrGs {
            beyond!("without, dB", of_whole - db(&without.volume), "{method:?}");
        }
        // Projections are those of the layer as well; without it there are none to compare.
        let db_2d = |result: &Reconstruction, config: &Config, volume: &Volume| {
            let found = evaluate(&cut, volume, result.primitives.as_ref(), config).unwrap();
            (found.metrics.psnr_2d.map(|metric| metric.value), found.absent.contains_key("psnr_2d"))
        };
        let of_layer = db_2d(&with, &config, with.around.as_ref().unwrap_or(&with.volume)).0.unwrap();
        if method == Method::TrGs {
            assert!(with.around.is_none(), "{method:?}");
        } else {
            assert_eq!(db_2d(&with, &config, &with.volume), (None, true), "{method:?}");
            let mut bare = config.clone();
            bare.model.margin = 0.0;
            let alone = db_2d(&with, &bare, &with.volume).0.unwrap();
            assert!(of_layer > alone, "{method:?}: {of_layer} dB, without the layer {alone}");
        }
        let folder = tempfile::tempdir().unwrap();
        let (file, mut left) = (folder.path().join("state"), 3);
        let stop = |_: Progress<'_>| {
            left -= 1;
            if left == 0 { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
        };
        Run::new(&cut, &config).checkpoints(RunCheckpoints::new(&file)).observe(stop).reconstruct().unwrap_err();
        let resumed =
            Run::new(&cut, &config).checkpoints(RunCheckpoints::resume(&file).unwrap()).reconstruct().unwrap();
        assert!(resumed.volume == with.volume, "{method:?}");
    }
}

#[test]
fn a_coarse_training_is_that_of_the_coarser_scan_with_the_volume_of_the_whole_one() {
    let dataset = scan();
    let mut posed = dataset.clone();
    let deviation = Deviation { axis_shift: 0.02, ..Deviation::none(&dataset.scanner) };
    posed.train.poses = Some(posed.train.angles.iter().map(|&angle| deviation.pose(angle)).collect());
    let mut flat = dataset.clone();
    (flat.scanner.grid.shape[2], flat.scanner.grid.spacing.z, flat.truth) = (1, 2.0, None);
    for (dataset, what) in [(&dataset, "circle"), (&posed, "poses"), (&flat, "one slice")] {
        let coarse = |factor| {
            let mut config = busy(Method::TrGs);
            config.coarse = factor;
            config
        };
        let config = coarse(2);
        let (found, seen) = (run(dataset, &config), dataset.coarser(2));
        assert_eq!((seen.scanner.grid.shape[0], seen.scanner.detector.columns), (10, 20));
        let expected = run(&seen, &coarse(1));
        assert!(bits(&found) == bits(&expected), "{what}");
        assert_eq!(found.volume.grid, dataset.scanner.grid);
        let volume = Field::<f32>::new(&found.primitives, config.cutoff).voxels(&dataset.scanner.grid);
        assert_eq!(found.volume.values, volume, "{what}");
        assert_ne!(bits(&run(dataset, &coarse(1))), bits(&found));
        let (folder, plan) = (tempfile::tempdir().unwrap(), planned(dataset, &config));
        let file = folder.path().join("checkpoint");
        let mut stop = |iteration, _: Option<&_>| {
            if iteration == 23 { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
        };
        train(dataset, &plan, Some(Checkpoints { file: file.clone(), from: None }), &mut stop).unwrap_err();
        let from = Some(Checkpoint::read(&file).unwrap());
        let resumed = train(dataset, &plan, Some(Checkpoints { file, from }), &mut |_, _| ControlFlow::Continue(()));
        assert!(bits(&resumed.unwrap()) == bits(&found), "{what}: other bits after a stop");
    }
}

/// The eight settings of the table of optimisers and density control.
fn pairs() -> impl Iterator<Item = Config> {
    let settings = [Method::TrGs, Method::R2Gaussian].into_iter().flat_map(|method| {
        [DensityControl::Adc, DensityControl::Ar].into_iter().flat_map(move |control| {
            [PositionOptimiser::Adam, PositionOptimiser::Sghmc].map(|position| (method, control, position))
        })
    });
    settings.map(|(method, control, position)| {
        let mut config = busy(method);
        config.density_control.method = control;
        config.optimiser.position = position;
        config
    })
}

/// Whole registers extend beyond the supports, relatively more for small supports.
#[test]
fn seven_tenths_of_the_lanes_that_a_run_goes_through_are_within_supports() {
    let pitch = 4.0 / 128.0;
    let detector = Detector { rows: 128, columns: 128, pitch_v: pitch, pitch_u: pitch, offset_u: 0.0, offset_v: 0.0 };
    let scanner = Scanner { beam: Beam::Cone { dso: 5.0, dsd: 7.0 }, detector, grid: Grid::cube(64) };
    let plan = Plan { views: 9, test_views: 0, noise: Noise::LOW, seed: 4 };
    let phantom = Phantom::by_name("torso", 0).unwrap();
    let dataset = simulate("torso", Object::Phantom(&phantom), &scanner, &plan).unwrap();
    let mut config = Config::of(Method::TrGs);
    (config.iterations, config.model.points, config.density_control.cap) = (300, 5000, 5000);
    let field = Field::<f32>::new(&run(&dataset, &config).primitives, config.cutoff);
    for angle in [0.0, 0.4, 2.0] {
        let pairs = field.view(&scanner, angle, config.projection).utilisation();
        assert!(pairs.active > 500_000, "{angle}: {pairs:?}");
        beyond!(pairs.ratio(), "{angle}: {pairs:?}");
    }
}

/// R²-Gaussian's own program keeps centres fixed in blocks.
///
/// The setting for that must leave only the data's gradient on the centres, and remove nothing else.
#[test]
fn blocks_move_centres_unless_they_are_told_not_to() {
    let dataset = scan();
    let after_one = |tv: f64, blocks_move: bool| {
        let mut config = busy(Method::TrGs);
        (config.iterations, config.optimiser.position) = (1, PositionOptimiser::Adam);
        (config.loss.tv, config.loss.blocks_move) = (tv.into(), blocks_move);
        run(&dataset, &config).primitives.parameters
    };
    let (without, held, moved) = (after_one(0.0, true), after_one(50.0, false), after_one(50.0, true));
    assert_eq!(held.mean, without.mean);
    assert_ne!(moved.mean, without.mean);
    for group in Group::ALL.into_iter().filter(|group| *group != Group::Mean) {
        assert_eq!(held.group(group), moved.group(group), "{group:?}");
    }
    assert_ne!(held.density, without.density);
}

#[test]
fn every_pair_of_density_control_and_optimiser_learns_and_stops_and_goes_on_to_the_same_bits() {
    let dataset = scan();
    let folder = tempfile::tempdir().unwrap();
    let mut results = BTreeSet::new();
    for (number, config) in pairs().enumerate() {
        let what = format!("{:?} {:?} {:?}", config.method, config.density_control.method, config.optimiser.position);
        let whole = threads::install(1, || run(&dataset, &config)).unwrap();
        let (first, last) = (&whole.log[0], whole.log.last().unwrap());
        within!(last.l1 / first.l1, "{what}: from {} to {}", first.l1, last.l1);
        assert!(last.primitives > 300, "{what}: {} primitives", last.primitives);
        assert!(results.insert(bits(&whole)), "{what} is the same as another pair");

        let file = folder.path().join(format!("{number}/checkpoint"));
        let stop = |at: usize| {
            move |iteration, _: Option<&_>| {
                if iteration == at { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
            }
        };
        let from = |file: &std::path::Path| file.exists().then(|| Checkpoint::read(file).unwrap());
        for at in [1, 23, 24, 45] {
            let checkpoints = Checkpoints { file: file.clone(), from: from(&file) };
            let stopped = train(&dataset, &planned(&dataset, &config), Some(checkpoints), &mut stop(at));
            assert!(matches!(stopped, Err(Error::Interrupted { step, .. }) if step == at), "{what}");
        }
        let checkpoints = Checkpoints { file: file.clone(), from: from(&file) };
        let resumed = train(&dataset, &planned(&dataset, &config), Some(checkpoints), &mut stop(0)).unwrap();
        assert!(bits(&resumed) == bits(&whole), "{what}: other bits after four stops");
        assert!(resumed.log.iter().map(|r| r.loss.to_bits()).eq(whole.log.iter().map(|r| r.loss.to_bits())), "{what}");
    }
}

#[test]
fn confidence_and_wavelets_each_change_the_result_and_report() {
    let dataset = scan();
    let variant = |confidence, wavelet| {
        let mut config = busy(Method::TrGs);
        (config.confidence.enabled, config.wavelet.enabled) = (confidence, wavelet);
        run(&dataset, &config)
    };
    let (base, confident, sharpened, full) =
        (variant(false, false), variant(true, false), variant(false, true), variant(true, true));
    let distinct: BTreeSet<_> = [&base, &confident, &sharpened, &full].map(bits).into();
    assert_eq!(distinct.len(), 4);
    for (result, has_nu, has_wavelet) in
        [(&base, false, false), (&confident, true, false), (&sharpened, false, true), (&full, true, true)]
    {
        let last = result.log.last().unwrap();
        assert_eq!((last.nu > 0.0, last.wavelet != 0.0), (has_nu, has_wavelet));
        assert_eq!(last.confidence.is_some(), has_nu || has_wavelet);
    }
    assert!(full.log.last().unwrap().spearman.is_some());
    assert!(base.log.last().unwrap().spearman.is_none());
}

#[test]
fn a_strong_pull_leads_nu_to_its_targets() {
    let dataset = scan();
    let spearman = |weight| {
        let mut config = busy(Method::TrGs);
        config.confidence.weight = weight;
        // The larger steps of a short run would overshoot.
        config.optimiser.horizon = config.iterations;
        config.density_control.method = DensityControl::None;
        run(&dataset, &config).log.last().unwrap().spearman.unwrap()
    };
    let (weak, strong) = (spearman(1e-6), spearman(10.0));
    beyond!(strong);
    assert!(strong > weak, "Spearman's ρ: {weak} with a weak pull, {strong} with a strong one");
}

#[test]
fn what_the_textbook_sampler_does_is_finite_and_its_own() {
    let dataset = scan();
    let mut config = busy(Method::TrGs);
    config.optimiser.position = PositionOptimiser::SghmcTextbook;
    let result = run(&dataset, &config);
    assert!(bits(&result) != bits(&run(&dataset, &busy(Method::TrGs))));
    assert!(result.volume.values.iter().all(|x| x.is_finite()));
}

#[test]
fn both_methods_come_close_to_the_phantom() {
    let dataset = scan();
    let truth = dataset.truth.as_ref().unwrap();
    for method in [Method::TrGs, Method::R2Gaussian] {
        let mut config = busy(method);
        (config.iterations, config.model.points) = (250, 800);
        let found = evaluation::psnr_3d(truth.values.view(), run(&dataset, &config).volume.values.view()).value;
        assert!(found > 20.0, "{method:?}: {found} dB");
    }
}

#[test]
fn a_population_that_dies_out_is_an_error_and_no_crash() {
    let dataset = scan();
    let mut config = busy(Method::R2Gaussian);
    config.density_control.faint = 1e6;
    let plan = planned(&dataset, &config);
    let message = train(&dataset, &plan, None, &mut |_, _| ControlFlow::Continue(())).unwrap_err().to_string();
    assert!(message.contains("density_control.faint"), "{message}");
}

/// Number of heap allocations in a run of so many iterations, on one thread.
fn blocks_of_memory(dataset: &Dataset, config: &Config, iterations: usize) -> u64 {
    let mut config = config.clone();
    config.iterations = iterations;
    let mut blocks = 0;
    let measured = || blocks = allocation_counter::measure(|| drop(run(dataset, &config))).count_total;
    threads::install(1, measured).unwrap();
    blocks
}

/// Runs twice at the same size; the second run is measured.
#[test]
fn what_fills_an_array_that_is_there_has_the_bits_of_a_new_one_and_asks_for_no_memory() {
    let dataset = scan();
    let Scanner { grid, detector, .. } = dataset.scanner;
    let mut config = busy(Method::TrGs);
    config.iterations = 1;
    let model = run(&dataset, &config).primitives;
    let field = Field::<f32>::new(&model, 1e-3);
    let (view, there) = (field.view(&dataset.scanner, 0.4, Projection::Exact), field.on(&grid));
    let ssim = Ssim::<f32>::default();
    let target = SsimTarget::new(&ssim, Array2::from_elem((detector.rows, detector.columns), 0.1).view());
    let settings = Config::default().wavelet.settings();
    let routing = Routing { high: Array3::from_elem(grid.shape, 1), neighbours: settings.neighbours };
    let (of_tv, of_wavelets) = (tv::Workspace::default(), wavelet::Workspace::default());
    let (mut image, mut volume) = (Array2::default((0, 0)), Array3::default((0, 0, 0)));
    let (mut cotangent, mut slopes) =
        (Array2::default((detector.rows, detector.columns)), [(); 2].map(|()| Array3::default((0, 0, 0))));
    let mut losses = (ImageTerms { total: 0.0, l1: 0.0, d_ssim: 0.0 }, 0.0, [0.0; 3]);
    let mut all = || {
        view.image_into(&mut image);
        there.voxels_into(&mut volume);
        losses = (
            image_loss_into(&ssim, 0.25, image.view(), &target, &mut cotangent),
            tv::tv_into(volume.view(), &of_tv, &mut slopes[0]),
            wavelet_loss_into(volume.view(), &routing, &settings, &of_wavelets, &mut slopes[1]),
        );
    };
    let mut blocks = [0; 2];
    let measured = || blocks = [(); 2].map(|()| allocation_counter::measure(&mut all).count_total);
    threads::install(1, measured).unwrap();
    assert!(blocks[0] > 0 && blocks[1] == 0, "{blocks:?}");
    assert_eq!((&image, &volume), (&view.image(), &there.voxels()));
    assert_eq!((losses.0, cotangent), image_loss(&ssim, 0.25, image.view(), &target));
    let (value, gradient) = tv::tv(volume.view());
    assert_eq!((losses.1, &slopes[0]), (value, &gradient));
    let expected = wavelet_loss(volume.view(), &routing, &settings);
    assert_eq!((losses.2[0], &slopes[1]), (expected.value, &expected.gradient));
}

/// The kd-tree of neighbours is rebuilt only where primitives moved far or were added.
#[test]
fn an_iteration_with_wavelets_asks_for_no_memory() {
    let dataset = scan();
    for mut config in pairs().filter(|config| config.wavelet.enabled) {
        (config.density_control.every, config.confidence.every, config.wavelet.every) = (1000, 1000, 5);
        (config.report_every, config.model.points) = (1000, 700);
        let [few, many] = [20, 70].map(|iterations| blocks_of_memory(&dataset, &config, iterations));
        assert_eq!(many, few, "{:?}", config.optimiser.position);
        config.wavelet.enabled = false;
        assert!(blocks_of_memory(&dataset, &config, 20) < few, "the first tree is counted");
    }
}

#[test]
fn an_iteration_in_which_nothing_else_is_due_asks_for_no_memory() {
    let dataset = scan();
    let mut affine = busy(Method::TrGs);
    affine.projection = Projection::Affine;
    for mut config in pairs().chain([affine]) {
        // Only the losses of every iteration and the optimisers.
        (config.density_control.every, config.confidence.every, config.wavelet.every) = (1000, 1000, 1000);
        (config.report_every, config.model.points) = (1000, 700);
        let [few, many] = [20, 70].map(|iterations| blocks_of_memory(&dataset, &config, iterations));
        assert_eq!(many, few, "{:?} and {:?}", config.density_control.method, config.optimiser.position);
        // A report allocates memory, so the number shows that allocations are counted.
        config.report_every = 10;
        assert!(blocks_of_memory(&dataset, &config, 70) > many);
    }
}
