//! How the values of the volume are taken from the fitted field: at the voxel centres, or so that their trilinear
//! interpolation is the field.
//!
//! A volume is read by trilinear interpolation. Where that is how the scanned object is defined, the values to find are those
//! whose interpolation projects as the field does: the [interpolant](interpolant()). A voxel of the truth of a continuous
//! object is a mean over the voxel, and point samples are closer to it. Two questions tell which of both was scanned: whether
//! a fit on voxels loses by moving the grid ([`alignment()`]), and how much of what interpolation changes is found in the
//! projections. With the projections A c of the interpolant, F of the field and the measurement p, over all pixels with p > 0:
//!
//! ```text
//! confirmed = ⟨p - F, A c - F⟩ / ‖A c - F‖²
//! ```
//!
//! It is below zero for a continuous object, whose edges the interpolant blurs. The object is an interpolated volume where the
//! sum of all three numbers is positive. Not in the paper, which samples points.

use super::project;
use crate::classical::algebraic::{Alignment, ObserveChoice, alignment};
use crate::config::{Config, Precision, Sampling};
use crate::error::Result;
use crate::numeric::{reduce, threads};
use crate::primitives::Primitives;
use crate::scene::{Dataset, Volume, interpolant, trilinear};
use serde::Serialize;
use std::fmt;

/// How a volume was sampled, and why.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Sampled {
    /// Point or interpolant.
    pub sampling: Sampling,
    /// What the projections say of it; missing where the configuration decides.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub evidence: Option<Evidence>,
}

/// What speaks for an interpolated volume, if positive, or for a continuous object.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Evidence {
    /// What a fit on voxels loses where the grid is moved.
    #[serde(flatten)]
    pub alignment: Alignment,
    /// The part of what interpolation changes that is found in the projections.
    pub confirmed: f64,
}

impl Evidence {
    /// All of it.
    pub fn sum(&self) -> f64 {
        self.alignment.sum() + self.confirmed
    }

    /// Whether the projections are those of a volume on the grid, interpolated.
    pub fn is_interpolated(&self) -> bool {
        self.sum() > 0.0
    }
}

impl fmt::Display for Sampled {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.sampling {
            Sampling::Interpolant => write!(f, "the volume interpolates to the primitives' field")?,
            _ => write!(f, "the volume holds the primitives' field at the voxel centres")?,
        }
        let Some(evidence) = self.evidence else { return Ok(()) };
        let kind = if evidence.is_interpolated() { "an interpolated volume" } else { "a continuous object" };
        write!(f, "; the projections are those of {kind} (evidence {:.3}; above 0: interpolated)", evidence.sum())
    }
}

/// The volume of primitives whose field has the values `samples` at the voxel centres. Not in the paper.
///
/// # Errors
/// As [`alignment()`].
pub(super) fn volume(
    primitives: &Primitives,
    samples: Volume,
    dataset: &Dataset,
    config: &Config,
    observe: &mut ObserveChoice<'_>,
) -> Result<(Volume, Sampled)> {
    if config.sampling == Sampling::Point {
        return Ok((samples, Sampled { sampling: Sampling::Point, evidence: None }));
    }
    let interpolant = interpolant(&samples);
    if config.sampling == Sampling::Interpolant {
        return Ok((interpolant, Sampled { sampling: Sampling::Interpolant, evidence: None }));
    }
    let (scanner, settings) = (&dataset.scanner, config.tv());
    let alignment = match config.precision {
        Precision::F32 => alignment::<f32>(scanner, &dataset.train, &settings, observe)?,
        Precision::F64 => alignment::<f64>(scanner, &dataset.train, &settings, observe)?,
    };
    let evidence = Evidence { alignment, confirmed: confirmed(primitives, &interpolant, dataset, config)? };
    let (volume, sampling) = match evidence.is_interpolated() {
        true => (interpolant, Sampling::Interpolant),
        false => (samples, Sampling::Point),
    };
    Ok((volume, Sampled { sampling, evidence: Some(evidence) }))
}

/// The part of what interpolation changes that is found in the projections; 0 where it changes nothing.
fn confirmed(primitives: &Primitives, interpolant: &Volume, dataset: &Dataset, config: &Config) -> Result<f64> {
    let train = &dataset.train;
    let fitted = project(primitives, &dataset.scanner, &train.angles, config)?;
    let interpolated = trilinear::project(interpolant, &dataset.scanner, &train.angles)?;
    let sums = threads::map(train.len(), |view| {
        let [p, f, c] = [train, &fitted, &interpolated].map(|of| of.image(view));
        // A value of 0 is one that noise has taken below 0.
        let pixels: Vec<[f64; 2]> = (p.iter().zip(f).zip(c))
            .filter(|((p, _), _)| **p > 0.0)
            .map(|((&p, &f), &c)| [f64::from(p) - f64::from(f), f64::from(c) - f64::from(f)])
            .collect();
        [0, 1].map(|k| reduce::sum_by(pixels.len(), &|i| pixels[i][k] * pixels[i][1]))
    });
    let [product, square] = [0, 1].map(|k| reduce::sum_by(sums.len(), &|view| sums[view][k]));
    Ok(if square > 0.0 { product / square } else { 0.0 })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::primitives::Parameters;
    use crate::projector::Field;
    use crate::scene::simulate::{Object, Plan, simulate};
    use crate::scene::{Beam, Detector, Grid, Noise, Phantom, Projections, Scanner};

    /// A few primitives hardly wider than a voxel, of which interpolation changes much.
    fn primitives() -> Primitives {
        Primitives::new(Parameters {
            mean: vec![[0.21, -0.13, 0.05], [-0.34, 0.28, -0.22], [0.02, 0.41, 0.33]],
            scale: vec![[0.09, 0.12, 0.1], [0.1, 0.08, 0.14], [0.11, 0.09, 0.08]],
            quaternion: vec![[1.0, 0.2, -0.1, 0.3], [0.9, 0.0, 0.4, 0.1], [1.0, 0.0, 0.0, 0.0]],
            density: vec![0.8, 0.5, 0.9],
            nu: vec![8.0, 20.0, 5.0],
        })
        .unwrap()
    }

    #[test]
    fn what_interpolation_changes_is_found_in_the_projections() {
        let detector = Detector { rows: 36, columns: 40, pitch_v: 0.1, pitch_u: 0.1, offset_u: 0.0, offset_v: 0.0 };
        let scanner = Scanner { beam: Beam::Cone { dso: 5.0, dsd: 7.0 }, detector, grid: Grid::cube(20) };
        let plan = Plan { views: 6, test_views: 1, noise: Noise::None, seed: 0 };
        let phantom = Phantom::by_name("torso", 0).unwrap();
        let mut dataset = simulate("scan", Object::Phantom(&phantom), &scanner, &plan).unwrap();
        let (primitives, config) = (primitives(), Config { precision: Precision::F64, ..Config::default() });
        let field = Field::<f64>::new(&primitives, config.cutoff);
        let samples = Volume::new(scanner.grid, field.voxels(&scanner.grid).mapv(|value| value as f32)).unwrap();
        let interpolant = interpolant(&samples);
        let angles = dataset.train.angles.clone();
        let interpolated = trilinear::project(&interpolant, &scanner, &angles).unwrap();
        let fitted = project(&primitives, &scanner, &angles, &config).unwrap();
        for part in [0.8, 0.0, -0.3] {
            let images = &fitted.images + &(&interpolated.images - &fitted.images).mapv(|value| value * part as f32);
            dataset.train = Projections::new(angles.clone(), images).unwrap();
            let found = confirmed(&primitives, &interpolant, &dataset, &config).unwrap();
            within!((found - part).abs(), "{found} of {part}");
        }
    }

    #[test]
    fn the_evidence_decides_by_its_sum() {
        let evidence = |fitted, held_out, confirmed| Evidence { alignment: Alignment { fitted, held_out }, confirmed };
        assert!(evidence(0.1, 0.02, -0.1).is_interpolated() && !evidence(0.1, 0.02, -0.2).is_interpolated());
    }
}
