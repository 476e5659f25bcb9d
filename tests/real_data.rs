//! What other programs measured and simulated, read and compared. The data are not part of the project: they are looked
//! for in `../shared/data` or where `TRGS_DATA` says, and without them nothing is checked, which the output says aloud.

use std::path::PathBuf;
use trgs::classical::{Window, fdk};
use trgs::numeric::elementary::log10;
use trgs::scene::{Dataset, trilinear};

/// The folder of a scan, or `None` and a loud remark.
fn scan(name: &str) -> Option<PathBuf> {
    let data = std::env::var_os("TRGS_DATA")
        .map_or_else(|| PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/../shared/data")), PathBuf::from);
    let path = data.join(name);
    if path.is_dir() {
        return Some(path);
    }
    eprintln!("SKIPPED: {} is not there; set TRGS_DATA to the folder that holds it", path.display());
    None
}

#[test]
fn exact_projections_agree_with_those_another_program_marched() {
    for name in ["engine_18v", "chest_fnndsc_18v"] {
        let Some(path) = scan(name) else { continue };
        let scan = Dataset::read(&path).unwrap();
        let (truth, test) = (scan.truth.unwrap(), scan.test.unwrap());
        let ours = trilinear::project(&truth, &scan.scanner, &test.angles).unwrap();
        let difference = (&ours.images - &test.images).mapv(f32::abs);
        let (mean, largest) = (difference.mean().unwrap(), difference.iter().fold(0.0_f32, |a, &b| a.max(b)));
        let peak = test.images.iter().fold(0.0_f32, |a, &b| a.max(b));
        eprintln!("{name}: mean difference {mean:e}, largest {largest:e}, of at most {peak}");
        // Theirs stepped a quarter of a voxel, ours is exact: the difference is their error.
        assert!(mean < 2e-5 && largest < 1e-3, "{name}");
    }
}

#[test]
fn filtered_backprojection_is_as_good_as_that_of_another_program() {
    for (name, expected) in [("engine_18v", 21.57), ("chest_fnndsc_18v", 23.02)] {
        let Some(path) = scan(name) else { continue };
        let scan = Dataset::read(&path).unwrap();
        let start = std::time::Instant::now();
        let volume = fdk(&scan.scanner, &scan.train, Window::RamLak).unwrap();
        let seconds = start.elapsed().as_secs_f64();
        let squares = (&volume.values - &scan.truth.unwrap().values).mapv(|d| f64::from(d * d));
        let psnr = -10.0 * log10(squares.mean().unwrap());
        eprintln!("{name}: {psnr:.3} dB, they had {expected}; {seconds:.4} s");
        assert!((psnr - expected).abs() < 0.3, "{name}: {psnr} dB");
    }
}
