//! Wavelet regularisation of a block of voxels, guided by the confidence of the primitives near it.
//!
//! | step | where | paper |
//! |---|---|---|
//! | 3-D Haar transform, bands alone at full size | [`haar`] | `[Eq. 11]` |
//! | confident and other neighbours of each voxel | [`route`] | `[Eq. 12]`, `[Eq. 13]` |
//! | enhancement, suppression, loss and gradient | [`wavelet_loss`] | `[Eq. 14]`, `[Eq. 15]` |
//! | the same, as plainly as it can be written | [`naive`] | `[Eq. 11]`–`[Eq. 15]` |
//!
//! With N voxels `p`, each with K neighbours of which `h(p)` are confident, and B bands of which `f_b` is one alone:
//!
//! ```text
//! g(p) = (1/B) Σ_b √(|∇f_b(p)|² + 1e-12)                          strength of the detail at p
//! E = (1/N) Σ_p η·h(p)/K·g(p),   S = (1/N) Σ_p (1 - h(p)/K)·g(p)   enhancement, suppression
//! L = λ_supp·S - λ_enh·E                                          minimised
//! ```
//!
//! ∇ are differences of neighbouring voxels, in units of voxels. The paper does not specify the wavelet, the differences,
//! the mean over the bands and the position of η.

mod detail;
pub mod haar;
mod loss;
pub mod naive;
mod routing;

pub use loss::{WaveletLoss, Workspace, wavelet_loss, wavelet_loss_into};
pub use routing::{Router, Routing, route};

use crate::error::{Error, Result};
use crate::setting::Text;

/// Added to `|∇f|²`: keeps the gradient finite where a band is flat.
const FLAT: f64 = 1e-12;

/// Parameters of the wavelet regularisation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Settings {
    /// K: nearest primitives of a voxel whose confidence is used.
    pub neighbours: usize,
    /// τ: confidence from which on a primitive counts as confident.
    pub threshold: f64,
    /// η: factor of the enhancement.
    pub enhancement: f64,
    /// λ_supp: weight of the suppression.
    pub suppress: f64,
    /// λ_enh: weight of the enhancement.
    pub enhance: f64,
    /// Levels of the transform; the sides of a block are multiples of 2^levels.
    pub levels: usize,
}

impl Default for Settings {
    fn default() -> Self {
        Self { neighbours: 8, threshold: 0.35, enhancement: 1.5, suppress: 0.03, enhance: 0.01, levels: 1 }
    }
}

impl Settings {
    /// Checks that there are neighbours and levels, and that a block of this shape can be transformed.
    fn check(&self, shape: [usize; 3]) -> Result<()> {
        if !(1..=usize::from(u16::MAX)).contains(&self.neighbours) {
            return Err(Error::invalid("neighbours", self.neighbours, "1 to 65535", "the paper's is 8"));
        }
        if self.levels == 0 {
            return Err(Error::invalid("levels of the wavelet transform", 0, "at least 1", "the paper's is 1"));
        }
        if shape.iter().any(|&side| side == 0 || (side.trailing_zeros() as usize) < self.levels) {
            return Err(Error::invalid(
                "sides of the wavelet's block",
                format!("{shape:?} with {} levels", self.levels),
                "even sides, divisible by 2 once for each level",
                "give " + Text::set("wavelet.block", 32) + " and " + Text::set("wavelet.levels", 1) + ", the defaults",
            ));
        }
        Ok(())
    }
}
