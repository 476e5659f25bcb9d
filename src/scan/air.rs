//! The line integral of air, measured at the borders of projections.
//!
//! Not in the paper. Air has the line integral 0. A flat field of another exposure, or a wrong reading without an object,
//! adds one constant to all line integrals; a source that drifts adds one to each view. Attenuation is never negative, so
//! that air is the lowest level of a view; unlike an object that leaves the detector, it is the same along the borders.
//!
//! The borders are divided into *places*: up to eight along each side, each with an outer and an inner strip. A place is
//! flat if the medians of its two strips agree. The *air* of a view is the median of all pixels of the flat places that
//! agree with the lowest ones, if these are a fifth of all places and half of those of two opposite sides. The air of a scan is the
//! median over the views, if at least half of them see any.
//!
//! "Agree" means within `AGREE` standard errors of a median. They follow from second differences along the strips, which
//! a slope of the object leaves as they are. The mean step from the inner to the outer strips of a view must be 0 in the
//! median over the views: a slope that noise hides in one view is none of air.

use ndarray::{ArrayView2, ArrayView3};
use std::ops::Range;
use trgs_core::numeric::Real;
use trgs_core::numeric::rank::{ERROR_OF_MEDIAN, ONE_SIGMA, WITHIN_ONE_SIGMA, median, quantile, spread};

/// Standard errors within which two medians agree.
const AGREE: f64 = 4.0;
/// Standard errors from which on air differs from 0, and one view from the others.
const SIGNIFICANT: f64 = 5.0;
/// Air that matters, in units of the largest entry of a profile: scatter and the source of a sound scan cause a percent.
const RELEVANT: f64 = 0.01;
/// Rounding of single precision, in units of the largest entry of a profile.
const ROUNDING: f64 = 1e-6;
/// Entries of a side from which on it has places.
const LEAST: usize = 8;
/// Places along a side, at most.
const PLACES: usize = 8;
/// Share of the places that see air in a view.
const SHARE: f64 = 0.2;

/// A side of the detector, as an index of [`Borders::sides`](super::borders::Borders::sides).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Side {
    /// Column 0.
    Left,
    /// The last column.
    Right,
    /// Row 0.
    Top,
    /// The last row.
    Bottom,
}

impl Side {
    /// All sides, in the order of [`Borders::sides`](super::borders::Borders::sides).
    pub const ALL: [Self; 4] = [Self::Left, Self::Right, Self::Top, Self::Bottom];

    /// Its name in messages.
    pub fn name(self) -> &'static str {
        match self {
            Self::Left => "left",
            Self::Right => "right",
            Self::Top => "top",
            Self::Bottom => "bottom",
        }
    }
}

/// The air of projections, in their unit.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Air {
    /// The median over the views.
    pub level: f64,
    /// Its standard error.
    pub error: f64,
    /// The air of each view, where it is seen.
    pub views: Vec<Option<f64>>,
    /// Standard error of the air of a view.
    pub view_error: f64,
    /// Standard deviation over the views, without the outermost ones.
    pub spread: f64,
    /// The sides that see air in at least half of the views.
    pub sides: Vec<Side>,
    /// Standard deviation of the noise of a pixel.
    pub noise: f64,
    /// Mean of the pixels in air less their median: noise that was clipped at 0 has one.
    pub bias: f64,
    /// The largest entry of a profile, above air: the median over the views.
    pub peak: f64,
}

/// A part of a border.
struct Place {
    side: Side,
    outer: [Range<usize>; 2],
    inner: [Range<usize>; 2],
}

/// The air of one view.
struct OfView {
    level: f64,
    error: f64,
    noise: f64,
    bias: f64,
    step: f64,
    seen: [bool; 4],
}

impl Air {
    /// Measures the air of images `[view, v, u]`; `None` if less than half of the views see any.
    ///
    /// Not in the paper: see the head of this page. Tests: `a_constant_is_air_and_an_object_is_not`,
    /// `noise_that_was_clipped_has_no_air`.
    pub fn of<R: Real>(images: ArrayView3<'_, R>) -> Option<Self> {
        let (views, rows, columns) = images.dim();
        let places = places(rows, columns);
        let height = |image: ArrayView2<'_, R>| largest_mean(image).max(largest_mean(image.reversed_axes()));
        let mut peaks: Vec<f64> = images.outer_iter().map(height).collect();
        let peak = median(&mut peaks);
        let found: Vec<Option<OfView>> =
            images.outer_iter().map(|image| OfView::of(image, &places, ROUNDING * peak.abs())).collect();
        let seen: Vec<&OfView> = found.iter().flatten().collect();
        if seen.is_empty() || 2 * seen.len() < views {
            return None;
        }
        let middle = |of: fn(&OfView) -> f64| median(&mut seen.iter().map(|view| of(view)).collect::<Vec<_>>());
        let levels: Vec<f64> = seen.iter().map(|view| view.level).collect();
        let (level, view_error, spread) = (middle(|view| view.level), middle(|view| view.error), spread(&levels));
        let sees = |side: &Side| 2 * seen.iter().filter(|view| view.seen[*side as usize]).count() >= seen.len();
        let root = (seen.len() as f64).sqrt();
        let steps: Vec<f64> = seen.iter().map(|view| view.step).collect();
        if middle(|view| view.step).abs()
            > AGREE * ERROR_OF_MEDIAN * self::spread(&steps) / root + ROUNDING * peak.abs()
        {
            return None;
        }
        Some(Self {
            level,
            error: (ERROR_OF_MEDIAN * spread).max(view_error) / root,
            views: found.iter().map(|view| view.as_ref().map(|view| view.level)).collect(),
            view_error,
            spread,
            sides: Side::ALL.into_iter().filter(sees).collect(),
            noise: middle(|view| view.noise),
            bias: middle(|view| view.bias),
            peak: peak - level,
        })
    }

    /// Whether a value differs from 0 by as much as matters.
    fn matters(&self, value: f64) -> bool {
        value.abs() > RELEVANT * self.peak
    }

    /// Whether air varies over the views by more than its errors, and by as much as matters.
    pub fn drifts(&self) -> bool {
        // Deviations of 3 standard errors of a view are outside of what the median of them reaches.
        self.spread > 3.0 * self.view_error && self.matters(self.spread)
    }

    /// Whether the air of all views differs from 0 by more than its error, and by as much as matters.
    pub fn is_offset(&self) -> bool {
        self.level.abs() > SIGNIFICANT * self.error && self.matters(self.level)
    }

    /// The views whose air differs from that of the others by more than a drift explains.
    pub fn outliers(&self) -> Vec<usize> {
        let limit = SIGNIFICANT * self.view_error.max(self.spread);
        let differs = |level: &Option<f64>| {
            level.is_some_and(|level| (level - self.level).abs() > limit && self.matters(level - self.level))
        };
        (0..self.views.len()).filter(|&view| differs(&self.views[view])).collect()
    }

    /// What is to be taken as air in a view: 0, as long as the measured air may be 0.
    pub fn at(&self, view: usize) -> f64 {
        if self.drifts() || self.outliers().contains(&view) {
            self.views[view].unwrap_or(self.level)
        } else if self.is_offset() {
            self.level
        } else {
            0.0
        }
    }
}

impl OfView {
    fn of<R: Real>(image: ArrayView2<'_, R>, places: &[Place], rounding: f64) -> Option<Self> {
        let pixels = |[rows, columns]: &[Range<usize>; 2]| -> Vec<f64> {
            let part = rows.clone().flat_map(|row| columns.clone().map(move |column| (row, column)));
            part.map(|at| Real::to_f64(image[at])).collect()
        };
        struct Measured {
            place: usize,
            level: f64,
            step: f64,
            error: f64,
            pixels: Vec<f64>,
        }
        let measure = |(place, Place { side, outer, inner }): (usize, &Place)| {
            let noise = noise(image, *side, outer, inner);
            let (mut outer, mut inner) = (pixels(outer), pixels(inner));
            let (a, b) = (median(&mut outer), median(&mut inner));
            let count = outer.len().min(inner.len()) as f64;
            outer.append(&mut inner);
            let error = ERROR_OF_MEDIAN * noise / count.sqrt();
            Measured { place, level: 0.5 * (a + b), step: a - b, error, pixels: outer }
        };
        let all: Vec<Measured> = places.iter().enumerate().map(measure).collect();
        let mut errors: Vec<f64> = all.iter().map(|place| place.error).collect();
        errors.sort_unstable_by(f64::total_cmp);
        errors.truncate(errors.len().div_ceil(2));
        let close = AGREE * median(&mut errors) + rounding;
        // The difference of two medians has √2 times the error of one.
        let flat: Vec<&Measured> =
            all.iter().filter(|place| place.step.abs() <= std::f64::consts::SQRT_2 * close).collect();
        let mut level = quantile(&mut flat.iter().map(|place| place.level).collect::<Vec<_>>(), 0.1);
        let mut members: Vec<&Measured> = Vec::new();
        for _ in 0..3 {
            members = flat.iter().copied().filter(|place| (place.level - level).abs() <= close).collect();
            level = median(&mut members.iter().map(|place| place.level).collect::<Vec<_>>());
        }
        let seen = Side::ALL.map(|side| {
            let found = members.iter().filter(|member| places[member.place].side == side).count();
            found > 0 && 2 * found >= places.iter().filter(|place| place.side == side).count()
        });
        let opposite = (seen[0] && seen[1]) || (seen[2] && seen[3]);
        if !opposite || (members.len() as f64) < SHARE * places.len() as f64 {
            return None;
        }
        let mut pool: Vec<f64> = members.iter().flat_map(|member| member.pixels.iter().copied()).collect();
        let levels: Vec<f64> = members.iter().map(|member| member.level).collect();
        let level = median(&mut pool);
        // Above the median, noise that was clipped at 0 is as it was.
        let noise = quantile(&mut pool, ONE_SIGMA) - level;
        let step = members.iter().map(|member| member.step).sum::<f64>() / members.len() as f64;
        let of_places = spread(&levels) / (levels.len() as f64).sqrt();
        let of_pixels = noise / (pool.len() as f64).sqrt();
        // Hot pixels are left out of the mean.
        pool.retain(|value| (value - level).abs() <= SIGNIFICANT * noise);
        let mean = pool.iter().sum::<f64>() / pool.len().max(1) as f64;
        Some(Self { level, error: ERROR_OF_MEDIAN * of_places.max(of_pixels), noise, bias: mean - level, step, seen })
    }
}

/// Standard deviation of the noise of a pixel, from second differences: along the side, or across it on a single line.
fn noise<R: Real>(image: ArrayView2<'_, R>, side: Side, outer: &[Range<usize>; 2], inner: &[Range<usize>; 2]) -> f64 {
    let is_upright = matches!(side, Side::Left | Side::Right);
    let along = usize::from(!is_upright);
    let mut differences = Vec::new();
    let mut add = |rows: Range<usize>, columns: Range<usize>, is_along_rows: bool| {
        let (n, m) = if is_along_rows { (rows.len(), columns.len()) } else { (columns.len(), rows.len()) };
        for line in 0..m {
            let at = |k: usize| {
                let at = if is_along_rows {
                    [rows.start + k, columns.start + line]
                } else {
                    [rows.start + line, columns.start + k]
                };
                Real::to_f64(image[at])
            };
            differences.extend((2..n).map(|k| (at(k) - 2.0 * at(k - 1) + at(k - 2)).abs()));
        }
    };
    if outer[along].len() > 2 {
        for [rows, columns] in [outer, inner] {
            add(rows.clone(), columns.clone(), is_upright);
        }
    } else {
        let join = |i: usize| outer[i].start.min(inner[i].start)..outer[i].end.max(inner[i].end);
        add(join(0), join(1), !is_upright);
    }
    // The sum of squares of the factors 1, -2 and 1 is 6.
    if differences.is_empty() { 0.0 } else { quantile(&mut differences, WITHIN_ONE_SIGMA) / 6.0_f64.sqrt() }
}

/// The largest mean of a row.
fn largest_mean<R: Real>(image: ArrayView2<'_, R>) -> f64 {
    let mean = |row: ndarray::ArrayView1<'_, R>| {
        row.iter().map(|&value| Real::to_f64(value)).sum::<f64>() / row.len().max(1) as f64
    };
    image.outer_iter().map(mean).fold(f64::NEG_INFINITY, |a, b| if b > a { b } else { a })
}

fn places(rows: usize, columns: usize) -> Vec<Place> {
    let mut places = Vec::new();
    let depth = |n: usize| if n < 2 * LEAST { 1 } else { (n / 32).max(2) };
    let parts = |n: usize| {
        let count = (n / 4).clamp(1, PLACES);
        (0..count).map(move |i| n * i / count..n * (i + 1) / count)
    };
    if columns >= LEAST {
        let (d, n) = (depth(columns), columns);
        for part in parts(rows) {
            let place = |side, outer, inner| Place { side, outer: [part.clone(), outer], inner: [part.clone(), inner] };
            places.push(place(Side::Left, 0..d, d..2 * d));
            places.push(place(Side::Right, n - d..n, n - 2 * d..n - d));
        }
    }
    if rows >= LEAST {
        let (d, n) = (depth(rows), rows);
        for part in parts(columns) {
            let place = |side, outer, inner| Place { side, outer: [outer, part.clone()], inner: [inner, part.clone()] };
            places.push(place(Side::Top, 0..d, d..2 * d));
            places.push(place(Side::Bottom, n - d..n, n - 2 * d..n - d));
        }
    }
    places
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Noise;
    use crate::phantom::Phantom;
    use crate::simulate::{Object, Plan, simulate};
    use ndarray::Array3;
    use trgs_core::geometry::Scanner;

    fn images(noise: Noise) -> Array3<f32> {
        let plan = Plan { views: 12, test_views: 0, noise, seed: 1 };
        let phantom = Phantom::by_name("teapot", 0).unwrap();
        simulate("teapot", Object::Phantom(&phantom), &Scanner::synthetic(16, 32), &plan).unwrap().train.images
    }

    #[test]
    fn a_constant_is_air_and_an_object_is_not() {
        for noise in [Noise::None, Noise::LOW, Noise::HIGH] {
            let sound = images(noise);
            for offset in [0.2_f32, -0.3] {
                let air = Air::of((&sound + offset).view()).unwrap();
                assert!(air.is_offset() && !air.drifts() && air.sides.len() == 4, "{noise} {air:?}");
                within!("level", (air.level - f64::from(offset)).abs() / air.peak);
                assert_eq!(air.at(3), air.level);
            }
            let mut drifting = sound.clone();
            let of_view = |view: usize| 0.03 * (view as f32 / 5.5 - 1.0);
            drifting.outer_iter_mut().enumerate().for_each(|(view, mut image)| image += of_view(view));
            let air = Air::of(drifting.view()).unwrap();
            assert!(air.drifts(), "{noise} {air:?}");
            for view in 0..12 {
                within!("drift", (air.at(view) - f64::from(of_view(view))).abs() / air.peak);
            }
        }
        // A long cylinder wider than the detector: both borders are alike in all views, but not flat.
        let chord = |column: usize| {
            let aside = (column as f32 - 15.5) / 16.0;
            2.0 * (4.0 - aside * aside).sqrt()
        };
        let wide = Array3::from_shape_fn((12, 32, 32), |(_, _, column)| chord(column));
        assert_eq!(Air::of(wide.view()), None);
    }

    #[test]
    fn noise_that_was_clipped_has_no_air() {
        let air = Air::of(images(Noise::HIGH).view()).unwrap();
        assert!(!air.is_offset() && !air.drifts() && air.outliers().is_empty() && air.at(0) == 0.0, "{air:?}");
        // The mean of the positive half of a normal distribution.
        within!("bias", (air.bias / air.noise - 0.399).abs());
    }
}
