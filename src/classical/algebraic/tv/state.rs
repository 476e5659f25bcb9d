//! The state from which a reconstruction with total variation resumes to the same bits.

use super::{TvRun, TvSettings};
use crate::classical::VoxelProjector;
use crate::error::{Error, Result, start_again};
use crate::numeric::{Real, real};
use crate::scene::Projections;
use serde::{Deserialize, Serialize};

/// The state of a [`TvRun`] after an iteration, for a checkpoint file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct TvState {
    iteration: usize,
    momentum: [f64; 2],
    objective: f64,
    change: f64,
    lipschitz: f64,
    /// x, the previous x, and the dual of the total variation.
    arrays: [Numbers; 5],
}

/// Numbers in the precision of the run.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
enum Numbers {
    Single(Vec<f32>),
    Double(Vec<f64>),
}

impl Numbers {
    fn new<R: Real>(values: &[R]) -> Self {
        if size_of::<R>() == size_of::<f32>() {
            Self::Single(values.iter().map(|value| value.to_f64() as f32).collect())
        } else {
            Self::Double(values.iter().map(|value| value.to_f64()).collect())
        }
    }

    fn get<R: Real>(&self) -> Vec<R> {
        match self {
            Self::Single(values) => values.iter().map(|&value| real(f64::from(value))).collect(),
            Self::Double(values) => values.iter().map(|&value| real(value)).collect(),
        }
    }
}

impl TvState {
    /// Iterations done.
    pub fn iteration(&self) -> usize {
        self.iteration
    }
}

impl<'a, R: Real> TvRun<'a, R> {
    /// The state that [`Self::resume`] continues from.
    pub fn state(&self) -> TvState {
        let [q0, q1, q2] = self.proximal.dual();
        TvState {
            iteration: self.iteration,
            momentum: self.momentum,
            objective: self.objective,
            change: self.change,
            lipschitz: self.lipschitz,
            arrays: [&self.x, &self.before, q0, q1, q2].map(|values| Numbers::new(values)),
        }
    }

    /// Continues a run with the same projections and settings, bit-identical to an uninterrupted run.
    ///
    /// # Errors
    /// When the state belongs to a volume of another size, or the projections do not fit the projector.
    pub fn resume(
        projector: &'a VoxelProjector,
        projections: &'a Projections,
        settings: &TvSettings,
        state: &TvState,
    ) -> Result<Self> {
        let mut run = Self::prepared(projector, projections, settings)?;
        let [x, before, q0, q1, q2] = state.arrays.each_ref().map(Numbers::get::<R>);
        if let Some(other) = [&x, &before, &q0, &q1, &q2].iter().find(|values| values.len() != run.x.len()) {
            let (got, expected) = (format!("{} voxels", other.len()), run.x.len().to_string());
            return Err(Error::invalid("checkpoint", got, expected, start_again()));
        }
        (run.seen, run.seen_before) = (run.project(&x), run.project(&before));
        (run.x, run.before) = (x, before);
        run.proximal.set_dual([q0, q1, q2]);
        (run.iteration, run.momentum) = (state.iteration, state.momentum);
        (run.objective, run.change, run.lipschitz) = (state.objective, state.change, state.lipschitz);
        Ok(run)
    }
}
