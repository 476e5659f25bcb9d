//! The gradient of the projection of a primitive. Mirrors `footprint`.
//!
//! It is computed in the same whitened coordinates, so that needles lose no digits.

use super::footprint::{Footprint, Geometry};
use crate::geometry::View;
use crate::numeric::Lanes;
use crate::numeric::vectors::{DVec3x8, LANES, f64x8, splat};
use crate::projector::kernel::Sums;
use crate::projector::projection::Projection;
use crate::projector::whitened::{GradientLanes, PrimitiveGradient, Symmetric, WhitenedPrimitive, whitening};
use std::array::from_fn;

impl Geometry<f64x8> {
    /// The geometry of eight footprints.
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

    /// From a vector in the (y, z) axes to its product with the detector's axes, `(pᵤ·, pᵥ·)`.
    fn on_detector(&self, [y, z]: [f64x8; 2]) -> [f64x8; 2] {
        [self.ab * y + self.a * z, self.b * y]
    }
}

/// The gradients to mean, precision matrix, density and ν from the sums over pixels. Mirrors [`Footprint::project`].
pub(crate) fn vjp(
    footprints: [&Footprint; LANES],
    primitives: [&WhitenedPrimitive; LANES],
    view: &View,
    projection: Projection,
    sums: &[Sums; LANES],
) -> [PrimitiveGradient; LANES] {
    let geometry = Geometry::of(footprints);
    let Geometry { slope, kappa, g, .. } = geometry;
    let p0 = geometry.p0();
    let a0 = p0.length_squared();
    let weight = f64x8::from_fn(|i| footprints[i].conic.weight);
    let unit = f64x8::from_fn(|i| primitives[i].unit);
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
    let line = f64x8::from_fn(|i| primitives[i].line.0);
    let per_density = match projection {
        Projection::Affine => line / a0.sqrt() * d0_squared.sqrt(),
        Projection::Exact => line / a0.sqrt(),
    };

    // ν at constant δ: the exponent's half, the 1/ν's half (Σ a·x, read off the moments), and the line integral.
    let nu = f64x8::from_fn(|i| primitives[i].nu);
    let d_x = (k_sum * f64x8::from_fn(|i| footprints[i].conic.k) - yy - zz) / nu;
    let log = f64x8::from_fn(|i| sums[i].log);
    let d_line = f64x8::from_fn(|i| primitives[i].line.1) / line;
    let d_nu = splat(-0.5 * std::f64::consts::LN_2) * log * weight + d_x + d_line * weight * d_weight;
    let d_nu = nu.select_le(splat(f64::MAX), d_nu, splat(0.0));

    // Σ⁻¹ at fixed centre: δ = |e|² for the nearest point e = y·q_y + z·q_z, A0 = |p0|², and h's slope on p0.
    let whitening = whitening(primitives);
    let (q_y, q_z) = geometry.axes(whitening * DVec3x8::splat(view.v));
    let d_a0 = -(splat(0.5) * weight * d_weight + kappa * kappa * d_k / a0) / a0;
    let precision = Symmetric::new(q_y, q_y, yy)
        + Symmetric::new(q_y, q_z, splat(2.0) * yz)
        + Symmetric::new(q_z, q_z, zz)
        + Symmetric::new(q_y * d_h[0] + q_z * d_h[1], p0, kappa / a0)
        + Symmetric::new(p0, p0, d_a0);

    // The centre's position in the plane: α = a·m_z - m_x and β = b·m_z - m_y at a fixed pixel.
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
    let mut d_z = slope[0] * d_offset_u + slope[1] * d_offset_v + kappa * (splat(2.0) * (yy + zz) + kappa / a0 * g_h);
    d_slope = from_fn(|j| d_slope[j] + g[j] * by_g);
    match projection {
        Projection::Affine => d_slope = from_fn(|j| d_slope[j] + slope[j] * by_slope),
        Projection::Exact => d_z -= kappa * kappa * (g_h + splat(2.0) * kappa * d_k) / a0,
    }
    let d_u = kappa * d_slope[0] - d_offset_u;
    let d_v = kappa * d_slope[1] - d_offset_v;
    let d_z = d_z - kappa * (slope[0] * d_slope[0] + slope[1] * d_slope[1]);
    let mean = DVec3x8::splat(view.u) * d_u + DVec3x8::splat(view.v) * d_v + DVec3x8::splat(view.w) * d_z;
    GradientLanes {
        mean,
        precision,
        density: per_density * d_weight,
        nu: d_nu,
        mean2d: [-d_offset_u * geometry.half[0], -d_offset_v * geometry.half[1]],
    }
    .to_array()
}
