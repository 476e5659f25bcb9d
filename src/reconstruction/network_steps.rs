//! The first steps of a network's training with all that they rest on, for programs that repeat them.

use crate::config::{Config, Plan};
use crate::error::{Error, Result};
use crate::neural::Batch;
use crate::scan::Dataset;
use crate::train::unit_of;
use ndarray::ArrayD;
use trgs_methods::internals::first_steps;

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
    let (scanner, views) = (&dataset.scanner, &dataset.train);
    let ([begin, end], batches, errors) = first_steps(config.precision, scanner, views, &config.neural(), unit, count)?;
    Ok(NetworkSteps { begin, batches, errors, end, unit, config })
}
