//! The stage `recycling`: adding and recycling after an iteration of a training, with its random numbers given. Its questions are
//! written by `trgs oracle trace` beside the iteration.

use super::outputs::{Outputs, one, parameters};
use super::population::{generation, recycling, rows};
use super::question::Question;
use ndarray::{ArrayView2, Ix2};
use trgs_core::density::{ar, kept_rows, spread};
use trgs_core::error::Result;
use trgs_core::primitives::{Group, Parameters};

/// The stage's name.
pub const STAGE: &str = "recycling";
/// The outputs, in the order in which they are computed, and the archives among them.
pub(crate) const OUTPUTS: [&str; 6] = ["1-parent", "2-fresh", "3-physical", "4-first", "5-second", "6-momentum"];
pub(crate) const ARCHIVES: [&str; 3] = ["3-physical", "4-first", "5-second"];

pub(super) fn answer(q: &Question) -> Result<Outputs> {
    let physical = q.activation()?.forward(&q.parameters("raw")?);
    let mut draws = q.numbers("uniform")?.into_iter();
    let mut next = ar::ar(&physical, &recycling(q)?, || draws.next().unwrap_or(f64::NAN));
    let mut normals = rows(&q.array::<Ix2>("normals")?).into_iter();
    spread(&physical.parameters, &mut next, q.setting("spread")?, || normals.next().unwrap_or([f64::NAN; 3]));
    let [moments, momentum] = kept_rows(&next, q.setting("reset_parents")? != 0.0);

    let mut population = generation(&physical.parameters, &next);
    let mut all = Outputs::new();
    for (name, role) in OUTPUTS.into_iter().zip(["parent", "fresh", "model"]) {
        all.insert(name.into(), population.remove(role).expect("an output of a step"));
    }
    for (name, role) in OUTPUTS[3..].iter().zip(["first", "second"]) {
        let (old, mut new) = (q.parameters(role)?, Parameters::zeros(next.len()));
        for group in Group::ALL {
            let (old, width) = (old.group(group), group.width());
            for (new, row) in new.group_mut(group).chunks_exact_mut(width).zip(&moments) {
                row.iter().for_each(|row| new.copy_from_slice(&old[row * width..][..width]));
            }
        }
        all.extend(parameters(name, &new));
    }
    let old = rows(&q.array::<Ix2>("momentum")?);
    let new: Vec<_> = momentum.iter().map(|row| row.map_or([0.0; 3], |row| old[row])).collect();
    all.extend(one(OUTPUTS[5], ArrayView2::from(new.as_slice()).to_owned()));
    Ok(all)
}
