//! Values against 50-digit truth, element by element, including distant kernel tails.

use crate::common::vectors::assert_conformance;
use trgs::config::Precision;
use trgs::oracle::Format;

fn is_value(case: &trgs::oracle::Case) -> bool {
    !case.stage.starts_with("gradient")
}

#[test]
fn values_in_f64_agree_with_the_truth() {
    assert_conformance(Precision::F64, Format::F64, is_value);
}

#[test]
fn values_in_f32_agree_with_the_truth() {
    assert_conformance(Precision::F32, Format::F32, is_value);
}
