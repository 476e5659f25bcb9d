//! Plots a metric against the varied parameter: a line per row, or one line through numbered rows.

use super::summary::{Estimate, Summary};
use super::table::{Table, TableRow};
use crate::confidence::nu_target;
use crate::primitives::activation::Interval;
use crate::report::escape;
use plotters::prelude::*;
use std::collections::BTreeSet;

/// The colours of Okabe and Ito, distinguishable with any colour vision, on light and dark backgrounds.
const COLOURS: [RGBColor; 7] = [
    RGBColor(0, 114, 178),
    RGBColor(230, 159, 0),
    RGBColor(0, 158, 115),
    RGBColor(204, 121, 167),
    RGBColor(86, 180, 233),
    RGBColor(213, 94, 0),
    RGBColor(128, 128, 128),
];
const SIZE: (u32, u32) = (720, 340);

/// One line: our figures with their band, and the paper's figures.
struct Series {
    name: String,
    ours: Vec<(f64, Estimate)>,
    paper: Vec<(f64, f64)>,
}

/// The plot as inline SVG with its legend; `None` if the table varies nothing, or no cell is finished.
pub(super) fn plot(summary: &Summary, metric: &str) -> Option<String> {
    summary.table.against.as_ref()?;
    let column = summary.table.metrics.iter().position(|known| known == metric)?;
    let series = series(summary, column);
    let places: BTreeSet<_> = points(&series).map(|(x, _)| x.to_bits()).collect();
    if places.len() < 2 {
        return None;
    }
    drawn(&series, summary.table.against.as_deref()?, &summary.table.noise)
}

/// The target of ν against the confidence `[Eq. 9]`, a line for each temperature of the rows, as inline SVG; `None` if all have the
/// same.
pub(super) fn targets(summary: &Summary) -> Option<String> {
    let Table { rows, basis, set, .. } = &summary.table;
    let configs = rows.iter().filter_map(|row| row.config(*basis, set)).filter(|config| config.confidence.enabled);
    let settings = configs.map(|config| (config.confidence.settings(1.0), config.model.nu_min, config.model.nu_max));
    let mut series: Vec<Series> = Vec::new();
    for (settings, min, max) in settings {
        let name = format!("T = {}", settings.temperature);
        let target = |k: u32| {
            let c = f64::from(k) / 200.0;
            (c, Estimate { mean: nu_target(c, &settings, Interval { min, max }), interval: None })
        };
        if series.iter().all(|line| line.name != name) {
            series.push(Series { name, ours: (0..=200).map(target).collect(), paper: Vec::new() });
        }
    }
    if series.len() < 2 { None } else { drawn(&series, "confidence", &[]) }
}

/// The chart as SVG with its legend.
fn drawn(series: &[Series], against: &str, noise: &[String]) -> Option<String> {
    let mut svg = String::new();
    draw(&mut svg, series, against, noise).ok()?;
    let svg = &svg[svg.find("<svg ")?..];
    let names = series.iter().zip(COLOURS.iter().cycle()).map(|(Series { name, ours, paper }, RGBColor(r, g, b))| {
        let whose = match (ours.is_empty(), paper.is_empty()) {
            (false, _) => "",
            (true, false) => " (the paper’s alone)",
            (true, true) => " (not finished)",
        };
        format!("<span><b style=\"color: rgb({r} {g} {b})\">●</b> {}{whose}</span>\n", escape(name))
    });
    Some(format!("{svg}\n<p class=\"legends\">\n{}</p>", names.collect::<String>()))
}

fn points(series: &[Series]) -> impl Iterator<Item = (f64, f64)> {
    series.iter().flat_map(|series| {
        let ours = series.ours.iter().flat_map(|(x, estimate)| {
            let (low, high) = estimate.interval.unwrap_or((estimate.mean, estimate.mean));
            [(*x, low), (*x, high)]
        });
        ours.chain(series.paper.iter().copied())
    })
}

fn series(summary: &Summary, column: usize) -> Vec<Series> {
    let table = &summary.table;
    let of = |name: String, wanted: &dyn Fn(&TableRow, &str, usize) -> bool| {
        let mut series = Series { name, ours: Vec::new(), paper: Vec::new() };
        for block in &summary.blocks {
            for (row, figures) in table.rows.iter().zip(&block.figures) {
                let Some(x) = table.place(row, block.views, &block.noise) else { continue };
                if wanted(row, &block.noise, block.views) {
                    let figure = &figures[column];
                    series.ours.extend(figure.complete().map(|ours| (x, ours)));
                    series.paper.extend(figure.paper.map(|paper| (x, paper)));
                }
            }
        }
        series
    };
    match table.against.as_deref() {
        Some("views") => table.rows.iter().map(|row| of(row.name.clone(), &|r, _, _| r.name == row.name)).collect(),
        Some("noise") => {
            let lines = table.rows.iter().flat_map(|row| table.views.iter().map(move |&views| (row, views)));
            lines
                .map(|(row, views)| {
                    of(format!("{}, {views} views", row.name), &|r, _, v| r.name == row.name && v == views)
                })
                .collect()
        }
        _ => vec![of("TR-GS".into(), &|_, _, _| true)],
    }
}

fn draw(
    svg: &mut String,
    series: &[Series],
    against: &str,
    noise: &[String],
) -> Result<(), Box<dyn std::error::Error>> {
    let range = |values: Vec<f64>| {
        let (low, high) = values.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), &v| (l.min(v), h.max(v)));
        let margin = 0.05 * (high - low).max(1e-6);
        low - margin..high + margin
    };
    let area = SVGBackend::with_string(svg, SIZE).into_drawing_area();
    let mut chart = ChartBuilder::on(&area).margin(8).x_label_area_size(36).y_label_area_size(56).build_cartesian_2d(
        range(points(series).map(|p| p.0).collect()),
        range(points(series).map(|p| p.1).collect()),
    )?;
    let grey = RGBColor(128, 128, 128);
    let label = |x: &f64| match against {
        "noise" => {
            noise.iter().enumerate().find(|(i, _)| (*i as f64 - x).abs() < 1e-6).map_or(String::new(), |n| n.1.clone())
        }
        "views" => format!("{x:.0}"),
        _ => format!("{x:.2}"),
    };
    chart
        .configure_mesh()
        .light_line_style(TRANSPARENT)
        .bold_line_style(grey.mix(0.25))
        .axis_style(grey)
        .label_style(("sans-serif", 13, &grey))
        .x_labels(if against == "noise" { 2 * noise.len() } else { 6 })
        .x_label_formatter(&label)
        .x_desc(against)
        .draw()?;
    for (number, Series { ours, paper, .. }) in series.iter().enumerate() {
        let colour = COLOURS[number % COLOURS.len()];
        let bands: Vec<_> = ours.iter().filter_map(|(x, e)| e.interval.map(|(low, high)| (*x, low, high))).collect();
        let outline = bands.iter().map(|b| (b.0, b.1)).chain(bands.iter().rev().map(|b| (b.0, b.2)));
        chart.draw_series([Polygon::new(outline.collect::<Vec<_>>(), colour.mix(0.2))])?;
        chart.draw_series(DashedLineSeries::new(paper.clone(), 4, 4, colour.into()))?;
        let line = ours.iter().map(|(x, estimate)| (*x, estimate.mean));
        let size = if ours.len() < 50 { 3 } else { 0 };
        chart.draw_series(LineSeries::new(line, colour.stroke_width(2)).point_size(size))?;
    }
    area.present()?;
    Ok(())
}
