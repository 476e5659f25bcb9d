//! The pilot run: a shorter training without some of the views, on which sampling and finish are chosen. Not in the paper.
//!
//! Primitives are fitted to five sixths of the views in half of the iterations. Their volume is sampled and finished as
//! that of the run is (`super::finish`), with weights of the total variation a factor of four apart. The run takes the
//! smallest weight within one standard error of the least error in the views held out, the fewest iterations within one
//! of the weight's own, and the share of the finished volume in its mixture with the one before that has the least error.
//! Where the sampling is open, both are tried, and the one with the smaller error is taken:
//!
//! ```text
//! error = ‖A x - p'‖ / ‖p'‖     p': views held out, corrected where the views of the fit are corrected
//! ```
//!
//! Where the training sees longer voxels, weights are chosen on those, and all else on the scan as it is.
//!
//! Each sampling is a model of the scan. With the interpolant, `A x` predicts the views held out; with point samples, the
//! projections F of the primitives do, changed by `A (x - x₀)` as the finish changes the volume.
//!
//! The views held out have to be unknown to the primitives, too, which is why the pilot trains primitives of its own. Where
//! the run starts from a model, which may have seen those views, the pilot starts from SART.

use super::finish::{LEAST, SHORTEST, target};
use super::{Observe, Progress, Sampled};
use crate::classical::VoxelProjector;
use crate::classical::algebraic::{Choice, Trial};
use crate::config::{Plan, Sampling, Start};
use crate::error::Result;
use crate::geometry::{Projections, Volume};
use crate::primitives::Primitives;
use crate::projector::Field;
use crate::reconstruction::Evidence;
use crate::scan::{Dataset, interpolant};
use crate::train::{Decision, MOST_ITERATIONS, Record, TrainedModel, seen, train};
use std::ops::ControlFlow;
use trgs_core::in_precision;
use trgs_methods::internals::{FinishSearch, choose_finish, pilot_folds};

/// Iterations of the pilot as a fraction of those of the run.
pub const PILOT_PART: f64 = 0.5;
/// The smallest weight that is tried for an interpolant: below it the error of held-out views still falls while the volume
/// becomes worse.
const FIRST: f64 = 4e-4;
/// Where the projections are corrected, fewer iterations are taken for this fraction of the error: it still falls a little
/// while edges are smoothed, which the views held out do not see.
const NEAR_CORRECTED: f64 = 0.02;

/// What a pilot run found.
pub(super) struct Found {
    /// How to sample the volume.
    pub(super) sampled: Sampled,
    /// Weight, number of iterations and share of the finish.
    pub(super) choice: Choice,
}

impl Found {
    /// What a checkpoint keeps of a run of so many iterations.
    pub(super) fn decision(&self, iterations: usize) -> Decision {
        let Sampled { sampling, evidence } = self.sampled;
        let errors = evidence.map(|evidence| [evidence.point, evidence.interpolant]);
        Decision { iterations, sampling, errors, finish: self.choice.clone() }
    }
}

impl From<Decision> for Found {
    fn from(Decision { sampling, errors, finish, .. }: Decision) -> Self {
        let evidence = errors.map(|[point, interpolant]| Evidence { point, interpolant });
        Self { sampled: Sampled { sampling, evidence }, choice: finish }
    }
}

/// Sampling and finish of a run by a pilot run; none where there are too few views to hold any out.
///
/// # Errors
/// Those of the training and of the method tv, and [`crate::Error::Interrupted`] when `observe` breaks.
pub(super) fn choose(dataset: &Dataset, config: &Plan, observe: &mut Observe<'_>) -> Result<Option<Found>> {
    let projector = VoxelProjector::new(&dataset.scanner, config.algebraic.rays)?;
    let Some(folds) = pilot_folds(&projector, &dataset.train) else { return Ok(None) };
    let config = shorter(config);
    let part = dataset.of_views(&folds[0]);
    let mut watch = |iteration, record: Option<&Record>| observe(Progress::Pilot(iteration, record));
    let TrainedModel { primitives, volume, .. } = train(&part, &config, None, &mut watch)?;
    let views = |scan: &Dataset| [0, 1].map(|i| scan.train.select(&folds[i]));
    let whole = Scale { projector, views: views(dataset), volume, factor: 1.0 };
    let coarse = match &*seen(dataset, &config) {
        seen if config.coarse > 1 => {
            let projector = VoxelProjector::new(&seen.scanner, config.algebraic.rays)?;
            let (grid, cutoff) = (seen.scanner.grid, config.cutoff);
            let voxels = in_precision!(
                config.precision,
                R => Field::<R>::new(&primitives, cutoff).on(&grid).voxels_in_single()
            );
            let volume = Volume::new(grid, voxels)?;
            Some(Scale { projector, views: views(seen), volume, factor: config.coarse as f64 })
        }
        _ => None,
    };
    let mut judge = |scale: &Scale, sampling, weight| finish_of(&primitives, scale, sampling, weight, &config, observe);
    let mut choice_of = |sampling| -> Result<Choice> {
        let Some(coarse) = &coarse else { return judge(&whole, sampling, None) };
        let coarse = judge(coarse, sampling, None)?;
        let whole = judge(&whole, sampling, Some(coarse.value))?;
        Ok(Choice { cost: coarse.cost + whole.cost, ..whole })
    };
    let (sampled, mut choice) = match config.sampling {
        Sampling::Auto => {
            let [interpolant, point] = [choice_of(Sampling::Interpolant)?, choice_of(Sampling::Point)?];
            let evidence = Evidence { point: error(&point), interpolant: error(&interpolant) };
            let cost = interpolant.cost + point.cost;
            let (sampling, choice) = match evidence.is_interpolated() {
                true => (Sampling::Interpolant, interpolant),
                false => (Sampling::Point, point),
            };
            (Sampled { sampling, evidence: Some(evidence) }, Choice { cost, ..choice })
        }
        sampling => (Sampled { sampling, evidence: None }, choice_of(sampling)?),
    };
    // One iteration of the training projects one view.
    choice.cost += config.iterations as f64 / dataset.train.len() as f64;
    Ok(Some(Found { sampled, choice }))
}

/// Voxels on which a finish of the pilot's volume is judged.
struct Scale {
    projector: VoxelProjector,
    /// Views of the fit and those held out.
    views: [Projections; 2],
    /// The volume of the pilot's primitives.
    volume: Volume,
    /// Length of a voxel in voxels of the scan. λ is relative to the largest entry of Aᵀp, so the same functional has a
    /// weight that is so many times as small.
    factor: f64,
}

/// The finish of the pilot's volume, sampled as `sampling`, that the views held out ask for; its weight can be given.
fn finish_of(
    primitives: &Primitives,
    scale: &Scale,
    sampling: Sampling,
    weight: Option<f64>,
    config: &Plan,
    observe: &mut Observe<'_>,
) -> Result<Choice> {
    let Scale { projector, views, volume, factor } = scale;
    let interpolated: Volume;
    let (start, first, fewest, near) = match sampling {
        Sampling::Interpolant => {
            interpolated = interpolant(volume);
            (&interpolated, FIRST, 0, 0.0)
        }
        _ => (volume, LEAST, SHORTEST, NEAR_CORRECTED),
    };
    let search = FinishSearch {
        weight: config.tv.weight.fixed().or(weight).map(|weight| weight / factor),
        iterations: config.tv.finish_iterations.fixed(),
        share: config.tv.share.fixed(),
        range: [fewest, MOST_ITERATIONS],
        first,
        near,
    };
    let of = |views| target(views, projector.scanner(), primitives, start, sampling, projector, config);
    let [train, held] = [of(&views[0])?, of(&views[1])?];
    let mut watch = |key: &str, trial: Option<&Trial>| -> ControlFlow<()> {
        let trial = trial.map(|trial| Trial { value: trial.value * factor, ..*trial });
        observe(Progress::Choosing(key, trial.as_ref()))
    };
    let mut found = choose_finish(
        config.precision,
        projector,
        [&train, &held],
        start,
        &config.tv(),
        &search,
        config.division(),
        &mut watch,
    )?;
    found.value *= factor;
    found.curve.iter_mut().for_each(|trial| trial.value *= factor);
    // An iteration projects so many times fewer rays through so many times fewer voxels.
    found.cost /= factor * factor * factor;
    Ok(found)
}

/// The least error of a choice.
fn error(choice: &Choice) -> f64 {
    choice.curve.iter().fold(f64::INFINITY, |least, trial| least.min(trial.error))
}

/// The configuration of the pilot, from a resolved one: intervals shrink with the run.
fn shorter(plan: &Plan) -> Plan {
    let scaled = |iterations: usize| ((iterations as f64 * PILOT_PART) as usize).max(1);
    plan.changed(|pilot| {
        pilot.iterations = scaled(plan.iterations);
        pilot.density_control.every = scaled(plan.density_control.every);
        pilot.confidence.every = scaled(plan.confidence.every);
        if plan.initialisation.from == Start::Model {
            // The model may have seen the views that are held out.
            (pilot.initialisation.from, pilot.initialisation.model) = (Start::Sart, String::new());
        }
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::{Auto, Config, Finish, Method};
    use crate::geometry::{Beam, Detector, Grid, Scanner};
    use crate::reconstruction::reconstruct;
    use crate::scan::simulate::{Object, Plan, simulate};
    use crate::scan::{Noise, Phantom};

    fn scan(views: usize) -> Dataset {
        let detector = Detector { rows: 20, columns: 20, pitch_v: 0.2, pitch_u: 0.2, offset_u: 0.0, offset_v: 0.0 };
        let scanner = Scanner { beam: Beam::Cone { dso: 5.0, dsd: 7.0 }, detector, grid: Grid::cube(12) };
        let plan = Plan { views, test_views: 0, noise: Noise::LOW, seed: 1 };
        simulate("scan", Object::Phantom(&Phantom::by_name("torso", 0).unwrap()), &scanner, &plan).unwrap()
    }

    fn config() -> Config {
        let mut config = Config { iterations: 40, sampling: Sampling::Point, ..Config::of(Method::TrGs) };
        config.model.points = 150;
        config
    }

    #[test]
    fn the_finish_is_as_the_pilot_says() {
        let (scan, config) = (scan(8), config());
        let found = reconstruct(&scan, &config).unwrap();
        let choice = found.choice.unwrap();
        assert!(choice.folds == 1 && choice.value >= LEAST && choice.cost > 0.0);
        let mut fixed = config.clone();
        fixed.tv.weight = Auto::Fixed(choice.value);
        fixed.tv.finish_iterations = Auto::Fixed(choice.iterations.unwrap());
        fixed.tv.share = Auto::Fixed(choice.share.unwrap());
        let again = reconstruct(&scan, &fixed).unwrap();
        assert!(again.choice.is_none() && again.volume.values == found.volume.values);
        assert!(!fixed.has_pilot() && config.has_pilot());
    }

    #[test]
    fn too_few_views_make_no_pilot() {
        let plan = config().plan(&scan(3).scanner, 3).unwrap();
        let found = choose(&scan(3), &plan, &mut |_| ControlFlow::Continue(())).unwrap();
        assert!(found.is_none());
        // Point samples, then: nothing speaks for an interpolated volume.
        let auto = Config { sampling: Sampling::Auto, ..config() };
        let sampled = reconstruct(&scan(3), &auto).unwrap().sampled.unwrap();
        assert_eq!(sampled, Sampled { sampling: Sampling::Point, evidence: None });
    }

    #[test]
    fn the_pilot_decides_the_sampling_where_it_is_open() {
        let scan = scan(8);
        let config = Config { sampling: Sampling::Auto, ..config() };
        let found = reconstruct(&scan, &config).unwrap();
        let (sampled, choice) = (found.sampled.unwrap(), found.choice.unwrap());
        let evidence = sampled.evidence.unwrap();
        assert_eq!(sampled.sampling == Sampling::Interpolant, evidence.interpolant < evidence.point);
        // The finish that is chosen is that of the sampling that is chosen.
        let alone = Config { sampling: sampled.sampling, ..config.clone() };
        let fixed = reconstruct(&scan, &alone).unwrap();
        let expected = Choice { cost: choice.cost, ..fixed.choice.clone().unwrap() };
        assert_eq!((fixed.sampled.unwrap().evidence, &choice), (None, &expected));
        assert!(choice.cost > fixed.choice.unwrap().cost);
        assert_eq!(fixed.volume.values, found.volume.values);
        assert_eq!(evidence.point.min(evidence.interpolant), error(&choice));
        // Without a finish the pilot run decides the sampling alone.
        let unfinished = reconstruct(&scan, &Config { finish: Finish::None, ..config }).unwrap();
        assert!(unfinished.choice.is_none() && unfinished.unfinished.is_none());
        assert_eq!(unfinished.sampled, Some(sampled));
        assert_eq!(unfinished.volume, found.unfinished.unwrap());
    }

    #[test]
    fn a_coarse_pilot_has_its_weight_from_longer_voxels_and_all_else_from_the_scan() {
        let (scan, mut config) = (scan(8), Config { coarse: 2, sampling: Sampling::Auto, ..config() });
        let choose = |scan: &Dataset, config: &Config| {
            let mut trials = Vec::new();
            let plan = config.plan(&scan.scanner, scan.train.len()).unwrap();
            let plan = plan.changed(|plan| plan.density_unit = Auto::Fixed(1.0));
            let mut watch = |progress: Progress<'_>| {
                if let Progress::Choosing(_, Some(trial)) = progress {
                    trials.push(trial.value);
                }
                ControlFlow::Continue(())
            };
            let Found { sampled, choice } = choose(scan, &plan, &mut watch).unwrap().unwrap();
            (sampled, choice, trials)
        };
        let (sampled, choice, trials) = choose(&scan, &config);
        let coarse = Config { coarse: 1, sampling: sampled.sampling, ..config.clone() };
        let (_, expected, tried) = choose(&scan.coarser(2), &coarse);
        assert_eq!((choice.value, choice.curve.len()), (2.0 * expected.value, 1));
        assert!(tried.iter().all(|value| trials.contains(&(2.0 * value))));
        assert!(sampled.evidence.is_some() && choice.iterations.is_some() && choice.share.is_some());
        // Iterations and share are those of the pilot's primitives on the voxels of the scan.
        config.sampling = sampled.sampling;
        let alone = choose(&scan, &config).1;
        assert_eq!((alone.value, alone.iterations, alone.share), (choice.value, choice.iterations, choice.share));
        config.tv.weight = Auto::Fixed(choice.value);
        let fixed = choose(&scan, &config).1;
        assert_eq!((fixed.value, fixed.iterations, fixed.share), (choice.value, choice.iterations, choice.share));
    }

    #[test]
    fn a_pilot_is_a_shorter_run_of_the_same_kind() {
        let scan = scan(8);
        let config = config().plan(&scan.scanner, scan.train.len()).unwrap();
        let pilot = shorter(&config);
        assert_eq!(pilot.iterations, 20);
        let (control, whole) = (&pilot.density_control, &config.density_control);
        assert_eq!((control.cap, control.every), (whole.cap, 1.max(whole.every / 2)));
        // Whatever a model knows, the pilot does not.
        let from_model = config.changed(|config| {
            (config.initialisation.from, config.initialisation.model) = (Start::Model, "model.npz".into());
        });
        assert_eq!(shorter(&from_model), pilot);
        assert_eq!(pilot.initialisation.from, Start::Sart);
    }
}
