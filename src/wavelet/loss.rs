//! Strength of the detail, the loss and its gradient.

use super::haar::{self, BANDS, Subbands};
use super::routing::Routing;
use super::{FLAT, Settings, differences};
use crate::numeric::{Real, real, reduce, threads};
use ndarray::{Array3, ArrayView3};

/// The bands that count in each level: not the low one, not the one that is high along all axes `[Eq. 11]`.
const MIDDLE: std::ops::RangeInclusive<usize> = 1..=6;

/// Slices that a band is gone through with, and numbers between them: a slice of 32² is a page, and a processor takes
/// what was written at a place of one page for what is read at the same place of another.
const SLICES: usize = 11;
const GAP: usize = 256;
/// Sums that are added to by turns.
const LANES: usize = 16;

/// What a block has to answer for `[Eq. 15]`.
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

/// Value and gradient of the wavelet loss of a block `[x, y, z]` `[Eq. 14]`, `[Eq. 15]`; formulas in [`super`].
///
/// The routing is constant to the gradient, which goes from a band alone through the transpose of the differences and
/// back through the transform. Where a band is flat (`|∇| ≪ 1e-6`) the gradient to it fades to 0.
/// Bands are computed in parallel and added up in order, voxels in a tree in f64.
///
/// Tests: against [`super::naive::wavelet_loss`] to 1e-13 in f64 and 1e-5 in f32, and central differences.
///
/// # Panics
/// When block and routing differ in shape, a voxel has more confident neighbours than neighbours, or a side cannot be halved
/// `settings.levels` times.
pub fn wavelet_loss<R: Real>(block: ArrayView3<R>, routing: &Routing, settings: &Settings) -> WaveletLoss<R> {
    assert_eq!(block.shape(), routing.high.shape(), "shapes of block and routing");
    let (x, y, z) = block.dim();
    let shape = [x, y, z];
    let subbands = haar::forward(block, settings.levels);
    let high = routing.high.as_standard_layout();
    let high = high.as_slice().expect("standard layout");
    let k = routing.neighbours as f64;
    // What a voxel's count is divided by: neighbours, voxels and bands.
    let share = k * high.len() as f64 * (settings.levels * MIDDLE.count()) as f64;
    let slope = |high: usize| {
        let (high, low) = (high as f64, k - high as f64);
        R::from_f64((settings.suppress * low - settings.enhance * settings.enhancement * high) / share)
    };
    let slopes: Vec<R> = (0..=routing.neighbours).map(slope).collect();
    let push: Vec<R> = high.iter().map(|&high| slopes[usize::from(high)]).collect();
    let mut gradient = Subbands::zeros(shape, settings.levels);
    let mut sums = [0.0; 2];
    for level in 1..=settings.levels {
        let slopes = gradient.levels[level - 1].as_slice_mut().expect("coefficients are contiguous");
        let mut of_bands = [[0.0; 2]; BANDS];
        let bands = (threads::chunks(slopes, high.len() >> (3 * level)), threads::chunks(&mut of_bands, 1));
        threads::for_each_of(bands, |band, (slopes, sums)| {
            if MIDDLE.contains(&band) {
                let detail = Detail { shape, level, band, push: &push, high, neighbours: k };
                sums[0] = detail.strength(subbands.band(level, band), slopes);
            }
        });
        sums = std::array::from_fn(|i| sums[i] + reduce::sum_by(BANDS, &|band| of_bands[band][i]));
    }
    let [enhancement, suppression] = sums;
    let (enhancement, suppression) = (settings.enhancement * enhancement / share, suppression / share);
    WaveletLoss {
        value: settings.suppress * suppression - settings.enhance * enhancement,
        enhancement,
        suppression,
        gradient: haar::inverse(&gradient),
    }
}

/// One band, alone.
struct Detail<'a, R> {
    shape: [usize; 3],
    level: usize,
    band: usize,
    /// The gradient to the strength.
    push: &'a [R],
    /// Confident neighbours of each voxel, and neighbours.
    high: &'a [u16],
    neighbours: f64,
}

impl<R: Real> Detail<'_, R> {
    /// The strength times confident neighbours and times others, added up; writes the gradient to the coefficients. Goes
    /// through the block slice by slice, so that what is made of coefficients stays in the nearest cache.
    fn strength(&self, coefficients: &[R], slopes: &mut [R]) -> [f64; 2] {
        let Self { shape, level, band, .. } = *self;
        let ([nx, ny, nz], flat) = (shape, real::<R>(FLAT));
        let size = ny * nz;
        let (coefficients, finest) = haar::at_finest(coefficients, shape, level, band);
        let mut gradient = vec![R::ZERO; coefficients.len()];
        let mut space = vec![R::ZERO; SLICES * (size + GAP)];
        let mut slices = space.chunks_exact_mut(size + GAP).map(|slice| &mut slice[..size]);
        let mut slice = || slices.next().expect("as many as there is room for");
        // Three slices, or two, by turns.
        let (alone, along_x) = ([slice(), slice(), slice()], [slice(), slice(), slice()]);
        let (along_y, along_z, strength) = ([slice(), slice()], [slice(), slice()], slice());
        let (mut pair, mut sums) = (vec![R::ZERO; 2 * size], vec![[0.0; 2]; nx]);
        haar::slice_alone(&coefficients, shape, finest, 0, alone[0]);
        for x in 0..=nx {
            if x + 1 < nx {
                haar::slice_alone(&coefficients, shape, finest, x + 1, alone[(x + 1) % 3]);
            }
            if x < nx {
                let around = [x.checked_sub(1), Some(x + 1).filter(|above| *above < nx)];
                let around = around.map(|x| x.map(|x| &*alone[x % 3]));
                let [dx, dy, dz] = [&mut *along_x[x % 3], &mut *along_y[x % 2], &mut *along_z[x % 2]];
                differences::forward(alone[x % 3], around, nz, [&mut *dx, &mut *dy, &mut *dz]);
                let slopes = dx.iter_mut().zip(&mut *dy).zip(&mut *dz).zip(&mut *strength);
                for ((((dx, dy), dz), strength), &push) in slopes.zip(&self.push[x * size..]) {
                    *strength = (*dx * *dx + *dy * *dy + *dz * *dz + flat).sqrt();
                    let flux = push / *strength;
                    (*dx, *dy, *dz) = (flux * *dx, flux * *dy, flux * *dz);
                }
                sums[x] = self.weigh(strength, &self.high[x * size..][..size]);
            }
            if let Some(x) = x.checked_sub(1) {
                let gradient_of_slice = &mut pair[x % 2 * size..][..size];
                let of_slice = |x: usize| &*along_x[x % 3];
                differences::transpose(of_slice, along_y[x % 2], along_z[x % 2], shape, x, gradient_of_slice);
                if x % 2 == 1 {
                    let cells = &mut gradient[x / 2 * size / 4..][..size / 4];
                    haar::analyse(&pair, [2, ny, nz], finest, cells);
                }
            }
        }
        slopes.copy_from_slice(&haar::from_finest(gradient, shape, level, band));
        [0, 1].map(|i| reduce::sum_by(nx, &|x| sums[x][i]))
    }

    /// Sums of a slice: lane by lane, then over the lanes.
    fn weigh(&self, strength: &[R], high: &[u16]) -> [f64; 2] {
        let mut sums = [[0.0; LANES]; 2];
        let mut add = |strength: &[R], high: &[u16]| {
            let [confident, others] = &mut sums;
            for i in 0..strength.len() {
                let (strength, high) = (strength[i].to_f64(), f64::from(high[i]));
                confident[i] += high * strength;
                others[i] += (self.neighbours - high) * strength;
            }
        };
        let ((strength, strength_left), (high, high_left)) = (strength.as_chunks::<LANES>(), high.as_chunks::<LANES>());
        strength.iter().zip(high).for_each(|(strength, high)| add(strength, high));
        add(strength_left, high_left);
        sums.map(|lanes| reduce::sum(&lanes))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::numeric::rng::{Purpose, stream};
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
                assert!((got - expected).abs() <= 1e-13 * expected.abs(), "{shape:?}: {got} or {expected}");
                assert!((single - expected).abs() <= 1e-5 * expected.abs(), "{shape:?}: {single} or {expected}");
            }
            let error = worst(&found.gradient, &expected.gradient);
            assert!(error <= 1e-13, "{shape:?}, {levels} levels: {error:e}");
            let error = worst(&single.gradient.mapv(f64::from), &expected.gradient);
            assert!(error <= 1e-5, "{shape:?}, {levels} levels, f32: {error:e}");
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
                assert!((analytic - difference).abs() <= 1e-7 * peak, "{voxel:?}: {analytic:e} or {difference:e}");
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
        approx::assert_relative_eq!(loss.enhancement, 1.5 * g / 2.0, max_relative = 1e-12);
        approx::assert_relative_eq!(loss.suppression, g / 2.0, max_relative = 1e-12);
        approx::assert_relative_eq!(loss.value, 0.25 * g / 2.0 - 0.5 * 0.75 * g, max_relative = 1e-12);
        // The step of 2 is the difference of two means of four voxels: ±1/4 for each, in one band of six.
        let slope = (0.25 * 0.5 - 0.5 * 0.75) / 6.0 / 4.0;
        for ((x, ..), d) in loss.gradient.indexed_iter() {
            approx::assert_relative_eq!(*d, if x == 0 { slope } else { -slope }, max_relative = 1e-9);
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
    fn a_constant_block_has_a_strength_of_rounding_and_no_gradient() {
        let routing = routing([4, 4, 4], 8);
        let loss = wavelet_loss(Array3::from_elem([4, 4, 4], 0.3_f32).view(), &routing, &plain());
        assert!(loss.enhancement < 2e-6 && loss.suppression < 2e-6);
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
