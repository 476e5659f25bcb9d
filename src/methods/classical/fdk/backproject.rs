//! The weighted sum of the views at every voxel.

use super::Sample;
use crate::classical::columns::Columns;
use crate::classical::resample::{Places, interpolate, margin};
use glam::DVec3;
use ndarray::Array3;
use std::ops::Range;
use trgs_core::geometry::{Beam, Scanner, View};
use trgs_core::numeric::{real, threads};

/// The slices `x` of the volume `[x, y, z]` on the scanner's grid, from filtered images; `shift` of source and detector
/// along u.
pub(super) fn voxels<R: Sample>(
    filtered: &Columns<R>,
    scanner: &Scanner,
    angles: &[f64],
    shift: f64,
    x: Range<usize>,
) -> Array3<R> {
    let shifted = |view: View| View { source: view.source + view.u * shift, ..view };
    let views: Vec<View> = angles.iter().map(|&angle| shifted(scanner.view(angle))).collect();
    let [_, ny, nz] = scanner.grid.shape;
    let mut values = Array3::from_elem([x.len(), ny, nz], R::ZERO);
    let slices = values.as_slice_mut().expect("a new array is in C order");
    threads::for_each_chunk(slices, ny * nz, |i, slice| {
        let mut profile = vec![R::ZERO; filtered.rows + 2 + margin::<R>()];
        for (number, view) in views.iter().enumerate() {
            for (y, line) in slice.chunks_exact_mut(nz).enumerate() {
                add_view(filtered, scanner, number, view, [x.start + i, y], line, &mut profile);
            }
        }
    });
    values
}

/// Adds a view to the line of voxels along z at (x, y).
///
/// `profile` is scratch: a zero, the rows from below, and zeros for the margin. All voxels of the line have one depth
/// and one detector column position, so the two columns next to it are blended once into a profile.
fn add_view<R: Sample>(
    filtered: &Columns<R>,
    scanner: &Scanner,
    number: usize,
    view: &View,
    xy: [usize; 2],
    line: &mut [R],
    profile: &mut [R],
) {
    let first = view.to_camera(scanner.grid.centre([xy[0], xy[1], 0]));
    let second = view.to_camera(scanner.grid.centre([xy[0], xy[1], 1]));
    let weight = match scanner.beam {
        Beam::Cone { dso, .. } => (dso / first.z) * (dso / first.z),
        Beam::Parallel { .. } => 1.0,
    };
    let pixel = |camera: DVec3| view.project(camera).map(|(u, v)| view.detector.pixel(u, v));
    let (Some((row, column)), Some((next_row, _))) = (pixel(first), pixel(second)) else { return };
    if !(column > -1.0 && column < filtered.columns as f64) {
        return;
    }
    // Counted from the zero below the lowest row.
    let row = filtered.rows as f64 - row;
    let places = Places { first: row, pitch: filtered.rows as f64 - next_row - row };
    // The range where the interpolated image is not 0.
    let voxels = places.within(&(0..line.len()), 0.0, (filtered.rows + 1) as f64);
    if voxels.is_empty() {
        return;
    }

    let column = column + 1.0;
    let (left, fraction) = (column.floor(), column - column.floor());
    let sides = [weight * (1.0 - fraction), weight * fraction].map(real::<R>);
    // `left` counts from the column of zeros before the detector.
    blend(filtered, number, left as usize, sides, &mut profile[1..=filtered.rows]);

    interpolate(profile, places, voxels, line);
}

/// The weighted sum of columns `left - 1` and `left` of a view; columns outside the detector are 0.
fn blend<R: Sample>(filtered: &Columns<R>, view: usize, left: usize, [a, b]: [R; 2], profile: &mut [R]) {
    let image = filtered.view(view);
    let column = |index: usize| &image[index * filtered.rows..][..filtered.rows];
    match (left > 0, left < filtered.columns) {
        (true, true) => {
            for ((out, l), r) in profile.iter_mut().zip(column(left - 1)).zip(column(left)) {
                *out = a * *l + b * *r;
            }
        }
        (false, _) => profile.iter_mut().zip(column(left)).for_each(|(out, &r)| *out = b * r),
        (true, false) => profile.iter_mut().zip(column(left - 1)).for_each(|(out, &l)| *out = a * l),
    }
}

#[cfg(test)]
mod tests {
    use crate::classical::fdk::backproject;
    use ndarray::Array3;
    use trgs_core::geometry::{Beam, Detector, Grid, Scanner};

    #[test]
    fn a_pixel_spreads_over_the_voxels_it_sees() {
        let detector = Detector { rows: 5, columns: 8, pitch_v: 0.45, pitch_u: 0.3, offset_u: 0.1, offset_v: -0.05 };
        let mut images = Array3::<f32>::zeros((2, 5, 8));
        // One pixel in the middle of a view, one in the corner of the other, whose border fades to zero over a pixel.
        (images[[0, 3, 4]], images[[1, 0, 7]]) = (2.0, -1.0);
        let angles = [0.3, 2.0];
        for beam in [Beam::Cone { dso: 4.0, dsd: 6.0 }, Beam::Parallel { dso: 4.0 }] {
            let scanner = Scanner { beam, detector, grid: Grid::cube(14) };
            let volume = backproject(&scanner, &angles, images.view()).unwrap();
            let mut touched = [0; 2];
            for (voxel, &value) in volume.indexed_iter() {
                let mut expected = 0.0;
                for (k, (angle, row, column, g)) in
                    [(0.3, 3.0, 4.0, 2.0), (2.0, 0.0, 7.0, -1.0)].into_iter().enumerate()
                {
                    let view = scanner.view(angle);
                    let camera = view.to_camera(scanner.grid.centre(voxel.into()));
                    let (u, v) = view.project(camera).unwrap();
                    let (r, c) = detector.pixel(u, v);
                    let near: f64 = (1.0 - (r - row).abs()).max(0.0) * (1.0 - (c - column).abs()).max(0.0);
                    let weight = if matches!(beam, Beam::Cone { .. }) { 16.0 / (camera.z * camera.z) } else { 1.0 };
                    touched[k] += usize::from(near > 0.0);
                    expected += weight * near * g;
                }
                within!((f64::from(value) - expected).abs(), "{beam:?} {voxel:?}: {value} against {expected}");
            }
            assert!(touched.iter().all(|&n| n > 5), "{touched:?}");
        }
    }
}
