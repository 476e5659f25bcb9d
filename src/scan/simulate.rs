//! Simulated scans of phantoms and volumes.

use super::chain::Chain;
use super::dataset::Dataset;
use super::noise::Noise;
use super::phantom::Phantom;
use super::trilinear;
use crate::limit;
use rand::RngExt;
use std::f64::consts::TAU;
use trgs_core::error::{Error, Result};
use trgs_core::geometry::{Deviation, Pose, Projections, Scanner, Trajectory, Volume};
use trgs_core::numeric::rng::{Purpose, stream};
use trgs_core::setting::Setting;
use trgs_core::words::counted;

/// Points along each axis of a voxel, for the mean density of a phantom.
const SAMPLES: usize = 4;

/// The object to scan.
#[derive(Clone, Copy, Debug)]
pub enum Object<'a> {
    /// Projections are exact; the true volume is sampled on the scanner's grid.
    Phantom(&'a Phantom),
    /// Must lie on the scanner's grid; projections are those of the trilinear function.
    Volume(&'a Volume),
    /// The same, with another model of the rays.
    Voxels(&'a Volume, VoxelRays),
}

impl<'a> Object<'a> {
    fn volume(&self) -> Option<&'a Volume> {
        match *self {
            Self::Phantom(_) => None,
            Self::Volume(volume) | Self::Voxels(volume, _) => Some(volume),
        }
    }
}

/// A model of the rays through the voxels of a volume.
#[derive(Clone, Copy, Debug)]
pub struct VoxelRays {
    /// Line integrals of a volume on the scanner's grid.
    pub project: fn(&Volume, &Scanner, Trajectory<'_>) -> Result<Projections>,
    /// A sentence for the notes of the scan.
    pub note: &'static str,
    /// Bytes needed for a voxel and for a pixel, besides volume and projections.
    pub bytes: [u64; 2],
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

/// How the views of a simulated scan deviate from the circle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Orbit {
    /// Turns that the views are spread over; more than 0.
    pub turns: f64,
    /// Height that source and detector gain per turn, scene units; the middle of the scan is at height 0.
    pub pitch: f64,
    /// Turn of the detector in its plane, from u towards v, radians.
    pub roll: f64,
    /// Shift of source and detector along u, scene units.
    pub axis_shift: f64,
}

impl Orbit {
    /// The circle.
    pub const CIRCLE: Self = Self { turns: 1.0, pitch: 0.0, roll: 0.0, axis_shift: 0.0 };

    /// Checks that all numbers are finite and that there are turns.
    ///
    /// # Errors
    /// For the first number that is not.
    pub fn validate(&self) -> Result<()> {
        let numbers = [("pitch of the helix", self.pitch), ("roll", self.roll), ("axis shift", self.axis_shift)];
        if let Some((what, value)) = numbers.into_iter().find(|(_, value)| !value.is_finite()) {
            return Err(Error::invalid(what, value, "a finite number", "give a finite number"));
        }
        if self.turns > 0.0 && self.turns.is_finite() {
            return Ok(());
        }
        Err(Error::invalid("turns of the helix", self.turns, "a positive number", "give at least one turn"))
    }

    /// Angles on the circle and poses of views at angles from the start, radians; no poses for the circle.
    fn views(&self, scanner: &Scanner, from_start: &[f64]) -> (Vec<f64>, Option<Vec<Pose>>) {
        if *self == Self::CIRCLE {
            return (from_start.to_vec(), None);
        }
        let pose = |&angle: &f64| {
            let height = self.pitch * (angle / TAU - self.turns / 2.0);
            let none = Deviation::none(scanner).rolled(self.roll);
            let deviation = Deviation { axis_shift: self.axis_shift, heights: [height; 2], ..none };
            deviation.pose(angle.rem_euclid(TAU))
        };
        let angles = from_start.iter().map(|angle| angle.rem_euclid(TAU)).collect();
        (angles, Some(from_start.iter().map(pose).collect()))
    }
}

/// Simulates a scan on a circle. The result depends only on the arguments.
///
/// # Errors
/// For an invalid scanner, zero training views, or a volume on a grid other than the scanner's.
pub fn simulate(name: &str, object: Object<'_>, scanner: &Scanner, plan: &Plan) -> Result<Dataset> {
    simulate_on(name, object, scanner, plan, &Orbit::CIRCLE)
}

/// Simulates a scan on any [`Orbit`]. The result depends only on the arguments.
///
/// # Errors
/// Those of [`simulate`], and for an invalid orbit or one whose views miss the volume.
///
/// Tests: `posed_scans_reconstruct_as_well_as_plain_ones`.
pub fn simulate_on(name: &str, object: Object<'_>, scanner: &Scanner, plan: &Plan, orbit: &Orbit) -> Result<Dataset> {
    scan(name, object, scanner, plan, orbit, None)
}

/// Simulates a scan on any [`Orbit`] whose training views went through a measuring chain.
///
/// Test views and truth are ideal: line integrals at 60 keV, from the stated place. Of the noise, the chain takes the
/// photons and the electronic noise.
///
/// # Errors
/// Those of [`simulate_on`], and for noise with the Beer-Lambert law, which the chain has of its own.
///
/// Tests: `a_measured_scan_has_ideal_test_views_and_says_so`.
pub fn simulate_measured(
    name: &str,
    object: Object<'_>,
    scanner: &Scanner,
    plan: &Plan,
    orbit: &Orbit,
    chain: &Chain,
) -> Result<Dataset> {
    scan(name, object, scanner, plan, orbit, Some(chain))
}

fn scan(
    name: &str,
    object: Object<'_>,
    scanner: &Scanner,
    plan: &Plan,
    orbit: &Orbit,
    chain: Option<&Chain>,
) -> Result<Dataset> {
    scanner.validate()?;
    orbit.validate()?;
    if plan.views == 0 {
        return Err(Error::invalid("training views", 0, "at least one", "give " + Setting::Views + " 18, for example"));
    }
    check_memory(scanner, plan, &object, chain)?;
    let truth = match object {
        Object::Phantom(phantom) => phantom.voxelize(&scanner.grid, SAMPLES),
        Object::Volume(volume) | Object::Voxels(volume, _) if volume.grid == scanner.grid => volume.clone(),
        Object::Volume(volume) | Object::Voxels(volume, _) => {
            let (got, expected) = (format!("{:?}", volume.grid), format!("the scanner's, {:?}", scanner.grid));
            return Err(Error::invalid(
                "grid of the volume",
                got,
                expected,
                "resample the volume to this grid, or give the scanner the volume's grid",
            ));
        }
    };
    let project = |object: Object<'_>, orbit: &Orbit, from_start: &[f64]| -> Result<Projections> {
        let (angles, poses) = orbit.views(scanner, from_start);
        let views = Trajectory { angles: &angles, poses: poses.as_deref() };
        views.validate(scanner)?;
        match object {
            Object::Phantom(phantom) => phantom.project(scanner, views),
            Object::Volume(volume) => trilinear::project(volume, scanner, views),
            Object::Voxels(volume, rays) => (rays.project)(volume, scanner, views),
        }
    };
    let span = TAU * orbit.turns;
    let start = Scanner::uniform_angles(plan.views, 0.0, span);
    let train = match chain {
        None => plan.noise.apply(&project(object, orbit, &start)?, plan.seed)?,
        Some(chain) => {
            let moved = Orbit { axis_shift: orbit.axis_shift + chain.axis_shift(scanner), ..*orbit };
            let ideal = project(object, &moved, &start)?;
            let dense = chain.dense_part(&truth).map(|dense| match object {
                Object::Voxels(_, rays) => project(Object::Voxels(&dense, rays), &moved, &start),
                _ => project(Object::Volume(&dense), &moved, &start),
            });
            let images =
                chain.measure(&scanner.detector, &ideal, dense.transpose()?.as_ref(), plan.noise, plan.seed)?;
            let (angles, poses) = orbit.views(scanner, &start);
            Projections::along(Trajectory { angles: &angles, poses: poses.as_deref() }, images)?
        }
    };
    let test = match plan.test_views {
        0 => None,
        n => Some(project(object, orbit, &random_angles(n, span, plan.seed))?),
    };
    let mut notes: Vec<String> = match object {
        Object::Phantom(phantom) => phantom.caveat().into_iter().collect(),
        Object::Volume(_) => Vec::new(),
        Object::Voxels(_, rays) => vec![rays.note.into()],
    };
    notes.extend(chain.map(|chain| {
        format!(
            "the training views are simulated measurements ({chain}); test views and true volume are ideal, at 60 keV"
        )
    }));
    Ok(Dataset { noise: plan.noise, test, truth: Some(truth), notes, ..Dataset::new(name, *scanner, train) })
}

/// Rejects a scan that does not fit into memory: the volume, the given one, the training views with and without noise, and
/// the needs of rays and chain.
fn check_memory(scanner: &Scanner, plan: &Plan, object: &Object<'_>, chain: Option<&Chain>) -> Result<()> {
    let [voxels, pixels] = [scanner.grid.voxels(), scanner.detector.pixels()];
    // A chain has the dense part of the object as well.
    let parts = usize::from(chain.is_some());
    let views = plan.views.saturating_mul(2 + parts).saturating_add(plan.test_views);
    let volumes = 1 + usize::from(object.volume().is_some()) + parts;
    let numbers = views.saturating_mul(pixels).saturating_add(voxels.saturating_mul(volumes)) as u64;
    let [per_voxel, per_pixel] = if let Object::Voxels(_, rays) = object { rays.bytes } else { [0; 2] };
    let projected = plan.views.max(plan.test_views).saturating_mul(pixels) as u64;
    let others = per_voxel.saturating_mul(voxels as u64).saturating_add(per_pixel.saturating_mul(projected));
    let what = format!(
        "scan of {:?} voxels and {} of {:?} pixels",
        scanner.grid.shape,
        counted(plan.views.saturating_add(plan.test_views), "view"),
        [scanner.detector.rows, scanner.detector.columns]
    );
    let checked = limit::allow(what, numbers.saturating_mul(size_of::<f32>() as u64).saturating_add(others));
    checked.map_err(|error| error.or_instead("fewer voxels, views or pixels"))
}

/// `n` uniformly random angles below `span` (radians), in increasing order.
fn random_angles(n: usize, span: f64, seed: u64) -> Vec<f64> {
    let mut draws = stream(seed, Purpose::TestAngles, 0, 0);
    let mut angles: Vec<f64> = (0..n).map(|_| draws.random::<f64>() * span).collect();
    angles.sort_by(f64::total_cmp);
    angles
}

#[cfg(test)]
mod tests {
    use super::*;
    use trgs_core::geometry::{Beam, Detector, Grid};

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
