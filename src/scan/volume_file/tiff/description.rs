//! What the programs that wrote a TIFF say in its description: number of pages, spacing, calibration.

use super::super::header::{converted, shown};
use crate::unit::Unit;
use glam::DVec3;
use serde_json::Value;

/// The description of a stack.
#[derive(Debug, Default, PartialEq)]
pub(super) struct Description {
    /// Number of pages that the file should have.
    pub(super) pages: Option<u64>,
    /// Whether further pages may follow the first one without directories of their own.
    pub(super) may_be_contiguous: bool,
    /// Distance between pages; it is in the unit of the resolution.
    pub(super) depth: f64,
    /// Distance between pixels and pages in millimetres, where the description states it.
    pub(super) spacing: Option<DVec3>,
    /// Millimetres of the unit of the resolution, where the description states a unit of length; 1 for an unknown one.
    pub(super) unit: Option<f64>,
    /// Whether the unit is known.
    pub(super) in_millimetres: bool,
    /// Number of images at each position; they cannot be told from slices.
    pub(super) channels: u64,
    /// Offset and slope of a linear calibration.
    pub(super) calibration: Option<[f64; 2]>,
    pub(super) oddities: Vec<String>,
}

impl Description {
    /// Interprets the text of the first page, which has `rows` and `columns`.
    pub(super) fn parse(text: &str, rows: u64, columns: u64) -> Self {
        let text = text.trim_matches(['\0', ' ', '\n', '\r', '\u{feff}']);
        let mut found = Self { depth: 1.0, channels: 1, ..Self::default() };
        if text.starts_with("ImageJ=") {
            found.image_j(text);
        } else if text.starts_with('{') {
            found.shaped(text, rows, columns);
        } else if text.contains("<OME") {
            found.ome(text);
        }
        found
    }

    /// Lines `key=value` of ImageJ.
    fn image_j(&mut self, text: &str) {
        self.may_be_contiguous = true;
        let field = |key: &str| text.lines().find_map(|line| line.trim().strip_prefix(key)?.strip_prefix('='));
        let number = |key: &str| field(key)?.trim().parse::<f64>().ok();
        let count = |key: &str| field(key)?.trim().parse::<u64>().ok();
        self.pages = count("images");
        self.channels = count("channels").unwrap_or(1);
        if let (Some(slices), Some(frames)) = (count("slices"), count("frames"))
            && slices > 1
            && frames > 1
        {
            self.oddities.push(format!("{slices} slices at each of {frames} times are read one after another"));
        }
        if let Some(depth) = number("spacing") {
            self.depth = depth.abs();
        }
        match field("unit").map(str::trim) {
            None | Some("" | "pixel" | "pixels") => {}
            Some(unit) => {
                let known = converted("ImageJ's unit", unit, &mut self.oddities);
                (self.unit, self.in_millimetres) = (Some(known.map_or(1.0, Unit::millimetres)), known.is_some());
            }
        }
        match (count("cf"), number("c0"), number("c1")) {
            (None, ..) => {}
            (Some(0), Some(offset), Some(slope)) => {
                self.calibration = Some([offset, slope]);
                self.oddities.push(format!("ImageJ's calibration {offset} + {slope}·(stored number) is applied"));
            }
            (Some(function), ..) => {
                self.oddities.push(format!("ImageJ's calibration function {function} is not applied"));
            }
        }
    }

    /// The shape that Python's tifffile writes as JSON.
    fn shaped(&mut self, text: &str, rows: u64, columns: u64) {
        let Ok(parsed) = serde_json::from_str::<Value>(text) else { return };
        let Some(shape) = parsed["shape"].as_array() else { return };
        let sides: Option<Vec<u64>> = shape.iter().map(Value::as_u64).collect();
        let (Some(sides), true) = (sides, self.pages.is_none()) else { return };
        let [outer @ .., r, c] = sides.as_slice() else { return };
        if (*r, *c) != (rows, columns) {
            self.oddities.push(format!("its description states the shape {sides:?}, which its pages do not have"));
            return;
        }
        self.pages = outer.iter().try_fold(1_u64, |product, &n| product.checked_mul(n));
        self.may_be_contiguous = true;
        if outer.iter().filter(|n| **n > 1).count() > 1 {
            self.oddities.push(format!("its axes {outer:?} before rows and columns are read one after another"));
        }
    }

    /// Attributes of the first `Pixels` of OME-XML.
    fn ome(&mut self, text: &str) {
        let Some((_, rest)) = text.split_once("<Pixels ") else { return };
        let pixels = rest.split('>').next().unwrap_or_default();
        let field = |key: &str| {
            let (_, value) = pixels.split_once(&format!("{key}=\""))?;
            value.split('"').next()
        };
        let size = |key: &str| field(key)?.parse::<u64>().ok();
        let [z, c, t] = ["SizeZ", "SizeC", "SizeT"].map(|key| size(key).unwrap_or(1));
        self.channels = c;
        self.pages = z.checked_mul(c).and_then(|pages| pages.checked_mul(t));
        if z > 1 && t > 1 {
            self.oddities.push(format!("{z} slices at each of {t} times are read one after another"));
        }
        let mut side = |axis: &str| -> Option<f64> {
            let length = field(&format!("PhysicalSize{axis}"))?.parse::<f64>().ok()?;
            let unit = field(&format!("PhysicalSize{axis}Unit")).unwrap_or("µm").replace("&#181;", "µ");
            Some(length * Unit::named(&unit)?.millimetres())
        };
        let [x, y, z] = ["X", "Y", "Z"].map(&mut side);
        if let (Some(x), Some(y)) = (x, y) {
            (self.spacing, self.in_millimetres) = (Some(DVec3::new(x, y, z.unwrap_or(1.0))), true);
            if z.is_none() {
                self.oddities.push("the distance between its pages is not stated: 1 mm is taken".into());
            }
        }
        if text.split_once("<BinaryOnly").is_some() {
            let remark = shown("BinaryOnly");
            self.oddities.push(format!("its OME description {remark} names other files, which are not read"));
        }
    }
}
