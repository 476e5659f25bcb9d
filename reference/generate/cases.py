"""All cases in the order of the manifest, the files they share, and the meaning of the flags."""

import confidence_cases
import cut_cases
import network_cases
import population_cases
import raw_cases
import scan_cases
import scene_cases
import small_cases
import wavelet_cases
from files import file_bytes

FLAGS = {
    "above-i0": "a reading above the photons without an object: clipped to 0",
    "all-covered": "a confidence of 1",
    "anisotropic-voxels": "the three sides of a voxel differ",
    "at-source-plane": "a centre lies exactly in the plane of the source, where its depth is 0",
    "behind-source": "a centre lies behind the source",
    "below-floor": "a reading below the floor, which stands in for it",
    "beyond-detector": "voxels that project beside the detector",
    "cap-reached": "the population is as large as it may get",
    "centre-on-pixel": "a centre projects exactly on the centre of a pixel",
    "centre-outside-detector": "centres project beside the detector",
    "constant-images": "all pixels of an image are the same",
    "equal-distances": "primitives at the same distance from a voxel: the one with the lower index is nearer",
    "equal-neighbours": "neighbours with the same value: the sub-gradient of their difference is 0",
    "equal-pixels": "pixels where prediction and target are the same: the sub-gradient of |p-t| is 0",
    "extreme-gradient": "gradients many orders of magnitude from 1",
    "far-skirt": "values far below the peak",
    "few-primitives": "fewer primitives than neighbours are asked for",
    "flat-block": "a block or a part of it without any change",
    "gaussian-limit": "the Gaussian kernel as the limit of nu to infinity, and nu so large that it is nearly reached",
    "ill-conditioned": "scales of one primitive a thousand apart",
    "near-limit": "a centre just nearer to the source than dso/100, where it is left out",
    "negative-values": "values below 0",
    "non-square-pixels": "the two sides of a pixel differ",
    "nothing-covered": "a confidence of 0",
    "nu-above-training-range": "nu > 100",
    "nu-below-training-range": "nu < 2",
    "odd-even-sides": "one side of the detector is odd, the other even",
    "offset-detector": "the detector is shifted",
    "offset-volume": "the volume is shifted",
    "on-the-cutoff": "a pixel or a voxel at the cutoff itself, where either answer is right (see its allowance)",
    "one-pixel": "a detector or an image of one pixel",
    "one-row": "an image of one row",
    "one-view": "a single view",
    "parallel": "a parallel beam",
    "range-above-one": "image values above the range of 1 that SSIM's constants are made for",
    "repeated-points": "several primitives at one place",
    "saturated": "raw numbers far out, where a sigmoid or a softplus loses its slope",
    "side-of-one": "an array with a side of 1",
    "sign-flip": "a gradient that changes its sign",
    "subnormal": "densities below the smallest normal number",
    "support-beyond-detector": "the support of a primitive is larger than the detector",
    "support-not-ellipse": "the plane of the source cuts the support, whose shadow is then no ellipse",
    "tiny-density": "a density of 1e-30",
    "tiny-quaternion": "a quaternion of norm 1e-18 or 1e-100",
    "two-levels": "a transform of two levels",
    "uneven-views": "views at uneven angles, not in order",
    "unnormalised-quaternion": "quaternions whose norm is not 1",
    "zero-density": "a density of 0",
    "zero-gradient": "a gradient of exactly 0",
    "zero-image": "an image of zeros",
    "zero-rate": "a rate of 0 at one end",
}

CASES = [
    *scene_cases.covariances(),
    *small_cases.kernels(),
    *small_cases.integral_factors(),
    *scene_cases.densities(),
    *scene_cases.projected_kernels("affine"),
    *scene_cases.projected_kernels("exact"),
    *scene_cases.images("affine"),
    *scene_cases.images("exact"),
    *scene_cases.density_gradients(),
    *scene_cases.image_gradients("affine"),
    *scene_cases.image_gradients("exact"),
    *raw_cases.activations(),
    *raw_cases.raw_gradients(),
    *cut_cases.supports(),
    *cut_cases.cut_images("image-cutoff"),
    *cut_cases.cut_densities(),
    *cut_cases.cut_images("truncation-bound"),
    *small_cases.image_losses("loss-l1"),
    *small_cases.image_losses("loss-ssim"),
    *small_cases.tv_losses(),
    *small_cases.image_losses("loss-image"),
    *confidence_cases.confidences(),
    *confidence_cases.nu_targets(),
    *confidence_cases.nu_losses(),
    *wavelet_cases.transforms(),
    *wavelet_cases.routings(),
    *wavelet_cases.wavelet_losses(),
    *wavelet_cases.field_gradients(),
    *small_cases.schedules(),
    *small_cases.adams(),
    *population_cases.gates(),
    *population_cases.samplers(),
    *population_cases.recyclings(),
    *population_cases.controls(),
    *population_cases.shadow_gradients(),
    *scan_cases.fdk_filters(),
    *scan_cases.fdk_backprojections(),
    *scan_cases.fdks(),
    *scan_cases.noises(),
    *scan_cases.randoms(),
    *scan_cases.metric_cases(),
    *network_cases.hash_corners(),
    *network_cases.hash_codes("hash-code"),
    *network_cases.hash_codes("gradient-hash-code"),
    *network_cases.frequency_codes(),
    *network_cases.lineformers(),
    *network_cases.lineformer_gradients(),
    *network_cases.quadratures(),
]


def shared_inputs():
    """path -> content of every given file; one path must not have two contents."""
    found = {}
    for case in CASES:
        for given in case.inputs.values():
            before = found.setdefault(given.path, given.content)
            assert before is given.content or file_bytes(given.path, before) == file_bytes(given.path, given.content), given.path
    return found


INPUTS = shared_inputs()
USED = {flag for case in CASES for flag in case.flags}
assert USED == set(FLAGS), f"flags used but not described, or described but not used: {sorted(USED ^ set(FLAGS))}"
assert len({case.id for case in CASES}) == len(CASES), "two cases have one id"
