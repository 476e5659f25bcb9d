//! Animals and plants: beetle, bonsai, broccoli, kingsnake, pepper. z points up.

use super::parts::{Chance, Parts, curve, pulled_into};
use glam::{DVec3, dvec3};
use std::f64::consts::{PI, TAU};
use trgs_core::numeric::elementary::{cos, sin};

/// The two sides of an animal.
const SIDES: [f64; 2] = [-1.0, 1.0];
/// The golden angle; multiples of it are evenly spread.
const GOLDEN: f64 = 2.399_963;

pub(in super::super) fn beetle(parts: &mut Parts, chance: &mut Chance) {
    const SHELL: f64 = 0.8;
    const FLESH: f64 = 0.3;
    // Head to -y: abdomen below the wing cases, thorax, head, each a thin shell.
    let wide = chance.about(0.36, 0.04);
    let bodies = [
        (dvec3(0.0, 0.4, 0.0), dvec3(wide, 0.5, 0.24), 0.02),
        (dvec3(0.0, -0.18, 0.0), dvec3(0.31, 0.19, 0.19), 0.025),
        (dvec3(0.0, -0.43, -0.02), dvec3(0.2, 0.14, 0.12), 0.025),
    ];
    for (centre, half, wall) in bodies {
        parts.ellipsoid(SHELL, centre, half);
        parts.ellipsoid(0.04, centre, half - wall);
        parts.ellipsoid(FLESH, centre - dvec3(0.0, 0.0, 0.03), half * dvec3(0.8, 0.85, 0.62));
    }
    // Wing cases with ridges and a seam; below them folded wings.
    for side in SIDES {
        for ridge in 0..5 {
            let aside = side * (0.1 + 0.18 * f64::from(ridge));
            let path = curve(8, |t| {
                let along = -0.85 + 1.7 * t;
                let round = (1.0 - along * along).max(0.0).sqrt();
                bodies[0].0 + dvec3(wide, 0.5, 0.24) * dvec3(round * sin(aside), along, round * cos(aside)) * 1.005
            });
            parts.tube(SHELL, &path, |_| 0.012);
        }
        parts.ellipsoid(0.5, [side * 0.12, 0.45, 0.14], [0.11, 0.36, 0.008]);
    }
    parts.ellipsoid(0.0, [0.0, 0.4, 0.26], [0.008, 0.48, 0.06]);
    // Gut, flight muscles, eggs.
    parts.tube(0.45, &curve(14, |t| dvec3(0.09 * sin(9.0 * t), -0.4 + 1.15 * t, -0.04 + 0.03 * cos(9.0 * t))), |_| {
        0.035
    });
    for side in SIDES {
        for muscle in 0..3 {
            let centre = dvec3(side * 0.1, -0.26 + 0.08 * f64::from(muscle), 0.02);
            parts.ellipsoid_along(0.42, centre, dvec3(0.03, 0.03, 0.12), dvec3(side, 0.0, 0.8));
        }
    }
    for _ in 0..40 {
        let egg = dvec3(0.0, 0.52, -0.05) + chance.inside() * dvec3(0.2, 0.26, 0.1);
        parts.ellipsoid_along(0.55, egg, dvec3(0.02, 0.02, 0.032), chance.direction());
    }
    // Mandibles with a tooth, eyes, antennae with combs.
    for (i, side) in SIDES.into_iter().enumerate() {
        let mut draws = parts.chance(1 + i as u64);
        let bite = draws.about(0.16, 0.15);
        let jaw = curve(8, |t| dvec3(side * (0.08 + bite * sin(2.6 * t)), -0.52 - 0.36 * t, -0.01 + 0.05 * t));
        parts.tube(SHELL, &jaw, |t| 0.05 - 0.03 * t);
        parts.cone(SHELL, [jaw[5], jaw[5] - dvec3(side * 0.1, 0.03, 0.0)], [0.022, 0.006]);
        parts.ball(0.65, [side * 0.18, -0.45, 0.02], 0.045);
        let feeler = curve(8, |t| dvec3(side * (0.16 + 0.34 * sin(2.0 * t)), -0.5 - 0.16 * t, 0.03 + 0.1 * t));
        parts.tube(0.6, &feeler, |_| 0.012);
        for joint in &feeler[5..] {
            parts.capsule(0.6, [*joint, *joint - dvec3(0.0, 0.07, 0.01)], 0.01);
        }
    }
    // Three pairs of legs: hip, thigh, shin with spines, foot with claws.
    for (i, side) in SIDES.into_iter().enumerate() {
        for pair in 0..3 {
            let mut draws = parts.chance(10 + 3 * i as u64 + pair as u64);
            let fan = [-0.75, 0.15, 0.8][pair] + draws.between(-0.08, 0.08);
            let out = dvec3(side * cos(fan), sin(fan), 0.0);
            let hip = dvec3(side * 0.18, [-0.22, 0.08, 0.3][pair], -0.17);
            let knee = hip + out * draws.about(0.3, 0.06) + dvec3(0.0, 0.0, 0.1);
            let ankle = knee + out * draws.about(0.22, 0.06) - dvec3(0.0, 0.0, 0.3);
            for (density, less) in [(SHELL, 0.0), (FLESH, 0.014)] {
                parts.capsule(density, [hip, knee], 0.042 - less);
                parts.capsule(density, [knee, ankle], 0.028 - less);
            }
            for spine in 1..4 {
                let root = knee.lerp(ankle, 0.25 * f64::from(spine));
                parts.cone(SHELL, [root, root + out * 0.07], [0.014, 0.003]);
            }
            let toe = ankle + out * 0.15 - dvec3(0.0, 0.0, 0.04);
            parts.tube(SHELL, &curve(3, |t| ankle.lerp(toe, t)), |t| 0.02 - 0.008 * t);
            for claw in SIDES {
                let aside = out.cross(DVec3::Z) * claw;
                parts.cone(SHELL, [toe, toe + (out + aside) * 0.045], [0.01, 0.003]);
            }
        }
    }
}

/// Adds a branch in bent segments and its own branches; returns the tips in `tips`.
fn grow(
    parts: &mut Parts,
    density: f64,
    stem: (DVec3, DVec3, f64),
    (level, id): (u32, u64),
    room: (DVec3, DVec3),
    tips: &mut Vec<DVec3>,
) {
    let mut chance = parts.chance(id);
    let (mut place, mut way, radius) = stem;
    for step in 0..3 {
        let next = pulled_into(place + way / 3.0 + chance.shift(0.12) * way.length(), room.0, room.1);
        if place.distance(next) > 0.01 {
            parts.capsule(density, [place, next], radius * (1.0 - 0.12 * f64::from(step)));
        }
        place = next;
    }
    if level == 0 {
        tips.push(place);
        return;
    }
    way = way.lerp(DVec3::Z * way.length(), 0.2);
    let aside = way.normalize().any_orthonormal_pair();
    let start = chance.between(0.0, TAU);
    for child in 0..3_u32 {
        let turn = start + TAU * f64::from(child) / 3.0 + chance.between(-0.3, 0.3);
        let out = (aside.0 * cos(turn) + aside.1 * sin(turn)) * way.length() * chance.about(0.75, 0.2);
        let next = (way * 0.55 + out) * chance.about(0.78, 0.1);
        let id = 16 * id + u64::from(child);
        grow(parts, density, (place, next, radius * 0.6), (level - 1, id), room, tips);
    }
}

pub(in super::super) fn bonsai(parts: &mut Parts, chance: &mut Chance) {
    const WOOD: f64 = 0.62;
    // Pot with a rim and feet, soil with stones.
    parts.cone(0.85, [dvec3(0.0, 0.0, -0.88), dvec3(0.0, 0.0, -0.56)], [0.42, 0.56]);
    parts.rod(0.85, [dvec3(0.0, 0.0, -0.6), dvec3(0.0, 0.0, -0.54)], 0.6);
    parts.cone(0.0, [dvec3(0.0, 0.0, -0.82), dvec3(0.0, 0.0, -0.53)], [0.38, 0.52]);
    parts.cone(0.3, [dvec3(0.0, 0.0, -0.82), dvec3(0.0, 0.0, -0.6)], [0.38, 0.484]);
    for i in 0..4 {
        let turn = TAU * (f64::from(i) + 0.5) / 4.0;
        parts.cylinder(0.85, [0.34 * cos(turn), 0.34 * sin(turn), -0.9], [0.07, 0.07, 0.03]);
    }
    for i in 0..40 {
        let (turn, out) = (GOLDEN * f64::from(i), 0.44 * chance.between(0.0, 1.0).sqrt());
        let stone = dvec3(out * cos(turn), out * sin(turn), chance.between(-0.78, -0.61));
        let out = stone.truncate().length() < 0.36 || stone.z > -0.7;
        if out {
            parts.ball(chance.between(0.4, 0.7), stone, chance.between(0.015, 0.035));
        }
    }
    // Roots, a bent trunk, branches, leaves.
    for i in 0..6 {
        let turn = TAU * f64::from(i) / 6.0 + chance.between(-0.3, 0.3);
        let end = dvec3(0.3 * cos(turn), 0.3 * sin(turn), -0.68);
        parts.cone(WOOD, [dvec3(0.0, 0.0, -0.56), end], [0.06, 0.015]);
    }
    let lean = chance.between(-0.5, 0.5);
    let trunk = curve(6, |t| {
        dvec3(0.16 * sin(PI * 1.5 * t + lean), 0.1 * sin(PI * t), -0.6 + 0.62 * t) - dvec3(0.16 * sin(lean), 0.0, 0.0)
    });
    parts.tube(WOOD, &trunk, |t| 0.1 - 0.04 * t);
    let crown = (dvec3(0.0, 0.0, 0.36), dvec3(0.82, 0.8, 0.5));
    let mut tips = Vec::new();
    let starts = [(trunk[3], 0.5, 2), (trunk[4], 3.1, 2), (trunk[5], 1.9, 2), (trunk[6], 4.6, 3), (trunk[6], 0.2, 2)];
    for (i, (place, turn, level)) in starts.into_iter().enumerate() {
        let way = dvec3(0.42 * cos(turn), 0.42 * sin(turn), 0.2 + 0.12 * i as f64);
        grow(parts, WOOD, (place, way, 0.055), (level, 5 + i as u64), crown, &mut tips);
    }
    for (i, tip) in tips.into_iter().enumerate() {
        let mut draws = parts.chance(10_000 + i as u64);
        for _ in 0..4 {
            let leaf = pulled_into(tip + draws.inside() * 0.13, crown.0, crown.1);
            let axis = draws.direction() * dvec3(1.0, 1.0, 0.5) + dvec3(0.0, 0.0, 0.05);
            parts.ellipsoid_along(draws.between(0.22, 0.4), leaf, dvec3(0.045, 0.02, 0.075), axis);
        }
    }
}

pub(in super::super) fn broccoli(parts: &mut Parts, chance: &mut Chance) {
    const STALK: f64 = 0.5;
    let crown = (dvec3(0.0, 0.0, 0.16), dvec3(0.72, 0.72, 0.58));
    let foot = dvec3(chance.between(-0.08, 0.08), chance.between(-0.08, 0.08), -0.92);
    let fork = dvec3(0.0, 0.0, -0.3);
    parts.cone(0.62, [foot, fork], [chance.about(0.17, 0.08), 0.22]);
    parts.ball(0.62, fork, 0.22);
    // Stubs of the leaves that were cut off.
    for i in 0..4 {
        let turn = GOLDEN * f64::from(i) + chance.between(-0.2, 0.2);
        let root = foot.lerp(fork, 0.3 + 0.17 * f64::from(i)) + dvec3(0.17 * cos(turn), 0.17 * sin(turn), 0.0);
        parts.cone(STALK, [root, root + dvec3(0.2 * cos(turn), 0.2 * sin(turn), 0.16)], [0.06, 0.03]);
    }
    let mut tips = Vec::new();
    for i in 0..7_u32 {
        let (turn, rise) = (GOLDEN * f64::from(i), if i == 0 { 3.0 } else { 0.9 + 0.12 * f64::from(i) });
        let way = dvec3(cos(turn), sin(turn), rise).normalize() * 0.42;
        grow(parts, STALK, (fork, way, 0.1), (1, 1 + u64::from(i)), crown, &mut tips);
    }
    // Pith, drier than its surroundings.
    parts.cone(0.34, [foot + dvec3(0.0, 0.0, 0.02), fork], [0.1, 0.13]);
    for (i, tip) in tips.into_iter().enumerate() {
        let mut draws = parts.chance(1000 + i as u64);
        let (centre, size) = (pulled_into(tip, crown.0, crown.1), draws.between(0.13, 0.17));
        let out = (centre - fork).normalize();
        parts.ball(STALK, centre, 0.7 * size);
        parts.ball(0.42, centre, 0.5 * size);
        for _ in 0..20 {
            let bud = centre + (draws.direction() + out * 0.7).normalize() * size * draws.between(0.75, 1.0);
            parts.ball(draws.between(0.55, 0.75), bud, draws.between(0.03, 0.05));
        }
    }
}

pub(in super::super) fn kingsnake(parts: &mut Parts, chance: &mut Chance) {
    const BONE: f64 = 0.95;
    const JOINTS: usize = 80;
    let (turns, start) = (chance.about(2.55, 0.03), chance.between(0.0, TAU));
    let spine = curve(JOINTS, |t| {
        let turn = start + TAU * turns * t;
        let out = 0.79 - 0.5 * t + 0.012 * sin(23.0 * t);
        dvec3(out * cos(turn), out * sin(turn), -0.5 + 0.95 * t + 0.015 * sin(31.0 * t))
    });
    // Thin at the tail, thick in the middle, a neck behind the head.
    let thick = |t: f64| 0.13 * (1.0 - pow4(1.0 - t)) * (1.0 - 0.42 * pow4(t));
    parts.tube(0.36, &spine, |t| thick(t) + 0.012);
    parts.tube(0.3, &spine, |t| 0.85 * thick(t) + 0.004);
    let gut: Vec<DVec3> = spine.iter().skip(12).map(|point| *point - dvec3(0.0, 0.0, 0.03)).collect();
    parts.tube(0.42, &gut, |_| 0.032);
    // The last meal.
    let meal = gut[chance.between(25.0, 45.0) as usize];
    parts.ball(0.5, meal, 0.065);
    parts.ball(0.6, meal + chance.shift(0.015), 0.04);
    for i in 2..JOINTS - 2 {
        let t = i as f64 / JOINTS as f64;
        let (along, size) = ((spine[i + 1] - spine[i - 1]).normalize(), thick(t));
        let side = along.cross(DVec3::Z).normalize();
        let up = side.cross(along);
        let vertebra = spine[i] + up * size * 0.55;
        parts.ellipsoid_along(BONE, vertebra, dvec3(0.2 * size, 0.2 * size, 0.024), along);
        if (9..JOINTS - 6).contains(&i) {
            for side in [side, -side] {
                let at = |turn: f64| spine[i] + (side * sin(turn) + up * cos(turn)) * size * 0.8 - along * 0.02 * turn;
                parts.capsule(BONE, [vertebra, at(1.3)], 0.009);
                parts.capsule(BONE, [at(1.3), at(2.3)], 0.007);
            }
        }
    }
    // The head: skull, jaws, eyes, teeth.
    let (tip, way) = (spine[JOINTS], (spine[JOINTS] - spine[JOINTS - 2]).normalize());
    let (way, side) = ((way * dvec3(1.0, 1.0, 0.3)).normalize(), way.cross(DVec3::Z).normalize());
    let middle = tip + way * 0.1;
    parts.ellipsoid_along(0.36, middle, dvec3(0.1, 0.1, 0.19), way);
    parts.ellipsoid_along(BONE, middle + dvec3(0.0, 0.0, 0.025), dvec3(0.06, 0.06, 0.14), way);
    parts.ellipsoid_along(0.35, middle + dvec3(0.0, 0.0, 0.025), dvec3(0.042, 0.042, 0.12), way);
    for side in [side, -side] {
        let hinge = tip + side * 0.07 - dvec3(0.0, 0.0, 0.045);
        parts.capsule(BONE, [hinge, middle + way * 0.13 + side * 0.025 - dvec3(0.0, 0.0, 0.05)], 0.012);
        parts.ball(0.55, middle + way * 0.05 + side * 0.065 + dvec3(0.0, 0.0, 0.02), 0.024);
        for tooth in 0..4 {
            let root = middle + way * (0.04 + 0.03 * f64::from(tooth)) + side * 0.045;
            parts.cone(1.0, [root, root - dvec3(0.0, 0.0, 0.045)], [0.008, 0.002]);
        }
    }
}

fn pow4(x: f64) -> f64 {
    x * x * x * x
}

pub(in super::super) fn pepper(parts: &mut Parts, chance: &mut Chance) {
    const WALL: f64 = 0.55;
    const LOBES: u32 = 4;
    let start = chance.between(0.0, TAU);
    let lobes: Vec<_> = (0..LOBES)
        .map(|i| {
            let turn = start + TAU * f64::from(i) / f64::from(LOBES) + chance.between(-0.12, 0.12);
            let out = dvec3(cos(turn), sin(turn), 0.0);
            (out * 0.32, dvec3(0.46, 0.46, chance.about(0.7, 0.04)) * chance.about(1.0, 0.03))
        })
        .collect();
    let middle = dvec3(0.0, 0.0, -0.12);
    for (density, wall) in [(0.75, 0.0), (WALL, 0.015), (0.0, 0.09)] {
        for (out, half) in &lobes {
            parts.ellipsoid(density, middle + *out, *half - wall);
        }
        if wall < 0.05 {
            parts.ellipsoid(density, middle, DVec3::new(0.4, 0.4, 0.62) - wall);
        }
        if density == 0.0 {
            parts.ellipsoid(density, middle, [0.3, 0.3, 0.5]);
        }
    }
    // Inner walls between the lobes, placenta with seeds, dents at both ends.
    for pair in 0..LOBES as usize {
        let (one, next) = (lobes[pair].0, lobes[(pair + 1) % LOBES as usize].0);
        let out = (one + next).normalize();
        parts.ellipsoid_along(WALL, middle + out * 0.42, dvec3(0.03, 0.03, 0.56), DVec3::Z);
        parts.strap(
            WALL,
            [middle + out * 0.3 - DVec3::Z * 0.35, middle + out * 0.3 + DVec3::Z * 0.3],
            out.cross(DVec3::Z),
            [0.02, 0.14],
        );
    }
    parts.ellipsoid(0.0, [0.0, 0.0, 0.66], [0.2, 0.2, 0.12]);
    parts.ellipsoid(0.0, [0.0, 0.0, -0.87], [0.16, 0.16, 0.13]);
    let core = dvec3(0.0, 0.0, 0.27);
    parts.ellipsoid(0.35, core, [0.15, 0.15, 0.27]);
    for i in 0..130 {
        let mut draws = parts.chance(10 + i);
        let way = dvec3(cos(GOLDEN * i as f64), sin(GOLDEN * i as f64), 1.0 - i as f64 / 65.0);
        let out = dvec3(way.x, way.y, 0.0) * (1.0 - way.z * way.z).max(0.0).sqrt() + DVec3::Z * way.z;
        let seed = core - dvec3(0.0, 0.0, 0.05) + out * dvec3(0.17, 0.17, 0.24) * draws.about(1.0, 0.1);
        let flat = out.cross(draws.direction()).normalize();
        parts.ellipsoid_along(0.95, seed, dvec3(0.034, 0.034, 0.012), flat);
    }
    // Calyx and stem.
    for i in 0..6 {
        let turn = TAU * f64::from(i) / 6.0 + chance.between(-0.2, 0.2);
        let leaf = dvec3(0.12 * cos(turn), 0.12 * sin(turn), 0.56);
        parts.ellipsoid(0.5, leaf, [0.09, 0.09, 0.03]);
    }
    let bend = chance.direction() * dvec3(1.0, 1.0, 0.0);
    let stem = curve(6, |t| dvec3(0.0, 0.0, 0.52 + 0.34 * t) + bend * 0.22 * t * t);
    parts.tube(0.6, &stem, |t| 0.055 - 0.01 * t);
    parts.tube(0.3, &stem, |t| 0.03 - 0.006 * t);
}
