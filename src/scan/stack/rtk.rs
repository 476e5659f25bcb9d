//! The geometry file of RTK: `RTKThreeDCircularGeometry`, version 2 or 3.
//!
//! Lengths are in the unit of the scanner's description, usually millimetres; angles are in degrees. RTK's axes are ours
//! in another order: its rotation axis y is our z, its z is our x, its x is our y, so the gantry angle is our angle. In
//! the frame of a view, the source lies at `(SourceOffsetX, SourceOffsetY, SourceToIsocenterDistance)`, and the point
//! (0, 0) of the projection at `(ProjectionOffsetX, ProjectionOffsetY, SourceToIsocenterDistance -
//! SourceToDetectorDistance)`; the frame is turned by `InPlaneAngle` about z, `OutOfPlaneAngle` about x and
//! `GantryAngle` about y, in this order. A parameter that all views share stands before the first projection.
//!
//! Two facts are not in the file: the middle of the projections is taken for their point (0, 0), and rows run down
//! against RTK's y, so that a stack whose first row is at the bottom must be flipped.

use glam::DVec3;
use std::path::Path;
use trgs_core::error::{Error, Result};
use trgs_core::geometry::Pose;
use trgs_core::numeric::elementary::{cos, sin};
use trgs_core::words::utf8;

/// Parameters of a view in the order of [`NAMES`].
type Parameters = [f64; 9];

/// The parameters that are read.
const NAMES: [&str; 9] = [
    "SourceToIsocenterDistance",
    "SourceToDetectorDistance",
    "GantryAngle",
    "OutOfPlaneAngle",
    "InPlaneAngle",
    "SourceOffsetX",
    "SourceOffsetY",
    "ProjectionOffsetX",
    "ProjectionOffsetY",
];
/// Elements that are not needed: matrices follow from the parameters, and collimators only hide pixels.
const NOT_NEEDED: [&str; 5] = ["Matrix", "CollimationUInf", "CollimationUSup", "CollimationVInf", "CollimationVSup"];

/// The views of an RTK geometry file, in its unit of length.
#[derive(Clone, Debug, PartialEq)]
pub struct RtkGeometry {
    /// One for each projection.
    pub poses: Vec<Pose>,
    /// Unusual properties of the file, one sentence each.
    pub oddities: Vec<String>,
}

impl RtkGeometry {
    /// Reads a file.
    ///
    /// # Errors
    /// [`Error::Read`], or [`Error::Format`] for content that is no such geometry or has no meaning here.
    pub fn read(path: impl AsRef<Path>) -> Result<Self> {
        let path = path.as_ref();
        let text = crate::input::read(path).map_err(|source| Error::read(path, source))?;
        Self::parse(&String::from_utf8_lossy(&utf8(&text))).map_err(|error| error.in_file(path))
    }

    /// Parses the content of a file.
    ///
    /// # Errors
    /// [`Error::Invalid`] as for [`Self::read`].
    pub fn parse(text: &str) -> Result<Self> {
        // RTK states none, and a few lines of them expand to any amount of text.
        if text.contains("<!ENTITY") {
            return Err(wrong("geometry", "entities", "an XML file of RTK, which states none"));
        }
        let options = roxmltree::ParsingOptions { allow_dtd: true, ..Default::default() };
        let document = roxmltree::Document::parse_with_options(text, options)
            .map_err(|error| wrong("geometry", error, "an XML file of RTK"))?;
        let root = document.root_element();
        if root.tag_name().name() != "RTKThreeDCircularGeometry" {
            return Err(wrong("geometry", root.tag_name().name(), "RTKThreeDCircularGeometry"));
        }
        let (mut shared, mut oddities, mut poses) = (Parameters::default(), Vec::new(), Vec::new());
        for element in root.children().filter(roxmltree::Node::is_element) {
            if element.tag_name().name() == "Projection" {
                let mut own = shared;
                for element in element.children().filter(roxmltree::Node::is_element) {
                    take(element, &mut own, &mut oddities)?;
                }
                poses.push(pose(&own).map_err(|error| error.within(format!("projection {}", poses.len())))?);
            } else {
                take(element, &mut shared, &mut oddities)?;
            }
        }
        if poses.is_empty() {
            return Err(wrong("Projection", "none", "at least one"));
        }
        Ok(Self { poses, oddities })
    }
}

/// Takes an element's number into the parameters.
fn take(element: roxmltree::Node<'_, '_>, into: &mut Parameters, oddities: &mut Vec<String>) -> Result<()> {
    let (name, text) = (element.tag_name().name(), element.text().unwrap_or_default().trim());
    if let Some(place) = NAMES.iter().position(|known| *known == name) {
        let number = text.parse().ok().filter(|x: &f64| x.is_finite());
        into[place] = number.ok_or_else(|| wrong(name, text, "a finite number"))?;
        return Ok(());
    }
    let is_zero = text.parse() == Ok(0.0);
    if name == "RadiusCylindricalDetector" && !is_zero {
        return Err(wrong(name, text, "0: a flat detector"));
    }
    let remark = format!("the element {name} is not read");
    let known = NOT_NEEDED.contains(&name) || name == "RadiusCylindricalDetector";
    if !known && !oddities.contains(&remark) {
        oddities.push(remark);
    }
    Ok(())
}

/// The pose of a view in our axes.
fn pose(parameters: &Parameters) -> Result<Pose> {
    let [sid, sdd, gantry, out_of_plane, in_plane, source_x, source_y, offset_x, offset_y] = *parameters;
    if !(sdd > 0.0 && sid > 0.0) {
        let got = format!("SourceToIsocenterDistance {sid}, SourceToDetectorDistance {sdd}");
        return Err(wrong("distances", got, "positive lengths; 0, RTK's parallel beam, is not supported"));
    }
    let turn = |degrees: f64| (sin(degrees.to_radians()), cos(degrees.to_radians()));
    let ((sz, cz), (sx, cx), (sy, cy)) = (turn(in_plane), turn(out_of_plane), turn(gantry));
    let world = |p: DVec3| {
        let p = DVec3::new(cz * p.x - sz * p.y, sz * p.x + cz * p.y, p.z);
        let p = DVec3::new(p.x, cx * p.y - sx * p.z, sx * p.y + cx * p.z);
        let p = DVec3::new(cy * p.x + sy * p.z, p.y, cy * p.z - sy * p.x);
        DVec3::new(p.z, p.x, p.y)
    };
    Ok(Pose {
        source: world(DVec3::new(source_x, source_y, sid)),
        centre: world(DVec3::new(offset_x, offset_y, sid - sdd)),
        u: world(DVec3::X),
        v: world(DVec3::NEG_Y),
    })
}

fn wrong(what: &str, got: impl ToString, expected: &str) -> Error {
    Error::invalid(what, got, expected, "give the geometry file that RTK wrote for these projections")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tolerances::largest;
    use trgs_core::geometry::{Beam, Detector, Deviation, Grid, Scanner};

    const FILE: &str = r#"<?xml version="1.0"?>
<!DOCTYPE RTKGEOMETRY>
<RTKThreeDCircularGeometry version="3">
  <SourceToIsocenterDistance>5</SourceToIsocenterDistance>
  <SourceToDetectorDistance>7</SourceToDetectorDistance>
  <Projection><GantryAngle>40</GantryAngle><Matrix>1 0 0 0 0 1 0 0 0 0 1 0</Matrix></Projection>
  <Projection>
    <GantryAngle>130</GantryAngle><InPlaneAngle>10</InPlaneAngle><ProjectionOffsetX>0.3</ProjectionOffsetX>
    <SourceOffsetX>0.2</SourceOffsetX><Weather>fair</Weather>
  </Projection>
</RTKThreeDCircularGeometry>"#;

    #[test]
    fn a_plain_projection_is_the_plain_view_and_an_in_plane_angle_a_roll() {
        let found = RtkGeometry::parse(FILE).unwrap();
        assert_eq!(found.oddities, ["the element Weather is not read"]);
        let detector = Detector { rows: 4, columns: 4, pitch_v: 1.0, pitch_u: 1.0, offset_u: 0.0, offset_v: 0.0 };
        let scanner = Scanner { beam: Beam::Cone { dso: 5.0, dsd: 7.0 }, detector, grid: Grid::cube(4) };
        let plain = Deviation::none(&scanner);
        let near = |a: Pose, b: Pose| {
            let apart = [a.source - b.source, a.centre - b.centre, a.u - b.u, a.v - b.v];
            within!(largest(apart.map(DVec3::length)), "{a:?} and {b:?}");
        };
        near(found.poses[0], plain.pose(40.0_f64.to_radians()));
        // RTK turns the frame, which has y upwards, against our roll; and the offsets with it.
        let rolled = plain.rolled(-10.0_f64.to_radians()).pose(130.0_f64.to_radians());
        let along = rolled.u;
        let moved = Pose { source: rolled.source + along * 0.2, centre: rolled.centre + along * 0.3, ..rolled };
        near(found.poses[1], moved);
    }

    #[test]
    fn other_files_are_refused_with_the_reason() {
        let refused = |text: &str| RtkGeometry::parse(text).unwrap_err().to_string();
        assert!(refused("<a/>").contains("expected RTKThreeDCircularGeometry"));
        assert!(refused("no xml").contains("an XML file of RTK"));
        assert!(refused(&FILE.replace(">40<", ">forty<")).contains("GantryAngle: got forty"));
        assert!(refused(&FILE.replace(">7<", ">0<")).contains("parallel beam, is not supported"));
        let round = FILE.replace("<Weather>fair</Weather>", "<RadiusCylindricalDetector>9</RadiusCylindricalDetector>");
        assert!(refused(&round).contains("flat detector"));
        assert!(refused("<RTKThreeDCircularGeometry/>").contains("Projection: got none"));
    }
}
