//! Stochastic gradient Hamiltonian Monte Carlo for positions: momentum, friction and noise.
//!
//! The paper names the method and follows 3D Student Splatting and Scooping, whose form is the default here: a step
//! along Adam's direction, in which only primitives of vanishing density have momentum and noise. A primitive
//! with a gate of 0 moves exactly as under Adam with the rate squared. The textbook's form (Chen, Fox & Guestrin,
//! 2014) is also available: no gate, the plain gradient, and the invariant density is `exp(-U)`.

use super::adam::remap_rows;
use crate::numeric::elementary::sigmoid;
use crate::numeric::threads;
use glam::{DMat3, DVec3};
use serde::{Deserialize, Serialize};

/// Rows of one task.
const CHUNK: usize = 256;
/// Steepness of the gate, and the fraction of the reference density at which it is half open.
const GATE: (f64, f64) = (100.0, 0.005);
/// A gate below this is set to 0: its noise would be lost in the rounding of any position.
const MIN_GATE: f64 = 1e-12;
/// An argument below which the logistic function is less than [`MIN_GATE`].
///
/// Most primitives are below it, which saves their exponentials.
const FAR: f64 = -28.0;

/// Momentum of M positions.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Sghmc {
    momentum: Vec<[f64; 3]>,
    /// Whether the momentum has been reset at the end of the burn-in.
    burnt_in: bool,
}

/// The phase of a step, with its friction C. Sampling is stable while the rate times the friction is below 2.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Phase {
    /// No momentum; the noise has the primitive's covariance. C scales the noise only.
    BurnIn(f64),
    /// With momentum; the noise is isotropic.
    Sampling(f64),
}

/// The noise of one position.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NoiseInput {
    /// From 0 (as Adam) to 1 (full momentum and noise); see [`gate`].
    pub gate: f64,
    /// Standard normal numbers.
    pub noise: DVec3,
    /// Covariance of the primitive, scene units squared; used by the burn-in only.
    pub covariance: DMat3,
}

impl NoiseInput {
    /// No momentum and no noise.
    pub const GATE_CLOSED: Self = Self { gate: 0.0, noise: DVec3::ZERO, covariance: DMat3::ZERO };
}

/// The gate of a primitive's momentum and noise: `σ(100·((1-ρ̂) - 0.995))` with `ρ̂ = min(ρ/reference, 1)`.
///
/// It is ½ at ρ̂ = 0.005, and 0 where the formula is below 1e-12.
///
/// Not in the paper: the gate of 3D Student Splatting, with densities instead of opacities. Tests:
/// `the_gate_opens_for_what_is_nearly_gone`.
pub fn gate(density: f64, reference: f64) -> f64 {
    let opened = GATE.0 * (GATE.1 - (density / reference).min(1.0));
    let open = if opened < FAR { 0.0 } else { sigmoid(opened) };
    if open < MIN_GATE { 0.0 } else { open }
}

impl Sghmc {
    /// `m` positions at rest.
    pub fn new(m: usize) -> Self {
        Self { momentum: vec![[0.0; 3]; m], burnt_in: false }
    }

    /// Continues with this momentum; `burnt_in` says that a step of [`Phase::Sampling`] was made.
    pub fn continued(momentum: Vec<[f64; 3]>, burnt_in: bool) -> Self {
        Self { momentum, burnt_in }
    }

    /// The momentum of each position.
    pub fn momentum(&self) -> &[[f64; 3]] {
        &self.momentum
    }

    /// Whether this is a state of `m` positions.
    pub fn fits(&self, m: usize) -> bool {
        self.momentum.len() == m && self.momentum.as_flattened().iter().all(|x| x.is_finite())
    }

    /// One step of `[SGHMC]` with the rate η, against `direction` ĝ; `noise_for(i)` is called once per position.
    ///
    /// | phase | |
    /// |---|---|
    /// | burn-in | `x += η·(-η·ĝ + Σ·(gate·z))`, z of variance 2ηC |
    /// | sampling | `p = gate·(1-ηC)·p - η·ĝ + gate·z`, `x += η·p`; p = 0 before the first such step |
    ///
    /// Not in the paper: it names the method. Tests: `tests/contracts/statistics.rs`, and those below.
    ///
    /// # Panics
    /// If the lengths differ.
    pub fn step(
        &mut self,
        positions: &mut [[f64; 3]],
        direction: &[[f64; 3]],
        rate: f64,
        phase: Phase,
        noise_for: impl Fn(usize) -> NoiseInput + Sync + Send,
    ) {
        let m = self.momentum.len();
        assert_eq!((positions.len(), direction.len()), (m, m), "lengths of positions and direction");
        if matches!(phase, Phase::Sampling(_)) && !self.burnt_in {
            self.momentum.fill([0.0; 3]);
            self.burnt_in = true;
        }
        let chunks = (threads::chunks(positions, CHUNK), threads::chunks(&mut self.momentum, CHUNK));
        threads::for_each_zip(chunks, |chunk, (positions, momentum)| {
            let rows = (chunk * CHUNK..).zip(&direction[chunk * CHUNK..]);
            for ((x, p), (i, g)) in positions.iter_mut().zip(momentum).zip(rows) {
                let NoiseInput { gate, noise, covariance } = noise_for(i);
                let drift = DVec3::from_array(*g) * -rate;
                let next = match phase {
                    Phase::BurnIn(friction) => drift + covariance * (noise * (gate * deviation(rate, friction))),
                    Phase::Sampling(friction) => {
                        let kept = DVec3::from_array(*p) * (gate * (1.0 - rate * friction));
                        kept + drift + noise * (gate * deviation(rate, friction))
                    }
                };
                *p = next.to_array();
                *x = (DVec3::from_array(*x) + next * rate).to_array();
            }
        });
    }

    /// Adapts to a new population: each row takes an old row's momentum, or 0.
    pub fn remap_rows(&mut self, rows: &[Option<usize>]) {
        self.momentum = remap_rows(&self.momentum, 1, rows, [0.0; 3]);
    }
}

/// Standard deviation of the noise of a step, `√(2ηC)`.
fn deviation(rate: f64, friction: f64) -> f64 {
    (2.0 * rate * friction).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tolerances::relative;

    const Z: DVec3 = DVec3::new(0.5, -1.5, 0.25);

    fn open(gate: f64) -> NoiseInput {
        NoiseInput { gate, noise: Z, covariance: DMat3::from_diagonal(DVec3::new(0.04, 0.01, 0.25)) }
    }

    #[test]
    fn the_gate_opens_for_what_is_nearly_gone() {
        within!(relative(gate(0.005, 1.0), 0.5));
        within!(relative(gate(0.0, 1.0), 1.0 / (1.0 + libm::exp(-0.5))));
        within!(relative(gate(0.1, 2.0), gate(0.05, 1.0)));
        within!("shut", gate(0.05, 1.0));
        assert!(gate(0.05, 1.0) > 0.0);
        assert_eq!((gate(0.5, 1.0), gate(40.0, 1.0)), (0.0, 0.0));
        assert!(sigmoid(FAR) < MIN_GATE && gate(0.28, 1.0) > 0.0);
    }

    #[test]
    fn a_shut_gate_is_adam_with_the_rate_squared() {
        for phase in [Phase::BurnIn(50.0), Phase::Sampling(50.0)] {
            let (mut sghmc, mut x) = (Sghmc::new(1), [[1.0, 2.0, 3.0]]);
            for _ in 0..3 {
                sghmc.step(&mut x, &[[0.5, -1.0, 2.0]], 0.1, phase, |_| NoiseInput { gate: 0.0, ..open(0.0) });
            }
            for (got, expected) in x[0].into_iter().zip([0.985, 2.03, 2.94]) {
                within!(relative(got, expected));
            }
        }
    }

    #[test]
    fn the_burn_in_forgets_and_its_noise_has_the_shape_of_the_primitive() {
        let (mut sghmc, mut x) = (Sghmc::new(1), [[0.0; 3]]);
        for steps in 1..=2 {
            sghmc.step(&mut x, &[[1.0, 0.0, 0.0]], 0.1, Phase::BurnIn(20.0), |_| open(0.5));
            // √(2·0.1·20) = 2; half open.
            let expected = [0.1 * (-0.1 + 0.04 * 0.5), 0.1 * 0.01 * -1.5, 0.1 * 0.25 * 0.25];
            for (got, expected) in x[0].into_iter().zip(expected) {
                within!(relative(got, expected * f64::from(steps)));
            }
        }
    }

    #[test]
    fn sampling_starts_at_rest_and_remembers() {
        let (mut sghmc, mut x) = (Sghmc::new(1), [[0.0; 3]]);
        sghmc.step(&mut x, &[[9.0; 3]], 0.1, Phase::BurnIn(1.0), |_| NoiseInput::GATE_CLOSED);
        let start = x[0];
        let quiet = NoiseInput { noise: DVec3::ZERO, ..open(1.0) };
        let (mut p, mut expected) = (0.0, start[0]);
        for _ in 0..4 {
            sghmc.step(&mut x, &[[1.0, 0.0, 0.0]], 0.1, Phase::Sampling(4.0), |_| quiet);
            p = p * (1.0 - 0.4) - 0.1;
            expected += 0.1 * p;
            within!(relative(x[0][0], expected));
        }
    }

    #[test]
    fn a_new_population_keeps_the_momentum_of_its_old_rows() {
        let mut sghmc = Sghmc::new(2);
        let mut x = [[0.0; 3]; 2];
        sghmc.step(&mut x, &[[1.0; 3], [2.0; 3]], 1.0, Phase::Sampling(0.5), |_| NoiseInput::GATE_CLOSED);
        sghmc.remap_rows(&[None, Some(1), Some(0)]);
        assert_eq!(sghmc.momentum, [[0.0; 3], [-2.0; 3], [-1.0; 3]]);
    }
}
