//! A line chart as inline SVG with a logarithmic y axis; each line is labelled at its end.
//!
//! Colours are CSS variables of the page, so the chart follows its light and dark mode.

use super::escape;
use super::slice::{short, significant};
use crate::numeric::elementary::{log10, pow};
use std::fmt::Write;

/// The x axis and its labels.
#[derive(Clone, Copy, Debug)]
pub(super) struct Axes<'a> {
    /// Description of the chart for screen readers.
    pub(super) label: &'a str,
    /// Label of the x axis.
    pub(super) x: &'a str,
    /// Whether it is logarithmic.
    pub(super) is_logarithmic: bool,
    /// Position of a dashed vertical line.
    pub(super) mark: Option<f64>,
}

/// A quantity over the iterations.
#[derive(Clone, Debug, PartialEq)]
pub struct Curve<'a> {
    /// Its name.
    pub name: &'a str,
    /// (iteration, value); values that are not above 0 are left out of the logarithmic chart.
    pub points: Vec<(f64, f64)>,
}

const WIDTH: f64 = 640.0;
const HEIGHT: f64 = 300.0;
/// Inner margins: left, right (for the labels), top, bottom.
const MARGIN: [f64; 4] = [52.0, 100.0, 12.0, 40.0];
/// Smallest distance between two labels.
const LINE_HEIGHT: f64 = 16.0;
/// Number of colours in the page's style.
const COLOURS: usize = 6;

/// The chart; `None` if there is nothing to draw.
pub(super) fn line_chart(curves: &[Curve], axes: &Axes<'_>) -> Option<String> {
    let across = |x: f64| if axes.is_logarithmic { log10(x) } else { x };
    let visible = |&&(x, y): &&(f64, f64)| x.is_finite() && y.is_finite() && y > 0.0;
    let points = || curves.iter().flat_map(|curve| curve.points.iter().filter(visible));
    let (x_min, x_max) = match range(points().map(|p| across(p.0)))? {
        // A choice of which all but one value was given has one point.
        (low, high) if low == high => (low - 0.5, high + 0.5),
        ends => ends,
    };
    let (y_min, y_max) = range(points().map(|p| log10(p.1)))?;
    let (y_min, y_max) = (y_min - 0.05, y_max + 0.05);
    let [left, right, top, bottom] = MARGIN;
    let x = |value: f64| left + (across(value) - x_min) / (x_max - x_min).max(1e-9) * (WIDTH - left - right);
    let y = |log: f64| HEIGHT - bottom - (log - y_min) / (y_max - y_min) * (HEIGHT - top - bottom);

    let mut svg = format!(
        "<svg class=\"chart\" viewBox=\"0 0 {WIDTH} {HEIGHT}\" role=\"img\" aria-label=\"{}\">",
        escape(axes.label)
    );
    for value in logarithmic_ticks(y_min, y_max) {
        let (at, edge) = (y(log10(value)), WIDTH - right);
        let _ = write!(svg, "<path class=\"grid\" d=\"M{left} {at:.1}H{edge}\"/>");
        let _ = write!(
            svg,
            "<text x=\"{:.1}\" y=\"{:.1}\" text-anchor=\"end\">{}</text>",
            left - 8.0,
            at + 4.0,
            short(value)
        );
    }
    let floor = HEIGHT - bottom;
    let ticks = if axes.is_logarithmic { logarithmic_ticks(x_min, x_max) } else { linear_ticks(x_min, x_max) };
    for value in ticks {
        let at = x(value);
        let _ = write!(svg, "<path class=\"grid\" d=\"M{at:.1} {floor}v5\"/>");
        let _ =
            write!(svg, "<text x=\"{at:.1}\" y=\"{:.1}\" text-anchor=\"middle\">{}</text>", floor + 18.0, short(value));
    }
    let middle = (left + WIDTH - right) / 2.0;
    let _ = write!(svg, "<text x=\"{middle}\" y=\"{}\" text-anchor=\"middle\">{}</text>", HEIGHT - 4.0, escape(axes.x));
    if let Some(at) = axes.mark.map(x) {
        let _ = write!(svg, "<path class=\"grid\" stroke-dasharray=\"4 4\" d=\"M{at:.1} {top}V{floor}\"/>");
    }

    let mut names = Vec::new();
    for (number, curve) in curves.iter().enumerate() {
        let line: Vec<String> =
            curve.points.iter().filter(visible).map(|p| format!("{:.1} {:.1}", x(p.0), y(log10(p.1)))).collect();
        let Some(last) = curve.points.iter().rfind(visible) else { continue };
        let colour = number % COLOURS;
        let _ = write!(svg, "<path class=\"line c{colour}\" d=\"M{}\"/>", line.join("L"));
        // A browser shows the title of the point under the pointer.
        for point in curve.points.iter().filter(visible) {
            let (at, height) = (x(point.0), y(log10(point.1)));
            let (name, axis) = (escape(curve.name), escape(axes.x));
            let (place, value) = (significant(point.0, 5), significant(point.1, 4));
            let _ = write!(
                svg,
                "<circle class=\"point c{colour}\" cx=\"{at:.1}\" cy=\"{height:.1}\" r=\"7\">\
                 <title>{name} at {axis} {place}: {value}</title></circle>"
            );
        }
        names.push((y(log10(last.1)), colour, curve.name));
    }
    names.sort_by(|a, b| a.0.total_cmp(&b.0));
    let mut free = f64::NEG_INFINITY;
    for (at, colour, name) in names {
        let at = at.max(free);
        free = at + LINE_HEIGHT;
        let (x, y) = (WIDTH - right + 8.0, at + 4.0);
        let _ = write!(svg, "<text class=\"name c{colour}\" x=\"{x}\" y=\"{y:.1}\">{}</text>", escape(name));
    }
    svg.push_str("</svg>");
    Some(svg)
}

fn range(values: impl Iterator<Item = f64>) -> Option<(f64, f64)> {
    values.fold(None, |range, v| Some(range.map_or((v, v), |(low, high): (f64, f64)| (low.min(v), high.max(v)))))
}

/// Ticks at 1, 2, 5 times powers of ten, or at powers only if that gives more than six ticks. Less than a third of a decade
/// has evenly spaced values.
fn logarithmic_ticks(low: f64, high: f64) -> Vec<f64> {
    let decades = low.floor() as i32..=high.floor() as i32;
    let ticks = |steps: &[f64]| -> Vec<f64> {
        let all = decades.clone().flat_map(|decade| steps.iter().map(move |step| step * pow(10.0, f64::from(decade))));
        all.filter(|&tick| (low..=high).contains(&log10(tick))).collect()
    };
    let fine = ticks(&[1.0, 2.0, 5.0]);
    match fine.len() {
        0..=1 => round_values(pow(10.0, low), pow(10.0, high)),
        2..=6 => fine,
        _ => ticks(&[1.0]),
    }
}

/// Three to seven multiples of 1, 2 or 5 times a power of ten.
fn round_values(low: f64, high: f64) -> Vec<f64> {
    let decade = log10((high - low).max(f64::MIN_POSITIVE)).floor();
    // Divisions by whole numbers: the ticks are the doubles nearest to their decimals.
    let steps = [5.0, 2.0, 1.0].map(|part| part * pow(10.0, -decade));
    let per_unit = steps.into_iter().find(|per_unit| (high - low) * per_unit <= 6.0);
    let per_unit = per_unit.unwrap_or(0.5 * pow(10.0, -decade));
    let first = (low * per_unit).ceil();
    (0..).map(|i| (first + f64::from(i)) / per_unit).take_while(|&tick| tick <= high).collect()
}

/// Three to seven ticks at round integers, since they count iterations.
fn linear_ticks(low: f64, high: f64) -> Vec<f64> {
    let span = (high - low).max(1.0);
    let decade = pow(10.0, log10(span).floor());
    let step = [0.2, 0.5, 1.0].map(|part| part * decade).into_iter().find(|step| span / step <= 6.0);
    let step = step.unwrap_or(2.0 * decade).max(1.0);
    (0..).map(|i| ((low / step).ceil() + f64::from(i)) * step).take_while(|&tick| tick <= high).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    const AXES: Axes<'static> = Axes { label: "", x: "", is_logarithmic: false, mark: None };

    #[test]
    fn ticks_are_round_numbers_inside_the_range() {
        assert_eq!(linear_ticks(0.0, 5000.0), [0., 1000., 2000., 3000., 4000., 5000.]);
        assert_eq!(linear_ticks(100.0, 1000.0), [200., 400., 600., 800., 1000.]);
        assert_eq!(logarithmic_ticks(-2.0, -0.5), [0.01, 0.02, 0.05, 0.1, 0.2]);
        assert_eq!(logarithmic_ticks(-3.2, 1.1).len(), 5);
        // Ranges with fewer than two of these: 0.018 to 0.032, 0.0628 to 0.0661, and 4.0 to 4.4.
        assert_eq!(logarithmic_ticks(log10(0.018), log10(0.032)), [0.02, 0.025, 0.03]);
        assert_eq!(logarithmic_ticks(log10(0.0628), log10(0.0661)), [0.063, 0.064, 0.065, 0.066]);
        assert_eq!(logarithmic_ticks(log10(3.99), log10(4.41)), [4.0, 4.1, 4.2, 4.3, 4.4]);
    }

    #[test]
    fn a_single_point_is_in_the_middle() {
        for is_logarithmic in [false, true] {
            let curve = Curve { name: "error", points: vec![(1e-3, 0.03)] };
            let svg = line_chart(&[curve], &Axes { is_logarithmic, mark: Some(1e-3), ..AXES }).unwrap();
            assert!(svg.contains(&format!("cx=\"{:.1}\"", (MARGIN[0] + WIDTH - MARGIN[1]) / 2.0)), "{svg}");
            assert!(svg.len() < 2000, "{} ticks", svg.matches("v5").count());
        }
    }

    #[test]
    fn a_line_falls_as_its_values_do_and_bears_its_name() {
        let curves = [Curve { name: "L1 & more", points: vec![(0.0, 1.0), (50.0, 0.1), (100.0, 0.0), (200.0, 0.01)] }];
        let svg = line_chart(&curves, &AXES).unwrap();
        assert!(svg.contains("L1 &amp; more</text>"));
        let line = svg.split("class=\"line c0\" d=\"M").nth(1).unwrap().split('"').next().unwrap();
        let heights: Vec<f64> = line.split('L').map(|p| p.split(' ').nth(1).unwrap().parse().unwrap()).collect();
        assert_eq!(heights.len(), 3);
        assert!(heights.is_sorted());
    }

    #[test]
    fn a_point_states_its_value() {
        let curve = Curve { name: "a & b", points: vec![(10.0, 0.123_456), (20.0, f64::NAN)] };
        let svg = line_chart(&[curve], &Axes { x: "iteration", ..AXES }).unwrap();
        assert_eq!(svg.matches("<circle class=\"point c0\"").count(), 1);
        assert!(svg.contains("<title>a &amp; b at iteration 10: 0.1235</title>"), "{svg}");
    }

    #[test]
    fn names_of_lines_that_end_together_do_not_overlap() {
        let curve = |name| Curve { name, points: vec![(0.0, 1.0), (1.0, 0.5)] };
        let svg = line_chart(&[curve("a"), curve("b")], &AXES).unwrap();
        let heights: Vec<f64> = svg
            .split("class=\"name")
            .skip(1)
            .map(|t| t.split("y=\"").nth(1).unwrap().split('"').next().unwrap().parse().unwrap())
            .collect();
        within!(LINE_HEIGHT - (heights[1] - heights[0]), "{heights:?}");
    }

    #[test]
    fn nothing_to_draw_gives_no_chart() {
        assert_eq!(line_chart(&[], &AXES), None);
        assert_eq!(line_chart(&[Curve { name: "zero", points: vec![(1.0, 0.0), (2.0, f64::NAN)] }], &AXES), None);
    }
}
