//! The projection of a primitive in one view: its quadratic form on the detector, and the box of its support.
//!
//! With the whitened directions `p0 = M·d0`, `pᵤ = M·u`, `pᵥ = M·v` of the ray through the centre and of the detector's
//! axes, the form of `[Eq. 4]` is the squared part of `α·pᵤ + β·pᵥ` perpendicular to p0. Its coefficients are taken from
//! cross products, and its determinant from `det M`, so that needles lose no digits to a difference of squares.
//! `footprint_vjp` mirrors this file.

use super::placement::PlacedFootprint;
use crate::geometry::{Beam, View};
use crate::numeric::Lanes;
use crate::numeric::vectors::{DVec3x8, LANES, f64x8, splat};
use crate::projector::kernel::conic::{Conic, ConicX8};
use crate::projector::kernel::extents::Extents;
use crate::projector::projection::{MIN_DEPTH, Projection};
use crate::projector::whitened::{WhitenedPrimitive, whitening};
use std::array::from_fn;
use std::ops::Range;

/// A primitive on the detector of one view. The default is a primitive that is left out.
#[derive(Clone, Debug, Default)]
pub(crate) struct Footprint {
    /// False for a primitive near or behind the source: it is left out of the view whatever the cutoff.
    pub(crate) seen: bool,
    pub(crate) conic: Conic,
    /// Rows of the support, empty if the primitive is not seen.
    pub(crate) rows: Range<usize>,
    /// Columns of the support.
    pub(crate) columns: Range<usize>,
    pub(super) geometry: Geometry<f64>,
}

/// Intermediate values of the projection that its gradient needs, of one primitive or of eight.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Geometry<N> {
    /// `(â, b̂)`: the centre's ray is d0 = (â, b̂, 1) in the camera's axes.
    pub(super) slope: [N; 2],
    /// 1/depth of the centre; 0 for a parallel beam.
    pub(super) kappa: N,
    /// d0, whitened; `A0 = |p0|²`.
    pub(super) p0: [N; 3],
    /// `uᵀΣ⁻¹d0`, `vᵀΣ⁻¹d0`.
    pub(super) g: [N; 2],
    /// The conic's coordinates per length: y = b·β + ab·α, z = a·α.
    pub(super) b: N,
    pub(super) ab: N,
    pub(super) a: N,
    /// Half the detector along (u, v), as lengths in the plane through the centre.
    pub(super) half: [N; 2],
}

impl Geometry<f64x8> {
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

    /// `gᵀ(α, β)` in terms of y and z.
    pub(super) fn g_yz(&self) -> [f64x8; 2] {
        let [u, v] = self.g;
        [v / self.b, (u - v * self.ab / self.b) / self.a]
    }
}

/// The projections of eight primitives, before their supports are clipped.
struct Projected {
    /// Mask of the primitives that are neither near nor behind the source.
    seen: f64x8,
    conics: ConicX8,
    geometry: Geometry<f64x8>,
    support: Support,
}

impl Projected {
    #[inline(always)]
    fn new(primitives: [&WhitenedPrimitive; LANES], view: &View, projection: Projection) -> Self {
        let detector = &view.detector;
        let (vu, vv, vw) = (DVec3x8::splat(view.u), DVec3x8::splat(view.v), DVec3x8::splat(view.w));
        let offset = DVec3x8::from_fn(|i| primitives[i].mean) - DVec3x8::splat(view.source);
        let m = [vu.dot(offset), vv.dot(offset), vw.dot(offset)];
        let (seen, kappa, slope, [step_u, step_v], [u, v]) = match view.beam {
            Beam::Cone { dso, dsd } => {
                let kappa = splat(1.0) / m[2];
                (
                    m[2].simd_gt(splat(MIN_DEPTH * dso)),
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
        let whitening = whitening(primitives);
        let (p0, pu, pv) = (whitening * d0, whitening * vu, whitening * vv);
        let a0 = p0.length_squared();
        let g = [pu.dot(p0), pv.dot(p0)];
        let (cu, cv) = (p0.cross(pu), p0.cross(pv));
        let c = [cu.length_squared() / a0, cu.dot(cv) / a0, cv.length_squared() / a0];
        let b = c[2].sqrt();
        let half = [step_u * splat(detector.columns as f64), step_v * splat(detector.rows as f64)]
            .map(|side| side / splat(2.0));
        let determinant = f64x8::from_fn(|i| primitives[i].determinant());
        let a = determinant / (a0.sqrt() * b);
        let geometry = Geometry { slope, kappa, p0: [p0.x, p0.y, p0.z], g, b, ab: c[1] / b, a, half };
        let unit = f64x8::from_fn(|i| primitives[i].unit);
        let unit_root = unit.sqrt();
        let line = f64x8::from_fn(|i| primitives[i].density * primitives[i].line.0);
        let mut conics = Conic {
            row_centre,
            column_centre,
            slant: -geometry.ab * step_u / (b * step_v),
            b: b * step_v / unit_root,
            a: a * step_u / unit_root,
            q: f64x8::from_fn(|i| (primitives[i].nu + 2.0) / 2.0),
            weight: line / a0.sqrt(),
            max_x: f64x8::from_fn(|i| primitives[i].max_x),
            ..Conic::default()
        };
        let (mut s, mut k) = ([splat(0.0); 2], splat(0.0));
        match projection {
            Projection::Exact => {
                (s, k) = (g.map(|g| g * (kappa / a0)), kappa * kappa / a0);
                let [h_y, h_z] = geometry.g_yz().map(|g| g * (kappa / a0 * unit_root));
                (conics.h_y, conics.h_z, conics.k) = (h_y, h_z, k * unit);
            }
            Projection::Affine => conics.weight *= d0.length(),
        }
        // The determinant of c is taken from its factors, which have all their digits.
        let det_c = a * a * b * b;
        let support = Support { centre: [row_centre, column_centre], steps: [step_v, step_u], c, det_c, s, k };
        Self { seen, conics, geometry, support }
    }
}

impl Footprint {
    /// Projects up to eight primitives.
    pub(crate) fn project(
        footprints: &mut [Self],
        primitives: [&WhitenedPrimitive; LANES],
        view: &View,
        projection: Projection,
    ) {
        let Projected { seen, conics, geometry, support } = Projected::new(primitives, view, projection);
        let counts = [view.detector.rows, view.detector.columns];
        let unit = f64x8::from_fn(|i| primitives[i].unit);
        let (ellipse, extents) = support.extents(conics.max_x * unit);
        let [rows, columns] = from_fn(|axis| extents[axis].indices(counts[axis]).or_all(ellipse, counts[axis]));
        let conics = conics.bounded(rows, columns).to_array();
        let (rows, columns, geometry) = (rows.ranges(), columns.ranges(), geometry.to_array());
        let seen = seen.to_bitmask();
        for (i, footprint) in footprints.iter_mut().enumerate() {
            *footprint = match seen >> i & 1 {
                0 => Self::default(),
                _ => Self {
                    seen: true,
                    conic: conics[i],
                    rows: rows[i].clone(),
                    columns: columns[i].clone(),
                    geometry: geometry[i],
                },
            };
        }
    }

    /// Boxes of the cutoff's support, as [`ViewField::support_boxes`](super::view::ViewField::support_boxes) returns them.
    pub(crate) fn support_boxes(
        primitives: [&WhitenedPrimitive; LANES],
        view: &View,
        projection: Projection,
    ) -> [[f64; 4]; LANES] {
        let Projected { seen, support, .. } = Projected::new(primitives, view, projection);
        let (ellipse, extents) = support.extents(f64x8::from_fn(|i| primitives[i].cutoff_x * primitives[i].unit));
        let ends = extents.map(|extent| [(extent.low, -1.0), (extent.high, 1.0)]);
        let ends = ends.as_flattened().iter().map(|&(end, sign)| {
            let (unbounded, empty) = (splat(sign * f64::INFINITY), splat(-sign * f64::INFINITY));
            seen.select(ellipse.select(end, unbounded), empty).to_array()
        });
        let mut boxes = [[0.0; 4]; LANES];
        for (side, ends) in ends.enumerate() {
            boxes.iter_mut().zip(ends).for_each(|(sides, end)| sides[side] = end);
        }
        boxes
    }

    /// Whether the support holds no pixel.
    pub(crate) fn is_empty(&self) -> bool {
        self.rows.is_empty() || self.columns.is_empty()
    }

    /// The rows of the support within a band.
    pub(crate) fn rows_in(&self, band: Range<usize>) -> Range<usize> {
        self.rows.start.max(band.start)..self.rows.end.min(band.end)
    }

    /// Reads a word of each cache line that [`Self::placed`] reads.
    pub(crate) fn touch(&self) -> u64 {
        let Self { conic, rows, columns, .. } = self;
        conic.row_centre.to_bits() ^ conic.max_abs_e.to_bits() ^ rows.start as u64 ^ columns.start as u64
    }

    /// The footprint in `rows` of an image buffer, in which the first of them is row `top`.
    pub(crate) fn placed(&self, rows: Range<usize>, top: usize, stride: usize) -> PlacedFootprint {
        PlacedFootprint::new(&self.conic, rows, self.columns.clone(), top, stride)
    }
}

/// The quadratic forms of eight primitives on the detector, in lengths (α, β) from their projected means.
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
    /// Rows and columns of the support `[X2]`: the exact bounding box of the conic `δ ≤ cut·(h² + kδ)`.
    ///
    /// The first value is the mask of ellipses. The conic is no ellipse where the support holds the source or passes next to
    /// it, or without a cutoff.
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
    use super::super::footprint_vjp::vjp;
    use super::*;
    use crate::geometry::{Detector, Grid, Scanner};
    use crate::primitives::{Parameters, Primitives, student_t};
    use crate::projector::kernel::Sums;

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

    fn project(primitives: [&WhitenedPrimitive; LANES], view: &View, projection: Projection) -> [Footprint; LANES] {
        let mut footprints: [Footprint; LANES] = Default::default();
        Footprint::project(&mut footprints, primitives, view, projection);
        footprints
    }

    fn footprint(mean: [f64; 3], scale: [f64; 3], projection: Projection) -> Footprint {
        let [footprint, ..] = project([&whitened(mean, scale, 1e-2); LANES], &scanner().view(0.8), projection);
        footprint
    }

    fn whitened(mean: [f64; 3], scale: [f64; 3], cutoff: f64) -> WhitenedPrimitive {
        let primitives = Primitives::new(Parameters {
            mean: vec![mean],
            scale: vec![scale],
            quaternion: vec![[0.7, -0.3, 0.5, 0.2]],
            density: vec![1.0],
            nu: vec![7.0],
        });
        WhitenedPrimitive::new::<f64>(&primitives.unwrap(), 0, student_t::bits(cutoff))
    }

    fn support_box(mean: [f64; 3], scale: [f64; 3], cutoff: f64, projection: Projection) -> [f64; 4] {
        Footprint::support_boxes([&whitened(mean, scale, cutoff); LANES], &scanner().view(0.8), projection)[0]
    }

    /// Rows and columns that hold a pixel of the support, by testing every pixel.
    fn reached(footprint: &Footprint) -> (Range<usize>, Range<usize>) {
        let detector = scanner().detector;
        let (mut low, mut high) = ([usize::MAX; 2], [0; 2]);
        for row in 0..detector.rows {
            for column in (0..detector.columns).filter(|&column| footprint.conic.contains(row, column)) {
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
            Footprint::support_boxes([&whitened(mean, scale, 1e-2); LANES], &fine.view(0.8), Projection::Exact);
        assert!(coarse[2] < 0.0 || coarse[3] > 239.0 || coarse[0] < 0.0 || coarse[1] > 199.0, "{coarse:?}");
        for (a, b) in place(&scanner(), coarse).into_iter().zip(place(&fine, finer)) {
            within!((a - b).abs(), "{a} against {b}");
        }
    }

    #[test]
    fn boxes_know_the_cutoff_alone() {
        let (all, none) = ([f64::NEG_INFINITY, f64::INFINITY], [f64::INFINITY, f64::NEG_INFINITY]);
        for projection in [Projection::Exact, Projection::Affine] {
            assert_eq!(support_box([0.1; 3], [0.1; 3], 0.0, projection), [all, all].concat()[..]);
            assert_eq!(support_box([5.0, 5.0, 0.0], [0.05; 3], 1e-2, projection), [none, none].concat()[..]);
            assert_eq!(support_box([5.0, 5.0, 0.0], [0.05; 3], 0.0, projection), [none, none].concat()[..]);
            // Cutoffs beyond the horizon of f64, within it, and as in training.
            let tails =
                [1e-308, 1e-200, 1e-2].map(|cutoff| support_box([0.1; 3], [0.01; 3], cutoff, Projection::Affine));
            assert!(tails.windows(2).all(|pair| pair[0][0] < pair[1][0] && pair[0][3] > pair[1][3]), "{tails:?}");
        }
        assert_eq!(support_box([1.0, 1.0, 0.0], [2.5, 2.0, 3.0], 1e-2, Projection::Exact), [all, all].concat()[..]);
    }

    #[test]
    fn among_seven_others_a_primitive_has_the_bits_that_it_has_alone() {
        let view = scanner().view(0.8);
        // One near the edge, one behind the source, one that holds it, one that misses the detector, and four amid it.
        let means = [[1.2, 1.2, 0.0], [5.0, 5.0, 0.0], [1.0, 1.0, 0.0], [0.0, 0.0, 3.0]];
        let means = means.into_iter().chain((0..4).map(|i| [0.3 - 0.2 * f64::from(i), 0.1 * f64::from(i), 0.2]));
        let primitives: Vec<_> = means
            .enumerate()
            .map(|(i, mean)| {
                whitened(mean, if i == 2 { [2.5, 2.0, 3.0] } else { [0.04 * (i + 1) as f64, 0.05, 0.06] }, 1e-2)
            })
            .collect();
        let primitives: [&WhitenedPrimitive; LANES] = std::array::from_fn(|i| &primitives[i]);
        let sums: [Sums; LANES] = std::array::from_fn(|i| Sums {
            distance: std::array::from_fn(|j| (i + j) as f64 / 7.0),
            h: [0.3 * i as f64, -0.2, 0.1],
            k: 0.7,
            value: i as f64,
            log: 0.4,
            ..Sums::default()
        });
        for projection in [Projection::Exact, Projection::Affine] {
            let together = project(primitives, &view, projection);
            let boxes = Footprint::support_boxes(primitives, &view, projection);
            let parts = vjp(together.each_ref(), primitives, &view, projection, &sums);
            assert_eq!(together.each_ref().map(|f| f.seen), [true, false, true, true, true, true, true, true]);
            for (i, primitive) in primitives.into_iter().enumerate() {
                let [alone, ..] = project([primitive; LANES], &view, projection);
                assert_eq!(format!("{alone:?}"), format!("{:?}", together[i]), "{i} {projection:?}");
                assert_eq!(Footprint::support_boxes([primitive; LANES], &view, projection)[0], boxes[i]);
                if alone.seen {
                    let part = vjp([&alone; LANES], [primitive; LANES], &view, projection, &[sums[i]; LANES]);
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
