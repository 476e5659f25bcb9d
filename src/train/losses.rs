//! The losses of one iteration and their gradients.

use super::record::Losses;
use super::views::random_block;
use crate::confidence::nu_loss_into;
use crate::config::Config;
use crate::error::Result;
use crate::geometry::View;
use crate::loss::{ImageTerms, Ssim, SsimTarget, image_loss_into, tv};
use crate::numeric::rng::Purpose;
use crate::numeric::threads::{self, Pool, PoolGuard};
use crate::numeric::{Real, real};
use crate::primitives::{Activation, Parameters, Primitives};
use crate::projector::{Field, FieldGradient, Kernels, ViewField};
use crate::scan::dataset::Dataset;
use crate::wavelet::{self, Router, Routing, wavelet_loss_into};
use ndarray::{Array2, Array3};

/// Buffers of the losses, reused from iteration to iteration.
#[derive(Default)]
pub(super) struct Workspace<R: Real> {
    images: Pool<Array2<R>>,
    volumes: Pool<Array3<R>>,
    tv: tv::Workspace<R>,
    routers: Pool<Router>,
    routings: Pool<Routing>,
    wavelets: wavelet::Workspace<R>,
    nu_gradients: Pool<Vec<f64>>,
}

/// Arrays that every iteration computes anew from the raw parameters, in the memory of the one before.
pub(super) struct IterationState<R: Kernels> {
    pub(super) physical: Primitives,
    pub(super) field: Field<R>,
    pub(super) workspace: Workspace<R>,
    /// To the physical parameters, then to the raw ones.
    pub(super) gradient: Parameters,
    pub(super) direction: Vec<[f64; 3]>,
}

impl<R: Kernels> IterationState<R> {
    /// Empty until the first [`Self::update`].
    pub(super) fn new(activation: &Activation, cutoff: f64) -> Self {
        let physical = activation.forward(&Parameters::default());
        let field = Field::new(&physical, cutoff);
        let (workspace, gradient) = (Workspace::default(), Parameters::default());
        Self { physical, field, workspace, gradient, direction: Vec::new() }
    }

    /// The physical parameters and the field of raw parameters.
    pub(super) fn update(&mut self, raw: &Parameters, activation: &Activation) {
        activation.forward_into(raw, &mut self.physical);
        self.field.renew(&self.physical);
    }
}

/// The inputs of an iteration's losses.
pub(super) struct LossInputs<'a, R: Kernels> {
    pub(super) iteration: usize,
    pub(super) dataset: &'a Dataset,
    pub(super) config: &'a Config,
    pub(super) ssim: &'a Ssim<R>,
    /// The measured projection of the iteration's view, and that view.
    pub(super) image: &'a SsimTarget<R>,
    pub(super) view: View,
    /// ν_target `[Eq. 9]` and c `[Eq. 8]` of each primitive.
    pub(super) nu_targets: &'a [f64],
    pub(super) confidence: &'a [f64],
    pub(super) physical: &'a Primitives,
    pub(super) field: &'a Field<R>,
    pub(super) workspace: &'a Workspace<R>,
}

/// L1 and D-SSIM of a view, with the gradient.
pub(super) struct DataTerm<'a, R: Kernels> {
    pub(super) terms: ImageTerms,
    pub(super) view: ViewField<'a, R>,
    pub(super) gradient: PoolGuard<'a, FieldGradient>,
}

/// A loss on a block of the volume, with the gradient.
pub(super) struct BlockTerm<'a> {
    pub(super) value: f64,
    pub(super) gradient: PoolGuard<'a, FieldGradient>,
}

/// The loss on the degrees of freedom, with the gradient to ν.
pub(super) struct NuTerm<'a> {
    pub(super) value: f64,
    pub(super) gradient: PoolGuard<'a, Vec<f64>>,
}

/// All losses of an iteration; those that are not due are missing.
pub(super) struct LossTerms<'a, R: Kernels> {
    pub(super) data: DataTerm<'a, R>,
    pub(super) tv: Option<BlockTerm<'a>>,
    pub(super) wavelet: Option<BlockTerm<'a>>,
    pub(super) nu: Option<NuTerm<'a>>,
}

impl<'a, R: Kernels> LossInputs<'a, R> {
    /// All losses that are due, computed in parallel: the last tasks of one overlap with those of the others.
    pub(super) fn all(&self) -> Result<LossTerms<'a, R>> {
        let ((data, tv), (wavelet, nu)) = threads::join(
            || threads::join(|| self.data_loss(), || self.total_variation()),
            || threads::join(|| self.wavelet_loss(), || self.nu_loss()),
        );
        Ok(LossTerms { data, tv, wavelet: wavelet?, nu })
    }

    /// L1 and D-SSIM of the iteration's view.
    fn data_loss(&self) -> DataTerm<'a, R> {
        let view = self.field.seen_in(&self.view, self.config.projection);
        let (mut image, mut cotangent) = (self.workspace.images.take(), self.workspace.images.take());
        view.image_into(&mut image);
        let weight = self.config.loss.d_ssim;
        let terms = image_loss_into(self.ssim, weight, image.view(), self.image, &mut cotangent);
        let mut gradient = self.field.pooled_gradient();
        view.vjp(cotangent.view(), &mut gradient);
        DataTerm { terms, view, gradient }
    }

    /// Total variation of a random block of the volume, if it has a weight.
    fn total_variation(&self) -> Option<BlockTerm<'a>> {
        let (grid, loss) = (&self.dataset.scanner.grid, &self.config.loss);
        let weight = weight_of_tv(self.config);
        if weight <= 0.0 {
            return None;
        }
        let block = random_block(grid, loss.tv_block, 1, self.config.seed, Purpose::TotalVariation, self.iteration);
        let on_block = self.field.on(&block);
        let (mut voxels, mut cotangent) = (self.workspace.volumes.take(), self.workspace.volumes.take());
        on_block.voxels_into(&mut voxels);
        let value = tv::tv_into(voxels.view(), &self.workspace.tv, &mut cotangent);
        cotangent.mapv_inplace(|d| d * real::<R>(weight));
        let mut gradient = self.field.pooled_gradient();
        on_block.vjp(cotangent.view(), &mut gradient);
        Some(BlockTerm { value, gradient })
    }

    /// The wavelet loss of a random block of the volume `[Eq. 11]`–`[Eq. 15]`, if it is due.
    fn wavelet_loss(&self) -> Result<Option<BlockTerm<'a>>> {
        let (grid, wavelet) = (&self.dataset.scanner.grid, &self.config.wavelet);
        if !(wavelet.enabled && self.iteration.is_multiple_of(wavelet.every)) {
            return Ok(None);
        }
        let multiple = 1 << wavelet.levels;
        let block = random_block(grid, wavelet.block, multiple, self.config.seed, Purpose::Wavelet, self.iteration);
        let settings = wavelet.settings();
        let (mut router, mut routing) = (self.workspace.routers.take(), self.workspace.routings.take());
        router.route_into(&block, &self.physical.parameters.mean, self.confidence, &settings, &mut routing)?;
        let on_block = self.field.on(&block);
        let (mut voxels, mut cotangent) = (self.workspace.volumes.take(), self.workspace.volumes.take());
        on_block.voxels_into(&mut voxels);
        let workspace = &self.workspace.wavelets;
        let [value, ..] = wavelet_loss_into(voxels.view(), &routing, &settings, workspace, &mut cotangent);
        let mut gradient = self.field.pooled_gradient();
        on_block.vjp(cotangent.view(), &mut gradient);
        Ok(Some(BlockTerm { value, gradient }))
    }

    /// The loss on the degrees of freedom `[Eq. 10]`, if it is enabled.
    fn nu_loss(&self) -> Option<NuTerm<'a>> {
        let settings = &self.config.confidence;
        let loss = || {
            let mut gradient = self.workspace.nu_gradients.take();
            let nu = &self.physical.parameters.nu;
            let value = nu_loss_into(nu, self.nu_targets, self.confidence, settings.weight, &mut gradient);
            NuTerm { value, gradient }
        };
        settings.enabled.then(loss)
    }
}

/// The weight of the total variation in a resolved configuration.
pub(super) fn weight_of_tv(config: &Config) -> f64 {
    config.loss.tv.fixed().expect("training resolves its configuration")
}

impl<R: Kernels> LossTerms<'_, R> {
    /// The values; the total has the weights of the configuration.
    pub(super) fn values(&self, config: &Config) -> Losses {
        let ImageTerms { total, l1, d_ssim } = self.data.terms;
        let tv = self.tv.as_ref().map_or(0.0, |term| term.value);
        let wavelet = self.wavelet.as_ref().map_or(0.0, |term| term.value);
        let nu = self.nu.as_ref().map_or(0.0, |term| term.value);
        let total = total + (weight_of_tv(config) * tv + wavelet + nu);
        Losses { total, l1, d_ssim, tv, nu, wavelet, blocks: usize::from(self.wavelet.is_some()) }
    }

    /// Writes the gradient to the physical parameters.
    pub(super) fn gradient_into(self, field: &Field<R>, config: &Config, gradient: &mut Parameters) {
        let mut sum = self.data.gradient;
        let mut blocks = [self.tv, self.wavelet].into_iter().flatten().map(|block| block.gradient);
        if config.loss.blocks_move {
            blocks.for_each(|block| sum.add(&block));
        } else if let Some(mut frozen) = blocks.next() {
            blocks.for_each(|block| frozen.add(&block));
            frozen.freeze_means();
            sum.add(&frozen);
        }
        field.parameter_gradient_into(&sum, gradient);
        if let Some(nu) = self.nu {
            gradient.nu.iter_mut().zip(nu.gradient.iter()).for_each(|(gradient, d)| *gradient += d);
        }
    }
}
