//! Everything a reconstruction can be told, with its default. TOML, one table per part; unknown keys are errors.
//!
//! A key is one field of one struct below: its doc comment is its documentation in every file that is written, its
//! `default` attribute its default. A key also needs its range in `validate`, which a test asks for; a new table
//! needs a row in `text::TABLES`, which another test asks for.

mod text;
mod validate;

use crate::projector::Projection;
use documented::{Documented, DocumentedFields};
use serde::{Deserialize, Serialize};
use smart_default::SmartDefault;

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

/// How a volume is reconstructed.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, SmartDefault, Documented, DocumentedFields)]
#[serde(deny_unknown_fields, default)]
pub struct Config {
    /// How the volume is found: tr-gs or fdk.
    #[default(Method::TrGs)]
    pub method: Method,
    /// Training steps, one view each.
    #[default = 5000]
    pub iterations: usize,
    /// All random choices follow from it.
    #[default = 0]
    pub seed: u64,
    /// Arithmetic of the pixel kernels: f32 or f64.
    #[default(Precision::F32)]
    pub precision: Precision,
    /// Rays through a primitive in a cone beam: exact, or affine as in the paper.
    #[default(Projection::Exact)]
    pub projection: Projection,
    /// A primitive ends where its projection has fallen to this fraction of its peak; 0: nowhere.
    #[default = 1e-3]
    pub cutoff: f64,
    /// Iterations between two reports.
    #[default = 100]
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
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, SmartDefault, Documented, DocumentedFields)]
#[serde(deny_unknown_fields, default)]
pub struct ModelConfig {
    /// Profile of the primitives: student-t or gaussian.
    #[default(KernelName::StudentT)]
    pub kernel: KernelName,
    /// Primitives at the start.
    #[default = 5000]
    pub points: usize,
    /// Lower end of the degrees of freedom.
    #[default = 2.0]
    pub nu_min: f64,
    /// Upper end of the degrees of freedom.
    #[default = 100.0]
    pub nu_max: f64,
    /// Degrees of freedom at the start.
    #[default = 10.0]
    pub nu_initial: f64,
    /// Smallest scale, as a fraction of the volume's longest side.
    #[default = 0.0005]
    pub scale_min: f64,
    /// Largest scale, as a fraction of the volume's longest side.
    #[default = 0.5]
    pub scale_max: f64,
}

/// Where the primitives start.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, SmartDefault, Documented, DocumentedFields)]
#[serde(deny_unknown_fields, default)]
pub struct InitialisationConfig {
    /// fdk, dataset (its init_*.npy) or random.
    #[default(Start::Fdk)]
    pub from: Start,
    /// Voxels of the first reconstruction above this density can carry a primitive.
    #[default = 0.05]
    pub threshold: f64,
    /// Measured density → density of the primitive, which overlaps its neighbours.
    #[default = 0.15]
    pub density_factor: f64,
}

/// What is minimised: `L1 + d_ssim·(1-SSIM)` of a projection `+ tv·TV` of a block of the volume.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, SmartDefault, Documented, DocumentedFields)]
#[serde(deny_unknown_fields, default)]
pub struct LossConfig {
    /// Weight of 1-SSIM of the projection.
    #[default = 0.25]
    pub d_ssim: f64,
    /// Weight of the total variation of the block; 0 leaves it out.
    #[default = 0.05]
    pub tv: f64,
    /// Side of the block in voxels.
    #[default = 32]
    pub tv_block: usize,
}

/// How it is minimised. Learning rates fall exponentially from the first number to the second over the run.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, SmartDefault, Documented, DocumentedFields)]
#[serde(deny_unknown_fields, default)]
pub struct OptimiserConfig {
    /// How positions move: adam.
    #[default(PositionOptimiser::Adam)]
    pub position: PositionOptimiser,
    /// Learning rate of means, scene units.
    #[default([2e-4, 2e-5])]
    pub mean: [f64; 2],
    /// Learning rate of raw scales.
    #[default([5e-3, 5e-4])]
    pub scale: [f64; 2],
    /// Learning rate of quaternions.
    #[default([1e-3, 1e-4])]
    pub quaternion: [f64; 2],
    /// Learning rate of raw densities.
    #[default([1e-2, 1e-3])]
    pub density: [f64; 2],
    /// Learning rate of raw degrees of freedom; [0, 0] keeps them.
    #[default([1e-2, 1e-3])]
    pub nu: [f64; 2],
    /// Adam's decay of the first and the second moment.
    #[default([0.9, 0.999])]
    pub beta: [f64; 2],
    /// Adam's guard against division by zero.
    #[default = 1e-15]
    pub epsilon: f64,
}

/// How primitives come and go.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, SmartDefault, Documented, DocumentedFields)]
#[serde(deny_unknown_fields, default)]
pub struct DensityControlConfig {
    /// none: the initial primitives stay.
    #[default(DensityControl::None)]
    pub method: DensityControl,
}
