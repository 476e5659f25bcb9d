//! Conversion of a stack of projections to R²-Gaussian's folder.

use super::Convert;
use crate::cli::arguments::finite;
use crate::cli::messages::{moved, warning, warnings};
use crate::cli::{Output, interrupt};
use clap::{Args, ValueEnum};
use ndarray::{Array2, Array3};
use serde::Serialize;
use std::path::{Path, PathBuf};
use trgs::output::Destination;
use trgs::scan::dataset::Description;
use trgs::scan::intensities::{Air, Corrected, Correction, White, full_scale, mean_frame, wrapped};
use trgs::scan::plausibility::{self, AnglesFrom};
use trgs::scan::stack::{self, Orientation, RtkGeometry, ScanFile, Series};
use trgs::{Error, Result};

/// The fields in messages.
const FLAT: &str = "flat field";
const DARK: &str = "dark field";

/// Flags for stacks of projections.
#[derive(Args)]
#[command(next_help_heading = "Stacks of projections")]
pub(super) struct StackArgs {
    /// Angles of the views in radians: a text of numbers, a table with a header, or .npy
    #[arg(long, value_name = "FILE")]
    angles: Option<PathBuf>,
    /// Angles and poses of the views: geometry of RTK, in the unit of length of the scanner
    #[arg(long, value_name = "FILE.xml", conflicts_with_all = ["angles", "clockwise"])]
    geometry: Option<PathBuf>,
    /// Read the angles as degrees
    #[arg(long, requires = "angles")]
    degrees: bool,
    /// Read the angles as radians, even if they look like degrees
    #[arg(long, conflicts_with = "degrees")]
    radians: bool,
    /// Flat field: frames without an object (any stack, or one image), which are averaged
    #[arg(long, value_name = "STACK", conflicts_with_all = ["normalise", "white", "line_integrals"])]
    flat: Option<PathBuf>,
    /// Dark field: frames without X-rays (any stack, or one image), which are averaged
    #[arg(long, value_name = "STACK", conflicts_with = "line_integrals")]
    dark: Option<PathBuf>,
    /// Replace the flat field by the brightest pixels of the stack, or of each frame (inconsistent views)
    #[arg(long, value_enum, value_name = "OVER", conflicts_with_all = ["white", "line_integrals"])]
    normalise: Option<Normalise>,
    /// Reading of a pixel without an object, instead of a flat field
    #[arg(long, value_name = "I0", conflicts_with = "line_integrals", value_parser = finite)]
    white: Option<f64>,
    /// Read the stack as line integrals, with lengths in the unit of the scanner
    #[arg(long)]
    line_integrals: bool,
    /// Row 0 of a frame is at the bottom
    #[arg(long)]
    flip_rows: bool,
    /// Column 0 of a frame is at the opposite side
    #[arg(long)]
    flip_columns: bool,
    /// Angles are clockwise, seen from +z
    #[arg(long)]
    clockwise: bool,
}

#[derive(Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Normalise {
    /// The brightest pixels of the whole stack.
    Global,
    /// The brightest pixels of each frame.
    Frame,
}

/// The result of the command.
#[derive(Serialize)]
struct Measured<'a> {
    #[serde(serialize_with = "trgs::words::serialize_name")]
    out: &'a Path,
    kind: &'static str,
    views: usize,
    detector: [usize; 2],
    shape: [usize; 3],
    /// Scene units per unit of length of the description.
    scale: f64,
    unit: &'static str,
    #[serde(flatten)]
    correction: Option<Summary>,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    notes: Vec<String>,
}

/// Statistics of the conversion of intensities.
#[derive(Serialize)]
struct Summary {
    #[serde(skip_serializing_if = "Option::is_none")]
    white: Option<f64>,
    clamped: usize,
    dead_pixels: usize,
    #[serde(skip_serializing_if = "Option::is_none")]
    air: Option<[f64; 2]>,
}

impl StackArgs {
    /// The first of these flags that was given, if any.
    pub(super) fn first_flag(&self) -> Option<&'static str> {
        let given = [
            ("--angles", self.angles.is_some()),
            ("--geometry", self.geometry.is_some()),
            ("--radians", self.radians),
            ("--flat", self.flat.is_some()),
            ("--dark", self.dark.is_some()),
            ("--normalise", self.normalise.is_some()),
            ("--white", self.white.is_some()),
            ("--line-integrals", self.line_integrals),
            ("--flip-rows", self.flip_rows),
            ("--flip-columns", self.flip_columns),
            ("--clockwise", self.clockwise),
        ];
        given.into_iter().find(|(_, given)| *given).map(|(flag, _)| flag)
    }

    /// Reads frames, and the fields and angles that are in the same file.
    fn read(&self, source: &Path) -> Result<ScanFile> {
        let fields = [(FLAT, &self.flat), (DARK, &self.dark)];
        let fields: Vec<(&str, &Path)> =
            fields.into_iter().filter_map(|(what, path)| Some((what, path.as_deref()?))).collect();
        let scan = match stack::read_scan_file(source)? {
            Some(scan) => scan,
            None => {
                let Series { values, remarks, .. } = stack::read_series(source, &fields)?;
                ScanFile { frames: values, remarks, ..ScanFile::default() }
            }
        };
        warnings(source, &scan.remarks);
        let replaced = [
            (FLAT, scan.flat.is_some() && (self.line_integrals || self.has_white())),
            (DARK, scan.dark.is_some() && (self.line_integrals || self.dark.is_some())),
            ("angles", scan.angles.is_some() && (self.angles.is_some() || self.geometry.is_some())),
        ];
        for (what, _) in replaced.iter().filter(|(_, is_replaced)| *is_replaced) {
            warning(source, format!("the {what} of this file: not used, as the flags say"));
        }
        Ok(scan)
    }

    /// Whether a flag states the reading of a pixel without an object.
    fn has_white(&self) -> bool {
        self.flat.is_some() || self.white.is_some() || self.normalise.is_some()
    }

    /// Converts the intensities of a file to line integrals.
    fn correct(&self, source: &Path, scan: &ScanFile, air: Option<Air>) -> Result<Corrected> {
        let own = |what: &str, frames: &Option<Array3<f32>>| {
            frames.as_ref().map(|frames| mean(what, frames, source)).transpose()
        };
        let white = match (&self.flat, self.white, self.normalise) {
            (Some(flat), _, _) => White::Flat(field(FLAT, flat)?),
            (None, Some(reading), _) => White::Reading(reading),
            (None, None, Some(Normalise::Frame)) => White::OfFrame,
            (None, None, Some(Normalise::Global)) => White::OfStack,
            (None, None, None) => own(FLAT, &scan.flat)?.map_or(White::OfStack, White::Flat),
        };
        let dark = match &self.dark {
            Some(dark) => Some(field(DARK, dark)?),
            None => own(DARK, &scan.dark)?,
        };
        let correction = Correction { dark, white, air };
        correction.apply(&scan.frames).map_err(|error| error.in_file(source))
    }
}

fn field(what: &str, path: &Path) -> Result<Array2<f64>> {
    mean(what, &stack::read(path)?, path)
}

fn mean(what: &str, frames: &Array3<f32>, path: &Path) -> Result<Array2<f64>> {
    warnings(path, full_scale(what, frames).into_iter().chain(wrapped(what, frames)));
    mean_frame(what, frames).map_err(|error| error.in_file(path))
}

pub(super) fn convert(command: &Convert) -> Result<Output> {
    let Convert { source, out, scanner, corrections, protocol, stack: arguments, .. } = command;
    let Some(scanner) = scanner else {
        let expected = "the description of beam, detector and volume, for a stack of projections";
        let remedy = "add --scanner meta_data.json, or end OUT with .nii.gz to write a volume";
        return Err(Error::invalid("--scanner", format!("none, and OUT {}", out.display()), expected, remedy));
    };
    let of_flags = [&arguments.angles, &arguments.geometry, &arguments.flat, &arguments.dark];
    let destination = of_flags.into_iter().flatten().fold(command.destination(), Destination::input);
    destination.check()?;
    let mut description = Description::read(scanner)?;
    if let Some(path) = &arguments.geometry {
        let RtkGeometry { poses, oddities } = RtkGeometry::read(path)?;
        warnings(path, &oddities);
        description = description.with_poses(&poses).map_err(|error| error.in_file(scanner))?;
    }
    let scan = arguments.read(source)?;
    let mut angles = match (&arguments.angles, &scan.angles) {
        (Some(path), _) => stack::read_angles(path, arguments.degrees)?,
        // The file states no unit, and degrees were assumed.
        (None, Some(angles)) if arguments.radians && scan.is_unit_assumed => {
            angles.iter().map(|angle| angle.to_degrees()).collect()
        }
        (None, Some(angles)) if arguments.geometry.is_none() => angles.clone(),
        _ => description.angles(scan.frames.dim().0).map_err(|error| error.in_file(scanner))?,
    };
    if arguments.radians {
        plausibility::within_a_turn(&mut angles);
    }
    let orientation = Orientation {
        flip_rows: arguments.flip_rows,
        flip_columns: arguments.flip_columns,
        clockwise: arguments.clockwise,
    };
    let (line_integrals, correction) = if arguments.line_integrals {
        corrections.refuse_region("line integrals")?;
        (scan.frames, None)
    } else {
        let corrected = arguments.correct(source, &scan, corrections.region())?;
        warnings(source, &corrected.remarks);
        let Corrected { line_integrals, white, clamped, dead, drift, .. } = corrected;
        (line_integrals, Some(Summary { white, clamped, dead_pixels: dead, air: drift }))
    };
    let name = out.file_name().unwrap_or_default().to_string_lossy();
    let dataset = stack::scan(&name, &description, line_integrals, angles, orientation);
    let mut dataset = dataset.map_err(|error| error.in_file(source))?;
    plausibility::check(&dataset, AnglesFrom::Stack).map_err(|error| error.in_file(source))?;
    corrections.apply(&mut dataset, [arguments.flip_rows, arguments.flip_columns])?;
    warnings(scanner, &dataset.oddities);
    warnings(source, plausibility::remarks(&dataset));
    tracing::info!("{}", stack::span(&dataset.train.angles));
    let dataset = protocol.apply(dataset)?;
    interrupt::shielded(|| dataset.write(destination.clone()))?;
    moved(&destination);
    let detector = dataset.scanner.detector;
    Ok(Output::list(&Measured {
        out,
        kind: "dataset",
        views: dataset.train.len(),
        detector: [detector.rows, detector.columns],
        shape: dataset.scanner.grid.shape,
        scale: dataset.frame.scale,
        unit: dataset.frame.unit_words(),
        correction,
        notes: dataset.notes,
    }))
}
