//! The defaults of each method, and what the parts of the library are told.

use super::{
    AlgebraicConfig, AsdPocsConfig, Auto, Config, DensityControl, Finish, Method, NeuralConfig, NeuralOutput,
    PositionOptimiser, Preset, Sampling, Start, TvConfig, VoxelPartner,
};
use crate::classical::algebraic::{AsdPocsSettings, SartSettings, TvSettings};
use crate::neural::NeuralSettings;
use crate::primitives::KernelKind;
use crate::projector::Projection;

impl Config {
    /// The defaults of a method: [`Config::default`], and what the other methods have of their own.
    pub fn of(method: Method) -> Self {
        let mut config = Self { method, ..Self::default() };
        match method {
            Method::TrGs | Method::Fdk => {}
            Method::R2Gaussian => {
                config.finish = Finish::None;
                config.projection = Projection::Affine;
                config.model.kernel = KernelKind::Gaussian;
                config.confidence.enabled = false;
                config.wavelet.enabled = false;
                config.optimiser.position = PositionOptimiser::Adam;
                config.density_control.method = DensityControl::Adc;
                config.density_control.stop = 0.5;
            }
            Method::Sart | Method::Cgls => config.iterations = SartSettings::default().iterations,
            Method::OsSart => (config.iterations, config.algebraic.subset) = (SartSettings::default().iterations, 10),
            Method::AsdPocs => {
                let sart = AsdPocsSettings::default().sart;
                (config.iterations, config.algebraic.reduction) = (sart.iterations, sart.reduction);
            }
            Method::Tv => (config.iterations, config.checkpoint_every) = (TvSettings::default().iterations, 20),
            Method::Naf | Method::Intratomo => (config.iterations, config.checkpoint_every) = (1500, 250),
            Method::SaxNerf => {
                (config.iterations, config.checkpoint_every) = (1500, 250);
                (config.neural.rays, config.neural.windows, config.neural.network_rate) = (512, 32, 1e-3);
            }
        }
        config
    }

    /// Takes over the settings of another comparison; [`Preset::R2Gaussian`]'s are those of [`Config::of`].
    pub fn apply(&mut self, preset: Preset) {
        *self = Self { seed: self.seed, ..Self::of(self.method) };
        if preset == Preset::SaxNerf && matches!(self.method, Method::Sart | Method::OsSart | Method::AsdPocs) {
            self.iterations = 6;
            self.algebraic.reduction = 0.999;
            (self.asd_pocs.epsilon, self.asd_pocs.r_max) = (0.2, 0.95);
        }
        if preset == Preset::Paper && self.method.fits_primitives() {
            self.as_in_the_paper();
        }
    }

    /// The settings of the paper's experiment, for volumes of 256³.
    ///
    /// What the paper states, or takes over from R²-Gaussian without a word: numbers of iterations and primitives, start,
    /// affine projection, point samples, no finish, R²-Gaussian's smallest scale and weight of the total variation, densities
    /// as they are. It leaves the weight λ of the pull on ν open, which here is the one that its Table 5 asks for
    /// (reference/results/confidence.md).
    fn as_in_the_paper(&mut self) {
        self.projection = Projection::Affine;
        self.density_unit = Auto::Fixed(1.0);
        (self.iterations, self.optimiser.longest) = (30_000, 30_000);
        self.model.points = 50_000;
        self.density_control.cap = match self.density_control.method {
            // The last step of ADC exceeds its cap.
            DensityControl::Adc => 80_000,
            DensityControl::Ar | DensityControl::None => 100_000,
        };
        self.initialisation.from = Start::Fdk;
        (self.sampling, self.finish) = (Sampling::Point, Finish::None);
        self.model.smallest_scale = 0.128;
        self.loss.tv = Auto::Fixed(0.05);
        self.confidence.weight = 4e-4;
    }

    /// What SART is told.
    pub fn sart(&self) -> SartSettings {
        let AlgebraicConfig {
            relaxation, reduction, constant_relaxation, subset, order, non_negative, tolerance, ..
        } = self.algebraic;
        let (iterations, seed) = (self.iterations, self.seed);
        SartSettings {
            iterations,
            relaxation,
            reduction,
            constant_relaxation,
            subset,
            order,
            non_negative,
            tolerance,
            seed,
        }
    }

    /// What the reconstruction with total variation is told, with the default weight where that is to be found.
    pub fn tv(&self) -> TvSettings {
        let TvConfig { weight, tolerance, steps, .. } = self.tv;
        TvSettings { weight: weight.or(TvSettings::default().weight), iterations: self.iterations, tolerance, steps }
    }

    /// What a network is told; keys must be resolved.
    ///
    /// # Panics
    /// When the method has none.
    pub fn neural(&self) -> NeuralSettings {
        let NeuralConfig {
            levels,
            table,
            samples,
            rays,
            air,
            windows,
            window,
            table_rate,
            network_rate,
            drop,
            output,
            ceiling,
            partner,
        } = self.neural;
        let kind = self.method.network().expect("a method with a network");
        let (iterations, seed) = (self.iterations, self.seed);
        let is_bounded = output == NeuralOutput::Sigmoid;
        NeuralSettings {
            kind,
            iterations,
            levels,
            table,
            samples,
            rays,
            sees_air: air,
            windows,
            window,
            rate: [table_rate, network_rate],
            drop,
            is_bounded,
            ceiling,
            pairs_neighbours: partner == VoxelPartner::Neighbour,
            seed,
        }
    }

    /// What ASD-POCS is told. Where `density_unit` is auto, whoever knows the scan sets the unit.
    pub fn asd_pocs(&self) -> AsdPocsSettings {
        let AsdPocsConfig { tv_steps, alpha, alpha_reduction, r_max, epsilon } = self.asd_pocs;
        let unit = self.density_unit.or(1.0);
        AsdPocsSettings { sart: self.sart(), tv_steps, alpha, alpha_reduction, r_max, epsilon, unit }
    }
}
