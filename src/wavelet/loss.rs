//! Strength of the detail, the loss and its gradient.

use super::haar::{self, Subbands};
use super::routing::Routing;
use super::{FLAT, Settings, differences};
use crate::numeric::{Real, real, reduce, threads};
use ndarray::{Array3, ArrayView3};

/// The bands that count in each level: not the low one, not the one that is high along all axes `[Eq. 11]`.
const MIDDLE: std::ops::RangeInclusive<usize> = 1..=6;

/// Voxels that one task adds up: a constant, so the cut does not depend on the threads.
const CHUNK: usize = 4096;

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

/// One band: its part of the strength at each voxel, and the loss' gradient to its coefficients.
struct Band<R> {
    strength: Vec<R>,
    gradient: Vec<R>,
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
/// When block and routing differ in shape, or a side cannot be halved `settings.levels` times.
pub fn wavelet_loss<R: Real>(block: ArrayView3<R>, routing: &Routing, settings: &Settings) -> WaveletLoss<R> {
    assert_eq!(block.shape(), routing.high.shape(), "shapes of block and routing");
    let (x, y, z) = block.dim();
    let shape = [x, y, z];
    let subbands = haar::forward(block, settings.levels);
    let places: Vec<(usize, usize)> =
        (1..=settings.levels).flat_map(|level| MIDDLE.map(move |band| (level, band))).collect();

    let high = routing.high.as_standard_layout();
    let high = high.as_slice().expect("standard layout");
    let k = routing.neighbours as f64;
    let low = |high: u16| k - f64::from(high);
    // What a voxel's count is divided by: neighbours, voxels and bands.
    let share = k * high.len() as f64 * places.len() as f64;
    let mut push = vec![R::ZERO; high.len()];
    threads::for_each_chunk(&mut push, CHUNK, |chunk, push| {
        for (push, &h) in push.iter_mut().zip(&high[chunk * CHUNK..]) {
            let enhance = settings.enhance * settings.enhancement * f64::from(h);
            *push = R::from_f64((settings.suppress * low(h) - enhance) / share);
        }
    });
    let bands = threads::map(places.len(), |i| {
        let (level, band) = places[i];
        detail(subbands.band(level, band), shape, level, band, &push)
    });

    let mut gradient = Subbands::zeros(shape, settings.levels);
    for (&(level, band), part) in places.iter().zip(&bands) {
        gradient.band_mut(level, band).copy_from_slice(&part.gradient);
    }
    let mut strength = vec![0.0; high.len()];
    threads::for_each_chunk(&mut strength, CHUNK, |chunk, strength| {
        for part in &bands {
            let parts = &part.strength[chunk * CHUNK..];
            strength.iter_mut().zip(parts).for_each(|(sum, &part)| *sum += part.to_f64());
        }
    });
    let all = 0..high.len();
    let (enhancement, suppression) = threads::both(
        || reduce::sum_of(all.clone(), &|i| f64::from(high[i]) * strength[i]),
        || reduce::sum_of(all.clone(), &|i| low(high[i]) * strength[i]),
    );
    let (enhancement, suppression) = (settings.enhancement * enhancement / share, suppression / share);
    WaveletLoss {
        value: settings.suppress * suppression - settings.enhance * enhancement,
        enhancement,
        suppression,
        gradient: haar::inverse(&gradient),
    }
}

/// Strength of one band, and its coefficients' gradient for the gradient `push` to the strength. Goes through the
/// block slice by slice, so that all but the block itself stays in the nearest cache.
fn detail<R: Real>(coefficients: &[R], shape: [usize; 3], level: usize, band: usize, push: &[R]) -> Band<R> {
    let [nx, ny, nz] = shape;
    let (size, flat) = (ny * nz, real::<R>(FLAT));
    let mut block = haar::alone(coefficients, shape, level, band);
    let mut strength = vec![R::ZERO; block.len()];
    // The fluxes of three slices, or of two, by turns. Behind them the gradient takes the block's place.
    let slice = || vec![R::ZERO; size];
    let (mut along_x, mut along_y, mut along_z) = ([(); 3].map(|()| slice()), [slice(), slice()], [slice(), slice()]);
    for x in 0..=nx {
        if x < nx {
            let [dx, dy, dz] = [&mut along_x[x % 3], &mut along_y[x % 2], &mut along_z[x % 2]];
            differences::forward(&block, shape, x, [dx, dy, dz]);
            let slopes = dx.iter_mut().zip(dy).zip(dz).zip(&mut strength[x * size..]);
            for ((((dx, dy), dz), strength), &push) in slopes.zip(&push[x * size..]) {
                *strength = (*dx * *dx + *dy * *dy + *dz * *dz + flat).sqrt();
                let flux = push / *strength;
                (*dx, *dy, *dz) = (flux * *dx, flux * *dy, flux * *dz);
            }
        }
        if let Some(x) = x.checked_sub(1) {
            let gradient = &mut block[x * size..][..size];
            gradient.fill(R::ZERO);
            let around = [x + 2, x, x + 1].map(|x| &along_x[x % 3][..]);
            differences::add_transpose(around, &along_y[x % 2], &mut along_z[x % 2], shape, x, gradient);
        }
    }
    Band { strength, gradient: haar::coefficients(&block, shape, level, band) }
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
