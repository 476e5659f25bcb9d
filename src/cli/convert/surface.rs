//! Conversion of volumes to surfaces and to folders of slices.

use super::volume::{converted, read};
use super::{Convert, extension};
use crate::cli::messages::moved;
use crate::cli::{Output, interrupt};
use serde::Serialize;
use std::path::Path;
use trgs::Result;
use trgs::output::{Destination, Kind, check_file, stage_folder};
use trgs::scan::surface::{Mesh, otsu};
use trgs::scan::volume_file::{Scaling, Slices, write_slices};

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
    Ok(Output::list(&converted(&command.out, "slices", &volume, [scaling].into_iter().chain(note).collect())))
}
