//! Everything a reconstruction can be told, with its default. TOML, one table per part; unknown keys are errors.

use crate::projector::Projection;
use serde::{Deserialize, Serialize};

/// How the volume is found.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, clap::ValueEnum)]
#[serde(rename_all = "kebab-case")]
pub enum Method {
    /// Student's t-kernels, this project's subject.
    TrGs,
    /// Filtered back projection of a cone beam (Feldkamp, Davis, Kress).
    Fdk,
}

/// Arithmetic of the pixel kernels. Parameters and optimisers are always f64.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, clap::ValueEnum)]
#[serde(rename_all = "lowercase")]
pub enum Precision {
    /// Single.
    F32,
    /// Double.
    F64,
}

/// Where the primitives start.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Start {
    /// On bright voxels of an FDK reconstruction.
    Fdk,
    /// On the initial points that come with the dataset.
    Dataset,
    /// Anywhere in the volume.
    Random,
}

/// The profile of the primitives.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum KernelName {
    /// `(1+δ/ν)^(-(ν+3)/2)`.
    StudentT,
    /// `exp(-δ/2)`.
    Gaussian,
}

/// How positions move.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum PositionOptimiser {
    /// Like all other parameters.
    Adam,
}

/// How primitives come and go.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum DensityControl {
    /// The initial primitives stay.
    None,
}

/// The whole configuration.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Config {
    /// How the volume is found: tr-gs or fdk.
    pub method: Method,
    /// Training steps, one view each.
    pub iterations: usize,
    /// All random choices follow from it.
    pub seed: u64,
    /// Arithmetic of the pixel kernels: f32 or f64.
    pub precision: Precision,
    /// Rays through a primitive in a cone beam: exact, or affine as in the paper.
    pub projection: Projection,
    /// A primitive ends where its projection has fallen to this fraction of its peak; 0: nowhere.
    pub cutoff: f64,
    /// Iterations between two reports.
    pub report_every: usize,
    /// What is fitted.
    pub model: ModelConfig,
    /// Where it starts.
    pub initialisation: InitialisationConfig,
    /// What is minimised.
    pub loss: LossConfig,
    /// How it is minimised.
    pub optimiser: OptimiserConfig,
    /// How primitives come and go.
    pub density_control: DensityControlConfig,
}

/// What is fitted.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ModelConfig {
    /// Profile of the primitives: student-t or gaussian.
    pub kernel: KernelName,
    /// Primitives at the start.
    pub points: usize,
    /// Lower end of the degrees of freedom.
    pub nu_min: f64,
    /// Upper end of the degrees of freedom.
    pub nu_max: f64,
    /// Degrees of freedom at the start.
    pub nu_initial: f64,
    /// Smallest scale, as a fraction of the volume's longest side.
    pub scale_min: f64,
    /// Largest scale, as a fraction of the volume's longest side.
    pub scale_max: f64,
}

/// Where the primitives start.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct InitialisationConfig {
    /// fdk, dataset (its init_*.npy) or random.
    pub from: Start,
    /// Voxels of the first reconstruction above this density can carry a primitive.
    pub threshold: f64,
    /// Measured density → density of the primitive, which overlaps its neighbours.
    pub density_factor: f64,
}

/// What is minimised: `L1 + d_ssim·(1-SSIM)` of a projection `+ tv·TV` of a block of the volume.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct LossConfig {
    /// Weight of 1-SSIM of the projection.
    pub d_ssim: f64,
    /// Weight of the total variation of the block; 0 leaves it out.
    pub tv: f64,
    /// Side of the block in voxels.
    pub tv_block: usize,
}

/// How it is minimised. Learning rates fall exponentially from the first number to the second over the run.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct OptimiserConfig {
    /// How positions move: adam.
    pub position: PositionOptimiser,
    /// Learning rate of means, scene units.
    pub mean: [f64; 2],
    /// Learning rate of raw scales.
    pub scale: [f64; 2],
    /// Learning rate of quaternions.
    pub quaternion: [f64; 2],
    /// Learning rate of raw densities.
    pub density: [f64; 2],
    /// Learning rate of raw degrees of freedom; [0, 0] keeps them.
    pub nu: [f64; 2],
    /// Adam's decay of the first and the second moment.
    pub beta: [f64; 2],
    /// Adam's guard against division by zero.
    pub epsilon: f64,
}

/// How primitives come and go.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct DensityControlConfig {
    /// none: the initial primitives stay.
    pub method: DensityControl,
}

impl Default for Config {
    fn default() -> Self {
        Self {
            method: Method::TrGs,
            iterations: 5000,
            seed: 0,
            precision: Precision::F32,
            projection: Projection::Exact,
            cutoff: 1e-3,
            report_every: 100,
            model: ModelConfig::default(),
            initialisation: InitialisationConfig::default(),
            loss: LossConfig::default(),
            optimiser: OptimiserConfig::default(),
            density_control: DensityControlConfig::default(),
        }
    }
}

impl Default for ModelConfig {
    fn default() -> Self {
        Self {
            kernel: KernelName::StudentT,
            points: 5000,
            nu_min: 2.0,
            nu_max: 100.0,
            nu_initial: 10.0,
            scale_min: 0.0005,
            scale_max: 0.5,
        }
    }
}

impl Default for InitialisationConfig {
    fn default() -> Self {
        Self { from: Start::Fdk, threshold: 0.05, density_factor: 0.15 }
    }
}

impl Default for LossConfig {
    fn default() -> Self {
        Self { d_ssim: 0.25, tv: 0.05, tv_block: 32 }
    }
}

impl Default for OptimiserConfig {
    fn default() -> Self {
        Self {
            position: PositionOptimiser::Adam,
            mean: [2e-4, 2e-5],
            scale: [5e-3, 5e-4],
            quaternion: [1e-3, 1e-4],
            density: [1e-2, 1e-3],
            nu: [1e-2, 1e-3],
            beta: [0.9, 0.999],
            epsilon: 1e-15,
        }
    }
}

impl Default for DensityControlConfig {
    fn default() -> Self {
        Self { method: DensityControl::None }
    }
}
