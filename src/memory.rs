//! Upper bound on the memory of a run, known before it starts: rows of arrays, grouped by phase. Each method on voxels
//! states its own, beside itself.
//!
//! Populations are counted as large as their settings let them become, and an allowance covers memory that the
//! allocator keeps between two uses. Volumes of total variation are in slabs of files where whole ones need more than the
//! limit. The estimate needs sizes only, so a run can be rejected before a projection is read.
//!
//! Tests: `tests/cli/memory.rs` compares it with the largest resident set of runs.

use crate::classical::algebraic::{SartSettings, cgls_arrays};
use crate::classical::fdk;
use crate::config::{Config, DensityControl, Finish, Method, Plan, Precision, Sampling, Start};
use crate::error::{Error, Result};
use crate::geometry::Scanner;
use crate::projector;
use crate::report::viewer::WHOLE;
use crate::scan::dataset::DatasetInfo;
use crate::setting::Setting;
use bytesize::ByteSize;
use std::fmt;
use trgs_methods::memory::{F32, F64, Sizes, allocation};

pub use trgs_methods::memory::Allocation;

/// Bytes of the program itself, its threads' stacks and small objects.
const PROGRAM: u64 = 20 << 20;
/// What arrays that are not named need, as a fraction of all others.
const SLACK: f64 = 0.05;
/// Memory that the allocator keeps of an earlier phase, as a fraction of its arrays but those of [`MOST_KEPT`] bytes and more.
const KEPT: f64 = 0.2;
/// The most that it keeps, bytes: glibc returns larger blocks to the system.
const MOST_KEPT: usize = 32 << 20;
/// Numbers per primitive: mean, scales, quaternion, density, ν.
const NUMBERS: usize = 12;
/// Views that the page of a run compares with those of the result, at most.
pub const COMPARED_VIEWS: usize = 24;
/// The phase that runs with primitives have.
const ITERATION: &str = "iteration";
/// Rows named in the message that rejects a run.
const SHOWN: usize = 3;

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
    /// Phases in the order of the run, and their temporary arrays.
    pub phases: Vec<Phase>,
}

fn sum<'a>(allocations: impl IntoIterator<Item = &'a Allocation>) -> u64 {
    allocations.into_iter().fold(0, |sum, allocation| sum.saturating_add(allocation.total()))
}

impl Estimate {
    /// Estimates a run on a scan with `views` of its training views and `threads` workers.
    pub fn new(scan: &DatasetInfo, views: usize, plan: &Plan, threads: usize) -> Self {
        let config: &Config = plan;
        let scan = &DatasetInfo { scanner: config.with_margin(&scan.scanner), ..scan.clone() };
        let run = Run::new(scan, views, plan, threads);
        let sizes = &run.sizes;
        let reconstruction = |allocations| vec![Phase { name: "reconstruction", allocations }];
        let mut phases = match config.method {
            Method::TrGs | Method::R2Gaussian => run.training(config),
            Method::Fdk => {
                let pads = scan.scanner.detector.offset_u != 0.0 || scan.is_posed || scan.is_cut;
                reconstruction(fdk::arrays(sizes, pads))
            }
            Method::Sart | Method::OsSart => reconstruction(config.sart().arrays(sizes)),
            Method::AsdPocs => reconstruction(config.asd_pocs().arrays(sizes)),
            Method::Cgls => reconstruction(cgls_arrays(sizes)),
            Method::Tv => reconstruction(tv(config, sizes)),
            Method::Naf | Method::SaxNerf | Method::Intratomo => {
                let unit = Phase { name: "unit of density", allocations: SartSettings::default().arrays(sizes) };
                let steps =
                    config.neural().phases(sizes).map(|allocations| Phase { name: "reconstruction", allocations });
                [vec![unit], steps.to_vec()].concat()
            }
        };
        if scan.train > views {
            let all =
                allocation("all training projections, before the choice of views", scan.train * sizes.detector, F32);
            phases.insert(0, Phase { name: "reading", allocations: vec![all] });
        }
        phases.extend([run.evaluation(config), run.views(config), run.page(config)]);
        Self {
            lasting: vec![
                allocation("training projections", sizes.pixels, if config.model.margin > 0.0 { 2 * F32 } else { F32 }),
                allocation("test projections", scan.test * sizes.detector, F32),
                allocation("true volume", if scan.has_truth { sizes.voxels } else { 0 }, F32),
                allocation("initial points", scan.points, 4 * F64),
            ],
            phases,
        }
    }

    /// The plan with as few slabs as keep the run within `limit` bytes, and its estimate.
    ///
    /// # Errors
    /// As [`Self::check`] of whole volumes, when no number of slabs is enough or the method has none.
    pub fn fitted(scan: &DatasetInfo, views: usize, plan: &Plan, threads: usize, limit: u64) -> Result<(Plan, Self)> {
        let slices = if plan.has_slabs() { scan.scanner.grid.shape[0] } else { 1 };
        let numbers = std::iter::successors(Some(1), |slabs| Some(2 * slabs)).take_while(|&slabs| slabs <= slices);
        let plans = numbers.map(|slabs| plan.in_slabs(slabs));
        let mut estimates = plans.map(|plan| (Self::new(scan, views, &plan, threads), plan));
        if let Some((estimate, plan)) = estimates.find(|(estimate, _)| estimate.peak() <= limit) {
            return Ok((plan, estimate));
        }
        let whole = Self::new(scan, views, plan, threads);
        let without = plan.changed(|config| (config.finish, config.sampling) = (Finish::None, Sampling::Point));
        let least = Self::new(scan, views, &without, threads).peak();
        let refused = |error: Error| match least <= limit {
            true => error.or_instead(format!("finish=none and sampling=point, which need {}", ByteSize(least))),
            false => error,
        };
        whole.check(limit).map(|()| (plan.clone(), whole)).map_err(refused)
    }

    /// Estimates a file of `bytes` bytes of unknown content: the content, its arrays and the scan.
    pub fn of_file(bytes: u64) -> Self {
        let allocations =
            vec![allocation("the file, its arrays and the scan", usize::try_from(bytes).unwrap_or(usize::MAX), 5)];
        Self { lasting: Vec::new(), phases: vec![Phase { name: "reading", allocations }] }
    }

    /// Bytes in the phase that needs most.
    pub fn peak(&self) -> u64 {
        self.most().1
    }

    /// The phase that needs most.
    pub fn worst(&self) -> &Phase {
        self.most().0
    }

    /// The phase that needs most, and the bytes of all that lives in it.
    fn most(&self) -> (&Phase, u64) {
        let (lasting, mut kept) = (sum(&self.lasting), 0);
        let needs = self.phases.iter().map(|phase| {
            let arrays = lasting.saturating_add(sum(&phase.allocations));
            let more = SLACK * arrays as f64 + (KEPT * kept as f64).min(MOST_KEPT as f64);
            kept = kept.max(sum(phase.allocations.iter().filter(|row| row.count < MOST_KEPT / F32)));
            (phase, PROGRAM.saturating_add(arrays).saturating_add(more as u64))
        });
        needs.max_by_key(|(_, bytes)| *bytes).expect("every run is evaluated")
    }

    /// Rejects a run that may need more than `limit` bytes.
    ///
    /// # Errors
    /// [`Error::Memory`] with the estimate and its largest rows.
    pub fn check(&self, limit: u64) -> Result<()> {
        if self.peak() <= limit {
            return Ok(());
        }
        let points = "fewer primitives (" + Setting::Points + ", density_control.cap), views (";
        let has_primitives = self.phases.iter().any(|phase| phase.name == ITERATION);
        let views = if has_primitives { points } else { "fewer views (".into() };
        let instead = views + Setting::Views + "), pixels or voxels";
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

/// The arrays of TV by a configuration.
fn tv(config: &Config, sizes: &Sizes) -> Vec<Allocation> {
    config.tv().arrays(sizes, config.tv.weight.fixed().is_none())
}

/// The volumes of the result.
fn volumes(config: &Config, sizes: &Sizes) -> Allocation {
    match (config.method.fits_primitives(), config.finish) {
        (true, Finish::Tv) => allocation("volume, and that before the finish", sizes.voxels, 2 * F32),
        (true, Finish::None) => allocation("volume", sizes.voxels, F32),
        (false, _) => allocation("volume, and as its projections read it", sizes.voxels, 2 * F32),
    }
}

/// The sizes that the rows of a run follow from.
struct Run {
    sizes: Sizes,
    /// What the training sees.
    seen: Sizes,
    /// Rows of a view.
    rows: usize,
    /// Primitives at the start.
    points: usize,
    /// Largest number of primitives.
    most: usize,
    test: usize,
}

impl Run {
    fn new(scan: &DatasetInfo, views: usize, config: &Plan, threads: usize) -> Self {
        let grid = config.seen(&scan.scanner).grid;
        let points = match config.initialisation.from {
            Start::Fdk | Start::SmoothedFdk | Start::Sart | Start::Tv => config.model.points.min(grid.voxels()),
            Start::Random | Start::Model => config.model.points,
            Start::Dataset => scan.points,
        };
        let sizes = |scanner: &Scanner| Sizes {
            detector: scanner.detector.pixels(),
            pixels: views * scanner.detector.pixels(),
            voxels: scanner.grid.voxels(),
            slice: scanner.grid.shape[1] * scanner.grid.shape[2],
            slices: scanner.grid.shape[0],
            column: scanner.grid.shape[2],
            real: match config.precision {
                Precision::F32 => F32,
                Precision::F64 => F64,
            },
            threads,
            slabs: config.division().slabs,
        };
        let seen = config.seen(&scan.scanner);
        let (rows, most) = (seen.detector.rows, most_primitives(points, config));
        let (sizes, seen) = (sizes(&scan.scanner), sizes(&seen));
        Self { sizes, seen, rows, points, most, test: scan.test }
    }

    fn training(&self, config: &Config) -> Vec<Phase> {
        let Self { sizes: whole, seen: sizes, most: m, .. } = self;
        let (m, real, d) = (*m, sizes.real, sizes.detector);
        let averaged = if config.coarse > 1 { sizes.pixels } else { 0 };
        let in_units = config.density_unit.fixed() != Some(1.0);
        let lasting = |count: usize| {
            vec![
                allocation("projections on longer pixels", averaged, F32),
                allocation("views as SSIM compares with them: image, mean, variance", sizes.pixels, 3 * real),
                allocation("projections in units of density", if in_units { sizes.pixels } else { 0 }, F32),
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
            Start::Sart | Start::Model => config.sart().arrays(sizes),
            _ => fdk::arrays(sizes, false),
        };
        start.push(allocation("bright voxels and the choice among them", sizes.voxels, size_of::<usize>() + 4));
        let block = |side: usize| sizes.voxels.min(side * side * side);
        let together = projector::bytes::SLICES * whole.threads;
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
        // The next population coexists with the last one: successors, raw and physical values, moments.
        let grown = if config.density_control.method == DensityControl::None { 0 } else { m };
        let next = allocation("next population", grown, 2 * 80 + 5 * NUMBERS * F64 + 3 * F64 + 16);
        let mut phases = vec![
            Phase { name: "unit of density", allocations: config.sart().arrays(sizes) },
            with("first volume", self.points, &start),
            working(ITERATION, &[]),
            working("density control", &[next]),
            working("checkpoint", &[allocation("copy of the state", m, 3 * NUMBERS * F64 + 6 * F64 + 12)]),
            with(
                "last volume",
                m,
                &[
                    physical,
                    prepared,
                    allocation("primitives on the grid", m, projector::bytes::GRID),
                    allocation("slices of the volume", whole.slice * whole.slices.min(together), real),
                    allocation("volume", whole.voxels, F32),
                ],
            ),
        ];
        if config.has_pilot() {
            let run = [
                allocation("volume of the run", whole.voxels, F32),
                allocation("primitives of the run", m, NUMBERS * F64),
                allocation("views of the pilot run and those held out", sizes.pixels, F32),
            ];
            phases.push(working("pilot run", &run));
            let choice = |more: Vec<Allocation>| Phase {
                name: "choice of sampling and finish",
                allocations: [&run[..], &[allocation("primitives of the pilot run", m, NUMBERS * F64)], &more].concat(),
            };
            let name = "volume of the pilot run, and its interpolant as it is solved for";
            phases.push(choice(vec![allocation(name, whole.voxels, F64 + 2 * F32)]));
            // Weights are chosen on the voxels that the training sees, all else on those of the scan.
            let mut allocations = tv(config, whole);
            allocations.extend([
                allocation("volume of the pilot run, and its interpolant", whole.voxels, 2 * F32),
                allocation("corrected projections, and what they come from", whole.pixels, 3 * F32),
            ]);
            phases.push(choice(allocations));
        }
        if config.sampling != Sampling::Point {
            let volumes = allocation("volume, and its interpolant as it is solved for", whole.voxels, F64 + 2 * F32);
            phases.push(Phase { name: "sampling", allocations: vec![volumes] });
        }
        if config.finish != Finish::None {
            let mut allocations = tv(config, whole);
            allocations.push(allocation("volume of the primitives", whole.voxels, F32));
            allocations.push(allocation("corrected projections", whole.pixels, F32));
            phases.push(Phase { name: "finish", allocations });
        }
        phases
    }

    fn evaluation(&self, config: &Config) -> Phase {
        let Self { sizes, .. } = self;
        let m = if config.method.fits_primitives() { self.most } else { 0 };
        // A view or a slice for each worker.
        let compared = (sizes.detector * sizes.threads.min(self.test)).max(sizes.slice * sizes.threads);
        let allocations = vec![
            volumes(config, sizes),
            allocation(
                "test views of the result",
                self.test * sizes.detector,
                F32 + if m > 0 { sizes.real } else { 0 },
            ),
            allocation("images that are compared", compared, 6 * F64),
            allocation(
                "primitives in a view",
                m,
                NUMBERS * F64 + projector::bytes::FIELD + projector::bytes::VIEW + 16 * 4,
            ),
        ];
        Phase { name: "evaluation", allocations }
    }

    /// The views that the page compares with those of the result.
    fn views(&self, config: &Config) -> Phase {
        let Self { sizes, .. } = self;
        let compared = self.compared();
        let real = if config.method.fits_primitives() { sizes.real } else { 0 };
        let allocations = vec![
            volumes(config, sizes),
            allocation("views, those of the result and their difference", compared, 3 * F32 + real),
            allocation("differences of neighbouring pixels", sizes.pixels / 4, F64),
        ];
        Phase { name: "views of the page", allocations }
    }

    /// The page, with its volumes and views as text.
    fn page(&self, config: &Config) -> Phase {
        let Self { sizes, .. } = self;
        let beside = if config.method.fits_primitives() { volumes(config, sizes).bytes } else { F32 };
        let shown = self.compared().min(WHOLE);
        let allocations = vec![
            allocation("volumes", sizes.voxels, beside),
            allocation("volumes and views as the page holds them", 2 * (sizes.voxels.min(WHOLE) + shown), 3),
        ];
        Phase { name: "page", allocations }
    }

    /// Pixels of the views that the page compares.
    fn compared(&self) -> usize {
        let Self { sizes, .. } = self;
        let compared = if self.test > 0 { self.test * sizes.detector } else { sizes.pixels };
        compared.min(COMPARED_VIEWS * sizes.detector)
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

    /// The training sees longer voxels there, and the finish is judged on those of the scan.
    #[test]
    fn a_coarse_pilot_has_whole_volumes() {
        let mut scan = scan();
        scan.scanner.grid = Grid::cube(256);
        let of = |method| {
            let plan = Config::of(method).plan(&scan.scanner, 18).unwrap();
            assert!(method == Method::Tv || plan.coarse == 2);
            Estimate::new(&scan, 18, &plan, 2).peak()
        };
        let volumes = 3 * 4 * (256_u64 * 256 * 256);
        assert!([Method::TrGs, Method::R2Gaussian].into_iter().all(|method| of(method) > of(Method::Tv) + volumes));
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
        let mut large = scan();
        large.scanner.grid = Grid::cube(512);
        let plan_of_large = Config::default().plan(&large.scanner, 18).unwrap();
        let of = |limit: u64| Estimate::fitted(&large, 18, &plan_of_large, 2, limit << 20).unwrap_err().to_string();
        assert!(of(1500).contains("or finish=none and sampling=point, which need 1."), "{}", of(1500));
        assert!(!of(100).contains("finish=none"), "{}", of(100));
        estimate.check(estimate.peak()).unwrap();
        let message = estimate.check(estimate.peak() - 1).unwrap_err().to_string();
        assert!(
            message.contains("`max_memory`") && message.contains("iB (") && message.contains("`points`"),
            "{message}"
        );
    }
}
