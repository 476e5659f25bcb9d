//! Adam (Kingma & Ba, 2015), with bias correction. Not in the paper: it names the method only.

use crate::numeric::threads;

/// Numbers updated together.
const CHUNK: usize = 8192;

/// Moments of one array of parameters.
#[derive(Clone, Debug, PartialEq)]
pub struct Adam {
    beta: [f64; 2],
    epsilon: f64,
    steps: u32,
    /// First and second moment of each number.
    moments: Vec<[f64; 2]>,
}

impl Adam {
    /// Zero moments for `n` numbers.
    pub fn new(n: usize, beta: [f64; 2], epsilon: f64) -> Self {
        Self { beta, epsilon, steps: 0, moments: vec![[0.0; 2]; n] }
    }

    /// `θ -= rate · m̂ / (√v̂ + ε)`.
    ///
    /// # Panics
    /// If an array does not have the length the optimiser was made for.
    pub fn step(&mut self, parameters: &mut [f64], gradient: &[f64], rate: f64) {
        assert_eq!(
            (parameters.len(), gradient.len()),
            (self.moments.len(), self.moments.len()),
            "lengths of parameters and gradient"
        );
        self.steps += 1;
        let [beta1, beta2] = self.beta;
        let correction = [1.0 - power(beta1, self.steps), 1.0 - power(beta2, self.steps)];
        let epsilon = self.epsilon;
        let mut work: Vec<_> =
            parameters.chunks_mut(CHUNK).zip(self.moments.chunks_mut(CHUNK)).zip(gradient.chunks(CHUNK)).collect();
        threads::for_each_chunk(&mut work, 1, |_, work| {
            let ((parameters, moments), gradient) = &mut work[0];
            for ((parameter, [m, v]), &g) in parameters.iter_mut().zip(moments.iter_mut()).zip(gradient.iter()) {
                *m = beta1 * *m + (1.0 - beta1) * g;
                *v = beta2 * *v + (1.0 - beta2) * (g * g);
                *parameter -= rate * (*m / correction[0]) / ((*v / correction[1]).sqrt() + epsilon);
            }
        });
    }
}

/// `base^n` by repeated squaring: the same bits everywhere.
fn power(base: f64, mut n: u32) -> f64 {
    let (mut square, mut product) = (base, 1.0);
    while n > 0 {
        if n & 1 == 1 {
            product *= square;
        }
        square *= square;
        n >>= 1;
    }
    product
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_first_step_has_the_length_of_the_rate_whatever_the_gradient() {
        let mut parameters = [1.0, 1.0, 1.0];
        Adam::new(3, [0.9, 0.999], 1e-15).step(&mut parameters, &[1e-9, -3.0, 1e6], 0.01);
        for (got, expected) in parameters.iter().zip([0.99, 1.01, 0.99]) {
            approx::assert_relative_eq!(*got, expected, max_relative = 1e-7);
        }
    }

    #[test]
    fn ten_steps_follow_the_published_recurrence() {
        let (mut parameters, mut adam) = ([3.3], Adam::new(1, [0.9, 0.999], 1e-15));
        let (mut x, mut m, mut v) = (3.3_f64, 0.0_f64, 0.0_f64);
        for t in 1..=10 {
            let g = 2.0 * x + 0.1 * f64::from(t);
            m = 0.9 * m + 0.1 * g;
            v = 0.999 * v + 0.001 * g * g;
            let g_ours = [2.0 * parameters[0] + 0.1 * f64::from(t)];
            x -= 0.05 * (m / (1.0 - libm::pow(0.9, f64::from(t))))
                / ((v / (1.0 - libm::pow(0.999, f64::from(t)))).sqrt() + 1e-15);
            adam.step(&mut parameters, &g_ours, 0.05);
            approx::assert_relative_eq!(parameters[0], x, max_relative = 1e-12);
        }
    }

    #[test]
    fn a_zero_gradient_moves_nothing() {
        let mut parameters = [1.5];
        Adam::new(1, [0.9, 0.999], 1e-15).step(&mut parameters, &[0.0], 0.1);
        assert_eq!(parameters, [1.5]);
    }

    #[test]
    fn powers_by_squaring_are_powers() {
        for n in [1, 2, 3, 7, 100, 5000] {
            approx::assert_relative_eq!(power(0.999, n), libm::pow(0.999, f64::from(n)), max_relative = 1e-12);
        }
    }
}
