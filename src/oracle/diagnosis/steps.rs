//! Adam with one mistake.

use super::Suspect;
use crate::question::Question;
use ndarray::{Array2, ArrayD, Ix2};
use trgs_core::error::Result;

/// Adam with changes.
#[derive(Clone, Copy)]
struct Adam {
    beta: [f64; 2],
    epsilon: f64,
    /// Bias correction of m and v.
    corrected: [bool; 2],
    /// Steps by which the correction is ahead.
    ahead: i32,
    /// ε under the root.
    inside: bool,
    /// The largest v so far.
    largest: bool,
    /// Weight decay, apart from the gradient (AdamW) or added to it.
    decay: [f64; 2],
    /// Nesterov's momentum.
    nesterov: bool,
    /// |g| for g² in v, and no root.
    absolute: bool,
}

/// Suspects of the stage `adam`.
pub(super) fn adam(q: &Question) -> Result<Vec<Suspect>> {
    let (start, gradients, rates) = (q.numbers("start")?, q.array::<Ix2>("gradients")?, q.numbers("rates")?);
    let beta = [q.setting("beta1")?, q.setting("beta2")?];
    let right = Adam {
        beta,
        epsilon: q.setting("epsilon")?,
        corrected: [true; 2],
        ahead: 0,
        inside: false,
        largest: false,
        decay: [0.0; 2],
        nesterov: false,
        absolute: false,
    };
    let variants = [
        ("Adam without bias correction", Adam { corrected: [false; 2], ..right }),
        ("Adam without bias correction of m", Adam { corrected: [false, true], ..right }),
        ("Adam without bias correction of v", Adam { corrected: [true, false], ..right }),
        ("Adam with a bias correction that is one step ahead", Adam { ahead: 1, ..right }),
        ("Adam with ε inside of the root", Adam { inside: true, ..right }),
        ("Adam with ε = 1e-8", Adam { epsilon: 1e-8, ..right }),
        ("Adam with ε = 1e-8 inside of the root", Adam { epsilon: 1e-8, inside: true, ..right }),
        ("Adam with ε = 1e-7", Adam { epsilon: 1e-7, ..right }),
        ("Adam with β₁ and β₂ exchanged", Adam { beta: [beta[1], beta[0]], ..right }),
        ("Adam with β₂ = 0.99", Adam { beta: [beta[0], 0.99], ..right }),
        ("AMSGrad: the largest v so far", Adam { largest: true, ..right }),
        ("AdamW with a weight decay of 0.01", Adam { decay: [0.01, 0.0], ..right }),
        ("Adam with a weight decay of 0.01 in the gradient", Adam { decay: [0.0, 0.01], ..right }),
        ("NAdam: Nesterov's momentum", Adam { nesterov: true, ..right }),
        ("|g| for g² and no root", Adam { absolute: true, ..right }),
    ];
    let run = |rule: Adam| trajectory(rule, &start, &gradients, &rates);
    let mut all: Vec<Suspect> = variants.into_iter().map(|(name, rule)| Suspect::exactly(name, run(rule))).collect();
    let constant = vec![rates[0]; rates.len()];
    all.push(Suspect::exactly("the first rate in all steps", trajectory(right, &start, &gradients, &constant)));
    Ok(all)
}

fn trajectory(rule: Adam, start: &[f64], gradients: &Array2<f64>, rates: &[f64]) -> ArrayD<f64> {
    let mut result = Array2::zeros(gradients.raw_dim());
    for (k, &first) in start.iter().enumerate() {
        let (mut x, mut m, mut v, mut top) = (first, 0.0, 0.0, 0.0_f64);
        for (t, rate) in rates.iter().enumerate() {
            let [b1, b2] = rule.beta;
            let g = gradients[[t, k]] + rule.decay[1] * x;
            (m, v) = (b1 * m + (1.0 - b1) * g, b2 * v + (1.0 - b2) * if rule.absolute { g.abs() } else { g * g });
            top = top.max(v);
            let step = t as i32 + 1 + rule.ahead;
            let correction =
                |k: usize| if rule.corrected[k] { 1.0 - libm::pow(rule.beta[k], f64::from(step)) } else { 1.0 };
            let square = if rule.largest { top } else { v } / correction(1);
            let mut mean = m / correction(0);
            if rule.nesterov {
                mean = b1 * m / (1.0 - libm::pow(b1, f64::from(step + 1))) + (1.0 - b1) * g / correction(0);
            }
            let root = match (rule.absolute, rule.inside) {
                (true, _) => square + rule.epsilon,
                (_, true) => (square + rule.epsilon).sqrt(),
                _ => square.sqrt() + rule.epsilon,
            };
            x -= rate * (mean / root + rule.decay[0] * x);
            result[[t, k]] = x;
        }
    }
    result.into_dyn()
}

#[cfg(test)]
mod tests {
    use super::super::of_part;
    use super::*;
    use crate::answers::answer;
    use crate::format::Format;
    use crate::manifest::Vectors;
    use trgs_core::numeric::Precision;

    #[test]
    fn each_mistake_is_named_alone() {
        let vectors = Vectors::embedded().unwrap();
        let case = vectors.manifest.cases.iter().find(|case| case.id == "adam/random").unwrap();
        let q = Question::new(&vectors, case).unwrap();
        let right = answer(&q, Precision::F64).unwrap().remove("trajectory").unwrap().remove("").unwrap();
        for suspect in adam(&q).unwrap() {
            let found = of_part(&q, ("trajectory", ""), &right, &suspect.array, Format::F64, 1e-14);
            // ε inside of the root is 1e-15 here: rounding in this case.
            let expected = Some(suspect.name.as_str()).filter(|&name| name != "Adam with ε inside of the root");
            assert_eq!(found.as_deref(), expected);
        }
        // Mistakes that are not in the catalogue: no name.
        let (start, gradients, rates) =
            (q.numbers("start").unwrap(), q.array::<Ix2>("gradients").unwrap(), q.numbers("rates").unwrap());
        for (beta, epsilon) in [([0.85, 0.999], 1e-15), ([0.9, 0.98], 1e-15), ([0.9, 0.999], 1e-4)] {
            let rule = Adam {
                beta,
                epsilon,
                corrected: [true; 2],
                ahead: 0,
                inside: false,
                largest: false,
                decay: [0.0; 2],
                nesterov: false,
                absolute: false,
            };
            let wrong = trajectory(rule, &start, &gradients, &rates);
            assert_eq!(of_part(&q, ("trajectory", ""), &right, &wrong, Format::F64, 1e-14), None, "{beta:?} {epsilon}");
        }
    }
}
