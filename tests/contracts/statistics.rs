//! The sampler draws from a known density: positions have the known mean and covariance.

use glam::{DMat3, DVec3};
use rand::RngExt;
use rand_distr::StandardNormal;
use trgs::numeric::rng::{self, Purpose};
use trgs::optim::Sghmc;
use trgs::optim::sghmc::{NoiseInput, Phase};

const CHAINS: usize = 4096;
const FRICTION: f64 = 2.0;

/// Mean and covariance of all chains over `steps` steps after a warm-up; energy `(x-m)ᵀP(x-m)/2`.
fn moments(rate: f64, warm_up: usize, steps: usize, mean: DVec3, precision: DMat3) -> (DVec3, DMat3) {
    let mut sampler = Sghmc::new(CHAINS);
    let mut positions = vec![[0.0; 3]; CHAINS];
    let (mut first, mut second) = (DVec3::ZERO, DMat3::ZERO);
    for step in 0..warm_up + steps {
        let slope = |x: &[f64; 3]| (precision * (DVec3::from_array(*x) - mean)).to_array();
        let gradient: Vec<_> = positions.iter().map(slope).collect();
        sampler.step(&mut positions, &gradient, rate, Phase::Sampling(FRICTION), |i| {
            let mut random = rng::stream(11, Purpose::PositionNoise, step as u64, i as u64);
            let mut normal = || random.sample(StandardNormal);
            NoiseInput { gate: 1.0, noise: DVec3::new(normal(), normal(), normal()), covariance: DMat3::ZERO }
        });
        if step >= warm_up {
            for x in positions.iter().map(|x| DVec3::from_array(*x) - mean) {
                first += x;
                second += DMat3::from_cols(x * x.x, x * x.y, x * x.z);
            }
        }
    }
    let n = (CHAINS * steps) as f64;
    (mean + first / n, second * (1.0 / n))
}

#[test]
fn the_textbook_form_samples_from_the_density_of_its_energy() {
    let mean = DVec3::new(0.3, -1.2, 2.0);
    let covariance =
        DMat3::from_cols(DVec3::new(1.0, 0.3, -0.2), DVec3::new(0.3, 0.5, 0.1), DVec3::new(-0.2, 0.1, 0.8));
    let (got_mean, got) = moments(0.05, 600, 1000, mean, covariance.inverse());
    // 4096 chains over 50 units of time with a correlation time of about one: some 10⁵ independent samples.
    within!((got_mean - mean).abs().max_element(), "{got_mean}");
    // The discretisation increases the covariance in first order of the rate.
    for (got, expected) in got.to_cols_array().into_iter().zip(covariance.to_cols_array()) {
        within!("variance", (got - expected).abs(), "{got} instead of {expected}");
    }
}

#[test]
fn the_error_of_the_covariance_falls_with_the_rate() {
    let error = |rate: f64, steps| {
        let (_, got) = moments(rate, steps / 2, steps, DVec3::ZERO, DMat3::IDENTITY);
        (got.determinant() - 1.0).abs()
    };
    let (coarse, fine) = (error(0.4, 150), error(0.1, 600));
    assert!(coarse > 2.0 * fine, "{coarse} at a rate of 0.4, {fine} at 0.1");
}
