//! Values whose held-out error is near the least, by standard errors. Not in the paper.
//!
//! Of the numbers of iterations whose error is within one standard error of the least, the smallest is taken, and of the
//! weights of a finish the smallest, because more views ask for less:
//!
//! ```text
//! Σ_t d_t ≤ √(n/(n-1)·Σ_t (d_t - Σ d/n)²)     d_t = ‖A x - p‖² - ‖A x' - p‖² over tile t of n, x' of least error
//! ```
//!
//! The differences are paired: noise of the views held out is in both terms and cancels. Rays of a tile share the error of
//! the volume, so tiles are counted, not rays.

/// Squared errors of the held-out views, over the rays that are used.
#[derive(Clone)]
pub(super) struct Squares {
    /// `‖A x - p‖²` and `‖p‖²`.
    pub(super) sums: [f64; 2],
    /// `‖A x - p‖²` of each tile of each view.
    pub(super) tiles: Vec<f64>,
    /// Share of the volume in its mixture with the start of a finish.
    pub(super) share: f64,
}

impl Squares {
    /// Whether the error exceeds another one by no more than the standard error of their difference.
    pub(super) fn is_near(&self, other: &Self) -> bool {
        let differences = || self.tiles.iter().zip(&other.tiles).map(|(a, b)| a - b);
        let n = self.tiles.len() as f64;
        let sum: f64 = differences().sum();
        let scatter: f64 = differences().map(|difference| (difference - sum / n) * (difference - sum / n)).sum();
        sum <= (n / (n - 1.0) * scatter).sqrt()
    }
}

/// The least error.
pub(super) fn least_of(errors: &[(usize, Squares)]) -> Option<&Squares> {
    errors.iter().map(|(_, error)| error).min_by(|a, b| a.sums[0].total_cmp(&b.sums[0]))
}

/// The fewest iterations whose error is within one standard error, or this fraction, of the least.
pub(super) fn near(errors: &[(usize, Squares)], fraction: f64) -> Option<&(usize, Squares)> {
    let least = least_of(errors)?;
    let most = (1.0 + fraction) * relative(least.sums);
    let is_near = |error: &Squares| relative(error.sums) <= most || error.is_near(least);
    errors.iter().find(|(_, error)| is_near(error))
}

/// `‖A x - p‖/‖p‖` from the squares.
pub(super) fn relative([error, size]: [f64; 2]) -> f64 {
    (error / size).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_fewest_iterations_within_a_standard_error_are_taken() {
        let of = |tiles: [f64; 4]| Squares { sums: [tiles.iter().sum(), 1.0], tiles: tiles.to_vec(), share: 1.0 };
        let noise = [3.0, 5.0, 4.0, 8.0];
        let with = |more: [f64; 4]| of([0, 1, 2, 3].map(|tile| noise[tile] + more[tile]));
        // What all tiles have in common is no chance, however small it is beside the noise; what some gain and others lose is.
        let (worse, unsure) = (with([0.01, 0.011, 0.012, 0.01]), with([0.4, -0.3, 0.1, -0.1]));
        let errors = vec![(0, worse), (5, unsure), (10, of(noise)), (15, of(noise))];
        let near = |errors: &[_], fraction| near(errors, fraction).map(|(iteration, _)| *iteration);
        assert_eq!((near(&errors, 0.0), near(&errors[..1], 0.0), near(&[], 0.0)), (Some(5), Some(0), None));
        assert!(!errors[0].1.is_near(&errors[2].1) && errors[2].1.is_near(&errors[0].1));
        assert_eq!(near(&errors, 0.002), Some(0));
    }
}
