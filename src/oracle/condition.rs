//! The condition of each true value: the error of a correct answer in units of the format's rounding.
//!
//! Not in the paper. With u half a unit in the last place of 1, inputs that are rounded to a format and every operation
//! on them change a value by about u·condition: the sum of |partial derivative|·|input|, of the cancellation in the
//! formulas of the protocol, and of the depth of the sum. All terms are bounds that need one pass over (element, primitive).

use super::manifest::{Arrays, Case, Vectors};
use super::question::Question;
use glam::{DMat3, DQuat, DVec3};
use ndarray::{Array1, Array3, ArrayD, Axis, Ix3};
use trgs_core::error::Result;
use trgs_core::geometry::{Beam, Scanner, View};
use trgs_core::numeric::elementary::{exp, log1p};
use trgs_core::primitives::{Parameters, student_t};
use trgs_core::projector::Projection;

/// The condition of each element of an output, by the array's name.
pub(super) type Conditions = Arrays;

/// The stages with a bound.
pub(super) const STAGES: [&str; 11] = [
    "kernel",
    "density",
    "density-cutoff",
    "projected-kernel-affine",
    "projected-kernel-exact",
    "image-affine",
    "image-exact",
    "image-cutoff",
    "gradient-density",
    "gradient-image-affine",
    "gradient-image-exact",
];

/// Roundings of a kernel's value that belong to no input: factor, root, quotient, exponential.
const ROUNDINGS: f64 = 4.0;

/// One primitive.
struct One {
    mean: DVec3,
    scale: DVec3,
    to_axes: DMat3,
    norm: f64,
    density: f64,
    nu: f64,
    /// C(ν) of projections, its condition as a quotient of Γ by logarithms, and the magnitude of the terms of C'/C.
    line: [f64; 3],
}

/// A primitive at one point of its field, or at the point of a ray with the least δ.
struct At {
    /// The contribution without its density.
    value: f64,
    /// The condition of the contribution, relative to it.
    relative: f64,
    /// The magnitude of the slope of its logarithm to δ.
    slope: f64,
    delta: f64,
    /// The offset in scales, and how far rounded positions and rotations move it, in u.
    offset: DVec3,
    moved: DVec3,
    /// δ before the cancellation of the ray's direction.
    whole: f64,
    /// Length of the arm on which a rotation acts.
    arm: f64,
    /// The ray's length in scales: cancellation of its square, and whether there is a ray.
    along: f64,
}

impl One {
    fn new(p: &Parameters, i: usize) -> Self {
        let [w, x, y, z] = p.quaternion[i];
        let norm = (w * w + x * x + y * y + z * z).sqrt();
        let rotation = DMat3::from_quat(DQuat::from_xyzw(x / norm, y / norm, z / norm, w / norm));
        let nu = p.nu[i];
        let line = if nu.is_finite() {
            let terms = (libm::log(nu / 2.0 + 1.0).abs() + 1.0) + 1.0 / nu;
            [student_t::line_integral(nu).0, 2.0 * libm::lgamma(nu / 2.0 + 1.5).abs(), terms]
        } else {
            [std::f64::consts::TAU.sqrt(), 0.0, 0.0]
        };
        Self {
            mean: DVec3::from_array(p.mean[i]),
            scale: DVec3::from_array(p.scale[i]),
            to_axes: rotation.transpose(),
            norm,
            density: p.density[i],
            nu,
            line,
        }
    }

    /// The kernel at an offset from the centre, whose coordinates come from numbers of the size `magnitude`.
    ///
    /// `ray` has the offset before the part along the ray is taken off, and the ray's direction.
    fn at(&self, offset: DVec3, magnitude: f64, ray: Option<(DVec3, DVec3)>) -> At {
        let n = if ray.is_some() { 2.0 } else { 3.0 };
        let local = self.to_axes * offset / self.scale;
        let moved = magnitude / self.scale;
        let delta = local.length_squared();
        let short = self.scale.min_element();
        let (mut value, mut along, mut whole, mut quotient) = (1.0, 0.0, delta, 0.0);
        if let Some((before, direction)) = ray {
            let square = (self.to_axes * direction / self.scale).length_squared();
            value = self.line[0] * (direction.length_squared() / square).sqrt();
            along = direction.length_squared() / (short * short * square);
            quotient = self.line[1];
            whole = before.length_squared() / (short * short);
        }
        let (logarithm, slope) = if self.nu.is_finite() {
            let q = (self.nu + n) / 2.0;
            (q * log1p(delta / self.nu), q / (self.nu + delta))
        } else {
            (delta / 2.0, 0.5)
        };
        let error = 2.0 * local.abs().dot(moved) + 2.0 * whole * along.max(1.0);
        let relative = ROUNDINGS + slope * error + 2.0 * logarithm + along + quotient;
        let arm = if ray.is_some() { magnitude } else { offset.abs().element_sum() };
        At { value: value * exp(-logarithm), relative, slope, delta, offset: local.abs(), moved, whole, arm, along }
    }

    /// The kernel at a voxel.
    fn voxel(&self, centre: DVec3) -> At {
        let offset = centre - self.mean;
        self.at(offset, centre.abs().element_sum() + self.mean.abs().element_sum(), None)
    }

    /// The kernel on the ray of a pixel; nothing if the near rule leaves it out.
    fn pixel(&self, view: &View, row: usize, column: usize, exact: bool) -> Option<At> {
        let centre = view.to_camera(self.mean);
        let (u, v) = view.detector.position(row as f64, column as f64);
        let (shrink, cone) = match view.beam {
            Beam::Cone { dso, .. } if centre.z <= dso / 100.0 => return None,
            Beam::Cone { dsd, .. } => (centre.z / dsd, true),
            Beam::Parallel { .. } => (1.0, false),
        };
        let world = |camera: DVec3| view.u * camera.x + view.v * camera.y + view.w * camera.z;
        let before = world(DVec3::new(u * shrink - centre.x, v * shrink - centre.y, 0.0));
        let direction = match cone {
            true if exact => world(DVec3::new(u * shrink, v * shrink, centre.z)),
            true => world(centre),
            false => view.w,
        };
        let scaled = |x: DVec3| self.to_axes * x / self.scale;
        let (y, z) = (scaled(before), scaled(direction));
        let nearest = before - direction * (y.dot(z) / z.length_squared());
        let source = if cone { view.beam.dso() } else { 0.0 };
        let magnitude = source + self.mean.abs().element_sum() + (u.abs() + v.abs()) * shrink.abs();
        Some(self.at(nearest, magnitude, Some((before, direction))))
    }

    /// Adds the condition of the slopes to the twelve numbers; `weight` is |cotangent|·|density|.
    fn slopes(&self, at: &At, weight: f64, sums: &mut [f64; 12]) {
        let value = weight * at.value;
        let (relative, steep) = (at.relative + ROUNDINGS, 2.0 * at.slope);
        let short = self.scale.min_element();
        let ray = f64::from(u8::from(at.along > 0.0));
        let pull = at.offset * relative + at.moved;
        let mean = steep * (pull / self.scale).element_sum();
        sums[..3].iter_mut().for_each(|sum| *sum += value * mean);
        for k in 0..3 {
            let squares = at.offset[k] * (at.offset[k] * relative + 2.0 * at.moved[k]) + ray * at.whole * at.along;
            sums[3 + k] += value * (steep * squares + ray * (relative + at.along)) / self.scale[k];
        }
        let turn = steep * (pull + at.offset).element_sum() * at.arm / short + ray * at.along * relative;
        sums[6..10].iter_mut().for_each(|sum| *sum += value * 4.0 / self.norm * turn);
        sums[10] += at.value * at.relative;
        if self.nu.is_finite() {
            let x = at.delta / self.nu;
            let terms = 0.5 * log1p(x) + at.slope * x * (1.0 + at.relative) + ray * self.line[2];
            sums[11] += value * terms * relative;
        }
    }
}

/// The scene of a question.
struct Scene {
    primitives: Vec<One>,
    scanner: Scanner,
    views: Vec<View>,
    exact: bool,
}

impl Scene {
    fn new(q: &Question) -> Result<Self> {
        let (parameters, scanner) = (q.parameters("model")?, q.scanner()?);
        let views = q.angles().map(|angles| angles.iter().map(|&angle| scanner.view(angle)).collect());
        Ok(Self {
            primitives: (0..parameters.len()).map(|i| One::new(&parameters, i)).collect(),
            scanner,
            views: views.unwrap_or_default(),
            exact: q.projection()? == Projection::Exact,
        })
    }

    /// The shape of the image or volume.
    fn shape(&self) -> (usize, usize, usize) {
        let ([x, y, z], detector) = (self.scanner.grid.shape, &self.scanner.detector);
        if self.views.is_empty() { (x, y, z) } else { (self.views.len(), detector.rows, detector.columns) }
    }

    /// A primitive at an element.
    fn at(&self, one: &One, (a, b, c): (usize, usize, usize)) -> Option<At> {
        match self.views.get(a) {
            Some(view) => one.pixel(view, b, c, self.exact),
            None => Some(one.voxel(self.scanner.grid.centre([a, b, c]))),
        }
    }

    /// The condition of one primitive's values, with the depth of a sum.
    fn values(&self, one: &One, depth: f64) -> Array3<f64> {
        Array3::from_shape_fn(self.shape(), |index| {
            let at = self.at(one, index);
            at.map_or(0.0, |at| one.density.abs() * at.value * (at.relative + depth))
        })
    }

    /// The condition of one primitive's slopes.
    fn slopes(&self, one: &One, cotangent: &Array3<f64>) -> [f64; 12] {
        let mut sums = [0.0; 12];
        let depth = (cotangent.len() as f64).sqrt();
        for (index, &weight) in cotangent.indexed_iter().filter(|(_, weight)| **weight != 0.0) {
            let Some(mut at) = self.at(one, index) else { continue };
            at.relative += depth;
            let mut terms = [0.0; 12];
            one.slopes(&at, weight.abs() * one.density.abs(), &mut terms);
            terms[10] *= weight.abs();
            sums.iter_mut().zip(terms).for_each(|(sum, term)| *sum += term);
        }
        sums
    }
}

/// The condition of each element of a question's output, by the array's name; nothing for a stage without a bound.
///
/// # Errors
/// When an input is missing.
pub(super) fn of(vectors: &Vectors, case: &Case) -> Result<Conditions> {
    if !STAGES.contains(&case.stage.as_str()) {
        return Ok(Conditions::new());
    }
    let q = &Question::new(vectors, case)?;
    let single = |array: ArrayD<f64>| Ok([(String::new(), array)].into());
    match q.stage.as_str() {
        "kernel" => {
            let condition = q.numbers("delta")?.into_iter().zip(q.numbers("nu")?).map(|(delta, nu)| {
                let (logarithm, slope) = if nu.is_finite() {
                    ((nu + 3.0) / 2.0 * log1p(delta / nu), (nu + 3.0) / 2.0 / (nu + delta))
                } else {
                    (delta / 2.0, 0.5)
                };
                exp(-logarithm) * (ROUNDINGS + 2.0 * slope * delta + 2.0 * logarithm)
            });
            single(condition.collect::<Array1<f64>>().into_dyn())
        }
        "density" | "image-affine" | "image-exact" | "image-cutoff" | "density-cutoff" => {
            let scene = Scene::new(q)?;
            // Sequential sums of M terms err like √M with rounding to nearest.
            let depth = (scene.primitives.len() as f64).sqrt();
            let parts = scene.primitives.iter().map(|one| scene.values(one, depth));
            single(parts.fold(Array3::zeros(scene.shape()), |sum, part| sum + part).into_dyn())
        }
        "projected-kernel-affine" | "projected-kernel-exact" => {
            let scene = Scene::new(q)?;
            let parts: Vec<_> = scene.primitives.iter().map(|one| scene.values(one, 0.0)).collect();
            let views: Vec<_> = parts.iter().map(|part| part.view()).collect();
            single(ndarray::stack(Axis(0), &views).expect("arrays of one shape").into_dyn())
        }
        "gradient-density" | "gradient-image-affine" | "gradient-image-exact" => {
            let (scene, cotangent) = (Scene::new(q)?, q.array::<Ix3>("cotangent")?);
            let mut sums = Parameters::zeros(scene.primitives.len());
            for (i, one) in scene.primitives.iter().enumerate() {
                let all = scene.slopes(one, &cotangent);
                sums.mean[i].copy_from_slice(&all[..3]);
                sums.scale[i].copy_from_slice(&all[3..6]);
                sums.quaternion[i].copy_from_slice(&all[6..10]);
                (sums.density[i], sums.nu[i]) = (all[10], all[11]);
            }
            Ok(super::outputs::gradient(&sums).remove("grad").unwrap_or_default())
        }
        _ => Ok(Conditions::new()),
    }
}

#[cfg(test)]
mod tests {
    use super::STAGES;
    use crate::answers::{self, answer};
    use crate::check::{Options, Report, Status, check};
    use crate::manifest::{Case, Level, Vectors};
    use crate::question::Question;
    use crate::{Format, Tolerances};
    use std::path::Path;
    use trgs_core::numeric::Precision;

    const SCENES: [&str; 6] = [
        "density/cone-offset",
        "projected-kernel-affine/cone-centred",
        "projected-kernel-exact/cone-centred",
        "image-affine/cone-offset",
        "image-exact/cone-offset",
        "image-exact/parallel-offset",
    ];

    fn judge(vectors: &Vectors, folder: &Path, format: Format) -> Report {
        let today = crate::waivers::today();
        let options = Options { format, level: Level::Stress, stages: &[], waivers: &[], today, commit: None };
        check(vectors, &Tolerances::embedded().unwrap(), folder, &options).unwrap()
    }

    /// The truth of a case in single precision, with the element changed that is faintest above 1e-18 of the peak.
    fn write_with_a_wrong_tail(vectors: &Vectors, case: &Case, factor: f64, folder: &Path) -> f64 {
        let (role, file) = case.outputs.first_key_value().unwrap();
        let mut array = vectors.arrays(file).unwrap().remove("").unwrap().mapv(|x| Format::F32.round(x));
        let peak = array.iter().fold(0.0_f64, |peak, x| peak.max(x.abs()));
        const FAINT: f64 = 1e-18;
        let seen = array.iter_mut().filter(|x| x.abs() > FAINT * peak);
        let faintest = seen.min_by(|a, b| a.abs().total_cmp(&b.abs())).unwrap();
        let share = faintest.abs() / peak;
        *faintest *= factor;
        answers::write(folder, case, &[(role.clone(), [(String::new(), array)].into())].into()).unwrap();
        share
    }

    #[test]
    fn a_thousandth_of_a_faint_tail_is_accused_by_its_element_alone() {
        let vectors = Vectors::embedded().unwrap();
        let cases = || vectors.manifest.cases.iter().filter(|case| SCENES.contains(&case.id.as_str()));
        assert_eq!(cases().count(), SCENES.len());
        for (factor, status) in [(1.0, Status::Passed), (1.001, Status::Failed)] {
            let folder = tempfile::tempdir().unwrap();
            for case in cases() {
                let share = write_with_a_wrong_tail(&vectors, case, factor, folder.path());
                println!("{}: the faintest element has {share:e} of the peak", case.id);
            }
            let report = judge(&vectors, folder.path(), Format::F32);
            for case in cases() {
                let result = report.results.iter().find(|result| result.id == case.id).unwrap();
                assert_eq!(result.status, status, "{} times {factor}: {:?}", case.id, result.parts);
                let norms: Vec<_> = result.parts[0].exceeded.iter().map(|excess| excess.norm).collect();
                assert_eq!(norms, if factor == 1.0 { vec![] } else { vec!["element"] }, "{}", case.id);
            }
        }
    }

    #[test]
    fn this_programs_answers_are_within_the_limits_of_their_elements() {
        let vectors = Vectors::embedded().unwrap();
        for (precision, format) in [(Precision::F32, Format::F32), (Precision::F64, Format::F64)] {
            let folder = tempfile::tempdir().unwrap();
            let cases = vectors.manifest.cases.iter().filter(|case| STAGES.contains(&case.stage.as_str()));
            for case in cases {
                let outputs = answer(&Question::new(&vectors, case).unwrap(), precision).unwrap();
                answers::write(folder.path(), case, &outputs).unwrap();
            }
            let report = judge(&vectors, folder.path(), format);
            let parts = report.results.iter().flat_map(|result| result.parts.iter().map(move |part| (result, part)));
            let failed = parts.clone().filter(|(_, part)| part.status == Status::Failed);
            let failed: Vec<_> = failed.map(|(result, part)| (&result.id, &part.output, &part.exceeded)).collect();
            assert!(failed.is_empty(), "{failed:?}");
            assert!(parts.filter(|(_, part)| part.element.is_some()).count() > 200, "elements with a condition");
        }
    }

    #[test]
    fn every_stage_says_whether_its_elements_have_a_limit() {
        let tolerances = Tolerances::embedded().unwrap();
        for stage in answers::STAGES {
            let rows: Vec<_> = tolerances.elements.iter().filter(|row| row.stages.iter().any(|s| s == stage)).collect();
            assert!(!rows.is_empty(), "no [[element]] for {stage}");
            for row in rows {
                assert_eq!(
                    row.factor.is_some(),
                    STAGES.contains(&stage),
                    "{stage}: a factor where there is a condition"
                );
                assert!(row.reason.len() > 20, "{stage}: a reason, not {:?}", row.reason);
            }
        }
    }
}
