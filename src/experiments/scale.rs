//! The paper's experiments at another size: how all settings scale.

use crate::config::{Auto, Config, DensityControl, Finish, Sampling, Start};
use crate::numeric::elementary::pow;

/// Voxels along a side of the paper's volumes.
const PAPER_SIZE: f64 = 256.0;
/// Smallest scale of a primitive in R²-Gaussian, as a fraction of the volume's longest side.
const PAPER_SMALLEST_SCALE: f64 = 0.0005;
/// Weight of the total variation in R²-Gaussian.
const PAPER_TOTAL_VARIATION: f64 = 0.05;
/// Initial number of primitives in the paper.
const PAPER_POINTS: f64 = 50_000.0;
/// Training iterations in the paper.
const PAPER_ITERATIONS: f64 = 30_000.0;

/// Experiments on volumes of `size`³ voxels.
///
/// | quantity | at 256 | at a size of N |
/// |---|---|---|
/// | detector | 512² | (2N)² |
/// | primitives at the start | 50,000 | 50,000 (N/256)² |
/// | most primitives | 100,000 | 100,000 (N/256)²; with ADC, which ends above its cap, the cap is four fifths of it |
/// | iterations n | 30,000 | 30,000 (N/256)^8/3 |
/// | iterations between two steps of density control | 100 | n/60, at most 100 |
/// | iterations between two computations of confidence | 500 | n/12, at most 500 |
/// | wavelet block, block of the total variation | 32³ | at most (N/4)³ |
/// | passes of a voxel method | its own | its own |
/// | test views | 50 | 50 (N/256), at least 8 |
/// | density that counts as 1 | 1 | 1: densities of the paper's scans are from 0 to about 1 |
///
/// Primitives cover surfaces, so their number scales with N². Iterations fall faster than that, which keeps a cell at
/// 64³ under half a minute of one core. Settings stated as fractions are unchanged, and learning rates follow the
/// number of iterations ([`pace`](crate::optim::schedule::pace)).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Scale {
    /// Voxels along the longest side.
    pub size: usize,
}

impl Scale {
    /// Pixels along each side of the detector.
    pub fn detector(self) -> usize {
        2 * self.size
    }

    /// Number of test views.
    pub fn test_views(self) -> usize {
        (50 * self.size).div_ceil(256).max(8)
    }

    /// Scales the settings of a method to the size.
    pub fn apply(self, config: &mut Config) {
        config.density_unit = Auto::Fixed(1.0);
        if !config.method.fits_primitives() {
            return;
        }
        let ratio = self.size as f64 / PAPER_SIZE;
        let scaled = |paper: f64, power: f64| ((paper * pow(ratio, power)).round() as usize).max(1);
        config.model.points = scaled(PAPER_POINTS, 2.0);
        config.density_control.cap = match config.density_control.method {
            // ADC's last step exceeds its cap; this gives about as many primitives as the other methods.
            DensityControl::Adc => config.model.points * 8 / 5,
            DensityControl::Ar | DensityControl::None => 2 * config.model.points,
        };
        config.iterations = scaled(PAPER_ITERATIONS, 8.0 / 3.0);
        config.density_control.every = (config.iterations / 60).clamp(1, 100);
        config.confidence.every = (config.iterations / 12).clamp(1, 500);
        config.checkpoint_every = config.iterations;
        // As in the paper and R²-Gaussian, for all scans.
        (config.sampling, config.finish) = (Sampling::Point, Finish::None);
        if config.initialisation.from == Start::Sart {
            config.initialisation.from = Start::Fdk;
        }
        // R²-Gaussian's fraction of the side and weight, at any size.
        config.model.smallest_scale = PAPER_SMALLEST_SCALE * self.size as f64;
        config.loss.tv = PAPER_TOTAL_VARIATION.into();
        config.report_every = config.iterations;
        let block = (self.size / 4).clamp(4, 32) & !1;
        (config.wavelet.block, config.loss.tv_block) = (block, block);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::Method;

    #[test]
    fn the_papers_size_is_the_papers() {
        let mut config = Config::of(Method::TrGs);
        let paper = Scale { size: 256 };
        paper.apply(&mut config);
        assert_eq!((config.model.points, config.iterations, config.wavelet.block), (50_000, 30_000, 32));
        assert_eq!((paper.detector(), paper.test_views()), (512, 50));
        assert_eq!((config.density_control.every, config.confidence.every), (100, 500));
        assert_eq!(crate::optim::schedule::pace(config.optimiser.horizon, config.iterations), 1.0);
    }

    #[test]
    fn smaller_is_less_of_everything_and_still_valid() {
        for method in [Method::TrGs, Method::R2Gaussian, Method::Fdk, Method::Sart] {
            for size in [8, 16, 32, 64, 128] {
                let (mut small, mut large) = (Config::of(method), Config::of(method));
                Scale { size }.apply(&mut small);
                Scale { size: 2 * size }.apply(&mut large);
                small.validate().unwrap();
                let less = small.iterations < large.iterations && small.model.points < large.model.points;
                assert_eq!(less, method.fits_primitives(), "{method:?} {size}");
            }
        }
    }
}
