//! The equations as plainly as they can be written: f64, no SIMD, no tiles, no shared setup. The fast path is
//! tested against it. It works in the camera frame with Σ⁻¹ itself and visits every pixel for every primitive.
//!
//! A primitive whose centre lies behind the source, or nearer to it than 1/100 of `dso`, contributes nothing.
//! Quaternions are squared as they are, so their lengths must lie well between 1e-150 and 1e150.

use super::projection::{MIN_DEPTH, Projection};
use crate::geometry::{Beam, Grid, Scanner, Trajectory, View};
use crate::numeric::elementary::{exp, log1p};
use crate::primitives::{KernelKind, Parameters, Primitives, gaussian, student_t};
use glam::{DMat3, DQuat, DVec3};
use ndarray::{Array3, ArrayView3};

/// One primitive in world axes.
struct Plain {
    mean: DVec3,
    /// `Σ⁻¹ = R diag(1/s²) Rᵀ` `[Eq. 3]`.
    precision: DMat3,
    scale: DVec3,
    quaternion: [f64; 4],
    density: f64,
    nu: f64,
    /// δ beyond which nothing is seen `[X2]`.
    cut: f64,
    line: (f64, f64),
    kernel: KernelKind,
}

/// Gradient to a [`Plain`]'s mean, precision matrix, density and ν.
struct PlainGradient {
    mean: DVec3,
    precision: DMat3,
    density: f64,
    nu: f64,
}

fn rotation(q: [f64; 4]) -> DMat3 {
    DMat3::from_quat(DQuat::from_xyzw(q[1], q[2], q[3], q[0]).normalize())
}

impl Plain {
    fn new(primitives: &Primitives, i: usize, cutoff: f64) -> Self {
        let p = &primitives.parameters;
        let scale = DVec3::from_array(p.scale[i]);
        let r = rotation(p.quaternion[i]);
        let nu = p.nu[i];
        let bits = student_t::bits(cutoff);
        let (line, cut) = match primitives.kernel {
            KernelKind::StudentT => (student_t::line_integral(nu), student_t::reach(nu, bits)),
            KernelKind::Gaussian => ((gaussian::line_integral(), 0.0), gaussian::reach(bits)),
        };
        Self {
            mean: DVec3::from_array(p.mean[i]),
            precision: r * DMat3::from_diagonal(1.0 / (scale * scale)) * r.transpose(),
            scale,
            quaternion: p.quaternion[i],
            density: p.density[i],
            nu,
            cut,
            line,
            kernel: primitives.kernel,
        }
    }

    /// `(1+δ/ν)^-((ν+n)/2)` or `exp(-δ/2)`, and its derivatives to δ and ν. n = 3 in space, 2 on the detector.
    fn profile(&self, delta: f64, n: f64) -> (f64, f64, f64) {
        match self.kernel {
            KernelKind::Gaussian => {
                let value = exp(-delta / 2.0);
                (value, -value / 2.0, 0.0)
            }
            KernelKind::StudentT => {
                let (q, x) = ((self.nu + n) / 2.0, delta / self.nu);
                let value = exp(-q * log1p(x));
                let d_delta = -q / self.nu * value / (1.0 + x);
                (value, d_delta, -0.5 * log1p(x) * value - d_delta * x)
            }
        }
    }

    /// The form of one ray `[Eq. 4]`, `[X1]`: its direction, A, and the
    /// displacement e from the centre at which δ = eᵀΣ⁻¹e is taken. `None` behind the source.
    fn ray(&self, view: &View, row: usize, column: usize, projection: Projection) -> Option<Ray> {
        let m = view.to_camera(self.mean);
        let (u, v) = view.detector.position(row as f64, column as f64);
        let (alpha, beta, kappa, d0) = match view.beam {
            Beam::Cone { dso, dsd } => {
                if m.z <= MIN_DEPTH * dso {
                    return None;
                }
                (u / dsd * m.z - m.x, v / dsd * m.z - m.y, 1.0 / m.z, m / m.z)
            }
            Beam::Parallel { .. } => (u - m.x, v - m.y, 0.0, DVec3::Z),
        };
        let world = |camera: DVec3| view.u * camera.x + view.v * camera.y + view.w * camera.z;
        let (offset, d0) = (world(DVec3::new(alpha, beta, 0.0)), world(d0));
        let a0 = d0.dot(self.precision * d0);
        let l = d0.dot(self.precision * offset);
        match projection {
            Projection::Affine => {
                let e = offset - d0 * (l / a0);
                Some(Ray { direction: d0, a: a0, e, d0, kappa })
            }
            Projection::Exact => {
                let d = d0 + offset * kappa;
                let a = d.dot(self.precision * d);
                // The point of the ray nearest to the centre: e = offset + σ·d, d·Σ⁻¹e = 0.
                let sigma = -d.dot(self.precision * offset) / a;
                Some(Ray { direction: d, a, e: offset + d * sigma, d0, kappa })
            }
        }
    }

    fn parameter_gradient(&self, gradient: &PlainGradient, i: usize, out: &mut Parameters) {
        out.mean[i] = gradient.mean.to_array();
        out.density[i] = gradient.density;
        out.nu[i] = gradient.nu;
        // Σ⁻¹ = Σₖ rₖ rₖᵀ / sₖ².
        let r = rotation(self.quaternion);
        let d = gradient.precision;
        for k in 0..3 {
            out.scale[i][k] = -2.0 / (self.scale[k] * self.scale[k] * self.scale[k]) * r.col(k).dot(d * r.col(k));
        }
        // dR = 2 D R Λ; then each entry of R(q/|q|) by the quaternion, and the normalisation's projection.
        let d_r = d * r * DMat3::from_diagonal(2.0 / (self.scale * self.scale));
        let norm = self.quaternion.iter().map(|x| x * x).sum::<f64>().sqrt();
        let [w, x, y, z] = self.quaternion.map(|c| c / norm);
        let derivative = [
            [[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]],
            [[0.0, y, z], [y, -2.0 * x, -w], [z, w, -2.0 * x]],
            [[-2.0 * y, x, w], [x, 0.0, z], [-w, z, -2.0 * y]],
            [[-2.0 * z, -w, x], [w, -2.0 * z, y], [x, y, 0.0]],
        ];
        let d_unit = derivative.map(|rows| {
            (0..3)
                .flat_map(|row| (0..3).map(move |column| (row, column)))
                .map(|(row, column)| 2.0 * rows[row][column] * d_r.col(column)[row])
                .sum::<f64>()
        });
        let radial = d_unit[0] * w + d_unit[1] * x + d_unit[2] * y + d_unit[3] * z;
        for (k, unit) in [w, x, y, z].into_iter().enumerate() {
            out.quaternion[i][k] = (d_unit[k] - radial * unit) / norm;
        }
    }
}

/// What one pixel's ray and one primitive have to do with each other, in world axes.
struct Ray {
    /// Direction whose length and A count: d (exact) or d0 (affine), of length 1 along the view's axis.
    direction: DVec3,
    /// `directionᵀ Σ⁻¹ direction`.
    a: f64,
    /// From the centre to the point at which δ is taken.
    e: DVec3,
    d0: DVec3,
    kappa: f64,
}

fn outer(a: DVec3, b: DVec3) -> DMat3 {
    DMat3::from_cols(a * b.x, a * b.y, a * b.z)
}

/// Projections `[view, v, u]` `[Eq. 4]`, `[Eq. 5]`, `[X1]`.
pub fn forward<'a>(
    primitives: &Primitives,
    scanner: &Scanner,
    views: impl Into<Trajectory<'a>>,
    projection: Projection,
    cutoff: f64,
) -> Array3<f64> {
    let views = views.into().views(scanner);
    Array3::from_shape_fn((views.len(), scanner.detector.rows, scanner.detector.columns), |(view, row, column)| {
        let one = |i: usize| {
            let p = Plain::new(primitives, i, cutoff);
            let Some(ray) = p.ray(&views[view], row, column, projection) else { return 0.0 };
            let delta = ray.e.dot(p.precision * ray.e);
            if delta > p.cut {
                return 0.0;
            }
            p.density * p.line.0 * ray.direction.length() / ray.a.sqrt() * p.profile(delta, 2.0).0
        };
        (0..primitives.len()).map(one).sum()
    })
}

/// Gradient of `Σ cotangent·projection` to the physical parameters `[Eq. 4]`, `[X1]`.
///
/// δ is stationary in the position along the ray, so `∂δ/∂Σ⁻¹ = e eᵀ` and moving the centre moves e alone.
pub fn vjp<'a>(
    primitives: &Primitives,
    scanner: &Scanner,
    views: impl Into<Trajectory<'a>>,
    projection: Projection,
    cutoff: f64,
    cotangent: ArrayView3<'_, f64>,
) -> Parameters {
    let views = views.into().views(scanner);
    let mut out = Parameters::zeros(primitives.len());
    for i in 0..primitives.len() {
        let p = Plain::new(primitives, i, cutoff);
        let mut sum = PlainGradient { mean: DVec3::ZERO, precision: DMat3::ZERO, density: 0.0, nu: 0.0 };
        for ((view, row, column), &d_value) in cotangent.indexed_iter() {
            let view = &views[view];
            let Some(ray) = p.ray(view, row, column, projection) else { continue };
            let pe = p.precision * ray.e;
            let delta = ray.e.dot(pe);
            if delta > p.cut {
                continue;
            }
            let (profile, slope, slope_nu) = p.profile(delta, 2.0);
            let front = ray.direction.length() / ray.a.sqrt();
            let value = p.density * p.line.0 * front * profile;
            let d_delta = d_value * p.density * p.line.0 * front * slope;
            let d_a = -0.5 * d_value * value / ray.a;
            sum.density += d_value * p.line.0 * front * profile;
            sum.nu += d_value * p.density * front * (p.line.1 * profile + p.line.0 * slope_nu);
            sum.precision += outer(ray.e, ray.e) * d_delta + outer(ray.direction, ray.direction) * d_a;
            sum.mean += match projection {
                // The pixel's ray stays where it is; the centre moves away from its nearest point.
                Projection::Exact => pe * (-2.0 * d_delta),
                Projection::Affine => affine_mean(&p, &ray, view, d_delta, d_a, d_value * value),
            };
        }
        p.parameter_gradient(&sum, i, &mut out);
    }
    out
}

/// The affine form's gradient to the centre: the direction of integration d0 = m/m_z moves with it, and so does the plane.
fn affine_mean(p: &Plain, ray: &Ray, view: &View, d_delta: f64, d_a: f64, d_log: f64) -> DVec3 {
    let pe = p.precision * ray.e;
    // e = offset + σ·d0 with offset = m_z·(pixel's direction) - m: its change with the centre, σ held.
    let sigma = (ray.e).dot(view.w);
    let offset = ray.e - ray.d0 * sigma;
    let pixel_direction = ray.d0 + offset * ray.kappa;
    let d_offset = pe * (2.0 * d_delta);
    let plane = |x: DVec3| x - view.w * view.w.dot(x);
    let mut mean = -plane(d_offset);
    if ray.kappa > 0.0 {
        mean += view.w * plane(pixel_direction).dot(d_offset);
        // d0: from δ (through σ·d0), from A, and from |d0|.
        let d_d0 = pe * (2.0 * d_delta * sigma)
            + p.precision * ray.d0 * (2.0 * d_a)
            + ray.d0 * (d_log / ray.d0.length_squared());
        let d_d0 = plane(d_d0);
        mean += (d_d0 - view.w * plane(ray.d0).dot(d_d0)) * ray.kappa;
    }
    mean
}

/// The field at voxel centres `[Eq. 1]`, `[Eq. 2]`.
pub fn voxelize(primitives: &Primitives, grid: &Grid, cutoff: f64) -> Array3<f64> {
    Array3::from_shape_fn(grid.shape, |(x, y, z)| {
        let one = |i: usize| {
            let p = Plain::new(primitives, i, cutoff);
            let e = grid.centre([x, y, z]) - p.mean;
            let delta = e.dot(p.precision * e);
            if delta > p.cut { 0.0 } else { p.density * p.profile(delta, 3.0).0 }
        };
        (0..primitives.len()).map(one).sum()
    })
}

/// Gradient of `Σ cotangent·volume` to the physical parameters `[Eq. 1]`.
pub fn voxelize_vjp(primitives: &Primitives, grid: &Grid, cutoff: f64, cotangent: ArrayView3<'_, f64>) -> Parameters {
    let mut out = Parameters::zeros(primitives.len());
    for i in 0..primitives.len() {
        let p = Plain::new(primitives, i, cutoff);
        let mut sum = PlainGradient { mean: DVec3::ZERO, precision: DMat3::ZERO, density: 0.0, nu: 0.0 };
        for ((x, y, z), &d_value) in cotangent.indexed_iter() {
            let e = grid.centre([x, y, z]) - p.mean;
            let pe = p.precision * e;
            let delta = e.dot(pe);
            if delta > p.cut {
                continue;
            }
            let (profile, slope, slope_nu) = p.profile(delta, 3.0);
            let d_delta = d_value * p.density * slope;
            sum.density += d_value * profile;
            sum.nu += d_value * p.density * slope_nu;
            sum.precision += outer(e, e) * d_delta;
            sum.mean += pe * (-2.0 * d_delta);
        }
        p.parameter_gradient(&sum, i, &mut out);
    }
    out
}
