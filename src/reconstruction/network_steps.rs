//! The first steps of a network's training with all that they rest on, for programs that repeat them.

use crate::config::{Config, Plan, Precision};
use crate::error::{Error, Result};
use crate::limit;
use crate::neural::{Batch, NeuralRun};
use crate::numeric::Real;
use crate::scan::Dataset;
use crate::train::unit_of;
use ndarray::ArrayD;

/// Steps of a network's training.
#[derive(Clone, Debug, PartialEq)]
pub struct NetworkSteps {
    /// Parameters before the first step, by name; weights are `[outputs, inputs]`, tables `[entries, features]`.
    pub begin: Vec<(String, ArrayD<f64>)>,
    /// What each step sees.
    pub batches: Vec<Batch>,
    /// Mean squared error of the rays of each step, before the step.
    pub errors: Vec<f64>,
    /// Parameters after the last step.
    pub end: Vec<(String, ArrayD<f64>)>,
    /// Attenuation per scene unit that counts as 1.
    pub unit: f64,
    /// The configuration with what follows from the scan.
    pub config: Plan,
}

/// The first `count` steps of a run with this configuration.
///
/// # Errors
/// For a method that has no network, settings out of their ranges, or a scan that does not fit.
pub fn network_steps(dataset: &Dataset, config: &Config, count: usize) -> Result<NetworkSteps> {
    if !config.method.is_network() {
        let got = serde_json::to_value(config.method).expect("a name");
        return Err(Error::invalid("method", got, "naf, sax-nerf or intratomo", "name one of them"));
    }
    let config = config.plan(&dataset.scanner, dataset.train.len())?;
    let unit = unit_of(dataset, &config)?;
    match config.precision {
        Precision::F32 => steps::<f32>(dataset, config, count, unit),
        Precision::F64 => steps::<f64>(dataset, config, count, unit),
    }
}

fn steps<R: Real>(dataset: &Dataset, config: Plan, count: usize, unit: f64) -> Result<NetworkSteps> {
    let mut run = NeuralRun::<R>::new(&dataset.scanner, &dataset.train, &config.neural(), unit, None)?;
    let begin = run.named_parameters();
    let settings = config.neural();
    let rays = settings.rays + settings.windows * settings.window * settings.window;
    limit::allow_array("points of all steps", &[count, rays, settings.samples], 4 * size_of::<f64>())?;
    let (mut batches, mut errors) = (Vec::with_capacity(count), Vec::with_capacity(count));
    for _ in 0..count {
        batches.push(run.batch());
        errors.push(run.train());
    }
    let end = run.named_parameters();
    Ok(NetworkSteps { begin, batches, errors, end, unit, config })
}
