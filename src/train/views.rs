//! The view and the blocks of an iteration.

use crate::geometry::Grid;
use crate::numeric::rng::{self, Purpose};
use rand::RngExt;
use rand::seq::SliceRandom;

/// A random block of the grid with sides of at most `side` voxels, multiples of `multiple`.
pub(super) fn random_block(
    grid: &Grid,
    side: usize,
    multiple: usize,
    seed: u64,
    purpose: Purpose,
    iteration: usize,
) -> Grid {
    let mut random = rng::stream(seed, purpose, iteration as u64, 0);
    let shape = grid.shape.map(|n| n.min(side) / multiple * multiple);
    let start = [0, 1, 2].map(|axis| random.random_range(0..=grid.shape[axis] - shape[axis]));
    grid.block(start, shape)
}

/// Every view once per epoch, in an order that depends on the seed and the epoch alone.
pub(super) struct ViewOrder {
    views: Vec<usize>,
    epoch: Option<u64>,
    seed: u64,
}

impl ViewOrder {
    pub(super) fn new(views: usize, seed: u64) -> Self {
        Self { views: (0..views).collect(), epoch: None, seed }
    }

    /// The view of a step, counted from 0.
    pub(super) fn view(&mut self, step: usize) -> usize {
        let epoch = (step / self.views.len()) as u64;
        if self.epoch != Some(epoch) {
            self.views.sort_unstable();
            self.views.shuffle(&mut rng::stream(self.seed, Purpose::ViewOrder, epoch, 0));
            self.epoch = Some(epoch);
        }
        self.views[step % self.views.len()]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_epoch_shows_every_view_once_in_its_own_order() {
        let mut order = ViewOrder::new(7, 3);
        let epochs: Vec<Vec<usize>> = (0..4).map(|e| (0..7).map(|i| order.view(e * 7 + i)).collect()).collect();
        for epoch in &epochs {
            let mut sorted = epoch.clone();
            sorted.sort_unstable();
            assert_eq!(sorted, (0..7).collect::<Vec<_>>());
        }
        assert_ne!(epochs[0], epochs[1]);
        assert_eq!(ViewOrder::new(7, 3).view(23), epochs[3][2], "a step's view does not depend on what came before");
    }

    #[test]
    fn random_blocks_lie_within_the_grid_and_move() {
        let grid = Grid::cube(40);
        let blocks: Vec<Grid> = (0..50).map(|i| random_block(&grid, 32, 1, 0, Purpose::TotalVariation, i)).collect();
        assert!(blocks.iter().all(|b| b.shape == [32; 3]
            && b.min.cmpge(grid.min - 1e-12).all()
            && b.max().cmple(grid.max() + 1e-12).all()));
        assert!(blocks.iter().any(|b| b.min != blocks[0].min));
        let block = |side, multiple| random_block(&Grid::cube(side), 32, multiple, 0, Purpose::Wavelet, 1).shape;
        assert_eq!((block(8, 1), block(11, 4), block(33, 2)), ([8; 3], [8; 3], [32; 3]));
    }
}
