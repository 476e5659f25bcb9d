//! Reconstructs a scan with the default settings and writes the volume.
//!
//!     cargo run --release --example reconstruct -- SCAN volume.nii.gz
//!
//! Without arguments: a short run on a simulated scan of a phantom.

use std::ops::ControlFlow;
use trgs::reconstruction::{Checkpoints, Progress};
use trgs::scan::simulate::{Object, Plan, simulate};
use trgs::scan::{Noise, Phantom};
use trgs::{Config, Dataset, Run, Scanner};

fn main() -> trgs::Result<()> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let mut config = Config::default();
    let scan = match arguments.first() {
        // A dataset folder, its meta_data.json, or a pickle of NAF.
        Some(path) => Dataset::read(path)?,
        None => {
            config.iterations = 200;
            phantom()?
        }
    };

    // Every key of the configuration can be set by its name, too.
    config.set("report_every=50")?;
    let mut run = Run::new(&scan, &config).observe(|progress| {
        if let Progress::Iteration(iteration, Some(record)) = progress {
            println!("iteration {iteration}: loss {:.5}, {} primitives", record.loss, record.primitives);
        }
        // `Break` stops the run; with checkpoints it can be continued.
        ControlFlow::Continue(())
    });
    if let Some(volume) = arguments.get(1) {
        run = run.checkpoints(Checkpoints::resume(format!("{volume}.checkpoint"))?);
    }
    let result = run.reconstruct()?;

    // Metrics that the dataset allows: it may have a true volume and test views.
    let evaluation = trgs::evaluate(&scan, &result.volume, result.primitives.as_ref(), &config)?;
    for metric in evaluation.metrics.columns().into_iter().flatten() {
        println!("{} {:.4}", metric.definition, metric.value);
    }
    // The format follows from the name: .nii.gz, .mha, .nrrd, .tif, .npy, .raw.
    arguments.get(1).map_or(Ok(()), |path| trgs::write_volume(path, &result.volume, &scan.frame))
}

/// Twelve noisy views of a torso in 32³ voxels.
fn phantom() -> trgs::Result<Dataset> {
    let plan = Plan { views: 12, test_views: 4, noise: Noise::LOW, seed: 0 };
    let torso = Phantom::by_name("torso", 0)?;
    simulate("torso", Object::Phantom(&torso), &Scanner::synthetic(32, 48), &plan)
}
