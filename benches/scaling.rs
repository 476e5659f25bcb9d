//! Growth of time and memory with primitives, pixels, voxels, views and threads.
//!
//! One parameter varies at a time. After the measurements, `target/scaling.svg` shows both against size, relative to
//! the smallest, with a line for linear growth. `cargo bench --bench scaling`

use criterion::{BenchmarkId, Criterion, criterion_group, criterion_main};
use plotters::prelude::*;
use std::hint::black_box;
use std::time::{Duration, Instant};
use trgs::confidence::{Coverage, Settings};
use trgs::config::Config;
use trgs::geometry::{Beam, Detector, Grid, Scanner};
use trgs::memory::Estimate;
use trgs::numeric::threads::{self, WorkerPool};
use trgs::primitives::{Parameters, Primitives};
use trgs::projector::{Field, Projection};
use trgs::scan::dataset::DatasetInfo;

const CUTOFF: f64 = 1e-3;
/// The smallest size of each parameter.
const PRIMITIVES: usize = 2_000;
const PIXELS: usize = 64;
const VOXELS: usize = 32;
const VIEWS: usize = 12;

/// Sizes, with milliseconds and bytes at each size.
struct Growth {
    what: &'static str,
    points: Vec<(f64, f64, Option<f64>)>,
}

fn scanner(pixels: usize, voxels: usize) -> Scanner {
    let pitch = 4.0 / pixels as f64;
    let detector =
        Detector { rows: pixels, columns: pixels, pitch_v: pitch, pitch_u: pitch, offset_u: 0.0, offset_v: 0.0 };
    Scanner { beam: Beam::Cone { dso: 5.0, dsd: 7.0 }, detector, grid: Grid::cube(voxels) }
}

/// `m` primitives of one size in the whole volume: pairs of pixels and primitives grow with `m`.
fn primitives(m: usize) -> Primitives {
    let at = |i: usize, factor: f64| ((i as f64 * factor).fract() - 0.5) * 1.6;
    Primitives::new(Parameters {
        // A low-discrepancy sequence: powers of the inverse of the plastic number.
        mean: (0..m).map(|i| [at(i, 0.819_172_5), at(i, 0.671_043_6), at(i, 0.549_700_5)]).collect(),
        scale: (0..m).map(|i| [0.03, 0.035, 0.025 + 0.002 * (i % 7) as f64]).collect(),
        quaternion: (0..m).map(|i| [1.0, 0.1 * (i % 5) as f64, -0.2, 0.07 * (i % 3) as f64]).collect(),
        density: vec![0.1; m],
        nu: (0..m).map(|i| 5.0 + (i % 30) as f64).collect(),
    })
    .expect("valid primitives")
}

fn memory(scanner: Scanner, views: usize, points: usize, workers: usize) -> f64 {
    let mut config = Config::default();
    (config.model.points, config.density_control.cap) = (points, points);
    config.initialisation.from = trgs::config::Start::Random;
    let plan = config.plan(&scanner, views).expect("values in their ranges");
    let info =
        DatasetInfo { scanner, train: views, test: 0, is_posed: false, has_truth: false, points: 0, is_cut: false };
    Estimate::new(&info, views, &plan, workers).peak() as f64
}

fn all(c: &mut Criterion) {
    let mut group = c.benchmark_group("scaling");
    group.sample_size(10).warm_up_time(Duration::from_millis(300)).measurement_time(Duration::from_secs(2));
    let mut measure = |what: &'static str, size: usize, work: &dyn Fn()| {
        let (mut spent, mut runs) = (Duration::ZERO, 0);
        group.bench_function(BenchmarkId::new(what, size), |bencher| {
            bencher.iter_custom(|n| {
                let began = Instant::now();
                (0..n).for_each(|_| work());
                spent += began.elapsed();
                runs += n as u32;
                began.elapsed()
            });
        });
        spent.as_secs_f64() * 1e3 / f64::from(runs.max(1))
    };
    let workers = threads::count();
    let project = |physical: &Primitives, scanner: &Scanner| {
        let field = Field::<f32>::new(physical, CUTOFF);
        let view = field.view(scanner, 0.4, Projection::Exact);
        let image = view.image();
        let mut gradient = field.zero_gradient();
        view.vjp(image.view(), &mut gradient);
        black_box(field.parameter_gradient(&gradient));
    };
    let mut growths = Vec::new();

    let (here, mut points) = (scanner(4 * PIXELS, VOXELS), Vec::new());
    for factor in [1, 2, 4, 8, 16] {
        let physical = primitives(PRIMITIVES * factor);
        let time = measure("primitives, a view and back", physical.len(), &|| project(&physical, &here));
        points.push((factor as f64, time, Some(memory(here, VIEWS, physical.len(), workers))));
    }
    growths.push(Growth { what: "primitives", points });

    let (physical, mut points) = (primitives(PRIMITIVES), Vec::new());
    for factor in [1, 2, 4, 8] {
        let here = scanner(PIXELS * factor, VOXELS);
        let time = measure("pixels, a view and back", here.detector.pixels(), &|| project(&physical, &here));
        points.push(((factor * factor) as f64, time, Some(memory(here, VIEWS, PRIMITIVES, workers))));
    }
    growths.push(Growth { what: "pixels", points });

    let mut points = Vec::new();
    for factor in [1, 2, 4] {
        let here = scanner(PIXELS, VOXELS * factor);
        let time = measure("voxels, a volume and back", here.grid.voxels(), &|| {
            let field = Field::<f32>::new(&physical, CUTOFF);
            let mut gradient = field.zero_gradient();
            let there = field.on(&here.grid);
            there.vjp(there.voxels().view(), &mut gradient);
            black_box(field.parameter_gradient(&gradient));
        });
        points.push(((factor * factor * factor) as f64, time, Some(memory(here, VIEWS, PRIMITIVES, workers))));
    }
    growths.push(Growth { what: "voxels", points });

    let (here, coverage, mut points) = (scanner(PIXELS, VOXELS), Coverage::new(Settings::default()), Vec::new());
    for factor in [1, 2, 4, 8] {
        let angles = Scanner::uniform_angles(VIEWS * factor, 0.0, std::f64::consts::TAU);
        let time = measure("views, confidence", angles.len(), &|| {
            black_box(coverage.confidence(&physical, &here, &angles));
        });
        points.push((factor as f64, time, Some(memory(here, angles.len(), PRIMITIVES, workers))));
    }
    growths.push(Growth { what: "views", points });

    let (physical, here, mut points) = (primitives(8 * PRIMITIVES), scanner(4 * PIXELS, VOXELS), Vec::new());
    for count in (1..=workers).filter(|n| n.is_power_of_two() || *n == workers) {
        let pool = WorkerPool::new(count).expect("threads");
        let time = measure("threads, a view and back", count, &|| pool.run(|| project(&physical, &here)));
        points.push((count as f64, time, None));
    }
    growths.push(Growth { what: "threads", points });
    group.finish();

    for Growth { what, points } in &growths {
        println!("\n{what:<12} {:>12} {:>12} {:>12}", "times", "ms", "MB at most");
        for (factor, time, bytes) in points {
            let bytes = bytes.map_or("".into(), |bytes| format!("{:.0}", bytes / 1e6));
            println!("{:<12} {factor:>12} {time:>12.3} {bytes:>12}", "");
        }
    }
    draw(&growths).expect("target is a folder that can be written to");
}

/// Draws both panels, in the colours of Okabe and Ito.
fn draw(growths: &[Growth]) -> Result<(), Box<dyn std::error::Error>> {
    const COLOURS: [RGBColor; 5] = [
        RGBColor(0, 114, 178),
        RGBColor(230, 159, 0),
        RGBColor(0, 158, 115),
        RGBColor(204, 121, 167),
        RGBColor(86, 180, 233),
    ];
    let path = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("target/scaling.svg");
    let area = SVGBackend::new(&path, (900, 380)).into_drawing_area();
    area.fill(&WHITE)?;
    let (left, right) = area.split_horizontally(450);
    type Pick = fn(&(f64, f64, Option<f64>)) -> Option<f64>;
    let panels: [(_, &str, Pick); 2] = [(left, "time", |p| Some(p.1)), (right, "memory at most", |p| p.2)];
    for (panel, title, pick) in panels {
        let mut chart = ChartBuilder::on(&panel)
            .caption(format!("{title}, relative to the smallest"), ("sans-serif", 16))
            .margin(10)
            .x_label_area_size(36)
            .y_label_area_size(44)
            .build_cartesian_2d((1.0..70.0).log_scale(), (0.4..70.0).log_scale())?;
        // As many labels as fit: 1, 2, 5, 10, 20, 50.
        let few = |x: &f64| {
            let first = if *x < 10.0 { *x } else { *x / 10.0 };
            if [1.0, 2.0, 5.0].contains(&first.round()) { format!("{x:.0}") } else { String::new() }
        };
        let mut mesh = chart.configure_mesh();
        mesh.x_desc("size, relative to the smallest").light_line_style(WHITE);
        mesh.x_label_formatter(&few).y_label_formatter(&|y| format!("{y:.0}")).draw()?;
        chart
            .draw_series(LineSeries::new([(1.0, 1.0), (64.0, 64.0)], BLACK.stroke_width(1)))?
            .label("linear")
            .legend(|(x, y)| PathElement::new(vec![(x, y), (x + 16, y)], BLACK));
        for (Growth { what, points }, colour) in growths.iter().zip(COLOURS) {
            let values: Vec<_> = points.iter().filter_map(|p| Some((p.0, pick(p)?))).collect();
            let Some(&(_, smallest)) = values.first() else { continue };
            let line = values.iter().map(|(x, y)| (*x, y / smallest));
            chart
                .draw_series(LineSeries::new(line.clone(), colour.stroke_width(2)))?
                .label(*what)
                .legend(move |(x, y)| PathElement::new(vec![(x, y), (x + 16, y)], colour.stroke_width(2)));
            chart.draw_series(line.map(|point| Circle::new(point, 3, colour.filled())))?;
        }
        chart.configure_series_labels().position(SeriesLabelPosition::UpperLeft).background_style(WHITE).draw()?;
    }
    area.present()?;
    println!("\n{}", path.display());
    Ok(())
}

criterion_group!(benches, all);
criterion_main!(benches);
