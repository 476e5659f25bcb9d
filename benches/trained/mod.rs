//! Primitives with the statistics of trained models.

use rand::RngExt;
use rand_distr::StandardNormal;
use trgs::geometry::{Beam, Detector, Grid, Scanner};
use trgs::numeric::rng::{Purpose, stream};
use trgs::primitives::{Parameters, Primitives};

/// Statistics of the primitives of a default run on the chest (`chest_fnndsc`, 18 views, low noise).
pub(crate) struct Trained {
    pub(crate) voxels: usize,
    pub(crate) pixels: usize,
    pub(crate) primitives: usize,
    /// Geometric mean of all scales, 7 % below the model's.
    ///
    /// With it, supports have as many pixels as the model's.
    scale: f64,
    /// Standard deviations of log scale: between primitives, and among the axes of a primitive.
    spread: [f64; 2],
    /// Minimum, 5, 25, 50, 75, 95 % quantiles and maximum of ν.
    nu: [f64; 7],
}

pub(crate) const TRAINED: [Trained; 2] = [
    Trained {
        voxels: 64,
        pixels: 128,
        primitives: 5_000,
        scale: 0.0488,
        spread: [0.28, 0.53],
        nu: [2.6, 5.1, 20.4, 32.0, 44.9, 66.6, 91.9],
    },
    Trained {
        voxels: 256,
        pixels: 512,
        primitives: 50_000,
        scale: 0.0219,
        spread: [0.39, 0.48],
        nu: [2.3, 7.5, 18.9, 35.8, 51.3, 69.6, 94.8],
    },
];

impl Trained {
    pub(crate) fn scanner(&self) -> Scanner {
        let pitch = 4.0 / self.pixels as f64;
        Scanner {
            beam: Beam::Cone { dso: 5.0, dsd: 7.0 },
            detector: Detector {
                rows: self.pixels,
                columns: self.pixels,
                pitch_v: pitch,
                pitch_u: pitch,
                offset_u: 0.0,
                offset_v: 0.0,
            },
            grid: Grid::cube(self.voxels),
        }
    }

    pub(crate) fn primitives(&self) -> Primitives {
        let mut random = stream(0, Purpose::Phantom, 0, 0);
        let mut parameters = Parameters::default();
        for i in 0..self.primitives {
            let mut normal = || random.sample::<f64, _>(StandardNormal);
            let size = self.scale * libm::exp(self.spread[0] * normal());
            parameters.scale.push([(); 3].map(|()| size * libm::exp(self.spread[1] * normal())));
            parameters.quaternion.push([(); 4].map(|()| normal()));
            parameters.mean.push([(); 3].map(|()| random.random_range(-0.85..0.85)));
            parameters.density.push(0.05 + 0.01 * (i % 11) as f64);
            parameters.nu.push(self.nu_at(random.random()));
        }
        Primitives::new(parameters).expect("valid primitives")
    }

    /// The quantile `part` of ν, from 0 to 1.
    fn nu_at(&self, part: f64) -> f64 {
        let parts = [0.0, 0.05, 0.25, 0.5, 0.75, 0.95, 1.0];
        let above = parts.iter().position(|&end| part < end).expect("a part below 1");
        let along = (part - parts[above - 1]) / (parts[above] - parts[above - 1]);
        self.nu[above - 1] + along * (self.nu[above] - self.nu[above - 1])
    }
}
