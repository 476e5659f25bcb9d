//! `trgs demo`: simulates, reconstructs and evaluates a phantom, and writes a report page.

use super::arguments::{Replace, seed};
use super::messages::moved;
use super::reconstruct::reconstruct;
use super::run_folder::{Outcome, RunFolder, Source};
use super::{Global, Output, interrupt};
use clap::Args;
use serde_json::json;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use trgs::config::{Config, Method};
use trgs::evaluation::{Metric, Metrics};
use trgs::experiments::{Matching, Scale};
use trgs::geometry::Scanner;
use trgs::output::{Destination, Kind, Mark};
use trgs::scan::simulate::{Object, Plan, simulate};
use trgs::scan::{Dataset, Noise, Phantom};
use trgs::{Result, words};

/// The paper's experiment at a quarter of its size in every direction.
const SCALE: Scale = Scale { size: 64, matching: Matching::Edge, pixels: None };

/// Fewer iterations than the default, which keep the demo under a minute.
const ITERATIONS: usize = 500;

/// Simulate a phantom scan, reconstruct it and write a report page; takes about half a minute
#[derive(Args)]
#[command(after_help = "Example:
  trgs demo --out out/demo")]
pub(super) struct Demo {
    /// Folder to write
    #[arg(long, value_name = "DIR", default_value = "out/demo")]
    out: PathBuf,
    #[command(flatten)]
    replace: Replace,
    /// Seed of all random choices
    #[arg(long, value_name = "N", default_value_t = 0, value_parser = seed)]
    seed: u64,
}

impl Demo {
    pub(super) fn run(&self, global: &Global) -> Result<Output> {
        let source = self.out.join("dataset");
        tracing::info!("scanning a phantom: 18 noisy projections for reconstruction, 50 for evaluation");
        let dataset = self.scan()?;
        let overwrite = self.replace.overwrite;
        let destination = Destination::new(&source, Kind::Scan, "demo").overwrite(overwrite);
        interrupt::shielded(|| dataset.write(destination.clone()))?;
        moved(&destination);
        // The mark of the folder has the digests of its files.
        let files = Mark::read(&source).map_or_else(BTreeMap::new, |mark| mark.files);
        let path = |file: String| source.join(file).display().to_string();
        let digests: BTreeMap<_, _> =
            files.into_iter().filter_map(|(file, digest)| Some((path(file), digest?))).collect();

        let run = |method, folder: &Path, beside: Option<&Outcome>| {
            let claim = RunFolder::claim(folder, &source, overwrite)?;
            let mut config = Config::of(method);
            (config.seed, config.report_every) = (self.seed, 50);
            if method.fits_primitives() {
                config.iterations = ITERATIONS;
            }
            let config = config.plan(&dataset.scanner, dataset.train.len())?;
            let source = Source { scan: source.clone(), digests: digests.clone(), warnings: Vec::new() };
            reconstruct(&dataset, &config, claim, source, None, beside, global)
        };
        tracing::info!("reconstructing by filtered back projection");
        let fdk = run(Method::Fdk, &self.out.join("fdk"), None)?;
        tracing::info!("reconstructing with Student's t-kernels");
        let folder = self.out.join("tr-gs");
        let ours = run(Method::TrGs, &folder, Some(&fdk))?;

        let report = folder.join("report.html");
        tracing::info!("wrote {}: open it in a browser", report.display());
        let [ours, fdk] = [ours.evaluation, fdk.evaluation];
        let rows = (Metrics::NAMES.into_iter().zip(ours.metrics.row()).zip(fdk.metrics.row()))
            .map(|((name, ours), fdk)| [name.into(), ours, fdk]);
        let found =
            json!({ "dataset": words::name(&source), "report": words::name(&report), "tr-gs": ours, "fdk": fdk });
        let lead = |(ours, fdk): (&Metric, &Metric)| {
            format!(
                "TR-GS is {:.1} dB above FDK, the usual reconstruction, from the same projections.",
                ours.value - fdk.value
            )
        };
        let lead: Vec<String> =
            ours.metrics.psnr_3d.as_ref().zip(fdk.metrics.psnr_3d.as_ref()).map(lead).into_iter().collect();
        Ok(Output::judged_table(&found, ["metric", "TR-GS", "FDK"], rows, &lead, true))
    }

    fn scan(&self) -> Result<Dataset> {
        let scanner = Scanner::synthetic(SCALE.size, SCALE.detector());
        let plan = Plan { views: 18, test_views: 50, noise: Noise::LOW, seed: self.seed };
        let phantom = Phantom::by_name("torso", self.seed)?;
        simulate("torso", Object::Phantom(&phantom), &scanner, &plan)
    }
}
