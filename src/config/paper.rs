//! The paper's method: the one place that defines it, at any size of the volume.
//!
//! Every choice has a row with its source in reference/paper/method.md. N is the side of a cube with as many voxels as the
//! volume.

use super::auto::fill;
use super::{Auto, Config, DensityControl, Finish, Rules, Sampling, Start};
use crate::density::Relocation;
use crate::numeric::elementary::pow;
use crate::projector::Projection;

/// Voxels along a side of the paper's volumes.
pub(super) const SIDE: f64 = 256.0;
/// R²-Gaussian's gradient from which a primitive is cloned or split.
pub(super) const GRADIENT: f64 = 5e-5;
/// Training iterations at that size.
const ITERATIONS: f64 = 30_000.0;
/// Primitives at the start and at most, there; primitives beyond which R²-Gaussian's density control adds none.
const POPULATIONS: [f64; 3] = [50_000.0, 100_000.0, 500_000.0];
/// R²-Gaussian's weight of the total variation there: the mean difference of neighbours is in proportion to the voxel.
pub(super) const TOTAL_VARIATION: f64 = 0.05;
/// Weight of the pull on ν.
const PULL: f64 = 1e-4;
/// Voxels along a side of the blocks, and iterations between two wavelet blocks there.
pub(super) const BLOCK: usize = 32;
const WAVELET_EVERY: f64 = 10.0;
/// Smallest scale of a primitive, voxels: a 2,000th of the side.
const SMALLEST_SCALE: f64 = 0.128;

impl Config {
    /// Sets what does not depend on the size, and leaves the rest to [`Rules::Paper`].
    pub(super) fn use_paper(&mut self) {
        self.rules = Rules::Paper;
        self.projection = Projection::Affine;
        self.density_unit = Auto::Fixed(1.0);
        (self.initialisation.from, self.sampling, self.finish) = (Start::Fdk, Sampling::Point, Finish::None);
        self.optimiser.longest = ITERATIONS as usize;
        self.model.smallest_scale = SMALLEST_SCALE;
        self.loss.blocks_move = false;
        self.confidence.weight = PULL;
        let control = &mut self.density_control;
        (control.relocation, control.dead, control.spread) = (Relocation::Sss, 0.005, 0.0);
        control.reset_parents = true;
        (self.sghmc.burn_in_friction, self.sghmc.friction) = (5e5, 100.0);
    }

    /// Fills in what depends on the side of the volume in voxels.
    pub(super) fn fill_as_in_the_paper(&mut self, side: f64) {
        let ratio = side / SIDE;
        let surface = |number: f64| ((number * ratio * ratio).round() as usize).max(4);
        let [points, most, most_adc] = POPULATIONS.map(surface);
        fill(&mut self.iterations, ((ITERATIONS * pow(ratio, 8.0 / 3.0)).round() as usize).max(1));
        fill(&mut self.model.points, points);
        let adaptive = self.density_control.method == DensityControl::Adc;
        fill(&mut self.density_control.cap, if adaptive { most_adc } else { most });
        // The part of a mean loss that a primitive has is the part of the detector that it covers.
        self.density_control.gradient = Auto::Fixed(self.density_control.gradient.or(GRADIENT / (ratio * ratio)));
        fill(&mut self.confidence.every, (self.iterations / 60).clamp(1, 500));
        let block = ((side / 4.0) as usize).clamp(4, BLOCK) & !1;
        fill(&mut self.loss.tv_block, block);
        self.loss.tv = Auto::Fixed(self.loss.tv.or(TOTAL_VARIATION * ratio));
        let whole = 1 << self.wavelet.levels;
        fill(&mut self.wavelet.block, (block / whole).max(1) * whole);
        // A voxel is in as many blocks as at 256³, from 64³ on: there is at most one block an iteration.
        let visits = |iterations: f64, block: usize, side: f64| iterations * pow(block as f64 / side, 3.0);
        let there = visits(ITERATIONS, BLOCK, SIDE) / WAVELET_EVERY;
        let every = visits(self.iterations as f64, self.wavelet.block, side) / there;
        fill(&mut self.wavelet.every, (every.round() as usize).max(1));
    }
}

#[cfg(test)]
mod tests {
    use crate::config::{Auto, Config, Method, Preset};
    use crate::geometry::Scanner;

    fn plan(method: Method, size: usize) -> crate::config::Plan {
        let mut config = Config::of(method);
        config.apply(Preset::Paper);
        config.plan(&Scanner::synthetic(size, size), 18).unwrap()
    }

    #[test]
    fn at_256_it_has_the_numbers_of_its_sources() {
        let paper = plan(Method::TrGs, 256);
        let control = &paper.density_control;
        assert_eq!((paper.iterations, paper.model.points, control.cap, control.every), (30_000, 50_000, 100_000, 100));
        assert_eq!((paper.wavelet.block, paper.wavelet.every, paper.loss.tv_block), (32, 10, 32));
        assert_eq!((paper.loss.tv, paper.confidence.every), (Auto::Fixed(0.05), 500));
        let pace = crate::optim::schedule::pace(paper.optimiser.horizon, paper.optimiser.longest, paper.iterations);
        assert_eq!(pace, 1.0);
        let r2 = plan(Method::R2Gaussian, 256);
        assert_eq!((r2.density_control.cap, r2.density_control.stop), (500_000, Auto::Fixed(0.5)));
        assert_eq!((r2.iterations, r2.model.points, r2.loss.tv), (30_000, 50_000, Auto::Fixed(0.05)));
        assert_eq!(r2.density_control.gradient, Auto::Fixed(5e-5));
    }

    #[test]
    fn lengths_and_counts_scale_with_the_volume() {
        let visits = |size: usize| {
            let plan = plan(Method::TrGs, size);
            let part = plan.wavelet.block as f64 / size as f64;
            (plan.iterations / plan.wavelet.every) as f64 * part * part * part
        };
        for size in [64, 128, 192] {
            let (small, large) = (plan(Method::TrGs, size), plan(Method::TrGs, 256));
            let surface = 256.0 * 256.0 / (size * size) as f64;
            let times = large.model.points as f64 / small.model.points as f64;
            within!("points", (times / surface - 1.0).abs(), "{size}: {times} {surface}");
            within!("visits", (visits(size) / visits(256) - 1.0).abs(), "{size}: {} {}", visits(size), visits(256));
            assert_eq!(small.model.smallest_scale, large.model.smallest_scale);
        }
    }

    #[test]
    fn blocks_have_whole_levels_at_any_size() {
        let mut config = Config::of(Method::TrGs);
        config.apply(Preset::Paper);
        config.set("wavelet.levels=3").unwrap();
        let block = |size| config.plan(&Scanner::synthetic(size, size), 18).unwrap().wavelet.block;
        assert_eq!([16, 48, 64, 256].map(block), [8, 8, 16, 32]);
    }

    #[test]
    fn a_method_on_voxels_has_its_own_settings() {
        let mut fdk = Config::of(Method::Fdk);
        fdk.apply(Preset::Paper);
        assert_eq!(fdk, Config::of(Method::Fdk));
    }
}
