//! Parts of the human body: chest, foot, head, jaw, pancreas. x is left, the back is at +y, z is up.

use super::parts::{Chance, Parts, arc, curve, pulled_into};
use glam::{DVec3, dvec3};
use std::f64::consts::PI;
use trgs_core::numeric::elementary::{cos, sin};

/// Densities of tissues, on a scale where compact bone is 0.85.
const AIR: f64 = 0.0;
const LUNG: f64 = 0.08;
const FAT: f64 = 0.27;
const WATER: f64 = 0.32;
const MUSCLE: f64 = 0.37;
const ORGAN: f64 = 0.42;
const BLOOD: f64 = 0.48;
const MARROW: f64 = 0.5;
const BONE: f64 = 0.85;
const ENAMEL: f64 = 1.0;

/// The two sides of the body.
const SIDES: [f64; 2] = [-1.0, 1.0];

/// A long bone: compact shell, marrow, and thicker ends.
fn bone(parts: &mut Parts, ends: [DVec3; 2], radius: f64) {
    let [from, to] = ends;
    parts.capsule(BONE, ends, radius);
    parts.ball(BONE, from, radius * 1.25);
    parts.ball(BONE, to, radius * 1.25);
    parts.capsule(MARROW, [from.lerp(to, 0.04), from.lerp(to, 0.96)], radius * 0.62);
}

/// A short bone: compact shell and marrow.
fn ossicle(parts: &mut Parts, centre: DVec3, half: DVec3, axis: DVec3) {
    parts.ellipsoid_along(BONE, centre, half, axis);
    parts.ellipsoid_along(MARROW, centre, half - 0.035, axis);
}

/// A column of vertebrae from z to z, with the canal behind them.
fn spine(parts: &mut Parts, [low, high]: [f64; 2], count: usize, y: f64, radius: f64) {
    let pitch = (high - low) / count as f64;
    for i in 0..count {
        let z = low + pitch * (i as f64 + 0.5);
        let half = dvec3(radius, 0.8 * radius, 0.4 * pitch);
        parts.cylinder(BONE, [0.0, y + 1.35 * radius, z], [0.55 * radius, 0.55 * radius, 0.3 * pitch]);
        parts.cylinder(WATER, [0.0, y + 1.2 * radius, z], [0.36 * radius, 0.32 * radius, 0.5 * pitch]);
        parts.cylinder(BONE, [0.0, y, z], half);
        parts.cylinder(MARROW, [0.0, y, z], half * dvec3(0.8, 0.8, 0.75));
        let back = dvec3(0.0, y + 1.7 * radius, z);
        parts.strap(BONE, [back, back + dvec3(0.0, 0.6 * radius, -0.3 * pitch)], DVec3::X, [0.02, 0.3 * pitch]);
        for side in SIDES {
            let root = dvec3(side * 0.5 * radius, y + 1.3 * radius, z);
            parts.capsule(BONE, [root, root + dvec3(side * radius, 0.3 * radius, 0.0)], 0.028);
        }
    }
}

/// Vessels or airways that bifurcate until they are thin, kept inside an ellipsoid.
fn tree(parts: &mut Parts, chance: &mut Chance, density: f64, stem: [DVec3; 2], radius: f64, room: [DVec3; 2]) {
    let [from, way] = stem;
    let to = pulled_into(from + way, room[0], room[1]);
    if from.distance(to) < 0.02 {
        return;
    }
    parts.capsule(density, [from, to], radius);
    if radius > 0.011 {
        let aside = way.cross(chance.direction()).normalize() * way.length();
        for side in SIDES {
            let next = (way * 0.75 + aside * side * chance.between(0.4, 0.7)) * chance.between(0.8, 1.0);
            tree(parts, chance, density, [to, next], radius * 0.74, room);
        }
    }
}

pub(in super::super) fn chest(parts: &mut Parts, chance: &mut Chance) {
    parts.cylinder(FAT, [0.0, 0.0, 0.0], [chance.about(0.89, 0.02), chance.about(0.61, 0.03), 0.93]);
    parts.cylinder(MUSCLE, [0.0, 0.0, 0.0], [0.84, 0.56, 0.93]);
    // Fat between the shoulder's muscles, lungs, and the liver below the right one.
    for side in SIDES {
        parts.ellipsoid(FAT, [side * 0.72, 0.05, 0.72], [0.06, 0.25, 0.18]);
    }
    let lungs = [dvec3(-0.38, -0.02, 0.08), dvec3(0.39, 0.0, 0.06)];
    let halves = [dvec3(chance.about(0.28, 0.04), 0.4, 0.68), dvec3(chance.about(0.26, 0.04), 0.39, 0.7)];
    for i in 0..2 {
        parts.ellipsoid(LUNG, lungs[i], halves[i]);
    }
    parts.ellipsoid(ORGAN, [-0.36, -0.05, -0.6], [0.36, 0.42, chance.about(0.3, 0.08)]);
    parts.ellipsoid(ORGAN, [0.42, 0.1, -0.68], [0.3, 0.35, 0.24]);
    parts.ellipsoid(WATER, [0.4, -0.15, -0.72], [0.2, 0.16, 0.14]);
    for (i, side) in SIDES.into_iter().enumerate() {
        let room = [lungs[i], halves[i] * 0.96];
        let hilum = dvec3(side * 0.17, 0.0, 0.12);
        for k in 0..3 {
            let mut draws = parts.chance(10 + 3 * i as u64 + k);
            let way = dvec3(side * 0.14, draws.between(-0.12, 0.12), 0.2 * k as f64 - 0.2);
            tree(parts, &mut draws, MUSCLE, [hilum, way], 0.028, room);
        }
    }
    let mut draws = parts.chance(1);
    let nodule = lungs[1] + draws.inside() * 0.2 + dvec3(0.02, 0.0, 0.2);
    parts.ball(ORGAN, nodule, draws.between(0.025, 0.045));
    // The heart with its chambers, aorta, vena cava.
    let heart = dvec3(0.1, -0.2, -0.2) + draws.shift(0.02);
    let axis = dvec3(0.6, -0.4, -0.7);
    parts.ellipsoid_along(FAT, heart, dvec3(0.235, 0.225, 0.32), axis);
    parts.ellipsoid_along(MUSCLE, heart, dvec3(0.22, 0.21, 0.305), axis);
    parts.ellipsoid_along(BLOOD, heart + dvec3(0.07, 0.03, -0.02), dvec3(0.085, 0.085, 0.17), axis);
    parts.ellipsoid_along(BLOOD, heart + dvec3(-0.08, -0.04, -0.02), dvec3(0.075, 0.1, 0.17), axis);
    parts.ellipsoid(BLOOD, heart + dvec3(-0.07, 0.08, 0.17), [0.09, 0.08, 0.09]);
    let aorta = curve(9, |t| {
        let turn = PI * (1.0 - t);
        dvec3(0.02 + 0.06 * (1.0 - cos(PI * t)), 0.04 + 0.16 * cos(turn), 0.3 + 0.16 * sin(turn))
    });
    parts.tube(BLOOD, &aorta, |_| 0.06);
    parts.rod(BLOOD, [dvec3(0.02, -0.12, -0.05), aorta[0]], 0.06);
    parts.rod(BLOOD, [aorta[9], dvec3(0.11, 0.22, -0.93)], 0.055);
    parts.rod(BLOOD, [dvec3(-0.11, -0.1, 0.0), dvec3(-0.12, -0.08, 0.75)], 0.045);
    // Windpipe and bronchi.
    let fork = dvec3(-0.01, 0.06, 0.24);
    for (density, extra) in [(MUSCLE, 0.018), (AIR, 0.0)] {
        parts.rod(density, [fork, dvec3(0.0, 0.02, 0.93)], 0.045 + extra);
        for side in SIDES {
            parts.capsule(density, [fork, dvec3(side * 0.2, 0.02, 0.1)], 0.03 + extra);
        }
    }
    spine(parts, [-0.93, 0.93], 10, 0.33, 0.11);
    ribs(parts);
    // Breastbone, collarbones, shoulder blades.
    parts.strap(BONE, [dvec3(0.0, -0.46, 0.45), dvec3(0.0, -0.5, -0.25)], DVec3::Y, [0.028, 0.075]);
    parts.strap(MARROW, [dvec3(0.0, -0.46, 0.42), dvec3(0.0, -0.5, -0.22)], DVec3::Y, [0.014, 0.055]);
    for side in SIDES {
        let neck = dvec3(side * 0.09, -0.42, 0.58);
        bone(parts, [neck, dvec3(side * 0.62, -0.12, 0.74)], 0.034);
        let blade = [dvec3(side * 0.62, 0.38, 0.66), dvec3(side * 0.42, 0.5, 0.12)];
        parts.strap(BONE, blade, dvec3(0.4 * side, 1.0, 0.0), [0.018, 0.1]);
    }
}

/// Nine pairs of ribs; all but the last two reach the breastbone as cartilage.
fn ribs(parts: &mut Parts) {
    let mut chance = parts.chance(2);
    for pair in 0..9 {
        let width = [0.62, 0.8, 0.92][pair.min(2)] * chance.about(1.0, 0.01);
        let top = 0.74 - 0.165 * pair as f64 + chance.between(-0.01, 0.01);
        let (end, cartilage) = if pair < 7 { (2.35, 2.95) } else { (1.8, 1.8) };
        for side in SIDES {
            let at = |turn: f64| {
                let fall = if turn > 2.35 { 0.2 - 0.12 * (turn - 2.35) } else { 0.2 * turn / 2.35 };
                dvec3(side * 0.8 * width * sin(turn), 0.49 * cos(turn), top - fall)
            };
            let path = curve(9, |t| at(0.28 + (end - 0.28) * t));
            for pair in path.windows(2) {
                parts.strap(BONE, [pair[0], pair[1]], DVec3::Z, [0.036, 0.024]);
            }
            if cartilage > end {
                parts.tube(BLOOD, &curve(2, |t| at(end + (cartilage - end) * t)), |_| 0.026);
            }
        }
    }
}

pub(in super::super) fn foot(parts: &mut Parts, chance: &mut Chance) {
    // Skin and flesh: leg, heel, instep, ball; toes with their bones. Toes point to -y, the big toe lies at +x.
    let skin = |parts: &mut Parts, density: f64, less: f64| {
        parts.cone(density, [dvec3(-0.04, 0.45, -0.25), dvec3(-0.04, 0.44, 0.93)], [0.27 - less, 0.29 - less]);
        parts.ellipsoid(density, [-0.02, 0.55, -0.42], DVec3::new(0.25, 0.36, 0.29) - less);
        parts.ellipsoid_along(
            density,
            dvec3(0.02, 0.12, -0.36),
            DVec3::new(0.29, 0.3, 0.62) - less,
            dvec3(0.0, -1.0, -0.35),
        );
        parts.ellipsoid(density, [0.02, -0.38, -0.53], DVec3::new(0.4, 0.32, 0.17) - less);
    };
    skin(parts, MUSCLE, 0.0);
    skin(parts, FAT, 0.02);
    parts.ellipsoid_along(MUSCLE, dvec3(0.02, 0.05, -0.5), dvec3(0.2, 0.1, 0.42), dvec3(0.0, -1.0, -0.25));
    parts.rod(ORGAN, [dvec3(-0.03, 0.68, -0.2), dvec3(-0.03, 0.62, 0.93)], 0.045);
    // Leg.
    bone(parts, [dvec3(0.05, 0.4, 0.8), dvec3(0.04, 0.38, 0.03)], chance.about(0.1, 0.06));
    parts.cone(BONE, [dvec3(0.05, 0.4, 0.1), dvec3(0.04, 0.38, -0.04)], [0.1, 0.14]);
    parts.cone(MARROW, [dvec3(0.05, 0.4, 0.08), dvec3(0.04, 0.38, -0.02)], [0.06, 0.11]);
    parts.capsule(BONE, [dvec3(0.16, 0.38, 0.05), dvec3(0.16, 0.38, -0.1)], 0.04);
    bone(parts, [dvec3(-0.17, 0.48, 0.83), dvec3(-0.15, 0.42, -0.08)], chance.about(0.045, 0.06));
    // Ankle, heel and the middle of the foot.
    let mut small = |parts: &mut Parts, centre: [f64; 3], half: [f64; 3], axis: [f64; 3]| {
        let size = chance.about(1.0, 0.04);
        ossicle(parts, centre.into(), DVec3::from(half) * size, axis.into());
    };
    small(parts, [0.03, 0.32, -0.17], [0.13, 0.11, 0.2], [0.0, 1.0, 0.25]);
    small(parts, [-0.02, 0.55, -0.42], [0.12, 0.14, 0.3], [0.0, 1.0, -0.25]);
    small(parts, [0.08, 0.06, -0.24], [0.12, 0.1, 0.06], [0.0, 1.0, 0.2]);
    small(parts, [-0.13, 0.08, -0.42], [0.09, 0.09, 0.15], [0.0, 1.0, 0.2]);
    for (i, x) in [0.15, 0.04, -0.05].into_iter().enumerate() {
        small(parts, [x, -0.08, -0.29 - 0.02 * i as f64], [0.055, 0.08, 0.09], [0.0, 1.0, 0.2]);
    }
    // Rays: a metatarsal and two or three phalanges each.
    for toe in 0..5 {
        let mut draws = parts.chance(1 + toe);
        let i = toe as f64;
        let first = if toe == 0 { 1.5 } else { 1.0 };
        let base = dvec3(0.17 - 0.085 * i, -0.17 + 0.045 * i, -0.35 - 0.02 * i);
        let head = dvec3(0.24 - 0.135 * i, -0.47 + 0.035 * i * i, -0.57);
        let spread = dvec3(0.02 - 0.03 * i, -1.0, -0.02) + draws.shift(0.04);
        let length = draws.about([0.2, 0.17, 0.16, 0.15, 0.13][toe as usize], 0.05);
        let end = head + spread.normalize() * length * if toe == 0 { 1.75 } else { 2.1 };
        for (density, less) in [(MUSCLE, 0.0), (FAT, 0.015)] {
            parts.capsule(density, [head, end], if toe == 0 { 0.115 } else { 0.078 } - less);
        }
        bone(parts, [base, head], 0.036 * first);
        let joints: &[f64] = if toe == 0 { &[0.15, 0.55, 0.62, 1.0] } else { &[0.16, 0.52, 0.6, 0.78, 0.86, 1.02] };
        for pair in joints.chunks(2) {
            let thick = 0.03 * first * (1.1 - 0.35 * pair[0]);
            bone(parts, [head.lerp(end, pair[0]), head.lerp(end, pair[1])], thick);
        }
    }
}

pub(in super::super) fn head(parts: &mut Parts, chance: &mut Chance) {
    let centre = dvec3(0.0, 0.08, 0.22);
    // Skin, ears, nose, neck.
    parts.cylinder(MUSCLE, [0.0, 0.27, -0.6], [0.37, 0.36, 0.33]);
    parts.ellipsoid(MUSCLE, [0.0, -0.26, -0.34], [0.46, 0.5, 0.5]);
    parts.ellipsoid(FAT, centre, [0.67, chance.about(0.8, 0.01), 0.69]);
    parts.cone(MUSCLE, [dvec3(0.0, -0.62, 0.1), dvec3(0.0, -0.78, -0.16)], [0.06, 0.11]);
    for side in SIDES {
        parts.ellipsoid(FAT, [side * 0.68, 0.12, 0.02], [0.06, 0.13, 0.18]);
    }
    // Skull and its contents.
    parts.ellipsoid(BONE, centre, [0.62, 0.75, 0.64]);
    parts.ellipsoid(MARROW, centre, [0.595, 0.725, 0.615]);
    parts.ellipsoid(BONE, centre, [0.575, 0.705, 0.595]);
    let cavity = dvec3(0.55, 0.68, 0.57);
    parts.ellipsoid(WATER, centre, cavity);
    let grey = cavity - 0.02;
    parts.ellipsoid(ORGAN, centre, grey);
    for side in SIDES {
        parts.ellipsoid(
            MUSCLE,
            centre + dvec3(side * 0.24, 0.0, 0.05),
            dvec3(0.2, 0.52, 0.4) * chance.about(1.0, 0.03),
        );
    }
    sulci(parts, centre, grey);
    parts.ellipsoid(WATER, centre + dvec3(0.0, 0.0, 0.08), [0.01, 0.64, 0.47]);
    // Ventricles and deep nuclei.
    let wide = chance.about(0.05, 0.25);
    for side in SIDES {
        let horn = curve(6, |t| {
            centre + dvec3(side * (0.05 + 0.12 * t * t), -0.24 + 0.48 * t, 0.1 + 0.07 * sin(PI * t) - 0.06 * t)
        });
        parts.tube(WATER, &horn, |t| wide * (1.15 - 0.4 * t));
        parts.ellipsoid(BLOOD, centre + dvec3(side * 0.11, -0.02, -0.02), [0.07, 0.12, 0.07]);
    }
    parts.ellipsoid(WATER, centre + dvec3(0.0, 0.0, -0.02), [0.015, 0.12, 0.09]);
    // Cerebellum with its folds, brainstem, spinal cord.
    parts.ellipsoid(WATER, [0.0, 0.44, -0.16], [0.37, 0.25, 0.2]);
    for side in SIDES {
        parts.ellipsoid(ORGAN, [side * 0.16, 0.44, -0.16], [0.18, 0.22, 0.175]);
        for fold in 0..4 {
            let z = -0.27 + 0.07 * f64::from(fold);
            parts.ellipsoid(WATER, [side * 0.2, 0.5, z], [0.13, 0.17, 0.008]);
        }
    }
    parts.capsule(BONE, [dvec3(0.0, 0.22, -0.24), dvec3(0.0, 0.26, -0.36)], 0.17);
    parts.capsule(WATER, [dvec3(0.0, 0.2, -0.15), dvec3(0.0, 0.28, -0.42)], 0.11);
    spine(parts, [-0.93, -0.42], 4, 0.2, 0.1);
    parts.rod(ORGAN, [dvec3(0.0, 0.2, -0.08), dvec3(0.0, 0.31, -0.93)], 0.05);
    face(parts);
}

/// Furrows of the brain: thin sheets that extend inwards from its surface.
fn sulci(parts: &mut Parts, centre: DVec3, half: DVec3) {
    for i in 0..150 {
        let mut draws = parts.chance(100 + i);
        let (direction, depth) = (draws.direction(), draws.between(0.03, 0.07));
        // None where they would meet the base of the skull.
        if direction.z > -0.35 {
            let surface = direction * half;
            let inwards = (direction / half).normalize();
            let along = inwards.cross(draws.direction()).normalize() * draws.between(0.04, 0.09);
            let place = centre + surface - inwards * (depth + 0.005);
            parts.strap(WATER, [place - along, place + along], along.cross(inwards), [0.009, depth]);
        }
    }
}

fn face(parts: &mut Parts) {
    let mut chance = parts.chance(1);
    for side in SIDES {
        let eye = dvec3(side * 0.25, -0.52, 0.02);
        parts.ball(BONE, eye + dvec3(0.0, 0.04, 0.0), 0.2);
        parts.ball(FAT, eye, 0.175);
        parts.ball(ORGAN, eye + dvec3(0.0, -0.05, 0.0), 0.115);
        parts.ball(WATER, eye + dvec3(0.0, -0.05, 0.0), 0.1);
        parts.ellipsoid(BLOOD, eye + dvec3(0.0, -0.13, 0.0), [0.045, 0.025, 0.045]);
        parts.tube(
            BONE,
            &arc(4, [0.0, -0.12, -0.12], [0.53, 0.4], [-0.5 * PI + side * 0.6, -0.5 * PI + side * 1.45]),
            |_| 0.035,
        );
        // Temporal bone with its cells.
        parts.ellipsoid(BONE, [side * 0.42, 0.2, -0.2], [0.13, 0.17, 0.13]);
        for _ in 0..8 {
            let cell = dvec3(side * 0.44, 0.22, -0.22) + chance.inside() * 0.1;
            parts.ball(AIR, cell, chance.between(0.015, 0.03));
        }
    }
    // Upper jaw with sinuses and nose, lower jaw, teeth, mouth.
    parts.ellipsoid(BONE, [0.0, -0.42, -0.24], [0.3, 0.26, 0.2]);
    for side in SIDES {
        parts.ellipsoid(AIR, [side * 0.17, -0.42, -0.22], [chance.about(0.095, 0.1), 0.15, 0.13]);
        parts.ellipsoid(AIR, [side * 0.09, -0.615, chance.about(0.3, 0.05)], [0.06, 0.025, 0.06]);
    }
    parts.ellipsoid(AIR, [0.0, -0.48, -0.15], [0.06, 0.24, 0.17]);
    parts.ellipsoid(BONE, [0.0, -0.46, -0.14], [0.012, 0.22, 0.16]);
    parts.tube(AIR, &curve(4, |t| dvec3(0.0, -0.2 + 0.12 * t, -0.18 - 0.7 * t)), |_| 0.06);
    parts.ellipsoid(AIR, [0.0, -0.4, -0.42], [0.22, 0.26, 0.05]);
    parts.ellipsoid(MUSCLE, [0.0, -0.36, -0.5], [0.22, 0.26, 0.1]);
    let jaw = arc(10, [0.0, -0.2, -0.6], [0.36, 0.46], [-PI, 0.0]);
    for pair in jaw.windows(2) {
        parts.strap(BONE, [pair[0], pair[1]], DVec3::Z, [0.075, 0.05]);
        parts.strap(MARROW, [pair[0], pair[1]], DVec3::Z, [0.045, 0.02]);
    }
    for (side, end) in SIDES.into_iter().zip([jaw[0], jaw[10]]) {
        parts.strap(BONE, [end, dvec3(side * 0.42, 0.0, -0.22)], DVec3::X, [0.03, 0.08]);
    }
    for z in [-0.485, -0.38] {
        for tooth in arc(13, [0.0, -0.24, z], [0.26, 0.38], [-PI + 0.15, -0.15]) {
            parts.ellipsoid(ENAMEL, tooth, [0.03, 0.03, 0.055]);
        }
    }
}

pub(in super::super) fn jaw(parts: &mut Parts, chance: &mut Chance) {
    // Cheeks, mouth, tongue, throat.
    let chin = chance.about(0.5, 0.04);
    for (density, less) in [(FAT, 0.0), (MUSCLE, 0.06)] {
        parts.cylinder(density, [0.0, 0.05, 0.2], DVec3::new(0.84, 0.86, 0.62) - less);
        parts.ellipsoid(density, [0.0, 0.05, -0.4], DVec3::new(0.84, 0.86, chin) - less);
    }
    parts.ellipsoid(AIR, [0.0, -0.12, 0.06], [0.42, 0.5, 0.16]);
    parts.ellipsoid(ORGAN, [0.0, -0.08, -0.12], [0.38, 0.46, chance.about(0.2, 0.05)]);
    parts.capsule(AIR, [dvec3(0.0, 0.5, 0.5), dvec3(0.0, 0.52, -0.6)], 0.1);
    // The lower jaw: a horseshoe with a canal for the nerve, and a branch up to each joint.
    let lower = arc(16, [0.0, 0.15, -0.38], [0.58, 0.78], [-PI, 0.0]);
    let upper = arc(14, [0.0, 0.12, 0.33], [0.56, 0.76], [-PI + 0.1, -0.1]);
    let branches = |parts: &mut Parts, density: f64, less: f64| {
        for (side, end) in SIDES.into_iter().zip([lower[0], lower[16]]) {
            let joint = dvec3(side * 0.6, 0.47, 0.4);
            parts.strap(density, [end, joint - dvec3(0.0, 0.06, 0.2)], DVec3::X, [0.055 - less, 0.17 - less]);
            parts.capsule(density, [joint - dvec3(0.0, 0.06, 0.2), joint], 0.075 - less);
            parts.capsule(density, [end, dvec3(side * 0.61, 0.24, 0.3)], 0.06 - less);
        }
    };
    let along = |parts: &mut Parts, density: f64, path: &[DVec3], size: [f64; 2]| {
        path.windows(2).for_each(|pair| parts.strap(density, [pair[0], pair[1]], DVec3::Z, size));
    };
    branches(parts, BONE, 0.0);
    along(parts, BONE, &lower, [0.2, 0.105]);
    along(parts, BONE, &upper, [0.15, 0.1]);
    parts.ellipsoid(BONE, [0.0, -0.06, 0.38], [0.52, 0.58, 0.035]);
    branches(parts, MARROW, 0.03);
    along(parts, MARROW, &lower, [0.165, 0.07]);
    along(parts, MARROW, &upper, [0.12, 0.07]);
    let canal: Vec<DVec3> = lower.iter().map(|point| *point - dvec3(0.0, 0.0, 0.1)).collect();
    parts.tube(WATER, &canal, |_| 0.022);
    for side in SIDES {
        parts.ellipsoid(AIR, [side * 0.44, 0.05, 0.56], [0.14, chance.about(0.3, 0.08), 0.13]);
    }
    // Fourteen teeth in each jaw, from molar to molar.
    for (jaw, up) in [(0, -1.0), (1, 1.0)] {
        let (centre, half) =
            ([dvec3(0.0, 0.15, -0.06), dvec3(0.0, 0.12, 0.08)][jaw], [[0.57, 0.77], [0.555, 0.755]][jaw]);
        for (i, place) in arc(13, centre, half, [-PI + 0.22, -0.22]).into_iter().enumerate() {
            let mut draws = parts.chance(10 + 20 * jaw as u64 + i as u64);
            tooth(parts, &mut draws, place, up, i.min(13 - i));
        }
    }
}

/// A tooth with its root towards `up`; `kind` counts from the last molar, 0, to the central incisor, 6.
fn tooth(parts: &mut Parts, chance: &mut Chance, crown: DVec3, up: f64, kind: usize) {
    let (across, height): (f64, f64) = ([0.085, 0.085, 0.065, 0.06, 0.06, 0.05, 0.055][kind], chance.about(0.1, 0.06));
    let thick = if kind < 4 { across } else { 0.045 };
    let half = dvec3(across.min(0.075), thick, height);
    let outwards = dvec3(crown.x, 0.6 * crown.y - 0.3, 0.0).normalize();
    let length = chance.about([0.2, 0.22, 0.23, 0.24, 0.3, 0.24, 0.25][kind], 0.08);
    let neck = crown + DVec3::Z * up * 0.06;
    let roots: &[f64] = if kind < 2 { &[-0.045, 0.045] } else { &[0.0] };
    let along = outwards.cross(DVec3::Z);
    for aside in roots {
        let tip = neck + along * *aside + dvec3(0.0, 0.0, up * length) + chance.shift(0.012);
        parts.cone(0.75, [neck + along * *aside * 0.8, tip], [0.042, 0.016]);
    }
    parts.ellipsoid(ENAMEL, crown, half);
    parts.ellipsoid(0.78, crown + DVec3::Z * up * 0.035, half * dvec3(0.72, 0.72, 0.85));
    for aside in roots {
        let tip = neck + along * *aside + dvec3(0.0, 0.0, up * length * 0.85);
        parts.cone(ORGAN, [crown + along * *aside * 0.5, tip], [0.018, 0.007]);
    }
}

pub(in super::super) fn pancreas(parts: &mut Parts, chance: &mut Chance) {
    // Skin and fat, muscles, the fat of the belly.
    parts.cylinder(FAT, [0.0, 0.0, 0.0], [0.93, chance.about(0.68, 0.02), 0.93]);
    parts.cylinder(MUSCLE, [0.0, 0.02, 0.0], [0.83, 0.6, 0.93]);
    parts.cylinder(FAT, [0.0, -0.02, 0.0], [0.78, 0.54, 0.93]);
    for side in SIDES {
        parts.cylinder(MUSCLE, [side * 0.2, 0.48, 0.0], [0.16, 0.12, 0.93]);
        parts.cone(MUSCLE, [dvec3(side * 0.2, 0.34, 0.4), dvec3(side * 0.27, 0.3, -0.93)], [0.05, 0.11]);
    }
    // Liver with its vessels and gall bladder, spleen, kidneys.
    let liver = [dvec3(-0.38, -0.06, 0.4), dvec3(0.38, 0.44, chance.about(0.48, 0.05))];
    parts.ellipsoid(BLOOD, liver[0], liver[1]);
    parts.ellipsoid_along(BLOOD, dvec3(-0.02, -0.27, 0.5), dvec3(0.2, 0.22, 0.42), dvec3(1.0, 0.0, 0.1));
    for k in 0..3 {
        let mut draws = parts.chance(10 + k);
        let way = dvec3(-0.2, draws.between(-0.15, 0.1), 0.14 * k as f64 - 0.08);
        tree(parts, &mut draws, 0.58, [dvec3(-0.1, 0.0, 0.24), way], 0.034, [liver[0], liver[1] * 0.94]);
    }
    parts.ellipsoid_along(WATER, dvec3(-0.3, -0.28, -0.02), dvec3(0.08, 0.08, 0.16), dvec3(0.2, -0.5, -1.0));
    parts.ellipsoid_along(BLOOD, dvec3(0.56, 0.2, 0.48), dvec3(0.13, 0.2, 0.29), dvec3(0.1, 0.3, 1.0));
    for side in SIDES {
        let kidney = dvec3(side * 0.42, 0.33, -0.08 + side * 0.06) + chance.shift(0.02);
        parts.ellipsoid(0.56, kidney, [0.13, 0.12, 0.26]);
        for k in 0..5 {
            let z = -0.17 + 0.085 * f64::from(k);
            parts.ellipsoid(ORGAN, kidney + dvec3(-side * 0.005, 0.0, z), [0.075, 0.065, 0.03]);
        }
        parts.ellipsoid(FAT, kidney - dvec3(side * 0.09, 0.02, 0.0), [0.065, 0.05, 0.1]);
        parts.capsule(MUSCLE, [kidney - dvec3(side * 0.1, 0.02, 0.0), dvec3(side * 0.26, 0.22, -0.88)], 0.018);
    }
    // Stomach with food and a bubble.
    let stomach = curve(8, |t| dvec3(0.42 - 0.5 * t * t, -0.05 - 0.24 * t, 0.55 - 0.62 * t + 0.2 * t * t));
    parts.tube(ORGAN, &stomach, |t| 0.22 - 0.12 * t);
    parts.tube(WATER, &stomach, |t| 0.195 - 0.12 * t);
    parts.ellipsoid(AIR, stomach[2] + dvec3(0.0, -0.11, 0.02), [0.12, 0.06, 0.14]);
    bowels(parts);
    spine(parts, [-0.93, 0.93], 5, 0.26, 0.14);
    for side in SIDES {
        for pair in 0..4 {
            let top = 0.85 - 0.28 * f64::from(pair);
            let path = curve(7, |t| {
                let turn = 0.3 + 1.5 * t;
                dvec3(side * 0.8 * sin(turn), 0.57 * cos(turn), top - 0.3 * t)
            });
            path.windows(2).for_each(|ends| parts.strap(BONE, [ends[0], ends[1]], DVec3::Z, [0.04, 0.022]));
        }
    }
    // Aorta, vena cava, portal and splenic veins.
    parts.rod(0.6, [dvec3(0.05, 0.1, -0.93), dvec3(0.02, 0.12, 0.93)], 0.065);
    parts.rod(0.55, [dvec3(-0.12, 0.1, -0.93), dvec3(-0.14, 0.08, 0.93)], 0.07);
    parts.tube(0.57, &curve(6, |t| dvec3(0.48 - 0.55 * t, 0.12 - 0.14 * sin(PI * t), 0.3 - 0.16 * t)), |_| 0.03);
    parts.capsule(0.57, [dvec3(-0.07, 0.05, 0.12), dvec3(-0.12, -0.02, 0.28)], 0.038);
    parts.capsule(0.57, [dvec3(-0.06, 0.02, 0.13), dvec3(-0.02, -0.08, -0.4)], 0.034);
    gland(parts);
}

/// The pancreas: lobules around a duct.
///
/// It extends from the head in the bend of the duodenum to the tail at the spleen.
fn gland(parts: &mut Parts) {
    let axis = curve(24, |t| {
        dvec3(-0.22 + 0.68 * t, -0.12 - 0.1 * sin(PI * t) + 0.2 * t * t, -0.08 + 0.1 * sin(PI * t) + 0.3 * t * t)
    });
    for (i, place) in axis.iter().enumerate() {
        let mut chance = parts.chance(30 + i as u64);
        let size = 0.1 - 0.045 * i as f64 / 24.0;
        for _ in 0..4 {
            parts.ball(ORGAN, *place + chance.inside() * size * 0.8, chance.about(0.6 * size, 0.2));
        }
    }
    parts.ball(0.4, axis[2] + parts.chance(29).shift(0.03), 0.045);
    parts.tube(WATER, &axis, |_| 0.012);
}

/// Duodenum, small and large bowel.
fn bowels(parts: &mut Parts) {
    let mut chance = parts.chance(1);
    let phase = chance.between(0.0, PI);
    let small = curve(40, |t| {
        let z = -0.24 - 0.6 * t;
        dvec3(0.42 * sin(19.0 * t + phase), -0.2 + 0.12 * cos(31.0 * t + phase), z)
    });
    parts.pipe([ORGAN, WATER], &small, [0.075, 0.052]);
    let duodenum = curve(8, |t| dvec3(-0.12 - 0.2 * sin(PI * t), -0.16 + 0.12 * t, 0.06 - 0.34 * t));
    parts.pipe([ORGAN, WATER], &duodenum, [0.07, 0.045]);
    // The colon's pouches with air and contents.
    let colon = curve(30, |t| {
        let turn = PI * (1.25 - 1.5 * t);
        dvec3(0.62 * cos(turn), -0.16 + 0.1 * cos(2.0 * turn), -0.5 + 0.38 * sin(turn))
    });
    for (density, size) in [(ORGAN, 0.098), (0.3, 0.078)] {
        for place in &colon {
            parts.ball(density, *place, size);
        }
    }
    for place in &colon {
        let bubble = *place - dvec3(0.0, 0.03, 0.0) + chance.shift(0.01);
        parts.ellipsoid(AIR, bubble, [0.055, 0.035, 0.055]);
    }
}
