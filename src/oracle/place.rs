//! The place of an error: rows, columns, primitives, views or tiles that are wrong while the rest is right.
//!
//! Not in the paper. A place is named if at least four fifths of its elements are wrong that could show an error, and no
//! element outside of it is.

use ndarray::{ArrayD, Dimension};

/// Sides of the tiles that are tried, largest first.
const TILES: [usize; 4] = [32, 16, 8, 4];

/// Which elements are wrong, and which of the others would show an error.
pub(super) struct Errors {
    shape: Vec<usize>,
    wrong: Vec<Vec<usize>>,
    visible: ArrayD<bool>,
}

impl Errors {
    /// Compares two arrays of one shape; `limit` is the error of an element, by index, that is no error.
    pub(super) fn new(expected: &ArrayD<f64>, got: &ArrayD<f64>, limit: impl Fn(&[usize], f64) -> f64) -> Self {
        let mut wrong = Vec::new();
        let mut visible = ArrayD::from_elem(expected.raw_dim(), false);
        for ((index, &e), (&g, visible)) in expected.indexed_iter().zip(got.iter().zip(&mut visible)) {
            let index = index.as_array_view().to_vec();
            let limit = limit(&index, e);
            let fine = e == g || (g - e).abs() <= limit;
            *visible = !fine || e.abs() > limit;
            if !fine {
                wrong.push(index);
            }
        }
        Self { shape: expected.shape().to_vec(), wrong, visible }
    }

    /// The place in words; `None` if the errors are everywhere, a single element, or in no simple set.
    ///
    /// `axes` names the axes, outermost first.
    pub(super) fn place(&self, axes: &[&str]) -> Option<String> {
        if self.wrong.len() < 2 {
            return None;
        }
        self.lines(axes).or_else(|| self.tiles())
    }

    /// Whether the elements with `inside` are wrong, as far as they could be.
    fn fills(&self, inside: impl Fn(&[usize]) -> bool) -> bool {
        let visible = self.visible.indexed_iter().filter(|(_, visible)| **visible);
        let within = visible.filter(|(index, _)| inside(index.as_array_view().as_slice().expect("contiguous"))).count();
        5 * self.wrong.len() >= 4 * within
    }

    /// Sets of indices along the axes.
    fn lines(&self, axes: &[&str]) -> Option<String> {
        let none = || self.shape.iter().map(|&n| vec![false; n]).collect::<Vec<_>>();
        let (mut used, mut shown) = (none(), none());
        for index in &self.wrong {
            used.iter_mut().zip(index).for_each(|(used, &i)| used[i] = true);
        }
        for (index, _) in self.visible.indexed_iter().filter(|(_, visible)| **visible) {
            shown.iter_mut().zip(index.as_array_view()).for_each(|(shown, &i)| shown[i] = true);
        }
        let whole = |axis: usize| used[axis].iter().zip(&shown[axis]).all(|(&used, &shown)| used || !shown);
        let partial: Vec<usize> = (0..self.shape.len()).filter(|&axis| !whole(axis)).collect();
        if partial.is_empty() || !self.fills(|index| partial.iter().all(|&axis| used[axis][index[axis]])) {
            return None;
        }
        let name = |axis: usize| axes.get(axis).map_or_else(|| format!("axis-{axis} line"), |name| spoken(name).into());
        // The innermost axis first: columns of rows of views.
        let parts = partial.iter().rev().map(|&axis| set(&used[axis], &name(axis)));
        let mut text = parts.collect::<Option<Vec<_>>>()?.join(", ");
        if let ([axis], Some(row)) = (&partial[..], self.shape.len().checked_sub(2))
            && *axis == row + 1
            && self.shape[row] > 1
        {
            text += &format!(" of every {}", name(row));
        }
        Some(text)
    }

    /// Squares of the last two axes.
    fn tiles(&self) -> Option<String> {
        let [.., rows, columns] = self.shape[..] else { return None };
        let tile = |index: &[usize], side: usize| [index[index.len() - 2] / side, index[index.len() - 1] / side];
        for side in TILES {
            let all = rows.div_ceil(side) * columns.div_ceil(side);
            let mut hit: Vec<_> = self.wrong.iter().map(|index| tile(index, side)).collect();
            hit.sort_unstable();
            hit.dedup();
            if 2 * hit.len() <= all && self.fills(|index| hit.binary_search(&tile(index, side)).is_ok()) {
                let share = all as f64 / hit.len() as f64;
                let whole = (share - share.round()).abs() < 1e-9 && hit.len() > 1;
                return Some(match whole {
                    true => format!("one tile of {side}×{side} in {share}"),
                    false => format!("{} of {all} tiles of {side}×{side}", hit.len()),
                });
            }
        }
        None
    }
}

/// The word for an index of an axis.
fn spoken(axis: &str) -> &str {
    match axis {
        "v" => "row",
        "u" => "column",
        "x" => "x slice",
        "y" => "y slice",
        "z" => "z slice",
        _ => axis,
    }
}

/// A set of indices as a range or a period.
fn set(used: &[bool], name: &str) -> Option<String> {
    let indices: Vec<usize> = (0..used.len()).filter(|&i| used[i]).collect();
    let (first, last, count) = (*indices.first()?, *indices.last()?, indices.len());
    if count == 1 {
        return Some(format!("{name} {first}"));
    }
    if last - first + 1 == count {
        let end = if last + 1 == used.len() && first > 0 { format!(" (the last {count})") } else { String::new() };
        return Some(format!("{name}s {first}-{last}{end}"));
    }
    let period = indices[1] - first;
    let regular = first < period && indices.iter().enumerate().all(|(k, &i)| i == first + k * period);
    (regular && last + period >= used.len()).then(|| match period {
        2 => format!("every second {name} from {first}"),
        _ => format!("one {name} in {period} from {first}"),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use ndarray::Array3;

    const AXES: [&str; 3] = ["view", "v", "u"];

    fn place(wrong: impl Fn(usize, usize, usize) -> bool) -> Option<String> {
        let truth = Array3::from_elem((4, 40, 48), 1.0).into_dyn();
        let got = Array3::from_shape_fn((4, 40, 48), |(n, v, u)| if wrong(n, v, u) { 0.0 } else { 1.0 }).into_dyn();
        Errors::new(&truth, &got, |_, _| 1e-6).place(&AXES)
    }

    #[test]
    fn places_are_named() {
        type Wrong = fn(usize, usize, usize) -> bool;
        let cases: [(Wrong, &str); 8] = [
            (|_, _, u| (16..32).contains(&u), "columns 16-31 of every row"),
            (|_, _, u| u >= 32, "columns 32-47 (the last 16) of every row"),
            (|n, _, _| n % 2 == 1, "every second view from 1"),
            (|n, v, _| n == 3 && v < 2, "rows 0-1, view 3"),
            (|_, _, u| u % 4 == 2, "one column in 4 from 2"),
            (|_, v, _| v == 39, "row 39"),
            (|n, _, _| n >= 2, "views 2-3 (the last 2)"),
            (|_, v, u| (v / 8) % 2 == 0 && (u / 8 + v / 16) % 3 == 0, "one tile of 8×8 in 5"),
        ];
        for (wrong, name) in cases {
            let found = place(wrong);
            assert!(found.as_deref().is_some_and(|found| found.contains(name)), "{found:?} for {name}");
        }
    }

    #[test]
    fn errors_everywhere_at_one_element_or_scattered_have_no_place() {
        assert_eq!(place(|_, _, _| true), None);
        assert_eq!(place(|n, v, u| (n, v, u) == (1, 2, 3)), None);
        assert_eq!(place(|n, v, u| (n * 7 + v * 31 + u * 17) % 13 == 0), None);
        assert_eq!(place(|_, _, _| false), None);
    }

    #[test]
    fn elements_that_cannot_show_an_error_do_not_hide_a_place() {
        // Half of the columns are 0 in truth: there a dropped pixel is not seen.
        let truth = Array3::from_shape_fn((1, 8, 32), |(_, v, _)| f64::from(u8::from(v % 2 == 0))).into_dyn();
        let mut got = truth.clone();
        got.indexed_iter_mut().filter(|(index, _)| index[2] >= 16).for_each(|(_, x)| *x = 0.0);
        let found = Errors::new(&truth, &got, |_, _| 1e-6).place(&AXES);
        assert_eq!(found.unwrap(), "columns 16-31 (the last 16) of every row");
    }
}
