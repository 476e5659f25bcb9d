//! Which rays a step has, and the points along a ray. Not in the paper.

use super::settings::NeuralSettings;
use glam::DVec3;
use rand::seq::index::sample;
use rand_chacha::ChaCha8Rng;
use trgs_core::geometry::{Grid, Projections, Ray, View};
use trgs_core::numeric::rng::{Purpose, stream};

/// The last point of a ray stands for this length.
const LAST: f64 = 1e-10;

/// A ray that meets the box of the volume, from `near` to `far`, and its measured line integral.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct MeasuredRay {
    pub(super) ray: Ray,
    pub(super) near: f64,
    pub(super) far: f64,
    pub(super) value: f64,
}

/// The rays of a step, from one view: pixels of windows, and single pixels outside of them.
///
/// Windows are drawn from all windows of the detector that are complete. Rays that miss the box are left out.
pub(super) fn chosen(
    grid: &Grid,
    views: &[View],
    projections: &Projections,
    settings: &NeuralSettings,
    step: usize,
    unit: f64,
) -> Vec<MeasuredRay> {
    let number = step % views.len();
    let (view, image) = (&views[number], projections.image(number));
    let (rows, columns) = image.dim();
    let mut random = stream(settings.seed, Purpose::Rays, step as u64, 0);
    let mut pixels = windows(rows, columns, settings, &mut random);
    let mut is_taken = vec![false; rows * columns];
    pixels.iter().for_each(|&pixel| is_taken[pixel] = true);
    let value = |pixel: usize| f64::from(image[[pixel / columns, pixel % columns]]) / unit;
    let seen: Vec<usize> =
        (0..rows * columns).filter(|&pixel| !is_taken[pixel] && (settings.sees_air || value(pixel) > 0.0)).collect();
    let mut drawn = sample(&mut random, seen.len(), settings.rays.min(seen.len())).into_vec();
    drawn.sort_unstable();
    pixels.extend(drawn.into_iter().map(|place| seen[place]));
    let of = |pixel: usize| {
        let ray = view.ray(pixel / columns, pixel % columns);
        let [near, far] = crossing(grid, &ray)?;
        Some(MeasuredRay { ray, near, far, value: value(pixel) })
    };
    pixels.into_iter().filter_map(of).collect()
}

/// The pixels of the windows of a step, without overlap.
fn windows(rows: usize, columns: usize, settings: &NeuralSettings, random: &mut ChaCha8Rng) -> Vec<usize> {
    let side = settings.window.max(1);
    let across = columns / side;
    let all = rows / side * across;
    let mut drawn = sample(random, all, settings.windows.min(all)).into_vec();
    drawn.sort_unstable();
    let pixels = |window: usize| {
        let corner = window / across * side * columns + window % across * side;
        (0..side * side).map(move |k| corner + k / side * columns + k % side)
    };
    drawn.into_iter().flat_map(pixels).collect()
}

/// Where a ray enters and leaves the box of the volume.
pub(super) fn crossing(grid: &Grid, ray: &Ray) -> Option<[f64; 2]> {
    let (mut near, mut far) = (f64::NEG_INFINITY, f64::INFINITY);
    let (low, high) = (grid.min, grid.min + grid.size());
    for axis in 0..3 {
        let (origin, direction) = (ray.origin[axis], ray.direction[axis]);
        if direction == 0.0 {
            if origin < low[axis] || origin > high[axis] {
                return None;
            }
            continue;
        }
        let ends = [(low[axis] - origin) / direction, (high[axis] - origin) / direction];
        near = near.max(ends[0].min(ends[1]));
        far = far.min(ends[0].max(ends[1]));
    }
    (near < far).then_some([near, far])
}

/// Points along a ray and the lengths that they stand for, by one number from 0 to 1 for each.
///
/// Each point lies in the part of the ray that is nearest to one of evenly spaced places; the first and the last part
/// are half as long. A point stands for the length to the next one.
pub(super) fn points(ray: &MeasuredRay, draws: &[f64]) -> Vec<(DVec3, f64)> {
    let count = draws.len();
    let step = (ray.far - ray.near) / (count - 1) as f64;
    let place = |k: f64| ray.near + k * step;
    let at = |k: f64, draw: f64| {
        let (from, to) = (place((k - 0.5).max(0.0)), place((k + 0.5).min((count - 1) as f64)));
        from + (to - from) * draw
    };
    let drawn: Vec<f64> = draws.iter().enumerate().map(|(k, &draw)| at(k as f64, draw)).collect();
    let length = |k: usize| drawn.get(k + 1).map_or(LAST, |next| next - drawn[k]);
    (0..count).map(|k| (ray.ray.origin + drawn[k] * ray.ray.direction, length(k))).collect()
}
