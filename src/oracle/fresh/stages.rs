//! The inputs of generated questions, stage by stage.

use super::dimensions::STAGES;
use super::draft::{Draft, ScannerFile};
use super::draw::{Draw, Kind, Row, single};
use super::large::enlarge;
use crate::manifest::{Arrays, Level};
use crate::outputs;
use ndarray::{Array, ArrayD, Dimension, IxDyn};
use serde_json::{Map, Value, json};
use std::collections::BTreeMap;
use std::f64::consts::{PI, TAU};
use trgs_core::primitives::Parameters;

/// A difference that single precision holds beside numbers below 1.
const FAINT: f64 = 1.0 / (1 << 24) as f64;

/// Question `index` of a stage: a function of its arguments alone; `huge` allows sizes that have no truth.
pub(crate) fn draft(stage: &str, seed: u64, index: u64, level: Level, huge: bool) -> Draft {
    let number = STAGES.iter().position(|name| *name == stage).expect("a stage with generated questions") as u64;
    let mut draw = Draw::new(seed, number, index, level == Level::Large, huge);
    let mut new = Draft {
        id: format!("{stage}/fresh-{seed}-{index}"),
        stage: stage.into(),
        title: String::new(),
        level,
        flags: vec![draw.kind.word().into()],
        settings: Map::new(),
        scanner: None,
        arrays: BTreeMap::new(),
    };
    fill(&mut new, &mut draw);
    new.title = format!("Generated: {}", new.flags.join(", "));
    new
}

fn fill(new: &mut Draft, draw: &mut Draw) {
    let stage = new.stage.clone();
    let stress = new.level == Level::Stress;
    match stage.as_str() {
        "kernel" => {
            let n = draw.size(1, 12);
            let far = if stress { 1e12 } else { 60.0 };
            let delta = (0..n).map(|_| if draw.chance(0.1) { 0.0 } else { draw.magnitude(1e-4, far) }).collect();
            let nu = (0..n).map(|_| nu(draw, new.level)).collect();
            put(new, "delta", numbers(delta));
            put(new, "nu", numbers(nu));
        }
        "integral-factor" => {
            let n = draw.size(1, 12);
            let nu = (0..n).map(|_| draw.magnitude(2.0, 100.0)).collect();
            put(new, "nu", numbers(nu));
        }
        "activation" | "gradient-raw" => raw(new, draw),
        "loss-l1" | "loss-ssim" | "loss-image" => images(new, draw),
        "loss-tv" => {
            let shape = match new.level {
                Level::Large => draw.pick(&[[65, 48, 33], [17, 33, 5]]),
                _ => [draw.count(1, 5), draw.count(1, 5), draw.count(1, 5)],
            };
            let block = steps(new, draw, &shape);
            let faint = stress && draw.chance(0.25);
            put(new, "block", if faint { block.mapv(|x| x * FAINT) } else { block });
        }
        "haar" | "wavelet-loss" => wavelets(new, draw),
        "nu-target" => {
            new.settings = settings(
                json!({"temperature": draw.magnitude(0.05, 1.0), "nu_range": [2.0, 100.0], "sphere_points": 64}),
            );
            let n = draw.size(1, 10);
            let c = draw.row(n, 0.0, 1.0);
            put(new, "c", numbers(c));
        }
        "loss-nu" => {
            new.settings = settings(json!({"weight": draw.magnitude(1e-4, 1.0)}));
            let n = draw.size(1, 10);
            for role in ["nu", "target"] {
                let values = (0..n).map(|_| draw.magnitude(2.0, 100.0)).collect();
                put(new, role, numbers(values));
            }
            let confidence = draw.row(n, 0.0, 1.0);
            put(new, "confidence", numbers(confidence));
        }
        "schedule" => {
            let (first, last) = (draw.magnitude(1e-4, 0.1), draw.magnitude(1e-6, 0.1));
            let length = draw.count(1, 1000);
            new.settings = settings(json!({"first": first, "last": last, "length": length}));
            let n = draw.size(1, 8);
            let steps = (0..n).map(|_| draw.count(0, length + 10) as f64).collect();
            put(new, "steps", numbers(steps));
        }
        "adam" => {
            let (n, steps) = (draw.size(1, 5), draw.count(1, if stress { 60 } else { 12 }));
            new.settings = settings(
                json!({"beta1": draw.pick(&[0.9, 0.5, 0.95]), "beta2": draw.pick(&[0.999, 0.99]), "epsilon": 1e-15}),
            );
            put(new, "start", numbers(draw.row(n, -1.0, 1.0)));
            let zero = draw.kind != Kind::Random && draw.chance(0.3);
            let size = if stress { draw.magnitude(1e-14, 1e4) } else { draw.magnitude(1e-4, 10.0) };
            let gradients =
                draw.row(n * steps, -1.0, 1.0).into_iter().map(|g| if zero { 0.0 } else { single(g * size) });
            let gradients = gradients.collect();
            put(new, "gradients", shaped(&[steps, n], gradients));
            let rates = (0..steps).map(|_| draw.magnitude(1e-4, 0.1)).collect();
            put(new, "rates", numbers(rates));
        }
        "sghmc-gate" => {
            new.settings = settings(json!({"reference": draw.magnitude(0.1, 2.0)}));
            let n = draw.size(1, 10);
            let density = (0..n).map(|_| if draw.chance(0.2) { 0.0 } else { draw.magnitude(1e-5, 1.0) }).collect();
            put(new, "density", numbers(density));
        }
        "sghmc" => sghmc(new, draw),
        _ => {
            scene(new, draw);
            if stage.starts_with("gradient") && stage != "gradient-wavelet" {
                cotangent(new, draw);
            }
            if stage == "covariance" {
                new.scanner = None;
            }
            let has_views = stage.contains("image") || stage.contains("projected") || stage == "gradient-shadow";
            if !has_views {
                new.settings.remove("angles");
            }
            if stage.ends_with("-cutoff") {
                new.settings.insert("cutoff".into(), json!(draw.pick(&[1e-3, 0.01, 1e-4])));
            }
            if stage == "image-cutoff" || stage == "gradient-shadow" {
                new.settings.insert("projection".into(), json!(draw.pick(&["exact", "affine"])));
            }
            if stage == "gradient-wavelet" {
                let scanner = new.scanner.as_mut().expect("a scene has one");
                let side = |draw: &mut Draw| draw.pick_by_level(&[2, 4], &[4, 20, 36]);
                scanner.n_voxel = [side(draw), 4, side(draw)];
                let shape = scanner.n_voxel;
                wavelet_settings(new, draw, 1);
                high(new, draw, &shape);
            }
        }
    }
}

fn settings(value: Value) -> Map<String, Value> {
    serde_json::from_value(value).expect("an object")
}

fn put(new: &mut Draft, role: &str, array: ArrayD<f64>) {
    new.arrays.insert(role.into(), Arrays::from([(String::new(), array)]));
}

fn numbers(values: Vec<f64>) -> ArrayD<f64> {
    Array::from(values).into_dyn()
}

fn shaped(shape: &[usize], values: Vec<f64>) -> ArrayD<f64> {
    ArrayD::from_shape_vec(IxDyn(shape), values).expect("as many values")
}

/// ν of a Student's t primitive.
fn nu(draw: &mut Draw, level: Level) -> f64 {
    if matches!(level, Level::Optional | Level::Stress) && draw.chance(0.2) {
        return draw.pick(if level == Level::Stress { &[1.0, 1e3, 1e4, 1e6] } else { &[1.0, 1e3] });
    }
    draw.magnitude(2.0, 100.0)
}

/// Model, scanner and angles.
fn scene(new: &mut Draft, draw: &mut Draw) {
    let cone = draw.chance(0.75);
    let dso = draw.between(3.5, 8.0);
    let dsd = single(dso * draw.between(1.2, 2.0));
    let reach = if cone { 2.0 * dsd / dso } else { 2.0 };
    let s_detector = [single(reach * draw.between(0.5, 1.8)), single(reach * draw.between(0.5, 1.8))];
    let mut s_voxel = [draw.between(0.8, 2.0), draw.between(0.8, 2.0), draw.between(0.8, 2.0)];
    s_voxel[draw.count(0, 2)] = 2.0;
    let mut scanner = ScannerFile {
        mode: if cone { "cone" } else { "parallel" }.into(),
        dso,
        dsd,
        n_detector: [draw.count(1, 7), draw.count(1, 7)],
        s_detector,
        n_voxel: [draw.count(1, 6), draw.count(1, 6), draw.count(1, 6)],
        s_voxel,
        off_origin: [draw.between(-0.2, 0.2), draw.between(-0.2, 0.2), draw.between(-0.2, 0.2)],
        off_detector: [
            single(s_detector[1] * draw.between(-0.2, 0.2)),
            single(s_detector[0] * draw.between(-0.2, 0.2)),
        ],
    };
    let views = draw.count(1, 3);
    let mut angles: Vec<f64> = (0..views).map(|_| draw.between(-PI, TAU)).collect();
    let gaussian = draw.chance(0.2);
    let count = draw.count(1, 5);
    let mut rows: Vec<Row> = (0..count).map(|_| row(draw, new.level, gaussian)).collect();
    if new.level == Level::Large {
        // Each primitive has an array or a row of its own in the other outputs.
        let most = if new.stage.starts_with("image") || new.stage.starts_with("density") { 5000 } else { 1025 };
        let more = |draw: &mut Draw| row(draw, Level::Large, gaussian);
        let word = enlarge(draw, most, more, &mut scanner, &mut angles, &mut rows);
        new.flags.push(word.into());
    } else if draw.kind == Kind::Adversarial {
        let word = trap(new.level, draw, &mut scanner, &mut angles, &mut rows);
        new.flags.push(word.into());
    }
    new.settings.insert("angles".into(), json!(angles));
    new.scanner = Some(scanner);
    new.arrays.extend(outputs::parameters("model", &parameters(&rows)));
}

pub(super) fn row(draw: &mut Draw, level: Level, gaussian: bool) -> Row {
    let mut quaternion = [(); 4].map(|()| draw.between(-1.0, 1.0));
    if quaternion.iter().all(|x| x.abs() < 0.05) {
        quaternion = [1.0, 0.0, 0.0, 0.0];
    }
    let base = draw.magnitude(0.08, 0.4);
    Row {
        mean: [(); 3].map(|()| draw.between(-0.8, 0.8)),
        scale: [(); 3].map(|()| single(base * draw.magnitude(0.5, 2.0))),
        quaternion,
        density: draw.magnitude(0.05, 3.0),
        nu: if gaussian { f64::INFINITY } else { nu(draw, level) },
    }
}

fn parameters(rows: &[Row]) -> Parameters {
    let mut all = Parameters::zeros(0);
    for row in rows {
        all.mean.push(row.mean);
        all.scale.push(row.scale);
        all.quaternion.push(row.quaternion);
        all.density.push(row.density);
        all.nu.push(row.nu);
    }
    all
}

/// Gives a scene one property that programs are known to get wrong; returns its flag.
fn trap(
    level: Level,
    draw: &mut Draw,
    scanner: &mut ScannerFile,
    angles: &mut [f64],
    rows: &mut Vec<Row>,
) -> &'static str {
    let last = rows.len() - 1;
    let traps = match level {
        Level::Core | Level::Large => 9,
        Level::Optional => 11,
        Level::Stress => 14,
    };
    match draw.count(0, traps - 1) {
        0 => {
            (scanner.n_detector, scanner.n_voxel) = ([1, draw.count(1, 3)], [1, draw.count(1, 3), 1]);
            "one-pixel"
        }
        1 => {
            rows[0].density = 0.0;
            "zero-density"
        }
        2 => {
            // Beside others a faint primitive is lost in rounding: at `stress` there is no other.
            match level {
                Level::Stress => rows.iter_mut().for_each(|row| row.density = 1e-24),
                _ => rows.push(Row { density: 1e-30, ..rows[last] }),
            }
            "tiny-density"
        }
        3 => {
            // The axis of rotation meets the middle of the detector, and a voxel's centre.
            (scanner.off_detector, scanner.off_origin) = ([0.0; 2], [0.0; 3]);
            (scanner.n_detector, scanner.n_voxel) = ([5, 3], [3; 3]);
            rows[0].mean = [0.0; 3];
            "centre-on-pixel"
        }
        4 => {
            angles[0] = 0.0;
            let shrink = if scanner.mode == "cone" { scanner.dso / scanner.dsd } else { 1.0 };
            let edge = 0.5 * scanner.s_detector[1] + scanner.off_detector[0];
            rows[0].mean = [0.0, single(edge * shrink), 0.0];
            "detector-border"
        }
        5 => {
            let norm = draw.pick(&[1e-3, 250.0, 1e-2]);
            rows.iter_mut().for_each(|row| row.quaternion = row.quaternion.map(|x| single(x * norm)));
            "unnormalised-quaternion"
        }
        6 => {
            rows.push(rows[0]);
            "equal-primitives"
        }
        7 => {
            rows.iter_mut().for_each(|row| row.nu = f64::INFINITY);
            "gaussian-limit"
        }
        8 => {
            rows.iter_mut().for_each(|row| row.nu = 2.0);
            rows[0].nu = 100.0;
            "nu-end"
        }
        9 => {
            let nu = draw.pick(&[1.0, 1e3]);
            rows.iter_mut().for_each(|row| row.nu = nu);
            "nu-outside-training-range"
        }
        10 => {
            let place = draw.pick(&[0.95, 0.985, 0.995, 1.0, 1.05]);
            // Parallel rays pass through what is behind the source, too.
            if place <= 1.0 {
                scanner.mode = "cone".into();
            }
            angles[0] = 0.0;
            rows[0].mean[0] = single(scanner.dso * place);
            "behind-source"
        }
        11 => {
            rows[0].nu = draw.pick(&[0.5, 1e4, 1e6]);
            "nu-outside-training-range"
        }
        12 => {
            rows[0].scale = [0.5, 0.0005, 0.0006];
            "ill-conditioned"
        }
        _ => {
            rows[0].scale = [0.48, 0.0005, 0.41];
            "ill-conditioned"
        }
    }
}

/// A cotangent of the shape of the image or the volume.
fn cotangent(new: &mut Draft, draw: &mut Draw) {
    let scanner = new.scanner.as_ref().expect("a scene has one");
    let views = new.settings["angles"].as_array().map_or(0, Vec::len);
    let shape = if new.stage == "gradient-density" {
        scanner.n_voxel
    } else {
        [views, scanner.n_detector[0], scanner.n_detector[1]]
    };
    let values = draw.row(shape.iter().product(), -1.0, 1.0);
    put(new, "cotangent", shaped(&shape, values));
}

/// Raw parameters, and for a gradient the scene around them.
fn raw(new: &mut Draft, draw: &mut Draw) {
    scene(new, draw);
    let model = new.arrays.remove("model").expect("a scene has one");
    let m = model["density"].len();
    let mut raw = model;
    for (key, width) in [("scale", 3), ("density", 1), ("nu", 1)] {
        let values = draw.row(m * width, -3.0, 3.0);
        let shape = raw[key].raw_dim();
        raw.insert(key.into(), shaped(shape.slice(), values));
    }
    new.arrays.insert("raw".into(), raw);
    let kernel = draw.pick(&["student_t", "student_t", "gaussian"]);
    let more = json!({"kernel": kernel, "scale_range": [0.05, 1.0], "nu_range": [2.0, 100.0]});
    new.settings.extend(settings(more));
    if new.stage == "activation" {
        new.scanner = None;
        new.settings.remove("angles");
    } else {
        cotangent(new, draw);
    }
}

/// Multiples of 1/64, so that differences are exact; sometimes equal values throughout.
fn steps(new: &mut Draft, draw: &mut Draw, shape: &[usize]) -> ArrayD<f64> {
    let constant = draw.kind == Kind::Adversarial && draw.chance(0.3);
    if constant {
        new.flags.push("zero-image".into());
    }
    let value = (draw.between(-0.5, 1.5) * 64.0).round() / 64.0;
    let n = shape.iter().product();
    let values =
        (0..n).map(|_| if constant { value } else { (draw.between(-0.5, 1.5) * 64.0).round() / 64.0 }).collect();
    shaped(shape, values)
}

/// Prediction and target: apart, close together, or partly equal.
fn images(new: &mut Draft, draw: &mut Draw) {
    let most = if new.stage == "loss-l1" { 8 } else { 14 };
    let shape = match new.level {
        Level::Large => draw.pick(&[[200, 200], [250, 190], [33, 65], [17, 31]]),
        _ => [draw.count(1, most), draw.count(1, most)],
    };
    let target = steps(new, draw, &shape).mapv(f64::abs);
    let faint = new.level == Level::Stress && new.stage == "loss-l1" && draw.chance(0.25);
    let prediction = match draw.count(0, 2) {
        _ if faint => target.mapv(|t| single(t + FAINT)),
        0 => steps(new, draw, &shape).mapv(f64::abs),
        1 => target.mapv(|t| if draw.chance(0.3) { t } else { t + (draw.between(-1.0, 1.0) * 32.0).round() / 64.0 }),
        _ => target.mapv(|t| t * 0.75 + 0.125),
    };
    put(new, "prediction", prediction);
    put(new, "target", target);
    if new.stage == "loss-image" {
        new.settings.insert("weight".into(), json!(draw.pick(&[0.25, 0.2, 0.5, 1.0])));
    }
}

fn wavelet_settings(new: &mut Draft, draw: &mut Draw, levels: usize) {
    let neighbours = draw.count(1, 8);
    new.settings = settings(json!({
        "neighbours": neighbours, "enhancement": draw.between(0.5, 2.0), "suppress": draw.between(0.1, 1.0),
        "enhance": draw.between(0.1, 1.0), "levels": levels,
    }));
}

fn high(new: &mut Draft, draw: &mut Draw, shape: &[usize]) {
    let most = new.settings["neighbours"].as_u64().expect("a count") as usize;
    let values = (0..shape.iter().product()).map(|_| draw.count(0, most) as f64).collect();
    put(new, "high", shaped(shape, values));
}

fn wavelets(new: &mut Draft, draw: &mut Draw) {
    let levels = if new.stage == "haar" { 1 } else { draw.count(1, 2) };
    let (small, large): (&[usize], &[usize]) =
        if new.stage == "haar" { (&[2, 4, 6], &[18, 34, 66]) } else { (&[4, 8], &[20, 36]) };
    let shape = [(); 3].map(|()| draw.pick_by_level(small, large));
    let values = draw.row(shape.iter().product(), -0.5, 1.5);
    put(new, "block", shaped(&shape, values));
    if new.stage == "wavelet-loss" {
        wavelet_settings(new, draw, levels);
        high(new, draw, &shape);
    }
}

fn sghmc(new: &mut Draft, draw: &mut Draw) {
    let (m, steps) = (draw.size(1, 3), draw.count(1, 6));
    new.settings = settings(json!({
        "burn_in": draw.count(0, steps), "burn_in_friction": draw.between(10.0, 60.0), "friction": draw.between(10.0, 60.0),
    }));
    put(new, "start", shaped(&[m, 3], draw.row(3 * m, -1.0, 1.0)));
    put(new, "directions", shaped(&[steps, m, 3], draw.row(3 * m * steps, -1.0, 1.0)));
    put(new, "noise", shaped(&[steps, m, 3], draw.row(3 * m * steps, -2.0, 2.0)));
    put(new, "gates", numbers(draw.row(m, 0.0, 1.0)));
    let rows: Vec<Row> = (0..m).map(|_| row(draw, Level::Core, false)).collect();
    let all = parameters(&rows);
    let covariance = (0..m).flat_map(|i| all.covariance(i).to_cols_array()).map(single).collect();
    put(new, "covariance", shaped(&[m, 3, 3], covariance));
    put(new, "rates", numbers((0..steps).map(|_| draw.magnitude(1e-4, 1e-2)).collect()));
}
