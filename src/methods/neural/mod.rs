//! Fields of density that are small networks: NAF, SAX-NeRF, and IntraTomo as in SAX-NeRF's toolbox. Not in the paper,
//! which compares with SAX-NeRF.
//!
//! | method | encoding of a point | network |
//! |---|---|---|
//! | `naf` (Zha et al.) | hash grid | four linear layers of 32 |
//! | `sax-nerf` (Cai et al.) | hash grid | the same with a Lineformer block as second layer |
//! | `intratomo` | sines and cosines | eight linear layers of 32 |
//!
//! A step takes one view and some of its rays. The density at points along a ray, summed with their distances, is its line
//! integral; the mean squared error of the rays is minimised by Adam. Densities and projections are in the unit of the scan
//! ([`crate::classical::density_unit()`]).
//!
//! ```text
//! rays ── points ── encoding ── network ── density ── sum along the ray ── error
//!         (box)     table       weights    (0 to ceiling)
//! ```
//!
//! **One lane a sample.** A register holds the same number of [`Lanes`](trgs_core::numeric::Lanes) samples; every output of a
//! layer is one chain of fused products over its inputs, in order. Samples are divided into bundles of rays by their number
//! alone, gradients of bundles are added in order, and each level of the table has one task. The bits are therefore those of
//! any number of threads and any build.
//!
//! What differs from the programs of the two papers, and why:
//!
//! - points lie in the box of the volume (theirs: within 0.3 m, with densities beyond continued from its surface), so any unit
//!   of length works, and rays beside the volume see nothing;
//! - rays of air are seen, too (`neural.air`): theirs are drawn where the value is above 0, which tells nothing about what lies
//!   beside the object in a scan without noise;
//! - no jitter and no checkpoint chosen by the truth when the volume is read off;
//! - SAX-NeRF's block sees pairs of points along a ray in training. A voxel is paired with itself when the volume is read off,
//!   so its density depends on its position alone; theirs is paired with its neighbour along z (`neural.partner`);
//! - levels, table and samples follow from the number of voxels (`neural.*`), theirs are for 256³;
//! - a sigmoid reaches `neural.ceiling` units instead of 1;
//! - random numbers depend on seed, step and ray only.
//!
//! R. Zha, Y. Zhang, H. Li, *NAF: neural attenuation fields for sparse-view CBCT reconstruction*, MICCAI 2022.
//! Y. Cai et al., *Structure-aware sparse-view X-ray 3D reconstruction*, CVPR 2024.

mod activation;
mod block;
#[cfg(feature = "conformance")]
pub mod conformance;
mod encoding;
mod linear;
mod network;
mod rays;
mod run;
mod settings;
#[cfg(test)]
mod tests;

pub use run::{Batch, NeuralRun};
pub use settings::{Kind, NeuralSettings};
