//! `trgs evaluate`: how good a reconstruction is.

use super::Answer;
use clap::Args;
use serde::Serialize;
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use trgs::Result;
use trgs::config::{Config, Method, Precision};
use trgs::evaluation::Metrics;
use trgs::primitives::{Primitives, model};
use trgs::projector::forward;
use trgs::scene::{Dataset, Projections, Volume, trilinear, volume_file};

/// Compare a reconstruction with the truth and the test views of a dataset
#[derive(Args)]
#[command(after_help = "Examples:
  trgs evaluate out/torso --against data/torso
  trgs evaluate volume.npy --against data/torso --json

The projections of a run with a model are those of its primitives, in the run's own projection; those of a volume
are exact line integrals of the trilinear function through its voxels.")]
pub(super) struct Evaluate {
    /// Folder of a run, or a volume [x, y, z] on the dataset's grid
    #[arg(value_name = "RUN|VOLUME")]
    result: PathBuf,
    /// What to compare with
    #[arg(long, value_name = "DATASET")]
    against: PathBuf,
}

/// The metrics, and why the others are missing.
#[derive(Clone, Serialize)]
pub(super) struct Evaluation {
    #[serde(flatten)]
    pub(super) metrics: Metrics,
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    pub(super) absent: BTreeMap<&'static str, &'static str>,
}

impl Evaluate {
    pub(super) fn run(&self) -> Result<Answer> {
        let dataset = Dataset::read(&self.against)?;
        for note in &dataset.notes {
            tracing::info!("{}: {note}", self.against.display());
        }
        let evaluation = if self.result.is_dir() {
            let config = Config::read(&self.result.join("config.toml"), Method::TrGs)?;
            let volume = read_volume(&self.result.join("volume.npy"), &dataset)?;
            let model = self.result.join("model.npz");
            let primitives = if model.exists() { Some(model::read(&model)?) } else { None };
            evaluate(&dataset, &volume, primitives.as_ref(), &config)?
        } else {
            evaluate(&dataset, &read_volume(&self.result, &dataset)?, None, &Config::default())?
        };
        Ok(evaluation.answer(json!({ "result": self.result, "against": self.against })))
    }
}

/// Evaluates a volume, and the projections of the primitives that it came from, or where there are none its own.
pub(super) fn evaluate(
    dataset: &Dataset,
    volume: &Volume,
    primitives: Option<&Primitives>,
    config: &Config,
) -> Result<Evaluation> {
    let mut absent = BTreeMap::new();
    let volumes = dataset.truth.as_ref().map(|truth| (truth, volume));
    if volumes.is_none() {
        absent.extend(["psnr_3d", "ssim_3d"].map(|name| (name, "the dataset has no true volume")));
    }
    let projections = match &dataset.test {
        Some(test) => {
            let seen = match primitives {
                Some(primitives) => project(primitives, dataset, &test.angles, config)?,
                None => trilinear::project(volume, &dataset.scanner, &test.angles)?,
            };
            Some((test, seen))
        }
        None => {
            absent.extend(["psnr_2d", "ssim_2d"].map(|name| (name, "the dataset has no test views")));
            None
        }
    };
    let projections = projections.as_ref().map(|(test, seen)| (*test, seen));
    Ok(Evaluation { metrics: Metrics::compute(volumes, projections)?, absent })
}

/// Projections of primitives as they were fitted.
fn project(primitives: &Primitives, dataset: &Dataset, angles: &[f64], config: &Config) -> Result<Projections> {
    let (scanner, projection, cutoff) = (&dataset.scanner, config.projection, config.cutoff);
    let images = match config.precision {
        Precision::F32 => forward::<f32>(primitives, scanner, angles, projection, cutoff),
        Precision::F64 => forward::<f64>(primitives, scanner, angles, projection, cutoff).mapv(|value| value as f32),
    };
    Projections::new(angles.to_vec(), images)
}

fn read_volume(path: &Path, dataset: &Dataset) -> Result<Volume> {
    Volume::new(dataset.scanner.grid, volume_file::read(path)?.values).map_err(|error| error.in_file(path))
}

impl Evaluation {
    /// The metrics in a table, and in JSON together with the object `context`.
    pub(super) fn answer(&self, mut context: Value) -> Answer {
        let cells = Metrics::NAMES.into_iter().zip(self.metrics.row()).zip(self.metrics.columns());
        let rows = cells.map(|((name, value), metric)| {
            let reason = || format!("absent: {}", self.absent[name]);
            [name.into(), value, metric.map_or_else(reason, |metric| metric.definition.clone())]
        });
        if let (Some(context), Ok(Value::Object(metrics))) = (context.as_object_mut(), serde_json::to_value(self)) {
            context.extend(metrics);
        }
        Answer::table(&context, ["metric", "value", "definition"], rows)
    }
}
