//! Methods on voxels, one iteration at a time, and the state from which they continue to the same bits.

use super::Pass;
use serde::{Deserialize, Serialize};
use std::any::Any;
use std::borrow::Cow;
use trgs_core::error::{Error, Result, start_again};
use trgs_core::geometry::Volume;
use trgs_core::numeric::{Real, real};

/// A method on voxels, run one iteration at a time.
///
/// No method depends on the number of iterations that it was given, so a run that continues from the [`VoxelState`] of a
/// shorter one has the bits of a run that was longer from the start.
pub trait VoxelRun {
    /// Whether the run has converged or reached its last iteration.
    fn is_finished(&self) -> bool;

    /// Runs one iteration; `None` when nothing is left to do.
    ///
    /// # Errors
    /// When values become non-finite.
    fn step(&mut self) -> Result<Option<Pass>>;

    /// The state after the last iteration.
    fn state(&self) -> VoxelState<'_>;

    /// The current volume, `[x, y, z]`.
    ///
    /// # Errors
    /// None, since the shape is the grid's.
    fn into_volume(self: Box<Self>) -> Result<Volume>;
}

/// The state of a [`VoxelRun`] after an iteration, for a checkpoint file.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct VoxelState<'a> {
    pub(super) iteration: usize,
    /// Numbers of the method.
    pub(super) scalars: Vec<f64>,
    /// Arrays of the method; the first is the volume.
    pub(super) arrays: Vec<Numbers<'a>>,
}

/// Numbers in the precision of the run: those of the run itself, or read from a file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(super) enum Numbers<'a> {
    Single(Cow<'a, [f32]>),
    Double(Cow<'a, [f64]>),
}

impl<'a> Numbers<'a> {
    #[expect(clippy::ptr_arg, reason = "slices have no type that is known when the program runs")]
    pub(super) fn new<R: Real>(values: &'a Vec<R>) -> Self {
        let values: &dyn Any = values;
        let single = values.downcast_ref::<Vec<f32>>().map(|values| Self::Single(values.into()));
        single.unwrap_or_else(|| Self::Double(values.downcast_ref::<Vec<f64>>().expect("single or double").into()))
    }

    fn are_finite(&self) -> bool {
        match self {
            Self::Single(values) => values.iter().all(|value| value.is_finite()),
            Self::Double(values) => values.iter().all(|value| value.is_finite()),
        }
    }

    fn get<R: Real>(&self) -> Vec<R> {
        match self {
            Self::Single(values) => values.iter().map(|&value| real(f64::from(value))).collect(),
            Self::Double(values) => values.iter().map(|&value| real(value)).collect(),
        }
    }
}

impl<'a> VoxelState<'a> {
    /// The state of a method with these arrays.
    pub(super) fn of<R: Real>(iteration: usize, scalars: Vec<f64>, arrays: Vec<&'a Vec<R>>) -> Self {
        Self { iteration, scalars, arrays: arrays.into_iter().map(Numbers::new).collect() }
    }
}

impl VoxelState<'_> {
    /// Iterations done.
    pub fn iteration(&self) -> usize {
        self.iteration
    }

    /// Whether no array has a value that is not finite, and no number of the method is NaN: residuals begin at infinity.
    #[doc(hidden)]
    pub fn is_finite(&self) -> bool {
        self.arrays.iter().all(Numbers::are_finite) && !self.scalars.iter().any(|scalar| scalar.is_nan())
    }

    /// A state of numbers and arrays in double precision.
    #[doc(hidden)]
    pub fn new(iteration: usize, scalars: Vec<f64>, arrays: [Vec<f64>; 3]) -> Self {
        Self { iteration, scalars, arrays: arrays.map(|array| Numbers::Double(array.into())).into() }
    }

    /// The numbers and arrays of a method; `lengths` are those of the arrays.
    #[doc(hidden)]
    pub fn get<R: Real, const S: usize, const A: usize>(&self, lengths: [usize; A]) -> Result<([f64; S], [Vec<R>; A])> {
        let refused = |got: String, expected: String| Error::invalid("checkpoint", got, expected, start_again());
        let scalars =
            self.scalars.as_slice().try_into().map_err(|_| {
                refused(format!("{} numbers", self.scalars.len()), format!("{S} numbers of the method"))
            })?;
        let arrays: Vec<Vec<R>> = self.arrays.iter().map(Numbers::get).collect();
        let found: Vec<usize> = arrays.iter().map(Vec::len).collect();
        if found != lengths {
            return Err(refused(format!("arrays of {found:?}"), format!("{lengths:?}")));
        }
        Ok((scalars, arrays.try_into().expect("as many arrays as lengths")))
    }
}
