//! Parts of the networks by themselves, for the vectors of the oracle. Not in the paper.
//!
//! Arrays have a row for each point or pair; they go through the registers of the runs. `R` is the precision of the kernels.

use super::block::{BlockTrace, BlockWeights, PARTS, rows};
use super::encoding::{Encoding, FEATURES, Level};
use super::linear::{HIDDEN, stride};
use super::network::split;
use super::rays::{self, MeasuredRay};
use ndarray::{Array1, Array2, Array3, ArrayD, ArrayView2, ArrayView3};
use trgs_core::error::{Error, Result};
use trgs_core::geometry::Scanner;
use trgs_core::numeric::{Lanes, Real, WIDEST, real};

/// The level of a table with so many entries.
fn level(resolution: u32, entries: u32) -> Level {
    Level { resolution, entries, first: 0 }
}

/// Points, from 0 to 1 along each side, in registers; the last is repeated.
fn registers<R: Real>(points: ArrayView2<f64>) -> Vec<[R::Lanes; 3]> {
    let count = points.nrows();
    let row = |row: usize| {
        std::array::from_fn(|axis| {
            let place = |lane: usize| points[[(row * R::Lanes::WIDTH + lane).min(count - 1), axis]];
            R::Lanes::from_fn(|lane| real(place(lane)))
        })
    };
    (0..count.div_ceil(R::Lanes::WIDTH)).map(row).collect()
}

/// The corners of the cells that points lie in: the number of their entry and their weight, `[point, corner]`, x fastest.
pub fn corners<R: Real>(resolution: u32, entries: u32, points: ArrayView2<f64>) -> [Array2<f64>; 2] {
    let level = level(resolution, entries);
    let shape = [points.nrows(), 8];
    let [mut numbers, mut weights] = [Array2::zeros(shape), Array2::zeros(shape)];
    let all = registers::<R>(points).into_iter().flat_map(|points| level.corners_of::<R>(&points));
    for (point, corners) in all.take(shape[0]).enumerate() {
        for (corner, (entry, weight)) in corners.into_iter().enumerate() {
            numbers[[point, corner]] = entry as f64;
            weights[[point, corner]] = weight.to_f64();
        }
    }
    [numbers, weights]
}

/// Codes of points, `[point, feature]`: of a level of the hash grid with this table, `[entry, feature]`.
pub fn hash_code<R: Real>(resolution: u32, table: ArrayView2<f64>, points: ArrayView2<f64>) -> Array2<f64> {
    let encoding = Encoding::Hash(vec![level(resolution, table.nrows() as u32)]);
    let table: Vec<R> = table.iter().map(|&value| real(value)).collect();
    code::<R>(&encoding, &table, [1.0; 3], points)
}

/// Codes of points, `[point, number]`: coordinates within a box with these half sides, sines and cosines.
pub fn frequency_code<R: Real>(frequencies: usize, half_sides: [f64; 3], points: ArrayView2<f64>) -> Array2<f64> {
    code::<R>(&Encoding::Frequencies(frequencies), &[], half_sides, points)
}

fn code<R: Real>(encoding: &Encoding, table: &[R], frame: [f64; 3], points: ArrayView2<f64>) -> Array2<f64> {
    let width = encoding.width();
    let mut codes = Array2::zeros([points.nrows(), width]);
    let mut lanes = vec![R::Lanes::default(); width];
    for (row, register) in registers::<R>(points).iter().enumerate() {
        encoding.encode(table, register, frame, &mut lanes);
        for (number, lanes) in lanes.iter().enumerate() {
            let mut values = [R::ZERO; WIDEST];
            lanes.write(&mut values);
            for (lane, value) in values.iter().enumerate().take(R::Lanes::WIDTH) {
                if let Some(code) = codes.get_mut([row * R::Lanes::WIDTH + lane, number]) {
                    *code = value.to_f64();
                }
            }
        }
    }
    codes
}

/// The gradient to a table, `[entry, feature]`, from the one to the codes of points, `[point, feature]`.
pub fn hash_code_vjp<R: Real>(
    resolution: u32,
    entries: u32,
    points: ArrayView2<f64>,
    cotangent: ArrayView2<f64>,
) -> Array2<f64> {
    let mut gradient = vec![R::ZERO; entries as usize * FEATURES];
    for (row, register) in registers::<R>(points).iter().enumerate() {
        let slopes: [R::Lanes; FEATURES] = std::array::from_fn(|k| {
            let at = |lane: usize| cotangent.get([row * R::Lanes::WIDTH + lane, k]).copied().unwrap_or(0.0);
            R::Lanes::from_fn(|lane| real(at(lane)))
        });
        level(resolution, entries).add_gradient(register, &slopes, &mut gradient);
    }
    let gradient = gradient.into_iter().map(Real::to_f64).collect();
    Array2::from_shape_vec([entries as usize, FEATURES], gradient).expect("as many numbers as entries have")
}

/// Points of rays and the line integrals of densities there.
#[derive(Clone, Debug, PartialEq)]
pub struct Quadrature {
    /// Points `[ray, sample, axis]`, scene units.
    pub points: Array3<f64>,
    /// The length that each point stands for `[ray, sample]`, scene units.
    pub lengths: Array2<f64>,
    /// Line integral of each ray.
    pub integrals: Array1<f64>,
}

/// The quadrature along rays, one for each row of `draws` (from 0 to 1, `[ray, sample]`) and of `densities`; `pixels` has view,
/// row and column of each.
///
/// # Errors
/// When a ray misses the box of the volume.
pub fn quadrature(
    scanner: &Scanner,
    angles: &[f64],
    pixels: ArrayView2<f64>,
    draws: ArrayView2<f64>,
    densities: ArrayView2<f64>,
) -> Result<Quadrature> {
    let (rays, samples) = draws.dim();
    let mut found = Quadrature {
        points: Array3::zeros([rays, samples, 3]),
        lengths: Array2::zeros([rays, samples]),
        integrals: Array1::zeros(rays),
    };
    for ray in 0..rays {
        let [view, row, column] = [0, 1, 2].map(|k| pixels[[ray, k]] as usize);
        let line = scanner.view(angles[view]).ray(row, column);
        let [near, far] = rays::crossing(&scanner.grid, &line).ok_or_else(|| {
            let got = format!("row {row}, column {column} of view {view}");
            Error::invalid("pixels", got, "a ray through the volume", "leave it out")
        })?;
        let measured = MeasuredRay { ray: line, near, far, value: 0.0 };
        for (sample, (point, length)) in rays::points(&measured, &draws.row(ray).to_vec()).into_iter().enumerate() {
            (0..3).for_each(|axis| found.points[[ray, sample, axis]] = point[axis]);
            found.lengths[[ray, sample]] = length;
            found.integrals[ray] += densities[[ray, sample]] * length;
        }
    }
    Ok(found)
}

/// Names and shapes of the parts of the Lineformer block's parameters, in order; weights are `[outputs, inputs]`.
pub fn lineformer_parts() -> impl Iterator<Item = (&'static str, &'static [usize])> {
    PARTS.iter().map(|part| (part.name, part.shape))
}

/// Registers of pairs `[pair, point, number]`: rows 2g and 2g+1 have the first and the second points.
fn pairs<R: Real>(x: ArrayView3<f64>) -> Vec<R::Lanes> {
    let count = x.dim().0;
    let mut lanes = Vec::new();
    let groups = count.div_ceil(R::Lanes::WIDTH);
    rows(&mut lanes, 2 * groups, HIDDEN);
    for (row, lanes) in lanes.chunks_exact_mut(stride(HIDDEN)).enumerate() {
        for (number, lanes) in lanes.iter_mut().enumerate().take(HIDDEN) {
            let pair = |lane: usize| row / 2 * R::Lanes::WIDTH + lane;
            *lanes = R::Lanes::from_fn(|lane| real(x.get([pair(lane), row % 2, number]).copied().unwrap_or(0.0)));
        }
    }
    lanes
}

/// `[pair, point, number]` of registers of pairs.
fn unpaired<R: Real>(lanes: &[R::Lanes], count: usize) -> Array3<f64> {
    let mut values = Array3::zeros([count, 2, HIDDEN]);
    for (row, lanes) in lanes.chunks_exact(stride(HIDDEN)).enumerate() {
        for (number, lanes) in lanes.iter().enumerate().take(HIDDEN) {
            let mut of = [R::ZERO; WIDEST];
            lanes.write(&mut of);
            for (lane, of) in of.iter().enumerate().take(R::Lanes::WIDTH) {
                if let Some(value) = values.get_mut([row / 2 * R::Lanes::WIDTH + lane, row % 2, number]) {
                    *value = of.to_f64();
                }
            }
        }
    }
    values
}

/// The output of the Lineformer block for pairs `[pair, point, number]`.
pub fn lineformer<R: Real>(parameters: &[f64], x: ArrayView3<f64>) -> Array3<f64> {
    let (lanes, mut trace) = (pairs::<R>(x), BlockTrace::default());
    let mut output = lanes.clone();
    weights::<R>(parameters).forward(&lanes, &mut trace, &mut output);
    unpaired::<R>(&output, x.dim().0)
}

fn weights<R: Real>(parameters: &[f64]) -> BlockWeights<R> {
    let parameters: Vec<R> = parameters.iter().map(|&value| real(value)).collect();
    BlockWeights::new(&parameters)
}

/// The gradient to the parts of the Lineformer block's parameters, and to the pairs, from the one to its output.
pub fn lineformer_vjp<R: Real>(
    parameters: &[f64],
    x: ArrayView3<f64>,
    cotangent: ArrayView3<f64>,
) -> (Vec<(String, ArrayD<f64>)>, Array3<f64>) {
    let (lanes, mut trace) = (pairs::<R>(x), BlockTrace::default());
    let (mut slopes, mut gradient) = (pairs::<R>(cotangent), vec![0.0; parameters.len()]);
    let weights = weights::<R>(parameters);
    weights.forward(&lanes, &mut trace, &mut lanes.clone());
    weights.backward(&mut trace, &mut slopes, &mut gradient);
    let parts = lineformer_parts().map(|(name, shape)| (name.to_owned(), shape.to_vec()));
    (split(&gradient, parts), unpaired::<R>(&slopes, x.dim().0))
}
