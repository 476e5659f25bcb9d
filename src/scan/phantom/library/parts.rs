//! The builder that phantoms are assembled with.

use super::super::solid::{Shape, Solid};
use glam::{DMat3, DQuat, DVec3};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use std::f64::consts::TAU;
use trgs_core::numeric::elementary::{cos, sin};
use trgs_core::numeric::rng::{Purpose, stream};

/// Parts in order of insertion: each displaces earlier parts where they overlap.
pub(in super::super) struct Parts {
    seed: u64,
    phantom: u64,
    solids: Vec<Solid>,
}

/// Random numbers for one group of parts.
pub(in super::super) struct Chance(ChaCha8Rng);

impl Parts {
    /// The parts that `draw` adds, with the random numbers of the group 0.
    ///
    /// `phantom` is a number unique to the phantom, so that no two phantoms share random numbers.
    pub(in super::super) fn drawn(seed: u64, phantom: u64, draw: fn(&mut Self, &mut Chance)) -> Vec<Solid> {
        let mut parts = Self { seed, phantom, solids: Vec::new() };
        let mut chance = parts.chance(0);
        draw(&mut parts, &mut chance);
        parts.solids
    }

    /// The random numbers of a group of parts; they depend only on the seed, the phantom and `id`.
    pub(super) fn chance(&self, id: u64) -> Chance {
        Chance(stream(self.seed, Purpose::Phantom, self.phantom, id))
    }

    pub(super) fn put(&mut self, solid: Solid) {
        self.solids.push(solid.displacing());
    }

    pub(super) fn ellipsoid(&mut self, density: f64, centre: impl Into<DVec3>, half: impl Into<DVec3>) {
        self.put(Solid::new(Shape::Ellipsoid, density, centre.into(), half.into()));
    }

    pub(super) fn cuboid(&mut self, density: f64, centre: impl Into<DVec3>, half: impl Into<DVec3>) {
        self.put(Solid::new(Shape::Cuboid, density, centre.into(), half.into()));
    }

    /// A cylinder with its axis along z.
    pub(super) fn cylinder(&mut self, density: f64, centre: impl Into<DVec3>, half: impl Into<DVec3>) {
        self.put(Solid::new(Shape::Cylinder, density, centre.into(), half.into()));
    }

    pub(super) fn ball(&mut self, density: f64, centre: impl Into<DVec3>, radius: f64) {
        self.ellipsoid(density, centre, DVec3::splat(radius));
    }

    /// An ellipsoid whose z axis points along `axis`.
    pub(super) fn ellipsoid_along(&mut self, density: f64, centre: DVec3, half: DVec3, axis: DVec3) {
        self.put(Solid::new(Shape::Ellipsoid, density, centre, half).rotated(from_z(axis)));
    }

    /// A cylinder between the centres of its ends.
    pub(super) fn rod(&mut self, density: f64, ends: [impl Into<DVec3>; 2], radius: f64) {
        let [from, to] = ends.map(Into::into);
        let half = DVec3::new(radius, radius, from.distance(to) / 2.0);
        self.put(Solid::new(Shape::Cylinder, density, (from + to) / 2.0, half).rotated(from_z(to - from)));
    }

    /// A cylinder whose radius changes between its ends.
    pub(super) fn cone(&mut self, density: f64, ends: [impl Into<DVec3>; 2], radii: [f64; 2]) {
        let ([from, to], [r, s]) = (ends.map(Into::into), radii);
        let half = DVec3::new((r + s) / 2.0, (r + s) / 2.0, from.distance(to) / 2.0);
        let shape = Shape::Cone { taper: (r - s) / (r + s) };
        self.put(Solid::new(shape, density, (from + to) / 2.0, half).rotated(from_z(to - from)));
    }

    /// All points within `radius` of a line segment.
    pub(super) fn capsule(&mut self, density: f64, ends: [impl Into<DVec3>; 2], radius: f64) {
        let [from, to] = ends.map(Into::into);
        let shape = Shape::Capsule { core: from.distance(to) / (2.0 * radius) };
        self.put(Solid::new(shape, density, (from + to) / 2.0, DVec3::splat(radius)).rotated(from_z(to - from)));
    }

    /// A capsule of half width `thick` along `flat` and half width `wide` across it.
    pub(super) fn strap(&mut self, density: f64, ends: [DVec3; 2], flat: DVec3, [thick, wide]: [f64; 2]) {
        let [from, to] = ends;
        let z = (to - from).normalize();
        let y = z.cross(flat).normalize();
        let end = thick.min(wide);
        let shape = Shape::Capsule { core: from.distance(to) / (2.0 * end) };
        let turn = DQuat::from_mat3(&DMat3::from_cols(y.cross(z), y, z));
        self.put(Solid::new(shape, density, (from + to) / 2.0, DVec3::new(thick, wide, end)).rotated(turn));
    }

    /// Capsules along a curve; `radius` is a function of the position along it, from 0 to 1.
    pub(super) fn tube(&mut self, density: f64, points: &[DVec3], radius: impl Fn(f64) -> f64) {
        let n = points.len() - 1;
        for (i, pair) in points.windows(2).enumerate() {
            self.capsule(density, [pair[0], pair[1]], radius((i as f64 + 0.5) / n as f64));
        }
    }

    /// A tube with wall and filling.
    pub(super) fn pipe(&mut self, [wall, filling]: [f64; 2], points: &[DVec3], [outer, inner]: [f64; 2]) {
        self.tube(wall, points, |_| outer);
        self.tube(filling, points, |_| inner);
    }
}

impl Chance {
    /// A uniform random number between two numbers.
    pub(super) fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.0.random::<f64>()
    }

    /// A random number within the relative distance `spread` of `value`.
    pub(super) fn about(&mut self, value: f64, spread: f64) -> f64 {
        value * self.between(1.0 - spread, 1.0 + spread)
    }

    /// A random vector with components from `-size` to `size`.
    pub(super) fn shift(&mut self, size: f64) -> DVec3 {
        DVec3::new(self.between(-size, size), self.between(-size, size), self.between(-size, size))
    }

    /// A random unit vector, uniform on the sphere.
    pub(super) fn direction(&mut self) -> DVec3 {
        let (height, turn) = (self.between(-1.0, 1.0), self.between(0.0, TAU));
        let around = (1.0 - height * height).max(0.0).sqrt();
        DVec3::new(around * cos(turn), around * sin(turn), height)
    }

    /// A random point inside the unit ball, denser towards its centre.
    pub(super) fn inside(&mut self) -> DVec3 {
        self.direction() * self.between(0.0, 1.0)
    }
}

/// The rotation that takes z to a direction.
fn from_z(direction: DVec3) -> DQuat {
    DQuat::from_rotation_arc(DVec3::Z, direction.normalize())
}

/// `n` + 1 points of a curve over [0, 1].
pub(super) fn curve(n: usize, point: impl Fn(f64) -> DVec3) -> Vec<DVec3> {
    (0..=n).map(|i| point(i as f64 / n as f64)).collect()
}

/// Points of a horizontal ellipse around `centre` between two angles (radians), measured from x.
pub(super) fn arc(n: usize, centre: impl Into<DVec3>, [a, b]: [f64; 2], [from, to]: [f64; 2]) -> Vec<DVec3> {
    let centre = centre.into();
    curve(n, |t| {
        let turn = from + (to - from) * t;
        centre + DVec3::new(a * cos(turn), b * sin(turn), 0.0)
    })
}

/// The point itself, or the point where the segment from `centre` to it leaves the ellipsoid.
pub(super) fn pulled_into(point: DVec3, centre: DVec3, half: DVec3) -> DVec3 {
    let distance = ((point - centre) / half).length();
    if distance <= 1.0 { point } else { centre + (point - centre) / distance }
}
