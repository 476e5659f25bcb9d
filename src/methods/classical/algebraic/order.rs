//! The order in which views are processed.

use rand::seq::SliceRandom;
use serde::{Deserialize, Serialize};
use std::f64::consts::TAU;
use trgs_core::numeric::rng::{Purpose, stream};

/// The order of views within an iteration.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Order {
    /// As measured.
    #[default]
    Input,
    /// Shuffled once, using the seed.
    Random,
    /// Each view as far in angle as possible from all before it.
    AngularDistance,
}

impl Order {
    /// The indices of the views at `angles` (radians) in this order.
    pub(super) fn of(self, angles: &[f64], seed: u64) -> Vec<usize> {
        let mut order: Vec<usize> = (0..angles.len()).collect();
        match self {
            Self::Input => {}
            Self::Random => order.shuffle(&mut stream(seed, Purpose::ViewOrder, 0, 0)),
            Self::AngularDistance => farthest_first(angles, &mut order),
        }
        order
    }
}

/// Farthest-first order: the first view stays; ties are broken by index.
///
/// Each next view is the one whose nearest chosen view is farthest away.
fn farthest_first(angles: &[f64], order: &mut [usize]) {
    let distance = |a: usize, b: usize| {
        let apart = (angles[a] - angles[b]).rem_euclid(TAU);
        apart.min(TAU - apart)
    };
    let mut nearest = vec![f64::INFINITY; angles.len()];
    for chosen in 1..order.len() {
        let last = order[chosen - 1];
        for &view in &order[chosen..] {
            nearest[view] = nearest[view].min(distance(view, last));
        }
        // Rounding must not decide between equal distances.
        let is_farther = |a: usize, b: usize| nearest[a] > nearest[b] + 1e-9 || nearest[a] > nearest[b] - 1e-9 && a < b;
        let next = (chosen..order.len()).reduce(|a, b| if is_farther(order[b], order[a]) { b } else { a });
        order.swap(chosen, next.expect("one is left"));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use trgs_core::geometry::Scanner;

    #[test]
    fn the_farthest_view_is_next() {
        let angles = Scanner::uniform_angles(8, 0.4, TAU);
        assert_eq!(Order::AngularDistance.of(&angles, 0), [0, 4, 2, 6, 1, 3, 5, 7]);
        assert_eq!(Order::Input.of(&angles, 0), [0, 1, 2, 3, 4, 5, 6, 7]);
    }

    #[test]
    fn a_shuffled_order_has_every_view_once_and_depends_on_the_seed() {
        let angles = Scanner::uniform_angles(30, 0.0, TAU);
        let order = Order::Random.of(&angles, 3);
        assert_ne!(order, Order::Random.of(&angles, 4));
        assert_eq!(order, Order::Random.of(&angles, 3));
        let mut sorted = order.clone();
        sorted.sort_unstable();
        assert!(sorted == Order::Input.of(&angles, 3) && sorted != order);
    }
}
