//! Settings chosen by cross-validation over views. Not in the paper.
//!
//! ```text
//! error² = Σ_f ‖A_f x_f - p_f‖² / Σ_f ‖p_f‖²      x_f: from all views but those of fold f
//! ```
//!
//! Views are sorted by angle, and every k-th view belongs to one fold. Parallel views from opposite sides stay
//! together, because each determines the other. The procedure is deterministic. Of values with nearly the least error the
//! simplest is taken: see [`mod@near`].

mod choice;
mod held;
mod near;

use super::space::{Space, some};
use super::{CglsRun, Division, SartRun, SartSettings, TvRun, TvSettings, VoxelRun, Whole};
use crate::classical::VoxelProjector;
pub use choice::{Choice, Trial};
use held::Held;
pub use held::{Mixture, mixture};
use near::{Squares, least_of, near, relative};
use std::collections::BTreeMap;
use std::f64::consts::{PI, TAU};
use std::ops::ControlFlow;
use trgs_core::error::{Error, Result};
use trgs_core::geometry::{Beam, Projections, Volume};
use trgs_core::numeric::elementary::{log, pow};
use trgs_core::numeric::{Real, real};

/// Number of folds for a weight; every second one is held out, one after the other, until the weight is clear.
const WEIGHT_FOLDS: usize = 4;
/// With fewer folds than this, nothing is chosen.
const FEWEST_FOLDS: usize = 3;
/// The first weight tried, the factor between neighbours, and the largest number of steps either way.
const FIRST: f64 = 1e-3;
const FACTOR: f64 = 4.0;
const MOST_NEIGHBOURS: i32 = 5;
/// Fewest reconstructions of a choice by [`choose_weight`]: three weights in the first fold held out.
pub const FEWEST_TRIALS: usize = 3;
/// Number of folds for a number of passes; one of them is held out.
const PASS_FOLDS: usize = 4;
/// Number of folds of a pilot run; one of them is held out.
const PILOT_FOLDS: usize = 6;
/// A finish is judged after every so many iterations, and ends so many iterations after its least error.
const JUDGED_EVERY: usize = 5;
const IN_VAIN: usize = 20;
/// The search for a number of passes ends when the error exceeds the best by this factor.
const PATIENCE: f64 = 1.2;

/// Observer of a choice: gets the setting's name and each trial; breaking ends it with an error.
pub type ObserveChoice<'a> = dyn FnMut(&str, Option<&Trial>) -> ControlFlow<()> + 'a;

/// The method whose number of passes is chosen.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Passes {
    /// SART or OS-SART, with at most the iterations of the settings.
    Sart(SartSettings),
    /// CGLS with at most this many iterations.
    Cgls(usize),
}

/// The weight of [`super::tv()`] with the least error on held-out views, a quarter of all views.
///
/// Not in the paper. A second quarter is held out, too, where another weight is within one standard error of the best.
/// Each weight is judged after the iterations of `settings`, from zeros: with fewer, small weights are further from their
/// minimum than they will be in the run, and a weight too large is chosen. Weights change by factors of four from the
/// first one to either side until the error rises; then a parabola in the logarithm of the weight is fitted to the three
/// around the best. With two views or fewer, the weight of `settings` is returned.
///
/// # Errors
/// Those of [`super::tv()`].
///
/// Tests: `the_weight_is_near_the_best_of_a_grid`, `two_views_are_too_few_to_choose`.
pub fn choose_weight<R: Real>(
    projector: &VoxelProjector,
    projections: &Projections,
    settings: &TvSettings,
    division: &Division,
    observe: &mut ObserveChoice<'_>,
) -> Result<Choice> {
    let all = projector.views(projections.trajectory())?;
    let mut space = |views: &[usize]| division.space::<R>(projector, some(&all, views));
    choose_weight_in(projector, projections, settings, &mut space, observe)
}

/// Makes a space for the views of these numbers.
pub type SpaceOf<'f, 'a, R> = dyn FnMut(&[usize]) -> Result<Box<dyn Space<R> + 'a>> + 'f;

/// [`choose_weight`] in other spaces, whose values at first do not matter.
///
/// # Errors
/// Those of [`choose_weight`] and of the spaces.
pub fn choose_weight_in<'a, R: Real>(
    projector: &VoxelProjector,
    projections: &Projections,
    settings: &TvSettings,
    space: &mut SpaceOf<'_, 'a, R>,
    observe: &mut ObserveChoice<'_>,
) -> Result<Choice> {
    const KEY: &str = "tv.weight";
    let used = weight_folds(projector, projections);
    if used.is_empty() {
        return Ok(Choice::without_folds(KEY, settings.weight));
    }
    // Power of the factor → its error in the first fold, and sums over the folds that are judged.
    let mut errors: BTreeMap<i32, Squares> = BTreeMap::new();
    let (mut folds, mut work) = (0, 0);
    let settings = TvSettings { weight: FIRST, ..*settings };
    let weight = |power: i32| FIRST * pow(FACTOR, f64::from(power));
    for [train, held] in &used {
        // The views held out follow those of the fit.
        let space = space(&[train.as_slice(), held].concat())?;
        let (train, held) = (projections.select(train), projections.select(held));
        let held = Held::<R>::new(projector, &held)?;
        let mut run = TvRun::in_space(projector, &train, &settings, None, space)?;
        let mut error_of = |power: i32| {
            run.restart(weight(power))?;
            let mut see = |judged: Option<Trial>| if judged.is_none() { go_on(observe(KEY, None), 0) } else { Ok(()) };
            let error = |run: &mut TvRun<'_, R>| Ok(held.error(&run.see_others()?));
            let mut judged = judged(&mut run, &error, &|_| false, &|_| usize::MAX, &mut see)?;
            work += judged.iterations * train.len();
            let (_, error) = judged.errors.pop().expect("the last iteration is judged");
            if folds == 0 {
                go_on(observe(KEY, Some(&Trial { value: weight(power), error: relative(error.sums) })), 0)?;
            }
            Ok(error)
        };
        // The first fold decides which weights are tried, and whether the second one is asked.
        if folds == 0 {
            errors = until_it_rises(&[1, -1], &mut error_of, |before, after| after.sums[0] > before.sums[0])?;
        } else {
            for (&power, error) in &mut errors {
                let other = error_of(power)?;
                (0..2).for_each(|k| error.sums[k] += other.sums[k]);
            }
        }
        folds += 1;
        let best = errors.values().min_by(|a, b| a.sums[0].total_cmp(&b.sums[0])).expect("the first weight was tried");
        if errors.values().filter(|error| error.is_near(best)).count() == 1 {
            break;
        }
    }
    let curve: Vec<Trial> =
        (errors.iter()).map(|(&power, error)| Trial { value: weight(power), error: relative(error.sums) }).collect();
    let value = least(&curve);
    Ok(Choice {
        key: KEY.into(),
        value,
        curve,
        folds,
        cost: work as f64 / projections.len() as f64,
        iterations: None,
        share: None,
    })
}

/// The fewest passes within one standard error of the least error on held-out views, a quarter of all views.
///
/// Not in the paper. The search ends when the error exceeds the best by a fifth, so it costs about as much as the
/// passes that it finds. With two views or fewer, the given number is returned.
///
/// # Errors
/// Those of [`super::sart()`].
///
/// Tests: `the_number_of_passes_is_where_the_error_of_the_volume_is_small`, `two_views_are_too_few_to_choose`.
pub fn choose_passes<R: Real>(
    projector: &VoxelProjector,
    projections: &Projections,
    passes: Passes,
    observe: &mut ObserveChoice<'_>,
) -> Result<Choice> {
    const KEY: &str = "passes";
    let most = match passes {
        Passes::Sart(settings) => settings.iterations,
        Passes::Cgls(most) => most,
    };
    let folds = folds(projector, projections, PASS_FOLDS);
    let Some([train, held]) = folds.get(1).filter(|_| projections.len() > 2) else {
        return Ok(Choice::without_folds(KEY, most as f64));
    };
    let (train, views_held) = (projections.select(train), projections.select(held));
    let share = train.len() as f64 / projections.len() as f64;
    let held = Held::<R>::new(projector, &views_held)?;
    let mut see = |judged: Option<Trial>| judged.map_or(Ok(()), |trial| go_on(observe(KEY, Some(&trial)), 0));
    let last = |best: usize| (best as f64 * PATIENCE).max(best as f64 + 1.0).ceil() as usize;
    let when = |iteration: usize| iteration > 0;
    let errors = match passes {
        Passes::Sart(settings) => {
            let all = [projector.views(train.trajectory())?, projector.views(views_held.trajectory())?].concat();
            let others: Vec<usize> = (train.len()..all.len()).collect();
            let space = Box::new(Whole::<R>::new(projector, all, false));
            let mut run = SartRun::in_space(projector, &train, &settings, space)?;
            let error = |run: &mut SartRun<'_, R>| Ok(held.error(&run.see(&others)?));
            judged(&mut run, &error, &when, &last, &mut see)?.errors
        }
        Passes::Cgls(most) => {
            let mut run = CglsRun::<R>::new(projector, &train, most, None)?;
            let error = |run: &mut CglsRun<'_, R>| Ok(held.error(&held.see(run.values())));
            judged(&mut run, &error, &when, &last, &mut see)?.errors
        }
    };
    let curve: Vec<Trial> = (errors.iter())
        .map(|(iteration, error)| Trial { value: *iteration as f64, error: relative(error.sums) })
        .collect();
    let best = near(&errors, 0.0).map_or(1.0, |(passes, _)| *passes as f64);
    let cost = curve.len() as f64 * share;
    Ok(Choice { key: KEY.into(), value: best, curve, folds: 1, cost, iterations: None, share: None })
}

/// What is searched for a finish from a given volume.
#[derive(Clone, Copy, Debug)]
pub struct FinishSearch {
    /// The weight, if it is not to be chosen.
    pub weight: Option<f64>,
    /// The number of iterations, if it is not to be chosen.
    pub iterations: Option<usize>,
    /// The share of the finished volume in the mixture with the start, if it is not to be chosen.
    pub share: Option<f64>,
    /// Smallest and largest number of iterations otherwise.
    pub range: [usize; 2],
    /// The smallest weight that is tried otherwise.
    pub first: f64,
    /// Numbers of iterations whose error exceeds the least by no more than this fraction are near it, too.
    pub near: f64,
}

/// The smallest weight of [`super::tv()`] from the volume `start` whose error of the held-out views is within one standard
/// error of the least, and the fewest iterations within one of its own.
///
/// `views` are those of the fit and those held out. Weights a factor of four apart are tried from the first one upwards
/// until the error rises. The curve has the least error of each weight. The share is that of the mixture of start and
/// finished volume whose error is least, a least-squares problem of one number, because projections are linear in the
/// volume. A long finish forgets its start, and the errors of two volumes found by different models cancel in part.
///
/// # Errors
/// As [`super::tv()`].
pub(crate) fn choose_finish<R: Real>(
    projector: &VoxelProjector,
    views: [&Projections; 2],
    start: &Volume,
    settings: &TvSettings,
    search: &FinishSearch,
    division: &Division,
    observe: &mut ObserveChoice<'_>,
) -> Result<Choice> {
    const KEY: &str = "tv.weight";
    let [train, held] = views;
    // The views held out follow those of the fit.
    let all = [projector.views(train.trajectory())?, projector.views(held.trajectory())?].concat();
    let held = Held::<R>::new(projector, held)?;
    let before = {
        let x: Vec<R> = start.values.iter().map(|&value| real(f64::from(value.max(0.0)))).collect();
        held.residual(&held.see(&x))
    };
    let error = |run: &mut TvRun<'_, R>| Ok(held.mixed(&before, &run.see_others()?, search.share));
    let mut steps = 0;
    // The least error with a weight, and the fewest iterations within one standard error of it.
    let mut least = |weight: f64| {
        let [fewest, most] = search.iterations.map_or(search.range, |iterations| [iterations; 2]);
        let settings = TvSettings { weight, iterations: most, ..*settings };
        let mut run =
            TvRun::in_space(projector, train, &settings, Some(start), division.space::<R>(projector, all.clone())?)?;
        let when =
            |iteration: usize| iteration == fewest || iteration > fewest && iteration.is_multiple_of(JUDGED_EVERY);
        let last = |best: usize| best.max(fewest) + IN_VAIN;
        let mut see = |judged: Option<Trial>| if judged.is_none() { go_on(observe(KEY, None), 0) } else { Ok(()) };
        let judged = judged(&mut run, &error, &when, &last, &mut see)?;
        steps += judged.iterations;
        let best = least_of(&judged.errors).expect("the last iteration is judged").clone();
        go_on(observe(KEY, Some(&Trial { value: weight, error: relative(best.sums) })), 0)?;
        let (iterations, taken) = near(&judged.errors, search.near).expect("the last iteration is judged");
        Ok((weight, *iterations, taken.share, best))
    };
    let first = search.weight.unwrap_or(search.first);
    let sides: &[i32] = if search.weight.is_none() { &[1] } else { &[] };
    let mut of = |power: i32| least(first * pow(FACTOR, f64::from(power)));
    let tried = until_it_rises(sides, &mut of, |before, after| after.3.sums[0] >= before.3.sums[0])?;
    let best = tried.values().map(|(.., error)| error).min_by(|a, b| a.sums[0].total_cmp(&b.sums[0]));
    let best = best.expect("the first weight was tried");
    let &(value, iterations, share, _) =
        tried.values().find(|(.., error)| error.is_near(best)).expect("the best is near itself");
    let curve = tried.values().map(|(value, .., error)| Trial { value: *value, error: relative(error.sums) }).collect();
    let cost = steps as f64 * train.len() as f64 / (train.len() + held.system.trajectory.len()) as f64;
    Ok(Choice { key: KEY.into(), value, curve, folds: 1, cost, iterations: Some(iterations), share: Some(share) })
}

/// What held-out views say about a run.
struct Judged {
    /// Iterations, with the error after each.
    errors: Vec<(usize, Squares)>,
    /// Iterations of the run.
    iterations: usize,
}

/// Judges a run after the iterations `when` and at its end, which is at the latest `last` of the best iteration so far.
///
/// `see` gets nothing for an iteration, and then its error if it is judged.
fn judged<T: VoxelRun>(
    run: &mut T,
    error_of: &dyn Fn(&mut T) -> Result<Squares>,
    when: &dyn Fn(usize) -> bool,
    last: &dyn Fn(usize) -> usize,
    see: &mut dyn FnMut(Option<Trial>) -> Result<()>,
) -> Result<Judged> {
    let (mut errors, mut best, mut iterations) = (Vec::new(), (0, f64::INFINITY), 0);
    loop {
        let ends = run.is_finished();
        if when(iterations) || ends {
            errors.push((iterations, error_of(run)?));
            let error = relative(errors[errors.len() - 1].1.sums);
            if error < best.1 {
                best = (iterations, error);
            }
            see(Some(Trial { value: iterations as f64, error }))?;
        }
        if ends || iterations >= last(best.0) || run.step()?.is_none() {
            return Ok(Judged { errors, iterations });
        }
        iterations += 1;
        see(None)?;
    }
}

/// Trials of the powers from 0 to each of `sides` until the error rises.
fn until_it_rises<T>(
    sides: &[i32],
    trial: &mut dyn FnMut(i32) -> Result<T>,
    rises: fn(&T, &T) -> bool,
) -> Result<BTreeMap<i32, T>> {
    let mut tried = BTreeMap::from([(0, trial(0)?)]);
    for side in sides {
        for power in (1..=MOST_NEIGHBOURS).map(|k| side * k) {
            let after = trial(power)?;
            let ends = rises(&tried[&(power - side)], &after);
            tried.insert(power, after);
            if ends {
                break;
            }
        }
    }
    Ok(tried)
}

/// The views that a pilot run fits and those that it leaves out; none where there are too few views.
pub fn pilot_folds(projector: &VoxelProjector, projections: &Projections) -> Option<[Vec<usize>; 2]> {
    let folds = folds(projector, projections, PILOT_FOLDS);
    folds.into_iter().nth(1).filter(|[train, _]| train.len() >= PILOT_FOLDS - 1)
}

/// An error after `step` where the observer of a run that keeps no checkpoint breaks.
pub(crate) fn go_on(flow: ControlFlow<()>, step: usize) -> Result<()> {
    match flow {
        ControlFlow::Continue(()) => Ok(()),
        ControlFlow::Break(()) => {
            Err(Error::Interrupted { step, remedy: "nothing was written; run the same command again".into() })
        }
    }
}

/// The folds held out for a weight; empty if there are too few views.
fn weight_folds(projector: &VoxelProjector, projections: &Projections) -> Vec<[Vec<usize>; 2]> {
    let folds = folds(projector, projections, WEIGHT_FOLDS);
    if folds.len() < FEWEST_FOLDS { Vec::new() } else { folds.into_iter().step_by(2).collect() }
}

/// For each fold, the views to reconstruct from and the views held out.
///
/// There are fewer folds than k if there are fewer views.
fn folds(projector: &VoxelProjector, projections: &Projections, k: usize) -> Vec<[Vec<usize>; 2]> {
    /// Angles (radians) closer than this are equal.
    const SAME: f64 = 1e-6;
    let turn = if matches!(projector.scanner().beam, Beam::Parallel { .. }) { PI } else { TAU };
    // An angle just below 0 and one just below a full turn are equal, too.
    let angle = |view: usize| (projections.angles[view] + SAME).rem_euclid(turn);
    let mut order: Vec<usize> = (0..projections.len()).collect();
    order.sort_by(|&a, &b| angle(a).total_cmp(&angle(b)));
    let mut rank = vec![0; order.len()];
    for pair in order.windows(2) {
        rank[pair[1]] = rank[pair[0]] + usize::from(angle(pair[1]) - angle(pair[0]) > SAME);
    }
    let k = k.min(rank.iter().max().map_or(0, |last| last + 1));
    let of = |fold: usize| (0..rank.len()).partition(|&view| rank[view] % k != fold);
    (0..k)
        .map(of)
        .map(|(train, held): (Vec<usize>, Vec<usize>)| [train, held])
        .filter(|[train, _]| !train.is_empty())
        .collect()
}

/// The value of least error, interpolated by a parabola in the logarithm of the value.
fn least(curve: &[Trial]) -> f64 {
    let best =
        (0..curve.len()).min_by(|&a, &b| curve[a].error.total_cmp(&curve[b].error)).expect("something was tried");
    if best == 0 || best + 1 == curve.len() {
        return curve[best].value;
    }
    let [low, middle, high] = [best - 1, best, best + 1].map(|i| log(curve[i].error));
    let bend = low - 2.0 * middle + high;
    let shift = if bend > 0.0 { 0.5 * (low - high) / bend } else { 0.0 };
    curve[best].value * pow(FACTOR, shift)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::classical::RayModel;
    use crate::classical::algebraic::{Pass, sart, tv};
    use crate::evaluation::psnr_3d;
    use trgs_core::geometry::{Detector, Grid, Scanner};
    use trgs_scan::simulate::{Object, Plan, simulate};
    use trgs_scan::{Dataset, Noise, Phantom};

    pub(super) fn scan(views: usize, beam: Beam) -> Dataset {
        let detector = Detector { rows: 32, columns: 32, pitch_v: 0.12, pitch_u: 0.12, offset_u: 0.0, offset_v: 0.0 };
        let scanner = Scanner { beam, detector, grid: Grid::cube(24) };
        let plan = Plan { views, test_views: 0, noise: Noise::MEDIUM, seed: 3 };
        let phantom = Phantom::by_name("torso", 0).unwrap();
        // Projections of the voxels, interpolated, since the projector can represent those. Projections of the phantom
        // itself say less about the best voxel means.
        let volume = simulate("torso", Object::Phantom(&phantom), &scanner, &plan).unwrap().truth.unwrap();
        simulate("torso", Object::Volume(&volume), &scanner, &plan).unwrap()
    }

    pub(super) const CONE: Beam = Beam::Cone { dso: 5.0, dsd: 7.0 };

    #[test]
    fn the_weight_is_near_the_best_of_a_grid() {
        let scan = scan(12, CONE);
        let projector = VoxelProjector::new(&scan.scanner, RayModel::Joseph).unwrap();
        let mut quiet = |_: &str, _: Option<&Trial>| ControlFlow::Continue(());
        let choice =
            choose_weight::<f32>(&projector, &scan.train, &TvSettings::default(), &Division::whole(), &mut quiet)
                .unwrap();
        let truth = scan.truth.as_ref().unwrap().values.view();
        let psnr = |weight: f64| {
            let settings = TvSettings { weight, ..TvSettings::default() };
            let volume =
                tv::<f32>(&projector, &scan.train, &settings, None, &mut |_| ControlFlow::Continue(())).unwrap();
            psnr_3d(truth, volume.values.view()).value
        };
        let best = (0..7).map(|i| psnr(0.03 / pow(2.0, f64::from(i)))).fold(0.0, f64::max);
        let found = psnr(choice.value);
        eprintln!("weight {:.5}: {found:.2} dB, best {best:.2} dB, {choice:?}", choice.value);
        within!(best - found, "{found} dB, best {best} dB: {choice:?}");
        assert!(found > psnr(0.03) + 1.0, "no better than a weight far off");
        assert!(choice.curve.is_sorted_by(|a, b| a.value < b.value) && choice.folds == 1);
        // Fewer iterations leave small weights far from their minimum, and cost as much less.
        let short = TvSettings { iterations: 20, ..TvSettings::default() };
        let short = choose_weight::<f32>(&projector, &scan.train, &short, &Division::whole(), &mut quiet).unwrap();
        assert!(short.value > choice.value, "{short:?}");
        let of_one = |choice: &Choice| choice.cost / (choice.curve.len() * choice.folds) as f64;
        assert!(of_one(&short) < of_one(&choice), "{short:?}");
        // With a view more, two weights predict the views held out about equally well: a second fold is asked.
        let scan = self::scan(13, CONE);
        let projector = VoxelProjector::new(&scan.scanner, RayModel::Joseph).unwrap();
        let settings = TvSettings::default();
        let unsure = choose_weight::<f32>(&projector, &scan.train, &settings, &Division::whole(), &mut quiet).unwrap();
        assert_eq!(unsure.folds, 2, "{unsure:?}");
    }

    #[test]
    fn the_number_of_passes_is_where_the_error_of_the_volume_is_small() {
        let scan = scan(12, CONE);
        let projector = VoxelProjector::new(&scan.scanner, RayModel::Joseph).unwrap();
        let mut quiet = |_: &str, _: Option<&Trial>| ControlFlow::Continue(());
        let truth = scan.truth.as_ref().unwrap().values.view();
        let settings = SartSettings { iterations: 60, ..SartSettings::default() };
        let choice = choose_passes::<f32>(&projector, &scan.train, Passes::Sart(settings), &mut quiet).unwrap();
        let psnr = |iterations: usize| {
            let settings = SartSettings { iterations, ..settings };
            let volume = sart::<f32>(&projector, &scan.train, &settings, &mut |_| ControlFlow::Continue(())).unwrap();
            psnr_3d(truth, volume.values.view()).value
        };
        let best = [1, 2, 3, 4, 6, 8, 12, 20, 40, 60].map(psnr).into_iter().fold(0.0, f64::max);
        let found = psnr(choice.value as usize);
        eprintln!("{} passes: {found:.2} dB, best {best:.2} dB", choice.value);
        within!(best - found, "{found} dB after {} passes, best {best} dB", choice.value);
        assert!(found > psnr(1) + 1.0, "no better than a single pass");
    }

    #[test]
    fn a_finish_is_chosen_where_the_volume_is_good() {
        let scan = scan(12, CONE);
        let projector = VoxelProjector::new(&scan.scanner, RayModel::Joseph).unwrap();
        let [fitted, held] = pilot_folds(&projector, &scan.train).unwrap();
        assert_eq!((fitted.len(), held.len()), (10, 2));
        let [fitted, held] = [fitted, held].map(|views| scan.train.select(&views));
        let settings = SartSettings { iterations: 3, ..SartSettings::default() };
        let start = sart::<f32>(&projector, &fitted, &settings, &mut |_| ControlFlow::Continue(())).unwrap();
        let truth = scan.truth.as_ref().unwrap().values.view();
        let finished = |weight: f64, iterations: usize| {
            let settings = TvSettings { weight, iterations, tolerance: 0.0, ..TvSettings::default() };
            let mut quiet = |_: &Pass| ControlFlow::Continue(());
            let volume = tv::<f32>(&projector, &fitted, &settings, Some(&start), &mut quiet).unwrap();
            psnr_3d(truth, volume.values.view()).value
        };
        let free =
            FinishSearch { weight: None, iterations: None, share: Some(1.0), range: [0, 60], first: 4e-4, near: 0.0 };
        let choose = |search: &FinishSearch| {
            let mut quiet = |_: &str, _: Option<&Trial>| ControlFlow::Continue(());
            let views = [&fitted, &held];
            choose_finish::<f32>(
                &projector,
                views,
                &start,
                &TvSettings::default(),
                search,
                &Division::whole(),
                &mut quiet,
            )
            .unwrap()
        };
        let choice = choose(&free);
        let found = finished(choice.value, choice.iterations.unwrap());
        let weights = [1e-4, 4e-4, 1.6e-3, 6.4e-3, 2.56e-2];
        let all = weights.map(|weight| [5, 20, 60].map(|iterations| finished(weight, iterations)));
        let best = all.iter().flatten().copied().fold(0.0, f64::max);
        let start = psnr_3d(truth, start.values.view()).value;
        eprintln!("{found:.2} dB by {choice:?}; start {start:.2}, grid {all:.2?}");
        within!(best - found, "{found} dB, best {best} dB");
        assert!(found > start + 1.0, "{found} dB, start {start} dB");
        assert!(choice.curve.is_sorted_by(|a, b| a.value < b.value) && choice.curve.len() >= 2);
        // A fixed weight and a fixed number are not varied.
        let fixed = choose(&FinishSearch { weight: Some(0.01), iterations: Some(7), ..free });
        assert_eq!((fixed.value, fixed.iterations, fixed.curve.len()), (0.01, Some(7), 1));
        // The share that is found has a smaller error than the finished volume alone.
        let heavy = FinishSearch { weight: Some(0.03), iterations: Some(60), ..free };
        let (open, whole) = (choose(&FinishSearch { share: None, ..heavy }), choose(&heavy));
        let share = open.share.unwrap();
        let mixed = choose(&FinishSearch { share: open.share, ..heavy });
        assert!((0.0..1.0).contains(&share) && mixed.curve[0].error < whole.curve[0].error, "{share}, {mixed:?}");
        assert_eq!((whole.share, &open.curve), (Some(1.0), &whole.curve));
        let most = choose(&FinishSearch { range: [10, 60], first: 2e-3, ..free });
        assert!(most.curve[0].value == 2e-3 && most.iterations.unwrap() >= 10);
    }

    #[test]
    fn two_views_are_too_few_to_choose() {
        let scan = scan(2, CONE);
        let projector = VoxelProjector::new(&scan.scanner, RayModel::Joseph).unwrap();
        let mut quiet = |_: &str, _: Option<&Trial>| ControlFlow::Continue(());
        let weight =
            choose_weight::<f32>(&projector, &scan.train, &TvSettings::default(), &Division::whole(), &mut quiet)
                .unwrap();
        assert!(weight.curve.is_empty() && weight.value == TvSettings::default().weight);
        let passes = choose_passes::<f32>(&projector, &scan.train, Passes::Cgls(7), &mut quiet).unwrap();
        assert!(passes.curve.is_empty() && passes.value == 7.0);
        assert_eq!(pilot_folds(&projector, &scan.train), None);
    }

    #[test]
    fn folds_share_all_views_and_opposite_parallel_views_stay_together() {
        let scan = scan(8, Beam::Parallel { dso: 5.0 });
        let projector = VoxelProjector::new(&scan.scanner, RayModel::Joseph).unwrap();
        let folds = folds(&projector, &scan.train, 3);
        let mut all: Vec<usize> = folds.iter().flat_map(|[_, held]| held.clone()).collect();
        all.sort_unstable();
        assert_eq!(all, [0, 1, 2, 3, 4, 5, 6, 7]);
        for [_, held] in folds {
            assert!(held.iter().all(|&view| held.contains(&((view + 4) % 8))), "{held:?}");
        }
    }
}
