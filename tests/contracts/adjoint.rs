//! ⟨A x, y⟩ = ⟨x, Aᵀ y⟩: every backward pass is the transpose of its forward pass, with the factor 1.
//!
//! Images and volumes are linear in the densities, so both sides are computed exactly there. In the other parameters A
//! is the derivative, computed by differences along one random direction through all parameters. Each test prints the
//! fitted factor ⟨Ax,y⟩/⟨x,Aᵀy⟩ and the residual relative to ‖Ax‖·‖y‖: a wrong factor and a wrong entry look different
//! there.

use crate::common::scenes;
use crate::tolerances::largest;
use ndarray::Array3;
use trgs::geometry::{Beam, Scanner};
use trgs::numeric::Real;
use trgs::primitives::{Group, KernelKind, Parameters, Primitives};
use trgs::projector::{self, Kernels, Projection};

const ANGLES: [f64; 3] = [0.35, 2.2, 4.9];
/// Number of random pairs (x, y) that a factor is fitted to.
const PAIRS: u64 = 5;

/// The linear operator: from densities to a set of images, or to the volume.
#[derive(Clone, Copy)]
enum Operator {
    Images(Projection, fn() -> Scanner),
    Volume,
}

impl Operator {
    const ALL: [Self; 5] = [
        Self::Images(Projection::Exact, scenes::cone),
        Self::Images(Projection::Affine, scenes::cone),
        Self::Images(Projection::Exact, scenes::parallel),
        Self::Images(Projection::Affine, scenes::parallel),
        Self::Volume,
    ];

    fn name(self) -> String {
        match self {
            Self::Images(projection, scanner) => {
                let beam = if matches!(scanner().beam, Beam::Cone { .. }) { "cone" } else { "parallel" };
                format!("{beam} {projection:?}")
            }
            Self::Volume => "volume".into(),
        }
    }

    fn shape(self) -> [usize; 3] {
        match self {
            Self::Images(_, scanner) => [ANGLES.len(), scanner().detector.rows, scanner().detector.columns],
            Self::Volume => scenes::cone().grid.shape,
        }
    }

    fn forward<R: Kernels>(self, primitives: &Primitives, cutoff: f64) -> Array3<R> {
        match self {
            Self::Images(projection, scanner) => {
                projector::forward(primitives, &scanner(), &ANGLES, projection, cutoff)
            }
            Self::Volume => projector::voxelize(primitives, &scenes::cone().grid, cutoff),
        }
    }

    fn vjp<R: Kernels>(self, primitives: &Primitives, cutoff: f64, y: &Array3<R>) -> Parameters {
        match self {
            Self::Images(projection, scanner) => {
                projector::vjp(primitives, &scanner(), &ANGLES, projection, cutoff, y.view())
            }
            Self::Volume => projector::voxelize_vjp(primitives, &scenes::cone().grid, cutoff, y.view()),
        }
    }
}

fn dot<'a, R: Real>(a: impl IntoIterator<Item = &'a R>, b: impl IntoIterator<Item = &'a R>) -> f64 {
    a.into_iter().zip(b).map(|(a, b)| a.to_f64() * b.to_f64()).sum()
}

/// Both sides for one pair, and the product of norms ‖Ax‖·‖y‖.
struct Sides {
    forward: f64,
    backward: f64,
    norm: f64,
}

/// The factor that fits all pairs best, and the largest residual at factor 1.
fn fit(pairs: &[Sides]) -> (f64, f64) {
    let (above, below) = pairs.iter().fold((0.0, 0.0), |(above, below), pair| {
        (above + pair.forward * pair.backward, below + pair.backward * pair.backward)
    });
    let residual = |pair: &Sides| (pair.forward - pair.backward).abs() / pair.norm;
    let worst = pairs.iter().map(residual).fold(0.0, |m: f64, r| if r.is_nan() { f64::INFINITY } else { m.max(r) });
    (above / below, worst)
}

/// The residual of the pairs, which must not be almost orthogonal.
fn residual(what: &str, pairs: &[Sides]) -> f64 {
    let (factor, residual) = fit(pairs);
    eprintln!("{what:<36} factor 1{:+.1e}  residual {residual:.1e}", factor - 1.0);
    let strongest = pairs.iter().map(|p| p.backward.abs() / p.norm).fold(0.0, f64::max);
    beyond!("strongest", strongest, "{what}: the pairs are almost orthogonal and show nothing");
    residual
}

/// The largest residual over operators, kernels and cutoffs.
fn residual_of_densities<R: Kernels>(precision: &str) -> f64 {
    let mut worst = Vec::new();
    for operator in Operator::ALL {
        for kernel in [KernelKind::StudentT, KernelKind::Gaussian] {
            for cutoff in [0.0, 1e-3] {
                let mut primitives = scenes::primitives(kernel, 23, 31);
                let pairs = (0..PAIRS).map(|seed| {
                    let x = scenes::uniform(700 + seed, primitives.len(), -1.0, 1.0);
                    primitives.parameters.density.copy_from_slice(&x);
                    let y = scenes::cotangent(seed, operator.shape()).mapv(R::from_f64);
                    let ax = operator.forward::<R>(&primitives, cutoff);
                    let back = operator.vjp(&primitives, cutoff, &y).density;
                    Sides {
                        forward: dot(&ax, &y),
                        backward: dot(&x, &back),
                        norm: (dot(&ax, &ax) * dot(&y, &y)).sqrt(),
                    }
                });
                let pairs: Vec<_> = pairs.collect();
                worst.push(residual(&format!("{precision} {} {kernel:?} {cutoff}", operator.name()), &pairs));
            }
        }
    }
    largest(worst)
}

#[test]
fn in_f64_the_gradient_to_densities_is_the_transpose_of_projecting_and_voxelizing() {
    within!(residual_of_densities::<f64>("f64"));
}

#[test]
fn in_f32_the_gradient_to_densities_is_the_transpose_of_projecting_and_voxelizing() {
    within!(residual_of_densities::<f32>("f32"));
}

/// Tests single entries of the transpose: random pairs would average away a wrong row.
#[test]
fn each_entry_of_the_matrix_is_that_of_its_transpose() {
    for operator in Operator::ALL {
        for kernel in [KernelKind::StudentT, KernelKind::Gaussian] {
            let mut primitives = scenes::primitives(kernel, 5, 32);
            let shape = operator.shape();
            for pixel in [[0, 0, 0], [shape[0] - 1, shape[1] - 1, shape[2] - 1], shape.map(|n| n / 2)] {
                let mut y = Array3::zeros(shape);
                y[pixel] = 1.0;
                let row = operator.vjp::<f64>(&primitives, 0.0, &y).density;
                for (i, entry) in row.iter().enumerate() {
                    primitives.parameters.density.fill(0.0);
                    primitives.parameters.density[i] = -1.0;
                    let column = -operator.forward::<f64>(&primitives, 0.0)[pixel];
                    let what = format!("{} {kernel:?}: A[{pixel:?}, {i}] = {column:e}", operator.name());
                    within!((entry - column).abs() / column.abs(), "{what}, of the transpose {entry:e}");
                }
            }
        }
    }
}

/// A direction through all parameters, scaled to their sizes.
fn direction(primitives: &Primitives, seed: u64) -> Parameters {
    let mut direction = Parameters::zeros(primitives.len());
    for (component, group) in (0..).zip(Group::ALL) {
        let values = primitives.parameters.group(group);
        let random = scenes::uniform(seed * 8 + component, values.len(), -1.0, 1.0);
        for (i, (d, random)) in direction.group_mut(group).iter_mut().zip(random).enumerate() {
            *d = random
                * match group {
                    Group::Mean => primitives.parameters.scale[i / 3][i % 3],
                    Group::Nu if values[i].is_infinite() => 0.0,
                    Group::Quaternion => 1.0,
                    Group::Scale | Group::Density | Group::Nu => values[i],
                };
        }
    }
    direction
}

fn moved(primitives: &Primitives, direction: &Parameters, step: f64) -> Primitives {
    let mut moved = primitives.clone();
    for group in Group::ALL {
        let values = moved.parameters.group_mut(group).iter_mut().zip(direction.group(group));
        values.for_each(|(value, d)| *value += step * d);
    }
    moved
}

#[test]
fn the_derivative_along_a_random_direction_is_the_gradient_times_the_direction() {
    const STEP: f64 = 1e-3;
    for operator in Operator::ALL {
        for kernel in [KernelKind::StudentT, KernelKind::Gaussian] {
            let pairs = (0..PAIRS).map(|seed| {
                let mut primitives = scenes::primitives(kernel, 7, 33 + seed);
                primitives.parameters.density[3] *= -1.0;
                let x = direction(&primitives, 900 + seed);
                let y = scenes::cotangent(40 + seed, operator.shape());
                // The derivative of all pixels: central differences of two steps, extrapolated to h = 0.
                let central = |h: f64| {
                    let [after, before] = [h, -h].map(|h| operator.forward::<f64>(&moved(&primitives, &x, h), 0.0));
                    (after - before) / (2.0 * h)
                };
                let jx = (central(STEP / 2.0) * 4.0 - central(STEP)) / 3.0;
                let gradient = operator.vjp(&primitives, 0.0, &y);
                Sides {
                    forward: dot(&jx, &y),
                    backward: Group::ALL.map(|group| dot(gradient.group(group), x.group(group))).iter().sum(),
                    norm: (dot(&jx, &jx) * dot(&y, &y)).sqrt(),
                }
            });
            let pairs: Vec<_> = pairs.collect();
            within!(residual(&format!("{} {kernel:?}", operator.name()), &pairs), "{} {kernel:?}", operator.name());
        }
    }
}
