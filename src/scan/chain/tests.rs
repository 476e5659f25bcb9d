use super::*;
use crate::phantom::Phantom;
use crate::phantom::solid::{Shape, Solid};
use crate::simulate::{Object, Orbit, Plan, simulate_measured, simulate_on};
use crate::tolerances::{largest, relative};
use glam::DVec3;
use ndarray::{Axis, Slice};
use trgs_core::geometry::{Beam, Grid};
use trgs_core::numeric::reduce;

const OFF: Chain = Chain {
    depth: 0.0,
    spectrum: 0.0,
    bone: 0.5,
    scatter: 0.0,
    spread: 0.2,
    blur: 0.0,
    flat: 0.0,
    bits: 0.0,
    axis: 0.0,
};
const DETECTOR: Detector = Detector { rows: 16, columns: 21, pitch_v: 0.2, pitch_u: 0.2, offset_u: 0.0, offset_v: 0.0 };
const PLAN: Plan = Plan { views: 4, test_views: 3, noise: Noise::None, seed: 7 };

/// Views of one value each.
fn uniform(values: &[f32]) -> Projections {
    let images = Array3::from_shape_fn((values.len(), 16, 21), |(view, _, _)| values[view]);
    Projections::new((0..values.len()).map(|view| view as f64).collect(), images).unwrap()
}

fn measured(chain: &Chain, views: &Projections, noise: Noise) -> Array3<f64> {
    chain.measure(&DETECTOR, views, None, noise, 7).unwrap().mapv(f64::from)
}

fn scanner() -> Scanner {
    Scanner { beam: Beam::Parallel { dso: 4.0 }, detector: DETECTOR, grid: Grid::cube(24) }
}

fn torso() -> Phantom {
    Phantom::by_name("torso", 0).unwrap()
}

#[test]
fn without_any_part_line_integrals_stay() {
    let phantom = torso();
    let scan = |chain: &Chain| {
        simulate_measured("scan", Object::Phantom(&phantom), &scanner(), &PLAN, &Orbit::CIRCLE, chain).unwrap()
    };
    let ideal = simulate_on("scan", Object::Phantom(&phantom), &scanner(), &PLAN, &Orbit::CIRCLE).unwrap();
    let error = &scan(&OFF).train.images - &ideal.train.images;
    within!(largest(error.iter().map(|&e| f64::from(e))));
    // A depth alone changes the unit of attenuation, and back.
    let error = &scan(&Chain { depth: 4.0, ..OFF }).train.images - &ideal.train.images;
    within!(largest(error.iter().map(|&e| f64::from(e))));
}

/// -ln Σ w_k exp(-4 μ(E_k)/μ(60)) and Σ w_k μ(E_k)/μ(60), of water and of bone, by another program.
const HARDENED: [(f64, f64); 2] = [(4.018422943741998, 1.0474502185526955), (3.611641666276672, 1.2102287166454893)];

#[test]
fn a_cylinder_hardens_the_beam_as_computed() {
    let cylinder = Solid::new(Shape::Cylinder, 0.8, DVec3::ZERO, DVec3::new(0.7, 0.7, 0.9));
    let phantom = Phantom { name: "cylinder".into(), solids: vec![cylinder] };
    let ideal = phantom.project(&scanner(), &[0.0]).unwrap();
    let chain = Chain { depth: 4.0, spectrum: 1.0, ..OFF };
    for (dense, (thickest, slope)) in [None, Some(&ideal)].into_iter().zip(HARDENED) {
        let found = chain.measure(&DETECTOR, &ideal, dense, Noise::None, 0).unwrap();
        let peak = |images: &Array3<f32>| f64::from(images.iter().fold(0.0_f32, |peak, &p| peak.max(p)));
        let scale = 4.0 / peak(&ideal.images);
        within!(relative(scale * peak(&found), thickest), "{} instead of {thickest}", scale * peak(&found));
        // All others are between it and the linear law of thin parts.
        let hit = found.iter().zip(&ideal.images).filter(|(_, q)| **q > 0.0);
        let ratios: Vec<f64> = hit.map(|(&p, &q)| f64::from(p) / f64::from(q)).collect();
        within!("linear law", ratios.iter().map(|ratio| ratio - slope).fold(f64::MIN, f64::max));
        within!("thickest", ratios.iter().map(|ratio| thickest / 4.0 - ratio).fold(f64::MIN, f64::max));
    }
}

#[test]
fn the_dense_part_is_what_the_fraction_of_the_largest_density_says() {
    let volume =
        Volume::new(Grid::cube(2), Array3::from_shape_fn((2, 2, 2), |(x, y, z)| (4 * x + 2 * y + z) as f32)).unwrap();
    let dense = |chain: Chain| chain.dense_part(&volume).map(|dense| dense.values.iter().copied().collect::<Vec<_>>());
    assert_eq!(dense(Chain { spectrum: 1.0, bone: 0.7, ..OFF }).unwrap(), [0.0, 0.0, 0.0, 0.0, 0.0, 5.0, 6.0, 7.0]);
    assert_eq!(dense(OFF), None);
}

#[test]
fn scatter_lowers_line_integrals_as_computed() {
    let chain = Chain { scatter: 0.2, ..OFF };
    let found = measured(&chain, &uniform(&[0.0, 0.7, 4.0]), Noise::None);
    for (view, p) in [0.0, f64::from(0.7_f32), 4.0].into_iter().enumerate() {
        let expected = p - log(1.0 + 0.2 * p);
        let error = found.index_axis(Axis(0), view).iter().map(|p| p - expected).collect::<Vec<_>>();
        within!(largest(error), "{p}");
    }
    // Far from an object there is less of it.
    let mut views = uniform(&[0.0]);
    views.images.slice_axis_mut(Axis(2), Slice::from(..5)).fill(1.0);
    let found = measured(&Chain { spread: 0.1, ..chain }, &views, Noise::None);
    assert!(found[[0, 8, 5]] < found[[0, 8, 8]] && found[[0, 8, 8]] < found[[0, 8, 12]] && found[[0, 8, 20]] == 0.0);
}

#[test]
fn blur_keeps_the_sum_and_has_its_width() {
    for at in [[8, 10], [0, 20], [15, 3]] {
        let mut image = vec![0.0; 16 * 21];
        image[at[0] * 21 + at[1]] = 3.0;
        for sigma in [0.7, 1.1, 30.0] {
            let image = blurred(image.clone(), [16, 21], [sigma; 2]);
            within!("sum", relative(reduce::sum_by(image.len(), &|i| image[i]), 3.0));
            if sigma < 2.0 && at == [8, 10] {
                let moment = |i: usize| image[i] * ((i % 21) as f64 - 10.0) * ((i % 21) as f64 - 10.0);
                within!("variance", relative(reduce::sum_by(image.len(), &moment) / 3.0, sigma * sigma));
            }
        }
    }
    assert_eq!(blurred(vec![1.0, 2.0], [1, 2], [0.0; 2]), [1.0, 2.0]);
    // The measured intensities have the sum of the ideal ones.
    let mut views = uniform(&[0.0]);
    views.images[[0, 3, 4]] = 2.0;
    let sum = |images: Array3<f64>| images.iter().map(|&p| exp(-p)).sum::<f64>();
    let blurred = measured(&Chain { blur: 1.0, ..OFF }, &views, Noise::None);
    assert!(0.0 < blurred[[0, 3, 5]] && blurred[[0, 3, 5]] < blurred[[0, 3, 4]] && blurred[[0, 3, 4]] < 2.0);
    within!("measured", relative(sum(blurred), sum(views.images.mapv(f64::from))));
}

#[test]
fn readings_are_whole_steps_and_half_a_step_off_at_most() {
    let values: Vec<f32> = (0..60).map(|i| 0.1 * i as f32).collect();
    let step = FULL_SCALE / exp2(8.0);
    let found = measured(&Chain { bits: 8.0, ..OFF }, &uniform(&values), Noise::None);
    for (view, &p) in values.iter().enumerate() {
        let (reading, intensity) = (exp(-found[[view, 0, 0]]), exp(-f64::from(p)));
        within!("half a step", (reading - intensity).abs() / step);
        // Below half a step the reading is that half.
        let steps = reading / step;
        within!("whole", (steps - steps.round()).abs().min((steps - 0.5).abs()), "{steps}");
    }
    // A bright pixel has the largest reading.
    let bright = measured(&Chain { bits: 8.0, ..OFF }, &uniform(&[-3.0]), Noise::None);
    within!("largest", relative(exp(-bright[[0, 0, 0]]), FULL_SCALE));
}

#[test]
fn the_error_of_the_flat_field_is_the_same_in_all_views() {
    let chain = Chain { flat: 0.02, ..OFF };
    let found = measured(&chain, &uniform(&[0.0, 1.0, 3.0]), Noise::None);
    let error = |view: usize, ideal: f64| found.index_axis(Axis(0), view).mapv(|p| p - ideal);
    within!("repeated", largest((error(0, 0.0) - error(2, 3.0)).iter().copied()));
    // Four standard errors of the deviation of 336 normal numbers are 0.16 of it.
    within!("deviation", relative(error(1, 1.0).std(1.0), 0.02));
    let other = chain.measure(&DETECTOR, &uniform(&[0.0]), None, Noise::None, 8).unwrap();
    assert_ne!(f64::from(other[[0, 0, 0]]), found[[0, 0, 0]]);
}

#[test]
fn photons_and_electronic_noise_follow_the_depth() {
    let noise = Noise::relative(1e4, 20.0);
    let found = measured(&Chain { depth: 3.0, ..OFF }, &uniform(&[0.5, 1.5]), noise);
    for (view, depth) in [1.0, 3.0].into_iter().enumerate() {
        let counts = 1e4 * exp(-depth);
        // In the unit of the scan, where 3 is 1.5.
        let expected = (counts + 400.0).sqrt() / counts / 2.0;
        within!(relative(found.index_axis(Axis(0), view).std(1.0), expected));
    }
    let refused = OFF.measure(&DETECTOR, &uniform(&[1.0]), None, noise.physical(), 0).unwrap_err().to_string();
    assert!(refused.contains("10000,20,physical") && refused.contains("depth=0"), "{refused}");
    // Nothing passes: the floor.
    let dark = measured(&OFF, &uniform(&[900.0]), Noise::relative(1e4, 0.0));
    within!("floor", relative(dark[[0, 0, 0]], -log(FLOOR / 1e4)));
}

#[test]
fn a_measured_scan_has_ideal_test_views_and_says_so() {
    let phantom = torso();
    let helix = Orbit { turns: 2.0, pitch: 0.2, roll: 0.02, axis_shift: 0.1 };
    for orbit in [Orbit::CIRCLE, helix] {
        let scan = |plan: &Plan| {
            simulate_measured("scan", Object::Phantom(&phantom), &scanner(), plan, &orbit, &Chain::default()).unwrap()
        };
        let plan = Plan { noise: Noise::LOW, ..PLAN };
        let ideal = simulate_on("scan", Object::Phantom(&phantom), &scanner(), &PLAN, &orbit).unwrap();
        let found = scan(&plan);
        assert_eq!((&found.test, &found.truth), (&ideal.test, &ideal.truth));
        assert_eq!((&found.train.angles, &found.train.poses), (&ideal.train.angles, &ideal.train.poses));
        assert!(found.train.images != ideal.train.images && found.noise == Noise::LOW);
        assert!(found.notes[0].contains("simulated measurements (axis=0.3,depth=4,"), "{:?}", found.notes);
        let again = trgs_core::numeric::threads::install(1, || scan(&plan)).unwrap();
        assert_eq!(again, found);
        assert_ne!(scan(&Plan { seed: 8, ..plan }).train, found.train);
    }
}

#[test]
fn the_axis_is_off_by_pixels_of_the_detector() {
    let chain = Chain { axis: 2.0, ..OFF };
    let cone = Scanner { beam: Beam::Cone { dso: 5.0, dsd: 8.0 }, ..scanner() };
    let phantom = torso();
    let image = |scanner: &Scanner, chain: &Chain| {
        let plan = Plan { views: 1, ..PLAN };
        simulate_measured("scan", Object::Phantom(&phantom), scanner, &plan, &Orbit::CIRCLE, chain)
            .unwrap()
            .train
            .images
    };
    // In parallel rays the whole image moves; the axis itself does in a cone.
    let (stated, moved) = (image(&scanner(), &OFF), image(&scanner(), &chain));
    let error = &moved.slice_axis(Axis(2), Slice::from(..19)) - &stated.slice_axis(Axis(2), Slice::from(2..));
    within!("parallel", largest(error.iter().map(|&e| f64::from(e))));
    within!("cone", relative(chain.axis_shift(&cone), 2.0 * 0.2 * 5.0 / 8.0));
    assert!(image(&cone, &chain) != image(&cone, &OFF));
}

#[test]
fn parts_are_set_by_name() {
    let chain: Chain = "scatter=0.25, axis = 0,bits=12".parse().unwrap();
    assert_eq!(chain, Chain { scatter: 0.25, axis: 0.0, bits: 12.0, ..Chain::default() });
    assert_eq!("".parse::<Chain>().unwrap(), Chain::default());
    assert_eq!(chain.to_string().parse::<Chain>().unwrap(), chain);
    for (bad, words) in [
        ("scater=1", "scatter, spread, blur"),
        ("scatter", "scatter: got , expected a number from 0 to 1"),
        ("scatter=2", "got 2, expected a number from 0 to 1: scattered part"),
        ("bits=1.5", "a whole number from 0 to 32"),
        ("blur=nan", "give blur=0.7"),
    ] {
        let message = bad.parse::<Chain>().unwrap_err().to_string();
        assert!(message.contains(words), "{bad}: {message}");
    }
}
