//! Hounsfield units and attenuation.
//!
//! Not in the paper. Scanners in hospitals write `HU = 1000·(μ/μ_water - 1)`: air is -1000 and water 0. Projections need
//! the attenuation
//!
//! ```text
//! μ = μ_water · (1 + HU/1000)
//! ```
//!
//! with `μ_water` in the unit wanted; 1 makes water 1. Values below -1000 (padding outside of the scanner's circle, noise
//! in air) become 0.

use ndarray::Array3;
use trgs_core::error::{Error, Result};
use trgs_core::setting::{Setting, Text};

/// Values below this are no attenuation per millimetre: noise of a reconstruction is far smaller.
pub const IMPOSSIBLE: f32 = -200.0;
/// Air in Hounsfield units, with its noise.
const AIR: std::ops::RangeInclusive<f32> = -1100.0..=-900.0;
/// Share of voxels that are air from which on values are Hounsfield units.
const SHARE_OF_AIR: f64 = 1e-3;

/// A remark on values that look like Hounsfield units; `what` names the volume.
///
/// Noise of attenuation per metre reaches below [`IMPOSSIBLE`], too. Hounsfield units have air at -1000, or are whole
/// numbers, as scanners store them.
pub fn remark(what: &str, values: &Array3<f32>) -> Option<Text> {
    let (low, high) = values.iter().fold((0.0_f32, 0.0_f32), |(low, high), &value| {
        (if value < low { value } else { low }, if value > high { value } else { high })
    });
    let share = values.iter().filter(|value| **value < IMPOSSIBLE).count() as f64 / values.len().max(1) as f64;
    let air = values.iter().filter(|value| AIR.contains(*value)).count() as f64 / values.len().max(1) as f64;
    let is_hounsfield = || air >= SHARE_OF_AIR || values.iter().all(|value| value.fract() == 0.0);
    (low < IMPOSSIBLE && is_hounsfield()).then(|| {
        let found = format!(
            "the {what} has values from {low} to {high}, {:.1} % of them below {IMPOSSIBLE}: they look like Hounsfield \
             units instead of attenuation; convert them with ",
            100.0 * share
        );
        let water = " X, the attenuation of water (1 makes water 1): trgs convert IN OUT ";
        Text::from(found) + Setting::MuWater + water + Setting::MuWater + " 1"
    })
}

/// Replaces Hounsfield units by attenuation, `mu_water·(1 + HU/1000)`, and returns how many values were below -1000.
///
/// # Errors
/// For a `mu_water` that is not a positive number.
pub fn to_attenuation(values: &mut Array3<f32>, mu_water: f64) -> Result<usize> {
    if !(mu_water > 0.0 && mu_water.is_finite()) {
        let expected = "a positive number: the attenuation of water";
        let remedy = "give 1 for densities relative to water, or for example 0.02 per mm at 60 keV";
        return Err(Error::invalid(Setting::MuWater, mu_water, expected, remedy));
    }
    let mut below = 0;
    values.mapv_inplace(|hounsfield| {
        let mu = mu_water * (1.0 + f64::from(hounsfield) / 1000.0);
        below += usize::from(mu < 0.0);
        if mu < 0.0 { 0.0 } else { mu as f32 }
    });
    Ok(below)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn noise_of_attenuation_per_metre_is_no_hounsfield_unit() {
        // Water, 20 per metre, in half of the voxels; noise of ±300, without a voxel that is air in Hounsfield units.
        let noise = |i: usize| ((i * 7919 % 1009) as f32 / 1009.0 - 0.5) * 600.0;
        let per_metre = Array3::from_shape_fn((10, 10, 10), |(x, y, z)| {
            noise(x * 100 + y * 10 + z) + if x < 5 { 20.0 } else { 0.0 }
        });
        assert!(per_metre.iter().any(|value| *value < IMPOSSIBLE));
        assert_eq!(remark("volume", &per_metre), None);
        // The same per millimetre as Hounsfield units of whole numbers, cropped to soft tissue and lung.
        let tissue = per_metre.mapv(|value| if value < 0.0 { -700.0 } else { 40.0 });
        assert!(remark("volume", &tissue).is_some());
    }

    #[test]
    fn air_is_0_and_water_the_value_given() {
        let mut values = Array3::from_shape_vec((1, 1, 5), vec![-2000.0, -1000.0, -500.0, 0.0, 1000.0]).unwrap();
        let found = remark("volume", &values).unwrap().to_string();
        assert!(found.contains("from -2000 to 1000, 60.0 % of them below -200"), "{found}");
        assert_eq!(to_attenuation(&mut values, 0.02).unwrap(), 1);
        assert_eq!(values.as_slice().unwrap(), [0.0, 0.0, 0.01, 0.02, 0.04]);
        assert!(remark("volume", &values).is_none());
        for wrong in [0.0, -1.0, f64::NAN] {
            assert!(to_attenuation(&mut values, wrong).unwrap_err().to_string().contains("`mu_water`"));
        }
    }
}
