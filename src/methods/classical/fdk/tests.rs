//! The decision table of [`super::fdk`], cell by cell: right in the middle, or refused.

use super::{Turn, Window, fdk};
use glam::DVec3;
use std::f64::consts::{PI, TAU};
use trgs_core::error::Result;
use trgs_core::geometry::{Beam, Detector, Grid, Scanner, Volume};
use trgs_scan::phantom::Phantom;
use trgs_scan::phantom::solid::{Shape, Solid};

const DENSITY: f64 = 0.8;

/// An ellipsoid off the axis whose projection is up to 1 from the axis on the detector.
fn object() -> Phantom {
    let solid = Solid::new(Shape::Ellipsoid, DENSITY, DVec3::new(0.08, -0.05, 0.03), DVec3::new(0.62, 0.5, 0.7));
    Phantom { name: "ellipsoid".into(), solids: vec![solid] }
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum Views {
    Full,
    Short,
    Half,
    Less,
    Sparse,
    Few,
    SparseShort,
    Groups,
    Single,
}

impl Views {
    const ALL: [Self; 9] = [
        Self::Full,
        Self::Short,
        Self::Half,
        Self::Less,
        Self::Sparse,
        Self::Few,
        Self::SparseShort,
        Self::Groups,
        Self::Single,
    ];

    fn angles(self) -> Vec<f64> {
        match self {
            Self::Full => Scanner::uniform_angles(180, 0.3, TAU),
            Self::Short => Scanner::uniform_angles(150, 0.3, 4.3),
            Self::Half => Scanner::uniform_angles(120, 0.3, PI),
            Self::Less => Scanner::uniform_angles(100, 0.3, 2.5),
            Self::Sparse => Scanner::uniform_angles(15, 0.3, TAU),
            Self::Few => Scanner::uniform_angles(5, 0.3, TAU),
            Self::SparseShort => Scanner::uniform_angles(15, 0.3, 4.3),
            Self::Groups => (0..100).map(|i| 0.02 * f64::from(i) + if i < 50 { 0.0 } else { PI - 1.0 }).collect(),
            Self::Single => vec![0.3],
        }
    }
}

/// The ends of the detector along u.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Ends {
    /// Centred, wider than the object.
    Inside,
    /// Displaced, wider than the object on both sides.
    DisplacedInside,
    /// Displaced, ends inside the object on the near side.
    HalfFan,
    /// Displaced, ends inside the object on both sides.
    HalfFanWider,
    /// Centred, ends inside the object on both sides.
    Wider,
    /// Centred; the object is more than twice as wide.
    MuchWider,
    /// Does not reach the axis.
    Beside,
}

impl Ends {
    const ALL: [Self; 7] = [
        Self::Inside,
        Self::DisplacedInside,
        Self::HalfFan,
        Self::HalfFanWider,
        Self::Wider,
        Self::MuchWider,
        Self::Beside,
    ];

    fn of(self) -> [f64; 2] {
        match self {
            Self::Inside => [-1.5, 1.5],
            Self::DisplacedInside => [-1.8, 1.2],
            Self::HalfFan => [-0.4, 1.4],
            Self::HalfFanWider => [-0.4, 0.8],
            Self::Wider => [-0.75, 0.75],
            Self::MuchWider => [-0.425, 0.425],
            Self::Beside => [0.1, 1.6],
        }
    }
}

fn scanner(beam: Beam, [left, right]: [f64; 2]) -> Scanner {
    let columns = ((right - left) / 0.025).round() as usize;
    let offset_u = (left + right) / 2.0;
    let detector = Detector { rows: 20, columns, pitch_v: 0.04, pitch_u: 0.025, offset_u, offset_v: 0.0 };
    Scanner { beam, detector, grid: Grid::cube(24) }
}

/// The result of [`mean`] for a scan of the object.
fn middle(beam: Beam, ends: [f64; 2], angles: &[f64]) -> Result<f64> {
    let scanner = scanner(beam, ends);
    let projections = object().project(&scanner, angles)?;
    Ok(mean(&fdk(&scanner, &projections, Window::RamLak, Turn::Measured)?))
}

/// The mean within 0.25 of the axis near the plane of the source, in units of the object's density.
fn mean(volume: &Volume) -> f64 {
    let (mut sum, mut count) = (0.0, 0);
    for ((x, y, z), &value) in volume.values.indexed_iter() {
        let at = volume.grid.centre([x, y, z]);
        if at.truncate().length() < 0.25 && at.z.abs() < 0.15 {
            sum += f64::from(value);
            count += 1;
        }
    }
    sum / f64::from(count) / DENSITY
}

/// A cell: right, or refused for the arc, for a displaced detector without a full turn, for gaps, for a missing middle.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Cell {
    Right,
    Arc,
    Displaced,
    Groups,
    Beside,
}

impl Cell {
    /// The decision as a table: rows are the ends of the detector, columns those of [`Views::ALL`].
    fn of(beam: Beam, ends: Ends) -> [Self; 9] {
        use Cell::{Arc as A, Beside as B, Displaced as D, Groups as G, Right as R};
        match (beam, ends) {
            //                                         Full Short Half Less Sparse Few SparseShort Groups Single
            (_, Ends::Beside) => [B, B, B, B, B, B, B, B, B],
            (Beam::Cone { .. }, Ends::HalfFan | Ends::HalfFanWider) => [R, D, A, A, R, R, D, G, A],
            (Beam::Cone { .. }, _) => [R, R, A, A, R, R, R, G, A],
            (Beam::Parallel { .. }, Ends::HalfFan | Ends::HalfFanWider) => [R, D, D, A, R, R, D, A, A],
            (Beam::Parallel { .. }, _) => [R, R, R, A, R, R, R, A, A],
        }
    }

    /// A part of the message of its refusal.
    fn reason(self) -> &'static str {
        match self {
            Self::Right => unreachable!("it is not refused"),
            Self::Arc => "half a turn and the fan",
            Self::Displaced => "with a displaced detector",
            Self::Groups => "between groups of views",
            Self::Beside => "before the rotation axis",
        }
    }
}

#[test]
fn every_cell_is_right_in_the_middle_or_refused() {
    for beam in [Beam::Cone { dso: 5.0, dsd: 7.0 }, Beam::Parallel { dso: 5.0 }] {
        // A parallel detector has the size of the region that it sees.
        let size = if matches!(beam, Beam::Cone { .. }) { 1.0 } else { 5.0 / 7.0 };
        for ends in Ends::ALL {
            for (views, cell) in Views::ALL.into_iter().zip(Cell::of(beam, ends)) {
                let name = format!("{beam:?} {ends:?} {views:?}");
                match (middle(beam, ends.of().map(|end| end * size), &views.angles()), cell) {
                    (Ok(found), Cell::Right) => within!((found - 1.0).abs(), "{name}: {found:.4}"),
                    (Ok(found), _) => panic!("{name}: {found:.4} instead of a refusal"),
                    (Err(error), Cell::Right) => panic!("{name}: {error}"),
                    (Err(error), cell) => {
                        let message = error.to_string();
                        assert!(message.contains(cell.reason()), "{name}: {message}");
                        assert!(["tr-gs", "sart", "tv"].iter().all(|method| message.contains(method)), "{message}");
                    }
                }
            }
        }
    }
}

#[test]
fn the_weights_of_the_table_make_the_difference() {
    let cone = Beam::Cone { dso: 5.0, dsd: 7.0 };
    let error = |ends: Ends, views: Views, turn: Turn| {
        let scanner = scanner(cone, ends.of());
        let projections = object().project(&scanner, &views.angles()).unwrap();
        (mean(&fdk(&scanner, &projections, Window::RamLak, turn).unwrap()) - 1.0).abs()
    };
    for ends in [Ends::HalfFan, Ends::Wider] {
        let (with, without) = (error(ends, Views::Full, Turn::Measured), error(ends, Views::Full, Turn::Full));
        within!("with", with, "{ends:?}");
        beyond!("without", without / with, "{ends:?}");
    }
}

#[test]
fn a_bright_core_changes_little_in_a_truncated_scan() {
    // The continuation assumes a homogeneous ellipse; here the core has three times the density of the rest.
    let cone = Beam::Cone { dso: 5.0, dsd: 7.0 };
    let narrow = scanner(cone, Ends::Wider.of());
    let mut phantom = object();
    phantom.solids.push(Solid::new(Shape::Ellipsoid, 2.0 * DENSITY, DVec3::new(0.1, 0.05, 0.0), DVec3::splat(0.15)));
    let angles = Views::Full.angles();
    let volume = fdk(&narrow, &phantom.project(&narrow, &angles).unwrap(), Window::RamLak, Turn::Measured).unwrap();
    let whole = scanner(cone, Ends::Inside.of());
    let truth = fdk(&whole, &phantom.project(&whole, &angles).unwrap(), Window::RamLak, Turn::Measured).unwrap();
    let (found, expected) = (mean(&volume), mean(&truth));
    within!((found / expected - 1.0).abs(), "{found} instead of {expected}");
}
