//! Simulated scans of phantoms and volumes.

use super::arrays::{Projections, Volume};
use super::dataset::Dataset;
use super::geometry::Scanner;
use super::noise::Noise;
use super::phantom::Phantom;
use super::trilinear;
use crate::error::{Error, Result};
use crate::numeric::rng::{Purpose, stream};
use crate::setting::Setting;
use rand::RngExt;
use std::f64::consts::TAU;

/// Points along each axis of a voxel, for the mean density of a phantom.
const SAMPLES: usize = 4;

/// The object to scan.
#[derive(Clone, Copy, Debug)]
pub enum Object<'a> {
    /// Projections are exact; the true volume is sampled on the scanner's grid.
    Phantom(&'a Phantom),
    /// Must lie on the scanner's grid; projections are those of the trilinear function.
    Volume(&'a Volume),
}

/// Parameters of a simulated scan.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Plan {
    /// Number of training views, evenly spaced over a full turn from angle 0.
    pub views: usize,
    /// Number of noise-free test views, at random angles of the full turn in increasing order.
    pub test_views: usize,
    /// Noise of the training views.
    pub noise: Noise,
    /// Seed of noise and test angles.
    pub seed: u64,
}

/// Simulates a scan. The result depends only on the arguments.
///
/// # Errors
/// For an invalid scanner, zero training views, or a volume on a grid other than the scanner's.
pub fn simulate(name: &str, object: Object<'_>, scanner: &Scanner, plan: &Plan) -> Result<Dataset> {
    scanner.validate()?;
    if plan.views == 0 {
        return Err(Error::invalid(
            "training views",
            0,
            "at least one",
            format!("give {} 18, for example", Setting::Views),
        ));
    }
    let truth = match object {
        Object::Phantom(phantom) => phantom.voxelize(&scanner.grid, SAMPLES),
        Object::Volume(volume) if volume.grid == scanner.grid => volume.clone(),
        Object::Volume(volume) => {
            let (got, expected) = (format!("{:?}", volume.grid), format!("the scanner's, {:?}", scanner.grid));
            return Err(Error::invalid(
                "grid of the volume",
                got,
                expected,
                "resample the volume to this grid, or give the scanner the volume's grid",
            ));
        }
    };
    let project = |angles: &[f64]| -> Result<Projections> {
        match object {
            Object::Phantom(phantom) => phantom.project(scanner, angles),
            Object::Volume(volume) => trilinear::project(volume, scanner, angles),
        }
    };
    let train = plan.noise.apply(&project(&Scanner::uniform_angles(plan.views, 0.0, TAU))?, plan.seed)?;
    let test = match plan.test_views {
        0 => None,
        n => Some(project(&random_angles(n, plan.seed))?),
    };
    let notes = match object {
        Object::Phantom(phantom) => phantom.caveat().into_iter().collect(),
        Object::Volume(_) => Vec::new(),
    };
    Ok(Dataset {
        name: name.into(),
        scanner: *scanner,
        scale: 1.0,
        noise: plan.noise,
        train,
        test,
        truth: Some(truth),
        initial_points: None,
        notes,
        oddities: Vec::new(),
    })
}

/// `n` uniformly random angles of a full turn (radians), in increasing order.
fn random_angles(n: usize, seed: u64) -> Vec<f64> {
    let mut draws = stream(seed, Purpose::TestAngles, 0, 0);
    let mut angles: Vec<f64> = (0..n).map(|_| draws.random::<f64>() * TAU).collect();
    angles.sort_by(f64::total_cmp);
    angles
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::geometry::{Beam, Detector, Grid};

    fn scanner() -> Scanner {
        let detector = Detector { rows: 20, columns: 24, pitch_v: 0.2, pitch_u: 0.18, offset_u: 0.1, offset_v: 0.0 };
        Scanner { beam: Beam::Cone { dso: 5.0, dsd: 7.0 }, detector, grid: Grid::cube(20) }
    }

    const PLAN: Plan = Plan { views: 6, test_views: 5, noise: Noise::HIGH, seed: 3 };

    #[test]
    fn a_scan_has_what_the_plan_asks_for() {
        let phantom = Phantom::by_name("torso", 0).unwrap();
        let scan = simulate("chest", Object::Phantom(&phantom), &scanner(), &PLAN).unwrap();
        assert_eq!(scan.train.angles, Scanner::uniform_angles(6, 0.0, TAU));
        let test = scan.test.as_ref().unwrap();
        assert!(test.angles.is_sorted() && test.angles.iter().all(|a| (0.0..TAU).contains(a)) && test.len() == 5);
        assert_eq!(*test, phantom.project(&scanner(), &test.angles).unwrap());
        assert_ne!(scan.train, phantom.project(&scanner(), &scan.train.angles).unwrap());
        assert_eq!(scan.truth.as_ref().unwrap().grid, scanner().grid);
        let again = simulate("chest", Object::Phantom(&phantom), &scanner(), &PLAN).unwrap();
        assert_eq!(scan, again);
        let other = simulate("chest", Object::Phantom(&phantom), &scanner(), &Plan { seed: 4, ..PLAN }).unwrap();
        assert!(other.train != scan.train && other.test.unwrap().angles != test.angles);
        assert_eq!(other.truth, scan.truth);
    }

    #[test]
    fn a_scan_of_a_stand_in_says_so() {
        let notes = |name: &str| {
            let phantom = Phantom::by_name(name, 0).unwrap();
            simulate(name, Object::Phantom(&phantom), &scanner(), &Plan { views: 1, test_views: 0, ..PLAN })
                .unwrap()
                .notes
        };
        assert!(notes("teapot").len() == 1 && notes("teapot")[0].contains("stand-in"));
        assert!(notes("torso").is_empty());
    }

    #[test]
    fn scanning_the_voxels_of_a_phantom_is_close_to_scanning_the_phantom() {
        let mut scanner = scanner();
        scanner.grid = Grid::cube(64);
        let plan = Plan { noise: Noise::None, views: 2, ..PLAN };
        let phantom = Phantom::by_name("axes", 0).unwrap();
        let exact = simulate("a", Object::Phantom(&phantom), &scanner, &plan).unwrap();
        let volume = exact.truth.as_ref().unwrap();
        let voxels = simulate("a", Object::Volume(volume), &scanner, &plan).unwrap();
        let difference = (&exact.train.images - &voxels.train.images).mapv(f32::abs);
        within!(difference.mean().unwrap(), "mean difference {:?}", difference.mean());
        assert_eq!(voxels.truth.as_ref().unwrap(), volume);
    }

    #[test]
    fn impossible_plans_are_errors() {
        let phantom = Phantom::by_name("axes", 0).unwrap();
        assert!(simulate("a", Object::Phantom(&phantom), &scanner(), &Plan { views: 0, ..PLAN }).is_err());
        let volume = phantom.voxelize(&Grid::cube(8), 1);
        let message = simulate("a", Object::Volume(&volume), &scanner(), &PLAN).unwrap_err().to_string();
        assert!(message.contains("grid of the volume"), "{message}");
        let mut inside = scanner();
        inside.beam = Beam::Cone { dso: 1.0, dsd: 7.0 };
        assert!(simulate("a", Object::Phantom(&phantom), &inside, &PLAN).is_err());
    }
}
