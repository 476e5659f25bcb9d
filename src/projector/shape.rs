//! What a primitive is, wherever it is seen from: its whitening matrix and the constants of its kernel, and the
//! way back from a gradient in these terms to scales, quaternion, density and ν.

use crate::numeric::{Real, threads};
use crate::primitives::{Kernel, Parameters, Primitives, gaussian, student_t};
use glam::{DMat3, DQuat, DVec3};

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
    inverse_scale: DVec3,
    /// `M = diag(1/s)·Rᵀ`, so that `Σ⁻¹ = MᵀM` and δ = |M(x-μ)|².
    pub(super) whitening: DMat3,
    pub(super) density: f64,
    /// Integral of the kernel along a line of unit scale through its centre, and the derivative to ν `[Eq. 5]`.
    pub(super) line: (f64, f64),
    /// δ is measured in units of this: ν, or 2 ln 2 for the Gaussian.
    pub(super) unit: f64,
    /// Largest δ/unit that counts.
    pub(super) limit: f64,
    /// ν, infinite for the Gaussian.
    pub(super) nu: f64,
}

/// Gradient to a primitive in the terms in which all its uses are linear.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct ShapeGradient {
    pub(super) mean: DVec3,
    /// To Σ⁻¹, symmetric, in whitened axes: D of `tr(D·M⁻ᵀ dΣ⁻¹ M⁻¹)`. Needles keep their digits in these.
    pub(super) precision: DMat3,
    pub(super) density: f64,
    pub(super) nu: f64,
}

impl ShapeGradient {
    // Not `Default`: glam's default matrix is the identity.
    pub(super) const ZERO: Self = Self { mean: DVec3::ZERO, precision: DMat3::ZERO, density: 0.0, nu: 0.0 };

    pub(super) fn add(&mut self, other: &Self) {
        self.mean += other.mean;
        self.precision += other.precision;
        self.density += other.density;
        self.nu += other.nu;
    }
}

impl Shape {
    /// Primitive `i` with a relative cutoff ε (0: none), for kernels that run in `R`.
    pub(super) fn new<R: Real>(primitives: &Primitives, i: usize, epsilon: f64) -> Self {
        let p = &primitives.parameters;
        let [w, x, y, z] = p.quaternion[i];
        let norm = (w * w + x * x + y * y + z * z).sqrt();
        let rotation = DQuat::from_xyzw(x / norm, y / norm, z / norm, w / norm);
        let inverse_scale = 1.0 / DVec3::from_array(p.scale[i]);
        let nu = p.nu[i];
        let bits = student_t::bits(epsilon);
        let (line, unit, limit) = match primitives.kernel {
            Kernel::Gaussian => (
                (gaussian::line_integral(), 0.0),
                gaussian::UNIT,
                (gaussian::reach(bits) / gaussian::UNIT).min(R::HORIZON),
            ),
            // The largest exponent in use is the voxel gradient's, (ν+3)/2 + 1.
            Kernel::StudentT => (
                student_t::line_integral(nu),
                nu,
                (student_t::reach(nu, bits) / nu).min(student_t::horizon((nu + 5.0) / 2.0, R::HORIZON)),
            ),
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
            limit,
            nu,
        }
    }

    /// All primitives, in parallel.
    pub(super) fn all<R: Real>(primitives: &Primitives, epsilon: f64) -> Vec<Self> {
        let chunks = threads::map(primitives.len().div_ceil(CHUNK), |chunk| {
            let range = chunk * CHUNK..((chunk + 1) * CHUNK).min(primitives.len());
            range.map(|i| Self::new::<R>(primitives, i, epsilon)).collect::<Vec<_>>()
        });
        chunks.concat()
    }

    /// `1/(s₁s₂s₃)`, the determinant of the whitening matrix.
    pub(super) fn determinant(&self) -> f64 {
        self.inverse_scale.x * self.inverse_scale.y * self.inverse_scale.z
    }

    /// A bound on any projection of this primitive beyond its cutoff ε: |ρ| · line integral · largest scale · ε.
    pub(super) fn truncation_bound(&self, epsilon: f64) -> f64 {
        self.density.abs() * self.line.0 / self.inverse_scale.min_element() * epsilon
    }

    /// Gradient to mean, scale, quaternion, density and ν, written to row `i`.
    ///
    /// Rotating the body frame by a small ω changes Σ⁻¹ by `R([ω]Λ - Λ[ω])Rᵀ`, Λ = diag(1/s²): the torque of two axes
    /// carries the factor sⱼ/sᵢ - sᵢ/sⱼ and vanishes exactly where they are equal. The gradient to the quaternion
    /// is tangential by construction.
    fn finish(&self, gradient: &ShapeGradient, i: usize, out: &mut Parameters) {
        out.mean[i] = gradient.mean.to_array();
        out.density[i] = gradient.density;
        out.nu[i] = gradient.nu;
        let d = gradient.precision;
        let inverse = self.inverse_scale;
        out.scale[i] = [0, 1, 2].map(|k| -2.0 * inverse[k] * d.col(k)[k]);
        let torque = |a: usize, b: usize| 2.0 * d.col(b)[a] * (inverse[a] / inverse[b] - inverse[b] / inverse[a]);
        let q = self.rotation * DQuat::from_xyzw(torque(1, 2), torque(2, 0), torque(0, 1), 0.0);
        out.quaternion[i] = [q.w, q.x, q.y, q.z].map(|x| 2.0 * x / self.norm);
    }
}

/// [`Shape::finish`] for all primitives, in parallel.
pub(super) fn finish(shapes: &[Shape], gradients: &[ShapeGradient]) -> Parameters {
    let m = shapes.len();
    let parts = threads::map(m.div_ceil(CHUNK), |chunk| {
        let range = chunk * CHUNK..((chunk + 1) * CHUNK).min(m);
        let mut part = Parameters::zeros(range.len());
        for (row, i) in range.enumerate() {
            shapes[i].finish(&gradients[i], row, &mut part);
        }
        part
    });
    let mut all = Parameters::default();
    for part in parts {
        all.mean.extend(part.mean);
        all.scale.extend(part.scale);
        all.quaternion.extend(part.quaternion);
        all.density.extend(part.density);
        all.nu.extend(part.nu);
    }
    all
}
