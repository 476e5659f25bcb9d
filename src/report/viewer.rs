//! The interactive viewer: volumes and projections as data in a page, and the script that shows them.
//!
//! The script is in `viewer/`, without a library; node's test runner tests it by `viewer.test.js`. A page carries it
//! without comments and indents, and its content policy names the script's digest.
//!
//! Values are stored as whole numbers of 8 or 16 bits with an offset and a scale for each volume. Each number is replaced by
//! its difference to the one before; differences of 16 bits are folded (0, -1, 1, -2, … become 0, 1, 2, 3, …) and stored
//! as all high bytes, then all low bytes. The bytes are deflated and written in base64.

mod model;

use super::slice::{AXES, quantile_of, significant};
use super::{document, escape, section};
use crate::error::{Error, Result};
use crate::geometry::{Grid, Projections, Scanner, Volume};
use crate::primitives::Primitives;
use crate::scan::volume_file::VolumeFile;
use crate::scan::{Frame, Unit, hounsfield};
use crate::words::counted;
use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use flate2::Compression;
use flate2::write::DeflateEncoder;
use glam::{DMat3, DVec3};
use model::Model;
use ndarray::{Array3, Axis, Slice};
use serde::Serialize;
use serde_json::{Value, json};
use sha2::{Digest, Sha256};
use std::borrow::Cow;
use std::io::Write;

/// Voxels of a volume that a page shows without averaging.
pub const WHOLE: usize = 128 * 128 * 128;
/// Views of a scan that a page shows without leaving any out.
const VIEWS: usize = 128;
/// Axes of a stack of projections.
const STACK: [&str; 3] = ["view", "v", "u"];
/// Most volumes of a scene.
pub(super) const MOST: usize = 4;
/// Intervals of a histogram.
const BINS: usize = 160;
/// Values nearer to 0 than this part of the window are no reason for black to be another value.
const NEAR_ZERO: f64 = 0.05;
/// Cosine from which on an axis is said to run to a second side of the patient.
const OBLIQUE: f64 = 0.3;
const STYLE: &str = include_str!("viewer/viewer.css");
/// The part of the script that pages with primitives have before the others.
const MODEL_SCRIPT: &str = include_str!("viewer/model.js");
/// How a scene with primitives is recognised.
const WITH_MODEL: &str = "\"model\":[{";
/// The files of the script, in one scope.
const SCRIPT: [&str; 5] = [
    include_str!("viewer/volume.js"),
    include_str!("viewer/colour.js"),
    include_str!("viewer/pane.js"),
    include_str!("viewer/plots.js"),
    include_str!("viewer/viewer.js"),
];

/// Bits of a stored value.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Depth {
    /// 255 steps from the lowest to the highest value of a volume.
    Eight,
    /// 65,535 steps.
    Sixteen,
}

/// One to four volumes, or stacks of projections, on one grid.
#[derive(Clone, Debug, Default)]
pub struct Scene<'a> {
    title: String,
    named: Vec<(String, Cow<'a, Array3<f32>>)>,
    axes: [&'static str; 3],
    spacing: DVec3,
    /// Centre of the first voxel.
    origin: DVec3,
    directions: DMat3,
    /// Whether the directions are those of a patient.
    has_sides: bool,
    unit: Option<Unit>,
    /// Degrees of the views of projections; empty if they are not known.
    angles: Option<Vec<f64>>,
    is_hounsfield: bool,
    /// Whether values are of another quantity than attenuation, which is shown in grey.
    is_map: bool,
    /// Attenuation of water, where Hounsfield units are wanted.
    water: Option<f64>,
    notes: Vec<String>,
    model: Model,
}

/// A plane as it is shown.
#[derive(Serialize)]
struct Plane {
    /// The axis across it.
    across: usize,
    title: String,
    /// The horizontal and the vertical axis.
    axes: [usize; 2],
    /// 1 where the index grows to the right or downwards, or else -1.
    signs: [i8; 2],
    /// What is written on the left and the right, on top and at the bottom.
    ends: [[String; 2]; 2],
}

impl<'a> Scene<'a> {
    /// Named volumes of files; the first states the place of all.
    ///
    /// # Errors
    /// For no volume, more than four, an empty one, and different shapes.
    pub fn of_files(title: &str, files: Vec<(String, VolumeFile)>) -> Result<Self> {
        let Some((_, first)) = files.first() else { return Err(wrong_number(0)) };
        let scene = Self {
            title: title.into(),
            axes: AXES,
            spacing: first.spacing.unwrap_or(DVec3::ONE),
            origin: first.origin.unwrap_or(DVec3::ZERO),
            directions: first.directions,
            has_sides: first.unit.is_some() && first.origin.is_some(),
            unit: first.unit,
            is_hounsfield: hounsfield::remark("volume", &first.values).is_some(),
            ..Self::default()
        };
        scene.with(files.into_iter().map(|(name, file)| (name, Cow::Owned(file.values))).collect())
    }

    /// Named volumes on the grid of a scan.
    ///
    /// # Errors
    /// Those of [`Self::of_files`].
    pub fn of_volumes(title: &str, volumes: Vec<(&str, &'a Volume)>, frame: &Frame) -> Result<Self> {
        let Some((_, first)) = volumes.first() else { return Err(wrong_number(0)) };
        let (spacing, origin) = frame.place(&first.grid);
        let scene = Self {
            title: title.into(),
            axes: AXES,
            spacing,
            origin,
            directions: frame.directions,
            has_sides: frame.unit.is_some(),
            unit: frame.unit,
            ..Self::default()
        };
        scene.with(volumes.into_iter().map(|(name, volume)| (name.into(), Cow::Borrowed(&volume.values))).collect())
    }

    /// A volume of another quantity than attenuation, without a unit and in colours.
    ///
    /// # Errors
    /// Those of [`Self::of_files`].
    pub fn of_map(title: &str, name: &str, map: &'a Volume, frame: &Frame) -> Result<Self> {
        Ok(Self { is_map: true, ..Self::of_volumes(title, vec![(name, map)], frame)? })
    }

    /// Named projections in the same views: measured and rendered, for example.
    ///
    /// # Errors
    /// Those of [`Self::of_files`].
    pub fn of_projections(
        title: &str,
        stacks: Vec<(&str, Cow<'a, Projections>)>,
        scanner: &Scanner,
        frame: &Frame,
    ) -> Result<Self> {
        let Some((_, first)) = stacks.first() else { return Err(wrong_number(0)) };
        let detector = &scanner.detector;
        let [u, v] = [
            (detector.pitch_u, detector.columns, detector.offset_u),
            (detector.pitch_v, detector.rows, detector.offset_v),
        ];
        let start = |(pitch, count, offset): (f64, usize, f64)| offset - (count as f64 - 1.0) / 2.0 * pitch;
        let scene = Self {
            title: title.into(),
            axes: STACK,
            spacing: DVec3::new(1.0, v.0 / frame.scale, u.0 / frame.scale),
            origin: DVec3::new(0.0, start(v) / frame.scale, start(u) / frame.scale),
            unit: frame.unit,
            angles: Some(first.angles.iter().map(|angle| angle.to_degrees()).collect()),
            ..Self::default()
        };
        let images = |stack: Cow<'a, Projections>| match stack {
            Cow::Owned(Projections { images, .. }) => Cow::Owned(images),
            Cow::Borrowed(stack) => Cow::Borrowed(&stack.images),
        };
        scene.with(stacks.into_iter().map(|(name, stack)| (name.into(), images(stack))).collect())
    }

    /// Frames `[view, v, u]` of which nothing else is known.
    ///
    /// # Errors
    /// Those of [`Self::of_files`].
    pub fn of_frames(title: &str, name: &str, frames: Array3<f32>) -> Result<Self> {
        let file = VolumeFile { values: frames, ..VolumeFile::default() };
        let scene = Self::of_files(title, vec![(name.into(), file)])?;
        Ok(Self { axes: STACK, angles: Some(Vec::new()), is_hounsfield: false, ..scene })
    }

    /// The scene with these arrays, checked.
    fn with(mut self, named: Vec<(String, Cow<'a, Array3<f32>>)>) -> Result<Self> {
        if named.len() > MOST {
            return Err(wrong_number(named.len()));
        }
        let expected = named[0].1.dim();
        if let Some((name, values)) = named.iter().find(|(_, values)| values.dim() != expected || values.is_empty()) {
            let (got, remedy) = (format!("shape {:?}", values.shape()), "show volumes on one grid, or each on its own");
            return Err(Error::invalid(format!("volume of {name}"), got, format!("{expected:?}, not empty"), remedy));
        }
        self.named = named;
        for (name, values) in &mut self.named {
            let count = values.iter().filter(|value| !value.is_finite()).count();
            if count > 0 {
                let lowest = values.iter().copied().filter(|value| value.is_finite()).reduce(f32::min).unwrap_or(0.0);
                values.to_mut().mapv_inplace(|value| if value.is_finite() { value } else { lowest });
                self.notes.push(format!("{name}: {} not finite, shown as the lowest.", counted(count, "value")));
            }
        }
        Ok(self)
    }

    /// The scene with values in Hounsfield units beside its own, for this attenuation of water.
    pub fn with_water(self, water: Option<f64>) -> Self {
        Self { water: water.filter(|_| !self.is_hounsfield), ..self }
    }

    /// The scene of volumes on a grid with the primitives in it, drawn where a plane cuts them.
    pub fn with_primitives(self, primitives: &Primitives, grid: &Grid, confidence: Option<Vec<f64>>) -> Self {
        let mut scene = Self { model: Model::new(primitives, grid, confidence), ..self };
        scene.notes.push("A primitive is drawn where its density is half of that at its centre, from violet to yellow by its quantity.".into());
        scene
    }

    /// The scene with at most [`WHOLE`] voxels.
    pub fn reduced(self) -> Self {
        self.within(WHOLE)
    }

    /// The scene with at most so many voxels: the means of blocks. Of projections, views are left out first.
    pub fn within(mut self, most: usize) -> Self {
        if let Some(angles) = &mut self.angles {
            let step = self.named[0].1.len_of(Axis(0)).div_ceil(VIEWS);
            if step > 1 {
                let every = Slice::new(0, None, step as isize);
                *angles = angles.iter().copied().step_by(step).collect();
                self.named
                    .iter_mut()
                    .for_each(|(_, values)| *values = Cow::Owned(values.slice_axis(Axis(0), every).to_owned()));
                self.notes.push(format!("One view of {step} is shown."));
            }
        }
        let shape = self.shape();
        let blocks = |side: usize| [0, 1, 2].map(|axis| if axis == 0 && self.angles.is_some() { 1 } else { side });
        let voxels = |block: [usize; 3]| (0..3).map(|axis| shape[axis].div_ceil(block[axis])).product::<usize>();
        let block = (1..).map(blocks).find(|&block| voxels(block) <= most || block[1] > 64).unwrap_or([1; 3]);
        if block == [1; 3] {
            return self;
        }
        self.named.iter_mut().for_each(|(_, values)| *values = Cow::Owned(means(values, block)));
        let factor = DVec3::from_array(block.map(|side| side as f64));
        self.origin += self.directions * (self.spacing * (factor - 1.0) / 2.0);
        self.spacing *= factor;
        self.model.reduce(factor);
        let [x, y, z] = block;
        self.notes.push(format!("Means of {x} × {y} × {z} values are shown."));
        self
    }

    /// Heading.
    pub fn title(&self) -> &str {
        &self.title
    }

    /// Number of volumes.
    pub fn count(&self) -> usize {
        self.named.len()
    }

    /// Names and size.
    pub fn summary(&self) -> String {
        let names: Vec<_> = self.named.iter().map(|(name, _)| name.as_str()).collect();
        format!("{}, {}", names.join(", "), self.shape().map(|n| n.to_string()).join(" × "))
    }

    fn shape(&self) -> [usize; 3] {
        self.named[0].1.dim().into()
    }

    /// The scene as an element of a page.
    pub fn html(&self, depth: Depth) -> String {
        // In a script, the end of one must not appear.
        let data = self.json(depth).to_string().replace('<', "\\u003c");
        format!(
            "<div class=\"trgs-viewer\"><script type=\"application/json\">{data}</script>\
             <noscript>The viewer needs JavaScript.</noscript></div>\n"
        )
    }

    /// What the script reads.
    fn json(&self, depth: Depth) -> Value {
        let all: Vec<&Array3<f32>> = self.named.iter().map(|(_, values)| values.as_ref()).collect();
        let ends = all.iter().map(|values| ends(values));
        let [low, high] =
            ends.fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], [a, b]| [low.min(a), high.max(b)]);
        let high = if high > low { high } else { low + 1.0 };
        let reach = match all[..] {
            [first, second, ..] => reach(first, second),
            _ => 1.0,
        };
        // Views have no length: a sinogram is as high as a projection is wide.
        let shape = self.shape();
        let mut sides = self.spacing.to_array();
        if self.angles.is_some() {
            sides[0] = shape[2] as f64 * sides[2] / shape[0] as f64;
        }
        let quantity = self.unit.filter(|_| self.angles.is_none() && !self.is_hounsfield && !self.is_map);
        json!({
            "title": self.title,
            "note": self.note(depth),
            "axes": self.axes,
            "shape": shape,
            "spacing": self.spacing.to_array(),
            "sides": sides,
            "origin": self.origin.to_array(),
            "directions": self.directions.to_cols_array_2d(),
            "has_sides": self.has_sides,
            "unit": self.unit.map_or("", Unit::symbol),
            "quantity": quantity.map_or(String::new(), |unit| format!("/{unit}")),
            "is_hounsfield": self.is_hounsfield,
            "water": self.water,
            "map": if self.is_map { "Cividis" } else { "Grey" },
            "angles": self.angles,
            "window": window(all[0]),
            "range": [low, high],
            "reach": reach,
            "histograms": all.iter().map(|values| histogram(values, low, high)).collect::<Vec<_>>(),
            "planes": self.planes(),
            "volumes": self.named.iter().map(|(name, values)| coded(name, values, depth)).collect::<Vec<_>>(),
            "model": self.model.json(),
        })
    }

    fn note(&self, depth: Depth) -> String {
        let step = |(name, values): &(String, Cow<Array3<f32>>)| {
            let [low, high] = ends(values);
            format!("{:.1e} of {name}", (high - low) / depth.top() / 2.0)
        };
        let steps: Vec<_> = self.named.iter().map(step).collect();
        let stored = format!("Values are stored to ±{}.", steps.join(", ±"));
        self.notes.iter().chain([&stored]).cloned().collect::<Vec<_>>().join(" ")
    }

    /// The planes that are no lines: axes to the right and downwards or upwards, and what is written at the ends.
    ///
    /// Of a patient, left is on the right of a picture, and the head or the front on top. Of other volumes, the axes grow to
    /// the right and upwards. Of projections, u grows to the right, v and the views downwards.
    fn planes(&self) -> Vec<Plane> {
        let plane = |across, title: &str, axes, signs, ends: [[&str; 2]; 2]| Plane {
            across,
            title: title.into(),
            axes,
            signs,
            ends: ends.map(|ends| ends.map(Into::into)),
        };
        let name = |axis: usize| self.axes[axis];
        let all = if self.angles.is_some() {
            let stacked = |across, title, h, v| plane(across, title, [h, v], [1, 1], [["", name(h)], ["", name(v)]]);
            [
                stacked(0, "Projection", 2, 1),
                stacked(1, "Sinogram of a row", 2, 0),
                stacked(2, "Sinogram of a column", 0, 1),
            ]
        } else if self.has_sides {
            let nearest = self.nearest();
            [("Sagittal", 0, 1, 2), ("Coronal", 1, 0, 2), ("Axial", 2, 0, 1)].map(|(title, across, h, v)| {
                let [(horizontal, right), (vertical, up)] = [nearest[h], nearest[v]];
                let signs = [right, if v == 2 { -up } else { up }];
                let ends = |axis: usize, sign: i8| [-sign, sign].map(|end| sides(self.directions.col(axis), end));
                let [left_right, up_down] = [ends(horizontal, signs[0]), ends(vertical, signs[1])];
                let ends = [&left_right, &up_down].map(|ends| [ends[0].as_str(), ends[1].as_str()]);
                plane(nearest[across].0, title, [horizontal, vertical], signs, ends)
            })
        } else {
            [[0, 1, 2], [1, 0, 2], [2, 0, 1]].map(|[across, h, v]| {
                let title = format!("Across {}", name(across));
                plane(across, &title, [h, v], [1, -1], [["", name(h)], [name(v), ""]])
            })
        };
        let shape = self.shape();
        let is_line = |plane: &Plane| plane.axes.iter().any(|&axis| shape[axis] == 1);
        let are_lines = all.iter().all(is_line);
        all.into_iter().filter(|plane| are_lines || !is_line(plane)).collect()
    }

    /// For left, back and head, the axis of the array that is nearest, and whether it runs there (1) or away (-1).
    fn nearest(&self) -> [(usize, i8); 3] {
        let mut free = vec![0, 1, 2];
        let mut found = [(0, 1); 3];
        for side in [2, 1, 0] {
            let towards = |axis: usize| self.directions.col(axis)[side];
            let best = (0..free.len()).max_by(|&a, &b| towards(free[a]).abs().total_cmp(&towards(free[b]).abs()));
            let axis = free.remove(best.unwrap_or(0));
            found[side] = (axis, if towards(axis) < 0.0 { -1 } else { 1 });
        }
        found
    }
}

impl Depth {
    fn bits(self) -> usize {
        match self {
            Self::Eight => 8,
            Self::Sixteen => 16,
        }
    }

    /// The largest stored number.
    fn top(self) -> f64 {
        ((1 << self.bits()) - 1) as f64
    }
}

/// A page that shows scenes, complete in one file.
pub fn page(title: &str, lead: &str, scenes: &[Scene], depth: Depth) -> String {
    let only = scenes.len() == 1;
    let of = |scene: &Scene| if only { scene.html(depth) } else { section(&escape(&scene.title), &scene.html(depth)) };
    let content: String = scenes.iter().map(of).collect();
    // Nothing else on the page is scrolled.
    let content = if only { content.replacen("<div ", "<div data-wheel=\"page\" ", 1) } else { content };
    document(title, lead, &format!("<div class=\"trgs-wide\">\n{content}</div>\n"))
}

/// What a page with this content carries for the viewer: style, script, and the script's source in a content policy.
pub(super) fn parts(content: &str) -> [String; 3] {
    if !content.contains("<div class=\"trgs-viewer\"") && !content.contains("<div data-wheel=") {
        return Default::default();
    }
    let script = script(content.contains(WITH_MODEL));
    let digest = STANDARD.encode(Sha256::digest(script.as_bytes()));
    [STYLE.into(), format!("<script>{script}</script>\n"), format!("; script-src 'sha256-{digest}'")]
}

/// The script without comments and indents, with or without the part for primitives.
fn script(has_model: bool) -> String {
    let is_code = |line: &&str| {
        !["", "/**", "* ", "*/", "//"].iter().any(|start| match *start {
            "" => line.is_empty(),
            start => line.starts_with(start),
        })
    };
    let files = has_model.then_some(MODEL_SCRIPT).into_iter().chain(SCRIPT);
    let lines = files.flat_map(|file| file.lines().map(str::trim_start).filter(is_code));
    format!("(() => {{\n'use strict';\n{}\n}})();\n", lines.collect::<Vec<_>>().join("\n"))
}

fn wrong_number(count: usize) -> Error {
    Error::invalid("volumes to show", count, format!("1 to {MOST}"), "show fewer at once")
}

/// The side of the patient that a direction runs to (`sign` 1) or comes from (-1): one letter, or two if it is oblique.
fn sides(direction: DVec3, sign: i8) -> String {
    let mut parts = [("R", "L"), ("A", "P"), ("I", "S")].into_iter().zip(direction.to_array()).collect::<Vec<_>>();
    parts.sort_by(|(_, a), (_, b)| b.abs().total_cmp(&a.abs()));
    let letter = |((low, high), part): ((&'static str, &'static str), f64)| {
        if part * f64::from(sign) > 0.0 { high } else { low }
    };
    let second = if parts[1].1.abs() > OBLIQUE { letter(parts[1]) } else { "" };
    format!("{}{second}", letter(parts[0]))
}

/// The means of blocks; those at the end may be smaller.
fn means(values: &Array3<f32>, block: [usize; 3]) -> Array3<f32> {
    let shape = [0, 1, 2].map(|axis| values.len_of(Axis(axis)).div_ceil(block[axis]));
    Array3::from_shape_fn(shape, |(x, y, z)| {
        let part = values.slice_each_axis(|axis| {
            let number = axis.axis.index();
            let start = [x, y, z][number] * block[number];
            Slice::from(start..(start + block[number]).min(axis.len))
        });
        part.sum() / part.len() as f32
    })
}

/// The lowest and the highest value.
fn ends(values: &Array3<f32>) -> [f64; 2] {
    let start = [f32::INFINITY, f32::NEG_INFINITY];
    values.iter().fold(start, |[low, high], &value| [low.min(value), high.max(value)]).map(f64::from)
}

/// The automatic window: the 1st to the 99.9th percentile; black is 0 where that is near.
fn window(values: &Array3<f32>) -> [f64; 2] {
    let [low, high] = [0.01, 0.999].map(|part| significant(quantile_of(part, values.iter().copied()), 3));
    if high <= low {
        return [low, low + 1.0];
    }
    [if low.abs() < NEAR_ZERO * (high - low) { 0.0 } else { low }, high]
}

/// The difference at full colour: the 99.5th percentile of the magnitudes.
fn reach(first: &Array3<f32>, second: &Array3<f32>) -> f64 {
    let differences = first.iter().zip(second).map(|(a, b)| (b - a).abs());
    let reach = significant(quantile_of(0.995, differences), 2);
    if reach > 0.0 { reach } else { 1.0 }
}

/// Parts of all values in equal intervals, per ten million.
fn histogram(values: &Array3<f32>, low: f64, high: f64) -> Vec<f64> {
    let mut counts = vec![0_u64; BINS];
    for &value in values {
        let bin = (f64::from(value) - low) / (high - low) * BINS as f64;
        counts[(bin as usize).min(BINS - 1)] += 1;
    }
    counts.into_iter().map(|count| (count as f64 / values.len() as f64 * 1e7).round() / 1e7).collect()
}

/// The values as the script decodes them.
fn coded(name: &str, values: &Array3<f32>, depth: Depth) -> Value {
    let [low, high] = ends(values);
    let scale = if high > low { (high - low) / depth.top() } else { 1.0 };
    let mut last = 0_u16;
    let steps = values.iter().map(|&value| {
        let level = ((f64::from(value) - low) / scale).round() as u16;
        let step = level.wrapping_sub(last);
        last = level;
        step
    });
    let bytes: Vec<u8> = match depth {
        Depth::Eight => steps.map(|step| step as u8).collect(),
        Depth::Sixteen => {
            let folded: Vec<u16> = steps.map(|step| (step << 1) ^ ((step as i16) >> 15) as u16).collect();
            let high = folded.iter().map(|step| (step >> 8) as u8);
            high.chain(folded.iter().map(|step| *step as u8)).collect()
        }
    };
    let mut encoder = DeflateEncoder::new(Vec::new(), Compression::default());
    encoder.write_all(&bytes).expect("memory takes all bytes");
    let data = STANDARD.encode(encoder.finish().expect("memory takes all bytes"));
    json!({ "name": name, "bits": depth.bits(), "offset": low, "scale": scale, "data": data })
}

#[cfg(test)]
mod tests;
