//! Conventions of axes and angles that a scan may have been written with.

use ndarray::Axis;
use serde::Serialize;
use trgs_core::geometry::{Beam, Projections};

/// The differences between a scan's convention and the geometry page; all `false` means none.
///
/// A reading is corrected in the order of the fields: images are transposed, then rows and columns are reversed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Convention {
    /// The images are `[u, v]`, not `[v, u]`.
    pub transposed: bool,
    /// The first row is at the bottom.
    pub rows_reversed: bool,
    /// The columns run against u.
    pub columns_reversed: bool,
    /// The angles are clockwise seen from +z.
    pub rotation_reversed: bool,
    /// The angles are degrees, not radians.
    pub degrees: bool,
}

impl Convention {
    /// No difference: as stated.
    pub const AS_STATED: Self = Self {
        transposed: false,
        rows_reversed: false,
        columns_reversed: false,
        rotation_reversed: false,
        degrees: false,
    };

    /// All conventions, the stated one first: the symmetries of the image times both senses of rotation.
    ///
    /// Transposed images are left out for a detector that is not square. The list doubles where angles may be degrees.
    pub fn all(square: bool, maybe_degrees: bool) -> Vec<Self> {
        let bit = |number: usize, place: usize| number >> place & 1 == 1;
        let all = (0..32).map(|number| Self {
            rows_reversed: bit(number, 0),
            columns_reversed: bit(number, 1),
            rotation_reversed: bit(number, 2),
            transposed: bit(number, 3),
            degrees: bit(number, 4),
        });
        all.filter(|c| (square || !c.transposed) && (maybe_degrees || !c.degrees)).collect()
    }

    /// The projections on the geometry page's convention, if the data follow this one.
    pub fn correct(&self, projections: &Projections) -> Projections {
        let mut images = projections.images.view();
        if self.transposed {
            images.swap_axes(1, 2);
        }
        if self.rows_reversed {
            images.invert_axis(Axis(1));
        }
        if self.columns_reversed {
            images.invert_axis(Axis(2));
        }
        Projections {
            poses: None,
            angles: projections.angles.iter().map(|&angle| self.angle(angle)).collect(),
            images: images.as_standard_layout().into_owned(),
        }
    }

    /// The angle in radians for a number that was read as radians.
    pub fn angle(&self, stated: f64) -> f64 {
        let angle = if self.degrees { stated.to_radians() } else { stated };
        if self.rotation_reversed { -angle } else { angle }
    }

    /// Whether no projection distinguishes this convention from another: see the [module's page](super).
    pub fn looks_like(&self, other: &Self, beam: &Beam) -> bool {
        let handed = |c: &Self| c.columns_reversed != c.rotation_reversed;
        let parallel = matches!(beam, Beam::Parallel { .. });
        self.transposed == other.transposed
            && self.degrees == other.degrees
            && (parallel || handed(self) == handed(other))
    }

    /// The roll of the corrected images where `stated` is that of the images as they are: reflections reverse it.
    pub fn roll(&self, stated: f64) -> f64 {
        let reflected = self.transposed ^ self.rows_reversed ^ self.columns_reversed;
        if reflected { 0.0 - stated } else { stated }
    }

    /// The axis shift along u of the corrected images where `stated` is that along their columns.
    pub fn axis_shift(&self, stated: f64) -> f64 {
        if self.columns_reversed { 0.0 - stated } else { stated }
    }

    /// The offset `[u, v]` at which this convention explains the data as `other` does at `offset`.
    pub fn offset_from(&self, other: &Self, offset: [f64; 2]) -> [f64; 2] {
        let signed = |same: bool, value: f64| if same { value } else { 0.0 - value };
        [
            signed(self.columns_reversed == other.columns_reversed, offset[0]),
            signed(self.rows_reversed == other.rows_reversed, offset[1]),
        ]
    }

    /// Number of differences from the stated convention.
    pub fn faults(&self) -> usize {
        self.each().into_iter().filter(|(wrong, ..)| *wrong).count()
    }

    /// The convention in words.
    pub fn words(&self) -> String {
        let words: Vec<_> = self.each().into_iter().filter(|(wrong, ..)| *wrong).map(|(_, words, _)| words).collect();
        if words.is_empty() { "as stated".into() } else { words.join(" and ") }
    }

    /// One remedy per difference; empty if there is none.
    pub fn remedies(&self) -> Vec<&'static str> {
        self.each().into_iter().filter(|(wrong, ..)| *wrong).map(|(_, _, remedy)| remedy).collect()
    }

    fn each(&self) -> [(bool, &'static str, &'static str); 5] {
        [
            (self.transposed, "images transposed", "transpose every projection, image.T"),
            (self.rows_reversed, "rows from the bottom up", "reverse the rows, image[::-1, :]"),
            (self.columns_reversed, "columns mirrored", "reverse the columns, image[:, ::-1]"),
            (self.rotation_reversed, "rotation in the opposite sense", "change the sign of every angle"),
            (self.degrees, "angles in degrees", "write the angles in radians"),
        ]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ndarray::Array3;

    #[test]
    fn there_are_sixteen_conventions_of_a_square_detector_and_eight_of_another() {
        let all = Convention::all(true, false);
        assert_eq!((all.len(), Convention::all(false, false).len(), Convention::all(true, true).len()), (16, 8, 32));
        assert_eq!(all[0], Convention::AS_STATED);
        for (i, a) in all.iter().enumerate() {
            assert!(all[..i].iter().all(|b| a != b));
        }
    }

    #[test]
    fn the_images_of_all_corrections_differ_and_each_reversal_undoes_itself() {
        let images = Array3::from_shape_fn((2, 3, 3), |(k, v, u)| (k * 9 + v * 3 + u) as f32);
        let scan = Projections::new(vec![0.1, 0.2], images).unwrap();
        let corrected: Vec<_> = Convention::all(true, true).iter().map(|c| c.correct(&scan)).collect();
        for (i, a) in corrected.iter().enumerate() {
            assert!(corrected[..i].iter().all(|b| a != b), "{i}");
        }
        for c in Convention::all(false, false) {
            assert_eq!(c.correct(&c.correct(&scan)), scan);
        }
        let turned = Convention { transposed: true, rows_reversed: true, ..Convention::AS_STATED };
        assert_eq!(turned.correct(&scan).images[[0, 0, 1]], scan.images[[0, 1, 2]]);
    }

    #[test]
    fn sixteen_conventions_make_four_classes_in_a_cone_beam_and_two_in_a_parallel_one() {
        let all = Convention::all(true, false);
        for (beam, members) in [(Beam::Cone { dso: 5.0, dsd: 7.0 }, 4), (Beam::Parallel { dso: 5.0 }, 8)] {
            for a in &all {
                assert_eq!(all.iter().filter(|b| a.looks_like(b, &beam)).count(), members);
            }
        }
    }
}
