//! Pixels of a detector that err in all views: dead and hot ones, and columns that cause rings.
//!
//! Not in the paper. A pixel is *wrong* if it lies, in the median over the views, outside of its eight neighbours (of which
//! the largest and the smallest do not count) by more than
//!
//! - `RELEVANT` of the largest entry of a profile, and
//! - `f` times the distance between the second largest and the second smallest neighbour, at this pixel and in the median
//!   of the pixels around it.
//!
//! A *column* is wrong if it differs in the same way from the three columns at each side: in the median over its rows, and
//! in the upper and the lower quarter of them.
//!
//! **False alarms.** In half of n views, h of them, a sound pixel errs with the probability `C(n, h)·p^h`, if it errs with p
//! in one. `quantile_of_noise` solves `N·C(n, h)·p^h = 0.01` for N pixels and gives the quantile z of normal noise that is
//! exceeded with p: one scan of a hundred has one false alarm by noise. The second largest of eight normal values is at
//! 0.85 σ, and noise that was clipped at 0 has a distance of 0.9 σ between the two neighbours, so `f = (z - 0.85)/0.9`.
//!
//! **Objects.** A feature of an object stays in one pixel of all views if it is on the axis or a ring around it. Then it is
//! symmetric: pixels and columns whose mirror image at the axis errs alike are none of the detector.

use ndarray::{Array2, Array3, ArrayView2, Axis};
use serde::Serialize;
use trgs_core::error::{Error, Result};
use trgs_core::geometry::{Projections, Scanner, Trajectory};
use trgs_core::numeric::elementary::{exp, log};
use trgs_core::numeric::rank::{ONE_SIGMA, median, quantile};
use trgs_core::numeric::threads;

/// Views in which a pixel must err, at least: fewer say nothing about all views.
const LEAST_VIEWS: usize = 5;
/// Views that are examined, at most: more change nothing.
const MOST_VIEWS: usize = 24;
/// Error of a pixel that matters, in units of the largest entry of a profile.
const RELEVANT: f64 = 0.05;
/// Error of a column that matters; it is an artefact of every slice.
const RELEVANT_COLUMN: f64 = 0.01;
/// Expected number of pixels of a sound scan that are called wrong.
const FALSE_ALARMS: f64 = 0.01;
/// Neighbours on each side of a column.
const REACH: usize = 3;
/// Smallest detector, in rows or columns, whose pixels have neighbours.
const LEAST: usize = 8;
/// Error of the mirror image, in units of the pixel's own, from which on both are of the object.
const MIRRORED: f64 = 0.3;
/// A value that no measurement has, in units of the largest value of the median view.
const IMPOSSIBLE: f64 = 100.0;

/// Wrong pixels of a detector.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct WrongPixels {
    /// Single pixels: row and column.
    pub single: Vec<[usize; 2]>,
    /// Whole columns.
    pub columns: Vec<usize>,
    /// Pixels of single views with values that no measurement has: view, row and column.
    pub impossible: Vec<[usize; 3]>,
}

impl WrongPixels {
    /// Finds those of projections.
    ///
    /// Not in the paper: see the head of this page. Tests: `a_hot_pixel_and_a_column_are_found_and_repaired`.
    pub fn of(scanner: &Scanner, views: &Projections) -> Self {
        let (n, rows, columns) = views.images.dim();
        let heights: Vec<f64> = views.images.outer_iter().map(|image| largest(image.iter().copied())).collect();
        let limit = IMPOSSIBLE * median(&mut heights.clone());
        let is_impossible = |value: f32| limit > 0.0 && f64::from(value).abs() > limit;
        let found = views.images.indexed_iter().filter(|(_, value)| is_impossible(**value));
        let impossible: Vec<[usize; 3]> = found.map(|((view, row, column), _)| [view, row, column]).collect();
        let mut wrong = Self { impossible, ..Self::default() };
        if n < LEAST_VIEWS || columns < LEAST {
            return wrong;
        }
        let few = n.min(MOST_VIEWS);
        let images = views.images.select(Axis(0), &(0..few).map(|i| i * n / few).collect::<Vec<_>>());
        let profiles = images.outer_iter().map(|image| {
            largest(image.mean_axis(Axis(0)).into_iter().flatten())
                .max(largest(image.mean_axis(Axis(1)).into_iter().flatten()))
        });
        let peak = median(&mut profiles.collect::<Vec<_>>());
        let axis = column_of_axis(scanner, views.trajectory());
        if rows >= LEAST {
            wrong.single = single(&images, RELEVANT * peak, axis);
        }
        wrong.columns = whole_columns(&images, RELEVANT_COLUMN * peak, axis);
        let columns = &wrong.columns;
        wrong.single.retain(|[_, column]| !columns.contains(column));
        wrong
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.single.is_empty() && self.columns.is_empty() && self.impossible.is_empty()
    }

    /// The pixels that are wrong in all views, `[v, u]`.
    pub fn mask(&self, rows: usize, columns: usize) -> Array2<bool> {
        let mut mask = Array2::from_elem((rows, columns), false);
        self.single.iter().for_each(|&at| mask[at] = true);
        self.columns.iter().for_each(|&column| mask.column_mut(column).fill(true));
        mask
    }

    /// The pixels in words, a few of them by number: `2 pixels (row 3, column 4; …) and 1 column (17)`.
    pub fn describe(&self) -> String {
        const SHOWN: usize = 5;
        let list = |texts: Vec<String>| {
            let more = if texts.len() > SHOWN { "; …" } else { "" };
            format!("{}{more}", texts[..texts.len().min(SHOWN)].join("; "))
        };
        let mut parts = Vec::new();
        if !self.single.is_empty() {
            let places = self.single.iter().map(|[row, column]| format!("row {row}, column {column}")).collect();
            parts.push(format!("{} ({})", trgs_core::words::counted(self.single.len(), "pixel"), list(places)));
        }
        if !self.columns.is_empty() {
            let places = self.columns.iter().map(usize::to_string).collect();
            parts.push(format!("{} ({})", trgs_core::words::counted(self.columns.len(), "whole column"), list(places)));
        }
        parts.join(" and ")
    }
}

/// Replaces the masked pixels of an image by their neighbours, weighted by the inverse of their distance.
///
/// The neighbours are the nearest sound pixels to the left and right, above and below.
///
/// # Errors
/// For a mask of another shape, and for one that leaves no pixel in the row and in the column of a masked one.
///
/// Not in the paper. Tests: `a_hot_pixel_and_a_column_are_found_and_repaired`.
pub fn interpolate(images: &mut Array3<f32>, mask: &Array2<bool>) -> Result<()> {
    let (_, rows, columns) = images.dim();
    if mask.dim() != (rows, columns) {
        let (got, expected) = (format!("shape {:?}", mask.shape()), format!("[{rows}, {columns}] = [v, u]"));
        return Err(Error::invalid("mask of pixels", got, expected, "give a mask of this detector, not 0 where wrong"));
    }
    let mut sources = Vec::new();
    for ((row, column), _) in mask.indexed_iter().filter(|(_, wrong)| **wrong) {
        let sound = |at: &(usize, usize)| !mask[*at];
        let nearest = [
            (0..column).rev().map(|c| (row, c)).find(sound),
            (column + 1..columns).map(|c| (row, c)).find(sound),
            (0..row).rev().map(|r| (r, column)).find(sound),
            (row + 1..rows).map(|r| (r, column)).find(sound),
        ];
        let weighted: Vec<((usize, usize), f64)> = nearest
            .into_iter()
            .flatten()
            .map(|at| (at, 1.0 / (at.0.abs_diff(row) + at.1.abs_diff(column)) as f64))
            .collect();
        if weighted.is_empty() {
            let got = format!("no sound pixel in row {row} and column {column}");
            let remedy = "give a mask whose wrong pixels have sound ones beside them, or crop the frames";
            return Err(Error::invalid("mask of pixels", got, "at least one", remedy));
        }
        sources.push(((row, column), weighted));
    }
    for mut image in images.outer_iter_mut() {
        for (at, weighted) in &sources {
            let sum: f64 = weighted.iter().map(|(from, weight)| weight * f64::from(image[*from])).sum();
            image[*at] = (sum / weighted.iter().map(|(_, weight)| weight).sum::<f64>()) as f32;
        }
    }
    Ok(())
}

fn largest(values: impl Iterator<Item = f32>) -> f64 {
    f64::from(values.fold(0.0_f32, |a, b| if b > a { b } else { a }))
}

/// The column that sees the axis in the first view; beyond all columns where views have poses.
fn column_of_axis(scanner: &Scanner, trajectory: Trajectory<'_>) -> f64 {
    if trajectory.poses.is_some() {
        return f64::INFINITY;
    }
    let view = trajectory.view(scanner, 0);
    let middle = scanner.grid.min + scanner.grid.size() / 2.0;
    let on_axis = glam::DVec3 { x: 0.0, y: 0.0, ..middle };
    view.project(view.to_camera(on_axis)).map_or(f64::INFINITY, |(u, v)| view.detector.pixel(u, v).1)
}

/// The quantile of the absolute value of standard normal noise that half of `views` exceed in one of [`FALSE_ALARMS`]
/// scans of `pixels`.
fn quantile_of_noise(views: usize, pixels: usize) -> f64 {
    let half = views.div_ceil(2);
    // ln C(n, h).
    let choices: f64 = (0..half).map(|i| log((views - i) as f64 / (i + 1) as f64)).sum();
    let p = exp((log(FALSE_ALARMS / pixels as f64) - choices) / half as f64);
    let (mut low, mut high) = (0.0, 12.0);
    for _ in 0..50 {
        let z = 0.5 * (low + high);
        if libm::erfc(z * std::f64::consts::FRAC_1_SQRT_2) > p { low = z } else { high = z }
    }
    low
}

/// What a pixel exceeds its eight neighbours by, signed, and the distance between the second largest and smallest of them.
fn excess(image: ArrayView2<'_, f32>, row: usize, column: usize) -> (f64, f64) {
    let (rows, columns) = image.dim();
    // Beyond the border, neighbours are mirrored.
    let at = |i: usize, step: usize, n: usize| match i + step {
        0 => 1,
        k if k > n => n - 2,
        k => k - 1,
    };
    let mut around = [0.0_f32; 8];
    for (k, value) in around.iter_mut().enumerate() {
        let k = if k < 4 { k } else { k + 1 };
        *value = image[[at(row, k / 3, rows), at(column, k % 3, columns)]];
    }
    around.sort_unstable_by(f32::total_cmp);
    let (low, high, value) = (f64::from(around[1]), f64::from(around[6]), f64::from(image[[row, column]]));
    let excess = if value > high { value - high } else { (value - low).min(0.0) };
    (excess, high - low)
}

/// Whether the mirror image of an error at the axis errs alike.
fn is_mirrored(errors: ArrayView2<'_, f64>, row: usize, column: usize, axis: f64) -> bool {
    let (rows, columns) = errors.dim();
    let mirror = (2.0 * axis - column as f64).round();
    if !(-2.0..columns as f64 + 2.0).contains(&mirror) {
        return false;
    }
    let own = errors[[row, column]];
    let near = |(r, c): (usize, usize)| r.abs_diff(row) <= 1 && (c as f64 - mirror).abs() <= 2.0;
    let rows = row.saturating_sub(1)..(row + 2).min(rows);
    let around = rows.flat_map(|r| (0..columns).map(move |c| (r, c))).filter(|at| near(*at));
    around.into_iter().any(|at| errors[at] * own.signum() > MIRRORED * own.abs())
}

fn single(images: &Array3<f32>, floor: f64, axis: f64) -> Vec<[usize; 2]> {
    let (views, rows, columns) = images.dim();
    let factor = ((quantile_of_noise(views, rows * columns) - 0.85) / 0.9).max(1.0);
    let of_row = |row: usize| -> Vec<[f64; 2]> {
        let of_pixel = |column: usize| {
            let (mut errors, mut widths): (Vec<f64>, Vec<f64>) =
                images.outer_iter().map(|image| excess(image, row, column)).unzip();
            [median(&mut errors), median(&mut widths)]
        };
        (0..columns).map(of_pixel).collect()
    };
    let all: Vec<[f64; 2]> = threads::map(rows, of_row).into_iter().flatten().collect();
    let errors = Array2::from_shape_fn((rows, columns), |(row, column)| all[row * columns + column][0]);
    let mut found = Vec::new();
    for ((row, column), error) in errors.indexed_iter() {
        let width = all[row * columns + column][1];
        if error.abs() <= floor.max(factor * width) || is_mirrored(errors.view(), row, column, axis) {
            continue;
        }
        let (r, c) = (row.saturating_sub(2)..(row + 3).min(rows), column.saturating_sub(2)..(column + 3).min(columns));
        let around = r.flat_map(|r| c.clone().map(move |c| r * columns + c));
        if error.abs() > factor * median(&mut around.map(|at| all[at][1]).collect::<Vec<_>>()) {
            found.push([row, column]);
        }
    }
    found
}

fn whole_columns(images: &Array3<f32>, floor: f64, axis: f64) -> Vec<usize> {
    let (views, rows, columns) = images.dim();
    let quarter = rows.div_ceil(4);
    // For each view and column: the error in the median of all rows, and of the first and the last quarter.
    let of_view = |view: usize| -> Vec<[f64; 3]> {
        let image = images.index_axis(Axis(0), view);
        let of_column = |column: usize| {
            let first = column.saturating_sub(REACH).min(columns - 2 * REACH - 1);
            let around = |row: usize| {
                let mut others: [f64; 2 * REACH] = std::array::from_fn(|k| {
                    let c = first + k;
                    f64::from(image[[row, if c < column { c } else { c + 1 }]])
                });
                f64::from(image[[row, column]]) - median(&mut others)
            };
            let errors: Vec<f64> = (0..rows).map(around).collect();
            let [mut all, mut top, mut bottom] =
                [&errors[..], &errors[..quarter], &errors[rows - quarter..]].map(<[f64]>::to_vec);
            [median(&mut all), median(&mut top), median(&mut bottom)]
        };
        (0..columns).map(of_column).collect()
    };
    let all = threads::map(views, of_view);
    let over_views =
        |column: usize, part: usize| median(&mut all.iter().map(|view| view[column][part]).collect::<Vec<_>>());
    let errors = Array2::from_shape_fn((1, columns), |(_, column)| over_views(column, 0));
    // Errors of neighbours have the quantile of one standard deviation of their absolute values, which is at 1.41 σ.
    let factor = (quantile_of_noise(views, columns) / 1.41).max(3.0);
    let is_wrong = |column: &usize| {
        let column = *column;
        let error = errors[[0, column]];
        let others = (column.saturating_sub(4)..(column + 5).min(columns)).filter(|&c| c != column);
        let mut others: Vec<f64> = others.flat_map(|c| all.iter().map(move |view| view[c][0].abs())).collect();
        let same = |part| over_views(column, part) * error.signum() > 0.5 * error.abs();
        error.abs() > floor.max(factor * quantile(&mut others, ONE_SIGMA))
            && same(1)
            && same(2)
            && !is_mirrored(errors.view(), 0, column, axis)
    };
    (0..columns).filter(is_wrong).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::phantom::Phantom;
    use crate::simulate::{Object, Plan, simulate};
    use crate::{Dataset, Noise};

    fn scan(noise: Noise) -> Dataset {
        let plan = Plan { views: 12, test_views: 0, noise, seed: 1 };
        let phantom = Phantom::by_name("torso", 0).unwrap();
        simulate("torso", Object::Phantom(&phantom), &Scanner::synthetic(16, 32), &plan).unwrap()
    }

    #[test]
    fn a_hot_pixel_and_a_column_are_found_and_repaired() {
        for noise in [Noise::None, Noise::LOW, Noise::HIGH] {
            let sound = scan(noise);
            assert!(WrongPixels::of(&sound.scanner, &sound.train).is_empty(), "{noise}");
            let mut scan = sound.clone();
            let images = &mut scan.train.images;
            for mut image in images.outer_iter_mut() {
                image[[9, 20]] += 0.5;
                image[[21, 6]] = 0.9;
                image[[16, 11]] = -0.1;
                image.column_mut(14).mapv_inplace(|value| value + 0.1);
            }
            images[[3, 2, 2]] = 1e30;
            let wrong = WrongPixels::of(&scan.scanner, &scan.train);
            let expected = WrongPixels {
                single: vec![[9, 20], [16, 11], [21, 6]],
                columns: vec![14],
                impossible: vec![[3, 2, 2]],
            };
            assert_eq!(wrong, expected, "{noise}");
            interpolate(&mut scan.train.images, &wrong.mask(32, 32)).unwrap();
            let left = scan.train.images[[5, 9, 19]] + scan.train.images[[5, 9, 21]];
            let above = scan.train.images[[5, 8, 20]] + scan.train.images[[5, 10, 20]];
            within!("interpolated", f64::from((scan.train.images[[5, 9, 20]] - 0.25 * (left + above)).abs()));
        }
    }

    #[test]
    fn noise_is_exceeded_in_one_scan_of_a_hundred() {
        // C(5, 3)·p³·N = 0.01 for N = 1 has p = 0.1, the two-sided quantile 1.6449 of tables.
        within!((quantile_of_noise(5, 1) - 1.644_853_6).abs());
    }

    #[test]
    fn a_mask_without_sound_pixels_is_refused() {
        let mut images = Array3::zeros((1, 8, 8));
        let all = interpolate(&mut images, &Array2::from_elem((8, 8), true)).unwrap_err().to_string();
        assert!(all.contains("no sound pixel in row 0 and column 0"), "{all}");
        let other = interpolate(&mut images, &Array2::from_elem((8, 9), true)).unwrap_err().to_string();
        assert!(other.contains("got shape [8, 9], expected [8, 8]"), "{other}");
    }
}
