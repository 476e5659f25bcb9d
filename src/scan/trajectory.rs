//! The poses of a scan in words.

use glam::DVec3;
use trgs_core::geometry::{Projections, Scanner, View};
use trgs_core::numeric::elementary::{asin, atan2};

/// How the poses of a scan differ from the circle, in words; `None` for a circle.
pub fn words(scanner: &Scanner, projections: &Projections) -> Option<String> {
    projections.poses.as_ref()?;
    let views = projections.trajectory().views(scanner);
    let range = |name: &str, of: &dyn Fn(&View) -> f64| {
        let values: Vec<f64> = views.iter().map(of).collect();
        let (low, high) = values.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), &x| (l.min(x), h.max(x)));
        // Rounding is not worth a word.
        let near = 1e-9 * scanner.beam.dso();
        let [low, high] = [low, high].map(|x| if x.abs() <= near { 0.0 } else { x });
        match high - low <= near {
            true => format!("{name} {}", short(low)),
            false => format!("{name} {} to {}", short(low), short(high)),
        }
    };
    // The u of the plain view in the direction w.
    let along_u = |view: &View| DVec3::new(view.w.y, -view.w.x, 0.0).normalize_or_zero();
    let parts = [
        range("source at height", &|view| view.source.z),
        range("axis shift", &|view| view.source.dot(along_u(view))),
        range("detector offset u", &|view| view.detector.offset_u),
        range("v", &|view| view.detector.offset_v),
        range("roll", &|view| atan2(0.0 - view.u.z, 0.0 - view.v.z).to_degrees()) + "°",
        range("tilt", &|view| asin(view.w.z.clamp(-1.0, 1.0)).to_degrees()) + "°",
    ];
    Some(parts.join(", "))
}

/// A number with about six significant digits.
fn short(value: f64) -> String {
    if value != 0.0 && !(1e-3..1e6).contains(&value.abs()) {
        return format!("{value:.4e}");
    }
    let text = format!("{value:.6}");
    text.trim_end_matches('0').trim_end_matches('.').into()
}
