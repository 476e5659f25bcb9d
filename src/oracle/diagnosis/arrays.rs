//! Mistakes that can be recognised from the right and the wrong array alone.

use super::Suspect;
use ndarray::{ArrayD, Axis, IxDyn, Slice};

/// Suspects: zeros, wrong sign or factor, `1 - x`, wrong order of axes, direction or index.
pub(super) fn suspects(expected: &ArrayD<f64>, got: &ArrayD<f64>, axes: &[&str]) -> Vec<Suspect> {
    let mut all = vec![
        Suspect::new("zeros: nothing was computed", ArrayD::zeros(expected.raw_dim())),
        Suspect::new("the opposite sign", -expected),
        Suspect::new("1 - x instead of x", expected.mapv(|x| 1.0 - x)),
    ];
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
            all.push(Suspect { residual: 0.2, ..Suspect::new(text, shifted(expected, got, axis, by)) });
        }
    }
    all.extend(factor(expected, got));
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

/// The best constant factor, with its meaning if it is a known one.
fn factor(expected: &ArrayD<f64>, got: &ArrayD<f64>) -> Option<Suspect> {
    let finite = || expected.iter().zip(got).filter(|(e, _)| e.is_finite());
    let (eg, ee) = finite().fold((0.0, 0.0), |(eg, ee), (e, g)| (eg + e * g, ee + e * e));
    let k = eg / ee;
    if !k.is_finite() || k == 0.0 {
        return None;
    }
    let numbers = finite().filter(|(e, _)| **e != 0.0).count();
    let n = expected.len() as f64;
    let known = [
        (2.0, "2".to_owned()),
        (0.5, "½".to_owned()),
        (-2.0, "-2".to_owned()),
        (n, format!("{n}, the number of elements: a sum instead of a mean")),
        (1.0 / n, format!("1/{n}: a mean instead of a sum")),
        (std::f64::consts::TAU.sqrt(), "√(2π)".to_owned()),
        (1.0 / std::f64::consts::TAU.sqrt(), "1/√(2π)".to_owned()),
        (std::f64::consts::LN_2, "ln 2: powers of 2 instead of e".to_owned()),
        (std::f64::consts::PI / 180.0, "π/180: degrees instead of radians".to_owned()),
    ];
    let text = known.into_iter().find(|(value, _)| (k / value - 1.0).abs() < 1e-2).map(|(_, text)| text);
    // With two numbers or fewer, some factor always fits.
    let text = text.or_else(|| (numbers > 2).then(|| format!("{k:.6}")))?;
    Some(Suspect::new(format!("a factor of {text}"), expected * k))
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
            all.push(Suspect { name, array, residual: 0.25 });
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
        let found = of_array(&blob(8.3), got, &["view", "v", "u"]);
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
        assert_eq!(of_array(&blob(8.3), &noise, &["view", "v", "u"]), None);
    }
}
