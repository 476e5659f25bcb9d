//! How primitives come and go: adaptive density control ([`adc`], R²-Gaussian's) and adding & recycling ([`ar`]).
//!
//! Both look at physical values and answer with the next population as a list of [`Successor`]s, each of an old
//! primitive. What is not named there (rotation, ν) is inherited; who is not `fresh` keeps its id and the optimiser's
//! memory. The volume's box and all thresholds are in the settings; all draws are given, none made.
//! Not in the paper: it names adding and recycling and compares with adaptive density control.

pub mod adc;
pub mod ar;
pub mod relocation;

pub use relocation::Relocation;

use crate::primitives::Parameters;

/// A primitive of the next population.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Successor {
    /// Row of the old primitive whose rotation and ν it has.
    pub parent: usize,
    /// Centre, scene units.
    pub mean: [f64; 3],
    /// Scales, scene units.
    pub scale: [f64; 3],
    /// Density, attenuation per scene unit.
    pub density: f64,
    /// Whether it is new: with an id of its own, unknown to the optimiser.
    pub fresh: bool,
}

impl Successor {
    /// Primitive `i` as it is.
    pub fn same(primitives: &Parameters, i: usize) -> Self {
        let (mean, scale, density) = (primitives.mean[i], primitives.scale[i], primitives.density[i]);
        Self { parent: i, mean, scale, density, fresh: false }
    }
}

/// The next population: physical values of the successors.
pub fn succeed(primitives: &Parameters, successors: &[Successor]) -> Parameters {
    Parameters {
        mean: successors.iter().map(|s| s.mean).collect(),
        scale: successors.iter().map(|s| s.scale).collect(),
        quaternion: successors.iter().map(|s| primitives.quaternion[s.parent]).collect(),
        density: successors.iter().map(|s| s.density).collect(),
        nu: successors.iter().map(|s| primitives.nu[s.parent]).collect(),
    }
}
