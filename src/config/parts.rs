//! Words of keys: the readings of α, and of the networks.

use serde::{Deserialize, Serialize};

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

/// Last layer of a network.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum NeuralOutput {
    /// A multiple of a sigmoid.
    Sigmoid,
    /// A leaky rectifier.
    Relu,
}

/// Partner of a voxel in SAX-NeRF's block when the volume is computed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum VoxelPartner {
    /// Itself.
    #[serde(rename = "self")]
    Itself,
    /// The next or the last along z.
    #[serde(rename = "z")]
    Neighbour,
}
