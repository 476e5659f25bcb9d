//! A primitive in one view: its quadratic form on the detector, the box it reaches, and the way back.
//!
//! With the whitened directions `p0 = M·d0`, `pᵤ = M·u`, `pᵥ = M·v` of the ray through the centre and of the detector's
//! axes, the form of `[Eq. 4]` is the squared part of `α·pᵤ + β·pᵥ` perpendicular to p0. Its coefficients are taken from
//! cross products, and its determinant from `det M`, so that needles lose no digits to a difference of squares.

use super::Projection;
use super::kernel::{Plane, Sums};
use super::shape::{Shape, ShapeGradient};
use crate::scene::{Beam, Scanner, View};
use glam::{DMat3, DVec2, DVec3};
use std::ops::Range;

/// Primitives whose centre is nearer to the source than this fraction of `dso`, or behind it, are left out.
pub(super) const NEAR: f64 = 0.01;

/// A primitive on the detector of one view.
#[derive(Clone, Debug, Default)]
pub(super) struct Footprint {
    pub(super) plane: Plane,
    /// Rows of the support, empty if the primitive is not seen.
    pub(super) rows: Range<usize>,
    /// Columns of the support.
    pub(super) columns: Range<usize>,
    geometry: Geometry,
}

/// What the way back needs.
#[derive(Clone, Copy, Debug, Default)]
struct Geometry {
    /// The centre's ray (world axes), of length 1 along the view's axis.
    d0: DVec3,
    /// `(â, b̂)` of that ray.
    slope: DVec2,
    /// 1/depth of the centre; 0 for a parallel beam.
    kappa: f64,
    a0: f64,
    /// `uᵀΣ⁻¹d0`, `vᵀΣ⁻¹d0`.
    g: DVec2,
    /// Schur complement: δ = c₀α² + 2c₁αβ + c₂β².
    c: [f64; 3],
}

impl Geometry {
    /// `c·x` as a symmetric matrix.
    fn times_c(&self, x: DVec2) -> DVec2 {
        DVec2::new(self.c[0] * x.x + self.c[1] * x.y, self.c[1] * x.x + self.c[2] * x.y)
    }
}

impl Footprint {
    /// The primitive as the view sees it.
    pub(super) fn new(shape: &Shape, scanner: &Scanner, view: &View, projection: Projection) -> Self {
        let detector = &scanner.detector;
        let m = view.to_camera(shape.mean);
        let (kappa, slope, step_u, step_v) = match scanner.beam {
            Beam::Cone { dso, dsd } => {
                if m.z <= NEAR * dso {
                    return Self::default();
                }
                let kappa = 1.0 / m.z;
                (
                    kappa,
                    DVec2::new(m.x * kappa, m.y * kappa),
                    detector.pitch_u * m.z / dsd,
                    detector.pitch_v * m.z / dsd,
                )
            }
            Beam::Parallel { .. } => (0.0, DVec2::ZERO, detector.pitch_u, detector.pitch_v),
        };
        let Some((u, v)) = scanner.project(m) else { return Self::default() };
        let (row_centre, column_centre) = detector.pixel(u, v);
        let d0 = view.w + view.u * slope.x + view.v * slope.y;
        let (p0, pu, pv) = (shape.whitening * d0, shape.whitening * view.u, shape.whitening * view.v);
        let a0 = p0.length_squared();
        let g = DVec2::new(pu.dot(p0), pv.dot(p0));
        let (cu, cv) = (p0.cross(pu), p0.cross(pv));
        let c = [cu.length_squared() / a0, cu.dot(cv) / a0, cv.length_squared() / a0];
        let b = c[2].sqrt();
        let unit_root = shape.unit.sqrt();
        let hs = g * (kappa / a0);
        let mut plane = Plane {
            row_centre,
            column_centre,
            row_step: step_v,
            column_step: step_u,
            b: b / unit_root,
            ab: c[1] / (b * unit_root),
            a: shape.determinant() / (a0.sqrt() * b * unit_root),
            q: (shape.nu + 2.0) / 2.0,
            weight: shape.density * shape.line.0 / a0.sqrt(),
            limit: shape.limit,
            ..Plane::default()
        };
        let geometry = Geometry { d0, slope, kappa, a0, g, c };
        let (s, k) = match projection {
            Projection::Exact => (hs, kappa * kappa / a0),
            Projection::Affine => (DVec2::ZERO, 0.0),
        };
        plane.h_column = s.x;
        plane.h_row = s.y;
        plane.k = k * shape.unit;
        if projection == Projection::Affine {
            plane.weight *= d0.length();
        }
        let (rows, columns) = support(&plane, c, s, k, shape.limit * shape.unit, detector.rows, detector.columns);
        Self { plane, rows, columns, geometry }
    }

    /// Whether any pixel can see it.
    pub(super) fn is_empty(&self) -> bool {
        self.rows.is_empty() || self.columns.is_empty()
    }

    /// From sums over pixels to the gradient of mean, precision matrix, density and ν. Mirrors [`Self::new`].
    pub(super) fn pull_back(&self, shape: &Shape, view: &View, projection: Projection, sums: &Sums) -> ShapeGradient {
        let Geometry { d0, slope, kappa, a0, g, c } = self.geometry;
        let plane = &self.plane;
        let weight = plane.weight;
        // To δ: Σ G αα, αβ, ββ and Σ G α, β; to the slopes of h; to k; all with the weight in.
        let [_, ga, gb, gaa, gab, gbb] = sums.distance.map(|x| x * weight / shape.unit);
        let [h1, ha, hb] = sums.h.map(|x| 2.0 * x * weight);
        let d_k = sums.k * weight * shape.unit;
        let d_hs = DVec2::new(ha, hb);
        let hs = DVec2::new(plane.h_column, plane.h_row);

        // The weight: ρ · line · a0^-½ (· |d0| if affine).
        let d_weight = sums.value;
        let mut d_a0 = -0.5 * weight * d_weight / a0;
        let per_density = shape.line.0 / a0.sqrt() * if projection == Projection::Affine { d0.length() } else { 1.0 };

        // ν at constant δ: the exponent's half, the 1/ν's half (Σ a·x, read off the moments), and the line integral.
        let d_nu = if shape.nu.is_finite() {
            let moment = c[0] * gaa + 2.0 * c[1] * gab + c[2] * gbb;
            let d_x = (d_k * plane.k / shape.unit - moment) / shape.nu;
            -0.5 * std::f64::consts::LN_2 * sums.log * weight + d_x + shape.line.1 / shape.line.0 * weight * d_weight
        } else {
            0.0
        };

        // The centre's place in the plane: α = a·m_z - m_x and β = b·m_z - m_y at a fixed pixel.
        let d_offset = DVec2::new(2.0 * (c[0] * ga + c[1] * gb), 2.0 * (c[1] * ga + c[2] * gb)) + hs * h1;
        let mut d_m = DVec3::new(-d_offset.x, -d_offset.y, 0.0);
        if kappa > 0.0 {
            let moment = 2.0 * (c[0] * gaa + 2.0 * c[1] * gab + c[2] * gbb) + hs.dot(d_hs);
            d_m.z = slope.dot(d_offset) + kappa * moment;
        }

        // The form's coefficients: a displacement x in the plane is e = T x in space, T = [u v] - d0 gᵀ/a0.
        let (tu, tv) = (view.u - d0 * (g.x / a0), view.v - d0 * (g.y / a0));
        let mut precision = symmetric(tu, tu, gaa) + symmetric(tu, tv, 2.0 * gab) + symmetric(tv, tv, gbb);
        let dc_g = DVec2::new(gaa * g.x + gab * g.y, gab * g.x + gbb * g.y);
        let mut y = dc_g * (-2.0 / a0);
        let mut along_g = 0.0;
        if projection == Projection::Exact {
            y += d_hs * (kappa / a0);
            precision += symmetric(tu * d_hs.x + tv * d_hs.y, d0, kappa / a0);
            along_g = -kappa * g.dot(d_hs) / (a0 * a0);
            d_a0 -= kappa * kappa * d_k / (a0 * a0);
        }
        precision += symmetric(d0, d0, d_a0);

        // The ray through the centre, d0 = m/m_z.
        if kappa > 0.0 {
            let mut d_slope = self.geometry.times_c(y) + g * (along_g + 2.0 * d_a0);
            if projection == Projection::Affine {
                d_slope += slope * (weight * d_weight / d0.length_squared());
            } else {
                let d_kappa = g.dot(d_hs) / a0 + 2.0 * kappa * d_k / a0;
                d_m.z -= kappa * kappa * d_kappa;
            }
            d_m.x += kappa * d_slope.x;
            d_m.y += kappa * d_slope.y;
            d_m.z -= kappa * slope.dot(d_slope);
        }
        ShapeGradient {
            mean: view.u * d_m.x + view.v * d_m.y + view.w * d_m.z,
            precision,
            density: per_density * d_weight,
            nu: d_nu,
        }
    }
}

/// `factor · (a bᵀ + b aᵀ)/2`.
pub(super) fn symmetric(a: DVec3, b: DVec3, factor: f64) -> DMat3 {
    let column = |k: usize| (a * b[k] + b * a[k]) * (0.5 * factor);
    DMat3::from_cols(column(0), column(1), column(2))
}

/// Rows and columns of the pixels that the support can reach `[X2]`: the exact bounding box of the conic
/// `δ ≤ cut·(h² + kδ)`, the whole detector where that is no ellipse (the support holds the source or passes beside it).
fn support(
    plane: &Plane,
    c: [f64; 3],
    s: DVec2,
    k: f64,
    cut: f64,
    rows: usize,
    columns: usize,
) -> (Range<usize>, Range<usize>) {
    let t = 1.0 / cut - k;
    let n = [t * c[0] - s.x * s.x, t * c[1] - s.x * s.y, t * c[2] - s.y * s.y];
    let determinant = n[0] * n[2] - n[1] * n[1];
    if !(t > 0.0 && n[0] > 0.0 && n[2] > 0.0 && determinant > 1e-12 * n[0] * n[2]) {
        return whole_or_needle(plane, c, s, k, cut, rows, columns);
    }
    let centre = DVec2::new(n[2] * s.x - n[1] * s.y, n[0] * s.y - n[1] * s.x) / determinant;
    let radius = 1.0 + s.dot(centre);
    let half = DVec2::new((radius * n[2] / determinant).sqrt(), (radius * n[0] / determinant).sqrt());
    (
        pixels(plane.row_centre, plane.row_step, centre.y, half.y, rows),
        pixels(plane.column_centre, plane.column_step, centre.x, half.x, columns),
    )
}

/// Without digits enough to invert the conic (needles seen from the side): affine forms still have a safe box.
fn whole_or_needle(
    plane: &Plane,
    c: [f64; 3],
    s: DVec2,
    k: f64,
    cut: f64,
    rows: usize,
    columns: usize,
) -> (Range<usize>, Range<usize>) {
    let determinant = plane.a * plane.a * plane.b * plane.b;
    if s == DVec2::ZERO && k == 0.0 && determinant > 0.0 && cut.is_finite() {
        let unit = c[2] / (plane.b * plane.b);
        let half = DVec2::new((cut * c[2] / determinant).sqrt(), (cut * c[0] / determinant).sqrt()) / unit;
        return (
            pixels(plane.row_centre, plane.row_step, 0.0, half.y, rows),
            pixels(plane.column_centre, plane.column_step, 0.0, half.x, columns),
        );
    }
    (0..rows, 0..columns)
}

/// Indices of the pixel centres within `half` of the offset `middle`, with a breath of rounding to spare.
pub(super) fn pixels(centre: f64, step: f64, middle: f64, half: f64, count: usize) -> Range<usize> {
    let slack = 1e-9 * (1.0 + half / step);
    let first = (centre + (middle - half) / step - slack).ceil().max(0.0);
    let last = (centre + (middle + half) / step + slack).floor().min(count as f64 - 1.0);
    if first > last { 0..0 } else { first as usize..last as usize + 1 }
}
