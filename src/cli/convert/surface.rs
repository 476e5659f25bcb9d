//! Conversion of volumes to surfaces, folders of slices and contact sheets.

use super::volume::{converted, open, read};
use super::{Convert, extension};
use crate::cli::messages::moved;
use crate::cli::{Output, interrupt};
use serde::Serialize;
use std::io::Write;
use std::path::Path;
use trgs::Result;
use trgs::output::{Destination, Kind, check_file, stage_folder, write_atomically};
use trgs::report::slice::{Picture, Window, contact_sheet};
use trgs::scan::surface::{Mesh, otsu};
use trgs::scan::volume_file::{Scaling, Slices, write_slices};
use trgs::words::counted;

/// Most slices of a contact sheet.
const MOST_SLICES: usize = 64;

/// The result of a surface.
#[derive(Serialize)]
struct Meshed<'a> {
    #[serde(serialize_with = "trgs::words::serialize_name")]
    out: &'a Path,
    kind: &'static str,
    level: f64,
    triangles: usize,
    vertices: usize,
    /// Inside of the surface, in the cube of the unit.
    volume: f64,
    unit: &'static str,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    notes: Vec<String>,
}

pub(super) fn convert(command: &Convert) -> Result<Output> {
    let (volume, note) = read(command)?;
    let level = command.level.unwrap_or_else(|| otsu(&volume));
    let mesh = Mesh::of(&volume, level)?;
    check_file(&command.out)?;
    mesh.write(&command.out)?;
    let chosen =
        command.level.is_none().then(|| format!("level {level:.4} is chosen by Otsu's method; --level gives another"));
    let is_glb = extension(&command.out) == "glb" && volume.unit.is_some();
    let metres = is_glb.then(|| "GLB has metres: its node scales the vertices, which are in mm".into());
    Ok(Output::list(&Meshed {
        out: &command.out,
        kind: "surface",
        level,
        triangles: mesh.triangles.len(),
        vertices: mesh.positions.len(),
        volume: mesh.volume(),
        unit: if volume.unit.is_some() { "mm" } else { "not stated" },
        notes: chosen.into_iter().chain(metres).chain(note).collect(),
    }))
}

/// A folder of slices.
pub(super) fn slices(command: &Convert, format: Slices) -> Result<Output> {
    let (volume, note) = read(command)?;
    let destination = Destination::new(&command.out, Kind::Slices, "convert").overwrite(command.replace.overwrite);
    let destination = destination.input(&command.source);
    let Scaling { offset, step } = interrupt::shielded(|| {
        let staged = stage_folder(destination.clone())?;
        let scaling = write_slices(&staged.path(), &volume, format)?;
        staged.commit().map(|()| scaling)
    })?;
    moved(&destination);
    let scaling = format!("a stored number n is the value {offset:.6e} + {step:.6e} n");
    let (shape, notes) = (volume.values.dim().into(), [scaling].into_iter().chain(note).collect());
    Ok(Output::list(&converted(&command.out, "slices", &volume, shape, notes)))
}

/// A picture of the slices across z.
pub(super) fn sheet(command: &Convert) -> Result<Output> {
    let (stored, note) = open(command)?;
    let volume = stored.metadata().clone();
    let mut stored = stored.kept()?;
    // Of a patient, left is on the right and the front on top; of other volumes, y runs upwards.
    let has_sides = volume.unit.is_some() && volume.origin.is_some();
    let sides = [volume.directions.x_axis.x, volume.directions.y_axis.y];
    let signs = if has_sides { sides.map(|along| if along < 0.0 { -1 } else { 1 }) } else { [1, -1] };
    let window = Window::of(&mut stored)?;
    let (sheet, indices) = contact_sheet(&mut stored, MOST_SLICES, signs)?;
    check_file(&command.out)?;
    let png = Picture::grey(&sheet, window).png();
    interrupt::shielded(|| write_atomically(&command.out, |file| file.write_all(&png)))?;
    let Window { low, high } = window;
    let shown =
        format!("{} across z from the top left, {low} to {high} as black to white", counted(indices.len(), "slice"));
    let (shape, notes) = (stored.shape(), [shown].into_iter().chain(note).collect());
    Ok(Output::list(&converted(&command.out, "contact sheet", &volume, shape, notes)))
}
