//! Estimation of offset and roll of the detector.

use super::Convention;
use super::held_out::{BANDS, HeldOut, held_out};
use super::reduced::{Place, ROLL, Reduced};
use serde::Serialize;
use trgs_core::error::Result;
use trgs_core::numeric::reduce;

/// Largest displacement searched from the stated place or the centre, relative to the detector's width.
const RANGE: f64 = 0.1;
/// Spacing of the offsets in the first scan, coarse pixels.
const STEP: f64 = 0.8;
/// A minimum counts if it is this close to the middle of the five offsets, in units of their spacing.
const INSIDE: f64 = 1.5;
/// Errors along u and v caused by coarse pixels and voxels, coarse pixels.
///
/// On phantoms with known offsets, errors up to 0.06 and 0.51 were seen.
const SYSTEMATIC: [f64; 2] = [0.06, 0.5];
/// The same of a roll, in units of [`Reduced::units`].
const SYSTEMATIC_ROLL: f64 = 0.02;

/// Runs of neighbouring views that a jackknife leaves out.
const RUNS: usize = 6;

/// Standard errors from which a roll differs.
pub(super) const SIGNIFICANT_ROLL: f64 = 3.0;

/// Parameters of the search for a minimum.
#[derive(Clone, Copy, Debug)]
pub(super) struct Search {
    /// Spacing of the five offsets, coarse pixels.
    pub(super) step: f64,
    /// Largest number of rounds.
    pub(super) rounds: usize,
}

/// The detector offset along one direction that explains the data best.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct OffsetScan {
    /// The stated offset, pixels of the detector.
    pub stated: f64,
    /// The offset of least held-out residual, pixels of the detector.
    pub found: f64,
    /// Standard error of `found`, pixels: a jackknife over the views, plus a part of a coarse pixel.
    pub uncertainty: f64,
    /// The offset found, scene units.
    pub found_length: f64,
    /// The residual at the offset found.
    pub residual: f64,
    /// The residual with the stated offset along this direction and the found offset along the other.
    pub residual_stated: f64,
    /// Offsets (pixels) and held-out residuals of the last refinement.
    pub curve: Vec<[f64; 2]>,
}

/// The roll of the detector that explains the data best, from u towards v.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct RollScan {
    /// The stated roll, degrees.
    pub stated: f64,
    /// The roll of least held-out residual, degrees.
    pub found: f64,
    /// Standard error of `found`, degrees: a jackknife over the views, plus a part of a coarse pixel.
    pub uncertainty: f64,
    /// The residual at the roll found.
    pub residual: f64,
    /// The residual at the stated roll.
    pub residual_stated: f64,
    /// Rolls (degrees) and held-out residuals of the last refinement.
    pub curve: Vec<[f64; 2]>,
}

impl RollScan {
    /// The result for a minimum that was found on `scan`; `stated` in radians.
    pub(super) fn new(scan: &Reduced, minimum: &Minimum, stated: f64, residual_stated: f64) -> Self {
        let (by_chance, systematic) = (minimum.uncertainty, SYSTEMATIC_ROLL * scan.units()[ROLL]);
        Self {
            stated: stated.to_degrees(),
            found: minimum.offset[ROLL].to_degrees(),
            uncertainty: (by_chance * by_chance + systematic * systematic).sqrt().to_degrees(),
            residual: minimum.residual,
            residual_stated,
            curve: minimum.curve.iter().map(|[roll, residual]| [roll.to_degrees(), *residual]).collect(),
        }
    }

    /// Whether it differs from the stated roll by more than its uncertainty.
    pub(super) fn differs(&self) -> bool {
        (self.found - self.stated).abs() > SIGNIFICANT_ROLL * self.uncertainty
    }
}

/// The shift of source and detector along u, TIGRE's `COR`, that explains the data as the offset found does.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct AxisShift {
    /// The stated shift, scene units.
    pub stated: f64,
    /// The shift with the detector where it is stated, scene units.
    pub found: f64,
    /// Standard error of `found`, from that of the offset, scene units.
    pub uncertainty: f64,
    /// The residual with this shift.
    pub residual: f64,
    /// The residual with the offset instead.
    pub residual_offset: f64,
    /// By how many standard errors the residual with this shift is above that with the offset; below it if negative.
    pub standard_errors: f64,
}

/// Offsets along u of the first scan, scene units: around the centre, the stated offset, its opposite.
pub(super) fn first_scan(stated: f64, width: f64, pitch: f64) -> Vec<f64> {
    let (step, mut all) = (STEP * pitch, Vec::<f64>::new());
    let reach = (RANGE * width / step).ceil() as i32;
    for centre in [stated, 0.0, 0.0 - stated] {
        for k in -reach..=reach {
            let offset = centre + f64::from(k) * step;
            if all.iter().all(|other| (other - offset).abs() > step / 2.0) {
                all.push(offset);
            }
        }
    }
    all
}

/// A minimum along one direction.
pub(super) struct Minimum {
    /// The place with the least residual.
    pub(super) offset: Place,
    /// Standard error along the direction, in the unit of the place.
    pub(super) uncertainty: f64,
    /// The least residual found.
    pub(super) residual: f64,
    /// Offsets along the direction, scene units, and their residuals.
    pub(super) curve: Vec<[f64; 2]>,
}

impl OffsetScan {
    /// The result for a minimum along `axis` that was found on `scan`.
    ///
    /// `pitch` is the size of a pixel; `stated` holds the stated offset and its residual; lengths are in scene units.
    pub(super) fn new(scan: &Reduced, axis: usize, minimum: &Minimum, stated: [f64; 2], pitch: f64) -> Self {
        let (by_chance, systematic) = (minimum.uncertainty, SYSTEMATIC[axis] * scan.pitch()[axis]);
        let [stated, residual_stated] = stated;
        Self {
            stated: stated / pitch,
            found: minimum.offset[axis] / pitch,
            uncertainty: (by_chance * by_chance + systematic * systematic).sqrt() / pitch,
            found_length: minimum.offset[axis],
            residual: minimum.residual,
            residual_stated,
            curve: minimum.curve.iter().map(|[offset, residual]| [offset / pitch, *residual]).collect(),
        }
    }
}

/// Refines a place along `axis`, an index of [`Place`], by a parabola through five offsets.
///
/// While the minimum is at the end of their range, the range is centred on it and the step repeated.
pub(super) fn refine(
    scan: &Reduced,
    convention: Convention,
    offset: Place,
    axis: usize,
    search: Search,
) -> Result<Minimum> {
    let (step, mut centre) = (search.step * scan.units()[axis], offset);
    for round in 1.. {
        let places = [-2.0, -1.0, 0.0, 1.0, 2.0].map(|place| {
            let mut offset = centre;
            offset[axis] += place * step;
            offset
        });
        let results = held_out(scan, &places.map(|offset| (convention, offset)))?;
        let (vertex, error) = vertex(&results);
        centre[axis] += vertex * step;
        if vertex.abs() < INSIDE || round >= search.rounds {
            let curve = places.iter().zip(&results).map(|(offset, result)| [offset[axis], result.residual()]);
            let residual = results.iter().map(HeldOut::residual).fold(f64::INFINITY, f64::min);
            return Ok(Minimum { offset: centre, uncertainty: error * step, residual, curve: curve.collect() });
        }
    }
    unreachable!("the last round returns")
}

/// The minimum of the least-squares parabola through the squared residuals at -2, -1, 0, 1, 2.
///
/// The second value is its standard error: the largest of four jackknives, over single views, runs of neighbouring views,
/// bands of rows, and bands of columns. An error that several views or pixels share shows in one of them.
fn vertex(results: &[HeldOut]) -> (f64, f64) {
    let views = results[0].residuals.len();
    let along = |weights: [f64; 5], view: usize, tile: usize| {
        results.iter().zip(weights).map(|(result, weight)| weight * result.tiles[view][tile]).sum::<f64>()
    };
    // Slope and curvature of each tile of each view.
    let parts: Vec<(usize, usize, f64, f64)> = (0..views)
        .flat_map(|view| (0..BANDS * BANDS).map(move |tile| (view, tile)))
        .map(|(view, tile)| {
            let slope = along([-2.0, -1.0, 0.0, 1.0, 2.0], view, tile) / 10.0;
            (view, tile, slope, along([2.0, -1.0, -2.0, -1.0, 2.0], view, tile) / 14.0)
        })
        .collect();
    let least = |slope: f64, bend: f64| {
        // Without a minimum: downhill to the end of the range.
        if bend > 0.0 {
            (-slope / (2.0 * bend)).clamp(-2.0, 2.0)
        } else if slope != 0.0 {
            2.0_f64.copysign(-slope)
        } else {
            0.0
        }
    };
    let without = |leaves_out: &dyn Fn(usize, usize) -> bool| {
        let kept = parts.iter().filter(|&&(view, tile, ..)| !leaves_out(view, tile));
        let (slopes, bends): (Vec<f64>, Vec<f64>) = kept.map(|&(.., slope, bend)| (slope, bend)).unzip();
        least(reduce::sum(&slopes), reduce::sum(&bends))
    };
    let jackknife = |groups: usize, group: &dyn Fn(usize, usize) -> usize| {
        let others: Vec<f64> = (0..groups).map(|k| without(&|view, tile| group(view, tile) == k)).collect();
        let mean = reduce::sum(&others) / groups as f64;
        let spread = reduce::sum_by(groups, &|i| (others[i] - mean) * (others[i] - mean));
        (spread * (groups as f64 - 1.0) / groups as f64).sqrt()
    };
    let runs = RUNS.min(views);
    let errors = [
        jackknife(views, &|view, _| view),
        jackknife(runs, &|view, _| view * runs / views),
        jackknife(BANDS, &|_, tile| tile / BANDS),
        jackknife(BANDS, &|_, tile| tile % BANDS),
    ];
    (without(&|_, _| false), errors.into_iter().fold(0.0, f64::max))
}
