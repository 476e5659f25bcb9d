//! What a primitive is, wherever it is seen from: its whitening matrix and the constants of its kernel, and the
//! way back from a gradient in these terms to scales, quaternion, density and ν.

use crate::numeric::vectors::{EIGHT, Eight, Matrices, Vectors, all};
use crate::numeric::{Real, threads};
use crate::primitives::{Kernel, Parameters, Primitives, gaussian, rotation, student_t};
use glam::{DMat3, DQuat, DVec2, DVec3};
use std::ops::Add;

/// Primitives worked on together.
pub(super) const CHUNK: usize = 256;

/// One primitive, prepared once for all views and grids.
#[derive(Clone, Copy, Debug)]
pub(super) struct Shape {
    pub(super) mean: DVec3,
    /// Unit quaternion.
    rotation: DQuat,
    /// Length of the given quaternion.
    norm: f64,
    /// 1/s.
    pub(super) inverse_scale: DVec3,
    /// `M = diag(1/s)·Rᵀ`, so that `Σ⁻¹ = MᵀM` and δ = |M(x-μ)|².
    pub(super) whitening: DMat3,
    pub(super) density: f64,
    /// Integral of the kernel along a line of unit scale through its centre, and the derivative to ν `[Eq. 5]`.
    pub(super) line: (f64, f64),
    /// δ is measured in units of this: ν, or 2 ln 2 for the Gaussian.
    pub(super) unit: f64,
    /// Largest δ/unit within the cutoff, infinite without one.
    pub(super) reach: f64,
    /// Largest δ/unit that counts: the cutoff's, or the last one whose powers R can hold.
    pub(super) limit: f64,
    /// ν, infinite for the Gaussian.
    pub(super) nu: f64,
}

/// Gradient to a primitive in the terms in which all its uses are linear.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct ShapeGradient {
    pub(super) mean: DVec3,
    /// To Σ⁻¹, symmetric, in whitened axes: xx, xy, xz, yy, yz, zz of the D of `tr(D·M⁻ᵀ dΣ⁻¹ M⁻¹)`. Needles keep their
    /// digits in these.
    pub(super) precision: [f64; 6],
    pub(super) density: f64,
    pub(super) nu: f64,
    /// To the centre's shadow with everything else held, in halves of the detector along (u, v), summed over views.
    pub(super) shadow: DVec2,
}

impl ShapeGradient {
    pub(super) const ZERO: Self =
        Self { mean: DVec3::ZERO, precision: [0.0; 6], density: 0.0, nu: 0.0, shadow: DVec2::ZERO };

    pub(super) fn add(&mut self, other: &Self) {
        self.mean += other.mean;
        self.precision.iter_mut().zip(other.precision).for_each(|(entry, other)| *entry += other);
        self.density += other.density;
        self.nu += other.nu;
        self.shadow += other.shadow;
    }
}

/// A symmetric matrix in each of eight lanes: xx, xy, xz, yy, yz, zz.
#[derive(Clone, Copy)]
pub(super) struct Symmetric([Eight; 6]);

impl Symmetric {
    /// `factor · (a bᵀ + b aᵀ)/2`.
    #[inline(always)]
    pub(super) fn new(a: Vectors, b: Vectors, factor: Eight) -> Self {
        let half = all(0.5) * factor;
        let (a, b) = ([a.x, a.y, a.z], [b.x, b.y, b.z]);
        Self([[0, 0], [0, 1], [0, 2], [1, 1], [1, 2], [2, 2]].map(|[i, j]| (a[i] * b[j] + b[i] * a[j]) * half))
    }
}

impl Add for Symmetric {
    type Output = Self;
    #[inline(always)]
    fn add(self, other: Self) -> Self {
        Self(std::array::from_fn(|i| self.0[i] + other.0[i]))
    }
}

/// The [`ShapeGradient`] of eight primitives.
pub(super) struct Gradients {
    pub(super) mean: Vectors,
    pub(super) precision: Symmetric,
    pub(super) density: Eight,
    pub(super) nu: Eight,
    /// Along u and v.
    pub(super) shadow: [Eight; 2],
}

impl Gradients {
    /// One for each lane.
    #[inline(always)]
    pub(super) fn to_array(&self) -> [ShapeGradient; EIGHT] {
        let mean = self.mean.to_array();
        let precision = self.precision.0.map(Eight::to_array);
        let [density, nu, u, v] = [self.density, self.nu, self.shadow[0], self.shadow[1]].map(Eight::to_array);
        std::array::from_fn(|i| ShapeGradient {
            mean: mean[i],
            precision: precision.map(|entry| entry[i]),
            density: density[i],
            nu: nu[i],
            shadow: DVec2::new(u[i], v[i]),
        })
    }
}

impl Shape {
    /// Primitive `i`, cut off where it has fallen to 2^-`bits`, for kernels that run in `R`.
    pub(super) fn new<R: Real>(primitives: &Primitives, i: usize, bits: f64) -> Self {
        let p = &primitives.parameters;
        let (rotation, norm) = rotation::unit(p.quaternion[i]);
        let inverse_scale = 1.0 / DVec3::from_array(p.scale[i]);
        let nu = p.nu[i];
        let (line, unit, reach, horizon) = match primitives.kernel {
            Kernel::Gaussian => (
                (gaussian::line_integral(), 0.0),
                gaussian::UNIT,
                gaussian::reach(bits) / gaussian::UNIT,
                gaussian::horizon::<R>(),
            ),
            Kernel::StudentT => {
                (student_t::line_integral(nu), nu, student_t::reach(nu, bits) / nu, student_t::horizon::<R>(nu))
            }
        };
        Self {
            mean: DVec3::from_array(p.mean[i]),
            rotation,
            norm,
            inverse_scale,
            whitening: DMat3::from_diagonal(inverse_scale) * DMat3::from_quat(rotation).transpose(),
            density: p.density[i],
            line,
            unit,
            reach,
            limit: reach.min(horizon),
            nu,
        }
    }

    /// All primitives with a relative cutoff ε (0: none), in parallel.
    pub(super) fn all_into<R: Real>(shapes: &mut Vec<Self>, primitives: &Primitives, epsilon: f64) {
        let bits = student_t::bits(epsilon);
        threads::map_many_into(shapes, primitives.len(), |i| Self::new::<R>(primitives, i, bits));
    }

    /// `1/(s₁s₂s₃)`, the determinant of the whitening matrix.
    pub(super) fn determinant(&self) -> f64 {
        self.inverse_scale.x * self.inverse_scale.y * self.inverse_scale.z
    }

    /// A bound on any projection of this primitive beyond its cutoff ε: |ρ| · line integral · largest scale · ε.
    pub(super) fn truncation_bound(&self, epsilon: f64) -> f64 {
        self.density.abs() * self.line.0 / self.inverse_scale.min_element() * epsilon
    }

    /// Gradient to mean, scale and quaternion.
    ///
    /// Rotating the body frame by a small ω changes Σ⁻¹ by `R([ω]Λ - Λ[ω])Rᵀ`, Λ = diag(1/s²): the torque of two axes
    /// carries the factor sⱼ/sᵢ - sᵢ/sⱼ and vanishes exactly where they are equal. The gradient to the quaternion
    /// is tangential by construction.
    fn finish(&self, gradient: &ShapeGradient) -> ([f64; 3], [f64; 3], [f64; 4]) {
        let [xx, xy, xz, yy, yz, zz] = gradient.precision;
        let inverse = self.inverse_scale;
        let scale = [(0, xx), (1, yy), (2, zz)].map(|(k, d)| -2.0 * inverse[k] * d);
        let torque = |a: usize, b: usize, d: f64| 2.0 * d * (inverse[a] / inverse[b] - inverse[b] / inverse[a]);
        let q = self.rotation * DQuat::from_xyzw(torque(1, 2, yz), torque(2, 0, xz), torque(0, 1, xy), 0.0);
        (gradient.mean.to_array(), scale, [q.w, q.x, q.y, q.z].map(|x| 2.0 * x / self.norm))
    }
}

/// The whitening matrices of eight primitives.
#[inline(always)]
pub(super) fn whitening(shapes: [&Shape; EIGHT]) -> Matrices {
    Matrices { columns: [0, 1, 2].map(|axis| Vectors::each(|i| shapes[i].whitening.col(axis))) }
}

/// The gradient to all parameters of all primitives, in parallel.
pub(super) fn finish(shapes: &[Shape], gradients: &[ShapeGradient], all: &mut Parameters) {
    all.resize(shapes.len());
    let Parameters { mean, scale, quaternion, density, nu } = all;
    let chunks = (
        threads::chunks(mean, CHUNK),
        threads::chunks(scale, CHUNK),
        threads::chunks(quaternion, CHUNK),
        threads::chunks(density, CHUNK),
        threads::chunks(nu, CHUNK),
    );
    threads::for_each_of(chunks, |chunk, (mean, scale, quaternion, density, nu)| {
        for row in 0..mean.len() {
            let i = chunk * CHUNK + row;
            (mean[row], scale[row], quaternion[row]) = shapes[i].finish(&gradients[i]);
            (density[row], nu[row]) = (gradients[i].density, gradients[i].nu);
        }
    });
}

#[cfg(test)]
mod tests {
    use super::*;

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
        let m = Shape::new::<f64>(&primitives, 0, f64::INFINITY).whitening;
        let unit = m * primitives.parameters.covariance(0) * m.transpose();
        assert!((unit - DMat3::IDENTITY).to_cols_array().iter().all(|x| x.abs() < 1e-14), "{unit}");
    }

    #[test]
    fn the_gradient_to_a_quaternion_is_inverse_to_its_length_however_small() {
        let gradient = ShapeGradient { precision: [0.3, -0.8, 0.5, -1.6, 1.0, 1.5], ..ShapeGradient::ZERO };
        let to_quaternion = |length: f64| {
            let shape = Shape::new::<f64>(&primitives([0.7, -0.3, 0.5, 0.2].map(|x| x * length)), 0, f64::INFINITY);
            let mut all = Parameters::default();
            finish(&[shape], &[gradient], &mut all);
            all.quaternion[0]
        };
        let ordinary = to_quaternion(1.0);
        for length in [1e-149, 1e-100, 1e150] {
            for (a, b) in to_quaternion(length).into_iter().zip(ordinary) {
                approx::assert_relative_eq!(a * length, b, max_relative = 1e-13);
            }
        }
    }
}
