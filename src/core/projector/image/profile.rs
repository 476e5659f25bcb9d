//! The profile as a function of the distance alone, computed by the kernel of the images.

use super::placement::PlacedFootprint;
use crate::primitives::{KernelKind, gaussian, student_t};
use crate::projector::kernel::Scratch;
use crate::projector::kernel::buffers::PaddedImage;
use crate::projector::kernel::conic::Conic;
use crate::projector::kernels::Kernels;
use crate::projector::projection::Projection;

/// The kernels `T(δ; ν)` at squared Mahalanobis distances δ `[Eq. 2]`, `[X3]`; `[N]`.
///
/// ```text
/// T = (1+δ/ν)^(-(ν+3)/2)        exp(-δ/2) where ν is infinite
/// ```
///
/// δ ≥ 0 and ν > 0, an element each; both are pure numbers, as is T. Every value is made by the very kernel that
/// makes images and volumes, in precision `R`: a pixel with `y = z = 0` and `floor = δ/ν`. Like there, T is 0 where
/// `R` could not hold its gradient any more, below about `2^-R::HORIZON`; also for infinite δ.
///
/// Accuracy: within 1.5e-7 (f32) and 5e-16 (f64) of the peak 1, plus the rounding of δ/ν to `R`; relative to itself
/// a tail of 2^-n is n times less accurate. Tests: `profile_agrees_with_libm`.
///
/// # Panics
/// If there are not as many ν as δ.
pub fn profile<R: Kernels>(delta: &[f64], nu: &[f64]) -> Vec<R> {
    assert_eq!(delta.len(), nu.len(), "numbers of distances and of degrees of freedom");
    let mut image = PaddedImage::<R>::new(1, 1);
    let mut scratch = Scratch::default();
    let one = |(&delta, &nu): (&f64, &f64)| {
        let (kernel, unit, max_x) = if nu == f64::INFINITY {
            (KernelKind::Gaussian, gaussian::UNIT, R::HORIZON)
        } else {
            (KernelKind::StudentT, nu, student_t::horizon(nu, R::HORIZON))
        };
        let conic = Conic {
            floor: delta / unit,
            q: (nu + 3.0) / 2.0,
            weight: 1.0,
            max_x,
            max_delta: max_x,
            ..Conic::default()
        };
        image.clear(0..1);
        let footprint = PlacedFootprint::new(&conic, 0..1, 0..1, 0, image.stride);
        (R::image_kernels(kernel, Projection::Affine).forward)(&footprint, &mut image, &mut scratch);
        image.row(0, 1)[0]
    };
    delta.iter().zip(nu).map(one).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tolerances::relative;

    /// δ from 1e-10 to 1e6 and 0, each with ν from ½ to 1e4 and ∞.
    fn arguments() -> (Vec<f64>, Vec<f64>) {
        let deltas = (0..=64).map(|i| libm::pow(10.0, -10.0 + 0.25 * f64::from(i))).chain([0.0]);
        let nus = [0.5, 1.0, 3.7, 10.0, 1e3, 1e4, f64::INFINITY];
        deltas.flat_map(|delta| nus.map(|nu| (delta, nu))).unzip()
    }

    fn worst<R: Kernels>() -> f64 {
        let (delta, nu) = arguments();
        let values = profile::<R>(&delta, &nu);
        let error = |((value, &delta), &nu): ((&R, &f64), &f64)| {
            // What the kernel is given is δ/unit, rounded.
            let unit = if nu.is_infinite() { gaussian::UNIT } else { nu };
            let x = R::from_f64(delta / unit).to_f64();
            let log = if nu.is_infinite() { x * std::f64::consts::LN_2 } else { (nu + 3.0) / 2.0 * libm::log1p(x) };
            (value.to_f64() - libm::exp(-log)).abs()
        };
        values.iter().zip(&delta).zip(&nu).map(error).fold(0.0, f64::max)
    }

    #[test]
    fn profile_agrees_with_libm() {
        within!(worst::<f64>(), "{:e}", worst::<f64>());
        within!("f32", worst::<f32>(), "{:e}", worst::<f32>());
    }

    #[test]
    fn the_peak_is_1_and_nothing_is_left_beyond_the_horizon() {
        for nu in [1.0, 1e4, f64::INFINITY] {
            assert_eq!(profile::<f32>(&[0.0, 1e30, f64::INFINITY], &[nu; 3]), [1.0, 0.0, 0.0]);
            assert_eq!(profile::<f64>(&[0.0, f64::INFINITY], &[nu; 2]), [1.0, 0.0]);
        }
        // 2^-126 itself is still there, the next power is not.
        let at = |n: f64| profile::<f32>(&[n * gaussian::UNIT], &[f64::INFINITY])[0];
        assert!(at(126.0) > 0.0 && at(127.0) == 0.0);
    }

    #[test]
    fn a_volume_is_made_of_the_same_numbers() {
        use crate::geometry::Grid;
        use crate::primitives::{Parameters, Primitives};
        // One voxel, √δ along x from a centre of unit scales.
        let grid = Grid::new([1, 1, 1], glam::DVec3::NEG_ONE, glam::DVec3::ONE).unwrap();
        for (delta, nu) in [(0.25, 3.0), (2.25, 50.0), (4.0, f64::INFINITY)] {
            let primitives = Primitives::new(Parameters {
                mean: vec![[f64::sqrt(delta), 0.0, 0.0]],
                scale: vec![[1.0; 3]],
                quaternion: vec![[1.0, 0.0, 0.0, 0.0]],
                density: vec![1.0],
                nu: vec![nu],
            });
            let volume = crate::projector::voxelize::<f64>(&primitives.unwrap(), &grid, 0.0);
            let value = profile::<f64>(&[delta], &[nu])[0];
            within!(relative(volume[[0, 0, 0]], value), "δ = {delta}, ν = {nu}");
        }
    }
}
