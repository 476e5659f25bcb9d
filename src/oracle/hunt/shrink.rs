//! Shrinks a question that a backend fails: fewest elements, then the roundest numbers.
//!
//! A round asks all single changes in one batch, then the changes that still fail together, half of them, a quarter, and so
//! on, in a second batch. The backend is started twice for a round, however many changes there are.

use crate::fresh::dimensions::{Dimension, Of, dimensions};
use crate::fresh::draft::Draft;
use serde_json::{Value, json};
use trgs_core::error::Result;

/// Rounds after which a question is simple enough.
const ROUNDS: usize = 12;
/// Selections of one dimension that are tried in a round.
const SELECTIONS: usize = 24;
/// Those of each size, in a dimension with more elements.
const OF_A_SIZE: usize = 5;

/// A change of a question; none if it changes nothing.
type Change = Box<dyn Fn(&Draft) -> Option<Draft>>;

/// Asks a backend all questions in one batch, and says which of them fail. Invalid questions do not.
pub(super) trait Judge {
    fn fail(&mut self, drafts: &[Draft]) -> Result<Vec<bool>>;
}

/// The simplest question found that still fails.
pub(super) fn shrink(start: Draft, judge: &mut impl Judge) -> Result<Draft> {
    let mut best = start;
    for _ in 0..ROUNDS {
        let groups = changes(&best);
        let singles: Vec<(usize, usize, Draft)> = groups
            .iter()
            .enumerate()
            .flat_map(|(group, changes)| changes.iter().enumerate().map(move |(place, change)| (group, place, change)))
            .filter_map(|(group, place, change)| Some((group, place, change(&best)?)))
            .collect();
        let drafts: Vec<Draft> = singles.iter().map(|(_, _, draft)| draft.clone()).collect();
        let failing = judge.fail(&drafts)?;
        // Of each group the first change that still fails: they are in the order of what they gain.
        let mut chosen: Vec<(usize, usize)> = Vec::new();
        for ((group, place, _), fails) in singles.iter().zip(failing) {
            if fails && chosen.last().is_none_or(|(last, _)| last != group) {
                chosen.push((*group, *place));
            }
        }
        if chosen.is_empty() {
            break;
        }
        let mut together = Vec::new();
        let mut count = chosen.len();
        while count > 0 {
            let all = chosen[..count].iter();
            together
                .push(all.fold(best.clone(), |draft, (group, place)| groups[*group][*place](&draft).unwrap_or(draft)));
            count /= 2;
        }
        let fails = judge.fail(&together)?;
        // The last one is a single change, which failed before.
        let first = fails.iter().position(|fails| *fails).unwrap_or(together.len() - 1);
        if together[first] == best {
            break;
        }
        best = together.swap_remove(first);
    }
    Ok(best)
}

/// All changes, in groups of which one is applied at a time.
fn changes(draft: &Draft) -> Vec<Vec<Change>> {
    let mut groups: Vec<Vec<Change>> = dimensions(&draft.stage).into_iter().map(|of| selections(draft, of)).collect();
    for (role, arrays) in &draft.arrays {
        for (name, array) in arrays {
            groups.push(numbers(role, name));
            if name == "mean" || array.len() <= 4 {
                groups.extend((0..array.len().min(6)).map(|index| element(role, name, index)));
            }
        }
    }
    if draft.settings.contains_key("angles") {
        groups.push([-1, 0, 1, 2].into_iter().map(angles).collect());
    }
    if draft.scanner.is_some() {
        groups.extend(scanners());
    }
    groups
}

/// Fewer elements of a dimension: one of them, a half, a quarter; all but an eighth.
fn selections(draft: &Draft, of: Dimension) -> Vec<Change> {
    let units = draft.length(&of) / of.step;
    let mut ranges: Vec<(usize, usize)> = Vec::new();
    let mut part = 1;
    while part < units {
        let all: Vec<_> = (0..units).step_by(part).map(|start| (start, (start + part).min(units))).collect();
        match units <= SELECTIONS {
            true => ranges.extend(all),
            // The last, the first and some between.
            false => ranges.extend(all.iter().rev().step_by(all.len().div_ceil(OF_A_SIZE - 1)).chain(all.first())),
        }
        part *= 2;
    }
    let contiguous = matches!(of.of, Of::Rows | Of::Columns | Of::Voxels(_)) || of.step > 1;
    let mut kept: Vec<Vec<usize>> = ranges.iter().map(|(start, end)| (*start..*end).collect()).collect();
    kept.truncate(if units <= SELECTIONS { SELECTIONS } else { usize::MAX });
    let drop = units.div_ceil(8);
    for start in (0..units).step_by(drop.max(1)) {
        let rest: Vec<usize> = (0..units).filter(|i| !(start..start + drop).contains(i)).collect();
        let is_run = rest.windows(2).all(|pair| pair[1] == pair[0] + 1);
        if !rest.is_empty() && (is_run || !contiguous) {
            kept.push(rest);
        }
    }
    let step = of.step;
    let change = |units: Vec<usize>| -> Change {
        let indices: Vec<usize> = units.into_iter().flat_map(|unit| unit * step..(unit + 1) * step).collect();
        let of = of.clone();
        // After other changes the dimension has the same length: each group is of one dimension.
        Box::new(move |draft| (indices.len() < draft.length(&of)).then(|| draft.select(&of, &indices)))
    };
    kept.into_iter().map(change).collect()
}

/// Rounder numbers in an array: a usual value, then one, two and three digits.
fn numbers(role: &str, name: &str) -> Vec<Change> {
    let usual: Option<&'static [f64]> = match name {
        "mean" => Some(&[0.0]),
        "scale" => Some(&[0.25]),
        "quaternion" => Some(&[1.0, 0.0, 0.0, 0.0]),
        "density" => Some(&[1.0]),
        "nu" => Some(&[4.0]),
        "" if role == "cotangent" => Some(&[1.0]),
        _ => None,
    };
    let mut all: Vec<Change> = Vec::new();
    let (role, name) = (role.to_owned(), name.to_owned());
    if let Some(usual) = usual {
        all.push(edit(&role, &name, move |index, x| if x.is_finite() { usual[index % usual.len()] } else { x }));
    }
    all.extend((1..=3).map(|digits| edit(&role, &name, move |_, x| rounded(x, digits))));
    all
}

/// A round value for one number.
fn element(role: &str, name: &str, index: usize) -> Vec<Change> {
    let one = |value: f64| edit(role, name, move |at, x| if at == index && x.is_finite() { value } else { x });
    if name == "mean" { vec![one(0.0), one(0.5)] } else { vec![one(1.0), one(0.5)] }
}

fn edit(role: &str, name: &str, change: impl Fn(usize, f64) -> f64 + 'static) -> Change {
    let (role, name) = (role.to_owned(), name.to_owned());
    Box::new(move |draft| {
        let mut new = draft.clone();
        let array = new.arrays.get_mut(&role)?.get_mut(&name)?;
        array.iter_mut().enumerate().for_each(|(index, x)| *x = change(index, *x));
        (new != *draft).then_some(new)
    })
}

/// Angles of 0, or with fewer digits.
fn angles(digits: i32) -> Change {
    Box::new(move |draft| {
        let mut new = draft.clone();
        let old = draft.settings["angles"].as_array()?;
        let round = |angle: &Value| match digits {
            -1 => json!(0.0),
            0 => json!(angle.as_f64().unwrap_or(0.0).round()),
            _ => json!(rounded(angle.as_f64().unwrap_or(0.0), digits as usize)),
        };
        new.settings["angles"] = old.iter().map(round).collect();
        (new != *draft).then_some(new)
    })
}

/// Simpler scanners.
fn scanners() -> Vec<Vec<Change>> {
    fn of(change: fn(&mut crate::fresh::draft::ScannerFile)) -> Change {
        Box::new(move |draft| {
            let mut new = draft.clone();
            change(new.scanner.as_mut()?);
            (new != *draft).then_some(new)
        })
    }
    vec![
        vec![of(|s| s.off_detector = [0.0; 2]), of(|s| s.off_detector = s.off_detector.map(|x| rounded(x, 1)))],
        vec![of(|s| s.off_origin = [0.0; 3]), of(|s| s.off_origin = s.off_origin.map(|x| rounded(x, 1)))],
        vec![of(|s| (s.dso, s.dsd) = (4.0, 8.0)), of(|s| (s.dso, s.dsd) = (rounded(s.dso, 1), rounded(s.dsd, 1)))],
        vec![
            of(|s| s.s_detector = [0, 1].map(|k| s.n_detector[k] as f64)),
            of(|s| s.s_detector = s.s_detector.map(|x| rounded(x, 1))),
        ],
        vec![of(|s| s.s_voxel = [2.0; 3]), of(|s| s.s_voxel = s.s_voxel.map(|x| rounded(x, 1)))],
        vec![of(|s| s.mode = "parallel".into())],
    ]
}

/// The nearest number with so many significant digits.
fn rounded(x: f64, digits: usize) -> f64 {
    if x.is_finite() { format!("{x:.*e}", digits - 1).parse().unwrap_or(x) } else { x }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fresh::Ask;
    use crate::manifest::Level;

    /// Fails where the number of primitives is no multiple of 32, as long as the last is there.
    struct Tail(Vec<f64>);

    impl Judge for Tail {
        fn fail(&mut self, drafts: &[Draft]) -> Result<Vec<bool>> {
            let fails = |draft: &Draft| {
                let density = &draft.arrays["model"]["density"];
                !density.len().is_multiple_of(32) && density.iter().last() == self.0.last()
            };
            Ok(drafts.iter().map(fails).collect())
        }
    }

    #[test]
    fn a_failure_of_the_last_of_thousands_of_primitives_is_shrunk_to_that_one() {
        let start = Ask::Values.drafts("image-affine", 7, 1, 1, Level::Large).0.remove(0);
        let density: Vec<f64> = start.arrays["model"]["density"].iter().copied().collect();
        assert_eq!(density.len(), 5000);
        let small = shrink(start, &mut Tail(density)).unwrap();
        assert_eq!(small.size()[0], 1);
    }
}
