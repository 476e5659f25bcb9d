//! The pilot run: a shorter training without some of the views, on which the finish is chosen. Not in the paper.
//!
//! Primitives are fitted to five sixths of the views in half of the iterations. Their volume is finished as that of the run is
//! (`super::finish`), with weights of the total variation a factor of four apart. The run takes the weight with
//! the least error in the views held out, and the first number of iterations that comes near that error:
//!
//! ```text
//! error = ‖A x - p'‖ / ‖p'‖     p': views held out, corrected where the views of the fit are corrected
//! ```
//!
//! The views held out have to be unknown to the primitives, too, which is why the pilot trains primitives of its own.

use super::finish::{LEAST, SHORTEST, target};
use super::{Observe, Progress};
use crate::classical::VoxelProjector;
use crate::classical::algebraic::{Choice, FinishSearch, Trial, choose_finish, pilot_folds};
use crate::config::{Config, Sampling};
use crate::error::Result;
use crate::numeric::Real;
use crate::scene::{Dataset, interpolant};
use crate::train::{Record, train};
use std::ops::ControlFlow;

/// Iterations of the pilot as a fraction of those of the run.
pub const PILOT_PART: f64 = 0.5;
/// The smallest weight that is tried for an interpolant: below it the error of held-out views still falls while the volume
/// becomes worse.
const FIRST: f64 = 4e-4;
/// Most iterations of a finish that are tried.
const MOST_ITERATIONS: usize = 200;

/// Weight and number of iterations of the finish of a run whose volume is sampled as `sampling`; none where there are too
/// few views to hold any out.
///
/// # Errors
/// Those of the training and of the method tv, and [`crate::Error::Interrupted`] when `observe` breaks.
pub(super) fn choose<R: Real>(
    dataset: &Dataset,
    sampling: Sampling,
    config: &Config,
    observe: &mut Observe<'_>,
) -> Result<Option<Choice>> {
    let projector = VoxelProjector::new(&dataset.scanner, config.algebraic.rays)?;
    let Some([train_views, held_views]) = pilot_folds(&projector, &dataset.train) else { return Ok(None) };
    let config = shorter(&config.resolved(&dataset.scanner, dataset.train.len()));
    let held = dataset.train.select(&held_views);
    let part = Dataset { train: dataset.train.select(&train_views), truth: None, test: None, ..dataset.clone() };
    let mut watch = |_, _: Option<&Record>| observe(Progress::Choosing("tv.weight", None));
    let found = train(&part, &config, None, &mut watch)?;
    let start = match sampling {
        Sampling::Interpolant => interpolant(&found.volume),
        _ => found.volume,
    };
    let of = |views| target(views, &dataset.scanner, &found.primitives, &start, sampling, &projector, &config);
    let (first, fewest) = match sampling {
        Sampling::Interpolant => (FIRST, 0),
        _ => (LEAST, SHORTEST),
    };
    let search = FinishSearch {
        weight: config.tv.weight.fixed(),
        iterations: config.tv.finish_iterations.fixed(),
        range: [fewest, MOST_ITERATIONS],
        first,
    };
    let mut watch = |key: &str, trial: Option<&Trial>| -> ControlFlow<()> { observe(Progress::Choosing(key, trial)) };
    let views = [&*of(&part.train)?, &*of(&held)?];
    let mut choice = choose_finish::<R>(&projector, views, &start, &config.tv(), &search, &mut watch)?;
    // One iteration of the training projects one view.
    choice.cost += config.iterations as f64 / dataset.train.len() as f64;
    Ok(Some(choice))
}

/// The configuration of the pilot, from a resolved one: intervals shrink with the run.
fn shorter(config: &Config) -> Config {
    let mut pilot = config.clone();
    let scaled = |iterations: usize| ((iterations as f64 * PILOT_PART) as usize).max(1);
    pilot.iterations = scaled(config.iterations);
    pilot.density_control.every = scaled(config.density_control.every);
    pilot.confidence.every = scaled(config.confidence.every);
    pilot
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::{Auto, Method};
    use crate::reconstruction::reconstruct;
    use crate::scene::simulate::{Object, Plan, simulate};
    use crate::scene::{Beam, Detector, Grid, Noise, Phantom, Scanner};

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
        (fixed.tv.weight, fixed.tv.finish_iterations) =
            (Auto::Fixed(choice.value), Auto::Fixed(choice.iterations.unwrap()));
        let again = reconstruct(&scan, &fixed).unwrap();
        assert!(again.choice.is_none() && again.volume.values == found.volume.values);
        assert!(!fixed.has_pilot() && config.has_pilot());
    }

    #[test]
    fn too_few_views_make_no_pilot() {
        let found = choose::<f32>(&scan(3), Sampling::Point, &config(), &mut |_| ControlFlow::Continue(())).unwrap();
        assert_eq!(found, None);
    }

    #[test]
    fn a_pilot_is_a_shorter_run_of_the_same_kind() {
        let scan = scan(8);
        let config = config().resolved(&scan.scanner, scan.train.len());
        let pilot = shorter(&config);
        assert_eq!(pilot.iterations, 20);
        let (control, whole) = (&pilot.density_control, &config.density_control);
        assert_eq!((control.cap, control.every), (whole.cap, 1.max(whole.every / 2)));
    }
}
