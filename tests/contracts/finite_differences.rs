//! Every gradient against central differences of three steps, whose error must fall as h².
//!
//! Covers every group of parameters, every loss, exact and affine projection, both kernels, physical and raw
//! parameters.
//!
//! A wrong gradient shows at the smallest step; an invalid difference (a kink, a step lost to rounding) shows as an
//! order other than two. Steps are fractions of a parameter's own size; steps of quaternions follow great circles.

use crate::common::scenes;
use ndarray::{Array2, Array3, Axis};
use std::f64::consts::FRAC_PI_4;
use trgs::geometry::{Detector, Grid, Scanner};
use trgs::loss::{Ssim, SsimTarget, image_loss, l1, tv};
use trgs::primitives::activation::Interval;
use trgs::primitives::{Activation, Group, KernelKind, Parameters, Primitives};
use trgs::projector::{self, Projection};

const STEPS: [f64; 3] = [4e-3, 4e-4, 2e-5];
const ANGLES: [f64; 2] = [0.4, 2.9];
const D_SSIM: f64 = 0.25;

/// A quarter of the scenes' detector, off-centre.
fn scanner() -> Scanner {
    let detector = Detector { rows: 17, columns: 21, pitch_v: 0.19, pitch_u: 0.17, offset_u: 0.13, offset_v: -0.07 };
    Scanner { detector, ..scenes::cone() }
}

fn activation(kernel: KernelKind) -> Activation {
    Activation { kernel, scale: Interval { min: 0.001, max: 1.0 }, nu: Interval { min: 0.5, max: 100.0 } }
}

/// A scalar function of images, or of a block of voxels.
enum Loss {
    /// `Σ cotangent·images`.
    Images(Array3<f64>),
    /// `Σ cotangent·volume`.
    Volume(Array3<f64>, Grid),
    L1(Array3<f64>),
    Ssim(Array3<f64>),
    /// The data loss of a projection: L1 and D-SSIM.
    Both(Array3<f64>),
    Tv(Grid),
}

impl Loss {
    /// Whether the loss is linear in a physical parameter, apart from kinks.
    fn is_linear_in(&self, group: Group) -> bool {
        group == Group::Density && !matches!(self, Self::Ssim(_) | Self::Both(_))
    }

    /// All losses, with targets that keep kinks far from `primitives`.
    fn all(primitives: &Primitives, projection: Projection) -> Vec<(&'static str, Self)> {
        let detector = scanner().detector;
        let shape = [ANGLES.len(), detector.rows, detector.columns];
        let images = projector::forward::<f64>(primitives, &scanner(), &ANGLES, projection, 0.0);
        let peak = images.iter().fold(0.0_f64, |m, x| m.max(*x));
        // At least two fifths of the peak away, on either side: no step reaches the kink.
        let away =
            scenes::cotangent::<_, ndarray::Ix3>(50, shape).mapv(|x: f64| peak * (0.4 + 0.3 * x.abs()) * x.signum());
        let target = &images + &away;
        let block = Grid::new([4, 5, 3], glam::DVec3::new(0.2, 0.35, 0.25), glam::DVec3::new(0.6, 0.8, 0.7)).unwrap();
        let grid = Grid { shape: [4, 5, 7], ..scenes::cone().grid };
        vec![
            ("images", Self::Images(scenes::cotangent(51, shape))),
            ("volume", Self::Volume(scenes::cotangent(52, grid.shape), grid)),
            ("L1", Self::L1(target.clone())),
            ("SSIM", Self::Ssim(target.clone())),
            ("L1 and D-SSIM", Self::Both(target)),
            ("TV", Self::Tv(block)),
        ]
    }

    /// Value and gradient of an image loss, summed over the views.
    fn of_image(&self, image: &Array2<f64>, view: usize) -> (f64, Array2<f64>) {
        let ssim = Ssim::<f64>::default();
        match self {
            Self::Images(cotangent) => {
                let cotangent = cotangent.index_axis(Axis(0), view);
                ((image * &cotangent).sum(), cotangent.to_owned())
            }
            Self::L1(target) => l1::l1(image.view(), target.index_axis(Axis(0), view)),
            Self::Ssim(target) => {
                ssim.value_and_grad(image.view(), &SsimTarget::new(&ssim, target.index_axis(Axis(0), view)))
            }
            Self::Both(target) => {
                let target = SsimTarget::new(&ssim, target.index_axis(Axis(0), view));
                let (loss, cotangent) = image_loss(&ssim, D_SSIM, image.view(), &target);
                (loss.total, cotangent)
            }
            Self::Volume(..) | Self::Tv(_) => unreachable!("a loss of volumes"),
        }
    }

    fn value(&self, primitives: &Primitives, projection: Projection) -> f64 {
        match self {
            Self::Volume(cotangent, grid) => (projector::voxelize::<f64>(primitives, grid, 0.0) * cotangent).sum(),
            Self::Tv(block) => tv::tv(projector::voxelize::<f64>(primitives, block, 0.0).view()).0,
            _ => {
                let images = projector::forward::<f64>(primitives, &scanner(), &ANGLES, projection, 0.0);
                let views = images.outer_iter().enumerate();
                views.map(|(view, image)| self.of_image(&image.to_owned(), view).0).sum()
            }
        }
    }

    fn gradient(&self, primitives: &Primitives, projection: Projection) -> Parameters {
        match self {
            Self::Volume(cotangent, grid) => projector::voxelize_vjp(primitives, grid, 0.0, cotangent.view()),
            Self::Tv(block) => {
                let (_, cotangent) = tv::tv(projector::voxelize::<f64>(primitives, block, 0.0).view());
                projector::voxelize_vjp(primitives, block, 0.0, cotangent.view())
            }
            _ => {
                let images = projector::forward::<f64>(primitives, &scanner(), &ANGLES, projection, 0.0);
                let mut cotangent = Array3::zeros(images.dim());
                for (view, image) in images.outer_iter().enumerate() {
                    let (_, of_view) = self.of_image(&image.to_owned(), view);
                    cotangent.index_axis_mut(Axis(0), view).assign(&of_view);
                }
                projector::vjp(primitives, &scanner(), &ANGLES, projection, 0.0, cotangent.view())
            }
        }
    }
}

/// A path of one parameter: along its axis, or along a great circle for quaternions.
#[derive(Clone, Copy, Debug)]
struct Path {
    group: Group,
    primitive: usize,
    component: usize,
    /// Change of the parameter per unit of step.
    size: f64,
}

/// `q·i`, `q·j`, `q·k`: orthogonal to q and to each other, of equal length.
fn tangents([w, x, y, z]: [f64; 4]) -> [[f64; 4]; 3] {
    [[-x, w, z, -y], [-y, -z, w, x], [-z, y, -x, w]]
}

impl Path {
    /// All paths of a group; the size of a raw parameter is 1.
    fn all(group: Group, at: &Parameters, scale: &[[f64; 3]], raw: bool) -> Vec<Self> {
        let components = if group == Group::Quaternion { 3 } else { group.width() };
        let path = |primitive: usize, component: usize| {
            let size = match group {
                Group::Mean => scale[primitive].into_iter().fold(f64::INFINITY, f64::min),
                Group::Quaternion => 1.0,
                _ if raw => 1.0,
                _ => at.group(group)[primitive * group.width() + component],
            };
            Self { group, primitive, component, size }
        };
        (0..at.len()).flat_map(|primitive| (0..components).map(move |c| path(primitive, c))).collect()
    }

    fn moved(&self, at: &Parameters, step: f64) -> Parameters {
        let mut moved = at.clone();
        if self.group == Group::Quaternion {
            let q = &mut moved.quaternion[self.primitive];
            let tangent = tangents(*q)[self.component];
            let (sine, cosine) = (libm::sin(step), libm::cos(step));
            q.iter_mut().zip(tangent).for_each(|(q, t)| *q = *q * cosine + t * sine);
        } else {
            moved.group_mut(self.group)[self.primitive * self.group.width() + self.component] += step * self.size;
        }
        moved
    }

    /// The derivative along the path, from a gradient.
    fn derivative(&self, at: &Parameters, gradient: &Parameters) -> f64 {
        let i = self.primitive;
        match self.group {
            Group::Quaternion => {
                let tangent = tangents(at.quaternion[i])[self.component];
                tangent.iter().zip(gradient.quaternion[i]).map(|(t, g)| t * g).sum()
            }
            group => gradient.group(group)[i * group.width() + self.component] * self.size,
        }
    }
}

/// Root mean square error of the differences for each step, relative to the gradient.
fn errors(value: &impl Fn(&Parameters) -> f64, at: &Parameters, gradient: &Parameters, paths: &[Path]) -> [f64; 3] {
    let norm = paths.iter().map(|path| path.derivative(at, gradient)).map(|d| d * d).sum::<f64>().sqrt();
    assert!(norm > 0.0, "no gradient along {:?}", paths[0]);
    STEPS.map(|h| {
        let error = |path: &Path| {
            (value(&path.moved(at, h)) - value(&path.moved(at, -h))) / (2.0 * h) - path.derivative(at, gradient)
        };
        paths.iter().map(error).map(|e| e * e).sum::<f64>().sqrt() / norm
    })
}

fn assert_second_order(what: &str, errors: [f64; 3], linear: bool) {
    let [first, second, third] = errors;
    eprintln!("{what:<58} {first:.1e} {second:.1e} {third:.1e}");
    // Where a loss is linear in a group, the error does not fall.
    if linear {
        within!("linear", first, "{what}: errors {errors:?} at steps {STEPS:?}");
    } else {
        let order = first / second / 100.0;
        within!("order", (order - 1.0).abs(), "{what}: errors {errors:?} at steps {STEPS:?} fall by {}", 100.0 * order);
    }
    within!("error", third, "{what}: at a step of {:e}", STEPS[2]);
}

/// Three overlapping primitives of all shapes, with a smooth field in the block of TV.
fn primitives(kernel: KernelKind) -> Primitives {
    let nu = |nu: f64| if kernel == KernelKind::Gaussian { f64::INFINITY } else { nu };
    Primitives::new(Parameters {
        mean: vec![[0.1, -0.2, 0.05], [-0.15, 0.1, -0.1], [0.0, 0.05, 0.12]],
        scale: vec![[0.3, 0.25, 0.4], [0.22, 0.35, 0.28], [0.33, 0.24, 0.2]],
        quaternion: vec![[0.9, 0.1, -0.2, 0.15], [1.1, -0.3, 0.1, 0.2], [-0.5, 0.1, 0.05, 0.1]],
        density: vec![0.7, 0.4, -0.1],
        nu: vec![nu(2.5), nu(9.0), nu(40.0)],
    })
    .unwrap()
}

fn combinations() -> impl Iterator<Item = (KernelKind, Projection, &'static str, Loss)> {
    let kernels = [KernelKind::StudentT, KernelKind::Gaussian].into_iter();
    let pairs =
        kernels.flat_map(|kernel| [Projection::Exact, Projection::Affine].map(|projection| (kernel, projection)));
    pairs.flat_map(|(kernel, projection)| {
        let losses = Loss::all(&primitives(kernel), projection).into_iter();
        // Losses on volumes do not depend on the projection.
        let losses = losses.filter(move |(_, loss)| {
            projection == Projection::Exact || !matches!(loss, Loss::Volume(..) | Loss::Tv(_))
        });
        losses.map(move |(name, loss)| (kernel, projection, name, loss))
    })
}

fn groups(kernel: KernelKind) -> impl Iterator<Item = Group> {
    Group::ALL.into_iter().filter(move |group| kernel == KernelKind::StudentT || *group != Group::Nu)
}

#[test]
fn gradients_to_physical_parameters_match_differences_of_second_order() {
    for (kernel, projection, name, loss) in combinations() {
        let at = primitives(kernel);
        let gradient = loss.gradient(&at, projection);
        let value = |p: &Parameters| loss.value(&Primitives { kernel, parameters: p.clone() }, projection);
        for group in groups(kernel) {
            let paths = Path::all(group, &at.parameters, &at.parameters.scale, false);
            let what = format!("{name}, {kernel:?} {projection:?}, {}", group.key());
            assert_second_order(&what, errors(&value, &at.parameters, &gradient, &paths), loss.is_linear_in(group));
        }
    }
}

#[test]
fn gradients_to_raw_parameters_match_differences_of_second_order() {
    for (kernel, projection, name, loss) in combinations() {
        let activation = activation(kernel);
        let mut positive = primitives(kernel);
        positive.parameters.density[2] = 0.1;
        let at = activation.inverse(&positive.parameters);
        let physical = activation.forward(&at);
        let mut gradient = loss.gradient(&physical, projection);
        activation.vjp(&physical, &mut gradient);
        let value = |raw: &Parameters| loss.value(&activation.forward(raw), projection);
        for group in groups(kernel) {
            let paths = Path::all(group, &at, &physical.parameters.scale, true);
            let what = format!("raw {name}, {kernel:?} {projection:?}, {}", group.key());
            assert_second_order(&what, errors(&value, &at, &gradient, &paths), false);
        }
    }
}

#[test]
fn the_length_of_a_quaternion_has_no_derivative() {
    for (kernel, projection, name, loss) in combinations() {
        let at = primitives(kernel);
        let gradient = loss.gradient(&at, projection).quaternion;
        for (i, (q, d)) in at.parameters.quaternion.iter().zip(&gradient).enumerate() {
            let radial: f64 = q.iter().zip(d).map(|(q, d)| q * d).sum();
            let size: f64 = q.iter().zip(d).map(|(q, d)| (q * d).abs()).sum();
            let what = format!("{name}, {kernel:?} {projection:?}, primitive {i}");
            within!(radial.abs() / size, "{what}: {radial:e} along {q:?}, gradient {d:?}");
        }
    }
}

/// No step of these tests crosses a kink of |·|: with twice the largest step, all signs stay the same.
#[test]
fn no_step_crosses_a_kink() {
    for (kernel, projection, name, loss) in combinations() {
        let signs = |primitives: &Primitives| -> Vec<bool> {
            match &loss {
                Loss::L1(target) | Loss::Both(target) => {
                    let images = projector::forward::<f64>(primitives, &scanner(), &ANGLES, projection, 0.0);
                    (images - target).iter().map(|d| *d > 0.0).collect()
                }
                Loss::Tv(block) => {
                    let values = projector::voxelize::<f64>(primitives, block, 0.0);
                    let along = |axis: usize| {
                        let lanes = values.lanes(Axis(axis)).into_iter().map(|lane| lane.to_vec());
                        lanes.flat_map(|lane| lane.windows(2).map(|pair| pair[1] > pair[0]).collect::<Vec<_>>())
                    };
                    (0..3).flat_map(along).collect()
                }
                _ => Vec::new(),
            }
        };
        for at in [primitives(kernel), {
            let mut positive = primitives(kernel);
            positive.parameters.density[2] = 0.1;
            positive
        }] {
            let here = signs(&at);
            for group in groups(kernel) {
                for path in Path::all(group, &at.parameters, &at.parameters.scale, false) {
                    for step in [2.0 * STEPS[0], -2.0 * STEPS[0]] {
                        let there = signs(&Primitives { kernel, parameters: path.moved(&at.parameters, step) });
                        assert!(here == there, "{name}, {kernel:?} {projection:?}: {path:?} crosses a kink");
                    }
                }
            }
        }
    }
}

#[test]
fn tangents_are_orthogonal_and_an_eighth_of_a_turn_is_where_it_should_be() {
    let q = [0.3, -0.7, 0.4, 0.2];
    for t in tangents(q) {
        within!(q.iter().zip(t).map(|(q, t)| q * t).sum::<f64>().abs());
    }
    let path = Path { group: Group::Quaternion, primitive: 0, component: 0, size: 1.0 };
    let at = Parameters { quaternion: vec![[1.0, 0.0, 0.0, 0.0]], ..Parameters::zeros(1) };
    let [w, x, y, z] = path.moved(&at, FRAC_PI_4).quaternion[0];
    within!("turn", (w - x).abs());
    assert_eq!([y, z], [0.0; 2]);
}
