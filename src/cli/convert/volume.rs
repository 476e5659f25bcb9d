//! Conversion of volumes.

use super::{Convert, Converted, extension};
use crate::cli::Output;
use crate::cli::messages::{hounsfield_to_attenuation, warnings};
use std::path::Path;
use trgs::output::check_file;
use trgs::scan::Unit;
use trgs::scan::dataset::Description;
use trgs::scan::volume_file::{self, Stored, VolumeFile};
use trgs::{Error, Result};

/// [`open`] in memory.
pub(super) fn read(command: &Convert) -> Result<(VolumeFile, Option<String>)> {
    let (stored, note) = open(command)?;
    Ok((stored.whole()?, note))
}

/// The volume to convert, at its place and in attenuation where that is asked for; and its note.
pub(super) fn open(command: &Convert) -> Result<(Stored, Option<String>)> {
    // The folder of a run stands for its volume.
    let of_run = command.source.join("volume.npy");
    let source = if of_run.exists() { &of_run } else { &command.source };
    let mut stored = volume_file::open(source)?;
    if let Some(path) = &command.scanner {
        let Description { scanner, frame, .. } = Description::read(path)?;
        let (shape, grid) = (stored.shape(), scanner.grid);
        if grid.shape != shape {
            let expected = format!("{:?}, the grid of {}", grid.shape, path.display());
            let remedy = "give the scan that the volume was reconstructed from";
            return Err(Error::format(source, "volume", format!("shape {shape:?}"), expected, remedy));
        }
        stored = frame.arrange_stored(stored, &grid).map_err(|error| error.in_file(source))?;
    }
    warnings(source, &stored.metadata().oddities);
    if let Some(mu_water) = command.mu_water {
        let mut volume = stored.whole()?;
        hounsfield_to_attenuation(source, &mut volume.values, mu_water)?;
        stored = volume.into();
    }
    let is_of_a_scan = command.scanner.is_some() || extension(source) == "npy";
    let note = note(stored.metadata(), extension(&command.out), is_of_a_scan);
    Ok((stored, note))
}

pub(super) fn convert(command: &Convert) -> Result<Output> {
    let out = &command.out;
    let (stored, note) = open(command)?;
    check_file(out)?;
    let (volume, shape) = (stored.metadata().clone(), stored.shape());
    volume_file::write_stored(out, stored)?;
    Ok(Output::list(&converted(out, "volume", &volume, shape, note.into_iter().collect())))
}

/// A volume that was written, and its place as it was written.
pub(super) fn converted<'a>(
    out: &'a Path,
    kind: &'static str,
    volume: &VolumeFile,
    shape: [usize; 3],
    notes: Vec<String>,
) -> Converted<'a> {
    let factor = volume.unit.map_or(1.0, Unit::millimetres);
    let [spacing, origin] =
        [volume.spacing, volume.origin].map(|vector| vector.map(|vector| (vector * factor).to_array()));
    let unit = volume.spacing.map(|_| if volume.unit.is_some() { "mm" } else { "not stated" });
    Converted { out, kind, shape, spacing, origin, unit, notes }
}

/// What the written file does not keep, or the place that it states without knowing it.
fn note(volume: &VolumeFile, ending: &str, is_of_a_scan: bool) -> Option<String> {
    let is_tiff = ending.starts_with("tif");
    let drops = ["npy", "raw", "png"].contains(&ending) || is_tiff && volume.unit.is_none();
    match (volume.spacing, volume.unit) {
        (None, _) if !drops => {
            Some("no spacing is known: 1 is written; --scanner SCAN gives that of a scan".into())
        }
        (None, _) => None,
        (Some(_), _) if drops => {
            Some(format!(".{ending} keeps no spacing, origin and directions: .nii.gz, .mha and .nrrd do"))
        }
        (Some(_), None) if is_of_a_scan => Some(
            "the scan states no unit of length: lengths are those of its files; \"unit\": \"mm\" in its meta_data.json \
             states it"
                .into(),
        ),
        (Some(_), None) => Some("the unit of length is not stated: lengths are those of the source".into()),
        (Some(_), Some(Unit::Millimetre)) => None,
        (Some(_), Some(unit)) => {
            let factor = unit.millimetres();
            Some(format!("lengths in {unit} are written in mm, and values per {unit} divided by {factor}, per mm"))
        }
    }
}
