//! Conversion of scans to R²-Gaussian's folder.

use super::{Convert, Converted};
use crate::cli::messages::{moved, warnings};
use crate::cli::{Output, interrupt};
use trgs::scan::Dataset;
use trgs::scan::plausibility::{self, AnglesFrom};
use trgs::{Error, Result};

pub(super) fn convert(command: &Convert) -> Result<Output> {
    let (source, out) = (&command.source, &command.out);
    if command.scanner.is_some() {
        let expected = "no --scanner: a scan has its own";
        return Err(Error::invalid("--scanner", source.display(), expected, "leave the flag out"));
    }
    command.corrections.refuse_region("a scan")?;
    let destination = command.destination();
    destination.check()?;
    let mut dataset = Dataset::read(source)?;
    plausibility::check(&dataset, AnglesFrom::File).map_err(|error| error.in_file(source))?;
    warnings(source, &dataset.oddities);
    command.corrections.apply(&mut dataset, [false; 2])?;
    warnings(source, plausibility::remarks(&dataset));
    let dataset = command.protocol.apply(dataset)?;
    interrupt::shielded(|| dataset.write(destination.clone()))?;
    moved(&destination);
    let Dataset { scanner, frame, notes, .. } = dataset;
    let (shape, (spacing, origin)) = (scanner.grid.shape, frame.place(&scanner.grid));
    let [spacing, origin] = [spacing, origin].map(|vector| Some(vector.to_array()));
    Ok(Output::list(&Converted { out, kind: "dataset", shape, spacing, origin, unit: Some(frame.unit_words()), notes }))
}
