//! How the objects of a table are scanned: the model of the rays, measuring errors, wrong data.

use crate::geometry::Projections;
use crate::numeric::rng::{Purpose, stream};
use ndarray::Axis;
use rand::RngExt;
use serde::Deserialize;

/// One pixel in so many is replaced.
const ONE_IN: f64 = 100.0;

/// How a table scans its objects.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Conditions {
    /// The model of the rays.
    pub rays: Rays,
    /// Whether training views go through the measuring chain of [`Chain`](crate::scan::chain::Chain).
    pub realistic: bool,
    /// What is wrong in the training views.
    pub damage: Damage,
}

/// What rays see.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Rays {
    /// The object as it is: a phantom, or the trilinear function of a volume.
    #[default]
    Object,
    /// Voxels of constant density, as TIGRE's projector and the paper's scans have them.
    Siddon,
}

/// What is wrong in the training views of a scan.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Damage {
    /// Nothing.
    #[default]
    None,
    /// One pixel in a hundred has a uniform random value from 0 to the largest of the scan.
    Pixels,
    /// The middle view holds the image of the first one.
    View,
}

impl Damage {
    /// Replaces values of training views; the result depends only on the arguments.
    pub(super) fn apply(self, views: &mut Projections, seed: u64) {
        match self {
            Self::None => {}
            Self::Pixels => {
                let largest = views.images.iter().fold(0.0_f32, |largest, &value| largest.max(value));
                for (view, mut image) in views.images.axis_iter_mut(Axis(0)).enumerate() {
                    let mut random = stream(seed, Purpose::Damage, view as u64, 0);
                    for value in &mut image {
                        let (chosen, replaced): (f64, f32) = (random.random(), random.random());
                        if chosen * ONE_IN < 1.0 {
                            *value = largest * replaced;
                        }
                    }
                }
            }
            Self::View => {
                let first = views.images.index_axis(Axis(0), 0).to_owned();
                let middle = views.len() / 2;
                views.images.index_axis_mut(Axis(0), middle).assign(&first);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ndarray::Array3;

    fn views() -> Projections {
        let images = Array3::from_shape_fn((4, 50, 50), |(view, v, u)| (view * 100 + v + u) as f32);
        Projections::new(vec![0.0, 1.0, 2.0, 3.0], images).unwrap()
    }

    #[test]
    fn pixels_are_replaced_in_every_view_and_the_same_for_a_seed() {
        let damaged = |seed| {
            let mut damaged = views();
            Damage::Pixels.apply(&mut damaged, seed);
            damaged.images
        };
        let changed = |view: usize| {
            let (before, after) = (views().images, damaged(3));
            let pairs =
                before.index_axis(Axis(0), view).to_owned().into_iter().zip(after.index_axis(Axis(0), view).to_owned());
            pairs.filter(|(before, after)| before != after).count()
        };
        // 25 of 2,500 are expected, ± 5.
        assert!((0..4).all(|view| (10..=40).contains(&changed(view))), "{:?}", [0, 1, 2, 3].map(changed));
        assert_eq!(damaged(3), damaged(3));
        assert_ne!(damaged(3), damaged(4));
        assert!(damaged(3).iter().all(|value| (0.0..=398.0).contains(value)));
    }

    #[test]
    fn one_view_is_that_of_another_angle() {
        let mut damaged = views();
        Damage::View.apply(&mut damaged, 0);
        let of = |views: &Projections, view| views.images.index_axis(Axis(0), view).to_owned();
        assert_eq!(of(&damaged, 2), of(&views(), 0));
        assert_eq!([0, 1, 3].map(|view| of(&damaged, view)), [0, 1, 3].map(|view| of(&views(), view)));
    }
}
