//! The stage `iteration`: one iteration of the training, with its random numbers given and every intermediate array as an
//! output, so that the first wrong one is named. Its questions are written by `trgs oracle trace`.

use super::outputs::{Outputs, one, parameters};
use super::population::rows;
use super::question::Question;
use ndarray::{Array1, Array2, ArrayView2, Ix2};
use trgs_core::confidence::nu_loss;
use trgs_core::error::{Error, Result};
use trgs_core::geometry::Grid;
use trgs_core::loss::tv::tv;
use trgs_core::loss::{Ssim, SsimTarget, image_loss};
use trgs_core::numeric::real;
use trgs_core::optim::sghmc::{NoiseInput, Phase, gate};
use trgs_core::optim::{Adam, Exponential, Sghmc};
use trgs_core::primitives::{Group, Parameters};
use trgs_core::projector::{Field, Kernels};
use trgs_core::wavelet;

/// The stage's name.
pub const STAGE: &str = "iteration";
/// The outputs, in the order in which they are computed.
pub(crate) const OUTPUTS: [&str; 11] = [
    "01-physical",
    "02-image",
    "03-cotangent",
    "04-losses",
    "05-gradient",
    "06-raw-gradient",
    "07-rates",
    "08-first",
    "09-second",
    "10-momentum",
    "11-raw",
];

/// Those that are archives with the arrays of a model.
pub(crate) const ARCHIVES: [&str; 6] =
    ["01-physical", "05-gradient", "06-raw-gradient", "08-first", "09-second", "11-raw"];

/// The block of a setting with the indices of its first voxel and its shape; `None` where the loss is not due.
fn block(q: &Question, key: &str, grid: &Grid) -> Result<Option<Grid>> {
    if !q.settings.contains_key(key) {
        return Ok(None);
    }
    match q.list(key)?.iter().map(|&n| n as usize).collect::<Vec<_>>()[..] {
        [x, y, z, nx, ny, nz] => Ok(Some(grid.block([x, y, z], [nx, ny, nz]))),
        _ => Err(Error::invalid(key, "another number of values", "six: first voxel and shape", "trace the step again")),
    }
}

pub(super) fn answer<R: Kernels>(q: &Question) -> Result<Outputs> {
    changed::<R>(q, &|_| ())
}

/// The answer if `change` is applied to the gradient to the physical parameters.
pub(crate) fn changed<R: Kernels>(q: &Question, change: &dyn Fn(&mut Parameters)) -> Result<Outputs> {
    let (activation, scanner, mut raw) = (q.activation()?, q.scanner()?, q.parameters("raw")?);
    let physical = activation.forward(&raw);
    let field = Field::<R>::new(&physical, 0.0);
    let view = field.view(&scanner, q.angles()?.first().copied().unwrap_or(0.0), q.projection()?);
    let mut image = Array2::default((scanner.detector.rows, scanner.detector.columns));
    view.image_into(&mut image);
    let ssim = Ssim::<R>::default();
    let target = SsimTarget::new(&ssim, q.array::<Ix2>("target")?.mapv(real::<R>).view());
    let (data, cotangent) = image_loss(&ssim, q.setting("d_ssim")?, image.view(), &target);
    let mut sum = field.zero_gradient();
    view.vjp(cotangent.view(), &mut sum);

    let mut of_blocks = field.zero_gradient();
    let (mut tv_value, mut wavelet_value) = (0.0, 0.0);
    if let Some(block) = block(q, "tv_block", &scanner.grid)? {
        let (weight, on_block) = (q.setting("tv_weight")?, field.on(&block));
        let (value, mut slope) = tv(on_block.voxels().view());
        slope.mapv_inplace(|d| d * real::<R>(weight));
        on_block.vjp(slope.view(), &mut of_blocks);
        tv_value = value;
    }
    let confidence = q.numbers("confidence")?;
    if let Some(block) = block(q, "wavelet_block", &scanner.grid)? {
        let settings = q.wavelet_settings()?;
        let routing = wavelet::route(&block, &physical.parameters.mean, &confidence, &settings)?;
        let on_block = field.on(&block);
        let loss = wavelet::wavelet_loss(on_block.voxels().view(), &routing, &settings);
        let mut of_wavelets = field.zero_gradient();
        on_block.vjp(loss.gradient.view(), &mut of_wavelets);
        of_blocks.add(&of_wavelets);
        wavelet_value = loss.value;
    }
    if q.setting("blocks_move")? == 0.0 {
        of_blocks.freeze_means();
    }
    sum.add(&of_blocks);
    let mut gradient = field.parameter_gradient(&sum);
    let (nu, weight) = (&physical.parameters.nu, q.setting("nu_weight")?);
    // Of Gaussians the logarithm of ν is infinite.
    let (nu_value, of_nu) = match weight > 0.0 {
        true => nu_loss(nu, &q.numbers("nu_target")?, &confidence, weight),
        false => Default::default(),
    };
    gradient.nu.iter_mut().zip(of_nu).for_each(|(gradient, d)| *gradient += d);
    change(&mut gradient);
    let total = data.total + (q.setting("tv_weight")? * tv_value + wavelet_value + nu_value);
    let losses = vec![data.l1, data.d_ssim, tv_value, wavelet_value, nu_value, total];

    let mut all = parameters("01-physical", &physical.parameters);
    all.extend(one("02-image", image.mapv(R::to_f64)));
    all.extend(one("03-cotangent", cotangent.mapv(R::to_f64)));
    all.extend(one("04-losses", Array1::from(losses)));
    all.extend(parameters("05-gradient", &gradient));
    activation.vjp(&physical, &mut gradient);
    all.extend(parameters("06-raw-gradient", &gradient));
    update(q, &physical.parameters, &gradient, &mut raw, &mut all)?;
    Ok(all)
}

/// Rates, moments, momentum and the new raw parameters.
fn update(
    q: &Question,
    physical: &Parameters,
    gradient: &Parameters,
    raw: &mut Parameters,
    all: &mut Outputs,
) -> Result<()> {
    let (done, length, pace) = (q.integer("done")? as usize, q.integer("length")? as usize, q.setting("pace")?);
    let rate = |ends: &[f64]| pace * Exponential { first: ends[0], last: ends[1], steps: length }.at(done);
    let rates: Vec<f64> = q.list("rates")?.chunks_exact(2).map(rate).collect();
    let [mut first, mut second] = [q.parameters("first")?, q.parameters("second")?];
    let mut momentum = rows(&q.array::<Ix2>("momentum")?);
    for (group, &rate) in Group::ALL.into_iter().zip(&rates) {
        let beta = [q.setting("beta1")?, q.setting("beta2")?];
        let (m, v) = (first.group(group), second.group(group));
        let mut adam = Adam::continued(beta, q.setting("epsilon")?, done as u32, m, v);
        if group == Group::Mean && q.word("position")? == "sghmc" {
            let mut direction = vec![[0.0; 3]; raw.len()];
            adam.direction(gradient.group(group), direction.as_flattened_mut());
            momentum = sample(q, physical, &direction, momentum, rate.sqrt(), &mut raw.mean)?;
        } else {
            adam.step(raw.group_mut(group), gradient.group(group), rate);
        }
        let (_, m, v) = adam.state();
        first.group_mut(group).copy_from_slice(&m);
        second.group_mut(group).copy_from_slice(&v);
    }
    all.extend(one("07-rates", Array1::from(rates)));
    all.extend(parameters("08-first", &first));
    all.extend(parameters("09-second", &second));
    all.extend(one("10-momentum", ArrayView2::from(momentum.as_slice()).to_owned()));
    all.extend(parameters("11-raw", raw));
    Ok(())
}

/// One step of the centres by SGHMC; returns their momentum.
fn sample(
    q: &Question,
    physical: &Parameters,
    direction: &[[f64; 3]],
    momentum: Vec<[f64; 3]>,
    rate: f64,
    centres: &mut [[f64; 3]],
) -> Result<Vec<[f64; 3]>> {
    let (done, burn_in, root) = (q.integer("done")?, q.integer("burn_in")?, q.setting("pace")?.sqrt());
    let burning = done < burn_in;
    let friction = q.setting(if burning { "burn_in_friction" } else { "friction" })? / root;
    let phase = if burning { Phase::BurnIn(friction) } else { Phase::Sampling(friction) };
    let (normals, reference) = (rows(&q.array::<Ix2>("normals")?), q.setting("reference")?);
    let noise_for = |i: usize| match gate(physical.density[i], reference) {
        0.0 => NoiseInput::GATE_CLOSED,
        gate => NoiseInput { gate, noise: normals[i].into(), covariance: physical.covariance(i) },
    };
    let mut sampler = Sghmc::continued(momentum, done > burn_in);
    sampler.step(centres, direction, rate, phase, noise_for);
    Ok(sampler.momentum().to_vec())
}
