//! Phantoms with exactly known density and line integrals: sums of solids. Not in the paper.
//!
//! Solids are ellipsoids, cuboids, cylinders, cones and capsules that add up or displace each other.
//!
//! Fifteen phantoms are named and grouped like the scans of the paper's synthetic cases. They are **stand-ins**: they
//! share the names and, roughly, the appearance. Measurements on them imply nothing about the paper's figures.

mod library;
pub mod solid;
mod voxels;

use super::trace::trace;
use glam::DVec3;
use library::parts::{Chance, Parts};
use library::{artificial, basic, nature, organs};
use solid::Solid;
use trgs_core::error::{Error, Result};
use trgs_core::geometry::{Grid, Projections, Ray, Scanner, Trajectory, Volume};
use trgs_core::numeric::reduce;

/// The groups of the paper's synthetic cases.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Group {
    /// Parts of the human body.
    Organs,
    /// Animals and plants.
    AnimalsAndPlants,
    /// Artificial objects.
    Artificial,
}

/// A named phantom.
#[derive(Clone, Copy, Debug)]
pub struct Named {
    /// Its name.
    pub name: &'static str,
    /// Its appearance or purpose.
    pub description: &'static str,
    /// The group of the paper's case that it stands in for; `None` if it imitates no scan.
    pub group: Option<Group>,
    source: Source,
}

/// Where the solids of a phantom come from.
#[derive(Clone, Copy, Debug)]
enum Source {
    /// A function of the seed.
    Own(fn(u64) -> Vec<Solid>),
    /// The number of the phantom, and a function that adds its parts.
    Drawn(u64, fn(&mut Parts, &mut Chance)),
}

/// The named phantoms: first those without a group, then the stand-ins in the order of their groups.
pub const PHANTOMS: [Named; 20] = {
    use Group::{AnimalsAndPlants, Artificial, Organs};
    [
        own("shepp-logan", "the head phantom in three dimensions, with contrasts one can see", |_| {
            basic::shepp_logan()
        }),
        own("torso", "a chest with lungs, heart, spine and ribs", |_| basic::torso()),
        own("foam", "a ball with hundreds of bubbles; the seed places them", basic::foam),
        own("axes", "a different marker on every axis and in every octant: shows flips and exchanged axes", |_| {
            basic::axes()
        }),
        own("letters", "a cube with R, A and S on these sides of the patient", |_| basic::letters()),
        drawn("chest", Organs, "lungs with vessels and a nodule, heart, ribs, spine", 1, organs::chest),
        drawn("foot", Organs, "26 bones with marrow in soft tissue", 2, organs::foot),
        drawn("head", Organs, "skull, brain with sulci and ventricles, sinuses, teeth", 3, organs::head),
        drawn("jaw", Organs, "both jaws with teeth of enamel, dentine and pulp", 4, organs::jaw),
        drawn("pancreas", Organs, "the upper abdomen with its organs, vessels and bowels", 5, organs::pancreas),
        drawn("beetle", AnimalsAndPlants, "a stag beetle: thin shells, legs, antennae", 11, nature::beetle),
        drawn("bonsai", AnimalsAndPlants, "a small tree in a pot", 12, nature::bonsai),
        drawn("broccoli", AnimalsAndPlants, "a branching stalk with florets of buds", 13, nature::broccoli),
        drawn("kingsnake", AnimalsAndPlants, "a coiled snake with vertebrae and ribs", 14, nature::kingsnake),
        drawn("pepper", AnimalsAndPlants, "a hollow pepper with walls, seeds and stem", 15, nature::pepper),
        drawn("backpack", Artificial, "a bag with bottles, books, cans and cables", 21, artificial::backpack),
        drawn(
            "engine",
            Artificial,
            "a block with two cylinders, pistons, crankshaft and pipes",
            22,
            artificial::engine,
        ),
        drawn("mount", Artificial, "a metal bracket with bores, ribs and screws", 23, artificial::mount),
        drawn("present", Artificial, "a box with ribbons, bow and toys", 24, artificial::present),
        drawn("teapot", Artificial, "a pot with spout, handle and lid, and a lobster inside", 25, artificial::teapot),
    ]
};

const fn own(name: &'static str, description: &'static str, solids: fn(u64) -> Vec<Solid>) -> Named {
    Named { name, description, group: None, source: Source::Own(solids) }
}

const fn drawn(
    name: &'static str,
    group: Group,
    description: &'static str,
    number: u64,
    draw: fn(&mut Parts, &mut Chance),
) -> Named {
    Named { name, description, group: Some(group), source: Source::Drawn(number, draw) }
}

impl Group {
    /// All groups in the paper's order.
    pub const ALL: [Self; 3] = [Self::Organs, Self::AnimalsAndPlants, Self::Artificial];

    /// The name of the group for display.
    pub fn title(self) -> &'static str {
        match self {
            Self::Organs => "human organs",
            Self::AnimalsAndPlants => "animals and plants",
            Self::Artificial => "artificial objects",
        }
    }

    /// The stand-ins of the group.
    pub fn stand_ins(self) -> impl Iterator<Item = Named> {
        PHANTOMS.into_iter().filter(move |phantom| phantom.group == Some(self))
    }
}

/// A sequence of solids.
#[derive(Clone, Debug, PartialEq)]
pub struct Phantom {
    /// Its name.
    pub name: String,
    /// Its parts. Overlapping densities add up, except that a displacing part replaces all parts before it.
    pub solids: Vec<Solid>,
}

impl Phantom {
    /// The phantom with one of the names of [`PHANTOMS`].
    ///
    /// It lies inside [-1,1]³ with densities from 0 to 1. `seed` varies the details of a stand-in and the bubbles of
    /// the foam.
    ///
    /// # Errors
    /// For an unknown name; the message lists the names and suggests the nearest one.
    pub fn by_name(name: &str, seed: u64) -> Result<Self> {
        if let Some(phantom) = PHANTOMS.iter().find(|phantom| phantom.name == name) {
            let solids = match phantom.source {
                Source::Own(solids) => solids(seed),
                Source::Drawn(number, draw) => Parts::drawn(seed, number, draw),
            };
            return Ok(Self { name: name.into(), solids });
        }
        let names = PHANTOMS.map(|phantom| phantom.name);
        let distance = |candidate: &&str| strsim::damerau_levenshtein(name, candidate);
        let nearest = names.into_iter().min_by_key(distance).unwrap_or_default();
        let remedy = format!("did you mean {nearest}?");
        Err(Error::invalid("phantom", name, format!("one of {}", names.join(", ")), remedy))
    }

    /// The caveat to state with any result on a stand-in; `None` for other phantoms.
    pub fn caveat(&self) -> Option<String> {
        PHANTOMS.iter().find(|phantom| phantom.name == self.name)?.group.map(|_| {
            let name = &self.name;
            format!("{name} is a procedural stand-in: it shares only its name with the scan of the paper's case {name}")
        })
    }

    /// Density at a point.
    pub fn density_at(&self, point: DVec3) -> f64 {
        self.solids.iter().filter(|solid| solid.contains(point)).fold(0.0, |below, solid| solid.over(below))
    }

    /// Integral of the density along the whole line of a ray, length × density, exact to rounding.
    pub fn line_integral(&self, ray: &Ray) -> f64 {
        if !self.solids.iter().any(Solid::displaces) {
            return reduce::sum_by(self.solids.len(), &|i| self.solids[i].line_integral(ray));
        }
        let chords: Vec<_> = self.solids.iter().filter_map(|solid| Some((solid, solid.chord(ray)?))).collect();
        let mut ends: Vec<f64> = chords.iter().flat_map(|(_, (from, to))| [*from, *to]).collect();
        ends.sort_by(f64::total_cmp);
        reduce::sum_by(ends.len().saturating_sub(1), &|i| {
            let (from, to) = (ends[i], ends[i + 1]);
            let middle = (from + to) / 2.0;
            let here = chords.iter().filter(|(_, chord)| chord.0 <= middle && middle <= chord.1);
            here.fold(0.0, |below, (solid, _)| solid.over(below)) * (to - from)
        })
    }

    /// The mean density of each voxel.
    ///
    /// It is exact inside solids; voxels on a surface average `samples`³ points.
    pub fn voxelize(&self, grid: &Grid, samples: usize) -> Volume {
        voxels::means(&self.solids, grid, samples)
    }

    /// Exact projections in the views of a trajectory, one ray through the centre of each pixel.
    ///
    /// # Errors
    /// When there is no angle, or one is not finite.
    pub fn project<'a>(&self, scanner: &Scanner, views: impl Into<Trajectory<'a>>) -> Result<Projections> {
        trace(scanner, views, |ray| self.line_integral(ray))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tolerances::largest;
    use ndarray::Array3;
    use trgs_core::geometry::{Beam, Detector};
    use trgs_core::numeric::threads;

    fn phantoms() -> impl Iterator<Item = Phantom> {
        PHANTOMS.into_iter().map(|phantom| Phantom::by_name(phantom.name, 3).unwrap())
    }

    fn stand_ins() -> impl Iterator<Item = Named> {
        Group::ALL.into_iter().flat_map(Group::stand_ins)
    }

    fn scanner(beam: Beam) -> Scanner {
        let detector = Detector { rows: 9, columns: 13, pitch_v: 0.3, pitch_u: 0.25, offset_u: 0.1, offset_v: -0.2 };
        Scanner { beam, detector, grid: Grid::cube(16) }
    }

    #[test]
    fn phantoms_that_add_up_have_densities_from_0_to_1_and_air_around_them() {
        for phantom in phantoms().filter(|phantom| !phantom.solids.iter().any(Solid::displaces)) {
            let (mut range, mut end) = ((f64::INFINITY, f64::NEG_INFINITY), 0.0);
            let n = 101;
            for (x, y, z) in (0..n * n * n).map(|k| (k / n / n, k / n % n, k % n)) {
                let point = DVec3::new(x as f64, y as f64, z as f64) * (2.0 / (n - 1) as f64) - 1.0;
                let density = phantom.density_at(point);
                range = (range.0.min(density), range.1.max(density));
                if density != 0.0 {
                    end = f64::max(end, point.abs().max_element());
                }
            }
            within!("end", end, "{}", phantom.name);
            within!("range", f64::max(-range.0, range.1 - 1.0), "{}: {range:?}", phantom.name);
            beyond!("peak", range.1, "{}", phantom.name);
        }
    }

    #[test]
    fn stand_ins_have_densities_from_0_to_1_and_air_around_them_whatever_the_seed() {
        for (named, seed) in stand_ins().flat_map(|named| (0..40).map(move |seed| (named, seed))) {
            let Phantom { name, solids } = Phantom::by_name(named.name, seed).unwrap();
            assert!(solids.len() <= 600, "{name}: {} solids", solids.len());
            // Where each solid displaces the ones before, densities are those of single solids.
            for solid in &solids {
                assert!(solid.displaces() && (0.0..=1.0).contains(&solid.density()), "{name}: {solid:?}");
                let end = (solid.centre().abs() + solid.reach()).max_element();
                if solid.density() != 0.0 {
                    within!(end, "{name} with seed {seed}: {solid:?}");
                }
            }
        }
    }

    #[test]
    fn stand_ins_follow_the_seed_and_are_all_different() {
        let volumes = |seed| {
            let volume = |named: Named| Phantom::by_name(named.name, seed).unwrap().voxelize(&Grid::cube(32), 2).values;
            stand_ins().map(volume).collect::<Vec<_>>()
        };
        let differ = |a: &Array3<f32>, b: &Array3<f32>| a.iter().zip(b).filter(|(a, b)| (*a - *b).abs() > 0.02).count();
        let (first, other) = (volumes(3), volumes(4));
        for (i, named) in stand_ins().enumerate() {
            assert_eq!(Phantom::by_name(named.name, 3).unwrap(), Phantom::by_name(named.name, 3).unwrap());
            assert!(differ(&first[i], &other[i]) > 50, "{}: {}", named.name, differ(&first[i], &other[i]));
            let peak = first[i].iter().fold(0.0_f32, |a, &b| a.max(b));
            assert!(peak <= 1.0, "{}: {peak}", named.name);
            beyond!(peak, "{}", named.name);
            for j in 0..i {
                assert!(differ(&first[i], &first[j]) > 1000, "{} looks like number {j}", named.name);
            }
        }
    }

    #[test]
    fn there_are_five_stand_ins_in_each_of_the_three_groups_and_they_say_what_they_are() {
        let names = Group::ALL.map(|group| group.stand_ins().map(|named| named.name).collect::<Vec<_>>());
        let expected = [
            ["chest", "foot", "head", "jaw", "pancreas"],
            ["beetle", "bonsai", "broccoli", "kingsnake", "pepper"],
            ["backpack", "engine", "mount", "present", "teapot"],
        ];
        assert_eq!(names, expected);
        for (named, phantom) in PHANTOMS.into_iter().zip(phantoms()) {
            assert_eq!(phantom.caveat().is_some_and(|caveat| caveat.contains("stand-in")), named.group.is_some());
        }
    }

    #[test]
    fn line_integrals_agree_with_quadrature() {
        for beam in [Beam::Cone { dso: 5.0, dsd: 7.0 }, Beam::Parallel { dso: 5.0 }] {
            let scanner = scanner(beam);
            for phantom in phantoms() {
                let projections = phantom.project(&scanner, &[0.4]).unwrap();
                let mut largest = 0.0_f32;
                for (row, column) in (0..9).flat_map(|row| [(row, 4), (row, 6), (row, 9)]) {
                    let ray = scanner.ray(&scanner.view(0.4), row, column);
                    // Only solids whose box lies near the ray: all others are far from its points.
                    let near = |solid: &&Solid| {
                        let nearest = ray.origin + ray.direction * (solid.centre() - ray.origin).dot(ray.direction);
                        nearest.distance(solid.centre()) <= solid.reach().length()
                    };
                    let solids: Vec<Solid> = phantom.solids.iter().filter(near).copied().collect();
                    let near = Phantom { name: "near".into(), solids };
                    let (n, from, to) = (10_000, 3.0, 7.0);
                    let step = (to - from) / n as f64;
                    let point = |i: usize| ray.origin + ray.direction * (from + (i as f64 + 0.5) * step);
                    let expected = reduce::sum_by(n, &|i| near.density_at(point(i)) * step);
                    let exact = projections.images[[0, row, column]];
                    let error = (f64::from(exact) - expected).abs();
                    within!(error, "{exact} instead of {expected}: {}", phantom.name);
                    largest = largest.max(exact);
                }
                beyond!("largest", largest, "{} was missed", phantom.name);
            }
        }
    }

    #[test]
    fn voxels_and_projections_hold_the_same_mass() {
        // Points and rays a hundredth apart in z, so that flat faces at hundredths lie midway between them. The
        // remaining error is that of counting lattice points in circles: 0.7 % for the engine's upright bores, 0.1 %
        // for most others.
        let (pitch_v, pitch_u) = (0.01, 0.014);
        let detector = Detector { rows: 200, columns: 200, pitch_v, pitch_u, offset_u: 0.0, offset_v: 0.0 };
        let scanner = Scanner { beam: Beam::Parallel { dso: 5.0 }, detector, grid: Grid::cube(50) };
        for phantom in phantoms() {
            let voxels = phantom.voxelize(&scanner.grid, 4);
            let voxels = reduce::sum(voxels.values.as_slice().unwrap()) * scanner.grid.spacing.element_product();
            let rays = phantom.project(&scanner, &[0.3]).unwrap();
            let rays = reduce::sum(rays.images.as_slice().unwrap()) * pitch_v * pitch_u;
            within!((voxels / rays - 1.0).abs(), "{}: {voxels} against {rays}", phantom.name);
        }
    }

    #[test]
    fn line_integrals_of_parts_add_up() {
        let torso = Phantom::by_name("torso", 0).unwrap();
        let (a, b) = torso.solids.split_at(7);
        let [a, b] = [a, b].map(|solids| Phantom { name: "part".into(), solids: solids.to_vec() });
        let scanner = scanner(Beam::Cone { dso: 4.0, dsd: 6.0 });
        for row in 0..9 {
            let ray = scanner.ray(&scanner.view(1.3), row, row);
            let sum = a.line_integral(&ray) + b.line_integral(&ray);
            within!((torso.line_integral(&ray) - sum).abs());
        }
    }

    #[test]
    fn a_displacing_solid_takes_the_place_of_what_stands_before_it() {
        let cuboid = |density, half: f64| Solid::new(solid::Shape::Cuboid, density, DVec3::ZERO, DVec3::splat(half));
        let solids = vec![cuboid(0.9, 0.6), cuboid(0.3, 0.8).displacing(), cuboid(0.2, 0.4), cuboid(-0.1, 0.2)];
        let phantom = Phantom { name: "boxes".into(), solids };
        for (x, density) in [(0.1, 0.4), (0.3, 0.5), (0.5, 0.3), (0.7, 0.3), (0.9, 0.0)] {
            within!((phantom.density_at(DVec3::new(x, 0.0, 0.0)) - density).abs(), "at {x}");
        }
        let ray = Ray { origin: DVec3::new(3.0, 0.01, -0.02), direction: DVec3::NEG_X };
        let expected = 2.0 * (0.2 * 0.4 + 0.2 * 0.5 + 0.4 * 0.3);
        within!("integral", (phantom.line_integral(&ray) - expected).abs(), "{}", phantom.line_integral(&ray));
        let volume = phantom.voxelize(&Grid::cube(2), 5).values;
        // Points at 0.1, 0.3, 0.5, 0.7, 0.9 of a side.
        let sum = 0.4 * 1.0 + 0.5 * 7.0 + 0.3 * 56.0;
        within!("voxels", largest(volume.iter().map(|&mean| f64::from(mean) - sum / 125.0)));
    }

    #[test]
    fn all_48_permutations_and_flips_of_the_axes_phantom_differ() {
        let volume = Phantom::by_name("axes", 0).unwrap().voxelize(&Grid::cube(24), 2).values;
        let mut images: Vec<Array3<f32>> = Vec::new();
        for permutation in [[0, 1, 2], [0, 2, 1], [1, 0, 2], [1, 2, 0], [2, 0, 1], [2, 1, 0]] {
            for flips in 0..8 {
                let mut image = volume.clone().permuted_axes(permutation);
                (0..3).filter(|axis| flips >> axis & 1 == 1).for_each(|axis| image.invert_axis(ndarray::Axis(axis)));
                for other in &images {
                    let difference = image.iter().zip(other).filter(|(a, b)| (*a - *b).abs() > 0.1).count();
                    assert!(difference > 20, "{permutation:?} with flips {flips:03b} looks like another: {difference}");
                }
                images.push(image);
            }
        }
        assert_eq!(images.len(), 48);
    }

    #[test]
    fn voxels_are_means_on_any_grid_and_with_any_number_of_threads() {
        let phantom = Phantom::by_name("torso", 0).unwrap();
        let grid = Grid::new([10, 7, 12], DVec3::new(-0.8, -0.5, -1.1), DVec3::new(0.9, 0.6, 0.4)).unwrap();
        let volume = phantom.voxelize(&grid, 4);
        let one_thread = threads::install(1, || phantom.voxelize(&grid, 4)).unwrap();
        assert_eq!(volume, one_thread);
        let n = 16;
        for index in [[4, 3, 5], [2, 5, 9], [7, 1, 0]] {
            let corner = grid.centre(index) - grid.spacing / 2.0;
            let points =
                (0..n * n * n).map(|k| DVec3::new((k / n / n) as f64, (k / n % n) as f64, (k % n) as f64) + 0.5);
            let mean = points.map(|p| phantom.density_at(corner + p / n as f64 * grid.spacing)).sum::<f64>()
                / (n * n * n) as f64;
            let found = f64::from(volume.values[index]);
            within!((found - mean).abs(), "{found} instead of {mean}");
        }
    }

    #[test]
    fn a_misspelt_name_is_answered_with_the_list_and_a_guess() {
        let message = Phantom::by_name("shep-logan", 0).unwrap_err().to_string();
        assert!(message.contains("did you mean shepp-logan?") && message.contains("foam"), "{message}");
    }
}
