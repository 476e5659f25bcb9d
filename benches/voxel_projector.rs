//! Cost of projecting a voxel volume, of the adjoint by both ray models, and of methods based on them.
//!
//! These are filtered backprojection and a pass of SART. 256³ voxels, 18 and 50 views of 512 × 512; 64³, 18 of 128 ×
//! 128.
//!
//! `cargo bench --bench voxel_projector`; RAYON_NUM_THREADS sets the number of threads.

use criterion::{BenchmarkId, Criterion, criterion_group, criterion_main};
use ndarray::Array3;
use std::hint::black_box;
use std::ops::ControlFlow;
use std::time::Duration;
use trgs::classical::algebraic::{SartSettings, sart};
use trgs::classical::{RayModel, Turn, VoxelProjector, Window, fdk};
use trgs::geometry::{Beam, Detector, Grid, Projections, Scanner};

fn scanner(size: usize) -> Scanner {
    let pitch = 4.0 / (2 * size) as f64;
    let detector =
        Detector { rows: 2 * size, columns: 2 * size, pitch_v: pitch, pitch_u: pitch, offset_u: 0.0, offset_v: 0.0 };
    Scanner { beam: Beam::Cone { dso: 5.0, dsd: 7.0 }, detector, grid: Grid::cube(size) }
}

fn voxels(criterion: &mut Criterion) {
    for (size, views) in [(64, 18), (256, 18), (256, 50)] {
        let scanner = scanner(size);
        let angles = Scanner::uniform_angles(views, 0.1, std::f64::consts::TAU);
        let volume = Array3::from_shape_fn((size, size, size), |(x, y, z)| ((x ^ y ^ z) % 7) as f32 / 7.0);
        let mut group = criterion.benchmark_group(format!("{size} voxels, {views} views"));
        group.sample_size(10).warm_up_time(Duration::from_millis(500)).measurement_time(Duration::from_secs(3));
        let mut images = Array3::zeros((views, 2 * size, 2 * size));
        for (name, model) in [("Joseph", RayModel::Joseph), ("Siddon", RayModel::Siddon)] {
            let projector = VoxelProjector::new(&scanner, model).expect("a scanner that works");
            images = projector.forward(&angles, volume.view()).expect("its volume");
            group.bench_function(BenchmarkId::new("forward", name), |b| {
                b.iter(|| black_box(projector.forward(&angles, volume.view())));
            });
            group.bench_function(BenchmarkId::new("adjoint", name), |b| {
                b.iter(|| black_box(projector.adjoint(&angles, images.view())));
            });
        }
        let projections = Projections::new(angles, images).expect("an image per angle");
        group.bench_function("FDK", |b| {
            b.iter(|| black_box(fdk(&scanner, &projections, Window::Hann, Turn::Measured)));
        });
        let projector = VoxelProjector::new(&scanner, RayModel::Joseph).expect("a scanner that works");
        let pass = SartSettings { iterations: 1, ..SartSettings::default() };
        group.bench_function("pass of SART", |b| {
            b.iter(|| black_box(sart::<f32>(&projector, &projections, &pass, &mut |_| ControlFlow::Continue(()))));
        });
        group.finish();
    }
}

criterion_group!(benches, voxels);
criterion_main!(benches);
