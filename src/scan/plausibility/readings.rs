//! Readings of a detector instead of line integrals.

use super::{ends, is_at_border};
use crate::dataset::Dataset;
use trgs_core::numeric::reduce;
use trgs_core::setting::{Setting, Text};

/// Range of whole numbers from which on they are remarked on.
pub const LEVELS: f64 = 16.0;
/// A whole number, as far as single precision keeps it after scaling.
const WHOLE: f64 = 1e-6;
/// Air of readings: the border of the mean view, in units of the view's largest value, at least.
const AIR: f64 = 0.7;
/// The object in readings: the smallest value of the mean view, in units of its border, at most.
const SHADE: f64 = 0.8;

/// A remark on training views that are readings of a detector.
pub(super) fn remark(dataset: &Dataset) -> Option<Text> {
    let (images, scale) = (&dataset.train.images, dataset.scale);
    let (views, rows, columns) = images.dim();
    let (low, high) = ends(images.iter().map(|&value| f64::from(value) / scale));
    let is_whole = |value: &f32| {
        let value = f64::from(*value) / scale;
        (value - value.round()).abs() <= WHOLE * value.abs()
    };
    let whole = high - low >= LEVELS && images.iter().all(is_whole);
    let mean = |row: usize, column: usize| {
        reduce::sum_by(views, &|view| f64::from(images[[view, row, column]])) / views as f64 / scale
    };
    let pixels: Vec<f64> = (0..rows * columns).map(|pixel| mean(pixel / columns, pixel % columns)).collect();
    let (dark, bright) = ends(pixels.iter().copied());
    let at_border = |pixel: &usize| {
        let (row, column) = (pixel / columns, pixel % columns);
        is_at_border(row, column, [rows, columns])
    };
    let border: Vec<f64> = (0..pixels.len()).filter(at_border).map(|pixel| pixels[pixel]).collect();
    let air = reduce::sum(&border) / border.len().max(1) as f64;
    let shaded = air > 0.0 && air >= AIR * bright && dark <= SHADE * air;
    if !whole && !shaded {
        return None;
    }
    let short = |value: f64| if value.abs() < 100.0 { format!("{value:.4}") } else { format!("{value:.0}") };
    let mut what = vec![format!("training views have values from {} to {}", short(low), short(high))];
    if whole {
        what.push("all of them whole numbers".into());
    }
    if shaded {
        what.push(format!("and air, at their border, is {} instead of 0", short(air)));
    }
    let found = format!(
        "{}: they look like readings of a detector instead of line integrals; convert the frames first: \
         trgs convert FRAMES SCAN ",
        what.join(", ")
    );
    let command = Text::from(found) + Setting::Scanner + " meta_data.json " + Setting::Flat + " FLAT, or ";
    Some(command + Setting::White + format!(" {} without a flat field", short(bright)))
}
