//! How much memory a run will need, before it starts: a row for each kind of array, by the moment it lives in.
//!
//! The estimate is an upper end: populations are taken as large as their settings let them become, and what the allocator
//! keeps between two uses is given room. It knows sizes alone, so a run can be refused before a projection is read.
//!
//! Tests: `tests/cli/memory.rs` holds it against the largest resident set of runs.

use crate::config::{Config, DensityControl, Finish, Method, Precision, Sampling, Start};
use crate::error::{Error, Result};
use crate::projector;
use crate::scene::dataset::Survey;
use crate::setting::Setting;
use bytesize::ByteSize;
use std::fmt;

/// The program itself, its threads' stacks and what is small.
const PROGRAM: u64 = 20 << 20;
/// What the allocator keeps, as a part of all arrays.
const SLACK: f64 = 0.15;
/// Numbers of a primitive: mean, scales, quaternion, density, ν.
const NUMBERS: usize = 12;
/// A double.
const F64: usize = size_of::<f64>();
/// A single.
const F32: usize = size_of::<f32>();
/// Columns of the message that refuses a run.
const SHOWN: usize = 3;

/// Arrays of one kind.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Row {
    /// What they hold.
    pub what: &'static str,
    /// Number of elements: pixels, voxels or primitives.
    pub count: usize,
    /// Bytes for each.
    pub bytes: usize,
}

/// Arrays that live at the same time.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Moment {
    /// What the run does then.
    pub name: &'static str,
    /// Its arrays, beside those that last.
    pub rows: Vec<Row>,
}

/// What a run needs.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Estimate {
    /// Arrays that live from the beginning to the end.
    pub lasting: Vec<Row>,
    /// What comes and goes.
    pub moments: Vec<Moment>,
}

impl Row {
    /// Bytes of all.
    pub fn total(&self) -> u64 {
        (self.count as u64).saturating_mul(self.bytes as u64)
    }
}

fn row(what: &'static str, count: usize, bytes: usize) -> Row {
    Row { what, count, bytes }
}

fn sum(rows: &[Row]) -> u64 {
    rows.iter().fold(0, |sum, row| sum.saturating_add(row.total()))
}

impl Estimate {
    /// Of a run of `config` on a scan, of whose training views it uses `views`, with so many workers.
    pub fn new(scan: &Survey, views: usize, config: &Config, threads: usize) -> Self {
        let config = &config.resolved(&scan.scanner, views);
        let sizes = Sizes::new(scan, views, config, threads);
        let mut moments = match config.method {
            Method::TrGs | Method::R2Gaussian => sizes.training(config),
            Method::Fdk => vec![sizes.fdk("reconstruction", scan.scanner.detector.offset_u != 0.0)],
            Method::Sart | Method::OsSart => vec![sizes.sart(config)],
            Method::AsdPocs => vec![sizes.asd_pocs(config)],
            Method::Cgls => vec![sizes.cgls()],
            Method::Tv => vec![sizes.tv(config)],
        };
        if scan.train > views {
            let all = row("all training projections, before the choice of views", scan.train * sizes.detector, F32);
            moments.push(Moment { name: "reading", rows: vec![all] });
        }
        moments.push(sizes.evaluation(config));
        Self {
            lasting: vec![
                row("training projections", sizes.pixels, F32),
                row("test projections", scan.test * sizes.detector, F32),
                row("true volume", if scan.has_truth { sizes.voxels } else { 0 }, F32),
                row("initial points", scan.points, 4 * F64),
            ],
            moments,
        }
    }

    /// Of reading a file of so many bytes whose sizes only reading tells: its content, its arrays, and the scan.
    pub fn of_file(bytes: u64) -> Self {
        let rows = vec![row("the file, its arrays and the scan", usize::try_from(bytes).unwrap_or(usize::MAX), 5)];
        Self { lasting: Vec::new(), moments: vec![Moment { name: "reading", rows }] }
    }

    /// Bytes at the worst moment.
    pub fn peak(&self) -> u64 {
        let arrays = sum(&self.lasting).saturating_add(sum(&self.worst().rows));
        PROGRAM.saturating_add(arrays).saturating_add((arrays as f64 * SLACK) as u64)
    }

    /// The moment that needs most.
    pub fn worst(&self) -> &Moment {
        self.moments.iter().max_by_key(|moment| sum(&moment.rows)).expect("every run is evaluated")
    }

    /// Refuses a run that may need more than `limit` bytes.
    ///
    /// # Errors
    /// [`Error::Invalid`] with the figure and what makes it.
    pub fn check(&self, limit: u64) -> Result<()> {
        if self.peak() <= limit {
            return Ok(());
        }
        let [points, views] = [Setting::Points, Setting::Views];
        let remedy =
            format!("take fewer primitives ({points}, density_control.cap), views ({views}), pixels or voxels");
        Err(Error::invalid(Setting::MaxMemory, ByteSize(limit), format!("at least {self}"), remedy))
    }
}

/// The figure, and the largest of what makes it.
impl fmt::Display for Estimate {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let mut rows: Vec<&Row> = self.lasting.iter().chain(&self.worst().rows).collect();
        rows.sort_by_key(|row| std::cmp::Reverse(row.total()));
        let parts: Vec<_> =
            rows.iter().take(SHOWN).map(|row| format!("{} {}", ByteSize(row.total()), row.what)).collect();
        write!(f, "{} ({}; among them {})", ByteSize(self.peak()), self.worst().name, parts.join(", "))
    }
}

/// The sizes that everything follows from.
#[derive(Clone)]
struct Sizes {
    /// Pixels of a view, and its rows.
    detector: usize,
    rows: usize,
    /// Pixels of all views that are used.
    pixels: usize,
    voxels: usize,
    /// Voxels with one more along each axis.
    voxels_beyond: usize,
    /// Voxels of a slice across x.
    slice: usize,
    slices: usize,
    /// Primitives at the start.
    points: usize,
    /// Primitives at most.
    most: usize,
    test: usize,
    /// Bytes of a number that pixels and voxels are computed in.
    real: usize,
    threads: usize,
}

impl Sizes {
    fn new(scan: &Survey, views: usize, config: &Config, threads: usize) -> Self {
        let (grid, detector) = (&scan.scanner.grid, scan.scanner.detector.pixels());
        let points = match config.initialisation.from {
            Start::Fdk | Start::SmoothedFdk | Start::Sart | Start::Tv => config.model.points.min(grid.voxels()),
            Start::Random => config.model.points,
            Start::Dataset => scan.points,
        };
        Self {
            detector,
            rows: scan.scanner.detector.rows,
            pixels: views * detector,
            voxels: grid.voxels(),
            voxels_beyond: grid.shape.iter().map(|&n| if n > 1 { n + 1 } else { n }).product(),
            slice: grid.shape[1] * grid.shape[2],
            slices: grid.shape[0],
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

    fn fdk(&self, name: &'static str, displaced: bool) -> Moment {
        // A displaced detector is made twice as wide at most, before the projections are filtered.
        let copies = if displaced { 4 } else { 1 };
        let rows = vec![row("filtered projections", self.pixels, copies * F32), row("volume", self.voxels, F32)];
        Moment { name, rows }
    }

    fn training(&self, config: &Config) -> Vec<Moment> {
        let (m, real, d) = (self.most, self.real, self.detector);
        let in_units = config.density_unit.fixed() != Some(1.0);
        let lasting = |count: usize| {
            vec![
                row("views as SSIM compares with them: image, mean, variance", self.pixels, 3 * real),
                row("projections in units of density", if in_units { self.pixels } else { 0 }, F32),
                // Raw values, two moments each, momentum, id, c, its target, pull and views.
                row("state of the optimisers", count, 3 * NUMBERS * F64 + 3 * F64 + 8 + 2 * F64 + 12),
            ]
        };
        let with = |name, count: usize, rows: &[Row]| Moment { name, rows: [lasting(count), rows.to_vec()].concat() };
        let physical = row("physical values", m, NUMBERS * F64);
        let shapes = row("primitives, prepared", m, projector::bytes::FIELD);
        let mut start = match config.initialisation.from {
            Start::Sart => self.sart(config).rows,
            _ => self.fdk("first volume", false).rows,
        };
        start.push(row("bright voxels and the choice among them", self.voxels, size_of::<usize>() + 4));
        let block = |side: usize| self.voxels.min(side * side * side);
        // What an iteration works in stays for the next one, whatever is due between them.
        let kept = [
            physical,
            shapes,
            row(
                "gradients of the view, of two blocks and of the parameters",
                m,
                3 * projector::bytes::GRADIENT + 2 * NUMBERS * F64 + 3 * F64,
            ),
            row("footprints in the view and on both blocks", m, projector::bytes::VIEW + 2 * projector::bytes::GRID),
            row("lists of primitives by bands", m, 4 * (self.rows / 32 + 1)),
            row("image, loss and cotangent", d, 10 * real),
            row("block of the total variation", block(config.loss.tv_block), 8 * real),
            // Voxels, cotangent, two transforms, a weight of each voxel, and copies of at most six bands out of eight.
            row("block of the wavelets", block(config.wavelet.block), 6 * real + 2),
            row("tree of neighbours, and where it has them", m, 11 * F64 + 1),
        ];
        let working = |name, rows: &[Row]| with(name, m, &[&kept, rows].concat());
        let mut moments = vec![
            Moment { name: "unit of density", rows: self.sart(config).rows },
            with("first volume", self.points, &start),
            working("iteration", &[]),
            working("checkpoint", &[row("copy of the state", m, 3 * NUMBERS * F64 + 6 * F64 + 12)]),
            with(
                "last volume",
                m,
                &[
                    physical,
                    shapes,
                    row("primitives on the grid", m, projector::bytes::GRID),
                    row("volume, in slices, together and in single precision", self.voxels, 2 * real + F32),
                ],
            ),
        ];
        if config.sampling != Sampling::Point {
            let volumes = row("volume, and its interpolant as it is solved for", self.voxels, F64 + 3 * F32);
            let projections = row("projections of the primitives and of the interpolant", self.pixels, 2 * F32);
            moments.push(Moment { name: "sampling", rows: vec![volumes, projections] });
        }
        if config.sampling == Sampling::Auto {
            let mut moved = self.clone();
            moved.voxels = self.voxels_beyond;
            let mut rows = moved.tv(&Config::default()).rows;
            rows.push(row("volume of the primitives, and its interpolant", self.voxels, 2 * F32));
            moments.push(Moment { name: "choice of the sampling", rows });
        }
        if config.finish != Finish::None {
            let mut rows = self.tv(config).rows;
            rows.push(row("volume of the primitives", self.voxels, F32));
            rows.push(row("corrected projections", self.pixels, F32));
            moments.push(Moment { name: "finish", rows });
        }
        if config.density_control.method != DensityControl::None {
            // The next population beside the last one: successors, raw and physical values, moments.
            let next = row("next population", m, 2 * 80 + 5 * NUMBERS * F64 + 3 * F64 + 16);
            moments.push(working("density control", &[next]));
        }
        moments
    }

    fn sart(&self, config: &Config) -> Moment {
        let subset = config.algebraic.subset.saturating_mul(self.detector).min(self.pixels);
        let rows = vec![
            row("projections and lengths of rays", self.pixels, 3 * self.real),
            row("corrections of a set of views", subset, 3 * self.real),
            row("volume, and as it is written", self.voxels, self.real + F32),
            row("sums of slices at work", self.slice, self.at_work(2)),
        ];
        Moment { name: "reconstruction", rows }
    }

    fn asd_pocs(&self, config: &Config) -> Moment {
        let mut moment = self.sart(config);
        moment.rows.extend([
            row("first guess, steps and direction", self.voxels, 5 * self.real + F32),
            row("residual", self.pixels, self.real),
        ]);
        moment
    }

    fn cgls(&self) -> Moment {
        let rows = vec![
            row("projections, residual, image and pairs", self.pixels, 4 * self.real),
            row("volume, direction and gradient", self.voxels, 3 * self.real + F32),
            row("sums of slices at work", self.slice, self.at_work(1)),
        ];
        Moment { name: "reconstruction", rows }
    }

    fn tv(&self, config: &Config) -> Moment {
        let rows = vec![
            row("projections, images of two volumes, residual and pairs", self.pixels, 6 * self.real + 1),
            row(
                "views held out and the others",
                if config.tv.weight.fixed().is_some() { 0 } else { self.pixels },
                F32 + self.real,
            ),
            row("volumes, dual of the total variation, and as it is written", self.voxels, 12 * self.real + F32),
            row("sums of slices at work", self.slice, self.at_work(1)),
        ];
        Moment { name: "reconstruction", rows }
    }

    /// Bytes per voxel of a slice for what all workers sum up.
    fn at_work(&self, numbers: usize) -> usize {
        const SLICES: usize = 8;
        SLICES * numbers * self.real * self.threads.min(self.slices.div_ceil(SLICES))
    }

    fn evaluation(&self, config: &Config) -> Moment {
        let m = if config.method.fits_primitives() { self.most } else { 0 };
        let largest = self.detector.max(self.slice);
        let rows = vec![
            row("volume and a copy in order of its values", self.voxels, 2 * F32),
            row("test views of the result", self.test * self.detector, F32 + if m > 0 { self.real } else { 0 }),
            row("images that are compared", largest, 12 * F64 * self.threads),
            row("primitives in a view", m, NUMBERS * F64 + projector::bytes::FIELD + projector::bytes::VIEW + 16 * 4),
        ];
        Moment { name: "evaluation", rows }
    }
}

/// As many as density control can make of them.
fn most_primitives(points: usize, config: &Config) -> usize {
    let control = &config.density_control;
    let added = |m: usize| match control.method {
        DensityControl::None => 0,
        // Of each primitive two, as long as the cap is not reached before.
        DensityControl::Adc if m < control.cap => m,
        DensityControl::Adc => 0,
        DensityControl::Ar => ((control.growth * m as f64) as usize).min(control.cap.saturating_sub(m)),
    };
    (0..config.iterations / control.every.max(1))
        // Err: it grows no more.
        .try_fold(points, |m, _| if added(m) == 0 { Err(m) } else { Ok(m + added(m)) })
        .unwrap_or_else(|m| m)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::{Beam, Detector, Grid, Scanner};

    fn scan() -> Survey {
        let detector = Detector { rows: 64, columns: 80, pitch_v: 0.05, pitch_u: 0.05, offset_u: 0.0, offset_v: 0.0 };
        let scanner = Scanner { beam: Beam::Cone { dso: 5.0, dsd: 7.0 }, detector, grid: Grid::cube(32) };
        Survey { scanner, train: 18, test: 5, has_truth: true, points: 0 }
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
        ] {
            let config = Config::of(method);
            let of = |scan: &Survey, views, config: &Config| Estimate::new(scan, views, config, 2).peak();
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
        let estimate = Estimate::new(&scan(), 18, &Config::default(), 2);
        estimate.check(estimate.peak()).unwrap();
        let message = estimate.check(estimate.peak() - 1).unwrap_err().to_string();
        assert!(
            message.contains("`max_memory`") && message.contains("iB (") && message.contains("`points`"),
            "{message}"
        );
    }
}
