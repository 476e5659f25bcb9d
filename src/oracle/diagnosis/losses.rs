//! Losses of images and blocks with one mistake; gradients by differences.

use super::Suspect;
use crate::question::Question;
use ndarray::{Array1, Array2, Array3, ArrayD, Ix2, Ix3};
use trgs_core::error::Result;
use trgs_core::numeric::elementary::exp;

/// The mean similarity with changes.
#[derive(Clone, Copy)]
struct Ssim {
    radius: i32,
    sigma: f64,
    constants: [f64; 2],
    border: Border,
    /// Factor on variances and covariance.
    variance: f64,
}

/// What a window finds beyond the image.
#[derive(Clone, Copy, PartialEq)]
enum Border {
    Zeros,
    /// Weights renormalised over the image.
    Renormalised,
    Reflected,
    Repeated,
    /// Pixels whose window leaves the image are left out.
    Valid,
}

const RIGHT: Ssim = Ssim { radius: 5, sigma: 1.5, constants: [1e-4, 9e-4], border: Border::Zeros, variance: 1.0 };

/// Names and changes of SSIM.
fn similarities() -> [(&'static str, Ssim); 12] {
    [
        ("SSIM without padding: only windows inside of the image", Ssim { border: Border::Valid, ..RIGHT }),
        ("SSIM with the window renormalised at the border", Ssim { border: Border::Renormalised, ..RIGHT }),
        ("SSIM with a reflected border", Ssim { border: Border::Reflected, ..RIGHT }),
        ("SSIM with a repeated border", Ssim { border: Border::Repeated, ..RIGHT }),
        ("SSIM with a uniform window of 11", Ssim { sigma: f64::INFINITY, ..RIGHT }),
        ("SSIM with a uniform window of 7", Ssim { radius: 3, sigma: f64::INFINITY, ..RIGHT }),
        ("SSIM with a window of 7 pixels", Ssim { radius: 3, ..RIGHT }),
        ("SSIM with σ² = 1.5", Ssim { sigma: 1.224_744_871_391_589, ..RIGHT }),
        ("SSIM with C1 and C2 not squared", Ssim { constants: [0.01, 0.03], ..RIGHT }),
        ("SSIM with C1 and C2 exchanged", Ssim { constants: [9e-4, 1e-4], ..RIGHT }),
        ("SSIM with C1 and C2 for a range of 255", Ssim { constants: [6.5025, 58.5225], ..RIGHT }),
        ("SSIM with unbiased variances", Ssim { variance: 121.0 / 120.0, ..RIGHT }),
    ]
}

impl Ssim {
    /// The weights of the output positions along an axis of n pixels `[output, input]`.
    fn matrix(&self, n: usize) -> Array2<f64> {
        let weight = |k: i32| exp(-f64::from(k * k) / (2.0 * self.sigma * self.sigma));
        let total: f64 = (-self.radius..=self.radius).map(weight).sum();
        let (length, radius) = (n as i32, self.radius);
        let outputs: Vec<i32> = match self.border {
            Border::Valid => (radius..length - radius).collect(),
            _ => (0..length).collect(),
        };
        let mut matrix = Array2::zeros((outputs.len(), n));
        for (row, &at) in outputs.iter().enumerate() {
            for k in -radius..=radius {
                let mut place = at + k;
                if self.border == Border::Reflected && n > 1 {
                    let period = 2 * (length - 1);
                    place = place.rem_euclid(period);
                    place = place.min(period - place);
                }
                if self.border == Border::Repeated {
                    place = place.clamp(0, length - 1);
                }
                if (0..length).contains(&place) {
                    matrix[[row, place as usize]] += weight(k) / total;
                }
            }
        }
        if self.border == Border::Renormalised {
            matrix.rows_mut().into_iter().for_each(|mut row| row /= row.sum());
        }
        matrix
    }

    fn value(&self, p: &Array2<f64>, t: &Array2<f64>, [rows, columns]: [&Array2<f64>; 2]) -> f64 {
        let blur = |image: &Array2<f64>| rows.dot(image).dot(&columns.t());
        let (a, b) = (blur(p), blur(t));
        let (aa, bb, ab) = (blur(&(p * p)), blur(&(t * t)), blur(&(p * t)));
        let [c1, c2] = self.constants;
        let mut total = 0.0;
        for (index, &a) in a.indexed_iter() {
            let b = b[index];
            let covariance = self.variance * (ab[index] - a * b);
            let variances = self.variance * (aa[index] - a * a + bb[index] - b * b);
            total += (2.0 * a * b + c1) * (2.0 * covariance + c2) / ((a * a + b * b + c1) * (variances + c2));
        }
        total / a.len() as f64
    }

    /// The value, or its gradient.
    fn answer(&self, role: &str, p: &Array2<f64>, t: &Array2<f64>) -> ArrayD<f64> {
        let (rows, columns) = (self.matrix(p.nrows()), self.matrix(p.ncols()));
        let value = |p: &Array2<f64>| self.value(p, t, [&rows, &columns]);
        if role == "value" { Array1::from(vec![value(p)]).into_dyn() } else { differences(p, value).into_dyn() }
    }
}

/// The gradient by central differences of order four.
fn differences(p: &Array2<f64>, value: impl Fn(&Array2<f64>) -> f64) -> Array2<f64> {
    let step = 1e-3 * p.iter().fold(0.1_f64, |peak, x| peak.max(x.abs()));
    Array2::from_shape_fn(p.raw_dim(), |index| {
        let at = |by: f64| {
            let mut moved = p.clone();
            moved[index] += by * step;
            value(&moved)
        };
        (8.0 * (at(1.0) - at(-1.0)) - (at(2.0) - at(-2.0))) / (12.0 * step)
    })
}

/// `sign(x)`, and 0 for 0.
fn sign(x: f64) -> f64 {
    if x == 0.0 { 0.0 } else { x.signum() }
}

/// Suspects of the stages `loss-l1`, `loss-ssim` and `loss-image`.
pub(super) fn images(q: &Question, role: &str) -> Result<Vec<Suspect>> {
    let (p, t) = (q.array::<Ix2>("prediction")?, q.array::<Ix2>("target")?);
    let n = p.len() as f64;
    let d = &p - &t;
    let pick = |value: f64, gradient: Array2<f64>| {
        if role == "value" { Array1::from(vec![value]).into_dyn() } else { gradient.into_dyn() }
    };
    let l1 = || pick(d.mapv(f64::abs).sum() / n, d.mapv(|x| sign(x) / n));
    let l2 = || pick(d.mapv(|x| x * x).sum() / n, d.mapv(|x| 2.0 * x / n));
    let signs = || pick(d.mapv(f64::abs).sum() / n, d.mapv(|x| f64::from(u8::from(x >= 0.0)) * 2.0 / n - 1.0 / n));
    let right = RIGHT.answer(role, &p, &t);
    let one = if role == "value" { 1.0 } else { 0.0 };
    let sum = |a: &ArrayD<f64>, b: ArrayD<f64>| a + &b;
    let mut all = Vec::new();
    match q.stage.as_str() {
        "loss-l1" => {
            all.push(Suspect::new("a sum instead of a mean", l1() * n));
            all.push(Suspect::new("the mean square for the mean absolute difference", l2()));
            all.push(Suspect::new("a slope where prediction and target are equal", signs()));
            all.push(Suspect::new("target minus prediction", pick(d.sum() / -n, d.mapv(|x| -sign(x) / n))));
            all.push(Suspect::new("the difference without its absolute value", pick(d.sum() / n, d.mapv(|_| 1.0 / n))));
        }
        "loss-ssim" => {
            all.push(Suspect::new("1 - SSIM for SSIM", right.mapv(|x| one - x)));
            let of = |(name, ssim): (&str, Ssim)| Suspect::new(name, ssim.answer(role, &p, &t));
            all.extend(similarities().into_iter().map(of));
        }
        _ => {
            let weight = q.setting("weight")?;
            let dssim = right.mapv(|x| one - x);
            let of = |name: &str, a: f64, b: f64| Suspect::new(name, sum(&(l1() * a), &dssim * b));
            all.push(of("(1 - weight)·L1 + weight·(1 - SSIM)", 1.0 - weight, weight));
            all.push(of("a weight of 0.2", 1.0, 0.2));
            all.push(of("½·(1 - SSIM)", 1.0, weight / 2.0));
            all.push(of("L1 alone", 1.0, 0.0));
            all.push(of("the weight left out", 1.0, 1.0));
            all.push(of("weight and 1 exchanged", weight, 1.0));
            all.push(Suspect::new("L1 + weight·SSIM", sum(&l1(), &right * weight)));
            all.push(Suspect::new("the mean square for L1", sum(&l2(), &dssim * weight)));
            let of = |(name, ssim): (&str, Ssim)| {
                let other = ssim.answer(role, &p, &t).mapv(|x| weight * (one - x));
                Suspect::new(name, sum(&l1(), other))
            };
            all.extend(similarities().into_iter().map(of));
        }
    }
    Ok(all)
}

/// Suspects of the stage `loss-tv`.
pub(super) fn variation(q: &Question, role: &str) -> Result<Vec<Suspect>> {
    let block = q.array::<Ix3>("block")?;
    let voxels = block.len() as f64;
    let (x, y, z) = block.dim();
    let count = ((x - 1) * y * z + x * (y - 1) * z + x * y * (z - 1)) as f64;
    let [mut absolute, mut square, mut wrapped, mut isotropic] = [0.0; 4];
    let mut slopes = [(); 4].map(|()| Array3::<f64>::zeros(block.raw_dim()));
    for ((i, j, k), &here) in block.indexed_iter() {
        let here_index = [i, j, k];
        let mut steps: Vec<([usize; 3], f64)> = Vec::new();
        for axis in 0..3 {
            let length = block.shape()[axis];
            let mut next = here_index;
            next[axis] = (next[axis] + 1) % length;
            let step = block[next] - here;
            (wrapped, slopes[2][next], slopes[2][here_index]) =
                (wrapped + step.abs(), slopes[2][next] + sign(step), slopes[2][here_index] - sign(step));
            if next[axis] > here_index[axis] {
                steps.push((next, step));
            }
        }
        let root = steps.iter().map(|(_, step)| step * step).sum::<f64>().sqrt();
        isotropic += root;
        for (next, step) in steps {
            (absolute, square) = (absolute + step.abs(), square + step * step);
            let each = [sign(step), 2.0 * step, 0.0, if root > 0.0 { step / root } else { 0.0 }];
            for (slope, by) in slopes.iter_mut().zip(each) {
                slope[next] += by;
                slope[here_index] -= by;
            }
        }
    }
    let pick = |value: f64, slope: &Array3<f64>, by: f64| {
        if role == "value" { Array1::from(vec![value / by]).into_dyn() } else { (slope / by).into_dyn() }
    };
    Ok(vec![
        Suspect::new("a sum instead of a mean", pick(absolute, &slopes[0], 1.0)),
        Suspect::new("the mean over voxels instead of differences", pick(absolute, &slopes[0], voxels)),
        Suspect::new("squares of the differences", pick(square, &slopes[1], count)),
        Suspect::new("the block continued periodically", pick(wrapped, &slopes[2], 3.0 * voxels)),
        Suspect::new("the isotropic total variation", pick(isotropic, &slopes[3], voxels)),
        Suspect::new(
            "the isotropic total variation over the number of differences",
            pick(isotropic, &slopes[3], count),
        ),
    ])
}

#[cfg(test)]
mod tests {
    use super::super::of_part;
    use super::*;
    use crate::answers::answer;
    use crate::format::Format;
    use crate::manifest::Vectors;
    use trgs_core::numeric::Precision;

    fn question(id: &str) -> Question {
        let vectors = Vectors::embedded().unwrap();
        let case = vectors.manifest.cases.iter().find(|case| case.id == id).unwrap();
        Question::new(&vectors, case).unwrap()
    }

    fn norm(a: &ArrayD<f64>) -> f64 {
        a.iter().map(|x| x * x).sum::<f64>().sqrt()
    }

    #[test]
    fn without_a_mistake_ssim_is_that_of_the_library() {
        let q = question("loss-ssim/random");
        let (p, t) = (q.array::<Ix2>("prediction").unwrap(), q.array::<Ix2>("target").unwrap());
        let right = answer(&q, Precision::F64).unwrap();
        for role in ["value", "gradient"] {
            let (own, right) = (RIGHT.answer(role, &p, &t), &right[role][""]);
            within!(super::super::distance(&own, right) / norm(right), "{role}");
        }
    }

    #[test]
    fn each_mistake_is_named_by_its_gradient() {
        for id in ["loss-l1/random", "loss-ssim/random", "loss-image/range-eight", "loss-tv/random"] {
            let q = question(id);
            let right = answer(&q, Precision::F64).unwrap().remove("gradient").unwrap().remove("").unwrap();
            let suspects =
                if q.stage == "loss-tv" { variation(&q, "gradient").unwrap() } else { images(&q, "gradient").unwrap() };
            assert!(suspects.len() >= 5, "{id}: {} mistakes", suspects.len());
            for suspect in suspects.iter().filter(|suspect| suspect.array != right) {
                let found = of_part(&q, ("gradient", ""), &right, &suspect.array, Format::F64, 1e-13);
                // Without an answer for this case the name is open; a name of another mistake is wrong.
                let same = |name: &str| suspects.iter().any(|s| s.name == name && s.array == suspect.array);
                let named =
                    found.as_deref().is_none_or(|found| found.split(", or ").any(|n| n == suspect.name || same(n)));
                assert!(named, "{id}: {found:?} for {}", suspect.name);
            }
        }
    }
}
