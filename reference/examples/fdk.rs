//! Filtered backprojection (FDK) of a scan, without the rest of a run.
//!
//!     cargo run --release --example fdk -- SCAN volume.nii.gz
//!
//! Without arguments: a simulated scan of a phantom.

use trgs::classical::{Turn, Window, fdk};
use trgs::evaluation::psnr_3d;
use trgs::scan::simulate::{Object, Plan, simulate};
use trgs::scan::{Noise, Phantom};
use trgs::{Dataset, Scanner};

fn main() -> trgs::Result<()> {
    let mut arguments = std::env::args().skip(1);
    let scan = match arguments.next() {
        Some(path) => Dataset::read(path)?,
        None => phantom()?,
    };

    // Hann damps the noise that the ramp filter amplifies; ram-lak, the plain ramp, is the sharpest.
    for window in [Window::RamLak, Window::Hann] {
        let volume = fdk(&scan.scanner, &scan.train, window, Turn::Measured)?;
        let size = volume.grid.shape;
        match &scan.truth {
            Some(truth) => {
                let psnr = psnr_3d(truth.values.view(), volume.values.view());
                println!("{window:?}: {size:?} voxels, {:.2} dB ({})", psnr.value, psnr.definition);
            }
            None => println!("{window:?}: {size:?} voxels"),
        }
    }
    let volume = fdk(&scan.scanner, &scan.train, Window::Hann, Turn::Measured)?;
    arguments.next().map_or(Ok(()), |path| trgs::write_volume(path, &volume, &scan.frame))
}

/// Ninety noisy views of a torso in 64³ voxels.
fn phantom() -> trgs::Result<Dataset> {
    let plan = Plan { views: 90, test_views: 0, noise: Noise::LOW, seed: 0 };
    let torso = Phantom::by_name("torso", 0)?;
    simulate("torso", Object::Phantom(&torso), &Scanner::synthetic(64, 96), &plan)
}
