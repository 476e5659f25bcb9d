//! Mistakes whose result is found by recomputing the question with one change.

use super::{Suspect, losses, plain, steps};
use crate::answers::answer;
use crate::format::Format;
use crate::outputs::Outputs;
use crate::question::Question;
use ndarray::{Array1, Array4, ArrayD, Axis};
use serde_json::json;
use std::f64::consts::PI;
use trgs_core::error::Result;
use trgs_core::geometry::{Beam, Detector, Scanner};
use trgs_core::numeric::Precision;
use trgs_core::numeric::elementary::{exp, log};
use trgs_core::primitives::{Group, KernelKind, Parameters, Primitives, gaussian, student_t};

/// A change of a question.
type Change = fn(&mut Question) -> Result<()>;

const OF_VIEWS: [(&str, Change); 23] = [
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
    ("the detector's offset along u with the opposite sign", |q| detector(q, |d| d.offset_u = -d.offset_u)),
    ("the detector's height and width exchanged", |q| {
        detector(q, |d| {
            let (rows, columns) = (d.rows as f64, d.columns as f64);
            (d.pitch_v, d.pitch_u) = (d.pitch_u * columns / rows, d.pitch_v * rows / columns);
        })
    }),
    ("a quarter turn backwards", |q| angles(q, |angle| angle - PI / 2.0)),
    ("a quarter turn forwards", |q| angles(q, |angle| angle + PI / 2.0)),
    ("DSD - DSO for DSD", |q| distances(q, |dso, dsd| (dso, dsd - dso))),
    ("DSO + DSD for DSD", |q| distances(q, |dso, dsd| (dso, dso + dsd))),
    ("DSO and DSD exchanged", |q| distances(q, |dso, dsd| (dsd, dso))),
    ("source and detector on each other's side", |q| angles(q, |angle| angle + PI)),
    ("angles taken for degrees", |q| angles(q, |angle| angle * PI / 180.0)),
    ("the affine projection for the exact", |q| projection(q, "exact", "affine")),
    ("the exact projection for the affine", |q| projection(q, "affine", "exact")),
];

const OF_VOLUMES: [(&str, Change); 8] = [
    ("a half-voxel shift along x", |q| grid(q, |s| s.grid.min.x -= 0.5 * s.grid.spacing.x)),
    ("a half-voxel shift along y", |q| grid(q, |s| s.grid.min.y -= 0.5 * s.grid.spacing.y)),
    ("a half-voxel shift along z", |q| grid(q, |s| s.grid.min.z -= 0.5 * s.grid.spacing.z)),
    ("voxel corners for voxel centres", |q| grid(q, |s| s.grid.min -= 0.5 * s.grid.spacing)),
    ("voxels from one end of the box to the other", |q| {
        grid(q, |s| {
            let last = glam::DVec3::from_array(s.grid.shape.map(|n| (n.max(2) - 1) as f64));
            let size = s.grid.size();
            s.grid.spacing = size / last;
            s.grid.min -= 0.5 * s.grid.spacing;
        })
    }),
    ("the volume's offset with the opposite sign", |q| grid(q, |s| s.grid.min = -s.grid.max())),
    ("the sides of the volume in the order z, y, x", |q| {
        grid(q, |s| {
            let (centre, n) =
                (s.grid.min + 0.5 * s.grid.size(), glam::DVec3::from_array(s.grid.shape.map(|n| n as f64)));
            let size = s.grid.size();
            s.grid.spacing = glam::DVec3::new(size.z, size.y, size.x) / n;
            s.grid.min = centre - 0.5 * s.grid.spacing * n;
        })
    }),
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

fn distances(q: &mut Question, change: impl Fn(f64, f64) -> (f64, f64)) -> Result<()> {
    grid(q, |scanner| {
        if let Beam::Cone { dso, dsd } = &mut scanner.beam {
            (*dso, *dsd) = change(*dso, *dsd);
        }
    })
}

fn projection(q: &mut Question, from: &str, to: &str) -> Result<()> {
    q.stage = q.stage.replace(from, to);
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
    q.set_model(&parameters)
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
    if question.stage.starts_with("image") || question.stage.starts_with("density") {
        all.extend(without_the_last(question, of));
    }
    let special = match question.stage.as_str() {
        "kernel" => power_without_log1p(question, format),
        "image-exact" | "projected-kernel-exact" => rounded_logarithm(question, format),
        "adam" => steps::adam(question),
        "loss-l1" | "loss-ssim" | "loss-image" => losses::images(question, role),
        "loss-tv" => losses::variation(question, role),
        "integral-factor" => question.numbers("nu").map(|nu| plain::factors(&nu, role)),
        "covariance" => Ok(scales(question, expected)),
        _ if gradient => parametrisations(question, part, expected),
        _ => Ok(Vec::new()),
    };
    all.extend(special.unwrap_or_default());
    let scene =
        ["image-affine", "image-exact", "density", "gradient-density", "gradient-image-affine", "gradient-image-exact"];
    if scene.contains(&question.stage.as_str()) || question.stage.starts_with("projected-kernel") {
        all.extend(plain::scenes(question, part).unwrap_or_default());
    }
    all.retain(|suspect| suspect.array.shape() == expected.shape());
    all
}

/// Sums without the primitives beyond a whole number of blocks.
fn without_the_last(question: &Question, of: impl Fn(&Question) -> Option<ArrayD<f64>>) -> Vec<Suspect> {
    let count = question.parameters("model").map_or(0, |parameters| parameters.len());
    let mut rests: Vec<usize> = (2..=8).map(|power| count % (1 << power)).filter(|&n| 0 < n && n < count).collect();
    rests.dedup();
    let suspect = |rest: usize| {
        let mut question = question.clone();
        model(&mut question, |p| p.density[count - rest..].fill(0.0)).ok()?;
        Some(Suspect::new("the last primitives left out, those beyond a whole number of blocks", of(&question)?))
    };
    rests.into_iter().filter_map(suspect).collect()
}

fn take(mut outputs: Outputs, role: &str, part: &str) -> Option<ArrayD<f64>> {
    outputs.remove(role)?.remove(part)
}

const NO_LOG1P: &str = "log(1 + x) or a power of 1 + x in place of log1p(x) [X3]";

/// `(1+x)^-exponent` with 1+x rounded to the format, which loses the digits of a small x.
fn rounded_power(x: f64, exponent: f64, format: Format) -> f64 {
    exp(-exponent * log(format.round(1.0 + x)))
}

fn power_without_log1p(q: &Question, format: Format) -> Result<Vec<Suspect>> {
    let (delta, nu) = (q.numbers("delta")?, q.numbers("nu")?);
    let value = |(&delta, &nu): (&f64, &f64)| {
        if nu.is_finite() { rounded_power(delta / nu, (nu + 3.0) / 2.0, format) } else { exp(-delta / 2.0) }
    };
    let values: Array1<f64> = delta.iter().zip(&nu).map(value).collect();
    let mut all = vec![Suspect::new(NO_LOG1P, values.into_dyn())];
    all.extend(plain::kernel(&delta, &nu));
    Ok(all)
}

/// The inverse of the covariances, and the covariances of quaternions that are not normalised.
fn scales(q: &Question, expected: &ArrayD<f64>) -> Vec<Suspect> {
    let Ok(p) = q.parameters("model") else { return Vec::new() };
    let mut inverse = expected.clone();
    for (i, mut matrix) in inverse.outer_iter_mut().enumerate() {
        let precision = p.covariance(i).inverse();
        matrix.indexed_iter_mut().for_each(|(index, x)| *x = precision.col(index[1])[index[0]]);
    }
    vec![
        Suspect::new("the inverse of the covariance", inverse),
        Suspect::new("quaternions not normalised", plain::covariances(&p)),
    ]
}

/// The exact projection with a logarithm of 1 + x, from the closest point of each ray.
fn rounded_logarithm(q: &Question, format: Format) -> Result<Vec<Suspect>> {
    let (primitives, scanner, angles) = (q.primitives()?, q.scanner()?, q.angles()?);
    if primitives.kernel != KernelKind::StudentT {
        return Ok(Vec::new());
    }
    let profile = |delta: f64, nu: f64| rounded_power(delta / nu, (nu + 2.0) / 2.0, format);
    Ok(vec![Suspect::new(NO_LOG1P, images(q, &primitives, &scanner, &angles, &profile))])
}

/// Images of the stage's shape, by the closed form in world coordinates `[X1]`.
fn images(
    q: &Question,
    primitives: &Primitives,
    scanner: &Scanner,
    angles: &[f64],
    profile: &impl Fn(f64, f64) -> f64,
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
        p.density[i] * line / a.sqrt() * profile(delta, p.nu[i])
    });
    if q.stage.starts_with("projected-kernel") { kernels.into_dyn() } else { kernels.sum_axis(Axis(0)).into_dyn() }
}

/// Gradients with respect to other parametrisations than the model file's, or than the raw parameters.
fn parametrisations(q: &Question, part: &str, expected: &ArrayD<f64>) -> Result<Vec<Suspect>> {
    let raw = q.stage == "gradient-raw";
    let p = if raw { q.activation()?.forward(&q.parameters("raw")?).parameters } else { q.parameters("model")? };
    let times = |name: &str, values: Vec<f64>| {
        let factors = ArrayD::from_shape_vec(expected.raw_dim(), values).ok()?;
        Some(Suspect::new(name, expected * &factors))
    };
    let all = match part {
        "quaternion" if expected.ndim() == 2 => quaternions(q, &p, expected),
        _ if raw => vec![times("the gradient to the physical value", slopes(q, part)?)],
        "scale" => {
            let of = |change: fn(&f64) -> f64| p.scale.as_flattened().iter().map(change).collect();
            vec![
                times("the gradient to the scale's inverse", of(|s| -s * s)),
                times("the gradient to the scale's logarithm", of(|s| *s)),
                times("the gradient to the variance", of(|s| 0.5 / s)),
            ]
        }
        "density" => vec![times("the gradient to the density's logarithm", p.density.clone())],
        "nu" => {
            let constant = if q.stage.starts_with("gradient-image") { constant_factor(q, &p, expected)? } else { None };
            vec![times("the gradient to the logarithm of ν", p.nu.clone()), constant]
        }
        _ => Vec::new(),
    };
    Ok(all.into_iter().flatten().collect())
}

/// The inverse slopes of the activation of a group.
fn slopes(q: &Question, part: &str) -> Result<Vec<f64>> {
    let physical = q.activation()?.forward(&q.parameters("raw")?);
    let mut slopes = Parameters::zeros(physical.len());
    Group::ALL.into_iter().for_each(|group| slopes.group_mut(group).fill(1.0));
    q.activation()?.vjp(&physical, &mut slopes);
    let group = Group::ALL.into_iter().find(|group| group.key() == part);
    Ok(group.map_or_else(Vec::new, |group| slopes.group(group).iter().map(|slope| 1.0 / slope).collect()))
}

/// The gradient to ν with the derivative of the integral factor left out.
fn constant_factor(q: &Question, p: &Parameters, expected: &ArrayD<f64>) -> Result<Option<Suspect>> {
    let d_density = take(answer(q, Precision::F64)?, "grad", "density");
    let Some(d_density) = d_density.filter(|array| array.shape() == expected.shape()) else { return Ok(None) };
    let constant = |((expected, d_density), (nu, density)): ((&f64, &f64), (&f64, &f64))| {
        let (line, slope) = student_t::line_integral(*nu);
        expected - slope / line * density * d_density
    };
    let values: Array1<f64> = expected.iter().zip(&d_density).zip(p.nu.iter().zip(&p.density)).map(constant).collect();
    Ok(Some(Suspect::new("∂C/∂ν of the integral factor left out [Eq. 5]", values.into_dyn())))
}

/// Gradients to quaternions in another order, of another sign, or without the normalisation.
fn quaternions(q: &Question, p: &Parameters, expected: &ArrayD<f64>) -> Vec<Option<Suspect>> {
    let norm = |q: &[f64; 4]| q.iter().map(|x| x * x).sum::<f64>().sqrt();
    let norms: Vec<f64> = p.quaternion.iter().flat_map(|q| [norm(q); 4]).collect();
    let (Ok(norms), 4) = (ArrayD::from_shape_vec(expected.raw_dim(), norms), expected.len_of(Axis(1))) else {
        return Vec::new();
    };
    let mut signs = expected.clone();
    signs.index_axis_mut(Axis(1), 0).mapv_inplace(|x| -x);
    let mut all = vec![
        Suspect::new("the gradient to the normalised quaternion", expected * &norms),
        Suspect::new("the quaternion's order (x, y, z, w)", expected.select(Axis(1), &[1, 2, 3, 0])),
        Suspect::new("the opposite sign of the gradient to w", signs.clone()),
        Suspect::new("the opposite sign of the gradient to x, y, z", -signs),
    ];
    for unit in without_normalisation(q, p).unwrap_or_default() {
        // The formula for a unit quaternion, and the derivative with a constant norm.
        let name = "the gradient not through the quaternion's normalisation";
        if unit.shape() == expected.shape() {
            all.push(Suspect::new(name, &unit / &norms));
            all.push(Suspect::new(name, unit));
        }
    }
    all.into_iter().map(Some).collect()
}

/// The gradient to the normalised quaternion, by the rotation's formula for a unit quaternion.
fn without_normalisation(q: &Question, p: &Parameters) -> Result<Vec<ArrayD<f64>>> {
    let mut unit = p.clone();
    for quaternion in &mut unit.quaternion {
        let norm = quaternion.iter().map(|x| x * x).sum::<f64>().sqrt();
        quaternion.iter_mut().for_each(|x| *x /= norm);
    }
    let cotangent = q.array::<ndarray::Ix3>("cotangent")?;
    let plain = plain::Plain::with_model(q, &unit)?;
    let faults = [plain::Fault::Unnormalised, plain::Fault::UnnormalisedRay];
    Ok(faults.into_iter().filter_map(|fault| plain.gradient(&cotangent, "quaternion", Some(fault))).collect())
}

#[cfg(test)]
mod tests {
    use super::super::of_part;
    use super::*;
    use crate::manifest::Vectors;

    /// Puts each change into a case, and counts the names: right, among candidates, none, wrong.
    fn named(id: &str, role: &str, part: &str, changes: &[(&str, Change)]) -> [usize; 4] {
        let vectors = Vectors::embedded().unwrap();
        let case = vectors.manifest.cases.iter().find(|case| case.id == id).unwrap();
        let question = Question::new(&vectors, case).unwrap();
        let right = take(answer(&question, Precision::F64).unwrap(), role, part).unwrap();
        let mut counts = [0; 4];
        for (name, change) in changes {
            let mut changed = question.clone();
            change(&mut changed).unwrap();
            let wrong = take(answer(&changed, Precision::F64).unwrap(), role, part).unwrap();
            if wrong == right {
                continue;
            }
            let found = of_part(&question, (role, part), &right, &wrong, Format::F64, 1e-13);
            let kind = match &found {
                None => 2,
                Some(found) if found == name => 0,
                Some(found) if found.split(", or ").any(|one| one == *name) => 1,
                Some(found) => {
                    println!("{id}: {found} for {name}");
                    3
                }
            };
            counts[kind] += 1;
        }
        println!("{id} {part}: {counts:?}");
        counts
    }

    #[test]
    fn each_mistake_of_geometry_and_models_is_named() {
        let images = [&OF_VIEWS[..], &OF_MODELS].concat();
        let volumes = [&OF_VOLUMES[..], &OF_MODELS].concat();
        let all = [
            named("image-exact/cone-offset", "image", "", &images),
            named("image-affine/cone-offset", "image", "", &images),
            named("density/cone-offset", "volume", "", &volumes),
            named("gradient-image-exact/cone-offset", "grad", "mean", &OF_VIEWS),
            named("gradient-image-affine/cone-offset", "grad", "quaternion", &OF_VIEWS),
            named("gradient-density/cone-offset", "grad", "scale", &OF_VOLUMES),
        ];
        let total = all.iter().fold([0; 4], |sum, one| std::array::from_fn(|k| sum[k] + one[k]));
        let tried = total.iter().sum::<usize>();
        assert!(tried > 90, "{tried} mistakes");
        assert_eq!(total[3], 0, "wrong names: {total:?}");
        assert!(10 * total[0] >= 9 * tried, "right, among candidates, none, wrong: {total:?}");
    }

    #[test]
    fn mistakes_in_gradients_to_raw_parameters_are_named() {
        let vectors = Vectors::embedded().unwrap();
        let case = vectors.manifest.cases.iter().find(|case| case.id == "gradient-raw/cone").unwrap();
        let q = Question::new(&vectors, case).unwrap();
        let right = answer(&q, Precision::F64).unwrap().remove("grad").unwrap();
        let found = |part: &str, wrong: &ArrayD<f64>| {
            of_part(&q, ("grad", part), &right[part], wrong, Format::F64, 1e-13).unwrap_or_default()
        };
        let physical = q.activation().unwrap().forward(&q.parameters("raw").unwrap()).parameters;
        for unit in without_normalisation(&q, &physical).unwrap() {
            let name = found("quaternion", &unit);
            assert!(name.contains("normalis"), "{name:?}");
        }
        let mut changed = q.clone();
        changed.stage = "gradient-image-exact".into();
        assert!(changed.set_model(&physical).is_err(), "a question of raw parameters has no model");
        changed.scanner = None;
        assert!(suspects(&changed, "grad", "quaternion", &right["quaternion"], Format::F64).is_empty());
        for part in ["scale", "density", "nu"] {
            let factors = ArrayD::from_shape_vec(right[part].raw_dim(), slopes(&q, part).unwrap()).unwrap();
            assert_eq!(found(part, &(&right[part] * &factors)), "the gradient to the physical value");
        }
    }
}
