//! Everything a reconstruction can be told, with its default. TOML, one table per part; unknown keys are errors.
//!
//! A key is one line of `tables`: type, default and range below its sentence, which is the comment in every file that is
//! written. What keys demand of each other is in `validate`; a new table needs a row in `text::TABLES`, which a test asks
//! for.

mod auto;
mod keys;
mod methods;
mod paper;
mod parts;
mod plan;
mod tables;
mod text;
mod validate;

pub use crate::numeric::Precision;
pub use auto::Auto;
pub use parts::{AlphaConfig, AlphaReading, NeuralOutput, VoxelPartner};
pub use plan::Plan;
pub use tables::{
    AlgebraicConfig, AsdPocsConfig, ConfidenceConfig, Config, DensityControlConfig, FdkConfig, InitialisationConfig,
    LossConfig, ModelConfig, NeuralConfig, OptimiserConfig, SghmcConfig, TvConfig, WaveletConfig,
};

use crate::confidence::{self, Alpha};
use crate::neural::Kind;
use crate::wavelet;
use serde::{Deserialize, Serialize};
use trgs_core::described;

described! {
    /// How the volume is found.
    #[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
    #[serde(rename_all = "kebab-case")]
    #[non_exhaustive]
    pub enum Method {
        /// Student's t-kernels; the settings of the paper are those of the preset paper.
        TrGs,
        /// Gaussian kernels with the settings of R²-Gaussian, to compare with.
        R2Gaussian,
        /// Filtered backprojection of a cone beam (Feldkamp, Davis, Kress).
        Fdk,
        /// Simultaneous algebraic reconstruction, view by view.
        Sart,
        /// SART by sets of views.
        OsSart,
        /// SART and descent of the total variation by turns.
        AsdPocs,
        /// Conjugate gradients on the normal equations.
        Cgls,
        /// Non-negative least squares with total variation.
        Tv,
        /// A small network on a hash grid.
        Naf,
        /// NAF with a Lineformer block.
        SaxNerf,
        /// A small network on sines and cosines, as in SAX-NeRF's toolbox.
        Intratomo,
    }
}

described! {
    /// Published settings to start from.
    #[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
    #[serde(rename_all = "kebab-case")]
    #[non_exhaustive]
    pub enum Preset {
        /// Those of R²-Gaussian's comparison, the defaults.
        R2Gaussian,
        /// Those of SAX-NeRF's comparison.
        SaxNerf,
        /// The paper's method, scaled with the volume; what it leaves open is as in the works that it follows.
        Paper,
    }
}

/// How keys that are 0 or auto follow from the scan.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Rules {
    /// Ours: [`Config::plan`].
    Trgs,
    /// The paper's numbers at 256³, scaled with the volume.
    Paper,
}

/// Where the primitives start.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Start {
    /// On bright voxels of an FDK reconstruction.
    Fdk,
    /// On bright voxels of an FDK reconstruction after a Gaussian filter.
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
    /// So that the trilinear interpolation of the volume is the field: [`crate::scan::interpolant()`].
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
    /// SGHMC in the textbook's form.
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
    /// The name in the literature.
    pub fn title(self) -> &'static str {
        match self {
            Self::TrGs => "TR-GS",
            Self::R2Gaussian => "R²-Gaussian",
            Self::Fdk => "FDK",
            Self::Sart => "SART",
            Self::OsSart => "OS-SART",
            Self::AsdPocs => "ASD-POCS",
            Self::Cgls => "CGLS",
            Self::Tv => "TV",
            Self::Naf => "NAF",
            Self::SaxNerf => "SAX-NeRF",
            Self::Intratomo => "IntraTomo",
        }
    }

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
