//! The wavelet loss and its gradient.

use super::Settings;
use super::detail::{Scratch, Weights, strength};
use super::haar::{self, BANDS, Subbands};
use super::routing::Routing;
use crate::numeric::threads::{self, Pool};
use crate::numeric::{Real, reduce};
use ndarray::{Array3, ArrayView3};

/// The bands that count in each level: not the low one, not the one that is high along all axes `[Eq. 11]`.
const MIDDLE: std::ops::RangeInclusive<usize> = 1..=6;

/// Value and gradient of the wavelet loss `[Eq. 15]`.
#[derive(Clone, Debug)]
pub struct WaveletLoss<R> {
    /// `L = λ_supp·S - λ_enh·E`.
    pub value: f64,
    /// E, the mean of `η·|N_high|/K·g` over the voxels.
    pub enhancement: f64,
    /// S, the mean of `|N_low|/K·g` over the voxels.
    pub suppression: f64,
    /// ∂L/∂block `[x, y, z]`.
    pub gradient: Array3<R>,
}

/// Buffers of [`wavelet_loss_into`].
///
/// With one level nothing is allocated while blocks have the size of the last one.
#[derive(Debug, Default)]
pub struct Workspace<R: Real> {
    weights: Pool<Weights<R>>,
    bands: Pool<Scratch<R>>,
    subbands: Pool<Subbands<R>>,
    slopes: Pool<Subbands<R>>,
}

/// Value and gradient of the wavelet loss of a block `[x, y, z]` `[Eq. 14]`, `[Eq. 15]`; formulas in [`super`].
///
/// The gradient treats the routing as constant. It is computed in the coefficients of each band and transformed back.
/// Where a band is flat (`|∇| ≪ 1e-6`) its gradient tends to 0.
/// Bands are computed in parallel and summed in order, voxels of a cell in the block's precision, cells in f64.
///
/// Tests: against [`super::naive::wavelet_loss`] to 1e-13 in f64 and 1e-5 in f32, and central differences.
///
/// # Panics
/// When block and routing differ in shape, a voxel has more confident neighbours than neighbours, or a side cannot be halved
/// `settings.levels` times.
pub fn wavelet_loss<R: Real>(block: ArrayView3<R>, routing: &Routing, settings: &Settings) -> WaveletLoss<R> {
    let mut gradient = Array3::default((0, 0, 0));
    let [value, enhancement, suppression] =
        wavelet_loss_into(block, routing, settings, &Workspace::default(), &mut gradient);
    WaveletLoss { value, enhancement, suppression, gradient }
}

/// L, E and S of [`wavelet_loss`] `[Eq. 15]`; the gradient is written to an existing array.
///
/// # Panics
/// As [`wavelet_loss`].
pub fn wavelet_loss_into<R: Real>(
    block: ArrayView3<R>,
    routing: &Routing,
    settings: &Settings,
    workspace: &Workspace<R>,
    gradient: &mut Array3<R>,
) -> [f64; 3] {
    assert_eq!(block.shape(), routing.high.shape(), "shapes of block and routing");
    let (x, y, z) = block.dim();
    let shape = [x, y, z];
    let (mut subbands, mut of_subbands) = (workspace.subbands.take(), workspace.slopes.take());
    haar::forward_into(block, settings.levels, &mut subbands);
    of_subbands.fit(shape, settings.levels);
    let (k, most) = (routing.neighbours, routing.high.iter().fold(0, |most, &high| high.max(most)));
    assert!(usize::from(most) <= k, "{most} confident neighbours of {k}");
    // Divisor of all counts: neighbours, voxels and bands.
    let share = (k * block.len() * settings.levels * MIDDLE.count()) as f64;
    let mut weights = workspace.weights.take();
    weights.fit(routing, settings, share);
    let mut sums = [0.0; 2];
    for level in 1..=settings.levels {
        let slopes = of_subbands.levels[level - 1].as_slice_mut().expect("coefficients are contiguous");
        let mut of_bands = [[0.0; 2]; BANDS];
        let bands = (threads::chunks(slopes, block.len() >> (3 * level)), threads::chunks(&mut of_bands, 1));
        threads::for_each_zip(bands, |band, (slopes, sums)| {
            if MIDDLE.contains(&band) {
                let mut scratch = workspace.bands.take();
                let coefficients = subbands.band(level, band);
                if level == 1 {
                    sums[0] = strength(coefficients, band, &weights, &mut scratch, slopes);
                } else {
                    // A coarser band is the same block as low coefficients of level 1.
                    let half = shape.map(|side| side / 2);
                    let alone = haar::alone(coefficients, half, level - 1, band);
                    let mut of_alone = vec![R::ZERO; alone.len()];
                    sums[0] = strength(&alone, 0, &weights, &mut scratch, &mut of_alone);
                    slopes.copy_from_slice(&haar::coefficients(&of_alone, half, level - 1, band));
                }
            }
        });
        sums = std::array::from_fn(|i| sums[i] + reduce::sum_by(BANDS, &|band| of_bands[band][i]));
    }
    let [enhancement, suppression] = sums;
    let (enhancement, suppression) = (settings.enhancement * enhancement / share, suppression / share);
    haar::inverse_into(&of_subbands, gradient);
    [settings.suppress * suppression - settings.enhance * enhancement, enhancement, suppression]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::numeric::rng::{Purpose, stream};
    use crate::tolerances::{largest, relative};
    use crate::wavelet::naive;
    use rand::RngExt;

    const SETTINGS: Settings = Settings { suppress: 0.7, enhance: 0.4, ..plain() };

    const fn plain() -> Settings {
        Settings { neighbours: 8, threshold: 0.35, enhancement: 1.5, suppress: 1e-3, enhance: 1e-3, levels: 1 }
    }

    fn block(shape: [usize; 3], seed: u64) -> Array3<f64> {
        let mut random = stream(seed, Purpose::Phantom, 2, 0);
        Array3::from_shape_simple_fn(shape, || random.random::<f64>())
    }

    fn routing(shape: [usize; 3], neighbours: usize) -> Routing {
        let high = Array3::from_shape_fn(shape, |(x, y, z)| ((3 * x + 5 * y + 7 * z) % (neighbours + 1)) as u16);
        Routing { high, neighbours }
    }

    fn worst(a: &Array3<f64>, b: &Array3<f64>) -> f64 {
        let peak = b.iter().fold(0.0_f64, |m, v| m.max(v.abs()));
        a.iter().zip(b).fold(0.0_f64, |m, (a, b)| m.max((a - b).abs())) / peak
    }

    #[test]
    fn loss_and_gradient_agree_with_the_naive_twin() {
        for (shape, levels) in [([2, 2, 2], 1), ([4, 6, 8], 1), ([10, 2, 6], 1), ([8, 4, 4], 2)] {
            let (block, routing) = (block(shape, 3), routing(shape, 5));
            let settings = Settings { levels, ..SETTINGS };
            let expected = naive::wavelet_loss(&block, &routing, &settings);
            let found = wavelet_loss(block.view(), &routing, &settings);
            let single = wavelet_loss(block.mapv(|v| v as f32).view(), &routing, &settings);
            for (got, single, expected) in [
                (found.value, single.value, expected.value),
                (found.enhancement, single.enhancement, expected.enhancement),
                (found.suppression, single.suppression, expected.suppression),
            ] {
                within!((got - expected).abs() / expected.abs(), "{shape:?}: {got} or {expected}");
                within!("f32", (single - expected).abs() / expected.abs(), "{shape:?}: {single} or {expected}");
            }
            let error = worst(&found.gradient, &expected.gradient);
            within!(error, "{shape:?}, {levels} levels: {error:e}");
            let error = worst(&single.gradient.mapv(f64::from), &expected.gradient);
            within!("f32", error, "{shape:?}, {levels} levels, f32: {error:e}");
        }
    }

    #[test]
    fn gradient_matches_central_differences() {
        for (shape, levels) in [([4, 6, 2], 1), ([4, 4, 8], 2)] {
            let (block, routing) = (block(shape, 4), routing(shape, 8));
            let settings = Settings { levels, ..SETTINGS };
            let gradient = wavelet_loss(block.view(), &routing, &settings).gradient;
            let peak = gradient.iter().fold(0.0_f64, |m, v| m.max(v.abs()));
            for (voxel, analytic) in gradient.indexed_iter() {
                let moved = |by: f64| {
                    let mut block = block.clone();
                    block[voxel] += by;
                    wavelet_loss(block.view(), &routing, &settings).value
                };
                let difference = (moved(1e-5) - moved(-1e-5)) / 2e-5;
                within!((analytic - difference).abs() / peak, "{voxel:?}: {analytic:e} or {difference:e}");
            }
        }
    }

    /// A step of 2 along x: bands 0 and 4. Band 4 alone is +1, -1, whose only difference is -2 at both voxels of a pair.
    #[test]
    fn loss_of_a_block_of_eight_voxels_is_that_computed_by_hand() {
        let block = Array3::from_shape_fn((2, 2, 2), |(x, _, _)| if x == 0 { 5.0 } else { 3.0 });
        let routing = Routing { high: Array3::from_shape_fn((2, 2, 2), |(_, y, z)| (2 * y + z) as u16), neighbours: 3 };
        let settings = Settings { suppress: 0.25, enhance: 0.5, ..plain() };
        let loss = wavelet_loss(block.view(), &routing, &settings);
        // Five of the six bands are flat: √1e-12 each. The mean of high/3 over the voxels is a half.
        let g = (2.0 + 5.0 * 1e-6) / 6.0;
        within!(relative(loss.enhancement, 1.5 * g / 2.0));
        within!(relative(loss.suppression, g / 2.0));
        within!(relative(loss.value, 0.25 * g / 2.0 - 0.5 * 0.75 * g));
        // The step of 2 is the difference of two means of four voxels: ±1/4 for each, in one band of six.
        let slope = (0.25 * 0.5 - 0.5 * 0.75) / 6.0 / 4.0;
        for ((x, ..), d) in loss.gradient.indexed_iter() {
            within!("slope", relative(*d, if x == 0 { slope } else { -slope }));
        }
    }

    #[test]
    fn more_detail_lowers_the_loss_near_confident_primitives_and_raises_it_near_others() {
        let block = block([4, 6, 4], 8);
        let sharper = block.mapv(|v| 1.1 * v);
        for (high, sign) in [(8, -1.0), (0, 1.0)] {
            let routing = Routing { high: Array3::from_elem([4, 6, 4], high), neighbours: 8 };
            let [before, after] = [&block, &sharper].map(|b| wavelet_loss(b.view(), &routing, &plain()));
            assert!(sign * before.value > 0.0 && sign * (after.value - before.value) > 0.0, "{high} of 8");
            let (one, other) = if high == 8 {
                (before.enhancement, before.suppression)
            } else {
                (before.suppression, before.enhancement)
            };
            assert!(one > 0.0 && other == 0.0, "{one} and {other}");
            let along: f64 = before.gradient.iter().zip(&block).map(|(d, v)| d * v).sum();
            assert!(sign * along > 0.0, "the gradient along the block: {along}");
        }
    }

    #[test]
    fn blocks_of_other_shapes_before_it_do_not_matter_to_a_block() {
        let (workspace, mut gradient) = (Workspace::default(), Array3::default((0, 0, 0)));
        // A slice of sixteen cells, of three, of fifteen: what is left over in registers is not that of the last one.
        for (shape, neighbours) in [([4, 8, 8], 8), ([6, 2, 6], 8), ([4, 6, 10], 5), ([4, 8, 8], 3)] {
            let (block, routing) = (block(shape, 6), routing(shape, neighbours));
            let found = wavelet_loss_into(block.view(), &routing, &plain(), &workspace, &mut gradient);
            let expected = wavelet_loss(block.view(), &routing, &plain());
            assert_eq!(found, [expected.value, expected.enhancement, expected.suppression], "{shape:?}");
            assert_eq!(gradient, expected.gradient, "{shape:?}");
        }
    }

    #[test]
    fn a_constant_block_has_a_strength_of_rounding_and_no_gradient() {
        let routing = routing([4, 4, 4], 8);
        let loss = wavelet_loss(Array3::from_elem([4, 4, 4], 0.3_f32).view(), &routing, &plain());
        within!(largest([loss.enhancement, loss.suppression]));
        assert!(loss.gradient.iter().all(|d| *d == 0.0), "{:?}", loss.gradient);
    }

    #[test]
    fn bits_do_not_depend_on_threads_nor_on_how_the_block_lies_in_memory() {
        let (block, routing) = (block([8, 12, 6], 9), routing([8, 12, 6], 8));
        let turned = block.clone().permuted_axes([2, 0, 1]).as_standard_layout().into_owned();
        let settings = Settings { levels: 1, ..plain() };
        let run = |threads: usize, view: ArrayView3<f64>| {
            threads::install(threads, || wavelet_loss(view, &routing, &settings)).unwrap()
        };
        let alone = run(1, block.view());
        for found in [run(2, block.view()), run(3, block.view()), run(2, turned.view().permuted_axes([1, 2, 0]))] {
            assert_eq!(found.value.to_bits(), alone.value.to_bits());
            assert!(found.gradient.iter().zip(&alone.gradient).all(|(a, b)| a.to_bits() == b.to_bits()));
        }
    }
}
