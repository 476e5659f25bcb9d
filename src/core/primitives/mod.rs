//! Primitives: M kernels, each with a mean, three scales, a rotation, a density and degrees of freedom.
//!
//! `f(x) = Σ ρᵢ Tᵢ(x)` `[Eq. 1]`, with `T = (1+δ/ν)^(-(ν+3)/2)` `[Eq. 2]` or its limit `exp(-δ/2)`,
//! `δ = (x-μ)ᵀΣ⁻¹(x-μ)` and `Σ = R diag(s²) Rᵀ` `[Eq. 3]`.

pub mod activation;
pub mod gaussian;
pub mod initialisation;
pub(crate) mod rotation;
pub mod student_t;

pub use activation::Activation;

use crate::error::{Error, Result};
use crate::numeric::threads;
use glam::{DMat3, DVec3};
use serde::{Deserialize, Serialize};

/// The profile shared by all primitives of a scene.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum KernelKind {
    /// `(1+δ/ν)^(-(ν+3)/2)`.
    StudentT,
    /// `exp(-δ/2)`; ν is infinite.
    Gaussian,
}

impl KernelKind {
    /// Its name in a configuration.
    pub fn key(self) -> &'static str {
        match self {
            Self::StudentT => "student-t",
            Self::Gaussian => "gaussian",
        }
    }
}

/// Twelve numbers per primitive, one array per group: parameters, gradients, or optimiser moments.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Parameters {
    /// Centre μ, scene units, `[M,3]`.
    pub mean: Vec<[f64; 3]>,
    /// Standard deviations s along the principal axes, scene units, `[M,3]`.
    pub scale: Vec<[f64; 3]>,
    /// Rotation (w,x,y,z) of any length; the largest entry has magnitude at least 1e-150, `[M,4]`.
    pub quaternion: Vec<[f64; 4]>,
    /// Density ρ at the centre, attenuation per scene unit, `[M]`.
    pub density: Vec<f64>,
    /// Degrees of freedom ν, `[M]`.
    pub nu: Vec<f64>,
}

/// A contiguous range of rows of [`Parameters`].
pub(crate) struct Rows<'a> {
    pub(crate) mean: &'a mut [[f64; 3]],
    pub(crate) scale: &'a mut [[f64; 3]],
    pub(crate) quaternion: &'a mut [[f64; 4]],
    pub(crate) density: &'a mut [f64],
    pub(crate) nu: &'a mut [f64],
}

/// Physical parameters and their kernel.
#[derive(Clone, Debug, PartialEq)]
pub struct Primitives {
    /// The profile.
    pub kernel: KernelKind,
    /// Physical values, not raw ones.
    pub parameters: Parameters,
}

/// The five groups of parameters, in the order of all files and logs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Group {
    /// μ
    Mean,
    /// s
    Scale,
    /// q
    Quaternion,
    /// ρ
    Density,
    /// ν
    Nu,
}

impl Group {
    /// All groups, in order.
    pub const ALL: [Self; 5] = [Self::Mean, Self::Scale, Self::Quaternion, Self::Density, Self::Nu];

    /// The key in MODEL.npz and GRAD.npz.
    pub fn key(self) -> &'static str {
        match self {
            Self::Mean => "mean",
            Self::Scale => "scale",
            Self::Quaternion => "quaternion",
            Self::Density => "density",
            Self::Nu => "nu",
        }
    }

    /// Numbers per primitive.
    pub fn width(self) -> usize {
        match self {
            Self::Mean | Self::Scale => 3,
            Self::Quaternion => 4,
            Self::Density | Self::Nu => 1,
        }
    }
}

impl Parameters {
    /// `m` primitives of zeros.
    pub fn zeros(m: usize) -> Self {
        let mut zeros = Self::default();
        zeros.resize(m);
        zeros
    }

    /// These rows, in this order.
    ///
    /// # Panics
    /// If there is no such row.
    #[must_use]
    pub fn select(&self, rows: &[usize]) -> Self {
        fn of<T: Copy>(values: &[T], rows: &[usize]) -> Vec<T> {
            rows.iter().map(|&row| values[row]).collect()
        }
        Self {
            mean: of(&self.mean, rows),
            scale: of(&self.scale, rows),
            quaternion: of(&self.quaternion, rows),
            density: of(&self.density, rows),
            nu: of(&self.nu, rows),
        }
    }

    /// Whether every quaternion has a direction.
    pub fn have_directions(&self) -> bool {
        self.quaternion.iter().all(|&q| rotation::is_usable(q))
    }

    /// Resizes to `m` primitives: existing rows stay, new ones are zeros.
    pub(crate) fn resize(&mut self, m: usize) {
        self.mean.resize(m, [0.0; 3]);
        self.scale.resize(m, [0.0; 3]);
        self.quaternion.resize(m, [0.0; 4]);
        self.density.resize(m, 0.0);
        self.nu.resize(m, 0.0);
    }

    /// Calls `f(chunk, rows)` in parallel, for chunks of `length` primitives (the last may be shorter).
    pub(crate) fn for_each_chunk(&mut self, length: usize, f: impl Fn(usize, Rows<'_>) + Sync + Send) {
        let Self { mean, scale, quaternion, density, nu } = self;
        let chunks = (
            threads::chunks(mean, length),
            threads::chunks(scale, length),
            threads::chunks(quaternion, length),
            threads::chunks(density, length),
            threads::chunks(nu, length),
        );
        threads::for_each_zip(chunks, |chunk, (mean, scale, quaternion, density, nu)| {
            f(chunk, Rows { mean, scale, quaternion, density, nu });
        });
    }

    /// Number of primitives.
    pub fn len(&self) -> usize {
        self.density.len()
    }

    /// Whether there is no primitive.
    pub fn is_empty(&self) -> bool {
        self.density.is_empty()
    }

    /// One group as a flat slice of `M·width` numbers.
    pub fn group(&self, group: Group) -> &[f64] {
        match group {
            Group::Mean => self.mean.as_flattened(),
            Group::Scale => self.scale.as_flattened(),
            Group::Quaternion => self.quaternion.as_flattened(),
            Group::Density => &self.density,
            Group::Nu => &self.nu,
        }
    }

    /// One group as a flat mutable slice.
    pub fn group_mut(&mut self, group: Group) -> &mut [f64] {
        match group {
            Group::Mean => self.mean.as_flattened_mut(),
            Group::Scale => self.scale.as_flattened_mut(),
            Group::Quaternion => self.quaternion.as_flattened_mut(),
            Group::Density => &mut self.density,
            Group::Nu => &mut self.nu,
        }
    }

    /// The covariance of primitive `i`, scene units squared: `Σ = R diag(s²) Rᵀ` `[Eq. 3]`.
    ///
    /// R is the rotation of its normalised quaternion. The matrix is exactly symmetric; an entry is within 1e-15 of the
    /// largest entry.
    ///
    /// Tests: `covariance_agrees_with_the_entries_of_a_rotation_written_out`, and against the projector's whitening.
    ///
    /// # Panics
    /// If there is no primitive `i`.
    pub fn covariance(&self, i: usize) -> DMat3 {
        let root = self.root(i);
        root * root.transpose()
    }

    /// The factor R·diag(s) of Σ of primitive `i`, scene units: Σ is its product with its transpose.
    ///
    /// Tests: those of [`Self::covariance`].
    ///
    /// # Panics
    /// If there is no primitive `i`.
    pub fn root(&self, i: usize) -> DMat3 {
        let (rotation, _) = rotation::unit(self.quaternion[i]);
        DMat3::from_quat(rotation) * DMat3::from_diagonal(DVec3::from_array(self.scale[i]))
    }

    /// Reports the first non-finite number as an error of the given stage.
    ///
    /// # Errors
    /// [`Error::NonFinite`] with the group's number, the primitive and the component as index.
    pub fn check_finite(&self, stage: &'static str, step: usize) -> Result<()> {
        for (number, group) in Group::ALL.into_iter().enumerate() {
            let values = self.group(group);
            // Without an early exit, so that the loop vectorises.
            let finite = values.iter().fold(true, |finite, value| finite & value.is_finite());
            if !finite && let Some(i) = values.iter().position(|value| !value.is_finite()) {
                let index = vec![number, i / group.width(), i % group.width()];
                return Err(Error::NonFinite { stage, value: values[i], index, step });
            }
        }
        Ok(())
    }
}

impl Primitives {
    /// Number of primitives.
    pub fn len(&self) -> usize {
        self.parameters.len()
    }

    /// Whether there is no primitive.
    pub fn is_empty(&self) -> bool {
        self.parameters.is_empty()
    }

    /// Checks primitives: equal lengths, finite numbers, positive scales and ν, usable quaternions.
    ///
    /// The kernel is Gaussian if every ν is infinite.
    ///
    /// # Errors
    /// An error for the first value that cannot be used.
    pub fn new(mut parameters: Parameters) -> Result<Self> {
        let m = parameters.len();
        for group in Group::ALL {
            let got = parameters.group(group).len() / group.width();
            if got != m {
                return Err(Error::invalid(
                    group.key(),
                    format!("{got} rows"),
                    format!("{m}, as many as densities"),
                    "give every array of the model one row per primitive",
                ));
            }
        }
        let infinite = parameters.nu.iter().filter(|nu| **nu == f64::INFINITY).count();
        let kernel = if m > 0 && infinite == m { KernelKind::Gaussian } else { KernelKind::StudentT };
        let bad = |what: &str, i: usize, got: &dyn std::fmt::Debug, expected: &str| {
            Err(Error::invalid(
                format!("{what} of primitive {i}"),
                format!("{got:?}"),
                expected,
                "correct the model file: it holds physical values, not raw ones",
            ))
        };
        for i in 0..m {
            let (mean, scale, q, nu) =
                (parameters.mean[i], parameters.scale[i], parameters.quaternion[i], parameters.nu[i]);
            if !mean.iter().all(|x| x.is_finite()) {
                return bad("mean", i, &mean, "finite coordinates");
            }
            if !scale.iter().all(|s| *s > 0.0 && s.is_finite()) {
                return bad("scale", i, &scale, "positive lengths");
            }
            if !rotation::is_usable(q) {
                let expected = format!("four finite numbers (w,x,y,z), not all below {:e}", rotation::SMALLEST);
                return bad("quaternion", i, &q, &expected);
            }
            if !parameters.density[i].is_finite() {
                return bad("density", i, &parameters.density[i], "a finite number");
            }
            if kernel == KernelKind::StudentT && !(nu > 0.0 && nu.is_finite()) {
                return bad(
                    "nu",
                    i,
                    &nu,
                    "a positive number (infinite only if it is for all: then the kernel is Gaussian)",
                );
            }
        }
        if kernel == KernelKind::Gaussian {
            parameters.nu.fill(f64::INFINITY);
        }
        Ok(Self { kernel, parameters })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tolerances::largest;

    fn one(scale: [f64; 3], quaternion: [f64; 4]) -> Parameters {
        Parameters { scale: vec![scale], quaternion: vec![quaternion], ..Parameters::zeros(1) }
    }

    #[test]
    fn covariance_agrees_with_the_entries_of_a_rotation_written_out() {
        // A turn by 2·atan(1/2) about z: cos = 3/5, sin = 4/5.
        let (c, s) = (0.6, 0.8);
        for length in [1e-100, 1.0, 1e150] {
            let covariance = one([0.2, 0.5, 3.0], [2.0, 0.0, 0.0, 1.0].map(|x| x * length)).covariance(0);
            let (a, b) = (0.04, 0.25);
            let expected = DMat3::from_cols_array_2d(&[
                [c * c * a + s * s * b, c * s * (a - b), 0.0],
                [c * s * (a - b), s * s * a + c * c * b, 0.0],
                [0.0, 0.0, 9.0],
            ]);
            within!(largest((covariance - expected).to_cols_array()), "{covariance}");
        }
    }

    #[test]
    fn covariance_is_symmetric_to_the_bit() {
        let covariance = one([0.01, 0.3, 7.0], [0.7, -0.3, 0.5, 0.2]).covariance(0);
        assert_eq!(covariance, covariance.transpose());
        assert!(covariance.determinant() > 0.0);
    }

    #[test]
    fn quaternions_of_any_length_are_accepted() {
        for (length, usable) in [(1e-151, false), (1e-149, true), (1e-100, true), (1e150, true), (1e308, true)] {
            let parameters = Parameters { nu: vec![3.0], ..one([0.1; 3], [0.0, length, 0.0, 0.0]) };
            assert_eq!(Primitives::new(parameters).is_ok(), usable, "{length:e}");
        }
    }
}
