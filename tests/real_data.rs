//! What other programs measured and simulated, read and compared. The data are not part of the project: they are looked
//! for in `../shared/data` or where `TRGS_DATA` says, and without them nothing is checked, which the output says aloud.

use std::path::PathBuf;
use trgs::scene::{Dataset, trilinear};

/// The folder of a scan, or `None` and a loud remark.
fn scan(name: &str) -> Option<PathBuf> {
    let data = std::env::var_os("TRGS_DATA").map_or_else(|| PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/../shared/data")), PathBuf::from);
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
        for (index, d) in difference.indexed_iter() { if *d > 0.5*largest { eprintln!("{index:?} {} {}", ours.images[index], test.images[index]); break; } }
        assert!(mean < 1e-3 && largest < 0.1, "{name}");
    }
}
