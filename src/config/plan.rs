//! What follows from the scan: the one place where lengths of runs and sizes of populations are set.
//!
//! A key that is 0 is filled in before a run starts. n is the side of a cube with as many voxels as the volume. Lengths of
//! runs, populations, intervals and blocks are these with `rules = "trgs"`; `paper` has the others.
//!
//! | key | value | reason |
//! |---|---|---|
//! | `coarse` | 1; 2 from 256 voxels a side, 4 from 512 | the training needs minutes; primitives are longer than such voxels |
//! | `iterations` | 140 a training view, 1,000 to 5,000 | every view is seen as often, however many there are |
//! | `model.points` | ¾ n² | primitives lie on surfaces; 49,152 at 256³ |
//! | `density_control.cap` | 2 n², at most a primitive for 8 rays | the same; a primitive has 12 numbers |
//! | `density_control.every` | iterations/60, 1 to 100 | the population is at its cap after a third of any run |
//! | `confidence.every` | iterations/12, 1 to 500 | twelve times a run |
//! | `neural.levels` | the last has 4 n cells a side | finer ones are not seen by any ray |
//! | `neural.table` | n³ entries as a power of two, 2^14 to 2^19 | NAF's 2^19 is for 256³ |
//! | `neural.samples` | 1.5 n | NAF has 192 to 320 for 256³ |
//! | `neural.drop` | ⅔ of the steps | the last third refines, however long the run is |
//! | `density_control.stop` | 1/2 with adc, 5/6 with ar | R²-Gaussian's 15,000 and 3D Student Splatting's 25,000 of 30,000 |
//! | `loss.tv` | 0.1 n/256 | the mean difference of neighbours is in proportion to the voxel: twice R²'s weight for 256³ |
//!
//! Wavelets are left out where the volume has fewer than `2^wavelet.levels` voxels a side, as that of a single row has.
//! Lengths need no rule: they are stated in voxels. What was measured is in CHOICES.md.

use super::auto::fill;
use super::paper::{BLOCK, GRADIENT, SIDE, TOTAL_VARIATION};
use super::{Auto, Config, DensityControl, Finish, Method, Rules, Sampling, Start, TvConfig};
use crate::classical::RayModel;
use crate::classical::algebraic::Division;
use crate::error::Result;
use crate::geometry::Scanner;
use crate::numeric::elementary::{cbrt, pow};
use crate::scan::model;
use std::ops::Deref;
use std::path::Path;

/// Iterations for a training view, and their range.
const ITERATIONS_PER_VIEW: usize = 140;
const FEWEST_ITERATIONS: usize = 1000;
const MOST_ITERATIONS: usize = 5000;
/// Fewest primitives that a run starts from, and that its cap is.
const FEWEST_POINTS: usize = 64;
/// Voxels a side that the training sees at least, where there are as many.
const SEEN: usize = 128;
/// Rays for a primitive.
const RAYS: usize = 8;
/// Cells of the finest level of a hash grid along a voxel, and most doublings of anything.
const CELLS_PER_VOXEL: f64 = 4.0;
const LEVELS: u32 = 19;
/// Iterations between two wavelet blocks.
const WAVELET_EVERY: usize = 10;

/// A configuration of which every value is in its range, and every key that follows from the scan is filled in.
#[derive(Clone, Debug, PartialEq)]
pub struct Plan {
    config: Config,
    /// Of the volumes of total variation. No result depends on it.
    division: Division,
}

impl Deref for Plan {
    type Target = Config;

    fn deref(&self) -> &Config {
        &self.config
    }
}

impl Plan {
    /// Whether the volumes of total variation are whole or in slabs.
    pub fn division(&self) -> &Division {
        &self.division
    }

    /// The plan with so many slabs.
    #[must_use]
    pub(crate) fn in_slabs(&self, slabs: usize) -> Self {
        Self { division: Division { slabs, ..self.division.clone() }, ..self.clone() }
    }

    /// The plan with the files of slabs in a folder.
    #[must_use]
    pub fn with_files_in(&self, folder: &Path) -> Self {
        Self { division: Division { folder: folder.to_path_buf(), ..self.division.clone() }, ..self.clone() }
    }

    /// The plan with some other values, which must be in their ranges.
    #[must_use]
    pub(crate) fn changed(&self, change: impl FnOnce(&mut Config)) -> Self {
        let mut plan = self.clone();
        change(&mut plan.config);
        plan
    }
}

impl Config {
    /// What a run on a scan with so many training views does: the one place where a configuration is checked and completed.
    ///
    /// # Errors
    /// [`Error::Invalid`](crate::Error::Invalid) for the first value out of its range; when the run starts from a model that
    /// cannot be read.
    pub fn plan(&self, scanner: &Scanner, views: usize) -> Result<Plan> {
        self.validate()?;
        let mut config = self.clone();
        if config.method.fits_primitives() && config.initialisation.from == Start::Model && config.model.points == 0 {
            config.model.points = model::read(Path::new(&config.initialisation.model))?.len();
        }
        let division = Division { folder: std::env::temp_dir(), ..Division::whole() };
        Ok(Plan { config: config.resolved(scanner, views), division })
    }

    /// The configuration with every key that is 0 filled in for a scan with so many training views.
    #[must_use]
    fn resolved(&self, scanner: &Scanner, views: usize) -> Self {
        let (mut config, scanner) = (self.clone(), &self.with_margin(scanner));
        if config.method.is_network() {
            let side = cbrt(scanner.grid.voxels() as f64);
            let neural = &mut config.neural;
            let doublings = |number: f64| (0..LEVELS).find(|&k| f64::from(1_u32 << k) >= number).unwrap_or(LEVELS);
            fill(&mut neural.levels, 1 + doublings(CELLS_PER_VOXEL * side / 16.0) as usize);
            if neural.table == 0 {
                neural.table = doublings(scanner.grid.voxels() as f64).clamp(14, 19);
            }
            fill(&mut neural.samples, 2 * ((0.75 * side).round() as usize).max(4));
            neural.drop = Auto::Fixed(neural.drop.or((2 * config.iterations / 3).max(1)));
        }
        if !config.method.fits_primitives() {
            return config;
        }
        let longest = scanner.grid.shape.into_iter().fold(1, usize::max);
        let doublings = if config.rules == Rules::Paper { 0 } else { (longest / SEEN).max(1).ilog2() };
        fill(&mut config.coarse, 1 << doublings);
        let scanner = &config.seen(scanner);
        let side = cbrt(scanner.grid.voxels() as f64);
        if config.rules == Rules::Paper {
            config.fill_as_in_the_paper(side);
        }
        let surface = pow(scanner.grid.voxels() as f64, 2.0 / 3.0);
        let rays = views.saturating_mul(scanner.detector.pixels());
        fill(&mut config.iterations, (ITERATIONS_PER_VIEW * views).clamp(FEWEST_ITERATIONS, MOST_ITERATIONS));
        let cap = ((2.0 * surface).round() as usize).min(rays / RAYS).max(FEWEST_POINTS);
        fill(&mut config.model.points, ((0.75 * surface).round() as usize).clamp(FEWEST_POINTS, cap));
        // Its last step leads beyond.
        let adaptive = config.density_control.method == DensityControl::Adc;
        fill(&mut config.density_control.cap, if adaptive { cap * 4 / 5 } else { cap });
        fill(&mut config.density_control.every, (config.iterations / 60).clamp(1, 100));
        fill(&mut config.confidence.every, (config.iterations / 12).clamp(1, 500));
        config.density_control.stop =
            Auto::Fixed(config.density_control.stop.or(if adaptive { 0.5 } else { 5.0 / 6.0 }));
        config.density_control.gradient = Auto::Fixed(config.density_control.gradient.or(GRADIENT));
        fill(&mut config.wavelet.every, WAVELET_EVERY);
        fill(&mut config.wavelet.block, BLOCK);
        fill(&mut config.loss.tv_block, (side as usize / 4).clamp(BLOCK / 2, BLOCK));
        config.loss.tv = Auto::Fixed(config.loss.tv.or(2.0 * TOTAL_VARIATION * side / SIDE));
        config.wavelet.enabled &= scanner.grid.shape.into_iter().all(|n| n >= 1 << config.wavelet.levels);
        config
    }
}

impl Config {
    /// The scanner as the training sees it, with `coarse` times as long voxels.
    pub fn seen(&self, scanner: &Scanner) -> Scanner {
        scanner.coarser(self.coarse.max(1))
    }

    /// The scanner with the layer around the volume that is reconstructed as well.
    pub fn with_margin(&self, scanner: &Scanner) -> Scanner {
        Scanner { grid: scanner.grid.with_margin(self.model.margin), ..*scanner }
    }

    /// Whether the run has volumes of total variation, and they can be in slabs: with Joseph's rays.
    pub fn has_slabs(&self) -> bool {
        let varies = self.method == Method::Tv || self.method.fits_primitives() && self.finish == Finish::Tv;
        varies && self.algebraic.rays == RayModel::Joseph
    }

    /// Whether a pilot run chooses the sampling or settings of the finish.
    pub fn has_pilot(&self) -> bool {
        self.method.fits_primitives() && self.tv.pilot && (self.sampling == Sampling::Auto || self.has_open_finish())
    }

    /// Whether there is a finish with a weight or a number of iterations to choose.
    pub fn has_open_finish(&self) -> bool {
        let TvConfig { weight, finish_iterations, .. } = self.tv;
        self.finish == Finish::Tv && (weight.fixed().is_none() || finish_iterations.fixed().is_none())
    }

    /// Mean number of primitives over a run that starts from `points`, as far as the settings tell; keys must be resolved.
    pub fn mean_population(&self, points: usize) -> f64 {
        let control = &self.density_control;
        let cap = control.cap.max(points) as f64;
        match control.method {
            DensityControl::None => points as f64,
            // How many are split depends on the scan.
            DensityControl::Adc => (points as f64 + cap) / 2.0,
            DensityControl::Ar => {
                let (mut population, mut sum) = (points as f64, 0.0);
                for iteration in 1..=self.iterations {
                    let part = iteration as f64 / self.iterations as f64;
                    if iteration.is_multiple_of(control.every) && part > control.start && part <= control.stop.or(1.0) {
                        population = (population * (1.0 + control.growth)).min(cap);
                    }
                    sum += population;
                }
                sum / self.iterations as f64
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::Method;
    use crate::geometry::{Beam, Detector, Grid};

    fn scanner(voxels: usize, pixels: usize) -> Scanner {
        let pitch = 4.0 / pixels as f64;
        let detector =
            Detector { rows: pixels, columns: pixels, pitch_v: pitch, pitch_u: pitch, offset_u: 0.0, offset_v: 0.0 };
        Scanner { beam: Beam::Cone { dso: 5.0, dsd: 7.0 }, detector, grid: Grid::cube(voxels) }
    }

    #[test]
    fn populations_go_with_surfaces_and_iterations_with_views() {
        let of = |voxels, pixels, views| {
            let config = Config::of(Method::TrGs).resolved(&scanner(voxels, pixels), views);
            (config.iterations, config.model.points, config.density_control.cap, config.density_control.every)
        };
        assert_eq!(of(64, 128, 18), (2520, 3072, 8192, 42));
        assert_eq!(of(255, 512, 50), (5000, 48_769, 130_050, 83));
        let weight = |rules, voxels| {
            let config = Config { coarse: 1, rules, ..Config::of(Method::TrGs) };
            config.resolved(&scanner(voxels, 128), 18).loss.tv
        };
        assert_eq!([256, 64, 16].map(|n| weight(Rules::Trgs, n)), [0.1, 0.025, 0.006_25].map(Auto::Fixed));
        assert_eq!([256, 64, 16].map(|n| weight(Rules::Paper, n)), [0.05, 0.0125, 0.003_125].map(Auto::Fixed));
        // Few rays make fewer primitives.
        assert_eq!(of(64, 32, 6), (1000, 768, 768, 16));
        assert_eq!(of(2, 2, 1), (1000, 64, 64, 16));
    }

    #[test]
    fn the_training_of_large_volumes_sees_longer_voxels() {
        let plan = |voxels, pixels| Config::of(Method::TrGs).resolved(&scanner(voxels, pixels), 50);
        assert_eq!(
            [2, 128, 255, 256, 511, 512, 1024].map(|voxels| plan(voxels, 2 * voxels).coarse),
            [1, 1, 1, 2, 2, 4, 8]
        );
        // All that follows from the volume follows from the one that is seen.
        assert_eq!(Config { coarse: 1, ..plan(256, 512) }, plan(128, 256));
        let mut long = scanner(64, 128);
        long.grid.shape[2] = 256;
        assert_eq!(Config::of(Method::TrGs).resolved(&long, 50).coarse, 2);
        let set = Config { coarse: 1, ..Config::of(Method::TrGs) }.resolved(&scanner(256, 512), 50);
        assert_eq!((set.coarse, set.model.points), (1, 49_152));
        let paper = Config { rules: Rules::Paper, ..Config::of(Method::TrGs) }.resolved(&scanner(256, 256), 50);
        assert_eq!((paper.coarse, paper.model.points), (1, 50_000));
    }

    #[test]
    fn a_single_slice_has_no_wavelets() {
        let mut flat = scanner(64, 128);
        assert!(Config::of(Method::TrGs).resolved(&flat, 18).wavelet.enabled);
        flat.grid.shape[2] = 1;
        assert!(!Config::of(Method::TrGs).resolved(&flat, 18).wavelet.enabled);
    }

    #[test]
    fn what_was_set_stays() {
        let mut config = Config::of(Method::TrGs);
        config.set("density_control.cap=777").unwrap();
        config.iterations = 30;
        let resolved = config.resolved(&scanner(64, 128), 18);
        assert_eq!((resolved.iterations, resolved.density_control.cap, resolved.density_control.every), (30, 777, 1));
        assert_eq!(resolved.resolved(&scanner(16, 16), 3), resolved);
    }

    #[test]
    fn the_mean_population_lies_between_start_and_cap() {
        let mut config = Config::of(Method::TrGs).resolved(&scanner(64, 128), 18);
        let mean = config.mean_population(3072);
        assert!(mean > 5000.0 && mean < 8192.0, "{mean}");
        config.density_control.method = DensityControl::None;
        assert_eq!(config.mean_population(3072), 3072.0);
    }

    #[test]
    fn rates_of_networks_drop_after_two_thirds_of_any_run() {
        let drop = |iterations, setting| {
            let mut config = Config::of(Method::Naf);
            (config.iterations, config.neural.drop) = (iterations, setting);
            config.resolved(&scanner(64, 128), 18).neural().drop
        };
        assert_eq!(Config::of(Method::SaxNerf).iterations, 1500);
        assert_eq!([1, 4, 1500, 4500, 15_000].map(|steps| drop(steps, Auto::Auto)), [1, 2, 1000, 3000, 10_000]);
        assert_eq!(drop(4500, Auto::Fixed(1000)), 1000);
    }

    #[test]
    fn methods_on_voxels_have_their_own_iterations() {
        for method in [Method::Sart, Method::OsSart, Method::Cgls, Method::AsdPocs] {
            let config = Config::of(method);
            assert_eq!(config.resolved(&scanner(64, 128), 18).iterations, config.iterations);
        }
    }
}
