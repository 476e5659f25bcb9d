//! Level `large`: scenes whose sizes break the tiles and blocks of parallel programs.

use super::draft::ScannerFile;
use super::draw::{Draw, Row, single};
use std::f64::consts::{PI, TAU};

/// Changes a scene to sizes that break tiles; returns its flag.
///
/// `most` limits the primitives, and `more` draws one. A scene is large in one respect, so that plain programs end as well.
pub(super) fn enlarge(
    draw: &mut Draw,
    most: usize,
    more: impl Fn(&mut Draw) -> Row,
    scanner: &mut ScannerFile,
    angles: &mut Vec<f64>,
    rows: &mut Vec<Row>,
) -> &'static str {
    angles.truncate(if draw.turn(5) == 4 { 3 } else { 1 });
    let mut grow = |draw: &mut Draw, count: usize, size: f64| {
        *rows = (0..count).map(|_| more(draw)).collect();
        rows.iter_mut().for_each(|row| row.scale = row.scale.map(|x| x * size));
    };
    match draw.turn(5) {
        0 => {
            grow(draw, 3, 1.0);
            scanner.n_detector = draw.pick(&[[256, 256], [250, 190], [190, 250]]);
            scanner.n_voxel = [65, 48, 33];
            if draw.huge && draw.chance(0.5) {
                (scanner.n_detector, scanner.n_voxel) = ([512, 512], [256; 3]);
            }
            "large-arrays"
        }
        1 => {
            grow(draw, most, 0.5);
            (scanner.n_detector, scanner.n_voxel) = ([17, 33], [17, 9, 5]);
            "many-primitives"
        }
        2 => {
            grow(draw, 33, 0.25);
            (rows[0].mean, rows[0].scale) = ([0.0; 3], [2.0, 1.5, 2.0]);
            (scanner.n_detector, scanner.n_voxel) = ([65, 100], [33, 17, 20]);
            "covering-primitive"
        }
        3 => {
            grow(draw, 300, 0.125);
            let centre = rows[0].mean;
            for (x, centre) in rows.iter_mut().flat_map(|row| row.mean.iter_mut().zip(centre)) {
                *x = single(centre + *x / 64.0);
            }
            (scanner.n_detector, scanner.n_voxel) = ([40, 48], [20, 18, 17]);
            "crowded-tile"
        }
        _ => {
            let count = draw.pick(&[31, 33, 47, 257, 259]);
            grow(draw, count, 0.5);
            scanner.n_detector = draw.pick(&[[31, 33], [47, 17], [1, 257], [257, 1]]);
            if draw.chance(0.5) {
                *angles = (0..17).map(|_| draw.between(-PI, TAU)).collect();
            }
            scanner.n_voxel = draw.pick(&[[15, 17, 33], [1, 33, 47]]);
            "odd-count"
        }
    }
}
