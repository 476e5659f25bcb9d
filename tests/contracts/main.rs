//! The contracts of the library, one module each.

#[macro_use]
#[path = "../common/tolerances.rs"]
mod tolerances;
#[path = "../common/mod.rs"]
mod common;
mod damage;

// Backward passes are transposes of forward passes.
mod adjoint;
// Values against 50-digit truth.
mod analytic;
// No circle of imports between files.
mod circles;
// Methods on voxels against exact chords and phantoms.
mod classical;
// The register of equations has no gap.
mod completeness;
// Three default runs against committed PSNR.
mod defaults;
// A NumPy backend: export, answers and check.
mod example_backend;
// Extreme but allowed numbers give finite results.
mod extremes;
// Gradients against central differences.
mod finite_differences;
// Odd volumes and the table of them.
mod formats;
// Gradients against 50-digit central differences.
mod gradients;
mod hostile;
// Symmetries of the scene.
mod invariance;
// SIMD lanes against plain numbers, bit by bit.
mod lanes;
// Conformance vectors and their judge.
mod oracle;
// The tables of the paper as data.
mod paper;
// Fast path against the naive twin.
mod parity;
// Views with poses.
mod poses;
// The page for authors of other backends.
mod protocol;
// Volumes and projections of other programs.
mod real_data;
// Rules that a compiler does not check.
mod repository;
// Equal fields written in different ways.
mod representation;
// Arbitrary bytes in every reader.
mod robustness;
// Positions drawn by the sampler.
mod statistics;
// The table of tolerances.
mod tolerance_rows;
// Training as a whole.
mod training;
// Wavelet loss through the voxels of a block.
mod wavelet;

/// The folder of the repository.
fn root() -> std::path::PathBuf {
    env!("CARGO_MANIFEST_DIR").into()
}
