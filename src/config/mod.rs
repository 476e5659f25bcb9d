//! Everything a reconstruction can be told, with its default. TOML, one table per part; unknown keys are errors.
//!
//! A key is one field of one struct below: its doc comment is its documentation in every file that is written, its
//! `default` attribute its default. A key also needs its range in `validate`, which a test asks for; a new table
//! needs a row in `text::TABLES`, which another test asks for.

mod auto;
mod methods;
mod parts;
mod plan;
mod text;
mod validate;

pub use auto::Auto;
pub use parts::{AlphaConfig, AlphaReading, NeuralConfig, NeuralOutput, VoxelPartner};

use crate::classical::algebraic::{AsdPocsSettings, Order, SartSettings, TvSettings};
use crate::classical::{RayModel, Turn, Window};
use crate::confidence::{self, Alpha};
use crate::density::Relocation;
use crate::neural::Kind;
use crate::primitives::KernelKind;
use crate::projector::Projection;
use crate::wavelet;
use documented::{Documented, DocumentedFields, DocumentedVariants};
use serde::{Deserialize, Serialize};
use smart_default::SmartDefault;

/// How the volume is found.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, DocumentedVariants)]
#[serde(rename_all = "kebab-case")]
pub enum Method {
    /// Student's t-kernels, this project's subject.
    TrGs,
    /// Gaussian kernels with the settings of R²-Gaussian, to compare with.
    R2Gaussian,
    /// Filtered back projection of a cone beam (Feldkamp, Davis, Kress).
    Fdk,
    /// Simultaneous algebraic reconstruction, view by view.
    Sart,
    /// The same by sets of views.
    OsSart,
    /// SART and descent of the total variation in turn.
    AsdPocs,
    /// Conjugate gradients on the normal equations.
    Cgls,
    /// Least squares without negative values, with total variation.
    Tv,
    /// A small network on a hash grid.
    Naf,
    /// The same with a Lineformer block.
    SaxNerf,
    /// A small network on sines and cosines, as in SAX-NeRF's toolbox.
    Intratomo,
}

/// Published settings to start from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, DocumentedVariants)]
#[serde(rename_all = "kebab-case")]
pub enum Preset {
    /// Those of R²-Gaussian's comparison, the defaults.
    R2Gaussian,
    /// Those of SAX-NeRF's comparison.
    SaxNerf,
    /// The paper's own experiment, with its open constants as its tables ask for.
    Paper,
}

/// Arithmetic of the pixel kernels. Parameters and optimisers are always f64.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, DocumentedVariants)]
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
    /// The same of that reconstruction smoothed.
    SmoothedFdk,
    /// On bright voxels after five passes of SART.
    Sart,
    /// On bright voxels of a reconstruction with total variation.
    Tv,
    /// On the initial points that come with the dataset.
    Dataset,
    /// As the primitives of a model file.
    Model,
    /// Anywhere in the volume.
    Random,
}

/// How the values of a volume are taken from a field of primitives.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Sampling {
    /// As views say that a pilot run holds out: see [`crate::reconstruction::Sampled`].
    Auto,
    /// The field at the voxel centres, the paper's and R²-Gaussian's.
    Point,
    /// So that the trilinear interpolation of the volume is the field: [`crate::scene::interpolant()`].
    Interpolant,
}

/// What is done to the volume of fitted primitives.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Finish {
    /// Nothing, as in the paper.
    None,
    /// A few steps of least squares with total variation on its voxels.
    Tv,
}

/// How positions move.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum PositionOptimiser {
    /// Like all other parameters.
    Adam,
    /// Stochastic gradient Hamiltonian Monte Carlo as 3D Student Splatting has it.
    Sghmc,
    /// The same in the textbook's form.
    SghmcTextbook,
}

/// How primitives come and go.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum DensityControl {
    /// The initial primitives stay.
    None,
    /// Adaptive density control, R²-Gaussian's.
    Adc,
    /// Adding and recycling.
    Ar,
}

/// How a volume is reconstructed.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, SmartDefault, Documented, DocumentedFields)]
#[serde(deny_unknown_fields, default)]
pub struct Config {
    /// How the volume is found.
    #[default(Method::TrGs)]
    pub method: Method,
    /// Training steps, one view each; 0: 140 a view.
    #[default = 0]
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
    /// How volume.npy is sampled from the primitives: auto (the pilot run decides), point (at voxel centres, as in the paper) or interpolant.
    #[default(Sampling::Auto)]
    pub sampling: Sampling,
    /// What is done to the volume of the primitives: tv (iterations of the method tv on its voxels), or none, as in the paper.
    #[default(Finish::Tv)]
    pub finish: Finish,
    /// Attenuation per scene unit that counts as 1 inside a run on primitives, of asd-pocs or of a network; auto: from the projections.
    pub density_unit: Auto<f64>,
    /// Iterations between two reports.
    #[default = 100]
    pub report_every: usize,
    /// Iterations between two checkpoints.
    #[default = 500]
    pub checkpoint_every: usize,
    /// What is fitted.
    pub model: ModelConfig,
    /// Where it starts.
    pub initialisation: InitialisationConfig,
    /// What is minimised.
    pub loss: LossConfig,
    /// How well the rays around a primitive cover its directions, and what that says about its tails.
    pub confidence: ConfidenceConfig,
    /// Which details of the volume are sharpened and which are smoothed.
    pub wavelet: WaveletConfig,
    /// How it is minimised.
    pub optimiser: OptimiserConfig,
    /// How positions are stirred.
    pub sghmc: SghmcConfig,
    /// How primitives come and go.
    pub density_control: DensityControlConfig,
    /// Filtered back projection.
    pub fdk: FdkConfig,
    /// The methods sart, os-sart, asd-pocs and cgls.
    pub algebraic: AlgebraicConfig,
    /// What asd-pocs does beside SART.
    pub asd_pocs: AsdPocsConfig,
    /// Least squares without negative values, with total variation.
    pub tv: TvConfig,
    /// The methods naf, sax-nerf and intratomo.
    pub neural: NeuralConfig,
}

/// What is fitted.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, SmartDefault, Documented, DocumentedFields)]
#[serde(deny_unknown_fields, default)]
pub struct ModelConfig {
    /// Profile of the primitives: student-t or gaussian.
    #[default(KernelKind::StudentT)]
    pub kernel: KernelKind,
    /// Primitives at the start; 0: as the volume's surface, ¾ of (voxels)^⅔.
    #[default = 0]
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
    /// Smallest scale, in voxels. The default is the standard deviation of the linear interpolation between voxel centres.
    #[default = 0.408]
    pub smallest_scale: f64,
    /// Largest scale, as a fraction of the volume's longest side.
    #[default = 0.5]
    pub scale_max: f64,
}

/// Where the primitives start.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, SmartDefault, Documented, DocumentedFields)]
#[serde(deny_unknown_fields, default)]
pub struct InitialisationConfig {
    /// sart, tv, fdk, smoothed-fdk, dataset (its init_*.npy), random, or model (the primitives of a file).
    #[default(Start::Sart)]
    pub from: Start,
    /// Voxels of the first reconstruction above this density, in units of density_unit, can carry a primitive.
    #[default = 0.05]
    pub threshold: f64,
    /// Measured density → density of the primitive, which overlaps its neighbours.
    #[default = 0.15]
    pub density_factor: f64,
    /// smoothed-fdk: standard deviation of the smoothing, voxels.
    #[default = 1.0]
    pub smoothing: f64,
    /// model: the MODEL.npz whose primitives, in scene units, the run starts from; their number is model.points.
    pub model: String,
}

/// What is minimised: `L1 + d_ssim·(1-SSIM)` of a projection `+ tv·TV` of a block of the volume.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, SmartDefault, Documented, DocumentedFields)]
#[serde(deny_unknown_fields, default)]
pub struct LossConfig {
    /// Weight of 1-SSIM of the projection.
    #[default = 0.25]
    pub d_ssim: f64,
    /// Weight of the total variation of the block; 0 leaves it out. auto: 0.05 n/256 for a volume of n³ voxels.
    #[default(Auto::Auto)]
    pub tv: Auto<f64>,
    /// Side of the block in voxels.
    #[default = 32]
    pub tv_block: usize,
    /// Whether losses on blocks of the volume, total variation and wavelets, move centres.
    #[default = true]
    pub blocks_move: bool,
}

/// How well the rays around a primitive cover its directions (confidence c), and what that says about its tails.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, SmartDefault, Documented, DocumentedFields)]
#[serde(deny_unknown_fields, default)]
pub struct ConfidenceConfig {
    /// Whether c pulls the degrees of freedom; the routing of wavelet details uses c in any case.
    #[default = true]
    pub enabled: bool,
    /// Weight λ of the pull.
    #[default = 1e-4]
    pub weight: f64,
    /// T: the lower, the steeper degrees of freedom rise with c.
    #[default(confidence::Settings::default().temperature)]
    pub temperature: f64,
    /// Points on the unit sphere.
    #[default(confidence::Settings::default().sphere_points)]
    pub sphere_points: usize,
    /// α: the length that a primitive's extent along a ray is compared with. `own`: the geometric mean of its scales, `median`:
    /// the median of these means over all primitives, a number: so many sides of a voxel.
    #[default(AlphaConfig::Reading(AlphaReading::Own))]
    pub alpha: AlphaConfig,
    /// Radius that a ray covers at most, in units of the sphere's.
    #[default(confidence::Settings::default().r_max)]
    pub r_max: f64,
    /// Ratio of α to the extent along the ray at which that radius is reached.
    #[default(confidence::Settings::default().kappa)]
    pub kappa: f64,
    /// Iterations between two computations of c; what density control adds has its own at once. 0: a twelfth of the run.
    #[default = 0]
    pub every: usize,
}

/// Which details of the volume are sharpened (near confident primitives) and which are smoothed.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, SmartDefault, Documented, DocumentedFields)]
#[serde(deny_unknown_fields, default)]
pub struct WaveletConfig {
    /// Whether they are.
    #[default = true]
    pub enabled: bool,
    /// Iterations between two blocks.
    #[default = 10]
    pub every: usize,
    /// Side of the block in voxels.
    #[default = 32]
    pub block: usize,
    /// Levels of the Haar transform.
    #[default(wavelet::Settings::default().levels)]
    pub levels: usize,
    /// K: nearest primitives that are asked for their confidence.
    #[default(wavelet::Settings::default().neighbours)]
    pub neighbours: usize,
    /// τ: confidence from which a primitive counts as confident.
    #[default(wavelet::Settings::default().threshold)]
    pub threshold: f64,
    /// η: factor on the details near confident primitives.
    #[default(wavelet::Settings::default().enhancement)]
    pub enhancement: f64,
    /// Weight of smoothing.
    #[default(wavelet::Settings::default().suppress)]
    pub suppress: f64,
    /// Weight of sharpening.
    #[default(wavelet::Settings::default().enhance)]
    pub enhance: f64,
}

/// How it is minimised. Learning rates fall exponentially over a run; they and frictions are stated for `horizon` iterations.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, SmartDefault, Documented, DocumentedFields)]
#[serde(deny_unknown_fields, default)]
pub struct OptimiserConfig {
    /// How positions move: sghmc, sghmc-textbook or adam.
    #[default(PositionOptimiser::Sghmc)]
    pub position: PositionOptimiser,
    /// Iterations that learning rates are stated for: n make them (horizon/n)^¾ times as large, up to 64 times.
    #[default = 30_000]
    pub horizon: usize,
    /// Iterations beyond which learning rates fall as 1/n: their sum stays, so longer runs do not fit the noise more closely.
    #[default = 5000]
    pub longest: usize,
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

/// How positions are stirred where optimiser.position is sghmc. Its step is the root of the learning rate of means.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, SmartDefault, Documented, DocumentedFields)]
#[serde(deny_unknown_fields, default)]
pub struct SghmcConfig {
    /// Part of the run without momentum at the start.
    #[default(7.0 / 30.0)]
    pub burn_in: f64,
    /// C of the burn-in, which scales its noise.
    #[default = 50.0]
    pub burn_in_friction: f64,
    /// C afterwards: friction and noise.
    #[default = 50.0]
    pub friction: f64,
    /// Density (of density_unit) at which a primitive counts as fully there; below a hundredth of it one is stirred.
    #[default = 0.1]
    pub density_reference: f64,
    /// Of sghmc-textbook: the loss is divided by it to be an energy.
    #[default = 1e-6]
    pub temperature: f64,
}

/// How primitives come and go.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, SmartDefault, Documented, DocumentedFields)]
#[serde(deny_unknown_fields, default)]
pub struct DensityControlConfig {
    /// ar: adding and recycling; adc: adaptive density control; none: the initial primitives stay.
    #[default(DensityControl::Ar)]
    pub method: DensityControl,
    /// Part of the run before it begins.
    #[default(1.0 / 60.0)]
    pub start: f64,
    /// Part of the run after which it ends.
    #[default(25.0 / 30.0)]
    pub stop: f64,
    /// Iterations between two steps; 0: a sixtieth of the run, at most 100.
    #[default = 0]
    pub every: usize,
    /// Number of primitives that it does not lead beyond; adc may do so by one step. 0: 2 (voxels)^⅔, a primitive for 8 rays at most.
    #[default = 0]
    pub cap: usize,
    /// ar: density below which a primitive is dead, in units of density_unit.
    #[default = 5e-4]
    pub dead: f64,
    /// ar: largest fraction of all that is recycled in one step.
    #[default = 0.05]
    pub recycled: f64,
    /// ar: fraction by which the population grows in one step.
    #[default = 0.05]
    pub growth: f64,
    /// ar: how copies share. exact: field and projections stay; sss: as opacities; sss-program: as its program has it.
    #[default(Relocation::Exact)]
    pub relocation: Relocation,
    /// ar: how far apart copies start, in standard deviations of the primitive; 0: at one place, where nothing changes.
    #[default = 1.0]
    pub spread: f64,
    /// adc: mean length of the gradient to a primitive's shadow, in halves of the detector, from which it is multiplied.
    #[default = 5e-5]
    pub gradient: f64,
    /// adc: largest scale that is cloned and not split, as a fraction of the volume's longest side.
    #[default = 0.1]
    pub split_scale: f64,
    /// adc: density below which a primitive is removed, in units of density_unit.
    #[default = 1e-5]
    pub faint: f64,
}

/// Filtered back projection.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, SmartDefault, Documented, DocumentedFields)]
#[serde(deny_unknown_fields, default)]
pub struct FdkConfig {
    /// Damping of the ramp filter: ram-lak (none), shepp-logan, cosine, hamming or hann.
    pub window: Window,
    /// What the views cover: measured (their angles tell; too little is refused), or full, whatever is missing.
    pub turn: Turn,
}

/// The methods sart, os-sart, asd-pocs and cgls.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, SmartDefault, Documented, DocumentedFields)]
#[serde(deny_unknown_fields, default)]
pub struct AlgebraicConfig {
    /// How a ray weighs voxels: joseph or siddon.
    pub rays: RayModel,
    /// λ of the first pass of SART.
    #[default(SartSettings::default().relaxation)]
    pub relaxation: f64,
    /// λ is multiplied with it after every pass.
    #[default(SartSettings::default().reduction)]
    pub reduction: f64,
    /// λ keeps its first value, as in TIGRE, which takes a reduction and does not use it.
    #[default(SartSettings::default().constant_relaxation)]
    pub constant_relaxation: bool,
    /// Views that correct the volume together.
    #[default(SartSettings::default().subset)]
    pub subset: usize,
    /// Order of the views: input, random or angular-distance.
    pub order: Order,
    /// Negative values become 0 after every correction; not in cgls.
    #[default(SartSettings::default().non_negative)]
    pub non_negative: bool,
    /// sart, os-sart and cgls find the number of passes on views held out; `iterations` is the most then.
    pub auto: bool,
    /// SART ends when a pass lowers the residual by less than this fraction; 0: not before its last.
    #[default(SartSettings::default().tolerance)]
    pub tolerance: f64,
}

/// What asd-pocs does beside SART.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, SmartDefault, Documented, DocumentedFields)]
#[serde(deny_unknown_fields, default)]
pub struct AsdPocsConfig {
    /// Steps down the total variation per iteration.
    #[default(AsdPocsSettings::default().tv_steps)]
    pub tv_steps: usize,
    /// The first step of the descent, as a fraction of SART's.
    #[default(AsdPocsSettings::default().alpha)]
    pub alpha: f64,
    /// Factor on it when the descent undoes too much of what SART did.
    #[default(AsdPocsSettings::default().alpha_reduction)]
    pub alpha_reduction: f64,
    /// The fraction of SART's step from which on that is too much.
    #[default(AsdPocsSettings::default().r_max)]
    pub r_max: f64,
    /// Residual that is good enough, as a fraction of that of FDK.
    #[default(AsdPocsSettings::default().epsilon)]
    pub epsilon: f64,
}

/// Least squares without negative values, with total variation: the method tv.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, SmartDefault, Documented, DocumentedFields)]
#[serde(deny_unknown_fields, default)]
pub struct TvConfig {
    /// Weight of the total variation, as a fraction of the largest backprojected value; auto: found on views held out.
    pub weight: Auto<f64>,
    /// It ends when a step is shorter than this fraction of the volume; 0: not before its last iteration.
    #[default(TvSettings::default().tolerance)]
    pub tolerance: f64,
    /// Steps of the total variation in each iteration.
    #[default(TvSettings::default().steps)]
    pub steps: usize,
    /// Iterations where finish = tv; auto: chosen with the weight on the pilot run, otherwise 10 to 20.
    pub finish_iterations: Auto<usize>,
    /// Whether a pilot run, half as long and without a sixth of the views, chooses what is auto of the sampling and the finish.
    #[default = true]
    pub pilot: bool,
}

impl ConfidenceConfig {
    /// What the confidence is computed with; the side of a voxel in scene units.
    pub fn settings(&self, voxel: f64) -> confidence::Settings {
        let Self { sphere_points, r_max, kappa, temperature, .. } = *self;
        let alpha = match self.alpha {
            AlphaConfig::Reading(AlphaReading::Own) => Alpha::Own,
            AlphaConfig::Reading(AlphaReading::Median) => Alpha::Median,
            AlphaConfig::Voxels(voxels) => Alpha::Length(voxels * voxel),
        };
        confidence::Settings { sphere_points, alpha, r_max, kappa, temperature }
    }
}

impl WaveletConfig {
    /// What the wavelet loss is computed with.
    pub fn settings(&self) -> wavelet::Settings {
        let Self { neighbours, threshold, enhancement, suppress, enhance, levels, .. } = *self;
        wavelet::Settings { neighbours, threshold, enhancement, suppress, enhance, levels }
    }
}

impl Method {
    /// All methods.
    pub const ALL: [Self; 11] = [
        Self::TrGs,
        Self::R2Gaussian,
        Self::Fdk,
        Self::Sart,
        Self::OsSart,
        Self::AsdPocs,
        Self::Cgls,
        Self::Tv,
        Self::Naf,
        Self::SaxNerf,
        Self::Intratomo,
    ];

    /// The network that it trains, if it does.
    pub fn network(self) -> Option<Kind> {
        match self {
            Self::Naf => Some(Kind::Naf),
            Self::SaxNerf => Some(Kind::SaxNerf),
            Self::Intratomo => Some(Kind::IntraTomo),
            _ => None,
        }
    }

    /// Whether it trains a network.
    pub fn is_network(self) -> bool {
        self.network().is_some()
    }

    /// Whether it fits primitives, and not voxels.
    pub fn fits_primitives(self) -> bool {
        matches!(self, Self::TrGs | Self::R2Gaussian)
    }
}

impl Preset {
    /// All presets.
    pub const ALL: [Self; 3] = [Self::R2Gaussian, Self::SaxNerf, Self::Paper];
}

impl Precision {
    /// Both precisions.
    pub const ALL: [Self; 2] = [Self::F32, Self::F64];
}
