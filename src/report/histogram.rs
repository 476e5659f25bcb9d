//! A chart of bars: how many primitives have a confidence in each interval.

use super::escape;
use crate::confidence::Histogram;
use std::fmt::Write;

const WIDTH: f64 = 640.0;
const HEIGHT: f64 = 200.0;
/// Inner margins: left, right, top, bottom.
const MARGIN: [f64; 4] = [52.0, 12.0, 16.0, 40.0];
/// Every so many intervals have their beginning written below.
const LABELLED: usize = 2;

/// The chart; `None` if nothing is counted.
pub(super) fn bars(histogram: &Histogram, label: &str, x: &str) -> Option<String> {
    let largest = histogram.counts.into_iter().max().filter(|count| *count > 0)?;
    let total: usize = histogram.counts.iter().sum();
    let [left, right, top, bottom] = MARGIN;
    let (floor, step) = (HEIGHT - bottom, (WIDTH - left - right) / Histogram::INTERVALS as f64);
    let mut svg =
        format!("<svg class=\"chart\" viewBox=\"0 0 {WIDTH} {HEIGHT}\" role=\"img\" aria-label=\"{}\">", escape(label));
    let _ = write!(svg, "<path class=\"grid\" d=\"M{left} {floor}H{}\"/>", WIDTH - right);
    let _ = write!(
        svg,
        "<text x=\"{:.1}\" y=\"{:.1}\" text-anchor=\"end\">{:.0} %</text>",
        left - 8.0,
        top + 4.0,
        100.0 * largest as f64 / total as f64
    );
    for (interval, count) in histogram.counts.into_iter().enumerate() {
        let at = left + step * interval as f64;
        let height = (floor - top) * count as f64 / largest as f64;
        if count > 0 {
            let (from, to) = (Histogram::start(interval), Histogram::start(interval + 1));
            let _ = write!(
                svg,
                "<rect class=\"bar\" x=\"{:.1}\" y=\"{:.1}\" width=\"{:.1}\" height=\"{height:.1}\">\
                 <title>{from:.2} to {to:.2}: {count}</title></rect>",
                at + 1.0,
                floor - height,
                step - 2.0
            );
        }
    }
    for interval in (0..=Histogram::INTERVALS).step_by(LABELLED) {
        let (at, value) = (left + step * interval as f64, Histogram::start(interval));
        let _ = write!(svg, "<text x=\"{at:.1}\" y=\"{:.1}\" text-anchor=\"middle\">{value}</text>", floor + 16.0);
    }
    let middle = (left + WIDTH - right) / 2.0;
    let _ =
        write!(svg, "<text x=\"{middle}\" y=\"{}\" text-anchor=\"middle\">{}</text></svg>", HEIGHT - 4.0, escape(x));
    Some(svg)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_tallest_bar_fills_the_chart_and_empty_intervals_have_none() {
        let svg = bars(&Histogram::of(&[0.12, 0.13, 0.8]), "c & more", "c").unwrap();
        assert_eq!(svg.matches("<rect").count(), 2);
        let full = HEIGHT - MARGIN[2] - MARGIN[3];
        for (text, count) in [
            (format!("height=\"{full:.1}\""), 1),
            (format!("height=\"{:.1}\"", full / 2.0), 1),
            ("0.10 to 0.15: 2".into(), 1),
            ("67 %".into(), 1),
            ("c &amp; more".into(), 1),
        ] {
            assert_eq!(svg.matches(&text).count(), count, "{text} in {svg}");
        }
    }

    #[test]
    fn nothing_counted_gives_no_chart() {
        assert_eq!(bars(&Histogram::of(&[]), "c", "c"), None);
    }
}
