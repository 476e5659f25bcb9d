//! Artificial objects: backpack, engine, mount, present, teapot. z points up.

use super::super::solid::{Shape, Solid};
use super::parts::{Chance, Parts, arc, curve};
use glam::{DQuat, DVec3, dvec3};
use std::f64::consts::{PI, TAU};
use trgs_core::numeric::elementary::{cos, sin};

/// The two sides of a symmetric object.
const SIDES: [f64; 2] = [-1.0, 1.0];
/// The golden angle; multiples of it are evenly spread.
const GOLDEN: f64 = 2.399_963;
const METAL: f64 = 1.0;

/// A box rotated about its centre.
fn turned_box(parts: &mut Parts, density: f64, centre: DVec3, half: DVec3, turn: DQuat) {
    parts.put(Solid::new(Shape::Cuboid, density, centre, half).rotated(turn));
}

/// A bottle along `way`: wall, content up to the fraction `full` of its length, neck and cap.
fn bottle(parts: &mut Parts, foot: DVec3, way: DVec3, radius: f64, full: f64) {
    let shoulder = foot + way * 0.72;
    parts.rod(0.55, [foot, shoulder], radius);
    parts.cone(0.55, [shoulder, foot + way * 0.84], [radius, 0.42 * radius]);
    parts.rod(0.55, [foot + way * 0.84, foot + way * 0.93], 0.42 * radius);
    parts.rod(0.0, [foot + way * 0.03, shoulder], 0.86 * radius);
    parts.cone(0.0, [shoulder, foot + way * 0.84], [0.86 * radius, 0.3 * radius]);
    parts.rod(0.0, [foot + way * 0.84, foot + way * 0.93], 0.3 * radius);
    parts.rod(0.38, [foot + way * 0.03, foot + way * 0.72 * full], 0.86 * radius);
    parts.rod(0.65, [foot + way * 0.9, foot + way], 0.5 * radius);
}

pub(in super::super) fn backpack(parts: &mut Parts, chance: &mut Chance) {
    const CLOTH: f64 = 0.3;
    // The bag: a rounded top, a main and a front compartment, padding at the back.
    for (density, wall) in [(CLOTH, 0.0), (0.02, 0.02)] {
        parts.cuboid(density, [0.0, 0.12, -0.16], DVec3::new(0.58, 0.34, 0.72) - wall);
        parts.put(
            Solid::new(Shape::Cylinder, density, dvec3(0.0, 0.12, 0.5), DVec3::new(0.58, 0.36, 0.34) - wall)
                .rotated(DQuat::from_rotation_x(PI / 2.0)),
        );
    }
    parts.cuboid(0.02, [0.0, 0.12, 0.4], [0.55, 0.3, 0.2]);
    for (density, wall) in [(CLOTH, 0.0), (0.02, 0.02)] {
        parts.cuboid(density, [0.0, -0.37, -0.4], DVec3::new(0.46, 0.15, 0.42) - wall);
    }
    parts.cuboid(0.16, [0.0, 0.41, 0.0], [0.5, 0.03, 0.7]);
    // Handle, straps with buckles, zips.
    parts.tube(CLOTH, &curve(6, |t| dvec3(0.14 * cos(PI * t), 0.42, 0.8 + 0.09 * sin(PI * t))), |_| 0.025);
    for side in SIDES {
        let strap = curve(9, |t| dvec3(side * (0.16 + 0.22 * t), 0.48 + 0.28 * sin(PI * t), 0.68 - 1.4 * t));
        strap.windows(2).for_each(|ends| parts.strap(0.35, [ends[0], ends[1]], DVec3::Y, [0.025, 0.08]));
        parts.cuboid(0.7, strap[7], [0.09, 0.03, 0.05]);
    }
    let zip = curve(24, |t| dvec3(0.52 * cos(PI * t), -0.2, 0.36 + 0.4 * sin(PI * t)));
    zip.iter().for_each(|tooth| parts.ball(0.9, *tooth, 0.016));
    // Computer, books with covers, bottle, can, lunch box with apple and cutlery.
    let lean = DQuat::from_rotation_x(chance.between(-0.04, 0.04));
    turned_box(parts, 0.8, dvec3(0.0, 0.34, -0.12), dvec3(0.47, 0.025, 0.34), lean);
    turned_box(parts, 0.45, dvec3(0.0, 0.34, -0.12), dvec3(0.44, 0.012, 0.31), lean);
    turned_box(parts, METAL, dvec3(0.0, 0.34, -0.3), dvec3(0.3, 0.012, 0.1), lean);
    for book in 0..3 {
        let half = dvec3(chance.about(0.36, 0.1), 0.04, chance.about(0.42, 0.1));
        let centre = dvec3(-0.14, 0.25 - 0.1 * f64::from(book), -0.86 + half.z);
        parts.cuboid(0.55, centre, half);
        parts.cuboid(chance.between(0.36, 0.48), centre + dvec3(0.012, 0.0, 0.0), half - dvec3(0.0, 0.009, 0.012));
    }
    bottle(parts, dvec3(0.4, 0.1, -0.84), dvec3(0.0, 0.0, 0.95), 0.13, chance.between(0.4, 0.9));
    let can = dvec3(0.36, -0.1, -0.83);
    parts.rod(0.9, [can, can + DVec3::Z * 0.38], 0.11);
    parts.rod(0.4, [can + DVec3::Z * 0.012, can + DVec3::Z * 0.32], 0.1);
    parts.rod(0.0, [can + DVec3::Z * 0.32, can + DVec3::Z * 0.368], 0.1);
    parts.cuboid(0.4, [-0.16, -0.1, -0.68], [0.3, 0.09, 0.17]);
    parts.cuboid(0.0, [-0.16, -0.1, -0.67], [0.28, 0.075, 0.15]);
    let apple = dvec3(-0.3 + chance.between(-0.03, 0.06), -0.1, -0.745);
    parts.ball(0.42, apple, 0.072);
    parts.ball(0.2, apple, 0.018);
    parts.cuboid(0.28, [-0.02, -0.1, -0.78], [0.1, 0.06, 0.035]);
    // A rolled pullover, keys, cable, pens, telephone, coins.
    let wool = curve(40, |t| {
        let turn = 6.0 * PI * t;
        dvec3((0.05 + 0.17 * t) * cos(turn) - 0.15, 0.1, 0.3 + (0.05 + 0.17 * t) * sin(turn))
    });
    wool.windows(2)
        .for_each(|ends| parts.strap(chance.between(0.14, 0.22), [ends[0], ends[1]], DVec3::Y, [0.2, 0.022]));
    let cable = curve(60, |t| {
        let turn = 8.0 * TAU * t;
        dvec3(0.26 + 0.12 * cos(turn), -0.36 + 0.05 * (2.0 * t - 1.0), -0.62 + 0.12 * sin(turn))
    });
    parts.tube(0.75, &cable, |_| 0.012);
    for pen in 0..5 {
        let foot = dvec3(-0.38 + 0.06 * f64::from(pen), -0.33 + chance.between(-0.06, 0.02), -0.74);
        let tip = foot + dvec3(chance.between(-0.04, 0.04), chance.between(-0.03, 0.03), 0.34);
        parts.rod(0.5, [foot, tip], 0.018);
        parts.rod(0.15, [foot, tip], 0.009);
        parts.cone(0.95, [foot, foot - DVec3::Z * 0.04], [0.018, 0.003]);
    }
    parts.cuboid(0.85, [0.0, -0.44, -0.3], [0.16, 0.022, 0.085]);
    parts.cuboid(METAL, [-0.03, -0.44, -0.3], [0.09, 0.012, 0.055]);
    let ring = dvec3(-0.1, -0.38, -0.5);
    parts.tube(METAL, &curve(12, |t| ring + dvec3(0.05 * cos(TAU * t), 0.0, 0.05 * sin(TAU * t))), |_| 0.007);
    for key in 0..4 {
        let turn = PI * 1.5 + 0.5 * (f64::from(key) - 1.5) + chance.between(-0.1, 0.1);
        let way = dvec3(cos(turn), 0.25 * f64::from(key) - 0.4, sin(turn));
        parts.strap(METAL, [ring + way * 0.05, ring + way * 0.19], DVec3::Y, [0.007, 0.02]);
        parts.strap(METAL, [ring + way * 0.04, ring + way * 0.07], DVec3::Y, [0.009, 0.038]);
    }
    for _ in 0..8 {
        let coin = dvec3(chance.between(-0.3, 0.3), chance.between(-0.46, -0.3), chance.between(-0.78, -0.76));
        parts.ellipsoid_along(0.95, coin, dvec3(0.035, 0.035, 0.007), chance.direction() * 0.3 + DVec3::Z);
    }
}

pub(in super::super) fn engine(parts: &mut Parts, chance: &mut Chance) {
    const CAST: f64 = 0.5;
    const STEEL: f64 = 0.9;
    // Crankshaft along y: crankcase, block, head, pan, ribs.
    parts.cuboid(CAST, [0.0, 0.0, -0.5], [0.5, 0.78, 0.3]);
    parts.cuboid(CAST, [0.0, 0.0, 0.1], [0.42, 0.78, 0.4]);
    parts.cuboid(CAST, [0.0, 0.0, 0.56], [0.46, 0.74, 0.12]);
    parts.cuboid(STEEL, [0.0, 0.0, 0.46], [0.46, 0.78, 0.01]);
    parts.cuboid(CAST, [0.0, 0.0, -0.82], [0.36, 0.66, 0.08]);
    for i in 0..8 {
        let y = -0.7 + 0.2 * f64::from(i);
        SIDES.iter().for_each(|side| parts.cuboid(CAST, [side * 0.44, y, 0.12], [0.06, 0.02, 0.3]));
    }
    parts.cuboid(0.0, [0.0, 0.0, -0.5], [0.43, 0.71, 0.22]);
    parts.cuboid(0.3, [0.0, 0.0, -0.79], [0.3, 0.6, 0.07]);
    // Two cylinders: water, liner, bore, piston with rings, pin and rod, valves.
    let phase = chance.between(0.0, TAU);
    let crank = |turn: f64| dvec3(0.13 * sin(turn), 0.0, 0.13 * cos(turn));
    for (i, side) in SIDES.into_iter().enumerate() {
        let axis = DVec3::Y * side * 0.36;
        let throw = crank(phase + PI * i as f64);
        let at = |z: f64| axis + DVec3::Z * z;
        parts.rod(0.15, [at(-0.05), at(0.42)], 0.34);
        parts.rod(STEEL, [at(-0.32), at(0.45)], 0.28);
        parts.rod(0.0, [at(-0.33), at(0.5)], 0.235);
        let crown = 0.12 + throw.z;
        parts.rod(0.6, [at(crown - 0.2), at(crown)], 0.228);
        parts.rod(0.0, [at(crown - 0.21), at(crown - 0.04)], 0.17);
        for ring in 0..3 {
            let z = crown - 0.03 - 0.04 * f64::from(ring);
            parts.rod(METAL, [at(z - 0.009), at(z + 0.009)], 0.236);
            parts.rod(0.6, [at(z - 0.009), at(z + 0.009)], 0.205);
        }
        let pin = at(crown - 0.12);
        parts.rod(METAL, [pin - DVec3::X * 0.2, pin + DVec3::X * 0.2], 0.035);
        let end = at(-0.5) + throw;
        parts.strap(STEEL, [pin, end], DVec3::Y, [0.03, 0.045]);
        parts.rod(STEEL, [end - DVec3::Y * 0.05, end + DVec3::Y * 0.05], 0.085);
        for side in SIDES {
            let web = end + DVec3::Y * side * 0.085;
            parts.strap(STEEL, [web, web - throw * 1.9], DVec3::Y, [0.025, 0.09]);
            let seat = axis + dvec3(side * 0.11, 0.0, 0.5);
            parts.rod(0.0, [seat, seat + dvec3(side * 0.3, 0.0, 0.12)], 0.06);
            parts.cone(METAL, [seat, seat + DVec3::Z * 0.05], [0.085, 0.02]);
            parts.rod(METAL, [seat, seat + DVec3::Z * 0.34], 0.018);
            let coils =
                curve(24, |t| seat + dvec3(0.045 * cos(6.0 * PI * t), 0.045 * sin(6.0 * PI * t), 0.19 + 0.13 * t));
            parts.tube(STEEL, &coils, |_| 0.01);
        }
        parts.rod(METAL, [end - DVec3::Y * 0.06, end + DVec3::Y * 0.06], 0.05);
        parts.rod(0.4, [at(0.47), at(0.86)], 0.035);
        parts.rod(METAL, [at(0.45), at(0.8)], 0.012);
    }
    // Shaft, wheel, pulley.
    let middle = dvec3(0.0, 0.0, -0.5);
    for y in [-0.8, -0.08, 0.6] {
        let to = if y < -0.5 { 0.19 } else { 0.16 };
        parts.rod(METAL, [middle + DVec3::Y * y, middle + DVec3::Y * (y + to)], 0.07);
    }
    for (y, to, radius) in [(0.82, 0.9, 0.36), (-0.88, -0.82, 0.22)] {
        parts.rod(STEEL, [middle + DVec3::Y * y, middle + DVec3::Y * to], radius);
        for hole in 0..6 {
            let turn = TAU * f64::from(hole) / 6.0 + phase;
            let place = middle + dvec3(0.6 * radius * cos(turn), 0.0, 0.6 * radius * sin(turn));
            parts.rod(0.0, [place + DVec3::Y * (y - 0.01), place + DVec3::Y * (to + 0.01)], 0.14 * radius);
        }
    }
    // Bolts of the head and the pan, pipes with flanges.
    for side in SIDES {
        for bolt in [-0.7, -0.02, 0.66] {
            let foot = dvec3(side * 0.37, bolt, 0.1);
            parts.rod(STEEL, [foot, foot + DVec3::Z * 0.6], 0.028);
            parts.rod(STEEL, [foot + DVec3::Z * 0.58, foot + DVec3::Z * 0.64], 0.055);
            parts.rod(STEEL, [foot - dvec3(-side * 0.06, 0.0, 0.84), foot - dvec3(-side * 0.06, 0.0, 0.96)], 0.03);
        }
        for y in SIDES {
            let root = dvec3(side * 0.44, y * 0.36, 0.62);
            let fall = if side < 0.0 { chance.about(0.5, 0.1) } else { -chance.about(0.22, 0.1) };
            let path =
                curve(7, |t| root + dvec3(side * 0.36 * sin(PI / 2.0 * t), 0.0, -fall * (1.0 - cos(PI / 2.0 * t))));
            parts.pipe([0.6, 0.0], &path, [0.088, 0.06]);
            parts.rod(STEEL, [root, root + DVec3::X * side * 0.035], 0.12);
            parts.rod(0.0, [root - DVec3::X * side * 0.02, root + DVec3::X * side * 0.05], 0.06);
        }
    }
    // Pores of the casting.
    let mut draws = parts.chance(1);
    for _ in 0..40 {
        let pore = dvec3(draws.between(-0.4, 0.4), draws.between(-0.76, 0.76), draws.between(0.46, 0.66));
        parts.ball(0.0, pore, draws.between(0.008, 0.02));
    }
}

pub(in super::super) fn mount(parts: &mut Parts, chance: &mut Chance) {
    const ALLOY: f64 = 0.7;
    const STEEL: f64 = 1.0;
    // Gussets: boxes cut along their diagonal, where no other part lies yet.
    let slope = DQuat::from_rotation_x(chance.about(0.62, 0.05));
    for side in SIDES {
        parts.cuboid(ALLOY, [side * 0.5, 0.04, -0.2], [0.05, 0.58, 0.6]);
    }
    turned_box(parts, 0.0, dvec3(0.0, -0.52, 0.22), dvec3(0.9, 0.5, 1.0), slope);
    for side in SIDES {
        let hole = dvec3(side * 0.5, 0.22, -0.36);
        parts.rod(0.0, [hole - DVec3::X * 0.1, hole + DVec3::X * 0.1], 0.14);
    }
    // Base with holes and slots, upright with a bearing.
    parts.cuboid(ALLOY, [0.0, 0.0, -0.8], [0.9, 0.7, 0.09]);
    parts.cuboid(ALLOY, [0.0, 0.56, -0.15], [0.66, 0.09, 0.7]);
    let bore = dvec3(0.0, 0.0, chance.about(0.3, 0.05));
    parts.rod(ALLOY, [bore + DVec3::Y * 0.2, bore + DVec3::Y * 0.78], 0.44);
    parts.rod(STEEL, [bore + DVec3::Y * 0.18, bore + DVec3::Y * 0.8], 0.34);
    parts.rod(0.1, [bore + DVec3::Y * 0.17, bore + DVec3::Y * 0.81], 0.3);
    let start = chance.between(0.0, TAU);
    for ball in 0..11 {
        let turn = start + TAU * f64::from(ball) / 11.0;
        let place = bore + dvec3(0.255 * cos(turn), 0.0, 0.255 * sin(turn));
        for y in [0.32, 0.66] {
            parts.ball(STEEL, place + DVec3::Y * y, 0.05);
        }
    }
    parts.rod(STEEL, [bore + DVec3::Y * 0.19, bore + DVec3::Y * 0.79], 0.215);
    parts.rod(0.0, [bore + DVec3::Y * 0.1, bore + DVec3::Y * 0.9], 0.17);
    parts.cuboid(0.0, bore + dvec3(0.0, 0.49, 0.18), [0.035, 0.32, 0.035]);
    for side in SIDES {
        for y in SIDES {
            let hole = dvec3(side * 0.74, y * 0.5, -0.8);
            parts.rod(ALLOY, [hole, hole + DVec3::Z * 0.14], 0.14);
            parts.rod(0.0, [hole - DVec3::Z * 0.1, hole + DVec3::Z * 0.2], 0.075);
            parts.rod(0.0, [hole + DVec3::Z * 0.08, hole + DVec3::Z * 0.2], 0.105);
        }
        // Screws with heads and threads hold the upright.
        for z in [-0.55, 0.42] {
            let foot = dvec3(side * 0.56, 0.3, z);
            parts.rod(STEEL, [foot, foot + DVec3::Y * 0.36], 0.04);
            for thread in 0..6 {
                let y = 0.1 + 0.045 * f64::from(thread);
                parts.rod(STEEL, [foot + DVec3::Y * y, foot + DVec3::Y * (y + 0.018)], 0.052);
            }
            parts.rod(STEEL, [foot + DVec3::Y * 0.35, foot + DVec3::Y * 0.42], 0.085);
            parts.rod(0.0, [foot + DVec3::Y * 0.38, foot + DVec3::Y * 0.44], 0.04);
        }
    }
    let slot = [dvec3(-0.22, -0.45, -0.8), dvec3(0.22, -0.45, -0.8)];
    parts.strap(0.0, slot, DVec3::Y, [0.075, 0.2]);
    for y in [0.1, 0.3] {
        parts.rod(0.0, [dvec3(-0.2, y, -0.95), dvec3(-0.2, y, -0.65)], 0.05);
        parts.rod(0.0, [dvec3(0.2, y, -0.95), dvec3(0.2, y, -0.65)], 0.05);
    }
    // An oil channel, and pores of the casting.
    parts.rod(0.0, [bore + dvec3(0.0, 0.5, 0.3), bore + dvec3(0.0, 0.5, 0.5)], 0.03);
    for i in 0..60 {
        let mut draws = parts.chance(10 + i);
        let pore = if i < 30 {
            dvec3(draws.between(-0.62, 0.62), draws.between(0.5, 0.62), draws.between(-0.65, -0.2))
        } else {
            dvec3(draws.between(-0.55, 0.55), draws.between(-0.25, 0.6), draws.between(-0.86, -0.74))
        };
        parts.ball(0.0, pore, draws.between(0.008, 0.024));
    }
}

pub(in super::super) fn present(parts: &mut Parts, chance: &mut Chance) {
    const CARD: f64 = 0.35;
    const RIBBON: f64 = 0.6;
    // Box with a lid, ribbons around it, the bow.
    let half = dvec3(chance.about(0.76, 0.02), chance.about(0.7, 0.02), 0.56);
    let middle = dvec3(0.0, 0.0, -0.32);
    let lid = middle + DVec3::Z * 0.46;
    parts.cuboid(RIBBON, middle, half * dvec3(0.0, 1.0, 1.0) + dvec3(0.09, 0.045, 0.045));
    parts.cuboid(RIBBON, middle, half * dvec3(1.0, 0.0, 1.0) + dvec3(0.045, 0.09, 0.045));
    parts.cuboid(CARD, lid, dvec3(half.x + 0.03, half.y + 0.03, 0.125));
    parts.cuboid(CARD, middle, half);
    parts.cuboid(0.01, middle, half - 0.03);
    let knot = dvec3(0.0, 0.0, 0.31);
    for bow in 0..6 {
        let turn = TAU * f64::from(bow) / 6.0 + chance.between(-0.12, 0.12);
        let (out, size) = (dvec3(cos(turn), sin(turn), 0.0), chance.about(0.42, 0.08));
        let path = curve(10, |t| knot + out * size * sin(PI * t) + DVec3::Z * (0.02 + 0.3 * t + 0.1 * sin(TAU * t)));
        let across = out.cross(DVec3::Z);
        for ends in path.windows(2) {
            let flat = (ends[1] - ends[0]).cross(across);
            parts.strap(RIBBON, [ends[0], ends[1]], flat, [0.014, 0.085]);
        }
    }
    parts.ball(RIBBON, knot + DVec3::Z * 0.06, 0.09);
    // Packing chips below and between, then the wrapped objects.
    for i in 0..170 {
        let mut draws = parts.chance(100 + i);
        let room = half - 0.11;
        let chip = middle + dvec3(draws.between(-1.0, 1.0), draws.between(-1.0, 1.0), draws.between(-1.0, 0.35)) * room;
        let along = draws.direction() * 0.045;
        parts.capsule(0.12, [chip - along, chip + along], 0.035);
    }
    bear(parts, dvec3(-0.36, 0.16, -0.42));
    car(parts, dvec3(0.34, -0.3, -0.62), DQuat::from_rotation_z(chance.between(-0.3, 0.3)));
    // A watch in its case, a bottle of scent, marbles.
    let watch = dvec3(0.36, 0.36, -0.66);
    parts.cuboid(0.4, watch, [0.24, 0.2, 0.14]);
    parts.cuboid(0.0, watch, [0.22, 0.18, 0.12]);
    parts.cylinder(METAL, watch, [0.1, 0.1, 0.035]);
    parts.cylinder(0.3, watch, [0.08, 0.08, 0.024]);
    let hand = chance.between(0.0, TAU);
    for (length, turn) in [(0.07, hand), (0.045, 12.0 * hand)] {
        parts.capsule(METAL, [watch, watch + dvec3(length * cos(turn), length * sin(turn), 0.0)], 0.006);
    }
    let strap =
        curve(16, |t| watch + dvec3(0.1 * cos(0.35 + (TAU - 0.7) * t) - 0.1, 0.0, 0.08 * sin(0.35 + (TAU - 0.7) * t)));
    for ends in strap.windows(2) {
        parts.strap(0.75, [ends[0], ends[1]], (ends[1] - ends[0]).cross(DVec3::Y), [0.01, 0.05]);
    }
    bottle(parts, dvec3(0.05, 0.4, -0.82), dvec3(0.0, 0.0, 0.62), 0.12, chance.between(0.3, 0.9));
    for i in 0..9 {
        let turn = GOLDEN * f64::from(i);
        let out = 0.05 + 0.045 * f64::from(i).sqrt();
        parts.ball(chance.between(0.75, 0.95), [0.4 + out * cos(turn), -0.02 + out * sin(turn), -0.8], 0.045);
    }
}

/// A plush bear with a voice box and glass eyes.
fn bear(parts: &mut Parts, seat: DVec3) {
    let mut chance = parts.chance(1);
    let plush = |parts: &mut Parts, centre: DVec3, half: DVec3| {
        parts.ellipsoid(0.32, centre, half);
        parts.ellipsoid(0.16, centre, half - 0.02);
    };
    let head = seat + dvec3(0.0, -0.03, 0.33);
    for side in SIDES {
        plush(parts, head + dvec3(side * 0.12, 0.0, 0.12), DVec3::splat(0.06));
        plush(parts, seat + dvec3(side * 0.2, -0.05, chance.between(0.02, 0.14)), dvec3(0.12, 0.065, 0.065));
        plush(parts, seat + dvec3(side * 0.12, -0.2, -0.18), dvec3(0.075, 0.16, 0.075));
    }
    plush(parts, seat, dvec3(0.18, 0.16, 0.23));
    plush(parts, head, dvec3(0.155, 0.14, 0.14));
    plush(parts, head - dvec3(0.0, 0.13, 0.03), dvec3(0.07, 0.06, 0.055));
    for side in SIDES {
        parts.ball(0.95, head + dvec3(side * 0.06, -0.125, 0.035), 0.02);
    }
    parts.ball(0.8, head - dvec3(0.0, 0.19, 0.02), 0.02);
    parts.cylinder(0.7, seat, [0.07, 0.07, 0.06]);
    parts.cylinder(0.1, seat, [0.055, 0.055, 0.045]);
}

/// A tin car with wheels, axles and a spring.
fn car(parts: &mut Parts, place: DVec3, turn: DQuat) {
    let at = |x: f64, y: f64, z: f64| place + turn * dvec3(x, y, z);
    for (density, wall) in [(0.9, 0.0), (0.0, 0.016)] {
        turned_box(parts, density, at(0.0, 0.0, 0.0), dvec3(0.28, 0.14, 0.075) - wall, turn);
        turned_box(parts, density, at(-0.04, 0.0, 0.11), dvec3(0.15, 0.12, 0.07) - wall, turn);
    }
    turned_box(parts, 0.0, at(-0.04, 0.0, 0.12), dvec3(0.11, 0.13, 0.035), turn);
    for x in [-0.16, 0.16] {
        parts.rod(METAL, [at(x, -0.17, -0.08), at(x, 0.17, -0.08)], 0.012);
        for side in SIDES {
            let [inner, outer] = [0.125, 0.18].map(|y| at(x, side * y, -0.08));
            parts.rod(0.5, [inner, outer], 0.072);
            parts.rod(0.85, [inner, outer], 0.035);
        }
    }
    let spring = curve(32, |t| at(-0.1 + 0.2 * t, 0.035 * cos(16.0 * PI * t), 0.035 * sin(16.0 * PI * t)));
    parts.tube(METAL, &spring, |_| 0.008);
}

pub(in super::super) fn teapot(parts: &mut Parts, chance: &mut Chance) {
    const CLAY: f64 = 0.8;
    const GLAZE: f64 = 0.95;
    // Spout to +x, handle to -x. The belly is filled last, so that both end in its wall.
    let belly = (dvec3(0.0, 0.0, -0.12), dvec3(0.58, 0.58, chance.about(0.46, 0.03)));
    let lift = chance.about(0.42, 0.08);
    let spout = curve(10, |t| dvec3(0.45 + 0.42 * t, 0.0, -0.22 + lift * (t + 0.6 * t * t * t)));
    let width = |t: f64| 0.15 - 0.095 * t;
    parts.tube(CLAY, &spout, width);
    let handle = curve(16, |t| {
        let turn = PI * (0.3 + 1.3 * t);
        dvec3(-0.5 + 0.38 * cos(turn), 0.0, -0.05 + 0.34 * sin(turn))
    });
    handle.windows(2).for_each(|ends| parts.strap(CLAY, [ends[0], ends[1]], DVec3::Y, [0.05, 0.05]));
    parts.cylinder(CLAY, [0.0, 0.0, belly.0.z - 0.45], [0.36, 0.36, 0.07]);
    parts.cylinder(0.0, [0.0, 0.0, belly.0.z - 0.51], [0.3, 0.3, 0.04]);
    parts.ellipsoid(GLAZE, belly.0, belly.1);
    parts.ellipsoid(CLAY, belly.0, belly.1 - 0.012);
    parts.ellipsoid(0.0, belly.0, belly.1 - 0.06);
    let mouth = *spout.last().expect("a curve has points") + dvec3(0.03, 0.0, 0.06);
    let bore: Vec<DVec3> = spout.iter().copied().chain([mouth]).collect();
    parts.tube(0.0, &bore, |t| width(t) - 0.03);
    // A sieve in front of the spout; rim; lid with knob and hole.
    for (i, hole) in arc(5, [0.0, 0.0, 0.0], [0.08, 0.08], [0.0, TAU]).into_iter().enumerate().skip(1) {
        parts.ball(CLAY, dvec3(0.5 + 0.005 * i as f64, hole.x, -0.16 + hole.y), 0.028);
    }
    parts.cylinder(CLAY, [0.0, 0.0, 0.3], [0.33, 0.33, 0.05]);
    parts.cylinder(0.0, [0.0, 0.0, 0.28], [0.28, 0.28, 0.1]);
    parts.ellipsoid(GLAZE, [0.0, 0.0, 0.35], [0.31, 0.31, 0.16]);
    parts.ellipsoid(0.0, [0.0, 0.0, 0.31], [0.27, 0.27, 0.14]);
    parts.cylinder(CLAY, [0.0, 0.0, 0.34], [0.32, 0.32, 0.022]);
    parts.cylinder(0.0, [0.0, 0.0, 0.3], [0.25, 0.25, 0.07]);
    parts.cone(CLAY, [dvec3(0.0, 0.0, 0.48), dvec3(0.0, 0.0, 0.58)], [0.06, 0.04]);
    parts.ball(GLAZE, [0.0, 0.0, 0.63], chance.about(0.09, 0.1));
    parts.rod(0.0, [dvec3(0.14, 0.0, 0.3), dvec3(0.16, 0.0, 0.56)], 0.018);
    for _ in 0..14 {
        let bubble = belly.0 + chance.direction() * (belly.1 - 0.036);
        parts.ball(0.4, bubble, chance.between(0.008, 0.018));
    }
    lobster(parts, belly.0 - dvec3(0.0, 0.0, 0.24));
}

/// A lobster, as in a well-known data set: body, tail, claws, legs, antennae.
fn lobster(parts: &mut Parts, place: DVec3) {
    const SHELL: f64 = 0.55;
    let mut chance = parts.chance(1);
    let turn = DQuat::from_rotation_z(chance.between(0.0, TAU));
    let at = |x: f64, y: f64, z: f64| place + turn * dvec3(x, y, z);
    for ring in 0..6 {
        let x = -0.06 - 0.05 * f64::from(ring);
        parts.ellipsoid(SHELL, at(x, 0.0, -0.004 * f64::from(ring)), DVec3::splat(0.062 - 0.005 * f64::from(ring)));
    }
    for fan in -1..=1 {
        let end = at(-0.4, 0.06 * f64::from(fan), -0.02);
        parts.strap(SHELL, [at(-0.33, 0.0, -0.02), end], DVec3::Z, [0.012, 0.03]);
    }
    parts.ellipsoid_along(SHELL, at(0.06, 0.0, 0.0), dvec3(0.07, 0.07, 0.14), turn * DVec3::X);
    parts.ellipsoid_along(0.3, at(0.06, 0.0, 0.0), dvec3(0.05, 0.05, 0.115), turn * DVec3::X);
    for side in SIDES {
        let (elbow, wrist) = (at(0.22, side * 0.13, 0.0), at(0.27, side * 0.07, 0.03));
        parts.tube(SHELL, &[at(0.1, side * 0.05, 0.0), elbow, wrist], |_| 0.02);
        let open = chance.between(0.01, 0.04);
        for (aside, size) in [(open, 0.034), (-open, 0.022)] {
            parts.capsule(SHELL, [wrist, wrist + turn * dvec3(0.1, side * (aside - 0.02), 0.02)], size);
        }
        for leg in 0..4 {
            let x = 0.12 - 0.05 * f64::from(leg);
            let knee = at(x - 0.01, side * 0.14, 0.04);
            parts.tube(SHELL, &[at(x, side * 0.05, -0.02), knee, at(x - 0.03, side * 0.19, -0.06)], |_| 0.009);
        }
        parts.tube(
            SHELL,
            &[at(0.19, side * 0.02, 0.02), at(0.26, side * 0.1, 0.1), at(0.12, side * 0.2, 0.15)],
            |_| 0.007,
        );
    }
}
