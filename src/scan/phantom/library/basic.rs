//! Phantoms for tests and first looks; they do not imitate a scan of the paper.

use super::super::solid::{Shape, Solid};
use glam::{DQuat, DVec3};
use rand::RngExt;
use std::f64::consts::{PI, TAU};
use trgs_core::numeric::elementary::{cos, pow, sin};
use trgs_core::numeric::rng::{Purpose, stream};

/// Number of bubbles in the foam.
const BUBBLES: usize = 300;

/// Side of a pixel of the letters.
const PIXEL: f64 = 0.12;
/// Seven rows of five pixels of each letter.
const R: [u8; 7] = [0b11110, 0b10001, 0b10001, 0b11110, 0b10100, 0b10010, 0b10001];
const A: [u8; 7] = [0b01110, 0b10001, 0b10001, 0b11111, 0b10001, 0b10001, 0b10001];
const S: [u8; 7] = [0b01111, 0b10000, 0b10000, 0b01110, 0b00001, 0b00001, 0b11110];

/// The Shepp-Logan head phantom in three dimensions.
///
/// Ellipsoids of A. C. Kak and M. Slaney, *Principles of Computerized Tomographic Imaging*, 1988, with the stronger
/// contrasts of P. Toft, 1996.
pub(in super::super) fn shepp_logan() -> Vec<Solid> {
    // Density, centre, semi-axes, rotation about z in degrees.
    const ELLIPSOIDS: [(f64, [f64; 3], [f64; 3], f64); 10] = [
        (1.0, [0.0, 0.0, 0.0], [0.69, 0.92, 0.9], 0.0),
        (-0.8, [0.0, 0.0, 0.0], [0.6624, 0.874, 0.88], 0.0),
        (-0.2, [-0.22, 0.0, -0.25], [0.41, 0.16, 0.21], 108.0),
        (-0.2, [0.22, 0.0, -0.25], [0.31, 0.11, 0.22], 72.0),
        (0.1, [0.0, 0.35, -0.25], [0.21, 0.25, 0.5], 0.0),
        (0.1, [0.0, 0.1, -0.25], [0.046, 0.046, 0.046], 0.0),
        (0.1, [-0.08, -0.65, -0.25], [0.046, 0.023, 0.02], 0.0),
        (0.1, [0.06, -0.65, -0.25], [0.046, 0.023, 0.02], 90.0),
        (0.1, [0.06, -0.105, 0.625], [0.056, 0.04, 0.1], 90.0),
        (-0.1, [0.0, 0.1, 0.625], [0.056, 0.056, 0.1], 0.0),
    ];
    let solid = |(density, centre, half, degrees): (f64, [f64; 3], [f64; 3], f64)| {
        Solid::new(Shape::Ellipsoid, density, centre.into(), half.into())
            .rotated(DQuat::from_rotation_z(degrees.to_radians()))
    };
    ELLIPSOIDS.map(solid).to_vec()
}

/// A different bar on each axis and a ball of a different density in each octant.
pub(in super::super) fn axes() -> Vec<Solid> {
    let mut solids = vec![
        Solid::new(Shape::Cuboid, 1.0, DVec3::new(0.45, 0.0, 0.0), DVec3::new(0.45, 0.08, 0.05)),
        Solid::new(Shape::Cylinder, 0.7, DVec3::new(0.0, 0.4, 0.0), DVec3::new(0.06, 0.06, 0.3))
            .rotated(DQuat::from_rotation_x(PI / 2.0)),
        Solid::new(Shape::Ellipsoid, 0.4, DVec3::new(0.0, 0.0, 0.35), DVec3::new(0.07, 0.1, 0.25)),
    ];
    for octant in 0..8_u8 {
        let side = |bit: u8| if octant >> bit & 1 == 1 { 0.5 } else { -0.5 };
        let centre = DVec3::new(side(0), side(1), side(2));
        let size = 0.12 + 0.02 * f64::from(octant);
        solids.push(Solid::new(Shape::Ellipsoid, f64::from(octant + 1) / 8.0, centre, DVec3::splat(size)));
    }
    solids
}

/// A cube with the letters of the patient's sides on their faces, each upright for a reader outside: R at -x and A at -y with
/// their tops to +z, S at +z with its top to -y.
pub(in super::super) fn letters() -> Vec<Solid> {
    let mut solids = vec![Solid::new(Shape::Cuboid, 0.3, DVec3::ZERO, DVec3::splat(0.6))];
    for (rows, face, up) in [(R, DVec3::NEG_X, DVec3::Z), (A, DVec3::NEG_Y, DVec3::Z), (S, DVec3::Z, DVec3::NEG_Y)] {
        let right = up.cross(face);
        for (row, pixels) in rows.into_iter().enumerate() {
            for column in (0..5).filter(|column| pixels >> (4 - column) & 1 == 1) {
                let place = right * (f64::from(column) - 2.0) + up * (3.0 - row as f64);
                let pixel = Solid::new(Shape::Cuboid, 0.9, 0.62 * face + PIXEL * place, DVec3::splat(PIXEL / 2.0));
                solids.push(pixel.displacing());
            }
        }
    }
    solids
}

/// A chest: soft tissue 0.45, lungs 0.1 with vessels, heart 0.55, bones up to 0.9. The back is at +y.
pub(in super::super) fn torso() -> Vec<Solid> {
    let ellipsoid =
        |density, centre: [f64; 3], half: [f64; 3]| Solid::new(Shape::Ellipsoid, density, centre.into(), half.into());
    let cylinder =
        |density, centre: [f64; 3], half: [f64; 3]| Solid::new(Shape::Cylinder, density, centre.into(), half.into());
    let mut solids = vec![
        cylinder(0.45, [0.0, 0.0, 0.0], [0.86, 0.6, 0.9]),
        ellipsoid(-0.35, [-0.41, 0.0, 0.08], [0.25, 0.37, 0.66]).rotated(DQuat::from_rotation_y(0.07)),
        ellipsoid(-0.35, [0.44, 0.03, 0.1], [0.21, 0.35, 0.62]).rotated(DQuat::from_rotation_y(-0.09)),
        ellipsoid(0.1, [0.06, -0.17, -0.12], [0.15, 0.17, 0.24]).rotated(DQuat::from_rotation_z(0.5)),
        // Aorta, trachea, breastbone.
        cylinder(0.15, [0.07, 0.2, 0.1], [0.06, 0.06, 0.7]),
        cylinder(-0.42, [-0.03, 0.02, 0.55], [0.045, 0.05, 0.3]),
        cylinder(0.35, [0.0, -0.5, 0.15], [0.09, 0.03, 0.4]),
    ];
    for level in 0..9 {
        let z = -0.76 + 0.19 * f64::from(level);
        // A vertebra and its canal.
        solids.push(cylinder(0.4, [0.0, 0.37, z], [0.11, 0.09, 0.075]));
        solids.push(cylinder(-0.3, [0.0, 0.44, z], [0.03, 0.02, 0.075]));
        // Ribs descend towards the front, in segments that do not overlap.
        for side in [-1.0, 1.0] {
            for piece in 0..7 {
                let turn = 0.45 + 0.33 * f64::from(piece);
                let (across, along) = (0.76 * sin(turn), 0.52 * cos(turn));
                let tangent = DVec3::new(side * 0.76 * cos(turn), -0.52 * sin(turn), -0.06);
                let centre = [side * across, along, z + 0.05 - 0.02 * f64::from(piece)];
                let half = [0.16 * tangent.length(), 0.028, 0.04];
                solids.push(
                    ellipsoid(0.4, centre, half).rotated(DQuat::from_rotation_arc(DVec3::X, tangent.normalize())),
                );
            }
        }
    }
    // Vessels: rods in the lungs, spread by the golden angle.
    for i in 0..24 {
        let (side, turn) = (if i % 2 == 0 { -1.0 } else { 1.0 }, 2.399_963 * f64::from(i));
        let centre = DVec3::new(side * (0.42 + 0.07 * cos(turn)), 0.14 * sin(turn), 0.1 + 0.07 * f64::from(i / 2 - 6));
        let direction = DVec3::new(side, sin(turn), 0.6 * cos(turn)).normalize();
        let rod = Solid::new(Shape::Ellipsoid, 0.35, centre, DVec3::new(0.1, 0.018, 0.018));
        solids.push(rod.rotated(DQuat::from_rotation_arc(DVec3::X, direction)));
    }
    solids
}

/// A ball of density 0.8 with empty bubbles that touch neither each other nor the surface.
pub(in super::super) fn foam(seed: u64) -> Vec<Solid> {
    const BALL: f64 = 0.92;
    let mut bubbles: Vec<(DVec3, f64)> = Vec::with_capacity(BUBBLES);
    for i in 0..BUBBLES {
        // From large to small: at the end, large ones would no longer fit.
        let radius = 0.15 * pow(0.2, i as f64 / BUBBLES as f64);
        let mut draws = stream(seed, Purpose::Phantom, 0, i as u64);
        let place = (0..1000).find_map(|_| {
            let height: f64 = draws.random::<f64>() * 2.0 - 1.0;
            let turn = draws.random::<f64>() * TAU;
            let distance = (BALL - radius) * 0.98 * pow(draws.random::<f64>(), 1.0 / 3.0);
            let around = (1.0 - height * height).sqrt();
            let centre = DVec3::new(around * cos(turn), around * sin(turn), height) * distance;
            bubbles.iter().all(|(other, r)| centre.distance(*other) > 1.02 * (r + radius)).then_some(centre)
        });
        bubbles.extend(place.map(|centre| (centre, radius)));
    }
    let ball = |density, centre, radius| Solid::new(Shape::Ellipsoid, density, centre, DVec3::splat(radius));
    let mut solids = vec![ball(0.8, DVec3::ZERO, BALL)];
    solids.extend(bubbles.into_iter().map(|(centre, radius)| ball(-0.8, centre, radius)));
    solids
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_foam_has_hundreds_of_separate_bubbles_that_follow_the_seed() {
        let solids = foam(4);
        assert!(solids.len() > 250, "{} solids", solids.len());
        assert_eq!(solids, foam(4));
        assert_ne!(solids, foam(5));
        for (i, a) in solids.iter().enumerate().skip(1) {
            for b in &solids[1..i] {
                assert!(a.centre().distance(b.centre()) > a.reach().x + b.reach().x);
            }
        }
    }
}
