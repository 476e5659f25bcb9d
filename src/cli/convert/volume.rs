//! Conversion of volumes.

use super::{Convert, Converted, warn};
use crate::cli::Output;
use crate::cli::messages::hounsfield_to_attenuation;
use trgs::scene::dataset::read_scanner;
use trgs::scene::volume_file;
use trgs::{Error, Result};

pub(super) fn convert(command: &Convert) -> Result<Output> {
    let (source, out) = (&command.source, &command.out);
    let mut volume = volume_file::read(source)?;
    warn(source, &volume.oddities);
    if let Some(mu_water) = command.mu_water {
        hounsfield_to_attenuation(source, &mut volume.values, mu_water)?;
    }
    let shape: [usize; 3] = volume.values.dim().into();
    if let Some(path) = &command.scanner {
        let grid = read_scanner(path)?.grid;
        if grid.shape != shape {
            let expected = format!("{:?}, the grid of {}", grid.shape, path.display());
            let remedy = "give the scan that the volume was reconstructed from";
            return Err(Error::format(source, "volume", format!("shape {shape:?}"), expected, remedy));
        }
        (volume.spacing, volume.origin) = (Some(grid.spacing), Some(grid.centre([0, 0, 0])));
        volume.directions = volume_file::STRAIGHT;
    }
    volume_file::write(out, &volume)?;
    let [spacing, origin] = [volume.spacing, volume.origin].map(|vector| vector.map(|vector| vector.to_array()));
    Ok(Output::list(&Converted { out, kind: "volume", shape, spacing, origin, notes: Vec::new() }))
}
