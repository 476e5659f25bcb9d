//! Which scans filtered backprojection can reconstruct, and with which weights.
//!
//! [`Plan::of`] is the decision table of [`super::fdk`], in the order of its rows.

use super::fan::{half_fan, shadow};
use std::f64::consts::{PI, TAU};
use trgs_core::error::{Error, Result};
use trgs_core::geometry::{Beam, Scanner};
use trgs_core::setting::Text;
use trgs_scan::borders::Borders;
use trgs_scan::truncation::Displacement;

/// A gap between neighbouring views wider than all others by this factor ends an arc.
const GAP: f64 = 1.5;
/// A gap between views that no sampling explains: wider than this, radians, …
const HOLE: f64 = PI / 6.0;
/// … and than the median gap by this factor.
const HOLE_FACTOR: f64 = 6.0;
/// Mean steps between views that a full turn of a displaced detector may lack.
const STEPS: f64 = 4.0;
/// The methods that need no condition.
const OTHERS: &str = "use the method tr-gs, sart, asd-pocs, cgls or tv, which need no complete rays";

/// The weights of the rays, and the sides at which the projections are continued.
#[derive(Debug)]
pub(super) struct Plan {
    pub(super) weights: Weights,
    /// Whether the object is cut off left and right where no other view sees the rest.
    pub(super) continued: [bool; 2],
}

/// The weights of the rays.
#[derive(Debug)]
pub(super) enum Weights {
    /// Each view by the angle that it covers.
    Even,
    /// Parker's, for an arc.
    Arc(Arc),
    /// Those of a displaced detector on a full turn.
    Displaced(Displacement),
}

impl Plan {
    /// The decision for views at `angles` whose borders are `seen`; `shift` of source and detector along u, scene units.
    ///
    /// # Errors
    /// For a scan that lacks rays, with the reason and the methods that do without them.
    pub(super) fn of(scanner: &Scanner, angles: &[f64], shift: f64, seen: &Borders) -> Result<Self> {
        let circle = match scanner.beam {
            Beam::Cone { .. } => TAU,
            Beam::Parallel { .. } => PI,
        };
        let (arc, turn) = (Arc::of(angles, circle), Arc::of(angles, TAU));
        let displacement = Displacement::of(scanner, shift);
        let cut = Displacement::SIDES.map(|side| seen.at(side).is_cut());
        let near_is_cut = displacement.is_displaced() && cut[displacement.near()];

        if displacement.overlap <= 0.0 {
            let got = format!("one that ends {:.4} before the rotation axis", -displacement.overlap);
            let expected = "one that reaches beyond the axis: the middle of the volume was not measured";
            let offset = scanner.detector.offset_u;
            let remedy =
                format!("correct offDetector = [u, upwards], whose u is {offset:.4} in scene units, or {OTHERS}");
            return Err(Error::invalid("detector", got, expected, remedy));
        }
        if arc.ends || angles.len() == 1 {
            arc.check(PI + 2.0 * half_fan(scanner, shift, seen))?;
        }
        if let Some(hole) = arc.holes() {
            let got = format!("gaps of up to {:.1}° between groups of views", hole.to_degrees());
            let expected = "views all around, or one arc: filtered back projection needs every ray";
            return Err(Error::invalid("arc of the views", got, expected, others_or_full()));
        }
        if near_is_cut && !turn.is_whole() {
            let got = format!(
                "{:.1}° with a displaced detector that ends {:.4} beside the axis, inside the object",
                turn.coverage.to_degrees(),
                displacement.overlap
            );
            let expected = "360.0°, for the other side of the object is only seen from the opposite angle";
            return Err(Error::invalid("arc of the views", got, expected, OTHERS));
        }
        let narrow = displacement.overlap < shadow(scanner) && displacement.is_displaced();
        let half_fan = if near_is_cut { true } else { narrow && !turn.ends };
        let weights = match (half_fan, circle == TAU && arc.ends) {
            (true, _) => Weights::Displaced(displacement),
            (false, true) => Weights::Arc(arc),
            (false, false) => Weights::Even,
        };
        let mut continued = cut;
        if half_fan {
            continued[displacement.near()] = false;
        }
        Ok(Self { weights, continued })
    }
}

/// The other methods, or a first guess from any scan.
fn others_or_full() -> Text {
    Text::from(OTHERS) + ", or " + Text::set("fdk.turn", "full") + ", which ignores the gap"
}

/// The views as an arc: sorted, starting after the widest gap.
#[derive(Debug)]
pub(super) struct Arc {
    /// Indices of the views in order.
    pub(super) order: Vec<usize>,
    /// Angle of each view from the first, in that order, radians.
    pub(super) from_first: Vec<f64>,
    /// The angle that the views cover, radians: from the first to the last, plus one step; 0 for a single view.
    pub(super) coverage: f64,
    /// Whether the widest gap ends an arc.
    ends: bool,
    /// All gaps, in increasing order.
    gaps: Vec<f64>,
}

impl Arc {
    /// The arc of angles on a circle of circumference `turn`.
    fn of(angles: &[f64], turn: f64) -> Self {
        let n = angles.len();
        let mut order: Vec<usize> = (0..n).collect();
        let on_circle = |view: usize| angles[view].rem_euclid(turn);
        order.sort_by(|&a, &b| on_circle(a).total_cmp(&on_circle(b)).then(a.cmp(&b)));
        let gap = |k: usize| (on_circle(order[(k + 1) % n]) - on_circle(order[k])).rem_euclid(turn);
        let mut gaps: Vec<f64> = (0..n).map(gap).collect();
        let widest = (0..n).reduce(|a, b| if gaps[b] > gaps[a] { b } else { a }).expect("at least one view");
        order.rotate_left((widest + 1) % n);
        gaps.sort_by(f64::total_cmp);
        let second = if n > 1 { gaps[n - 2] } else { 0.0 };
        let first = on_circle(order[0]);
        let from_first: Vec<f64> = order.iter().map(|&view| (on_circle(view) - first).rem_euclid(turn)).collect();
        let (last, steps) = (from_first[n - 1], (n - 1) as f64);
        let step = if n > 1 { last / steps } else { 0.0 };
        Self { order, from_first, coverage: (last + step).min(turn), ends: n > 1 && gaps[n - 1] > GAP * second, gaps }
    }

    /// Half the angle between the neighbours of each view; the ends use their one neighbour twice.
    pub(super) fn steps(&self) -> Vec<f64> {
        let (at, n) = (&self.from_first, self.from_first.len());
        let step = |k: usize| match k {
            0 => at[1] - at[0],
            k if k + 1 == n => at[k] - at[k - 1],
            k => (at[k + 1] - at[k - 1]) / 2.0,
        };
        (0..n).map(step).collect()
    }

    /// Whether the gap at its end is no wider than a few steps.
    fn is_whole(&self) -> bool {
        let n = self.gaps.len();
        n > 1 && (!self.ends || self.gaps[n - 1] <= STEPS * self.coverage / n as f64)
    }

    /// The widest gap, if at least two are wider than any sampling explains.
    fn holes(&self) -> Option<f64> {
        let n = self.gaps.len();
        let limit = HOLE.max(HOLE_FACTOR * self.gaps[n / 2]);
        (n > 1 && self.gaps[n - 2] > limit).then(|| self.gaps[n - 1])
    }

    /// Refuses an arc of less than `needed`, radians.
    fn check(&self, needed: f64) -> Result<()> {
        let (needed, got) = (needed.to_degrees(), self.coverage.to_degrees());
        if got >= needed - 1e-6 {
            return Ok(());
        }
        let expected = format!(
            "at least {needed:.1}°, half a turn and the fan of the volume: filtered back projection needs every ray"
        );
        Err(Error::invalid("arc of the views", format!("{got:.1}°"), expected, others_or_full()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_arc_is_told_from_a_full_turn() {
        let arc = |n, span| Arc::of(&Scanner::uniform_angles(n, 5.0, span), TAU);
        assert!(!arc(12, TAU).ends);
        within!((arc(12, TAU).coverage - TAU).abs());
        let short = arc(40, 4.0);
        assert!(short.ends);
        within!((short.coverage - 4.0).abs());
        assert_eq!(short.order, (0..40).collect::<Vec<_>>());
        assert!(arc(12, TAU).is_whole() && !short.is_whole());
        // A turn of 40 views without 2 of them ends an arc, and is whole.
        let lacking = Arc::of(&Scanner::uniform_angles(40, 5.0, TAU)[2..], TAU);
        assert!(lacking.ends && lacking.is_whole());
    }

    #[test]
    fn several_wide_gaps_are_holes() {
        let degrees = |list: &[f64]| Arc::of(&list.iter().map(|angle| angle.to_radians()).collect::<Vec<_>>(), TAU);
        let arcs: Vec<f64> = (0..60).map(|i| f64::from(i) + if i < 30 { 0.0 } else { 150.0 }).collect();
        within!((degrees(&arcs).holes().unwrap().to_degrees() - 151.0).abs());
        assert!(degrees(&(0..180).map(f64::from).collect::<Vec<_>>()).holes().is_none(), "a single gap");
        assert!(degrees(&[0.0, 90.0, 180.0, 270.0]).holes().is_none(), "few views are no groups");
    }
}
