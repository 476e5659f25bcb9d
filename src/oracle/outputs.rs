//! Builds the outputs of a case.

use super::manifest::Arrays;
use ndarray::{Array, Array1, ArrayD, Dimension, IxDyn};
use std::collections::BTreeMap;
use trgs_core::numeric::Real;
use trgs_core::primitives::{Group, Parameters};

/// The outputs of a case, by role.
pub type Outputs = BTreeMap<String, Arrays>;

/// One array as an output.
pub fn one<D: Dimension>(role: &str, array: Array<f64, D>) -> Outputs {
    [(role.to_owned(), [(String::new(), array.into_dyn())].into())].into()
}

pub(super) fn two<A: Dimension, B: Dimension>(a: (&str, Array<f64, A>), b: (&str, Array<f64, B>)) -> Outputs {
    let mut both = one(a.0, a.1);
    both.extend(one(b.0, b.1));
    both
}

pub(super) fn valued<R: Real, D: Dimension>(value: f64, gradient: Array<R, D>) -> Outputs {
    two(("value", Array1::from(vec![value])), ("gradient", gradient.mapv(R::to_f64)))
}

/// Parameters as an output, an archive by group.
pub fn parameters(role: &str, values: &Parameters) -> Outputs {
    let m = values.len();
    let array = |group: Group| {
        let shape = if group.width() == 1 { IxDyn(&[m]) } else { IxDyn(&[m, group.width()]) };
        ArrayD::from_shape_vec(shape, values.group(group).to_vec()).expect("a group has M·width numbers")
    };
    [(role.to_owned(), Group::ALL.map(|group| (group.key().to_owned(), array(group))).into())].into()
}

pub(super) fn gradient(values: &Parameters) -> Outputs {
    parameters("grad", values)
}
