//! The stage `run`: iterations of the training in a row, with their random numbers given. Its questions are written by
//! `trgs oracle trace`.
//!
//! Each step is one of the stage [`iteration`] from the state that the step before left. Population, confidence and targets of
//! ν stay as they are. Errors of rounding grow from step to step, so the answer has a corridor (`fresh::truth`).

use super::iteration;
use super::outputs::Outputs;
use super::question::Question;
use ndarray::{Array1, ArrayD, Axis, Ix3};
use serde_json::json;
use trgs_core::error::{Error, Result};
use trgs_core::projector::Kernels;

/// The stage's name.
pub const STAGE: &str = "run";
/// The outputs: losses of all steps, and the raw parameters after each fifth of the steps.
pub(crate) const OUTPUTS: [&str; 6] = ["1-losses", "2-raw", "3-raw", "4-raw", "5-raw", "6-raw"];
/// The inputs that a step hands on to the next one, each with the output of the stage [`iteration`].
const STATE: [(&str, &str); 4] =
    [("raw", "11-raw"), ("first", "08-first"), ("second", "09-second"), ("momentum", "10-momentum")];

pub(super) fn answer<R: Kernels>(q: &Question) -> Result<Outputs> {
    walk::<R>(q, &mut |_| ())
}

/// Runs all steps; `change` is applied to the arrays of the state after each.
pub(crate) fn walk<R: Kernels>(q: &Question, change: &mut dyn FnMut(&mut ArrayD<f64>)) -> Result<Outputs> {
    let (angles, views) = (q.angles()?, q.list("views")?);
    let (normals, targets) = (q.array::<Ix3>("normals")?, q.array::<Ix3>("targets")?);
    let (begun, steps) = (q.integer("done")?, angles.len());
    let count = targets.len_of(Axis(0));
    let fit = views.len() == steps && normals.len_of(Axis(0)) == steps && steps > 0;
    if !fit || views.iter().any(|&view| view as usize >= count) {
        let got = format!("views {views:?} and {} arrays of normals", normals.len_of(Axis(0)));
        let expected = format!("{steps} of each, one for each angle, and views below {count}");
        return Err(Error::invalid(format!("case {}", q.id), got, expected, "trace the run again"));
    }
    let mut step = q.clone();
    step.stage = iteration::STAGE.into();
    let mut losses = ndarray::Array2::zeros((steps, 6));
    let mut outputs = Outputs::new();
    let mut fifths = (1..=5).zip(&OUTPUTS[1..]).peekable();
    for done in 0..steps {
        step.settings.insert("angles".into(), json!([angles[done]]));
        step.settings.insert("done".into(), json!(begun + done as u64));
        for key in ["tv_block", "wavelet_block"] {
            // A block of no voxels is not due.
            match q.settings.get(key).and_then(|blocks| blocks[done].as_array()) {
                Some(block) if !block.is_empty() => step.settings.insert(key.into(), json!(block)),
                _ => step.settings.remove(key),
            };
        }
        let target = targets.index_axis(Axis(0), views[done] as usize).to_owned().into_dyn();
        let normals = normals.index_axis(Axis(0), done).to_owned().into_dyn();
        for (role, array) in [("target", target), ("normals", normals)] {
            step.arrays_mut().insert(role.into(), [(String::new(), array)].into());
        }
        let mut all = iteration::answer::<R>(&step)?;
        losses.row_mut(done).assign(&Array1::from_iter(all["04-losses"][""].iter().copied()));
        for (role, output) in STATE {
            let mut arrays = all.remove(output).expect("an output of every iteration");
            arrays.values_mut().for_each(&mut *change);
            step.arrays_mut().insert(role.into(), arrays);
        }
        while let Some((_, output)) = fifths.next_if(|(fifth, _)| 5 * (done + 1) >= fifth * steps) {
            outputs.insert((*output).into(), step.arrays_mut()["raw"].clone());
        }
    }
    outputs.insert(OUTPUTS[0].into(), [(String::new(), losses.into_dyn())].into());
    Ok(outputs)
}
