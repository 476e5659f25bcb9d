//! The first iterations from zeros: sets of views correct the volume one after another `[KF15]`.
//!
//! ```text
//! for each set S of V views' n:   y = x + β·(x - x before);  x ← prox(y - V/n·A_Sᵀ(A_S y - p_S)/L)
//! ```
//!
//! A sweep costs as much as an iteration over all views and gets as far as many of them, but its fixed point is another:
//! once F falls slowly the number of sets is halved, until iterations over all views go on with the momentum of the sweeps.
//!
//! `[KF15]`: D. Kim, S. Ramani, J. A. Fessler, *Combining ordered subsets and momentum for accelerated X-ray CT image
//! reconstruction*, IEEE Trans. Med. Imaging 34 (2015) 167.

use super::{TvRun, next_momentum};
use crate::classical::algebraic::space::total;
use crate::classical::algebraic::{Change, Measure, Name, Order, Pass, dot};
use std::f64::consts::TAU;
use trgs_core::error::Result;
use trgs_core::numeric::{Real, real, threads};

/// Fewest views of a set: L bounds what three views contribute, not what one does.
const VIEWS: usize = 3;
/// A sweep that lowers F by less than this fraction halves the number of sets.
const SLOW: f64 = 3e-3;
/// Steps of the dual problem per set; it is kept from set to set.
const STEPS: usize = 1;

/// Sets of so many views at first.
pub(super) fn first_sets(views: usize) -> usize {
    (views / VIEWS).max(1)
}

impl<R: Real> TvRun<'_, R> {
    /// The sets in the order of a sweep. Views of a set are evenly spaced, and each set is far in angle from those before.
    fn sets(&self) -> Vec<Vec<usize>> {
        let angles = self.system.trajectory.angles;
        let mut views: Vec<usize> = (0..angles.len()).collect();
        views.sort_by(|&a, &b| angles[a].rem_euclid(TAU).total_cmp(&angles[b].rem_euclid(TAU)));
        let places: Vec<f64> = (0..self.sets).map(|set| TAU * set as f64 / self.sets as f64).collect();
        let of = |set: usize| views.iter().copied().skip(set).step_by(self.sets).collect();
        Order::AngularDistance.of(&places, 0).into_iter().map(of).collect()
    }

    /// Corrects the volume by one set after another.
    pub(super) fn sweep(&mut self) -> Result<Pass> {
        let sets = self.sets();
        let squares: Vec<f64> = sets.iter().map(|set| self.correct(set)).collect::<Result<_>>()?;
        // Each set counts before its own correction.
        let misfit: f64 = squares.iter().sum();
        let variation = total(&mut *self.space, Measure::Variation(Name::Volume))?[0];
        let objective = 0.5 * misfit + self.lambda * variation;
        let pass = Pass::new(self.iteration, self.settings.iterations, misfit.sqrt())?;
        if objective > (1.0 - SLOW) * self.objective {
            // Larger sets have other sums: the first sweep over them is compared with none.
            (self.sets, self.objective) = (self.sets / 2, f64::INFINITY);
        } else {
            self.objective = objective;
        }
        if self.sets <= 1 {
            self.begin_whole()?;
        }
        Ok(pass)
    }

    /// Corrects the volume by a set of views; returns the squared residual before.
    fn correct(&mut self, set: &[usize]) -> Result<f64> {
        self.space.change(Change::Extrapolate(real(self.momentum[1])))?;
        let pixels = self.system.pixels;
        let mut residual = self.space.project(set, Some(Name::Next))?;
        threads::for_each_chunk(&mut residual, pixels, |slot, residual| {
            let part = set[slot] * pixels..(set[slot] + 1) * pixels;
            let known = self.system.measured[part.clone()].iter().zip(&self.idle[part]);
            for (value, (&p, &idle)) in residual.iter_mut().zip(known) {
                *value = if idle { R::ZERO } else { *value - p };
            }
        });
        let share = self.views.len() as f64 / set.len() as f64;
        let [step, tau] = self.step_lengths();
        self.space.adjoin(set, &residual, Name::Next, Some(real(share * step)))?;
        self.space.solve(tau, STEPS)?;
        self.advance();
        self.momentum = next_momentum(self.momentum[0]);
        Ok(dot(&residual, &residual))
    }
}
