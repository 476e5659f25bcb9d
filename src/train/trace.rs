//! What one iteration of a run starts from, for implementations that are compared step by step.

use super::losses::weight_of_tv;
use super::optimiser::{burn_in, normals};
use super::views::random_block;
use super::{Plan, Trainer};
use crate::config::{PositionOptimiser, Precision};
use crate::error::{Error, Result};
use crate::geometry::{Grid, Scanner};
use crate::numeric::rng::Purpose;
use crate::optim::schedule::pace;
use crate::primitives::{Group, KernelKind, Parameters};
use crate::projector::{Kernels, Projection};
use crate::scan::dataset::Dataset;
use ndarray::{Array1, ArrayD, ArrayView2, IxDyn};
use serde_json::{Map, Value, json};
use std::collections::BTreeMap;
use std::ops::ControlFlow;
use trgs_methods::internals::in_unit;

/// Settings and arrays of an iteration, as the stage `iteration` of the oracle has them; lengths in scene units, densities in
/// the run's unit.
#[derive(Clone, Debug)]
pub struct Traced {
    /// The geometry.
    pub scanner: Scanner,
    /// Numbers and words.
    pub settings: Map<String, Value>,
    /// By role, and within an archive by name.
    pub arrays: BTreeMap<String, BTreeMap<String, ArrayD<f64>>>,
}

/// Runs a configuration up to `iteration`, counted from 1, and returns what that one starts from.
///
/// `observe` is called after every iteration; `Break` stops.
///
/// # Errors
/// Those of [`super::train`]; for another method, views with poses, an iteration that the run does not have, and SGHMC in the
/// textbook's form.
pub fn trace(
    dataset: &Dataset,
    config: &Plan,
    iteration: usize,
    observe: &mut dyn FnMut(usize) -> ControlFlow<()>,
) -> Result<Traced> {
    let refuse = |what: &str, got: String, expected: String| {
        Err(Error::invalid(what, got, expected, "trace another iteration, or another run"))
    };
    if !(1..=config.iterations).contains(&iteration) {
        return refuse("iteration", iteration.to_string(), format!("1 to {}", config.iterations));
    }
    if !config.method.fits_primitives() {
        return refuse("method", config.method.title().into(), "one that fits primitives".into());
    }
    if dataset.train.poses.is_some() {
        return refuse("scan", "views with poses".into(), "views of a circle".into());
    }
    if config.optimiser.position == PositionOptimiser::SghmcTextbook {
        return refuse("optimiser.position", "sghmc-textbook".into(), "sghmc or adam".into());
    }
    let unit = super::unit_of(dataset, config)?;
    let dataset = &*in_unit(dataset, unit);
    match config.precision {
        Precision::F32 => Trainer::<f32>::new(dataset, unit, config, None)?.traced(iteration, observe),
        Precision::F64 => Trainer::<f64>::new(dataset, unit, config, None)?.traced(iteration, observe),
    }
}

impl<R: Kernels> Trainer<'_, R> {
    fn traced(mut self, iteration: usize, observe: &mut dyn FnMut(usize) -> ControlFlow<()>) -> Result<Traced> {
        while self.state.iteration + 1 < iteration {
            let next = self.state.iteration + 1;
            self.step(next)?;
            self.state.iteration = next;
            if observe(next).is_break() {
                return Err(Error::interrupted(next, false));
            }
        }
        let (view, done) = (self.order.view(iteration - 1), iteration - 1);
        let state = &self.state;
        let count = state.raw.len();
        let [first, second] = state.optimiser.moments(count);
        let normals: Vec<[f64; 3]> = state.ids.iter().map(|&id| normals(self.config, done, id).to_array()).collect();
        let of_all = |values: &[f64]| if values.is_empty() { vec![1.0; count] } else { values.to_vec() };
        let rows = |rows: &[[f64; 3]]| plain(ArrayView2::from(rows).to_owned().into_dyn());
        let image = self.dataset.train.image(view).mapv(f64::from);
        let arrays = [
            ("raw", archive(&state.raw)),
            ("first", archive(&first)),
            ("second", archive(&second)),
            ("momentum", rows(state.optimiser.momentum())),
            ("normals", rows(&normals)),
            ("confidence", plain(Array1::from(of_all(&state.confidence)).into_dyn())),
            ("nu_target", plain(Array1::from(of_all(&self.targets)).into_dyn())),
            ("target", plain(image.into_dyn())),
        ];
        let arrays = arrays.map(|(role, arrays)| (role.to_owned(), arrays)).into();
        let settings = self.settings(done, self.dataset.train.angles[view]);
        Ok(Traced { scanner: self.dataset.scanner, settings, arrays })
    }

    fn settings(&self, done: usize, angle: f64) -> Map<String, Value> {
        let (config, grid, activation) = (self.config, &self.dataset.scanner.grid, &self.activation);
        let (o, wavelet) = (&config.optimiser, config.wavelet.settings());
        let block = |side, multiple, purpose| {
            let block = random_block(grid, side, multiple, config.seed, purpose, done + 1);
            indices(grid, &block)
        };
        let rates = [o.mean, o.scale, o.quaternion, o.density, o.nu].concat();
        let mut settings = json!({
            "angles": [angle],
            "projection": if config.projection == Projection::Exact { "exact" } else { "affine" },
            "kernel": if config.model.kernel == KernelKind::Gaussian { "gaussian" } else { "student-t" },
            "scale_range": [activation.scale.min, activation.scale.max],
            "nu_range": [activation.nu.min, activation.nu.max],
            "d_ssim": config.loss.d_ssim,
            "tv_weight": weight_of_tv(config),
            "blocks_move": u8::from(config.loss.blocks_move),
            "nu_weight": if config.confidence.enabled { config.confidence.weight } else { 0.0 },
            "neighbours": wavelet.neighbours,
            "threshold": wavelet.threshold,
            "enhancement": wavelet.enhancement,
            "suppress": wavelet.suppress,
            "enhance": wavelet.enhance,
            "levels": wavelet.levels,
            "rates": rates,
            "length": config.iterations,
            "done": done,
            "steps": done,
            "pace": pace(o.horizon, o.longest, config.iterations),
            "beta1": o.beta[0],
            "beta2": o.beta[1],
            "epsilon": o.epsilon,
            "position": if o.position == PositionOptimiser::Adam { "adam" } else { "sghmc" },
            "burn_in": burn_in(config),
            "burn_in_friction": config.sghmc.burn_in_friction,
            "friction": config.sghmc.friction,
            "reference": config.sghmc.density_reference,
        });
        if weight_of_tv(config) > 0.0 {
            settings["tv_block"] = block(config.loss.tv_block, 1, Purpose::TotalVariation);
        }
        if config.wavelet.enabled && (done + 1).is_multiple_of(config.wavelet.every) {
            settings["wavelet_block"] = block(config.wavelet.block, 1 << config.wavelet.levels, Purpose::Wavelet);
        }
        let Value::Object(settings) = settings else { unreachable!("an object") };
        settings
    }
}

/// The indices of the first voxel of a block, and its shape.
fn indices(grid: &Grid, block: &Grid) -> Value {
    let first = ((block.min - grid.min) / grid.spacing).round().to_array().map(|index| index as usize);
    json!([first, block.shape].concat())
}

fn plain(array: ArrayD<f64>) -> BTreeMap<String, ArrayD<f64>> {
    [(String::new(), array)].into()
}

fn archive(values: &Parameters) -> BTreeMap<String, ArrayD<f64>> {
    let of = |group: Group| {
        let shape = if group.width() == 1 { vec![values.len()] } else { vec![values.len(), group.width()] };
        let array = ArrayD::from_shape_vec(IxDyn(&shape), values.group(group).to_vec()).expect("rows of one width");
        (group.key().to_owned(), array)
    };
    Group::ALL.map(of).into()
}

#[cfg(feature = "oracle")]
#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::{Config, DensityControl, Method};
    use crate::oracle::{Outputs, Question, answers, fresh};
    use crate::scan::simulate::{Object, simulate};
    use crate::scan::{Noise, Phantom};
    use crate::tolerances::relative;

    /// The oracle's answer to a traced iteration, in double precision.
    fn answer(traced: &Traced) -> Outputs {
        let Traced { scanner, settings, arrays } = traced.clone();
        let vectors = fresh::traced("step", String::new(), settings, &scanner, arrays);
        let question = Question::new(&vectors, &vectors.manifest.cases[0]).unwrap();
        answers::answer(&question, trgs_core::numeric::Precision::F64).unwrap()
    }

    #[test]
    fn the_answer_to_an_iteration_is_what_the_next_one_starts_from() {
        let scanner = Scanner::synthetic(12, 14);
        let scan = crate::scan::simulate::Plan { views: 4, test_views: 0, noise: Noise::LOW, seed: 1 };
        let phantom = Phantom::by_name("torso", 0).unwrap();
        let dataset = simulate("scan", Object::Phantom(&phantom), &scanner, &scan).unwrap();
        for method in [Method::TrGs, Method::R2Gaussian] {
            let mut config = Config { iterations: 12, precision: Precision::F64, cutoff: 0.0, ..Config::of(method) };
            config.density_control.method = DensityControl::None;
            config.model.points = 40;
            config.wavelet.every = 3;
            let plan = config.plan(&dataset.scanner, dataset.train.len()).unwrap();
            // With and without wavelets, in the burn-in and after it.
            for iteration in [1, 3, 8, 12 - 1] {
                let at = |iteration| trace(&dataset, &plan, iteration, &mut |_| ControlFlow::Continue(())).unwrap();
                let (found, next) = (answer(&at(iteration)), at(iteration + 1));
                for (output, role) in
                    [("08-first", "first"), ("09-second", "second"), ("10-momentum", "momentum"), ("11-raw", "raw")]
                {
                    for (name, expected) in &next.arrays[role] {
                        let found = &found[output][name];
                        let error = found.iter().zip(expected).map(|(a, b)| relative(*a, *b)).fold(0.0, f64::max);
                        within!(error, "{method:?} {iteration} {output} {name}");
                    }
                }
            }
        }
    }
}
