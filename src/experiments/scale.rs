//! The paper's experiments at another size: how all settings scale.

use crate::numeric::elementary::pow;
use serde::{Deserialize, Serialize};
use std::fmt;

/// Voxels along a side of the paper's volumes.
const PAPER_SIZE: f64 = 256.0;
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
    /// Rays per voxel. Compare methods on primitives with those on voxels.
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
/// | detector | 512² | (2N)² | d² with d = 512 (N/256)^3/2 |
/// | test views | 100 | 100 N/256, at least 8 | the same |
///
/// A pixel is one ray through its centre, with the paper's photons.
///
/// How the method scales is defined by the preset `paper` alone; voxel methods have their own number of passes at any size.
/// Densities of the paper's scans are from 0 to about 1: their unit is 1.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Scale {
    /// Voxels along the longest side.
    pub size: usize,
    /// What stays as in the paper.
    pub matching: Matching,
    /// Pixels along each side of the detector, if they do not follow from the size.
    pub pixels: Option<usize>,
}

impl Scale {
    /// A size with the detector that follows from it.
    pub fn new(size: usize, matching: Matching) -> Self {
        Self { size, matching, pixels: None }
    }

    fn ratio(self) -> f64 {
        self.size as f64 / PAPER_SIZE
    }

    /// Pixels along each side of the detector.
    pub fn detector(self) -> usize {
        match (self.pixels, self.matching) {
            (Some(pixels), _) => pixels,
            (None, Matching::Edge) => 2 * self.size,
            (None, Matching::Ray) => (PAPER_DETECTOR * pow(self.ratio(), 1.5)).round() as usize,
        }
    }

    /// Pixels of all views over voxels.
    pub fn rays_per_voxel(self, views: usize) -> f64 {
        (views * self.detector() * self.detector()) as f64 / pow(self.size as f64, 3.0)
    }

    /// Number of test views.
    pub fn test_views(self) -> usize {
        (100 * self.size).div_ceil(256).max(8)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_papers_size_is_the_papers() {
        for matching in [Matching::Edge, Matching::Ray] {
            let paper = Scale::new(256, matching);
            assert_eq!((paper.detector(), paper.test_views()), (512, 100));
        }
    }

    #[test]
    fn what_is_matched_is_that_of_the_paper() {
        let paper = Scale::new(256, Matching::Edge);
        // 12 · 512² / 256³.
        assert_eq!(paper.rays_per_voxel(12), 0.1875);
        let relative = |size, matching| Scale::new(size, matching).rays_per_voxel(18) / paper.rays_per_voxel(18);
        assert_eq!(relative(64, Matching::Edge), 4.0);
        for size in [16, 32, 64, 96, 128] {
            // Detectors have whole pixels.
            let ray = relative(size, Matching::Ray);
            within!((ray - 1.0).abs(), "{size}: {ray}");
        }
        let ray = Scale::new(64, Matching::Ray);
        assert_eq!((ray.detector(), Scale::new(128, Matching::Ray).detector()), (64, 181));
    }
}
