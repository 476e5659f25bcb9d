//! The initial primitives of a run: at points of a first volume, of the dataset or at random, or those of a model.

use crate::classical::algebraic::{Division, Order, SartSettings, TvSettings};
use crate::classical::fdk::{Turn, Window, fdk};
use crate::classical::{RayModel, VoxelProjector};
use crate::config::{Config, DensityControl, Method, Plan, Precision, Start};
use crate::error::{Error, Result};
use crate::geometry::{Grid, Volume};
use crate::numeric::elementary::exp;
use crate::primitives::activation::Interval;
use crate::primitives::initialisation::{self, Point};
use crate::primitives::{KernelKind, Primitives};
use crate::scan::{Dataset, model};
use crate::setting::Text;
use glam::DVec3;
use ndarray::{ArrayView1, Axis, Zip};
use std::path::Path;
use trgs_methods::internals::{Iterative, begin};

/// Iterations of SART for the first volume.
const PASSES: usize = 5;
/// Iterations with total variation for the first volume; the weight is that of [`TvSettings::default`].
const ITERATIONS: usize = 30;
/// Radius of the smoothing kernel in standard deviations.
const REACH: f64 = 3.0;

/// The initial primitives of a run, with densities in the unit of the dataset's projections.
///
/// # Errors
/// When the dataset does not have what the configuration asks for, and those of [`primitives_of_model`].
pub fn initial_primitives(dataset: &Dataset, config: &Plan) -> Result<Primitives> {
    let start = &config.initialisation;
    let points = match start.from {
        Start::Fdk | Start::SmoothedFdk | Start::Sart | Start::Tv => {
            let volume = first_volume(dataset, start.from, start.smoothing)?;
            initialisation::bright_voxels(&volume, start.threshold, config.model.points, config.seed)?
        }
        Start::Random => initialisation::random_points(&dataset.scanner.grid, config.model.points, config.seed),
        Start::Dataset => given(dataset)?,
        Start::Model => return Ok(primitives_of_model(&dataset.scanner.grid, config)?.0),
    };
    initialisation::primitives(&points, config.model.kernel, start.density_factor, config.model.nu_initial)
}

/// The primitives of `initialisation.model` as a run on a grid starts from them, and remarks on what it changes.
///
/// Primitives are in scene units, so the scan of the model may have had any grid and detector. Scales, densities and ν
/// outside of their ranges start at the end of the range. Keys must be resolved.
///
/// # Errors
/// When the file is no model, has kernels of another kind, more than half of its centres outside of the grid, another
/// number of primitives than `model.points`, or more than density control keeps.
///
/// Tests: `a_model_starts_with_its_values_and_a_run_without_steps_returns_them`,
/// `what_a_run_changes_about_its_model_is_said`, `a_model_that_does_not_fit_the_run_is_refused`.
pub fn primitives_of_model(grid: &Grid, config: &Config) -> Result<(Primitives, Vec<String>)> {
    let file = &config.initialisation.model;
    let found = model::read(Path::new(file))?;
    let (m, control) = (found.len(), &config.density_control);
    if config.model.points != m {
        let remedy = "leave it out or set " + Text::set("model.points", m);
        let expected = format!("{m}, the number of primitives in {file}");
        return Err(Error::invalid("model.points", config.model.points, expected, remedy));
    }
    if control.method != DensityControl::None && m > control.cap {
        let expected = format!("at most density_control.cap = {}", control.cap);
        let remedy = "raise the cap: " + Text::set("density_control.cap", m);
        return Err(Error::invalid("initialisation.model", format!("{m} primitives in {file}"), expected, remedy));
    }
    if found.kernel != config.model.kernel {
        let [got, asked] = [found.kernel, config.model.kernel].map(KernelKind::key);
        let expected = format!("{asked} kernels, as model.kernel has them");
        let keys = match (found.kernel, config.method) {
            (KernelKind::StudentT, Method::R2Gaussian) => Text::set("method", "tr-gs"),
            (KernelKind::StudentT, _) => Text::set("model.kernel", "student-t"),
            // Gaussian kernels have no ν to pull.
            (KernelKind::Gaussian, _) => {
                Text::set("model.kernel", "gaussian") + " and " + Text::set("confidence.enabled", false)
            }
        };
        let remedy = "fit kernels of that kind, " + keys + ", or start from another model";
        return Err(Error::invalid("initialisation.model", format!("{got} kernels in {file}"), expected, remedy));
    }
    let (low, high) = (grid.min, grid.max());
    let is_outside = |mean: &&[f64; 3]| {
        let mean = DVec3::from_array(**mean);
        mean.cmplt(low).any() || mean.cmpgt(high).any()
    };
    let outside = found.parameters.mean.iter().filter(is_outside).count();
    if 2 * outside > m {
        let got = format!("{outside} of {m} centres in {file} outside of the volume");
        let expected = format!("centres within {low:.4} to {high:.4}, scene units");
        let remedy = "use the model of a scan with the same scale and position of the volume, or another start, such as "
            + Text::set("initialisation.from", "sart");
        return Err(Error::invalid("initialisation.model", got, expected, remedy));
    }
    let mut remarks = Vec::new();
    let mut remark = |count: usize, text: String| {
        if count > 0 {
            remarks.push(format!("{file}: {count} of {m} {text}"));
        }
    };
    let parameters = &found.parameters;
    if found.kernel == KernelKind::StudentT {
        let (min, max) = (config.model.nu_min, config.model.nu_max);
        let beyond = parameters.nu.iter().filter(|&&nu| !(min..=max).contains(&nu)).count();
        remark(beyond, format!("ν are outside of model.nu_min = {min} to model.nu_max = {max} and start at the end"));
    }
    let Interval { min, max } = super::scales(grid, config)?;
    let is_beyond = |scale: &&[f64; 3]| scale.iter().any(|s| !(min..=max).contains(s));
    let beyond = parameters.scale.iter().filter(is_beyond).count();
    let ends = format!("{min:.3e} to {max:.3e}, from model.smallest_scale and model.scale_max");
    remark(beyond, format!("primitives have a scale outside of {ends}, and start at the end"));
    let negative = parameters.density.iter().filter(|&&density| density <= 0.0).count();
    remark(negative, "densities are not positive and start near 0".into());
    remark(outside, "centres are outside of the volume".into());
    Ok((found, remarks))
}

/// The volume whose bright voxels are the first points.
fn first_volume(dataset: &Dataset, from: Start, smoothing: f64) -> Result<Volume> {
    let projector = VoxelProjector::new(&dataset.scanner, RayModel::Joseph)?;
    let to_the_end = |method: &Iterative| {
        let mut run = begin(method, Precision::F32, &projector, &dataset.train, None)?;
        while !run.is_finished() && run.step()?.is_some() {}
        run.into_volume()
    };
    match from {
        Start::Sart => {
            let order = Order::AngularDistance;
            let settings = SartSettings { iterations: PASSES, order, ..SartSettings::default() };
            to_the_end(&Iterative::Sart(&settings))
        }
        Start::Tv => {
            let settings = TvSettings { iterations: ITERATIONS, ..TvSettings::default() };
            to_the_end(&Iterative::Tv(&settings, None, &Division::whole()))
        }
        _ => {
            let volume = fdk(&dataset.scanner, &dataset.train, Window::RamLak, Turn::Full)?;
            Ok(if from == Start::SmoothedFdk { smoothed(volume, smoothing) } else { volume })
        }
    }
}

/// The initial points of the dataset.
fn given(dataset: &Dataset) -> Result<Vec<Point>> {
    let points = dataset.initial_points.as_ref().ok_or_else(|| {
        Error::invalid(
            "initialisation.from",
            "dataset",
            "a dataset with initial points (init_*.npy)",
            "use fdk or random",
        )
    })?;
    let point = |row: ArrayView1<'_, f64>| Point { position: DVec3::new(row[0], row[1], row[2]), density: row[3] };
    Ok(points.rows().into_iter().map(point).collect())
}

/// A volume convolved with a normal distribution of `sigma` voxels along each axis; edge voxels are repeated.
fn smoothed(mut volume: Volume, sigma: f64) -> Volume {
    let reach = (REACH * sigma).ceil() as usize;
    let weights: Vec<f64> = (0..=2 * reach)
        .map(|k| {
            let offset = k as f64 - reach as f64;
            exp(-offset * offset / (2.0 * sigma * sigma))
        })
        .collect();
    let total: f64 = weights.iter().sum();
    for axis in 0..3 {
        let before = volume.values.clone();
        let lanes = |axis| (volume.values.len_of(Axis(axis)), Axis(axis));
        let (n, axis) = lanes(axis);
        Zip::from(volume.values.lanes_mut(axis)).and(before.lanes(axis)).for_each(|mut out, line| {
            for (i, out) in out.iter_mut().enumerate() {
                let at = |k: usize| f64::from(line[(i + k).saturating_sub(reach).min(n - 1)]);
                let sum: f64 = weights.iter().enumerate().map(|(k, weight)| weight * at(k)).sum();
                *out = (sum / total) as f32;
            }
        });
    }
    volume
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::PositionOptimiser;
    use crate::geometry::{Beam, Detector, Grid, Scanner};
    use crate::primitives::{Group, Parameters};
    use crate::scan::simulate::{Object, Plan, simulate};
    use crate::scan::{Noise, Phantom};
    use crate::tolerances::{largest, relative};
    use crate::train::train;
    use ndarray::Array3;

    #[test]
    fn every_first_volume_has_its_points_on_the_object() {
        let detector = Detector { rows: 24, columns: 24, pitch_v: 0.16, pitch_u: 0.16, offset_u: 0.0, offset_v: 0.0 };
        let scanner = Scanner { beam: Beam::Cone { dso: 5.0, dsd: 7.0 }, detector, grid: Grid::cube(16) };
        let plan = Plan { views: 8, test_views: 0, noise: Noise::None, seed: 0 };
        let phantom = Phantom::by_name("torso", 0).unwrap();
        let scan = simulate("scan", Object::Phantom(&phantom), &scanner, &plan).unwrap();
        let truth = &scan.truth.as_ref().unwrap().values;
        // Random points would hit the object less often; FDK has streaks outside of it with so few views.
        assert!(truth.iter().filter(|value| **value > 0.0).count() * 2 < truth.len());
        let mut volumes = Vec::new();
        for from in [Start::Fdk, Start::SmoothedFdk, Start::Sart, Start::Tv] {
            let mut config = Config::default();
            (config.initialisation.from, config.model.points) = (from, 200);
            let primitives = initial_primitives(&scan, &config.plan(&scanner, 8).unwrap()).unwrap();
            let on_object = (primitives.parameters.mean.iter())
                .filter(|mean| {
                    let place = (DVec3::from_array(**mean) - scanner.grid.min) / scanner.grid.spacing;
                    truth[place.to_array().map(|place| place as usize)] > 0.0
                })
                .count();
            assert!(primitives.len() == 200 && on_object >= 140, "{from:?}: {on_object} of {}", primitives.len());
            volumes.push(first_volume(&scan, from, config.initialisation.smoothing).unwrap().values);
        }
        assert!((0..4).all(|i| (0..i).all(|k| volumes[i] != volumes[k])));
    }

    /// A scan, and a model of three primitives in its file.
    fn scan_and_model(kernel: KernelKind) -> (Dataset, tempfile::TempDir, Config) {
        let detector = Detector { rows: 14, columns: 12, pitch_v: 0.3, pitch_u: 0.3, offset_u: 0.0, offset_v: 0.0 };
        let scanner = Scanner { beam: Beam::Cone { dso: 5.0, dsd: 7.0 }, detector, grid: Grid::cube(10) };
        let plan = Plan { views: 4, test_views: 0, noise: Noise::None, seed: 0 };
        let phantom = Phantom::by_name("torso", 0).unwrap();
        let scan = simulate("scan", Object::Phantom(&phantom), &scanner, &plan).unwrap();
        let nu = if kernel == KernelKind::Gaussian { [f64::INFINITY; 3] } else { [3.0, 17.0, 60.0] };
        let parameters = Parameters {
            mean: vec![[0.1, -0.2, 0.3], [0.5, 0.0, -0.4], [-0.3, 0.2, 0.1]],
            scale: vec![[0.1, 0.2, 0.15], [0.3, 0.12, 0.2], [0.25, 0.4, 0.1]],
            quaternion: vec![[1.0, 0.2, 0.0, 0.1], [0.3, 0.4, -0.5, 0.6], [1.0, 0.0, 0.0, 0.0]],
            density: vec![0.4, 0.07, 1.3],
            nu: nu.into(),
        };
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("model.npz");
        model::write(&file, &parameters).unwrap();
        let mut config = Config { iterations: 2, ..Config::default() };
        (config.initialisation.from, config.initialisation.model) = (Start::Model, file.to_str().unwrap().into());
        (config.loss.tv_block, config.wavelet.block) = (8, 8);
        (scan, folder, config)
    }

    #[test]
    fn a_model_starts_with_its_values_and_a_run_without_steps_returns_them() {
        let (scan, _folder, mut config) = scan_and_model(KernelKind::StudentT);
        config.optimiser.position = PositionOptimiser::Adam;
        let still = &mut config.optimiser;
        (still.mean, still.scale, still.quaternion) = ([0.0; 2], [0.0; 2], [0.0; 2]);
        (still.density, still.nu) = ([0.0; 2], [0.0; 2]);
        config.density_control.method = DensityControl::None;
        let expected = model::read(Path::new(&config.initialisation.model)).unwrap();
        let of_three = config.plan(&scan.scanner, scan.train.len()).unwrap();
        assert_eq!(of_three.model.points, 3);
        assert_eq!(initial_primitives(&scan, &of_three).unwrap(), expected);
        // The unit of this scan is not 1, and scales, densities and ν pass through their activations.
        let found = train(&scan, &of_three, None, &mut |_, _| std::ops::ControlFlow::Continue(())).unwrap();
        assert!(found.unit != 1.0);
        for group in Group::ALL {
            for (a, b) in found.primitives.parameters.group(group).iter().zip(expected.parameters.group(group)) {
                within!(relative(*a, *b), "{}", group.key());
            }
        }
        // Another grid: primitives are in scene units.
        let mut other = scan.clone();
        (other.scanner.grid, other.truth) = (Grid { shape: [7, 9, 8], ..scan.scanner.grid }, None);
        assert_eq!(initial_primitives(&other, &of_three).unwrap(), expected);
    }

    /// The remarks on the model of a scan, or the message of the error.
    fn judged(kernel: KernelKind, change: impl Fn(&mut Dataset, &mut Config)) -> std::result::Result<String, String> {
        let (mut scan, _folder, mut config) = scan_and_model(kernel);
        change(&mut scan, &mut config);
        let config = config.plan(&scan.scanner, 4).map_err(|error| error.to_string())?;
        match primitives_of_model(&scan.scanner.grid, &config) {
            Ok((_, remarks)) => Ok(remarks.join("\n")),
            Err(error) => Err(error.to_string()),
        }
    }

    #[test]
    fn what_a_run_changes_about_its_model_is_said() {
        let said = |settings: &[&str]| {
            judged(KernelKind::StudentT, |_, config| {
                settings.iter().for_each(|setting| config.set(setting).unwrap());
            })
            .unwrap()
        };
        assert_eq!(said(&[]), "");
        assert!(said(&["model.nu_max=50"]).contains("1 of 3 ν are outside"));
        assert!(said(&["model.scale_max=0.19"]).contains("1 of 3 primitives have a scale outside"));
        // One of three centres has x = 0.5.
        let narrow = judged(KernelKind::StudentT, |scan, _| scan.scanner.grid.shape[0] = 6).unwrap();
        assert!(narrow.contains("1 of 3 centres are outside"), "{narrow}");
    }

    #[test]
    fn a_model_that_does_not_fit_the_run_is_refused() {
        let (student, gaussian) = (KernelKind::StudentT, KernelKind::Gaussian);
        let set = |setting: &'static str| move |_: &mut Dataset, config: &mut Config| config.set(setting).unwrap();
        let far = |scan: &mut Dataset, _: &mut Config| scan.scanner.grid.min.z += 20.0;
        let plain = |_: &mut Dataset, config: &mut Config| {
            (config.model.kernel, config.confidence.enabled) = (gaussian, false);
        };
        let refused = |kernel, change: &dyn Fn(&mut Dataset, &mut Config)| judged(kernel, change).unwrap_err();
        for (message, names) in [
            (refused(student, &set("model.points=5")), ["model.points: got 5", "`model.points=3`"]),
            (refused(student, &set("initialisation.model=none.npz")), ["none.npz", "read"]),
            (refused(gaussian, &set("seed=0")), ["got gaussian kernels", "`model.kernel=gaussian`"]),
            (refused(student, &plain), ["got student-t kernels", "`model.kernel=student-t`"]),
            (refused(student, &far), ["got 3 of 3 centres", "`initialisation.from=sart`"]),
            (refused(student, &set("density_control.cap=2")), ["density_control.cap: got 2", "4 to 10 million"]),
        ] {
            assert!(names.iter().all(|name| message.contains(name)), "{message}");
        }
    }

    #[test]
    fn smoothing_keeps_the_sum_and_has_its_variance() {
        let mut values = Array3::zeros((21, 19, 17));
        values[[10, 9, 8]] = 1.0;
        let grid = Grid { shape: [21, 19, 17], ..Grid::cube(20) };
        let found = smoothed(Volume::new(grid, values).unwrap(), 1.2).values;
        let sum: f64 = found.iter().map(|&value| f64::from(value)).sum();
        let second: f64 =
            found.indexed_iter().map(|((x, ..), &v)| f64::from(v) * (x as f64 - 10.0) * (x as f64 - 10.0)).sum();
        within!("sum", (sum - 1.0).abs());
        within!("variance", (second / sum - 1.44).abs());
        let even = Volume::new(Grid::cube(6), Array3::from_elem([6; 3], 0.3)).unwrap();
        within!("constant", largest(smoothed(even, 2.0).values - 0.3));
    }
}
