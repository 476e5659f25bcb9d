//! One run of an experiment: a case, its acquisition, and the settings of a method.

use super::case::{Acquisition, Case};
use super::conditions::Conditions;
use super::scale::Scale;
use super::table::{Table, TableRow, noise};
use crate::config::{Config, Method};
use crate::error::Result;
use crate::geometry::Volume;
use crate::provenance::{commit, digest_bytes};
use crate::reconstruction::{self, Checkpoints, Reconstruction, Run};
use crate::report::slice::{Cut, Picture, Window};
use crate::report::viewer::{self, Depth, Scene};
use crate::scan::Dataset;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::ops::ControlFlow;
use std::path::PathBuf;

/// Digits of an id: among a million cells, two equal ids are improbable.
const ID_DIGITS: usize = 20;

/// Voxels of a volume on the page of a cell: a table has hundreds of these files.
const SHOWN_VOXELS: usize = 64 * 64 * 64;

/// A run that is independent of all others and is needed only once.
#[derive(Clone, Debug)]
pub struct Cell {
    /// Id, derived from configuration, data and program version.
    pub id: String,
    /// The object or scan.
    pub case: Case,
    /// Number of training views.
    pub views: usize,
    /// Level of noise.
    pub noise: String,
    /// Seed of all random choices of scan and run.
    pub seed: u64,
    /// The size that all sizes are derived from.
    pub scale: Scale,
    conditions: Conditions,
    config: Config,
}

/// The result of a cell. Equal cells give equal bits, so it holds no time.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Finding {
    /// Id of the cell.
    pub id: String,
    /// Name of the case.
    pub case: String,
    /// Number of training views.
    pub views: usize,
    /// Level of noise.
    pub noise: String,
    /// Seed of scan and run.
    pub seed: u64,
    /// The reconstruction method.
    pub method: Method,
    /// Those of [`super::METRICS`] that were computed.
    pub metrics: BTreeMap<String, f64>,
    /// Number of primitives at the end.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub primitives: Option<usize>,
}

impl Table {
    /// The cells of the table; cells of one scan are adjacent.
    pub fn cells(&self, cases: &[Case], scale: Scale, seeds: u64) -> Vec<Cell> {
        let mut cells = Vec::new();
        for seed in 0..seeds {
            for &views in &self.views {
                for level in &self.noise {
                    for case in cases {
                        let of_row = |row: &TableRow| self.cell(row, case, scale, views, level, seed);
                        cells.extend(self.rows.iter().filter_map(of_row));
                    }
                }
            }
        }
        cells
    }

    /// The cell of a row; `None` if the row runs nothing, or the case has other noise.
    pub(super) fn cell(
        &self,
        row: &TableRow,
        case: &Case,
        scale: Scale,
        views: usize,
        level: &str,
        seed: u64,
    ) -> Option<Cell> {
        let mut config = row.config(self.basis, &self.set)?;
        if !case.takes_noise() && level != "low" {
            return None;
        }
        config.seed = seed;
        let (case, noise, conditions) = (case.clone(), level.into(), self.conditions());
        let mut cell = Cell { id: String::new(), case, views, noise, seed, scale, conditions, config };
        let settings = serde_json::to_string(&cell.config).expect("a configuration has string keys");
        let program = commit().unwrap_or(env!("CARGO_PKG_VERSION"));
        let known = format!("{program}\n{}\n{settings}", cell.scan_id());
        cell.id = digest_bytes(known.as_bytes())[..ID_DIGITS].to_owned();
        Some(cell)
    }
}

impl Cell {
    /// Id of the scan; equal for cells of the same scan.
    pub(super) fn scan_id(&self) -> String {
        let Self { case, scale, views, noise, seed, conditions, .. } = self;
        format!("{} {scale:?} {views} {noise} {seed} {conditions:?}", case.digest)
    }

    /// A short description for display.
    pub fn description(&self) -> String {
        let method = serde_json::to_value(self.config.method).expect("a name");
        let method = method.as_str().unwrap_or_default();
        format!("{}, {} views, {} noise, seed {}, {method}", self.case.name, self.views, self.noise, self.seed)
    }

    /// The scan that the cell reconstructs.
    pub(super) fn scan(&self) -> Result<Dataset> {
        let (noise, conditions) = (noise(&self.noise), self.conditions);
        let acquisition = Acquisition { views: self.views, noise, seed: self.seed, conditions };
        let mut scan = self.case.scan(self.scale, &acquisition)?;
        self.conditions.damage.apply(&mut scan.train, self.seed);
        Ok(scan)
    }

    /// Runs the cell on its scan, from the checkpoint in `state` if there is one; also returns the [`picture`] of its result,
    /// and a page to scroll through it.
    pub(super) fn run(
        &self,
        dataset: &Dataset,
        state: PathBuf,
        go_on: &mut dyn FnMut() -> ControlFlow<()>,
    ) -> Result<(Finding, Vec<u8>, String)> {
        let Reconstruction { primitives, volume, around, unfinished, log, .. } = Run::new(dataset, &self.config)
            .checkpoints(Checkpoints::resume(state)?)
            .observe(|_| go_on())
            .reconstruct()?;
        let evaluation =
            reconstruction::evaluate(dataset, around.as_ref().unwrap_or(&volume), primitives.as_ref(), &self.config)?;
        let names = crate::evaluation::Metrics::NAMES.into_iter().zip(evaluation.metrics.columns());
        let mut metrics: BTreeMap<String, f64> = names
            .filter_map(|(name, metric)| Some((name.into(), metric?.value)))
            .filter(|(_, value)| value.is_finite())
            .collect();
        if let Some(before) = unfinished {
            let before = reconstruction::evaluate(dataset, &before, None, &self.config)?.metrics;
            metrics.extend(before.psnr_3d.map(|metric| ("unfinished".into(), metric.value)));
        }
        if let Some(spearman) = log.last().and_then(|record| record.spearman) {
            metrics.insert("spearman".into(), spearman);
        }
        if let Some(primitives) = &primitives {
            metrics.insert("primitives".into(), primitives.len() as f64);
        }
        let finding = Finding {
            id: self.id.clone(),
            case: self.case.name.clone(),
            views: self.views,
            noise: self.noise.clone(),
            seed: self.seed,
            method: self.config.method,
            metrics,
            primitives: primitives.map(|primitives| primitives.len()),
        };
        Ok((finding, picture(&volume), self.page(dataset, &volume)?))
    }

    /// The truth and the result in the viewer.
    fn page(&self, dataset: &Dataset, volume: &Volume) -> Result<String> {
        let truth = dataset.truth.iter().map(|truth| ("truth", truth));
        let shown = truth.chain([(self.config.method.title(), volume)]).collect();
        let title = self.description();
        let scene = Scene::of_volumes(&title, shown, &dataset.frame)?.within(SHOWN_VOXELS);
        Ok(viewer::page(&title, &scene.summary(), &[scene], Depth::Eight))
    }
}

/// The middle slice across z, densities 0 to 1 as black to white, as a PNG file.
pub(super) fn picture(volume: &Volume) -> Vec<u8> {
    let cut = Cut { axis: 2, index: volume.grid.shape[2] / 2 };
    Picture::grey(&cut.values(volume), Window { low: 0.0, high: 1.0 }).png()
}
