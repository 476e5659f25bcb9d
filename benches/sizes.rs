//! Time and memory of whole runs against the side of the volume, with the fitted exponents.
//!
//! A torso with 18 views, whose detector has as many pixels as the volume has voxels on a side; `--method M` and no other
//! setting, on one thread. A table is printed, and `target/sizes.svg` shows both on logarithmic axes. Linux alone: CPU
//! seconds and the largest resident set are those of /proc. `cargo bench --bench sizes [-- SIDE...]`

use plotters::prelude::*;
use std::error::Error;
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::Duration;
use trgs::numeric::elementary::log;

const METHODS: [&str; 4] = ["fdk", "sart", "tv", "tr-gs"];
const COLOURS: [RGBColor; 4] =
    [RGBColor(0, 114, 178), RGBColor(230, 159, 0), RGBColor(0, 158, 115), RGBColor(204, 121, 167)];
const SIDES: [usize; 4] = [24, 32, 48, 64];
/// Clock ticks of /proc/PID/stat in a second.
const TICKS: f64 = 100.0;

/// CPU seconds and MiB of a run of the program.
fn measured(arguments: &str, folder: &Path) -> Result<[f64; 2], Box<dyn Error>> {
    let mut command = Command::new(env!("CARGO_BIN_EXE_trgs"));
    command.args(arguments.split_whitespace()).current_dir(folder).stdout(Stdio::null()).stderr(Stdio::null());
    let mut child = command.spawn()?;
    let process = child.id();
    let of = |file: &str| std::fs::read_to_string(format!("/proc/{process}/{file}")).unwrap_or_default();
    let (mut seconds, mut peak) = (0.0_f64, 0.0_f64);
    loop {
        // User and system time are the 14th and 15th field; the second one, the name, ends with a bracket.
        let (stat, status) = (of("stat"), of("status"));
        let fields = stat.rsplit(") ").next().unwrap_or_default().split(' ').skip(11).take(2);
        let ticks: f64 = fields.filter_map(|field| field.parse::<f64>().ok()).sum();
        let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:"));
        let kib = line.and_then(|line| line.trim().trim_end_matches(" kB").parse::<f64>().ok());
        (seconds, peak) = (seconds.max(ticks / TICKS), peak.max(kib.unwrap_or(0.0) / 1024.0));
        if let Some(outcome) = child.try_wait()? {
            return if outcome.success() { Ok([seconds, peak]) } else { Err(arguments.to_owned().into()) };
        }
        std::thread::sleep(Duration::from_millis(5));
    }
}

/// The slope of a line through the logarithms, by least squares.
fn exponent(points: &[(f64, f64)]) -> f64 {
    let logs: Vec<(f64, f64)> = points.iter().map(|(x, y)| (log(*x), log(y.max(0.01)))).collect();
    let n = logs.len() as f64;
    let (mean_x, mean_y) = (logs.iter().map(|p| p.0).sum::<f64>() / n, logs.iter().map(|p| p.1).sum::<f64>() / n);
    let along: f64 = logs.iter().map(|(x, y)| (x - mean_x) * (y - mean_y)).sum();
    along / logs.iter().map(|(x, _)| (x - mean_x) * (x - mean_x)).sum::<f64>()
}

fn draw(path: &Path, growths: &[[Vec<(f64, f64)>; 2]]) -> Result<(), Box<dyn Error>> {
    let area = SVGBackend::new(path, (900, 380)).into_drawing_area();
    area.fill(&WHITE)?;
    let (left, right) = area.split_horizontally(450);
    for (quantity, (panel, title)) in
        [(left, "CPU seconds"), (right, "largest resident set, MiB")].into_iter().enumerate()
    {
        let points = || growths.iter().flat_map(|growth| growth[quantity].iter());
        let range = |of: fn(&(f64, f64)) -> f64| {
            let values = points().map(of).map(|value| value.max(0.01));
            values.clone().fold(f64::INFINITY, f64::min) / 1.3..values.fold(0.0, f64::max) * 1.3
        };
        let mut chart = ChartBuilder::on(&panel)
            .caption(title, ("sans-serif", 16))
            .margin(10)
            .x_label_area_size(36)
            .y_label_area_size(50)
            .build_cartesian_2d(range(|p| p.0).log_scale(), range(|p| p.1).log_scale())?;
        let mut mesh = chart.configure_mesh();
        mesh.x_desc("side of the volume, voxels")
            .light_line_style(WHITE)
            .y_label_formatter(&|y| format!("{y}"))
            .draw()?;
        for ((method, growth), colour) in METHODS.iter().zip(growths).zip(COLOURS) {
            let line = growth[quantity].iter().map(|(x, y)| (*x, y.max(0.01)));
            let name = format!("{method}: side^{:.1}", exponent(&growth[quantity]));
            chart
                .draw_series(LineSeries::new(line.clone(), colour.stroke_width(2)))?
                .label(name)
                .legend(move |(x, y)| PathElement::new(vec![(x, y), (x + 16, y)], colour.stroke_width(2)));
            chart.draw_series(line.map(|point| Circle::new(point, 3, colour.filled())))?;
        }
        chart.configure_series_labels().position(SeriesLabelPosition::UpperLeft).background_style(WHITE).draw()?;
    }
    area.present()?;
    Ok(())
}

fn main() -> Result<(), Box<dyn Error>> {
    if !cfg!(target_os = "linux") {
        eprintln!("SKIPPED: CPU seconds and memory are those of /proc");
        return Ok(());
    }
    let given: Vec<usize> = std::env::args().skip(1).filter_map(|argument| argument.parse().ok()).collect();
    if given.len() == 1 {
        return Err("one side has no exponent: give two or more, such as 24 32".into());
    }
    let sides = if given.is_empty() { SIDES.to_vec() } else { given };
    let folder = std::env::temp_dir().join(format!("trgs-sizes-{}", std::process::id()));
    std::fs::create_dir_all(&folder)?;
    let mut growths = vec![[Vec::new(), Vec::new()]; METHODS.len()];
    println!("| voxels | method | CPU seconds | MiB |\n|---|---|---|---|");
    for side in sides {
        let scan = "simulate --phantom torso --views 18 --test-views 4 --noise low --quiet --overwrite --out scan";
        measured(&format!("{scan} --size {side} --detector {side}"), &folder)?;
        for (method, growth) in METHODS.iter().zip(&mut growths) {
            let run = format!("reconstruct scan --method {method} --out {method} --threads 1 --quiet --overwrite");
            let [seconds, peak] = measured(&run, &folder)?;
            println!("| {side}³ | `{method}` | {seconds:.1} | {peak:.0} |");
            growth[0].push((side as f64, seconds));
            growth[1].push((side as f64, peak));
        }
    }
    for (method, growth) in METHODS.iter().zip(&growths) {
        println!(
            "{method}: CPU time grows with side^{:.2}, memory with side^{:.2}",
            exponent(&growth[0]),
            exponent(&growth[1])
        );
    }
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("target/sizes.svg");
    draw(&path, &growths)?;
    println!("{}", path.display());
    std::fs::remove_dir_all(&folder)?;
    Ok(())
}
