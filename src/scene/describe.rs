//! A readable summary of a dataset, with remarks on anything unusual.

use super::arrays::{Projections, Volume};
use super::dataset::Dataset;
use super::geometry::{Beam, Scanner, View};
use super::{noise::Noise, trilinear};
use crate::error::Result;
use crate::numeric::elementary::{asin, atan2};
use crate::numeric::reduce;
use crate::words::{counted, verb};
use glam::DVec3;
use ndarray::{Array3, Axis};
use std::f64::consts::TAU;

/// Mean of a detector border, relative to the maximum, from which the object counts as cut off.
const CUT_OFF: f64 = 0.02;
/// Relative RMS difference between measured and computed projections that is remarked on.
///
/// Coarse voxels alone cause a tenth.
const DISAGREEMENT: f64 = 0.25;

/// A line of the summary.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct DescriptionLine {
    /// Name of the property.
    pub name: String,
    /// Its value.
    pub value: String,
    /// What is unusual about it; mostly empty.
    pub remark: String,
}

fn line(name: impl Into<String>, value: impl Into<String>, remark: impl Into<String>) -> DescriptionLine {
    DescriptionLine { name: name.into(), value: value.into(), remark: remark.into() }
}

/// Sizes, units, views, value ranges and oddities of a dataset, in a fixed order.
///
/// With a true volume, a few of its projections are computed and compared with the training views: this detects wrong
/// units, flipped axes and a reversed rotation.
///
/// # Errors
/// None for a dataset that was read or simulated.
pub fn describe(dataset: &Dataset) -> Result<Vec<DescriptionLine>> {
    let mut rows = vec![line("name", &dataset.name, "")];
    rows.extend(scanner_rows(&dataset.scanner));
    rows.extend(pose_row(&dataset.scanner, &dataset.train));
    rows.push(line("unit", dataset.frame.words(), ""));
    rows.extend(view_rows("training", &dataset.train));
    if let Some(test) = &dataset.test {
        rows.extend(view_rows("test", test));
    }
    let noise = match dataset.noise {
        Noise::None => "none stated".into(),
        Noise::Counts { photons, sigma, .. } => {
            format!("{photons} photons per pixel, σ {sigma} counts ({})", dataset.noise)
        }
    };
    rows.push(line("noise", noise, ""));
    match &dataset.truth {
        None => rows.push(line("true volume", "none", "results can only be judged by projections")),
        Some(truth) => {
            let (low, mean, high) = range(&truth.values);
            let mut remarks = Vec::new();
            if low < 0.0 {
                remarks.push(counted(truth.values.iter().filter(|v| **v < 0.0).count(), "negative voxel"));
            }
            if high > 1.0 {
                remarks.push("above 1, which PSNR takes as the peak".into());
            } else if high > 0.0 && high < 0.5 {
                remarks.push("far below 1, which PSNR takes as the peak".into());
            }
            rows.push(line("true values", span(low, mean, high), remarks.join("; ")));
            rows.push(agreement(&dataset.scanner, truth, &dataset.train)?);
        }
    }
    if let Some(points) = &dataset.initial_points {
        let (min, max) = (dataset.scanner.grid.min, dataset.scanner.grid.max());
        let outside = |p: &ndarray::ArrayView1<'_, f64>| (0..3).any(|i| p[i] < min[i] || p[i] > max[i]);
        let count = points.rows().into_iter().filter(outside).count();
        let remark = if count > 0 { format!("{count} outside of the volume") } else { String::new() };
        rows.push(line("initial points", points.nrows().to_string(), remark));
    }
    rows.extend(dataset.notes.iter().map(|note| line("note", note, "")));
    rows.extend(dataset.oddities.iter().map(|oddity| line("oddity", "", oddity)));
    Ok(rows)
}

fn scanner_rows(scanner: &Scanner) -> [DescriptionLine; 4] {
    let Scanner { beam, detector: d, grid } = scanner;
    let beam = match *beam {
        Beam::Cone { dso, dsd } => {
            format!("cone, DSO {}, DSD {}, magnification {}", short(dso), short(dsd), short(dsd / dso))
        }
        Beam::Parallel { .. } => "parallel".into(),
    };
    let (height, width) = (d.rows as f64 * d.pitch_v, d.columns as f64 * d.pitch_u);
    let size = format!("{} × {} pixels [v, u], {} × {} scene units", d.rows, d.columns, short(height), short(width));
    let offset = format!("[{}, {}] along [u, v]", short(d.offset_u), short(d.offset_v));
    let voxels = format!("{:?} voxels [x, y, z] of {}, from {} to {}", grid.shape, grid.spacing, grid.min, grid.max());
    let s = grid.spacing;
    let uneven = s.max_element() > s.min_element() * (1.0 + 1e-6);
    [
        line("beam", beam, ""),
        line("detector", size, ""),
        line("detector offset", offset, ""),
        line("volume", voxels, if uneven { "voxels are no cubes" } else { "" }),
    ]
}

/// What the poses of the views are; `None` for a circle.
fn pose_row(scanner: &Scanner, views: &Projections) -> Option<DescriptionLine> {
    let remark = "";
    trajectory_words(scanner, views).map(|words| line("poses", words, remark))
}

/// How the poses of a scan differ from the circle, in words; `None` for a circle.
pub fn trajectory_words(scanner: &Scanner, projections: &Projections) -> Option<String> {
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

fn view_rows(kind: &str, views: &Projections) -> [DescriptionLine; 2] {
    let angles = &views.angles;
    let fold = |from: f64, pick: fn(f64, f64) -> f64| angles.iter().fold(from, |a, &b| pick(a, b)).to_degrees();
    let (first, last) = (fold(f64::INFINITY, f64::min), fold(f64::NEG_INFINITY, f64::max));
    let mut sorted: Vec<f64> = angles.iter().map(|angle| angle.rem_euclid(TAU)).collect();
    sorted.sort_by(f64::total_cmp);
    sorted.push(sorted[0] + TAU);
    let gaps = || sorted.windows(2).map(|pair| pair[1] - pair[0]);
    let largest = gaps().fold(0.0, f64::max);
    let mut remarks = Vec::new();
    if kind == "training" && largest > 2.5 * TAU / views.len() as f64 {
        remarks.push(format!("no view for {:.1}°", largest.to_degrees()));
    }
    let repeated = gaps().filter(|gap| *gap < 1e-6).count();
    if repeated > 0 && views.len() > 1 && views.poses.is_none() {
        remarks.push(format!("{} {} again", counted(repeated, "angle"), verb(repeated, "occurs", "occur")));
    }
    let value = format!("{}, {first:.2}° to {last:.2}°, largest gap {:.2}°", views.len(), largest.to_degrees());
    let count = line(format!("{kind} views"), value, remarks.join("; "));

    let (low, mean, high) = range(&views.images);
    let mut remarks = Vec::new();
    let negative = views.images.iter().filter(|p| **p < 0.0).count();
    if negative > 0 {
        remarks.push(counted(negative, "negative pixel"));
    }
    let [_, rows, columns] = [0, 1, 2].map(|axis| views.images.len_of(Axis(axis)));
    for (side, axis, index) in [("top", 1, 0), ("bottom", 1, rows - 1), ("left", 2, 0), ("right", 2, columns - 1)] {
        let border = views.images.index_axis(Axis(axis), index);
        if f64::from(border.mean().unwrap_or(0.0)) > CUT_OFF * high {
            remarks.push(format!("the object seems cut off at the {side}"));
        }
    }
    if high <= 0.0 {
        remarks.push("all pixels are zero".into());
    }
    [count, line(format!("{kind} values"), span(low, mean, high), remarks.join("; "))]
}

/// Compares the training views with projections of the true volume.
fn agreement(scanner: &Scanner, truth: &Volume, train: &Projections) -> Result<DescriptionLine> {
    let n = train.len();
    // Three views, not a quarter turn apart: those could hide a mirrored volume.
    let measured = train.select(&[n / 9, n / 3 + n / 12, 3 * n / 4].map(|i: usize| i.min(n - 1)));
    let computed = trilinear::project(truth, scanner, &measured)?;
    let reversed: Vec<f64> = measured.angles.iter().map(|angle| -angle).collect();
    let flipped = |axes: &[usize]| {
        let mut images = computed.images.clone();
        axes.iter().for_each(|axis| images.invert_axis(Axis(*axis)));
        images
    };
    let mut candidates = vec![
        ("", computed.images.clone()),
        ("reversed rows", flipped(&[1])),
        ("reversed columns", flipped(&[2])),
        ("reversed rows and columns", flipped(&[1, 2])),
    ];
    if measured.poses.is_none() {
        candidates.push(("the opposite sense of rotation", trilinear::project(truth, scanner, &reversed)?.images));
    }
    let (difference, factor) = fit(&measured.images, &candidates[0].1);
    let remark = if difference > DISAGREEMENT {
        let better = candidates[1..].iter().map(|(name, images)| (fit(&measured.images, images).0, name));
        let (best, name) = better.fold((difference, &""), |best, other| if other.0 < best.0 { other } else { best });
        if best < 0.5 * difference {
            format!("it would be {:.1} % with {name}", 100.0 * best)
        } else {
            "the volume does not explain the views".into()
        }
    } else if (factor - 1.0).abs() > DISAGREEMENT {
        format!("the views are {} times as large as computed: check the units", short(factor))
    } else {
        String::new()
    };
    Ok(line("views against true volume", format!("{:.2} % RMS difference", 100.0 * difference), remark))
}

/// Relative RMS difference after the best scaling, and that scaling factor.
fn fit(measured: &Array3<f32>, computed: &Array3<f32>) -> (f64, f64) {
    let (a, b): (Vec<f32>, Vec<f32>) = (measured.iter().copied().collect(), computed.iter().copied().collect());
    let dot = |a: &[f32], b: &[f32]| reduce::sum_by(a.len(), &|i| f64::from(a[i]) * f64::from(b[i]));
    let (aa, ab, bb) = (dot(&a, &a), dot(&a, &b), dot(&b, &b));
    if aa == 0.0 || bb == 0.0 {
        return if aa == bb { (0.0, 1.0) } else { (1.0, 1.0) };
    }
    ((1.0 - (ab / aa) * (ab / bb)).max(0.0).sqrt(), ab / bb)
}

/// Smallest value, mean and largest value.
fn range(values: &Array3<f32>) -> (f64, f64, f64) {
    let low = values.iter().fold(f32::INFINITY, |a, &b| if b < a { b } else { a });
    let high = values.iter().fold(f32::NEG_INFINITY, |a, &b| if b > a { b } else { a });
    let flat = values.as_slice().expect("arrays of datasets are in C order");
    (low.into(), reduce::sum(flat) / flat.len() as f64, high.into())
}

fn span(low: f64, mean: f64, high: f64) -> String {
    format!("{} to {}, mean {}", short(low), short(high), short(mean))
}

/// A number with about six significant digits.
fn short(value: f64) -> String {
    if value != 0.0 && !(1e-3..1e6).contains(&value.abs()) {
        return format!("{value:.4e}");
    }
    let text = format!("{value:.6}");
    text.trim_end_matches('0').trim_end_matches('.').into()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::phantom::Phantom;
    use crate::scene::simulate::{Object, Plan, simulate};
    use crate::scene::{Detector, Grid};

    fn scan() -> Dataset {
        let detector = Detector { rows: 40, columns: 44, pitch_v: 0.1, pitch_u: 0.09, offset_u: 0.05, offset_v: 0.0 };
        let scanner = Scanner { beam: Beam::Cone { dso: 5.0, dsd: 7.0 }, detector, grid: Grid::cube(32) };
        let plan = Plan { views: 18, test_views: 4, noise: Noise::LOW, seed: 1 };
        simulate("axes", Object::Phantom(&Phantom::by_name("axes", 0).unwrap()), &scanner, &plan).unwrap()
    }

    fn remarks(dataset: &Dataset) -> String {
        describe(dataset).unwrap().iter().map(|row| format!("{}: {}\n", row.name, row.remark)).collect()
    }

    #[test]
    fn a_sound_scan_has_no_remarks() {
        let rows = describe(&scan()).unwrap();
        assert!(rows.iter().all(|row| row.remark.is_empty()), "{rows:#?}");
        let text = format!("{rows:?}");
        for part in
            ["cone, DSO 5, DSD 7, magnification 1.4", "40 × 44 pixels", "18, 0.00° to 340.00°", "low", "[32, 32, 32]"]
        {
            assert!(text.contains(part), "{part} is missing in {text}");
        }
    }

    #[test]
    fn wrong_orders_signs_and_units_are_found() {
        let mut scan = scan();
        let good = scan.train.clone();
        scan.train.images.invert_axis(Axis(1));
        scan.train.images = scan.train.images.as_standard_layout().into_owned();
        assert!(remarks(&scan).contains("with reversed rows\n"), "{}", remarks(&scan));
        scan.train = good.clone();
        scan.train.angles.iter_mut().for_each(|angle| *angle = -*angle);
        assert!(remarks(&scan).contains("with the opposite sense of rotation"), "{}", remarks(&scan));
        scan.train = good.clone();
        scan.train.images *= 100.0;
        assert!(remarks(&scan).contains("times as large as computed"), "{}", remarks(&scan));
        scan.train = Projections::new(good.angles.clone(), good.images.mapv(|_| 0.3)).unwrap();
        assert!(remarks(&scan).contains("does not explain"), "{}", remarks(&scan));
    }

    #[test]
    fn gaps_repetitions_truncation_and_negative_values_are_found() {
        let mut scan = scan();
        scan.train = scan.train.select(&[0, 1, 2, 3, 4, 5, 6, 7, 7]);
        scan.train.images.index_axis_mut(Axis(2), 0).fill(0.2);
        scan.train.images[[0, 20, 20]] = -1.0;
        scan.truth.as_mut().unwrap().values[[0, 0, 0]] = -0.5;
        scan.oddities.push("something else".into());
        let remarks = remarks(&scan);
        for part in [
            "no view for 220.0°",
            "1 angle occurs again",
            "cut off at the left",
            "1 negative pixel",
            "1 negative voxel",
            "oddity: something else",
        ] {
            assert!(remarks.contains(part), "{part} is missing in {remarks}");
        }
    }
}
