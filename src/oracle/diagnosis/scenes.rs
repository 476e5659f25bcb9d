//! Mistakes whose result is found by recomputing the question with one change.

use super::Suspect;
use crate::config::Precision;
use crate::error::Result;
use crate::numeric::elementary::{exp, log, log1p};
use crate::oracle::answers::answer;
use crate::oracle::format::Format;
use crate::oracle::outputs::Outputs;
use crate::oracle::question::Question;
use crate::primitives::{KernelKind, Parameters, Primitives, gaussian, student_t};
use crate::scene::{Detector, Scanner};
use ndarray::{Array1, Array2, Array4, ArrayD, Axis, Ix2};
use serde_json::json;
use std::f64::consts::PI;

/// A change of a question.
type Change = fn(&mut Question) -> Result<()>;

const OF_VIEWS: [(&str, Change); 15] = [
    ("a half-pixel shift in u towards lower columns", |q| detector(q, |d| d.offset_u += 0.5 * d.pitch_u)),
    ("a half-pixel shift in u towards higher columns", |q| detector(q, |d| d.offset_u -= 0.5 * d.pitch_u)),
    ("a half-pixel shift in v towards lower rows", |q| detector(q, |d| d.offset_v += 0.5 * d.pitch_v)),
    ("a half-pixel shift in v towards higher rows", |q| detector(q, |d| d.offset_v -= 0.5 * d.pitch_v)),
    ("a half-pixel shift in u and v towards lower indices", |q| {
        detector(q, |d| (d.offset_u, d.offset_v) = (d.offset_u + 0.5 * d.pitch_u, d.offset_v + 0.5 * d.pitch_v))
    }),
    ("a half-pixel shift in u and v towards higher indices", |q| {
        detector(q, |d| (d.offset_u, d.offset_v) = (d.offset_u - 0.5 * d.pitch_u, d.offset_v - 0.5 * d.pitch_v))
    }),
    ("the detector's offset ignored", |q| detector(q, |d| (d.offset_u, d.offset_v) = (0.0, 0.0))),
    ("the detector's offset with the opposite sign", |q| {
        detector(q, |d| (d.offset_u, d.offset_v) = (-d.offset_u, -d.offset_v))
    }),
    ("the detector's offset along v counted down the rows", |q| detector(q, |d| d.offset_v = -d.offset_v)),
    ("the detector's offset read as [v, u]", |q| {
        detector(q, |d| (d.offset_u, d.offset_v) = (-d.offset_v, -d.offset_u))
    }),
    ("the pixel sizes of u and v exchanged", |q| detector(q, |d| (d.pitch_u, d.pitch_v) = (d.pitch_v, d.pitch_u))),
    ("the opposite sense of rotation", |q| angles(q, |angle| -angle)),
    ("source and detector on each other's side", |q| angles(q, |angle| angle + PI)),
    ("angles taken for degrees", |q| angles(q, |angle| angle * PI / 180.0)),
    ("the other projection: affine for exact, or exact for affine", |q| {
        let (from, to) = if q.stage.ends_with("affine") { ("affine", "exact") } else { ("exact", "affine") };
        q.stage = q.stage.replace(from, to);
        Ok(())
    }),
];

const OF_VOLUMES: [(&str, Change); 5] = [
    ("a half-voxel shift along x", |q| grid(q, |s| s.grid.min.x -= 0.5 * s.grid.spacing.x)),
    ("a half-voxel shift along y", |q| grid(q, |s| s.grid.min.y -= 0.5 * s.grid.spacing.y)),
    ("a half-voxel shift along z", |q| grid(q, |s| s.grid.min.z -= 0.5 * s.grid.spacing.z)),
    ("voxel corners for voxel centres", |q| grid(q, |s| s.grid.min -= 0.5 * s.grid.spacing)),
    ("the volume's offset ignored", |q| {
        grid(q, |s| {
            let shape = glam::DVec3::from_array(s.grid.shape.map(|n| n as f64));
            s.grid.min = -0.5 * shape * s.grid.spacing;
        })
    }),
];

const OF_MODELS: [(&str, Change); 5] = [
    ("quaternions read as (x, y, z, w)", |q| {
        model(q, |p| p.quaternion.iter_mut().for_each(|[w, x, y, z]| (*w, *x, *y, *z) = (*z, *w, *x, *y)))
    }),
    ("the inverse rotation", |q| model(q, |p| p.quaternion.iter_mut().for_each(|quaternion| quaternion[0] *= -1.0))),
    ("the Gaussian kernel", |q| model(q, |p| p.nu.fill(f64::INFINITY))),
    ("scales taken for variances", |q| {
        model(q, |p| p.scale.as_flattened_mut().iter_mut().for_each(|scale| *scale = scale.sqrt()))
    }),
    ("variances taken for scales", |q| {
        model(q, |p| p.scale.as_flattened_mut().iter_mut().for_each(|scale| *scale *= *scale))
    }),
];

fn detector(q: &mut Question, change: impl Fn(&mut Detector)) -> Result<()> {
    grid(q, |scanner| change(&mut scanner.detector))
}

fn grid(q: &mut Question, change: impl Fn(&mut Scanner)) -> Result<()> {
    let mut scanner = q.scanner()?;
    change(&mut scanner);
    q.scanner = Some(scanner);
    Ok(())
}

fn angles(q: &mut Question, change: impl Fn(f64) -> f64) -> Result<()> {
    let angles: Vec<f64> = q.angles()?.into_iter().map(change).collect();
    q.settings.insert("angles".into(), json!(angles));
    Ok(())
}

fn model(q: &mut Question, change: impl Fn(&mut Parameters)) -> Result<()> {
    let mut parameters = q.parameters("model")?;
    change(&mut parameters);
    q.set_model(&parameters);
    Ok(())
}

/// Mistakes in geometry, kernels, parameters and optimisers, as far as they apply to the stage.
///
/// A mistake that cannot be computed for a question is left out.
pub(super) fn suspects(
    question: &Question,
    role: &str,
    part: &str,
    expected: &ArrayD<f64>,
    format: Format,
) -> Vec<Suspect> {
    let gradient = question.stage.starts_with("gradient");
    let changes: Vec<(&str, Change)> = match question.stage.as_str() {
        "covariance" => OF_MODELS.to_vec(),
        "density" | "density-cutoff" => [&OF_VOLUMES[..], &OF_MODELS].concat(),
        "gradient-density" => OF_VOLUMES.to_vec(),
        _ if gradient => OF_VIEWS.to_vec(),
        _ if question.stage.starts_with("image") || question.stage.starts_with("projected-kernel") => {
            [&OF_VIEWS[..], &OF_MODELS].concat()
        }
        _ => Vec::new(),
    };
    let of = |question: &Question| take(answer(question, Precision::F64).ok()?, role, part);
    let right = of(question);
    let changed = |(name, change): &(&str, Change)| {
        let mut question = question.clone();
        change(&mut question).ok()?;
        Some(Suspect::new(*name, of(&question)?)).filter(|suspect| Some(&suspect.array) != right.as_ref())
    };
    let mut all: Vec<Suspect> = changes.iter().filter_map(changed).collect();
    let special = match question.stage.as_str() {
        "kernel" => power_without_log1p(question, format),
        "image-exact" | "projected-kernel-exact" => variants(question, format),
        "adam" => adam(question),
        _ if gradient => parametrisations(question, part, expected),
        _ => Ok(Vec::new()),
    };
    all.extend(special.unwrap_or_default());
    all.retain(|suspect| suspect.array.shape() == expected.shape());
    all
}

fn take(mut outputs: Outputs, role: &str, part: &str) -> Option<ArrayD<f64>> {
    outputs.remove(role)?.remove(part)
}

const NO_LOG1P: &str = "log(1 + x) for log1p(x), or a power of 1 + x [X3]";

/// `(1+x)^-exponent` with 1+x rounded to the format, which loses the digits of a small x.
fn rounded_power(x: f64, exponent: f64, format: Format) -> f64 {
    exp(-exponent * log(format.round(1.0 + x)))
}

/// `(1+x)^-exponent`.
fn power(x: f64, exponent: f64) -> f64 {
    exp(-exponent * log1p(x))
}

fn power_without_log1p(q: &Question, format: Format) -> Result<Vec<Suspect>> {
    let (delta, nu) = (q.numbers("delta")?, q.numbers("nu")?);
    let value = |(&delta, &nu): (&f64, &f64)| {
        if nu.is_finite() { rounded_power(delta / nu, (nu + 3.0) / 2.0, format) } else { exp(-delta / 2.0) }
    };
    let values: Array1<f64> = delta.iter().zip(&nu).map(value).collect();
    Ok(vec![Suspect::new(NO_LOG1P, values.into_dyn())])
}

/// The exact projection with another profile or weight, from the closest point of each ray.
fn variants(q: &Question, format: Format) -> Result<Vec<Suspect>> {
    type Profile = fn(f64, f64, Format) -> f64;
    let profiles: [(&str, Profile); 3] = [
        (NO_LOG1P, |delta, nu, format| rounded_power(delta / nu, (nu + 2.0) / 2.0, format)),
        ("the exponent (ν+3)/2 of the density for the projection's (ν+2)/2", |delta, nu, _| {
            power(delta / nu, (nu + 3.0) / 2.0)
        }),
        ("the exponent (ν+1)/2 for the projection's (ν+2)/2", |delta, nu, _| power(delta / nu, (nu + 1.0) / 2.0)),
    ];
    let (primitives, scanner, angles) = (q.primitives()?, q.scanner()?, q.angles()?);
    let mut all = Vec::new();
    if primitives.kernel == KernelKind::StudentT {
        for (name, profile) in profiles {
            let profile = |delta, nu| profile(delta, nu, format);
            all.push(Suspect::new(name, images(q, &primitives, &scanner, &angles, &profile, &|_| 1.0)));
        }
    }
    let profile = |delta: f64, nu: f64| {
        if nu.is_finite() { power(delta / nu, (nu + 2.0) / 2.0) } else { exp(-delta / 2.0) }
    };
    let cosine = "the ray's length left out: a factor of the cosine of the ray's angle to the detector's axis";
    all.push(Suspect::new(cosine, images(q, &primitives, &scanner, &angles, &profile, &|cosine| cosine)));
    Ok(all)
}

/// Images of the stage's shape, by the closed form in world coordinates `[X1]`.
fn images(
    q: &Question,
    primitives: &Primitives,
    scanner: &Scanner,
    angles: &[f64],
    profile: &impl Fn(f64, f64) -> f64,
    weight: &impl Fn(f64) -> f64,
) -> ArrayD<f64> {
    let p = &primitives.parameters;
    let precision: Vec<_> = (0..primitives.len()).map(|i| p.covariance(i).inverse()).collect();
    let shape = (primitives.len(), angles.len(), scanner.detector.rows, scanner.detector.columns);
    let kernels = Array4::from_shape_fn(shape, |(i, view, row, column)| {
        let view = scanner.view(angles[view]);
        let ray = scanner.ray(&view, row, column);
        let offset = ray.origin - glam::DVec3::from_array(p.mean[i]);
        let a = ray.direction.dot(precision[i] * ray.direction);
        let nearest = offset - ray.direction * (ray.direction.dot(precision[i] * offset) / a);
        let delta = nearest.dot(precision[i] * nearest);
        let line = if p.nu[i].is_finite() { student_t::line_integral(p.nu[i]).0 } else { gaussian::line_integral() };
        p.density[i] * line / a.sqrt() * profile(delta, p.nu[i]) * weight(ray.direction.dot(view.w))
    });
    if q.stage.starts_with("projected-kernel") { kernels.into_dyn() } else { kernels.sum_axis(Axis(0)).into_dyn() }
}

/// Gradients with respect to other parametrisations than the model file's.
fn parametrisations(q: &Question, part: &str, expected: &ArrayD<f64>) -> Result<Vec<Suspect>> {
    let role = if q.stage == "gradient-raw" { "raw" } else { "model" };
    let p = q.parameters(role)?;
    let times = |values: Vec<f64>| {
        let factors = ArrayD::from_shape_vec(expected.raw_dim(), values).expect("as many as parameters");
        expected * &factors
    };
    let outputs = || answer(q, Precision::F64);
    Ok(match part {
        "scale" => {
            let scales = p.scale.as_flattened();
            vec![
                Suspect::new("the gradient to the scale's logarithm", times(scales.to_vec())),
                Suspect::new("the gradient to the variance", times(scales.iter().map(|s| 0.5 / s).collect())),
            ]
        }
        "quaternion" => {
            let norm = |q: &[f64; 4]| q.iter().map(|x| x * x).sum::<f64>().sqrt();
            let norms = p.quaternion.iter().flat_map(|q| [norm(q); 4]).collect();
            let order = [1, 2, 3, 0].map(|k| expected.index_axis(Axis(1), k).insert_axis(Axis(1)));
            let order = ndarray::concatenate(Axis(1), &order).expect("columns of one array");
            vec![
                Suspect::new("the gradient to the normalised quaternion", times(norms)),
                Suspect::new("the quaternion's order (x, y, z, w)", order),
            ]
        }
        "density" => vec![Suspect::new("the gradient to the density's logarithm", times(p.density.clone()))],
        "nu" if q.stage.starts_with("gradient-image") => {
            let Some(d_density) = take(outputs()?, "grad", "density") else { return Ok(Vec::new()) };
            let constant = |i: usize| {
                let (line, slope) = student_t::line_integral(p.nu[i]);
                expected[[i]] - slope / line * p.density[i] * d_density[[i]]
            };
            let values: Array1<f64> = (0..p.len()).map(constant).collect();
            vec![Suspect::new("∂C/∂ν of the integral factor left out [Eq. 5]", values.into_dyn())]
        }
        _ => Vec::new(),
    })
}

/// Adam with common mistakes.
fn adam(q: &Question) -> Result<Vec<Suspect>> {
    let (start, gradients, rates) = (q.numbers("start")?, q.array::<Ix2>("gradients")?, q.numbers("rates")?);
    let [beta1, beta2, epsilon] = [q.setting("beta1")?, q.setting("beta2")?, q.setting("epsilon")?];
    let run = |corrected: bool, inside: bool, beta1: f64, beta2: f64| {
        let mut trajectory = Array2::zeros(gradients.raw_dim());
        for (k, &first) in start.iter().enumerate() {
            let (mut x, mut m, mut v, mut power) = (first, 0.0, 0.0, [1.0, 1.0]);
            for (t, rate) in rates.iter().enumerate() {
                let g = gradients[[t, k]];
                (m, v) = (beta1 * m + (1.0 - beta1) * g, beta2 * v + (1.0 - beta2) * g * g);
                power = [power[0] * beta1, power[1] * beta2];
                let [c1, c2] = if corrected { power.map(|p| 1.0 - p) } else { [1.0, 1.0] };
                let root = if inside { (v / c2 + epsilon).sqrt() } else { (v / c2).sqrt() + epsilon };
                x -= rate * (m / c1) / root;
                trajectory[[t, k]] = x;
            }
        }
        trajectory.into_dyn()
    };
    Ok(vec![
        Suspect::new("Adam without bias correction", run(false, false, beta1, beta2)),
        Suspect::new("Adam with ε inside of the root", run(true, true, beta1, beta2)),
        Suspect::new("Adam with β₁ and β₂ exchanged", run(true, false, beta2, beta1)),
    ])
}
