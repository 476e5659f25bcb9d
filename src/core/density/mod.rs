//! Density control: adaptive density control ([`adc`], R²-Gaussian's) and adding & recycling ([`ar`]).
//!
//! Both take physical values and return the next population as a list of [`NextPrimitive`]s, each derived from an old
//! primitive. Rotation and ν are inherited. A primitive that is not `fresh` keeps its id and the optimiser's moments.
//! Random numbers are arguments. Not in the paper: it names adding and recycling and compares with adaptive density
//! control.

pub mod adc;
pub mod ar;
pub mod relocation;

pub use relocation::Relocation;

use crate::primitives::{Parameters, rotation};
use glam::DVec3;
use std::collections::BTreeSet;

/// A primitive of the next population.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NextPrimitive {
    /// Row of the old primitive from which it inherits rotation and ν.
    pub parent: usize,
    /// Centre, scene units.
    pub mean: [f64; 3],
    /// Scales, scene units.
    pub scale: [f64; 3],
    /// Density, attenuation per scene unit.
    pub density: f64,
    /// Whether it is new: it gets an id of its own, and the optimiser starts from zero.
    pub fresh: bool,
}

impl NextPrimitive {
    /// Primitive `i`, unchanged.
    pub fn same(primitives: &Parameters, i: usize) -> Self {
        let (mean, scale, density) = (primitives.mean[i], primitives.scale[i], primitives.density[i]);
        Self { parent: i, mean, scale, density, fresh: false }
    }
}

/// Displaces fresh primitives, each by `spread` times a draw from the normal distribution with its own covariance.
///
/// `normals` returns three standard normal numbers per fresh primitive, in order. Copies at the same position would have
/// the same gradients and stay together. The displacement changes field and projections; a spread of 0 disables it.
///
/// Not in the paper. Tests: `what_is_fresh_moves_by_its_own_covariance`; its effect is in CHOICES.md.
pub fn spread(primitives: &Parameters, next: &mut [NextPrimitive], spread: f64, mut normals: impl FnMut() -> [f64; 3]) {
    for fresh in next.iter_mut().filter(|primitive| primitive.fresh) {
        let (rotation, _) = rotation::unit(primitives.quaternion[fresh.parent]);
        let offset = rotation * (DVec3::from_array(fresh.scale) * DVec3::from_array(normals()) * spread);
        fresh.mean = (DVec3::from_array(fresh.mean) + offset).to_array();
    }
}

/// Physical parameters of the next population.
pub fn next_parameters(primitives: &Parameters, next: &[NextPrimitive]) -> Parameters {
    Parameters {
        mean: next.iter().map(|s| s.mean).collect(),
        scale: next.iter().map(|s| s.scale).collect(),
        quaternion: next.iter().map(|s| primitives.quaternion[s.parent]).collect(),
        density: next.iter().map(|s| s.density).collect(),
        nu: next.iter().map(|s| primitives.nu[s.parent]).collect(),
    }
}

/// Of each primitive of the next population: the old row whose moments it keeps, and the one whose momentum it keeps.
///
/// A fresh primitive keeps neither. With `reset_parents` the moments of what was copied start anew, too.
/// Not in the paper. Tests: `src/train/state.rs`, and `src/train/trace.rs` against a whole run.
pub fn kept_rows(next: &[NextPrimitive], reset_parents: bool) -> [Vec<Option<usize>>; 2] {
    let copied: BTreeSet<usize> = next.iter().filter(|s| s.fresh && reset_parents).map(|s| s.parent).collect();
    let momentum: Vec<_> = next.iter().map(|s| (!s.fresh).then_some(s.parent)).collect();
    let moments = momentum.iter().map(|row| row.filter(|parent| !copied.contains(parent))).collect();
    [moments, momentum]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tolerances::relative;

    #[test]
    fn what_is_fresh_moves_by_its_own_covariance() {
        let primitives = Parameters {
            mean: vec![[0.1, 0.2, 0.3]],
            scale: vec![[0.5, 0.25, 0.125]],
            // A quarter turn about z, not normalised: x becomes y, y becomes -x.
            quaternion: vec![[2.0, 0.0, 0.0, 2.0]],
            density: vec![1.0],
            nu: vec![5.0],
        };
        let old = NextPrimitive::same(&primitives, 0);
        let small = NextPrimitive { fresh: true, scale: old.scale.map(|s| s / 2.0), ..old };
        let mut next = [old, NextPrimitive { fresh: true, ..old }, small];
        let mut draws = [[1.0, -2.0, 4.0], [1.0, 0.0, 0.0]].into_iter();
        spread(&primitives, &mut next, 2.0, || draws.next().unwrap());
        assert_eq!(draws.next(), None);
        assert_eq!(next[0], old);
        for (got, expected) in [(next[1].mean, [1.1, 1.2, 1.3]), (next[2].mean, [0.1, 0.7, 0.3])] {
            for (got, expected) in got.into_iter().zip(expected) {
                within!(relative(got, expected));
            }
        }
        assert_eq!((next[1].density, next[1].scale, next[1].parent), (old.density, old.scale, 0));
    }
}
