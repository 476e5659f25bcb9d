//! The target of ν, a function of the confidence, and the loss that attracts ν to it.

use super::Settings;
use crate::numeric::elementary::{logit, sigmoid};
use crate::numeric::exponentials::log;
use crate::numeric::vectors::{LANES, f64x8};
use crate::numeric::{Lanes, reduce, threads};
use crate::primitives::activation::Interval;

/// Primitives of one task.
const CHUNK: usize = 1024;

/// Target degrees of freedom `ν_min + (ν_max - ν_min)·σ(logit(c)/T)` `[Eq. 9]` for a confidence c in [0, 1].
///
/// c is first moved half a point of the sphere away from 0 and 1, to [1/(2N), 1 - 1/(2N)]: its logit is finite, and the
/// target within the interval. Half a sphere gives the middle of the interval for every T.
///
/// Tests: `targets_are_those_computed_by_hand`, `the_target_grows_with_the_confidence`.
pub fn nu_target(confidence: f64, settings: &Settings, nu: Interval) -> f64 {
    let half_a_point = 0.5 / settings.sphere_points as f64;
    let c = confidence.clamp(half_a_point, 1.0 - half_a_point);
    nu.min + (nu.max - nu.min) * sigmoid(logit(c) / settings.temperature)
}

/// Value and gradient to ν, `[M]`, of `L = (1/M) Σ λ(1-c)(ln ν - ln ν_target)²` `[Eq. 10]`, λ the weight.
///
/// Confidence and target are constants: `∂L/∂ν = 2λ(1-c)(ln ν - ln ν_target)/(νM)`. Without primitives the loss is 0.
/// Not in the paper: its weight ω(c), here 1-c.
///
/// Tests: `value_and_gradient_of_the_loss_are_those_computed_by_hand`, `gradient_of_the_loss_matches_central_differences`.
///
/// # Panics
/// When the three arrays differ in length.
pub fn nu_loss(nu: &[f64], target: &[f64], confidence: &[f64], weight: f64) -> (f64, Vec<f64>) {
    let mut gradient = Vec::new();
    let value = nu_loss_into(nu, target, confidence, weight, &mut gradient);
    (value, gradient)
}

/// [`nu_loss`] `[Eq. 10]` with the gradient written to an existing array.
pub fn nu_loss_into(nu: &[f64], target: &[f64], confidence: &[f64], weight: f64, gradient: &mut Vec<f64>) -> f64 {
    let m = nu.len();
    assert_eq!((target.len(), confidence.len()), (m, m), "targets and confidences of {m} primitives");
    let count = m.max(1) as f64;
    gradient.resize(m, 0.0);
    // The array holds distances first, then slopes.
    threads::for_each_chunk(gradient, CHUNK, |chunk, distance| {
        for (first, distance) in (chunk * CHUNK..).step_by(LANES).zip(distance.chunks_mut(LANES)) {
            let logs = |of: &[f64]| log(f64x8::from_fn(|i| of[(first + i).min(m - 1)]));
            let found = (logs(nu) - logs(target)).to_array();
            distance.copy_from_slice(&found[..distance.len()]);
        }
    });
    let weight_of = |i: usize| weight * (1.0 - confidence[i]);
    let value = reduce::sum_by(m, &|i| weight_of(i) * gradient[i] * gradient[i]);
    gradient.iter_mut().enumerate().for_each(|(i, slope)| *slope = 2.0 * weight_of(i) * *slope / (nu[i] * count));
    value / count
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tolerances::relative;

    const RANGE: Interval = Interval { min: 2.0, max: 100.0 };

    fn target(c: f64, temperature: f64) -> f64 {
        nu_target(c, &Settings { temperature, sphere_points: 8, ..Settings::default() }, RANGE)
    }

    #[test]
    fn targets_are_those_computed_by_hand() {
        // σ(logit(c)·4) = c⁴/(c⁴ + (1-c)⁴): 81/82 at ¾, and 1/(1+15⁴) where 0 has become 1/16.
        within!(relative(target(0.75, 0.25), 2.0 + 98.0 * 81.0 / 82.0));
        within!(relative(target(0.0, 0.25), 2.0 + 98.0 / 50626.0));
        within!(relative(target(1.0, 0.25), 2.0 + 98.0 * 50625.0 / 50626.0));
        // With T = 1 the fraction is c itself, with T = ½ it is c²/(c² + (1-c)²).
        within!(relative(target(0.3, 1.0), 2.0 + 98.0 * 0.3));
        within!(relative(target(0.25, 0.5), 2.0 + 9.8));
        for temperature in [0.1, 0.25, 1.0] {
            within!(relative(target(0.5, temperature), 51.0));
        }
    }

    #[test]
    fn the_target_grows_with_the_confidence() {
        let targets: Vec<f64> = (0..=8).map(|k| target(f64::from(k) / 8.0, 0.25)).collect();
        assert!(targets.windows(2).all(|pair| pair[0] < pair[1]), "{targets:?}");
        assert!(targets[0] > RANGE.min && targets[8] < RANGE.max, "{targets:?}");
    }

    #[test]
    fn a_sharp_temperature_stays_finite() {
        assert_eq!(target(0.0, 1e-6), RANGE.min);
        assert_eq!(target(1.0, 1e-6), RANGE.max);
    }

    #[test]
    fn value_and_gradient_of_the_loss_are_those_computed_by_hand() {
        // Distances ln 2, -ln 4 and ln 3; the last weighs nothing.
        let (value, gradient) = nu_loss(&[6.0, 5.0, 9.0], &[3.0, 20.0, 3.0], &[0.25, 0.5, 1.0], 0.1);
        let ln2 = std::f64::consts::LN_2;
        within!(relative(value, 0.1 * (0.75 + 0.5 * 4.0) * ln2 * ln2 / 3.0));
        within!(relative(gradient[0], 2.0 * 0.075 * ln2 / 18.0));
        within!(relative(gradient[1], -2.0 * 0.05 * 2.0 * ln2 / 15.0));
        assert_eq!(gradient[2], 0.0);
    }

    #[test]
    fn no_primitives_cost_nothing() {
        assert_eq!(nu_loss(&[], &[], &[], 1.0), (0.0, vec![]));
    }

    #[test]
    fn gradient_of_the_loss_matches_central_differences() {
        let nu: Vec<f64> = (0..70).map(|i| 2.1 + 1.3 * f64::from(i)).collect();
        let confidence: Vec<f64> = (0..70).map(|i| f64::from(i * 29 % 70) / 70.0).collect();
        let target: Vec<f64> = confidence.iter().map(|&c| target(c, 0.25)).collect();
        let (_, gradient) = nu_loss(&nu, &target, &confidence, 0.3);
        for i in 0..nu.len() {
            let moved = |by: f64| {
                let mut nu = nu.clone();
                nu[i] += by;
                nu_loss(&nu, &target, &confidence, 0.3).0
            };
            let difference = (moved(1e-4) - moved(-1e-4)) / 2e-4;
            within!((gradient[i] - difference).abs(), "{i}: {} against {difference}", gradient[i]);
        }
    }
}
