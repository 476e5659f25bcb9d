//! Adam (Kingma & Ba, 2015), with bias correction. Not in the paper: it names the method only.

use crate::numeric::threads;
use serde::{Deserialize, Serialize};

/// Numbers of one task.
const CHUNK: usize = 512;

/// Adam's moments of one array of parameters.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
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

    /// Continues after so many steps from first and second moments.
    ///
    /// # Panics
    /// When the moments differ in number.
    pub fn continued(beta: [f64; 2], epsilon: f64, steps: u32, first: &[f64], second: &[f64]) -> Self {
        assert_eq!(first.len(), second.len(), "numbers of moments");
        let moments = first.iter().zip(second).map(|(&m, &v)| [m, v]).collect();
        Self { beta, epsilon, steps, moments }
    }

    /// Steps done, first and second moments.
    pub fn state(&self) -> (u32, Vec<f64>, Vec<f64>) {
        let of = |k: usize| self.moments.iter().map(|moments| moments[k]).collect();
        (self.steps, of(0), of(1))
    }

    /// Whether this is a state of `n` numbers after at most `most` steps.
    pub fn fits(&self, n: usize, beta: [f64; 2], epsilon: f64, most: usize) -> bool {
        let are_moments = |[m, v]: &[f64; 2]| m.is_finite() && v.is_finite() && *v >= 0.0;
        (self.moments.len(), self.beta, self.epsilon) == (n, beta, epsilon)
            && self.steps as usize <= most
            && self.moments.iter().all(are_moments)
    }

    /// `θ -= rate · m̂ / (√v̂ + ε)`.
    ///
    /// # Panics
    /// If an array does not have the length the optimiser was made for.
    pub fn step(&mut self, parameters: &mut [f64], gradient: &[f64], rate: f64) {
        self.advance(parameters, gradient, |parameter, m, root| parameter - rate * m / root);
    }

    /// Writes the direction `m̂ / (√v̂ + ε)` that a step of rate 1 goes against.
    ///
    /// # Panics
    /// If an array does not have the length the optimiser was made for.
    pub fn direction(&mut self, gradient: &[f64], direction: &mut [f64]) {
        self.advance(direction, gradient, |_, m, root| m / root);
    }

    /// Updates the moments, and each number to `then(number, m̂, √v̂ + ε)`.
    fn advance(&mut self, values: &mut [f64], gradient: &[f64], then: impl Fn(f64, f64, f64) -> f64 + Sync + Send) {
        let n = self.moments.len();
        assert_eq!((values.len(), gradient.len()), (n, n), "lengths of parameters and gradient");
        self.steps += 1;
        let ([beta1, beta2], epsilon) = (self.beta, self.epsilon);
        let [first, second] = self.beta.map(|beta| 1.0 - power(beta, self.steps));
        let chunks = (threads::chunks(values, CHUNK), threads::chunks(&mut self.moments, CHUNK));
        threads::for_each_zip(chunks, |chunk, (values, moments)| {
            for ((value, moments), g) in values.iter_mut().zip(moments).zip(&gradient[chunk * CHUNK..]) {
                let m = beta1 * moments[0] + (1.0 - beta1) * g;
                let v = beta2 * moments[1] + (1.0 - beta2) * (g * g);
                *moments = [m, v];
                *value = then(*value, m / first, (v / second).sqrt() + epsilon);
            }
        });
    }

    /// Adapts the moments to a new population: each row of `width` numbers takes those of an old row, or zeros.
    ///
    /// The step count continues.
    pub fn remap_rows(&mut self, width: usize, rows: &[Option<usize>]) {
        self.moments = remap_rows(&self.moments, width, rows, [0.0; 2]);
    }
}

/// Rows of `width` elements copied from `old`, or filled with `empty`.
pub(super) fn remap_rows<T: Copy>(old: &[T], width: usize, rows: &[Option<usize>], empty: T) -> Vec<T> {
    let mut new = vec![empty; rows.len() * width];
    for (new, row) in new.chunks_exact_mut(width).zip(rows) {
        if let Some(row) = row {
            new.copy_from_slice(&old[row * width..][..width]);
        }
    }
    new
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
    use crate::tolerances::relative;

    #[test]
    fn the_first_step_has_the_length_of_the_rate_whatever_the_gradient() {
        let mut parameters = [1.0, 1.0, 1.0];
        Adam::new(3, [0.9, 0.999], 1e-15).step(&mut parameters, &[1e-9, -3.0, 1e6], 0.01);
        for (got, expected) in parameters.iter().zip([0.99, 1.01, 0.99]) {
            within!(relative(*got, expected));
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
            within!(relative(parameters[0], x));
        }
    }

    #[test]
    fn the_direction_is_the_step_of_rate_one() {
        let mut adam = Adam::new(2, [0.9, 0.999], 1e-15);
        let (mut parameters, mut direction) = ([0.0; 2], [7.0; 2]);
        adam.direction(&[0.3, -2.0], &mut direction);
        let mut twin = adam.clone();
        twin.step(&mut parameters, &[-0.1, 5.0], 1.0);
        adam.direction(&[-0.1, 5.0], &mut direction);
        assert_eq!(direction, parameters.map(|x| -x));
        assert_eq!(adam, twin);
    }

    #[test]
    fn a_new_population_keeps_the_moments_of_its_old_rows() {
        let mut adam = Adam::new(6, [0.9, 0.999], 1e-15);
        adam.direction(&[1.0, 2.0, 3.0, 4.0, 5.0, 6.0], &mut [0.0; 6]);
        adam.remap_rows(2, &[Some(2), None, Some(0), Some(0)]);
        let first: Vec<f64> = adam.moments.iter().map(|[m, _]| *m * 10.0).collect();
        for (got, expected) in first.iter().zip([5.0, 6.0, 0.0, 0.0, 1.0, 2.0, 1.0, 2.0]) {
            within!(relative(*got, expected));
        }
        assert_eq!((first.len(), adam.steps), (8, 1));
    }

    #[test]
    fn a_number_moves_as_if_it_were_alone() {
        let gradient: [f64; 19] = std::array::from_fn(|i| (i as f64 - 7.3) * 0.1);
        let mut parameters = gradient.map(|g| 3.0 * g + 1.0);
        let mut apart = parameters;
        let mut adam = Adam::new(19, [0.9, 0.999], 1e-15);
        let mut adams = vec![Adam::new(1, [0.9, 0.999], 1e-15); 19];
        for _ in 0..3 {
            adam.step(&mut parameters, &gradient, 0.1);
            for ((adam, parameter), g) in adams.iter_mut().zip(&mut apart).zip(gradient) {
                adam.step(std::slice::from_mut(parameter), &[g], 0.1);
            }
        }
        assert_eq!(parameters, apart);
        assert!(adam.moments.iter().eq(adams.iter().flat_map(|adam| &adam.moments)));
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
            within!(relative(power(0.999, n), libm::pow(0.999, f64::from(n))));
        }
    }
}
