//! Methods on voxels against exact results: chords of spheres, and phantoms from few views.

use std::ops::ControlFlow;
use trgs::classical::algebraic::{AsdPocsSettings, Order, SartSettings, asd_pocs, cgls, sart};
use trgs::classical::{RayModel, Turn, VoxelProjector, Window, fdk};
use trgs::evaluation::psnr_3d;
use trgs::geometry::{Beam, Detector, Grid, Scanner};
use trgs::numeric::reduce;
use trgs::scan::phantom::solid::{Shape, Solid};
use trgs::scan::simulate::{Object, Plan, simulate};
use trgs::scan::{Noise, Phantom};

fn scanner(size: usize) -> Scanner {
    let (pixels, pitch) = (2 * size, 4.0 / (2 * size) as f64);
    let detector =
        Detector { rows: pixels, columns: pixels, pitch_v: pitch, pitch_u: pitch, offset_u: 0.0, offset_v: 0.0 };
    Scanner { beam: Beam::Cone { dso: 5.0, dsd: 7.0 }, detector, grid: Grid::cube(size) }
}

#[test]
fn chords_of_a_sphere_are_found_to_six_thousandths() {
    let scanner = scanner(256);
    let centre = glam::DVec3::new(0.05, -0.03, 0.08);
    let ball = Solid::new(Shape::Ellipsoid, 1.0, centre, glam::DVec3::splat(0.7));
    let phantom = Phantom { name: "ball".into(), solids: vec![ball] };
    let volume = phantom.voxelize(&scanner.grid, 2).values;
    let angles = [0.4];
    let exact = phantom.project(&scanner, &angles).unwrap().images;
    for model in [RayModel::Joseph, RayModel::Siddon] {
        let found = VoxelProjector::new(&scanner, model).unwrap().forward(&angles, volume.view()).unwrap();
        let (found, exact) = (found.as_slice().unwrap(), exact.as_slice().unwrap());
        let hit: Vec<usize> = (0..exact.len()).filter(|&i| exact[i] > 0.0).collect();
        let squares = |f: &dyn Fn(usize) -> f32| {
            reduce::sum_by(hit.len(), &|k| {
                let value = f64::from(f(hit[k]));
                value * value
            })
        };
        let error = (squares(&|i| found[i] - exact[i]) / squares(&|i| exact[i])).sqrt();
        match model {
            RayModel::Joseph => within!("Joseph", error),
            RayModel::Siddon => within!("Siddon", error),
        }
    }
}

#[test]
fn few_views_are_better_used_by_iterations_than_by_filtering() {
    let scanner = scanner(32);
    let plan = Plan { views: 12, test_views: 0, noise: Noise::LOW, seed: 5 };
    let phantom = Phantom::by_name("torso", 0).unwrap();
    let scan = simulate("torso", Object::Phantom(&phantom), &scanner, &plan).unwrap();
    let projector = VoxelProjector::new(&scanner, RayModel::Joseph).unwrap();
    let truth = scan.truth.unwrap().values;
    let mut go_on = |_: &_| ControlFlow::Continue(());
    let filtered = fdk(&scanner, &scan.train, Window::RamLak, Turn::Measured).unwrap();
    let psnr = |volume: &trgs::geometry::Volume| psnr_3d(truth.view(), volume.values.view()).value;
    let base = psnr(&filtered);
    let subsets = SartSettings { subset: 4, order: Order::AngularDistance, ..SartSettings::default() };
    for (name, volume) in [
        ("SART", sart::<f32>(&projector, &scan.train, &SartSettings::default(), &mut go_on).unwrap()),
        ("OS-SART", sart::<f32>(&projector, &scan.train, &subsets, &mut go_on).unwrap()),
        ("ASD-POCS", asd_pocs::<f32>(&projector, &scan.train, &AsdPocsSettings::default(), &mut go_on).unwrap()),
        ("CGLS", cgls::<f32>(&projector, &scan.train, 12, &mut go_on).unwrap()),
    ] {
        let found = psnr(&volume);
        eprintln!("{name}: {found:.2} dB, FDK {base:.2} dB");
        assert!(found > base + 2.0, "{name}: {found} dB, FDK {base} dB");
    }
}
