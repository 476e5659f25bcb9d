//! Adaptive density control by the gradient to the projected means.
//!
//! Primitives with a large gradient are cloned if small and split if large. Faint primitives and those outside of the
//! volume are removed.

use super::NextPrimitive;
use crate::geometry::Grid;
use crate::primitives::{Parameters, rotation};
use glam::DVec3;

/// Parts of a split primitive.
const PARTS: usize = 2;
/// Ratio of a primitive's scales to those of its parts.
const SHRINK: f64 = 1.6;

/// Thresholds.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Settings {
    /// Densify where the mean screen-space positional gradient (NDC units) is at least this.
    pub gradient: f64,
    /// Primitives up to this scale are cloned, larger ones split; scene units.
    pub split_scale: f64,
    /// Density below which a primitive is removed.
    pub faint: f64,
    /// Number of primitives from which none is added.
    pub cap: usize,
}

/// One step of `[ADC]`: the next population.
///
/// `view_gradient[i]` is the mean length of the gradient to the projected mean over the views that saw primitive `i` (see
/// [`FieldGradient::mean2d_gradients`](crate::projector::FieldGradient::mean2d_gradients)). `normals(i)` are six standard
/// normal numbers for the positions of its two parts.
///
/// A clone and its origin have the density `ρ/2` each, at the same position. A split primitive is replaced by two parts
/// of density ρ/2 and scales s/1.6, whose positions are drawn from the normal distribution with its mean and covariance.
/// Then primitives below `faint` and those centred outside of the box are removed. The others stay in order, followed by
/// clones, then parts.
/// Not in the paper: R²-Gaussian's rules. Tests: below, and `tests/contracts/invariance.rs`.
///
/// # Panics
/// If `view_gradient` does not have one number per primitive.
pub fn adc(
    primitives: &Parameters,
    view_gradient: &[f64],
    settings: &Settings,
    grid: &Grid,
    normals: impl Fn(usize) -> [f64; 3 * PARTS],
) -> Vec<NextPrimitive> {
    assert_eq!(view_gradient.len(), primitives.len(), "numbers of gradients and primitives");
    let room = primitives.len() < settings.cap;
    let (mut stay, mut clones, mut parts) = (Vec::new(), Vec::new(), Vec::new());
    for (i, &view_gradient) in view_gradient.iter().enumerate() {
        let same = NextPrimitive::same(primitives, i);
        let half = NextPrimitive { density: same.density / 2.0, ..same };
        let largest = same.scale.into_iter().fold(0.0, f64::max);
        if !room || view_gradient < settings.gradient {
            stay.push(same);
        } else if largest <= settings.split_scale {
            stay.push(half);
            clones.push(NextPrimitive { fresh: true, ..half });
        } else {
            let (rotation, _) = rotation::unit(primitives.quaternion[i]);
            for z in normals(i).chunks_exact(3) {
                let offset = rotation * (DVec3::from_array(same.scale) * DVec3::from_slice(z));
                let mean = (DVec3::from_array(same.mean) + offset).to_array();
                parts.push(NextPrimitive { mean, scale: same.scale.map(|s| s / SHRINK), fresh: true, ..half });
            }
        }
    }
    stay.extend(clones);
    stay.extend(parts);
    let (low, high) = (grid.min, grid.max());
    stay.retain(|s| {
        let mean = DVec3::from_array(s.mean);
        s.density >= settings.faint && mean.cmpge(low).all() && mean.cmple(high).all()
    });
    stay
}

#[cfg(test)]
mod tests {
    use super::super::next_parameters;
    use super::*;

    const SETTINGS: Settings = Settings { gradient: 1e-3, split_scale: 0.2, faint: 1e-2, cap: 100 };

    fn primitives() -> Parameters {
        Parameters {
            mean: vec![[0.1, 0.2, 0.3], [-0.4, 0.5, 0.0], [0.0, 0.0, 0.1], [0.7, -0.2, 0.6]],
            scale: vec![[0.1, 0.2, 0.05], [0.1, 0.3, 0.1], [0.5, 0.1, 0.1], [0.1; 3]],
            quaternion: vec![[1.0, 0.0, 0.0, 0.0], [1.0, 0.0, 0.0, 1.0], [1.0, 0.0, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0]],
            density: vec![0.4, 0.6, 0.8, 0.1],
            nu: vec![3.0, 4.0, 5.0, 6.0],
        }
    }

    fn step(view_gradient: [f64; 4], settings: &Settings) -> Vec<NextPrimitive> {
        adc(&primitives(), &view_gradient, settings, &Grid::cube(8), |_| [0.5, -1.0, 2.0, -0.5, 1.0, -2.0])
    }

    #[test]
    fn the_small_are_cloned_and_the_large_are_split() {
        let next = step([1e-3, 2e-3, 0.0, 9e-4], &SETTINGS);
        let kept: Vec<_> = next.iter().map(|s| (s.parent, s.fresh, s.density)).collect();
        let expected =
            [(0, false, 0.2), (2, false, 0.8), (3, false, 0.1), (0, true, 0.2), (1, true, 0.3), (1, true, 0.3)];
        assert_eq!(kept, expected);
        assert_eq!((next[3].mean, next[3].scale), ([0.1, 0.2, 0.3], [0.1, 0.2, 0.05]));
        // The second primitive is turned by 90° about z: its x axis points along y, its y axis along -x.
        for (got, expected) in next[4].mean.into_iter().zip([-0.4 + 0.3, 0.5 + 0.05, 0.2]) {
            within!((got - expected).abs());
        }
        assert_eq!(next[4].scale, [0.1, 0.3, 0.1].map(|s| s / 1.6));
        let parameters = next_parameters(&primitives(), &next);
        assert_eq!((parameters.nu[4], parameters.quaternion[4]), (4.0, [1.0, 0.0, 0.0, 1.0]));
    }

    #[test]
    fn a_clone_changes_neither_field_nor_mass() {
        let next = step([1.0, 0.0, 0.0, 1.0], &SETTINGS);
        for i in 0..4 {
            let total: f64 = next.iter().filter(|s| s.parent == i).map(|s| s.density).sum();
            assert_eq!(total, primitives().density[i]);
            assert!(next.iter().filter(|s| s.parent == i).all(|s| s.mean == primitives().mean[i]));
        }
    }

    #[test]
    fn the_faint_and_the_lost_are_removed() {
        let mut lost = primitives();
        (lost.density[0], lost.mean[2]) = (0.009, [0.0, 1.0 + 1e-9, 0.0]);
        let next = adc(&lost, &[0.0; 4], &SETTINGS, &Grid::cube(8), |_| [0.0; 6]);
        assert_eq!(next.iter().map(|s| s.parent).collect::<Vec<_>>(), [1, 3]);
        // Halves of what is just above the threshold are below it.
        lost.density[0] = 0.019;
        assert!(adc(&lost, &[1.0; 4], &SETTINGS, &Grid::cube(8), |_| [0.0; 6]).iter().all(|s| s.parent != 0));
    }

    #[test]
    fn a_full_population_is_only_thinned() {
        let next = step([1.0; 4], &Settings { cap: 4, ..SETTINGS });
        assert_eq!(next, (0..4).map(|i| NextPrimitive::same(&primitives(), i)).collect::<Vec<_>>());
        assert_eq!(step([1.0; 4], &Settings { cap: 5, ..SETTINGS }).len(), 8);
    }
}
