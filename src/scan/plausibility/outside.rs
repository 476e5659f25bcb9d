//! An object that is larger than the volume: rays that miss the volume and read more than air.
//!
//! Such mass is in the readings of other rays, too, whose voxels then must hold it: with sart or tv tens of percent. The
//! views are compared with themselves: air is what the rays farthest outside read, whatever that is.

use super::Evidence;
use crate::borders::{CLEARLY, Side};
use glam::DVec3;
use trgs_core::geometry::{Beam, Grid, Projections, Ray, Scanner, View};
use trgs_core::numeric::threads;

/// Largest number of views examined.
const VIEWS: usize = 24;
/// Standard deviations of the noise that a reading must exceed air by.
const SIGNIFICANT: f64 = 6.0;
/// From the median absolute deviation to the standard deviation of a normal distribution.
const NORMAL: f64 = 1.4826;
/// Quantile of the readings beside the volume that is air.
const AIR: f64 = 0.1;
/// Pixels of a view that must see the object beside the volume: noise passes the median of nine once or twice.
const FEWEST: usize = 3;
/// Share of the views that must see the object beside the volume: single damaged views do not count.
const SHARE: f64 = 0.1;

/// What one view sees beside the volume, scene units from the middle of the volume; 0 for nothing.
#[derive(Clone, Copy, Debug, Default)]
struct Seen {
    /// Distance from the axis of the volume of the farthest ray that sees the object beside the volume.
    radius: f64,
    /// Height of the highest or lowest such ray at the axis of the volume, as a distance from the middle.
    height: f64,
}

/// A remark on an object that is larger than the volume and its layer.
pub(super) fn remark(scan: &Evidence<'_>) -> Option<String> {
    beyond(scan, scan.margin)
}

/// Whether the object is larger than the volume.
pub(super) fn is_larger(scan: &Evidence<'_>) -> bool {
    beyond(scan, 0.0).is_some()
}

/// A remark on an object that is larger than the volume with such a layer.
fn beyond(scan: &Evidence<'_>, margin: f64) -> Option<String> {
    if scan.are_readings {
        return None;
    }
    let (scanner, train) = (&scan.dataset.scanner, &scan.dataset.train);
    let used = train.len().min(VIEWS);
    let around = Scanner { grid: scanner.grid.with_margin(margin), ..*scanner };
    let seen = threads::map(used, |i| look(&around, train, i * train.len() / used));
    let is_cut = |sides: [Side; 2]| sides.iter().any(|&side| scan.borders.at(side).is_cut());
    let farthest = |of: &dyn Fn(&Seen) -> f64| {
        let found: Vec<f64> = seen.iter().map(of).filter(|distance| *distance > 0.0).collect();
        let most = found.iter().fold(0.0, |a: f64, &b| if b > a { b } else { a });
        (found.len() as f64 >= (SHARE * used as f64).max(1.0)).then_some(most)
    };
    let radius = farthest(&|seen| seen.radius);
    // A volume may be a slab of an object that is taller than the detector.
    let height = farthest(&|seen| seen.height).filter(|_| !is_cut([Side::Top, Side::Bottom]));
    if radius.is_none() && height.is_none() {
        return None;
    }
    let (size, spacing) = (scanner.grid.size(), scanner.grid.spacing);
    let at_least = |old: f64, half: Option<f64>| half.map_or(old, |half| old.max(2.0 * half));
    let needed = DVec3::new(at_least(size.x, radius), at_least(size.y, radius), at_least(size.z, height));
    let voxels = (needed / spacing - 1e-9).ceil();
    let whole = voxels * spacing / scan.dataset.scale;
    let margin = (100.0 * (needed - size).max_element() / 2.0 / size.max_element()).ceil() / 100.0;
    let cut = if is_cut([Side::Left, Side::Right]) { " at least" } else { "" };
    let count = seen.iter().filter(|seen| seen.radius > 0.0 || (height.is_some() && seen.height > 0.0)).count();
    Some(format!(
        "the object is larger than the volume: rays that miss the volume see it in {count} of {used} views, and sart, tv and \
         other methods on voxels put its mass inside; set sVoxel to{cut} [{:.4}, {:.4}, {:.4}] and nVoxel to [{}, {}, {}], \
         which keeps the size of the voxels, or set model.margin to {margin:.2}, which reconstructs what is around the volume \
         and does not write it",
        whole.x, whole.y, whole.z, voxels.x, voxels.y, voxels.z
    ))
}

/// What a view sees beside the volume.
fn look(scanner: &Scanner, train: &Projections, number: usize) -> Seen {
    let (view, image) = (train.trajectory().view(scanner, number), train.image(number));
    let (rows, columns) = image.dim();
    let box_of = Box::around(&scanner.grid, &view);
    // The median of a pixel and its neighbours: a single pixel is no object.
    let reading = |row: usize, column: usize| {
        let near = |i: usize, n: usize| i.saturating_sub(1)..(i + 2).min(n);
        let (mut values, mut count) = ([0.0_f32; 9], 0);
        for row in near(row, rows) {
            for column in near(column, columns) {
                values[count] = image[[row, column]];
                count += 1;
            }
        }
        f64::from(*values[..count].select_nth_unstable_by(count / 2, f32::total_cmp).1)
    };
    let mut beside: Vec<(f64, f64, Place)> = Vec::new();
    let mut largest = f64::NEG_INFINITY;
    for row in 0..rows {
        for column in 0..columns {
            let place = box_of.place(&view.ray(row, column));
            let value = reading(row, column);
            largest = if value > largest { value } else { largest };
            if place != Place::Inside {
                beside.push((value, f64::from(image[[row, column]]), place));
            }
        }
    }
    let quantile = |mut values: Vec<f64>, share: f64| {
        let place = (values.len().saturating_sub(1) as f64 * share).round() as usize;
        if values.is_empty() { 0.0 } else { *values.select_nth_unstable_by(place, f64::total_cmp).1 }
    };
    let air = quantile(beside.iter().map(|found| found.0).collect(), AIR);
    // What the median of nine leaves is below the noise of a pixel.
    let noise = NORMAL * quantile(beside.iter().map(|found| (found.1 - found.0).abs()).collect(), 0.5);
    let limit = air + (CLEARLY * (largest - air)).max(SIGNIFICANT * noise);
    let (mut seen, mut counts) = (Seen::default(), [0, 0]);
    for (_, _, place) in beside.iter().filter(|(value, ..)| *value > limit) {
        match *place {
            Place::Beside(radius) => {
                seen.radius = if radius > seen.radius { radius } else { seen.radius };
                counts[0] += 1;
            }
            Place::Above(height) => {
                seen.height = if height > seen.height { height } else { seen.height };
                counts[1] += 1;
            }
            Place::Inside => {}
        }
    }
    let enough = |distance: f64, count: usize| if count < FEWEST { 0.0 } else { distance };
    Seen { radius: enough(seen.radius, counts[0]), height: enough(seen.height, counts[1]) }
}

/// Where a ray passes the volume.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Place {
    /// Through the volume, or less than half a pixel and half a voxel beside it.
    Inside,
    /// Beside it, seen along z, at this distance from its axis.
    Beside(f64),
    /// Above or below it, at this height above or below its middle where it passes the axis.
    Above(f64),
}

/// The volume, enlarged by half a voxel and half a pixel: what a pixel sees of it at its edge is inside.
struct Box {
    middle: DVec3,
    half: DVec3,
}

impl Box {
    fn around(grid: &Grid, view: &View) -> Self {
        let half = grid.size() / 2.0;
        // What half a pixel sees at the far end of the volume.
        let pixel = view.detector.pitch_u.max(view.detector.pitch_v) / 2.0;
        let pixel = match view.beam {
            Beam::Cone { dso, dsd } => pixel * ((dso + half.truncate().length()) / dsd).min(1.0),
            Beam::Parallel { .. } => pixel,
        };
        Self { middle: grid.min + half, half: half + grid.spacing / 2.0 + DVec3::splat(pixel) }
    }

    fn place(&self, ray: &Ray) -> Place {
        let (origin, direction) = (ray.origin - self.middle, ray.direction);
        let slab = |axis: usize| {
            let (o, d, half) = (origin[axis], direction[axis], self.half[axis]);
            if d == 0.0 {
                return if o.abs() <= half { (f64::NEG_INFINITY, f64::INFINITY) } else { (1.0, 0.0) };
            }
            let (a, b) = ((-half - o) / d, (half - o) / d);
            if a < b { (a, b) } else { (b, a) }
        };
        let within = |(a, b): (f64, f64), (c, d): (f64, f64)| (if c > a { c } else { a }, if d < b { d } else { b });
        let across = within(slab(0), slab(1));
        // Where the ray is nearest to the axis of the volume.
        let level = direction.truncate().length_squared();
        let near = if level > 0.0 { -origin.truncate().dot(direction.truncate()) / level } else { 0.0 };
        let nearest = origin + direction * near;
        if across.0 > across.1 {
            return Place::Beside(nearest.truncate().length());
        }
        let all = within(across, slab(2));
        if all.0 > all.1 { Place::Above(nearest.z.abs()) } else { Place::Inside }
    }
}
