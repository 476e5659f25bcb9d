//! Detects a scan's conventions: rows and columns of images, sense of rotation, offset and roll of the detector, axis shift.
//!
//! Not in the paper.
//!
//! A scan read with a wrong convention mostly contradicts itself: no object has such views. Coarse reconstructions are
//! made under the eight symmetries of the image (rows reversed or not, columns reversed or not, transposed or not) and
//! both senses of rotation, each from two thirds of the views with two passes of SART `[SART84]`. The remaining third
//! is predicted and compared: the residual is `‖A x - p‖/‖p‖` over all views, each with an x reconstructed without it.
//! Views used in a reconstruction can be fitted under a wrong convention, too; held-out views cannot be predicted. The
//! detector offsets along u and v minimise the same residual.
//!
//! # Ambiguities
//!
//! Let `P_f(φ, u, v)` be the scan of an object f as on the [geometry page](trgs_core::geometry). An orthogonal map
//! of space that takes every ray of the scan to a ray of the scan gives another object with the same rays, relabelled.
//! There are three:
//!
//! | object | its scan | projections cannot distinguish |
//! |---|---|---|
//! | rotated, `f(R_β x)` | `P_f(φ + β, u, v)` | the zero of the angles |
//! | mirrored at z = 0 | `P_f(φ, u, -v)` | rows from the top, and rows from the bottom |
//! | mirrored at y = 0 | `P_f(-φ, -u, v)` | a scan, and one with columns *and* rotation reversed |
//!
//! The first shifts the angle of the source. For the second, z → -z keeps source, u and w and reverses v. For the
//! third, y → -y takes the source to that of -φ, and `u(φ) = (-sin φ, cos φ, 0)` to `-u(-φ)`. Reversing rows or columns
//! changes the sign of the detector's offset, since an image is reversed about its own centre. So the sixteen
//! conventions form four classes of four, distinguished by *transposed or not* and by *columns reversed ≠ rotation
//! reversed*. Only the object can decide which member of a class is right: if the true volume or initial points are
//! given, reconstructions under the members and in four quarter turns are compared with them.
//!
//! What the data distinguish:
//!
//! - **Columns reversed alone**, or rotation alone. In the plane of the source the ray (φ, u) has the direction
//!   `θ = φ + γ` and the distance `s = dso·sin γ` from the axis, `tan γ = u/dsd`. With reversed columns its value is that of
//!   the ray (θ - 2γ, -s), which is the ray (θ - 2γ, s) of the object after half a turn: a sinogram sheared by
//!   `2γ ≈ 2s/dso`. A point at distance r from the axis then traces a sine with a second harmonic of `r²/dso`, which no real
//!   point does. The effect vanishes for narrow fans: when `r²/dso` is below a pixel, or for a body of revolution, the
//!   data do not decide, and the check says so.
//! - **In a parallel beam** γ is 0, and the view of φ + π is that of φ with columns reversed. Then reversed columns
//!   equal a half turn of the object, and reversed rotation equals a half turn and a mirror image. All eight
//!   conventions that are not transposed form one class, for a half turn as for a full one.
//! - **Transposed** images seem to rotate about an axis along u. With parallel rays the sum of each row, `∫ P du`, is
//!   the object's mass at that height in every view. In a transposed scan it is a projection of all heights together,
//!   which depends on φ unless the object is a body of revolution. In a cone beam the same holds up to the
//!   magnification of each depth. Only a square detector can be transposed.
//! - **An offset along u** moves the axis of rotation in the image, so that opposite views disagree.
//! - **An offset along v**: with parallel rays it is a shift of the object along z and invisible. In a cone beam a
//!   shift by δ would have to be `δ·d/dsd` at depth d: only its change over the object's depth is visible, `r/dso` of
//!   δ. The uncertainty states how well.
//! - **A roll of the detector** turns every image. No rotation of an object does so in all views, so it is visible, and
//!   the data determine it well. Its sign belongs to the convention: reversed rows reverse it.
//!   Where it differs from the stated roll by three standard errors, the offsets are found again with it.
//! - **A shift of the axis** (TIGRE's `COR`) moves source and detector along u. The axis is then seen where an offset of
//!   `dsd/dso` times the shift shows it, and the fan is turned by `shift/dso`, which only large shifts make visible. The
//!   check derives the shift from the offset found, states the residuals of both, and whether the data prefer one.
//!
//! A scan may have poses if they make a circle: one roll, shift and offset in all views. Helices and tilted detectors are
//! refused.
//!
//! Not tested: DSO and DSD, a tilted detector, a wrong order of views.

mod convention;
mod held_out;
mod offsets;
mod prepared;
mod reduced;
mod reference;
mod stated;
mod verdict;

pub use convention::Convention;
pub use offsets::{AxisShift, OffsetScan, RollScan};
pub use reference::{Resemblance, Source};

use super::algebraic::held_out::go_on;
use held_out::{HeldOut, Hypothesis, held_out};
use offsets::{Search, first_scan, refine};
use prepared::Prepared;
use reduced::{Place, ROLL, Reduced};
use reference::Reference;
use serde::Serialize;
use stated::Stated;
use std::f64::consts::PI;
use std::ops::ControlFlow;
use trgs_core::error::{Error, Result};
use trgs_core::geometry::{Beam, Projections};
use trgs_core::setting::Text;
use trgs_scan::Dataset;
use trgs_scan::pixels::WrongPixels;

/// Largest number of rows and columns of the reduced detector in the first scan of offsets.
const COARSE: usize = 32;
/// The same for the comparison of conventions.
const MEDIUM: usize = 48;
/// The same for the last scan of offsets.
const FINE: usize = 64;
/// Smallest number of views: with fewer, none can be held out.
const FEWEST_VIEWS: usize = 4;
/// Angles beyond this (radians) may be degrees.
const LARGEST_USUAL_ANGLE: f64 = 4.0 * PI;
/// Difference in standard errors from which a class of conventions is excluded.
const TOLD_APART: f64 = 3.0;
/// Excess correlation with the reference from which a mirrored or rotated object is preferred.
const RESEMBLES: f64 = 0.005;
/// Refinement after the first scan of offsets along u.
const FIRST_SEARCH: Search = Search { step: 0.4, rounds: 1 };
/// Last refinement along u: wide, then narrow, since the minimum is not parabolic.
const ALONG_U: [Search; 2] = [Search { step: 0.5, rounds: 8 }, Search { step: 0.2, rounds: 2 }];
/// Refinement along v, where the minimum is shallow.
const ALONG_V: Search = Search { step: 1.0, rounds: 8 };

/// Refinement of the roll: wide on the coarse detector, then narrow on the fine one.
const OF_ROLL: [Search; 2] = [Search { step: 0.3, rounds: 8 }, Search { step: 0.15, rounds: 4 }];

/// Progress of the check.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Step {
    /// The last step done.
    pub what: &'static str,
    /// Number of steps done.
    pub done: usize,
    /// Number of all steps.
    pub steps: usize,
}

impl Step {
    /// Number of steps of a check.
    pub const ALL: usize = 7;
}

/// Observer of every step; breaking ends the check with an error.
pub type Observe<'a> = dyn FnMut(&Step) -> ControlFlow<()> + 'a;

/// The result of a check.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct GeometryCheck {
    /// Whether the scan is as stated, as far as data and reference can tell.
    pub agrees: bool,
    /// Findings and remedies, one sentence each.
    pub verdict: Vec<Text>,
    /// The convention that the data seem to have.
    pub looks_like: Convention,
    /// Detector offset along u.
    pub offset_u: OffsetScan,
    /// Detector offset along v, down the rows; `None` for parallel rays, which do not determine it.
    pub offset_v: Option<OffsetScan>,
    /// Turn of the detector in its plane.
    pub roll: RollScan,
    /// The shift of the axis that explains the data as the offset along u does.
    pub axis_shift: AxisShift,
    /// The offDetector to write into the files, `[u, upwards]` in their unit of length.
    ///
    /// It is the offset found where that differs from the stated one.
    pub off_detector: [f64; 2],
    /// The reference that members of a class were compared with.
    pub reference: Option<Source>,
    /// All conventions: the best class first, ordered by resemblance to the reference, or by simplicity.
    pub candidates: Vec<Candidate>,
    /// Whether some convention predicts the held-out views; without it, offsets and roll mean nothing.
    pub is_explained: bool,
    /// Pixels that err in all views; the check replaced them by their neighbours.
    pub wrong_pixels: WrongPixels,
    /// The smallest and the largest reading of air in the views, which the check subtracted, in the unit of the files; `None`
    /// if it subtracted none.
    pub air: Option<[f64; 2]>,
    /// Number of views used.
    pub views: usize,
    /// Rows and columns of the reduced detector.
    pub detector: [usize; 2],
    /// Voxels of the reconstructions.
    pub grid: [usize; 3],
}

/// A convention and its residual.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Candidate {
    /// The convention.
    pub convention: Convention,
    /// The convention in words.
    pub words: String,
    /// Conventions of one class explain the same data; class 1 has the least residual.
    pub class: usize,
    /// `‖A x - p‖/‖p‖` of held-out views.
    pub residual: f64,
    /// Difference from the residual of the best class, in standard errors.
    pub standard_errors: f64,
    /// Whether the data exclude this class.
    pub told_apart: bool,
    /// The detector's offset `[u, v]` used for it, pixels.
    pub offset: [f64; 2],
    /// Resemblance of its object to the reference; only for the class of the verdict.
    pub resemblance: Option<Resemblance>,
}

/// Reconstructs a scan coarsely under all conventions and ranks them by consistency. Not in the paper.
///
/// At most 24 views, 64² pixels and 48 voxels along a side are used. The number of threads changes no bit.
///
/// # Errors
/// When the scanner is invalid, the views have poses that make no circle, there are fewer than four training views, all
/// their pixels are zero, or `observe` breaks.
///
/// Tests: `every_fault_of_the_images_and_of_the_rotation_is_found`, `conventions_of_a_class_have_the_same_residual`,
/// `displaced_detectors_are_found_to_a_fifth_of_a_pixel`, `rolls_and_axis_shifts_are_found`,
/// `the_true_volume_or_points_from_it_tell_where_the_angles_begin`.
pub fn check_geometry(dataset: &Dataset, observe: &mut Observe<'_>) -> Result<GeometryCheck> {
    dataset.scanner.validate()?;
    let train = &dataset.train;
    if train.len() < FEWEST_VIEWS {
        let expected = format!("at least {FEWEST_VIEWS}: some are held out and predicted from the others");
        return Err(Error::invalid("training views", train.len(), expected, "give a scan with more views"));
    }
    if train.images.iter().all(|value| *value == 0.0) {
        return Err(Error::invalid("projections", "zeros only", "an object", "give projections of an object"));
    }
    let stated_circle = Stated::of(dataset)?;
    let mut steps = Steps { observe, done: 0 };
    let beam = dataset.scanner.beam;
    let Prepared { views, wrong, air } = Prepared::new(dataset, &stated_circle)?;
    let mut trials = classes(&views, &stated_circle, &mut steps)?;
    rank(&Reduced::new(&views, &stated_circle, MEDIUM), &mut trials, &beam)?;
    steps.done("conventions")?;

    // The stated convention is kept unless the data exclude it.
    let mut all = trials.iter().map(|trial| &trial.candidate);
    let stated = all.find(|c| c.convention == Convention::AS_STATED).expect("it is among all");
    let class = if stated.told_apart { 1 } else { stated.class };
    let reference = compare(dataset, &views, &stated_circle, &mut trials, class)?;
    steps.done("reference")?;
    trials.sort_by_key(|trial| {
        let own = trial.candidate.class;
        (own != class, own, trial.is_unlike, trial.faults())
    });

    let chosen = trials.iter().find(|trial| trial.candidate.class == class).expect("every class has a member");
    let fine = Reduced::new(&views, &stated_circle, FINE);
    let (convention, place) = chosen.hypothesis();
    let widely = refine(&fine, convention, place, 0, ALONG_U[0])?;
    let mut along_u = refine(&fine, convention, widely.offset, 0, ALONG_U[1])?;
    steps.done("detector along u")?;
    let along_v = |place: Place| match beam {
        Beam::Cone { .. } => refine(&fine, convention, place, 1, ALONG_V).map(Some),
        Beam::Parallel { .. } => Ok(None),
    };
    let mut of_v = along_v(along_u.offset)?;
    steps.done("detector along v")?;

    let [.., stated_roll, stated_shift] = place;
    let coarse = Reduced::new(&views, &stated_circle, COARSE);
    let place = of_v.as_ref().unwrap_or(&along_u).offset;
    let widely = refine(&coarse, convention, place, ROLL, OF_ROLL[0])?;
    let mut rolled = refine(&fine, convention, widely.offset, ROLL, OF_ROLL[1])?;
    let is_rolled = RollScan::new(&fine, &rolled, stated_roll, 0.0).differs();
    if is_rolled {
        // The offsets were found with another roll.
        along_u = refine(&fine, convention, rolled.offset, 0, ALONG_U[1])?;
        of_v = along_v(along_u.offset)?;
        rolled = refine(&fine, convention, of_v.as_ref().unwrap_or(&along_u).offset, ROLL, OF_ROLL[1])?;
    }
    steps.done("roll of the detector")?;

    let d = &stated_circle.scanner.detector;
    let [u, v, found_roll, _] = rolled.offset;
    let roll = if is_rolled { found_roll } else { stated_roll };
    let magnification = stated_circle.scanner.beam.magnification();
    let shift = stated_shift + (u - d.offset_u) / magnification;
    let as_stated = [
        [d.offset_u, v, roll, stated_shift],
        [u, d.offset_v, roll, stated_shift],
        [u, v, stated_roll, stated_shift],
        [d.offset_u, v, roll, shift],
        [u, v, roll, stated_shift],
    ];
    let results = held_out(&fine, &as_stated.map(|place| (convention, place)))?;
    let residuals: Vec<f64> = results.iter().map(HeldOut::residual).collect();
    let roll = RollScan::new(&fine, &rolled, stated_roll, residuals[2]);
    let offset_u = OffsetScan::new(&fine, 0, &along_u, [d.offset_u, residuals[0]], d.pitch_u);
    let offset_v = of_v.map(|minimum| OffsetScan::new(&fine, 1, &minimum, [d.offset_v, residuals[1]], d.pitch_v));
    let axis_shift = AxisShift {
        stated: stated_shift,
        found: shift,
        uncertainty: offset_u.uncertainty * d.pitch_u / magnification,
        residual: residuals[3],
        residual_offset: residuals[4],
        standard_errors: results[3].worse_than(&results[4]),
    };
    let mut check = GeometryCheck {
        agrees: false,
        verdict: Vec::new(),
        looks_like: convention,
        off_detector: [d.offset_u, d.offset_v],
        roll,
        axis_shift,
        offset_u,
        offset_v,
        reference,
        candidates: trials.into_iter().map(|trial| trial.candidate).collect(),
        is_explained: false,
        wrong_pixels: wrong,
        air,
        views: fine.views.len(),
        detector: [fine.views.images.dim().1, fine.views.images.dim().2],
        grid: fine.grid().shape,
    };
    verdict::judge(&mut check, dataset, &stated_circle.scanner);
    Ok(check)
}

/// A convention that is being evaluated.
#[derive(Clone)]
struct Trial {
    candidate: Candidate,
    place: Place,
    /// Whether another member of its class resembles the reference more.
    is_unlike: bool,
}

impl Trial {
    /// Number of differences from the stated convention.
    fn faults(&self) -> usize {
        let Candidate { convention, resemblance, .. } = &self.candidate;
        convention.faults() + usize::from(resemblance.is_some_and(|r| r.quarter_turns != 0))
    }

    /// What it supposes.
    fn hypothesis(&self) -> Hypothesis {
        (self.candidate.convention, self.place)
    }
}

/// All conventions, with the offset of least residual of their class; one per class is evaluated.
fn classes(views: &Projections, stated: &Stated, steps: &mut Steps<'_, '_>) -> Result<Vec<Trial>> {
    let (d, beam) = (&stated.scanner.detector, &stated.scanner.beam);
    let maybe_degrees = views.angles.iter().any(|angle| angle.abs() > LARGEST_USUAL_ANGLE);
    let all = Convention::all(d.rows == d.columns, maybe_degrees);
    let mut representatives: Vec<Convention> = Vec::new();
    for convention in &all {
        if representatives.iter().all(|other| !convention.looks_like(other, beam)) {
            representatives.push(*convention);
        }
    }
    let coarse = Reduced::new(views, stated, COARSE);
    let along_u = first_scan(d.offset_u, d.columns as f64 * d.pitch_u, coarse.pitch()[0]);
    // A class has members with the rows reversed, for which the offset has the opposite sign.
    let mut along_v = vec![d.offset_v];
    if d.offset_v != 0.0 && matches!(beam, Beam::Cone { .. }) {
        along_v.push(-d.offset_v);
    }
    let offsets: Vec<[f64; 2]> = along_v.iter().flat_map(|&v| along_u.iter().map(move |&u| [u, v])).collect();
    let place = |c: &Convention, [u, v]: [f64; 2]| [u, v, c.roll(stated.roll), c.axis_shift(stated.axis_shift)];
    let hypotheses: Vec<Hypothesis> =
        representatives.iter().flat_map(|&c| offsets.iter().map(move |&offset| (c, place(&c, offset)))).collect();
    let results: Vec<f64> = held_out(&coarse, &hypotheses)?.iter().map(HeldOut::residual).collect();
    steps.done("first scan of detector offsets")?;
    let mut found = Vec::new();
    for (&convention, results) in representatives.iter().zip(results.chunks_exact(offsets.len())) {
        let least = (0..offsets.len()).reduce(|a, b| if results[b] < results[a] { b } else { a });
        let offset = offsets[least.expect("there is at least what is stated")];
        found.push(refine(&coarse, convention, place(&convention, offset), 0, FIRST_SEARCH)?.offset);
    }
    steps.done("refinement of the offset")?;
    let trial = |convention: &Convention| {
        let class = representatives.iter().position(|other| convention.looks_like(other, beam));
        let class = class.expect("every convention is represented");
        let [u, v, ..] = found[class];
        let place = place(convention, convention.offset_from(&representatives[class], [u, v]));
        let candidate = Candidate {
            convention: *convention,
            words: convention.words(),
            class,
            residual: 0.0,
            standard_errors: 0.0,
            told_apart: false,
            offset: [place[0] / d.pitch_u, place[1] / d.pitch_v],
            resemblance: None,
        };
        Trial { candidate, place, is_unlike: false }
    };
    Ok(all.iter().map(trial).collect())
}

/// Evaluates all conventions and numbers their classes, the best first.
fn rank(scan: &Reduced, trials: &mut [Trial], beam: &Beam) -> Result<()> {
    let hypotheses: Vec<Hypothesis> = trials.iter().map(Trial::hypothesis).collect();
    let results = held_out(scan, &hypotheses)?;
    let residuals: Vec<f64> = results.iter().map(HeldOut::residual).collect();
    let mut order: Vec<usize> = (0..trials.len()).collect();
    order.sort_by(|&a, &b| residuals[a].total_cmp(&residuals[b]));
    let mut leaders: Vec<usize> = Vec::new();
    for &i in &order {
        if leaders.iter().all(|&leader| !hypotheses[i].0.looks_like(&hypotheses[leader].0, beam)) {
            leaders.push(i);
        }
    }
    for (i, Trial { candidate: trial, .. }) in trials.iter_mut().enumerate() {
        let class = leaders.iter().position(|&leader| trial.convention.looks_like(&hypotheses[leader].0, beam));
        trial.class = class.expect("every class has a leader") + 1;
        trial.residual = residuals[i];
        let worse = results[leaders[trial.class - 1]].worse_than(&results[leaders[0]]);
        (trial.standard_errors, trial.told_apart) = (worse, worse > TOLD_APART);
    }
    Ok(())
}

/// Compares reconstructions under the members of a class with the known object.
fn compare(
    dataset: &Dataset,
    views: &Projections,
    stated: &Stated,
    trials: &mut [Trial],
    class: usize,
) -> Result<Option<Source>> {
    let coarse = Reduced::new(views, stated, COARSE);
    let Some(reference) = Reference::new(dataset, coarse.grid()) else { return Ok(None) };
    let members: Vec<usize> = (0..trials.len()).filter(|&i| trials[i].candidate.class == class).collect();
    let hypotheses: Vec<Hypothesis> = members.iter().map(|&i| trials[i].hypothesis()).collect();
    let found = reference.compare(&coarse, &hypotheses)?;
    let best = found.iter().map(|resemblance| resemblance.correlation).fold(f64::NEG_INFINITY, f64::max);
    for (&i, resemblance) in members.iter().zip(found) {
        trials[i].is_unlike = resemblance.correlation < best - RESEMBLES;
        trials[i].candidate.resemblance = Some(resemblance);
    }
    Ok(Some(reference.source))
}

/// Counts steps and reports them.
struct Steps<'a, 'b> {
    observe: &'a mut Observe<'b>,
    done: usize,
}

impl Steps<'_, '_> {
    fn done(&mut self, what: &'static str) -> Result<()> {
        self.done += 1;
        go_on((self.observe)(&Step { what, done: self.done, steps: Step::ALL }), self.done)
    }
}
