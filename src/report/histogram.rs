//! A chart of bars: primitives by confidence, or residuals of views.

use super::escape;
use std::fmt::Write;

const WIDTH: f64 = 640.0;
const HEIGHT: f64 = 200.0;
/// Inner margins: left, right, top, bottom.
const MARGIN: [f64; 4] = [52.0, 12.0, 16.0, 40.0];
/// Widest gap between two bars.
const GAP: f64 = 2.0;

/// Bars of equal width.
pub(super) struct Bars<'a> {
    pub(super) label: &'a str,
    /// The label of the horizontal axis.
    pub(super) x: &'a str,
    /// Height and description of each bar.
    pub(super) bars: Vec<(f64, String)>,
    /// The height of the tallest bar in words.
    pub(super) highest: String,
    /// Numbers below the axis, and their places in bars from the left.
    pub(super) ticks: Vec<(f64, String)>,
}

impl Bars<'_> {
    /// The chart; `None` without any bar.
    pub(super) fn svg(&self) -> Option<String> {
        let tallest = self.bars.iter().map(|(height, _)| *height).fold(0.0, f64::max);
        if tallest == 0.0 {
            return None;
        }
        let [left, right, top, bottom] = MARGIN;
        let (floor, step) = (HEIGHT - bottom, (WIDTH - left - right) / self.bars.len() as f64);
        let label = escape(self.label);
        let mut svg =
            format!("<svg class=\"chart\" viewBox=\"0 0 {WIDTH} {HEIGHT}\" role=\"img\" aria-label=\"{label}\">");
        let _ = write!(svg, "<path class=\"grid\" d=\"M{left} {floor}H{}\"/>", WIDTH - right);
        let (x, y) = (left - 8.0, top + 4.0);
        let _ = write!(svg, "<text x=\"{x:.1}\" y=\"{y:.1}\" text-anchor=\"end\">{}</text>", escape(&self.highest));
        let gap = GAP.min(0.2 * step);
        for (number, (value, title)) in self.bars.iter().enumerate().filter(|(_, (height, _))| *height > 0.0) {
            let (at, height) = (left + step * number as f64 + gap / 2.0, (floor - top) * value / tallest);
            let _ = write!(
                svg,
                "<rect class=\"bar\" x=\"{at:.1}\" y=\"{:.1}\" width=\"{:.1}\" height=\"{height:.1}\"><title>{}</title></rect>",
                floor - height,
                step - gap,
                escape(title)
            );
        }
        for (place, words) in &self.ticks {
            let (at, y) = (left + step * place, floor + 16.0);
            let _ = write!(svg, "<text x=\"{at:.1}\" y=\"{y:.1}\" text-anchor=\"middle\">{}</text>", escape(words));
        }
        let (middle, y) = ((left + WIDTH - right) / 2.0, HEIGHT - 4.0);
        let _ = write!(svg, "<text x=\"{middle}\" y=\"{y}\" text-anchor=\"middle\">{}</text></svg>", escape(self.x));
        Some(svg)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn chart(heights: &[f64]) -> Option<String> {
        let bars = heights.iter().map(|&height| (height, format!("{height} & more"))).collect();
        Bars { label: "b & more", x: "x & more", bars, highest: "67 %".into(), ticks: vec![(2.0, "two".into())] }.svg()
    }

    #[test]
    fn the_tallest_bar_fills_the_chart_and_empty_ones_are_left_out() {
        let svg = chart(&[2.0, 0.0, 1.0, 0.0]).unwrap();
        assert_eq!(svg.matches("<rect").count(), 2);
        let full = HEIGHT - MARGIN[2] - MARGIN[3];
        for text in [
            format!("height=\"{full:.1}\""),
            format!("height=\"{:.1}\"", full / 2.0),
            "<title>1 &amp; more</title>".into(),
            "67 %".into(),
            "x &amp; more".into(),
            // The second of four bars ends in the middle.
            format!("<text x=\"{:.1}\" y=\"176.0\" text-anchor=\"middle\">two", (MARGIN[0] + WIDTH - MARGIN[1]) / 2.0),
        ] {
            assert_eq!(svg.matches(&text).count(), 1, "{text} in {svg}");
        }
    }

    #[test]
    fn nothing_counted_gives_no_chart() {
        assert_eq!([chart(&[]), chart(&[0.0])], [None, None]);
    }
}
