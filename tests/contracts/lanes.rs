//! SIMD lanes against plain numbers, bit by bit: single operations, and all kernels on plain arrays.
//!
//! A build without wide registers emulates the lanes: both must equal the plain arithmetic of `common::plain`, or the
//! project's bits would depend on the build. Only the bits of a NaN may differ.

use crate::common::plain::{Plain32, Plain64};
use crate::common::scenes;
use crate::tolerances::largest;
use ndarray::Array3;
use rand::RngExt;
use trgs::classical::{RayModel, VoxelProjector};
use trgs::geometry::{Detector, Scanner};
use trgs::numeric::rng::{Purpose, stream};
use trgs::numeric::{Lanes, Real};
use trgs::primitives::{Group, KernelKind, Parameters, Primitives};
use trgs::projector::{self, Kernels, Projection};
use trgs::wavelet::{self, Routing};
use wide::{f32x8, f32x16, f64x4, f64x8};

/// Operands: zeros, subnormals, extreme numbers, infinities, NaN, ties, and random numbers.
///
/// Random numbers have every magnitude and sign; all are exact in single precision.
fn operands() -> Vec<f64> {
    let mut operands = vec![0.0, -0.0, f64::INFINITY, f64::NEG_INFINITY, f64::NAN];
    for x in [f32::from_bits(1), f32::from_bits(0x7f_ffff), f32::MIN_POSITIVE, f32::EPSILON, f32::MAX] {
        operands.extend([f64::from(x), -f64::from(x)]);
    }
    for x in
        [0.5, 1.0, 1.5, 2.5, 125.5, 126.0, 8_388_607.5, 1e15_f32.into(), 0.41421354, 0.41421357, 0.99999994, 1.0000001]
    {
        operands.extend([x, -x].map(|x| f64::from(x as f32)));
    }
    let mut random = stream(3, Purpose::Phantom, 97, 0);
    for _ in 0..3000 {
        let (mantissa, exponent) = (2.0 * random.random::<f64>() - 1.0, random.random_range(-60..=60));
        operands.push(f64::from((mantissa * libm::exp2(f64::from(exponent))) as f32));
        operands.push(f64::from(random.random::<f32>()));
    }
    operands
}

/// [`operands`] in another order, so that every pair has two different numbers.
fn others(operands: &[f64]) -> Vec<f64> {
    (0..operands.len()).map(|i| operands[(i * 31 + 7) % operands.len()]).collect()
}

/// Equality including the sign of zero; all NaN are equal.
fn same(a: f64, b: f64) -> bool {
    a.to_bits() == b.to_bits() || a.is_nan() && b.is_nan()
}

/// All lanes of a vector of numbers.
fn unpack<L: Lanes>(lanes: L) -> Vec<f64> {
    let half = L::WIDTH / 2;
    let mut rows = [vec![-L::Scalar::ZERO; half], vec![-L::Scalar::ZERO; half]];
    let [top, bottom] = &mut rows;
    // -0 is the neutral element of addition: a lane of -0 stays -0.
    lanes.add_to_rows(top, bottom);
    rows.concat().into_iter().map(Real::to_f64).collect()
}

/// An operation on lanes with up to three operands.
type Operation<L> = (&'static str, fn(L, L, L) -> L);

/// An operation with two operands, on registers of any kind.
type Binary<T> = (&'static str, fn(T, T) -> T);

fn operations<L: Lanes>() -> Vec<Operation<L>> {
    vec![
        ("add", |a, b, _| a + b),
        ("add_assign", |a, b, _| {
            let mut sum = a;
            sum += b;
            sum
        }),
        ("sub", |a, b, _| a - b),
        ("mul", |a, b, _| a * b),
        ("div", |a, b, _| a / b),
        ("neg", |a, _, _| -a),
        ("sqrt", |a, _, _| a.sqrt()),
        ("at_most", |a, b, _| a.at_most(b)),
        ("at_least", |a, b, _| a.at_least(b)),
        ("select_le", |a, b, c| a.select_le(b, c, a)),
        ("log2_1p", |a, _, _| a.log2_1p()),
        ("exp2", |a, _, _| a.exp2()),
        ("log2_1p of positive numbers", |a, _, _| (a * a).log2_1p()),
        ("log2_1p_near", |a, _, _| (a * a).at_most(L::splat(L::Scalar::from_f64(L::LOG_NEAR))).log2_1p_near()),
        ("rsqrt_1p_quarter", |a, _, _| a.rsqrt_1p_quarter()),
        ("rsqrt_1p_sixteenth", |a, _, _| a.rsqrt_1p_sixteenth()),
        ("exp2 down to the horizon", |a, _, _| {
            (-(a * a).at_most(L::splat(L::Scalar::from_f64(L::Scalar::HORIZON)))).exp2()
        }),
    ]
}

/// Results of an operation for `WIDTH` operands at a time.
fn packed<L: Lanes>(operation: fn(L, L, L) -> L, operands: &[f64]) -> Vec<f64> {
    let (second, third) = (others(operands), others(&others(operands)));
    let blocks = operands.len().div_ceil(L::WIDTH);
    let row = |values: &[f64], block: usize| {
        L::from_fn(|i| L::Scalar::from_f64(*values.get(block * L::WIDTH + i).unwrap_or(&0.0)))
    };
    let results = (0..blocks).flat_map(|b| unpack(operation(row(operands, b), row(&second, b), row(&third, b))));
    results.take(operands.len()).collect()
}

/// Results of an operation for each operand alone, copied to every lane.
fn splatted<L: Lanes>(operation: fn(L, L, L) -> L, operands: &[f64]) -> Vec<f64> {
    let (second, third) = (others(operands), others(&others(operands)));
    let splat = |x: f64| L::splat(L::Scalar::from_f64(x));
    let one = |i: usize| {
        let lanes = unpack(operation(splat(operands[i]), splat(second[i]), splat(third[i])));
        assert!(lanes.iter().all(|lane| same(*lane, lanes[0])), "lanes of the same operands differ: {lanes:?}");
        lanes[0]
    };
    (0..operands.len()).map(one).collect()
}

fn assert_operations_agree<Fast: Real, Plain: Real>() {
    let operands = operands();
    let second = others(&operands);
    for ((name, fast), (_, plain)) in operations::<Fast::Lanes>().into_iter().zip(operations::<Plain::Lanes>()) {
        let expected = packed(plain, &operands);
        for (how, found) in [("packed", packed(fast, &operands)), ("splatted", splatted(fast, &operands))] {
            for (i, (found, expected)) in found.iter().zip(&expected).enumerate() {
                let operand = (operands[i], second[i]);
                assert!(same(*found, *expected), "{name} of {operand:?}, {how}: {found:e}, plain {expected:e}");
            }
        }
        let defined = expected.iter().filter(|x| x.is_finite()).count();
        assert!(defined > operands.len() / 4, "{name}: only {defined} of {} results are finite", operands.len());
    }
}

#[test]
fn every_operation_on_sixteen_lanes_of_f32_is_that_on_one() {
    assert_operations_agree::<f32, Plain32<2>>();
    assert_operations_agree::<f32, Plain32<16>>();
}

#[test]
fn every_operation_on_eight_lanes_of_f64_is_that_on_one() {
    assert_operations_agree::<f64, Plain64<2>>();
    assert_operations_agree::<f64, Plain64<8>>();
}

/// Asserts that results in registers of half the width equal those of the operation called `name`.
fn assert_half<R: Real>(name: &str, halves: impl Iterator<Item = f64>) {
    let operation = operations::<R::Lanes>().into_iter().find(|(n, _)| *n == name).unwrap().1;
    let operands = operands();
    let second = others(&operands);
    let mut compared = 0;
    for (i, (half, whole)) in halves.zip(packed(operation, &operands)).enumerate() {
        let pair = (operands[i], second[i]);
        assert!(same(half, whole), "{name} of {pair:?}: half as wide {half:e}, whole {whole:e}");
        compared += 1;
    }
    assert!(compared > operands.len() - 8, "{compared} of {}", operands.len());
}

/// Registers of half the width, as on a machine with 256 bits.
#[test]
fn arithmetic_on_half_as_many_lanes_has_the_same_bits() {
    let (first, second) = (operands(), others(&operands()));
    let single: [Binary<f32x8>; 5] = [
        ("add", |a, b| a + b),
        ("sub", |a, b| a - b),
        ("mul", |a, b| a * b),
        ("div", |a, b| a / b),
        ("sqrt", |a, _| a.sqrt()),
    ];
    for (name, operation) in single {
        let row = |values: &[f64]| f32x8::new(std::array::from_fn(|i| values[i] as f32));
        let pairs = first.chunks_exact(8).zip(second.chunks_exact(8));
        assert_half::<f32>(name, pairs.flat_map(|(a, b)| operation(row(a), row(b)).to_array().map(f64::from)));
    }
    let double: [Binary<f64x4>; 5] = [
        ("add", |a, b| a + b),
        ("sub", |a, b| a - b),
        ("mul", |a, b| a * b),
        ("div", |a, b| a / b),
        ("sqrt", |a, _| a.sqrt()),
    ];
    for (name, operation) in double {
        let row = |values: &[f64]| f64x4::new(std::array::from_fn(|i| values[i]));
        let pairs = first.chunks_exact(4).zip(second.chunks_exact(4));
        assert_half::<f64>(name, pairs.flat_map(|(a, b)| operation(row(a), row(b)).to_array()));
    }
}

/// Sums of numbers of very different magnitudes depend on the order of addition.
fn assert_sum_is_the_documented_tree<R: Real>() {
    let operands: Vec<f64> = operands().into_iter().filter(|x| x.is_finite()).collect();
    let mut orders = 0;
    for block in operands.chunks_exact(R::Lanes::WIDTH) {
        let sum = R::Lanes::from_fn(|i| R::from_f64(block[i])).sum();
        let mut tree: Vec<f64> = block.to_vec();
        while tree.len() > 1 {
            let (low, high) = tree.split_at(tree.len() / 2);
            tree = low.iter().zip(high).map(|(a, b)| a + b).collect();
        }
        assert!(same(sum, tree[0]), "{block:?}: {sum:e}, by halves {:e}", tree[0]);
        orders += usize::from(block.iter().sum::<f64>() != tree[0]);
    }
    assert!(orders > 10, "these numbers do not tell one order from another");
}

#[test]
fn lanes_are_added_by_halves() {
    assert_sum_is_the_documented_tree::<f32>();
    assert_sum_is_the_documented_tree::<f64>();
}

/// Images of all kinds, the volume, and the gradients of both.
fn all<R: Kernels>(primitives: &Primitives, scanner: &Scanner, cutoff: f64) -> (Vec<Array3<f64>>, Vec<Parameters>) {
    let (mut arrays, mut gradients) = (Vec::new(), Vec::new());
    let angles = [0.7, 3.3];
    let cotangent = scenes::cotangent(81, (2, scanner.detector.rows, scanner.detector.columns)).mapv(R::from_f64);
    for projection in [Projection::Exact, Projection::Affine] {
        arrays.push(projector::forward::<R>(primitives, scanner, &angles, projection, cutoff).mapv(R::to_f64));
        gradients.push(projector::vjp(primitives, scanner, &angles, projection, cutoff, cotangent.view()));
    }
    let cotangent = scenes::cotangent(82, scanner.grid.shape).mapv(R::from_f64);
    arrays.push(projector::voxelize::<R>(primitives, &scanner.grid, cutoff).mapv(R::to_f64));
    gradients.push(projector::voxelize_vjp(primitives, &scanner.grid, cutoff, cotangent.view()));
    (arrays, gradients)
}

fn bits((arrays, gradients): &(Vec<Array3<f64>>, Vec<Parameters>)) -> Vec<u64> {
    let gradients = gradients.iter().flat_map(|gradient| Group::ALL.map(|group| gradient.group(group)));
    arrays.iter().flatten().chain(gradients.flatten()).map(|x| x.to_bits()).collect()
}

fn assert_kernels_agree_bit_by_bit<Fast: Kernels, Plain: Kernels>() {
    for kernel in [KernelKind::StudentT, KernelKind::Gaussian] {
        for scanner in [scenes::cone(), scenes::parallel()] {
            for cutoff in [0.0, 1e-3] {
                let primitives = scenes::primitives(kernel, 21, 83);
                let (fast, plain) =
                    (all::<Fast>(&primitives, &scanner, cutoff), all::<Plain>(&primitives, &scanner, cutoff));
                assert!(
                    bits(&fast) == bits(&plain),
                    "{kernel:?} {:?} {cutoff}: bits differ from plain arithmetic",
                    scanner.beam
                );
            }
        }
    }
}

#[test]
fn all_kernels_have_the_same_bits_in_plain_arithmetic() {
    assert_kernels_agree_bit_by_bit::<f32, Plain32<16>>();
    assert_kernels_agree_bit_by_bit::<f64, Plain64<8>>();
}

/// The wavelet loss of a block and its gradient.
fn wavelets<R: Real>(shape: [usize; 3], levels: usize) -> Vec<u64> {
    let number = |i: usize| R::from_f64(f64::from(((i * 7919 + 13) % 1009) as f32 / 1009.0));
    let [_, y, z] = shape;
    let block = Array3::from_shape_fn(shape, |(i, j, k)| number((i * y + j) * z + k));
    let high = Array3::from_shape_fn(shape, |(i, j, k)| ((3 * i + 5 * j + 7 * k) % 9) as u16);
    let settings = wavelet::Settings { levels, ..wavelet::Settings::default() };
    let loss = wavelet::wavelet_loss(block.view(), &Routing { high, neighbours: 8 }, &settings);
    assert!(loss.enhancement > 0.0 && loss.suppression > 0.0);
    let gradient = loss.gradient.iter().map(|d| d.to_f64());
    gradient.chain([loss.value, loss.enhancement, loss.suppression]).map(f64::to_bits).collect()
}

/// Rows of cells shorter than a register, as long, and longer.
#[test]
fn wavelet_losses_have_the_same_bits_in_plain_arithmetic() {
    for (shape, levels) in [([2, 2, 2], 1), ([4, 6, 10], 1), ([6, 4, 32], 1), ([4, 10, 44], 1), ([8, 12, 72], 2)] {
        assert!(wavelets::<f32>(shape, levels) == wavelets::<Plain32<16>>(shape, levels), "f32, {shape:?}");
        assert!(wavelets::<f64>(shape, levels) == wavelets::<Plain64<8>>(shape, levels), "f64, {shape:?}");
    }
}

/// Largest difference relative to the largest value of each array.
fn distance(a: &[Array3<f64>], b: &[Array3<f64>]) -> f64 {
    let one = |(a, b): (&Array3<f64>, &Array3<f64>)| {
        let peak = b.iter().fold(0.0_f64, |m, x| m.max(x.abs()));
        (a - b).iter().fold(0.0_f64, |m, d| if d.is_nan() { f64::INFINITY } else { m.max(d.abs()) }) / peak
    };
    a.iter().zip(b).map(one).fold(0.0, f64::max)
}

/// The lane width is a constant because the last bits depend on it.
///
/// A column's distance from the centre is computed from that of its register's first column. Nothing else may depend on
/// the width.
#[test]
fn another_width_changes_the_last_bits_only() {
    let primitives = scenes::primitives(KernelKind::StudentT, 21, 84);
    let scanner = scenes::cone();
    let (fast, narrow) = (all::<f64>(&primitives, &scanner, 0.0), all::<Plain64<4>>(&primitives, &scanner, 0.0));
    within!("f64", distance(&narrow.0, &fast.0));
    let (fast, narrow) = (all::<f32>(&primitives, &scanner, 0.0), all::<Plain32<4>>(&primitives, &scanner, 0.0));
    within!("f32", distance(&narrow.0, &fast.0));
}

/// A detector of one column or one row leaves most lanes empty.
///
/// Its pixel must equal that of a whole detector in which the same pixel starts a register: the largest difference,
/// relative to the peak.
fn narrow<R: Kernels>() -> f64 {
    let mut worst = Vec::new();
    let (d, angles) = (scenes::cone().detector, [0.7]);
    for kernel in [KernelKind::StudentT, KernelKind::Gaussian] {
        let primitives = scenes::primitives(kernel, 21, 85);
        let image = |detector: Detector| {
            let scanner = Scanner { detector, ..scenes::cone() };
            projector::forward::<R>(&primitives, &scanner, &angles, Projection::Exact, 0.0).mapv(R::to_f64)
        };
        let whole = image(d);
        let peak = whole.iter().fold(0.0_f64, |m, x| m.max(x.abs()));
        for (row, column) in [(0, 0), (3, 44), (36, 17), (17, 24)] {
            let (u, v) = d.position(row as f64, column as f64);
            let one = image(Detector { rows: 1, columns: 1, offset_u: u, offset_v: v, ..d })[[0, 0, 0]];
            let (_, v) = d.position((d.rows as f64 - 1.0) / 2.0, 0.0);
            let line = image(Detector { columns: 1, offset_u: u, offset_v: v, ..d })[[0, row, 0]];
            let expected = whole[[0, row, column]];
            worst.extend([one, line].map(|found| (found - expected) / peak));
        }
    }
    largest(worst)
}

#[test]
fn a_pixel_alone_is_the_pixel_of_a_whole_detector() {
    within!("f64", narrow::<f64>());
    within!("f32", narrow::<f32>());
}

/// Projections of a volume and their adjoint in one number type; the detector's rows are `pitch` apart.
fn voxels<R: Real>(pitch: f64) -> Vec<u64> {
    let mut scanner = scenes::cone();
    (scanner.detector.rows, scanner.detector.columns, scanner.detector.pitch_v) = (45, 21, pitch);
    let number = |i: usize| R::from_f64(f64::from(((i * 7919 + 13) % 1009) as f32 / 1009.0));
    let [x, y, z] = scanner.grid.shape;
    let volume = Array3::from_shape_fn((x, y, z), |(i, j, k)| number((i * y + j) * z + k));
    let projector = VoxelProjector::new(&scanner, RayModel::Joseph).unwrap();
    let images = projector.forward(&[0.3, 2.0], volume.view()).unwrap();
    let adjoint = projector.adjoint(&[0.3, 2.0], images.view()).unwrap();
    assert!(images.iter().any(|value| value.to_f64() > 0.0));
    images.iter().chain(&adjoint).map(|value| value.to_f64().to_bits()).collect()
}

#[test]
fn rays_through_voxels_are_plain_numbers_at_every_pitch() {
    for pitch in [0.02, 0.06, 0.1, 0.3] {
        assert!(voxels::<f32>(pitch) == voxels::<Plain32<16>>(pitch), "f32 at pitch {pitch}");
        assert!(voxels::<f64>(pitch) == voxels::<Plain64<8>>(pitch), "f64 at pitch {pitch}");
    }
}

#[test]
fn exp2_is_exact_at_the_integers_down_to_the_horizon() {
    for n in 0..=126 {
        assert_eq!(Lanes::exp2(f32x16::splat(-(n as f32))).to_array()[0], libm::exp2f(-(n as f32)));
        assert_eq!(Lanes::exp2(f64x8::splat(-f64::from(n))).to_array()[7], libm::exp2(-f64::from(n)));
    }
    assert_eq!(Lanes::exp2(f64x8::splat(-1022.0)).to_array()[7], f64::MIN_POSITIVE);
}
