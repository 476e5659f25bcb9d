//! Reports on the state of a run.

use crate::sealed::are_finite;
use serde::{Deserialize, Serialize};

/// A report on the state of a run: means over the iterations since the last report.
///
/// Losses are of projections and volume in the run's unit of density.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Record {
    /// Iterations done.
    pub iteration: usize,
    /// Iterations of the whole run.
    pub iterations: usize,
    /// The total loss.
    pub loss: f64,
    /// Mean absolute difference of the projections.
    pub l1: f64,
    /// 1 - SSIM of the projections.
    pub d_ssim: f64,
    /// Total variation of the blocks.
    pub tv: f64,
    /// The loss on the degrees of freedom `[Eq. 10]`; 0 if disabled.
    pub nu: f64,
    /// The wavelet loss `[Eq. 15]` of the blocks; 0 if disabled.
    pub wavelet: f64,
    /// Number of primitives.
    pub primitives: usize,
    /// Mean confidence c of the primitives `[Eq. 8]`, if it is computed.
    pub confidence: Option<f64>,
    /// Mean ν of the primitives; `None` of Gaussians and of older runs.
    #[serde(default)]
    pub mean_nu: Option<f64>,
    /// Spearman's rank correlation of ν and c, if both vary.
    pub spearman: Option<f64>,
    /// Seconds since training began.
    pub seconds: f64,
}

impl Record {
    pub(super) fn is_finite(&self) -> bool {
        let Self { loss, l1, d_ssim, tv, nu, wavelet, confidence, mean_nu, spearman, seconds, .. } = self;
        are_finite(
            [loss, l1, d_ssim, tv, nu, wavelet, seconds].into_iter().chain(confidence).chain(mean_nu).chain(spearman),
        )
    }
}

/// The loss terms of one iteration, or their sums over several.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(super) struct Losses {
    pub(super) total: f64,
    pub(super) l1: f64,
    pub(super) d_ssim: f64,
    pub(super) tv: f64,
    pub(super) nu: f64,
    pub(super) wavelet: f64,
    /// Number of blocks in `wavelet`.
    pub(super) blocks: usize,
}

impl Losses {
    pub(super) fn is_finite(&self) -> bool {
        let Self { total, l1, d_ssim, tv, nu, wavelet, .. } = self;
        are_finite([total, l1, d_ssim, tv, nu, wavelet])
    }

    pub(super) fn add(&mut self, other: &Self) {
        self.total += other.total;
        self.l1 += other.l1;
        self.d_ssim += other.d_ssim;
        self.tv += other.tv;
        self.nu += other.nu;
        self.wavelet += other.wavelet;
        self.blocks += other.blocks;
    }
}
