//! How the values of the volume are taken from the fitted field: at the voxel centres, or so that their trilinear
//! interpolation is the field.
//!
//! A volume is read by trilinear interpolation. Where that is how the scanned object is defined, the values to find are those
//! whose interpolation projects as the field does: the [interpolant](interpolant()). A voxel of the truth of a continuous
//! object is a mean over the voxel, and point samples are closer to it. Views held out tell which of both was scanned
//! (`super::pilot`). Not in the paper, which samples points.

use crate::config::Sampling;
use crate::geometry::Volume;
use crate::numeric::elementary::log;
use crate::scan::interpolant;
use serde::Serialize;
use std::fmt;

/// How a volume was sampled, and why.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Sampled {
    /// Point or interpolant.
    pub sampling: Sampling,
    /// Errors of both in the views that a pilot run held out; missing without a pilot run, or where the configuration decides.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub evidence: Option<Evidence>,
}

/// Errors in the views that a pilot run held out, relative to their values, after the finish.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Evidence {
    /// With point samples.
    pub point: f64,
    /// With the interpolant.
    pub interpolant: f64,
}

impl Evidence {
    /// Natural logarithm of the ratio of both errors: above 0 for an interpolated volume, below 0 for a continuous object.
    pub fn log_ratio(&self) -> f64 {
        match self.point > 0.0 && self.interpolant > 0.0 {
            true => log(self.point / self.interpolant),
            // A perfect fit, as of an empty object, says nothing.
            false => 0.0,
        }
    }

    /// Whether the projections are those of a volume on the grid, interpolated.
    pub fn is_interpolated(&self) -> bool {
        self.log_ratio() > 0.0
    }
}

impl fmt::Display for Sampled {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.sampling {
            Sampling::Interpolant => write!(f, "its interpolation is the field of the primitives")?,
            _ => write!(f, "the field of the primitives at the voxel centres")?,
        }
        let Some(Evidence { point, interpolant }) = self.evidence else { return Ok(()) };
        let (kind, [error, against]) = match self.sampling {
            Sampling::Interpolant => ("an interpolated volume", [interpolant, point]),
            _ => ("a continuous object", [point, interpolant]),
        };
        let [error, against] = [error, against].map(|error| 100.0 * error);
        write!(f, ", since held-out views are those of {kind} (error {error:.2} %, otherwise {against:.2} %)")
    }
}

/// The volume of primitives whose field has the values `samples` at the voxel centres. Not in the paper.
///
/// Without a decision, [`Sampling::Auto`] stands for point samples: a measured object is continuous.
pub(super) fn volume(samples: Volume, sampling: Sampling) -> Volume {
    match sampling {
        Sampling::Interpolant => interpolant(&samples),
        Sampling::Point | Sampling::Auto => samples,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_smaller_error_decides() {
        let evidence = |point, interpolant| Evidence { point, interpolant };
        assert!(evidence(0.2, 0.1).is_interpolated() && !evidence(0.1, 0.2).is_interpolated());
        // Nothing speaks for an interpolated volume.
        assert!(!evidence(0.1, 0.1).is_interpolated() && !evidence(0.1, 0.0).is_interpolated());
        assert_eq!(evidence(0.2, 0.1).log_ratio(), -evidence(0.1, 0.2).log_ratio());
    }
}
