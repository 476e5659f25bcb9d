//! Corrections of measured projections: air that is not 0, and pixels that err in all views.
//!
//! Not in the paper, and off unless asked for. [`super::air`] and [`super::pixels`] define what is measured.

use super::air::Air;
use super::dataset::Dataset;
use super::pixels::{WrongPixels, interpolate};
use ndarray::{Array2, Axis};
use std::str::FromStr;
use trgs_core::error::{Error, Result};
use trgs_core::geometry::{Projections, Scanner};
use trgs_core::setting::Setting;
use trgs_core::words::counted;

/// What is corrected; nothing by default.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Corrections {
    /// The air to subtract.
    pub air: Option<AirCorrection>,
    /// The pixels to interpolate; before air is measured.
    pub pixels: Option<PixelCorrection>,
}

/// The air that is subtracted.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum AirCorrection {
    /// That measured at the borders: for each view if it varies, or else one constant.
    Auto,
    /// A line integral, in the unit of the files.
    Value(f64),
}

/// The pixels that are interpolated.
#[derive(Clone, Debug, PartialEq)]
pub enum PixelCorrection {
    /// Those found by comparison with their neighbours.
    Auto,
    /// Those of a mask `[v, u]`.
    Mask(Array2<bool>),
}

impl FromStr for AirCorrection {
    type Err = Error;

    fn from_str(text: &str) -> Result<Self> {
        match (text, text.parse::<f64>()) {
            ("auto", _) => Ok(Self::Auto),
            (_, Ok(value)) if value.is_finite() => Ok(Self::Value(value)),
            _ => {
                let expected = "auto, or the line integral of air as a number";
                Err(Error::invalid(Setting::Air, text, expected, "give auto, or what a remark on air states"))
            }
        }
    }
}

impl Dataset {
    /// Corrects the projections, and notes what was changed.
    ///
    /// Test views are corrected like training views; their air is measured on its own.
    ///
    /// # Errors
    /// When air is to be measured and the object covers the borders, and for a mask of another shape.
    ///
    /// Not in the paper. Tests: `what_was_taken_out_is_said`, `nothing_is_changed_unasked`.
    pub fn correct(&mut self, corrections: &Corrections) -> Result<()> {
        let Corrections { air, pixels } = corrections;
        if let Some(pixels) = pixels {
            let note = correct_pixels(&self.scanner, &mut self.train, self.test.as_mut(), pixels)?;
            self.notes.push(note);
        }
        if let Some(air) = air {
            let note = subtract_air(&mut self.train, *air, self.scale, "views")?;
            self.notes.push(note);
            if let Some(test) = &mut self.test {
                // Too few test views may see air; then they keep theirs.
                let note = subtract_air(test, *air, self.scale, "test views");
                self.notes
                    .push(note.unwrap_or_else(|_| "air of the test views is not seen: nothing is subtracted".into()));
            }
        }
        Ok(())
    }
}

fn correct_pixels(
    scanner: &Scanner,
    train: &mut Projections,
    test: Option<&mut Projections>,
    pixels: &PixelCorrection,
) -> Result<String> {
    let (_, rows, columns) = train.images.dim();
    let (mask, mut said) = match pixels {
        PixelCorrection::Mask(mask) => {
            let wrong = mask.iter().filter(|wrong| **wrong).count();
            (mask.clone(), format!("{} of the mask", counted(wrong, "pixel")))
        }
        PixelCorrection::Auto => {
            let wrong = WrongPixels::of(scanner, train);
            for &[view, row, column] in &wrong.impossible {
                let mut one = Array2::from_elem((rows, columns), false);
                one[[row, column]] = true;
                let mut image = train.images.select(Axis(0), &[view]);
                interpolate(&mut image, &one)?;
                train.images[[view, row, column]] = image[[0, row, column]];
            }
            let mut said = wrong.describe();
            if !wrong.impossible.is_empty() {
                let and = if said.is_empty() { "" } else { " and " };
                said += &format!("{and}{} of single views", counted(wrong.impossible.len(), "value"));
            }
            (wrong.mask(rows, columns), said)
        }
    };
    if said.is_empty() {
        said = "no pixel: none errs in all views".into();
    }
    for projections in [Some(train), test].into_iter().flatten() {
        interpolate(&mut projections.images, &mask)?;
    }
    Ok(format!("interpolated from their neighbours: {said}"))
}

fn subtract_air(views: &mut Projections, air: AirCorrection, scale: f64, what: &str) -> Result<String> {
    let n = views.len();
    let (levels, said): (Vec<f64>, String) = match air {
        AirCorrection::Value(value) => {
            (vec![value * scale; n], format!("air of {value} was subtracted from all {what}"))
        }
        AirCorrection::Auto => {
            let Some(air) = Air::of(views.images.view()) else {
                let got = format!("an object at the borders in more than half of the {n} {what}");
                let remedy = "give its line integral as a number, or convert with the right flat field";
                return Err(Error::invalid(Setting::Air, got, "air at two opposite borders", remedy));
            };
            let levels: Vec<f64> = (0..n).map(|view| air.at(view)).collect();
            let (low, high) = levels.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), &level| {
                (if level < low { level } else { low }, if level > high { level } else { high })
            });
            let [low, high, level, error] = [low, high, air.level, air.error].map(|value| value / scale);
            let said = if low == high && low == 0.0 {
                format!("air of the {what} is {level:.2e} ± {error:.1e}: nothing is subtracted")
            } else if low == high {
                format!("air of {level:.4} ± {error:.1e} was subtracted from all {what}")
            } else {
                format!("air of {low:.4} to {high:.4} was subtracted, one value for each of the {what}")
            };
            (levels, said)
        }
    };
    for (mut image, level) in views.images.outer_iter_mut().zip(levels) {
        if level != 0.0 {
            image.mapv_inplace(|value| (f64::from(value) - level) as f32);
        }
    }
    Ok(said)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Noise;
    use crate::phantom::Phantom;
    use crate::plausibility::sentences as remarks;
    use crate::simulate::{Object, Plan, simulate};

    fn scan(noise: Noise) -> Dataset {
        let plan = Plan { views: 12, test_views: 5, noise, seed: 1 };
        let phantom = Phantom::by_name("teapot", 0).unwrap();
        simulate("teapot", Object::Phantom(&phantom), &Scanner::synthetic(16, 32), &plan).unwrap()
    }

    const AUTO: Corrections = Corrections { air: Some(AirCorrection::Auto), pixels: Some(PixelCorrection::Auto) };

    #[test]
    fn what_was_taken_out_is_said() {
        let sound = scan(Noise::LOW);
        let mut wrong = sound.clone();
        // In files of another unit.
        wrong.scale = 0.5;
        wrong.train.images += 0.02;
        wrong.train.images.outer_iter_mut().for_each(|mut image| image[[7, 9]] = 0.9);
        let found = remarks(&wrong);
        assert!(found[0].contains("air is 0.0") && found[0].contains("all four borders"), "{found:?}");
        assert!(found[1].contains("1 pixel (row 7, column 9)") && found.len() == 2, "{found:?}");
        let mut right = wrong.clone();
        right.correct(&AUTO).unwrap();
        assert_eq!(remarks(&right), [""; 0]);
        let notes = right.notes.join("; ");
        for part in ["1 pixel (row 7, column 9)", "air of 0.0", "subtracted from all views", "test views is 0"] {
            assert!(notes.contains(part), "{part}: {notes}");
        }
        for ((at, right), sound) in right.train.images.indexed_iter().zip(&sound.train.images) {
            if (at.1, at.2) != (7, 9) {
                within!("corrected", f64::from((right - sound).abs()));
            }
        }
        let value = Corrections { air: Some("0.04".parse().unwrap()), pixels: None };
        wrong.correct(&value).unwrap();
        assert!(wrong.notes.concat().contains("air of 0.04 was subtracted"), "{:?}", wrong.notes);
    }

    #[test]
    fn nothing_is_changed_unasked() {
        let sound = scan(Noise::HIGH);
        let mut same = sound.clone();
        same.correct(&Corrections::default()).unwrap();
        assert_eq!(same, sound);
        same.correct(&AUTO).unwrap();
        assert_eq!(same.train, sound.train, "a sound scan has nothing to correct: {:?}", same.notes);
        let message = "much".parse::<AirCorrection>().unwrap_err().to_string();
        assert!(message.starts_with("`air`: got much, expected auto"), "{message}");
    }
}
