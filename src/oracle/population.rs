//! This program's answers about the sampler and density control.

use super::outputs::{Outputs, one, parameters};
use super::question::Question;
use glam::{DMat3, DVec3};
use ndarray::{Array1, Array2, Array3, ArrayView1, ArrayView2, Axis, Ix2, Ix3};
use trgs_core::density::{NextPrimitive, Relocation, adc, ar, next_parameters};
use trgs_core::error::{Error, Result};
use trgs_core::geometry::Grid;
use trgs_core::optim::Sghmc;
use trgs_core::optim::sghmc::{NoiseInput, Phase};
use trgs_core::primitives::Parameters;
use trgs_core::projector::{Field, Kernels};

/// `trajectory [T, M, 3]` of positions.
pub(super) fn sghmc(q: &Question) -> Result<Array3<f64>> {
    let (mut positions, gates) = (rows(&q.array::<Ix2>("start")?), q.numbers("gates")?);
    let (directions, noise) = (q.array::<Ix3>("directions")?, q.array::<Ix3>("noise")?);
    let covariance = q.array::<Ix3>("covariance")?;
    let covariance = |i: usize| {
        let matrix = covariance.index_axis(Axis(0), i);
        DMat3::from_cols(vector(matrix.column(0)), vector(matrix.column(1)), vector(matrix.column(2)))
    };
    let mut sampler = Sghmc::new(positions.len());
    let mut trajectory = Array3::zeros(directions.raw_dim());
    for (step, rate) in q.numbers("rates")?.into_iter().enumerate() {
        let phase = if (step as u64) < q.integer("burn_in")? {
            Phase::BurnIn(q.setting("burn_in_friction")?)
        } else {
            Phase::Sampling(q.setting("friction")?)
        };
        let noise = noise.index_axis(Axis(0), step);
        let noise_for =
            |i: usize| NoiseInput { gate: gates[i], noise: vector(noise.row(i)), covariance: covariance(i) };
        let direction = rows(&directions.index_axis(Axis(0), step).to_owned());
        sampler.step(&mut positions, &direction, rate, phase, noise_for);
        let after = ArrayView2::from(positions.as_slice());
        trajectory.index_axis_mut(Axis(0), step).assign(&after);
    }
    Ok(trajectory)
}

/// The thresholds and fractions of adding and recycling.
pub(super) fn recycling(q: &Question) -> Result<ar::Settings> {
    let name = q.word("relocation")?;
    let rules = [("exact", Relocation::Exact), ("sss", Relocation::Sss), ("sss-program", Relocation::SssProgram)];
    let rule = rules.into_iter().find(|(rule, _)| *rule == name);
    let (_, relocation) =
        rule.ok_or_else(|| Error::invalid("relocation", name, "a known rule", "export the vectors again"))?;
    Ok(ar::Settings {
        dead: q.setting("dead")?,
        recycled: q.setting("recycled")?,
        growth: q.setting("growth")?,
        cap: q.integer("cap")? as usize,
        relocation,
    })
}

/// The outputs of one step of adding and recycling.
pub(super) fn recycled(q: &Question) -> Result<Outputs> {
    let (primitives, draws) = (q.primitives()?, q.numbers("uniform")?);
    let mut draws = draws.into_iter();
    let next = ar::ar(&primitives, &recycling(q)?, || draws.next().unwrap_or(f64::NAN));
    Ok(generation(&primitives.parameters, &next))
}

/// The outputs of one step of adaptive density control.
pub(super) fn controlled(q: &Question) -> Result<Outputs> {
    let settings = adc::Settings {
        gradient: q.setting("gradient")?,
        split_scale: q.setting("split_scale")?,
        faint: q.setting("faint")?,
        cap: q.integer("cap")? as usize,
    };
    let corner = |key| Ok::<_, Error>(vector(ArrayView1::from(&q.list(key)?)));
    let grid = Grid::new([1; 3], corner("low")?, corner("high")?)?;
    let (primitives, normals) = (q.primitives()?, q.array::<Ix2>("normals")?);
    let normals = |i: usize| std::array::from_fn(|k| normals[[i, k]]);
    let next = adc::adc(&primitives.parameters, &q.numbers("pull")?, &settings, &grid, normals);
    Ok(generation(&primitives.parameters, &next))
}

/// Gradient with respect to the projected centres of all primitives, `[M, 2]`.
pub(super) fn mean2d_gradients<R: Kernels>(q: &Question) -> Result<Array2<f64>> {
    let (primitives, scanner, projection) = (q.primitives()?, q.scanner()?, q.projection()?);
    let cotangent = q.array::<Ix3>("cotangent")?.mapv(R::from_f64);
    let field = Field::<R>::new(&primitives, 0.0);
    let mut gradient = field.zero_gradient();
    for (cotangent, angle) in cotangent.outer_iter().zip(q.angles()?) {
        field.view(&scanner, angle, projection).vjp(cotangent, &mut gradient);
    }
    Ok(Array2::from(gradient.mean2d_gradients().collect::<Vec<_>>()))
}

pub(super) fn generation(old: &Parameters, next: &[NextPrimitive]) -> Outputs {
    let numbers = |of: fn(&NextPrimitive) -> f64| next.iter().map(of).collect::<Array1<_>>();
    let mut outputs = parameters("model", &next_parameters(old, next));
    outputs.extend(one("parent", numbers(|s| s.parent as f64)));
    outputs.extend(one("fresh", numbers(|s| f64::from(u8::from(s.fresh)))));
    outputs
}

pub(super) fn rows(array: &Array2<f64>) -> Vec<[f64; 3]> {
    array.outer_iter().map(|row| vector(row).to_array()).collect()
}

fn vector(values: ArrayView1<'_, f64>) -> DVec3 {
    DVec3::new(values[0], values[1], values[2])
}
