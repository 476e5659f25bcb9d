//! Keys of the networks, and the readings of α.

use documented::{Documented, DocumentedFields};
use serde::{Deserialize, Serialize};
use smart_default::SmartDefault;

/// The scaling factor α of the confidence: a word or a number.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(untagged, expecting = "\"own\", \"median\" or a number")]
pub enum AlphaConfig {
    /// A length in sides of a voxel.
    Voxels(f64),
    /// A length that follows from the primitives.
    Reading(AlphaReading),
}

/// An α that follows from the primitives.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum AlphaReading {
    /// The geometric mean of a primitive's own scales.
    Own,
    /// The median of these means over all primitives.
    Median,
}

/// The methods naf, sax-nerf and intratomo.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, SmartDefault, Documented, DocumentedFields)]
#[serde(deny_unknown_fields, default)]
pub struct NeuralConfig {
    /// Levels of the hash grid, of 16, 32, 64, … cells a side; 0: the last has four cells a voxel.
    #[default = 0]
    pub levels: usize,
    /// Largest number of entries of a level, as a power of two; 0: as many as voxels, 14 to 19.
    #[default = 0]
    pub table: u32,
    /// Points along a ray, even; 0: one and a half a voxel along a side.
    #[default = 0]
    pub samples: usize,
    /// Single pixels of a step.
    #[default = 1024]
    pub rays: usize,
    /// Whether these are any pixels, or those with a value above 0 as in the original programs.
    #[default = true]
    pub air: bool,
    /// Windows of pixels of a step.
    #[default = 0]
    pub windows: usize,
    /// Pixels along each side of a window.
    #[default = 4]
    pub window: usize,
    /// Learning rate of the hash grid.
    #[default = 1e-2]
    pub table_rate: f64,
    /// Learning rate of the network.
    #[default = 3e-3]
    pub network_rate: f64,
    /// Steps after which both learning rates are a tenth, again and again.
    #[default = 1000]
    pub drop: usize,
    /// What makes a density: sigmoid (from 0 to the ceiling) or relu (a leaky rectifier, with small negative ones).
    #[default(NeuralOutput::Sigmoid)]
    pub output: NeuralOutput,
    /// Largest density of the sigmoid, in units of the scan.
    #[default = 1.25]
    pub ceiling: f64,
    /// What a voxel is paired with in SAX-NeRF's block: itself, or its neighbour along z as in the original program.
    #[default(VoxelPartner::Itself)]
    pub partner: VoxelPartner,
}

/// What makes a density of a network's output.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum NeuralOutput {
    /// A multiple of a sigmoid.
    Sigmoid,
    /// A leaky rectifier.
    Relu,
}

/// What a voxel is paired with when the volume of a SAX-NeRF is read off.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum VoxelPartner {
    /// Itself.
    #[serde(rename = "self")]
    Itself,
    /// The next or the last along z.
    #[serde(rename = "z")]
    Neighbour,
}
