//! Mistakes that can be recognised from the right and the wrong array alone.

use super::Suspect;
use super::evidence::Accuracy;
use crate::format::Format;
use ndarray::{ArrayD, Axis, IxDyn, Slice};
use std::f64::consts::{LN_2, PI, TAU};

/// Suspects: wrong sign or factor, `1 - x`, rounding to a coarser format, wrong order of axes, direction or index.
pub(super) fn suspects(expected: &ArrayD<f64>, got: &ArrayD<f64>, axes: &[&str], accuracy: Accuracy) -> Vec<Suspect> {
    let mut all = vec![
        Suspect::observed("the opposite sign", -expected),
        Suspect::observed("1 - x instead of x", expected.mapv(|x| 1.0 - x)),
    ];
    for format in [Format::F32, Format::F16, Format::Bf16] {
        if 4.0 * accuracy.limit < format.ulp(1.0) {
            all.push(Suspect::new(format!("values rounded to {format}"), expected.mapv(|x| format.round(x))));
        }
    }
    let name = |axis| axis_name(axes, axis);
    for axis in (0..expected.ndim()).filter(|&axis| expected.len_of(Axis(axis)) > 1) {
        let mut flipped = expected.clone();
        flipped.invert_axis(Axis(axis));
        all.push(Suspect::new(format!("mirrored along {}", name(axis)), flipped));
    }
    for a in 0..expected.ndim() {
        for b in a + 1..expected.ndim() {
            if expected.len_of(Axis(a)) > 1 && expected.len_of(Axis(b)) > 1 {
                let names = format!("{} and {} transposed", name(a), name(b));
                all.push(Suspect::new(names, stored_as(expected, a, b)));
            }
        }
    }
    for axis in (0..expected.ndim()).filter(|&axis| expected.len_of(Axis(axis)) > 2) {
        for (by, towards) in [(1, "higher"), (-1, "lower")] {
            let text = format!("shifted by one along {} towards {towards} indices", name(axis));
            all.push(Suspect { fitted: true, ..Suspect::new(text, shifted(expected, got, axis, by)) });
        }
    }
    all.extend(factors(expected, got, accuracy));
    all.retain(|suspect| suspect.array != *expected);
    all
}

/// The name of an axis, or its number.
fn axis_name(axes: &[&str], axis: usize) -> String {
    axes.get(axis).map_or_else(|| format!("axis {axis}"), |name| (*name).to_owned())
}

/// The values with two axes exchanged in memory, in the expected shape.
fn stored_as(expected: &ArrayD<f64>, a: usize, b: usize) -> ArrayD<f64> {
    let mut turned = expected.view();
    turned.swap_axes(a, b);
    let values: Vec<f64> = turned.iter().copied().collect();
    ArrayD::from_shape_vec(expected.raw_dim(), values).expect("as many values")
}

/// Describes the permutation of axes that turns the truth into the answer, if there is one.
pub(crate) fn transposition(expected: &ArrayD<f64>, got: &ArrayD<f64>, axes: &[&str]) -> Option<String> {
    let name = |axis| axis_name(axes, axis);
    for a in 0..expected.ndim() {
        for b in a + 1..expected.ndim() {
            let mut turned = expected.view();
            turned.swap_axes(a, b);
            if turned.shape() == got.shape() {
                let error = super::distance(&turned.to_owned(), got);
                let size = super::distance(&ArrayD::zeros(got.raw_dim()), got);
                if error <= 0.05 * size {
                    return Some(format!("{} and {} transposed", name(a), name(b)));
                }
            }
        }
    }
    None
}

/// The values shifted by one along an axis; the vacated border is filled from the answer.
fn shifted(expected: &ArrayD<f64>, got: &ArrayD<f64>, axis: usize, by: isize) -> ArrayD<f64> {
    let (axis, mut result) = (Axis(axis), got.clone());
    let (to, from) = if by > 0 { (Slice::from(1..), Slice::from(..-1)) } else { (Slice::from(..-1), Slice::from(1..)) };
    result.slice_axis_mut(axis, to).assign(&expected.slice_axis(axis, from));
    result
}

/// Known factors, and the best constant factor.
fn factors(expected: &ArrayD<f64>, got: &ArrayD<f64>, accuracy: Accuracy) -> Vec<Suspect> {
    let n = expected.len() as f64;
    let mut known = vec![
        (2.0, "2".to_owned()),
        (0.5, "½".to_owned()),
        (-2.0, "-2".to_owned()),
        (4.0, "4".to_owned()),
        (0.25, "¼".to_owned()),
        (TAU.sqrt(), "√(2π)".to_owned()),
        (1.0 / TAU.sqrt(), "1/√(2π)".to_owned()),
        (TAU, "2π".to_owned()),
        (1.0 / TAU, "1/(2π)".to_owned()),
        (LN_2, "ln 2: powers of 2 instead of e".to_owned()),
        (PI / 180.0, "π/180: degrees instead of radians".to_owned()),
    ];
    if n > 4.0 {
        known.push((n, format!("{n}, the number of elements: a sum instead of a mean")));
        known.push((1.0 / n, format!("1/{n}: a mean instead of a sum")));
    }
    let suspect = |(k, text): (f64, String)| Suspect::observed(format!("a factor of {text}"), expected * k);
    let mut all: Vec<Suspect> = known.into_iter().map(suspect).collect();
    let finite = expected.iter().zip(got).filter(|(e, _)| e.is_finite());
    let (eg, ee) = finite.fold((0.0, 0.0), |(eg, ee), (e, g)| (eg + e * g, ee + e * e));
    let k = eg / ee;
    // A smaller factor would be written as 0: then most values are 0.
    if k.is_finite() && k.abs() >= 1e-6 && (k - 1.0).abs() > accuracy.smallest_factor() {
        let fitted = Suspect::observed(format!("a factor of {k:.6}"), expected * k);
        all.push(Suspect { fitted: true, residual: 0.01, ..fitted });
    }
    all
}

/// Shifts by half a pixel along the last two axes, interpolated; used if there is no scene to render.
pub(super) fn half_shifts(expected: &ArrayD<f64>, got: &ArrayD<f64>, axes: &[&str]) -> Vec<Suspect> {
    let first = expected.ndim().saturating_sub(if axes.first() == Some(&"x") { 3 } else { 2 });
    let mut all = Vec::new();
    for axis in (first..expected.ndim()).filter(|&axis| expected.len_of(Axis(axis)) > 4) {
        let name = axis_name(axes, axis);
        for (side, towards) in [(0, "higher"), (1, "lower")] {
            let array = between(expected, got, axis, side);
            let name = format!("a half-pixel shift in {name} towards {towards} indices");
            all.push(Suspect { residual: 0.25, interpolated: true, ..Suspect::new(name, array) });
        }
    }
    all
}

/// Cubic interpolation halfway before (side 0) or after (side 1) each element.
///
/// Borders are filled from the answer.
fn between(expected: &ArrayD<f64>, got: &ArrayD<f64>, axis: usize, side: usize) -> ArrayD<f64> {
    let length = expected.len_of(Axis(axis));
    let at = |index: &IxDyn, place: usize| {
        let mut index = index.clone();
        index[axis] = place;
        expected[index]
    };
    let mut result = got.clone();
    for (index, value) in result.indexed_iter_mut() {
        let after = index[axis] + side;
        if (2..length - 1).contains(&after) {
            let inner = at(&index, after - 1) + at(&index, after);
            *value = (9.0 * inner - at(&index, after - 2) - at(&index, after + 1)) / 16.0;
        }
    }
    result
}

#[cfg(test)]
mod tests {
    use super::super::of_array;
    use super::*;
    use ndarray::Array3;

    fn blob(columns: f64) -> ArrayD<f64> {
        Array3::from_shape_fn((2, 12, 15), |(n, r, c)| {
            let (y, x) = (r as f64 - 4.2 - n as f64, c as f64 - columns);
            libm::exp(-(x * x + 0.7 * y * y + 0.4 * x * y) / 9.0) + 0.01 * x
        })
        .into_dyn()
    }

    #[track_caller]
    fn assert_named(got: &ArrayD<f64>, name: &str) {
        let found = of_array(&blob(8.3), got, &["view", "v", "u"], Format::F64);
        assert!(found.as_deref().is_some_and(|found| found.contains(name)), "{found:?} for {name}");
    }

    #[test]
    fn each_mistake_is_named() {
        let truth = blob(8.3);
        assert_named(&-&truth, "the opposite sign");
        assert_named(&(&truth * 2.0), "a factor of 2");
        assert_named(&(&truth * 360.0), "a sum instead of a mean");
        assert_named(&truth.mapv(|x| 1.0 - x), "1 - x");
        assert_named(&ArrayD::zeros(truth.raw_dim()), "zeros");
        assert_named(&blob(8.8), "a half-pixel shift in u towards higher");
        assert_named(&blob(7.8), "a half-pixel shift in u towards lower");
        assert_named(&blob(9.3), "shifted by one along u towards higher");
        assert_named(&stored_as(&truth, 1, 2), "v and u transposed");
        let mut mirrored = truth.clone();
        mirrored.invert_axis(Axis(1));
        assert_named(&mirrored, "mirrored along v");
        let mut turned = truth.clone();
        turned.swap_axes(1, 2);
        assert_eq!(transposition(&truth, &turned, &["view", "v", "u"]).unwrap(), "v and u transposed");
    }

    #[test]
    fn what_is_no_known_mistake_gets_no_name() {
        let noise = Array3::from_shape_fn((2, 12, 15), |(n, r, c)| ((n * 7 + r * 31 + c * 17) % 13) as f64).into_dyn();
        assert_eq!(of_array(&blob(8.3), &noise, &["view", "v", "u"], Format::F64), None);
    }
}
