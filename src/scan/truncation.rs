//! Objects that are larger than the detector.
//!
//! Not in the paper. Whether the object is cut off at a border is measured by [`super::borders`].
//!
//! | remark | condition |
//! |---|---|
//! | wider than the detector | the object is cut off left or right, and no opposite view sees the rest |
//! | taller than the detector | the views that look farthest beyond the end of the volume see the object cut off at the top or bottom, and the detector sees the slices there less often than others |
//!
//! How often a slice is seen is the share of four points of it, in all views, whose row is on the detector: its largest
//! and smallest x and y in the middle of the volume. The views of a circle look equally far; in a helix the last views
//! decide, so that an object taller than each view is whole if the helix is long enough.

use super::borders::{Borders, Side};
use glam::DVec3;
use ndarray::Axis;
use std::f64::consts::TAU;
use trgs_core::geometry::{Beam, Projections, Scanner, View};

/// Ratio of the parts of the detector on both sides of the axis from which on it is displaced.
const DISPLACED: f64 = 1.05;
/// Widest gap between the views of a full turn, radians.
const GAP: f64 = TAU / 12.0;
/// A slice is outside of the detector if it is seen less often than the best slice by this factor.
const SEEN: f64 = 0.75;
/// Share of the views in which a tall object is cut off: in fewer, every part of it is whole in most of the views.
const MOST: f64 = 0.5;
/// Views that look as far as the farthest: their difference in heights of the detector.
const LEVEL: f64 = 0.05;

/// The detector relative to the rotation axis.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Displacement {
    /// Width from the axis to the nearer end, scene units; negative if the detector does not reach the axis.
    pub overlap: f64,
    /// Width from the axis to the farther end, scene units.
    pub far: f64,
    /// 1 if the farther end is the right one, otherwise -1.
    pub side: f64,
    /// Where the detector sees the axis, along u, scene units.
    pub axis: f64,
}

impl Displacement {
    /// The sides that [`Self::near`] counts.
    pub const SIDES: [Side; 2] = [Side::Left, Side::Right];

    /// `shift` of source and detector along u, scene units.
    pub fn of(scanner: &Scanner, shift: f64) -> Self {
        let detector = &scanner.detector;
        let half = detector.columns as f64 * detector.pitch_u / 2.0;
        let axis = match scanner.beam {
            Beam::Cone { dso, dsd } => -shift * dsd / dso,
            Beam::Parallel { .. } => 0.0,
        };
        let offset = detector.offset_u - axis;
        let (low, high) = (half - offset, half + offset);
        Self { overlap: low.min(high), far: low.max(high), side: if high > low { 1.0 } else { -1.0 }, axis }
    }

    /// That of a view, whose rows run along the circle.
    fn of_view(scanner: &Scanner, view: &View) -> Self {
        let shift = view.source.dot(view.u);
        let mut of_view = Scanner { beam: view.beam, detector: view.detector, ..*scanner };
        if let Beam::Parallel { .. } = view.beam {
            of_view.detector.offset_u += shift;
        }
        Self::of(&of_view, shift)
    }

    /// Whether the detector reaches clearly farther on one side of the axis.
    pub fn is_displaced(&self) -> bool {
        self.far >= DISPLACED * self.overlap
    }

    /// Index of the nearer end in [`Self::SIDES`].
    pub fn near(&self) -> usize {
        usize::from(self.side < 0.0)
    }
}

/// Remarks on an object that is larger than the detector.
pub(super) fn remarks(scanner: &Scanner, train: &Projections, borders: &Borders) -> Vec<String> {
    [wider(scanner, train, borders), taller(scanner, train, borders)].into_iter().flatten().collect()
}

/// A remark on an object that is wider than the detector, where no opposite view sees the rest.
fn wider(scanner: &Scanner, train: &Projections, borders: &Borders) -> Option<String> {
    let displacement = Displacement::of_view(scanner, &train.trajectory().view(scanner, 0));
    // On a full turn, the far side of a displaced detector sees what its near side lacks.
    let turns = widest_gap(&train.angles) <= GAP;
    let replaced = turns && displacement.overlap > 0.0 && displacement.is_displaced();
    let is_lacking = |side: &Side| !(replaced && *side == Displacement::SIDES[displacement.near()]);
    let lacking: Vec<Side> = Displacement::SIDES.into_iter().filter(is_lacking).collect();
    let cut = borders.cut(&lacking, train.len());
    (!cut.is_empty()).then(|| {
        format!(
            "the object is wider than the detector: cut off at the {}; near the border results are wrong; fdk \
             continues the projections if it has all other rays, the other methods need a volume (sVoxel) that contains \
             the whole object",
            cut.join(" and the ")
        )
    })
}

/// A remark on an object that is taller than the detector, where the volume reaches beyond the detector.
fn taller(scanner: &Scanner, train: &Projections, borders: &Borders) -> Option<String> {
    let ends = [Side::Top, Side::Bottom];
    if !ends.iter().any(|&side| borders.at(side).is_cut()) {
        return None;
    }
    let views = train.trajectory().views(scanner);
    let slices = scanner.grid.shape[2];
    let seen: Vec<f64> = (0..slices).map(|slice| share_seen(scanner, &views, slice)).collect();
    let best = seen.iter().fold(0.0, |a: f64, &b| if b > a { b } else { a });
    let is_outside = |slice: &usize| seen[*slice] < SEEN * best;
    let last = slices - 1;
    let upright =
        views.iter().map(|view| row(view, axis(scanner, last)) - row(view, axis(scanner, 0))).sum::<f64>() <= 0.0;
    let (mut cut, mut kept) = (Vec::new(), 0..slices);
    for side in ends {
        let from_above = (side == Side::Top) == upright;
        let from_end: Box<dyn Iterator<Item = usize>> =
            if from_above { Box::new((0..slices).rev()) } else { Box::new(0..slices) };
        let outside: Vec<usize> = from_end.take_while(is_outside).collect();
        let Some((&first, &inner)) = outside.first().zip(outside.last()) else { continue };
        let farthest = farthest(&views, axis(scanner, first), side);
        let text = if farthest.len() == views.len() {
            cut_in_most(borders, side, views.len())
        } else {
            let images = train.images.select(Axis(0), &farthest);
            cut_in_most(&Borders::of(images.view()), side, farthest.len())
        };
        let Some(text) = text else { continue };
        let unseen = outside.iter().take_while(|&&slice| seen[slice] == 0.0).last();
        let unseen = unseen.map_or_else(String::new, |&unseen| format!(" ({} in no view)", slices_text(first, unseen)));
        cut.push(format!("{text}, beyond which the volume has the slices {}{unseen}", slices_text(first, inner)));
        if from_above { kept.end = inner } else { kept.start = inner + 1 }
    }
    (!cut.is_empty()).then(|| {
        let rest = if kept.is_empty() { String::new() } else {
            format!(", or use the slices {} only", slices_text(kept.start, kept.end - 1))
        };
        format!(
            "the object is taller than the detector: cut off at the {}; values there and beside them are wrong with every \
             method; measure with more rows{rest}",
            cut.join(" and the "),
        )
    })
}

/// The object at the border, if it is cut off there in most of the views.
fn cut_in_most(borders: &Borders, side: Side, views: usize) -> Option<String> {
    if borders.at(side).share < MOST { None } else { borders.cut(&[side], views).pop() }
}

/// Numbers of neighbouring slices, the smaller one first.
fn slices_text(a: usize, b: usize) -> String {
    match (a.min(b), a.max(b)) {
        (low, high) if low == high => format!("z = {low}"),
        (low, high) => format!("z = {low} to {high}"),
    }
}

/// The middle of a slice.
fn axis(scanner: &Scanner, slice: usize) -> DVec3 {
    let grid = &scanner.grid;
    let middle = grid.min + grid.size() / 2.0;
    DVec3 { z: grid.centre([0, 0, slice]).z, ..middle }
}

/// Row of a point, fractional; not a number behind the source.
fn row(view: &View, point: DVec3) -> f64 {
    view.project(view.to_camera(point)).map_or(f64::NAN, |(u, v)| view.detector.pixel(u, v).0)
}

/// Share of the points of a slice in all views that lie on rows of the detector, from 0 to 1.
fn share_seen(scanner: &Scanner, views: &[View], slice: usize) -> f64 {
    let (middle, half) = (axis(scanner, slice), scanner.grid.size() / 2.0);
    let points = [DVec3::X, DVec3::NEG_X, DVec3::Y, DVec3::NEG_Y].map(|side| middle + side * half);
    let rows = scanner.detector.rows as f64;
    let on_rows = |view: &View| points.iter().filter(|&&point| (-0.5..=rows - 0.5).contains(&row(view, point))).count();
    views.iter().map(on_rows).sum::<usize>() as f64 / (points.len() * views.len()) as f64
}

/// The views that look farthest beyond a point at the end of the volume, at a side of the detector.
fn farthest(views: &[View], end: DVec3, side: Side) -> Vec<usize> {
    let into = |view: &View| if side == Side::Top { row(view, end) } else { -row(view, end) };
    let most = views.iter().map(into).fold(f64::NEG_INFINITY, |a, b| if b > a { b } else { a });
    (0..views.len()).filter(|&i| into(&views[i]) >= most - LEVEL * views[i].detector.rows as f64).collect()
}

/// The widest gap between neighbouring angles on the circle, radians.
fn widest_gap(angles: &[f64]) -> f64 {
    let mut sorted: Vec<f64> = angles.iter().map(|angle| angle.rem_euclid(TAU)).collect();
    sorted.sort_by(f64::total_cmp);
    let Some(&first) = sorted.first() else { return TAU };
    sorted.push(first + TAU);
    sorted.windows(2).map(|pair| pair[1] - pair[0]).fold(0.0, |a, b| if b > a { b } else { a })
}

#[cfg(test)]
mod tests {
    use crate::phantom::Phantom;
    use crate::plausibility::sentences as remarks;
    use crate::simulate::{Object, Orbit, Plan, simulate_on};
    use crate::{Dataset, Noise};
    use glam::DVec3;
    use trgs_core::geometry::{Beam, Detector, Grid, Scanner};

    /// Pitch of the rows.
    const PITCH: f64 = 0.1;

    fn scanner(rows: usize, columns: usize, offset_u: f64, offset_v: f64) -> Scanner {
        let detector = Detector { rows, columns, pitch_v: PITCH, pitch_u: 0.09, offset_u, offset_v };
        Scanner { beam: Beam::Cone { dso: 5.0, dsd: 7.0 }, detector, grid: Grid::cube(24) }
    }

    fn scan_on(scanner: &Scanner, orbit: &Orbit) -> Dataset {
        let plan = Plan { views: 18, test_views: 4, noise: Noise::LOW, seed: 1 };
        let phantom = Phantom::by_name("torso", 0).unwrap();
        simulate_on("torso", Object::Phantom(&phantom), scanner, &plan, orbit).unwrap()
    }

    fn scan(rows: usize, columns: usize, offset_u: f64, offset_v: f64) -> Dataset {
        scan_on(&scanner(rows, columns, offset_u, offset_v), &Orbit::CIRCLE)
    }

    fn only(dataset: &Dataset) -> String {
        let found = remarks(dataset);
        assert_eq!(found.len(), 1, "{found:?}");
        found.into_iter().next().unwrap()
    }

    #[test]
    fn an_object_wider_than_the_detector_is_found_unless_opposite_views_see_it() {
        let narrow = only(&scan(40, 12, 0.0, 0.0));
        assert!(
            narrow.contains("cut off at the left (in 18 of 18 views") && narrow.contains("and the right"),
            "{narrow}"
        );
        // Displaced: whole on a full turn, and not on an arc.
        let mut displaced = scan(40, 28, 0.9, 0.0);
        displaced.train.angles.iter_mut().for_each(|angle| *angle *= 0.6);
        let found = only(&displaced);
        assert!(found.contains("left") && !found.contains("the right"), "{found}");
        // A shift of source and detector displaces it as well.
        let shifted = |columns, axis_shift, roll| {
            scan_on(&scanner(40, columns, 0.0, 0.0), &Orbit { axis_shift, roll, ..Orbit::CIRCLE })
        };
        let narrow = only(&shifted(22, 0.0, 0.01));
        assert!(narrow.contains("at the left") && narrow.contains("the right"), "{narrow}");
        assert_eq!(remarks(&shifted(28, 0.64, 0.0)), [""; 0]);
    }

    #[test]
    fn an_object_taller_than_the_detector_is_found_at_its_end() {
        // 28 rows from -2 to 0.8, from the bottom of the detector upwards, and the reverse.
        let above = only(&scan(28, 44, 0.0, 0.6));
        for part in
            ["taller than the detector: cut off at the top (in 18 of 18 views", "slices z = 1", "to 23", "in no view"]
        {
            assert!(above.contains(part), "{part}: {above}");
        }
        assert!(!above.contains("bottom"), "{above}");
        let below = only(&scan(28, 44, 0.0, -0.6));
        assert!(
            below.contains("cut off at the bottom (in 18 of 18 views") && below.contains("slices z = 0 to "),
            "{below}"
        );
        assert!(!below.contains("the top"), "{below}");
        let both = only(&scan(16, 44, 0.0, 0.0));
        assert!(
            both.contains("at the top (")
                && both.contains("and the bottom (")
                && both.contains("or use the slices z = "),
            "{both}"
        );
        // In both directions.
        let found = remarks(&scan(16, 22, 0.0, 0.0));
        assert_eq!(found.len(), 2, "{found:?}");
        assert!(
            found[0].contains("wider than the detector") && found[1].contains("taller than the detector"),
            "{found:?}"
        );
        // A parallel beam sees its rows alone.
        let parallel = Scanner { beam: Beam::Parallel { dso: 5.0 }, ..scanner(12, 44, 0.0, 0.0) };
        let found = only(&scan_on(&parallel, &Orbit::CIRCLE));
        assert!(found.contains("use the slices z = 5 to 18 only"), "{found}");
    }

    #[test]
    fn slices_that_the_detector_sees_are_no_truncation() {
        assert_eq!(remarks(&scan(40, 44, 0.05, 0.1)), [""; 0]);
        // A volume of the part that all rows see, and a single row.
        let low = Scanner {
            grid: Grid::new([24, 24, 6], DVec3::new(-1.0, -1.0, -0.4), DVec3::new(1.0, 1.0, 0.4)).unwrap(),
            ..scanner(16, 44, 0.0, 0.0)
        };
        assert_eq!(remarks(&scan_on(&low, &Orbit::CIRCLE)), [""; 0]);
        let flat = Scanner {
            grid: Grid::new([24, 24, 1], DVec3::new(-1.0, -1.0, -0.05), DVec3::new(1.0, 1.0, 0.05)).unwrap(),
            ..scanner(1, 44, 0.0, 0.0)
        };
        assert_eq!(remarks(&scan_on(&flat, &Orbit::CIRCLE)), [""; 0]);
    }

    #[test]
    fn the_last_views_of_a_helix_decide() {
        let helix = |pitch| scan_on(&scanner(16, 44, 0.0, 0.0), &Orbit { turns: 3.0, pitch, ..Orbit::CIRCLE });
        assert_eq!(remarks(&helix(0.8)), [""; 0]);
        let short = only(&helix(0.15));
        assert!(short.contains("at the top (") && short.contains("and the bottom ("), "{short}");
    }
}
