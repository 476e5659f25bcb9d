//! The keys: one table for each part, with type, default, range and sentence.

use super::keys::{keys, ranges::*};
use super::{
    AlphaConfig, AlphaReading, Auto, DensityControl, Finish, Method, NeuralOutput, PositionOptimiser, Precision, Rules,
    Sampling, Start, VoxelPartner,
};
use crate::classical::algebraic::{AsdPocsSettings, Order, SartSettings, TvSettings};
use crate::classical::{RayModel, Turn, Window};
use crate::density::Relocation;
use crate::primitives::KernelKind;
use crate::projector::Projection;
use crate::{confidence, wavelet};

keys! {
    /// Settings of a reconstruction.
    pub struct Config {
        /// Reconstruction method.
        method: Method = Method::TrGs;
        /// Training steps, one view each, or passes over all views on voxels. 0: 140 a training view, 1,000 to 5,000.
        iterations: usize = 0;
        /// Seed of all random numbers.
        seed: u64 = 0, SEED;
        /// How keys that are 0 or auto follow from the scan: trgs, or paper (its numbers for 256³, scaled with the volume).
        rules: Rules = Rules::Trgs;
        /// Arithmetic of the pixel kernels: f32 or f64.
        precision: Precision = Precision::F32;
        /// Projection of a primitive in a cone beam: exact (the line integral), or affine as in the paper.
        projection: Projection = Projection::Exact;
        /// Support of a primitive: it ends where its projection falls below this fraction of its peak. 0: no end.
        cutoff: f64 = 1e-3, BELOW_1;
        /// Sampling of volume.npy: auto (the pilot run decides), point (at voxel centres, as in the paper) or interpolant.
        sampling: Sampling = Sampling::Auto;
        /// Last stage on the volume of the primitives: tv (iterations of the method tv), or none as in the paper.
        finish: Finish = Finish::Tv;
        /// Attenuation per scene unit that counts as 1 in primitives, asd-pocs and networks. auto: from the projections.
        density_unit: Auto<f64> = Auto::Auto, POSITIVE_OR_AUTO;
        /// Length of the voxels that the training sees, in voxels of the scan. 0: 1; 2 from 256 voxels a side, 4 from 512.
        coarse: usize = 0, COARSE;
        /// Iterations between two reports.
        report_every: usize = 100, AT_LEAST_1;
        /// Iterations between two checkpoints.
        checkpoint_every: usize = 500, AT_LEAST_1;
        /// The primitives.
        model: ModelConfig = ModelConfig::default();
        /// Where the primitives start.
        initialisation: InitialisationConfig = InitialisationConfig::default();
        /// The loss of the training.
        loss: LossConfig = LossConfig::default();
        /// Ray confidence and its pull on ν.
        confidence: ConfidenceConfig = ConfidenceConfig::default();
        /// The wavelet loss.
        wavelet: WaveletConfig = WaveletConfig::default();
        /// Learning rates and Adam.
        optimiser: OptimiserConfig = OptimiserConfig::default();
        /// The sampler of positions.
        sghmc: SghmcConfig = SghmcConfig::default();
        /// How primitives are added, recycled and removed.
        density_control: DensityControlConfig = DensityControlConfig::default();
        /// Filtered backprojection.
        fdk: FdkConfig = FdkConfig::default();
        /// The methods sart, os-sart, asd-pocs and cgls.
        algebraic: AlgebraicConfig = AlgebraicConfig::default();
        /// The descent of the total variation in asd-pocs.
        asd_pocs: AsdPocsConfig = AsdPocsConfig::default();
        /// The method tv, and the finish.
        tv: TvConfig = TvConfig::default();
        /// The methods naf, sax-nerf and intratomo.
        neural: NeuralConfig = NeuralConfig::default();
    }
}

keys! {
    /// The primitives.
    pub struct ModelConfig {
        /// Profile of the primitives: student-t or gaussian.
        kernel: KernelKind = KernelKind::StudentT;
        /// Number of primitives at the start. 0: ¾ (voxels)^⅔.
        points: usize = 0, POPULATION;
        /// Lower limit of the degrees of freedom ν.
        nu_min: f64 = 2.0, POSITIVE;
        /// Upper limit of ν.
        nu_max: f64 = 100.0, POSITIVE;
        /// ν at the start.
        nu_initial: f64 = 10.0, POSITIVE;
        /// Smallest scale, voxels. The default is the standard deviation of linear interpolation between voxel centres.
        smallest_scale: f64 = 0.408, VOXELS;
        /// Largest scale, as a fraction of the longest side of the volume.
        scale_max: f64 = 0.5, UP_TO_1;
        /// Layer around the volume that is reconstructed as well and not written, as a fraction of the volume's longest side:
        /// for an object that is longer or wider than the volume. All methods have it.
        margin: f64 = 0.0, NOT_NEGATIVE;
    }
}

keys! {
    /// Where the primitives start.
    pub struct InitialisationConfig {
        /// First volume: sart, tv, fdk, smoothed-fdk, dataset (its init_*.npy), random, or model (primitives of a file).
        from: Start = Start::Sart;
        /// Voxels of the first volume above this density, in units of density_unit, can become primitives.
        threshold: f64 = 0.05, FINITE;
        /// Factor from the density of the voxel to that of its primitive, which overlaps its neighbours.
        density_factor: f64 = 0.15, POSITIVE;
        /// smoothed-fdk: standard deviation of the Gaussian filter, voxels.
        smoothing: f64 = 1.0, UP_TO_16;
        /// model: the MODEL.npz (scene units) that the run starts from; its primitives set model.points.
        model: String = String::new();
    }
}

keys! {
    /// The loss of the training: `L1 + d_ssim·(1-SSIM)` of a projection `+ tv·TV` of a block of the volume.
    pub struct LossConfig {
        /// Weight of 1-SSIM of the projection.
        d_ssim: f64 = 0.25, NOT_NEGATIVE;
        /// Weight of the total variation of the block; 0: none. auto: 0.1 n/256 for a volume of n³ voxels.
        tv: Auto<f64> = Auto::Auto, NOT_NEGATIVE_OR_AUTO;
        /// Side of the block, voxels. 0: 32.
        tv_block: usize = 0, BLOCK;
        /// Whether total variation and wavelet loss have a gradient to the centres of primitives.
        blocks_move: bool = true;
    }
}

keys! {
    /// Ray confidence c: how well the rays around a primitive cover its directions, and its pull on ν.
    pub struct ConfidenceConfig {
        /// Whether c pulls ν. The wavelet loss uses c in any case.
        enabled: bool = true;
        /// Weight λ of the pull.
        weight: f64 = 1e-4, NOT_NEGATIVE;
        /// Temperature T: the lower it is, the more steeply the target of ν rises with c.
        temperature: f64 = confidence::Settings::default().temperature, POSITIVE;
        /// Number of points on the unit sphere.
        sphere_points: usize = confidence::Settings::default().sphere_points, SPHERE;
        /// α: the length that the extent of a primitive along a ray is divided by. `own`: the geometric mean of its
        /// scales; `median`: the median of these means over all primitives; a number: so many sides of a voxel.
        alpha: AlphaConfig = AlphaConfig::Reading(AlphaReading::Own);
        /// Largest radius that a ray covers, in units of the radius of the sphere.
        r_max: f64 = confidence::Settings::default().r_max, POSITIVE;
        /// Ratio of α to the extent along the ray at which that radius is reached.
        kappa: f64 = confidence::Settings::default().kappa, POSITIVE;
        /// Iterations between two computations of c. Primitives that density control adds get theirs at once. 0: a twelfth
        /// of the run, at most 500.
        every: usize = 0;
    }
}

keys! {
    /// The wavelet loss: detail is sharpened near confident primitives and smoothed elsewhere.
    pub struct WaveletConfig {
        /// Whether the loss is used.
        enabled: bool = true;
        /// Iterations between two blocks. 0: 10.
        every: usize = 0;
        /// Side of the block, voxels. 0: 32.
        block: usize = 0;
        /// Levels of the Haar transform.
        levels: usize = wavelet::Settings::default().levels, LEVELS;
        /// K: number of nearest primitives of a voxel whose confidence counts.
        neighbours: usize = wavelet::Settings::default().neighbours, NEIGHBOURS;
        /// τ: confidence from which on a primitive is confident.
        threshold: f64 = wavelet::Settings::default().threshold, FRACTION;
        /// η: factor on detail near confident primitives.
        enhancement: f64 = wavelet::Settings::default().enhancement, NOT_NEGATIVE;
        /// Weight of the smoothing.
        suppress: f64 = wavelet::Settings::default().suppress, NOT_NEGATIVE;
        /// Weight of the sharpening.
        enhance: f64 = wavelet::Settings::default().enhance, NOT_NEGATIVE;
    }
}

keys! {
    /// Learning rates and Adam. A pair is the rate at the start and at the end of a run of `horizon` iterations; rates fall
    /// exponentially between them.
    pub struct OptimiserConfig {
        /// Optimiser of positions: sghmc, sghmc-textbook or adam.
        position: PositionOptimiser = PositionOptimiser::Sghmc;
        /// Iterations that the rates belong to. A run of n multiplies them by (horizon/n)^¾, at most by 64.
        horizon: usize = 30_000, AT_LEAST_1;
        /// Iterations beyond which rates are divided by n/longest: a longer run does not fit the noise more closely.
        longest: usize = 5000, AT_LEAST_1;
        /// Learning rates of the centres, scene units.
        mean: [f64; 2] = [2e-4, 2e-5], RATES;
        /// Learning rates of raw scales.
        scale: [f64; 2] = [5e-3, 5e-4], RATES;
        /// Learning rates of quaternions.
        quaternion: [f64; 2] = [1e-3, 1e-4], RATES;
        /// Learning rates of raw densities.
        density: [f64; 2] = [1e-2, 1e-3], RATES;
        /// Learning rates of raw ν. [0, 0]: ν stays as it is.
        nu: [f64; 2] = [1e-2, 1e-3], RATES;
        /// Adam's decay rates of the first and the second moment.
        beta: [f64; 2] = [0.9, 0.999], DECAYS;
        /// Adam's ε, which is added to the root of the second moment.
        epsilon: f64 = 1e-15, POSITIVE;
    }
}

keys! {
    /// The sampler of positions, where optimiser.position is sghmc. Its step is the root of the learning rate of centres.
    pub struct SghmcConfig {
        /// Fraction of the run, from its start, without momentum.
        burn_in: f64 = 7.0 / 30.0, FRACTION;
        /// Friction C during the burn-in; it scales the noise.
        burn_in_friction: f64 = 50.0;
        /// Friction C afterwards: damping and noise.
        friction: f64 = 50.0;
        /// Density, in units of density_unit, at which a primitive gets no noise. Below a hundredth of it noise is full.
        density_reference: f64 = 0.1, POSITIVE;
        /// sghmc-textbook: the loss divided by it is the energy.
        temperature: f64 = 1e-6, POSITIVE;
    }
}

keys! {
    /// How primitives are added, recycled and removed.
    pub struct DensityControlConfig {
        /// ar (adding and recycling), adc (adaptive density control), or none (the initial primitives stay).
        method: DensityControl = DensityControl::Ar;
        /// Fraction of the run before the first step.
        start: f64 = 1.0 / 60.0, FRACTION;
        /// Fraction of the run after which there are no more steps. auto: 1/2 with adc, otherwise 5/6.
        stop: Auto<f64> = Auto::Auto, FRACTION_OR_AUTO;
        /// Iterations between two steps. 0: a sixtieth of the run, at most 100.
        every: usize = 0;
        /// Largest number of primitives; adc may exceed it by one step. 0: 2 (voxels)^⅔, at most a primitive for 8 rays.
        cap: usize = 0, POPULATION;
        /// ar: density below which a primitive is dead, in units of density_unit.
        dead: f64 = 5e-4, NOT_NEGATIVE;
        /// ar: largest fraction of the primitives that one step recycles.
        recycled: f64 = 0.05, FRACTION;
        /// ar: fraction by which one step adds primitives.
        growth: f64 = 0.05, NOT_NEGATIVE;
        /// ar: how copies share the density of their parent. exact: field and projections do not change; sss: the rule for
        /// opacities; sss-program: that of 3D Student Splatting's program.
        relocation: Relocation = Relocation::Exact;
        /// ar: whether Adam's moments of a primitive that was copied start anew, as in 3D Student Splatting.
        reset_parents: bool = false;
        /// ar: distance of copies from their parent, in its standard deviations. 0: the same place, where they never separate.
        spread: f64 = 1.0, NOT_NEGATIVE;
        /// adc: mean length of the gradient to a projected centre, in halves of the detector, from which a primitive is cloned
        /// or split. auto: 5e-5.
        gradient: Auto<f64> = Auto::Auto, NOT_NEGATIVE_OR_AUTO;
        /// adc: scale above which a primitive is split instead of cloned, as a fraction of the volume's longest side.
        split_scale: f64 = 0.1, NOT_NEGATIVE;
        /// adc: density below which a primitive is removed, in units of density_unit.
        faint: f64 = 1e-5, NOT_NEGATIVE;
    }
}

keys! {
    /// Filtered backprojection.
    pub struct FdkConfig {
        /// Window of the ramp filter: ram-lak (none), shepp-logan, cosine, hamming or hann.
        window: Window = Window::default();
        /// Arc of the views: measured (from the angles; too short an arc is refused), or full, whatever views are missing.
        turn: Turn = Turn::default();
    }
}

keys! {
    /// The methods sart, os-sart, asd-pocs and cgls.
    pub struct AlgebraicConfig {
        /// Weights of voxels along a ray: joseph or siddon.
        rays: RayModel = RayModel::default();
        /// Relaxation λ of the first pass of SART.
        relaxation: f64 = SartSettings::default().relaxation, BELOW_2;
        /// Factor on λ after each pass.
        reduction: f64 = SartSettings::default().reduction, UP_TO_1;
        /// Whether λ keeps its first value, as in TIGRE, which accepts a reduction and ignores it.
        constant_relaxation: bool = SartSettings::default().constant_relaxation;
        /// Number of views that correct the volume together.
        subset: usize = SartSettings::default().subset, AT_LEAST_1;
        /// Order of the views: input, random or angular-distance.
        order: Order = Order::default();
        /// Whether negative voxels become 0 after each correction; not in cgls.
        non_negative: bool = SartSettings::default().non_negative;
        /// sart, os-sart and cgls: whether held-out views choose the number of passes, at most `iterations`.
        auto: bool = false;
        /// SART ends when a pass lowers the residual by less than this fraction. 0: after its last pass.
        tolerance: f64 = SartSettings::default().tolerance, FRACTION;
    }
}

keys! {
    /// The descent of the total variation in asd-pocs.
    pub struct AsdPocsConfig {
        /// Steps of the descent per iteration.
        tv_steps: usize = AsdPocsSettings::default().tv_steps, AT_LEAST_1;
        /// Length of the first step, as a fraction of SART's.
        alpha: f64 = AsdPocsSettings::default().alpha, NOT_NEGATIVE;
        /// Factor on the length where the descent exceeds r_max.
        alpha_reduction: f64 = AsdPocsSettings::default().alpha_reduction, UP_TO_1;
        /// Fraction of SART's step beyond which the descent is too long.
        r_max: f64 = AsdPocsSettings::default().r_max, NOT_NEGATIVE;
        /// Residual below which the step is not reduced, as a fraction of the residual of FDK.
        epsilon: f64 = AsdPocsSettings::default().epsilon, NOT_NEGATIVE;
    }
}

keys! {
    /// The method tv, non-negative least squares with total variation, and the finish.
    pub struct TvConfig {
        /// Weight of the total variation, as a fraction of the largest backprojected value. auto: chosen on held-out views.
        weight: Auto<f64> = Auto::Auto, NOT_NEGATIVE_OR_AUTO;
        /// tv ends when a step is shorter than this fraction of the volume. 0: after its last iteration.
        tolerance: f64 = TvSettings::default().tolerance, FRACTION;
        /// Steps of the total variation in each iteration.
        steps: usize = TvSettings::default().steps, AT_LEAST_1;
        /// Iterations of the finish. auto: chosen with the weight on the pilot run, otherwise 10 to 20.
        finish_iterations: Auto<usize> = Auto::Auto, COUNT_OR_AUTO;
        /// Share of the finished volume in the result; the rest is the volume before. auto: chosen with the weight, else 1.
        share: Auto<f64> = Auto::Auto, FRACTION_OR_AUTO;
        /// Whether a pilot run, half as long and without a sixth of the views, chooses what is auto in sampling and finish.
        pilot: bool = true;
    }
}

keys! {
    /// The methods naf, sax-nerf and intratomo.
    pub struct NeuralConfig {
        /// Levels of the hash grid, of 16, 32, 64, … cells a side. 0: the last level has four cells a voxel.
        levels: usize = 0, GRIDS;
        /// Largest number of entries of a level, as a power of two. 0: as many as voxels, 14 to 19.
        table: u32 = 0, DOUBLINGS;
        /// Points along a ray, an even number. 0: one and a half per voxel along a side.
        samples: usize = 0, SAMPLES;
        /// Single pixels of a step.
        rays: usize = 1024;
        /// Whether pixels of value 0 are used; the original programs leave them out.
        air: bool = true;
        /// Windows of pixels of a step.
        windows: usize = 0;
        /// Side of a window, pixels.
        window: usize = 4, AT_LEAST_1;
        /// Learning rate of the hash grid.
        table_rate: f64 = 1e-2, POSITIVE;
        /// Learning rate of the network.
        network_rate: f64 = 3e-3, POSITIVE;
        /// Steps after which both learning rates are divided by ten, again and again. auto: two thirds of all steps.
        drop: Auto<usize> = Auto::Auto, COUNT_OR_AUTO;
        /// Last layer: sigmoid (densities from 0 to the ceiling), or relu (leaky, with small negative densities).
        output: NeuralOutput = NeuralOutput::Sigmoid;
        /// Largest density of the sigmoid, in units of the scan.
        ceiling: f64 = 1.25, POSITIVE;
        /// Partner of a voxel in SAX-NeRF's block: self, or z (its neighbour along z, as in the original program).
        partner: VoxelPartner = VoxelPartner::Itself;
    }
}
