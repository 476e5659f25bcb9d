//! A subset of a scan's views, chosen by R²-Gaussian's protocol for measured scans.

use super::Dataset;
use rand::seq::SliceRandom;
use trgs_core::error::{Error, Result};
use trgs_core::numeric::rng::{Purpose, stream};
use trgs_core::setting::Setting;

/// Default number of test views.
const TEST_VIEWS: usize = 100;

impl Dataset {
    /// Keeps `views` of the n training views and takes test views from the others.
    ///
    /// Training views are evenly spaced from the first to the last, at indices `⌊i·(n-1)/(views-1)⌋` for i from 0,
    /// computed as NumPy's `linspace(0, n-1, views).astype(int)`; for one view, it is the first. Test views are drawn
    /// from the remaining views without repetition and stay in the order of the scan. They are as noisy as the training
    /// views and replace the dataset's own test views. `test_views = None` means 100, or all remaining views if these
    /// are fewer. Initial points are dropped, because they may come from views that were removed. A note records the
    /// choice.
    ///
    /// # Errors
    /// For zero `views`, more than there are, or more test views than remain.
    pub fn subsample(self, views: usize, test_views: Option<usize>, seed: u64) -> Result<Self> {
        let n = self.train.len();
        let kept = evenly_spaced(views, n)?;
        let mut others: Vec<usize> = (0..n).filter(|view| kept.binary_search(view).is_err()).collect();
        let count = test_views.unwrap_or(others.len().min(TEST_VIEWS));
        if count > others.len() {
            let expected = format!("at most {}, the views that are left of {n}", others.len());
            return Err(Error::invalid(
                "test views",
                count,
                expected,
                "give " + Setting::TestViews + format!(" {}, or keep fewer ", others.len()) + Setting::Views,
            ));
        }
        others.shuffle(&mut stream(seed, Purpose::TestViews, 0, 0));
        others.truncate(count);
        others.sort_unstable();
        let note = format!(
            "{views} of {n} measured views are kept, evenly spaced; {count} of the others, drawn by chance, are test views"
        );
        Ok(Self {
            train: self.train.select(&kept),
            test: (count > 0).then(|| self.train.select(&others)),
            initial_points: None,
            notes: self.notes.into_iter().chain([note]).collect(),
            ..self
        })
    }
}

/// `views` evenly spaced indices below n, including the first and the last.
fn evenly_spaced(views: usize, n: usize) -> Result<Vec<usize>> {
    if views == 0 || views > n {
        return Err(Error::invalid(
            "views to keep",
            views,
            format!("1 to {n}, the training views"),
            "give " + Setting::Views + format!(" {n} for all of them"),
        ));
    }
    if views == 1 {
        return Ok(vec![0]);
    }
    let step = (n - 1) as f64 / (views - 1) as f64;
    Ok((0..views).map(|i| if i + 1 == views { n - 1 } else { (i as f64 * step) as usize }).collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Noise;
    use crate::phantom::Phantom;
    use crate::simulate::{Object, Plan, simulate};
    use ndarray::Array2;
    use trgs_core::geometry::{Beam, Detector, Grid, Scanner};

    /// A scan with `n` views, each with a different angle.
    fn scan(n: usize) -> Dataset {
        let detector = Detector { rows: 3, columns: 4, pitch_v: 1.0, pitch_u: 1.0, offset_u: 0.0, offset_v: 0.0 };
        let scanner = Scanner { beam: Beam::Cone { dso: 5.0, dsd: 7.0 }, detector, grid: Grid::cube(4) };
        let plan = Plan { views: n, test_views: 2, noise: Noise::None, seed: 0 };
        let phantom = Phantom::by_name("axes", 0).unwrap();
        let scan = simulate("axes", Object::Phantom(&phantom), &scanner, &plan).unwrap();
        Dataset { initial_points: Some(Array2::zeros((1, 4))), ..scan }
    }

    #[test]
    fn views_are_those_of_numpys_linspace_cut_to_integers() {
        // numpy.linspace(0, n - 1, views).astype(int). Of 31, 11·30/22 is 15, but falls short of it in floating point.
        for (views, n, expected) in [
            (5, 11, vec![0, 2, 5, 7, 10]),
            (6, 13, vec![0, 2, 4, 7, 9, 12]),
            (12, 721, vec![0, 65, 130, 196, 261, 327, 392, 458, 523, 589, 654, 720]),
            (23, 31, vec![0, 1, 2, 4, 5, 6, 8, 9, 10, 12, 13, 14, 16, 17, 19, 20, 21, 23, 24, 25, 27, 28, 30]),
            (1, 9, vec![0]),
            (2, 9, vec![0, 8]),
            (4, 4, vec![0, 1, 2, 3]),
        ] {
            assert_eq!(evenly_spaced(views, n).unwrap(), expected, "{views} of {n}");
        }
        for n in 1..200 {
            for views in 1..=n {
                assert!(evenly_spaced(views, n).unwrap().is_sorted_by(|a, b| a < b), "{views} of {n}");
            }
        }
    }

    #[test]
    fn test_views_are_others_that_the_seed_draws() {
        let whole = scan(40);
        let few = whole.clone().subsample(7, Some(9), 5).unwrap();
        let test = few.test.as_ref().unwrap();
        assert_eq!((few.train.len(), test.len()), (7, 9));
        assert_eq!(few.train, whole.train.select(&evenly_spaced(7, 40).unwrap()));
        let place = |angle: &f64| whole.train.angles.iter().position(|other| other == angle).unwrap();
        let drawn: Vec<usize> = test.angles.iter().map(place).collect();
        assert!(drawn.is_sorted_by(|a, b| a < b) && *test == whole.train.select(&drawn), "{drawn:?}");
        assert!(test.angles.iter().all(|angle| !few.train.angles.contains(angle)));
        assert_eq!(whole.clone().subsample(7, Some(9), 5).unwrap(), few);
        assert_ne!(whole.clone().subsample(7, Some(9), 6).unwrap().test, few.test);
        assert_eq!((&few.truth, &few.initial_points), (&whole.truth, &None));
        assert!(few.notes.concat().contains("7 of 40 measured views"), "{:?}", few.notes);
    }

    #[test]
    fn as_many_test_views_as_are_left_but_no_more() {
        let tests =
            |n, views, test_views| scan(n).subsample(views, test_views, 0).map(|d| d.test.map_or(0, |t| t.len()));
        assert_eq!(tests(130, 10, None).unwrap(), 100);
        assert_eq!(tests(30, 10, None).unwrap(), 20);
        assert_eq!(tests(30, 30, None).unwrap(), 0);
        assert_eq!(tests(30, 10, Some(20)).unwrap(), 20);
        assert_eq!(tests(30, 10, Some(0)).unwrap(), 0);
        let message = tests(30, 10, Some(21)).unwrap_err().to_string();
        assert!(message.contains("test views: got 21, expected at most 20"), "{message}");
        for views in [0, 31] {
            let message = tests(30, views, None).unwrap_err().to_string();
            assert!(message.contains("expected 1 to 30"), "{message}");
        }
    }
}
