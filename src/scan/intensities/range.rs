//! Readings at the end of their range: a saturated detector, frames that a program has stretched, and unsigned numbers
//! that were stored as signed ones.

use ndarray::{Array3, ArrayView2, Axis};

/// The numbers of bits of detectors and of types, and their largest values.
const FULL: [(u32, f32); 6] = [(8, 255.0), (10, 1023.0), (12, 4095.0), (14, 16_383.0), (15, 32_767.0), (16, 65_535.0)];
/// Share of readings at the end from which on they are remarked on: a hot pixel is none.
const MANY: f64 = 1e-4;

/// Negative readings, in units of the range, from which on they are no noise around a dark field.
const BELOW: f64 = 0.05;

/// A remark on readings `[view, v, u]` that are unsigned numbers of 16 bits stored as signed ones.
///
/// Then those above 32767 are negative. `what` names the readings.
///
/// Not in the paper. Tests: `unsigned_numbers_stored_as_signed_are_told_from_noise`.
pub fn wrapped(what: &str, readings: &Array3<f32>) -> Option<String> {
    let (low, high) = readings.iter().fold((f32::INFINITY, f32::NEG_INFINITY), |(low, high), &value| {
        (if value < low { value } else { low }, if value > high { value } else { high })
    });
    let is_of_type = low >= -32_768.0 && high <= 32_767.0 && readings.iter().all(|value| value.fract() == 0.0);
    let limit = -BELOW * f64::from(high.max(0.0) - low);
    let count = readings.iter().filter(|value| f64::from(**value) < limit).count();
    (is_of_type && low < 0.0 && count as f64 > 0.001 * readings.len() as f64).then(|| {
        format!(
            "the {what} have whole numbers from {low} to {high}, {:.1} % of them negative: they look like unsigned numbers of \
             16 bits stored as signed; store them as unsigned, in Python frames.view('uint16')",
            100.0 * count as f64 / readings.len() as f64
        )
    })
}

/// A remark on readings `[view, v, u]` that are cut off at the largest value of their type, or stretched to it.
///
/// Only whole numbers have such a value. `what` names the readings.
///
/// Not in the paper. Tests: `saturated_and_stretched_frames_are_told_from_sound_ones`.
pub fn full_scale(what: &str, readings: &Array3<f32>) -> Option<String> {
    let largest =
        |values: ndarray::ArrayViewD<'_, f32>| values.iter().fold(f32::NEG_INFINITY, |a, &b| if b > a { b } else { a });
    let full = largest(readings.view().into_dyn());
    let (bits, _) = FULL.into_iter().find(|(_, value)| *value == full)?;
    if readings.iter().any(|value| value.fract() != 0.0) {
        return None;
    }
    let count = readings.iter().filter(|value| **value == full).count();
    let share = count as f64 / readings.len() as f64;
    let views = readings.len_of(Axis(0));
    // A pixel at the end in all frames is a hot one, and says nothing of the frames.
    let is_hot = readings.map_axis(Axis(0), |pixel| pixel.iter().all(|value| *value == full));
    let reaches = |frame: &ArrayView2<'_, f32>| frame.iter().zip(&is_hot).any(|(value, hot)| *value == full && !hot);
    let reach = readings.outer_iter().filter(reaches).count();
    if share >= MANY {
        return Some(format!(
            "{count} readings of the {what} ({:.2} %) are {full}, the largest number of {bits} bits: the detector was \
             saturated, or the frames were stretched; line integrals there are wrong; measure with less exposure, or crop \
             the frames to the part without such readings",
            100.0 * share
        ));
    }
    (views > 1 && reach == views).then(|| {
        format!(
            "all {views} frames of the {what} reach {full}, the largest number of {bits} bits: each seems stretched to its \
             own brightest pixel, so the views contradict each other; export them without contrast adjustment"
        )
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn unsigned_numbers_stored_as_signed_are_told_from_noise() {
        let unsigned =
            Array3::from_shape_fn((2, 30, 30), |(view, row, column)| 20_000 + 1000 * row + 100 * column + view);
        let stored = |value: usize| f32::from(value as u16 as i16);
        let found = wrapped("frames", &unsigned.mapv(stored)).unwrap();
        assert!(found.contains("the frames have whole numbers from -") && found.contains("view('uint16')"), "{found}");
        // All of them above 32767.
        assert!(wrapped("flat field", &unsigned.mapv(|value| stored(value + 13_000))).is_some());
        assert!(wrapped("frames", &unsigned.mapv(|value| value as f32)).is_none(), "not wrapped");
        let noise = unsigned.mapv(|value| (value % 41) as f32 - 20.0 + (value % 2000) as f32);
        assert!(wrapped("dark-corrected frames", &noise).is_none(), "noise around a dark field");
    }

    #[test]
    fn saturated_and_stretched_frames_are_told_from_sound_ones() {
        let frames = |top: f32| {
            Array3::from_shape_fn((4, 120, 120), |(view, row, column)| {
                let value = (top - 1.0 - (view + row + column) as f32).max(0.0);
                if (row, column) == (50, 50 + view) { top } else { value }
            })
        };
        assert!(full_scale("frames", &frames(3000.0)).is_none(), "an ordinary number");
        let stretched = full_scale("scan", &frames(255.0)).unwrap();
        assert!(
            stretched.starts_with("all 4 frames of the scan reach 255, the largest number of 8 bits"),
            "{stretched}"
        );
        let mut cut = frames(60_000.0);
        cut.mapv_inplace(|value| if value > 59_900.0 { 65_535.0 } else { value });
        let found = full_scale("frames", &cut).unwrap();
        assert!(found.contains("are 65535, the largest number of 16 bits") && found.contains('%'), "{found}");
        assert!(full_scale("frames", &cut.mapv(|value| value + 0.25)).is_none(), "no whole numbers");
        // One hot pixel in all views, and in one.
        let mut hot = frames(3000.0);
        hot.outer_iter_mut().for_each(|mut frame| frame[[70, 20]] = 65_535.0);
        assert!(full_scale("frames", &hot).is_none());
        let mut hot = frames(3000.0);
        hot[[2, 50, 50]] = 4095.0;
        assert!(full_scale("frames", &hot).is_none());
    }
}
