//! The defaults of each method, and what the parts of the library are told.

use super::{
    AsdPocsConfig, Config, DensityControl, Finish, Method, NeuralOutput, PositionOptimiser, Preset, TvConfig,
    VoxelPartner,
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
            self.use_paper();
        }
    }

    /// The settings of SART.
    pub fn sart(&self) -> SartSettings {
        let a = &self.algebraic;
        SartSettings {
            iterations: self.iterations,
            relaxation: a.relaxation,
            reduction: a.reduction,
            constant_relaxation: a.constant_relaxation,
            subset: a.subset,
            order: a.order,
            non_negative: a.non_negative,
            tolerance: a.tolerance,
            seed: self.seed,
        }
    }

    /// The settings of the reconstruction with total variation, with the default weight where that is to be found.
    pub fn tv(&self) -> TvSettings {
        let TvConfig { weight, tolerance, steps, .. } = self.tv;
        TvSettings { weight: weight.or(TvSettings::default().weight), iterations: self.iterations, tolerance, steps }
    }

    /// The settings of a network; keys must be resolved.
    ///
    /// # Panics
    /// When the method has none.
    pub fn neural(&self) -> NeuralSettings {
        let n = &self.neural;
        NeuralSettings {
            kind: self.method.network().expect("a method with a network"),
            iterations: self.iterations,
            levels: n.levels,
            table: n.table,
            samples: n.samples,
            rays: n.rays,
            sees_air: n.air,
            windows: n.windows,
            window: n.window,
            rate: [n.table_rate, n.network_rate],
            drop: n.drop.or(self.iterations),
            is_bounded: n.output == NeuralOutput::Sigmoid,
            ceiling: n.ceiling,
            pairs_neighbours: n.partner == VoxelPartner::Neighbour,
            seed: self.seed,
        }
    }

    /// The settings of ASD-POCS. Where `density_unit` is auto, the caller sets the unit, which depends on the scan.
    pub fn asd_pocs(&self) -> AsdPocsSettings {
        let AsdPocsConfig { tv_steps, alpha, alpha_reduction, r_max, epsilon } = self.asd_pocs;
        let unit = self.density_unit.or(1.0);
        AsdPocsSettings { sart: self.sart(), tv_steps, alpha, alpha_reduction, r_max, epsilon, unit }
    }
}
