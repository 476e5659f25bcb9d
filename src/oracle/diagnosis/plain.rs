//! Kernels, fields, projections and their gradients as plainly as possible, with one fault.

use super::Suspect;
use crate::format::Format;
use crate::question::Question;
use glam::{DMat3, DVec3};
use ndarray::{Array1, Array2, Array3, Array4, ArrayD, Axis, IxDyn};
use std::f64::consts::{PI, TAU};
use trgs_core::error::Result;
use trgs_core::geometry::{Beam, Scanner, View};
use trgs_core::numeric::elementary::{exp, log1p};
use trgs_core::primitives::{Group, Parameters, student_t};
use trgs_core::projector::Projection;

/// The numbers of one primitive: mean, scale, quaternion (w, x, y, z), density, ν.
type Numbers = [f64; 12];

/// One mistake in the equations.
#[derive(Clone, Copy)]
pub(super) enum Fault {
    /// Another summand of ν in the exponent, for 3 of the field or 2 of the projection.
    Exponent(f64),
    /// The power of `1 + δ` for that of `1 + δ/ν`.
    WithoutNu,
    /// The distance for its square.
    Distance,
    /// Another integral factor C(ν) [Eq. 5].
    Factor(fn(f64) -> f64),
    /// The integral over the depth for the integral along the ray.
    Cosine,
    /// The rotation of the quaternion as it is stored, in the moment of a ray.
    Unnormalised,
    /// The same in the position and the direction of a ray.
    UnnormalisedRay,
    /// Values beyond three scales left out.
    Cut,
    /// Other numbers in the model.
    Model(fn(&mut Numbers)),
    /// The depth of the axis for the depth of the centre in the affine projection.
    Depth,
}

/// Names and faults.
pub(super) const FAULTS: [(&str, Fault); 21] = [
    ("the exponent (ν+1)/2", Fault::Exponent(1.0)),
    ("the exponent (ν+2)/2 of the projection for the field's (ν+3)/2", Fault::Exponent(2.0)),
    ("the exponent (ν+3)/2 of the density for the projection's (ν+2)/2", Fault::Exponent(3.0)),
    ("the exponent ν/2", Fault::Exponent(0.0)),
    ("1 + δ in place of 1 + δ/ν", Fault::WithoutNu),
    ("the distance √δ in place of δ", Fault::Distance),
    ("the integral factor's √(νπ) left out", Fault::Factor(gamma_ratio)),
    ("the integral factor's Γ quotient left out", Fault::Factor(|nu| (nu * PI).sqrt())),
    ("the integral factor left out", Fault::Factor(|_| 1.0)),
    ("the integral factor's Γ quotient inverted", Fault::Factor(|nu| (nu * PI).sqrt() / gamma_ratio(nu))),
    ("√ν for √(νπ) in the integral factor", Fault::Factor(|nu| nu.sqrt() * gamma_ratio(nu))),
    ("Γ((ν+1)/2)/Γ((ν+2)/2) in the integral factor", Fault::Factor(|nu| (nu * PI).sqrt() * gamma_ratio(nu - 1.0))),
    ("the Gaussian's √(2π) in the integral factor", Fault::Factor(|_| TAU.sqrt())),
    ("the ray's length left out: a factor of the cosine of the ray's angle to the detector's axis", Fault::Cosine),
    ("quaternions not normalised", Fault::Unnormalised),
    ("quaternions not normalised", Fault::UnnormalisedRay),
    ("values beyond three scales left out", Fault::Cut),
    ("quaternions read as (x, y, z, w)", Fault::Model(|p| (p[6], p[7], p[8], p[9]) = (p[9], p[6], p[7], p[8]))),
    ("the inverse rotation", Fault::Model(|p| p[6] = -p[6])),
    ("scales taken for variances", Fault::Model(|p| p[3..6].iter_mut().for_each(|s| *s = s.sqrt()))),
    ("variances taken for scales", Fault::Model(|p| p[3..6].iter_mut().for_each(|s| *s *= *s))),
];

/// Γ((ν+2)/2)/Γ((ν+3)/2).
fn gamma_ratio(nu: f64) -> f64 {
    exp(libm::lgamma((nu + 2.0) / 2.0) - libm::lgamma((nu + 3.0) / 2.0))
}

/// `(1 + δ/ν)^(-(ν+n)/2)`, `exp(-δ/2)` for an infinite ν, with a fault.
pub(super) fn power(delta: f64, nu: f64, n: f64, fault: Option<Fault>) -> f64 {
    let (delta, n, x) = match fault {
        Some(Fault::Exponent(other)) => (delta, other, delta / nu),
        Some(Fault::WithoutNu) => (delta, n, delta),
        Some(Fault::Distance) => (delta.sqrt(), n, delta.sqrt() / nu),
        Some(Fault::Cut) if delta > 9.0 => return 0.0,
        _ => (delta, n, delta / nu),
    };
    if nu.is_finite() { exp(-(nu + n) / 2.0 * log1p(x)) } else { exp(-delta / 2.0) }
}

/// C(ν) [Eq. 5] with a fault.
pub(super) fn integral_factor(nu: f64, fault: Option<Fault>) -> f64 {
    match fault {
        Some(Fault::Factor(factor)) if nu.is_finite() => factor(nu),
        _ if nu.is_finite() => student_t::line_integral(nu).0,
        _ => TAU.sqrt(),
    }
}

/// Numbers and axes of a primitive under a fault.
fn read(numbers: &Numbers, fault: Option<Fault>) -> (Numbers, DMat3) {
    let mut p = *numbers;
    if let Some(Fault::Model(change)) = fault {
        change(&mut p);
    }
    let norm = if matches!(fault, Some(Fault::Unnormalised | Fault::UnnormalisedRay)) {
        1.0
    } else {
        p[6..10].iter().map(|x| x * x).sum::<f64>().sqrt()
    };
    let [w, x, y, z] = [p[6], p[7], p[8], p[9]].map(|component| component / norm);
    let cross = DMat3::from_cols_array(&[0.0, z, -y, -z, 0.0, x, y, -x, 0.0]);
    (p, DMat3::IDENTITY + 2.0 * w * cross + 2.0 * cross * cross)
}

/// One primitive at the voxel centres [Eq. 1] [Eq. 2].
fn field(numbers: &Numbers, scanner: &Scanner, fault: Option<Fault>) -> Array3<f64> {
    let (p, axes) = read(numbers, fault);
    let (mean, scale) = (DVec3::new(p[0], p[1], p[2]), DVec3::new(p[3], p[4], p[5]));
    let to_axes = axes.transpose();
    Array3::from_shape_fn(scanner.grid.shape, |(x, y, z)| {
        let local = to_axes * (scanner.grid.centre([x, y, z]) - mean) / scale;
        p[10] * power(local.length_squared(), p[11], 3.0, fault)
    })
}

/// One primitive in one view `[v, u]` `[Eq. 4]` `[Eq. 5]` `[X1]`.
fn footprint(numbers: &Numbers, scanner: &Scanner, view: &View, exact: bool, fault: Option<Fault>) -> Array2<f64> {
    let (p, axes) = read(numbers, fault);
    let shape = (scanner.detector.rows, scanner.detector.columns);
    let centre = view.to_camera(DVec3::new(p[0], p[1], p[2]));
    let to_axes = (DMat3::from_cols(view.u, view.v, view.w).transpose() * axes).transpose();
    let scale = DVec3::new(p[3], p[4], p[5]);
    let (magnification, distance) = match scanner.beam {
        Beam::Cone { dso, .. } if centre.z <= dso / 100.0 => return Array2::zeros(shape),
        Beam::Cone { dso, dsd } => (if matches!(fault, Some(Fault::Depth)) { dso } else { centre.z } / dsd, Some(dsd)),
        Beam::Parallel { .. } => (1.0, None),
    };
    let amplitude = p[10] * integral_factor(p[11], fault);
    Array2::from_shape_fn(shape, |(row, column)| {
        let (u, v) = scanner.detector.position(row as f64, column as f64);
        let offset = DVec3::new(u, v, 0.0) * magnification - DVec3::new(centre.x, centre.y, 0.0);
        let direction = match distance {
            Some(dsd) if exact => DVec3::new(u, v, dsd),
            Some(_) => centre,
            None => DVec3::Z,
        };
        let square = (to_axes * direction / scale).length_squared();
        // The moment of the ray, in the axes of the primitive: no cancellation.
        let moment = match fault {
            Some(Fault::UnnormalisedRay) => (to_axes * offset / scale).cross(to_axes * direction / scale),
            _ => to_axes * offset.cross(direction) * scale / scale.element_product(),
        };
        let length = if matches!(fault, Some(Fault::Cosine)) { direction.z } else { direction.length() };
        amplitude * length / square.sqrt() * power(moment.length_squared() / square, p[11], 2.0, fault)
    })
}

/// The numbers of all primitives.
fn numbers(p: &Parameters) -> Vec<Numbers> {
    let one = |i: usize| {
        let (mean, scale, quaternion) = (p.mean[i], p.scale[i], p.quaternion[i]);
        let mut all = [0.0; 12];
        all[..3].copy_from_slice(&mean);
        all[3..6].copy_from_slice(&scale);
        all[6..10].copy_from_slice(&quaternion);
        (all[10], all[11]) = (p.density[i], p.nu[i]);
        all
    };
    (0..p.len()).map(one).collect()
}

/// A stage's question with the terms that all elements share.
pub(super) struct Plain {
    model: Vec<Numbers>,
    scanner: Scanner,
    views: Vec<View>,
    exact: bool,
}

impl Plain {
    /// Reads a question with a model and a scanner; without views for stages of the field.
    pub(super) fn new(q: &Question) -> Result<Self> {
        Self::with_model(q, &q.parameters("model")?)
    }

    /// [`Self::new`] with other parameters.
    pub(super) fn with_model(q: &Question, model: &Parameters) -> Result<Self> {
        let scanner = q.scanner()?;
        let views = q.angles().map(|angles| angles.iter().map(|&angle| scanner.view(angle)).collect());
        let exact = q.projection()? == Projection::Exact;
        Ok(Self { model: numbers(model), scanner, views: views.unwrap_or_default(), exact })
    }

    /// The contributions of one primitive, in the shape of the image or volume.
    fn of(&self, p: &Numbers, fault: Option<Fault>) -> Array3<f64> {
        if self.views.is_empty() {
            return field(p, &self.scanner, fault);
        }
        let views: Vec<Array2<f64>> =
            self.views.iter().map(|view| footprint(p, &self.scanner, view, self.exact, fault)).collect();
        let views: Vec<_> = views.iter().map(|view| view.view()).collect();
        ndarray::stack(Axis(0), &views).expect("images of one shape")
    }

    /// The image, volume, or single kernels.
    pub(super) fn values(&self, fault: Option<Fault>, single: bool) -> ArrayD<f64> {
        let parts: Vec<Array3<f64>> = self.model.iter().map(|p| self.of(p, fault)).collect();
        if single {
            let (a, b, c) = parts[0].dim();
            let all = Array4::from_shape_fn((parts.len(), a, b, c), |(i, a, b, c)| parts[i][[a, b, c]]);
            return all.into_dyn();
        }
        parts.into_iter().reduce(|sum, part| sum + part).expect("a model has primitives").into_dyn()
    }

    /// The sum over the primitives with each partial sum rounded to a format.
    pub(super) fn accumulated(&self, format: Format) -> ArrayD<f64> {
        let parts = self.model.iter().map(|p| self.of(p, None).mapv(|x| format.round(x)));
        parts.reduce(|sum, part| (sum + part).mapv(|x| format.round(x))).expect("a model has primitives").into_dyn()
    }

    /// The gradient of `Σ cotangent·value` to one group, by central differences.
    pub(super) fn gradient(&self, cotangent: &Array3<f64>, part: &str, fault: Option<Fault>) -> Option<ArrayD<f64>> {
        let group = Group::ALL.into_iter().find(|group| group.key() == part)?;
        let first: usize = Group::ALL.into_iter().take_while(|before| *before != group).map(Group::width).sum();
        let slope = |p: &Numbers, k: usize| {
            if !p[k].is_finite() {
                return 0.0;
            }
            let size = match k {
                0..6 => p[3..6].iter().copied().fold(f64::INFINITY, f64::min),
                6..10 => p[6..10].iter().map(|x| x * x).sum::<f64>().sqrt(),
                _ => p[k].abs().max(1e-3),
            };
            let step = 1e-5 * size;
            let at = |by: f64| {
                let mut moved = *p;
                moved[k] += by * step;
                (cotangent * &self.of(&moved, fault)).sum()
            };
            (at(1.0) - at(-1.0)) / (2.0 * step)
        };
        let values: Vec<f64> =
            self.model.iter().flat_map(|p| (first..first + group.width()).map(|k| slope(p, k))).collect();
        let shape = if group.width() == 1 { vec![self.model.len()] } else { vec![self.model.len(), group.width()] };
        ArrayD::from_shape_vec(IxDyn(&shape), values).ok()
    }
}

/// The faults of a stage with images, volumes, or their gradients.
pub(super) fn scenes(q: &Question, part: &str) -> Result<Vec<Suspect>> {
    let plain = Plain::new(q)?;
    let field = plain.views.is_empty();
    let fits = |fault: &Fault| match fault {
        Fault::Exponent(n) => *n != if field { 3.0 } else { 2.0 },
        Fault::Factor(_) | Fault::Cosine | Fault::UnnormalisedRay => !field,
        _ => true,
    };
    let faults = FAULTS.into_iter().filter(|(_, fault)| fits(fault));
    let faults = faults.chain([("the depth of the axis for that of the centre", Fault::Depth)]);
    if q.stage.starts_with("gradient") {
        let cotangent = q.array::<ndarray::Ix3>("cotangent")?;
        let gradient = |(name, fault)| Some(Suspect::new(name, plain.gradient(&cotangent, part, Some(fault))?));
        return Ok(faults.filter_map(gradient).collect());
    }
    let single = q.stage.starts_with("projected-kernel");
    // The faults of the model in a value are among the changes of the question.
    let faults = faults.filter(|(_, fault)| !matches!(fault, Fault::Model(_)));
    let mut all: Vec<Suspect> =
        faults.map(|(name, fault)| Suspect::new(name, plain.values(Some(fault), single))).collect();
    if !single {
        for format in [Format::F16, Format::Bf16] {
            all.push(Suspect::new(format!("sums accumulated in {format}"), plain.accumulated(format)));
        }
    }
    Ok(all)
}

/// The covariances of quaternions that are not normalised.
pub(super) fn covariances(p: &Parameters) -> ArrayD<f64> {
    let mut all = Array3::zeros((p.len(), 3, 3));
    for (mut matrix, numbers) in all.outer_iter_mut().zip(numbers(p)) {
        let (numbers, axes) = read(&numbers, Some(Fault::Unnormalised));
        let scaled = axes * DMat3::from_diagonal(DVec3::new(numbers[3], numbers[4], numbers[5]));
        let covariance = scaled * scaled.transpose();
        matrix.indexed_iter_mut().for_each(|((row, column), x)| *x = covariance.col(column)[row]);
    }
    all.into_dyn()
}

/// The faults of the kernel at given δ and ν.
pub(super) fn kernel(delta: &[f64], nu: &[f64]) -> Vec<Suspect> {
    let faults = FAULTS.into_iter().filter(|(_, fault)| {
        matches!(fault, Fault::WithoutNu | Fault::Distance | Fault::Cut)
            || matches!(fault, Fault::Exponent(n) if *n != 3.0)
    });
    let all = faults.map(|(name, fault)| {
        let values: Array1<f64> =
            delta.iter().zip(nu).map(|(&delta, &nu)| power(delta, nu, 3.0, Some(fault))).collect();
        Suspect::new(name, values.into_dyn())
    });
    all.collect()
}

/// The faults of the integral factor and its slope.
pub(super) fn factors(nu: &[f64], role: &str) -> Vec<Suspect> {
    let of = |nu: f64, fault: Fault| {
        let at = |nu: f64| integral_factor(nu, Some(fault));
        let step = 1e-3 * nu;
        if role == "factor" {
            return at(nu);
        }
        (8.0 * (at(nu + step) - at(nu - step)) - (at(nu + 2.0 * step) - at(nu - 2.0 * step))) / (12.0 * step)
    };
    let faults = FAULTS.into_iter().filter(|(_, fault)| matches!(fault, Fault::Factor(_)));
    let all = faults.map(|(name, fault)| {
        let values: Array1<f64> = nu.iter().map(|&nu| of(nu, fault)).collect();
        Suspect::new(name, values.into_dyn())
    });
    all.collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::answers::answer;
    use crate::manifest::Vectors;
    use crate::tolerances::largest;
    use trgs_core::numeric::Precision;

    fn question(id: &str) -> Question {
        let vectors = Vectors::embedded().unwrap();
        let case = vectors.manifest.cases.iter().find(|case| case.id == id).unwrap();
        Question::new(&vectors, case).unwrap()
    }

    fn error(a: &ArrayD<f64>, b: &ArrayD<f64>) -> f64 {
        super::super::distance(a, b) / b.iter().map(|x| x * x).sum::<f64>().sqrt()
    }

    #[test]
    fn without_a_fault_values_are_the_answers() {
        let scenes = [
            ("density/cone-offset", "volume"),
            ("image-affine/cone-offset", "image"),
            ("image-exact/cone-offset", "image"),
            ("image-exact/parallel-offset", "image"),
            ("image-exact/gaussian-cone", "image"),
            ("projected-kernel-exact/cone-centred", "kernels"),
        ];
        for (id, role) in scenes {
            let q = question(id);
            let right = answer(&q, Precision::F64).unwrap().remove(role).unwrap().remove("").unwrap();
            let values = Plain::new(&q).unwrap().values(None, role == "kernels");
            assert_eq!(values.shape(), right.shape(), "{id}");
            within!(error(&values, &right), "{id}");
        }
    }

    #[test]
    fn without_a_fault_gradients_are_the_answers() {
        for id in
            ["gradient-density/cone-offset", "gradient-image-affine/cone-offset", "gradient-image-exact/cone-offset"]
        {
            let q = question(id);
            let right = answer(&q, Precision::F64).unwrap().remove("grad").unwrap();
            let (plain, cotangent) = (Plain::new(&q).unwrap(), q.array::<ndarray::Ix3>("cotangent").unwrap());
            for (part, right) in right {
                let gradient = plain.gradient(&cotangent, &part, None).unwrap();
                within!(error(&gradient, &right), "{id} {part}");
            }
        }
    }

    #[test]
    fn without_a_fault_kernel_and_factor_are_those_of_the_library() {
        let nu = [2.0, 3.7, 30.0, 100.0];
        let factors = nu.map(|nu| (nu * PI).sqrt() * gamma_ratio(nu) / student_t::line_integral(nu).0 - 1.0);
        within!("factor", largest(factors));
        let powers = nu.map(|nu| power(2.5, nu, 3.0, None) / libm::pow(1.0 + 2.5 / nu, -(nu + 3.0) / 2.0) - 1.0);
        within!("kernel", largest(powers));
        assert_eq!(power(9.1, 4.0, 3.0, Some(Fault::Cut)), 0.0);
    }

    #[test]
    fn a_sum_in_half_precision_has_its_rounding() {
        let plain = Plain::new(&question("image-exact/cone-five")).unwrap();
        let error = error(&plain.accumulated(Format::F16), &plain.values(None, false));
        within!("most", error);
        beyond!("least", error);
    }
}
