//! The views that a check uses, without the errors that no geometry causes.
//!
//! A pixel that errs in every view, and a brightness that differs between views, contradict each other under every
//! geometry. Either of them makes a residual that some roll or offset lowers by chance. Both are removed first.

use super::stated::Stated;
use crate::numeric::threads;
use crate::scene::{Dataset, Projections};
use ndarray::{ArrayView2, ArrayView3, ArrayViewMut2, Axis};

/// Largest number of views used.
const VIEWS: usize = 24;
/// Excess of a line over its neighbours that counts, in robust standard deviations of all lines.
const OUTLIER: f64 = 10.0;
/// Excess of a pixel that counts, in units of the structure around it: this quantile of the excess of its neighbours.
const ABOVE: f64 = 5.0;
const STRUCTURE: f64 = 0.8;
/// Quantile of a line's pixels that must have at least half of its excess.
const END_TO_END: f64 = 0.1;
/// Pixels to each side that are around a pixel.
const NEAR: usize = 2;
/// The same in units of the object's readings: a smaller error changes less than the coarse voxels do.
const VISIBLE: f64 = 0.05;
/// The readings of the object: this quantile of all pixels.
const OBJECT: f64 = 0.98;
/// Farthest neighbours that a pixel is replaced from.
const REACH: isize = 4;
/// Spread of a border in units of the spread between its neighbours: for noise it is 0.7.
const FLAT: f64 = 2.0;
/// Share of the views in which a border must be flat to be air.
const MOST: f64 = 0.9;
/// From the median absolute deviation to the standard deviation of a normal distribution.
const NORMAL: f64 = 1.4826;

/// The views that a check uses.
pub(super) struct Prepared {
    /// Evenly spaced training views, in the order of their angles, on the plain circle.
    pub(super) views: Projections,
    /// Pixels `[v, u]` that err in all views; they were replaced by the mean of their neighbours.
    pub(super) faulty: Vec<[usize; 2]>,
    /// The reading of each view at borders that see air; `None` without such a border.
    pub(super) air: Option<Vec<f64>>,
}

impl Prepared {
    /// Evenly spaced views of a scan, without pixels that err in all of them.
    pub(super) fn new(dataset: &Dataset, stated: &Stated) -> Self {
        let (train, angles) = (&dataset.train, &stated.angles);
        let mut order: Vec<usize> = (0..train.len()).collect();
        order.sort_by(|&a, &b| angles[a].total_cmp(&angles[b]));
        let used = train.len().min(VIEWS);
        let chosen: Vec<usize> = (0..used).map(|i| order[i * train.len() / used]).collect();
        let mut images = train.images.select(Axis(0), &chosen);
        let faulty = faulty(images.view());
        images.outer_iter_mut().for_each(|mut image| repair(&mut image, &faulty));
        let air = air(images.view());
        let angles = chosen.iter().map(|&view| angles[view]).collect();
        Self { views: Projections { poses: None, angles, images }, faulty, air }
    }

    /// The views with air at 0, as far as their borders tell it.
    pub(super) fn with_air_at_zero(&self) -> Option<Projections> {
        let mut views = self.views.clone();
        for (mut image, &air) in views.images.outer_iter_mut().zip(self.air.as_ref()?) {
            image.mapv_inplace(|value| (f64::from(value) - air) as f32);
        }
        Some(views)
    }
}

/// Steps from a pixel to one of each pair of opposite neighbours.
const PAIRS: [[isize; 2]; 4] = [[0, 1], [1, 0], [1, 1], [1, -1]];

/// Single pixels, rows and columns whose excess over their neighbours stands out in the median of all views.
///
/// The excess of a pixel is that over the nearest of the means of opposite neighbours: along an edge there is none. The
/// excess of a row or column is the median of its pixels over the mean of the next two lines.
fn faulty(images: ArrayView3<'_, f32>) -> Vec<[usize; 2]> {
    let (views, rows, columns) = images.dim();
    let excess_in = |view: usize, at: [usize; 2], step: [isize; 2]| {
        let image = images.index_axis(Axis(0), view);
        Some(f64::from(image[at]) - mean_of_pair(image, at, step, &|_| true)?)
    };
    let over_views = |of: &dyn Fn(usize) -> Option<f64>| median((0..views).filter_map(of).collect());
    let of_pixel = |at: [usize; 2]| {
        over_views(&|view| {
            let all = PAIRS.iter().filter_map(|&step| excess_in(view, at, step));
            all.reduce(|a, b| if b.abs() < a.abs() { b } else { a })
        })
    };
    let pixels: Vec<Vec<f64>> = threads::map(rows, |v| (0..columns).map(|u| of_pixel([v, u])).collect());
    let of_line = |pixels: Vec<[usize; 2]>, step: [isize; 2]| {
        let all: Vec<f64> = pixels.into_iter().map(|at| over_views(&|view| excess_in(view, at, step))).collect();
        let middle = median(all.clone());
        // A faulty line errs from end to end; the border of a body ends somewhere.
        let low = quantile(all.into_iter().map(|value| value * middle.signum()).collect(), END_TO_END);
        if low >= middle.abs() / 2.0 { middle } else { 0.0 }
    };
    let of_rows = threads::map(rows, |v| of_line((0..columns).map(|u| [v, u]).collect(), [1, 0]));
    let of_columns = threads::map(columns, |u| of_line((0..rows).map(|v| [v, u]).collect(), [0, 1]));

    let object = quantile(images.index_axis(Axis(0), 0).iter().map(|&value| f64::from(value)).collect(), OBJECT);
    let least = VISIBLE * object;
    // The neighbours of a faulty line have the opposite excess, half as large.
    let outlying_lines = |excess: &[f64]| -> Vec<bool> {
        let size = |i: usize| excess.get(i).map_or(0.0, |value| value.abs());
        let limit = (OUTLIER * NORMAL * median(excess.iter().map(|value| value.abs()).collect())).max(least);
        let is_peak = |i: usize| size(i) >= size(i + 1) && (i == 0 || size(i) >= size(i - 1));
        (0..excess.len()).map(|i| size(i) > limit && is_peak(i)).collect()
    };
    // The border of a body has an excess as well, which its neighbours share.
    let is_outlying = |[v, u]: [usize; 2]| {
        let size = pixels[v][u].abs();
        let near = |i: usize, n: usize| i.saturating_sub(NEAR)..(i + NEAR + 1).min(n);
        let around = near(v, rows).flat_map(|row| near(u, columns).map(move |column| [row, column]));
        let others = around.filter(|&at| at != [v, u]).map(|[row, column]| pixels[row][column].abs()).collect();
        // At the border of the detector there are neighbours in one direction alone.
        let is_inside = v > 0 && u > 0 && v + 1 < rows && u + 1 < columns;
        is_inside && size > least && size > ABOVE * quantile(others, STRUCTURE)
    };
    let (in_rows, in_columns) = (outlying_lines(&of_rows), outlying_lines(&of_columns));
    let all = (0..rows).flat_map(|v| (0..columns).map(move |u| [v, u]));
    all.filter(|&[v, u]| is_outlying([v, u]) || in_rows[v] || in_columns[u]).collect()
}

/// The mean of two opposite neighbours of a pixel, if both are on the detector and good.
fn mean_of_pair(
    image: ArrayView2<'_, f32>,
    [v, u]: [usize; 2],
    [down, right]: [isize; 2],
    is_good: &dyn Fn([usize; 2]) -> bool,
) -> Option<f64> {
    let at = |sign: isize| {
        let place = [v.checked_add_signed(sign * down)?, u.checked_add_signed(sign * right)?];
        image.get(place).filter(|_| is_good(place)).map(|&value| f64::from(value))
    };
    Some((at(1)? + at(-1)?) / 2.0)
}

/// Replaces pixels by the mean of their good opposite neighbours, the nearest pairs that there are.
fn repair(image: &mut ArrayViewMut2<'_, f32>, faulty: &[[usize; 2]]) {
    let is_good = |place: [usize; 2]| faulty.binary_search(&place).is_err();
    let of = |&at: &[usize; 2]| {
        (1..=REACH).find_map(|far| {
            let pairs = PAIRS[..2].iter().map(|step| step.map(|x| x * far));
            let means: Vec<f64> = pairs.filter_map(|step| mean_of_pair(image.view(), at, step, &is_good)).collect();
            (!means.is_empty()).then(|| means.iter().sum::<f64>() / means.len() as f64)
        })
    };
    let values: Vec<Option<f64>> = faulty.iter().map(of).collect();
    for (&at, value) in faulty.iter().zip(values) {
        if let Some(value) = value {
            image[at] = value as f32;
        }
    }
}

/// The median reading of each view over the borders that are flat in most of the views.
fn air(images: ArrayView3<'_, f32>) -> Option<Vec<f64>> {
    let (views, rows, columns) = images.dim();
    let side = |view: usize, side: usize| -> Vec<f64> {
        let image = images.index_axis(Axis(0), view);
        let line = match side {
            0 => image.row(0),
            1 => image.row(rows - 1),
            2 => image.column(0),
            _ => image.column(columns - 1),
        };
        line.iter().map(|&value| f64::from(value)).collect()
    };
    let is_air = |&at: &usize| {
        let flat = (0..views).filter(|&view| is_flat(&side(view, at))).count();
        flat as f64 >= MOST * views as f64
    };
    let sides: Vec<usize> = (0..4).filter(is_air).collect();
    let of = |view: usize| median(sides.iter().flat_map(|&at| side(view, at)).collect());
    (!sides.is_empty()).then(|| (0..views).map(of).collect())
}

/// Whether a line of readings varies no more than neighbouring readings do.
fn is_flat(line: &[f64]) -> bool {
    let spread = |values: Vec<f64>| quantile(values.clone(), 0.75) - quantile(values, 0.25);
    let steps: Vec<f64> = line.windows(2).map(|pair| pair[1] - pair[0]).collect();
    !steps.is_empty() && spread(line.to_vec()) <= FLAT * spread(steps)
}

fn median(values: Vec<f64>) -> f64 {
    let n = values.len();
    (at_place(values.clone(), n / 2) + at_place(values, n.saturating_sub(1) / 2)) / 2.0
}

/// A quantile, without interpolation; 0 without values.
fn quantile(values: Vec<f64>, share: f64) -> f64 {
    let place = (values.len().saturating_sub(1) as f64 * share).round() as usize;
    at_place(values, place)
}

/// The value at a place of the order; 0 without values.
fn at_place(mut values: Vec<f64>, place: usize) -> f64 {
    if values.is_empty() { 0.0 } else { *values.select_nth_unstable_by(place, f64::total_cmp).1 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tolerances::largest;
    use ndarray::Array3;

    /// A bright body that moves through the views over rows 6 to 17, and noise of a thousandth.
    fn images() -> Array3<f32> {
        Array3::from_shape_fn((12, 24, 26), |(view, v, u)| {
            let centre = 12.5 + 4.0 * ((view as f64 - 5.5) / 6.0);
            let (x, y) = ((u as f64 - centre) / 7.0, (v as f64 - 11.5) / 6.0);
            let body = 1.0 - x * x - y * y;
            let noise = ((view * 7919 + v * 104_729 + u * 1299) % 1009) as f64 / 1009.0 - 0.5;
            (body.max(0.0).sqrt() + 0.002 * noise) as f32
        })
    }

    #[test]
    fn pixels_and_lines_that_err_in_all_views_are_found_and_replaced() {
        let sound = images();
        assert_eq!(faulty(sound.view()), [[0; 2]; 0]);
        let mut wrong = sound.clone();
        for mut image in wrong.outer_iter_mut() {
            image[[9, 13]] = 1.8;
            image[[20, 3]] = -0.5;
            image.column_mut(17).mapv_inplace(|value| value + 0.1);
        }
        let found = faulty(wrong.view());
        let expected: Vec<[usize; 2]> = (0..24)
            .flat_map(|v| (0..26).map(move |u| [v, u]))
            .filter(|at| at[1] == 17 || [[9, 13], [20, 3]].contains(at))
            .collect();
        // Beside the column, single pixels at the border of the body may stand out, too.
        assert!(expected.iter().all(|at| found.contains(at)) && found.len() <= expected.len() + 4, "{found:?}");
        wrong.outer_iter_mut().for_each(|mut image| repair(&mut image, &found));
        within!(largest(wrong.iter().zip(&sound).map(|(a, b)| f64::from(a - b))));
    }

    #[test]
    fn air_is_read_where_a_border_is_flat_and_nowhere_else() {
        let mut views = images();
        for (view, mut image) in views.outer_iter_mut().enumerate() {
            image.mapv_inplace(|value| value + 0.01 * view as f32 - 0.03);
        }
        let found = air(views.view()).unwrap();
        within!(largest(found.iter().enumerate().map(|(view, air)| air - (0.01 * view as f64 - 0.03))));
        // A body at all four borders leaves no air.
        let body = Array3::from_shape_fn((6, 20, 20), |(view, v, u)| ((v * v + 3 * u * u + view) as f32).sqrt());
        assert_eq!(air(body.view()), None);
    }
}
