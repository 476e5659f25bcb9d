//! Whether a reconstruction explains views: its residual beside their noise, and the places where both disagree.
//!
//! A residual above the noise is an error of the volume, of the geometry or of the views. The noise is that of
//! neighbouring pixels of training views, σ = 1.48 · median |a - b - c + d| / 2 over squares of 2 × 2 pixels that show the
//! object; a detector that blurs has more. Test views of simulated scans have none.

use super::section;
use super::slice::short;
use super::viewer::{Depth, Scene};
use crate::error::Result;
use crate::geometry::{Grid, Projections, Scanner, Volume};
use crate::numeric::rank::{SIGMA_OF_MAD, median};
use crate::numeric::threads;
use crate::scan::Frame;
use ndarray::{Array3, ArrayView2, Axis};
use serde::Serialize;

/// Part of the largest measured value from which a square of pixels shows the object: air has less noise.
const OBJECT: f32 = 0.1;
/// Residual in units of the noise up to which a volume explains views, and up to which it nearly does.
const EXPLAINED: [f64; 2] = [1.5, 3.0];
/// Most voxels along a side of the map.
const SIDE: usize = 48;

/// Measured views beside those of a reconstruction.
#[derive(Clone, Debug)]
pub struct Agreement {
    /// Whether the reconstruction was fitted to these views.
    is_fitted: bool,
    /// RMS residual in pixels that show the object.
    residual: f64,
    /// The noise there of training views; `None` where it cannot be measured.
    noise: Option<f64>,
    /// Norm of the residual relative to that of the measured values.
    relative: f64,
    /// The same of each view, and its angle in degrees.
    views: Vec<[f64; 2]>,
    /// RMS over the views of the residual where a voxel's centre is projected, relative to the RMS of all.
    map: Volume,
    /// Parts of the map that all views see, and that none sees.
    seen: [f64; 2],
}

/// The residual of a reconstruction in a few views.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Figures {
    /// `test`, or `training`: those that the reconstruction was fitted to.
    pub views: &'static str,
    /// Their number.
    pub count: usize,
    /// Norm of the residual relative to that of the measured values.
    pub relative: f64,
    /// RMS residual in pixels that show the object, in units of the noise; `None` where that cannot be measured.
    pub per_noise: Option<f64>,
}

impl Agreement {
    /// Compares measured with rendered views, and the residual with the noise of training views; `is_fitted` says that the
    /// reconstruction was fitted to the measured ones.
    ///
    /// # Panics
    /// When the views differ in number or shape.
    ///
    /// # Errors
    /// For values that are not finite.
    pub fn new(
        [measured, rendered]: [&Projections; 2],
        training: &Projections,
        scanner: &Scanner,
        is_fitted: bool,
    ) -> Result<Self> {
        let residuals = &rendered.images - &measured.images;
        let sum = |image: ArrayView2<f32>| image.iter().map(square).sum::<f64>();
        let relative = |residual, of| if of > 0.0 { f64::sqrt(residual / of) } else { 0.0 };
        let sums: Vec<_> = (measured.images.axis_iter(Axis(0)).zip(residuals.axis_iter(Axis(0))))
            .map(|(image, residual)| [sum(residual), sum(image)])
            .collect();
        let of_view = |(angle, [residual, all]): (&f64, &[f64; 2])| [angle.to_degrees(), relative(*residual, *all)];
        let views = measured.angles.iter().zip(&sums).map(of_view).collect();
        let [total, all] = sums.iter().fold([0.0; 2], |sum, part| [sum[0] + part[0], sum[1] + part[1]]);
        let residual = of_object(&measured.images, &residuals);
        let rms = (total / residuals.len() as f64).sqrt();
        let (map, seen) = disagreement(measured, &residuals, scanner, rms)?;
        Ok(Self {
            is_fitted,
            residual,
            noise: noise(&training.images),
            relative: relative(total, all),
            views,
            map,
            seen,
        })
    }

    /// What a file of results holds.
    pub fn figures(&self) -> Figures {
        let per_noise = self.noise.filter(|noise| *noise > 0.0).map(|noise| self.residual / noise);
        Figures {
            views: if self.is_fitted { "training" } else { "test" },
            count: self.views.len(),
            relative: self.relative,
            per_noise,
        }
    }

    /// Whether the residual is no more than noise.
    pub fn is_explained(&self) -> bool {
        self.figures().per_noise.is_some_and(|ratio| ratio <= EXPLAINED[0])
    }

    /// The answer to whether the volume is good.
    pub(super) fn verdict(&self) -> String {
        let Figures { count, relative, per_noise: ratio, .. } = self.figures();
        let views = match self.is_fitted {
            true => format!("{count} of the views that it was fitted to"),
            false => format!("{count} test views, which were not used to make it"),
        };
        let verdict = match ratio {
            None => "The views have no noise that can be measured".into(),
            Some(ratio) if ratio <= EXPLAINED[0] => "The volume explains the views to within the noise".into(),
            Some(ratio) if ratio <= EXPLAINED[1] => {
                format!("The volume explains the views nearly: the residual is {} times the noise", short(ratio))
            }
            Some(ratio) => {
                format!("The volume does not explain the views: the residual is {} times the noise", short(ratio))
            }
        };
        let noise = self.noise.map_or(String::new(), |noise| {
            format!(
                " In pixels that show the object it is {} RMS, and the noise of training views is {}.",
                short(self.residual),
                short(noise)
            )
        });
        let fitted = match self.is_fitted {
            true => " The volume was fitted to them, so a small residual does not prove that it is right.",
            false => "",
        };
        format!(
            "<p><b>{verdict}.</b></p>\n<p>In {views}, the residual is {} % of the measured values.{noise}{fitted}</p>\n",
            short(100.0 * relative)
        )
    }

    /// Angle in degrees, residual in percent.
    pub(super) fn views(&self) -> impl Iterator<Item = [f64; 2]> {
        self.views.iter().map(|[angle, residual]| [*angle, 100.0 * residual])
    }

    /// The section with the map.
    pub(super) fn doubt(&self, frame: &Frame) -> Result<String> {
        let [all, none] = self.seen.map(|part| (1000.0 * part).round() / 10.0);
        let unseen = if none > 0.0 {
            format!(", {} % by none: that part has the highest value", short(none))
        } else {
            String::new()
        };
        let all = short(all);
        let scene = Scene::of_map("Disagreement", "disagreement", &self.map, frame)?;
        let html = format!(
            "<p>Bright: the rays through this place contradict the volume more than others do. A value is the RMS residual of \
             the pixels that the place is projected to, relative to the RMS residual of all pixels.</p>\n\
             <p>{all} % of the volume is seen by all of these views{unseen}.</p>\n{}",
            scene.html(Depth::Eight)
        );
        Ok(section("Where is it doubtful?", &html))
    }
}

fn square(value: &f32) -> f64 {
    f64::from(*value) * f64::from(*value)
}

/// Visits the squares of 2 × 2 pixels that show the object, and the same squares of `others`.
fn each_square(images: &Array3<f32>, others: &Array3<f32>, mut visit: impl FnMut(ArrayView2<f32>, ArrayView2<f32>)) {
    let least = 4.0 * OBJECT * images.iter().copied().fold(0.0, f32::max);
    for (image, other) in images.axis_iter(Axis(0)).zip(others.axis_iter(Axis(0))) {
        for (pixels, other) in image.exact_chunks([2, 2]).into_iter().zip(other.exact_chunks([2, 2])) {
            if pixels.sum() > least {
                visit(pixels, other);
            }
        }
    }
}

/// RMS residual of pixels that show the object.
fn of_object(measured: &Array3<f32>, residuals: &Array3<f32>) -> f64 {
    let (mut sum, mut count) = (0.0, 0_usize);
    each_square(measured, residuals, |_, residual| {
        sum += residual.iter().map(square).sum::<f64>();
        count += residual.len();
    });
    (sum / count.max(1) as f64).sqrt()
}

/// Noise of pixels that show the object; `None` without any.
fn noise(images: &Array3<f32>) -> Option<f64> {
    let mut steps = Vec::with_capacity(images.len() / 4);
    each_square(images, images, |pixels, _| {
        let step = pixels[[0, 0]] - pixels[[0, 1]] - pixels[[1, 0]] + pixels[[1, 1]];
        steps.push(f64::from(step.abs()) / 2.0);
    });
    (!steps.is_empty()).then(|| SIGMA_OF_MAD * median(&mut steps))
}

/// For each voxel of a coarse grid the RMS residual of the views relative to `rms`, and the parts that all see and none.
fn disagreement(
    measured: &Projections,
    residuals: &Array3<f32>,
    scanner: &Scanner,
    rms: f64,
) -> Result<(Volume, [f64; 2])> {
    let grid = Grid::new(scanner.grid.shape.map(|count| count.min(SIDE)), scanner.grid.min, scanner.grid.max())?;
    let views = measured.trajectory().views(scanner);
    let detector = &scanner.detector;
    let [_, columns, depth] = grid.shape;
    let at = |index: usize| {
        let place = [index / (columns * depth), index / depth % columns, index % depth];
        let pixels = views.iter().enumerate().filter_map(|(number, view)| {
            let (u, v) = view.project(view.to_camera(grid.centre(place)))?;
            let (row, column) = detector.pixel(u, v);
            let is_inside = |at: f64, count: usize| at > -0.5 && at < count as f64 - 0.5;
            let is_seen = is_inside(row, detector.rows) && is_inside(column, detector.columns);
            is_seen.then(|| square(&residuals[[number, row.round() as usize, column.round() as usize]]))
        });
        pixels.fold((0.0, 0_usize), |(sum, count), value| (sum + value, count + 1))
    };
    let sums = threads::map(grid.voxels(), at);
    let part = |seen: usize| sums.iter().filter(|(_, count)| *count == seen).count() as f64 / sums.len() as f64;
    let of = |(sum, count): &(f64, usize)| if rms > 0.0 { (sum / (*count).max(1) as f64).sqrt() / rms } else { 0.0 };
    let highest = sums.iter().map(of).fold(1.0, f64::max);
    let value = |found: &(f64, usize)| if found.1 == 0 { highest } else { of(found) } as f32;
    let values = Array3::from_shape_vec(grid.shape, sums.iter().map(value).collect()).expect("one value per voxel");
    Ok((Volume::new(grid, values)?, [part(views.len()), part(0)]))
}

#[cfg(test)]
mod tests {
    use super::*;
    use ndarray::Array2;

    /// Smooth views of a round object; the noise of each pixel is normal.
    fn views(noise: f32) -> Projections {
        use rand_distr::{Distribution, StandardNormal};
        let mut random = crate::numeric::rng::stream(1, crate::numeric::rng::Purpose::Noise, 0, 0);
        let images = Array3::from_shape_fn((4, 40, 40), |(_, row, column)| {
            let [x, y] = [row, column].map(|i| (i as f32 - 19.5) / 20.0);
            let normal: f32 = StandardNormal.sample(&mut random);
            (1.0 - 0.4 * (x * x + y * y)) + noise * normal
        });
        Projections::new((0..4).map(f64::from).collect(), images).unwrap()
    }

    fn scanner() -> Scanner {
        Scanner::synthetic(8, 40)
    }

    #[test]
    fn noise_is_that_of_neighbouring_pixels_and_explains_its_own_residual() {
        let (clean, noisy) = (views(0.0), views(0.02));
        let found = Agreement::new([&noisy, &clean], &noisy, &scanner(), false).unwrap();
        within!("noise", (found.noise.unwrap() / 0.02 - 1.0).abs());
        within!("residual", (found.residual / 0.02 - 1.0).abs());
        assert!(found.is_explained() && found.verdict().contains("to within the noise"));
        // An error of the volume is not noise.
        let wrong = Projections { images: &clean.images * 0.9, ..clean.clone() };
        let found = Agreement::new([&noisy, &wrong], &noisy, &scanner(), true).unwrap();
        assert!(found.figures().per_noise.unwrap() > 3.0 && !found.is_explained());
        let text = found.verdict();
        assert!(text.contains("does not explain the views") && text.contains("does not prove"), "{text}");
    }

    #[test]
    fn the_residual_of_each_view_is_relative_to_its_own_values() {
        let clean = views(0.0);
        let mut wrong = clean.clone();
        wrong.images.index_axis_mut(Axis(0), 2).mapv_inplace(|value| 1.5 * value);
        let found: Vec<_> = Agreement::new([&clean, &wrong], &clean, &scanner(), false).unwrap().views().collect();
        let percents: Vec<_> = found.iter().map(|view| view[1].round()).collect();
        assert_eq!(percents, [0.0, 0.0, 50.0, 0.0]);
        assert_eq!(found[3][0], 3_f64.to_degrees());
    }

    #[test]
    fn the_map_is_brightest_where_the_rays_with_a_residual_meet() {
        let scanner = scanner();
        let clean = views(0.0);
        // The pixel that the voxel (6, 2, 5) is projected to, in each view.
        let centre = scanner.grid.centre([6, 2, 5]);
        let mut wrong = clean.clone();
        for (number, &angle) in clean.angles.iter().enumerate() {
            let view = scanner.view(angle);
            let (u, v) = view.project(view.to_camera(centre)).unwrap();
            let (row, column) = scanner.detector.pixel(u, v);
            wrong.images[[number, row.round() as usize, column.round() as usize]] += 1.0;
        }
        let found = Agreement::new([&clean, &wrong], &clean, &scanner, false).unwrap();
        let highest = found.map.values.indexed_iter().max_by(|a, b| a.1.total_cmp(b.1)).unwrap();
        assert_eq!(highest.0, (6, 2, 5));
        // All 4 of 6400 pixels that differ meet there.
        within!("map", (f64::from(*highest.1) - 40.0).abs());
        assert_eq!(found.seen, [1.0, 0.0]);
    }

    #[test]
    fn places_that_no_view_sees_are_doubtful_and_views_without_noise_are_said_to_have_none() {
        let mut scanner = scanner();
        scanner.detector.pitch_v /= 4.0;
        let flat = Projections::new(vec![0.0], Array2::ones((40, 40)).insert_axis(Axis(0))).unwrap();
        let wrong = Projections { images: &flat.images * 1.1, ..flat.clone() };
        let found = Agreement::new([&flat, &wrong], &flat, &scanner, false).unwrap();
        let [all, none] = found.seen;
        assert!(all > 0.0 && none > all);
        assert_eq!(found.map.values[[0, 0, 0]], 1.0);
        assert!(found.figures().per_noise.is_none() && found.verdict().contains("no noise that can be measured"));
    }
}
