//! A primitive in one view: its quadratic form on the detector, the box it reaches, and the way back.
//!
//! With the whitened directions `p0 = M·d0`, `pᵤ = M·u`, `pᵥ = M·v` of the ray through the centre and of the detector's
//! axes, the form of `[Eq. 4]` is the squared part of `α·pᵤ + β·pᵥ` perpendicular to p0. Its coefficients are taken from
//! cross products, and its determinant from `det M`, so that needles lose no digits to a difference of squares. The
//! gradient comes back in the same whitened coordinates, for the same reason.

use super::Projection;
use super::kernel::Sums;
use super::patch::Patch;
use super::plane::Plane;
use super::shape::{Shape, ShapeGradient};
use crate::numeric::elementary::{length, unit};
use crate::scene::{Beam, Scanner, View};
use glam::{DMat3, DVec2, DVec3};
use std::ops::Range;

/// Primitives whose centre is nearer to the source than this fraction of `dso`, or behind it, are left out.
pub(super) const NEAR: f64 = 0.01;

/// A range that starts at an even row, as the kernels want it.
pub(super) fn from_even(rows: Range<usize>) -> Range<usize> {
    rows.start & !1..rows.end
}

/// A primitive on the detector of one view. The default is one that is left out.
#[derive(Clone, Debug, Default)]
pub(super) struct Footprint {
    /// False for a primitive near or behind the source: it is left out of the view whatever the cutoff.
    pub(super) seen: bool,
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
    /// `(â, b̂)`: the centre's ray is d0 = (â, b̂, 1) in the camera's axes.
    slope: DVec2,
    /// 1/depth of the centre; 0 for a parallel beam.
    kappa: f64,
    /// d0, whitened; `A0 = |p0|²`.
    p0: DVec3,
    /// `uᵀΣ⁻¹d0`, `vᵀΣ⁻¹d0`.
    g: DVec2,
    /// The plane's coordinates per length: y = b·β + ab·α, z = a·α.
    b: f64,
    ab: f64,
    a: f64,
    /// Half the detector along (u, v) as lengths in the plane through the centre.
    half: DVec2,
}

impl Geometry {
    /// Orthonormal whitened axes of y and z, perpendicular to p0.
    fn axes(&self, whitened_v: DVec3) -> (DVec3, DVec3) {
        let q_y = unit(self.p0.cross(whitened_v).cross(self.p0));
        (q_y, q_y.cross(unit(self.p0)))
    }

    /// `gᵀ(α, β)` in terms of y and z.
    fn g_yz(&self) -> DVec2 {
        DVec2::new(self.g.y / self.b, (self.g.x - self.g.y * self.ab / self.b) / self.a)
    }

    /// From a vector in the (y, z) axes to its product with the detector's axes, `(pᵤ·, pᵥ·)`.
    fn on_detector(&self, yz: DVec2) -> DVec2 {
        DVec2::new(self.ab * yz.x + self.a * yz.y, self.b * yz.x)
    }
}

impl Footprint {
    /// The primitive as the view sees it.
    #[inline]
    pub(super) fn new(shape: &Shape, scanner: &Scanner, view: &View, projection: Projection) -> Self {
        let Some((mut plane, geometry, support)) = Self::prepare(shape, scanner, view, projection) else {
            return Self::default();
        };
        let [rows, columns] = [scanner.detector.rows, scanner.detector.columns];
        let (rows, columns) = match support.extents(shape.limit * shape.unit) {
            Some([row, column]) => (row.indices(rows), column.indices(columns)),
            None => (0..rows, 0..columns),
        };
        plane.bound(&rows, &columns);
        Self { seen: true, plane, rows, columns, geometry }
    }

    /// The box of the cutoff's support, as [`ViewField::support_boxes`](super::ViewField::support_boxes) has it.
    pub(super) fn support_box(shape: &Shape, scanner: &Scanner, view: &View, projection: Projection) -> [f64; 4] {
        const ALL: [f64; 2] = [f64::NEG_INFINITY, f64::INFINITY];
        const NONE: [f64; 2] = [f64::INFINITY, f64::NEG_INFINITY];
        let [[top, bottom], [left, right]] = match Self::prepare(shape, scanner, view, projection) {
            None => [NONE; 2],
            Some((_, _, support)) => {
                support.extents(shape.reach * shape.unit).map_or([ALL; 2], |both| both.map(|e| [e.low, e.high]))
            }
        };
        [top, bottom, left, right]
    }

    /// All but the rows and columns, which follow from the support. `None` for a primitive that is left out.
    #[inline(always)]
    fn prepare(
        shape: &Shape,
        scanner: &Scanner,
        view: &View,
        projection: Projection,
    ) -> Option<(Plane, Geometry, Support)> {
        let detector = &scanner.detector;
        let m = view.to_camera(shape.mean);
        let (kappa, slope, step_u, step_v) = match scanner.beam {
            Beam::Cone { dso, dsd } => {
                if m.z <= NEAR * dso {
                    return None;
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
        let (u, v) = scanner.project(m)?;
        let (row_centre, column_centre) = detector.pixel(u, v);
        let d0 = view.w + view.u * slope.x + view.v * slope.y;
        let (p0, pu, pv) = (shape.whitening * d0, shape.whitening * view.u, shape.whitening * view.v);
        let a0 = p0.length_squared();
        let g = DVec2::new(pu.dot(p0), pv.dot(p0));
        let (cu, cv) = (p0.cross(pu), p0.cross(pv));
        let c = [cu.length_squared() / a0, cu.dot(cv) / a0, cv.length_squared() / a0];
        let b = c[2].sqrt();
        let half = DVec2::new(step_u * detector.columns as f64, step_v * detector.rows as f64) / 2.0;
        let geometry =
            Geometry { slope, kappa, p0, g, b, ab: c[1] / b, a: shape.determinant() / (a0.sqrt() * b), half };
        let unit_root = shape.unit.sqrt();
        let mut plane = Plane {
            row_centre,
            column_centre,
            slant: -geometry.ab * step_u / (b * step_v),
            b: b * step_v / unit_root,
            a: geometry.a * step_u / unit_root,
            q: (shape.nu + 2.0) / 2.0,
            weight: shape.density * shape.line.0 / a0.sqrt(),
            limit: shape.limit,
            ..Plane::default()
        };
        let (mut s, mut k) = (DVec2::ZERO, 0.0);
        match projection {
            Projection::Exact => {
                (s, k) = (g * (kappa / a0), kappa * kappa / a0);
                let h = geometry.g_yz() * (kappa / a0 * unit_root);
                (plane.h_y, plane.h_z, plane.k) = (h.x, h.y, k * shape.unit);
            }
            Projection::Affine => plane.weight *= length(d0),
        }
        // The determinant of c is taken from its factors, which have all their digits.
        let det_c = geometry.a * geometry.a * geometry.b * geometry.b;
        let support = Support { centre: [row_centre, column_centre], steps: [step_v, step_u], c, det_c, s, k };
        Some((plane, geometry, support))
    }

    /// Whether any pixel can see it.
    pub(super) fn is_empty(&self) -> bool {
        self.rows.is_empty() || self.columns.is_empty()
    }

    /// The rows within a band that the kernel walks.
    pub(super) fn rows_in(&self, band: Range<usize>) -> Range<usize> {
        from_even(self.rows.start.max(band.start)..self.rows.end.min(band.end))
    }

    /// Its part of a canvas in `rows` (even start), the first of which is row `top` there.
    pub(super) fn patch(&self, rows: Range<usize>, top: usize, stride: usize) -> Patch {
        Patch::new(&self.plane, rows, self.columns.clone(), top, stride)
    }

    /// From sums over pixels to the gradient of mean, precision matrix, density and ν. Mirrors [`Self::new`].
    pub(super) fn pull_back(&self, shape: &Shape, view: &View, projection: Projection, sums: &Sums) -> ShapeGradient {
        let geometry = &self.geometry;
        let Geometry { slope, kappa, p0, g, .. } = *geometry;
        let a0 = p0.length_squared();
        let weight = self.plane.weight;
        let unit_root = shape.unit.sqrt();
        // Sums with the weight in and lengths for units: Σ G (y, z), Σ G (yy, yz, zz); the same of h; of k.
        let [_, y, z, yy, yz, zz] = sums.distance.map(|x| x * weight);
        let first = DVec2::new(y, z) / unit_root;
        let [h, hy, hz] = sums.h.map(|x| 2.0 * x * weight);
        let d_h = DVec2::new(hy, hz) * unit_root;
        let d_k = sums.k * weight * shape.unit;
        let g_yz = geometry.g_yz();

        // The weight: ρ · line · a0^-½ (· |d0| if affine).
        let d_weight = sums.value;
        let d0_squared = 1.0 + slope.length_squared();
        let per_density =
            shape.line.0 / a0.sqrt() * if projection == Projection::Affine { d0_squared.sqrt() } else { 1.0 };

        // ν at constant δ: the exponent's half, the 1/ν's half (Σ a·x, read off the moments), and the line integral.
        let d_nu = if shape.nu.is_finite() {
            let d_x = (sums.k * weight * self.plane.k - yy - zz) / shape.nu;
            -0.5 * std::f64::consts::LN_2 * sums.log * weight + d_x + shape.line.1 / shape.line.0 * weight * d_weight
        } else {
            0.0
        };

        // Σ⁻¹ at fixed centre: δ = |e|² for the nearest point e = y·q_y + z·q_z, A0 = |p0|², and h's slope on p0.
        let (q_y, q_z) = geometry.axes(shape.whitening * view.v);
        let d_a0 = -(0.5 * weight * d_weight + kappa * kappa * d_k / a0) / a0;
        let precision = symmetric(q_y, q_y, yy)
            + symmetric(q_y, q_z, 2.0 * yz)
            + symmetric(q_z, q_z, zz)
            + symmetric(q_y * d_h.x + q_z * d_h.y, p0, kappa / a0)
            + symmetric(p0, p0, d_a0);

        // The centre's place in the plane: α = a·m_z - m_x and β = b·m_z - m_y at a fixed pixel.
        let hs = if projection == Projection::Exact { g * (kappa / a0) } else { DVec2::ZERO };
        let d_offset = geometry.on_detector(first) * 2.0 + hs * h;
        let mut d_m = DVec3::new(-d_offset.x, -d_offset.y, 0.0);
        if kappa > 0.0 {
            let g_h = g_yz.dot(d_h);
            d_m.z = slope.dot(d_offset) + kappa * (2.0 * (yy + zz) + kappa / a0 * g_h);
            // The ray through the centre, d0 = m/m_z: from δ and h's slope, from A0, from |d0|.
            let along = DVec2::new(yy * g_yz.x + yz * g_yz.y, yz * g_yz.x + zz * g_yz.y);
            let mut d_slope = geometry.on_detector(along * (-2.0 / a0) + d_h * (kappa / a0));
            d_slope += g * (2.0 * d_a0 - kappa * g_h / (a0 * a0));
            match projection {
                Projection::Affine => d_slope += slope * (weight * d_weight / d0_squared),
                Projection::Exact => d_m.z -= kappa * kappa * (g_h + 2.0 * kappa * d_k) / a0,
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
            shadow: -d_offset * geometry.half,
        }
    }
}

/// `factor · (a bᵀ + b aᵀ)/2`.
pub(super) fn symmetric(a: DVec3, b: DVec3, factor: f64) -> DMat3 {
    let half = 0.5 * factor;
    DMat3::from_cols((a * b.x + b * a.x) * half, (a * b.y + b * a.y) * half, (a * b.z + b * a.z) * half)
}

/// The quadratic form of a primitive on the detector, in lengths (α, β) from its centre's shadow.
struct Support {
    /// Row and column of the centre.
    centre: [f64; 2],
    /// Lengths per row and per column.
    steps: [f64; 2],
    /// `c_uu, c_uv, c_vv` of δ `[Eq. 4]`, and its determinant.
    c: [f64; 3],
    det_c: f64,
    /// `h = 1 + s·(α, β)` and k of the exact projection `[X1]`; 0 for the affine one.
    s: DVec2,
    k: f64,
}

impl Support {
    /// Rows and columns of the support `[X2]`: the exact bounding box of the conic `δ ≤ cut·(h² + kδ)`. `None` where
    /// that is no ellipse: the support holds the source or passes beside it, or there is no cutoff.
    fn extents(&self, cut: f64) -> Option<[Extent; 2]> {
        let Self { centre: [row, column], steps: [step_v, step_u], c, det_c, s, k } = *self;
        let t = 1.0 / cut - k;
        // The conic's matrix is t·c - s sᵀ; its determinant is taken from that of c.
        let s_adjugate = DVec2::new(c[2] * s.x - c[1] * s.y, c[0] * s.y - c[1] * s.x);
        let determinant = t * (t * det_c - s.dot(s_adjugate));
        let n = [t * c[0] - s.x * s.x, t * c[2] - s.y * s.y];
        if !(t > 0.0 && n[0] > 0.0 && n[1] > 0.0 && determinant > 1e-9 * t * t * det_c) {
            return None;
        }
        let centre = s_adjugate * (t / determinant);
        let radius = 1.0 + s.dot(centre);
        let half = DVec2::new((radius * n[1] / determinant).sqrt(), (radius * n[0] / determinant).sqrt());
        Some([Extent::new(row, step_v, centre.y, half.y), Extent::new(column, step_u, centre.x, half.x)])
    }
}

/// An interval on an axis of pixels or voxels, in fractional indices.
#[derive(Clone, Copy, Debug)]
pub(super) struct Extent {
    low: f64,
    high: f64,
    /// A breath of rounding, in indices.
    slack: f64,
}

impl Extent {
    /// What lies within `half` of the offset `middle` from index `centre`; `step` is the length per index.
    pub(super) fn new(centre: f64, step: f64, middle: f64, half: f64) -> Self {
        Self {
            low: centre + (middle - half) / step,
            high: centre + (middle + half) / step,
            slack: 1e-9 * (1.0 + half / step),
        }
    }

    /// The indices below `count` within, with the breath of rounding to spare.
    pub(super) fn indices(self, count: usize) -> Range<usize> {
        let first = (self.low - self.slack).ceil().max(0.0);
        let last = (self.high + self.slack).floor().min(count as f64 - 1.0);
        if first > last { 0..0 } else { first as usize..last as usize + 1 }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::primitives::{Parameters, Primitives, student_t};
    use crate::scene::{Detector, Grid};

    fn scanner() -> Scanner {
        Scanner {
            beam: Beam::Cone { dso: 5.0, dsd: 7.0 },
            detector: Detector {
                rows: 200,
                columns: 240,
                pitch_v: 0.02,
                pitch_u: 0.017,
                offset_u: 0.1,
                offset_v: -0.05,
            },
            grid: Grid::cube(8),
        }
    }

    fn footprint(mean: [f64; 3], scale: [f64; 3], projection: Projection) -> Footprint {
        Footprint::new(&shape(mean, scale, 1e-2), &scanner(), &scanner().view(0.8), projection)
    }

    fn shape(mean: [f64; 3], scale: [f64; 3], cutoff: f64) -> Shape {
        let primitives = Primitives::new(Parameters {
            mean: vec![mean],
            scale: vec![scale],
            quaternion: vec![[0.7, -0.3, 0.5, 0.2]],
            density: vec![1.0],
            nu: vec![7.0],
        });
        Shape::new::<f64>(&primitives.unwrap(), 0, student_t::bits(cutoff))
    }

    fn support_box(mean: [f64; 3], scale: [f64; 3], cutoff: f64, projection: Projection) -> [f64; 4] {
        Footprint::support_box(&shape(mean, scale, cutoff), &scanner(), &scanner().view(0.8), projection)
    }

    /// Rows and columns that hold a pixel of the support, found by asking every pixel.
    fn reached(footprint: &Footprint) -> (Range<usize>, Range<usize>) {
        let detector = scanner().detector;
        let (mut low, mut high) = ([usize::MAX; 2], [0; 2]);
        for row in 0..detector.rows {
            for column in (0..detector.columns).filter(|&column| footprint.plane.reaches(row, column)) {
                low = [low[0].min(row), low[1].min(column)];
                high = [high[0].max(row + 1), high[1].max(column + 1)];
            }
        }
        (low[0]..high[0], low[1]..high[1])
    }

    #[test]
    fn the_box_of_the_support_is_exact() {
        let cases = [
            ([0.1, -0.2, 0.15], [0.05, 0.12, 0.2]),
            ([-0.4, 0.3, -0.2], [0.02, 0.03, 0.25]),
            ([0.9, 0.2, 0.1], [0.3, 0.2, 0.1]),
        ];
        for (mean, scale) in cases {
            for projection in [Projection::Exact, Projection::Affine] {
                let footprint = footprint(mean, scale, projection);
                assert_eq!(
                    (footprint.rows.clone(), footprint.columns.clone()),
                    reached(&footprint),
                    "{scale:?} {projection:?}"
                );
                let [top, bottom, left, right] = support_box(mean, scale, 1e-2, projection);
                let within =
                    |low: f64, high: f64, n: usize| low.ceil().max(0.0) as usize..n.min(high.floor() as usize + 1);
                assert_eq!(
                    (within(top, bottom, 200), within(left, right, 240)),
                    (footprint.rows, footprint.columns),
                    "{scale:?} {projection:?}"
                );
            }
        }
    }

    #[test]
    fn a_box_is_neither_clipped_nor_rounded() {
        // Cut by the left edge of the detector; the same primitive on a finer and wider detector of the same place.
        let (mean, scale) = ([0.9, 0.2, 0.1], [0.3, 0.2, 0.1]);
        let coarse = support_box(mean, scale, 1e-2, Projection::Exact);
        let mut fine = scanner();
        (fine.detector.pitch_u, fine.detector.pitch_v) = (0.001, 0.001);
        let place = |scanner: &Scanner, [top, bottom, left, right]: [f64; 4]| {
            let ((u0, v0), (u1, v1)) = (scanner.detector.position(top, left), scanner.detector.position(bottom, right));
            [v0, v1, u0, u1]
        };
        let finer = Footprint::support_box(&shape(mean, scale, 1e-2), &fine, &fine.view(0.8), Projection::Exact);
        assert!(coarse[2] < 0.0 || coarse[3] > 239.0 || coarse[0] < 0.0 || coarse[1] > 199.0, "{coarse:?}");
        for (a, b) in place(&scanner(), coarse).into_iter().zip(place(&fine, finer)) {
            assert!((a - b).abs() < 1e-13, "{a} against {b}");
        }
    }

    #[test]
    fn boxes_know_the_cutoff_alone() {
        let (all, none) = ([f64::NEG_INFINITY, f64::INFINITY], [f64::INFINITY, f64::NEG_INFINITY]);
        for projection in [Projection::Exact, Projection::Affine] {
            assert_eq!(support_box([0.1; 3], [0.1; 3], 0.0, projection), [all, all].concat()[..]);
            assert_eq!(support_box([5.0, 5.0, 0.0], [0.05; 3], 1e-2, projection), [none, none].concat()[..]);
            assert_eq!(support_box([5.0, 5.0, 0.0], [0.05; 3], 0.0, projection), [none, none].concat()[..]);
            // Beyond the horizon of f64, within it, and where the walked pixels come from.
            let tails =
                [1e-308, 1e-200, 1e-2].map(|cutoff| support_box([0.1; 3], [0.01; 3], cutoff, Projection::Affine));
            assert!(tails.windows(2).all(|pair| pair[0][0] < pair[1][0] && pair[0][3] > pair[1][3]), "{tails:?}");
        }
        assert_eq!(support_box([1.0, 1.0, 0.0], [2.5, 2.0, 3.0], 1e-2, Projection::Exact), [all, all].concat()[..]);
    }

    #[test]
    fn a_support_that_holds_the_source_takes_the_whole_detector() {
        let footprint = footprint([1.0, 1.0, 0.0], [2.5, 2.0, 3.0], Projection::Exact);
        assert_eq!((footprint.rows, footprint.columns), (0..200, 0..240));
    }

    #[test]
    fn a_primitive_beside_the_detector_or_behind_the_source_is_not_seen() {
        assert!(footprint([0.0, 0.0, 3.0], [0.05, 0.05, 0.05], Projection::Exact).is_empty());
        assert!(footprint([5.0, 5.0, 0.0], [0.05, 0.05, 0.05], Projection::Exact).is_empty());
    }
}
