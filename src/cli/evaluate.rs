//! `trgs evaluate`: the quality of a reconstruction.

use super::Output;
use super::messages::warnings;
use clap::Args;
use ndarray::Axis;
use serde_json::{Value, json};
use std::path::{Path, PathBuf};
use trgs::config::{Config, Method};
use trgs::evaluation::Metrics;
use trgs::geometry::{Grid, Volume};
use trgs::reconstruction::{Evaluation, evaluate};
use trgs::scan::volume_file::{self, Stored, VolumeFile};
use trgs::scan::{Dataset, Frame, model};
use trgs::{Result, words};

/// Compare a reconstruction with the truth and the test views of a dataset, or with a volume
#[derive(Args)]
#[command(after_help = "Examples:
  trgs evaluate out/torso --against data/torso
  trgs evaluate volume.npy --against data/torso --json
  trgs evaluate out/torso --against own-ct.nii.gz

Projections of a run with a model are computed from its primitives, with the projection of the run. Projections of \
a volume are exact line integrals of its trilinear interpolation.")]
pub(super) struct Evaluate {
    /// Folder of a run, or a volume [x, y, z] on the dataset's grid
    #[arg(value_name = "RUN|VOLUME")]
    result: PathBuf,
    /// Dataset with the true volume and test views, or a true volume in any format
    #[arg(long, value_name = "DATASET|VOLUME")]
    against: PathBuf,
}

impl Evaluate {
    pub(super) fn run(&self) -> Result<Output> {
        let context = json!({ "result": words::name(&self.result), "against": words::name(&self.against) });
        if self.against.is_file() && volume_file::is_volume(&self.against) {
            return Ok(answer(&self.against_volume()?, context));
        }
        let dataset = Dataset::read(&self.against)?;
        for note in &dataset.notes {
            tracing::info!("{}: {note}", self.against.display());
        }
        let evaluation = if self.result.is_dir() {
            let config = Config::read(self.result.join("config.toml"), Method::TrGs)?;
            let volume = read_volume(&self.result.join("volume.npy"), &dataset)?;
            let model = self.result.join("model.npz");
            let primitives = if model.exists() { Some(model::read(&model)?) } else { None };
            evaluate(&dataset, &volume, primitives.as_ref(), &config)?
        } else {
            evaluate(&dataset, &read_volume(&self.result, &dataset)?, None, &Config::default())?
        };
        Ok(answer(&evaluation, context))
    }

    /// The quality against a volume alone, on the grid of whichever file states its spacing.
    fn against_volume(&self) -> Result<Evaluation> {
        let result = if self.result.is_dir() { &self.result.join("volume.npy") } else { &self.result };
        let files = [volume_file::open(&self.against)?, volume_file::open(result)?];
        let is_second = files[0].metadata().spacing.is_none() && files[1].metadata().spacing.is_some();
        let (stating, path) = if is_second { (&files[1], result) } else { (&files[0], &self.against) };
        let around = Frame::around_shape(stating.metadata(), stating.shape());
        let (frame, grid) = around.map_err(|error| error.in_file(path))?;
        let arranged = |file: Stored, path: &PathBuf| -> Result<Stored> {
            let arranged = frame.arrange_stored(file, &grid).map_err(|error| error.in_file(path))?;
            warnings(path, &arranged.metadata().oddities);
            arranged.kept()
        };
        let [truth, volume] = files;
        let (mut truth, mut volume) = (arranged(truth, &self.against)?, arranged(volume, result)?);
        let metrics = Metrics::of_slabs(&mut |Axis(axis), compare| {
            let thickness = truth.thickness(axis)?.max(volume.thickness(axis)?);
            let count = grid.shape[axis];
            (0..count).step_by(thickness).try_for_each(|first| {
                let slices = first..count.min(first.saturating_add(thickness));
                compare(truth.slab(axis, slices.clone())?.view(), volume.slab(axis, slices)?.view());
                Ok(())
            })
        })?;
        let absent = ["psnr_2d", "ssim_2d"].map(|name| (name, "a volume has no test views")).into();
        Ok(Evaluation { metrics, absent })
    }
}

/// The volume of a file on the grid of a dataset.
pub(super) fn read_volume(path: &Path, dataset: &Dataset) -> Result<Volume> {
    arrange(&dataset.frame, volume_file::read(path)?, &dataset.scanner.grid, path)
}

/// The volume of a file on a grid; one that states other axes is turned to those of the grid.
pub(super) fn arrange(frame: &Frame, file: VolumeFile, grid: &Grid, path: &Path) -> Result<Volume> {
    let (volume, remarks) = frame.arrange(file, grid).map_err(|error| error.in_file(path))?;
    warnings(path, remarks);
    Ok(volume)
}

/// The metrics in a table, and in JSON together with the object `context`.
pub(super) fn answer(evaluation: &Evaluation, mut context: Value) -> Output {
    let cells = Metrics::NAMES.into_iter().zip(evaluation.metrics.row()).zip(evaluation.metrics.columns());
    let rows = cells.map(|((name, value), metric)| {
        let reason = || format!("absent: {}", evaluation.absent[name]);
        [name.into(), value, metric.map_or_else(reason, |metric| metric.definition.clone())]
    });
    let ranges = Metrics::RANGE_NAMES.into_iter().zip([2, 4]).zip(evaluation.metrics.of_range());
    let ranges = ranges.filter_map(|((name, decimals), metric)| {
        let metric = metric?;
        Some([name.into(), format!("{:.decimals$}", metric.value), metric.definition.clone()])
    });
    let rows: Vec<_> = rows.chain(ranges).collect();
    if let (Some(context), Ok(Value::Object(metrics))) = (context.as_object_mut(), serde_json::to_value(evaluation)) {
        context.extend(metrics);
    }
    let header = ["metric", "value", "definition"];
    if rows.len() == Metrics::NAMES.len() {
        return Output::table(&context, header, rows);
    }
    let remark = "The largest value of the truth is not near 1, the peak of psnr_3d and ssim_3d; those of _range take the truth's \
                  own range instead.";
    Output::judged_table(&context, header, rows, &[remark.into()], true)
}

/// [`answer`] from the metrics that a run has written.
pub(super) fn answer_again(metrics: Value, mut context: Value) -> Output {
    let names = Metrics::NAMES.into_iter().chain(Metrics::RANGE_NAMES);
    let rows: Vec<_> = names
        .filter_map(|name| {
            let metric = metrics.get(name)?;
            let definition = metric["definition"].as_str()?;
            Some([name.into(), format!("{:.4}", metric["value"].as_f64()?), definition.to_owned()])
        })
        .collect();
    if let (Some(context), Value::Object(metrics)) = (context.as_object_mut(), metrics) {
        context.extend(metrics);
    }
    Output::table(&context, ["metric", "value", "definition"], rows)
}
