//! Raw ↔ physical parameters. Raw parameters are unconstrained real numbers for the optimiser.
//!
//! | physical | raw | range |
//! |---|---|---|
//! | μ | itself | everywhere |
//! | s | `min + (max-min)·σ(raw)` | open interval |
//! | s | `min + (max-min)·σ(raw)` | open interval |
//! | ρ | `softplus(raw)` | positive |
//! | ν | `min + (max-min)·σ(raw)` | open interval |
//!
//! Not in the paper: its parametrisation is not given; scales and densities follow R²-Gaussian.

use super::{KernelKind, Parameters, Primitives, Rows};
use crate::numeric::elementary::{logit, softplus_inverse};
use crate::numeric::exponentials::{expm1, sigmoid, softplus};
use crate::numeric::threads;
use crate::numeric::vectors::{self, f64x8, splat};

/// Primitives per parallel task.
const CHUNK: usize = 256;
/// Smallest distance of a value from a bound, as a fraction of the interval.
const MARGIN: f64 = 1e-5;

/// An open interval that a sigmoid maps onto.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Interval {
    /// Lower end, exclusive.
    pub min: f64,
    /// Upper end, exclusive.
    pub max: f64,
}

/// The map between raw and physical parameters.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Activation {
    /// The kernel of the resulting primitives.
    pub kernel: KernelKind,
    /// Range of the scales, scene units.
    pub scale: Interval,
    /// Range of ν.
    pub nu: Interval,
}

impl Interval {
    fn physical(&self, raw: f64x8) -> f64x8 {
        splat(self.min) + splat(self.max - self.min) * sigmoid(raw)
    }

    /// The raw value of a physical value; values outside the interval are first moved just inside.
    fn raw(&self, value: f64) -> f64 {
        let fraction = (value - self.min) / (self.max - self.min);
        logit(fraction.clamp(MARGIN, 1.0 - MARGIN))
    }

    /// d physical / d raw, computed from the physical value.
    fn slope(&self, value: f64) -> f64 {
        (value - self.min) * (self.max - value) / (self.max - self.min)
    }
}

impl Activation {
    /// Physical values of raw parameters.
    pub fn forward(&self, raw: &Parameters) -> Primitives {
        let mut physical = Primitives { kernel: self.kernel, parameters: Parameters::default() };
        self.forward_into(raw, &mut physical);
        physical
    }

    /// [`Self::forward`] into existing primitives.
    pub fn forward_into(&self, raw: &Parameters, physical: &mut Primitives) {
        physical.kernel = self.kernel;
        physical.parameters.resize(raw.len());
        physical.parameters.for_each_chunk(CHUNK, |chunk, Rows { mean, scale, quaternion, density, nu }| {
            let here = chunk * CHUNK..chunk * CHUNK + nu.len();
            mean.copy_from_slice(&raw.mean[here.clone()]);
            quaternion.copy_from_slice(&raw.quaternion[here.clone()]);
            let scales = raw.scale[here.clone()].as_flattened();
            vectors::map_into(scale.as_flattened_mut(), scales, |raw| self.scale.physical(raw));
            vectors::map_into(density, &raw.density[here.clone()], softplus);
            match self.kernel {
                KernelKind::Gaussian => nu.fill(f64::INFINITY),
                KernelKind::StudentT => vectors::map_into(nu, &raw.nu[here], |raw| self.nu.physical(raw)),
            }
        });
    }

    /// Raw parameters of physical values; values at or outside a bound are first moved just inside.
    pub fn inverse(&self, physical: &Parameters) -> Parameters {
        let mut raw = physical.clone();
        raw.scale.as_flattened_mut().iter_mut().for_each(|s| *s = self.scale.raw(*s));
        raw.density.iter_mut().for_each(|x| *x = softplus_inverse(x.max(1e-12)));
        match self.kernel {
            KernelKind::Gaussian => raw.nu.fill(0.0),
            KernelKind::StudentT => raw.nu.iter_mut().for_each(|x| *x = self.nu.raw(*x)),
        }
        raw
    }

    /// Converts a gradient with respect to physical values into one with respect to raw values, in place.
    pub fn vjp(&self, physical: &Primitives, gradient: &mut Parameters) {
        let values = &physical.parameters;
        let Parameters { scale, density, nu, .. } = gradient;
        let of_scale = || {
            threads::for_each_chunk(scale, CHUNK, |chunk, gradient| {
                for (d_scale, scale) in gradient.iter_mut().zip(&values.scale[chunk * CHUNK..]) {
                    d_scale.iter_mut().zip(scale).for_each(|(d_scale, scale)| *d_scale *= self.scale.slope(*scale));
                }
            });
        };
        // d softplus / d raw = 1 - e^-ρ needs no raw value.
        let of_density = || {
            threads::for_each_chunk(density, CHUNK, |chunk, gradient| {
                let mut slopes = [0.0; CHUNK];
                let slopes = &mut slopes[..gradient.len()];
                vectors::map_into(slopes, &values.density[chunk * CHUNK..], |density| -expm1(-density));
                gradient.iter_mut().zip(slopes).for_each(|(d_density, slope)| *d_density *= *slope);
            });
        };
        let of_nu = || match self.kernel {
            KernelKind::Gaussian => nu.fill(0.0),
            KernelKind::StudentT => nu.iter_mut().zip(&values.nu).for_each(|(d_nu, nu)| *d_nu *= self.nu.slope(*nu)),
        };
        threads::join(of_scale, || threads::join(of_density, of_nu));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tolerances::relative;

    fn activation(kernel: KernelKind) -> Activation {
        Activation { kernel, scale: Interval { min: 0.001, max: 1.0 }, nu: Interval { min: 2.0, max: 100.0 } }
    }

    fn raw() -> Parameters {
        Parameters {
            mean: vec![[0.1, -0.2, 0.3]],
            scale: vec![[-2.0, 0.4, 1.7]],
            quaternion: vec![[0.3, -0.4, 0.8, 0.1]],
            density: vec![-0.7],
            nu: vec![-1.3],
        }
    }

    #[test]
    fn inverse_undoes_forward() {
        let a = activation(KernelKind::StudentT);
        let back = a.inverse(&a.forward(&raw()).parameters);
        for group in super::super::Group::ALL {
            for (x, y) in back.group(group).iter().zip(raw().group(group)) {
                within!(relative(*x, *y));
            }
        }
    }

    #[test]
    fn vjp_matches_central_differences() {
        let a = activation(KernelKind::StudentT);
        let weights = Parameters {
            mean: vec![[1.0, 2.0, 3.0]],
            scale: vec![[0.5, -1.0, 2.0]],
            quaternion: vec![[1.0; 4]],
            density: vec![-3.0],
            nu: vec![0.7],
        };
        let loss = |raw: &Parameters| {
            let p = a.forward(raw).parameters;
            super::super::Group::ALL
                .iter()
                .flat_map(|g| p.group(*g).iter().zip(weights.group(*g)))
                .map(|(x, w)| x * w)
                .sum::<f64>()
        };
        let mut gradient = weights.clone();
        a.vjp(&a.forward(&raw()), &mut gradient);
        for group in super::super::Group::ALL {
            for i in 0..group.width() {
                let shifted = |h: f64| {
                    let mut p = raw();
                    p.group_mut(group)[i] += h;
                    loss(&p)
                };
                let difference = (shifted(1e-5) - shifted(-1e-5)) / 2e-5;
                within!(relative(gradient.group(group)[i], difference));
            }
        }
    }

    #[test]
    fn values_outside_of_their_range_come_to_lie_just_inside() {
        let a = activation(KernelKind::StudentT);
        let mut physical = a.forward(&raw()).parameters;
        physical.scale[0] = [0.0, 5.0, 0.5];
        physical.nu[0] = f64::INFINITY;
        let p = a.forward(&a.inverse(&physical)).parameters;
        assert!(p.scale[0][0] > a.scale.min && p.scale[0][1] < a.scale.max && p.nu[0] < a.nu.max);
    }
}
