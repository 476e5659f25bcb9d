//! Any unit of density: projections times k give densities times k, bit-exact for powers of two.

use crate::program::Sandbox;
use ndarray::{Array2, Array3};
use std::ops::ControlFlow;
use trgs::classical::density_unit;
use trgs::config::{Auto, Config, Method, Start};
use trgs::evaluation::{psnr_3d_range, range};
use trgs::geometry::{Beam, Detector, Grid, Scanner};
use trgs::primitives::Group;
use trgs::reconstruction::{Checkpoints, Progress, Reconstruction, Run, reconstruct};
use trgs::scan::simulate::{Object, Plan, simulate};
use trgs::scan::{Dataset, Noise, Phantom};

/// Powers of two, -20 and 20: scaling is exact.
const EXACT: [f64; 2] = [1.0 / 1_048_576.0, 1_048_576.0];
/// Other factors: pixels are rounded.
const ROUNDED: [f64; 4] = [1e-6, 0.02, 1000.0, 1e6];

fn scan() -> Dataset {
    let pitch = 4.0 / 36.0;
    let scanner = Scanner {
        beam: Beam::Cone { dso: 5.0, dsd: 7.0 },
        detector: Detector { rows: 36, columns: 36, pitch_v: pitch, pitch_u: pitch, offset_u: 0.0, offset_v: 0.0 },
        grid: Grid::cube(16),
    };
    let plan = Plan { views: 8, test_views: 0, noise: Noise::LOW, seed: 4 };
    simulate("torso", Object::Phantom(&Phantom::by_name("torso", 0).unwrap()), &scanner, &plan).unwrap()
}

/// A configuration in which every part runs within a few iterations; voxel methods set their own.
fn config(method: Method) -> Config {
    let mut config = Config::of(method);
    if method.fits_primitives() {
        (config.iterations, config.report_every, config.model.points) = (150, 50, 300);
        (config.loss.tv_block, config.wavelet.block, config.density_control.cap) = (8, 8, 600);
        (config.density_control.every, config.confidence.every) = (20, 50);
    }
    if method.network().is_some() {
        (config.iterations, config.neural.rays, config.neural.windows, config.neural.samples) = (12, 96, 2, 16);
    }
    config
}

fn times(dataset: &Dataset, k: f64) -> Dataset {
    let mut dataset = dataset.clone();
    dataset.train.images.mapv_inplace(|value| (f64::from(value) * k) as f32);
    if let Some(points) = &mut dataset.initial_points {
        points.column_mut(3).mapv_inplace(|density| density * k);
    }
    dataset
}

fn found(dataset: &Dataset, config: &Config) -> Reconstruction {
    config.validate().unwrap();
    reconstruct(dataset, config).unwrap()
}

/// Bits of the volume and of each group of parameters, divided by k where they scale.
fn bits(found: &Reconstruction, k: f64) -> Vec<u64> {
    let volume = found.volume.values.iter().map(|&value| (f64::from(value) / k).to_bits());
    let parameters = found.primitives.iter().flat_map(|primitives| {
        Group::ALL.into_iter().flat_map(|group| {
            let k = if group == Group::Density { k } else { 1.0 };
            primitives.parameters.group(group).iter().map(move |value| (value / k).to_bits())
        })
    });
    volume.chain(parameters).collect()
}

/// PSNR of the volume divided by k, in dB.
fn quality(found: &Reconstruction, dataset: &Dataset, k: f64) -> f64 {
    let truth = dataset.truth.as_ref().unwrap().values.view();
    let values: Array3<f32> = found.volume.values.mapv(|value| (f64::from(value) / k) as f32);
    psnr_3d_range(truth, values.view(), range(truth)).value
}

#[test]
fn every_method_gives_k_times_the_volume_of_k_times_the_scan() {
    let scan = scan();
    for method in Method::ALL {
        let config = config(method);
        let once = found(&scan, &config);
        for k in EXACT {
            let scaled = found(&times(&scan, k), &config);
            assert!(bits(&scaled, k) == bits(&once, 1.0), "{method:?}: other bits at {k}");
            assert_eq!(scaled.unit.map(|unit| unit / k), once.unit, "{method:?}");
        }
    }
}

/// The default learning rates of so short a run amplify the rounding of a pixel in any unit.
///
/// A smaller horizon lowers them; the run still passes through all phases.
#[test]
fn factors_that_round_the_pixels_move_no_method_by_a_hundredth_of_a_decibel() {
    let scan = scan();
    for method in Method::ALL {
        let mut config = config(method);
        config.optimiser.horizon = 600;
        if method == Method::Cgls {
            // With more, directions in f32 lose conjugacy, and each rounding changes the result.
            config.iterations = 6;
        }
        let decibels = quality(&found(&scan, &config), &scan, 1.0);
        for k in ROUNDED {
            let difference = quality(&found(&times(&scan, k), &config), &scan, k) - decibels;
            eprintln!("{method:?}, {k}: {decibels:.3} dB {difference:+.5}");
            within!(difference.abs(), "{method:?}, {k}: {decibels} dB {difference:+}");
        }
    }
}

#[test]
fn given_points_and_fewer_views_are_in_the_unit_of_the_scan() {
    let mut scan = scan();
    scan.train = scan.train.evenly_spaced(5).unwrap();
    let points = (0..300).map(|i| [i % 7, i / 7 % 6, i / 42].map(|place| 0.2 * f64::from(place) - 0.6));
    let rows: Vec<f64> = points.zip(0..).flat_map(|([x, y, z], i)| [x, y, z, 0.3 + 0.001 * f64::from(i)]).collect();
    scan.initial_points = Some(Array2::from_shape_vec((300, 4), rows).unwrap());
    for start in [Start::Dataset, Start::Random] {
        for method in [Method::TrGs, Method::R2Gaussian] {
            let mut config = config(method);
            config.initialisation.from = start;
            let k = EXACT[1];
            let (once, scaled) = (found(&scan, &config), found(&times(&scan, k), &config));
            assert!(bits(&scaled, k) == bits(&once, 1.0), "{method:?} from {start:?}");
        }
    }
}

#[test]
fn a_run_that_was_stopped_goes_on_in_its_unit() {
    let scan = times(&scan(), 0.02);
    let config = config(Method::TrGs);
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("checkpoint");
    let stop = |progress: Progress| match progress {
        Progress::Iteration(70, _) => ControlFlow::Break(()),
        _ => ControlFlow::Continue(()),
    };
    Run::new(&scan, &config).checkpoints(Checkpoints::new(&file)).observe(stop).reconstruct().unwrap_err();
    let resumed =
        |scan: &Dataset| Run::new(scan, &config).checkpoints(Checkpoints::resume(&file).unwrap()).reconstruct();
    let message = resumed(&times(&scan, 2.0)).unwrap_err().to_string();
    assert!(message.contains("other projections"), "{message}");
    assert!(bits(&resumed(&scan).unwrap(), 1.0) == bits(&found(&scan, &config), 1.0));
}

#[test]
fn a_unit_that_is_set_is_the_unit() {
    let scan = scan();
    let mut config = config(Method::TrGs);
    let auto = density_unit(&scan.scanner, &scan.train).unwrap();
    let by_itself = found(&scan, &config);
    assert_eq!(by_itself.unit, Some(auto));
    config.density_unit = Auto::Fixed(auto);
    assert!(bits(&found(&scan, &config), 1.0) == bits(&by_itself, 1.0));
    config.density_unit = Auto::Fixed(1.0);
    assert!(bits(&found(&scan, &config), 1.0) != bits(&by_itself, 1.0));
    for wrong in ["0", "-1", "inf", "nan"] {
        config.set(&format!("density_unit={wrong}")).unwrap();
        let message = config.validate().unwrap_err().to_string();
        assert!(message.contains("density_unit") && message.contains("or auto"), "{message}");
    }
    config.set("density_unit=auto").unwrap();
    assert_eq!(config.density_unit, Auto::Auto);
}

/// Water per millimetre: thresholds for densities about 1 once left no voxel to start from.
#[test]
fn the_program_takes_scans_in_any_unit_and_judges_them_by_the_range_of_the_truth() {
    let sandbox = Sandbox::with_scan();
    let scan = Dataset::read(sandbox.path("scan")).unwrap();
    for (name, k) in [("water", 0.02), ("half", 1.0 / 64.0)] {
        let mut scaled = times(&scan, k);
        scaled.truth.as_mut().unwrap().values *= k as f32;
        scaled.test.as_mut().unwrap().images *= k as f32;
        scaled.write(&sandbox.path(name)).unwrap();
    }
    let run = "--iterations 60 --points 100 --views 3 --set density_control.every=10";
    let near = sandbox.done(&format!("reconstruct scan --out of_scan {run}"));
    assert!(near.get("psnr_3d_range").is_none(), "{near}");
    let far = sandbox.done(&format!("reconstruct half --out of_half {run}"));
    let of = |found: &serde_json::Value, name: &str| found[name]["value"].as_f64().unwrap();
    let model = |run: &str| trgs::scan::model::read(sandbox.path(&format!("{run}/model.npz"))).unwrap().parameters;
    let (one, other) = (model("of_scan"), model("of_half"));
    assert!(one.mean == other.mean && one.density.iter().zip(&other.density).all(|(a, b)| a / 64.0 == *b));
    within!((of(&far, "psnr_2d") - of(&near, "psnr_2d")).abs());

    sandbox.done(&format!("reconstruct water --out of_water {run}"));
    let page = sandbox.text("of_water/report.html");
    assert!(page.contains("Density that counted as 1") && page.contains("psnr3d/truth-range"));
    let provenance: serde_json::Value = serde_json::from_str(&sandbox.text("of_water/provenance.json")).unwrap();
    let unit = provenance["density_unit"].as_f64().unwrap() / 0.02;
    within!("unit", f64::max(unit, unit.recip()), "{provenance}");
    let judged = sandbox.done("evaluate of_water --against water");
    assert_eq!(judged["psnr_3d"]["definition"], "psnr3d/peak1");
    assert_eq!(judged["psnr_3d_range"]["definition"], "psnr3d/truth-range");
    assert!(of(&judged, "psnr_3d_range") < of(&judged, "psnr_3d") - 25.0, "{judged}");
    let table = String::from_utf8(sandbox.run("evaluate of_water --against water").stdout).unwrap();
    assert!(table.contains("psnr_3d_range") && table.contains("not near 1"), "{table}");

    let message = sandbox.refused(&format!("reconstruct water --out again {run} --set density_unit=1"));
    assert!(message.contains("voxels above it"), "{message}");
}
