//! The paper's experiments at another size: how all settings scale.

use super::table::TableRow;
use crate::config::{Auto, Config, DensityControl, Finish, Sampling, Start};
use crate::numeric::elementary::pow;
use crate::scan::Noise;
use serde::{Deserialize, Serialize};
use std::fmt;

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

/// Primitives have so many parameters: mean, scales, quaternion, density, ν.
const PARAMETERS: f64 = 12.0;
/// Pixels along a side of the paper's detector.
const PAPER_DETECTOR: f64 = 512.0;

/// What stays as it is in the paper when the volume gets smaller.
///
/// A volume has fewer voxels by (N/256)³, but its surfaces by (N/256)² only, so both cannot stay.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Matching {
    /// Rays per voxel of a surface. There are more rays per voxel than in the paper: compare methods on primitives with
    /// each other.
    #[default]
    Edge,
    /// Rays per voxel, and rays per parameter. Compare methods on primitives with those on voxels.
    Ray,
}

impl fmt::Display for Matching {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Edge => "edge",
            Self::Ray => "ray",
        })
    }
}

/// Experiments on volumes of `size`³ voxels.
///
/// | quantity | at 256 | at a size of N, matched by edge | matched by ray |
/// |---|---|---|---|
/// | detector | 512² | (2N)², a ray through each pixel's centre | d² with d = 512 (N/256)^3/2, each pixel the mean of 2 × 2 rays |
/// | photons | 10⁵ | 10⁵ | 10⁵ N/256, and the electronic noise times the root of N/256 |
/// | primitives at the start | 50,000 | 50,000 (N/256)² | 50,000 (N/256)³ |
/// | most primitives | 100,000 | twice as many as at the start; with ADC, which ends above its cap, the cap is four fifths of it | the same |
///
/// And in both:
///
/// | quantity | at 256 | at a size of N |
/// |---|---|---|
/// | iterations n | 30,000 | 30,000 (N/256)^8/3 |
/// | iterations between two steps of density control | 100 | n/60, at most 100 |
/// | iterations between two computations of confidence | 500 | n/12, at most 500 |
/// | wavelet block, block of the total variation | 32³ | at most (N/4)³ |
/// | passes of a voxel method, steps of a network | its own | its own |
/// | test views | 50 | 50 (N/256), at least 8 |
/// | density that counts as 1 | 1 | 1: densities of the paper's scans are from 0 to about 1 |
///
/// Primitives cover surfaces, so their number scales with N², or with the pixels. Iterations fall faster than that, which keeps a cell at
/// 64³ under half a minute of one core. Settings stated as fractions are unchanged, and learning rates follow the
/// number of iterations ([`pace`](crate::optim::schedule::pace)).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Scale {
    /// Voxels along the longest side.
    pub size: usize,
    /// What stays as in the paper.
    pub matching: Matching,
}

impl Scale {
    fn ratio(self) -> f64 {
        self.size as f64 / PAPER_SIZE
    }

    /// Pixels along each side of the detector.
    pub fn detector(self) -> usize {
        match self.matching {
            Matching::Edge => 2 * self.size,
            Matching::Ray => (PAPER_DETECTOR * pow(self.ratio(), 1.5)).round() as usize,
        }
    }

    /// Rays along each side of a pixel, of whose line integrals it is the mean.
    pub fn rays_per_side(self) -> usize {
        match self.matching {
            Matching::Edge => 1,
            Matching::Ray => 2,
        }
    }

    /// A level of noise of the paper at this size.
    pub fn noise(self, paper: Noise) -> Noise {
        match self.matching {
            Matching::Edge => paper,
            Matching::Ray => paper.with_photons_times(self.ratio()),
        }
    }

    /// Primitives at the start.
    fn points(self) -> f64 {
        let power = if self.matching == Matching::Edge { 2.0 } else { 3.0 };
        (PAPER_POINTS * pow(self.ratio(), power)).round().max(4.0)
    }

    /// Pixels of all views over voxels, and over the parameters of the most primitives of a run.
    pub fn rays_per_voxel_and_parameter(self, views: usize) -> [f64; 2] {
        let rays = (views * self.detector() * self.detector()) as f64;
        [rays / pow(self.size as f64, 3.0), rays / (2.0 * self.points() * PARAMETERS)]
    }

    /// Number of test views.
    pub fn test_views(self) -> usize {
        (50 * self.size).div_ceil(256).max(8)
    }

    /// The configuration of a row at this size; `None` for a row that only the paper has.
    ///
    /// # Panics
    /// When a setting is invalid.
    pub(super) fn applied(self, row: &TableRow, settings: &[String]) -> Option<Config> {
        let mut config = row.config()?;
        self.apply(&mut config);
        let settings = settings.iter().filter(|_| config.method.fits_primitives());
        for setting in settings.chain(&row.set).cloned().collect::<Vec<_>>() {
            config.set(&setting).unwrap_or_else(|error| panic!("{}: {error}", row.name));
        }
        Some(config)
    }

    /// Scales the settings of a method to the size.
    pub fn apply(self, config: &mut Config) {
        config.density_unit = Auto::Fixed(1.0);
        if !config.method.fits_primitives() {
            return;
        }
        config.model.points = self.points() as usize;
        config.density_control.cap = match config.density_control.method {
            // ADC's last step exceeds its cap; this gives about as many primitives as the other methods.
            DensityControl::Adc => config.model.points * 8 / 5,
            DensityControl::Ar | DensityControl::None => 2 * config.model.points,
        };
        config.optimiser.longest = PAPER_ITERATIONS as usize;
        config.iterations = ((PAPER_ITERATIONS * pow(self.ratio(), 8.0 / 3.0)).round() as usize).max(1);
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
    use crate::config::{Method, Preset};
    use crate::projector::Projection;

    #[test]
    fn the_papers_size_is_the_papers() {
        let mut config = Config::of(Method::TrGs);
        for matching in [Matching::Edge, Matching::Ray] {
            let paper = Scale { size: 256, matching };
            paper.apply(&mut config);
            assert_eq!((config.model.points, config.iterations, config.wavelet.block), (50_000, 30_000, 32));
            assert_eq!((paper.detector(), paper.test_views()), (512, 50));
            assert_eq!((config.density_control.every, config.confidence.every), (100, 500));
            let optimiser = &config.optimiser;
            let pace = crate::optim::schedule::pace(optimiser.horizon, optimiser.longest, config.iterations);
            assert_eq!(pace, 1.0);
            assert_eq!(paper.noise(Noise::LOW), Noise::LOW);
        }
    }

    #[test]
    fn the_preset_of_the_paper_is_its_experiment_at_its_size() {
        for method in [Method::TrGs, Method::R2Gaussian] {
            let (mut preset, mut scaled) = (Config::of(method), Config::of(method));
            preset.apply(Preset::Paper);
            scaled.projection = Projection::Affine;
            Scale { size: 256, matching: Matching::Edge }.apply(&mut scaled);
            preset.validate().unwrap();
            // What the tables of the paper ask for, and intervals that follow from the length of the run.
            scaled.confidence = preset.confidence.clone();
            (preset.density_control.every, preset.report_every) = (100, 30_000);
            preset.checkpoint_every = 30_000;
            assert_eq!(preset, scaled);
        }
        let mut fdk = Config::of(Method::Fdk);
        fdk.apply(Preset::Paper);
        assert_eq!(fdk, Config::of(Method::Fdk));
    }

    #[test]
    fn what_is_matched_is_that_of_the_paper() {
        let paper = Scale { size: 256, matching: Matching::Edge };
        // 12 · 512² / 256³.
        assert_eq!(paper.rays_per_voxel_and_parameter(12)[0], 0.1875);
        let relative = |size: usize, matching: Matching| {
            let scaled = Scale { size, matching }.rays_per_voxel_and_parameter(18);
            let paper = paper.rays_per_voxel_and_parameter(18);
            [0, 1].map(|k| scaled[k] / paper[k])
        };
        // Detectors have whole pixels, and there are whole primitives.
        assert_eq!(relative(64, Matching::Edge), [4.0, 1.0]);
        for size in [16, 32, 64, 96, 128] {
            let ray = relative(size, Matching::Ray);
            within!((ray[0] - 1.0).abs().max((ray[1] - 1.0).abs()), "{size}: {ray:?}");
        }
        let ray = Scale { size: 64, matching: Matching::Ray };
        assert_eq!((ray.detector(), Scale { size: 128, ..ray }.detector()), (64, 181));
        assert_eq!(ray.noise(Noise::LOW), Noise::relative(25_000.0, 5.0));
        assert_eq!(
            (ray.noise(Noise::None), Scale { size: 64, matching: Matching::Edge }.noise(Noise::LOW)),
            (Noise::None, Noise::LOW)
        );
    }

    #[test]
    fn smaller_is_less_of_everything_and_still_valid() {
        for method in [Method::TrGs, Method::R2Gaussian, Method::Fdk, Method::Sart] {
            for (size, matching) in
                [8, 16, 32, 64, 128].into_iter().flat_map(|size| [(size, Matching::Edge), (size, Matching::Ray)])
            {
                let (mut small, mut large) = (Config::of(method), Config::of(method));
                Scale { size, matching }.apply(&mut small);
                Scale { size: 2 * size, matching }.apply(&mut large);
                small.validate().unwrap();
                let less = small.iterations < large.iterations && small.model.points < large.model.points;
                assert_eq!(less, method.fits_primitives(), "{method:?} {size}");
            }
        }
    }
}
