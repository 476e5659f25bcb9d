//! Primitives in the terms that all views and grids share: the whitening matrix and the constants of the kernel.
//!
//! Gradients are summed in these terms, and then converted to scales, quaternion, density and ν.

use crate::numeric::vectors::{DMat3x8, DVec3x8, LANES, f64x8, splat};
use crate::numeric::{Lanes, threads};
use crate::primitives::rotation::Units;
use crate::primitives::{KernelKind, Parameters, Primitives, Rows, gaussian, student_t};
use glam::{DMat3, DQuat, DVec2, DVec3};
use std::array::from_fn;
use std::ops::Add;

/// Primitives of one task.
pub(crate) const CHUNK: usize = 256;

/// One primitive, prepared once for all views and grids.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct WhitenedPrimitive {
    pub(crate) mean: DVec3,
    /// Unit quaternion.
    rotation: DQuat,
    /// Length of the given quaternion.
    norm: f64,
    /// 1/s.
    pub(crate) inverse_scale: DVec3,
    /// `M = diag(1/s)·Rᵀ`, so that `Σ⁻¹ = MᵀM` and δ = |M(x-μ)|².
    pub(crate) whitening: DMat3,
    pub(crate) density: f64,
    /// Integral of the kernel along a line of unit scale through its centre, and its derivative to ν `[Eq. 5]`.
    pub(crate) line: (f64, f64),
    /// δ is measured in units of this: ν, or 2 ln 2 for the Gaussian.
    pub(crate) unit: f64,
    /// Largest δ/unit within the cutoff, infinite without one.
    pub(crate) cutoff_x: f64,
    /// Largest δ/unit of the support: the cutoff's, or the last one whose powers R can hold.
    pub(crate) max_x: f64,
    /// ν, infinite for the Gaussian.
    pub(crate) nu: f64,
    /// Radius of a sphere around the support.
    pub(crate) radius: f64,
}

/// Gradient to one primitive, in the terms in which views and volumes add up.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct PrimitiveGradient {
    pub(crate) mean: DVec3,
    /// To Σ⁻¹, symmetric, in whitened axes: xx, xy, xz, yy, yz, zz of the D of `tr(D·M⁻ᵀ dΣ⁻¹ M⁻¹)`. Needles keep their
    /// digits in these.
    pub(crate) precision: [f64; 6],
    pub(crate) density: f64,
    pub(crate) nu: f64,
    /// To the projected mean with all else held constant, in halves of the detector along (u, v), summed over views.
    pub(crate) mean2d: DVec2,
}

impl PrimitiveGradient {
    pub(crate) const ZERO: Self =
        Self { mean: DVec3::ZERO, precision: [0.0; 6], density: 0.0, nu: 0.0, mean2d: DVec2::ZERO };

    pub(crate) fn add(&mut self, other: &Self) {
        self.mean += other.mean;
        self.precision.iter_mut().zip(other.precision).for_each(|(entry, other)| *entry += other);
        self.density += other.density;
        self.nu += other.nu;
        self.mean2d += other.mean2d;
    }
}

/// A symmetric matrix in each of eight lanes: xx, xy, xz, yy, yz, zz.
#[derive(Clone, Copy)]
pub(crate) struct Symmetric([f64x8; 6]);

impl Symmetric {
    /// `factor · (a bᵀ + b aᵀ)/2`.
    #[inline(always)]
    pub(crate) fn new(a: DVec3x8, b: DVec3x8, factor: f64x8) -> Self {
        let half = splat(0.5) * factor;
        let (a, b) = ([a.x, a.y, a.z], [b.x, b.y, b.z]);
        let entry = |i: usize, j: usize| (a[i] * b[j] + b[i] * a[j]) * half;
        Self([entry(0, 0), entry(0, 1), entry(0, 2), entry(1, 1), entry(1, 2), entry(2, 2)])
    }
}

impl Add for Symmetric {
    type Output = Self;
    #[inline(always)]
    fn add(self, other: Self) -> Self {
        Self(from_fn(|i| self.0[i] + other.0[i]))
    }
}

/// The [`PrimitiveGradient`]s of eight primitives.
pub(crate) struct GradientLanes {
    pub(crate) mean: DVec3x8,
    pub(crate) precision: Symmetric,
    pub(crate) density: f64x8,
    pub(crate) nu: f64x8,
    /// Along u and v.
    pub(crate) mean2d: [f64x8; 2],
}

impl GradientLanes {
    /// The gradient of each lane.
    #[inline(always)]
    pub(crate) fn to_array(&self) -> [PrimitiveGradient; LANES] {
        let mean = self.mean.to_array();
        let precision: [_; 6] = from_fn(|entry| self.precision.0[entry].to_array());
        let (density, nu) = (self.density.to_array(), self.nu.to_array());
        let [u, v] = [self.mean2d[0].to_array(), self.mean2d[1].to_array()];
        from_fn(|i| PrimitiveGradient {
            mean: mean[i],
            precision: from_fn(|entry| precision[entry][i]),
            density: density[i],
            nu: nu[i],
            mean2d: DVec2::new(u[i], v[i]),
        })
    }
}

/// A gradient to a [`Field`](super::Field), summed over any number of views and volumes.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct FieldGradient {
    pub(crate) by_primitive: Vec<PrimitiveGradient>,
}

impl FieldGradient {
    /// Becomes zeros for `m` primitives.
    pub fn reset(&mut self, m: usize) {
        self.by_primitive.resize(m, PrimitiveGradient::ZERO);
        threads::for_each_chunk(&mut self.by_primitive, CHUNK, |_, gradients| gradients.fill(PrimitiveGradient::ZERO));
    }

    /// Adds another gradient to the same field.
    pub fn add(&mut self, other: &Self) {
        assert_eq!(self.by_primitive.len(), other.by_primitive.len(), "primitives of the gradients");
        threads::for_each_chunk(&mut self.by_primitive, CHUNK, |chunk, gradients| {
            let others = &other.by_primitive[chunk * CHUNK..];
            gradients.iter_mut().zip(others).for_each(|(gradient, other)| gradient.add(other));
        });
    }

    /// Sets the gradient to the means to zero.
    pub fn freeze_means(&mut self) {
        self.by_primitive.iter_mut().for_each(|gradient| gradient.mean = DVec3::ZERO);
    }

    /// The gradient to each projected mean, all else held constant, `[∂/∂û, ∂/∂v̂]`: û and v̂ run from -1 to 1 over the
    /// detector. It is summed over the views of the gradient; volumes add nothing. Adaptive density control uses it.
    ///
    /// Not in the paper: units and meaning are R²-Gaussian's.
    pub fn mean2d_gradients(&self) -> impl Iterator<Item = [f64; 2]> {
        self.by_primitive.iter().map(|gradient| gradient.mean2d.to_array())
    }
}

/// Whitened primitives and the constants that they share.
#[derive(Clone, Copy)]
pub(crate) struct Whitened<'a> {
    pub(crate) primitives: &'a [WhitenedPrimitive],
    pub(crate) kernel: KernelKind,
    /// Relative to each primitive's peak, 0 for none.
    pub(crate) cutoff: f64,
}

impl WhitenedPrimitive {
    /// Whitens up to eight primitives, cut off where they have fallen to 2^-`bits`, for kernels that represent
    /// 2^-`horizon`.
    #[inline(always)]
    fn whiten(whitened: &mut [Self], primitives: &Primitives, indices: [usize; LANES], bits: f64, horizon: f64) {
        let p = &primitives.parameters;
        let (rotations, norms) = Units::new(from_fn(|entry| f64x8::from_fn(|i| p.quaternion[indices[i]][entry])));
        let one = splat(1.0);
        let [x, y, z] = from_fn(|axis| one / f64x8::from_fn(|i| p.scale[indices[i]][axis]));
        let nu = f64x8::from_fn(|i| p.nu[indices[i]]);
        let (line, unit, cutoff_x, max_x) = match primitives.kernel {
            KernelKind::Gaussian => {
                let cutoff_x = gaussian::reach(bits) / gaussian::UNIT;
                let line = (splat(gaussian::line_integral()), splat(0.0));
                (line, splat(gaussian::UNIT), splat(cutoff_x), splat(cutoff_x.min(horizon)))
            }
            KernelKind::StudentT => {
                let cutoff_x = student_t::reaches(nu, bits) / nu;
                (student_t::line_integrals(nu), nu, cutoff_x, student_t::limits(nu, bits, cutoff_x, horizon))
            }
        };
        let radius = (max_x * unit).sqrt() / x.at_most(y.at_most(z)) * splat(1.0 + 1e-9);
        let columns = rotations.transposed().columns;
        let whitening: [_; 3] =
            from_fn(|j| DVec3x8::new(x * columns[j].x, y * columns[j].y, z * columns[j].z).to_array());
        let (rotations, norms) = (rotations.to_array(), norms.to_array());
        let inverse_scale = DVec3x8::new(x, y, z).to_array();
        let (line, slope, unit) = (line.0.to_array(), line.1.to_array(), unit.to_array());
        let (cutoff_x, max_x, radius) = (cutoff_x.to_array(), max_x.to_array(), radius.to_array());
        for (lane, (primitive, i)) in whitened.iter_mut().zip(indices).enumerate() {
            *primitive = Self {
                mean: DVec3::from_array(p.mean[i]),
                rotation: rotations[lane],
                norm: norms[lane],
                inverse_scale: inverse_scale[lane],
                whitening: DMat3::from_cols(whitening[0][lane], whitening[1][lane], whitening[2][lane]),
                density: p.density[i],
                line: (line[lane], slope[lane]),
                unit: unit[lane],
                cutoff_x: cutoff_x[lane],
                max_x: max_x[lane],
                nu: p.nu[i],
                radius: radius[lane],
            };
        }
    }

    /// Whitens primitive `i` alone.
    #[cfg(test)]
    pub(crate) fn new<R: crate::numeric::Real>(primitives: &Primitives, i: usize, bits: f64) -> Self {
        let mut primitive = Self::default();
        Self::whiten(std::slice::from_mut(&mut primitive), primitives, [i; LANES], bits, R::HORIZON);
        primitive
    }

    /// Whitens all primitives with a relative cutoff ε (0: none) for kernels that represent 2^-`horizon`, in parallel.
    pub(crate) fn all_into(whitened: &mut Vec<Self>, primitives: &Primitives, epsilon: f64, horizon: f64) {
        let (bits, last) = (student_t::bits(epsilon), primitives.len().saturating_sub(1));
        whitened.resize(primitives.len(), Self::default());
        threads::for_each_chunk(whitened, CHUNK, |chunk, whitened| {
            for (first, whitened) in (chunk * CHUNK..).step_by(LANES).zip(whitened.chunks_mut(LANES)) {
                let indices = from_fn(|i| (first + i).min(last));
                Self::whiten(whitened, primitives, indices, bits, horizon);
            }
        });
    }

    /// `1/(s₁s₂s₃)`, the determinant of the whitening matrix.
    pub(crate) fn determinant(&self) -> f64 {
        self.inverse_scale.x * self.inverse_scale.y * self.inverse_scale.z
    }

    /// A bound on any projection of this primitive beyond its cutoff ε: |ρ| · line integral · largest scale · ε.
    pub(crate) fn truncation_bound(&self, epsilon: f64) -> f64 {
        self.density.abs() * self.line.0 / self.inverse_scale.min_element() * epsilon
    }

    /// Gradient to mean, scale and quaternion.
    ///
    /// Rotating the body frame by a small ω changes Σ⁻¹ by `R([ω]Λ - Λ[ω])Rᵀ`, Λ = diag(1/s²): the torque of two axes
    /// carries the factor sⱼ/sᵢ - sᵢ/sⱼ and vanishes exactly where they are equal. The gradient to the quaternion
    /// is tangential by construction.
    fn parameter_gradient(&self, gradient: &PrimitiveGradient) -> ([f64; 3], [f64; 3], [f64; 4]) {
        let [xx, xy, xz, yy, yz, zz] = gradient.precision;
        let inverse = self.inverse_scale;
        let scale = [-2.0 * inverse.x * xx, -2.0 * inverse.y * yy, -2.0 * inverse.z * zz];
        let torque = |a: f64, b: f64, d: f64| 2.0 * d * (a / b - b / a);
        let DVec3 { x, y, z } = inverse;
        let q = self.rotation * DQuat::from_xyzw(torque(y, z, yz), torque(z, x, xz), torque(x, y, xy), 0.0);
        let slope = |x: f64| 2.0 * x / self.norm;
        (gradient.mean.to_array(), scale, [slope(q.w), slope(q.x), slope(q.y), slope(q.z)])
    }
}

/// The whitening matrices of eight primitives.
#[inline(always)]
pub(crate) fn whitening(whitened: [&WhitenedPrimitive; LANES]) -> DMat3x8 {
    let (x, y) =
        (DVec3x8::from_fn(|i| whitened[i].whitening.x_axis), DVec3x8::from_fn(|i| whitened[i].whitening.y_axis));
    DMat3x8 { columns: [x, y, DVec3x8::from_fn(|i| whitened[i].whitening.z_axis)] }
}

/// Writes the gradient to all parameters of all primitives, in parallel.
pub(crate) fn parameter_gradient(
    whitened: &[WhitenedPrimitive],
    gradients: &[PrimitiveGradient],
    all: &mut Parameters,
) {
    all.resize(whitened.len());
    all.for_each_chunk(CHUNK, |chunk, Rows { mean, scale, quaternion, density, nu }| {
        for row in 0..mean.len() {
            let i = chunk * CHUNK + row;
            (mean[row], scale[row], quaternion[row]) = whitened[i].parameter_gradient(&gradients[i]);
            (density[row], nu[row]) = (gradients[i].density, gradients[i].nu);
        }
    });
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::numeric::Real;
    use crate::numeric::rng::{Purpose, stream};
    use crate::primitives::rotation;
    use crate::tolerances::{largest, relative};
    use rand::RngExt;

    fn primitives(quaternion: [f64; 4]) -> Primitives {
        Primitives::new(Parameters {
            mean: vec![[0.1, 0.2, 0.3]],
            scale: vec![[0.05, 0.12, 0.2]],
            quaternion: vec![quaternion],
            density: vec![1.0],
            nu: vec![7.0],
        })
        .unwrap()
    }

    #[test]
    fn whitening_inverts_the_covariance() {
        let primitives = primitives([0.7, -0.3, 0.5, 0.2]);
        let m = WhitenedPrimitive::new::<f64>(&primitives, 0, f64::INFINITY).whitening;
        let unit = m * primitives.parameters.covariance(0) * m.transpose();
        within!(largest((unit - DMat3::IDENTITY).to_cols_array()), "{unit}");
    }

    #[test]
    fn among_seven_others_a_whitened_primitive_is_what_it_is_alone_by_glam() {
        let mut random = stream(3, Purpose::Phantom, 0, 0);
        let mut draw = |low: f64, high: f64| low + (high - low) * random.random::<f64>();
        let m = 61;
        let parameters = Parameters {
            mean: (0..m).map(|_| [0; 3].map(|_| draw(-1.0, 1.0))).collect(),
            scale: (0..m).map(|_| [0; 3].map(|_| draw(0.01, 0.3))).collect(),
            quaternion: (0..m).map(|_| [0; 4].map(|_| draw(-1.0, 1.0))).collect(),
            density: (0..m).map(|_| draw(0.1, 2.0)).collect(),
            nu: (0..m).map(|_| draw(0.5, 100.0)).collect(),
        };
        // Without a cutoff, and with one below what f32 can hold, the horizon is the max_x.
        for bits in [f64::INFINITY, student_t::bits(1e-2), 125.0, 300.0] {
            let primitives = Primitives::new(parameters.clone()).unwrap();
            let mut whitened = Vec::new();
            WhitenedPrimitive::all_into(&mut whitened, &primitives, libm::exp2(-bits), f32::HORIZON);
            for (i, primitive) in whitened.iter().enumerate() {
                assert_eq!(
                    format!("{primitive:?}"),
                    format!("{:?}", WhitenedPrimitive::new::<f32>(&primitives, i, bits))
                );
                let (rotation, norm) = rotation::unit(parameters.quaternion[i]);
                let inverse_scale = 1.0 / DVec3::from_array(parameters.scale[i]);
                let whitening = DMat3::from_diagonal(inverse_scale) * DMat3::from_quat(rotation).transpose();
                assert_eq!((primitive.rotation, primitive.norm, primitive.whitening), (rotation, norm, whitening));
                let nu = parameters.nu[i];
                let reach = student_t::reach(nu, bits) / nu;
                let max_x = reach.min(student_t::horizon(nu, f32::HORIZON));
                assert_eq!(
                    (primitive.line, primitive.cutoff_x, primitive.max_x),
                    (student_t::line_integral(nu), reach, max_x)
                );
            }
        }
    }

    #[test]
    fn the_gradient_to_a_quaternion_is_inverse_to_its_length_however_small() {
        let gradient = PrimitiveGradient { precision: [0.3, -0.8, 0.5, -1.6, 1.0, 1.5], ..PrimitiveGradient::ZERO };
        let to_quaternion = |length: f64| {
            let primitive =
                WhitenedPrimitive::new::<f64>(&primitives([0.7, -0.3, 0.5, 0.2].map(|x| x * length)), 0, f64::INFINITY);
            let mut all = Parameters::default();
            parameter_gradient(&[primitive], &[gradient], &mut all);
            all.quaternion[0]
        };
        let ordinary = to_quaternion(1.0);
        for length in [1e-149, 1e-100, 1e150] {
            for (a, b) in to_quaternion(length).into_iter().zip(ordinary) {
                within!(relative(a * length, b));
            }
        }
    }
}
