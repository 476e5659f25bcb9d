//! Conversion of raw detector intensities to line integrals.
//!
//! Not in the paper, whose data are line integrals already. By the Beer-Lambert law, with the reading I of a pixel, its
//! reading D without X-rays (dark field) and its reading F without an object (flat field):
//!
//! ```text
//! p = -ln((I - D)/(F - D))
//! ```
//!
//! Without a flat field, one number for **all** frames replaces F - D: a given reading, or the brightest reading of the
//! whole stack. If it is wrong, all line integrals are wrong by the same constant.
//!
//! **Pitfall: normalising each frame on its own.** Dividing each frame by its own brightest pixel, or stretching it
//! from its own minimum to its own maximum as viewers and exports do, gives every frame a different F. If no pixel of a
//! frame sees air (the object fills the detector from that side), the frame loses the line integral of its most
//! transparent ray. Frames are then wrong by different constants: they contradict each other, no volume explains all of
//! them, and the constants cannot be recovered.
//!
//! The correct scale of a frame is the mean over a region where the beam passes through air in **every** frame
//! ([`Air`]); it removes the drift of a source. An 8-bit stack in which every frame reaches 255 has been stretched
//! already.
//!
//! Three rules of this project: a transmission below [`FLOOR`] is set to it. A pixel whose F - D is below [`DEAD`] of
//! the median is dead and gets the median of its neighbours' line integrals. Negative line integrals, from readings
//! brighter than the beam without an object, are kept, because clamping them would bias air. All three are counted.

mod range;

pub use range::{full_scale, wrapped};

use crate::limit;
use ndarray::{Array2, Array3};
use std::ops::Range;
use std::str::FromStr;
use trgs_core::error::{Error, Result};
use trgs_core::geometry::check_finite;
use trgs_core::numeric::elementary::log;
use trgs_core::numeric::rank::median;
use trgs_core::numeric::{reduce, threads};
use trgs_core::setting::Setting;

/// Smallest transmission, the step of a 16-bit detector: no line integral exceeds 16·ln 2 = 11.09.
pub const FLOOR: f64 = 1.0 / 65_536.0;
/// Fraction of the median of F - D below which a pixel is dead.
pub const DEAD: f64 = 0.01;
/// Largest allowed fraction of dead pixels.
const MOST_DEAD: f64 = 0.05;
/// The brightest reading is this quantile: a thousandth of the pixels may be hot.
const BRIGHTEST: f64 = 0.999;
/// Fraction of readings below the floor that is remarked on with its likely causes.
const MANY: f64 = 0.01;
/// Ratio of the brightest to the darkest frame's air that is remarked on.
const DRIFT: f64 = 1.1;

/// The reading without an object.
#[derive(Clone, Debug, PartialEq)]
pub enum White {
    /// A reading for every pixel, `[v, u]`.
    Flat(Array2<f64>),
    /// One reading, before the dark field is subtracted.
    Reading(f64),
    /// The brightest reading of the stack: the 99.9 % quantile of all pixels less their dark field.
    OfStack,
    /// The brightest reading of each frame: see the pitfall above; for data that were treated so already.
    OfFrame,
}

/// A region of pixels that see only air in every frame.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Air {
    /// Rows, the end excluded.
    pub rows: Range<usize>,
    /// Columns, the end excluded.
    pub columns: Range<usize>,
}

/// Parameters of the conversion from readings to line integrals.
#[derive(Clone, Debug, PartialEq)]
pub struct Correction {
    /// Reading of each pixel without X-rays, `[v, u]`; zero if `None`.
    pub dark: Option<Array2<f64>>,
    /// The reading without an object.
    pub white: White,
    /// Region where the drift of the source is measured.
    pub air: Option<Air>,
}

/// Line integrals, and statistics of the conversion.
#[derive(Clone, Debug, PartialEq)]
pub struct Corrected {
    /// `[view, v, u]`, dimensionless: attenuation times length.
    pub line_integrals: Array3<f32>,
    /// The single number used for F - D, if there is one.
    pub white: Option<f64>,
    /// Readings whose transmission was below [`FLOOR`].
    pub clamped: usize,
    /// Dead pixels of the detector.
    pub dead: usize,
    /// Smallest and largest mean transmission of the air region over the frames.
    pub drift: Option<[f64; 2]>,
    /// Remarks for the user, one sentence each.
    pub remarks: Vec<String>,
}

/// The mean of frames `[frame, v, u]`, pixel by pixel.
///
/// # Errors
/// For no frame, or a value that is not finite.
///
/// Not in the paper. Tests: `patterns_of_flat_and_dark_fields_are_taken_out`.
pub fn mean_frame(what: &str, frames: &Array3<f32>) -> Result<Array2<f64>> {
    check_finite(what, frames)?;
    let (count, rows, columns) = frames.dim();
    if count == 0 {
        return Err(Error::invalid(what, "no frame", "at least one", "give a file with at least one frame"));
    }
    let mean = |(row, column)| reduce::sum_by(count, &|frame| f64::from(frames[[frame, row, column]])) / count as f64;
    Ok(Array2::from_shape_fn((rows, columns), mean))
}

/// The line integral of a ray, `-ln(max(transmission, FLOOR))`, from its transmission (I - D)/(F - D).
///
/// Not in the paper: see the head of this page. The result is dimensionless. Tests:
/// `a_transmission_is_turned_into_a_line_integral`.
pub fn line_integral(transmission: f64) -> f64 {
    -log(if transmission > FLOOR { transmission } else { FLOOR })
}

impl Correction {
    /// The line integrals of readings `[view, v, u]`, computed in f64 and rounded once.
    ///
    /// # Errors
    /// For values that are not finite, shapes that differ, a region outside the detector, a beam that is not brighter
    /// than the dark field, or more than 5 % dead pixels.
    ///
    /// Not in the paper: see the head of this page. Tests: `patterns_of_flat_and_dark_fields_are_taken_out`,
    /// `frames_by_themselves_lose_what_no_ray_of_theirs_misses`, `drift_is_taken_out_by_air`.
    pub fn apply(&self, readings: &Array3<f32>) -> Result<Corrected> {
        self.check(readings)?;
        // The readings and the line integrals.
        limit::allow_array("readings", readings.shape(), 2 * size_of::<f32>())?;
        let (views, rows, columns) = readings.dim();
        let dark: Vec<f64> = match &self.dark {
            Some(dark) => dark.iter().copied().collect(),
            None => vec![0.0; rows * columns],
        };
        let in_order = readings.as_standard_layout();
        let all = in_order.as_slice().expect("in C order by now");
        let signal = |view: usize, pixel: usize| f64::from(all[view * dark.len() + pixel]) - dark[pixel];
        let (beam, mut levels) = self.white.beam(&dark, views, &signal)?;
        let white = match &self.white {
            White::Reading(reading) => Some(*reading),
            White::OfStack => Some(levels[0]),
            White::Flat(_) | White::OfFrame => None,
        };
        let dead = dead_pixels(&beam)?;
        let drift = match &self.air {
            None => None,
            Some(air) => {
                Some(follow(air, columns, &dead, &mut levels, |view, pixel| signal(view, pixel) / beam[pixel])?)
            }
        };

        let mut values = vec![0.0_f32; readings.len()];
        threads::for_each_chunk(&mut values, beam.len(), |view, image| {
            for (pixel, p) in image.iter_mut().enumerate() {
                *p = line_integral(signal(view, pixel) / (beam[pixel] * levels[view])) as f32;
            }
        });
        let ceiling = line_integral(0.0) as f32;
        let lives = |pixel: usize| dead.binary_search(&pixel).is_err();
        let clamped = values.iter().enumerate().filter(|(i, p)| **p == ceiling && lives(i % beam.len())).count();
        // Neighbours are living pixels only, so no repaired value enters another repair.
        let neighbours: Vec<Vec<usize>> = dead.iter().map(|&pixel| around(pixel, rows, columns, &lives)).collect();
        threads::for_each_chunk(&mut values, beam.len(), |_, image| {
            for (&pixel, around) in dead.iter().zip(&neighbours) {
                image[pixel] =
                    median(&mut around.iter().map(|&pixel| f64::from(image[pixel])).collect::<Vec<_>>()) as f32;
            }
        });
        let line_integrals = Array3::from_shape_vec(readings.dim(), values).expect("a value for each reading");
        let mut corrected = Corrected { line_integrals, white, clamped, dead: dead.len(), drift, remarks: Vec::new() };
        corrected.remarks = self.remarks(&corrected);
        corrected.remarks.extend(full_scale("frames", readings));
        corrected.remarks.extend(wrapped("frames", readings));
        Ok(corrected)
    }

    fn check(&self, readings: &Array3<f32>) -> Result<()> {
        check_finite("readings", readings)?;
        let (_, rows, columns) = readings.dim();
        if readings.is_empty() {
            return Err(Error::invalid(
                "readings",
                format!("shape {:?}", readings.shape()),
                "frames",
                "give a file with at least one frame",
            ));
        }
        let flat = if let White::Flat(flat) = &self.white { Some(flat) } else { None };
        for (what, field) in [("dark field", self.dark.as_ref()), ("flat field", flat)] {
            if let Some(field) = field.filter(|field| field.dim() != (rows, columns)) {
                let expected = format!("[{rows}, {columns}] = [v, u], as the frames");
                return Err(Error::invalid(
                    what,
                    format!("shape {:?}", field.shape()),
                    expected,
                    "give the field recorded with this scan",
                ));
            }
        }
        match &self.air {
            Some(Air { rows: r, columns: c }) if r.is_empty() || c.is_empty() || r.end > rows || c.end > columns => {
                let got = format!("rows {r:?}, columns {c:?}");
                let expected = format!("a region within {rows} rows and {columns} columns");
                Err(Error::invalid("air", got, expected, "give ROW0,COLUMN0,ROW1,COLUMN1, the ends excluded"))
            }
            _ => Ok(()),
        }
    }

    fn remarks(&self, corrected: &Corrected) -> Vec<String> {
        let mut remarks = Vec::new();
        match self.white {
            White::OfStack if self.air.is_none() => remarks.push(format!(
                "no flat field: the brightest reading of all frames is used, {} above the dark field; if no pixel \
                 sees air in any frame, give the reading without an object",
                corrected.white.unwrap_or_default()
            )),
            White::OfFrame if self.air.is_none() => remarks.push(
                "every frame is normalised by its own brightest pixel: where no pixel of a frame sees air its line integrals \
                 are too small by a constant of its own, and the views contradict each other"
                    .into(),
            ),
            _ => {}
        }
        if corrected.clamped > 0 {
            let part = corrected.clamped as f64 / corrected.line_integrals.len() as f64;
            let cause = if part > MANY {
                ": is the dark field that of this scan, are these line integrals already?"
            } else {
                ""
            };
            remarks.push(format!(
                "{} readings ({:.3} %) let less than 2^-16 of the beam through, or less than nothing, and were taken as \
                 that{cause}",
                corrected.clamped,
                100.0 * part
            ));
        }
        if corrected.dead > 0 {
            remarks.push(format!("{} dead pixels have the median of their neighbours", corrected.dead));
        }
        if let Some([low, high]) = corrected.drift.filter(|[low, high]| *high > DRIFT * low) {
            remarks.push(format!(
                "air lets {low:.4} to {high:.4} of the beam through: a source that drifts, or the object is in the region"
            ));
        }
        remarks
    }
}

impl White {
    /// F - D as a factor per pixel times a factor per frame.
    ///
    /// `dark` is the dark field, `signal(view, pixel)` is I - D.
    fn beam(&self, dark: &[f64], views: usize, signal: &impl Fn(usize, usize) -> f64) -> Result<(Vec<f64>, Vec<f64>)> {
        let pixels = dark.len();
        Ok(match self {
            Self::Flat(flat) => (flat.iter().zip(dark).map(|(flat, dark)| flat - dark).collect(), vec![1.0; views]),
            Self::Reading(reading) => (dark.iter().map(|dark| reading - dark).collect(), vec![1.0; views]),
            Self::OfStack => {
                let level = brightest((0..views * pixels).map(|i| signal(i / pixels, i % pixels)))?;
                (vec![1.0; pixels], vec![level; views])
            }
            Self::OfFrame => {
                let level = |view| brightest((0..pixels).map(|pixel| signal(view, pixel)));
                (vec![1.0; pixels], (0..views).map(level).collect::<Result<_>>()?)
            }
        })
    }
}

/// The 99.9 % quantile: the smallest value that at least 99.9 % of all do not exceed.
fn brightest(values: impl Iterator<Item = f64>) -> Result<f64> {
    let mut values: Vec<f64> = values.collect();
    let rank = (BRIGHTEST * values.len() as f64).ceil() as usize - 1;
    let (_, &mut value, _) = values.select_nth_unstable_by(rank, f64::total_cmp);
    if value > 0.0 {
        return Ok(value);
    }
    let remedy = "give the dark field of this scan, or " + Setting::LineIntegrals + " if the data are no intensities";
    Err(Error::invalid("brightest reading", value, "more than the dark field", remedy))
}

/// Pixels that receive none of the beam, in increasing order.
fn dead_pixels(beam: &[f64]) -> Result<Vec<usize>> {
    let typical = median(&mut beam.to_vec());
    if typical.is_nan() || typical <= 0.0 {
        let got = format!("{typical} above the dark field, in the median of all pixels");
        let remedy = "exchange flat and dark field, or give the fields of this scan";
        return Err(Error::invalid("beam without an object", got, "more than the dark field", remedy));
    }
    let dead: Vec<usize> = (0..beam.len()).filter(|&pixel| beam[pixel] < DEAD * typical).collect();
    if dead.len() as f64 > MOST_DEAD * beam.len() as f64 {
        let got = format!("{} of {} pixels below a hundredth of the median", dead.len(), beam.len());
        return Err(Error::invalid(
            "flat field",
            got,
            "at most a twentieth of dead pixels",
            "crop the frames to the part of the detector that the beam reaches",
        ));
    }
    Ok(dead)
}

/// Multiplies each frame's level by its mean transmission in air; returns the least and largest mean.
fn follow(
    air: &Air,
    columns: usize,
    dead: &[usize],
    levels: &mut [f64],
    transmission: impl Fn(usize, usize) -> f64,
) -> Result<[f64; 2]> {
    let pixels = air.rows.clone().flat_map(|row| air.columns.clone().map(move |column| row * columns + column));
    let pixels: Vec<usize> = pixels.filter(|pixel| dead.binary_search(pixel).is_err()).collect();
    let mut ends = [f64::INFINITY, f64::NEG_INFINITY];
    for (view, level) in levels.iter_mut().enumerate() {
        let mean = reduce::sum_by(pixels.len(), &|i| transmission(view, pixels[i]) / *level) / pixels.len() as f64;
        if mean.is_nan() || mean <= 0.0 {
            let got = format!("a mean of {mean} of the beam in frame {view}");
            return Err(Error::invalid(
                "air",
                got,
                "light",
                "give a region of living pixels that see air in every frame",
            ));
        }
        *level *= mean;
        ends = [ends[0].min(mean), ends[1].max(mean)];
    }
    Ok(ends)
}

/// The living pixels of the smallest square around a pixel that contains any.
fn around(pixel: usize, rows: usize, columns: usize, lives: &impl Fn(usize) -> bool) -> Vec<usize> {
    let (row, column) = (pixel / columns, pixel % columns);
    let square = |reach: usize| {
        let span = move |at: usize, end: usize| at.saturating_sub(reach)..(at + reach + 1).min(end);
        span(row, rows).flat_map(move |row| span(column, columns).map(move |column| row * columns + column))
    };
    let mut living = (1..).map(|reach| square(reach).filter(|&pixel| lives(pixel)).collect::<Vec<_>>());
    living.find(|pixels| !pixels.is_empty()).expect("most pixels live")
}

impl FromStr for Air {
    type Err = Error;

    /// Parses `ROW0,COLUMN0,ROW1,COLUMN1`, the ends excluded.
    fn from_str(text: &str) -> Result<Self> {
        let numbers: Option<Vec<usize>> = text.split(',').map(|number| number.trim().parse().ok()).collect();
        match numbers.as_deref() {
            Some(&[top, left, bottom, right]) if top < bottom && left < right => {
                Ok(Self { rows: top..bottom, columns: left..right })
            }
            _ => {
                let expected = "ROW0,COLUMN0,ROW1,COLUMN1, the first below the last";
                Err(Error::invalid("air", text, expected, "for example 0,0,40,20: the ends are excluded"))
            }
        }
    }
}

#[cfg(test)]
mod tests;
