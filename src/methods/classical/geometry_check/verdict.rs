//! Turns the numbers of a check into sentences.

use super::offsets::SIGNIFICANT_ROLL;
use super::{AxisShift, Candidate, Convention, GeometryCheck, OffsetScan, RESEMBLES, RollScan, Source, TOLD_APART};
use std::f64::consts::FRAC_PI_2;
use trgs_core::geometry::{Beam, Scanner};
use trgs_core::setting::{Setting, Text};
use trgs_core::words::verb;
use trgs_scan::pixels::WrongPixels;
use trgs_scan::{Dataset, Unit};

/// Allowed displacement of the detector, pixels.
const TOLERANCE: f64 = 0.5;
/// Standard errors allowed in addition.
const SIGNIFICANT: f64 = 2.0;
/// Factor by which the residual must fall for a displacement along v to count.
///
/// Coarse voxels add to the residual of a body whose height is hardly visible; this makes false minima a tenth deep.
const VISIBLE: f64 = 1.25;
/// Allowed roll of the detector, degrees, in addition to its uncertainty.
const ROLL_TOLERANCE: f64 = 0.2;
/// If the best relative residual exceeds this, no convention explains the data.
const UNEXPLAINED: f64 = 0.4;

/// Sets `agrees` and the sentences of the verdict.
pub(super) fn judge(check: &mut GeometryCheck, dataset: &Dataset, scanner: &Scanner) {
    let scale = dataset.scale;
    let chosen = check.candidates[0].clone();
    let turns = chosen.resemblance.map_or(0, |resemblance| resemblance.quarter_turns);
    let as_stated = chosen.convention == Convention::AS_STATED && turns == 0;
    let least = check.candidates.iter().map(|c| c.residual).fold(f64::INFINITY, f64::min);
    let explained = least < UNEXPLAINED;
    check.is_explained = explained;
    let displaced_u = is_displaced(&check.offset_u);
    let seen_v =
        check.offset_v.as_ref().filter(|scan| is_displaced(scan) && scan.residual_stated > VISIBLE * scan.residual);
    let displaced_v = seen_v.is_some();
    let u = if displaced_u { check.offset_u.found_length } else { scanner.detector.offset_u };
    let v = seen_v.map_or(scanner.detector.offset_v, |scan| scan.found_length);
    check.off_detector = [u / scale, (0.0 - v) / scale];

    check.agrees = as_stated && explained && !displaced_u && !displaced_v && !is_rolled(&check.roll);
    if !explained {
        check.off_detector = [scanner.detector.offset_u / scale, (0.0 - scanner.detector.offset_v) / scale];
        let unexplained = format!(
            "No convention explains the data: even the best leaves {}. Nothing is said about the place of the detector. \
             Check DSO, DSD, sizes, angles and the order of views.",
            percent(least)
        );
        check.verdict = vec![unexplained.into()];
        check.verdict.extend(removed(check));
        return;
    }
    let mut verdict = vec![Text::from(conventions(check, as_stated, turns))];
    verdict.extend(removed(check));
    verdict.extend(alternatives(check, chosen.class).into_iter().map(Text::from));
    verdict.push(equals(check, chosen.class, &scanner.beam).into());
    verdict.push(place("u", &check.offset_u, displaced_u).into());
    match &check.offset_v {
        Some(scan) if is_displaced(scan) && !displaced_v => {
            let shallow = "The minimum is too shallow to count.";
            verdict.push(format!("{} {shallow}", place("v, down the rows,", scan, false)).into());
        }
        Some(scan) => verdict.push(place("v, down the rows,", scan, displaced_v).into()),
        None => verdict.push("The detector's offset along v cannot be determined: the rays are parallel.".into()),
    }
    if displaced_u || displaced_v {
        let [u, up] = check.off_detector;
        let frame = &dataset.frame;
        // A converted scan has other lengths than the description it was made with.
        let in_files = if frame.scale == scale {
            String::new()
        } else {
            let [u, up] = [u, up].map(|length| length * scale / frame.scale);
            let unit = frame.unit.map_or("the unit of the files that the scan was made from", Unit::symbol);
            format!(", which are [{u:.6}, {up:.6}] in {unit}")
        };
        verdict.push(format!("Set offDetector to [{u:.6}, {up:.6}], along u and upwards{in_files}.").into());
    }
    if displaced_u {
        verdict.push(shifted_axis(&check.axis_shift, scale).into());
    }
    let rolled = is_rolled(&check.roll);
    verdict.push(roll(&check.roll, rolled).into());
    check.verdict = verdict;
}

/// Sentences about errors of the data that were removed before the check.
fn removed(check: &GeometryCheck) -> Vec<Text> {
    let mut found = Vec::new();
    let WrongPixels { single, columns, .. } = &check.wrong_pixels;
    let count = single.len() + columns.len();
    if count > 0 {
        let removed = format!(
            "In all views {} {} from the neighbours: the check replaced {}. If {} no detail of the object, correct the \
             flat field, or give ",
            check.wrong_pixels.describe(),
            verb(count, "differs", "differ"),
            verb(count, "it", "them"),
            verb(count, "it is", "they are"),
        );
        found.push(Text::from(removed) + Setting::MaskPixels + " auto.");
    }
    if let Some([low, high]) = check.air {
        let removed = format!(
            "Air reads {low:.4} to {high:.4} instead of 0: the check subtracted it. Correct the flat field, I0, or the \
             drift of the source, or give "
        );
        found.push(Text::from(removed) + Setting::Air + " auto.");
    }
    found
}

/// Whether the offset differs from the stated one by more than tolerance and uncertainty.
fn is_displaced(scan: &OffsetScan) -> bool {
    (scan.found - scan.stated).abs() > TOLERANCE + SIGNIFICANT * scan.uncertainty
}

/// Whether the roll differs from the stated one by more than tolerance and uncertainty, and lowers the residual.
fn is_rolled(scan: &RollScan) -> bool {
    (scan.found - scan.stated).abs() > ROLL_TOLERANCE + SIGNIFICANT_ROLL * scan.uncertainty
        && scan.residual < scan.residual_stated
}

/// The sentence about a shifted axis that explains the displacement along u instead.
fn shifted_axis(shift: &AxisShift, scale: f64) -> String {
    let AxisShift { found, uncertainty, residual, residual_offset, standard_errors, .. } = *shift;
    let told = match standard_errors {
        worse if worse > TOLD_APART => "the data prefer the offset",
        worse if worse < -TOLD_APART => "the data prefer the shift",
        _ => "the data do not tell them apart",
    };
    let [found, uncertainty] = [found, uncertainty].map(|length| length / scale);
    format!(
        "Along u, a shifted rotation axis would do as well: COR {found:.6} ± {uncertainty:.6} with offDetector as stated leaves {}, \
         the offset {}: {told}. Set one of the two.",
        percent(residual),
        percent(residual_offset)
    )
}

/// The sentence about the roll.
fn roll(scan: &RollScan, rolled: bool) -> String {
    let RollScan { stated, found, uncertainty, .. } = *scan;
    // A negative number that rounds to zero has no sign.
    let shown = |degrees: f64| if degrees.abs() < 0.005 { 0.0 } else { degrees };
    let (found, stated) = (shown(found), shown(stated));
    match rolled {
        // TIGRE counts turns about x, which points to the source.
        true => format!(
            "The detector is rolled by {found:.2}° ± {uncertainty:.2}°, stated {stated:.2}°: set rotDetector to [0, 0, \
             {:.6}], radians.",
            -found.to_radians()
        ),
        false => {
            format!("The data agree with the stated roll of {stated:.2}°: they give {found:.2}° ± {uncertainty:.2}°.")
        }
    }
}

/// The sentence about the convention found.
fn conventions(check: &GeometryCheck, as_stated: bool, turns: usize) -> String {
    let chosen = &check.candidates[0];
    let foretold = format!("held-out views are predicted to within {}", percent(chosen.residual));
    if as_stated {
        return format!("The data agree with the conventions as stated: {foretold}.");
    }
    // Without a reference the simplest members of the class are equally likely.
    let simplest = |c: &&Candidate| c.class == chosen.class && c.convention.faults() == chosen.convention.faults();
    let equal: Vec<&Candidate> = check.candidates.iter().filter(simplest).collect();
    let shown = if check.reference.is_some() { &equal[..1] } else { &equal[..] };
    let words: Vec<String> = shown.iter().map(|c| c.words.clone()).collect();
    let mut remedies: Vec<String> = Vec::new();
    for candidate in shown {
        let mut steps: Vec<String> = candidate.convention.remedies().into_iter().map(Into::into).collect();
        if turns != 0 {
            steps.push(format!("add {:.6} ({}°) to every angle", turns as f64 * FRAC_PI_2, 90 * turns));
        }
        remedies.push(steps.join(" and "));
    }
    let mut words = words.join(", or ");
    if turns != 0 {
        words = format!("{words}, with angles that begin {}° too early", 90 * turns);
    }
    let stated = check.candidates.iter().find(|c| c.convention == Convention::AS_STATED);
    let instead = stated.map_or(String::new(), |c| format!(", as stated only to {}", percent(c.residual)));
    let instead = if stated.is_some_and(|c| c.class == chosen.class) { String::new() } else { instead };
    format!("The data look like {words}: {foretold}{instead}. Remedy: {}.", remedies.join(", or "))
}

/// The sentence about the best of the other classes, and whether the data exclude it.
fn alternatives(check: &GeometryCheck, class: usize) -> Option<String> {
    let other = check.candidates.iter().find(|c| c.class != class)?;
    let words = simplest(check, other.class);
    Some(if other.told_apart {
        format!(
            "The next best is {words}: {}, {:.0} standard errors worse.",
            percent(other.residual),
            other.standard_errors
        )
    } else {
        format!(
            "The data do not exclude {words}: {}, less than {TOLD_APART} standard errors worse.",
            percent(other.residual)
        )
    })
}

/// The sentence about conventions that are equivalent to the chosen one.
fn equals(check: &GeometryCheck, class: usize, beam: &Beam) -> String {
    let members: Vec<&Candidate> = check.candidates.iter().filter(|c| c.class == class).collect();
    let others: Vec<&str> = members[1..].iter().map(|c| c.words.as_str()).collect();
    let parallel = if matches!(beam, Beam::Parallel { .. }) {
        " For parallel rays, mirrored columns equal half a turn."
    } else {
        ""
    };
    // In a parallel beam a member with mirrored columns equals one without, half a turn later.
    let same = |c: &Candidate| {
        let (a, b) = (c.convention, members[0].convention);
        (a.rows_reversed, a.rotation_reversed) == (b.rows_reversed, b.rotation_reversed)
    };
    let others_resemble = members.iter().filter(|c| !same(c)).filter_map(|c| c.resemblance?.correlation.into());
    let told = match (check.reference, members[0].resemblance) {
        (Some(source), Some(best)) => {
            let name = match source {
                Source::TrueVolume => "The true volume",
                Source::InitialPoints => "The initial points, if they were not made from these views,",
            };
            let (best, next) = (best.correlation, others_resemble.fold(f64::NEG_INFINITY, f64::max));
            if best - next > RESEMBLES {
                format!(" {name} can: correlation {best:.3}, next {next:.3}.")
            } else {
                format!(" {name} cannot either: correlation {best:.3} and {next:.3}.")
            }
        }
        _ => " Nor can they determine the zero of the angles.".into(),
    };
    format!(
        "Projections cannot distinguish this from {}, of a mirrored or rotated object.{parallel}{told}",
        others.join("; ")
    )
}

/// The sentence about the detector offset along one direction.
fn place(direction: &str, scan: &OffsetScan, displaced: bool) -> String {
    let OffsetScan { stated, found, uncertainty, .. } = *scan;
    let text =
        format!("Along {direction} the detector lies at {found:.2} ± {uncertainty:.2} pixels, stated {stated:.2}");
    if displaced && (found + stated).abs() < TOLERANCE && stated.abs() > TOLERANCE {
        format!("{text}: its offset has the opposite sign.")
    } else if displaced {
        format!("{text}: it is displaced.")
    } else {
        format!("{text}.")
    }
}

/// The simplest members of a class, in words.
fn simplest(check: &GeometryCheck, class: usize) -> String {
    let members = || check.candidates.iter().filter(|c| c.class == class);
    let least = members().map(|c| c.convention.faults()).min();
    let words: Vec<&str> =
        members().filter(|c| Some(c.convention.faults()) == least).map(|c| c.words.as_str()).collect();
    words.join(" or ")
}

fn percent(residual: f64) -> String {
    format!("{:.1} %", 100.0 * residual)
}
