//! A self-contained HTML page about a run, with its style, charts and images inside.
//!
//! It is readable on a phone, in dark mode and on paper, loads nothing, and forbids loading by its content policy.

pub mod agreement;
mod chart;
mod histogram;
pub mod slice;
pub mod viewer;

use agreement::Agreement;
use chart::Axes;
pub use chart::Curve;

use crate::classical::algebraic::Choice;
use crate::confidence::Histogram;
use crate::error::Result;
use crate::evaluation::Metrics;
use crate::geometry::Volume;
use crate::primitives::Primitives;
use crate::provenance::Provenance;
use crate::scan::Frame;
use histogram::Bars;
use slice::short;
use std::fmt::Write;
use viewer::{Depth, Scene};

/// The content of a page. An empty or missing part leaves its section out.
#[derive(Clone, Debug, Default)]
pub struct Report<'a> {
    /// Headline.
    pub title: &'a str,
    /// One sentence below the title: what was measured and how.
    pub subtitle: &'a str,
    /// The reconstructions; the page's main one comes first.
    pub methods: Vec<Method<'a>>,
    /// The true volume, on the grid of the reconstructions.
    pub truth: Option<&'a Volume>,
    /// Unit and place of the volumes.
    pub frame: Frame,
    /// What is unusual about the scan, one sentence each.
    pub warnings: Vec<String>,
    /// Measured and rendered views beside each other, compared and displayed.
    pub views: Option<(Agreement, Scene<'a>)>,
    /// Commands that may follow: what each is for, and its text.
    pub next: Vec<(String, String)>,
    /// Losses over the iterations; the total comes first.
    pub curves: Vec<Curve<'a>>,
    /// Quantities of the primitives over the iterations, a chart each.
    pub population: Vec<Curve<'a>>,
    /// The setting that was chosen by held-out views.
    pub choice: Option<&'a Choice>,
    /// The primitives of the main reconstruction, and the confidence of each where it is used.
    pub primitives: Option<(&'a Primitives, Option<Vec<f64>>)>,
    /// Other facts: (label, value).
    pub facts: Vec<(String, String)>,
    /// Origin of the run.
    pub provenance: Option<&'a Provenance>,
}

/// A named reconstruction.
#[derive(Clone, Copy, Debug)]
pub struct Method<'a> {
    /// For example "TR-GS".
    pub name: &'a str,
    /// The volume, if it is to be displayed.
    pub volume: Option<&'a Volume>,
    /// Its metrics, if known.
    pub metrics: Option<&'a Metrics>,
}

/// For each of [`Metrics::NAMES`]: title, unit and meaning.
const METRICS: [(&str, &str, &str); 4] = [
    ("PSNR 3D", "dB", "of all voxels, for a peak of 1"),
    ("SSIM 3D", "", "mean over the slices across x, y and z that are not empty in the truth"),
    ("PSNR 2D", "dB", "of the projections, each divided by its own maximum"),
    ("SSIM 2D", "", "of the same projections"),
];

/// Most numbers below a chart of bars.
const MOST_TICKS: usize = 12;

/// Axes of the chart of losses.
const LOSSES: Axes<'static> =
    Axes { label: "Loss over the iterations", x: "iteration", is_logarithmic: false, mark: None };

/// Content policy that prevents the page from loading anything; the viewer adds the digest of its script.
const POLICY: &str = "default-src 'none'; img-src data:; style-src 'unsafe-inline'";

/// Renders the page as the text of an HTML file.
///
/// # Errors
/// When the volumes differ in shape.
pub fn render(report: &Report) -> Result<String> {
    let views = report.views.as_ref();
    let confidences = report.primitives.as_ref().and_then(|(_, confidences)| confidences.as_ref());
    let content = [
        headline(&report.methods),
        answer(report),
        volumes_to_scroll(report)?,
        views.map(|(agreement, _)| agreement.doubt(&report.frame)).transpose()?.unwrap_or_default(),
        views.map_or(String::new(), |(agreement, scene)| projections(agreement, scene)),
        next(&report.next),
        losses(&report.curves),
        population(&report.population),
        report.choice.map_or(String::new(), choice),
        confidences.map_or(String::new(), |c| confidence(&Histogram::of(c))),
        metrics_table(&report.methods),
        facts(&report.facts),
        report.provenance.map_or(String::new(), provenance),
    ];
    Ok(document(report.title, report.subtitle, &content.concat()))
}

/// A complete page in the project's style; title and lead are plain text, the content is HTML.
pub(crate) fn document(title: &str, lead: &str, content: &str) -> String {
    let (title, lead, style) = (escape(title), escape(lead), include_str!("style.css"));
    let [viewer_style, script, source] = viewer::parts(content);
    format!(
        "<!doctype html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n\
         <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n\
         <meta http-equiv=\"Content-Security-Policy\" content=\"{POLICY}{source}\">\n\
         <title>{title}</title>\n<style>\n{style}{viewer_style}</style>\n</head>\n<body>\n<main>\n\
         <header>\n<h1>{title}</h1>\n<p class=\"lead\">{lead}</p>\n</header>\n{content}</main>\n{script}</body>\n</html>\n"
    )
}

/// A section under its title; empty without content.
fn section(title: &str, content: &str) -> String {
    if content.is_empty() { String::new() } else { format!("<section>\n<h2>{title}</h2>\n{content}</section>\n") }
}

/// The metrics of the first method in large figures, those of the other methods below.
fn headline(methods: &[Method]) -> String {
    let rated = || methods.iter().filter_map(|m| Some((escape(m.name), m.metrics?)));
    let Some((first, metrics)) = rated().next() else { return String::new() };
    let mut html = String::from("<section class=\"cards\" aria-label=\"Main results\">\n");
    for (number, (title, unit, _)) in METRICS.iter().enumerate().filter(|(n, _)| metrics.columns()[*n].is_some()) {
        let value = &metrics.row()[number];
        let _ =
            write!(html, "<div class=\"card\"><h2>{title}</h2><p><b>{value}</b> {unit}</p><p class=\"note\">{first}");
        for (name, metrics) in rated().skip(1) {
            let _ = write!(html, "<br>{name} {}", metrics.row()[number]);
        }
        html += "</p></div>\n";
    }
    html + "</section>\n"
}

/// The viewer of the truth and of as many reconstructions as a page of a few megabytes holds.
fn volumes_to_scroll(report: &Report) -> Result<String> {
    let named = report.methods.iter().filter_map(|method| Some((method.name, method.volume?)));
    let shown: Vec<_> = report.truth.map(|truth| ("Truth", truth)).into_iter().chain(named).collect();
    let Some((_, first)) = shown.first() else { return Ok(String::new()) };
    let most = (2 * viewer::WHOLE / first.values.len().min(viewer::WHOLE)).min(viewer::MOST);
    let title = "Volumes";
    let grid = first.grid;
    let mut scene = Scene::of_volumes(title, shown.into_iter().take(most).collect(), &report.frame)?;
    if let Some((primitives, confidences)) = &report.primitives {
        scene = scene.with_primitives(primitives, &grid, confidences.clone());
    }
    let scene = scene.reduced();
    let how = "<p>Click into a picture; the wheel then goes through the slices, a drag with the right button sets the window, \
               and ? lists the keys.</p>\n";
    Ok(section(title, &format!("{how}{}", scene.html(Depth::Eight))))
}

/// The answer to whether the volume is good, and what to mind.
fn answer(report: &Report) -> String {
    let mut html = report.views.as_ref().map_or(String::new(), |(agreement, _)| agreement.verdict());
    let chosen =
        |choice: &Choice| choice.curve.iter().find(|trial| trial.value == choice.value).map(|trial| trial.error);
    if let Some(error) = report.choice.and_then(chosen) {
        let percent = short(100.0 * error);
        let _ = writeln!(html, "<p>A volume made without some views predicts them with a residual of {percent} %.</p>");
    }
    if !report.warnings.is_empty() {
        let items: String = report.warnings.iter().map(|text| format!("<li>{}</li>\n", escape(text))).collect();
        let _ = writeln!(html, "<h3>Warnings</h3>\n<ul>\n{items}</ul>");
    }
    section("Is the volume good?", &html)
}

/// Measured and rendered views, and the residual of each.
fn projections(agreement: &Agreement, scene: &Scene) -> String {
    let views: Vec<_> = agreement.views().collect();
    let percent = |residual: f64| format!("{} %", short(residual));
    let bar = |[angle, residual]: &[f64; 2]| (*residual, format!("view at {}°: {}", short(*angle), percent(*residual)));
    let step = views.len().div_ceil(MOST_TICKS).max(1);
    let tick = |number: usize| (number as f64 + 0.5, format!("{}°", views[number][0].round()));
    let highest = views.iter().map(|view| view[1]).fold(0.0, f64::max);
    let chart = Bars {
        label: "Residual of each view",
        x: "angle of the view",
        bars: views.iter().map(bar).collect(),
        highest: percent(highest),
        ticks: (0..views.len()).step_by(step).map(tick).collect(),
    };
    let bars = chart.svg().map_or(String::new(), |svg| {
        format!("<h3>Residual of each view <span>relative to its measured values</span></h3>\n{svg}\n")
    });
    let meaning = "<p>The volume contradicts the data where the difference is more than noise.</p>\n";
    section(&escape(scene.title()), &format!("{meaning}{}{bars}", scene.html(Depth::Eight)))
}

/// The commands that may follow; a click selects one.
fn next(commands: &[(String, String)]) -> String {
    let item = |(what, command): &(String, String)| {
        format!("<li>{}<pre class=\"scroll\"><code>{}</code></pre></li>\n", escape(what), escape(command))
    };
    let items: String = commands.iter().map(item).collect();
    section("What next?", &if items.is_empty() { items } else { format!("<ul class=\"next\">\n{items}</ul>\n") })
}

fn losses(curves: &[Curve]) -> String {
    let Some(chart) = chart::line_chart(curves, &LOSSES) else { return String::new() };
    let ends = curves.first().and_then(|curve| Some((escape(curve.name), curve.points.first()?, curve.points.last()?)));
    let summary = ends.map_or(String::new(), |(name, first, last)| {
        let (from, to) = (short(first.1), short(last.1));
        format!(
            "<p>On a logarithmic scale: {name} went from {from} at iteration {} to {to} at {}.</p>\n",
            first.0, last.0
        )
    });
    section("Loss", &format!("{summary}{chart}\n"))
}

/// A chart of each quantity of the primitives.
fn population(curves: &[Curve]) -> String {
    let of = |curve: &Curve| {
        let label = format!("{} over the iterations", curve.name);
        let axes = Axes { label: &label, x: "iteration", is_logarithmic: false, mark: None };
        chart::line_chart(std::slice::from_ref(curve), &axes)
    };
    let charts: String = curves.iter().filter_map(of).collect();
    let content = if charts.is_empty() { charts } else { format!("<div class=\"charts\">\n{charts}</div>\n") };
    section("Primitives over the iterations", &content)
}

/// The chart of how many primitives have which confidence.
fn confidence(histogram: &Histogram) -> String {
    let label = "Primitives by confidence";
    let total: usize = histogram.counts.iter().sum();
    let largest = histogram.counts.into_iter().max().unwrap_or(0);
    let bar = |(interval, count): (usize, usize)| {
        let (from, to) = (Histogram::start(interval), Histogram::start(interval + 1));
        (count as f64, format!("{from:.2} to {to:.2}: {count}"))
    };
    let chart = Bars {
        label,
        x: "confidence c",
        bars: histogram.counts.into_iter().enumerate().map(bar).collect(),
        highest: format!("{:.0} %", 100.0 * largest as f64 / total.max(1) as f64),
        ticks: (0..=Histogram::INTERVALS).step_by(2).map(|n| (n as f64, Histogram::start(n).to_string())).collect(),
    };
    let Some(chart) = chart.svg() else { return String::new() };
    let meaning = "<p>The part of a primitive's directions that the rays of all training views cover, 0 to 1. The height of a \
                   bar is the part of all primitives.</p>\n";
    section(label, &format!("{meaning}{chart}\n"))
}

/// The chart of held-out error over the values of a setting.
fn choice(choice: &Choice) -> String {
    let points = choice.curve.iter().map(|trial| (trial.value, trial.error)).collect();
    let axes = Axes {
        label: "Error of held-out views",
        x: &choice.key,
        is_logarithmic: choice.key != "passes",
        mark: Some(choice.value),
    };
    let Some(chart) = chart::line_chart(&[Curve { name: "error", points }], &axes) else { return String::new() };
    let (key, value) = (escape(&choice.key), short(choice.value));
    let details = choice.details();
    let text = format!(
        "<p>Residual of held-out views relative to the measured values: {key} = {value}{details} was chosen, the dashed line. \
         That took as much work as {:.0} iterations over all views.</p>\n",
        choice.cost
    );
    section(&format!("Choice of {key}"), &format!("{text}{chart}\n"))
}

/// All metrics of all methods; the best of each column in bold.
fn metrics_table(methods: &[Method]) -> String {
    let rated: Vec<(&str, &Metrics)> = methods.iter().filter_map(|m| Some((m.name, m.metrics?))).collect();
    let (mut head, mut meanings) = (String::new(), String::new());
    let mut columns = Vec::new();
    for (number, (title, unit, meaning)) in METRICS.iter().enumerate() {
        let Some(metric) = rated.iter().find_map(|(_, metrics)| metrics.columns()[number]) else { continue };
        let _ = write!(head, "<th>{title} {unit}<br><code>{}</code></th>", escape(&metric.definition));
        let _ = write!(meanings, " {title}: {meaning}.");
        let value = move |metrics: &Metrics| metrics.columns()[number].map_or(f64::NAN, |metric| metric.value);
        let best = rated.iter().map(|(_, metrics)| value(metrics)).fold(f64::NEG_INFINITY, f64::max);
        columns.push(move |metrics: &Metrics| {
            let cell = &metrics.row()[number];
            if value(metrics) == best { format!("<td><b>{cell}</b></td>") } else { format!("<td>{cell}</td>") }
        });
    }
    if columns.is_empty() {
        return String::new();
    }
    let row = |&(name, metrics): &(&str, &Metrics)| {
        let cells: String = columns.iter().map(|cell| cell(metrics)).collect();
        format!("<tr><th>{}</th>{cells}</tr>\n", escape(name))
    };
    let body: String = rated.iter().map(row).collect();
    let table = format!(
        "<div class=\"scroll\"><table>\n<thead><tr><th>method</th>{head}</tr></thead>\n<tbody>\n{body}</tbody></table></div>\n\
         <p class=\"note\">Higher is better, the best is bold.{meanings}</p>\n"
    );
    section("Metrics", &table)
}

fn facts(facts: &[(String, String)]) -> String {
    let table = if facts.is_empty() { String::new() } else { rows(facts.iter().map(|(label, value)| (label, value))) };
    section("Run", &table)
}

fn provenance(provenance: &Provenance) -> String {
    let mut html = String::from("<p>The same inputs, seeds and version give the same digests on every machine.</p>\n");
    html += &rows(provenance.facts().iter().map(|(label, value)| (label, value)));
    for (what, digests) in [("inputs", &provenance.inputs), ("outputs", &provenance.outputs)] {
        if !digests.is_empty() {
            let (number, table) = (digests.len(), rows(digests.iter()));
            let _ = writeln!(html, "<details><summary>SHA-256 of {number} {what}</summary>\n{table}</details>");
        }
    }
    section("Provenance", &html)
}

/// An HTML table of labels and values.
fn rows<'a>(rows: impl Iterator<Item = (&'a String, &'a String)>) -> String {
    let row =
        |(label, value): (&String, &String)| format!("<tr><th>{}</th><td>{}</td></tr>\n", escape(label), escape(value));
    format!("<table class=\"facts\">\n{}</table>\n", rows.map(row).collect::<String>())
}

/// Text escaped for HTML content and attributes.
pub(crate) fn escape(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}

#[cfg(test)]
mod tests;
