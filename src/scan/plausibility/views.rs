//! Views that are listed twice, test views that are training views, and short arcs.

use super::Evidence;
use ndarray::ArrayView2;
use std::cmp::Ordering;
use std::collections::BTreeMap;
use trgs_core::geometry::Projections;
use trgs_core::words::{counted, verb};

/// A total arc that is remarked on, radians: 20°, less than that of a tomosynthesis.
const SHORT_ARC: f64 = 20.0 * std::f64::consts::PI / 180.0;
/// Views of an arc that is remarked on: fewer have no arc worth a word.
const FEWEST: usize = 3;

/// Remarks on the training and test views.
pub(super) fn remarks(scan: &Evidence<'_>) -> Vec<String> {
    let (train, test) = (&scan.dataset.train, scan.dataset.test.as_ref());
    let test = test.and_then(|test| leaked(train, test));
    [arc(train), frames(train), angles(train), test].into_iter().flatten().collect()
}

/// A remark on views that span a few degrees.
fn arc(train: &Projections) -> Option<String> {
    let (low, high) = super::ends(train.angles.iter().copied());
    (train.len() >= FEWEST && train.poses.is_none() && high - low < SHORT_ARC && high > low).then(|| {
        format!(
            "the views span {:.2}° only: were radians converted from degrees twice? Then multiply every angle by {}",
            (high - low).to_degrees(),
            1.0_f64.to_degrees()
        )
    })
}

/// The order of two images by their bits.
fn by_bits(a: ArrayView2<'_, f32>, b: ArrayView2<'_, f32>) -> Ordering {
    a.iter().map(|value| value.to_bits()).cmp(b.iter().map(|value| value.to_bits()))
}

/// The views of an object, ordered by the bits of their images; constant images show none.
fn ordered(views: &Projections) -> Vec<usize> {
    let varies = |view: &usize| {
        let image = views.image(*view);
        image.iter().any(|value| *value != image[[0, 0]])
    };
    let mut order: Vec<usize> = (0..views.len()).filter(varies).collect();
    order.sort_by(|&a, &b| by_bits(views.image(a), views.image(b)));
    order
}

/// A remark on images that are equal in every bit.
fn frames(train: &Projections) -> Option<String> {
    let order = ordered(train);
    let equal = |pair: &&[usize]| by_bits(train.image(pair[0]), train.image(pair[1])).is_eq();
    let pairs: Vec<&[usize]> = order.windows(2).filter(equal).collect();
    let &[a, b] = *pairs.iter().min_by_key(|pair| pair[1])? else { return None };
    let (views, are) = (counted(pairs.len(), "training view"), verb(pairs.len(), "has", "have"));
    Some(format!(
        "{views} {are} the image of another one, bit by bit, as views {a} and {b}: list every frame once, or remove the copies"
    ))
}

/// A remark on angles that are stated twice on a circle.
fn angles(train: &Projections) -> Option<String> {
    if train.poses.is_some() {
        return None;
    }
    let mut first = BTreeMap::new();
    let mut pairs = Vec::new();
    for (view, angle) in train.angles.iter().enumerate() {
        match first.get(&angle.to_bits()) {
            Some(&other) => pairs.push((other, view)),
            None => _ = first.insert(angle.to_bits(), view),
        }
    }
    let &(a, b) = pairs.first()?;
    let (views, are) = (counted(pairs.len(), "training view"), verb(pairs.len(), "has", "have"));
    Some(format!(
        "{views} {are} the angle of another one, as views {a} and {b} at {:.2}°: correct the angles if the object was turned \
         between them",
        train.angles[a].to_degrees()
    ))
}

/// A remark on test views that are training views.
fn leaked(train: &Projections, test: &Projections) -> Option<String> {
    let order = ordered(train);
    let on_circle = train.poses.is_none() && test.poses.is_none();
    let of = |view: usize| {
        let place = order.binary_search_by(|&known| by_bits(train.image(known), test.image(view))).ok();
        let same_angle = || train.angles.iter().position(|angle| on_circle && *angle == test.angles[view]);
        Some((view, place.map(|place| order[place]).or_else(same_angle)?))
    };
    let pairs: Vec<(usize, usize)> = (0..test.len()).filter_map(of).collect();
    let &(a, b) = pairs.first()?;
    let (views, are) = (counted(pairs.len(), "test view"), verb(pairs.len(), "is a", "are"));
    Some(format!(
        "{views} of {} {are} training {}, as test view {a} and training view {b}: the 2D metrics do not judge what a method \
         has seen; list other views in proj_test",
        test.len(),
        verb(pairs.len(), "view", "views"),
    ))
}
