//! A primitive in one view: its quadratic form on the detector, the box it reaches, and the way back.
//!
//! With the whitened directions `p0 = M·d0`, `pᵤ = M·u`, `pᵥ = M·v` of the ray through the centre and of the detector's
//! axes, the form of `[Eq. 4]` is the squared part of `α·pᵤ + β·pᵥ` perpendicular to p0. Its coefficients are taken from
//! cross products, and its determinant from `det M`, so that needles lose no digits to a difference of squares. The
//! gradient comes back in the same whitened coordinates, for the same reason.

use super::Projection;
use super::extents::Extents;
use super::kernel::Sums;
use super::patch::Patch;
use super::plane::{Plane, Planes};
use super::shape::{Gradients, Shape, ShapeGradient, Symmetric, whitening};
use crate::numeric::Lanes;
use crate::numeric::vectors::{DVec3x8, LANES, f64x8, splat};
use crate::scene::{Beam, Scanner, View};
use std::array::from_fn;
use std::ops::Range;

/// Primitives whose centre is nearer to the source than this fraction of `dso`, or behind it, are left out.
pub(super) const NEAR: f64 = 0.01;

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
    geometry: Geometry<f64>,
}

/// What the way back needs, of one primitive or of eight.
#[derive(Clone, Copy, Debug, Default)]
struct Geometry<N> {
    /// `(â, b̂)`: the centre's ray is d0 = (â, b̂, 1) in the camera's axes.
    slope: [N; 2],
    /// 1/depth of the centre; 0 for a parallel beam.
    kappa: N,
    /// d0, whitened; `A0 = |p0|²`.
    p0: [N; 3],
    /// `uᵀΣ⁻¹d0`, `vᵀΣ⁻¹d0`.
    g: [N; 2],
    /// The plane's coordinates per length: y = b·β + ab·α, z = a·α.
    b: N,
    ab: N,
    a: N,
    /// Half the detector along (u, v) as lengths in the plane through the centre.
    half: [N; 2],
}

impl Geometry<f64x8> {
    fn of(footprints: [&Footprint; LANES]) -> Self {
        let of = footprints.map(|footprint| &footprint.geometry);
        Self {
            slope: from_fn(|axis| f64x8::from_fn(|i| of[i].slope[axis])),
            kappa: f64x8::from_fn(|i| of[i].kappa),
            p0: from_fn(|axis| f64x8::from_fn(|i| of[i].p0[axis])),
            g: from_fn(|axis| f64x8::from_fn(|i| of[i].g[axis])),
            b: f64x8::from_fn(|i| of[i].b),
            ab: f64x8::from_fn(|i| of[i].ab),
            a: f64x8::from_fn(|i| of[i].a),
            half: from_fn(|axis| f64x8::from_fn(|i| of[i].half[axis])),
        }
    }

    fn to_array(self) -> [Geometry<f64>; LANES] {
        let (slope, p0, g) =
            (self.slope.map(f64x8::to_array), self.p0.map(f64x8::to_array), self.g.map(f64x8::to_array));
        let half = self.half.map(f64x8::to_array);
        let [kappa, b, ab, a] = [self.kappa, self.b, self.ab, self.a].map(f64x8::to_array);
        std::array::from_fn(|i| Geometry {
            slope: slope.map(|of| of[i]),
            kappa: kappa[i],
            p0: p0.map(|of| of[i]),
            g: g.map(|of| of[i]),
            b: b[i],
            ab: ab[i],
            a: a[i],
            half: half.map(|of| of[i]),
        })
    }

    fn p0(&self) -> DVec3x8 {
        let [x, y, z] = self.p0;
        DVec3x8::new(x, y, z)
    }

    /// Orthonormal whitened axes of y and z, perpendicular to p0.
    fn axes(&self, whitened_v: DVec3x8) -> (DVec3x8, DVec3x8) {
        let p0 = self.p0();
        let q_y = p0.cross(whitened_v).cross(p0).unit();
        (q_y, q_y.cross(p0.unit()))
    }

    /// `gᵀ(α, β)` in terms of y and z.
    fn g_yz(&self) -> [f64x8; 2] {
        let [u, v] = self.g;
        [v / self.b, (u - v * self.ab / self.b) / self.a]
    }

    /// From a vector in the (y, z) axes to its product with the detector's axes, `(pᵤ·, pᵥ·)`.
    fn on_detector(&self, [y, z]: [f64x8; 2]) -> [f64x8; 2] {
        [self.ab * y + self.a * z, self.b * y]
    }
}

/// What footprints are made from, of eight primitives.
struct Prepared {
    /// Where not 0: it is neither near nor behind the source.
    seen: f64x8,
    planes: Planes,
    geometry: Geometry<f64x8>,
    support: Support,
}

impl Prepared {
    #[inline(always)]
    fn new(shapes: [&Shape; LANES], scanner: &Scanner, view: &View, projection: Projection) -> Self {
        let detector = &scanner.detector;
        let (vu, vv, vw) = (DVec3x8::splat(view.u), DVec3x8::splat(view.v), DVec3x8::splat(view.w));
        let offset = DVec3x8::from_fn(|i| shapes[i].mean) - DVec3x8::splat(view.source);
        let m = [vu.dot(offset), vv.dot(offset), vw.dot(offset)];
        let (seen, kappa, slope, [step_u, step_v], [u, v]) = match scanner.beam {
            Beam::Cone { dso, dsd } => {
                let kappa = splat(1.0) / m[2];
                (
                    m[2].simd_gt(splat(NEAR * dso)),
                    kappa,
                    [m[0] * kappa, m[1] * kappa],
                    [splat(detector.pitch_u) * m[2] / splat(dsd), splat(detector.pitch_v) * m[2] / splat(dsd)],
                    [splat(dsd) * m[0] / m[2], splat(dsd) * m[1] / m[2]],
                )
            }
            Beam::Parallel { .. } => {
                let zero = splat(0.0);
                (zero.simd_eq(zero), zero, [zero; 2], [detector.pitch_u, detector.pitch_v].map(splat), [m[0], m[1]])
            }
        };
        let at = |along: f64x8, offset: f64, pitch: f64, count: usize| {
            (along - splat(offset)) / splat(pitch) + splat(count as f64 / 2.0) - splat(0.5)
        };
        let row_centre = at(v, detector.offset_v, detector.pitch_v, detector.rows);
        let column_centre = at(u, detector.offset_u, detector.pitch_u, detector.columns);
        let d0 = vw + vu * slope[0] + vv * slope[1];
        let whitening = whitening(shapes);
        let (p0, pu, pv) = (whitening * d0, whitening * vu, whitening * vv);
        let a0 = p0.length_squared();
        let g = [pu.dot(p0), pv.dot(p0)];
        let (cu, cv) = (p0.cross(pu), p0.cross(pv));
        let c = [cu.length_squared() / a0, cu.dot(cv) / a0, cv.length_squared() / a0];
        let b = c[2].sqrt();
        let half = [step_u * splat(detector.columns as f64), step_v * splat(detector.rows as f64)]
            .map(|side| side / splat(2.0));
        let determinant = f64x8::from_fn(|i| shapes[i].determinant());
        let a = determinant / (a0.sqrt() * b);
        let geometry = Geometry { slope, kappa, p0: [p0.x, p0.y, p0.z], g, b, ab: c[1] / b, a, half };
        let unit = f64x8::from_fn(|i| shapes[i].unit);
        let unit_root = unit.sqrt();
        let line = f64x8::from_fn(|i| shapes[i].density * shapes[i].line.0);
        let mut planes = Planes {
            row_centre,
            column_centre,
            slant: -geometry.ab * step_u / (b * step_v),
            b: b * step_v / unit_root,
            a: a * step_u / unit_root,
            shift: splat(0.0),
            floor: splat(0.0),
            h_y: splat(0.0),
            h_z: splat(0.0),
            k: splat(0.0),
            q: f64x8::from_fn(|i| (shapes[i].nu + 2.0) / 2.0),
            weight: line / a0.sqrt(),
            limit: f64x8::from_fn(|i| shapes[i].limit),
        };
        let (mut s, mut k) = ([splat(0.0); 2], splat(0.0));
        match projection {
            Projection::Exact => {
                (s, k) = (g.map(|g| g * (kappa / a0)), kappa * kappa / a0);
                let [h_y, h_z] = geometry.g_yz().map(|g| g * (kappa / a0 * unit_root));
                (planes.h_y, planes.h_z, planes.k) = (h_y, h_z, k * unit);
            }
            Projection::Affine => planes.weight *= d0.length(),
        }
        // The determinant of c is taken from its factors, which have all their digits.
        let det_c = a * a * b * b;
        let support = Support { centre: [row_centre, column_centre], steps: [step_v, step_u], c, det_c, s, k };
        Self { seen, planes, geometry, support }
    }
}

impl Footprint {
    /// Up to eight primitives as the view sees them.
    pub(super) fn eight(
        footprints: &mut [Self],
        shapes: [&Shape; LANES],
        scanner: &Scanner,
        view: &View,
        projection: Projection,
    ) {
        let Prepared { seen, planes, geometry, support } = Prepared::new(shapes, scanner, view, projection);
        let counts = [scanner.detector.rows, scanner.detector.columns];
        let unit = f64x8::from_fn(|i| shapes[i].unit);
        let (ellipse, extents) = support.extents(planes.limit * unit);
        let [rows, columns] = from_fn(|axis| extents[axis].indices(counts[axis]).or_all(ellipse, counts[axis]));
        let planes = planes.to_array(&planes.bounds(rows, columns));
        let (rows, columns, geometry) = (rows.ranges(), columns.ranges(), geometry.to_array());
        let seen = seen.to_bitmask();
        for (i, footprint) in footprints.iter_mut().enumerate() {
            *footprint = match seen >> i & 1 {
                0 => Self::default(),
                _ => Self {
                    seen: true,
                    plane: planes[i],
                    rows: rows[i].clone(),
                    columns: columns[i].clone(),
                    geometry: geometry[i],
                },
            };
        }
    }

    /// Boxes of the cutoff's support, as [`ViewField::support_boxes`](super::ViewField::support_boxes) has them.
    pub(super) fn support_boxes(
        shapes: [&Shape; LANES],
        scanner: &Scanner,
        view: &View,
        projection: Projection,
    ) -> [[f64; 4]; LANES] {
        let Prepared { seen, support, .. } = Prepared::new(shapes, scanner, view, projection);
        let (ellipse, extents) = support.extents(f64x8::from_fn(|i| shapes[i].reach * shapes[i].unit));
        let ends = extents.map(|extent| [(extent.low, -1.0), (extent.high, 1.0)]);
        let ends = ends.as_flattened().iter().map(|&(end, sign)| {
            let (all_of_it, none) = (splat(sign * f64::INFINITY), splat(-sign * f64::INFINITY));
            seen.select(ellipse.select(end, all_of_it), none).to_array()
        });
        let mut boxes = [[0.0; 4]; LANES];
        for (side, ends) in ends.enumerate() {
            boxes.iter_mut().zip(ends).for_each(|(sides, end)| sides[side] = end);
        }
        boxes
    }

    /// Whether any pixel can see it.
    pub(super) fn is_empty(&self) -> bool {
        self.rows.is_empty() || self.columns.is_empty()
    }

    /// The rows within a band that the kernel walks.
    pub(super) fn rows_in(&self, band: Range<usize>) -> Range<usize> {
        self.rows.start.max(band.start)..self.rows.end.min(band.end)
    }

    /// Something of each line of memory that [`Self::patch`] reads.
    pub(super) fn touch(&self) -> u64 {
        let Self { plane, rows, columns, .. } = self;
        plane.row_centre.to_bits() ^ plane.bend.to_bits() ^ rows.start as u64 ^ columns.start as u64
    }

    /// Its part of a canvas in `rows`, the first of which is row `top` there.
    pub(super) fn patch(&self, rows: Range<usize>, top: usize, stride: usize) -> Patch {
        Patch::new(&self.plane, rows, self.columns.clone(), top, stride)
    }

    /// From sums over pixels to the gradients of mean, precision matrix, density and ν. Mirrors [`Self::eight`].
    pub(super) fn pull_back(
        footprints: [&Self; LANES],
        shapes: [&Shape; LANES],
        view: &View,
        projection: Projection,
        sums: &[Sums; LANES],
    ) -> [ShapeGradient; LANES] {
        let geometry = Geometry::of(footprints);
        let Geometry { slope, kappa, g, .. } = geometry;
        let p0 = geometry.p0();
        let a0 = p0.length_squared();
        let weight = f64x8::from_fn(|i| footprints[i].plane.weight);
        let unit = f64x8::from_fn(|i| shapes[i].unit);
        let unit_root = unit.sqrt();
        // Sums with the weight in and lengths for units: Σ G (y, z), Σ G (yy, yz, zz); the same of h; of k.
        let [y, z, yy, yz, zz] = from_fn(|j| f64x8::from_fn(|i| sums[i].distance[1 + j]) * weight);
        let first = [y / unit_root, z / unit_root];
        let [h, hy, hz] = from_fn(|j| splat(2.0) * f64x8::from_fn(|i| sums[i].h[j]) * weight);
        let d_h = [hy * unit_root, hz * unit_root];
        let k_sum = f64x8::from_fn(|i| sums[i].k) * weight;
        let d_k = k_sum * unit;
        let g_yz = geometry.g_yz();

        // The weight: ρ · line · a0^-½ (· |d0| if affine).
        let d_weight = f64x8::from_fn(|i| sums[i].value);
        let d0_squared = splat(1.0) + (slope[0] * slope[0] + slope[1] * slope[1]);
        let line = f64x8::from_fn(|i| shapes[i].line.0);
        let per_density = match projection {
            Projection::Affine => line / a0.sqrt() * d0_squared.sqrt(),
            Projection::Exact => line / a0.sqrt(),
        };

        // ν at constant δ: the exponent's half, the 1/ν's half (Σ a·x, read off the moments), and the line integral.
        let nu = f64x8::from_fn(|i| shapes[i].nu);
        let d_x = (k_sum * f64x8::from_fn(|i| footprints[i].plane.k) - yy - zz) / nu;
        let log = f64x8::from_fn(|i| sums[i].log);
        let d_line = f64x8::from_fn(|i| shapes[i].line.1) / line;
        let d_nu = splat(-0.5 * std::f64::consts::LN_2) * log * weight + d_x + d_line * weight * d_weight;
        let d_nu = nu.select_le(splat(f64::MAX), d_nu, splat(0.0));

        // Σ⁻¹ at fixed centre: δ = |e|² for the nearest point e = y·q_y + z·q_z, A0 = |p0|², and h's slope on p0.
        let whitening = whitening(shapes);
        let (q_y, q_z) = geometry.axes(whitening * DVec3x8::splat(view.v));
        let d_a0 = -(splat(0.5) * weight * d_weight + kappa * kappa * d_k / a0) / a0;
        let precision = Symmetric::new(q_y, q_y, yy)
            + Symmetric::new(q_y, q_z, splat(2.0) * yz)
            + Symmetric::new(q_z, q_z, zz)
            + Symmetric::new(q_y * d_h[0] + q_z * d_h[1], p0, kappa / a0)
            + Symmetric::new(p0, p0, d_a0);

        // The centre's place in the plane: α = a·m_z - m_x and β = b·m_z - m_y at a fixed pixel.
        let [mut d_offset_u, mut d_offset_v] = geometry.on_detector(first).map(|d| d * splat(2.0));
        if projection == Projection::Exact {
            (d_offset_u, d_offset_v) = (d_offset_u + g[0] * (kappa / a0) * h, d_offset_v + g[1] * (kappa / a0) * h);
        }
        // The ray through the centre, d0 = m/m_z: from δ and h's slope, from A0, from |d0|. In a parallel beam κ is 0.
        let g_h = g_yz[0] * d_h[0] + g_yz[1] * d_h[1];
        let along = [yy * g_yz[0] + yz * g_yz[1], yz * g_yz[0] + zz * g_yz[1]];
        let mut d_slope = geometry.on_detector(from_fn(|j| along[j] * (splat(-2.0) / a0) + d_h[j] * (kappa / a0)));
        let by_g = splat(2.0) * d_a0 - kappa * g_h / (a0 * a0);
        let by_slope = weight * d_weight / d0_squared;
        let mut d_z =
            slope[0] * d_offset_u + slope[1] * d_offset_v + kappa * (splat(2.0) * (yy + zz) + kappa / a0 * g_h);
        d_slope = from_fn(|j| d_slope[j] + g[j] * by_g);
        match projection {
            Projection::Affine => d_slope = from_fn(|j| d_slope[j] + slope[j] * by_slope),
            Projection::Exact => d_z -= kappa * kappa * (g_h + splat(2.0) * kappa * d_k) / a0,
        }
        let d_u = kappa * d_slope[0] - d_offset_u;
        let d_v = kappa * d_slope[1] - d_offset_v;
        let d_z = d_z - kappa * (slope[0] * d_slope[0] + slope[1] * d_slope[1]);
        let mean = DVec3x8::splat(view.u) * d_u + DVec3x8::splat(view.v) * d_v + DVec3x8::splat(view.w) * d_z;
        Gradients {
            mean,
            precision,
            density: per_density * d_weight,
            nu: d_nu,
            shadow: [-d_offset_u * geometry.half[0], -d_offset_v * geometry.half[1]],
        }
        .to_array()
    }
}

/// The quadratic forms of eight primitives on the detector, in lengths (α, β) from their centre's shadow.
struct Support {
    /// Row and column of the centre.
    centre: [f64x8; 2],
    /// Lengths per row and per column.
    steps: [f64x8; 2],
    /// `c_uu, c_uv, c_vv` of δ `[Eq. 4]`, and its determinant.
    c: [f64x8; 3],
    det_c: f64x8,
    /// `h = 1 + s·(α, β)` and k of the exact projection `[X1]`; 0 for the affine one.
    s: [f64x8; 2],
    k: f64x8,
}

impl Support {
    /// Rows and columns of the support `[X2]`: the exact bounding box of the conic `δ ≤ cut·(h² + kδ)`. The first is 0
    /// where that is no ellipse: the support holds the source or passes beside it, or there is no cutoff.
    fn extents(&self, cut: f64x8) -> (f64x8, [Extents; 2]) {
        let Self { centre: [row, column], steps: [step_v, step_u], c, det_c, s, k } = *self;
        let zero = splat(0.0);
        let t = splat(1.0) / cut - k;
        // The conic's matrix is t·c - s sᵀ; its determinant is taken from that of c.
        let s_adjugate = [c[2] * s[0] - c[1] * s[1], c[0] * s[1] - c[1] * s[0]];
        let determinant = t * (t * det_c - (s[0] * s_adjugate[0] + s[1] * s_adjugate[1]));
        let n = [t * c[0] - s[0] * s[0], t * c[2] - s[1] * s[1]];
        let ellipse = t.simd_gt(zero)
            & n[0].simd_gt(zero)
            & n[1].simd_gt(zero)
            & determinant.simd_gt(splat(1e-9) * t * t * det_c);
        let centre = s_adjugate.map(|s| s * (t / determinant));
        let radius = splat(1.0) + (s[0] * centre[0] + s[1] * centre[1]);
        let half = [n[1], n[0]].map(|n| (radius * n / determinant).sqrt());
        let extents = [Extents::new(row, step_v, centre[1], half[1]), Extents::new(column, step_u, centre[0], half[0])];
        (ellipse, extents)
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

    fn eight(shapes: [&Shape; LANES], scanner: &Scanner, view: &View, projection: Projection) -> [Footprint; LANES] {
        let mut footprints: [Footprint; LANES] = Default::default();
        Footprint::eight(&mut footprints, shapes, scanner, view, projection);
        footprints
    }

    fn footprint(mean: [f64; 3], scale: [f64; 3], projection: Projection) -> Footprint {
        let [footprint, ..] = eight([&shape(mean, scale, 1e-2); LANES], &scanner(), &scanner().view(0.8), projection);
        footprint
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
        Footprint::support_boxes([&shape(mean, scale, cutoff); LANES], &scanner(), &scanner().view(0.8), projection)[0]
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
        let [finer, ..] =
            Footprint::support_boxes([&shape(mean, scale, 1e-2); LANES], &fine, &fine.view(0.8), Projection::Exact);
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
    fn among_seven_others_a_primitive_has_the_bits_that_it_has_alone() {
        let (scanner, view) = (scanner(), scanner().view(0.8));
        // One near the edge, one behind the source, one that holds it, one that misses the detector, and four amid it.
        let means = [[1.2, 1.2, 0.0], [5.0, 5.0, 0.0], [1.0, 1.0, 0.0], [0.0, 0.0, 3.0]];
        let means = means.into_iter().chain((0..4).map(|i| [0.3 - 0.2 * f64::from(i), 0.1 * f64::from(i), 0.2]));
        let shapes: Vec<_> = means
            .enumerate()
            .map(|(i, mean)| {
                shape(mean, if i == 2 { [2.5, 2.0, 3.0] } else { [0.04 * (i + 1) as f64, 0.05, 0.06] }, 1e-2)
            })
            .collect();
        let shapes: [&Shape; LANES] = std::array::from_fn(|i| &shapes[i]);
        let sums: [Sums; LANES] = std::array::from_fn(|i| Sums {
            distance: std::array::from_fn(|j| (i + j) as f64 / 7.0),
            h: [0.3 * i as f64, -0.2, 0.1],
            k: 0.7,
            value: i as f64,
            log: 0.4,
            ..Sums::default()
        });
        for projection in [Projection::Exact, Projection::Affine] {
            let together = eight(shapes, &scanner, &view, projection);
            let boxes = Footprint::support_boxes(shapes, &scanner, &view, projection);
            let parts = Footprint::pull_back(together.each_ref(), shapes, &view, projection, &sums);
            assert_eq!(together.each_ref().map(|f| f.seen), [true, false, true, true, true, true, true, true]);
            for (i, shape) in shapes.into_iter().enumerate() {
                let [alone, ..] = eight([shape; LANES], &scanner, &view, projection);
                assert_eq!(format!("{alone:?}"), format!("{:?}", together[i]), "{i} {projection:?}");
                assert_eq!(Footprint::support_boxes([shape; LANES], &scanner, &view, projection)[0], boxes[i]);
                if alone.seen {
                    let part =
                        Footprint::pull_back([&alone; LANES], [shape; LANES], &view, projection, &[sums[i]; LANES]);
                    assert_eq!(part[0], parts[i], "{i} {projection:?}");
                }
            }
        }
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
