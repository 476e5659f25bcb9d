//! This program's own answers in both precisions: stage name → function that computes it.

use super::manifest::{Case, encode, write_file};
use super::outputs::{Outputs, gradient, one, parameters, two, valued};
use super::question::Question;
use super::{iteration, networks, population, recycling, run};
use ndarray::{Array1, Array2, Array3, Array4, Axis, Ix1, Ix2, Ix3};
use rand::Rng;
use std::path::Path;
use trgs_core::confidence::{Coverage, Settings, nu_loss, nu_target};
use trgs_core::error::{Error, Result};
use trgs_core::in_precision;
use trgs_core::loss::{Ssim, SsimTarget, image_loss, l1::l1, tv::tv};
use trgs_core::numeric::rng::{self, Purpose};
use trgs_core::numeric::{Precision, Real, real};
use trgs_core::optim::{Adam, Exponential, sghmc};
use trgs_core::primitives::{Parameters, Primitives, student_t};
use trgs_core::projector::{self, Field, Kernels};
use trgs_core::wavelet::haar::Subbands;
use trgs_core::wavelet::{self, Routing, WaveletLoss};
use trgs_methods::classical::fdk::{self, Sample, Window};
use trgs_methods::evaluation;
use trgs_scan::noise::noisy_line_integral;

/// The stages this program computes, in the manifest's order.
pub const STAGES: [&str; 48] = [
    "covariance",
    "kernel",
    "integral-factor",
    "density",
    "projected-kernel-affine",
    "projected-kernel-exact",
    "image-affine",
    "image-exact",
    "gradient-density",
    "gradient-image-affine",
    "gradient-image-exact",
    "activation",
    "gradient-raw",
    "support",
    "image-cutoff",
    "density-cutoff",
    "truncation-bound",
    "loss-l1",
    "loss-ssim",
    "loss-tv",
    "loss-image",
    "confidence",
    "nu-target",
    "loss-nu",
    "haar",
    "wavelet-routing",
    "wavelet-loss",
    "gradient-wavelet",
    "schedule",
    "adam",
    "sghmc-gate",
    "sghmc",
    "ar",
    "adc",
    "gradient-shadow",
    "fdk-filter",
    "fdk-backprojection",
    "fdk",
    "noise",
    "random",
    "metrics",
    "hash-corners",
    "hash-code",
    "gradient-hash-code",
    "frequency-code",
    "lineformer",
    "gradient-lineformer",
    "ray-quadrature",
];

/// This program's outputs for a question, with pixel kernels and losses in the given precision.
///
/// # Errors
/// When an input is missing or means nothing, or the stage is not in [`STAGES`].
pub fn answer(question: &Question, precision: Precision) -> Result<Outputs> {
    question.refuse_nonsense()?;
    in_precision!(precision, R => answer_in::<R>(question))
}

fn answer_in<R: Kernels + Sample>(q: &Question) -> Result<Outputs> {
    Ok(match q.stage.as_str() {
        "covariance" => one("covariance", covariance(&q.primitives()?)),
        "kernel" => {
            one("kernel", Array1::from(numbers(&projector::profile::<R>(&q.numbers("delta")?, &q.numbers("nu")?))))
        }
        "integral-factor" => {
            let (factor, slope): (Vec<f64>, Vec<f64>) =
                q.numbers("nu")?.into_iter().map(student_t::line_integral).unzip();
            two(("factor", Array1::from(factor)), ("slope", Array1::from(slope)))
        }
        "density" => one("volume", volume::<R>(q, 0.0)?),
        "density-cutoff" => one("volume", volume::<R>(q, q.setting("cutoff")?)?),
        "projected-kernel-affine" | "projected-kernel-exact" => one("kernels", projected_kernels::<R>(q)?),
        "image-affine" | "image-exact" => one("image", image::<R>(q, &q.primitives()?, 0.0)?),
        "image-cutoff" => one("image", image::<R>(q, &q.primitives()?, q.setting("cutoff")?)?),
        "gradient-density" => {
            let (grid, cotangent) = (q.scanner()?.grid, q.array::<Ix3>("cotangent")?.mapv(real::<R>));
            gradient(&projector::voxelize_vjp(&q.primitives()?, &grid, 0.0, cotangent.view()))
        }
        "gradient-image-affine" | "gradient-image-exact" => gradient(&image_gradient::<R>(q, &q.primitives()?)?),
        "activation" => parameters("physical", &q.activation()?.forward(&q.parameters("raw")?).parameters),
        "gradient-raw" => {
            let physical = q.activation()?.forward(&q.parameters("raw")?);
            let mut raw = image_gradient::<R>(q, &physical)?;
            q.activation()?.vjp(&physical, &mut raw);
            gradient(&raw)
        }
        "support" => one("box", support::<R>(q)?),
        "truncation-bound" => one("bound", truncation_bound::<R>(q)?),
        "loss-l1" => {
            let (value, gradient) = l1(pixels::<R>(q, "prediction")?.view(), pixels::<R>(q, "target")?.view());
            valued(value, gradient)
        }
        "loss-ssim" => {
            let ssim = Ssim::<R>::default();
            let target = SsimTarget::new(&ssim, pixels(q, "target")?.view());
            let (value, gradient) = ssim.value_and_grad(pixels(q, "prediction")?.view(), &target);
            valued(value, gradient)
        }
        "loss-image" => {
            let ssim = Ssim::<R>::default();
            let target = SsimTarget::new(&ssim, pixels(q, "target")?.view());
            let (loss, cotangent) = image_loss(&ssim, q.setting("weight")?, pixels(q, "prediction")?.view(), &target);
            valued(loss.total, cotangent)
        }
        "loss-tv" => {
            let (value, gradient) = tv(q.array::<Ix3>("block")?.mapv(real::<R>).view());
            valued(value, gradient)
        }
        "confidence" => {
            let coverage =
                Coverage::new(Settings { r_max: q.setting("r_max")?, kappa: q.setting("kappa")?, ..points(q)? });
            one("confidence", Array1::from(coverage.confidence(&q.primitives()?, &q.scanner()?, &q.angles()?)))
        }
        "nu-target" => {
            let settings = Settings { temperature: q.setting("temperature")?, ..points(q)? };
            let range = q.interval("nu_range")?;
            one("nu_target", q.array::<Ix1>("c")?.mapv(|c| nu_target(c, &settings, range)))
        }
        "loss-nu" => {
            let [nu, target, confidence] = [q.numbers("nu")?, q.numbers("target")?, q.numbers("confidence")?];
            let (value, gradient) = nu_loss(&nu, &target, &confidence, q.setting("weight")?);
            valued(value, Array1::from(gradient))
        }
        "haar" => {
            let (coefficients, bands) = haar(q.array::<Ix3>("block")?.mapv(real::<R>));
            two(("coefficients", coefficients), ("bands", bands))
        }
        "wavelet-routing" => {
            let means: Vec<_> = q.array::<Ix2>("means")?.outer_iter().map(|row| [row[0], row[1], row[2]]).collect();
            let routing =
                wavelet::route(&q.scanner()?.grid, &means, &q.numbers("confidence")?, &q.wavelet_settings()?)?;
            one("high", routing.high.mapv(f64::from))
        }
        "wavelet-loss" => {
            let loss = wavelet_loss(q, &q.array::<Ix3>("block")?.mapv(real::<R>))?;
            let number = |value: f64| Array1::from(vec![value]);
            let mut all = valued(loss.value, loss.gradient);
            all.extend(two(("enhancement", number(loss.enhancement)), ("suppression", number(loss.suppression))));
            all
        }
        "gradient-wavelet" => {
            let (field, grid) = (Field::<R>::new(&q.primitives()?, 0.0), q.scanner()?.grid);
            let loss = wavelet_loss(q, &field.voxels(&grid))?;
            let mut sum = field.zero_gradient();
            field.on(&grid).vjp(loss.gradient.view(), &mut sum);
            gradient(&field.parameter_gradient(&sum))
        }
        "schedule" => {
            let schedule = Exponential {
                first: q.setting("first")?,
                last: q.setting("last")?,
                steps: q.integer("length")? as usize,
            };
            one("rate", q.numbers("steps")?.iter().map(|&step| schedule.at(step as usize)).collect::<Array1<_>>())
        }
        "adam" => one("trajectory", adam(q)?),
        "sghmc-gate" => {
            let reference = q.setting("reference")?;
            one("gate", q.numbers("density")?.iter().map(|&d| sghmc::gate(d, reference)).collect::<Array1<_>>())
        }
        "sghmc" => one("trajectory", population::sghmc(q)?),
        "ar" => population::recycled(q)?,
        "adc" => population::controlled(q)?,
        "gradient-shadow" => one("shadow", population::mean2d_gradients::<R>(q)?),
        "fdk-filter" => one("filtered", filtered::<R>(q)?.mapv(Real::to_f64)),
        "fdk-backprojection" => {
            let filtered = q.array::<Ix3>("filtered")?.mapv(real::<R>);
            one("volume", fdk::backproject(&q.scanner()?, &q.angles()?, filtered.view())?.mapv(Real::to_f64))
        }
        "fdk" => {
            one("volume", fdk::backproject(&q.scanner()?, &q.angles()?, filtered::<R>(q)?.view())?.mapv(Real::to_f64))
        }
        "noise" => one("noisy", noise(q)?),
        "random" => random(q)?,
        iteration::STAGE => iteration::answer::<R>(q)?,
        recycling::STAGE => recycling::answer(q)?,
        run::STAGE => run::answer::<R>(q)?,
        "metrics" => metrics(q)?,
        "hash-corners" => networks::corners::<R>(q)?,
        "hash-code" => networks::hash_code::<R>(q)?,
        "gradient-hash-code" => networks::hash_code_vjp::<R>(q)?,
        "frequency-code" => networks::frequency_code::<R>(q)?,
        "lineformer" => networks::lineformer::<R>(q)?,
        "gradient-lineformer" => networks::lineformer_vjp::<R>(q)?,
        "ray-quadrature" => networks::quadrature(q)?,
        stage => {
            let remedy = "export the vectors again with this version: `trgs oracle export`";
            return Err(Error::invalid("stage", stage, format!("one of {}", STAGES.join(", ")), remedy));
        }
    })
}

/// Writes the outputs of a case below `folder` as f64, under the names of the manifest.
///
/// # Errors
/// [`Error::Write`] with the error of the operating system.
pub fn write(folder: &Path, case: &Case, outputs: &Outputs) -> Result<()> {
    for (role, file) in &case.outputs {
        let Some(arrays) = outputs.get(role) else { continue };
        write_file(&folder.join(&file.file), &encode(arrays))?;
    }
    Ok(())
}

fn numbers<R: Real>(values: &[R]) -> Vec<f64> {
    values.iter().map(|value| value.to_f64()).collect()
}

fn covariance(primitives: &Primitives) -> Array3<f64> {
    let matrices: Vec<_> = (0..primitives.len()).map(|i| primitives.parameters.covariance(i)).collect();
    Array3::from_shape_fn((primitives.len(), 3, 3), |(i, row, column)| matrices[i].col(column)[row])
}

/// Settings of the ray confidence; the question states the number of points.
fn points(q: &Question) -> Result<Settings> {
    Ok(Settings { sphere_points: q.integer("sphere_points")? as usize, ..Settings::default() })
}

fn pixels<R: Real>(q: &Question, role: &str) -> Result<Array2<R>> {
    Ok(q.array::<Ix2>(role)?.mapv(R::from_f64))
}

fn volume<R: Kernels>(q: &Question, cutoff: f64) -> Result<Array3<f64>> {
    Ok(projector::voxelize::<R>(&q.primitives()?, &q.scanner()?.grid, cutoff).mapv(R::to_f64))
}

fn image<R: Kernels>(q: &Question, primitives: &Primitives, cutoff: f64) -> Result<Array3<f64>> {
    let image = projector::forward::<R>(primitives, &q.scanner()?, &q.angles()?, q.projection()?, cutoff);
    Ok(image.mapv(R::to_f64))
}

fn image_gradient<R: Kernels>(q: &Question, primitives: &Primitives) -> Result<Parameters> {
    let cotangent = q.array::<Ix3>("cotangent")?.mapv(R::from_f64);
    Ok(projector::vjp(primitives, &q.scanner()?, &q.angles()?, q.projection()?, 0.0, cotangent.view()))
}

/// The image of each primitive alone.
fn projected_kernels<R: Kernels>(q: &Question) -> Result<Array4<f64>> {
    let all = q.primitives()?;
    let images: Vec<Array3<f64>> = (0..all.len())
        .map(|i| {
            let alone = Primitives { kernel: all.kernel, parameters: all.parameters.select(&[i]) };
            image::<R>(q, &alone, 0.0)
        })
        .collect::<Result<_>>()?;
    let views: Vec<_> = images.iter().map(|image| image.view()).collect();
    Ok(ndarray::stack(Axis(0), &views).expect("images of one detector"))
}

fn support<R: Kernels>(q: &Question) -> Result<Array3<f64>> {
    let (primitives, scanner, angles) = (q.primitives()?, q.scanner()?, q.angles()?);
    let field = Field::<R>::new(&primitives, q.setting("cutoff")?);
    let mut boxes = Array3::zeros((angles.len(), primitives.len(), 4));
    for (view, &angle) in angles.iter().enumerate() {
        for (i, sides) in field.view(&scanner, angle, q.projection()?).support_boxes().into_iter().enumerate() {
            sides.into_iter().enumerate().for_each(|(k, side)| boxes[[view, i, k]] = side);
        }
    }
    Ok(boxes)
}

fn truncation_bound<R: Kernels>(q: &Question) -> Result<Array3<f64>> {
    let (primitives, scanner, angles, projection) = (q.primitives()?, q.scanner()?, q.angles()?, q.projection()?);
    let field = Field::<R>::new(&primitives, q.setting("cutoff")?);
    let bounds: Vec<_> =
        angles.iter().map(|&angle| field.view(&scanner, angle, projection).truncation_bound()).collect();
    let views: Vec<_> = bounds.iter().map(|image| image.view()).collect();
    Ok(ndarray::stack(Axis(0), &views).expect("images of one detector"))
}

/// Coefficients `[8, X/2, Y/2, Z/2]`, and each of the bands 1 to 6 inverted alone `[6, X, Y, Z]`.
fn haar<R: Real>(block: Array3<R>) -> (Array4<f64>, Array4<f64>) {
    let mut subbands = wavelet::haar::forward(block.view(), 1);
    let all = subbands.levels.remove(0);
    let bands: Vec<Array3<R>> = (1..=6)
        .map(|band| {
            let mut alone = Array4::default(all.raw_dim());
            alone.index_axis_mut(Axis(0), band).assign(&all.index_axis(Axis(0), band));
            wavelet::haar::inverse(&Subbands { levels: vec![alone] })
        })
        .collect();
    let views: Vec<_> = bands.iter().map(|band| band.view()).collect();
    let bands = ndarray::stack(Axis(0), &views).expect("bands of one block");
    (all.mapv(R::to_f64), bands.mapv(R::to_f64))
}

fn wavelet_loss<R: Real>(q: &Question, block: &Array3<R>) -> Result<WaveletLoss<R>> {
    let settings = q.wavelet_settings()?;
    let high = q.array::<Ix3>("high")?.mapv(|count| count as u16);
    let routing = Routing { high, neighbours: settings.neighbours };
    Ok(wavelet::wavelet_loss(block.view(), &routing, &settings))
}

fn adam(q: &Question) -> Result<Array2<f64>> {
    let (mut values, gradients, rates) = (q.numbers("start")?, q.array::<Ix2>("gradients")?, q.numbers("rates")?);
    let mut adam = Adam::new(values.len(), [q.setting("beta1")?, q.setting("beta2")?], q.setting("epsilon")?);
    let mut trajectory = Array2::zeros(gradients.raw_dim());
    for ((gradient, rate), mut after) in gradients.outer_iter().zip(rates).zip(trajectory.outer_iter_mut()) {
        adam.step(&mut values, &gradient.to_vec(), rate);
        after.iter_mut().zip(&values).for_each(|(after, value)| *after = *value);
    }
    Ok(trajectory)
}

fn window(q: &Question) -> Result<Window> {
    let name = q.word("window")?;
    let window = Window::NAMED.iter().find(|(n, _)| *n == name);
    window
        .map(|(_, window)| *window)
        .ok_or_else(|| Error::invalid("window", name, "a window of FDK", "export the vectors again"))
}

fn filtered<R: Sample>(q: &Question) -> Result<Array3<R>> {
    let projections = q.array::<Ix3>("projections")?.mapv(real::<R>);
    fdk::filter(&q.scanner()?, &q.angles()?, projections.view(), window(q)?)
}

fn noise(q: &Question) -> Result<Array3<f64>> {
    let projections = q.array::<Ix3>("projections")?;
    let (counts, normals) = (q.array::<Ix3>("counts")?, q.array::<Ix3>("normals")?);
    let (photons, sigma) = (q.setting("photons")?, q.setting("sigma")?);
    let peak = projections.iter().fold(0.0_f64, |peak, &p| peak.max(p));
    let readings =
        counts.iter().zip(&normals).map(|(&counts, &normal)| noisy_line_integral(photons, sigma, peak, counts, normal));
    Ok(Array3::from_shape_vec(projections.raw_dim(), readings.collect()).expect("as many draws as pixels"))
}

fn random(q: &Question) -> Result<Outputs> {
    const PURPOSES: [Purpose; 10] = [
        Purpose::Noise,
        Purpose::Initialisation,
        Purpose::ViewOrder,
        Purpose::TotalVariation,
        Purpose::TestAngles,
        Purpose::Phantom,
        Purpose::PositionNoise,
        Purpose::Splitting,
        Purpose::Recycling,
        Purpose::Wavelet,
    ];
    let number = q.integer("purpose")?;
    let purpose = PURPOSES.into_iter().find(|purpose| *purpose as u64 == number);
    let purpose = purpose.ok_or_else(|| Error::invalid("purpose", number, "1 to 10", "see numeric::rng"))?;
    let stream = || Ok::<_, Error>(rng::stream(q.integer("seed")?, purpose, q.integer("step")?, q.integer("id")?));
    let count = q.integer("count")? as usize;
    let (mut words, mut doubles) = (stream()?, stream()?);
    let words: Vec<f64> = (0..count).map(|_| f64::from(words.next_u32())).collect();
    let uniform: Vec<f64> = (0..count / 2).map(|_| rand::RngExt::random::<f64>(&mut doubles)).collect();
    Ok(two(("words", Array1::from(words)), ("uniform", Array1::from(uniform))))
}

fn metrics(q: &Question) -> Result<Outputs> {
    let single = |role: &str| Ok::<_, Error>(q.array::<Ix3>(role)?.mapv(|value| value as f32));
    let (truth, volume) = (single("volume_truth")?, single("volume")?);
    let (true_images, images) = (single("projections_truth")?, single("projections")?);
    let values = [
        ("psnr_3d", evaluation::psnr_3d(truth.view(), volume.view())),
        ("ssim_3d", evaluation::ssim_3d(truth.view(), volume.view())),
        ("psnr_2d", evaluation::psnr_2d(true_images.view(), images.view())),
        ("ssim_2d", evaluation::ssim_2d(true_images.view(), images.view())),
    ];
    let array = |value: f64| Array1::from(vec![value]).into_dyn();
    let arrays = values.into_iter().map(|(name, metric)| (name.to_owned(), array(metric.value))).collect();
    Ok([("metrics".to_owned(), arrays)].into())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::check::select;
    use crate::difference::Difference;
    use crate::format::Format;
    use crate::limits::Tolerances;
    use crate::manifest::{Level, Vectors};
    use trgs_scan::digest::digest_bytes;

    /// `.ci/portable` compares the digests that it prints between processors, WebAssembly among them.
    #[test]
    fn core_answers_are_within_their_limits_on_every_processor() {
        let (vectors, tolerances) = (Vectors::embedded().unwrap(), Tolerances::embedded().unwrap());
        for (precision, format) in [(Precision::F32, Format::F32), (Precision::F64, Format::F64)] {
            let mut bytes = Vec::new();
            for case in select(&vectors, Level::Core, &[]).unwrap() {
                let answers = answer(&Question::new(&vectors, case).unwrap(), precision).unwrap();
                let format = tolerances.judged_as(&case.stage, format);
                for (role, file) in &case.outputs {
                    let allowances = case.allowances.get(role).map(|file| vectors.arrays(file).unwrap());
                    for (name, expected) in vectors.arrays(file).unwrap() {
                        let got = &answers[role.as_str()][&name];
                        bytes.extend(got.iter().flat_map(|x| x.to_le_bytes()));
                        let part = if name.is_empty() { role } else { &name };
                        let allowance = allowances.as_ref().and_then(|arrays| arrays.get(&name));
                        let difference = Difference::new(&expected, got, allowance, format);
                        let rule = tolerances.rule(case, part, format).unwrap();
                        assert!(rule.limits[&format].exceeded(&difference).is_empty(), "{} {part} {format}", case.id);
                    }
                }
            }
            println!("core answers, {format}: {} bytes, {}", bytes.len(), digest_bytes(&bytes));
        }
    }
}
