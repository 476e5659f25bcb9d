//! Asymmetric, anisotropic, off-centre scenes, generated from a seed.

use glam::DVec3;
use ndarray::{Array, Dimension, ShapeBuilder};
use rand::RngExt;
use trgs::geometry::{Beam, Detector, Grid, Scanner};
use trgs::numeric::rng::{Purpose, stream};
use trgs::primitives::{KernelKind, Parameters, Primitives};

/// Numbers in [low, high) that depend only on the seed and the index.
pub(crate) fn uniform(seed: u64, n: usize, low: f64, high: f64) -> Vec<f64> {
    let mut random = stream(seed, Purpose::Phantom, 99, 0);
    (0..n).map(|_| low + (high - low) * random.random::<f64>()).collect()
}

/// An array of numbers in [-1, 1).
pub(crate) fn cotangent<Sh, D: Dimension>(seed: u64, shape: Sh) -> Array<f64, D>
where
    Sh: ShapeBuilder<Dim = D>,
{
    let mut random = stream(seed, Purpose::Phantom, 98, 0);
    Array::from_shape_simple_fn(shape, || 2.0 * random.random::<f64>() - 1.0)
}

/// `m` primitives about within the unit ball, with scales between 0.03 and 0.3.
pub(crate) fn primitives(kernel: KernelKind, m: usize, seed: u64) -> Primitives {
    let draw = |component: u64, width: usize, low: f64, high: f64| uniform(seed * 16 + component, m * width, low, high);
    let rows3 = |values: Vec<f64>| values.chunks_exact(3).map(|c| [c[0], c[1], c[2]]).collect::<Vec<_>>();
    Primitives::new(Parameters {
        mean: rows3(draw(0, 3, -0.7, 0.7)),
        scale: rows3(draw(1, 3, 0.03, 0.3)),
        quaternion: draw(2, 4, -1.0, 1.0).chunks_exact(4).map(|c| [c[0], c[1], c[2], c[3]]).collect(),
        density: draw(3, 1, 0.1, 1.0),
        nu: match kernel {
            KernelKind::StudentT => draw(4, 1, 1.0, 40.0),
            KernelKind::Gaussian => vec![f64::INFINITY; m],
        },
    })
    .unwrap()
}

/// A cone-beam scanner with an offset, non-square detector and an anisotropic volume.
pub(crate) fn cone() -> Scanner {
    Scanner {
        beam: Beam::Cone { dso: 5.0, dsd: 7.0 },
        detector: Detector { rows: 37, columns: 45, pitch_v: 0.09, pitch_u: 0.083, offset_u: 0.13, offset_v: -0.07 },
        grid: Grid::new([7, 9, 35], DVec3::new(-1.0, -0.9, -0.8), DVec3::new(0.9, 1.0, 0.7)).unwrap(),
    }
}

/// The scanner of [`cone`] with parallel rays.
pub(crate) fn parallel() -> Scanner {
    Scanner {
        beam: Beam::Parallel { dso: 5.0 },
        detector: Detector { pitch_v: 0.06, pitch_u: 0.055, ..cone().detector },
        ..cone()
    }
}
