//! What one iteration of a run starts from, for implementations that are compared step by step.

use super::losses::weight_of_tv;
use super::optimiser::{burn_in, normals};
use super::views::random_block;
use super::{Plan, Trainer};
use crate::config::{DensityControl, PositionOptimiser};
use crate::error::{Error, Result};
use crate::numeric::rng::Purpose;
use crate::optim::schedule::pace;
use crate::oracle::fresh::Traced;
use crate::oracle::internals::{one, parameters};
use crate::oracle::{Outputs, Vectors, fresh, iteration, recycling, run};
use crate::primitives::KernelKind;
use crate::projector::{Kernels, Projection};
use crate::scan::dataset::Dataset;
use ndarray::{Array1, Array2, ArrayView2, Axis, stack};
use serde_json::{Map, Value, json};
use std::ops::ControlFlow;
use trgs_core::in_precision;
use trgs_methods::internals::in_unit;

/// Runs a configuration up to `iteration`, counted from 1, and returns what that one starts from: a question of the oracle's
/// stage `iteration`, or `run` for several `steps` from there. Where adding and recycling is due after a single iteration, a
/// question of the stage `recycling` follows. Lengths are in scene units, densities in the run's unit.
///
/// `observe` is called after every iteration; `Break` stops.
///
/// # Errors
/// Those of [`super::train`]; for another method, views with poses, an iteration that the run does not have, and SGHMC in the
/// textbook's form.
pub fn trace(
    dataset: &Dataset,
    config: &Plan,
    [iteration, steps]: [usize; 2],
    observe: &mut dyn FnMut(usize) -> ControlFlow<()>,
) -> Result<Vectors> {
    let refuse = |what: &str, got: String, expected: String| {
        Err(Error::invalid(what, got, expected, "trace another iteration, or another run"))
    };
    if !(1..=config.iterations).contains(&iteration) {
        return refuse("iteration", iteration.to_string(), format!("1 to {}", config.iterations));
    }
    if !(1..=config.iterations + 1 - iteration).contains(&steps) {
        return refuse("steps", steps.to_string(), format!("1 to {}", config.iterations + 1 - iteration));
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
    let dataset = &dataset.on(config.with_margin(&dataset.scanner).grid);
    let dataset = &*super::seen(dataset, config);
    let unit = super::unit_of(dataset, config)?;
    let dataset = &*in_unit(dataset, unit);
    let steps = [iteration, steps];
    in_precision!(config.precision, R => Trainer::<R>::new(dataset, unit, config, None)?.traced(steps, observe))
}

impl<R: Kernels> Trainer<'_, R> {
    fn traced(
        mut self,
        [iteration, steps]: [usize; 2],
        observe: &mut dyn FnMut(usize) -> ControlFlow<()>,
    ) -> Result<Vectors> {
        while self.state.iteration + 1 < iteration {
            let next = self.state.iteration + 1;
            self.step(next)?;
            self.state.iteration = next;
            if observe(next).is_break() {
                return Err(Error::interrupted(next, false));
            }
        }
        let mut questions = vec![self.iterations(iteration, steps)];
        let recycles = self.config.density_control.method == DensityControl::Ar && self.controls_density(iteration);
        if steps == 1 && recycles {
            self.fit(iteration)?;
            questions.push(self.recycling(iteration));
        }
        Ok(fresh::traced(questions))
    }

    /// What iterations in a row start from.
    fn iterations(&mut self, iteration: usize, steps: usize) -> Traced {
        let done = iteration - 1;
        let views: Vec<usize> = (done..done + steps).map(|step| self.order.view(step)).collect();
        let state = &self.state;
        let count = state.raw.len();
        let normals = |done: usize| -> Vec<[f64; 3]> {
            state.ids.iter().map(|&id| normals(self.config, done, id).to_array()).collect()
        };
        let of_all = |values: &[f64]| if values.is_empty() { vec![1.0; count] } else { values.to_vec() };
        let mut arrays = self.parameters();
        arrays.extend(one("confidence", Array1::from(of_all(&state.confidence))));
        arrays.extend(one("nu_target", Array1::from(of_all(&self.targets))));
        let (train, of) = (&self.dataset.train, format!("of {} of {}", self.config.iterations, self.dataset.name));
        let mut settings = self.settings(done);
        settings.insert("angles".into(), views.iter().map(|&view| train.angles[view]).collect());
        let (id, title) = if steps == 1 {
            arrays.extend(one("normals", rows(&normals(done))));
            arrays.extend(one("target", train.image(views[0]).mapv(f64::from)));
            settings.extend(self.blocks(done).map(|(key, block)| (key.into(), json!(block))));
            (format!("{}/step-{iteration}", iteration::STAGE), format!("Iteration {iteration} {of}"))
        } else {
            let all: Vec<Array2<f64>> = (done..done + steps).map(|done| rows(&normals(done))).collect();
            let all: Vec<_> = all.iter().map(|rows| rows.view()).collect();
            arrays.extend(one("normals", stack(Axis(0), &all).expect("arrays of one shape")));
            arrays.extend(one("targets", train.images.mapv(f64::from)));
            settings.insert("views".into(), json!(views));
            // A step in which a loss is not due has an empty block.
            for key in ["tv_block", "wavelet_block"] {
                let block =
                    |done| self.blocks(done).find(|(known, _)| *known == key).map_or(Vec::new(), |(_, block)| block);
                settings.insert(key.into(), (done..done + steps).map(block).collect());
            }
            let last = done + steps;
            (format!("{}/steps-{iteration}-{last}", run::STAGE), format!("Iterations {iteration} to {last} {of}"))
        };
        Traced { id, title, settings, scanner: Some(self.dataset.scanner), arrays }
    }

    /// What adding and recycling after an iteration starts from.
    fn recycling(&self, iteration: usize) -> Traced {
        let (mut uniform, mut normals) = (Vec::new(), Vec::new());
        let physical = self.activation.forward(&self.state.raw);
        self.recycled(&physical, iteration, |draw| uniform.push(draw), |draw| normals.push(draw));
        let mut arrays = self.parameters();
        arrays.extend(one("uniform", Array1::from(uniform)));
        arrays.extend(one("normals", rows(&normals)));
        let control = &self.config.density_control;
        let mut settings = self.activations();
        settings.extend(object(json!({
            "dead": control.dead,
            "recycled": control.recycled,
            "growth": control.growth,
            "cap": control.cap,
            "relocation": control.relocation,
            "spread": control.spread,
            "reset_parents": u8::from(control.reset_parents),
        })));
        let id = format!("{}/step-{iteration}", recycling::STAGE);
        let of = format!("of {} of {}", self.config.iterations, self.dataset.name);
        Traced { id, title: format!("Recycling after iteration {iteration} {of}"), settings, scanner: None, arrays }
    }

    /// The parameters with the state of their optimisers.
    fn parameters(&self) -> Outputs {
        let state = &self.state;
        let [first, second] = state.optimiser.moments(state.raw.len());
        let mut arrays = parameters("raw", &state.raw);
        arrays.extend(parameters("first", &first));
        arrays.extend(parameters("second", &second));
        arrays.extend(one("momentum", rows(state.optimiser.momentum())));
        arrays
    }

    /// The way from raw to physical parameters.
    fn activations(&self) -> Map<String, Value> {
        let activation = &self.activation;
        let kernel = if self.config.model.kernel == KernelKind::Gaussian { "gaussian" } else { "student-t" };
        object(json!({
            "kernel": kernel,
            "scale_range": [activation.scale.min, activation.scale.max],
            "nu_range": [activation.nu.min, activation.nu.max],
        }))
    }

    /// The blocks of the losses that are due in the step after `done`: first voxel and shape.
    fn blocks(&self, done: usize) -> impl Iterator<Item = (&'static str, Vec<usize>)> {
        let (config, grid) = (self.config, &self.dataset.scanner.grid);
        let block = |side, multiple, purpose| {
            let block = random_block(grid, side, multiple, config.seed, purpose, done + 1);
            let first = ((block.min - grid.min) / grid.spacing).round().to_array().map(|index| index as usize);
            [first, block.shape].concat()
        };
        let tv =
            (weight_of_tv(config) > 0.0).then(|| ("tv_block", block(config.loss.tv_block, 1, Purpose::TotalVariation)));
        let wavelet = (config.wavelet.enabled && (done + 1).is_multiple_of(config.wavelet.every))
            .then(|| ("wavelet_block", block(config.wavelet.block, 1 << config.wavelet.levels, Purpose::Wavelet)));
        tv.into_iter().chain(wavelet)
    }

    fn settings(&self, done: usize) -> Map<String, Value> {
        let config = self.config;
        let (o, wavelet) = (&config.optimiser, config.wavelet.settings());
        let rates = [o.mean, o.scale, o.quaternion, o.density, o.nu].concat();
        let settings = json!({
            "projection": if config.projection == Projection::Exact { "exact" } else { "affine" },
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
        let mut settings = object(settings);
        settings.extend(self.activations());
        settings
    }
}

fn object(value: Value) -> Map<String, Value> {
    let Value::Object(map) = value else { unreachable!("an object") };
    map
}

fn rows(rows: &[[f64; 3]]) -> Array2<f64> {
    ArrayView2::from(rows).to_owned()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::{Config, Method};
    use crate::density::Relocation;
    use crate::geometry::Scanner;
    use crate::oracle::{Format, Options, Question, Tolerances, answers, check, report, waivers};
    use crate::scan::simulate::{Object, simulate};
    use crate::scan::{Noise, Phantom};
    use crate::tolerances::relative;

    fn scan() -> Dataset {
        let plan = crate::scan::simulate::Plan { views: 4, test_views: 0, noise: Noise::LOW, seed: 1 };
        let phantom = Phantom::by_name("torso", 0).unwrap();
        simulate("scan", Object::Phantom(&phantom), &Scanner::synthetic(12, 14), &plan).unwrap()
    }

    fn config(method: Method) -> Config {
        let mut config =
            Config { iterations: 12, precision: trgs_core::numeric::Precision::F64, cutoff: 0.0, ..Config::of(method) };
        config.density_control.method = DensityControl::None;
        config.model.points = 40;
        config.wavelet.every = 3;
        config
    }

    #[test]
    fn iterations_in_a_row_end_where_the_training_ends() {
        let dataset = scan();
        for method in [Method::TrGs, Method::R2Gaussian] {
            let mut config = config(method);
            // Its value at the first of them stays.
            config.confidence.every = 100;
            let plan = config.plan(&dataset.scanner, dataset.train.len()).unwrap();
            let of = |steps| trace(&dataset, &plan, steps, &mut |_| ControlFlow::Continue(())).unwrap();
            let (run, after) = (of([2, 6]), of([8, 1]));
            let question = Question::new(&run, &run.manifest.cases[0]).unwrap();
            let found = answers::answer(&question, trgs_core::numeric::Precision::F64).unwrap();
            for (name, expected) in &after.arrays(&after.manifest.cases[0].inputs["raw"]).unwrap() {
                let error = found["6-raw"][name].iter().zip(expected).map(|(a, b)| relative(*a, *b));
                within!(error.fold(0.0, f64::max), "{method:?} {name}");
            }
        }
    }

    #[test]
    fn the_answer_to_recycling_is_what_the_next_iteration_starts_from() {
        let dataset = scan();
        for (relocation, reset_parents, spread) in [(Relocation::Exact, false, 1.0), (Relocation::Sss, true, 0.0)] {
            let mut config = config(Method::TrGs);
            let control = &mut config.density_control;
            (control.method, control.every, control.start) = (DensityControl::Ar, 4, 0.0);
            (control.relocation, control.reset_parents, control.spread) = (relocation, reset_parents, spread);
            (control.dead, control.recycled, control.growth) = (0.05, 0.2, 0.1);
            let plan = config.plan(&dataset.scanner, dataset.train.len()).unwrap();
            let at = |iteration| trace(&dataset, &plan, [iteration, 1], &mut |_| ControlFlow::Continue(())).unwrap();
            let (this, next) = (at(4), at(5));
            assert_eq!([&this, &next].map(|vectors| vectors.manifest.cases.len()), [2, 1]);
            let case = &this.manifest.cases[1];
            assert_eq!(case.id, "recycling/step-4");
            let found = answers::answer(&Question::new(&this, case).unwrap(), trgs_core::numeric::Precision::F64);
            let mut found = found.unwrap();
            let following = &next.manifest.cases[0];
            let mut after = Question::new(&next, following)
                .and_then(|question| answers::answer(&question, trgs_core::numeric::Precision::F64))
                .unwrap();
            let physical = after.remove("01-physical").unwrap();
            let (old, new) = (plan.model.points, physical["nu"].len());
            assert!(new > old, "{new}");
            let is_fresh = |row: &usize| found["2-fresh"][""][[*row]] == 1.0;
            assert!((0..old).any(|row| is_fresh(&row)) && (old..new).all(|row| is_fresh(&row)));
            let mut expected = Outputs::from([("3-physical".into(), physical)]);
            for (output, role) in [("4-first", "first"), ("5-second", "second"), ("6-momentum", "momentum")] {
                expected.insert(output.into(), next.arrays(&following.inputs[role]).unwrap());
            }
            for (output, arrays) in expected {
                for (name, expected) in arrays {
                    let found = found.get_mut(&output).unwrap().remove(&name).unwrap();
                    let error = found.iter().zip(&expected).map(|(a, b)| relative(*a, *b)).fold(0.0, f64::max);
                    assert_eq!(found.shape(), expected.shape());
                    within!(error, "{relocation:?} {output} {name}");
                }
            }
        }
    }

    /// The slope of a ball to its quaternion is 0 or a rounding error, of which Adam's first step has the sign.
    #[test]
    fn the_first_step_may_follow_a_rounding_error() {
        let dataset = scan();
        let plan = config(Method::TrGs).plan(&dataset.scanner, dataset.train.len()).unwrap();
        for (iteration, passes) in [(1, true), (8, false)] {
            let vectors = trace(&dataset, &plan, [iteration, 1], &mut |_| ControlFlow::Continue(())).unwrap();
            let folder = tempfile::tempdir().unwrap();
            let vectors = fresh::with_truth(vectors, Format::F32, folder.path()).unwrap();
            let case = &vectors.manifest.cases[0];
            let question = Question::new(&vectors, case).unwrap();
            let mut found = answers::answer(&question, trgs_core::numeric::Precision::F64).unwrap();
            let raw = &vectors.arrays(&case.inputs["raw"]).unwrap()["quaternion"];
            let (rate, density) = (found["07-rates"][""][[2]], found["01-physical"]["density"].clone());
            let after = found.get_mut("11-raw").and_then(|arrays| arrays.get_mut("quaternion")).unwrap();
            // Those of almost no density have almost no rounding error either.
            let mean = density.mean().unwrap();
            let rows = density.iter().zip(raw.outer_iter()).zip(after.outer_iter_mut());
            let mut rows: Vec<_> = rows.filter(|((density, _), _)| **density > mean).collect();
            assert!(rows.len() > 5, "{}", rows.len());
            rows.iter_mut().for_each(|((_, raw), after)| after.zip_mut_with(raw, |after, raw| *after = raw + rate));
            answers::write(folder.path(), case, &found).unwrap();
            let level = case.level;
            let options = Options {
                format: Format::F32,
                level,
                stages: &[],
                waivers: &[],
                today: waivers::today(),
                commit: None,
            };
            let report = check(&vectors, &Tolerances::of(&vectors).unwrap(), folder.path(), &options).unwrap();
            assert_eq!(report.passed(), passes, "{iteration}: {}", report::markdown(&report));
        }
    }

    #[test]
    fn the_answer_to_an_iteration_is_what_the_next_one_starts_from() {
        let dataset = scan();
        for method in [Method::TrGs, Method::R2Gaussian] {
            let plan = config(method).plan(&dataset.scanner, dataset.train.len()).unwrap();
            // With and without wavelets, in the burn-in and after it.
            for iteration in [1, 3, 8, 12 - 1] {
                let at =
                    |iteration| trace(&dataset, &plan, [iteration, 1], &mut |_| ControlFlow::Continue(())).unwrap();
                let (this, next) = (at(iteration), at(iteration + 1));
                let [case, following] = [&this, &next].map(|vectors| &vectors.manifest.cases[0]);
                let question = Question::new(&this, case).unwrap();
                let found = answers::answer(&question, trgs_core::numeric::Precision::F64).unwrap();
                for (output, role) in
                    [("08-first", "first"), ("09-second", "second"), ("10-momentum", "momentum"), ("11-raw", "raw")]
                {
                    for (name, expected) in &next.arrays(&following.inputs[role]).unwrap() {
                        let found = &found[output][name];
                        let error = found.iter().zip(expected).map(|(a, b)| relative(*a, *b)).fold(0.0, f64::max);
                        within!(error, "{method:?} {iteration} {output} {name}");
                    }
                }
            }
        }
    }
}
