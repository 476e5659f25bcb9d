//! The methods in a precision that is known when the program runs.
//!
//! Their loops are compiled in this crate, once, and not again in every crate that calls them.

use crate::classical::VoxelProjector;
use crate::classical::algebraic::held_out::{self, FinishSearch};
use crate::classical::algebraic::{
    AsdPocsRun, AsdPocsSettings, CglsRun, Choice, Division, ObserveChoice, Passes, SartRun, SartSettings, TvRun,
    TvSettings, VoxelRun, VoxelState,
};
use crate::neural::{Batch, NeuralRun, NeuralSettings};
use ndarray::ArrayD;
use trgs_core::error::Result;
use trgs_core::geometry::{Projections, Scanner, Volume};
use trgs_core::in_precision;
use trgs_core::numeric::Precision;
use trgs_scan::limit;

/// An iterative method and its settings.
pub enum Iterative<'s> {
    /// SART or OS-SART.
    Sart(&'s SartSettings),
    /// ASD-POCS.
    AsdPocs(&'s AsdPocsSettings),
    /// CGLS with so many iterations.
    Cgls(usize),
    /// Total variation from zeros or from a volume, on so many slabs.
    Tv(&'s TvSettings, Option<&'s Volume>, &'s Division),
    /// A network, and the density that counts as 1.
    Network(&'s NeuralSettings, f64),
}

/// A run of a method from its beginning, or from a state with the bits of an uninterrupted run.
pub fn begin<'a>(
    method: &Iterative<'_>,
    precision: Precision,
    projector: &'a VoxelProjector,
    views: &'a Projections,
    state: Option<&VoxelState>,
) -> Result<Box<dyn VoxelRun + 'a>> {
    in_precision!(precision, R => Ok(match (method, state) {
        (Iterative::Sart(settings), _) => Box::new(SartRun::<R>::new(projector, views, settings, state)?),
        (Iterative::AsdPocs(settings), _) => Box::new(AsdPocsRun::<R>::new(projector, views, settings, state)?),
        (Iterative::Cgls(iterations), _) => Box::new(CglsRun::<R>::new(projector, views, *iterations, state)?),
        (Iterative::Tv(settings, _, division), Some(state)) => {
            Box::new(TvRun::<R>::resume(projector, views, settings, state, division)?)
        }
        (Iterative::Tv(settings, start, division), None) => {
            Box::new(TvRun::<R>::new(projector, views, settings, *start, division)?)
        }
        (Iterative::Network(settings, unit), _) => {
            Box::new(NeuralRun::<R>::new(projector.scanner(), views, settings, *unit, state)?)
        }
    }))
}

/// [`crate::classical::algebraic::choose_weight`].
pub fn choose_weight(
    precision: Precision,
    projector: &VoxelProjector,
    views: &Projections,
    settings: &TvSettings,
    division: &Division,
    observe: &mut ObserveChoice<'_>,
) -> Result<Choice> {
    in_precision!(precision, R => held_out::choose_weight::<R>(projector, views, settings, division, observe))
}

/// [`crate::classical::algebraic::choose_passes`].
pub fn choose_passes(
    precision: Precision,
    projector: &VoxelProjector,
    views: &Projections,
    passes: Passes,
    observe: &mut ObserveChoice<'_>,
) -> Result<Choice> {
    in_precision!(precision, R => held_out::choose_passes::<R>(projector, views, passes, observe))
}

/// The finish of a volume that views held out ask for.
#[expect(clippy::too_many_arguments, reason = "those of the choice and its precision")]
pub fn choose_finish(
    precision: Precision,
    projector: &VoxelProjector,
    views: [&Projections; 2],
    start: &Volume,
    settings: &TvSettings,
    search: &FinishSearch,
    division: &Division,
    observe: &mut ObserveChoice<'_>,
) -> Result<Choice> {
    in_precision!(
        precision,
        R => held_out::choose_finish::<R>(projector, views, start, settings, search, division, observe)
    )
}

/// Parameters of a network by name.
type Named = Vec<(String, ArrayD<f64>)>;

/// The first steps of a network's training: parameters before and after, what each step sees, and its error before it.
pub fn first_steps(
    precision: Precision,
    scanner: &Scanner,
    views: &Projections,
    settings: &NeuralSettings,
    unit: f64,
    count: usize,
) -> Result<([Named; 2], Vec<Batch>, Vec<f64>)> {
    let rays = settings.rays + settings.windows * settings.window * settings.window;
    in_precision!(precision, R => {
        let mut run = NeuralRun::<R>::new(scanner, views, settings, unit, None)?;
        let begin = run.named_parameters();
        limit::allow_array("points of all steps", &[count, rays, settings.samples], 4 * size_of::<f64>())?;
        let (batches, errors) = (0..count).map(|_| (run.batch(), run.train())).unzip();
        Ok(([begin, run.named_parameters()], batches, errors))
    })
}
