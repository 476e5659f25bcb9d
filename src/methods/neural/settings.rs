//! Settings of the training of a network.

/// Encoding and network.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// Hash grid and four linear layers.
    Naf,
    /// Hash grid, linear layers and a Lineformer block.
    SaxNerf,
    /// Sines and cosines, and eight linear layers.
    IntraTomo,
}

/// Settings of a run.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NeuralSettings {
    /// Encoding and network.
    pub kind: Kind,
    /// Steps.
    pub iterations: usize,
    /// Levels of the hash grid: 16, 32, 64, … cells a side.
    pub levels: usize,
    /// Largest number of entries of a level, as a power of two.
    pub table: u32,
    /// Points along a ray, even.
    pub samples: usize,
    /// Single pixels of a step.
    pub rays: usize,
    /// Whether they are drawn from all pixels, else from those with a value above 0.
    pub sees_air: bool,
    /// Windows of a step.
    pub windows: usize,
    /// Pixels along each side of a window.
    pub window: usize,
    /// Learning rates of the table and of the network.
    pub rate: [f64; 2],
    /// Steps after which the rates are a tenth, again and again.
    pub drop: usize,
    /// Whether densities are `ceiling` times a sigmoid; else a leaky rectifier, which has negative ones.
    pub is_bounded: bool,
    /// Largest density, in units of the scan.
    pub ceiling: f64,
    /// Whether the block sees a voxel with its neighbour along z, else with itself.
    pub pairs_neighbours: bool,
    /// Seed of all random choices.
    pub seed: u64,
}
