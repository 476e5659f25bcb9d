//! Flags that correct measured projections: `--air` and `--mask-pixels`.

use clap::Args;
use ndarray::Array2;
use std::path::Path;
use std::str::FromStr;
use trgs::scan::corrections::{AirCorrection, PixelCorrection};
use trgs::scan::intensities::Air as Region;
use trgs::scan::{Corrections, Dataset, stack};
use trgs::{Error, Result, words};

#[derive(Args)]
#[command(next_help_heading = "Corrections of measured views")]
pub(super) struct CorrectionArgs {
    /// Subtract air that is not 0: measured at the borders (auto: per view if it varies), or NUMBER; for a stack also a region
    /// that sees air in every frame, ends excluded, whose mean corrects the drift of the source
    #[arg(
        long,
        value_name = "auto|NUMBER|ROW0,COL0,ROW1,COL1",
        num_args = 0..=1,
        default_missing_value = "auto",
        allow_negative_numbers = true
    )]
    air: Option<AirFlag>,
    /// Interpolate wrong pixels: those that differ from their neighbours in all views (auto), or those that are not 0 in FILE
    #[arg(long, value_name = "auto|FILE", num_args = 0..=1, default_missing_value = "auto")]
    mask_pixels: Option<String>,
}

/// The argument of `--air`.
#[derive(Clone)]
enum AirFlag {
    Subtract(AirCorrection),
    Region(Region),
}

impl FromStr for AirFlag {
    type Err = Error;

    fn from_str(text: &str) -> Result<Self> {
        if text.contains(',') { text.parse().map(Self::Region) } else { text.parse().map(Self::Subtract) }
    }
}

impl CorrectionArgs {
    /// The first of these flags that was given, if any.
    pub(super) fn flag(&self) -> Option<&'static str> {
        self.air.as_ref().map(|_| "--air").or(self.mask_pixels.as_ref().map(|_| "--mask-pixels"))
    }

    /// The flags as they were given, each after a space.
    pub(super) fn again(&self) -> String {
        let air = match &self.air {
            Some(AirFlag::Subtract(AirCorrection::Auto)) => " --air=auto".into(),
            Some(AirFlag::Subtract(AirCorrection::Value(value))) => format!(" --air={value}"),
            Some(AirFlag::Region(_)) | None => String::new(),
        };
        let pixels = self.mask_pixels.as_deref();
        air + &pixels.map_or(String::new(), |file| format!(" --mask-pixels {}", words::quoted_path(Path::new(file))))
    }

    /// The region of air of a stack of intensities.
    pub(super) fn region(&self) -> Option<Region> {
        if let Some(AirFlag::Region(region)) = &self.air { Some(region.clone()) } else { None }
    }

    /// Corrects a scan. A region was for intensities, before they became a scan.
    ///
    /// `flips` are those of rows and columns that made the scan of the frames that the mask belongs to.
    pub(super) fn apply(&self, dataset: &mut Dataset, flips: [bool; 2]) -> Result<()> {
        let air = if let Some(AirFlag::Subtract(air)) = &self.air { Some(*air) } else { None };
        let pixels = match self.mask_pixels.as_deref() {
            None => None,
            Some("auto") => Some(PixelCorrection::Auto),
            Some(file) => Some(PixelCorrection::Mask(mask(Path::new(file), flips)?)),
        };
        let before = dataset.notes.len();
        dataset.correct(&Corrections { air, pixels })?;
        dataset.notes[before..].iter().for_each(|note| tracing::info!("{note}"));
        Ok(())
    }

    /// Refuses a region, for data that are no intensities.
    pub(super) fn refuse_region(&self, what: &str) -> Result<()> {
        if self.region().is_none() {
            return Ok(());
        }
        let expected = format!("auto or a number, for {what}");
        Err(Error::invalid("--air", "a region", expected, "give --air auto, which measures air at the borders"))
    }
}

fn mask(path: &Path, flips: [bool; 2]) -> Result<Array2<bool>> {
    let frames = stack::read(path)?;
    let [1, ..] = *frames.shape() else {
        let got = format!("{} frames", frames.shape()[0]);
        let error =
            Error::invalid("mask of pixels", got, "one image [v, u]", "give one image, not 0 where pixels are wrong");
        return Err(error.in_file(path));
    };
    let mut mask = frames.index_axis_move(ndarray::Axis(0), 0).mapv(|value| value != 0.0);
    for (axis, flip) in flips.into_iter().enumerate() {
        if flip {
            mask.invert_axis(ndarray::Axis(axis));
        }
    }
    Ok(mask)
}
