//! Upper bound on the memory of a run, known before it starts: rows of arrays, grouped by phase.
//!
//! Populations are counted as large as their settings let them become, and an allowance covers memory that the
//! allocator keeps between two uses. The estimate needs sizes only, so a run can be rejected before a projection is
//! read.
//!
//! Tests: `tests/cli/memory.rs` compares it with the largest resident set of runs.

use crate::config::{Config, DensityControl, Finish, Method, Plan, Precision, Sampling, Start};
use crate::error::{Error, Result};
use crate::projector;
use crate::scan::dataset::DatasetInfo;
use crate::setting::Setting;
use bytesize::ByteSize;
use std::fmt;

/// Bytes of the program itself, its threads' stacks and small objects.
const PROGRAM: u64 = 20 << 20;
/// Memory that the allocator keeps, as a fraction of all arrays.
const SLACK: f64 = 0.15;
/// Numbers per primitive: mean, scales, quaternion, density, ν.
const NUMBERS: usize = 12;
/// Bytes of a double-precision number.
const F64: usize = size_of::<f64>();
/// Bytes of a single-precision number.
const F32: usize = size_of::<f32>();
/// Rows named in the message that rejects a run.
const SHOWN: usize = 3;

/// Arrays of one kind.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Allocation {
    /// Content of the arrays.
    pub what: &'static str,
    /// Number of elements: pixels, voxels or primitives.
    pub count: usize,
    /// Bytes per element.
    pub bytes: usize,
}

/// A phase of a run: arrays that live at the same time.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Phase {
    /// Name of the phase.
    pub name: &'static str,
    /// Arrays of this phase, in addition to the lasting ones.
    pub allocations: Vec<Allocation>,
}

/// The memory that a run needs.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Estimate {
    /// Arrays that live from the beginning to the end.
    pub lasting: Vec<Allocation>,
    /// Phases and their temporary arrays.
    pub phases: Vec<Phase>,
}

impl Allocation {
    /// Bytes of all rows.
    pub fn total(&self) -> u64 {
        (self.count as u64).saturating_mul(self.bytes as u64)
    }
}

fn allocation(what: &'static str, count: usize, bytes: usize) -> Allocation {
    Allocation { what, count, bytes }
}

fn sum(allocations: &[Allocation]) -> u64 {
    allocations.iter().fold(0, |sum, allocation| sum.saturating_add(allocation.total()))
}

impl Estimate {
    /// Estimates a run on a scan with `views` of its training views and `threads` workers.
    pub fn new(scan: &DatasetInfo, views: usize, plan: &Plan, threads: usize) -> Self {
        let config: &Config = plan;
        let sizes = Sizes::new(scan, views, config, threads);
        let mut phases = match config.method {
            Method::TrGs | Method::R2Gaussian => sizes.training(config),
            Method::Fdk => {
                let pads = scan.scanner.detector.offset_u != 0.0 || scan.is_posed || scan.is_cut;
                vec![sizes.fdk("reconstruction", pads)]
            }
            Method::Sart | Method::OsSart => vec![sizes.sart(config)],
            Method::AsdPocs => vec![sizes.asd_pocs(config)],
            Method::Cgls => vec![sizes.cgls()],
            Method::Tv => vec![sizes.tv(config)],
            Method::Naf | Method::SaxNerf | Method::Intratomo => {
                vec![sizes.sart(&Config::of(Method::Sart)), sizes.neural(config)]
            }
        };
        if scan.train > views {
            let all =
                allocation("all training projections, before the choice of views", scan.train * sizes.detector, F32);
            phases.push(Phase { name: "reading", allocations: vec![all] });
        }
        phases.push(sizes.evaluation(config));
        Self {
            lasting: vec![
                allocation("training projections", sizes.pixels, F32),
                allocation("test projections", scan.test * sizes.detector, F32),
                allocation("true volume", if scan.has_truth { sizes.voxels } else { 0 }, F32),
                allocation("initial points", scan.points, 4 * F64),
            ],
            phases,
        }
    }

    /// Estimates a file of `bytes` bytes of unknown content: the content, its arrays and the scan.
    pub fn of_file(bytes: u64) -> Self {
        let allocations =
            vec![allocation("the file, its arrays and the scan", usize::try_from(bytes).unwrap_or(usize::MAX), 5)];
        Self { lasting: Vec::new(), phases: vec![Phase { name: "reading", allocations }] }
    }

    /// Bytes in the phase that needs most.
    pub fn peak(&self) -> u64 {
        let arrays = sum(&self.lasting).saturating_add(sum(&self.worst().allocations));
        PROGRAM.saturating_add(arrays).saturating_add((arrays as f64 * SLACK) as u64)
    }

    /// The phase that needs most.
    pub fn worst(&self) -> &Phase {
        self.phases.iter().max_by_key(|phase| sum(&phase.allocations)).expect("every run is evaluated")
    }

    /// Rejects a run that may need more than `limit` bytes.
    ///
    /// # Errors
    /// [`Error::Memory`] with the estimate and its largest rows.
    pub fn check(&self, limit: u64) -> Result<()> {
        if self.peak() <= limit {
            return Ok(());
        }
        let points = "fewer primitives (" + Setting::Points + ", density_control.cap), ";
        let instead = points + "views (" + Setting::Views + "), pixels or voxels";
        Err(Error::memory("run", self, limit, self.peak()).or_instead(instead))
    }
}

/// The estimate and its largest rows.
impl fmt::Display for Estimate {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let mut allocations: Vec<&Allocation> = self.lasting.iter().chain(&self.worst().allocations).collect();
        allocations.sort_by_key(|allocation| std::cmp::Reverse(allocation.total()));
        let parts: Vec<_> = allocations
            .iter()
            .take(SHOWN)
            .map(|allocation| format!("{} {}", ByteSize(allocation.total()), allocation.what))
            .collect();
        write!(f, "{} ({}; among them {})", ByteSize(self.peak()), self.worst().name, parts.join(", "))
    }
}

/// The sizes that all rows follow from.
#[derive(Clone)]
struct Sizes {
    /// Pixels of a view, and its rows.
    detector: usize,
    rows: usize,
    /// Pixels of all views used.
    pixels: usize,
    voxels: usize,
    /// Voxels of a slice across x.
    slice: usize,
    slices: usize,
    /// Voxels along z.
    column: usize,
    /// Primitives at the start.
    points: usize,
    /// Largest number of primitives.
    most: usize,
    test: usize,
    /// Bytes of a number in the precision of pixels and voxels.
    real: usize,
    threads: usize,
}

impl Sizes {
    fn new(scan: &DatasetInfo, views: usize, config: &Config, threads: usize) -> Self {
        let (grid, detector) = (&scan.scanner.grid, scan.scanner.detector.pixels());
        let points = match config.initialisation.from {
            Start::Fdk | Start::SmoothedFdk | Start::Sart | Start::Tv => config.model.points.min(grid.voxels()),
            Start::Random | Start::Model => config.model.points,
            Start::Dataset => scan.points,
        };
        Self {
            detector,
            rows: scan.scanner.detector.rows,
            pixels: views * detector,
            voxels: grid.voxels(),
            slice: grid.shape[1] * grid.shape[2],
            slices: grid.shape[0],
            column: grid.shape[2],
            points,
            most: most_primitives(points, config),
            test: scan.test,
            real: match config.precision {
                Precision::F32 => F32,
                Precision::F64 => F64,
            },
            threads,
        }
    }

    fn fdk(&self, name: &'static str, widened: bool) -> Phase {
        // A detector that is displaced or cuts the object off at most doubles in width before projections are filtered.
        let copies = if widened { 4 } else { 1 };
        let allocations =
            vec![allocation("filtered projections", self.pixels, copies * F32), allocation("volume", self.voxels, F32)];
        Phase { name, allocations }
    }

    fn training(&self, config: &Config) -> Vec<Phase> {
        let (m, real, d) = (self.most, self.real, self.detector);
        let in_units = config.density_unit.fixed() != Some(1.0);
        let lasting = |count: usize| {
            vec![
                allocation("views as SSIM compares with them: image, mean, variance", self.pixels, 3 * real),
                allocation("projections in units of density", if in_units { self.pixels } else { 0 }, F32),
                // Raw values, two moments each, momentum, id, c, its target, pull and views.
                allocation("state of the optimisers", count, 3 * NUMBERS * F64 + 3 * F64 + 8 + 2 * F64 + 12),
            ]
        };
        let with = |name, count: usize, allocations: &[Allocation]| Phase {
            name,
            allocations: [lasting(count), allocations.to_vec()].concat(),
        };
        let physical = allocation("physical values", m, NUMBERS * F64);
        let prepared = allocation("primitives, prepared", m, projector::bytes::FIELD);
        let mut start = match config.initialisation.from {
            // The pilot run of a run from a model starts from SART.
            Start::Sart | Start::Model => self.sart(config).allocations,
            _ => self.fdk("first volume", false).allocations,
        };
        start.push(allocation("bright voxels and the choice among them", self.voxels, size_of::<usize>() + 4));
        let block = |side: usize| self.voxels.min(side * side * side);
        // The workspace of an iteration stays for the next one, whatever runs between them.
        let kept = [
            physical,
            prepared,
            allocation(
                "gradients of the view, of two blocks and of the parameters",
                m,
                3 * projector::bytes::GRADIENT + 2 * NUMBERS * F64 + 3 * F64,
            ),
            allocation(
                "footprints in the view and on both blocks",
                m,
                projector::bytes::VIEW + 2 * projector::bytes::GRID,
            ),
            allocation("lists of primitives by bands", m, 4 * (self.rows / 32 + 1)),
            allocation("image, loss and cotangent", d, 10 * real),
            allocation("block of the total variation", block(config.loss.tv_block), 8 * real),
            // Voxels, cotangent, two transforms, a weight of each voxel, and copies of at most six of the eight bands.
            allocation("block of the wavelets", block(config.wavelet.block), 6 * real + 2),
            allocation("tree of neighbours, and where it has them", m, 11 * F64 + 1),
        ];
        let working = |name, allocations: &[Allocation]| with(name, m, &[&kept, allocations].concat());
        let mut phases = vec![
            Phase { name: "unit of density", allocations: self.sart(config).allocations },
            with("first volume", self.points, &start),
            working("iteration", &[]),
            working("checkpoint", &[allocation("copy of the state", m, 3 * NUMBERS * F64 + 6 * F64 + 12)]),
            with(
                "last volume",
                m,
                &[
                    physical,
                    prepared,
                    allocation("primitives on the grid", m, projector::bytes::GRID),
                    allocation("volume, in slices, together and in single precision", self.voxels, 2 * real + F32),
                ],
            ),
        ];
        if config.sampling != Sampling::Point {
            let volumes = allocation("volume, and its interpolant as it is solved for", self.voxels, F64 + 3 * F32);
            phases.push(Phase { name: "sampling", allocations: vec![volumes] });
        }
        if config.finish != Finish::None {
            let mut allocations = self.tv(config).allocations;
            allocations.push(allocation("volume of the primitives", self.voxels, F32));
            allocations.push(allocation("corrected projections", self.pixels, F32));
            phases.push(Phase { name: "finish", allocations });
        }
        if config.has_pilot() {
            let run = [
                allocation("volume of the run", self.voxels, F32),
                allocation("primitives of the run", m, NUMBERS * F64),
                allocation("views of the pilot run and those held out", self.pixels, F32),
            ];
            phases.push(working("pilot run", &run));
            let mut allocations = self.tv(config).allocations;
            allocations.extend(run);
            allocations.extend([
                allocation("volume of the pilot run, its interpolant as solved", self.voxels, F64 + 3 * F32),
                allocation("primitives of the pilot run", m, NUMBERS * F64),
                allocation("corrected projections, and what they come from", self.pixels, 3 * F32),
            ]);
            phases.push(Phase { name: "choice of sampling and finish", allocations });
        }
        if config.density_control.method != DensityControl::None {
            // The next population coexists with the last one: successors, raw and physical values, moments.
            let next = allocation("next population", m, 2 * 80 + 5 * NUMBERS * F64 + 3 * F64 + 16);
            phases.push(working("density control", &[next]));
        }
        phases
    }

    fn sart(&self, config: &Config) -> Phase {
        let subset = config.algebraic.subset.saturating_mul(self.detector).min(self.pixels);
        let allocations = vec![
            allocation("projections and lengths of rays", self.pixels, 3 * self.real),
            allocation("corrections of a set of views", subset, 3 * self.real),
            allocation("volume, its copy in the state, and as it is written", self.voxels, 2 * self.real + F32),
            allocation("sums of slices at work", self.slice, self.at_work(2)),
        ];
        Phase { name: "reconstruction", allocations }
    }

    fn asd_pocs(&self, config: &Config) -> Phase {
        let mut phase = self.sart(config);
        phase.allocations.extend([
            allocation("first guess, steps and direction", self.voxels, 5 * self.real + F32),
            allocation("residual", self.pixels, self.real),
        ]);
        phase
    }

    fn cgls(&self) -> Phase {
        let allocations = vec![
            allocation("projections, residual, image and pairs", self.pixels, 4 * self.real),
            allocation(
                "volume, direction, and their gradient or copies in the state",
                self.voxels,
                4 * self.real + F32,
            ),
            allocation("sums of slices at work", self.slice, self.at_work(1)),
        ];
        Phase { name: "reconstruction", allocations }
    }

    fn tv(&self, config: &Config) -> Phase {
        let allocations = vec![
            allocation("projections, images of two volumes, residual and pairs", self.pixels, 6 * self.real + 1),
            allocation(
                "views held out and the others",
                if config.tv.weight.fixed().is_some() { 0 } else { self.pixels },
                F32 + self.real,
            ),
            allocation("volumes, dual of the total variation, and as it is written", self.voxels, 12 * self.real + F32),
            allocation("sums of slices at work", self.slice, self.at_work(1)),
        ];
        Phase { name: "reconstruction", allocations }
    }

    /// The unit of density comes from SART in f32 before.
    fn neural(&self, config: &Config) -> Phase {
        let settings = config.neural();
        let sizes = crate::neural::sizes(&settings, self.column);
        let parameters = sizes.table + sizes.network;
        let rays = settings.rays + settings.windows * settings.window * settings.window;
        let allocations = vec![
            allocation("parameters, moments and gradients", parameters, 5 * F64 + 3 * self.real),
            allocation("as they are written to a checkpoint", parameters, 6 * F64),
            allocation(
                "points of a step and gradients to their codes",
                rays * settings.samples,
                4 * F64 + (3 + 41) * self.real,
            ),
            allocation("gradients of the network", sizes.bundles * sizes.network, F64),
            allocation("samples in the network", self.threads * sizes.together, sizes.computed * self.real),
            allocation("volume", self.voxels, F32),
        ];
        Phase { name: "reconstruction", allocations }
    }

    /// Bytes per voxel of a slice for the partial sums of all workers.
    fn at_work(&self, numbers: usize) -> usize {
        const SLICES: usize = 8;
        SLICES * numbers * self.real * self.threads.min(self.slices.div_ceil(SLICES))
    }

    fn evaluation(&self, config: &Config) -> Phase {
        let m = if config.method.fits_primitives() { self.most } else { 0 };
        let largest = self.detector.max(self.slice);
        let allocations = vec![
            allocation("volume and a copy in order of its values", self.voxels, 2 * F32),
            allocation("test views of the result", self.test * self.detector, F32 + if m > 0 { self.real } else { 0 }),
            allocation("images that are compared", largest, 12 * F64 * self.threads),
            allocation(
                "primitives in a view",
                m,
                NUMBERS * F64 + projector::bytes::FIELD + projector::bytes::VIEW + 16 * 4,
            ),
        ];
        Phase { name: "evaluation", allocations }
    }
}

/// Upper bound on the number of primitives after density control.
fn most_primitives(points: usize, config: &Config) -> usize {
    let control = &config.density_control;
    let added = |m: usize| match control.method {
        DensityControl::None => 0,
        // Each primitive may be doubled, unless the cap is reached before.
        DensityControl::Adc if m < control.cap => m,
        DensityControl::Adc => 0,
        DensityControl::Ar => ((control.growth * m as f64) as usize).min(control.cap.saturating_sub(m)),
    };
    (0..config.iterations / control.every.max(1))
        // Err: the population no longer grows.
        .try_fold(points, |m, _| if added(m) == 0 { Err(m) } else { Ok(m.saturating_add(added(m))) })
        .unwrap_or_else(|m| m)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::{Beam, Detector, Grid, Scanner};

    fn scan() -> DatasetInfo {
        let detector = Detector { rows: 64, columns: 80, pitch_v: 0.05, pitch_u: 0.05, offset_u: 0.0, offset_v: 0.0 };
        let scanner = Scanner { beam: Beam::Cone { dso: 5.0, dsd: 7.0 }, detector, grid: Grid::cube(32) };
        DatasetInfo { scanner, train: 18, test: 5, is_posed: false, has_truth: true, points: 0, is_cut: false }
    }

    #[test]
    fn more_of_anything_needs_more() {
        for method in [
            Method::TrGs,
            Method::R2Gaussian,
            Method::Fdk,
            Method::Sart,
            Method::OsSart,
            Method::AsdPocs,
            Method::Cgls,
            Method::Tv,
            Method::Naf,
        ] {
            let config = Config::of(method);
            let of = |scan: &DatasetInfo, views, config: &Config| {
                Estimate::new(scan, views, &config.plan(&scan.scanner, views).unwrap(), 2).peak()
            };
            let base = of(&scan(), 18, &config);
            let mut finer = scan();
            finer.scanner.grid = Grid::cube(128);
            let mut larger = scan();
            larger.scanner.detector.rows *= 30;
            assert!(of(&finer, 18, &config) > base && of(&larger, 18, &config) > base, "{method:?}");
            assert!(of(&larger, 9, &config) < of(&larger, 18, &config), "{method:?}");
            let double = Config { precision: Precision::F64, ..config.clone() };
            assert!(of(&larger, 18, &double) >= of(&larger, 18, &config), "{method:?}");
        }
    }

    #[test]
    fn populations_grow_as_far_as_their_settings_let_them() {
        let mut config = Config::of(Method::TrGs);
        (config.iterations, config.density_control.every, config.density_control.cap) = (5000, 100, 1000);
        assert_eq!(most_primitives(500, &config), 1000);
        (config.iterations, config.density_control.every) = (20, 10);
        let once = 500 + (500.0 * config.density_control.growth) as usize;
        assert_eq!(most_primitives(500, &config), once + (once as f64 * config.density_control.growth) as usize);
        assert_eq!(most_primitives(2000, &config), 2000);
        config.density_control.method = DensityControl::Adc;
        assert_eq!([100, 500, 999, 1000].map(|points| most_primitives(points, &config)), [400, 1000, 1998, 1000]);
        config.density_control.method = DensityControl::None;
        assert_eq!(most_primitives(500, &config), 500);
    }

    #[test]
    fn a_refusal_has_the_figure_its_parts_and_a_remedy() {
        let plan = Config::default().plan(&scan().scanner, 18).unwrap();
        let estimate = Estimate::new(&scan(), 18, &plan, 2);
        estimate.check(estimate.peak()).unwrap();
        let message = estimate.check(estimate.peak() - 1).unwrap_err().to_string();
        assert!(
            message.contains("`max_memory`") && message.contains("iB (") && message.contains("`points`"),
            "{message}"
        );
    }
}
