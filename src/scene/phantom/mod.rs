//! Phantoms whose density and line integrals are known exactly: sums of ellipsoids, cuboids and cylinders. Not in the
//! paper.

mod library;
pub mod solid;

use super::arrays::{Projections, Volume};
use super::geometry::{Grid, Ray, Scanner};
use super::trace::trace;
use crate::error::{Error, Result};
use crate::numeric::{reduce, threads};
use glam::DVec3;
use ndarray::Array3;
use solid::Solid;

/// The phantoms that have a name, and what they are for.
pub const NAMES: [(&str, &str); 4] = [
    ("shepp-logan", "the head phantom in three dimensions, with contrasts one can see"),
    ("torso", "a chest with lungs, heart, spine and ribs"),
    ("foam", "a ball with hundreds of bubbles; the seed places them"),
    ("axes", "a different marker on every axis and in every octant: shows flips and exchanged axes"),
];

/// A sum of solids.
#[derive(Clone, Debug, PartialEq)]
pub struct Phantom {
    /// What to call it.
    pub name: String,
    /// Its parts; where they overlap, densities add up.
    pub solids: Vec<Solid>,
}

impl Phantom {
    /// The phantom with one of the [`NAMES`], inside [-1,1]³ with densities from 0 to 1. `seed` matters where chance does.
    ///
    /// # Errors
    /// For another name; the message lists the names and guesses which was meant.
    pub fn by_name(name: &str, seed: u64) -> Result<Self> {
        let solids = match name {
            "shepp-logan" => library::shepp_logan(),
            "torso" => library::torso(),
            "foam" => library::foam(seed),
            "axes" => library::axes(),
            _ => {
                let names = NAMES.map(|(name, _)| name);
                let distance = |candidate: &&str| strsim::damerau_levenshtein(name, candidate);
                let nearest = names.into_iter().min_by_key(distance).unwrap_or_default();
                let remedy = format!("did you mean {nearest}?");
                return Err(Error::invalid("phantom", name, format!("one of {}", names.join(", ")), remedy));
            }
        };
        Ok(Self { name: name.into(), solids })
    }

    /// Density at a point.
    pub fn density_at(&self, point: DVec3) -> f64 {
        self.solids.iter().filter(|solid| solid.contains(point)).fold(0.0, |sum, solid| sum + solid.density())
    }

    /// Integral of the density along the whole line of a ray, in scene units, to rounding.
    pub fn line_integral(&self, ray: &Ray) -> f64 {
        reduce::sum_by(self.solids.len(), &|i| self.solids[i].line_integral(ray))
    }

    /// The mean density of every voxel: exact inside of solids, from `samples`³ points on their surfaces.
    pub fn voxelize(&self, grid: &Grid, samples: usize) -> Volume {
        let [_, ny, nz] = grid.shape;
        let half = grid.spacing / 2.0;
        let mut values = Array3::zeros(grid.shape);
        let slices = values.as_slice_mut().expect("a new array is in C order");
        threads::for_each_chunk(slices, ny * nz, |x, slice| {
            let mut sums = vec![0.0_f64; slice.len()];
            for solid in &self.solids {
                let low = (solid.centre() - solid.reach() - grid.min) / grid.spacing;
                let high = (solid.centre() + solid.reach() - grid.min) / grid.spacing;
                if (x as f64) > high.x || ((x + 1) as f64) < low.x {
                    continue;
                }
                let range = |low: f64, high: f64, n: usize| {
                    low.clamp(0.0, n as f64) as usize..high.ceil().clamp(0.0, n as f64) as usize
                };
                for y in range(low.y, high.y, ny) {
                    for z in range(low.z, high.z, nz) {
                        sums[y * nz + z] += solid.density() * solid.fraction(grid.centre([x, y, z]), half, samples);
                    }
                }
            }
            for (value, sum) in slice.iter_mut().zip(sums) {
                *value = sum as f32;
            }
        });
        Volume { grid: *grid, values }
    }

    /// Exact projections at the given angles (radians), one ray through the centre of each pixel.
    ///
    /// # Errors
    /// When there is no angle, or one is not finite.
    pub fn project(&self, scanner: &Scanner, angles: &[f64]) -> Result<Projections> {
        trace(scanner, angles, |ray| self.line_integral(ray))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::geometry::{Beam, Detector};

    fn phantoms() -> impl Iterator<Item = Phantom> {
        NAMES.into_iter().map(|(name, _)| Phantom::by_name(name, 3).unwrap())
    }

    fn scanner(beam: Beam) -> Scanner {
        let detector = Detector { rows: 9, columns: 13, pitch_v: 0.3, pitch_u: 0.25, offset_u: 0.1, offset_v: -0.2 };
        Scanner { beam, detector, grid: Grid::cube(16) }
    }

    #[test]
    fn every_phantom_has_densities_from_0_to_1_and_air_around_it() {
        for phantom in phantoms() {
            let mut range = (f64::INFINITY, f64::NEG_INFINITY);
            let n = 101;
            for (x, y, z) in (0..n * n * n).map(|k| (k / n / n, k / n % n, k % n)) {
                let point = DVec3::new(x as f64, y as f64, z as f64) * (2.0 / (n - 1) as f64) - 1.0;
                let density = phantom.density_at(point);
                range = (range.0.min(density), range.1.max(density));
                assert!(point.abs().max_element() < 0.96 || density == 0.0, "{} at the border, {point}", phantom.name);
            }
            assert!(range.0 >= -1e-12 && range.1 <= 1.0 + 1e-12 && range.1 > 0.6, "{}: {range:?}", phantom.name);
        }
    }

    #[test]
    fn projections_match_quadrature_in_both_beams() {
        for beam in [Beam::Cone { dso: 5.0, dsd: 7.0 }, Beam::Parallel { dso: 5.0 }] {
            let scanner = scanner(beam);
            for phantom in phantoms() {
                let projections = phantom.project(&scanner, &[0.4]).unwrap();
                let mut largest = 0.0_f32;
                for (row, column) in (0..9).flat_map(|row| [(row, 4), (row, 6), (row, 9)]) {
                    let ray = scanner.ray(&scanner.view(0.4), row, column);
                    let (n, from, to) = (20_000, 3.0, 7.0);
                    let step = (to - from) / n as f64;
                    let point = |i: usize| ray.origin + ray.direction * (from + (i as f64 + 0.5) * step);
                    let expected = reduce::sum_by(n, &|i| phantom.density_at(point(i)) * step);
                    let exact = projections.images[[0, row, column]];
                    assert!(
                        (f64::from(exact) - expected).abs() < 2e-3,
                        "{exact} instead of {expected}: {}",
                        phantom.name
                    );
                    largest = largest.max(exact);
                }
                assert!(largest > 0.1, "{} was missed", phantom.name);
            }
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
            assert!((torso.line_integral(&ray) - sum).abs() < 1e-13);
        }
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
            assert!(
                (f64::from(volume.values[index]) - mean).abs() < 0.03,
                "{} instead of {mean}",
                volume.values[index]
            );
        }
    }

    #[test]
    fn a_misspelt_name_is_answered_with_the_list_and_a_guess() {
        let message = Phantom::by_name("shep-logan", 0).unwrap_err().to_string();
        assert!(message.contains("did you mean shepp-logan?") && message.contains("foam"), "{message}");
    }
}
